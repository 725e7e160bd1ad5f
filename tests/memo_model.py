"""What `cl/memo/` is to do, in NumPy and plain Python: which key a hit has, and a table of values by their hashes (MaterialMemo)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

NONE = 0xFFFFFFFF
WORDS = 2**32
EMPTY, LOCKED, DEAD = 0, 1, 2
EVICTIONS = ("none", "random", "lrw-frame", "lru-frame", "lrw-counter", "lru-counter")
COUNTERS = (
    "lookups",
    "hits",
    "inserted",
    "evicted",
    "discarded",
    "occupied",
    "capacity",
    "distinct",
    "duplicates",
    "built",
)
FINEST, COARSEST = 24, -24
NO_BOUND = -30  # as the level of a graph's coarsest texels: they may be of any size
BEYOND = 4  # levels that footprints may be coarser than a graph's coarsest texels
SCATTERED = 3  # levels from a graph's coarsest on, in whose texels values are taken at random points
LARGEST_TEXEL = 1e9
NEAR = 1e-5  # so near to where one level ends float32 may take the next


def pcg_hash(word: np.ndarray | int) -> np.ndarray:
    """PCG's hash of words (O'Neill 2014): uint32."""
    word = np.asarray(word, np.uint64) % WORDS
    state = (word * np.uint64(747796405) + np.uint64(2891336453)) % WORDS
    mixed = (((state >> ((state >> np.uint64(28)) + np.uint64(4))) ^ state) * np.uint64(277803737)) % WORDS
    return ((mixed >> np.uint64(22)) ^ mixed).astype(np.uint32)


def hash_of(numbers: Sequence[np.ndarray], seed: np.ndarray | int) -> np.ndarray:
    """(n,) uint32: the chained hash of Eq. 5.8 and 5.9. numbers: those of a key, (n,) int each, the first of which is hashed last."""
    value = np.asarray(seed, np.uint32)
    for number in reversed(numbers):
        value = pcg_hash(np.asarray(number, np.int64) % WORDS ^ value.astype(np.int64))
    return value


def remapped(check: np.ndarray) -> np.ndarray:
    """Check hashes without those values that mean something else in the table."""
    check = np.asarray(check, np.uint32)
    return np.where(check <= DEAD, check + np.uint32(2**31), check)


@dataclass(frozen=True)
class Levels:
    """footprint: (n,) int, the levels of footprints. texels: (n,) int, those by which texels are apart. scattered: (n,) bool, whether values
    are taken at random points of them. certain: (n,) bool, whether rounding cannot change these."""

    footprint: np.ndarray
    texels: np.ndarray
    scattered: np.ndarray
    certain: np.ndarray

    @property
    def word(self) -> np.ndarray:
        """(n,) int: all, as keys have them."""
        return self.footprint - COARSEST + 2**8 * (self.texels - COARSEST) + 2**16 * self.scattered

    @property
    def middle(self) -> np.ndarray:
        """(n,): what is called the middle of texels; the finest are points."""
        return np.where(self.texels == FINEST, 0.0, 0.5)

    def places(self, texel: np.ndarray) -> np.ndarray:
        """(n, d): where in texels their values are taken, of their size. texel: (n, d) int, in two or three dimensions."""
        u, v, *rest = np.asarray(texel).T
        if rest:
            w = rest[0]
            found = [*self._drawn(u, v ^ w), self._drawn(v, w ^ u)[1]]
        else:
            found = self._drawn(u, v)
        return np.where(self.scattered, found, self.middle).T

    def _drawn(self, u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
        word = hash_of([u, v], pcg_hash(self.word)).astype(np.int64)
        return [(word & 0xFFFF) / 2**16, (word >> 16) / 2**16]


def levels_of(
    x: np.ndarray, y: np.ndarray, point: np.ndarray, bias: float = 0.0, coarsest: np.ndarray | int = NO_BOUND
) -> Levels:
    """The levels of footprints (Eq. 5.5, with its sign put right), within their bounds. x, y: (n, d) axes. point: (n, d), of which no
    number of a texel exceeds 2^29. coarsest: (n,), the level of the coarsest texels."""
    with np.errstate(divide="ignore", over="ignore"):
        shorter = np.minimum(*(np.square(np.asarray(a, float)).sum(axis=1) for a in (x, y)))
        exact = -0.5 * np.log2(np.clip(shorter, 1e-37, 1e37)) + bias
        _, exponent = np.frexp(np.abs(np.asarray(point, np.float32)).max(axis=1))  # largest < 2^exponent
        finest = np.minimum(FINEST, 29 - np.where(point.any(axis=1), exponent, -200))
    level = np.clip(np.floor(exact + 0.5), COARSEST, FINEST)
    off = np.abs(exact + 0.5 - np.round(exact + 0.5))
    certain = (off > NEAR) | (exact + 0.5 > finest + 1) | (exact + 0.5 < COARSEST)
    finest = np.maximum(finest, COARSEST)
    widest = np.minimum(np.maximum(coarsest - BEYOND, COARSEST), finest)
    footprint = np.clip(level, widest, finest).astype(int)
    texels = np.minimum(np.maximum(footprint, coarsest), finest).astype(int)
    return Levels(footprint, texels, (texels < coarsest + SCATTERED) & (texels < FINEST), certain)


def texels_of(point: np.ndarray, level: np.ndarray) -> np.ndarray:
    """(n, d) int: the texels of levels that points lie in. point: (n, d) float32."""
    scaled = np.float32(point).astype(float) * np.exp2(level)[:, None]
    return np.clip(np.floor(scaled), -LARGEST_TEXEL, LARGEST_TEXEL).astype(np.int64)


@dataclass(frozen=True)
class Keys:
    """place, check: (n,) uint32: where the search begins, and what is compared. numbers: by name, all that tells texels apart, (n,)
    int. certain: (n,) bool, whether rounding cannot change them."""

    place: np.ndarray
    check: np.ndarray
    numbers: dict[str, np.ndarray]
    certain: np.ndarray


def keys_of(
    graph: np.ndarray,
    uv: tuple[np.ndarray, np.ndarray, np.ndarray],
    position: tuple[np.ndarray, np.ndarray, np.ndarray],
    reads: Sequence[str],
    places: int,
    bias: float = 0.0,
    coarsest: np.ndarray | None = None,
) -> Keys:
    """The keys of hits. uv, position: a point and the axes of its footprint, (n, 2) and (n, 3) float32 each. reads: which of both the
    graphs read. places: at which searches begin. coarsest: (graphs, 2), levels of the coarsest texels, in two dimensions and in three."""
    numbers, is_certain = {}, np.ones(len(graph), bool)
    of_both = ("uv", uv, ("level", "u", "v")), ("position", position, ("level3", "x", "y", "z"))
    for k, (name, (point, x, y), axes) in enumerate(of_both):
        if name in reads:
            level = levels_of(x, y, point, bias, NO_BOUND if coarsest is None else coarsest[graph, k])
            numbers |= dict(zip(axes, (level.word, *texels_of(point, level.texels).T), strict=True))
            is_certain &= level.certain
    graph = np.asarray(graph, np.int64)
    first, second = (hash_of(list(numbers.values()), pcg_hash(seed % WORDS)) for seed in (graph, ~graph))
    return Keys((first % np.uint32(places)).astype(np.uint32), remapped(second), numbers, is_certain)


@dataclass
class Table:
    """Places, each with a key, and the stamps, counts and clock that evictions go by. records: of each place its key; stamp of the last
    access; twice how many times it was written, and one more while it is; stamp of then; the clock's."""

    capacity: int
    probe: int
    eviction: str = "lru-frame"
    records: list[list[int]] = field(default_factory=list)
    clock: int = 0
    counters: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))

    def __post_init__(self):
        self.records = self.records or [[0] * 5 for _ in range(self.capacity)]

    def _count(self, name: str, count: int = 1) -> None:
        self.counters[name] = (self.counters[name] + count) % WORDS

    def way(self, place: int) -> list[int]:
        """The places that a search looks at, in order: up to the first that was never used."""
        way = list(range(place, place + self.probe))
        empty = [k for k, e in enumerate(way) if self.records[e][0] == EMPTY]
        return way[: empty[0] + 1] if empty else way

    def find(self, place: int, check: int) -> int:
        """The entry, or NONE."""
        return next((e for e in self.way(place) if self.records[e][0] == check), NONE)

    def touch(self, entry: int, stamp: int) -> None:
        """Note that it was read."""
        self._count("distinct", self.records[entry][1] != stamp)
        self.records[entry][1] = stamp
        if self.eviction == "lru-counter":
            self._tick(entry)

    def _tick(self, entry: int) -> None:
        self.records[entry][4], self.clock = self.clock, self.clock + 1

    def _least_useful(self, way: Sequence[int], place: int, stamp: int, draw: int) -> int:
        if self.eviction == "random":
            return place + draw % self.probe
        unlocked = [e for e in way if self.records[e][0] != LOCKED]
        if self.eviction == "none" or not unlocked:
            return NONE
        if self.eviction.endswith("counter"):
            return min(unlocked, key=lambda e: self.records[e][4])
        word = 3 if self.eviction == "lrw-frame" else 1
        return max(unlocked, key=lambda e: (stamp - self.records[e][word]) % WORDS)

    def lock(self, place: int, check: int, stamp: int, draw: int) -> int:
        """The entry that the key is to get, locked; NONE where it gets none."""
        way = self.way(place)
        if any(self.records[e][0] == check for e in way):
            self._count("duplicates")
            return NONE
        free = [e for e in way if self.records[e][0] in (EMPTY, DEAD)]
        entry = free[0] if free else self._least_useful(way, place, stamp, draw)
        if entry == NONE or self.records[entry][0] == LOCKED:
            self._count("discarded")
            return NONE
        self._count("occupied" if free else "evicted")
        self.records[entry][0] = LOCKED
        self.records[entry][2] += 1
        return entry

    def publish(self, place: int, entry: int, check: int, stamp: int) -> None:
        """Unlock it; of twins, the one that is further on dies."""
        self.records[entry][0:4] = [check, stamp, self.records[entry][2] + 1, stamp]
        if self.eviction.endswith("counter"):
            self._tick(entry)
        self._count("inserted")
        self._count("distinct")
        for twin in self.way(place):
            if self.records[twin][0] == check and twin != entry:
                self._count("duplicates")
                self._count("occupied", -1)
                self.records[max(twin, entry)][0] = DEAD
                if twin < entry:
                    return

    def access(self, place: int, check: int, stamp: int, draw: int) -> int:
        """Look up as the caches do: find, or else insert. The entry found, else NONE."""
        self._count("lookups")
        entry = self.find(place, check)
        if entry != NONE:
            self._count("hits")
            self.touch(entry, stamp)
            return entry
        locked = self.lock(place, check, stamp, draw)
        if locked != NONE:
            self.publish(place, locked, check, stamp)
        return NONE

    def keys(self) -> list[int]:
        """Of the entries that hold a value."""
        return [r[0] for r in self.records if r[0] > DEAD]
