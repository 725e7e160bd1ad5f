"""The cache of tiles on a device, fed with requests, and what it must answer."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from memo_model import COARSEST, FINEST, Levels

from clcache.device import Device
from clcache.passes.tiles import image_shape, tile_buffers, tile_defines, tile_size, tile_texels
from clcache.probe import LANE_EXTENSIONS
from clcache.settings import SETTINGS

# Graph g gives 3 + g channels: linear functions of the texture coordinates and of the footprint, and its number.
GRAPHS = """
#include "graph/types.cl"
#include "scene/maps.cl"

NOINLINE void evaluate_graph(uint graph, const GraphInputs *in, const Maps *maps, float *out)
{
    float u = in->uv.v.x, v = in->uv.v.y;
    out[0] = 2.0f * u - v;
    out[1] = in->uv.x.x + in->uv.y.y + in->uv.x.y + in->uv.y.x;
    out[2] = (float)graph;
    for (uint c = 0; c < graph; c++) out[3 + c] = 0.5f * v * (float)(c + 1);
}
"""
CHANNELS = 7  # of graphs 0 .. 4
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
TILES = ("2x2", "3x3", "4x4", "5x5", "6x5", "8x4")
LAYOUTS = ("entry", "buffer", "image2d", "image3d")
CHUNK, RUN = 4096, 16


@dataclass(frozen=True)
class Hits:
    """Of n hits. cell: (4, n) int32, tile in u and v, levels, graph; within: (2, n); asks: (n,) whether a tile is asked for."""

    cell: np.ndarray
    within: np.ndarray
    asks: np.ndarray

    def __getitem__(self, which) -> "Hits":
        return Hits(self.cell[:, which], self.within[:, which], self.asks[which])

    def __len__(self) -> int:
        return len(self.asks)


def has_sub_groups(device: Device) -> bool:
    """Whether lanes can be those of a sub-group. What graphs call with vectors, they may get wrong all the same."""
    return set(device.context.devices[0].extensions.split()) >= LANE_EXTENSIONS


def pcg(word):
    """PCG's hash of uint32."""
    state = np.asarray(word, np.uint32) * np.uint32(747796405) + np.uint32(2891336453)
    mixed = ((state >> ((state >> np.uint32(28)) + np.uint32(4))) ^ state) * np.uint32(277803737)
    return mixed >> np.uint32(22) ^ mixed


def hashed(cell: np.ndarray, seed: int) -> np.ndarray:
    """(n,) uint32 of (4, n) cells."""
    value = np.full(cell.shape[1], seed, np.uint32)
    for number in cell.astype(np.int64).astype(np.uint32):
        value = pcg(value ^ number)
    return value


@dataclass(frozen=True)
class Cache:
    """How tiles are stored, read and built. native: lanes are those of a sub-group."""

    device: Device
    tile: str = "4x4"
    filter: str = "nearest"
    layout: str = "buffer"
    builder: str = "serial"
    native: bool = False
    grouped: bool = False
    precision: str = "float"
    eviction: str = "lru-frame"
    read: str = "counter"
    capacity: int = 1000
    probe: int = 8
    channels: int = CHANNELS
    graphs: str = GRAPHS
    arrays: dict = field(default_factory=dict, compare=False)

    @property
    def settings(self) -> dict:
        """By dotted name."""
        chosen = {
            f"memo.{name}": getattr(self, name)
            for name in ("tile", "filter", "layout", "builder", "grouped", "precision")
        }
        return {name: s.default for name, s in SETTINGS.items()} | chosen

    @property
    def defines(self) -> dict:
        """Of the program."""
        half = self.precision == "half"
        by_counter = self.eviction.endswith("counter")
        value_words = -(-self.channels // 2) if half else self.channels
        record_words = 6 if by_counter else 4
        return {
            "READ_COUNTER": self.read == "counter",
            "EVICTION": SETTINGS["memo.eviction"].choices.index(self.eviction),
            "HALF": half,
            "VALUE_WORDS": value_words,
            "RECORD_WORDS": record_words,
            "TILED": 1,
            "GRAPH_CHANNELS": self.channels,
            "NATIVE_SUBGROUPS": self.native,
            **tile_defines(self.settings, record_words, value_words),
        }

    def kernel(self):
        """The kernel that looks up."""
        return self.device.program("memo/tile.cl", {"graph/generated.cl": self.graphs}, **self.defines)["look_up_tiles"]

    def table(self) -> dict:
        """The arrays that outlive a look-up, zeros at first."""
        if not self.arrays:
            device = self.device
            stride = self.defines["RECORD_STRIDE"]
            self.arrays["memo_records"] = device.upload(np.zeros((self.capacity, stride), np.uint32))
            self.arrays["memo_clock"] = device.upload(np.zeros(1, np.uint64))
            for b in tile_buffers(self.settings, self.channels, self.capacity, 1):
                if b.name == "memo_tiles":
                    array = device.image(b.shape, b.dtype) if b.is_image else device.upload(np.zeros(b.shape, b.dtype))
                    self.arrays.update(memo_tiles=array, tiles_read=array, tiles_written=array)
        return self.arrays

    def upload(self, hits: Hits, alive: int | None = None) -> dict:
        """What a look-up reads and writes besides the table. alive: hits that are, of each chunk; None for all."""
        device, n = self.device, len(hits)
        probe = min(self.probe, self.capacity)
        check = hashed(hits.cell, 2)
        check = np.where(hits.asks, np.where(check < 3, check + 0x80000000, check), 0).astype(np.uint32)
        place = (hashed(hits.cell, 1) % max(self.capacity - probe, 1)).astype(np.uint32)
        alive = np.full(-(-n // CHUNK), CHUNK if alive is None else alive, np.uint32)
        arrays = {
            "alive": alive, "memo_place": place, "memo_check": check, "memo_cell": np.int32(hits.cell),
            "memo_within": np.float32(hits.within), "memo_counters": np.zeros(len(COUNTERS), np.uint32),
            "memo_graph_count": np.zeros((5, 2), np.uint32), "graph_value": np.full((self.channels, n), -77.0, np.float32),
        }  # fmt: skip
        return {name: device.upload(values) for name, values in arrays.items()}

    def look_up(
        self, hits: Hits, stamp: int = 1, alive: int | None = None, turn: int = 0, turns: int = 1
    ) -> tuple[np.ndarray, dict[str, int], np.ndarray]:
        """Values, (channels, n), with -77 where nothing was written; counters; lookups and hits of each graph, (graphs, 2)."""
        arrays, n = self.upload(hits, alive), len(hits)
        scalars = {"capacity": self.capacity, "probe": min(self.probe, self.capacity), "stamp": stamp, "n": n}
        scalars |= {"turn": turn, "turns": turns}
        count = -(-n // RUN) if self.builder == "serial" else n
        self.kernel().run(count, arrays, self.table(), **scalars)
        counters = dict(zip(COUNTERS, arrays["memo_counters"].get().tolist(), strict=True))
        return arrays["graph_value"].get(), counters, arrays["memo_graph_count"].get()

    def tiles(self) -> dict[int, bytes]:
        """The texels of the tiles that are in the table, (texels, channels) as float32, by check hash."""
        records = self.arrays["memo_records"].get()
        kept = [e for e in range(self.capacity) if records[e, 0] >= 3]
        texels = self._texels(records)
        return {int(records[e, 0]): texels[e].tobytes() for e in kept}

    def _texels(self, records: np.ndarray) -> np.ndarray:
        """(capacity, texels, channels) float32."""
        texels, channels = tile_texels(self.settings), self.channels
        if self.layout.startswith("image"):
            return self._image_texels(self.arrays["memo_tiles"].get())
        words = self.defines["VALUE_WORDS"] * texels
        first = self.defines["RECORD_WORDS"]
        raw = records[:, first : first + words] if self.layout == "entry" else self.arrays["memo_tiles"].get()
        values = np.ascontiguousarray(raw).view(np.float16 if self.precision == "half" else np.float32)
        return values.reshape(self.capacity, texels, -1)[:, :, :channels].astype(np.float32)

    def _image_texels(self, image: np.ndarray) -> np.ndarray:
        width, height = tile_size(self.settings)
        quads = -(-self.channels // 4)
        assert image.shape == image_shape(self.settings, self.channels, self.capacity)
        found = np.zeros((self.capacity, height, width, 4 * quads), np.float32)
        for entry in range(self.capacity):
            for quad in range(quads):
                if image.ndim == 3:
                    across = image.shape[1] // (width * quads)
                    x, y = (entry % across * quads + quad) * width, entry // across * height
                    part = image[y : y + height, x : x + width]
                else:
                    across, down = image.shape[2] // width, image.shape[1] // height
                    x, y = entry % across * width, entry // across % down * height
                    part = image[entry // (across * down) * quads + quad, y : y + height, x : x + width]
                found[entry, :, :, 4 * quad : 4 * quad + 4] = part
        return found.reshape(self.capacity, width * height, -1)[:, :, : self.channels]

    def with_(self, **changes) -> "Cache":
        """Another cache, empty."""
        return replace(self, arrays={}, **changes)


def covers(cache: Cache) -> np.ndarray:
    """Texels that a tile stands for in u and v."""
    return np.array(tile_size(cache.settings)) - (cache.filter == "bilinear")


def word_of(footprint: np.ndarray | int, texels: np.ndarray | int) -> np.ndarray:
    """The levels of footprints, and of texels, as requests have them; the coarser ones' values are at random points."""
    texels = np.asarray(texels)
    return Levels(np.asarray(footprint), texels, texels < 4, np.asarray(True)).word


def some_hits(
    cache: Cache, n: int, seed: int = 1, tiles: int = 3, levels: int = 2, graphs: int = 5, asking: float = 0.9
) -> Hits:
    """Hits of few tiles, some asking nothing, at places that are multiples of 1/64 of a texel. Footprints are as large as texels or
    larger; the last of the levels is the finest."""
    rng = np.random.default_rng(seed)
    texels = np.array([*range(3, 2 + levels), FINEST])[rng.integers(0, levels, n)]
    footprint = np.where(texels == 3, rng.integers(2, 4, n), texels)
    cell = np.stack([
        rng.integers(-tiles, tiles, n), rng.integers(-1, 1, n), word_of(footprint, texels), rng.integers(0, graphs, n)
    ])  # fmt: skip
    within = rng.integers(0, 64 * covers(cache)[:, None], (2, n)) / 64
    return Hits(cell, within, rng.random(n) < asking)


def expected(cache: Cache, hits: Hits) -> np.ndarray:
    """What the graphs give at the texels' middles, or by interpolation, which reproduces linear functions."""
    footprint, texels, scattered = hits.cell[2] & 255, hits.cell[2] >> 8 & 255, hits.cell[2] >> 16
    levels = Levels(footprint + COARSEST, texels + COARSEST, scattered == 1, np.asarray(True))
    corner = hits.cell[:2] * covers(cache)[:, None] + np.floor(hits.within).astype(int)
    is_bilinear = cache.filter == "bilinear"
    place = hits.within % 1 + levels.middle if is_bilinear else levels.places(corner.T).T
    u, v = (corner + place) * 2.0**-levels.texels
    width = 2.0**-levels.footprint
    graph = hits.cell[3]
    values = np.zeros((cache.channels, len(hits)))
    values[:3] = 2 * u - v, 2 * width, graph
    for c in range(cache.channels - 3):
        values[3 + c] = np.where(c < graph, 0.5 * v * (c + 1), 0)
    values[:, ~hits.asks] = -77
    return values.astype(np.float32)


def distinct(hits: Hits) -> int:
    """How many tiles are asked for."""
    return len(np.unique(hits.cell[:, hits.asks], axis=1).T)


def tiles_at_once(cache: Cache) -> int:
    """How many tiles a group of lanes builds in an iteration."""
    return 32 // math.prod(tile_size(cache.settings))
