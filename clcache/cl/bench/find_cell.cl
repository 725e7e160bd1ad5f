// Finding cells of an octree by their keys, and nothing else (OctreeCache, section 3.1).

#include "octree/find.cl"

// One work-item per key: the index of its cell, or NONE.
__kernel void find_cells(
    __global const ulong *keys,          // (n)
    __global uint *found,                // (n)
    __global const ulong *octree_table,  // (entries)
    __global const uint *octree_tables,  // (tables, 4)
    uint level,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    CellTables tables = {octree_table, octree_tables};
    found[i] = find_cell(&tables, keys[i], level);
}
