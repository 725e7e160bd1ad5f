// The pinhole camera: from pixels to rays and back. Pixel coordinates are continuous; pixel (0, 0) is top left and its centre is
// at (0.5, 0.5).

#include "common/transform.cl"

inline Vec3 eye_of(const Camera *camera)
{
    return vec3(camera->to_world[3], camera->to_world[7], camera->to_world[11]);
}

inline Vec3 forward_of(const Camera *camera)
{
    return vec3(-camera->to_world[2], -camera->to_world[6], -camera->to_world[10]);
}

// A vector of the world in the camera's axes.
inline Vec3 to_view(const Camera *camera, Vec3 v)
{
    const float *m = camera->to_world;
    return vec3(m[0] * v.x + m[4] * v.y + m[8] * v.z, m[1] * v.x + m[5] * v.y + m[9] * v.z,
                m[2] * v.x + m[6] * v.y + m[10] * v.z);
}

// Where in the image, in pixels, a point appears that lies at `towards` from the eye; false if it is not in front of the plane
// at distance `near` (0 for what is infinitely far away, of which `towards` is the direction). Not checked: whether it is
// within the image.
inline bool project(const Camera *camera, Vec3 towards, float near, float *x, float *y)
{
    Vec3 view = to_view(camera, towards);
    float depth = -view.z;
    *x = (0.5f + 0.5f * view.x / (depth * camera->slope[0])) * (float)(int)camera->width;
    *y = (0.5f - 0.5f * view.y / (depth * camera->slope[1])) * (float)(int)camera->height;
    return depth > near;
}

// Towards a place of the image, as far as the plane at distance 1 before the eye.
inline Vec3 through_pixel(const Camera *camera, float x, float y)
{
    float across = 2.0f * (x / (float)(int)camera->width) - 1.0f, down = 2.0f * (y / (float)(int)camera->height) - 1.0f;
    return transform_vector(camera->to_world, vec3(across * camera->slope[0], -down * camera->slope[1], -1.0f));
}

// The angle of a pixel's height, by which the cones about rays widen.
inline float pixel_spread(const Camera *camera)
{
    return 2.0f * camera->slope[1] / (float)(int)camera->height;
}

// Row and column of a pixel; in floats, since integers are not divided in vectors. What rounding may have done is put right.
inline void place_of_pixel(uint pixel, uint width, int *row, int *column)
{
    int r = (int)((float)(int)pixel / (float)(int)width), c = (int)pixel - r * (int)width;
    r = c < 0 ? r - 1 : r;
    r = c >= (int)width ? r + 1 : r;
    *row = r;
    *column = (int)pixel - r * (int)width;
}
