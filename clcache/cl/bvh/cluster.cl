// Binary trees by clustering (Meister, Bittner 2018, "Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy
// Construction"). The clusters, at first the boxes, stand in the order of their Morton codes. In each round each of them looks
// for the neighbour, at most RADIUS places away and of the same segment, with which it has the smallest common box
// (`nearest_neighbours`); two that chose each other become one cluster (`match_clusters`, `merge_clusters`). Rounds go on until
// each segment is a single cluster.
//
// Of equally good neighbours a cluster takes the one whose place differs from its own in the lowest bits. Both sides of a
// pair see the same two numbers, so the best pair of a segment always finds together, and a run of equal boxes joins in twos.
// Where few pairs form nevertheless (boxes that grow from one to the next each want the one before), the host has the rest
// join by places, two and two.
//
// Clusters are planes with RADIUS places before the first and room behind the last; a place without a cluster has the segment
// NONE. Numbers of clusters: the boxes in their order, then the pairs, in the order in which they were made.
//
// Defines: RADIUS; CHUNK: how many places one work-item counts, and moves, in order.
//
// A Cluster also knows what its subtree will cost (collapse.cl): that is computed here, while both halves are at hand.

#include "bvh/box.cl"
#include "bvh/cost.cl"

#define LANES 16u
#define BATCH 64u  // places that are moved step by step: what a step reads is scattered, and no read waits for another

// One work-item per place: the clusters of the first round, and no cluster at the places before and behind them.
__kernel void first_clusters(
    __global const float *boxes,    // (n, 6)
    __global const ulong *keys,     // (n)
    __global const uint *order,     // (n)
    __global float *planes,         // (6, places)
    __global uint *segment,         // (places)
    __global uint *cluster,         // (places)
    __global float *other_planes,   // (6, places)
    __global uint *other_segment,   // (places)
    uint n,
    uint places,
    uint morton_bits)
{
    uint place = get_global_id(0);
    if (place >= places) return;
    bool is_cluster = place >= RADIUS && place < RADIUS + n;
    uint i = is_cluster ? place - RADIUS : 0;
    Box box = load_box(boxes, order[i]);
    store_box_planes(planes, places, place, box);
    segment[place] = is_cluster ? (uint)(keys[i] >> morton_bits) : NONE;
    cluster[place] = i;
    if (is_cluster) return;
    store_box_planes(other_planes, places, place, box);
    other_segment[place] = NONE;
}

typedef struct Lanes {
    float16 low_x, low_y, low_z, high_x, high_y, high_z;
    uint16 segment, place;
} Lanes;

inline Lanes load_lanes(__global const float *planes, __global const uint *segment, uint places, uint first)
{
    size_t n = places;
    Lanes lanes;
    lanes.low_x = vload16(0, planes + first);
    lanes.low_y = vload16(0, planes + n + first);
    lanes.low_z = vload16(0, planes + 2 * n + first);
    lanes.high_x = vload16(0, planes + 3 * n + first);
    lanes.high_y = vload16(0, planes + 4 * n + first);
    lanes.high_z = vload16(0, planes + 5 * n + first);
    lanes.segment = vload16(0, segment + first);
    lanes.place = first + (uint16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    return lanes;
}

// Half the areas of the common boxes. Infinite where float32 has no number for it.
inline float16 joint_areas(Lanes a, Lanes b)
{
    float16 x = (a.high_x > b.high_x ? a.high_x : b.high_x) - (a.low_x < b.low_x ? a.low_x : b.low_x);
    float16 y = (a.high_y > b.high_y ? a.high_y : b.high_y) - (a.low_y < b.low_y ? a.low_y : b.low_y);
    float16 z = (a.high_z > b.high_z ? a.high_z : b.high_z) - (a.low_z < b.low_z ? a.low_z : b.low_z);
    float16 area = x * y + y * z + z * x;
    return area < INFINITY ? area : INFINITY;
}

// One work-item per LANES clusters: the index of each one's best neighbour; NONE where its segment has no other.
__kernel void nearest_neighbours(
    __global const float *planes,  // (6, places)
    __global const uint *segment,  // (places)
    __global uint *nearest,        // (places)
    uint places,
    uint n)
{
    uint first = LANES * get_global_id(0);
    if (first >= n) return;
    Lanes own = load_lanes(planes, segment, places, RADIUS + first);
    float16 best = INFINITY;
    uint16 best_difference = NONE;
    for (uint step = 0; step <= 2 * RADIUS; step++) {
        if (step == RADIUS) continue;
        Lanes other = load_lanes(planes, segment, places, first + step);
        int16 same = own.segment == other.segment;
        float16 area = same ? joint_areas(own, other) : (float16)(INFINITY);
        uint16 difference = same ? (own.place - RADIUS) ^ (other.place - RADIUS) : (uint16)(NONE);
        int16 better = area < best || (area == best && difference < best_difference);
        best = better ? area : best;
        best_difference = better ? difference : best_difference;
    }
    uint16 index = own.place - RADIUS;
    vstore16(best_difference == (uint16)(NONE) ? (uint16)(NONE) : (index ^ best_difference), 0, nearest + first);
}

// The one that cluster i chose, if it chose i; else NONE.
inline uint mutual(__global const uint *nearest, uint i)
{
    uint other = nearest[i];
    return nearest[other == NONE ? i : other] == i ? other : NONE;
}

// One work-item per chunk: with which other each cluster joins, or NONE, and how many of the chunk are the first and the second
// of a pair. `by_place`: those that found nobody join two and two.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void match_clusters(
    __global const uint *segment,  // (places)
    __global const uint *nearest,  // (places)
    __global uint *partner,        // (places)
    __global uint *counts,         // (2, chunks)
    uint places,
    uint chunks,
    uint n,
    uint by_place)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint firsts = 0, seconds = 0;
    uint end = min(n, (chunk + 1) * (uint)CHUNK);
    for (uint i = chunk * CHUNK; i < end; i++) {
        uint with = mutual(nearest, i), other = i ^ 1;
        if (by_place && with == NONE && other < n && segment[RADIUS + other] == segment[RADIUS + i])
            with = mutual(nearest, other) == NONE ? other : NONE;
        partner[i] = with;
        firsts += with != NONE && i < with;
        seconds += with < i;
    }
    counts[chunk] = firsts;
    counts[chunks + chunk] = seconds;
}

// One work-item per kind: exclusive prefix sums over the chunks, in place, and the sum of all.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void sum_counts(
    __global uint *counts,  // (kinds, chunks)
    __global uint *totals,  // (kinds)
    uint kinds,
    uint chunks)
{
    uint kind = get_global_id(0);
    if (kind >= kinds) return;
    uint sum = 0;
    for (uint chunk = 0; chunk < chunks; chunk++) {
        uint count = counts[kind * chunks + chunk];
        counts[kind * chunks + chunk] = sum;
        sum += count;
    }
    totals[kind] = sum;
}

// One work-item per chunk: move what is left to the next round's arrays, in order. `boxes`: how many there were at first;
// `first_pair`: how
// many pairs were made before.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void merge_clusters(
    __global const float *planes,       // (6, places)
    __global const uint *segment,       // (places)
    __global const uint *cluster,       // (places)
    __global const uint *partner,       // (places)
    __global const uint *offsets,       // (2, chunks)
    __global float *next_planes,        // (6, places)
    __global uint *next_segment,        // (places)
    __global uint *next_cluster,        // (places)
    __global Cluster *clusters,         // (pairs)
    uint places,
    uint chunks,
    uint n,
    uint boxes,
    uint first_pair,
    uint leaf_size)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint pair = first_pair + offsets[chunk], to = RADIUS + chunk * CHUNK - offsets[chunks + chunk];
    uint end = min(n, (chunk + 1) * (uint)CHUNK);
    for (uint begin = chunk * CHUNK; begin < end; begin += BATCH) {
        uint moved[BATCH], moved_to[BATCH], joined[BATCH], joined_to[BATCH], moves = 0, joins = 0;
        for (uint i = begin; i < min(end, begin + BATCH); i++) {
            uint other = partner[i];
            moved[moves] = joined[joins] = RADIUS + i;
            moved_to[moves] = joined_to[joins] = to;
            moves += other == NONE;
            joins += other != NONE && i < other;
            to += other > i;
        }
        for (uint k = 0; k < moves; k++) {
            uint from = moved[k], place = moved_to[k];
            store_box_planes(next_planes, places, place, load_box_planes(planes, places, from));
            next_segment[place] = segment[from];
            next_cluster[place] = cluster[from];
        }
        Subtree left[BATCH], right[BATCH];
        for (uint k = 0; k < joins; k++) {
            uint i = joined[k], other = RADIUS + partner[i - RADIUS];
            left[k] = load_subtree(clusters, boxes, cluster[i], load_box_planes(planes, places, i));
            right[k] = load_subtree(clusters, boxes, cluster[other], load_box_planes(planes, places, other));
        }
        for (uint k = 0; k < joins; k++) {
            uint i = joined[k], other = RADIUS + partner[i - RADIUS], place = joined_to[k];
            Box box = join(load_box_planes(planes, places, i), load_box_planes(planes, places, other));
            store_cluster(clusters + pair, left[k], right[k], box, leaf_size);
            store_box_planes(next_planes, places, place, box);
            next_segment[place] = segment[i];
            next_cluster[place] = boxes + pair++;
        }
    }
    Box nothing = { (float3)(0.0f), (float3)(0.0f) };
    for (uint place = to; end == n && place < to + RADIUS + LANES; place++) {
        store_box_planes(next_planes, places, place, nothing);
        next_segment[place] = NONE;
    }
}
