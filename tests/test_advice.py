import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from clcache import advice, probe

APT = "apt-get update && apt-get install -y pocl-opencl-icd"
SUDO_APT = "sudo apt-get update && sudo apt-get install -y pocl-opencl-icd"
PIP = f"{sys.executable} -m pip install intel-opencl-rt intel-cmplr-lib-rt"
NOTHING = "no driver is left to suggest: install that of the processor's or the graphics card's maker"


@pytest.fixture
def machine(monkeypatch):
    """A Debian machine on x86_64 without any driver, for an ordinary user who has pip; the arguments change that."""

    def make(tools=("apt-get",), root=False, sudo_asks=False, arch="x86_64", drivers=(), intel=False, pip=True):
        monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
        monkeypatch.delenv("OPENCL_VENDOR_PATH", raising=False)
        monkeypatch.setattr(advice.shutil, "which", lambda tool: f"/usr/bin/{tool}" if tool in tools else None)
        monkeypatch.setattr(advice.os, "geteuid", lambda: 0 if root else 1000)
        monkeypatch.setattr(advice.subprocess, "run", lambda *a, **k: SimpleNamespace(returncode=int(sudo_asks)))
        monkeypatch.setattr(advice.platform, "machine", lambda: arch)
        monkeypatch.setattr(advice.importlib.util, "find_spec", lambda name: object() if pip else None)
        monkeypatch.setattr(probe, "driver_files", lambda: [Path("/etc/OpenCL/vendors", name) for name in drivers])
        monkeypatch.setattr(probe, "intel_runtime", lambda: Path("/prefix/lib/libintelocl.so") if intel else None)
        monkeypatch.setattr(sys, "prefix", "/an/environment")
        return advice.install_driver()

    return make


def test_root_installs_the_systems_pocl(machine):
    assert machine(root=True) == [APT]


def test_sudo_without_a_question_installs_the_systems_pocl(machine):
    assert machine(tools=("apt-get", "sudo")) == [SUDO_APT]


def test_sudo_that_asks_is_not_relied_on(machine):
    assert machine(tools=("apt-get", "sudo"), sudo_asks=True) == [PIP, f"or, as root: {APT}"]


def test_without_root_intels_runtime_from_pypi(machine):
    assert machine() == [PIP, f"or, as root: {APT}"]


def test_fedora(machine):
    assert machine(tools=("dnf",), root=True) == ["dnf install -y pocl"]


def test_system_without_a_known_package_manager(machine):
    assert machine(tools=(), root=True) == [PIP]


def test_installed_drivers_are_not_suggested_again(machine):
    assert machine(root=True, drivers=("pocl.icd",)) == [PIP]
    assert machine(intel=True) == [f"as root: {APT}"]
    assert machine(root=True, drivers=("pocl.icd",), intel=True) == [NOTHING]


def test_intels_runtime_is_for_x86_only(machine):
    assert machine(arch="aarch64", root=True) == [APT]
    remark = "(Intel's CPU runtime on PyPI is for x86_64 only, not for aarch64)"
    assert machine(arch="aarch64") == [f"as root: {APT}", remark]


def test_environment_without_pip(machine):
    assert machine(tools=("uv",), pip=False) == [
        f"uv pip install --python {sys.executable} intel-opencl-rt intel-cmplr-lib-rt"
    ]
    assert machine(tools=(), pip=False) == [f"{sys.executable} -m ensurepip && {PIP}"]


def test_externally_managed_python(machine, monkeypatch, tmp_path):
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    monkeypatch.setattr(advice.sysconfig, "get_path", lambda name: str(tmp_path))
    assert "--break-system-packages" not in machine(tools=())[0]
    monkeypatch.setattr(sys, "base_prefix", "/an/environment")
    assert machine(tools=())[0] == PIP.replace("install", "install --break-system-packages")


@pytest.mark.parametrize("variable", ["OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"])
def test_variable_that_hides_drivers(monkeypatch, variable):
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    monkeypatch.setenv(variable, "/some/where")
    assert advice.install_driver()[0] == f"unset {variable}"
