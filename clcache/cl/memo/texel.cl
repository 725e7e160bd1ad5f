// The values of a queue's hits from the cache of texels (MaterialMemo, section 5.3): who finds none evaluates the graph, and inserts what
// it returned. One work-item per run of places, so that those that miss together profit from each other as far as they can.
//
// With SNAP the graph is evaluated in the middle of the texel, so that values follow from their keys alone; else where the hit is.
//
// Defines: those of surface.cl and table.cl; SNAP, HALF: values take 16 bits.

#include "memo/inputs.cl"
#include "memo/lookup.cl"
#include "memo/table.cl"
#include "memo/turn.cl"
#include "memo/values.cl"
#include "pathtrace/queue.cl"

#define RUN 16u  // places

ONE_BY_ONE __kernel __attribute__((reqd_work_group_size(16, 1, 1))) void look_up_texels(
    __global const float *positions,           // (vertices, 3)
    __global const uint *triangles,            // (triangles, 3)
    __global const float *normals,             // (vertices, 3) or null
    __global const float *uvs,                 // (vertices, 2)
    __global const Instance *instances,        // (instances)
    __global const uint *material,             // (triangles)
    __global const Material *materials,        // (materials)
    __global const TextureUse *uses,           // (uses) or null
    __global const Texture *textures,          // (textures) or null
    __global const uint *texels,               // (texels) or null
    __global const float *srgb,                // (256) or null
    __global const uint *alive,                // (chunks)
    __global const float *hit_t,               // (n)
    __global const float *hit_uv,              // (2, n)
    __global const uint *hit_primitive,        // (n)
    __global const uint *hit_instance,         // (n)
    __global const float *ray_direction,       // (3, n)
    __global const float *ray_length,          // (n)
    __global const float *cone,                // (2, n)
    __global const int *graph_coarsest,        // (graphs, 2)
    __global const uint *memo_mode,            // (graphs)
    __global const uint *memo_place,           // (n)
    __global const uint *memo_check,           // (n)
    __global volatile uint *memo_records,      // (capacity, stride)
    __global volatile ulong *memo_clock,       // (1) or null
    __global volatile uint *memo_counters,     // (counters)
    __global volatile uint *memo_graph_count,  // (graphs, 2)
    __global float *graph_value,               // (GRAPH_CHANNELS, n)
    float bias,
    uint light_only,
    uint capacity,
    uint probe,
    uint stamp,
    uint turn,
    uint turns,
    uint n)
{
    uint begin = get_global_id(0) * RUN;
    if (begin >= n || begin % CHUNK >= alive[begin / CHUNK] || !has_turn(begin, RUN, turn, turns)) return;
    uint end = min(min(begin + RUN, n), begin / CHUNK * CHUNK + alive[begin / CHUNK]);  // behind it `address` may not have written
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Hits hits = { hit_t, hit_uv, hit_primitive, hit_instance, ray_direction, ray_length, cone, n };
    Table table = { memo_records, memo_clock, capacity, probe, stamp };
    MemoCounts counts = { 0, 0, 0, 0, 0, 0, 0, 0, 0 };
    GraphCounts graph_counts = { memo_graph_count, 0, 0, 0 };
#if defined(__has_builtin) && !defined(NO_PREFETCH)
    for (uint i = begin; i < end; i++) {
        if (memo_place[i] >= IS_EVALUATED) continue;
        __builtin_prefetch((__global const void *)record_of(&table, memo_place[i]));
        __builtin_prefetch((__global const void *)(record_of(&table, memo_place[i]) + RECORD_STRIDE - 1));
    }
#endif
    for (uint i = begin; i < end; i++) {
        uint place = memo_place[i], check = memo_check[i];
        if (place == ASKS_NOTHING) continue;
        float values[GRAPH_CHANNELS] = { 0.0f };  // graphs may have fewer
        bool is_hit = false;
        uint graph = (uint)graph_at(&scene, &hits, light_only, i);
        if (place != IS_EVALUATED) {
            uint entry = find_entry(&table, place, check);
            if (entry != NONE) {
                uint version = begin_reading(&table, entry);
                load_values(value_words(&table, entry), values);
                is_hit = is_unchanged(&table, entry, check, version);
                if (is_hit) touch(&table, entry, &counts);
            }
            counts.lookups++;
            counts.hits += is_hit ? 1 : 0;
            count_graph(&graph_counts, graph, is_hit);
        }
        if (!is_hit) {
            GraphHit hit = graph_hit_at(&scene, &hits, i);
#if SNAP
            if (place != IS_EVALUATED) {
                Key key = texel_key(&hit, graph, memo_mode[graph], bias, graph_coarsest);
                hit = snapped(&hit, &key);
            }
#endif
            evaluate_at(graph, &hit, &maps, values);
            if (place != IS_EVALUATED) {
                round_values(values);
                counts.built++;
                uint entry = lock_entry(&table, place, check, pcg_hash(check ^ stamp ^ i), &counts);
                if (entry != NONE) {
                    store_values(value_words(&table, entry), values);
                    publish_entry(&table, place, entry, check, &counts);
                }
            }
        }
        for (uint c = 0; c < GRAPH_CHANNELS; c++) graph_value[c * n + i] = values[c];
    }
    add_counts(memo_counters, &counts);
    flush_graph(&graph_counts);
}
