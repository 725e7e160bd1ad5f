// Functions that nodes share: of numbers, component by component, and of values with changes.

#include "graph/types.cl"

#define LARGEST 3.402823466e38f          // the largest float
#define SMALLEST_NORMAL 1.17549435e-38f  // below it log2_of does not hold
#define WHOLE_FROM 8388608.0f            // 2^23: floats from here on are whole numbers

// x brought to low .. high; low where x is no number.
NODE float bounded(float x, float low, float high)
{
    return fmin(fmax(x, low), high);
}

// 2^(whole + part) for a whole number from -127 to 128 and |part| <= 1/2, within 2.0e-7 of itself; 0 below the smallest normal
// float, at most the largest float. 2^part is a polynomial (least squares at Chebyshev's nodes).
NODE float power_of_2(float whole, float part)
{
    float value = 1.0f + part * (6.931471880e-1f + part * (2.402265092e-1f + part * (5.550357104e-2f + part * (9.618056670e-3f
                  + part * (1.339086735e-3f + part * 1.546144746e-4f)))));
    value *= as_float((uint)(min((int)whole, 127) + 127) << 23);
    value = whole > 127.0f ? 2.0f * value : value;
    return value < SMALLEST_NORMAL ? 0.0f : fmin(value, LARGEST);
}

// x^y as node Pow states it.
NODE float power(float x, float y)
{
    float size = fabs(x), exponent = bounded(y * log2_of(fmin(size, LARGEST)), -127.0f, 128.0f);
    float value = size < SMALLEST_NORMAL ? 0.0f : power_of_2(floor(exponent + 0.5f), exponent - floor(exponent + 0.5f));
    float of_negative = y != floor(y) ? 0.0f : (0.5f * y != floor(0.5f * y) ? -value : value);  // odd powers keep the sign
    value = x < 0.0f ? of_negative : value;
    return y == 0.0f ? 1.0f : value;
}

NODE float logarithm(float x)
{
    return 0.693147181f * log2_of(bounded(x, SMALLEST_NORMAL, LARGEST));
}

// For the derivative of powers, which are 0 where their base is not positive.
NODE float logarithm_or_zero(float x)
{
    return x > 0.0f ? logarithm(x) : 0.0f;
}

// The nearest multiple of ln 2 is taken off in two parts, exactly.
NODE float exponential(float x)
{
    float within = bounded(x, -88.0f, 88.8f), whole = floor(1.44269504f * within + 0.5f);
    float rest = (within - whole * 0.693359375f) + whole * 2.12194440e-4f;
    return power_of_2(whole, 1.44269504f * rest);
}

NODE float sine_of_turns(float turns)
{
    float sine, cosine;
    sincos_turns(turns - floor(turns + 0.5f), &sine, &cosine);
    return sine;
}

NODE float cosine_of_turns(float turns)
{
    float sine, cosine;
    sincos_turns(turns - floor(turns + 0.5f), &sine, &cosine);
    return cosine;
}

NODE float sine(float radians)
{
    return sine_of_turns(bounded(radians, -1e30f, 1e30f) * (0.5f * ONE_OVER_PI));
}

NODE float cosine(float radians)
{
    return cosine_of_turns(bounded(radians, -1e30f, 1e30f) * (0.5f * ONE_OVER_PI));
}

// Angle of (x, y) from the x axis, in radians.
NODE float angle(float y, float x)
{
    return 2.0f * PI * atan2_turns(bounded(y, -1e38f, 1e38f), bounded(x, -1e38f, 1e38f));
}

#define FOR_EACH_COMPONENT(FUNCTION)                                                                                         \
    NODE float2 FUNCTION(float2 a)                                                                                           \
    {                                                                                                                        \
        return (float2)(FUNCTION(a.x), FUNCTION(a.y));                                                                       \
    }                                                                                                                        \
    NODE float3 FUNCTION(float3 a)                                                                                           \
    {                                                                                                                        \
        return (float3)(FUNCTION(a.x), FUNCTION(a.y), FUNCTION(a.z));                                                        \
    }                                                                                                                        \
    NODE float4 FUNCTION(float4 a)                                                                                           \
    {                                                                                                                        \
        return (float4)(FUNCTION(a.x), FUNCTION(a.y), FUNCTION(a.z), FUNCTION(a.w));                                         \
    }
FOR_EACH_COMPONENT(logarithm)
FOR_EACH_COMPONENT(logarithm_or_zero)
FOR_EACH_COMPONENT(exponential)
FOR_EACH_COMPONENT(sine)
FOR_EACH_COMPONENT(cosine)
#undef FOR_EACH_COMPONENT

#define FOR_EACH_COMPONENT_OF_TWO(FUNCTION)                                                                                  \
    NODE float2 FUNCTION(float2 a, float2 b)                                                                                 \
    {                                                                                                                        \
        return (float2)(FUNCTION(a.x, b.x), FUNCTION(a.y, b.y));                                                             \
    }                                                                                                                        \
    NODE float3 FUNCTION(float3 a, float3 b)                                                                                 \
    {                                                                                                                        \
        return (float3)(FUNCTION(a.x, b.x), FUNCTION(a.y, b.y), FUNCTION(a.z, b.z));                                         \
    }                                                                                                                        \
    NODE float4 FUNCTION(float4 a, float4 b)                                                                                 \
    {                                                                                                                        \
        return (float4)(FUNCTION(a.x, b.x), FUNCTION(a.y, b.y), FUNCTION(a.z, b.z), FUNCTION(a.w, b.w));                     \
    }
FOR_EACH_COMPONENT_OF_TWO(power)
FOR_EACH_COMPONENT_OF_TWO(angle)
#undef FOR_EACH_COMPONENT_OF_TWO

// times, quotient: at most the largest float in size, which a product that is no number becomes too, so that sums of products
// are numbers; quotient: 0 for a zero divisor. whole_quotient, has_remainder (0 or 1): of node Mod. sum, difference, product:
// what + - * are to numbers, also for values with changes. between: a where part is 0, b where it is 1.
#define FOR_EACH_WIDTH(T)                                                                                                    \
    NODE T within_floats(T a)                                                                                                \
    {                                                                                                                        \
        T not_above = a < LARGEST ? a : (T)(LARGEST);                                                                        \
        return not_above > -LARGEST ? not_above : (T)(-LARGEST);                                                             \
    }                                                                                                                        \
    NODE T times(T a, T b)                                                                                                   \
    {                                                                                                                        \
        return within_floats(a * b);                                                                                         \
    }                                                                                                                        \
    NODE T quotient(T a, T b)                                                                                                \
    {                                                                                                                        \
        return b != 0.0f ? within_floats(a / b) : (T)(0.0f);                                                                 \
    }                                                                                                                        \
    NODE T##_D quotient(T##_D a, T##_D b)                                                                                    \
    {                                                                                                                        \
        T ratio = quotient(a.v, b.v);                                                                                        \
        return chain(ratio, quotient((T)(1.0f), b.v), a, -quotient(ratio, b.v), b);                                          \
    }                                                                                                                        \
    NODE T whole_quotient(T a, T b)                                                                                          \
    {                                                                                                                        \
        return floor(quotient(a, b));                                                                                        \
    }                                                                                                                        \
    NODE T has_remainder(T a, T b)                                                                                           \
    {                                                                                                                        \
        T is_exact = fabs(quotient(a, b)) < WHOLE_FROM ? (T)(1.0f) : (T)(0.0f);                                              \
        return b != 0.0f ? is_exact : (T)(0.0f);                                                                             \
    }                                                                                                                        \
    NODE T root(T a)                                                                                                         \
    {                                                                                                                        \
        return a > 0.0f ? sqrt(a) : (T)(0.0f);                                                                               \
    }                                                                                                                        \
    NODE T within_one(T a)                                                                                                   \
    {                                                                                                                        \
        return fmin(fmax(a, (T)(-1.0f)), (T)(1.0f));                                                                         \
    }                                                                                                                        \
    NODE T sign_of(T a)                                                                                                      \
    {                                                                                                                        \
        T not_negative = a > 0.0f ? (T)(1.0f) : (T)(0.0f);                                                                   \
        return a < 0.0f ? (T)(-1.0f) : not_negative;                                                                         \
    }                                                                                                                        \
    NODE T sum(T a, T b)                                                                                                     \
    {                                                                                                                        \
        return a + b;                                                                                                        \
    }                                                                                                                        \
    NODE T##_D sum(T##_D a, T##_D b)                                                                                         \
    {                                                                                                                        \
        return with_changes(a.v + b.v, a.x + b.x, a.y + b.y);                                                                \
    }                                                                                                                        \
    NODE T difference(T a, T b)                                                                                              \
    {                                                                                                                        \
        return a - b;                                                                                                        \
    }                                                                                                                        \
    NODE T##_D difference(T##_D a, T##_D b)                                                                                  \
    {                                                                                                                        \
        return with_changes(a.v - b.v, a.x - b.x, a.y - b.y);                                                                \
    }                                                                                                                        \
    NODE T product(T a, T b)                                                                                                 \
    {                                                                                                                        \
        return a * b;                                                                                                        \
    }                                                                                                                        \
    NODE T##_D product(T##_D a, T##_D b)                                                                                     \
    {                                                                                                                        \
        return chain(times(a.v, b.v), b.v, a, a.v, b);                                                                       \
    }                                                                                                                        \
    NODE T complement(T a)                                                                                                   \
    {                                                                                                                        \
        return 1.0f - a;                                                                                                     \
    }                                                                                                                        \
    NODE T##_D complement(T##_D a)                                                                                           \
    {                                                                                                                        \
        return with_changes(1.0f - a.v, -a.x, -a.y);                                                                         \
    }                                                                                                                        \
    NODE T between(T a, T b, T part)                                                                                         \
    {                                                                                                                        \
        return a + times(b - a, part);                                                                                       \
    }                                                                                                                        \
    NODE T##_D between(T##_D a, T##_D b, T##_D part)                                                                         \
    {                                                                                                                        \
        return chain(between(a.v, b.v, part.v), 1.0f - part.v, a, part.v, b, b.v - a.v, part);                               \
    }
FOR_EACH_WIDTH(float)
FOR_EACH_WIDTH(float2)
FOR_EACH_WIDTH(float3)
FOR_EACH_WIDTH(float4)
#undef FOR_EACH_WIDTH

// 0 below a threshold, 1 above it, with the cubic of smoothstep between, over the length of the value's change times sqrt(2).
NODE float_D step_of(float threshold, float_D value)
{
    float half_width = 0.707106781f * root(value.x * value.x + value.y * value.y);
    float t = bounded(0.5f + 0.5f * quotient(value.v - threshold, half_width), 0.0f, 1.0f);
    t = half_width > 0.0f ? t : (value.v < threshold ? 0.0f : 1.0f);
    float by_value = quotient(3.0f * t * (1.0f - t), half_width);
    return chain(t * t * (3.0f - 2.0f * t), by_value, value);
}
