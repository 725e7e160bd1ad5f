// What a tile holds, and what a hit takes from it: the same functions for whoever builds tiles (tile.cl).
//
// Texels are numbered row by row; the value of each is that in its middle. With BILINEAR they are taken for points of a grid, and
// neighbouring tiles share those on the border (MaterialMemo, section 4.6).
//
// Defines: those of tile_key.cl and tile_store.cl; BILINEAR.

#include "graph/generated.cl"
#include "memo/tile_key.cl"
#include "memo/tile_store.cl"
#include "pathtrace/queue.cl"

// What hits ask for (address.cl).
typedef struct Requests {
    __global const uint *alive;    // (chunks)
    __global const uint *place;    // (n)
    __global const uint *check;    // (n): 0 where no tile is asked for
    __global const int *cell;      // (4, n): the tile's number in u and v, level (word_of), graph
    __global const float *within;  // (2, n): the place in the tile, in texels
    uint n;
    uint end;  // hits from here on are passed over
} Requests;

inline bool asks(const Requests *requests, uint i)
{
    return i < requests->end && i % CHUNK < requests->alive[i / CHUNK] && requests->check[i] != 0;
}

inline uint graph_asked(const Requests *requests, uint i)
{
    return (uint)requests->cell[3 * requests->n + i];
}

inline bool ask_the_same(const Requests *requests, uint i, uint j)
{
    __global const int *cell = requests->cell;
    uint n = requests->n;
    return cell[i] == cell[j] && cell[n + i] == cell[n + j] && cell[2 * n + i] == cell[2 * n + j] &&
           cell[3 * n + i] == cell[3 * n + j];
}

// The values of a texel of the tile that hit i asks for, with the level's footprint (Eq. 5.16 and 5.17), as they come back from the cache.
inline void evaluate_texel(const Requests *requests, uint i, uint texel, const Maps *maps, float *values)
{
    uint n = requests->n;
    Level level = level_in((uint)requests->cell[2 * n + i]);
    float size = power_of_two(-level.texels), width = power_of_two(-level.footprint);
    int column = requests->cell[i] * TILE_COVERS_U + (int)texel % TILE_WIDTH;
    int row = requests->cell[n + i] * TILE_COVERS_V + (int)texel / TILE_WIDTH;
    float3 nothing = (float3)(0.0f, 0.0f, 0.0f);
    GraphInputs in;
#if BILINEAR
    Pair place = { middle_of(level), middle_of(level) };  // of a grid
#else
    Pair place = place_in_texel(level, column, row);
#endif
    in.uv.v = (float2)(((float)column + place.u) * size, ((float)row + place.v) * size);
    in.uv.x = (float2)(width, 0.0f);
    in.uv.y = (float2)(0.0f, width);
    in.position.v = in.position.x = in.position.y = in.normal = nothing;
    for (uint c = 0; c < GRAPH_CHANNELS; c++) values[c] = 0.0f;  // graphs may have fewer
    evaluate_graph(graph_asked(requests, i), &in, maps, values);
    round_values(values);
}

// What a hit takes: a texel, or of four, from this one to the right and down, parts.
typedef struct Sample {
    uint texel;
    float part_u, part_v;
} Sample;

#define CORNERS (BILINEAR ? 4u : 1u)

inline Sample sample_of(const Requests *requests, uint i)
{
    float u = requests->within[i], v = requests->within[requests->n + i];
    int column = clamp((int)u, 0, TILE_COVERS_U - 1), row = clamp((int)v, 0, TILE_COVERS_V - 1);
    Sample sample = { (uint)(row * TILE_WIDTH + column), u - (float)column, v - (float)row };
    return sample;
}

inline uint corner_of(const Sample *sample, uint corner)
{
    return sample->texel + corner % 2u + corner / 2u * TILE_WIDTH;
}

// A channel's value there, of its values at the corners.
inline float sampled(const Sample *sample, const float *corner)
{
#if BILINEAR
    float above = corner[0] + sample->part_u * (corner[1] - corner[0]);
    float below = corner[2] + sample->part_u * (corner[3] - corner[2]);
    return above + sample->part_v * (below - above);
#else
    return corner[0];
#endif
}

// Have the memory ready for what hit i asks for, if it is at the first place that it may be at.
inline void expect_tile(const Table *table, STORE_PARAMETER, const Requests *requests, uint i)
{
    Sample sample = sample_of(requests, i);
    for (uint k = 0; k < CORNERS; k += 2) expect_texel(table, STORE, requests->place[i], corner_of(&sample, k));
}

// What hit i takes from the cache; whether the tile was there all the time.
inline bool read_tile(const Table *table, STORE_PARAMETER, const Requests *requests, uint i, float *values, MemoCounts *counts)
{
    uint check = requests->check[i], entry = find_entry(table, requests->place[i], check);
    if (entry == NONE) return false;
    uint version = begin_reading(table, entry);
    Sample sample = sample_of(requests, i);
    float corner[CORNERS][GRAPH_CHANNELS];
    for (uint k = 0; k < CORNERS; k++) load_tile_texel(table, STORE, entry, corner_of(&sample, k), corner[k]);
    if (!is_unchanged(table, entry, check, version)) return false;
    touch(table, entry, counts);
    for (uint c = 0; c < GRAPH_CHANNELS; c++) {
        float of_channel[CORNERS];
        for (uint k = 0; k < CORNERS; k++) of_channel[k] = corner[k][c];
        values[c] = sampled(&sample, of_channel);
    }
    return true;
}

// An entry for the tile that hit i asks for, locked, or NONE.
inline uint lock_tile(const Table *table, const Requests *requests, uint i, MemoCounts *counts)
{
    uint check = requests->check[i];
    return lock_entry(table, requests->place[i], check, pcg_hash(check ^ table->stamp ^ i), counts);
}

inline void write_values(__global float *graph_value, uint n, uint i, const float *values)
{
    for (uint c = 0; c < GRAPH_CHANNELS; c++) graph_value[c * n + i] = values[c];
}
