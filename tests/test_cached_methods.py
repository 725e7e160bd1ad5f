"""What the renderer does for methods with a cache: updates, each eye's history, counters, memory, blending and what it refuses.

The methods here compute nothing that is worth seeing: their passes leave numbers from which follows what they were told
and what they found.
"""

from dataclasses import replace

import pyopencl as cl
import pytest
from fake_method import EYES, PIXELS, SIZE, Fake
from render_helpers import everything

from clcache import DeviceError, Renderer, SettingError
from clcache.methods import METHODS
from clcache.random import stream_key
from clcache.renderer import camera_record


@pytest.fixture
def fake(monkeypatch):
    return use(monkeypatch, Fake())


def use(monkeypatch, method):
    monkeypatch.setitem(METHODS, "samplecache", method)
    return method


def renderer(**options):
    return Renderer(everything(), "samplecache", **{"size": SIZE, "stereo": True} | options)


def colors(frame):
    """The eyes' colours, each the same everywhere."""
    assert all((color == color[0, 0, 0]).all() and color.shape == (2, 3, 3) for color in frame.color.values())
    return [int(color[0, 0, 0]) for color in frame.color.values()]


# Updates and history


def test_each_eye_goes_on_with_what_it_left(fake):
    assert [colors(frame) for frame in renderer().frames(0, 3)] == [[1, 2], [11, 22], [111, 222]]
    assert [colors(frame) for frame in renderer(stereo=False).frames(0, 2)] == [[3], [33]]


def test_caches_outlive_a_sequence_but_not_the_renderer(fake):
    first = renderer()
    assert colors(list(first.frames(0, 2))[-1]) == [11, 22]
    assert colors(next(first.frames(0, 1))) == [111, 222]
    assert colors(next(renderer().frames(5, 6))) == [1, 2]


@pytest.mark.parametrize(("spp", "expected"), [(None, 1), (1, 1), (3, 3)])
def test_spp_is_the_updates_of_each_frame(fake, spp, expected):
    """One where nothing is given, whatever the scene says."""
    scene = everything()
    scene = replace(scene, defaults=replace(scene.defaults, spp=7, method="samplecache", stereo=True))
    first = Renderer(scene, size=SIZE, spp=spp)
    frames = list(first.frames(0, 2))
    assert first.stats()["spp"] == frames[1].stats["eyes"]["left"]["spp"] == expected
    assert colors(frames[1]) == [int("1" * 2 * expected), int("2" * 2 * expected)]


def test_what_the_passes_are_told(fake):
    """Random numbers go on from frame to frame: each eye has a key of its own, the same in all of them, and the update is the sample;
    each update is one sample."""
    for _ in renderer(spp=2, seed=9).frames(4, 6):
        pass
    assert [s.update for s in fake.states] == [0, 1, 0, 1, 2, 3, 2, 3]  # two for each eye and frame
    keys = [stream_key(9, 0)] * 2 + [stream_key(9, 1)] * 2
    assert [state.key for state in fake.states] == keys + keys and keys[0] != keys[2]
    for state in fake.states:
        assert (state.sample, state.samples, state.begin, state.batch) == (state.update, 1, 0, 0)
        assert state.other is None
        assert state.sampling == {"sample": state.update, "key0": state.key[0], "key1": state.key[1]}


def test_a_method_without_cache_has_new_numbers_in_each_frame(monkeypatch, fake):
    monkeypatch.setitem(METHODS, "other", fake)
    for _ in Renderer(everything(), "other", size=SIZE, spp=5, seed=9).frames(0, 2):
        pass
    assert [s.key for s in fake.states] == [stream_key(9, 0), stream_key(9, 1)]
    assert [(s.samples, s.sample, s.update) for s in fake.states] == [(5, 0, 0), (5, 0, 1)]


def test_progress_is_of_updates(fake):
    parts = []
    for _ in renderer(spp=2).frames(0, 1, parts.append):
        pass
    assert parts == [0.25, 0.5, 0.75, 1.0]


# Statistics


def test_counters_and_rays_are_of_all_updates_but_levels_are_the_last(fake):
    frames = [frame.stats["eyes"] for frame in renderer(spp=2).frames(0, 2)]
    for number, eyes in enumerate(frames):
        updates = [2 * number, 2 * number + 1]
        for eye in EYES:
            assert eyes[eye]["cache"] == {"occupied": 100 + updates[1], "created": 40, "retraced": sum(updates)}
            assert eyes[eye]["rays"] == {
                "primary": sum(20 + u for u in updates), "secondary": sum(4 * (u + 1) for u in updates), "shadow": 8,
            }  # fmt: skip


def test_a_method_that_counts_nothing(monkeypatch):
    use(monkeypatch, Fake(counters=()))
    eye = next(renderer(spp=3, stereo=False).frames(0, 1)).stats["eyes"]["mono"]
    assert eye["cache"] == {}
    assert eye["rays"]["primary"] == 3 * PIXELS


@pytest.mark.parametrize(("stereo", "eyes"), [(False, 1), (True, 2)])
def test_memory_of_the_cache_is_that_of_its_buffers(fake, stereo, eyes):
    memory = {size: renderer(size=size, stereo=stereo).stats()["memory"] for size in (SIZE, (30, 2))}
    for (width, height), of_size in memory.items():
        assert of_size["cache"] == eyes * 2 * 4 * width * height
    grown = memory[30, 2]["total"] - memory[SIZE]["total"]
    assert grown == 4 * (60 - PIXELS) * (eyes * (2 + 3) + 1)  # history twice and colour; the age, which both eyes share


def test_path_tracing_has_no_cache():
    assert Renderer(everything(), size=SIZE).stats()["memory"]["cache"] == 0


# Blending


def test_the_blend_sees_both_eyes_as_they_were(fake):
    """Neither eye gets what the other's blend made, and the histories go on unblended; AOVs are those of the method."""
    frames = list(renderer(stereo_blend="samples", aovs=("age",)).frames(0, 3))
    assert fake.stereo_blend == "samples"
    assert [colors(frame) for frame in frames] == [[2001, 1002], [22011, 11022], [222111, 111222]]
    assert [frame.aov("age", eye)[1, 2] for frame in frames for eye in EYES] == [1, 2, 11, 22, 111, 222]
    assert {"remember", "blend"} <= frames[0].stats["eyes"]["right"]["passes"].keys()


def test_what_the_blend_is_told(fake):
    frame = next(renderer(stereo_blend="samples", spp=3).frames(0, 1))
    records = [camera_record(frame.cameras[eye], SIZE) for eye in EYES]
    assert [(s.camera, s.other) for s in fake.told] == [(records[0], records[1]), (records[1], records[0])]
    assert [s.update for s in fake.told] == [2, 2]


def test_without_blending_nothing_of_it_is_there(fake):
    frame = next(renderer(aovs=("age",)).frames(0, 1))
    assert (fake.stereo_blend, colors(frame)) == ("none", [1, 2])
    assert "blend" not in frame.stats["eyes"]["left"]["passes"]
    assert "blended" not in renderer()._graph.sizes


@pytest.mark.parametrize("buffer", ["aov_age", "other_aov_age", "other_scratch"])
def test_the_blend_cannot_read_what_the_other_eye_has_overwritten(monkeypatch, buffer):
    use(monkeypatch, Fake(reads=("color", buffer)))
    with pytest.raises(ValueError, match=f"blend uses {buffer}, which is neither declared nor given"):
        renderer(stereo_blend="samples")


@pytest.mark.parametrize("broken", ["remember", "blend"])
def test_a_device_that_fails(monkeypatch, fake, broken):
    def fail(arrays, state):
        raise cl.RuntimeError("enqueue", cl.status_code.OUT_OF_RESOURCES, "")

    monkeypatch.setattr(fake, broken, fail)
    with pytest.raises(DeviceError, match="frame 4: the device failed"):
        next(renderer(stereo_blend="samples").frames(4, 5))


# What is refused


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"until_relmse": 0.1},
            "until_relmse 0.1: method samplecache has a cache; expected a method without, pathtrace",
        ),
        ({"spp": 0}, "spp 0: expected 1 .. "),
        ({"aovs": ("age", "Z")}, "AOV Z: method samplecache has none; it has visible, age"),
        ({"stereo_blend": "more"}, "stereo_blend more: unknown; there is none, constant, varianceblend, samples"),
        ({"stereo_blend": "samples", "stereo": False}, "stereo_blend samples: there is one eye; expected stereo"),
        (
            {"stereo_blend": "samples", "method": "pathtrace"},
            "stereo_blend samples: method pathtrace has no cache of samples to blend",
        ),
        (
            {"aovs": ("occupancy",), "method": "pathtrace"},
            "AOV occupancy: method pathtrace has none; it has albedo, N, variance, samples, Z",
        ),
    ],
)
def test_wrong_arguments(fake, options, message):
    with pytest.raises(SettingError) as caught:
        Renderer(everything(), **{"method": "samplecache", "size": SIZE, "stereo": True} | options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_stats_say_how_the_eyes_were_blended(fake):
    assert renderer().stats()["stereo_blend"] == "none"
    assert renderer(stereo_blend="samples").stats()["stereo_blend"] == "samples"
