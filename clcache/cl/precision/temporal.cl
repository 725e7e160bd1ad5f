// The temporal filter's weights by themselves (VarianceBlend, Eq. 4, 5, 10 and 11), in the vectors in which it computes them.
//
// Defines: those of temporal.cl.

#include "filter/temporal.cl"

// One work-item per sixteen numbers of each: the history's difference, the variance about the pixel, the known one, the history's N.
ONE_BY_ONE __kernel void measure(
    __global const float *told,  // (4, n)
    __global float *found,       // (3, n)
    uint n)
{
    uint i = 16 * get_global_id(0);
    if (i >= n) return;
    float16 difference = vload16(0, told + i), around = vload16(0, told + n + i);
    float16 variance = vload16(0, told + 2 * n + i), count = vload16(0, told + 3 * n + i);
    float16 alpha = corrected_alpha(difference, around, variance, count, (float16)(1.0f / 9.0f));
    vstore16(published_alpha(difference, around), 0, found + i);
    vstore16(alpha, 0, found + n + i);
    vstore16(effective_count(count, alpha), 0, found + 2 * n + i);
}
