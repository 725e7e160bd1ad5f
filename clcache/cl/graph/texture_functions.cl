// Lookups in the scene's textures from graphs.

#include "graph/vector_functions.cl"
#include "scene/maps.cl"

// RGBA of texture use `index` at uv, for a footprint of this width; what is not finite is taken as 0, or as the widest
// footprint.
NODE float4 look_up(const Maps *maps, int index, float2 uv, float footprint)
{
    float2 place = finite_or_zero(uv);
    Texel texel = sample_map(maps, index, place.x, place.y, footprint <= 1e15f ? footprint : 1e15f);
    return (float4)(texel.x, texel.y, texel.z, texel.w);
}

// The width of a footprint (ray cones): the geometric mean of the lengths of its axes.
NODE float width_of(float2_D uv)
{
    return sqrt(length_of(uv.x)) * sqrt(length_of(uv.y));
}
