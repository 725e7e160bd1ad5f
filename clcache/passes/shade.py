"""Hits in, surfaces, light and the next rays out."""

from collections.abc import Iterable

import pyopencl as cl

from ..device import Device
from ..frame import Buffer, Pass
from ..resources import SceneResources

SURFACE = ("point", "offset", "geometric_normal", "shading_normal", "albedo")
SHADOW_RAY = ("shadow_direction", "shadow_length", "shadow_radiance")


def path_buffers(n: int) -> list[Buffer]:
    """The surfaces that the paths' rays hit, their shadow rays, and what they carry and gather."""
    return [
        Buffer("point", (3, n)),
        Buffer("offset", (n,)),
        Buffer("geometric_normal", (3, n)),
        Buffer("shading_normal", (3, n)),
        Buffer("albedo", (3, n)),
        Buffer("shadow_direction", (3, n)),
        Buffer("shadow_length", (n,)),
        Buffer("shadow_radiance", (3, n)),
        Buffer("occluded", (n,), "u1"),
        Buffer("throughput", (3, n)),
        Buffer("radiance", (3, n)),
        Buffer("ray_counts", (2, n), "u4"),
    ]


class Surface(Pass):
    """What the rays hit: point, normals, albedo (`cl/scene/surface.cl`)."""

    name = "surface"
    reads = ("ray_direction", "hit_uv", "hit_primitive", "hit_instance")
    writes = SURFACE

    def __init__(self, device: Device, scene: SceneResources):
        self._scene = scene
        defines = {key: scene.features[key] for key in ("HAS_NORMALS", "HAS_TEXTURES")}
        self._kernel = device.program("scene/surface.cl", **defines)["surface"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One surface for each path that hit something."""
        n = arrays["hit_instance"].shape[0]
        hits = (arrays[b] for b in self.reads)
        yield self._kernel(*self._scene.surface_arrays(), *hits, *(arrays[b] for b in SURFACE), n, count=n)


class Emission(Pass):
    """Light that the rays found themselves, on emissive surfaces or from the environment (`cl/pathtrace/gather.cl`)."""

    name = "emission"
    reads = ("hit_primitive", "hit_instance", "ray_length", "throughput", "radiance")
    writes = ("radiance",)

    def __init__(self, device: Device, scene: SceneResources):
        self._scene = scene
        self._kernel = device.program("pathtrace/gather.cl")["emission"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Add what each path's ray found."""
        n, scene = arrays["ray_length"].shape[0], self._scene
        found = (arrays[b] for b in self.reads)
        tables = (scene.trees.instances, scene.material, scene.materials)
        yield self._kernel(*tables, *found, n, *map(float, scene.environment), count=n)


class Shade(Pass):
    """The paths' next rays, and a shadow ray to a light where the scene has lights (`cl/pathtrace/shade.cl`).

    vertex: number of the surface along the path, 0 for the first hit. roulette: first bounce that may end a path. is_last:
    no ray is traced after this one.
    """

    name = "shade"

    def __init__(self, device: Device, scene: SceneResources, vertex: int, roulette: int, is_last: bool):
        self._scene, self._vertex, self._roulette, self._is_last = scene, vertex, roulette, is_last
        self._kernel = device.program("pathtrace/shade.cl", HAS_LIGHTS=scene.features["HAS_LIGHTS"])["shade"]
        shadow_ray = SHADOW_RAY if scene.features["HAS_LIGHTS"] else ()
        self.reads = ("hit_instance", *SURFACE, "throughput", "ray_counts")
        self.writes = ("ray_origin", "ray_direction", "ray_length", "throughput", *shadow_ray, "ray_counts")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One vertex of each path."""
        n, scene = arrays["ray_length"].shape[0], self._scene
        used = ("hit_instance", *SURFACE, "ray_origin", "ray_direction", "ray_length", "throughput", *SHADOW_RAY)
        buffers = (arrays.get(b) for b in (*used, "ray_counts"))
        choice = (scene.light_count, self._vertex, self._roulette, int(self._is_last))
        yield self._kernel(scene.lights, *buffers, n, *choice, state.sample, *state.key, count=n)


class Direct(Pass):
    """Light that the shadow rays let through (`cl/pathtrace/gather.cl`)."""

    name = "direct"
    reads = ("occluded", "shadow_length", "shadow_radiance", "radiance")
    writes = ("radiance",)

    def __init__(self, device: Device):
        self._kernel = device.program("pathtrace/gather.cl")["direct"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Add what each path's light brings."""
        n = arrays["shadow_length"].shape[0]
        yield self._kernel(*(arrays[b] for b in self.reads), n, count=n)
