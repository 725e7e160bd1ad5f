"""Renders of one frame with different seeds, merged into what one render of all their samples would be.

Of a pixel, the files i have n_i samples each, with the mean C_i and, as the AOV `variance`, the variance V_i of that mean,
N = sum n_i:

    samples   N
    colour    C = sum n_i C_i / N; albedo likewise
    variance  V = (sum n_i (n_i - 1) V_i + sum n_i (C_i - C)^2) / (N (N - 1))
    N         the direction of sum n_i N_i
    Z         the least

V is the estimate from the spread of all N samples about their common mean C: the first sum is that of the squared distances
from the means of the files, the second that of those means from C (Chan, Golub and LeVeque 1979, "Updating Formulae and a
Pairwise Algorithm for Computing Sample Variances"). One sample has no distance from its mean: where n_i = 1, V_i is not
looked at. n_i is the AOV `samples` where a file has it, else the attribute `spp`.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Self

import numpy as np

from ..errors import SettingError
from ..settings import CACHED_METHODS
from .aov import AOVS
from .exr import COLOR, REC_709, SOFTWARE, channel_names, name_in_view, sample_counts, write_images
from .read import MONO, Picture, read_header, read_picture

MAX_SPP = 2**31 - 1  # the attribute spp has 32 bits


@dataclass(frozen=True)
class Source:
    """A file to merge, by its header. seeds: one, or those of the files that it was merged from. spp: by view."""

    file: str
    size: tuple[int, int]
    seeds: tuple[int, ...]
    spp: dict[str, int]
    attributes: dict[str, object]

    @classmethod
    def read(cls, path: str | os.PathLike) -> Self:
        """Read the header. Raises SettingError where the file is none, or lacks what clcache writes."""
        file = os.fspath(path)
        header = read_header(file)
        attributes = header.attributes
        views = list(attributes["multiView"]) if "multiView" in attributes else [MONO]
        try:
            seeds = tuple(int(seed) for seed in attributes["seed"].split(","))
            spp = {view: attributes[name_in_view("spp", views, view)] for view in views}
            if not all(isinstance(count, int) and count > 0 for count in spp.values()):
                raise ValueError("spp")
            source = cls(file, header.size, seeds, spp, attributes)
            source.identity()
            for view in views:
                source.camera(view)
            if len(views) > 1:
                float(attributes["eyeDistance"])
        except KeyError as error:
            raise SettingError(
                f"{file}: lacks the attribute {error.args[0]}; expected an EXR file of clcache"
            ) from None
        except (ValueError, TypeError, AttributeError, RecursionError):
            raise SettingError(f"{file}: its attributes are damaged; expected an EXR file of clcache") from None
        return source

    def identity(self) -> dict[str, object]:
        """What must be the same in all files: names of things, and their values."""
        has = self.attributes
        settings = json.loads(has["settings"])
        return {
            "size": "{}x{}".format(*self.size),
            "views": ", ".join(self.spp),
            **{name: has[name] for name in ("scene", "method", "frame")},
            "memo": has.get("memo", "off"),
            "fps": float(Fraction(*has["framesPerSecond"])),
            # How the device is used has no effect on the image.
            **{f"setting {name}": value for name, value in settings.items() if not name.startswith("device.")},
        }

    def camera(self, view: str) -> np.ndarray:
        """The numbers that say what a view sees."""
        matrix, fov_y = (
            self.attributes[name_in_view(name, list(self.spp), view)] for name in ("worldToCamera", "fovY")
        )
        return np.append(np.reshape(matrix, 16), fov_y).astype(np.float64)


def check_mergeable(sources: Sequence[Source]) -> None:
    """Raise SettingError where these files, two or more, are not the same frame rendered with different seeds."""
    first, *others = sources
    for source in sources:
        if source.attributes["method"] in CACHED_METHODS:
            raise SettingError(
                f"{source.file}: its method, {source.attributes['method']}, has samples of earlier frames, too, of which no number"
                " is known; expected frames that stand by themselves, as pathtrace's do"
            )
        for attribute, what, whose in (
            ("temporal", "temporal filter", "earlier frames"),
            ("stereoBlend", "stereo blend", "the other eye"),
        ):
            name = source.attributes.get(attribute, "none")
            if name != "none":
                raise SettingError(
                    f"{source.file}: its {what}, {name}, has put colour of {whose} into it, for which no number of samples"
                    " stands; expected frames without"
                )
    expected, seen = first.identity(), dict.fromkeys(first.seeds, first.file)
    for source in others:
        found = source.identity()
        for what in {**expected, **found}:
            if found.get(what) != expected.get(what):
                values = f"{source.file} has {found.get(what, 'none')} and {first.file} {expected.get(what, 'none')}"
                raise SettingError(f"{what}: {values}; expected the same in all files")
        for view in first.spp:
            if not np.allclose(source.camera(view), first.camera(view), rtol=1e-5, atol=1e-6):
                raise SettingError(
                    f"cameras: view {view} of {source.file} is not that of {first.file}; expected the same in all files"
                )
        for seed in source.seeds:
            if seed in seen:
                raise SettingError(
                    f"{source.file} and {seen[seed]} both hold the samples of seed {seed}; expected a seed of its own for each"
                )
        seen |= dict.fromkeys(source.seeds, source.file)
    for view in first.spp:
        total = sum(source.spp[view] for source in sources)
        if total > MAX_SPP:
            raise SettingError(f"{total} samples per pixel; expected at most {MAX_SPP} in one file")


def merge(sources: Sequence[Source], path: str | os.PathLike) -> set[str]:
    """Merge files, of which `check_mergeable` said that it can be done, into one, whole or not at all.

    An AOV that not all files have is left out, but for `samples`, which the attribute spp stands for. Returns the names of
    the channels that were left out. Raises SettingError where a file cannot be read, Error where the result cannot be written.
    """
    first = sources[0]
    totals = {view: _Total() for view in first.spp}
    left_out: set[str] = set()
    has_samples = False
    for source in sources:
        picture = read_picture(source.file)
        if picture.color.keys() != totals.keys():
            raise SettingError(f"{source.file}: has colour in {', '.join(picture.color)}; expected {', '.join(totals)}")
        for view, total in totals.items():
            images = _images(picture, view)
            has_samples |= "samples" in images
            counts = images.setdefault("samples", np.full(source.size[::-1], source.spp[view], np.float64))
            if not (counts >= 1).all():
                raise SettingError(f"{source.file}: view {view} has pixels without samples; expected 1 or more in each")
            total.add(images)
            left_out |= picture.channels[view].keys()
    merged = {view: total.images() for view, total in totals.items()}
    for images in merged.values():
        if not has_samples:
            del images["samples"]
        left_out -= {channel for name in images for channel in channel_names(name)}
    write_images(path, merged, _header(sources))
    return left_out


def _images(picture: Picture, view: str) -> dict[str, np.ndarray]:
    """Colour and AOVs of a view, (H, W) or (H, W, 3) float64."""
    channels = picture.channels[view]
    images = {COLOR: picture.color[view].astype(np.float64)}
    for name, aov in AOVS.items():
        if channels.keys() >= set(aov.channels):
            image = np.stack([channels[channel] for channel in aov.channels], axis=-1, dtype=np.float64)
            images[name] = image[..., 0] if len(aov.channels) == 1 else image
    return images


class _Total:
    """The files so far, of one view: sums in double precision, of those AOVs that all have."""

    def __init__(self) -> None:
        self._samples: np.ndarray | None = None
        self._sums: dict[str, np.ndarray] = {}

    def add(self, images: dict[str, np.ndarray]) -> None:
        """Add a file. images: `samples`, COLOR and AOVs."""
        n = images["samples"][..., None]
        with np.errstate(invalid="ignore"):  # a pixel that is not finite stays so
            new = {name: n * images[name] for name in (COLOR, "albedo", "N") if name in images}
            if "Z" in images:
                new["Z"] = images["Z"]
            if "variance" in images:
                new["variance"] = np.where(n > 1, n * (n - 1) * images["variance"], 0.0)
            if self._samples is None:
                self._samples, self._sums = n, new
                return
            if "variance" in new:
                # Of two groups of n and m samples, sum n_i (C_i - C)^2 is the squared distance of their means times
                # n m / (n + m).
                apart = images[COLOR] - self._sums[COLOR] / self._samples
                new["variance"] += apart**2 * (n * self._samples / (n + self._samples))
            both = self._sums.keys() & new.keys()
            self._sums = {name: (np.minimum if name == "Z" else np.add)(self._sums[name], new[name]) for name in both}
            self._samples = self._samples + n

    def images(self) -> dict[str, np.ndarray]:
        """The merged images, `samples` among them."""
        n, images = self._samples, dict(self._sums)
        for name in {COLOR, "albedo"} & images.keys():
            images[name] = images[name] / n
        if "variance" in images:
            images["variance"] = images["variance"] / (n * (n - 1))  # two files have two samples or more
        if "N" in images:
            length = np.linalg.norm(images["N"], axis=-1, keepdims=True)
            images["N"] = np.divide(images["N"], length, out=np.zeros_like(images["N"]), where=length > 0)
        return images | {"samples": n[..., 0]}


def _header(sources: Sequence[Source]) -> dict[str, object]:
    """The header of the merged file: the first file's, with the seeds and the samples of all."""
    first, views = sources[0], list(sources[0].spp)
    has = first.attributes
    header = {name: has[name] for name in ("scene", "method", "settings", "frame")}
    header["memo"] = has.get("memo", "off")
    for name in ("sceneDigest", "cameraDigest"):
        if name in has and all(source.attributes.get(name) == has[name] for source in sources):
            header[name] = has[name]
    header |= {
        "software": SOFTWARE,
        "framesPerSecond": Fraction(*has["framesPerSecond"]),
        "chromaticities": REC_709,
        "seed": ",".join(str(seed) for seed in sorted(seed for source in sources for seed in source.seeds)),
        **sample_counts({view: sum(source.spp[view] for source in sources) for view in views}),
    }
    if len(views) > 1:
        header |= {"multiView": views, "eyeDistance": has["eyeDistance"]}
    for view in views:
        matrix, fov_y = (name_in_view(name, views, view) for name in ("worldToCamera", "fovY"))
        header[matrix] = np.reshape(has[matrix], (4, 4)).astype(np.float32)
        header[fov_y] = has[fov_y]
    return header
