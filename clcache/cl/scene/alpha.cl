// Surfaces with holes: whether a hit meets one. Read at the finest level of the maps.

#include "scene/maps.cl"

typedef struct Masks {
    __global const Instance *instances;
    __global const uint *triangles;
    __global const uint *material;
    __global const float *uvs;
    __global const Material *materials;
    Maps maps;
} Masks;

// instance, primitive, u and v as in Hit.
INLINED bool is_hole(const Masks *masks, uint instance, uint primitive, float u, float v)
{
    uint triangle = masks->instances[instance].first_triangle + primitive;
    __global const Material *m = masks->materials + masks->material[triangle];
    if (!(m->alpha_cutoff > 0.0f)) return false;
    float alpha = m->alpha;
#if HAS_TEXTURES
    if (m->base_color_map >= 0) {
        uint a = masks->triangles[3 * triangle], b = masks->triangles[3 * triangle + 1], c = masks->triangles[3 * triangle + 2];
        __global const float *uv0 = masks->uvs + 2 * a, *uv1 = masks->uvs + 2 * b, *uv2 = masks->uvs + 2 * c;
        float across = uv0[0] + (u * (uv1[0] - uv0[0]) + v * (uv2[0] - uv0[0]));
        float down = uv0[1] + (u * (uv1[1] - uv0[1]) + v * (uv2[1] - uv0[1]));
        alpha *= sample_map(&masks->maps, m->base_color_map, across, down, 0.0f).w;
    }
#endif
    return alpha < m->alpha_cutoff;
}
