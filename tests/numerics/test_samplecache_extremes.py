"""The sample cache at the ends of its ranges. What is seen is chosen so that its colour is known: surfaces that all samples show
as equally bright, so that whatever is wrong with a sample shows in its pixel.

Two lights do that: a white sky about convex things, of which each is as bright as its albedo is, and a sun in the zenith, of
pi W / m^2, over level ground.
"""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import along, at, counters, held, one_device, yard
from cache_renders import cached as with_any_bounces
from helpers import IDENTITY
from render_helpers import WHITE, ball, floor, grey, image, lit, view

from clcache.metrics import relmse
from clcache.scene.model import DirectionalLight, Track

ALL = ("albedo", "N", "Z", "variance", "samples", "occupancy", "visible", "age", "trace")
SUN = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
ABOVE = view((0, 3, 0.1), (0, 0, 0))
FRONT = view((0, 0, 3), (0, 0, 0))
METHODS = ("samplecache", "isrt")


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def cached(*arguments, **options):
    """With direct light only, which is all that there is here."""
    return with_any_bounces(*arguments, bounces=0, **options)


def white_sky(albedo=1.0, camera=FRONT, **options):
    """A ball of this albedo before a white sky."""
    return lit(ball(1, 3), camera=camera, materials=[grey(albedo)], environment=WHITE, **options)


def level(*meshes, camera=ABOVE, albedos=(1.0,), **options):
    """Level ground under the sun, each as bright as its albedo is; the sky is black."""
    materials = [grey(a) for a in albedos]
    return lit(*(meshes or (floor(1000),)), camera=camera, materials=materials, lights=[SUN], **options)


def colors(renderer, count=4):
    """The images of so many frames, each checked for what holds of all: every pixel shows something, and nothing is not finite."""
    images = []
    for frame in renderer.frames(0, count):
        for eye, color in frame.color.items():
            assert np.isfinite(color).all() and color.min() >= 0
            after = held(renderer, eye)
            assert (after.visible.any(axis=0)).all()
            assert np.isfinite(after.radiance[after.occupied]).all()
        images.append(next(iter(frame.color.values())))
    return images


# Sizes and views


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (5, 3), (1, 97), (65, 1), (13, 11)])
def test_image_sizes(method, size):
    """All white; within as many frames as a pixel is to have samples, it has them."""
    renderer = cached(white_sky(), method, size, aovs=ALL)
    *_, last = renderer.frames(0, 6)
    np.testing.assert_allclose(last.color["mono"], np.ones((*size[::-1], 3)), atol=1e-5)
    assert 3 <= last.aov("occupancy", "mono").mean() <= 5
    assert np.isfinite(last.aov("N", "mono")).all() and not np.isnan(last.aov("Z", "mono")).any()
    assert counters(last)["occupied"] == counters(last)["visible"] == last.aov("visible", "mono").sum()


@pytest.mark.parametrize("degrees", [0.01, 1, 120, 179])
def test_fields_of_view(degrees):
    cameras = [view((0, 3, 0.1 + 0.01 * k), (0, 0, 0), degrees) for k in range(4)]
    camera = cached(along(level(floor(1e4)), cameras), aovs=("albedo",))
    for frame in camera.frames(0, 4):
        color, albedo = frame.color["mono"], frame.aov("albedo", "mono")
        assert color.min() >= 0 and (albedo == 1).any()
        np.testing.assert_allclose(color[albedo == 1], 1, atol=1e-5)
        assert (color[albedo == 0] == 0).all()


def test_looking_straight_down():
    """Along the axis that is up everywhere else, and turning about it."""
    cameras = [view((0, 3, 0), (0, 0, 0), up=(np.sin(a), 0, np.cos(a))) for a in (0, 1, 2, 3)]
    for color in colors(cached(along(level(), cameras))):
        np.testing.assert_allclose(color, 1, atol=1e-5)


def test_nothing_but_background():
    """Nothing is shaded, and the sky's colour is exact while the camera turns."""
    away = [view((0, 0, 3), (0.2 * k, 0.1, 6)) for k in range(5)]
    scene = lit(ball(1, 3), camera=FRONT, environment=(0.5, 1.0, 2.0))
    for frame in cached(along(scene, away), aovs=ALL, stereo=True, stereo_blend="samples").frames(0, 5):
        for eye in ("left", "right"):
            np.testing.assert_allclose(frame.color[eye], np.broadcast_to([0.5, 1, 2], (16, 16, 3)), rtol=1e-6)
            assert counters(frame, eye)["shaded"] == frame.stats["eyes"][eye]["rays"]["secondary"] == 0
            assert np.isinf(frame.aov("Z", eye)).all()
            assert (frame.aov("samples", eye) == 0).all()
            assert not any(frame.aov(name, eye).any() for name in ("albedo", "N"))


def test_camera_cut():
    """From ground of one albedo to that of another, far away: nothing of the first is left, and nothing is dark."""
    scene = level(floor(20), floor(20, 1), albedos=(0.5, 0.25), instances=[(0, IDENTITY), (1, at((500, 20, 0)))])
    cameras = [ABOVE] * 5 + [view((500, 23, 0.1), (500, 20, 0))] * 2 + [ABOVE]
    for frame, expected in zip(cached(along(scene, cameras)).frames(0, 8), [0.5] * 5 + [0.25] * 2 + [0.5], strict=True):
        np.testing.assert_allclose(frame.color["mono"], expected, atol=1e-5)
        if frame.number in (5, 7):
            now = counters(frame)
            assert now["occupied"] == now["created"] == 256 and now["dropped"] > 256 and now["retraced"] == 0


@pytest.mark.parametrize("method", METHODS)
def test_a_half_turn_and_back(method):
    """Ground of one albedo before the camera, of another one behind it. In the turn's first frame all is dropped."""
    halves = floor(1000), floor(1000, 1)
    scene = level(*halves, albedos=(0.5, 0.25), instances=[(0, at((0, 0, -500))), (1, at((0, 0, 500)))])
    ahead, behind = view((0, 2, 0), (0, 0, -2), 30), view((0, 2, 0), (0, 0, 2), 30)
    sequence = [ahead] * 4 + [behind] * 3 + [ahead] * 3
    for frame in cached(along(scene, sequence), method).frames(0, len(sequence)):
        np.testing.assert_allclose(frame.color["mono"], 0.5 if sequence[frame.number] is ahead else 0.25, atol=1e-5)
        assert (counters(frame)["dropped"] > 0) == (frame.number in (4, 7))


def test_grazing_view():
    """A millimetre above a wide plane, on the way along it. Below the horizon all is white, and as dense as elsewhere."""
    cameras = [view((0, 1e-3, -1e-4 * k), (0, 1e-3, -10), 20) for k in range(8)]
    renderer = cached(along(level(floor(1000)), cameras), size=(32, 32), aovs=("occupancy",))
    *_, last = colors(renderer, 8)
    np.testing.assert_allclose(last[17:], 1, atol=1e-5)
    assert (last[:15] == 0).all()
    below = held(renderer).occupied.sum(axis=0).reshape(32, 32)[17:]
    assert 2 < below.mean() < 6


def test_near_plane():
    """On the way into the ball, what comes nearer than the near plane goes, and its far side is seen, from within."""
    near, cameras = 2.5, [view((0, 0, z), (0, 0, 0), 30, near=2.5) for z in (4.5, 4.0, 3.5, 3.2, 3.0, 2.8)]
    depths = []
    for frame in cached(along(white_sky(), cameras), aovs=("Z",)).frames(0, 6):
        depth = frame.aov("Z", "mono")
        assert depth.min() >= near - 1e-5
        depths.append(depth[8, 8])
    assert depths[0] == pytest.approx(3.5, abs=0.02)
    assert depths[-1] == pytest.approx(3.8, abs=0.02)


# Scenes


@pytest.mark.parametrize("offset", [1e4, 1e6])
def test_far_from_the_origin(offset):
    """Ten thousand kilometres out, float32 has steps of a millimetre at best: samples are still seen, and not shadowed by their own surface."""
    size = 2e-3 * offset
    place = np.array([offset, 0, -offset])
    scene = level(floor(1.0), instances=[(0, at(place, 100 * size))])
    cameras = [view(place + [0.01 * size * k, size, 0.1 * size], place + [0.01 * size * k, 0, 0]) for k in range(5)]
    renderer = cached(along(scene, cameras))
    for color in colors(renderer, 5):
        np.testing.assert_allclose(color, 1, atol=1e-5)
    after = held(renderer)
    assert after.visible.sum() > 0.95 * after.occupied.sum()


@pytest.mark.parametrize("method", METHODS)
def test_everything_falls_into_few_pixels(method):
    """The camera backs away so fast that all there is crowds into a few pixels: they fill up, the rest is counted as lost, and what
    is left is as bright as ever."""
    cameras = [view((0, 0, z), (0, 0, 0), 40) for z in (3.5, 3.5, 3.5, 3.5, 60, 300)]
    renderer, before = cached(along(white_sky(0.5), cameras), method, (24, 24), aovs=("occupancy", "albedo")), 0
    for frame in renderer.frames(0, 6):
        now = counters(frame)
        assert (
            now["occupied"]
            == before - now["dropped"] - now["overflow"] - now["stolen"] + now["created"] - now["purged"]
        )
        before = now["occupied"]
        albedo, color = frame.aov("albedo", "mono"), frame.color["mono"]
        assert ((color > 0.5 - 1e-5) & (color < 1 + 1e-5)).all()
        np.testing.assert_allclose(color[albedo == 0.5], 0.5, atol=1e-5)
        if frame.number == 4:
            assert now["overflow"] > 100
            if method == "samplecache":  # all slots but that of the one sample that a full pixel purges in a frame
                assert frame.aov("occupancy", "mono").max() >= 11


def test_a_furnace():
    """Within a closed ball that shines by itself, of albedo 1/2: its own light, and half of that by direct light."""
    room = lit(ball(2, 2), camera=view((0, 0, 0), (0, 0, -1)), materials=[grey(0.5, 1.0)])
    (frame,) = cached(room, size=(8, 8), spp=32).frames(0, 1)
    np.testing.assert_allclose(frame.color["mono"].mean(), 1.5, rtol=0.01)
    np.testing.assert_allclose(frame.color["mono"], 1.5, rtol=0.1)


def jumping(places):
    """A ball before a white sky that is at the k-th place in frame k."""
    scene = white_sky(0.5, view((0, 0, 6), (0, 0, 0), 40))
    count = len(places)
    turn = np.tile([0.0, 0, 0, 1], (count, 1))
    track = Track(np.arange(count, dtype=float), np.array(places, float), turn, np.ones((count, 3)), step=True)
    return replace(
        scene, instances=(replace(scene.instances[0], motion=(track,)),), defaults=replace(scene.defaults, fps=1.0)
    )


def test_an_object_that_leaves_leaves_nothing_behind():
    """Its samples go with it, and so the sky is seen at once."""
    for place in ((1e4, 0, 0), (0, 0, 1e4), (0, 0, 6.5), (1e18, 1e18, 1e18)):
        images = colors(cached(jumping([(0, 0, 0)] * 4 + [place] * 2)), 6)
        np.testing.assert_allclose(images[3][8, 8], 0.5, atol=1e-5)
        if place[2] != 6.5:  # there the camera is within
            for color in images[4:]:
                np.testing.assert_allclose(color, 1, atol=1e-5)


@pytest.mark.parametrize(("tracing", "delay"), [("multi", 0), ("adaptive", 16 * 5 - 1)])
def test_an_object_that_appears_is_seen(tracing, delay):
    """At once where all is traced. In a flat sky each pixel has its turn once in 16 frames, in which one of its samples, of at most 5,
    is found to be hidden."""
    scene = jumping([(1e4, 0, 0)] * 5 + [(0, 0, 0)])
    frames = list(cached(scene, tracing=tracing, aovs=("albedo",)).frames(0, 6 + delay))
    np.testing.assert_allclose(frames[4].color["mono"], 1, rtol=1e-6)
    np.testing.assert_allclose(frames[-1].color["mono"][6:10, 6:10], 0.5, atol=1e-5)


def test_an_object_faster_than_its_size():
    """It is somewhere else in each frame. White sky, grey ball: nothing else is ever seen, and the ball is where it is now."""
    places = [(1.5 * (-1) ** k, 0.7 * (k % 3 - 1), 0) for k in range(9)]
    renderer = cached(jumping(places), tracing="multi", aovs=("albedo",))
    for frame in renderer.frames(0, 9):
        color, albedo = frame.color["mono"], frame.aov("albedo", "mono")
        assert ((color > 0.5 - 1e-5) & (color < 1 + 1e-5)).all()
        np.testing.assert_allclose(color[albedo == 0], 1, atol=1e-5)
        np.testing.assert_allclose(color[albedo == 0.5], 0.5, atol=1e-5)
        slope = np.tan(np.radians(20)) * 6
        x, y = places[frame.number][:2]
        assert albedo[int(8 - 8 * y / slope), int(8 + 8 * x / slope), 0] == 0.5


# Numbers


def test_thousands_of_updates_of_a_still_view():
    """Converged to the path tracer's image, finite, and, where all pixels are shaded, with counts that say how many values there are:
    one for each update and pixel, but those of samples that were lost, none of which is on a still view."""
    scene = replace(yard(moving=False), camera=view((3, 2.5, 0.8), (1.8, 0, 0.2), 10))
    rate = {"shading": "uniform", "shading_rate": 1.0}
    renderer = cached(scene, size=(4, 4), spp=2000, aovs=("samples", "age"), **rate)
    (frame,) = renderer.frames(0, 1)
    assert relmse(frame.color["mono"], image(scene, (4, 4), 4096, bounces=0)) < 2e-4
    np.testing.assert_array_equal(frame.aov("samples", "mono"), 2000)
    assert frame.aov("age", "mono").min() > 1900


@pytest.mark.parametrize("seed", [0, 2**32, 2**63, 2**64 - 1])
def test_seeds(seed):
    """Ground in the light, and noise of its own for each."""
    renderer = cached(level(), seed=seed)
    (color,) = colors(renderer, 1)
    np.testing.assert_allclose(color, 1, atol=1e-5)
    other = cached(level(), seed=(seed + 1) % 2**64)
    colors(other, 1)
    assert (held(renderer).first_hit[0, :, :2] != held(other).first_hit[0, :, :2]).mean() > 0.99
