// The stereo filter's weight of the other eye by itself (VarianceBlend, Eq. 4, 10 and 11).
//
// Defines: VARIANCE, PER_CHANNEL, as of stereo.cl.

#include "filter/stereo.cl"

// One work-item per neighbourhood of 3 x 3 numbers, row by row, and the other eye's difference from the one in the middle.
__kernel void measure(
    __global const float *told,         // (n, 9)
    __global const float *differences,  // (n)
    __global float *found,              // (n, 1)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    found[i] = part_of_other(told + 9 * i, 4, 3, true, true, differences[i]);
}
