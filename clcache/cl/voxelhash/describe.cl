// What pixels show of voxels, for AOVs. Each asked as its sample did.
//
// Defines: those of ask.cl.

#include "samplecache/groups.cl"
#include "voxelhash/ask.cl"

// One work-item per run of entries: how many updates ago each one's voxel was last accessed; infinite where there is none yet. To be
// found before this frame's accesses.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void find_age(
    __global const uint *asked_stream,  // (pixels)
    __global const uint *voxel_place,   // (pixels)
    __global const uint *voxel_check,   // (pixels)
    __global ulong *voxel_key,          // (capacity)
    __global float *aov_age,            // (pixels)
    uint capacity,
    uint probe,
    uint stamp,
    int lifetime,
    uint entries)
{
    uint begin = get_global_id(0) * RUN, end = min(begin + RUN, entries);
    if (begin >= entries) return;
    Table table = { voxel_key, capacity, probe, stamp, lifetime };
    for (uint i = begin; i < end; i++) {
        uint place = voxel_place[i], entry = NONE;
        if (place != NONE) entry = find_entry(&table, place < capacity ? place : place % capacity, voxel_check[i]);
        aov_age[asked_stream[i]] = entry == NONE ? INFINITY : (float)((max(stamps_since(&table, voxel_key[entry]), 0) + 1) / 2);
    }
}

// One work-item per entry of the list.
__kernel void describe_voxels(
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
    __global const uint *first_hit,        // (slots, pixels, 4)
    __global const uint *asked,            // (pixels)
    __global const uint *asked_stream,     // (pixels)
    __global const uint *voxel,            // (pixels)
    __global const float *voxel_radiance,  // (capacity, 4)
    __global float *aov_voxel,             // (pixels, 3)
    __global float *aov_level,             // (pixels)
    __global float *aov_count,             // (pixels)
    __global const float *graph_value,    // (channels, n) or null
    Camera camera,
    uint n,
    float factor,
    uint entries,
    uint update,
    uint key0,
    uint key1)
{
    uint i = get_global_id(0);
    if (i >= entries) return;
    uint pixel = asked_stream[i], entry = voxel[pixel];
    bool has_none = entry == NONE;
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Geometry geometry = { positions, triangles, instances };
    FirstHit hit = load_first_hit(first_hit, asked[i]);
    GraphValues graph = { graph_value, n, i };
    Vec3 direction;
    float t;
    Surface surface = surface_of(&scene, &camera, hit, &graph, &direction, &t);
    Seen seen = seen_point(&geometry, &camera, hit);
    Asked a = ask(&camera, &seen, factor, random_of_asking(pixel, update, key0, key1));
    Words hue = pcg4d(voxel_at(a.point, seen.normal, a.level, dark_of(&surface), 1).check, 1, 2, 3);
    store_row(aov_voxel, pixel, either3(has_none, all3(0.0f), vec3(to_unit(hue.x), to_unit(hue.y), to_unit(hue.z))));
    aov_level[pixel] = has_none ? INFINITY : (float)a.level;
    aov_count[pixel] = has_none ? 0.0f : voxel_radiance[words_of(has_none ? 0 : entry) + 3];
}
