// Stereo filtering (Philippi et al. 2023, sections 4.1 and 5.2): Y, the colour of a pixel of this eye, is blended with X, what
// the other eye shows of the same point: (1 - beta) X + beta Y. Either beta is the same everywhere, or Eq. 4 gives it, by the
// variance of the pixels about Y and by how far X is from them.
//
// The eyes look in parallel and lie side by side, along the rows of the images: a point is in the same row of both, at the same
// depth, and as much farther to one side as it is near. Depths are along the cameras' axes, as reciprocals, here `near`.
//
// The point is the pixel's centre at the depth of its closest first hit: of that hit the depth is what is stable, whereas its
// place within the pixel would shift X against Y. X is interpolated between the two pixels of the other eye about the
// point, of those only that show the point's surface; where neither does, Y is kept.
//
// What is not a finite number stays where it is: such a Y is kept, such a pixel of the other eye shows nothing, and one beside Y
// is left out of the variance.
//
// Defines: VARIANCE (Eq. 4 gives beta), PER_CHANNEL (to each channel its own, else one by luminance).

#include "common/camera.cl"
#include "filter/other_eye.cl"
#include "scene/first_hit.cl"

#define UNKNOWN (-1.0f)     // in place of a reciprocal depth
#define LEAST_WEIGHT 1e-3f  // of the weights' sum, 1 if no pixel is left out

#if PER_CHANNEL
#define PLANES 3
#else
#define PLANES 1
#endif

// The reciprocal depth of each pixel's first hit; 0 of the background. eye: whose these are. One work-item per pixel, whose
// numbers are the lanes of vectors. The instance's place is taken relative to the eye first: far from the origin nothing is lost.
__kernel void find_near(
    __global const float *positions,     // (vertices, 3)
    __global const uint *triangles,      // (triangles, 3)
    __global const Instance *instances,  // (instances)
    __global const uint *surface,        // (pixels, 4)
    __global float *near,                // (2, pixels)
    Camera camera,
    uint eye,
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= pixels) return;
    uint4 words = vload4(i, surface);
    FirstHit hit = { words.x, words.y, words.z, words.w };
    float found = 0.0f;
    if (!is_background(hit)) {
        __global const Instance *instance = instances + hit.w;
        uint3 corner = vload3(instance->first_triangle + hit.z, triangles);
        float3 v0 = vload3(corner.x, positions);
        float3 edge1 = vload3(corner.y, positions) - v0, edge2 = vload3(corner.z, positions) - v0;
        float4 point = (float4)(v0 + (unpack_u(hit) * edge1 + unpack_v(hit) * edge2), 1.0f);
        Vec3 forward = forward_of(&camera), eye_place = eye_of(&camera);
        float4 x = vload4(0, instance->to_world), y = vload4(1, instance->to_world), z = vload4(2, instance->to_world);
        x.w -= eye_place.x;
        y.w -= eye_place.y;
        z.w -= eye_place.z;
        float4 terms = (forward.x * x + forward.y * y + forward.z * z) * point;
        float depth = terms.x + terms.y + (terms.z + terms.w);
        found = depth > 0.0f && depth < INFINITY ? 1.0f / depth : UNKNOWN;
    }
    near[eye * pixels + i] = found;
}

inline bool is_finite3(Vec3 v)
{
    return fabs(v.x) + fabs(v.y) + fabs(v.z) < INFINITY;
}

inline float luminance(Vec3 color)
{
    return 0.2126f * color.x + 0.7152f * color.y + 0.0722f * color.z;
}

// What variances are judged by, in planes with a margin of a row and a pixel before and behind, so that the neighbours of all
// pixels are in them, next to each other; NaN in the margin, and for what is not finite. One work-item per place.
__kernel void lay_out(
    __global const float *color,  // (pixels, 3)
    __global float *judged,       // (PLANES, places)
    uint width,
    uint pixels,
    uint places)
{
    uint i = get_global_id(0);
    if (i >= places) return;
    int pixel = (int)i - (int)width - 1;
    bool is_inside = pixel >= 0 && pixel < (int)pixels;
    Vec3 value = row3(color, is_inside ? (uint)pixel : 0);
    bool is_known = is_inside && is_finite3(value);
#if PER_CHANNEL
    store_planes(judged, places, i, either3(is_known, value, all3(NAN)));
#else
    judged[i] = is_known ? luminance(value) : NAN;
#endif
}

// Sums over pixels of their deviations from Y, and of their squares: about zero, squares would lose them to rounding.
typedef struct Sums {
    float count, first, second;
} Sums;

INLINED void add_neighbour(Sums *sum, bool is_there, float value, float y)
{
    bool counts = is_there && value == value;
    float deviation = counts ? value - y : 0.0f;
    sum->count += counts ? 1.0f : 0.0f;
    sum->first += deviation;
    sum->second += deviation * deviation;
}

// X's weight, 1 - beta of Eq. 4, by what is judged at the place of Y: its 3x3 pixels, and the difference of X and Y. The variance
// is Eq. 10's, each of whose sums is to be divided by the number of pixels. Eq. 11's mean squared difference between X and
// the pixels is their variance and the squared difference between X and their mean. Without a gradient the sum is on average what
// Eq. 4 asks for: nine pixels' variance about their own mean lacks a ninth, which that mean's error has. 0 / 0 is 0.
INLINED float part_of_other(__global const float *judged, int place, int width, bool has_left, bool has_right, float difference)
{
    float y = judged[place];
    Sums sum = { 1.0f, 0.0f, 0.0f };
    add_neighbour(&sum, has_left, judged[place - width - 1], y);
    add_neighbour(&sum, true, judged[place - width], y);
    add_neighbour(&sum, has_right, judged[place - width + 1], y);
    add_neighbour(&sum, has_left, judged[place - 1], y);
    add_neighbour(&sum, has_right, judged[place + 1], y);
    add_neighbour(&sum, has_left, judged[place + width - 1], y);
    add_neighbour(&sum, true, judged[place + width], y);
    add_neighbour(&sum, has_right, judged[place + width + 1], y);
    float share = 1.0f / sum.count, mean = share * sum.first, variance = fmax(share * sum.second - mean * mean, 0.0f);
    float away = difference - mean, bias = away * away;
    float part = variance / (bias + variance);
    return part > 0.0f ? part : 0.0f;
}

// What is interpolated: weights, and deviations from Y.
typedef struct Interpolated {
    float weight;
    Vec3 deviation;
} Interpolated;

INLINED void add_tap(Interpolated *sum, float weight, bool shows_surface, Vec3 value, Vec3 y)
{
    bool counts = shows_surface && is_finite3(value);
    float part = counts ? weight : 0.0f;
    sum->weight += part;
    sum->deviation.x += counts ? part * (value.x - y.x) : 0.0f;
    sum->deviation.y += counts ? part * (value.y - y.y) : 0.0f;
    sum->deviation.z += counts ? part * (value.z - y.z) : 0.0f;
}

// disparity: pixels by which what is at depth 1 lies farther right in the other eye's image than in this one. eye: which of
// the rows of `near` is this one's. One work-item per pixel.
__kernel void stereo(
    __global const float *color,        // (pixels, 3)
    __global const float *other_color,  // (pixels, 3)
    __global const float *near,         // (2, pixels)
    __global const float *judged,       // (*) or null
    __global float *blended,            // (pixels, 3)
    __global float *aov_beta,           // (pixels)
    float disparity,
    float beta,
    uint eye,
    uint width,
    uint height,
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= pixels) return;
    int row, column, last_column = (int)width - 1, last_row = (int)height - 1;
    place_of_pixel(i, width, &row, &column);
    Vec3 y = row3(color, i);
    float expected = near[eye * pixels + i], there = (float)column + 0.5f + disparity * expected;
    bool is_seen = expected >= 0.0f && there >= 0.0f && there < (float)(int)width && is_finite3(y);
    there = is_seen ? there : 0.5f;

    // The pixel that the point is in, how the reciprocal depth changes about it, and its neighbour on the point's side.
    int inside = min((int)there, last_column), here = (int)((1 - eye) * pixels) + row * (int)width + inside;
    bool is_first = inside == 0, is_last = inside == last_column, is_top = row == 0, is_bottom = row == last_row;
    float centre = near[here], before = near[here - (is_first ? 0 : 1)], after = near[here + (is_last ? 0 : 1)];
    float above = near[here - (is_top ? 0 : (int)width)], below = near[here + (is_bottom ? 0 : (int)width)];
    float slope = least_step(before, centre, after) + least_step(above, centre, below);
    float allowed = allowed_step(expected, slope);
    float aside = there - ((float)inside + 0.5f), part_aside = fabs(aside);
    bool is_right = aside > 0.0f, has_aside = is_right ? !is_last : !is_first;
    float near_aside = is_right ? after : before;
    int tap = row * (int)width + inside, tap_aside = tap + (has_aside ? (is_right ? 1 : -1) : 0);

    Interpolated x = { 0.0f, { 0.0f, 0.0f, 0.0f } };
    bool shows_here = centre >= 0.0f && shows(centre, expected, allowed);
    bool shows_aside = has_aside && near_aside >= 0.0f && shows(near_aside, expected, allowed);
    add_tap(&x, 1.0f - part_aside, shows_here, row3(other_color, (uint)tap), y);
    add_tap(&x, part_aside, shows_aside, row3(other_color, (uint)tap_aside), y);
    is_seen = is_seen && x.weight >= LEAST_WEIGHT;
    Vec3 difference = scale3(is_seen ? 1.0f / x.weight : 0.0f, x.deviation);

#if VARIANCE
    int place = (int)i + (int)width + 1;
    bool has_left = column > 0, has_right = column < last_column;
#if PER_CHANNEL
    int places = (int)pixels + 2 * ((int)width + 1);
    Vec3 part = vec3(part_of_other(judged, place, (int)width, has_left, has_right, difference.x),
                     part_of_other(judged, places + place, (int)width, has_left, has_right, difference.y),
                     part_of_other(judged, 2 * places + place, (int)width, has_left, has_right, difference.z));
#else
    Vec3 part = all3(part_of_other(judged, place, (int)width, has_left, has_right, luminance(difference)));
#endif
#else
    Vec3 part = all3(1.0f - beta);
#endif
    part = either3(is_seen, part, all3(0.0f));
    store_row(blended, i, either3(is_seen, add3(y, mul3(part, difference)), y));
    aov_beta[i] = 1.0f - (part.x + part.y + part.z) / 3.0f;
}
