// Vectors of eight and sixteen lanes: those that a comparison chose as a mask, one byte for each, for loops over them; one
// lane of a vector; the lowest and the highest. No processor's own instructions are named: compilers find them, and a byte
// mask costs no more than theirs.

#include "common/math.cl"

#define LANES 0x0101010101010101ul

inline ulong lanes8(int8 chosen)
{
    return as_ulong(convert_char8(chosen)) & LANES;
}

inline ulong2 lanes16(int16 chosen)
{
    return as_ulong2(convert_char16(chosen)) & LANES;
}

// The lowest of the lanes, of which there must be one.
inline uint first_lane(ulong lanes)
{
    return (uint)popcount((lanes & -lanes) - 1) >> 3;
}

inline ulong without_first_lane(ulong lanes)
{
    return lanes & (lanes - 1);
}

inline uint first_lane16(ulong2 lanes)
{
    return lanes.x ? first_lane(lanes.x) : 8 + first_lane(lanes.y);
}

inline ulong2 without_first_lane16(ulong2 lanes)
{
    return lanes.x ? (ulong2)(without_first_lane(lanes.x), lanes.y) : (ulong2)(0, without_first_lane(lanes.y));
}

inline int16 chosen16(ulong2 lanes)
{
    return convert_int16(as_char16(lanes)) != 0;
}

inline bool any16(int16 chosen)
{
    ulong2 lanes = as_ulong2(convert_char16(chosen));
    return (lanes.x | lanes.y) != 0;
}

inline float lowest16(float16 v)
{
    float8 a = v.lo < v.hi ? v.lo : v.hi;
    float4 b = a.lo < a.hi ? a.lo : a.hi;
    float2 c = b.lo < b.hi ? b.lo : b.hi;
    return c.x < c.y ? c.x : c.y;
}

inline float highest16(float16 v)
{
    float8 a = v.lo > v.hi ? v.lo : v.hi;
    float4 b = a.lo > a.hi ? a.lo : a.hi;
    float2 c = b.lo > b.hi ? b.lo : b.hi;
    return c.x > c.y ? c.x : c.y;
}

typedef union Floats8 {
    float8 all;
    float lane[8];
} Floats8;

typedef union Floats16 {
    float16 all;
    float lane[16];
} Floats16;

typedef union Ints16 {
    int16 all;
    int lane[16];
} Ints16;

// Values first .. first + 15 of n; the last one again where there are no more.
inline float16 load16(__global const float *values, uint n, uint first)
{
    if (n - first >= 16u) return vload16(0, values + first);
    Floats16 loaded;
    for (uint lane = 0; lane < 16u; lane++) loaded.lane[lane] = values[min(first + lane, n - 1)];
    return loaded.all;
}
