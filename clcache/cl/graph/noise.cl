// Procedural noise: Perlin's gradient noise, cell noise, Worley's distances to feature points, and simplex noise.
//
// Lattice points are hashed by Bob Jenkins' lookup3, and gradients, scales and the offsets of feature points follow from the
// hash as MaterialX defines them, so that pictures look as in its other renderers. The corners of one cell are the lanes of
// vectors: corner k of a square or cube lies at (k & 1, k >> 1 & 1, k >> 2). Coordinates are brought to +-1e9 before they
// become integers; floats of that size have no fraction.

#include "graph/vector_functions.cl"

#define MOST_OCTAVES 32
#define PERLIN_2D 0.6616f   // what brings Perlin's noise with MaterialX's gradients to about -1 .. 1
#define PERLIN_3D 0.9820f
#define SIMPLEX_2D 44.3655f  // 99.204 for unit gradients; these have the length sqrt(5)

#define FOR_EACH_WIDTH(T)                                                                                                    \
    NODE T hash_end(T a, T b, T c)                                                                                           \
    {                                                                                                                        \
        c = (c ^ b) - rotate(b, (T)(14u));                                                                                   \
        a = (a ^ c) - rotate(c, (T)(11u));                                                                                   \
        b = (b ^ a) - rotate(a, (T)(25u));                                                                                   \
        c = (c ^ b) - rotate(b, (T)(16u));                                                                                   \
        a = (a ^ c) - rotate(c, (T)(4u));                                                                                    \
        b = (b ^ a) - rotate(a, (T)(14u));                                                                                   \
        return (c ^ b) - rotate(b, (T)(24u));                                                                                \
    }                                                                                                                        \
    NODE T hash_of(T x, T y)                                                                                                 \
    {                                                                                                                        \
        T start = (T)(0xDEADBEEFu + (2u << 2) + 13u);                                                                        \
        return hash_end(start + x, start + y, start);                                                                        \
    }                                                                                                                        \
    NODE T hash_of(T x, T y, T z)                                                                                            \
    {                                                                                                                        \
        T start = (T)(0xDEADBEEFu + (3u << 2) + 13u);                                                                        \
        return hash_end(start + x, start + y, start + z);                                                                    \
    }                                                                                                                        \
    NODE void hash_four(T x, T y, T z, T *a, T *b, T *c)                                                                     \
    {                                                                                                                        \
        T start = (T)(0xDEADBEEFu + (4u << 2) + 13u);                                                                        \
        x += start, y += start, z += start;                                                                                  \
        x = (x - z) ^ rotate(z, (T)(4u)), z += y;                                                                            \
        y = (y - x) ^ rotate(x, (T)(6u)), x += z;                                                                            \
        z = (z - y) ^ rotate(y, (T)(8u)), y += x;                                                                            \
        x = (x - z) ^ rotate(z, (T)(16u)), z += y;                                                                           \
        y = (y - x) ^ rotate(x, (T)(19u)), x += z;                                                                           \
        z = (z - y) ^ rotate(y, (T)(4u)), y += x;                                                                            \
        *a = x, *b = y, *c = z;                                                                                              \
    }
FOR_EACH_WIDTH(uint)
FOR_EACH_WIDTH(uint4)
FOR_EACH_WIDTH(uint8)
FOR_EACH_WIDTH(uint16)
#undef FOR_EACH_WIDTH

// The number of the cell that holds x.
NODE float cell_of(float x)
{
    return floor(bounded(x, -1e9f, 1e9f));
}

NODE uint as_cell(float cell)
{
    return (uint)(int)cell;
}

// Where x lies in its cell, 0 to 1.
NODE float part_of(float x)
{
    return bounded(x - floor(x), 0.0f, 1.0f);
}

NODE float to_one(uint hash)
{
    return (float)hash * 2.32830644e-10f;
}

// 6 t^5 - 15 t^4 + 10 t^3, and its derivative.
NODE float fade(float t)
{
    return t * t * t * (t * (t * 6.0f - 15.0f) + 10.0f);
}

NODE float fade_slope(float t)
{
    return 30.0f * t * t * (t * (t - 2.0f) + 1.0f);
}

// Products of (x, y) with one of the eight gradients (+-1, +-2), (+-2, +-1); of (x, y, z) with those to the edges of a cube,
// some of them twice among 16.
NODE float4 with_gradient(uint4 hash, float4 x, float4 y)
{
    uint4 h = hash & 7u;
    float4 u = h < 4u ? x : y, v = 2.0f * (h < 4u ? y : x);
    return as_float4(as_uint4(u) ^ (h << 31)) + as_float4(as_uint4(v) ^ ((h & 2u) << 30));
}

NODE float8 with_gradient(uint8 hash, float8 x, float8 y, float8 z)
{
    uint8 h = hash & 15u;
    float8 third = (h & 13u) == 12u ? x : z;
    float8 u = h < 8u ? x : y, v = h < 4u ? y : third;
    return as_float8(as_uint8(u) ^ (h << 31)) + as_float8(as_uint8(v) ^ ((h & 2u) << 30));
}

// The sum of the corners' values, weighted by (1 - u, u) along each axis in turn, the last one first.
NODE float weigh(float2 ends, float u)
{
    return ends.x * (1.0f - u) + ends.y * u;
}

NODE float weigh(float4 corners, float u, float v)
{
    return weigh(corners.lo * (1.0f - v) + corners.hi * v, u);
}

NODE float weigh(float8 corners, float u, float v, float w)
{
    return weigh(corners.lo * (1.0f - w) + corners.hi * w, u, v);
}

// How an octave differs from the first one: coordinates are multiplied by frequency, noise by amplitude.
typedef struct Octave {
    float frequency, amplitude;
} Octave;

NODE Octave next_octave(Octave octave, float lacunarity, float diminish)
{
    octave.frequency = bounded(octave.frequency * lacunarity, -1e30f, 1e30f);
    octave.amplitude = bounded(octave.amplitude * diminish, -1e30f, 1e30f);
    return octave;
}

// Sums of octaves of Perlin's noise at p; channels: 1 or 3 of them, from different bits of the hash.
NOINLINE NODE void perlin(float2 p, int octaves, float lacunarity, float diminish, int channels, float *values)
{
    Octave octave = { 1.0f, 1.0f };
    for (int c = 0; c < channels; ++c)
        values[c] = 0.0f;
    for (int i = 0; i < min(octaves, MOST_OCTAVES); ++i) {
        float x = part_of(p.x), y = part_of(p.y);
        uint4 hash = hash_of(as_cell(cell_of(p.x)) + (uint4)(0, 1, 0, 1), as_cell(cell_of(p.y)) + (uint4)(0, 0, 1, 1));
        float4 from_x = x - (float4)(0.0f, 1.0f, 0.0f, 1.0f), from_y = y - (float4)(0.0f, 0.0f, 1.0f, 1.0f);
        for (int c = 0; c < channels; ++c)
            values[c] += octave.amplitude * PERLIN_2D * weigh(with_gradient(hash >> 8 * c, from_x, from_y), fade(x), fade(y));
        p = p * lacunarity;
        octave = next_octave(octave, lacunarity, diminish);
    }
}

// The same with derivatives.
NOINLINE NODE void perlin(float2 p, int octaves, float lacunarity, float diminish, int channels, float *values, float2 *slopes)
{
    Octave octave = { 1.0f, 1.0f };
    for (int c = 0; c < channels; ++c) {
        values[c] = 0.0f;
        slopes[c] = (float2)(0.0f, 0.0f);
    }
    for (int i = 0; i < min(octaves, MOST_OCTAVES); ++i) {
        float x = part_of(p.x), y = part_of(p.y), u = fade(x), v = fade(y);
        uint4 hash = hash_of(as_cell(cell_of(p.x)) + (uint4)(0, 1, 0, 1), as_cell(cell_of(p.y)) + (uint4)(0, 0, 1, 1));
        float4 from_x = x - (float4)(0.0f, 1.0f, 0.0f, 1.0f), from_y = y - (float4)(0.0f, 0.0f, 1.0f, 1.0f);
        float per_slope = octave.amplitude * octave.frequency * PERLIN_2D;
        for (int c = 0; c < channels; ++c) {
            uint4 h = hash >> 8 * c;
            float4 corners = with_gradient(h, from_x, from_y), one = (float4)(1.0f), zero = (float4)(0.0f);
            float by_x = weigh(with_gradient(h, one, zero), u, v) + fade_slope(x) * weigh(corners.odd - corners.even, v);
            float by_y = weigh(with_gradient(h, zero, one), u, v) + fade_slope(y) * weigh(corners.hi - corners.lo, u);
            values[c] += octave.amplitude * PERLIN_2D * weigh(corners, u, v);
            slopes[c] += per_slope * (float2)(by_x, by_y);
        }
        p = p * lacunarity;
        octave = next_octave(octave, lacunarity, diminish);
    }
}

NOINLINE NODE void perlin(float3 p, int octaves, float lacunarity, float diminish, int channels, float *values)
{
    Octave octave = { 1.0f, 1.0f };
    for (int c = 0; c < channels; ++c)
        values[c] = 0.0f;
    for (int i = 0; i < min(octaves, MOST_OCTAVES); ++i) {
        float x = part_of(p.x), y = part_of(p.y), z = part_of(p.z);
        uint8 hash = hash_of(as_cell(cell_of(p.x)) + (uint8)(0, 1, 0, 1, 0, 1, 0, 1),
                             as_cell(cell_of(p.y)) + (uint8)(0, 0, 1, 1, 0, 0, 1, 1),
                             as_cell(cell_of(p.z)) + (uint8)(0, 0, 0, 0, 1, 1, 1, 1));
        float8 from_x = x - (float8)(0.0f, 1.0f, 0.0f, 1.0f, 0.0f, 1.0f, 0.0f, 1.0f);
        float8 from_y = y - (float8)(0.0f, 0.0f, 1.0f, 1.0f, 0.0f, 0.0f, 1.0f, 1.0f);
        float8 from_z = z - (float8)(0.0f, 0.0f, 0.0f, 0.0f, 1.0f, 1.0f, 1.0f, 1.0f);
        for (int c = 0; c < channels; ++c)
            values[c] += octave.amplitude * PERLIN_3D
                         * weigh(with_gradient(hash >> 8 * c, from_x, from_y, from_z), fade(x), fade(y), fade(z));
        p = p * lacunarity;
        octave = next_octave(octave, lacunarity, diminish);
    }
}

NOINLINE NODE void perlin(float3 p, int octaves, float lacunarity, float diminish, int channels, float *values, float3 *slopes)
{
    Octave octave = { 1.0f, 1.0f };
    for (int c = 0; c < channels; ++c) {
        values[c] = 0.0f;
        slopes[c] = (float3)(0.0f, 0.0f, 0.0f);
    }
    for (int i = 0; i < min(octaves, MOST_OCTAVES); ++i) {
        float x = part_of(p.x), y = part_of(p.y), z = part_of(p.z), u = fade(x), v = fade(y), w = fade(z);
        uint8 hash = hash_of(as_cell(cell_of(p.x)) + (uint8)(0, 1, 0, 1, 0, 1, 0, 1),
                             as_cell(cell_of(p.y)) + (uint8)(0, 0, 1, 1, 0, 0, 1, 1),
                             as_cell(cell_of(p.z)) + (uint8)(0, 0, 0, 0, 1, 1, 1, 1));
        float8 from_x = x - (float8)(0.0f, 1.0f, 0.0f, 1.0f, 0.0f, 1.0f, 0.0f, 1.0f);
        float8 from_y = y - (float8)(0.0f, 0.0f, 1.0f, 1.0f, 0.0f, 0.0f, 1.0f, 1.0f);
        float8 from_z = z - (float8)(0.0f, 0.0f, 0.0f, 0.0f, 1.0f, 1.0f, 1.0f, 1.0f);
        float per_slope = octave.amplitude * octave.frequency * PERLIN_3D;
        for (int c = 0; c < channels; ++c) {
            uint8 h = hash >> 8 * c;
            float8 corners = with_gradient(h, from_x, from_y, from_z), one = (float8)(1.0f), zero = (float8)(0.0f);
            float4 face = corners.lo * (1.0f - w) + corners.hi * w;
            float by_x = weigh(with_gradient(h, one, zero, zero), u, v, w) + fade_slope(x) * weigh(face.odd - face.even, v);
            float by_y = weigh(with_gradient(h, zero, one, zero), u, v, w) + fade_slope(y) * weigh(face.hi - face.lo, u);
            float by_z = weigh(with_gradient(h, zero, zero, one), u, v, w)
                         + fade_slope(z) * weigh(corners.hi - corners.lo, u, v);
            values[c] += octave.amplitude * PERLIN_3D * weigh(face, u, v);
            slopes[c] += per_slope * (float3)(by_x, by_y, by_z);
        }
        p = p * lacunarity;
        octave = next_octave(octave, lacunarity, diminish);
    }
}

// Changes over the footprint, from those of the point.
NODE float_D along(float value, float2 slope, float2_D p)
{
    return with_changes(value, dot_of(slope, p.x), dot_of(slope, p.y));
}

NODE float_D along(float value, float3 slope, float3_D p)
{
    return with_changes(value, dot_of(slope, p.x), dot_of(slope, p.y));
}

#define FOR_EACH_WIDTH(T)                                                                                                    \
    NODE float perlin_1(T p, int octaves, float lacunarity, float diminish)                                                  \
    {                                                                                                                        \
        float value;                                                                                                         \
        perlin(p, octaves, lacunarity, diminish, 1, &value);                                                                 \
        return value;                                                                                                        \
    }                                                                                                                        \
    NODE float_D perlin_1(T##_D p, int octaves, float lacunarity, float diminish)                                            \
    {                                                                                                                        \
        float value;                                                                                                         \
        T slope;                                                                                                             \
        perlin(p.v, octaves, lacunarity, diminish, 1, &value, &slope);                                                       \
        return along(value, slope, p);                                                                                       \
    }                                                                                                                        \
    NODE float3 perlin_3(T p, int octaves, float lacunarity, float diminish)                                                 \
    {                                                                                                                        \
        float v[3];                                                                                                          \
        perlin(p, octaves, lacunarity, diminish, 3, v);                                                                      \
        return (float3)(v[0], v[1], v[2]);                                                                                   \
    }                                                                                                                        \
    NODE float3_D perlin_3(T##_D p, int octaves, float lacunarity, float diminish)                                           \
    {                                                                                                                        \
        float v[3];                                                                                                          \
        T slopes[3];                                                                                                         \
        perlin(p.v, octaves, lacunarity, diminish, 3, v, slopes);                                                            \
        float_D x = along(v[0], slopes[0], p), y = along(v[1], slopes[1], p), z = along(v[2], slopes[2], p);                 \
        return with_changes((float3)(x.v, y.v, z.v), (float3)(x.x, y.x, z.x), (float3)(x.y, y.y, z.y));                      \
    }
FOR_EACH_WIDTH(float2)
FOR_EACH_WIDTH(float3)
#undef FOR_EACH_WIDTH

NODE float cell_noise(float2 p)
{
    return to_one(hash_of(as_cell(cell_of(p.x)), as_cell(cell_of(p.y))));
}

NODE float cell_noise(float3 p)
{
    return to_one(hash_of(as_cell(cell_of(p.x)), as_cell(cell_of(p.y)), as_cell(cell_of(p.z))));
}

NODE float3 cell_noise_3(float2 p)
{
    uint x = as_cell(cell_of(p.x)), y = as_cell(cell_of(p.y));
    return (float3)(to_one(hash_of(x, y, 0u)), to_one(hash_of(x, y, 1u)), to_one(hash_of(x, y, 2u)));
}

NODE float3 cell_noise_3(float3 p)
{
    uint a, b, c;
    hash_four(as_cell(cell_of(p.x)), as_cell(cell_of(p.y)), as_cell(cell_of(p.z)), &a, &b, &c);
    return (float3)(to_one(hash_end(a, b, c)), to_one(hash_end(a + 1u, b, c)), to_one(hash_end(a + 2u, b, c)));
}

// The feature points of the cells about a point, one in each: squared distance from the point, and the way there.
#define FEATURES_2D 9
#define FEATURES_3D 27
#define FARTHEST 1e6f  // squared; what is farther is not seen
typedef struct Features {
    float squared[32], x[32], y[32], z[32];
} Features;

// jitter: 0 puts feature points in the middle of their cells, 1 anywhere in them.
NODE float16 feature(uint16 hash, float jitter)
{
    return (convert_float16(hash) * 2.32830644e-10f - 0.5f) * jitter + 0.5f;
}

NOINLINE NODE void find_features(float2 p, float jitter, Features *found)
{
    int16 column = (int16)(-1, -1, -1, 0, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0);
    int16 row = (int16)(-1, 0, 1, -1, 0, 1, -1, 0, 1, 0, 0, 0, 0, 0, 0, 0);
    uint16 x = as_cell(cell_of(p.x)) + as_uint16(column), y = as_cell(cell_of(p.y)) + as_uint16(row);
    jitter = bounded(jitter, -1e6f, 1e6f);
    float16 to_x = convert_float16(column) + feature(hash_of(x, y, (uint16)(0u)), jitter) - part_of(p.x);
    float16 to_y = convert_float16(row) + feature(hash_of(x, y, (uint16)(1u)), jitter) - part_of(p.y);
    vstore16(to_x, 0, found->x);
    vstore16(to_y, 0, found->y);
    vstore16(to_x * to_x + to_y * to_y, 0, found->squared);
}

// Cell 9 i + 3 j + k lies at (i, j, k) - 1; 27 of 32 lanes are such.
NOINLINE NODE void find_features(float3 p, float jitter, Features *found)
{
    uint x0 = as_cell(cell_of(p.x)), y0 = as_cell(cell_of(p.y)), z0 = as_cell(cell_of(p.z));
    jitter = bounded(jitter, -1e6f, 1e6f);
    for (int half_of = 0; half_of < 2; ++half_of) {
        int16 cell = 16 * half_of + (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
        int16 third = cell * 171 >> 9, ninth = cell * 57 >> 9;  // cell / 3 and cell / 9, for cells below 32
        int16 i = ninth - 1, j = third - 3 * ninth - 1, k = cell - 3 * third - 1;
        uint16 a, b, c;
        hash_four(x0 + as_uint16(i), y0 + as_uint16(j), z0 + as_uint16(k), &a, &b, &c);
        float16 to_x = convert_float16(i) + feature(hash_end(a, b, c), jitter) - part_of(p.x);
        float16 to_y = convert_float16(j) + feature(hash_end(a + 1u, b, c), jitter) - part_of(p.y);
        float16 to_z = convert_float16(k) + feature(hash_end(a + 2u, b, c), jitter) - part_of(p.z);
        vstore16(to_x, half_of, found->x);
        vstore16(to_y, half_of, found->y);
        vstore16(to_z, half_of, found->z);
        vstore16(to_x * to_x + to_y * to_y + to_z * to_z, half_of, found->squared);
    }
}

// The three nearest feature points, nearest first; 1,000 away and in no direction where fewer are seen.
typedef struct Nearest {
    float distance[3];
    float3 way[3];
} Nearest;

NODE Nearest nearest_of(const Features *found, int count)
{
    float squared0 = FARTHEST, squared1 = FARTHEST, squared2 = FARTHEST;
    int first = -1, second = -1, third = -1;
    for (int k = 0; k < count; ++k) {
        float squared = found->squared[k];
        bool before0 = squared < squared0, before1 = squared < squared1, before2 = squared < squared2;
        third = before1 ? second : (before2 ? k : third);
        squared2 = before1 ? squared1 : (before2 ? squared : squared2);
        second = before0 ? first : (before1 ? k : second);
        squared1 = before0 ? squared0 : (before1 ? squared : squared1);
        first = before0 ? k : first;
        squared0 = before0 ? squared : squared0;
    }
    int points[3] = { first, second, third };
    Nearest nearest = { { sqrt(squared0), sqrt(squared1), sqrt(squared2) } };
    for (int n = 0; n < 3; ++n) {
        int k = max(points[n], 0);
        bool seen = points[n] >= 0;
        nearest.way[n] = (float3)(seen ? found->x[k] : 0.0f, seen ? found->y[k] : 0.0f, seen ? found->z[k] : 0.0f);
    }
    return nearest;
}

NODE Nearest nearest_features(float2 p, float jitter)
{
    Features found;
    for (int k = 0; k < FEATURES_2D; ++k)
        found.z[k] = 0.0f;
    find_features(p, jitter, &found);
    return nearest_of(&found, FEATURES_2D);
}

NODE Nearest nearest_features(float3 p, float jitter)
{
    Features found;
    find_features(p, jitter, &found);
    return nearest_of(&found, FEATURES_3D);
}

// The place of the nearest feature point, whose cell colours what is nearest to it.
NODE float2 nearest_place(float2 p, const Nearest *nearest)
{
    float3 way = nearest->way[0];
    return (float2)(cell_of(p.x) + floor(part_of(p.x) + way.x), cell_of(p.y) + floor(part_of(p.y) + way.y));
}

NODE float3 nearest_place(float3 p, const Nearest *nearest)
{
    float3 way = nearest->way[0];
    return (float3)(cell_of(p.x) + floor(part_of(p.x) + way.x), cell_of(p.y) + floor(part_of(p.y) + way.y),
                    cell_of(p.z) + floor(part_of(p.z) + way.z));
}

// The distance shrinks as the point moves its way; 0 at the feature point itself.
NODE float_D distance_along(const Nearest *nearest, int n, float3 x, float3 y)
{
    float3 slope = nearest->way[n] * quotient(-1.0f, nearest->distance[n]);
    return with_changes(nearest->distance[n], dot_of(slope, x), dot_of(slope, y));
}

NODE float3_D distances_along(const Nearest *nearest, float3 x, float3 y)
{
    float_D a = distance_along(nearest, 0, x, y), b = distance_along(nearest, 1, x, y), c = distance_along(nearest, 2, x, y);
    return with_changes((float3)(a.v, b.v, c.v), (float3)(a.x, b.x, c.x), (float3)(a.y, b.y, c.y));
}

// Simplex noise over equilateral triangles: each corner contributes (1/2 - r^2)^4 times the product with its gradient.
// Returns the value and its derivatives by x and y.
NOINLINE NODE float3 simplex(float2 p)
{
    float unskew = 0.211324865f;  // (3 - sqrt 3) / 6
    float x = bounded(p.x, -1e8f, 1e8f), y = bounded(p.y, -1e8f, 1e8f);
    float skewed = 0.366025404f * (x + y);  // (sqrt 3 - 1) / 2
    float i = floor(x + skewed), j = floor(y + skewed), back = (i + j) * unskew;
    x = x - (i - back);
    y = y - (j - back);
    uint step_x = x > y ? 1u : 0u, step_y = 1u - step_x;
    uint4 hash = hash_of(as_cell(i) + (uint4)(0, step_x, 1, 1), as_cell(j) + (uint4)(0, step_y, 1, 1));
    float4 from_x = x - (float4)(0.0f, (float)(int)step_x - unskew, 1.0f - 2.0f * unskew, 1.0f - 2.0f * unskew);
    float4 from_y = y - (float4)(0.0f, (float)(int)step_y - unskew, 1.0f - 2.0f * unskew, 1.0f - 2.0f * unskew);
    float4 reach = fmax(0.5f - from_x * from_x - from_y * from_y, (float4)(0.0f)) * (float4)(1.0f, 1.0f, 1.0f, 0.0f);
    float4 cubed = reach * reach * reach, weight = cubed * reach;
    float4 gradient_x = with_gradient(hash, (float4)(1.0f), (float4)(0.0f));
    float4 gradient_y = with_gradient(hash, (float4)(0.0f), (float4)(1.0f));
    float4 product = gradient_x * from_x + gradient_y * from_y, inward = -8.0f * cubed * product;
    float4 parts = weight * product;
    float4 by_x = weight * gradient_x + inward * from_x, by_y = weight * gradient_y + inward * from_y;
    return SIMPLEX_2D * (float3)(parts.x + parts.y + parts.z, by_x.x + by_x.y + by_x.z, by_y.x + by_y.y + by_y.z);
}

NODE float3 simplex_octaves(float2 p, int octaves, float lacunarity, float diminish)
{
    Octave octave = { 1.0f, 1.0f };
    float3 total = (float3)(0.0f, 0.0f, 0.0f);
    for (int i = 0; i < min(octaves, MOST_OCTAVES); ++i) {
        float per_slope = octave.amplitude * octave.frequency;
        total += (float3)(octave.amplitude, per_slope, per_slope) * simplex(p);
        p = p * lacunarity;
        octave = next_octave(octave, lacunarity, diminish);
    }
    return total;
}
