// Reprojection without any choice of slots, by which the cost of that choice is judged: each sample is stored where it appears,
// whatever else is there. One work-item per run of the list.
//
// Defines: those of moved.cl.

#include "samplecache/moved.cl"

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void store_samples(
    __global const uint *samples,           // (capacity)
    __global const uint *target,            // (capacity)
    __global const uint *first_hit_before,  // (slots, pixels, 4)
    __global const uint *shading_before,    // (slots, pixels, 4) or null
    __global uint *first_hit,               // (slots, pixels, 4)
    __global uint *shading,                 // (slots, pixels, 4) or null
    uint pixels,
    uint length)
{
    uint begin = get_global_id(0) * RUN;
    if (begin >= length) return;
    Caches caches = { first_hit_before, shading_before, first_hit, shading };
    for (uint i = begin; i < min(begin + RUN, length); i++)
        if (target[i] < pixels) move_sample(&caches, samples[i] & ~IS_VISIBLE, target[i]);
}
