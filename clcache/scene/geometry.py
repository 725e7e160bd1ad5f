"""All meshes of a scene in one set of arrays, as kernels read them, and its instances' transforms and bounds."""

from dataclasses import dataclass

import numpy as np

from .model import Scene


@dataclass(frozen=True)
class Geometry:
    """The meshes, one behind the other.

    positions: (v, 3) float32. triangles: (t, 3) uint32, into positions. material: (t,) uint32. normals: (v, 3) float32, rows
    of zeros where a mesh is flat; None if all are. uvs: (v, 2) float32; None if no mesh has any. first_triangle:
    (meshes + 1,) int64. mesh_bounds: (6, meshes) float32, low and high. instance_mesh: (i,) int64. to_world, to_object:
    (i, 3, 4) float32.
    """

    positions: np.ndarray
    triangles: np.ndarray
    material: np.ndarray
    normals: np.ndarray | None
    uvs: np.ndarray | None
    first_triangle: np.ndarray
    mesh_bounds: np.ndarray
    instance_mesh: np.ndarray
    to_world: np.ndarray
    to_object: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> "Geometry":
        """Gather a scene's meshes and instances."""
        meshes = scene.meshes
        first_vertex = _starts(len(m.positions) for m in meshes)
        used = [m.positions[np.unique(m.triangles)] for m in meshes]
        # Rounded first: the way back must be the inverse of the way that kernels go.
        to_world = np.array([i.transform for i in scene.instances], np.float32).astype(np.float64)
        square = np.concatenate([to_world, np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(to_world), 1, 4))], axis=1)
        return cls(
            positions=np.concatenate([m.positions for m in meshes]).astype(np.float32),
            triangles=np.concatenate(
                [m.triangles + np.uint32(start) for m, start in zip(meshes, first_vertex, strict=False)]
            ).astype(np.uint32),
            material=np.concatenate([m.material for m in meshes]).astype(np.uint32),
            normals=_optional([m.normals for m in meshes], [m.positions for m in meshes], 3),
            uvs=_optional([m.uvs for m in meshes], [m.positions for m in meshes], 2),
            first_triangle=_starts(len(m.triangles) for m in meshes),
            mesh_bounds=np.array([[*p.min(axis=0), *p.max(axis=0)] for p in used], np.float32).T.copy(),
            instance_mesh=np.array([i.mesh for i in scene.instances]),
            to_world=to_world.astype(np.float32),
            to_object=np.linalg.inv(square)[:, :3].astype(np.float32),
        )


def _starts(lengths) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(list(lengths), dtype=np.int64)])


def _optional(parts: list[np.ndarray | None], positions: list[np.ndarray], width: int) -> np.ndarray | None:
    if all(p is None for p in parts):
        return None
    filled = [np.zeros((len(v), width), np.float32) if p is None else p for p, v in zip(parts, positions, strict=True)]
    return np.concatenate(filled).astype(np.float32)


def instance_bounds(geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """World-space boxes of the instances: low, high, each (i, 3) float32.

    Exact for the identity; otherwise wide enough for what float32 transforms of a ray can be off: some units in the last
    place of the largest number met.
    """
    low, high = (
        geometry.mesh_bounds.T[geometry.instance_mesh, side].astype(np.float64) for side in (np.s_[:3], np.s_[3:])
    )
    matrix, offset = geometry.to_world[:, :, :3].astype(np.float64), geometry.to_world[:, :, 3].astype(np.float64)
    centre = np.einsum("ijk,ik->ij", matrix, 0.5 * (low + high)) + offset
    half = np.einsum("ijk,ik->ij", np.abs(matrix), 0.5 * (high - low))
    size = np.einsum("ijk,ik->ij", np.abs(matrix), np.maximum(np.abs(low), np.abs(high))) + np.abs(offset)
    is_identity = (geometry.to_world == np.eye(3, 4, dtype=np.float32)).all(axis=(1, 2))
    margin = np.where(is_identity[:, None], 0.0, 16 * np.finfo(np.float32).eps * size)
    outward = np.float32(np.inf)
    world_low = np.where(is_identity[:, None], low, np.nextafter((centre - half - margin).astype(np.float32), -outward))
    world_high = np.where(
        is_identity[:, None], high, np.nextafter((centre + half + margin).astype(np.float32), outward)
    )
    return world_low.astype(np.float32), world_high.astype(np.float32)
