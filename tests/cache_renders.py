"""Renders by the methods with a sample cache: along cameras, on one device that compiles once, and what is in the cache then."""

import functools
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import IDENTITY
from render_helpers import ball, floor, grey, lit, view
from scipy.spatial.transform import Rotation

from clcache import Renderer
from clcache.device import Device
from clcache.renderer import Frame
from clcache.scene.model import Camera, DirectionalLight, Material, Scene, Track

_SHORT = ("slots", "target", "tolerance", "tracing", "reprojection", "shading", "shading_rate", "demodulate", "alpha")
NONE = 0xFFFFFFFF
SMALL = {"slots": 6, "target": 5, "tolerance": 0.5}  # so few slots that samples are lost to full pixels


@contextmanager
def one_device() -> Iterator[None]:
    """All renderers that ask for the same device get the same, and so what one has compiled serves the others."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("clcache.renderer.Device", functools.cache(Device))
        yield


def cached(scene: Scene, method: str = "samplecache", size: tuple[int, int] = (16, 16), **options) -> Renderer:
    """A renderer with a cache. options: of `Renderer`; settings of samplecache by their last names; `bounces`."""
    short = {f"samplecache.{name}": options.pop(name) for name in _SHORT if name in options}
    short |= {"pathtrace.bounces": options.pop("bounces")} if "bounces" in options else {}
    return Renderer(scene, method, size, settings=short | options.pop("settings", {}), **options)


def along(scene: Scene, cameras: Sequence[Camera]) -> Scene:
    """The scene of which frame k is seen by the k-th camera, and what follows by the last. They share a field of view."""
    poses = np.array([c.transform for c in cameras])
    rotations = Rotation.from_matrix(poses[:, :, :3]).as_quat()
    times = np.arange(len(cameras), dtype=float)
    track = Track(times, poses[:, :, 3], rotations, np.ones((len(cameras), 3)), step=True)
    camera = replace(cameras[0], motion=(track,))
    return replace(scene, camera=camera, defaults=replace(scene.defaults, fps=1.0))


def orbit(count: int, step: float = 0.05) -> list[Camera]:
    """Cameras on their way round the origin."""
    angles = 0.4 + step * np.arange(count)
    return [view((4 * np.sin(a), 2.5, 4 * np.cos(a)), (0, 0.5, 0)) for a in angles]


def yard(count: int = 8, moving: bool = True, eye_distance: float = 0.06) -> Scene:
    """A diffuse ball over a diffuse floor, a smaller one that flies past it where `moving`, sun and sky."""
    scene = lit(
        floor(6), ball(0.8, 2, 1), ball(0.3, 1, 2),
        camera=orbit(1)[0], materials=[grey(0.6), Material("red", (0.8, 0.3, 0.2)), grey(0.9)],
        lights=[DirectionalLight((0.48, -0.8, 0.36), (2.0, 1.8, 1.5))], environment=(0.3, 0.4, 0.5),
        instances=[(0, IDENTITY), (1, at((0, 0.8, 0))), (2, at((-1.2, 0.4, 1)))], eye_distance=eye_distance,
    )  # fmt: skip
    if moving:
        fly = Track(
            np.array([0.0, count]),
            np.array([(-1.2, 0.4, 1), (1.5, 1.2, 1)]),
            np.tile([0, 0, 0, 1.0], (2, 1)),
            np.ones((2, 3)),
        )
        scene = replace(scene, instances=(*scene.instances[:2], replace(scene.instances[2], motion=(fly,))))
    return along(scene, orbit(count)) if moving else scene


def at(place: Sequence[float], scale: float = 1.0) -> np.ndarray:
    """(3, 4): a transform."""
    return np.column_stack([scale * np.eye(3), place])


@dataclass(frozen=True)
class Held:
    """What a cache holds. occupied, visible: (slots, pixels) bool. first_hit: (slots, pixels, 4). radiance: (slots, pixels, 3). count,
    age: (slots, pixels)."""

    occupied: np.ndarray
    visible: np.ndarray
    first_hit: np.ndarray
    radiance: np.ndarray
    count: np.ndarray
    age: np.ndarray

    @property
    def background(self) -> np.ndarray:
        """(slots, pixels) bool."""
        return self.occupied & (self.first_hit[..., 3] == NONE)


def held(renderer: Renderer, eye: str | None = None) -> Held:
    """The cache of an eye as the last frame left it."""
    arrays = renderer._graph.of(eye)
    words, first_hit, shading = (arrays[name].get() for name in ("mask", "first_hit", "shading"))
    slots = first_hit.shape[0]
    mask = (words.astype(np.uint64) << np.arange(0, 32 * words.shape[1], 32, dtype=np.uint64)).sum(
        axis=1, dtype=np.uint64
    )
    bits = mask >> np.arange(2 * slots, dtype=np.uint64)[:, None] & np.uint64(1) == 1
    return Held(
        bits[:slots], bits[slots:], first_hit,
        np.ascontiguousarray(shading[..., :3]).view(np.float32), shading[..., 3] & 0xFFFF, shading[..., 3] >> 16,
    )  # fmt: skip


def counters(frame: Frame, eye: str = "mono") -> dict[str, int]:
    """What the frame's counted."""
    return frame.stats["eyes"][eye]["cache"]


def in_child(code: str) -> list[int]:
    """What a process of its own prints, in words."""
    environment = {k: v for k, v in os.environ.items() if k not in ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")}
    environment["PYTHONPATH"] = os.pathsep.join(p or os.getcwd() for p in sys.path)
    command = [sys.executable, "-c", f"from cache_renders import SMALL, cached, yard\n{code}"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return [int(word) for word in done.stdout.split()]
