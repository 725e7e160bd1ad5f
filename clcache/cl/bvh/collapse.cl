// Wide nodes out of binary trees. First downwards, level by level: which subtrees of the pair that it stands for a node has as its
// children follows from the least costs (cost.cl). Then upwards: how many nodes and leaves there are below each. Last downwards
// again: the nodes are numbered depth first, and written; likewise the leaves, so that what a ray visits lies close together.
//
// A level is rows of eight numbers of clusters, packed at the front, NONE behind: the children of each of its nodes. IS_LEAF marks
// those that become leaves. The children that become nodes have, in this order, the rows of the next level. The roots of the
// segments, eight to a row, are handled as the children of a level above the first.
//
// Defines: ROW_CHUNK: how many rows one work-item counts, and lists, in order.

#include "bvh/box.cl"
#include "bvh/cost.cl"

// One work-item per place in the rows of the roots, of which `segments` are used. `begins`: the first item of each (divide.cl).
__kernel void list_roots(
    __global const uint *roots,        // (items)
    __global const uint *begins,       // (segments)
    __global const Cluster *clusters,  // (pairs)
    __global uint *children,           // (rows, 8)
    uint rows,
    uint segments,
    uint boxes)
{
    uint i = get_global_id(0);
    if (i >= 8 * rows) return;
    children[i] = i < segments ? marked(clusters, boxes, roots[begins[i]]) : NONE;
}

// How many of `places` places the left half of a pair gets at best.
inline uint left_places(__global const Cluster *clusters, uint boxes, __global const Cluster *pair, uint places)
{
    if (pair->left < boxes) return 1;
    if (pair->right < boxes) return places - 1;
    __global const float *left = clusters[pair->left - boxes].costs, *right = clusters[pair->right - boxes].costs;
    uint best = 1;
    float least = INFINITY;
    for (uint k = 1; k < places; k++) {
        float cost = left[k - 1] + right[places - k - 1];
        best = cost < least ? k : best;
        least = cost < least ? cost : least;
    }
    return best;
}

// One work-item per node: its children. `queue`: the pairs that become nodes.
__kernel void open_nodes(
    __global const uint *queue,        // (rows)
    __global const Cluster *clusters,  // (pairs)
    __global uint *children,           // (rows, 8)
    uint rows,
    uint boxes)
{
    uint i = get_global_id(0);
    if (i >= rows) return;
    uint waiting[8], places[8], depth = 1, found = 0;
    waiting[0] = queue[i];
    places[0] = 8;
    while (depth > 0) {
        depth--;
        uint cluster = waiting[depth], share = places[depth];
        if (cluster >= boxes) {
            __global const Cluster *pair = clusters + (cluster - boxes);
            if (share < 8) while (share > 1 && pair->costs[share - 1] == pair->costs[share - 2]) share--;
            if (share > 1) {
                uint left = left_places(clusters, boxes, pair, share);
                waiting[depth] = pair->right;
                places[depth++] = share - left;
                waiting[depth] = pair->left;
                places[depth++] = left;
                continue;
            }
        }
        children[8 * i + found++] = marked(clusters, boxes, cluster);
    }
    for (; found < 8; found++) children[8 * i + found] = NONE;
}

// One work-item per chunk of rows: how many of their children are nodes.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void count_children(
    __global const uint *children,  // (rows, 8)
    __global uint *counts,          // (1, chunks)
    uint rows,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint nodes = 0;
    uint end = 8 * min(rows, (chunk + 1) * (uint)ROW_CHUNK);
    for (uint i = 8 * chunk * ROW_CHUNK; i < end; i++) nodes += children[i] < IS_LEAF;
    counts[chunk] = nodes;
}

// One work-item per chunk of rows: list the children that are nodes; of each row, where its own begin in the list.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void list_children(
    __global const uint *children,  // (rows, 8)
    __global const uint *offsets,   // (1, chunks)
    __global uint *queue,           // (entries)
    __global uint *first_row,       // (rows)
    uint rows,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint node = offsets[chunk];
    uint end = min(rows, (chunk + 1) * (uint)ROW_CHUNK);
    for (uint row = chunk * ROW_CHUNK; row < end; row++) {
        first_row[row] = node;
        for (uint slot = 0; slot < 8; slot++) {
            uint child = children[8 * row + slot];
            if (child < IS_LEAF) queue[node++] = child;
        }
    }
}

// One work-item per node of a level: how many nodes, it included, and leaves there are in its subtree.
__kernel void measure_subtrees(
    __global const uint *children,   // (rows, 8)
    __global const uint *first_row,  // (rows)
    __global const uint *sizes_below,  // (rows_below, 2)
    __global uint *sizes,            // (rows, 2)
    uint rows)
{
    uint i = get_global_id(0);
    if (i >= rows) return;
    uint below = first_row[i], nodes = 1, leaves = 0;
    for (uint slot = 0; slot < 8; slot++) {
        uint child = children[8 * i + slot];
        if (child < IS_LEAF) {
            nodes += sizes_below[2 * below];
            leaves += sizes_below[2 * below + 1];
            below++;
        } else if (child != NONE) leaves++;
    }
    sizes[2 * i] = nodes;
    sizes[2 * i + 1] = leaves;
}

// The reference to a leaf, which has that number. It is named by it if it has a block, else by what its one box stands for.
inline int leaf_reference(__global const Cluster *clusters, __global const uint *order, uint boxes, uint cluster, uint leaf,
                          bool has_blocks)
{
    uint triangles = cluster < boxes ? 1 : clusters[cluster - boxes].triangles & ~IS_LEAF;
    return ~(int)(has_blocks ? leaf << 3 | (triangles - 1) : order[cluster] << 3);
}

// One work-item in all: the references of the roots; `starts`: the numbers at which the nodes and leaves of each tree begin.
// `leaf_clusters`: the clusters that are leaves, by number.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void number_roots(
    __global const uint *children,       // (rows, 8)
    __global const uint *sizes_below,    // (rows_below, 2)
    __global const Cluster *clusters,    // (pairs)
    __global const uint *order,          // (boxes)
    __global int *roots,                 // (segments)
    __global uint *starts_below,         // (rows_below, 2)
    __global uint *leaf_clusters,        // (leaves)
    uint rows,
    uint segments,
    uint boxes,
    uint has_blocks)
{
    if (get_global_id(0) > 0) return;
    uint below = 0, node = 0, leaf = 0;
    for (uint segment = 0; segment < segments; segment++) {
        uint child = children[segment], cluster = child & ~IS_LEAF;
        if (child < IS_LEAF) {
            roots[segment] = node;
            starts_below[2 * below] = node;
            starts_below[2 * below + 1] = leaf;
            node += sizes_below[2 * below];
            leaf += sizes_below[2 * below + 1];
            below++;
        } else {
            roots[segment] = leaf_reference(clusters, order, boxes, cluster, leaf, has_blocks);
            leaf_clusters[leaf++] = cluster;
        }
    }
}

// One work-item per node of a level: the node, with its children numbered: `starts` says where its subtree's nodes and leaves begin,
// its own first.
__kernel void write_nodes(
    __global const uint *children,     // (rows, 8)
    __global const uint *first_row,    // (rows)
    __global const uint *starts,       // (rows, 2)
    __global const uint *sizes_below,  // (rows_below, 2)
    __global const Cluster *clusters,  // (pairs)
    __global const float *boxes,       // (n, 6)
    __global const uint *order,        // (n)
    __global uint *starts_below,       // (rows_below, 2)
    __global uint *leaf_clusters,      // (leaves)
    __global Node *nodes,              // (nodes)
    uint rows,
    uint n,
    uint has_blocks)
{
    uint i = get_global_id(0);
    if (i >= rows) return;
    uint below = first_row[i], next_node = starts[2 * i] + 1, leaf = starts[2 * i + 1], next_leaf = leaf;
    __global Node *node = nodes + starts[2 * i];
    for (uint slot = 0; slot < 8; slot++) {
        uint child = children[8 * i + slot];
        next_leaf += child >= IS_LEAF && child != NONE;
    }
    for (uint slot = 0; slot < 8; slot++) {
        uint child = children[8 * i + slot], cluster = child & ~IS_LEAF;
        Box box = { (float3)(INFINITY), (float3)(-INFINITY) };
        if (child != NONE) box = cluster < n ? load_box(boxes, order[cluster]) : cluster_box(clusters + (cluster - n));
        int reference = 0;
        if (child < IS_LEAF) {
            reference = next_node;
            starts_below[2 * below] = next_node;
            starts_below[2 * below + 1] = next_leaf;
            next_node += sizes_below[2 * below];
            next_leaf += sizes_below[2 * below + 1];
            below++;
        } else if (child != NONE) {
            reference = leaf_reference(clusters, order, n, cluster, leaf, has_blocks);
            leaf_clusters[leaf++] = cluster;
        }
        node->planes[slot] = box.low.x, node->planes[8 + slot] = box.high.x;
        node->planes[16 + slot] = box.low.y, node->planes[24 + slot] = box.high.y;
        node->planes[32 + slot] = box.low.z, node->planes[40 + slot] = box.high.z;
        node->child[slot] = reference;
    }
}
