// What a graph reads of the place where it is evaluated.

NODE void UVInput(const GraphInputs *in, float2 *Out)
{
    *Out = in->uv.v;
}
NODE void UVInput(const GraphInputs *in, float2_D *Out)
{
    *Out = in->uv;
}

NODE void PositionInput(const GraphInputs *in, float3 *Out)
{
    *Out = in->position.v;
}
NODE void PositionInput(const GraphInputs *in, float3_D *Out)
{
    *Out = in->position;
}

NODE void NormalInput(const GraphInputs *in, float3 *Out)
{
    *Out = in->normal;
}
