// What a hit is: reads hits and the scene, writes a surface for each ray, as planes. One work-item per ray.
//
// The point is interpolated from the triangle, not taken from t, and comes with a bound on how far it can be off along the
// normal; a ray that starts that far from the surface cannot meet it again (van Antwerpen 2023, "Solving self-intersection
// artifacts in DirectX raytracing"). The bound follows the size of the numbers that were rounded, so that it holds at any
// scale and any distance from the origin.
//
// Defines: HAS_NORMALS, HAS_TEXTURES: compiled out where the scene has none.

#include "common/transform.cl"
#include "scene/texture.cl"

// Bounds, in units of the numbers' size: interpolation and intersection within the object; either transform.
#define OBJECT_ERROR (3.0f * UNIT_ROUNDOFF)
#define TRANSFORM_ERROR (5.0f * UNIT_ROUNDOFF)

inline float3 interpolate(float3 a, float3 b, float3 c, float u, float v)
{
    return a + (u * (b - a) + v * (c - a));
}

__kernel void surface(
    __global const float *positions,      // (vertices, 3)
    __global const uint *triangles,       // (triangles, 3)
    __global const uint *material,        // (triangles)
    __global const float *normals,        // (vertices, 3) or null
    __global const float *uvs,            // (vertices, 2) or null
    __global const Instance *instances,   // (instances)
    __global const Material *materials,   // (materials)
    __global const Texture *textures,     // (textures) or null
    __global const uint *texels,          // (texels) or null
    __constant const float *srgb,         // (256) or null
    __global const float *ray_direction,  // (3, n)
    __global const float *hit_uv,         // (2, n)
    __global const uint *hit_primitive,   // (n)
    __global const uint *hit_instance,    // (n)
    __global float *point,                // (3, n)
    __global float *offset,               // (n)
    __global float *geometric_normal,     // (3, n)
    __global float *shading_normal,       // (3, n)
    __global float *albedo,               // (3, n)
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
    ng = dot3(ng, direction) > 0.0f ? -ng : ng;
    float3 ns = ng;
#if HAS_NORMALS
    float3 na = load_row(normals, a), nb = load_row(normals, b), nc = load_row(normals, c);
    float3 smooth = normalize3(transform_normal(instance.to_object, interpolate(na, nb, nc, u, v)));
    smooth = dot3(smooth, ng) < 0.0f ? -smooth : smooth;
    bool is_smooth = fmin(dot3(na, na), fmin(dot3(nb, nb), dot3(nc, nc))) > 0.0f;  // a row of zeros: a flat triangle
    ns = is_smooth && dot3(smooth, smooth) > 0.5f ? smooth : ng;
#endif
    store_planes(point, n, i, world_point);
    store_planes(geometric_normal, n, i, ng);
    store_planes(shading_normal, n, i, ns);

    __global const Material *m = materials + material[triangle];
    float3 color = (float3)(m->base_color[0], m->base_color[1], m->base_color[2]);
#if HAS_TEXTURES
    if (m->texture >= 0) {
        float s = uvs[2 * a] + (u * (uvs[2 * b] - uvs[2 * a]) + v * (uvs[2 * c] - uvs[2 * a]));
        float t = uvs[2 * a + 1] + (u * (uvs[2 * b + 1] - uvs[2 * a + 1]) + v * (uvs[2 * c + 1] - uvs[2 * a + 1]));
        color *= sample_texture(texels, textures[m->texture], srgb, s, t);
    }
#endif
    store_planes(albedo, n, i, color);
}
