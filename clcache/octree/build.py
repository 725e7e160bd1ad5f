"""The octree of a scene: its cells on all levels, and the tables that find them (HashCache, section 3.1)."""

import time

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device
from ..scene.geometry import Geometry
from .cuckoo import BUCKET, CuckooTables, build_tables, first_table
from .occupancy import CELL_BYTES, Parts, check_cells, find_occupied, offsets_of, parts_of

_RUN = 256  # cells that one work-item goes through in order


class Octree:
    """The cells that a scene's static triangles overlap, on all levels, and the tables that find them.

    Cells are numbered level by level from the whole cube on, within a level by their keys (`cl/octree/shape.cl`). shape: OctreeShape. finest:
    number of the finest level, log2 of the resolution, or less where float32 is coarser than its cells. first_cell: (finest +
    2,) int64: those of level l are first_cell[l] .. first_cell[l + 1] - 1. cells: how many on all levels, at least 1. arrays:
    octree_table (entries,) uint64, octree_tables (tables, 4) uint32, of `cl/octree/find.cl`. seconds: what the build took.
    nbytes: of the arrays.

    is_static: (instances,) bool, which never move. resolution: a power of two, 64 .. 4096. eyes: (k, 3), places that the scene is seen from: what
    lies very much farther away than all else has no cells then; None: the cube is about everything. A scene in which nothing is static
    has no cells. Raises DeviceError where it does not fit.
    """

    def __init__(
        self,
        device: Device,
        geometry: Geometry,
        is_static: np.ndarray,
        resolution: int,
        eyes: np.ndarray | None = None,
    ):
        clock = _Clock(device)
        found = find_occupied(device, geometry, is_static, resolution, eyes)
        self.shape, self.finest = found.shape, int(found.shape["finest"])
        clock.stop("occupancy")
        levels = _all_levels(device, found.parts, self.finest)
        counts = [sum(keys.size for keys in parts if keys is not None) for parts in levels]
        self.first_cell = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        self.cells = max(int(self.first_cell[-1]), 1)
        clock.stop("levels")
        check_cells(device, self.cells, self.finest)
        tables = build_tables(device, levels)
        device.queue.finish()
        device.release(*(keys for parts in levels for keys in parts if keys is not None))
        clock.stop("tables")
        self.arrays: dict[str, cl_array.Array] = {"octree_table": tables.entries, "octree_tables": tables.tables}
        self.nbytes = sum(a.nbytes for a in self.arrays.values())
        self.seconds = sum(clock.steps.values())
        self._report = {
            "resolution": 2**self.finest,
            "size": float(self.shape["size"]),
            "seconds": clock.steps,
            "attempts": int(tables.attempts.max()),
            "space_factor": float(tables.space_factors.max()),
            "margin": found.margin,
            "levels": _level_reports(counts, tables),
        }

    @property
    def cube(self) -> list[float]:
        """Its lowest corner and its edge, in metres: by which cells of one octree are known from those of another."""
        return [*self.shape["origin"].tolist(), float(self.shape["size"])]

    def report(self) -> dict:
        """What `--stats` says: resolution; size, of the cube, in metres; seconds of the steps of the build; the most attempts that a table took, and its space factor;
        margin, by which the finest cells were dilated, as a part of their edge; levels: of each, level, cells, density (the part of
        all its cells that these are), data_bytes, hash_bytes."""
        return self._report


class _Clock:
    """Seconds of the steps of a build, without those of the driver's compiler."""

    def __init__(self, device: Device):
        self._device, self._last, self.steps = device, self._now(device), {}

    def stop(self, step: str) -> None:
        """The end of a step."""
        self._device.queue.finish()
        now = self._now(self._device)
        self.steps[step], self._last = now - self._last, now

    @staticmethod
    def _now(device: Device) -> float:
        return time.perf_counter() - device.compile_seconds


def _all_levels(device: Device, parts: Parts, finest: int) -> list[Parts]:
    """The keys of all levels from those of the finest, level 0 first."""
    levels = [parts]
    for level in range(finest, 0, -1):
        levels.append(_level_above(device, levels[-1], level))
    return levels[::-1]


def _level_above(device: Device, parts: Parts, level: int) -> Parts:
    """The cells that hold those of a level. Where that has more parts of space than the level above, eight become one."""
    octants = len(parts) // parts_of(level - 1)
    above = [_parents(device, keys, part % octants) for part, keys in enumerate(parts)]
    if octants == 1:
        return above
    return [_joined(device, above[first : first + octants]) for first in range(0, len(above), octants)]


def _parents(device: Device, keys: cl_array.Array | None, octant: int) -> cl_array.Array | None:
    """The cells that hold those of a part, in the part of space of which this is an octant, or all (0)."""
    if keys is None:
        return None
    program, n = device.program("octree/levels.cl", RUN=_RUN), keys.size
    runs = -(-n // _RUN)
    counts = device.empty(runs, np.uint32, "counts")
    program["count_parents"](keys, counts, n, runs, count=runs)
    offsets, cells = offsets_of(device, counts)
    parents = device.empty(cells, np.uint32, "keys of cells")
    program["list_parents"](keys, offsets, parents, n, runs, cells, octant, count=runs)
    device.queue.finish()
    device.release(offsets)
    return parents


def _joined(device: Device, parts: Parts) -> cl_array.Array | None:
    """The keys of parts in one array; they are released."""
    known = [keys for keys in parts if keys is not None]
    if not known:
        return None
    joined = device.empty(sum(keys.size for keys in known), np.uint32, "keys of cells")
    place = 0
    for keys in known:
        cl.enqueue_copy(device.queue, joined.base_data, keys.base_data, byte_count=keys.nbytes, dst_offset=place)
        place += keys.nbytes
    device.queue.finish()
    device.release(*known)
    return joined


def _level_reports(counts: list[int], tables: CuckooTables) -> list[dict]:
    rows = tables.tables.get()
    buckets = np.where(tables.attempts > 0, rows[:, 1], 0)
    return [
        {
            "level": level,
            "cells": cells,
            "density": cells / 8**level,
            "data_bytes": CELL_BYTES * cells,
            "hash_bytes": int(buckets[first_table(level) : first_table(level + 1)].sum())
            * BUCKET
            * tables.entries.dtype.itemsize,
        }
        for level, cells in enumerate(counts)
    ]
