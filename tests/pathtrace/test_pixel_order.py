"""Which pixel a path belongs to: a permutation in blocks, with whatever the blocks have too much left out."""

import numpy as np
import pytest
from kernel_source import build

from clcache.passes.trace import path_count

SOURCE = """
#include "common/pixel_order.cl"

__kernel void there(
    __global uint *pixel,  // (n)
    uint n,
    uint width,
    uint height)
{
    uint i = get_global_id(0);
    if (i < n) pixel[i] = pixel_of_path(i, width, height);
}

__kernel void back(
    __global uint *path,  // (n)
    uint n,
    uint width,
    uint height)
{
    uint i = get_global_id(0);
    if (i < n) path[i] = path_of_pixel(i % width, i / width, width, height);
}
"""
NONE = 0xFFFFFFFF
SIZES = [(1, 1), (3, 5), (4, 4), (5, 4), (4, 9), (37, 23), (640, 360), (1, 100), (100, 1), (33, 32), (9, 64), (50, 97)]


@pytest.fixture(scope="module")
def program(device, tmp_path_factory):
    """Both directions, each called by a kernel."""
    return build(device, SOURCE, tmp_path_factory.mktemp("cl"))


def run(device, program, kernel, n, size):
    out = device.empty(n, np.uint32)
    program[kernel](out, n, *size, count=n)
    return out.get()


@pytest.mark.parametrize("size", SIZES)
def test_every_pixel_has_one_path(device, program, size):
    pixels, n = size[0] * size[1], path_count(size)
    pixel = run(device, program, "there", n, size)
    np.testing.assert_array_equal(np.sort(pixel[pixel != NONE]), np.arange(pixels))
    path = run(device, program, "back", pixels, size)
    np.testing.assert_array_equal(pixel[path], np.arange(pixels))
    assert n % 16 == 0
    assert n < pixels + 4 * (size[0] + size[1] + 4) * 4


@pytest.mark.parametrize("size", SIZES)
def test_sixteen_paths_are_a_block(device, program, size):
    pixel = run(device, program, "there", path_count(size), size).reshape(-1, 16)
    for block in pixel:
        there = block[block != NONE]
        x, y = there % size[0], there // size[0]
        assert len({*(x // 4), -1}) == len({*(y // 4), -1}) == 2
        np.testing.assert_array_equal(np.flatnonzero(block != NONE), x % 4 + 4 * (y % 4))


def test_both_halves_of_the_paths_have_their_share_of_the_image(device, program):
    """Rows of pixels in the upper part of the image: as many in the first half of the paths as in the second."""
    size = (64, 256)
    pixel = run(device, program, "there", path_count(size), size)
    first, second = (np.bincount(half // size[0] // 64, minlength=4) for half in np.split(pixel, 2))
    np.testing.assert_array_equal(first, second)


def test_paths_near_each_other_see_near_pixels(device, program):
    """Those of a chunk in which rays are sorted lie in a piece of the image that is not much wider than it is high."""
    size = (1024, 256)
    pixel = run(device, program, "there", path_count(size), size).reshape(-1, 4096)
    width, height = (np.ptp(axis, axis=1) + 1 for axis in (pixel % size[0], pixel // size[0]))
    assert set(width) == {128}
    assert set(height) == {32}
