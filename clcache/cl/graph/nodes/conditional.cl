// Choices. A truth value is a float: false if it is 0.

// for T in float float2 float3 float4
NODE void IfGreater(float Value1, float Value2, T In1, T In2, T *Out)
{
    *Out = Value1 > Value2 ? In1 : In2;
}
NODE void IfGreater(float Value1, float Value2, T_D In1, T_D In2, T_D *Out)
{
    *Out = Value1 > Value2 ? In1 : In2;
}

// for T in float float2 float3 float4
NODE void IfGreaterEqual(float Value1, float Value2, T In1, T In2, T *Out)
{
    *Out = Value1 >= Value2 ? In1 : In2;
}
NODE void IfGreaterEqual(float Value1, float Value2, T_D In1, T_D In2, T_D *Out)
{
    *Out = Value1 >= Value2 ? In1 : In2;
}

// for T in float float2 float3 float4
NODE void IfEqual(float Value1, float Value2, T In1, T In2, T *Out)
{
    *Out = Value1 == Value2 ? In1 : In2;
}
NODE void IfEqual(float Value1, float Value2, T_D In1, T_D In2, T_D *Out)
{
    *Out = Value1 == Value2 ? In1 : In2;
}

NODE void And(float A, float B, float *Out)
{
    *Out = A != 0.0f && B != 0.0f ? 1.0f : 0.0f;
}
NODE void And(float A, float B, float_D *Out)
{
    *Out = unchanging(A != 0.0f && B != 0.0f ? 1.0f : 0.0f);
}

NODE void Or(float A, float B, float *Out)
{
    *Out = A != 0.0f || B != 0.0f ? 1.0f : 0.0f;
}
NODE void Or(float A, float B, float_D *Out)
{
    *Out = unchanging(A != 0.0f || B != 0.0f ? 1.0f : 0.0f);
}

NODE void Xor(float A, float B, float *Out)
{
    *Out = (A != 0.0f) != (B != 0.0f) ? 1.0f : 0.0f;
}
NODE void Xor(float A, float B, float_D *Out)
{
    *Out = unchanging((A != 0.0f) != (B != 0.0f) ? 1.0f : 0.0f);
}

NODE void Not(float In, float *Out)
{
    *Out = In != 0.0f ? 0.0f : 1.0f;
}
NODE void Not(float In, float_D *Out)
{
    *Out = unchanging(In != 0.0f ? 0.0f : 1.0f);
}
