"""Cuckoo tables against Python's dictionaries: every key found at its index, and no other; keys made to collide; restarts."""

import os
from dataclasses import replace

import numpy as np
import pytest
from cache_renders import in_child
from hypothesis import given, settings
from hypothesis import strategies as st
from octree_on_device import NONE, find_cells
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from clcache.device import Device
from clcache.errors import DeviceError
from clcache.octree import cuckoo
from clcache.octree.cuckoo import CuckooTables, buckets_of, build_tables, seeds_of, space_factor

WHOLE = 10  # the level of one part of space whose keys are all of 30 bits


def build(device: Device, levels: list[list[np.ndarray]]) -> tuple[CuckooTables, dict]:
    """Tables of keys: of each level, of each of its parts."""
    sent = [[device.upload(np.asarray(k, np.uint32)) if len(k) else None for k in parts] for parts in levels]
    tables = build_tables(device, sent)
    device.release(*(k for parts in sent for k in parts if k is not None))
    return tables, {"octree_table": tables.entries, "octree_tables": tables.tables}


def one_table(device: Device, keys: np.ndarray) -> tuple[CuckooTables, dict]:
    """The table of level 10, with these keys, and of no other level."""
    return build(device, [[[]]] * WHOLE + [[keys]])


def random_keys(n: int, seed: int) -> np.ndarray:
    """About `n` different keys, ascending."""
    return np.unique(np.random.default_rng(seed).integers(0, 2**30, n, dtype=np.uint32))


def bucket_of(keys: np.ndarray, seed: int, buckets: int) -> np.ndarray:
    """The hash function of cl/octree/find.cl."""
    h = (keys.astype(np.uint32) + np.uint32(1)) * np.uint32(seed)
    h = (h ^ h >> np.uint32(16)) * np.uint32(0x7FEB352D)
    h = (h ^ h >> np.uint32(15)) * np.uint32(0x846CA68B)
    h ^= h >> np.uint32(16)
    return (h.astype(np.uint64) * np.uint64(buckets) >> np.uint64(32)).astype(np.uint32)


def check_all_found(device: Device, arrays: dict, keys: np.ndarray, first: int = 0, level: int = WHOLE) -> None:
    assert np.array_equal(find_cells(device, arrays, keys, level), first + np.arange(len(keys)))


def check_entries(tables: CuckooTables, cells: int) -> None:
    """Each cell has one entry, and all other places are empty."""
    entries = tables.entries.get()
    taken = entries[entries != cuckoo.EMPTY]
    assert np.array_equal(np.sort(taken & np.uint64(0xFFFFFFFF)), np.arange(cells))
    assert (entries[: cuckoo.BUCKET] == cuckoo.EMPTY).all()


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 8, 33, 1000, 30_000, 1_000_000])
def test_every_key_is_found_and_no_other(device, n):
    keys = random_keys(2 * n, seed=n)
    others, keys = keys[::2], keys[1::2]
    tables, arrays = one_table(device, keys)
    check_all_found(device, arrays, keys)
    assert (find_cells(device, arrays, others, WHOLE) == NONE).all()
    check_entries(tables, len(keys))


def test_ten_million_keys(device):
    n = 10_000_000
    numbers = np.arange(n + 100_000, dtype=np.uint32) * np.uint32(0x9E3779B1) & np.uint32(
        2**30 - 1
    )  # no two are the same
    keys, others = np.sort(numbers[:n]), numbers[n:]
    _, arrays = one_table(device, keys)
    check_all_found(device, arrays, keys)
    assert (find_cells(device, arrays, others, WHOLE) == NONE).all()
    device.release(*arrays.values())


@settings(max_examples=60, deadline=None)
@given(
    st.dictionaries(st.integers(0, 2**30 - 1), st.none(), min_size=1, max_size=200), st.lists(st.integers(0, 2**30 - 1))
)
def test_the_same_as_a_dictionary(device, known, asked):
    keys = sorted(known)
    expected = {key: i for i, key in enumerate(keys)}
    _, arrays = one_table(device, np.array(keys))
    near = [key + 1 for key in keys if key + 1 < 2**30] + [key ^ 1 for key in keys]
    asked = [*keys, *asked, *near]
    assert find_cells(device, arrays, asked, WHOLE).tolist() == [expected.get(key, NONE) for key in asked]


@pytest.mark.parametrize(
    "keys",
    [
        np.arange(5000),  # a block of space without gaps
        np.arange(5000) * 2**15,  # multiples
        2**30 - 1 - np.arange(5000)[::-1],  # up to the largest key, whose bits are all set as EMPTY's are
        np.unique(np.arange(5000) ^ 0x2AAAAAAA),
    ],
)
def test_keys_with_a_pattern(device, keys):
    tables, arrays = one_table(device, keys)
    check_all_found(device, arrays, keys)
    check_entries(tables, len(keys))
    assert tables.attempts[WHOLE] <= 2


def test_the_same_key_on_every_level_and_in_every_part(device):
    """A table is of one level and one part; its neighbours' keys must not be found in it."""
    rng = np.random.default_rng(4)
    parts = [1] * 11 + [8, 64]
    levels = [
        [
            np.unique(rng.integers(0, 8 ** min(level, 10), 40)) if rng.random() < 0.7 or level < 3 else []
            for _ in range(n)
        ]
        for level, n in enumerate(parts)
    ]
    _, arrays = build(device, levels)
    index, expected = 0, {}
    for level, of_parts in enumerate(levels):
        for part, keys in enumerate(of_parts):
            expected |= {(level, int(key) + (part << 30)): index + i for i, key in enumerate(keys)}
            index += len(keys)
    assert len({key for _, key in expected}) < len(expected)
    asked = sorted({key for _, key in expected})
    for level in range(13):
        answers = [expected.get((level, key), NONE) for key in asked]
        assert find_cells(device, arrays, asked, level).tolist() == answers


def test_what_is_no_key_of_a_level_has_no_cell(device):
    levels = [[np.arange(8**level)] for level in range(4)]
    _, arrays = build(device, levels)
    for level in range(4):
        assert find_cells(device, arrays, [8**level - 1], level) != NONE
        beyond = [8**level, 2**30 - 1, 2**36 - 1, 2**63, 2**64 - 1]
        assert (find_cells(device, arrays, beyond, level) == NONE).all()
    assert (find_cells(device, arrays, [0, 1, 2**36 - 1], 12) == NONE).all()  # a level that there is not


def test_tables_without_cells(device):
    tables, arrays = build(device, [[[]]] * 11 + [[[]] * 8])
    assert tables.entries.size == cuckoo.BUCKET
    for level in range(12):
        assert (find_cells(device, arrays, np.arange(20), level) == NONE).all()


def colliding(n: int, many: int, table: int) -> np.ndarray:
    """`n` keys of which `many` go to the same two buckets in the table's first attempt."""
    seeds, buckets = seeds_of(table, 1), buckets_of(n)
    candidates = np.arange(1 << 23, dtype=np.uint32)
    a, b = (bucket_of(candidates, seed, buckets) for seed in seeds)
    chosen = candidates[((a == 5) | (a == 7)) & ((b == 5) | (b == 7))][:many]
    assert len(chosen) == many
    rest = np.setdiff1d(random_keys(4 * n, seed=1), chosen)
    return np.sort(np.concatenate([chosen, np.random.default_rng(2).permutation(rest)[: n - many]]))


def test_keys_made_against_the_seeds_force_a_restart(device):
    keys = colliding(1000, 2 * cuckoo.BUCKET + 1, WHOLE)
    tables, arrays = one_table(device, keys)
    assert tables.attempts[WHOLE] == 2
    assert tables.tables.get()[WHOLE].tolist() == [1, buckets_of(1000, 2), *seeds_of(WHOLE, 2)]
    check_all_found(device, arrays, keys)
    check_entries(tables, len(keys))


def test_as_many_as_two_buckets_hold_are_found(device):
    keys = colliding(1000, 2 * cuckoo.BUCKET, WHOLE)
    _, arrays = one_table(device, keys)
    check_all_found(device, arrays, keys)


def test_a_restart_leaves_the_tables_before_it_and_behind_it_alone(device):
    bad = colliding(1000, 12, 9) & np.uint32(2**27 - 1)
    levels = [[np.arange(8 ** min(level, 4))] for level in range(9)] + [[bad], [random_keys(3000, seed=5)]]
    tables, arrays = build(device, levels)
    assert tables.attempts[9] > 1
    assert (tables.attempts[:9] >= 1).all()
    first = 0
    for level, (keys,) in enumerate(levels):
        check_all_found(device, arrays, keys, first, level)
        first += len(keys)
    check_entries(tables, first)


def test_attempts_have_an_end(device, monkeypatch):
    monkeypatch.setattr(cuckoo, "_ATTEMPTS", 1)
    monkeypatch.setattr(device, "allocated", device.allocated)
    with pytest.raises(DeviceError, match="table of 1000 cells could not be built in 1 attempts") as caught:
        one_table(device, colliding(1000, 9, WHOLE))
    assert "\n" not in str(caught.value)


def test_the_same_key_twice_too_often_has_an_end(device, monkeypatch):
    """Not what a scene can give: nine entries of one key fit no two buckets, whatever the seeds."""
    monkeypatch.setattr(cuckoo, "_ATTEMPTS", 5)
    monkeypatch.setattr(device, "allocated", device.allocated)
    with pytest.raises(DeviceError, match="5 attempts"):
        one_table(device, np.zeros(9))


def test_tables_that_do_not_fit_are_said_in_one_line(device, monkeypatch):
    keys = random_keys(100_000, seed=1)
    monkeypatch.setattr(device, "allocated", device.allocated)
    limits = replace(device.capabilities, global_memory=device.allocated + 4 * len(keys) + 1000)
    monkeypatch.setattr(device, "capabilities", limits)
    with pytest.raises(DeviceError, match="octree's tables") as caught:
        one_table(device, keys)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("n", [1, 7, 1000, 99_999])
def test_the_law_of_hash_memory(device, n):
    keys = random_keys(3 * n, seed=n)[:n]
    tables, _ = one_table(device, keys)
    factor = 1.1 * 1.01 ** (tables.attempts[WHOLE] - 1)
    buckets = int(np.ceil(factor * n / 4))
    assert tables.tables.get()[WHOLE, 1] == buckets == buckets_of(n, tables.attempts[WHOLE])
    assert tables.entries.nbytes == 8 * 4 * (1 + buckets)
    assert tables.space_factors[WHOLE] == pytest.approx(factor)


def test_seeds_of_tables_and_attempts_differ_and_are_odd():
    seeds = np.array([seeds_of(table, attempt) for table in range(cuckoo.TABLES) for attempt in range(1, 4)])
    assert len(np.unique(seeds)) == seeds.size
    assert (seeds % 2 == 1).all()
    assert space_factor(3) == pytest.approx(1.1 * 1.01**2)


def test_buckets_are_taken_evenly():
    for seed in seeds_of(0, 1):
        for keys in (np.arange(100_000), random_keys(100_000, 3), np.arange(100_000) * 8):
            counts = np.bincount(bucket_of(keys, seed, 1000), minlength=1000)
            assert np.abs(counts - len(keys) / 1000).max() < 6 * np.sqrt(len(keys) / 1000)


def fits_single_places(keys: np.ndarray, places: int, seeds: np.ndarray) -> bool:
    """Whether keys can each have one of their two places to themselves: exactly if, where keys join places, no connected part
    has more keys than places."""
    a, b = (bucket_of(keys, seed, places) for seed in seeds)
    _, part = connected_components(coo_array((np.ones(len(keys)), (a, b)), shape=(places, places)), directed=False)
    return bool((np.bincount(part[a], minlength=part.max() + 1) <= np.bincount(part)).all())


def test_single_places_would_need_twice_the_space():
    """The paper's two hash functions with one place for each: from a space factor of 2 on, not 1.1."""
    keys = random_keys(100_000, seed=6)
    for factor in (1.1, 1.5, 1.9):
        assert not any(fits_single_places(keys, int(factor * len(keys)), seeds_of(0, k)) for k in range(1, 6))
    assert any(fits_single_places(keys, int(2.1 * len(keys)), seeds_of(0, k)) for k in range(1, 6))


def checksum(threads: int) -> int:
    """Of what is found in tables of 300,000 keys, and of half as many that are not there, built by so many threads."""
    device = Device(threads=threads)
    keys = random_keys(450_000, seed=7)
    _, arrays = one_table(device, keys[keys % 3 > 0])
    return int(np.bitwise_xor.reduce((find_cells(device, arrays, keys, WHOLE) + np.uint64(1)) * keys.astype(np.uint64)))


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_what_is_found_is_the_same_for_any_number_of_threads():
    code = "import test_cuckoo as t; print(t.checksum({}))"
    one, two = (in_child(code.format(threads)) for threads in (1, 2))
    assert one == two
