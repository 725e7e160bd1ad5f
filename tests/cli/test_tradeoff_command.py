"""`clcache tradeoff`: what it measures once, keeps, recommends and refuses."""

import argparse
import contextlib
import csv
import json
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("distributed")
pytest.importorskip("pandas")
pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

import distributed

from clcache import DeviceError
from clcache.cli import main
from clcache.cli.tradeoff import duration
from clcache.experiments import job as jobs
from clcache.experiments import runner
from clcache.experiments.job import Result

CORNELL = str(Path(__file__).parents[2] / "data" / "cornell" / "scene.toml")


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """A cluster in this process, in place of one of processes."""

    @contextlib.contextmanager
    def cluster(scheduler, workers):
        with (
            distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=False, dashboard_address=":0"
            ) as local,
            distributed.Client(local) as client,
        ):
            yield client

    monkeypatch.setattr(runner, "cluster", cluster)


@pytest.fixture
def work(monkeypatch):
    """Configurations that are not rendered, but have a time and an error for each; the list of what was done."""
    done = []
    function_of = jobs.function_of

    def fake(parameters, needed, machine):
        if "configuration" not in parameters:
            return Result([{"spp": 1}])
        done.append(parameters["configuration"])
        spp, settings = parameters["configuration"]["spp"], parameters["configuration"]["settings"]
        if settings.get("pathtrace.bounces") == 1:
            return Result([{"failed": "<too little> memory"}])
        time = 0.1 * spp * (1 + 0.1 * len(settings))
        slow = 2 ** (spp % 3)  # as a machine that is busy
        numbers = {
            "seconds": slow * time,
            "seconds_error": slow * 0.01,
            "relative": 10 * time,
            "yardstick": 0.1,
            "relmse": 0.4 / spp,
            "flicker": 1.0,
        }
        return Result([numbers | {"relmse_error": 0.002, "memory": 1000, "cache": 0}])

    monkeypatch.setattr(
        jobs, "function_of", lambda kind: fake if kind in ("tradeoff", "reference") else function_of(kind)
    )
    return done


def tradeoff(folder, *options):
    return main(["tradeoff", CORNELL, "-o", str(folder), "--methods", "pathtrace", *options])


def read(file):
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_tradeoff_is_measured_once_and_answers_from_what_is_kept(work, tmp_path, capsys):
    few = ("--configurations", "9")
    assert tradeoff(tmp_path, *few) == 0
    assert len(work) == 9
    rows = read(tmp_path / "configurations.csv")
    assert [row["origin"] for row in rows].count("default") == 1 and len(rows) == 9
    assert [float(row["seconds"]) for row in rows if row["seconds"]] == sorted(
        float(row["seconds"]) for row in rows if row["seconds"]
    )
    (failed,) = (row for row in rows if row["failed"])
    assert failed["failed"] == "<too little> memory" and "pathtrace.bounces=1" in failed["command"]
    best = read(tmp_path / "front-relmse.csv")
    points = dict.fromkeys((float(row["seconds"]), float(row["relmse"])) for row in best)
    assert list(points) == [(pytest.approx(0.1 * spp), 0.4 / spp) for spp in (1, 2, 4, 8)]
    assert all((row in best) == (row["front.relmse"] == "True") for row in rows)
    page = (tmp_path / "tradeoff.html").read_text()
    assert "&lt;too little&gt; memory" in page and "<too little>" not in page
    for row in best:
        assert row["command"] in page
    assert "://" not in page  # nothing from elsewhere
    written = {file: file.read_bytes() for file in tmp_path.glob("*.csv")}
    svg = (tmp_path / "front-relmse.svg").read_bytes()
    capsys.readouterr()

    work.clear()
    assert tradeoff(tmp_path, *few, "--within", "250ms", "--error", "0.21") == 0
    assert work == [] and {file: file.read_bytes() for file in tmp_path.glob("*.csv")} == written
    assert (tmp_path / "front-relmse.svg").read_bytes() == svg
    *_, said, command, page = capsys.readouterr().out.splitlines()
    assert said.endswith("pathtrace, 200.0 ms ± 10.0 a frame, relMSE 0.2 ± 0.002") and "nothing" not in said
    assert shlex.split(command)[:4] == ["clcache", "render", CORNELL, "--size"] and "--spp 2" in command
    assert page == str(tmp_path / "tradeoff.html")

    assert tradeoff(tmp_path, *few, "--error", "0.01") == 0
    *_, said, command, _ = capsys.readouterr().out.splitlines()
    assert "nothing of what was measured" in said and "--spp 8" in command and work == []


def test_what_is_recommended_can_be_pasted(work, tmp_path, capsys):
    folder = tmp_path / "my scene"
    folder.mkdir()
    (folder / "scene.toml").write_text(Path(CORNELL).read_text())
    options = ("--configurations", "12", "--within", "1s", "--mono", "--size", "32x18", "-o", str(tmp_path / "out"))
    assert main(["tradeoff", str(folder / "scene.toml"), "--methods", "samplecache", *options]) == 0
    *_, command, _ = capsys.readouterr().out.splitlines()
    assert work[0]["method"] == "samplecache"
    words = shlex.split(command)
    assert words[:3] == ["clcache", "render", str(folder / "scene.toml")]
    assert main([*words[1:], "-o", str(tmp_path / "frames")]) == 0


def test_frames_are_rendered_and_found_again(tmp_path):
    options = ("--size", "32x18", "--frames", "0:3", "--skip", "1", "--configurations", "2")
    assert tradeoff(tmp_path, *options) == 0
    one, two = sorted(read(tmp_path / "configurations.csv"), key=lambda row: row["command"])
    for name in ("seconds", "relative", "relmse", "relmse_error", "flicker", "stereo", "stereo_reference", "memory"):
        assert float(one[name]) > 0 and float(two[name]) > 0
    assert "--spp 1" in one["command"] and "--spp 2" in two["command"]
    assert float(two["relmse"]) < 0.8 * float(one["relmse"]) and two["stereo_reference"] == one["stereo_reference"]
    kinds = [json.loads(file.read_text())["kind"] for file in (tmp_path / "results").glob("*.json")]
    assert sorted(kinds) == ["reference"] * 4 + ["tradeoff"] * 2
    written = (tmp_path / "configurations.csv").read_bytes()
    assert tradeoff(tmp_path, *options) == 0
    assert (tmp_path / "configurations.csv").read_bytes() == written


def test_the_search_goes_on_where_it_was(work, tmp_path, monkeypatch, capsys):
    pytest.importorskip("optuna")
    options = ("--configurations", "5", "--refine", "9")
    assert tradeoff(tmp_path / "whole", *options) == 0
    assert len(work) == 14
    whole = (tmp_path / "whole" / "configurations.csv").read_bytes()

    stop = 9  # is interrupted in the first batch
    write = jobs.Store.write

    def interrupted(store, job, result):
        nonlocal stop
        stop -= job.kind == "tradeoff"
        if not stop:
            raise KeyboardInterrupt
        write(store, job, result)

    monkeypatch.setattr(jobs.Store, "write", interrupted)
    assert tradeoff(tmp_path / "parts", *options) == 130
    assert "the same command goes on" in capsys.readouterr().err
    assert not (tmp_path / "parts" / "configurations.csv").exists()
    work.clear()
    monkeypatch.setattr(jobs.Store, "write", write)
    assert tradeoff(tmp_path / "parts", *options) == 0
    assert len(work) < 10 and (tmp_path / "parts" / "configurations.csv").read_bytes() == whole


def test_what_a_budget_leaves_is_said(work, tmp_path, monkeypatch, capsys):
    assert tradeoff(tmp_path, "--configurations", "7", "--budget", "1ms") == 1
    assert "nothing was measured" in capsys.readouterr().err and work == []
    clock = iter(range(10**6))
    monkeypatch.setattr("clcache.cli.tradeoff.time", SimpleNamespace(monotonic=lambda: next(clock)))
    assert tradeoff(tmp_path, "--configurations", "7", "--budget", "3s") == 0
    assert "3 configurations are not measured" in capsys.readouterr().err and len(work) == 4
    assert len(read(tmp_path / "configurations.csv")) == 4


def test_where_all_fails_the_work_failed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(jobs, "function_of", lambda kind: lambda *_: Result([{"failed": "needs 9 GiB"}]))
    assert tradeoff(tmp_path, "--configurations", "2", "--within", "1s") == 1
    out, err = capsys.readouterr()
    assert "nothing was measured" in out and "needs 9 GiB" in (tmp_path / "tradeoff.html").read_text()
    assert err.splitlines()[-1] == "clcache: error: all 2 configurations failed, the first as: needs 9 GiB"


def test_an_error_of_the_device_is_one_line(tmp_path, monkeypatch, capsys):
    def fail(*_):
        raise DeviceError("there is none")

    monkeypatch.setattr(jobs, "function_of", lambda kind: fail)
    assert tradeoff(tmp_path, "--configurations", "2") == 1
    assert capsys.readouterr().err.splitlines()[-1] == "clcache: error: there is none"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--within=-1s"], "expected a time above 0"),
        (["--within", "0ms"], "expected a time above 0"),
        (["--budget", "1 h"], "expected a time above 0"),
        (["--error", "ssim=0.5"], "metric of relmse, flip"),
        (["--error", "0"], "expected a number above 0"),
        (["--error", "stereo=0.5", "--mono"], "there is one eye"),
        (["--methods", "raytrace"], "expected names of pathtrace"),
        (["--methods", ","], "expected names of pathtrace"),
        (["--frames", "0:4", "--skip", "4"], "expected more than the 4"),
        (["--configurations", "0"], "whole number"),
    ],
)
def test_wrong_options_are_one_line_and_exit_code_2(options, message, tmp_path, capsys):
    assert main(["tradeoff", CORNELL, "-o", str(tmp_path), *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("clcache: error: ") and message in line


@given(st.integers(1, 10**6), st.sampled_from([("ms", 0.001), ("s", 1.0), ("", 1.0), ("m", 60.0), ("h", 3600.0)]))
def test_times_are_read_as_written(number, unit):
    name, seconds = unit
    assert duration(f"{number}{name}") == pytest.approx(number * seconds)
    assert duration(f"{number / 8:.3f}{name}") == pytest.approx(number / 8 * seconds)
    for wrong in (f"-{number}{name}", f"{number}{name} ", f"{number}d", f"{number}e3", ""):
        with pytest.raises(argparse.ArgumentTypeError):
            duration(wrong)
