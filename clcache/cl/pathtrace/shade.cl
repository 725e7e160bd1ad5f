// One vertex of every path: a shadow ray to one of the lights, and the path's next direction, or its end. Reads the paths'
// surfaces, writes shadow rays and what each would bring, the next rays and the throughput. One work-item per path; a ray
// of length 0 is no ray.
//
// Lights with an extent are found by both rays; the power heuristic weighs the two (Veach 1997, section 9.2): here for the
// shadow ray, in gather.cl for the other, to which `density` goes along. From the bounce `roulette` on, a path goes on with
// the probability of its throughput's largest component; where `is_last`, none does.
//
// Defines: HAS_DIRECT (something to send shadow rays to) and those of bsdf.cl and emitters.cl.

#include "common/bsdf.cl"
#include "common/sampler.cl"
#include "pathtrace/dimensions.cl"
#include "pathtrace/mis.cl"
#include "scene/emitters.cl"

#define WIDEST_ROUGH_SPREAD 1.0f

// The parameters of a hit as a reflection model.
inline Bsdf make_bsdf(float3 base, float metallic, float roughness, __global const Material *m, bool from_behind)
{
    Bsdf bsdf;
    bsdf.diffuse = base;
#if HAS_SPECULAR
    float reflected = (m->ior - 1.0f) / (m->ior + 1.0f);
    float3 tint = (float3)(m->specular_color[0], m->specular_color[1], m->specular_color[2]);
    float3 dielectric = fmin(reflected * reflected * tint, 1.0f) * m->specular;
    bsdf.diffuse = base * ((1.0f - metallic) * (1.0f - m->transmission));
    bsdf.transmitted = base * ((1.0f - metallic) * m->transmission);
    bsdf.f0 = dielectric + metallic * (base - dielectric);
    bsdf.f90 = m->specular + metallic * (1.0f - m->specular);
    if (from_behind && !m->double_sided && !(m->transmission > 0.0f)) {  // black, and so is its reflection
        bsdf.f0 = (float3)(0.0f);
        bsdf.f90 = 0.0f;
    }
    bsdf.alpha = roughness * roughness;
    bsdf.thin = m->thin;
    bsdf.eta = from_behind && !m->thin ? 1.0f / m->ior : m->ior;
#endif
    return bsdf;
}

inline float3 to_local(float3 tangent, float3 bitangent, float3 normal, float3 v)
{
    return (float3)(dot3(v, tangent), dot3(v, bitangent), dot3(v, normal));
}

// How much wider a cone gets by reflection (MaterialMemo, Eq. 2.11), clamped where that diverges at alpha = 1.
inline float rough_spread(float alpha)
{
    float squared = alpha * alpha;
    return fmin(2.0f * sqrt(squared / fmax(2.0f - 2.0f * squared, 1e-6f)), WIDEST_ROUGH_SPREAD);
}

__kernel void shade(
    __global const Emitter *emitter_list,    // (emitters) or null
    __global const float *shares,            // (emitters) or null
    __global const float *positions,         // (vertices, 3)
    __global const uint *triangles,          // (triangles, 3)
    __global const float *uvs,               // (vertices, 2) or null
    __global const Instance *instances,      // (instances)
    __global const uint *material,           // (triangles)
    __global const Material *materials,      // (materials)
    __global const TextureUse *uses,         // (uses) or null
    __global const Texture *textures,        // (textures) or null
    __global const uint *texels,             // (texels) or null
    __global const float *srgb,              // (256) or null
    __global const float *sky,               // (sky_size, 3)
    __global const float *sky_rows,          // (sky_height) or null
    __global const float *sky_columns,       // (sky_size) or null
    __global const uint *hit_instance,       // (n)
    __global const uint *hit_material,       // (n)
    __global const float *point,             // (3, n)
    __global const float *offset,            // (n)
    __global const float *geometric_normal,  // (3, n)
    __global const float *shading_normal,    // (3, n)
    __global const float *albedo,            // (3, n)
    __global const float *gloss,             // (2, n) or null
    __global float *cone,                    // (2, n) or null
    __global float *ray_origin,              // (3, n)
    __global float *ray_direction,           // (3, n)
    __global float *ray_length,              // (n)
    __global float *throughput,              // (3, n)
    __global float *density,                 // (n) or null
    __global float *shadow_origin,           // (3, n) or null
    __global float *shadow_direction,        // (3, n) or null
    __global float *shadow_length,           // (n) or null
    __global float *shadow_radiance,         // (3, n) or null
    __global uint *ray_counts,               // (2, n)
    Environment environment,
    uint n,
    uint emitters,
    uint vertex,
    uint roulette,
    uint is_last,
    uint sample,
    uint key0,
    uint key1)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    if (hit_instance[i] == NONE) {
        ray_length[i] = 0.0f;
#if HAS_DIRECT
        shadow_length[i] = 0.0f;
#endif
        return;
    }
    uint2 key = (uint2)(key0, key1);
    float4 random = sample4(i, sample, DIMENSION_VERTEX + 2 * vertex, key);
    float3 ng = load_planes(geometric_normal, n, i), ns = load_planes(shading_normal, n, i);
    float3 here = load_planes(point, n, i), away = offset[i] * ng;
    float3 carried = load_planes(throughput, n, i);
    float3 tangent, bitangent;
    make_frame(ns, &tangent, &bitangent);
    float3 out = to_local(tangent, bitangent, ns, -load_planes(ray_direction, n, i));
    out.z = fmax(out.z, 1e-6f);
    uint tagged = hit_material[i];
#if HAS_SPECULAR
    float metallic = gloss[i], roughness = gloss[n + i];
#else
    float metallic = 0.0f, roughness = 1.0f;
#endif
    Bsdf bsdf = make_bsdf(load_planes(albedo, n, i), metallic, roughness, materials + (tagged & ~FROM_BEHIND), tagged & FROM_BEHIND);

#if HAS_DIRECT
    Maps maps = { uses, textures, texels, srgb };
    Sky far = { environment, sky, sky_rows, sky_columns };
    Emitters lights = { emitter_list, shares, emitters, positions, triangles, uvs, instances, material, materials, maps, far };
    float4 place = sample4(i, sample, DIMENSION_VERTEX + 2 * vertex + 1, key);
    LightSample light = sample_emitters(&lights, here, place.z, place.x, place.y);
    float3 towards = normalize3(light.towards);
    float3 in = to_local(tangent, bitangent, ns, towards);
    float found_otherwise;
    float3 reflected = evaluate_bsdf(&bsdf, out, in, &found_otherwise);
    float weight = light.density > 0.0f ? power_heuristic(light.density, found_otherwise) : 1.0f;
    float3 brought = carried * reflected * light.radiance * weight;
    bool above = dot3(ng, towards) > 0.0f;
    bool lit = above == (in.z > 0.0f) && max_component(brought) > 0.0f && max_component(brought) < INFINITY;
    float3 from = above ? here + away : here - away;
    store_planes(shadow_origin, n, i, from);
    store_planes(shadow_direction, n, i, light.length < INFINITY ? light.towards + (here - from) : towards);
    shadow_length[i] = lit ? light.length : 0.0f;
    store_planes(shadow_radiance, n, i, lit ? brought : (float3)(0.0f));
    ray_counts[n + i] += lit;
#endif

    Scattered next = sample_bsdf(&bsdf, out, random.w, random.x, random.y);
    float3 direction = normalize3(next.direction.x * tangent + next.direction.y * bitangent + next.direction.z * ns);
    bool leaves_above = dot3(ng, direction) > 0.0f;
    float3 kept = carried * next.weight;
    float survival = vertex + 1 >= roulette ? fmin(max_component(kept), 1.0f) : 1.0f;
    bool goes_on = !is_last && leaves_above == (next.direction.z > 0.0f) && max_component(kept) > 0.0f && random.z < survival;
    store_planes(ray_origin, n, i, leaves_above ? here + away : here - away);
    store_planes(ray_direction, n, i, direction);
    store_planes(throughput, n, i, kept / survival);
    if (density) density[i] = next.density;
    ray_length[i] = goes_on ? INFINITY : 0.0f;
    ray_counts[i] += goes_on;
#if HAS_TEXTURES
    cone[n + i] += rough_spread(next.density < INFINITY ? roughness * roughness : 0.0f);
#endif
}
