"""What the renderer makes of memoization: its settings, its counters, what it reports, and when frames depend on it.

The method here computes nothing that is worth seeing; its counters are numbers that tell runs and frames apart.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from fake_method import SIZE, Fake, Step, put
from graph_materials import by_graph
from render_helpers import everything

from clcache import Renderer, SettingError
from clcache import settings as table
from clcache.frame import Buffer
from clcache.methods import METHODS
from clcache.output.state import STATE_FILE
from clcache.passes.materials import COUNTERS, LEVELS
from clcache.settings import MEMOS, SETTINGS


class Remembering(Fake):
    """Counts 1, 2, 3, ... in each run, and 1000 times the run's number more. seen: what `observe` was given."""

    runs = 0

    def __call__(self, setup):
        self.setup, self.seen = setup, []
        own = super().__call__(setup)
        if setup.memo == "off":
            return own
        counters, variance = Buffer("memo_counters", (len(COUNTERS),), "u4"), Buffer("aov_variance", (6, 3))
        buffers = (*own.buffers, counters, variance, Buffer("table", (5,), persistent=True))
        look_up = Step("look up", ("table",), ("memo_counters", "table", "aov_variance"), self.look_up)
        return replace(own, passes=(*own.passes, look_up), buffers=buffers, cache=(*own.cache, "table"), memo=self)

    def look_up(self, arrays, state):
        self.runs += 1
        put(arrays["memo_counters"], np.arange(1, len(COUNTERS) + 1) + 1000 * self.runs)

    def observe(self, arrays):
        self.seen.append(int(arrays["memo_counters"].get()[0]))

    def report(self):
        return [{"materials": ["wood"], "frames": len(self.seen)}]


@pytest.fixture
def method(monkeypatch):
    found = Remembering()
    for name in ("pathtrace", "samplecache"):
        monkeypatch.setitem(METHODS, name, found)
    return found


def renderer(method="samplecache", **options):
    return Renderer(everything(), method, **{"size": SIZE, "stereo": True, "memo": "texel"} | options)


def counted(runs):
    """What is counted in runs of these numbers."""
    each = np.arange(1, len(COUNTERS) + 1) + 1000 * np.array(runs)[:, None]
    return {
        name: int(each[-1, k] if name in LEVELS else each[:, k].sum()) for k, name in enumerate(COUNTERS)
    }  # fmt: skip


@pytest.mark.parametrize("memo", [m for m in MEMOS if m != "off"])
def test_each_eye_has_the_counters_of_its_own_runs(method, memo):
    of = renderer(memo=memo, spp=2)
    frames = [frame.stats["eyes"] for frame in of.frames(0, 2)]
    assert method.setup.memo == memo
    for number, eyes in enumerate(frames):
        for index, eye in enumerate(("left", "right")):
            first = 4 * number + 2 * index + 1
            assert eyes[eye]["memo"] == counted([first, first + 1])


def test_counters_of_the_method_come_before_those_of_the_memo(method):
    eyes = next(renderer().frames(0, 1)).stats["eyes"]["left"]
    assert eyes["cache"] == eyes["memo"] | {"occupied": 100, "created": 20, "retraced": 0}
    assert eyes["memo"]["occupied"] == counted([1])["occupied"] != 100


def test_the_memo_sees_each_frame_once_and_its_report_is_in_the_statistics(method):
    of = renderer("pathtrace", memo="tile", spp=3)
    assert of.stats()["memo"] == {"kind": "tile", "materials": [{"materials": ["wood"], "frames": 0}]}
    list(of.frames(0, 3))
    assert method.seen == [2001, 4001, 6001]  # after the last eye
    stats = json.loads(json.dumps(of.stats()))
    assert stats["memo"] == {"kind": "tile", "materials": [{"materials": ["wood"], "frames": 3}]}
    assert stats["memory"]["cache"] == 4 * (4 * 6 + 5)  # histories of two eyes, and the table


def test_rounds_of_samples_are_counted_together(method, monkeypatch):
    errors = iter([0.5, 0.2, 0.01])
    monkeypatch.setattr("clcache.renderer._estimated_relmse", lambda *_: next(errors))
    of = renderer("pathtrace", stereo=False, until_relmse=0.05, aovs=())
    eye = next(of.frames(0, 1)).stats["eyes"]["mono"]
    assert eye["memo"] == counted([1, 2, 3])


def test_off_is_the_default_and_counts_nothing(method):
    of = renderer(memo=None)
    eye = next(of.frames(0, 1)).stats["eyes"]["left"]
    assert method.setup.memo == of.memo == "off"
    assert "memo" not in eye and "lookups" not in eye["cache"]
    assert of.stats()["memo"] == {"kind": "off", "materials": []}


@pytest.mark.parametrize("memo", MEMOS)
def test_a_scene_without_graphs_is_as_it_was(memo):
    """Nothing of it is there, in any form."""
    of = Renderer(everything(), "pathtrace", size=SIZE, memo=memo, spp=1)
    frame = next(of.frames(0, 1))
    plain = next(Renderer(everything(), "pathtrace", size=SIZE, spp=1).frames(0, 1))
    np.testing.assert_array_equal(frame.color["mono"], plain.color["mono"])
    assert frame.stats["eyes"]["mono"]["passes"].keys() == plain.stats["eyes"]["mono"]["passes"].keys()
    assert of.stats()["memory"]["cache"] == 0 and not of.has_state


@pytest.mark.parametrize(
    ("memo", "settings", "depends"),
    [
        ("off", {}, False),
        ("texel", {}, True),
        ("texel", {"memo.auto": False}, False),
        ("texel", {"memo.auto": False, "memo.snap": False}, True),
        ("tile", {}, True),
        ("tile", {"memo.auto": False, "memo.snap": False}, False),
    ],
)
def test_frames_depend_on_those_before_where_what_is_kept_shows(method, memo, settings, depends):
    """By decisions from times, or by values from wherever the first hit was."""
    assert renderer("pathtrace", memo=memo, settings=settings).has_state == depends
    assert renderer("samplecache", memo=memo, settings=settings).has_state


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"memo": "tile"}, "memo is texel there and tile here"),
        ({"memo": "off"}, "memo is texel there and off here"),
        ({"settings": {"memo.capacity": 9}}, "settings memo.capacity is 0 there and 9 here"),
        ({"settings": {"memo.snap": False}}, "settings memo.snap is True there and False here"),
    ],
)
def test_the_state_of_another_memo_is_refused(method, tmp_path, options, message):
    of = renderer()
    list(of.frames(0, 1))
    of.save(tmp_path / STATE_FILE)
    assert renderer().restore(tmp_path) == 0
    with pytest.raises(SettingError, match=message):
        renderer(**options).restore(tmp_path)


def test_the_table_goes_into_the_state(method, tmp_path):
    of = renderer()
    list(of.frames(0, 1))
    put(of._graph.of("left")["table"], 7.5)
    of.save(tmp_path / STATE_FILE)
    other = renderer()
    other.restore(tmp_path)
    np.testing.assert_array_equal(other._graph.of("right")["table"].get(), np.full(5, 7.5))


# With graphs


def painted():
    """A floor and things on it, most of them by graph."""
    scene = everything()
    return replace(scene, materials=(by_graph("base_color"), by_graph("base_color", scale=2.0), *scene.materials[2:]))


def of_graphs(**options):
    options = {"size": (24, 16), "spp": 2, "memo": "texel", "settings": {"memo.auto": False}} | options
    return Renderer(painted(), "pathtrace", **options)


def test_a_render_with_a_memo_says_what_it_kept():
    of = of_graphs()
    first, second = (frame.stats["eyes"]["mono"] for frame in of.frames(0, 2))
    stats = json.loads(json.dumps(of.stats()))
    for eye in (first, second):
        assert eye["memo"].keys() == set(COUNTERS) and eye["cache"] == eye["memo"]
        assert 0 < eye["memo"]["occupied"] <= eye["memo"]["capacity"] == 2**21
    assert first["memo"]["inserted"] == first["memo"]["occupied"] > 0
    # Two threads may insert the same key, of which one entry stays.
    assert second["memo"]["hits"] > second["memo"]["inserted"] >= second["memo"]["occupied"] - first["memo"]["occupied"]
    assert [graph["memoized"] for graph in stats["memo"]["materials"]] == [True, True]
    assert stats["memory"]["cache"] >= 2**21 * 4 and stats["seconds"]["graphs"] > 0
    assert stats["features"]["HAS_GRAPHS"]


def test_without_a_memo_there_is_none():
    of = of_graphs(memo=None)
    eye = next(of.frames(0, 1)).stats["eyes"]["mono"]
    assert "memo" not in eye and eye["cache"] == {} and of.stats()["memory"]["cache"] == 0


@pytest.mark.parametrize(("memo", "layout"), [("texel", "buffer"), ("tile", "entry"), ("tile", "image2d")])
def test_a_render_goes_on_with_what_it_had_kept(tmp_path, device, memo, layout):
    """The frames are the same, and what was kept is found again."""
    if "image" in layout and not device.capabilities.images:
        pytest.skip("the device has no images")
    options = {"memo": memo, "temporal": "taa", "settings": {"memo.auto": False, "memo.layout": layout}}
    whole = of_graphs(**options)
    frames = list(whole.frames(0, 4))
    cut = of_graphs(**options)
    list(cut.frames(0, 2))
    cut.save(tmp_path / STATE_FILE)
    resumed = of_graphs(**options)
    resumed.restore(tmp_path)
    for frame, expected in zip(resumed.frames(2, 4), frames[2:], strict=True):
        np.testing.assert_array_equal(frame.color["mono"], expected.color["mono"])
        memo, wanted = (f.stats["eyes"]["mono"]["memo"] for f in (frame, expected))
        assert memo["lookups"] == wanted["lookups"] and memo["hits"] > memo["inserted"]
        # Two threads may miss the same key at once.
        assert abs(memo["hits"] - wanted["hits"]) <= 0.01 * wanted["lookups"]
    cold = next(of_graphs(**options).frames(2, 3)).stats["eyes"]["mono"]["memo"]
    assert cold["inserted"] > frames[2].stats["eyes"]["mono"]["memo"]["inserted"]


def test_another_render_begins_with_what_was_kept(tmp_path):
    """Of another size, and from pathtrace, which keeps nothing else."""
    first = of_graphs()
    list(first.frames(0, 2))
    first.save(tmp_path / STATE_FILE)
    warm, cold = of_graphs(size=(20, 14)), of_graphs(size=(20, 14))
    warm.warm_start(tmp_path)
    color, memo = {}, {}
    for name, of in (("warm", warm), ("cold", cold)):
        frame = next(of.frames(5, 6))
        color[name], memo[name] = frame.color["mono"], frame.stats["eyes"]["mono"]["memo"]
    assert memo["warm"]["inserted"] < memo["cold"]["inserted"]
    np.testing.assert_array_equal(color["warm"], color["cold"])
    with pytest.raises(SettingError, match="memo is texel there and tile here"):
        of_graphs(memo="tile").warm_start(tmp_path)
    with pytest.raises(SettingError, match="method pathtrace keeps nothing"):
        of_graphs(memo="off").warm_start(tmp_path)


@pytest.mark.parametrize(
    ("name", "default", "good", "bad"),
    [
        ("memo.capacity", 0, ("0", "268435456"), ("-1", "268435457", "many")),
        ("memo.probe", 8, ("1", "64"), ("0", "65")),
        ("memo.eviction", "lru-frame", ("none", "random", "lrw-frame", "lrw-counter", "lru-counter"), ("fifo",)),
        ("memo.tile", "4x4", ("2x2", "3x3", "5x5", "6x5", "8x4"), ("4", "1x1", "4x8")),
        ("memo.filter", "nearest", ("bilinear",), ("trilinear",)),
        ("memo.snap", True, ("false",), ("maybe",)),
        ("memo.bias", 0.0, ("-4", "4"), ("-4.1", "4.1", "nan")),
        ("memo.primary", True, ("off",), ("2",)),
        ("memo.precision", "float", ("half",), ("double",)),
        ("memo.auto", True, ("false",), ("",)),
        ("memo.read", "counter", ("key",), ("lock",)),
        ("memo.layout", "buffer", ("entry", "image2d", "image3d"), ("image",)),
        ("memo.builder", "serial", ("lanes",), ("parallel",)),
        ("memo.grouped", False, ("true",), ("x",)),
        ("memo.passes", "1", ("2", "4", "prepass2", "prepass4", "prepass8"), ("3", "prepass")),
    ],
)
def test_settings(name, default, good, bad):
    assert SETTINGS[name].default == default and type(SETTINGS[name].default) is type(default)
    for text in good:
        assert table.resolve({name: text})[name] is not None
    for text in bad:
        with pytest.raises(SettingError, match=f"setting {name}: '{text}' is not an? .* in range; expected "):
            table.resolve({name: text})
