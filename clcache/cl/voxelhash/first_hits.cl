// Where every frame's first hits are traced anew, one for each pixel: a sample cache of one slot that remembers nothing.

#include "samplecache/groups.cl"
#include "scene/first_hit.cl"

#define IN_USE 3u  // the mask of a pixel whose only slot is occupied and visible

// One work-item per path.
__kernel void keep_first_hits(
    __global const uint *pixel,          // (n)
    __global const uint *material,       // (triangles)
    __global const Instance *instances,  // (instances)
    __global const float *ray_direction, // (3, rays)
    __global const float *hit_uv,        // (2, rays)
    __global const uint *hit_primitive,  // (rays)
    __global const uint *hit_instance,   // (rays)
    __global uint *mask,                 // (pixels, 1)
    __global uint *first_hit,            // (1, pixels, 4)
    uint rays,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n || pixel[i] == NONE) return;
    uint instance = hit_instance[i], primitive = hit_primitive[i];
    bool is_far = instance == NONE;
    uint kind = material[is_far ? 0 : instances[instance].first_triangle + primitive];
    FirstHit near = pack_first_hit(hit_uv[i], hit_uv[rays + i], primitive, instance, kind);
    FirstHit far = pack_background(load_vec3(ray_direction, rays, i));
    FirstHit hit = { is_far ? far.x : near.x, is_far ? far.y : near.y, is_far ? far.z : near.z, is_far ? far.w : near.w };
    store_first_hit(first_hit, pixel[i], hit);
    mask[pixel[i]] = IN_USE;
}

// One work-item per pixel: its first hit is also what filters follow from image to image.
__kernel void keep_surface(
    __global const uint *first_hit,  // (1, pixels, 4)
    __global uint *surface,          // (pixels, 4)
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= pixels) return;
    store_first_hit(surface, i, load_first_hit(first_hit, i));
}

// One work-item per group: the list of all pixels but those of the background; each has its own stream of random numbers.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void ask_all(
    __global const uint *pixel,              // (n)
    __global const uint *first_hit,          // (1, pixels, 4)
    __global uint *asked,                    // (pixels)
    __global uint *asked_stream,             // (pixels)
    __global volatile uint *asked_listed,    // (lists)
    uint n,
    uint groups)
{
    uint group = get_global_id(0), count = 0, found[GROUP];
    if (group >= groups) return;
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n); path++) {
        uint here = pixel[path];
        found[count] = here;
        count += here != NONE && first_hit[words_of(here) + 3] != NONE ? 1 : 0;
    }
    uint first = take(asked_listed + 1, count);
    for (uint k = 0; k < count; k++) asked[first + k] = asked_stream[first + k] = found[k];
}
