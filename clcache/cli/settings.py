"""`clcache settings`: the table of all settings."""

import argparse

from ..settings import SETTINGS

HEADINGS = ("name", "type", "default", "range", "trade", "meaning")
TRADE = "yes"  # of settings that `clcache tradeoff` tries


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    summary = "list every setting: name, type, default, range, whether it trades accuracy for speed, meaning"
    subparsers.add_parser("settings", help=summary, description=f"{summary[0].upper()}{summary[1:]}.")


def run(args: argparse.Namespace) -> int:
    """Print the table to stdout, aligned. Returns the exit code."""
    rows = [HEADINGS] + [
        (s.name, s.type, _text(s.default), s.range, TRADE if s.trade else "", s.meaning) for s in SETTINGS.values()
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return 0


def _text(default: bool | int | float | str) -> str:
    """The default as --set takes it."""
    return str(default).lower() if isinstance(default, bool) else str(default)
