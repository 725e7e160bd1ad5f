"""What the commands say to the user: lines on stderr, and how far a render is (a bar on a terminal, plain lines elsewhere)."""

import sys
import time
from typing import TYPE_CHECKING, Self

from tqdm import tqdm

if TYPE_CHECKING:
    from ..renderer import Frame


def say(text: str) -> None:
    """One line on stderr, above a bar that is shown."""
    tqdm.write(printable(text), file=sys.stderr)


def printable(text: str) -> str:
    """The text on one line; what cannot be printed, such as a control character in a file's name, is escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


STEPS = 1000  # of the bar for each frame whose number of samples is not known


class Progress:
    """How far a render is. On a terminal: a bar with samples per second and the time left for all frames, or where a goal
    decides how many samples there will be, with the part of the way to it; while kernels compile a bar of its own. Elsewhere: a line when compiling starts and one for each finished frame.
    """

    def __init__(self) -> None:
        self._on_terminal = sys.stderr.isatty()
        self._compile_bar: tqdm | None = None
        self._programs = 0
        self._bar: tqdm | None = None

    def start(self, frames: int, samples_per_frame: int | None) -> None:
        """Begin: so many frames are to come, of so many samples each (pixels x samples per pixel x eyes; None: unknown)."""
        self._end_compiling()
        self._frames, self._steps = frames, samples_per_frame or STEPS
        self._done, self._started = 0, time.perf_counter()
        if self._on_terminal:
            form = "{l_bar}{bar}| [{elapsed}<{remaining}]" if samples_per_frame is None else None
            self._bar = tqdm(
                total=frames * self._steps, unit="sample", unit_scale=True, bar_format=form, file=sys.stderr
            )

    def compiling(self, program: str) -> None:
        """The program of this name is about to be compiled."""
        self._programs += 1
        if self._on_terminal:
            self._end_compiling()
            form = f"compiling {self._programs}: {{desc}} [{{elapsed}}]"
            self._compile_bar = tqdm(desc=program, bar_format=form, leave=False, file=sys.stderr)
        elif self._programs == 1:
            say("compiling kernels")

    def part_of_frame(self, fraction: float) -> None:
        """This much of the frame at hand is done, 0 to 1."""
        self._end_compiling()
        if self._bar is not None:
            self._bar.update(round((self._done + fraction) * self._steps) - self._bar.n)

    def frame_done(self, frame: "Frame") -> None:
        """This frame is finished and written."""
        self._done += 1
        if self._bar is not None:
            self.part_of_frame(0.0)
            return
        left = (time.perf_counter() - self._started) / self._done * (self._frames - self._done)
        rate = ray_count(frame.stats) / max(frame.stats["seconds"], 1e-9) / 1e6
        place = f"frame {frame.number} ({self._done} of {self._frames})"
        say(f"{place}: {frame.stats['seconds']:.2f} s, {rate:.2f} Mrays/s, {left:.0f} s left")

    def _end_compiling(self) -> None:
        if self._compile_bar is not None:
            self._compile_bar.close()
            self._compile_bar = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._end_compiling()
        if self._bar is not None:
            self._bar.close()


def ray_count(frame_stats: dict) -> int:
    """All rays of a frame, over its eyes and kinds, from its entry of the statistics."""
    return sum(sum(eye["rays"].values()) for eye in frame_stats["eyes"].values())
