// One ray, from a node or leaf of either level on: placed meshes, or the triangles of one in its own space. Directions are
// not normalised there, so that t means the same everywhere.

#include "bvh/traced.cl"

// The triangles of a block. True if there was a hit that counts.
INLINED bool trace_block(const Traced *traced, const Ray *ray, __global const Block *block, uint placement, bool any, Hit *hit)
{
    Met met;
    bool found = false;
    for (ulong lanes = meet_block(ray, block, hit->t, &met); lanes; lanes = without_first_lane(lanes)) {
        uint lane = first_lane(lanes), triangle = block->triangle[lane];
        float size = met.denominator.lane[lane], t = met.t.lane[lane] / size;
        if (!(t > ray->t_min) || !replaces(traced, t, triangle, placement, hit)) continue;
        float u = met.u.lane[lane] / size, v = met.v.lane[lane] / size;
        if (passes_hole(traced, triangle, placement, u, v)) continue;
        if (any) return true;
        Hit nearer = { t, u, v, triangle, placement };
        *hit = nearer;
        found = true;
    }
    return found;
}

// The triangles below a root, in its space. Returns at the first hit if `any`; true if there was a hit.
INLINED bool trace_mesh(const Traced *traced, const Ray *ray, int root, uint placement, bool any, Hit *hit)
{
    Waiting stack[STACK_SIZE];
    stack[0].entry = -INFINITY;
    int depth = 1, current = root;
    bool found = false;
    while (true) {
        if (current >= 0) {
            __global const Node *node = traced->nodes + current;
            float8 entries;
            ulong lanes = enter_boxes(ray, node, hit->t, &entries);
            if (lanes) {
                current = any ? descend_unordered(lanes, node->child, stack, &depth)
                              : descend(lanes, entries, node->child, stack, &depth);
                continue;
            }
        } else {
            found |= trace_block(traced, ray, traced->blocks + (~current >> 3), placement, any, hit);
            if (any && found) return true;
        }
        do depth--;
        while (stack[depth].entry > hit->t);
        if (depth == 0) return found;
        current = stack[depth].subtree;
    }
}

#if HAS_INSTANCES
INLINED bool trace_placed(const Traced *traced, uint index, float3 origin, float3 direction, float t_min, bool any, Hit *hit)
{
    __global const Instance *placed = traced->placed + index;
    float3 low = (float3)(placed->low[0], placed->low[1], placed->low[2]);
    float3 high = (float3)(placed->high[0], placed->high[1], placed->high[2]);
    float to_object[12];
    for (int k = 0; k < 12; k++) to_object[k] = placed->to_object[k];
    origin = transform_point(to_object, origin);
    direction = transform_vector(to_object, direction);
    Ray ray = make_ray(origin, direction, t_min, low, high);
    return trace_mesh(traced, &ray, placed->root, index, any, hit);
}

// The placed meshes below a root of the upper level. True if there was a hit within (t_min, hit->t); the nearest, unless
// `any`, is in *hit.
inline bool trace_scene(const Traced *traced, int root, float3 origin, float3 direction, float t_min, bool any, Hit *hit)
{
    __global const float *bounds = traced->bounds;
    float3 low = (float3)(bounds[0], bounds[1], bounds[2]), high = (float3)(bounds[3], bounds[4], bounds[5]);
    Ray ray = make_ray(origin, direction, t_min, low, high);
    Waiting stack[STACK_SIZE];
    stack[0].entry = -INFINITY;
    int depth = 1, current = root;
    bool found = false;
    while (true) {
        if (current >= 0) {
            __global const Node *node = traced->top_nodes + current;
            float8 entries;
            ulong lanes = enter_boxes(&ray, node, hit->t, &entries);
            if (lanes) {
                current = descend(lanes, entries, node->child, stack, &depth);
                continue;
            }
        } else {
            found |= trace_placed(traced, ~current >> 3, origin, direction, t_min, any, hit);
            if (any && found) return true;
        }
        do depth--;
        while (stack[depth].entry > hit->t);
        if (depth == 0) return found;
        current = stack[depth].subtree;
    }
}
#endif
