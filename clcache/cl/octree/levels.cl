// The cells of each level, in the order of their keys (HashCache, section 3.1): those of the finest from the bits that
// occupy.cl set, counted by popcount; those of each level above from those below. A part's keys are its own, of 30 bits.
//
// Nothing here depends on the order in which work-items run: places are given by prefix sums, not by atomics.

#define SEGMENT 1024u  // words; as SEGMENT_BITS in occupy.cl

// One work-item per segment of words in which bits were set: how many.
__kernel void count_bits(
    __global const uint *bits,      // (words)
    __global const uint *segments,  // (n)
    __global uint *counts,          // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    __global const uint *words = bits + SEGMENT * segments[i];
    uint count = 0;
    for (uint k = 0; k < SEGMENT; k++) count += popcount(words[k]);
    counts[i] = count;
}

// One work-item per segment: the keys of its cells, from where its own begin on; the bits are cleared for the next part.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void list_cells(
    __global uint *bits,            // (words)
    __global const uint *segments,  // (n)
    __global const uint *offsets,   // (n)
    __global uint *keys,            // (cells)
    uint n,
    uint cells)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint first = SEGMENT * segments[i], place = offsets[i];
    for (uint word = first; word < first + SEGMENT; word++) {
        uint left = bits[word];
        for (; left != 0; left &= left - 1) keys[place++] = word << 5 | (31 - clz(left & -left));
        bits[word] = 0;
    }
}

inline bool begins_parent(__global const uint *keys, uint i)
{
    return i == 0 || keys[i] >> 3 != keys[i - 1] >> 3;
}

// One work-item per run of a part's cells: how many cells of the level above begin there.
__kernel void count_parents(
    __global const uint *keys,  // (n)
    __global uint *counts,      // (runs)
    uint n,
    uint runs)
{
    uint run = get_global_id(0), begin = run * RUN, end = min(begin + RUN, n), count = 0;
    if (run >= runs) return;
    for (uint i = begin; i < end; i++) count += begins_parent(keys, i) ? 1 : 0;
    counts[run] = count;
}

// One work-item per run of a part's cells: the keys of those above, which are in the eighth `octant` of their part where parts
// halve.
__kernel void list_parents(
    __global const uint *keys,     // (n)
    __global const uint *offsets,  // (runs)
    __global uint *parents,        // (cells)
    uint n,
    uint runs,
    uint cells,
    uint octant)
{
    uint run = get_global_id(0), begin = run * RUN, end = min(begin + RUN, n);
    if (run >= runs) return;
    uint place = offsets[run];
    for (uint i = begin; i < end; i++)
        if (begins_parent(keys, i)) parents[place++] = octant << 27 | keys[i] >> 3;
}
