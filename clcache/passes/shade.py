"""Hits in, light and the next rays out (`cl/pathtrace/shade.cl`)."""

from collections.abc import Iterable

import pyopencl as cl

from ..device import Device
from ..frame import Buffer, Pass
from ..resources import SceneResources
from .materials import VALUES, values_as
from .trace import HITS

_SHADOW_RAY = ("shadow_origin", "shadow_direction", "shadow_length", "shadow_radiance")


def path_buffers(n: int) -> list[Buffer]:
    """The paths' shadow rays, and what they carry and gather."""
    return [
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


class _ShadePass(Pass):
    """A kernel of shade.cl, one work-item for each path."""

    def __init__(self, device: Device, scene: SceneResources, kernel: str, sobol: bool, values: str = VALUES):
        self._scene, features = scene, scene.features
        self._kernel = device.program("pathtrace/shade.cl", SOBOL=sobol, **scene.defines)[kernel]
        self._cone = ("cone",) if features["HAS_TEXTURES"] else ()
        self._values = (values,) if features["HAS_GRAPHS"] else ()
        self._density = ("density",) if features["HAS_EMISSION"] else ()
        self._is_lit = features["HAS_DIRECT"]

    def _launch(self, arrays, **scalars) -> cl.Event | None:
        n, scene = arrays["ray_length"].size, self._scene
        arrays = values_as(arrays, *self._values)
        return self._kernel.run(n, arrays, scene.arrays, n=n, environment=scene.environment, **scalars)


class Shade(_ShadePass):
    """One vertex of the paths: the light that they found on the way, their next rays, and shadow rays where there are lights.

    vertex: number of the surface along the path, 0 for the first hit. roulette: first bounce that may end a path. is_last:
    no ray is traced after this one. stream: the buffer that says, by path, whose random numbers it takes. own_light: whether
    what a ray found counts that shines by itself. values: the buffer of what the hits' graphs returned.
    """

    name = "shade"

    def __init__(
        self,
        device: Device,
        scene: SceneResources,
        vertex: int,
        roulette: int,
        is_last: bool,
        sobol: bool,
        stream: str = "pixel",
        own_light: bool = True,
        values: str = VALUES,
    ):
        super().__init__(device, scene, "shade", sobol, values)
        self._stream = stream
        self._place = {"vertex": vertex, "roulette": roulette, "is_last": int(is_last), "own_light": int(own_light)}
        self._place["emitters"] = scene.emitter_count
        path = ("ray_length", "throughput", "radiance", "ray_counts", *self._density, *self._cone)
        shadow_ray = _SHADOW_RAY if self._is_lit else ()
        self.reads = (stream, "path", "alive", *HITS, *self._values, "ray_direction", *path)
        self.writes = ("ray_origin", "ray_direction", *path, *shadow_ray)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One vertex of each path."""
        yield self._launch(arrays, pixel=arrays[self._stream], **self._place, **state.sampling)


class Compact(Pass):
    """Add what the shadow rays let through, and close the ranks of the paths that go on (`cl/pathtrace/compact.cl`). is_settled: whether
    others have seen to the shadow rays."""

    name = "compact"

    def __init__(self, device: Device, scene: SceneResources, is_settled: bool = False):
        features = scene.features
        optional = {"HAS_DIRECT": "shadow_length", "HAS_EMISSION": "density", "HAS_TEXTURES": "cone"}
        defines = {feature: features[feature] for feature in optional}
        self._kernel = device.program("pathtrace/compact.cl", SETTLED=is_settled, **defines)["compact"]
        carried = ("ray_origin", "ray_direction", "ray_length", "throughput", "path", "alive")
        light = () if is_settled else ("radiance",)
        self.writes = (*carried, *light, *(b for feature, b in optional.items() if features[feature]))
        brought = ("occluded", "shadow_radiance") if features["HAS_DIRECT"] and not is_settled else ()
        self.reads = (*self.writes, *brought)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One chunk of the queue for each work-item."""
        chunks = arrays["alive"].size
        yield self._kernel.run(chunks, arrays, n=arrays["path"].size, chunks=chunks)


class Finish(_ShadePass):
    """The end of the paths: what the last rays found."""

    name = "finish"

    def __init__(self, device: Device, scene: SceneResources, sobol: bool):
        super().__init__(device, scene, "finish", sobol)
        self._values = self._values if any("emission" in g.outputs for g in scene.graphs) else ()
        carried = ("ray_direction", "ray_length", "throughput", "density", *self._cone, *HITS)
        self.reads = ("path", "alive", *carried, *self._values, "radiance")
        self.writes = ("radiance",)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Add what each path's last ray found."""
        yield self._launch(arrays)


class FirstHits(_ShadePass):
    """Sum albedos and normals of the first hits."""

    name = "first_hits"
    writes = ("albedo_sum", "N_sum")

    def __init__(self, device: Device, scene: SceneResources, sobol: bool):
        super().__init__(device, scene, "first_hits", sobol)
        self.reads = ("ray_direction", *HITS, *self._values, *self._cone, *self.writes)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Add this sample's surfaces."""
        yield self._launch(arrays)
