// Which slots of a pixel hold a sample, and which of these are visible (SampleCache, section 3): bit s of the pixel's mask says
// that slot s is occupied, bit s + SLOTS that its sample is visible. Up to 16 slots fit a mask of one word, up to 32 one of two.
//
// Defines: SLOTS, WORDS.

#include "common/math.cl"

#if WORDS == 2
typedef ulong Mask;
#else
typedef uint Mask;
#endif

#define ALL_SLOTS ((uint)((1ul << SLOTS) - 1))

inline Mask load_mask(__global const uint *mask, uint pixel)
{
#if WORDS == 2
    return (ulong)mask[2 * pixel + 1] << 32 | mask[2 * pixel];
#else
    return mask[pixel];
#endif
}

inline void store_mask(__global uint *mask, uint pixel, Mask m)
{
#if WORDS == 2
    mask[2 * pixel] = (uint)m;
    mask[2 * pixel + 1] = (uint)(m >> 32);
#else
    mask[pixel] = m;
#endif
}

// Sets of slots, one bit each, to a mask and back.
inline Mask make_mask(uint occupied, uint visible)
{
    return (Mask)visible << SLOTS | occupied;
}

inline uint occupied_slots(Mask m)
{
    return (uint)m & ALL_SLOTS;
}

inline uint visible_slots(Mask m)
{
    return (uint)(m >> SLOTS) & ALL_SLOTS;
}

// Number of the lowest bit that is set; there must be one.
inline uint lowest_bit(uint bits)
{
    return 31 - clz(bits & (0 - bits));
}

// Number of the n-th bit that is set, from 0; there must be that many.
inline uint nth_bit(uint bits, uint n)
{
    for (; n > 0; n--) bits &= bits - 1;
    return lowest_bit(bits);
}

// One of some slots, each in its turn: a set of one, or of none.
inline uint round_robin(uint slots, uint turn)
{
    return slots ? 1u << nth_bit(slots, turn % popcount(slots)) : 0;
}
