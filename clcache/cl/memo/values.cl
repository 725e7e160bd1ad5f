// A texel's values in the words of a record, and how often each graph was asked for.
//
// Defines: GRAPH_CHANNELS, graphs' channels at most; HALF; VALUE_WORDS; those of table.cl.

#include "memo/table.cl"

// What is kept of a value with HALF: no more than half precision can hold.
#define LARGEST_HALF 65504.0f

inline __global volatile uint *value_words(const Table *table, uint entry)
{
    return record_of(table, entry) + RECORD_WORDS;
}

inline float rounded_value(float value)
{
#if HALF
    ushort bits[1];
    vstore_half_rte(clamp(value, -LARGEST_HALF, LARGEST_HALF), 0, (half *)bits);
    return vload_half(0, (const half *)bits);
#else
    return value;
#endif
}

// Values as they come back from the cache.
inline void round_values(float *values)
{
    for (uint c = 0; c < GRAPH_CHANNELS; c++) values[c] = rounded_value(values[c]);
}

inline void store_values(__global volatile uint *words, const float *values)
{
#if HALF
    for (uint c = 0; c < GRAPH_CHANNELS; c += 2) {
        ushort bits[2] = { 0, 0 };
        vstore_half_rte(values[c], 0, (half *)bits);
        if (c + 1 < GRAPH_CHANNELS) vstore_half_rte(values[c + 1], 1, (half *)bits);
        words[c / 2] = (uint)bits[0] | (uint)bits[1] << 16;
    }
#else
    for (uint c = 0; c < GRAPH_CHANNELS; c++) words[c] = as_uint(values[c]);
#endif
}

inline void load_values(__global volatile uint *words, float *values)
{
#if HALF
    for (uint c = 0; c < GRAPH_CHANNELS; c += 2) {
        uint pair = words[c / 2];
        ushort bits[2] = { (ushort)(pair & 0xFFFFu), (ushort)(pair >> 16) };
        values[c] = vload_half(0, (const half *)bits);
        if (c + 1 < GRAPH_CHANNELS) values[c + 1] = vload_half(1, (const half *)bits);
    }
#else
    for (uint c = 0; c < GRAPH_CHANNELS; c++) values[c] = as_float(words[c]);
#endif
}

// Lookups and hits of the graph that was asked for last, until another is.
typedef struct GraphCounts {
    __global volatile uint *counts;  // (graphs, 2)
    uint graph, lookups, hits;
} GraphCounts;

inline void flush_graph(GraphCounts *counts)
{
    if (counts->lookups > 0) atomic_add(counts->counts + 2 * counts->graph, counts->lookups);
    if (counts->hits > 0) atomic_add(counts->counts + 2 * counts->graph + 1, counts->hits);
    counts->lookups = counts->hits = 0;
}

inline void count_graph(GraphCounts *counts, uint graph, bool is_hit)
{
    if (graph != counts->graph) flush_graph(counts);
    counts->graph = graph;
    counts->lookups++;
    counts->hits += is_hit ? 1 : 0;
}
