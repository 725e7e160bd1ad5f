"""`clcache experiment`: tables and figures of the papers, measured here, beside what the papers say."""

import argparse
import shlex
import sys
import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import SettingError
from . import jobs
from .terminal import say

if TYPE_CHECKING:
    from ..experiments.experiment import Experiment

SEEDS, QUICK_SEEDS = 3, 2
HERE, OF_CLONE = Path("data"), Path(__file__).parents[2] / "data"  # where the scenes may be


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    parser = subparsers.add_parser(
        "experiment",
        help="reproduce tables and figures of the papers",
        description="Measure what a table or figure of the papers shows, and set it beside the paper's: DIR/NAME/report.html, with tables as"
        " CSV and plots as SVG beside it. Each job's result is kept in DIR/results, so that an experiment which was interrupted goes on"
        " where it was, and one that shares jobs with another does not repeat them. A measurement in full takes minutes to an hour on a few cores;"
        " with --quick less than a minute, at a size that shows that all works and no more.",
    )
    add = parser.add_argument
    add("names", metavar="NAME", nargs="+", help="experiments; or list, which lists them; or all")
    jobs.add_options(parser, "experiments")
    add("--quick", action="store_true", help="at small size; the report says so")
    add(
        "--seeds",
        metavar="N",
        type=jobs.whole(1, 1000),
        help=f"repetitions, from which error bars are (default: {SEEDS}; with --quick {QUICK_SEEDS})",
    )
    add(
        "--data",
        metavar="DIR",
        type=Path,
        help="folder of the project's scenes (default: data/ here, else of its clone)",
    )


def run(args: argparse.Namespace) -> int:
    """List or measure as the arguments say. Returns 0. Raises SceneError, SettingError, DeviceError, Error."""
    from ..experiments.catalogue import EXPERIMENTS

    if args.names == ["list"]:
        print(_listing(EXPERIMENTS.values()))
        return 0
    chosen = list(EXPERIMENTS.values()) if args.names == ["all"] else [_known(name) for name in args.names]
    _measure(chosen, args)
    return 0


def _measure(chosen: list["Experiment"], args: argparse.Namespace) -> None:
    from ..experiments.job import Machine, Store
    from ..experiments.report import write_index, write_report
    from ..experiments.runner import cluster, run_jobs
    from ..output.files import check_target

    seeds = range(1, 1 + (args.seeds or (QUICK_SEEDS if args.quick else SEEDS)))
    data = args.data or (HERE if HERE.is_dir() else OF_CLONE)
    store, machine = Store(args.folder / "results"), Machine(args.device, args.threads)
    check_target(args.folder / "results" / "any")
    with cluster(args.scheduler, args.workers) as client:
        if not client.scheduler_info()["workers"]:
            say(f"{args.scheduler}: has no workers; waiting for one")
        for experiment in chosen:
            start = time.perf_counter()
            labelled = experiment.jobs(data, seeds, args.quick)
            with jobs.JobProgress(experiment.name) as progress:
                results = run_jobs([one.job for one in labelled], store, client, machine, progress)
            about = {
                "command": shlex.join(["clcache", *sys.argv[1:]]),
                "is_quick": args.quick,
                "seeds": list(seeds),
                "wall_seconds": time.perf_counter() - start,
            }
            folder = args.folder / experiment.name
            write_report(folder, experiment, list(zip(labelled, results, strict=True)), about)
            print(folder / "report.html", flush=True)
    if len(chosen) > 1:
        write_index(args.folder, chosen)
        print(args.folder / "index.html")


def _known(name: str) -> "Experiment":
    import difflib

    from ..experiments.catalogue import EXPERIMENTS

    if name in EXPERIMENTS:
        return EXPERIMENTS[name]
    if name in ("list", "all"):
        raise SettingError(f"experiment {name}: stands alone; expected it without other names")
    near = difflib.get_close_matches(name, EXPERIMENTS, 1)
    hint = f"did you mean {near[0]}?" if near else "'clcache experiment list' lists all"
    raise SettingError(f"experiment {name}: unknown; {hint}")


def _listing(experiments) -> str:
    lines = []
    for experiment in experiments:
        lines.append(f"{experiment.name:24} {experiment.source}: {experiment.title}")
        lines += textwrap.wrap(experiment.about, 116, initial_indent="    ", subsequent_indent="    ")
    return "\n".join(lines)
