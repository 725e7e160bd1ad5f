"""Stereo blending from the sample caches' moments (`cl/samplecache/blend.cl`; SampleCache, section 3.6).

A frame's two eyes are rendered apart, then each is blended with what the other shows of the same points. Neither sees
the other's blended colour: `color` stays as it is, and the result is `blended`.
"""

from collections.abc import Iterable

import pyopencl as cl

from ..device import Device
from ..frame import Buffer, Pass


def moment_buffers(pixels: int) -> list[Buffer]:
    """What reconstruction leaves for blending, one row per pixel, in the order of the image.

    `moments`, over the pixel's visible samples with radiance L_s and count c_s: columns 0-2 the mean sum(c_s L_s) / c;
    3 the count c = sum(c_s); 4-6 the mean squared deviation from that mean, sum(c_s (L_s - mean)^2) / c; 7 the reciprocal
    depth, along the camera's axis, of the closest of them, 0 for the background. All finite; a row of zeros where nothing is
    known. Deviations are summed about the mean, or about one of the samples: from raw moments they would cancel.
    """
    return [Buffer("moments", (pixels, 8), per_eye=True)]


def blend_buffers(pixels: int) -> list[Buffer]:
    """The blended colour, (pixels, 3)."""
    return [Buffer("blended", (pixels, 3))]


class Blend(Pass):
    """Blend this eye's colour with the other's, pixel by pixel, by the variances of both.

    sharpness: R of section 5.2, 0 .. 1: 1 takes each pixel's moments alone, 0 blurs them the most.
    """

    name = "blend"
    reads = ("color", "moments", "other_color", "other_moments")
    writes = ("blended",)

    def __init__(self, device: Device, sharpness: float):
        self._sharpness = sharpness
        self._kernel = device.program("samplecache/blend.cl", BLUR=sharpness < 1.0)["blend"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Blend the eye whose camera is the state's; `state.other` is the other eye's."""
        pixels = arrays["color"].shape[0]
        scalars = {"camera": state.camera, "other": state.other, "sharpness": self._sharpness, "pixels": pixels}
        yield self._kernel.run(pixels, arrays, **scalars)
