// Building cuckoo tables (find.cl), all cells in parallel. A cell goes to a free entry of one of its two buckets; where there
// is none, it takes the place of another by exchange, and that one goes to its own other bucket, and so on. Exchanges lose
// nothing, whoever comes between. A way that gets too long fails, and with it the table, which is built again, larger and with
// other seeds.
//
// Which entry of its buckets a cell stands in depends on the order in which work-items run; what find_cell answers does not.

#include "octree/find.cl"

#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable

typedef struct Table {
    __global volatile ulong *entries;
    uint first, buckets, seeds[2];
} Table;

inline __global volatile ulong *places_of(const Table *table, uint bucket)
{
    return table->entries + BUCKET * (size_t)(table->first + bucket);
}

// Of an entry's two buckets the one that is not this.
inline uint other_bucket(const Table *table, ulong entry, uint bucket)
{
    uint key = (uint)(entry >> 32), first = bucket_of(key, table->seeds[0], table->buckets);
    return first != bucket ? first : bucket_of(key, table->seeds[1], table->buckets);
}

inline void prefetch_bucket(const Table *table, uint bucket)
{
#if defined(__has_builtin) && !defined(NO_PREFETCH)
    __builtin_prefetch((__global const void *)places_of(table, bucket), 1);
#endif
}

// Put an entry into a bucket, if it has a free place. What is read while others write is a hint only: if it is wrong, the
// exchange fails, or another place is taken.
inline bool put_entry(const Table *table, uint bucket, ulong entry)
{
    __global volatile ulong *places = places_of(table, bucket);
    for (;;) {
        uint is_free = 0;
        for (uint k = 0; k < BUCKET; k++) is_free |= places[k] == EMPTY ? 1u << k : 0;
        if (is_free == 0) return false;
        if (atom_cmpxchg(places + 31 - clz(is_free), EMPTY, entry) == EMPTY) return true;
    }
}

// Put an entry in the place of one of a bucket's, which is returned. round: to choose the place by, at random.
inline ulong exchange(const Table *table, uint bucket, ulong entry, uint round)
{
    uint place = ((uint)(entry >> 32) * 0x9E3779B9u + round * 0x85EBCA6Bu) >> 30;  // one of four
    return atom_xchg(places_of(table, bucket) + place, entry);
}

// One work-item per entry of some buckets.
__kernel void clear_buckets(
    __global ulong *entries,  // (entries)
    uint first_bucket,
    uint buckets)
{
    size_t i = get_global_id(0);
    if (i < BUCKET * (size_t)buckets) entries[BUCKET * (size_t)first_bucket + i] = EMPTY;
}

// One work-item per run of a table's cells, whose global indices follow each other. Those of a run move at once, each a step in
// each round, so that what they touch is fetched meanwhile.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void insert_cells(
    __global const uint *keys,         // (n)
    __global volatile ulong *entries,  // (entries)
    __global volatile uint *failed,    // (1)
    uint n,
    uint first_cell,
    uint first_bucket,
    uint buckets,
    uint seed0,
    uint seed1,
    uint most)
{
    uint begin = get_global_id(0) * RUN, end = min(begin + RUN, n);
    if (begin >= n) return;
    Table table = { entries, first_bucket, buckets, { seed0, seed1 } };
    ulong moving[RUN];  // entries on their way
    uint to[RUN];       // the bucket where each goes next
    uint left = end - begin;
    for (uint i = 0; i < left; i++) {
        uint key = keys[begin + i];
        moving[i] = (ulong)key << 32 | (first_cell + begin + i);
        to[i] = bucket_of(key, seed0, buckets);
        prefetch_bucket(&table, to[i]);
    }
    for (uint round = 0; left > 0 && round <= most; round++) {
        uint moved = 0;
        for (uint i = 0; i < left; i++) {
            if (put_entry(&table, to[i], moving[i])) continue;
            ulong entry = round > 0 ? exchange(&table, to[i], moving[i], round) : moving[i];
            if (entry == EMPTY) continue;
            uint next = other_bucket(&table, entry, to[i]);
            prefetch_bucket(&table, next);
            moving[moved] = entry;
            to[moved++] = next;
        }
        left = moved;
    }
    if (left > 0) atomic_or(failed, 1);
}
