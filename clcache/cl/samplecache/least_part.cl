// How much a new value of radiance counts at least against those before, since what a surface reflects may follow the view (SampleCache,
// Appendix C).
//
// Defines: HAS_SPECULAR.

#include "common/math.cl"

// The least part that a new value gets on surfaces that reflect, of roughness 0 and 1.
#define LEAST_PART_SMOOTH 0.5f
#define LEAST_PART_ROUGH 0.1f

// The least part of a new value (Appendix C), by how much of what the surface reflects, seen head on, follows the view. Pictures of
// the base colour, and what graphs make of it, are left out of account, as if they were white. specular: of the dielectric, its strength
// times the largest component of its tint.
INLINED float least_part(float metal, float roughness, float specular, __global const Material *m)
{
#if HAS_SPECULAR
    float alpha = roughness * roughness, base = max_component(load3(m->base_color));
    float dielectric = (m->ior - 1.0f) / (m->ior + 1.0f), rest = 1.0f - metal;
    float gloss = fmin(specular * dielectric * dielectric, 1.0f);
    float follows = metal * base + rest * (gloss + (1.0f - gloss) * base * m->transmission);
    float stays = rest * (1.0f - gloss) * base * (1.0f - m->transmission);
    float part = follows + stays > 0.0f ? follows / (follows + stays) : 0.0f;
    return part * (LEAST_PART_SMOOTH + alpha * (LEAST_PART_ROUGH - LEAST_PART_SMOOTH));
#else
    return 0.0f;
#endif
}
