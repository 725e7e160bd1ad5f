// What of a sample goes from the cache of the last frame into that of this one, and what a pixel keeps of its visible samples'
// distances (SampleCache, sections 3.1 and 3.4).
//
// Defines: HAS_RADIANCE (samples carry radiance), and those of mask.cl.

#include "samplecache/groups.cl"
#include "samplecache/mask.cl"

// In a list of samples that are reprojected: the sample is visible. The rest of an entry is slot * pixels + pixel.
#define IS_VISIBLE 0x80000000u

#define NO_NEAREST 0xFFFFFFFFFFFFFFFFul  // of a pixel without a visible sample

// Bits of a positive number, which are ordered as the numbers are: the nearest distance with its slope, the farthest.
inline ulong nearness(float distance, float slope)
{
    return (ulong)as_uint(distance) << 32 | as_uint(slope);
}

// The radiance's word with count and age: one frame older. The oldest stay as they are.
inline uint aged(uint count_and_age)
{
    return count_and_age < 0xFFFF0000u ? count_and_age + 0x10000u : count_and_age;
}

// Both caches' data.
typedef struct Caches {
    __global const uint *first_hit_before;  // (slots, pixels, 4)
    __global const uint *shading_before;    // (slots, pixels, 4)
    __global uint *first_hit;               // (slots, pixels, 4)
    __global uint *shading;                 // (slots, pixels, 4)
} Caches;

// Copy a sample's data; `from` and `to` are slot * pixels + pixel.
inline void move_sample(const Caches *caches, uint from, uint to)
{
    vstore4(vload4(from, caches->first_hit_before), to, caches->first_hit);
#if HAS_RADIANCE
    uint4 radiance = vload4(from, caches->shading_before);
    radiance.w = aged(radiance.w);
    vstore4(radiance, to, caches->shading);
#endif
}

// Have the memory ready for that. OpenCL's own prefetch() does nothing on PoCL; Oclgrind does not know the compilers' one, and
// is told NO_PREFETCH.
inline void expect_move(const Caches *caches, uint from, uint to)
{
#if defined(__has_builtin) && !defined(NO_PREFETCH)
    __builtin_prefetch(caches->first_hit_before + 4 * (size_t)from);
    __builtin_prefetch(caches->first_hit + 4 * (size_t)to, 1);
#if HAS_RADIANCE
    __builtin_prefetch(caches->shading_before + 4 * (size_t)from);
    __builtin_prefetch(caches->shading + 4 * (size_t)to, 1);
#endif
#endif
}
