// A linear bounding volume hierarchy over boxes (Karras 2012, "Maximizing Parallelism in the Construction of BVHs, Octrees,
// and k-d Trees"), for any number of separate sets of boxes ("segments": the triangles of each mesh, or the instances) at
// once: the number of the segment leads the sort key, so that each segment is a subtree of its own.
//
//   triangle_bounds   a box for each triangle
//   morton_keys       key = segment, then the Morton code of the box's centre within the segment's bounds
//   radix_*           stable sort of (key, box), 8 bits a round
//   bounds_leaves,
//   bounds_level      a pyramid of the boxes in sorted order: level k + 1 joins pairs of level k
//   hierarchy         a node for each split of the sorted keys; its children's boxes by range queries to the pyramid, which
//                     needs no atomics and does not depend on the order of work-items
//   gather_triangles  the vertices of the triangles in sorted order
//
// Boxes are arrays of 6 planes: low x, y, z, high x, y, z.

#include "common/math.cl"

typedef struct Box {
    float3 low, high;
} Box;

inline Box load_box(__global const float *boxes, uint n, uint i)
{
    Box box = { load_planes(boxes, n, i), load_planes(boxes + 3 * (size_t)n, n, i) };
    return box;
}

inline void store_box(__global float *boxes, uint n, uint i, Box box)
{
    store_planes(boxes, n, i, box.low);
    store_planes(boxes + 3 * (size_t)n, n, i, box.high);
}

inline void extend(Box *box, Box other)
{
    box->low = fmin(box->low, other.low);
    box->high = fmax(box->high, other.high);
}

// One work-item per triangle. `triangles` index `positions` directly.
__kernel void triangle_bounds(
    __global const float *positions,  // (vertices, 3)
    __global const uint *triangles,   // (n, 3)
    __global float *boxes,            // (6, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    float3 a = load_row(positions, triangles[3 * i]);
    float3 b = load_row(positions, triangles[3 * i + 1]);
    float3 c = load_row(positions, triangles[3 * i + 2]);
    Box box = { fmin(a, fmin(b, c)), fmax(a, fmax(b, c)) };
    store_box(boxes, n, i, box);
}

// The low 21 bits of v, two zero bits between each two of them.
inline ulong spread_bits(ulong v)
{
    v = (v | v << 32) & 0x001F00000000FFFFul;
    v = (v | v << 16) & 0x001F0000FF0000FFul;
    v = (v | v << 8) & 0x100F00F00F00F00Ful;
    v = (v | v << 4) & 0x10C30C30C30C30C3ul;
    v = (v | v << 2) & 0x1249249249249249ul;
    return v;
}

// The cell, of `cells` between from and to, that the middle of low .. high lies in; 0 where there is no extent.
inline ulong cell_index(float low, float high, float from, float to, float cells)
{
    float place = (0.5f * low + 0.5f * high - from) / (to - from);
    return to > from ? (ulong)clamp(floor(place * cells), 0.0f, cells - 1.0f) : 0;
}

// One work-item per box. `axis_bits` (at most 21) are spent on each axis of the Morton code.
__kernel void morton_keys(
    __global const float *boxes,           // (6, n)
    __global const uint *segment,          // (n)
    __global const float *segment_bounds,  // (6, segments)
    __global ulong *keys,                  // (n)
    __global uint *order,                  // (n)
    uint n,
    uint segments,
    uint axis_bits)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Box box = load_box(boxes, n, i), bounds = load_box(segment_bounds, segments, segment[i]);
    float cells = (float)(1u << axis_bits);
    ulong x = cell_index(box.low.x, box.high.x, bounds.low.x, bounds.high.x, cells);
    ulong y = cell_index(box.low.y, box.high.y, bounds.low.y, bounds.high.y, cells);
    ulong z = cell_index(box.low.z, box.high.z, bounds.low.z, bounds.high.z, cells);
    ulong morton = spread_bits(x) << 2 | spread_bits(y) << 1 | spread_bits(z);
    keys[i] = (ulong)segment[i] << (3 * axis_bits) | morton;
    order[i] = i;
}

#define DIGITS 256u

// One work-item per chunk of consecutive keys, of ceil(n / chunks) each: how often each value of the digit occurs.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void radix_count(
    __global const ulong *keys,  // (n)
    __global uint *counts,       // (256, chunks)
    uint n,
    uint chunks,
    uint shift)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint local_counts[DIGITS];
    for (uint digit = 0; digit < DIGITS; digit++) local_counts[digit] = 0;
    uint length = (n + chunks - 1) / chunks;
    uint end = min(n, (chunk + 1) * length);
    for (uint i = chunk * length; i < end; i++) local_counts[(uint)(keys[i] >> shift) & (DIGITS - 1)]++;
    for (uint digit = 0; digit < DIGITS; digit++) counts[digit * chunks + chunk] = local_counts[digit];
}

// One work-item in all: exclusive prefix sums over (digit, chunk), in place.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void radix_offsets(
    __global uint *counts,  // (256, chunks)
    uint chunks)
{
    if (get_global_id(0) > 0) return;
    uint sum = 0;
    for (uint i = 0; i < DIGITS * chunks; i++) {
        uint count = counts[i];
        counts[i] = sum;
        sum += count;
    }
}

// One work-item per chunk: move its keys, in order, to where their digits' runs begin.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void radix_scatter(
    __global const ulong *keys,    // (n)
    __global const uint *order,    // (n)
    __global const uint *offsets,  // (256, chunks)
    __global ulong *sorted_keys,   // (n)
    __global uint *sorted_order,   // (n)
    uint n,
    uint chunks,
    uint shift)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint next[DIGITS];
    for (uint digit = 0; digit < DIGITS; digit++) next[digit] = offsets[digit * chunks + chunk];
    uint length = (n + chunks - 1) / chunks;
    uint end = min(n, (chunk + 1) * length);
    for (uint i = chunk * length; i < end; i++) {
        ulong key = keys[i];
        uint place = next[(uint)(key >> shift) & (DIGITS - 1)]++;
        sorted_keys[place] = key;
        sorted_order[place] = order[i];
    }
}

// One work-item per box: level 0 of the pyramid, the boxes in sorted order.
__kernel void bounds_leaves(
    __global const float *boxes,  // (6, n)
    __global const uint *order,   // (n)
    __global float *pyramid,      // (6, entries)
    uint n,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    store_box(pyramid, entries, i, load_box(boxes, n, order[i]));
}

// One work-item per entry of the level that begins at `to`, from the `below` entries of the level that begins at `from`.
__kernel void bounds_level(
    __global float *pyramid,  // (6, entries)
    uint entries,
    uint from,
    uint below,
    uint to)
{
    uint i = get_global_id(0);
    if (2 * i >= below) return;
    Box box = load_box(pyramid, entries, from + 2 * i);
    if (2 * i + 1 < below) extend(&box, load_box(pyramid, entries, from + 2 * i + 1));
    store_box(pyramid, entries, to + i, box);
}

// The box around the sorted boxes first .. last.
inline Box range_bounds(__global const float *pyramid, uint entries, uint n, uint first, uint last)
{
    Box box = { (float3)(INFINITY), (float3)(-INFINITY) };
    uint level = 0, size = n;
    uint begin = first, end = last + 1;
    while (begin < end) {
        if (begin & 1) extend(&box, load_box(pyramid, entries, level + begin++));
        if (end & 1) extend(&box, load_box(pyramid, entries, level + --end));
        begin >>= 1;
        end >>= 1;
        level += size;
        size = (size + 1) >> 1;
    }
    return box;
}

// How many leading bits keys i and j share; equal keys go on with the bits of their places. -1 where j is outside.
inline int common_prefix(__global const ulong *keys, uint n, uint i, int j)
{
    if (j < 0 || j >= (int)n) return -1;
    ulong differ = keys[i] ^ keys[j];
    return differ ? (int)clz(differ) : 64 + (int)clz(i ^ (uint)j);
}

// One work-item per inner node, of n - 1. Node i covers a range of sorted keys that begins or ends at i (Karras, Fig. 4).
// A child of at most `leaf_size` boxes becomes a leaf. The node that covers the whole of a segment is its root.
__kernel void hierarchy(
    __global const ulong *keys,           // (n)
    __global const float *pyramid,        // (6, entries)
    __global const uint *segment,         // (n)
    __global const uint *order,           // (n)
    __global const uint *segment_begins,  // (ends)
    __global Node *nodes,                 // (inner)
    __global uint *roots,                 // (segments)
    uint n,
    uint entries,
    uint leaf_size)
{
    uint i = get_global_id(0);
    if (i + 1 >= n) return;

    int forward = common_prefix(keys, n, i, (int)i + 1), backward = common_prefix(keys, n, i, (int)i - 1);
    int direction = forward > backward ? 1 : -1;
    int shared_outside = min(forward, backward);
    int reach = 2;
    while (common_prefix(keys, n, i, (int)i + reach * direction) > shared_outside) reach *= 2;
    int length = 0;
    for (int step = reach / 2; step > 0; step /= 2)
        if (common_prefix(keys, n, i, (int)i + (length + step) * direction) > shared_outside) length += step;
    int other = (int)i + length * direction;

    int shared = common_prefix(keys, n, i, other);
    int before_split = 0;
    for (int step = (length + 1) / 2;; step = (step + 1) / 2) {
        if (common_prefix(keys, n, i, (int)i + (before_split + step) * direction) > shared) before_split += step;
        if (step <= 1) break;
    }
    uint first = min((int)i, other), last = max((int)i, other);
    uint split = (int)i + before_split * direction + min(direction, 0);

    __global Node *node = nodes + i;
    for (uint side = 0; side < 2; side++) {
        uint begin = side ? split + 1 : first, end = side ? last : split, count = end - begin + 1;
        Box box = range_bounds(pyramid, entries, n, begin, end);
        __global float *low = node->low + 3 * side, *high = node->high + 3 * side;
        low[0] = box.low.x, low[1] = box.low.y, low[2] = box.low.z;
        high[0] = box.high.x, high[1] = box.high.y, high[2] = box.high.z;
        bool leaf = count <= leaf_size;
        node->count[side] = leaf ? count : 0;
        node->child[side] = leaf ? begin : (side ? split + 1 : split);
    }

    uint own = segment[order[first]];
    if (segment_begins[own] == first && segment_begins[own + 1] == last + 1) roots[own] = i;
}

// One work-item per triangle, in the tree's order: its vertices, and in their fourth components its number within its mesh
// and the instance that it belongs to.
__kernel void gather_triangles(
    __global const float *positions,  // (vertices, 3)
    __global const uint *triangles,   // (n, 3)
    __global const uint *order,       // (n)
    __global const uint *instance,    // (n)
    __global const uint *primitive,   // (n)
    __global float4 *leaves,          // (n, 3)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint triangle = order[i];
    leaves[3 * i].xyz = load_row(positions, triangles[3 * triangle]);
    leaves[3 * i + 1].xyz = load_row(positions, triangles[3 * triangle + 1]);
    leaves[3 * i + 2].xyz = load_row(positions, triangles[3 * triangle + 2]);
    // As integers: a float register may change what is no number.
    __global uint *words = (__global uint *)(leaves + 3 * i);
    words[3] = primitive[triangle];
    words[7] = instance[triangle];
    words[11] = 0;
}
