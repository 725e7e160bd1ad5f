// From samples to the voxels that they ask (SampleCache, section 4), and who updates these: of all samples that ask a voxel in an update
// one, whichever comes out highest in an order that is drawn anew each time; the others only read. So no sum is ever shared by
// threads, and what a voxel gets does not depend on which of them was first. A sample without a voxel (none may answer it, or the
// table has no place) is traced for itself.
//
// The table is shared by the eyes, and a voxel that the first has updated in a frame, the second only reads.
//
// Defines: those of ask.cl; COUNT_LOOKUPS, COUNT_HITS, COUNT_INSERTED, COUNT_EVICTED, COUNT_DISCARDED, COUNT_VOXELS, COUNT_CAPACITY,
// COUNT_SHADED (places in `counters`).

#include "samplecache/groups.cl"
#include "voxelhash/ask.cl"

// What is claimed: by nobody, as a sample of this priority does, or updated already.
#define UNCLAIMED 0u
#define UPDATED 0xFFFFFFFFu

#define MOST_INHERITED 16.0f  // values

// A pixel's priority in an update: no two pixels have the same, and none those two values. A permutation of 31 bits.
inline uint priority_of(uint pixel, uint update)
{
    uint p = (pixel + update * 0x2545F491u) & 0x7FFFFFFFu;
    p = (p * 0x5851F42Du) & 0x7FFFFFFFu;
    p ^= p >> 15;
    p = (p * 0x2C9277B5u) & 0x7FFFFFFFu;
    p ^= p >> 16;
    return p + 1;
}

// One work-item per entry of the list: where its voxel is to be found. A place of NONE: it has none.
__kernel void address_asked(
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
    __global const uint *first_hit,      // (slots, pixels, 4)
    __global const uint *asked,          // (pixels)
    __global const uint *asked_stream,   // (pixels)
    __global uint *voxel_place,          // (pixels)
    __global uint *voxel_check,          // (pixels)
    __global const float *graph_value,    // (channels, n) or null
    Camera camera,
    uint n,
    float factor,
    uint blocks,
    uint entries,
    uint update,
    uint key0,
    uint key1)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    FirstHit hit = load_first_hit(first_hit, asked[i]);
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Geometry geometry = { positions, triangles, instances };
    GraphValues graph = { graph_value, n, i };
    Vec3 direction;
    float t;
    Surface surface = surface_of(&scene, &camera, hit, &graph, &direction, &t);
    Seen seen = seen_point(&geometry, &camera, hit);
    Asked a = ask(&camera, &seen, factor, random_of_asking(asked_stream[i], update, key0, key1));
    Voxel voxel = voxel_at(a.point, seen.normal, a.level, dark_of(&surface), blocks);
    bool has_none = follows_view(&surface, materials + surface.material) || is_too_near(&seen, a.level);
    voxel_place[i] = has_none ? NONE : voxel.place;
    voxel_check[i] = voxel.check;
}

// One work-item per run of entries: find their voxels, make those that are not there, and claim those that are to be updated.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void look_up(
    __global const uint *asked_stream,         // (pixels)
    __global const uint *voxel_place,          // (pixels)
    __global const uint *voxel_check,          // (pixels)
    __global volatile ulong *voxel_key,        // (capacity)
    __global float *voxel_radiance,            // (capacity, 4)
    __global volatile uint *voxel_claim,       // (capacity)
    __global uint *voxel,                      // (pixels)
    __global volatile uint *voxel_occupied,    // (1)
    __global volatile uint *counters,          // (counts)
    uint capacity,
    uint probe,
    uint stamp,
    int lifetime,
    uint update,
    uint entries)
{
    uint begin = get_global_id(0) * RUN, end = min(begin + RUN, entries);
    if (begin >= entries) return;
    Table table = { voxel_key, capacity, probe, stamp, lifetime };
#if defined(__has_builtin) && !defined(NO_PREFETCH)
    for (uint i = begin; i < end; i++)
        if (voxel_place[i] < capacity) __builtin_prefetch((__global const void *)(voxel_key + voxel_place[i]));
#endif
    uint count[4] = { 0, 0, 0, 0 };
    for (uint i = begin; i < end; i++) {
        uint pixel = asked_stream[i], place = voxel_place[i], entry = NONE;
        if (place != NONE) {
            Outcome outcome;
            entry = find_or_insert(&table, place < capacity ? place : place % capacity, voxel_check[i], &outcome);
            count[outcome]++;
            if (outcome == INSERTED || outcome == EVICTED) voxel_radiance[words_of(entry) + 3] = 0.0f;
            if (outcome == HIT) {
                uint before = touch(&table, entry);
                bool is_updated = !(stamp & 1) && before != stamp && (int)(stamp - before) <= 1;  // of the second eye
                if (is_updated) atomic_max(voxel_claim + entry, UPDATED);
            }
            if (entry != NONE) atomic_max(voxel_claim + entry, priority_of(pixel, update));
        }
        voxel[pixel] = entry;
    }
    atomic_add(counters + COUNT_LOOKUPS, count[HIT] + count[INSERTED] + count[EVICTED] + count[DISCARDED]);
    atomic_add(counters + COUNT_HITS, count[HIT]);
    if (count[INSERTED] + count[EVICTED]) atomic_add(counters + COUNT_INSERTED, count[INSERTED] + count[EVICTED]);
    if (count[INSERTED]) atomic_add(voxel_occupied, count[INSERTED]);
    if (count[EVICTED]) atomic_add(counters + COUNT_EVICTED, count[EVICTED]);
    if (count[DISCARDED]) atomic_add(counters + COUNT_DISCARDED, count[DISCARDED]);
}

// One work-item per run of entries: list those that are traced, with their voxels.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void list_claimed(
    __global const uint *asked,         // (pixels)
    __global const uint *asked_stream,  // (pixels)
    __global const uint *voxel,         // (pixels)
    __global const uint *voxel_claim,   // (capacity)
    __global uint *shaded,              // (pixels)
    __global uint *stream,              // (pixels)
    __global uint *shaded_voxel,        // (pixels)
    __global volatile uint *listed,     // (lists)
    __global volatile uint *counters,   // (counts)
    uint update,
    uint entries)
{
    uint begin = get_global_id(0) * RUN, end = min(begin + RUN, entries), count = 0, chosen[RUN];
    if (begin >= entries) return;
    for (uint i = begin; i < end; i++) {
        uint pixel = asked_stream[i], entry = voxel[pixel];
        chosen[count] = i;
        count += entry == NONE || voxel_claim[entry] == priority_of(pixel, update) ? 1 : 0;
    }
    uint first = take(listed + 1, count);
    for (uint k = 0; k < count; k++) {
        uint i = chosen[k];
        shaded[first + k] = asked[i];
        stream[first + k] = asked_stream[i];
        shaded_voxel[first + k] = voxel[asked_stream[i]];
    }
    if (count) atomic_add(counters + COUNT_SHADED, count);
}

// One work-item per entry of the list: nothing is claimed any more. (A frame that is broken off before this leaves claims behind, by
// which their voxels miss one update.)
__kernel void release(
    __global const uint *asked_stream,  // (pixels)
    __global const uint *voxel,         // (pixels)
    __global uint *voxel_claim,         // (capacity)
    uint entries)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    uint entry = voxel[asked_stream[i]];
    if (entry != NONE) voxel_claim[entry] = UNCLAIMED;
}

// One work-item: what the table holds, entries that have died included.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void tally(
    __global const uint *voxel_occupied,  // (1)
    __global uint *counters,              // (counts)
    uint capacity)
{
    if (get_global_id(0) > 0 || capacity == 0) return;
    counters[COUNT_VOXELS] = voxel_occupied[0];
    counters[COUNT_CAPACITY] = capacity;
}

// One work-item per run of the list of what is traced: a voxel that has no values yet starts from those of the voxel at its place one
// level above or below, whichever has more, as if it had had a few of them; else nobody would know what was known when a
// camera's motion changes the level. Only the table as it was before this update's values is read.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void inherit(
    __global const float *positions,        // (vertices, 3)
    __global const uint *triangles,         // (triangles, 3)
    __global const float *normals,          // (vertices, 3) or null
    __global const float *uvs,              // (vertices, 2) or null
    __global const Instance *instances,     // (instances)
    __global const uint *material,          // (triangles)
    __global const Material *materials,     // (materials)
    __global const TextureUse *uses,        // (uses) or null
    __global const Texture *textures,       // (textures) or null
    __global const uint *texels,            // (texels) or null
    __global const float *srgb,             // (256) or null
    __global const uint *first_hit,         // (slots, pixels, 4)
    __global const uint *shaded,            // (pixels)
    __global const uint *stream,            // (pixels)
    __global const uint *shaded_voxel,      // (pixels)
    __global ulong *voxel_key,              // (capacity)
    __global const float *voxel_radiance,   // (capacity, 4)
    __global float *voxel_start,            // (pixels, 4)
    __global const float *graph_value,    // (channels, n) or null
    Camera camera,
    uint n,
    float factor,
    uint blocks,
    uint capacity,
    uint probe,
    uint stamp,
    int lifetime,
    uint update,
    uint key0,
    uint key1,
    uint entries)
{
    uint begin = get_global_id(0) * RUN, end = min(begin + RUN, entries);
    if (begin >= entries) return;
    Table table = { voxel_key, capacity, probe, stamp, lifetime };
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Geometry geometry = { positions, triangles, instances };
    for (uint i = begin; i < end; i++) {
        uint entry = shaded_voxel[i];
        if (entry == NONE || voxel_radiance[words_of(entry) + 3] > 0.0f) continue;
        FirstHit hit = load_first_hit(first_hit, shaded[i]);
        Seen seen = seen_point(&geometry, &camera, hit);
        GraphValues graph = { graph_value, n, i };
        Vec3 direction;
        float t;
        Surface surface = surface_of(&scene, &camera, hit, &graph, &direction, &t);
        Asked a = ask(&camera, &seen, factor, random_of_asking(stream[i], update, key0, key1));
        float4 start = (float4)(0.0f);
        for (int aside = -1; aside <= 1; aside += 2) {
            Voxel near = voxel_at(a.point, seen.normal, a.level + aside, dark_of(&surface), blocks);
            uint found = find_entry(&table, near.place < capacity ? near.place : near.place % capacity, near.check);
            float4 known = found == NONE ? (float4)(0.0f) : vload4(found, voxel_radiance);
            start = known.w > start.w ? known : start;
        }
        start.w = fmin(start.w, MOST_INHERITED);
        vstore4(start, i, voxel_start);
    }
}
