"""Pictures read back: what `write_exr` wrote, and the EXR, Radiance HDR and PNG files of other programs, by OpenImageIO.

A picture has one view (`mono`) or several. An EXR file says so by OpenEXR's multi-view convention, in the names of its
channels (see `exr`), or by parts with the attribute `view`. The colour of a view is its channels R, G and B, or Y alone
for a grey picture; alpha is not looked at. Z is its depth, and the attributes `worldToCamera` and `fovY` its camera.
"""

import contextlib
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from ..errors import SettingError
from ..scene.model import Camera
from .exr import COLOR_CHANNELS, REC_709, name_in_view

# What a file of each kind begins with, and OpenImageIO's name of the kind. The endings of file names are not trusted.
SIGNATURES = {b"\x76\x2f\x31\x01": "openexr", b"\x89PNG\r\n\x1a\n": "png", b"#?": "hdr"}
KINDS = (".exr", ".hdr", ".png")
MAX_VALUES = 2**30  # of all channels together, 4 GiB as float32
MONO = "mono"


@dataclass(frozen=True)
class Picture:
    """A picture file's content, by view.

    color: (H, W, 3) float32, linear Rec. 709, or sRGB-encoded in [0, 1] where `encoded`. depth: (H, W) float32, planar
    depth in metres along the viewing axis; only of views that have it. cameras: likewise. channels: of each view all,
    (H, W) float32, by the names that they have in a file with a single view. origin: column and row of the upper left pixel.
    """

    file: str
    encoded: bool
    origin: tuple[int, int]
    color: dict[str, np.ndarray]
    depth: dict[str, np.ndarray]
    cameras: dict[str, Camera]
    channels: dict[str, dict[str, np.ndarray]]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width, _ = next(iter(self.color.values())).shape
        return width, height


def decode_srgb(display: np.ndarray) -> np.ndarray:
    """The inverse of the sRGB transfer function (IEC 61966-2-1). display: in [0, 1]. Returns linear values in [0, 1]."""
    return np.where(display <= 0.04045, display / 12.92, ((np.maximum(display, 0.04045) + 0.055) / 1.055) ** 2.4)


def read_picture(path: str | os.PathLike) -> Picture:
    """Read an EXR, Radiance HDR or PNG file.

    Raises SettingError, with one line, where the file cannot be read, is damaged, holds no colour of the kinds above, is
    too large, or has primaries other than Rec. 709.
    """
    with _opened(os.fspath(path)) as (kind, source):
        return _picture(os.fspath(path), kind, source)


@dataclass(frozen=True)
class Header:
    """What a file says of its first part. size: width, height. channels: their names. attributes: as OpenImageIO gives them."""

    size: tuple[int, int]
    channels: tuple[str, ...]
    attributes: dict[str, object]


def read_header(path: str | os.PathLike) -> Header:
    """A picture's header, without its pixels.

    Raises SettingError, with one line, where the file cannot be read or is damaged.
    """
    with _opened(os.fspath(path)) as (_, source):
        spec = source.spec()
        attributes = {attribute.name: attribute.value for attribute in spec.extra_attribs}
        return Header((spec.width, spec.height), tuple(spec.channelnames), attributes)


@contextlib.contextmanager
def _opened(file: str) -> Iterator[tuple[str, oiio.ImageInput]]:
    """The file's kind, and the file, open."""
    kind = _kind(file)
    as_stored = oiio.ImageSpec()
    as_stored.attribute("oiio:UnassociatedAlpha", 1)
    try:
        source = oiio.ImageInput.open(file, as_stored)
    except UnicodeError:
        raise SettingError(f"{file!r}: the file's name is not UTF-8 text; expected a name that is") from None
    if source is None:
        raise _damaged(file, oiio.geterror())
    try:
        if source.format_name() != kind:
            raise _damaged(file, "")
        yield kind, source
    finally:
        source.close()


def _kind(file: str) -> str:
    try:
        if not os.path.isfile(file):
            raise SettingError(f"{file}: {'not a regular file' if os.path.exists(file) else 'no such file'}")
        with Path(file).open("rb") as stream:
            start = stream.read(max(map(len, SIGNATURES)))
    except (OSError, ValueError) as error:
        raise SettingError(f"{file}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    for signature, kind in SIGNATURES.items():
        if start.startswith(signature):
            return kind
    raise SettingError(f"{file}: not a picture of a known kind; expected an EXR, Radiance HDR or PNG file")


def _damaged(file: str, reason: str) -> SettingError:
    reason = " ".join(reason.replace(f'"{file}"', "").split()) or "its content does not fit its kind"
    return SettingError(f"{file}: the picture is damaged ({reason})")


def _picture(file: str, kind: str, source: oiio.ImageInput) -> Picture:
    planes: dict[tuple[str, str], np.ndarray] = {}  # by view and by the name that the channel has in a single-view file
    cameras: dict[str, Camera] = {}
    origin = None
    part = 0
    while source.seek_subimage(part, 0):
        spec = source.spec()
        _check_part(file, spec)
        if origin is None:
            origin, shape = (spec.x, spec.y), (spec.height, spec.width)
        if (spec.x, spec.y, spec.height, spec.width) == (*origin, *shape):
            _read_part(file, source, part, planes, cameras)
        part += 1
    views = [view for view in dict.fromkeys(view for view, _ in planes) if _color(planes, view) is not None]
    if not views:
        names = ", ".join(dict.fromkeys(name for _, name in planes)) or "none"
        raise SettingError(f"{file}: channels {names[:200]}; expected R, G and B, or Y alone, in one view or more")
    return Picture(
        file,
        kind == "png",
        origin,
        {view: _color(planes, view) for view in views},
        {view: planes[view, "Z"] for view in views if (view, "Z") in planes},
        {view: cameras[view] for view in views if view in cameras},
        {view: {name: plane for (of, name), plane in planes.items() if of == view} for view in views},
    )


def _check_part(file: str, spec: oiio.ImageSpec) -> None:
    if spec.deep:
        raise SettingError(f"{file}: a deep picture; expected one value for each pixel and channel")
    if spec.width * spec.height * spec.nchannels > MAX_VALUES:
        size = f"{spec.width}x{spec.height} with {spec.nchannels} channels"
        raise SettingError(f"{file}: {size}; expected at most {MAX_VALUES:,} values")
    primaries = spec.getattribute("chromaticities")
    if primaries is not None and not np.allclose(primaries, REC_709, atol=1e-3):
        raise SettingError(f"{file}: has primaries (chromaticities) of its own; expected those of Rec. 709")


def _read_part(
    file: str,
    source: oiio.ImageInput,
    part: int,
    planes: dict[tuple[str, str], np.ndarray],
    cameras: dict[str, Camera],
) -> None:
    spec = source.spec()
    pixels = source.read_image(part, 0, 0, spec.nchannels, "float")
    if pixels is None:
        raise _damaged(file, source.geterror())
    listed = spec.getattribute("multiView")
    own = spec.getattribute("view")
    views = [listed] if isinstance(listed, str) else list(listed or [own or MONO])
    for index, name in enumerate(spec.channelnames):
        view, base = (own, name) if own and not listed else split_name(name, views)
        if view is not None:
            planes.setdefault((view, base), pixels[..., index])
    for view in views:
        camera = _camera(file, spec, [view] if own and not listed else views, view)
        if camera is not None:
            cameras.setdefault(view, camera)


def split_name(name: str, views: Sequence[str]) -> tuple[str | None, str]:
    """The inverse of `name_in_view`: a channel's view (None: in no view) and the name that it has in a single-view file."""
    *layers, last = name.split(".")
    if len(views) < 2 or not layers:
        return views[0], name
    if layers[-1] in views:
        return layers[-1], ".".join((*layers[:-1], last))
    return None, name


def _color(planes: dict[tuple[str, str], np.ndarray], view: str) -> np.ndarray | None:
    names = {name for of, name in planes if of == view}
    if names.issuperset(COLOR_CHANNELS):
        return np.stack([planes[view, name] for name in COLOR_CHANNELS], axis=-1)
    if "Y" in names and not names & {"RY", "BY", *COLOR_CHANNELS}:
        return np.repeat(planes[view, "Y"][..., None], 3, axis=-1)
    return None


def _camera(file: str, spec: oiio.ImageSpec, views: Sequence[str], view: str) -> Camera | None:
    matrix = spec.getattribute(name_in_view("worldToCamera", views, view))
    fov_y = spec.getattribute(name_in_view("fovY", views, view))
    if matrix is None or fov_y is None:
        return None
    to_right_handed = np.diag((1.0, 1.0, -1.0, 1.0))
    try:
        camera_to_world = np.linalg.inv(to_right_handed @ np.reshape(np.asarray(matrix, np.float64), (4, 4)).T)
        if not (np.isfinite(camera_to_world).all() and 0.0 < float(fov_y) < math.pi):
            raise ValueError
    except (ValueError, TypeError, np.linalg.LinAlgError):
        raise SettingError(
            f"{file}: the attributes worldToCamera and fovY of view {view} are no camera; "
            "expected an invertible 4x4 matrix and an angle in (0, pi)"
        ) from None
    return Camera(camera_to_world[:3], float(fov_y))
