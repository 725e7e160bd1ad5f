"""Render frames: a scene, a method and a device, tied together."""

import math
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
from .passes.trace import path_count
from .random import stream_key
from .resources import SceneResources
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
    program's name before it is built. stereo_blend: one of STEREO_BLENDS, how the eyes share what they know. What is None is
    as the scene says, else the default. The device's memory is checked before anything is allocated. Caches are empty at
    first and outlive a call of `frames`: the next one goes on with what the last frame left, whatever its number.
    Raises SettingError, DeviceError.
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
        self.stereo_blend = _first(stereo_blend, "none")
        if self.stereo_blend not in settings_module.STEREO_BLENDS:
            known = ", ".join(settings_module.STEREO_BLENDS)
            raise SettingError(f"stereo_blend {self.stereo_blend}: unknown; there is {known}")
        if self.stereo_blend != "none" and len(self.eyes) < 2:
            raise SettingError(f"stereo_blend {self.stereo_blend}: there is one eye; expected stereo")
        self.settings = settings_module.resolve(defaults.settings, settings or {})
        self.aovs = _checked_aovs(aovs)

        self.device = Device(device, threads, self.settings["device.local_size"], on_compile)
        self._resources = SceneResources(self.device, scene)
        setup = MethodSetup(self.device, self._resources, self.size, self.settings, self.stereo_blend)
        self._parts = parts = METHODS[self.method](setup)
        self._check_offers()
        self._graph = FrameGraph(
            self.device, parts.passes, parts.buffers, self._outputs(), eyes=self.eyes, exchanged=parts.exchanged
        )
        self._blend = self._blend_graph() if parts.blend else None
        self._updates = dict.fromkeys(self.eyes, 0)
        self._render_seconds = 0.0

    def _checked_spp(self, spp: int | None) -> int:
        """The samples for each pixel, or the most of them. Raises SettingError."""
        goal = self.until_relmse
        if goal is None:
            default = (
                _CACHED_SPP
                if self.method in settings_module.CACHED_METHODS
                else _first(self.scene.defaults.spp, DEFAULT_SPP)
            )
            return _checked("spp", _first(spp, default), 1, 2**31 - 1)
        if not goal > 0:
            raise SettingError(f"until_relmse {goal}: expected a number above 0")
        if self.method in settings_module.CACHED_METHODS:
            others = ", ".join(name for name in METHODS if name not in settings_module.CACHED_METHODS)
            raise SettingError(
                f"until_relmse {goal}: method {self.method} has a cache; expected a method without, {others}"
            )
        return _checked("spp", _first(spp, _UNTIL_SPP), 2, 2**31 - 1)  # one sample says nothing of the variance

    def _check_offers(self) -> None:
        """Raise SettingError where the method lacks an AOV or the blend that is asked for."""
        own = {b.name for b in self._parts.buffers}
        for name in self.aovs:
            if f"aov_{name}" not in own:
                there = ", ".join(n for n in AOVS if f"aov_{n}" in own) or "none"
                raise SettingError(f"AOV {name}: method {self.method} has none; it has {there}")
        if self.stereo_blend != "none" and not self._parts.blend:
            raise SettingError(
                f"stereo_blend {self.stereo_blend}: method {self.method} has no cache of samples to blend"
            )

    def _outputs(self) -> set[str]:
        """The buffers of the method that a frame is made from."""
        parts = self._parts
        outputs = {"color", "ray_counts", *(f"aov_{name}" for name in self.aovs)}
        outputs |= {"aov_variance"} if self.until_relmse is not None else set()
        outputs |= {"counters"} if parts.counters else set()
        of_blend = {b.name for b in parts.blend_buffers}
        return outputs | {b.removeprefix(_OTHER) for p in parts.blend for b in p.reads if b not in of_blend}

    def _blend_graph(self) -> FrameGraph:
        parts, inputs = self._parts, self._eye_inputs(self.eyes[0])
        return FrameGraph(self.device, parts.blend, parts.blend_buffers, {"blended"}, inputs, self.eyes)

    def _eye_inputs(self, eye: str) -> dict[str, cl_array.Array]:
        """What an eye's blend may read: what the last runs of both eyes left."""
        own, other = self._graph.of(eye), self._graph.of(self._other(eye))
        left = [b for b in self._graph.buffers if b.per_eye or b.persistent]
        return {b.name: own[b.name] for b in left} | {f"{_OTHER}{b.name}": other[b.name] for b in left}

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

    def stats(self) -> dict:
        """All of stats.json but its frames, so far."""
        device, scene = self.device, self.scene
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
            "stereo_blend": self.stereo_blend,
            "size": list(self.size),
            "features": self._resources.features,
            "memory": {
                "bvh": self._resources.trees.nbytes,
                "textures": self._resources.texture_bytes,
                "cache": sum(self._graph.sizes.get(name, 0) for name in self._parts.cache),
                "total": device.allocated,
            },
            "seconds": {
                "bvh_build": self._resources.trees.seconds,
                "compile": device.compile_seconds,
                "render": self._render_seconds,
            },
        }

    def _render(self, number: int, progress: Callable[[float], None] | None) -> Frame:
        start = time.perf_counter()
        seconds = number / self.scene.defaults.fps
        cameras = {eye: self._eye_camera(index, seconds) for index, eye in enumerate(self.eyes)}
        try:
            self._resources.set_time(seconds)
            color, aovs, stats = self._render_eyes(number, cameras, progress)
        except cl.Error as error:
            raise DeviceError(f"frame {number}: the device failed: {error}") from error
        elapsed = time.perf_counter() - start
        self._render_seconds += elapsed
        return Frame(number, color, cameras, {"frame": number, "seconds": elapsed, "eyes": stats}, aovs)

    def _render_eyes(
        self, number: int, cameras: Mapping[str, Camera], progress: Callable[[float], None] | None
    ) -> tuple[dict, dict, dict]:
        """The eyes' colours, AOVs and statistics, each by eye."""
        color, aovs, stats = {}, {}, {}
        is_cached = self.method in settings_module.CACHED_METHODS
        samples = 1 if is_cached else self.spp
        # Of a cache each eye has random numbers of its own: what is blended is to be independent.
        keys = [stream_key(self.seed, index if is_cached else number) for index in range(len(self.eyes))]
        states = {
            eye: PathState(camera_record(cameras[eye], self.size), key, samples)
            for eye, key in zip(self.eyes, keys, strict=True)
        }
        for index, eye in enumerate(self.eyes):
            part = None if progress is None else lambda p, index=index: progress((index + p) / len(self.eyes))
            stats[eye] = (self._update if is_cached else self._sample)(eye, states[eye], part)
            color[eye] = self._image("color", eye)
            aovs[eye] = {name: self._image(f"aov_{name}", eye) for name in self.aovs}
        for eye in self.eyes if self._blend else ():
            state = replace(states[eye], other=states[self._other(eye)].camera, update=self._updates[eye] - 1)
            _add(stats[eye]["passes"], self._blend.run(state, eye=eye, inputs=self._eye_inputs(eye)))
            color[eye] = self._shaped(self._blend.of(eye)["blended"])
        return color, aovs, stats

    def _update(self, eye: str, state: PathState, progress: Callable[[float], None] | None) -> dict:
        """Update an eye's cache as often as spp says: the eye's statistics. Times, rays and counters are of all updates; what the
        cache holds is as the last leaves it."""
        passes: dict[str, float] = {}
        rays: dict[str, int] = {}
        counters: dict[str, int] = {}
        for done in range(1, self.spp + 1):
            _add(passes, self._run(eye, replace(state, sample=self._updates[eye])))
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
        return self._graph.run(replace(state, update=update), progress, eye)

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
