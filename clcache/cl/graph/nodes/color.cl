// Colours: luminance, hue, and layers (operators of Porter and Duff among them). Fourth components are alpha.
// needs color_functions.cl

NODE void Luminance(float3 In, float3 Weights, float3 *Out)
{
    *Out = to_float3(dot_of(In, Weights));
}
NODE void Luminance(float3_D In, float3_D Weights, float3_D *Out)
{
    *Out = to_float3_D(dot_of(In, Weights));
}
NODE void Luminance(float4 In, float3 Weights, float4 *Out)
{
    *Out = with_alpha(to_float3(dot_of(to_float3(In), Weights)), In.w);
}
NODE void Luminance(float4_D In, float3_D Weights, float4_D *Out)
{
    *Out = with_alpha(to_float3_D(dot_of(to_float3_D(In), Weights)), alpha_of(In));
}

// Hue in turns, saturation, value.
NODE void RgbToHsv(float3 In, float3 *Out)
{
    *Out = hsv_of(unchanging(In)).v;
}
NODE void RgbToHsv(float3_D In, float3_D *Out)
{
    *Out = hsv_of(In);
}
NODE void RgbToHsv(float4 In, float4 *Out)
{
    *Out = with_alpha(hsv_of(unchanging(to_float3(In))).v, In.w);
}
NODE void RgbToHsv(float4_D In, float4_D *Out)
{
    *Out = with_alpha(hsv_of(to_float3_D(In)), alpha_of(In));
}

NODE void HsvToRgb(float3 In, float3 *Out)
{
    *Out = rgb_of(unchanging(In)).v;
}
NODE void HsvToRgb(float3_D In, float3_D *Out)
{
    *Out = rgb_of(In);
}
NODE void HsvToRgb(float4 In, float4 *Out)
{
    *Out = with_alpha(rgb_of(unchanging(to_float3(In))).v, In.w);
}
NODE void HsvToRgb(float4_D In, float4_D *Out)
{
    *Out = with_alpha(rgb_of(to_float3_D(In)), alpha_of(In));
}

NODE void Premultiply(float4 In, float4 *Out)
{
    *Out = times(In, (float4)(In.w, In.w, In.w, 1.0f));
}
NODE void Premultiply(float4_D In, float4_D *Out)
{
    *Out = with_alpha(product(to_float3_D(In), to_float3_D(alpha_of(In))), alpha_of(In));
}

// Black where alpha is 0.
NODE void Unpremultiply(float4 In, float4 *Out)
{
    *Out = with_alpha(quotient(to_float3(In), to_float3(In.w)), In.w);
}
NODE void Unpremultiply(float4_D In, float4_D *Out)
{
    *Out = with_alpha(quotient(to_float3_D(In), to_float3_D(alpha_of(In))), alpha_of(In));
}

// Bg mixed with Bg + Fg.
// for T in float float2 float3 float4
NODE void BlendPlus(T Fg, T Bg, T Mix, T *Out)
{
    *Out = between(Bg, sum(Bg, Fg), Mix);
}
NODE void BlendPlus(T_D Fg, T_D Bg, T_D Mix, T_D *Out)
{
    *Out = between(Bg, sum(Bg, Fg), Mix);
}

// for T in float float2 float3 float4
NODE void BlendMinus(T Fg, T Bg, T Mix, T *Out)
{
    *Out = between(Bg, difference(Bg, Fg), Mix);
}
NODE void BlendMinus(T_D Fg, T_D Bg, T_D Mix, T_D *Out)
{
    *Out = between(Bg, difference(Bg, Fg), Mix);
}

// for T in float float2 float3 float4
NODE void BlendDifference(T Fg, T Bg, T Mix, T *Out)
{
    *Out = between(Bg, fabs(Bg - Fg), Mix);
}
NODE void BlendDifference(T_D Fg, T_D Bg, T_D Mix, T_D *Out)
{
    T_D distance = difference(Bg, Fg);
    *Out = between(Bg, chain(fabs(distance.v), sign_of(distance.v), distance), Mix);
}

// for T in float float2 float3 float4
NODE void BlendScreen(T Fg, T Bg, T Mix, T *Out)
{
    *Out = between(Bg, complement(product(complement(Fg), complement(Bg))), Mix);
}
NODE void BlendScreen(T_D Fg, T_D Bg, T_D Mix, T_D *Out)
{
    *Out = between(Bg, complement(product(complement(Fg), complement(Bg))), Mix);
}

// 1 - (1 - Bg) / Fg, mixed with Bg; 0, whatever Mix, where Fg is nearer to 0 than 1e-8.
// for T in float float2 float3 float4
NODE void BlendBurn(T Fg, T Bg, T Mix, T *Out)
{
    *Out = fabs(Fg) < 1e-8f ? (T)(0.0f) : between(Bg, complement(quotient(complement(Bg), Fg)), Mix);
}
NODE void BlendBurn(T_D Fg, T_D Bg, T_D Mix, T_D *Out)
{
    *Out = zero_where_small(Fg.v, between(Bg, complement(quotient(complement(Bg), Fg)), Mix));
}

// Bg / (1 - Fg), mixed with Bg; 0, whatever Mix, where Fg is nearer to 1 than 1e-8.
// for T in float float2 float3 float4
NODE void BlendDodge(T Fg, T Bg, T Mix, T *Out)
{
    *Out = fabs(complement(Fg)) < 1e-8f ? (T)(0.0f) : between(Bg, quotient(Bg, complement(Fg)), Mix);
}
NODE void BlendDodge(T_D Fg, T_D Bg, T_D Mix, T_D *Out)
{
    *Out = zero_where_small(1.0f - Fg.v, between(Bg, quotient(Bg, complement(Fg)), Mix));
}

// Fg within Bg's alpha.
NODE void BlendIn(float4 Fg, float4 Bg, float Mix, float4 *Out)
{
    *Out = between(Bg, times(Fg, to_float4(Bg.w)), to_float4(Mix));
}
NODE void BlendIn(float4_D Fg, float4_D Bg, float_D Mix, float4_D *Out)
{
    *Out = between(Bg, product(Fg, to_float4_D(alpha_of(Bg))), to_float4_D(Mix));
}

// Bg within Fg's alpha.
NODE void BlendMask(float4 Fg, float4 Bg, float Mix, float4 *Out)
{
    *Out = between(Bg, times(Bg, to_float4(Fg.w)), to_float4(Mix));
}
NODE void BlendMask(float4_D Fg, float4_D Bg, float_D Mix, float4_D *Out)
{
    *Out = between(Bg, product(Bg, to_float4_D(alpha_of(Fg))), to_float4_D(Mix));
}

// Fg outside Bg's alpha.
NODE void BlendOut(float4 Fg, float4 Bg, float Mix, float4 *Out)
{
    *Out = between(Bg, times(Fg, to_float4(1.0f - Bg.w)), to_float4(Mix));
}
NODE void BlendOut(float4_D Fg, float4_D Bg, float_D Mix, float4_D *Out)
{
    *Out = between(Bg, product(Fg, to_float4_D(complement(alpha_of(Bg)))), to_float4_D(Mix));
}

// Fg over Bg, premultiplied.
NODE void BlendOver(float4 Fg, float4 Bg, float Mix, float4 *Out)
{
    *Out = between(Bg, Fg + times(Bg, to_float4(1.0f - Fg.w)), to_float4(Mix));
}
NODE void BlendOver(float4_D Fg, float4_D Bg, float_D Mix, float4_D *Out)
{
    *Out = between(Bg, sum(Fg, product(Bg, to_float4_D(complement(alpha_of(Fg))))), to_float4_D(Mix));
}

// Fg over Bg, where Fg is not premultiplied.
NODE void BlendMatte(float4 Fg, float4 Bg, float Mix, float4 *Out)
{
    *Out = between(Bg, times(Fg, (float4)(Fg.w, Fg.w, Fg.w, 1.0f)) + times(Bg, to_float4(1.0f - Fg.w)), to_float4(Mix));
}
NODE void BlendMatte(float4_D Fg, float4_D Bg, float_D Mix, float4_D *Out)
{
    float3_D alpha = to_float3_D(alpha_of(Fg));
    float4_D premultiplied = with_alpha(product(to_float3_D(Fg), alpha), alpha_of(Fg));
    *Out = between(Bg, sum(premultiplied, product(Bg, to_float4_D(complement(alpha_of(Fg))))), to_float4_D(Mix));
}

// Fg beside Bg: what of Bg's colour Fg's alpha leaves room for. Black where there is none and Bg's alpha is below 1e-8.
NODE void BlendDisjointOver(float4 Fg, float4 Bg, float Mix, float4 *Out)
{
    *Out = between(Bg, disjoint_over(unchanging(Fg), unchanging(Bg)).v, to_float4(Mix));
}
NODE void BlendDisjointOver(float4_D Fg, float4_D Bg, float_D Mix, float4_D *Out)
{
    *Out = between(Bg, disjoint_over(Fg, Bg), to_float4_D(Mix));
}
