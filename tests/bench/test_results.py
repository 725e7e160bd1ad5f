"""The figures that follow from what was measured."""

import dataclasses
import json
from types import SimpleNamespace

import pytest

from clcache.bench import Job, Result, Run, report
from clcache.bench.report import scaling_pairs, scalings

RESULT = Result("rays", "primary", "room", 600, "rays", (3.0, 1.0, 2.0, 5.0, 4.0))


def run(threads, *results, index=0):
    candidate = SimpleNamespace(index=index, platform="P", name="N", driver_version="1")
    return Run(candidate, Job(("rays",), str(index), threads, 5, (64, 48)), list(results))


def copy(rate):
    return Result("bandwidth", "copy", "", 1000, "bytes", (1000 / rate,))


def test_rate_is_items_by_the_median():
    entry = RESULT.entry(100.0)
    assert entry["seconds"] == {"min": 1.0, "median": 3.0, "max": 5.0}
    assert entry["rate"] == RESULT.rate == 200.0
    assert not {"bytes", "of_bound", "embree", "ratio", "agree", "bytes_per_triangle"} & entry.keys()


def test_time_beside_the_bandwidth_bound():
    result = dataclasses.replace(RESULT, nbytes=150)
    entry = result.entry(100.0)
    assert entry["bytes_per_second"] == result.bytes_per_second == 50.0
    assert entry["bandwidth_bound"] == 1.5
    assert entry["of_bound"] == 2.0


def test_ratio_is_above_one_where_embree_is_slower():
    entry = dataclasses.replace(RESULT, peer_seconds=(6.0, 8.0, 7.0), agree=0.5).entry(100.0)
    assert entry["embree"] == {"seconds": {"min": 6.0, "median": 7.0, "max": 8.0}, "rate": 600 / 7}
    assert entry["ratio"] == pytest.approx(7 / 3)
    assert entry["ratio"] == pytest.approx(entry["rate"] / entry["embree"]["rate"])
    assert entry["agree"] == 0.5


def test_scaling_is_between_the_fewest_and_the_most_threads():
    fast = dataclasses.replace(RESULT, seconds=(1.5,))
    alone = dataclasses.replace(RESULT, name="shadow")
    runs = [run(2, fast), run(4, fast), run(1, RESULT, alone), run(None, RESULT, index=1), run(1, RESULT, index=2)]
    [(few, many)] = scaling_pairs(runs)
    assert (few, many) == (runs[2], runs[1])
    [scaling] = scalings(few, many)
    assert (scaling.family, scaling.name, scaling.scene) == ("rays", "primary", "room")
    assert scaling.threads == (1, 4)
    assert scaling.factor == 2.0


def test_report_judges_each_run_by_its_own_bandwidth():
    moved = dataclasses.replace(RESULT, nbytes=300)
    runs = [run(1, copy(100), moved), run(2, copy(200), moved)]
    whole = json.loads(json.dumps(report(runs, "a note"), allow_nan=False))
    assert (whole["size"], whole["repeats"], whole["embree"]) == ([64, 48], 5, "a note")
    assert [r["threads"] for r in whole["runs"]] == [1, 2]
    assert [r["bandwidth"] for r in whole["runs"]] == [{"copy": 100.0}, {"copy": 200.0}]
    assert [r["results"][1]["bandwidth_bound"] for r in whole["runs"]] == [3.0, 1.5]
    assert [r["results"][0]["rate"] for r in whole["runs"]] == [100.0, 200.0]
    assert whole["runs"][0]["device"] == {"index": 0, "platform": "P", "name": "N", "driver": "1"}
    assert [s["factor"] for s in whole["scaling"]] == [2.0, 1.0]
