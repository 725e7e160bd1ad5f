// A device that runs this right can run the project's kernels: wide vectors, contraction switched off, 64-bit
// integers, a barrier over local memory, and 32-bit atomics on global memory, among them a bounded compare-and-exchange.
// Reads a, b: 16 floats per work-item. Writes product_sum (16 floats per item), mixed and mirrored (one element per item)
// and counters: sum, maximum and number of the items.
#pragma OPENCL FP_CONTRACT OFF

#define GROUP 64
#define MAX_TRIES 1000000

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void probe(__global const float *a, __global const float *b, __global float *product_sum, __global ulong *mixed,
           __global uint *mirrored, __global volatile uint *counters)
{
    const uint item = get_global_id(0);
    const uint lane = get_local_id(0);
    __local uint exchange[GROUP];

    // Two roundings, not the one of a fused multiply-add.
    const float16 wide = vload16(item, a) * vload16(item, b) + vload16(item, a);
    const float8 low_half = fmax(wide.lo, wide.hi);
    const float8 high_half = fmin(wide.lo, wide.hi);
    vstore8(low_half, 2 * item, product_sum);
    vstore8(high_half, 2 * item + 1, product_sum);

    ulong key = (item + 1) * 0x9E3779B97F4A7C15UL;
    key ^= key >> 30;
    mixed[item] = key * 0xBF58476D1CE4E5B9UL;

    exchange[lane] = item;
    barrier(CLK_LOCAL_MEM_FENCE);
    mirrored[item] = exchange[GROUP - 1 - lane];

    atomic_add(&counters[0], item);
    atomic_max(&counters[1], item);
    uint seen = counters[2];
    for (int i = 0; i < MAX_TRIES; i++) {
        const uint found = atomic_cmpxchg(&counters[2], seen, seen + 1);
        if (found == seen)
            break;
        seen = found;
    }
}
