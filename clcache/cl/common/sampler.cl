// The numbers that a sample's choices are made by: four for each (pixel, sample, dimension), in [0, 1).
//
// Independent: a hash (random.cl). Otherwise two pairs of the first two dimensions of the Sobol sequence, each with its own
// Owen scrambling and its own order of the samples (Burley 2020, "Practical Hash-based Owen Scrambling", JCGT 10(4)): in
// each pair the first 2^k samples of a pixel are well spread, and pairs are independent of each other.
//
// Defines: SOBOL.

#include "common/random.cl"

inline uint reverse_bits(uint v)
{
    v = (v >> 1 & 0x55555555u) | (v & 0x55555555u) << 1;
    v = (v >> 2 & 0x33333333u) | (v & 0x33333333u) << 2;
    v = (v >> 4 & 0x0F0F0F0Fu) | (v & 0x0F0F0F0Fu) << 4;
    v = (v >> 8 & 0x00FF00FFu) | (v & 0x00FF00FFu) << 8;
    return v >> 16 | v << 16;
}

// An Owen scrambling of the bit-reversed v: each bit is flipped depending on the lower ones alone (Laine and Karras 2011;
// constants by Vegdahl, as in Burley's supplement).
inline uint scramble_reversed(uint v, uint seed)
{
    v ^= v * 0x3d20adeau;
    v += seed;
    v *= seed >> 16 | 1u;
    v ^= v * 0x05526c56u;
    v ^= v * 0x53a22864u;
    return v;
}

// The second Sobol dimension of `index`, bit-reversed: a product with Pascal's triangle modulo 2, which is the exclusive
// or over all supersets of a bit's number (Lucas), one step for each of that number's five bits.
inline uint sobol_second_reversed(uint index)
{
    index ^= index >> 1 & 0x55555555u;
    index ^= index >> 2 & 0x33333333u;
    index ^= index >> 4 & 0x0F0F0F0Fu;
    index ^= index >> 8 & 0x00FF00FFu;
    index ^= index >> 16 & 0x0000FFFFu;
    return index;
}

INLINED void sobol_pair(uint sample, uint order, uint scramble_x, uint scramble_y, float *x, float *y)
{
    uint index = reverse_bits(scramble_reversed(reverse_bits(sample), order));
    *x = to_unit(reverse_bits(scramble_reversed(index, scramble_x)));
    *y = to_unit(reverse_bits(scramble_reversed(sobol_second_reversed(index), scramble_y)));
}

INLINED Random sample4(uint pixel, uint sample, uint dimension, uint key0, uint key1)
{
#if SOBOL
    Words first = pcg4d(pixel, 2 * dimension, key0, key1);
    Words second = pcg4d(pixel, 2 * dimension + 1, key0, key1);
    float x, y, z, w;
    sobol_pair(sample, first.x, first.y, first.z, &x, &y);
    sobol_pair(sample, second.x, second.y, second.z, &z, &w);
    return make_random(x, y, z, w);
#else
    return random4(pixel, sample, dimension, key0, key1);
#endif
}
