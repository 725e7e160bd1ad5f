"""What an octree leaves out where a scene reaches very much farther than what is near: the choice of the cube, triangles cut to it,
their cells, and images across its border."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from cache_renders import at, counters, one_device
from helpers import IDENTITY, blob, icosphere, make_mesh, make_scene, moved, random_directions, soup
from hypothesis import given, settings
from hypothesis import strategies as st
from octree_on_device import NONE, cell_keys, find_cells
from octree_renders import cells, octree
from overlap_model import morton, overlaps, world_corners
from render_helpers import MODELLED, ball, camera_rays, floor, grey, lit, on_floor, view
from scipy.ndimage import binary_erosion
from ztest import agree

from clcache import Renderer, Tracer, load_scene
from clcache.octree import Octree, cube, occupancy
from clcache.octree.cube import cut_to, near_bounds
from clcache.octree.occupancy import find_occupied, hit_error
from clcache.resources import eyes_of
from clcache.scene.geometry import Geometry
from clcache.scene.model import DirectionalLight, Material, Mesh, PointLight, Scene

DATA = Path(__file__).parents[2] / "data"
EYES = np.array([[0.0, 1.0, 3.0]])


def ground(size: float, height: float = 0.0, tilt: float = 0.0) -> Mesh:
    """Two triangles, of a square about the y axis."""
    corners = 0.5 * size * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1.0]])
    corners[:, 1] = height + tilt * (corners[:, 0] + 0.3 * corners[:, 2])
    return make_mesh(corners, [0, 2, 1, 0, 3, 2])


def village(size: float = 1000.0, offset: Sequence[float] = (0, 0, 0)) -> Scene:
    """A few hundred triangles within some metres, on a ground that is `size` large."""
    return make_scene(moved(blob(2), 2.0, offset), moved(ground(size), 1.0, offset))


def statics(scene: Scene) -> np.ndarray:
    return np.array([not i.motion for i in scene.instances])


def bounds_of(scene: Scene, eyes: np.ndarray = EYES, **options) -> tuple[np.ndarray, np.ndarray] | None:
    return near_bounds(Geometry.of(scene), statics(scene), np.asarray(eyes, np.float64), **options)


def areas(corners: np.ndarray) -> np.ndarray:
    """(n,): of triangles (n, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1)


def clipped(polygon: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(n, 3): what is left of a convex polygon within a box (Sutherland and Hodgman 1974)."""
    for axis in range(3):
        for inwards, side in ((1, low), (-1, high)):
            along = inwards * (polygon[:, axis] - side[axis])
            left = []
            for k in range(len(polygon)):
                following = (k + 1) % len(polygon)
                if along[k] >= 0:
                    left.append(polygon[k])
                if (along[k] < 0) != (along[following] < 0):
                    part = along[k] / (along[k] - along[following])
                    left.append((1 - part) * polygon[k] + part * polygon[following])
            polygon = np.array(left).reshape(-1, 3)
    return polygon


def area_within(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Of triangles (n, 3, 3), clipped one by one."""
    total = 0.0
    for triangle in corners:
        polygon = clipped(triangle, low, high)
        if len(polygon) > 2:
            fan = [np.stack([polygon[0], b, c]) for b, c in zip(polygon[1:], polygon[2:], strict=False)]
            total += np.linalg.norm(sum(np.cross(b - a, c - a) for a, b, c in fan)) / 2
    return float(total)


# Which cube.


@pytest.mark.parametrize("name", sorted(p.parent.name for p in DATA.glob("*/scene.toml")))
def test_ordinary_scenes_have_a_cube_around_all(device, name):
    scene = load_scene(DATA / name / "scene.toml")
    geometry, is_static = Geometry.of(scene), statics(scene)
    eyes = eyes_of(scene)
    bounds = near_bounds(geometry, is_static, eyes)
    if name != "city":
        assert bounds is None
        return
    low, high = bounds
    assert (high - low).max() < 2000  # of the sea's 20 km
    assert ((eyes > low) & (eyes < high)).all()
    shape = find_occupied(device, geometry, is_static, 64, eyes).shape
    assert shape["size"] == pytest.approx((high - low).max(), rel=0.02)


def test_the_cube_holds_most_centres_and_the_eyes():
    scene = village()
    low, high = bounds_of(scene)
    geometry = Geometry.of(scene)
    centres = world_corners(geometry, statics(scene)).mean(axis=1)
    assert ((centres > low) & (centres < high)).all(axis=1).mean() >= 0.98
    assert ((low < EYES) & (high > EYES)).all()
    # Nearly twice as large as it must be, at most.
    reach = max(np.abs(centres[:-2] - (low + high) / 2).max(), np.abs(EYES - (low + high) / 2).max())
    assert (high - low).max() <= 2 * 2 * 1.25 * reach


@pytest.mark.parametrize("far", [8.0, 20.0, 45.0])
def test_eyes_farther_away_get_a_larger_cube_about_the_same_place(far):
    near, (low, high) = bounds_of(village()), bounds_of(village(), [[0, 1, 3], [far, 0, 0]])
    assert low[0] < far < high[0]
    assert np.allclose(low + high, near[0] + near[1])
    doublings = np.log2((high - low) / (near[1] - near[0]))
    assert np.allclose(doublings, np.round(doublings)) and (doublings > 0.5).all()


@pytest.mark.parametrize("far", [60.0, 1e3, 1e6])
def test_eyes_far_outside_need_all(far):
    assert bounds_of(village(), [[0, 1, 3], [far, 0, 0]]) is None


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-2.2, 2.2)] * 3), max_size=4))
def test_eyes_elsewhere_within_have_the_same_cube(eyes):
    expected = bounds_of(village(), np.zeros((0, 3)))
    assert np.array_equal(bounds_of(village(), np.reshape(eyes, (-1, 3))), expected)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_the_cube_scales_with_the_scene(scale):
    scale = 2.0 ** round(np.log2(scale))
    scene = make_scene(moved(blob(2), 2 * scale), moved(ground(1000), scale))
    assert np.allclose(bounds_of(scene, EYES * scale), np.array(bounds_of(village())) * scale, rtol=1e-12)


def test_its_edge_is_the_scenes_halved_some_times():
    for size in (70.0, 300.0, 1000.0, 12345.0):
        low, high = bounds_of(village(size))
        halvings = np.log2(np.float32(size) / (high - low))
        assert np.allclose(halvings, np.round(halvings)) and (np.round(halvings) >= 3).all()
        assert ((high - low) <= size / 8 + 1e-9).all()


def test_a_scene_that_is_not_so_much_larger_has_none():
    assert bounds_of(village(50)) is None
    assert bounds_of(village(100)) is not None


def test_instances_count_one_by_one():
    houses = [(0, at(place)) for place in np.random.default_rng(0).uniform(-4, 4, (30, 3))]
    together = make_scene(icosphere(1), ground(1000), instances=[*houses, (1, IDENTITY)])
    meshes = [moved(icosphere(1), 1.0, matrix[:, 3]) for _, matrix in houses]
    apart = make_scene(*meshes, ground(1000))
    assert np.allclose(bounds_of(together), bounds_of(apart), atol=1e-5)


def test_what_moves_is_not_looked_at():
    scene = make_scene(moved(soup(3000, seed=2), 1.0, (300, 0, 0)), *(i for i in village().meshes))
    geometry, is_static = Geometry.of(scene), np.array([False, True, True])
    assert np.array_equal(near_bounds(geometry, is_static, EYES), bounds_of(village()))
    assert near_bounds(geometry, np.array([False, False, False]), EYES) is None
    assert near_bounds(geometry, np.ones(3, bool), EYES) is None  # most triangles are far from the eyes


def test_without_eyes_the_surfaces_alone_decide():
    low, high = bounds_of(village(), np.zeros((0, 3)))
    assert (high - low).max() < 10


@pytest.mark.parametrize("far", [50.0, 2000.0])
@pytest.mark.parametrize("subdivisions", [1, 3])
def test_two_clusters_are_both_within(far, subdivisions):
    """Unless the smaller one is a fiftieth of all: then it is as the ground."""
    scene = make_scene(icosphere(3), moved(icosphere(subdivisions), 1.0, (far, 0, 0)), ground(40 * far))
    low, high = bounds_of(scene, np.zeros((0, 3)))
    assert low[0] < -1 and far + 1 < high[0]


def test_what_is_far_away_is_left_out_if_it_is_little():
    scene = make_scene(icosphere(3), moved(icosphere(0), 1.0, (2000, 0, 0)), ground(80_000))
    low, high = bounds_of(scene, np.zeros((0, 3)))
    assert low[0] < -1 and 1 < high[0] < 3


def test_a_single_terrain_is_no_reason_to_leave_anything_out():
    grid = np.stack(np.meshgrid(np.arange(33.0), np.arange(33.0), indexing="ij"), axis=-1).reshape(-1, 2)
    positions = 30 * np.column_stack([grid[:, 0], np.sin(grid).sum(axis=1), grid[:, 1]])
    first = (np.arange(32)[:, None] * 33 + np.arange(32)).ravel()
    triangles = np.concatenate(
        [np.column_stack([first, first + 1, first + 33]), np.column_stack([first + 1, first + 34, first + 33])]
    )
    assert bounds_of(make_scene(make_mesh(positions, triangles)), [[480, 20, 480]]) is None


def test_all_at_one_place():
    assert bounds_of(make_scene(make_mesh(np.zeros((3, 3)), [0, 1, 2])), np.zeros((1, 3))) is None
    points = make_mesh(np.zeros((300, 3)), np.arange(300))
    assert bounds_of(make_scene(points, ground(10)), np.zeros((1, 3))) is None


def test_every_so_many_triangles_are_enough(monkeypatch):
    every = bounds_of(village())
    monkeypatch.setattr(cube, "_MOST", 100)
    some = bounds_of(village())
    assert (some[1] - some[0]).max() == (every[1] - every[0]).max()
    assert np.allclose(some, every, atol=0.5)


def test_cells_are_no_finer_than_hit_points_on_what_is_huge(device):
    # On a ground of 1000 km hit points are off by decimetres: a smaller cube would not have finer cells.
    scene = village(1e6)
    geometry = Geometry.of(scene)
    assert (np.diff(bounds_of(scene), axis=0) < 16).all()
    occupied = find_occupied(device, geometry, np.ones(2, bool), 256, EYES)
    assert occupied.shape["finest"] == 8
    assert occupied.margin <= 0.25 + 2.0**-8
    assert (
        4 * hit_error(geometry, np.ones(2, bool))
        <= occupied.shape["size"] / 256
        < 16 * hit_error(geometry, np.ones(2, bool))
    )


# What is cut.

LOW, HIGH = np.full(3, -1.0), np.full(3, 1.0)


def cut_corners(corners: np.ndarray, low: np.ndarray = LOW, high: np.ndarray = HIGH) -> np.ndarray:
    """(m, 3, 3) float64: of what is within the cube of one mesh, where it is."""
    geometry = Geometry.of(make_scene(make_mesh(np.reshape(corners, (-1, 3)), np.arange(3 * len(corners)))))
    cut = cut_to(geometry, np.ones(1, bool), low, high)
    return world_corners(cut, np.ones(len(cut.instance_mesh), bool))


def check_cut(corners: np.ndarray, low: np.ndarray = LOW, high: np.ndarray = HIGH) -> np.ndarray:
    corners = np.asarray(corners, np.float32).astype(np.float64)
    cut, size = cut_corners(corners, low, high), (high - low).max()
    rounding = 3e-7 * max(size, np.abs([low, high]).max())
    assert (cut >= low - rounding).all() and (cut <= high + rounding).all()
    expected = area_within(corners, low, high)
    perimeter = 8 * size * max(len(corners), 1)
    assert areas(cut).sum() == pytest.approx(expected, rel=1e-5, abs=perimeter * rounding)
    return cut


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0, 1e4])
def test_area_is_that_of_clipped_polygons(size):
    rng = np.random.default_rng(int(size * 10))
    corners = size * rng.normal(size=(200, 3, 3))
    inside = np.einsum("tk,tkj->tj", rng.dirichlet([1, 1, 1], 200), corners)
    corners += rng.uniform(-1.5, 1.5, (200, 1, 3)) - inside[:, None]
    assert areas(check_cut(corners)).sum() > 0.2


@pytest.mark.parametrize("scale", [1e-20, 1e-6, 1e6])
@pytest.mark.parametrize("offset", [0.0, 50.0])
def test_cubes_of_all_sizes_and_places(scale, offset):
    rng = np.random.default_rng(1)
    corners = rng.uniform(-1.5, 1.5, (100, 1, 3)) + rng.normal(size=(100, 3, 3))
    check_cut((corners + offset) * scale, (LOW + offset) * scale, (HIGH + offset) * scale)


def test_every_point_within_is_still_there():
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1.2, 1.2, (40, 1, 3)) + rng.normal(size=(40, 3, 3))
    for triangle in corners.astype(np.float32).astype(np.float64):
        cut = cut_corners(triangle[None])
        points = rng.dirichlet([1, 1, 1], 300) @ triangle
        points = points[(np.abs(points) < 1 - 1e-4).all(axis=1)]
        if len(points):
            assert is_covered(points, cut).all()


def is_covered(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether points of a plane lie in one of some triangles in it: the triangles that the point makes with their edges have no more
    area than they."""
    rolled = np.roll(corners, -1, axis=1)
    parts = np.stack(
        [
            areas(np.stack([np.broadcast_to(p, (len(corners), 3)), a, b], axis=1))
            for p in points
            for a, b in zip(np.moveaxis(corners, 1, 0), np.moveaxis(rolled, 1, 0), strict=True)
        ]
    )
    sums = parts.reshape(len(points), 3, len(corners)).sum(axis=1)
    return (sums <= areas(corners) * (1 + 1e-5) + 1e-5).any(axis=1)


def test_what_is_within_is_as_it_was_and_what_is_outside_is_gone():
    within, outside = moved(soup(50, seed=1), 0.5), moved(soup(50, seed=2), 0.5, (9, 0, 0))
    across = make_mesh(np.array([[0, 0, 0], [9, 0, 0], [0, 0.5, 0.0]]), [0, 1, 2])
    both = make_mesh(np.concatenate([outside.positions, within.positions]), np.arange(300))
    geometry = Geometry.of(make_scene(within, outside, across, both))
    cut = cut_to(geometry, np.ones(4, bool), LOW, HIGH)
    is_there = world_corners(cut, np.ones(len(cut.instance_mesh), bool)).reshape(-1, 9)
    whole = within.positions.reshape(-1, 9).astype(np.float64)
    assert np.array_equal(is_there[:50], whole)
    assert np.array_equal(is_there[50:100], whole)
    assert len(is_there) == 102  # the last triangle has become a quadrilateral
    assert is_there[100:].max() == 1.0


def test_triangles_that_only_go_round_the_cube_leave_nothing():
    assert len(cut_corners([[[3, -0.5, 0], [0, 3, 0], [3, 3, 0.1]]])) == 0  # its box reaches in
    assert areas(check_cut([[[-9, -9, 0.5], [9, -9, 0.5], [0, 20, 0.5]]])).sum() == pytest.approx(4)


def test_sides_of_the_cube_are_within():
    side = np.array([[-1, -1, 1], [1, -1, 1], [0, 1, 1.0]])
    for triangle in (side, side[::-1], side[:, [2, 0, 1]], -side):
        assert np.array_equal(cut_corners(triangle[None])[0], triangle)


@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-5, 1e-7, 0.0])
def test_needles_are_cut(width):
    rng = np.random.default_rng(7)
    ends = rng.uniform(-1, 1, (60, 2, 3)) * rng.choice([0.9, 3.0, 100.0], (60, 2, 1))
    third = ends.mean(axis=1, keepdims=True) + width * rng.normal(size=(60, 1, 3))
    corners = np.concatenate([ends, third], axis=1)
    cut = check_cut(corners)
    # Along its whole length: the part of a line between its ends, within the cube.
    for triangle in corners.astype(np.float32).astype(np.float64):
        line = clipped(triangle, LOW, HIGH)
        if len(line) and np.ptp(line, axis=0).max() > 1e-3:
            pieces = cut_corners(triangle[None]).reshape(-1, 3)
            assert np.allclose(pieces.min(axis=0), line.min(axis=0), atol=1e-5)
            assert np.allclose(pieces.max(axis=0), line.max(axis=0), atol=1e-5)
    assert np.isfinite(cut).all()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-6, 6)] * 9), min_size=1, max_size=5), st.sampled_from([0.5, 1 / 3, 1.0]))
def test_corners_on_the_sides_and_edges(corners, scale):
    corners = scale * np.array(corners, np.float64).reshape(-1, 3, 3)
    on_side = (np.abs(corners) == 1).all(axis=1).any(axis=1)  # where nothing is decided
    if not on_side.all():
        check_cut(corners[~on_side])


def test_instances_are_cut_where_they_stand():
    turned = np.column_stack([1.7 * np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]), [0.4, 0.2, -0.3]])
    places = [turned, at((0.9, 0, 0), 0.5), at((0, 0, 0), 0.3), at((5, 0, 0))]
    geometry = Geometry.of(make_scene(blob(2), soup(40, seed=1), instances=[(0, m) for m in places] + [(1, turned)]))
    is_static = np.array([True, True, True, True, False])
    cut = cut_to(geometry, is_static, LOW, HIGH)
    found = world_corners(cut, np.ones(len(cut.instance_mesh), bool))
    assert areas(found).sum() == pytest.approx(area_within(world_corners(geometry, is_static), LOW, HIGH), rel=1e-5)
    assert np.abs(found).max() <= 1 + 1e-6


def test_batches_change_nothing(monkeypatch):
    corners = np.random.default_rng(5).uniform(-2, 2, (150, 3, 3))
    at_once = cut_corners(corners)
    monkeypatch.setattr(cube, "_AT_ONCE", 7)
    assert areas(cut_corners(corners)).sum() == pytest.approx(areas(at_once).sum())
    assert len(cut_corners(corners)) == len(at_once)


def test_large_scenes_are_cut_within_little_memory():
    import tracemalloc

    # Less than float64 corners of all would take: of what is within nothing but indices is written anew.
    sphere = moved(icosphere(7), 0.9)
    geometry = Geometry.of(
        make_scene(
            sphere, moved(blob(2), 1.2), ground(100), instances=[(0, at((0.2, 0, 0))), (1, IDENTITY), (2, IDENTITY)]
        )
    )
    tracemalloc.start()
    cut = cut_to(geometry, np.ones(3, bool), LOW, HIGH)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(cut.triangles) > 1.8 * len(sphere.triangles)
    assert most < 72 * len(sphere.triangles)


# Its cells.


def keys_of(occupied: occupancy.Occupied) -> np.ndarray:
    parts = [
        keys.get() + (np.uint64(part) << np.uint64(30)) for part, keys in enumerate(occupied.parts) if keys is not None
    ]
    return np.concatenate(parts)


@pytest.mark.parametrize("resolution", [64, 128])
@pytest.mark.parametrize("tilt", [0.0, 0.03, 0.5])
def test_occupied_cells_are_those_that_uncut_triangles_overlap(device, tilt, resolution):
    scene = make_scene(
        blob(1),
        ground(300, 0.1, tilt),
        soup(60, seed=3, size=2.0),
        instances=[(0, at((0.3, 0, 0), 2)), (1, IDENTITY), (2, IDENTITY)],
    )
    geometry, is_static = Geometry.of(scene), np.ones(3, bool)
    occupied = find_occupied(device, geometry, is_static, resolution, EYES)
    assert occupied.shape["size"] < 300 / 8 * 1.02
    corners, keys = world_corners(geometry, is_static), keys_of(occupied)
    assert np.isin(overlaps(occupied.shape, corners, -1e-6), keys).all()
    assert np.isin(keys, overlaps(occupied.shape, corners, 2 * occupied.margin)).all()


def hit_points(scene: Scene, hits: np.ndarray) -> np.ndarray:
    """(n, 3) float32: as cl/scene/surface.cl computes them."""
    geometry = Geometry.of(scene)
    triangles = geometry.triangles[
        geometry.first_triangle[geometry.instance_mesh[hits["instance"]]] + hits["primitive"]
    ]
    a, b, c = np.moveaxis(geometry.positions[triangles], 1, 0)
    u, v = hits["u"][:, None], hits["v"][:, None]
    x, y, z = (a + (u * (b - a) + v * (c - a))).T
    m = geometry.to_world[hits["instance"]]
    return np.stack([m[:, k, 0] * x + m[:, k, 1] * y + m[:, k, 2] * z + m[:, k, 3] for k in range(3)], axis=1)


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_whatever_rays_hit_within_the_cube_has_a_cell(device, tilt):
    turned = np.column_stack([2 * np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]), [0.4, 0.2, -0.3]])
    scene = make_scene(
        blob(2),
        ground(3000, -0.7, tilt),
        soup(40, seed=1, size=3.0),
        instances=[(0, turned), (1, turned), (2, IDENTITY)],
    )
    tree = Octree(device, Geometry.of(scene), np.ones(3, bool), 512, EYES)
    low, size = tree.shape["origin"], tree.shape["size"]
    assert tree.finest == 9 and size < 400
    rng = np.random.default_rng(0)
    n = 60_000
    within = rng.uniform(0, 1, (n, 3))
    within[::2] = 0.5 + 0.05 * (within[::2] - 0.5)  # near the middle too, where most triangles are
    directions = random_directions(n, rng)
    # A sixth of the rays stay as near to one of the cube's sides as a cell or two.
    rays, axis = np.arange(0, n, 6), rng.integers(3, size=n // 6)
    within[rays, axis] = rng.integers(2, size=n // 6) + rng.uniform(-2, 2, n // 6) / 512
    directions[rays, axis] = 0
    hits = Tracer(scene, device).closest_hit((low + size * within).astype(np.float32), directions)
    points = hit_points(scene, hits[np.isfinite(hits["t"])])
    along = points - low
    inside = points[(along >= 0).all(axis=1) & (along <= size).all(axis=1)]
    border = np.minimum(inside - low, size - (inside - low)).min(axis=1) < size / 512
    assert len(inside) > 10_000 and border.sum() > 300 and len(points) > len(inside)
    for level in range(tree.finest + 1):
        keys, _ = cell_keys(device, tree.shape, inside, level)
        assert (find_cells(device, tree.arrays, keys, level) != NONE).all()


def test_a_point_knows_the_cell_that_numpy_says(device):
    scene = village()
    tree = Octree(device, Geometry.of(scene), np.ones(2, bool), 64, EYES)
    points = (
        tree.shape["origin"] + tree.shape["size"] * np.random.default_rng(1).uniform(0.001, 0.999, (500, 3))
    ).astype(np.float32)
    expected = morton(
        np.floor((points.astype(np.float64) - tree.shape["origin"]) / np.float64(tree.shape["size"]) * 64).astype(int)
    )
    assert (cell_keys(device, tree.shape, points, 6)[0] == expected).mean() > 0.99


# The method.

SIZE = (32, 24)


def meadow(eye=(0.0, 2.5, 5.0), target=(0.0, 0.5, -1.0), degrees=60.0, size=400.0, **options) -> Scene:
    """A ball on a ground of which the cube is a small part."""
    given = {
        "materials": [grey(0.5), grey(0.7)],
        "lights": [DirectionalLight((0.48, -0.8, 0.36), (2.0, 1.8, 1.5)), PointLight((1.5, 3.0, 1.0), (8.0, 8.0, 9.0))],
        "environment": (0.3, 0.4, 0.5),
    }
    return lit(floor(size), ball(1.0, 3, 1, smooth=True), camera=view(eye, target, degrees), **(given | options))


def sides_of(renderer: Renderer) -> tuple[np.ndarray, np.ndarray]:
    """Low and high of its cube."""
    shape = renderer._parts.octree.shape
    low = shape["origin"].astype(np.float64)
    return low, low + np.float64(shape["size"])


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def test_hits_outside_are_traced_and_others_read():
    scene = meadow()
    renderer = octree(scene, SIZE, aovs=["level", "Z"], samples=1, jitter=0.0, gate=False, sampler=MODELLED)
    frame = list(renderer.frames(0, 8))[-1]
    low, high = sides_of(renderer)
    _, directions = camera_rays(scene.camera, SIZE, frame=7)
    points = on_floor(scene.camera, SIZE, frame=7)
    level = frame.aov("level", "mono")
    is_down, is_there = directions[..., 1] < 0, np.isfinite(frame.aov("Z", "mono"))
    passes_ball = np.linalg.norm(np.cross(directions, scene.camera.transform[:, 3]), axis=-1) < 1.01
    is_floor = is_down & is_there & ~passes_ball
    is_outside = ((points < low) | (points > high)).any(axis=-1) & is_floor
    is_inside = ((points > low) & (points < high)).all(axis=-1) & is_floor
    assert is_outside.sum() > 50 and is_inside.sum() > 200
    # Which place of a pixel is hit is another in each frame.
    surely_outside, surely_inside = (
        binary_erosion(p, np.ones((3, 3)), border_value=1) for p in (is_outside, is_inside)
    )
    assert np.isinf(level[surely_outside]).all() and surely_outside.sum() > 30
    assert np.isfinite(level[surely_inside]).mean() > 0.9  # to the others no path had come yet
    found = counters(frame)
    assert found["lookups"] == pytest.approx((is_down & is_there).sum(), abs=60)
    assert found["traced"] == found["lookups"] - found["hits"] == found["lookups"] - np.isfinite(level).sum()


def test_light_outside_goes_to_no_cell():
    """The camera stands within and sees nothing but what is outside: no cell gets any of it, none at the border either."""
    renderer = octree(meadow((0.0, 0.5, 6.0), (0.0, 0.49, 7.0), 1.5), SIZE, store=1, samples=1)
    low, high = sides_of(renderer)
    assert low[2] < 6.0 < high[2] < 20
    for frame in renderer.frames(0, 3):
        found = counters(frame)
        assert found["lookups"] == found["traced"] > 500
        assert found["inserted"] == found["occupied"] == 0
    assert cells(renderer).counts.sum() == 0


def images(scene: Scene, method: str, seeds: Sequence[int], spp: int, **options) -> list[np.ndarray]:
    if method == "octree":
        renderers = (octree(scene, (24, 24), seed=seed, spp=spp, bounces=3, **options) for seed in seeds)
    else:
        bounces = {"pathtrace.bounces": 3}
        renderers = (
            Renderer(scene, method, (24, 24), stereo=False, seed=seed, spp=spp, settings=bounces) for seed in seeds
        )
    return [next(r.frames(0, 1)).color["mono"] for r in renderers]


@pytest.mark.parametrize("kind", ["diffuse", "mirror"])
def test_images_agree_with_path_tracing_across_the_border(kind):
    # The upper half of the ground is outside; what the mirror shows is as well.
    mirror = Material("mirror", (0.9, 0.9, 0.9), metallic=1.0, specular=1.0, roughness=0.0)
    scene = meadow(target=(0.0, 0.5, -3.0), materials=[grey(0.5), mirror if kind == "mirror" else grey(0.7)])
    ours = images(scene, "octree", range(6), 16, resolution=512, samples=1, jitter=0.0)
    theirs = images(scene, "pathtrace", range(100, 106), 16)
    pixels, blocks = agree(ours, theirs)
    assert pixels.passed and blocks.passed, (pixels, blocks)


def test_there_is_no_seam():
    """Where light is even, the mean image is the same on both sides of the border."""
    sun = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
    scene = lit(
        floor(400),
        ball(0.3, 3, 1),
        camera=view((8.0, 3.0, 0.0), (13.0, 0.0, 0.0), 60),
        materials=[grey(0.5), grey(0.5)],
        lights=[sun],
        environment=(1.0, 1.0, 1.0),
    )
    renderer = octree(scene, SIZE, spp=64, samples=1, bounces=1, aovs=["level"])
    low, high = sides_of(renderer)
    frame = next(renderer.frames(0, 1))
    is_outside = on_floor(scene.camera, SIZE)[..., 0] > high[0]
    assert 100 < is_outside.sum() < 600 and low[0] < 8.0 < high[0]
    color = frame.color["mono"].mean(axis=-1)
    assert color[is_outside].mean() == pytest.approx(color[~is_outside].mean(), rel=0.002)
    assert color == pytest.approx(1.0, rel=0.02)  # albedo (pi / pi + 1)


def test_paths_from_surfaces_begin_within():
    """Though nearly all of the surfaces' area is outside; some begin a little beyond its sides."""
    renderer = octree(meadow(), SIZE, store=1, samples=1, paths="surfaces")
    low, high = sides_of(renderer)
    assert (high - low).max() < 40
    inserted = [counters(frame)["inserted"] for frame in renderer.frames(0, 3)]
    assert min(inserted) > 0.85 * SIZE[0] * SIZE[1]
