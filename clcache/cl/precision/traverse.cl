// A ray against eight boxes and against eight triangles, by themselves, as traversal tests them.
//
// Define: HAS_FP64.

#include "bvh/intersect.cl"

// One work-item per ray and block: the nearest of the triangles that it meets: t, u, v; its lane, or -1; the boxes that it enters, as bits.
ONE_BY_ONE __kernel void measure(
    __global const Node *nodes,        // (n)
    __global const Block *blocks,      // (n)
    __global const float *origins,     // (n, 3)
    __global const float *directions,  // (n, 3)
    __global const float *bounds,      // (6)
    __global float *found,             // (n, 3)
    __global int *lanes,               // (n, 2)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    float3 low = (float3)(bounds[0], bounds[1], bounds[2]), high = (float3)(bounds[3], bounds[4], bounds[5]);
    float3 origin = (float3)(origins[3 * i], origins[3 * i + 1], origins[3 * i + 2]);
    float3 direction = (float3)(directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]);
    Ray ray = make_ray(origin, direction, 0.0f, low, high);
    float8 entries;
    ulong entered = enter_boxes(&ray, nodes + i, 1e30f, &entries);
    int boxes = 0, nearest = -1;
    for (; entered; entered = without_first_lane(entered)) boxes |= 1 << first_lane(entered);
    Met met;
    float t = 1e30f, u = 0.0f, v = 0.0f;
    for (ulong hit = meet_block(&ray, blocks + i, 1e30f, &met); hit; hit = without_first_lane(hit)) {
        uint lane = first_lane(hit);
        float size = met.denominator.lane[lane], at = met.t.lane[lane] / size;
        if (at >= t) continue;
        t = at;
        u = met.u.lane[lane] / size;
        v = met.v.lane[lane] / size;
        nearest = (int)lane;
    }
    found[3 * i] = t;
    found[3 * i + 1] = u;
    found[3 * i + 2] = v;
    lanes[2 * i] = nearest;
    lanes[2 * i + 1] = boxes;
}
