// The upper part of the binary trees, from the roots down: a range of clusters is divided where the areas of both halves' boxes,
// times their numbers of triangles, are least; candidates are the borders of equal bins between the clusters' middles, along
// each axis (Wald 2007, "On fast Construction of SAH-based Bounding Volume Hierarchies").
//
// A range is begin .. end in an array of Items, which is put in order in place. Long ranges are divided by a work-item each, level by
// level, and their parts listed by the host (`divide_ranges`); short ones to the end by one work-item (`build_ranges`). A division at
// item s makes the pair s, so that none has to be counted. The pairs are completed (`Cluster`) in the opposite order, from below:
// `roots[begin]` is always the root of the longest completed range that begins there.
//
// Define: BINS.

#include "bvh/box.cl"
#include "bvh/cost.cl"

#define TINY 4u             // items of a range that is divided in the middle of its longest axis
#define BALANCED_DEPTH 40u  // divisions of a short range, one below the other, after which the parts are halved by number, for there
                            // are scenes of which bins take off one box at a time
#define WAITING 32u  // ranges that wait in build_ranges: the longer part of each, so they are at most half as long each time

// One work-item per cluster left by cluster.cl.
__kernel void list_items(
    __global const float *planes,      // (6, places)
    __global const uint *cluster,      // (places)
    __global const Cluster *clusters,  // (pairs)
    __global Item *items,              // (n)
    uint places,
    uint n,
    uint boxes)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Box box = load_box_planes(planes, places, RADIUS + i);
    uint number = cluster[RADIUS + i];
    __global Item *item = items + i;
    item->low[0] = box.low.x, item->low[1] = box.low.y, item->low[2] = box.low.z;
    item->minus_high[0] = -box.high.x, item->minus_high[1] = -box.high.y, item->minus_high[2] = -box.high.z;
    item->cluster = number;
    item->triangles = number < boxes ? 1 : clusters[number - boxes].triangles & ~IS_LEAF;
}

// The low sides of an item's box, 0, the negated high sides, 0: one minimum joins two boxes.
inline float8 item_box(__global const Item *item)
{
    float8 box = vload8(0, item->low);
    box.s37 = 0.0f;
    return box;
}

inline float8 least(float8 a, float8 b)
{
    return a < b ? a : b;
}

// Half the area of such a box; 0 where nothing was joined.
inline float joined_area(float8 box)
{
    float4 size = -box.hi - box.lo;
    return size.x >= 0.0f ? size.x * size.y + size.y * size.z + size.z * size.x : 0.0f;
}

// Along one axis, the first bin of the second half. bins: 0 if there is no division.
typedef struct Division {
    uint axis, bin, bins;
    float4 from, scale;
} Division;

// The bins of an item's middle (twice that, as all of this), of which `last` is the highest.
inline int4 item_bins(float8 box, float4 from, float4 scale, float last)
{
    float4 place = (box.lo - box.hi - from) * scale;
    return convert_int4(place < last ? place : (float4)(last));
}

// The best border among the bins along an axis, if its cost is less than `cost`.
inline void compare_borders(const float8 *boxes, const uint *triangles, uint axis, uint bins, float *cost, Division *best)
{
    float behind[BINS];
    float8 box = INFINITY;
    uint count = 0;
    for (uint bin = bins - 1; bin > 0; bin--) {
        box = least(box, boxes[bin]);
        count += triangles[bin];
        behind[bin] = count > 0 ? joined_area(box) * (float)count : INFINITY;
    }
    box = INFINITY;
    count = 0;
    for (uint bin = 1; bin < bins; bin++) {
        box = least(box, boxes[bin - 1]);
        count += triangles[bin - 1];
        float sum = joined_area(box) * (float)count + behind[bin];
        if (count == 0 || !(sum < *cost)) continue;
        *cost = sum;
        best->axis = axis, best->bin = bin, best->bins = bins;
    }
}

inline Division find_division(__global const Item *items, uint begin, uint end)
{
    float4 low = INFINITY, high = -INFINITY;
    for (uint i = begin; i < end; i++) {
        float8 box = item_box(items + i);
        float4 middle = box.lo - box.hi;
        low = middle < low ? middle : low;
        high = middle > high ? middle : high;
    }
    if (end - begin <= TINY) {
        float4 extent = high - low;
        uint axis = extent.x > extent.y ? (extent.x > extent.z ? 0 : 2) : (extent.y > extent.z ? 1 : 2);
        float longest = axis == 0 ? extent.x : axis == 1 ? extent.y : extent.z;
        float4 by = 2.0f / extent;
        Division halves = { axis, 1, longest > 0.0f && 2.0f / longest < INFINITY ? 2 : 0, low, by };
        return halves;
    }
    uint bins = end - begin < 4 * BINS ? BINS / 2 : BINS;
    float4 scale = (float)bins / (high - low);
    scale = scale < INFINITY ? scale : 0.0f;
    float8 boxes[3][BINS];
    uint triangles[3][BINS];
    for (uint axis = 0; axis < 3; axis++)
        for (uint bin = 0; bin < bins; bin++) {
            boxes[axis][bin] = INFINITY;
            triangles[axis][bin] = 0;
        }
    for (uint i = begin; i < end; i++) {
        float8 box = item_box(items + i);
        uint count = items[i].triangles;
        int4 bin = item_bins(box, low, scale, (float)(bins - 1));
        boxes[0][bin.x] = least(boxes[0][bin.x], box);
        boxes[1][bin.y] = least(boxes[1][bin.y], box);
        boxes[2][bin.z] = least(boxes[2][bin.z], box);
        triangles[0][bin.x] += count;
        triangles[1][bin.y] += count;
        triangles[2][bin.z] += count;
    }
    Division best = { 0, 0, 0, low, scale };
    float cost = INFINITY;
    if (scale.x > 0.0f) compare_borders(boxes[0], triangles[0], 0, bins, &cost, &best);
    if (scale.y > 0.0f) compare_borders(boxes[1], triangles[1], 1, bins, &cost, &best);
    if (scale.z > 0.0f) compare_borders(boxes[2], triangles[2], 2, bins, &cost, &best);
    return best;
}

// Put the range in order; where its second half begins.
inline uint divide(__global Item *items, uint begin, uint end, bool halve)
{
    uint middle = begin + (end - begin) / 2;
    if (halve || end - begin == 2) return middle;
    Division division = find_division(items, begin, end);
    if (division.bins == 0) return middle;
    uint first = begin, last = end;
    while (first < last) {
        float8 box = item_box(items + first);
        int4 bins = item_bins(box, division.from, division.scale, (float)(division.bins - 1));
        if ((division.axis == 0 ? bins.x : division.axis == 1 ? bins.y : bins.z) < (int)division.bin) {
            first++;
        } else {
            __global uint *a = (__global uint *)(items + first), *b = (__global uint *)(items + --last);
            uint8 item = vload8(0, a);
            vstore8(vload8(0, b), 0, a);
            vstore8(item, 0, b);
        }
    }
    return first;
}

// The pair of what begins at `begin` and at `middle`. `boxes` and `first_pair`: how many clusters are single boxes, and how many
// pairs there were before.
inline void complete_pair(__global const Item *items, __global uint *roots, __global Cluster *clusters, uint begin, uint middle,
                          uint boxes, uint first_pair, uint leaf_size)
{
    Box halves[2];
    for (uint side = 0; side < 2; side++) {
        uint start = side ? middle : begin;
        float8 box = item_box(items + start);
        Box single = { box.s012, -box.s456 };
        halves[side] = roots[start] < boxes ? single : cluster_box(clusters + (roots[start] - boxes));
    }
    Subtree left = load_subtree(clusters, boxes, roots[begin], halves[0]);
    Subtree right = load_subtree(clusters, boxes, roots[middle], halves[1]);
    store_cluster(clusters + first_pair + middle, left, right, join(halves[0], halves[1]), leaf_size);
    roots[begin] = boxes + first_pair + middle;
}

// One work-item per range: divide it once.
__kernel void divide_ranges(
    __global Item *items,         // (n)
    __global const uint *ranges,  // (count, 2)
    __global uint *middles,       // (count)
    uint n,
    uint count)
{
    uint i = get_global_id(0);
    if (i >= count) return;
    middles[i] = divide(items, ranges[2 * i], ranges[2 * i + 1], false);
}

// One work-item per range: its whole tree. `divisions`: begin and middle of each, in the order in which they were made.
__kernel void build_ranges(
    __global Item *items,         // (n)
    __global const uint *ranges,  // (count, 2)
    __global uint *divisions,     // (n, 2)
    __global uint *roots,         // (n)
    __global Cluster *clusters,   // (pairs)
    uint n,
    uint count,
    uint boxes,
    uint first_pair,
    uint leaf_size)
{
    uint i = get_global_id(0);
    if (i >= count) return;
    uint begin = ranges[2 * i], end = ranges[2 * i + 1], made = begin;
    uint3 waiting[WAITING];  // begin, end, depth
    uint stack = 1;
    waiting[0] = (uint3)(begin, end, 0);
    while (stack > 0) {
        uint3 range = waiting[--stack];
        if (range.y - range.x < 2) continue;
        uint middle = divide(items, range.x, range.y, range.z >= BALANCED_DEPTH);
        divisions[2 * made] = range.x;
        divisions[2 * made++ + 1] = middle;
        uint3 first = (uint3)(range.x, middle, range.z + 1), second = (uint3)(middle, range.y, range.z + 1);
        bool first_is_longer = middle - range.x > range.y - middle;
        waiting[stack++] = first_is_longer ? first : second;
        waiting[stack++] = first_is_longer ? second : first;
    }
    for (uint k = begin; k < end; k++) roots[k] = items[k].cluster;
    while (made-- > begin)
        complete_pair(items, roots, clusters, divisions[2 * made], divisions[2 * made + 1], boxes, first_pair, leaf_size);
}

// One work-item per division of a long range, whose parts are complete.
__kernel void complete_divisions(
    __global const Item *items,      // (n)
    __global const uint *divisions,  // (count, 2)
    __global uint *roots,            // (n)
    __global Cluster *clusters,      // (pairs)
    uint n,
    uint count,
    uint boxes,
    uint first_pair,
    uint leaf_size)
{
    uint i = get_global_id(0);
    if (i >= count) return;
    complete_pair(items, roots, clusters, divisions[2 * i], divisions[2 * i + 1], boxes, first_pair, leaf_size);
}
