"""Every line of extremes, for every method, as `clcache experiment extremes` runs them
(clcache/experiments/extreme_cases.py)."""

from dataclasses import replace

import numpy as np
import pytest

from clcache.experiments import extremes
from clcache.experiments.extreme_cases import CASES, LINES, Bench, Case, Found, attempt, compared, one_device, relative
from clcache.experiments.job import Machine


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


@pytest.fixture(scope="module")
def bench(device_spec):
    return Bench(Machine(device_spec), frames=extremes.QUICK_FRAMES)


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
@pytest.mark.parametrize("case", CASES, ids=[f"{c.line}-{c.name}-{c.method}".replace(" ", "_") for c in CASES])
def test_case(case, bench):
    found = attempt(case, bench)
    assert case.verdict(found) == ("refused" if case.refused else "right"), found


def test_every_line_has_cases_and_no_two_have_one_name():
    assert list(LINES) == sorted({c.line for c in CASES}, key=list(LINES).index)
    assert len({(c.line, c.name, c.method) for c in CASES}) == len(CASES)


def test_errors_are_relative_and_what_is_no_number_is_wrong():
    assert relative([1.0, 2.2], [1.0, 2.0]) == pytest.approx(0.1)
    assert relative([0.5, -0.25], 0.0) == 0.5
    assert relative([1e-6], 1e-7, least=1e-4) == pytest.approx(9e-3)
    assert compared(np.array([1.0, np.nan]), 1.0).error is None
    case = Case("scale", "a", "b", "c", lambda bench: None, 0.1, "reason")
    verdicts = {0.1: "right", 0.2: "wrong", None: "wrong", np.nan: "wrong"}
    assert [case.verdict(Found("", "", e)) for e in verdicts] == list(verdicts.values())
    assert case.verdict(Found("", "", 0.0, refused=True)) == "wrong"
    refusing = replace(case, refused=True)
    assert [refusing.verdict(Found("", "", 0.0, refused=r)) for r in (True, False)] == ["refused", "wrong"]


def test_a_case_that_brings_its_process_down_is_a_row(monkeypatch):
    """Rows that were written before it count, and what is behind it is done by another process."""
    cases = [replace(CASES[0], name=name) for name in ("fine", "deadly", "fine, too")]
    done = {0: ([extremes.row(cases[0], Found("1", "1", 0.0))], "the process ended with -11"),
            2: ([extremes.row(cases[2], Found("1", "1", 0.0))], "the process ended with 0")}  # fmt: skip
    monkeypatch.setattr(extremes, "_cases_of", lambda lines: cases)
    monkeypatch.setattr(extremes, "_in_a_process", lambda parameters, first, machine: done[first])
    rows = extremes.run({"lines": []}, {}, Machine()).rows
    assert [(r["case"], r["verdict"], r["came out"]) for r in rows] == [
        ("fine", "right", "1"), ("deadly", "wrong", "the process ended with -11"), ("fine, too", "right", "1"),
    ]  # fmt: skip


def test_a_job_is_a_process(device_spec):
    rows = extremes.run({"lines": ["not finite"], "frames": 1}, {}, Machine(device_spec)).rows
    assert len(rows) == sum(c.line == "not finite" for c in CASES)
    assert {r["verdict"] for r in rows} == {"refused"} and not any(r["wrong"] for r in rows)
    assert "pixel (2, 1) is nan" in {r["case"]: r for r in rows}["NaN in a texture"]["came out"]
