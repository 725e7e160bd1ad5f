"""Renders by the methods with a table of voxels, and what the table holds then."""

from dataclasses import dataclass

import numpy as np
from render_helpers import MODELLED, floor, grey, lit, view

from clcache import Renderer
from clcache.renderer import Frame
from clcache.scene.model import DirectionalLight, Scene

CAPACITY = 2**16  # so many that all voxels of these images find a place
SUN = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
SMALL = (32, 24)


def voxels(scene: Scene, method: str = "voxelhash", size: tuple[int, int] = SMALL, **options) -> Renderer:
    """A renderer with a table, without temporal filter unless it is given one. options: of `Renderer`; settings of voxelhash by their
    last names; `bounces`, `sampler`."""
    names = ("capacity", "probe", "lifetime", "jitter", "gate", "lod", "level_bias", "inherit", "alpha")
    settings = {"voxelhash.capacity": CAPACITY}
    settings |= {f"voxelhash.{name}": options.pop(name) for name in names if name in options}
    settings |= {f"pathtrace.{name}": options.pop(name) for name in ("bounces", "sampler") if name in options}
    settings |= options.pop("settings", {})
    return Renderer(scene, method, size, settings=settings, **{"temporal": "none", "stereo": False, **options})


def modelled(scene: Scene, **options) -> Renderer:
    """The same with numbers that the tests' `camera_rays` knows, direct light only, and nothing that moves what is asked."""
    return voxels(scene, **{"jitter": False, "inherit": False, "bounces": 0, "sampler": MODELLED, **options})


def ground(albedo: float = 0.5, eye=(0, 3, 4), target=(0, 0, 0), degrees: float = 40, **options) -> Scene:
    """An endless floor, evenly lit by the sun: albedo is its radiance, without noise if there is direct light only."""
    options = {"lights": [SUN], **options}
    return lit(floor(200), camera=view(eye, target, degrees), materials=[grey(albedo)], **options)


@dataclass(frozen=True)
class Held:
    """What the entries of a table that were ever used hold. check, stamp: (n,) uint32. radiance: (n, 3). count: (n,)."""

    check: np.ndarray
    stamp: np.ndarray
    radiance: np.ndarray
    count: np.ndarray

    @property
    def counts(self) -> dict[int, float]:
        """By check hash."""
        return dict(zip(self.check.tolist(), self.count.tolist(), strict=True))

    @property
    def stamps(self) -> dict[int, int]:
        """By check hash."""
        return dict(zip(self.check.tolist(), self.stamp.tolist(), strict=True))


def held(renderer: Renderer) -> Held:
    """The table as the last frame left it, in the order of check hashes: where entries stand depends on the order of threads."""
    arrays = renderer._graph.of(renderer.eyes[0])
    key, values = arrays["voxel_key"].get(), arrays["voxel_radiance"].get()
    used = np.flatnonzero(key)
    used = used[np.argsort(key[used] >> np.uint64(32), kind="stable")]
    check, stamp = (key[used] >> np.uint64(32)).astype(np.uint32), (key[used] & np.uint64(0xFFFFFFFF)).astype(np.uint32)
    return Held(check, stamp, values[used, :3], values[used, 3])


def colours_of(frame: Frame, eye: str = "mono") -> np.ndarray:
    """(H, W) int: which pixels asked the same voxel; -1 where there was none."""
    rgb = np.round(frame.aov("voxel", eye).astype(float) * 2**24).astype(np.int64)
    ids = (rgb[..., 0] << 24) + rgb[..., 1]
    return np.where(np.isfinite(frame.aov("level", eye)), ids, -1)
