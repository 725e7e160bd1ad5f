"""`clcache bench`: how fast the kernels are, as a table on stdout that grows as the results come, and as JSON."""

import argparse
import json
import re
from typing import TYPE_CHECKING

from .terminal import printable, say

if TYPE_CHECKING:
    from ..bench import Result, Run

_COLUMNS = (("benchmark", -40), ("scene", -11), ("items", 10), ("median ms", 10), ("min", 9), ("max", 9), ("rate", 9))
_COLUMNS += (("", -13), ("bound", 6), ("Embree", 8), ("ratio", 6), ("agree %", 8), ("bytes/triangle", 14))


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the command line."""
    parser = subparsers.add_parser(
        "bench",
        help="measure the kernels: rays, builds of trees, sorts, passes, memory",
        description="Measure kernels on a device, with one thread and with all, each in a process of its own on as many cores."
        " Seconds are the device's own, medians of --repeats runs after one that warms up. Bound: how many times longer it took"
        " than moving its arguments takes a copy on the same threads. Ratio: how many times faster than Embree, on the same rays,"
        " where embreex is installed; agree: the part of the hits that are the same.",
    )
    add = parser.add_argument
    add("names", metavar="NAME", nargs="*", help="what to measure (default: all that --list shows)")
    add("--list", action="store_true", help="list what can be measured")
    add(
        "--scene",
        dest="scenes",
        metavar="FILE",
        action="append",
        default=[],
        help="measure on this scene; repeatable (default: scenes of the project's data/)",
    )
    add("--size", metavar="WxH", type=_size, default=(640, 360), help="of the image that is traced (default: 640x360)")
    add("--repeats", metavar="N", type=_repeats, default=5, help="runs that count (default: 5)")
    add("--device", metavar="SPEC", help="index, or part of the platform's or the device's name; or all that work: all")
    add("--threads", metavar="N,...", type=_threads, default=(), help="CPU threads (default: one, and all)")
    add(
        "--json",
        metavar="FILE",
        help="write the results as JSON to this file too; '-': to stdout, instead of the table",
    )


def run(args: argparse.Namespace) -> int:
    """Measure as the arguments say. Returns 0. Raises SceneError, SettingError, DeviceError, Error."""
    from .. import bench
    from ..bench import embree
    from ..output.files import atomic_path, check_target

    if args.list:
        for name, family in bench.FAMILIES.items():
            print(f"{name:11}  {family.meaning}")
        return 0
    families = bench.check_families(args.names)
    to_stdout = args.json == "-"
    if args.json and not to_stdout:
        check_target(args.json)
    note = embree.NOTE if embree.is_installed() and "rays" in families else None
    if note:
        say(f"note: {note}")
    runs = []
    for candidate, threads in bench.targets(args.device, args.threads):
        for count in threads:
            job = bench.Job(families, str(candidate.index), count, args.repeats, args.size, tuple(args.scenes))
            runs.append(bench.Run(candidate, job))
            _measure(runs[-1], quiet=to_stdout)
    if not to_stdout:
        _print_scaling(runs)
    text = json.dumps(bench.report(runs, note), indent=1, allow_nan=False)
    if to_stdout:
        print(text)
    elif args.json:
        with atomic_path(args.json) as part:
            part.write_text(text + "\n", encoding="utf-8")
    return 0


def _measure(run: "Run", quiet: bool) -> None:
    from ..bench import measure

    threads = run.job.threads
    heading = f"device {run.candidate}" + (f", {threads} thread{'s' * (threads > 1)}" if threads else "")
    if not quiet:
        print(printable(heading))
        print(_line([name for name, _ in _COLUMNS]), flush=True)
    for result in measure(run.job):
        run.results.append(result)
        if not quiet:
            print(_line(_cells(result, run)), flush=True)


def _cells(result: "Result", run: "Run") -> list[str]:
    of = result.entry(run.bandwidth["copy"])
    factor, unit = (1e-9, "GB/s") if result.unit == "bytes" else (1e-6, f"M{result.unit}/s")
    times = [f"{1000 * of['seconds'][which]:.3f}" for which in ("median", "min", "max")]
    return [
        f"{result.family} {result.name}",
        printable(result.scene),
        f"{result.items}",
        *times,
        f"{factor * result.rate:.2f}",
        unit,
        f"{of['of_bound']:.2f}" if "of_bound" in of else "",
        f"{factor * of['embree']['rate']:.2f}" if "embree" in of else "",
        f"{result.ratio:.2f}" if result.ratio is not None else "",
        f"{100 * result.agree:.3f}" if result.agree is not None else "",
        f"{result.bytes_per_triangle:.1f}" if result.bytes_per_triangle is not None else "",
    ]


def _line(cells: list[str]) -> str:
    padded = (c.ljust(-width) if width < 0 else c.rjust(width) for c, (_, width) in zip(cells, _COLUMNS, strict=True))
    return " ".join(padded).rstrip()


def _print_scaling(runs: list["Run"]) -> None:
    from ..bench.report import scaling_pairs, scalings

    for few, many in scaling_pairs(runs):
        print(
            printable(
                f"device {few.candidate}: times faster with {many.job.threads} threads than with {few.job.threads}"
            )
        )
        for scaling in scalings(few, many):
            print(f"{scaling.family + ' ' + scaling.name:40} {printable(scaling.scene):11} {scaling.factor:10.2f}")


def _size(text: str) -> tuple[int, int]:
    from ..bench.ray_sets import TILE
    from ..renderer import MAX_PIXELS

    match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 0 < width * height <= MAX_PIXELS or width % TILE or height % TILE:
        raise argparse.ArgumentTypeError(f"{text!r}: expected WxH in pixels, multiples of {TILE}, such as 640x360")
    return width, height


def _repeats(text: str) -> int:
    if not re.fullmatch("[0-9]{1,4}", text) or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number, 1 .. 9999")
    return int(text)


def _threads(text: str) -> tuple[int, ...]:
    if not re.fullmatch("[0-9]{1,4}(,[0-9]{1,4})*", text):
        raise argparse.ArgumentTypeError(f"{text!r}: expected numbers of threads with commas between, such as 1,2")
    return tuple(dict.fromkeys(map(int, text.split(","))))
