"""OpenEXR files: one per frame, of one view (mono) or of the views `left` and `right`, with AOVs and provenance.

Channels. All are 32-bit float, so that nothing that was rendered is rounded or overflows, in scan lines with lossless ZIP
compression. In a mono file they have the conventional names: R, G, B, and those of `AOVS`. A stereo file follows
OpenEXR's multi-view convention (openexr.com, "Storing Multi-View Images in OpenEXR Files"): the attribute `multiView`
lists the views, the first of which is the default view; the view's name is the last component but one of a channel's
name; only names without a period stand for the default view. So there are R and right.R, Z and right.Z, but albedo.left.R
and albedo.right.R: a channel albedo.R would belong to no view.

Attributes. `scene`, `method`, `temporal`, `stereoBlend`, `memo`, `settings` (JSON), `seed` (text, since 64 bits do not fit an integer attribute; of a merged
file all of them, with commas between), `frame`, `software`, `framesPerSecond`, in stereo `eyeDistance` (metres), and for
each view, named as its channels are, `spp` (samples taken for each pixel), `worldToCamera` and `fovY` (vertical field of
view, radians). `sceneDigest` and `cameraDigest` tell scenes and camera paths apart by their content; a merged file has those that
all its sources share. `worldToCamera` is as OpenEXR defines it: a 4x4 matrix to
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

from ..scene.digest import camera_digest, scene_digest
from ..scene.model import Camera, Scene
from ..version import __version__
from .aov import AOVS
from .files import atomic_path

if TYPE_CHECKING:
    from ..renderer import Frame

COLOR = "color"
COLOR_CHANNELS = ("R", "G", "B")
SOFTWARE = f"clcache {__version__}"
REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x and y of red, green, blue and white (ITU-R BT.709)


def provenance(scene: Scene, stats: Mapping[str, object]) -> dict[str, object]:
    """The attributes that all frames of a render share. stats: `Renderer.stats()`."""
    return {
        "software": SOFTWARE,
        "scene": scene.file.encode("utf-8", "backslashreplace").decode("utf-8"),
        "sceneDigest": scene_digest(scene),
        "cameraDigest": camera_digest(scene),
        "method": stats["method"],
        "temporal": stats["temporal"],
        "stereoBlend": stats["stereo_blend"],
        "memo": stats["memo"]["kind"],
        "settings": json.dumps(stats["settings"], sort_keys=True),
        "seed": str(stats["seed"]),
        # A denominator of 1001 holds the broadcast rates exactly, and keeps the numerator within 32 bits.
        "framesPerSecond": Fraction(scene.defaults.fps).limit_denominator(1001),
        "chromaticities": REC_709,
    }


def sample_counts(spp: Mapping[str, int]) -> dict[str, int]:
    """The attributes that say how many samples each view has. spp: by view, in the file's order."""
    return {name_in_view("spp", list(spp), view): count for view, count in spp.items()}


def write_exr(path: str | os.PathLike, frame: "Frame", aovs: Iterable[str], attributes: Mapping[str, object]) -> None:
    """Write a frame's colour and the AOVs of these names, whole or not at all.

    attributes: as `provenance` and `sample_counts` make them; the frame's number and cameras are added. Raises Error where
    the file cannot be written.
    """
    views = list(frame.color)
    header = {**attributes, "frame": int(frame.number)}
    if len(views) > 1:
        left, right = (frame.cameras[view].transform[:, 3] for view in views)
        header |= {"multiView": views, "eyeDistance": float(np.linalg.norm(right - left))}
    images = {}
    for view in views:
        images[view] = {COLOR: frame.color[view], **{name: frame.aov(name, eye=view) for name in aovs}}
        header[name_in_view("worldToCamera", views, view)] = world_to_camera(frame.cameras[view])
        header[name_in_view("fovY", views, view)] = float(frame.cameras[view].fov_y)
    write_images(path, images, header)


def write_images(
    path: str | os.PathLike, images: Mapping[str, Mapping[str, np.ndarray]], header: Mapping[str, object]
) -> None:
    """Write images with a header as it is given, whole or not at all.

    images: view -> COLOR or an AOV's name -> (H, W) or (H, W, 3). Raises Error where the file cannot be written.
    """
    channels = {
        name_in_view(channel, list(images), view): np.ascontiguousarray(plane, dtype=np.float32)
        for view, of_view in images.items()
        for name, image in of_view.items()
        for channel, plane in zip(channel_names(name), np.moveaxis(np.atleast_3d(image), -1, 0), strict=True)
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    # OpenEXR does not report a full disk when it writes to a path; writing its bytes ourselves does.
    encoded = io.BytesIO()
    with OpenEXR.File(header, channels) as file:
        file.write(encoded)
    with atomic_path(path) as part:
        part.write_bytes(encoded.getbuffer())


def channel_names(image: str) -> tuple[str, ...]:
    """The channels that COLOR or an AOV has in a file with a single view."""
    return COLOR_CHANNELS if image == COLOR else AOVS[image].channels


def all_channels(aovs: Iterable[str], views: Sequence[str]) -> list[str]:
    """The channels of a file with the colour and these AOVs of each view."""
    of_view = [channel for image in (COLOR, *aovs) for channel in channel_names(image)]
    return [name_in_view(channel, views, view) for view in views for channel in of_view]


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
