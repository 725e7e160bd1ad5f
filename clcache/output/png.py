"""8-bit PNG pictures for looking at: linear radiance through a tone curve, then the sRGB encoding.

The tone curve is Khronos PBR Neutral (Khronos Group, "Khronos PBR Neutral Tone Mapper Specification", 2024) at exposure
1: a base colour under white light comes out as itself, highlights from 0.8 on are compressed towards 1 and, the brighter
they are, desaturated towards white. Negative radiance counts as 0. A pixel with a component that is NaN or infinite is
a defect of the render, and is magenta so that it is seen; EXR files keep the value.
"""

import os

import numpy as np
from PIL import Image

from .files import atomic_path

F90 = 0.04  # the reflectance that the curve takes off, that of a dielectric at normal incidence
START = 0.8 - F90  # peak value where compression starts
DESATURATION = 0.15
NOT_FINITE = (255, 0, 255)


def tone_map(color: np.ndarray) -> np.ndarray:
    """Khronos PBR Neutral. color: (..., 3), linear Rec. 709, finite. Returns float32 of that shape in [0, 1]."""
    color = np.maximum(np.asarray(color, dtype=np.float32), 0.0)
    lowest = color.min(axis=-1, keepdims=True)
    toe = np.minimum(lowest, 2 * F90)
    color = color - (toe - toe * toe / (4 * F90))
    peak = color.max(axis=-1, keepdims=True)
    excess = np.maximum(peak - START, 0.0)
    knee = 1.0 - START
    compressed = np.where(excess > 0.0, 1.0 - knee * knee / (excess + knee), peak)
    scale = np.divide(compressed, peak, out=np.ones_like(peak), where=excess > 0.0)
    whiteness = 1.0 - 1.0 / (DESATURATION * (peak - compressed) + 1.0)
    mapped = color * scale * (1.0 - whiteness) + compressed * whiteness
    return np.clip(mapped, 0.0, 1.0).astype(np.float32)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """The sRGB transfer function (IEC 61966-2-1). linear: in [0, 1]. Returns display values in [0, 1]."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def to_bytes(color: np.ndarray) -> np.ndarray:
    """The picture of a linear image. color: (H, W, 3) float32. Returns (H, W, 3) uint8, sRGB."""
    finite = np.isfinite(color).all(axis=-1, keepdims=True)
    display = encode_srgb(tone_map(np.where(finite, color, 0.0)))
    return np.where(finite, np.rint(display * 255.0), NOT_FINITE).astype(np.uint8)


def write_png(path: str | os.PathLike, color: np.ndarray) -> None:
    """Write a linear image, (H, W, 3) float32, as a picture, whole or not at all. Raises Error where it cannot be written."""
    with atomic_path(path) as part, part.open("wb") as file:
        Image.fromarray(to_bytes(color)).save(file, format="PNG")
