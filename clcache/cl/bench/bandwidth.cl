// What memory gives at most: one kernel that copies and one that only reads, over arrays much larger than the caches.

// Vectors that one work-item reads, one behind the other; as in bench/bandwidth.py.
#define RUN 64u

// One work-item per vector.
__kernel void copy(
    __global const float16 *from,  // (n)
    __global float16 *to,          // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    to[i] = from[i];
}

// One work-item per run of vectors: the sum of all their numbers. The four sums do not wait for each other.
__kernel void read(
    __global const float16 *values,  // (n)
    __global float *sums,            // (runs)
    uint n,
    uint runs)
{
    uint run = get_global_id(0);
    if (run >= runs) return;
    __global const float16 *mine = values + run * RUN;
    float16 a = 0.0f, b = 0.0f, c = 0.0f, d = 0.0f;
    for (uint i = 0; i < RUN; i += 4) {
        a += mine[i];
        b += mine[i + 1];
        c += mine[i + 2];
        d += mine[i + 3];
    }
    float16 sum = (a + b) + (c + d);
    float8 eight = sum.lo + sum.hi;
    float4 four = eight.lo + eight.hi;
    float2 two = four.lo + four.hi;
    sums[run] = two.x + two.y;
}
