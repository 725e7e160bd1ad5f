"""Plots of a report, as SVG that follows the reader's light or dark.

Means over seeds with their standard errors. What the paper prints is dashed and hollow; where it is of another order
than ours it has an axis of its own, as what compares are the proportions. No two series differ by colour alone: each
has a marker as well, and each bar its name. The colours are those of Okabe and Ito (2008), darkened where they would be
faint on white.
"""

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, MaxNLocator

from .experiment import Column, Experiment, Plot
from .summary import Estimate, is_time, lines, printed, summarise

COLORS = ("#0072B2", "#D55E00", "#009E73", "#B8609A", "#C08A00", "#3E9FD6", "#7A6FD0", "#8A8A8A")
MARKERS = "osD^vP*X"
INK, FAINT, PAPER = "#24292f", "#d4d8dd", "#6b7280"  # of text and axes; of lines behind; of what is the paper's
DARK = {INK: "#e3e6ea", FAINT: "#3a4149", PAPER: "#a0a8b3"}  # the same where the page is dark
FONTS = "system-ui, 'Segoe UI', Roboto, Helvetica, Arial, 'DejaVu Sans', sans-serif"  # what readers have
WIDTH = 4.7  # inches, at 96 dots of a screen each
OWN_SCALE = 4.0  # how many times ours the paper's values are, or ours theirs, before they get an axis of their own
_STYLE = {
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",  # by whose widths all is laid out; it comes with matplotlib
    "font.size": 9.0,
    "text.color": INK,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "text.parse_math": False,
}


@dataclass(frozen=True)
class Panel:
    """A plot of one value of the plot's facet."""

    facet: str
    svg: str


@dataclass(frozen=True)
class Point:
    """A point: x is a number or a word. name: of the configuration."""

    x: Estimate | str
    y: Estimate
    name: str


def panels(plot: Plot, experiment: Experiment, rows: pd.DataFrame) -> list[Panel]:
    """A panel for each facet that has values. rows: as `summary.tidy`."""
    facets = [facet for (facet,) in lines(rows, (plot.facet,))] if plot.facet in rows else [None]
    found = []
    for facet in facets:
        own = (
            rows
            if plot.facet not in rows
            else rows[rows[plot.facet].isna() if facet is None else rows[plot.facet] == facet]
        )
        series = series_of(plot, own)
        if series:
            found.append(Panel(text(facet), _drawn(plot, experiment, facet, series)))
    return found


def series_of(plot: Plot, rows: pd.DataFrame) -> dict[str, list[Point]]:
    """The points of a panel by the values of `by`. Rows of one configuration make one point, but where x tells them
    apart."""
    if plot.x not in rows or plot.y not in rows:
        return {}
    is_key = plot.kind == "bars" or plot.x == "frame" or "configuration" not in rows or _tells_apart(rows[plot.x])
    names = ["configuration"] if "configuration" in rows else []
    by = [name for name in (plot.by, *names) if name in rows] + ([plot.x] if is_key else [])
    by = list(dict.fromkeys(by))
    if plot.x == "frame" and "counted" in rows:  # all of them, as caches that fill are what is to be seen
        rows = rows.drop(columns="counted")
    y = summarise(rows, by, Column(plot.y, ""))
    x = {} if is_key else summarise(rows, by, Column(plot.x, ""))
    found: dict[str, list[Point]] = {}
    for line in lines(rows, by):
        own = dict(zip(by, line, strict=True))
        at = own[plot.x] if is_key else x.get(line)
        if line not in y or at is None or not _can_be_drawn(plot, at, y[line]):
            continue
        if is_key:
            is_number = plot.kind != "bars" and not isinstance(at, str)
            at = Estimate(float(at), math.nan, 0) if is_number else text(at)
        name = text(own.get("configuration", ""))
        found.setdefault(text(own.get(plot.by, "")), []).append(Point(at, y[line], name))
    return found


def _tells_apart(values: pd.Series) -> bool:
    return all(isinstance(value, str) for value in values.dropna())


def _can_be_drawn(plot: Plot, x: object, y: Estimate) -> bool:
    x = x.mean if isinstance(x, Estimate) else x
    is_above = not isinstance(x, (int, float)) or x > 0
    return ("x" not in plot.log or is_above) and ("y" not in plot.log or y.mean > 0)


def text(value: object) -> str:
    """A value of a label as words."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


# ---------------------------------------------------------------------------------------------------------------------
# Drawing


def _drawn(plot: Plot, experiment: Experiment, facet: object, series: dict[str, list[Point]]) -> str:
    draw = _bars if plot.kind == "bars" else _points
    return as_svg(lambda: draw(plot, experiment, facet, series), f"{plot.title}/{facet}")


def as_svg(draw: Callable[[], Figure], name: str) -> str:
    """What is drawn, in the style of all plots. name: the same for the same plot, and no other of a page."""
    with matplotlib.rc_context(_STYLE | {"svg.hashsalt": name}):
        stream = io.StringIO()
        draw().savefig(stream, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return _for_both(stream.getvalue())


def _for_both(svg: str) -> str:
    """The same with the colours of text and axes changed where the page is dark."""
    rules = "".join(
        f'[style*="{kind}: {light}"]{{{kind}:{dark}!important}}'
        for light, dark in DARK.items()
        for kind in ("fill", "stroke")
    )
    svg = svg[svg.index("<svg") :].replace("'DejaVu Sans'", FONTS)
    return svg.replace("<defs>", f"<style>@media(prefers-color-scheme:dark){{{rules}}}</style><defs>", 1)


def _bars(plot: Plot, experiment: Experiment, facet: object, series: dict[str, list[Point]]) -> Figure:
    """Lying bars, a row for each x, in which each series has one."""
    words = list(dict.fromkeys(point.x for points in series.values() for point in points))
    is_one_each = all(len(points) == 1 for points in series.values()) and len(series) == len(words)
    groups = {"": [points[0] for points in series.values()]} if is_one_each else series
    theirs = {
        (group, point.x): _printed(plot, experiment, facet, point, group if not is_one_each else point.x)
        for group, points in groups.items()
        for point in points
    }
    known = {key: value for key, value in theirs.items() if value is not None}
    thick = 0.8 / (len(groups) + (1 if known else 0))
    height = (
        0.75
        + 0.3 * len(words) * max(1.0, 0.55 * (len(groups) + bool(known)))
        + (0.35 if len(groups) > 1 or known else 0)
    )

    def alone(group: str, point: Point) -> float:  # the bar of a pair that has no other
        return thick / 2 if known and len(groups) == 1 and (group, point.x) not in known else 0.0

    figure = Figure((WIDTH, height), layout="constrained")
    axes = figure.subplots()
    for rank, (group, points) in enumerate(groups.items()):
        ys = [words.index(point.x) + rank * thick + alone(group, point) for point in points]
        axes.barh(
            ys, [p.y.mean for p in points], thick * 0.92, color=COLORS[rank % len(COLORS)], label=group or "measured"
        )
        errors = [0.0 if math.isnan(p.y.error) else p.y.error for p in points]
        axes.errorbar([p.y.mean for p in points], ys, xerr=errors, fmt="none", ecolor=INK, elinewidth=1, capsize=2)
    if known:
        ours = max(abs(p.y.mean) for points in groups.values() for p in points)
        target, label = _scale_of_paper(axes, plot, ours, max(map(abs, known.values())), "x")
        ys = [
            words.index(x) + (len(groups) if len(groups) == 1 else list(groups).index(group)) * thick
            for group, x in known
        ]
        target.barh(
            ys, list(known.values()), thick * 0.92, facecolor="none", edgecolor=PAPER, linestyle="--", label=label
        )
    axes.set_yticks(
        [i + thick * (len(groups) - 1 + (1 if known and len(groups) == 1 else 0)) / 2 for i in range(len(words))], words
    )
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(plot.y_head or plot.y)
    scales(axes, "x" if "y" in plot.log else "", {"x": plot.y})
    if len(groups) > 1 or known:
        _legend(figure)
    return figure


def _points(plot: Plot, experiment: Experiment, facet: object, series: dict[str, list[Point]]) -> Figure:
    """Lines or points. The rungs of the ladder are one line."""
    rungs = [
        point
        for name, points in series.items()
        for point in points
        if plot.by == "configuration" and name in experiment.ladder
    ]
    is_ladder = plot.kind == "points" and len(rungs) > 1
    others = {name: points for name, points in series.items() if not (is_ladder and name in experiment.ladder)}
    entries = len(others) + is_ladder
    figure = Figure((WIDTH, 3.1 + 0.2 * math.ceil(entries / 2)), layout="constrained")
    axes = figure.subplots()
    if is_ladder:
        rungs.sort(key=lambda point: experiment.ladder.index(point.name))
        _line(axes, rungs, PAPER, ".", f"{rungs[0].name} to {rungs[-1].name}", "-", faint=True)
        for point in rungs:
            at = (point.x.mean, point.y.mean)
            axes.annotate(point.name, at, (4, 4), textcoords="offset points", fontsize=7.5, color=PAPER)
    theirs = {name: _their_points(plot, experiment, facet, name, points) for name, points in others.items()}
    largest = max((abs(p.y.mean) for points in others.values() for p in points), default=1.0)
    known = [y for points in theirs.values() for _, y in points]
    beside, label = axes, "paper"
    if known:
        beside, label = _scale_of_paper(axes, plot, largest, max(map(abs, known)), "y")
    for rank, (name, points) in enumerate(others.items()):
        color, marker = COLORS[rank % len(COLORS)], MARKERS[(rank + rank // len(COLORS)) % len(MARKERS)]
        if plot.kind == "line" and not isinstance(points[0].x, str):
            points = sorted(points, key=lambda point: point.x.mean)
        _line(axes, points, color, marker, name or "measured", "-" if plot.kind == "line" else "")
        if theirs[name]:
            style = "--" if plot.kind == "line" else ""
            beside.plot(
                *zip(*theirs[name], strict=True),
                color=color,
                linestyle=style,
                marker=marker,
                markerfacecolor="none",
                linewidth=1,
            )
    if known:
        axes.plot([], [], color=PAPER, linestyle="--", marker="o", markerfacecolor="none", linewidth=1, label=label)
    axes.set_xlabel(plot.x_head or plot.x)
    axes.set_ylabel(plot.y_head or plot.y)
    scales(axes, plot.log, {"x": plot.x, "y": plot.y})
    if entries > 1 or known:
        _legend(figure)
    return figure


def _line(
    axes: Axes, points: Sequence[Point], color: str, marker: str, label: str, style: str, faint: bool = False
) -> None:
    xs = [point.x if isinstance(point.x, str) else point.x.mean for point in points]
    ys = [point.y.mean for point in points]
    y_errors = _errors(axes, points, "y")
    x_errors = None if isinstance(points[0].x, str) else _errors(axes, points, "x")
    is_alone = len(points) == 1 and not style
    axes.errorbar(
        xs,
        ys,
        y_errors,
        x_errors,
        color=color,
        marker=marker,
        markersize=6.5 if is_alone else 4.5,
        markevery=max(1, len(points) // 8) if style else 1,
        label=label,
        linestyle=style,
        linewidth=1.0 if faint else 1.4,
        elinewidth=0.9,
        capsize=2 if len(points) < 12 else 0,
    )


def _errors(axes: Axes, points: Sequence[Point], which: str) -> list[list[float]]:
    """Downwards and upwards; downwards no further than to a thousandth, so that logarithms exist."""
    estimates = [getattr(point, which) for point in points]
    errors = [0.0 if math.isnan(one.error) else one.error for one in estimates]
    return [[min(e, 0.999 * abs(one.mean)) for e, one in zip(errors, estimates, strict=True)], errors]


def _scale_of_paper(axes: Axes, plot: Plot, ours: float, theirs: float, which: str) -> tuple[Axes, str]:
    """The axes in which the paper's values are drawn, and what the legend says of them. which: the direction of
    values."""
    is_near = not is_time(plot.y) and ours > 0.0 and theirs > 0.0 and 1 / OWN_SCALE <= ours / theirs <= OWN_SCALE
    if is_near or ("y" in plot.log and which == "y"):
        return axes, "paper"
    twin = axes.twiny() if which == "x" else axes.twinx()
    twin.grid(visible=False)
    twin.spines["top" if which == "x" else "right"].set_visible(True)
    label = f"{plot.y_head or plot.y}, paper"
    twin.set_xlabel(label, color=PAPER) if which == "x" else twin.set_ylabel(label, color=PAPER)
    return twin, "paper (own scale)"


def _printed(plot: Plot, experiment: Experiment, facet: object, point: Point, by: str) -> float | None:
    line = {plot.facet: facet, "configuration": point.name, plot.x: point.x, plot.by: by}
    return printed(experiment.paper, line, Column(plot.y, ""))


def _their_points(plot: Plot, experiment: Experiment, facet: object, by: str, points: Sequence[Point]) -> list[tuple]:
    found = []
    for point in points:
        line = {plot.facet: facet, plot.by: by, **({"configuration": point.name} if point.name else {})}
        x = point.x
        if isinstance(x, Estimate):
            x = x.mean if x.n == 0 else printed(experiment.paper, line, Column(plot.x, ""))
            line |= {plot.x: x} if point.x.n == 0 else {}
        y = printed(experiment.paper, line, Column(plot.y, ""))
        found += [(x, y)] if x is not None and y is not None else []
    return found


def scales(axes: Axes, log: str, columns: Mapping[str, str] | None = None) -> None:
    """Make axes logarithmic, and write their values so that they can be read. log: "", "x", "y" or "xy". columns: what
    is on the axes by "x" and "y", if they are columns of rows."""
    columns = {"x": "", "y": ""} if columns is None else columns
    for which, column in columns.items():
        axis = axes.xaxis if which == "x" else axes.yaxis
        form = EngFormatter("s") if is_time(column) else None
        if which in log:
            getattr(axes, f"set_{which}scale")("log")
            low, high = getattr(axes, f"get_{which}lim")()
            is_short = high / low < 150.0
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if is_short else (1.0,), numticks=12))
            form = form or ((lambda value, _: f"{value:g}") if is_short else (lambda value, _: _power(value)))
            axis.set_minor_formatter(lambda value, _: "")
        elif column == "frame":
            axis.set_major_locator(MaxNLocator(integer=True))
        if form:
            axis.set_major_formatter(form)
    for twin in axes.figure.axes:
        if twin is not axes and is_time(columns.get("y", columns["x"])):
            (twin.yaxis if "y" in columns else twin.xaxis).set_major_formatter(EngFormatter("s"))


def _power(value: float) -> str:
    """A power of ten in words: from 0.01 to 100 in digits."""
    power = round(math.log10(value))
    raised = str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{value:g}" if abs(power) <= 2 else f"10{raised}"


def _legend(figure: Figure) -> None:
    handles: dict[str, object] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    longest = max(map(len, handles))
    columns = min(len(handles), 4 if longest < 10 else 3 if longest < 16 else 2 if longest < 32 else 1)
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=columns, handlelength=1.6, columnspacing=1.2
    )
