"""Rotations and camera poses from the forms in which files give them."""

import numpy as np
from numpy.typing import ArrayLike


def rotation_matrix(quaternion: ArrayLike) -> np.ndarray:
    """The (3, 3) rotation of a quaternion (x, y, z, w) of any length but 0."""
    q = np.asarray(quaternion, np.float64)
    q = q / np.abs(q).max()  # so that the squares of extreme components stay in range
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> np.ndarray | None:
    """The (3, 4) pose of a camera at `position` that looks at `target`; None if the arguments leave it open."""
    position, target, up = (np.asarray(v, np.float64) for v in (position, target, up))
    back = position - target
    right = np.cross(up, back)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(up) * np.linalg.norm(back):
        return None
    back = back / np.linalg.norm(back)
    right = right / np.linalg.norm(right)
    return np.column_stack([right, np.cross(back, right), back, position])


def compose(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """The (3, 4) transform that applies `inner` first and then `outer`, both (3, 4)."""
    return outer @ np.vstack([inner, (0.0, 0.0, 0.0, 1.0)])


def rigid(transform: np.ndarray) -> np.ndarray:
    """The camera pose of a node's (3, 4) transform: same place and viewing axis, +Y as near as can be, no scale."""
    back = transform[:, 2] / np.linalg.norm(transform[:, 2])
    up = transform[:, 1] - back * (back @ transform[:, 1])
    up /= np.linalg.norm(up)
    return np.column_stack([np.cross(up, back), up, back, transform[:, 3]])
