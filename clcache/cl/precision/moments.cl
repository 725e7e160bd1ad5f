// The variance of weighted pixels by itself (SampleCache, section 3.6, Eq. 5 to 7), as stereo blending adds it up.
//
// Define: BLUR, as of blend.cl.

#include "samplecache/blend.cl"

// One work-item per neighbourhood of nine means, without spread of their own: the first is the origin. weights: of each.
ONE_BY_ONE __kernel void measure(
    __global const float *told,     // (n, 9)
    __global const float *weights,  // (n, 9)
    __global float *found,          // (n, 1)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    float4 origin = told[9 * i];
    Moments sum = { 0.0f, (float4)(0.0f), (float4)(0.0f) };
    for (uint k = 0; k < 9; k++) {
        float8 row = 0.0f;
        row.lo = told[9 * i + k];
        add_moments(&sum, weights[9 * i + k], row, origin);
    }
    found[i] = variance_of(sum).x;
}
