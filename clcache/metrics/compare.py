"""Two picture files, or two folders of frames, compared file by file and view by view."""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import numpy as np

from ..errors import SettingError
from ..output.read import KINDS, Picture, decode_srgb, read_picture
from .image import METRICS, Metric, relative_error, to_display
from .reprojection import View, reprojected_difference

REFERENCE = "-ref"  # ends the names of values that judge the reference by itself
VALID = "-valid"  # ends the names of shares of pixels that a reprojected difference is taken over
EYES = ("left", "right")


@dataclass(frozen=True)
class Row:
    """What was found out about one view of one file.

    values: by column; what does not exist here is missing (the temporal difference of a first frame). maps: by name,
    (H, W) float64, relative errors and not their squares; NaN where there is none.
    """

    file: str
    view: str
    values: dict[str, float]
    maps: dict[str, np.ndarray]


class Comparison:
    """A test and its reference, each a picture file (EXR, Radiance HDR, PNG) or a folder of them.

    test, reference: two files, or two folders, of which the files of the first kind that both hold are compared: .exr, else
    .hdr, else .png. They are matched by name. metrics: names of METRICS; None: all that can be computed here, and
    `notes` says what is left out. temporal: the reprojected difference between each frame and the one before it. stereo:
    that between the views left and right. Both are of the test, and of the reference too where that has depth and cameras.

    columns: names of the values, in order. files: names of the files, in order. Raises SettingError where the files
    do not match or cannot be used.
    """

    def __init__(
        self,
        test: str | os.PathLike,
        reference: str | os.PathLike,
        metrics: Sequence[str] | None = None,
        *,
        temporal: bool = False,
        stereo: bool = False,
    ) -> None:
        self._pairs = _pair_files(Path(test), Path(reference))
        self.files = [path.name for path, _ in self._pairs]
        if temporal and len(self._pairs) < 2:
            raise SettingError(f"{test}: one frame has no frame before it; expected a folder of two frames or more")
        self._temporal, self._stereo = temporal, stereo
        self.notes: list[str] = []
        self._metrics = self._all_possible() if metrics is None else [_find(name) for name in dict.fromkeys(metrics)]
        self.columns = [name for metric in self._metrics for name in _columns(metric.name, metric.of_one)]
        for name, wanted in (("temporal", temporal), ("stereo", stereo)):
            if wanted:
                self.columns += [name, name + VALID, name + REFERENCE]

    def rows(self) -> Iterator[Row]:
        """Read and compare: a row for each view of each file, in order. Raises SettingError, and Error for a missing package."""
        before: tuple[Picture, Picture] | None = None
        for paths in self._pairs:
            pair = _read_pair(*paths)
            if self._stereo and not set(EYES) <= set(pair[0].color):
                raise SettingError(f"{pair[0].file}: has views {', '.join(pair[0].color)}; expected left and right")
            for view in pair[0].color:
                yield self._row(pair, view, before)
            before = pair

    def _all_possible(self) -> list[Metric]:
        side = min(_read_pair(*self._pairs[0])[0].size)
        possible = []
        for metric in METRICS.values():
            if not metric.installed:
                self.notes.append(f"{metric.name} left out; it needs: pip install {metric.distribution}")
            elif side < metric.least_side:
                self.notes.append(f"{metric.name} left out; it needs {metric.least_side} pixels a side")
            else:
                possible.append(metric)
        return possible

    def _row(self, pair: tuple[Picture, Picture], view: str, before: tuple[Picture, Picture] | None) -> Row:
        values: dict[str, float] = {}
        linear = [_linear(picture, view) for picture in pair]
        # Values that a file holds encoded are what a display shows, and pass through no tone curve.
        shown = [p.color[view] if p.encoded else to_display(p.color[view]) for p in pair]
        for metric in self._metrics:
            if metric.on_display:
                values[metric.name] = metric.function(*shown, encoded=True)
                if metric.of_one:
                    values[metric.name + REFERENCE] = metric.function(shown[1], encoded=True)
            else:
                values[metric.name] = metric.function(*linear)
        maps = {"relative": np.sqrt(relative_error(*linear))}
        if self._temporal and before is not None:
            _reproject(
                values, maps, "temporal", [((now, view), (then, view)) for now, then in zip(pair, before, strict=True)]
            )
        if self._stereo and view == EYES[0]:
            _reproject(values, maps, "stereo", [tuple((picture, eye) for eye in EYES) for picture in pair])
        return Row(os.path.basename(pair[0].file), view, values, maps)


def means(columns: Sequence[str], rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The means of the pictures' values, by column. A value that no picture has is missing."""
    return {name: fmean(values) for name, values in _found(columns, rows).items()}


def summarize(columns: Sequence[str], rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The values of a sequence, by column, from those of its pictures: of `rmse` that over all pixels, which is the root of the
    mean of the pictures' squares; of all others their mean. A value that no picture has is missing. Both eyes are of the
    sequence; pictures are taken to be of one size."""
    together = {name: METRICS[name].of_sequence for name in columns if name in METRICS}
    return {name: together.get(name, fmean)(values) for name, values in _found(columns, rows).items()}


def _found(columns: Sequence[str], rows: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    found = {name: [values[name] for values in rows if name in values] for name in columns}
    return {name: values for name, values in found.items() if values}


def _columns(name: str, of_one: bool) -> list[str]:
    return [name, name + REFERENCE] if of_one else [name]


def _find(name: str) -> Metric:
    if name not in METRICS:
        raise SettingError(f"unknown metric {name!r}; expected names of {', '.join(METRICS)}")
    return METRICS[name]


def _pair_files(test: Path, reference: Path) -> list[tuple[Path, Path]]:
    for path in (test, reference):
        if not os.path.exists(path):
            raise SettingError(f"{path}: no such file or folder")
    if os.path.isdir(test) != os.path.isdir(reference):
        folder, file = (test, reference) if os.path.isdir(test) else (reference, test)
        raise SettingError(f"{folder} is a folder and {file} a file; expected two files or two folders")
    if not os.path.isdir(test):
        return [(test, reference)]
    names = [_names(folder) for folder in (test, reference)]
    for kind in KINDS:
        tests, references = ({name for name in of if Path(name).suffix.lower() == kind} for of in names)
        if tests and references:
            break
    else:
        raise SettingError(
            f"{test} and {reference}: hold no pictures of one kind; expected {', '.join(KINDS)} files in both"
        )
    for folder, has, lacks in ((reference, tests, references), (test, references, tests)):
        missing = sorted(has - lacks, key=_natural_order)
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise SettingError(f"{folder}: lacks {missing[0]}{more}; expected files of the same names in both folders")
    return [(test / name, reference / name) for name in sorted(tests, key=_natural_order)]


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError as error:
        raise SettingError(f"{folder}: cannot be read ({error.strerror})") from None


def _natural_order(name: str) -> list[tuple[int, int | str]]:
    """A sorting key of file names by which frame_10000 comes after frame_9999."""
    return [
        (0, int(piece)) if piece.isascii() and piece.isdecimal() else (1, piece)
        for piece in re.split(r"([0-9]+)", name)
    ]


def _read_pair(test: Path, reference: Path) -> tuple[Picture, Picture]:
    pair = read_picture(test), read_picture(reference)
    for what, of in {
        "size": lambda p: f"{p.size[0]}x{p.size[1]}",
        "views": lambda p: ", ".join(sorted(p.color)),
        "origin": lambda p: f"({p.origin[0]}, {p.origin[1]})",
        "values": lambda p: "sRGB-encoded" if p.encoded else "linear",
    }.items():
        if of(pair[0]) != of(pair[1]):
            raise SettingError(
                f"{test} has {what} {of(pair[0])} and {reference} {of(pair[1])}; expected the same in both"
            )
    for picture in pair:
        for view, color in picture.color.items():
            bad = np.count_nonzero(~np.isfinite(color).all(axis=-1))
            if bad:
                total = color.shape[0] * color.shape[1]
                raise SettingError(
                    f"{picture.file}: view {view} has {bad:,} of {total:,} pixels that are NaN or infinite; expected finite ones"
                )
    return pair


def _linear(picture: Picture, view: str) -> np.ndarray:
    return decode_srgb(picture.color[view]) if picture.encoded else picture.color[view]


def _reproject(
    values: dict[str, float], maps: dict[str, np.ndarray], name: str, sides: Sequence[Sequence[tuple[Picture, str]]]
) -> None:
    """Add the difference between two views of the test, and of the reference if it has what that takes."""
    test, reference = ([_view(picture, view) for picture, view in side] for side in sides)
    if None in test:
        picture, view = sides[0][test.index(None)]
        raise SettingError(
            f"{picture.file}: view {view} lacks Z or its camera (worldToCamera, fovY); expected both for the {name} difference"
        )
    difference = reprojected_difference(*test)
    values[name], values[name + VALID] = difference.mean, difference.valid
    maps[name] = np.sqrt(difference.map)
    if None not in reference:
        values[name + REFERENCE] = reprojected_difference(*reference).mean


def _view(picture: Picture, view: str) -> View | None:
    if view not in picture.depth or view not in picture.cameras:
        return None
    return View(_linear(picture, view), picture.depth[view], picture.cameras[view])
