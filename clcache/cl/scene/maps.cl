// What a material's maps say at a place of its surface.

#include "scene/texture.cl"

typedef struct Maps {
    __global const TextureUse *uses;
    __global const Texture *textures;
    __global const uint *texels;
    __global const float *srgb;
} Maps;

// RGBA of map `index` at texture coordinates (u, v), for a footprint in units of them; white where there is no such map.
INLINED Texel sample_map(const Maps *maps, int index, float u, float v, float footprint)
{
    __global const TextureUse *use = maps->uses + max(index, 0);
    __global const float *m = use->transform;
    float s = m[0] * u + m[1] * v + m[2], t = m[3] * u + m[4] * v + m[5];
    float scale = sqrt(fabs(m[0] * m[4] - m[1] * m[3]));
    Texel texel = sample_texture(maps->texels, maps->textures + use->texture, maps->srgb, s, t, footprint * scale);
    bool is_there = index >= 0;
    return texel4(is_there ? texel.x : 1.0f, is_there ? texel.y : 1.0f, is_there ? texel.z : 1.0f, is_there ? texel.w : 1.0f);
}
