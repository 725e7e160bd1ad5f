"""What `clcache render` leaves to go on from, and how it goes on: the frames that are there, and the state after one of them.

Where frames do not depend on each other, the render goes on after the last of those that are complete. Else it goes on after the
frame that the state in the folder is of, with the caches as they were then, and writes later ones again.
"""

import argparse
import contextlib
import json
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import Error, SettingError
from .terminal import say

if TYPE_CHECKING:
    from ..renderer import Renderer

SAVE_EVERY = 60  # seconds
_LEAST_WORK = 20  # seconds of rendering for each second of saving
# What messages call attributes of a file. They come last: the path's depends on the frames per second, too.
_DIGESTS = {"sceneDigest": "content of the scene", "cameraDigest": "camera's path"}


def stem(folder: Path, number: int) -> Path:
    """The path of a frame's files without their endings."""
    return folder / f"frame_{number:04d}"


def picture_files(folder: Path, number: int, eyes: Sequence[str]) -> dict[str, Path]:
    """The PNG file of each eye."""
    path = stem(folder, number)
    return {eye: path.with_name(f"{path.name}{f'_{eye}' if len(eyes) > 1 else ''}.png") for eye in eyes}


def where_to_begin(
    renderer: "Renderer", args: argparse.Namespace, folder: Path, frames: tuple[int, int], attributes: Mapping
) -> int:
    """The frame to begin with, the renderer being told what it is to know then; the end of `frames` where all are there.

    attributes: those of the frames' files, as `provenance` makes them. Raises SettingError where what is there is of another
    render.
    """
    first, end = frames
    if args.save_state and not (renderer.has_state or renderer.keeps_world):
        raise SettingError(
            f"--save-state: the frames of method {renderer.method} do not depend on each other; expected a method with a"
            " cache, a temporal filter, or --memo of a scene with graphs"
        )
    begin = first
    if args.resume:
        begin = _first_missing(renderer, args, folder, frames, attributes)
        if begin < end and renderer.has_state:
            begin = _restore(renderer, folder, first, begin)
    if begin == first and args.warm_start:
        renderer.warm_start(args.warm_start)
    return begin


def _restore(renderer: "Renderer", folder: Path, first: int, missing: int) -> int:
    """Go on from the state in the folder: the frame to begin with. missing: the first frame that is not there."""
    from ..output.state import STATE_FILE, StateFile

    file = folder / STATE_FILE
    if not file.exists():
        if missing > first:
            say(f"note: {folder} has frames, but no {STATE_FILE} to go on from; begins with frame {first}")
        return first
    with StateFile(file) as state:
        began, last = (state.number(name) for name in ("first", "frame"))
    if began != first:
        raise SettingError(
            f"{file}: is of a render that began with frame {began}; expected to begin with frame {first}"
        )
    if last >= missing:
        say(f"note: {file} is of frame {last}, but {folder} lacks frame {missing}; begins with frame {first}")
        return first
    return renderer.restore(file) + 1


def _first_missing(
    renderer: "Renderer", args: argparse.Namespace, folder: Path, frames: tuple[int, int], attributes: Mapping
) -> int:
    """The first frame of which not all files are there, whole. Raises SettingError where one is of another render."""
    from ..output.exr import all_channels
    from ..output.read import read_header

    channels = all_channels(args.aov, renderer.eyes)
    expected = _comparable(attributes, renderer.size, renderer.eyes)
    if renderer.until_relmse is None:
        expected["spp"] = renderer.spp
    for number in range(*frames):
        file = stem(folder, number).with_suffix(".exr")
        pictures = picture_files(folder, number, renderer.eyes).values() if args.png else ()
        if not all(os.path.exists(path) for path in (file, *pictures)):
            return number
        try:
            header = read_header(file)
        except SettingError:  # damaged, and to be written again
            return number
        found = _comparable(header.attributes, header.size, header.attributes.get("multiView", ("mono",)))
        for name, value in (expected | {"frame": number}).items():
            if name not in found:
                raise SettingError(
                    f"{file}: {name} is not in its header; expected frames of the same render and version"
                )
            if found[name] != value:
                raise SettingError(
                    f"{file}: {name} is {found[name]} there and {value} here; expected frames of the same render"
                )
        _check_channels(file, header.channels, channels, args.aov)
    return frames[1]


def _check_channels(file: Path, found: Sequence[str], expected: Sequence[str], aovs: Sequence[str]) -> None:
    what = [f"lacks channel {name}" for name in expected if name not in found]
    what += [f"has channel {name}" for name in found if name not in expected]
    if what:
        raise SettingError(
            f"{file}: {what[0]}; expected frames of the same --aov, which is {','.join(aovs) or 'none'} here"
        )


def _comparable(attributes: Mapping, size: tuple[int, int], views: Sequence[str]) -> dict[str, object]:
    """What is the same in all frames of a render, of the attributes of a file, or of those that are to be written."""
    names = ("software", "scene", "method", "temporal", "stereoBlend", "memo", "seed", "frame", "spp")
    found = {name: attributes[name] for name in names if name in attributes}
    found |= {"size": "{}x{}".format(*size), "eyes": ", ".join(views)}
    with contextlib.suppress(KeyError, TypeError, ValueError, ZeroDivisionError, RecursionError):
        rate = attributes["framesPerSecond"]
        found["fps"] = float(rate if isinstance(rate, Fraction) else Fraction(*rate))
        settings = json.loads(attributes["settings"])
        found |= {f"setting {name}": v for name, v in settings.items() if not name.startswith("device.")}
    return found | {what: attributes[name] for name, what in _DIGESTS.items() if name in attributes}


class StateKeeper:
    """Writes the state of a render into its folder: where it is interrupted, and from time to time, so that a render that ends
    without notice loses little."""

    def __init__(self, renderer: "Renderer", folder: Path):
        from ..output.state import STATE_FILE

        self._renderer, self._file = renderer, folder / STATE_FILE
        self._saved, self._cost, self._is_there = time.monotonic(), 0.0, False

    def frame_done(self) -> None:
        """A frame is complete and written."""
        if time.monotonic() - self._saved >= max(SAVE_EVERY, _LEAST_WORK * self._cost):
            self._try_to_save()

    def interrupted(self) -> bool:
        """The render ends before its last frame. Returns whether --resume goes on, and does not begin anew."""
        self._try_to_save()
        return self._file.exists() or not self._renderer.has_state

    def end(self, is_wanted: bool) -> None:
        """The render is complete. is_wanted: leave the state after its last frame; else that of an earlier one goes, too. Raises
        SettingError or Error where it cannot be written."""
        if is_wanted:
            self._renderer.save(self._file)
        elif self._is_there:
            self._file.unlink(missing_ok=True)

    def _try_to_save(self) -> None:
        if not self._renderer.has_state:
            return
        start = time.monotonic()
        try:
            self._renderer.save(self._file)
            self._is_there = True
        except Error as error:  # no reason to give up the render
            say(f"note: {error}")
        self._saved = time.monotonic()
        self._cost = self._saved - start


class Interrupt:
    """Whether the user has asked for the render to end."""

    def __init__(self) -> None:
        self.is_asked = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if so."""
        if self.is_asked:
            raise KeyboardInterrupt


@contextlib.contextmanager
def finishing_frames(is_wanted: bool) -> Iterator[Interrupt]:
    """In the body, a first Ctrl-C only asks for the end, so that the frame at hand and its state become complete; a second one
    interrupts at once, as the first does where this is not wanted."""
    interrupt = Interrupt()
    is_ours = threading.current_thread() is threading.main_thread()
    if not (is_wanted and is_ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
        yield interrupt
        return

    def ask(*_: object) -> None:
        interrupt.is_asked = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
        say("clcache: the frame is being finished; Ctrl-C again interrupts it")

    signal.signal(signal.SIGINT, ask)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
