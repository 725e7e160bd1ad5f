"""Light of the diffuse surfaces in an octree of cells, and images from it (OctreeCache, sections 3.2-3.4; `cl/octree/`).

Two waves of paths. Those that fill the cache give each of their first vertices the light of the next ones (`caching_passes`); those that
read it begin at the camera and go on by specular and glossy parts alone, and each of their vertices is a layer of the image
(`layer_passes`). Where no cell answers, paths of the first kind do (`miss_passes`).
"""

from collections import ChainMap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl

from ..device import Device, fill
from ..frame import Buffer, Pass, Repeat
from ..octree import Octree
from ..resources import SceneResources
from ..scene.geometry import Geometry
from .materials import VALUES, GraphSetup, Materials, values_as
from .octree_update import COUNTERS, NO_VERTEX
from .shade import Compact
from .trace import CHUNK, HITS, Generate, Shadow, Trace, TraceCamera, path_count

_SHADOW_RAY = ("shadow_origin", "shadow_direction", "shadow_length", "shadow_radiance")
_RUN = 64  # places that one work-item goes through, as in cl/octree/look_up.cl
_ESTIMATE_WORDS = 19  # as in cl/octree/estimate.cl
_LEAST_PART = 1 / 64  # of the pixels along an edge for which there are caching paths, however little time there is
# What a layer is, by the names that kernels have for it: (3, pixels), or (pixels,).
LAYER_VECTORS = ("light", "albedo", "emitted", "own", "pass", "normal")
LAYER_NUMBERS = ("depth", "segment", "roughness", "count")


@dataclass(frozen=True)
class OctreeSetup:
    """What the passes have in common. settings: all, by dotted name. layers: how many an image has."""

    device: Device
    scene: SceneResources
    size: tuple[int, int]
    settings: Mapping[str, bool | int | float | str]
    octree: Octree
    graphs: GraphSetup

    @property
    def pixels(self) -> int:
        """Of the image."""
        return self.size[0] * self.size[1]

    @property
    def paths(self) -> int:
        """Places of the queue."""
        return path_count(self.size)

    @property
    def layers(self) -> int:
        """Vertices of a path that reads the cache: where nothing but diffuse surfaces can be hit there is one."""
        return self.settings["pathtrace.bounces"] + 1 if self.scene.features["HAS_SPECULAR"] else 1

    @property
    def length(self) -> int:
        """Bounces behind a vertex whose light is kept (l_len)."""
        length = self.settings["octree.length"]
        return self.settings["pathtrace.bounces"] if length < 0 else length

    @property
    def sobol(self) -> bool:
        """Whether sample points are of a Sobol sequence."""
        return self.settings["pathtrace.sampler"] == "sobol"

    @property
    def gathers_hits(self) -> bool:
        """Whether there is light to be found by rays."""
        return self.scene.features["HAS_EMISSION"]


@dataclass(frozen=True)
class Vertices:
    """Which buffers have the vertices whose light is kept. stored: how many of a path. stream: the buffer that says whose random numbers
    a path takes."""

    prefix: str
    stored: int
    stream: str

    @property
    def names(self) -> dict[str, str]:
        """The buffers, by the kernels' names."""
        return {name: f"{self.prefix}_{name.removeprefix('vertex_')}" for name in _VERTEX}

    def arrays(self, arrays: Mapping) -> Mapping:
        """The arrays, by the kernels' names."""
        known = {kernel: arrays[buffer] for kernel, buffer in self.names.items()}
        return ChainMap(known | {"pixel": arrays[self.stream]}, arrays)

    def buffers(self, paths: int) -> list[Buffer]:
        """Of so many paths."""
        n, names = self.stored * paths, self.names
        return [
            Buffer(names["vertex_key"], (n,), np.uint64),
            Buffer(names["vertex_normal"], (n,), np.uint32),
            Buffer(names["vertex_light"], (3, n)),
            Buffer(names["carried"], (3, n)),
        ]


_VERTEX = ("vertex_key", "vertex_normal", "vertex_light", "carried")
MISSES = Vertices("miss", 1, "miss_stream")


def cached_vertices(setup: OctreeSetup) -> Vertices:
    """Those that go to cells (l_store)."""
    return Vertices("vertex", setup.settings["octree.store"], "caching_pixel")


def stage(prefix: str, passes: Iterable[Pass]) -> list[Pass]:
    """The passes, with names that say which stage of an update they are of."""
    named = list(passes)
    for p in named:
        p.name = f"{prefix}.{p.name}"
        if isinstance(p, Repeat):
            stage(prefix, p.passes)
    return named


class Pace:
    """How many caching paths there are along the image's edges, as part of its pixels: as the setting says while the camera rests, and while it
    moves at most so many that an update takes no longer than `octree.frame_time` (HashCache, section 4.2)."""

    def __init__(self, settings: Mapping[str, bool | int | float | str]):
        self._most, self._seconds = settings["octree.caching_resolution"], settings["octree.frame_time"] / 1000
        self._moving = self._most

    def part(self, is_moving: bool) -> float:
        """Of the next update."""
        return self._moving if is_moving and self._seconds else self._most

    def observe(self, passes: Mapping[str, float], is_moving: bool) -> None:
        """Learn from an update. passes: seconds by pass. Caching takes time in proportion to its paths; what else there is, stays."""
        caching = sum(seconds for name, seconds in passes.items() if name.startswith("caching."))
        if not self._seconds or not caching:
            return
        room = max(self._seconds - (sum(passes.values()) - caching), 0.0)
        part = self.part(is_moving) * (room / caching) ** 0.5
        self._moving = min(max(part, _LEAST_PART), self._most)


def caching_size(size: tuple[int, int], part: float) -> tuple[int, int]:
    """Width and height of the image of caching paths."""
    return tuple(max(round(length * part), 1) for length in size)


def octree_buffers(setup: OctreeSetup) -> list[Buffer]:
    """What the passes of this module work with."""
    pixels, n, capacity = setup.pixels, setup.paths, setup.layers * setup.paths
    layers = range(setup.layers)
    return [
        Buffer("caching_pixel", (n,), np.uint32, persistent=True),
        Buffer("found", (3, n)),
        Buffer("step", (3, n)),
        Buffer("step_diffuse", (n,)),
        Buffer("shadow_light", (3, n)),
        *cached_vertices(setup).buffers(n),
        *MISSES.buffers(n),
        Buffer("miss_stream", (n,), np.uint32),
        Buffer("misses", (1,), np.uint32),
        Buffer("miss_uv", (2, capacity)),
        Buffer("miss_primitive", (capacity,), np.uint32),
        Buffer("miss_instance", (capacity,), np.uint32),
        Buffer("miss_t", (capacity,)),
        Buffer("miss_direction", (3, capacity)),
        Buffer("miss_cone", (2, capacity)),
        Buffer("miss_target", (capacity,), np.uint32),
        Buffer("asked_key", (2, n), np.uint64),
        Buffer("asked_level", (n,), np.uint32),
        Buffer("asked_normal", (n,), np.uint32),
        Buffer("asked_direction", (3, n)),
        Buffer("asked_cone", (2, n)),
        Buffer("answer_cell", (pixels,), np.uint32),
        Buffer("answer_level", (pixels,), np.uint32),
        *(Buffer(f"layer{i}_{name}", (3, pixels)) for i in layers for name in LAYER_VECTORS),
        *(Buffer(f"layer{i}_{name}", (pixels,)) for i in layers for name in LAYER_NUMBERS),
        Buffer("color", (pixels, 3), persistent=True, per_eye=True),
        Buffer("estimate_of", (_ESTIMATE_WORDS,), np.uint32, persistent=True, per_eye=True),
        Buffer("aov_voxel", (pixels, 3)),
        Buffer("aov_level", (pixels,)),
        Buffer("aov_count", (pixels,)),
        Buffer("counters", (len(COUNTERS),), np.uint32),
    ]


# ---------------------------------------------------------------------------------------------------------------------
# The beginning of an update


class BeginUpdate(Pass):
    """Count anew; and forget all light where anything has moved that it depends on."""

    name = "begin"
    reads = ("octree_wipe",)
    writes = ("octree_wipe", "counters", "misses")

    def __init__(self, setup: OctreeSetup):
        self._scene, self._octree = setup.scene, setup.octree

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Small writes."""
        known, lighting = arrays["octree_wipe"].get(), self._scene.lighting
        stamp, occupied = int(known[0]), int(known[3])
        if stamp == 0 or (known[1:3] != lighting).any():
            stamp, occupied = stamp % (2**32 - 1) + 1, 0
            arrays["octree_wipe"].set(np.array([stamp, *lighting, 0], np.uint32))
        counts = dict.fromkeys(COUNTERS, 0) | {"occupied": occupied, "capacity": self._octree.cells}
        arrays["counters"].set(np.array(list(counts.values()), np.uint32))
        yield fill(arrays["misses"], 0)


# ---------------------------------------------------------------------------------------------------------------------
# Paths that gather light for their vertices


class _VertexPass(Pass):
    """A kernel of cache.cl, one work-item for each place in the queue."""

    def __init__(self, setup: OctreeSetup, vertices: Vertices, kernel: str, values: str | None = None):
        self._scene, self._vertices, features = setup.scene, vertices, setup.scene.features
        defines = {"STORE": vertices.stored, "SOBOL": setup.sobol, **setup.scene.defines}
        self._kernel = setup.device.program("octree/cache.cl", **defines)[kernel]
        self._cone = ("cone",) if features["HAS_TEXTURES"] else ()
        self._density = ("density",) if features["HAS_EMISSION"] else ()
        self._shadow = (*_SHADOW_RAY, "shadow_light") if features["HAS_DIRECT"] else ()
        self._values = (values,) if values and features["HAS_GRAPHS"] else ()

    def _launch(self, arrays, **scalars) -> cl.Event | None:
        n = arrays["ray_length"].size
        arrays = values_as(self._vertices.arrays(arrays), *self._values)
        known = {"n": n, "stored": n * self._vertices.stored, "environment": self._scene.environment}
        return self._kernel.run(n, arrays, self._scene.arrays, **(known | scalars))


class ClearVertices(Pass):
    """No vertex has been met yet, and no shadow ray is on its way."""

    name = "clear"

    def __init__(self, setup: OctreeSetup, vertices: Vertices):
        self._key = vertices.names["vertex_key"]
        self.writes = (self._key, *(("shadow_length",) if setup.scene.features["HAS_DIRECT"] else ()))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Set every key to that of none, and lengths to 0."""
        yield fill(arrays[self._key], NO_VERTEX)
        for name in self.writes[1:]:
            yield fill(arrays[name], 0)


class ShadeVertex(_VertexPass):
    """One vertex of the paths: which cell it belongs to, shadow rays, and the next rays. vertex: its number."""

    name = "shade"

    def __init__(self, setup: OctreeSetup, vertices: Vertices, vertex: int, is_last: bool):
        super().__init__(setup, vertices, "shade_vertex", VALUES)
        names, roulette = vertices.names, setup.settings["pathtrace.roulette"]
        self._place = {"vertex": vertex, "roulette": roulette, "is_last": int(is_last), "shape": setup.octree.shape}
        self._place["emitters"] = setup.scene.emitter_count
        path = ("ray_length", "ray_counts", *self._density, *self._cone)
        kept = (names["vertex_key"], names["vertex_normal"])
        self.reads = (vertices.stream, "path", "alive", *HITS, *self._values, "ray_direction", *path)
        self.writes = ("ray_origin", "ray_direction", *path, *self._shadow, "found", "step", "step_diffuse", *kept)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One vertex of each path."""
        yield self._launch(arrays, **self._place, **state.sampling)


class FindLast(_VertexPass):
    """What the last rays found."""

    name = "finish"

    def __init__(self, setup: OctreeSetup, vertices: Vertices, values: str | None):
        super().__init__(setup, vertices, "find_last", values)
        shadow = ("shadow_length",) if self._shadow else ()
        self.reads = ("alive", *HITS, *self._values, "ray_direction", "ray_length", *self._density, *self._cone)
        self.writes = ("found", *shadow)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Of each path."""
        yield self._launch(arrays)


class Settle(_VertexPass):
    """What a vertex brings to itself and to those before it (Eq. 1). length: bounces behind a vertex."""

    name = "settle"

    def __init__(self, setup: OctreeSetup, vertices: Vertices, vertex: int, length: int):
        super().__init__(setup, vertices, "settle")
        before = ((to, vertex - to) for to in range(min(vertex + 1, vertices.stored)))
        self._parts = [
            {
                "to": to,
                "is_own": int(apart == 0),
                "takes_found": int(1 <= apart <= length + 1),
                "takes_own": int(1 <= apart <= length),
            }
            for to, apart in before
            if apart <= length + 1
        ]
        lit = ("occluded", *(b for b in self._shadow if b not in ("shadow_origin", "shadow_direction")))
        names = vertices.names
        self.writes = (names["vertex_light"], names["carried"])
        self.reads = ("path", "alive", *(lit if self._shadow else ()), "found", "step", "step_diffuse")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One launch for each of them."""
        for part in self._parts:
            yield self._launch(arrays, **part)


def vertex_passes(setup: OctreeSetup, vertices: Vertices, is_primary: bool) -> list[Pass]:
    """From the hits of rays to the light of the vertices that are to be kept. is_primary: whether the rays are the eye's own."""
    scene, length = setup.scene, setup.length
    last = vertices.stored + length - 1
    passes: list[Pass] = []
    for vertex in range(last + 1):
        passes += [Trace(scene)] if vertex > 0 else []
        passes += [Materials(setup.graphs, is_primary and vertex == 0)] if scene.graphs else []
        passes += [ShadeVertex(setup, vertices, vertex, vertex == last and not setup.gathers_hits)]
        passes += [Shadow(scene)] if scene.features["HAS_DIRECT"] else []
        passes += [Settle(setup, vertices, vertex, length), Compact(setup.device, scene, is_settled=True)]
    return passes + _last_passes(setup, vertices, last + 1)


def _last_passes(setup: OctreeSetup, vertices: Vertices, vertex: int) -> list[Pass]:
    """What follows the last vertex, where there is light to be found by rays."""
    if not setup.gathers_hits:
        return []
    emits = any("emission" in g.outputs for g in setup.scene.graphs)
    light = [Materials(setup.graphs, is_primary=False, light_only=True)] if emits else []
    return [
        Trace(setup.scene),
        *light,
        FindLast(setup, vertices, VALUES if emits else None),
        Settle(setup, vertices, vertex, setup.length),
    ]


# ---------------------------------------------------------------------------------------------------------------------
# Paths that fill the cache


class OrderCaching(Pass):
    """Which pixel of the smaller image each caching path belongs to: found out where its size has changed."""

    name = "order"
    writes = ("caching_pixel",)

    def __init__(self, setup: OctreeSetup, pace: Pace):
        self._setup, self._pace = setup, pace
        self._kernel = setup.device.program("pathtrace/generate.cl", SOBOL=setup.sobol, **setup.scene.features)[
            "order_pixels"
        ]
        self._known: tuple[int, int] | None = None

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One pixel for each path."""
        size = caching_size(self._setup.size, self._pace.part(state.is_moving))
        if size == self._known:
            return
        self._known, pixel = size, arrays["caching_pixel"]
        yield self._kernel.run(pixel.size, n=pixel.size, pixel=pixel, width=size[0], height=size[1])


class GenerateCaching(Generate):
    """Camera rays of caching paths."""

    def __init__(self, setup: OctreeSetup, pace: Pace):
        super().__init__(setup.device, setup.scene, setup.sobol)
        self._setup, self._pace = setup, pace
        self.reads = ("caching_pixel",)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each pixel of the smaller image."""
        size = caching_size(self._setup.size, self._pace.part(state.is_moving))
        camera = state.camera.copy()
        camera["width"], camera["height"] = size
        yield from super().run(ChainMap({"pixel": arrays["caching_pixel"]}, arrays), replace(state, camera=camera[()]))
        # Places behind the last path, of which a smaller image has many, are left out of all that follows.
        alive = arrays["alive"]
        begins = np.arange(alive.size) * CHUNK
        alive.set(np.clip(path_count(size) - begins, 0, CHUNK).astype(np.uint32))


class BeginOnSurfaces(Pass):
    """Paths that begin anywhere on the static surfaces."""

    name = "generate"
    reads = ("caching_pixel",)

    def __init__(self, setup: OctreeSetup):
        scene = setup.scene
        shape = setup.octree.shape
        surfaces = static_surfaces(scene.geometry, scene.is_static, shape["origin"], float(shape["size"]))
        self._scene, self._surfaces = scene, len(surfaces.shares)
        self._areas = {
            "area_shares": setup.device.upload(surfaces.shares, "areas of surfaces"),
            "area_triangle": setup.device.upload(surfaces.triangle, "areas of surfaces"),
            "area_corners": setup.device.upload(surfaces.corners, "areas of surfaces"),
        }
        defines = {"AREA_STEPS": max(self._surfaces - 1, 0).bit_length(), **scene.defines}
        self._kernel = setup.device.program("octree/surfaces.cl", **defines)["begin_on_surfaces"]
        used = {"density": "HAS_EMISSION", "cone": "HAS_TEXTURES"}
        rays = ("ray_origin", "ray_direction", "ray_length", "throughput", "path", "alive")
        self.writes = (*rays, *HITS, *(b for b, feature in used.items() if scene.features[feature]))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each pixel of the smaller image."""
        n, arrays = arrays["ray_length"].size, ChainMap({"pixel": arrays["caching_pixel"]}, self._areas, arrays)
        yield self._kernel.run(n, arrays, self._scene.arrays, n=n, surfaces=self._surfaces, **state.sampling)


@dataclass(frozen=True)
class Surfaces:
    """Triangles, or pieces of them, by area. shares: (k,) float32, cumulative. triangle: (k, 2) uint32, instance and primitive. corners:
    (k, 3, 2) float32, barycentric coordinates u, v of a piece's corners."""

    shares: np.ndarray
    triangle: np.ndarray
    corners: np.ndarray


_NO_SURFACES = Surfaces(np.ones(1, np.float32), np.zeros((1, 2), np.uint32), np.zeros((1, 3, 2), np.float32))
_WHOLE = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
# The quarters of a triangle by its corners.
_QUARTERS = np.array(
    [
        [[1, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5]],
        [[0.5, 0.5, 0], [0, 1, 0], [0, 0.5, 0.5]],
        [[0.5, 0, 0.5], [0, 0.5, 0.5], [0, 0, 1]],
        [[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]],
    ]
)
_SMALL = 1 / 64  # of the cube's edge: triangles, and pieces of them, that are larger and reach out of it are divided


def static_surfaces(geometry: Geometry, is_static: np.ndarray, low: np.ndarray, size: float) -> Surfaces:
    """The instances' triangles that never move, as far as they lie in a cube from `low`, (3,), on; a triangle without an area where there are
    none."""
    instances = np.flatnonzero(is_static)
    mesh = geometry.instance_mesh[instances]
    counts = np.diff(geometry.first_triangle)[mesh]
    instance = np.repeat(instances, counts)
    primitive = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    within = geometry.triangles[geometry.first_triangle[geometry.instance_mesh[instance]] + primitive]
    to_world = geometry.to_world[instance].astype(np.float64)
    points = np.einsum("tij,tcj->tci", to_world[:, :, :3], geometry.positions[within].astype(np.float64))
    points = (points + to_world[:, None, :, 3] - low) / size
    number, corners = np.arange(len(instance)), np.broadcast_to(_WHOLE, (len(instance), 3, 2))
    done: list[tuple[np.ndarray, ...]] = []
    while len(number):
        low_corner, high_corner = points.min(axis=1), points.max(axis=1)
        reaches_in = ((high_corner >= 0) & (low_corner <= 1)).all(axis=1)
        is_within = ((low_corner >= 0) & (high_corner <= 1)).all(axis=1)
        is_done = reaches_in & (is_within | ((high_corner - low_corner).max(axis=1) <= _SMALL))
        done.append((number[is_done], points[is_done], corners[is_done]))
        rest = reaches_in & ~is_done
        number = np.repeat(number[rest], 4)
        points, corners = (
            np.einsum("qkc,tcj->tqkj", _QUARTERS, v[rest]).reshape(-1, 3, v.shape[-1]) for v in (points, corners)
        )
    if not done:
        return _NO_SURFACES
    number, points, corners = (np.concatenate(parts) for parts in zip(*done, strict=True))
    edges = points[:, 1:] - points[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    if not areas.sum() > 0:
        return _NO_SURFACES
    shares = np.cumsum(areas) / areas.sum()
    triangle = np.column_stack([instance[number], primitive[number]])
    return Surfaces(shares.astype(np.float32), triangle.astype(np.uint32), corners.astype(np.float32))


def caching_passes(setup: OctreeSetup, pace: Pace) -> list[Pass]:
    """From the camera, or from surfaces, to the vertices whose light goes to cells."""
    vertices, from_camera = cached_vertices(setup), setup.settings["octree.paths"] == "camera"
    rays = [GenerateCaching(setup, pace), TraceCamera(setup.scene)] if from_camera else [BeginOnSurfaces(setup)]
    return [
        OrderCaching(setup, pace),
        ClearVertices(setup, vertices),
        *rays,
        *vertex_passes(setup, vertices, is_primary=from_camera),
    ]


# ---------------------------------------------------------------------------------------------------------------------
# Paths that read the cache


def layer_names(layer: int) -> dict[str, str]:
    """A layer's buffers, by the kernels' names."""
    return {f"layer_{name}": f"layer{layer}_{name}" for name in (*LAYER_VECTORS, *LAYER_NUMBERS)}


class _LayerPass(Pass):
    """A kernel over the queue that is about one of the layers."""

    def __init__(self, setup: OctreeSetup, source: str, kernel: str, layer: int, **defines: int | bool):
        self._setup, self._scene, self._layer = setup, setup.scene, layer
        self._kernel = setup.device.program(f"octree/{source}.cl", **defines)[kernel]

    def _launch(self, count: int, arrays, **scalars) -> cl.Event | None:
        own = {kernel: arrays.get(buffer) for kernel, buffer in layer_names(self._layer).items()}
        known = {"n": arrays["ray_length"].size, "pixels": self._setup.pixels, "layer": self._layer}
        arrays = ChainMap(own, arrays, self._setup.octree.arrays)
        return self._kernel.run(count, arrays, self._scene.arrays, **(known | scalars))

    def _of_layer(self, *names: str) -> tuple[str, ...]:
        return tuple(f"layer{self._layer}_{name}" for name in names)


class ClearLayer(Pass):
    """No path has come to this layer yet."""

    name = "clear"

    def __init__(self, layer: int):
        self.writes = (f"layer{layer}_depth", f"layer{layer}_segment")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Set depths to 0."""
        for name in self.writes:
            yield fill(arrays[name], 0)


class Gather(_LayerPass):
    """A vertex of the paths: what it asks the cache for, light that needs no cell, shadow rays, and the next rays."""

    name = "gather"

    def __init__(self, setup: OctreeSetup, layer: int, is_last: bool):
        scene, settings = setup.scene, setup.settings
        super().__init__(setup, "gather", "gather", layer, **_gather_defines(setup))
        self._scalars = {
            "is_last": int(is_last),
            "emitters": scene.emitter_count,
            "jitter": settings["octree.jitter"],
            "factor": 2.0 ** -settings["octree.level_bias"],
            "shape": setup.octree.shape,
        }
        features = scene.features
        self._values = (VALUES,) if features["HAS_GRAPHS"] else ()
        self._shadow = _SHADOW_RAY if has_shadows(setup) else ()
        cone = ("cone",) if features["HAS_TEXTURES"] else ()
        density = ("density",) if features["HAS_EMISSION"] else ()
        path = ("ray_length", "ray_direction", "throughput", "ray_counts", *density, *cone)
        before = (f"layer{layer - 1}_depth",) if layer else ()
        segment = (f"layer{layer - 1}_segment",) if layer else ()
        asked = ("asked_key", "asked_level", "asked_normal", "asked_direction", *(("asked_cone",) if cone else ()))
        unused = ("segment",) if setup.gathers_hits else ("segment", "emitted")
        own = [n for n in (*LAYER_VECTORS, *LAYER_NUMBERS) if n not in unused]
        self.reads = (
            "pixel",
            "path",
            "alive",
            *HITS,
            *self._values,
            *path,
            *before,
            *segment,
            *self._of_layer("depth"),
        )
        self.writes = ("ray_origin", *path, *self._shadow, *asked, *segment, *self._of_layer(*own))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One vertex of each path."""
        layer, values = self._layer, values_as(arrays, *self._values)
        before = {f"{n}_before": arrays[f"layer{layer - 1}_{n}"] if layer else None for n in ("depth", "segment")}
        arrays = ChainMap(before, values)
        yield self._launch(values["ray_length"].size, arrays, camera=state.camera, environment=self._scene.environment,
                           **self._scalars, **state.sampling)  # fmt: skip


class LookUp(_LayerPass):
    """The cells answer; who gets no answer is listed."""

    name = "look_up"

    def __init__(self, setup: OctreeSetup, layer: int):
        textures = setup.scene.features["HAS_TEXTURES"]
        super().__init__(setup, "look_up", "look_up", layer, **_look_up_defines(setup))
        cone = ("asked_cone",) if textures else ()
        asked = ("asked_key", "asked_level", "asked_normal", "asked_direction", *cone)
        changed = (*self._of_layer("light", "count"), "misses", "counters")
        self.reads = ("alive", "path", "pixel", "octree_cells", "octree_wipe", *asked, *HITS, *changed)
        missed = ("uv", "primitive", "instance", "t", "direction", *(("cone",) if textures else ()), "target")
        self.writes = (*changed, "answer_cell", "answer_level", *(f"miss_{name}" for name in missed))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run."""
        n, settings = arrays["ray_length"].size, self._setup.settings
        scalars = {
            "least": settings["octree.samples"],
            "capacity": arrays["miss_t"].size,
            "shape": self._setup.octree.shape,
        }
        yield self._launch(-(-n // _RUN), arrays, **scalars)


class DescribeCells(_LayerPass):
    """The cells that answered what is seen first."""

    name = "aovs"
    reads = ("layer0_depth", "layer0_count", "answer_cell", "answer_level")
    writes = ("aov_voxel", "aov_level", "aov_count")

    def __init__(self, setup: OctreeSetup):
        super().__init__(setup, "look_up", "describe_cells", 0, **_look_up_defines(setup))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Pixel by pixel."""
        yield self._launch(self._setup.pixels, arrays)


class AddOwn(_LayerPass):
    """Add what the shadow rays let through to a layer's own light."""

    name = "add_own"

    def __init__(self, setup: OctreeSetup, layer: int):
        super().__init__(setup, "gather", "add_own", layer, **_gather_defines(setup))
        own = self._of_layer("own")
        self.reads = ("alive", "path", "pixel", "occluded", "shadow_length", "shadow_radiance", *own)
        self.writes = own

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each place in the queue."""
        yield self._launch(arrays["ray_length"].size, arrays)


class AddLast(_LayerPass):
    """Add what the last rays found to the last layer's own light."""

    name = "finish"

    def __init__(self, setup: OctreeSetup, layer: int):
        super().__init__(setup, "gather", "add_last", layer, **_gather_defines(setup))
        own = self._of_layer("own")
        self.reads = ("alive", "path", "pixel", "found", *self._of_layer("pass"), *own)
        self.writes = own

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each place in the queue."""
        yield self._launch(arrays["ray_length"].size, arrays)


def _gather_defines(setup: OctreeSetup) -> dict[str, int | bool]:
    settings = setup.settings
    reads = {"JITTER": settings["octree.jitter"] > 0, "GATE": settings["octree.gate"], "SOBOL": setup.sobol}
    return reads | setup.scene.defines


def _look_up_defines(setup: OctreeSetup) -> dict[str, int | bool]:
    counts = {f"COUNT_{name.upper()}": COUNTERS.index(name) for name in ("lookups", "hits", "traced")}
    return counts | {"HAS_TEXTURES": setup.scene.features["HAS_TEXTURES"]}


def has_shadows(setup: OctreeSetup) -> bool:
    """Whether specular parts have lights to reflect that are sampled."""
    features = setup.scene.features
    return features["HAS_SPECULAR"] and features["HAS_DIRECT"]


def layer_passes(setup: OctreeSetup) -> list[Pass]:
    """From the first hits of the camera's rays, with what their graphs returned, to all layers."""
    scene, layers = setup.scene, setup.layers
    passes: list[Pass] = []
    for layer in range(layers):
        if layer > 0:
            passes += [Trace(scene), *([Materials(setup.graphs, is_primary=False)] if scene.graphs else [])]
        is_last = layer == layers - 1 and not (setup.gathers_hits and scene.features["HAS_SPECULAR"])
        passes += [ClearLayer(layer), Gather(setup, layer, is_last), LookUp(setup, layer)]
        passes += [DescribeCells(setup)] if layer == 0 else []
        passes += [Shadow(scene), AddOwn(setup, layer)] if has_shadows(setup) else []
        passes += [Compact(setup.device, scene, is_settled=True)] if scene.features["HAS_SPECULAR"] else []
    if scene.features["HAS_SPECULAR"] and setup.gathers_hits:
        emits = any("emission" in g.outputs for g in scene.graphs)
        light = [Materials(setup.graphs, is_primary=False, light_only=True)] if emits else []
        found = FindLast(setup, MISSES, VALUES if emits else None)
        passes += [Trace(scene), *light, found, AddLast(setup, layers - 1)]
    return passes


# ---------------------------------------------------------------------------------------------------------------------
# What no cell answers


class BeginMisses(Pass):
    """Put the current batch of the list into the queue."""

    name = "begin"

    def __init__(self, setup: OctreeSetup):
        features = setup.scene.features
        optional = {"density": "HAS_EMISSION", "cone": "HAS_TEXTURES", "shadow_length": "HAS_DIRECT"}
        used = {feature: features[feature] for feature in optional.values()}
        self._kernel = setup.device.program("octree/misses.cl", **used)["begin_misses"]
        missed = ("uv", "primitive", "instance", "t", "direction", *(("cone",) if features["HAS_TEXTURES"] else ()))
        self.reads = ("misses", "miss_target", *(f"miss_{name}" for name in missed))
        rays = ("miss_stream", "ray_direction", "ray_length", "path", "alive")
        self.writes = (*rays, *HITS, *(b for b, feature in optional.items() if used[feature]))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each place."""
        n = arrays["ray_length"].size
        yield self._kernel.run(n, arrays, n=n, capacity=arrays["miss_t"].size, **_part_of_misses(arrays, state))


class AnswerMisses(_LayerPass):
    """Give what the paths brought to the layers that missed it."""

    name = "answer"

    def __init__(self, setup: OctreeSetup, layer: int):
        features = ("HAS_EMISSION", "HAS_TEXTURES", "HAS_DIRECT")
        super().__init__(setup, "misses", "answer_misses", layer, **{f: setup.scene.features[f] for f in features})
        changed = self._of_layer("light", "count")
        self.reads = ("misses", "miss_target", "miss_light", *changed)
        self.writes = changed

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One for each entry of the batch."""
        part = _part_of_misses(arrays, state)
        yield self._launch(part["entries"], arrays, capacity=arrays["miss_t"].size, **part)


def _part_of_misses(arrays: Mapping, state) -> dict[str, int]:
    n = arrays["ray_length"].size
    first = state.batch * n
    return {"first": first, "entries": min(int(arrays["misses"].get()[0]) - first, n)}


def miss_passes(setup: OctreeSetup) -> Repeat:
    """Trace what no cell answered, as many at once as there are places in the queue."""
    passes = [
        BeginMisses(setup),
        ClearVertices(setup, MISSES),
        *vertex_passes(setup, MISSES, is_primary=False),
        *(AnswerMisses(setup, layer) for layer in range(setup.layers)),
    ]
    return Repeat(
        "misses",
        passes,
        count=lambda _, arrays: -(-int(arrays["misses"].get()[0]) // arrays["ray_length"].size),
        advance=lambda state, index: replace(state, batch=index),
        count_reads=("misses",),
    )


# ---------------------------------------------------------------------------------------------------------------------
# The image


class Estimate(Pass):
    """The mean of the images since the camera came to rest."""

    name = "estimate"
    reads = ("layer0_filtered", "octree_wipe", "estimate_of", "color")
    writes = ("estimate_of", "color")

    def __init__(self, setup: OctreeSetup):
        program = setup.device.program("octree/estimate.cl")
        self._begin, self._estimate = program["begin_estimate"], program["estimate"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One small launch; then pixel by pixel."""
        yield self._begin.run(1, arrays, camera=state.camera, words=_ESTIMATE_WORDS)
        pixels = arrays["color"].shape[0]
        yield self._estimate.run(pixels, arrays, pixels=pixels)
