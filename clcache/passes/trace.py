"""Rays in, hits out. The buffers `ray_*` and `shadow_*` are planes over the paths of a sample, one path for each pixel."""

from collections.abc import Iterable

import pyopencl as cl

from ..device import Device
from ..frame import Buffer, Pass
from ..resources import SceneResources

HITS = ("hit_t", "hit_uv", "hit_primitive", "hit_instance")


def ray_buffers(n: int) -> list[Buffer]:
    """The path's current ray, and what it hit."""
    return [
        Buffer("ray_origin", (3, n)),
        Buffer("ray_direction", (3, n)),
        Buffer("ray_length", (n,)),
        Buffer("cone", (2, n)),
        Buffer("hit_t", (n,)),
        Buffer("hit_uv", (2, n)),
        Buffer("hit_primitive", (n,), "u4"),
        Buffer("hit_instance", (n,), "u4"),
    ]


class Generate(Pass):
    """Camera rays, and paths that have gathered nothing yet (`cl/pathtrace/generate.cl`)."""

    name = "generate"

    def __init__(self, device: Device, scene: SceneResources, sobol: bool):
        self._kernel = device.program("pathtrace/generate.cl", SOBOL=sobol)["generate"]
        carried = [("density", scene.features["HAS_EMISSION"]), ("cone", scene.features["HAS_TEXTURES"])]
        used = tuple(buffer for buffer, is_used in carried if is_used)
        self.writes = ("ray_origin", "ray_direction", "ray_length", "throughput", "radiance", *used)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One camera ray for each pixel of the state's camera."""
        n = arrays["ray_length"].size
        yield self._kernel.run(n, arrays, n=n, camera=state.camera, **state.sampling)


class Trace(Pass):
    """The nearest hits of the paths' rays (`cl/bvh/trace.cl`)."""

    name = "trace"
    reads = ("ray_origin", "ray_direction", "ray_length")
    writes = HITS

    def __init__(self, scene: SceneResources):
        self._rays = scene.rays

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One traversal for each path that still has a ray."""
        origin, direction, length = (arrays[b] for b in self.reads)
        yield self._rays.closest_hit(origin, direction, None, length, *(arrays[b] for b in HITS))


class Shadow(Pass):
    """Whether anything stands between the paths' points and the lights that they chose (`cl/bvh/trace.cl`)."""

    name = "shadow"
    reads = ("shadow_origin", "shadow_direction", "shadow_length")
    writes = ("occluded",)

    def __init__(self, scene: SceneResources):
        self._rays = scene.rays

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One traversal for each path that has a shadow ray."""
        origin, direction, length = (arrays[b] for b in self.reads)
        yield self._rays.any_hit(origin, direction, None, length, arrays["occluded"])
