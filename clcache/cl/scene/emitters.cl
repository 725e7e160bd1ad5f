// Direct light: choose one of the scene's emitters by its share of their power, and a place on it.
//
// Defines: HAS_EMISSIVE (triangles), HAS_ALPHA (with holes), HAS_SKY_PICTURE.

#include "common/transform.cl"
#include "scene/alpha.cl"
#include "scene/environment.cl"

typedef struct LightSample {
    float3 towards;   // to the light, whose place is at t = length
    float length;
    float3 radiance;  // arriving, divided by the density of choosing it
    float density;    // per solid angle, of choosing this direction; 0 for a light without extent
} LightSample;

typedef struct Emitters {
    __global const Emitter *list;
    __global const float *shares;  // (count): cumulative share of power
    uint count;
    __global const float *positions;
    __global const uint *triangles;
    __global const float *uvs;
    __global const Instance *instances;
    __global const uint *material;
    __global const Material *materials;
    Maps maps;
    Sky sky;
} Emitters;

inline float3 float3_of(const float *v)
{
    return (float3)(v[0], v[1], v[2]);
}

#if HAS_EMISSIVE

// A place on an emissive triangle, uniform by area.
inline LightSample sample_triangle(const Emitters *emitters, Emitter emitter, float chance, float3 from, float u1, float u2)
{
    LightSample none = { (float3)(0.0f), 0.0f, (float3)(0.0f), 0.0f };
    Instance instance = emitters->instances[emitter.instance];
    uint triangle = instance.first_triangle + emitter.primitive;
    uint a = emitters->triangles[3 * triangle], b = emitters->triangles[3 * triangle + 1], c = emitters->triangles[3 * triangle + 2];
    float3 v0 = load_row(emitters->positions, a);
    float3 edge1 = load_row(emitters->positions, b) - v0, edge2 = load_row(emitters->positions, c) - v0;
    float root = sqrt(u1);
    float u = root * (1.0f - u2), v = root * u2;
#if HAS_ALPHA
    Masks masks = { emitters->instances, emitters->triangles, emitters->material, emitters->uvs, emitters->materials, emitters->maps };
    if (is_hole(&masks, emitter.instance, emitter.primitive, u, v)) return none;
#endif
    float3 place = transform_point(instance.to_world, v0 + (u * edge1 + v * edge2));
    float3 cross = cross3(transform_vector(instance.to_world, edge1), transform_vector(instance.to_world, edge2));
    float3 normal = normalize3(cross);
    float area = 0.5f * sqrt(dot3(cross, cross));
    float3 outward = transform_normal(instance.to_object, cross3(edge1, edge2));

    float3 towards = place - from;
    float squared = dot3(towards, towards);
    float cosine = fabs(dot3(normal, normalize3(towards)));
    __global const Material *m = emitters->materials + emitters->material[triangle];
    bool faces = m->double_sided || dot3(outward, towards) < 0.0f;
    if (!faces || !(cosine > 0.0f) || !(squared > 0.0f)) return none;
    float3 radiance = (float3)(m->emission[0], m->emission[1], m->emission[2]);
#if HAS_TEXTURES
    if (m->emission_map >= 0) {
        float2 uv0 = vload2(a, emitters->uvs);
        float2 uv = uv0 + u * (vload2(b, emitters->uvs) - uv0) + v * (vload2(c, emitters->uvs) - uv0);
        radiance *= sample_map(&emitters->maps, m->emission_map, uv, 0.0f).xyz;
    }
#endif
    float density = chance / area * squared / cosine;
    // Just short of the light, so that it does not shadow itself.
    LightSample sample = { towards, 1.0f - 1e-4f, radiance / density, density };
    return sample;
}

#endif

inline LightSample sample_emitters(const Emitters *emitters, float3 from, float pick, float u1, float u2)
{
    uint index = search_shares(emitters->shares, emitters->count, pick);
    float chance = share(emitters->shares, index);
    Emitter emitter = emitters->list[index];
    float3 power = float3_of(emitter.power), axis = float3_of(emitter.direction);
#if HAS_EMISSIVE
    if (emitter.kind == 2) return sample_triangle(emitters, emitter, chance, from, u1, u2);
#endif
#if HAS_SKY_PICTURE
    if (emitter.kind == 3) {
        float density;
        float3 towards = sample_sky(&emitters->sky, u1, u2, &density);
        density *= chance;
        LightSample sample = { towards, INFINITY, sky_radiance(&emitters->sky, towards) / density, density };
        return sample;
    }
#endif
    if (emitter.kind == 1) {
        LightSample sample = { axis, INFINITY, power / chance, 0.0f };
        return sample;
    }
    float3 towards = float3_of(emitter.position) - from;
    float squared = dot3(towards, towards);
    float falloff = clamp(-dot3(axis, normalize3(towards)) * emitter.cone[0] + emitter.cone[1], 0.0f, 1.0f);
    float3 arriving = squared > 0.0f ? power * (falloff * falloff / squared) : (float3)(0.0f);
    LightSample sample = { towards, 1.0f, arriving / chance, 0.0f };
    return sample;
}
