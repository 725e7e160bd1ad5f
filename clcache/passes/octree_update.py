"""An update of the octree's cells by the vertices of paths (OctreeCache, section 3.2; `cl/octree/`).

The vertices are given: `vertex_key` (V,) u8, keys at the finest level (cl/octree/shape.cl; NO_VERTEX where there is none),
`vertex_normal` (V,) u4, packed, towards where the path came from, and `vertex_light` (3, V), without albedo. Those that lie in
a cell are sorted by it; what the front and the back of each cell got is summed, and merged into its means; then the level
above gets what its children got, and so on up to the root.

Whatever the number of threads, the result has the same bits: all sums have an order, and only counts are by atomics.
"""

from collections.abc import Iterable

import numpy as np
import pyopencl as cl

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..octree import Octree
from ..radix import CHUNKS, radix_sort
from .trace import stamp

COUNTERS = ("lookups", "hits", "inserted", "evicted", "discarded", "occupied", "capacity", "traced")
CELLS = ("octree_cells", "octree_wipe")
NO_VERTEX = 2**64 - 1
# Entries of a list that one work-item counts and moves in order.
_CHUNK = 512
# Levels of the finest octree there is; behind its records' numbers, by level, stands that of the vertices that have a cell.
_LEVELS = 13
_RECORD = ("key", "cell", "normal", "sum")
_RECORDS, _PARENTS = (tuple(f"{of}_{part}" for part in _RECORD) for of in ("record", "parent"))
_DIGIT_BITS = 8


def update_buffers(vertices: int, cells: int) -> list[Buffer]:
    """What the cells know, which both eyes share, and what an update of them by so many vertices works with.

    `octree_cells`: 24 bytes each (cl/octree/cell.cl). `octree_wipe`: the stamp of the last wipe, the digest of the lighting (two
    words), and how many cells are in use since.
    """
    records = ((of, np.uint64 if of.endswith("key") else np.uint32) for of in (*_RECORDS[:3], *_PARENTS[:3]))
    return [
        Buffer("octree_cells", (cells, 6), np.uint32, persistent=True),
        Buffer("octree_wipe", (4,), np.uint32, persistent=True),
        Buffer("vertex_cell", (vertices,), np.uint32),
        Buffer("located", (vertices,), np.uint64),
        Buffer("located_spare", (vertices,), np.uint64),
        Buffer("located_row", (vertices, 8), np.uint32),
        Buffer("digit_counts", (1 << _DIGIT_BITS, CHUNKS), np.uint32),
        Buffer("chunk_counts", (-(-vertices // _CHUNK),), np.uint32),
        Buffer("records_listed", (_LEVELS + 1,), np.uint32),
        *(Buffer(name, (vertices,), dtype) for name, dtype in records),
        Buffer("record_sum", (vertices, 8)),
        Buffer("parent_sum", (vertices, 8)),
    ]


def update_passes(device: Device, octree: Octree) -> list[Pass]:
    """The passes of an update, in order. They add to `counters`, which another pass has cleared."""
    return [kind(device, octree) for kind in (Locate, Sort, Merge, Coarsen)]


class _UpdatePass(Pass):
    """Kernels of cl/octree/reduce.cl, which has them all."""

    def __init__(self, device: Device, octree: Octree):
        counts = {f"COUNT_{name.upper()}": number for number, name in enumerate(COUNTERS)}
        defines = {"CHUNK": _CHUNK, "DIGIT_BITS": _DIGIT_BITS, "ORDERED": False, "LEVELS": _LEVELS, **counts}
        self._octree, self._program = octree, device.program("octree/reduce.cl", **defines)
        # The sort begins in that one of two arrays from which it ends in `located`.
        self._bits = (octree.cells - 1).bit_length()
        begins = ("located", "located_spare")
        self._unsorted, self._spare = begins[::-1] if -(-self._bits // _DIGIT_BITS) % 2 else begins

    def _launch(self, kernel: str, count: int, arrays, **scalars) -> cl.Event | None:
        lists = {"listed": arrays["records_listed"]}
        return self._program[kernel].run(count, lists, arrays, self._octree.arrays, **scalars)

    def _most(self, arrays, level: int) -> int:
        """As many records as a level can have."""
        first = self._octree.first_cell
        return min(arrays["record_key"].size, int(first[level + 1] - first[level]))


class Locate(_UpdatePass):
    """Find the vertices' cells, and list those that have one."""

    name = "locate"
    reads = ("vertex_key", "vertex_normal", "vertex_light", "counters")

    def __init__(self, device: Device, octree: Octree):
        super().__init__(device, octree)
        self.writes = ("vertex_cell", "chunk_counts", "records_listed", self._unsorted, "located_row", "counters")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Chunk by chunk."""
        vertices = arrays["vertex_key"].size
        chunks, lists = -(-vertices // _CHUNK), {"located": arrays[self._unsorted]}
        yield fill(arrays["records_listed"], 0)
        all_of = {"vertices": vertices, "chunks": chunks}
        yield self._launch("locate_vertices", chunks, arrays, finest=self._octree.finest, **all_of)
        yield self._launch("sum_chunks", 1, arrays, list=_LEVELS, chunks=chunks)
        yield self._launch("list_located", chunks, {**arrays, **lists}, **all_of)


class Sort(_UpdatePass):
    """Sort them by cell."""

    name = "sort"
    writes = ("located", "located_spare", "digit_counts")

    def __init__(self, device: Device, octree: Octree):
        super().__init__(device, octree)
        self.reads = (self._unsorted, "records_listed")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """As many rounds as the number of cells takes."""
        n = int(arrays["records_listed"].get()[_LEVELS])
        if n:
            unsorted, spare = (arrays[self._unsorted],), (arrays[self._spare],)
            events, _ = radix_sort(self._program, unsorted, spare, arrays["digit_counts"], n, 32, self._bits)
            yield from events


def _draws(state) -> dict[str, int]:
    """By what means are rounded at random."""
    return {"update": stamp(state), "key0": state.key[0], "key1": state.key[1]}


class Merge(_UpdatePass):
    """Sum what the sides of each finest cell got, and merge that into it."""

    name = "merge"
    reads = ("located", "located_row", "records_listed", *CELLS, "counters")
    writes = (*CELLS, *_RECORDS, "chunk_counts", "records_listed", "counters")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run, chunk by chunk."""
        chunks = -(-arrays["located"].size // _CHUNK)
        yield self._launch("count_runs", chunks, arrays, chunks=chunks)
        yield self._launch("sum_chunks", 1, arrays, list=self._octree.finest, chunks=chunks)
        yield self._launch("reduce_vertices", chunks, arrays, chunks=chunks, **_draws(state))


class Coarsen(_UpdatePass):
    """The levels above, each by what the one below it got."""

    name = "coarsen"
    reads = (*_RECORDS, "records_listed", *CELLS, "counters")
    writes = (*CELLS, *_RECORDS, *_PARENTS, "chunk_counts", "records_listed", "counters")
    results = (*CELLS, "counters")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Family by family, chunk by chunk. What were the parents are the children of the next level."""
        own, above = _RECORDS, _PARENTS
        for level in range(self._octree.finest, 0, -1):
            records = {name: arrays[buffer] for name, buffer in zip(_RECORDS, own, strict=True)}
            parents = {name: arrays[buffer] for name, buffer in zip(_PARENTS, above, strict=True)}
            now, chunks = {**arrays, **records, **parents}, -(-self._most(arrays, level) // _CHUNK)
            yield self._launch("count_families", chunks, now, level=level, chunks=chunks)
            yield self._launch("sum_chunks", 1, now, list=level - 1, chunks=chunks)
            yield self._launch("find_parents", chunks, now, level=level, chunks=chunks)
            yield self._launch("reduce_families", chunks, now, level=level, chunks=chunks, **_draws(state))
            own, above = above, own
        yield self._launch("tally_cells", 1, arrays, cells=self._octree.cells)
