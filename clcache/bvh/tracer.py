"""Rays against a scene: the public `Tracer`, and the launch of its kernels for the passes of a frame."""

import numpy as np
import numpy.typing as npt
import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device
from ..scene.geometry import Geometry
from ..scene.model import Scene
from .build import SceneTrees

MISS = 0xFFFFFFFF
HIT_DTYPE = np.dtype([("t", "f4"), ("u", "f4"), ("v", "f4"), ("primitive", "u4"), ("instance", "u4")])


class RayKernels:
    """The traversal kernels, bound to the trees of a scene; rays and results are device arrays of planes."""

    def __init__(self, device: Device, trees: SceneTrees):
        self._program = device.program("bvh/trace.cl")
        self._trees = trees

    def closest_hit(
        self,
        origins: cl_array.Array,
        directions: cl_array.Array,
        t_mins: cl_array.Array | None,
        lengths: cl_array.Array,
        *hits: cl_array.Array,
    ) -> cl.Event | None:
        """Enqueue: origins, directions (3, n); t_mins, lengths (n,); hits t (n,), uv (2, n), primitive, instance (n,)."""
        n = lengths.shape[0]
        rays = (origins, directions, t_mins, lengths)
        return self._program["closest_hit"](
            *self._scene(), *rays, *hits, self._instances, self._trees.top_root, n, count=n
        )

    def any_hit(
        self,
        origins: cl_array.Array,
        directions: cl_array.Array,
        t_mins: cl_array.Array | None,
        lengths: cl_array.Array,
        occluded: cl_array.Array,
    ) -> cl.Event | None:
        """Enqueue: rays as for `closest_hit`; occluded (n,) uint8."""
        n = lengths.shape[0]
        rays = (origins, directions, t_mins, lengths)
        return self._program["any_hit"](
            *self._scene(), *rays, occluded, self._instances, self._trees.top_root, n, count=n
        )

    @property
    def _instances(self) -> int:
        return self._trees.instances.shape[0]

    def _scene(self) -> tuple[cl_array.Array, ...]:
        t = self._trees
        return t.top_nodes, t.top_order, t.nodes, t.leaves, t.instances, t.bounds


class Tracer:
    """Trace rays against a scene.

    scene: what `load_scene` returns. device: index, or part of the platform's or device's name; None for the default;
    or a `Device`. Hits are watertight along shared edges and vertices (Woop et al. 2013); between equally near
    triangles the lower instance, then the lower primitive is reported. Raises DeviceError.
    """

    def __init__(self, scene: Scene, device: str | int | Device | None = None):
        self._device = device if isinstance(device, Device) else Device(device)
        self.trees = SceneTrees(self._device, Geometry.of(scene))
        self._kernels = RayKernels(self._device, self.trees)

    def closest_hit(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
    ) -> np.ndarray:
        """The nearest hit of each ray within the open interval (t_min, t_max).

        origins, directions: (n, 3), finite; directions need not be of unit length, t is in units of theirs. t_min (at
        least 0), t_max: numbers or (n,). Returns (n,) HIT_DTYPE: t; u, v, the weights of the triangle's second and third vertex;
        primitive, its number in `Scene.meshes[...].triangles`; instance, its number in `Scene.instances`. A miss has t
        infinite and primitive and instance MISS. Raises ValueError for shapes or values that do not fit.
        """
        rays = self._upload(origins, directions, t_min, t_max)
        n = rays[3].shape[0]
        shapes = ((n,), np.float32), ((2, n), np.float32), ((n,), np.uint32), ((n,), np.uint32)
        results = [self._device.empty(shape, dtype, "hits") for shape, dtype in shapes]
        self._kernels.closest_hit(*rays, *results)
        hits = np.empty(n, HIT_DTYPE)
        hits["t"], (hits["u"], hits["v"]), hits["primitive"], hits["instance"] = (r.get() for r in results)
        self._device.release(*rays, *results)
        return hits

    def any_hit(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = 1.0,
    ) -> np.ndarray:
        """Whether anything lies on each ray within the open interval (t_min, t_max). Arguments as for `closest_hit`;
        returns (n,) bool."""
        rays = self._upload(origins, directions, t_min, t_max)
        occluded = self._device.empty(rays[3].shape[0], np.uint8, "occlusion")
        self._kernels.any_hit(*rays, occluded)
        result = occluded.get().astype(bool)
        self._device.release(*rays, occluded)
        return result

    def _upload(self, origins, directions, t_min, t_max) -> list[cl_array.Array]:
        origins, directions = np.asarray(origins, np.float32), np.asarray(directions, np.float32)
        if origins.ndim != 2 or origins.shape[1:] != (3,) or directions.shape != origins.shape:
            raise ValueError(f"origins {origins.shape} and directions {directions.shape} are not both (n, 3)")
        if not (np.isfinite(origins).all() and np.isfinite(directions).all()):
            raise ValueError("an origin or a direction is not finite")
        if not directions.any(axis=1).all():
            raise ValueError(f"direction {int(np.argmin(directions.any(axis=1)))} is zero")
        limits = [np.broadcast_to(np.asarray(t, np.float32), len(origins)) for t in (t_min, t_max)]
        if not (limits[0] >= 0).all() or np.isnan(limits[1]).any():
            raise ValueError("t_min is below 0, or t_min or t_max is not a number")
        return [self._device.upload(values, "rays") for values in (origins.T, directions.T, *limits)]
