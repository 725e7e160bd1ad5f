// Direct light: choose one of the scene's emitters by its share of their power, and a place on it.
//
// Defines: HAS_PUNCTUAL (points, spots, directions), HAS_EMISSIVE (triangles), HAS_LAMP_HOLES,
// HAS_EMISSION_MAPS (with holes and pictures), HAS_SKY_PICTURE;
// EMITTER_STEPS: of the search in the shares.

#include "scene/alpha.cl"
#include "scene/environment.cl"

#define LEAST_COSINE 1e-6f  // at a triangle that is seen from its own plane, but for rounding

typedef struct LightSample {
    Vec3 towards;   // to the light, whose place is at t = length
    float length;
    Vec3 radiance;  // arriving, divided by the density of choosing it
    float density;  // per solid angle, of choosing this direction; 0 for a light without extent
} LightSample;

typedef struct Emitters {
    __global const Emitter *list;
    __global const float *shares;  // (count): cumulative share of power
    uint count;
    Masks masks;
    Sky sky;
} Emitters;

inline LightSample either_light(bool first, LightSample a, LightSample b)
{
    LightSample light;
    light.towards = either3(first, a.towards, b.towards);
    light.length = first ? a.length : b.length;
    light.radiance = either3(first, a.radiance, b.radiance);
    light.density = first ? a.density : b.density;
    return light;
}

#if HAS_EMISSIVE

// A place on an emissive triangle, uniform by area.
INLINED LightSample sample_triangle(const Emitters *emitters, __global const Emitter *emitter, float chance, Vec3 from, float u1,
                                   float u2)
{
    const Masks *masks = &emitters->masks;
    Vec3 corner = load3(emitter->position), edge1 = load3(emitter->direction), edge2 = load3(emitter->power);
    float root = sqrt(u1);
    float u = root * (1.0f - u2), v = root * u2;
    Vec3 cross = cross3(edge1, edge2);
    float twice_area = sqrt(dot3(cross, cross));
    Vec3 towards = add3(sub3(corner, from), add3(scale3(u, edge1), scale3(v, edge2)));
    float squared = dot3(towards, towards);
    float facing = dot3(cross, towards) / (twice_area * sqrt(squared));
    float cosine = fabs(facing);
    __global const Material *m = masks->materials + emitter->material;
    bool faces = m->double_sided != 0 || facing * emitter->cone[0] < 0.0f;
    bool shines = faces && cosine > LEAST_COSINE && squared > 0.0f;
    Vec3 radiance = load3(m->emission);
#if HAS_EMISSION_MAPS
    uint triangle = masks->instances[emitter->instance].first_triangle + emitter->primitive;
    uint a = masks->triangles[3 * triangle], b = masks->triangles[3 * triangle + 1], c = masks->triangles[3 * triangle + 2];
    __global const float *uv0 = masks->uvs + 2 * a, *uv1 = masks->uvs + 2 * b, *uv2 = masks->uvs + 2 * c;
    float across = uv0[0] + (u * (uv1[0] - uv0[0]) + v * (uv2[0] - uv0[0]));
    float down = uv0[1] + (u * (uv1[1] - uv0[1]) + v * (uv2[1] - uv0[1]));
    Texel texel = sample_map(&masks->maps, m->emission_map, across, down, 0.0f);
    radiance = mul3(radiance, vec3(texel.x, texel.y, texel.z));
#endif
#if HAS_LAMP_HOLES
    shines = shines && !is_hole(masks, emitter->instance, emitter->primitive, u, v);
#endif
    float density = chance / (0.5f * twice_area) * squared / cosine;
    LightSample sample;
    sample.towards = either3(shines, towards, all3(0.0f));
    sample.length = shines ? 1.0f - 1e-4f : 0.0f;  // just short of the light, so that it does not shadow itself
    sample.radiance = either3(shines, scale3(1.0f / density, radiance), all3(0.0f));
    sample.density = shines ? density : 0.0f;
    return sample;
}

#endif

#if HAS_PUNCTUAL

INLINED LightSample sample_punctual(__global const Emitter *emitter, float chance, Vec3 from)
{
    Vec3 axis = load3(emitter->direction), power = load3(emitter->power);
    Vec3 towards = sub3(load3(emitter->position), from);
    float squared = dot3(towards, towards);
    float falloff = clamp(-dot3(axis, normalize3(towards)) * emitter->cone[0] + emitter->cone[1], 0.0f, 1.0f);
    float part = squared > 0.0f ? falloff * falloff / squared : 0.0f;
    bool is_far = emitter->kind == 1;
    LightSample sample;
    sample.towards = either3(is_far, axis, towards);
    sample.length = is_far ? INFINITY : 1.0f;
    sample.radiance = scale3((is_far ? 1.0f : part) / chance, power);
    sample.density = 0.0f;
    return sample;
}

#endif

INLINED LightSample sample_emitters(const Emitters *emitters, Vec3 from, float pick, float u1, float u2)
{
    uint index = search_shares(emitters->shares, emitters->count, EMITTER_STEPS, pick);
    float chance = share(emitters->shares, index);
    __global const Emitter *emitter = emitters->list + index;
    LightSample sample;
    sample.towards = sample.radiance = all3(0.0f);
    sample.length = sample.density = 0.0f;
#if HAS_PUNCTUAL
    sample = sample_punctual(emitter, chance, from);
#endif
#if HAS_EMISSIVE
    sample = either_light(emitter->kind == 2, sample_triangle(emitters, emitter, chance, from, u1, u2), sample);
#endif
#if HAS_SKY_PICTURE
    float density, u;
    LightSample far;
    bool is_sky = emitter->kind == 3;  // others look where the cache has it
    far.towards = sample_sky(&emitters->sky, is_sky ? u1 : 0.0f, is_sky ? u2 : 0.0f, &density, &u);
    far.length = INFINITY;
    far.density = density * chance;
    far.radiance = scale3(1.0f / far.density, picture_radiance(&emitters->sky, u, picture_v(far.towards)));
    sample = either_light(is_sky, far, sample);
#endif
    return sample;
}
