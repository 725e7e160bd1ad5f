// The cells of an octree (HashCache, section 3.1). Level l divides the cube into 2^l cells along each edge, up to 2^12. A cell's
// key is the Morton code of its coordinates, 3 l bits, of each three x the lowest, then y, then z: the parent's key is
// key >> 3, and the cells of a part of space stand side by side.
//
// Straight-line code on numbers of 32 bits, so that compilers compute neighbouring work-items in the lanes of vectors.

#include "common/math.cl"

#define PART_BITS 30  // of a key: the place among the 1024^3 cells of its part of space; the bits above say which part

// Bit i of ten bits to bit 3 i.
inline uint spread_bits(uint v)
{
    v = (v | v << 16) & 0x030000FFu;
    v = (v | v << 8) & 0x0300F00Fu;
    v = (v | v << 4) & 0x030C30C3u;
    return (v | v << 2) & 0x09249249u;
}

// Coordinates are below 4096.
INLINED ulong morton_key(uint x, uint y, uint z)
{
    uint within = spread_bits(x & 1023u) | spread_bits(y & 1023u) << 1 | spread_bits(z & 1023u) << 2;
    uint part = spread_bits(x >> 10) | spread_bits(y >> 10) << 1 | spread_bits(z >> 10) << 2;
    return (ulong)part << PART_BITS | within;
}

// 2^exponent, exactly.
inline float power_of_two(int exponent)
{
    return as_float((uint)(127 + exponent) << 23);
}

// A coordinate's cell. A coordinate that is not a number counts as low. That of a level is that of any finer one, shifted.
inline uint cell_of(float coordinate, float low, float per_size, uint level)
{
    float along = (coordinate - low) * per_size;
    float inside = along > 0.0f ? (along < 1.0f ? along : 1.0f) : 0.0f;
    int cell = (int)(inside * power_of_two((int)level)), last = (1 << level) - 1;
    return (uint)(cell < last ? cell : last);
}

// The key of the level's cell that a point lies in; of a point outside the cube, of the nearest cell.
INLINED ulong cell_key(const OctreeShape *shape, Vec3 point, uint level)
{
    float per_size = 1.0f / shape->size;
    return morton_key(cell_of(point.x, shape->origin[0], per_size, level), cell_of(point.y, shape->origin[1], per_size, level),
                      cell_of(point.z, shape->origin[2], per_size, level));
}

// The length of a cell's edge, in metres.
inline float cell_edge(const OctreeShape *shape, uint level)
{
    return shape->size * power_of_two(-(int)level);
}
