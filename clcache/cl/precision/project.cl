// Where points appear in the image, by themselves (SampleCache, section 3.1): camera.cl's projection, and what retracing begins with.

#include "common/camera.cl"

// One work-item per point. cameras: to_world, slope, near; a row for each.
__kernel void measure(
    __global const float *cameras,  // (n, 15)
    __global const float *points,   // (n, 3)
    __global float *found,          // (n, 3)
    uint width,
    uint height,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Camera camera;
    for (int k = 0; k < 12; k++) camera.to_world[k] = cameras[15 * i + k];
    camera.slope[0] = cameras[15 * i + 12];
    camera.slope[1] = cameras[15 * i + 13];
    camera.near = cameras[15 * i + 14];
    camera.width = width;
    camera.height = height;
    Vec3 towards = sub3(row3(points, i), eye_of(&camera));
    float x, y;
    bool is_in_front = project(&camera, towards, camera.near, &x, &y);
    found[3 * i] = is_in_front ? x : -1.0f;
    found[3 * i + 1] = is_in_front ? y : -1.0f;
    found[3 * i + 2] = sqrt(dot3(towards, towards));
}
