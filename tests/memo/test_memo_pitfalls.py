"""Bugs that published hash caches have, looked for in the caches of graphs. Those that a table has by itself are in test_memo_table.py, those
of keys (the missing level, reserved values, coordinates without bounds) in test_memo_keys.py."""

import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from cache_renders import along, at, one_device
from memo_model import DEAD, EMPTY, NONE, hash_of, pcg_hash, remapped
from memo_on_device import ACCESS, FIND, LOCK, PUBLISH, OnDevice
from memo_renders import assert_same, counters, frames, painted, renderer, yard
from render_helpers import view

import clcache
from clcache import SettingError
from clcache.output.state import STATE_FILE
from clcache.scene.model import Track

sys.path.append(str(Path(clcache.__file__).parents[1] / "tools"))
from memo_false_hits import NUMBERS, Keys, false_pairs, recorded, rows_of  # noqa: E402


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def test_a_hole_before_an_entry_does_not_hide_it(device):
    """A and B in one range; A dies, as a twin does; B is found, and inserted again it is still one B."""
    table = OnDevice(device, 8, 4, "lru-frame")
    a, b = (0, 10, 1, 0, 0), (0, 11, 1, 0, 0)
    # Twins of A at 0 and 1, B at 2; the one at 1 dies.
    table.run([(LOCK, *a), (LOCK, *a), (ACCESS, *b), (PUBLISH, *a[:-1], 0), (PUBLISH, *a[:-1], 1)])
    assert [r[0] for r in table.records[:4]] == [10, DEAD, 11, EMPTY]
    assert table.run([(FIND, *b), (ACCESS, *b), (LOCK, *b)]) == [2, 2, NONE]
    assert sorted(table.keys) == [10, 11]
    assert table.run([(ACCESS, 0, 12, 1, 0, 0), (FIND, 0, 12, 1, 0, 0), (FIND, *b)]) == [NONE, 1, 2]


@pytest.mark.parametrize("memo", ["texel", "tile"])
def test_who_finds_nothing_gets_what_the_graph_computes(memo):
    """Not black: with a table that can hold one entry, which others take away all the time, and one that takes nothing more."""
    scene = yard(painted("waves"))
    expected = frames(scene, memo)
    for eviction in ("lru-frame", "none"):
        assert_same(frames(scene, memo, capacity=1, eviction=eviction, layout="entry"), expected)


CHANGED = [
    {"memo.eviction": "none"},
    {"memo.bias": 1.0},
    {"memo.capacity": 4096},
    {"memo.precision": "half"},
    {"memo.read": "key"},
    {"memo.auto": True},
]


@pytest.mark.parametrize("changed", CHANGED, ids=str)
def test_a_table_of_other_settings_is_refused(changed, tmp_path):
    """By what goes on with a saved state, and by a warm start; of the same settings both take it."""
    scene, options = yard(painted("waves")), {"capacity": 1000}
    first = renderer(scene, "texel", **options)
    list(first.frames(0, 1))
    first.save(tmp_path / STATE_FILE)
    name = next(iter(changed))
    for go_on in ("restore", "warm_start"):
        with pytest.raises(SettingError, match=name):
            getattr(renderer(scene, "texel", **options, settings=changed), go_on)(tmp_path)
        other = renderer(scene, "texel", **options)
        getattr(other, go_on)(tmp_path)
        assert counters(next(other.frames(1, 2)))["hits"] > 0


def test_a_table_of_another_scene_is_refused(tmp_path):
    """Though it only has another graph."""
    first = renderer(yard(painted("waves")), "texel", capacity=1000)
    list(first.frames(0, 1))
    first.save(tmp_path / STATE_FILE)
    with pytest.raises(SettingError, match="content of the scene"):
        renderer(yard(painted("stripes")), "texel", capacity=1000).warm_start(tmp_path)


def test_renderers_on_a_device_share_no_table():
    """Taking turns, each shows and counts what it does alone."""
    scene, options = yard(painted("waves")), [{}, {"bias": -2.0}]
    alone = [frames(scene, "texel", capacity=500, **o) for o in options]
    together = [renderer(scene, "texel", capacity=500, **o) for o in options]
    for number in range(2):
        for of, expected in zip(together, alone, strict=True):
            (frame,) = of.frames(number, number + 1)
            assert_same([frame], [expected[number]])
            assert counters(frame)["lookups"] == counters(expected[number])["lookups"]
            if of.device.threads == 1:
                assert counters(frame) == counters(expected[number])


def test_looking_away_and_back():
    """What was kept is found again, and images are those of a cache that was never asked for anything else."""
    scene = yard(painted("waves"))
    there, away = scene.camera, view((0.4, 2.5, 3.5), (9, 9, 9))
    options = {"settings": {"pathtrace.bounces": 0}}
    found = frames(along(scene, [there, away, away, there]), "texel", count=4, **options)
    alone = frames(along(scene, [away, away, away, there]), "texel", count=4, **options)
    assert counters(found[1])["lookups"] == counters(found[2])["lookups"] == 0
    assert_same(found[3:], alone[3:])
    assert counters(found[3])["inserted"] < 0.5 * counters(alone[3])["inserted"]


def test_the_cache_does_not_care_where_instances_are():
    """Keys are of texture coordinates and of places within the object: what moves takes its texels along."""
    scene = replace(yard(painted("waves"), painted("stripes")), camera=view((0, 5, 0.01), (0, 0, 0)))
    still, size = np.tile([0, 0, 0, 1.0], (3, 1)), np.ones((3, 3))
    moving = Track(np.arange(3.0), np.array([[0, 0.8, 0], [0.5, 0.8, 0], [0.5, 0.8, 0.3]]), still, size, step=True)
    scene = replace(scene, instances=(replace(scene.instances[1], transform=at((0, 0, 0)), motion=(moving,)),))
    scene = replace(scene, defaults=replace(scene.defaults, fps=1.0))
    found = frames(scene, "texel", count=3, bias=-2.0, size=(96, 64), settings={"pathtrace.bounces": 0})
    assert counters(found[0])["inserted"] > 50
    for frame in found[1:]:
        assert counters(frame)["inserted"] < 0.5 * counters(found[0])["inserted"]


def test_frame_counters_at_their_end():
    """Of updates around 2^31, of which each has two stamps, and around 2^32: the same images, and the same evictions."""
    scene, options = yard(painted("waves")), {"capacity": 100, "eviction": "lru-frame", "stereo": True}
    usual = frames(scene, "texel", count=4, **options)
    for first in (2**31 - 2, 2**32 - 2):
        of = renderer(scene, "texel", **options)
        of._updates = dict.fromkeys(of.eyes, first)
        late = list(of.frames(0, 4))
        assert_same(late, usual)
        if of.device.threads == 1:
            assert [counters(f, e) for f in late for e in f.color] == [counters(f, e) for f in usual for e in f.color]


# False hits of 32-bit check hashes


def test_keys_of_a_scene_are_told_apart_as_independent_hashes_would():
    """The whole keys of all hits, recorded: as many as the table got entries. Their hashes are those of the model; cut to a few bits, as many
    pairs are alike as are to be expected, and in full none."""
    keys = Keys()
    with recorded(keys):
        found = frames(yard(painted("waves"), painted("stripes")), "texel", size=(96, 64), bias=2.0)
    assert keys.lookups == sum(counters(f)["lookups"] for f in found)
    n = len(keys.rows)
    assert n == counters(found[-1])["occupied"] > 5000
    numbers = keys.rows[:, :NUMBERS].view(np.int32).astype(np.int64)
    for graph, columns in ((0, (2, 3, 4)), (1, (5, 6, 7, 8))):
        own = numbers[:, 0] == graph
        assert own.sum() > 500
        for column, seed, finish in ((NUMBERS, graph, np.asarray), (NUMBERS + 1, ~graph % 2**32, remapped)):
            expected = finish(hash_of([numbers[own, c] for c in columns], pcg_hash(seed)))
            np.testing.assert_array_equal(keys.rows[own, column], expected)
    for bits, pairs, expected, false, expected_false in rows_of(keys, [32, 12, 8], 4096, 64):
        for counted, mean in ((int(pairs), float(expected)), (int(false), float(expected_false))):
            assert abs(counted - mean) <= 5 * np.sqrt(mean) + 1, bits


def test_false_hits_are_pairs_of_one_hash_less_than_a_range_apart():
    rng = np.random.default_rng(1)
    check, place = rng.integers(3, 20, 300).astype(np.uint32), rng.integers(0, 200, 300).astype(np.uint32)
    alike = [(a, b) for a, b in combinations(range(300), 2) if check[a] == check[b]]
    near = [pair for pair in alike if abs(int(place[pair[0]]) - int(place[pair[1]])) < 8]
    assert false_pairs(check, place, 8) == (len(alike), len(near))


@pytest.mark.parametrize("memo", ["texel", "tile"])
@pytest.mark.parametrize("local_size", [1, 7, 64])
def test_work_groups_that_are_smaller_or_larger_than_runs(memo, local_size):
    """Behind the last path that is alive nothing is asked for, wherever work-groups end."""
    scene = yard(painted("waves"))
    expected, found = (frames(scene, memo, settings=s) for s in ({}, {"device.local_size": local_size}))
    assert_same(found, expected)
    assert counters(found[1])["lookups"] == counters(expected[1])["lookups"]
