// Which voxel a point belongs to, and where the table has it (SampleCache, section 4).
//
// Voxels are cubes, 2^level metres along an edge, no larger than what a pixel in the image's middle covers at the point's distance: at
// right angles to the ray, or, with LOD_BY_INCIDENCE, along the surface, where grazing rays have the voxels of many pixels in
// one. They are told apart by level, by which of the six axis directions the normal is closest to, so that the sides of a wall
// thinner than a voxel share none, by which components of the albedo are too dark to divide by, and by place. Voxels that lie side by side in the plane across that axis form tiles of 4 x 4, and
// a tile has a block of the table for itself: neighbours share cache lines.
//
// The tile's hash says where; a hash of the voxel's place with another seed is compared.
//
// Defines: LOD_BY_INCIDENCE.

#include "common/random.cl"
#include "scene/first_hit.cl"
#include "voxelhash/table.cl"

#define TILE_SIDE_BITS 2   // of TILE
#define LEAST_COSINE 0.0625f
#define HIGHEST_LEVEL 100  // and, below 0, the lowest
#define FARTHEST 1e9f      // voxels from the origin, in each coordinate: those farther away become one. Beyond 2^24 floats are coarser
#define PLACE_SEED 0x5BF03635u
#define CHECK_SEED 0x9D2C5681u

// Surfaces often lie at round coordinates, just where voxels meet, and rounding errors would have them in both by turns. So layers
// begin this part of an edge off.
#define LAYER_OFFSET 0.3183f

// A point that the eye sees, as voxels take it.
typedef struct Seen {
    Vec3 point;
    Vec3 normal;    // of the triangle, towards the eye
    float distance;
} Seen;

typedef struct Voxel {
    uint place;  // where the search for it begins
    uint check;
} Voxel;

INLINED Seen seen_point(const Geometry *geometry, const Camera *camera, FirstHit hit)
{
    Located located = locate(geometry, hit);
    Vec3 towards = sub3(located.point, eye_of(camera));
    bool is_behind = dot3(towards, located.normal) > 0.0f;
    Seen seen = { located.point, either3(is_behind, negate3(located.normal), located.normal), sqrt(dot3(towards, towards)) };
    return seen;
}

// 2^level, for levels in range.
inline float edge_of(int level)
{
    return as_float((uint)(127 + level) << 23);
}

// factor: how much larger than a pixel voxels may be.
INLINED int level_at(const Camera *camera, Vec3 point, Vec3 normal, float factor)
{
    Vec3 towards = sub3(point, eye_of(camera));
    float distance = sqrt(dot3(towards, towards)), footprint = factor * pixel_spread(camera) * distance;
#if LOD_BY_INCIDENCE
    footprint /= fmax(fabs(dot3(towards, normal)) / fmax(distance, FLT_MIN), LEAST_COSINE);
#endif
    int exponent = (int)(as_uint(footprint) >> 23) - 127;
    return min(max(exponent, -HIGHEST_LEVEL), HIGHEST_LEVEL);
}

inline int whole(float coordinate)
{
    return (int)floor(fmin(fmax(coordinate, -FARTHEST), FARTHEST));
}

// dark: of the albedo's components (ask.cl). blocks: of the table.
INLINED Voxel voxel_at(Vec3 point, Vec3 normal, int level, uint dark, uint blocks)
{
    Vec3 scaled = scale3(edge_of(-level), point), size = abs3(normal);
    bool is_x = size.x >= size.y && size.x >= size.z, is_y = !is_x && size.y >= size.z;
    float along = is_x ? normal.x : is_y ? normal.y : normal.z;
    uint face = (is_x ? 0u : is_y ? 2u : 4u) + (along < 0.0f ? 1u : 0u);
    int u = whole(is_x ? scaled.y : scaled.x), v = whole(is_x || is_y ? scaled.z : scaled.y);
    int layer = whole((is_x ? scaled.x : is_y ? scaled.y : scaled.z) + LAYER_OFFSET);
    uint kind = (uint)(level + 128) << 6 | dark << 3 | face, within = (1u << TILE_SIDE_BITS) - 1;
    Words tile = pcg4d((uint)(u >> TILE_SIDE_BITS), (uint)(v >> TILE_SIDE_BITS), (uint)layer, kind ^ PLACE_SEED);
    Words check = pcg4d((uint)u, (uint)v, (uint)layer, kind ^ CHECK_SEED);
    uint block = (uint)((ulong)tile.x * blocks >> 32);
    Voxel voxel = { block * TILE + (((uint)v & within) << TILE_SIDE_BITS | ((uint)u & within)), check.x > 0 ? check.x : 1u };
    return voxel;
}
