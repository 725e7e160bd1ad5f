#!/usr/bin/env python3
"""Keep a table that was measured for the documentation: docs/measured/NAME.csv, with where it is from in lines above it.

    python tools/keep_measured.py taa tradeoff/sensitivity.csv --where "changed=temporal,taa.*" --command "clcache tradeoff SCENE"

To be run on the machine that measured, with the version that did.
"""

import argparse
import csv
import datetime
import io
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from clcache import Error, SettingError, __version__
from clcache.cli.terminal import say
from clcache.experiments.job import processor_name
from clcache.output.files import atomic_path

MEASURED = Path(__file__).resolve().parent.parent / "docs" / "measured"


def main(argv: Sequence[str] | None = None) -> int:
    """Keep what the arguments name. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("name", metavar="NAME", help="of the page")
    add("table", metavar="TABLE.csv", type=Path)
    add("--command", required=True, help="that measured")
    add("--column", metavar="NAME", dest="columns", action="append", help="to keep (default: all); repeatable")
    add(
        "--where",
        metavar="COLUMN=PATTERN,...",
        action="append",
        default=[],
        help="lines to keep: those in which the column is one of these, with * and ? for what may be anything; repeatable, and then all must hold",
    )
    args = parser.parse_args(argv)
    try:
        text = kept(args.table, args.command, args.columns, [one.partition("=")[::2] for one in args.where])
        with atomic_path(MEASURED / f"{args.name}.csv") as part:
            part.write_text(text, encoding="utf-8")
    except Error as error:
        say(f"keep_measured: error: {error}")
        return 2
    return 0


def names(text: str) -> list[str]:
    """What stands between commas."""
    return text.split(",")


def kept(table: Path, command: str, columns: Sequence[str] | None = None, where: Sequence[tuple[str, str]] = ()) -> str:
    """The file's text. where: columns, and patterns between commas, of which a line has to match one. Raises SettingError for a table
    that cannot be read, lacks a column, or has no such line."""
    try:
        rows = list(csv.reader(io.StringIO(table.read_text(encoding="utf-8"))))
        heads = rows[0]
    except (OSError, UnicodeDecodeError, csv.Error, IndexError) as error:
        raise SettingError(f"{table}: is no table ({error}); expected a CSV file with heads") from None
    for name in (*(columns or ()), *(column for column, _ in where)):
        if name not in heads:
            raise SettingError(f"{table}: has no column {name}; expected one of {', '.join(heads)}")
    for column, patterns in where:
        place = heads.index(column)
        rows[1:] = [row for row in rows[1:] if any(fnmatchcase(row[place], one) for one in names(patterns))]
    if len(rows) < 2:
        raise SettingError(f"{table}: has no line where {where}; expected patterns that some match")
    places = [heads.index(name) for name in columns or heads]
    stream = io.StringIO()
    about = {
        "command": command,
        "machine": processor_name(),
        "version": f"clcache {__version__}",
        "date": datetime.date.today().isoformat(),
    }
    stream.writelines(f"# {key}: {value}\n" for key, value in about.items())
    csv.writer(stream, lineterminator="\n").writerows([row[place] for place in places] for row in rows)
    return stream.getvalue()


if __name__ == "__main__":
    raise SystemExit(main())
