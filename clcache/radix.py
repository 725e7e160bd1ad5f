"""The host's part of the stable radix sort (`cl/bvh/radix.cl`)."""

import pyopencl as cl
import pyopencl.array as cl_array

from .program import Program

# Work-items that share a round; each counts a run of keys of its own.
CHUNKS = 64

Sorted = tuple[cl_array.Array, ...]


def radix_sort(
    program: Program, keys: Sorted, spare: Sorted, counts: cl_array.Array, n: int, first_bit: int, bits: int
) -> tuple[list[cl.Event | None], Sorted]:
    """Sort the first `n` keys by `bits` of their bits from `first_bit` on. program: built with what radix.cl defines.

    keys: ulong keys, and, where the program is ORDERED, uint numbers that go with them. spare: as many again. counts:
    (2^DIGIT_BITS, chunks) uint32. Returns the events, and which of `keys` and `spare` hold the result; the others are spent.
    """
    digits, chunks = counts.shape
    events = []
    for shift in range(first_bit, first_bit + bits, digits.bit_length() - 1):
        pairs = [array for pair in zip(keys, spare, strict=True) for array in pair]
        events += [
            program["radix_count"](keys[0], counts, n, chunks, shift, count=chunks),
            program["radix_offsets"](counts, chunks, count=1),
            program["radix_scatter"](*pairs, counts, n, chunks, shift, count=chunks),
        ]
        keys, spare = spare, keys
    return events, keys
