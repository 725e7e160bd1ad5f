"""Cuckoo tables that find an octree's cells by their keys (HashCache, section 3.1; `cl/octree/cuckoo.cl`, `find.cl`).

A table has ceil(f n / 4) buckets of four entries of 8 bytes for n cells; f is 1.1, and 1.01 times more with each attempt. (With two
hash functions and buckets of one entry, no table can be filled by more than a half: f would have to be above 2.)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device, fill
from ..errors import DeviceError

# As in cl/octree/find.cl.
BUCKET = 4
EMPTY = np.uint64(0xFFFFFFFFFFFFFFFF)
TABLES = 19 + 64  # levels 0 .. 10, the parts of level 11, of level 12
SPACE_FACTOR = 1.1
_GROWTH = 1.01
_ATTEMPTS = 100  # by which a table has 2.9 times its cells
_MOST_MOVES = 1000  # of cells, to make room for one
_RUN = 64  # cells that one work-item inserts


@dataclass(frozen=True)
class CuckooTables:
    """entries: (entries,) uint64. tables: (TABLES, 4) uint32, a row for each table: its first bucket, how many buckets, the seeds
    of its two hash functions. attempts: (TABLES,) int64, how many it took to build each; 0 for tables without cells, which
    are the first bucket."""

    entries: cl_array.Array
    tables: cl_array.Array
    attempts: np.ndarray

    @property
    def space_factors(self) -> np.ndarray:
        """(TABLES,): by which they have more entries than cells, but for rounding."""
        return space_factor(self.attempts)


def first_table(level: int) -> int:
    """The number of a level's first table; behind the last level, how many there are."""
    return {12: 19, 13: TABLES}.get(level, level)


def space_factor(attempt: np.ndarray | int) -> np.ndarray | float:
    """Of an attempt's tables; attempts count from 1."""
    return SPACE_FACTOR * _GROWTH ** (np.maximum(attempt, 1) - 1)


def buckets_of(cells: int, attempt: int = 1) -> int:
    """How many buckets a table of so many cells has, at least one."""
    return max(1, int(np.ceil(space_factor(attempt) * cells / BUCKET)))


def seeds_of(table: int, attempt: int) -> np.ndarray:
    """(2,) uint32, odd: the seeds of a table's hash functions in an attempt."""
    return np.random.default_rng([table, attempt]).integers(0, 2**31, 2, dtype=np.uint32) * np.uint32(2) + np.uint32(1)


def build_tables(device: Device, levels: Sequence[Sequence[cl_array.Array | None]]) -> CuckooTables:
    """Tables of all levels' cells. levels: of each level, for each of its parts of space, the keys within the part of its
    cells, (n,) uint32, each once; None if it has none. Cells are numbered in this order. Raises DeviceError where the tables do
    not fit, or one cannot be built in any attempt."""
    return _Builder(device, levels).build()


class _Builder:
    """Tables behind each other in one array, each built in place; where one fails it is begun anew, larger."""

    def __init__(self, device: Device, levels: Sequence[Sequence[cl_array.Array | None]]):
        self._device, self._program = device, device.program("octree/cuckoo.cl", RUN=_RUN)
        self._tables = [
            (first_table(level) + part, keys)
            for level, parts in enumerate(levels)
            for part, keys in enumerate(parts)
            if keys is not None
        ]
        self._rows = np.tile(np.array([0, 1, 1, 1], np.uint32), (TABLES, 1))
        self._attempts = np.zeros(TABLES, np.int64)

    def build(self) -> CuckooTables:
        device, end, cell = self._device, 1, 0
        later = sum(buckets_of(keys.size) for _, keys in self._tables)
        self._entries = self._empty(end + later)
        self._clear(0, 1)
        self._failed = device.empty(1, np.uint32, "failure")
        for table, keys in self._tables:
            later -= buckets_of(keys.size)
            end, cell = self._build_table(table, keys, end, later, cell), cell + keys.size
        device.release(self._failed)
        return CuckooTables(self._entries, device.upload(self._rows, "tables of cells"), self._attempts)

    def _build_table(self, table: int, keys: cl_array.Array, first: int, later: int, cell: int) -> int:
        """Build a table whose first bucket this is; where it ends. later: buckets that others need behind it. cell: its first
        cell's number."""
        n = keys.size
        for attempt in range(1, _ATTEMPTS + 1):
            buckets, seeds = buckets_of(n, attempt), seeds_of(table, attempt)
            if (first + buckets + later) * BUCKET > self._entries.size:
                self._grow(first, first + buckets + later)
            self._clear(first, buckets)
            fill(self._failed, 0)
            self._program["insert_cells"](
                keys, self._entries, self._failed, n, cell, first, buckets, *seeds, _MOST_MOVES, count=-(-n // _RUN)
            )
            if not self._failed.get()[0]:
                self._rows[table], self._attempts[table] = (first, buckets, *seeds), attempt
                return first + buckets
        raise DeviceError(f"the octree: the cuckoo table of {n} cells could not be built in {_ATTEMPTS} attempts")

    def _empty(self, buckets: int) -> cl_array.Array:
        return self._device.empty(buckets * BUCKET, np.uint64, "the octree's tables")

    def _clear(self, first: int, buckets: int) -> None:
        self._program["clear_buckets"](self._entries, first, buckets, count=buckets * BUCKET)

    def _grow(self, keep: int, buckets: int) -> None:
        """Go on in an array of so many buckets, of which the first are as they are."""
        larger = self._empty(buckets)
        size = keep * BUCKET * EMPTY.nbytes
        cl.enqueue_copy(self._device.queue, larger.base_data, self._entries.base_data, byte_count=size)
        self._device.queue.finish()
        self._device.release(self._entries)
        self._entries = larger
