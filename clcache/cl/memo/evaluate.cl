// The values of a queue's hits, each graph evaluated where the hit is; with `memo_place` only those that it says so of. One work-item
// per place in the queue.
//
// Defines: those of surface.cl.

#include "memo/inputs.cl"
#include "memo/lookup.cl"
#include "pathtrace/queue.cl"

ONE_BY_ONE __kernel void evaluate(
    __global const float *positions,      // (vertices, 3)
    __global const uint *triangles,       // (triangles, 3)
    __global const float *normals,        // (vertices, 3) or null
    __global const float *uvs,            // (vertices, 2)
    __global const Instance *instances,   // (instances)
    __global const uint *material,        // (triangles)
    __global const Material *materials,   // (materials)
    __global const TextureUse *uses,      // (uses) or null
    __global const Texture *textures,     // (textures) or null
    __global const uint *texels,          // (texels) or null
    __global const float *srgb,           // (256) or null
    __global const uint *alive,           // (chunks)
    __global const float *hit_t,          // (n)
    __global const float *hit_uv,         // (2, n)
    __global const uint *hit_primitive,   // (n)
    __global const uint *hit_instance,    // (n)
    __global const float *ray_direction,  // (3, n)
    __global const float *ray_length,     // (n)
    __global const float *cone,           // (2, n)
    __global const uint *memo_place,      // (n) or null
    __global float *graph_value,          // (GRAPH_CHANNELS, n)
    uint light_only,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n || i % CHUNK >= alive[i / CHUNK]) return;
    if (memo_place && memo_place[i] != IS_EVALUATED) return;
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Hits hits = { hit_t, hit_uv, hit_primitive, hit_instance, ray_direction, ray_length, cone, n };
    int graph = graph_at(&scene, &hits, light_only, i);
    if (graph < 0) return;
    GraphHit hit = graph_hit_at(&scene, &hits, i);
    float values[GRAPH_CHANNELS] = { 0.0f };  // graphs may have fewer
    evaluate_at((uint)graph, &hit, &maps, values);
    for (uint c = 0; c < GRAPH_CHANNELS; c++) graph_value[c * n + i] = values[c];
}
