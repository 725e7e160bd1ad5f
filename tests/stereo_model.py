"""Stereo filtering in NumPy and double precision, written from the paper (Philippi et al. 2023, Eq. 4, 10 and 11), in whole
images: the four pixels about each point, and the nine of a neighbourhood, are as many images here."""

from dataclasses import dataclass

import numpy as np

from clcache.scene.model import Camera

DEPTH_TOLERANCE, REACH, LEAST_WEIGHT = 0.01, 2.5, 1e-3  # as the kernel's
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Eye:
    """What the filter is given of an eye. color: (H, W, 3). near: (H, W), reciprocal depths, 0 of the background, negative
    where they are not known."""

    color: np.ndarray
    near: np.ndarray
    camera: Camera


@dataclass(frozen=True)
class Blended:
    """color: (H, W, 3). beta: (H, W, 3), the weight of the eye's own colour. other: (H, W, 3), X, what the other eye shows; the
    own colour where it is not seen. is_seen: (H, W). margin: (H, W), how far, relatively, the pixel is from being decided
    otherwise."""

    color: np.ndarray
    beta: np.ndarray
    other: np.ndarray
    is_seen: np.ndarray
    margin: np.ndarray


def blend(eye: Eye, other: Eye, beta: float | None, per_channel: bool = False) -> Blended:
    """`eye`'s colour blended with the other's by the weight beta, or by that of Eq. 4 where it is None."""
    y = eye.color.astype(np.float64)
    if beta is None:
        y = np.where(np.isfinite(y).all(axis=-1, keepdims=True), y, np.nan)
    x, is_seen, margin = reproject(eye, other)
    x = np.where(is_seen[..., None], x, y)
    if beta is None:
        weights = (np.ones((1, 3)) * LUMINANCE[:, None]) if not per_channel else np.eye(3)
        own = estimated_beta(y @ weights, x @ weights)
    else:
        own = np.full_like(y, beta)
    own = np.where(is_seen[..., None], own, 1.0)
    with np.errstate(invalid="ignore"):  # of what is not finite, which is not seen
        color = np.where(is_seen[..., None], (1 - own) * x + own * y, eye.color)
    return Blended(color, own, x, is_seen, margin)


def estimated_beta(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Eq. 4 of (H, W, C) images, with Eq. 10, whose sums are means, and Eq. 11; 1 for 0 / 0. NaN pixels are left out."""
    there = neighbours(y)
    count = np.isfinite(there).sum(axis=0)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.nansum(values, axis=0) / np.maximum(count, 1)

    variance = np.maximum(mean(there**2) - mean(there) ** 2, 0.0)
    squared_difference = mean((x - there) ** 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(squared_difference > 0, 1 - variance / squared_difference, 1.0)


def neighbours(image: np.ndarray) -> np.ndarray:
    """(9, H, W, C): the 3x3 pixels about each, NaN beyond the image's edge."""
    height, width, _ = image.shape
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    return np.stack([padded[r : r + height, c : c + width] for r in range(3) for c in range(3)])


def reproject(eye: Eye, other: Eye) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the other eye shows of each pixel's point, interpolated: (H, W, 3); whether it shows it; and the margin."""
    height, width = eye.near.shape
    x, y, expected = project(eye.camera, other.camera, eye.near)
    with np.errstate(invalid="ignore"):
        inside = (expected >= 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height) & (eye.near >= 0)
        inside &= np.isfinite(eye.color).all(axis=-1)
        margin = np.minimum.reduce([np.abs(v - np.rint(v)) for v in (x, y)])
    margin = np.where(np.isfinite(margin), margin, 1.0)
    x, y, expected = (np.where(inside, v, 0.0) for v in (x, y, expected))
    allowed = DEPTH_TOLERANCE * expected + REACH * _slope(other.near, y.astype(int), x.astype(int))
    left, top = (np.floor(v - 0.5).astype(int) for v in (x, y))
    total, found = np.zeros((height, width)), np.zeros((height, width, 3))
    for row, column in ((top + dy, left + dx) for dy in (0, 1) for dx in (0, 1)):
        is_there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        at = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
        near, value = other.near[at].astype(np.float64), other.color[at].astype(np.float64)
        weight = (1 - np.abs(x - column - 0.5)) * (1 - np.abs(y - row - 0.5))
        away = np.abs(near - expected)
        passes = is_there & (near >= 0) & ((near > 0) == (expected > 0)) & (away <= allowed)
        passes &= np.isfinite(value).all(axis=-1)
        decided = np.abs(away - allowed) / np.where(allowed > 0, allowed, 1.0)
        margin = np.minimum(margin, np.where(inside & is_there & (allowed > 0), decided, 1.0))
        weight = np.where(passes, weight, 0.0)
        total += weight
        found += weight[..., None] * np.where(passes[..., None], value, 0.0)
    is_seen = inside & (total >= LEAST_WEIGHT)
    margin = np.minimum(margin, np.where(inside, np.abs(total - LEAST_WEIGHT), 1.0))
    return found / np.where(is_seen, total, 1.0)[..., None], is_seen, margin


def project(camera: Camera, other: Camera, near: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Column and row, in pixels, and reciprocal depth at which the other camera has each pixel's centre; the latter negative
    where it is not in front of its near plane."""
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


def _slope(near: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Steps of the reciprocal depth to the next pixel: the least along each axis, together."""
    total = np.zeros(near.shape)
    for axis in (0, 1):
        if near.shape[axis] > 1:
            steps = np.diff(near.astype(np.float64), axis=axis)
            pad = [(1, 1) if a == axis else (0, 0) for a in (0, 1)]
            steps = np.pad(steps, pad)  # of pixel i, from before it is steps[i], to after it steps[i + 1]
            before, after = steps[row, column], steps[(row + 1, column) if axis == 0 else (row, column + 1)]
            total += np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    return total
