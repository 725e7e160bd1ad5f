// The values of a queue's hits from the cache of tiles (MaterialMemo, section 5.4): tiles that are missing are built and inserted.
// Either a group of lanes looks up a hit each, and they build together what they miss (tile_lanes.cl); or, with SERIAL, one
// work-item looks up a run of hits one after the other, and builds alone. Tiles are the same, bit for bit.
//
// Hits whose memo_check is 0 are passed over.
//
// Defines: SERIAL; NATIVE_SUBGROUPS without it; those of tile_lanes.cl.

#include "memo/tile_lanes.cl"
#include "memo/turn.cl"

#define RUN 16u  // hits

// What hit i asks for.
inline void look_up_alone(const Table *table, STORE_PARAMETER, const Requests *requests, uint i, const Maps *maps,
                          __global float *graph_value, MemoCounts *counts, GraphCounts *graph_counts)
{
    float values[GRAPH_CHANNELS];
    bool is_hit = read_tile(table, STORE, requests, i, values, counts);
    counts->lookups++;
    counts->hits += is_hit ? 1 : 0;
    count_graph(graph_counts, graph_asked(requests, i), is_hit);
    if (!is_hit) {
        float tile[TEXELS][GRAPH_CHANNELS];
        for (uint texel = 0; texel < TEXELS; texel++) evaluate_texel(requests, i, texel, maps, tile[texel]);
        counts->built++;
        uint entry = lock_tile(table, requests, i, counts);
        if (entry != NONE) {
            for (uint texel = 0; texel < TEXELS; texel++) store_tile_texel(table, STORE, entry, texel, tile[texel]);
            publish_entry(table, requests->place[i], entry, requests->check[i], counts);
        }
        Sample sample = sample_of(requests, i);
        for (uint c = 0; c < GRAPH_CHANNELS; c++) {
            float corner[CORNERS];
            for (uint k = 0; k < CORNERS; k++) corner[k] = tile[corner_of(&sample, k)][c];
            values[c] = sampled(&sample, corner);
        }
    }
    write_values(graph_value, requests->n, i, values);
}

__kernel __attribute__((reqd_work_group_size(32, 1, 1) IN_LANES)) void look_up_tiles(
    __global const TextureUse *uses,           // (uses) or null
    __global const Texture *textures,          // (textures) or null
    __global const uint *texels,               // (texels) or null
    __global const float *srgb,                // (256) or null
    __global const uint *alive,                // (chunks)
    __global const uint *memo_place,           // (n)
    __global const uint *memo_check,           // (n)
    __global const int *memo_cell,             // (4, n)
    __global const float *memo_within,         // (2, n)
    __global volatile uint *memo_records,      // (capacity, stride)
    __global volatile ulong *memo_clock,       // (1) or null
#if TEXELS_IN_IMAGE2D
    read_only image2d_t tiles_read,            // (rows, columns, 4)
    write_only image2d_t tiles_written,        // (rows, columns, 4)
#endif
#if TEXELS_IN_IMAGE3D
    read_only image3d_t tiles_read,            // (layers, rows, columns, 4)
    write_only image3d_t tiles_written,        // (layers, rows, columns, 4)
#endif
#if TEXELS_IN_BUFFER
    __global volatile uint *memo_tiles,        // (capacity, tile_words)
#endif
    __global volatile uint *memo_counters,     // (counters)
    __global volatile uint *memo_graph_count,  // (graphs, 2)
    __global float *graph_value,               // (GRAPH_CHANNELS, n)
    uint capacity,
    uint probe,
    uint stamp,
    uint turn,
    uint turns,
    uint n)
{
    Maps maps = { uses, textures, texels, srgb };
    uint hits = SERIAL ? RUN : LANES, first = SERIAL ? get_global_id(0) * RUN : get_group_id(0) * LANES;
    uint end = has_turn(first, hits, turn, turns) ? n : 0;
    Requests requests = { alive, memo_place, memo_check, memo_cell, memo_within, n, end };
    Table table = { memo_records, memo_clock, capacity, probe, stamp };
    MemoCounts counts = { 0, 0, 0, 0, 0, 0, 0, 0, 0 };
    GraphCounts graph_counts = { memo_graph_count, 0, 0, 0 };
#if TEXELS_IN_ENTRY
    __global volatile uint *memo_tiles = 0;
#endif
#if SERIAL
    for (uint i = first; i < min(first + RUN, end); i++) {
        if (asks(&requests, i)) expect_tile(&table, STORE, &requests, i);
    }
    for (uint i = first; i < min(first + RUN, end); i++) {
        if (asks(&requests, i)) look_up_alone(&table, STORE, &requests, i, &maps, graph_value, &counts, &graph_counts);
    }
#else
    __local uint words[OFFERED_WORDS * LANES];
    Lanes lanes = lanes_of(words);
    look_up_in_lanes(&lanes, &table, STORE, &requests, first, &maps, graph_value, &counts, &graph_counts);
#endif
    add_counts(memo_counters, &counts);
    flush_graph(&graph_counts);
}
