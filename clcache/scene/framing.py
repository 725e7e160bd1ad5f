"""A camera and light for files that bring none."""

import math

import numpy as np

from .model import Camera, DirectionalLight, PointLight
from .part import Part
from .transform import look_at

_FOV_Y = math.radians(40)
# Three-quarter view: from the front (+Z), to the right, and above.
_VIEW = np.array([0.5, 0.4, 0.8])


def complete(
    part: Part, environment: tuple[float, float, float] | None, size: tuple[int, int], notes: list[str]
) -> tuple[Camera, list[PointLight | DirectionalLight], tuple[float, float, float]]:
    """Camera, lights and environment of a scene, chosen where the file gives none."""
    camera = part.camera
    if camera is None:
        points = np.concatenate(
            [part.meshes[i.mesh].positions @ i.transform[:, :3].T + i.transform[:, 3] for i in part.instances]
        )
        centre = (points.min(axis=0) + points.max(axis=0)) / 2
        radius = np.linalg.norm(points - centre, axis=1).max()
        half = math.atan(math.tan(_FOV_Y / 2) * min(1, size[0] / size[1]))
        eye = centre + _VIEW / np.linalg.norm(_VIEW) * radius / math.sin(half)
        camera = Camera(look_at(eye, centre), _FOV_Y)
        notes.append("the file has no camera: framed from outside")
    if part.lights or environment is not None or any(any(m.emission) for m in part.materials):
        return camera, part.lights, environment or (0.0, 0.0, 0.0)
    notes.append("the file has no light: a sun and a sky were added")
    direction = np.array([-0.4, -1.0, -0.6])
    direction /= np.linalg.norm(direction)
    return camera, [DirectionalLight(tuple(direction.tolist()), (3.0, 3.0, 3.0))], (0.5, 0.5, 0.5)
