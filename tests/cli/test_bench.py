"""`clcache bench`: its table, its JSON, what it refuses, and how it ends."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import clcache
from clcache import drivers
from clcache.bench import FAMILIES, Result, embree
from clcache.cli import main

SCENE = """
[meshes.ball]
generator = "sphere"
radius = 1.0
subdivisions = 2
[[instances]]
mesh = "ball"
[environment]
color = [1.0, 1.0, 1.0]
"""
MEMORY = [
    Result("bandwidth", "copy", "", 2 * 10**9, "bytes", (0.25, 0.2, 0.1), 2 * 10**9),
    Result("bandwidth", "read", "", 10**9, "bytes", (0.05,), 10**9),
]
RAYS = [
    Result("rays", "build", "room", 1000, "triangles", (0.001,), peer_seconds=(0.002,), bytes_per_triangle=72.25),
    Result("rays", "primary", "room", 10**6, "rays", (0.02, 0.03, 0.01), 10**8, (0.05,), 0.99999),
]


@pytest.fixture
def scene(tmp_path):
    file = tmp_path / "ball.toml"
    file.write_text(SCENE)
    return str(file)


@pytest.fixture
def canned(monkeypatch):
    """Results that are not measured: half the seconds with two threads. Returns the jobs that were asked for."""
    jobs = []

    def measure(job):
        jobs.append(job)
        for r in MEMORY + RAYS:
            seconds = tuple(s / (job.threads or 1) for s in r.seconds)
            yield Result(**vars(r) | {"seconds": seconds})

    monkeypatch.setattr("clcache.bench.measure", measure)
    return jobs


def bench(*arguments, **options):
    """The real command in a process of its own."""
    command = [sys.executable, "-m", "clcache", "bench", *arguments]
    return subprocess.Popen(
        command,
        cwd=Path(clcache.__file__).parents[1],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def one_line(capsys):
    captured = capsys.readouterr()
    [line] = captured.err.splitlines()
    return line


def test_a_real_run(scene, tmp_path):
    """Everything, on a tiny scene, with one thread and two: the table and the JSON have the same lines."""
    file = tmp_path / "bench.json"
    options = ("--scene", scene, "--size", "16x8", "--repeats", "2", "--threads", "1,2", "--json", str(file))
    threads = ["1", "2"] if (os.cpu_count() or 1) > 1 else ["1"]
    child = bench(*options[:-3], ",".join(threads), *options[-2:])
    out, err = child.communicate()
    assert child.returncode == 0, err
    report = json.loads(file.read_text())
    assert [str(run["threads"]) for run in report["runs"]] == threads
    lines = out.splitlines()
    for run in report["runs"]:
        assert {r["family"] for r in run["results"]} == set(FAMILIES)
        assert min(run["bandwidth"]["copy"], run["bandwidth"]["read"]) > 0
        heading, table = lines[0], lines[2 : 2 + len(run["results"])]
        assert heading.startswith(f"device {drivers.choose()}, {run['threads']} thread")
        lines = lines[2 + len(run["results"]) :]
        for line, r in zip(table, run["results"], strict=True):
            assert line.startswith(f"{r['family']} {r['name']} ")
            assert f" {r['items']} " in line
            assert f" {1000 * r['seconds']['median']:.3f} " in line
            assert r["rate"] == pytest.approx(r["items"] / r["seconds"]["median"])
            if "of_bound" in r:
                assert r["of_bound"] == pytest.approx(r["seconds"]["median"] * run["bandwidth"]["copy"] / r["bytes"])
            if "ratio" in r:
                assert r["ratio"] == pytest.approx(r["embree"]["seconds"]["median"] / r["seconds"]["median"])
    assert len(report["scaling"]) == (len(report["runs"][0]["results"]) if len(threads) > 1 else 0)
    assert len(lines) == (1 + len(report["scaling"]) if len(threads) > 1 else 0)


def test_the_table(canned, capsys):
    assert main(["bench", "rays", "--threads", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + 4
    assert lines[1].split()[:5] == ["benchmark", "scene", "items", "median", "ms"]
    columns = [" ".join(line.split()) for line in lines[2:]]
    assert columns[0] == "bandwidth copy 2000000000 200.000 100.000 250.000 10.00 GB/s 1.00"
    assert columns[2] == "rays build room 1000 1.000 1.000 1.000 1.00 Mtriangles/s 0.50 2.00 72.2"
    assert columns[3] == "rays primary room 1000000 20.000 10.000 30.000 50.00 Mrays/s 2.00 20.00 2.50 99.999"


def test_threads_side_by_side(canned, capsys, tmp_path):
    file = tmp_path / "new" / "bench.json"
    assert main(["bench", "rays", "--threads", "2,1", "--size", "64x32", "--repeats", "7", "--json", str(file)]) == 0
    assert [(j.threads, j.size, j.repeats, j.families) for j in canned] == [
        (threads, (64, 32), 7, ("bandwidth", "rays")) for threads in (2, 1)
    ]
    lines = capsys.readouterr().out.splitlines()
    assert lines[12].endswith("times faster with 2 threads than with 1")
    assert [line.split()[-1] for line in lines[13:]] == ["2.00"] * 4
    report = json.loads(file.read_text())
    assert (report["size"], report["repeats"]) == ([64, 32], 7)
    assert [s["factor"] for s in report["scaling"]] == pytest.approx([2.0] * 4)


def test_json_instead_of_the_table(canned, capsys):
    assert main(["bench", "--json", "-", "--threads", "1"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [r["name"] for r in report["runs"][0]["results"]] == ["copy", "read", "build", "primary"]
    assert canned[0].families == tuple(FAMILIES)


def test_what_is_said_of_embree(canned, capsys, monkeypatch, tmp_path):
    file = tmp_path / "bench.json"
    for names, installed, said in ((["rays"], True, True), (["rays"], False, False), (["sort"], True, False)):
        monkeypatch.setattr(embree, "is_installed", lambda installed=installed: installed)
        assert main(["bench", *names, "--threads", "1", "--json", str(file)]) == 0
        assert capsys.readouterr().err == (f"note: {embree.NOTE}\n" if said else "")
        assert json.loads(file.read_text())["embree"] == (embree.NOTE if said else None)
    for fact in (
        "embreex's Python interface",
        "calling thread",
        "slower than its C interface",
        "tools/peers/rays_beside_embree.py",
    ):
        assert fact in embree.NOTE
    assert (Path(clcache.__file__).parents[1] / "tools" / "peers" / "rays_beside_embree.py").is_file()


def test_every_device(canned):
    assert main(["bench", "--device", "all", "--threads", "1"]) == 0
    usable = [c for c in drivers.candidates() if "Oclgrind" not in c.platform and drivers.probe(c).usable]
    assert [job.device for job in canned] == [str(c.index) for c in usable]


def test_list(capsys):
    assert main(["bench", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(FAMILIES)
    for line, family in zip(lines, FAMILIES.values(), strict=True):
        assert line.endswith(f"  {family.meaning}")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ray"], "benchmark ray: unknown; did you mean rays?"),
        (["rays", "nothing\nlike it"], r"benchmark nothing\nlike it: unknown; expected names of bandwidth, rays, "),
        (["--repeats", "0"], "argument --repeats: '0': expected a whole number, 1 .. 9999"),
        (["--size", "30x20"], "argument --size: '30x20': expected WxH in pixels, multiples of 4"),
        (["--size", "0x0"], "argument --size: '0x0': expected WxH in pixels, multiples of 4"),
        (["--size", "999999996x4"], "argument --size: '999999996x4': expected WxH in pixels, multiples of 4"),
        (["--threads", "1,"], "argument --threads: '1,': expected numbers of threads with commas between"),
        (["--threads", "0"], "--threads 0: expected 1 .. "),
        (["--device", "no such device"], "device 'no such device': no OpenCL device matches"),
        (["--json", "/"], "/: is there and is no regular file"),
        (["--scene", "nowhere.toml"], "nowhere.toml: no such file"),
        (["--nonsense"], "unrecognized arguments: --nonsense"),
    ],
)
def test_what_it_refuses(arguments, message, capsys, monkeypatch):
    monkeypatch.setattr(embree, "is_installed", lambda: False)
    assert main(["bench", *arguments]) == 2
    line = one_line(capsys)
    assert line.startswith("clcache: error: ")
    assert message in line


def test_a_process_that_dies(tmp_path, monkeypatch, capsys):
    kill = "import os, signal, sys\nif 'clcache.bench' in sys.orig_argv:\n    os.kill(os.getpid(), signal.SIGKILL)\n"
    (tmp_path / "sitecustomize.py").write_text(kill)
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["bench", "bandwidth", "--json", str(tmp_path / "bench.json")]) == 1
    assert "the process that measures device " in (line := one_line(capsys))
    assert "ended with SIGKILL" in line
    assert not (tmp_path / "bench.json").exists()


def test_interrupted(tmp_path):
    """Ctrl-C reaches the whole group of processes; nothing of it stays, and one line says so."""
    file = tmp_path / "bench.json"
    child = bench("bandwidth", "--repeats", "9999", "--json", str(file), start_new_session=True)
    assert child.stdout.readline().startswith("device ")
    assert child.stdout.readline().startswith("benchmark ")
    os.killpg(child.pid, signal.SIGINT)
    out, err = child.communicate()  # ends when the last process of the group that writes to these has ended
    assert child.returncode == 130
    assert err == "clcache: error: interrupted\n"
    assert not file.exists()
