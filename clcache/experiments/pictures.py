"""Pictures of a report: what each configuration shows, enlarged where they differ the most, and how far they are from
the truth.

The places that are enlarged are found and not chosen: where the errors of configurations, over an inset's square, are
the furthest apart, and again at some distance of that. Without a reference the pictures themselves stand for errors.
Pictures are kept without loss if they are few, and as good as fits a page if they are many; insets always are without
loss.
"""

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy.ndimage import uniform_filter

from ..metrics.heatmap import to_colors
from ..output.png import to_bytes
from .experiment import Labelled
from .job import Result

REFERENCE = "reference"
EPSILON = 0.01  # of relative squared errors, as in relMSE
QUALITIES = (None, 92, 85, 75)  # of WebP; None is without loss
BUDGET = 6_000_000  # bytes of all pictures of a page, before they are written as text


@dataclass(frozen=True)
class Inset:
    """A square of a picture: its corner and size in pixels, and the picture of it."""

    x: int
    y: int
    size: int
    uri: str


@dataclass(frozen=True)
class Shown:
    """A picture: its name, itself, how far it is from the reference, if there is one, and the insets."""

    name: str
    uri: str
    difference: str | None
    insets: tuple[Inset, ...]


@dataclass(frozen=True)
class Strip:
    """The pictures of one frame of a scene, the reference first, of width x height pixels."""

    scene: str
    frame: str
    eye: str
    width: int
    height: int
    shown: tuple[Shown, ...]


Frames = dict[tuple[str, str, str, tuple[int, ...]], dict[str, np.ndarray]]


def strips(found: Sequence[tuple[Labelled, Result]]) -> list[Strip]:
    """All pictures that results have, of the first seed of each, and with two eyes the left one."""
    frames = collected(found)
    for quality in QUALITIES:
        made, taken = [], 0
        for (scene, frame, eye, _), pictures in frames.items():
            made.append(_strip(scene, frame, eye, pictures, quality))
            taken += sum(len(shown.uri) + len(shown.difference or "") for shown in made[-1].shown) * 3 // 4
            if taken > BUDGET and quality != QUALITIES[-1]:
                break
            if taken > 1.3 * BUDGET:
                return made[:-1]
        else:
            return made
    return made


def collected(found: Sequence[tuple[Labelled, Result]]) -> Frames:
    """The pictures by scene, frame, eye and shape, and of these by name: linear, (H, W, 3)."""
    frames: Frames = {}
    for labelled, result in found:
        for key, image in result.arrays.items():
            if key.startswith("picture/") and not key.endswith("/right"):
                name, frame, eye = key.removeprefix("picture/").rsplit("/", 2)
                place = frames.setdefault((str(labelled.labels.get("scene", "")), frame, eye, image.shape), {})
                place.setdefault(name, np.asarray(image, dtype=np.float32))
    ordered = {}
    for place, images in frames.items():
        truth = {REFERENCE: images[REFERENCE]} if REFERENCE in images else {}
        if images.keys() - truth.keys():
            ordered[place] = truth | images
    return ordered


def _strip(scene: str, frame: str, eye: str, pictures: Mapping[str, np.ndarray], quality: int | None) -> Strip:
    reference = pictures.get(REFERENCE)
    differences = (
        {} if reference is None else {n: difference(p, reference) for n, p in pictures.items() if n != REFERENCE}
    )
    height, width = next(iter(pictures.values())).shape[:2]
    size = min(max(16, min(height, width) // 6), min(height, width) // 2)
    corners = places(list((differences or pictures).values()), size)
    shown = []
    for name, picture in pictures.items():
        display = to_bytes(picture)
        insets = (Inset(x, y, size, data_uri(display[y : y + size, x : x + size])) for x, y in corners)
        own = data_uri(to_colors(differences[name]), quality or 90, "WEBP") if name in differences else None
        shown.append(Shown(name, data_uri(display, quality, "WEBP"), own, tuple(insets)))
    return Strip(scene, frame, eye, width, height, tuple(shown))


def difference(picture: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The relative squared error of each pixel, the mean over channels. Returns (H, W)."""
    return np.mean((picture - reference) ** 2 / (reference**2 + EPSILON), axis=-1)


def places(maps: Sequence[np.ndarray], size: int, count: int = 2) -> list[tuple[int, int]]:
    """The corners (x, y) of squares in which maps differ the most from each other, and which lie apart. maps: (H, W) or
    (H, W, 3)."""
    if len(maps) < 2 or min(maps[0].shape[:2]) < size:
        return []
    flat = [np.minimum(np.nan_to_num(m if m.ndim == 2 else m.mean(axis=-1)), 1.0) for m in maps]
    means = np.stack([uniform_filter(m, size, mode="nearest") for m in flat])
    spread = np.sqrt(np.maximum(means, 0.0)).std(axis=0)
    half = size // 2
    height, width = spread.shape
    inner = spread[half : height - size + half + 1, half : width - size + half + 1].copy()
    found = []
    for _ in range(count):
        if not np.isfinite(inner).any():
            break
        y, x = np.unravel_index(np.argmax(inner), inner.shape)
        found.append((int(x), int(y)))
        apart = int(1.5 * size)
        inner[max(0, y - apart) : y + apart + 1, max(0, x - apart) : x + apart + 1] = -np.inf
    return found


def data_uri(image: np.ndarray, quality: int | None = None, form: str = "PNG") -> str:
    """A picture as an address that has all of it. image: (H, W, 3) uint8. quality: of WebP, without loss if None."""
    stream = io.BytesIO()
    how = (
        {"lossless": quality is None, "quality": 60 if quality is None else quality, "method": 3}
        if form == "WEBP"
        else {"optimize": True}
    )
    Image.fromarray(image).save(stream, format=form, **how)
    return f"data:image/{form.lower()};base64,{base64.b64encode(stream.getvalue()).decode()}"
