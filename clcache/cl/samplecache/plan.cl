// What is to be done about the samples of each pixel after reprojection (SampleCache, sections 3.2 and 3.4): which are traced
// again, and where samples are added or purged so that their density stays near the target.
//
// Defines: those of mask.cl; TRACING: SINGLE, MULTI or ADAPTIVE; ISRT: slots are cells of the pixel; COUNT_CREATED, COUNT_PURGED,
// COUNT_RETRACED (places in `counters`).

#include "common/camera.cl"
#include "common/random.cl"
#include "samplecache/dimensions.cl"
#include "samplecache/groups.cl"
#include "samplecache/mask.cl"
#include "samplecache/sample.cl"

#define SINGLE 0
#define MULTI 1
#define ADAPTIVE 2

#define EDGE_TOLERANCE 0.005f  // epsilon_1 of inequality 2
// How many slopes the farthest sample may lie behind the nearest. The paper has two, for the angle between a ray in the centre and
// one in another pixel; but the nearest sample may lie at one edge of the three pixels and the farthest at the other, and on the
// far side of a slope distances grow faster than Eq. 1, which looks to the near side, has it.
#define SLOPES 4.0f

typedef struct Around {
    uint occupied;   // samples of the 3 x 3 pixels; beyond the image's edge those at the edge stand in
    ulong nearest;
    uint farthest;
} Around;

INLINED void add_neighbour(Around *around, __global const uint *mask, __global const ulong *nearest, __global const uint *farthest,
                           int column, int row, uint width, uint height)
{
    uint pixel = (uint)clamp(row, 0, (int)height - 1) * width + (uint)clamp(column, 0, (int)width - 1);
    around->occupied += popcount(occupied_slots(load_mask(mask, pixel)));
#if TRACING == ADAPTIVE
    ulong key = nearest[pixel];
    around->nearest = key < around->nearest ? key : around->nearest;
    uint far = farthest[pixel];
    around->farthest = far > around->farthest ? far : around->farthest;
#endif
}

// Inequality 2 over the neighbourhood's visible samples; Eq. 1's slope is that of the nearest. All of it background is flat, and
// nothing visible is not.
inline bool is_flat(const Around *around)
{
    float t_min = as_float((uint)(around->nearest >> 32)), slope = as_float((uint)around->nearest);
    float t_max = as_float(around->farthest);
    bool is_known = around->farthest != 0;
    return is_known && (t_min == INFINITY || t_max < (1.0f + EDGE_TOLERANCE) * (t_min + SLOPES * slope));
}

// One work-item per pixel. A density that is off by less than one sample is put right with that probability, so that pixels
// that all see the same lack do not make up for it ninefold; where the band is a sample wide or more, that is harmless.
__kernel void assess(
    __global const uint *mask,       // (pixels, words)
    __global const ulong *nearest,   // (pixels) or null
    __global const uint *farthest,   // (pixels) or null
    __global uchar *plan,            // (pixels)
    Camera camera,
    uint pixels,
    float least,
    float most,
    uint update,
    uint key0,
    uint key1)
{
    uint pixel = get_global_id(0);
    if (pixel >= pixels) return;
    uint width = camera.width, height = camera.height;
    int row, column;
    place_of_pixel(pixel, width, &row, &column);
    Around around = { 0, ~0ul, 0 };
    add_neighbour(&around, mask, nearest, farthest, column - 1, row - 1, width, height);
    add_neighbour(&around, mask, nearest, farthest, column, row - 1, width, height);
    add_neighbour(&around, mask, nearest, farthest, column + 1, row - 1, width, height);
    add_neighbour(&around, mask, nearest, farthest, column - 1, row, width, height);
    add_neighbour(&around, mask, nearest, farthest, column, row, width, height);
    add_neighbour(&around, mask, nearest, farthest, column + 1, row, width, height);
    add_neighbour(&around, mask, nearest, farthest, column - 1, row + 1, width, height);
    add_neighbour(&around, mask, nearest, farthest, column, row + 1, width, height);
    add_neighbour(&around, mask, nearest, farthest, column + 1, row + 1, width, height);
    float density = (float)(int)around.occupied / 9.0f, band = most - least;
    float chance = random4(pixel, update, DIMENSION_DENSITY, key0, key1).x;
    Mask m = load_mask(mask, pixel);
    bool add = chance < least - density + (density < least ? band : 0.0f) || occupied_slots(m) == 0;
    bool purge = chance < density - most + (density > most ? band : 0.0f);
    bool edge = false;
#if TRACING == ADAPTIVE
    edge = !is_flat(&around);
#endif
    plan[pixel] = (edge ? IS_EDGE : 0u) | (add ? ADD : 0u) | (purge ? PURGE : 0u);
}

// One of a pixel's samples, but not the only one, nor the only visible one.
inline Mask purge_sample(Mask m, float random)
{
    uint occupied = occupied_slots(m), visible = visible_slots(m);
    uint candidates = popcount(visible) == 1 ? occupied & ~visible : occupied;
    uint count = popcount(candidates);
    if (count == 0 || popcount(occupied) == 1) return m;
    uint gone = 1u << nth_bit(candidates, min((uint)(random * (float)count), count - 1));
    return make_mask(occupied & ~gone, visible & ~gone);
}

// The slot for a new sample: a free one, or that of a sample that is not visible; a set of one slot, or of none.
inline uint slot_for_new(Mask m, float random)
{
    uint occupied = occupied_slots(m), unseen = occupied & ~visible_slots(m), free = ALL_SLOTS & ~occupied;
    uint from = free ? free : unseen;
    if (!from) return 0;
#if ISRT
    uint count = popcount(from);  // a slot is a place in the pixel
    return 1u << nth_bit(from, min((uint)(random * (float)count), count - 1));
#else
    return 1u << lowest_bit(from);
#endif
}

// Which of a pixel's samples are traced again. One alone is of those that are seen, which may do harm, three times in four.
inline uint choose_traced(Mask m, uint decided, uint lane, uint update)
{
    uint occupied = occupied_slots(m);
    if (TRACING == MULTI || visible_slots(m) == 0) return occupied;
    if (TRACING == SINGLE)
        return update % 4 < 3 ? round_robin(visible_slots(m), update - update / 4) : round_robin(occupied, update / 4);
    if (decided & IS_EDGE) return occupied;
    return lane == 7 * update % LANES ? round_robin(occupied, update / LANES) : 0;  // each pixel of a block once in 16 updates
}

// One work-item per group. Carries out what `assess` decided; writes the list of what is to be traced, samples of a pixel
// together and in the order of slots, and where in it the group's part is.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void list_traced(
    __global const uint *pixel,          // (n)
    __global uint *mask,                 // (pixels, words)
    __global const uchar *plan,          // (pixels)
    __global uint *samples,              // (capacity)
    __global volatile uint *listed,      // (lists)
    __global uint *group_first,          // (groups)
    __global uint *group_count,          // (groups)
    __global float *aov_trace,           // (pixels) or null
    __global volatile uint *counters,    // (counts)
    uint n,
    uint pixels,
    uint groups,
    uint batch,
    uint update,
    uint key0,
    uint key1)
{
    uint group = get_global_id(0);
    if (group >= groups) return;
    uint entries[GROUP * SLOTS], count = 0, created = 0, purged = 0;
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n); path++) {
        uint here = pixel[path];
        if (here == NONE) continue;
        Mask m = load_mask(mask, here);
        uint decided = plan[here], fresh = 0;
        if (decided & (ADD | PURGE)) {
            Random random = random4(here, update, DIMENSION_DENSITY, key0, key1);
            uint before = popcount(occupied_slots(m));
            if (decided & PURGE) m = purge_sample(m, random.y);
            purged += before - popcount(occupied_slots(m));
            if (decided & ADD) {
                fresh = slot_for_new(m, random.y);
                purged += occupied_slots(m) & fresh ? 1 : 0;
                created += fresh ? 1 : 0;
                m = make_mask(occupied_slots(m) & ~fresh, visible_slots(m) & ~fresh);
            }
        }
        uint traced = choose_traced(m, decided, path % LANES, update), occupied = occupied_slots(m);
        if (aov_trace) aov_trace[here] = (float)popcount(traced | fresh) / (float)max(popcount(occupied | fresh), 1u);
        for (uint rest = traced | fresh; rest; rest &= rest - 1) {
            uint slot = lowest_bit(rest);
            entries[count++] = (slot * pixels + here) | (fresh >> slot & 1 ? NEW_SAMPLE : 0u);
        }
        if (decided & (ADD | PURGE)) store_mask(mask, here, make_mask(occupied | fresh, visible_slots(m)));
    }
    uint first = take_together(listed, samples, count, batch);
    for (uint i = 0; i < count; i++) samples[first + i] = entries[i];
    group_first[group] = first;
    group_count[group] = count;
    if (created) atomic_add(counters + COUNT_CREATED, created);
    if (purged) atomic_add(counters + COUNT_PURGED, purged);
    if (count > created) atomic_add(counters + COUNT_RETRACED, count - created);
}
