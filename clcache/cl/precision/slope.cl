// Eq. 1 of SampleCache by itself, as reprojection computes it.
//
// Defines: those of reproject.cl.

#include "samplecache/reproject.cl"

// One work-item per row: distance, cosine, and of the pixel's angle sine, cosine, 1 - cosine.
__kernel void measure(
    __global const float *told,  // (n, 5)
    __global float *found,       // (n, 1)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    __global const float *row = told + 5 * i;
    found[i] = slope_of(row[0], row[1], row[2], row[3], row[4]);
}
