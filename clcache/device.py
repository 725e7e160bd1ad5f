"""An OpenCL device as the rest of clcache sees it: what it can do, its memory, its queue and its programs."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from . import drivers
from .errors import DeviceError, SettingError
from .image import Image
from .program import Program

# Arrays that large pages are worth it for, and what drivers want host memory to be aligned to, to use it in place; bytes.
_LARGE = 1 << 22
_PAGE = 4096
# With fast math: what the compiler may do. Infinities and NaNs keep their meaning, since kernels mark by them what is not there.
_FAST_MATH = "-cl-unsafe-math-optimizations"
# Programs that have none of it: those that decide hits and the trees and cells that rays find, and sums that carry their rounding errors.
_EXACT = ("bvh/", "octree/occupy.cl", "pathtrace/film.cl")


@dataclass(frozen=True)
class Capabilities:
    """What the device offers beyond OpenCL 1.2's least; sizes in bytes."""

    compute_units: int
    global_memory: int
    max_allocation: int
    max_work_group_size: int
    sub_groups: bool
    c11_atomics: bool
    int64_atomics: bool
    images: bool
    fp64: bool
    exact_division: bool  # correctly rounded float32 division and square root on request


def probe_capabilities(device: cl.Device) -> Capabilities:
    """Ask the driver, once."""
    extensions = set(device.extensions.split())
    version = tuple(int(x) for x in device.version.split()[1].split("."))
    return Capabilities(
        compute_units=device.max_compute_units,
        global_memory=device.global_mem_size,
        max_allocation=device.max_mem_alloc_size,
        max_work_group_size=device.max_work_group_size,
        sub_groups="cl_khr_subgroups" in extensions or "cl_intel_subgroups" in extensions,
        c11_atomics=version >= (2, 0),
        int64_atomics={"cl_khr_int64_base_atomics", "cl_khr_int64_extended_atomics"} <= extensions,
        images=bool(device.image_support),
        fp64="cl_khr_fp64" in extensions,
        exact_division=bool(device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT),
    )


class Device:
    """A context and a queue on one device, with the programs built and the memory taken so far.

    spec: index, or part of the platform's or the device's name; None for the default. threads: how many of a CPU's
    compute units to use. local_size: work-items in a group of kernels that do not prescribe it. on_compile: called with
    a program's name before it is built. fast_math: whether kernels that decide no hits may round less carefully. Raises DeviceError,
    SettingError.
    """

    def __init__(
        self,
        spec: str | int | None = None,
        threads: int | None = None,
        local_size: int = 64,
        on_compile: Callable[[str], None] | None = None,
        fast_math: bool = False,
    ):
        if threads is not None:
            processors = os.cpu_count() or threads
            if not 1 <= threads <= processors:
                raise SettingError(f"--threads {threads}: expected 1 .. {processors}")
            limit_pocl_threads(threads)
        candidate = drivers.choose(None if spec is None else str(spec))
        self._candidate, whole = candidate, candidate.device
        self.platform, self.name, self.driver = candidate.platform, candidate.name, candidate.driver_version
        self.capabilities = probe_capabilities(whole)
        device = whole if threads is None else _with_threads(candidate, threads)
        self.threads = device.max_compute_units
        self.is_cpu = bool(device.type & cl.device_type.CPU)
        if local_size > self.capabilities.max_work_group_size:
            limit = self.capabilities.max_work_group_size
            raise SettingError(f"setting device.local_size: {local_size} is more than this device's largest, {limit}")
        self.local_size = local_size
        self.context = cl.Context([device])
        self.queue = cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.compile_seconds = 0.0
        self.allocated = 0
        self._on_compile = on_compile
        self._programs: dict[tuple, Program] = {}
        exact = ["-cl-fp32-correctly-rounded-divide-sqrt"] if self.capabilities.exact_division else []
        self._exact_options = ["-cl-std=CL1.2", *exact]
        self._options = ["-cl-std=CL1.2", _FAST_MATH] if fast_math else self._exact_options

    def program(self, name: str, generated: Mapping[str, str] | None = None, **defines: int | float | bool) -> Program:
        """The program of `cl/<name>`, specialised by the defines; built at its first use. generated: as of `read_source`. Raises
        DeviceError."""
        made = tuple((generated or {}).items())
        key = (
            name,
            made,
            *sorted((key, repr(value)) for key, value in defines.items()),
        )  # repr tells 1 from 1.0 and True
        if key not in self._programs:
            if self._on_compile:
                self._on_compile(name)
            defines = {"HAS_FP64": self.capabilities.fp64, **defines}
            options = self._exact_options if name.startswith(_EXACT) else self._options
            program = Program(self.context, self.queue, options, self.local_size, name, defines, generated)
            self.compile_seconds += program.seconds
            self._programs[key] = program
        return self._programs[key]

    def proves(self, feature: str) -> bool:
        """Whether the device was seen to have an optional feature: "lanes", sub-groups that can be lane groups
        (cl/common/lane_group.cl), or "images" that one kernel both reads and writes. Tried at the first question."""
        return drivers.proves(self._candidate, feature)

    def image_limits(self, dimensions: int) -> tuple[int, ...]:
        """The largest width, height and, of three dimensions, number of layers of an image."""
        device = self._candidate.device
        if dimensions == 2:
            return device.image2d_max_width, device.image2d_max_height
        return device.image3d_max_width, device.image3d_max_height, device.image3d_max_depth

    def check_fits(self, what: str, sizes: Mapping[str, int]) -> None:
        """Raise DeviceError, before anything is allocated, if arrays of these sizes in bytes do not fit beside the others."""
        total, limits = sum(sizes.values()), self.capabilities
        largest = max(sizes, key=sizes.__getitem__, default=None)
        if self.allocated + total > limits.global_memory:
            raise DeviceError(
                f"{what} needs {_gib(total)} beside the {_gib(self.allocated)} already taken (the largest array is "
                f"{largest}, {_gib(sizes[largest])}); device {self.name} has {_gib(limits.global_memory)}"
            )
        if largest is not None and sizes[largest] > limits.max_allocation:
            raise DeviceError(
                f"{what}: the array {largest} needs {_gib(sizes[largest])}; device {self.name} allows "
                f"{_gib(limits.max_allocation)} for one array"
            )

    def empty(self, shape: tuple[int, ...] | int, dtype: np.dtype | type, what: str = "an array") -> cl_array.Array:
        """An uninitialised array on the device; an empty one holds no memory. Raises DeviceError if it does not fit."""
        dtype = np.dtype(dtype)
        size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        self.check_fits(what, {what: size})
        try:
            data = self._in_large_pages(size) if self.is_cpu and size >= _LARGE else None
            array = cl_array.Array(self.queue, shape, dtype, data=data)
        except (cl.Error, MemoryError) as error:
            raise DeviceError(f"{what}: the device gave no {_gib(size)}: {error}") from error
        self.allocated += size
        return array

    def image(self, shape: tuple[int, ...], dtype: np.dtype | type, what: str = "an image") -> Image:
        """An image of zeros on the device; arguments as of `Image`. Raises DeviceError if there are none, or it does not fit."""
        size = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
        self.check_fits(what, {what: size})
        try:
            image = Image(self.queue, shape, dtype)
            image.set(np.zeros(shape, dtype))
        except (cl.Error, MemoryError) as error:
            raise DeviceError(f"{what}: the device gave no image of {_gib(size)}: {error}") from error
        self.allocated += size
        return image

    def _in_large_pages(self, size: int) -> cl.Buffer:
        """Memory that NumPy asked the system to map in large pages, used in place: random reads of it miss the processor's
        table of pages far less often than in what drivers allocate."""
        host = np.empty(size + _PAGE, np.uint8)
        begin = -host.ctypes.data % _PAGE
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=host[begin : begin + size])

    def upload(self, values: np.ndarray, what: str = "an array") -> cl_array.Array:
        """A copy of the values on the device, at least one element long. Raises DeviceError if it does not fit."""
        values = np.ascontiguousarray(values)
        array = self.empty(values.shape, values.dtype, what)
        if values.size:
            cl.enqueue_copy(self.queue, array.base_data, values)
        return array

    def release(self, *arrays: cl_array.Array | Image) -> None:
        """Give back arrays that are needed no more."""
        for array in arrays:
            self.allocated -= array.nbytes
            if array.base_data is not None:
                array.base_data.release()


def fill(array: cl_array.Array, value: float) -> cl.Event:
    """Set every element of an array."""
    return cl.enqueue_fill_buffer(array.queue, array.base_data, array.dtype.type(value), 0, array.nbytes)


def event_seconds(event: cl.Event) -> float:
    """How long a finished command ran on the device."""
    return 1e-9 * (event.profile.end - event.profile.start)


def limit_pocl_threads(threads: int) -> None:
    """Ask PoCL for this many threads; it listens until its platform is first loaded in the process."""
    os.environ["POCL_MAX_PTHREAD_COUNT"] = os.environ["POCL_CPU_MAX_CU_COUNT"] = str(threads)


def _with_threads(candidate: drivers.Candidate, threads: int) -> cl.Device:
    device, name = candidate.device, candidate.name
    if threads == device.max_compute_units:
        return device
    if candidate.platform == "Portable Computing Language":  # its sub-devices run on all threads all the same
        raise DeviceError(
            f"--threads {threads}: PoCL has {device.max_compute_units} since it was first used in this process, "
            "and keeps that number; start another process, or ask for the threads first"
        )
    try:
        return device.create_sub_devices([cl.device_partition_property.BY_COUNTS, threads])[0]
    except cl.Error as error:
        raise DeviceError(f"--threads {threads}: device {name} cannot be divided: {error}") from error


def _gib(size: int) -> str:
    return f"{size / 2**30:.2f} GiB" if size >= 2**30 / 10 else f"{size / 2**20:.1f} MiB"
