// Trace rays through two levels of trees: placed meshes, then the triangles of each one in its own space. Directions are not
// normalised there, so that t means the same everywhere. Where there is but one mesh, in world space, the upper level is
// compiled out.
//
// Reads the rays as planes, and the scene. One work-item per ray. A ray whose length is not above t_min is not traced: a
// miss, and not occluded. Two private stacks hold at most one entry for each level of a tree, and a tree over 64-bit keys,
// with 32 bits more to tell equal ones apart, has at most 96.
//
// Defines: HAS_INSTANCES; HAS_ALPHA: surfaces have holes, through which rays pass (scene/alpha.cl).

#include "bvh/intersect.cl"
#include "common/transform.cl"
#include "scene/alpha.cl"

#define MAX_DEPTH 96

typedef struct Trees {
    __global const Node *top_nodes, *nodes;
    __global const uint *top_order;
    __global const float4 *leaves;
    __global const Instance *placed;
#if HAS_ALPHA
    Masks masks;
#endif
} Trees;

// A subtree that is still to be visited, and where the ray enters its box.
typedef struct Waiting {
    uint2 subtree;
    float entry;
} Waiting;

// Take the nearest subtree off the stack that begins before t_max. False if there is none.
inline bool next_subtree(const Waiting *stack, int *depth, float t_max, uint2 *current)
{
    while (*depth > 0) {
        Waiting top = stack[--*depth];
        *current = top.subtree;
        if (top.entry <= t_max) return true;
    }
    return false;
}

// The children of `node` that the ray meets: the nearer becomes current, the farther goes onto the stack. False if none.
inline bool descend(const Ray *ray, __global const Node *node, float t_max, uint2 *current, Waiting *stack, int *depth)
{
    float3 low0 = (float3)(node->low[0], node->low[1], node->low[2]);
    float3 low1 = (float3)(node->low[3], node->low[4], node->low[5]);
    float3 high0 = (float3)(node->high[0], node->high[1], node->high[2]);
    float3 high1 = (float3)(node->high[3], node->high[4], node->high[5]);
    float entry0 = box_entry(ray, low0, high0, t_max), entry1 = box_entry(ray, low1, high1, t_max);
    uint2 child0 = (uint2)(node->child[0], node->count[0]), child1 = (uint2)(node->child[1], node->count[1]);
    bool hit0 = entry0 < INFINITY, hit1 = entry1 < INFINITY;
    bool second_first = entry1 < entry0;
    if (hit0 && hit1) {
        Waiting farther = { second_first ? child0 : child1, second_first ? entry0 : entry1 };
        stack[(*depth)++] = farther;
    }
    *current = second_first ? child1 : child0;
    return hit0 || hit1;
}

// The triangles below a root, in its space. Returns at the first hit if `any`.
inline void trace_mesh(const Trees *trees, const Ray *ray, uint root, uint root_count, uint placed_instance, bool any, Hit *hit)
{
    Waiting stack[MAX_DEPTH];
    int depth = 0;
    uint2 current = (uint2)(root, root_count);
    while (true) {
        if (current.y == 0) {
            if (descend(ray, trees->nodes + current.x, hit->t, &current, stack, &depth)) continue;
        } else for (uint i = current.x; i < current.x + current.y; i++) {
            __global const float *leaf = (__global const float *)(trees->leaves + 3 * i);
            uint primitive = as_uint(leaf[3]), own_instance = as_uint(leaf[7]);
            uint instance = own_instance == NONE ? placed_instance : own_instance;
#if HAS_ALPHA
            Hit nearest = *hit;
            bool found = intersect_triangle(ray, leaf, primitive, instance, &nearest)
                         && !is_hole(&trees->masks, instance, primitive, nearest.u, nearest.v);
            if (found) *hit = nearest;
#else
            bool found = intersect_triangle(ray, leaf, primitive, instance, hit);
#endif
            if (any && found) return;
        }
        if (!next_subtree(stack, &depth, hit->t, &current)) return;
    }
}

inline void trace_placed(const Trees *trees, uint index, float3 origin, float3 direction, float t_min, bool any, Hit *hit)
{
    __global const Instance *placed = trees->placed + index;
    float3 low = (float3)(placed->low[0], placed->low[1], placed->low[2]);
    float3 high = (float3)(placed->high[0], placed->high[1], placed->high[2]);
#if HAS_INSTANCES
    float to_object[12];
    for (int k = 0; k < 12; k++) to_object[k] = placed->to_object[k];
    origin = transform_point(to_object, origin);
    direction = transform_vector(to_object, direction);
#endif
    Ray ray = make_ray(origin, direction, t_min, low, high);
    if (!(box_entry(&ray, low, high, hit->t) < INFINITY)) return;
    trace_mesh(trees, &ray, placed->root, placed->root_count, placed->number, any, hit);
}

inline Hit trace(const Trees *trees, float3 low, float3 high, uint placements, uint root, float3 origin, float3 direction,
                 float t_min, float t_max, bool any)
{
    Hit hit = { t_max, 0.0f, 0.0f, NONE, NONE };
    if (!(t_max > t_min)) return hit;
#if !HAS_INSTANCES
    trace_placed(trees, 0, origin, direction, t_min, any, &hit);
    return hit;
#else
    Ray ray = make_ray(origin, direction, t_min, low, high);
    Waiting stack[MAX_DEPTH];
    int depth = 0;
    uint2 current = (uint2)(root, placements == 1);
    while (true) {
        if (current.y == 0) {
            if (descend(&ray, trees->top_nodes + current.x, hit.t, &current, stack, &depth)) continue;
        } else for (uint i = current.x; i < current.x + current.y; i++) {
            trace_placed(trees, trees->top_order[i], origin, direction, t_min, any, &hit);
            if (any && hit.instance != NONE) return hit;
        }
        if (!next_subtree(stack, &depth, hit.t, &current)) return hit;
    }
#endif
}

__kernel void closest_hit(
    __global const Node *top_nodes,       // (top_inner)
    __global const uint *top_order,       // (placements)
    __global const Node *nodes,           // (inner)
    __global const float4 *leaves,        // (triangles, 3)
    __global const Instance *placed,      // (placements)
    __global const float *bounds,         // (6)
    __global const Instance *instances,   // (instances) or null
    __global const uint *triangles,       // (triangles, 3) or null
    __global const uint *material,        // (triangles) or null
    __global const float *uvs,            // (vertices, 2) or null
    __global const Material *materials,   // (materials) or null
    __global const TextureUse *uses,      // (uses) or null
    __global const Texture *textures,     // (textures) or null
    __global const uint *texels,          // (texels) or null
    __global const float *srgb,           // (256) or null
    __global const float *origins,        // (3, n)
    __global const float *directions,     // (3, n)
    __global const float *t_mins,         // (n) or null
    __global const float *lengths,        // (n)
    __global float *t,                    // (n)
    __global float *uv,                   // (2, n)
    __global uint *primitive,             // (n)
    __global uint *instance,              // (n)
    uint placements,
    uint top_root,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Trees trees = { top_nodes, nodes, top_order, leaves, placed };
#if HAS_ALPHA
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    trees.masks = masks;
#endif
    float3 low = (float3)(bounds[0], bounds[1], bounds[2]), high = (float3)(bounds[3], bounds[4], bounds[5]);
    Hit hit = trace(&trees, low, high, placements, top_root, load_planes(origins, n, i), load_planes(directions, n, i),
                    t_mins ? t_mins[i] : 0.0f, lengths[i], false);
    t[i] = hit.instance == NONE ? INFINITY : hit.t;
    uv[i] = hit.u;
    uv[n + i] = hit.v;
    primitive[i] = hit.primitive;
    instance[i] = hit.instance;
}

__kernel void any_hit(
    __global const Node *top_nodes,       // (top_inner)
    __global const uint *top_order,       // (placements)
    __global const Node *nodes,           // (inner)
    __global const float4 *leaves,        // (triangles, 3)
    __global const Instance *placed,      // (placements)
    __global const float *bounds,         // (6)
    __global const Instance *instances,   // (instances) or null
    __global const uint *triangles,       // (triangles, 3) or null
    __global const uint *material,        // (triangles) or null
    __global const float *uvs,            // (vertices, 2) or null
    __global const Material *materials,   // (materials) or null
    __global const TextureUse *uses,      // (uses) or null
    __global const Texture *textures,     // (textures) or null
    __global const uint *texels,          // (texels) or null
    __global const float *srgb,           // (256) or null
    __global const float *origins,        // (3, n)
    __global const float *directions,     // (3, n)
    __global const float *t_mins,         // (n) or null
    __global const float *lengths,        // (n)
    __global uchar *occluded,             // (n)
    uint placements,
    uint top_root,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Trees trees = { top_nodes, nodes, top_order, leaves, placed };
#if HAS_ALPHA
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    trees.masks = masks;
#endif
    float3 low = (float3)(bounds[0], bounds[1], bounds[2]), high = (float3)(bounds[3], bounds[4], bounds[5]);
    Hit hit = trace(&trees, low, high, placements, top_root, load_planes(origins, n, i), load_planes(directions, n, i),
                    t_mins ? t_mins[i] : 0.0f, lengths[i], true);
    occluded[i] = hit.instance != NONE;
}
