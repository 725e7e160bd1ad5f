// Camera rays: one for each pixel, through a place in it that the sample's random numbers choose (a box filter). They begin
// on the near plane. Writes the rays and resets the paths. One work-item per pixel. The cone about a ray begins with no
// width and the angle of a pixel. Defines: SOBOL.

#include "common/sampler.cl"
#include "common/transform.cl"
#include "pathtrace/dimensions.cl"

__kernel void generate(
    __global float *ray_origin,     // (3, n)
    __global float *ray_direction,  // (3, n)
    __global float *ray_length,     // (n)
    __global float *throughput,     // (3, n)
    __global float *radiance,       // (3, n)
    __global float *density,        // (n) or null
    __global float *cone,           // (2, n) or null
    Camera camera,
    uint n,
    uint sample,
    uint key0,
    uint key1)
{
    uint pixel = get_global_id(0);
    if (pixel >= n) return;
    uint x = pixel % camera.width, y = pixel / camera.width;
    float4 random = sample4(pixel, sample, DIMENSION_PIXEL, (uint2)(key0, key1));
    float across = 2.0f * (((float)x + random.x) / (float)camera.width) - 1.0f;
    float down = 2.0f * (((float)y + random.y) / (float)camera.height) - 1.0f;
    float3 on_plane = transform_vector(camera.to_world, (float3)(across * camera.slope[0], -down * camera.slope[1], -1.0f));
    float3 eye = (float3)(camera.to_world[3], camera.to_world[7], camera.to_world[11]);
    store_planes(ray_origin, n, pixel, eye + camera.near * on_plane);
    store_planes(ray_direction, n, pixel, normalize3(on_plane));
    ray_length[pixel] = INFINITY;
    store_planes(throughput, n, pixel, (float3)(1.0f));
    store_planes(radiance, n, pixel, (float3)(0.0f));
    if (density) density[pixel] = INFINITY;  // as after a mirror: nothing else could have found what this ray finds
    if (cone) {
        cone[pixel] = 0.0f;
        cone[n + pixel] = 2.0f * camera.slope[1] / (float)camera.height;
    }
}
