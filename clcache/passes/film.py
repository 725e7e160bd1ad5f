"""From the samples of a frame to its images (`cl/pathtrace/film.cl`)."""

from collections.abc import Iterable

import pyopencl as cl

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..resources import SceneResources
from .trace import HITS


def film_buffers(n: int, pixels: int) -> list[Buffer]:
    """The sums over a frame's samples, in the order of the n paths, as planes, and its images, in the order of the pixels."""
    return [
        Buffer("color_sum", (3, n)),
        Buffer("color_lost", (3, n)),
        Buffer("color", (pixels, 3), per_eye=True),
        Buffer("square_sum", (3, n)),
        Buffer("aov_variance", (pixels, 3)),
        Buffer("aov_samples", (pixels,)),
        Buffer("albedo_sum", (3, n)),
        Buffer("aov_albedo", (pixels, 3)),
        Buffer("N_sum", (3, n)),
        Buffer("aov_N", (pixels, 3)),
        Buffer("aov_Z", (pixels,)),
        Buffer("nearest", (n,)),
        Buffer("surface", (pixels, 4), "u4", per_eye=True),
    ]


class Clear(Pass):
    """Start a sum, or a search for the least, over a frame's samples; not where a run goes on with an earlier one's."""

    def __init__(self, buffer: str, value: float = 0):
        self.name, self.writes, self._value = "clear", (buffer,), value

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Set every element to the value."""
        if state.begin == 0:
            yield fill(arrays[self.writes[0]], self._value)


class AddRadiance(Pass):
    """Sum the samples' radiance, without the drift that rounding brings to long sums."""

    name = "color_sum"
    reads = ("radiance", "color_sum", "color_lost")
    writes = ("color_sum", "color_lost")

    def __init__(self, device: Device):
        self._kernel = device.program("pathtrace/film.cl")["add_compensated"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Add this sample's radiance."""
        n = arrays["radiance"].shape[1]
        yield self._kernel(*(arrays[b] for b in self.reads), n, count=n)


class AddSquare(Pass):
    """Sum the squares of the samples' radiance, from which their spread is known."""

    name = "square_sum"
    reads = ("radiance", "square_sum")
    writes = ("square_sum",)

    def __init__(self, device: Device):
        self._kernel = device.program("pathtrace/film.cl")["add_square"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Add this sample's squares."""
        values, total = (arrays[b] for b in self.reads)
        n = values.shape[1]
        yield self._kernel(values, total, n, count=n)


class Variance(Pass):
    """The variance of each pixel's mean."""

    name = "aov_variance"
    reads = ("pixel", "color_sum", "square_sum")
    writes = ("aov_variance",)

    def __init__(self, device: Device):
        self._kernel = device.program("pathtrace/film.cl")["variance_of_mean"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Estimate it from the sums so far."""
        pixel, total, squares = (arrays[b] for b in self.reads)
        variance = arrays["aov_variance"]
        n, pixels = pixel.size, variance.shape[0]
        yield self._kernel(pixel, total, squares, variance, n, pixels, state.samples, count=n)


class SampleCount(Pass):
    """How many samples each pixel has."""

    name = "aov_samples"
    writes = ("aov_samples",)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Set the count, the same everywhere."""
        yield fill(arrays["aov_samples"], state.samples)


class NearestDepth(Pass):
    """The depth of the nearest first hit of the samples."""

    name = "aov_Z"
    reads = ("pixel", "ray_direction", "hit_t", "aov_Z")
    writes = ("aov_Z",)

    def __init__(self, device: Device):
        self._kernel = device.program("pathtrace/film.cl")["nearest_depth"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Compare this sample's depths."""
        n, pixels = arrays["pixel"].size, arrays["aov_Z"].size
        yield self._kernel(*(arrays[b] for b in self.reads), state.camera, n, pixels, count=n)


class NearestHit(Pass):
    """The nearest first hit of the samples (`cl/pathtrace/nearest.cl`), packed as `cl/scene/first_hit.cl` says."""

    name = "surface"
    reads = ("pixel", "ray_direction", *HITS, "nearest")
    writes = ("nearest", "surface")

    def __init__(self, device: Device, scene: SceneResources):
        self._scene, self._kernel = scene, device.program("pathtrace/nearest.cl")["nearest_hit"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Compare this sample's depths."""
        n, pixels = arrays["pixel"].size, arrays["surface"].shape[0]
        yield self._kernel.run(n, arrays, self._scene.arrays, camera=state.camera, n=n, pixels=pixels)


class Mean(Pass):
    """The mean of a sum over samples."""

    def __init__(self, device: Device, total: str, average: str):
        self.name, self.reads, self.writes = average, ("pixel", total), (average,)
        self._kernel = device.program("pathtrace/film.cl")["mean"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Divide by the number of samples."""
        pixel, total, average = (arrays[b] for b in (*self.reads, *self.writes))
        yield self._kernel(pixel, total, average, pixel.size, average.shape[0], state.samples, count=pixel.size)


class MeanDirection(Pass):
    """The mean of summed directions, of unit length."""

    def __init__(self, device: Device, total: str, average: str):
        self.name, self.reads, self.writes = average, ("pixel", total), (average,)
        self._kernel = device.program("pathtrace/film.cl")["mean_direction"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Normalise the sums."""
        pixel, total, average = (arrays[b] for b in (*self.reads, *self.writes))
        yield self._kernel(pixel, total, average, pixel.size, average.shape[0], count=pixel.size)
