// The nearest first hit among a frame's samples of a pixel, for filters that follow it from image to image. One work-item per
// path; `nearest` is in the paths' order, `surface` in the pixels'.

#include "scene/first_hit.cl"

// What the sample hit first, where that is nearer than what those before it hit: `nearest` is the depth of that, infinite at
// first. Of pixels in which nothing was hit it is the background in the last sample's direction.
__kernel void nearest_hit(
    __global const uint *pixel,           // (n)
    __global const float *ray_direction,  // (3, n)
    __global const float *hit_t,          // (n)
    __global const float *hit_uv,         // (2, n)
    __global const uint *hit_primitive,   // (n)
    __global const uint *hit_instance,    // (n)
    __global const Instance *instances,   // (instances)
    __global const uint *material,        // (triangles)
    __global float *nearest,              // (n)
    __global uint *surface,               // (pixels, 4)
    Camera camera,
    uint n,
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= n || pixel[i] == NONE) return;
    Vec3 direction = load_vec3(ray_direction, n, i);
    float before = nearest[i], z = hit_t[i] * dot3(forward_of(&camera), direction);
    bool is_far = hit_instance[i] == NONE;
    uint instance = is_far ? 0 : hit_instance[i], primitive = is_far ? 0 : hit_primitive[i];
    uint surface_of = material[instances[instance].first_triangle + primitive];
    FirstHit near = pack_first_hit(hit_uv[i], hit_uv[n + i], primitive, instance, surface_of), far = pack_background(direction);
    if (!(z < before || before == INFINITY)) return;
    nearest[i] = z;
    __global uint *words = surface + 4 * (size_t)pixel[i];
    words[0] = is_far ? far.x : near.x;
    words[1] = is_far ? far.y : near.y;
    words[2] = is_far ? far.z : near.z;
    words[3] = is_far ? far.w : near.w;
}
