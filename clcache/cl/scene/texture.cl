// Trilinear lookups in 8-bit pictures with mip levels; `srgb` is the table that decodes the 256 values of encoded colour.

#include "common/math.cl"

// A texel's place along an axis of `size` texels, by wrap mode (Texture in layout.py).
inline uint wrap_texel(int place, int size, uint mode)
{
    if (mode == 1) return (uint)clamp(place, 0, size - 1);
    int period = mode == 2 ? 2 * size : size;
    int wrapped = place % period;
    wrapped = wrapped < 0 ? wrapped + period : wrapped;
    return (uint)(wrapped < size ? wrapped : period - 1 - wrapped);
}

inline float4 load_texel(__global const uint *texels, uint first, uint width, uint2 place, __global const float *srgb)
{
    uint texel = texels[first + place.y * width + place.x];
    uint4 bytes = (uint4)(texel, texel >> 8, texel >> 16, texel >> 24) & 255u;
    float4 plain = convert_float4(bytes) / 255.0f;
    return srgb ? (float4)(srgb[bytes.x], srgb[bytes.y], srgb[bytes.z], plain.w) : plain;
}

// RGBA at (u, v) on one level; texel centres lie at half-integer places.
inline float4 sample_level(__global const uint *texels, Texture texture, uint first, uint width, uint height,
                           __global const float *srgb, float2 uv)
{
    float x = uv.x * (float)width - 0.5f, y = uv.y * (float)height - 0.5f;
    float left = floor(x), top = floor(y);
    float along = x - left, down = y - top;
    uint column0 = wrap_texel((int)left, (int)width, texture.wrap[0]);
    uint column1 = wrap_texel((int)left + 1, (int)width, texture.wrap[0]);
    uint row0 = wrap_texel((int)top, (int)height, texture.wrap[1]);
    uint row1 = wrap_texel((int)top + 1, (int)height, texture.wrap[1]);
    float4 above = (1.0f - along) * load_texel(texels, first, width, (uint2)(column0, row0), srgb)
                   + along * load_texel(texels, first, width, (uint2)(column1, row0), srgb);
    float4 below = (1.0f - along) * load_texel(texels, first, width, (uint2)(column0, row1), srgb)
                   + along * load_texel(texels, first, width, (uint2)(column1, row1), srgb);
    return (1.0f - down) * above + down * below;
}

// RGBA at (u, v), for a footprint that is `footprint` wide in the picture's coordinates (1 is its whole width or height).
// Whole turns are taken off before the coordinates are scaled, so that large ones keep what precision they have, and none
// overflows an int.
inline float4 sample_texture(__global const uint *texels, Texture texture, __global const float *srgb_table, float2 uv,
                             float footprint)
{
    uv.x = texture.wrap[0] == 1 ? clamp(uv.x, 0.0f, 1.0f) : uv.x - 2.0f * floor(0.5f * uv.x);
    uv.y = texture.wrap[1] == 1 ? clamp(uv.y, 0.0f, 1.0f) : uv.y - 2.0f * floor(0.5f * uv.y);
    __global const float *srgb = texture.srgb ? srgb_table : 0;
    float finest = footprint * sqrt((float)texture.width * (float)texture.height);
    float level = finest > 1.0f ? fmin(log2(finest), (float)(texture.levels - 1)) : 0.0f;
    uint below = (uint)level;
    float blend = level - (float)below;
    uint first = texture.first_texel, width = texture.width, height = texture.height;
    for (uint i = 0; i < below; i++) {
        first += width * height;
        width = max(width >> 1, 1u);
        height = max(height >> 1, 1u);
    }
    float4 color = sample_level(texels, texture, first, width, height, srgb, uv);
    if (blend > 0.0f) {
        first += width * height;
        width = max(width >> 1, 1u);
        height = max(height >> 1, 1u);
        color = (1.0f - blend) * color + blend * sample_level(texels, texture, first, width, height, srgb, uv);
    }
    return color;
}
