// Vertices of paths in the order of their cells (HashCache, section 3.2): find the finest cell of each, list those that have
// one as
//
//   cell (global index) << 32 | number in the list
//
// and sort these words by cell. The sort is stable, so vertices of a cell stay in order, whatever the number of threads.
//
// Defines: CHUNK: vertices, or entries of another list, that one work-item counts and moves in order; COUNT_...: places in
// `counters`; LEVELS: the place in `listed`, behind the levels of an octree, of how many vertices have a cell; those of
// bvh/radix.cl.

#include "bvh/radix.cl"
#include "octree/cell.cl"
#include "octree/expect.cl"

#define NO_VERTEX 0xFFFFFFFFFFFFFFFFul

// One work-item per chunk of vertices: their finest cells, NONE for those that have none, or whose light is not finite; how many
// have one; and count those that are left out.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void locate_vertices(
    __global const ulong *vertex_key,      // (vertices)
    __global const float *vertex_light,    // (3, vertices)
    __global const ulong *octree_table,    // (entries)
    __global const uint *octree_tables,    // (tables, 4)
    __global uint *vertex_cell,            // (vertices)
    __global uint *chunk_counts,           // (places)
    __global volatile uint *counters,      // (counters)
    uint finest,
    uint vertices,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    CellTables tables = { octree_table, octree_tables };
    uint begin = chunk * CHUNK, end = min(vertices, begin + (uint)CHUNK), located = 0, there = 0;
    for (uint vertex = begin; vertex < end; vertex++) expect_cell(&tables, vertex_key[vertex], finest);
    for (uint vertex = begin; vertex < end; vertex++) {
        ulong key = vertex_key[vertex];
        Vec3 light = load_vec3(vertex_light, vertices, vertex);
        uint cell = fabs(light.x + light.y + light.z) < INFINITY ? find_cell(&tables, key, finest) : NONE;
        vertex_cell[vertex] = cell;
        located += cell != NONE;
        there += key != NO_VERTEX;
    }
    chunk_counts[chunk] = located;
    if (located) atomic_add(counters + COUNT_INSERTED, located);
    if (there - located) atomic_add(counters + COUNT_DISCARDED, there - located);
}

// One work-item: exclusive prefix sums over the chunks, in place; the sum of all goes to one of the lists' lengths.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void sum_chunks(
    __global uint *chunk_counts,  // (places)
    __global uint *listed,        // (lists)
    uint list,
    uint chunks)
{
    if (get_global_id(0) > 0 || chunks == 0) return;
    uint sum = 0;
    for (uint chunk = 0; chunk < chunks; chunk++) {
        uint count = chunk_counts[chunk];
        chunk_counts[chunk] = sum;
        sum += count;
    }
    listed[list] = sum;
}

// One work-item per chunk of vertices: list those that have a cell, in order, and what is known of each in one row: the sort
// brings vertices together that are anywhere, and a row takes memory as long to bring as a word. A row: light, normal, key, two
// words unused.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void list_located(
    __global const ulong *vertex_key,     // (vertices)
    __global const uint *vertex_normal,   // (vertices)
    __global const float *vertex_light,   // (3, vertices)
    __global const uint *vertex_cell,     // (vertices)
    __global const uint *chunk_counts,    // (places)
    __global ulong *located,              // (vertices)
    __global uint *located_row,           // (vertices, 8)
    uint vertices,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint place = chunk_counts[chunk], end = min(vertices, (chunk + 1) * (uint)CHUNK);
    for (uint vertex = chunk * CHUNK; vertex < end; vertex++) {
        uint cell = vertex_cell[vertex];
        if (cell == NONE) continue;
        Vec3 light = load_vec3(vertex_light, vertices, vertex);
        ulong key = vertex_key[vertex];
        uint8 row = (uint8)(as_uint(light.x), as_uint(light.y), as_uint(light.z), vertex_normal[vertex],
                            (uint)key, (uint)(key >> 32), 0, 0);
        located[place] = (ulong)cell << 32 | place;
        vstore8(row, place, located_row);
        place++;
    }
}
