// What the surface of a sample has to do with voxels: which one it asks, and whether it may.
//
// No voxel answers where the light that a surface reflects follows the view, since who looks from elsewhere would get it, too; and,
// with GATE, where the surface is nearer to the eye than a voxel is wide (its space diagonal), since the light within one
// then varies across the image. There each pixel's own path answers, of one frame.
//
// Defines: GATE; JITTER: each sample asks a voxel about its own; COIN: each sample asks by turns, by chance, the voxel and its parent,
// which is one level above; those of address.cl and surface.cl.

#include "samplecache/albedo.cl"
#include "samplecache/dimensions.cl"
#include "samplecache/least_part.cl"
#include "voxelhash/address.cl"

#define MOST_VIEW_DEPENDENT 0.2f  // least part of a new value (least_part.cl)
#define DIAGONAL 1.7320508f       // of a cube

inline bool follows_view(const Surface *surface, __global const Material *m)
{
    return least_part(surface->metallic, surface->roughness, tinted_specular(surface), m) > MOST_VIEW_DEPENDENT;
}

// A bit for each component of the albedo by which light is not divided as it is (albedo.cl): of such light a surface that is not as dark
// could make nothing.
inline uint dark_of(const Surface *surface)
{
    Vec3 albedo = surface->albedo;
    return (albedo.x < LEAST_ALBEDO ? 1u : 0u) | (albedo.y < LEAST_ALBEDO ? 2u : 0u) | (albedo.z < LEAST_ALBEDO ? 4u : 0u);
}

inline bool is_too_near(const Seen *seen, int level)
{
#if GATE
    return seen->distance < DIAGONAL * edge_of(level);
#else
    return false;
#endif
}

// A point, and the level of the voxel that it asks: that level is chosen last, since another place may have another one.
typedef struct Asked {
    Vec3 point;
    int level;
} Asked;

INLINED Asked ask(const Camera *camera, const Seen *seen, float factor, Random random)
{
    Asked asked = { seen->point, level_at(camera, seen->point, seen->normal, factor) };
#if JITTER
    Vec3 tangent, bitangent;
    make_frame(seen->normal, &tangent, &bitangent);
    float edge = edge_of(asked.level);
    Vec3 aside = add3(scale3((random.x - 0.5f) * edge, tangent), scale3((random.y - 0.5f) * edge, bitangent));
    asked.point = add3(seen->point, aside);
    asked.level = level_at(camera, asked.point, seen->normal, factor);
#endif
#if COIN
    asked.level += random.z < 0.5f ? 1 : 0;
#endif
    return asked;
}

// The random numbers by which a pixel's sample asks.
inline Random random_of_asking(uint pixel, uint update, uint key0, uint key1)
{
    return random4(pixel, update, DIMENSION_VOXEL, key0, key1);
}
