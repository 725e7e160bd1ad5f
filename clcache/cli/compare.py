"""`clcache compare`: the error of a picture or of a folder of frames against its reference; the table on stdout."""

import argparse
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import SettingError
from .terminal import printable, say

if TYPE_CHECKING:
    from ..metrics import Comparison, Row

MEAN, SEQUENCE = "mean", "sequence"  # of the pictures' values, and of all pictures together


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    parser = subparsers.add_parser(
        "compare",
        help="compare a picture, or a folder of frames, with its reference",
        description="Compare two pictures (EXR, Radiance HDR, PNG) or two folders of them, matched by file name. relmse (the"
        " relative squared error, RSE) and rmse are of linear radiance, ssim-linear of linear radiance clipped to 0 .. 1; psnr, ssim,"
        " ms-ssim, flip and cpbd of what a display shows (the tone curve and encoding of clcache's PNG files; PNG files as they"
        " are). cpbd is the sharpness of a picture by itself: -ref is the reference's. Of a folder there are, too, the mean of the"
        " pictures' values, and the values of the sequence, which differ from the mean for rmse alone: it is taken over all pixels."
        " A NaN or infinite pixel is an error.",
    )
    add = parser.add_argument
    add("test", metavar="TEST", type=Path, help="a picture or a folder")
    add("reference", metavar="REF", type=Path, help="what it is compared with, of the same kind")
    add(
        "--metrics",
        metavar="NAME,...",
        type=_names,
        help="of relmse, rmse, psnr, ssim, ssim-linear, ms-ssim, flip, cpbd (default: all that are installed and that the size allows)",
    )
    add(
        "--temporal",
        action="store_true",
        help="also the mean squared difference between each frame and the one before it, reprojected by Z and the cameras",
    )
    add("--stereo", action="store_true", help="the same between the views left and right of each frame")
    add(
        "--json", metavar="FILE", help="write the values as JSON to this file too; '-': to stdout, instead of the table"
    )
    add(
        "--heatmap",
        metavar="DIR",
        type=Path,
        help="write a PNG map of relative error for each picture, and of the reprojected differences; logarithmic, 0.1 %% to 100 %%",
    )
    add(
        "--max",
        dest="limits",
        metavar="METRIC=VALUE",
        type=_limit,
        action="append",
        default=[],
        help="exit with 1 if this is higher in any picture; for metrics where lower is better; repeatable",
    )


def run(args: argparse.Namespace) -> int:
    """Compare as the arguments say. Returns 0, or 1 where a limit is exceeded. Raises SettingError, Error."""
    from ..metrics import Comparison, means, summarize
    from ..output.files import check_target

    to_stdout = args.json == "-"
    if args.json and not to_stdout:
        check_target(args.json)
    if args.heatmap:
        check_target(args.heatmap / "map.png")
    comparison = Comparison(args.test, args.reference, args.metrics, temporal=args.temporal, stereo=args.stereo)
    _check_limits(args.limits, comparison.columns)
    for note in comparison.notes:
        say(f"note: {note}")

    rows = []
    table = None if to_stdout else Table(comparison)
    for row in _mapped(comparison, args.heatmap):
        rows.append((row.file, row.view, row.values))
        if table:
            table.line(row.file, row.view, row.values)
    summaries = {}
    if args.test.is_dir():
        found = [values for _, _, values in rows]
        summaries = {MEAN: means(comparison.columns, found), SEQUENCE: summarize(comparison.columns, found)}
    for name, values in summaries.items() if table else ():
        table.line(name, "", values)
    if args.json:
        _write_json(args, rows, summaries)
    return 1 if _over(args.limits, rows) else 0


class Table:
    """A table that is printed line by line, as the values come."""

    def __init__(self, comparison: "Comparison") -> None:
        self._columns = comparison.columns
        self._width = max(len(printable(name)) for name in (*comparison.files, MEAN, SEQUENCE))
        self._headed = False

    def line(self, file: str, view: str, values: dict[str, float]) -> None:
        """Print the values of one view of one file, `-` for those that do not exist."""
        if not self._headed:
            self._print("file", "view", self._columns)
            self._headed = True
        self._print(file, view, [f"{values[name]:.6g}" if name in values else "-" for name in self._columns])

    def _print(self, file: str, view: str, cells: list[str]) -> None:
        widths = [max(len(name), 11) for name in self._columns]
        line = [printable(file).ljust(self._width), view.ljust(5)]
        line += [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
        print("  ".join(line).rstrip(), flush=True)


def _mapped(comparison: "Comparison", folder: Path | None) -> Iterator["Row"]:
    """The rows; each row's maps are in the folder when it comes."""
    from ..metrics.heatmap import write_heatmap

    for row in comparison.rows():
        for name, values in row.maps.items() if folder else ():
            stem = Path(row.file).stem + ("" if row.view == "mono" else f"_{row.view}")
            write_heatmap(folder / f"{stem}_{name}.png", values)
        yield row


def _write_json(
    args: argparse.Namespace, rows: list[tuple[str, str, dict[str, float]]], summaries: dict[str, dict[str, float]]
) -> None:
    from ..output.files import atomic_path

    result = {
        "test": str(args.test),
        "reference": str(args.reference),
        "rows": [{"file": file, "view": view, **_finite(values)} for file, view, values in rows],
        **{name: _finite(values) for name, values in summaries.items()},
    }
    text = json.dumps(result, indent=1, allow_nan=False)
    if args.json == "-":
        print(text)
        return
    with atomic_path(args.json) as part:
        part.write_text(text + "\n", encoding="utf-8")


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    """JSON has no infinity (the psnr of equal pictures) and no NaN (the difference of no pixel): null stands for both."""
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def _check_limits(limits: list[tuple[str, float]], columns: list[str]) -> None:
    for name, _ in limits:
        if name not in columns:
            raise SettingError(f"--max {name}: is not measured here; expected one of {', '.join(columns)}")


def _over(limits: list[tuple[str, float]], rows: list[tuple[str, str, dict[str, float]]]) -> bool:
    """Whether a value is above its limit; says which. NaN is: there was nothing to measure."""
    over = False
    for name, limit in limits:
        above = [(value, file, view) for file, view, of in rows if name in of and not (value := of[name]) <= limit]
        if above:
            over = True
            value, file, view = max(above)
            say(
                f"clcache: {name} is above {limit:g} in {len(above)} of {len(rows)} pictures; most in {file} ({view}): {value:g}"
            )
    return over


def _names(text: str) -> tuple[str, ...]:
    from ..metrics import METRICS

    names = tuple(filter(None, text.split(",")))
    unknown = [name for name in names if name not in METRICS]
    if unknown or not names:
        raise argparse.ArgumentTypeError(f"{unknown[0] if unknown else text!r}: expected names of {', '.join(METRICS)}")
    return names


def _limit(text: str) -> tuple[str, float]:
    from ..metrics import METRICS

    name, _, number = text.partition("=")
    lower_is_better = [m.name for m in METRICS.values() if m.lower_is_better] + ["temporal", "stereo"]
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if name not in lower_is_better or not limit >= 0.0:
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected METRIC=VALUE with a value >= 0 and a metric of {', '.join(lower_is_better)}"
        )
    return name, limit
