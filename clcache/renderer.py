"""Render frames: a scene, a method and a device, tied together."""

import functools
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from . import settings as settings_module
from .device import Device
from .errors import DeviceError, SettingError
from .frame import FrameGraph
from .layout import STRUCTS
from .methods import METHODS, MethodSetup, PathState
from .output.aov import AOVS
from .output.state import StateFile, write_state
from .passes.filter import Filter
from .passes.materials import COUNTERS as MEMO_COUNTERS
from .passes.materials import LEVELS as MEMO_LEVELS
from .passes.trace import path_count
from .random import stream_key
from .resources import SceneResources
from .scene.digest import camera_digest, scene_digest
from .scene.model import Camera, Scene
from .scene.motion import pose_at
from .scene.transform import rigid
from .version import __version__

DEFAULT_SPP = 16
_CACHED_SPP = 1  # of methods with a cache, which have the samples of the frames before as well
# With a goal for the error: samples of the first round, and the most that are taken where nothing else is said.
_FIRST_ROUND = 16
_UNTIL_SPP = 65536
_OTHER = "other_"  # what the other eye's buffers have before their names, for the passes of a stereo blend
_FIRST_HITS = "first_hit"  # the buffer of sample caches that holds them
# The AOVs of filters: what there must be for them, and where it is said.
_FILTER_AOVS = {
    "alpha": "a temporal filter; expected --temporal taa or varianceblend",
    "effective": "a temporal filter; expected --temporal taa or varianceblend",
    "beta": "a stereo blend of images; expected --stereo-blend constant or varianceblend",
}
MAX_PIXELS = 2**30  # kernels count elements of three planes in 32 bits


@dataclass(frozen=True)
class Frame:
    """A finished frame. number: the frame's. color: eye -> (H, W, 3) float32, linear. cameras: eye -> Camera. stats: the
    frame's entry of stats.json."""

    number: int
    color: dict[str, np.ndarray]
    cameras: dict[str, Camera]
    stats: dict
    _aovs: dict[str, dict[str, np.ndarray]] = field(repr=False)

    def aov(self, name: str, eye: str) -> np.ndarray:
        """An AOV that the renderer was asked for: (H, W) or (H, W, 3) float32. Raises SettingError if it was not."""
        if name not in self._aovs[eye]:
            raise SettingError(f"AOV {name}: not rendered; there is {', '.join(self._aovs[eye]) or 'none'}")
        return self._aovs[eye][name]


class Renderer:
    """Render a scene by a method.

    scene: what `load_scene` returns. method: one of METHODS. size: width, height in pixels. stereo: two eyes. seed: of all
    random numbers, 0 .. 2^64 - 1. spp: samples for each pixel; of a method with a cache the updates of it for each frame,
    one unless given here. settings: dotted name -> value. device: index, or part of
    the platform's or device's name. threads: compute units to use. aovs: names of AOVS. until_relmse: take samples until the
    error that the pixels' variance lets expect (mean of variance / (colour^2 + 0.01)) is below this, `spp` being the most;
    the estimate counts samples as independent, and so is too high for a low-discrepancy sampler. on_compile: called with a
    program's name before it is built. temporal: one of TEMPORALS, how a frame's image is joined with those of the frames
    before; by default as the method has it. stereo_blend: one of STEREO_BLENDS, how the eyes share what they know. memo: one of
    MEMOS, how values of material graphs are kept; "off" by default, and without effect where the scene has no graphs. What is
    None is as the scene says, else the default. The device's memory is checked before anything is allocated. Caches are
    empty at first and outlive a call of `frames`: the next one goes on with what the last frame left, whatever its
    number; but the history of a temporal filter ends where a frame is not the one after the last.
    Raises SettingError, DeviceError.

    A frame is made in three stages, each a frame graph: the method, for each eye; the temporal filter of the eye's
    image, right after it; and when all eyes are there, the stereo blend of what the two have, which no history knows of.
    """

    def __init__(
        self,
        scene: Scene,
        method: str | None = None,
        size: tuple[int, int] | None = None,
        stereo: bool | None = None,
        seed: int | None = None,
        spp: int | None = None,
        settings: dict[str, object] | None = None,
        device: str | int | None = None,
        threads: int | None = None,
        aovs: Sequence[str] = (),
        until_relmse: float | None = None,
        on_compile: Callable[[str], None] | None = None,
        stereo_blend: str | None = None,
        temporal: str | None = None,
        memo: str | None = None,
    ):
        defaults = scene.defaults
        self.scene = scene
        self.method = _first(method, defaults.method, "pathtrace")
        self.size = _checked_size(_first(size, defaults.size))
        self.seed = _checked("seed", _first(seed, defaults.seed, 0), 0, 2**64 - 1)
        self.until_relmse = until_relmse
        if self.method not in METHODS:
            raise SettingError(f"method {self.method}: unknown; there is {', '.join(METHODS)}")
        self.spp = self._checked_spp(spp)
        self.eyes = ("left", "right") if _first(stereo, defaults.stereo) else ("mono",)
        default = settings_module.DEFAULT_TEMPORALS.get(self.method, "none")
        self.temporal = _known("temporal", _first(temporal, default), settings_module.TEMPORALS)
        self.stereo_blend = _known("stereo_blend", _first(stereo_blend, "none"), settings_module.STEREO_BLENDS)
        self.memo = _known("memo", _first(memo, "off"), settings_module.MEMOS)
        if self.stereo_blend != "none" and len(self.eyes) < 2:
            raise SettingError(f"stereo_blend {self.stereo_blend}: there is one eye; expected stereo")
        self.settings = settings_module.resolve(defaults.settings, settings or {})
        self.aovs = _checked_aovs(aovs)

        self.device = Device(
            device, threads, self.settings["device.local_size"], on_compile, self.settings["device.fast_math"]
        )
        self._resources = SceneResources(self.device, scene)
        setup = MethodSetup(self.device, self._resources, self.size, self.settings, self.stereo_blend, self.memo)
        self._parts = parts = METHODS[self.method](setup)
        self._temporal = self._temporal_filter()
        self._stereo = self._stereo_filter()
        self._check_aovs()
        self._graph = FrameGraph(
            self.device, parts.passes, parts.buffers, self._outputs(), eyes=self.eyes, exchanged=parts.exchanged
        )
        eye = self.eyes[0]
        self._temporal_graph = self._temporal and self._temporal.graph(
            self.device, self.aovs, self._graph.left(eye), self.eyes
        )
        self._stereo_graph = self._stereo and self._stereo.graph(
            self.device, self.aovs, self._pair_inputs(eye), self.eyes
        )
        # The frames that were rendered first and last, and whether all were completed.
        self._first: int | None = None
        self._last: int | None = None
        self._is_whole = True
        self._updates = dict.fromkeys(self.eyes, 0)
        self._memo_counts: dict[str, int] = {}  # of the eye's frame, so far
        self._render_seconds = 0.0

    def _checked_spp(self, spp: int | None) -> int:
        """The samples for each pixel, or the most of them. Raises SettingError."""
        goal = self.until_relmse
        if goal is None:
            default = _CACHED_SPP if self._is_cached else _first(self.scene.defaults.spp, DEFAULT_SPP)
            return _checked("spp", _first(spp, default), 1, 2**31 - 1)
        if not goal > 0:
            raise SettingError(f"until_relmse {goal}: expected a number above 0")
        if self._is_cached:
            others = ", ".join(name for name in METHODS if name not in settings_module.CACHED_METHODS)
            raise SettingError(
                f"until_relmse {goal}: method {self.method} has a cache; expected a method without, {others}"
            )
        return _checked("spp", _first(spp, _UNTIL_SPP), 2, 2**31 - 1)  # one sample says nothing of the variance

    def _temporal_filter(self) -> Filter | None:
        if self.temporal == "none":
            return None
        from .passes.temporal import temporal

        self._resources.keep_before()
        return temporal(self.device, self._resources, self.size, self.settings, self.temporal)

    def _stereo_filter(self) -> Filter | None:
        if self.stereo_blend == "none":
            return None
        if self.stereo_blend == "samples":
            if not self._parts.blend:
                raise SettingError(f"stereo_blend samples: method {self.method} has no cache of samples to blend")
            return Filter(self._parts.blend, self._parts.blend_buffers, "blended")
        from .passes.stereo import stereo

        return stereo(self.device, self._resources, self.size, self.settings, self.stereo_blend)

    @property
    def _filters(self) -> list[Filter]:
        return [f for f in (self._temporal, self._stereo) if f]

    def _check_aovs(self) -> None:
        """Raise SettingError where an AOV is asked for that nothing here writes."""
        own = {b.name for b in self._parts.buffers}
        filters = {b.name for f in self._filters for b in f.buffers}
        for name in self.aovs:
            if name in _FILTER_AOVS and f"aov_{name}" not in filters:
                raise SettingError(f"AOV {name}: needs {_FILTER_AOVS[name]}")
            if f"aov_{name}" not in own | filters:
                there = ", ".join(n for n in AOVS if f"aov_{n}" in own) or "none"
                raise SettingError(f"AOV {name}: method {self.method} has none; it has {there}")

    def _outputs(self) -> set[str]:
        """The buffers of the method that a frame is made from."""
        parts = self._parts
        outputs = {"color", "ray_counts"} | {f"aov_{name}" for name in self.aovs} & {b.name for b in parts.buffers}
        outputs |= {"aov_variance"} if self.until_relmse is not None else set()
        outputs |= {"counters"} if parts.counters else set()
        outputs |= {"memo_counters"} if parts.memo else set()
        read = {name.removeprefix(_OTHER) for f in self._filters for name in f.inputs(self.aovs)}
        return outputs | (read - {b.name for f in self._filters for b in f.buffers})

    def _eye_inputs(self, eye: str) -> dict[str, cl_array.Array]:
        """What the stages so far left of an eye; its image is `color`."""
        left = self._graph.left(eye)
        if self._temporal:
            filtered = self._temporal_graph.left(eye)
            left |= filtered | {"color": filtered[self._temporal.output]}
        return left

    def _pair_inputs(self, eye: str) -> dict[str, cl_array.Array]:
        """What an eye's stereo blend may read: what is left of both."""
        other = self._eye_inputs(self._other(eye))
        return self._eye_inputs(eye) | {f"{_OTHER}{name}": array for name, array in other.items()}

    def _other(self, eye: str) -> str:
        return next(e for e in self.eyes if e != eye)

    def frames(
        self, begin: int | None = None, end: int | None = None, progress: Callable[[float], None] | None = None
    ) -> Iterator[Frame]:
        """Render frames begin .. end - 1 (the scene's range where None), one at a time. progress: called with the part of
        the current frame that is done. Raises SettingError, DeviceError."""
        first, last = self.scene.defaults.frames
        begin, end = _first(begin, first), _first(end, last)
        if not 0 <= begin < end:
            raise SettingError(f"frames {begin}:{end}: expected 0 <= first < end")
        for number in range(begin, end):
            yield self._render(number, progress)

    @property
    def has_state(self) -> bool:
        """Whether a frame depends on those before it."""
        return self._is_cached or self.temporal != "none" or self._memo_shows

    @property
    def keeps_world(self) -> bool:
        """Whether there is anything that another sequence could begin with."""
        return bool(self._parts.world)

    @property
    def _memo_shows(self) -> bool:
        """Whether images depend on what is memoized, and when: else its values are those that would be computed anew."""
        is_free = self.memo == "texel" and not self.settings["memo.snap"]
        return self._parts.memo is not None and (is_free or self.settings["memo.auto"])

    def save(self, path: str | os.PathLike) -> None:
        """Write the state after the last frame to a file, whole or not at all: all that the next frame depends on.

        Raises SettingError where there is no such frame, or one was broken off, which leaves the eyes apart; SettingError or
        Error where the file cannot be written.
        """
        if self._last is None or not self._is_whole:
            why = "there is no frame yet" if self._is_whole else "a frame was broken off"
            raise SettingError(f"{path}: {why}; expected a state after whole frames")
        numbers = {"first": self._first, "frame": self._last, "updates": max(self._updates.values())}
        arrays = ((name, array.get()) for name, array in self._kept().items())
        write_state(path, self._identity() | numbers, arrays)

    def restore(self, path: str | os.PathLike) -> int:
        """Go on with what `save` wrote: the frames that follow are bit for bit what they would have been there. path: the file, or
        the folder that has it. Returns the number of the last frame. Raises SettingError where it is not a state of the
        same scene, method, settings, seed, size, eyes and filters."""
        with StateFile(path) as state:
            state.check(self._identity())
            first, last = (state.number(name) for name in ("first", "frame"))
            updates = state.number("updates")
            self._load(state, self._kept())
        self._first, self._last, self._is_whole = first, last, True
        self._updates = dict.fromkeys(self.eyes, updates)
        self._resources.set_time(last / self.scene.defaults.fps)
        return last

    def warm_start(self, path: str | os.PathLike) -> None:
        """Begin with what another sequence of the same scene knew of the world: frames, cameras, size, eyes and seed may be others.

        path: as of `restore`. To be called before the first frame. Raises SettingError where the method keeps nothing of the
        kind, or the file is not of the same scene, method and settings (those aside on which no more than the image depends).
        """
        if not self._parts.world:
            raise SettingError(f"{path}: method {self.method} keeps nothing that another sequence could begin with")
        if self._last is not None or not self._is_whole:
            raise SettingError(f"{path}: there are frames already; expected a warm start before the first")
        kept = self._kept()
        names = (f"method.all.{name}" for name in self._parts.world)
        with StateFile(path) as state:
            state.check(self._world_identity())
            updates = state.number("updates")
            self._load(state, {name: kept[name] for name in names if name in kept})
        self._updates = dict.fromkeys(self.eyes, updates)

    def _load(self, state: StateFile, arrays: Mapping[str, cl_array.Array]) -> None:
        state.check_arrays({name: (array.shape, array.dtype) for name, array in arrays.items()})
        for name in arrays:  # what kernels take for indices
            if _last(name) == _FIRST_HITS and not self._resources.has_first_hits(state.read(name)):
                raise SettingError(
                    f"{state.path}: {name} has triangles that the scene lacks; expected a state of this scene"
                )
        for name, array in arrays.items():
            array.set(state.read(name))

    def _kept(self) -> dict[str, cl_array.Array]:
        """What the next frame depends on, by GRAPH.EYE.NAME."""
        graphs = {"method": self._graph, "temporal": self._temporal_graph, "stereo": self._stereo_graph}
        return {f"{stage}.{name}": a for stage, graph in graphs.items() if graph for name, a in graph.kept().items()}

    @functools.cached_property
    def _scene_digest(self) -> str:
        return scene_digest(self.scene)

    def _world_identity(self) -> dict[str, object]:
        """What is the same in all sequences that can share what they know of the world."""
        return {
            "version": __version__,
            "content of the scene": self._scene_digest,
            "method": self.method,
            "memo": self.memo,
            "settings": self._settings_of("world"),
            **({"octree's cube": self._parts.octree.cube} if self._parts.octree else {}),
        }

    def _identity(self) -> dict[str, object]:
        """What is the same in all renders that can go on with each other's state."""
        return self._world_identity() | {
            "camera's path": camera_digest(self.scene),
            "settings of the image": self._settings_of("image"),
            "temporal": self.temporal,
            "stereo_blend": self.stereo_blend,
            "size": self.size,
            "eyes": self.eyes,
            "seed": self.seed,
            "spp": self.spp,
            "until_relmse": self.until_relmse,
        }

    def _settings_of(self, what: str) -> dict[str, object]:
        return {name: value for name, value in self.settings.items() if settings_module.SETTINGS[name].of == what}

    def stats(self) -> dict:
        """All of stats.json but its frames, so far."""
        device, scene, octree = self.device, self.scene, self._parts.octree
        cache = sum(self._graph.sizes.get(name, 0) for name in self._parts.cache)
        return {
            "version": __version__,
            "device": {
                "platform": device.platform,
                "name": device.name,
                "driver": device.driver,
                "threads": device.threads,
            },
            "scene": {
                "file": scene.file,
                "triangles": scene.triangle_count,
                "instances": len(scene.instances),
                "materials": len(scene.materials),
            },
            "method": self.method,
            "settings": self.settings,
            "spp": self.spp,
            "seed": self.seed,
            "temporal": self.temporal,
            "stereo_blend": self.stereo_blend,
            "memo": {"kind": self.memo, "materials": self._parts.memo.report() if self._parts.memo else []},
            **({"octree": octree.report()} if octree else {}),
            "size": list(self.size),
            "features": self._resources.features,
            "memory": {
                "bvh": self._resources.trees.nbytes,
                "textures": self._resources.texture_bytes,
                "cache": cache + (octree.nbytes if octree else 0),
                "total": device.allocated,
            },
            "seconds": {
                "graphs": self._resources.graph_seconds,
                "bvh_build": self._resources.trees.seconds,
                **({"octree": octree.seconds} if octree else {}),
                "compile": device.compile_seconds,
                "render": self._render_seconds,
            },
        }

    def _render(self, number: int, progress: Callable[[float], None] | None) -> Frame:
        start = time.perf_counter()
        was_whole, self._is_whole = self._is_whole, False
        before, self._last = self._last, None  # what is broken off is no history
        seconds = number / self.scene.defaults.fps
        cameras = {eye: self._eye_camera(index, seconds) for index, eye in enumerate(self.eyes)}
        try:
            self._resources.set_time(seconds)
            color, aovs, stats = self._render_eyes(number, before, cameras, progress)
        except cl.Error as error:
            raise DeviceError(f"frame {number}: the device failed: {error}") from error
        self._first = number if self._first is None else self._first
        self._last, self._is_whole = number, was_whole
        elapsed = time.perf_counter() - start
        self._render_seconds += elapsed
        return Frame(number, color, cameras, {"frame": number, "seconds": elapsed, "eyes": stats}, aovs)

    def _render_eyes(
        self,
        number: int,
        before: int | None,
        cameras: Mapping[str, Camera],
        progress: Callable[[float], None] | None,
    ) -> tuple[dict, dict, dict]:
        """The eyes' colours, AOVs and statistics, each by eye. before: the last frame, if there is one."""
        color, aovs, stats = {}, {}, {}
        states = {eye: self._state(index, number, before, cameras[eye]) for index, eye in enumerate(self.eyes)}
        for index, eye in enumerate(self.eyes):
            part = None if progress is None else lambda p, index=index: progress((index + p) / len(self.eyes))
            self._memo_counts = {}
            stats[eye] = (self._update if self._is_cached else self._sample)(eye, states[eye], part)
            if self._parts.memo:
                stats[eye]["cache"] = self._memo_counts | stats[eye]["cache"]
                stats[eye]["memo"] = self._memo_counts
            aovs[eye] = self._aovs_of(self._graph, eye)
            color[eye] = self._graph.of(eye)["color"]
            if self._temporal:
                state = replace(states[eye], update=self._updates[eye] - 1)
                _add(stats[eye]["passes"], self._temporal_graph.run(state, eye=eye, inputs=self._graph.left(eye)))
                aovs[eye] |= self._aovs_of(self._temporal_graph, eye)
                color[eye] = self._temporal_graph.of(eye)[self._temporal.output]
            if not self._stereo:
                color[eye] = self._shaped(color[eye])
        for eye in self.eyes if self._stereo else ():
            state = replace(states[eye], other=states[self._other(eye)].camera, update=self._updates[eye] - 1)
            _add(stats[eye]["passes"], self._stereo_graph.run(state, eye=eye, inputs=self._pair_inputs(eye)))
            aovs[eye] |= self._aovs_of(self._stereo_graph, eye)
            color[eye] = self._shaped(self._stereo_graph.of(eye)[self._stereo.output])
        if self._parts.memo:
            self._parts.memo.observe(self._graph.of(self.eyes[-1]))
        return color, aovs, stats

    @property
    def _is_cached(self) -> bool:
        return self.method in settings_module.CACHED_METHODS

    def _state(self, index: int, number: int, last: int | None, camera: Camera) -> PathState:
        """What the passes of an eye's frame are told. last: the number of the frame before."""
        now, before = camera_record(camera, self.size), None
        if last is not None:
            before = camera_record(self._eye_camera(index, last / self.scene.defaults.fps), self.size)
        is_moving = before is not None and bool(now != before)
        # What is blended is to be independent: then, and of a cache, each eye has random numbers of its own.
        aside = index << 32 if self.stereo_blend != "none" else 0
        key = stream_key(self.seed, index if self._is_cached else number + aside)
        samples = 1 if self._is_cached else self.spp
        history = before if number - 1 == last else None
        return PathState(now, key, samples, eye=index, camera_before=history, is_moving=is_moving)

    def _update(self, eye: str, state: PathState, progress: Callable[[float], None] | None) -> dict:
        """Update an eye's cache as often as spp says: the eye's statistics. Times, rays and counters are of all updates; what the
        cache holds is as the last leaves it."""
        passes: dict[str, float] = {}
        rays: dict[str, int] = {}
        counters: dict[str, int] = {}
        for done in range(1, self.spp + 1):
            _add(passes, self._run(eye, replace(state, sample=self._updates[eye] % 2**32)))
            found = self._counters(eye)
            _add(rays, self._ray_counts(eye, found, state.samples))
            _add(counters, found)
            counters |= {name: found[name] for name in self._parts.levels}
            if progress:
                progress(done / self.spp)
        return {"passes": passes, "rays": rays, "cache": counters, "spp": self.spp}

    def _sample(self, eye: str, state: PathState, progress: Callable[[float], None] | None) -> dict:
        """Take an eye's samples, all at once or in rounds until the error is small enough: the eye's statistics."""
        if self.until_relmse is None:
            passes, sampling = self._run(eye, state, progress), {"spp": state.samples}
        else:
            passes, sampling = self._sample_until(eye, state, progress)
        counters = self._counters(eye)
        rays = self._ray_counts(eye, counters, sampling["spp"])
        return {"passes": passes, "rays": rays, "cache": counters, **sampling}

    def _sample_until(
        self, eye: str, state: PathState, progress: Callable[[float], None] | None
    ) -> tuple[dict[str, float], dict]:
        """Rounds of samples: seconds by pass, and what there is to say of the sampling."""
        passes: dict[str, float] = {}
        samples = min(_FIRST_ROUND, self.spp)
        # reached: the part of the way to the goal, the error being in proportion to 1 / samples.
        begin, reached = 0, 0.0
        while True:
            expected = min(reached * samples / begin, 1.0) if begin else 0.0
            part = progress and (lambda p, a=reached, b=expected: progress(a + p * (b - a)))
            _add(passes, self._run(eye, replace(state, begin=begin, samples=samples), part))
            error = _estimated_relmse(self._image("color", eye), self._image("aov_variance", eye))
            reached = min(self.until_relmse / error, 1.0) if error else 1.0
            if error <= self.until_relmse or samples >= self.spp:
                return passes, {"spp": samples, "estimated_relmse": error if math.isfinite(error) else None}
            growth = min(max(error / self.until_relmse, 1.25), 2.0)
            begin, samples = samples, min(math.ceil(samples * growth), self.spp)

    def _run(self, eye: str, state: PathState, progress: Callable[[float], None] | None = None) -> dict[str, float]:
        """Run the method's passes once for an eye: seconds by pass."""
        update = self._updates[eye]
        self._updates[eye] += 1
        seconds = self._graph.run(replace(state, update=update), progress, eye)
        if self._parts.pace:
            self._parts.pace.observe(seconds, state.is_moving)
        if self._parts.memo:
            found = dict(zip(MEMO_COUNTERS, self._graph.of(eye)["memo_counters"].get().tolist(), strict=True))
            _add(self._memo_counts, found)
            self._memo_counts |= {name: found[name] for name in MEMO_LEVELS}
        return seconds

    def _eye_camera(self, index: int, seconds: float) -> Camera:
        """The camera at a time, moved along its x axis to the eye's place; eyes look in parallel."""
        camera = self.scene.camera
        aside = (index - 0.5) * self.scene.defaults.eye_distance if len(self.eyes) == 2 else 0.0
        transform = rigid(pose_at(camera.motion, seconds)) if camera.motion else np.array(camera.transform, np.float64)
        transform[:, 3] += aside * transform[:, 0]
        return replace(camera, transform=transform, motion=())

    def _image(self, buffer: str, eye: str) -> np.ndarray:
        """An image of the method's graph as (H, W) or (H, W, 3) float32."""
        return self._shaped(self._graph.of(eye)[buffer])

    def _aovs_of(self, graph: FrameGraph, eye: str) -> dict[str, np.ndarray]:
        """Those of the AOVs that an eye's last run of this graph wrote."""
        arrays = graph.of(eye)
        written = {b.name for b in graph.buffers}
        return {name: self._shaped(arrays[f"aov_{name}"]) for name in self.aovs if f"aov_{name}" in written}

    def _shaped(self, image: cl_array.Array) -> np.ndarray:
        width, height = self.size
        pixels = image.get()
        return pixels.reshape(height, width, *pixels.shape[1:])

    def _counters(self, eye: str) -> dict[str, int]:
        """What the method counted in its last run."""
        names = self._parts.counters
        return dict(zip(names, self._graph.of(eye)["counters"].get().tolist(), strict=True)) if names else {}

    def _ray_counts(self, eye: str, counters: Mapping[str, int], samples: int) -> dict[str, int]:
        """The rays of the eye's last run, in which pixels got so many samples."""
        secondary, shadow = self._graph.of(eye)["ray_counts"].get().sum(axis=1, dtype=np.int64)
        counted = self._parts.primary
        primary = sum(counters[name] for name in counted) if counted else math.prod(self.size) * samples
        return {"primary": primary, "secondary": int(secondary), "shadow": int(shadow)}


def _add(totals: dict, values: Mapping) -> None:
    """Add each of the values to the total of its name."""
    for name, value in values.items():
        totals[name] = totals.get(name, 0) + value


def _estimated_relmse(color: np.ndarray, variance: np.ndarray) -> float:
    """What relMSE against the true image is expected to be, the pixels' means standing in for the truth; infinite where a
    pixel is not finite."""
    with np.errstate(invalid="ignore"):
        error = float(np.mean(variance / (color.astype(np.float64) ** 2 + 0.01)))
    return math.inf if math.isnan(error) else error


def camera_record(camera: Camera, size: tuple[int, int]) -> np.void:
    """A camera as kernels take it: a record of Camera. size: of its image, width and height."""
    record = np.zeros((), STRUCTS["Camera"])
    width, height = size
    slope = np.tan(camera.fov_y / 2)
    record["to_world"] = np.asarray(camera.transform).ravel()
    record["slope"] = slope * width / height, slope
    record["near"], record["width"], record["height"] = camera.near, width, height
    return record[()]


def _first(*values):
    """The first value that is not None."""
    return next((v for v in values if v is not None), None)


def _last(name: str) -> str:
    return name.rpartition(".")[2]


def _known(what: str, name: str, names: Sequence[str]) -> str:
    if name not in names:
        raise SettingError(f"{what} {name}: unknown; there is {', '.join(names)}")
    return name


def _checked(name: str, value: int, low: int, high: int) -> int:
    if not low <= value <= high:
        raise SettingError(f"{name} {value}: expected {low} .. {high}")
    return value


def _checked_size(size: tuple[int, int]) -> tuple[int, int]:
    width, height = size
    if width < 1 or height < 1 or path_count(size) > MAX_PIXELS:
        raise SettingError(f"size {width}x{height}: expected at least 1x1, and at most {MAX_PIXELS} pixels")
    return width, height


def _checked_aovs(names: Sequence[str]) -> tuple[str, ...]:
    for name in names:
        if name not in AOVS:
            raise SettingError(f"AOV {name}: unknown; there is {', '.join(AOVS)}")
    return tuple(dict.fromkeys(names))
