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
