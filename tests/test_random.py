"""Random numbers: the same on host and device, evenly spread, and unrelated for different pixels, samples, seeds, frames.

Seeds are fixed: a test of significance 1e-4 either always passes or always fails.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from clcache.random import pcg4d, random4, stream_key

SIGNIFICANCE = 1e-4
WORDS = st.integers(0, 2**32 - 1) | st.sampled_from([0, 1, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1])
LONGS = st.integers(0, 2**64 - 1) | st.sampled_from([0, 1, 2**32 - 1, 2**32, 2**63, 2**64 - 1])

SOURCE = """
#include "common/random.cl"

__kernel void hash_words(
    __global const uint *v,  // (n, 4)
    __global uint *out,      // (n, 4)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Words words = pcg4d(v[4 * i], v[4 * i + 1], v[4 * i + 2], v[4 * i + 3]);
    vstore4((uint4)(words.x, words.y, words.z, words.w), i, out);
}

__kernel void numbers(
    __global const uint *pixel,  // (n)
    __global float *out,         // (n, 4)
    uint n,
    uint sample,
    uint dimension,
    uint key_low,
    uint key_high)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Random random = random4(pixel[i], sample, dimension, key_low, key_high);
    vstore4((float4)(random.x, random.y, random.z, random.w), i, out);
}
"""


@pytest.fixture(scope="module")
def program(device, tmp_path_factory):
    """The device's functions, each called by a kernel."""
    from clcache import program as module

    folder = tmp_path_factory.mktemp("cl")
    (folder / "common").symlink_to(module.SOURCE_FOLDER / "common")
    (folder / "random_test.cl").write_text(SOURCE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SOURCE_FOLDER", folder)
        return device.program("random_test.cl")


# Host and device


def test_hash_of_edge_values(device, program):
    edge = np.array([0, 1, 2, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF], np.uint32)
    v = np.stack(np.meshgrid(*[edge] * 4), axis=-1).reshape(-1, 4)
    out = device.empty(v.shape, np.uint32)
    program["hash_words"](device.upload(v), out, len(v), count=len(v))
    np.testing.assert_array_equal(out.get(), pcg4d(v))
    assert len(np.unique(pcg4d(v), axis=0)) == len(v)


def test_hash_of_random_words(device, program):
    v = np.random.default_rng(1).integers(0, 2**32, (100_000, 4), dtype=np.uint32)
    out = device.empty(v.shape, np.uint32)
    program["hash_words"](device.upload(v), out, len(v), count=len(v))
    np.testing.assert_array_equal(out.get(), pcg4d(v))


def test_hash_is_pcg4d():
    """The published function, in Python's integers."""

    def reference(x, y, z, w):
        m = 2**32
        x, y, z, w = ((c * 1664525 + 1013904223) % m for c in (x, y, z, w))
        for _ in range(2):
            x = (x + y * w) % m
            y = (y + z * x) % m
            z = (z + x * y) % m
            w = (w + y * z) % m
            if _ == 0:
                x, y, z, w = (c ^ (c >> 16) for c in (x, y, z, w))
        return x, y, z, w

    v = np.random.default_rng(2).integers(0, 2**32, (200, 4), dtype=np.uint32)
    assert [tuple(row) for row in pcg4d(v).tolist()] == [reference(*row) for row in v.tolist()]


@settings(max_examples=50, deadline=None)
@given(sample=WORDS, dimension=WORDS, seed=LONGS, frame=LONGS)
def test_numbers_are_the_hosts(device, program, sample, dimension, seed, frame):
    pixel = np.array([0, 1, 2, 12345, 2**31, 2**32 - 1], np.uint32)
    out = device.empty((len(pixel), 4), np.float32)
    key = stream_key(seed, frame)
    program["numbers"](device.upload(pixel), out, len(pixel), sample, dimension, *key, count=len(pixel))
    host = random4(pixel, sample, dimension, key)
    assert host.dtype == np.float32
    assert out.get().tobytes() == host.tobytes()


def test_numbers_lie_in_the_unit_interval_on_the_lattice():
    x = random4(np.arange(1_000_000, dtype=np.uint32), 0, 0, stream_key(0, 0))
    assert x.min() >= 0
    assert x.max() < 1
    scaled = x.astype(np.float64) * 2**24
    np.testing.assert_array_equal(scaled, np.floor(scaled))
    assert np.unique(scaled.astype(np.int64) & 1).size == 2


# Keys


@given(st.tuples(LONGS, LONGS), st.tuples(LONGS, LONGS))
def test_keys_are_two_words_that_differ_where_seed_or_frame_does(first, second):
    keys = stream_key(*first), stream_key(*second)
    assert all(0 <= word < 2**32 for key in keys for word in key)
    assert (keys[0] == keys[1]) == (first == second)


def test_keys_of_seeds_and_frames_are_all_different():
    keys = {stream_key(seed, frame) for seed in range(300) for frame in range(300)}
    assert len(keys) == 90_000


@pytest.mark.parametrize("bit", [0, 1, 31, 32, 63])
def test_every_bit_of_seed_and_frame_changes_half_of_the_key(bit):
    def word(seed, frame):
        low, high = stream_key(seed, frame)
        return low | high << 32

    for changed in ((1 << bit, 0), (0, 1 << bit)):
        flipped = [
            (word(s, f) ^ word(s ^ changed[0], f ^ changed[1])).bit_count() for s in range(20) for f in range(20)
        ]
        assert abs(np.mean(flipped) - 32) < 4 * 4 / np.sqrt(len(flipped))  # four standard errors, each flip 4 bits


# Statistics


def many(change, n=2**16):
    """(n, 4) numbers of which only one input differs. change: the input."""
    k = np.arange(n, dtype=np.uint32)
    if change == "pixel":
        return random4(k, 3, 5, stream_key(7, 11))
    zero = np.zeros(1, np.uint32)
    n_slow = 2**13
    if change == "sample":
        return np.concatenate([random4(zero, s, 5, stream_key(7, 11)) for s in range(n_slow)])
    if change == "dimension":
        return np.concatenate([random4(zero, 3, d, stream_key(7, 11)) for d in range(n_slow)])
    if change == "seed":
        return np.concatenate([random4(zero, 3, 5, stream_key(s, 11)) for s in range(n_slow)])
    return np.concatenate([random4(zero, 3, 5, stream_key(7, f)) for f in range(n_slow)])


CHANGES = ["pixel", "sample", "dimension", "seed", "frame"]


@pytest.mark.parametrize("change", CHANGES)
def test_numbers_are_uniform(change):
    x = many(change)
    for component in x.T:
        assert stats.kstest(component, "uniform").pvalue > SIGNIFICANCE
        assert stats.chisquare(np.bincount((component * 64).astype(int), minlength=64)).pvalue > SIGNIFICANCE
        low_bits = (component.astype(np.float64) * 2**24).astype(np.int64) & 63
        assert stats.chisquare(np.bincount(low_bits, minlength=64)).pvalue > SIGNIFICANCE


@pytest.mark.parametrize("change", CHANGES)
def test_pairs_are_uniform(change):
    """Components of one call with each other, and each with itself a step, and a power of two of steps, later."""
    x = (many(change) * 8).astype(int)
    pairs = [(x[:, a], x[:, b]) for a in range(4) for b in range(a)]
    pairs += [(x[:-step, c], x[step:, c]) for c in range(4) for step in (1, 2, 16, 64, 1024)]
    for first, second in pairs:
        assert stats.chisquare(np.bincount(8 * first + second, minlength=64)).pvalue > SIGNIFICANCE


@pytest.mark.parametrize("change", CHANGES)
def test_neighbours_are_uncorrelated(change):
    x = many(change).astype(np.float64)
    for lag in (1, 2, 3, 64):
        for component in x.T:
            r = np.corrcoef(component[:-lag], component[lag:])[0, 1]
            assert abs(r) < stats.norm.isf(SIGNIFICANCE / 2) / np.sqrt(len(component) - lag)


@pytest.mark.parametrize(
    "other",
    [
        (4, 5, stream_key(7, 11)),
        (3, 6, stream_key(7, 11)),
        (5, 3, stream_key(7, 11)),
        (3, 5, stream_key(8, 11)),
        (3, 5, stream_key(7, 12)),
        (3, 5, stream_key(11, 7)),
    ],
    ids=["sample", "dimension", "sample and dimension swapped", "seed", "frame", "seed and frame swapped"],
)
def test_streams_over_pixels_are_unrelated(other):
    n = 2**16
    pixel = np.arange(n, dtype=np.uint32)
    first, second = random4(pixel, 3, 5, stream_key(7, 11)), random4(pixel, *other)
    for a in range(4):
        for b in range(4):
            r = np.corrcoef(first[:, a], second[:, b])[0, 1]
            assert abs(r) < stats.norm.isf(SIGNIFICANCE / 2) / np.sqrt(n)
            joint = 8 * (first[:, a] * 8).astype(int) + (second[:, b] * 8).astype(int)
            assert stats.chisquare(np.bincount(joint, minlength=64)).pvalue > SIGNIFICANCE


def test_the_tests_notice_a_poor_generator():
    """A multiplicative sequence in the place of the hash: uniform, and correlated with its neighbours."""
    x = (np.arange(2**16) * 0.001) % 1
    assert stats.kstest(x, "uniform").pvalue > SIGNIFICANCE
    joint = 8 * (x[:-1] * 8).astype(int) + (x[1:] * 8).astype(int)
    assert stats.chisquare(np.bincount(joint, minlength=64)).pvalue < SIGNIFICANCE
