// The triangles of the leaves, eight to a block, as vectors. One work-item writes several blocks, step by step for all of them: what
// a step reads is scattered, and no read waits for another.
//
// Define: RUN: blocks of a work-item.

#include "common/math.cl"

#define BLOCK_LANES 8u

// The boxes of a leaf's cluster, in order, to `found`, and the first again in the lanes that are left over; how many there are.
inline uint find_boxes(__global const Cluster *clusters, uint boxes, uint leaf_cluster, uint *found)
{
    uint waiting[BLOCK_LANES], depth = 1, count = 0;
    waiting[0] = leaf_cluster;
    while (depth > 0) {
        uint cluster = waiting[--depth];
        if (cluster < boxes) {
            found[count++] = cluster;
        } else {
            waiting[depth++] = clusters[cluster - boxes].right;
            waiting[depth++] = clusters[cluster - boxes].left;
        }
    }
    for (uint lane = count; lane < BLOCK_LANES; lane++) found[lane] = found[0];
    return count;
}

// One work-item per RUN blocks.
__kernel void write_blocks(
    __global const uint *leaf_clusters,  // (leaves)
    __global const Cluster *clusters,    // (pairs)
    __global const uint *order,          // (n)
    __global const float *positions,     // (vertices, 3)
    __global const uint *triangles,      // (n, 3)
    __global Block *blocks,              // (leaves)
    uint leaves,
    uint n)
{
    uint first = RUN * (uint)get_global_id(0);
    if (first >= leaves) return;
    uint blocks_here = min((uint)RUN, leaves - first), lanes = BLOCK_LANES * blocks_here;
    uint counts[RUN], found[RUN * BLOCK_LANES], corners[3][RUN * BLOCK_LANES];
    for (uint k = 0; k < blocks_here; k++)
        counts[k] = find_boxes(clusters, n, leaf_clusters[first + k], found + BLOCK_LANES * k);
    for (uint lane = 0; lane < lanes; lane++) found[lane] = order[found[lane]];
    for (uint lane = 0; lane < lanes; lane++)
        for (uint corner = 0; corner < 3; corner++) corners[corner][lane] = triangles[3 * found[lane] + corner];
    for (uint k = 0; k < blocks_here; k++) {
        __global Block *block = blocks + first + k;
        int8 is_used = (int8)(0, 1, 2, 3, 4, 5, 6, 7) < (int8)(counts[k]);
        for (uint corner = 0; corner < 3; corner++) {
            float x[BLOCK_LANES], y[BLOCK_LANES], z[BLOCK_LANES];
            for (uint lane = 0; lane < BLOCK_LANES; lane++) {
                float3 position = load_row(positions, corners[corner][BLOCK_LANES * k + lane]);
                x[lane] = position.x, y[lane] = position.y, z[lane] = position.z;
            }
            __global float *rows = block->positions + 3 * corner * BLOCK_LANES;
            vstore8(is_used ? vload8(0, x) : (float8)(NAN), 0, rows);
            vstore8(is_used ? vload8(0, y) : (float8)(NAN), 0, rows + BLOCK_LANES);
            vstore8(is_used ? vload8(0, z) : (float8)(NAN), 0, rows + 2 * BLOCK_LANES);
        }
        vstore8(is_used ? vload8(k, found) : (uint8)(NONE), 0, block->triangle);
    }
}
