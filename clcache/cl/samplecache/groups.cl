// Lists of samples. What decides about samples goes through a group's pixels one after the other, one work-item per group, and
// writes those that something is to be done with to a list; what is done with them runs over the list, in vectors. A group is
// so many paths in a row (common/pixel_order.cl), so that what follows each other in a list lies near each other in the image.

#include "common/math.cl"

#define GROUP 64u   // paths: four blocks of pixels
#define BLOCKS 4u   // of a group
#define LANES 16u   // paths of a block
#define RUN 64u     // pixels along the rows, or entries of a list, that one work-item goes through

// Places for so many entries at the end of a list: where they begin.
inline uint take(__global volatile uint *length, uint count)
{
    return count > 0 ? atomic_add(length, count) : 0;
}

// The same, all within one of the batches of so many entries in which a list is worked off: what a group has to say of one pixel
// stays together, whichever group comes first. Places that are left over at a batch's end, fewer than the group needs, name no
// sample.
inline uint take_together(__global volatile uint *length, __global uint *list, uint count, uint batch)
{
    if (count == 0) return 0;
    uint before = *length, at, found;
    for (;;) {
        at = before / batch == (before + count - 1) / batch ? before : (before / batch + 1) * batch;
        found = atomic_cmpxchg(length, before, at + count);
        if (found == before) break;
        before = found;
    }
    for (uint i = before; i < at; i++) list[i] = NONE;
    return at;
}
