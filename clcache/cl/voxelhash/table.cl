// The hash table of the voxels (SampleCache, section 4): open addressing with linear probing. An entry's key is a 64-bit number
//
//   check hash (32 bits) | stamp of the last access (32 bits)        0: EMPTY, never used
//
// and its radiance four floats: 24 bytes. An entry that was not accessed for `lifetime` stamps is dead: it is not found any more, and
// may be overwritten. It is never emptied; so all before an entry on its way of probing are in use, and a search may end
// at the first that is EMPTY. (Where entries are emptied, a search has to go past the holes.)
//
// Stamps grow by two with each update, and are odd for the first eye and even for the second. They wrap around: only differences count.
//
// Neighbours on a surface stand side by side: places come in blocks, each of a tile of voxels (address.cl). Probing goes on to the
// same place of the next block, so that one tile does not push its own voxels aside.

#include "common/math.cl"

#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable

#define EMPTY 0ul
#define TILE 16u  // entries of a block

typedef struct Table {
    __global volatile ulong *keys;  // (capacity)
    uint capacity;
    uint probe;    // places that are looked at, at most
    uint stamp;    // of this access
    int lifetime;  // in stamps
} Table;

inline uint check_of(ulong key)
{
    return (uint)(key >> 32);
}

// How many stamps ago an entry was last accessed; below 0 where that was after this one (of another eye, in one of several updates).
inline int stamps_since(const Table *table, ulong key)
{
    return (int)(table->stamp - (uint)key);
}

inline bool is_live(const Table *table, ulong key)
{
    return key != EMPTY && stamps_since(table, key) <= table->lifetime;
}

inline uint next_place(const Table *table, uint place)
{
    uint next = place + TILE;
    return next < table->capacity ? next : next % table->capacity;
}

// The live entry with this check hash, at or behind `place`; NONE where there is none.
inline uint find_entry(const Table *table, uint place, uint check)
{
    for (uint k = 0; k < table->probe; k++) {
        ulong key = table->keys[place];
        if (key == EMPTY) break;
        if (check_of(key) == check && is_live(table, key)) return place;
        place = next_place(table, place);
    }
    return NONE;
}

// What became of a search.
typedef enum Outcome { HIT, INSERTED, EVICTED, DISCARDED } Outcome;  // EVICTED: inserted in place of a dead entry

// The same; where there is none, it is made, in the place of the key's own dead entry, else of the first that is free, and its stamp
// is the current one. NONE where no place is free.
//
// No key gets two entries, whatever other work-items do meanwhile. Free places may be taken, but none becomes free. Work-items that seek
// the same key therefore want the same place, unless one of them saw as free what another saw taken; and that one fails to get it,
// and begins anew.
inline uint find_or_insert(const Table *table, uint first, uint check, Outcome *outcome)
{
    ulong wanted = (ulong)check << 32 | table->stamp;
    for (;;) {
        uint place = first, free_place = NONE;
        ulong free_key = EMPTY;
        for (uint k = 0; k < table->probe; k++) {
            ulong key = table->keys[place];
            bool is_own = check_of(key) == check && key != EMPTY, is_free = !is_live(table, key);
            if (is_own && !is_free) {
                *outcome = HIT;
                return place;
            }
            if (is_free && (free_place == NONE || is_own)) {
                free_place = place;
                free_key = key;
            }
            if (key == EMPTY || is_own) break;
            place = next_place(table, place);
        }
        if (free_place == NONE) {
            *outcome = DISCARDED;
            return NONE;
        }
        ulong found = atom_cmpxchg(table->keys + free_place, free_key, wanted);
        if (found == free_key) {
            *outcome = free_key == EMPTY ? INSERTED : EVICTED;
            return free_place;
        }
        if (check_of(found) == check) {
            *outcome = HIT;
            return free_place;
        }
    }
}

// Give a live entry the current stamp, unless it has that or a later one, of the other eye's, already: the stamp that it had. While
// work-items look up, the check hash of a live entry does not change.
inline uint touch(const Table *table, uint entry)
{
    ulong key = table->keys[entry];
    if (stamps_since(table, key) <= 0) return (uint)key;
    return (uint)atom_xchg(table->keys + entry, (ulong)check_of(key) << 32 | table->stamp);
}
