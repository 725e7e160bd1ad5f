// The environment: an equirectangular picture, its importance, and rays towards it.
//
// Sampling chooses a row by its share of the light, then a pixel within it, then a place in the pixel; lookups filter
// bilinearly. The shares come from a blurred picture, so that no direction with light has density 0.
//
// Defines: HAS_SKY_PICTURE; SKY_ROW_STEPS, SKY_COLUMN_STEPS: of the search in its rows and columns.

#include "common/math.cl"

typedef struct Sky {
    Environment environment;
    __global const float *radiance;  // (height * width, 3)
    __global const float *rows;      // (height): cumulative share of the rows
    __global const float *columns;   // (height, width): cumulative share within each row
    __global const float *density;   // (height * width): per solid angle, of finding a pixel's directions
    __global const float *edges;     // (height + 1): how far up each row begins
} Sky;

// One step of a binary search: `found` moves on if the share before the place that lies `stride` further does not exceed u.
inline uint search_step(__global const float *shares, uint count, float u, uint found, uint stride)
{
    uint next = found + stride;
    bool is_there = stride > 0 && next < count;
    return is_there && shares[is_there ? next - 1 : 0] <= u ? next : found;
}

// Eight steps, as far as the width of the search has them.
INLINED uint search_steps(__global const float *shares, uint count, float u, uint found, uint bits)
{
    found = search_step(shares, count, u, found, bits & 0x80808080u);
    found = search_step(shares, count, u, found, bits & 0x40404040u);
    found = search_step(shares, count, u, found, bits & 0x20202020u);
    found = search_step(shares, count, u, found, bits & 0x10101010u);
    found = search_step(shares, count, u, found, bits & 0x08080808u);
    found = search_step(shares, count, u, found, bits & 0x04040404u);
    found = search_step(shares, count, u, found, bits & 0x02020202u);
    return search_step(shares, count, u, found, bits & 0x01010101u);
}

// First place at which the cumulative shares exceed u; 2^steps must be at least count. Unrolled by hand: neither does PoCL
// unroll loops, nor does it put work-items side by side where there are any. With constant `steps` only as many are left.
INLINED uint search_shares(__global const float *shares, uint count, uint steps, float u)
{
    uint bits = steps < 32 ? (1u << steps) - 1 : 0xFFFFFFFFu;
    uint found = search_steps(shares, count, u, 0, bits & 0xFF000000u);
    found = search_steps(shares, count, u, found, bits & 0x00FF0000u);
    found = search_steps(shares, count, u, found, bits & 0x0000FF00u);
    return search_steps(shares, count, u, found, bits & 0x000000FFu);
}

inline float share(__global const float *shares, uint index)
{
    return shares[index] - (index > 0 ? shares[max((int)index - 1, 0)] : 0.0f);
}

inline Vec3 sky_texel(const Sky *sky, int column, int row)
{
    int width = (int)sky->environment.width, height = (int)sky->environment.height;
    column = column < 0 ? column + width : column;
    column = column >= width ? column - width : column;
    return row3(sky->radiance, (uint)(clamp(row, 0, height - 1) * width + clamp(column, 0, width - 1)));
}

// Picture coordinates of a unit direction, in [0, 1]: v = 0 is up, u = 0.5 is -Z, u = 0.75 is +X.
inline float picture_u(Vec3 d)
{
    return atan2_turns(d.x, -d.z) + 0.5f;
}

inline float picture_v(Vec3 d)
{
    return 2.0f * atan2_turns(sqrt(d.x * d.x + d.z * d.z), d.y);
}

// The picture at coordinates in [0, 1].
INLINED Vec3 picture_radiance(const Sky *sky, float u, float v)
{
    float x = u * (float)(int)sky->environment.width - 0.5f, y = v * (float)(int)sky->environment.height - 0.5f;
    float left = floor(x), top = floor(y);
    int column = (int)left, row = (int)top;
    Vec3 above = mix3(sky_texel(sky, column, row), sky_texel(sky, column + 1, row), x - left);
    Vec3 below = mix3(sky_texel(sky, column, row + 1), sky_texel(sky, column + 1, row + 1), x - left);
    return mix3(above, below, y - top);
}

INLINED Vec3 sky_radiance(const Sky *sky, Vec3 direction)
{
#if HAS_SKY_PICTURE
    return picture_radiance(sky, picture_u(direction), picture_v(direction));
#else
    return row3(sky->radiance, 0);
#endif
}

#if HAS_SKY_PICTURE

// Density per solid angle with which `sample_sky` finds a direction; without the chance that the sky is sampled.
INLINED float sky_density_of(const Sky *sky, Vec3 direction)
{
    int width = (int)sky->environment.width, height = (int)sky->environment.height;
    int column = clamp((int)(picture_u(direction) * (float)width), 0, width - 1);
    int row = clamp((int)(picture_v(direction) * (float)height), 0, height - 1);
    return sky->density[row * width + column];
}

// A direction by its share of the light; places in a pixel are uniform in solid angle. *u: the picture's there.
INLINED Vec3 sample_sky(const Sky *sky, float u1, float u2, float *density, float *u)
{
    uint width = sky->environment.width, height = sky->environment.height;
    uint row = search_shares(sky->rows, height, SKY_ROW_STEPS, u1);
    __global const float *columns = sky->columns + row * width;
    uint column = search_shares(columns, width, SKY_COLUMN_STEPS, u2);
    float before_row = row > 0 ? sky->rows[max((int)row - 1, 0)] : 0.0f;
    float before_column = column > 0 ? columns[max((int)column - 1, 0)] : 0.0f;
    float down = (u1 - before_row) / (sky->rows[row] - before_row);
    float along = (u2 - before_column) / (columns[column] - before_column);
    *density = sky->density[row * width + column];
    float top = sky->edges[row], bottom = sky->edges[row + 1], sine, cosine;
    float up = top + clamp(down, 0.0f, 1.0f) * (bottom - top), out = sqrt(fmax(1.0f - up * up, 0.0f));
    *u = ((float)(int)column + clamp(along, 0.0f, 1.0f)) / (float)(int)width;
    sincos_turns(*u, &sine, &cosine);
    return vec3(-out * sine, up, out * cosine);
}

#endif
