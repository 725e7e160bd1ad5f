// From sums over samples to images. One work-item per path; sums are in the paths' order, images in the pixels'. `samples` is
// how many there were.

#include "common/math.cl"

// The mean of each component.
__kernel void mean(
    __global const uint *pixel,  // (n)
    __global const float *sum,   // (3, n)
    __global float *average,     // (pixels, 3)
    uint n,
    uint pixels,
    uint samples)
{
    uint i = get_global_id(0);
    if (i >= n || pixel[i] == NONE) return;
    store_row(average, pixel[i], scale3(1.0f / (float)samples, load_vec3(sum, n, i)));
}

// The mean direction, of unit length; zero where nothing was hit, or normals cancel.
__kernel void mean_direction(
    __global const uint *pixel,  // (n)
    __global const float *sum,   // (3, n)
    __global float *average,     // (pixels, 3)
    uint n,
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= n || pixel[i] == NONE) return;
    store_row(average, pixel[i], normalize3(load_vec3(sum, n, i)));
}

// Add one sample's values, and keep what rounding loses of them (Kahan): a mean of any number of samples is as good as one
// of few. `lost` is what the sum has too much.
__kernel void add_compensated(
    __global const float *values,  // (3, n)
    __global float *sum,           // (3, n)
    __global float *lost,          // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Vec3 before = load_vec3(sum, n, i);
    Vec3 added = sub3(load_vec3(values, n, i), load_vec3(lost, n, i));
    Vec3 after = add3(before, added);
    store_planes(lost, n, i, sub3(sub3(after, before), added));
    store_planes(sum, n, i, after);
}

// Add the squares of one sample's values.
__kernel void add_square(
    __global const float *values,  // (3, n)
    __global float *sum,           // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Vec3 value = load_vec3(values, n, i);
    store_planes(sum, n, i, add3(load_vec3(sum, n, i), mul3(value, value)));
}

// Of one component: the variance of the mean, estimated from the samples' spread; infinite where there is but one sample, or
// squares overflow.
inline float variance_of(float sum, float square_sum, uint samples)
{
    float average = sum / (float)samples;
    float spread = square_sum / (float)samples - average * average;
    return samples > 1 && !isnan(spread) ? fmax(spread, 0.0f) / (float)(samples - 1) : INFINITY;
}

__kernel void variance_of_mean(
    __global const uint *pixel,        // (n)
    __global const float *sum,         // (3, n)
    __global const float *square_sum,  // (3, n)
    __global float *variance,          // (pixels, 3)
    uint n,
    uint pixels,
    uint samples)
{
    uint i = get_global_id(0);
    if (i >= n || pixel[i] == NONE) return;
    Vec3 total = load_vec3(sum, n, i), squares = load_vec3(square_sum, n, i);
    Vec3 found = vec3(variance_of(total.x, squares.x, samples), variance_of(total.y, squares.y, samples),
                      variance_of(total.z, squares.z, samples));
    store_row(variance, pixel[i], found);
}

// Depth along the camera's axis, where the sample is nearer than those before; +infinity stays where nothing was hit.
__kernel void nearest_depth(
    __global const uint *pixel,           // (n)
    __global const float *ray_direction,  // (3, n)
    __global const float *hit_t,          // (n)
    __global float *depth,                // (pixels)
    Camera camera,
    uint n,
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= n || pixel[i] == NONE) return;
    Vec3 forward = vec3(-camera.to_world[2], -camera.to_world[6], -camera.to_world[10]);
    float z = hit_t[i] * dot3(forward, load_vec3(ray_direction, n, i));
    depth[pixel[i]] = z < depth[pixel[i]] ? z : depth[pixel[i]];
}
