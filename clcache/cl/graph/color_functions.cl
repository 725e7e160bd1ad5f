// Functions of colours that nodes share.

#include "graph/vector_functions.cl"

NODE float4 with_alpha(float3 rgb, float alpha)
{
    return (float4)(rgb.x, rgb.y, rgb.z, alpha);
}

NODE float4_D with_alpha(float3_D rgb, float_D alpha)
{
    return with_changes(with_alpha(rgb.v, alpha.v), with_alpha(rgb.x, alpha.x), with_alpha(rgb.y, alpha.y));
}

NODE float_D alpha_of(float4_D rgba)
{
    return with_changes(rgba.v.w, rgba.x.w, rgba.y.w);
}

#define FOR_EACH_WIDTH(T)                                                                                                    \
    NODE T##_D zero_where_small(T size, T##_D a)                                                                             \
    {                                                                                                                        \
        return with_changes(fabs(size) < 1e-8f ? (T)(0.0f) : a.v, fabs(size) < 1e-8f ? (T)(0.0f) : a.x,                      \
                            fabs(size) < 1e-8f ? (T)(0.0f) : a.y);                                                           \
    }
FOR_EACH_WIDTH(float)
FOR_EACH_WIDTH(float2)
FOR_EACH_WIDTH(float3)
FOR_EACH_WIDTH(float4)
#undef FOR_EACH_WIDTH

// Hue (in turns, 0 to 1), saturation and value. Saturation is 0 where no component is positive, hue where saturation is.
NODE float3_D hsv_of(float3_D rgb)
{
    float_D r = with_changes(rgb.v.x, rgb.x.x, rgb.y.x), g = with_changes(rgb.v.y, rgb.x.y, rgb.y.y),
            b = with_changes(rgb.v.z, rgb.x.z, rgb.y.z);
    bool red = r.v >= g.v && r.v >= b.v, green = !red && g.v >= b.v;
    float_D value = red ? r : (green ? g : b), next = red ? g : (green ? b : r), last = red ? b : (green ? r : g);
    float_D chroma = difference(value, next.v < last.v ? next : last);
    float_D saturation = value.v > 0.0f ? quotient(chroma, value) : unchanging(0.0f);
    float_D hue = quotient(difference(next, last), chroma);
    float turned = (hue.v + (red ? 0.0f : (green ? 2.0f : 4.0f))) * (1.0f / 6.0f), sixth = 1.0f / 6.0f;
    turned = turned < 0.0f ? turned + 1.0f : turned;
    bool has_hue = saturation.v > 0.0f;
    hue = has_hue ? with_changes(turned, hue.x * sixth, hue.y * sixth) : unchanging(0.0f);
    return with_changes((float3)(hue.v, saturation.v, value.v), (float3)(hue.x, saturation.x, value.x),
                        (float3)(hue.y, saturation.y, value.y));
}

// The component whose hue is `turns` away: the value, less the saturation's part of it by the distance of the hues.
NODE float_D rgb_component(float_D hue, float_D saturation, float_D value, float turns)
{
    float shifted = hue.v + turns;
    float distance = 6.0f * bounded(shifted - floor(shifted), 0.0f, 1.0f);
    bool rises = distance < 1.0f, falls = distance > 3.0f && distance < 4.0f;
    float part = distance >= 4.0f ? 0.0f : (rises ? distance : (falls ? 4.0f - distance : 1.0f));
    float slope = rises ? 6.0f : (falls ? -6.0f : 0.0f);
    float_D missing = product(saturation, with_changes(part, slope * hue.x, slope * hue.y));
    return product(value, complement(missing));
}

// The hue repeats every turn; colours of negative saturation are grey.
NODE float3_D rgb_of(float3_D hsv)
{
    float_D h = with_changes(hsv.v.x, hsv.x.x, hsv.y.x), s = with_changes(hsv.v.y, hsv.x.y, hsv.y.y),
            v = with_changes(hsv.v.z, hsv.x.z, hsv.y.z);
    s = s.v < 0.0f ? unchanging(0.0f) : s;
    float_D r = rgb_component(h, s, v, 5.0f / 6.0f), g = rgb_component(h, s, v, 3.0f / 6.0f),
            b = rgb_component(h, s, v, 1.0f / 6.0f);
    return with_changes((float3)(r.v, g.v, b.v), (float3)(r.x, g.x, b.x), (float3)(r.y, g.y, b.y));
}

NODE float4_D disjoint_over(float4_D fg, float4_D bg)
{
    float_D fg_alpha = alpha_of(fg), bg_alpha = alpha_of(bg), alpha = sum(fg_alpha, bg_alpha);
    bool fits = alpha.v <= 1.0f;
    float_D room = fits ? unchanging(1.0f) : quotient(complement(fg_alpha), bg_alpha);
    float3_D rgb = sum(to_float3_D(fg), product(to_float3_D(bg), to_float3_D(room)));
    bool is_black = !fits && fabs(bg_alpha.v) < 1e-8f;
    rgb = is_black ? unchanging((float3)(0.0f)) : rgb;
    return with_alpha(rgb, fits ? alpha : unchanging(1.0f));
}
