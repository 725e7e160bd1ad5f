// The first hit of the nearest visible sample of each pixel, for filters that follow it from image to image. Distances are found
// over the list of visible samples, in batches; then each group keeps the least.
//
// Defines: those of mask.cl.

#include "common/camera.cl"
#include "samplecache/groups.cl"
#include "samplecache/mask.cl"
#include "scene/first_hit.cl"

// One work-item per pixel: the background behind its centre, for where no sample is visible.
__kernel void clear_surface(
    __global uint *surface,  // (pixels, 4)
    Camera camera,
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= pixels) return;
    int row, column;
    place_of_pixel(i, camera.width, &row, &column);
    FirstHit far = pack_background(through_pixel(&camera, (float)column + 0.5f, (float)row + 0.5f));
    __global uint *words = surface + words_of(i);
    words[0] = far.x;
    words[1] = far.y;
    words[2] = far.z;
    words[3] = far.w;
}

// One work-item per entry: the depth along the camera's axis; that of the background is infinite.
__kernel void measure(
    __global const float *positions,     // (vertices, 3)
    __global const uint *triangles,      // (triangles, 3)
    __global const Instance *instances,  // (instances)
    __global const uint *first_hit,      // (slots, pixels, 4)
    __global const uint *samples,        // (capacity)
    __global float *sample_distance,     // (n)
    Camera camera,
    uint n,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    uint sample = samples[first + i];
    bool is_there = sample != NONE;
    FirstHit hit = load_first_hit(first_hit, is_there ? sample : 0);
    bool is_far = is_background(hit) || !is_there;
    hit.w = is_far ? 0 : hit.w;
    hit.z = is_far ? 0 : hit.z;
    Geometry geometry = { positions, triangles, instances };
    Vec3 towards = sub3(locate(&geometry, hit).point, eye_of(&camera));
    sample_distance[i] = is_far ? INFINITY : dot3(forward_of(&camera), towards);
}

// One work-item per group; those whose part of the list is in this batch do something. Of samples at one distance it is the
// first, so that the result does not depend on the order of the list's groups.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void keep_nearest(
    __global const uint *pixel,             // (n_paths)
    __global const uint *mask,              // (pixels, words)
    __global const uint *first_hit,         // (slots, pixels, 4)
    __global const uint *samples,           // (capacity)
    __global const uint *group_first,       // (groups)
    __global const uint *group_count,       // (groups)
    __global const float *sample_distance,  // (n)
    __global uint *surface,                 // (pixels, 4)
    uint n_paths,
    uint n,
    uint groups,
    uint first)
{
    uint group = get_global_id(0);
    if (group >= groups || group_count[group] == 0) return;
    if (group_first[group] < first || group_first[group] >= first + n) return;
    uint i = group_first[group] - first;
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n_paths); path++) {
        uint here = pixel[path];
        uint end = i + (here == NONE ? 0 : popcount(visible_slots(load_mask(mask, here)))), nearest = i;
        if (i == end) continue;
        for (; i < end; i++) nearest = sample_distance[i] < sample_distance[nearest] ? i : nearest;
        store_first_hit(surface, here, load_first_hit(first_hit, samples[first + nearest]));
    }
}
