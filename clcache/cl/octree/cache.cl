// One vertex of every path that fills the cache (HashCache, section 3.2, Eq. 1).
//
// Each of the first STORE vertices of a path, where its surface has a diffuse part, gets the light of the path's next vertices,
// up to `bounces` further ones: what arrives there, weighted by the cosine and divided by pi, as if the surface were white and
// nothing were reflected at its interface. With E_j of a vertex j, L_i the light that a vertex i reflects directly, T the
// weights of the scattered rays and W_j that of j's diffuse lobe alone,
//
//   E_j = sum over i = j .. j + bounces of L_i W_j T_{j+1} ... T_{i-1}
//
// which is Eq. 1 with W_j for T_j / C_j: surfaces here may have more than one lobe. `carried` is the product so far.
//
// `shade_vertex` makes shadow rays and next rays, like pathtrace/shade.cl, and says what the vertex itself contributes;
// `settle`, behind the shadow rays, adds that to one of the vertices before.
//
// Defines: STORE; HAS_EMISSION, HAS_DIRECT, HAS_TEXTURES, SOBOL, those of surface.cl, bsdf.cl and emitters.cl.

// The diffuse part's light is kept as if there were no other: it is sampled well even where the interface takes most, seen at a
// flat angle.
#define LEAST_DIFFUSE_CHANCE 0.5f

#include "common/sampler.cl"
#include "octree/ask.cl"
#include "octree/cell.cl"
#include "octree/dimensions.cl"
#include "octree/shape.cl"
#include "pathtrace/queue.cl"
#include "pathtrace/vertex.cl"

// One work-item per place in the queue.
__kernel void shade_vertex(
    __global const Emitter *emitter_list,  // (emitters) or null
    __global const float *shares,          // (emitters) or null
    __global const float *positions,       // (vertices, 3)
    __global const uint *triangles,        // (triangles, 3)
    __global const float *normals,         // (vertices, 3) or null
    __global const float *uvs,             // (vertices, 2) or null
    __global const Instance *instances,    // (instances)
    __global const uchar *is_static,       // (instances)
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
    __global float *density,               // (n) or null
    __global float *shadow_origin,         // (3, n) or null
    __global float *shadow_direction,      // (3, n) or null
    __global float *shadow_length,         // (n) or null
    __global float *shadow_radiance,       // (3, n) or null
    __global float *shadow_light,          // (3, n) or null
    __global float *found,                 // (3, n)
    __global float *step,                  // (3, n)
    __global float *step_diffuse,          // (n)
    __global ulong *vertex_key,            // (stored)
    __global uint *vertex_normal,          // (stored)
    __global uint *ray_counts,             // (2, n)
    Environment environment,
    OctreeShape shape,
    uint n,
    uint emitters,
    uint vertex,
    uint roulette,
    uint is_last,
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
    Vec3 direction = load_vec3(ray_direction, n, i);
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

    Vec3 light = all3(0.0f);
#if HAS_EMISSION
    light = found_light(&surface, &far, m, missed, t, direction, density[i]);
#endif
    store_planes(found, n, i, either3(has_ray, light, all3(0.0f)));

    uint place = pixel[path[i]];
    Random random = sample4(place, sample, DIMENSION_VERTEX + 2 * vertex, key0, key1);
    Vertex frame = make_vertex(&surface, direction);
    Bsdf bsdf = make_bsdf(&surface, m);
    bool has_diffuse = has_ray && !missed && max_component(bsdf.diffuse) > 0.0f, is_stored = has_diffuse && vertex < STORE;
    is_stored = is_stored && is_static[number] != 0 && is_in_cube(&shape, surface.point);
    uint at = min(vertex, STORE - 1u) * n + path[i];
    ulong key = cell_key(&shape, surface.point, shape.finest);
    if (is_stored) vertex_key[at] = key;
    if (is_stored) vertex_normal[at] = pack_normal(surface.geometric_normal);

#if HAS_DIRECT
    Emitters lights = { emitter_list, shares, emitters, masks, far };
    Random where = sample4(place, sample, DIMENSION_VERTEX + 2 * vertex + 1, key0, key1);
    DirectLight direct = sample_direct(&lights, &surface, &bsdf, &frame, where);
    Vec3 arriving = scale3(direct.weight, direct.radiance), brought = mul3(direct.reflected, arriving);
    Vec3 diffused = scale3(has_diffuse ? fmax(direct.cosine, 0.0f) * ONE_OVER_PI : 0.0f, arriving);
    float most = fmax(max_component(brought), max_component(diffused));
    bool lit = has_ray && !missed && direct.is_possible && most > 0.0f && most < INFINITY;
    store_planes(shadow_origin, n, i, direct.origin);
    store_planes(shadow_direction, n, i, direct.direction);
    shadow_length[i] = lit ? direct.length : 0.0f;
    store_planes(shadow_radiance, n, i, brought);
    store_planes(shadow_light, n, i, diffused);
    ray_counts[n + i] += lit ? 1 : 0;
#endif

    Onwards next = scatter(&surface, &bsdf, &frame, random);
    bool is_diffuse = has_diffuse && next.cosine > 0.0f && next.density >= LEAST_DENSITY && next.density < INFINITY;
    float weight_diffuse = is_diffuse ? next.cosine * ONE_OVER_PI / next.density : 0.0f;
    // What ends a path is the local weight: each vertex counts by itself, however little of its light the eye gets.
    float part = fmax(max_component(next.weight), is_stored ? weight_diffuse : 0.0f);
    float survival = vertex + 1 >= roulette ? fmin(part, 1.0f) : 1.0f;
    bool goes_on = has_ray && !missed && !is_last && next.is_possible && part > 0.0f && random.z < survival;
    store_planes(ray_origin, n, i, next.origin);
    store_planes(ray_direction, n, i, next.direction);
    store_planes(step, n, i, either3(goes_on, scale3(1.0f / survival, next.weight), all3(0.0f)));
    step_diffuse[i] = goes_on ? weight_diffuse / survival : 0.0f;
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

// What the vertex that has just been shaded brings to the path's vertex number `to`: the light that the ray found there, which
// the vertex before it reflects directly, and what it reflects itself. One work-item per place in the queue. takes_found,
// takes_own: whether it is within the bounces; is_own: whether it is the same vertex.
__kernel void settle(
    __global const uint *alive,             // (chunks)
    __global const uint *path,              // (n)
    __global const uchar *occluded,         // (n) or null
    __global const float *shadow_length,    // (n) or null
    __global const float *shadow_radiance,  // (3, n) or null
    __global const float *shadow_light,     // (3, n) or null
    __global const float *found,            // (3, n)
    __global const float *step,             // (3, n)
    __global const float *step_diffuse,     // (n)
    __global float *vertex_light,           // (3, stored)
    __global float *carried,                // (3, stored)
    uint n,
    uint stored,
    uint to,
    uint is_own,
    uint takes_found,
    uint takes_own)
{
    LEAVE_IDLE_GROUP(alive, n);
    uint i = place_in_queue();
    if (i >= n) goto together;
    bool is_there = i % CHUNK < alive[i / CHUNK];
    uint at = to * n + (is_there ? path[i] : 0);
    Vec3 light = load_vec3(vertex_light, stored, at), product = load_vec3(carried, stored, at);
    Vec3 own = all3(0.0f), here = own, arriving = load_vec3(found, n, i);
#if HAS_DIRECT
    bool is_lit = shadow_length[i] > 0.0f && !occluded[i];
    own = either3(is_lit, load_vec3(shadow_radiance, n, i), own);
    here = either3(is_lit, load_vec3(shadow_light, n, i), here);
#endif
    Vec3 taken = add3(either3(takes_found, arriving, all3(0.0f)), either3(takes_own, own, all3(0.0f)));
    light = either3(is_own, here, add3(light, mul3(product, taken)));
    product = either3(is_own, all3(step_diffuse[i]), mul3(product, load_vec3(step, n, i)));
    if (is_there) store_planes(vertex_light, stored, at, light);
    if (is_there) store_planes(carried, stored, at, product);
together:
    LEAVE_TOGETHER;
}

// Behind the last ray: what it found, as `found` of `settle`. One work-item per place in the queue.
__kernel void find_last(
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
    __global const float *sky,            // (sky_size, 3)
    __global const float *sky_rows,       // (sky_height) or null
    __global const float *sky_columns,    // (sky_size) or null
    __global const float *sky_density,    // (sky_size) or null
    __global const float *sky_edges,      // (sky_edges) or null
    __global const uint *alive,           // (chunks)
    __global const float *hit_t,          // (n)
    __global const float *hit_uv,         // (2, n)
    __global const uint *hit_primitive,   // (n)
    __global const uint *hit_instance,    // (n)
    __global const float *graph_value,    // (channels, n) or null
    __global const float *cone,           // (2, n) or null
    __global const float *ray_direction,  // (3, n)
    __global const float *ray_length,     // (n)
    __global const float *density,        // (n) or null
    __global float *shadow_length,        // (n) or null
    __global float *found,                // (3, n)
    Environment environment,
    uint n)
{
    LEAVE_IDLE_GROUP(alive, n);
    uint i = place_in_queue();
    if (i >= n) goto together;
    Vec3 light = all3(0.0f);
#if HAS_EMISSION
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
    light = found_light(&surface, &far, materials + surface.material, missed, t, direction, density[i]);
    light = either3(has_ray, light, all3(0.0f));
#endif
#if HAS_DIRECT
    shadow_length[i] = 0.0f;  // no light of its own
#endif
    store_planes(found, n, i, light);
together:
    LEAVE_TOGETHER;
}
