"""The methods samplecache and isrt: what they take, what they count, where their samples lie, and what they refuse."""

from collections import defaultdict

import numpy as np
import pytest
from cache_model import project
from cache_renders import SMALL, cached, counters, held, in_child, one_device, yard

from clcache import DeviceError, SettingError
from clcache.device import Device

SIZE = (32, 24)
PIXELS = 32 * 24
VARIANTS = ("single-pass", "two-pass", "deterministic")


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def frames(scene, count, **options):
    return list(cached(scene, size=SIZE, **SMALL, **options).frames(0, count))


# Memory


@pytest.fixture
def uncompiled(monkeypatch):
    """Without the kernels over caches, which take long to compile and say nothing about memory."""
    program = Device.program
    none = defaultdict(object)
    monkeypatch.setattr(
        Device, "program", lambda self, name, **d: none if name.startswith("samplecache/") else program(self, name, **d)
    )


@pytest.mark.parametrize(("stereo", "eyes"), [(False, 1), (True, 2)])
@pytest.mark.parametrize("slots", [1, 12, 16, 17, 32])
def test_memory_of_a_cache(uncompiled, slots, stereo, eyes):
    """A mask of two bits for each slot, in whole words; 16 bytes for the first hit and 16 for the radiance; for two frames."""
    words = 1 if 2 * slots <= 32 else 2
    memory = cached(yard(), size=SIZE, slots=slots, stereo=stereo).stats()["memory"]
    assert memory["cache"] == eyes * 2 * PIXELS * (4 * words + 32 * slots)
    assert memory["total"] > memory["cache"]


@pytest.mark.parametrize(("side", "words"), [(1, 1), (3, 1), (4, 1), (5, 2)])
def test_memory_of_interactive_stable_ray_tracing(uncompiled, side, words):
    memory = cached(yard(), "isrt", SIZE, settings={"isrt.superresolution": side}).stats()["memory"]
    assert memory["cache"] == 2 * PIXELS * (4 * words + 32 * side * side)


# Counters


@pytest.mark.parametrize(("method", "variant"), [*(("samplecache", v) for v in VARIANTS), ("isrt", "deterministic")])
def test_samples_are_conserved(method, variant):
    """Whatever was there is lost in one of three ways, or purged, or still there; over a moving camera all of it happens."""
    renderer = cached(yard(8), method, SIZE, **SMALL, reprojection=variant, aovs=("occupancy", "visible"))
    before, seen = 0, set()
    for frame in renderer.frames(0, 8):
        now, after = counters(frame), held(renderer)
        lost = now["dropped"] + now["overflow"] + now["stolen"]
        assert now["occupied"] == before - lost + now["created"] - now["purged"]
        assert now["occupied"] == after.occupied.sum() == frame.aov("occupancy", "mono").sum()
        assert now["visible"] == after.visible.sum() == frame.aov("visible", "mono").sum()
        assert not (after.visible & ~after.occupied).any()
        seen |= {name for name, count in now.items() if count > 0}
        before = now["occupied"]
    assert seen >= {"occupied", "visible", "created", "purged", "retraced", "shaded", "dropped"}
    if method == "samplecache":
        assert seen >= {"overflow", "stolen"}


@pytest.mark.parametrize("tracing", ["single", "multi", "adaptive"])
def test_primary_rays_are_those_traced(tracing):
    """What the AOV says of each pixel, in samples: those that are new, and those that were traced again."""
    for frame in frames(yard(6), 6, tracing=tracing, aovs=("trace", "occupancy")):
        traced = np.rint(frame.aov("trace", "mono").astype(float) * frame.aov("occupancy", "mono")).sum()
        assert frame.stats["eyes"]["mono"]["rays"]["primary"] == traced
        assert traced == counters(frame)["created"] + counters(frame)["retraced"]


def test_lists_have_room():
    """In an image of a few groups a group's samples are nearly a batch of the list, and what stays free at the batches' ends is
    much. What overruns the list breaks the process, which therefore is another one."""
    code = """
renderer = cached(yard(moving=False), size=(24, 16), **SMALL, aovs=("age",))
for _ in renderer.frames(0, 6):
    arrays = renderer._graph.of()
    print(arrays["listed"].get()[0], arrays["samples"].size)
"""
    listed, room = np.reshape(in_child(code), (-1, 2)).T
    assert len(listed) == 6 and (listed <= room).all()


def test_retraced_by_mode():
    """Of a view that stands still: multi traces all samples again, single one of each pixel, adaptive less than that here, where
    most of the image is flat."""
    retraced = {}
    for tracing in ("single", "multi", "adaptive"):
        *_, before, last = frames(yard(moving=False), 12, tracing=tracing)
        retraced[tracing] = counters(last)["retraced"]
        if tracing == "multi":
            assert retraced[tracing] == counters(before)["occupied"]
    assert retraced["single"] == PIXELS
    assert retraced["adaptive"] < retraced["multi"]


def test_every_pixel_has_a_visible_sample_from_the_first_frame_on():
    for frame in frames(yard(6), 6, aovs=("visible",)):
        assert frame.aov("visible", "mono").min() >= 1


@pytest.mark.parametrize("rate", [0.25, 0.5])
@pytest.mark.parametrize("shading", ["uniform", "adaptive"])
def test_shading_rate(shading, rate):
    """Samples that are shaded: as many as the rate says of the pixels that show a surface, within 4.5 deviations of as many coin
    tosses."""
    renderer = cached(yard(moving=False), size=SIZE, **SMALL, shading=shading, shading_rate=rate)
    shaded = [counters(frame)["shaded"] for frame in renderer.frames(0, 12)][4:]
    after = held(renderer)
    surfaces = (after.visible & ~after.background).any(axis=0).sum()
    expected = rate * (surfaces if shading == "uniform" else PIXELS)
    deviation = np.sqrt(rate * (1 - rate) * PIXELS / len(shaded))
    assert abs(np.mean(shaded) - expected) < 4.5 * deviation


def test_samples_lie_in_their_pixels():
    """Each sample of the cache, seen by the frame's camera, is within its pixel."""
    renderer = cached(yard(6), size=SIZE, **SMALL)
    for frame in renderer.frames(0, 6):
        check_places(renderer, frame, lambda x, y, slot: np.ones(len(x), bool))


def check_places(renderer, frame, in_slot):
    """in_slot: of places within pixels, 0 .. 1, and slots: which belong there."""
    after, scene = held(renderer), renderer.scene
    slot, pixel = np.nonzero(after.occupied)
    to_world = renderer._resources.arrays["instances"].get()["to_world"].reshape(-1, 3, 4)
    found = project(scene, frame.cameras["mono"], SIZE, after.first_hit[slot, pixel], to_world)
    assert found.in_front.all()
    x, y = found.x - pixel % SIZE[0], found.y - pixel // SIZE[0]
    assert min(x.min(), y.min()) > -1e-3 and max(x.max(), y.max()) < 1 + 1e-3
    assert in_slot(x, y, slot).all()


@pytest.mark.parametrize("side", [1, 5])
def test_slots_of_interactive_stable_ray_tracing_are_places_in_the_pixel(side):
    """Of a grid of so many cells along a pixel's side, row by row; up to what fixed point and float32 shift a point."""

    def in_cell(x, y, slot):
        across, down = x * side - slot % side, y * side - slot // side
        return (np.minimum(across, down) > -1e-3 * side) & (np.maximum(across, down) < 1 + 1e-3 * side)

    settings = {"isrt.superresolution": side}
    renderer = cached(yard(6), "isrt", SIZE, target=min(4, side * side), settings=settings)
    for frame in renderer.frames(0, 6):
        check_places(renderer, frame, in_cell)
    assert len(np.unique(np.nonzero(held(renderer).occupied)[0])) == side * side


# What is refused


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"slots": 0}, "setting samplecache.slots: 0 is not an int in range; expected 1 .. 32"),
        ({"slots": 33}, "setting samplecache.slots: 33 is not an int in range; expected 1 .. 32"),
        ({"tracing": "some"}, "setting samplecache.tracing: 'some' is not a str in range; expected single, multi, adaptive"),
        ({"reprojection": "triple"}, "setting samplecache.reprojection: 'triple' is not a str in range; expected single-pass, "),
        ({"shading_rate": 0.01}, "setting samplecache.shading_rate: 0.01 is not a float in range; expected 0.0625 .. 1"),
        ({"settings": {"isrt.superresolution": 6}}, "setting isrt.superresolution: 6 is not an int in range; expected 1 .. 5"),
        ({"slots": 32, "size": (8192, 8192)}, "67108864 pixels of 32 slots: expected "),
        ({"until_relmse": 0.1}, "until_relmse 0.1: method samplecache has a cache"),
        ({"stereo_blend": "samples"}, "stereo_blend samples: there is one eye; expected stereo"),
    ],
)  # fmt: skip
def test_wrong_settings(options, message):
    with pytest.raises(SettingError) as caught:
        cached(yard(), **{"size": SIZE} | options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_cache_that_does_not_fit_the_device(uncompiled):
    with pytest.raises(DeviceError, match="the frame needs .* GiB beside") as caught:
        cached(yard(), size=(16384, 16384), slots=1)
    assert "\n" not in str(caught.value)
