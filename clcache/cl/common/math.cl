// Constants, small vector helpers and transcendentals for all kernels.
//
// Contraction is off, so that every driver rounds every product and sum alike: the same bits on every device, and edge
// functions of neighbouring triangles that are exact negatives of each other.

#pragma OPENCL FP_CONTRACT OFF

#define PI 3.14159265358979f
#define ONE_OVER_PI 0.318309886183791f
#define UNIT_ROUNDOFF 5.9604645e-8f  // 2^-24: the largest relative error of one rounded operation
#define NONE 0xFFFFFFFFu              // no instance, no primitive: a miss

#define OVERLOADED __attribute__((overloadable))  // for Vec3 and float3 alike
// What compilers deem too long to inline, where a call would stop the vectoriser. tools/race_check.py has its own.
#ifndef INLINED
#define INLINED inline __attribute__((always_inline))
#endif

// For kernels that have vectors of their own, or work through calls: Intel's compiler makes vectors of neighbouring work-items all the
// same, which is slower, and of vectors passed to functions wrong.
#if __has_attribute(intel_vec_len_hint)
#define ONE_BY_ONE __attribute__((intel_vec_len_hint(1)))
#else
#define ONE_BY_ONE
#endif

// Three numbers of one item, in place of float3: PoCL computes neighbouring work-items in the lanes of vectors, but only those
// whose code has no vectors of its own.
typedef struct Vec3 {
    float x, y, z;
} Vec3;

inline Vec3 vec3(float x, float y, float z)
{
    Vec3 v = { x, y, z };
    return v;
}

inline Vec3 all3(float value)
{
    return vec3(value, value, value);
}

inline Vec3 add3(Vec3 a, Vec3 b)
{
    return vec3(a.x + b.x, a.y + b.y, a.z + b.z);
}

inline Vec3 sub3(Vec3 a, Vec3 b)
{
    return vec3(a.x - b.x, a.y - b.y, a.z - b.z);
}

inline Vec3 mul3(Vec3 a, Vec3 b)
{
    return vec3(a.x * b.x, a.y * b.y, a.z * b.z);
}

inline Vec3 scale3(float factor, Vec3 v)
{
    return vec3(factor * v.x, factor * v.y, factor * v.z);
}

inline Vec3 negate3(Vec3 v)
{
    return vec3(-v.x, -v.y, -v.z);
}

inline Vec3 abs3(Vec3 v)
{
    return vec3(fabs(v.x), fabs(v.y), fabs(v.z));
}

inline Vec3 either3(bool first, Vec3 a, Vec3 b)
{
    return vec3(first ? a.x : b.x, first ? a.y : b.y, first ? a.z : b.z);
}

inline Vec3 mix3(Vec3 a, Vec3 b, float part)
{
    return add3(scale3(1.0f - part, a), scale3(part, b));
}

// x, y, z of item `i` in an array of three planes of `n` items, and back.
inline float3 load_planes(__global const float *values, uint n, uint i)
{
    return (float3)(values[i], values[n + i], values[2 * n + i]);
}

inline OVERLOADED void store_planes(__global float *values, uint n, uint i, float3 v)
{
    values[i] = v.x;
    values[n + i] = v.y;
    values[2 * n + i] = v.z;
}

inline Vec3 load_vec3(__global const float *values, uint n, uint i)
{
    return vec3(values[i], values[n + i], values[2 * n + i]);
}

inline OVERLOADED void store_planes(__global float *values, uint n, uint i, Vec3 v)
{
    values[i] = v.x;
    values[n + i] = v.y;
    values[2 * n + i] = v.z;
}

inline float3 load_row(__global const float *rows, uint i)
{
    return (float3)(rows[3 * i], rows[3 * i + 1], rows[3 * i + 2]);
}

inline Vec3 row3(__global const float *rows, uint i)
{
    return vec3(rows[3 * i], rows[3 * i + 1], rows[3 * i + 2]);
}

inline void store_row(__global float *rows, uint i, Vec3 v)
{
    rows[3 * i] = v.x;
    rows[3 * i + 1] = v.y;
    rows[3 * i + 2] = v.z;
}

// Where row i of four words begins. A signed number, by which vectors gather faster.
inline int words_of(uint i)
{
    return 4 * (int)i;
}

inline Vec3 load3(__global const float *v)
{
    return vec3(v[0], v[1], v[2]);
}

inline float dot3(Vec3 a, Vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

inline Vec3 cross3(Vec3 a, Vec3 b)
{
    return vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

inline float max_component(Vec3 v)
{
    return fmax(v.x, fmax(v.y, v.z));
}

// The power of two that brings a positive number near 1; exact, and finite for all that are.
inline float scale_to_one(float v)
{
    uint exponent = as_uint(v) >> 23;
    return as_float((exponent < 254 ? 254 - exponent : 1) << 23);
}

// Unit vector along v; v scaled by its largest component first, so that no scale of a scene under- or overflows.
// A zero vector stays zero.
INLINED Vec3 normalize3(Vec3 v)
{
    float largest = max_component(abs3(v));
    Vec3 scaled = scale3(scale_to_one(largest), v);
    float squared = dot3(scaled, scaled);
    return scale3(squared > 0.0f ? 1.0f / sqrt(squared) : 0.0f, scaled);
}

// sin and cos of 2 pi u for u in [0, 1]: u is reduced, exactly, to a quarter turn about the nearest multiple of it, and
// polynomials (minimax on +-pi/4) are evaluated there. Absolute error below 1.07e-7 for all multiples of 2^-24.
INLINED void sincos_turns(float u, float *sine, float *cosine)
{
    float quarter = floor(4.0f * u + 0.5f);
    float x = (u - 0.25f * quarter) * (2.0f * PI);
    float xx = x * x;
    float s = x + x * xx * (-1.6666654611e-1f + xx * (8.3321608736e-3f + xx * -1.9515295891e-4f));
    float c = 1.0f - 0.5f * xx + xx * xx * (4.166664568298827e-2f + xx * (-1.388731625493765e-3f + xx * 2.443315711809948e-5f));
    int q = (int)quarter & 3;
    float swapped_s = (q & 1) ? c : s, swapped_c = (q & 1) ? s : c;
    *sine = (q & 2) ? -swapped_s : swapped_s;
    *cosine = (q == 1 || q == 2) ? -swapped_c : swapped_c;
}

// Base-2 logarithm of a positive normal number: exponent, and the series of the inverse hyperbolic tangent for what remains
// between sqrt(1/2) and sqrt(2). Absolute error below 1.1e-7 + 2^-24 |log2(v)|.
inline float log2_of(float v)
{
    uint bits = as_uint(v) - 0x3F3504F3u;  // of sqrt(1/2)
    int exponent = (int)bits >> 23;
    float m = as_float((bits & 0x007FFFFFu) + 0x3F3504F3u);
    float s = (m - 1.0f) / (m + 1.0f), ss = s * s;
    float series = 1.0f + ss * (1.0f / 3.0f + ss * (1.0f / 5.0f + ss * (1.0f / 7.0f + ss * (1.0f / 9.0f))));
    return (float)exponent + 2.88539008f * s * series;
}

// Angle of the direction (x, y) from the x axis, in turns: -0.5 .. 0.5; 0 for (0, 0). The arctangent of the smaller over the
// larger number, brought below tan(pi / 8), as a polynomial (minimax). Absolute error below 2^-24.
INLINED float atan2_turns(float y, float x)
{
    float size_x = fabs(x), size_y = fabs(y);
    bool steep = size_y > size_x;
    float larger = steep ? size_y : size_x, smaller = steep ? size_x : size_y;
    bool wide = smaller > 0.414213562f * larger;
    float divisor = wide ? larger + smaller : larger;
    float a = divisor > 0.0f ? (wide ? smaller - larger : smaller) / divisor : 0.0f;
    float aa = a * a;
    float angle = a + a * aa * (-3.33329491539e-1f + aa * (1.99777106478e-1f + aa * (-1.38776856032e-1f + aa * 8.05374449538e-2f)));
    float turns = angle * (0.5f * ONE_OVER_PI) + (wide ? 0.125f : 0.0f);
    turns = steep ? 0.25f - turns : turns;
    turns = x < 0.0f ? 0.5f - turns : turns;
    return y < 0.0f ? -turns : turns;
}
