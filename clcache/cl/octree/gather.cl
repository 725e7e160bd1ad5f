// One vertex of every path that reads the cache: a layer of the image (HashCache, sections 3.3 and 3.4). The cell that the
// vertex lies in answers for the diffuse part of its surface, whatever the other parts are; these are sampled, and the path
// goes on by them alone. So each pixel has
//
//   L_i = C_i E_i + M_i + S_i + T_i L_{i+1}
//
// E: what the cell says; C: the diffuse albedo, less what the interface reflects; M: what the surface, or the sky, shines with;
// S: what the specular parts reflect of the lights that are sampled; T: the weight of the ray that goes on.
//
// Paths end by Russian roulette, after how much all this makes of the next layer's light in the pixel. Layers' buffers are
// planes over the pixels.
//
// Defines: JITTER, GATE; HAS_EMISSION, HAS_DIRECT, HAS_TEXTURES, SOBOL, those of surface.cl, bsdf.cl and emitters.cl.

#include "common/camera.cl"
#include "common/sampler.cl"
#include "octree/ask.cl"
#include "octree/cell.cl"
#include "octree/dimensions.cl"
#include "octree/shape.cl"
#include "pathtrace/queue.cl"
#include "pathtrace/vertex.cl"

#define CERTAIN 0.0625f      // part of a pixel's light from which on a ray is traced for certain: fewer are no bargain
#define DIAGONAL 1.7320508f  // of a cube

// The part of white uniform light that an interface of f0 = 0, f90 = 1 reflects towards `out`, of that which falls on a diffuse
// base: Schlick's term at the microfacets, weighted by the cosine (as bsdf.cl has it). A polynomial, off by at most 1.1e-5.
inline float interface_share(float cosine)
{
    return 0.02816558f + cosine * (-0.07988039f + cosine * (0.08654912f + cosine * (-0.043782f + cosine * 0.00903063f)));
}

// What diffuse light is multiplied by on its way out.
INLINED Vec3 diffuse_albedo(const Bsdf *bsdf, float cosine)
{
#if HAS_SPECULAR
    Vec3 reflected = add3(bsdf->f0, scale3(interface_share(cosine), sub3(all3(bsdf->f90), bsdf->f0)));
    return mul3(sub3(all3(1.0f), reflected), bsdf->diffuse);
#else
    return bsdf->diffuse;
#endif
}

// The level whose cells are closest to a footprint's width.
inline uint level_for(const OctreeShape *shape, float footprint)
{
    float cells = fmin(fmax(shape->size / footprint, 1.0f), 16777216.0f) * 1.41421356f;
    int level = (int)(as_uint(cells) >> 23) - 127;
    return (uint)clamp(level, 0, (int)shape->finest);
}

// The coarsest level that may answer: whose cells a ray of this length does not begin in (a gate against light from behind
// corners).
inline uint level_within(const OctreeShape *shape, float ray)
{
#if GATE
    float cells = fmin(fmax(DIAGONAL * shape->size / ray, 1.0f), 16777216.0f);
    return (uint)((int)(as_uint(cells) >> 23) - 126);
#else
    return 0;
#endif
}

// One work-item per place in the queue.
__kernel void gather(
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
    __global float *throughput,            // (3, n)
    __global float *density,               // (n) or null
    __global float *shadow_origin,         // (3, n) or null
    __global float *shadow_direction,      // (3, n) or null
    __global float *shadow_length,         // (n) or null
    __global float *shadow_radiance,       // (3, n) or null
    __global const float *depth_before,    // (pixels) or null
    __global float *segment_before,        // (pixels) or null
    __global float *layer_light,           // (3, pixels)
    __global float *layer_count,           // (pixels)
    __global float *layer_emitted,         // (3, pixels) or null
    __global float *layer_own,             // (3, pixels)
    __global float *layer_albedo,          // (3, pixels)
    __global float *layer_pass,            // (3, pixels)
    __global float *layer_normal,          // (3, pixels)
    __global float *layer_depth,           // (pixels)
    __global float *layer_roughness,       // (pixels)
    __global ulong *asked_key,             // (2, n)
    __global uint *asked_level,            // (n)
    __global uint *asked_normal,           // (n)
    __global float *asked_direction,       // (3, n)
    __global float *asked_cone,            // (2, n) or null
    __global uint *ray_counts,             // (2, n)
    Camera camera,
    Environment environment,
    OctreeShape shape,
    uint n,
    uint pixels,
    uint emitters,
    uint layer,
    uint is_last,
    float jitter,
    float factor,
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
    asked_cone[i] = cone_width;
    asked_cone[n + i] = cone_spread;
#endif
    uint number = missed ? 0 : hit_instance[i], primitive = missed ? 0 : hit_primitive[i];
    float u = missed ? 0.0f : hit_uv[i], v = missed ? 0.0f : hit_uv[n + i];
    GraphValues graph = { graph_value, n, i };
    Surface surface = find_surface(&scene, number, primitive, u, v, t, direction, cone_width, cone_spread, &graph);
    __global const Material *m = materials + surface.material;

    uint place = pixel[path[i]];
    bool is_there = has_ray && place != NONE;
    place = is_there ? place : 0;
#if HAS_EMISSION
    Vec3 emitted = found_light(&surface, &far, m, missed, t, direction, density[i]);
    if (is_there) store_planes(layer_emitted, pixels, place, emitted);
#endif
    Random random = sample4(place, sample, DIMENSION_LAYER + 2 * layer, key0, key1);
    Random aside = random4(place, sample, DIMENSION_ASK + layer, key0, key1);
    Vec3 ng = surface.geometric_normal, here = surface.point;
    Vertex frame = make_vertex(&surface, direction);
    Bsdf bsdf = make_bsdf(&surface, m);
    Vec3 albedo = either3(missed, all3(0.0f), diffuse_albedo(&bsdf, frame.out.z));
    bool asks = is_there && max_component(albedo) > 0.0f;

    // What is asked: a cell about as wide as the pixel is there, by the length of the whole path. The level is chosen once more
    // where jitter has led, which may be nearer or farther.
    float before = layer > 0 ? depth_before[place] : 0.0f, depth = before + t, spread = factor * pixel_spread(&camera);
    uint level = level_for(&shape, spread * depth);
    Vec3 asked = here;
#if JITTER
    Vec3 along, across;
    make_frame(ng, &along, &across);
    float reach = jitter * cell_edge(&shape, level);
    asked = add3(here, scale3(reach, add3(scale3(2.0f * aside.x - 1.0f, along), scale3(2.0f * aside.y - 1.0f, across))));
    Vec3 back = sub3(asked, sub3(here, scale3(t, direction)));
    level = level_for(&shape, spread * (before + sqrt(dot3(back, back))));
#endif
    uint least = level_within(&shape, t);
    bool is_cached = is_static[number] != 0 && least <= shape.finest && is_in_cube(&shape, here);
    asked_key[i] = cell_key(&shape, asked, shape.finest);
    asked_key[n + i] = cell_key(&shape, here, shape.finest);
    asked_level[i] = asks ? (is_cached ? max(level, least) | least << 8 : NO_LEVEL) : NONE;
    asked_normal[i] = pack_normal(ng);
    store_planes(asked_direction, n, i, direction);

    // The surface without its diffuse part.
    bsdf.diffuse = all3(0.0f);
#if HAS_SPECULAR && HAS_DIRECT
    Emitters lights = { emitter_list, shares, emitters, masks, far };
    Random where = sample4(place, sample, DIMENSION_LAYER + 2 * layer + 1, key0, key1);
    DirectLight direct = sample_direct(&lights, &surface, &bsdf, &frame, where);
    Vec3 brought = scale3(direct.weight, mul3(direct.reflected, direct.radiance));
    float most = max_component(brought);
    bool lit = is_there && !missed && direct.is_possible && most > 0.0f && most < INFINITY;
    store_planes(shadow_origin, n, i, direct.origin);
    store_planes(shadow_direction, n, i, direct.direction);
    shadow_length[i] = lit ? direct.length : 0.0f;
    store_planes(shadow_radiance, n, i, brought);
    ray_counts[n + i] += lit ? 1 : 0;
#endif

    Vec3 passed = all3(0.0f);
    bool goes_on = false;
#if HAS_SPECULAR
    Onwards next = scatter(&surface, &bsdf, &frame, random);
    Vec3 kept = mul3(carried, next.weight);
    float part = max_component(kept), survival = fmin(part * (1.0f / CERTAIN), 1.0f);
    goes_on = is_there && !missed && !is_last && next.is_possible && part > 0.0f && random.z < survival;
    passed = either3(goes_on, scale3(1.0f / survival, next.weight), all3(0.0f));
    store_planes(ray_origin, n, i, next.origin);
    store_planes(ray_direction, n, i, next.direction);
    store_planes(throughput, n, i, scale3(1.0f / survival, kept));
    ray_counts[i] += goes_on ? 1 : 0;
#if HAS_EMISSION
    density[i] = next.density;
#endif
#if HAS_TEXTURES
    cone[i] = surface.cone_width;
    cone[n + i] = surface.cone_spread + rough_spread(alpha_of(&surface, next.density));
#endif
#endif
    ray_length[i] = goes_on ? INFINITY : 0.0f;

    if (is_there) store_planes(layer_own, pixels, place, all3(0.0f));
    if (is_there) store_planes(layer_albedo, pixels, place, albedo);
    if (is_there) store_planes(layer_pass, pixels, place, passed);
    if (is_there) store_planes(layer_normal, pixels, place, either3(missed, negate3(direction), surface.shading_normal));
    if (is_there) store_planes(layer_light, pixels, place, all3(0.0f));
    if (is_there) layer_count[place] = 0.0f;
    if (is_there) layer_depth[place] = missed ? INFINITY : depth;
    if (is_there) layer_roughness[place] = missed ? 0.0f : surface.roughness;
    if (is_there && layer > 0) segment_before[place] = missed ? INFINITY : t;
together:
    LEAVE_TOGETHER;
}

// What the shadow rays let through. One work-item per place in the queue.
__kernel void add_own(
    __global const uint *alive,             // (chunks)
    __global const uint *path,              // (n)
    __global const uint *pixel,             // (n)
    __global const uchar *occluded,         // (n)
    __global const float *shadow_length,    // (n)
    __global const float *shadow_radiance,  // (3, n)
    __global float *layer_own,              // (3, pixels)
    uint n,
    uint pixels)
{
    LEAVE_IDLE_GROUP(alive, n);
    uint i = place_in_queue();
    if (i >= n) goto together;
    bool is_lit = i % CHUNK < alive[i / CHUNK] && shadow_length[i] > 0.0f && !occluded[i];
    uint place = is_lit ? pixel[path[i]] : 0;
    if (is_lit) store_planes(layer_own, pixels, place, add3(load_vec3(layer_own, pixels, place), load_vec3(shadow_radiance, n, i)));
together:
    LEAVE_TOGETHER;
}

// What the last rays found (cache.cl). One work-item per place in the queue.
__kernel void add_last(
    __global const uint *alive,        // (chunks)
    __global const uint *path,         // (n)
    __global const uint *pixel,        // (n)
    __global const float *found,       // (3, n)
    __global const float *layer_pass,  // (3, pixels)
    __global float *layer_own,         // (3, pixels)
    uint n,
    uint pixels)
{
    LEAVE_IDLE_GROUP(alive, n);
    uint i = place_in_queue();
    if (i >= n) goto together;
    bool is_there = i % CHUNK < alive[i / CHUNK];
    uint place = is_there ? pixel[path[i]] : 0;
    is_there = is_there && place != NONE;
    place = is_there ? place : 0;
    Vec3 brought = mul3(load_vec3(layer_pass, pixels, place), load_vec3(found, n, i));
    if (is_there) store_planes(layer_own, pixels, place, add3(load_vec3(layer_own, pixels, place), brought));
together:
    LEAVE_TOGETHER;
}
