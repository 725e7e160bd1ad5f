// The first hits of a list of samples, as if rays from the eye had just found them: for what their materials' graphs say. One work-item
// per entry.

#include "common/camera.cl"
#include "pathtrace/queue.cl"
#include "scene/first_hit.cl"

__kernel void list_hits(
    __global const float *positions,     // (vertices, 3)
    __global const uint *triangles,      // (triangles, 3)
    __global const Instance *instances,  // (instances)
    __global const uint *first_hit,      // (slots, pixels, 4)
    __global const uint *samples,        // (capacity)
    __global float *ray_direction,       // (3, n)
    __global float *ray_length,          // (n)
    __global float *hit_t,               // (n)
    __global float *hit_uv,              // (2, n)
    __global uint *hit_primitive,        // (n)
    __global uint *hit_instance,         // (n)
    __global float *cone,                // (2, n)
    __global uint *alive,                // (chunks)
    Camera camera,
    uint n,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint sample = i < entries ? samples[first + i] : NONE;
    bool is_there = sample != NONE;
    FirstHit hit = load_first_hit(first_hit, is_there ? sample : 0);
    is_there = is_there && !is_background(hit);
    hit.w = is_there ? hit.w : 0;
    hit.z = is_there ? hit.z : 0;
    Geometry geometry = { positions, triangles, instances };
    Vec3 towards = sub3(locate(&geometry, hit).point, eye_of(&camera)), direction = normalize3(towards);
    store_planes(ray_direction, n, i, direction);
    ray_length[i] = is_there ? INFINITY : 0.0f;
    hit_t[i] = dot3(towards, direction);
    hit_uv[i] = unpack_u(hit);
    hit_uv[n + i] = unpack_v(hit);
    hit_primitive[i] = hit.z;
    hit_instance[i] = is_there ? hit.w : NONE;
    cone[i] = 0.0f;
    cone[n + i] = pixel_spread(&camera);
    if (i % CHUNK == 0) alive[i / CHUNK] = entries > i ? min(CHUNK, entries - i) : 0;
}
