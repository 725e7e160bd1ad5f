"""Error maps as pictures: logarithmic, from 0.1 % to 100 %, so that the maps of different renders can be laid side by side."""

import os

import numpy as np
from cmap import Colormap
from PIL import Image

from ..output.files import atomic_path

LOW, HIGH = 1e-3, 1.0  # the errors at the two ends of the colours
COLORS = "magma"  # perceptually uniform, from black to white
NO_VALUE = (0, 96, 96)  # a hue that the colours lack


def to_colors(error: np.ndarray) -> np.ndarray:
    """The picture of an error map. error: (H, W), >= 0, NaN where there is none. Returns (H, W, 3) uint8, sRGB."""
    known = np.isfinite(error)
    decades = np.log10(np.clip(np.where(known, error, LOW), LOW, HIGH) / LOW) / np.log10(HIGH / LOW)
    table = np.rint(Colormap(COLORS).lut(256)[:, :3] * 255.0).astype(np.uint8)
    return np.where(known[..., None], table[np.rint(decades * 255.0).astype(np.uint8)], np.array(NO_VALUE, np.uint8))


def write_heatmap(path: str | os.PathLike, error: np.ndarray) -> None:
    """Write an error map as a PNG picture, whole or not at all. Raises Error where it cannot be written."""
    with atomic_path(path) as part, part.open("wb") as file:
        Image.fromarray(to_colors(error)).save(file, format="PNG")
