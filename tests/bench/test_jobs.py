"""Jobs in processes of their own: every family, the errors that come back, and processes that end before their time."""

import json
import os
import signal
from dataclasses import asdict
from types import SimpleNamespace

import pyopencl as cl
import pytest

from clcache import drivers
from clcache.bench import FAMILIES, Job, Result, check_families, measure, targets
from clcache.bench.build import traffic
from clcache.bench.embree import is_installed
from clcache.bench.job import DATA, short_name
from clcache.bench.launches import Launch
from clcache.bench.run import ANSWER, Family, work
from clcache.errors import DeviceError, Error, SceneError, SettingError

TINY = """
[meshes.ball]
generator = "sphere"
radius = 1.0
subdivisions = 3
[meshes.floor]
generator = "plane"
size = [20.0, 20.0]
[meshes.box]
generator = "box"
size = [1.0, 1.0, 1.0]
[materials.lamp]
emission = [5.0, 5.0, 5.0]
[[instances]]
mesh = "ball"
[[instances]]
mesh = "floor"
translation = [0.0, -1.0, 0.0]
[[instances]]
mesh = "ball"
translation = [3.0, 0.0, 0.0]
[[instances]]
mesh = "box"
material = "lamp"
translation = [-3.0, 3.0, 0.0]
[[lights]]
type = "point"
position = [0.0, 5.0, 1.0]
intensity = [9.0, 9.0, 9.0]
[camera]
position = [0.0, 1.0, 6.0]
look_at = [0.0, 0.0, 0.0]
fov_y = 45.0
"""
SIZE = (32, 16)
MEASURED = tuple(name for name in FAMILIES if name != "memo")  # which has many variants to build: test_memo_bench.py


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    file = tmp_path_factory.mktemp("bench") / "tiny.toml"
    file.write_text(TINY)
    return str(file)


@pytest.fixture(scope="module")
def index():
    return str(drivers.choose().index)


@pytest.fixture(scope="module")
def results(scene, index):
    return list(measure(Job(MEASURED, index, 1, 3, SIZE, (scene,))))


def named(results, family):
    return {r.name: r for r in results if r.family == family}


def test_every_family_has_results(results):
    assert {r.family for r in results} == set(MEASURED)
    for r in results:
        assert len(r.seconds) == 3
        assert min(r.seconds) >= 0
        assert r.rate == pytest.approx(r.items / sorted(r.seconds)[1])
        assert r.scene == ("" if r.family in ("bandwidth", "table") else "tiny")


def test_bandwidth(results):
    memory = named(results, "bandwidth")
    assert memory["copy"].items == memory["copy"].nbytes == 2 * memory["read"].items
    assert all(r.rate > 0 for r in memory.values())


def test_rays(results):
    rays = named(results, "rays")
    assert set(rays) == {"build", "primary", "diffuse", "shadow"}
    assert rays["primary"].items == SIZE[0] * SIZE[1]
    assert rays["build"].items == 1280 + 2 + 12
    assert rays["build"].bytes_per_triangle > 36
    # Origin, direction and length in; t, u, v, primitive and instance out; of shadow rays a byte.
    assert rays["primary"].nbytes == rays["primary"].items * (28 + 20)
    assert rays["shadow"].nbytes == rays["shadow"].items * (28 + 1)


@pytest.mark.skipif(not is_installed(), reason="needs embreex")
def test_embree_beside(results):
    rays = named(results, "rays")
    for kind in ("primary", "diffuse", "shadow"):
        assert len(rays[kind].peer_seconds) == 3
        assert rays[kind].ratio == pytest.approx(sorted(rays[kind].peer_seconds)[1] / rays[kind].median)
        assert rays[kind].agree > 0.99
    assert rays["build"].peer_seconds is None  # Embree would build a tree over more triangles: the ball's twice


def test_kernels_of_a_build(results):
    build, sort = named(results, "build"), named(results, "sort")
    assert {"triangle_bounds", "morton_keys", "all kernels"} <= set(build)
    assert not {name for name in build if name.startswith("radix")}
    assert set(sort) == {"radix_count", "radix_offsets", "radix_scatter", "all kernels"}
    for of in (build, sort):
        parts = [r for name, r in of.items() if name != "all kernels"]
        assert of["all kernels"].seconds == pytest.approx(
            [sum(s) for s in zip(*(r.seconds for r in parts), strict=True)]
        )
    assert build["morton_keys"].nbytes >= build["morton_keys"].items * (24 + 8)  # a box in, a key out
    assert build["all kernels"].nbytes is None
    assert sort["radix_scatter"].nbytes > sort["radix_scatter"].items * 24  # keys and numbers, from and to, each round


def test_traffic_of_kernels_that_take_part_of_their_arrays_is_not_known():
    launches = [Launch("k", None, count, 100, longest) for count, longest in ((100, 200), (1, 6))]
    assert traffic(launches, takes_all=False) == 200
    assert traffic([*launches, Launch("k", None, 100, 100, 201)], takes_all=False) is None
    assert traffic([*launches, Launch("k", None, 100, 100, 201)], takes_all=True) == 300


def test_passes_of_the_path_tracer(results):
    passes = named(results, "pathtrace")
    assert {"generate", "trace", "shade", "shadow", "finish", "whole frame"} <= set(passes)
    inside = sum(min(r.seconds) for name, r in passes.items() if name != "whole frame")
    assert inside < max(passes["whole frame"].seconds)
    samples = 4 * SIZE[0] * SIZE[1]
    assert {r.items for r in passes.values()} == {samples}
    assert passes["generate"].nbytes >= samples * 28  # a ray each
    assert passes["whole frame"].nbytes is None


def test_passes_of_the_sample_cache(results):
    passes = named(results, "samplecache")
    assert {"project", "copy", "retrace", "shade", "average", "whole frame", "path-traced frame"} <= set(passes)
    inside = sum(min(r.seconds) for name, r in passes.items() if not name.endswith("frame"))
    assert inside < max(passes["whole frame"].seconds)
    assert {r.items for r in passes.values()} == {SIZE[0] * SIZE[1]}


def test_without_embree(scene, index, tmp_path, monkeypatch):
    (tmp_path / "embreex").mkdir()
    (tmp_path / "embreex" / "__init__.py").write_text("raise ImportError('not here')\n")
    monkeypatch.syspath_prepend(tmp_path)
    found = list(measure(Job(("rays",), index, 1, 1, SIZE, (scene,))))
    assert [r.name for r in found] == ["build", "primary", "diffuse", "shadow"]
    assert all(r.peer_seconds is None and r.agree is None for r in found)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"scenes": ("nowhere.toml",)}, SceneError, "nowhere.toml: no such file"),
        ({"threads": 9999}, SettingError, "--threads 9999: expected 1 .. "),
        ({"device": "no such device"}, SettingError, "device 'no such device': no OpenCL device matches"),
        ({"families": ("nonsense",)}, Error, "ended with exit code 1: KeyError: 'nonsense'"),
    ],
)
def test_errors_come_back(index, changes, error, message):
    job = {"families": ("rays",), "device": index, "threads": 1, "repeats": 1, "size": SIZE, "scenes": ()} | changes
    with pytest.raises(error) as caught:
        list(measure(Job(**job)))
    assert type(caught.value) is error
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def kill_benchmarks(folder):
    """A module that Python imports at its start, and that ends the processes of jobs."""
    kill = "os.kill(os.getpid(), signal.SIGKILL)"
    text = f"import os, signal, sys\nif 'clcache.bench' in sys.orig_argv:\n    {kill}\n"
    (folder / "sitecustomize.py").write_text(text)


def test_a_process_that_is_killed(index, tmp_path, monkeypatch):
    kill_benchmarks(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(Error, match=f"^the process that measures device {index} ended with SIGKILL: "):
        list(measure(Job(("bandwidth",), index, 1, 1, SIZE)))


def test_a_reader_that_stops_ends_the_process(scene, index):
    job = Job(("bandwidth", *["rays"] * 1000), index, 1, 9, SIZE, (scene,))
    results = measure(job)
    next(results)
    child = results.gi_frame.f_locals["child"]
    results.close()
    assert child.returncode == -signal.SIGKILL


def test_a_job_runs_on_as_many_cores_as_it_has_threads(monkeypatch, capsys):
    """And what its process prints is what the other side reads."""
    cores, answers = [], Result("rays", "primary", "", 3, "rays", (0.5,), agree=0.25)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {7, 3, 5}, raising=False)
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, chosen: cores.append(chosen), raising=False)
    monkeypatch.setitem(FAMILIES, "rays", Family("", lambda job: iter([answers] * job.repeats)))
    for threads in (1, 2, None):
        work(json.dumps(asdict(Job(("rays",), "0", threads, 2, SIZE))))
    assert cores == [[3], [3, 5]]
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    assert len(lines) == 6
    assert {line.startswith(ANSWER) for line in lines} == {True}
    assert json.loads(lines[0].removeprefix(ANSWER))["agree"] == 0.25


def test_a_tiny_time_still_has_a_rate():
    result = Result("rays", "primary", "", 3, "rays", (0.0, 0.0, 1.0), nbytes=5)
    assert result.rate == pytest.approx(3e9)
    assert result.entry(1.0)["of_bound"] == pytest.approx(2e-10)


def test_names_of_families():
    assert check_families([]) == tuple(FAMILIES)
    assert check_families(["sort", "rays", "sort"]) == ("bandwidth", "sort", "rays")
    with pytest.raises(SettingError, match="^benchmark ray: unknown; did you mean rays.$"):
        check_families(["ray"])
    with pytest.raises(SettingError, match="^benchmark x: unknown; expected names of bandwidth, rays, "):
        check_families(["x"])


def test_targets(index):
    cores = len(os.sched_getaffinity(0))
    [(candidate, threads)] = targets(index)
    assert str(candidate.index) == index
    assert threads == tuple(dict.fromkeys((1, cores)))
    assert targets(index, (3, 2))[0][1] == (3, 2)
    with pytest.raises(SettingError, match="no OpenCL device matches"):
        targets("no such device")


def test_all_targets_are_the_devices_that_work(monkeypatch):
    """Threads are counted on CPUs alone; a simulator would take forever."""
    kinds = (
        ("PoCL", cl.device_type.CPU),
        ("Oclgrind", cl.device_type.CPU),
        ("Broken", cl.device_type.CPU),
        ("G", cl.device_type.GPU),
    )
    found = [
        SimpleNamespace(index=i, platform=name, device=SimpleNamespace(type=kind))
        for i, (name, kind) in enumerate(kinds)
    ]
    monkeypatch.setattr(drivers, "candidates", lambda: found)
    monkeypatch.setattr(drivers, "probe", lambda c: drivers.Verdict(c.platform != "Broken", ""))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 2, 5}, raising=False)
    assert targets("all") == [(found[0], (1, 3)), (found[3], (None,))]


def test_targets_without_a_device(monkeypatch):
    monkeypatch.setattr(drivers, "candidates", list)
    for spec in (None, "all"):
        with pytest.raises(DeviceError, match="no OpenCL device works"):
            targets(spec)


def test_names_of_scenes(tmp_path, monkeypatch):
    assert short_name("data/cornell/scene.toml") == "cornell"
    assert short_name("models/tea.glb") == "tea"
    job = Job(("rays",), "0", 1, 1, SIZE)
    assert [name for name, _ in job.loaded("cornell")] == ["cornell"]
    assert (DATA / "cornell" / "scene.toml").is_file()
    monkeypatch.setattr("clcache.bench.job.DATA", tmp_path)
    with pytest.raises(SettingError, match="expected --scene FILE$"):
        list(job.loaded("cornell"))
