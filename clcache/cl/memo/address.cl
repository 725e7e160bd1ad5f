// Where the values of a queue's hits are to be found. One work-item per place in the queue.
//
// Defines: those of surface.cl; TILED, and those of tile_key.cl with it.

#include "memo/hit.cl"
#include "memo/lookup.cl"
#include "pathtrace/queue.cl"
#if TILED
#include "memo/tile_key.cl"
#endif

__kernel void address(
    __global const float *positions,      // (vertices, 3)
    __global const uint *triangles,       // (triangles, 3)
    __global const float *normals,        // (vertices, 3) or null
    __global const float *uvs,            // (vertices, 2)
    __global const Instance *instances,   // (instances)
    __global const uint *material,        // (triangles)
    __global const Material *materials,   // (materials)
    __global const uint *alive,           // (chunks)
    __global const float *hit_t,          // (n)
    __global const float *hit_uv,         // (2, n)
    __global const uint *hit_primitive,   // (n)
    __global const uint *hit_instance,    // (n)
    __global const float *ray_direction,  // (3, n)
    __global const float *ray_length,     // (n)
    __global const float *cone,           // (2, n)
    __global const int *graph_coarsest,   // (graphs, 2)
    __global const uint *memo_mode,       // (graphs)
    __global uint *memo_place,            // (n)
    __global uint *memo_check,            // (n)
    __global int *memo_cell,              // (4, n) or null
    __global float *memo_within,          // (2, n) or null
    float bias,
    uint places,
    uint light_only,
    uint n)
{
    LEAVE_IDLE_GROUP(alive, n);
    uint i = place_in_queue();
    if (i >= n) goto together;
    Maps maps = { 0, 0, 0, 0 };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Hits hits = { hit_t, hit_uv, hit_primitive, hit_instance, ray_direction, ray_length, cone, n };
    int graph = graph_at(&scene, &hits, light_only, i);
    uint mode = memo_mode[max(graph, 0)];
    GraphHit hit = graph_hit_at(&scene, &hits, i);
    bool has_graph = graph >= 0, has_key = has_graph & ((mode & IS_MEMOIZED) != 0);
#if TILED
    TileKey tile = tile_key(&hit, (uint)max(graph, 0), bias, graph_coarsest);
    Key key = tile.key;
    memo_cell[i] = key.u;
    memo_cell[n + i] = key.v;
    memo_cell[2 * n + i] = (int)word_of(key.level);
    memo_cell[3 * n + i] = graph;
    memo_within[i] = tile.within.u;
    memo_within[n + i] = tile.within.v;
#else
    Key key = texel_key(&hit, (uint)max(graph, 0), mode, bias, graph_coarsest);
#endif
    uint place = key.hash % places, otherwise = has_graph ? IS_EVALUATED : ASKS_NOTHING;
    memo_place[i] = has_key ? place : otherwise;
    memo_check[i] = has_key ? key.check : 0;
together:
    LEAVE_TOGETHER;
}
