// A ray against the eight boxes of a node and the eight triangles of a block, without leaks.
//
// Triangle: Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection": in a space sheared so that the ray runs along
// its longest axis, the signs of three edge functions decide; neighbours compute the same value for a shared edge. Box:
// Ize 2013, "Robust BVH Ray Traversal", widened by what the shear can move a vertex (Woop et al., section 3.3), so that no
// box hides a triangle that the rounded test hits.
//
// beam.cl does the same sums for sixteen rays and one triangle: the same bits, with contraction off and fma where it is meant.
// The boxes' sums may be contracted: what they let through may differ between processors, but not what is hit.

#include "common/math.cl"
#include "bvh/lanes.cl"

#if HAS_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

#define LARGEST_INVERSE 1e30f   // of a direction; far from overflow
#define LARGEST_OFFSET 3e38f    // finite, so that unused slots, whose planes are at infinity, are not met
#define LEAVE_LATER 1.0000005f  // 1 + 2 gamma(3), and one rounding
#define BIT_LONGER 1.0000003f   // more than a division's rounding: what t <= t_max might keep, before t is known
#define BIT_SHORTER 0.9999997f

typedef struct Ray {
    // The ray meets a plane at t = plane * inverse + offset. Of the two planes of an axis, one is met first, one last; both are
    // moved apart, so that boxes widen. `first`: whether the plane met first is the box's high one.
    float3 near_inverse, far_inverse, near_offset, far_offset;
    int first_x, first_y, first_z;
    // The axes, in cyclic order, the longest of the direction last; origin and shear in that order; shear.z scales.
    int x, y, z;
    float3 origin, shear;
    float t_min;
} Ray;

// Where a ray, or one of several, met a triangle. `triangle` counts through all meshes; `placement`: where the mesh stands.
typedef struct Hit {
    float t, u, v;
    uint triangle, placement;
} Hit;

// A subtree that is still to be visited, and where the ray enters its box.
typedef struct Waiting {
    int subtree;
    float entry;
} Waiting;

// (x, y, z) with axis `longest` last; the order stays cyclic.
inline float3 permute(float3 v, int longest)
{
    return longest == 0 ? v.yzx : longest == 1 ? v.zxy : v;
}

// A ray for tests against boxes and triangles that lie within low .. high.
inline Ray make_ray(float3 origin, float3 direction, float t_min, float3 low, float3 high)
{
    Ray ray;
    float3 size = fabs(direction);
    ray.z = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    ray.x = ray.z == 2 ? 0 : ray.z + 1;
    ray.y = ray.x == 2 ? 0 : ray.x + 1;
    float3 d = permute(direction, ray.z);
    ray.shear = (float3)(-d.x / d.z, -d.y / d.z, 1.0f / d.z);
    ray.origin = permute(origin, ray.z);
    float3 reach = fmax(fabs(origin - low), fabs(origin - high));
    float3 error = 5.0f * UNIT_ROUNDOFF * (reach + permute(reach, ray.z).z);
    error += 4.0f * UNIT_ROUNDOFF * fabs(origin);  // two units in the last place: the rounding of the sums and of the offsets
    float3 inverse = clamp(1.0f / direction, -LARGEST_INVERSE, LARGEST_INVERSE);
    error = copysign(error, inverse);
    ray.near_inverse = inverse;
    ray.far_inverse = inverse * LEAVE_LATER;
    ray.near_offset = clamp(-(origin + error) * ray.near_inverse, -LARGEST_OFFSET, LARGEST_OFFSET);
    ray.far_offset = clamp(-(origin - error) * ray.far_inverse, -LARGEST_OFFSET, LARGEST_OFFSET);
    ray.first_x = inverse.x < 0.0f;
    ray.first_y = inverse.y < 0.0f;
    ray.first_z = inverse.z < 0.0f;
    ray.t_min = t_min;
    return ray;
}

// Where the ray enters each of the eight boxes of a node; lanes of those that it meets within [t_min, t_max].
INLINED ulong enter_boxes(const Ray *ray, __global const Node *node, float t_max, float8 *entries)
{
#pragma OPENCL FP_CONTRACT ON
    __global const float8 *x = (__global const float8 *)node->planes, *y = x + 2, *z = x + 4;
    float8 near_x = x[ray->first_x] * ray->near_inverse.x + ray->near_offset.x;
    float8 near_y = y[ray->first_y] * ray->near_inverse.y + ray->near_offset.y;
    float8 near_z = z[ray->first_z] * ray->near_inverse.z + ray->near_offset.z;
    float8 far_x = x[1 - ray->first_x] * ray->far_inverse.x + ray->far_offset.x;
    float8 far_y = y[1 - ray->first_y] * ray->far_inverse.y + ray->far_offset.y;
    float8 far_z = z[1 - ray->first_z] * ray->far_inverse.z + ray->far_offset.z;
    float8 entry = near_x > near_y ? near_x : near_y, leave = far_x < far_y ? far_x : far_y;
    near_z = near_z > ray->t_min ? near_z : (float8)(ray->t_min);
    far_z = far_z < t_max ? far_z : (float8)(t_max);
    entry = entry > near_z ? entry : near_z;
    leave = leave < far_z ? leave : far_z;
    *entries = entry;
    return lanes8(entry <= leave);
}

// The children of a node in the chosen lanes (at least one): the nearest becomes current, the others go onto the stack, the
// nearest of them last.
INLINED int descend(ulong lanes, float8 entries, __global const int *child, Waiting *stack, int *depth)
{
    uint lane = first_lane(lanes);
    int nearest = child[lane];
    lanes = without_first_lane(lanes);
    if (!lanes) return nearest;
    Floats8 entry;
    entry.all = entries;
    float nearest_entry = entry.lane[lane];
    int bottom = *depth, top = bottom;
    do {
        lane = first_lane(lanes);
        lanes = without_first_lane(lanes);
        Waiting other = { child[lane], entry.lane[lane] };
        if (other.entry < nearest_entry) {
            Waiting farther = { nearest, nearest_entry };
            nearest = other.subtree;
            nearest_entry = other.entry;
            stack[top++] = farther;
            continue;
        }
        int place = top++;
        for (; place > bottom && stack[place - 1].entry < other.entry; place--) stack[place] = stack[place - 1];
        stack[place] = other;
    } while (lanes);
    *depth = top;
    return nearest;
}

// The same in no order, where any hit will do.
inline int descend_unordered(ulong lanes, __global const int *child, Waiting *stack, int *depth)
{
    int one = child[first_lane(lanes)];
    for (lanes = without_first_lane(lanes); lanes; lanes = without_first_lane(lanes)) {
        stack[*depth].subtree = child[first_lane(lanes)];
        stack[(*depth)++].entry = 0.0f;
    }
    return one;
}

// The edge functions of eight triangles: the weights of their vertices, times twice the area.
typedef struct Weights8 {
    float8 of0, of1, of2;
} Weights8;

inline int8 of_one_sign(const Weights8 *w)
{
    return ((w->of0 >= 0.0f) & (w->of1 >= 0.0f) & (w->of2 >= 0.0f)) | ((w->of0 <= 0.0f) & (w->of1 <= 0.0f) & (w->of2 <= 0.0f));
}

#if HAS_FP64
// Where the difference of two products is zero, its sign needs more bits: all three weights anew.
INLINED void sharpen(float8 ax, float8 ay, float8 bx, float8 by, float8 cx, float8 cy, Weights8 *w)
{
    double8 dax = convert_double8(ax), day = convert_double8(ay), dbx = convert_double8(bx), dby = convert_double8(by);
    double8 dcx = convert_double8(cx), dcy = convert_double8(cy);
    int8 zero = (w->of0 == 0.0f) | (w->of1 == 0.0f) | (w->of2 == 0.0f);
    w->of0 = zero ? convert_float8(dcx * dby - dcy * dbx) : w->of0;
    w->of1 = zero ? convert_float8(dax * dcy - day * dcx) : w->of1;
    w->of2 = zero ? convert_float8(dbx * day - dby * dax) : w->of2;
}
#endif

// What a ray meets among the triangles of a block: numerators of t and of the weights of the second and third vertex, over
// a positive denominator; lanes of those that it meets within a little more than (t_min, t_max].
typedef struct Met {
    Floats8 t, u, v, denominator;
} Met;

INLINED ulong meet_block(const Ray *ray, __global const Block *block, float t_max, Met *met)
{
    __global const float8 *x = (__global const float8 *)block->positions + ray->x;
    __global const float8 *y = (__global const float8 *)block->positions + ray->y;
    __global const float8 *z = (__global const float8 *)block->positions + ray->z;
    float8 az = z[0] - ray->origin.z, bz = z[3] - ray->origin.z, cz = z[6] - ray->origin.z;
    float8 shear_x = (float8)(ray->shear.x), shear_y = (float8)(ray->shear.y), shear_z = (float8)(ray->shear.z);
    float8 ax = fma(shear_x, az, x[0] - ray->origin.x), ay = fma(shear_y, az, y[0] - ray->origin.y);
    float8 bx = fma(shear_x, bz, x[3] - ray->origin.x), by = fma(shear_y, bz, y[3] - ray->origin.y);
    float8 cx = fma(shear_x, cz, x[6] - ray->origin.x), cy = fma(shear_y, cz, y[6] - ray->origin.y);
    Weights8 w = { cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax };
    int8 inside = of_one_sign(&w);
    if (!lanes8(inside)) return 0;
#if HAS_FP64
    if (lanes8(inside & ((w.of0 == 0.0f) | (w.of1 == 0.0f) | (w.of2 == 0.0f)))) {
        sharpen(ax, ay, bx, by, cx, cy, &w);
        inside = of_one_sign(&w);
    }
#endif
    float8 determinant = w.of0 + w.of1 + w.of2;
    float8 depth = fma(w.of0, shear_z * az, fma(w.of1, shear_z * bz, w.of2 * (shear_z * cz)));
    int8 sign = as_int8(determinant) & INT_MIN;
    float8 size = as_float8(as_int8(determinant) ^ sign);
    depth = as_float8(as_int8(depth) ^ sign);
    met->denominator.all = size;
    met->t.all = depth;
    met->u.all = as_float8(as_int8(w.of1) ^ sign);
    met->v.all = as_float8(as_int8(w.of2) ^ sign);
    return lanes8(inside & (size > 0.0f) & (depth > size * (ray->t_min * BIT_SHORTER)) & (depth <= size * (t_max * BIT_LONGER)));
}
