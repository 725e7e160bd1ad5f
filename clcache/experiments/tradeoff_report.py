"""What a trade-off found: tables as CSV, plots, one HTML page, and words for the terminal."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ..errors import Error
from ..output.files import atomic_path
from . import plots
from .report import render, svg_uri, write_csv
from .tradeoff import METHODS, METRICS, Goal, Trial, advise, identity, pareto_front

_FORMS = {"memory": ".0f"}
_SENSED = ("time", *METRICS)
_WORDS = ("configuration", "method", "origin", "failed", "command")


# ---------------------------------------------------------------------------------------------------------------------
# Tables


def table(tried: Sequence[Trial], rows: Mapping[str, Mapping], command: str) -> pd.DataFrame:
    """A line for each configuration that was measured, fastest first: what it is, what was found, and in `front.METRIC` whether no other
    is better in time and that metric. Times are what each took as a multiple of path tracing beside it, times what that takes in the middle of
    all jobs: so what else the machine did, or which one it was, counts for little. rows: by identity. command: the beginning of what renders it. Raises Error where there is none."""
    lines = []
    for trial in tried:
        configuration = trial.configuration
        row = rows.get(identity(configuration))
        if row is not None:
            what = {"configuration": identity(configuration), "method": configuration.method, "origin": trial.origin}
            what |= dict.fromkeys(("failed", "seconds", "seconds_error", "relative", "yardstick"))
            what |= {name: None for metric in METRICS for name in (metric, f"{metric}_error") if name != "memory_error"}
            what |= dict.fromkeys(("stereo_reference", "cache"))
            lines.append(what | row | {"command": f"{command} {configuration.options()}"})
    if not lines:
        raise Error("nothing was measured; expected more time than --budget gives")
    found = pd.DataFrame(lines)
    numbers = [c for c in found.columns if c not in _WORDS]
    found[numbers] = found[numbers].astype(float)
    alike = found["relative"] * found["yardstick"].median()
    found["seconds_error"] *= alike / found["seconds"]
    found["seconds"] = alike
    for metric in METRICS:
        found[f"front.{metric}"] = pareto_front(found["seconds"].to_numpy(), found[metric].to_numpy())
    order = [c for c in found.columns if c != "command"] + ["command"]
    return found[order].sort_values(["seconds", "configuration"], kind="stable", ignore_index=True)


def measured(found: pd.DataFrame) -> list[str]:
    """The metrics that there are values of."""
    return [metric for metric in METRICS if found[metric].notna().any()]


def front(found: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Those that no other is better than in time and this metric, fastest first."""
    return found[found[f"front.{metric}"]]


def answer(found: pd.DataFrame, goal: Goal) -> list[str]:
    """What is recommended for a goal, in words, with the command to paste in lines of its own."""
    wish = _wish(goal)
    lines = []
    for advice in advise(goal, found["seconds"].to_numpy(), found[goal.metric].to_numpy()):
        if advice.row is None:
            return [f"{wish}: nothing was measured"]
        row = found.iloc[advice.row]
        said = wish if advice.is_met else f"{wish}: nothing of what was measured; what comes nearest"
        lines += [f"{said}: {expectation(row, goal.metric)}", f"    {row['command']}"]
    return lines


def _wish(goal: Goal) -> str:
    limit = "" if goal.error is None else f"{METRICS[goal.metric]} of at most {goal.error:g}"
    if goal.seconds is None:
        return limit
    return f"within {1e3 * goal.seconds:g} ms a frame" + (f" and with {limit}" if limit else "")


def expectation(row: Mapping, metric: str) -> str:
    """Time and metric of a configuration, with their standard errors, in words."""
    time = f"{1e3 * row['seconds']:.1f} ms{_plus_minus(row, 'seconds', 1e3, '.1f')} a frame"
    return f"{row['method']}, {time}, {METRICS[metric]} {number(row[metric], metric)}{_plus_minus(row, metric)}"


def _plus_minus(row: Mapping, name: str, scale: float = 1.0, form: str = ".2g") -> str:
    error = row.get(f"{name}_error")
    return "" if error is None or not math.isfinite(error) else f" ± {scale * error:{form}}"


def number(value: float, metric: str) -> str:
    """A metric's value in words."""
    return "-" if not math.isfinite(value) else f"{value:{_FORMS.get(metric, '.4g')}}"


def fronts_text(found: pd.DataFrame) -> str:
    """The fronts, one below the other, for a terminal."""
    parts = []
    for metric in measured(found):
        rows = [("ms a frame", "of path tracing", METRICS[metric], "configuration")]
        for _, row in front(found, metric).iterrows():
            options = row["command"].partition(" --method ")[2]
            rows.append((f"{1e3 * row['seconds']:.1f}", f"{row['relative']:.2f}", number(row[metric], metric), options))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join([*map(str.rjust, row[:3], widths), row[3]]) for row in rows]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


# ---------------------------------------------------------------------------------------------------------------------
# Plots


def plot_front(found: pd.DataFrame, metric: str) -> str:
    """A point for each configuration by time and metric, in each method's colour and shape, and the front, with numbers, as SVG."""

    def draw() -> Figure:
        figure = Figure(figsize=(plots.WIDTH, 3.6), layout="constrained")
        axes = figure.subplots()
        for place, method in enumerate(METHODS):
            own = found[(found["method"] == method) & found[metric].notna()]
            if len(own):
                style = {"color": plots.COLORS[place], "marker": plots.MARKERS[place], "linewidths": 0}
                axes.scatter(1e3 * own["seconds"], own[metric], 16, alpha=0.7, label=method, **style)
        best = front(found, metric)
        axes.step(1e3 * best["seconds"], best[metric], plots.INK, where="post", linewidth=1)
        for place, (_, row) in enumerate(best.iterrows(), start=1):
            at = (1e3 * row["seconds"], row[metric])
            axes.annotate(str(place), at, (3, 3), textcoords="offset points", fontsize=7.5)
        axes.set_xlabel("milliseconds a frame")
        axes.set_ylabel(METRICS[metric])
        plots.scales(axes, "xy" if (found[metric].dropna() > 0).all() else "x")
        figure.legend(loc="outside lower center", ncols=3, handletextpad=0.3, columnspacing=1.2)
        return figure

    return plots.as_svg(draw, f"front {metric}")


def plot_changes(changes: Sequence[Mapping], method: str) -> str:
    """For each change of a method's defaults how many times longer it takes, and how many times the error it has, as SVG."""
    own = _by_effect([c for c in changes if c["method"] == method])

    def draw() -> Figure:
        figure = Figure(figsize=(plots.WIDTH, 0.8 + 0.24 * len(own)), layout="constrained")
        axes = figure.subplots()
        places = np.arange(len(own))
        for place, name in enumerate(("time", "relmse")):
            factors = np.array([c[name] if c[name] and c[name] > 0 else np.nan for c in own], float)
            errors = np.array([c[f"{name}_error"] for c in own], float) / factors / math.log(2)
            style = {"color": plots.COLORS[place], "label": METRICS.get(name, name)}
            whiskers = {"xerr": np.nan_to_num(errors), "error_kw": {"elinewidth": 0.7, "ecolor": plots.INK}}
            axes.barh(places + 0.38 * (place - 0.5), np.log2(factors), 0.38, **style, **whiskers)
        axes.set_yticks(places, [f"{c['changed']}={_text(c['value'])}" for c in own], fontsize=7.5)
        axes.invert_yaxis()
        axes.axvline(0.0, color=plots.INK, linewidth=0.8)
        axes.xaxis.set_major_formatter(lambda power, _: f"{2.0**power:.2g}×")
        figure.legend(loc="outside lower center", ncols=2)
        return figure

    return plots.as_svg(draw, f"changes {method}")


def _text(value: object) -> str:
    """A setting's value, as --set takes it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


# ---------------------------------------------------------------------------------------------------------------------
# Files


def write(
    folder: Path, found: pd.DataFrame, changes: Sequence[Mapping], answers: Sequence[str], about: Mapping
) -> None:
    """All files of a trade-off. changes: as of `tradeoff.sensitivities`. about: command, conditions, machines, and how many configurations
    are left. Raises SettingError, Error."""
    write_csv(folder / "configurations.csv", found)
    fronts = []
    for metric in measured(found):
        best, plot = front(found, metric), plot_front(found, metric)
        write_csv(folder / f"front-{metric}.csv", best)
        _write(folder / f"front-{metric}.svg", plot)
        panel = {"caption": "", "uri": svg_uri(plot), "words": f"time and {METRICS[metric]} of all configurations"}
        fronts.append({"head": METRICS[metric], "panel": panel, "rows": _lines(best, metric)})
    numbers = [column for name in _SENSED for column in (name, f"{name}_error") if column != "memory_error"]
    sensed_frame = pd.DataFrame(changes, columns=["method", "changed", "value", "default", *numbers])
    write_csv(folder / "sensitivity.csv", sensed_frame)
    sensed = []
    for method in dict.fromkeys(c["method"] for c in _by_effect(changes)):
        plot = plot_changes(changes, method)
        _write(folder / f"sensitivity-{method}.svg", plot)
        sensed.append({"caption": method, "uri": svg_uri(plot), "words": f"what each change does to {method}"})
    page = render(
        "tradeoff.html",
        title=f"Time and accuracy in {Path(about['conditions'].scene['file']).parent.name}",
        about=about,
        answers=answers,
        fronts=fronts,
        sensed=sensed,
        changes=[
            {
                "what": f"{c['changed']}={_text(c['value'])}",
                **c,
                "factors": [_times(c[name], c.get(f"{name}_error")) for name in _SENSED],
            }
            for c in _by_effect(changes)
        ],
        heads=["time", *METRICS.values()],
        counts=found.groupby("method", sort=False).size().to_dict(),
        failed=found[found["failed"].notna()][["command", "failed"]].to_dict("records"),
    )
    _write(folder / "tradeoff.html", page)


def _lines(best: pd.DataFrame, metric: str) -> list[dict]:
    return [
        {
            "place": place,
            "method": row["method"],
            "time": f"{1e3 * row['seconds']:.1f}",
            "time_error": _plus_minus(row, "seconds", 1e3, ".1f"),
            "relative": f"{row['relative']:.2f}",
            "value": number(row[metric], metric),
            "error": _plus_minus(row, metric),
            "command": row["command"],
        }
        for place, (_, row) in enumerate(best.iterrows(), start=1)
    ]


def _by_effect(changes: Sequence[Mapping]) -> list[Mapping]:
    """Methods in their order, and in each what changes time and relMSE the most first."""

    def effect(change: Mapping) -> float:
        return max((abs(math.log(f)) for f in (change["time"], change["relmse"]) if f and f > 0), default=0.0)

    return sorted(changes, key=lambda c: (METHODS.index(c["method"]), -effect(c)))


def _times(factor: float | None, error: float | None) -> str:
    return "-" if factor is None else f"{factor:.3g}" + ("" if error is None else f" ± {error:.1g}")


def _write(file: Path, text: str) -> None:
    with atomic_path(file) as part:
        part.write_text(text, encoding="utf-8")
