// Ramps and splits over texture coordinates.
// needs functions.cl

// Left where u is 0 or less, Right where it is 1 or more, the line between.
// for T in float float2 float3 float4
NODE void RampLR(T Left, T Right, float2 UV, T *Out)
{
    *Out = between(Left, Right, (T)(bounded(UV.x, 0.0f, 1.0f)));
}
NODE void RampLR(T_D Left, T_D Right, float2_D UV, T_D *Out)
{
    float part = bounded(UV.v.x, 0.0f, 1.0f), by_u = UV.v.x > 0.0f && UV.v.x < 1.0f ? 1.0f : 0.0f;
    *Out = between(Left, Right, with_changes((T)(part), (T)(by_u * UV.x.x), (T)(by_u * UV.y.x)));
}

// Bottom where v is 0 or less, Top where it is 1 or more, the line between.
// for T in float float2 float3 float4
NODE void RampTB(T Top, T Bottom, float2 UV, T *Out)
{
    *Out = between(Bottom, Top, (T)(bounded(UV.y, 0.0f, 1.0f)));
}
NODE void RampTB(T_D Top, T_D Bottom, float2_D UV, T_D *Out)
{
    float part = bounded(UV.v.y, 0.0f, 1.0f), by_v = UV.v.y > 0.0f && UV.v.y < 1.0f ? 1.0f : 0.0f;
    *Out = between(Bottom, Top, with_changes((T)(part), (T)(by_v * UV.x.y), (T)(by_v * UV.y.y)));
}

// Left where u is below Center, else Right; smoothed over the footprint.
// for T in float float2 float3 float4
NODE void SplitLR(T Left, T Right, float Center, float2_D UV, T *Out)
{
    float part = step_of(Center, with_changes(UV.v.x, UV.x.x, UV.y.x)).v;
    *Out = between(Left, Right, (T)(part));
}
NODE void SplitLR(T_D Left, T_D Right, float Center, float2_D UV, T_D *Out)
{
    float_D part = step_of(Center, with_changes(UV.v.x, UV.x.x, UV.y.x));
    *Out = between(Left, Right, with_changes((T)(part.v), (T)(part.x), (T)(part.y)));
}

// Bottom where v is below Center, else Top; smoothed over the footprint.
// for T in float float2 float3 float4
NODE void SplitTB(T Top, T Bottom, float Center, float2_D UV, T *Out)
{
    float part = step_of(Center, with_changes(UV.v.y, UV.x.y, UV.y.y)).v;
    *Out = between(Bottom, Top, (T)(part));
}
NODE void SplitTB(T_D Top, T_D Bottom, float Center, float2_D UV, T_D *Out)
{
    float_D part = step_of(Center, with_changes(UV.v.y, UV.x.y, UV.y.y));
    *Out = between(Bottom, Top, with_changes((T)(part.v), (T)(part.x), (T)(part.y)));
}
