// Sixteen rays against a box, or together against the eight boxes of a node, by the intervals that hold all their origins and
// all of 1 / direction; and against a triangle, by the sums of intersect.cl.

#include "bvh/traced.cl"

#define RAYS 16u

typedef struct Packet {
    float16 origin_x, origin_y, origin_z, direction_x, direction_y, direction_z, t_min;
    float16 t, u, v;  // of the hits; t as it was given where there is none, -infinity of what is not traced (any more)
    int16 triangle, placement;
} Packet;

// A number for the signs of a direction and its longest axis.
inline int16 direction_class(float16 inverse_x, float16 inverse_y, float16 inverse_z, float16 x, float16 y, float16 z)
{
    int16 z_over_x = (x > z) ? (int16)(0) : (int16)(2), z_over_y = (y > z) ? (int16)(1) : (int16)(2);
    int16 longest = x > y ? z_over_x : z_over_y;
    return longest | ((inverse_x < 0.0f) & 4) | ((inverse_y < 0.0f) & 8) | ((inverse_z < 0.0f) & 16);
}

// Sixteen rays in the space of what they are traced against, which lies within low .. high.
typedef struct Rays {
    float16 origin_x, origin_y, origin_z, x, y, z;
} Rays;

// Some of the rays, with one sign of direction on each axis, for tests against boxes and triangles within low .. high.
typedef struct Beam {
    int16 rays;
    // As in Ray, but lowest and highest over the rays.
    float near_inverse_low[3], near_inverse_high[3], far_inverse_low[3], far_inverse_high[3], near_offset_low[3], near_offset_high[3];
    float far_offset_low[3], far_offset_high[3];
    int first[3];
    int x, y, z;
    float16 origin_x, origin_y, origin_z, shear_x, shear_y, shear_z;  // in the order of the axes x, y, z
    float t_min, t_max;
} Beam;

inline float16 pick(int axis, float16 x, float16 y, float16 z)
{
    return axis == 0 ? x : axis == 1 ? y : z;
}

INLINED void set_axis(Beam *beam, int axis, int16 rays, float16 origin, float16 error, float16 inverse, bool backward)
{
    float16 none = (float16)(INFINITY);
    float low = lowest16(rays ? inverse : none), high = highest16(rays ? inverse : -none);
    float near = backward ? lowest16(rays ? origin - error : none) : highest16(rays ? origin + error : -none);
    float far = backward ? highest16(rays ? origin + error : -none) : lowest16(rays ? origin - error : none);
    beam->first[axis] = backward;
    beam->near_inverse_low[axis] = low;
    beam->near_inverse_high[axis] = high;
    beam->far_inverse_low[axis] = low * LEAVE_LATER;
    beam->far_inverse_high[axis] = high * LEAVE_LATER;
    beam->near_offset_low[axis] = clamp(-near * beam->near_inverse_low[axis], -LARGEST_OFFSET, LARGEST_OFFSET);
    beam->near_offset_high[axis] = clamp(-near * beam->near_inverse_high[axis], -LARGEST_OFFSET, LARGEST_OFFSET);
    beam->far_offset_low[axis] = clamp(-far * beam->far_inverse_low[axis], -LARGEST_OFFSET, LARGEST_OFFSET);
    beam->far_offset_high[axis] = clamp(-far * beam->far_inverse_high[axis], -LARGEST_OFFSET, LARGEST_OFFSET);
}

inline void set_farthest(Beam *beam, const Packet *packet)
{
    beam->t_max = highest16(beam->rays ? packet->t : (float16)(-INFINITY));
}

// What beams are narrowed from, ray by ray; near_inverse to shear as in Ray.
typedef struct Spread {
    Floats16 near_inverse[3], far_inverse[3], near_offset[3], far_offset[3], origin[3], shear[3], t_min;
} Spread;

inline void spread_axis(Spread *spread, int axis, float16 origin, float16 error, float16 inverse)
{
    const float16 most = (float16)(LARGEST_OFFSET);
    error = copysign(error, inverse);
    spread->near_inverse[axis].all = inverse;
    spread->far_inverse[axis].all = inverse * LEAVE_LATER;
    spread->near_offset[axis].all = clamp(-(origin + error) * spread->near_inverse[axis].all, -most, most);
    spread->far_offset[axis].all = clamp(-(origin - error) * spread->far_inverse[axis].all, -most, most);
}

// Those of the chosen rays that go with the first of them; *chosen are the others then.
INLINED Beam take_beam(const Rays *rays, const Packet *packet, __global const float *low, __global const float *high, int16 *chosen,
                      Spread *spread)
{
    const float16 most = (float16)(LARGEST_INVERSE);
    float16 inverse_x = clamp(1.0f / rays->x, -most, most);
    float16 inverse_y = clamp(1.0f / rays->y, -most, most);
    float16 inverse_z = clamp(1.0f / rays->z, -most, most);
    float16 reach_x = fmax(fabs(rays->origin_x - low[0]), fabs(rays->origin_x - high[0]));
    float16 reach_y = fmax(fabs(rays->origin_y - low[1]), fabs(rays->origin_y - high[1]));
    float16 reach_z = fmax(fabs(rays->origin_z - low[2]), fabs(rays->origin_z - high[2]));
    Ints16 class;
    class.all = direction_class(inverse_x, inverse_y, inverse_z, fabs(rays->x), fabs(rays->y), fabs(rays->z));
    ulong2 lanes = lanes16(*chosen);
    int own = class.lane[first_lane16(lanes)];

    Beam beam;
    beam.rays = *chosen & (class.all == own);
    *chosen &= ~beam.rays;
    beam.z = own & 3;
    beam.x = beam.z == 2 ? 0 : beam.z + 1;
    beam.y = beam.x == 2 ? 0 : beam.x + 1;
    float16 along = pick(beam.z, rays->x, rays->y, rays->z), farther = pick(beam.z, reach_x, reach_y, reach_z);
    beam.shear_x = -pick(beam.x, rays->x, rays->y, rays->z) / along;
    beam.shear_y = -pick(beam.y, rays->x, rays->y, rays->z) / along;
    beam.shear_z = 1.0f / along;
    beam.origin_x = pick(beam.x, rays->origin_x, rays->origin_y, rays->origin_z);
    beam.origin_y = pick(beam.y, rays->origin_x, rays->origin_y, rays->origin_z);
    beam.origin_z = pick(beam.z, rays->origin_x, rays->origin_y, rays->origin_z);
    float16 error_x = 5.0f * UNIT_ROUNDOFF * (reach_x + farther) + 4.0f * UNIT_ROUNDOFF * fabs(rays->origin_x);
    float16 error_y = 5.0f * UNIT_ROUNDOFF * (reach_y + farther) + 4.0f * UNIT_ROUNDOFF * fabs(rays->origin_y);
    float16 error_z = 5.0f * UNIT_ROUNDOFF * (reach_z + farther) + 4.0f * UNIT_ROUNDOFF * fabs(rays->origin_z);
    set_axis(&beam, 0, beam.rays, rays->origin_x, error_x, inverse_x, own & 4);
    set_axis(&beam, 1, beam.rays, rays->origin_y, error_y, inverse_y, own & 8);
    set_axis(&beam, 2, beam.rays, rays->origin_z, error_z, inverse_z, own & 16);
    beam.t_min = lowest16(beam.rays ? packet->t_min : (float16)(INFINITY));
    set_farthest(&beam, packet);
    if (!spread) return beam;
    spread_axis(spread, 0, rays->origin_x, error_x, inverse_x);
    spread_axis(spread, 1, rays->origin_y, error_y, inverse_y);
    spread_axis(spread, 2, rays->origin_z, error_z, inverse_z);
    spread->origin[0].all = beam.origin_x;
    spread->origin[1].all = beam.origin_y;
    spread->origin[2].all = beam.origin_z;
    spread->shear[0].all = beam.shear_x;
    spread->shear[1].all = beam.shear_y;
    spread->shear[2].all = beam.shear_z;
    spread->t_min.all = packet->t_min;
    return beam;
}

// Which of eight boxes the rays may meet, and where the first of them may enter each. first, last: of the planes across each
// axis, those met first and last.
INLINED ulong enter_together(const Beam *beam, const float8 *first, const float8 *last, float8 *entries)
{
#pragma OPENCL FP_CONTRACT ON
    float8 entry = (float8)(beam->t_min), leave = (float8)(beam->t_max);
#pragma unroll
    for (int axis = 0; axis < 3; axis++) {
        float8 near_low = first[axis] * beam->near_inverse_low[axis] + beam->near_offset_low[axis];
        float8 near_high = first[axis] * beam->near_inverse_high[axis] + beam->near_offset_high[axis];
        float8 far_low = last[axis] * beam->far_inverse_low[axis] + beam->far_offset_low[axis];
        float8 far_high = last[axis] * beam->far_inverse_high[axis] + beam->far_offset_high[axis];
        float8 near = near_low < near_high ? near_low : near_high, far = far_low > far_high ? far_low : far_high;
        entry = near > entry ? near : entry;
        leave = far < leave ? far : leave;
    }
    *entries = entry;
    return lanes8(entry <= leave);
}

INLINED ulong enter_boxes_together(const Beam *beam, __global const Node *node, float8 *entries)
{
    __global const float8 *planes = (__global const float8 *)node->planes;
    float8 first[3], last[3];
#pragma unroll
    for (int axis = 0; axis < 3; axis++) {
        first[axis] = planes[2 * axis + beam->first[axis]];
        last[axis] = planes[2 * axis + 1 - beam->first[axis]];
    }
    return enter_together(beam, first, last, entries);
}

// Those of the first `count` triangles of a block whose boxes the rays may meet.
INLINED ulong enter_triangles_together(const Beam *beam, __global const Block *block, uint count)
{
    __global const float8 *rows = (__global const float8 *)block->positions;
    float8 first[3], last[3], entries;
#pragma unroll
    for (int axis = 0; axis < 3; axis++) {
        float8 a = rows[axis], b = rows[3 + axis], c = rows[6 + axis];
        float8 low = a < b ? a : b, high = a > b ? a : b;
        low = c < low ? c : low;
        high = c > high ? c : high;
        first[axis] = beam->first[axis] ? high : low;
        last[axis] = beam->first[axis] ? low : high;
    }
    return enter_together(beam, first, last, &entries) & (ulong)-1 >> (64 - 8 * count);
}

// Which of the beam's rays meet the box in one lane of a node.
INLINED ulong2 enter_box(const Beam *beam, const Spread *spread, __global const Node *node, uint lane, float16 t_max)
{
#pragma OPENCL FP_CONTRACT ON
    float16 entry = spread->t_min.all, leave = t_max;
#pragma unroll
    for (int axis = 0; axis < 3; axis++) {
        float first = node->planes[8 * (2 * axis + beam->first[axis]) + lane];
        float last = node->planes[8 * (2 * axis + 1 - beam->first[axis]) + lane];
        float16 near = first * spread->near_inverse[axis].all + spread->near_offset[axis].all;
        float16 far = last * spread->far_inverse[axis].all + spread->far_offset[axis].all;
        entry = near > entry ? near : entry;
        leave = far < leave ? far : leave;
    }
    return lanes16((entry <= leave) & beam->rays);
}

inline Ray spread_ray(const Spread *spread, const Beam *beam, uint lane)
{
    Ray ray;
#define OF_LANE(v) (float3)(spread->v[0].lane[lane], spread->v[1].lane[lane], spread->v[2].lane[lane])
    ray.near_inverse = OF_LANE(near_inverse);
    ray.far_inverse = OF_LANE(far_inverse);
    ray.near_offset = OF_LANE(near_offset);
    ray.far_offset = OF_LANE(far_offset);
    ray.origin = OF_LANE(origin);
    ray.shear = OF_LANE(shear);
#undef OF_LANE
    ray.first_x = beam->first[0];
    ray.first_y = beam->first[1];
    ray.first_z = beam->first[2];
    ray.x = beam->x;
    ray.y = beam->y;
    ray.z = beam->z;
    ray.t_min = spread->t_min.lane[lane];
    return ray;
}

typedef struct Weights16 {
    float16 of0, of1, of2;
} Weights16;

inline int16 of_one_sign16(const Weights16 *w)
{
    return ((w->of0 >= 0.0f) & (w->of1 >= 0.0f) & (w->of2 >= 0.0f)) | ((w->of0 <= 0.0f) & (w->of1 <= 0.0f) & (w->of2 <= 0.0f));
}

#if HAS_FP64
inline void sharpen16(float16 ax, float16 ay, float16 bx, float16 by, float16 cx, float16 cy, Weights16 *w)
{
    double16 dax = convert_double16(ax), day = convert_double16(ay), dbx = convert_double16(bx), dby = convert_double16(by);
    double16 dcx = convert_double16(cx), dcy = convert_double16(cy);
    int16 zero = (w->of0 == 0.0f) | (w->of1 == 0.0f) | (w->of2 == 0.0f);
    w->of0 = zero ? convert_float16(dcx * dby - dcy * dbx) : w->of0;
    w->of1 = zero ? convert_float16(dax * dcy - day * dcx) : w->of1;
    w->of2 = zero ? convert_float16(dbx * day - dby * dax) : w->of2;
}
#endif

// Of `met`, the rays whose hit at t counts.
INLINED int16 that_count(const Traced *traced, const Packet *packet, int16 met, float16 t, float16 u, float16 v, uint triangle,
                        uint placement)
{
    met &= (t > packet->t_min) & (t <= packet->t);
    int16 equal = t == packet->t;
#if HAS_INSTANCES || HAS_ALPHA
    Ints16 chosen, triangles, placements;
    Floats16 at, us, vs, limits;
    chosen.all = met;
    triangles.all = packet->triangle;
    placements.all = packet->placement;
    at.all = t;
    us.all = u;
    vs.all = v;
    limits.all = packet->t;
    for (int lane = 0; lane < RAYS; lane++) {
        if (!chosen.lane[lane]) continue;
        Hit hit = { limits.lane[lane], 0.0f, 0.0f, (uint)triangles.lane[lane], (uint)placements.lane[lane] };
        bool counts = replaces(traced, at.lane[lane], triangle, placement, &hit);
        chosen.lane[lane] = counts && !passes_hole(traced, triangle, placement, us.lane[lane], vs.lane[lane]) ? -1 : 0;
    }
    return chosen.all;
#else
    // Triangles count below 2^31; NONE is below them all.
    return met & (~equal | (packet->triangle > (int16)((int)triangle)));
#endif
}

// One triangle against the rays. True if one of them met it.
INLINED bool meet_triangle(const Traced *traced, const Beam *beam, __global const Block *block, uint lane, uint placement,
                          bool any, Packet *packet)
{
    __global const float *x = block->positions + 8 * beam->x + lane, *y = block->positions + 8 * beam->y + lane;
    __global const float *z = block->positions + 8 * beam->z + lane;
    float16 az = z[0] - beam->origin_z, bz = z[24] - beam->origin_z, cz = z[48] - beam->origin_z;
    float16 ax = fma(beam->shear_x, az, x[0] - beam->origin_x), ay = fma(beam->shear_y, az, y[0] - beam->origin_y);
    float16 bx = fma(beam->shear_x, bz, x[24] - beam->origin_x), by = fma(beam->shear_y, bz, y[24] - beam->origin_y);
    float16 cx = fma(beam->shear_x, cz, x[48] - beam->origin_x), cy = fma(beam->shear_y, cz, y[48] - beam->origin_y);
    Weights16 w = { cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax };
    int16 inside = of_one_sign16(&w) & beam->rays;
    if (!any16(inside)) return false;
#if HAS_FP64
    if (any16(inside & ((w.of0 == 0.0f) | (w.of1 == 0.0f) | (w.of2 == 0.0f)))) {
        sharpen16(ax, ay, bx, by, cx, cy, &w);
        inside &= of_one_sign16(&w);
    }
#endif
    float16 determinant = w.of0 + w.of1 + w.of2;
    float16 depth = fma(w.of0, beam->shear_z * az, fma(w.of1, beam->shear_z * bz, w.of2 * (beam->shear_z * cz)));
    int16 met = inside & (determinant != 0.0f);
    float16 t = depth / determinant, u = w.of1 / determinant, v = w.of2 / determinant;
    uint triangle = block->triangle[lane];
    met = that_count(traced, packet, met, t, u, v, triangle, placement);
    if (!any16(met)) return false;
    packet->t = met ? (any ? (float16)(-INFINITY) : t) : packet->t;
    packet->triangle = met ? (int16)((int)triangle) : packet->triangle;
    if (any) return true;
    packet->u = met ? u : packet->u;
    packet->v = met ? v : packet->v;
#if HAS_INSTANCES
    packet->placement = met ? (int16)((int)placement) : packet->placement;
#endif
    return true;
}
