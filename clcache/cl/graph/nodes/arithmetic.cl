// Arithmetic, component by component.
// needs functions.cl

// for T in float float2 float3 float4
NODE void Add(T A, T B, T *Out)
{
    *Out = A + B;
}
NODE void Add(T_D A, T_D B, T_D *Out)
{
    *Out = with_changes(A.v + B.v, A.x + B.x, A.y + B.y);
}

// for T in float float2 float3 float4
NODE void Sub(T A, T B, T *Out)
{
    *Out = A - B;
}
NODE void Sub(T_D A, T_D B, T_D *Out)
{
    *Out = with_changes(A.v - B.v, A.x - B.x, A.y - B.y);
}

// At most the largest float in size, as quotients.
// for T in float float2 float3 float4
NODE void Mul(T A, T B, T *Out)
{
    *Out = product(A, B);
}
NODE void Mul(T_D A, T_D B, T_D *Out)
{
    *Out = product(A, B);
}

// 0 where B is 0.
// for T in float float2 float3 float4
NODE void Div(T A, T B, T *Out)
{
    *Out = quotient(A, B);
}
NODE void Div(T_D A, T_D B, T_D *Out)
{
    *Out = quotient(A, B);
}

// A - B floor(A / B), of B's sign; 0 where B is 0, and where A / B is 2^23 or more, so that no digit of the remainder is left.
// for T in float float2 float3 float4
NODE void Mod(T A, T B, T *Out)
{
    *Out = has_remainder(A, B) > 0.0f ? A - B * whole_quotient(A, B) : (T)(0.0f);
}
NODE void Mod(T_D A, T_D B, T_D *Out)
{
    T whole = whole_quotient(A.v, B.v), by_a = has_remainder(A.v, B.v);
    *Out = chain(by_a > 0.0f ? A.v - B.v * whole : (T)(0.0f), by_a, A, -by_a * whole, B);
}

// A to the power of B, at most the largest float. 1 where B is 0; else 0 where A is 0, and where A is negative and B is no
// whole number.
// for T in float float2 float3 float4
NODE void Pow(T A, T B, T *Out)
{
    *Out = power(A, B);
}
NODE void Pow(T_D A, T_D B, T_D *Out)
{
    *Out = chain(power(A.v, B.v), B.v * power(A.v, B.v - 1.0f), A, power(A.v, B.v) * logarithm_or_zero(A.v), B);
}

// The power of A's size, with A's sign.
// for T in float float2 float3 float4
NODE void SafePow(T A, T B, T *Out)
{
    *Out = sign_of(A) * power(fabs(A), B);
}
NODE void SafePow(T_D A, T_D B, T_D *Out)
{
    T size = fabs(A.v), value = sign_of(A.v) * power(size, B.v);
    *Out = chain(value, B.v * power(size, B.v - 1.0f), A, value * logarithm_or_zero(size), B);
}

// for T in float float2 float3 float4
NODE void Abs(T In, T *Out)
{
    *Out = fabs(In);
}
NODE void Abs(T_D In, T_D *Out)
{
    *Out = chain(fabs(In.v), sign_of(In.v), In);
}

// -1, 0 or 1.
// for T in float float2 float3 float4
NODE void Sign(T In, T *Out)
{
    *Out = sign_of(In);
}
NODE void Sign(T In, T_D *Out)
{
    *Out = unchanging(sign_of(In));
}

// for T in float float2 float3 float4
NODE void Floor(T In, T *Out)
{
    *Out = floor(In);
}
NODE void Floor(T In, T_D *Out)
{
    *Out = unchanging(floor(In));
}

// for T in float float2 float3 float4
NODE void Ceil(T In, T *Out)
{
    *Out = ceil(In);
}
NODE void Ceil(T In, T_D *Out)
{
    *Out = unchanging(ceil(In));
}

// The nearest whole number; halves away from zero.
// for T in float float2 float3 float4
NODE void Round(T In, T *Out)
{
    *Out = round(In);
}
NODE void Round(T In, T_D *Out)
{
    *Out = unchanging(round(In));
}

// In - floor(In).
// for T in float float2 float3 float4
NODE void Fract(T In, T *Out)
{
    *Out = In - floor(In);
}
NODE void Fract(T_D In, T_D *Out)
{
    *Out = with_changes(In.v - floor(In.v), In.x, In.y);
}

// for T in float float2 float3 float4
NODE void Min(T A, T B, T *Out)
{
    *Out = B < A ? B : A;
}
NODE void Min(T_D A, T_D B, T_D *Out)
{
    *Out = with_changes(B.v < A.v ? B.v : A.v, B.v < A.v ? B.x : A.x, B.v < A.v ? B.y : A.y);
}

// for T in float float2 float3 float4
NODE void Max(T A, T B, T *Out)
{
    *Out = B > A ? B : A;
}
NODE void Max(T_D A, T_D B, T_D *Out)
{
    *Out = with_changes(B.v > A.v ? B.v : A.v, B.v > A.v ? B.x : A.x, B.v > A.v ? B.y : A.y);
}

// High where it is below Low.
// for T in float float2 float3 float4
NODE void Clamp(T In, T Low, T High, T *Out)
{
    T raised = In < Low ? Low : In;
    *Out = raised > High ? High : raised;
}
NODE void Clamp(T_D In, T_D Low, T_D High, T_D *Out)
{
    T v = In.v < Low.v ? Low.v : In.v, x = In.v < Low.v ? Low.x : In.x, y = In.v < Low.v ? Low.y : In.y;
    *Out = with_changes(v > High.v ? High.v : v, v > High.v ? High.x : x, v > High.v ? High.y : y);
}

// 0 for negative numbers.
// for T in float float2 float3 float4
NODE void Sqrt(T In, T *Out)
{
    *Out = root(In);
}
NODE void Sqrt(T_D In, T_D *Out)
{
    *Out = chain(root(In.v), quotient((T)(0.5f), root(In.v)), In);
}

// Natural logarithm; that of the smallest normal float (-87.3) for all below it.
// for T in float float2 float3 float4
NODE void Ln(T In, T *Out)
{
    *Out = logarithm(In);
}
NODE void Ln(T_D In, T_D *Out)
{
    *Out = chain(logarithm(In.v), In.v > 0.0f ? quotient((T)(1.0f), In.v) : (T)(0.0f), In);
}

// At most the largest float; 0 below the smallest normal one.
// for T in float float2 float3 float4
NODE void Exp(T In, T *Out)
{
    *Out = exponential(In);
}
NODE void Exp(T_D In, T_D *Out)
{
    *Out = chain(exponential(In.v), exponential(In.v), In);
}

// Of radians; of the nearest float, whose distance to its neighbours is the error where they lie far apart.
// for T in float float2 float3 float4
NODE void Sin(T In, T *Out)
{
    *Out = sine(In);
}
NODE void Sin(T_D In, T_D *Out)
{
    *Out = chain(sine(In.v), cosine(In.v), In);
}

// for T in float float2 float3 float4
NODE void Cos(T In, T *Out)
{
    *Out = cosine(In);
}
NODE void Cos(T_D In, T_D *Out)
{
    *Out = chain(cosine(In.v), -sine(In.v), In);
}

// 0 at the poles.
// for T in float float2 float3 float4
NODE void Tan(T In, T *Out)
{
    *Out = quotient(sine(In), cosine(In));
}
NODE void Tan(T_D In, T_D *Out)
{
    T c = cosine(In.v);
    *Out = chain(quotient(sine(In.v), c), quotient((T)(1.0f), c * c), In);
}

// In brought to -1 .. 1, where it ends changing.
// for T in float float2 float3 float4
NODE void Asin(T In, T *Out)
{
    T bounded = within_one(In);
    *Out = angle(bounded, root((1.0f - bounded) * (1.0f + bounded)));
}
NODE void Asin(T_D In, T_D *Out)
{
    T bounded = within_one(In.v), other = root((1.0f - bounded) * (1.0f + bounded));
    *Out = chain(angle(bounded, other), quotient((T)(1.0f), other), In);
}

// for T in float float2 float3 float4
NODE void Acos(T In, T *Out)
{
    T bounded = within_one(In);
    *Out = angle(root((1.0f - bounded) * (1.0f + bounded)), bounded);
}
NODE void Acos(T_D In, T_D *Out)
{
    T bounded = within_one(In.v), other = root((1.0f - bounded) * (1.0f + bounded));
    *Out = chain(angle(other, bounded), -quotient((T)(1.0f), other), In);
}

// The angle of (X, Y) from the x axis; 0 for (0, 0).
// for T in float float2 float3 float4
NODE void Atan2(T Y, T X, T *Out)
{
    *Out = angle(Y, X);
}
NODE void Atan2(T_D Y, T_D X, T_D *Out)
{
    T squared = X.v * X.v + Y.v * Y.v;
    *Out = chain(angle(Y.v, X.v), quotient(X.v, squared), Y, -quotient(Y.v, squared), X);
}

// Bg where Mix is 0, Fg where it is 1, beyond them for other numbers.
// for T in float float2 float3 float4
NODE void Mix(T Fg, T Bg, T Mix, T *Out)
{
    *Out = between(Bg, Fg, Mix);
}
NODE void Mix(T_D Fg, T_D Bg, T_D Mix, T_D *Out)
{
    *Out = between(Bg, Fg, Mix);
}

// 0 up to Low, 1 from High on, the cubic 3 t^2 - 2 t^3 between.
// for T in float float2 float3 float4
NODE void Smoothstep(T In, T Low, T High, T *Out)
{
    T t = quotient(In - Low, High - Low), smooth = t * t * (3.0f - 2.0f * t);
    T lower = In > Low ? smooth : (T)(0.0f);
    *Out = In >= High ? (T)(1.0f) : lower;
}
NODE void Smoothstep(T_D In, T_D Low, T_D High, T_D *Out)
{
    T width = High.v - Low.v, t = quotient(In.v - Low.v, width);
    T lower = In.v > Low.v ? t * t * (3.0f - 2.0f * t) : (T)(0.0f), value = In.v >= High.v ? (T)(1.0f) : lower;
    T rises = In.v > Low.v ? quotient(6.0f * t * (1.0f - t), width) : (T)(0.0f), by_t = In.v >= High.v ? (T)(0.0f) : rises;
    *Out = chain(value, by_t, In, by_t * (t - 1.0f), Low, -by_t * t, High);
}

// The line through (InLow, OutLow) and (InHigh, OutHigh); OutLow where InLow is InHigh.
// for T in float float2 float3 float4
NODE void Remap(T In, T InLow, T InHigh, T OutLow, T OutHigh, T *Out)
{
    *Out = between(OutLow, OutHigh, quotient(In - InLow, InHigh - InLow));
}
NODE void Remap(T_D In, T_D InLow, T_D InHigh, T_D OutLow, T_D OutHigh, T_D *Out)
{
    T width = InHigh.v - InLow.v, t = quotient(In.v - InLow.v, width), per = quotient((T)(1.0f), width);
    T_D part = chain(t, per, In, per * (t - 1.0f), InLow, -per * t, InHigh);
    *Out = between(OutLow, OutHigh, part);
}
