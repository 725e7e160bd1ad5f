"""Recorded camera paths: CSV files of time, position and rotation, such as headsets give.

The first line names the columns: time, px, py, pz, qx, qy, qz, qw; seconds, metres, and a unit quaternion from camera to
world (the camera looks along its own -Z, +Y is up). Times ascend; between rows the pose is interpolated.
"""

from pathlib import Path

import numpy as np

from ..errors import SceneError
from .files import read_text
from .model import Track

COLUMNS = ("time", "px", "py", "pz", "qx", "qy", "qz", "qw")

_LARGEST_FILE = 1 << 27  # bytes; more than an hour at 240 poses per second
_FARTHEST = 1e30
_UNIT_TOLERANCE = 1e-2  # of a quaternion's length, as of numbers written with few digits


def read_pose_file(path: Path, name: str) -> Track:
    """The poses of a file. name: the file as messages call it. Raises SceneError that names the first line at fault."""
    size = path.stat().st_size
    if size > _LARGEST_FILE:
        raise SceneError(f"{name}: {size:,} bytes; expected at most {_LARGEST_FILE:,}")
    lines = read_text(path, name).splitlines()
    header = [word.strip() for word in lines[0].split(",")] if lines else []
    if tuple(header) != COLUMNS:
        raise SceneError(f"{name}:1: {','.join(header)[:80]!r} is wrong; expected the columns {','.join(COLUMNS)}")
    numbers = [number for number, line in enumerate(lines[1:], 2) if line.strip()]
    rows = np.array([_row(lines[number - 1], f"{name}:{number}") for number in numbers]).reshape(-1, len(COLUMNS))
    if not len(rows):
        raise SceneError(f"{name}: has no poses; expected a line for each")
    length = np.linalg.norm(rows[:, 4:], axis=1)
    _refuse_first(
        np.abs(length - 1) > _UNIT_TOLERANCE,
        lambda i: f"{name}:{numbers[i]}: the quaternion has length {length[i]:.6g}; expected 1",
    )
    time = rows[:, 0]
    _refuse_first(
        np.diff(time, prepend=-np.inf) <= 0,
        lambda i: f"{name}:{numbers[i]}: time {time[i]:g} after {time[i - 1]:g}; expected times that ascend",
    )
    return Track(time, rows[:, 1:4], rows[:, 4:] / length[:, None], np.ones((len(rows), 3)))


def _row(line: str, where: str) -> list[float]:
    words = line.split(",")
    if len(words) != len(COLUMNS):
        raise SceneError(f"{where}: {len(words)} values; expected {len(COLUMNS)}")
    values = []
    for column, word in zip(COLUMNS, words, strict=True):
        try:
            value = float(word)
        except ValueError:
            value = np.nan
        if not abs(value) <= _FARTHEST:
            raise SceneError(f"{where}: {column}: {word.strip()[:40]!r} is wrong; expected a finite number")
        values.append(value)
    return values


def _refuse_first(is_bad: np.ndarray, message) -> None:
    if is_bad.any():
        raise SceneError(message(int(np.argmax(is_bad))))
