"""Which samples of a cache are shaded in a frame, and their paths (SampleCache, sections 3.3 and 3.5;
`cl/samplecache/{choose,shade}.cl`)."""

from collections.abc import Iterable, Mapping

import pyopencl as cl

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..program import Program
from ..resources import SceneResources
from .materials import FIRST_VALUES, values_as
from .reproject import GROUP, counter_defines
from .retrace import batch, draws
from .trace import BLOCK, HITS

_BINS = 13  # M; as in cl/samplecache/choose.cl
_COUNTS = 1024  # as there


def radiance_buffers(pixels: int, paths: int, capacity: int, rays: int, is_adaptive: bool) -> list[Buffer]:
    """The list of what is shaded, and, for adaptive shading, which count is in which bin of importance, how many samples are in
    each, and the least and the most count of a frame; each pixel's samples that can be shaded, and their count; of each
    block of paths the one of whose pixel a sample is shaded always."""
    buffers = [Buffer(name, (capacity,), "u4") for name in ("shaded", "stream")]
    buffers += [Buffer("path_stream", (rays,), "u4")]
    if is_adaptive:
        buffers += [Buffer("histogram", (_BINS + 1,), "u4"), Buffer("bin_of", (_COUNTS,), "u1")]
        buffers += [Buffer("shadable", (pixels, 2), "u4"), Buffer("base_path", (paths // BLOCK**2,), "u4")]
        buffers += [Buffer(name, (2,), "u4", persistent=True, per_eye=True) for name in IMPORTANCE]
    return buffers


IMPORTANCE = ("count_range", "count_range_before")


class CountImportance(Pass):
    """How many samples have which importance."""

    name = "importance"
    reads = ("pixel", "mask", "shading", "count_range_before")
    writes = ("histogram", "count_range", "bin_of", "shadable", "base_path")

    def __init__(self, device: Device, defines: Mapping[str, int | bool]):
        program = _choose(device, defines, True)
        kernels = "divide_importance", "find_shadable", "count_importance"
        self._divide, self._find, self._count = (program[kernel] for kernel in kernels)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Pixel by pixel, then block by block."""
        pixels, n = arrays["mask"].shape[0], arrays["pixel"].size
        yield fill(arrays["histogram"], 0)
        ranges = {"count_range": arrays["count_range_before"], "next_range": arrays["count_range"]}
        yield self._divide.run(_COUNTS, arrays, **ranges, counts=_COUNTS)
        yield self._find.run(-(-pixels // GROUP), arrays, pixels=pixels)
        yield self._count.run(n // BLOCK**2, arrays, n=n, blocks=n // BLOCK**2, update=state.update % 2**32)


class Choose(Pass):
    """List the samples that are shaded. rate: samples per pixel."""

    name = "choose"
    writes = ("shaded", "stream", "listed", "counters")

    def __init__(self, device: Device, defines: Mapping[str, int | bool], shading: str, rate: float):
        is_adaptive = shading == "adaptive"
        self._kernel, self._rate = _choose(device, defines, is_adaptive)["choose"], rate
        importance = ("histogram", "bin_of", "shadable", "base_path") if is_adaptive else ()
        kept = "shading" if defines["HAS_RADIANCE"] else "first_hit"
        self.reads = ("pixel", "mask", kept, "counters", *importance)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group."""
        yield fill(arrays["listed"], 0)
        groups = arrays["group_first"].size
        scalars = {"n": arrays["pixel"].size, "pixels": arrays["mask"].shape[0], "groups": groups}
        yield self._kernel.run(groups, arrays, rate=self._rate, **scalars, **draws(state))


def _choose(device: Device, defines: Mapping[str, int | bool], is_adaptive: bool) -> Program:
    return device.program("samplecache/choose.cl", **defines, ADAPTIVE_SHADING=is_adaptive, **counter_defines())


def _shade(device: Device, scene: SceneResources, demodulate: bool) -> Program:
    return device.program("samplecache/shade.cl", DEMODULATE=demodulate, **scene.defines)


class BeginPaths(Pass):
    """Put the samples of the current batch into the path tracer's queue, as if rays had just found them."""

    name = "begin"
    reads = ("shaded", "stream", "listed", "first_hit")

    def __init__(self, device: Device, scene: SceneResources, demodulate: bool):
        self._scene = scene
        self._kernel = _shade(device, scene, demodulate)["begin_paths"]
        optional = {"density": "HAS_EMISSION", "cone": "HAS_TEXTURES", "shadow_length": "HAS_DIRECT"}
        used = tuple(buffer for buffer, feature in optional.items() if scene.features[feature])
        rays = ("ray_direction", "ray_length", "path_stream")
        self.writes = (*rays, *HITS, "throughput", "radiance", "path", "alive", *used)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One path for each place of the batch."""
        n = arrays["ray_length"].size
        scalars = {"camera": state.camera, "n": n, **batch(arrays, state, 1)}
        yield self._kernel.run(n, arrays, self._scene.arrays, **scalars)


class Accumulate(Pass):
    """Add what the paths brought to their samples. alpha: the part that each new value gets; 0: by how many there are."""

    name = "accumulate"
    writes = ("shading",)

    def __init__(self, device: Device, scene: SceneResources, demodulate: bool, alpha: float):
        self._scene, self._alpha = scene, alpha
        self._kernel = _shade(device, scene, demodulate)["accumulate"]
        self._values = (FIRST_VALUES,) if scene.graphs else ()
        self.reads = ("shaded", "listed", "first_hit", "radiance", "shading", *self._values)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One sample for each path."""
        n, scalars = arrays["ray_length"].size, batch(arrays, state, 1)
        scalars |= {"camera": state.camera, "n": n, "fixed_part": self._alpha}
        yield self._kernel.run(n, values_as(arrays, *self._values), self._scene.arrays, **scalars)
