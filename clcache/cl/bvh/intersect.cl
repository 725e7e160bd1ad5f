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
    float3 origin;
    float3 inverse;      // of the direction; infinite where it is zero
    float3 origin_low;   // origin for planes on the boxes' low side, for planes on their high side: moved apart
    float3 origin_high;
    float3 shear;        // x, y: shear; z: scale, of the permuted axes
    int longest;         // axis that becomes z
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
    ray.longest = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    float3 d = permute(direction, ray.longest);
    ray.shear = (float3)(d.x / d.z, d.y / d.z, 1.0f / d.z);
    float3 reach = fmax(fabs(origin - low), fabs(origin - high));
    float3 error = 5.0f * UNIT_ROUNDOFF * (reach + permute(reach, ray.longest).z);
    error += 2.0f * UNIT_ROUNDOFF * fabs(origin);  // a unit in the last place, or far from zero the sum would lose it all
    ray.origin = origin;
    ray.inverse = 1.0f / direction;
    ray.origin_low = origin + error;
    ray.origin_high = origin - error;
    ray.t_min = t_min;
    return ray;
}

// Where the ray enters the box, or +infinity if it misses it within (t_min, t_max]. A NaN (a ray within a plane of the box)
// loses every comparison, so that it never excludes.
inline float box_entry(const Ray *ray, float3 low, float3 high, float t_max)
{
    float3 to_low = (low - ray->origin_low) * ray->inverse, to_high = (high - ray->origin_high) * ray->inverse;
    float entry = ray->t_min, leave = t_max;
    float near_x = ray->inverse.x < 0.0f ? to_high.x : to_low.x, far_x = ray->inverse.x < 0.0f ? to_low.x : to_high.x;
    float near_y = ray->inverse.y < 0.0f ? to_high.y : to_low.y, far_y = ray->inverse.y < 0.0f ? to_low.y : to_high.y;
    float near_z = ray->inverse.z < 0.0f ? to_high.z : to_low.z, far_z = ray->inverse.z < 0.0f ? to_low.z : to_high.z;
    entry = near_x > entry ? near_x : entry;
    entry = near_y > entry ? near_y : entry;
    entry = near_z > entry ? near_z : entry;
    const float widen = 1.0000004f;  // 1 + 2 gamma(3)
    leave = far_x * widen < leave ? far_x * widen : leave;
    leave = far_y * widen < leave ? far_y * widen : leave;
    leave = far_z * widen < leave ? far_z * widen : leave;
    return entry <= leave ? entry : INFINITY;
}

// Intersect, and keep the hit if it is nearer than `hit`, or as near and of a lower number: the result depends neither on
// the tree nor on the order of its children. u and v are the weights of the triangle's second and third vertex.
inline bool intersect_triangle(const Ray *ray, float3 v0, float3 v1, float3 v2, uint primitive, uint instance, Hit *hit)
{
    float3 a = permute(v0 - ray->origin, ray->longest);
    float3 b = permute(v1 - ray->origin, ray->longest);
    float3 c = permute(v2 - ray->origin, ray->longest);
    float ax = a.x - ray->shear.x * a.z, ay = a.y - ray->shear.y * a.z;
    float bx = b.x - ray->shear.x * b.z, by = b.y - ray->shear.y * b.z;
    float cx = c.x - ray->shear.x * c.z, cy = c.y - ray->shear.y * c.z;
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
    float depth = weight0 * (ray->shear.z * a.z) + weight1 * (ray->shear.z * b.z) + weight2 * (ray->shear.z * c.z);
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
