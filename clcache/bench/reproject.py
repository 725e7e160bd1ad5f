"""Forward reprojection of a sample cache (SampleCache, Fig. 6): its three variants, with and without radiance, and beside them a
reprojection of one sample for each pixel that is stored without any choice of slots.

The cache holds first hits of rays through random places of the pixels; the camera then moves a little.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from ..bvh.tracer import MISS, Tracer
from ..device import Device, event_seconds
from ..frame import Pass
from ..methods import PathState
from ..passes.reproject import (
    VARIANTS,
    CachePass,
    cache_buffers,
    cache_defines,
    listed_length,
    mask_words,
    reproject_buffers,
    reproject_passes,
)
from ..renderer import camera_record
from ..resources import SceneResources
from ..scene.model import Camera, Scene
from ..scene.motion import pose_at
from ..scene.transform import rigid
from .job import Job
from .result import Result

FAMILY = "reproject"
USUAL = ("cornell", "city")
SLOTS, PER_PIXEL = 12, 4  # the method's usual slots, and samples for each pixel
_SEEN = 0.9  # the part of the samples that are visible
_COMMON = 2  # passes that all variants have: the list, the projection
_STEP = 1.5  # pixels that the camera's step moves what is at the median distance
_FIXED_ONE = 0xFFFFFF  # of barycentric coordinates in cl/scene/first_hit.cl


@dataclass(frozen=True)
class CacheContent:
    """A cache's arrays, and the camera that sees it. mask: (pixels, words). first_hit, shading: (slots, pixels, 4). All uint32.
    The first three words of a sample's radiance say whose it is: slot * pixels + pixel."""

    mask: np.ndarray
    first_hit: np.ndarray
    shading: np.ndarray
    camera: Camera

    def of_first_slot(self) -> "CacheContent":
        """A cache of one slot with one visible sample for each pixel."""
        mask = np.full((self.mask.shape[0], 1), 0b11, np.uint32)
        return CacheContent(mask, self.first_hit[:1], self.shading[:1], self.camera)


def cache_content(
    tracer: Tracer, scene: Scene, size: tuple[int, int], seen: float = _SEEN, seed: int = 1
) -> CacheContent:
    """PER_PIXEL first hits in each pixel, seen from a camera that has moved to the right and ahead since. seen: the part of
    them that is visible."""
    rng, pixels = np.random.default_rng(seed), size[0] * size[1]
    motion = scene.camera.motion
    transform = rigid(pose_at(motion, 0.0)) if motion else np.array(scene.camera.transform, np.float64)
    hits, distance = _first_hits(tracer, replace(scene.camera, transform=transform), size, rng)
    first_hit, shading = np.zeros((2, SLOTS, pixels, 4), np.uint32)
    first_hit[:PER_PIXEL] = hits
    sample = np.arange(SLOTS * pixels, dtype=np.uint32).reshape(SLOTS, pixels)
    shading[...] = np.stack([sample, sample, sample, np.ones_like(sample)], axis=-1)
    visible = rng.random((PER_PIXEL, pixels)) < seen
    visibility = (visible << np.arange(PER_PIXEL, dtype=np.uint64)[:, None]).sum(axis=0, dtype=np.uint64)
    mask = visibility << np.uint64(SLOTS) | np.uint64((1 << PER_PIXEL) - 1)
    words = mask[:, None] >> np.arange(0, 32 * mask_words(SLOTS), 32, dtype=np.uint64)
    hit = np.isfinite(distance)
    across = 2 * np.tan(scene.camera.fov_y / 2) / size[1] * float(np.median(distance[hit])) if hit.any() else 0.0
    moved = transform.copy()
    moved[:, 3] += _STEP * across * (transform[:, 0] - transform[:, 2])
    camera = replace(scene.camera, transform=moved, motion=())
    return CacheContent((words & np.uint64(0xFFFFFFFF)).astype(np.uint32), first_hit, shading, camera)


def _first_hits(
    tracer: Tracer, camera: Camera, size: tuple[int, int], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(PER_PIXEL, pixels, 4) uint32 as the cache has them, and their distances."""
    width, height = size
    y, x = np.divmod(np.tile(np.arange(width * height), PER_PIXEL), width)
    slope = np.tan(camera.fov_y / 2)
    across = (2 * (x + rng.random(x.size)) / width - 1) * slope * width / height
    up = (1 - 2 * (y + rng.random(x.size)) / height) * slope
    directions = np.stack([across, up, np.full(x.size, -1.0)], axis=1) @ camera.transform[:, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = tracer.closest_hit(np.broadcast_to(camera.transform[:, 3], directions.shape), directions)
    missed = hits["instance"] == MISS
    places = np.where(missed[:, None], _octahedral(directions), np.stack([hits["u"], hits["v"]], axis=1))
    fixed = np.floor(np.clip(places, 0, 1) * _FIXED_ONE + 0.5).astype(np.uint32)
    words = np.stack([*fixed.T, hits["primitive"], hits["instance"]], axis=1)
    return words.reshape(PER_PIXEL, width * height, 4), hits["t"]


def _octahedral(directions: np.ndarray) -> np.ndarray:
    """(n, 2) in [0, 1], of unit vectors (n, 3)."""
    x, y, z = (directions / np.abs(directions).sum(axis=1, keepdims=True)).T
    below = z < 0
    folded = np.copysign(1 - np.abs(y), x), np.copysign(1 - np.abs(x), y)
    return 0.5 + 0.5 * np.stack([np.where(below, folded[0], x), np.where(below, folded[1], y)], axis=1)


class Reprojection:
    """The passes of a variant with arrays of their own, which hold a cache. variant: as of `reproject_passes`, or "simple"."""

    def __init__(
        self, device: Device, scene: SceneResources, size: tuple[int, int], content: CacheContent, variant: str,
        has_radiance: bool = True,
    ):  # fmt: skip
        self._device, self._content, slots, pixels = device, content, content.first_hit.shape[0], size[0] * size[1]
        self._state = PathState(camera_record(content.camera, size), (0, 0), 1)
        is_simple = variant == "simple"
        known = VARIANTS[0] if is_simple else variant
        buffers = cache_buffers(pixels, slots, has_radiance) + reproject_buffers(pixels, slots, known)
        self.arrays: dict[str, cl_array.Array] = {b.name: device.empty(b.shape, b.dtype, b.name) for b in buffers}
        for name in ("mask", "first_hit", *(("shading",) if has_radiance else ())):
            self.arrays[f"{name}_before"].set(getattr(content, name))
            self.arrays[name].set(getattr(content, name))  # memory that nothing was written to is not there yet
        passes = reproject_passes(device, scene, size, slots, known, has_radiance)
        self._passes: Sequence[Pass] = passes
        if is_simple:
            self._passes = (*passes[:_COMMON], _StoreSamples(device, size, cache_defines(slots, has_radiance)))

    def _run(self, step: Pass) -> float:
        events = [event for event in step.run(self.arrays, self._state) if event is not None]
        self._device.queue.finish()
        return sum(map(event_seconds, events))

    def run_common(self) -> dict[str, float]:
        """List and project the samples. Seconds of each pass, by name."""
        return {step.name: self._run(step) for step in self._passes[:_COMMON]}

    def run_slots(self) -> dict[str, float]:
        """Give the samples slots, and fill them. Seconds of each pass, by name."""
        return {step.name: self._run(step) for step in self._passes[_COMMON:]}

    @property
    def listed(self) -> int:
        """How many samples there were in the last run."""
        return listed_length(self.arrays)

    def release(self) -> None:
        """Give back the arrays."""
        self._device.release(*self.arrays.values())


class _StoreSamples(CachePass):
    """Each sample to the only slot of where it appears (`cl/bench/reproject.cl`)."""

    name = "store"

    def __init__(self, device: Device, size: tuple[int, int], defines: dict[str, int | bool]):
        super().__init__(device, size, defines, "bench/reproject.cl", "store_samples")

    def run(self, arrays, state) -> Iterator[cl.Event | None]:
        """Store them, run by run of the list."""
        yield self._over_runs(arrays)


def reproject(job: Job) -> Iterator[Result]:
    """Seconds of the passes and of all together. One sample's are the reciprocal of the rate. The list and the projection, which
    the variants have in common, count in their totals."""
    for name, scene in job.loaded(*USUAL):
        device = Device(job.device, job.threads)
        content = cache_content(Tracer(scene, device), scene, job.size)
        resources = SceneResources(device, scene)
        variants = [(variant, has_radiance) for variant in VARIANTS for has_radiance in (True, False)]
        for variant, has_radiance in (*variants, ("simple", True), ("simple", False)):
            held = content.of_first_slot() if variant == "simple" else content
            passes = Reprojection(device, resources, job.size, held, variant, has_radiance)
            runs = [passes.run_common() | passes.run_slots() for _ in range(job.repeats + 1)][1:]
            items, label = passes.listed, variant if has_radiance else f"{variant}-no-shade"
            for step in runs[0]:
                seconds = tuple(run[step] for run in runs)
                is_common = step in ("list", "project")
                if not is_common or (variant, has_radiance) == variants[0]:
                    yield Result(FAMILY, step if is_common else f"{label} {step}", name, items, "samples", seconds)
            nbytes = items * 2 * (32 if has_radiance else 16) + 2 * held.mask.nbytes
            yield Result(FAMILY, label, name, items, "samples", tuple(sum(r.values()) for r in runs), nbytes)
            passes.release()
