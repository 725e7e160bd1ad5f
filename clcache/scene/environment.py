"""Environments from picture files: Radiance .hdr and OpenEXR, latitude by longitude.

The top row of the picture is up (+Y), its centre is looked at along -Z as a camera looks, its right half is +X.
"""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from ..errors import SceneError

FORMATS = (".exr", ".hdr")

_MOST_PIXELS = 1 << 26
_LARGEST = 1e30  # as of every radiance that a scene gives


def read_environment(path: Path, where: str) -> np.ndarray:
    """(h, w, 3) float32 linear radiance of a picture file. where: file and place that messages begin with.

    Pixels between the data window and the display window of an OpenEXR file are black; a picture of luminance alone is
    grey. Raises SceneError if the file is no such picture, is damaged or too large, or has values that are no radiance.
    """
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{where}: expected a picture with the suffix {' or '.join(FORMATS)}")
    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise SceneError(f"{where}: not a readable picture ({_one_line(oiio.geterror())})")
    try:
        spec = file.spec()
        channels = _channels(spec, where)
        if max(spec.width * spec.height, spec.full_width * spec.full_height) > _MOST_PIXELS:
            raise SceneError(f"{where}: {spec.width} x {spec.height} pixels; expected at most {_MOST_PIXELS:,} in all")
        first, last = min(channels), max(channels) + 1
        pixels = file.read_image(0, 0, first, last, "float") if last - first <= 8 else None
        if pixels is None:
            raise SceneError(f"{where}: the picture is damaged ({_one_line(file.geterror())})")
    finally:
        file.close()
    radiance = np.ascontiguousarray(pixels[..., [c - first for c in channels]])
    _check(radiance, where)
    return _in_display_window(radiance, spec)


def turned(picture: np.ndarray, degrees: float) -> np.ndarray:
    """The environment turned about +Y, counter-clockwise as seen from above; between columns it is interpolated."""
    columns = degrees / 360 * picture.shape[1]
    whole = int(np.floor(columns))
    part = np.float32(columns - whole)
    moved = np.roll(picture, -whole, axis=1)
    return moved if part == 0 else (1 - part) * moved + part * np.roll(moved, -1, axis=1)


def _one_line(message: str) -> str:
    return " ".join(message.split())[:200] or "cut short"


def _channels(spec: oiio.ImageSpec, where: str) -> list[int]:
    """The numbers of the channels that are red, green and blue."""
    if spec.getattribute("textureformat") == "CubeFace Environment":
        raise SceneError(f"{where}: a cube map; expected a picture of latitude by longitude")
    names = list(spec.channelnames)
    if all(name in names for name in "RGB"):
        return [names.index(name) for name in "RGB"]
    if "Y" in names and not {"RY", "BY"} & set(names):
        return [names.index("Y")] * 3
    raise SceneError(f"{where}: the picture has the channels {', '.join(names[:8])}; expected R, G and B")


def _check(radiance: np.ndarray, where: str) -> None:
    good = (radiance >= 0) & (radiance <= _LARGEST)  # false for NaN, too
    if not good.all():
        row, column, channel = np.unravel_index(int(np.argmin(good)), good.shape)
        raise SceneError(
            f"{where}: pixel ({column}, {row}) is {radiance[row, column, channel]:g} in {'RGB'[channel]}; "
            f"expected radiance from 0 to {_LARGEST:g}"
        )


def _in_display_window(radiance: np.ndarray, spec: oiio.ImageSpec) -> np.ndarray:
    if (spec.x, spec.y, spec.width, spec.height) == (spec.full_x, spec.full_y, spec.full_width, spec.full_height):
        return radiance
    canvas = np.zeros((spec.full_height, spec.full_width, 3), np.float32)
    left, top = spec.x - spec.full_x, spec.y - spec.full_y
    rows = slice(max(top, 0), max(min(top + spec.height, spec.full_height), 0))
    columns = slice(max(left, 0), max(min(left + spec.width, spec.full_width), 0))
    window = radiance[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    if window.size:
        canvas[rows, columns] = window
    return canvas
