"""Hits in, surfaces, light and the next rays out."""

from collections.abc import Iterable

import pyopencl as cl

from ..device import Device
from ..frame import Buffer, Pass
from ..resources import SceneResources
from .trace import HITS

_POINT = ("point", "offset", "geometric_normal", "shading_normal", "albedo", "hit_material")
_SHADOW_RAY = ("shadow_origin", "shadow_direction", "shadow_length", "shadow_radiance")


def path_buffers(n: int) -> list[Buffer]:
    """The surfaces that the paths' rays hit, their shadow rays, and what they carry and gather."""
    return [
        Buffer("point", (3, n)),
        Buffer("offset", (n,)),
        Buffer("geometric_normal", (3, n)),
        Buffer("shading_normal", (3, n)),
        Buffer("albedo", (3, n)),
        Buffer("gloss", (2, n)),
        Buffer("emitted", (3, n)),
        Buffer("hit_material", (n,), "u4"),
        Buffer("shadow_origin", (3, n)),
        Buffer("shadow_direction", (3, n)),
        Buffer("shadow_length", (n,)),
        Buffer("shadow_radiance", (3, n)),
        Buffer("occluded", (n,), "u1"),
        Buffer("throughput", (3, n)),
        Buffer("density", (n,)),
        Buffer("radiance", (3, n)),
        Buffer("ray_counts", (2, n), "u4"),
    ]


def surface_buffers(scene: SceneResources) -> tuple[str, ...]:
    """The buffers that describe a hit, as far as the scene needs them."""
    optional = [("gloss", "HAS_SPECULAR"), ("emitted", "HAS_EMISSIVE"), ("cone", "HAS_TEXTURES")]
    return _POINT + tuple(buffer for buffer, feature in optional if scene.features[feature])


class Surface(Pass):
    """What the rays hit: point, normals and the parameters of the material there (`cl/scene/surface.cl`)."""

    name = "surface"

    def __init__(self, device: Device, scene: SceneResources):
        self._scene = scene
        self._kernel = device.program("scene/surface.cl", **scene.features)["surface"]
        self.writes = surface_buffers(scene)
        self.reads = ("ray_direction", *HITS, *(("cone",) if "cone" in self.writes else ()))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One surface for each path that hit something."""
        n = arrays["hit_instance"].size
        yield self._kernel.run(n, arrays, self._scene.arrays, n=n)


class Emission(Pass):
    """Light that the rays found themselves, on emissive surfaces or from the environment (`cl/pathtrace/gather.cl`)."""

    name = "emission"

    def __init__(self, device: Device, scene: SceneResources):
        self._scene = scene
        self._kernel = device.program("pathtrace/gather.cl", **scene.features)["emission"]
        ray = ("ray_direction", "ray_length", "hit_t", "hit_instance", "throughput", "density")
        surface = ("hit_material", "geometric_normal", "emitted") if scene.features["HAS_EMISSIVE"] else ()
        self.reads, self.writes = (*ray, *surface, "radiance"), ("radiance",)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Add what each path's ray found."""
        n = arrays["ray_length"].size
        yield self._kernel.run(n, arrays, self._scene.arrays, n=n, environment=self._scene.environment)


class Shade(Pass):
    """The paths' next rays, and a shadow ray to a light where the scene has lights (`cl/pathtrace/shade.cl`).

    vertex: number of the surface along the path, 0 for the first hit. roulette: first bounce that may end a path. is_last:
    no ray is traced after this one.
    """

    name = "shade"

    def __init__(self, device: Device, scene: SceneResources, vertex: int, roulette: int, is_last: bool, sobol: bool):
        self._scene = scene
        self._place = {"vertex": vertex, "roulette": roulette, "is_last": int(is_last), "emitters": scene.emitter_count}
        self._kernel = device.program("pathtrace/shade.cl", SOBOL=sobol, **scene.features)["shade"]
        surface = tuple(b for b in surface_buffers(scene) if b != "emitted")
        cone = ("cone",) if scene.features["HAS_TEXTURES"] else ()
        density = ("density",) if scene.features["HAS_EMISSION"] else ()
        shadow_ray = _SHADOW_RAY if scene.features["HAS_DIRECT"] else ()
        self.reads = ("hit_instance", *surface, "ray_direction", "throughput", "ray_counts")
        path = ("ray_origin", "ray_direction", "ray_length", "throughput", *density, *cone)
        self.writes = (*path, *shadow_ray, "ray_counts")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One vertex of each path."""
        n, scene = arrays["ray_length"].size, self._scene
        scalars = self._place | {"n": n, "environment": scene.environment}
        yield self._kernel.run(n, arrays, scene.arrays, **scalars, **state.sampling)


class Direct(Pass):
    """Light that the shadow rays let through (`cl/pathtrace/gather.cl`)."""

    name = "direct"
    reads = ("occluded", "shadow_length", "shadow_radiance", "radiance")
    writes = ("radiance",)

    def __init__(self, device: Device, scene: SceneResources):
        self._kernel = device.program("pathtrace/gather.cl", **scene.features)["direct"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Add what each path's light brings."""
        n = arrays["shadow_length"].size
        yield self._kernel.run(n, arrays, n=n)
