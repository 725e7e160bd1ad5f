"""Stereo filtering by the renderer: of path-traced images of both eyes, against references, and how it finds first hits."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from render_helpers import everything

import clcache
from clcache import Renderer, Tracer, load_scene
from clcache.bvh.tracer import MISS
from clcache.frame import FrameGraph
from clcache.methods import PathState
from clcache.metrics import View, reprojected_difference, rmse, summarize
from clcache.passes.stereo import stereo
from clcache.renderer import Frame, camera_record
from clcache.resources import SceneResources
from clcache.settings import resolve

EYES = ("left", "right")
KINDS = ("constant", "varianceblend")
SPHERES = Path(clcache.__file__).parents[1] / "data" / "spheres" / "scene.toml"


def render(scene, kind: str, size=(48, 27), spp: int = 4, seed: int = 1, frame: int = 15, **options) -> Frame:
    settings = options.pop("settings", {})
    renderer = Renderer(
        scene, "pathtrace", size, stereo=True, seed=seed, spp=spp, stereo_blend=kind, settings=settings, **options
    )
    return next(renderer.frames(frame, frame + 1))


def at_distance(scene, metres: float):
    """The scene with its eyes so far apart."""
    return replace(scene, defaults=replace(scene.defaults, eye_distance=metres))


@pytest.fixture(scope="module")
def spheres():
    return load_scene(SPHERES)


def test_spheres_come_closer_to_the_reference_and_the_eyes_to_each_other(device_spec, spheres):
    """A Cornell box with spheres of metal and glass, of which the eyes see different reflections. The constant weight halves the
    variance and so lowers RMSE to 0.71 of itself but for the bias, X being interpolated, which lowers it further, and the
    noise of the reference, which lowers none; the thresholds are half way from there to no effect at all. What is left
    of the eyes' difference is what the own half of each has alone."""
    options = {"device": device_spec, "aovs": ("Z",)}
    reference = render(spheres, "none", spp=64, seed=1000, **options)
    errors, differences = {}, {}
    for kind in ("none", *KINDS):
        frames = [render(spheres, kind, seed=seed, **options) for seed in (1, 2)]
        found = [{"rmse": rmse(frame.color[eye], reference.color[eye])} for frame in frames for eye in EYES]
        errors[kind] = summarize(["rmse"], found)["rmse"]
        views = [[View(frame.color[eye], frame.aov("Z", eye), frame.cameras[eye]) for eye in EYES] for frame in frames]
        differences[kind] = np.mean([reprojected_difference(*pair).mean for pair in views])
    assert errors["constant"] < 0.85 * errors["none"]
    assert errors["varianceblend"] < 0.85 * errors["none"]
    assert differences["constant"] < 0.25 * differences["none"]
    assert differences["varianceblend"] < 0.5 * differences["none"]


def test_eyes_at_one_place_see_each_other_as_they_are(device_spec, spheres):
    """With beta = 0 each eye has the other's pixels, but for rounding of their difference, and for edges at which their samples met
    other surfaces, and for outermost pixels of slanted ones, whose slope is not known there."""
    options = {"spp": 1, "device": device_spec, "aovs": ("beta",)}
    taken, own = (
        render(at_distance(spheres, 0.0), "constant", settings={"stereo.beta": beta}, **options) for beta in (0.0, 1.0)
    )
    for eye, other in (EYES, EYES[::-1]):
        seen = taken.aov("beta", eye) == 0
        assert seen.mean() > 0.85
        assert not np.array_equal(own.color[eye][seen], own.color[other][seen])
        np.testing.assert_allclose(taken.color[eye][seen], own.color[other][seen], rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(1, 1), (3, 5)])
@pytest.mark.parametrize("eye_distance", [0.063, 10.0])
def test_small_images_and_eyes_far_apart(device_spec, spheres, kind, size, eye_distance):
    scene = at_distance(spheres, eye_distance)
    frame = render(scene, kind, size, spp=1, aovs=("beta",), device=device_spec)
    own = render(scene, "constant", size, spp=1, settings={"stereo.beta": 1.0}, device=device_spec)
    for eye in EYES:
        beta = frame.aov("beta", eye)
        assert np.isfinite(frame.color[eye]).all()
        assert np.all((beta >= 0) & (beta <= 1))
        np.testing.assert_array_equal(frame.color[eye][beta == 1], own.color[eye][beta == 1])


def test_both_eyes_are_blended_with_the_other_one(device_spec, spheres):
    """What is found of both eyes with the first serves the second. With beta = 0 an image is the other eye's, reprojected: from
    the same row of it; it is its own where the other does not see the point, and everywhere with beta = 1."""
    frames = [render(spheres, "constant", spp=1, settings={"stereo.beta": beta}, device=device_spec, aovs=("beta",))
              for beta in (0.0, 1.0)]  # fmt: skip
    for eye, other in (EYES, EYES[::-1]):
        seen = frames[0].aov("beta", eye) == 0
        assert 0.8 < seen.mean() < 1
        own, taken = frames[1].color[eye], frames[0].color[eye]
        np.testing.assert_array_equal(taken[~seen], own[~seen])
        theirs = frames[1].color[other]
        low, high = theirs.min(axis=1, keepdims=True), theirs.max(axis=1, keepdims=True)
        among = (taken >= low - 1e-5) & (taken <= high * (1 + 1e-5) + 1e-5)
        assert np.all(among[seen])  # from the same row of the other eye's image
        assert not np.array_equal(taken[seen], own[seen])


def test_first_hits_are_found_where_rays_meet_them(device):
    """Reciprocal depths of turned, stretched and mirrored instances, and of the sky, for both eyes at once."""
    scene, size = everything(), (40, 30)
    width, height = size
    tracer, resources = Tracer(scene, device), SceneResources(device, scene)
    surfaces, cameras, expected = [], [], []
    for aside in (-0.05, 0.05):
        transform = scene.camera.transform.copy()
        transform[:, 3] += aside * transform[:, 0]
        camera = replace(scene.camera, transform=transform)
        across = ((np.arange(width) + 0.5) / width * 2 - 1) * math.tan(camera.fov_y / 2) * width / height
        up = (1 - (np.arange(height)[:, None] + 0.5) / height * 2) * math.tan(camera.fov_y / 2)
        local = np.stack(np.broadcast_arrays(across, up, -1.0), axis=-1).reshape(-1, 3)
        hits = tracer.closest_hit(np.broadcast_to(transform[:, 3], local.shape), local @ transform[:, :3].T)
        fixed = np.rint(np.stack([hits["u"], hits["v"]], axis=1).clip(0, 1) * 0xFFFFFF).astype(np.uint32)
        surfaces.append(np.column_stack([fixed, hits["primitive"], hits["instance"]]).astype(np.uint32))
        expected.append(np.where(hits["instance"] == MISS, 0.0, 1 / hits["t"]))  # the ray's length is its depth
        cameras.append(camera_record(camera, size))
    assert (expected[0] == 0).any() and (expected[0] > 0).any()
    colors = np.ones((width * height, 3), np.float32)
    inputs = {"surface": surfaces[0], "other_surface": surfaces[1], "color": colors, "other_color": colors}
    found = stereo(device, resources, size, resolve({}, {}), "constant")
    given = {name: device.upload(values) for name, values in inputs.items()}
    graph = FrameGraph(device, found.passes, found.buffers, {found.output}, given)
    graph.run(PathState(cameras[0], (0, 0), 1, eye=0, other=cameras[1]))
    np.testing.assert_allclose(graph.of()["near"].get(), expected, rtol=1e-4)
