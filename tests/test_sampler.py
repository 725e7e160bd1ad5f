"""The Owen-scrambled Sobol numbers: nets, a model in NumPy, no relation between pixels and dimensions, and less noise."""

import numpy as np
import pytest
from helpers import IDENTITY
from kernel_source import build
from render_helpers import ball, floor, grey, lit, render, shape_mesh, view
from scipy import stats

from clcache import Renderer
from clcache.metrics import relmse
from clcache.random import pcg4d, stream_key
from clcache.scene.generators import plane
from clcache.scene.model import Environment, Material

SOURCE = """
#include "common/sampler.cl"

__kernel void numbers(
    __global const uint *pixel,      // (n)
    __global const uint *sample,     // (n)
    __global const uint *dimension,  // (n)
    __global float *out,             // (n, 4)
    uint n,
    uint key0,
    uint key1)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Random random = sample4(pixel[i], sample[i], dimension[i], key0, key1);
    vstore4((float4)(random.x, random.y, random.z, random.w), i, out);
}

__kernel void scrambled(
    __global const uint *v,  // (n)
    __global uint *out,      // (n)
    uint n,
    uint seed)
{
    uint i = get_global_id(0);
    if (i < n) out[i] = reverse_bits(scramble_reversed(reverse_bits(v[i]), seed));
}

__kernel void second(
    __global const uint *index,  // (n)
    __global uint *out,          // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) out[i] = reverse_bits(sobol_second_reversed(index[i]));
}
"""


@pytest.fixture(scope="module")
def program(device, tmp_path_factory):
    """The device's functions, each called by a kernel."""
    return build(device, SOURCE, tmp_path_factory.mktemp("cl"), SOBOL=True)


def numbers(device, program, pixel, sample, dimension, key=(3, 4)):
    """(n, 4)"""
    arrays = [np.ascontiguousarray(a, np.uint32) for a in np.broadcast_arrays(pixel, sample, dimension)]
    n = arrays[0].size
    out = device.empty((n, 4), np.float32)
    program["numbers"](*(device.upload(a.ravel()) for a in arrays), out, n, *key, count=n)
    return out.get()


def scrambled(device, program, v, seed):
    out = device.empty(len(v), np.uint32)
    program["scrambled"](device.upload(np.asarray(v, np.uint32)), out, len(v), seed, count=len(v))
    return out.get()


def bits(v):
    """(n, 32): the bits of each number, the highest first."""
    return (np.asarray(v, np.uint32)[:, None] >> np.arange(31, -1, -1, dtype=np.uint32)) & np.uint32(1)


def directions():
    """(32,) direction numbers of the second Sobol dimension (Joe and Kuo 2008: degree 1, m1 = 1): v_k = v_(k-1) ^ v_(k-1) >> 1."""
    v = [1 << 31]
    for _ in range(31):
        v.append(v[-1] ^ v[-1] >> 1)
    return np.array(v, np.uint32)


def sobol(index):
    """The second dimension of the sequence's points."""
    index = np.asarray(index, np.uint32)
    result = np.zeros_like(index)
    for k, v in enumerate(directions()):
        result ^= np.where(index >> np.uint32(k) & np.uint32(1), v, np.uint32(0))
    return result


# Scrambling


def test_scrambling_is_owens(device, program):
    """Each bit is flipped or not depending on the higher ones alone: numbers that agree in their first k bits agree there
    afterwards, and differ at the next bit if they did before. So it is a bijection, too."""
    rng = np.random.default_rng(1)
    for seed in (0, 1, 0xFFFFFFFF, *rng.integers(0, 2**32, 5)):
        a = rng.integers(0, 2**32, 4096, dtype=np.uint32)
        k = rng.integers(0, 32, 4096)
        differ_first_at = np.uint32(1) << (31 - k).astype(np.uint32)
        below = rng.integers(0, 2**32, 4096, dtype=np.uint32) & (differ_first_at - np.uint32(1))
        b = a ^ differ_first_at ^ below
        apart = bits(scrambled(device, program, a, int(seed)) ^ scrambled(device, program, b, int(seed)))
        np.testing.assert_array_equal(np.argmax(apart, axis=1), k)


def test_flips_are_even_and_depend_on_what_is_above(device, program):
    """Over seeds, each of a number's bits is flipped half of the time, and so is each that follows a different prefix, on its
    own account. |z| below 5 for 32 bits and 16 prefixes."""
    seeds = np.random.default_rng(2).integers(0, 2**32, 2000)
    v = np.arange(16, dtype=np.uint32) << np.uint32(28)
    flips = np.array([bits(scrambled(device, program, v, int(seed)) ^ v) for seed in seeds]).astype(float)
    z = (flips.mean(axis=0) - 0.5) * 2 * np.sqrt(len(seeds))
    assert np.abs(z).max() < 5
    lower = 2 * flips[:, :, 4:] - 1
    related = np.einsum("sib,sjb->ijb", lower, lower) / np.sqrt(len(seeds))  # of two prefixes' flips
    assert np.abs(related[~np.eye(16, dtype=bool)]).max() < 6


def test_second_dimension_is_sobols(device, program):
    index = np.concatenate([np.arange(5000), np.random.default_rng(3).integers(0, 2**32, 5000)]).astype(np.uint32)
    out = device.empty(len(index), np.uint32)
    program["second"](device.upload(index), out, len(index), count=len(index))
    np.testing.assert_array_equal(out.get(), sobol(index))


def test_numbers_follow_the_model(device, program):
    """Order, sequence and scrambling put together from the parts, for any pixel, dimension and key."""
    rng = np.random.default_rng(4)
    for pixel, dimension, key in ((0, 0, (0, 0)), (77, 3, (5, 6)), (2**32 - 1, 9, (2**32 - 1, 1))):
        sample = np.concatenate([np.arange(64), rng.integers(0, 2**31, 64)])
        found = numbers(device, program, pixel, sample, dimension, key)
        for pair in (0, 1):
            seeds = pcg4d(np.array([[pixel, 2 * dimension + pair, *key]], np.uint32))[0]
            index = scrambled(device, program, sample, int(seeds[0]))
            x = scrambled(device, program, np.packbits(bits(index)[:, ::-1], axis=1).view(">u4")[:, 0], int(seeds[1]))
            y = scrambled(device, program, sobol(index), int(seeds[2]))
            expected = np.column_stack([x, y]) >> 8
            np.testing.assert_array_equal(found[:, 2 * pair : 2 * pair + 2] * 2**24, expected)


# Nets


@pytest.mark.parametrize("k", [0, 1, 4, 8])
def test_first_samples_are_nets(device, program, k):
    """Of the first 2^k samples of a pair, every box of area 2^-k of whole halvings holds exactly one; and so do the next."""
    for pixel, dimension, part in ((0, 0, 0), (5, 2, 0), (5, 2, 1), (123456, 7, 3)):
        samples = np.arange(2**k) + part * 2**k
        points = numbers(device, program, pixel, samples, dimension)
        for pair in (points[:, :2], points[:, 2:]):
            for split in range(k + 1):
                boxes = np.floor(pair * [2**split, 2 ** (k - split)]).astype(int)
                assert len(np.unique(boxes, axis=0)) == 2**k


def test_numbers_are_below_one_and_evenly_spread(device, program):
    found = numbers(device, program, np.arange(200_000), 7, 3)
    assert found.min() >= 0 and found.max() < 1
    for column in found.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3


def test_pixels_dimensions_seeds_and_frames_are_unrelated(device, program):
    """Correlations of one sample's numbers over 65,536 pixels: between components, dimensions, neighbours, keys and samples."""
    n, pixel = 2**16, np.arange(2**16)
    first = numbers(device, program, pixel, 0, 1, stream_key(0, 0))
    others = [
        numbers(device, program, pixel, 0, 2, stream_key(0, 0)),
        numbers(device, program, pixel, 0, 1, stream_key(1, 0)),
        numbers(device, program, pixel, 0, 1, stream_key(0, 1)),
        numbers(device, program, pixel, 5, 2, stream_key(0, 0)),
        *(np.roll(first, -step, axis=0) for step in (1, 2, 64, 640)),
    ]
    columns = np.concatenate([first, *others], axis=1).T
    related = np.corrcoef(columns)[:4] * np.sqrt(n)
    assert np.abs(related[~np.eye(4, len(columns), dtype=bool)]).max() < 4.5


def test_pairs_are_unrelated_within_a_pixel(device, program):
    """Two pairs use the sequence in orders of their own: over a pixel's 256 samples no 2-D projection across them is less
    even than chance. Chi-square of 8 x 8 boxes, over 400 pixels."""
    total = np.zeros((4, 64))
    pixel, sample = np.repeat(np.arange(400), 256), np.tile(np.arange(256), 400)
    a, b = numbers(device, program, pixel, sample, 1), numbers(device, program, pixel, sample, 2)
    pairs = ((a[:, 0], a[:, 2]), (a[:, 1], a[:, 3]), (a[:, 0], b[:, 0]), (a[:, 1], b[:, 0]))
    for row, (x, y) in zip(total, pairs, strict=True):
        row += np.bincount((np.floor(x * 8) * 8 + np.floor(y * 8)).astype(int), minlength=64)
    assert min(stats.chisquare(row).pvalue for row in total) > 1e-3


def test_the_mean_is_not_biased(device, program):
    """Over pixels, the mean of a function by few samples is its integral. |z| below 3.3."""
    for samples in (1, 3, 16):
        pixel = np.repeat(np.arange(20_000 // samples), samples)
        x = numbers(device, program, pixel, np.arange(len(pixel)) % samples, 1).astype(np.float64)
        value = (x[:, 0] * x[:, 1] > 0.25).astype(float) * np.exp(x[:, 2])
        means = value.reshape(-1, samples).mean(axis=1)
        expected = (1 - 0.25 * (1 + np.log(4))) * (np.e - 1)
        assert abs(means.mean() - expected) < 3.3 * means.std(ddof=1) / np.sqrt(len(means))


# Rendering


def room():
    """A ball on a floor below a square lamp, and a sky: area light, soft shadow, one bounce."""
    lamp = shape_mesh(plane((1.0, 1.0)), 1)
    materials = [grey(0.6), Material("lamp", (0.0, 0.0, 0.0), emission=(8.0, 7.0, 6.0))]
    down = np.array([[1.0, 0, 0, 0], [0, -1, 0, 3], [0, 0, 1, 0]])
    return lit(
        floor(8), ball(0.8, 3), lamp, camera=view((0, 2.5, 4.5), (0, 0.6, 0)), materials=materials,
        environment=Environment.constant((0.1, 0.15, 0.2)),
        instances=[(0, IDENTITY), (1, IDENTITY + [[0, 0, 0, 0.0], [0, 0, 0, 0.8], [0] * 4]), (2, down)],
    )  # fmt: skip


@pytest.fixture(scope="module")
def errors():
    """relMSE of either sampler at 1, 16 and 256 samples per pixel."""
    scene, size = room(), (20, 14)
    truth = render(scene, size, 2048, bounces=1, seed=99, settings={"pathtrace.sampler": "sobol"}).color["mono"]
    return {
        name: [
            relmse(render(scene, size, spp, bounces=1, settings={"pathtrace.sampler": name}).color["mono"], truth)
            for spp in (1, 16, 256)
        ]
        for name in ("sobol", "independent")
    }


def test_sobol_has_less_noise(errors):
    """The default is the better one: alike at one sample, where nothing is to be spread; ahead from 16 on."""
    assert errors["sobol"][0] < 1.3 * errors["independent"][0]
    assert errors["sobol"][1] < 0.65 * errors["independent"][1]
    assert errors["sobol"][2] < 0.75 * errors["independent"][2]


def test_samplers_agree_on_the_image():
    """Means over the image, of frames, each with its own numbers: Welch's t-test."""
    means = []
    for name in ("sobol", "independent"):
        settings = {"pathtrace.sampler": name, "pathtrace.bounces": 1}
        frames = Renderer(room(), size=(24, 18), spp=16, settings=settings).frames(0, 12)
        means.append([frame.color["mono"].mean() for frame in frames])
    assert stats.ttest_ind(*means, equal_var=False).pvalue > 1e-3
