// What rays are traced against: placed meshes, each with a tree of its own, and a tree over the placements; the way from a
// triangle to the scene's names for it; which of two hits is kept.
//
// Defines: HAS_INSTANCES: there is more than one mesh, in world space, and so an upper level. HAS_ALPHA: surfaces have
// holes, through which rays pass (scene/alpha.cl). STACK_SIZE: entries that the walk over either level may need.

#include "bvh/intersect.cl"
#include "common/transform.cl"
#include "scene/alpha.cl"

typedef struct Traced {
    __global const Node *top_nodes, *nodes;
    __global const Block *blocks;
    __global const Instance *placed;
    __global const uint *joined_first, *joined_instance;
    __global const float *bounds;
    uint joined;
    int top_root;
#if HAS_ALPHA
    Masks masks;
#endif
} Traced;

// Which of the joined meshes a triangle of the mesh that they became belongs to.
inline uint find_joined(const Traced *traced, uint triangle)
{
    uint begin = 0;
    for (uint length = traced->joined; length > 1;) {
        uint half_length = length / 2;
        begin += triangle >= traced->joined_first[begin + half_length] ? half_length : 0;
        length -= half_length;
    }
    return begin;
}

// The instance that a triangle belongs to, and its number there.
inline uint2 name_triangle(const Traced *traced, uint triangle, uint placement)
{
#if HAS_INSTANCES
    __global const Instance *placed = traced->placed + placement;
    if (placed->number != NONE) return (uint2)(placed->number, triangle - placed->first_triangle);
#endif
    uint joined = find_joined(traced, triangle);
    return (uint2)(traced->joined_instance[joined], triangle - traced->joined_first[joined]);
}

// Whether a hit replaces the one so far: if it is nearer, or as near and of a lower instance, then primitive, so that the
// result depends neither on the tree nor on the order of its children.
inline bool replaces(const Traced *traced, float t, uint triangle, uint placement, const Hit *hit)
{
    if (t < hit->t) return true;
    if (t > hit->t || hit->triangle == NONE) return false;
    if (placement == hit->placement) return triangle < hit->triangle;
    return name_triangle(traced, triangle, placement).x < name_triangle(traced, hit->triangle, hit->placement).x;
}

inline bool passes_hole(const Traced *traced, uint triangle, uint placement, float u, float v)
{
#if HAS_ALPHA
    uint2 name = name_triangle(traced, triangle, placement);
    return is_hole(&traced->masks, name.x, name.y, u, v);
#else
    return false;
#endif
}
