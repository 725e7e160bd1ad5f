"""First hits in 128 bits: what is packed comes back, points to within half a step of 24 bits, and lie where the scene is now;
pixels and rays invert each other."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers import UNIT_ROUNDOFF, make_mesh, make_scene, random_directions
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from kernel_source import build
from render_helpers import view

from clcache.renderer import camera_record
from clcache.resources import SceneResources

NONE = 0xFFFFFFFF
STEPS = 2**24 - 1  # between 0 and 1
SOURCE = """
#include "scene/first_hit.cl"
#include "samplecache/moved.cl"

__kernel void pack(
    __global const float *uv,   // (2, n)
    __global const uint *ids,   // (3, n)
    __global uint *words,       // (n, 4)
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) store_first_hit(words, i, pack_first_hit(uv[i], uv[n + i], ids[i], ids[n + i], ids[2 * n + i]));
}

__kernel void unpack(
    __global const uint *words,  // (n, 4)
    __global float *uv,          // (2, n)
    __global uint *ids,          // (4, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    FirstHit hit = load_first_hit(words, i);
    uv[i] = unpack_u(hit);
    uv[n + i] = unpack_v(hit);
    ids[i] = hit.z;
    ids[n + i] = hit.w;
    ids[2 * n + i] = unpack_material(hit);
    ids[3 * n + i] = is_background(hit);
}

__kernel void copy(
    __global const uint *from,    // (n, 4)
    __global uint *to,            // (n, 4)
    __global const uint *before,  // (n, 4)
    __global uint *moved,         // (n, 4)
    __global uint *shading,       // (n, 4)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    store_first_hit(to, n - 1 - i, load_first_hit(from, i));
    Caches caches = { from, before, moved, shading };
    move_sample(&caches, i, n - 1 - i);
}

__kernel void background(
    __global const float *direction,  // (3, n)
    __global float *unpacked,         // (3, n)
    __global uint *words,             // (n, 4)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    FirstHit hit = pack_background(load_vec3(direction, n, i));
    store_first_hit(words, i, hit);
    store_planes(unpacked, n, i, unpack_direction(hit));
}

__kernel void locations(
    __global const float *positions,     // (vertices, 3)
    __global const uint *triangles,      // (triangles, 3)
    __global const Instance *instances,  // (instances)
    __global const uint *words,          // (n, 4)
    __global float *point,               // (3, n)
    __global float *normal,              // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Geometry geometry = { positions, triangles, instances };
    Located located = locate(&geometry, load_first_hit(words, i));
    store_planes(point, n, i, located.point);
    store_planes(normal, n, i, located.normal);
}

__kernel void projections(
    __global const float *towards,  // (3, n)
    __global float *xy,             // (2, n)
    __global uint *in_front,        // (n)
    Camera camera,
    float near,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    float x, y;
    in_front[i] = project(&camera, load_vec3(towards, n, i), near, &x, &y);
    xy[i] = x;
    xy[n + i] = y;
}

__kernel void rays(
    __global const float *xy,   // (2, n)
    __global float *direction,  // (3, n)
    Camera camera,
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) store_planes(direction, n, i, through_pixel(&camera, xy[i], xy[n + i]));
}

// Integers divide exactly.
__kernel void misplaced(
    __global const uint *pixels,     // (n)
    __global volatile uint *wrong,   // (1)
    uint first,
    uint width,
    uint n,
    uint listed)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    uint pixel = listed ? pixels[i] : first + i;
    int row, column;
    place_of_pixel(pixel, width, &row, &column);
    if (row != (int)(pixel / width) || column != (int)(pixel % width)) atomic_inc(wrong);
}
"""


@pytest.fixture(scope="module")
def functions(device, tmp_path_factory):
    """The device's functions over arrays."""
    program = build(device, SOURCE, tmp_path_factory.mktemp("cl"), SLOTS=12, WORDS=1, HAS_RADIANCE=True)

    def run(kernel, n, inputs, outputs=None, **scalars):
        arrays = {name: device.upload(np.ascontiguousarray(values)) for name, values in inputs.items()}
        results = {name: device.empty(shape, dtype) for name, (shape, dtype) in (outputs or {}).items()}
        program[kernel].run(n, arrays, results, n=n, **scalars)
        found = [array.get() for array in results.values()]
        device.release(*arrays.values(), *results.values())
        return found[0] if len(found) == 1 else found

    def pack(u, v, primitive, instance, material):
        n = np.size(u)
        inputs = {"uv": np.float32([u, v]), "ids": np.array([primitive, instance, material], np.uint32)}
        return run("pack", n, inputs, {"words": ((n, 4), np.uint32)})

    def unpack(words):
        n = len(words)
        uv, ids = run("unpack", n, {"words": words}, {"uv": ((2, n), np.float32), "ids": ((4, n), np.uint32)})
        return SimpleNamespace(
            u=uv[0], v=uv[1], primitive=ids[0], instance=ids[1], material=ids[2], is_background=ids[3].astype(bool)
        )

    def background(directions):
        n = len(directions)
        outputs = {"unpacked": ((3, n), np.float32), "words": ((n, 4), np.uint32)}
        unpacked, words = run("background", n, {"direction": directions.T.astype(np.float32)}, outputs)
        return unpacked.T, words

    return SimpleNamespace(run=run, pack=pack, unpack=unpack, background=background)


unit_floats = st.floats(0, 1, width=32)
ids = st.integers(0, NONE)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(unit_floats, unit_floats, ids, st.integers(0, NONE - 1), st.integers(0, 0xFFFF)), min_size=1))
@example([(0.0, 1.0, 0, 0, 0xFFFF), (1.0, 0.0, NONE, NONE - 1, 0x00FF), (0.5, 0.5, 1, 1, 0xFF00)])
def test_round_trip(functions, hits):
    u, v, primitive, instance, material = np.array(hits).T
    found = functions.unpack(functions.pack(u, v, primitive, instance, material))
    np.testing.assert_array_equal(found.primitive, primitive)
    np.testing.assert_array_equal(found.instance, instance)
    np.testing.assert_array_equal(found.material, material)
    assert not found.is_background.any()
    for given_number, unpacked in ((u, found.u), (v, found.v)):
        assert np.abs(unpacked - given_number).max() <= 0.5 / STEPS + UNIT_ROUNDOFF / 2


def test_every_material_and_no_crosstalk(functions):
    """All 16 bits of the material, beside coordinates whose 24 bits are all 0, all 1, and random."""
    material = np.arange(1 << 16)
    for u in (np.zeros(1 << 16), np.ones(1 << 16), np.random.default_rng(1).random(1 << 16)):
        words = functions.pack(u, 1 - u, material, material[::-1], material)
        found = functions.unpack(words)
        np.testing.assert_array_equal(found.material, material)
        np.testing.assert_array_equal(words[:, 0] >> 24, material & 0xFF)
        np.testing.assert_array_equal(words[:, 1] >> 24, material >> 8)
        assert np.abs(found.u - u).max() <= 0.5 / STEPS + UNIT_ROUNDOFF
        assert np.abs(found.v - (1 - u)).max() <= 0.5 / STEPS + UNIT_ROUNDOFF


def test_coordinates_go_to_the_nearest_step(functions):
    """Of all magnitudes, and every float in a range about each power of two; what is beyond 0 and 1 comes to them."""
    rng = np.random.default_rng(2)
    powers = np.ldexp(np.float32(1), np.arange(-26, 1))
    about = (powers.view(np.int32)[:, None] + np.arange(-2000, 1, dtype=np.int32)).view(np.float32).ravel()
    u = np.concatenate([rng.random(1 << 20), 10 ** rng.uniform(-9, 0, 1 << 20), about]).astype(np.float32)
    words = functions.pack(u, u, *np.zeros((3, u.size)))[:, 0]
    assert np.abs(words - u.astype(np.float64) * STEPS).max() <= 0.5 + 1e-7  # a tie may go either way
    outside = np.float32([-1e-30, -0.0, -5, 1 + 2**-23, 7, np.inf, -np.inf])
    words = functions.pack(outside, outside, *np.zeros((3, 7)))[:, 0]
    np.testing.assert_array_equal(words, [0, 0, 0, STEPS, STEPS, STEPS, 0])


def test_all_steps_are_kept(functions):
    """A sample that is packed again, as it was unpacked, does not wander."""
    step = np.concatenate([np.arange(1 << 20), np.arange(STEPS - (1 << 20), STEPS + 1), np.arange(0, STEPS, 17)])
    words = np.zeros((step.size, 4), np.uint32)
    words[:, 0] = words[:, 1] = step
    found = functions.unpack(words)
    np.testing.assert_array_equal(found.u, (step / STEPS).astype(np.float32))
    np.testing.assert_array_equal(functions.pack(found.u, found.v, *np.zeros((3, step.size))), words)


def test_words_that_would_be_no_numbers_are_copied_unchanged(functions):
    """Quiet and signalling NaNs of either sign, infinities and denormals, in each of the words."""
    odd = np.array(
        [0x7FC00001, 0x7F800001, 0xFF800001, NONE, 0x7F800000, 0xFFC00000, 0xFF800000, 1, 0x80000001, 0x807FFFFF],
        np.uint32,
    )
    words = np.stack(np.meshgrid(odd, odd, odd, odd), axis=-1).reshape(-1, 4)
    n = len(words)
    before = words.copy()
    before[:, 3] &= 0xFFFF  # new: the age grows from 0 to 1
    names = ("to", "moved", "shading")
    outputs = dict.fromkeys(names, ((n, 4), np.uint32))
    copied, moved, shading = functions.run("copy", n, {"from": words, "before": before}, outputs)
    np.testing.assert_array_equal(copied, words[::-1])
    np.testing.assert_array_equal(moved, words[::-1])
    np.testing.assert_array_equal(shading, before[::-1] + [0, 0, 0, 0x10000])


def angles(a, b):
    """(n,) in radians, in float64."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))


def test_background_directions(functions):
    """All round, near the folds, and along axes and diagonals of all octants: within 6e-7 radians. Half a step in each of the
    two coordinates turns a direction by at most sqrt(18) 2^-24, 2.5e-7; the rest is rounding, most of it of u and v below 1."""
    rng = np.random.default_rng(3)
    anywhere = random_directions(1 << 20, rng)
    flat = random_directions(3 << 16, rng).reshape(3, -1, 3) * (1 - (1 - 1e-7) * np.eye(3)[:, None])
    special = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 3)
    special = special[np.abs(special).sum(axis=1) > 0]
    beside = special + 1e-8 * rng.normal(size=(100, *special.shape))
    directions = np.concatenate([anywhere, flat.reshape(-1, 3), special, beside.reshape(-1, 3)]).astype(np.float32)
    unpacked, words = functions.background(directions)
    assert angles(unpacked, directions).max() < 6e-7
    assert np.abs(np.linalg.norm(unpacked.astype(np.float64), axis=1) - 1).max() < 2e-7
    np.testing.assert_array_equal(words[:, 2:], NONE)
    assert functions.unpack(words).is_background.all()


def test_background_in_every_octant_and_of_any_length(functions):
    """Signs are kept where they are more than rounding; the length does not matter."""
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 1, 3)
    directions = (signs * np.random.default_rng(4).uniform(0.01, 1, (1000, 3))).reshape(-1, 3).astype(np.float32)
    unpacked, words = functions.background(directions)
    np.testing.assert_array_equal(np.sign(unpacked), np.sign(directions))
    for factor in (2.0**-100, 2.0**100):
        np.testing.assert_array_equal(functions.background(directions * np.float32(factor))[1], words)


def located(device, functions, scene, words, to_world=None):
    """The device's points and normals, (n, 3). to_world: (i, 3, 4), where instances are if not where the scene has them."""
    arrays = SceneResources(device, scene).arrays
    records = arrays["instances"].get()
    if to_world is not None:
        records["to_world"] = to_world.reshape(-1, 12)
    n = len(words)
    inputs = {"positions": arrays["positions"].get(), "triangles": arrays["triangles"].get(), "words": words}
    outputs = {"point": ((3, n), np.float32), "normal": ((3, n), np.float32)}
    point, normal = functions.run("locations", n, inputs | {"instances": records}, outputs)
    return point.T, normal.T


def two_meshes(n=400, size=1.0, seed=5):
    """Random triangles, and which of them belong to which of four instances of two meshes."""
    rng = np.random.default_rng(seed)
    meshes = [make_mesh(rng.normal(size=(3 * n, 3)) * size, np.arange(3 * n)) for _ in range(2)]
    scene = make_scene(
        *meshes, instances=[(0, np.eye(4)[:3]), (1, np.eye(4)[:3]), (1, np.eye(4)[:3]), (0, np.eye(4)[:3])]
    )
    return scene, rng


def corners_of(scene, to_world, primitive, instance):
    """(n, 3, 3) in the world, in float64."""
    own = np.array([scene.meshes[i.mesh].positions[scene.meshes[i.mesh].triangles] for i in scene.instances])
    corners = own.astype(np.float64)[instance, primitive]
    matrix = to_world.astype(np.float32).astype(np.float64)[instance]
    return np.einsum("nij,nkj->nki", matrix[:, :, :3], corners) + matrix[:, None, :, 3]


def transforms():
    """Scaled, mirrored, turned, and sheared with a move."""
    turn, _ = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))
    matrices = [
        np.diag([3.0, 0.1, 2.0]),
        np.diag([-1.0, 1.0, 1.0]),
        turn,
        [[0.5, 0.2, 0], [0, -0.9, 0.3], [0.1, 0, -0.6]],
    ]
    moves = [[0, 0, 0], [1, 2, 3], [0, 0, 0], [-7, 5, 40]]
    return np.concatenate([np.array(matrices), np.array(moves)[..., None]], axis=2)


def test_location_follows_the_current_transforms(device, functions):
    """The scene was uploaded with all instances at rest; since then they were placed elsewhere. Displacement: half a step of
    each edge, and rounding."""
    scene, rng = two_meshes()
    n = 4000
    primitive, instance = rng.integers(400, size=n), rng.integers(4, size=n)
    u, v = np.sort(rng.random((2, n)).astype(np.float32), axis=0)
    v = v - u
    words = functions.pack(u, v, primitive, instance, rng.integers(65536, size=n))
    to_world = transforms()
    point, normal = located(device, functions, scene, words, to_world)
    a, b, c = corners_of(scene, to_world, primitive, instance).transpose(1, 0, 2)
    exact = a + u[:, None].astype(np.float64) * (b - a) + v[:, None].astype(np.float64) * (c - a)
    matrix = np.abs(to_world)[instance]
    size = np.abs(scene.meshes[0].positions).max(), np.abs(scene.meshes[1].positions).max()
    rounding = 16 * UNIT_ROUNDOFF * (matrix[:, :, :3].sum(axis=2) * max(size) + matrix[:, :, 3])
    allowed = (np.abs(b - a) + np.abs(c - a)) / 2**25 + rounding
    assert (np.abs(point - exact) <= allowed).all()
    cross = np.cross(b - a, c - a)
    well_shaped = np.linalg.norm(cross, axis=1) > 0.05 * np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    assert well_shaped.mean() > 0.8
    between = angles(normal, cross)
    assert np.minimum(between, np.pi - between)[well_shaped].max() < 1e-5
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=3e-7)


@pytest.mark.parametrize("size", [2.0**-20, 1.0, 2.0**20])
def test_displacement_is_at_most_half_a_step(device, functions, size):
    """Of right triangles whose corner is the origin and whose sides are powers of two, all arithmetic but the last is exact:
    what is left is what the 24 bits cannot say. The worst that is found is near the bound, so that the bound says something."""
    mesh = make_mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) * size, [[0, 1, 2]])
    rng = np.random.default_rng(7)
    u, v = np.sort(rng.random((2, 1 << 18)).astype(np.float32), axis=0)
    v -= u
    corner_u, corner_v = np.float32([0, 1, 0]), np.float32([0, 0, 1])
    words = functions.pack(np.append(u, corner_u), np.append(v, corner_v), *np.zeros((3, u.size + 3)))
    point, normal = located(device, functions, make_scene(mesh), words)
    np.testing.assert_array_equal(point[-3:], mesh.positions)
    np.testing.assert_array_equal(normal, [[0, 0, 1]] * len(normal))
    away = np.abs(point[:-3, :2].astype(np.float64) / size - np.stack([u, v], axis=1))
    assert away.max() <= 0.5 / STEPS + UNIT_ROUNDOFF / 2  # the rounding of a float below 1
    assert away.max() > 0.4 / STEPS


@pytest.mark.parametrize("scale", [1e-25, 1e-6, 1e6, 1e18])
@pytest.mark.parametrize("by_instance", [False, True])
def test_normals_of_tiny_and_of_huge_triangles(device, functions, scale, by_instance):
    """Also where the product of two edges is too small for a float."""
    scene, rng = two_meshes(size=1.0 if by_instance else scale)
    n = 2000
    primitive, instance = rng.integers(400, size=n), rng.integers(4, size=n)
    words = functions.pack(*np.full((2, n), 0.25), primitive, instance, np.zeros(n))
    to_world = np.concatenate([np.eye(3) * (scale if by_instance else 1.0), np.zeros((3, 1))], axis=1)[None].repeat(
        4, axis=0
    )
    point, normal = located(device, functions, scene, words, to_world)
    assert np.isfinite(normal).all()
    assert np.isfinite(point).all()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=3e-7)
    a, b, c = (corners_of(scene, to_world, primitive, instance) / scale).transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    between = angles(normal, cross)
    well_shaped = np.linalg.norm(cross, axis=1) > 0.05 * np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    assert np.minimum(between, np.pi - between)[well_shaped].max() < 1e-5


CAMERAS = [
    view((0, 0, 0), (0, 0, -1), 40),
    view((3, -2, 5), (-1, 4, 2), 90),
    view((1e4, 2e4, -3e4), (0, 0, 0), 5),
    view((0, 1, 0), (0, 0, 0.01), 150, up=(0, 0, -1)),
]
SIZES = [(1, 1), (3, 5), (1920, 1080), (4096, 17)]


def in_view(camera, size, xy):
    """(n, 3): directions through pixel coordinates (2, n), as far as the plane at distance 1, in float64."""
    slope = np.tan(camera.fov_y / 2)
    x = (2 * xy[0].astype(np.float64) / size[0] - 1) * slope * size[0] / size[1]
    y = (1 - 2 * xy[1].astype(np.float64) / size[1]) * slope
    return np.stack([x, y, -np.ones_like(x)], axis=1)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("camera", CAMERAS, ids=["at rest", "turned", "far", "wide"])
def test_projection_inverts_rays(functions, camera, size):
    """Rays through random places, corners and centres against float64; and the places again, from points at any distance."""
    rng = np.random.default_rng(8)
    n = 20_000
    xy = np.concatenate([rng.random((2, n)), rng.integers(0, 3, (2, 100)) / 2], axis=1) * np.array(size)[:, None]
    xy = xy.astype(np.float32)
    n = xy.shape[1]
    record = camera_record(camera, size)
    rays = functions.run("rays", n, {"xy": xy}, {"direction": ((3, n), np.float32)}, camera=record).T
    exact = in_view(camera, size, xy) @ camera.transform[:, :3].T
    slope = np.tan(camera.fov_y / 2) * np.array([size[0] / size[1], 1])
    assert np.abs(rays - exact).max() <= 6 * UNIT_ROUNDOFF * (1 + np.linalg.norm(slope))
    distance = (10.0 ** rng.uniform(-6, 6, n)).astype(np.float32)
    outputs = {"xy": ((2, n), np.float32), "in_front": ((n,), np.uint32)}
    back, in_front = functions.run(
        "projections", n, {"towards": (rays * distance[:, None]).T}, outputs, camera=record, near=0.0
    )
    assert in_front.all()
    # Of each component a few roundings of the direction's length, at depth 1; those of the depth count as much, at the edge.
    rounding = 4 * UNIT_ROUNDOFF * (1 + np.linalg.norm(exact, axis=1) * (1 + 1 / slope[:, None]))
    assert (np.abs(back - xy.astype(np.float64)) <= rounding * np.array(size)[:, None]).all()


def test_pixel_coordinates_begin_at_the_top_left(functions):
    """x to the right, y down; one unit is a pixel."""
    camera, size = view((0, 0, 0), (0, 0, -1), 90), (8, 4)
    towards = np.float32([[-2, 1, -1], [2, 1, -1], [-2, -1, -1], [0, 0, -5], [0.5, 0, -1], [0, -0.5, -1]])
    outputs = {"xy": ((2, 6), np.float32), "in_front": ((6,), np.uint32)}
    xy, _ = functions.run(
        "projections", 6, {"towards": towards.T}, outputs, camera=camera_record(camera, size), near=0.0
    )
    np.testing.assert_allclose(xy.T, [[0, 0], [8, 0], [0, 4], [4, 2], [5, 2], [4, 3]], atol=1e-5)


def test_what_is_not_before_the_near_plane_is_not_projected(functions):
    """Depth is along the axis of view: beside it, what is farther than `near` can lie before the plane."""
    near = np.float32(2.0)
    towards = np.float32([[0, 0, -3], [0, 0, -2], [0, 0, np.nextafter(np.float32(-2), np.float32(-3))], [5, 5, -1.9],
                          [0, 0, 3], [1, 0, 0], [0, 0, -0.001]])  # fmt: skip
    record = camera_record(view((0, 0, 0), (0, 0, -1), 90), (8, 8))
    outputs = {"xy": ((2, 7), np.float32), "in_front": ((7,), np.uint32)}
    for plane, expected in ((near, [1, 0, 1, 0, 0, 0, 0]), (np.float32(0), [1, 1, 1, 1, 0, 0, 1])):
        _, in_front = functions.run("projections", 7, {"towards": towards.T}, outputs, camera=record, near=plane)
        np.testing.assert_array_equal(in_front, expected)


@pytest.mark.parametrize("width", [1, 3, 640, 1920, 4096])
def test_place_of_every_pixel(device, functions, width):
    """All below 2^24; above, those of as many rows as float32 tells apart to within one, at random and about multiples of the
    width, below 2^30."""
    wrong = device.upload(np.zeros(1, np.uint32))
    rng = np.random.default_rng(9)
    most = min(2**30, max(width * 2**22, 2**25))
    near_rows = rng.integers(most // width, size=1 << 18)[:, None] * width + np.arange(-2, 3)
    above = np.concatenate([rng.integers(most, size=1 << 20), np.clip(near_rows.ravel(), 0, most - 1)]).astype(
        np.uint32
    )
    for first in range(0, 2**24, 2**23):
        scalars = {"wrong": wrong, "first": first, "width": width, "listed": 0}
        functions.run("misplaced", 2**23, {"pixels": np.zeros(2**23, np.uint32)}, **scalars)
    functions.run("misplaced", above.size, {"pixels": above}, wrong=wrong, first=0, width=width, listed=1)
    assert wrong.get()[0] == 0
