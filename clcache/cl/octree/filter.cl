// The layered filter of the octree's images (Roth et al. 2020, section 3.4), from the last layer to the first.
//
// A layer is what paths meet at their i-th vertex, one of each pixel: E, the light that a cell knows; C, the albedo; S, light
// that needs no cell; T, the throughput to the next layer's vertex; and guides. From out[i+1] of the layer behind it comes
//
//   R = S + T out[i+1]
//   out[i] = C filter(E) + filter(R), and what shines by itself
//
// so that noise is averaged where it arises, among vertices that are alike, and reflections and refractions of it stay sharp.
// Both filters are cross-bilateral, over a sparse pattern of taps, the same for all pixels. A tap's weight is the product of
// Eq. 2-6, each clamped to [0, 1]:
//
//   normal   w_n = s_n max(0, n_p . n_q)                                              (2)
//   depth    w_d = 1 - s_d D, D the difference of the paths' lengths so far           (3)
//   segment  w_d' = 1 - s_d' D', D' that of the lengths to the next vertex; R only    (4)
//   albedo   w_c = 1 - s_c c / (c + 1), c = log(1 + k |C_p - C_q|) / k in L*a*b*      (5)
//   light    w_l = max(0, 1 - log(1 + s_l l / (l + 1))), l = k |l_p - l_q|; E only    (6)
//
// Distances are relative to the tap's, and so have no unit. What a plane's slope explains is taken off them (`slope_of`), or
// floors seen at a grazing angle would not be filtered; off a segment's also what a rough lobe's width explains. k of Eq. 5 is
// so large that texture hardly counts: E has none of it, and a coat reflects the same whatever is below it. (Images of a
// kitchen had 7 % to 20 % less error with 30 than with 1.)
//
// k of Eq. 6 is such that l counts standard deviations of noise, as that is relative to the light, and for a cell's mean falls
// with the square root of its count. So a difference that noise explains is averaged out while cells have few samples, and is
// kept once they have many: the filter fades as the cache converges. A tap's E weighs, besides, by its count, as the best mean
// of unlike means does; what has none takes the mean of what is about it and gives nothing.
//
// R is of one path, which roulette may have ended, however many there were before: of few pixels it has much and of most
// nothing. So its light does not say what is alike, and Eq. 6 is left out; and a path that ended has no segment to compare.
// Taps are like in roughness, and either all have a diffuse part, whose coat reflects, or none has. R is averaged no farther
// than the surface by itself blurs what it shows (`reach_of`), of coats, which have the most noise and whose reflections are
// faint, COAT times as far: a mirror, or the foot of what stands on a polished floor, stays sharp.
//
// A work-item does a run of 16 pixels of a row, which are the lanes of vectors, and leaves where a layer has no vertex. Guides
// are planes, padded so that no tap is outside them: by RUN pixels at the left, by as many and what the last run lacks at the
// right, by REACH rows above and below. A pixel without a vertex, the background's and those of the padding too, has DEPTH 0
// and is no one's tap; all other numbers are finite, whoever's they are.
//
// Defines: PLAIN: the composed image is filtered as a whole, by the first layer's guides.

#include "filter/runs.cl"

#define REACH 8           // rows and columns that taps are away at most; as in passes/octree_filter.py
#define KAPPA_COLOR 30.0f  // of Eq. 5, for L*a*b* as it is
#define KAPPA_LIGHT 0.5f  // of Eq. 6, for each standard deviation
#define SLACK 2.0f        // slopes that a difference of distances may be without counting
#define LOBE 2.0f         // of a lobe's half-width, in radians, what segments may differ by without counting
#define BLUR 1.0f         // of the radius to which a surface blurs, the part that R is averaged over
#define COAT 8.0f         // how many times that where R is what a diffuse surface's coat reflects
#define UNLIKE 8.0f       // of a difference in roughness, what a tap's weight loses
#define MOST_COUNTED 65535.0f

// Planes of guides; 17, as in passes/octree_filter.py.
#define DEPTH 0      // its reciprocal; 0: no vertex, or the background
#define SEGMENT 1    // its reciprocal; 0: the path goes to the sky; negative: it ends
#define ROUGHNESS 2  // negative of what has no diffuse part; 0: R is not averaged, and is no one's tap
#define COUNT 3      // 0: E is not known
#define VARIANCE 4   // 1 / count; UNKNOWN where that is 0
#define NORMAL 5
#define LAB 8
#define LIGHT 11     // E
#define REST 14      // R

#define UNKNOWN 1e30f
#define ENDLESS 1e20f  // for the length of a segment to the sky

// Half of the taps, column and row; the others are opposite. Two beside the pixel, then evenly over a disk, by the golden angle.
#define HALF_TAPS 12
__constant int TAPS[2 * HALF_TAPS] = { 1, 0, 0, 1, 3, 1, -2, 3, -2, -4, 5, -1, -1, 6, -5, -4, 6, -4, 2, 7, -8, -1, 4, -7 };

typedef struct Run3 {
    float16 x, y, z;
} Run3;

// Where a run is: of the image, and of the guides' planes. missing: pixels of it beyond the image's edge.
typedef struct Place {
    int row, run, first, missing, guide;
} Place;

inline Place place_of_run(uint i, uint width)
{
    Place place;
    place_of_pixel(i, (uint)runs_along(width), &place.row, &place.run);
    place.first = place.row * (int)width + RUN * place.run;
    place.missing = max(RUN * place.run + RUN - (int)width, 0);
    place.guide = (place.row + REACH) * pitch_of(width) + RUN * (place.run + 1);
    return place;
}

INLINED float16 load_run(__global const float *plane, Place place)
{
    if (place.missing == 0) return vload16(0, plane + place.first);
    float16 values = 0.0f;
    for (int k = 0; k < RUN - place.missing; k++) ((float *)&values)[k] = plane[place.first + k];
    return values;
}

INLINED void store_run(__global float *plane, Place place, float16 values)
{
    if (place.missing == 0) vstore16(values, 0, plane + place.first);
    else
        for (int k = 0; k < RUN - place.missing; k++) plane[place.first + k] = ((float *)&values)[k];
}

INLINED Run3 load_run3(__global const float *planes, uint n, Place place)
{
    Run3 v = { load_run(planes, place), load_run(planes + n, place), load_run(planes + 2 * n, place) };
    return v;
}

INLINED void store_run3(__global float *planes, uint n, Place place, Run3 v)
{
    store_run(planes, place, v.x);
    store_run(planes + n, place, v.y);
    store_run(planes + 2 * n, place, v.z);
}

INLINED float16 guide1(__global const float *guides, size_t padded, int plane, int at)
{
    return vload16(0, guides + plane * padded + at);
}

INLINED Run3 guide3(__global const float *guides, size_t padded, int plane, int at)
{
    __global const float *first = guides + plane * padded + at;
    Run3 v = { vload16(0, first), vload16(0, first + padded), vload16(0, first + 2 * padded) };
    return v;
}

INLINED void store_guide(__global float *guides, size_t padded, int plane, int at, float16 v)
{
    vstore16(v, 0, guides + plane * padded + at);
}

INLINED void store_guide3(__global float *guides, size_t padded, int plane, int at, Run3 v)
{
    __global float *first = guides + plane * padded + at;
    vstore16(v.x, 0, first);
    vstore16(v.y, 0, first + padded);
    vstore16(v.z, 0, first + 2 * padded);
}

inline Run3 where3(int16 is_there, Run3 v)
{
    Run3 found = { is_there ? v.x : 0.0f, is_there ? v.y : 0.0f, is_there ? v.z : 0.0f };
    return found;
}

inline int16 are_finite(Run3 v)
{
    return fabs(v.x) < INFINITY && fabs(v.y) < INFINITY && fabs(v.z) < INFINITY;
}

// Some drivers' `any` goes lane by lane.
inline bool any_of(int16 lanes)
{
    ulong2 bytes = as_ulong2(convert_char16(lanes));
    return (bytes.x | bytes.y) != 0;
}

inline float16 to_unit(float16 v)
{
    return less(more(v, (float16)(0.0f)), (float16)(1.0f));
}

// Natural logarithm of a number of 1 or more: that of the power of two next to it, and a polynomial of what remains. Absolute
// error below 2e-7.
INLINED float16 log_of(float16 v)
{
    uint16 bits = as_uint16(v) - 0x3F3504F3u;  // of sqrt(1/2)
    int16 exponent = as_int16(bits) >> 23;
    float16 x = as_float16((bits & 0x007FFFFFu) + 0x3F3504F3u) - 1.0f;
    float16 series = 1.0f + x * (-0.5000036f + x * (0.33335114f + x * (-0.24970072f + x * (0.19898565f + x * (-0.17247013f
                   + x * (0.1623419f + x * -0.10134057f))))));
    return 0.693147181f * convert_float16(exponent) + x * series;
}

// Cube root of a normal positive number: a third of the exponent, then twice Halley's method.
INLINED float16 cube_root(float16 v)
{
    float16 root = as_float16(as_uint16(v) / 3u + 709921077u), cubed = root * root * root;
    root *= (cubed + 2.0f * v) / (2.0f * cubed + v);
    cubed = root * root * root;
    return root * ((cubed + 2.0f * v) / (2.0f * cubed + v));
}

// Of CIE 1976 L*a*b*: of a tristimulus value relative to white's.
inline float16 lightness(float16 t)
{
    return t > 0.008856452f ? cube_root(t) : 7.787037f * t + 0.137931034f;
}

// L*, a*, b* of linear Rec. 709, relative to D65.
INLINED Run3 lab_of(Run3 c)
{
    float16 x = lightness((0.4123908f * c.x + 0.3575843f * c.y + 0.1804808f * c.z) / 0.9504559f);
    float16 y = lightness(0.2126390f * c.x + 0.7151687f * c.y + 0.0721923f * c.z);
    float16 z = lightness((0.0193308f * c.x + 0.1191948f * c.y + 0.9505322f * c.z) / 1.0890578f);
    Run3 lab = { 116.0f * y - 16.0f, 500.0f * (x - y), 200.0f * (y - z) };
    return lab;
}

// R of a run. behind: what comes from the layer behind it, which is written only where that one has vertices.
INLINED Run3 rest_of(__global const float *own, __global const float *pass, __global const float *behind,
                     __global const float *behind_depth, uint n, Place place)
{
    Run3 rest = load_run3(own, n, place);
    if (behind_depth == 0) return rest;
    int16 is_there = load_run(behind_depth, place) != 0.0f;
    if (!any_of(is_there)) return rest;
    Run3 far = where3(is_there, load_run3(behind, n, place)), part = load_run3(pass, n, place);
    rest.x += part.x * far.x;
    rest.y += part.y * far.y;
    rest.z += part.z * far.z;
    return rest;
}

INLINED Run3 with_emitted(Run3 v, __global const float *emitted, uint n, Place place)
{
    if (emitted == 0) return v;
    Run3 light = load_run3(emitted, n, place), sum = { v.x + light.x, v.y + light.y, v.z + light.z };
    return sum;
}

// One work-item per run: out[i] without any filter.
ONE_BY_ONE __kernel void compose(
    __global const float *light,         // (3, n)
    __global const float *albedo,        // (3, n)
    __global const float *own,           // (3, n)
    __global const float *pass,          // (3, n)
    __global const float *depth,         // (n)
    __global const float *behind,        // (3, n) or null
    __global const float *behind_depth,  // (n) or null
    __global const float *emitted,       // (3, n) or null
    __global float *out,                 // (3, n)
    uint width,
    uint height,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= (uint)runs_along(width) * height) return;
    Place place = place_of_run(i, width);
    if (!any_of(load_run(depth, place) != 0.0f)) {
        Run3 none = { (float16)(0.0f), (float16)(0.0f), (float16)(0.0f) };
        store_run3(out, n, place, none);
        return;
    }
    Run3 sum = with_emitted(rest_of(own, pass, behind, behind_depth, n, place), emitted, n, place);
    Run3 e = load_run3(light, n, place), c = load_run3(albedo, n, place);
    sum.x += c.x * e.x;
    sum.y += c.y * e.y;
    sum.z += c.z * e.z;
    store_run3(out, n, place, sum);
}

// One work-item per run: the guides of a layer, and what is filtered.
ONE_BY_ONE __kernel void lay_out(
    __global const float *light,         // (3, n)
    __global const float *albedo,        // (3, n)
    __global const float *own,           // (3, n)
    __global const float *pass,          // (3, n)
    __global const float *normal,        // (3, n)
    __global const float *depth,         // (n)
    __global const float *segment,       // (n)
    __global const float *roughness,     // (n)
    __global const float *count,         // (n)
    __global const float *behind,        // (3, n) or null
    __global const float *behind_depth,  // (n) or null
    __global float *guides,              // (planes, padded)
    uint width,
    uint height,
    uint padded,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= (uint)runs_along(width) * height) return;
    Place place = place_of_run(i, width);
    float16 far = load_run(depth, place);
    int16 is_there = far > 0.0f && far < INFINITY;
    vstore16(is_there ? 1.0f / far : 0.0f, 0, guides + place.guide);
    if (!any_of(is_there)) return;
    Run3 e = load_run3(light, n, place), c = load_run3(albedo, n, place);
    Run3 rest = rest_of(own, pass, behind, behind_depth, n, place);
    float16 known = less(load_run(count, place), (float16)(MOST_COUNTED));
#if PLAIN
    e.x = c.x * e.x + rest.x;
    e.y = c.y * e.y + rest.y;
    e.z = c.z * e.z + rest.z;
    float16 rough = 0.0f;
    known = more(known, (float16)(1.0f));
#else
    float16 rough = are_finite(rest) ? load_run(roughness, place) : 0.0f;
    int16 is_diffuse = more(c.x, more(c.y, c.z)) > 0.0f;
    known = is_diffuse ? known : 0.0f;
    rough = is_diffuse ? rough : -rough;
#endif
    known = are_finite(e) ? known : 0.0f;
    known = is_there ? known : 0.0f;
    float16 next = load_run(segment, place);
    store_guide(guides, padded, SEGMENT, place.guide, is_there && next > 0.0f ? 1.0f / next : -1.0f);
    store_guide(guides, padded, ROUGHNESS, place.guide, is_there ? rough : 0.0f);
    store_guide(guides, padded, COUNT, place.guide, known);
    store_guide(guides, padded, VARIANCE, place.guide, known > 0.0f ? 1.0f / known : UNKNOWN);
    store_guide3(guides, padded, NORMAL, place.guide, where3(is_there, load_run3(normal, n, place)));
    store_guide3(guides, padded, LAB, place.guide, where3(is_there, lab_of(c)));
    store_guide3(guides, padded, LIGHT, place.guide, where3(known > 0.0f, e));
    store_guide3(guides, padded, REST, place.guide, where3(are_finite(rest), rest));
}

// How much two distances differ, in relation to the second, from their reciprocals; `length` is the first.
inline float16 difference(float16 length, float16 p, float16 q)
{
    return fabs(q - p) * length;
}

inline float16 length_of(float16 reciprocal)
{
    return reciprocal > 0.0f ? 1.0f / reciprocal : ENDLESS;
}

// Of two neighbours, where both distances are known, else infinite.
INLINED float16 step_between(__global const float *plane, int a, int b)
{
    float16 p = vload16(0, plane + a), q = vload16(0, plane + b), farther = less(p, q);
    return farther > 0.0f ? fabs(p - q) / more(p, q) : INFINITY;
}

inline float16 middle(float16 a, float16 b, float16 c)
{
    return more(less(a, b), less(more(a, b), c));
}

// How much a distance differs from one pixel to the next along a row (`step` 1, `across` the pitch) or a column: on the side
// where it does less, the middle one of three steps, so that neither an edge nor the place of samples in their pixels says much.
INLINED float16 slope_of(__global const float *plane, int at, int step, int across)
{
    float16 before = middle(step_between(plane, at - step, at), step_between(plane, at - across - step, at - across),
                            step_between(plane, at + across - step, at + across));
    float16 behind = middle(step_between(plane, at, at + step), step_between(plane, at - across, at - across + step),
                            step_between(plane, at + across, at + across + step));
    float16 slope = less(before, behind);
    return slope < INFINITY ? SLACK * slope : 0.0f;
}

// The user's factors of Eq. 2-6.
typedef struct Scales {
    float normal, depth, segment, albedo, albedo_glossy, luminance;
} Scales;

INLINED float16 normal_weight(float scale, Run3 p, Run3 q)
{
    float16 cosine = p.x * q.x + p.y * q.y + p.z * q.z;
    return to_unit(scale * more(cosine, (float16)(0.0f)));
}

// Eq. 3 and 4. slack: what needs no edge to be explained.
INLINED float16 distance_weight(float scale, float16 difference, float16 slack)
{
    return to_unit(1.0f - scale * more(difference - slack, (float16)(0.0f)));
}

// c / (c + 1) of Eq. 5.
INLINED float16 colors_apart(Run3 p, Run3 q)
{
    float16 x = p.x - q.x, y = p.y - q.y, z = p.z - q.z, squared = x * x + y * y + z * z;
    if (!any_of(squared > 0.0f)) return squared;
    float16 apart = log_of(1.0f + KAPPA_COLOR * sqrt(squared)) * (1.0f / KAPPA_COLOR);
    return apart / (apart + 1.0f);
}

// Eq. 6. variance: of the difference, in relation to that of one sample.
INLINED float16 light_weight(float scale, float16 p, float16 q, float16 variance)
{
    float16 apart = KAPPA_LIGHT * fabs(p - q), relative = apart / (apart + (p + q) * sqrt(variance) + FLT_MIN);
    return to_unit(1.0f - log_of(1.0f + scale * relative));
}

INLINED float16 light_of(Run3 v)
{
    return luminance(v.x, v.y, v.z);
}

// A pixel, as taps are held against it. slopes: of depth and of segment, along rows and columns.
typedef struct Pixel {
    Run3 normal, lab, light, rest;
    float16 depth, length, segment, segment_length, rough, variance, luminance;
    float16 slope_x, slope_y, segment_x, segment_y, lobe, reach;
} Pixel;

// Radius in pixels of what R is averaged over. A lobe of half-width rough^2 (in radians, about) blurs what is at the segment's
// end to that times the segment's length, of which a pixel covers the whole path's length times its own angle.
inline float16 reach_of(float16 rough, float16 length, float16 segment, float pixel_angle)
{
    float16 beyond = segment / (length + segment);
    return (rough > 0.0f ? BLUR * COAT : BLUR) * rough * rough * beyond / pixel_angle;
}

INLINED Pixel pixel_of(__global const float *guides, size_t padded, int at, int pitch, float pixel_angle)
{
    Pixel p;
    p.normal = guide3(guides, padded, NORMAL, at);
    p.lab = guide3(guides, padded, LAB, at);
    p.light = guide3(guides, padded, LIGHT, at);
    p.rest = guide3(guides, padded, REST, at);
    p.luminance = light_of(p.light);
    p.variance = guide1(guides, padded, VARIANCE, at);
    p.depth = guide1(guides, padded, DEPTH, at);
    p.length = length_of(p.depth);
    p.slope_x = slope_of(guides + DEPTH * padded, at, 1, pitch);
    p.slope_y = slope_of(guides + DEPTH * padded, at, pitch, 1);
    p.segment = guide1(guides, padded, SEGMENT, at);
    p.segment_length = length_of(p.segment);
    p.rough = guide1(guides, padded, ROUGHNESS, at);
    p.lobe = LOBE * p.rough * p.rough;
    p.reach = reach_of(p.rough, p.length, p.segment_length, pixel_angle);
    return p;
}

typedef struct Sums {
    Run3 value;
    float16 weight;
} Sums;

INLINED void add_tap(Sums *sums, float16 weight, Run3 value)
{
    sums->value.x += weight * value.x;
    sums->value.y += weight * value.y;
    sums->value.z += weight * value.z;
    sums->weight += weight;
}

INLINED Run3 mean_of(Sums sums)
{
    float16 part = sums.weight > 0.0f ? 1.0f / sums.weight : 0.0f;
    Run3 mean = { part * sums.value.x, part * sums.value.y, part * sums.value.z };
    return mean;
}

// E and R of a run, filtered: the weighted means of these pixels and their taps.
typedef struct Filtered {
    Sums light, rest;
    bool has_rest;
} Filtered;

INLINED void add_taps(Filtered *sums, const Pixel *p, Scales scales, __global const float *guides, size_t padded, int at,
                      float x, float y)
{
    float16 depth = guide1(guides, padded, DEPTH, at), slack = fabs(x) * p->slope_x + fabs(y) * p->slope_y;
    float16 place = normal_weight(scales.normal, p->normal, guide3(guides, padded, NORMAL, at)) *
                    distance_weight(scales.depth, difference(p->length, p->depth, depth), slack);
    place = depth > 0.0f ? place : 0.0f;
    if (!any_of(place > 0.0f)) return;
    float16 apart = colors_apart(p->lab, guide3(guides, padded, LAB, at));
    Run3 light = guide3(guides, padded, LIGHT, at);
    float16 variance = p->variance + guide1(guides, padded, VARIANCE, at);
    add_tap(&sums->light, place * to_unit(1.0f - scales.albedo * apart) * guide1(guides, padded, COUNT, at) *
                          light_weight(scales.luminance, p->luminance, light_of(light), variance), light);
    if (!sums->has_rest) return;
    float16 next = guide1(guides, padded, SEGMENT, at), rough = guide1(guides, padded, ROUGHNESS, at);
    float16 segment_slack = fabs(x) * p->segment_x + fabs(y) * p->segment_y + p->lobe;
    float16 segment = distance_weight(scales.segment, difference(p->segment_length, p->segment, next), segment_slack);
    float16 near = (x * x + y * y) / (p->reach * p->reach), unlike = UNLIKE * fabs(rough - p->rough);
    place *= to_unit(1.0f - near) * to_unit(1.0f - unlike) * (p->segment < 0.0f || next < 0.0f ? 1.0f : segment);
    place = rough != 0.0f ? place : 0.0f;
    add_tap(&sums->rest, place * to_unit(1.0f - scales.albedo_glossy * apart), guide3(guides, padded, REST, at));
}

INLINED Filtered filter_run(__global const float *guides, size_t padded, int at, int pitch, Scales scales, float pixel_angle)
{
    Pixel p = pixel_of(guides, padded, at, pitch, pixel_angle);
    float16 zero = 0.0f;
    Filtered sums = { { { zero, zero, zero }, zero }, { { zero, zero, zero }, zero }, any_of(p.reach > 1.0f) };
    add_tap(&sums.light, guide1(guides, padded, COUNT, at), p.light);
    add_tap(&sums.rest, (float16)(1.0f), p.rest);
    if (sums.has_rest) {
        p.reach = more(p.reach, (float16)(1.0f));
        p.segment_x = slope_of(guides + SEGMENT * padded, at, 1, pitch);
        p.segment_y = slope_of(guides + SEGMENT * padded, at, pitch, 1);
    }
    for (int k = 0; k < HALF_TAPS; k++) {
        int x = TAPS[2 * k], y = TAPS[2 * k + 1], away = y * pitch + x;
        add_taps(&sums, &p, scales, guides, padded, at + away, x, y);
        add_taps(&sums, &p, scales, guides, padded, at - away, x, y);
    }
    return sums;
}

// One work-item per run: out[i] from guides. Where a layer has neither vertex nor background in a run, nothing is written.
ONE_BY_ONE __kernel void filter_layer(
    __global const float *albedo,   // (3, n)
    __global const float *own,      // (3, n)
    __global const float *emitted,  // (3, n) or null
    __global const float *depth,    // (n)
    __global const float *guides,   // (planes, padded)
    __global float *out,            // (3, n)
    float scale_normal,
    float scale_depth,
    float scale_segment,
    float scale_albedo,
    float scale_albedo_glossy,
    float scale_luminance,
    float pixel_angle,
    uint width,
    uint height,
    uint padded,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= (uint)runs_along(width) * height) return;
    Place place = place_of_run(i, width);
    float16 far = load_run(depth, place);
    int16 has_light = far != 0.0f, is_there = vload16(0, guides + place.guide) > 0.0f;
    if (!any_of(has_light)) return;
    Run3 sum = load_run3(own, n, place);
    if (any_of(is_there)) {
        Scales scales = { scale_normal, scale_depth, scale_segment, scale_albedo, scale_albedo_glossy, scale_luminance };
        Filtered sums = filter_run(guides, padded, place.guide, pitch_of(width), scales, pixel_angle);
        Run3 e = mean_of(sums.light);
#if PLAIN
        Run3 near = e;
#else
        Run3 c = load_run3(albedo, n, place), near = mean_of(sums.rest);
        near.x += c.x * e.x;
        near.y += c.y * e.y;
        near.z += c.z * e.z;
#endif
        sum.x = is_there ? near.x : sum.x;
        sum.y = is_there ? near.y : sum.y;
        sum.z = is_there ? near.z : sum.z;
    }
    store_run3(out, n, place, where3(has_light, with_emitted(sum, emitted, n, place)));
}

// One work-item per pixel: out[i] as a picture.
__kernel void show_layer(
    __global const float *out,    // (3, n)
    __global const float *depth,  // (n)
    __global float *picture,      // (n, 3)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    store_row(picture, i, either3(depth[i] != 0.0f, load_vec3(out, n, i), all3(0.0f)));
}
