// Random numbers without state: a hash of (pixel, sample, dimension, key), where the host derives the 64-bit key from seed
// and frame. The same numbers for any number of threads and any order of work-items. clcache/random.py is the same
// function on the host.

#include "common/math.cl"

typedef struct Words {
    uint x, y, z, w;
} Words;

typedef struct Random {
    float x, y, z, w;
} Random;

inline Random make_random(float x, float y, float z, float w)
{
    Random random = { x, y, z, w };
    return random;
}

// PCG4D (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020): four words in, four words out.
inline Words pcg4d(uint x, uint y, uint z, uint w)
{
    x = x * 1664525u + 1013904223u;
    y = y * 1664525u + 1013904223u;
    z = z * 1664525u + 1013904223u;
    w = w * 1664525u + 1013904223u;
    x += y * w;
    y += z * x;
    z += x * y;
    w += y * z;
    x ^= x >> 16;
    y ^= y >> 16;
    z ^= z >> 16;
    w ^= w >> 16;
    x += y * w;
    y += z * x;
    z += x * y;
    w += y * z;
    Words words = { x, y, z, w };
    return words;
}

// A number in [0, 1), a multiple of 2^-24, from a word's upper bits.
inline float to_unit(uint word)
{
    return (float)(int)(word >> 8) * 5.9604645e-8f;
}

// Four independent numbers in [0, 1).
inline Random random4(uint pixel, uint sample, uint dimension, uint key0, uint key1)
{
    Words bits = pcg4d(pixel, sample, dimension ^ key0, key1);
    return make_random(to_unit(bits.x), to_unit(bits.y), to_unit(bits.z), to_unit(bits.w));
}
