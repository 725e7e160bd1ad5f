"""The temporal filters behind the methods: less error, less flicker, and histories that follow what moves."""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import at, one_device, orbit, yard
from helpers import IDENTITY
from render_helpers import ball, floor, grey, lit
from scipy.ndimage import maximum_filter

from clcache import Renderer
from clcache.methods import METHODS
from clcache.passes.temporal import FindMotion
from clcache.scene.model import DirectionalLight, Track

SIZE = (64, 48)
FRAMES = 16
TEMPORALS = ("taa", "varianceblend")
# A sample of each pixel is in one image alone; of the other methods, which keep samples, the next image has most of them again.
FORGETFUL = ("pathtrace", "voxelhash")


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def scene(moving: bool):
    made = yard(FRAMES, moving)
    return replace(made, defaults=replace(made.defaults, fps=1.0))


def frames(made, method="pathtrace", count=FRAMES, **options):
    """Their colours, and the last of them."""
    few = {"pathtrace.bounces": 1, "octree.resolution": 128}
    options = {"size": SIZE, "spp": 1, "seed": 4, "stereo": False, "settings": few} | options
    shown = list(Renderer(made, method, **options).frames(FRAMES - count, FRAMES))
    return [f.color["mono"] for f in shown], shown[-1]


@pytest.fixture(scope="module")
def shown():
    """The frames of a method with a temporal filter, rendered once."""
    rendered = {}

    def find(moving, method, temporal):
        key = moving, method, temporal
        if key not in rendered:
            rendered[key] = frames(scene(moving), method, temporal=temporal)[0]
        return rendered[key]

    return find


@pytest.fixture(scope="module")
def truth():
    """The last frame of the still and of the moving scene, with many samples."""
    options = {"count": 1, "spp": 512, "seed": 99}
    return {moving: frames(scene(moving), **options)[0][-1] for moving in (False, True)}


def rmse(image, reference):
    return float(np.sqrt(np.mean((image - reference) ** 2)))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
def test_less_error(truth, shown, method, moving):
    """Than without a filter, and the least with varianceblend where things move; but where most of an image's samples were in the
    one before, there is next to nothing to win and a little to lose."""
    error = {t: rmse(shown(moving, method, t)[-1], truth[moving]) for t in ("none", *TEMPORALS)}
    for name in TEMPORALS:
        assert error[name] < (0.99 if method in FORGETFUL else 1.3) * error["none"], error
    if method == "pathtrace":
        assert error["varianceblend"] < (0.5 if moving else 0.3) * error["none"], error
    if moving:
        assert error["varianceblend"] < error["taa"], error


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("temporal", TEMPORALS)
def test_less_flicker(shown, method, temporal):
    """From frame to frame of a still scene, after any method."""
    filtered, plain = (shown(False, method, t) for t in (temporal, "none"))
    assert rmse(filtered[-1], filtered[-2]) < 0.8 * rmse(plain[-1], plain[-2])


@pytest.mark.parametrize("temporal", TEMPORALS)
def test_history_follows_a_moving_instance(monkeypatch, temporal):
    """Of a ball that flies before a camera that stands still, with its motion and without: more effective samples, less error."""
    places = np.array([(-1.3, 0.9, 0.4), (1.3, 1.1, 0.2)])
    fly = Track(np.array([0.0, FRAMES]), places, np.tile([0, 0, 0, 1.0], (2, 1)), np.ones((2, 3)))
    made = lit(
        floor(6), ball(0.9, 2, 1), camera=orbit(1)[0], materials=[grey(0.1), grey(0.9)], environment=(0.3, 0.4, 0.5),
        lights=[DirectionalLight((0.48, -0.8, 0.36), (2.0, 1.8, 1.5))], instances=[(0, IDENTITY), (1, at(places[0]))],
    )  # fmt: skip
    made = replace(made, instances=(made.instances[0], replace(made.instances[1], motion=(fly,))))
    made = replace(made, defaults=replace(made.defaults, fps=1.0))
    reference, last = frames(made, count=1, spp=512, seed=99, aovs=("albedo",))
    on_ball = last.aov("albedo", "mono")[..., 0] > 0.85
    assert on_ball.sum() > 300
    options = {"temporal": temporal, "aovs": ("effective",)}
    options["settings"] = {"pathtrace.bounces": 1, "taa.validation": "reject"}
    run, found = FindMotion.run, {}

    def without_motion(self, arrays, state):
        scene_arrays = self._scene.arrays
        scene_arrays["instances_before"].set(scene_arrays["instances"].get())
        return run(self, arrays, state)

    for moves in (True, False):
        if not moves:
            monkeypatch.setattr(FindMotion, "run", without_motion)
        colors, last = frames(made, **options)
        found[moves] = rmse(colors[-1][on_ball], reference[-1][on_ball]), last.aov("effective", "mono")[on_ball].mean()
    assert found[True][0] < 0.9 * found[False][0], found
    assert found[True][1] > 1.2 * found[False][1], found


def test_a_cut_drops_the_history():
    """A frame that is not the next one begins anew; so do frames of another renderer."""
    made = scene(True)
    renderer = Renderer(made, "pathtrace", SIZE, spp=1, stereo=False, temporal="taa", aovs=("alpha", "effective"))
    options = {"size": SIZE, "spp": 1, "stereo": False}
    plain = Renderer(made, "pathtrace", **options)
    for number, is_first in ((3, True), (4, False), (9, True), (2, True)):
        frame = next(renderer.frames(number, number + 1))
        assert (frame.aov("alpha", "mono") == 1).all() == is_first
        assert (frame.aov("effective", "mono") == 1).all() == is_first
        if is_first:
            np.testing.assert_array_equal(frame.color["mono"], next(plain.frames(number, number + 1)).color["mono"])


def test_each_eye_has_a_history_of_its_own():
    """A pair's left image is the one that it is without the right one."""
    made = replace(scene(True), defaults=replace(scene(True).defaults, eye_distance=0.0, fps=1.0))
    settings = {"pathtrace.bounces": 1}
    pair = Renderer(made, "pathtrace", SIZE, spp=1, stereo=True, temporal="varianceblend", settings=settings)
    single = Renderer(made, "pathtrace", SIZE, spp=1, stereo=False, temporal="varianceblend", settings=settings)
    for both, one in zip(pair.frames(0, 4), single.frames(0, 4), strict=True):
        np.testing.assert_array_equal(both.color["left"], one.color["mono"])


def test_a_lamp_that_flies_on_leaves_no_trail():
    """A glowing ball over a floor, under the sky: where it was three frames before, and is not near any more, less than 5.4 % of its
    radiance is left, 5.9 % if only what it hid had no history, and not what was mixed with its edge."""
    places = np.array([(-4.0, 1.0, 0.6), (0.8, 1.0, 0.6)])
    fly = Track(np.array([0.0, FRAMES]), places, np.tile([0, 0, 0, 1.0], (2, 1)), np.ones((2, 3)))
    made = lit(
        floor(12), ball(0.45, 2, 1), camera=orbit(1)[0], materials=[grey(0.2), grey(0.1, 40.0)],
        environment=(0.3, 0.4, 0.5), instances=[(0, IDENTITY), (1, at(places[0]))],
    )  # fmt: skip
    made = replace(made, instances=(made.instances[0], replace(made.instances[1], motion=(fly,))))
    made = replace(made, defaults=replace(made.defaults, fps=1.0))
    plain, shown = frames(made)[0], frames(made, temporal="varianceblend")[0]
    glows = [image.mean(axis=-1) > 20 for image in plain]
    was_there = glows[-4] & ~maximum_filter(glows[-1], 3)
    assert was_there.sum() > 100
    assert abs((shown[-1] - plain[-1])[was_there].mean()) < 0.054 * 40
