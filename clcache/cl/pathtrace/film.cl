// From sums over samples to pixels. One work-item per pixel. `samples` is how many there were.

#include "common/math.cl"

// The mean of each component.
__kernel void mean(
    __global const float *sum,  // (3, n)
    __global float *average,    // (3, n)
    uint n,
    uint samples)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    store_planes(average, n, i, load_planes(sum, n, i) / (float)samples);
}

// The mean direction, of unit length; zero where nothing was hit, or normals cancel.
__kernel void mean_direction(
    __global const float *sum,  // (3, n)
    __global float *average,    // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    store_planes(average, n, i, normalize3(load_planes(sum, n, i)));
}

// Add one sample's values.
__kernel void add_sample(
    __global const float *values,  // (3, n)
    __global float *sum,           // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    store_planes(sum, n, i, load_planes(sum, n, i) + load_planes(values, n, i));
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
    float3 before = load_planes(sum, n, i);
    float3 added = load_planes(values, n, i) - load_planes(lost, n, i);
    float3 after = before + added;
    store_planes(lost, n, i, (after - before) - added);
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
    float3 value = load_planes(values, n, i);
    store_planes(sum, n, i, load_planes(sum, n, i) + value * value);
}

// The variance of the mean, estimated from the samples' spread; infinite where there is but one sample, or squares overflow.
__kernel void variance_of_mean(
    __global const float *sum,         // (3, n)
    __global const float *square_sum,  // (3, n)
    __global float *variance,          // (3, n)
    uint n,
    uint samples)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    float3 average = load_planes(sum, n, i) / (float)samples;
    float3 spread = load_planes(square_sum, n, i) / (float)samples - average * average;
    spread = select(fmax(spread, 0.0f), (float3)(INFINITY), isnan(spread));
    store_planes(variance, n, i, samples > 1 ? spread / (float)(samples - 1) : (float3)(INFINITY));
}

// Depth along the camera's axis, where the sample is nearer than those before; +infinity stays where nothing was hit.
__kernel void nearest_depth(
    __global const float *ray_direction,  // (3, n)
    __global const float *hit_t,          // (n)
    __global float *depth,                // (n)
    Camera camera,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    float3 forward = -(float3)(camera.to_world[2], camera.to_world[6], camera.to_world[10]);
    float z = camera.near + hit_t[i] * dot3(forward, load_planes(ray_direction, n, i));
    depth[i] = z < depth[i] ? z : depth[i];
}
