"""Which voxel a point belongs to, and where the table has it (`cl/voxelhash/address.cl`), against a model."""

import numpy as np
import pytest
from helpers import random_directions
from voxelhash_model import BLOCK, CHECK_SEED, HIGHEST_LEVEL, LAYER_OFFSET, TILE, levels_of, voxels_of
from voxelhash_on_device import EYE, Addressing

from clcache.random import pcg4d


@pytest.fixture(scope="module")
def address(device, tmp_path_factory):
    return Addressing(device, tmp_path_factory.mktemp("address"))


def scattered(rng, n, size=10.0):
    points = rng.uniform(-size, size, (n, 3)).astype(np.float32)
    return points, random_directions(n, rng)


@pytest.mark.parametrize("incidence", [False, True], ids=["distance", "incidence"])
@pytest.mark.parametrize("factor", [1.0, 0.25, 8.0])
def test_levels(address, incidence, factor):
    """A voxel's edge is above half of what a pixel covers and no larger than that, on what is near, far and askew."""
    rng = np.random.default_rng(1)
    points, normals = scattered(rng, 20000)
    points = (EYE + points * 10.0 ** rng.uniform(-5, 5, (20000, 1))).astype(np.float32)
    level, *_ = address(points, normals, 0, incidence=incidence, factor=factor)
    expected, certain = levels_of(EYE, address.spread, points, normals, factor, incidence)
    off = np.abs(points).max(axis=1) * 2**-20 > np.linalg.norm(points - EYE, axis=1) * 1e-5  # the difference is rounded
    certain &= ~off
    assert certain.mean() > 0.5
    np.testing.assert_array_equal(level[certain], expected[certain])


@pytest.mark.parametrize("capacity", [1, 7, 16, 64, 1000, 2**21, 2**28])
def test_places_and_checks(address, capacity):
    rng = np.random.default_rng(2)
    points, normals = scattered(rng, 20000)
    levels, dark = rng.integers(-12, 4, 20000), rng.integers(8, size=20000)
    _, place, check = address(points, normals, levels, capacity, dark=dark)
    expected = voxels_of(points, normals, levels, capacity, dark)
    assert expected.certain.mean() > 0.9
    np.testing.assert_array_equal(place[expected.certain], expected.place[expected.certain])
    np.testing.assert_array_equal(check[expected.certain], expected.check[expected.certain])
    assert place.max() < max(capacity - capacity % BLOCK, BLOCK)


def test_every_level_and_face_is_another_voxel(address):
    """Each level, each of the six sides, one place: no two of them have the same check hash."""
    levels = np.repeat(np.arange(-HIGHEST_LEVEL, HIGHEST_LEVEL + 2), 6)
    normals = np.tile(np.concatenate([np.eye(3), -np.eye(3)]), (len(levels) // 6, 1))
    points = np.full((len(levels), 3), 0.6) * 2.0 ** levels[:, None].clip(-120, 120)
    _, place, check = address(points, normals, levels)
    expected = voxels_of(points.astype(np.float32), normals, levels, 2**21)
    assert expected.certain.all()
    np.testing.assert_array_equal(check, expected.check)
    np.testing.assert_array_equal(place, expected.place)
    assert len(np.unique(check)) == len(levels) == len(np.unique(expected.key, axis=0))


def test_what_is_dark_shares_no_voxel_with_what_is_not(address):
    """Of one place and level, each of the eight ways in which an albedo's components may be too dark to divide by."""
    _, _, check = address([(0.6, 0.6, 0.6)] * 8, [(0, 1, 0)] * 8, 0, dark=np.arange(8))
    assert len(np.unique(check)) == 8


def test_a_tile_is_sixteen_neighbours_in_a_row_of_the_table(address):
    """On each of the six sides; the next tile is elsewhere."""
    across = np.arange(2 * TILE) + 0.5
    for axis in range(3):
        for sign in (1, -1):
            u, v = (g.ravel() for g in np.meshgrid(across, across))
            points = np.insert(np.column_stack([u, v]), axis, 0.1, axis=1)
            normals = np.tile(sign * np.eye(3)[axis], (len(u), 1))
            _, place, check = address(points, normals, 0)
            assert len(np.unique(check)) == len(u)
            tile = (u // TILE + 2 * (v // TILE)).astype(int)
            for t in range(4):
                inside = np.sort(place[tile == t])
                assert inside[0] % BLOCK == 0 and (np.diff(inside) == 1).all() and len(inside) == BLOCK
            assert len(np.unique(place // BLOCK)) == 4


ZERO = (10428, 2, 23199)  # of level 0, seen from above: a voxel whose check hash is 0


def test_a_hash_of_zero_is_remapped(address):
    """The key 0 is that of entries that were never used."""
    kind = 128 << 6 | 2
    assert pcg4d(np.array([[ZERO[0], ZERO[2], ZERO[1], kind ^ CHECK_SEED]], np.uint32))[0, 0] == 0
    points = np.array([ZERO]) + [0.5, 0.5 - LAYER_OFFSET, 0.5]
    _, place, check = address(points, [(0, 1, 0)], 0)
    expected = voxels_of(points, [(0, 1, 0)], [0], 2**21)
    assert expected.key.tolist() == [[ZERO[0], ZERO[2], ZERO[1], kind]]
    assert check[0] == expected.check[0] == 1 and place[0] == expected.place[0]


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6])
def test_the_scale_of_a_scene_changes_nothing_but_the_level(address, scale):
    """A power of two of the scale makes the same voxels, some levels aside."""
    power = 2.0 ** round(np.log2(scale))
    rng = np.random.default_rng(4)
    points, normals = scattered(rng, 4000)
    levels = rng.integers(-12, 4, 4000)
    shift = round(np.log2(power))
    here = voxels_of(points, normals, levels, 2**21)
    there = voxels_of(points * np.float32(power), normals, levels + shift, 2**21)
    np.testing.assert_array_equal(here.key[:, :3], there.key[:, :3])
    _, place, check = address(points * np.float32(power), normals, levels + shift)
    np.testing.assert_array_equal(check[there.certain], there.check[there.certain])


def test_what_is_beyond_all_bounds_has_a_voxel_all_the_same(address):
    """Points at the eye, at infinity and at no place; normals of no length: levels in range, places in the table."""
    points = np.array([EYE, [1e30, 0, 0], [-1e38, 1e38, 0], [np.inf, 0, 0], [np.nan, 1, 1], [1e-40, 0, 0]], np.float32)
    for normals in ([(0, 1, 0)] * 6, [(0, 0, 0)] * 6, [(np.nan, 0, 0)] * 6):
        for incidence in (False, True):
            level, place, check = address(points, normals, HIGHEST_LEVEL, incidence=incidence)
            assert (np.abs(level) <= HIGHEST_LEVEL).all() and (place < 2**21).all() and (check > 0).all()
            _, place, check = address(points, normals, -HIGHEST_LEVEL, incidence=incidence)
            assert (place < 2**21).all() and (check > 0).all()
