"""What the graphs of materials return at hits (`cl/memo/`): evaluated, or remembered (MaterialMemo).

Before hits are shaded, `graph_value` gets the values of those whose materials have graphs, by place in the queue. Without
memoization each graph is evaluated at its hit. With it, a hit's texel of a virtual texture, or the tile that it lies in, is looked
up in a hash table that both eyes and all frames share; who finds nothing evaluates the graph, and inserts what it returned.
"""

from collections import ChainMap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device, event_seconds, fill
from ..errors import SettingError
from ..frame import Buffer, Pass
from ..memo import IS_MEMOIZED, KNOWN_COLUMNS, READS_POSITION, READS_UV, Costs, Memo
from ..resources import SceneResources
from ..scene.geometry import NONE
from ..settings import SETTINGS
from .tiles import TileLookUp, check_tiles, tile_buffers, tile_defines, tile_texels
from .trace import HITS, stamp

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
LEVELS = ("occupied", "capacity")  # those that say what there is, and not what was done
VALUES = "graph_value"
# Of first hits that methods with caches ask about beside the paths: where a path began, for when it is through; and of lists of samples.
FIRST_VALUES = "first_value"
SEEN_VALUES = "seen_value"
ASKED_VALUES = "asked_value"
NEW_VALUES = "new_value"
DESCRIBED_VALUES = "described_value"
_OF_LISTS = (FIRST_VALUES, SEEN_VALUES, ASKED_VALUES, NEW_VALUES, DESCRIBED_VALUES)
_RUN = 16  # places that one work-item goes through, as in cl/memo/texel.cl
_TEXELS = 1 << 21  # for which there is room where no capacity is given
_QUEUE = ("alive", *HITS, "ray_direction", "ray_length", "cone")
_KEY_DEFINES = ("TILED", "TILE_WIDTH", "TILE_HEIGHT", "BILINEAR")  # all that keys depend on, besides the scene
# Hits by which a graph's costs are measured: as many as take so many seconds to evaluate if all miss, of at least and at most so many.
_BUDGET = 5e-4
_LEAST_MEASURED, _MOST_MEASURED = 64, 4096
_LEAST_SECONDS = 2e-9  # of a hit: what is less is not known


@dataclass(frozen=True)
class GraphSetup:
    """What the passes have in common. settings: all, by dotted name. kind: one of MEMOS; "off" where the scene has no graphs."""

    device: Device
    scene: SceneResources
    settings: Mapping[str, bool | int | float | str]
    kind: str
    memo: Memo | None = None

    @classmethod
    def of(
        cls, device: Device, scene: SceneResources, settings: Mapping[str, bool | int | float | str], kind: str
    ) -> "GraphSetup":
        """The same with what is known of the memoization. Raises SettingError where the device cannot do as the settings say."""
        setup = cls(device, scene, settings, kind if scene.graphs else "off")
        if setup.kind == "off":
            return setup
        setup._check()
        cannot = [_why_not(g.reads, setup.kind) for g in scene.graphs]
        auto = settings["memo.auto"]
        memo = Memo(scene.graph_materials, _reads(scene), cannot, auto, lambda arrays: _measure(setup, arrays))
        return replace(setup, memo=memo)

    def _check(self) -> None:
        if self.by_counter and not self.device.capabilities.int64_atomics:
            name = self.settings["memo.eviction"]
            raise SettingError(
                f"setting memo.eviction: {name} needs 64-bit atomics, which {self.device.name} lacks; "
                "expected a strategy by frame"
            )
        if self.kind == "tile":
            check_tiles(self.device, self.settings, self.scene.graph_channels, self.capacity)

    @property
    def capacity(self) -> int:
        """Entries of the table: texels or tiles."""
        texels = tile_texels(self.settings) if self.kind == "tile" else 1
        return self.settings["memo.capacity"] or _TEXELS // texels

    @property
    def probe(self) -> int:
        """Places that are looked at: no more than there are."""
        return min(self.settings["memo.probe"], self.capacity)

    @property
    def places(self) -> int:
        """Places at which probing begins (Eq. 5.10)."""
        return max(self.capacity - self.probe, 1)

    @property
    def turns(self) -> int:
        """Passes in which a frame's lookups are made."""
        return 1 if self.spacing else int(self.settings["memo.passes"])

    @property
    def spacing(self) -> int:
        """Side of the squares of pixels, of each of which one is traced in a pre-pass; 0 where there is none."""
        passes = self.settings["memo.passes"]
        return int(passes.removeprefix("prepass")) if passes.startswith("prepass") else 0

    @property
    def by_counter(self) -> bool:
        """Whether entries are evicted by a clock that counts accesses."""
        return self.settings["memo.eviction"].endswith("-counter")

    @property
    def defines(self) -> dict[str, int | bool]:
        """What the kernels of the cache are specialised by."""
        settings, channels = self.settings, self.scene.graph_channels
        is_half = settings["memo.precision"] == "half"
        value_words = -(-channels // 2) if is_half else channels
        record_words = 6 if self.by_counter else 4
        common = {
            "READ_COUNTER": settings["memo.read"] == "counter",
            "EVICTION": SETTINGS["memo.eviction"].choices.index(settings["memo.eviction"]),
            "HALF": is_half,
            "VALUE_WORDS": value_words,
            "RECORD_WORDS": record_words,
            "TILED": self.kind == "tile",
            **self.scene.defines,
        }
        if self.kind == "tile":
            return common | tile_defines(settings, record_words, value_words)
        return common | {"SNAP": settings["memo.snap"], "RECORD_STRIDE": (record_words + value_words + 1) // 2 * 2}

    @property
    def generated(self) -> dict[str, str]:
        """The graphs' source."""
        return {"graph/generated.cl": self.scene.graph_source}


def _reads(scene: SceneResources) -> np.ndarray:
    """What each graph reads, in the bits of memo_mode."""
    reads = [("uv" in g.reads) * READS_UV | ("position" in g.reads) * READS_POSITION for g in scene.graphs]
    return np.array(reads, np.uint32)


def _why_not(reads: frozenset[str], kind: str) -> str:
    """Why a graph that reads this is never memoized; nothing if it may be."""
    if "normal" in reads:
        return "it reads the normal, which is not part of keys"
    if kind == "tile" and "position" in reads:
        return "it reads the position, and tiles have two dimensions"
    return ""


def graph_buffers(setup: GraphSetup, n: int, has_lists: bool = False) -> list[Buffer]:
    """The values of so many places, those of lists of samples if there are any, and with memoization where each is to be found, and the
    table."""
    scene, graphs = setup.scene, len(setup.scene.graphs)
    if not graphs:
        return []
    names = (VALUES, *_OF_LISTS) if has_lists else (VALUES,)
    values = [Buffer(name, (scene.graph_channels, n)) for name in names]
    if setup.kind == "off":
        return values
    return [
        *values,
        Buffer("memo_place", (n,), "u4"),
        Buffer("memo_check", (n,), "u4"),
        Buffer("memo_records", (setup.capacity, setup.defines["RECORD_STRIDE"]), "u4", persistent=True),
        Buffer("memo_mode", (graphs,), "u4", persistent=True),
        Buffer("memo_known", (graphs, KNOWN_COLUMNS), "f8", persistent=True),
        Buffer("memo_counters", (len(COUNTERS),), "u4", persistent=True),
        Buffer("memo_graph_count", (graphs, 2), "u4", persistent=True),
        *([Buffer("memo_clock", (1,), "u8", persistent=True)] if setup.by_counter else []),
        *(tile_buffers(setup.settings, scene.graph_channels, setup.capacity, n) if setup.kind == "tile" else []),
    ]


def memo_names(setup: GraphSetup) -> tuple[str, ...]:
    """The buffers that outlive a frame: they depend on the scene alone, and not on where it is seen from."""
    return tuple(b.name for b in graph_buffers(setup, 1) if b.persistent)


def values_as(arrays: Mapping[str, cl_array.Array], *buffer: str) -> Mapping[str, cl_array.Array]:
    """The arrays, with one of them as the values that kernels take; without such values, if it is not named."""
    return ChainMap({VALUES: arrays[buffer[0]] if buffer else None}, arrays)


class BeginMemo(Pass):
    """Count anew; before the first frame, decide what is memoized."""

    name = "memo"

    def __init__(self, setup: GraphSetup):
        self._setup = setup
        self.reads = self.writes = memo_names(setup)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One small write."""
        self._setup.memo.begin(arrays)
        counters, occupied = arrays["memo_counters"], COUNTERS.index("occupied")
        fresh = np.zeros(len(COUNTERS), np.uint32)
        fresh[occupied], fresh[COUNTERS.index("capacity")] = counters.get()[occupied], self._setup.capacity
        counters.set(fresh)
        return ()


class ThinOut(Pass):
    """The camera's rays of a pre-pass."""

    name = "prepass"
    reads = ("pixel", "ray_length")
    writes = ("ray_length",)

    def __init__(self, setup: GraphSetup, width: int):
        self._kernel = setup.device.program("memo/prepass.cl")["thin_out"]
        self._scalars = {"width": width, "spacing": setup.spacing}

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each path."""
        n = arrays["ray_length"].size
        yield self._kernel.run(n, arrays, n=n, **self._scalars)


class Materials(Pass):
    """The values of the hits in the queue. is_primary: whether they are the eye's own. values: the buffer that gets them. light_only:
    of graphs that emit light alone."""

    name = "materials"

    def __init__(self, setup: GraphSetup, is_primary: bool, values: str = VALUES, light_only: bool = False):
        self._setup, self._values, self._light_only = setup, values, int(light_only)
        self._evaluate = setup.device.program("memo/evaluate.cl", setup.generated, **setup.scene.defines)["evaluate"]
        self._look_up = MemoLookUp(setup) if setup.memo and (setup.settings["memo.primary"] or not is_primary) else None
        own = [b.name for b in graph_buffers(setup, 1) if b.name not in (VALUES, "memo_mode")] if self._look_up else []
        self.reads = (*_QUEUE, *(memo_names(setup) if self._look_up else ()))
        self.writes, self.results = (values, *own), (values,)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Place by place, or run by run."""
        yield from self.run_first(arrays, state, arrays["ray_length"].size)

    def run_first(self, arrays, state, places: int) -> Iterable[cl.Event | None]:
        """Of so many of the queue's first places."""
        arrays = values_as(arrays, self._values)
        if self._look_up and self._setup.memo.memoizes:
            yield from self._look_up.run(arrays, state, places, self._light_only)
        else:
            scalars = {"n": arrays["ray_length"].size, "light_only": self._light_only}
            yield self._evaluate.run(places, arrays, self._setup.scene.arrays, memo_place=None, **scalars)


class MemoLookUp:
    """Find the values of a queue's hits in the cache, and evaluate and insert those that are not there."""

    def __init__(self, setup: GraphSetup):
        self._setup = setup
        tiles = {name: value for name, value in setup.defines.items() if name in _KEY_DEFINES}
        self._address = setup.device.program("memo/address.cl", **tiles, **setup.scene.defines)["address"]
        self._tiles = TileLookUp(setup) if setup.kind == "tile" else None
        if not self._tiles:
            program = setup.device.program("memo/texel.cl", setup.generated, **setup.defines)
            self._texels = program["look_up_texels"]

    def run(
        self, arrays: Mapping[str, cl_array.Array], state, places: int, light_only: int = 0
    ) -> Iterable[cl.Event | None]:
        """Where to look, place by place; then run by run. places: of the queue, from the first on."""
        setup = self._setup
        n, bias, scene = arrays["ray_length"].size, setup.settings["memo.bias"], setup.scene.arrays
        asked = {"n": n, "bias": bias, "light_only": light_only}
        yield self._address.run(places, arrays, scene, places=setup.places, **asked)
        scalars = asked | {"capacity": setup.capacity, "probe": setup.probe, "stamp": stamp(state)}
        turns = setup.turns
        for turn in range(turns):
            scalars |= {"turn": turn, "turns": turns}
            if self._tiles:
                yield from self._tiles.run(arrays, scalars, places)
            else:
                yield self._texels.run(-(-places // _RUN), arrays, scene, **scalars)


def _measure(setup: GraphSetup, arrays: Mapping[str, cl_array.Array]) -> list[Costs]:
    """What each graph costs, by hits anywhere on the surfaces that have it: as many as take about _BUDGET to evaluate if all
    miss. The table is empty before and after."""
    scene, n = setup.scene, _MOST_MEASURED
    evaluate = setup.device.program("memo/evaluate.cl", setup.generated, **scene.defines)["evaluate"]
    look_up, state = MemoLookUp(setup), _Before()
    may = np.array([not _why_not(g.reads, setup.kind) for g in scene.graphs])
    arrays["memo_mode"].set(np.where(may, _reads(scene) | IS_MEMOIZED, _reads(scene)).astype(np.uint32))
    own = {b.name: setup.device.empty(b.shape, b.dtype, b.name) for b in graph_buffers(setup, n) if not b.persistent}
    table = {name: arrays[name] for name in memo_names(setup)}
    rays = {name: setup.device.upload(values, name) for name, values in _some_rays().items()}

    def evaluated(known: Mapping[str, cl_array.Array], hits: int) -> float:
        known["alive"].set(np.full(1, hits, np.uint32))
        return _timed([evaluate.run(hits, known, scene.arrays, memo_place=None, n=n, light_only=0)])

    def looked_up(known: Mapping[str, cl_array.Array], hits: int) -> float:
        known["alive"].set(np.full(1, hits, np.uint32))
        return _timed(look_up.run(known, state, hits))

    costs, built = [], tile_texels(setup.settings) if setup.kind == "tile" else 1
    for triangles in scene.graph_triangles():
        uploaded = {name: setup.device.upload(values, name) for name, values in _some_hits(scene, triangles).items()}
        known = rays | own | table | uploaded
        first = min(evaluated(known, _LEAST_MEASURED) for _ in range(2))
        hits = int(np.clip(_BUDGET / (first * built) * _LEAST_MEASURED, _LEAST_MEASURED, _MOST_MEASURED))
        misses = -int(arrays["memo_counters"].get()[COUNTERS.index("built")])
        seconds = [min(evaluated(known, hits) for _ in range(2)), looked_up(known, hits)]
        misses += int(arrays["memo_counters"].get()[COUNTERS.index("built")])
        seconds.append(min(looked_up(known, hits) for _ in range(2)))
        known["alive"].set(np.zeros(1, np.uint32))  # what launches take without any hit
        launches = [
            _timed([evaluate.run(hits, known, scene.arrays, memo_place=None, n=n, light_only=0)]),
            *2 * (_timed(look_up.run(known, state, hits)),),
        ]
        evaluation, asked, hit = (
            max(s - e, _LEAST_SECONDS * hits) / hits for s, e in zip(seconds, launches, strict=True)
        )
        missed = (asked - hit) * hits / max(misses, 1)  # hits of the same texel or tile after each other miss once
        costs.append(Costs(evaluation, hit, missed - built * evaluation, built))
        setup.device.release(*uploaded.values())
    setup.device.release(*own.values(), *rays.values())
    for name in ("memo_records", "memo_counters", "memo_graph_count", "memo_clock"):
        if name in table:
            fill(table[name], 0)
    return costs


@dataclass(frozen=True)
class _Before:
    """The state of a run before the first."""

    update: int = -1
    eye: int = 0


def _timed(events: Iterable[cl.Event | None]) -> float:
    launched = [event for event in events if event is not None]
    for event in launched:
        event.wait()
    return sum(event_seconds(event) for event in launched)


def _some_rays() -> dict[str, np.ndarray]:
    """A queue of rays from all sides that hit triangles anywhere, one metre from where they begin."""
    rng, n = np.random.default_rng(1), _MOST_MEASURED
    u, v = rng.random((2, n))
    direction = rng.normal(size=(3, n))
    return {
        "alive": np.full(1, n, np.uint32),
        "hit_t": np.ones(n, np.float32),
        "hit_uv": np.where(u + v > 1, [1 - u, 1 - v], [u, v]).astype(np.float32),
        "ray_direction": (direction / np.linalg.norm(direction, axis=0)).astype(np.float32),
        "ray_length": np.full(n, np.inf, np.float32),
    }


def _some_hits(scene: SceneResources, triangles: np.ndarray) -> dict[str, np.ndarray]:
    """What such rays hit: some of the triangles, with cones that are some thousandths of the first one's mesh wide. triangles: (k, 2),
    as of `graph_triangles`."""
    n, is_shown = _MOST_MEASURED, len(triangles) > 0
    chosen = triangles if is_shown else np.full((1, 2), NONE)
    instance, primitive = chosen[np.random.default_rng(2).integers(len(chosen), size=n)].T
    width = scene.instance_size(triangles[0, 0]) / 500 if is_shown else 0.0
    return {
        "hit_primitive": np.ascontiguousarray(primitive, np.uint32),
        "hit_instance": np.ascontiguousarray(instance, np.uint32),
        "cone": np.stack([np.zeros(n), np.full(n, width)]).astype(np.float32),
    }
