"""Pictures, of whatever kind Pillow reads, as 8-bit sRGB textures."""

import io
import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from ..errors import SceneError
from .files import read_bytes
from .model import Texture


def read_picture(path: Path, where: str) -> np.ndarray:
    """The pixels of a picture file, as `decode_picture` gives them. Raises SceneError."""
    return decode_picture(read_bytes(path, where), where)


def decode_picture(data: bytes, where: str) -> np.ndarray:
    """(h, w, 4) uint8 RGBA, sRGB-encoded, top row first, from the bytes of a picture file.

    16-bit pictures are rounded to 8 bits. Floating-point pictures hold linear light by convention: they are clipped to
    [0, 1] and encoded. Raises SceneError if the data is no picture, is cut short, has values that are not finite, or would take
    more pixels than Pillow holds to be safe to unpack.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures and of odd metadata
            with Image.open(io.BytesIO(data)) as picture:
                return _to_rgba8(picture, where)
    except Image.DecompressionBombError:
        raise SceneError(
            f"{where}: the picture has too many pixels; expected at most {2 * Image.MAX_IMAGE_PIXELS:,}"
        ) from None
    except Image.UnidentifiedImageError:
        raise SceneError(f"{where}: not a picture in a format that Pillow reads") from None
    except (OSError, ValueError, SyntaxError, EOFError, IndexError, TypeError, OverflowError) as error:
        raise SceneError(f"{where}: the picture is damaged ({' '.join(str(error).split())})") from None


def _to_rgba8(picture: Image.Image, where: str) -> np.ndarray:
    if picture.mode.startswith(
        "I"
    ):  # I;16 and its byte orders; I, in which Pillow hands out 16-bit greys of some formats
        grey = np.clip(np.asarray(picture).astype(np.float64), 0, 65535)
        return _grey_to_rgba8(np.rint(grey / 257).astype(np.uint8))
    if picture.mode == "F":
        values = np.asarray(picture)
        _check_finite(values, where)
        grey = np.clip(values, 0.0, 1.0)
        return _grey_to_rgba8(np.rint(255 * encode_srgb(grey)).astype(np.uint8))
    return np.array(picture.convert("RGBA"), np.uint8)


def _check_finite(values: np.ndarray, where: str) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        row, column = np.unravel_index(int(np.argmin(finite)), finite.shape)
        raise SceneError(f"{where}: pixel ({column}, {row}) is {values[row, column]:g}; expected finite numbers")


def _grey_to_rgba8(grey: np.ndarray) -> np.ndarray:
    return np.dstack([grey, grey, grey, np.full_like(grey, 255)])


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """The sRGB transfer function (IEC 61966-2-1) of linear values in [0, 1]."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """The inverse of the sRGB transfer function (IEC 61966-2-1), of values in [0, 1]."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def mip_chain(texture: Texture) -> list[np.ndarray]:
    """The picture and its mip levels, each (h, w, 4) uint8, half as wide and high as the one before (rounded down, at least
    1), to a single texel. Colours are averaged as linear light, over the area that a texel covers."""
    levels = [texture.pixels]
    values = texture.pixels.astype(np.float32) / 255
    if texture.srgb:
        values[..., :3] = srgb_to_linear(values[..., :3])
    while max(values.shape[:2]) > 1:
        values = _halved(_halved(values).swapaxes(0, 1)).swapaxes(0, 1)
        encoded = np.clip(values, 0.0, 1.0)
        if texture.srgb:
            encoded[..., :3] = encode_srgb(encoded[..., :3])
        levels.append(np.rint(255 * encoded).astype(np.uint8))
    return levels


def _halved(rows: np.ndarray) -> np.ndarray:
    """Half as many rows (h, w, 4), rounded down, each the mean over the part of the picture that it covers; one stays one."""
    count = len(rows) // 2
    if len(rows) % 2 == 0:
        return 0.5 * (rows[0::2] + rows[1::2])
    if count == 0:
        return rows
    # A row covers the whole of one, and parts of the two about it that add up to 1 + 1 / count of them.
    part = (np.arange(count, dtype=np.float32)[:, None, None] + 1) / count
    both = (1 + 1 / count - part) * rows[0:-1:2] + part * rows[2::2]
    return ((rows[1::2] + both) * (count / len(rows))).astype(np.float32)


def mean_color(texture: Texture) -> np.ndarray:
    """The mean of the picture's linear colour: (3,) float64."""
    colors = texture.pixels[..., :3].reshape(-1, 3)
    table = srgb_to_linear(np.arange(256) / 255) if texture.srgb else np.arange(256) / 255
    return table[colors].mean(axis=0)
