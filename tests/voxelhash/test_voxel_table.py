"""The table of voxels (`cl/voxelhash/table.cl`) against a model of it: one work-item by any sequence of accesses, and many at once."""

import numpy as np
import pyopencl.array as cl_array
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from voxelhash_model import BLOCK, NONE, WORDS, Table
from voxelhash_on_device import FIND, INSERT, OnDevice, table_program


@pytest.fixture(scope="module")
def kernels(device, tmp_path_factory):
    return device, table_program(device, tmp_path_factory.mktemp("table"))


def in_turn_by_model(table, operations):
    entries, outcomes = [], []
    for what, place, check, stamp in operations:
        entry, outcome = table.insert(place, check, stamp) if what else (table.find(place, check, stamp), "hit")
        entries.append(entry)
        outcomes.append(outcome)
    return entries, outcomes


def assert_no_key_twice(keys, capacity, probe, place_of):
    """No check hash stands twice, and each where a search from its place finds it."""
    checks = [int(key) >> 32 for key in keys if key]
    assert len(checks) == len(set(checks))
    table = Table(capacity, probe, WORDS // 2 - 1, [(int(k) >> 32, int(k) % WORDS) if k else None for k in keys])
    for entry, key in enumerate(keys):
        if key:
            assert table.find(place_of[int(key) >> 32], int(key) >> 32, int(key) % WORDS) == entry


# One work-item


@st.composite
def accesses(draw):
    capacity = draw(st.sampled_from([1, 2, 7, 16, 17, 33, 64, 100]))
    probe = draw(st.sampled_from([1, 2, 3, 8, 64]))
    lifetime = draw(st.sampled_from([0, 1, 2, 6, 128]))
    stamp = draw(st.sampled_from([1, 100, WORDS - 3, WORDS - 20, WORDS // 2 - 4]))
    # Few places of which some are the last, and few keys for each: chains, ends and wrapping are common.
    places = draw(st.lists(st.sampled_from([0, capacity // 2, capacity - 1]), min_size=1, max_size=3))
    keys = [
        (places[k % len(places)], draw(st.sampled_from([1, 2, 3, WORDS - 1])) if k == 0 else 10 + k) for k in range(12)
    ]
    operations = []
    for _ in range(draw(st.integers(1, 60))):
        stamp = (stamp + draw(st.sampled_from([0, 0, 0, 1, 2, 5, -1, -3]))) % WORDS
        operations.append((draw(st.sampled_from([FIND, INSERT, INSERT])), *draw(st.sampled_from(keys)), stamp))
    return capacity, probe, lifetime, operations


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(accesses())
def test_any_sequence_of_accesses_is_the_models(kernels, sequence):
    capacity, probe, lifetime, operations = sequence
    ours, model = OnDevice(*kernels, capacity, probe, lifetime), Table(capacity, probe, lifetime)
    assert ours.in_turn(operations) == in_turn_by_model(model, operations)
    np.testing.assert_array_equal(ours.keys, model.keys())
    assert_no_key_twice(ours.keys, capacity, probe, {check: place for _, place, check, _ in operations})


@pytest.mark.parametrize("capacity", [1, 7, 16, 64, 1000])
def test_a_full_table_finds_all_that_it_holds_and_takes_nothing_more(kernels, capacity):
    probe = -(-capacity // BLOCK) + 64
    table = OnDevice(*kernels, capacity, probe, 10)
    fill = [(INSERT, i, 1000 + i, 5) for i in range(capacity)]
    entries, outcomes = table.in_turn(fill)
    assert sorted(entries) == list(range(capacity)) and set(outcomes) == {"inserted"}
    places = [0, capacity // 3, capacity - 1]
    assert table.in_turn([(INSERT, p, 7 + p, 6) for p in places]) == ([NONE] * 3, ["discarded"] * 3)
    assert table.in_turn([(FIND, p, 7 + p, 6) for p in places])[0] == [NONE] * 3
    assert table.in_turn([(FIND, *row[1:]) for row in fill])[0] == entries


@pytest.mark.parametrize(("capacity", "probe"), [(1, 64), (7, 64), (16, 8), (33, 8), (64, 64)])
def test_a_search_that_begins_at_the_last_place_stays_inside(kernels, capacity, probe):
    """Behind the table's end stand words that say so if they are read or written."""
    device, _ = kernels
    whole = device.upload(np.concatenate([np.zeros(capacity, np.uint64), np.full(256, (99 << 32) + 5, np.uint64)]))
    guarded = OnDevice(*kernels, capacity, probe, 10)
    guarded.array = cl_array.Array(device.queue, (capacity,), np.uint64, data=whole.base_data)
    entries, _ = guarded.in_turn([(INSERT, capacity - 1, 1 + i, 5) for i in range(80)])
    reached = len({(capacity - 1 + BLOCK * k) % capacity for k in range(probe)})
    assert [e != NONE for e in entries] == [i < reached for i in range(80)]
    assert guarded.in_turn([(FIND, capacity - 1, 99, 5)])[0] == [NONE]
    assert (whole.get()[capacity:] == (99 << 32) + 5).all()


@pytest.mark.parametrize("born", [1, WORDS - 2, WORDS - 1, 0, WORDS // 2 - 1])
@pytest.mark.parametrize("lifetime", [0, 2, 128, 2**31 - 2])
def test_an_entry_dies_once_it_was_not_accessed_for_its_lifetime(kernels, born, lifetime):
    table = OnDevice(*kernels, 64, 8, lifetime)
    last, after = (born + lifetime) % WORDS, (born + lifetime + 1) % WORDS
    entries, outcomes = table.in_turn(
        [(INSERT, 3, 8, born), (FIND, 3, 8, last), (FIND, 3, 8, after), (INSERT, 3, 9, last)]
    )
    assert entries == [3, 3, NONE, 3 + BLOCK] and outcomes[3] == "inserted"
    assert table.in_turn([(INSERT, 3, 10, after)]) == ([3], ["evicted"])


def test_an_access_begins_the_lifetime_anew(kernels):
    table = OnDevice(*kernels, 64, 8, 4)
    assert table.in_turn([(INSERT, 3, 8, 4 * k + 1) for k in range(5)])[1] == ["inserted"] + ["hit"] * 4
    assert table.in_turn([(FIND, 3, 8, 21), (FIND, 3, 8, 22)])[0] == [3, NONE]


def test_looking_does_not_prolong_a_life(kernels):
    table = OnDevice(*kernels, 64, 8, 4)
    assert table.in_turn([(INSERT, 3, 8, 1), (FIND, 3, 8, 4), (FIND, 3, 8, 5), (FIND, 3, 8, 6)])[0] == [3, 3, 3, NONE]


def test_a_dead_entry_that_is_asked_for_again_keeps_its_place(kernels):
    """Its own, though one before it is free, too."""
    table = OnDevice(*kernels, 64, 8, 2)
    table.in_turn([(INSERT, 3, 8, 1), (INSERT, 3, 9, 1)])
    assert table.in_turn([(INSERT, 3, 9, 9), (INSERT, 3, 8, 9)]) == ([3 + BLOCK, 3], ["evicted"] * 2)


# Many at once


def keys_of(rng, count, capacity):
    """Different check hashes, each with a place of its own; half of them crowd into few."""
    check = rng.choice(2**31, count, replace=False).astype(np.uint32) + 1
    place = rng.integers(capacity, size=count).astype(np.uint32)
    place[: count // 2] %= min(capacity, 5)
    return place, check


@pytest.mark.parametrize(
    ("capacity", "count", "probe"), [(1, 3, 8), (7, 12, 64), (64, 100, 8), (1024, 700, 64), (1024, 3000, 8)]
)
@pytest.mark.parametrize("full", [False, True], ids=["empty", "dead"])
def test_many_insert_overlapping_sets(kernels, capacity, count, probe, full):
    """Each key gets one entry, and one work-item that made it; all others find that. Into an empty table, and one full of dead
    entries of which some are the keys' own."""
    rng = np.random.default_rng(capacity + count)
    place, check = keys_of(rng, count, capacity)
    place_of = dict(zip(check.tolist(), place.tolist(), strict=True))
    table = OnDevice(*kernels, capacity, probe, 2)
    before = {}
    if full:
        _, outcomes = table.at_once(np.ones(count), place, check, 1)
        old = np.array(keys_of(rng, count, capacity))
        table.at_once(np.ones(count), *old, 1)
        before = {int(key) >> 32 for key in table.keys}
        place_of |= dict(zip(old[1].tolist(), old[0].tolist(), strict=True))
    chosen = rng.integers(count, size=20000)
    entries, outcomes = (np.array(a) for a in table.at_once(np.ones(20000), place[chosen], check[chosen], 9))
    keys = table.keys
    assert_no_key_twice(keys, capacity, probe, place_of)
    there = entries != NONE
    assert (there == (outcomes != "discarded")).all()
    assert (keys[entries[there]] == (check[chosen[there]].astype(np.uint64) << np.uint64(32)) + np.uint64(9)).all()
    live = (keys & np.uint64(NONE)) == 9
    made = np.isin(outcomes, ("inserted", "evicted"))
    assert sorted(entries[made]) == np.flatnonzero(live).tolist(), "an entry has one maker"
    assert (outcomes == "evicted").any() == bool(before)
    for key in range(count):  # of a key all are found, or, where its range was full, none
        mine = entries[chosen == key]
        assert (mine == NONE).sum() in (0, len(mine)) and len(set(mine[mine != NONE])) <= 1


def test_who_looks_while_others_insert_finds_what_was_there_and_nothing_false(kernels):
    """Entries that live before are found by all; those that are being made by some, and never in a wrong place."""
    rng = np.random.default_rng(8)
    place, check = keys_of(rng, 400, 256)
    table = OnDevice(*kernels, 256, 16, 4)
    table.at_once(np.ones(150), place[250:], check[250:], 1)  # they die
    table.at_once(np.ones(100), place[:100], check[:100], 9)
    there = np.array(table.in_turn([(FIND, p, c, 9) for p, c in zip(place, check, strict=True)])[0])
    assert (there[:100] != NONE).sum() > 50
    for _ in range(5):
        chosen, what = rng.integers(300, size=20000), rng.integers(2, size=20000)
        entries = np.array(table.at_once(what, place[chosen], check[chosen], 10)[0])
        found = entries != NONE
        assert (table.keys[entries[found]] >> np.uint64(32) == check[chosen[found]]).all()
        known = there[chosen] != NONE
        assert (entries[known] == there[chosen[known]]).all()


def test_no_key_twice_after_random_accesses_of_many(kernels):
    """Frames in which random sets of keys are asked for, and others die."""
    rng = np.random.default_rng(3)
    capacity, probe, lifetime = 64, 4, 4
    place, check = keys_of(rng, 300, capacity)
    place_of = dict(zip(check.tolist(), place.tolist(), strict=True))
    table, evicted = OnDevice(*kernels, capacity, probe, lifetime), 0
    for update in range(100):
        chosen = rng.choice(rng.choice(300, 30, replace=False), 500)
        stamp = (WORDS - 100 + 2 * update) % WORDS
        before = table.keys
        entries, outcomes = table.at_once(np.ones(500), place[chosen], check[chosen], stamp)
        after = table.keys
        assert_no_key_twice(after, capacity, probe, place_of)
        evicted += outcomes.count("evicted")
        changed = after >> np.uint64(32) != before >> np.uint64(32)
        age = (np.uint64(stamp) - before) & np.uint64(NONE)
        assert (before[changed] == 0).sum() + (age[changed & (before > 0)] > lifetime).sum() == changed.sum()
    assert evicted > 500
