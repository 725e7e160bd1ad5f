"""The report of an experiment: one HTML page that needs nothing beside it, tables as CSV, and plots as SVG.

The page has the claims first and what became of them; then tables, ours beside the paper's; what is as good in the same
time, and as fast for the same error; plots; pictures; and what is needed to measure it all again. Its one script, which
compares two pictures, is known to the page by its digest: nothing else runs, and nothing is loaded from anywhere.
Whatever comes from files, such as names of scenes, is text and nothing more.
"""

import base64
import csv
import datetime
import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import jinja2
import numpy as np
import pandas as pd

from ..metrics.heatmap import HIGH, LOW, to_colors
from ..output.files import atomic_path
from ..version import __version__
from .configuration import Configuration
from .experiment import Claim, Column, Experiment, Labelled, Table
from .job import Job, Result
from .pictures import REFERENCE, collected, strips
from .plots import Panel, panels, text
from .summary import (
    FAILS,
    HOLDS,
    NOT_MEASURED,
    OPEN,
    Estimate,
    Verdict,
    equals,
    lines,
    plain,
    printed,
    summarise,
    tidy,
    verdicts,
)

ICONS = {
    HOLDS: "M1.5 6.5 4.5 9.5 10.5 2.5",
    FAILS: "M2 2 10 10M10 2 2 10",
    OPEN: "M1 7.5C3 3 5 4 6 6S9 9 11 4.5",
    NOT_MEASURED: "M2 6H10",
}
NONE = "-"  # where there is no value
_MOST_WORDS = 3  # of a cell whose rows differ
_CHART = 132, 8  # of a drawn interval, width and margin
_MACHINE = ("host", "processor", "device", "driver", "threads", "version")  # what times depend on
_TEMPLATES = Path(__file__).parent / "templates"


# ---------------------------------------------------------------------------------------------------------------------
# What templates show


@dataclass(frozen=True)
class Head:
    """The head of a table's columns."""

    text: str
    is_number: bool = False
    columns: int = 1
    rows: int = 1
    is_paper: bool = False


@dataclass(frozen=True)
class Cell:
    """A cell of a table. kind: number, paper, words (where numbers would be), head, group, code or nothing. error: its
    standard error, which takes the room of so many digits, so that numbers stand below each other. rows: that it
    spans."""

    text: str
    kind: str = ""
    error: str = ""
    room: int = 0
    rows: int = 1


@dataclass(frozen=True)
class View:
    """A table as templates show it (macros.html): lines of heads, and groups of rows."""

    title: str
    heads: list[list[Head]]
    groups: list[list[list[Cell]]]
    note: str = ""


def render(template: str, **context: object) -> str:
    """A page from a template of this package, with all text escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {
        "digest": _digest,
        "version": __version__,
        "date": _date(datetime.datetime.now().timestamp()),
    }
    return environment.get_template(template).render(context)


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def svg_uri(svg: str) -> str:
    """A plot as an address that has all of it."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode()


def _date(seconds: float) -> str:
    return datetime.datetime.fromtimestamp(seconds).astimezone().strftime("%Y-%m-%d %H:%M %z")


# ---------------------------------------------------------------------------------------------------------------------
# Files


def write_report(
    folder: Path, experiment: Experiment, found: Sequence[tuple[Labelled, Result]], about: Mapping[str, object]
) -> None:
    """Write report.html, and beside it table.csv (table-1.csv and so on if there are several), claims.csv, rows.csv and
    plot-1.svg and so on (plot-1a.svg and so on where a plot has several panels).

    about: command, is_quick, seeds, wall_seconds, and what else there is to say. Raises SettingError, Error.
    """
    rows = tidy(found)
    views = []
    for number, table in enumerate(experiment.tables, start=1):
        name = "table.csv" if len(experiment.tables) == 1 else f"table-{number}.csv"
        view, values = table_view(table, rows, experiment)
        write_csv(folder / name, values)
        if view.groups:
            views.append(view)
    plotted = []
    for number, plot in enumerate(experiment.plots, start=1):
        drawn = panels(plot, experiment, rows)
        for letter, panel in zip("abcdefghijklmnopqrstuvwxyz", drawn, strict=False):
            own = f"plot-{number}{letter if len(drawn) > 1 else ''}.svg"
            _write(folder / own, panel.svg)
        if drawn:
            plotted.append(
                {"title": plot.title, "panels": [_shown_panel(plot.title, panel, len(drawn)) for panel in drawn]}
            )
    judged = [(claim, verdicts(claim, rows)) for claim in experiment.claims]
    write_csv(folder / "claims.csv", _claims_frame(judged))
    write_csv(folder / "rows.csv", rows)
    page = render("report.html", **_context(experiment, found, about, rows, views, plotted, judged))
    _write(folder / "report.html", page)


def write_index(folder: Path, experiments: Sequence[Experiment]) -> None:
    """Write index.html, which leads to the reports of experiments in the folder, with what became of their claims.
    Raises SettingError, Error."""
    entries = []
    for experiment in experiments:
        counts: Counter = Counter()
        file = folder / experiment.name / "claims.csv"
        if file.is_file():
            with file.open(encoding="utf-8", newline="") as stream:
                counts.update(row.get("verdict", "") for row in csv.DictReader(stream))
        entries.append(
            {
                "href": f"{experiment.name}/report.html",
                "name": experiment.name,
                "source": experiment.source,
                "title": experiment.title,
                "counts": counts,
            }
        )
    _write(folder / "index.html", render("index.html", entries=entries, verdicts=list(ICONS)))


def write_csv(file: Path, frame: pd.DataFrame) -> None:
    """Write a table with no cell that a spreadsheet takes for a formula. Raises SettingError, Error."""
    safe = frame.map(_harmless).rename(columns=_harmless)
    _write(file, safe.to_csv(index=False, lineterminator="\n"))


def _harmless(value: object) -> object:
    if not isinstance(value, str) or not value.lstrip(" ").startswith(("=", "+", "-", "@", "\t", "\r", "\n")):
        return value
    try:
        float(value)
    except ValueError:
        return "'" + value
    return value


def _write(file: Path, words: str) -> None:
    with atomic_path(file) as part:
        part.write_text(words, encoding="utf-8")


def _shown_panel(title: str, panel: Panel, count: int) -> dict:
    caption = panel.facet if count > 1 or panel.facet not in ("", NONE) else ""
    return {"caption": caption, "uri": svg_uri(panel.svg), "words": f"{title} {caption}".strip()}


def _beside_each_other(plotted: Sequence[dict]) -> list[dict]:
    """The same plots; those of one panel, where they follow each other, in one row, under their own titles."""
    found: list[dict] = []
    for plot in plotted:
        if len(plot["panels"]) > 1:
            found.append(plot)
            continue
        (panel,) = plot["panels"]
        caption = f"{plot['title']}: {panel['caption']}" if panel["caption"] else plot["title"]
        if not found or found[-1]["title"]:
            found.append({"title": "", "panels": []})
        found[-1]["panels"].append({**panel, "caption": caption})
    return found


# ---------------------------------------------------------------------------------------------------------------------
# The page


def _context(experiment, found, about, rows, views, plotted, judged) -> dict:
    pictures = strips(found)
    equal, has_equal = equal_view(experiment, rows), bool(experiment.ladder)
    has_scenes = any(one.scene for _, several in judged for one in several)
    sections = [
        *([("claims", "Claims")] if judged else []),
        ("tables", "Tables"),
        *([("equal", "Equal time and error")] if has_equal and equal.groups else []),
        *([("plots", "Plots")] if plotted else []),
        *([("pictures", "Pictures")] if pictures else []),
        ("again", "To measure it again"),
    ]
    counts = Counter(one.verdict for _, several in judged for one in several)
    return {
        "experiment": experiment,
        "about": {"command": "", "is_quick": False, "seeds": (), **about},
        "sections": sections,
        "claims": [_shown_claim(claim, several) for claim, several in judged],
        "counts": {verdict: counts[verdict] for verdict in ICONS if counts[verdict]},
        "has_scenes": has_scenes,
        "has_paper": any(claim.paper is not None for claim, _ in judged),
        "icons": ICONS,
        "tables": views,
        "equal": equal if has_equal and equal.groups else None,
        "ladder": _ladder(experiment, rows),
        "plotted": _beside_each_other(plotted),
        "strips": [_shown_strip(strip, experiment, rows) for strip in pictures],
        "is_narrow": bool(pictures) and all(strip.width <= strip.height for strip in pictures),
        "omitted": len(collected(found)) - len(pictures),
        "machines": len({tuple(result.about.get(name) for name in _MACHINE) for _, result in found}),
        "colors": _scale_colors(),
        "facts": _facts(found, about),
        "again": [
            view for view in (configurations_view(found), conditions_view(found), machines_view(found)) if view.groups
        ],
    }


def _ladder(experiment: Experiment, rows: pd.DataFrame) -> str:
    """The ladder's first and last rungs that were measured."""
    there = set(rows.get("configuration", ()))
    rungs = [rung for rung in experiment.ladder if rung in there]
    return f"{rungs[0]} to {rungs[-1]}" if rungs else ""


def _scale_colors() -> list[str]:
    errors = np.geomspace(LOW, HIGH, 24)[None]
    return ["#" + bytes(color.tolist()).hex() for color in to_colors(errors)[0]]


def _shown_strip(strip, experiment: Experiment, rows: pd.DataFrame) -> dict:
    errors = {}
    if experiment.error in rows:
        errors = summarise(rows[rows["scene"] == strip.scene], ("configuration",), Column(experiment.error, ""))
    shown = [
        {
            "name": one.name,
            "uri": one.uri,
            "difference": one.difference,
            "insets": one.insets,
            "error": f"{_head_of(experiment, experiment.error)} {errors[(one.name,)].mean:.3g}"
            if (one.name,) in errors and one.name != REFERENCE
            else "",
        }
        for one in strip.shown
    ]
    words = [strip.scene] if strip.scene else []
    words += [f"frame {strip.frame}"] + ([f"{strip.eye} eye"] if strip.eye != "mono" else [])
    has = any(one.difference for one in strip.shown)
    size = {"width": strip.width, "height": strip.height}
    return {"title": ", ".join(words), "shown": shown, "has_differences": has, **size}


# ---------------------------------------------------------------------------------------------------------------------
# Claims


def _shown_claim(claim: Claim, several: Sequence[Verdict]) -> dict:
    return {
        "says": claim.says,
        "measure": claim.measure,
        "of": claim.of + (f" / {claim.over}" if claim.over else ""),
        "claimed": _bounds(claim),
        "paper": NONE if claim.paper is None else _short(claim.paper),
        "lines": [
            {
                "verdict": one.verdict,
                "scene": one.scene or NONE,
                "value": NONE if one.value is None else _short(one.value),
                "interval": _interval(one),
                "drawn": _drawn(claim, one),
            }
            for one in several
        ],
    }


def _interval(one: Verdict) -> str:
    if one.low is None:
        return NONE if one.verdict != OPEN else "one run" if one.n == 1 else "no interval"
    return "exact" if one.low == one.high else f"{_short(one.low)} … {_short(one.high)}"


def _bounds(claim: Claim) -> str:
    if claim.low is not None and claim.high is not None:
        return f"= {claim.low:g}" if claim.low == claim.high else f"{claim.low:g} … {claim.high:g}"
    if claim.low is None and claim.high is None:
        return NONE
    return f"≥ {claim.low:g}" if claim.high is None else f"≤ {claim.high:g}"


def _short(value: float) -> str:
    words = f"{value:#.3g}".rstrip(".") if not 1000 <= abs(value) < 1e6 else f"{value:.0f}"
    return words.replace("-", "−", 1) if value < 0 else words


def _drawn(claim: Claim, one: Verdict) -> dict | None:
    """Where an interval and its bounds lie in a small picture. The scale has all of ours and the bounds; the paper's
    value only where it leaves room for the rest."""
    if one.low is None:
        return None
    bounds = [bound for bound in (claim.low, claim.high) if bound is not None]
    ends = [one.low, one.high, *bounds]
    width = (max(ends) - min(ends)) or abs(one.value) or 1.0
    if claim.paper is not None and min(ends) - 2 * width <= claim.paper <= max(ends) + 2 * width:
        ends.append(claim.paper)
    low, high = min(ends), max(ends)
    if high == low:
        low, high = low - width / 2, high + width / 2
    size, margin = _CHART

    def place(value: float) -> float:
        return round(margin + (size - 2 * margin) * (value - low) / (high - low), 1)

    left = 0.0 if claim.low is None else place(claim.low)
    right = float(size) if claim.high is None else place(claim.high)
    return {
        "area": (left, max(0.0, round(right - left, 1))),
        "bounds": [place(bound) for bound in bounds],
        "low": place(one.low),
        "high": place(one.high),
        "value": place(one.value),
        "paper": place(claim.paper) if claim.paper is not None and low <= claim.paper <= high else None,
    }


def _claims_frame(judged: Sequence[tuple[Claim, Sequence[Verdict]]]) -> pd.DataFrame:
    columns = [
        "claim",
        "scene",
        "verdict",
        "measure",
        "of",
        "over",
        "at least",
        "at most",
        "paper",
        "value",
        "low",
        "high",
        "seeds",
    ]
    found = [
        (claim.says, one.scene, one.verdict, claim.measure, claim.of, claim.over, claim.low, claim.high)
        + (claim.paper, one.value, one.low, one.high, one.n)
        for claim, several in judged
        for one in several
    ]
    return pd.DataFrame(found, columns=columns)


# ---------------------------------------------------------------------------------------------------------------------
# Tables


def table_view(table: Table, rows: pd.DataFrame, experiment: Experiment) -> tuple[View, pd.DataFrame]:
    """A table as it is shown, and as numbers. rows: as `summary.tidy`."""
    keys = lines(rows, table.by)
    estimates = [summarise(rows, table.by, column) if keys else {} for column in table.columns]
    words = _words(rows, table.by) if keys else {}
    dicts = [dict(zip(table.by, key, strict=True)) for key in keys]
    theirs = [[printed(experiment.paper, line, column) for line in dicts] for column in table.columns]
    has_value = [
        any(
            key in known or column.of in words.get(key, {})
            for column, known in zip(table.columns, estimates, strict=True)
        )
        for key in keys
    ]
    values: dict[str, list] = {name: [line[name] for line in dicts] for name in table.by}
    for column, known, paper in zip(table.columns, estimates, theirs, strict=True):
        own = [known.get(key) for key in keys]
        values[column.head] = [
            one.mean * column.scale if one else words.get(key, {}).get(column.of)
            for key, one in zip(keys, own, strict=True)
        ]
        values[f"{column.head}: standard error"] = [one and one.error * column.scale for one in own]
        values[f"{column.head}: seeds"] = [one and one.n for one in own]
        if any(value is not None for value in paper):
            values[f"{column.head}: paper"] = [value if value is None else value * column.scale for value in paper]
    frame = pd.DataFrame(values)[has_value] if keys else pd.DataFrame(columns=list(values))
    kept = [i for i, has in enumerate(has_value) if has]
    shown_by = _shown_by(table.by, [keys[i] for i in kept])
    with_paper = [any(paper[i] is not None for i in kept) for paper in theirs]
    body = []
    for i in kept:
        cells = []
        for column, known, paper, is_beside in zip(table.columns, estimates, theirs, with_paper, strict=True):
            cells.append(_value_cell(column, known.get(keys[i]), words.get(keys[i], {}).get(column.of)))
            cells += [Cell(NONE if paper[i] is None else _formed(paper[i], column), "paper")] if is_beside else []
        body.append(([text(dicts[i][name]) for name in shown_by], cells))
    is_words = [
        all(cell.kind != "number" for cell in column) for column in zip(*(cells for _, cells in body), strict=True)
    ]
    body = _aligned(body)
    heads = _heads(shown_by, table.columns, with_paper, is_words)
    note = _note(
        [estimates[c][keys[i]] for c in range(len(estimates)) for i in kept if keys[i] in estimates[c]], any(with_paper)
    )
    return View(table.title, heads, _grouped(body), note), frame


def _aligned(body: list[tuple[list[str], list[Cell]]]) -> list[tuple[list[str], list[Cell]]]:
    """The same rows, with as much room for errors in a column as the longest of them takes."""
    room = [max(len(cell.error) for cell in column) for column in zip(*(cells for _, cells in body), strict=True)]
    return [
        (names, [replace(c, room=r) if c.kind == "number" else c for c, r in zip(cells, room, strict=True)])
        for names, cells in body
    ]


def _shown_by(by: Sequence[str], keys: Sequence[tuple]) -> list[str]:
    """Those of `by` that tell something."""
    told = [name for i, name in enumerate(by) if any(key[i] not in (None, "") for key in keys)]
    return told or list(by[-1:])


def _heads(shown_by, columns, with_paper, is_words) -> list[list[Head]]:
    is_double = any(with_paper)
    first = [Head(name.capitalize(), rows=2 if is_double else 1) for name in shown_by]
    second, place = [], 0
    for column, is_beside in zip(columns, with_paper, strict=True):
        is_number = not (is_words[place] if place < len(is_words) else False)
        first.append(Head(column.head, is_number, 2 if is_beside else 1, 2 if is_double and not is_beside else 1))
        second += [Head("ours", True), Head("paper", True, is_paper=True)] if is_beside else []
        place += 2 if is_beside else 1
    return [first, second] if is_double else [first]


def _grouped(body: Sequence[tuple[list[str], list[Cell]]]) -> list[list[list[Cell]]]:
    """Rows, those with the same first name in one group, if there is more than one name."""
    groups: list[list[list[Cell]]] = []
    last = None
    for names, cells in body:
        if len(names) > 1:
            if not groups or names[0] != last:
                count = sum(other[0] == names[0] for other, _ in body)
                groups.append([])
                heads = [Cell(names[0], "group", rows=count)]
            else:
                heads = []
            last, names = names[0], names[1:]
        else:
            groups, heads = groups or [[]], []
        groups[-1].append([*heads, *(Cell(name, "head") for name in names), *cells])
    return groups


def _value_cell(column: Column, estimate: Estimate | None, words: str | None) -> Cell:
    if estimate is None:
        return Cell(words or NONE, "" if words else "number")
    error = "" if math.isnan(estimate.error) or estimate.error == 0.0 else _formed(estimate.error, column)
    return Cell(_formed(estimate.mean, column), "number", error)


def _formed(value: float, column: Column) -> str:
    return (
        f"{value * column.scale:{column.form}}".replace("-", "−", 1)
        if value < 0
        else f"{value * column.scale:{column.form}}"
    )


def _words(rows: pd.DataFrame, by: Sequence[str]) -> dict[tuple, dict[str, str]]:
    """What is no number, by the values of `by` and by column, where rows agree, and where they do not the first few."""
    keys = list(zip(*([plain(value) for value in rows[name]] for name in by), strict=True))
    found: dict[tuple, dict[str, dict]] = {}
    for name in rows.columns.difference(["job", "seeded", "counted"]):
        for key, value in zip(keys, rows[name], strict=True):
            if isinstance(value, (str, bool)):
                found.setdefault(key, {}).setdefault(name, {})[text(value)] = None
    return {key: {name: _joined(list(values)) for name, values in columns.items()} for key, columns in found.items()}


def _joined(values: list[str]) -> str:
    return ", ".join(values[:_MOST_WORDS]) + (
        f" and {len(values) - _MOST_WORDS} more" if len(values) > _MOST_WORDS else ""
    )


def _note(estimates: Sequence[Estimate], has_paper: bool) -> str:
    if not estimates:
        return ""
    n = max(one.n for one in estimates)
    said = f"Means over {n} seeds ± standard error." if n > 1 else "Of one run, without a standard error."
    return said + (" In italics, what the paper prints." if has_paper else "")


def _head_of(experiment: Experiment, name: str) -> str:
    """What tables call a column."""
    columns = (column for table in experiment.tables for column in table.columns)
    return next((column.head for column in columns if column.of == name and column.over is None), name)


def equal_view(experiment: Experiment, rows: pd.DataFrame) -> View:
    """All configurations beside the ladder."""
    found = equals(experiment, rows)
    names = ("scene", "configuration") if any(one.scene for one in found) else ("configuration",)
    time, error = Column("seconds", "", ".1f", 1e3), Column(experiment.error, "", ".3g")
    ratio = Column("", "", ".2f")
    body = []
    for one in found:
        cells = [_value_cell(time, one.seconds, None), _value_cell(error, one.error, None)]
        for value, why in ((one.at_time, one.why_no_time), (one.at_error, one.why_no_error)):
            cells.append(Cell(why, "words") if value is None else _value_cell(ratio, value, None))
        body.append(([getattr(one, name) for name in names], cells))
    last = ("error by the ladder's, in the same time", "ladder's time by its own, for the same error")
    heads = [Head(name.capitalize()) for name in names]
    heads += [Head(words, True) for words in ("frame, ms", _head_of(experiment, experiment.error), *last)]
    return View("Equal time and equal error", [heads], _grouped(_aligned(body)))


# ---------------------------------------------------------------------------------------------------------------------
# To measure it again


def _facts(found: Sequence[tuple[Labelled, Result]], about: Mapping) -> list[tuple[str, str]]:
    jobs = {labelled.job.key: result.about for labelled, result in found}
    began = [float(of["began"]) for of in jobs.values() if "began" in of]
    facts = [("Seeds", ", ".join(map(str, about.get("seeds", ()))) or NONE)]
    if began:
        first, last = _date(min(began)), _date(max(began))
        facts.append(("Measured", first if first == last else f"{first} to {last}"))
    loads = [of["load"] for of in jobs.values() if of.get("load") is not None]
    if loads:
        facts.append(("Load", f"{min(loads):.1f} to {max(loads):.1f} processes at work as jobs began, of all kinds"))
    total = sum(float(of.get("seconds", 0.0)) for of in jobs.values())
    facts.append(("Work", f"{len(jobs)} jobs, {_duration(total)} in all, without the references"))
    if "wall_seconds" in about:
        facts.append(
            ("This run", f"{_duration(float(about['wall_seconds']))}; what an earlier one had kept is not done again")
        )
    known = ("command", "is_quick", "seeds", "wall_seconds")
    return facts + [
        (name.capitalize().replace("_", " "), text(value)) for name, value in about.items() if name not in known
    ]


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def configurations_view(found: Sequence[tuple[Labelled, Result]]) -> View:
    """The options of each configuration."""
    options: dict[tuple[str, str], None] = {}
    for labelled, _ in found:
        for configuration in configurations_of(labelled.job):
            options.setdefault((configuration.name, configuration.options()))
    body = [[Cell(name, "head"), Cell(words, "code")] for name, words in options]
    note = "As clcache render and other commands take them. What is not named has its default."
    return View("Configurations", [[Head("Configuration"), Head("Options")]], [body] if body else [], note)


def configurations_of(job: Job) -> list[Configuration]:
    """The configurations that a job is told of."""
    told = job.parameters
    entries = [*told.get("configurations", ()), *([told["configuration"]] if "configuration" in told else [])]
    names = {field.name for field in fields(Configuration)}
    return [Configuration.of(e) for e in entries if isinstance(e, Mapping) and {"name", "method"} <= e.keys() <= names]


def conditions_view(found: Sequence[tuple[Labelled, Result]]) -> View:
    """What jobs are told, but for scene, seed and configurations."""
    scenes: dict[tuple[str, str, str], dict] = {}
    for labelled, _ in found:
        job = labelled.job
        own = {key: value for key, value in job.parameters.items() if key not in _TOLD_ELSEWHERE}
        told = " ".join(f"{name}={_told(value)}" for name, value in own.items() if value not in (None, [], {}, ""))
        scenes.setdefault((job.kind, told, _references(job)), {})[text(labelled.labels.get("scene"))] = None
    has_references = any(references for _, _, references in scenes)
    body = [
        [Cell(kind, "head"), Cell(", ".join(name for name in names if name) or NONE), Cell(told or NONE, "code")]
        + ([Cell(references or NONE)] if has_references else [])
        for (kind, told, references), names in scenes.items()
    ]
    heads = ["Kind of job", "Scenes", "Told", *(["References"] if has_references else [])]
    return View("Jobs", [[Head(words) for words in heads]], [body] if body else [])


_TOLD_ELSEWHERE = ("scene", "seed", "configurations", "configuration", "stages")


def _told(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


def _references(job: Job) -> str:
    told = [needed.parameters for needed in job.needs.values() if needed.kind == "reference"]
    if not told:
        return ""
    spp, frames, seeds = ({of.get(name) for of in told} for name in ("spp", "frame", "seed"))
    words = ", ".join(map(str, sorted(frames)))
    return f"path traced, {', '.join(map(str, spp))} spp, frames {words}, seeds {', '.join(map(str, sorted(seeds)))}"


def machines_view(found: Sequence[tuple[Labelled, Result]]) -> View:
    """Where results are from."""
    places: dict[tuple, list[dict]] = {}
    hidden = ("began", "seconds", "load")
    jobs = {labelled.job.key: result.about for labelled, result in found}
    names = list(dict.fromkeys(name for of in jobs.values() for name in of if name not in hidden))
    for of in jobs.values():
        places.setdefault(tuple(text(of.get(name)) for name in names), []).append(of)
    body = [
        [
            *(Cell(value) for value in place),
            Cell(str(len(several)), "number"),
            Cell(f"{sum(float(of.get('seconds', 0.0)) for of in several):.1f}", "number"),
        ]
        for place, several in places.items()
    ]
    heads = [*(Head(name.capitalize()) for name in names), Head("Jobs", True), Head("Seconds", True)]
    return View("Machines", [heads], [body] if body else [])
