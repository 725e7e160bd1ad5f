// Which samples are shaded in a frame (SampleCache, sections 3.3 and 3.5).
//
// Uniform: one sample of each pixel in turn, where the rate is below 1 of some pixels, by chance. Adaptive: a sample has the importance
// 1 / (1 + count); a histogram of it, in bins of equal ratio between the least and the most of the frame before, says from
// where on all samples are shaded; in the bin in which the rate is used up, each is by chance. One sample of each block of
// pixels is shaded always. The background is not shaded.
//
// The count is that of the values in the whole pixel, those that the frame will add included: a pixel's first sample, in the
// order of their turns, has the count of all of them, the second one more, and so on. In the paper it is the sample's own; but it is
// the pixel's noise that is seen, and by their own counts samples of crowded pixels would be shaded before a lonely one.
//
// Defines: those of mask.cl; HAS_RADIANCE; ADAPTIVE_SHADING; COUNT_OCCUPIED, COUNT_VISIBLE, COUNT_SHADED (places in `counters`;
// what a cache without radiance shades is not decided here).

#include "common/random.cl"
#include "samplecache/dimensions.cl"
#include "samplecache/groups.cl"
#include "samplecache/mask.cl"
#include "samplecache/radiance.cl"

#define BINS 13u
#define BASE_BIN BINS  // of the histogram, behind the others: how many samples are shaded always

// The visible samples of a pixel that can be shaded. kept: the cache's data that say which are of the background: the shading,
// or, of a cache without radiance, the first hits.
inline uint shadable_slots(__global const uint *kept, Mask m, uint here, uint pixels)
{
    uint slots = visible_slots(m);
    for (uint rest = slots; rest; rest &= rest - 1) {
        uint slot = lowest_bit(rest);
#if HAS_RADIANCE
        bool is_far = count_of(kept, slot * pixels + here) == OF_BACKGROUND;
#else
        bool is_far = kept[words_of(slot * pixels + here) + 3] == NONE;
#endif
        if (is_far) slots &= ~(1u << slot);
    }
    return slots;
}

// Samples with more values than this are as unimportant as each other.
#define COUNTS 1024u

// One work-item per count: the bin of its importance. count_range: the least and the most count of the frame before; of
// `next_range` a search for them begins.
__kernel void divide_importance(
    __global const uint *count_range,  // (2)
    __global uint *next_range,         // (2)
    __global uchar *bin_of,            // (counts)
    uint counts)
{
    uint count = get_global_id(0);
    if (count >= counts) return;
    if (count == 0) {
        next_range[0] = COUNTS;
        next_range[1] = 0;
    }
    float least_importance = 1.0f / (1.0f + (float)count_range[1]), most_importance = 1.0f / (1.0f + (float)count_range[0]);
    float above = 1.0f / (1.0f + (float)count) / least_importance, range = most_importance / least_importance;
    float place = range > 1.0f ? log2_of(above) / log2_of(range) : 1.0f;
    bin_of[count] = (uchar)clamp((int)(place * (float)BINS), 0, (int)BINS - 1);
}

// Of each pixel, the samples that can be shaded, a set of slots, and how many values they have together. One work-item per run of
// pixels, along the rows: in this order the layers of the cache are read from front to back.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void find_shadable(
    __global const uint *mask,     // (pixels, words)
    __global const uint *shading,  // (slots, pixels, 4)
    __global uint *shadable,       // (pixels, 2)
    uint pixels)
{
    uint begin = get_global_id(0) * RUN;
    for (uint here = begin; here < min(begin + RUN, pixels); here++) {
        uint slots = 0, counted = 0;
        for (uint rest = visible_slots(load_mask(mask, here)); rest; rest &= rest - 1) {
            uint slot = lowest_bit(rest), count = count_of(shading, slot * pixels + here);
            slots |= count == OF_BACKGROUND ? 0 : 1u << slot;
            counted += count == OF_BACKGROUND ? 0 : count;
        }
        shadable[2 * here] = slots;
        shadable[2 * here + 1] = counted;
    }
}

// One work-item per block of paths: the one of whose pixel a sample is shaded always, that whose turn it is or the next that has
// any, NONE where there is none; count the samples of the others into the bins; find the range of counts for the next frame.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void count_importance(
    __global const uint *pixel,            // (n)
    __global const uint *shadable,         // (pixels, 2)
    __global const uchar *bin_of,          // (known_counts)
    __global volatile uint *count_range,   // (2)
    __global volatile uint *histogram,     // (bins)
    __global uint *base_path,              // (blocks)
    uint n,
    uint blocks,
    uint update)
{
    uint block = get_global_id(0);
    if (block >= blocks) return;
    uint base = NONE, bins[BINS + 1], least = COUNTS, most = 0;
    for (uint bin = 0; bin <= BINS; bin++) bins[bin] = 0;
    for (uint k = 0; k < LANES; k++) {
        uint path = LANES * block + (7 * update + k) % LANES, here = pixel[path];
        uint many = here == NONE ? 0 : popcount(shadable[2 * here]), first = 0;
        if (many == 0) continue;
        uint counted = shadable[2 * here + 1];
        if (base == NONE) {
            base = path;
            first = 1;
        }
        bins[BASE_BIN] += first;
        for (uint sample = first; sample < many; sample++) bins[bin_of[min(counted + sample, COUNTS - 1)]]++;
        least = min(least, min(counted, COUNTS - 1));
        most = max(most, min(counted, COUNTS - 1));
    }
    base_path[block] = base;
    if (base == NONE) return;
    for (uint bin = 0; bin <= BINS; bin++) {
        if (bins[bin]) atomic_add(histogram + bin, bins[bin]);
    }
    atomic_min(count_range, least);
    atomic_max(count_range + 1, most);
}

typedef struct Threshold {
    uint bin;      // those above are shaded
    float chance;  // of those in it
} Threshold;

inline Threshold find_threshold(__global const uint *histogram, float budget)
{
    float rest = budget - (float)histogram[BASE_BIN];
    for (uint bin = BINS; bin-- > 0;) {
        float here = (float)histogram[bin];
        if (here > rest) {
            Threshold found = { bin, fmax(rest, 0.0f) / here };
            return found;
        }
        rest -= here;
    }
    Threshold all = { 0, 1.0f };
    return all;
}

// Of a block of paths, which begins at `first`, the one of whose pixel a sample is shaded always: that whose turn it is, or the next
// that has any; NONE where there is none.
inline uint find_base(__global const uint *pixel, __global const uint *mask, __global const uint *kept, uint pixels, uint first,
                      uint update)
{
    for (uint k = 0; k < LANES; k++) {
        uint path = first + (7 * update + k) % LANES, here = pixel[path];
        if (here != NONE && shadable_slots(kept, load_mask(mask, here), here, pixels)) return path;
    }
    return NONE;
}

// One work-item per group: the list of what is shaded; to each sample the stream of random numbers that its path takes: those of
// the pixel for the pixel's first one. So the numbers that a pixel's samples take together are well spread, rather than those of one.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void choose(
    __global const uint *pixel,          // (n)
    __global const uint *mask,           // (pixels, words)
    __global const uint *shading,        // (slots, pixels, 4) or null
    __global const uint *first_hit,      // (slots, pixels, 4) or null
    __global const uchar *bin_of,        // (known_counts) or null
    __global const uint *histogram,      // (bins) or null
    __global const uint *base_path,      // (blocks) or null
    __global const uint *shadable,       // (pixels, 2) or null
    __global uint *shaded,               // (capacity)
    __global uint *stream,               // (capacity)
    __global volatile uint *listed,      // (lists)
    __global volatile uint *counters,    // (counts)
    uint n,
    uint pixels,
    uint groups,
    float rate,
    uint update,
    uint key0,
    uint key1)
{
    uint group = get_global_id(0);
    if (group >= groups) return;
#if HAS_RADIANCE
    __global const uint *kept = shading;
#else
    __global const uint *kept = first_hit;
#endif
    uint chosen[GROUP * SLOTS], streams[GROUP * SLOTS], visible = 0, count = 0, occupied = 0, base = NONE;
#if ADAPTIVE_SHADING
    Threshold threshold = find_threshold(histogram, rate * (float)pixels);
#endif
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n); path++) {
        uint here = pixel[path];
#if !ADAPTIVE_SHADING
        if (path % LANES == 0 && rate < 1.0f) base = find_base(pixel, mask, kept, pixels, path, update);
#endif
        if (here == NONE) continue;
        Mask m = load_mask(mask, here);
        occupied += popcount(occupied_slots(m));
        visible += popcount(visible_slots(m));
        uint slots = 0;
#if ADAPTIVE_SHADING
        uint all = shadable[2 * here], counted = shadable[2 * here + 1], many = popcount(all);
        bool is_base = base_path[path / LANES] == path;
        uint turn = is_base ? update / LANES : update;  // whose turn it is to be the base, comes back after so many updates
        Random coins;
        for (uint k = 0; k < many; k++) {
            uint bin = bin_of[min(counted + k, COUNTS - 1)];
            if (bin < threshold.bin && k > 0) break;
            if (k % 4 == 0) coins = random4(here, update, DIMENSION_COIN + k / 4, key0, key1);
            float coin = k % 4 < 2 ? (k % 4 == 0 ? coins.x : coins.y) : k % 4 == 2 ? coins.z : coins.w;
            bool is_shaded = (is_base && k == 0) || bin > threshold.bin || (bin == threshold.bin && coin < threshold.chance);
            if (is_shaded) slots |= 1u << nth_bit(all, (turn + k) % many);
        }
#else
        float chance = rate < 1.0f ? (rate * (float)LANES - 1.0f) / (float)(LANES - 1) : 1.0f;
        bool is_chosen = path == base || chance >= 1.0f || random4(here, update, DIMENSION_COIN, key0, key1).x < chance;
        if (is_chosen) slots = round_robin(shadable_slots(kept, m, here, pixels), path == base ? update / LANES : update);
#endif
        for (uint k = 0; slots; slots &= slots - 1, k++) {
            chosen[count] = lowest_bit(slots) * pixels + here;
            streams[count++] = k * pixels + here;
        }
    }
    uint first = take(listed + 1, count);
    for (uint i = 0; i < count; i++) {
        shaded[first + i] = chosen[i];
        stream[first + i] = streams[i];
    }
    if (occupied) atomic_add(counters + COUNT_OCCUPIED, occupied);
    if (visible) atomic_add(counters + COUNT_VISIBLE, visible);
#if HAS_RADIANCE
    if (count) atomic_add(counters + COUNT_SHADED, count);
#endif
}
