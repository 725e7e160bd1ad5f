"""A short text that tells scenes apart by what is in them."""

import hashlib
from dataclasses import fields, is_dataclass

import numpy as np

from ..graph import CompiledGraph
from .model import Scene


def scene_digest(scene: Scene) -> str:
    """Of all that a scene shows: not of the camera, nor of what a render uses where the user gives nothing else."""
    return _digest(scene.meshes, scene.instances, scene.materials, scene.textures, scene.lights, scene.environment)


def camera_digest(scene: Scene) -> str:
    """Of where the scene is seen from, and when: the camera, the distance of the eyes and the frames per second."""
    return _digest(scene.camera, scene.defaults.eye_distance, scene.defaults.fps)


def _digest(*values: object) -> str:
    found = hashlib.sha256()
    _feed(found, values)
    return found.hexdigest()[:16]


def _feed(found: "hashlib._Hash", value: object) -> None:
    """Every value goes in with its type and its length, so that no two of different structure are the same bytes."""
    if isinstance(value, np.ndarray):
        _feed(found, (str(value.dtype), value.shape))
        found.update(np.ascontiguousarray(value).data)
    elif isinstance(value, tuple | list):
        found.update(f"{len(value)}:".encode())
        for item in value:
            _feed(found, item)
    elif isinstance(value, CompiledGraph):  # what it computes, wherever it is written
        _feed(found, (value.source, *value.outputs.items()))
    elif is_dataclass(value):
        _feed(found, (type(value).__name__, *(getattr(value, f.name) for f in fields(value))))
    else:
        text = repr(value)
        found.update(f"{type(value).__name__} {len(text)}:{text}".encode("utf-8", "backslashreplace"))
