// Images as the temporal filters have them: by runs.
//
// A work-item does a run of 16 pixels of a row, which are the lanes of vectors; where each pixel reads its history from elsewhere,
// a vector is a row of the history's pixels. Images are padded, so that no neighbour and no run is outside them: by RUN pixels at
// the left, by as many and what the last run lacks at the right, by MARGIN rows above and below.
//
//   frame     planes: red, green, blue, luminance, NaN where there is no pixel or one that is not finite; motion in x and y, and depth,
//             as `find_motion` says them, NaN where there is no pixel
//   history   rows of red, green, blue, N; 0 where there is no pixel
//   depths    rows of the least and the greatest depth of the 3x3 pixels about each
//   variance  of the new samples, as the history has it: of luminance, or rows of red, green, blue and an unused number

#include "common/camera.cl"

#define RUN 16    // pixels; as in passes/temporal.py
#define MARGIN 2  // rows, for the farthest of 4x4 pixels about a place at the edge; as there
#define LANES ((float16)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f, 8.0f, 9.0f, 10.0f, 11.0f, 12.0f, 13.0f, 14.0f, 15.0f))

inline int runs_along(uint width)
{
    return ((int)width + RUN - 1) / RUN;
}

inline int pitch_of(uint width)
{
    return RUN * (runs_along(width) + 2);
}

inline int padded_place(int row, int column, int pitch)
{
    return (row + MARGIN) * pitch + column + RUN;
}

// Neither is NaN.
inline OVERLOADED float16 less(float16 a, float16 b) { return a < b ? a : b; }
inline OVERLOADED float16 more(float16 a, float16 b) { return a > b ? a : b; }
inline OVERLOADED float8 less(float8 a, float8 b) { return a < b ? a : b; }
inline OVERLOADED float8 more(float8 a, float8 b) { return a > b ? a : b; }
inline OVERLOADED float4 less(float4 a, float4 b) { return a < b ? a : b; }
inline OVERLOADED float4 more(float4 a, float4 b) { return a > b ? a : b; }

// A number of each pixel of a run.
typedef struct Colors {
    float16 r, g, b, w;
} Colors;

inline float16 luminance(float16 r, float16 g, float16 b)
{
    return 0.2126f * r + 0.7152f * g + 0.0722f * b;
}

// Vectors of shorter ones. No literals, for on those of vectors Oclgrind 21.10 ends with a segmentation fault.
inline float16 both_of(float8 a, float8 b)
{
    float16 both;
    both.lo = a;
    both.hi = b;
    return both;
}

inline OVERLOADED float16 four_of(float4 a, float4 b, float4 c, float4 d)
{
    float16 all;
    all.s0123 = a;
    all.s4567 = b;
    all.s89ab = c;
    all.scdef = d;
    return all;
}

inline OVERLOADED float4 four_of(float a, float b, float c, float d)
{
    return (float4)(a, b, c, d);
}

inline float16 evens(float16 a, float16 b)
{
    return both_of(a.even, b.even);
}

inline float16 odds(float16 a, float16 b)
{
    return both_of(a.odd, b.odd);
}

inline float16 zip(float8 a, float8 b)
{
    return (float16)(a.s0, b.s0, a.s1, b.s1, a.s2, b.s2, a.s3, b.s3, a.s4, b.s4, a.s5, b.s5, a.s6, b.s6, a.s7, b.s7);
}

// From rows of four numbers to one vector for each of these, and back: to pixels 0-3, 4-7, 8-11 and 12-15.
inline Colors from_rows(const float16 *rows)
{
    float16 rb_low = evens(rows[0], rows[1]), rb_high = evens(rows[2], rows[3]);
    float16 gw_low = odds(rows[0], rows[1]), gw_high = odds(rows[2], rows[3]);
    Colors colors = { evens(rb_low, rb_high), evens(gw_low, gw_high), odds(rb_low, rb_high), odds(gw_low, gw_high) };
    return colors;
}

inline void to_rows(Colors colors, float16 *rows)
{
    float16 rb_low = zip(colors.r.lo, colors.b.lo), gw_low = zip(colors.g.lo, colors.w.lo);
    float16 rb_high = zip(colors.r.hi, colors.b.hi), gw_high = zip(colors.g.hi, colors.w.hi);
    rows[0] = zip(rb_low.lo, gw_low.lo);
    rows[1] = zip(rb_low.hi, gw_low.hi);
    rows[2] = zip(rb_high.lo, gw_high.lo);
    rows[3] = zip(rb_high.hi, gw_high.hi);
}

// Sixteen pixels of an image without padding, of which the last `missing` are not there.
INLINED Colors load_colors(__global const float *color, int first, int missing)
{
    float16 a, b, c;
    if (missing > 0) {
        float16 rows[3];
        for (int k = 0; k < 3 * RUN; k++) ((float *)rows)[k] = k < 3 * (RUN - missing) ? color[3 * first + k] : NAN;
        a = rows[0];
        b = rows[1];
        c = rows[2];
    } else {
        a = vload16(0, color + 3 * first);
        b = vload16(1, color + 3 * first);
        c = vload16(2, color + 3 * first);
    }
    Colors colors;
    colors.r = (float16)(a.s0, a.s3, a.s6, a.s9, a.sc, a.sf, b.s2, b.s5, b.s8, b.sb, b.se, c.s1, c.s4, c.s7, c.sa, c.sd);
    colors.g = (float16)(a.s1, a.s4, a.s7, a.sa, a.sd, b.s0, b.s3, b.s6, b.s9, b.sc, b.sf, c.s2, c.s5, c.s8, c.sb, c.se);
    colors.b = (float16)(a.s2, a.s5, a.s8, a.sb, a.se, b.s1, b.s4, b.s7, b.sa, b.sd, c.s0, c.s3, c.s6, c.s9, c.sc, c.sf);
    colors.w = luminance(colors.r, colors.g, colors.b);
    return colors;
}
