"""What `cl/voxelhash/` is to do, in NumPy and plain Python: which voxel a point belongs to, and a table of voxels by their hashes."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from clcache.random import pcg4d

NONE = 0xFFFFFFFF
WORDS = 2**32
TILE = 4  # voxels along a tile's side
BLOCK = TILE * TILE  # entries of a tile
LEAST_COSINE = 1 / 16
HIGHEST_LEVEL = 100
LAYER_OFFSET = 0.3183
PLACE_SEED, CHECK_SEED = 0x5BF03635, 0x9D2C5681
NEAR = 1e-5  # so near to where one level ends float32 may take the next
ROUNDING = 2.0**-23


def levels_of(
    eye: Sequence[float], spread: float, points: np.ndarray, normals: np.ndarray, factor: float, incidence: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) each: the level of points' voxels, and whether rounding cannot change it. spread: a pixel's width at distance 1. points,
    normals: (n, 3). factor: how much larger than a pixel voxels may be."""
    towards = np.asarray(points, float) - np.asarray(eye, float)
    distance = np.linalg.norm(towards, axis=1)
    footprint = factor * spread * distance
    if incidence:
        footprint /= np.maximum(np.abs((towards * normals).sum(axis=1)) / distance, LEAST_COSINE)
    exact = np.log2(footprint)
    return np.clip(np.floor(exact), -HIGHEST_LEVEL, HIGHEST_LEVEL).astype(int), np.abs(exact - np.round(exact)) > NEAR


@dataclass(frozen=True)
class Voxels:
    """key: (n, 4) int, two places in the plane, the layer across it, and level, darkness and face as one: all that tells voxels apart. place, check:
    (n,) uint32, where the search begins and what is compared. certain: (n,) bool, whether rounding cannot change them."""

    key: np.ndarray
    place: np.ndarray
    check: np.ndarray
    certain: np.ndarray


def voxels_of(
    points: np.ndarray, normals: np.ndarray, levels: np.ndarray, capacity: int, dark: np.ndarray | int = 0
) -> Voxels:
    """The voxels of points. points, normals: (n, 3). levels: (n,). capacity: of the table, in entries. dark: (n,), a bit for each of the
    albedo's components that is too dark to divide by."""
    normals, levels = np.asarray(normals, float), np.asarray(levels, int)
    rows = np.arange(len(levels))
    scaled = np.asarray(points, float) * 2.0 ** -levels[:, None]
    axis = np.argmax(np.abs(normals), axis=1)
    face = 2 * axis + (normals[rows, axis] < 0)
    plane = np.array([(1, 2), (0, 2), (0, 1)])[axis]
    exact = np.column_stack(
        [scaled[rows, plane[:, 0]], scaled[rows, plane[:, 1]], scaled[rows, axis] + float(np.float32(LAYER_OFFSET))]
    )
    sizes = np.sort(np.abs(normals), axis=1)
    off = np.abs(exact[:, 2] - np.round(exact[:, 2])) > ROUNDING * (
        1 + np.abs(exact[:, 2])
    )  # only here is a sum rounded
    key = np.column_stack([np.floor(exact).astype(np.int64), (levels + 128) << 6 | dark << 3 | face])
    tiles = key.copy()
    tiles[:, :2] >>= 2
    tiles[:, 3] ^= PLACE_SEED
    checks = key.copy()
    checks[:, 3] ^= CHECK_SEED
    blocks = max(capacity // BLOCK, 1)
    block = _first_word(tiles).astype(np.uint64) * np.uint64(blocks) >> np.uint64(32)
    place = block.astype(np.int64) * BLOCK + TILE * (key[:, 1] % TILE) + key[:, 0] % TILE
    return Voxels(key, place.astype(np.uint32), np.maximum(_first_word(checks), 1), off & (sizes[:, 2] > sizes[:, 1]))


def _first_word(words: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return pcg4d((words % WORDS).astype(np.uint32))[:, 0]


@dataclass
class Table:
    """Places, each with a check hash and a stamp, or None if it never held any. lifetime: in stamps."""

    capacity: int
    probe: int
    lifetime: int
    entries: list[tuple[int, int] | None] = field(default_factory=list)

    def __post_init__(self):
        self.entries = self.entries or [None] * self.capacity

    def way(self, place: int) -> list[int]:
        """The places that a search looks at, in order: up to the first that was never used."""
        steps = [(place + BLOCK * k) % self.capacity for k in range(self.probe)]
        unused = [k for k, step in enumerate(steps) if self.entries[step] is None]
        return steps[: unused[0] + 1] if unused else steps

    def age(self, entry: int, stamp: int) -> int:
        """How many stamps ago it was accessed; below 0 for stamps to come."""
        return (stamp - self.entries[entry][1] + WORDS // 2) % WORDS - WORDS // 2

    def is_live(self, entry: int, stamp: int) -> bool:
        """Whether it is there to be found."""
        return self.entries[entry] is not None and self.age(entry, stamp) <= self.lifetime

    def find(self, place: int, check: int, stamp: int) -> int:
        """The entry, or NONE."""
        found = [e for e in self.way(place) if self.is_live(e, stamp) and self.entries[e][0] == check]
        return found[0] if found else NONE

    def insert(self, place: int, check: int, stamp: int) -> tuple[int, str]:
        """The entry with the current stamp, and what became of the search."""
        way = self.way(place)
        own = [e for e in way if self.entries[e] is not None and self.entries[e][0] == check]
        free = [e for e in way if not self.is_live(e, stamp)]
        if own and self.is_live(own[0], stamp):
            entry, outcome = own[0], "hit"
            stamp = self.entries[entry][1] if self.age(entry, stamp) < 0 else stamp
        elif not free:
            return NONE, "discarded"
        else:
            entry = (own or free)[0]
            outcome = "inserted" if self.entries[entry] is None else "evicted"
        self.entries[entry] = (check, stamp)
        return entry, outcome

    def keys(self) -> np.ndarray:
        """(capacity,) uint64: the entries as a device holds them."""
        return np.array([0 if e is None else e[0] << 32 | e[1] for e in self.entries], np.uint64)
