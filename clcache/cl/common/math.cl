// Constants, small vector helpers and transcendentals for all kernels.
//
// Contraction is off, so that every driver rounds every product and sum alike: the same bits on every device, and edge
// functions of neighbouring triangles that are exact negatives of each other.

#pragma OPENCL FP_CONTRACT OFF

#define PI 3.14159265358979f
#define ONE_OVER_PI 0.318309886183791f
#define UNIT_ROUNDOFF 5.9604645e-8f  // 2^-24: the largest relative error of one rounded operation
#define NONE 0xFFFFFFFFu              // no instance, no primitive: a miss
#define FROM_BEHIND 0x80000000u       // flag on a material's index: the surface's back was hit

// x, y, z of item `i` in an array of three planes of `n` items, and back.
inline float3 load_planes(__global const float *values, uint n, uint i)
{
    return (float3)(values[i], values[n + i], values[2 * n + i]);
}

inline void store_planes(__global float *values, uint n, uint i, float3 v)
{
    values[i] = v.x;
    values[n + i] = v.y;
    values[2 * n + i] = v.z;
}

inline float3 load_row(__global const float *rows, uint i)
{
    return (float3)(rows[3 * i], rows[3 * i + 1], rows[3 * i + 2]);
}

inline float dot3(float3 a, float3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

inline float3 cross3(float3 a, float3 b)
{
    return (float3)(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// Unit vector along v; v scaled by its largest component first, so that no scale of a scene under- or overflows.
// A zero vector stays zero.
inline float3 normalize3(float3 v)
{
    float largest = fmax(fabs(v.x), fmax(fabs(v.y), fabs(v.z)));
    if (!(largest > 0.0f)) return (float3)(0.0f);
    float3 scaled = v / largest;
    return scaled / sqrt(dot3(scaled, scaled));
}

inline float max_component(float3 v)
{
    return fmax(v.x, fmax(v.y, v.z));
}

// sin and cos of 2 pi u for u in [0, 1]: u is reduced, exactly, to a quarter turn about the nearest multiple of it, and
// polynomials (minimax on +-pi/4) are evaluated there. Absolute error below 1.07e-7 for all multiples of 2^-24.
inline void sincos_turns(float u, float *sine, float *cosine)
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
