"""From rows to numbers: what belongs together over frames, then over seeds, with standard errors; and the verdicts on
claims.

Rows are brought together in three steps. Within a job, what belongs to one configuration: times, rays and counters by
the median over the frames that count, which a busy machine disturbs least, and all else by the mean over all rows that
have it. Where values are divided by those of another configuration this comes next, within the job if it has both, as
only what has run in turn on one machine is timed alike. Then the mean over jobs of the same seed; and at last the mean
over seeds with its standard error. Intervals are those of Student's t over seeds. What depends on no seed is known
exactly, but for times.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np
import pandas as pd
from scipy import stats

from .experiment import Claim, Column, Experiment, Labelled
from .job import Result

TIMES = ("seconds", "elapsed", "device", "seconds.", "pass.", "stage.")  # columns in seconds, or their beginnings
_BY_MEDIAN = (*TIMES, "rays.", "cache.", "memo.")
CONFIDENCE = 0.95
HOLDS, FAILS, OPEN, NOT_MEASURED = "holds", "fails", "open", "not measured"


def is_time(column: str) -> bool:
    """Whether a column is a time."""
    return _starts(column, TIMES)


def _starts(column: str, names: Iterable[str]) -> bool:
    return any(column.startswith(name) if name.endswith(".") else column == name for name in names)


@dataclass(frozen=True)
class Estimate:
    """A mean of n values, and its standard error, which is NaN of a single one."""

    mean: float
    error: float
    n: int

    @classmethod
    def of(cls, values: Iterable[float]) -> "Estimate":
        """Of values, at least one."""
        values = np.asarray(list(values), dtype=float)
        return cls(float(values.mean()), float(stats.sem(values)) if len(values) > 1 else math.nan, len(values))


# ---------------------------------------------------------------------------------------------------------------------
# Rows


def tidy(found: Sequence[tuple[Labelled, Result]]) -> pd.DataFrame:
    """All rows with their labels, one line each. Beside their columns: scene, seed, `seeded`, whether what the job
    finds depends on the seed, and `job`, its key."""
    rows = [
        {**labelled.labels, **row, "seeded": "seed" in labelled.job.parameters, "job": labelled.job.key}
        for labelled, result in found
        for row in result.rows
    ]
    columns = dict.fromkeys(("scene", "seed", *(name for row in rows for name in row)))
    return pd.DataFrame(rows, columns=[*columns], dtype=object)


def numbers(values: pd.Series) -> pd.Series:
    """Those of the values that are finite numbers, as floats, and NaN for all else. Truth values are words."""
    is_number = values.map(lambda value: isinstance(value, (int, float, np.number)) and not isinstance(value, bool))
    return values.where(is_number.astype(bool)).astype(float).replace([math.inf, -math.inf], math.nan)


def per_job(rows: pd.DataFrame, by: Sequence[str], column: str) -> pd.Series:
    """A column over frames: by the values of `by`, seed and job. Empty where no row has numbers of it."""
    keys = list(dict.fromkeys((*by, "seed", "job")))
    if column not in rows or any(key not in rows for key in keys):
        return pd.Series(dtype=float, index=pd.MultiIndex.from_arrays([[]] * len(keys), names=keys))
    is_median = _starts(column, _BY_MEDIAN)
    if is_median and "counted" in rows:
        rows = rows[rows["counted"].map(lambda value: value is not False).astype(bool)]
    values = numbers(rows[column])
    known = rows.loc[values.notna(), keys].assign(value=values)
    return known.groupby(keys, dropna=False, sort=False)["value"].agg("median" if is_median else "mean")


def per_seed(rows: pd.DataFrame, by: Sequence[str], column: Column) -> dict[tuple, dict[int, float]]:
    """What a column of a table is, by the values of `by`, and of these by seed."""
    values = per_job(rows, by, column.of)
    if column.over is not None and len(values):
        values = _divided(values, rows, by, column)
    table = values.reset_index(name="value")
    found: dict[tuple, dict[int, list[float]]] = {}
    for line, seed, value in zip(_lines(table, by), table["seed"], table["value"], strict=True):
        found.setdefault(line, {}).setdefault(seed, []).append(value)
    return {line: {seed: fmean(values) for seed, values in seeds.items()} for line, seeds in found.items()}


def _divided(values: pd.Series, rows: pd.DataFrame, by: Sequence[str], column: Column) -> pd.Series:
    """Values by those of another configuration in the same scene: of the same job, or else of the same seed. There is none
    where the divisor is not above zero, as an error may be that is lost in its references' noise."""
    if "configuration" not in rows:
        return values.iloc[:0]
    base = per_job(rows[rows["configuration"] == column.over], ("scene",), column.of).reset_index()
    table = values.reset_index(name="value")
    if "scene" not in table:
        table = table.merge(rows[["job", "scene"]].drop_duplicates("job"), on="job")
    divisors = pd.Series(math.nan, index=table.index)
    for keys in (["job", "scene"], ["seed", "scene"]):
        known = base.groupby(keys)["value"].mean()
        divisors = divisors.fillna(
            pd.Series(known.reindex(pd.MultiIndex.from_frame(table[keys])).to_numpy(), table.index)
        )
    top, bottom = (divisors, table["value"]) if column.inverse else (table["value"], divisors)
    table["value"] = (top / bottom.where(bottom > 0.0)).astype(float)
    return table.dropna(subset="value").set_index(list(values.index.names))["value"]


def summarise(rows: pd.DataFrame, by: Sequence[str], column: Column) -> dict[tuple, Estimate]:
    """A column over frames and seeds, by the values of `by`."""
    return {line: Estimate.of(seeds.values()) for line, seeds in per_seed(rows, by, column).items()}


def lines(rows: pd.DataFrame, by: Sequence[str]) -> list[tuple]:
    """The values of `by` that rows have, in the order in which they appear, those of the first together. None where a
    row has none."""
    if rows.empty or any(name not in rows for name in by):
        return []
    found = _lines(rows, by)
    ranks = [{value: rank for rank, value in enumerate(dict.fromkeys(values))} for values in zip(*found, strict=True)]
    return sorted(dict.fromkeys(found), key=lambda line: [rank[value] for rank, value in zip(ranks, line, strict=True)])


def _lines(rows: pd.DataFrame, by: Sequence[str]) -> list[tuple]:
    return list(zip(*([plain(value) for value in rows[name]] for name in by), strict=True))


def plain(value: object) -> object:
    """A value as JSON has it: NaN and the like are None."""
    if value is None or isinstance(value, (bool, str)):
        return value
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and math.isnan(value) else value


# ---------------------------------------------------------------------------------------------------------------------
# What the paper prints


def printed(paper: Sequence[Mapping], line: Mapping[str, object], column: Column) -> float | None:
    """The paper's value of a column. line: the values of `by`, of which the paper's row may leave out some, but not
    all."""
    value = _printed(paper, line, column.of)
    if value is None or column.over is None:
        return value
    other = _printed(paper, {**line, "configuration": column.over}, column.of)
    top, bottom = (other, value) if column.inverse else (value, other)
    return top / bottom if top is not None and bottom else None


def _printed(paper: Sequence[Mapping], line: Mapping[str, object], column: str) -> float | None:
    for row in paper:
        same = [row[name] == value for name, value in line.items() if name in row]
        if same and all(same) and column in row and column not in line:
            return row[column]
    return None


# ---------------------------------------------------------------------------------------------------------------------
# Claims


@dataclass(frozen=True)
class Verdict:
    """What became of a claim in a scene. value: ours, the mean over n seeds, of ratios the geometric one. low, high: its interval. None where there
    is none."""

    scene: str
    value: float | None
    low: float | None
    high: float | None
    verdict: str
    n: int = 0


def judge(claim: Claim, rows: pd.DataFrame, scene: str) -> Verdict:
    """Whether a claim holds in a scene. It is open where the interval holds a bound, where there is none as there is but
    one seed, or where what values are divided by is zero or lost in noise for some seeds; and not measured where a value
    that it needs is missing."""
    column = Column(claim.measure, "", over=claim.over)
    if rows.empty or "configuration" not in rows:
        return Verdict(scene, None, None, None, NOT_MEASURED)
    here = rows[rows["scene"] == scene]
    seeds = per_seed(here, ("configuration",), column).get((claim.of,))
    if not seeds:
        return Verdict(scene, None, None, None, NOT_MEASURED)
    values = np.array(list(seeds.values()))
    involved = here[here["configuration"].isin([claim.of, claim.over])]
    is_exact = not involved["seeded"].any() and not is_time(claim.measure)
    is_ratio = claim.over is not None and bool((values > 0.0).all())
    value, bounds = mean_ratio(values, is_exact) if is_ratio else (float(values.mean()), interval(values, is_exact))
    measured = per_seed(here, ("configuration",), Column(claim.measure, ""))[(claim.of,)]
    if bounds is None or len(measured) > values.size:  # the seeds that are left would not be chosen by chance
        return Verdict(scene, value, None, None, OPEN, values.size)
    return Verdict(scene, value, *bounds, _verdict(claim, *bounds), values.size)


def mean_ratio(values: np.ndarray, is_exact: bool = False) -> tuple[float, tuple[float, float] | None]:
    """The geometric mean of ratios above zero, and its interval: that of the mean of their logarithms, so that it does not matter which of
    two is over the other, and that no end of it is below zero."""
    logarithms = np.log(values)
    bounds = interval(logarithms, is_exact)
    return math.exp(logarithms.mean()), bounds and (math.exp(bounds[0]), math.exp(bounds[1]))


def interval(values: np.ndarray, is_exact: bool = False) -> tuple[float, float] | None:
    """The 95 % interval of the mean by Student's t; None of a single value, unless it is exact."""
    mean = float(np.mean(values))
    if is_exact:
        return mean, mean
    if len(values) < 2:
        return None
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * stats.sem(values))
    return mean - half, mean + half


def _verdict(claim: Claim, low: float, high: float) -> str:
    least = -math.inf if claim.low is None else claim.low
    most = math.inf if claim.high is None else claim.high
    if least <= low and high <= most:
        return HOLDS
    return FAILS if high < least or low > most else OPEN


def verdicts(claim: Claim, rows: pd.DataFrame) -> list[Verdict]:
    """What becomes of a claim in each scene that it names; if it names none, in all in which it can be measured."""
    if claim.scenes:
        return [judge(claim, rows, scene) for scene in claim.scenes]
    scenes = [scene for (scene,) in lines(rows, ("scene",))] or [""]
    found = [judge(claim, rows, scene) for scene in scenes]
    return [one for one in found if one.verdict != NOT_MEASURED] or [Verdict("", None, None, None, NOT_MEASURED)]


# ---------------------------------------------------------------------------------------------------------------------
# Equal time and equal error


@dataclass(frozen=True)
class Equal:
    """A configuration beside a ladder. at_time: its error by that of the ladder in the same time. at_error: the
    ladder's time for the same error by its own. Where one of them is None, the words beside it say why."""

    scene: str
    configuration: str
    seconds: Estimate
    error: Estimate
    at_time: Estimate | None
    at_error: Estimate | None
    why_no_time: str = ""
    why_no_error: str = ""


def equals(experiment: Experiment, rows: pd.DataFrame) -> list[Equal]:
    """Every configuration beside the experiment's ladder, in each scene, by each seed and over seeds."""
    by = ("scene", "configuration")
    if not experiment.ladder or rows.empty or "configuration" not in rows:
        return []
    times, errors = (per_seed(rows, by, Column(name, "")) for name in ("seconds", experiment.error))
    found = []
    for line in lines(rows, by):
        rungs = [(line[0], rung) for rung in experiment.ladder]
        rungs = [rung for rung in rungs if rung in times and rung in errors]
        if rungs and line[1] not in experiment.ladder and line in times and line in errors:
            found.append(_equal(line, rungs, times, errors))
    return found


def _equal(line: tuple[str, str], rungs: list[tuple], times: dict, errors: dict) -> Equal:
    at_time, at_error, why_no_time, why_no_error = [], [], "", ""
    common = set(times[line]).intersection(errors[line], *(table[rung] for table in (times, errors) for rung in rungs))
    first, last = rungs[0][1], rungs[-1][1]
    for seed in sorted(common):
        time, error = times[line][seed], errors[line][seed]
        ladder_times, ladder_errors = (np.array([table[rung][seed] for rung in rungs]) for table in (times, errors))
        if (theirs := meet(ladder_times, ladder_errors, time)) is not None:
            at_time.append(error / theirs)
        elif (ladder_errors <= 0.0).any():
            why_no_time = "the ladder's error is lost in noise"
        else:
            why_no_time = f"takes less than {first}" if time < ladder_times.min() else f"takes more than {last}"
        if (theirs := meet(ladder_errors, ladder_times, error)) is not None:
            at_error.append(theirs / time)
        elif error <= 0.0 or (ladder_errors <= 0.0).any():
            why_no_error = "an error is lost in noise"
        else:
            why_no_error = f"errs less than {last}" if error < ladder_errors.min() else f"errs more than {first}"
    none = "" if common else "no seed has all of the ladder"
    return Equal(
        *line,
        Estimate.of(times[line].values()),
        Estimate.of(errors[line].values()),
        Estimate.of(at_time) if at_time and not why_no_time else None,
        Estimate.of(at_error) if at_error and not why_no_error else None,
        why_no_time or none,
        why_no_error or none,
    )


def meet(along: np.ndarray, across: np.ndarray, level: float) -> float | None:
    """Where a curve is at a level of one of its coordinates: the other one there, between points as powers of each
    other. The first such place. None where the curve has no such place, or a value is not above zero."""
    if level <= 0.0 or (along <= 0.0).any() or (across <= 0.0).any():
        return None
    x, y, at = np.log(along), np.log(across), math.log(level)
    for i in range(len(x) - 1):
        if min(x[i], x[i + 1]) <= at <= max(x[i], x[i + 1]):
            share = (at - x[i]) / (x[i + 1] - x[i]) if x[i + 1] != x[i] else 0.0
            return math.exp(y[i] + share * (y[i + 1] - y[i]))
    return None
