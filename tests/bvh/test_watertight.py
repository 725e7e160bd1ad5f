"""A closed mesh, seen from inside, hides everything behind it: no ray leaks through edges or corners."""

import numpy as np
import pytest
from helpers import (
    IDENTITY,
    MISS,
    blob,
    cube,
    edge_targets,
    edges,
    icosphere,
    make_mesh,
    make_scene,
    moved,
    prism,
    random_directions,
    tunnel,
)
from scipy.spatial.transform import Rotation

from clcache.bvh import Tracer

PLACES = [
    (1.0, (0, 0, 0)),
    (1e-6, (0, 0, 0)),
    (1e6, (0, 0, 0)),
    (1.0, (1e4, -1e4, 1e4)),
    (1e3, (1e6, 3, -1e6)),
]
MESHES = {"cube": cube, "icosphere": lambda: icosphere(3), "blob": lambda: blob(4), "needles": lambda: prism(1000)}


def leaks(tracer, origins, directions):
    """Rays that leave, to either query."""
    missed = tracer.closest_hit(origins, directions)["instance"] == MISS
    return np.flatnonzero(missed | ~tracer.any_hit(origins, directions, t_max=np.inf))


def inside(n, rng, scale=1.0, offset=(0, 0, 0)):
    """Points near the middle of a mesh of that size and place; every second one is the middle itself."""
    points = np.asarray(offset) + 0.55 * scale * rng.random((n, 1)) * random_directions(n, rng)
    points[::2] = offset
    return points.astype(np.float32)


@pytest.mark.parametrize(("scale", "offset"), PLACES)
@pytest.mark.parametrize("shape", MESHES)
def test_rays_at_corners_and_edges(device, shape, scale, offset):
    rng = np.random.default_rng(1)
    mesh = moved(MESHES[shape](), scale, offset)
    origins = inside(30_000, rng, scale, offset)
    assert leaks(Tracer(make_scene(mesh), device), origins, edge_targets(mesh, 30_000, rng) - origins).size == 0


def test_a_million_rays(device):
    rng = np.random.default_rng(2)
    mesh = blob(4)
    origins = inside(1_000_000, rng)
    directions = random_directions(1_000_000, rng)
    directions[::3] = edge_targets(mesh, 333_334, rng) - origins[::3]
    missed = Tracer(make_scene(mesh), device).closest_hit(origins, directions)["instance"] == MISS
    assert np.count_nonzero(missed) == 0


def test_a_hole_is_seen(device):
    """What the tests above would say of a mesh that lacks one triangle of 5,120."""
    rng = np.random.default_rng(3)
    mesh = blob(4)
    origins = inside(30_000, rng)
    tracer = Tracer(make_scene(make_mesh(mesh.positions, mesh.triangles[1:])), device)
    assert leaks(tracer, origins, random_directions(30_000, rng)).size > 0


@pytest.mark.parametrize("offset", [0.0, 1e4, 1e6])
def test_rays_that_pass_close_by_long_edges(device, offset):
    """A triangle that reaches far along the ray moves, when sheared, by a rounding error of its far corners' places: boxes
    must be wide enough for that, also where coordinates are so large that the width is lost in adding it."""
    rng = np.random.default_rng(4)
    shape = tunnel(64, half_length=1000.0)
    a, b = (shape.positions[column].astype(np.float64) for column in edges(shape).T)
    is_long = np.linalg.norm(a - b, axis=1) > 1000
    pick = rng.choice(np.flatnonzero(is_long), 200_000)
    along = 0.5 + 0.03 * rng.normal(size=(200_000, 1))
    beside = rng.normal(size=(200_000, 3)) * 10.0 ** rng.uniform(-6, -3, (200_000, 1))
    directions = (a[pick] * (1 - along) + b[pick] * along + beside).astype(np.float32)
    origins = np.full((200_000, 3), offset, np.float32)
    tracer = Tracer(make_scene(moved(shape, 1, [offset] * 3)), device)
    assert leaks(tracer, origins, directions).size == 0


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_axis_parallel_rays_within_the_planes_of_boxes(device, axis):
    """Rays along an axis whose other coordinates are those of a corner: both lie in planes of boxes."""
    finer = cube()
    for _ in range(4):  # on a lattice, so that corners, edges and box planes coincide everywhere
        pairs = np.sort(finer.triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
        middles, number = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
        ab, bc, ca = number.reshape(-1, 3).T + len(finer.positions)
        a, b, c = finer.triangles.T
        positions = np.vstack([finer.positions, finer.positions[middles].mean(axis=1)])
        finer = make_mesh(positions, np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]).transpose(0, 2, 1))
    for mesh, limit in ((finer, 0.99), (icosphere(4), 0.7), (blob(4, roughness=0.1), 0.6)):
        across = np.delete(np.arange(3), axis)
        corners = mesh.positions[np.linalg.norm(mesh.positions[:, across], axis=1) < limit]
        origins = corners.copy()
        origins[:, axis] = 0
        along = np.zeros_like(origins)
        along[:, axis] = 1
        tracer = Tracer(make_scene(mesh), device)
        assert len(origins) > 100
        assert leaks(tracer, np.vstack([origins] * 3), np.vstack([along, -along, along * np.float32(1e-3)])).size == 0


@pytest.mark.parametrize("stretch", [(1, 1, 1), (0.01, 1, 30), (1e-4, 1e-4, 1e-4), (1e5, 1e5, 1e5)])
@pytest.mark.parametrize("distance", [0, 1e3])
def test_rotated_and_stretched_instances(device, stretch, distance):
    rng = np.random.default_rng(5)
    matrix = Rotation.random(random_state=6).as_matrix() @ np.diag(stretch)
    middle = distance * min(stretch) * np.array([1.0, -2.0, 3.0])
    mesh = blob(3)
    tracer = Tracer(make_scene(mesh, instances=[(0, np.column_stack([matrix, middle]))]), device)
    origins = (inside(30_000, rng).astype(np.float64) @ matrix.T + middle).astype(np.float32)
    targets = edge_targets(mesh, 30_000, rng).astype(np.float64) @ matrix.T + middle
    assert leaks(tracer, origins, (targets - origins).astype(np.float32)).size == 0


@pytest.mark.parametrize(("scale", "offset"), PLACES)
def test_a_room_of_several_instances(device, scale, offset):
    """The walls of one closed mesh as meshes of their own, each placed by the identity, share their edges exactly."""
    rng = np.random.default_rng(7)
    whole = moved(blob(3), scale, offset)
    part = rng.integers(8, size=len(whole.triangles))
    walls = [make_mesh(whole.positions, whole.triangles[part == k]) for k in range(8)]
    tracer = Tracer(make_scene(*walls, instances=[(k, IDENTITY) for k in range(8)]), device)
    origins = inside(30_000, rng, scale, offset)
    assert leaks(tracer, origins, edge_targets(whole, 30_000, rng) - origins).size == 0


def test_rays_that_part_into_many_instances(device):
    """Tubes far apart, each turned its own way; rays beside each other start in different ones and aim at long edges."""
    rng = np.random.default_rng(8)
    shape = tunnel(32, half_length=500.0)
    turns = Rotation.random(216, random_state=9).as_matrix()
    places = 4000.0 * np.stack(np.meshgrid(*[np.arange(6)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    placed = [(0, np.column_stack([turn, place])) for turn, place in zip(turns, places, strict=True)]
    tracer = Tracer(make_scene(shape, instances=placed), device)
    own = rng.integers(216, size=100_000)
    targets = edge_targets(shape, 100_000, rng) + rng.normal(size=(100_000, 3)) * 10.0 ** rng.uniform(
        -5, -2, (100_000, 1)
    )
    directions = np.einsum("rij,rj->ri", turns[own], targets).astype(np.float32)
    hits = tracer.closest_hit(places[own].astype(np.float32), directions)
    np.testing.assert_array_equal(hits["instance"], own)
