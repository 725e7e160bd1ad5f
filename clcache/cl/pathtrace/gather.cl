// Add to the pixels' radiance what the paths found. Straight-line; one work-item per path.

#include "common/math.cl"

// What the surfaces hit emit, and the environment where there was none.
__kernel void emission(
    __global const Instance *instances,  // (instances)
    __global const uint *material,       // (triangles)
    __global const Material *materials,  // (materials)
    __global const uint *hit_primitive,  // (n)
    __global const uint *hit_instance,   // (n)
    __global const float *ray_length,    // (n)
    __global const float *throughput,    // (3, n)
    __global float *radiance,            // (3, n)
    uint n,
    float red,
    float green,
    float blue)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    if (!(ray_length[i] > 0.0f)) return;
    float3 emitted = (float3)(red, green, blue);
    uint instance = hit_instance[i];
    if (instance != NONE) {
        __global const Material *m = materials + material[instances[instance].first_triangle + hit_primitive[i]];
        emitted = (float3)(m->emission[0], m->emission[1], m->emission[2]);
    }
    store_planes(radiance, n, i, load_planes(radiance, n, i) + load_planes(throughput, n, i) * emitted);
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
