"""The OpenCL devices of this machine, and a kernel that proves that one of them works.

A driver that is listed may still fail every build, return wrong numbers, hang, or end the process with an error of its
compiler. `drivers.probe` therefore runs this file in a child process, and it imports nothing else of the package, so
that the child starts quickly:

    python probe.py            load the drivers and ask for their platforms
    python probe.py INDEX      prove one device
    python probe.py INDEX lanes    prove that its sub-groups do what a lane group does (cl/common/lane_group.cl)
    python probe.py INDEX images   prove that a kernel may read what it wrote to an image

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
LANE_KERNEL = (KERNEL.parent / "common" / "lane_group.cl", KERNEL.parent / "probe_lanes.cl")
IMAGE_KERNEL = KERNEL.parent / "probe_images.cl"
ANSWER = "wrong: "
VECTORISED = "loops are vectorised"
GROUP = 64  # work-items in a group, as in probe.cl
LANES = 32  # of a lane group
LANE_FUNCTIONS = (
    "ballot",
    "broadcast",
    "shuffle",
    "shuffle of floats",
    "minimum",
    *2 * ("calls",),
)  # of probe_lanes.cl
LANE_EXTENSIONS = {"cl_khr_subgroup_ballot", "cl_khr_subgroup_shuffle", "cl_intel_required_subgroup_size"}
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


def lanes_failure(device: cl.Device) -> str | None:
    """Whether lane groups may be sub-groups: None if so, else what is missing or went wrong. (Intel's runtime of 2026 exchanges values
    rightly, and gets functions wrong that lanes call with vectors.)"""
    if missing := LANE_EXTENSIONS - set(device.extensions.split()):
        return f"it lacks {', '.join(sorted(missing))}"
    values = np.random.default_rng(1).integers(0, 2**32, ITEMS, dtype=np.uint32)
    source = "".join(file.read_text() for file in LANE_KERNEL)
    try:
        context = cl.Context([device])
        queue = cl.CommandQueue(context)
        program = cl.Program(context, source).build(["-cl-std=CL1.2", "-DNATIVE_SUBGROUPS=1"])
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        found = np.zeros((7, ITEMS), np.uint32)
        buffers = [cl.Buffer(context, flags, hostbuf=array) for array in (values, found)]
        cl.Kernel(program, "probe")(queue, (ITEMS,), (LANES,), *buffers, np.uint32(ITEMS))
        cl.enqueue_copy(queue, found, buffers[1])
    except cl.Error as error:
        return gist(str(error))
    rows = zip(LANE_FUNCTIONS, found, lanes_expected(values), strict=True)
    wrong = dict.fromkeys(name for name, row, right in rows if not np.array_equal(row, right))
    return f"wrong numbers: {', '.join(wrong)}" if wrong else None


def lanes_expected(values: np.ndarray) -> np.ndarray:
    """What probe_lanes.cl finds: (7, n) of (n,) uint32."""
    lanes = values.reshape(-1, LANES)
    chosen = np.take_along_axis(lanes, (lanes >> 7).astype(np.int64) % LANES, 1)
    all_alike = (((lanes & 1) << np.arange(LANES, dtype=np.uint32)).sum(1), lanes[:, 5], lanes.min(1))
    ballot, broadcast, least = (np.repeat(value.astype(np.uint32), LANES) for value in all_alike)
    as_float = (chosen >> 8).astype(np.float32).astype(np.uint32)
    x, y, calls = values & 255, values >> 8 & 255, values & 1  # whole numbers that floats hold exactly
    calculated = (calls * (2 * x + 1 + 3 * y + 2), calls * ((x + y) * x + 2))
    return np.stack([ballot, broadcast, chosen.ravel(), as_float.ravel(), least, *calculated]).astype(np.uint32)


def images_failure(device: cl.Device) -> str | None:
    """Whether a kernel may write an image and read it again: None if so, else what is missing or went wrong."""
    if not device.image_support:
        return "it lacks images"
    try:
        context = cl.Context([device])
        queue = cl.CommandQueue(context)
        program = cl.Program(context, IMAGE_KERNEL.read_text()).build("-cl-std=CL1.2")
        found = np.zeros((2, ITEMS, 4), np.float32)
        for kind in (cl.channel_type.FLOAT, cl.channel_type.HALF_FLOAT):
            texel = cl.ImageFormat(cl.channel_order.RGBA, kind)
            flat, solid = (
                cl.create_image(context, cl.mem_flags.READ_WRITE, texel, shape=shape)
                for shape in ((ITEMS, 2), (ITEMS, 2, 2))
            )
            results = cl.Buffer(context, cl.mem_flags.READ_WRITE, found.nbytes)
            kernel = cl.Kernel(program, "probe")
            kernel(queue, (ITEMS,), (GROUP,), flat, flat, solid, solid, results, np.uint32(ITEMS))
            cl.enqueue_copy(queue, found, results)
            texels = np.stack([np.arange(ITEMS), *(np.full(ITEMS, c) for c in (1, 2, 3))], 1)
            if not np.array_equal(found, [texels, -texels]):
                return "wrong numbers"
    except cl.Error as error:
        return gist(str(error))
    return None


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


FEATURES = {"lanes": lanes_failure, "images": images_failure}


def main(arguments: list[str]) -> None:
    """Print the verdict, as JSON behind ANSWER, on the device of the given index, or a feature of it; without one, on loading the
    drivers."""
    if len(arguments) == 1 and sys.platform == "linux" and _survives(vectorise_loops):
        vectorise_loops()
        print(f"\n{VECTORISED}", flush=True)
    prove = FEATURES[arguments[1]] if arguments[1:] else failure
    found = prove(devices()[int(arguments[0])]) if arguments else loading_failure()
    print(f"\n{ANSWER}{json.dumps(found)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
