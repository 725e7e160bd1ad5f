// Slots for reprojected samples as the paper gives them away (SampleCache, section 3.1): whoever sets a slot's bits in the
// pixel's mask first has it; the lowest free one, and where none is free, a visible sample takes the lowest of those whose
// sample is invisible.
//
// In a single pass (Listing 2) the sample is written at once. Two races are known. A visible sample may take the slot of an
// invisible one that is not written yet, and the invisible one is written over it later; and where two samples are written to a
// slot at once, each may leave a part. Then the slot's visibility or radiance is not that of its first hit.
//
// In two passes only the sample's place in the list is written, as one word, and everything else is read from there afterwards:
// whichever of two samples is the last, all of the slot is its. Reservation is by compare-and-exchange, since the atomic OR
// can take the slot of an invisible sample that was free when it was looked at, though others still are.
//
// With ISRT a sample's only slot is its place within the pixel.
//
// Defines: ISRT, COUNT_DROPPED, COUNT_STOLEN, COUNT_OVERFLOW (places in `counters`), those of moved.cl.

#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable

#include "samplecache/groups.cl"
#include "samplecache/moved.cl"

#if WORDS == 2
#define MASK_OR atom_or
#define MASK_COMPARE_EXCHANGE atom_cmpxchg
#else
#define MASK_OR atomic_or
#define MASK_COMPARE_EXCHANGE atomic_cmpxchg
#endif

typedef enum Outcome {
    FAILED,
    RESERVED,
    STOLEN,  // reserved, but an invisible sample loses it
} Outcome;

// Slots that a sample can have, one bit each: those that are free; where there are none, for a visible sample, those of
// invisible ones.
inline uint available_slots(Mask m, bool is_visible, uint allowed)
{
    uint vacant = allowed & ~occupied_slots(m), invisible = is_visible ? allowed & ~visible_slots(m) : 0;
    return vacant != 0 ? vacant : invisible;
}

inline uint allowed_slots(__global const uchar *cell, uint i)
{
#if ISRT
    return 1u << cell[i];
#else
    return ALL_SLOTS;
#endif
}

inline Mask bits_of(uint slot, bool is_visible)
{
    return make_mask(1u << slot, is_visible ? 1u << slot : 0);
}

inline Outcome outcome_of(Mask before, uint slot, bool is_visible)
{
    if ((occupied_slots(before) >> slot & 1) == 0) return RESERVED;
    return is_visible && (visible_slots(before) >> slot & 1) == 0 ? STOLEN : FAILED;
}

// Listing 2. What the mask was before goes to *m; where the slot was not to be had, it still is that.
inline Outcome reserve_by_or(volatile __global Mask *mask, uint slot, bool is_visible, Mask *m)
{
    *m = MASK_OR(mask, bits_of(slot, is_visible));
    return outcome_of(*m, slot, is_visible);
}

// The same if the mask still is *m. That it is not anymore can happen but so often as it has bits to be set.
inline Outcome reserve_by_exchange(volatile __global Mask *mask, uint slot, bool is_visible, Mask *m)
{
    Mask expected = *m;
    *m = MASK_COMPARE_EXCHANGE(mask, expected, expected | bits_of(slot, is_visible));
    return *m == expected ? outcome_of(expected, slot, is_visible) : FAILED;
}

// Try slots until one is reserved, or none is left that the sample could have. compared: by exchange, else as in Listing 2.
inline Outcome take_slot(volatile __global Mask *mask, bool is_visible, uint allowed, bool compared, uint *slot)
{
    Mask m = *mask;
    Outcome outcome = FAILED;
    uint available;
    while (outcome == FAILED && (available = available_slots(m, is_visible, allowed)) != 0) {
        *slot = lowest_bit(available);
        outcome = compared ? reserve_by_exchange(mask, *slot, is_visible, &m) : reserve_by_or(mask, *slot, is_visible, &m);
    }
    return outcome;
}

inline void add_losses(volatile __global uint *counters, uint dropped, uint overflow, uint stolen)
{
    if (dropped > 0) atomic_add(counters + COUNT_DROPPED, dropped);
    if (overflow > 0) atomic_add(counters + COUNT_OVERFLOW, overflow);
    if (stolen > 0) atomic_add(counters + COUNT_STOLEN, stolen);
}

// One work-item per run of the list.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void single_pass(
    __global const uint *samples,           // (capacity)
    __global const uint *target,            // (capacity)
    __global const float *distance,         // (capacity)
    __global const float *slope,            // (capacity)
    __global const uchar *cell,             // (capacity) or null
    __global const uint *first_hit_before,  // (slots, pixels, 4)
    __global const uint *shading_before,    // (slots, pixels, 4) or null
    __global volatile uint *mask,           // (pixels, words)
    __global uint *first_hit,               // (slots, pixels, 4)
    __global uint *shading,                 // (slots, pixels, 4) or null
    __global volatile ulong *nearest,       // (pixels)
    __global volatile uint *farthest,       // (pixels)
    __global volatile uint *counters,       // (counters)
    uint pixels,
    uint length)
{
    uint begin = get_global_id(0) * RUN, dropped = 0, overflow = 0, stolen = 0;
    if (begin >= length) return;
    Caches caches = { first_hit_before, shading_before, first_hit, shading };
    for (uint i = begin; i < min(begin + RUN, length); i++) {
        uint place = target[i], from = samples[i] & ~IS_VISIBLE;
        bool is_visible = (samples[i] & IS_VISIBLE) != 0;
        if (place >= pixels) {
            dropped++;
            continue;
        }
        volatile __global Mask *word = (volatile __global Mask *)mask + place;
        uint slot;
        Outcome outcome = take_slot(word, is_visible, allowed_slots(cell, i), false, &slot);
        overflow += outcome == FAILED ? 1 : 0;
        stolen += outcome == STOLEN ? 1 : 0;
        if (outcome == FAILED) continue;
        move_sample(&caches, from, slot * pixels + place);
        if (!is_visible) continue;
        atom_min(nearest + place, nearness(distance[i], slope[i]));
        atomic_max(farthest + place, as_uint(distance[i]));
    }
    add_losses(counters, dropped, overflow, stolen);
}

// The first of two passes: `address` is which of the listed samples a slot is to have. One work-item per run of the list.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void reserve(
    __global const uint *samples,      // (capacity)
    __global const uint *target,       // (capacity)
    __global const uchar *cell,        // (capacity) or null
    __global volatile uint *mask,      // (pixels, words)
    __global uint *address,            // (slots, pixels)
    __global volatile uint *counters,  // (counters)
    uint pixels,
    uint length)
{
    uint begin = get_global_id(0) * RUN, dropped = 0, overflow = 0, stolen = 0;
    if (begin >= length) return;
    for (uint i = begin; i < min(begin + RUN, length); i++) {
        uint place = target[i];
        bool is_visible = (samples[i] & IS_VISIBLE) != 0;
        if (place >= pixels) {
            dropped++;
            continue;
        }
        volatile __global Mask *word = (volatile __global Mask *)mask + place;
        uint slot;
        Outcome outcome = take_slot(word, is_visible, allowed_slots(cell, i), true, &slot);
        overflow += outcome == FAILED ? 1 : 0;
        stolen += outcome == STOLEN ? 1 : 0;
        if (outcome != FAILED) address[slot * pixels + place] = i;
    }
    add_losses(counters, dropped, overflow, stolen);
}

// The second: copy what the addresses say, visibility included. One work-item per run of pixels, along the rows.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void copy_reserved(
    __global const uint *samples,           // (capacity)
    __global const float *distance,         // (capacity)
    __global const float *slope,            // (capacity)
    __global const uint *address,           // (slots, pixels)
    __global const uint *first_hit_before,  // (slots, pixels, 4)
    __global const uint *shading_before,    // (slots, pixels, 4) or null
    __global uint *mask,                    // (pixels, words)
    __global uint *first_hit,               // (slots, pixels, 4)
    __global uint *shading,                 // (slots, pixels, 4) or null
    __global ulong *nearest,                // (pixels)
    __global uint *farthest,                // (pixels)
    uint pixels)
{
    uint begin = get_global_id(0) * RUN;
    Caches caches = { first_hit_before, shading_before, first_hit, shading };
    for (uint place = begin; place < min(begin + RUN, pixels); place++) {
        uint occupied = occupied_slots(load_mask(mask, place)), visible = 0, far = 0;
        ulong near = NO_NEAREST;
        for (uint left = occupied; left != 0; left &= left - 1) {
            uint slot = lowest_bit(left), to = slot * pixels + place, i = address[to];
            move_sample(&caches, samples[i] & ~IS_VISIBLE, to);
            if ((samples[i] & IS_VISIBLE) == 0) continue;
            visible |= 1u << slot;
            near = min(near, nearness(distance[i], slope[i]));
            far = max(far, as_uint(distance[i]));
        }
        store_mask(mask, place, make_mask(occupied, visible));
        nearest[place] = near;
        farthest[place] = far;
    }
}
