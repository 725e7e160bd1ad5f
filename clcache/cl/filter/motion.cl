// Where the points that the pixels show were seen in the frame before (Philippi et al. 2023, Fig. 3: reprojection): from the first
// hit of a pixel's closest sample, the scene's instances now and before, and the camera now and before.
//
// `views` says, of each instance, how a point of it goes to the image: the columns, for x, y, z and 1, of the matrix that gives
// (X, Y, depth, 0) now and then the same of the frame before, so that (X, Y) / depth is the place in pixels. Behind the instances
// comes the background, whose points are directions, and which translations do not move. What stands still before a camera
// that does gets the same bits twice, and so a motion of exactly 0.

#include "filter/runs.cl"
#include "scene/first_hit.cl"

#define VIEW 32u  // numbers of an instance in `views`
#define DEPTH_TOLERANCE 0.02f  // of the depth: what may be the same surface
#define NEARER 0.1f            // what surely is another

#if DISOCCLUSION
// The least and the greatest depth about a place, in pixels, of the frame before. A place outside the image counts as the nearest inside.
INLINED float2 depths_about(__global const float *depths_before, float2 place, int width, int height)
{
    int column = (int)fmin(fmax(place.x, 0.0f), (float)(width - 1)), row = (int)fmin(fmax(place.y, 0.0f), (float)(height - 1));
    return vload2(padded_place(row, column, pitch_of((uint)width)), depths_before);
}
#endif

// A vector's image: X, Y and depth.
inline Vec3 seen(const Camera *camera, Vec3 v)
{
    Vec3 view = to_view(camera, v);
    float width = (float)(int)camera->width, height = (float)(int)camera->height;
    float x = 0.5f * width * (view.x / camera->slope[0] - view.z), y = 0.5f * height * (-view.y / camera->slope[1] - view.z);
    return vec3(x, y, -view.z);
}

inline void store_column(__global float *columns, uint column, Vec3 v)
{
    columns[8 * column] = v.x;
    columns[8 * column + 1] = v.y;
    columns[8 * column + 2] = v.z;
    columns[8 * column + 3] = 0.0f;
}

// The translation is taken relative to the eye before it is turned: far from the origin nothing is lost.
INLINED void store_view(__global float *columns, const Camera *camera, Instance instance, bool is_background)
{
    const float *m = instance.to_world;
    Vec3 offset = sub3(vec3(m[3], m[7], m[11]), eye_of(camera));
    store_column(columns, 0, seen(camera, either3(is_background, vec3(1.0f, 0.0f, 0.0f), vec3(m[0], m[4], m[8]))));
    store_column(columns, 1, seen(camera, either3(is_background, vec3(0.0f, 1.0f, 0.0f), vec3(m[1], m[5], m[9]))));
    store_column(columns, 2, seen(camera, either3(is_background, vec3(0.0f, 0.0f, 1.0f), vec3(m[2], m[6], m[10]))));
    store_column(columns, 3, either3(is_background, all3(0.0f), seen(camera, offset)));
}

// One work-item per instance, and one for the background.
__kernel void view_instances(
    __global const Instance *instances,         // (instances)
    __global const Instance *instances_before,  // (instances)
    __global float *views,                      // (places, 32)
    Camera camera,
    Camera camera_before,
    uint places)
{
    uint i = get_global_id(0);
    if (i >= places) return;
    bool is_background = i == places - 1;
    uint instance = is_background ? 0 : i;
    store_view(views + VIEW * i, &camera, instances[instance], is_background);
    store_view(views + VIEW * i + 4, &camera_before, instances_before[instance], is_background);
}

// One work-item per pixel: from the place now to the place before, in pixels; infinite where the point was not seen.
// Beside it the depth along the camera's axis, infinite for the background; negative if something nearer was beside the point before.
// depths_before: the least and the greatest depth of the 3x3 pixels about each. A pixel's numbers are the lanes of vectors.
__kernel void find_motion(
    __global const float *positions,        // (vertices, 3)
    __global const uint *triangles,         // (triangles, 3)
    __global const Instance *instances,     // (instances)
    __global const uint *surface,           // (pixels, 4)
    __global const float *views,            // (places, 32)
    __global float *motion,                 // (moved, 2)
    __global float *depth,                  // (moved)
    __global const float *depths_before,    // (padded, 2) or null
    float near,
    float near_before,
    uint width,
    uint height,
    uint places)
{
    uint i = get_global_id(0);
    if (i >= width * height) return;
    uint4 words = vload4(i, surface);
    FirstHit hit = { words.x, words.y, words.z, words.w };
    bool is_far = is_background(hit);
    float3 point;
    if (is_far) {
        Vec3 direction = unpack_direction(hit);
        point = (float3)(direction.x, direction.y, direction.z);
    } else {
        uint3 corner = vload3(instances[hit.w].first_triangle + hit.z, triangles);
        float3 v0 = vload3(corner.x, positions);
        point = v0 + (unpack_u(hit) * (vload3(corner.y, positions) - v0) + unpack_v(hit) * (vload3(corner.z, positions) - v0));
    }
    __global const float *view = views + VIEW * (is_far ? places - 1 : hit.w);
    float8 image = (point.x * vload8(0, view) + point.y * vload8(1, view)) + (point.z * vload8(2, view) + vload8(3, view));
    float4 place = image.s0145 / image.s2266;
    bool was_seen = image.s2 > (is_far ? 0.0f : near) && image.s6 > (is_far ? 0.0f : near_before);
    bool was_beside = false;
#if DISOCCLUSION
    float depth_then = is_far ? INFINITY : image.s6;
    float2 about = depths_about(depths_before, place.hi, (int)width, (int)height);
    was_seen = was_seen && depth_then <= about.y * (1.0f + DEPTH_TOLERANCE);
    was_beside = about.x < depth_then * (1.0f - NEARER);
#endif
    vstore2(was_seen ? place.hi - place.lo : (float2)(INFINITY), i, motion);
    float depth_now = is_far ? INFINITY : image.s2;
    depth[i] = was_beside ? -depth_now : depth_now;
}
