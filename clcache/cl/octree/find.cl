// Finding cells by their keys (HashCache, section 3.1; cuckoo hashing: Pagh and Rodler 2004, Alcantara et al. 2009; buckets:
// Dietzfelbinger and Weidling 2007). Each level has a table; level 11 one for each of its 8 parts of 1024^3 cells, level 12 for
// its 64. An entry is
//
//   key within the part (30 bits), << 32 | global index of the cell        ~0: EMPTY, whose upper half is no key
//
// and stands in one of the two buckets of four that its key hashes to. As the key is compared in full, an answer is right, or
// NONE. A table without cells is the first bucket, which stays empty.

#include "octree/shape.cl"

#define EMPTY 0xFFFFFFFFFFFFFFFFul
#define BUCKET 4u              // entries
#define PART_MASK ((1u << PART_BITS) - 1)
#define TABLE_WORDS 4          // of a row of `tables`

typedef struct CellTables {
    __global const ulong *entries;  // (entries)
    __global const uint *tables;    // (tables, 4): first bucket, number of buckets, seeds of the two hash functions
} CellTables;

// Which table a key of a level is in.
inline uint table_of(ulong key, uint level)
{
    uint part = (uint)(key >> PART_BITS);
    return level < 12 ? level + part : 19 + part;
}

// One of a table's buckets. Another seed, which is odd, is another function: a multiplication, and rounds of mixing (the
// constants are Wellons's). The largest digits of the product choose the bucket, so that any number of buckets will do.
inline uint bucket_of(uint key, uint seed, uint buckets)
{
    uint h = (key + 1) * seed;
    h = (h ^ h >> 16) * 0x7FEB352Du;
    h = (h ^ h >> 15) * 0x846CA68Bu;
    h ^= h >> 16;
    return (uint)((ulong)h * buckets >> 32);
}

// The global index of a level's cell, or NONE where the scene has nothing there. level: at most 12.
INLINED uint find_cell(const CellTables *tables, ulong key, uint level)
{
    bool is_key = key >> 3 * level == 0;
    __global const uint *table = tables->tables + TABLE_WORDS * (is_key ? table_of(key, level) : 0);
    uint within = (uint)key & PART_MASK, found = NONE;
    size_t first = BUCKET * (size_t)(table[0] + bucket_of(within, table[2], table[1]));
    size_t second = BUCKET * (size_t)(table[0] + bucket_of(within, table[3], table[1]));
    for (uint k = 0; k < BUCKET; k++) {
        ulong a = tables->entries[first + k], b = tables->entries[second + k];
        found = (uint)(a >> 32) == within ? (uint)a : found;
        found = (uint)(b >> 32) == within ? (uint)b : found;
    }
    return is_key ? found : NONE;
}
