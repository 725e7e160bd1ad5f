// Vectors as wholes, and their parts. A single number is a vector of one component.
// needs vector_functions.cl

// for T in float float2 float3 float4
NODE void Dot(T A, T B, float *Out)
{
    *Out = dot_of(A, B);
}
NODE void Dot(T_D A, T_D B, float_D *Out)
{
    *Out = dot_of(A, B);
}

NODE void Cross(float3 A, float3 B, float3 *Out)
{
    *Out = cross_of(A, B);
}
NODE void Cross(float3_D A, float3_D B, float3_D *Out)
{
    *Out = cross_of(A, B);
}

// for T in float float2 float3 float4
NODE void Length(T In, float *Out)
{
    *Out = length_of(In);
}
NODE void Length(T_D In, float_D *Out)
{
    *Out = length_of(In);
}

// for T in float float2 float3 float4
NODE void Distance(T A, T B, float *Out)
{
    *Out = length_of(A - B);
}
NODE void Distance(T_D A, T_D B, float_D *Out)
{
    *Out = length_of(with_changes(A.v - B.v, A.x - B.x, A.y - B.y));
}

// A zero vector stays zero.
// for T in float float2 float3 float4
NODE void Normalize(T In, T *Out)
{
    *Out = unit_of(In);
}
NODE void Normalize(T_D In, T_D *Out)
{
    T unit = unit_of(In.v);
    float length = length_of(In.v), per_length = length > 0.0f ? 1.0f / length : 0.0f;
    *Out = with_changes(unit, per_length * (In.x - unit * dot_of(unit, In.x)), per_length * (In.y - unit * dot_of(unit, In.y)));
}

NODE void Combine2(float X, float Y, float2 *Out)
{
    *Out = (float2)(X, Y);
}
NODE void Combine2(float_D X, float_D Y, float2_D *Out)
{
    *Out = with_changes((float2)(X.v, Y.v), (float2)(X.x, Y.x), (float2)(X.y, Y.y));
}

NODE void Combine3(float X, float Y, float Z, float3 *Out)
{
    *Out = (float3)(X, Y, Z);
}
NODE void Combine3(float_D X, float_D Y, float_D Z, float3_D *Out)
{
    *Out = with_changes((float3)(X.v, Y.v, Z.v), (float3)(X.x, Y.x, Z.x), (float3)(X.y, Y.y, Z.y));
}

NODE void Combine4(float X, float Y, float Z, float W, float4 *Out)
{
    *Out = (float4)(X, Y, Z, W);
}
NODE void Combine4(float_D X, float_D Y, float_D Z, float_D W, float4_D *Out)
{
    *Out = with_changes((float4)(X.v, Y.v, Z.v, W.v), (float4)(X.x, Y.x, Z.x, W.x), (float4)(X.y, Y.y, Z.y, W.y));
}

// A's components, then B's.
NODE void Append(float3 A, float B, float4 *Out)
{
    *Out = (float4)(A.x, A.y, A.z, B);
}
NODE void Append(float3_D A, float_D B, float4_D *Out)
{
    *Out = with_changes((float4)(A.v.x, A.v.y, A.v.z, B.v), (float4)(A.x.x, A.x.y, A.x.z, B.x),
                        (float4)(A.y.x, A.y.y, A.y.z, B.y));
}
NODE void Append(float2 A, float2 B, float4 *Out)
{
    *Out = (float4)(A.x, A.y, B.x, B.y);
}
NODE void Append(float2_D A, float2_D B, float4_D *Out)
{
    *Out = with_changes((float4)(A.v.x, A.v.y, B.v.x, B.v.y), (float4)(A.x.x, A.x.y, B.x.x, B.x.y),
                        (float4)(A.y.x, A.y.y, B.y.x, B.y.y));
}

NODE void Separate2(float2 In, float *X, float *Y)
{
    *X = In.x;
    *Y = In.y;
}
NODE void Separate2(float2_D In, float_D *X, float_D *Y)
{
    *X = with_changes(In.v.x, In.x.x, In.y.x);
    *Y = with_changes(In.v.y, In.x.y, In.y.y);
}

NODE void Separate3(float3 In, float *X, float *Y, float *Z)
{
    *X = In.x;
    *Y = In.y;
    *Z = In.z;
}
NODE void Separate3(float3_D In, float_D *X, float_D *Y, float_D *Z)
{
    *X = with_changes(In.v.x, In.x.x, In.y.x);
    *Y = with_changes(In.v.y, In.x.y, In.y.y);
    *Z = with_changes(In.v.z, In.x.z, In.y.z);
}

NODE void Separate4(float4 In, float *X, float *Y, float *Z, float *W)
{
    *X = In.x;
    *Y = In.y;
    *Z = In.z;
    *W = In.w;
}
NODE void Separate4(float4_D In, float_D *X, float_D *Y, float_D *Z, float_D *W)
{
    *X = with_changes(In.v.x, In.x.x, In.y.x);
    *Y = with_changes(In.v.y, In.x.y, In.y.y);
    *Z = with_changes(In.v.z, In.x.z, In.y.z);
    *W = with_changes(In.v.w, In.x.w, In.y.w);
}

// The first three components.
NODE void Color(float4 In, float3 *Out)
{
    *Out = to_float3(In);
}
NODE void Color(float4_D In, float3_D *Out)
{
    *Out = to_float3_D(In);
}

// Component Index of In; the last one beyond it, the first one before 0.
// for T in float float2 float3 float4
NODE void Extract(int Index, T In, float *Out)
{
    *Out = component(In, Index);
}
NODE void Extract(int Index, T_D In, float_D *Out)
{
    *Out = with_changes(component(In.v, Index), component(In.x, Index), component(In.y, Index));
}

// In turned by Angle degrees, clockwise.
NODE void Rotate2D(float2 In, float Angle, float2 *Out)
{
    float s = sine_of_degrees(Angle), c = cosine_of_degrees(Angle);
    *Out = (float2)(c * In.x + s * In.y, c * In.y - s * In.x);
}
NODE void Rotate2D(float2_D In, float_D Angle, float2_D *Out)
{
    float s = sine_of_degrees(Angle.v), c = cosine_of_degrees(Angle.v), per_degree = PI / 180.0f;
    float2 turned = (float2)(c * In.v.x + s * In.v.y, c * In.v.y - s * In.v.x);
    float2 by_angle = (float2)(turned.y * per_degree, -turned.x * per_degree);
    *Out = with_changes(turned, (float2)(c * In.x.x + s * In.x.y, c * In.x.y - s * In.x.x) + by_angle * Angle.x,
                        (float2)(c * In.y.x + s * In.y.y, c * In.y.y - s * In.y.x) + by_angle * Angle.y);
}

// In turned about Axis by Angle degrees, clockwise as seen against the axis (MaterialX multiplies row vectors). An axis of
// zero length leaves the cosine's part of In.
NODE void Rotate3D(float3 In, float Angle, float3 Axis, float3 *Out)
{
    float s = sine_of_degrees(Angle), c = cosine_of_degrees(Angle);
    *Out = turned_about(In, unit_of(Axis), s, c);
}
NODE void Rotate3D(float3_D In, float_D Angle, float3 Axis, float3_D *Out)
{
    float s = sine_of_degrees(Angle.v), c = cosine_of_degrees(Angle.v), per_degree = PI / 180.0f;
    float3 unit = unit_of(Axis), along = unit * dot_of(unit, In.v);
    float3 by_angle = ((along - In.v) * s + cross_of(In.v, unit) * c) * per_degree;
    *Out = with_changes(turned_about(In.v, unit, s, c), turned_about(In.x, unit, s, c) + by_angle * Angle.x,
                        turned_about(In.y, unit, s, c) + by_angle * Angle.y);
}

// The products of In with the rows of a matrix, plus Offset.
NODE void Transform3(float3 In, float3 Row0, float3 Row1, float3 Row2, float3 Offset, float3 *Out)
{
    *Out = (float3)(dot_of(Row0, In), dot_of(Row1, In), dot_of(Row2, In)) + Offset;
}
NODE void Transform3(float3_D In, float3 Row0, float3 Row1, float3 Row2, float3 Offset, float3_D *Out)
{
    *Out = with_changes((float3)(dot_of(Row0, In.v), dot_of(Row1, In.v), dot_of(Row2, In.v)) + Offset,
                        (float3)(dot_of(Row0, In.x), dot_of(Row1, In.x), dot_of(Row2, In.x)),
                        (float3)(dot_of(Row0, In.y), dot_of(Row1, In.y), dot_of(Row2, In.y)));
}

NODE void Transform2(float2 In, float2 Row0, float2 Row1, float2 Offset, float2 *Out)
{
    *Out = (float2)(dot_of(Row0, In), dot_of(Row1, In)) + Offset;
}
NODE void Transform2(float2_D In, float2 Row0, float2 Row1, float2 Offset, float2_D *Out)
{
    *Out = with_changes((float2)(dot_of(Row0, In.v), dot_of(Row1, In.v)) + Offset,
                        (float2)(dot_of(Row0, In.x), dot_of(Row1, In.x)),
                        (float2)(dot_of(Row0, In.y), dot_of(Row1, In.y)));
}

NODE void Transform4(float4 In, float4 Row0, float4 Row1, float4 Row2, float4 Row3, float4 *Out)
{
    *Out = (float4)(dot_of(Row0, In), dot_of(Row1, In), dot_of(Row2, In), dot_of(Row3, In));
}
NODE void Transform4(float4_D In, float4 Row0, float4 Row1, float4 Row2, float4 Row3, float4_D *Out)
{
    *Out = with_changes((float4)(dot_of(Row0, In.v), dot_of(Row1, In.v), dot_of(Row2, In.v), dot_of(Row3, In.v)),
                        (float4)(dot_of(Row0, In.x), dot_of(Row1, In.x), dot_of(Row2, In.x), dot_of(Row3, In.x)),
                        (float4)(dot_of(Row0, In.y), dot_of(Row1, In.y), dot_of(Row2, In.y), dot_of(Row3, In.y)));
}
