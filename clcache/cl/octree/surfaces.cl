// Paths that begin anywhere on the static surfaces in the cube, alike by area, on either side: they fill the cache whatever is
// seen (HashCache, section 3.3: any distribution of rays will do). Each begins as if a ray had just found the place, from a
// direction over it by the cosine.
//
// Defines: AREA_STEPS: of the search in the shares; HAS_EMISSION, HAS_TEXTURES, those of alpha.cl.

#include "common/bsdf.cl"
#include "common/random.cl"
#include "common/transform.cl"
#include "octree/dimensions.cl"
#include "pathtrace/queue.cl"
#include "scene/alpha.cl"
#include "scene/environment.cl"

// One work-item per path.
__kernel void begin_on_surfaces(
    __global const float *area_shares,     // (surfaces)
    __global const uint *area_triangle,    // (surfaces, 2)
    __global const float *area_corners,    // (surfaces, 3, 2)
    __global const float *positions,       // (vertices, 3)
    __global const uint *triangles,        // (triangles, 3)
    __global const float *uvs,             // (vertices, 2) or null
    __global const Instance *instances,    // (instances)
    __global const uint *material,         // (triangles)
    __global const Material *materials,    // (materials)
    __global const TextureUse *uses,       // (uses) or null
    __global const Texture *textures,      // (textures) or null
    __global const uint *texels,           // (texels) or null
    __global const float *srgb,            // (256) or null
    __global const uint *pixel,            // (n)
    __global float *ray_origin,            // (3, n)
    __global float *ray_direction,         // (3, n)
    __global float *ray_length,            // (n)
    __global float *throughput,            // (3, n)
    __global float *hit_t,                 // (n)
    __global float *hit_uv,                // (2, n)
    __global uint *hit_primitive,          // (n)
    __global uint *hit_instance,           // (n)
    __global float *density,               // (n) or null
    __global float *cone,                  // (2, n) or null
    __global uint *path,                   // (n)
    __global uint *alive,                  // (chunks)
    uint n,
    uint surfaces,
    uint sample,
    uint key0,
    uint key1)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint place = pixel[i];
    bool is_there = place != NONE;
    place = is_there ? place : 0;
    Random where = random4(place, sample, DIMENSION_PLACE, key0, key1);
    Random how = random4(place, sample, DIMENSION_PLACE + 1, key0, key1);
    uint found = search_shares(area_shares, surfaces, AREA_STEPS, where.x);
    uint number = area_triangle[2 * found], primitive = area_triangle[2 * found + 1];
    float root = sqrt(where.y), second = root * (1.0f - where.z), third = root * where.z;
    __global const float *corners = area_corners + 6 * found;
    float u = corners[0] + second * (corners[2] - corners[0]) + third * (corners[4] - corners[0]);
    float v = corners[1] + second * (corners[3] - corners[1]) + third * (corners[5] - corners[1]);
    Instance instance = instances[number];
    uint corner = 3 * (instance.first_triangle + primitive);
    Vec3 v0 = row3(positions, triangles[corner]);
    Vec3 edge1 = transform_vector(instance.to_world, sub3(row3(positions, triangles[corner + 1]), v0));
    Vec3 edge2 = transform_vector(instance.to_world, sub3(row3(positions, triangles[corner + 2]), v0));
    edge1 = scale3(scale_to_one(max_component(abs3(edge1))), edge1);
    edge2 = scale3(scale_to_one(max_component(abs3(edge2))), edge2);
    Vec3 normal = normalize3(cross3(edge1, edge2)), tangent, bitangent;
    normal = either3(how.z < 0.5f, normal, negate3(normal));
    make_frame(normal, &tangent, &bitangent);
    Vec3 aside = sample_cosine(how.x, how.y);
    Vec3 towards = add3(scale3(aside.z, normal), add3(scale3(aside.x, tangent), scale3(aside.y, bitangent)));
    bool is_solid = is_there && dot3(normal, normal) > 0.5f;
#if HAS_ALPHA
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    is_solid = is_solid && !is_hole(&masks, number, primitive, u, v);
#endif
    store_planes(ray_origin, n, i, all3(0.0f));
    store_planes(ray_direction, n, i, negate3(towards));
    ray_length[i] = is_solid ? INFINITY : 0.0f;
    store_planes(throughput, n, i, all3(1.0f));
    hit_t[i] = 0.0f;
    hit_uv[i] = u;
    hit_uv[n + i] = v;
    hit_primitive[i] = primitive;
    hit_instance[i] = is_solid ? number : NONE;
    path[i] = i;
    if (i % CHUNK == 0) alive[i / CHUNK] = min(CHUNK, n - i);
#if HAS_EMISSION
    density[i] = INFINITY;
#endif
#if HAS_TEXTURES
    cone[i] = 0.0f;
    cone[n + i] = 0.0f;
#endif
}
