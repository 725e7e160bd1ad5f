"""The table of the caches of graphs (`cl/memo/table.cl`) against a model of it: any sequence of operations, of one work-item."""

import numpy as np
import pyopencl.array as cl_array
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from memo_model import DEAD, EMPTY, EVICTIONS, LOCKED, NONE, WORDS, Table
from memo_on_device import ACCESS, FIND, LOCK, PUBLISH, OnDevice

HYPOTHESIS = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def by_model(table, operations):
    entries = []
    for what, place, check, stamp, draw, of in operations:
        if what == FIND:
            entry = table.find(place, check)
        elif what == ACCESS:
            entry = table.access(place, check, stamp, draw)
        elif what == LOCK:
            entry = table.lock(place, check, stamp, draw)
        else:
            entry = entries[of]
            if entry != NONE:
                table.publish(place, entry, check, stamp)
        entries.append(entry)
    return entries


def access(place, check, stamp=1, draw=0):
    return ACCESS, place, check, stamp, draw, 0


def find(place, check):
    return FIND, place, check, 0, 0, 0


def lock(place, check, stamp=1, draw=0):
    return LOCK, place, check, stamp, draw, 0


def publish(of, place, check, stamp=1):
    return PUBLISH, place, check, stamp, 0, of


@st.composite
def sequences(draw, locks=True):
    """Operations on few places of a small table, so that ends, chains and evictions are common; all that is locked is published."""
    capacity = draw(st.sampled_from([1, 2, 5, 9, 16, 33]))
    probe = min(draw(st.sampled_from([1, 2, 3, 8, 64])), capacity)
    places = max(capacity - probe, 1)
    stamp = draw(st.sampled_from([0, 1, WORDS - 3, WORDS - 20, WORDS // 2 - 4]))
    starts = draw(st.lists(st.sampled_from([0, places // 2, places - 1]), min_size=1, max_size=3))
    keys = [(starts[k % len(starts)], [3, WORDS - 1, 2**31 + 1][k] if k < 3 else 10 + k) for k in range(12)]
    operations, opened = [], []
    for _ in range(draw(st.integers(1, 60))):
        stamp = (stamp + draw(st.sampled_from([0, 0, 0, 1, 2, 5]))) % WORDS
        what = draw(st.sampled_from([FIND, ACCESS, ACCESS, ACCESS, LOCK, PUBLISH] if locks else [FIND, ACCESS, ACCESS]))
        if what == PUBLISH and opened:
            of = opened.pop(draw(st.integers(0, len(opened) - 1)))
            operations.append(publish(of, *operations[of][1:3], stamp))
        elif what != PUBLISH:
            opened += [len(operations)] if what == LOCK else []
            operations.append((what, *draw(st.sampled_from(keys)), stamp, draw(st.integers(0, WORDS - 1)), 0))
    operations += [publish(of, *operations[of][1:3], stamp) for of in opened]
    return capacity, probe, operations or [find(0, 3)]


@HYPOTHESIS
@given(sequences())
@pytest.mark.parametrize("eviction", EVICTIONS)
def test_any_sequence_of_operations_is_the_models(device, eviction, sequence):
    """Entries, records, the clock and all counters; and no key stands twice once all that write have published."""
    capacity, probe, operations = sequence
    ours, model = OnDevice(device, capacity, probe, eviction), Table(capacity, probe, eviction)
    assert ours.run(operations) == by_model(model, operations)
    assert ours.records == model.records
    assert ours.clock == model.clock
    assert ours.counters == model.counters
    place_of = {check: place for _, place, check, *_ in operations}
    keys = ours.keys
    assert len(keys) == len(set(keys)) == ours.counters["occupied"]
    entries = ours.run([find(place_of[key], key) for key in keys]) if keys else []
    assert [ours.records[e][0] for e in entries] == keys


@pytest.mark.parametrize("eviction", EVICTIONS)
def test_a_range_that_begins_at_the_last_possible_index_stays_inside(device, eviction):
    """Behind the table's end stand words that say so if they are read or written; a key among them is not found."""
    for capacity, probe in ((1, 1), (7, 7), (16, 8), (33, 8), (64, 64)):
        table = OnDevice(device, capacity, probe, eviction)
        records = table.arrays["records"]
        beyond = np.full((80, records.shape[1]), 99, np.uint32)
        whole = device.upload(np.concatenate([records.get(), beyond]))
        table.arrays["records"] = cl_array.Array(device.queue, records.shape, np.uint32, data=whole.base_data)
        last = max(capacity - probe, 1) - 1
        table.run([access(last, 1000 + i, 1 + i // 5, i) for i in range(80)])
        assert table.run([find(last, 99)]) == [NONE]
        assert (whole.get()[capacity:] == 99).all()
        assert len(table.keys) == probe


@pytest.mark.parametrize("eviction", EVICTIONS)
@pytest.mark.parametrize(("capacity", "probe"), [(1, 1), (8, 8), (40, 8)])
def test_a_full_table(device, eviction, capacity, probe):
    """Without eviction it finds what it holds, and takes nothing more; else it takes what is new for something old."""
    table = OnDevice(device, capacity, probe, eviction)
    fill = [(k % max(capacity - probe, 1), 1000 + k) for k in range(200)]
    table.run([access(place, check) for place, check in fill])
    held, before = table.keys, table.records
    assert len(held) == (capacity if capacity <= probe else capacity - 1) == table.counters["occupied"]
    (entry,) = table.run([lock(0, 7, 2)])
    assert (entry == NONE) == (eviction == "none")
    if eviction == "none":
        assert table.counters["discarded"] == 200 - len(held) + 1 and table.records == before
        assert table.counters["evicted"] == 0 and held == [key for key in range(1000, 1200) if key in held]


def test_who_is_evicted(device):
    """By each strategy, of four entries that were written in order, and then read in another."""
    writes = [access(0, 10 + k, 5 + k) for k in range(4)]
    reads = [access(0, 10 + k, stamp) for stamp, k in ((9, 2), (10, 0), (11, 3), (11, 1))]
    victims = {"lrw-frame": 10, "lru-frame": 12, "lrw-counter": 10, "lru-counter": 12, "random": 13}
    for eviction, victim in victims.items():
        table = OnDevice(device, 4, 4, eviction)
        table.run([*writes, *reads, access(0, 99, 12, 7)])
        assert sorted({10, 11, 12, 13} - set(table.keys)) == [victim], eviction
        assert table.counters["evicted"] == 1 and 99 in table.keys


def test_counters_tell_accesses_of_one_frame_apart(device):
    """Where frames tell nothing, the first of the range goes; a counter knows better."""
    accesses = [access(0, 10 + k, 5) for k in (0, 1, 2, 1, 2, 0)]
    for eviction, victim in {"lrw-frame": 10, "lru-frame": 10, "lrw-counter": 10, "lru-counter": 11}.items():
        table = OnDevice(device, 3, 3, eviction)
        table.run([*accesses, access(0, 99, 5)])
        assert {10, 11, 12} - set(table.keys) == {victim}, eviction


@pytest.mark.parametrize("eviction", ["lrw-frame", "lru-frame"])
def test_stamps_wrap_around(device, eviction):
    """What was accessed before 2^32 - 1 is older than what was accessed at 2, though its number is larger."""
    table = OnDevice(device, 2, 2, eviction)
    table.run([access(0, 10, WORDS - 2), access(0, 11, 1), access(0, 12, 2)])
    assert table.keys == [12, 11]


@pytest.mark.parametrize("stamp", [1, WORDS - 1, 0])
def test_distinct_are_entries_that_a_frame_accessed(device, stamp):
    table = OnDevice(device, 16, 8, "lru-frame")
    for frame, keys in enumerate(([10, 11, 10, 10, 11], [10, 10, 12], [10, 11, 12, 12])):
        before = table.counters["distinct"]
        table.run([access(0, key, (stamp + frame) % WORDS) for key in keys])
        assert table.counters["distinct"] - before == len(set(keys))


def test_twins_of_writers_that_did_not_see_each_other(device):
    """Both lock a place for the same key; whoever publishes last, the entry that is further on dies, and its place is taken again."""
    for order in ((0, 1), (1, 0)):
        table = OnDevice(device, 8, 4, "lru-frame")
        table.run([lock(0, 10), lock(0, 10), *(publish(of, 0, 10) for of in order)])
        assert [r[0] for r in table.records[:3]] == [10, DEAD, EMPTY]
        assert table.counters["duplicates"] == 1 and table.counters["occupied"] == 1
        assert table.run([find(0, 10), access(0, 11), find(0, 11), find(0, 10)]) == [0, NONE, 1, 0]
        assert table.counters["occupied"] == 2


def test_a_locked_place_is_passed_over(device):
    """By searches, and by all evictions but the random one, which discards if it draws it."""
    for eviction in EVICTIONS:
        table = OnDevice(device, 3, 3, eviction)
        table.run([lock(0, 10), access(0, 11), access(0, 12, 1), access(0, 13, 2, 0)])
        assert table.records[0][0] == LOCKED
        assert table.run([find(0, 10)]) == [NONE]
        assert table.counters["discarded"] == (eviction in ("none", "random")), eviction


def test_nothing_is_written_where_all_is_locked(device):
    for eviction in EVICTIONS:
        table = OnDevice(device, 2, 2, eviction)
        table.run([lock(0, 10), lock(0, 11)])
        before = table.records
        assert table.run([lock(0, 12, 2, draw) for draw in range(4)]) == [NONE] * 4
        assert table.records == before and table.counters["discarded"] == 4, eviction
