// Trees for any number of separate sets of boxes ("segments": the triangles of each mesh, or the instances) at once, in
// steps with a file each.
//
//   keys, radix.cl   a box for each triangle; its Morton code behind the number of its segment; the boxes in order of these
//   cluster.cl       binary trees over each segment, from the boxes upwards: neighbours that fit together join
//   divide.cl        what is above these, from the root down: divisions that part them best
//   collapse.cl      nodes with up to eight children out of it, so that rays are expected to do the least work
//   blocks.cl        the triangles of the leaves, eight to a block
//
// Nothing here depends on the order in which work-items run: numbers are given by prefix sums, not by atomics.

#include "bvh/box.cl"
#include "bvh/radix.cl"
#include "bvh/cluster.cl"
#include "bvh/divide.cl"
#include "bvh/collapse.cl"
#include "bvh/blocks.cl"

// One work-item per triangle. `triangles` index `positions` directly.
__kernel void triangle_bounds(
    __global const float *positions,  // (vertices, 3)
    __global const uint *triangles,   // (n, 3)
    __global float *boxes,            // (n, 6)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    float3 a = load_row(positions, triangles[3 * i]);
    float3 b = load_row(positions, triangles[3 * i + 1]);
    float3 c = load_row(positions, triangles[3 * i + 2]);
    Box point_a = { a, a }, point_b = { b, b }, point_c = { c, c };
    store_box(boxes, i, join(point_a, join(point_b, point_c)));
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
    float place = (0.5f * low + 0.5f * high - from) / (to - from) * cells;
    place = place < cells - 1.0f ? place : cells - 1.0f;
    return place > 0.0f && to > from ? (uint)place : 0;
}

// The segment that box i belongs to. `begins` ascends.
inline uint find_segment(__global const uint *begins, uint segments, uint i)
{
    uint low = 0, high = segments;
    while (high - low > 1) {
        uint middle = (low + high) / 2;
        if (begins[middle] <= i) low = middle;
        else high = middle;
    }
    return low;
}

// One work-item per box. `begins`: the first box of each segment, and where the last ends. `axis_bits` (at most 21) are spent on each axis of the Morton code.
__kernel void morton_keys(
    __global const float *boxes,           // (n, 6)
    __global const uint *begins,           // (ends)
    __global const float *segment_bounds,  // (segments, 6)
    __global ulong *keys,                  // (n)
    __global uint *order,                  // (n)
    uint n,
    uint segments,
    uint axis_bits)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint segment = find_segment(begins, segments, i);
    Box box = load_box(boxes, i), bounds = load_box(segment_bounds, segment);
    float cells = (float)(1u << axis_bits);
    ulong x = cell_index(box.low.x, box.high.x, bounds.low.x, bounds.high.x, cells);
    ulong y = cell_index(box.low.y, box.high.y, bounds.low.y, bounds.high.y, cells);
    ulong z = cell_index(box.low.z, box.high.z, bounds.low.z, bounds.high.z, cells);
    ulong morton = spread_bits(x) << 2 | spread_bits(y) << 1 | spread_bits(z);
    keys[i] = (ulong)segment << (3 * axis_bits) | morton;
    order[i] = i;
}
