// An update of the cells, level by level (HashCache, section 3.2): what the two sides of a cell get is summed, and merged into
// the cell (merge.cl). The sums stay as records, of which the level above makes its own:
//
//   record_key (u8)       the cell's key, in whose order they stand       record_cell (u4)    its global index
//   record_normal (u4)    of its front (cell.cl)                          record_sum (8)      of its sides (merge.cl)
//
// Vertices of a cell, which the sort has brought together, are a run; so are records that have a parent cell in common. The heads
// of runs are counted by chunks, and one work-item reduces the runs that begin in its chunk, from first to last: the same
// sums for any number of threads, and no cell is written twice in a level. A launch covers as many records as there may
// be; how many there are stands in `listed`, by level.
//
// Front is where the cell's first sample since the last wipe came from. The paper lets threads race for it, so that images differ
// from run to run; here it is the first in order.

#include "octree/merge.cl"
#include "octree/sort.cl"

#define MOST_LIGHT 1e30f  // of a sample: sums stay finite
#define AHEAD 16u         // entries of a list whose cells are expected

// How many cells an update has begun: those that are first used since the last wipe; of these, those that were used before it.
typedef struct Begun {
    uint begun, evicted;
} Begun;

// The front of a cell: what it is, or, where the cell is empty, what it is to be.
inline uint front_of(__global const uint *words, uint wipe, uint first, Begun *begun)
{
    bool is_empty = words[STAMP_WORD] != wipe;
    begun->begun += is_empty;
    begun->evicted += is_empty && words[STAMP_WORD] != 0;
    return is_empty ? first : words[NORMAL_WORD];
}

inline void tally_begun(__global volatile uint *octree_wipe, __global volatile uint *counters, Begun begun)
{
    if (begun.begun) atomic_add(octree_wipe + WIPE_OCCUPIED, begun.begun);
    if (begun.evicted) atomic_add(counters + COUNT_EVICTED, begun.evicted);
}

typedef struct Records {
    __global const uint *cell, *normal;
    __global const float *sum;
} Records;

// Merge records into their cells. Only when the sums of a chunk are done: one after the other, a processor works on several at
// a time.
inline void merge_records(
    __global uint *cells, Records records, uint first, uint end, uint wipe, uint update, uint key0, uint key1)
{
    for (uint i = first; i < end; i++) {
        uint cell = records.cell[i];
        Words random = pcg4d(cell, update, key0, key1);
        merge_into_cell(cells + words_of_cell(cell), vload8(i, records.sum), records.normal[i], wipe, random);
    }
}

// A cell's 24 bytes may be on both sides of a boundary between the units that memory brings.
inline void expect_words(__global const uint *words)
{
    expect(words);
    expect(words + CELL_WORDS - 1);
}

// A sum whose error does not grow with the number of its terms (Kahan's).
typedef struct Sum {
    float8 value, rest;
} Sum;

inline void add_to_sum(Sum *sum, float8 term)
{
    float8 next = term - sum->rest, value = sum->value + next;
    sum->rest = (value - sum->value) - next;
    sum->value = value;
}

inline bool is_run_head(__global const ulong *located, uint i)
{
    return i == 0 || (located[i] ^ located[i - 1]) >> 32 != 0;
}

// One work-item per chunk of the sorted vertices: how many runs begin in it.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void count_runs(
    __global const ulong *located,  // (vertices)
    __global const uint *listed,    // (lists)
    __global uint *chunk_counts,    // (places)
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint runs = 0, end = min(listed[LEVELS], (chunk + 1) * (uint)CHUNK);
    for (uint i = chunk * CHUNK; i < end; i++) runs += is_run_head(located, i);
    chunk_counts[chunk] = runs;
}

// One work-item per chunk of the sorted vertices: sum the runs that begin in it, and merge them into their cells.
ONE_BY_ONE __kernel __attribute__((reqd_work_group_size(1, 1, 1))) void reduce_vertices(
    __global const ulong *located,         // (vertices)
    __global const uint *located_row,      // (vertices, 8)
    __global const uint *listed,           // (lists)
    __global const uint *chunk_counts,     // (places)
    __global uint *octree_cells,           // (cells, 6)
    __global ulong *record_key,            // (vertices)
    __global uint *record_cell,            // (vertices)
    __global uint *record_normal,          // (vertices)
    __global float *record_sum,            // (vertices, 8)
    __global volatile uint *octree_wipe,   // (4)
    __global volatile uint *counters,      // (counters)
    uint update,
    uint key0,
    uint key1,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint entries = listed[LEVELS], i = chunk * CHUNK, end = min(entries, (chunk + 1) * (uint)CHUNK);
    uint record = chunk_counts[chunk], wipe = octree_wipe[WIPE_STAMP];
    Begun begun = { 0, 0 };
    while (i < end && !is_run_head(located, i)) i++;
    while (i < end) {
        uint cell = (uint)(located[i] >> 32);
        uint8 first = vload8((uint)located[i], located_row);
        uint normal = front_of(octree_cells + words_of_cell(cell), wipe, first.s3, &begun);
        Vec3 front = unfold_normal(normal);
        Sum sum = { (float8)(0.0f), (float8)(0.0f) };
        do {
            ulong later = located[min(i + AHEAD, entries - 1)];
            expect_words(octree_cells + words_of_cell((uint)(later >> 32)));
            expect(located_row + 8 * (size_t)(uint)later);
            uint8 row = vload8((uint)located[i], located_row);
            float8 light = (float8)(as_float(row.s0), as_float(row.s1), as_float(row.s2), 1.0f, 0.0f, 0.0f, 0.0f, 0.0f);
            light = min(light, MOST_LIGHT);
            bool is_front = dot3(unfold_normal(row.s3), front) > 0.0f;
            add_to_sum(&sum, is_front ? light : light.s45670123);
            i++;
        } while (i < entries && !is_run_head(located, i));
        record_key[record] = (ulong)first.s5 << 32 | first.s4;
        record_cell[record] = cell;
        record_normal[record] = normal;
        vstore8(sum.value, record, record_sum);
        record++;
    }
    Records made = { record_cell, record_normal, record_sum };
    merge_records(octree_cells, made, chunk_counts[chunk], record, wipe, update, key0, key1);
    tally_begun(octree_wipe, counters, begun);
}

inline bool is_family_head(__global const ulong *record_key, uint i)
{
    return i == 0 || (record_key[i] ^ record_key[i - 1]) >> 3 != 0;
}

// One work-item per chunk of a level's records: how many families, records with a parent in common, begin in it.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void count_families(
    __global const ulong *record_key,  // (vertices)
    __global const uint *listed,       // (lists)
    __global uint *chunk_counts,       // (places)
    uint level,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint families = 0, end = min(listed[level], (chunk + 1) * (uint)CHUNK);
    for (uint i = chunk * CHUNK; i < end; i++) families += is_family_head(record_key, i);
    chunk_counts[chunk] = families;
}

// One work-item per chunk of a level's records: the parents of the families that begin in it.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void find_parents(
    __global const ulong *record_key,      // (vertices)
    __global const uint *listed,           // (lists)
    __global const uint *chunk_counts,     // (places)
    __global const ulong *octree_table,    // (entries)
    __global const uint *octree_tables,    // (tables, 4)
    __global ulong *parent_key,            // (vertices)
    __global uint *parent_cell,            // (vertices)
    uint level,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint begin = chunk * CHUNK, end = min(listed[level], begin + (uint)CHUNK);
    uint first = chunk_counts[chunk], last = first;
    CellTables tables = { octree_table, octree_tables };
    for (uint i = begin; i < end; i++) {
        if (!is_family_head(record_key, i)) continue;
        parent_key[last] = record_key[i] >> 3;
        expect_cell(&tables, parent_key[last], level - 1);
        last++;
    }
    for (uint parent = first; parent < last; parent++) parent_cell[parent] = find_cell(&tables, parent_key[parent], level - 1);
}

// One work-item per chunk of a level's records: sum the families that begin in it, and merge them into the parents. A child's
// front is its parent's front if their normals are on one side, else its back.
ONE_BY_ONE __kernel __attribute__((reqd_work_group_size(1, 1, 1))) void reduce_families(
    __global const ulong *record_key,      // (vertices)
    __global const uint *record_normal,    // (vertices)
    __global const float *record_sum,      // (vertices, 8)
    __global const uint *listed,           // (lists)
    __global const uint *chunk_counts,     // (places)
    __global uint *octree_cells,           // (cells, 6)
    __global const uint *parent_cell,      // (vertices)
    __global uint *parent_normal,          // (vertices)
    __global float *parent_sum,            // (vertices, 8)
    __global volatile uint *octree_wipe,   // (4)
    __global volatile uint *counters,      // (counters)
    uint level,
    uint update,
    uint key0,
    uint key1,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint records = listed[level], parents = listed[level - 1], i = chunk * CHUNK, end = min(records, (chunk + 1) * (uint)CHUNK);
    uint parent = chunk_counts[chunk], wipe = octree_wipe[WIPE_STAMP];
    Begun begun = { 0, 0 };
    while (i < end && !is_family_head(record_key, i)) i++;
    while (i < end) {
        uint cell = parent_cell[parent];
        expect_words(octree_cells + words_of_cell(parent_cell[min(parent + AHEAD, parents - 1)]));
        __global uint *words = octree_cells + words_of_cell(cell);
        uint normal = front_of(words, wipe, record_normal[i], &begun);
        Vec3 front = unfold_normal(normal);
        float8 sum = 0.0f;
        do {
            float8 of_child = vload8(i, record_sum);
            bool is_alike = dot3(unfold_normal(record_normal[i]), front) > 0.0f;
            sum += is_alike ? of_child : of_child.s45670123;
            i++;
        } while (i < records && !is_family_head(record_key, i));
        parent_normal[parent] = normal;
        vstore8(sum, parent, parent_sum);
        parent++;
    }
    Records made = { parent_cell, parent_normal, parent_sum };
    merge_records(octree_cells, made, chunk_counts[chunk], parent, wipe, update, key0, key1);
    tally_begun(octree_wipe, counters, begun);
}

// One work-item: how many cells are in use, and how many there are.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void tally_cells(
    __global const uint *octree_wipe,  // (4)
    __global uint *counters,           // (counters)
    uint cells)
{
    if (get_global_id(0) > 0 || cells == 0) return;
    counters[COUNT_OCCUPIED] = octree_wipe[WIPE_OCCUPIED];
    counters[COUNT_CAPACITY] = cells;
}
