"""Embree, by way of the package embreex where it is installed: single rays, traced in the calling thread, one call of Python's
for all of them. Its trees are built on as many threads as the process may use."""

import importlib
import time

import numpy as np

from ..scene.geometry import Geometry
from .ray_sets import RaySet

_SCENE, _MESH = "embreex.rtcore_scene", "embreex.mesh_construction"
NOTE = (
    "Embree: through embreex's Python interface, which traces single rays in the calling thread, and is slower than its "
    "C interface; of instances it gets the triangles. tools/peers/rays_beside_embree.py compares with that."
)


def is_installed() -> bool:
    """Whether there is an Embree to compare with."""
    try:
        importlib.import_module(_SCENE)
    except ImportError:
        return False
    return True


class Embree:
    """Triangles in Embree. triangles: (n, 3, 3) float32, their corners. `seconds`: what the build took."""

    def __init__(self, triangles: np.ndarray):
        positions = triangles.reshape(-1, 3)
        numbers = np.arange(len(positions), dtype=np.int32).reshape(-1, 3)
        self._scene = importlib.import_module(_SCENE).EmbreeScene()
        mesh = importlib.import_module(_MESH).TriangleMesh
        start = time.perf_counter()
        mesh(self._scene, positions, numbers)
        self._scene.run(positions[:1], np.float32([[0, 0, 1]]))  # the first ray has the tree built
        self.seconds = time.perf_counter() - start

    def trace(self, rays: RaySet, repeats: int) -> tuple[tuple[float, ...], np.ndarray]:
        """Seconds of each of so many runs, after one that warms up, and (n,): t, infinite for a miss; where any hit is asked
        for, whether there is one."""
        origins, directions = np.ascontiguousarray(rays.origins.T), np.ascontiguousarray(rays.directions.T)
        query, seconds = "OCCLUDED" if rays.any_hit else "DISTANCE", []
        for _ in range(repeats + 1):
            lengths = rays.lengths.copy()  # where embreex puts t
            start = time.perf_counter()
            found = self._scene.run(origins, directions, dists=lengths, query=query)
            seconds.append(time.perf_counter() - start)
        return tuple(seconds[1:]), found >= 0 if rays.any_hit else found


def world_triangles(geometry: Geometry) -> np.ndarray:
    """(n, 3, 3) float32: the corners of the triangles of all instances."""
    parts = []
    for mesh, matrix in zip(geometry.instance_mesh, geometry.to_world.astype(np.float64), strict=True):
        first, last = geometry.first_triangle[mesh : mesh + 2]
        corners = geometry.positions[geometry.triangles[first:last]].astype(np.float64)
        parts.append((corners @ matrix[:, :3].T + matrix[:, 3]).astype(np.float32))
    return np.concatenate(parts)
