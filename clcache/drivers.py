"""Which OpenCL device to use: every device found, whether it really works, and the choice between those that do.

A platform that is listed proves nothing: a driver may fail every build, return wrong numbers, hang, or end the process.
So a device counts as usable only after the probe kernel of `probe.py` gave the right numbers on it, in a child process
with a time limit (about 0.15 s once the driver has the kernel in its cache).
"""

import functools
import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pyopencl as cl

from . import probe as prober
from .errors import DeviceError, SettingError

TIME_LIMIT = 60  # seconds; a first build takes one or two, several when the driver is read from a slow disk
ADVICE = "`clcache doctor` says what to do"


@dataclass(frozen=True)
class Candidate:
    """A device that an installed driver lists; index: its place in the order of preference."""

    index: int
    platform: str
    name: str
    driver_version: str
    platform_version: str
    device: cl.Device

    def __str__(self) -> str:
        return f"{self.index} ({self.platform}: {self.name})"


@dataclass(frozen=True)
class Verdict:
    """Whether a device, or a driver, works; reason: one line; crashed: it ended the process, or would not end; vectorises:
    whether `probe.vectorise_loops` helps it."""

    usable: bool
    reason: str
    crashed: bool = False
    vectorises: bool = field(default=False, compare=False)


def candidates() -> list[Candidate]:
    """Every OpenCL device here, best first: PoCL's CPU, other CPUs, other devices, simulators."""
    return [
        Candidate(
            index,
            device.platform.name.strip(),
            device.name.strip(),
            device.driver_version.strip(),
            device.platform.version.strip(),
            device,
        )
        for index, device in enumerate(prober.devices())
    ]


@functools.cache
def probe(candidate: Candidate, use_caches: bool = True) -> Verdict:
    """Build and run the probe kernel on the device, in a child process; once per process and device.

    use_caches: let the driver take the kernel from its cache of binaries; a fresh build is slower and proves more.
    """
    fresh = {} if use_caches else {"POCL_KERNEL_CACHE": "0", "PYOPENCL_NO_CACHE": "1"}
    return _run_child([str(candidate.index)], fresh)


@functools.cache
def proves(candidate: Candidate, feature: str) -> bool:
    """Whether the device, which works, has an optional feature, one of `probe.FEATURES`: tried in a child process, once."""
    return _run_child([str(candidate.index), feature], {}).usable


def choose(spec: str | None = None) -> Candidate:
    """The device to use.

    spec: an index of `candidates`, or a part, in either case, of one platform's or device's name; None: the
    environment variable CLCACHE_DEVICE, else the first device that works.
    Raises SettingError where spec names no device or several, DeviceError where the device does not work.
    """
    found = candidates()
    spec = os.environ.get("CLCACHE_DEVICE") or None if spec is None else spec
    if spec is None or not found:
        usable = next((c for c in found if probe(c).usable), None)
        if usable is None:
            state = f"{len(found)} found; the first: {probe(found[0]).reason}" if found else "no driver lists one"
            raise DeviceError(f"no OpenCL device works here ({state}); {ADVICE}")
        return _prepared(usable)
    candidate = _named(spec, found)
    verdict = probe(candidate)
    if not verdict.usable:
        raise DeviceError(f"device {candidate} does not work: {verdict.reason}; {ADVICE}")
    return _prepared(candidate)


def _prepared(candidate: Candidate) -> Candidate:
    """The device, after its driver was told to make vectors, if it takes that."""
    if probe(candidate).vectorises:
        prober.vectorise_loops()
    return candidate


def check_loading() -> Verdict:
    """Whether all drivers together can be loaded without ending the process, which `candidates` takes for granted."""
    return _run_child([], {})


def check_driver_file(path: Path) -> Verdict:
    """Whether the driver that a single .icd file names can be loaded and gives a platform."""
    return _run_child([], {"OCL_ICD_VENDORS": str(path)})


def _named(spec: str, found: list[Candidate]) -> Candidate:
    if spec.isdecimal():
        matches = found[int(spec) :][:1]
    else:
        part = spec.casefold()  # the version's text is where PoCL's platforms go by that name
        matches = [c for c in found if any(part in t.casefold() for t in (c.platform, c.name, c.platform_version))]
    if len(matches) == 1:
        return matches[0]
    problem = "several OpenCL devices match" if matches else "no OpenCL device matches"
    choices = ", ".join(str(c) for c in matches or found)
    raise SettingError(f"device {spec!r}: {problem}; expected an index or part of one name of: {choices}")


def _run_child(arguments: list[str], environment: dict[str, str]) -> Verdict:
    command = [sys.executable, "-P", prober.__file__, *arguments]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | environment
    try:
        child = subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIME_LIMIT,
        )
    except subprocess.TimeoutExpired:
        return Verdict(False, f"gave no answer within {TIME_LIMIT} s", crashed=True)
    if child.returncode:
        return Verdict(False, f"{_ending(child.returncode)}: {prober.gist(child.stderr)}", crashed=True)
    answers = [line for line in child.stdout.splitlines() if line.startswith(prober.ANSWER)]  # drivers may print, too
    if not answers:
        return Verdict(False, "ended the process before it was done", crashed=True)
    failure = json.loads(answers[-1].removeprefix(prober.ANSWER))
    vectorises = prober.VECTORISED in child.stdout.splitlines()
    return Verdict(failure is None, failure or "the probe kernel gave the right numbers", vectorises=vectorises)


def _ending(returncode: int) -> str:
    if returncode > 0:
        return f"ended the process with exit code {returncode}"
    try:
        return f"ended the process with {signal.Signals(-returncode).name}"
    except ValueError:
        return f"ended the process with signal {-returncode}"
