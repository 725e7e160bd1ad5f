// Camera rays: one for each pixel, through a place in it that the sample's random numbers choose (a box filter). All begin at
// the eye, so that packets of them are traced as such, and count from where they leave the near plane. One work-item per
// path; a path without a pixel has a ray of length 0, which is none. The cone about a ray begins with no width and the
// angle of a pixel.
//
// Defines: SOBOL, HAS_EMISSION, HAS_TEXTURES.

#include "common/camera.cl"
#include "common/pixel_order.cl"
#include "common/sampler.cl"
#include "pathtrace/dimensions.cl"
#include "pathtrace/queue.cl"

// The pixel of each path; NONE where there is none.
__kernel void order_pixels(
    __global uint *pixel,  // (n)
    uint n,
    uint width,
    uint height)
{
    uint path = get_global_id(0), paths = blocks_along(width) * blocks_along(height) * BLOCK * BLOCK;
    if (path < n) pixel[path] = path < paths ? pixel_of_path(path, width, height) : NONE;
}

__kernel void generate(
    __global const uint *pixel,     // (n)
    __global float *ray_origin,     // (3, n)
    __global float *ray_direction,  // (3, n)
    __global float *ray_start,      // (n)
    __global float *ray_length,     // (n)
    __global float *throughput,     // (3, n)
    __global float *radiance,       // (3, n)
    __global float *density,        // (n) or null
    __global float *cone,           // (2, n) or null
    __global uint *path,            // (n)
    __global uint *alive,           // (chunks)
    Camera camera,
    uint n,
    uint sample,
    uint key0,
    uint key1)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint place = pixel[i];
    bool is_there = place != NONE;
    place = is_there ? place : 0;
    Random random = sample4(place, sample, DIMENSION_PIXEL, key0, key1);
    int row, column;
    place_of_pixel(place, camera.width, &row, &column);
    Vec3 on_plane = through_pixel(&camera, (float)column + random.x, (float)row + random.y);
    store_planes(ray_origin, n, i, eye_of(&camera));
    store_planes(ray_direction, n, i, normalize3(on_plane));
    ray_start[i] = camera.near * sqrt(dot3(on_plane, on_plane));  // the plane is at distance 1
    ray_length[i] = is_there ? INFINITY : 0.0f;
    store_planes(throughput, n, i, all3(1.0f));
    store_planes(radiance, n, i, all3(0.0f));
    path[i] = i;
    if (i % CHUNK == 0) alive[i / CHUNK] = min(CHUNK, n - i);
#if HAS_EMISSION
    density[i] = INFINITY;  // as after a mirror: nothing else could have found what this ray finds
#endif
#if HAS_TEXTURES
    cone[i] = 0.0f;
    cone[n + i] = pixel_spread(&camera);
#endif
}
