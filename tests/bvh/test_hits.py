"""Hits of the tracer against every ray with every triangle in float64, and the rules of its public interface."""

import numpy as np
import pytest
from helpers import (
    IDENTITY,
    MISS,
    WorldTriangles,
    blob,
    cube,
    edge_targets,
    make_mesh,
    make_scene,
    moved,
    prism,
    random_directions,
    soup,
    tunnel,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from clcache.bvh import HIT_DTYPE, Tracer

PLACES = [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e4), (1e3, -1e6)]
MESHES = {
    "soup": lambda: soup(50, 1, 0.3),
    "blob": lambda: blob(1),
    "prism": lambda: prism(10),
    "cube": cube,
    "tunnel": lambda: tunnel(20),
}


def cube_rays(n, seed, scale=1.0, offset=0.0):
    """Origins in and about the cube of that size and place, directions to points within it."""
    rng = np.random.default_rng(seed)
    origins = (offset + scale * rng.uniform(-2, 2, (n, 3))).astype(np.float32)
    return origins, (offset + scale * rng.uniform(-1, 1, (n, 3))).astype(np.float32) - origins


def square(z=0.0, size=1.0):
    """Two triangles in the plane z, about the z axis."""
    corners = np.array([[-1, -1, z], [1, -1, z], [1, 1, z], [-1, 1, z]]) * [size, size, 1]
    return make_mesh(corners, [[0, 1, 2], [0, 2, 3]])


# Against brute force


@pytest.mark.parametrize(("scale", "offset"), PLACES)
@pytest.mark.parametrize("shape", MESHES)
def test_hits_equal_brute_force(device, shape, scale, offset):
    mesh = moved(MESHES[shape](), scale, [offset] * 3)
    scene = make_scene(mesh)
    tracer, triangles = Tracer(scene, device), WorldTriangles.of(scene)
    origins, directions = cube_rays(2000, 1, scale, offset)
    directions[1000:] = edge_targets(mesh, 1000, np.random.default_rng(2)) - origins[1000:]
    hits = tracer.closest_hit(origins, directions)
    assert np.count_nonzero(hits["instance"] != MISS) > 500
    assert not triangles.wrong(hits, origins, directions).any()


def test_brute_force_notices_wrong_hits():
    scene = make_scene(soup(50, 1, 0.3))
    triangles = WorldTriangles.of(scene)
    origins, directions = cube_rays(500, 1)
    hits = Tracer(scene).closest_hit(origins, directions)
    found = hits["instance"] != MISS

    def share_noticed(change):
        spoiled = hits.copy()
        change(spoiled)
        return triangles.wrong(spoiled, origins, directions)[found].mean()

    def forget(h):
        h["instance"] = h["primitive"] = MISS

    def lengthen(h):
        h["t"] *= 1 + 1e-4

    def renumber(h):
        h["primitive"] = np.where(found, (h["primitive"] + 1) % 50, MISS)

    def look_behind(h):
        behind = hits.copy()
        behind[:] = Tracer(scene).closest_hit(origins, directions, t_min=np.where(found, hits["t"] * 1.001, 0))
        h[:] = behind

    for change in (forget, lengthen, renumber, look_behind):
        assert share_noticed(change) > 0.98


@settings(max_examples=60, deadline=None)
@given(data=st.data(), seed=st.integers(0, 2**32 - 1), exponent=st.integers(-6, 6))
def test_tiny_meshes_on_a_lattice(device, data, seed, exponent):
    """Corners on a small lattice: shared corners, triangles in one plane, needles, duplicates, flat meshes."""
    n = data.draw(st.integers(1, 12))
    lattice = data.draw(hnp.arrays(np.int8, (n, 3, 3), elements=st.integers(-2, 2))).astype(np.float64)
    scene = make_scene(make_mesh(lattice.reshape(-1, 3) * 10.0**exponent, np.arange(3 * n)))
    origins, directions = cube_rays(64, seed, 2 * 10.0**exponent)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(-3, 3), distance=st.integers(0, 4), count=st.integers(1, 8))
def test_instances_rotated_stretched_and_moved(device, seed, size, distance, count):
    rng = np.random.default_rng(seed)
    meshes = (soup(20, 1, 0.3), blob(1), cube())
    scale = 10.0**size
    instances = [
        (
            int(rng.integers(3)),
            np.column_stack(
                [
                    Rotation.random(random_state=rng).as_matrix() @ np.diag(scale * rng.uniform(0.1, 3, 3)),
                    scale * 10.0**distance * rng.uniform(-3, 3, 3),
                ]
            ),
        )
        for _ in range(count)
    ]
    scene = make_scene(*meshes, instances=instances)
    triangles = WorldTriangles.of(scene)
    origins = (scale * 10.0**distance * rng.uniform(-3, 3, (200, 3))).astype(np.float32)
    aimed = triangles.corners[rng.integers(len(triangles.corners), size=200)].mean(axis=1)
    directions = (aimed + 0.1 * scale * rng.normal(size=(200, 3)) - origins).astype(np.float32)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert np.count_nonzero(hits["instance"] != MISS) > 20
    assert not triangles.wrong(hits, origins, directions).any()


def test_weights_and_t_give_the_same_point(device):
    mesh = blob(2)
    origins, directions = cube_rays(5000, 3)
    hits = Tracer(make_scene(mesh), device).closest_hit(origins, directions)
    found = hits["instance"] != MISS
    hits, origins, directions = hits[found], origins[found], directions[found]
    a, b, c = (mesh.positions[mesh.triangles[hits["primitive"], k]].astype(np.float64) for k in range(3))
    u, v = hits["u"][:, None].astype(np.float64), hits["v"][:, None].astype(np.float64)
    assert ((u >= 0) & (v >= 0) & (u + v <= 1 + 1e-6)).all()
    by_weights = (1 - u - v) * a + u * b + v * c
    by_t = origins + hits["t"][:, None].astype(np.float64) * directions
    assert np.abs(by_weights - by_t).max() < 1e-4
    assert np.median(np.abs(by_weights - by_t)) < 3e-7


def test_many_small_meshes(device):
    """300 meshes of 1 to 5 triangles: trees that are a leaf, and trees of one node."""
    rng = np.random.default_rng(4)
    meshes = [moved(soup(1 + k % 5, k, 0.05), 0.2, rng.uniform(-1, 1, 3)) for k in range(300)]
    scene = make_scene(*meshes)
    origins, directions = cube_rays(1000, 5)
    aimed = WorldTriangles.of(scene).corners[rng.integers(900, size=1000)].mean(axis=1)
    directions[:] = aimed - origins
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert (hits["instance"] != MISS).all()
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


def test_thousands_of_instances(device):
    """A lattice of cubes seen along its rows: the first cube in each row."""
    k = np.arange(16)
    places = np.stack(np.meshgrid(k, k, k, indexing="ij"), axis=-1).reshape(-1, 3) * 4.0
    scene = make_scene(cube(), instances=[(0, np.column_stack([np.eye(3), p])) for p in places])
    rng = np.random.default_rng(6)
    row = rng.integers(256, size=2000)
    origins = (places[16 * row] + np.column_stack([rng.uniform(-0.9, 0.9, (2000, 2)), np.full(2000, -10.0)])).astype(
        np.float32
    )
    hits = Tracer(scene, device).closest_hit(origins, np.tile(np.float32([0, 0, 1]), (2000, 1)))
    np.testing.assert_array_equal(hits["instance"], 16 * row)
    np.testing.assert_allclose(hits["t"], 9, rtol=2e-7)


def test_nested_scales(device):
    """A thousand shells, each a thousandth larger than the one inside it, with the smallest at the middle."""
    growth = 1.001 ** np.arange(1000)
    scene = make_scene(cube(), instances=[(0, np.column_stack([g * np.eye(3), np.zeros(3)])) for g in growth])
    tracer = Tracer(scene, device)
    for start in (0, 1, 400, 998):
        origin = np.float32([[0.1, 0.2, (growth[start] + growth[start + 1]) / 2]])
        outwards, inwards = (tracer.closest_hit(origin, np.float32([[0, 0, s]]))[0] for s in (1, -1))
        assert (inwards["instance"], outwards["instance"]) == (start, start + 1)


# The interval, misses, ties, and any hit


def test_interval_is_open(device):
    tracer = Tracer(make_scene(square(1.0), square(2.0)), device)

    def hit(t_min, t_max):
        args = ([[0.25, 0.5, 0]], [[0, 0, 1]], t_min, t_max)
        found = tracer.closest_hit(*args)[0]
        assert bool(tracer.any_hit(*args)[0]) == (found["instance"] != MISS)
        return found["instance"]

    below, above = np.nextafter(np.float32([1, 2]), 0), np.nextafter(np.float32([1, 2]), 3)
    assert hit(0, np.inf) == 0
    assert hit(0, 1) == MISS
    assert hit(0, above[0]) == 0
    assert hit(1, np.inf) == 1
    assert hit(below[0], np.inf) == 0
    assert hit(1, 2) == MISS
    assert hit(1, above[1]) == 1
    assert hit(below[1], above[1]) == 1
    assert hit(2, np.inf) == MISS
    assert hit(1.5, 1.5) == hit(3, 1) == hit(np.inf, np.inf) == hit(0, 0) == MISS


def test_t_max_of_any_hit_is_1_by_default(device):
    tracer = Tracer(make_scene(square(1.0)), device)
    assert tracer.any_hit([[0, 0, 0]], [[0, 0, 1.001]])[0]
    assert not tracer.any_hit([[0, 0, 0]], [[0, 0, 0.999]])[0]


def test_a_miss(device):
    hit = Tracer(make_scene(square()), device).closest_hit([[5, 5, 5]], [[0, 1, 0]], t_max=7.0)[0]
    assert hit["t"] == np.inf
    assert hit["primitive"] == hit["instance"] == MISS


@pytest.mark.parametrize("t_max", [np.inf, 1.0, 0.5])
def test_any_hit_agrees_with_closest_hit(device, t_max):
    scene = make_scene(
        soup(300, 2, 0.2), cube(), instances=[(0, IDENTITY), (1, np.column_stack([0.2 * np.eye(3), [2, 0, 0]]))]
    )
    tracer = Tracer(scene, device)
    origins, directions = cube_rays(20_000, 8)
    t_min = np.random.default_rng(9).uniform(0, 0.3, 20_000).astype(np.float32)
    closest = tracer.closest_hit(origins, directions, t_min, t_max)
    found = closest["instance"] != MISS
    assert 0.05 < found.mean() < 0.95
    np.testing.assert_array_equal(tracer.any_hit(origins, directions, t_min, t_max), found)
    assert ((closest["t"][found] > t_min[found]) & (closest["t"][found] < t_max)).all()


def test_ties_go_to_the_lowest_instance_then_primitive(device):
    """Copies of one triangle, in several meshes and instances; each mesh's copies come in another place of its order."""
    rng = np.random.default_rng(11)
    triangle = np.array([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]])
    others = [moved(soup(k, k), 1, [0, 0, -50]) for k in (7, 3, 0)]
    meshes = [
        make_mesh(np.vstack([other.positions, np.tile(triangle, (5, 1))]), np.arange(len(other.positions) + 15))
        for other in others
    ]
    first_copy = [7, 3, 0]
    used = [2, 0, 1, 2, 0]
    scene = make_scene(*meshes, instances=[(m, IDENTITY) for m in used])
    origins = np.column_stack([rng.uniform(-0.9, 0.9, (500, 2)), rng.uniform(1, 9, 500)]).astype(np.float32)
    directions = np.column_stack([rng.uniform(-0.01, 0.01, (500, 2)), np.full(500, -1.0)]).astype(np.float32)
    hits = Tracer(scene, device).closest_hit(origins, directions)
    assert (hits["instance"] == 0).all()
    assert (hits["primitive"] == first_copy[used[0]]).all()
    later = Tracer(make_scene(*meshes, instances=[(m, IDENTITY) for m in used[1:]]), device).closest_hit(
        origins, directions
    )
    assert (later["instance"] == 0).all()
    assert (later["primitive"] == first_copy[used[1]]).all()


def test_hits_do_not_depend_on_the_order_of_triangles(device):
    """Edges and corners of a cube, where several triangles are equally near: the lowest number wins in every order."""
    rng = np.random.default_rng(12)
    mesh = cube()
    targets = edge_targets(mesh, 3000, rng)
    origins = np.zeros_like(targets)
    hits = Tracer(make_scene(mesh), device).closest_hit(origins, targets)
    for _ in range(3):
        shuffle = rng.permutation(12)
        again = Tracer(make_scene(make_mesh(mesh.positions, mesh.triangles[shuffle])), device).closest_hit(
            origins, targets
        )
        np.testing.assert_array_equal(again["t"], hits["t"])
        tied = shuffle[again["primitive"]] != hits["primitive"]
        assert (tied == (np.argsort(shuffle)[hits["primitive"]] > again["primitive"])).all()


def test_bit_equal_for_other_work_group_sizes(device, other_groups):
    scene = make_scene(soup(500, 3), blob(2))
    origins, directions = cube_rays(5001, 13)
    first, second = (Tracer(scene, d).closest_hit(origins, directions) for d in (device, other_groups))
    assert first.tobytes() == second.tobytes()


# Arguments


def test_no_rays(device):
    tracer = Tracer(make_scene(square()), device)
    empty = np.zeros((0, 3), np.float32)
    assert tracer.closest_hit(empty, empty).dtype == HIT_DTYPE
    assert tracer.closest_hit(empty, empty).shape == tracer.any_hit(empty, empty).shape == (0,)


@pytest.mark.parametrize(
    ("origins", "directions", "limits", "message"),
    [
        ([[0, 0]], [[0, 0, 1]], {}, "not both"),
        ([[0, 0, 0]], [[0, 0, 1]] * 2, {}, "not both"),
        ([0, 0, 0], [0, 0, 1], {}, "not both"),
        ([[0, 0, np.nan]], [[0, 0, 1]], {}, "not finite"),
        ([[0, 0, 0]], [[0, 0, np.inf]], {}, "not finite"),
        ([[0, 0, 0]] * 2, [[0, 0, 1], [0, 0, 0]], {}, "direction 1 is zero"),
        ([[0, 0, 0]], [[0, 0, 1]], {"t_max": np.nan}, "not a number"),
        ([[0, 0, 0]], [[0, 0, 1]], {"t_min": np.nan}, "not a number"),
        ([[0, 0, 0]], [[0, 0, 1]], {"t_min": -1.0}, "below 0"),
        ([[0, 0, 0]], [[0, 0, 1]], {"t_min": [0, 0]}, "broadcast"),
    ],
)
def test_rays_that_do_not_fit(device, origins, directions, limits, message):
    tracer = Tracer(make_scene(square()), device)
    for trace in (tracer.closest_hit, tracer.any_hit):
        with pytest.raises(ValueError, match=message):
            trace(origins, directions, **limits)


def test_memory_is_given_back(device):
    tracer = Tracer(make_scene(blob(1)), device)
    before = device.allocated
    rays = cube_rays(100, 14)
    tracer.closest_hit(*rays)
    tracer.any_hit(*rays)
    assert device.allocated == before


def test_directions_of_any_length(device):
    scene = make_scene(blob(2))
    tracer = Tracer(scene, device)
    directions = random_directions(2000, np.random.default_rng(15))
    origins = np.zeros_like(directions)
    unit = tracer.closest_hit(origins, directions)
    for length in (2.0**-60, 2.0**-10, 2.0**60):
        scaled = tracer.closest_hit(origins, directions * np.float32(length))
        np.testing.assert_array_equal(scaled["primitive"], unit["primitive"])
        np.testing.assert_array_equal(scaled["t"] * np.float32(length), unit["t"])
