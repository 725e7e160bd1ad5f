"""The layered filter of the octree's images (`cl/octree/filter.cl`; Roth et al. 2020, section 3.4, Eq. 2-6).

A layer is what an update's paths meet at their i-th vertex. From the last layer to the first, each one's light is filtered by
its own guides, joined with what it sees of the layer behind it, and handed on; `layer0_filtered` is the update's image.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device, fill
from ..frame import Buffer, Pass
from ..program import Program
from .denoise import Denoiser

SHOWN = 3  # layers that can be looked at
_RUN = 16  # pixels of a row that are done at once, and about an image at its sides, as in cl/filter/runs.cl
_REACH = 8  # rows above and below an image, as in cl/octree/filter.cl
_PLANES = 17  # of guides, as there
_NAME = "filter"
_SCALES = ("normal", "depth", "segment", "albedo", "albedo_glossy", "luminance")
_COMPOSED = ("light", "albedo", "own", "pass", "depth")
_PARTS = (*_COMPOSED, "normal", "segment", "roughness", "count")


def filter_buffers(layers: int, size: tuple[int, int], settings: Mapping[str, object]) -> list[Buffer]:
    """What the passes write and work with. layers: how many there are. size: width, height.

    `layer<i>_filtered`, (3, pixels): what comes from layer i; where a layer other than the first has no vertex it may be anything.
    `aov_layer<i>` and `aov_filtered<i>`, (pixels, 3), of the first three: the same, before and after this layer's own filter;
    black where there is no such vertex.
    """
    pixels = size[0] * size[1]
    shown = (Buffer(f"aov_{kind}{i}", (pixels, 3)) for kind in ("layer", "filtered") for i in range(SHOWN))
    return [
        *(Buffer(f"layer{i}_filtered", (3, pixels)) for i in range(layers)),
        # Zeros at first: those of the padding stay.
        Buffer("filter_guides", (_PLANES, _padded(size)), persistent=True),
        Buffer("filter_unfiltered", (3, pixels)),
        *shown,
    ]


def filter_passes(
    device: Device, size: tuple[int, int], layers: int, settings: Mapping[str, object], emits: bool = False
) -> list[Pass]:
    """From the planes of `layers` layers to `layer0_filtered` and the AOVs of layers. emits: whether what shines by itself is not in
    `layer<i>_own` but in `layer<i>_emitted`, (3, pixels), and is not filtered. Raises SettingError."""
    kind, is_layered = settings["octree.filter"], settings["octree.layered"]
    if kind == "oidn":
        denoiser = Denoiser(device.threads if device.is_cpu else 0)
    passes: list[Pass] = []
    for i in reversed(range(layers)):
        layer = Layer(i, i + 1 == layers, size, emits)
        if kind == "none" or not (is_layered or i == 0):
            passes.append(Compose(device, layer))
        elif kind == "oidn":
            passes.append(DenoiseLayer(device, layer, denoiser, is_layered))
        else:
            passes.append(FilterLayer(device, layer, settings))
        if i < SHOWN:
            passes += [ShowUnfiltered(device, layer), Show(device, layer)]
    return passes + [Blank(i) for i in range(layers, SHOWN)]


@dataclass(frozen=True)
class Layer:
    """A layer by its number, in images of `size`, width and height."""

    number: int
    is_last: bool
    size: tuple[int, int]
    emits: bool

    def names(self, *parts: str) -> tuple[str, ...]:
        """The names of buffers of this layer."""
        return tuple(f"layer{self.number}_{part}" for part in parts)

    @property
    def joined(self) -> tuple[str, ...]:
        """The names of what its light is joined with: what shines by itself, and what is behind it."""
        return (*(self.names("emitted") if self.emits else ()), *self.behind)

    @property
    def behind(self) -> tuple[str, ...]:
        """The names of what comes from the layer behind it, and of where that one has vertices."""
        return () if self.is_last else (f"layer{self.number + 1}_filtered", f"layer{self.number + 1}_depth")

    @property
    def runs(self) -> int:
        """How many runs of pixels the image has."""
        return _runs(self.size[0]) * self.size[1]

    @property
    def scalars(self) -> dict[str, int]:
        """The sizes that kernels ask for."""
        width, height = self.size
        return {"width": width, "height": height, "n": width * height}

    def arrays(self, arrays: Mapping[str, cl_array.Array]) -> dict[str, cl_array.Array]:
        """The layer's buffers by the names that kernels have for them."""
        own = {part: arrays[name] for part in (*_PARTS, "emitted") if (name := f"layer{self.number}_{part}") in arrays}
        return own | dict(zip(("behind", "behind_depth"), (arrays[name] for name in self.behind), strict=False))


class Compose(Pass):
    """Join a layer's light with that of the layer behind it, without a filter."""

    name = _NAME

    def __init__(self, device: Device, layer: Layer):
        self._layer, self._kernel = layer, _program(device)["compose"]
        self.reads = (*layer.names(*_COMPOSED), *layer.joined)
        self.writes = layer.names("filtered")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run."""
        layer = self._layer
        out = arrays[self.writes[0]]
        yield self._kernel.run(layer.runs, layer.arrays(arrays), out=out, **layer.scalars)


class FilterLayer(Pass):
    """Filter a layer's light and what it shows of the layer behind it, each by Eq. 2-6, and join them."""

    name = _NAME

    def __init__(self, device: Device, layer: Layer, settings: Mapping[str, object]):
        self._layer = layer
        self._program = _program(device, not settings["octree.layered"])
        self._scales = {f"scale_{name}": settings[f"octree.filter_{name}"] for name in _SCALES}
        self.reads = (*layer.names(*_PARTS), *layer.joined)
        self.results = layer.names("filtered")
        self.writes = ("filter_guides", *self.results)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Lay out the guides, then filter; both run by run."""
        layer, guides = self._layer, arrays["filter_guides"]
        known = {"padded": guides.shape[1], "guides": guides, **layer.scalars}
        yield self._program["lay_out"].run(layer.runs, layer.arrays(arrays), **known)
        angle = 2.0 * float(state.camera["slope"][1]) / layer.size[1]
        known |= {"out": arrays[self.results[0]], "pixel_angle": angle, **self._scales}
        yield self._program["filter_layer"].run(layer.runs, layer.arrays(arrays), **known)


class DenoiseLayer(Pass):
    """Denoise a layer's light and, where surfaces are rough, what it shows of the layer behind it, and join them; or, of an image that
    is not layered, what is composed of all. Pictures go by way of the host, so that the device's time says nothing of it.

    A pixel that knows nothing is taken to be black: the denoiser has no word for it.
    """

    name = _NAME

    def __init__(self, device: Device, layer: Layer, denoiser: Denoiser, is_layered: bool):
        self._layer, self._denoise, self._is_layered = layer, denoiser, is_layered
        self.reads = (*layer.names(*_COMPOSED, "normal", "roughness"), *layer.joined)
        self.writes = layer.names("filtered")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Read the layer, denoise, and write what comes of it."""
        layer = {part: array.get() for part, array in self._layer.arrays(arrays).items()}
        out = arrays[self.writes[0]]
        out.set(np.zeros(out.shape, np.float32) if not layer["depth"].any() else self._filtered(layer))
        return ()

    def _filtered(self, layer: Mapping[str, np.ndarray]) -> np.ndarray:
        is_there = np.isfinite(layer["depth"]) & (layer["depth"] > 0)
        rest = layer["own"] * (layer["depth"] != 0)
        if "behind" in layer:
            rest += layer["pass"] * np.where(layer["behind_depth"] != 0, layer["behind"], 0)
        emitted = layer["emitted"] * (layer["depth"] != 0) if "emitted" in layer else np.float32(0)
        light, albedo = np.where(is_there, layer["light"], 0), np.where(is_there, layer["albedo"], 0)
        guides = self._picture(albedo), self._picture(np.where(is_there, layer["normal"], 0))
        if not self._is_layered:
            return self._planes(self._denoise(self._picture(albedo * light + rest), *guides)) + emitted
        is_rough = is_there & (layer["roughness"] > 0)
        if is_rough.any():
            rest = np.where(is_rough, self._planes(self._denoise(self._picture(rest), *guides)), rest)
        return albedo * self._planes(self._denoise(self._picture(light), *guides)) + rest + emitted

    def _picture(self, planes: np.ndarray) -> np.ndarray:
        return np.moveaxis(planes.reshape(3, *self._layer.size[::-1]), 0, -1)

    def _planes(self, picture: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.moveaxis(picture, -1, 0)).reshape(3, -1)


class Show(Pass):
    """A layer's light as a picture."""

    name = "aovs"

    def __init__(self, device: Device, layer: Layer):
        self._kernel = _program(device)["show_layer"]
        self.reads, self.writes = layer.names("filtered", "depth"), (f"aov_filtered{layer.number}",)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Pixel by pixel."""
        out, depth, picture = (arrays[b] for b in (*self.reads, *self.writes))
        yield self._kernel.run(depth.size, out=out, depth=depth, picture=picture, n=depth.size)


class ShowUnfiltered(Pass):
    """The same before this layer's filter."""

    name = "aovs"

    def __init__(self, device: Device, layer: Layer):
        self._compose, self._show, self._layer = _program(device)["compose"], _program(device)["show_layer"], layer
        self.reads = (*layer.names(*_COMPOSED), *layer.joined)
        self.results = (f"aov_layer{layer.number}",)
        self.writes = ("filter_unfiltered", *self.results)

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Run by run, then pixel by pixel."""
        layer, out = self._layer, arrays["filter_unfiltered"]
        known = {"out": out, **layer.scalars}
        yield self._compose.run(layer.runs, layer.arrays(arrays), **known)
        yield self._show.run(out.shape[1], layer.arrays(arrays), picture=arrays[self.results[0]], **known)


class Blank(Pass):
    """The pictures of a layer that there is not."""

    name = "aovs"

    def __init__(self, number: int):
        self.writes = (f"aov_layer{number}", f"aov_filtered{number}")

    def run(self, arrays, state) -> Iterable[cl.Event | None]:
        """Black, those that are wanted."""
        for name in self.writes:
            if name in arrays:
                yield fill(arrays[name], 0)


def _program(device: Device, is_plain: bool = False) -> Program:
    return device.program("octree/filter.cl", PLAIN=is_plain)


def _runs(width: int) -> int:
    return -(-width // _RUN)


def _padded(size: tuple[int, int]) -> int:
    return _RUN * (_runs(size[0]) + 2) * (size[1] + 2 * _REACH)
