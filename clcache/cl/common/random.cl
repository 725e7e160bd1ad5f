// Random numbers without state: a hash of (pixel, sample, dimension, key), where the host derives the 64-bit key from seed
// and frame. The same numbers for any number of threads and any order of work-items. clcache/random.py is the same
// function on the host.

// PCG4D (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020): four words in, four words out.
inline uint4 pcg4d(uint4 v)
{
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> 16;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

// Four independent numbers in [0, 1), multiples of 2^-24.
inline float4 random4(uint pixel, uint sample, uint dimension, uint2 key)
{
    uint4 bits = pcg4d((uint4)(pixel, sample, dimension ^ key.x, key.y));
    return convert_float4(bits >> 8) * 5.9604645e-8f;
}
