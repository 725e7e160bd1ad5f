"""A pixel's mask and sets of slots, against NumPy's 64-bit integers."""

import numpy as np
import pytest
from cache_model import join_mask, split_mask
from kernel_source import build

from clcache.passes.reproject import mask_words

SLOTS = (1, 12, 16, 17, 32)
SOURCE = """
#include "samplecache/mask.cl"

__kernel void masks(
    __global const uint *occupied,  // (n)
    __global const uint *visible,   // (n)
    __global uint *mask,            // (n, words)
    __global uint *copied,          // (n, words)
    __global uint *read,            // (2, n)
    uint n,
    uint words)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    store_mask(mask, i, make_mask(occupied[i], visible[i]));
    Mask m = load_mask(mask, i);
    store_mask(copied, n - 1 - i, m);
    read[i] = occupied_slots(m);
    read[n + i] = visible_slots(m);
}

__kernel void bits(
    __global const uint *set,  // (n)
    __global uint *found,      // (33, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    found[i] = lowest_bit(set[i]);
    for (uint k = 0; k < popcount(set[i]); k++) found[(1 + k) * n + i] = nth_bit(set[i], k);
}

__kernel void all_slots(__global uint *all,  // (n)
                        uint n)
{
    if (get_global_id(0) < n) all[get_global_id(0)] = ALL_SLOTS;
}
"""


def program_of(device, folder, slots):
    return build(device, SOURCE, folder, SLOTS=slots, WORDS=mask_words(slots))


def sets(slots, n, seed):
    """Random ones, of all densities, with none, each one alone, and all."""
    rng = np.random.default_rng(seed)
    dense = rng.random((n, slots)) < rng.random((n, 1))
    some = np.concatenate([dense, np.zeros((1, slots)), np.eye(slots), np.ones((1, slots))]).astype(np.uint64)
    return (some << np.arange(slots, dtype=np.uint64)).sum(axis=1, dtype=np.uint64).astype(np.uint32)


def test_words():
    assert [mask_words(s) for s in SLOTS] == [1, 1, 1, 2, 2]


@pytest.mark.parametrize("slots", SLOTS)
def test_masks_of_occupied_and_visible_slots(device, tmp_path, slots):
    occupied, visible = sets(slots, 3000, 1), np.random.default_rng(3).permutation(sets(slots, 3000, 2))
    n, words = len(occupied), mask_words(slots)
    mask, copied = (device.empty((n, words), np.uint32) for _ in range(2))
    read = device.empty((2, n), np.uint32)
    program = program_of(device, tmp_path, slots)
    program["masks"](device.upload(occupied), device.upload(visible), mask, copied, read, n, words, count=n)
    expected = occupied.astype(np.uint64) | visible.astype(np.uint64) << np.uint64(slots)
    np.testing.assert_array_equal(join_mask(mask.get()), expected)
    np.testing.assert_array_equal(mask.get(), split_mask(expected, slots))
    np.testing.assert_array_equal(copied.get(), mask.get()[::-1])
    np.testing.assert_array_equal(read.get(), [occupied, visible])


@pytest.mark.parametrize("slots", SLOTS)
def test_bits_in_order(device, tmp_path, slots):
    some = sets(slots, 3000, 4)
    some = some[some > 0]
    found = device.empty((33, len(some)), np.uint32)
    program_of(device, tmp_path, slots)["bits"](device.upload(some), found, len(some), count=len(some))
    lowest, *nth = found.get()
    is_set = (some[:, None] >> np.arange(32, dtype=np.uint32) & np.uint32(1)).astype(bool)
    np.testing.assert_array_equal(lowest, is_set.argmax(axis=1))
    for bits, places in zip(is_set, np.transpose(nth), strict=True):
        np.testing.assert_array_equal(places[: bits.sum()], np.flatnonzero(bits))


@pytest.mark.parametrize("slots", SLOTS)
def test_set_of_all_slots(device, tmp_path, slots):
    found = device.empty(1, np.uint32)
    program_of(device, tmp_path, slots)["all_slots"](found, 1, count=1)
    assert found.get()[0] == 2**slots - 1
