// From the visible samples to the image (SampleCache, section 3.3): the mean over each pixel's samples. Where radiance is stored
// without albedo, each sample's is multiplied by that at its own point, over the list of visible samples, in batches, and then
// averaged group by group; otherwise the cache is averaged as it is. Of a cache without radiance something else resolves the list.
//
// Defines: those of mask.cl and surface.cl; HAS_RADIANCE; DEMODULATE; FILL: not every pixel has a sample that was shaded; HAS_MOMENTS.

#include "samplecache/albedo.cl"
#include "samplecache/groups.cl"
#include "samplecache/mask.cl"
#include "samplecache/radiance.cl"

// One work-item per group: list the visible samples, those of a group in one batch.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void list_visible(
    __global const uint *pixel,      // (n)
    __global const uint *mask,       // (pixels, words)
    __global uint *samples,          // (capacity)
    __global volatile uint *listed,  // (lists)
    __global uint *group_first,      // (groups)
    __global uint *group_count,      // (groups)
    uint n,
    uint pixels,
    uint groups,
    uint batch)
{
    uint group = get_global_id(0);
    if (group >= groups) return;
    uint seen[GROUP * SLOTS], visible = 0;
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n); path++) {
        uint here = pixel[path];
        uint rest = here == NONE ? 0 : visible_slots(load_mask(mask, here));
        for (; rest; rest &= rest - 1) seen[visible++] = lowest_bit(rest) * pixels + here;
    }
    uint first = take_together(listed, samples, visible, batch);
    for (uint i = 0; i < visible; i++) samples[first + i] = seen[i];
    group_first[group] = first;
    group_count[group] = visible;
}

// A pixel's mean. Surfaces are weighed against each other; surfaces and background by their numbers.
typedef struct Mean {
    Vec3 near, far;  // sums
    float weight;    // of what is near
    uint near_count, far_count;
} Mean;

inline void add_sample(Mean *mean, Vec3 value, float weight, bool is_far)
{
    mean->near = add3(mean->near, scale3(is_far ? 0.0f : weight, value));
    mean->far = add3(mean->far, scale3(is_far ? 1.0f : 0.0f, value));
    mean->weight += is_far ? 0.0f : weight;
    mean->near_count += is_far ? 0 : 1;
    mean->far_count += is_far ? 1 : 0;
}

// Whether something is known of all that the pixel shows.
inline bool is_known(const Mean *mean)
{
    return mean->weight > 0.0f || (mean->near_count == 0 && mean->far_count > 0);
}

// near: the mean of what is near.
inline Vec3 mean_with(const Mean *mean, Vec3 near)
{
    Vec3 sum = add3(scale3((float)mean->near_count, near), mean->far);
    return scale3(1.0f / (float)max(mean->near_count + mean->far_count, 1u), sum);
}

inline Vec3 mean_of(const Mean *mean)
{
    return mean_with(mean, scale3(mean->weight > 0.0f ? 1.0f / mean->weight : 0.0f, mean->near));
}

// One work-item per entry.
__kernel void resolve(
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
    __global const uint *shading,         // (slots, pixels, 4)
    __global const uint *samples,         // (capacity)
    __global const float *graph_value,    // (channels, n) or null
    __global float *sample_value,         // (3, n)
    __global float *sample_weight,        // (n)
    __global float *sample_albedo,        // (3, n) or null
    __global float *sample_near,          // (n) or null
    Camera camera,
    uint n,
    uint first,
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    uint sample = samples[first + i];
    bool is_there = sample != NONE;
    sample = is_there ? sample : 0;
    uint counted = count_of(shading, sample);
    Vec3 light = radiance_of(shading, sample);
#if DEMODULATE || HAS_MOMENTS
    FirstHit hit = load_first_hit(first_hit, sample);
    bool is_far = is_background(hit) || !is_there;
    hit.w = is_far ? 0 : hit.w;
    hit.z = is_far ? 0 : hit.z;
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    GraphValues graph = { graph_value, n, i };
    Vec3 direction;
    float t;
    Surface surface = surface_of(&scene, &camera, hit, &graph, &direction, &t);
#endif
#if DEMODULATE
    Vec3 albedo = either3(is_far, all3(1.0f), modulation(&surface));
    light = mul3(albedo, light);
#if FILL
    store_planes(sample_albedo, n, i, either3(is_far, all3(0.0f), albedo));
#endif
#endif
#if HAS_MOMENTS
    sample_near[i] = is_far ? 0.0f : 1.0f / (t * dot3(forward_of(&camera), direction));
#endif
    store_planes(sample_value, n, i, light);
    sample_weight[i] = counted == OF_BACKGROUND ? FAR : weight_of(counted);
}

typedef struct Filling {
    Vec3 light;  // weighted mean, without albedo, of the block's samples
    float weight;
} Filling;

// The light on the surfaces of each block of a group, for those of its pixels that have none of their own yet.
inline void gather_light(__global const float *sample_value, __global const float *sample_weight,
                         __global const float *sample_albedo, const uchar *block_of, uint n, uint begin, uint end,
                         Filling *filling)
{
    for (uint block = 0; block < BLOCKS; block++) filling[block].light = all3(filling[block].weight = 0.0f);
    for (uint i = begin; i < end; i++) {
        Vec3 albedo = load_vec3(sample_albedo, n, i), value = load_vec3(sample_value, n, i);
        float weight = sample_weight[i];
        Filling *f = filling + block_of[i - begin];
        if (!(albedo.x > 0.0f && weight > 0.0f)) continue;
        f->weight += weight;
        f->light = add3(f->light, scale3(weight, vec3(value.x / albedo.x, value.y / albedo.y, value.z / albedo.z)));
    }
    for (uint block = 0; block < BLOCKS; block++) {
        Filling *f = filling + block;
        if (f->weight > 0.0f) f->light = scale3(1.0f / f->weight, f->light);
    }
}

// One work-item per group; those whose part of the list is in this batch do something.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void average(
    __global const uint *pixel,           // (n_paths)
    __global const uint *mask,            // (pixels, words)
    __global const uint *group_first,     // (groups)
    __global const uint *group_count,     // (groups)
    __global const float *sample_value,   // (3, n)
    __global const float *sample_weight,  // (n)
    __global const float *sample_albedo,  // (3, n) or null
    __global float *color,                // (pixels, 3)
    uint n_paths,
    uint n,
    uint groups,
    uint first)
{
    uint group = get_global_id(0);
    if (group >= groups || group_count[group] == 0) return;
    if (group_first[group] < first || group_first[group] >= first + n) return;
    uint begin = group_first[group] - first, i = begin;
#if FILL
    uchar block_of[GROUP * SLOTS];
    Filling filling[BLOCKS];
    uint k = 0;
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n_paths); path++) {
        uint many = pixel[path] == NONE ? 0 : popcount(visible_slots(load_mask(mask, pixel[path])));
        while (many-- > 0) block_of[k++] = path % GROUP / LANES;
    }
    gather_light(sample_value, sample_weight, sample_albedo, block_of, n, begin, begin + k, filling);
#endif
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n_paths); path++) {
        uint here = pixel[path];
        if (here == NONE) continue;
        uint end = i + popcount(visible_slots(load_mask(mask, here)));
        Mean mean = { all3(0.0f), all3(0.0f), 0.0f, 0, 0 };
        Vec3 albedo = all3(0.0f);
        for (; i < end; i++) {
            add_sample(&mean, load_vec3(sample_value, n, i), sample_weight[i], sample_weight[i] == FAR);
#if FILL
            albedo = add3(albedo, load_vec3(sample_albedo, n, i));
#endif
        }
        Vec3 near = scale3(mean.weight > 0.0f ? 1.0f / mean.weight : 0.0f, mean.near);
#if FILL
        Vec3 filled = mul3(scale3(1.0f / (float)max(mean.near_count, 1u), albedo), filling[path % GROUP / LANES].light);
        near = either3(is_known(&mean), near, filled);
#endif
        store_row(color, here, mean_with(&mean, near));
    }
}

// Red of a pixel that no radiance is known of: a mark for `fill_gaps`, where that follows.
#if FILL
#define NOTHING_YET -1.0f
#else
#define NOTHING_YET 0.0f
#endif

// The same straight from the cache, for radiance with albedo. One work-item per run of pixels, along the rows: in this order the
// layers of the cache are read from front to back.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void average_cache(
    __global const uint *mask,     // (pixels, words)
    __global const uint *shading,  // (slots, pixels, 4)
    __global float *color,         // (pixels, 3)
    uint pixels)
{
    uint begin = get_global_id(0) * RUN;
    for (uint here = begin; here < min(begin + RUN, pixels); here++) {
        Mean mean = { all3(0.0f), all3(0.0f), 0.0f, 0, 0 };
        for (uint rest = visible_slots(load_mask(mask, here)); rest; rest &= rest - 1) {
            uint sample = lowest_bit(rest) * pixels + here, count = count_of(shading, sample);
            add_sample(&mean, radiance_of(shading, sample), weight_of(count), count == OF_BACKGROUND);
        }
        store_row(color, here, either3(is_known(&mean), mean_of(&mean), vec3(NOTHING_YET, 0.0f, 0.0f)));
    }
}

// A pixel that no radiance is known of is as bright as those of its block are on average. One work-item per block.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void fill_gaps(
    __global const uint *pixel,  // (n)
    __global float *color,       // (pixels, 3)
    uint n)
{
    uint first = get_global_id(0) * LANES, gaps = 0, known = 0;
    if (first >= n) return;
    Vec3 sum = all3(0.0f);
    for (uint lane = 0; lane < LANES; lane++) {
        uint here = pixel[first + lane];
        if (here == NONE) continue;
        bool is_known = color[3 * here] >= 0.0f;
        gaps |= is_known ? 0 : 1u << lane;
        known += is_known ? 1 : 0;
        if (is_known) sum = add3(sum, row3(color, here));
    }
    for (; gaps; gaps &= gaps - 1) store_row(color, pixel[first + lowest_bit(gaps)], scale3(1.0f / (float)max(known, 1u), sum));
}

// One work-item per group: for stereo blending, the first two moments of a pixel's samples (section 3.6, Eq. 5 and 6; the second
// about the first, where raw ones would cancel), their count, and the reciprocal depth of the nearest. The background
// counts as much as the other samples do on average.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void find_moments(
    __global const uint *pixel,           // (n_paths)
    __global const uint *mask,            // (pixels, words)
    __global const uint *shading,         // (slots, pixels, 4)
    __global const uint *samples,         // (capacity)
    __global const uint *group_first,     // (groups)
    __global const uint *group_count,     // (groups)
    __global const float *sample_value,   // (3, n)
    __global const float *sample_near,    // (n)
    __global float *moments,              // (pixels, 8)
    uint n_paths,
    uint n,
    uint groups,
    uint first)
{
    uint group = get_global_id(0);
    if (group >= groups || group_count[group] == 0) return;
    if (group_first[group] < first || group_first[group] >= first + n) return;
    uint i = group_first[group] - first;
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n_paths); path++) {
        uint here = pixel[path];
        if (here == NONE) continue;
        uint many = popcount(visible_slots(load_mask(mask, here))), end = i + many, far = 0;
        float total = 0.0f, nearest = 0.0f, counts[SLOTS];
        for (uint k = 0; k < many; k++) {
            bool is_far = sample_near[i + k] == 0.0f;
            counts[k] = is_far ? -1.0f : (float)count_of(shading, samples[first + i + k]);
            far += is_far ? 1 : 0;
            total += is_far ? 0.0f : counts[k];
            nearest = fmax(nearest, sample_near[i + k]);
        }
        float of_far = many > far ? total / (float)(many - far) : 1.0f;
        total += of_far * (float)far;
        Vec3 mean = all3(0.0f), spread = all3(0.0f);
        for (uint k = 0; k < many; k++) {
            counts[k] = total > 0.0f ? (counts[k] < 0.0f ? of_far : counts[k]) / total : 0.0f;
            mean = add3(mean, scale3(counts[k], load_vec3(sample_value, n, i + k)));
        }
        for (uint k = 0; k < many; k++) {
            Vec3 away = sub3(load_vec3(sample_value, n, i + k), mean);
            spread = add3(spread, scale3(counts[k], mul3(away, away)));
        }
        __global float *row = moments + 8 * (size_t)here;
        bool is_finite = spread.x + spread.y + spread.z < INFINITY;  // squares may overflow
        row[0] = mean.x;
        row[1] = mean.y;
        row[2] = mean.z;
        row[3] = is_finite ? total : 0.0f;
        row[4] = is_finite ? spread.x : 0.0f;
        row[5] = is_finite ? spread.y : 0.0f;
        row[6] = is_finite ? spread.z : 0.0f;
        row[7] = nearest;
        i = end;
    }
}

// One work-item per entry: what the surface there is like, for AOVs.
__kernel void describe(
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
    __global const uint *samples,         // (capacity)
    __global const float *graph_value,    // (channels, n) or null
    __global float *sample_base,          // (3, n)
    __global float *sample_normal,        // (3, n)
    __global float *sample_depth,         // (n)
    Camera camera,
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
    hit.w = is_far ? 0 : hit.w;
    hit.z = is_far ? 0 : hit.z;
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    GraphValues graph = { graph_value, n, i };
    Vec3 direction;
    float t;
    Surface surface = surface_of(&scene, &camera, hit, &graph, &direction, &t);
    store_planes(sample_base, n, i, either3(is_far, all3(0.0f), surface.albedo));
    store_planes(sample_normal, n, i, either3(is_far, all3(0.0f), surface.shading_normal));
    sample_depth[i] = is_far ? INFINITY : t * dot3(forward_of(&camera), direction);
}

// Of one component: the variance of the weighted mean, from the samples' spread; infinite where there is but one sample.
inline float variance_of_mean(float spread, float weight, uint many)
{
    return many > 1 && !isnan(spread) ? spread / (weight * weight) * (float)many / (float)(many - 1) : INFINITY;
}

// One work-item per group: the AOVs of its pixels.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void fill_aovs(
    __global const uint *pixel,           // (n_paths)
    __global const uint *mask,            // (pixels, words)
    __global const uint *shading,         // (slots, pixels, 4) or null
    __global const float *answer_count,   // (n) or null
    __global const uint *samples,         // (capacity)
    __global const uint *group_first,     // (groups)
    __global const uint *group_count,     // (groups)
    __global const float *sample_value,   // (3, n)
    __global const float *sample_weight,  // (n)
    __global const float *sample_base,    // (3, n)
    __global const float *sample_normal,  // (3, n)
    __global const float *sample_depth,   // (n)
    __global const float *color,          // (pixels, 3)
    __global float *aov_albedo,           // (pixels, 3)
    __global float *aov_N,                // (pixels, 3)
    __global float *aov_Z,                // (pixels)
    __global float *aov_variance,         // (pixels, 3)
    __global float *aov_samples,          // (pixels)
    __global float *aov_occupancy,        // (pixels)
    __global float *aov_visible,          // (pixels)
    __global float *aov_age,              // (pixels) or null
    uint n_paths,
    uint n,
    uint groups,
    uint first)
{
    uint group = get_global_id(0);
    if (group >= groups || group_count[group] == 0) return;
    if (group_first[group] < first || group_first[group] >= first + n) return;
    uint i = group_first[group] - first;
    for (uint path = group * GROUP; path < min(group * GROUP + GROUP, n_paths); path++) {
        uint here = pixel[path];
        if (here == NONE) continue;
        Mask m = load_mask(mask, here);
        uint many = popcount(visible_slots(m)), begin = i, end = i + many, weighed = 0;
        float near_weight = 0.0f;
        uint near_count = 0;
        for (uint k = begin; k < end; k++) {
            near_weight += sample_weight[k] == FAR ? 0.0f : sample_weight[k];
            near_count += sample_weight[k] == FAR ? 0 : 1;
        }
        float far_weight = near_weight > 0.0f ? near_weight / (float)near_count : 1.0f;
        Vec3 base = all3(0.0f), normal = all3(0.0f), spread = all3(0.0f), mean = row3(color, here);
        float depth = INFINITY, weight = 0.0f, age = 0.0f, counted = 0.0f;
        for (; i < end; i++) {
            bool is_far = isinf(sample_depth[i]);
            float part_of = is_far ? far_weight : sample_weight[i];
            Vec3 away = scale3(part_of, sub3(load_vec3(sample_value, n, i), mean));
            base = add3(base, load_vec3(sample_base, n, i));
            normal = add3(normal, load_vec3(sample_normal, n, i));
            depth = fmin(depth, sample_depth[i]);
            spread = add3(spread, mul3(away, away));
            weight += part_of;
            weighed += part_of > 0.0f ? 1 : 0;
#if HAS_RADIANCE
            counted += is_far ? 0.0f : (float)count_of(shading, samples[first + i]);
            age += (float)age_of(shading, samples[first + i]);
#else
            counted += is_far ? 0.0f : answer_count[i];
#endif
        }
        float part = 1.0f / (float)max(many, 1u);
        store_row(aov_albedo, here, scale3(part, base));
        store_row(aov_N, here, normalize3(normal));
        aov_Z[here] = depth;
        store_row(aov_variance, here, vec3(variance_of_mean(spread.x, weight, weighed), variance_of_mean(spread.y, weight, weighed),
                                           variance_of_mean(spread.z, weight, weighed)));
        aov_samples[here] = counted;
        aov_occupancy[here] = (float)popcount(occupied_slots(m));
        aov_visible[here] = (float)many;
        if (aov_age) aov_age[here] = part * age;
    }
}
