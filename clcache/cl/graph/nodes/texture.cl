// Pictures, and normals from them.
// needs texture_functions.cl

// RGBA of a picture at UV, from the mip levels that fit the footprint. With changes: differences over the footprint's axes.
NODE void Image(const Maps *maps, int Texture, float2_D UV, float4 *Out)
{
    *Out = look_up(maps, Texture, UV.v, width_of(UV));
}
NODE void Image(const Maps *maps, int Texture, float2_D UV, float4_D *Out)
{
    float width = width_of(UV);
    float4 change_x = look_up(maps, Texture, UV.v + 0.5f * UV.x, width) - look_up(maps, Texture, UV.v - 0.5f * UV.x, width);
    float4 change_y = look_up(maps, Texture, UV.v + 0.5f * UV.y, width) - look_up(maps, Texture, UV.v - 0.5f * UV.y, width);
    *Out = with_changes(look_up(maps, Texture, UV.v, width), change_x, change_y);
}

// The tangent-space normal of a picture that stores it as 0.5 + 0.5 n, with its x and y scaled; not of unit length. The
// unperturbed normal where the picture is black.
NODE void NormalMap(float3 In, float2 Scale, float3 *Out)
{
    bool is_black = In.x == 0.0f && In.y == 0.0f && In.z == 0.0f;
    float3 normal = (float3)((2.0f * In.x - 1.0f) * Scale.x, (2.0f * In.y - 1.0f) * Scale.y, 2.0f * In.z - 1.0f);
    *Out = is_black ? (float3)(0.0f, 0.0f, 1.0f) : normal;
}

// The normal of the surface that Height raises over UV, stored as 0.5 + 0.5 n; (0.5, 0.5, 1) where the changes of UV span no
// area. 1 / 16 is MaterialX's, whose other renderers find slopes by a Sobel filter.
NODE void HeightToNormal(float_D Height, float Scale, float2_D UV, float3 *Out)
{
    float slope = Scale * (1.0f / 16.0f);
    float3 along_x = (float3)(UV.x.x, UV.x.y, Height.x * slope), along_y = (float3)(UV.y.x, UV.y.y, Height.y * slope);
    float3 normal = unit_of(cross_of(unit_of(along_x), unit_of(along_y)));
    normal = normal.z < 0.0f ? -normal : normal;
    float determinant = fabs(UV.x.x * UV.y.y - UV.x.y * UV.y.x);
    *Out = determinant > 0.0f && normal.z >= 0.0f ? normal * 0.5f + 0.5f : (float3)(0.5f, 0.5f, 1.0f);
}
