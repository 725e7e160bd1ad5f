// The queue in which paths go from pass to pass: chunks of places, in each of which those that still have a ray come to stand
// in front (compact.cl).

#include "common/math.cl"

#define CHUNK 4096u  // places

// Leave where no place of this work-group has a path, all items together: one by one would save nothing, since the lanes of a
// vector go through all code alike. The barrier, which every item reaches or none, keeps PoCL from making it one by one. All
// items of the other groups must leave together, too, past a second barrier: PoCL takes a return behind the first one for the
// whole group's.
#define LEAVE_IDLE_GROUP(alive, n)              \
    if (group_is_idle((alive), (n))) return;    \
    barrier(CLK_LOCAL_MEM_FENCE)
#define LEAVE_TOGETHER barrier(CLK_LOCAL_MEM_FENCE)

INLINED bool group_is_idle(__global const uint *alive, uint n)
{
    uint first = (uint)get_group_id(0) * (uint)get_local_size(0), last = first + (uint)get_local_size(0) - 1;
    return first >= n || (first / CHUNK == last / CHUNK && first % CHUNK >= alive[first / CHUNK]);
}

// This item's place: get_global_id(0), which PoCL would work out ahead of the barrier, and then gather where neighbours are.
inline uint place_in_queue()
{
    return (uint)get_group_id(0) * (uint)get_local_size(0) + (uint)get_local_id(0);
}
