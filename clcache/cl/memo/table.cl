// The hash table of what graphs returned (MaterialMemo, sections 4.4, 4.5 and 5.3): open addressing with linear probing over `probe`
// places. A record is so many 32-bit words, in ENTRY layout with the values behind them:
//
//   0: key: the check hash, or EMPTY, LOCKED or DEAD      1: stamp of the last access
//   2: twice how many times it was written, and 1 more     3: stamp of when it was written
//      while it is
//   4, 5 (by counter): the table's clock when it was written (LRW) or last accessed (LRU), 64 bits
//
// Who writes exchanges the key with LOCKED first, and gives up where it was LOCKED already; the key comes last, and unlocks. Who reads
// makes sure that nothing was written meanwhile: that the key is the same before and after the value (READ_COUNTER 0; a key
// that went and came back is not noticed), or the count of writes (READ_COUNTER 1; nothing goes unnoticed: it is raised when a write
// begins and when it ends, for who writes may have the key that is asked for, and publish it in time).
//
// Keys never become EMPTY again, so that a search may end at the first that is. No key has two entries for long: who has
// written looks for a twin, and of the two the one that is further on becomes DEAD, which is taken for free. (One of two that write the
// same key at once sees the other, since exchanges order what stands before and behind them.)
//
// Stamps count frames of either eye; they wrap around, and only differences count.
//
// Defines: RECORD_WORDS, RECORD_STRIDE (words of a record, and from one to the next), READ_COUNTER, EVICTION.

#include "common/math.cl"

#define EMPTY 0u
#define LOCKED 1u
#define DEAD 2u
#define KEYS_FROM 3u  // check hashes

// Values of EVICTION, in the order of the setting's choices.
#define EVICT_NONE 0
#define EVICT_RANDOM 1
#define EVICT_LRW_FRAME 2
#define EVICT_LRU_FRAME 3
#define EVICT_LRW_COUNTER 4
#define EVICT_LRU_COUNTER 5
#define BY_COUNTER (EVICTION == EVICT_LRW_COUNTER || EVICTION == EVICT_LRU_COUNTER)

#if BY_COUNTER
#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
#endif

// Reads and writes of this work-item stay in order. Where the processor sees to that by itself, `volatile`, which keeps the compiler from
// changing it, is enough.
#if defined(__x86_64__) || defined(__i386__)
#define IN_ORDER
#else
#define IN_ORDER mem_fence(CLK_GLOBAL_MEM_FENCE)
#endif

typedef struct Table {
    __global volatile uint *records;  // (capacity, RECORD_STRIDE)
    __global volatile ulong *clock;   // (1), or null
    uint capacity;
    uint probe;  // places that are looked at, at most `capacity`
    uint stamp;  // of this access
} Table;

// What is counted, by each work-item for itself.
typedef struct MemoCounts {
    uint lookups, hits, inserted, evicted, discarded, occupied, distinct, duplicates, built;
} MemoCounts;

// Places of the counters in `memo_counters`, in the order of passes/materials.py.
typedef enum MemoCounter {
    COUNT_LOOKUPS, COUNT_HITS, COUNT_INSERTED, COUNT_EVICTED, COUNT_DISCARDED, COUNT_OCCUPIED, COUNT_CAPACITY, COUNT_DISTINCT,
    COUNT_DUPLICATES, COUNT_BUILT
} MemoCounter;

inline void add_count(__global volatile uint *counters, MemoCounter counter, uint count)
{
    if (count > 0) atomic_add(counters + counter, count);
}

inline void add_counts(__global volatile uint *counters, const MemoCounts *counts)
{
    add_count(counters, COUNT_LOOKUPS, counts->lookups);
    add_count(counters, COUNT_HITS, counts->hits);
    add_count(counters, COUNT_INSERTED, counts->inserted);
    add_count(counters, COUNT_EVICTED, counts->evicted);
    add_count(counters, COUNT_DISCARDED, counts->discarded);
    add_count(counters, COUNT_OCCUPIED, counts->occupied);  // modulo 2^32: below 0 where more died than came
    add_count(counters, COUNT_DISTINCT, counts->distinct);
    add_count(counters, COUNT_DUPLICATES, counts->duplicates);
    add_count(counters, COUNT_BUILT, counts->built);
}

inline __global volatile uint *record_of(const Table *table, uint entry)
{
    return table->records + (size_t)entry * RECORD_STRIDE;
}

// The entry with this check hash within `probe` places from `place`; NONE where there is none.
inline uint find_entry(const Table *table, uint place, uint check)
{
    for (uint k = 0; k < table->probe; k++) {
        uint key = *record_of(table, place + k);
        if (key == check) return place + k;
        if (key == EMPTY) return NONE;
    }
    return NONE;
}

// Before the value of a found entry is read: what `is_unchanged` needs to know.
inline uint begin_reading(const Table *table, uint entry)
{
#if READ_COUNTER
    uint version = record_of(table, entry)[2];
    IN_ORDER;
    return version;
#else
    return 0;
#endif
}

// After that: whether the value was that of this key all the time.
inline bool is_unchanged(const Table *table, uint entry, uint check, uint version)
{
    __global volatile uint *record = record_of(table, entry);
    IN_ORDER;
#if READ_COUNTER
    // The key is looked at once more since it may have changed between `find_entry` and `begin_reading`.
    bool is_key = record[0] == check;
    IN_ORDER;
    return is_key && record[2] == version;
#else
    return record[0] == check;
#endif
}

// Note that an entry was read.
inline void touch(const Table *table, uint entry, MemoCounts *counts)
{
    __global volatile uint *record = record_of(table, entry);
    if (record[1] != table->stamp && atomic_xchg(record + 1, table->stamp) != table->stamp) counts->distinct++;
#if EVICTION == EVICT_LRU_COUNTER
    *(__global volatile ulong *)(record + 4) = atom_inc(table->clock);
#endif
}

// How long ago an entry was of use, by the strategy: of several the one that is of the least use has the most.
inline ulong age_of(const Table *table, __global volatile uint *record)
{
#if EVICTION == EVICT_LRW_FRAME
    return table->stamp - record[3];
#elif EVICTION == EVICT_LRU_FRAME
    return table->stamp - record[1];
#elif BY_COUNTER
    return ~*(__global volatile ulong *)(record + 4);
#else
    return 0;
#endif
}

// An entry for a key that was not found, locked: to be written, and then published. NONE where it is not to be written: another has
// written the same key meanwhile, or is about to write here, or there is no room. draw: a random number.
inline uint lock_entry(const Table *table, uint place, uint check, uint draw, MemoCounts *counts)
{
    uint chosen = NONE;
    bool is_free = false;
    ulong oldest = 0;
    for (uint k = 0; k < table->probe; k++) {
        __global volatile uint *record = record_of(table, place + k);
        uint key = *record;
        if (key == check) {
            counts->duplicates++;
            return NONE;
        }
        if (key == EMPTY || key == DEAD) {
            chosen = is_free ? chosen : place + k;
            is_free = true;
            if (key == EMPTY) break;
        }
#if EVICTION != EVICT_NONE && EVICTION != EVICT_RANDOM
        else if (!is_free && key != LOCKED) {
            ulong age = age_of(table, record);
            if (chosen == NONE || age > oldest) {
                chosen = place + k;
                oldest = age;
            }
        }
#endif
    }
#if EVICTION == EVICT_RANDOM
    chosen = is_free ? chosen : place + draw % table->probe;
#endif
    uint before = chosen == NONE ? LOCKED : atomic_xchg(record_of(table, chosen), LOCKED);
    if (before == LOCKED) {
        counts->discarded++;
        return NONE;
    }
    counts->occupied += before == EMPTY || before == DEAD ? 1 : 0;
    counts->evicted += before != EMPTY && before != DEAD && before != check ? 1 : 0;
    IN_ORDER;
    record_of(table, chosen)[2]++;
    IN_ORDER;
    return chosen;
}

// Unlock an entry whose value has been written.
inline void publish_entry(const Table *table, uint place, uint entry, uint check, MemoCounts *counts)
{
    __global volatile uint *record = record_of(table, entry);
    IN_ORDER;
    record[2]++;
    record[1] = table->stamp;
    record[3] = table->stamp;
#if BY_COUNTER
    *(__global volatile ulong *)(record + 4) = atom_inc(table->clock);
#endif
    counts->inserted++;
    counts->distinct++;
    IN_ORDER;
    atomic_xchg(record, check);
    for (uint k = 0; k < table->probe; k++) {
        uint twin = place + k, key = *record_of(table, twin);
        if (key == EMPTY) break;
        if (key != check || twin == entry) continue;
        counts->duplicates++;
        bool is_dead = atomic_cmpxchg(record_of(table, max(twin, entry)), check, DEAD) == check;
        counts->occupied -= is_dead ? 1 : 0;
        if (twin < entry) break;
    }
}
