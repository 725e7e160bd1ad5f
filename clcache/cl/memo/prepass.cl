// Of the camera's rays, one for each square of `spacing` pixels (MaterialMemo, section 6.7.2: the pre-pass): the others have no length.
// One work-item per path.

#include "common/math.cl"

__kernel void thin_out(
    __global const uint *pixel,  // (n)
    __global float *ray_length,  // (n)
    uint width,
    uint spacing,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint place = pixel[i], x = place % width, y = place / width;
    bool stays = x % spacing == spacing / 2 && y % spacing == spacing / 2;
    ray_length[i] = stays ? ray_length[i] : 0.0f;
}
