// Add to the pixels' radiance what the paths found. One work-item per path.
//
// Defines: HAS_EMISSIVE, HAS_SKY_PICTURE.

#include "common/math.cl"
#include "pathtrace/mis.cl"
#include "scene/environment.cl"

// What the surfaces hit emit, and the environment where there was none, weighted against finding it by a shadow ray.
__kernel void emission(
    __global const Material *materials,      // (materials)
    __global const float *sky,               // (sky_size, 3)
    __global const float *sky_rows,          // (sky_height) or null
    __global const float *sky_columns,       // (sky_size) or null
    __global const float *ray_direction,     // (3, n)
    __global const float *ray_length,        // (n)
    __global const float *hit_t,             // (n)
    __global const uint *hit_instance,       // (n)
    __global const uint *hit_material,       // (n)
    __global const float *geometric_normal,  // (3, n)
    __global const float *emitted,           // (3, n) or null
    __global const float *throughput,        // (3, n)
    __global const float *density,           // (n)
    __global float *radiance,                // (3, n)
    Environment environment,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    if (!(ray_length[i] > 0.0f)) return;
    float3 found = (float3)(0.0f), direction = load_planes(ray_direction, n, i);
    float found_otherwise = 0.0f;
    if (hit_instance[i] == NONE) {
        Sky far = { environment, sky, sky_rows, sky_columns };
        found = sky_radiance(&far, direction);
#if HAS_SKY_PICTURE
        found_otherwise = environment.chance * sky_density(&far, direction);
#endif
    }
#if HAS_EMISSIVE
    else {
        found = load_planes(emitted, n, i);
        float cosine = fabs(dot3(load_planes(geometric_normal, n, i), direction));
        float per_area = materials[hit_material[i] & ~FROM_BEHIND].emitter_density;
        found_otherwise = per_area > 0.0f ? per_area * hit_t[i] * hit_t[i] / cosine : 0.0f;
    }
#endif
    found *= load_planes(throughput, n, i) * power_heuristic(density[i], found_otherwise);
    store_planes(radiance, n, i, load_planes(radiance, n, i) + found);
}

// What the lights bring where nothing stands between.
__kernel void direct(
    __global const uchar *occluded,         // (n)
    __global const float *shadow_length,    // (n)
    __global const float *shadow_radiance,  // (3, n)
    __global float *radiance,               // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    bool visible = shadow_length[i] > 0.0f && !occluded[i];
    float3 brought = load_planes(shadow_radiance, n, i);
    store_planes(radiance, n, i, load_planes(radiance, n, i) + (visible ? brought : (float3)(0.0f)));
}
