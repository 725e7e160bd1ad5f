"""Rotations, camera poses, chains of transforms and those of texture coordinates, from the forms that files give them in."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from .model import Track
from .motion import pose_at

Chain = tuple[Track | np.ndarray, ...]


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


def chain(*links: Track | np.ndarray) -> Chain:
    """A chain of transforms, outermost first, in which neighbours that stand still are one (3, 4) matrix."""
    merged: list[Track | np.ndarray] = []
    for link in links:
        if merged and not isinstance(link, Track) and not isinstance(merged[-1], Track):
            merged[-1] = compose(merged[-1], link)
        else:
            merged.append(link)
    return tuple(merged)


def is_moving(motion: Chain) -> bool:
    """Whether any link of the chain is a track."""
    return any(isinstance(link, Track) for link in motion)


def rest_pose(motion: Chain) -> np.ndarray:
    """The chain's (3, 4) transform at time 0."""
    return pose_at(motion, 0.0)


def uv_transform(
    offset: tuple[float, float], rotation: float, scale: tuple[float, float]
) -> tuple[float, float, float, float, float, float]:
    """`TextureUse.transform` as KHR_texture_transform means it: scale, then rotation in radians, then offset.

    A rotation turns the coordinates counter-clockwise as the picture is looked at, with v downwards; the matrix in the
    extension's text turns them the other way, against its words, its example and its implementations.
    """
    c, s = math.cos(rotation), math.sin(rotation)
    return c * scale[0], s * scale[1], offset[0], 0.0 - s * scale[0], c * scale[1], offset[1]


def turns_between(directions: np.ndarray) -> np.ndarray:
    """(k, 4) quaternions that turn the first of (k, 3) unit directions into each, along great circles from one to the next."""
    turns = [Rotation.identity()]
    for a, b in zip(directions[:-1], directions[1:], strict=True):
        axis, cosine = np.cross(a, b), float(np.clip(a @ b, -1.0, 1.0))
        if np.linalg.norm(axis) < 1e-9:  # the same, or opposite: any axis across leads there
            axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        turns.append(Rotation.from_rotvec(axis / np.linalg.norm(axis) * math.acos(cosine)) * turns[-1])
    return np.array([turn.as_quat() for turn in turns])
