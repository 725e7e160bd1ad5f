// What the frames before show, read between their pixels: by Catmull-Rom's weights of the 4x4 about a place if BICUBIC, else
// between the four about it; always within the range of the pixels that it is read from, so that nothing rings. Where some of
// those have no history, it is between those of the four that do.

#include "filter/runs.cl"

#define CARRIES_VARIANCE (!TAA && !PUBLISHED)

// The variance of new samples at one place, of four, of a run.
#if PER_CHANNEL
typedef float4 Spread;
typedef float16 SpreadsOfFour;
typedef struct Spreads {
    float16 rows[4];
} Spreads;
#define LOAD_SPREAD(place, from) vload4(place, from)

inline void store_spreads(const Spreads *spreads, __global float *variance, int place)
{
    for (int k = 0; k < 4; k++) vstore16(spreads->rows[k], k, variance + 4 * place);
}

#else
typedef float Spread;
typedef float4 SpreadsOfFour;
typedef float16 Spreads;
#define LOAD_SPREAD(place, from) ((from)[place])

inline void store_spreads(const Spreads *spreads, __global float *variance, int place)
{
    vstore16(*spreads, 0, variance + place);
}

#endif

// What the history has at one place: mean.w is N, 0 for none. least: the smallest N of the pixels that it is read from.
typedef struct Past {
    float4 mean;
    Spread variance;
    float least;
} Past;

// Between those of the four pixels about a place that have a history, `place` being the first.
inline Past between_some(int place, int pitch, float x, float y, __global const float *history, __global const float *variance)
{
    Past sum = { (float4)(0.0f), (Spread)(0.0f), 0.0f };
    float4 lowest = INFINITY, highest = -INFINITY;
    float total = 0.0f;
    for (int corner = 0; corner < 4; corner++) {
        int at = place + (corner & 1) + (corner >> 1) * pitch;
        float weight = (corner & 1 ? x : 1.0f - x) * (corner >> 1 ? y : 1.0f - y);
        float4 value = vload4(at, history);
        if (!(value.w > 0.0f)) continue;
        lowest = less(lowest, value);
        highest = more(highest, value);
        total += weight;
        sum.mean += weight * value;
#if CARRIES_VARIANCE
        sum.variance += weight * LOAD_SPREAD(at, variance);
#endif
    }
    Past none = { (float4)(0.0f), (Spread)(0.0f), 0.0f };
    if (!(total > 0.0f)) return none;
    sum.mean = less(more(sum.mean / total, lowest), highest);
    sum.variance /= total;
    return sum;
}

// Where in the history the pixels of a run read: `place` is the first of the four pixels about the point; from there it is `x` and
// `y` of the way to the others. across, down: the weights of the four columns and rows.
typedef struct Places {
    int16 place;
    float16 x, y;
    float16 across[4], down[4];
} Places;

// Catmull-Rom's weights of the four pixels about a place that is `part` of the way from the second to the third.
inline void set_cubic(float16 *weights, float16 part)
{
    weights[0] = ((-0.5f * part + 1.0f) * part - 0.5f) * part;
    weights[1] = (1.5f * part - 2.5f) * part * part + 1.0f;
    weights[2] = ((-1.5f * part + 2.0f) * part + 0.5f) * part;
    weights[3] = (0.5f * part - 0.5f) * part * part;
}

INLINED void find_places(Places *places, float16 x, float16 y, int pitch)
{
    float16 left = floor(x), top = floor(y);
    places->place = (convert_int16(top) + MARGIN) * pitch + convert_int16(left) + RUN;
    places->x = x - left;
    places->y = y - top;
#if BICUBIC
    set_cubic(places->across, x - left);
    set_cubic(places->down, y - top);
#endif
}

// Where all pixels have a history; where not, nonsense.
INLINED Past past_at(const Places *places, int k, int pitch, __global const float *history, __global const float *variance)
{
    int place = ((const int *)&places->place)[k];
    float x = ((const float *)&places->x)[k], y = ((const float *)&places->y)[k];
    Past past = { (float4)(0.0f), (Spread)(0.0f), 0.0f };
#if BICUBIC
    __global const float *first = history + 4 * (place - pitch - 1);
    float16 r0 = vload16(0, first), r1 = vload16(0, first + 4 * pitch), r2 = vload16(0, first + 8 * pitch);
    float16 r3 = vload16(0, first + 12 * pitch);
    float16 low = less(less(r0, r1), less(r2, r3)), high = more(more(r0, r1), more(r2, r3));
    float8 low8 = less(low.lo, low.hi), high8 = more(high.lo, high.hi);
    float4 lowest = less(low8.lo, low8.hi), highest = more(high8.lo, high8.hi);
    const float *across = (const float *)places->across + k, *down = (const float *)places->down + k;
    float16 sums = (down[0] * r0 + down[RUN] * r1) + (down[2 * RUN] * r2 + down[3 * RUN] * r3);
    past.mean = (across[0] * sums.lo.lo + across[RUN] * sums.lo.hi) + (across[2 * RUN] * sums.hi.lo + across[3 * RUN] * sums.hi.hi);
#else
    float8 r0 = vload8(0, history + 4 * place), r1 = vload8(0, history + 4 * (place + pitch));
    float8 low = less(r0, r1), high = more(r0, r1);
    float4 lowest = less(low.lo, low.hi), highest = more(high.lo, high.hi);
    float8 both = (1.0f - y) * r0 + y * r1;
    past.mean = (1.0f - x) * both.lo + x * both.hi;
#endif
    past.mean = less(more(past.mean, lowest), highest);
    past.least = lowest.w;
#if CARRIES_VARIANCE
    Spread upper = (1.0f - x) * LOAD_SPREAD(place, variance) + x * LOAD_SPREAD(place + 1, variance);
    Spread lower = (1.0f - x) * LOAD_SPREAD(place + pitch, variance) + x * LOAD_SPREAD(place + pitch + 1, variance);
    past.variance = (1.0f - y) * upper + y * lower;
#endif
    return past;
}

// The history of a run's pixels, as rows of four numbers; the least N that was read.
typedef struct Pasts {
    float16 means[4];
    Spreads variances;
    float least;
} Pasts;

INLINED void read_four(Pasts *pasts, int four, const Places *places, int pitch, __global const float *history,
                       __global const float *variance)
{
    Past a = past_at(places, 4 * four, pitch, history, variance), b = past_at(places, 4 * four + 1, pitch, history, variance);
    Past c = past_at(places, 4 * four + 2, pitch, history, variance), d = past_at(places, 4 * four + 3, pitch, history, variance);
    pasts->means[four] = four_of(a.mean, b.mean, c.mean, d.mean);
#if CARRIES_VARIANCE
    ((SpreadsOfFour *)&pasts->variances)[four] = four_of(a.variance, b.variance, c.variance, d.variance);
#endif
    float least_ab = a.least < b.least ? a.least : b.least, least_cd = c.least < d.least ? c.least : d.least;
    float least = least_ab < least_cd ? least_ab : least_cd;
    pasts->least = pasts->least < least ? pasts->least : least;
}

// Once more the pixels that read from some that have no history: at the image's edge, and beside those without a finite value yet.
inline void mend(Pasts *pasts, const Places *places, int pitch, __global const float *history, __global const float *variance)
{
    for (int k = 0; k < RUN; k++) {
        int place = ((const int *)&places->place)[k];
        if (past_at(places, k, pitch, history, variance).least > 0.0f) continue;
        float x = ((const float *)&places->x)[k], y = ((const float *)&places->y)[k];
        Past past = between_some(place, pitch, x, y, history, variance);
        ((float4 *)pasts->means)[k] = past.mean;
        ((Spread *)&pasts->variances)[k] = past.variance;
    }
}

INLINED void read_history(Pasts *pasts, const Places *places, int pitch, __global const float *history,
                          __global const float *variance)
{
    pasts->least = INFINITY;
    read_four(pasts, 0, places, pitch, history, variance);
    read_four(pasts, 1, places, pitch, history, variance);
    read_four(pasts, 2, places, pitch, history, variance);
    read_four(pasts, 3, places, pitch, history, variance);
    if (!(pasts->least > 0.0f)) mend(pasts, places, pitch, history, variance);
}
