// What an update brings becomes part of a cell's means (HashCache, section 3.2). A cell's two sides are worked on at once, as a
// vector:
//
//   front R, G, B, number of samples,  back R, G, B, number of samples

#include "common/random.cl"
#include "octree/cell.cl"

#define MOST_SAMPLES 65535.0f
#define LARGEST_HALF 65504.0f

inline float8 halves_to_floats(uint8 bits)
{
    float8 subnormal = convert_float8(as_int8(bits)) * 5.9604645e-8f;  // 2^-24 is the least
    return bits < 0x400 ? subnormal : as_float8((bits << 13) + (112u << 23));
}

// For each number of 0 .. 65504 one of the two halves beside it, by chance (32 random bits): the nearer one more often, so that
// the expected value is the number itself. Rounding to the nearest would stop a mean of many samples from moving. What is a
// half stays as it is.
inline uint8 round_to_halves(float8 v, uint8 random)
{
    float8 scaled = min(v * 16777216.0f, 1024.0f);
    int8 whole = convert_int8(scaled);
    int8 is_more = convert_float8(as_int8(random >> 8)) * 5.9604645e-8f < scaled - convert_float8(whole);
    uint8 subnormal = as_uint8(whole - is_more);
    uint8 normal = ((as_uint8(v) + (random >> 19)) >> 13) - (112u << 10);
    return v < 6.103515625e-5f ? subnormal : normal;
}

// Add sums and numbers of samples to a cell, which is empty unless its stamp is that of the last wipe. The mean goes on as a
// running
// one: samples count alike, until a side has MOST_SAMPLES; from there on n new ones have a weight of n / (MOST_SAMPLES + n).
// normal: of the cell's front. random: of this cell and update.
inline void merge_into_cell(__global uint *words, float8 sum, uint normal, uint wipe, Words random)
{
    uint known = words[STAMP_WORD] == wipe ? 0xFFFFFFFF : 0;
    uint a = words[0] & known, b = words[1] & known, c = words[2] & known, counts = words[COUNTS_WORD] & known;
    float front = (float)(int)(counts & 0xFFFF), back = (float)(int)(counts >> 16);
    uint8 halves = (uint8)(a, a >> 16, b, 0, b >> 16, c, c >> 16, 0) & 0xFFFF;
    float8 before = (float8)(front, front, front, front, back, back, back, back), added = sum.s33337777, after = before + added;
    float8 mean = (halves_to_floats(halves) * before + sum) / max(after, 1.0f);
    uint8 chance = (uint8)(random.x, random.y, random.z, random.w, random.x, random.y, random.z, random.w);
    uint8 rounded = round_to_halves(min(max(mean, 0.0f), LARGEST_HALF), chance);
    halves = added > 0.0f ? rounded : halves;
    after = min(after, MOST_SAMPLES);
    words[0] = halves.s0 | halves.s1 << 16;
    words[1] = halves.s2 | halves.s4 << 16;
    words[2] = halves.s5 | halves.s6 << 16;
    words[NORMAL_WORD] = normal;
    words[COUNTS_WORD] = (uint)(int)after.s3 | (uint)(int)after.s7 << 16;
    words[STAMP_WORD] = wipe;
}
