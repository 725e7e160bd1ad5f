// What a path does at a vertex: its surface as a reflection model, the light that its ray found there, a ray to one of the
// lights, and where it goes on.
//
// Defines: those of surface.cl, bsdf.cl and emitters.cl.

#include "pathtrace/mis.cl"
#include "scene/emitters.cl"
#include "scene/surface.cl"

#define WIDEST_ROUGH_SPREAD 1.0f

// The parameters of a surface as a reflection model.
INLINED Bsdf make_bsdf(const Surface *surface, __global const Material *m)
{
    Bsdf bsdf;
    Vec3 base = surface->albedo;
    bsdf.diffuse = base;
#if HAS_SPECULAR
    float metallic = surface->metallic, rest = 1.0f - metallic;
    bool behind = surface->from_behind, is_thin = m->thin != 0;
    float transmission = m->transmission, ior = m->ior, reflected = (ior - 1.0f) / (ior + 1.0f);
    Vec3 tint = scale3(reflected * reflected, surface->specular_color);
    Vec3 dielectric = scale3(surface->specular, vec3(fmin(tint.x, 1.0f), fmin(tint.y, 1.0f), fmin(tint.z, 1.0f)));
    bsdf.diffuse = scale3(rest * (1.0f - transmission), base);
    bsdf.transmitted = scale3(rest * transmission, base);
    bool is_black = behind && m->double_sided == 0 && !(transmission > 0.0f);  // and so is its reflection
    bsdf.f0 = either3(is_black, all3(0.0f), add3(dielectric, scale3(metallic, sub3(base, dielectric))));
    bsdf.f90 = is_black ? 0.0f : surface->specular + metallic * (1.0f - surface->specular);
    bsdf.alpha = surface->roughness * surface->roughness;
    bsdf.thin = is_thin;
    bsdf.eta = behind && !is_thin ? 1.0f / ior : ior;
#endif
    return bsdf;
}

inline Vec3 to_local(Vec3 tangent, Vec3 bitangent, Vec3 normal, Vec3 v)
{
    return vec3(dot3(v, tangent), dot3(v, bitangent), dot3(v, normal));
}

// How much wider a cone gets by reflection (MaterialMemo, Eq. 2.11), clamped where that diverges at alpha = 1.
inline float rough_spread(float alpha)
{
    float squared = alpha * alpha;
    return fmin(2.0f * sqrt(squared / fmax(2.0f - 2.0f * squared, 1e-6f)), WIDEST_ROUGH_SPREAD);
}

// What a ray found: the light of the surface, or of the sky where it hit none, weighted against finding it by a shadow ray.
INLINED Vec3 found_light(const Surface *surface, const Sky *sky, __global const Material *m, bool missed, float t, Vec3 direction,
                         float density)
{
#if HAS_EMISSIVE
    float cosine = fabs(dot3(surface->geometric_normal, direction));
#endif
    direction = either3(missed, direction, vec3(0.0f, 1.0f, 0.0f));  // where others look, too: a lookup from the cache
    Vec3 far = sky_radiance(sky, direction);
    float found_otherwise = 0.0f;
#if HAS_SKY_PICTURE
    found_otherwise = sky->environment.chance * sky_density_of(sky, direction);
#endif
#if HAS_EMISSIVE
    float per_area = m->emitter_density;
    float on_surface = per_area > 0.0f ? per_area * t * t / cosine : 0.0f;
    far = either3(missed, far, surface->emitted);
    found_otherwise = missed ? found_otherwise : on_surface;
#else
    far = either3(missed, far, all3(0.0f));
#endif
    return scale3(power_heuristic(density, found_otherwise), far);
}

// A surface as the reflection model sees it: its frame about the shading normal, and the direction that the path came from.
typedef struct Vertex {
    Vec3 tangent, bitangent, out;
} Vertex;

INLINED Vertex make_vertex(const Surface *surface, Vec3 direction)
{
    Vertex vertex;
    make_frame(surface->shading_normal, &vertex.tangent, &vertex.bitangent);
    vertex.out = to_local(vertex.tangent, vertex.bitangent, surface->shading_normal, negate3(direction));
    vertex.out.z = fmax(vertex.out.z, 1e-6f);
    return vertex;
}

// A shadow ray, and what it would bring: `reflected`, f |cos|, times `weight` (of it against rays that find the same light)
// times `radiance`.
typedef struct DirectLight {
    Vec3 origin, direction;
    float length;
    Vec3 radiance, reflected;
    float weight, cosine;  // cosine: to the shading normal
    bool is_possible;      // on one side of both normals
} DirectLight;

INLINED DirectLight sample_direct(const Emitters *lights, const Surface *surface, const Bsdf *bsdf, const Vertex *vertex,
                                  Random where)
{
    Vec3 ng = surface->geometric_normal, here = surface->point;
    LightSample light_sample = sample_emitters(lights, here, where.z, where.x, where.y);
    Vec3 towards = normalize3(light_sample.towards);
    Vec3 in = to_local(vertex->tangent, vertex->bitangent, surface->shading_normal, towards);
    float found_otherwise;
    DirectLight direct;
    direct.reflected = evaluate_bsdf(bsdf, vertex->out, in, &found_otherwise);
    direct.weight = light_sample.density > 0.0f ? power_heuristic(light_sample.density, found_otherwise) : 1.0f;
    direct.radiance = light_sample.radiance;
    direct.cosine = in.z;
    bool above = dot3(ng, towards) > 0.0f, is_near = light_sample.length < INFINITY;
    direct.is_possible = above == (in.z > 0.0f);
    direct.origin = add3(here, scale3(above ? surface->offset : -surface->offset, ng));
    direct.direction = either3(is_near, add3(light_sample.towards, sub3(here, direct.origin)), towards);
    direct.length = light_sample.length;
    return direct;
}

// The next ray: from where, its direction and density, and what it is multiplied by; impossible where it leaves through the
// surface's other side than the reflection model has it.
typedef struct Onwards {
    Vec3 origin, direction, weight;
    float density, cosine;
    bool is_possible;
} Onwards;

INLINED Onwards scatter(const Surface *surface, const Bsdf *bsdf, const Vertex *vertex, Random random)
{
    Vec3 ng = surface->geometric_normal, ns = surface->shading_normal;
    Scattered next = sample_bsdf(bsdf, vertex->out, random.w, random.x, random.y);
    Vec3 sideways = add3(scale3(next.direction.x, vertex->tangent), scale3(next.direction.y, vertex->bitangent));
    Onwards onwards;
    onwards.direction = normalize3(add3(sideways, scale3(next.direction.z, ns)));
    bool leaves_above = dot3(ng, onwards.direction) > 0.0f;
    onwards.origin = add3(surface->point, scale3(leaves_above ? surface->offset : -surface->offset, ng));
    onwards.weight = next.weight;
    onwards.density = next.density;
    onwards.cosine = next.direction.z;
    onwards.is_possible = leaves_above == (next.direction.z > 0.0f);
    return onwards;
}

// The roughness that a cone gets by: none after a mirror.
inline float alpha_of(const Surface *surface, float density)
{
    return density < INFINITY ? surface->roughness * surface->roughness : 0.0f;
}
