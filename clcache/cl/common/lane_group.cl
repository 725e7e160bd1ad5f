// Lane groups: LANES work-items that go through a kernel together and see each other's values (the waves of MaterialMemo,
// section 2.5.2). A work-group is one lane group. With NATIVE_SUBGROUPS it is a sub-group of the driver's, whose lanes need no memory
// to exchange values; else they do so through local memory, between barriers.
//
// A kernel has the attributes `reqd_work_group_size(32, 1, 1) IN_LANES`, and begins so; WORDS: how many words a lane offers at
// once, at least 1:
//
//     __local uint words[WORDS * LANES];
//     Lanes lanes = lanes_of(words);
//
// All lanes of a group call these functions, or none does.

#define LANES 32u

#if NATIVE_SUBGROUPS
#pragma OPENCL EXTENSION cl_khr_subgroups : enable
#pragma OPENCL EXTENSION cl_khr_subgroup_ballot : enable
#pragma OPENCL EXTENSION cl_khr_subgroup_shuffle : enable
#define IN_LANES , intel_reqd_sub_group_size(32)
#elif __has_attribute(intel_vec_len_hint)
#define IN_LANES , intel_vec_len_hint(1)  // ONE_BY_ONE of math.cl
#else
#define IN_LANES
#endif

typedef struct Lanes {
    __local uint *words;  // (WORDS, LANES), for what is exchanged
    uint id;
} Lanes;

inline Lanes lanes_of(__local uint *words)
{
    Lanes lanes = { words, (uint)get_local_id(0) };
    return lanes;
}

inline uint lane_id(const Lanes *lanes)
{
    return lanes->id;
}

// What lanes offered, or wrote to global memory, is there for all.
inline void lane_barrier()
{
#if NATIVE_SUBGROUPS
    sub_group_barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
#else
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
#endif
}

// Several words at once: each lane offers values of its own, passes a barrier, takes what any lane offered under the same number,
// and passes another before it offers anew.
inline void lane_offer(const Lanes *lanes, uint word, uint value)
{
#if !NATIVE_SUBGROUPS
    lanes->words[word * LANES + lanes->id] = value;
#endif
}

// own: what this lane offered.
inline uint lane_take(const Lanes *lanes, uint word, uint own, uint lane)
{
#if NATIVE_SUBGROUPS
    return sub_group_shuffle(own, lane);
#else
    return lanes->words[word * LANES + lane];
#endif
}

// The value of a lane that each lane chooses.
inline uint __attribute__((overloadable)) lane_shuffle(const Lanes *lanes, uint value, uint lane)
{
#if NATIVE_SUBGROUPS
    return sub_group_shuffle(value, lane);
#else
    lane_offer(lanes, 0, value);
    lane_barrier();
    uint found = lane_take(lanes, 0, value, lane);
    lane_barrier();
    return found;
#endif
}

inline float __attribute__((overloadable)) lane_shuffle(const Lanes *lanes, float value, uint lane)
{
    return as_float(lane_shuffle(lanes, as_uint(value), lane));
}

// The value of one lane, the same for all.
inline uint __attribute__((overloadable)) lane_broadcast(const Lanes *lanes, uint value, uint lane)
{
    return lane_shuffle(lanes, value, lane);
}

inline float __attribute__((overloadable)) lane_broadcast(const Lanes *lanes, float value, uint lane)
{
    return lane_shuffle(lanes, value, lane);
}

// The lanes of which something is true, as bits.
inline uint lane_ballot(const Lanes *lanes, bool value)
{
#if NATIVE_SUBGROUPS
    return sub_group_ballot(value).x;
#else
    lane_offer(lanes, 0, (uint)value << lanes->id);
    lane_barrier();
    uint all = 0;
    for (uint lane = 0; lane < LANES; lane++) all |= lanes->words[lane];
    lane_barrier();
    return all;
#endif
}

// The least of the lanes' values.
inline uint lane_min(const Lanes *lanes, uint value)
{
#if NATIVE_SUBGROUPS
    return sub_group_reduce_min(value);
#else
    lane_offer(lanes, 0, value);
    lane_barrier();
    uint least = value;
    for (uint lane = 0; lane < LANES; lane++) least = min(least, lanes->words[lane]);
    lane_barrier();
    return least;
#endif
}

// The first of some lanes, which are one at least.
inline uint first_lane(uint lanes)
{
    return 31u - clz(lanes & (0u - lanes));
}
