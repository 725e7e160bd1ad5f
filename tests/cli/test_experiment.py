"""`clcache experiment`: what it lists, measures, keeps and refuses."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("distributed")
pytest.importorskip("pandas")

from clcache.cli import main
from clcache.experiments.catalogue import EXPERIMENTS
from clcache.experiments.configuration import Configuration
from clcache.experiments.experiment import Column, Experiment, Sequences, Table, Truth

DATA = Path(__file__).parents[2] / "data"
TINY = Experiment(
    name="tiny",
    source="Nowhere, Fig. 0",
    title="Two methods",
    about="Whether all works.",
    plans=(
        Sequences(
            scenes=("cornell",),
            configurations=(Configuration("paths", "pathtrace"), Configuration("cache", "samplecache")),
            size=(640, 360),
            frames=(0, 64),
            truth=Truth(spp=1024, frames=(1,)),
            quick={"size": (24, 16), "frames": (0, 2), "skip": 1, "truth": Truth(spp=2, frames=(1,))},
        ),
    ),
    tables=(Table("Errors", (Column("relmse", "relMSE"), Column("seconds", "ms", scale=1000.0))),),
)


@pytest.fixture
def tiny(monkeypatch):
    """An experiment in place of all others."""
    monkeypatch.setattr("clcache.experiments.catalogue.EXPERIMENTS", {"tiny": TINY})


def test_every_figure_that_can_be_measured_is_listed(capsys):
    figures = {
        "samplecache": [f"fig{n}" for n in (6, 7, 8, 9, 10, 12, 13, 14, 15, 18, 19)],
        "varianceblend": [*(f"table{n}" for n in (1, 2, 3, 4)), *(f"fig{n}" for n in (5, 6, 7))],
        "memo": [*(f"table6.{n}" for n in (1, 2, 3)), *(f"fig6.{n}" for n in (2, *range(10, 20)))],
        "octree": ["table1", *(f"fig{n}" for n in (11, 13, 14, 16, 17, 18))],
    }
    expected = {f"{paper}-{figure}" for paper, names in figures.items() for figure in names}
    assert expected <= EXPERIMENTS.keys()
    others = {
        "samplecache-still",
        "memo-section6.7.1",
        "mitsuba",
        "extremes",
        "precision",
        "requires",
        "requires-unused",
    }
    assert EXPERIMENTS.keys() == expected | others
    assert main(["experiment", "list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed if line[0] != " "] == list(EXPERIMENTS)


def test_an_experiment_is_measured_once_and_reported(tiny, tmp_path, capsys):
    command = ["experiment", "tiny", "--quick", "-o", str(tmp_path)]
    assert main(command) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'tiny' / 'report.html'}\n"
    written = {file.name for file in (tmp_path / "tiny").iterdir()}
    assert {"report.html", "table.csv", "rows.csv"} <= written
    results = sorted((tmp_path / "results").iterdir())
    kinds = [json.loads(file.read_text())["kind"] for file in results if file.suffix == ".json"]
    assert sorted(kinds) == ["reference"] * 2 + ["sequence"] * 2  # two seeds of each
    times = [file.stat().st_mtime_ns for file in results]
    assert main(command) == 0
    assert [file.stat().st_mtime_ns for file in sorted((tmp_path / "results").iterdir())] == times
    assert "4 of 4 jobs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["tinny"], "experiment tinny: unknown; did you mean tiny?"),
        (["tiny", "list"], "experiment list: stands alone; expected it without other names"),
        (["tiny", "--data", "nowhere"], "--data nowhere: is no folder; expected the project's data/, with the scenes"),
        (["tiny", "--seeds", "0"], "argument --seeds: '0': expected a whole number, 1 .. 1000"),
    ],
)
def test_what_is_wrong_is_one_line(tiny, tmp_path, capsys, arguments, line):
    assert main(["experiment", *arguments, "--quick", "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith(f"clcache: error: {line}")
    assert not list((tmp_path / "out").rglob("*.*"))


def test_scenes_are_looked_for_here_first(tiny, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    assert main(["experiment", "tiny", "--quick"]) == 2
    assert f"{tmp_path / 'data' / 'cornell' / 'scene.toml'}" in capsys.readouterr().err


def test_an_experiment_without_one_of_its_scenes_says_so(monkeypatch, tmp_path, capsys):
    (plan,) = TINY.plans
    lost = replace(TINY, plans=(replace(plan, scenes=("lost",)),))
    monkeypatch.setattr("clcache.experiments.catalogue.EXPERIMENTS", {"tiny": lost})
    assert main(["experiment", "tiny", "--quick", "-o", str(tmp_path)]) == 2
    assert f"{DATA / 'lost' / 'scene.toml'}" in capsys.readouterr().err
