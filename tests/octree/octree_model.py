"""The octree's cells in NumPy (cl/octree/cell.cl, reduce.cl, merge.cl), an octree made by hand, and updates of it on a device."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from clcache.device import Device
from clcache.frame import Buffer, FrameGraph, Pass
from clcache.methods.method import PathState
from clcache.octree import Octree
from clcache.passes.octree_update import COUNTERS, NO_VERTEX, update_buffers, update_passes
from clcache.random import pcg4d

F = np.float32
NONE = 0xFFFFFFFF
KEY = (0x1234567, 0x89ABCDE)
MOST_SAMPLES = 65535
LARGEST_HALF = 65504.0


# Normals and halves


def pack_normals(normals: np.ndarray) -> np.ndarray:
    """(n, 3) float32 unit vectors as (n,) uint32."""
    v = np.asarray(normals, F)
    size = np.abs(v)
    v = v[:, :2] * (F(1) / (size[:, 0] + size[:, 1] + size[:, 2]))[:, None]
    folded = (F(1) - np.abs(v[:, ::-1])) * np.where(v < 0, F(-1), F(1))
    v = np.where(np.asarray(normals)[:, 2:] < 0, folded, v)
    q = (v * F(32767) + F(32768.5)).astype(np.uint32)
    return q[:, 0] | q[:, 1] << np.uint32(16)


def unfold_normals(words: np.ndarray) -> np.ndarray:
    """(n,) uint32 as (n, 3) float32, not of unit length."""
    words = np.asarray(words, np.uint32)
    q = np.stack([words & 0xFFFF, words >> np.uint32(16)], axis=1).astype(np.int32)
    v = (q - 32768).astype(F) * F(1 / 32767)
    z = F(1) - np.abs(v[:, 0]) - np.abs(v[:, 1])
    folded = (F(1) - np.abs(v[:, ::-1])) * np.where(v < 0, F(-1), F(1))
    return np.column_stack([np.where(z[:, None] < 0, folded, v), z])


def dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Dot products of rows, summed from x to z."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def round_to_halves(values: np.ndarray, random: np.ndarray) -> np.ndarray:
    """One of the two float16 beside each of the values, float32, 0 .. 65504, by the random words."""
    below = values.astype(np.float16)
    below = np.where(below.astype(F) > values, np.nextafter(below, np.float16(-1)), below)
    with np.errstate(over="ignore", invalid="ignore"):
        above = np.nextafter(below, np.float16(np.inf))
        part = (values.astype(np.float64) - below) / (np.minimum(above, LARGEST_HALF + 32).astype(np.float64) - below)
    tiny = values < 2.0**-14
    up = np.where(tiny, (random >> 8) * 2.0**-24 < part, (random >> 19) / 8192 >= 1 - part) & (part > 0)
    return np.where(up, above, below)


# The octree


def bucket_of(keys: np.ndarray, seed: int, buckets: int) -> np.ndarray:
    """The hash function of cl/octree/find.cl."""
    h = (keys.astype(np.uint32) + np.uint32(1)) * np.uint32(seed)
    h = (h ^ h >> np.uint32(16)) * np.uint32(0x7FEB352D)
    h = (h ^ h >> np.uint32(15)) * np.uint32(0x846CA68B)
    h ^= h >> np.uint32(16)
    return (h.astype(np.uint64) * np.uint64(buckets) >> np.uint64(32)).astype(np.int64)


def make_table(keys: np.ndarray, first_cell: int) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Entries of one level's table, (buckets, 4), each key in the emptier one of its two; number of buckets, and the seeds."""
    buckets, rng = len(keys), np.random.default_rng(7)
    while True:
        seeds = rng.integers(0, 2**31, 2) * 2 + 1
        first, second = (bucket_of(keys, seed, buckets) for seed in seeds)
        table, used = np.full((buckets, 4), ~np.uint64(0)), np.zeros(buckets, int)
        for rank, (a, b) in enumerate(zip(first, second, strict=True)):
            place = a if used[a] <= used[b] else b
            if used[place] == 4:
                break
            table[place, used[place]] = int(keys[rank]) << 32 | first_cell + rank
            used[place] += 1
        else:
            return table, (buckets, int(seeds[0]), int(seeds[1]))


@dataclass
class HandOctree:
    """An octree of given cells, of at most 11 levels. keys: (cells of the finest level,) uint64, sorted."""

    device: Device
    keys: np.ndarray
    finest: int
    levels: list[np.ndarray] = field(init=False)

    def __post_init__(self):
        self.levels = [np.unique(self.keys >> np.uint64(3 * (self.finest - level))) for level in range(self.finest + 1)]
        self.first_cell = np.concatenate([[0], np.cumsum([len(keys) for keys in self.levels])])
        self.cells = int(self.first_cell[-1])

    @cached_property
    def arrays(self) -> dict:
        """As kernels take them."""
        made = [make_table(keys, int(first)) for keys, first in zip(self.levels, self.first_cell, strict=False)]
        begins = np.cumsum([0, *(numbers[0] for _, numbers in made)])
        rows = np.array([(begin, *numbers) for begin, (_, numbers) in zip(begins, made, strict=False)], np.uint32)
        entries = np.concatenate([table for table, _ in made]).ravel()
        return {"octree_table": self.device.upload(entries), "octree_tables": self.device.upload(rows)}

    def find(self, keys: np.ndarray, level: int) -> np.ndarray:
        """Global indices of a level's cells; -1 where there is none."""
        known = self.levels[level]
        rank = np.minimum(np.searchsorted(known, keys), len(known) - 1)
        return np.where(known[rank] == keys, self.first_cell[level] + rank, -1)


# Updates


@dataclass(frozen=True)
class Vertices:
    """What caching hands to an update. key: (n,) uint64. normal: (n, 3) float32. light: (3, n) float32."""

    key: np.ndarray
    normal: np.ndarray
    light: np.ndarray


@dataclass
class Cells:
    """The cells of an octree as they are stored. wipe: stamp. occupied: cells in use."""

    words: np.ndarray
    wipe: int = 1
    occupied: int = 0

    @property
    def light(self) -> np.ndarray:
        """(cells, 2, 3) float16: means of front and back."""
        return self.words.view(np.float16)[:, :6].reshape(-1, 2, 3)

    @property
    def count(self) -> np.ndarray:
        """(cells, 2): samples of front and back; 0 in cells that were wiped."""
        counts = np.stack([self.words[:, 4] & 0xFFFF, self.words[:, 4] >> 16], axis=1).astype(np.int64)
        return np.where(self.words[:, 5:] == self.wipe, counts, 0)

    @property
    def energy(self) -> np.ndarray:
        """(cells, 3) float64: mean times number of samples, both sides."""
        return (self.light.astype(np.float64) * self.count[..., None]).sum(axis=1)


@dataclass
class Records:
    """What an update adds to cells of a level, sorted. sums: (n, 2, 4) float32."""

    key: np.ndarray
    cell: np.ndarray
    normal: np.ndarray
    sums: np.ndarray


class Model:
    """Cells of an octree, updated in NumPy."""

    def __init__(self, octree: HandOctree, wipe: int = 1):
        self.octree, self.cells = octree, Cells(np.zeros((octree.cells, 6), np.uint32), wipe)

    def update(self, vertices: Vertices, update: int = 0, eye: int = 0, key: tuple[int, int] = KEY) -> dict[str, int]:
        """One update; its counters."""
        self._counts = dict.fromkeys(COUNTERS, 0)
        records = self._reduce(vertices)
        for level in range(self.octree.finest, -1, -1):
            self._merge(records, (2 * update + eye + 1) % 2**32, key)
            records = self._parents(records, level) if level else None
        return self._counts | {"occupied": self.cells.occupied, "capacity": self.octree.cells}

    def _fronts(self, cell: np.ndarray, first: np.ndarray) -> np.ndarray:
        words = self.cells.words[cell]
        is_new = words[:, 5] != self.cells.wipe
        self.cells.occupied += int(is_new.sum())
        self._counts["evicted"] += int((is_new & (words[:, 5] != 0)).sum())
        return np.where(is_new, first, words[:, 3])

    def _reduce(self, vertices: Vertices) -> Records:
        cell = self.octree.find(vertices.key, self.octree.finest)
        with np.errstate(over="ignore", invalid="ignore"):
            is_finite = np.isfinite(vertices.light[0] + vertices.light[1] + vertices.light[2])
        is_merged = (cell >= 0) & is_finite
        self._counts["inserted"] = int(is_merged.sum())
        self._counts["discarded"] = int((~is_merged & (vertices.key != NO_VERTEX)).sum())
        order = np.flatnonzero(is_merged)
        order = order[np.argsort(cell[order], kind="stable")]
        cells, first, run = np.unique(cell[order], return_index=True, return_inverse=True)
        packed = pack_normals(vertices.normal)[order]
        fronts = self._fronts(cells, packed[first])
        side = (dots(unfold_normals(packed), unfold_normals(fronts)[run]) <= 0).astype(int)
        light = np.minimum(np.column_stack([vertices.light.T[order], np.ones(len(order), F)]), F(1e30))
        sums, rest = np.zeros((2, len(cells), 2, 4), F)
        for i in range(len(order)):
            term = np.zeros((2, 4), F)
            term[side[i]] = light[i]
            following = term - rest[run[i]]
            value = sums[run[i]] + following
            rest[run[i]] = (value - sums[run[i]]) - following
            sums[run[i]] = value
        return Records(vertices.key[order][first], cells, fronts, sums)

    def _merge(self, records: Records, update: int, key: tuple[int, int]) -> None:
        cells, n = self.cells, len(records.cell)
        is_known = (cells.words[records.cell, 5] == cells.wipe)[:, None]
        count = np.where(is_known, cells.count[records.cell], 0).astype(F)
        light = np.where(is_known[..., None], cells.light[records.cell], np.float16(0))
        after, has_new = count + records.sums[..., 3], records.sums[..., 3] > 0
        mean = (light.astype(F) * count[..., None] + records.sums[..., :3]) / np.where(has_new, after, F(1))[..., None]
        rows = np.column_stack([records.cell, np.full(n, update), np.full((n, 2), key)]).astype(np.uint32)
        random = pcg4d(rows)[:, None, :3]
        rounded = round_to_halves(np.clip(mean, F(0), F(LARGEST_HALF)), np.broadcast_to(random, mean.shape))
        light = np.where(has_new[..., None], rounded, light).astype(np.float16)
        counts = np.minimum(after, MOST_SAMPLES).astype(np.uint32)
        words = np.ascontiguousarray(light.reshape(n, 6)).view(np.uint32)
        rest = [records.normal, counts[:, 0] | counts[:, 1] << np.uint32(16), np.full(n, cells.wipe, np.uint32)]
        cells.words[records.cell] = np.column_stack([words, *rest])

    def _parents(self, records: Records, level: int) -> Records:
        keys, first, family = np.unique(records.key >> np.uint64(3), return_index=True, return_inverse=True)
        cells = self.octree.find(keys, level - 1)
        fronts = self._fronts(cells, records.normal[first])
        is_alike = dots(unfold_normals(records.normal), unfold_normals(fronts)[family]) > 0
        sums = np.zeros((len(keys), 2, 4), F)
        for i, parent in enumerate(family):
            sums[parent] += records.sums[i] if is_alike[i] else records.sums[i, ::-1]
        return Records(keys, cells, fronts, sums)


class _Clear(Pass):
    """Counters that begin anew, as the methods' first pass has it."""

    name = "clear"
    writes = ("counters",)

    def run(self, arrays, state):
        arrays["counters"].fill(0)
        return ()


class DeviceCells:
    """Cells of an octree on a device, updated by the package's passes with so many vertices."""

    def __init__(self, octree: HandOctree | Octree, vertices: int, wipe: int = 1, device: Device | None = None):
        device = device or octree.device
        self.inputs = {
            "vertex_key": device.empty(vertices, np.uint64),
            "vertex_normal": device.empty(vertices, np.uint32),
            "vertex_light": device.empty((3, vertices), np.float32),
        }
        buffers = [*update_buffers(vertices, octree.cells), Buffer("counters", (len(COUNTERS),), np.uint32)]
        passes = [_Clear(), *update_passes(device, octree)]
        self.graph = FrameGraph(device, passes, buffers, {"octree_cells", "counters"}, self.inputs)
        self.wipe(wipe)

    def wipe(self, stamp: int) -> None:
        """As if the lighting had changed."""
        self.graph.of()["octree_wipe"].set(np.array([stamp, 0, 0, 0], np.uint32))

    def update(self, vertices: Vertices, update: int = 0, eye: int = 0, key: tuple[int, int] = KEY) -> dict[str, int]:
        """One update; its counters."""
        self.inputs["vertex_key"].set(vertices.key)
        self.inputs["vertex_normal"].set(pack_normals(vertices.normal))
        self.inputs["vertex_light"].set(np.ascontiguousarray(vertices.light, F))
        self.graph.run(PathState(None, key, 1, update=update, eye=eye))
        return dict(zip(COUNTERS, self.graph.of()["counters"].get().tolist(), strict=True))

    @property
    def cells(self) -> Cells:
        """As they are now."""
        arrays = self.graph.of()
        wipe = arrays["octree_wipe"].get()
        return Cells(arrays["octree_cells"].get(), int(wipe[0]), int(wipe[3]))
