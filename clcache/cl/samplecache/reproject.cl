// Forward reprojection (SampleCache, section 3.1), the part that all variants share: which samples there are, and where each
// of them appears to the current camera. Which slots they get is up to arrivals.cl or reserve.cl.
//
// Defines: ISRT (a sample's slot is its place within the pixel), SUPER (places along a pixel's side), those of moved.cl.

#include "common/camera.cl"
#include "scene/first_hit.cl"
#include "samplecache/groups.cl"
#include "samplecache/moved.cl"

// List all samples of the last frame's cache; listed[0] is how many. One work-item per run of pixels, along the rows: in this order
// the layers of the cache are then read from front to back.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void list_samples(
    __global const uint *mask_before,  // (pixels, words)
    __global uint *samples,            // (capacity)
    __global volatile uint *listed,    // (4)
    uint pixels)
{
    uint begin = get_global_id(0) * RUN, end = min(begin + RUN, pixels), count = 0;
    for (uint place = begin; place < end; place++) count += popcount(occupied_slots(load_mask(mask_before, place)));
    uint at = take(listed, count);
    for (uint place = begin; place < end; place++) {
        Mask m = load_mask(mask_before, place);
        for (uint left = occupied_slots(m); left != 0; left &= left - 1) {
            uint slot = lowest_bit(left);
            samples[at++] = (slot * pixels + place) | ((visible_slots(m) >> slot & 1) != 0 ? IS_VISIBLE : 0);
        }
    }
}

// Expected difference of distances within a pixel (Eq. 1): t |1 - cos theta / cos(theta - phi)|, in a form that does not cancel.
// cosine: of theta, the angle of incidence, 0 .. 1. The diagonal of a pixel subtends phi: its sine, cosine, 1 - cosine.
inline float slope_of(float distance, float cosine, float phi_sine, float phi_cosine, float phi_versine)
{
    float sine = sqrt(fmax(1.0f - cosine * cosine, 0.0f));
    float turned = cosine * phi_cosine + sine * phi_sine;
    return turned > 0.0f ? distance * (fabs(sine * phi_sine - cosine * phi_versine) / turned) : 0.0f;
}

// Of each sample listed: the pixel that it appears in, NONE if that is outside the view, before the near plane or nowhere; its
// distance from the eye, +infinity for the background; its slope, 0 for the background; the place within the pixel.
__kernel void project_samples(
    __global const float *positions,        // (vertices, 3)
    __global const uint *triangles,         // (triangles, 3)
    __global const Instance *instances,     // (instances)
    __global const uint *samples,           // (capacity)
    __global const uint *first_hit_before,  // (slots, pixels, 4)
    __global uint *target,                  // (capacity)
    __global float *distance,               // (capacity)
    __global float *slope,                  // (capacity)
    __global uchar *cell,                   // (capacity) or null
    Camera camera,
    uint length,
    float phi_sine,
    float phi_cosine,
    float phi_versine)
{
    uint i = get_global_id(0);
    if (i >= length) return;
    FirstHit hit = load_first_hit(first_hit_before, samples[i] & ~IS_VISIBLE);
    bool is_far = is_background(hit);
    FirstHit near = { hit.x, hit.y, is_far ? 0 : hit.z, is_far ? 0 : hit.w };
    Geometry geometry = { positions, triangles, instances };
    Located located = locate(&geometry, near);
    Vec3 towards = either3(is_far, unpack_direction(hit), sub3(located.point, eye_of(&camera)));
    float t = sqrt(dot3(towards, towards));
    float x, y;
    bool is_in_front = project(&camera, towards, is_far ? 0.0f : camera.near, &x, &y);
    bool is_in_view = is_in_front && t > 0.0f && t < INFINITY && x >= 0.0f && x < (float)(int)camera.width && y >= 0.0f
                      && y < (float)(int)camera.height;  // all false for what is not a number
    x = is_in_view ? x : 0.0f;
    y = is_in_view ? y : 0.0f;
    int column = min((int)x, (int)camera.width - 1), row = min((int)y, (int)camera.height - 1);
    float cosine = fmin(fabs(dot3(located.normal, towards)) / t, 1.0f);
    float found = slope_of(t, cosine, phi_sine, phi_cosine, phi_versine);
    target[i] = is_in_view ? (uint)(row * (int)camera.width + column) : NONE;
    distance[i] = is_far ? INFINITY : t;
    slope[i] = is_far || !is_in_view ? 0.0f : found;
#if ISRT
    int across = min((int)((x - (float)column) * (float)SUPER), SUPER - 1);
    int down = min((int)((y - (float)row) * (float)SUPER), SUPER - 1);
    cell[i] = (uchar)(down * SUPER + across);
#endif
}
