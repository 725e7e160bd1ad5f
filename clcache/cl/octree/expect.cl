// Reading ahead: reads of a large octree's tables and cells miss all of the processor's caches, but many at once do not take
// longer than one.

#include "octree/find.cl"

// Have the memory bring what is read soon.
inline void expect(__global const void *place)
{
#if defined(__has_builtin) && !defined(NO_PREFETCH)
    __builtin_prefetch(place);
#endif
}

inline void expect_cell(const CellTables *tables, ulong key, uint level)
{
    if (key >> 3 * level != 0) return;
    __global const uint *table = tables->tables + TABLE_WORDS * table_of(key, level);
    uint within = (uint)key & PART_MASK;
    expect(tables->entries + BUCKET * (size_t)(table[0] + bucket_of(within, table[2], table[1])));
    expect(tables->entries + BUCKET * (size_t)(table[0] + bucket_of(within, table[3], table[1])));
}
