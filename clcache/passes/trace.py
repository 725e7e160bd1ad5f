"""Rays in, hits out. Buffers are planes over the paths of a sample, one path for each pixel, in the order of
`cl/common/pixel_order.cl`; `pixel` says which is whose. Between vertices the paths that go on close ranks: rays, hits
and throughput are then by place in the queue, and `path` says whose. A ray of length 0 is none."""

from collections.abc import Iterable

import pyopencl as cl

from ..device import Device
from ..frame import Buffer, Pass
from ..resources import SceneResources

HITS = ("hit_t", "hit_uv", "hit_primitive", "hit_instance")
BLOCK = 4  # pixels along the side of a block, as in pixel_order.cl
CHUNK = 4096  # places of the queue, as in queue.cl


def stamp(state) -> int:
    """When an update of an eye is, modulo 2^32: odd for the first eye."""
    return (2 * state.update + state.eye + 1) % 2**32


def path_count(size: tuple[int, int]) -> int:
    """How many paths an image of this width and height has: whole blocks of pixels."""
    return -(-size[0] // BLOCK) * -(-size[1] // BLOCK) * BLOCK**2


def ray_buffers(n: int) -> list[Buffer]:
    """The path's pixel; for each place in the queue its path, that one's current ray, and what it hit; the paths in each chunk
    of places."""
    return [
        Buffer("pixel", (n,), "u4", persistent=True),
        Buffer("path", (n,), "u4"),
        Buffer("alive", (-(-n // CHUNK),), "u4"),
        Buffer("ray_origin", (3, n)),
        Buffer("ray_direction", (3, n)),
        Buffer("ray_start", (n,)),
        Buffer("ray_length", (n,)),
        Buffer("cone", (2, n)),
        Buffer("hit_t", (n,)),
        Buffer("hit_uv", (2, n)),
        Buffer("hit_primitive", (n,), "u4"),
        Buffer("hit_instance", (n,), "u4"),
    ]


class OrderPixels(Pass):
    """Which pixel each path belongs to (`cl/common/pixel_order.cl`): found out once."""

    name = "order"
    writes = ("pixel",)

    def __init__(self, device: Device, scene: SceneResources, size: tuple[int, int], sobol: bool):
        self._size = {"width": size[0], "height": size[1]}
        self._kernel = device.program("pathtrace/generate.cl", SOBOL=sobol, **scene.features)["order_pixels"]
        self._is_done = False

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One pixel for each path."""
        if self._is_done:
            return
        self._is_done, n = True, arrays["pixel"].size
        yield self._kernel.run(n, arrays, n=n, **self._size)


class Generate(Pass):
    """Camera rays, and paths that have gathered nothing yet (`cl/pathtrace/generate.cl`)."""

    name = "generate"
    reads = ("pixel",)

    def __init__(self, device: Device, scene: SceneResources, sobol: bool):
        self._kernel = device.program("pathtrace/generate.cl", SOBOL=sobol, **scene.features)["generate"]
        carried = [("density", scene.features["HAS_EMISSION"]), ("cone", scene.features["HAS_TEXTURES"])]
        used = tuple(buffer for buffer, is_used in carried if is_used)
        rays = ("ray_origin", "ray_direction", "ray_start", "ray_length")
        self.writes = (*rays, "throughput", "radiance", "path", "alive", *used)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One camera ray for each pixel of the state's camera."""
        n = arrays["ray_length"].size
        yield self._kernel.run(n, arrays, n=n, camera=state.camera, **state.sampling)


class TraceCamera(Pass):
    """The nearest hits of the camera's rays, of which neighbouring paths have like ones (`cl/bvh/trace.cl`)."""

    name = "trace_camera"
    reads = ("ray_origin", "ray_direction", "ray_start", "ray_length")
    writes = HITS

    def __init__(self, scene: SceneResources):
        self._rays = scene.rays

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One traversal for each path."""
        yield self._rays.closest_hit(*(arrays[b] for b in (*self.reads, *HITS)), coherent=True)


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
    """Whether anything stands between the paths' points and the lights that they chose (`cl/bvh/trace.cl`). Even the first
    hits' rays are not alike enough to gain from going as packets."""

    name = "shadow"
    reads = ("shadow_origin", "shadow_direction", "shadow_length")
    writes = ("occluded",)

    def __init__(self, scene: SceneResources):
        self._rays = scene.rays

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One traversal for each path that has a shadow ray."""
        origin, direction, length = (arrays[b] for b in self.reads)
        yield self._rays.any_hit(origin, direction, None, length, arrays["occluded"])
