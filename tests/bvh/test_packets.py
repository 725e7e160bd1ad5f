"""Rays traced together: packets of sixteen in a row, and of those that are alike in chunks, find the same hits to the bit."""

from dataclasses import replace

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
    random_directions,
    soup,
    tunnel,
)
from render_helpers import lit, shape_mesh, view
from scipy.spatial.transform import Rotation

from clcache import drivers
from clcache.bvh import HIT_DTYPE, SceneTrees
from clcache.bvh.tracer import RayKernels
from clcache.device import Device
from clcache.resources import SceneResources
from clcache.scene.generators import plane
from clcache.scene.geometry import Geometry
from clcache.scene.model import Material, Texture, TextureUse

SIZES = [1, 2, 15, 16, 17, 31, 33, 4095, 4096, 4097, 8200]


def kernels(device, scene):
    return RayKernels(device, SceneTrees(device, Geometry.of(scene)))


def trace(device, rays, origins, directions, t_min=None, length=np.inf, coherent=False):
    """Closest hits and occlusion of rays given as (n, 3), by one of the two ways."""
    n = len(origins)
    up = [device.upload(np.ascontiguousarray(np.asarray(v, np.float32).T)) for v in (origins, directions)]
    up.append(None if t_min is None else device.upload(np.broadcast_to(np.float32(t_min), n)))
    up.append(device.upload(np.broadcast_to(np.float32(length), n)))
    shapes = ((n,), np.float32), ((2, n), np.float32), ((n,), np.uint32), ((n,), np.uint32)
    out = [device.upload(np.full(shape, 77, dtype)) for shape, dtype in shapes]
    occluded = device.upload(np.full(n, 77, np.uint8))
    rays.closest_hit(*up, *out, coherent=coherent)
    rays.any_hit(*up, occluded, coherent=coherent)
    hits = np.empty(n, HIT_DTYPE)
    hits["t"], (hits["u"], hits["v"]), hits["primitive"], hits["instance"] = (a.get() for a in out)
    return hits, occluded.get()


def assert_same(device, scene, *rays, **limits):
    """Both ways agree; returns the hits."""
    traced = kernels(device, scene)
    (hits, occluded), (others, also) = (trace(device, traced, *rays, **limits, coherent=c) for c in (False, True))
    assert hits.tobytes() == others.tobytes()
    np.testing.assert_array_equal(occluded, also)
    np.testing.assert_array_equal(occluded, hits["instance"] != MISS)
    return hits


def camera_rays(n, seed=0):
    """Alike: from one place, towards places near each other."""
    rng = np.random.default_rng(seed)
    across = np.linspace(-0.3, 0.3, n)
    directions = np.column_stack([across, 0.1 * rng.uniform(-1, 1, n), np.full(n, -1.0)])
    return np.tile([0.1, 0.2, 4.0], (n, 1)), directions


def scattered_rays(n, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.5, 1.5, (n, 3)), random_directions(n, rng)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("rays", [camera_rays, scattered_rays])
def test_both_ways_agree(device, n, rays):
    hits = assert_same(device, make_scene(soup(3000, 1, 0.1), blob(3)), *rays(n))
    assert n < 100 or 0.1 < (hits["instance"] != MISS).mean() <= 1


@pytest.mark.parametrize("make", [lambda: blob(3), lambda: tunnel(50), lambda: soup(500, 5, 0.3), cube])
def test_packets_equal_brute_force(device, make):
    mesh = make()
    scene = make_scene(mesh)
    rng = np.random.default_rng(2)
    origins = rng.uniform(-1, 1, (1600, 3)).astype(np.float32)
    origins[800:] = np.repeat(origins[800:850], 16, axis=0)  # packets with one origin
    directions = edge_targets(mesh, 1600, rng) - origins
    hits, _ = trace(device, kernels(device, scene), origins, directions, coherent=True)
    assert np.count_nonzero(hits["instance"] != MISS) > 400
    assert not WorldTriangles.of(scene).wrong(hits, origins, directions).any()


def test_directions_along_axes(device):
    """Zeros of either sign in the directions, in packets that mix them with others."""
    rng = np.random.default_rng(3)
    axes = np.array(
        [[1, 0, 0], [-1, 0, -0.0], [0, 1, 0], [-0.0, -1, 0], [0, 0, 1], [0, -0.0, -1], [1, 1, 0], [0, -1, 1]]
    )
    directions = axes[rng.integers(8, size=3000)].astype(np.float32)
    origins = rng.uniform(-0.9, 0.9, (3000, 3))
    origins[::2] = np.clip(0.25 * np.round(4 * origins[::2]), -0.75, 0.75)  # some in the planes of boxes
    hits = assert_same(device, make_scene(cube(), blob(2)), origins, directions)
    assert (hits["instance"] != MISS).all()


def test_instances(device):
    """Rotated, stretched and mirrored, beside meshes that are joined; rays of a packet hit different ones."""
    rng = np.random.default_rng(4)
    placed = [(k % 2, np.column_stack([Rotation.random(random_state=rng).as_matrix() @ np.diag(rng.uniform(-1, 1, 3)),
                                       rng.uniform(-3, 3, 3)])) for k in range(40)]  # fmt: skip
    placed += [(2, IDENTITY), (3, IDENTITY)]
    scene = make_scene(soup(20, 1, 0.3), cube(), blob(2), soup(50, 6, 0.3), instances=placed)
    origins, directions = scattered_rays(5000)
    hits = assert_same(device, scene, 2 * origins, directions)
    assert len(set(hits["instance"])) > 20
    near = camera_rays(5000)
    assert len(set(assert_same(device, scene, near[0] * 2, near[1])["instance"])) > 3


def test_equal_distances_in_instances(device):
    """Copies of one mesh at one place: the lowest instance wins in packets, too."""
    scene = make_scene(blob(2), instances=[(0, IDENTITY)] * 5)
    hits = assert_same(device, scene, *camera_rays(500))
    assert set(hits["instance"]) == {0, MISS}


def sieve():
    """Sheets whose texture has holes, at heights about the origin."""
    pixels = np.full((8, 8, 4), 255, np.uint8)
    pixels[..., 3] = np.random.default_rng(6).choice([0, 255], (8, 8))
    sheet = shape_mesh(plane((4.0, 4.0)), 0)
    sheet = replace(sheet, uvs=(sheet.positions[:, [0, 2]] * 3).astype(np.float32))
    full = Material("sieve", base_color_texture=TextureUse(0), alpha_cutoff=0.5)
    heights = [(0, IDENTITY + [[0, 0, 0, 0], [0, 0, 0, h], [0, 0, 0, 0]]) for h in (-1, -0.5, 0, 0.5, 1)]
    return lit(sheet, camera=view((0, 4, 0), (0, 0, 0), up=(0, 0, -1)), materials=(full,), instances=heights,
               textures=(Texture("holes", pixels, wrap=("repeat", "repeat")),), environment=(1, 1, 1))  # fmt: skip


@pytest.mark.parametrize("rays", [camera_rays, scattered_rays])
def test_holes(device, rays):
    scene = SceneResources(device, sieve())
    assert scene.features["HAS_ALPHA"]
    origins, directions = rays(3000)
    directions = directions[:, [0, 2, 1]]  # downwards
    origins = origins[:, [0, 2, 1]]
    (hits, occluded), (others, also) = (
        trace(device, scene.rays, origins, directions, coherent=c) for c in (False, True)
    )
    assert hits.tobytes() == others.tobytes()
    np.testing.assert_array_equal(occluded, also)
    np.testing.assert_array_equal(occluded, hits["instance"] != MISS)
    assert len(set(hits["instance"])) > 3


def test_limits_of_each_ray(device):
    """Own t_min and length for each; some are not to be traced at all."""
    rng = np.random.default_rng(5)
    n = 5000
    t_min, length = rng.uniform(0, 0.5, n), rng.uniform(0.2, 3, n)
    length[::7] = 0
    length[1::7] = np.inf
    hits = assert_same(device, make_scene(blob(3)), *scattered_rays(n), t_min=t_min, length=length)
    found = hits["instance"] != MISS
    idle = length <= t_min
    assert idle.sum() > 500
    assert not found[idle].any()
    assert 0.1 < found[~idle].mean() < 0.9
    assert ((hits["t"] > np.float32(t_min)) & (hits["t"] < np.float32(length)))[found].all()


def test_interval_is_open_for_rays_alone(device):
    """A hundred sheets one behind the other; the few rays end and begin exactly at sheets."""
    corners = np.array([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]])
    sheets = np.concatenate([corners + [0, 0, k] for k in range(1, 101)])
    rays = kernels(device, make_scene(make_mesh(sheets, np.arange(300))))
    begin, end = np.array([[0, 1], [1, 2], [1, 3], [7, 8], [7, 9], [41, 200]], np.float32).T
    origins, directions = np.tile([0.25, 0.5, 0], (6, 1)), np.tile([0, 0, 1], (6, 1))
    hits, occluded = trace(device, rays, origins, directions, begin, end)
    np.testing.assert_array_equal(hits["t"], [np.inf, np.inf, 2, np.inf, 8, 42])
    np.testing.assert_array_equal(occluded, [0, 0, 1, 0, 1, 1])


def test_results_do_not_depend_on_neighbours(device):
    """A ray's hit is the same bits whatever rays it is traced with."""
    rays = kernels(device, make_scene(soup(2000, 9, 0.2), blob(3)))
    origins, directions = scattered_rays(4500)
    hits = trace(device, rays, origins, directions)[0]
    for seed in range(3):
        shuffle = np.random.default_rng(seed).permutation(4500)
        for coherent in (False, True):
            again = trace(device, rays, origins[shuffle], directions[shuffle], coherent=coherent)[0]
            assert again.tobytes() == hits[shuffle].tobytes()


def test_drivers_agree_to_the_bit():
    """No kernel that decides what is hit is contracted: t, u, v, primitive and instance are the same on every CPU's driver."""
    specs = [str(c.index) for c in drivers.candidates() if "Oclgrind" not in c.platform and drivers.probe(c).usable]
    devices = [d for d in map(Device, specs) if d.is_cpu and d.capabilities.fp64]
    if len(devices) < 2:
        pytest.skip("needs a second OpenCL driver for the CPU")
    rng = np.random.default_rng(7)
    placed = [(0, IDENTITY), (1, np.column_stack([Rotation.random(random_state=rng).as_matrix() * 0.7, [0.3, 0, -1]]))]
    scene = make_scene(soup(3000, 1, 0.1), blob(4), instances=[*placed, (1, IDENTITY)])
    rays = [np.vstack(parts) for parts in zip(scattered_rays(20_000), camera_rays(20_000), strict=True)]
    results = [trace(d, kernels(d, scene), *rays, coherent=c) for d in devices for c in (False, True)]
    assert 0.3 < results[0][1].mean() < 0.9
    for hits, occluded in results[1:]:
        assert hits.tobytes() == results[0][0].tobytes()
        np.testing.assert_array_equal(occluded, results[0][1])
