"""The tracer where float32 is at its limits: scales, places, and meshes without shape."""

import numpy as np
import pytest
from helpers import (
    MISS,
    WorldTriangles,
    blob,
    cube,
    icosphere,
    make_mesh,
    make_scene,
    moved,
    prism,
    random_directions,
    soup,
)

from clcache.bvh import Tracer

INFINITE = np.float32(np.inf)


def rays_to(scene, n, seed):
    """Rays from about the scene to points on its triangles, beside them, and in random directions."""
    rng = np.random.default_rng(seed)
    corners = WorldTriangles.of(scene).corners
    middle, size = corners.mean(axis=(0, 1)), max(np.ptp(corners, axis=(0, 1)).max(), np.abs(corners).max() * 1e-5)
    origins = (middle + size * rng.uniform(-1.5, 1.5, (n, 3))).astype(np.float32)
    weights = rng.dirichlet([1, 1, 1], n)[..., None]
    targets = (corners[rng.integers(len(corners), size=n)] * weights).sum(axis=1)
    targets[::3] += 0.02 * size * rng.normal(size=(len(targets[::3]), 3))
    return origins, (targets - origins).astype(np.float32)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_scales(device, scale, offset):
    """Distances in units of the scene's scale; at 1,000 times its size from the origin float32 leaves it 1e-4 of itself."""
    scene = make_scene(
        moved(soup(60, 1, 0.3), scale, [offset * scale] * 3), moved(blob(1), scale, [offset * scale] * 3)
    )
    origins, directions = rays_to(scene, 2000, 2)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert np.count_nonzero(hits["instance"] != MISS) > 1000
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


@pytest.mark.parametrize("power", [-20, -10, 10, 20])
def test_powers_of_two_change_nothing(device, power):
    """Every product and sum scales exactly: the same hits, at any scale."""
    mesh, scale = soup(200, 3), 2.0**power
    origins, directions = rays_to(make_scene(mesh), 3000, 4)
    plain = Tracer(make_scene(mesh), device).closest_hit(origins, directions)
    scaled = Tracer(make_scene(moved(mesh, scale)), device).closest_hit(
        origins * np.float32(scale), directions * np.float32(scale)
    )
    assert plain.tobytes() == scaled.tobytes()


def test_big_and_small_together(device):
    """A cube of a millimetre in a sphere of a thousand kilometres."""
    scene = make_scene(moved(icosphere(3), 1e6), moved(cube(), 1e-3))
    tracer = Tracer(scene, device)
    directions = random_directions(2000, np.random.default_rng(5))
    inside = tracer.closest_hit(np.zeros_like(directions), directions)
    assert (inside["instance"] == 1).all()
    assert ((inside["t"] >= 0.999e-3) & (inside["t"] <= 1.74e-3)).all()
    beyond = tracer.closest_hit(np.zeros_like(directions), directions, t_min=1.0)
    assert (beyond["instance"] == 0).all()
    assert ((beyond["t"] > 0.98e6) & (beyond["t"] < 1.001e6)).all()


@pytest.mark.parametrize("angle", [1e-1, 1e-3, 1e-5, 1e-7])
def test_grazing_incidence(device, angle):
    """A large square met at a small angle: what is above is missed, what descends hits where geometry says."""
    corners = np.array([[-1e3, 0, -1e3], [1e3, 0, -1e3], [1e3, 0, 1e3], [-1e3, 0, 1e3]])
    tracer = Tracer(make_scene(make_mesh(corners, [[0, 1, 2], [0, 2, 3]])), device)
    distance = np.linspace(1, 500, 400)
    height = (distance * np.tan(angle)).astype(np.float32)
    origins = np.column_stack([np.full(400, 7.0), height, np.full(400, 3.0)]).astype(np.float32)
    down = np.tile(np.float32([np.sqrt(0.5), -np.tan(angle), np.sqrt(0.5)]), (400, 1))
    hits = tracer.closest_hit(origins, down)
    assert (hits["instance"] == 0).all()
    # Float32 resolves the place within a triangle to some 1e-7 of its size.
    np.testing.assert_allclose(hits["t"], height / -down[:, 1].astype(np.float64), rtol=1e-5, atol=5e-4)
    assert not tracer.any_hit(origins, down * np.float32([1, -1, 1]), t_max=np.inf).any()
    level = down * np.float32([1, 0, 1])
    assert not tracer.any_hit(origins, level, t_max=np.inf).any()


def test_a_ray_within_a_plane_misses_it(device):
    tracer = Tracer(make_scene(make_mesh([[-1, 0, -1], [1, 0, -1], [0, 0, 1]], [[0, 1, 2]])), device)
    assert not tracer.any_hit([[-5, 0, 0], [0, 0, -5]], [[1, 0, 0], [0, 0, 1]], t_max=np.inf).any()


# Meshes without shape


def test_a_thousand_copies_of_a_triangle(device):
    corners = np.tile([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]], (1000, 1))
    tracer = Tracer(make_scene(make_mesh(corners, np.arange(3000))), device)
    rng = np.random.default_rng(6)
    origins = np.column_stack([rng.uniform(-1, 1, (2000, 2)), np.full(2000, 5.0)]).astype(np.float32)
    hits = tracer.closest_hit(origins, np.tile(np.float32([0, 0, -1]), (2000, 1)))
    x, y = np.abs(origins[:, 0]), origins[:, 1]
    np.testing.assert_array_equal(hits["primitive"] == 0, 2 * x + y < 1)
    assert set(hits["primitive"]) == {0, MISS}


def test_all_centroids_equal(device):
    sizes = np.linspace(1, 2, 500)[:, None, None]
    turned = np.array([[-1, -1, -1], [1, 1, 1], [1, -1, 0]]) * sizes
    scene = make_scene(make_mesh(turned.reshape(-1, 3), np.arange(1500)))
    origins, directions = rays_to(scene, 500, 7)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


@pytest.mark.parametrize("axes", [(0,), (1,), (2,), (0, 2)])
def test_meshes_without_extent_on_an_axis(device, axes):
    """Flat meshes, and one within a line, whose triangles have no area."""
    mesh = soup(100, 8, 0.3)
    mesh.positions[:, list(axes)] = 0.25
    scene = make_scene(mesh)
    origins, directions = rays_to(scene, 1000, 9)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert np.count_nonzero(hits["instance"] != MISS) > (500 if len(axes) == 1 else -1)
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


@pytest.mark.parametrize("n", range(1, 10))
def test_few_triangles(device, n):
    scene = make_scene(soup(n, n, 0.5))
    origins, directions = rays_to(scene, 1000, n)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert np.unique(hits["primitive"][hits["instance"] != MISS]).size == n
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


def test_zero_area_triangles_are_no_wider_than_rounding(device):
    """A point, a line along an axis, a line across, among real triangles, with rays aimed at them."""
    corners = np.array([[[1, 1, 1]] * 3, [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 0, 0], [1, 1, 1], [3, 3, 3]]])
    real = soup(20, 10, 0.3)
    both = np.concatenate([corners, real.positions[real.triangles]]).reshape(-1, 3)
    scene = make_scene(make_mesh(both, np.arange(len(both))))
    rng = np.random.default_rng(11)
    ends = corners[rng.integers(3, size=1000)]
    targets = ends[:, 0] + rng.random((1000, 1)) * (ends[:, 2] - ends[:, 0])
    targets[::2] += 1e-5 * rng.normal(size=(500, 3))
    origins = rng.uniform(-3, 3, (1000, 3)).astype(np.float32)
    directions = (targets - origins).astype(np.float32)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert np.isfinite(hits["t"][hits["instance"] != MISS]).all()
    assert not np.isin(hits["primitive"][::2], [0, 1, 2]).any()
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


def test_needles(device):
    """Triangles a hundredth as wide as long, from all sides."""
    scene = make_scene(prism(600))
    origins, directions = rays_to(scene, 300, 12)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert np.count_nonzero(hits["instance"] != MISS) > 250
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


# Rays


def test_origins_far_outside(device):
    """From a million sizes away the mesh is as wide as the roundings of the ray: no hit is farther off than those."""
    scene = make_scene(cube())
    rng = np.random.default_rng(13)
    origins = (1e6 * random_directions(2000, rng)).astype(np.float32)
    hits = Tracer(scene, device).closest_hit(origins, -origins)
    assert (hits["instance"] == 0).all()
    np.testing.assert_allclose(hits["t"], 1, rtol=3e-6)


def test_origins_on_the_surface_do_not_hit_it(device):
    """Corners of a cube as origins, exactly on three of its sides: t = 0 is not within the interval."""
    mesh = cube()
    tracer = Tracer(make_scene(mesh), device)
    outwards = mesh.positions
    assert not tracer.any_hit(mesh.positions, outwards, t_max=np.inf).any()
    inwards = tracer.closest_hit(mesh.positions, -mesh.positions)
    np.testing.assert_array_equal(inwards["t"], 2)


def test_huge_and_tiny_coordinates_of_rays(device):
    tracer = Tracer(make_scene(cube()), device)
    huge = np.float32(1e30)
    origins = np.float32([[0, 0, 0], [0, 0, 0], [huge, 0, 0], [0, 0, 1e-30], [0, 0, -5]])
    directions = np.float32([[1e-30, 0, 0], [1e30, 0, 0], [0, 1, 0], [0, 0, 1], [1e-38, 0, 1]])
    hits = tracer.closest_hit(origins, directions)
    np.testing.assert_allclose(hits["t"], [1e30, 1e-30, INFINITE, 1, 4], rtol=1e-6)
