"""Render frames: a scene, a method and a device, tied together."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyopencl as cl

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
# With a goal for the error: samples of the first round, and the most that are taken where nothing else is said.
_FIRST_ROUND = 16
_UNTIL_SPP = 65536
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
    random numbers, 0 .. 2^64 - 1. spp: samples for each pixel. settings: dotted name -> value. device: index, or part of
    the platform's or device's name. threads: compute units to use. aovs: names of AOVS. until_relmse: take samples until the
    error that the pixels' variance lets expect (mean of variance / (colour^2 + 0.01)) is below this, `spp` being the most;
    the estimate counts samples as independent, and so is too high for a low-discrepancy sampler. on_compile: called with a
    program's name before it is built. What is None is as the scene says, else the default. The device's memory is
    checked before anything is allocated. Raises SettingError, DeviceError.
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
    ):
        defaults = scene.defaults
        self.scene = scene
        self.method = _first(method, defaults.method, "pathtrace")
        self.size = _checked_size(_first(size, defaults.size))
        self.seed = _checked("seed", _first(seed, defaults.seed, 0), 0, 2**64 - 1)
        self.until_relmse = until_relmse
        if until_relmse is None:
            spp = _first(spp, defaults.spp, DEFAULT_SPP)
        elif not until_relmse > 0:
            raise SettingError(f"until_relmse {until_relmse}: expected a number above 0")
        # One sample says nothing of the variance.
        self.spp = _checked("spp", _first(spp, _UNTIL_SPP), 1 if until_relmse is None else 2, 2**31 - 1)
        self.eyes = ("left", "right") if _first(stereo, defaults.stereo) else ("mono",)
        self.settings = settings_module.resolve(defaults.settings, settings or {})
        self.aovs = _checked_aovs(aovs)
        if self.method not in METHODS:
            raise SettingError(f"method {self.method}: unknown; there is {', '.join(METHODS)}")

        self.device = Device(device, threads, self.settings["device.local_size"], on_compile)
        self._resources = SceneResources(self.device, scene)
        setup = MethodSetup(self.device, self._resources, self.size, self.settings)
        parts = METHODS[self.method](setup)
        outputs = {"color", "ray_counts", *(f"aov_{name}" for name in self.aovs)}
        outputs |= {"aov_variance"} if until_relmse is not None else set()
        self._graph = FrameGraph(self.device, parts.passes, parts.buffers, outputs)
        self._render_seconds = 0.0

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
            "size": list(self.size),
            "features": self._resources.features,
            "memory": {
                "bvh": self._resources.trees.nbytes,
                "textures": self._resources.texture_bytes,
                "cache": 0,
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
        color, aovs, cameras, stats = {}, {}, {}, {}
        seconds = number / self.scene.defaults.fps
        self._resources.set_time(seconds)
        for index, eye in enumerate(self.eyes):
            cameras[eye] = self._eye_camera(index, seconds)
            state = PathState(_camera_record(cameras[eye], self.size), stream_key(self.seed, number), self.spp)
            part = None if progress is None else lambda p, index=index: progress((index + p) / len(self.eyes))
            try:
                passes, sampling = self._sample(state, part)
            except cl.Error as error:
                raise DeviceError(f"frame {number}: the device failed: {error}") from error
            color[eye] = self._image("color")
            aovs[eye] = {name: self._image(f"aov_{name}") for name in self.aovs}
            stats[eye] = {"passes": passes, "rays": self._ray_counts(sampling["spp"]), "cache": {}, **sampling}
        elapsed = time.perf_counter() - start
        self._render_seconds += elapsed
        return Frame(number, color, cameras, {"frame": number, "seconds": elapsed, "eyes": stats}, aovs)

    def _sample(self, state: PathState, progress: Callable[[float], None] | None) -> tuple[dict[str, float], dict]:
        """Run the graph for all samples, or in rounds until the error is small enough: seconds by pass, and what there is to
        say of the sampling."""
        if self.until_relmse is None:
            return dict(self._graph.run(state, progress)), {"spp": state.samples}
        seconds: dict[str, float] = {}
        samples = min(_FIRST_ROUND, self.spp)
        begin, reached = (
            0,
            0.0,
        )  # reached: the part of the way to the goal, the error being in proportion to 1 / samples
        while True:
            expected = min(reached * samples / begin, 1.0) if begin else 0.0
            part = progress and (lambda p, a=reached, b=expected: progress(a + p * (b - a)))
            for name, value in self._graph.run(replace(state, begin=begin, samples=samples), part).items():
                seconds[name] = seconds.get(name, 0.0) + value
            error = _estimated_relmse(self._image("color"), self._image("aov_variance"))
            reached = min(self.until_relmse / error, 1.0) if error else 1.0
            if error <= self.until_relmse or samples >= self.spp:
                return seconds, {"spp": samples, "estimated_relmse": error if math.isfinite(error) else None}
            growth = min(max(error / self.until_relmse, 1.25), 2.0)
            begin, samples = samples, min(math.ceil(samples * growth), self.spp)

    def _eye_camera(self, index: int, seconds: float) -> Camera:
        """The camera at a time, moved along its x axis to the eye's place; eyes look in parallel."""
        camera = self.scene.camera
        aside = (index - 0.5) * self.scene.defaults.eye_distance if len(self.eyes) == 2 else 0.0
        transform = rigid(pose_at(camera.motion, seconds)) if camera.motion else np.array(camera.transform, np.float64)
        transform[:, 3] += aside * transform[:, 0]
        return replace(camera, transform=transform, motion=())

    def _image(self, buffer: str) -> np.ndarray:
        """An image of the graph as (H, W) or (H, W, 3) float32."""
        width, height = self.size
        pixels = self._graph.arrays[buffer].get()
        return pixels.reshape(height, width, *pixels.shape[1:])

    def _ray_counts(self, spp: int) -> dict[str, int]:
        secondary, shadow = self._graph.arrays["ray_counts"].get().sum(axis=1, dtype=np.int64)
        return {"primary": self.size[0] * self.size[1] * spp, "secondary": int(secondary), "shadow": int(shadow)}


def _estimated_relmse(color: np.ndarray, variance: np.ndarray) -> float:
    """What relMSE against the true image is expected to be, the pixels' means standing in for the truth; infinite where a
    pixel is not finite."""
    with np.errstate(invalid="ignore"):
        error = float(np.mean(variance / (color.astype(np.float64) ** 2 + 0.01)))
    return math.inf if math.isnan(error) else error


def _camera_record(camera: Camera, size: tuple[int, int]) -> np.void:
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
