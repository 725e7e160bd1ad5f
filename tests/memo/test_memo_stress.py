"""A tiny table of values hammered by all threads (tools/memo_stress.py): no value of another key's, nothing twice, nothing locked."""

import sys
from pathlib import Path

import pytest
from memo_model import EVICTIONS

import clcache

sys.path.append(str(Path(clcache.__file__).parents[1] / "tools"))
from memo_stress import LAUNCH, RUN, main, stress  # noqa: E402


@pytest.mark.parametrize("read", ["counter", "key"])
@pytest.mark.parametrize("eviction", EVICTIONS)
def test_a_table_hammered_by_all_threads(device, eviction, read):
    """Whoever looks at keys alone may be deceived (tests/memo/test_memo_races.py), but hardly ever is."""
    totals = stress(device, 250_000, 16, 4, eviction, read)
    assert totals.defects == 0, totals
    assert totals.foreign == 0 if read == "counter" else totals.foreign < 1e-4 * totals.lookups
    # How many hit depends on how long a thread that has locked an entry is kept waiting by the system.
    assert totals.lookups >= 250_000 and totals.hits > 1000
    assert (totals.evicted > 100) == (eviction != "none")
    assert (totals.discarded > 1000) >= (eviction == "none")


@pytest.mark.parametrize(("capacity", "keys"), [(1, 2), (2, 3), (64, 20)])
def test_tables_of_other_sizes(device, capacity, keys):
    totals = stress(device, RUN * LAUNCH, capacity, 8, "random", "counter", keys=keys)
    assert totals.defects == totals.foreign == 0, totals
    assert totals.hits > 0 and (totals.evicted > 0) == (keys > capacity)


def test_the_tool_prints_what_it_counted(device_spec, monkeypatch, capsys):
    monkeypatch.setenv("CLCACHE_DEVICE", device_spec or "")
    assert main(["--lookups", "1000", "--read", "counter", "--eviction", "none", "lru-frame"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("16 entries, 24 keys") and [line.split()[1] for line in lines[2:]] == [
        "none",
        "lru-frame",
    ]
