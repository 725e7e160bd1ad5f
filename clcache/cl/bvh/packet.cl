// Sixteen rays together through the trees (Wald et al. 2001, "Interactive Rendering with Coherent Ray Tracing", in vectors):
// boxes are tested against the intervals that hold all the rays, eight boxes at once, and triangles against all rays at
// once. Rays whose directions differ in a sign or in their longest axis go in turns, so that what depends on these is the
// same for all. Where the rays part, each goes on alone.

#include "bvh/beam.cl"
#include "bvh/single.cl"

// Of the rays of a packet, so many that meet a box are quicker one by one; on their way to any hit, fewer.
#define FEW 8
#define FEW_TO_ANY 3
// Where so many meet a box, the next boxes are entered untested.
#define MANY 14
#define UNTESTED 2

// The triangles below a root, in its space.
INLINED void trace_beam(const Traced *traced, Beam *beam, int root, uint placement, bool any, Packet *packet)
{
    Waiting stack[STACK_SIZE];
    stack[0].entry = -INFINITY;
    int depth = 1, current = root;
    while (true) {
        if (current >= 0) {
            __global const Node *node = traced->nodes + current;
            float8 entries;
            ulong lanes = enter_boxes_together(beam, node, &entries);
            if (lanes) {
                current = descend(lanes, entries, node->child, stack, &depth);
                continue;
            }
        } else {
            __global const Block *block = traced->blocks + (~current >> 3);
            bool found = false;
            for (ulong lanes = enter_triangles_together(beam, block, (~current & 7u) + 1); lanes; lanes = without_first_lane(lanes))
                found |= meet_triangle(traced, beam, block, first_lane(lanes), placement, any, packet);
            if (found) set_farthest(beam, packet);
            if (any && found && beam->t_max == -INFINITY) return;
        }
        do depth--;
        while (stack[depth].entry > beam->t_max);
        if (depth == 0) return;
        current = stack[depth].subtree;
    }
}

// The hits of a packet's rays, one by one.
typedef struct HitLanes {
    Floats16 t, u, v;
    Ints16 triangle, placement;
} HitLanes;

inline HitLanes load_hits(const Packet *packet)
{
    HitLanes hits;
    hits.t.all = packet->t;
    hits.u.all = packet->u;
    hits.v.all = packet->v;
    hits.triangle.all = packet->triangle;
    hits.placement.all = packet->placement;
    return hits;
}

inline void keep_hits(const HitLanes *hits, bool any, Packet *packet)
{
    packet->t = hits->t.all;
    packet->triangle = hits->triangle.all;
    if (any) return;
    packet->u = hits->u.all;
    packet->v = hits->v.all;
    packet->placement = hits->placement.all;
}

inline Hit hit_of_lane(const HitLanes *hits, uint lane)
{
    Hit hit = { hits->t.lane[lane], hits->u.lane[lane], hits->v.lane[lane], (uint)hits->triangle.lane[lane],
                (uint)hits->placement.lane[lane] };
    return hit;
}

inline void set_lane(HitLanes *hits, uint lane, Hit hit, bool any)
{
    hits->t.lane[lane] = any ? -INFINITY : hit.t;
    hits->u.lane[lane] = hit.u;
    hits->v.lane[lane] = hit.v;
    hits->triangle.lane[lane] = any ? 0 : (int)hit.triangle;
    hits->placement.lane[lane] = (int)hit.placement;
}

// Each of the rays alone, from a node or leaf of a mesh's tree on.
inline void trace_alone(const Traced *traced, const Beam *beam, const Spread *spread, ulong2 lanes, int root, uint placement,
                        bool any, Packet *packet)
{
    HitLanes hits = load_hits(packet);
    for (; lanes.x | lanes.y; lanes = without_first_lane16(lanes)) {
        uint lane = first_lane16(lanes);
        Ray ray = spread_ray(spread, beam, lane);
        Hit hit = hit_of_lane(&hits, lane);
        if (trace_mesh(traced, &ray, root, placement, any, &hit)) set_lane(&hits, lane, hit, any);
    }
    keep_hits(&hits, any, packet);
}

// Put the chosen children of a node onto the stack, the nearest last, as 8 times the node's number and their lanes.
INLINED void push_slots(ulong lanes, float8 entries, int first_slot, Waiting *stack, int *depth)
{
    Floats8 entry;
    entry.all = entries;
    int bottom = *depth, top = bottom;
    for (; lanes; lanes = without_first_lane(lanes)) {
        uint lane = first_lane(lanes);
        Waiting child = { first_slot + (int)lane, entry.lane[lane] };
        int place = top++;
        for (; place > bottom && stack[place - 1].entry < child.entry; place--) stack[place] = stack[place - 1];
        stack[place] = child;
    }
    *depth = top;
}

// The triangles below a root, in its space, for rays that may part: each box that the beam may meet is tested against every
// ray before it is entered; where few meet it, they go on alone.
INLINED void trace_spreading(const Traced *traced, Beam *beam, const Spread *spread, int root, uint placement, bool any,
                            Packet *packet)
{
    Waiting stack[STACK_SIZE];
    stack[0].entry = -INFINITY;
    int depth = 1, current = root, untested = UNTESTED;
    while (true) {
        bool found = false;
        if (current >= 0) {
            __global const Node *node = traced->nodes + current;
            float8 entries;
            ulong lanes = enter_boxes_together(beam, node, &entries);
            push_slots(lanes, entries, 8 * current, stack, &depth);
        } else {
            __global const Block *block = traced->blocks + (~current >> 3);
            for (ulong lanes = enter_triangles_together(beam, block, (~current & 7u) + 1); lanes; lanes = without_first_lane(lanes))
                found |= meet_triangle(traced, beam, block, first_lane(lanes), placement, any, packet);
        }
        while (true) {
            if (found) {
                set_farthest(beam, packet);
                if (any && beam->t_max == -INFINITY) return;
            }
            do depth--;
            while (stack[depth].entry > beam->t_max);
            if (depth == 0) return;
            int slot = stack[depth].subtree;
            __global const Node *node = traced->nodes + (slot >> 3);
            if (untested > 0) {
                untested--;
                current = node->child[slot & 7];
                break;
            }
            ulong2 lanes = enter_box(beam, spread, node, slot & 7, packet->t);
            int rays = popcount(lanes.x) + popcount(lanes.y);
            current = node->child[slot & 7];
            untested = rays >= MANY ? UNTESTED : 0;
            if (rays > (any ? FEW_TO_ANY : FEW)) break;
            found = rays > 0;
            if (found) trace_alone(traced, beam, spread, lanes, current, placement, any, packet);
        }
    }
}

INLINED void trace_packet_placed(const Traced *traced, uint index, int16 chosen, bool any, bool parting, Packet *packet)
{
    __global const Instance *placed = traced->placed + index;
    Rays rays = { packet->origin_x, packet->origin_y, packet->origin_z, packet->direction_x, packet->direction_y, packet->direction_z };
#if HAS_INSTANCES
    __global const float *m = placed->to_object;
    rays.x = m[0] * packet->direction_x + m[1] * packet->direction_y + m[2] * packet->direction_z;
    rays.y = m[4] * packet->direction_x + m[5] * packet->direction_y + m[6] * packet->direction_z;
    rays.z = m[8] * packet->direction_x + m[9] * packet->direction_y + m[10] * packet->direction_z;
    rays.origin_x = (m[0] * packet->origin_x + m[1] * packet->origin_y + m[2] * packet->origin_z) + m[3];
    rays.origin_y = (m[4] * packet->origin_x + m[5] * packet->origin_y + m[6] * packet->origin_z) + m[7];
    rays.origin_z = (m[8] * packet->origin_x + m[9] * packet->origin_y + m[10] * packet->origin_z) + m[11];
#endif
    while (any16(chosen)) {
        if (parting) {
            Spread spread;
            Beam beam = take_beam(&rays, packet, placed->low, placed->high, &chosen, &spread);
            trace_spreading(traced, &beam, &spread, placed->root, index, any, packet);
        } else {
            Beam beam = take_beam(&rays, packet, placed->low, placed->high, &chosen, 0);
            trace_beam(traced, &beam, placed->root, index, any, packet);
        }
    }
}

#if HAS_INSTANCES
// Each of the rays alone, from a node or leaf of the upper level on.
inline void trace_scene_alone(const Traced *traced, ulong2 lanes, int root, bool any, Packet *packet)
{
    Floats16 origin[3], direction[3], t_min;
    origin[0].all = packet->origin_x, origin[1].all = packet->origin_y, origin[2].all = packet->origin_z;
    direction[0].all = packet->direction_x, direction[1].all = packet->direction_y, direction[2].all = packet->direction_z;
    t_min.all = packet->t_min;
    HitLanes hits = load_hits(packet);
    for (; lanes.x | lanes.y; lanes = without_first_lane16(lanes)) {
        uint lane = first_lane16(lanes);
        float3 from = (float3)(origin[0].lane[lane], origin[1].lane[lane], origin[2].lane[lane]);
        float3 along = (float3)(direction[0].lane[lane], direction[1].lane[lane], direction[2].lane[lane]);
        Hit hit = hit_of_lane(&hits, lane);
        if (trace_scene(traced, root, from, along, t_min.lane[lane], any, &hit)) set_lane(&hits, lane, hit, any);
    }
    keep_hits(&hits, any, packet);
}

// The placed meshes that a beam meets. Whether the rays may part or not, there is a test for each before a mesh is entered.
inline void trace_scene_beam(const Traced *traced, Beam *beam, const Spread *spread, bool any, bool parting, Packet *packet)
{
    Waiting stack[STACK_SIZE];
    stack[0].entry = -INFINITY;
    int depth = 1, current = traced->top_root;
    ulong2 lanes = lanes16(beam->rays);
    while (true) {
        if (current >= 0) {
            float8 entries;
            ulong children = enter_boxes_together(beam, traced->top_nodes + current, &entries);
            push_slots(children, entries, 8 * current, stack, &depth);
        } else {
            trace_packet_placed(traced, ~current >> 3, chosen16(lanes), any, parting, packet);
            set_farthest(beam, packet);
        }
        while (true) {
            do depth--;
            while (stack[depth].entry > beam->t_max);
            if (depth == 0) return;
            int slot = stack[depth].subtree;
            __global const Node *node = traced->top_nodes + (slot >> 3);
            lanes = enter_box(beam, spread, node, slot & 7, packet->t);
            int rays = popcount(lanes.x) + popcount(lanes.y);
            current = node->child[slot & 7];
            if (rays > (any ? FEW_TO_ANY : FEW)) break;
            if (rays == 0) continue;
            trace_scene_alone(traced, lanes, current, any, packet);
            set_farthest(beam, packet);
        }
    }
}
#endif

INLINED void trace_packet(const Traced *traced, bool any, bool parting, Packet *packet)
{
    int16 chosen = packet->t > packet->t_min;
#if !HAS_INSTANCES
    trace_packet_placed(traced, 0, chosen, any, parting, packet);
#else
    Rays rays = { packet->origin_x, packet->origin_y, packet->origin_z, packet->direction_x, packet->direction_y, packet->direction_z };
    while (any16(chosen)) {
        Spread spread;
        Beam beam = take_beam(&rays, packet, traced->bounds, traced->bounds + 3, &chosen, &spread);
        trace_scene_beam(traced, &beam, &spread, any, parting, packet);
    }
#endif
}
