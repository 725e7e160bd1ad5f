// The running estimate (HashCache, section 3.3): while the camera rests and the light stays the same, the image is the mean of
// all that have been made since.

#include "common/math.cl"

#define CAMERA_WORDS 17
#define ESTIMATE_WIPE 17    // in `estimate_of`, behind the camera's words: the stamp of the wipe
#define ESTIMATE_COUNT 18   // images
#define MOST_IMAGES 16777215u  // beyond it float32's mean would not move any more

// Whether the estimate goes on. One work-item in all.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void begin_estimate(
    __global const uint *octree_wipe,  // (4)
    __global uint *estimate_of,        // (words)
    Camera camera,
    uint words)
{
    if (get_global_id(0) > 0 || words == 0) return;
    uint now[CAMERA_WORDS + 1];
    for (uint k = 0; k < 12; k++) now[k] = as_uint(camera.to_world[k]);
    now[12] = as_uint(camera.slope[0]);
    now[13] = as_uint(camera.slope[1]);
    now[14] = as_uint(camera.near);
    now[15] = camera.width;
    now[16] = camera.height;
    now[ESTIMATE_WIPE] = octree_wipe[0];
    uint count = estimate_of[ESTIMATE_COUNT];
    for (uint k = 0; k <= ESTIMATE_WIPE; k++) {
        count = estimate_of[k] == now[k] ? count : 0;
        estimate_of[k] = now[k];
    }
    estimate_of[ESTIMATE_COUNT] = min(count, MOST_IMAGES) + 1;
}

// One work-item per pixel.
__kernel void estimate(
    __global const uint *estimate_of,       // (words)
    __global const float *layer0_filtered,  // (3, pixels)
    __global float *color,                  // (pixels, 3)
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= pixels) return;
    float count = (float)(int)estimate_of[ESTIMATE_COUNT];
    Vec3 image = load_vec3(layer0_filtered, pixels, i), mean = row3(color, i);
    bool is_first = count == 1.0f;
    store_row(color, i, either3(is_first, image, add3(mean, scale3(1.0f / count, sub3(image, mean)))));
}
