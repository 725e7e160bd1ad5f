"""Occupied cells against brute force: every cell that a triangle overlaps, and none that all miss by more than the bound."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import blob, cube, make_mesh, make_scene, moved, prism, soup
from hypothesis import given, settings
from hypothesis import strategies as st
from overlap_model import cell_coordinates, gaps, morton, overlaps, unmorton, world_corners

from clcache.errors import DeviceError
from clcache.octree.occupancy import MOST_CELLS, Occupied, check_cells, choose_shape, find_occupied, hit_error
from clcache.scene.geometry import Geometry


def keys_of(occupied: Occupied) -> np.ndarray:
    """(n,) uint64: the keys of all parts, in order."""
    parts = [
        np.zeros(0, np.uint64) if keys is None else keys.get() + (np.uint64(part) << np.uint64(30))
        for part, keys in enumerate(occupied.parts)
    ]
    return np.concatenate(parts)


def find(device, scene, resolution: int, is_static: np.ndarray | None = None) -> tuple[Occupied, np.ndarray, Geometry]:
    geometry = Geometry.of(scene)
    is_static = np.ones(len(scene.instances), bool) if is_static is None else is_static
    occupied = find_occupied(device, geometry, is_static, resolution)
    return occupied, keys_of(occupied), geometry


def check(device, scene, resolution: int) -> tuple[Occupied, np.ndarray]:
    """Find the occupied cells of a scene, and compare with brute force."""
    occupied, keys, geometry = find(device, scene, resolution)
    corners = world_corners(geometry, np.ones(len(scene.instances), bool))
    assert (np.diff(keys.astype(np.int64)) > 0).all()
    # Brute force in float64 is off by much less than a step of the grid; cells that it has only just are left to the other side.
    certain = overlaps(occupied.shape, corners, -1e-9)
    possible = overlaps(occupied.shape, corners, 2 * occupied.margin)
    assert np.isin(certain, keys).all()
    assert np.isin(keys, possible).all()
    return occupied, keys


def place(scale: float, offset: tuple[float, float, float], angle: float = 0.0) -> np.ndarray:
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return np.column_stack([scale * turn, offset])


def test_morton_codes_there_and_back():
    cells = np.random.default_rng(0).integers(0, 4096, (1000, 3))
    assert np.array_equal(unmorton(morton(cells)), cells)
    assert morton(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0]])).tolist() == [1, 2, 4, 8]


def test_the_model_has_every_cell_that_points_of_a_triangle_lie_in():
    rng = np.random.default_rng(1)
    for corners in rng.uniform(0, 10, (20, 3, 3)):
        weights = rng.dirichlet([1, 1, 1], 2000)
        cells = np.unique(np.floor(weights @ corners).astype(int), axis=0)
        assert (gaps(corners, cells) < 1e-12).all()


def test_the_model_knows_how_far_a_cell_is():
    flat = np.array([[0.0, 0, 2.5], [9, 0, 2.5], [0, 9, 2.5]])
    assert gaps(flat, np.array([[1, 1, 2], [1, 1, 3], [1, 1, 4], [8, 8, 2]])).tolist() == pytest.approx(
        [-0.5, 0.5, 1.5, 3.5]
    )


@pytest.mark.parametrize("size", [0.01, 0.2, 2.0])
@pytest.mark.parametrize("resolution", [64, 128])
def test_triangles_of_all_sizes(device, size, resolution):
    check(device, make_scene(soup(60, seed=int(100 * size), size=size)), resolution)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_tiny_and_huge_scenes_have_the_cells_of_moderate_ones(device, scale):
    mesh = soup(60, seed=3)
    scale = 2.0 ** round(np.log2(scale))
    _, expected = check(device, make_scene(mesh), 64)
    _, found = check(device, make_scene(moved(mesh, scale)), 64)
    assert np.array_equal(found, expected)


@pytest.mark.parametrize("scale", [1e-30, 1e-20, 1e20, 1e30])
def test_scales_near_the_limits(device, scale):
    occupied, keys = check(device, make_scene(moved(cube(), scale)), 64)
    assert len(keys) > 6 * 50**2
    assert occupied.shape["finest"] == 6


def test_instances_turned_and_scaled(device):
    scene = make_scene(
        blob(2),
        prism(7),
        instances=[(0, place(0.7, (1, 2, 3), 0.5)), (1, place(3, (-1, 0, 2), 1)), (1, place(0.1, (0, 0, 0)))],
    )
    check(device, scene, 128)


def test_moving_instances_have_no_cells(device):
    mesh, moving = soup(20, seed=1), moved(soup(20, seed=2), 3)
    _, alone, _ = find(device, make_scene(mesh), 64)
    _, beside, _ = find(device, make_scene(mesh, moving), 64, np.array([True, False]))
    assert np.array_equal(alone, beside)


def test_a_scene_in_which_all_moves_has_no_cells(device):
    occupied, keys, _ = find(device, make_scene(cube()), 64, np.array([False]))
    assert len(keys) == 0
    assert occupied.shape["finest"] == 6


def test_needles(device):
    rng = np.random.default_rng(5)
    ends = rng.uniform(-1, 1, (80, 2, 3))
    width = 10.0 ** rng.uniform(-7, -1, (80, 1, 1))
    third = ends.mean(axis=1, keepdims=True) + width * rng.normal(size=(80, 1, 3))
    corners = np.concatenate([ends, third], axis=1)[:, rng.permutation(3)]
    check(device, make_scene(make_mesh(corners.reshape(-1, 3), np.arange(240))), 128)


def test_triangles_without_area(device):
    rng = np.random.default_rng(6)
    a, b = rng.uniform(-1, 1, (2, 40, 3))
    points = np.stack([a, a, a], axis=1)
    lines = np.stack([a, b, a], axis=1)
    collinear = np.stack([a, 0.5 * a + 0.5 * b, b], axis=1)
    along_axis = np.stack([a, a + [0.5, 0, 0], a + [0.25, 0, 0]], axis=1)
    corners = np.concatenate([points, lines, collinear, along_axis])
    check(device, make_scene(make_mesh(corners.reshape(-1, 3), np.arange(corners.size // 3))), 128)


def test_duplicates_change_nothing(device):
    mesh = soup(50, seed=7)
    twice = make_mesh(mesh.positions, np.concatenate([mesh.triangles, mesh.triangles[::-1, [2, 0, 1]]]))
    _, once, _ = find(device, make_scene(mesh), 64)
    _, found, _ = find(device, make_scene(twice), 64)
    assert np.array_equal(found, once)


def test_a_single_point_has_a_cell(device):
    _, keys = check(device, make_scene(make_mesh(np.zeros((3, 3)), [0, 1, 2])), 64)
    assert len(keys) >= 1


def test_one_triangle_across_everything(device):
    corners = np.array([[-1.0, -1, -1], [1, -0.8, 0.9], [-0.7, 1, 1]])
    check(device, make_scene(make_mesh(corners, [0, 1, 2])), 256)


def test_walls_at_the_bounds_do_not_lie_where_cells_meet(device):
    occupied, keys = check(device, make_scene(cube()), 64)
    sides = cell_coordinates(occupied.shape, np.array([[-1.0, -1, -1], [1, 1, 1]]))
    assert np.allclose(sides, [[0.3183] * 3, [64 - 0.3817] * 3], atol=1e-3)
    assert len(keys) == 64**3 - 62**3


@pytest.mark.parametrize("resolution", [2048, 4096])
def test_parts_of_space(device, resolution):
    """Triangles of a few dozen cells, some of which lie across the parts' borders."""
    rng = np.random.default_rng(8)
    middle = np.vstack([rng.uniform(-1, 1, (30, 3)), rng.choice([-0.5, 0, 0.5], (30, 3)), [[1, 1, 1], [-1, -1, -1]]])
    corners = middle[:, None] + 16 / resolution * rng.uniform(-1, 1, (len(middle), 3, 3))
    occupied, keys = check(
        device, make_scene(make_mesh(corners.reshape(-1, 3), np.arange(corners.size // 3))), resolution
    )
    assert len(occupied.parts) == (resolution // 1024) ** 3
    assert len(np.unique(keys >> np.uint64(30))) > 3


@pytest.mark.parametrize(("offset", "finest"), [(0, 10), (1e3, 10), (1e5, 6), (1e7, 0)])
def test_far_from_the_origin_cells_are_no_finer_than_hit_points(device, offset, finest):
    occupied, keys, _ = find(device, make_scene(moved(cube(), 1.0, (offset, 0, 0))), 1024)
    assert occupied.shape["finest"] == finest
    assert occupied.margin <= 0.25 + 2.0**-8
    assert len(keys) >= (2**finest - 1) ** 2 * 6 // 2


@pytest.mark.parametrize(("size", "offset"), [(0, 1), (0, 1e6), (1e-9, 1e3), (1, 1e20)])
def test_what_is_smaller_than_its_hit_points_are_off_has_one_cell(device, size, offset):
    instance = np.column_stack([np.eye(3), (offset, offset, 0)])
    scene = make_scene(make_mesh(size * np.eye(3), [0, 1, 2]), instances=[(0, instance)])
    occupied, keys, _ = find(device, scene, 64)
    assert occupied.shape["finest"] == 0
    assert occupied.margin <= 0.25 + 2.0**-8
    assert keys.tolist() == [0]


@pytest.mark.parametrize("offset", [0, 30, 1e4])
def test_the_bound_on_hit_points(device, offset):
    """Points in float32, as cl/scene/surface.cl computes them, against float64."""
    matrix = place(0.7, (offset, -offset, 1), 0.5).astype(np.float32)
    scene = make_scene(soup(200, seed=2, size=0.5), instances=[(0, matrix)])
    geometry = Geometry.of(scene)
    rng = np.random.default_rng(3)
    a, b, c = np.moveaxis(geometry.positions[geometry.triangles[rng.integers(200, size=20_000)]], 1, 0)
    u, v = rng.dirichlet([1, 1, 1], 20_000)[:, :2].astype(np.float32).T[:, :, None]
    x, y, z = (a + (u * (b - a) + v * (c - a))).T
    points = np.stack([m[0] * x + m[1] * y + m[2] * z + m[3] for m in matrix], axis=1)
    assert points.dtype == np.float32
    a, b, c, u, v, matrix = (values.astype(np.float64) for values in (a, b, c, u, v, matrix))
    exact = (a + u * (b - a) + v * (c - a)) @ matrix[:, :3].T + matrix[:, 3]
    worst = np.abs(points - exact).max()
    assert worst <= hit_error(geometry, np.array([True])) / 2 <= 30 * worst  # the other half is for the corners


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(*[st.integers(-16, 16)] * 9), min_size=1, max_size=6),
    st.sampled_from([1.0, 1 / 3, 1e-3]),
)
def test_corners_on_few_places(device, corners, scale):
    """Edges along axes, shared corners, corners where cells meet, and triangles without area, all of them often."""
    positions = scale * np.array(corners, np.float64).reshape(-1, 3)
    check(device, make_scene(make_mesh(positions, np.arange(len(positions)))), 64)


@settings(max_examples=30, deadline=None)
@given(st.floats(1e-25, 1e25), st.floats(0, 1e-2), st.integers(0, 12))
def test_the_cube_holds_the_bounds(longest, error, finest):
    low, high = np.array([-1.0, 2, 3]) * longest, np.array([0.0, 2.5, 3.1]) * longest
    shape = choose_shape(low, high, error * longest, finest)
    origin, size, edge = (
        shape["origin"].astype(float),
        float(shape["size"]),
        float(shape["size"]) / 2.0 ** shape["finest"],
    )
    assert (origin < low).all() and (origin + size > high).all()
    assert shape["finest"] == 0 or 0.25 * edge >= error * longest * (1 - 1e-6)


def test_bits_are_used_again_for_each_part(device, monkeypatch):
    """What one scene leaves behind must not be seen by the parts that follow."""
    sizes = []
    empty = device.empty
    monkeypatch.setattr(device, "empty", lambda *a: sizes.append(a) or empty(*a))
    mesh = make_mesh(np.array([[-1.0, -1, -1], [1, 1, 1], [-1, -1, -0.999]]), [0, 1, 2])
    check(device, make_scene(mesh), 2048)
    bits = [int(np.prod(shape)) * 4 for shape, _, what in sizes if what == "bits of cells"]
    assert bits == [128 * 2**20]


def test_more_cells_than_can_be_numbered_are_refused(device, monkeypatch):
    limits = replace(device.capabilities, global_memory=2**40, max_allocation=2**40)
    monkeypatch.setattr(device, "capabilities", limits)
    assert 6 * MOST_CELLS < 2**31 <= 6 * (MOST_CELLS + 1)  # words of 32 bits
    check_cells(device, MOST_CELLS, 12)
    with pytest.raises(DeviceError, match=f"octree.resolution 4096, of {MOST_CELLS + 1} cells .* at most {MOST_CELLS}"):
        check_cells(device, MOST_CELLS + 1, 12)


@pytest.mark.parametrize("budget", [1 << 10, 129 << 20])
def test_what_does_not_fit_is_said_in_one_line(device, monkeypatch, budget):
    limits = replace(device.capabilities, global_memory=device.allocated + budget)
    monkeypatch.setattr(device, "capabilities", limits)
    before = device.allocated
    monkeypatch.setattr(device, "allocated", before)  # what the failure leaves behind is not counted in other tests
    with pytest.raises(DeviceError, match="octree") as caught:
        find(device, make_scene(soup(1000, seed=1, size=1.0)), 1024)
    assert "\n" not in str(caught.value)
    assert device.allocated - before <= budget
