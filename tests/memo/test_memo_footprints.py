"""What graphs are given at hits (`cl/scene/graph_inputs.cl`): texture coordinates, place and normal, and how they change over the ray
cone's footprint, against Eq. 2.13-2.16 of MaterialMemo in float64, and against neighbouring pixels."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import make_mesh, make_scene, random_directions
from memo_on_device import run_source
from memo_renders import painted
from render_helpers import view

from clcache.resources import SceneResources
from clcache.scene.transform import look_at

LEAST_COSINE = 1e-2
NAMES = ("uv", "uv_x", "uv_y", "position", "position_x", "position_y", "normal")
SOURCE = """
#include "scene/graph_inputs.cl"

void put(__global float *found, uint n, uint i, uint row, Vec3 v)
{
    found[row * n + i] = v.x;
    found[(row + 1) * n + i] = v.y;
    found[(row + 2) * n + i] = v.z;
}

__kernel void inputs(
    __global const float *positions,      // (vertices, 3)
    __global const uint *triangles,       // (triangles, 3)
    __global const float *normals,        // (vertices, 3) or null
    __global const float *uvs,            // (vertices, 2)
    __global const Instance *instances,   // (instances)
    __global const uint *material,        // (triangles)
    __global const Material *materials,   // (materials)
    __global const uint *instance,        // (n)
    __global const uint *primitive,       // (n)
    __global const float *hit,            // (3, n): u, v, t
    __global const float *direction,      // (3, n)
    __global const float *cone,           // (2, n)
    __global float *found,                // (18, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Maps maps = { 0, 0, 0, 0 };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    GraphHit at = graph_hit(&scene, instance[i], primitive[i], hit[i], hit[n + i], hit[2 * n + i], load_vec3(direction, n, i), cone[i],
                            cone[n + i]);
    Pair pairs[3] = { at.uv, at.uv_x, at.uv_y };
    for (uint k = 0; k < 3; k++) {
        found[2 * k * n + i] = pairs[k].u;
        found[(2 * k + 1) * n + i] = pairs[k].v;
    }
    put(found, n, i, 6, at.position);
    put(found, n, i, 9, at.position_x);
    put(found, n, i, 12, at.position_y);
    put(found, n, i, 15, at.normal);
}
"""


@dataclass(frozen=True)
class Hits:
    """instance, primitive: (n,). u, v, t: (n,). direction: (n, 3). width, spread: (n,) of the cones."""

    instance: np.ndarray
    primitive: np.ndarray
    u: np.ndarray
    v: np.ndarray
    t: np.ndarray
    direction: np.ndarray
    width: np.ndarray
    spread: np.ndarray


def on_device(device, scene, hits):
    """What graphs are given, by name, (n, d)."""
    resources = SceneResources(device, scene)
    n = len(hits.t)
    columns = {
        "instance": np.uint32(hits.instance), "primitive": np.uint32(hits.primitive), "hit": np.stack([hits.u, hits.v, hits.t]),
        "direction": hits.direction.T, "cone": np.stack([hits.width, hits.spread]),
    }  # fmt: skip
    arrays = {
        name: device.upload(np.ascontiguousarray(values, values.dtype if values.dtype == np.uint32 else np.float32))
        for name, values in columns.items()
    }
    arrays["found"] = device.empty((18, n), np.float32)
    run_source(device, SOURCE, **resources.defines)["inputs"].run(n, arrays, resources.arrays, n=n)
    found = arrays["found"].get().astype(float)
    rows = np.cumsum([0, 2, 2, 2, 3, 3, 3, 3])
    return {name: found[a:b].T for name, a, b in zip(NAMES, rows[:-1], rows[1:], strict=True)}


def dots(a, b):
    return (a * b).sum(axis=-1, keepdims=True)


def on_plane(v, n):
    """ProjectOnPlane of section 2.2."""
    return v - dots(v, n) * n


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def by_equations(scene, hits):
    """The same in float64: the footprint's vertices P1 and P2, and what the triangle's plane makes of them."""
    corners, uvs, to_world = [], [], []
    for instance, primitive in zip(hits.instance, hits.primitive, strict=True):
        mesh = scene.meshes[scene.instances[instance].mesh]
        corners.append(mesh.positions[mesh.triangles[primitive]].astype(float))
        uvs.append(mesh.uvs[mesh.triangles[primitive]].astype(float))
        to_world.append(scene.instances[instance].transform[:, :3])
    corners, uvs, to_world = (np.array(a) for a in (corners, uvs, to_world))
    edges = corners[:, 1:] - corners[:, :1]
    world = np.einsum("nij,nkj->nki", to_world, edges)
    normal = unit(np.cross(world[:, 0], world[:, 1]))
    d, radius = hits.direction, np.abs(hits.width + hits.spread * hits.t)[:, None]
    h1 = on_plane(d, normal)
    h2 = np.cross(normal, h1)
    tips = [h * radius / np.linalg.norm(on_plane(h, d), axis=1, keepdims=True) for h in (h1, h2)]  # P1 - P, P2 - P
    weights = [
        np.linalg.lstsq(np.swapaxes(world, 1, 2)[k], tip[k], rcond=None)[0] for tip in tips for k in range(len(d))
    ]
    x, y = np.array(weights).reshape(2, len(d), 2)
    uv_edges, here = uvs[:, 1:] - uvs[:, :1], np.column_stack([hits.u, hits.v])

    def along(weight, edge):
        return np.einsum("nk,nkj->nj", weight, edge)

    return {
        "uv": uvs[:, 0] + along(here, uv_edges), "uv_x": along(x, uv_edges), "uv_y": along(y, uv_edges),
        "position": corners[:, 0] + along(here, edges), "position_x": along(x, edges), "position_y": along(y, edges),
        "normal": unit(np.cross(edges[:, 0], edges[:, 1])),
    }, np.abs(dots(d, normal))[:, 0]  # fmt: skip


def soup_scene(scale, rng):
    """Triangles of no bad shape, each corner with a coordinate of its own, placed as they are, and turned, stretched and mirrored."""
    rough = rng.normal(size=(60, 3, 3))
    base = np.array([[0, 0, 0], [1, 0, 0], [0.2, 0.9, 0]])
    turns = np.linalg.qr(rng.normal(size=(60, 3, 3)))[0]
    corners = (base + 0.1 * rough) @ turns + 3 * rng.normal(size=(60, 1, 3))
    mesh = make_mesh(scale * corners.reshape(-1, 3), np.arange(180))
    mesh = replace(mesh, uvs=rng.uniform(-4, 4, (180, 2)).astype(np.float32))
    stretched = np.column_stack([[[1.0, 0.2, 0], [0, -2.0, 0.1], [0.3, 0, 0.5]], [5, 6, 7]])
    scene = make_scene(mesh, instances=[(0, np.eye(4)[:3]), (0, stretched)])
    return replace(scene, materials=(painted("stripes"),))


def random_hits(rng, n, scale):
    """Such as no cosine is near 0 or 1."""
    a, b = rng.random((2, n))
    u, v = np.where(a + b > 1, [1 - a, 1 - b], [a, b])
    return Hits(
        rng.integers(2, size=n), rng.integers(60, size=n), u, v, scale * rng.uniform(0.5, 30, n), random_directions(n, rng).astype(float),
        scale * rng.uniform(0, 0.01, n), rng.uniform(0, 0.01, n),
    )  # fmt: skip


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_derivatives_are_those_of_the_thesis(device, scale):
    """Of coordinates and places, at scales from micrometres to a thousand kilometres."""
    rng = np.random.default_rng(3)
    scene, hits = soup_scene(scale, rng), random_hits(rng, 3000, scale)
    found, (expected, cosine) = on_device(device, scene, hits), by_equations(scene, hits)
    usual = (cosine > 0.05) & (cosine < 0.999)
    assert usual.mean() > 0.9
    for name, values in expected.items():
        size = np.linalg.norm(values, axis=1)
        away = np.linalg.norm(found[name] - values, axis=1)
        assert (away[usual] <= 2e-4 * size[usual] + 1e-6 * np.median(size)).all(), name


def test_what_a_cone_is_wide_counts_as_its_width_and_what_it_spread(device):
    """width + spread t, whatever its sign: the ratio of any two footprints is that of the widths."""
    rng = np.random.default_rng(5)
    scene, hits = soup_scene(1.0, rng), random_hits(rng, 500, 1.0)
    base = on_device(device, scene, replace(hits, width=np.ones(500), spread=np.zeros(500)))
    for width, spread in ((0.5, 0.0), (0.0, 0.25), (1.0, -0.5), (0.0, 0.0)):
        found = on_device(device, scene, replace(hits, width=np.full(500, width), spread=np.full(500, spread)))
        wide = np.abs(width + spread * hits.t)[:, None]
        for name in ("uv_x", "uv_y", "position_x", "position_y"):
            np.testing.assert_allclose(
                found[name], wide * base[name], rtol=1e-4, atol=1e-4 * np.abs(base[name]).max() * wide.max()
            )


def floor_scene(per_metre=3.0, **options):
    corners = np.array([[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50]])
    mesh = make_mesh(corners, [[0, 2, 1], [0, 3, 2]])
    mesh = replace(mesh, uvs=(per_metre * corners[:, [0, 2]]).astype(np.float32))
    return replace(make_scene(mesh), materials=(painted("waves"),), **options)


def hits_on_floor(origin, directions, spread):
    """Of unit directions that go down."""
    t = -origin[1] / directions[:, 1]
    place = origin + t[:, None] * directions
    x, z = (place[:, [0, 2]] + 50).T / 100
    first = x <= z  # triangles: corners 0, 3, 2 above the diagonal, else 0, 2, 1
    n = len(t)
    u, v = np.where(first, z - x, z), np.where(first, x, x - z)
    return Hits(np.zeros(n), first.astype(int), u, v, t, directions, np.zeros(n), np.full(n, spread)), place


@pytest.mark.parametrize("elevation", [10, 30, 60, 85])
def test_derivatives_are_the_differences_of_neighbouring_pixels(device, elevation):
    """In the middle of the image, where the cone is as wide as pixels are apart: the two axes of the footprint are the columns' and rows'
    differences."""
    per_metre, distance, size, fov = 3.0, 7.0, (640, 360), np.radians(40)
    angle = np.radians(elevation)
    eye = distance * np.array([0.0, np.sin(angle), np.cos(angle)])
    camera = replace(view(eye, (0, 0, 0)), transform=look_at(eye, (0, 0, 0), (0, 1, 0)))
    slope = np.tan(fov / 2)
    pixel = 2 * slope / size[1]
    offsets = np.array([[0, 0], [0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]) * pixel
    directions = unit(np.column_stack([offsets, -np.ones(5)]) @ camera.transform[:, :3].T)
    hits, place = hits_on_floor(eye, directions, pixel)
    found = on_device(device, floor_scene(per_metre), hits)
    np.testing.assert_allclose(found["uv"], per_metre * place[:, [0, 2]], atol=2e-5)
    column, row = found["uv"][1] - found["uv"][2], found["uv"][3] - found["uv"][4]
    expected = per_metre * (place[1] - place[2])[[0, 2]], per_metre * (place[3] - place[4])[[0, 2]]
    np.testing.assert_allclose([column, row], expected, atol=5e-5)
    for ours, theirs in zip((found["uv_y"][0], found["uv_x"][0]), expected, strict=True):
        assert np.linalg.norm(ours) == pytest.approx(np.linalg.norm(theirs), rel=5e-3)
        assert abs(ours @ theirs) == pytest.approx(np.linalg.norm(ours) * np.linalg.norm(theirs), rel=1e-5)


def test_head_on_the_footprint_is_a_circle(device):
    """Whatever its axes are there, they are as long as the cone is wide, and at right angles."""
    directions = np.tile([0.0, -1.0, 0.0], (4, 1))
    hits, _ = hits_on_floor(np.array([0.3, 5.0, 0.2]), directions, 0.01)
    found = on_device(device, floor_scene(2.0), hits)
    for name, wide in (("uv", 0.1), ("position", 0.05)):
        x, y = found[f"{name}_x"][0], found[f"{name}_y"][0]
        assert np.linalg.norm([x, y], axis=1) == pytest.approx([wide, wide], rel=1e-5)
        assert x @ y == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("angle", [1e-2, 1e-3, 1e-8, 0.0])
def test_at_grazing_angles_the_footprint_has_an_end(device, angle):
    directions = unit(np.array([[1.0, -angle, 0.0], [-1.0, angle, 0.0]]))
    hits = Hits(*np.zeros((2, 2), int), *np.full((2, 2), 0.25), np.ones(2), directions, np.full(2, 0.01), np.zeros(2))
    found = on_device(device, floor_scene(2.0), hits)
    assert np.linalg.norm(found["uv_x"], axis=1) == pytest.approx(0.02 / max(angle, LEAST_COSINE), rel=1e-3)
    assert np.linalg.norm(found["uv_y"], axis=1) == pytest.approx(0.02, rel=1e-3)


def test_triangles_without_area_have_no_derivatives(device):
    """Neither in space nor in texture coordinates; and nothing is infinite."""
    corners = np.array(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 0], [1e-3, 0, 0], [1e3, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]]
    )
    mesh = make_mesh(corners, np.arange(9))
    mesh = replace(mesh, uvs=np.float32([[0, 0], [1, 0], [0, 1]] * 2 + [[0.5, 0.5]] * 3))
    scene = replace(make_scene(mesh), materials=(painted("waves"),))
    n = 3
    directions = np.tile(unit(np.array([0.1, 0.2, -1.0])), (n, 1))
    hits = Hits(
        np.zeros(n), np.arange(3), *np.full((2, n), 0.25), np.ones(n), directions, np.full(n, 0.01), np.full(n, 0.01)
    )
    found = on_device(device, scene, hits)
    assert all(np.isfinite(values).all() for values in found.values())
    for name in ("uv_x", "uv_y"):
        assert not found[name].any()
    for name in ("position_x", "position_y"):
        assert not found[name][:2].any() and found[name][2].any()


def test_smooth_normals_are_given_where_there_are_any(device):
    rng = np.random.default_rng(7)
    scene, hits = soup_scene(1.0, rng), random_hits(rng, 400, 1.0)
    flat = on_device(device, scene, hits)["normal"]
    mesh = scene.meshes[0]
    normals = random_directions(len(mesh.positions), rng)
    normals[: 30 * 3 : 3] = 0  # a corner without one: the triangle is flat
    smooth = replace(scene, meshes=(replace(mesh, normals=normals),))
    found = on_device(device, smooth, hits)["normal"]
    corner = normals.astype(float)[mesh.triangles[hits.primitive]]
    weights = np.column_stack([1 - hits.u - hits.v, hits.u, hits.v])
    blend = np.einsum("nk,nkj->nj", weights, corner)
    is_smooth = (hits.primitive >= 30) & (np.linalg.norm(blend, axis=1) > 0.05)
    np.testing.assert_allclose(found[is_smooth], unit(blend[is_smooth]), atol=1e-4)
    np.testing.assert_array_equal(found[hits.primitive < 30], flat[hits.primitive < 30])
