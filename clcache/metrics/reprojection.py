"""What differs between two views of one scene where both see the same point: frames of a moving camera, or two eyes.

A pixel of one view is placed in the world by its depth, projected into the other view, and compared with the colour that
is interpolated there; the squared difference of radiance stands for flicker between frames (Philippi et al. 2025, Fig. 10)
and for what disturbs stereo vision between eyes (Philippi et al. 2023, section 4.1 and Fig. 2; 2025, Fig. 15). Pixels whose point the other view
does not show are left out: those that fall outside it, and those that fail the depth test, which compares
reciprocal depths since these are linear across the image of a plane, so that no slope fails it; where surfaces meet, the
interpolated reciprocal depth passes only with next to none of the farther one mixed in. What is infinitely far away is at
reciprocal depth 0 and takes part like everything else.

It is exact for a static scene. Moving objects count as difference, and so do highlights, which belong to the eye.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from ..errors import SettingError
from ..scene.model import Camera
from .image import check_color

DEPTH_TOLERANCE = 0.01  # of the reciprocal depth that is expected
# Pixels by which a point may miss the outermost pixel centres: rounding, where cameras stand still.
EDGE_TOLERANCE = 1e-3


@dataclass(frozen=True)
class View:
    """A picture with what it takes to reproject it.

    color: (H, W, 3), linear radiance, finite. depth: (H, W), planar depth along the viewing axis, metres, > 0, +inf where
    nothing was hit (the AOV Z).
    """

    color: np.ndarray
    depth: np.ndarray
    camera: Camera


@dataclass(frozen=True)
class Difference:
    """map: (H, W) float64, squared difference averaged over channels; NaN where the other view does not show the point.
    mean: of the map's valid pixels; NaN if there are none. valid: their share of all pixels, 0 to 1."""

    map: np.ndarray
    mean: float
    valid: float


def reprojected_difference(view: View, other: View) -> Difference:
    """Reproject `other` into `view` and compare.

    For flicker, `other` is the frame before; for stereo, `view` is the left eye and `other` the right. Raises
    SettingError where sizes differ, a colour is not finite, or a depth is NaN or not positive.
    """
    _check(view, "view")
    _check(other, "other view")
    if view.color.shape != other.color.shape:
        raise SettingError(
            f"views of {view.color.shape[1::-1]} and {other.color.shape[1::-1]} pixels; expected one size"
        )
    row, column, expected = _project(view, other.camera)
    near = 1.0 / other.depth.astype(np.float64)
    height, width = near.shape
    inside = (
        (expected >= 0.0)  # a point behind the camera has a negative one, and NaN is no place at all
        & (np.abs(row - (height - 1) / 2) <= (height - 1) / 2 + EDGE_TOLERANCE)
        & (np.abs(column - (width - 1) / 2) <= (width - 1) / 2 + EDGE_TOLERANCE)
    )
    there = np.where(inside, [row, column], 0.0)
    found = map_coordinates(near, there, order=1, mode="nearest")
    valid = inside & (np.abs(found - expected) <= DEPTH_TOLERANCE * expected)
    squared = np.zeros(near.shape)
    for channel in range(3):
        color = map_coordinates(other.color[..., channel].astype(np.float64), there, order=1, mode="nearest")
        squared += (view.color[..., channel] - color) ** 2 / 3.0
    count = int(np.count_nonzero(valid))
    mean = float(squared[valid].mean()) if count else float("nan")
    return Difference(np.where(valid, squared, np.nan), mean, count / valid.size)


def _project(view: View, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, column (pixel centres at whole numbers) and reciprocal depth at which `camera` sees each pixel's point."""
    height, width = view.depth.shape
    slope_x, slope_y = _slopes(view.camera, width, height)
    x = (2.0 * (np.arange(width) + 0.5) / width - 1.0) * slope_x
    y = (1.0 - 2.0 * (np.arange(height)[:, None] + 0.5) / height) * slope_y
    near = 1.0 / view.depth.astype(np.float64)
    to_world, from_world = (np.vstack((c.transform, (0.0, 0.0, 0.0, 1.0))) for c in (view.camera, camera))
    matrix = np.linalg.solve(from_world, to_world)
    # The homogeneous point (x, y, -1, 1 / depth), which also holds directions: 1 / depth is 0.
    point = [r[0] * x + r[1] * y - r[2] + r[3] * near for r in matrix[:3]]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = -1.0 / point[2]
        slope_x, slope_y = _slopes(camera, width, height)
        column = (point[0] * scale / slope_x + 1.0) * width / 2 - 0.5
        row = (1.0 - point[1] * scale / slope_y) * height / 2 - 0.5
        expected = np.where(point[2] < 0.0, near * scale, -1.0)
    return row, column, expected


def _slopes(camera: Camera, width: int, height: int) -> tuple[float, float]:
    """Half the extent of the image at distance 1, across and up."""
    up = np.tan(camera.fov_y / 2)
    return up * width / height, up


def _check(view: View, what: str) -> None:
    color = check_color(view.color, what)
    if view.depth.shape != color.shape[:2]:
        raise SettingError(f"{what}: depth is {view.depth.shape}; expected {color.shape[:2]}, as the colour")
    if not (view.depth > 0.0).all():
        bad = np.count_nonzero(~(view.depth > 0.0))
        raise SettingError(f"{what}: {bad:,} depths are NaN or not positive; expected positive ones, or infinity")
