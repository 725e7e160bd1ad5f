"""The OpenCL devices of this machine, and a kernel that proves that one of them works.

A driver that is listed may still fail every build, return wrong numbers, hang, or end the process with an error of its
compiler. `drivers.probe` therefore runs this file in a child process, and it imports nothing else of the package, so
that the child starts quickly:

    python probe.py            load the drivers and ask for their platforms
    python probe.py INDEX      prove one device

It prints a line that starts with ANSWER and gives what is wrong, null if nothing is, as JSON; any other end of the
process is an answer, too. A line VECTORISED before that says that `vectorise_loops` can be called.
"""

import contextlib
import ctypes
import functools
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path

import numpy as np
import pyopencl as cl

KERNEL = Path(__file__).parent / "cl" / "probe.cl"
ANSWER = "wrong: "
VECTORISED = "loops are vectorised"
GROUP = 64  # work-items in a group, as in probe.cl
ITEMS = 4 * GROUP


@functools.cache
def platforms() -> list[cl.Platform]:
    """Every OpenCL platform: the loader's, and Intel's CPU runtime if its wheel is installed."""
    with _vendor_folder():
        try:
            return cl.get_platforms()
        except cl.Error:  # none at all is an error of OpenCL's
            return []


@functools.cache
def vectorise_loops() -> bool:
    """Let PoCL compute neighbouring work-items side by side; whether there was something to be done, and it was.

    PoCL has LLVM look for vectors within a work-item first (SLP), and LLVM's loop vectoriser then refuses the loop over the
    work-items wherever some were found: shading takes three times as long. A threshold that no gain reaches turns the
    former off. Sixteen work-items at a time, which is two vectors on most processors, hide more of the time that memory
    takes than the eight of LLVM's choice: a fifth less. PoCL has no settings for either, and where LLVM is linked into it,
    nothing changes. Results are the same bits all the same. An LLVM that does not know the options would end the process,
    so they are tried in another one first (`main`).
    """
    platforms()
    try:
        mapped = {line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "/libpocl" in line}
        pocl = ctypes.CDLL(mapped.pop()) if mapped else None
    except OSError:
        return False
    parse = getattr(pocl, "LLVMParseCommandLineOptions", None)  # a name of the libraries that PoCL is linked with, too
    if parse is None:
        return False
    arguments = [b"clcache", b"-slp-threshold=1000000", b"-force-vector-width=16"]
    parse(len(arguments), (ctypes.c_char_p * len(arguments))(*arguments), None)
    return True


def devices() -> list[cl.Device]:
    """Every device of every platform: CPUs with PoCL first, then other CPUs, other devices, and simulators."""
    return sorted((device for platform in platforms() for device in _devices_of(platform)), key=_preference)


def empty_platforms() -> list[cl.Platform]:
    """The platforms that list no device."""
    return [platform for platform in platforms() if not _devices_of(platform)]


def driver_files() -> list[Path]:
    """The .icd files by which the loader finds the system's drivers."""
    setting = os.environ.get("OCL_ICD_VENDORS") or os.environ.get("OPENCL_VENDOR_PATH") or "/etc/OpenCL/vendors"
    path = Path(setting)
    return sorted(path.glob("*.icd")) if path.is_dir() else [path] if path.suffix == ".icd" and path.is_file() else []


def intel_runtime() -> Path | None:
    """The driver library of the wheel intel-opencl-rt, if it is installed."""
    try:
        files = metadata.files("intel-opencl-rt") or []
    except metadata.PackageNotFoundError:
        return None
    return next((Path(f.locate()).resolve() for f in files if f.name == "libintelocl.so"), None)


def failure(device: cl.Device) -> str | None:
    """Build and run the probe kernel: None if every number is right, else what went wrong."""
    a, b = np.random.default_rng(1).random((2, 16 * ITEMS), dtype=np.float32)
    expected = _expected(a, b)
    try:
        results = _run(device, a, b, expected)
    except cl.Error as error:
        return gist(str(error).split("\n\n(options:")[0])  # PyOpenCL's own last line
    wrong = [name for name, right in expected.items() if not np.array_equal(results[name], right)]
    return f"wrong numbers: {', '.join(wrong)}" if wrong else None


def loading_failure() -> str | None:
    """Load the drivers: None if there is a platform, else why the first of them gives none."""
    if platforms():
        return None
    for file in driver_files():
        try:
            ctypes.CDLL(file.read_text(errors="replace").strip())
        except (OSError, ValueError) as error:
            return f"its library cannot be loaded: {error}"
    return "no OpenCL platform"


def gist(output: str) -> str:
    """The line that tells most of what a driver or a failed process printed: its first error, else its last line."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    return next((line for line in lines if "error:" in line.lower()), lines[-1] if lines else "no message")


@contextlib.contextmanager
def _vendor_folder() -> Iterator[None]:
    """Have the loader find Intel's wheel beside the system's drivers.

    The wheel's own .icd file names a folder that does not exist. The loader reads the vendors' folder only once, when
    the platforms are first asked for, so a temporary one will do.
    """
    library = intel_runtime()
    if library is None or os.environ.get("OCL_ICD_VENDORS"):
        yield
        return
    with tempfile.TemporaryDirectory(prefix="clcache-drivers-") as folder:
        for file in driver_files():
            (Path(folder) / file.name).symlink_to(file)
        (Path(folder) / "clcache-intel.icd").write_text(f"{library}\n")
        os.environ["OCL_ICD_VENDORS"] = folder
        try:
            yield
        finally:
            del os.environ["OCL_ICD_VENDORS"]


def _devices_of(platform: cl.Platform) -> list[cl.Device]:
    try:
        return platform.get_devices()
    except cl.Error:
        return []


def _preference(device: cl.Device) -> tuple[bool, bool, bool]:
    is_cpu = bool(device.type & cl.device_type.CPU)
    return "Oclgrind" in device.platform.name, not is_cpu, "PoCL" not in device.platform.version


def _expected(a: np.ndarray, b: np.ndarray) -> dict[str, np.ndarray]:
    item = np.arange(ITEMS, dtype=np.uint32)
    low, high = np.split((a * b + a).reshape(ITEMS, 16), 2, axis=1)
    key = (item + 1).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    key ^= key >> np.uint64(30)
    return {
        "vectors": np.hstack([np.maximum(low, high), np.minimum(low, high)]).ravel(),
        "64-bit integers": key * np.uint64(0xBF58476D1CE4E5B9),
        "local memory": item.reshape(-1, GROUP)[:, ::-1].ravel(),
        "atomics": np.array([item.sum(), item.max(), ITEMS], np.uint32),
    }


def _run(device: cl.Device, a: np.ndarray, b: np.ndarray, outputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    program = cl.Program(context, KERNEL.read_text()).build("-cl-std=CL1.2")
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    results = {name: np.zeros_like(array) for name, array in outputs.items()}
    buffers = [cl.Buffer(context, flags, hostbuf=array) for array in (a, b, *results.values())]
    cl.Kernel(program, "probe")(queue, (ITEMS,), (GROUP,), *buffers)
    for result, buffer in zip(results.values(), buffers[2:], strict=True):
        cl.enqueue_copy(queue, result, buffer)
    return results


def _survives(attempt: Callable[[], bool]) -> bool:
    """Whether a copy of this process gets True from the attempt, rather than ending with it."""
    copy = os.fork()
    if copy == 0:
        done = False
        try:
            done = attempt()
        finally:
            os._exit(0 if done else 1)
    return os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1]) == 0


def main(arguments: list[str]) -> None:
    """Print the verdict, as JSON behind ANSWER, on the device of the given index; without one, on loading the drivers."""
    if arguments and sys.platform == "linux" and _survives(vectorise_loops):
        vectorise_loops()
        print(f"\n{VECTORISED}", flush=True)
    found = failure(devices()[int(arguments[0])]) if arguments else loading_failure()
    print(f"\n{ANSWER}{json.dumps(found)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
