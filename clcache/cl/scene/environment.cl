// The environment: an equirectangular picture, its importance, and rays towards it.
//
// Sampling chooses a row by its share of the light, then a pixel within it, then a place in the pixel; lookups filter
// bilinearly. The shares come from a blurred picture, so that no direction with light has density 0.

#include "common/math.cl"

typedef struct Sky {
    Environment environment;
    __global const float *radiance;  // (height * width, 3)
    __global const float *rows;      // (height): cumulative share of the rows
    __global const float *columns;   // (height, width): cumulative share within each row
} Sky;

// First place at which the cumulative shares exceed u.
inline uint search_shares(__global const float *shares, uint count, float u)
{
    uint low = 0, high = count - 1;
    while (low < high) {
        uint middle = (low + high) / 2;
        if (shares[middle] > u) high = middle;
        else low = middle + 1;
    }
    return low;
}

inline float share(__global const float *shares, uint index)
{
    return shares[index] - (index ? shares[index - 1] : 0.0f);
}

// Picture coordinates of a unit direction, in [0, 1]: v = 0 is up, u = 0.5 is -Z, u = 0.75 is +X.
inline float2 direction_to_picture(float3 d)
{
    float around = atan2(d.x, -d.z) * (0.5f * ONE_OVER_PI) + 0.5f;
    return (float2)(around, acos(clamp(d.y, -1.0f, 1.0f)) * ONE_OVER_PI);
}


inline float3 sky_texel(const Sky *sky, int column, int row)
{
    int width = (int)sky->environment.width, height = (int)sky->environment.height;
    column = (column + width) % width;
    row = clamp(row, 0, height - 1);
    return load_row(sky->radiance, (uint)(row * width + column));
}

inline float3 sky_radiance(const Sky *sky, float3 direction)
{
#if HAS_SKY_PICTURE
    float2 uv = direction_to_picture(direction);
    float x = uv.x * (float)sky->environment.width - 0.5f, y = uv.y * (float)sky->environment.height - 0.5f;
    float left = floor(x), top = floor(y), along = x - left, down = y - top;
    int column = (int)left, row = (int)top;
    float3 above = (1.0f - along) * sky_texel(sky, column, row) + along * sky_texel(sky, column + 1, row);
    float3 below = (1.0f - along) * sky_texel(sky, column, row + 1) + along * sky_texel(sky, column + 1, row + 1);
    return (1.0f - down) * above + down * below;
#else
    return load_row(sky->radiance, 0);
#endif
}

#if HAS_SKY_PICTURE

// Density per solid angle with which `sample_sky` finds a pixel's directions; without the chance that the sky is sampled.
inline float sky_pixel_density(const Sky *sky, uint column, uint row)
{
    uint width = sky->environment.width, height = sky->environment.height;
    float chance = share(sky->rows, row) * share(sky->columns + (size_t)row * width, column);
    float unused, top, bottom;
    sincos_turns(0.5f * (float)row / (float)height, &unused, &top);
    sincos_turns(0.5f * (float)(row + 1) / (float)height, &unused, &bottom);
    return chance * (float)width / (2.0f * PI * fmax(top - bottom, 1e-12f));
}

inline float sky_density(const Sky *sky, float3 direction)
{
    float2 uv = direction_to_picture(direction);
    uint column = min((uint)(uv.x * (float)sky->environment.width), sky->environment.width - 1);
    uint row = min((uint)(uv.y * (float)sky->environment.height), sky->environment.height - 1);
    return sky_pixel_density(sky, column, row);
}

// A direction by its share of the light; places in a pixel are uniform in solid angle.
inline float3 sample_sky(const Sky *sky, float u1, float u2, float *density)
{
    uint width = sky->environment.width, height = sky->environment.height;
    uint row = search_shares(sky->rows, height, u1);
    __global const float *columns = sky->columns + (size_t)row * width;
    uint column = search_shares(columns, width, u2);
    float down = (u1 - (row ? sky->rows[row - 1] : 0.0f)) / share(sky->rows, row);
    float along = (u2 - (column ? columns[column - 1] : 0.0f)) / share(columns, column);
    *density = sky_pixel_density(sky, column, row);
    float unused, top, bottom, sine, cosine;
    sincos_turns(0.5f * (float)row / (float)height, &unused, &top);
    sincos_turns(0.5f * (float)(row + 1) / (float)height, &unused, &bottom);
    float up = top + clamp(down, 0.0f, 1.0f) * (bottom - top), out = sqrt(fmax(1.0f - up * up, 0.0f));
    sincos_turns(((float)column + clamp(along, 0.0f, 1.0f)) / (float)width, &sine, &cosine);
    return (float3)(-out * sine, up, out * cosine);
}

#endif
