// What a subtree costs the rays that meet its box, times half the box's area, if up to k places of a wide node above are
// given to it, for each k from 1 to 7 (Ylitie, Karras, Laine 2017, "Efficient Incoherent Ray Traversal on GPUs Through
// Compressed Wide BVHs", section 3.1). One place holds a leaf (of up to `leaf_size` triangles, in one block) or a node, whose
// eight places are divided among the two halves at best; k places are divided, or some are left unused.
//
// Defines: NODE_COST, of testing the eight boxes of a node; BLOCK_COST, of testing the triangles of a block, all at once;
// TRIANGLE_COST, what each of these adds.

#include "bvh/box.cl"

#define IS_LEAF 0x80000000u  // flag on Cluster.triangles, and on the number of a cluster: it becomes a leaf

typedef struct Subtree {
    uint cluster;    // its number
    uint triangles;
    float8 costs;    // for 1 .. 7 places; the last is not used
} Subtree;

inline Box cluster_box(__global const Cluster *cluster)
{
    Box box = { load_row(cluster->low, 0), load_row(cluster->high, 0) };
    return box;
}

// The number of a cluster, marked if it becomes a leaf. `boxes` of them are single boxes, the others pairs.
inline uint marked(__global const Cluster *clusters, uint boxes, uint cluster)
{
    bool is_leaf = cluster < boxes || clusters[cluster - boxes].triangles & IS_LEAF;
    return cluster | (is_leaf ? IS_LEAF : 0);
}

inline float leaf_cost(float area, uint triangles)
{
    return area * (BLOCK_COST + TRIANGLE_COST * (float)triangles);
}

// The subtree of a cluster, whose box is known.
inline Subtree load_subtree(__global const Cluster *clusters, uint boxes, uint cluster, Box box)
{
    Subtree subtree = { cluster, 1, leaf_cost(half_area(box), 1) };
    if (cluster >= boxes) {
        __global const Cluster *pair = clusters + (cluster - boxes);
        subtree.triangles = pair->triangles & ~IS_LEAF;
        subtree.costs = vload8(0, pair->costs);
    }
    return subtree;
}

// The least cost of two subtrees that share 1 .. 8 places; infinite for 1.
inline float8 divided_costs(float8 left, float8 right)
{
    float8 best = INFINITY, shifted = right;
    float costs[8];
    vstore8(left, 0, costs);
    for (int places = 0; places < 7; places++) {
        shifted = shifted.s00123456;
        shifted.s0 = INFINITY;
        float8 cost = costs[places] + shifted;
        best = cost < best ? cost : best;
    }
    return best;
}

// In each component the least of this and those before.
inline float8 running_least(float8 v)
{
    float8 shifted = v.s00123456;
    v = shifted < v ? shifted : v;
    shifted = v.s01012345;
    v = shifted < v ? shifted : v;
    shifted = v.s01230123;
    return shifted < v ? shifted : v;
}

// A pair of subtrees, with the costs of both together.
inline void store_cluster(__global Cluster *cluster, Subtree left, Subtree right, Box box, uint leaf_size)
{
    float area = half_area(box);
    float8 costs = divided_costs(left.costs, right.costs);
    uint triangles = left.triangles + right.triangles;
    float as_node = costs.s7 + NODE_COST * area;
    float as_leaf = triangles <= leaf_size ? leaf_cost(area, triangles) : INFINITY;
    bool is_leaf = triangles <= leaf_size && as_leaf <= as_node;
    costs.s0 = is_leaf ? as_leaf : as_node;
    vstore8(running_least(costs), 0, cluster->costs);
    cluster->triangles = triangles | (is_leaf ? IS_LEAF : 0);
    cluster->left = left.cluster;
    cluster->right = right.cluster;
    cluster->low[0] = box.low.x, cluster->low[1] = box.low.y, cluster->low[2] = box.low.z;
    cluster->high[0] = box.high.x, cluster->high[1] = box.high.y, cluster->high[2] = box.high.z;
}
