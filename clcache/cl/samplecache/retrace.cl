// Trace the samples of a list: rays from the eye towards the stored points, or anywhere in their pixel for new ones, and what
// their hits mean for the cache (SampleCache, section 3.2). A list is worked off in batches of as many entries as there are rays.
//
// Defines: SOBOL; those of mask.cl and environment.cl; HAS_RADIANCE; ISRT: slots are cells of the pixel, SUPER in a row.

#include "common/camera.cl"
#include "common/sampler.cl"
#include "pathtrace/dimensions.cl"
#include "scene/first_hit.cl"
#include "samplecache/groups.cl"
#include "samplecache/mask.cl"
#include "samplecache/places.cl"
#include "samplecache/radiance.cl"
#include "samplecache/sample.cl"
#include "scene/environment.cl"

// epsilon_0: a sample is visible if nothing is hit before this part of the way to it. Relative, so independent of the scene's scale.
#define NEARLY_THERE (1.0f - 1e-3f)

// Where in its pixel a new sample lies: as that of a path, of which there is one each update, so that samples that are made one
// after the other are well spread.
inline void place_in_pixel(uint slot, Random random, float *x, float *y)
{
#if ISRT
    *x = ((float)(int)(slot % SUPER) + random.x) / (float)SUPER;
    *y = ((float)(int)(slot / SUPER) + random.y) / (float)SUPER;
#else
    *x = random.x;
    *y = random.y;
#endif
}

// One work-item per ray. The direction is the vector to the stored point itself, so that the point is at t = 1 (van Antwerpen
// 2023).
__kernel void aim(
    __global const float *positions,     // (vertices, 3)
    __global const uint *triangles,      // (triangles, 3)
    __global const Instance *instances,  // (instances)
    __global const uint *first_hit,      // (slots, pixels, 4)
    __global const uint *samples,        // (capacity)
    __global float *ray_origin,          // (3, n)
    __global float *ray_direction,       // (3, n)
    __global float *ray_start,           // (n)
    __global float *ray_length,          // (n)
    Camera camera,
    uint n,
    uint pixels,
    uint first,
    uint entries,
    uint update,
    uint key0,
    uint key1)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint listed = entry_of_place(i, n);
    uint entry = listed < entries ? samples[first + listed] : NONE, sample = entry & ~NEW_SAMPLE;
    bool is_there = entry != NONE, is_new = (entry & NEW_SAMPLE) != 0;
    sample = is_there ? sample : 0;
    uint slot = (uint)(int)((float)(int)sample / (float)(int)pixels), here = sample - slot * pixels;
    slot = (int)here < 0 ? slot - 1 : slot;  // what rounding may have done
    slot = (int)here >= (int)pixels ? slot + 1 : slot;
    here = sample - slot * pixels;
    int row, column;
    place_of_pixel(here, camera.width, &row, &column);
    float x, y;
    place_in_pixel(slot, sample4(here, update, DIMENSION_PIXEL, key0, key1), &x, &y);
    Vec3 anywhere = through_pixel(&camera, (float)column + x, (float)row + y);

    FirstHit hit = load_first_hit(first_hit, sample);
    bool is_far = is_background(hit);
    hit.w = is_new || is_far ? 0 : hit.w;
    hit.z = is_new || is_far ? 0 : hit.z;
    Geometry geometry = { positions, triangles, instances };
    Vec3 eye = eye_of(&camera), far = unpack_direction(hit);
    Vec3 towards = either3(is_far, far, sub3(locate(&geometry, hit).point, eye));
    towards = either3(is_new, anywhere, towards);
    store_planes(ray_origin, n, i, eye);
    store_planes(ray_direction, n, i, towards);
    ray_start[i] = camera.near / dot3(forward_of(&camera), towards);
    ray_length[i] = !is_there ? 0.0f : is_new || is_far ? INFINITY : NEARLY_THERE;
}

// The cache, and what is needed to fill it.
typedef struct Cache {
    __global uint *first_hit;  // (slots, pixels, 4)
    __global uint *shading;    // (slots, pixels, 4)
    __global const uint *material;
    __global const Instance *instances;
    Sky sky;
} Cache;

// What rays found.
typedef struct Found {
    __global const float *direction;   // (3, n)
    __global const float *uv;          // (2, n)
    __global const uint *primitive;    // (n)
    __global const uint *instance;     // (n)
    uint n;
} Found;

// Put what ray i found into a slot.
inline void replace_sample(const Cache *cache, const Found *found, uint i, uint sample)
{
    uint instance = found->instance[i], primitive = found->primitive[i], state = 0;
    Vec3 light = all3(0.0f);
    if (instance == NONE) {
        Vec3 direction = normalize3(load_vec3(found->direction, found->n, i));
        store_first_hit(cache->first_hit, sample, pack_background(direction));
        light = sky_radiance(&cache->sky, direction);
        state = OF_BACKGROUND;
    } else {
        uint material = cache->material[cache->instances[instance].first_triangle + primitive];
        FirstHit hit = pack_first_hit(found->uv[i], found->uv[found->n + i], primitive, instance, material);
        store_first_hit(cache->first_hit, sample, hit);
    }
#if HAS_RADIANCE
    __global uint *words = cache->shading + words_of(sample);
    words[0] = as_uint(light.x);
    words[1] = as_uint(light.y);
    words[2] = as_uint(light.z);
    words[3] = state;
#endif
}

// One work-item per group; those whose part of the list is in this batch do something. A sample is visible if nothing stands
// before it. Where nothing visible is left in a pixel, what stands there takes the place of the first sample that failed. It does so,
// too, where a sample failed in what was taken for flat: all that stands before flat surroundings is new there, and makes an edge
// of them in the next frame. (In the paper it stays unseen until all samples of a pixel have failed, one by one.)
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void settle(
    __global const uint *material,       // (triangles)
    __global const Instance *instances,  // (instances)
    __global const float *sky,           // (sky_size, 3)
    __global const float *sky_rows,      // (sky_height) or null
    __global const float *sky_columns,   // (sky_size) or null
    __global const float *sky_density,   // (sky_size) or null
    __global const float *sky_edges,     // (sky_edges) or null
    __global const uchar *plan,          // (pixels) or null
    __global uint *mask,                 // (pixels, words)
    __global uint *first_hit,            // (slots, pixels, 4)
    __global uint *shading,              // (slots, pixels, 4) or null
    __global const uint *samples,        // (capacity)
    __global const uint *group_first,    // (groups)
    __global const uint *group_count,    // (groups)
    __global const float *ray_direction, // (3, n)
    __global const float *hit_uv,        // (2, n)
    __global const uint *hit_primitive,  // (n)
    __global const uint *hit_instance,   // (n)
    Environment environment,
    uint n,
    uint pixels,
    uint groups,
    uint first)
{
    uint group = get_global_id(0);
    if (group >= groups || group_count[group] == 0) return;
    if (group_first[group] < first || group_first[group] >= first + n) return;
    Sky far = { environment, sky, sky_rows, sky_columns, sky_density, sky_edges };
    Cache cache = { first_hit, shading, material, instances, far };
    Found found = { ray_direction, hit_uv, hit_primitive, hit_instance, n };
    uint end = group_first[group] + group_count[group] - first;
    for (uint i = group_first[group] - first; i < end;) {
        uint here = (samples[first + i] & ~NEW_SAMPLE) % pixels, failed = NONE, failed_slot = 0;
        Mask m = load_mask(mask, here);
        uint visible = visible_slots(m);
        for (; i < end && (samples[first + i] & ~NEW_SAMPLE) % pixels == here; i++) {
            uint sample = samples[first + i] & ~NEW_SAMPLE, bit = 1u << sample / pixels;
            bool is_new = (samples[first + i] & NEW_SAMPLE) != 0, is_free = hit_instance[place_of_entry(i, n)] == NONE;
            visible = is_new || is_free ? visible | bit : visible & ~bit;
            if (is_new) {
                replace_sample(&cache, &found, place_of_entry(i, n), sample);
            } else if (!is_free && failed == NONE) {
                failed = i;
                failed_slot = bit;
            }
        }
        bool is_flat = plan && !(plan[here] & IS_EDGE);
        if (failed != NONE && (is_flat || !visible)) {
            replace_sample(&cache, &found, place_of_entry(failed, n), samples[first + failed] & ~NEW_SAMPLE);
            visible |= failed_slot;
        }
        store_mask(mask, here, make_mask(occupied_slots(m), visible));
    }
}
