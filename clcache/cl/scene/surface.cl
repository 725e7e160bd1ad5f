// What a hit is: reads hits and the scene, writes a surface for each ray, as planes. One work-item per ray.
//
// The point is interpolated from the triangle, not taken from t, and comes with a bound on how far it can be off along the
// normal; a ray that starts that far from the surface cannot meet it again (van Antwerpen 2023, "Solving self-intersection
// artifacts in DirectX raytracing"). The bound follows the size of the numbers that were rounded, so that it holds at any
// scale and any distance from the origin.
//
// Maps are read at the level that a ray cone asks for (Akenine-Moeller et al. 2021, "Improved Shader and Texture Level of
// Detail Using Ray Cones", JCGT 10(1); MaterialMemo, section 2.2): the cone's width across the ray, in units of the texture.
//
// Defines: HAS_NORMALS, HAS_TEXTURES, HAS_NORMAL_MAPS, HAS_SPECULAR, HAS_EMISSIVE: compiled out where the scene has none.

#include "common/bsdf.cl"
#include "common/transform.cl"
#include "scene/maps.cl"

// Bounds, in units of the numbers' size: interpolation and intersection within the object; either transform.
#define OBJECT_ERROR (3.0f * UNIT_ROUNDOFF)
#define TRANSFORM_ERROR (5.0f * UNIT_ROUNDOFF)
#define WIDEST_SPREAD 1.0f  // radians: past it, and at grazing incidence, the cone's small-angle approximation diverges

inline float3 interpolate(float3 a, float3 b, float3 c, float u, float v)
{
    return a + (u * (b - a) + v * (c - a));
}

// How fast the normal turns along an edge, relative to the edge's length.
inline float edge_curvature(float3 edge, float3 turn)
{
    float squared = dot3(edge, edge);
    return squared > 0.0f ? dot3(turn, edge) / squared : 0.0f;
}

__kernel void surface(
    __global const float *positions,      // (vertices, 3)
    __global const uint *triangles,       // (triangles, 3)
    __global const uint *material,        // (triangles)
    __global const float *normals,        // (vertices, 3) or null
    __global const float *uvs,            // (vertices, 2) or null
    __global const Instance *instances,   // (instances)
    __global const Material *materials,   // (materials)
    __global const TextureUse *uses,      // (uses) or null
    __global const Texture *textures,     // (textures) or null
    __global const uint *texels,          // (texels) or null
    __global const float *srgb,           // (256) or null
    __global const float *ray_direction,  // (3, n)
    __global const float *hit_t,          // (n)
    __global const float *hit_uv,         // (2, n)
    __global const uint *hit_primitive,   // (n)
    __global const uint *hit_instance,    // (n)
    __global float *cone,                 // (2, n) or null
    __global float *point,                // (3, n)
    __global float *offset,               // (n)
    __global float *geometric_normal,     // (3, n)
    __global float *shading_normal,       // (3, n)
    __global float *albedo,               // (3, n)
    __global float *gloss,                // (2, n) or null
    __global float *emitted,              // (3, n) or null
    __global uint *hit_material,          // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint number = hit_instance[i];
    if (number == NONE) {
        store_planes(albedo, n, i, (float3)(0.0f));
        store_planes(shading_normal, n, i, (float3)(0.0f));
        return;
    }

    Instance instance = instances[number];
    uint triangle = instance.first_triangle + hit_primitive[i];
    uint a = triangles[3 * triangle], b = triangles[3 * triangle + 1], c = triangles[3 * triangle + 2];
    float u = hit_uv[i], v = hit_uv[n + i];
    float3 v0 = load_row(positions, a), v1 = load_row(positions, b), v2 = load_row(positions, c);
    float3 edge1 = v1 - v0, edge2 = v2 - v0;
    float3 object_point = v0 + (u * edge1 + v * edge2);
    float3 world_point = transform_point(instance.to_world, object_point);
    float3 object_normal = normalize3(cross3(normalize3(edge1), normalize3(edge2)));
    float3 world_normal = transform_normal(instance.to_object, object_normal);

    float3 extent = fabs(edge1) + fabs(edge2) + fabs(edge1 - edge2);
    float3 object_error = OBJECT_ERROR * (fabs(v0) + (float3)(max_component(extent)));
    object_error += TRANSFORM_ERROR * (transform_vector_abs(instance.to_object, world_point) + translation_abs(instance.to_object));
    float3 world_error = TRANSFORM_ERROR * (transform_vector_abs(instance.to_world, object_point) + translation_abs(instance.to_world));
    // The plane n.p = const of object space is world_normal.p = const: an object-space distance is 1/|world_normal| as far there.
    float to_world_scale = 1.0f / sqrt(dot3(world_normal, world_normal));
    float3 ng = world_normal * to_world_scale;
    offset[i] = dot3(object_error, fabs(object_normal)) * to_world_scale + dot3(world_error, fabs(ng));

    float3 direction = load_planes(ray_direction, n, i);
    bool from_behind = dot3(ng, direction) > 0.0f;
    ng = from_behind ? -ng : ng;
    float3 ns = ng;
#if HAS_NORMALS
    float3 n0 = load_row(normals, a), n1 = load_row(normals, b), n2 = load_row(normals, c);
    float3 smooth = normalize3(transform_normal(instance.to_object, interpolate(n0, n1, n2, u, v)));
    smooth = dot3(smooth, ng) < 0.0f ? -smooth : smooth;
    bool is_smooth = fmin(dot3(n0, n0), fmin(dot3(n1, n1), dot3(n2, n2))) > 0.0f;  // a row of zeros: a flat triangle
    ns = is_smooth && dot3(smooth, smooth) > 0.5f ? smooth : ng;
#endif

    uint index = material[triangle];
    __global const Material *m = materials + index;
    float3 color = (float3)(m->base_color[0], m->base_color[1], m->base_color[2]);
    float metallic = m->metallic, roughness = m->roughness;
    bool faces = !from_behind || m->double_sided;
    float3 light = (float3)(m->emission[0], m->emission[1], m->emission[2]);

#if HAS_TEXTURES
    Maps maps = { uses, textures, texels, srgb };
    float2 uv0 = vload2(a, uvs), uv1 = vload2(b, uvs) - uv0, uv2 = vload2(c, uvs) - uv0;
    float2 uv = uv0 + (u * uv1 + v * uv2);
    float3 world_edge1 = transform_vector(instance.to_world, edge1), world_edge2 = transform_vector(instance.to_world, edge2);
    float3 world_cross = cross3(world_edge1, world_edge2);
    float world_area = sqrt(dot3(world_cross, world_cross)), uv_area = fabs(uv1.x * uv2.y - uv1.y * uv2.x);
    float width = fabs(cone[i] + cone[n + i] * hit_t[i]);
    float footprint = world_area > 0.0f ? width * sqrt(uv_area / world_area) : 0.0f;
    float spread = cone[n + i];
#if HAS_NORMALS
    float3 w0 = normalize3(transform_normal(instance.to_object, n0)), w1 = normalize3(transform_normal(instance.to_object, n1));
    float3 w2 = normalize3(transform_normal(instance.to_object, n2));
    float curvature = edge_curvature(world_edge1, w1 - w0) + edge_curvature(world_edge2, w2 - w0)
                      + edge_curvature(world_edge2 - world_edge1, w2 - w1);
    curvature *= from_behind ? -1.0f / 3.0f : 1.0f / 3.0f;
    float bend = 2.0f * curvature * width / fmax(-dot3(ns, direction), 1e-2f);
    spread = clamp(spread + bend, -WIDEST_SPREAD, WIDEST_SPREAD);
#endif
    cone[i] = width;
    cone[n + i] = spread;

    color *= sample_map(&maps, m->base_color_map, uv, footprint).xyz;
#if HAS_SPECULAR
    if (m->metallic_roughness_map >= 0) {
        float4 texel = sample_map(&maps, m->metallic_roughness_map, uv, footprint);
        roughness *= texel.y;
        metallic *= texel.z;
    }
#endif
#if HAS_EMISSIVE
    light *= sample_map(&maps, m->emission_map, uv, footprint).xyz;
#endif
#if HAS_NORMAL_MAPS
    if (m->normal_map >= 0 && uv_area > 0.0f) {
        // The directions in which u and v grow, as glTF has them: v grows downwards in the picture, green points up.
        float determinant = uv1.x * uv2.y - uv1.y * uv2.x;
        float3 along_u = (uv2.y * world_edge1 - uv1.y * world_edge2) / determinant;
        float3 along_v = (uv1.x * world_edge2 - uv2.x * world_edge1) / determinant;
        float3 outward = from_behind ? -ns : ns;
        float3 tangent = normalize3(along_u - dot3(along_u, outward) * outward);
        float3 bitangent = cross3(outward, tangent);
        bitangent = dot3(bitangent, along_v) > 0.0f ? -bitangent : bitangent;
        float3 texel = sample_map(&maps, m->normal_map, uv, footprint).xyz * 2.0f - 1.0f;
        float3 bent = normalize3(m->normal_scale * (texel.x * tangent + texel.y * bitangent) + texel.z * outward);
        ns = dot3(bent, bent) > 0.5f ? (from_behind ? -bent : bent) : ns;
    }
#endif
#endif
    // A shading normal that points away from the viewer reflects nothing that he could see.
    ns = dot3(ns, direction) < 0.0f ? ns : ng;

    store_planes(point, n, i, world_point);
    store_planes(geometric_normal, n, i, ng);
    store_planes(shading_normal, n, i, ns);
    store_planes(albedo, n, i, faces || m->transmission > 0.0f ? color : (float3)(0.0f));
#if HAS_SPECULAR
    gloss[i] = metallic;
    gloss[n + i] = roughness;
#endif
#if HAS_EMISSIVE
    store_planes(emitted, n, i, faces ? light : (float3)(0.0f));
#endif
    hit_material[i] = index | (from_behind ? FROM_BEHIND : 0u);
}
