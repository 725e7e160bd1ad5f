// Temporal filtering (Philippi et al. 2023, sections 3.1 and 4.2, Fig. 3): a pixel of the new frame, Y, is joined with the history
// X, what the frames before show of its point: (1 - alpha) X + alpha Y.
//
// The history is read about the pixel's centre moved by the motion of the closest surface among the 3x3 pixels, so that the
// edge of what moves before something else moves with it. It ends where a point was outside the image or behind the camera; for the
// corrected estimate, which trusts its history more, also where it was hidden (`filter/motion.cl`), or mixed with what was beside it
// and has left (`was_left`). Without that, a lamp that the camera passes would leave a trail.
//
//   TAA              alpha is the setting's, or 1 / N while the history has fewer than 1 / alpha samples; before, the
//                    history may be held against the 3x3 pixels of the new frame: REJECT (dropped if any channel is outside
//                    their range), CLAMP (brought to its edge), CLIP (to gamma standard deviations from their mean).
//   PUBLISHED        alpha by Eq. 4: 1 - variance / E[(X - Y)^2], the variance by Eq. 10, each of whose sums is to be divided by
//                    the number of pixels, the denominator by Eq. 11, X against each of the 3x3. That is d^2 / (d^2 + variance),
//                    d being from X to their mean. Nothing known, 0 / 0, is 1.
//   else             the same with what is known of the noise taken out: see `corrected_alpha`.
//
// PER_CHANNEL: each channel has an alpha of its own, else one by luminance.
//
// The effective number of samples N (Eq. 5), in frames, is that of the variance reduction if all frames are independent and
// equally noisy; it goes on with the history, and is resampled with it. That resampling, too, reduces the variance is left
// out. Where channels have weights of their own it follows the weights' mean.
//
// What is not a finite number is no sample: such a pixel of the new frame is left out of its neighbours' statistics, and shows the
// history, as it is; without history it is black, and has N = 0, by which the next frame knows that there is none.
//
// Defines: TAA with at most one of REJECT, CLAMP, CLIP; PUBLISHED; PER_CHANNEL; BICUBIC.

#include "filter/history.cl"

#define STILL_NEARER 0.05f  // of a depth: what is beside a surface, and not of it

// The new frame as padded planes. One work-item per run, those of the padding included.
__kernel void lay_out(
    __global const float *color,   // (pixels, 3)
    __global const float *motion,  // (moved, 2)
    __global const float *depth,   // (moved)
    __global float *frame,         // (7, padded)
    uint width,
    uint height,
    uint padded)
{
    uint i = get_global_id(0);
    if (i >= padded / RUN) return;
    int row, run;
    place_of_pixel(i, runs_along(width) + 2, &row, &run);
    row -= MARGIN;
    run -= 1;
    float16 none = NAN, motion_x = none, motion_y = none, depths = none;
    Colors colors = { none, none, none, none };
    if (row >= 0 && row < (int)height && run >= 0 && run < runs_along(width)) {
        int first = row * (int)width + RUN * run, missing = max(RUN * run + RUN - (int)width, 0);
        colors = load_colors(color, first, missing);
        int16 is_pixel = LANES < (float)(RUN - missing);
        float16 motion0 = vload16(0, motion + 2 * first), motion1 = vload16(1, motion + 2 * first);
        motion_x = is_pixel ? evens(motion0, motion1) : none;
        motion_y = is_pixel ? odds(motion0, motion1) : none;
        depths = is_pixel ? vload16(0, depth + first) : none;
        int16 is_finite = fabs(colors.r) < INFINITY && fabs(colors.g) < INFINITY && fabs(colors.b) < INFINITY;
        colors.r = is_finite ? colors.r : none;
        colors.g = is_finite ? colors.g : none;
        colors.b = is_finite ? colors.b : none;
        colors.w = is_finite ? colors.w : none;
    }
    vstore16(colors.r, i, frame);
    vstore16(colors.g, i, frame + padded);
    vstore16(colors.b, i, frame + 2 * (size_t)padded);
    vstore16(colors.w, i, frame + 3 * (size_t)padded);
    vstore16(motion_x, i, frame + 4 * (size_t)padded);
    vstore16(motion_y, i, frame + 5 * (size_t)padded);
    vstore16(depths, i, frame + 6 * (size_t)padded);
}

// The closest surface about each pixel so far, and how it moves; and how far away the farthest is.
typedef struct Closest {
    float16 depth, x, y, farthest;
} Closest;

// planes: motion in x and y, depth with its sign.
INLINED void consider(Closest *closest, __global const float *planes, size_t padded, int place)
{
    float16 depth = fabs(vload16(0, planes + 2 * padded + place));
    int16 is_closer = depth < closest->depth;
    closest->depth = is_closer ? depth : closest->depth;
    closest->x = is_closer ? vload16(0, planes + place) : closest->x;
    closest->y = is_closer ? vload16(0, planes + padded + place) : closest->y;
    closest->farthest = depth > closest->farthest ? depth : closest->farthest;
}

INLINED Closest closest_about(__global const float *planes, size_t padded, int place, int pitch)
{
    float16 depth = fabs(vload16(0, planes + 2 * padded + place));
    Closest closest = { depth, vload16(0, planes + place), vload16(0, planes + padded + place), depth };
    consider(&closest, planes, padded, place - pitch - 1);
    consider(&closest, planes, padded, place - pitch);
    consider(&closest, planes, padded, place - pitch + 1);
    consider(&closest, planes, padded, place - 1);
    consider(&closest, planes, padded, place + 1);
    consider(&closest, planes, padded, place + pitch - 1);
    consider(&closest, planes, padded, place + pitch);
    consider(&closest, planes, padded, place + pitch + 1);
    return closest;
}

// Whether what was beside a pixel's point before has left it: the history has been mixed with it at its edge. Not asked where
// nothing moves: the sample of a pixel is elsewhere in it in each frame, so that what is near comes and goes. (What was hidden has an
// infinite motion, and so moves.)
INLINED int16 was_left(__global const float *planes, size_t padded, int place, float16 closest)
{
    float16 x = vload16(0, planes + place), y = vload16(0, planes + padded + place), depth = vload16(0, planes + 2 * padded + place);
    return depth < 0.0f && !(closest < -(1.0f - STILL_NEARER) * depth) && (x != 0.0f || y != 0.0f);
}

// Of the 3x3 pixels about each, in one plane: how many there are, and 1 over that; the mean of their differences from the pixel
// itself, the variance, the least and the most. From large numbers themselves, squares would lose the variance.
typedef struct Neighbours {
    float16 own, count, part, mean, variance, lowest, highest;
} Neighbours;

INLINED void add_neighbour(Neighbours *all, float16 value)
{
    int16 is_there = value == value;
    float16 zero = 0.0f, difference = is_there ? value - all->own : zero;
    all->count += is_there ? (float16)(1.0f) : zero;
    all->mean += difference;
    all->variance += difference * difference;
#if REJECT || CLAMP
    all->lowest = value < all->lowest ? value : all->lowest;
    all->highest = value > all->highest ? value : all->highest;
#endif
}

INLINED Neighbours neighbours(__global const float *plane, int place, int pitch)
{
    float16 own = vload16(0, plane + place), zero = 0.0f;
    Neighbours all = { own, (float16)(1.0f), (float16)(1.0f), zero, zero, own, own };
    __global const float *above = plane + place - pitch, *here = plane + place, *below = plane + place + pitch;
    add_neighbour(&all, vload16(0, above - 1));
    add_neighbour(&all, vload16(0, above));
    add_neighbour(&all, vload16(0, above + 1));
    add_neighbour(&all, vload16(0, here - 1));
    add_neighbour(&all, vload16(0, here + 1));
    add_neighbour(&all, vload16(0, below - 1));
    add_neighbour(&all, vload16(0, below));
    add_neighbour(&all, vload16(0, below + 1));
    all.part = 1.0f / all.count;
    all.mean *= all.part;
    all.variance = more(all.variance * all.part - all.mean * all.mean, zero);
    return all;
}

// The effective number of samples of a blend of a history with N = n > 0 and one sample (Eq. 5).
inline float16 effective_count(float16 n, float16 alpha)
{
    float16 kept = 1.0f - alpha;
    return n / (alpha * alpha * n + kept * kept);
}

// The history of one channel as it passes validation; is_outside: whether it is not within the neighbours' range.
inline float16 validated(float16 past, Neighbours all, float gamma, int16 *is_outside)
{
#if REJECT
    *is_outside |= past < all.lowest || past > all.highest;
#elif CLAMP
    past = less(more(past, all.lowest), all.highest);
#elif CLIP
    float16 middle = all.own + all.mean, reach = gamma * sqrt(all.variance);
    past = less(more(past, middle - reach), middle + reach);
#endif
    return past;
}

// Eq. 4 by Eq. 10 and 11. difference: of the history from the neighbours' mean.
inline float16 published_alpha(float16 difference, float16 variance)
{
    float16 squared = difference * difference, alpha = squared / (squared + variance);
    return alpha >= 0.0f ? alpha : 1.0f;
}

// Eq. 4 where the squared difference of history and neighbourhood, beside the bias, has the noise of both, which is not bias:
// of the history variance / N, by Eq. 5, and of the mean of `count` pixels around / count. So
//   bias^2 = max(difference^2 - variance / N - around / count, 0)
//   alpha = (bias^2 + variance / N) / (bias^2 + variance / N + variance)
// which is 1 / (N + 1) without bias, the equal weights of Eq. 6; as well where nothing differs. around: the neighbourhood's variance.
// variance: that, or what the history knows if it is more (`weigh`). part: 1 / count.
inline float16 corrected_alpha(float16 difference, float16 around, float16 variance, float16 n, float16 part)
{
    float16 of_one = 1.0f / n, bias = more(difference * difference - (variance * of_one + around * part), (float16)(0.0f));
    float16 noise = bias > 0.0f || variance > 0.0f ? variance : 1.0f, away = bias + noise * of_one;
    return away < INFINITY && noise < INFINITY ? away / (away + noise) : 1.0f;
}

// The weight of new samples by one plane, and the variance that goes on with the history: rare bright samples escape most
// neighbourhoods, whose variances are then too small, and would take a good history for bias; so the variance is taken to be at
// least what the history knows of it, which is averaged with the same weights as the history.
INLINED float16 weigh(Neighbours all, float16 past, float16 n, float16 *known)
{
    float16 difference = (past - all.own) - all.mean;
#if PUBLISHED
    return published_alpha(difference, all.variance);
#else
    float16 variance = all.count > 1.0f ? all.variance * (all.count / (all.count - 1.0f)) : 0.0f;
    variance = less(variance, (float16)(FLT_MAX));
    float16 alpha = corrected_alpha(difference, variance, more(variance, *known), n, all.part);
    float16 found = *known + alpha * (variance - *known);
    *known = all.own == all.own ? (n > 0.0f ? found : variance) : *known;
    return alpha;
#endif
}

// X + alpha (Y - X), between both whatever rounding does. Without a history Y; without a sample X.
inline float16 join(float16 past, float16 new, float16 alpha, int16 has_past, int16 is_there)
{
    float16 x = has_past ? past : 0.0f, y = is_there ? new : x;
    float16 mean = fmin(fmax(x + alpha * (y - x), less(x, y)), more(x, y));
    return has_past ? mean : y;
}

// The weights of new samples in each channel, and, as w, for all. past: may change by validation, its N to 0. variances: of the
// samples before, become those with the new ones.
INLINED Colors weights(__global const float *frame, int place, int pitch, size_t padded, Colors *past, Spreads *variances,
                       int16 is_there, float least_alpha, float gamma)
{
    __global const float *red = frame, *green = frame + padded, *blue = frame + 2 * padded, *luminances = frame + 3 * padded;
    Colors alpha;
#if TAA
#if REJECT || CLAMP || CLIP
    int16 is_outside = 0;
    float16 r = validated(past->r, neighbours(red, place, pitch), gamma, &is_outside);
    float16 g = validated(past->g, neighbours(green, place, pitch), gamma, &is_outside);
    float16 b = validated(past->b, neighbours(blue, place, pitch), gamma, &is_outside);
    past->r = is_there ? r : past->r;
    past->g = is_there ? g : past->g;
    past->b = is_there ? b : past->b;
    past->w = is_outside && is_there ? 0.0f : past->w;
#endif
    alpha.r = more((float16)(least_alpha), 1.0f / (past->w + 1.0f));
#elif PER_CHANNEL
    Colors known = { (float16)(0.0f), (float16)(0.0f), (float16)(0.0f), (float16)(0.0f) };
#if CARRIES_VARIANCE
    known = from_rows(variances->rows);
#endif
    alpha.r = weigh(neighbours(red, place, pitch), past->r, past->w, &known.r);
    alpha.g = weigh(neighbours(green, place, pitch), past->g, past->w, &known.g);
    alpha.b = weigh(neighbours(blue, place, pitch), past->b, past->w, &known.b);
#if CARRIES_VARIANCE
    to_rows(known, variances->rows);
#endif
#else
    alpha.r = weigh(neighbours(luminances, place, pitch), luminance(past->r, past->g, past->b), past->w, variances);
#endif
    int16 has_past = past->w > 0.0f;
    alpha.r = is_there ? (has_past ? alpha.r : 1.0f) : 0.0f;
#if PER_CHANNEL
    alpha.g = is_there ? (has_past ? alpha.g : 1.0f) : 0.0f;
    alpha.b = is_there ? (has_past ? alpha.b : 1.0f) : 0.0f;
    alpha.w = (alpha.r + alpha.g + alpha.b) / 3.0f;
#else
    alpha.g = alpha.b = alpha.w = alpha.r;
#endif
    return alpha;
}

// Rows of four to an image without padding, and a number of each pixel beside them; of a run, the first `count` pixels.
INLINED void store_run(const float16 *rows, float16 alpha, int count, __global float *filtered, __global float *aov_alpha)
{
    if (count >= RUN) {
        for (int k = 0; k < 4; k++) {
            vstore8(rows[k].s01245689, 0, filtered + 12 * k);
            vstore4(rows[k].sacde, 0, filtered + 12 * k + 8);
        }
        vstore16(alpha, 0, aov_alpha);
        return;
    }
    for (int k = 0; k < count; k++) {
        vstore3(((const float4 *)rows)[k].xyz, k, filtered);
        aov_alpha[k] = ((const float *)&alpha)[k];
    }
}

// One work-item per run, in a group of its own: PoCL would keep the arrays of a group's work-items all at once.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void filter(
    __global const float *frame,            // (7, padded)
    __global const float *history_before,   // (padded, 4)
    __global const float *variance_before,  // (padded, spreads) or null
    __global float *filtered,               // (pixels, 3)
    __global float *aov_alpha,              // (pixels)
    __global float *history,                // (padded, 4)
    __global float *variance,               // (padded, spreads) or null
    __global float *depths,                 // (padded, 2) or null
    uint width,
    uint height,
    uint padded,
    float least_alpha,
    float gamma)
{
    uint i = get_global_id(0);
    int runs = runs_along(width), pitch = pitch_of(width), row, column;
    if (i >= runs * height) return;
    place_of_pixel(i, (uint)runs, &row, &column);
    column *= RUN;
    int place = padded_place(row, column, pitch), pixel = row * (int)width + column;

    Closest closest = closest_about(frame + 4 * (size_t)padded, padded, place, pitch);
    float16 own_x = (float)column + LANES, at_x = own_x + closest.x, at_y = (float)row + closest.y;
    int16 is_pixel = own_x < (float)(int)width;
    float right = (float)(int)width - 0.5f, bottom = (float)(int)height - 0.5f;
    int16 is_inside = is_pixel && at_x >= -0.5f && at_x < right && at_y >= -0.5f && at_y < bottom;
    Places places;
    find_places(&places, is_inside ? at_x : 0.0f, is_inside ? at_y : 0.0f, pitch);
    Pasts pasts;
    read_history(&pasts, &places, pitch, history_before, variance_before);
    Colors past = from_rows(pasts.means);
    past.w = is_inside ? past.w : 0.0f;
#if CARRIES_VARIANCE
    past.w = was_left(frame + 4 * (size_t)padded, padded, place, closest.depth) ? 0.0f : past.w;
#endif

    Colors new = { vload16(0, frame + place), vload16(0, frame + padded + place), vload16(0, frame + 2 * (size_t)padded + place),
                   (float16)(0.0f) };
    int16 is_there = new.r == new.r;
    Colors alpha = weights(frame, place, pitch, padded, &past, &pasts.variances, is_there, least_alpha, gamma);
    int16 has_past = past.w > 0.0f;
    Colors joined = { join(past.r, new.r, alpha.r, has_past, is_there), join(past.g, new.g, alpha.g, has_past, is_there),
                      join(past.b, new.b, alpha.b, has_past, is_there), has_past ? effective_count(past.w, alpha.w) : alpha.w };
    // What is in no pixel stays 0.
    joined.r = is_pixel ? joined.r : 0.0f;
    joined.g = is_pixel ? joined.g : 0.0f;
    joined.b = is_pixel ? joined.b : 0.0f;
    joined.w = is_pixel ? joined.w : 0.0f;
    float16 rows[4];
    to_rows(joined, rows);
    for (int k = 0; k < 4; k++) vstore16(rows[k], k, history + 4 * place);
#if CARRIES_VARIANCE
    store_spreads(&pasts.variances, variance, place);
    vstore16(zip(closest.depth.lo, closest.farthest.lo), 0, depths + 2 * place);
    vstore16(zip(closest.depth.hi, closest.farthest.hi), 1, depths + 2 * place);
#endif
    store_run(rows, alpha.w, (int)width - column, filtered + 3 * pixel, aov_alpha + pixel);
}

// The effective number of samples of each pixel, as an image. One work-item per pixel.
__kernel void show_effective(
    __global const float *history,  // (padded, 4)
    __global float *aov_effective,  // (pixels)
    uint width,
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= pixels) return;
    int row, column;
    place_of_pixel(i, width, &row, &column);
    aov_effective[i] = history[4 * padded_place(row, column, pitch_of(width)) + 3];
}
