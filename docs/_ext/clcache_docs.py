"""Directives that write what clcache knows of itself, so that no page has a copy of it by hand.

    clcache-settings PREFIX ...    settings whose names begin so; without an argument all, by their first word
    clcache-commands               each command of the command line, with what its --help says
    clcache-aovs                   what a frame can carry beside its colour
    clcache-experiments            each experiment: source, what is measured, what differs, what is claimed
    clcache-measured NAME          measured/NAME.csv, with where it is from; a note where there is no such file
    clcache-gallery                the pictures of gallery.toml, each with the command that makes it
    clcache-readme HEADING         a section of README.md; in pages of Markdown only

A file of measured/ is a CSV table under lines `# key: value`, which tools/keep_measured.py writes.
"""

import argparse
import csv
import inspect
import io
import os
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from clcache.cli import COMMANDS
from clcache.experiments.catalogue import EXPERIMENTS
from clcache.experiments.experiment import Claim, Experiment
from clcache.output.aov import AOVS
from clcache.settings import SETTINGS, Setting

HEADS = ("setting", "type", "default", "range", "meaning", "trade")
HELP_WIDTH = 100  # characters
MOST_ROWS = 40  # of a table on a page
WIDEST = 60  # characters of a column

# ---------------------------------------------------------------------------------------------------------------------
# What is known, as plain rows


def settings_of(prefixes: Sequence[str] = ()) -> list[Setting]:
    """The settings whose names begin with any of these; all without."""
    return [s for s in SETTINGS.values() if not prefixes or s.name.startswith(tuple(prefixes))]


def setting_rows(settings: Iterable[Setting]) -> list[tuple[str, ...]]:
    """A row of HEADS for each setting."""
    return [
        (s.name, s.type, _text(s.default), s.range, s.meaning, ", ".join(map(_text, getattr(s, "trade", ()))) or "–")
        for s in settings
    ]


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def command_help() -> dict[str, str]:
    """What `--help` says of each command."""
    subparsers = argparse.ArgumentParser(prog="clcache").add_subparsers()
    for command in COMMANDS.values():
        command.add_parser(subparsers)
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(HELP_WIDTH + 2)
    try:
        return {name: parser.format_help() for name, parser in subparsers.choices.items()}
    finally:
        os.environ.pop("COLUMNS") if before is None else os.environ.update(COLUMNS=before)


def read_measured(text: str) -> tuple[dict[str, str], list[str], list[list[str]]]:
    """Where a table is from, its heads, and its rows."""
    lines = text.splitlines()
    notes = [line[1:].partition(":") for line in lines if line.startswith("#")]
    heads, *rows = csv.reader(io.StringIO("\n".join(line for line in lines if not line.startswith("#"))))
    return {key.strip(): value.strip() for key, _, value in notes}, heads, rows


def read_gallery(file: Path) -> list[dict[str, str]]:
    """The pictures: name, title, command, caption; `eye` and `aov` as tools/make_gallery.py takes them."""
    return tomllib.loads(file.read_text(encoding="utf-8"))["picture"]


def readme_section(text: str, heading: str, has_tables: bool = True) -> list[str]:
    """The lines below `## heading`, up to the next such heading. Raises KeyError where there is none."""
    sections = dict(part.split("\n", 1) for part in f"\n{text}".split("\n## ")[1:])
    return [line for line in sections[heading].splitlines() if has_tables or not line.startswith("|")]


# ---------------------------------------------------------------------------------------------------------------------
# Nodes


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]], code: int | None = None) -> nodes.table:
    """A table. code: the column that is set as code."""
    rows = list(rows)
    widths = [min(max(map(len, column)), WIDEST) for column in zip(heads, *rows, strict=True)]
    group = nodes.tgroup(cols=len(heads))
    group += [nodes.colspec(colwidth=width) for width in widths]
    head, body = nodes.thead(), nodes.tbody()
    head += _row([nodes.paragraph("", text) for text in heads])
    for row in rows:
        cells = [_cell(text, column == code) for column, text in enumerate(row)]
        body += _row(cells)
    group += [head, body]
    return nodes.table("", group, classes=["clcache"])


def _row(cells: Iterable[nodes.Node]) -> nodes.row:
    row = nodes.row()
    row += [nodes.entry("", cell) for cell in cells]
    return row


def _cell(text: str, is_code: bool) -> nodes.paragraph:
    return nodes.paragraph("", "", nodes.literal("", text) if is_code else nodes.Text(text))


def _section(name: str, *content: nodes.Node) -> nodes.section:
    return nodes.section("", nodes.title("", name), *content, ids=[nodes.make_id(name)], names=[name])


def _block(text: str, language: str = "text") -> nodes.literal_block:
    return nodes.literal_block(text, text, language=language)


class _Directive(SphinxDirective):
    """A directive that depends on the package's sources, and so is read anew when they change."""

    sources: tuple[object, ...] = ()

    def run(self) -> list[nodes.Node]:
        for source in self.sources:
            self.env.note_dependency(inspect.getsourcefile(source))
        return self.made()

    def made(self) -> list[nodes.Node]:
        """The nodes."""
        raise NotImplementedError


class Settings(_Directive):
    """Tables of settings."""

    optional_arguments, final_argument_whitespace = 1, True
    sources = (Setting,)

    def made(self) -> list[nodes.Node]:
        prefixes = self.arguments[0].split() if self.arguments else []
        if prefixes:
            found = settings_of(prefixes)
            if not found:
                raise self.error(f"no setting begins with {' or '.join(prefixes)}")
            return [_table(HEADS, setting_rows(found), 0)]
        groups = dict.fromkeys(name.partition(".")[0] for name in SETTINGS)
        return [_section(g, _table(HEADS, setting_rows(settings_of([f"{g}."])), 0)) for g in groups]


class Commands(_Directive):
    """All commands."""

    sources = tuple(COMMANDS.values())

    def made(self) -> list[nodes.Node]:
        return [_section(f"clcache {name}", _block(text)) for name, text in command_help().items()]


class Aovs(_Directive):
    """All AOVs."""

    sources = (next(iter(AOVS.values())).__class__,)

    def made(self) -> list[nodes.Node]:
        rows = [(a.name, ", ".join(a.channels), "yes" if a.default else "no", a.meaning) for a in AOVS.values()]
        return [_table(("AOV", "channels", "by default", "meaning"), rows, 0)]


class Experiments(_Directive):
    """All experiments."""

    sources = (Experiment,)

    def made(self) -> list[nodes.Node]:
        if not EXPERIMENTS:
            return [nodes.note("", nodes.paragraph("", "There are none in this version."))]
        return [self._of(experiment) for experiment in EXPERIMENTS.values()]

    def _of(self, experiment: Experiment) -> nodes.section:
        content = [
            nodes.paragraph("", f"{experiment.title} ({experiment.source}). {experiment.about}"),
            _block(f"clcache experiment {experiment.name}", "sh"),
        ]
        if experiment.differs:
            content.append(nodes.paragraph("", f"What is otherwise than in the paper: {experiment.differs}"))
        if experiment.claims:
            rows = [(c.says, _measure(c), _bounds(c.low, c.high), _number(c.paper)) for c in experiment.claims]
            content.append(_table(("claim", "measure", "holds if", "the paper's value"), rows))
        return _section(experiment.name, *content)


def _measure(claim: Claim) -> str:
    return f"{claim.measure} of {claim.of}" + (f", divided by that of {claim.over}" if claim.over else "")


def _bounds(low: float | None, high: float | None) -> str:
    ends = ([f"at least {low:g}"] if low is not None else []) + ([f"at most {high:g}"] if high is not None else [])
    return " and ".join(ends)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"


FACTORS = (
    " Time, errors and memory are those with the value over those with the default; beside them their standard errors."
)


class Measured(SphinxDirective):
    """A table that was measured."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        file = Path(self.env.srcdir) / "measured" / f"{self.arguments[0]}.csv"
        self.env.note_dependency(str(file))
        if not file.is_file():
            text = (
                f"Not measured yet: docs/measured/{file.name} is missing; docs/measured/README.txt says how it is made."
            )
            return [nodes.note("", nodes.paragraph("", text))]
        notes, heads, rows = read_measured(file.read_text(encoding="utf-8"))
        shown = [[_shortened(cell) for cell in row] for row in rows[:MOST_ROWS]]
        told = "; ".join(f"{key}: {value}" for key, value in notes.items() if key != "command")
        parts = [_table(heads, shown), nodes.paragraph("", f"Measured by the command below; {told}.")]
        if "default" in heads:  # of `clcache tradeoff`
            parts[1] += nodes.Text(FACTORS)
        if len(rows) > MOST_ROWS:
            parts[1] += nodes.Text(f" The first {MOST_ROWS} of {len(rows)} lines; the file has all.")
        return [*parts, _block(notes.get("command", "not known"), "sh")]


def _shortened(text: str) -> str:
    """A number with four digits; words as they are."""
    try:
        return f"{float(text):.4g}"
    except ValueError:
        return text


class Gallery(SphinxDirective):
    """The pictures, each with its command."""

    def run(self) -> list[nodes.Node]:
        folder = Path(self.env.srcdir)
        self.env.note_dependency(str(folder / "gallery.toml"))
        return [self._of(folder, picture) for picture in read_gallery(folder / "gallery.toml")]

    def _of(self, folder: Path, picture: dict[str, str]) -> nodes.section:
        name = f"gallery/{picture['name']}.webp"
        self.env.note_dependency(str(folder / name))
        image = nodes.image(uri=name, alt=picture["caption"], classes=["gallery"])
        shown = image if (folder / name).is_file() else nodes.note("", nodes.paragraph("", f"{name} is missing."))
        about = nodes.paragraph("", picture["caption"])
        return _section(picture["title"], shown, about, _block(picture["command"], "sh"))


class Readme(SphinxDirective):
    """A section of README.md."""

    required_arguments, final_argument_whitespace = 1, True
    option_spec = {"without-tables": directives.flag}

    def run(self) -> list[nodes.Node]:
        file = Path(self.env.srcdir).parent / "README.md"
        self.env.note_dependency(str(file))
        try:
            lines = readme_section(
                file.read_text(encoding="utf-8"), self.arguments[0], "without-tables" not in self.options
            )
        except KeyError:
            raise self.error(f"README.md has no section {self.arguments[0]}") from None
        holder = nodes.container()
        self.state.nested_parse(StringList(lines, str(file)), 0, holder)
        return holder.children


def setup(app: Sphinx) -> dict[str, object]:
    """Tell Sphinx of the directives."""
    for name, directive in {
        "settings": Settings,
        "commands": Commands,
        "aovs": Aovs,
        "experiments": Experiments,
        "measured": Measured,
        "gallery": Gallery,
        "readme": Readme,
    }.items():
        app.add_directive(f"clcache-{name}", directive)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
