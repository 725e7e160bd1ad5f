// Stereo blending (SampleCache, section 3.6 and section 5.2's sharpness R): Y, the colour of a pixel of this eye, goes towards
// X, what the other eye shows of the same point, as far as lowers the expected squared error: (1 - beta) X + beta Y by Eq. 3
// and 8, channel by channel. Reads both eyes' colours and moments, writes this eye's blended colour; one work-item per pixel.
//
// The point is the pixel's centre at the depth of the closest visible sample: of that sample the depth is what is
// stable, whereas its place within the pixel would shift X against Y. X and its moments are resampled by Dodgson's quadratic
// kernel, R being its parameter ("Quadratic interpolation for image resampling", IEEE Trans. Image Processing 6(9), 1997),
// over those pixels only that show the point's surface; Y's moments are blurred with weights 1 - R about the centre's 1.
//
// A row of `moments`, the pixel's visible samples weighted by their counts:
//   0-2 mean radiance (mu1 of Eq. 5)         3 sum of the counts (Eq. 6); 0: nothing is known of the pixel
//   4-6 mean squared deviation (Eq. 7)       7 reciprocal depth along the camera's axis of the closest one; 0: background
// Raw second moments, mu2 = 4-6 plus 0-2 squared, would lose the deviation to rounding where means are large. They are mixed
// all the same: about a common origin, here the pixel's own mean, they add up to what Eq. 8 asks for.
//
// Each row is one vector. Define: BLUR, 0 if R is 1, where Y's neighbours have no weight.

#include "common/camera.cl"
#include "filter/other_eye.cl"

// Of the weights' sum, 1 if no pixel is left out. Weights can be negative: what remains of a smaller sum is mostly rounding.
#define LEAST_WEIGHT 0.1f

// Sums over pixels; of radiance, as deviations from an origin.
typedef struct Moments {
    float weight;
    float4 first, second;
} Moments;

typedef struct Resampled {
    Moments moments;
    float3 color, lowest, highest;  // as deviations from Y
} Resampled;

// The point's surface, as the other eye sees it, by reciprocal depths.
typedef struct Surface {
    float expected, allowed;
} Surface;

// Dodgson's kernel for the pixel before, the one that holds the place, and the one after it; offset: of the place from the
// centre, -0.5 .. 0.5. They add up to 1. R = 1 interpolates, 1/2 is the quadratic B-spline.
inline float3 dodgson(float offset, float r)
{
    float before = 1.0f + offset, after = 1.0f - offset, step = 2.0f * r + 0.5f, level = 0.75f * (r + 1.0f);
    return (float3)(r * before * before - step * before + level, 0.5f * (r + 1.0f) - 2.0f * r * offset * offset,
                    r * after * after - step * after + level);
}

inline void add_moments(Moments *sum, float weight, float8 moments, float4 origin)
{
    float4 deviation = moments.lo - origin;
    sum->weight += weight;
    sum->first += weight * deviation;
    sum->second += weight * (moments.hi + deviation * deviation);
}

// A neighbour of the pixel itself.
INLINED void blur(Moments *sum, float weight, __global const float *moments, uint pixel, float4 origin)
{
    float8 row = vload8(pixel, moments);
    if (weight != 0.0f && row.s3 > 0.0f) add_moments(sum, weight, row, origin);
}

// A pixel of the other eye, if it shows the surface.
INLINED void resample(Resampled *sum, float weight, float8 row, Surface surface, __global const float *color, uint pixel,
                      float4 origin, float3 y)
{
    if (weight == 0.0f || !(row.s3 > 0.0f) || !shows(row.s7, surface.expected, surface.allowed)) return;
    float3 deviation = vload3(pixel, color) - y;
    add_moments(&sum->moments, weight, row, origin);
    sum->color += weight * deviation;
    sum->lowest = fmin(sum->lowest, deviation);
    sum->highest = fmax(sum->highest, deviation);
}

// Variance, by Eq. 7: what of the second moments the first do not account for.
inline float4 variance_of(Moments sum)
{
    float4 mean = sum.first / sum.weight;
    return fmax(sum.second / sum.weight - mean * mean, 0.0f);
}

__kernel void blend(
    __global const float *color,          // (pixels, 3)
    __global const float *moments,        // (pixels, 8)
    __global const float *other_color,    // (pixels, 3)
    __global const float *other_moments,  // (pixels, 8)
    __global float *blended,              // (pixels, 3)
    Camera camera,
    Camera other,
    float sharpness,
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= pixels) return;
    float8 here = vload8(i, moments);
    float3 y = vload3(i, color);
    vstore3(y, i, blended);
    int width = (int)camera.width, height = (int)camera.height, row, column;
    place_of_pixel(i, camera.width, &row, &column);

    // The point relative to the other eye, times its reciprocal depth: the background, at 0, is a direction.
    Vec3 through = through_pixel(&camera, (float)column + 0.5f, (float)row + 0.5f);
    Vec3 towards = add3(through, scale3(here.s7, sub3(eye_of(&camera), eye_of(&other))));
    float x_there, y_there;
    bool is_seen = project(&other, towards, here.s7 * other.near, &x_there, &y_there) && here.s3 > 0.0f;
    if (!(is_seen && x_there >= 0.0f && x_there < (float)width && y_there >= 0.0f && y_there < (float)height)) return;

    int c = (int)x_there, r = (int)y_there;
    bool is_left = c == 0, is_right = c == width - 1, is_top = r == 0, is_bottom = r == height - 1;
    float3 across = dodgson(x_there - (float)c - 0.5f, sharpness), down = dodgson(y_there - (float)r - 0.5f, sharpness);
    across.s0 = is_left ? 0.0f : across.s0;
    across.s2 = is_right ? 0.0f : across.s2;
    down.s0 = is_top ? 0.0f : down.s0;
    down.s2 = is_bottom ? 0.0f : down.s2;
    uint p4 = (uint)(r * width + c), left = is_left ? 0 : 1, right = is_right ? 0 : 1;
    uint p1 = is_top ? p4 : p4 - (uint)width, p7 = is_bottom ? p4 : p4 + (uint)width;
    float8 m0 = vload8(p1 - left, other_moments), m1 = vload8(p1, other_moments), m2 = vload8(p1 + right, other_moments);
    float8 m3 = vload8(p4 - left, other_moments), m4 = vload8(p4, other_moments), m5 = vload8(p4 + right, other_moments);
    float8 m6 = vload8(p7 - left, other_moments), m7 = vload8(p7, other_moments), m8 = vload8(p7 + right, other_moments);
    float slope = least_step(m3.s7, m4.s7, m5.s7) + least_step(m1.s7, m4.s7, m7.s7);
    float expected = here.s7 / dot3(forward_of(&other), towards);
    Surface surface = { expected, allowed_step(expected, slope) };

    float4 origin = here.lo;
    Resampled x = { { 0.0f, (float4)(0.0f), (float4)(0.0f) }, (float3)(0.0f), (float3)(INFINITY), (float3)(-INFINITY) };
    resample(&x, down.s0 * across.s0, m0, surface, other_color, p1 - left, origin, y);
    resample(&x, down.s0 * across.s1, m1, surface, other_color, p1, origin, y);
    resample(&x, down.s0 * across.s2, m2, surface, other_color, p1 + right, origin, y);
    resample(&x, down.s1 * across.s0, m3, surface, other_color, p4 - left, origin, y);
    resample(&x, down.s1 * across.s1, m4, surface, other_color, p4, origin, y);
    resample(&x, down.s1 * across.s2, m5, surface, other_color, p4 + right, origin, y);
    resample(&x, down.s2 * across.s0, m6, surface, other_color, p7 - left, origin, y);
    resample(&x, down.s2 * across.s1, m7, surface, other_color, p7, origin, y);
    resample(&x, down.s2 * across.s2, m8, surface, other_color, p7 + right, origin, y);
    if (!(x.moments.weight >= LEAST_WEIGHT)) return;

    Moments own = { 1.0f, (float4)(0.0f), here.hi };
#if BLUR
    float aside = 1.0f - sharpness;
    float at_left = column > 0 ? aside : 0.0f, at_right = column < width - 1 ? aside : 0.0f;
    bool has_above = row > 0, has_below = row < height - 1;
    uint before = column > 0 ? 1 : 0, after = column < width - 1 ? 1 : 0;
    uint above = has_above ? i - (uint)width : i, below = has_below ? i + (uint)width : i;
    blur(&own, has_above ? at_left : 0.0f, moments, above - before, origin);
    blur(&own, has_above ? aside : 0.0f, moments, above, origin);
    blur(&own, has_above ? at_right : 0.0f, moments, above + after, origin);
    blur(&own, at_left, moments, i - before, origin);
    blur(&own, at_right, moments, i + after, origin);
    blur(&own, has_below ? at_left : 0.0f, moments, below - before, origin);
    blur(&own, has_below ? aside : 0.0f, moments, below, origin);
    blur(&own, has_below ? at_right : 0.0f, moments, below + after, origin);
#endif

    float4 bias = x.moments.first / x.moments.weight - own.first / own.weight;
    float4 variance = variance_of(own);
    float4 part = variance / (bias * bias + variance_of(x.moments) + variance);  // 1 - beta of Eq. 8
    part = part > 0.0f ? part : (float4)(0.0f);                                  // 0 / 0: no noise, no difference
    // What negative weights may have pushed beyond all of the values is put back among them.
    float3 difference = clamp(x.color / x.moments.weight, x.lowest, x.highest);
    vstore3(y + part.xyz * difference, i, blended);
}
