// Trilinear lookups in 8-bit pictures with mip levels; `srgb` is the table that decodes the 256 values of encoded colour.

#include "common/math.cl"

typedef struct Texel {
    float x, y, z, w;  // red, green, blue, alpha
} Texel;

inline Texel texel4(float x, float y, float z, float w)
{
    Texel texel = { x, y, z, w };
    return texel;
}

inline Texel mix4(Texel a, Texel b, float part)
{
    float rest = 1.0f - part;
    return texel4(rest * a.x + part * b.x, rest * a.y + part * b.y, rest * a.z + part * b.z, rest * a.w + part * b.w);
}

// A texel's place along an axis of `size` texels, by wrap mode (Texture in layout.py); -1 <= place <= 2 size, and what
// coordinates that are not finite give ends up within the picture too.
inline uint wrap_texel(int place, int size, uint mode)
{
    int clamped = clamp(place, 0, size - 1);
    int period = mode == 2 ? 2 * size : size;
    int wrapped = place < 0 ? place + period : place;
    wrapped = wrapped >= period ? wrapped - period : wrapped;
    wrapped = wrapped >= period ? wrapped - period : wrapped;  // 2 size, where the period is size
    wrapped = wrapped < size ? wrapped : period - 1 - wrapped;
    return min((uint)(mode == 1 ? clamped : wrapped), (uint)(size - 1));
}

inline Texel load_texel(__global const uint *texels, uint place, bool encoded, __global const float *srgb)
{
    uint texel = texels[place];
    uint x = texel & 255u, y = texel >> 8 & 255u, z = texel >> 16 & 255u, w = texel >> 24;
    float to_one = 1.0f / 255.0f;
    return texel4(encoded ? srgb[x] : (float)(int)x * to_one, encoded ? srgb[y] : (float)(int)y * to_one,
                  encoded ? srgb[z] : (float)(int)z * to_one, (float)(int)w * to_one);
}

// RGBA at (u, v) on one level; texel centres lie at half-integer places.
INLINED Texel sample_level(__global const uint *texels, __global const Texture *texture, uint level,
                          __global const float *srgb, float u, float v)
{
    uint first = texture->first_texel[level], width = texture->width >> level, height = texture->height >> level;
    width = width > 0 ? width : 1;
    height = height > 0 ? height : 1;
    float x = u * (float)(int)width - 0.5f, y = v * (float)(int)height - 0.5f;
    float left = floor(x), top = floor(y);
    uint mode_u = texture->wrap[0], mode_v = texture->wrap[1];
    uint column0 = wrap_texel((int)left, (int)width, mode_u), column1 = wrap_texel((int)left + 1, (int)width, mode_u);
    uint row0 = first + width * wrap_texel((int)top, (int)height, mode_v);
    uint row1 = first + width * wrap_texel((int)top + 1, (int)height, mode_v);
    bool encoded = texture->srgb != 0;
    Texel above = mix4(load_texel(texels, row0 + column0, encoded, srgb), load_texel(texels, row0 + column1, encoded, srgb), x - left);
    Texel below = mix4(load_texel(texels, row1 + column0, encoded, srgb), load_texel(texels, row1 + column1, encoded, srgb), x - left);
    return mix4(above, below, y - top);
}

// RGBA at (u, v), for a footprint that is `footprint` wide in the picture's coordinates (1 is its whole width or height).
// Whole turns are taken off before the coordinates are scaled, so that large ones keep what precision they have, and none
// overflows an int.
INLINED Texel sample_texture(__global const uint *texels, __global const Texture *texture, __global const float *srgb,
                            float u, float v, float footprint)
{
    u = texture->wrap[0] == 1 ? clamp(u, 0.0f, 1.0f) : u - 2.0f * floor(0.5f * u);
    v = texture->wrap[1] == 1 ? clamp(v, 0.0f, 1.0f) : v - 2.0f * floor(0.5f * v);
    float finest = footprint * sqrt((float)(int)texture->width * (float)(int)texture->height);
    float coarsest = (float)((int)texture->levels - 1);
    float level = finest > 1.0f ? fmin(log2_of(finest), coarsest) : 0.0f;
    uint sharper = (uint)(int)level;
    float blend = level - (float)(int)sharper;
    uint softer = blend > 0.0f ? sharper + 1 : sharper;
    return mix4(sample_level(texels, texture, sharper, srgb, u, v), sample_level(texels, texture, softer, srgb, u, v), blend);
}
