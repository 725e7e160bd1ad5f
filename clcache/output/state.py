"""The state of a render after a frame, from which another goes on as if it had not stopped: `state.npz` beside the frames.

It is an archive as `numpy.savez` writes it: an array for each buffer that the next frame depends on, named GRAPH.EYE.BUFFER (EYE is
`all` where the eyes share it), and `meta`, the bytes of a JSON object that says which render and which frame it is of. It is
not compressed: what it holds hardly gets smaller. So its size is known before anything is read, and a file that declares
more than is expected, or than it has, is refused.
"""

import contextlib
import itertools
import json
import math
import os
import struct
import tokenize
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Self

import numpy as np
from numpy.lib import format as npy

from ..errors import SettingError
from .files import atomic_path

STATE_FILE = "state.npz"
_META = "meta"
_MAX_META = 2**20  # bytes
_MAX_NUMBER = 2**31 - 1  # frames and updates are ints of kernels and of EXR files
_MAX_ARRAYS = 1000
_MAX_HEADER = 1000  # characters before an array; with more, Python's parser can run out of stack
# The end of an archive (APPNOTE.TXT of PKWARE, 4.3.14 to 4.3.16): of a large one, a record with 64-bit numbers comes first.
_END, _LOCATOR, _END_64 = struct.Struct("<4s4xHHI4xH"), struct.Struct("<4s16x"), struct.Struct("<4s28xQQ8x")


def write_state(path: str | os.PathLike, meta: Mapping[str, object], arrays: Iterable[tuple[str, np.ndarray]]) -> None:
    """Write a state, whole or not at all. arrays: names and values; each is asked for when it is its turn. Raises
    SettingError or Error where the file cannot be written."""
    text = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    with atomic_path(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_STORED) as archive:
        for name, array in itertools.chain([(_META, text)], arrays):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                npy.write_array(member, array, version=(1, 0), allow_pickle=False)


class StateFile:
    """A state file that is open to be read. path: the file, or the folder that has it. meta: its JSON object.

    Nothing is read of which the size was not checked before. All methods raise SettingError, with one line, where the file is
    none, is damaged, or is not what is expected.
    """

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path) / STATE_FILE if os.path.isdir(path) else Path(path)
        try:
            with self._reading():
                if self.path.exists() and not self.path.is_file():  # a pipe would be waited for
                    raise OSError("it is no regular file")
                self._file = self.path.open("rb")
            try:
                self._open()
            except BaseException:
                self._file.close()
                raise
        except FileNotFoundError:
            raise SettingError(f"{self.path}: no such file; expected what clcache render --save-state writes") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def _open(self) -> None:
        with self._reading():
            self._size = os.fstat(self._file.fileno()).st_size
            entries, directory = self._directory()
            if entries > _MAX_ARRAYS or directory > _MAX_META:
                raise ValueError(f"{entries} arrays")
            archive = zipfile.ZipFile(self._file)
            self._members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            self._archive = archive
            if self._members[_META].file_size > _MAX_META:
                raise ValueError("too much text")
            self.meta = json.loads(self.read(_META).tobytes())
            if not isinstance(self.meta, dict):
                raise ValueError("no object")

    def _directory(self) -> tuple[int, int]:
        """How many members the archive has by its end, and the bytes of their list, both before the list is read."""
        length = _END_64.size + _LOCATOR.size + _END.size
        self._file.seek(max(self._size - length, 0))
        tail = self._file.read(length)
        mark, _, entries, directory, comment = _END.unpack(tail[-_END.size :])
        if mark != b"PK\5\6" or comment:
            raise ValueError("no end")
        if _LOCATOR.unpack(tail[-_END.size - _LOCATOR.size : -_END.size])[0] == b"PK\6\7":
            mark, entries, directory = _END_64.unpack(tail[: _END_64.size])
        return entries, directory

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        """What goes wrong in the body as a SettingError."""
        try:
            yield
        except FileNotFoundError:
            raise
        except OSError as error:
            raise SettingError(f"{self.path}: cannot be read ({error.strerror or error})") from None
        except (zipfile.BadZipFile, struct.error, ValueError, LookupError, EOFError, RecursionError,
                NotImplementedError, RuntimeError, TypeError, tokenize.TokenError) as error:  # fmt: skip
            raise SettingError(
                f"{self.path}: is damaged, or no state of a render; expected a file of clcache"
            ) from error

    def number(self, name: str) -> int:
        """A whole number of the meta data: of a frame, or of updates."""
        value = self.meta.get(name)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= _MAX_NUMBER:
            raise SettingError(f"{self.path}: {name} is {_short(value)}; expected 0 .. {_MAX_NUMBER}")
        return value

    def check(self, expected: Mapping[str, object]) -> None:
        """Raise SettingError where the meta data has other values than these."""
        for name, value in json.loads(json.dumps(expected)).items():
            found = self.meta.get(name)
            if isinstance(value, dict) and isinstance(found, dict):
                name, found, value = next(
                    (
                        (f"{name} {key}", found.get(key), value.get(key))
                        for key in {**value, **found}
                        if found.get(key) != value.get(key)
                    ),
                    (name, value, value),
                )
            if found != value or type(found) is not type(value):
                raise SettingError(
                    f"{self.path}: {name} is {_short(found)} there and {_short(value)} here; expected the same"
                )

    def check_arrays(self, expected: Mapping[str, tuple[tuple[int, ...], np.dtype]]) -> None:
        """Raise SettingError unless these arrays are there whole, of these shapes and dtypes."""
        for name, (shape, dtype) in expected.items():
            if name not in self._members:
                raise SettingError(f"{self.path}: lacks {name}; expected a state of the same method, filters and AOVs")
            with self._reading(), self._member(name) as (_, found_shape, found_dtype):
                pass
            if (found_shape, found_dtype) != (shape, dtype):
                raise SettingError(
                    f"{self.path}: {name} is {found_dtype} {_short(found_shape)}; expected {dtype} {_short(shape)}"
                )
        with self._reading():
            for name in expected:
                self._verify(name)

    def read(self, name: str) -> np.ndarray:
        """An array that is there."""
        with self._reading(), self._member(name) as (member, shape, dtype):
            array = np.empty(shape, dtype)
            view = memoryview(array.reshape(-1)).cast("B") if array.size else b""
            if (member.readinto(view) if array.size else 0) != array.nbytes or member.read(1):
                raise ValueError("too short")
            return array

    def _verify(self, name: str) -> None:
        """Read a member to its end, by which its checksum is checked."""
        with self._archive.open(self._members[name]) as member:
            while member.read(2**20):
                pass

    @contextlib.contextmanager
    def _member(self, name: str) -> Iterator[tuple[IO[bytes], tuple[int, ...], np.dtype]]:
        """A member behind its header, with the shape and the dtype that follow, of which it has just so many bytes."""
        info = self._members[name]
        if (
            info.compress_type != zipfile.ZIP_STORED
            or info.file_size != info.compress_size
            or info.file_size > self._size
        ):
            raise ValueError("not stored")
        with self._archive.open(info) as member:
            if npy.read_magic(member) != (1, 0):
                raise ValueError("another version")
            shape, is_fortran, dtype = npy.read_array_header_1_0(member, max_header_size=_MAX_HEADER)
            size = math.prod(shape) * dtype.itemsize
            if is_fortran or dtype.hasobject or min(shape, default=1) < 0 or size != info.file_size - member.tell():
                raise ValueError("another size")
            yield member, shape, dtype


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
