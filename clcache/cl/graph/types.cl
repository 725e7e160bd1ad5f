// Types of the values that flow along a material graph's edges.
//
// A value of type T_D carries its change along the two axes of the ray cone's footprint, as texture lookups need them to
// choose a mip level (thesis, section 5.1): v is the value, x and y are its differences over one footprint's extent, to first
// order.
//
// No function of cl/graph gives NaN for finite inputs: products and quotients end at the largest float, and what would divide
// by zero or leave its domain says what it gives instead. Sums may become infinite. That does no harm either: nothing is
// converted to an integer before it is bounded, and finite_or_zero ends the way of such values at the graph's outputs.

#include "common/math.cl"

#define NODE static inline __attribute__((overloadable))
#ifndef NOINLINE
#define NOINLINE __attribute__((noinline))
#endif

typedef struct float_D {
    float v, x, y;
} float_D;

typedef struct float2_D {
    float2 v, x, y;
} float2_D;

typedef struct float3_D {
    float3 v, x, y;
} float3_D;

typedef struct float4_D {
    float4 v, x, y;
} float4_D;

// Where a graph is evaluated. uv: texture coordinates; position, normal: in object space.
typedef struct GraphInputs {
    float2_D uv;
    float3_D position;
    float3 normal;
} GraphInputs;

// with_changes: a value and its changes. chain: a function's value v and its changes by the chain rule, from its partial
// derivatives, component by component, with respect to each argument. unchanging: a value that is the same all over the
// footprint.
#define FOR_EACH_WIDTH(T)                                                                                                    \
    NODE T##_D with_changes(T v, T x, T y)                                                                                   \
    {                                                                                                                        \
        T##_D result = { v, x, y };                                                                                          \
        return result;                                                                                                       \
    }                                                                                                                        \
    NODE T##_D unchanging(T v)                                                                                               \
    {                                                                                                                        \
        return with_changes(v, (T)(0.0f), (T)(0.0f));                                                                        \
    }                                                                                                                        \
    NODE T##_D chain(T v, T by_a, T##_D a)                                                                                   \
    {                                                                                                                        \
        return with_changes(v, by_a * a.x, by_a * a.y);                                                                      \
    }                                                                                                                        \
    NODE T##_D chain(T v, T by_a, T##_D a, T by_b, T##_D b)                                                                  \
    {                                                                                                                        \
        return with_changes(v, by_a * a.x + by_b * b.x, by_a * a.y + by_b * b.y);                                            \
    }                                                                                                                        \
    NODE T##_D chain(T v, T by_a, T##_D a, T by_b, T##_D b, T by_c, T##_D c)                                                 \
    {                                                                                                                        \
        return with_changes(v, by_a * a.x + by_b * b.x + by_c * c.x, by_a * a.y + by_b * b.y + by_c * c.y);                  \
    }                                                                                                                        \
    NODE T finite_or_zero(T v)                                                                                               \
    {                                                                                                                        \
        return fabs(v) <= (T)(3.402823466e38f) ? v : (T)(0.0f);                                                              \
    }
FOR_EACH_WIDTH(float)
FOR_EACH_WIDTH(float2)
FOR_EACH_WIDTH(float3)
FOR_EACH_WIDTH(float4)
#undef FOR_EACH_WIDTH

// Conversions that type inference may insert: to_T of the same type, of a float (repeated), and between float3 and float4
// (alpha 1); from a type with changes to one with or without; from one without to one with only for what does not change.
NODE float to_float(float a)
{
    return a;
}

NODE float2 to_float2(float a)
{
    return (float2)(a, a);
}

NODE float2 to_float2(float2 a)
{
    return a;
}

NODE float3 to_float3(float a)
{
    return (float3)(a, a, a);
}

NODE float3 to_float3(float3 a)
{
    return a;
}

NODE float3 to_float3(float4 a)
{
    return (float3)(a.x, a.y, a.z);
}

NODE float4 to_float4(float a)
{
    return (float4)(a, a, a, a);
}

NODE float4 to_float4(float3 a)
{
    return (float4)(a.x, a.y, a.z, 1.0f);
}

NODE float4 to_float4(float4 a)
{
    return a;
}

#define CONVERSIONS_WITH_CHANGES(T, S, CHANGE_OF)                                                                            \
    NODE T to_##T(S##_D a)                                                                                                   \
    {                                                                                                                        \
        return to_##T(a.v);                                                                                                  \
    }                                                                                                                        \
    NODE T##_D to_##T##_D(S##_D a)                                                                                           \
    {                                                                                                                        \
        return with_changes(to_##T(a.v), CHANGE_OF(a.x), CHANGE_OF(a.y));                                                    \
    }                                                                                                                        \
    NODE T##_D to_##T##_D(S a)                                                                                               \
    {                                                                                                                        \
        return unchanging(to_##T(a));                                                                                        \
    }
#define CHANGE_WITH_ALPHA(a) (float4)((a).x, (a).y, (a).z, 0.0f)
CONVERSIONS_WITH_CHANGES(float, float, to_float)
CONVERSIONS_WITH_CHANGES(float2, float, to_float2)
CONVERSIONS_WITH_CHANGES(float2, float2, to_float2)
CONVERSIONS_WITH_CHANGES(float3, float, to_float3)
CONVERSIONS_WITH_CHANGES(float3, float3, to_float3)
CONVERSIONS_WITH_CHANGES(float3, float4, to_float3)
CONVERSIONS_WITH_CHANGES(float4, float, to_float4)
CONVERSIONS_WITH_CHANGES(float4, float3, CHANGE_WITH_ALPHA)
CONVERSIONS_WITH_CHANGES(float4, float4, to_float4)
#undef CHANGE_WITH_ALPHA
#undef CONVERSIONS_WITH_CHANGES
