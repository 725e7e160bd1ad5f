"""The stages after the method: what a temporal filter and a stereo blend are given, when they run, and what becomes of it.

Neither computes anything worth seeing. The temporal filter's image is 1000 times the colour of its last run plus that of this
one; the stereo blend's 2^20 times the other eye's image plus the own.
"""

import sys
import types
from pathlib import Path

import numpy as np
import pytest
from fake_method import EYES, PIXELS, SIZE, Fake, Step, put
from render_helpers import everything

from clcache import Renderer, SettingError, load_scene
from clcache.frame import Buffer
from clcache.methods import METHODS
from clcache.passes.filter import Filter
from clcache.renderer import camera_record

FAR = 2.0**20


class FakeTemporal:
    """kinds: it was asked for. told: its passes' states. seen: (colour, surface) of each run."""

    def __init__(self):
        self.kinds, self.told, self.seen = [], [], []

    def __call__(self, device, scene, size, settings, kind):
        self.kinds.append(kind)
        self.has_before = "instances_before" in scene.arrays
        n = size[0] * size[1]
        return Filter(
            (
                Step("temporal", ("color", "surface", "before"), ("now", "filtered"), self.run),
                Step("weigh", ("filtered",), ("aov_alpha",), lambda arrays, _: put(arrays["aov_alpha"], 0.25)),
            ),
            (
                *(Buffer(b, (n, 3), persistent=True, per_eye=True) for b in ("now", "before")),
                Buffer("filtered", (n, 3), per_eye=True),
                Buffer("aov_alpha", (n,)),
            ),
            "filtered",
            (("now", "before"),),
        )

    def run(self, arrays, state):
        self.told.append(state)
        color, before = arrays["color"].get(), arrays["before"].get()
        self.seen.append((int(color[0, 0]), int(arrays["surface"].get()[0, 0])))
        put(arrays["now"], color)
        put(arrays["filtered"], color + 1000 * before)


class FakeStereo:
    """kinds: it was asked for. told: its passes' states."""

    def __init__(self):
        self.kinds, self.told = [], []

    def __call__(self, device, scene, size, settings, kind):
        self.kinds.append(kind)
        n = size[0] * size[1]
        reads = ("color", "other_color", "surface", "other_surface", "history", "other_history")
        passes = (
            Step("stereo", reads, ("joined",), self.run),
            Step("share", ("joined",), ("aov_beta",), lambda arrays, _: put(arrays["aov_beta"], 0.75)),
        )
        return Filter(passes, (Buffer("joined", (n, 3)), Buffer("aov_beta", (n,))), "joined")

    def run(self, arrays, state):
        self.told.append(state)
        for eye in ("", "other_"):
            assert (arrays[f"{eye}surface"].get() == arrays[f"{eye}history"].get()[:, None]).all()
        put(arrays["joined"], arrays["color"].get() + FAR * arrays["other_color"].get())


@pytest.fixture
def stages(monkeypatch):
    """The fakes, in the places of the method samplecache, of the temporal filters and of the stereo blends."""
    stages = types.SimpleNamespace(method=Fake(), temporal=FakeTemporal(), stereo=FakeStereo())
    monkeypatch.setitem(METHODS, "samplecache", stages.method)
    monkeypatch.setitem(sys.modules, "clcache.passes.temporal", types.SimpleNamespace(temporal=stages.temporal))
    monkeypatch.setitem(sys.modules, "clcache.passes.stereo", types.SimpleNamespace(stereo=stages.stereo))
    return stages


def renderer(**options):
    return Renderer(everything(), **{"method": "samplecache", "size": SIZE, "stereo": True} | options)


def colors(frame):
    """The eyes' colours, each the same everywhere."""
    assert all((color == color[0, 0, 0]).all() and color.shape == (2, 3, 3) for color in frame.color.values())
    return [color[0, 0, 0] for color in frame.color.values()]


def test_a_temporal_filter_has_a_history_for_each_eye(stages):
    frames = list(renderer(temporal="taa").frames(0, 3))
    assert stages.temporal.kinds == ["taa"]
    assert [colors(frame) for frame in frames] == [[1, 2], [1011, 2022], [11111, 22222]]
    assert stages.temporal.seen == [(n, n) for n in (1, 2, 11, 22, 111, 222)]  # and it sees the unfiltered colour
    assert "temporal" in frames[0].stats["eyes"]["right"]["passes"]
    assert not {"weigh", "stereo"} & frames[0].stats["eyes"]["right"]["passes"].keys()


def test_the_stereo_blend_follows_the_temporal_filter_and_enters_no_history(stages):
    frames = list(renderer(temporal="varianceblend", stereo_blend="constant").frames(0, 3))
    assert (stages.temporal.kinds, stages.stereo.kinds) == (["varianceblend"], ["constant"])
    pairs = [(1, 2), (1011, 2022), (11111, 22222)]
    assert [colors(frame) for frame in frames] == [
        [np.float32(own + FAR * other) for own, other in (pair, pair[::-1])] for pair in pairs
    ]


def test_the_stereo_blend_alone_has_the_methods_image(stages):
    frame = next(renderer(stereo_blend="varianceblend").frames(0, 1))
    assert colors(frame) == [1 + FAR * 2, 2 + FAR * 1]
    assert stages.stereo.kinds == ["varianceblend"] and not stages.temporal.kinds


def test_blending_by_samples_takes_filtered_images(stages):
    """The fake's own blend adds 1000 times the other's colour, and looks at the unfiltered history only where it is told to."""
    stages.method.reads = ("color", "other_color")
    stages.method.blend = lambda arrays, state: put(
        arrays["blended"], arrays["color"].get() + FAR * arrays["other_color"].get()
    )
    *_, frame = renderer(temporal="taa", stereo_blend="samples").frames(0, 2)
    assert colors(frame) == [1011 + FAR * 2022, 2022 + FAR * 1011]


def test_filters_run_once_for_each_frame_and_eye(stages):
    frames = list(renderer(temporal="taa", stereo_blend="constant", spp=3, seed=5).frames(4, 6))
    assert [s.eye for s in stages.method.states] == [0, 0, 0, 1, 1, 1] * 2
    for told in (stages.temporal.told, stages.stereo.told):
        assert [(s.eye, s.update) for s in told] == [(0, 2), (1, 2), (0, 5), (1, 5)]
    records = [camera_record(frame.cameras[eye], SIZE) for frame in frames for eye in EYES]
    assert [s.camera for s in stages.temporal.told] == records
    assert [s.other for s in stages.temporal.told] == [None] * 4
    assert [s.other for s in stages.stereo.told] == [records[i] for i in (1, 0, 3, 2)]


def test_the_camera_before_is_of_the_frame_before(stages):
    """And there is none at first, or after frames that do not follow each other."""
    first, cameras = renderer(temporal="taa"), None
    for begin, end in ((3, 5), (5, 6), (7, 8), (7, 8)):
        for frame in first.frames(begin, end):
            before = [s.camera_before for s in stages.temporal.told[-2:]]
            if frame.number in (4, 5):
                assert before == [s.camera_before for s in stages.method.states[-2:]] == cameras
            else:
                assert before == [None, None]
            cameras = [camera_record(frame.cameras[eye], SIZE) for eye in EYES]


def test_aovs_of_filters(stages):
    options = {"temporal": "taa", "stereo_blend": "constant", "aovs": ("age", "beta", "alpha")}
    *_, frame = renderer(**options).frames(0, 2)
    for eye, age in zip(EYES, (11, 22), strict=True):
        assert {name: frame.aov(name, eye)[1, 2] for name in options["aovs"]} == {
            "age": age,
            "beta": 0.75,
            "alpha": 0.25,
        }
        assert {"weigh", "share"} <= frame.stats["eyes"][eye]["passes"].keys()


def test_without_filters_there_is_nothing_for_them(stages):
    plain = renderer()
    passes = next(plain.frames(0, 1)).stats["eyes"]["left"]["passes"]
    assert not {"surface", "temporal", "stereo"} & passes.keys()
    assert "surface" in next(renderer(temporal="taa").frames(0, 1)).stats["eyes"]["left"]["passes"]
    assert stages.temporal.has_before
    assert "instances_before" not in plain._resources.arrays


def test_histories_are_memory_but_not_the_cache(stages):
    plain, filtered = (renderer(temporal=kind).stats()["memory"] for kind in ("none", "taa"))
    assert filtered["cache"] == plain["cache"]
    vectors, surface = 2 * 3 * 3 * 4, 2 * 4 * 4  # of two eyes: now, before and filtered
    instances = renderer(temporal="taa")._resources.arrays["instances_before"].nbytes
    assert filtered["total"] - plain["total"] == PIXELS * (vectors + surface) + instances


def test_rounds_of_samples_are_filtered_once(stages):
    options = {"method": "pathtrace", "temporal": "taa", "until_relmse": 1e-9, "spp": 40, "stereo": False}
    frames = list(renderer(**options).frames(0, 2))
    assert [frame.stats["eyes"]["mono"]["spp"] for frame in frames] == [40, 40]
    assert [s.update for s in stages.temporal.told] == [2, 5]  # after 16, 32 and 40 samples


def test_stats_say_which_filter_there_was(stages):
    assert renderer().stats()["temporal"] == "none"
    assert renderer(temporal="taa").stats()["temporal"] == "taa"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"temporal": "tee"}, "temporal tee: unknown; there is none, taa, varianceblend"),
        ({"stereo_blend": "constant", "stereo": False}, "stereo_blend constant: there is one eye; expected stereo"),
        ({"aovs": ("alpha",)}, "AOV alpha: needs a temporal filter; expected --temporal taa or varianceblend"),
        ({"aovs": ("effective",)}, "AOV effective: needs a temporal filter; expected --temporal taa or varianceblend"),
        (
            {"aovs": ("beta",), "temporal": "taa", "stereo_blend": "samples"},
            "AOV beta: needs a stereo blend of images; expected --stereo-blend constant or varianceblend",
        ),
        ({"aovs": ("Z",), "temporal": "taa"}, "AOV Z: method samplecache has none; it has visible, age"),
    ],
)
def test_wrong_arguments(stages, options, message):
    with pytest.raises(SettingError) as caught:
        renderer(**options)
    assert str(caught.value) == message


def test_a_frame_that_was_broken_off_is_no_history(monkeypatch):
    """The eye that was through already would have it in its history, the other not."""
    scene = load_scene(Path(__file__).parents[2] / "data" / "spinning" / "scene.toml")

    def renderer():
        options = {"size": (16, 12), "stereo": True, "spp": 1, "temporal": "taa", "aovs": ("effective",)}
        return Renderer(scene, **options)

    broken, begun_anew = renderer(), renderer()
    frames = broken.frames(0, 6)
    next(frames), next(frames)
    run = broken._temporal_graph.run

    def stop_in_the_right_eye(*args, eye, **options):
        if eye == "right":
            raise KeyboardInterrupt
        return run(*args, eye=eye, **options)

    monkeypatch.setattr(broken._temporal_graph, "run", stop_in_the_right_eye)
    with pytest.raises(KeyboardInterrupt):
        next(frames)
    monkeypatch.undo()
    for ours, expected in zip(broken.frames(2, 5), begun_anew.frames(2, 5), strict=True):
        for eye in ("left", "right"):
            np.testing.assert_array_equal(ours.color[eye], expected.color[eye])
            np.testing.assert_array_equal(ours.aov("effective", eye), expected.aov("effective", eye))
