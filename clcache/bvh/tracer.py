"""Rays against a scene: the public `Tracer`, and the launch of its kernels for the passes of a frame."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device
from ..scene.geometry import NONE, Geometry
from ..scene.model import Scene
from .build import SceneTrees

MISS = 0xFFFFFFFF
HIT_DTYPE = np.dtype([("t", "f4"), ("u", "f4"), ("v", "f4"), ("primitive", "u4"), ("instance", "u4")])
# Rays of a packet, and those among which packets are formed of rays that are not alike; as in cl/bvh/packet.cl.
_PACKET = 16
_CHUNK = 4096
FARTHEST = 1e31  # as in cl/bvh/queue.cl: rays from beyond it hit nothing


class RayKernels:
    """The traversal kernels, bound to the trees of a scene; rays and results are device arrays of planes.

    surfaces: the arrays by which `cl/scene/alpha.cl` finds holes, by name, and whether there is anything to find.
    """

    def __init__(
        self,
        device: Device,
        trees: SceneTrees,
        surfaces: Mapping[str, cl_array.Array] | None = None,
        has_alpha: bool = False,
        has_textures: bool = False,
    ):
        has_instances = trees.placed.size > 1 or trees.merged.number[0] != NONE
        self._program = device.program(
            "bvh/trace.cl",
            HAS_ALPHA=has_alpha,
            HAS_TEXTURES=has_textures,
            HAS_INSTANCES=bool(has_instances),
            STACK_SIZE=_stack_size(trees.depth),
        )
        self._trees, self._surfaces = trees, surfaces if has_alpha else {}

    def closest_hit(
        self,
        origins: cl_array.Array,
        directions: cl_array.Array,
        t_mins: cl_array.Array | None,
        lengths: cl_array.Array,
        *hits: cl_array.Array,
        coherent: bool = False,
    ) -> cl.Event | None:
        """Enqueue: origins, directions (3, n); t_mins, lengths (n,); hits t (n,), uv (2, n), primitive, instance (n,).

        coherent: each 16 rays in a row are alike, and are traced together; the results are the same bits.
        """
        results = dict(zip(("t", "uv", "primitive", "instance"), hits, strict=True))
        return self._launch("closest_hit", origins, directions, t_mins, lengths, results, coherent)

    def any_hit(
        self,
        origins: cl_array.Array,
        directions: cl_array.Array,
        t_mins: cl_array.Array | None,
        lengths: cl_array.Array,
        occluded: cl_array.Array,
        coherent: bool = False,
    ) -> cl.Event | None:
        """Enqueue: rays as for `closest_hit`; occluded (n,) uint8."""
        return self._launch("any_hit", origins, directions, t_mins, lengths, {"occluded": occluded}, coherent)

    def _launch(self, kernel: str, origins, directions, t_mins, lengths, results, coherent) -> cl.Event | None:
        rays = {"origins": origins, "directions": directions, "t_mins": t_mins, "lengths": lengths}
        n, trees = lengths.size, self._trees
        scalars = {"n": n, "joined": trees.joined_instance.size, "top_root": trees.top_root}
        name, rays_each = (f"{kernel}_packets", _PACKET) if coherent else (kernel, _CHUNK)
        items = -(-n // rays_each)
        return self._program[name].run(items, rays, results, trees.arrays, self._surfaces, **scalars)


def _stack_size(depth: int) -> int:
    """Entries that the walk over a tree of so many levels may need: seven children wait at each. A power of two, so that
    kernels are compiled for few different sizes."""
    return max(128, 1 << (7 * depth).bit_length())


class Tracer:
    """Trace rays against a scene's triangles, as they are at time 0; alpha masks make no holes here.

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

        origins, directions: (n, 3), finite, shorter than FARTHEST; directions need not be of unit length, t is in units of
        theirs. t_min (at least 0), t_max: numbers or (n,). Returns (n,) HIT_DTYPE: t; u, v, the weights of the triangle's second and third vertex;
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
        if not max(np.abs(v).sum(axis=1, dtype=np.float64).max(initial=0.0) for v in (origins, directions)) < FARTHEST:
            raise ValueError(f"an origin or a direction is longer than {FARTHEST:g}")
        limits = [np.broadcast_to(np.asarray(t, np.float32), len(origins)) for t in (t_min, t_max)]
        if not (limits[0] >= 0).all() or np.isnan(limits[1]).any():
            raise ValueError("t_min is below 0, or t_min or t_max is not a number")
        return [self._device.upload(values, "rays") for values in (origins.T, directions.T, *limits)]
