"""What to install on this machine, and how, so that it gets an OpenCL device that works."""

import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from . import probe

INTEL_WHEELS = "intel-opencl-rt intel-cmplr-lib-rt"


def install_driver() -> list[str]:
    """What to tell the user, in lines: first the shell command that helps, if there is one.

    PoCL from the system's packages where the user may install them without a question, else Intel's CPU runtime from
    PyPI, which needs no root; neither where it is installed already, and so does not work.
    """
    for variable in ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"):
        if os.environ.get(variable):
            return [f"unset {variable}", "(it hides all drivers but its own)"]
    if sys.platform != "linux":
        return ["install the OpenCL driver of the processor's or the graphics card's maker"]
    package = None if any("pocl" in file.name for file in probe.driver_files()) else _pocl_commands()
    prefix = _root_prefix()
    if package and prefix is not None:
        return [" && ".join(prefix + command for command in package)]
    has_wheels = platform.machine() == "x86_64"
    lines = [_pip_command()] if has_wheels and probe.intel_runtime() is None else []
    if package:
        lines.append(f"{'or, ' if lines else ''}as root: {' && '.join(package)}")
    if not has_wheels:
        lines.append(f"(Intel's CPU runtime on PyPI is for x86_64 only, not for {platform.machine()})")
    return lines or ["no driver is left to suggest: install that of the processor's or the graphics card's maker"]


def _pocl_commands() -> list[str] | None:
    if shutil.which("apt-get"):
        return ["apt-get update", "apt-get install -y pocl-opencl-icd"]
    return ["dnf install -y pocl"] if shutil.which("dnf") else None


def _root_prefix() -> str | None:
    """What makes a command run as root without a question: "" for root, "sudo ", or None."""
    if os.geteuid() == 0:
        return ""
    if shutil.which("sudo") is None:
        return None
    asked = subprocess.run(["sudo", "-n", "true"], stdin=subprocess.DEVNULL, capture_output=True)
    return "sudo " if asked.returncode == 0 else None


def _pip_command() -> str:
    python = shlex.quote(sys.executable)
    if importlib.util.find_spec("pip") is None:
        if shutil.which("uv"):
            return f"uv pip install --python {python} {INTEL_WHEELS}"
        return f"{python} -m ensurepip && {python} -m pip install {INTEL_WHEELS}"
    managed = sys.prefix == sys.base_prefix and Path(sysconfig.get_path("stdlib"), "EXTERNALLY-MANAGED").exists()
    return f"{python} -m pip install {'--break-system-packages ' if managed else ''}{INTEL_WHEELS}"
