// From cached first hits to the path tracer's queue and back (SampleCache, section 3.3): a list of samples is worked off in batches
// of as many as there are paths.
//
// Defines: DEMODULATE; those of surface.cl; HAS_EMISSION; HAS_DIRECT; HAS_TEXTURES.

#include "samplecache/albedo.cl"
#include "samplecache/least_part.cl"
#include "samplecache/places.cl"
#include "samplecache/radiance.cl"

// One work-item per path: its first hit is a sample's.
__kernel void begin_paths(
    __global const float *positions,     // (vertices, 3)
    __global const uint *triangles,      // (triangles, 3)
    __global const Instance *instances,  // (instances)
    __global const uint *first_hit,      // (slots, pixels, 4)
    __global const uint *shaded,         // (capacity)
    __global const uint *stream,         // (capacity)
    __global uint *path_stream,          // (n)
    __global float *ray_direction,       // (3, n)
    __global float *ray_length,          // (n)
    __global float *hit_t,               // (n)
    __global float *hit_uv,              // (2, n)
    __global uint *hit_primitive,        // (n)
    __global uint *hit_instance,         // (n)
    __global float *throughput,          // (3, n)
    __global float *radiance,            // (3, n)
    __global float *density,             // (n) or null
    __global float *cone,                // (2, n) or null
    __global float *shadow_length,       // (n) or null
    __global uint *path,                 // (n)
    __global uint *alive,                // (chunks)
    Camera camera,
    uint n,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint entry = entry_of_place(i, n);
    uint sample = entry < entries ? shaded[first + entry] : 0;
    FirstHit hit = load_first_hit(first_hit, sample);
    bool is_there = entry < entries && !is_background(hit);  // which single-pass reprojection may have mixed up
    hit.w = is_there ? hit.w : 0;
    hit.z = is_there ? hit.z : 0;
    Geometry geometry = { positions, triangles, instances };
    Vec3 towards = sub3(locate(&geometry, hit).point, eye_of(&camera)), direction = normalize3(towards);
    path_stream[i] = is_there ? stream[first + entry] : 0;
    store_planes(ray_direction, n, i, direction);
    ray_length[i] = is_there ? INFINITY : 0.0f;
    hit_t[i] = dot3(towards, direction);
    hit_uv[i] = unpack_u(hit);
    hit_uv[n + i] = unpack_v(hit);
    hit_primitive[i] = hit.z;
    hit_instance[i] = is_there ? hit.w : NONE;
    store_planes(throughput, n, i, all3(1.0f));
    store_planes(radiance, n, i, all3(0.0f));
    path[i] = i;
    if (i % CHUNK == 0) alive[i / CHUNK] = entries > entry ? min(min(CHUNK, n - i), entries - entry) : 0;
#if HAS_DIRECT
    shadow_length[i] = 0.0f;  // shading leaves places without a path as they are
#endif
#if HAS_EMISSION
    density[i] = INFINITY;
#endif
#if HAS_TEXTURES
    cone[i] = 0.0f;
    cone[n + i] = pixel_spread(&camera);
#endif
}

// One work-item per path: what it brought goes to its sample: L += (new - L) part, where the part of a new value is 1 / (count + 1),
// but no less than the surface's least (Appendix C), or fixed. The count stays where the part does. What is not finite is left out.
__kernel void accumulate(
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
    __global const uint *first_hit,       // (slots, pixels, 4)
    __global uint *shading,               // (slots, pixels, 4)
    __global const uint *shaded,          // (capacity)
    __global const float *radiance,       // (3, n)
    __global const float *graph_value,    // (channels, n) or null
    Camera camera,
    float fixed_part,
    uint n,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    uint entry = entry_of_place(i, n);
    if (i >= n || entry >= entries) return;
    uint sample = shaded[first + entry];
    FirstHit hit = load_first_hit(first_hit, sample);
    bool is_far = is_background(hit);
    hit.w = is_far ? 0 : hit.w;
    hit.z = is_far ? 0 : hit.z;
    __global const Material *m = materials + unpack_material(hit);
    Vec3 brought = load_vec3(radiance, n, i);
    float metallic = m->metallic, roughness = m->roughness;
    float specular = m->specular * max_component(load3(m->specular_color));
#if DEMODULATE || (HAS_SPECULAR && (HAS_METALLIC_ROUGHNESS_MAPS || HAS_GRAPHS))
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    GraphValues graph = { graph_value, n, i };
    Vec3 direction;
    float t;
    Surface surface = surface_of(&scene, &camera, hit, &graph, &direction, &t);
    metallic = surface.metallic;
    roughness = surface.roughness;
    specular = tinted_specular(&surface);
#endif
#if DEMODULATE
    Vec3 divisor = modulation(&surface);
    brought = vec3(brought.x / divisor.x, brought.y / divisor.y, brought.z / divisor.z);
#endif
    __global uint *words = shading + words_of(sample);
    uint counted = words[3] & 0xFFFFu;
    float least = fixed_part > 0.0f ? fixed_part : least_part(metallic, roughness, specular, m);
    float part = fmax(1.0f / (float)(int)(counted + 1), least);
    Vec3 before = vec3(as_float(words[0]), as_float(words[1]), as_float(words[2]));
    Vec3 after = add3(before, scale3(part, sub3(brought, before)));
    bool is_finite = !is_far && fabs(brought.x + brought.y + brought.z) < INFINITY;
    bool is_full = counted == MOST_COUNTED || (float)(int)counted * least >= 1.0f;
    words[0] = as_uint(is_finite ? after.x : before.x);
    words[1] = as_uint(is_finite ? after.y : before.y);
    words[2] = as_uint(is_finite ? after.z : before.z);
    words[3] += is_finite && !is_full ? 1 : 0;
}
