"""Kernels from `clcache/cl/`: sources with their includes, specialised by defines; calls that check what they are given.

A kernel's own source declares its arguments, once. The comment behind a pointer gives the array's shape, in numbers and
in names; a name stands for the same number wherever it occurs, and for the value of the scalar argument of that name:

    __kernel void scale(
        __global const float *values,  // (3, n)
        __global float *scaled,        // (3, n)
        uint n,
        float factor)

`(*)` allows any shape; `or null` allows None. Images, `read_only image2d_t` or `write_only image3d_t`, are declared in the same
way, (rows, columns, 4) or (layers, rows, columns, 4); one that a kernel reads and writes is two arguments. Arguments that
depend on a define stand between lines `#if NAME`, `#else` and `#endif`. Work is one-dimensional: one work-item for each of
`n` things, with surplus work-items in the last group, so that every kernel begins by leaving if its index is not below its count.
A kernel whose scalars are all 0 therefore does nothing; that is how it is compiled for its work-group size ahead of use.
"""

import re
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from . import layout
from .errors import DeviceError
from .image import Image

SOURCE_FOLDER = Path(__file__).parent / "cl"

_SCALARS = {
    "char": np.int8, "uchar": np.uint8, "int": np.int32, "uint": np.uint32,
    "long": np.int64, "ulong": np.uint64, "float": np.float32, "double": np.float64,
}  # fmt: skip
_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
_KERNEL = re.compile(
    r"__kernel\s+(?:__attribute__\(\((?P<attribute>[^;{]*?)\)\)\s+)?void\s+(?P<name>\w+)\s*\((?P<arguments>[^{]*?)\)\s*\{"
)
_LOCAL_SIZE = re.compile(r"reqd_work_group_size\(\s*(\d+)\s*,\s*1\s*,\s*1\s*\)")
_ARGUMENT = re.compile(
    r"(?:(?P<pointer>__global|__constant)\s+)?(?:const\s+|volatile\s+)*"
    r"(?:(?:read|write)_only\s+(?P<image>image[23]d)_t|(?P<type>[A-Za-z]+?)(?P<width>2|3|4|8|16)?)\s*"
    r"(?P<star>\*)?\s*(?:restrict\s+)?(?P<name>\w+)\s*(?:,|$)\s*(?://\s*\((?P<shape>[^)]*)\)\s*(?P<null>or null)?)?",
    re.MULTILINE,
)
_CONDITION = re.compile(r"^\s*#(?:if\s+(?P<name>\w+)|(?P<other>else|endif))\s*$")


@dataclass(frozen=True)
class Argument:
    """One declared argument. shape: entries are numbers or names; None for a scalar, () is never used; ("*",) is any. dtype: None
    for an image, which is of float32 or of float16."""

    name: str
    dtype: np.dtype | None
    shape: tuple[int | str, ...] | None
    nullable: bool = False


@dataclass(frozen=True)
class Signature:
    """A kernel's name, its arguments in order, and the work-group size that it prescribes, if any."""

    name: str
    arguments: tuple[Argument, ...]
    local_size: int | None = None


def read_source(name: str, generated: Mapping[str, str] | None = None) -> str:
    """The text of `cl/<name>` with each include expanded where it first stands; `#line` keeps errors in the true files.
    generated: the texts of files that are made up, and may be included like those of the folder, by name."""
    seen: set[str] = set()
    made = generated or {}

    def expand(file: str) -> list[str]:
        seen.add(file)
        lines = [f'#line 1 "{file}"']
        text = made[file] if file in made else (SOURCE_FOLDER / file).read_text(encoding="utf-8")
        for number, line in enumerate(text.splitlines(), start=1):
            include = _INCLUDE.match(line)
            if include is None:
                lines.append(line)
            elif include[1] in seen:
                lines.append("")
            else:
                lines += [*expand(include[1]), f'#line {number + 1} "{file}"']
        return lines

    return "\n".join(expand(name)) + "\n"


def read_signatures(source: str, defines: Mapping[str, int | float | bool] | None = None) -> dict[str, Signature]:
    """The kernels that a source declares, by name. Raises ValueError where an argument breaks the conventions."""
    signatures = {}
    for kernel in _KERNEL.finditer(source):
        declared = _without_excluded(kernel["arguments"], defines or {})
        arguments = tuple(_read_argument(kernel["name"], match) for match in _ARGUMENT.finditer(declared))
        local_size = _LOCAL_SIZE.search(kernel["attribute"] or "")
        signatures[kernel["name"]] = Signature(kernel["name"], arguments, int(local_size[1]) if local_size else None)
    return signatures


def _without_excluded(arguments: str, defines: Mapping[str, int | float | bool]) -> str:
    """The lines of an argument list that its conditions leave."""
    lines, is_in = [], True
    for line in arguments.splitlines():
        condition = _CONDITION.match(line)
        if condition is None:
            lines += [line] if is_in else []
        elif condition["name"]:
            is_in = bool(defines.get(condition["name"]))
        else:
            is_in = condition["other"] == "endif" or not is_in
    return "\n".join(lines)


def _read_argument(kernel: str, match: re.Match) -> Argument:
    scalar = _SCALARS.get(match["type"])
    dtype = np.dtype(scalar) if scalar else layout.STRUCTS.get(match["type"])
    if dtype is None and not match["image"]:
        raise ValueError(f"kernel {kernel}: argument {match['name']} has the unknown type {match['type']}")
    if not match["star"] and not match["image"]:
        return Argument(match["name"], dtype, None)
    if match["shape"] is None:
        raise ValueError(f"kernel {kernel}: argument {match['name']} lacks its shape")
    shape = [s.strip() for s in match["shape"].split(",") if s.strip()]
    shape += [match["width"]] if match["width"] else []
    return Argument(match["name"], dtype, tuple(int(s) if s.isdigit() else s for s in shape), bool(match["null"]))


class Kernel:
    """A kernel, called with one value for each declared argument: device arrays, None where allowed, numbers, structs."""

    def __init__(self, queue: cl.CommandQueue, kernel: cl.Kernel, signature: Signature, local_size: int):
        self._queue = queue
        self._kernel = kernel
        self.signature = signature
        self.local_size = signature.local_size or local_size

    def __call__(self, *values: object, count: int) -> cl.Event | None:
        """Enqueue `count` work-items; None if there are none. Raises TypeError or ValueError for values that do not fit."""
        bound = self._check(values)
        if count == 0:
            return None
        return self._enqueue(bound, -(-count // self.local_size) * self.local_size)

    def run(self, count: int, *arrays: Mapping[str, object], **scalars: object) -> cl.Event | None:
        """Enqueue with each argument found by its name: among the scalars, else in the first of the tables of arrays that
        has it; one that may be null and is in none of them is null. Raises as a call does."""
        values = []
        for argument in self.signature.arguments:
            known = next((table for table in (scalars, *arrays) if argument.name in table), None)
            if known is None and not argument.nullable:
                raise TypeError(f"kernel {self.signature.name}: argument {argument.name} is missing")
            values.append(None if known is None else known[argument.name])
        return self(*values, count=count)

    def warm_up(self) -> None:
        """Have the driver compile the kernel for its work-group size, without doing any work."""
        arguments = self.signature.arguments
        self._enqueue([self._nothing(a) for a in arguments], self.local_size).wait()

    def _nothing(self, argument: Argument) -> object:
        if argument.dtype is None:  # no image is none
            return Image(self._queue, (1,) * (len(argument.shape) - 1) + (4,), np.float32).base_data
        return np.zeros((), argument.dtype)[()] if argument.shape is None else None

    def _enqueue(self, values: list[object], global_size: int) -> cl.Event:
        try:
            self._kernel.set_args(*values)
            return cl.enqueue_nd_range_kernel(self._queue, self._kernel, (global_size,), (self.local_size,))
        except cl.Error as error:
            raise DeviceError(f"kernel {self.signature.name}: launch failed: {_first_line(error)}") from error

    def _check(self, values: tuple[object, ...]) -> list[object]:
        name, arguments = self.signature.name, self.signature.arguments
        if len(values) != len(arguments):
            raise TypeError(f"kernel {name} takes {len(arguments)} arguments, not {len(values)}")
        sizes: dict[str, tuple[int, str]] = {}
        bound = []
        for argument, value in zip(arguments, values, strict=True):
            place = f"kernel {name}: argument {argument.name}"
            if argument.shape is None:
                bound.append(_as_scalar(place, argument, value))
                if argument.dtype.kind in "ui":
                    _unify(sizes, argument.name, int(bound[-1]), place)
            else:
                bound.append(_as_buffer(place, argument, value, sizes))
                if bound[-1] is not None and value.context != self._queue.context:
                    raise ValueError(f"{place} is an array of another device")
        return bound


def _as_scalar(place: str, argument: Argument, value: object) -> np.generic:
    if argument.dtype.names:
        if getattr(value, "dtype", None) != argument.dtype:
            raise TypeError(f"{place} is {type(value).__name__}, not a value of its struct")
        return np.asarray(value)[()]
    scalar = np.asarray(value)
    if scalar.shape or not np.can_cast(scalar.dtype, argument.dtype, "same_kind") and scalar.dtype.kind not in "ui":
        raise TypeError(f"{place} is {value!r}, not one {argument.dtype}")
    if scalar.dtype.kind in "ui" and argument.dtype.kind in "ui":
        limits = np.iinfo(argument.dtype)
        if not limits.min <= int(scalar) <= limits.max:
            raise ValueError(f"{place} is {value!r}, out of the range of {argument.dtype}")
    return argument.dtype.type(value)


def _as_buffer(
    place: str, argument: Argument, value: object, sizes: dict[str, tuple[int, str]]
) -> cl.MemoryObject | None:
    if value is None and argument.nullable:
        return None
    kind = Image if argument.dtype is None else cl_array.Array
    if not isinstance(value, kind):
        raise TypeError(f"{place} is {type(value).__name__}, not an {kind.__name__.lower()} of the device")
    if argument.dtype is not None:
        if value.dtype != argument.dtype:
            raise TypeError(f"{place} has dtype {value.dtype}, not {argument.dtype}")
        if value.offset or not value.flags.c_contiguous:
            raise ValueError(f"{place} is a view; kernels take whole arrays in C order")
    if argument.shape != ("*",):
        if len(value.shape) != len(argument.shape):
            raise ValueError(f"{place} has shape {value.shape}, not {_shape_text(argument.shape)}")
        for length, expected in zip(value.shape, argument.shape, strict=True):
            if isinstance(expected, str):
                _unify(sizes, expected, length, place)
            elif length != expected:
                raise ValueError(f"{place} has shape {value.shape}, not {_shape_text(argument.shape)}")
    return value.base_data


def _unify(sizes: dict[str, tuple[int, str]], symbol: str, length: int, place: str) -> None:
    known, where = sizes.setdefault(symbol, (length, place))
    if known != length:
        raise ValueError(f"{place}: {symbol} is {length}, but {known} in {where.split(': ')[1]}")


def _shape_text(shape: tuple[int | str, ...]) -> str:
    return "(" + ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "") + ")"


class Program:
    """The kernels of one source file, built for one device with one set of defines. generated: as of `read_source`. `seconds`:
    what the build took."""

    def __init__(self, context: cl.Context, queue: cl.CommandQueue, options: list[str], local_size: int, name: str,
                 defines: Mapping[str, int | float | bool], generated: Mapping[str, str] | None = None):  # fmt: skip
        self.name = name
        text = "".join(f"#define {key} {_literal(value)}\n" for key, value in sorted(defines.items()))
        text += layout.source() + read_source(name, generated)
        start = time.perf_counter()
        try:
            with warnings.catch_warnings():  # drivers that have something to say of every build
                warnings.simplefilter("ignore", cl.CompilerWarning)
                built = cl.Program(context, text).build(options)
        except cl.Error as error:
            failure = DeviceError(f"{name}: the driver cannot build it: {_first_line(error)}")
            failure.add_note(str(error))
            raise failure from error
        self._kernels = {
            s.name: Kernel(queue, cl.Kernel(built, s.name), s, local_size)
            for s in read_signatures(text, defines).values()
        }
        for kernel in self._kernels.values():
            kernel.warm_up()
        self.seconds = time.perf_counter() - start

    def __getitem__(self, kernel: str) -> Kernel:
        return self._kernels[kernel]

    def __iter__(self):
        return iter(self._kernels.values())


def _literal(value: int | float | bool) -> str:
    return f"({float(value)!r}f)" if isinstance(value, (float, np.floating)) else f"({int(value)})"


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return next((line for line in lines if "error:" in line), lines[0] if lines else type(error).__name__)
