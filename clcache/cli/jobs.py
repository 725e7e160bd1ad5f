"""What the commands that run jobs have in common: where they run, and how far they are."""

import argparse
import re
import sys
import time
from pathlib import Path
from typing import Self

from tqdm import tqdm

from .terminal import say

MAX_WORKERS = 1024


def add_options(parser: argparse.ArgumentParser, folder: str) -> None:
    """The options: where results go, on which machines they are found. folder: the default one."""
    add = parser.add_argument
    add(
        "-o",
        dest="folder",
        metavar="DIR",
        type=Path,
        default=Path(folder),
        help="output folder; what is in its results/ is not measured again (default: %(default)s)",
    )
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask scheduler, whose workers do the jobs: start them with --nthreads 1, and with the scenes at the same places"
        " (default: a cluster on this machine)",
    )
    add(
        "--workers",
        metavar="N",
        type=whole(1, MAX_WORKERS),
        default=1,
        help="of the cluster on this machine; with more than one, times are of workers that share it (default: 1)",
    )
    add("--device", metavar="SPEC", help="OpenCL device: its index, or part of the platform's or the device's name")
    add("--threads", metavar="N", type=whole(1, 2**16), help="CPU threads of each worker's device (default: all)")


def whole(low: int, high: int):
    """A parser of whole numbers in this range."""

    def parse(text: str) -> int:
        if not re.fullmatch(r"[0-9]{1,10}", text) or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number, {low} .. {high}")
        return int(text)

    return parse


class JobProgress:
    """How many jobs are done: a bar on a terminal, and a line for each elsewhere. what: of which it is."""

    def __init__(self, what: str) -> None:
        self._what, self._started, self._at_first = what, time.perf_counter(), 0
        self._bar: tqdm | None = None

    def __call__(self, done: int, total: int) -> None:
        """So many jobs of all are done."""
        if sys.stderr.isatty():
            if self._bar is None:
                self._bar = tqdm(desc=self._what, total=total, initial=done, unit="job", file=sys.stderr)
            self._bar.update(done - self._bar.n)
            return
        if not self._at_first:
            self._at_first = done + 1  # one more, so that it is never 0
        began = self._at_first - 1
        spent = time.perf_counter() - self._started
        left = f", {spent / (done - began) * (total - done):.0f} s left" if done > began and done < total else ""
        say(f"{self._what}: {done} of {total} jobs{left}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()
