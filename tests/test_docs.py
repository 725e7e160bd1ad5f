"""The documentation: what it is generated from is complete, its commands are commands, and Sphinx builds it without a warning."""

import argparse
import re
import sys
from pathlib import Path

import pytest

from clcache.cli import COMMANDS, Parser
from clcache.experiments.catalogue import EXPERIMENTS
from clcache.methods import METHODS
from clcache.settings import SETTINGS, STEREO_BLENDS, TEMPORALS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"

sphinx = pytest.importorskip("sphinx")
pytest.importorskip("myst_parser")


@pytest.fixture(scope="module")
def extension():
    sys.path.insert(0, str(DOCS / "_ext"))
    try:
        import clcache_docs
    finally:
        sys.path.pop(0)
    return clcache_docs


@pytest.fixture(scope="module")
def pages():
    """The text of each page's source, by its name."""
    files = [f for f in DOCS.rglob("*.md") if "_build" not in f.parts]
    return {f.relative_to(DOCS).with_suffix("").as_posix(): f.read_text(encoding="utf-8") for f in files}


def test_tables_have_all_settings_and_each_method_shows_its_own(extension, pages):
    rows = extension.setting_rows(extension.settings_of())
    assert [row[0] for row in rows] == list(SETTINGS)
    bounces = dict(zip(extension.HEADS, rows[0], strict=True))
    assert bounces["setting"] == "pathtrace.bounces" and bounces["default"] == "3" and bounces["range"] == "0 .. 64"
    assert all(row[4] == SETTINGS[row[0]].meaning for row in rows)
    shown = set()
    for name, text in pages.items():
        for prefixes in re.findall(r"\.\. clcache-settings:: (.+)", text):
            found = [s.name for s in extension.settings_of(prefixes.split())]
            assert found, f"{name}: {prefixes}"
            shown |= set(found)
    assert {name for name in SETTINGS if not name.startswith("device.")} <= shown


def test_every_method_and_filter_has_a_page_that_says_what_it_costs(pages):
    filters = {"taa": "filters/taa", "varianceblend": "filters/varianceblend"} | dict.fromkeys(
        STEREO_BLENDS, "filters/stereo"
    )
    assert set(TEMPORALS) | set(STEREO_BLENDS) <= set(filters) | {"none"}
    for page in {f"methods/{name}" for name in METHODS} | set(filters.values()):
        assert "**What it is.**" in pages[page] and "**When to use it.**" in pages[page]
        assert re.search(r"\.\. clcache-measured:: \w+", pages[page])
    for name, page in filters.items():
        assert name in pages[page] or name == "none"
    told = (DOCS / "measured" / "README.txt").read_text(encoding="utf-8")
    shown = {name for text in pages.values() for name in re.findall(r"\.\. clcache-measured:: (\w+)", text)}
    loop = re.search(r"for name in ([a-z ]+);", told)
    assert shown == {*re.findall(r"\$keep (\w+)", told), *loop[1].split()}


def test_help_is_that_of_all_commands(extension):
    known = extension.command_help()
    assert list(known) == list(COMMANDS)
    assert "--stereo-blend" in known["render"] and max(map(len, known["render"].splitlines())) <= extension.HELP_WIDTH


def test_every_experiment_is_in_the_catalogue_that_the_page_shows(extension, pages):
    assert ".. clcache-experiments::" in pages["experiments"]
    assert {"requires", "requires-unused"} <= set(EXPERIMENTS)
    assert extension.EXPERIMENTS is EXPERIMENTS


def test_commands_of_the_gallery_parse_and_make_what_is_shown(extension):
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        import make_gallery
    finally:
        sys.path.pop(0)
    parser = Parser(prog="clcache")
    subparsers = parser.add_subparsers(dest="command", required=True)
    for command in COMMANDS.values():
        command.add_parser(subparsers)
    pictures = extension.read_gallery(DOCS / "gallery.toml")
    methods, seen = set(), set()
    for picture in pictures:
        lines = [line for line in picture["command"].splitlines() if line]
        commands = make_gallery.commands(picture)
        assert len(commands) == len(lines), picture["name"]
        parsed: list[argparse.Namespace] = [parser.parse_args(words) for words in commands]
        for args in parsed:
            if args.command == "render":
                assert (ROOT / args.scene).is_file()
                methods.add(args.method or "pathtrace")
        folders = {str(getattr(args, "folder", None) or args.heatmap) for args in parsed}
        assert all(str(Path(file).parent) in folders for file in picture["shows"]), picture["name"]
        seen.add(picture["name"])
        file = DOCS / "gallery" / f"{picture['name']}.webp"
        assert file.is_file() and file.stat().st_size <= make_gallery.MOST_BYTES
    assert methods == set(METHODS) and len(seen) == len(pictures) >= 12


def test_a_measured_table_is_kept_with_where_it_is_from(extension, tmp_path):
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        import keep_measured
    finally:
        sys.path.pop(0)
    table = tmp_path / "front.csv"
    table.write_text('name,error,time\n"a, b",0.5,2\nc,0.25,4\n')
    text = keep_measured.kept(table, "clcache tradeoff x: y", ["time", "name"])
    notes, heads, rows = extension.read_measured(text)
    assert notes["command"] == "clcache tradeoff x: y" and notes["version"].startswith("clcache ")
    assert heads == ["time", "name"] and rows == [["2", "a, b"], ["4", "c"]]
    some = keep_measured.kept(table, "x", None, [("name", "c,d*"), ("error", "0.*")])
    assert extension.read_measured(some)[2] == [["c", "0.25", "4"]]
    assert keep_measured.main(["none", str(table), "--command", "x", "--where", "name=e"]) == 2
    assert keep_measured.main(["none", str(tmp_path / "missing.csv"), "--command", "x"]) == 2


def test_a_section_of_the_readme_ends_where_the_next_one_begins(extension):
    text = "# a\n\n## b\nc\n| d |\n### e\nf\n\n## g\nh\n"
    assert extension.readme_section(text, "b") == ["c", "| d |", "### e", "f"]
    assert extension.readme_section(text, "b", has_tables=False) == ["c", "### e", "f"]
    assert extension.readme_section(text, "g") == ["h"]
    with pytest.raises(KeyError):
        extension.readme_section(text, "a")


def build(source, target, builder):
    """Build with Sphinx, in which a warning is an error."""
    from sphinx.application import Sphinx

    quiet = {"status": None, "warningiserror": True}
    Sphinx(source, source, target / "out", target / "trees", builder, **quiet).build()
    return target / "out"


def test_a_measured_table_is_shown_and_a_missing_one_is_said_to_be(extension, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "_ext")
    source = tmp_path / "docs"
    (source / "measured").mkdir(parents=True)
    (source / "measured" / "here.csv").write_text(
        '# command: clcache tradeoff\n# machine: abacus\nname,"frame, ms",default\na,0.123456,1\n'
    )
    (source / "conf.py").write_text("extensions = ['clcache_docs']\n")
    page = "Page\n====\n\n.. clcache-measured:: here\n\n.. clcache-measured:: gone\n"
    (source / "index.rst").write_text(page)
    text = (build(source, tmp_path, "xml") / "index.xml").read_text(encoding="utf-8")
    assert "0.1235" in text and "abacus" in text and "clcache tradeoff" in text and "frame, ms" in text
    assert "over those with the default" in text
    assert "gone.csv is missing" in text


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")  # MyST's, of Sphinx
def test_all_pages_build_without_a_warning(tmp_path, monkeypatch):
    pytest.importorskip("furo")
    monkeypatch.syspath_prepend(DOCS / "_ext")
    out = build(DOCS, tmp_path, "html")
    settings = (out / "settings.html").read_text(encoding="utf-8")
    assert all(f">{name}<" in re.sub(r"</?span[^>]*>", "", settings) for name in SETTINGS)
    commands = (out / "commands.html").read_text(encoding="utf-8")
    assert all(f"clcache {name}" in commands for name in COMMANDS)
    experiments = (out / "experiments.html").read_text(encoding="utf-8")
    assert all(f'id="{name.replace(".", "-")}"' in experiments for name in EXPERIMENTS)
    assert 'id="clcache.renderer.Renderer"' in (out / "python.html").read_text(encoding="utf-8")
