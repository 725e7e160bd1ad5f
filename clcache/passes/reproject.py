"""Forward reprojection: the samples of the last frame's cache go to the slots of the pixels in which they now appear
(SampleCache, section 3.1; `cl/samplecache/`).

First all samples are listed and projected. Then each gets a slot, in one of three ways: VARIANTS. What an invocation leaves is
the cache of this frame, the nearest and farthest distances of each pixel's visible samples, and, in `counters`, how many
samples were lost: dropped, those that are not in the view; overflow, those whose pixel was full; stolen, invisible ones whose
slot a visible one took.
"""

from collections.abc import Iterable, Mapping

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..resources import SceneResources

VARIANTS = ("single-pass", "two-pass", "deterministic")
COUNTERS = ("occupied", "visible", "created", "purged", "retraced", "shaded", "dropped", "stolen", "overflow")
GROUP = 64  # paths, or pixels in a row, as in cl/samplecache/groups.cl
_RUN = 64  # entries of a list, as in cl/samplecache/moved.cl
_NONE = 0xFFFFFFFF
_NO_NEAREST = 2**64 - 1
# What a pixel's diagonal is taken to subtend at most: Eq. 1 is for small angles, and bounded below a quarter turn.
_WIDEST_PIXEL = np.pi / 4


def counter_defines() -> dict[str, int]:
    """The places in `counters`, for kernels: COUNT_OCCUPIED and so on."""
    return {f"COUNT_{name.upper()}": index for index, name in enumerate(COUNTERS)}


def cache_defines(slots: int, has_radiance: bool = True, superresolution: int | None = None) -> dict[str, int | bool]:
    """What all kernels over the cache are specialised by. superresolution: M where slots are M x M places within the pixel."""
    subpixels = {} if superresolution is None else {"SUPER": superresolution}
    shape = {"SLOTS": slots, "WORDS": mask_words(slots), "HAS_RADIANCE": has_radiance}
    return {**shape, "ISRT": superresolution is not None, **subpixels}


def mask_words(slots: int) -> int:
    """How many 32-bit words hold a pixel's mask: an occupied and a visible bit for each slot."""
    return 1 if slots <= 16 else 2


def cache_buffers(pixels: int, slots: int, has_radiance: bool = True) -> list[Buffer]:
    """The cache of an eye: of this frame, and, by the names with `_before`, of the last one."""
    shapes = {"mask": (pixels, mask_words(slots)), "first_hit": (slots, pixels, 4)}
    shapes |= {"shading": (slots, pixels, 4)} if has_radiance else {}
    return [
        Buffer(name + when, shape, "u4", persistent=True, per_eye=True)
        for name, shape in shapes.items()
        for when in ("", "_before")
    ]


def exchanged_buffers(has_radiance: bool = True) -> tuple[tuple[str, str], ...]:
    """The pairs of names that change places before each frame."""
    return tuple((name, f"{name}_before") for name in ("mask", "first_hit", *(("shading",) if has_radiance else ())))


def list_capacity(pixels: int, slots: int) -> int:
    """How many entries a list of samples may need: all there are, and what may stay free at the ends of the batches in which it
    is worked off, a group's samples staying together.

    A batch has room for a sample of each pixel and for all of a group. What stays free at its end is less than the next group
    needs; so two batches in a row hold more than one has room for, and each holds all but a group's samples.
    """
    samples, group = slots * pixels, GROUP * slots
    batch = max(pixels, group)
    ends = min(2 * samples // batch, samples // (batch - group + 1)) + 2
    return samples + ends * group


def reproject_buffers(
    pixels: int, slots: int, variant: str = "deterministic", superresolution: int | None = None
) -> list[Buffer]:
    """What reprojection works with, and its results beside the cache: `nearest`, `farthest` and `counters`."""
    capacity = list_capacity(pixels, slots)
    buffers = [
        Buffer("samples", (capacity,), "u4"),
        Buffer("listed", (4,), "u4"),
        Buffer("target", (capacity,), "u4"),
        Buffer("distance", (capacity,)),
        Buffer("slope", (capacity,)),
        Buffer("nearest", (pixels,), "u8"),
        Buffer("farthest", (pixels,), "u4"),
        Buffer("counters", (len(COUNTERS),), "u4"),
    ]
    buffers += [Buffer("latest", (pixels,), "u4")] if variant == "deterministic" else []
    buffers += [Buffer("address", (slots, pixels), "u4")] if variant == "two-pass" else []
    buffers += [Buffer("cell", (capacity,), "u1")] if superresolution is not None else []
    return buffers


def reproject_passes(
    device: Device,
    scene: SceneResources,
    size: tuple[int, int],
    slots: int,
    variant: str = "deterministic",
    has_radiance: bool = True,
    superresolution: int | None = None,
) -> list[Pass]:
    """The passes, in order. size: width, height. variant: one of VARIANTS. superresolution: M where slots are the M x M places
    within the pixel; slots is then M * M."""
    defines = cache_defines(slots, has_radiance, superresolution)
    common = device, size, defines
    return [ListSamples(*common), ProjectSamples(*common, scene), *(p(*common) for p in _SLOT_PASSES[variant])]


def listed_length(arrays: Mapping[str, cl_array.Array], which: int = 0) -> int:
    """The length of a list on the device, when all that was enqueued is done."""
    length = np.empty(1, np.uint32)
    cl.enqueue_copy(arrays["listed"].queue, length, arrays["listed"].base_data, src_offset=4 * which)
    return int(length[0])


def pixel_diagonal(camera: np.void) -> dict[str, float]:
    """The angle phi that the diagonal of a pixel in the image's middle subtends, as `project_samples` takes it."""
    slope = camera["slope"].astype(np.float64)
    half = np.arctan(np.hypot(slope[0] / camera["width"], slope[1] / camera["height"]))
    phi = min(2 * half, _WIDEST_PIXEL)
    return {"phi_sine": np.sin(phi), "phi_cosine": np.cos(phi), "phi_versine": 2 * np.sin(phi / 2) ** 2}


class CachePass(Pass):
    """A kernel over the samples of a cache. source: its file, below cl/."""

    def __init__(
        self, device: Device, size: tuple[int, int], defines: Mapping[str, int | bool], source: str, kernel: str
    ):
        self._kernel = device.program(source, **defines, **counter_defines())[kernel]
        self._pixels = size[0] * size[1]
        self._cell = ("cell",) if defines["ISRT"] else ()
        self._data = ("first_hit", "shading") if defines["HAS_RADIANCE"] else ("first_hit",)
        self._data_before = tuple(f"{name}_before" for name in self._data)

    def _over_pixels(self, arrays) -> cl.Event | None:
        return self._kernel.run(-(-self._pixels // GROUP), arrays, pixels=self._pixels)

    def _over_runs(self, arrays) -> cl.Event | None:
        length = listed_length(arrays)
        return self._kernel.run(-(-length // _RUN), arrays, pixels=self._pixels, length=length)


class ListSamples(CachePass):
    """The list of all samples in the last frame's cache; counters begin anew."""

    name = "list"
    reads = ("mask_before",)
    writes = ("samples", "listed", "counters")

    def __init__(self, device: Device, size: tuple[int, int], defines: Mapping[str, int | bool]):
        super().__init__(device, size, defines, "samplecache/reproject.cl", "list_samples")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """List them row by row."""
        yield fill(arrays["listed"], 0)
        yield fill(arrays["counters"], 0)
        yield self._over_pixels(arrays)


class ProjectSamples(CachePass):
    """Where each listed sample is now, seen from the state's camera."""

    name = "project"

    def __init__(self, device: Device, size: tuple[int, int], defines: Mapping[str, int | bool], scene: SceneResources):
        super().__init__(device, size, defines, "samplecache/reproject.cl", "project_samples")
        self._scene = scene
        self.reads = ("samples", "listed", "first_hit_before")
        self.writes = ("target", "distance", "slope", *self._cell)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Project as many as there are."""
        length = listed_length(arrays)
        scalars = {"camera": state.camera, "length": length, **pixel_diagonal(state.camera)}
        yield self._kernel.run(length, arrays, self._scene.arrays, **scalars)


class LinkArrivals(CachePass):
    """Deterministic: chains of the samples that arrive in each pixel."""

    name = "reserve"
    reads = ("listed", "target", "counters")
    writes = ("target", "latest", "counters")

    def __init__(self, device: Device, size: tuple[int, int], defines: Mapping[str, int | bool]):
        super().__init__(device, size, defines, "samplecache/arrivals.cl", "link_arrivals")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Link the list, run by run."""
        yield fill(arrays["latest"], _NONE)
        yield self._over_runs(arrays)


class PlaceArrivals(CachePass):
    """Deterministic: from each pixel's chain to its slots."""

    name = "copy"

    def __init__(self, device: Device, size: tuple[int, int], defines: Mapping[str, int | bool]):
        super().__init__(device, size, defines, "samplecache/arrivals.cl", "place_arrivals")
        chains = ("samples", "target", "latest", "distance", "slope", *self._cell)
        self.reads = (*chains, *self._data_before, "counters")
        self.writes = ("mask", *self._data, "nearest", "farthest", "counters")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Fill the slots, row by row."""
        yield self._over_pixels(arrays)


class SinglePass(CachePass):
    """Single-pass: slots go to whoever comes first, and are filled at once."""

    name = "reserve"

    def __init__(self, device: Device, size: tuple[int, int], defines: Mapping[str, int | bool]):
        super().__init__(device, size, defines, "samplecache/reserve.cl", "single_pass")
        found = ("samples", "target", "distance", "slope", *self._cell)
        self.reads = ("listed", *found, *self._data_before, "counters")
        self.writes = ("mask", *self._data, "nearest", "farthest", "counters")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """From empty pixels on, run by run of the list."""
        yield fill(arrays["mask"], 0)
        yield fill(arrays["nearest"], _NO_NEAREST)
        yield fill(arrays["farthest"], 0)
        yield self._over_runs(arrays)


class Reserve(CachePass):
    """Two-pass, the first: slots go to whoever comes first."""

    name = "reserve"

    def __init__(self, device: Device, size: tuple[int, int], defines: Mapping[str, int | bool]):
        super().__init__(device, size, defines, "samplecache/reserve.cl", "reserve")
        self.reads = ("listed", "samples", "target", *self._cell, "counters")
        self.writes = ("mask", "address", "counters")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """From empty pixels on, run by run of the list."""
        yield fill(arrays["mask"], 0)
        yield self._over_runs(arrays)


class Copy(CachePass):
    """Two-pass, the second: slots are filled."""

    name = "copy"

    def __init__(self, device: Device, size: tuple[int, int], defines: Mapping[str, int | bool]):
        super().__init__(device, size, defines, "samplecache/reserve.cl", "copy_reserved")
        self.reads = ("mask", "samples", "address", "distance", "slope", *self._data_before)
        self.writes = ("mask", *self._data, "nearest", "farthest")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Fill the slots, row by row."""
        yield self._over_pixels(arrays)


# The passes by which samples get their slots.
_SLOT_PASSES = {
    "single-pass": (SinglePass,),
    "two-pass": (Reserve, Copy),
    "deterministic": (LinkArrivals, PlaceArrivals),
}
