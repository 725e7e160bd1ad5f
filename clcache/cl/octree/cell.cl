// What a cell of the octree knows (OctreeCache, section 3.1): the mean light on each of its two sides, six words of 32 bits.
//
//   0  front R | front G << 16     1  front B | back R << 16     2  back G | back B << 16      halves, 0 .. 65504
//   3  NORMAL   of the front, octahedral, 16 + 16 bits; 0: none
//   4  COUNTS   samples of the front | of the back << 16, each 65535 at most
//   5  STAMP    of the last wipe before the cell was first used; what has another one is empty. 0: never used
//
// Light is without albedo and never negative. Halves are read and written by their bits: vload_half would keep the vectoriser
// off, and vstore_half knows no rounding by chance (merge.cl).

#include "common/math.cl"

#define CELL_WORDS 6
#define NORMAL_WORD 3
#define COUNTS_WORD 4
#define STAMP_WORD 5

// Places in `octree_wipe`. Two words of the lighting's digest stand between.
#define WIPE_STAMP 0
#define WIPE_OCCUPIED 3

// Where a cell's words begin. A signed number, by which vectors gather faster.
inline int words_of_cell(uint cell)
{
    return CELL_WORDS * (int)cell;
}

// A finite half that is not negative, in the lower 16 bits.
inline float half_to_float(uint bits)
{
    float subnormal = (float)(int)bits * 5.9604645e-8f;  // 2^-24 is the least
    return bits < 0x400 ? subnormal : as_float((bits << 13) + (112u << 23));
}

// A number that is 1 or -1 with the sign of v.
inline float sign_of(float v)
{
    return v < 0.0f ? -1.0f : 1.0f;
}

// A unit vector as the point of the unfolded octahedron: x | y << 16, each 1 .. 65535, 32768 is 0. Within 7e-5 radians.
INLINED uint pack_normal(Vec3 unit)
{
    float sum = fabs(unit.x) + fabs(unit.y) + fabs(unit.z), scale = sum > 0.0f ? 1.0f / sum : 0.0f;
    float x = unit.x * scale, y = unit.y * scale;
    float folded_x = (1.0f - fabs(y)) * sign_of(x), folded_y = (1.0f - fabs(x)) * sign_of(y);
    x = unit.z < 0.0f ? folded_x : x;
    y = unit.z < 0.0f ? folded_y : y;
    int qx = (int)(fmin(fmax(x, -1.0f), 1.0f) * 32767.0f + 32768.5f);
    int qy = (int)(fmin(fmax(y, -1.0f), 1.0f) * 32767.0f + 32768.5f);
    return (uint)qx | (uint)qy << 16;
}

// The same, not of unit length.
INLINED Vec3 unfold_normal(uint word)
{
    float x = (float)((int)(word & 0xFFFF) - 32768) * (1.0f / 32767.0f);
    float y = (float)((int)(word >> 16) - 32768) * (1.0f / 32767.0f);
    float z = 1.0f - fabs(x) - fabs(y);
    float folded_x = (1.0f - fabs(y)) * sign_of(x), folded_y = (1.0f - fabs(x)) * sign_of(y);
    return vec3(z < 0.0f ? folded_x : x, z < 0.0f ? folded_y : y, z);
}

INLINED Vec3 unpack_normal(uint word)
{
    Vec3 v = unfold_normal(word);
    return scale3(1.0f / sqrt(dot3(v, v)), v);
}

// Whether what has this normal is on the front side of a cell. Everything that reads or writes cells asks here.
INLINED bool is_front(Vec3 normal, uint cell_normal)
{
    return dot3(normal, unfold_normal(cell_normal)) > 0.0f;
}

// What a cell knows of a side: mean light and of how many samples.
typedef struct Side {
    Vec3 light;
    uint count;
} Side;

// The side of a cell that faces as `normal` does; count and light are 0 where nothing is known.
// cells: (cells, 6). index: of the cell, or NONE. wipe: the current stamp.
INLINED Side cell_side(__global const uint *cells, uint index, Vec3 normal, uint wipe)
{
    bool is_there = index != NONE;
    __global const uint *words = cells + words_of_cell(is_there ? index : 0);
    bool is_known = is_there && words[STAMP_WORD] == wipe;
    bool front = is_front(normal, words[NORMAL_WORD]);
    uint a = words[0], b = words[1], c = words[2], counts = words[COUNTS_WORD];
    uint red = front ? a & 0xFFFF : b >> 16, green = front ? a >> 16 : c & 0xFFFF, blue = front ? b & 0xFFFF : c >> 16;
    Side side;
    side.count = is_known ? (front ? counts & 0xFFFF : counts >> 16) : 0;
    side.light = either3(side.count > 0, vec3(half_to_float(red), half_to_float(green), half_to_float(blue)), all3(0.0f));
    return side;
}
