// Tiles that are missing, built by a group of lanes together (MaterialMemo, section 5.4.3): each lane evaluates one texel, of as many
// tiles at once as there are lanes for. The eight steps:
//
//   1. Select the lanes whose tiles are built: of those that miss the same tile, the first; in the order of lanes, or with GROUPED by
//      graph (section 5.4.4).
//   2. Their requests go to the lanes that build; here these read them where they stand, in global memory.
//   3. Find the texture coordinates of each lane's texel.
//   4. Evaluate the graph.
//   5. The lane of a tile's first texel finds an entry, and locks it.
//   6. Each lane stores its texel.
//   7. The lane of the first texel publishes the entry.
//   8. Lanes that wait for one of these tiles take their values from the lanes that have them, for it is not sure that there was an
//      entry. (Ahead of step 7, so that one barrier does for both.)
//
// Defines: those of tile_values.cl; GROUPED.

#include "common/lane_group.cl"
#include "memo/tile_values.cl"

#define TILES (LANES / TEXELS)             // that are built at once
#define OFFERED_WORDS (1 + GRAPH_CHANNELS)  // an entry, and a texel's values
#define NO_LANE LANES

// The first lane that misses the same tile; NO_LANE for those that miss none. missing: lanes that miss tiles; first: the hit of lane 0.
inline uint leader_of(const Lanes *lanes, const Requests *requests, uint first, uint missing)
{
    if (!(missing >> lane_id(lanes) & 1u)) return NO_LANE;
    for (uint rest = missing; rest != 0; rest &= rest - 1u) {
        uint lane = first_lane(rest);
        if (ask_the_same(requests, first + lane, first + lane_id(lanes))) return lane;
    }
    return NO_LANE;
}

// In which order a leader's tile is built: tiles of a graph follow each other, and before all others those that fill iterations with
// their like. leaders: all of them.
inline uint rank_of(const Lanes *lanes, const Requests *requests, uint first, uint leaders)
{
    if (!(leaders >> lane_id(lanes) & 1u)) return 0xFFFFFFFFu;
    uint graph = graph_asked(requests, first + lane_id(lanes)), before = 0, all = 0;
    for (uint rest = leaders; rest != 0; rest &= rest - 1u) {
        uint lane = first_lane(rest), is_like = graph_asked(requests, first + lane) == graph ? 1u : 0u;
        all += is_like;
        before += lane < lane_id(lanes) ? is_like : 0u;
    }
    return graph | (before < all - all % TILES ? 0u : 0x80000000u);
}

// The next of the leaders that are left.
inline uint next_leader(const Lanes *lanes, uint left, uint rank)
{
#if GROUPED
    bool is_left = (left >> lane_id(lanes) & 1u) != 0;
    uint least = lane_min(lanes, is_left ? rank : 0xFFFFFFFFu);
    return first_lane(lane_ballot(lanes, is_left && rank == least));
#else
    return first_lane(left);
#endif
}

// missing: lanes that miss tiles, at least one. first: the hit of lane 0.
inline void build_tiles(const Lanes *lanes, const Table *table, STORE_PARAMETER, const Requests *requests, uint first, uint missing,
                        const Maps *maps, __global float *graph_value, MemoCounts *counts)
{
    uint me = lane_id(lanes), slot = me / TEXELS, texel = me % TEXELS, home = me - texel;
    uint leader = leader_of(lanes, requests, first, missing), left = lane_ballot(lanes, leader == me), rank = 0;
#if GROUPED
    rank = rank_of(lanes, requests, first, left);
#endif
    while (left != 0) {
        uint building = NO_LANE, waits_for = NO_LANE;  // whose tile this lane builds; the slot of the tile that it needs
        for (uint t = 0; t < TILES && left != 0; t++) {
            uint next = next_leader(lanes, left, rank);
            left &= ~(1u << next);
            building = slot == t ? next : building;
            waits_for = leader == next ? t : waits_for;
        }
        bool builds = building != NO_LANE, has_first = builds && texel == 0;
        uint hit = first + building, entry = NONE;
        float values[GRAPH_CHANNELS];
        for (uint c = 0; c < GRAPH_CHANNELS; c++) values[c] = 0.0f;
        if (builds) evaluate_texel(requests, hit, texel, maps, values);
        if (has_first) {
            counts->built++;
            entry = lock_tile(table, requests, hit, counts);
        }
        lane_offer(lanes, 0, entry);
        for (uint c = 0; c < GRAPH_CHANNELS; c++) lane_offer(lanes, 1 + c, as_uint(values[c]));
        lane_barrier();
        uint locked = lane_take(lanes, 0, entry, home);
        if (builds && locked != NONE) store_tile_texel(table, STORE, locked, texel, values);

        bool waits = waits_for != NO_LANE;
        Sample sample = { 0, 0.0f, 0.0f };
        if (waits) sample = sample_of(requests, first + me);
        for (uint c = 0; c < GRAPH_CHANNELS; c++) {
            float corner[CORNERS];
            for (uint k = 0; k < CORNERS; k++) {
                uint lane = waits ? waits_for * TEXELS + corner_of(&sample, k) : me;
                corner[k] = as_float(lane_take(lanes, 1 + c, as_uint(values[c]), lane));
            }
            if (waits) graph_value[c * requests->n + first + me] = sampled(&sample, corner);
        }
        lane_barrier();
        if (entry != NONE) publish_entry(table, requests->place[hit], entry, requests->check[hit], counts);
    }
}

// One lane per hit; first: that of lane 0. Nothing may stand around a call that some groups make and others do not: PoCL 3.1 gets
// conditions around barriers wrong that stand within another.
inline void look_up_in_lanes(const Lanes *lanes, const Table *table, STORE_PARAMETER, const Requests *requests, uint first,
                             const Maps *maps, __global float *graph_value, MemoCounts *counts, GraphCounts *graph_counts)
{
    uint i = first + lane_id(lanes);
    bool is_asking = asks(requests, i), is_hit = false;
    if (is_asking) {
        float values[GRAPH_CHANNELS];
        is_hit = read_tile(table, STORE, requests, i, values, counts);
        if (is_hit) write_values(graph_value, requests->n, i, values);
    }
    uint missing = lane_ballot(lanes, is_asking && !is_hit);
    if (missing != 0) build_tiles(lanes, table, STORE, requests, first, missing, maps, graph_value, counts);
    if (lane_id(lanes) == 0) {  // counts for all
        for (uint lane = 0; lane < LANES; lane++) {
            if (!asks(requests, first + lane)) continue;
            bool was_hit = !(missing >> lane & 1u);
            counts->lookups++;
            counts->hits += was_hit ? 1 : 0;
            count_graph(graph_counts, graph_asked(requests, first + lane), was_hit);
        }
    }
}
