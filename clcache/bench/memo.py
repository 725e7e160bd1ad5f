"""The memoization of material graphs (`cl/memo/`): lookups, insertions and builds by variant; what each graph of a scene costs; and
whether memoization pays as much as Eq. 2.17 of MaterialMemo says.

The variants are measured on a graph that costs next to nothing, and on hits of which each has a texel of its own: in the order of the
image, where neighbours share tiles, or shuffled, as after many bounces. Insertions find nothing in an empty table; replacements find
nothing in a full one, as whenever more is seen than there is room for. What the device cannot do is left out.

From them follows what evaluating a graph must cost at the least for memoization to pay, at some hit rates. Costs are for a million of
lookups. Frames are those of a scene's own motion, without memoization, with one of texels and with one of tiles, of all graphs, in turn;
"by Eq. 2.17" is what the time for materials would be by the frames' lookups and hits, T_f as it is without memoization, and T_r and T_w
of the variants. What each graph's evaluation costs is what `memo.auto` decides by (`clcache/memo.py`).
"""

import math
import statistics
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from ..device import Device, fill
from ..errors import SettingError
from ..frame import FrameGraph
from ..memo import Costs
from ..passes.materials import COUNTERS, VALUES, BeginMemo, GraphSetup, Materials, graph_buffers
from ..passes.tiles import tile_texels
from ..passes.trace import BLOCK, HITS, ray_buffers
from ..renderer import Renderer
from ..resources import SceneResources
from ..scene import load_scene
from ..scene.model import Scene
from ..settings import SETTINGS, resolve
from .cached import FILLED, measured_frames
from .job import Job
from .result import Result

FAMILY = "memo"
HIT_RATES = (0.5, 0.9, 0.99, 0.999)
OCTAVES = (1, 4, 16)  # of the noise of the own scene's graphs
ROOM, FULL = 4, 1 / 8  # texels for each that is asked for, of a table that holds all, and of one that is always full
QUEUE = ("alive", *HITS, "ray_direction", "ray_length", "cone")  # what materials are found by
KINDS = ("texel", "tile")
MILLION = 1_000_000  # lookups that costs are given for: milliseconds are then nanoseconds for each


def _others(setting: str) -> list[str]:
    """The values of a setting that are not its default."""
    return [value for value in SETTINGS[setting].choices if value != SETTINGS[setting].default]


_BOTH = ("memo.eviction", "memo.read", "memo.precision")
_OF_TILES = ("memo.precision", "memo.builder", "memo.layout", "memo.tile", "memo.filter")
VARIANTS: Mapping[str, tuple[str, dict[str, object]]] = {
    "texel": ("texel", {}),
    **{f"texel {value}": ("texel", {key: value}) for key in _BOTH for value in _others(key)},
    "texel unsnapped": ("texel", {"memo.snap": False}),
    "tile": ("tile", {}),
    **{f"tile {value}": ("tile", {key: value}) for key in _OF_TILES for value in _others(key)},
}

# Squares side by side, each with a graph of its own; the first one's costs next to nothing.
_SCENE = """
[camera]
fov_y = 50
keys = [
  { time = 0.0, position = [0.0, 0.0, 3.0], look_at = [0.0, 0.0, 0.0] },
  { time = 100.0, position = [20.0, 0.0, 3.0], look_at = [20.0, 0.0, 0.0] },
]
[environment]
color = [1.0, 1.0, 1.0]
[render]
frames = [0, 3000]
fps = 30
"""
_SQUARE = """
[materials.m{0}]
graph = "g{0}.graph"
[meshes.square{0}]
generator = "plane"
size = [2.0, 2.0]
[[instances]]
mesh = "square{0}"
material = "m{0}"
translation = [{1}, 0.0, 0.0]
rotation = {{ axis = [1.0, 0.0, 0.0], degrees = 90.0 }}
"""
_CHEAP = """
UVInput Out>0;
Separate2 In<0 X>1 Y>2;
Combine3 X<1 Y<2 Z<2 Out>3;
ColorOutput In<3;
"""
_NOISE = """
UVInput Out>0;
Float2Constant 40.0 40.0 Out>1;
Mul A<0 B<1 Out>2;
Float1Constant 2.0 Out>3;
Float1Constant 0.5 Out>4;
SimplexFractal2D {} UV<2 Lacunarity<3 Diminish<4 Out>5;
Add A<4 B<5 Out>6;
Combine3 X<6 Y<4 Z<6 Out>7;
ColorOutput In<7;
"""


def memo(job: Job) -> Iterator[Result]:
    """Seconds of lookups by variant, on a scene of its own; then of the graphs and frames of those scenes that have any. Raises
    SettingError where one has fewer frames than are to be measured."""
    device = Device(job.device, job.threads)
    with tempfile.TemporaryDirectory() as folder:
        own = load_scene(_write_scene(Path(folder)))
    resources, costs = SceneResources(device, own), {}
    for name, (kind, changes) in VARIANTS.items():
        found = _of_variant(job, resources, device, own, kind, changes)
        n = job.size[0] * job.size[1]
        yield from (Result(FAMILY, f"{name}, {what}", "", n, "lookups", tuple(s)) for what, s in found.seconds.items())
        if name in KINDS:
            costs[name] = _costs(found, n)
            yield from _break_even(name, costs[name])
    for name, scene in job.loaded() if job.scenes else [("noise", own)]:
        if any(m.graph for m in scene.materials):
            yield from _of_scene(job, name, scene, costs)


def _write_scene(folder: Path) -> Path:
    """A scene of squares with graphs of growing cost; returns its file."""
    graphs = [_CHEAP, *(_NOISE.format(octaves) for octaves in OCTAVES)]
    for number, text in enumerate(graphs):
        (folder / f"g{number}.graph").write_text(text, encoding="utf-8")
    squares = (_SQUARE.format(number, 2.0 * number - len(graphs) + 1) for number in range(len(graphs)))
    file = folder / "noise.toml"
    file.write_text(_SCENE + "".join(squares), encoding="utf-8")
    return file


# ---------------------------------------------------------------------------------------------------------------------
# Variants


class Cache:
    """A cache, empty at first, and the passes that look hits up in it. settings: of `memo`. n: hits in a queue. Raises SettingError where
    the device has no such cache."""

    def __init__(self, resources: SceneResources, device: Device, kind: str, settings: Mapping[str, object], n: int):
        setup = GraphSetup.of(device, resources, resolve({}, {"memo.auto": False, **settings}), kind)
        self._device, self._turns = device, 0
        self._queue = {b.name: device.empty(b.shape, b.dtype, b.name) for b in ray_buffers(n) if b.name in QUEUE}
        passes, buffers = [BeginMemo(setup), Materials(setup, is_primary=True)], graph_buffers(setup, n)
        self._graph = FrameGraph(device, passes, buffers, {VALUES, "memo_counters"}, self._queue)

    def look_up(self, hits: Mapping[str, np.ndarray]) -> float:
        """Seconds of looking hits up, and inserting those that are not there. hits: what the arrays of QUEUE hold."""
        for name, values in hits.items():
            self._queue[name].set(values)
        self._turns += 1
        return self._graph.run(SimpleNamespace(update=self._turns, eye=0))[Materials.name]

    def counters(self) -> dict[str, int]:
        """What was counted of the last lookups, by name of COUNTERS."""
        return dict(zip(COUNTERS, self._graph.of()["memo_counters"].get().tolist(), strict=True))

    def values(self) -> np.ndarray:
        """(GRAPH_CHANNELS, n): what the last lookups gave."""
        return self._graph.of()[VALUES].get()

    def empty(self) -> None:
        """Forget all entries."""
        for name in ("memo_records", "memo_counters"):
            fill(self._graph.of()[name], 0)

    def release(self) -> None:
        """Give back all arrays."""
        self._graph.release()
        self._device.release(*self._queue.values())


def hits_of_square(scene: Scene, size: tuple[int, int], finer: int = 0) -> dict[str, np.ndarray]:
    """A queue of hits on a scene's first instance, a square, each with a texel of its own; blocks of four by four pixels one after the
    other, as paths are. finer: levels that the footprints are smaller by."""
    mesh = scene.meshes[scene.instances[0].mesh]
    width, height = size
    texel = 2.0 ** -np.ceil(np.log2(max(size) + 1))
    columns, rows = np.meshgrid(np.arange(width) + 1, np.arange(height) + 1)
    uvs = np.stack([columns, rows], axis=-1) * texel
    uvs = uvs.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, 2).swapaxes(1, 2).reshape(-1, 2)
    inside = [_barycentric(mesh.uvs[corners], uvs) for corners in mesh.triangles]
    primitive = np.argmax([np.minimum(b.min(axis=1), 1 - b.sum(axis=1)) for b in inside], axis=0)
    hit_uv = np.choose(primitive[:, None], inside)
    a, b, c = mesh.positions[mesh.triangles[0]]
    metres = np.sqrt(np.linalg.norm(np.cross(b - a, c - a)) / _area(mesh.uvs[mesh.triangles[0]]))
    down = scene.instances[0].transform[:, :3] @ np.cross(a - b, c - a)
    n = len(uvs)
    return {
        "alive": np.full(_alive(n), n, np.uint32),
        "hit_t": np.ones(n, np.float32),
        "hit_uv": np.ascontiguousarray(hit_uv.T, np.float32),
        "hit_primitive": primitive.astype(np.uint32),
        "hit_instance": np.zeros(n, np.uint32),
        "ray_direction": np.repeat((down / np.linalg.norm(down))[:, None], n, axis=1).astype(np.float32),
        "ray_length": np.full(n, np.inf, np.float32),
        "cone": np.stack([np.full(n, texel * metres * 0.5**finer), np.zeros(n)]).astype(np.float32),
    }


def shuffled(hits: Mapping[str, np.ndarray], order: np.ndarray) -> dict[str, np.ndarray]:
    """The same hits in another order."""
    return {name: v if name == "alive" else np.ascontiguousarray(v[..., order]) for name, v in hits.items()}


def _barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.linalg.solve((corners[1:] - corners[0]).T.astype(float), (points - corners[0]).T).T


def _area(corners: np.ndarray) -> float:
    return abs(float(np.linalg.det((corners[1:] - corners[0]).astype(float))))


def _alive(n: int) -> tuple[int, ...]:
    return next(b.shape for b in ray_buffers(n) if b.name == "alive")


@dataclass(frozen=True)
class Found:
    """What was measured of a variant. seconds: of each run, by what was done; nothing where the device cannot do it. built: values that were
    computed for the insertions, in so many entries."""

    seconds: Mapping[str, list[float]]
    built: int = 0
    entries: int = 0


def _of_variant(
    job: Job, resources: SceneResources, device: Device, scene: Scene, kind: str, changes: Mapping[str, object]
) -> Found:
    n = job.size[0] * job.size[1]
    per_entry = tile_texels(resolve({}, changes)) if kind == "tile" else 1
    try:
        cache = Cache(resources, device, kind, {**changes, "memo.capacity": math.ceil(ROOM * n / per_entry)}, n)
    except SettingError:
        return Found({})
    hits, finer = hits_of_square(scene, job.size), hits_of_square(scene, job.size, finer=1)
    mixed = shuffled(hits, np.random.default_rng(1).permutation(n))
    turns, seconds = range(job.repeats + 1), {}
    for _ in turns:
        cache.empty()
        seconds.setdefault("insertions", []).append(cache.look_up(hits))
    entries = cache.counters()["inserted"]
    seconds["hits in order"] = [cache.look_up(hits) for _ in turns]
    seconds["hits shuffled"] = [cache.look_up(mixed) for _ in turns]
    cache.release()
    cache = Cache(resources, device, kind, {**changes, "memo.capacity": math.ceil(FULL * n / per_entry)}, n)
    cache.look_up(finer)
    seconds["replacements"] = [cache.look_up((hits, finer)[turn % 2]) for turn in turns]
    cache.release()
    return Found({what: times[1:] for what, times in seconds.items()}, entries * per_entry, entries)


def _costs(found: Found, n: int) -> list[Costs]:
    """T_r, and T_w of an entry with what evaluating next to nothing takes, of each run; T_f is left open."""
    runs = zip(found.seconds["hits in order"], found.seconds["insertions"], strict=True)
    built = found.built // found.entries
    return [Costs(math.nan, hits / n, max(inserted - hits, 0.0) / found.entries, built) for hits, inserted in runs]


def _break_even(kind: str, costs: list[Costs]) -> Iterator[Result]:
    yield _cost(f"{kind}, lookup", "", [c.look_up for c in costs])
    yield _cost(f"{kind}, insertion", "", [c.insert for c in costs])
    for rate in HIT_RATES:
        least = [break_even_cost(c.look_up, c.insert, c.built, rate) for c in costs]
        if np.isfinite(least).all():
            yield _cost(f"{kind}, break-even at {rate:.1%} hits", "", least)


# ---------------------------------------------------------------------------------------------------------------------
# Scenes


def _of_scene(job: Job, name: str, scene: Scene, costs: Mapping[str, list[Costs]]) -> Iterator[Result]:
    first, last = measured_frames(scene, job.repeats)
    options = {"size": job.size, "stereo": False, "spp": 1, "seed": 1, "device": job.device, "threads": job.threads}
    options |= {"temporal": "none", "settings": {"memo.auto": False}}
    running = [Renderer(scene, "pathtrace", memo=kind, **options).frames(first, last) for kind in ("off", *KINDS)]
    turns = [tuple(frame.stats for frame in turn) for turn in zip(*running, strict=True)][FILLED:]
    pixels = job.size[0] * job.size[1]
    for kind, own in zip(("off", *KINDS), zip(*turns, strict=True), strict=True):
        yield Result(FAMILY, f"{kind}, whole frame", name, pixels, "pixels", tuple(f["seconds"] for f in own))
        yield Result(FAMILY, f"{kind}, materials", name, pixels, "pixels", tuple(map(_materials, own)))
        if kind in costs:
            counted = [
                (_materials(turn[0]), frame["eyes"]["mono"]["memo"]) for turn, frame in zip(turns, own, strict=True)
            ]
            seconds = tuple(expected(off, c["lookups"], c["hits"], costs[kind]) for off, c in counted)
            yield Result(FAMILY, f"{kind}, materials by Eq. 2.17", name, pixels, "pixels", seconds)
    measuring = Renderer(scene, "pathtrace", memo="texel", **{**options, "settings": {"memo.auto": True}})
    next(measuring.frames(first, first + 1))
    for graph in measuring.stats()["memo"]["materials"]:
        yield _cost(f"evaluation of {graph['materials'][0]}", name, [1e-9 * graph["evaluate_ns"]])


def _materials(frame: Mapping) -> float:
    return frame["eyes"]["mono"]["passes"][Materials.name]


def expected(off: float, lookups: int, hits: int, costs: list[Costs]) -> float:
    """Seconds that so many lookups take by Eq. 2.17, where evaluating all of them takes `off`: medians over the costs."""
    if not lookups:
        return off
    own = [replace(c, evaluate=off / lookups) for c in costs]
    return statistics.median(off * c.ratio(hits / lookups) for c in own)


def break_even_cost(look_up: float, insert: float, built: int, hit_rate: float) -> float:
    """The T_f at which Eq. 2.17 gives 1, where a lookup that misses evaluates the graph `built` times; infinite where misses take all that
    hits save."""
    saved = 1 - built * (1 - hit_rate)
    return (look_up + insert * (1 - hit_rate)) / saved if saved > 0 else np.inf


def _cost(name: str, scene: str, seconds: list[float]) -> Result:
    return Result(FAMILY, name, scene, MILLION, "lookups", tuple(MILLION * s for s in seconds))
