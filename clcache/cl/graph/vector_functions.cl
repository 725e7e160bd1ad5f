// Functions of vectors that nodes share.

#include "graph/functions.cl"

NODE float dot_of(float a, float b)
{
    return times(a, b);
}

NODE float dot_of(float2 a, float2 b)
{
    float2 products = times(a, b);
    return products.x + products.y;
}

NODE float dot_of(float3 a, float3 b)
{
    float3 products = times(a, b);
    return products.x + products.y + products.z;
}

NODE float dot_of(float4 a, float4 b)
{
    float4 products = times(a, b);
    return products.x + products.y + products.z + products.w;
}

NODE float3 cross_of(float3 a, float3 b)
{
    return times((float3)(a.y, a.z, a.x), (float3)(b.z, b.x, b.y)) - times((float3)(a.z, a.x, a.y), (float3)(b.y, b.z, b.x));
}

NODE float3_D cross_of(float3_D a, float3_D b)
{
    return with_changes(cross_of(a.v, b.v), cross_of(a.x, b.v) + cross_of(a.v, b.x), cross_of(a.y, b.v) + cross_of(a.v, b.y));
}

NODE float largest_of(float a)
{
    return fabs(a);
}

NODE float largest_of(float2 a)
{
    return fmax(fabs(a.x), fabs(a.y));
}

NODE float largest_of(float3 a)
{
    return fmax(fmax(fabs(a.x), fabs(a.y)), fabs(a.z));
}

NODE float largest_of(float4 a)
{
    return fmax(fmax(fabs(a.x), fabs(a.y)), fmax(fabs(a.z), fabs(a.w)));
}

NODE float component(float a, int index)
{
    return a;
}

NODE float component(float2 a, int index)
{
    return index > 0 ? a.y : a.x;
}

NODE float component(float3 a, int index)
{
    return index > 1 ? a.z : (index > 0 ? a.y : a.x);
}

NODE float component(float4 a, int index)
{
    return index > 2 ? a.w : (index > 1 ? a.z : (index > 0 ? a.y : a.x));
}

// Vectors are scaled by a power of two near their largest component first, so that squares neither over- nor underflow.
#define FOR_EACH_WIDTH(T)                                                                                                    \
    NODE float_D dot_of(T##_D a, T##_D b)                                                                                    \
    {                                                                                                                        \
        return with_changes(dot_of(a.v, b.v), dot_of(a.x, b.v) + dot_of(a.v, b.x), dot_of(a.y, b.v) + dot_of(a.v, b.y));     \
    }                                                                                                                        \
    NODE float length_of(T a)                                                                                                \
    {                                                                                                                        \
        float scale = scale_to_one(largest_of(a));                                                                           \
        T scaled = a * scale;                                                                                                \
        return sqrt(dot_of(scaled, scaled)) / scale;                                                                         \
    }                                                                                                                        \
    NODE T unit_of(T a)                                                                                                      \
    {                                                                                                                        \
        T scaled = a * scale_to_one(largest_of(a));                                                                          \
        float squared = dot_of(scaled, scaled);                                                                              \
        return scaled * (squared > 0.0f ? 1.0f / sqrt(squared) : 0.0f);                                                      \
    }                                                                                                                        \
    NODE float_D length_of(T##_D a)                                                                                          \
    {                                                                                                                        \
        T unit = unit_of(a.v);                                                                                               \
        return with_changes(length_of(a.v), dot_of(unit, a.x), dot_of(unit, a.y));                                           \
    }
FOR_EACH_WIDTH(float)
FOR_EACH_WIDTH(float2)
FOR_EACH_WIDTH(float3)
FOR_EACH_WIDTH(float4)
#undef FOR_EACH_WIDTH

NODE float sine_of_degrees(float degrees)
{
    return sine_of_turns(bounded(degrees, -1e30f, 1e30f) / 360.0f);
}

NODE float cosine_of_degrees(float degrees)
{
    return cosine_of_turns(bounded(degrees, -1e30f, 1e30f) / 360.0f);
}

// Rodrigues' formula for a turn, clockwise, by the angle of sine s and cosine c about a unit vector.
NODE float3 turned_about(float3 a, float3 unit, float s, float c)
{
    return a * c + cross_of(a, unit) * s + unit * (dot_of(unit, a) * (1.0f - c));
}
