"""Stereo blending in NumPy and double precision: what the kernel (clcache/cl/samplecache/blend.cl) is checked against.

It follows section 3.6 and 5.2 of "Stable Sample Caching for Interactive Stereoscopic Ray Tracing", in whole images: the
nine pixels of the other eye about each point are nine images here.
"""

from dataclasses import dataclass

import numpy as np

from clcache.scene.model import Camera

DEPTH_TOLERANCE, REACH, LEAST_WEIGHT = 0.01, 2.5, 0.1  # as the kernel's
NEIGHBOURS = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]


@dataclass(frozen=True)
class Eye:
    """What blending is given of an eye. color: (H, W, 3). moments: (H, W, 8), rows as `clcache.passes.blend` has them."""

    color: np.ndarray
    moments: np.ndarray
    camera: Camera


@dataclass(frozen=True)
class Blended:
    """color: (H, W, 3). other: (H, W, 3), X, what the other eye shows. part: (H, W, 3), X's weight, 1 - beta. is_seen:
    (H, W), whether there is an X. margin: (H, W), how far, relatively, the pixel is from being decided otherwise."""

    color: np.ndarray
    other: np.ndarray
    part: np.ndarray
    is_seen: np.ndarray
    margin: np.ndarray


def dodgson(distance: np.ndarray, r: float) -> np.ndarray:
    """Dodgson's family of piecewise quadratics: 1 for r interpolates, 1/2 is the quadratic B-spline."""
    s = np.abs(distance)
    inner = -2 * r * s**2 + (r + 1) / 2
    outer = r * s**2 - (2 * r + 0.5) * s + 0.75 * (r + 1)
    return np.where(s <= 0.5, inner, np.where(s <= 1.5, outer, 0.0))


def blend(eye: Eye, other: Eye, sharpness: float) -> Blended:
    """`eye`'s colour blended with the other's, by the moments of both."""
    color = eye.color.astype(np.float64)
    height, width, _ = color.shape
    mean, count, spread, near = _parts(eye.moments)
    x, y, expected = _project(eye.camera, other.camera, near)
    with np.errstate(invalid="ignore"):
        inside = (expected >= 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height) & (count > 0)
        margin = np.minimum.reduce([np.abs(v - np.rint(v)) for v in (x, y)])
    margin = np.where(np.isfinite(margin), margin, 1.0)
    x, y, expected = (np.where(inside, v, 0.0) for v in (x, y, expected))
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    there = _parts(other.moments)
    allowed = DEPTH_TOLERANCE * expected + REACH * _slope(there[3], row, column)

    total, lowest, highest = np.zeros((height, width)), np.full_like(color, np.inf), np.full_like(color, -np.inf)
    found, first, second = np.zeros_like(color), np.zeros_like(color), np.zeros_like(color)
    for dy, dx in NEIGHBOURS:
        at, is_there = _within(row + dy, column + dx, height, width)
        w = dodgson(x - (column + dx + 0.5), sharpness) * dodgson(y - (row + dy + 0.5), sharpness)
        away = np.abs(there[3][at] - expected)
        passes = is_there & (there[1][at] > 0) & ((there[3][at] > 0) == (expected > 0)) & (away <= allowed) & (w != 0)
        decided = np.abs(away - allowed) / np.where(allowed > 0, allowed, 1.0)
        margin = np.minimum(margin, np.where(is_there & (allowed > 0), decided, 1.0))
        w = np.where(passes, w, 0.0)
        value = other.color[at].astype(np.float64)
        total += w
        found += w[..., None] * (value - color)
        lowest = np.where(passes[..., None], np.minimum(lowest, value - color), lowest)
        highest = np.where(passes[..., None], np.maximum(highest, value - color), highest)
        deviation = there[0][at] - mean
        first += w[..., None] * deviation
        second += w[..., None] * (there[2][at] + deviation**2)
    is_seen = inside & (total >= LEAST_WEIGHT)
    margin = np.minimum(margin, np.where(inside, np.abs(total - LEAST_WEIGHT), 1.0))
    sure = np.where(is_seen, total, 1.0)[..., None]
    difference = np.where(is_seen[..., None], np.clip(found / sure, lowest, highest), 0.0)
    own_first, own_second = _blurred(mean, count, spread, 1.0 - sharpness)
    variance = np.maximum(own_second - own_first**2, 0.0)
    denominator = (first / sure - own_first) ** 2 + np.maximum(second / sure - (first / sure) ** 2, 0.0) + variance
    part = np.divide(variance, denominator, out=np.zeros_like(color), where=denominator > 0)
    part = np.where(is_seen[..., None], part, 0.0)
    return Blended(color + part * difference, color + difference, part, is_seen, margin)


def _parts(moments: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rows = moments.astype(np.float64)
    return rows[..., :3], rows[..., 3], rows[..., 4:7], rows[..., 7]


def _project(camera: Camera, other: Camera, near: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Column and row, in pixels, and reciprocal depth at which the other camera has each pixel; the latter negative where it
    is not in front of its near plane."""
    height, width = near.shape
    (slope_x, slope_y), (other_x, other_y) = (
        (np.tan(c.fov_y / 2) * width / height, np.tan(c.fov_y / 2)) for c in (camera, other)
    )
    to_world, from_world = (np.vstack((c.transform, (0.0, 0.0, 0.0, 1.0))) for c in (camera, other))
    across = ((np.arange(width) + 0.5) / width * 2 - 1) * slope_x
    up = (1 - (np.arange(height)[:, None] + 0.5) / height * 2) * slope_y
    point = np.stack(np.broadcast_arrays(across, up, -1.0, near), axis=-1) @ np.linalg.solve(from_world, to_world).T
    depth = -point[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (point[..., 0] / depth / other_x + 1) / 2 * width
        y = (1 - point[..., 1] / depth / other_y) / 2 * height
        return x, y, np.where(depth > near * other.near, near / depth, -1.0)


def _within(row: np.ndarray, column: np.ndarray, height: int, width: int) -> tuple[tuple, np.ndarray]:
    """Indices that are within the image in any case, and where they are the ones that were asked for."""
    at = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    return at, (at[0] == row) & (at[1] == column)


def _slope(near: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Steps of the reciprocal depth to the next pixel: the least along each axis, together."""
    total = np.zeros(near.shape)
    for axis in (0, 1):
        if near.shape[axis] > 1:
            steps = np.diff(near, axis=axis)
            pad = [(1, 1) if a == axis else (0, 0) for a in (0, 1)]
            steps = np.pad(steps, pad)  # of pixel i, from before it is steps[i], to after it steps[i + 1]
            before, after = steps[row, column], steps[(row + 1, column) if axis == 0 else (row, column + 1)]
            total += np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    return total


def _blurred(mean: np.ndarray, count: np.ndarray, spread: np.ndarray, aside: float) -> tuple[np.ndarray, np.ndarray]:
    """First and second moments over 3x3 pixels, about the mean of the middle one."""
    height, width = count.shape
    row, column = np.mgrid[:height, :width]
    total, first, second = np.zeros((height, width, 1)), np.zeros_like(mean), np.zeros_like(mean)
    for dy, dx in NEIGHBOURS:
        at, is_there = _within(row + dy, column + dx, height, width)
        w = np.where(is_there & (count[at] > 0), 1.0 if dy == dx == 0 else aside, 0.0)[..., None]
        deviation = mean[at] - mean
        total += w
        first += w * deviation
        second += w * (spread[at] + deviation**2)
    total = np.where(total > 0, total, 1.0)
    return first / total, second / total
