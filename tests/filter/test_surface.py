"""`surface`: of each pixel the first hit of the nearest sample, against the depth that the method finds by itself."""

import sys
import types
from dataclasses import replace

import numpy as np
import pytest
from cache_renders import one_device, yard
from fake_method import Step
from render_helpers import everything, view

from clcache import Renderer
from clcache.frame import Buffer
from clcache.methods import METHODS
from clcache.passes.filter import Filter
from clcache.scene.geometry import Geometry

SIZE = (13, 10)
NONE = 0xFFFFFFFF


@pytest.fixture(scope="module", autouse=True)
def device():
    with one_device():
        yield


@pytest.fixture
def surfaces(monkeypatch):
    """What a temporal filter sees of `surface`, one (H, W, 4) for each frame and eye."""
    seen = []

    def temporal(device, scene, size, settings, kind):
        n = size[0] * size[1]
        look = Step("look", ("color", "surface"), ("filtered",), lambda arrays, _: seen.append(arrays["surface"].get()))
        return Filter((look,), (Buffer("filtered", (n, 3), per_eye=True),), "filtered")

    monkeypatch.setitem(sys.modules, "clcache.passes.temporal", types.SimpleNamespace(temporal=temporal))
    return seen


def frames(scene, method, count=1, **options):
    few = {"pathtrace.bounces": 0, "octree.resolution": 64}
    options = {"size": SIZE, "settings": few, "temporal": "taa", "aovs": ("Z",)} | options
    return list(Renderer(scene, method, **options).frames(0, count))


def points_of(scene, surface, seconds):
    """(n, 3) float64: where first hits lie, by the scene's own transforms."""
    geometry = Geometry.of(scene).at(scene, seconds)
    instance, primitive = surface[:, 3], surface[:, 2]
    first = geometry.first_triangle[geometry.instance_mesh[instance]]
    corners = geometry.positions[geometry.triangles[first + primitive]].astype(np.float64)
    u, v = (surface[:, :2] & 0xFFFFFF)[:, :, None].transpose(1, 0, 2) / (2**24 - 1)
    local = corners[:, 0] + u * (corners[:, 1] - corners[:, 0]) + v * (corners[:, 2] - corners[:, 0])
    to_world = geometry.to_world[instance]
    return np.einsum("nij,nj->ni", to_world[:, :, :3], local) + to_world[:, :, 3]


def directions_of(surface):
    """(n, 3): octahedral, of unit length."""
    x, y = 2 * (surface[:, :2] & 0xFFFFFF).astype(np.float64).T / (2**24 - 1) - 1
    z = 1 - np.abs(x) - np.abs(y)
    x, y = (np.where(z < 0, (1 - np.abs(b)) * np.sign(a), a) for a, b in ((x, y), (y, x)))
    towards = np.column_stack([x, y, z])
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def places(camera, towards):
    """(n, 2): where in the image, in pixels, what lies at `towards` from the eye appears."""
    local = towards @ camera.transform[:, :3]
    slope = np.tan(camera.fov_y / 2)
    x = local[:, 0] / -local[:, 2] / (slope * SIZE[0] / SIZE[1])
    y = local[:, 1] / -local[:, 2] / slope
    return np.column_stack([(0.5 + 0.5 * x) * SIZE[0], (0.5 - 0.5 * y) * SIZE[1]])


@pytest.mark.parametrize("method", METHODS)
def test_it_is_the_nearest_sample_of_its_own_pixel(surfaces, method):
    """In each frame and eye of a moving scene: at the depth of Z, within the pixel, its material known; and background
    exactly where Z has no depth."""
    scene = yard(4)
    spp = 5 if method == "pathtrace" else 2
    rendered = frames(scene, method, 4, stereo=True, spp=spp)
    pixel = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), axis=-1).reshape(-1, 2)
    views = [(frame, eye) for frame in rendered for eye in frame.color]
    assert len(surfaces) == len(views)
    for (frame, eye), surface in zip(views, surfaces, strict=True):
        depth, camera = frame.aov("Z", eye).ravel(), frame.cameras[eye]
        is_far = surface[:, 3] == NONE
        np.testing.assert_array_equal(is_far, np.isinf(depth))
        assert 5 < is_far.sum() < 100
        towards = points_of(scene, surface[~is_far], float(frame.number)) - camera.transform[:, 3]
        np.testing.assert_allclose(towards @ -camera.transform[:, 2], depth[~is_far], rtol=1e-5)
        found = np.empty((len(surface), 2))
        found[~is_far], found[is_far] = places(camera, towards), places(camera, directions_of(surface[is_far]))
        assert (np.abs(found - pixel - 0.5) <= 0.5 + 1e-3).all()
        material = surface[~is_far, 0] >> 24 | surface[~is_far, 1] >> 24 << 8
        np.testing.assert_array_equal(material, np.array([0, 1, 2])[surface[~is_far, 3]])


def test_of_many_samples_the_nearest_is_kept_and_not_the_last(surfaces):
    """More samples bring it nearer, where a pixel shows a slanted surface."""
    scene = everything()
    few, many = (frames(scene, "pathtrace", spp=spp)[0].aov("Z", "mono").ravel() for spp in (1, 64))
    seen = surfaces[1][:, 3] != NONE
    depth = (points_of(scene, surfaces[1][seen], 0.0) - scene.camera.transform[:, 3]) @ -scene.camera.transform[:, 2]
    np.testing.assert_allclose(depth, many[seen], rtol=1e-5)
    assert (many < few)[seen].mean() > 0.8


@pytest.mark.parametrize("method", METHODS)
def test_background_all_over(surfaces, method):
    """Past everything: each pixel has a direction through itself, though no ray hit anything."""
    camera = view((0, 50, 0), (0, 100, 1))
    frames(replace(yard(4), camera=camera), method, spp=1)
    assert (surfaces[0][:, 2:] == NONE).all()
    found = places(camera, directions_of(surfaces[0]))
    pixel = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), axis=-1).reshape(-1, 2)
    assert (np.abs(found - pixel - 0.5) <= 0.5 + 1e-3).all()


@pytest.mark.parametrize("method", METHODS)
def test_nobody_pays_for_it_who_does_not_want_it(surfaces, method):
    passes = frames(yard(4), method, temporal="none")[0].stats["eyes"]["mono"]["passes"]
    assert not {"surface", "distance"} & passes.keys()
