"""Octrees of scenes: levels, numbers of cells, keys of points, hit points of rays, Table 1's law, repeatability."""

import os
from dataclasses import replace

import numpy as np
import pytest
from cache_renders import in_child
from helpers import blob, cube, make_mesh, make_scene, moved, prism, random_directions, soup, tunnel
from octree_on_device import NONE, cell_keys, find_cells
from overlap_model import cell_coordinates, morton, overlaps, unmorton, world_corners

from clcache.bvh import MISS, Tracer
from clcache.device import Device
from clcache.errors import DeviceError
from clcache.layout import STRUCTS
from clcache.octree import Octree
from clcache.scene.geometry import Geometry
from clcache.scene.model import Scene

SHAPE = np.zeros((), STRUCTS["OctreeShape"])
SHAPE["origin"], SHAPE["size"], SHAPE["finest"] = [-1.5, 0.25, 3.0], 3.0, 12


def octree_of(device: Device, scene: Scene, resolution: int) -> Octree:
    return Octree(device, Geometry.of(scene), np.ones(len(scene.instances), bool), resolution)


def turned(scale: float, offset: tuple[float, float, float], angle: float) -> np.ndarray:
    """A rotation about an axis that is none of the world's, scaled and moved."""
    x, y, z = np.array([0.36, 0.48, 0.8])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.column_stack([scale * (np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross), offset])


def some_scene() -> Scene:
    placed = [(0, turned(0.7, (1, 2, 3), 0.5)), (1, turned(2, (-1, 0, 2), 1)), (1, turned(0.1, (0, 0, 0), 2))]
    return make_scene(blob(3), soup(100, seed=1, size=0.3), instances=placed)


def check_levels(device: Device, octree: Octree, finest_keys: np.ndarray) -> None:
    """All cells of all levels are found by their keys, at their numbers; their neighbours only if they are cells."""
    for level in range(octree.finest + 1):
        keys = np.unique(finest_keys >> np.uint64(3 * (octree.finest - level)))
        first, end = octree.first_cell[level : level + 2]
        assert end - first == len(keys)
        assert np.array_equal(find_cells(device, octree.arrays, keys, level), first + np.arange(len(keys)))
        near = np.concatenate([keys ^ np.uint64(1 << k) for k in range(min(3 * level, 6))] or [keys])
        others = np.setdiff1d(near, keys)
        assert (find_cells(device, octree.arrays, others, level) == NONE).all()


def finest_keys(octree: Octree, scene: Scene) -> np.ndarray:
    """Those of the cells that brute force has, in float64; scenes that this is asked of have none that are overlapped only just."""
    corners = world_corners(Geometry.of(scene), np.ones(len(scene.instances), bool))
    keys = overlaps(octree.shape, corners, 0.0)
    assert np.array_equal(keys, overlaps(octree.shape, corners, 2 * octree.report()["margin"]))
    return keys


def test_levels_of_a_cube(device):
    scene = make_scene(cube())
    octree = octree_of(device, scene, 128)
    check_levels(device, octree, finest_keys(octree, scene))
    counts = np.diff(octree.first_cell)
    shell = [n**3 - max(n - 2, 0) ** 3 for n in 2 ** np.arange(8)]
    assert counts.tolist() == shell
    assert octree.cells == sum(shell)
    assert octree.finest == 7


@pytest.mark.parametrize("resolution", [2048, 4096])
def test_levels_across_parts_of_space(device, resolution):
    """Small squares along an axis' plane, in different parts of 1024^3 cells."""
    rng = np.random.default_rng(3)
    corners = []
    for middle in [*rng.uniform(-1, 1, (20, 3)), [-1, -1, -1], [1, 1, 1]]:
        a, b = np.array(middle) - 5.5 / resolution, np.array(middle) + 5.5 / resolution
        corners += [
            [a, [b[0], a[1], a[2]], [a[0], b[1], a[2]]],
            [[b[0], b[1], a[2]], [b[0], a[1], a[2]], [a[0], b[1], a[2]]],
        ]
    scene = make_scene(make_mesh(np.array(corners).reshape(-1, 3), np.arange(3 * len(corners))))
    octree = octree_of(device, scene, resolution)
    corners = world_corners(Geometry.of(scene), np.array([True]))
    margin = octree.report()["margin"]
    some = overlaps(octree.shape, corners, -1e-9)
    numbers = find_cells(device, octree.arrays, some, octree.finest)
    assert (numbers != NONE).all() and (np.diff(numbers.astype(np.int64)) > 0).all()
    every = overlaps(octree.shape, corners, 2 * margin)
    every = every[find_cells(device, octree.arrays, every, octree.finest) != NONE]
    check_levels(device, octree, every)
    assert len(np.unique(every >> np.uint64(30))) > 4


def test_all_hits_of_rays_lie_in_cells(device):
    """Of the level that is asked for, and of all above; points as cl/scene/surface.cl computes them."""
    far = [
        (0, turned(1, (300, -200, 100), 1)),
        (1, turned(0.01, (301, -200, 100), 0.3)),
        (2, turned(3e-3, (299, -201, 99), 2)),
    ]
    scenes = {
        "instances": (some_scene(), 512),
        "large": (make_scene(moved(blob(3), 2.0**20)), 512),
        "tiny": (make_scene(moved(blob(3), 2.0**-20), moved(cube(), 1.4 * 2.0**-20)), 256),
        "far": (make_scene(moved(blob(3), 1.0, (1000, 0, -500))), 512),
        "far instances": (make_scene(blob(3), prism(9), tunnel(), instances=far), 512),
        "needles": (make_scene(tunnel()), 2048),
    }
    for name, (scene, resolution) in scenes.items():
        octree = octree_of(device, scene, resolution)
        points = hit_points(device, scene, octree.shape, 40_000)
        assert len(points) > 10_000, name
        for level in (octree.finest, octree.finest - 1, octree.finest // 2):
            keys, _ = cell_keys(device, octree.shape, points, level)
            numbers = find_cells(device, octree.arrays, keys, level)
            assert (numbers != NONE).all(), (name, level)
            assert (numbers >= octree.first_cell[level]).all() and (numbers < octree.first_cell[level + 1]).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_surfaces_where_cells_meet(device, axis):
    """Sheets so close to the sides of cells that rounding decides on which side of them a hit point lies."""
    around = make_mesh(
        np.array([[-3.0, -3, -3], [-2.9, -3, -3], [-3, -2.9, -3], [3, 3, 3], [2.9, 3, 3], [3, 2.9, 3]]), np.arange(6)
    )
    shape = octree_of(device, make_scene(around), 256).shape
    sides = shape["origin"][axis].astype(float) + np.arange(40, 200, 20) / 256 * float(shape["size"])
    rng = np.random.default_rng(axis)
    corners = rng.uniform(-2, 2, (len(sides), 3, 3))
    corners[:, :, axis] = sides[:, None] + 1e-4 * rng.uniform(-1, 1, (len(sides), 3))
    sheets = make_mesh(corners.reshape(-1, 3) - [700, -800, 900], np.arange(corners.size // 3))
    scene = make_scene(
        around, sheets, instances=[(0, np.eye(4)[:3]), (1, np.column_stack([np.eye(3), [700, -800, 900]]))]
    )
    octree = octree_of(device, scene, 256)
    assert octree.shape == shape
    points = hit_points(device, scene, shape, 40_000)
    across = cell_coordinates(shape, points.astype(float))[:, axis]
    near = points[np.abs(across - np.round(across)) < 4e-3]
    keys, _ = cell_keys(device, shape, near, octree.finest)
    assert (find_cells(device, octree.arrays, keys, octree.finest) != NONE).all()
    on_side = unmorton(keys)[:, axis] - np.round(cell_coordinates(shape, near.astype(float))[:, axis])
    assert min(np.count_nonzero(on_side == 0), np.count_nonzero(on_side == -1)) > 100


def hit_points(device: Device, scene: Scene, shape: np.void, n: int) -> np.ndarray:
    """(m, 3) float32: where random rays through the cube hit, in the arithmetic of find_surface."""
    rng = np.random.default_rng(9)
    middle = shape["origin"].astype(float) + shape["size"] / 2
    origins = middle + float(shape["size"]) * random_directions(n, rng).astype(float)
    corners = world_corners(Geometry.of(scene), np.ones(len(scene.instances), bool))
    weights = rng.dirichlet([1, 1, 1], n)
    targets = np.einsum("nk,nkj->nj", weights, corners[rng.integers(len(corners), size=n)])
    hits = Tracer(scene, device).closest_hit(origins, targets - origins)
    hits = hits[hits["instance"] != MISS]
    geometry = Geometry.of(scene)
    mesh = geometry.instance_mesh[hits["instance"]]
    a, b, c = (geometry.positions[k] for k in geometry.triangles[geometry.first_triangle[mesh] + hits["primitive"]].T)
    x, y, z = (a + (hits["u"][:, None] * (b - a) + hits["v"][:, None] * (c - a))).T
    m = geometry.to_world[hits["instance"]]
    points = np.stack([m[:, k, 0] * x + m[:, k, 1] * y + m[:, k, 2] * z + m[:, k, 3] for k in range(3)], axis=1)
    assert points.dtype == np.float32
    return points


def test_keys_of_points(device):
    rng = np.random.default_rng(2)
    points = (SHAPE["origin"] + SHAPE["size"] * rng.uniform(0, 1, (5000, 3))).astype(np.float32)
    finest, _ = cell_keys(device, SHAPE, points, 12)
    exact = cell_coordinates(SHAPE, points.astype(np.float64))
    cells = unmorton(finest)
    assert (cells >= np.floor(exact - 1e-3)).all() and (cells <= np.floor(exact + 1e-3)).all()
    for level in range(13):
        keys, edge = cell_keys(device, SHAPE, points, level)
        assert np.array_equal(keys, finest >> np.uint64(3 * (12 - level)))
        assert edge == np.float32(3.0) * 2.0**-level


def test_x_is_the_lowest_bit_of_a_key(device):
    middle = np.array([0.25, 0.25, 0.25])
    points = [SHAPE["origin"] + SHAPE["size"] * (middle + 0.5 * axis) for axis in np.eye(3)]
    assert cell_keys(device, SHAPE, np.array(points), 1)[0].tolist() == [1, 2, 4]


def test_points_outside_belong_to_the_nearest_cell(device):
    low, high = SHAPE["origin"].astype(float), SHAPE["origin"] + SHAPE["size"].astype(float)
    points = np.array([low - 5, high + 5, [low[0] - 1e30, high[1] + 1e30, low[2]], [np.nan, np.inf, -np.inf], high])
    expected = np.array([[0, 0, 0], [4095, 4095, 4095], [0, 4095, 0], [0, 4095, 0], [4095, 4095, 4095]])
    assert np.array_equal(cell_keys(device, SHAPE, points, 12)[0], morton(expected))


@pytest.mark.parametrize("resolution", [64, 512])
def test_the_law_of_memory(device, resolution):
    """Table 1: 24 bytes of data for each cell; hash memory in buckets of four entries of 8 bytes, 1.1 as many as cells."""
    scene = some_scene()
    octree = octree_of(device, scene, resolution)
    report = octree.report()
    assert report["resolution"] == resolution == 2**octree.finest
    assert [r["level"] for r in report["levels"]] == list(range(octree.finest + 1))
    for level, row in enumerate(report["levels"]):
        cells = octree.first_cell[level + 1] - octree.first_cell[level]
        assert row["cells"] == cells
        assert row["density"] == cells / 8**level
        assert row["data_bytes"] == 24 * cells
        factors = 1.1 * 1.01 ** np.arange(report["attempts"])
        assert row["hash_bytes"] in [8 * 4 * int(np.ceil(factor * cells / 4)) for factor in factors]
    tables = octree.arrays["octree_tables"]
    assert octree.nbytes == sum(r["hash_bytes"] for r in report["levels"]) + 32 + tables.nbytes
    assert octree.seconds == pytest.approx(sum(report["seconds"].values()))
    assert octree.seconds > 0


def test_a_build_gives_back_what_it_does_not_keep(device):
    before = device.allocated
    octree = octree_of(device, some_scene(), 256)
    assert device.allocated == before + octree.nbytes
    device.release(*octree.arrays.values())


@pytest.mark.parametrize("resolution", [64, 2048])
def test_a_scene_in_which_all_moves(device, resolution):
    scene = make_scene(cube())
    octree = Octree(device, Geometry.of(scene), np.array([False]), resolution)
    assert octree.cells == 1
    assert octree.first_cell.tolist() == [0] * (octree.finest + 2)
    for level in range(octree.finest + 1):
        assert (find_cells(device, octree.arrays, np.arange(10), level) == NONE).all()


def test_cells_that_do_not_fit_are_said_in_one_line(device, monkeypatch):
    scene = make_scene(moved(cube(), 1.0))
    monkeypatch.setattr(device, "allocated", device.allocated)
    limits = replace(device.capabilities, global_memory=device.allocated + (20 << 20))
    monkeypatch.setattr(device, "capabilities", limits)
    with pytest.raises(DeviceError, match="octree") as caught:
        octree_of(device, scene, 512)
    assert "\n" not in str(caught.value)


def checksum(threads: int) -> list[int]:
    """First cells, and a digest of the numbers of all cells of some levels, from a build by so many threads."""
    device, scene = Device(threads=threads), some_scene()
    octree = octree_of(device, scene, 256)
    points = hit_points(device, scene, octree.shape, 20_000)
    digests = []
    for level in range(octree.finest + 1):
        keys, _ = cell_keys(device, octree.shape, points, level)
        numbers = find_cells(device, octree.arrays, keys, level).astype(np.uint64)
        digests.append(int(np.bitwise_xor.reduce((numbers + np.uint64(1)) * (keys + np.uint64(0x9E3779B97F4A7C15)))))
    return octree.first_cell.tolist() + digests


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_cells_are_the_same_for_any_number_of_threads():
    one, two = (in_child(f"import test_octree_build as t; print(*t.checksum({threads}))") for threads in (1, 2))
    assert one == two
    assert len(set(one)) > 10
