import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import clcache
from clcache import advice, cli, drivers, probe
from clcache.drivers import Verdict


def doctor(**environment):
    """Run the real command in a process of its own: exit code and output lines."""
    environment = {"CLCACHE_DEVICE": "", **{name: str(value) for name, value in environment.items()}}
    done = subprocess.run(
        [sys.executable, "-m", "clcache", "doctor"],
        cwd=Path(clcache.__file__).parents[1],
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )
    assert done.stderr == ""
    return done.returncode, done.stdout.splitlines()


def driver_file(folder, library):
    file = folder / "driver.icd"
    file.write_text(f"{library}\n")
    return file


def test_a_device_that_works():
    code, lines = doctor()
    assert code == 0
    assert lines[-1].startswith(f"used: device {drivers.choose()}: ")
    assert "    works          the probe kernel gave the right numbers" in lines
    for name in ("driver", "compute units", "memory", "has", "lacks"):
        assert any(line.startswith(f"    {name:14} ") for line in lines)


def test_the_environment_names_the_device():
    code, lines = doctor(CLCACHE_DEVICE="0")
    assert code == 0
    assert lines[-1].endswith("CLCACHE_DEVICE=0 names it")


def test_the_environment_names_no_device():
    code, lines = doctor(CLCACHE_DEVICE="no such device")
    assert code == 1
    assert lines[-1].startswith("CLCACHE_DEVICE=no such device: device 'no such device': no OpenCL device matches")


def test_no_driver(tmp_path):
    file = driver_file(tmp_path, "/nonexistent/libgone.so")
    code, lines = doctor(OCL_ICD_VENDORS=file)
    assert code == 1
    assert lines[0].startswith(f"driver file {file}: ")
    assert "/nonexistent/libgone.so" in lines[0]
    assert lines[1:3] == ["no OpenCL device was found; what to do:", "    unset OCL_ICD_VENDORS"]


def test_driver_that_ends_the_process_when_loaded(tmp_path):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    source, library = tmp_path / "abort.c", tmp_path / "libabort.so"
    source.write_text("#include <stdlib.h>\n__attribute__((constructor)) static void load(void) { abort(); }\n")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source], check=True)
    file = driver_file(tmp_path, library)
    code, lines = doctor(OCL_ICD_VENDORS=file)
    assert code == 1
    assert lines[0] == f"driver file {file}: ended the process with SIGABRT: no message"
    assert lines[1].startswith("loading the OpenCL drivers fails: ended the process with SIGABRT")
    assert "OCL_ICD_VENDORS" in lines[2]


def test_platform_without_a_device(monkeypatch, capsys):
    empty = SimpleNamespace(name="An empty one", version="OpenCL 3.0 PoCL 9.9", get_devices=list)
    real = probe.platforms()
    monkeypatch.setattr(probe, "platforms", lambda: [empty, *real])
    assert cli.main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "platform An empty one (OpenCL 3.0 PoCL 9.9) lists no device"
    assert "XDG_CACHE_HOME" in lines[1]


def test_a_device_that_fails_its_probe(monkeypatch, capsys):
    monkeypatch.delenv("CLCACHE_DEVICE", raising=False)
    monkeypatch.setattr(advice, "install_driver", lambda: ["install this", "or that"])
    broken = "error: unknown target CPU 'generic'"
    monkeypatch.setattr(drivers, "probe", lambda candidate, use_caches=True: Verdict(False, broken))
    assert cli.main(["doctor"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("device 0 (")
    assert f"    DOES NOT WORK  {broken}" in lines
    assert lines[-3:] == ["no OpenCL device works; what to do:", "    install this", "    or that"]
    assert not any(line.startswith("used:") for line in lines)
