// One vertex of every path. Reads what the paths' rays hit; adds to their radiance what the rays found themselves: emission, or
// the environment where there was nothing else; writes a shadow ray to one of the lights with what it would bring (added by
// compact.cl), the path's next ray, or its end, and the throughput. One work-item per place in the queue; a ray of length 0
// is no ray. `path` is whose place it is; only radiance is kept by path, since of the counts of rays only sums are wanted.
//
// Lights with an extent are found by both rays; the power heuristic weighs the two (Veach 1997, section 9.2): `density` is
// with which the path's last direction was chosen. From the bounce `roulette` on, a path goes on with the probability of its
// throughput's largest component; where `is_last`, none does. Without `own_light` what the rays found themselves is left out.
//
// Defines: HAS_EMISSION (something to be found by rays), HAS_DIRECT (something to send shadow rays to), SOBOL, and those of
// surface.cl, bsdf.cl and emitters.cl.

#include "common/sampler.cl"
#include "pathtrace/dimensions.cl"
#include "pathtrace/queue.cl"
#include "pathtrace/vertex.cl"

__kernel void shade(
    __global const Emitter *emitter_list,  // (emitters) or null
    __global const float *shares,          // (emitters) or null
    __global const float *positions,       // (vertices, 3)
    __global const uint *triangles,        // (triangles, 3)
    __global const float *normals,         // (vertices, 3) or null
    __global const float *uvs,             // (vertices, 2) or null
    __global const Instance *instances,    // (instances)
    __global const uint *material,         // (triangles)
    __global const Material *materials,    // (materials)
    __global const TextureUse *uses,       // (uses) or null
    __global const Texture *textures,      // (textures) or null
    __global const uint *texels,           // (texels) or null
    __global const float *srgb,            // (256) or null
    __global const float *sky,             // (sky_size, 3)
    __global const float *sky_rows,        // (sky_height) or null
    __global const float *sky_columns,     // (sky_size) or null
    __global const float *sky_density,     // (sky_size) or null
    __global const float *sky_edges,       // (sky_edges) or null
    __global const uint *alive,            // (chunks)
    __global const uint *path,             // (n)
    __global const uint *pixel,            // (n)
    __global const float *hit_t,           // (n)
    __global const float *hit_uv,          // (2, n)
    __global const uint *hit_primitive,    // (n)
    __global const uint *hit_instance,     // (n)
    __global const float *graph_value,     // (channels, n) or null
    __global float *cone,                  // (2, n) or null
    __global float *ray_origin,            // (3, n)
    __global float *ray_direction,         // (3, n)
    __global float *ray_length,            // (n)
    __global float *throughput,            // (3, n)
    __global float *density,               // (n) or null
    __global float *radiance,              // (3, n)
    __global float *shadow_origin,         // (3, n) or null
    __global float *shadow_direction,      // (3, n) or null
    __global float *shadow_length,         // (n) or null
    __global float *shadow_radiance,       // (3, n) or null
    __global uint *ray_counts,             // (2, n)
    Environment environment,
    uint n,
    uint emitters,
    uint vertex,
    uint roulette,
    uint is_last,
    uint own_light,
    uint sample,
    uint key0,
    uint key1)
{
    LEAVE_IDLE_GROUP(alive, n);
    uint i = place_in_queue();
    if (i >= n) goto together;
    bool has_ray = ray_length[i] > 0.0f, missed = hit_instance[i] == NONE;
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Sky far = { environment, sky, sky_rows, sky_columns, sky_density, sky_edges };
    Vec3 direction = load_vec3(ray_direction, n, i), carried = load_vec3(throughput, n, i);
    float cone_width = 0.0f, cone_spread = 0.0f, t = hit_t[i];
#if HAS_TEXTURES
    cone_width = cone[i];
    cone_spread = cone[n + i];
#endif
    uint number = missed ? 0 : hit_instance[i], primitive = missed ? 0 : hit_primitive[i];
    float u = missed ? 0.0f : hit_uv[i], v = missed ? 0.0f : hit_uv[n + i];
    GraphValues graph = { graph_value, n, i };
    Surface surface = find_surface(&scene, number, primitive, u, v, t, direction, cone_width, cone_spread, &graph);
    __global const Material *m = materials + surface.material;

#if HAS_EMISSION
    Vec3 found = mul3(carried, found_light(&surface, &far, m, missed, t, direction, density[i]));
    if (has_ray && own_light) store_planes(radiance, n, path[i], add3(load_vec3(radiance, n, path[i]), found));
#endif

    uint place = pixel[path[i]];
    Random random = sample4(place, sample, DIMENSION_VERTEX + 2 * vertex, key0, key1);
    Vertex frame = make_vertex(&surface, direction);
    Bsdf bsdf = make_bsdf(&surface, m);

#if HAS_DIRECT
    Emitters lights = { emitter_list, shares, emitters, masks, far };
    Random where = sample4(place, sample, DIMENSION_VERTEX + 2 * vertex + 1, key0, key1);
    DirectLight direct = sample_direct(&lights, &surface, &bsdf, &frame, where);
    Vec3 brought = scale3(direct.weight, mul3(mul3(carried, direct.reflected), direct.radiance));
    float most = max_component(brought);
    bool lit = !missed && direct.is_possible && most > 0.0f && most < INFINITY;
    store_planes(shadow_origin, n, i, direct.origin);
    store_planes(shadow_direction, n, i, direct.direction);
    shadow_length[i] = lit ? direct.length : 0.0f;
    store_planes(shadow_radiance, n, i, brought);
    ray_counts[n + i] += lit ? 1 : 0;
#endif

    Onwards next = scatter(&surface, &bsdf, &frame, random);
    Vec3 kept = mul3(carried, next.weight);
    float part = max_component(kept), survival = vertex + 1 >= roulette ? fmin(part, 1.0f) : 1.0f;
    bool goes_on = !missed && !is_last && next.is_possible && part > 0.0f && random.z < survival;
    store_planes(ray_origin, n, i, next.origin);
    store_planes(ray_direction, n, i, next.direction);
    store_planes(throughput, n, i, scale3(1.0f / survival, kept));
    ray_length[i] = goes_on ? INFINITY : 0.0f;
    ray_counts[i] += goes_on ? 1 : 0;
#if HAS_EMISSION
    density[i] = next.density;
#endif
#if HAS_TEXTURES
    cone[i] = surface.cone_width;
    cone[n + i] = surface.cone_spread + rough_spread(alpha_of(&surface, next.density));
#endif
together:
    LEAVE_TOGETHER;
}

// The end of every path: add what the last rays found.
__kernel void finish(
    __global const float *positions,          // (vertices, 3)
    __global const uint *triangles,           // (triangles, 3)
    __global const float *normals,            // (vertices, 3) or null
    __global const float *uvs,                // (vertices, 2) or null
    __global const Instance *instances,       // (instances)
    __global const uint *material,            // (triangles)
    __global const Material *materials,       // (materials)
    __global const TextureUse *uses,          // (uses) or null
    __global const Texture *textures,         // (textures) or null
    __global const uint *texels,              // (texels) or null
    __global const float *srgb,               // (256) or null
    __global const float *sky,                // (sky_size, 3)
    __global const float *sky_rows,           // (sky_height) or null
    __global const float *sky_columns,        // (sky_size) or null
    __global const float *sky_density,        // (sky_size) or null
    __global const float *sky_edges,          // (sky_edges) or null
    __global const uint *alive,               // (chunks)
    __global const uint *path,                // (n)
    __global const float *hit_t,              // (n)
    __global const float *hit_uv,             // (2, n)
    __global const uint *hit_primitive,       // (n)
    __global const uint *hit_instance,        // (n)
    __global const float *graph_value,        // (channels, n) or null
    __global const float *cone,               // (2, n) or null
    __global const float *ray_direction,      // (3, n)
    __global const float *ray_length,         // (n)
    __global const float *throughput,         // (3, n)
    __global const float *density,            // (n) or null
    __global float *radiance,                 // (3, n)
    Environment environment,
    uint n)
{
    LEAVE_IDLE_GROUP(alive, n);
    uint i = place_in_queue();
    if (i >= n) goto together;
    bool has_ray = ray_length[i] > 0.0f, missed = hit_instance[i] == NONE;
    Sky far = { environment, sky, sky_rows, sky_columns, sky_density, sky_edges };
    Vec3 direction = load_vec3(ray_direction, n, i);
    float t = hit_t[i];
    Surface surface;
    surface.material = 0;
#if HAS_EMISSIVE
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    float cone_width = 0.0f, cone_spread = 0.0f;
#if HAS_TEXTURES
    cone_width = cone[i];
    cone_spread = cone[n + i];
#endif
    uint number = missed ? 0 : hit_instance[i], primitive = missed ? 0 : hit_primitive[i];
    float u = missed ? 0.0f : hit_uv[i], v = missed ? 0.0f : hit_uv[n + i];
    GraphValues graph = { graph_value, n, i };
    surface = find_surface(&scene, number, primitive, u, v, t, direction, cone_width, cone_spread, &graph);
#endif
    Vec3 found = found_light(&surface, &far, materials + surface.material, missed, t, direction, density[i]);
    found = mul3(load_vec3(throughput, n, i), found);
    if (has_ray) store_planes(radiance, n, path[i], add3(load_vec3(radiance, n, path[i]), found));
together:
    LEAVE_TOGETHER;
}

// Sum albedos and normals of the first hits over the samples; nothing where there is no hit.
__kernel void first_hits(
    __global const float *positions,      // (vertices, 3)
    __global const uint *triangles,       // (triangles, 3)
    __global const float *normals,        // (vertices, 3) or null
    __global const float *uvs,            // (vertices, 2) or null
    __global const Instance *instances,   // (instances)
    __global const uint *material,        // (triangles)
    __global const Material *materials,   // (materials)
    __global const TextureUse *uses,      // (uses) or null
    __global const Texture *textures,     // (textures) or null
    __global const uint *texels,          // (texels) or null
    __global const float *srgb,           // (256) or null
    __global const float *hit_t,          // (n)
    __global const float *hit_uv,         // (2, n)
    __global const uint *hit_primitive,   // (n)
    __global const uint *hit_instance,    // (n)
    __global const float *graph_value,    // (channels, n) or null
    __global const float *cone,           // (2, n) or null
    __global const float *ray_direction,  // (3, n)
    __global float *albedo_sum,           // (3, n)
    __global float *N_sum,                // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    bool missed = hit_instance[i] == NONE;
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    float cone_width = 0.0f, cone_spread = 0.0f;
#if HAS_TEXTURES
    cone_width = cone[i];
    cone_spread = cone[n + i];
#endif
    uint number = missed ? 0 : hit_instance[i], primitive = missed ? 0 : hit_primitive[i];
    float u = missed ? 0.0f : hit_uv[i], v = missed ? 0.0f : hit_uv[n + i];
    Vec3 direction = load_vec3(ray_direction, n, i);
    GraphValues graph = { graph_value, n, i };
    Surface surface = find_surface(&scene, number, primitive, u, v, hit_t[i], direction, cone_width, cone_spread, &graph);
    store_planes(albedo_sum, n, i, add3(load_vec3(albedo_sum, n, i), either3(missed, all3(0.0f), surface.albedo)));
    store_planes(N_sum, n, i, add3(load_vec3(N_sum, n, i), either3(missed, all3(0.0f), surface.shading_normal)));
}
