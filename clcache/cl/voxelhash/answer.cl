// What was traced goes into the voxels, and what voxels know to the samples (SampleCache, section 4). Radiance is without the first
// hit's albedo throughout (albedo.cl), and without what it shines with itself: a lamp would light all that shares a voxel with it.
//
// Defines: INHERIT: new voxels start from what look_up.cl found; those of ask.cl.

#include "samplecache/groups.cl"
#include "samplecache/places.cl"
#include "samplecache/radiance.cl"
#include "scene/environment.cl"
#include "voxelhash/ask.cl"

#define MOST_VALUES 65535.0f  // above these float32's mean would not move any more

// So many stamps a pixel's own light, of a sample that has no voxel, stands for such samples of the pixel: as long as it takes until each
// of a few samples has had its turn.
#define OWN_LIFETIME 16

// A parent, of which four voxels of a surface have a part, stands in for a voxel that has few values. Its values count in full beside one
// that has none, half beside one that has so many, and less and less from there on.
#define ENOUGH 16.0f

// One work-item per entry of the list of what was traced: what its path brought goes to its sample's voxel: L += (new - L) part, where the part of a new value is
// 1 / (count + 1), but no less than the surface's least, or a fixed one. Without a voxel it is the pixel's own, for this update.
// What is not finite is left out.
__kernel void update_voxels(
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
    __global const uint *shaded,          // (pixels)
    __global const uint *stream,          // (pixels)
    __global const uint *shaded_voxel,    // (pixels)
    __global const float *radiance,       // (3, n)
    __global const float *graph_value,    // (channels, n) or null
    __global const float *voxel_start,    // (pixels, 4) or null
    __global float *voxel_radiance,       // (capacity, 4)
    __global uint *own_light,             // (pixels, 4)
    Camera camera,
    float fixed_part,
    uint stamp,
    uint n,
    uint first,
    uint entries)
{
    uint entry = get_global_id(0);
    if (entry >= entries) return;
    uint i = place_of_entry(entry, n);
    FirstHit hit = load_first_hit(first_hit, shaded[first + entry]);
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    GraphValues graph = { graph_value, n, i };
    Vec3 direction;
    float t;
    Surface surface = surface_of(&scene, &camera, hit, &graph, &direction, &t);
    Vec3 divisor = modulation(&surface), brought = load_vec3(radiance, n, i);
    brought = vec3(brought.x / divisor.x, brought.y / divisor.y, brought.z / divisor.z);
    bool is_finite = fabs(brought.x + brought.y + brought.z) < INFINITY;
    uint voxel = shaded_voxel[first + entry];
    bool has_voxel = voxel != NONE;
    __global uint *words = own_light + words_of(stream[first + entry]);
    if (is_finite && !has_voxel) words[0] = as_uint(brought.x);
    if (is_finite && !has_voxel) words[1] = as_uint(brought.y);
    if (is_finite && !has_voxel) words[2] = as_uint(brought.z);
    if (is_finite && !has_voxel) words[3] = stamp;
    __global float *known = voxel_radiance + words_of(has_voxel ? voxel : 0);
    Vec3 before = vec3(has_voxel ? known[0] : 0.0f, has_voxel ? known[1] : 0.0f, has_voxel ? known[2] : 0.0f);
    float count = has_voxel ? known[3] : 0.0f;
    bool is_new = has_voxel && !(count > 0.0f);
#if INHERIT
    __global const float *start = voxel_start + words_of(first + entry);
    before = either3(is_new, load3(start), before);
    count = is_new ? start[3] : count;
#else
    before = either3(is_new, all3(0.0f), before);
#endif
    __global const Material *m = materials + unpack_material(hit);
    float least = fixed_part > 0.0f ? fixed_part : least_part(surface.metallic, surface.roughness, tinted_specular(&surface), m);
    Vec3 after = add3(before, scale3(fmax(1.0f / (count + 1.0f), least), sub3(brought, before)));
    float counted = count * least < 1.0f ? fmin(count + 1.0f, MOST_VALUES) : count;
    if (is_finite && has_voxel) known[0] = after.x;
    if (is_finite && has_voxel) known[1] = after.y;
    if (is_finite && has_voxel) known[2] = after.z;
    if (is_finite && has_voxel) known[3] = counted;
}

// What is known of a sample: the mean of `count` values.
typedef struct Known {
    Vec3 light;
    float count;
} Known;

INLINED Known known_by(__global const float *voxel_radiance, uint entry)
{
    bool is_there = entry != NONE;
    __global const float *row = voxel_radiance + words_of(is_there ? entry : 0);
    Known known = { load3(row), is_there ? row[3] : 0.0f };
    return known;
}

// What a pixel's own paths brought lately, if there were any.
INLINED Known known_by_itself(__global const uint *own_light, uint pixel, uint stamp)
{
    __global const uint *words = own_light + words_of(pixel);
    bool is_there = words[3] != 0 && stamp - words[3] <= OWN_LIFETIME;
    Known known = { vec3(as_float(words[0]), as_float(words[1]), as_float(words[2])), is_there ? 1.0f : 0.0f };
    return known;
}

// The list of visible samples as it is resolved (reconstruct.cl).
typedef struct Resolved {
    __global float *value;   // (3, n): the sample's light, before it is answered its own alone
    __global float *weight;  // (n): FAR: the background. Else, before it is answered, 1 if it shines by itself
    __global float *albedo;  // (3, n)
    __global float *count;   // (n)
    uint n;
} Resolved;

// Before a sample is answered.
INLINED void begin_answer(const Resolved *resolved, uint i, const Sky *sky, FirstHit hit, bool is_far, const Surface *surface)
{
    Vec3 own = all3(0.0f);
#if HAS_EMISSIVE
    own = surface->emitted;
#endif
    Vec3 far = sky_radiance(sky, either3(is_far, unpack_direction(hit), vec3(0.0f, 1.0f, 0.0f)));
    store_planes(resolved->value, resolved->n, i, either3(is_far, far, own));
    store_planes(resolved->albedo, resolved->n, i, either3(is_far, all3(0.0f), modulation(surface)));
    resolved->weight[i] = is_far ? FAR : max_component(own) > 0.0f ? 1.0f : 0.0f;
}

// What voxels know of it, or, where it has none, the pixel by itself. All that is known weighs nearly alike, as a box filter would have it.
// What shines does not fill the gaps of its neighbours.
INLINED void finish_answer(const Resolved *resolved, uint i, bool has_voxel, Known known, Known own)
{
    bool is_far = resolved->weight[i] == FAR, shines = resolved->weight[i] > 0.0f, is_own = !has_voxel && own.count > 0.0f;
    Vec3 albedo = load_vec3(resolved->albedo, resolved->n, i), alone = load_vec3(resolved->value, resolved->n, i);
    float count = has_voxel ? known.count : own.count;
    Vec3 light = either3(count > 0.0f, either3(is_own, own.light, known.light), all3(0.0f));
    store_planes(resolved->value, resolved->n, i, add3(alone, mul3(albedo, light)));
    resolved->weight[i] = is_far ? FAR : shines || is_own ? 1.0f : count / (count + 1.0f);
    store_planes(resolved->albedo, resolved->n, i, either3(shines, all3(0.0f), albedo));
    resolved->count[i] = count;
}

// One work-item per entry of the list of visible samples, each pixel's only one: the voxel that it asked answers.
__kernel void answer_asked(
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
    __global const uint *first_hit,        // (slots, pixels, 4)
    __global const uint *samples,          // (capacity)
    __global const float *graph_value,    // (channels, n) or null
    __global const uint *voxel,            // (pixels)
    __global const float *voxel_radiance,  // (places, 4)
    __global const uint *own_light,        // (pixels, 4)
    __global float *sample_value,          // (3, n)
    __global float *sample_weight,         // (n)
    __global float *sample_albedo,         // (3, n)
    __global float *answer_count,          // (n)
    Environment environment,
    Camera camera,
    uint stamp,
    uint n,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    uint sample = samples[first + i];
    bool is_there = sample != NONE;
    sample = is_there ? sample : 0;
    FirstHit hit = load_first_hit(first_hit, sample);
    bool is_far = is_background(hit) || !is_there;
    FirstHit near = { hit.x, hit.y, is_far ? 0 : hit.z, is_far ? 0 : hit.w };
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Sky far = { environment, sky, sky_rows, sky_columns, sky_density, sky_edges };
    GraphValues graph = { graph_value, n, i };
    Vec3 direction;
    float t;
    Surface surface = surface_of(&scene, &camera, near, &graph, &direction, &t);
    Resolved resolved = { sample_value, sample_weight, sample_albedo, answer_count, n };
    begin_answer(&resolved, i, &far, hit, is_far, &surface);
    uint entry = is_far ? NONE : voxel[sample];
    finish_answer(&resolved, i, entry != NONE, known_by(voxel_radiance, entry), known_by_itself(own_light, sample, stamp));
}

// One work-item per entry of the list of visible samples: where each one's voxel and that one's parent are to be found.
__kernel void address_seen(
    __global const float *positions,     // (vertices, 3)
    __global const uint *triangles,      // (triangles, 3)
    __global const float *normals,       // (vertices, 3) or null
    __global const float *uvs,           // (vertices, 2) or null
    __global const Instance *instances,  // (instances)
    __global const uint *material,       // (triangles)
    __global const Material *materials,  // (materials)
    __global const TextureUse *uses,     // (uses) or null
    __global const Texture *textures,    // (textures) or null
    __global const uint *texels,         // (texels) or null
    __global const float *srgb,          // (256) or null
    __global const float *sky,           // (sky_size, 3)
    __global const float *sky_rows,      // (sky_height) or null
    __global const float *sky_columns,   // (sky_size) or null
    __global const float *sky_density,   // (sky_size) or null
    __global const float *sky_edges,     // (sky_edges) or null
    __global const uint *first_hit,      // (slots, pixels, 4)
    __global const uint *samples,        // (capacity)
    __global const float *graph_value,    // (channels, n) or null
    __global uint *seen_place,           // (2, n)
    __global uint *seen_check,           // (2, n)
    __global float *sample_value,        // (3, n)
    __global float *sample_weight,       // (n)
    __global float *sample_albedo,       // (3, n)
    Environment environment,
    Camera camera,
    float factor,
    uint blocks,
    uint n,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    uint sample = samples[first + i];
    bool is_there = sample != NONE;
    FirstHit hit = load_first_hit(first_hit, is_there ? sample : 0);
    bool is_far = is_background(hit) || !is_there;
    FirstHit near = { hit.x, hit.y, is_far ? 0 : hit.z, is_far ? 0 : hit.w };
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Sky far = { environment, sky, sky_rows, sky_columns, sky_density, sky_edges };
    GraphValues graph = { graph_value, n, i };
    Vec3 direction;
    float t;
    Surface surface = surface_of(&scene, &camera, near, &graph, &direction, &t);
    Resolved resolved = { sample_value, sample_weight, sample_albedo, 0, n };
    begin_answer(&resolved, i, &far, hit, is_far, &surface);
    Geometry geometry = { positions, triangles, instances };
    Seen seen = seen_point(&geometry, &camera, near);
    int level = level_at(&camera, seen.point, seen.normal, factor);
    bool has_none = is_far || follows_view(&surface, materials + surface.material);
    uint dark = dark_of(&surface);
    Voxel voxel = voxel_at(seen.point, seen.normal, level, dark, blocks);
    Voxel parent = voxel_at(seen.point, seen.normal, level + 1, dark, blocks);
    seen_place[i] = has_none || is_too_near(&seen, level) ? NONE : voxel.place;
    seen_place[n + i] = has_none || is_too_near(&seen, level + 1) ? NONE : parent.place;
    seen_check[i] = voxel.check;
    seen_check[n + i] = parent.check;
}

// One work-item per run of these: their entries, in place of where to find them.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void find_seen(
    __global ulong *voxel_key,       // (capacity)
    __global uint *seen_place,       // (2, n)
    __global const uint *seen_check, // (2, n)
    uint capacity,
    uint probe,
    uint stamp,
    int lifetime,
    uint n,
    uint entries)
{
    uint begin = get_global_id(0) * RUN, end = min(begin + RUN, entries);
    if (begin >= entries) return;
    Table table = { voxel_key, capacity, probe, stamp, lifetime };
    for (uint above = 0; above < 2; above++) {
        __global uint *places = seen_place + above * n;
        __global const uint *checks = seen_check + above * n;
#if defined(__has_builtin) && !defined(NO_PREFETCH)
        for (uint i = begin; i < end; i++)
            if (places[i] < capacity) __builtin_prefetch((__global const void *)(voxel_key + places[i]));
#endif
        for (uint i = begin; i < end; i++) {
            if (places[i] == NONE) continue;
            places[i] = find_entry(&table, places[i] < capacity ? places[i] : places[i] % capacity, checks[i]);
        }
    }
}

// One work-item per entry of the list of visible samples: voxel and parent answer together.
__kernel void answer_seen(
    __global const uint *samples,          // (capacity)
    __global const uint *seen_place,       // (2, n)
    __global const float *voxel_radiance,  // (places, 4)
    __global const uint *own_light,        // (pixels, 4)
    __global float *sample_value,          // (3, n)
    __global float *sample_weight,         // (n)
    __global float *sample_albedo,         // (3, n)
    __global float *answer_count,          // (n)
    uint stamp,
    uint pixels,
    uint n,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    uint sample = samples[first + i];
    Known voxel = known_by(voxel_radiance, seen_place[i]), parent = known_by(voxel_radiance, seen_place[n + i]);
    parent.count *= ENOUGH / (ENOUGH + voxel.count);
    float count = voxel.count + parent.count, of_parent = count > 0.0f ? parent.count / count : 0.0f;
    Known known = { mix3(either3(voxel.count > 0.0f, voxel.light, parent.light), parent.light, of_parent), count };
    int row, pixel;
    place_of_pixel(sample != NONE ? sample : 0, pixels, &row, &pixel);
    bool has_voxel = seen_place[i] != NONE || seen_place[n + i] != NONE;
    Resolved resolved = { sample_value, sample_weight, sample_albedo, answer_count, n };
    finish_answer(&resolved, i, has_voxel, known, known_by_itself(own_light, (uint)pixel, stamp));
}
