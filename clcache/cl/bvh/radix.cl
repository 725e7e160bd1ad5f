// A stable radix sort of keys, DIGIT_BITS of them a round: count the digits of each chunk of consecutive keys, sum over (digit,
// chunk), move. Each chunk is one work-item's, so that the order within it stays. The host's part is clcache/radix.py.
//
// Defines: DIGIT_BITS; ORDERED: a number goes with each key.

#define DIGITS (1u << DIGIT_BITS)

// One work-item per chunk of ceil(n / chunks) keys: how often each value of the digit occurs.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void radix_count(
    __global const ulong *keys,  // (places)
    __global uint *counts,       // (digits, chunks)
    uint n,
    uint chunks,
    uint shift)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint local_counts[DIGITS];
    for (uint digit = 0; digit < DIGITS; digit++) local_counts[digit] = 0;
    uint length = (n + chunks - 1) / chunks;
    uint end = min(n, (chunk + 1) * length);
    for (uint i = chunk * length; i < end; i++) local_counts[(uint)(keys[i] >> shift) & (DIGITS - 1)]++;
    for (uint digit = 0; digit < DIGITS; digit++) counts[digit * chunks + chunk] = local_counts[digit];
}

// One work-item in all: exclusive prefix sums over (digit, chunk), in place.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void radix_offsets(
    __global uint *counts,  // (digits, chunks)
    uint chunks)
{
    if (get_global_id(0) > 0) return;
    uint sum = 0;
    for (uint i = 0; i < DIGITS * chunks; i++) {
        uint count = counts[i];
        counts[i] = sum;
        sum += count;
    }
}

// One work-item per chunk: move its keys, in order, to where their digits' runs begin.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void radix_scatter(
    __global const ulong *keys,    // (places)
    __global ulong *sorted_keys,   // (places)
#if ORDERED
    __global const uint *order,    // (places)
    __global uint *sorted_order,   // (places)
#endif
    __global const uint *offsets,  // (digits, chunks)
    uint n,
    uint chunks,
    uint shift)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint next[DIGITS];
    for (uint digit = 0; digit < DIGITS; digit++) next[digit] = offsets[digit * chunks + chunk];
    uint length = (n + chunks - 1) / chunks;
    uint end = min(n, (chunk + 1) * length);
    for (uint i = chunk * length; i < end; i++) {
        ulong key = keys[i];
        uint place = next[(uint)(key >> shift) & (DIGITS - 1)]++;
        sorted_keys[place] = key;
#if ORDERED
        sorted_order[place] = order[i];
#endif
    }
}
