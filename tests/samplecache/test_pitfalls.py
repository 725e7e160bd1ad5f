"""What has gone wrong in published caches of radiance, asked of this one: settings that change under a cache, new samples that answer
black, and history that is lost or tinted by looking away."""

import numpy as np
import pytest
from cache_renders import along, cached, counters, held, one_device, orbit, yard
from render_helpers import floor, grey, lit, view
from ztest import agree

from clcache.scene.model import DirectionalLight

SIZE = (24, 16)
PIXELS = 24 * 16
SUN = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
ABOVE = view((0, 3, 0.1), (0, 0, 0))


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def images(scene, count, **options):
    return [frame.color["mono"] for frame in cached(scene, size=SIZE, **options).frames(0, count)]


# Settings changed without clearing what they invalidate


@pytest.mark.parametrize(
    "changed",
    [
        {"target": 2},
        {"tolerance": 0},
        {"tracing": "multi"},
        {"slots": 3},
        {"shading": "uniform"},
        {"shading_rate": 0.5},
        {"demodulate": True},
        {"alpha": 0.5},
        {"bounces": 0},
    ],
    ids=str,
)
def test_other_settings_begin_anew(changed):
    """A setting is the renderer's, for good: another one has another cache, and what it shows depends on nothing that went before on the
    same device."""
    usual, first = images(yard(4), 4), images(yard(4), 4, **changed)
    assert not all(np.array_equal(a, b) for a, b in zip(usual, first, strict=True)), "the setting changes nothing"
    between = cached(yard(4), size=SIZE)
    other = cached(yard(4), size=SIZE, **changed)
    for number in range(4):  # taking turns
        np.testing.assert_array_equal(next(between.frames(number, number + 1)).color["mono"], usual[number])
        np.testing.assert_array_equal(next(other.frames(number, number + 1)).color["mono"], first[number])


def test_what_is_written_to_a_renderers_settings_changes_nothing():
    renderer, usual = cached(yard(4), size=SIZE), images(yard(4), 4)
    for frame, expected in zip(renderer.frames(0, 4), usual, strict=True):
        np.testing.assert_array_equal(frame.color["mono"], expected)
        renderer.settings |= {"samplecache.target": 1.0, "samplecache.tracing": "multi", "samplecache.alpha": 1.0}


# A new sample that answers black


def cut(scene, other):
    """Six frames from one camera, then some from another that sees nothing of what the first saw."""
    return along(scene, [other] * 6 + [scene.camera] * 3)


@pytest.mark.parametrize("demodulate", [False, True])
def test_after_a_cut_a_pixel_is_what_its_sample_says(demodulate):
    """The first frame after it has one sample and one value of radiance in each pixel, and shows just that."""
    scene = cut(yard(moving=False), view((100, 2, 0), (200, 3, 0)))
    renderer = cached(scene, size=SIZE, demodulate=demodulate, aovs=("visible",))
    list(renderer.frames(0, 6))
    (frame,) = renderer.frames(6, 7)
    after, color = held(renderer), frame.color["mono"].reshape(-1, 3)
    assert (after.occupied.sum(axis=0) == 1).all() and (frame.aov("visible", "mono") == 1).all()
    slot = after.occupied.argmax(axis=0)
    radiance, count = (values[slot, np.arange(PIXELS)] for values in (after.radiance, after.count))
    surface = count != 0xFFFF
    assert 100 < surface.sum() < PIXELS and (count[surface] == 1).all()
    if not demodulate:
        np.testing.assert_allclose(color, radiance, rtol=1e-6)
    assert (color.min(axis=1) > 0).all() or (radiance[color.min(axis=1) == 0].min(axis=1) == 0).all()


@pytest.mark.parametrize("shading", ["uniform", "adaptive"])
@pytest.mark.parametrize("demodulate", [False, True])
@pytest.mark.parametrize("rate", [0.0625, 0.5])
def test_after_a_cut_pixels_that_are_not_shaded_yet_are_not_black(rate, demodulate, shading):
    """Ground that is evenly lit is so from the first frame on, though most of it was not shaded then."""
    scene = lit(floor(200), camera=ABOVE, materials=[grey(0.5)], lights=[SUN])
    scene = cut(scene, view((50, 3, 0.1), (50, 0, 0)))
    options = {"shading_rate": rate, "demodulate": demodulate, "shading": shading, "bounces": 0}
    for frame, color in enumerate(images(scene, 9, **options)):
        np.testing.assert_allclose(color, 0.5, rtol=1e-5, err_msg=f"frame {frame}")


# Looking away and back


AWAY = view((0, 2.5, 0), (0, 3, 50))


def test_looking_away_and_back_begins_anew():
    """All samples go with the view, and none comes back tinted: the images after it are those of a fresh start."""
    scene = yard(moving=False)
    there_and_back = along(scene, [scene.camera] * 6 + [AWAY] * 2 + [scene.camera] * 4)
    back, fresh = [], []
    for seed in range(6):
        renderer = cached(there_and_back, size=SIZE, seed=seed, aovs=("age", "samples"))
        *_, away, returned = renderer.frames(0, 9)
        assert (
            counters(away)["shaded"] == 0 and counters(returned)["occupied"] == counters(returned)["created"] == PIXELS
        )
        assert not returned.aov("age", "mono").any() and returned.aov("samples", "mono").max() == 1
        *_, last = renderer.frames(9, 12)
        back.append(last.color["mono"])
        fresh.append(images(scene, 4, seed=100 + seed)[-1])
    for verdict in agree(back, fresh):
        assert verdict.passed, verdict


def test_what_stays_in_view_keeps_its_history():
    """Of a small turn and back, only what left the view is new: the rest has all its values."""
    still = orbit(1)[0]
    eye = still.transform[:, 3]
    aside = view(eye, eye - still.transform[:, 2] + 0.15 * still.transform[:, 0])
    scene = along(yard(moving=False), [still] * 10 + [aside] + [still])
    renderer = cached(scene, size=SIZE, aovs=("age", "albedo"))
    *_, last = renderer.frames(0, 12)
    age = last.aov("age", "mono")
    assert age[:, 8:].mean() > 5
    assert age[:, 0].mean() < 1
    assert counters(last)["dropped"] > 0


def test_a_view_that_swings_is_as_dense_and_as_bright_as_one_at_rest():
    """There and back, over and over: density stays within its band, and the image's mean is that of a still view."""
    scene = yard(moving=False)
    swing = [orbit(5)[abs(4 - k % 8)] for k in range(33)]
    renderer = cached(along(scene, swing), size=SIZE, tracing="multi", aovs=("visible",))
    ends = [f for f in renderer.frames(0, 33) if f.number % 8 == 4 and f.number > 8]
    means = np.mean([f.color["mono"] for f in ends], axis=(0, 1, 2))
    rest = np.mean([images(scene, 16, seed=s)[-1] for s in range(3)], axis=(0, 1, 2))
    np.testing.assert_allclose(means, rest, rtol=0.03)
    assert all(2.5 < f.aov("visible", "mono").mean() < 5.5 for f in ends)
