"""Stereo filtering of finished images (`cl/filter/stereo.cl`; Philippi et al. 2023, sections 4.1 and 5.2).

Each eye's image is blended with what the other's shows of the same points, either everywhere by the same weight or by the
weight that Eq. 4 gives to each pixel. Neither sees the other's blended image, and nothing of it comes back in another frame.

Bias and variance are estimated as published. The correction that the temporal filter can make, to take from the squared
difference of X and the neighbours' mean what noise this mean has, does no good here, where Eq. 11 has no bias.
"""

from collections.abc import Iterable, Mapping

import numpy as np
import pyopencl as cl

from ..device import Device
from ..frame import Buffer, Pass
from ..resources import SceneResources
from .filter import Filter

KINDS = ("constant", "varianceblend")


def stereo(
    device: Device, scene: SceneResources, size: tuple[int, int], settings: Mapping[str, object], kind: str
) -> Filter:
    """The filter of an image of `size`, width and height. kind: one of KINDS.

    It reads `color` and `surface` of both eyes; the state says which `eye` this is, its `camera` and the `other`. The eyes look
    in parallel and lie side by side. It writes `blended`, (pixels, 3), and `aov_beta`, (pixels,): the weight of the eye's own
    colour, the mean over channels where each has its own; 1 where the other eye does not show the point. In each frame eye 0
    comes first: what is found of both eyes is kept for the other.
    """
    pixels, by_variance = size[0] * size[1], kind == "varianceblend"
    per_channel = settings["varianceblend.per_channel"]
    defines = {"VARIANCE": by_variance, "PER_CHANNEL": per_channel}
    buffers = (
        Buffer("near", (2, pixels), persistent=True),
        Buffer("judged", (3 if per_channel else 1, pixels + 2 * (size[0] + 1))),
        Buffer("blended", (pixels, 3)),
        Buffer("aov_beta", (pixels,)),
    )
    passes = (
        FindNear(device, scene, defines),
        *([LayOut(device, defines)] if by_variance else []),
        StereoBlend(device, defines, settings["stereo.beta"]),
    )
    return Filter(passes, buffers, output="blended")


class FindNear(Pass):
    """The reciprocal depths of both eyes' first hits."""

    name = "near"
    reads = ("surface", "other_surface")
    writes = ("near",)

    def __init__(self, device: Device, scene: SceneResources, defines: Mapping[str, bool]):
        self._scene, self._kernel = scene, device.program("filter/stereo.cl", **defines)["find_near"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """With the first eye; the second's run finds them there."""
        if state.eye == 0:
            pixels = arrays["near"].shape[1]
            for eye, (surface, camera) in enumerate((("surface", state.camera), ("other_surface", state.other))):
                own = {"surface": arrays[surface], "near": arrays["near"]}
                yield self._kernel.run(pixels, own, self._scene.arrays, camera=camera, eye=eye, pixels=pixels)


class LayOut(Pass):
    """What this eye's variances are judged by."""

    name = "stereo"
    reads = ("color",)
    writes = ("judged",)

    def __init__(self, device: Device, defines: Mapping[str, bool]):
        self._kernel = device.program("filter/stereo.cl", **defines)["lay_out"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Lay out the image."""
        places, pixels = arrays["judged"].shape[1], arrays["color"].shape[0]
        yield self._kernel.run(places, arrays, width=state.camera["width"], pixels=pixels, places=places)


class StereoBlend(Pass):
    """Blend this eye's image with the other's. beta: the weight of its own where it is the same everywhere."""

    name = "stereo"
    writes = ("blended", "aov_beta")

    def __init__(self, device: Device, defines: Mapping[str, bool], beta: float):
        self.reads = ("color", "other_color", "near", *(["judged"] if defines["VARIANCE"] else []))
        self._beta, self._kernel = beta, device.program("filter/stereo.cl", **defines)["stereo"]

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Blend the eye that the state says."""
        pixels = arrays["color"].shape[0]
        scalars = {"disparity": disparity(state.camera, state.other), "beta": self._beta, "eye": state.eye}
        scalars |= {"width": state.camera["width"], "height": state.camera["height"], "pixels": pixels}
        yield self._kernel.run(pixels, arrays, **scalars)


def disparity(camera: np.void, other: np.void) -> float:
    """Pixels by which what is 1 m away along the axis lies farther right in the other eye's image than in this one; Camera
    records of eyes side by side. It is in proportion to the reciprocal of that distance."""
    to_world, of_other = (c["to_world"].astype(np.float64).reshape(3, 4) for c in (camera, other))
    aside = to_world[:, 0] @ (to_world[:, 3] - of_other[:, 3])
    return float(aside / camera["slope"][0] * camera["width"] / 2)
