"""Which samples of a cache are traced in a frame, where samples are added and purged, and what their rays find (SampleCache,
sections 3.2 and 3.4; `cl/samplecache/{plan,retrace}.cl`)."""

from collections.abc import Iterable, Mapping

import pyopencl as cl

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..program import Program
from ..resources import SceneResources
from .reproject import counter_defines, listed_length
from .trace import HITS

TRACINGS = ("single", "multi", "adaptive")


def retrace_buffers(pixels: int, groups: int) -> list[Buffer]:
    """What is planned for each pixel, and where each group's part of a list of samples is."""
    return [
        Buffer("plan", (pixels,), "u1"),
        Buffer("group_first", (groups,), "u4"),
        Buffer("group_count", (groups,), "u4"),
        Buffer("aov_trace", (pixels,)),
    ]


def draws(state) -> dict[str, int]:
    """The scalars by which kernels draw random numbers for the samples of a cache; updates count modulo 2^32."""
    return {"update": state.update % 2**32, "key0": state.key[0], "key1": state.key[1]}


def _plan(device: Device, defines: Mapping[str, int | bool], tracing: str) -> Program:
    tracings = {"TRACING": TRACINGS.index(tracing)}
    return device.program("samplecache/plan.cl", **defines, **tracings, **counter_defines())


class Assess(Pass):
    """Where geometry has edges, and where there are too few samples or too many.

    tracing: one of TRACINGS. density: the least and the most samples per pixel that are left alone.
    """

    name = "assess"
    writes = ("plan",)

    def __init__(self, device: Device, defines: Mapping[str, int | bool], tracing: str, density: tuple[float, float]):
        self._kernel = _plan(device, defines, tracing)["assess"]
        self._density = {"least": density[0], "most": density[1]}
        self.reads = ("mask", *(("nearest", "farthest") if tracing == "adaptive" else ()))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Look at the neighbourhood of each pixel."""
        pixels = arrays["mask"].shape[0]
        scalars = {"camera": state.camera, "pixels": pixels, **self._density}
        yield self._kernel.run(pixels, arrays, **scalars, **draws(state))


class ListTraced(Pass):
    """Add and purge samples as was planned, and list those that are to be traced."""

    name = "plan"
    reads = ("pixel", "plan", "mask", "counters")
    writes = ("mask", "samples", "listed", "group_first", "group_count", "counters", "aov_trace")

    def __init__(self, device: Device, defines: Mapping[str, int | bool], tracing: str):
        self._kernel = _plan(device, defines, tracing)["list_traced"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group."""
        yield fill(arrays["listed"], 0)
        groups = arrays["group_first"].size
        scalars = {"n": arrays["pixel"].size, "pixels": arrays["mask"].shape[0], "groups": groups}
        yield self._kernel.run(groups, arrays, batch=arrays["ray_length"].size, **scalars, **draws(state))


def _retrace(device: Device, scene: SceneResources, defines: Mapping[str, int | bool]) -> Program:
    return device.program("samplecache/retrace.cl", **defines, **scene.defines)


class Aim(Pass):
    """Rays from the eye towards the samples of the current batch."""

    name = "aim"
    reads = ("samples", "listed", "first_hit")
    writes = ("ray_origin", "ray_direction", "ray_start", "ray_length")

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        self._scene = scene
        self._kernel = _retrace(device, scene, defines)["aim"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One ray for each place of the batch."""
        n, pixels = arrays["ray_length"].size, arrays["first_hit"].shape[1]
        scalars = {"camera": state.camera, "n": n, "pixels": pixels, **batch(arrays, state, 0)}
        yield self._kernel.run(n, arrays, self._scene.arrays, **scalars, **draws(state))


class Retrace(Pass):
    """What the rays of the current batch hit (`cl/bvh/trace.cl`). They all begin at the eye, but are too sparse to go as they come."""

    name = "retrace"
    reads = ("ray_origin", "ray_direction", "ray_start", "ray_length")
    writes = HITS

    def __init__(self, scene: SceneResources):
        self._rays = scene.rays

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One traversal for each ray."""
        yield self._rays.closest_hit(*(arrays[b] for b in (*self.reads, *HITS)))


class Settle(Pass):
    """Put new samples into the cache, say which of the others are visible, and replace a pixel's last one if it is not."""

    name = "settle"

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool], tracing: str):
        self.writes = ("mask", "first_hit", *(("shading",) if defines["HAS_RADIANCE"] else ()))
        self._scene, self._plan = scene, ("plan",) if tracing == "adaptive" else ()
        self._kernel = _retrace(device, scene, defines)["settle"]
        self.reads = ("samples", "group_first", "group_count", "ray_direction", *HITS[1:], "mask", *self._plan)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Those groups whose samples are in the current batch."""
        n, groups = arrays["ray_length"].size, arrays["group_first"].size
        scalars = {"n": n, "pixels": arrays["mask"].shape[0], "groups": groups, "first": state.batch * n}
        scalars["plan"] = arrays["plan"] if self._plan else None
        yield self._kernel.run(groups, arrays, self._scene.arrays, environment=self._scene.environment, **scalars)


def batches(arrays: Mapping, which: int) -> int:
    """In how many batches a list, of which `listed` has the length, is worked off."""
    return -(-listed_length(arrays, which) // arrays["ray_length"].size)


def batch(arrays: Mapping, state, which: int) -> dict[str, int]:
    """The scalars that tell kernels their batch of a list: where it begins, and how many entries it has."""
    first = state.batch * arrays["ray_length"].size
    return {"first": first, "entries": min(listed_length(arrays, which) - first, arrays["ray_length"].size)}
