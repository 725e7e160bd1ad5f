"""The benchmark of the memoization: that what it times is what it says, and what it makes of Eq. 2.17."""

import numpy as np
import pytest

from clcache.bench import Job
from clcache.bench.memo import (
    HIT_RATES,
    VARIANTS,
    Cache,
    _write_scene,
    break_even_cost,
    expected,
    hits_of_square,
    memo,
    shuffled,
)
from clcache.device import Device
from clcache.memo import Costs
from clcache.resources import SceneResources
from clcache.scene import load_scene

SIZE = (32, 16)
N = SIZE[0] * SIZE[1]


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """The scene, its resources, and a device."""
    scene, device = load_scene(_write_scene(tmp_path_factory.mktemp("noise"))), Device()
    return scene, SceneResources(device, scene), device


@pytest.fixture(scope="module")
def results():
    return list(memo(Job(("memo",), None, None, 2, SIZE)))


def test_each_hit_has_a_texel_of_its_own(own):
    scene, resources, device = own
    cache = Cache(resources, device, "texel", {"memo.capacity": 64 * N}, N)
    hits = hits_of_square(scene, SIZE)
    cache.look_up(hits)
    counted = cache.counters()
    assert (counted["lookups"], counted["hits"], counted["inserted"], counted["evicted"]) == (N, 0, N, 0)
    cache.look_up(shuffled(hits, np.random.default_rng(5).permutation(N)))
    assert (cache.counters()["lookups"], cache.counters()["hits"]) == (N, N)
    cache.empty()
    cache.look_up(hits)
    assert cache.counters()["hits"] == 0
    cache.release()


def test_hits_lie_where_their_pixels_do(own):
    """The first graph's colour is the texture coordinates: those of points in the texels, block by block."""
    scene, resources, device = own
    cache = Cache(resources, device, "texel", {}, N)
    cache.look_up(hits_of_square(scene, SIZE))
    u, v, _ = cache.values()
    cache.release()
    column, row = np.floor(64 * u).tolist(), np.floor(64 * v).tolist()
    assert column[:4] == [1, 2, 3, 4] and row[:8] == [1] * 4 + [2] * 4
    assert column[16] == 5 and row[16] == 1
    assert len({*zip(u.tolist(), v.tolist(), strict=True)}) == N


def test_replacements_find_nothing(own):
    scene, resources, device = own
    cache = Cache(resources, device, "texel", {"memo.capacity": N // 8}, N)
    cache.look_up(hits_of_square(scene, SIZE, finer=1))
    cache.look_up(hits_of_square(scene, SIZE))
    counted = cache.counters()
    assert counted["hits"] == 0
    assert counted["evicted"] == N
    cache.release()


def test_all_variants_are_measured(results):
    named = {r.name: r for r in results if not r.scene and r.items == N}
    whats = ("insertions", "hits in order", "hits shuffled", "replacements")
    assert {*named} <= {f"{name}, {what}" for name in VARIANTS for what in whats}
    assert {f"{name}, {what}" for name in ("texel", "texel half", "tile", "tile bilinear") for what in whats} <= {
        *named
    }
    assert all(len(r.seconds) == 2 and r.items == N and min(r.seconds) > 0 for r in named.values())


def test_frames_and_what_the_equation_expects_of_them(results):
    named = {r.name: r for r in results if r.scene}
    assert {r.scene for r in named.values()} == {"noise"}
    for kind in ("off", "texel", "tile"):
        frames, materials = named[f"{kind}, whole frame"], named[f"{kind}, materials"]
        assert len(frames.seconds) == len(materials.seconds) == 2
        assert all(m < f for m, f in zip(materials.seconds, frames.seconds, strict=True))
    for kind in ("texel", "tile"):
        assert len(named[f"{kind}, materials by Eq. 2.17"].seconds) == 2
    assert len([name for name in named if name.startswith("evaluation of ")]) == 4


def test_what_evaluation_must_cost_grows_as_hits_get_fewer(results):
    for kind, rates in (("texel", HIT_RATES), ("tile", HIT_RATES[-2:])):
        costs = [
            next(r for r in results if r.name == f"{kind}, break-even at {rate:.1%} hits").median for rate in rates
        ]
        lookup = next(r for r in results if r.name == f"{kind}, lookup")
        assert sorted(costs, reverse=True) == costs
        assert costs[-1] > 0.9 * lookup.median > 0


def test_scenes_without_graphs_have_no_frames(tmp_path, monkeypatch):
    monkeypatch.setattr("clcache.bench.memo.VARIANTS", {})
    file = tmp_path / "plain.toml"
    file.write_text('[meshes.a]\ngenerator = "plane"\nsize = [1, 1]\n[[instances]]\nmesh = "a"\n')
    assert list(memo(Job(("memo",), None, None, 2, SIZE, (str(file),)))) == []


@pytest.mark.parametrize("rate", HIT_RATES)
@pytest.mark.parametrize("built", [1, 16])
def test_memoization_is_worth_nothing_at_the_break_even_cost(rate, built):
    cost = break_even_cost(30e-9, 200e-9, built, rate)
    if built * (1 - rate) < 1:
        assert Costs(cost, 30e-9, 200e-9, built).ratio(rate) == pytest.approx(1)
        assert Costs(1.1 * cost, 30e-9, 200e-9, built).ratio(rate) < 1
    else:
        assert cost == np.inf


def test_frames_by_the_equation():
    """1000 lookups of which 900 hit: each takes 30 ns, and each of the others 200 ns for evaluation and 100 ns for insertion besides."""
    costs = [Costs(1e-9, 30e-9, 100e-9)]
    assert expected(1000 * 200e-9, 1000, 900, costs) == pytest.approx(1000 * 30e-9 + 100 * 300e-9)
    assert expected(1e-3, 0, 0, costs) == 1e-3
