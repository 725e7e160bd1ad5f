"""Renders that go on from a saved state with what is known of graphs in it: what was decided, by which costs and hits, and the values."""

import json

import numpy as np
import pytest
from cache_renders import one_device
from memo_renders import assert_same, counters, painted, renderer, yard

from clcache.memo import Costs
from clcache.output.state import STATE_FILE, write_state

# A lookup takes 0.85 of the evaluation, an insertion ten times as long: worth it if all hit.
WORTH_IT, NOT_WORTH_IT = Costs(1e-6, 8.5e-7, 1e-5), Costs(1e-8, 1e-7, 1e-7)
COUNT = 6  # frames; hit rates are looked at after the fourth


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def with_costs(monkeypatch, *costs):
    """What graphs cost from now on, for whoever measures."""
    monkeypatch.setattr("clcache.passes.materials._measure", lambda setup, arrays: list(costs))


def memoized(of):
    return [entry["memoized"] for entry in of.stats()["memo"]["materials"]]


@pytest.mark.parametrize("used", [0, 1, 5], ids="after {} frames".format)
@pytest.mark.parametrize("options", [{}, {"method": "samplecache", "stereo": True}], ids=["pathtrace", "samplecache"])
def test_who_goes_on_decides_alike(monkeypatch, tmp_path, used, options):
    """A renderer that has rendered frames already, by costs that spoke against memoization: it shows and counts what the one that saved the
    state does, which gives up one of the graphs on the way; and reports the same."""
    scene = yard(painted("waves"), painted("expensive"))
    options = {"memo": "texel", "auto": True, "size": (48, 32)} | options
    with_costs(monkeypatch, WORTH_IT, Costs(1e-5, 1e-7, 1e-7))
    first = renderer(scene, **options)
    list(first.frames(0, 2))
    first.save(tmp_path / STATE_FILE)
    expected = list(first.frames(2, COUNT))
    assert memoized(first) == [False, True]
    with_costs(monkeypatch, NOT_WORTH_IT, NOT_WORTH_IT)
    second = renderer(scene, **options)
    if used:
        list(second.frames(0, used))
        assert memoized(second) == [False, False]
    assert second.restore(tmp_path) == 1
    found = list(second.frames(2, COUNT))
    assert_same(found, expected)
    for one, other in zip(*(of.stats()["memo"]["materials"] for of in (second, first)), strict=True):
        assert (one["materials"], one["why"], one["break_even"]) == (
            other["materials"],
            other["why"],
            other["break_even"],
        )
        assert one["hit_rate"] == pytest.approx(other["hit_rate"], abs=0.01)  # work-items that miss at once
    for one, other in zip(found, expected, strict=True):
        for eye in other.color:
            assert counters(one, eye)["lookups"] == counters(other, eye)["lookups"] > 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0, 1e300, 5e-324], ids=str)
def test_a_state_whose_numbers_are_nonsense(monkeypatch, tmp_path, value):
    """Renders go on, and report numbers."""
    with_costs(monkeypatch, WORTH_IT)
    scene, options = yard(painted("waves")), {"auto": True, "capacity": 300}
    first = renderer(scene, "texel", **options)
    list(first.frames(0, 2))
    first.save(tmp_path / STATE_FILE)
    with np.load(tmp_path / STATE_FILE) as saved:
        arrays = {name: saved[name] for name in saved.files}
    meta = json.loads(arrays.pop("meta").tobytes())
    (known,) = (name for name in arrays if name.endswith("memo_known"))
    arrays[known] = np.full_like(arrays[known], value)
    write_state(tmp_path / STATE_FILE, meta, arrays.items())
    second = renderer(scene, "texel", **options)
    second.restore(tmp_path)
    for frame in second.frames(2, 9):
        assert np.isfinite(frame.color["mono"]).all()
    json.dumps(second.stats()["memo"], allow_nan=False)
