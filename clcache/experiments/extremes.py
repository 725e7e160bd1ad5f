"""The cases of extreme_cases.py as jobs, and as a table: what was fed, what came out, the error, the verdict.

Cases run in a process of their own, which writes a row as each is done. One that brings it down, or that does not come
to an end, is a row that says so, and another process goes on behind it.
"""

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence

from .experiment import Calls, Claim, Column, Experiment, Table
from .extreme_cases import CASES, FRAMES, LINES, Bench, Case, Found, attempt, one_device
from .job import Machine, Result

TIME_LIMIT = 1800.0  # seconds that a process may take
QUICK_FRAMES = 300


def run(parameters: Mapping, _needed: Mapping[str, Result], machine: Machine) -> Result:
    """Run the cases of some lines: a row for each.

    parameters: lines, by their keys in LINES; frames: static ones, of the cases that take as many as can be. Columns:
    line (in words), case, method, fed, came out, expected, verdict (right, refused or wrong) and reason (of the
    tolerance), in words; error, tolerance; wrong: 0 or 1; configuration: the method.
    """
    cases = _cases_of(parameters["lines"])
    rows: list[dict] = []
    while len(rows) < len(cases):
        found, end = _in_a_process(parameters, len(rows), machine)
        rows += found
        if len(rows) < len(cases):
            rows.append(row(cases[len(rows)], Found(end, "no error", None)))
    return Result(rows)


def _cases_of(lines: Sequence[str]) -> list[Case]:
    return [case for case in CASES if case.line in lines]


def row(case: Case, found: Found) -> dict:
    """A case and what came out of it, as a row."""
    verdict = case.verdict(found)
    return {
        "line": LINES[case.line],
        "case": case.name,
        "method": case.method,
        "configuration": case.method,
        "fed": case.fed,
        "came out": found.came,
        "expected": found.expected,
        "error": found.error,
        "tolerance": None if case.refused else case.tolerance,
        "reason": case.reason,
        "verdict": verdict,
        "wrong": int(verdict == "wrong"),
    }


def _in_a_process(parameters: Mapping, first: int, machine: Machine) -> tuple[list[dict], str]:
    """The rows of the cases from number `first` on, as far as a process comes, and how it ended."""
    told = {**parameters, "first": first, "device": machine.device, "threads": machine.threads}
    command = [sys.executable, "-W", "ignore", "-m", __name__, json.dumps(told)]
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=TIME_LIMIT, check=False)
        written, end = done.stdout, f"the process ended with {done.returncode}"
    except subprocess.TimeoutExpired as error:
        written = error.stdout or b""
        written, end = written.decode() if isinstance(written, bytes) else written, f"no end after {TIME_LIMIT:g} s"
    return [json.loads(line) for line in written.splitlines() if line.endswith("}")], end


def _write_rows(told: Mapping) -> Iterator[dict]:
    bench = Bench(Machine(told["device"], told["threads"]), told["frames"])
    with one_device():
        for case in _cases_of(told["lines"])[told["first"] :]:
            yield row(case, attempt(case, bench))


_METHODS = tuple(dict.fromkeys(case.method for case in CASES))

EXPERIMENTS = (
    Experiment(
        name="extremes",
        source="the project's own",
        title="Numerical extremes: what was fed, what came out",
        about="Every method, memoization, filter and the tracer where numbers end: sizes, places, angles,"
        " lights, tables, counters. What is seen is known: in closed form, in double precision, or as the"
        " same scene at an ordinary size. An error is relative, the largest of all pixels, channels, eyes"
        " and frames, where the row does not speak of a mean. Refused is what must be refused, with the"
        " file and the place in it; and wrong is anything else."
        f" At small size {QUICK_FRAMES} static frames stand for {FRAMES:,}.",
        plans=(
            Calls(
                "extremes",
                tuple({"lines": [line], "frames": FRAMES} for line in LINES),
                quick=({"lines": list(LINES), "frames": QUICK_FRAMES},),
            ),
        ),
        tables=(
            Table(
                "All cases",
                (
                    Column("error", "error", ".2g"),
                    Column("tolerance", "tolerance", ".2g"),
                ),
                by=("line", "case", "method", "fed", "came out", "expected", "verdict"),
            ),
            Table("By method", (Column("wrong", "part that is wrong", ".3g"),), by=("configuration",)),
        ),
        claims=tuple(Claim(f"{method}: no case is wrong", "wrong", method, high=0.0) for method in _METHODS),
    ),
)  # fmt: skip

if __name__ == "__main__":
    for _row in _write_rows(json.loads(sys.argv[1])):
        print(json.dumps(_row, allow_nan=False), flush=True)
