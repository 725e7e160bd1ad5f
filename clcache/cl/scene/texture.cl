// Bilinear lookups in 8-bit sRGB pictures; `srgb` is the table that decodes their 256 values.

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

inline float3 load_texel(__global const uint *texels, Texture texture, __constant const float *srgb, int x, int y)
{
    uint column = wrap_texel(x, (int)texture.width, texture.wrap[0]);
    uint row = wrap_texel(y, (int)texture.height, texture.wrap[1]);
    uint texel = texels[texture.first_texel + row * texture.width + column];
    return (float3)(srgb[texel & 255], srgb[texel >> 8 & 255], srgb[texel >> 16 & 255]);
}

// Colour at (u, v); texel centres lie at half-integer places. Whole turns are taken off before the coordinates are scaled,
// so that large ones keep what precision they have, and none overflows an int.
inline float3 sample_texture(__global const uint *texels, Texture texture, __constant const float *srgb, float u, float v)
{
    u = texture.wrap[0] == 1 ? clamp(u, 0.0f, 1.0f) : u - 2.0f * floor(0.5f * u);
    v = texture.wrap[1] == 1 ? clamp(v, 0.0f, 1.0f) : v - 2.0f * floor(0.5f * v);
    float x = u * (float)texture.width - 0.5f, y = v * (float)texture.height - 0.5f;
    float left = floor(x), top = floor(y);
    float along = x - left, down = y - top;
    int column = (int)left, row = (int)top;
    float3 above = (1.0f - along) * load_texel(texels, texture, srgb, column, row)
                   + along * load_texel(texels, texture, srgb, column + 1, row);
    float3 below = (1.0f - along) * load_texel(texels, texture, srgb, column, row + 1)
                   + along * load_texel(texels, texture, srgb, column + 1, row + 1);
    return (1.0f - down) * above + down * below;
}
