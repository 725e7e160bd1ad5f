"""The command line: one module for each command, each with `add_parser(subparsers)` and `run(args) -> int`.

Modules that take long to import, or that load an OpenCL driver, are imported by the commands that need them, when they
run. Exit codes: 0 done; 1 the work failed; 2 what the user gave is wrong; 130 interrupted.
"""

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from ..errors import Error, SceneError, SettingError
from ..version import __version__
from . import bench, compare, doctor, experiment, merge, render, settings, terminal, tradeoff

COMMANDS = {
    "bench": bench,
    "compare": compare,
    "doctor": doctor,
    "experiment": experiment,
    "merge": merge,
    "render": render,
    "settings": settings,
    "tradeoff": tradeoff,
}


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are SettingErrors, and which takes no abbreviated options."""

    def __init__(self, **options: object) -> None:
        super().__init__(**options, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        raise SettingError(f"{message}; see '{self.prog} --help'")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command of these arguments (default: the process's). Returns the exit code; errors go to stderr, one line each."""
    sys.stdout.reconfigure(errors="backslashreplace")  # a file's name may hold what the terminal's encoding does not
    try:
        try:
            code = _run(argv)
        except SystemExit as stop:  # argparse, after --help or --version
            code = stop.code
        sys.stdout.flush()
        return code
    except (SceneError, SettingError) as error:
        return _fail(2, str(error))
    except Error as error:
        return _fail(1, str(error))
    except MemoryError as error:
        return _fail(1, f"out of memory: {error}")
    except KeyboardInterrupt:
        return _fail(130, "interrupted")
    except BrokenPipeError:  # whoever read the output has had enough
        _discard_stdout()
        return 1
    except OSError as error:  # such as a full disk behind stdout
        _discard_stdout()
        return _fail(1, str(error))


def _run(argv: Sequence[str] | None) -> int:
    parser = Parser(prog="clcache", description="Cached, temporally stable, stereo ray tracing on OpenCL.")
    parser.add_argument("--version", action="version", version=f"clcache {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS.values():
        command.add_parser(subparsers)
    args = parser.parse_args(argv)
    return COMMANDS[args.command].run(args)


def _fail(code: int, message: str) -> int:
    with contextlib.suppress(OSError):
        terminal.say(f"clcache: error: {message}")
    return code


def _discard_stdout() -> None:
    """Let the interpreter's own flush at exit succeed."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
