"""Temporal filters: the new frame joined with those before it (`cl/filter/`; Philippi et al. 2023, sections 3.1 and 4.2).

Three steps, as in Fig. 3: reprojection, by the motion of each pixel's closest sample; validation; accumulation. `taa` weighs the
new frame by a constant, `varianceblend` by Eq. 4, for which bias and variance are estimated as published (Eq. 10 and 11) or
corrected for the noise in that estimate.

A pixel takes the motion of the closest surface among the 3x3. With one sample a pixel that lowered the error by 1 % (TAA without
validation: 4 %) where instances spin before a camera that stands still, and changed nothing where only the camera moves.
There cubic interpolation of the history matters: against linear, 9 % to 14 % less error.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..resources import SceneResources
from .filter import Filter

KINDS = ("taa", "varianceblend")
_VALIDATIONS = ("reject", "clamp", "clip")
_RUN = 16  # pixels of a row that are done at once, and about an image at its sides, as in cl/filter/runs.cl
_MARGIN = 2  # rows above and below an image, as there
_VIEW = 32  # numbers of an instance, as in cl/filter/motion.cl


@dataclass(frozen=True)
class Weighing:
    """How a filter reads and weighs its history. least_alpha: the least weight of a new frame, of TAA. gamma: of its clipping.
    spreads: numbers of a pixel's carried variance; none where no variance is carried."""

    defines: Mapping[str, bool]
    least_alpha: float
    gamma: float
    spreads: int

    @classmethod
    def of(cls, settings: Mapping[str, object], kind: str) -> "Weighing":
        """What the settings say of a kind of filter."""
        is_taa, validation = kind == "taa", settings["taa.validation"]
        is_published = not is_taa and settings["varianceblend.estimate"] == "published"
        per_channel = not is_taa and settings["varianceblend.per_channel"]
        defines = {
            "BICUBIC": settings["temporal.history"] == "bicubic",
            "TAA": is_taa,
            "PUBLISHED": is_published,
            "PER_CHANNEL": per_channel,
            **{name.upper(): is_taa and name == validation for name in _VALIDATIONS},
        }
        spreads = 0 if is_taa or is_published else 4 if per_channel else 1
        return cls(defines, settings["taa.alpha"], settings["taa.gamma"], spreads)


def temporal(
    device: Device, scene: SceneResources, size: tuple[int, int], settings: Mapping[str, object], kind: str
) -> Filter:
    """The filter of an image of `size`, width and height. kind: one of KINDS.

    It reads `color`, (pixels, 3), and `surface`, (pixels, 4), and writes `filtered`, (pixels, 3), and the AOVs `aov_alpha`, the
    weight of the new frame, the mean over channels where each has its own, and `aov_effective`, the effective number of samples
    (Eq. 5) in frames; both (pixels,). The state says the camera and, if there is a history, that of the frame before.
    """
    scene.keep_before()
    pixels, padded = size[0] * size[1], _RUN * (_runs(size[0]) + 2) * (size[1] + 2 * _MARGIN)
    weighing = Weighing.of(settings, kind)
    carries = weighing.spreads > 0
    shapes = {"history": (padded, 4)}
    shapes |= {"variance": (padded, weighing.spreads), "depths": (padded, 2)} if carries else {}
    exchanged = tuple((name, f"{name}_before") for name in shapes)
    buffers = (
        Buffer("views", (scene.arrays["instances"].size + 1, _VIEW)),
        Buffer("motion", (pixels + _RUN, 2)),
        Buffer("depth", (pixels + _RUN,)),
        Buffer("frame", (7, padded)),
        Buffer("filtered", (pixels, 3), per_eye=True),
        Buffer("aov_alpha", (pixels,)),
        Buffer("aov_effective", (pixels,)),
        *(Buffer(name, shapes[pair[0]], persistent=True, per_eye=True) for pair in exchanged for name in pair),
    )
    passes = (
        FindMotion(device, scene, size, carries),
        LayOut(device, size, weighing),
        Blend(device, size, weighing),
        ShowEffective(device, size, weighing),
    )
    return Filter(passes, buffers, output="filtered", exchanged=exchanged)


def _runs(width: int) -> int:
    return -(-width // _RUN)


class FindMotion(Pass):
    """Where each pixel's point was seen in the frame before, and how far it is now, with a sign (`find_motion`). size: of the image. disocclusion: whether
    what was hidden in the frame before has no history; otherwise only what was outside its view."""

    name = "motion"

    def __init__(self, device: Device, scene: SceneResources, size: tuple[int, int], disocclusion: bool):
        self._scene, self._size = scene, size
        self._program = device.program("filter/motion.cl", DISOCCLUSION=disocclusion)
        self.reads = ("surface", *(("depths_before",) if disocclusion else ()))
        self.writes = ("views", "motion", "depth")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """From the state's `camera_before` to its `camera`; without the former, nowhere."""
        camera, before = state.camera, state.camera_before
        known = camera if before is None else before
        places, (width, height) = arrays["views"].shape[0], self._size
        views = {"camera": camera, "camera_before": known, "places": places}
        yield self._program["view_instances"].run(places, arrays, self._scene.arrays, **views)
        scalars = {"near": camera["near"], "near_before": known["near"]}
        scalars |= {"width": width, "height": height, "places": places}
        yield self._program["find_motion"].run(width * height, arrays, self._scene.arrays, **scalars)
        if before is None:
            yield fill(arrays["motion"], np.inf)


class _Filtering(Pass):
    """A pass over the image as `Weighing` has it."""

    kernel: str

    def __init__(self, device: Device, size: tuple[int, int], weighing: Weighing):
        self._width, self._height = size
        self._weighing = weighing
        self._kernel = device.program("filter/temporal.cl", **weighing.defines)[self.kernel]


class LayOut(_Filtering):
    """The new frame in the form in which neighbourhoods are read fastest."""

    name = kernel = "lay_out"
    reads = ("color", "motion", "depth")
    writes = ("frame",)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Copy it, with luminance and motion, padding, and NaN for what is not there or not finite."""
        padded = arrays["frame"].shape[1]
        yield self._kernel.run(padded // _RUN, arrays, width=self._width, height=self._height, padded=padded)


class Blend(_Filtering):
    """The new frame and the history, read where the motion says, joined pixel by pixel."""

    name = kernel = "filter"

    def __init__(self, device: Device, size: tuple[int, int], weighing: Weighing):
        super().__init__(device, size, weighing)
        carried = ("history", "variance") if weighing.spreads else ("history",)
        self.reads = ("frame", *(f"{name}_before" for name in carried))
        self.writes = ("filtered", "aov_alpha", *carried, *(("depths",) if weighing.spreads else ()))

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """A run of pixels at a time."""
        scalars = {"width": self._width, "height": self._height, "padded": arrays["frame"].shape[1]}
        scalars |= {"least_alpha": self._weighing.least_alpha, "gamma": self._weighing.gamma}
        own = {name: arrays[name] for name in (*self.reads, *self.writes)}
        yield self._kernel.run(_runs(self._width) * self._height, own, **scalars)


class ShowEffective(_Filtering):
    """The effective number of samples as an image."""

    name, kernel = "aov_effective", "show_effective"
    reads = ("history",)
    writes = ("aov_effective",)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Take it out of the history."""
        pixels = arrays["aov_effective"].size
        yield self._kernel.run(pixels, arrays, width=self._width, pixels=pixels)
