// Slots for reprojected samples, the same whatever the order of the threads. Each pixel's arrivals are linked into a chain,
// which one work-item then goes through: it keeps the first of them by (visible before invisible, number in the cache of the
// last frame), in this order, in slots 0, 1, 2 ... What does not find a place is lost. As opposed to the variants of the paper
// (reserve.cl) there is one atomic operation for each sample, and only one work-item writes to a pixel.
//
// With ISRT a sample's slot is its place within the pixel; the first to arrive there, by the same order, is kept.
//
// Defines: ISRT, COUNT_DROPPED, COUNT_STOLEN, COUNT_OVERFLOW (places in `counters`), those of moved.cl.

#include "samplecache/groups.cl"
#include "samplecache/moved.cl"

// Put each listed sample at the front of its target's chain: `latest` is where a pixel's begins; the target of each sample
// becomes the next of its chain; NONE ends it. One work-item per run of the list. Samples without a target are counted.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void link_arrivals(
    __global uint *target,             // (capacity)
    __global volatile uint *latest,    // (pixels)
    __global volatile uint *counters,  // (counters)
    uint pixels,
    uint length)
{
    uint begin = get_global_id(0) * RUN, dropped = 0;
    if (begin >= length) return;
    for (uint i = begin; i < min(begin + RUN, length); i++) {
        uint place = target[i];
        if (place < pixels)
            target[i] = atomic_xchg(latest + place, i);
        else
            dropped++;
    }
    if (dropped > 0) atomic_add(counters + COUNT_DROPPED, dropped);
}

// What arrived in a pixel: the chain that begins at `first`.
typedef struct Arrivals {
    __global const uint *samples, *next;
    __global const uchar *cell;
    uint first;
} Arrivals;

// The samples that are kept, by slot, each as what it is chosen by, the lower winning: its entry's bits, the visible bit
// inverted, and where in the list it is.
typedef struct Kept {
    ulong sample[SLOTS];
    uint occupied, lost, stolen;
} Kept;

inline ulong as_kept(uint sample, uint i)
{
    return (ulong)(sample ^ IS_VISIBLE) << 32 | i;
}

inline uint sample_of(ulong kept)
{
    return (uint)(kept >> 32) ^ IS_VISIBLE;
}

#if ISRT

// Each to its own slot.
inline void choose_slots(const Arrivals *arrivals, const Caches *caches, uint pixels, uint place, Kept *kept)
{
    uint lost = 0, had_visible = 0, had_invisible = 0, occupied = 0;
    for (uint i = arrivals->first; i != NONE; i = arrivals->next[i]) {
        uint sample = arrivals->samples[i], slot = arrivals->cell[i], bit = 1u << slot;
        expect_move(caches, sample & ~IS_VISIBLE, slot * pixels + place);
        bool is_free = (occupied & bit) == 0;
        ulong here = is_free ? as_kept(~IS_VISIBLE, NONE) : kept->sample[slot];
        kept->sample[slot] = min(here, as_kept(sample, i));
        lost += is_free ? 0 : 1;
        occupied |= bit;
        had_visible |= (sample & IS_VISIBLE) != 0 ? bit : 0;
        had_invisible |= (sample & IS_VISIBLE) == 0 ? bit : 0;
    }
    kept->occupied = occupied;
    kept->lost = lost;
    kept->stolen = popcount(had_visible & had_invisible);
}

#else

// The first SLOTS of them, in order: by insertion, since they are few; of thousands, most are compared with the last one only.
inline void choose_slots(const Arrivals *arrivals, const Caches *caches, uint pixels, uint place, Kept *kept)
{
    uint arrived = 0, visible = 0, count = 0;
    for (uint i = arrivals->first; i != NONE; i = arrivals->next[i]) {
        uint sample = arrivals->samples[i];
        ulong rest = as_kept(sample, i);
        arrived++;
        visible += (sample & IS_VISIBLE) != 0 ? 1 : 0;
        if (count == SLOTS && rest > kept->sample[SLOTS - 1]) continue;
        expect_move(caches, sample & ~IS_VISIBLE, min(count, SLOTS - 1u) * pixels + place);
        for (uint slot = 0; slot < count; slot++) {
            ulong here = kept->sample[slot];
            kept->sample[slot] = min(here, rest);
            rest = max(here, rest);
        }
        if (count < SLOTS) kept->sample[count++] = rest;
    }
    // Those count as stolen that would have had a slot before the visible samples came, all invisible ones having come first.
    uint invisible = min(arrived - visible, (uint)SLOTS), invisible_kept = count - min(visible, count);
    kept->occupied = (uint)((1ul << count) - 1);
    kept->lost = arrived - count;
    kept->stolen = arrived > SLOTS ? invisible - invisible_kept : 0;
}

#endif

// Copy what is kept into the pixels' slots, with the pixels' masks and the nearest and farthest of their visible samples. One
// work-item per run of pixels, along the rows.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void place_arrivals(
    __global const uint *latest,            // (pixels)
    __global const uint *samples,           // (capacity)
    __global const uint *target,            // (capacity)
    __global const float *distance,         // (capacity)
    __global const float *slope,            // (capacity)
    __global const uchar *cell,             // (capacity) or null
    __global const uint *first_hit_before,  // (slots, pixels, 4)
    __global const uint *shading_before,    // (slots, pixels, 4) or null
    __global uint *mask,                    // (pixels, words)
    __global uint *first_hit,               // (slots, pixels, 4)
    __global uint *shading,                 // (slots, pixels, 4) or null
    __global ulong *nearest,                // (pixels)
    __global uint *farthest,                // (pixels)
    __global volatile uint *counters,       // (counters)
    uint pixels)
{
    uint begin = get_global_id(0) * RUN;
    Caches caches = { first_hit_before, shading_before, first_hit, shading };
    uint lost = 0, stolen = 0;
    for (uint place = begin; place < min(begin + RUN, pixels); place++) {
        Arrivals arrivals = { samples, target, cell, latest[place] };
        Kept kept;
        choose_slots(&arrivals, &caches, pixels, place, &kept);
        uint visible = 0, far = 0;
        ulong near = NO_NEAREST;
        for (uint left = kept.occupied; left != 0; left &= left - 1) {
            uint slot = lowest_bit(left), sample = sample_of(kept.sample[slot]), i = (uint)kept.sample[slot];
            move_sample(&caches, sample & ~IS_VISIBLE, slot * pixels + place);
            if ((sample & IS_VISIBLE) == 0) continue;
            visible |= 1u << slot;
            near = min(near, nearness(distance[i], slope[i]));
            far = max(far, as_uint(distance[i]));
        }
        store_mask(mask, place, make_mask(kept.occupied, visible));
        nearest[place] = near;
        farthest[place] = far;
        lost += kept.lost;
        stolen += kept.stolen;
    }
    if (lost > stolen) atomic_add(counters + COUNT_OVERFLOW, lost - stolen);
    if (stolen > 0) atomic_add(counters + COUNT_STOLEN, stolen);
}
