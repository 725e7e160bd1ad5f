// Under which key a graph's values are remembered (MaterialMemo, sections 4.3, 5.3.2 and 5.4.2): graph, level and texel of a sparse
// virtual texture, in two dimensions for graphs of texture coordinates, in three for those of the place within the object, in
// five for those of both. A level is the binary logarithm of the texels for each unit of length: m = round(-log2(l_min) + bias), by
// the shorter axis of the footprint. (Eq. 5.5 lacks the sign, as Eq. 5.16 shows: density is the reciprocal of length.) It has bounds, and
// is so low that texels can be counted; so points whose numbers are large have coarser ones, as their numbers are.
//
// A texel's value is that in its middle. (The thesis's texels lie about whole multiples of their size, Eq. 5.6. Paths' later cones are so
// wide that these are mostly whole numbers, where pictures have their seams and noise its zeros.) So that a surface which wide cones
// meet is more than a few values, texels are no larger than a part of what the graph covers (`coarsest`, resources.py): of wider cones
// the level says how graphs filter, and not how far texels are apart. Those that are nearly as large have their value at a point
// that a hash chooses, since their middles may all be at the same place of a pattern that repeats. The finest texels are points.

#include "scene/graph_inputs.cl"

#define READS_UV 1u
#define READS_POSITION 2u
#define IS_MEMOIZED 4u  // bits of memo_mode

#define FINEST_LEVEL 24
#define COARSEST_LEVEL -24
#define LEAST_TEXELS_LOG2 4  // of texels along what a graph covers, as in resources.py
#define SCATTERED_LEVELS 3  // above the coarsest, in which values are not those of middles
#define TEXEL_BITS 29       // of a texel's number, without sign

// A level, the one by which texels are apart, and whether their values are at points that a hash chooses.
typedef struct Level {
    int footprint, texels;
    uint is_scattered;
} Level;

// PCG (O'Neill 2014), one word in, one word out, one to one.
INLINED uint pcg_hash(uint word)
{
    uint state = word * 747796405u + 2891336453u;
    uint mixed = ((state >> ((state >> 28) + 4u)) ^ state) * 277803737u;
    return mixed >> 22 ^ mixed;
}

// 2^level, exactly.
inline float power_of_two(int level)
{
    return as_float((uint)(level + 127) << 23);
}

// The level at which texels are as large as the shorter of two axes; `largest` is the largest of the point's coordinates.
INLINED Level level_of(float squared_x, float squared_y, float largest, float bias, int coarsest)
{
    float squared = fmin(squared_x, squared_y);
    float level = floor(-0.5f * log2_of(fmin(fmax(squared, 1e-37f), 1e37f)) + bias + 0.5f);
    int exponent = (int)(as_uint(largest) >> 23) - 127;  // largest < 2^(exponent + 1)
    int finest = max(min(FINEST_LEVEL, TEXEL_BITS - 1 - exponent), COARSEST_LEVEL);
    Level found;
    int widest = max(coarsest - LEAST_TEXELS_LOG2, COARSEST_LEVEL);  // as wide as what the graph covers: wider ones see no more
    found.footprint = max(min((int)fmin(fmax(level, -64.0f), 64.0f), finest), min(widest, finest));
    found.texels = min(max(found.footprint, coarsest), finest);
    found.is_scattered = found.texels < coarsest + SCATTERED_LEVELS && found.texels < FINEST_LEVEL ? 1 : 0;
    return found;
}

// All in one word, and back.
inline uint word_of(Level level)
{
    return (uint)(level.footprint - COARSEST_LEVEL) | (uint)(level.texels - COARSEST_LEVEL) << 8 | level.is_scattered << 16;
}

inline Level level_in(uint word)
{
    Level level = { (int)(word & 255u) + COARSEST_LEVEL, (int)(word >> 8 & 255u) + COARSEST_LEVEL, word >> 16 };
    return level;
}

// Where in a texel its value is taken where that is its middle, of its size.
inline float middle_of(Level level)
{
    return level.texels == FINEST_LEVEL ? 0.0f : 0.5f;
}

// The same in two dimensions, of texel (u, v).
inline Pair place_in_texel(Level level, int u, int v)
{
    uint word = pcg_hash((uint)u ^ pcg_hash((uint)v ^ pcg_hash(word_of(level))));
    float middle = middle_of(level);
    Pair place = { level.is_scattered ? (float)(int)(word & 0xFFFFu) / 65536.0f : middle,
                   level.is_scattered ? (float)(int)(word >> 16) / 65536.0f : middle };
    return place;
}

// The texel of a coordinate.
INLINED int texel_of(float coordinate, float density)
{
    return (int)fmin(fmax(floor(coordinate * density), -1.0e9f), 1.0e9f);
}

typedef struct Key {
    Level level, level3;  // of texture coordinates, and of the place
    int u, v, x, y, z;  // numbers of texels, or of tiles
    uint hash, check;
} Key;

INLINED uint hash_of(const Key *key, uint reads, uint seed)
{
    uint of_place = pcg_hash((uint)key->x ^ pcg_hash((uint)key->y ^ pcg_hash((uint)key->z ^ seed)));
    of_place = pcg_hash(word_of(key->level3) ^ of_place);
    seed = (reads & READS_POSITION) ? of_place : seed;
    uint of_uv = pcg_hash(word_of(key->level) ^ pcg_hash((uint)key->u ^ pcg_hash((uint)key->v ^ seed)));
    return (reads & READS_UV) ? of_uv : seed;
}

// Eq. 5.8 and 5.9: the two hashes, of which the second keeps clear of what keys of the table mean otherwise.
INLINED void finish_key(Key *key, uint graph, uint reads)
{
    key->hash = hash_of(key, reads, pcg_hash(graph));
    uint check = hash_of(key, reads, pcg_hash(~graph));
    key->check = check < 3u ? check + 0x80000000u : check;
}

inline float squared2(Pair v)
{
    return v.u * v.u + v.v * v.v;
}

// coarsest: the levels of the graph's coarsest texels, in two dimensions and in three.
INLINED void find_levels(Key *key, const GraphHit *hit, float bias, __global const int *coarsest)
{
    key->level = level_of(squared2(hit->uv_x), squared2(hit->uv_y), fmax(fabs(hit->uv.u), fabs(hit->uv.v)), bias,
                          coarsest[0]);
    key->level3 = level_of(dot3(hit->position_x, hit->position_x), dot3(hit->position_y, hit->position_y),
                           max_component(abs3(hit->position)), bias, coarsest[1]);
}

// The texel that a hit lies in.
INLINED Key texel_key(const GraphHit *hit, uint graph, uint reads, float bias, __global const int *coarsest)
{
    Key key;
    find_levels(&key, hit, bias, coarsest + 2 * graph);
    float density = power_of_two(key.level.texels), density3 = power_of_two(key.level3.texels);
    key.u = texel_of(hit->uv.u, density);
    key.v = texel_of(hit->uv.v, density);
    key.x = texel_of(hit->position.x, density3);
    key.y = texel_of(hit->position.y, density3);
    key.z = texel_of(hit->position.z, density3);
    finish_key(&key, graph, reads);
    return key;
}

// A hit where its texel's value is taken, with the level's footprint (Eq. 5.16 and 5.17): the same for all that have the key. In three dimensions
// the footprint's axes are the first two.
INLINED GraphHit snapped(const GraphHit *hit, const Key *key)
{
    GraphHit middle = *hit;
    float size = power_of_two(-key->level.texels), size3 = power_of_two(-key->level3.texels);
    Pair place = place_in_texel(key->level, key->u, key->v), place_xy = place_in_texel(key->level3, key->x, key->y ^ key->z);
    float place_z = place_in_texel(key->level3, key->y, key->z ^ key->x).v;
    middle.uv.u = ((float)key->u + place.u) * size;
    middle.uv.v = ((float)key->v + place.v) * size;
    middle.uv_x.u = middle.uv_y.v = power_of_two(-key->level.footprint);
    middle.uv_x.v = middle.uv_y.u = 0.0f;
    Vec3 position = vec3((float)key->x + place_xy.u, (float)key->y + place_xy.v, (float)key->z + place_z);
    middle.position = scale3(size3, position);
    middle.position_x = vec3(power_of_two(-key->level3.footprint), 0.0f, 0.0f);
    middle.position_y = vec3(0.0f, power_of_two(-key->level3.footprint), 0.0f);
    return middle;
}
