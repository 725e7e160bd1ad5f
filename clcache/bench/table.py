"""The hash table of the voxels: lookups and insertions, by its load (`cl/voxelhash/look_up.cl`).

Keys are those of squares of voxels, as surfaces have them: in the order of the image, where neighbours share cache lines,
or shuffled, as after many bounces.
"""

from collections.abc import Iterator

import numpy as np

from ..device import Device, event_seconds, fill
from ..passes.voxelhash import RUN, TILE, voxel_counts
from ..program import Kernel
from .job import Job
from .result import Result

FAMILY = "table"
CAPACITY = 1 << 21  # entries, 48 MiB
LOADS = (0.25, 0.5, 0.75, 0.9)  # keys for each entry of the table; where it is nearly full, some find no place
PROBE = 16
_NONE = 0xFFFFFFFF
_DEFINES = {"JITTER": 0, "COIN": 0, "GATE": 0, "LOD_BY_INCIDENCE": 0, "INHERIT": 0, "HAS_SPECULAR": 0}


def table(job: Job) -> Iterator[Result]:
    """Seconds of looking up as many keys as an image has pixels; hits are of keys that the table has, and insertions of others,
    for which it may have no place. nbytes: their places and checks, and a cache line of keys for each tile in order, or for
    each key in none."""
    device, rng = Device(job.device, job.threads), np.random.default_rng(1)
    count = job.size[0] * job.size[1]
    for load in LOADS:
        tables = _Table(device, _keys(rng, int(load * CAPACITY), CAPACITY))
        for order in ("in order", "shuffled"):
            for what, keys in (("hits", tables.keys), ("misses", _keys(rng, count, CAPACITY))):
                asked = keys[:count] if order == "in order" else rng.permutation(keys)[:count]
                seconds = tuple(tables.find(asked)[0] for _ in range(job.repeats + 1))[1:]
                yield Result(
                    FAMILY, f"{what} {order}, load {load}", "", len(asked), "lookups", seconds, _moved(order, asked)
                )
        new = _keys(rng, count, CAPACITY)
        seconds = tuple(tables.insert(new)[0] for _ in range(job.repeats + 1))[1:]
        yield Result(
            FAMILY, f"insertions in order, load {load}", "", len(new), "lookups", seconds, _moved("in order", new)
        )
        tables.release()


def _keys(rng: np.random.Generator, count: int, capacity: int) -> np.ndarray:
    """(count, 2) uint32: places and checks of tiles that lie anywhere."""
    tiles = -(-count // TILE)
    block = rng.integers(0, capacity // TILE, tiles, np.uint32)
    place = (block[:, None] * np.uint32(TILE) + np.arange(TILE, dtype=np.uint32)).reshape(-1)[:count]
    return np.stack([place, rng.integers(1, 2**32, count, np.uint32)], axis=1)


def _moved(order: str, keys: np.ndarray) -> int:
    lines = len(keys) * 8 if order == "in order" else len(keys) * 64
    return keys.nbytes + lines


class _Table:
    """A table that holds these keys, as far as it has places for them: `keys` are those that it holds."""

    def __init__(self, device: Device, keys: np.ndarray):
        self._device = device
        program = device.program("voxelhash/look_up.cl", **_DEFINES, **voxel_counts())
        self._look_up = program["look_up"]
        self._find = device.program("voxelhash/answer.cl", **_DEFINES, **voxel_counts())["find_seen"]
        self._arrays = {
            "voxel_key": device.upload(np.zeros(CAPACITY, np.uint64), "keys"),
            "voxel_radiance": device.upload(np.zeros((CAPACITY, 4), np.float32), "radiance"),
            "voxel_claim": device.upload(np.zeros(CAPACITY, np.uint32), "claims"),
            "voxel_occupied": device.upload(np.zeros(1, np.uint32), "occupied"),
            "counters": device.upload(np.zeros(len(voxel_counts()), np.uint32), "counters"),
        }
        self._full = np.zeros(CAPACITY, np.uint64)
        self.insert(keys)
        self._full = self._arrays["voxel_key"].get()
        self.keys = keys[np.isin(keys[:, 1], (self._full >> np.uint64(32)).astype(np.uint32))]

    def insert(self, keys: np.ndarray) -> tuple[float, int]:
        """Insert keys that are not there, into the table as it was made: seconds, and for how many there was room."""
        self._arrays["voxel_key"].set(self._full)
        return self._run(self._look_up, keys, {"voxel_place": keys[:, 0], "voxel_check": keys[:, 1]}, "voxel")

    def find(self, keys: np.ndarray) -> tuple[float, int]:
        """Look keys up, and change nothing: seconds, and how many are there."""
        n = len(keys)
        nothing = np.full(n, _NONE, np.uint32)
        both = {"seen_place": np.stack([keys[:, 0], nothing]), "seen_check": np.stack([keys[:, 1], nothing])}
        return self._run(self._find, keys, both, "seen_place")

    def _run(self, kernel: Kernel, keys: np.ndarray, lists: dict[str, np.ndarray], found: str) -> tuple[float, int]:
        n = len(keys)
        lists |= {"asked_stream": np.arange(n, dtype=np.uint32), "voxel": np.zeros(n, np.uint32)}
        arrays = {name: self._device.upload(np.ascontiguousarray(values), name) for name, values in lists.items()}
        scalars = {"capacity": CAPACITY, "probe": PROBE, "stamp": 1, "lifetime": 2, "update": 0, "entries": n, "n": n}
        fill(self._arrays["counters"], 0)
        event = kernel.run(-(-n // RUN), arrays, self._arrays, **scalars)
        self._device.queue.finish()
        entries = int(np.count_nonzero(arrays[found].get() != _NONE))
        self._device.release(*arrays.values())
        return event_seconds(event), entries

    def release(self) -> None:
        """Give back the arrays."""
        self._device.release(*self._arrays.values())
