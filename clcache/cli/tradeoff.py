"""`clcache tradeoff`: what a scene's time buys in accuracy, by all methods and settings; and which to use for a time or an error."""

import argparse
import contextlib
import importlib.util
import math
import re
import shlex
import sys
import time
from typing import TYPE_CHECKING, Self

from ..errors import Error, SettingError
from . import jobs
from .render import parse_frames, parse_size
from .terminal import printable, say

if TYPE_CHECKING:
    from ..experiments.job import Job, Machine, Store
    from ..experiments.tradeoff import Conditions, Goal, Space, Trial

CONFIGURATIONS = 200
SIZE = (192, 108)
FRAMES, SKIP = 16, 6
_UNITS = {"ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
_NEEDED = ("pandas", "matplotlib", "jinja2")
_ROUND = 2  # jobs for each worker between looks at the clock


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    parser = subparsers.add_parser(
        "tradeoff",
        help="measure what time buys in accuracy, and recommend settings",
        description="Render a sequence of the scene by many configurations of all methods, and measure time, error, difference between"
        " frames and between eyes, and memory: DIR/tradeoff.html, with tables as CSV and plots as SVG beside it. Tried are each method's"
        " defaults, each of the settings that trade accuracy for speed ('clcache settings' marks them) by itself, and points"
        " spread over them all. What is in DIR/results is not measured again: the same command goes on where it was interrupted, and"
        " answers other questions by --within and --error at once.",
    )
    add = parser.add_argument
    add("scene", metavar="SCENE", help="a .toml scene or a mesh file")
    jobs.add_options(parser, "tradeoff")
    add(
        "--size",
        metavar="WxH",
        type=parse_size,
        default=SIZE,
        help=f"pixels; times are of this size (default: {SIZE[0]}x{SIZE[1]})",
    )
    add(
        "--frames",
        metavar="A:B",
        type=parse_frames,
        help=f"frame numbers from A to B - 1 (default: {FRAMES} from the scene's first on)",
    )
    add(
        "--skip",
        metavar="N",
        type=jobs.whole(0, 10**6),
        default=SKIP,
        help="frames at the start, in which caches fill, that count for nothing (default: %(default)s)",
    )
    add("--mono", dest="stereo", action="store_false", help="one eye (default: two)")
    add("--methods", metavar="M,...", type=_names, help="which to try (default: all)")
    add(
        "--configurations",
        metavar="N",
        type=jobs.whole(1, 100_000),
        default=CONFIGURATIONS,
        help="how many are tried (default: %(default)s)",
    )
    add(
        "--refine",
        metavar="N",
        type=jobs.whole(1, 100_000),
        default=0,
        help="after these so many more, near the best by time and relMSE (needs the package optuna)",
    )
    add("--budget", metavar="TIME", type=duration, help="begin no more measurements after this time, such as 30m")
    add(
        "--within",
        metavar="TIME",
        type=duration,
        help="recommend the least error within this time a frame, such as 100ms",
    )
    add(
        "--error",
        metavar="[METRIC=]X",
        type=_limit,
        help="recommend the fastest with no more than this relMSE, or other metric: flip, flicker, stereo, memory",
    )
    add(
        "--seed",
        metavar="N",
        type=jobs.whole(0, 10**9),
        default=1,
        help="of images, and of which configurations are tried (default: %(default)s)",
    )


def run(args: argparse.Namespace) -> int:
    """Measure and recommend as the arguments say. Returns 0, or 130 where it is interrupted. Raises SceneError, SettingError,
    DeviceError, Error."""
    _check_packages(args.refine > 0)
    from ..experiments import tradeoff, tradeoff_report
    from ..experiments.job import Machine, Store, scene_entry
    from ..output.files import check_target
    from ..scene import load_scene

    scene = load_scene(args.scene)
    first = scene.defaults.frames[0]
    frames = args.frames or (first, first + FRAMES)
    if frames[1] - frames[0] <= args.skip:
        raise SettingError(
            f"--frames {frames[0]}:{frames[1]}: expected more than the {args.skip} that --skip leaves out"
        )
    _check_metric(args)
    methods = args.methods or tradeoff.METHODS
    has_graphs = any(material.graph for material in scene.materials)
    found = tradeoff.spaces(methods, scene.defaults.settings, args.stereo, has_graphs)
    conditions = tradeoff.Conditions(scene_entry(args.scene), args.size, frames, args.skip, args.stereo, args.seed)
    check_target(args.folder / "results" / "any")
    bench = _Bench(args, conditions, Store(args.folder / "results"), Machine(args.device, args.threads))
    with bench:
        try:
            bench.measure(found)
        except KeyboardInterrupt:
            say(f"clcache: interrupted; {args.folder / 'results'} has what was measured; the same command goes on")
            return 130
    table = tradeoff_report.table(bench.tried, bench.rows, _command(args))
    answers = [line for goal in _goals(args) for line in tradeoff_report.answer(table, goal)]
    changes = tradeoff.sensitivities(bench.tried, bench.rows)
    about = {
        "command": shlex.join(["clcache", *sys.argv[1:]]),
        "conditions": conditions,
        "left": bench.left,
        "machines": bench.machines(),
    }
    tradeoff_report.write(args.folder, table, changes, answers, about)
    print(printable_lines(tradeoff_report.fronts_text(table)))
    for line in answers:
        print(printable(line))
    if bench.left:
        say(f"note: {bench.left} configurations are not measured, as --budget is used up; the same command goes on")
    print(printable(str(args.folder / "tradeoff.html")))
    failed = table["failed"].dropna()
    if len(failed) == len(table):
        raise Error(f"all {len(failed)} configurations failed, the first as: {failed.iloc[0]}")
    return 0


class _Bench:
    """Measures trials, as far as there is time. tried: those that were asked for. rows: what was found, by identity. left: how
    many there was no time for."""

    def __init__(self, args: argparse.Namespace, conditions: "Conditions", store: "Store", machine: "Machine") -> None:
        self._args, self._conditions, self._store, self._machine = args, conditions, store, machine
        self._end = math.inf if args.budget is None else time.monotonic() + args.budget
        self._stack, self._client = contextlib.ExitStack(), None
        self._progress = self._stack.enter_context(jobs.JobProgress("tradeoff"))
        self._abouts: dict[str, dict] = {}
        self._jobs: list[Job] = []
        self.tried: list[Trial] = []
        self.rows: dict[str, dict] = {}
        self.left = 0

    def measure(self, found: "list[Space]") -> None:
        """All that the arguments ask for."""
        from ..experiments.tradeoff import refine, trials

        args = self._args
        self._run(trials(found, args.seed, args.configurations))
        if args.refine and not self.left:
            for batch in refine(found, tuple(self.tried), self.rows, args.seed, args.refine):
                self._run(batch)
                if self.left:
                    break

    def machines(self) -> list[str]:
        """Where and when it was measured, in words, each once."""
        return sorted({f"{a['processor']}, {a['host']}, clcache {a['version']}" for a in self._abouts.values()})

    def _run(self, trials: "list[Trial]") -> None:
        from ..experiments.runner import run_jobs
        from ..experiments.tradeoff import failure, identity

        self.tried += trials
        named = {identity(trial.configuration): self._conditions.job(trial.configuration) for trial in trials}
        self._jobs += named.values()
        missing = [job for job in named.values() if job not in self._store]
        self._show()
        while missing and time.monotonic() < self._end:
            count = len(missing) if self._end == math.inf else _ROUND * self._workers()
            part, missing = missing[:count], missing[count:]
            run_jobs(part, self._store, self._cluster(), self._machine, self._show, failure)
        self.left += len(missing)
        for name, job in named.items():
            if job in self._store:
                result = self._store.read(job)
                self.rows[name], self._abouts[name] = result.rows[0], result.about

    def _show(self, *_: int) -> None:
        from ..experiments.job import with_needs

        asked = with_needs(self._jobs)
        self._progress(sum(job in self._store for job in asked), len(asked))

    def _cluster(self):
        """Opened when there is something to do."""
        from ..experiments.runner import cluster

        if self._client is None:
            self._client = self._stack.enter_context(cluster(self._args.scheduler, self._args.workers))
        return self._client

    def _workers(self) -> int:
        return max(len(self._cluster().scheduler_info(n_workers=-1)["workers"]), 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()


def _command(args: argparse.Namespace) -> str:
    """The beginning of the command that renders as was measured, as a shell takes it."""
    width, height = args.size
    words = ["clcache", "render", args.scene, "--size", f"{width}x{height}", "--stereo" if args.stereo else "--mono"]
    words += ["--seed", str(args.seed)]
    words += ["--device", args.device] if args.device else []
    words += ["--threads", str(args.threads)] if args.threads else []
    return shlex.join(words)


def _goals(args: argparse.Namespace) -> "list[Goal]":
    from ..experiments.tradeoff import Goal

    metric, error = args.error or ("relmse", None)
    return [Goal(args.within, metric, error)] if args.within is not None or error is not None else []


def _check_metric(args: argparse.Namespace) -> None:
    """Raise SettingError where --error asks for what will not be measured."""
    from ..metrics import METRICS

    name = args.error[0] if args.error else ""
    if name == "stereo" and not args.stereo:
        raise SettingError("--error stereo: there is one eye; expected another metric, or no --mono")
    if name == "flip" and not METRICS["flip"].installed:
        raise SettingError(
            f"--error flip: needs the package {METRICS['flip'].distribution}; expected another metric, or that"
        )


def _check_packages(is_refined: bool) -> None:
    """Raise SettingError where a package is missing that this needs."""
    for name in (*_NEEDED, *(("optuna",) if is_refined else ())):
        if importlib.util.find_spec(name) is None:
            raise SettingError(
                f"tradeoff needs the package {name}; expected pip install 'clcache-renderer[experiments]'"
            )


def printable_lines(text: str) -> str:
    """The same, line by line."""
    return "\n".join(map(printable, text.split("\n")))


def duration(text: str) -> float:
    """Seconds, of a time such as 100ms, 0.1s, 30m or 2h; a number alone is of seconds."""
    match = re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)(ms|s|m|h)?", text)
    seconds = float(match[1]) * _UNITS[match[2] or "s"] if match else 0.0
    if not seconds > 0:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a time above 0, such as 100ms, 0.1s, 30m or 2h")
    return seconds


def _limit(text: str) -> tuple[str, float]:
    from ..experiments.tradeoff import METRICS

    name, equals, number = text.rpartition("=")
    name = name if equals else "relmse"
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if name not in METRICS or not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected a number above 0, or METRIC=NUMBER with a metric of {', '.join(METRICS)}"
        )
    return name, value


def _names(text: str) -> tuple[str, ...]:
    from ..experiments.tradeoff import METHODS

    names = tuple(dict.fromkeys(filter(None, text.split(","))))
    unknown = [name for name in names if name not in METHODS]
    if unknown or not names:
        raise argparse.ArgumentTypeError(f"{unknown[0] if unknown else text!r}: expected names of {', '.join(METHODS)}")
    return names
