// Where no cell answers: paths of their own, from the listed hits into the queue and back. The list is worked off in batches of
// as many as there are places.
//
// Defines: HAS_DIRECT, HAS_EMISSION, HAS_TEXTURES.

#include "pathtrace/queue.cl"

#define STREAM 0x40000000u  // apart from the streams of pixels

// One work-item per place in the queue.
__kernel void begin_misses(
    __global const float *miss_uv,         // (2, capacity)
    __global const uint *miss_primitive,   // (capacity)
    __global const uint *miss_instance,    // (capacity)
    __global const float *miss_t,          // (capacity)
    __global const float *miss_direction,  // (3, capacity)
    __global const float *miss_cone,       // (2, capacity) or null
    __global const uint *miss_target,      // (capacity)
    __global uint *miss_stream,            // (n)
    __global float *ray_direction,         // (3, n)
    __global float *ray_length,            // (n)
    __global float *hit_t,                 // (n)
    __global float *hit_uv,                // (2, n)
    __global uint *hit_primitive,          // (n)
    __global uint *hit_instance,           // (n)
    __global float *density,               // (n) or null
    __global float *cone,                  // (2, n) or null
    __global float *shadow_length,         // (n) or null
    __global uint *path,                   // (n)
    __global uint *alive,                  // (chunks)
    uint n,
    uint capacity,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    bool is_there = i < entries;
    uint at = is_there ? first + i : first;
    miss_stream[i] = STREAM + miss_target[at];
    store_planes(ray_direction, n, i, load_vec3(miss_direction, capacity, at));
    ray_length[i] = is_there ? INFINITY : 0.0f;
    hit_t[i] = miss_t[at];
    hit_uv[i] = miss_uv[at];
    hit_uv[n + i] = miss_uv[capacity + at];
    hit_primitive[i] = miss_primitive[at];
    hit_instance[i] = is_there ? miss_instance[at] : NONE;
    path[i] = i;
    if (i % CHUNK == 0) alive[i / CHUNK] = entries > i ? min(CHUNK, entries - i) : 0;
#if HAS_DIRECT
    shadow_length[i] = 0.0f;  // shading leaves places without a path as they are
#endif
#if HAS_EMISSION
    density[i] = INFINITY;
#endif
#if HAS_TEXTURES
    cone[i] = miss_cone[at];
    cone[n + i] = miss_cone[capacity + at];
#endif
}

// What the paths brought goes to one of the layers. One work-item per entry of the batch.
__kernel void answer_misses(
    __global const uint *miss_target,  // (capacity)
    __global const float *miss_light,  // (3, n)
    __global float *layer_light,       // (3, pixels)
    __global float *layer_count,       // (pixels)
    uint n,
    uint pixels,
    uint capacity,
    uint layer,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    uint target = miss_target[first + i] - layer * pixels;
    Vec3 light = load_vec3(miss_light, n, i);
    bool is_here = target < pixels, is_finite = fabs(light.x + light.y + light.z) < INFINITY;
    if (is_here) store_planes(layer_light, pixels, target, either3(is_finite, light, all3(0.0f)));
    if (is_here) layer_count[target] = is_finite ? 1.0f : 0.0f;
}
