// A ray against boxes and triangles, without leaks.
//
// Triangle: Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection": in a space sheared so that the ray runs along
// its longest axis, the signs of three edge functions decide; neighbours compute the same value for a shared edge. Box:
// Ize 2013, "Robust BVH Ray Traversal", widened by what the shear can move a vertex (Woop et al., section 3.3), so that no
// box hides a triangle that the rounded test hits.

#include "common/math.cl"

#if HAS_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

typedef struct Ray {
    float3 inverse;         // of the direction; the largest number where that is zero
    float3 origin_low;      // origin for planes on the boxes' low side, for planes on their high side: moved apart
    float3 origin_high;
    int x, y, z;            // the axes, in cyclic order, the longest of the direction last
    float3 origin, shear;   // in that order; shear.z scales
    float t_min;
} Ray;

typedef struct Hit {
    float t, u, v;
    uint primitive, instance;
} Hit;

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
    ray.shear = (float3)(d.x / d.z, d.y / d.z, 1.0f / d.z);
    float3 reach = fmax(fabs(origin - low), fabs(origin - high));
    float3 error = 5.0f * UNIT_ROUNDOFF * (reach + permute(reach, ray.z).z);
    error += 2.0f * UNIT_ROUNDOFF * fabs(origin);  // a unit in the last place, or far from zero the sum would lose it all
    ray.origin = permute(origin, ray.z);
    ray.inverse = clamp(1.0f / direction, -FLT_MAX, FLT_MAX);
    ray.origin_low = origin + error;
    ray.origin_high = origin - error;
    ray.t_min = t_min;
    return ray;
}

// Where the ray enters a box, given where it meets the near and the far plane of each axis; +infinity if it misses it within
// (t_min, t_max].
inline float enter(float near_x, float near_y, float near_z, float far_x, float far_y, float far_z, float t_min, float t_max)
{
    float entry = near_x > near_y ? near_x : near_y, leave = far_x < far_y ? far_x : far_y;
    entry = near_z > entry ? near_z : entry;
    leave = far_z < leave ? far_z : leave;
    leave *= 1.0000004f;  // 1 + 2 gamma(3)
    entry = t_min > entry ? t_min : entry;
    leave = t_max < leave ? t_max : leave;
    return entry <= leave ? entry : INFINITY;
}

inline float box_entry(const Ray *ray, float3 low, float3 high, float t_max)
{
    float3 to_low = (low - ray->origin_low) * ray->inverse, to_high = (high - ray->origin_high) * ray->inverse;
    float3 near = to_low < to_high ? to_low : to_high, far = to_low < to_high ? to_high : to_low;
    return enter(near.x, near.y, near.z, far.x, far.y, far.z, ray->t_min, t_max);
}

// Intersect, and keep the hit if it is nearer than `hit`, or as near and of a lower number: the result depends neither on
// the tree nor on the order of its children. u and v are the weights of the triangle's second and third vertex. `leaf`: three
// vertices, four numbers apart.
inline bool intersect_triangle(const Ray *ray, __global const float *leaf, uint primitive, uint instance, Hit *hit)
{
    int x = ray->x, y = ray->y, z = ray->z;
    float az = leaf[z] - ray->origin.z, bz = leaf[4 + z] - ray->origin.z, cz = leaf[8 + z] - ray->origin.z;
    float ax = (leaf[x] - ray->origin.x) - ray->shear.x * az, ay = (leaf[y] - ray->origin.y) - ray->shear.y * az;
    float bx = (leaf[4 + x] - ray->origin.x) - ray->shear.x * bz, by = (leaf[4 + y] - ray->origin.y) - ray->shear.y * bz;
    float cx = (leaf[8 + x] - ray->origin.x) - ray->shear.x * cz, cy = (leaf[8 + y] - ray->origin.y) - ray->shear.y * cz;
    float weight0 = cx * by - cy * bx, weight1 = ax * cy - ay * cx, weight2 = bx * ay - by * ax;
#if HAS_FP64
    if (weight0 == 0.0f || weight1 == 0.0f || weight2 == 0.0f) {  // a difference that cancelled: its sign needs more bits
        weight0 = (float)((double)cx * (double)by - (double)cy * (double)bx);
        weight1 = (float)((double)ax * (double)cy - (double)ay * (double)cx);
        weight2 = (float)((double)bx * (double)ay - (double)by * (double)ax);
    }
#endif
    if ((weight0 < 0.0f || weight1 < 0.0f || weight2 < 0.0f) && (weight0 > 0.0f || weight1 > 0.0f || weight2 > 0.0f))
        return false;
    float determinant = weight0 + weight1 + weight2;
    if (determinant == 0.0f) return false;
    float depth = weight0 * (ray->shear.z * az) + weight1 * (ray->shear.z * bz) + weight2 * (ray->shear.z * cz);
    float t = depth / determinant;
    bool nearer = t < hit->t;
    bool tie = t == hit->t && hit->instance != NONE
               && (instance < hit->instance || (instance == hit->instance && primitive < hit->primitive));
    if (!(t > ray->t_min) || !(nearer || tie)) return false;
    hit->t = t;
    hit->u = weight1 / determinant;
    hit->v = weight2 / determinant;
    hit->primitive = primitive;
    hit->instance = instance;
    return true;
}
