"""From the visible samples of a cache to the image and its AOVs (SampleCache, section 3.3; `cl/samplecache/reconstruct.cl`)."""

from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping

import pyopencl as cl

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..program import Program
from ..resources import SceneResources
from .materials import SEEN_VALUES, GraphSetup, Materials, values_as
from .reproject import GROUP
from .retrace import batch, listed_length
from .trace import BLOCK, HITS

AOVS = tuple(f"aov_{name}" for name in ("albedo", "N", "Z", "variance", "samples", "occupancy", "visible", "age"))


# The list of visible samples: its buffers, by the names of those of other lists.
_SEEN = {"samples": "seen", "listed": "seen_listed", "group_first": "seen_first", "group_count": "seen_count"}
_SAMPLES, _LENGTH, _FIRST, _COUNT = _SEEN.values()


def reconstruct_buffers(pixels: int, groups: int, capacity: int, rays: int) -> list[Buffer]:
    """The list of visible samples, what those of a batch contribute, and the images."""
    vectors = ("aov_albedo", "aov_N", "aov_variance")
    shapes = {_SAMPLES: capacity, _LENGTH: 4, _FIRST: groups, _COUNT: groups}
    return [
        *(Buffer(name, (size,), "u4") for name, size in shapes.items()),
        Buffer("sample_value", (3, rays)),
        Buffer("sample_weight", (rays,)),
        Buffer("sample_albedo", (3, rays)),
        Buffer("sample_near", (rays,)),
        Buffer("sample_base", (3, rays)),
        Buffer("sample_normal", (3, rays)),
        Buffer("sample_depth", (rays,)),
        Buffer("sample_distance", (rays,)),
        Buffer("color", (pixels, 3), per_eye=True),
        Buffer("surface", (pixels, 4), "u4", per_eye=True),
        *(Buffer(name, (pixels, 3) if name in vectors else (pixels,)) for name in AOVS),
    ]


def seen(arrays: Mapping) -> Mapping:
    """The arrays, with the list of visible samples as the one that kernels and batches are about."""
    return ChainMap({name: arrays[buffer] for name, buffer in _SEEN.items() if buffer in arrays}, arrays)


def _reconstruct(device: Device, scene: SceneResources, defines: Mapping[str, int | bool]) -> Program:
    return device.program("samplecache/reconstruct.cl", **defines, **scene.defines)


def _nearest(device: Device, scene: SceneResources, defines: Mapping[str, int | bool]) -> Program:
    return device.program("samplecache/nearest.cl", **defines)


class _ReconstructPass(Pass):
    """A kernel of one of the programs over the list of visible samples."""

    def __init__(
        self,
        device: Device,
        scene: SceneResources,
        defines: Mapping[str, int | bool],
        kernel: str,
        program: Callable[..., Program] = _reconstruct,
    ):
        self._scene = scene
        self._kernel = program(device, scene, defines)[kernel]
        self._values = (SEEN_VALUES,) if scene.graphs else ()

    def _over_samples(self, arrays, state, **scalars) -> cl.Event | None:
        part = batch(seen(arrays), state, 0)
        scalars |= {"camera": state.camera, "n": arrays["ray_length"].size, **part}
        arrays = values_as(seen(arrays), *self._values)
        return self._kernel.run(part["entries"], arrays, self._scene.arrays, **scalars)

    def _over_groups(self, arrays, state) -> cl.Event | None:
        n, groups = arrays["ray_length"].size, arrays[_FIRST].size
        scalars = {"n_paths": arrays["pixel"].size, "n": n, "groups": groups, "first": state.batch * n}
        return self._kernel.run(groups, seen(arrays), **scalars)


class ListVisible(_ReconstructPass):
    """The list of all visible samples."""

    name = "list_visible"
    reads = ("pixel", "mask")
    writes = tuple(_SEEN.values())

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "list_visible")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group."""
        yield fill(arrays[_LENGTH], 0)
        groups = arrays[_FIRST].size
        scalars = {"n": arrays["pixel"].size, "pixels": arrays["mask"].shape[0], "groups": groups}
        yield self._kernel.run(groups, seen(arrays), batch=arrays["ray_length"].size, **scalars)


class ListedMaterials(Pass):
    """What the graphs of a list of samples say, by entry: of the current batch of it, or of all. listed: where `listed_length` finds the
    list's length, and which. is_batched: whether the list is worked off in batches. values: the buffer that gets them. The path tracer's
    queue is used for it."""

    name = "materials"

    def __init__(self, graphs: GraphSetup, samples: str, listed: tuple[str, int], is_batched: bool, values: str):
        self._scene, self._samples, self._listed, self._is_batched = graphs.scene, samples, listed, is_batched
        self._kernel = graphs.device.program("samplecache/list_hits.cl")["list_hits"]
        self._materials = Materials(graphs, True, values)
        queue = (*HITS, "ray_direction", "ray_length", "cone", "alive")
        self.reads = (samples, listed[0], "first_hit", *(b for b in self._materials.reads if b not in queue))
        self.writes, self.results = (*queue, *self._materials.writes), self._materials.results

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One place for each entry."""
        buffer, which = self._listed
        n, listed = arrays["ray_length"].size, {**arrays, "listed": arrays[buffer]}
        part = (
            batch(listed, state, which) if self._is_batched else {"first": 0, "entries": listed_length(listed, which)}
        )
        scalars = {"camera": state.camera, "n": n, **part}
        yield self._kernel.run(n, {"samples": arrays[self._samples]}, arrays, self._scene.arrays, **scalars)
        yield from self._materials.run_first(arrays, state, part["entries"])


class Resolve(_ReconstructPass):
    """The radiance of each visible sample of the current batch, and its weight."""

    name = "resolve"
    reads = (_SAMPLES, _LENGTH, "first_hit", "shading")

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "resolve")
        self.reads += self._values if defines["DEMODULATE"] else ()
        albedo = ("sample_albedo",) if defines["FILL"] and defines["DEMODULATE"] else ()
        self.writes = ("sample_value", "sample_weight", *albedo, *(("sample_near",) if defines["HAS_MOMENTS"] else ()))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One sample for each entry."""
        yield self._over_samples(arrays, state)


class Average(_ReconstructPass):
    """The mean over each pixel's samples."""

    name = "average"
    writes = ("color",)

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "average")
        albedo = ("sample_albedo",) if defines["FILL"] else ()
        self.reads = ("pixel", "mask", _FIRST, _COUNT, "sample_value", "sample_weight", *albedo)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group."""
        yield self._over_groups(arrays, state)


class AverageCache(Pass):
    """The mean over each pixel's samples, whose radiance is stored with albedo."""

    name = "average"
    reads = ("pixel", "mask", "shading")
    writes = ("color",)

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        program = _reconstruct(device, scene, defines)
        self._average, self._fill = program["average_cache"], program["fill_gaps"] if defines["FILL"] else None

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run; then what was left out, block by block."""
        n, pixels = arrays["pixel"].size, arrays["mask"].shape[0]
        yield self._average.run(-(-pixels // GROUP), arrays, pixels=pixels)
        if self._fill:
            yield self._fill.run(n // BLOCK**2, arrays, n=n)


class FindMoments(_ReconstructPass):
    """What stereo blending needs to know of each pixel's samples."""

    name = "moments"
    reads = ("pixel", "mask", "shading", _SAMPLES, _FIRST, _COUNT, "sample_value", "sample_near")
    writes = ("moments",)

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "find_moments")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group."""
        yield self._over_groups(arrays, state)


class ClearSurface(_ReconstructPass):
    """Start the search for each pixel's nearest sample: where none is visible, the background remains."""

    name = "surface"
    writes = ("surface",)

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "clear_surface", _nearest)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Pixel by pixel."""
        pixels = arrays["surface"].shape[0]
        yield self._kernel.run(pixels, arrays, camera=state.camera, pixels=pixels)


class Distance(_ReconstructPass):
    """How far away each visible sample of the current batch is."""

    name = "distance"
    reads = (_SAMPLES, _LENGTH, "first_hit")
    writes = ("sample_distance",)

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "measure", _nearest)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One sample for each entry."""
        yield self._over_samples(arrays, state)


class KeepNearest(_ReconstructPass):
    """The first hit of each pixel's nearest visible sample."""

    name = "surface"
    reads = ("pixel", "mask", "first_hit", _SAMPLES, _FIRST, _COUNT, "sample_distance")
    writes = ("surface",)

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "keep_nearest", _nearest)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group."""
        yield self._over_groups(arrays, state)


class Describe(_ReconstructPass):
    """The surface of each visible sample of the current batch."""

    name = "describe"
    reads = (_SAMPLES, _LENGTH, "first_hit")
    writes = ("sample_base", "sample_normal", "sample_depth")

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "describe")
        self.reads += self._values

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """One sample for each entry."""
        yield self._over_samples(arrays, state)


class FillAovs(_ReconstructPass):
    """The AOVs of each pixel."""

    name = "aovs"

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, int | bool]):
        super().__init__(device, scene, defines, "fill_aovs")
        samples = ("sample_value", "sample_weight", "sample_base", "sample_normal", "sample_depth")
        counts = "shading" if defines["HAS_RADIANCE"] else "answer_count"
        self.reads = ("pixel", "mask", counts, _SAMPLES, _FIRST, _COUNT, *samples, "color")
        self.writes = AOVS if defines["HAS_RADIANCE"] else tuple(b for b in AOVS if b != "aov_age")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Group by group. An `age` that is not of samples is left alone."""
        own = {name: a for name, a in arrays.items() if name in self.writes or not name.startswith("aov_")}
        yield self._over_groups(own, state)
