"""What the tools that check for races and false hits have in common: tables, and the command line."""

import argparse
import re
from collections.abc import Callable, Sequence

from clcache import Error, SceneError, SettingError
from clcache.cli.render import MAX_FRAME
from clcache.cli.terminal import say
from clcache.scene.model import Scene


def frame_range(scene: Scene, args: argparse.Namespace) -> tuple[int, int]:
    """The first frame and the one behind the last. Raises SettingError where none is left to count."""
    first, last = args.frames or scene.defaults.frames
    if last - first <= args.skip:
        raise SettingError(f"frames {first}:{last}: expected more than the {args.skip} that --skip leaves out")
    return first, last


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Rows in columns: the first flush left, the others right."""
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    lines = []
    for row in (heads, *rows):
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *cells[1:]]).rstrip())
    return "\n".join(lines)


def add_machine(parser: argparse.ArgumentParser) -> None:
    """The seed, and the options that choose a device."""
    add = parser.add_argument
    add("--seed", metavar="N", type=int, default=1)
    add("--device", metavar="SPEC", help="index, or part of the platform's or device's name")
    add("--threads", metavar="N", type=int, help="CPU threads of the device (default: all)")


def add_frames(parser: argparse.ArgumentParser, skip: int) -> None:
    """The options of what renders a sequence."""
    add = parser.add_argument
    add("--frames", metavar="A:B", type=frames, help="default: the scene's")
    add("--skip", metavar="N", type=whole(0), default=skip, help="frames that do not count (default: %(default)s)")


def size(text: str) -> tuple[int, int]:
    """Width and height, of WxH."""
    match = re.fullmatch(r"([0-9]{1,10})x([0-9]{1,10})", text)
    found = (int(match[1]), int(match[2])) if match else (0, 0)
    if min(found) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected WxH in pixels, such as 640x360")
    return found


def frames(text: str) -> tuple[int, int]:
    """The first frame and the one behind the last, of A:B."""
    match = re.fullmatch(r"([0-9]{1,10}):([0-9]{1,10})", text)
    found = (int(match[1]), int(match[2])) if match else (0, 0)
    if not found[0] < found[1] <= MAX_FRAME:
        raise argparse.ArgumentTypeError(f"{text!r}: expected A:B with 0 <= A < B <= {MAX_FRAME}; B is not rendered")
    return found


def whole(least: int) -> Callable[[str], int]:
    """A parser of whole numbers from this one on."""

    def parse(text: str) -> int:
        if not re.fullmatch(r"[0-9]{1,9}", text) or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number from {least} on")
        return int(text)

    return parse


def exit_code(tool: str, work: Callable[[], None]) -> int:
    """Do the work. The exit code, as of `clcache`; what went wrong is a line on stderr."""
    try:
        work()
    except (SceneError, SettingError) as error:
        say(f"{tool}: error: {error}")
        return 2
    except Error as error:
        say(f"{tool}: error: {error}")
        return 1
    except MemoryError as error:
        say(f"{tool}: error: out of memory: {error}")
        return 1
    return 0
