// 3x4 row-major transforms of points, vectors and normals.

#include "common/math.cl"

inline OVERLOADED float3 transform_vector(const float *m, float3 v)
{
    return (float3)(m[0] * v.x + m[1] * v.y + m[2] * v.z,
                    m[4] * v.x + m[5] * v.y + m[6] * v.z,
                    m[8] * v.x + m[9] * v.y + m[10] * v.z);
}

inline OVERLOADED Vec3 transform_vector(const float *m, Vec3 v)
{
    return vec3(m[0] * v.x + m[1] * v.y + m[2] * v.z, m[4] * v.x + m[5] * v.y + m[6] * v.z,
                m[8] * v.x + m[9] * v.y + m[10] * v.z);
}

// The translation is added last: the rounding errors of the rest stay relative to the rest.
inline OVERLOADED float3 transform_point(const float *m, float3 p)
{
    return transform_vector(m, p) + (float3)(m[3], m[7], m[11]);
}

inline OVERLOADED Vec3 transform_point(const float *m, Vec3 p)
{
    return add3(transform_vector(m, p), vec3(m[3], m[7], m[11]));
}

// A normal goes to the world by the transpose of the transform to object space. Not of unit length.
inline Vec3 transform_normal(const float *to_object, Vec3 n)
{
    const float *m = to_object;
    return vec3(m[0] * n.x + m[4] * n.y + m[8] * n.z, m[1] * n.x + m[5] * n.y + m[9] * n.z,
                m[2] * n.x + m[6] * n.y + m[10] * n.z);
}

// |m| |v|: the largest that rounding can have met on the way.
inline Vec3 transform_vector_abs(const float *m, Vec3 v)
{
    return vec3(fabs(m[0] * v.x) + fabs(m[1] * v.y) + fabs(m[2] * v.z),
                fabs(m[4] * v.x) + fabs(m[5] * v.y) + fabs(m[6] * v.z),
                fabs(m[8] * v.x) + fabs(m[9] * v.y) + fabs(m[10] * v.z));
}

inline Vec3 translation_abs(const float *m)
{
    return vec3(fabs(m[3]), fabs(m[7]), fabs(m[11]));
}
