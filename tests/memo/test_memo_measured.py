"""What graphs cost is measured in the cache that the frames then use: they find nothing there that they did not put there."""

import math
from pathlib import Path

import numpy as np
import pytest

from clcache import Renderer, load_scene

GRAPHS = Path(__file__).parents[2] / "data" / "graphs" / "scene.toml"


@pytest.fixture(scope="module")
def scene():
    return load_scene(GRAPHS)


@pytest.mark.parametrize("memo", ["texel", "tile"])
@pytest.mark.parametrize("eviction", ["lru-frame", "lru-counter"])
def test_measuring_leaves_the_cache_empty(scene, device_spec, monkeypatch, memo, eviction):
    monkeypatch.setattr("clcache.memo.MOST_RATIO", math.inf)  # so that all is memoized that can be
    frames, reports = {}, {}
    for auto in (True, False):
        settings = {"memo.auto": auto, "memo.eviction": eviction}
        renderer = Renderer(scene, size=(64, 36), stereo=False, spp=1, memo=memo, settings=settings, device=device_spec)
        frames[auto] = next(renderer.frames(0, 1))
        reports[auto] = renderer.stats()["memo"]["materials"]
    np.testing.assert_array_equal(frames[True].color["mono"], frames[False].color["mono"])
    measured, other = (frames[auto].stats["eyes"]["mono"]["memo"] for auto in (True, False))
    assert measured["lookups"] == other["lookups"] > 0
    for name in ("inserted", "occupied", "built"):  # two threads may miss the same key at once
        assert measured[name] == pytest.approx(other[name], rel=0.02) and measured[name] > 100
    assert all(r["evaluate_ns"] > 0 for r in reports[True]) and not any("evaluate_ns" in r for r in reports[False])
    memoized = [r for r in reports[True] if r["memoized"]]
    assert memoized and all(r["look_up_ns"] > 0 for r in memoized)
