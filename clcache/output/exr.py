"""OpenEXR files: one per frame, of one view (mono) or of the views `left` and `right`, with AOVs and provenance.

Channels. All are 32-bit float, so that nothing that was rendered is rounded or overflows, in scan lines with lossless ZIP
compression. In a mono file they have the conventional names: R, G, B, and those of `AOVS`. A stereo file follows
OpenEXR's multi-view convention (openexr.com, "Storing Multi-View Images in OpenEXR Files"): the attribute `multiView`
lists the views, the first of which is the default view; the view's name is the last component but one of a channel's
name; only names without a period stand for the default view. So there are R and right.R, Z and right.Z, but albedo.left.R
and albedo.right.R: a channel albedo.R would belong to no view.

Attributes. `scene`, `method`, `settings` (JSON), `seed` (text, since 64 bits do not fit an integer attribute), `spp`,
`frame`, `software`, `framesPerSecond`, in stereo `eyeDistance` (metres), and for each view, named as its channels are,
`worldToCamera` and `fovY` (vertical field of view, radians). `worldToCamera` is as OpenEXR defines it: a 4x4 matrix to
multiply a row vector with from its left, into a left-handed space with x to the right, y up and z along the view.
"""

import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import OpenEXR

from ..scene.model import Camera, Scene
from .aov import AOVS
from .files import atomic_path

if TYPE_CHECKING:
    from ..renderer import Frame

COLOR_CHANNELS = ("R", "G", "B")
REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x and y of red, green, blue and white (ITU-R BT.709)


def provenance(scene: Scene, stats: Mapping[str, object]) -> dict[str, object]:
    """The attributes that all frames of a render share. stats: `Renderer.stats()`."""
    return {
        "software": f"clcache {stats['version']}",
        "scene": scene.file.encode("utf-8", "backslashreplace").decode("utf-8"),
        "method": stats["method"],
        "settings": json.dumps(stats["settings"], sort_keys=True),
        "seed": str(stats["seed"]),
        "spp": stats["spp"],
        # A denominator of 1001 holds the broadcast rates exactly, and keeps the numerator within 32 bits.
        "framesPerSecond": Fraction(scene.defaults.fps).limit_denominator(1001),
        "chromaticities": REC_709,
    }


def write_exr(path: str | os.PathLike, frame: "Frame", aovs: Iterable[str], attributes: Mapping[str, object]) -> None:
    """Write a frame's colour and the AOVs of these names, whole or not at all.

    attributes: as `provenance` makes them; those of this frame and of its views are added. Raises Error where the file
    cannot be written.
    """
    views = list(frame.color)
    channels: dict[str, np.ndarray] = {}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        **attributes,
        "frame": int(frame.number),
    }
    if len(views) > 1:
        left, right = (frame.cameras[view].transform[:, 3] for view in views)
        header |= {"multiView": views, "eyeDistance": float(np.linalg.norm(right - left))}
    for view in views:
        _add_image(channels, views, view, COLOR_CHANNELS, frame.color[view])
        for name in aovs:
            _add_image(channels, views, view, AOVS[name].channels, frame.aov(name, eye=view))
        header[name_in_view("worldToCamera", views, view)] = world_to_camera(frame.cameras[view])
        header[name_in_view("fovY", views, view)] = float(frame.cameras[view].fov_y)
    # OpenEXR does not report a full disk when it writes to a path; writing its bytes ourselves does.
    encoded = io.BytesIO()
    with OpenEXR.File(header, channels) as file:
        file.write(encoded)
    with atomic_path(path) as part:
        part.write_bytes(encoded.getbuffer())


def name_in_view(name: str, views: Sequence[str], view: str) -> str:
    """The name that a channel of a single-view file has in `view`, one of `views` (the first is the default view)."""
    *layers, last = name.split(".")
    if len(views) < 2 or (view == views[0] and not layers):
        return name
    return ".".join((*layers, view, last))


def world_to_camera(camera: Camera) -> np.ndarray:
    """OpenEXR's standard attribute of this name, (4, 4) float32: row vectors, left-handed, z along the view."""
    camera_to_world = np.vstack((camera.transform, (0.0, 0.0, 0.0, 1.0)))
    to_left_handed = np.diag((1.0, 1.0, -1.0, 1.0))
    return np.ascontiguousarray((to_left_handed @ np.linalg.inv(camera_to_world)).T, dtype=np.float32)


def _add_image(
    channels: dict[str, np.ndarray], views: Sequence[str], view: str, names: Sequence[str], image: np.ndarray
) -> None:
    planes = np.moveaxis(np.atleast_3d(image), -1, 0)
    for name, plane in zip(names, planes, strict=True):
        channels[name_in_view(name, views, view)] = np.ascontiguousarray(plane, dtype=np.float32)
