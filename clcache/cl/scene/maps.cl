// What a material's maps say at a place of its surface.

#include "scene/texture.cl"

typedef struct Maps {
    __global const TextureUse *uses;
    __global const Texture *textures;
    __global const uint *texels;
    __global const float *srgb;
} Maps;

// RGBA of map `index` at texture coordinates uv, for a footprint in units of them; white where there is no such map.
inline float4 sample_map(const Maps *maps, int index, float2 uv, float footprint)
{
    if (index < 0) return (float4)(1.0f);
    TextureUse use = maps->uses[index];
    const float *m = use.transform;
    float2 place = (float2)(m[0] * uv.x + m[1] * uv.y + m[2], m[3] * uv.x + m[4] * uv.y + m[5]);
    float scale = sqrt(fabs(m[0] * m[4] - m[1] * m[3]));
    return sample_texture(maps->texels, maps->textures[use.texture], maps->srgb, place, footprint * scale);
}
