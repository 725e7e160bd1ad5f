import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pyopencl as cl
import pytest

from clcache import drivers, probe
from clcache.drivers import Candidate, Verdict
from clcache.errors import DeviceError, SettingError

POCL = Candidate(0, "Portable Computing Language", "cpu-zen5-Maker A1", "7.1", "OpenCL 3.0 PoCL 7.1", None)
INTEL = Candidate(1, "Intel(R) OpenCL", "Maker A1", "2026.2", "OpenCL 3.1 LINUX", None)
GPU = Candidate(2, "Vendor Compute", "RTX 3090", "1", "OpenCL 3.0", None)


@pytest.fixture(autouse=True)
def no_choice_in_the_environment(monkeypatch):
    monkeypatch.delenv("CLCACHE_DEVICE", raising=False)


@pytest.fixture
def three_devices(monkeypatch):
    """Three devices that all work, but for those whose index the test adds to the set."""
    broken = set()
    monkeypatch.setattr(drivers, "candidates", lambda: [POCL, INTEL, GPU])
    monkeypatch.setattr(drivers, "probe", lambda c: Verdict(c.index not in broken, "error: it is broken"))
    return broken


def child_running(monkeypatch, tmp_path, code):
    """Let the child process that proves a device run this code instead."""
    script = tmp_path / "child.py"
    script.write_text(code)
    monkeypatch.setattr(probe, "__file__", str(script))
    return drivers.check_loading()


# The probe kernel and its numbers


def test_default_device_passes_a_fresh_probe():
    chosen = drivers.choose()
    assert drivers.probe(chosen, use_caches=False) == Verdict(True, "the probe kernel gave the right numbers")


@pytest.mark.parametrize(
    ("right", "wrong", "reported"),
    [
        (
            "vload16(item, a) * vload16(item, b) + vload16(item, a)",
            "fma(vload16(item, a), vload16(item, b), vload16(item, a))",
            "vectors",
        ),
        ("vstore8(high_half, 2 * item + 1", "vstore8(low_half, 2 * item + 1", "vectors"),
        ("ulong key = ", "uint key = ", "64-bit integers"),
        ("exchange[GROUP - 1 - lane]", "exchange[lane]", "local memory"),
        ("atomic_max", "atomic_min", "atomics"),
        ("seen + 1", "seen", "atomics"),
        ("atomic_add(&counters[0], item)", "counters[0] = item", "atomics"),
    ],
)
def test_probe_names_what_is_wrong(monkeypatch, tmp_path, right, wrong, reported):
    source = probe.KERNEL.read_text()
    assert right in source
    monkeypatch.setattr(probe, "KERNEL", tmp_path / "probe.cl")
    probe.KERNEL.write_text(source.replace(right, wrong))
    assert probe.failure(drivers.choose().device) == f"wrong numbers: {reported}"


def test_failed_build_is_told_in_the_compilers_line(monkeypatch, tmp_path):
    monkeypatch.setattr(probe, "KERNEL", tmp_path / "probe.cl")
    probe.KERNEL.write_text("__kernel void probe(__global nosuchtype *a) {}\n")
    failure = probe.failure(drivers.choose().device)
    assert "error: " in failure
    assert "unknown type name 'nosuchtype'" in failure
    assert "\n" not in failure


# A driver that ends the process, or hangs, ends only the child


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (
            "import os; os.write(2, b'LLVM ERROR: Cannot select\\nStack dump:\\n'); os.abort()",
            "ended the process with SIGABRT: LLVM ERROR: Cannot select",
        ),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "ended the process with SIGSEGV: no message"),
        ("import os; os.write(2, b'no licence\\n'); os._exit(3)", "ended the process with exit code 3: no licence"),
        (
            "import nosuchmodule",
            "ended the process with exit code 1: ModuleNotFoundError: No module named 'nosuchmodule'",
        ),
    ],
)
def test_end_of_the_child_is_a_verdict(monkeypatch, tmp_path, code, reason):
    assert child_running(monkeypatch, tmp_path, code) == Verdict(False, reason, crashed=True)


def test_hanging_child_is_ended(monkeypatch, tmp_path):
    monkeypatch.setattr(drivers, "TIME_LIMIT", 0.2)
    verdict = child_running(monkeypatch, tmp_path, "import signal; signal.pause()")
    assert verdict == Verdict(False, "gave no answer within 0.2 s", crashed=True)


@pytest.mark.parametrize(
    ("answer", "verdict"),
    [
        ("null", Verdict(True, "the probe kernel gave the right numbers")),
        ('"wrong numbers: vectors"', Verdict(False, "wrong numbers: vectors")),
    ],
)
def test_what_a_driver_prints_does_not_hide_the_answer(monkeypatch, tmp_path, answer, verdict):
    code = f"print('driver: hello'); print('{probe.ANSWER}{answer}'); print('driver: bye')"
    assert child_running(monkeypatch, tmp_path, code) == verdict


def test_child_that_ends_well_without_an_answer_is_no_proof(monkeypatch, tmp_path):
    verdict = child_running(monkeypatch, tmp_path, "print('driver: bye')")
    assert verdict == Verdict(False, "ended the process before it was done", crashed=True)


def test_driver_file_that_names_no_library(tmp_path):
    file = tmp_path / "gone.icd"
    file.write_text("/nonexistent/libgone.so\n")
    verdict = drivers.check_driver_file(file)
    assert not verdict.usable
    assert not verdict.crashed
    assert "/nonexistent/libgone.so" in verdict.reason


def test_driver_file_that_names_a_library_without_opencl(tmp_path):
    file = tmp_path / "maths.icd"
    file.write_text("libm.so.6\n")
    assert drivers.check_driver_file(file) == Verdict(False, "no OpenCL platform")


def test_driver_files_of_this_machine():
    files = probe.driver_files()
    if not files:
        pytest.skip("the default device needs no driver file")
    assert any(drivers.check_driver_file(file).usable for file in files)


# Which device a name means


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("0", POCL),
        ("2", GPU),
        ("portable", POCL),
        ("ZEN5", POCL),
        ("pocl", POCL),
        ("intel(r)", INTEL),
        ("rtx 3090", GPU),
        (None, POCL),
    ],
)
@pytest.mark.usefixtures("three_devices")
def test_choice(spec, expected):
    assert drivers.choose(spec) is expected


@pytest.mark.parametrize(
    ("spec", "problem", "choices"),
    [
        ("3", "no OpenCL device matches", (POCL, INTEL, GPU)),
        ("3090", "no OpenCL device matches", (POCL, INTEL, GPU)),
        ("-1", "no OpenCL device matches", (POCL, INTEL, GPU)),
        ("radeon", "no OpenCL device matches", (POCL, INTEL, GPU)),
        ("maker", "several OpenCL devices match", (POCL, INTEL)),
        ("", "several OpenCL devices match", (POCL, INTEL, GPU)),
    ],
)
@pytest.mark.usefixtures("three_devices")
def test_unknown_and_ambiguous_names_list_the_choices(spec, problem, choices):
    with pytest.raises(SettingError) as error:
        drivers.choose(spec)
    assert str(error.value).startswith(f"device {spec!r}: {problem}")
    assert str(error.value).endswith("of: " + ", ".join(f"{c.index} ({c.platform}: {c.name})" for c in choices))


@pytest.mark.usefixtures("three_devices")
def test_environment_names_the_default_only(monkeypatch):
    monkeypatch.setenv("CLCACHE_DEVICE", "intel")
    assert drivers.choose() is INTEL
    assert drivers.choose("2") is GPU
    monkeypatch.setenv("CLCACHE_DEVICE", "")
    assert drivers.choose() is POCL


def test_default_is_the_first_that_works(three_devices):
    three_devices.update({0, 1})
    assert drivers.choose() is GPU


def test_named_device_must_work(three_devices):
    three_devices.add(1)
    with pytest.raises(DeviceError, match=r"device 1 .* error: it is broken; `clcache doctor`"):
        drivers.choose("intel")


def test_no_device_works(three_devices):
    three_devices.update({0, 1, 2})
    with pytest.raises(DeviceError, match=r"3 found; the first: error: it is broken\); `clcache doctor`"):
        drivers.choose()


@pytest.mark.parametrize("spec", [None, "0", "pocl"])
def test_no_device_is_found(monkeypatch, spec):
    monkeypatch.setattr(drivers, "candidates", list)
    with pytest.raises(DeviceError, match="no driver lists one.*`clcache doctor`"):
        drivers.choose(spec)


def test_order_of_preference(monkeypatch):
    def platform(name, version, kind):
        devices = []
        platform = SimpleNamespace(name=name, version=version, get_devices=lambda: devices)
        devices.append(SimpleNamespace(platform=platform, type=kind))
        return platform

    pocl, pocl_gpu = "OpenCL 3.0 PoCL 7.1", "OpenCL 3.0 PoCL 7.1 CUDA"
    found = [
        platform("Oclgrind", "OpenCL 1.2 (Oclgrind 21.10)", cl.device_type.CPU),
        platform("GPU maker", "OpenCL 3.0", cl.device_type.GPU),
        platform("PoCL's GPU", pocl_gpu, cl.device_type.GPU),
        platform("CPU maker", "OpenCL 3.0", cl.device_type.CPU),
        platform("PoCL's CPU", pocl, cl.device_type.CPU),
    ]
    monkeypatch.setattr(probe, "platforms", lambda: found)
    names = [device.platform.name for device in probe.devices()]
    assert names == ["PoCL's CPU", "CPU maker", "PoCL's GPU", "GPU maker", "Oclgrind"]


# Intel's runtime from PyPI beside the system's drivers


def test_intel_wheel_is_added_to_the_systems_drivers(monkeypatch, tmp_path):
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    monkeypatch.setenv("OPENCL_VENDOR_PATH", str(tmp_path))
    monkeypatch.setattr(probe, "intel_runtime", lambda: Path("/prefix/lib/libintelocl.so"))
    (tmp_path / "system.icd").write_text("libsystem.so\n")
    with probe._vendor_folder():
        folder = Path(os.environ["OCL_ICD_VENDORS"])
        libraries = {file.read_text().strip() for file in folder.glob("*.icd")}
    assert libraries == {"libsystem.so", "/prefix/lib/libintelocl.so"}
    assert "OCL_ICD_VENDORS" not in os.environ
    assert not folder.exists()


def test_the_users_choice_of_drivers_is_left_alone(monkeypatch):
    monkeypatch.setenv("OCL_ICD_VENDORS", "/only/this.icd")
    monkeypatch.setattr(probe, "intel_runtime", lambda: Path("/prefix/lib/libintelocl.so"))
    with probe._vendor_folder():
        assert os.environ["OCL_ICD_VENDORS"] == "/only/this.icd"


def test_intel_wheel_works():
    if probe.intel_runtime() is None or os.environ.get("OCL_ICD_VENDORS"):
        pytest.skip("needs the wheel intel-opencl-rt")
    assert drivers.probe(drivers.choose("intel")).usable


@pytest.mark.parametrize(
    ("attempt", "survives"),
    [("True", True), ("False", False), ("os._exit(1)", False), ("os.kill(os.getpid(), 9)", False), ("1 / 0", False)],
)
def test_what_ends_the_process_is_tried_in_a_copy(attempt, survives):
    code = f"import os; from clcache import probe; print(probe._survives(lambda: {attempt}), 'went on')"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert child.stdout.split("\n")[0] == f"{survives} went on"
