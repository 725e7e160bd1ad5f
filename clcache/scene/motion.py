"""Where things are at a time: key-framed tracks and chains of them."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from .model import Track


def pose_at(motion: Sequence[Track | np.ndarray], time: float) -> np.ndarray:
    """The product of a chain of tracks and fixed matrices, outermost first, at a time in seconds: (3, 4) float64."""
    pose = np.eye(4)
    for step in motion:
        matrix = track_at(step, time) if isinstance(step, Track) else step
        pose = pose @ np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    return pose[:3]


def key_times(motion: Sequence[Track | np.ndarray]) -> np.ndarray:
    """When the tracks of a chain have keys, in seconds, ascending; 0 where it has none."""
    times = [step.times for step in motion if isinstance(step, Track)]
    return np.unique(np.concatenate(times)) if times else np.zeros(1)


def track_at(track: Track, time: float) -> np.ndarray:
    """A track's transform at a time in seconds: (3, 4) float64, scale first, then rotation, then translation."""
    times = track.times
    if len(times) == 1 or time <= times[0]:
        key = 0
    elif time >= times[-1]:
        key = len(times) - 1
    else:
        key = int(np.searchsorted(times, time, side="right")) - 1
    inside = times[0] < time < times[-1] and not track.step and times[key + 1] > times[key]
    part = (time - times[key]) / (times[key + 1] - times[key]) if inside else 0.0
    following = key + 1 if inside else key
    translation = (1 - part) * track.translation[key] + part * track.translation[following]
    scale = (1 - part) * track.scale[key] + part * track.scale[following]
    rotation = Rotation.from_quat(track.rotation[key])
    if inside:
        rotation = Slerp([0.0, 1.0], Rotation.from_quat(track.rotation[[key, following]]))(part)
    return np.column_stack([rotation.as_matrix() * scale, translation])
