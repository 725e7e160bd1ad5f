// Rays in, hits out: sixteen in a row, or sixteen that are alike out of a chunk.

#include "bvh/packet.cl"

// What is not made of numbers, or begins farther out than FARTHEST, or has a longer direction, hits nothing; far enough from
// overflow that the spaces of instances may be larger.
#define FARTHEST 1e31f

inline void drop_wild_rays(Packet *packet)
{
    float16 away = fabs(packet->origin_x) + fabs(packet->origin_y) + fabs(packet->origin_z);
    float16 size = fabs(packet->direction_x) + fabs(packet->direction_y) + fabs(packet->direction_z);
    int16 is_tame = (away < FARTHEST) & (size < FARTHEST);
    packet->t = is_tame ? packet->t : (float16)(-INFINITY);
}

// The rays first .. first + 15 of n; the last one again, not to be traced, where there are no more.
INLINED Packet load_packet(__global const float *origins, __global const float *directions, __global const float *t_mins,
                          __global const float *lengths, uint n, uint first)
{
    const int16 lanes = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    size_t plane = n;
    Packet packet;
    packet.origin_x = load16(origins, n, first);
    packet.origin_y = load16(origins + plane, n, first);
    packet.origin_z = load16(origins + 2 * plane, n, first);
    packet.direction_x = load16(directions, n, first);
    packet.direction_y = load16(directions + plane, n, first);
    packet.direction_z = load16(directions + 2 * plane, n, first);
    packet.t_min = t_mins ? load16(t_mins, n, first) : (float16)(0.0f);
    float16 length = load16(lengths, n, first);
    int16 is_ray = (length > packet.t_min) & (lanes < (int16)(min(n - first, RAYS)));
    packet.t = is_ray ? length : (float16)(-INFINITY);
    drop_wild_rays(&packet);
    packet.u = packet.v = (float16)(0.0f);
    packet.triangle = packet.placement = (int16)(NONE);
    return packet;
}

// Whether all the hits are of one instance, as they mostly are; its number, and its first triangle, then.
INLINED bool are_of_one(const Traced *traced, const Packet *packet, int16 found, uint *instance, uint *first_triangle)
{
    if (!any16(found)) return true;
    Ints16 triangle, placement;
    triangle.all = packet->triangle;
    placement.all = packet->placement;
    ulong2 lanes = lanes16(found);
    uint lane = first_lane16(lanes);
#if HAS_INSTANCES
    __global const Instance *placed = traced->placed + placement.lane[lane];
    if (any16(found & (packet->placement != placement.lane[lane]))) return false;
    if (placed->number != NONE) {
        *instance = placed->number;
        *first_triangle = placed->first_triangle;
        return true;
    }
#endif
    uint joined = find_joined(traced, triangle.lane[lane]);
    int begin = traced->joined_first[joined], end = traced->joined_first[joined + 1];
    *instance = traced->joined_instance[joined];
    *first_triangle = begin;
    return !any16(found & ((packet->triangle < begin) | (packet->triangle >= end)));
}

// The hits of the first `count` of the packet's rays, to begin + order[0 .. count - 1].
inline void scatter_hits(const Traced *traced, const Packet *packet, __global float *t, __global float *uv,
                         __global uint *primitive, __global uint *instance, uint n, uint begin, const ushort *order, uint count)
{
    Ints16 triangle, placement;
    Floats16 ts, us, vs;
    triangle.all = packet->triangle;
    placement.all = packet->placement;
    ts.all = packet->t;
    us.all = packet->u;
    vs.all = packet->v;
    for (uint lane = 0; lane < count; lane++) {
        uint i = begin + order[lane];
        bool found = triangle.lane[lane] != (int)NONE;
        uint2 name = found ? name_triangle(traced, triangle.lane[lane], placement.lane[lane]) : (uint2)(NONE);
        t[i] = found ? ts.lane[lane] : INFINITY;
        uv[i] = us.lane[lane];
        uv[n + i] = vs.lane[lane];
        primitive[i] = name.y;
        instance[i] = name.x;
    }
}

INLINED void store_hits(const Traced *traced, const Packet *packet, __global float *t, __global float *uv,
                       __global uint *primitive, __global uint *instance, uint n, uint first)
{
    int16 found = packet->triangle != (int)NONE;
    float16 distance = found ? packet->t : (float16)(INFINITY);
    uint number = NONE, first_triangle = 0;
    if (n - first >= RAYS && are_of_one(traced, packet, found, &number, &first_triangle)) {
        vstore16(distance, 0, t + first);
        vstore16(packet->u, 0, uv + first);
        vstore16(packet->v, 0, uv + n + first);
        vstore16(as_uint16(found ? packet->triangle - (int)first_triangle : (int16)(NONE)), 0, primitive + first);
        vstore16(as_uint16(found ? (int16)(number) : (int16)(NONE)), 0, instance + first);
        return;
    }
    ushort in_a_row[RAYS];
    for (uint lane = 0; lane < RAYS; lane++) in_a_row[lane] = lane;
    scatter_hits(traced, packet, t, uv, primitive, instance, n, first, in_a_row, min(RAYS, n - first));
}

inline void store_occluded(const Packet *packet, __global uchar *occluded, uint n, uint first)
{
    int16 found = packet->triangle != (int)NONE;
    if (n - first >= RAYS) {
        vstore16(as_uchar16(convert_char16(found) & (char16)(1)), 0, occluded + first);
        return;
    }
    Ints16 each;
    each.all = found;
    for (uint lane = 0; first + lane < n; lane++) occluded[first + lane] = each.lane[lane] != 0;
}

// For a chunk of rays, which need not be alike: their places in an order in which those that are alike follow each other, and
// those that are not to be traced come last. A counting sort by the class of direction; within a class the order stays, and
// so neighbours in it are near each other. Returns how many are to be traced.
#define CHUNK 4096
#define IDLE 31  // a class that no direction has

inline uint order_chunk(__global const float *directions, __global const float *t_mins, __global const float *lengths, uint n,
                        uint begin, uint rays, ushort *order)
{
    uchar class_of[CHUNK];
    uint places[IDLE + 1];
    for (uint class = 0; class <= IDLE; class++) places[class] = 0;
    for (uint i = 0; i < rays; i += RAYS) {
        float16 x = load16(directions, n, begin + i), y = load16(directions + n, n, begin + i);
        float16 z = load16(directions + 2 * (size_t)n, n, begin + i);
        float16 t_min = t_mins ? load16(t_mins, n, begin + i) : (float16)(0.0f);
        Ints16 classes;
        classes.all = load16(lengths, n, begin + i) > t_min ? direction_class(x, y, z, fabs(x), fabs(y), fabs(z)) : (int16)(IDLE);
        for (uint lane = 0; lane < min(RAYS, rays - i); lane++) {
            class_of[i + lane] = classes.lane[lane];
            places[classes.lane[lane]]++;
        }
    }
    uint before = 0;
    for (uint class = 0; class <= IDLE; class++) {
        uint here = places[class];
        places[class] = before;
        before += here;
    }
    uint traced = places[IDLE];
    for (uint i = 0; i < rays; i++) order[places[class_of[i]]++] = i;
    return traced;
}

// The rays at begin + order[0 .. count - 1]; the last one again, not to be traced, where these are fewer than sixteen.
inline Packet gather_packet(__global const float *origins, __global const float *directions, __global const float *t_mins,
                            __global const float *lengths, uint n, uint begin, const ushort *order, uint count)
{
    Floats16 v[8];
    for (uint lane = 0; lane < RAYS; lane++) {
        uint i = begin + order[min(lane, count - 1)];
        for (uint axis = 0; axis < 3; axis++) {
            v[axis].lane[lane] = origins[axis * (size_t)n + i];
            v[3 + axis].lane[lane] = directions[axis * (size_t)n + i];
        }
        v[6].lane[lane] = t_mins ? t_mins[i] : 0.0f;
        v[7].lane[lane] = lane < count ? lengths[i] : -INFINITY;
    }
    Packet packet = { v[0].all, v[1].all, v[2].all, v[3].all, v[4].all, v[5].all, v[6].all, v[7].all };
    drop_wild_rays(&packet);
    packet.u = packet.v = (float16)(0.0f);
    packet.triangle = packet.placement = (int16)(NONE);
    return packet;
}

inline void scatter_occluded(const Packet *packet, __global uchar *occluded, uint begin, const ushort *order, uint count)
{
    Ints16 triangle;
    triangle.all = packet->triangle;
    for (uint lane = 0; lane < count; lane++) occluded[begin + order[lane]] = triangle.lane[lane] != (int)NONE;
}

inline void scatter_misses(__global float *t, __global float *uv, __global uint *primitive, __global uint *instance, uint n,
                           uint begin, const ushort *order, uint count)
{
    for (uint k = 0; k < count; k++) {
        uint i = begin + order[k];
        t[i] = INFINITY;
        uv[i] = uv[n + i] = 0.0f;
        primitive[i] = instance[i] = NONE;
    }
}
