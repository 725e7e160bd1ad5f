"""All meshes of a scene in one set of arrays, as kernels read them, and its instances' transforms and bounds."""

from dataclasses import dataclass, replace

import numpy as np

from .model import Scene
from .motion import pose_at

# Coordinates of an instance in the world, relative to its size, up to which its vertices may be rounded there.
_FARTHEST = 64

NONE = np.uint32(0xFFFFFFFF)  # no instance; as in cl/common/math.cl


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
        bounds = [_bounds(_compacted(m.positions, m.triangles)[0]) for m in meshes]
        to_world, to_object = _transforms(scene, 0.0)
        return cls(
            positions=np.concatenate([m.positions for m in meshes]).astype(np.float32),
            triangles=np.concatenate(
                [m.triangles + np.uint32(start) for m, start in zip(meshes, first_vertex, strict=False)]
            ).astype(np.uint32),
            material=np.concatenate([m.material for m in meshes]).astype(np.uint32),
            normals=_optional([m.normals for m in meshes], [m.positions for m in meshes], 3),
            uvs=_optional([m.uvs for m in meshes], [m.positions for m in meshes], 2),
            first_triangle=_starts(len(m.triangles) for m in meshes),
            mesh_bounds=np.array(bounds, np.float32).T.copy(),
            instance_mesh=np.array([i.mesh for i in scene.instances]),
            to_world=to_world,
            to_object=to_object,
        )

    def at(self, scene: Scene, time: float) -> "Geometry":
        """The same meshes with the instances where they are at a time, in seconds; itself if none of them moved."""
        if not any(i.motion for i in scene.instances):
            return self
        to_world, to_object = _transforms(scene, time)
        return (
            self if np.array_equal(to_world, self.to_world) else replace(self, to_world=to_world, to_object=to_object)
        )


@dataclass(frozen=True)
class Merged:
    """A scene's geometry as rays see it: the meshes that are placed once, and stand still, are one mesh in world space, so
    that a ray descends a single tree for all of them; the others follow as they are, and so do those that stand so far from
    the origin, for their size, that float32 would deform them there.

    geometry: meshes, instances and their numbers here; without normals and texture coordinates. number: (i,) uint32, the
    scene's instance of each instance here, or NONE for the merged mesh, which is the first if there is one. joined_instance:
    (k,) uint32, the scene's instances in the merged mesh. joined_first: (k + 1,) uint32, the first triangle of each, and where
    the last ends; in itself each is as its mesh in the scene.
    """

    geometry: Geometry
    number: np.ndarray
    joined_instance: np.ndarray
    joined_first: np.ndarray

    @classmethod
    def of(cls, geometry: Geometry, moves: np.ndarray) -> "Merged":
        """moves: (i,) bool, which of the instances are not always where they are now."""
        uses = np.bincount(geometry.instance_mesh, minlength=len(geometry.first_triangle) - 1)
        joins = (uses[geometry.instance_mesh] == 1) & ~moves & _keeps_shape(geometry)
        together, apart = np.flatnonzero(joins), np.flatnonzero(~joins)
        parts = [_Part.joined(geometry, together)] if len(together) else []
        meshes, mesh_here = np.unique(geometry.instance_mesh[apart], return_inverse=True)
        parts += [_Part.of_mesh(geometry, mesh) for mesh in meshes]
        first_vertex = _starts(len(p.positions) for p in parts)
        identity = np.eye(3, 4, dtype=np.float32)[None][: int(joins.any())]
        joined = len(identity)
        merged = Geometry(
            positions=_stacked([p.positions for p in parts]),
            triangles=_stacked([_shifted(p.triangles, start) for p, start in zip(parts, first_vertex, strict=False)]),
            material=np.zeros(0, np.uint32),
            normals=None,
            uvs=None,
            first_triangle=_starts(len(p.triangles) for p in parts),
            mesh_bounds=np.array([_bounds(p.positions) for p in parts], np.float32).T.copy(),
            instance_mesh=np.concatenate([np.arange(joined), mesh_here + joined]).astype(np.int64),
            to_world=np.concatenate([identity, geometry.to_world[apart]]),
            to_object=np.concatenate([identity, geometry.to_object[apart]]),
        )
        sizes = np.diff(geometry.first_triangle)[geometry.instance_mesh[together]]
        return cls(
            merged,
            np.concatenate([np.full(joined, NONE), apart]).astype(np.uint32),
            together.astype(np.uint32),
            _starts(sizes).astype(np.uint32),
        )

    def at(self, geometry: Geometry) -> "Merged":
        """The same with the instances that are apart where `geometry` has them."""
        apart = self.number != NONE
        to_world, to_object = self.geometry.to_world.copy(), self.geometry.to_object.copy()
        to_world[apart], to_object[apart] = (
            geometry.to_world[self.number[apart]],
            geometry.to_object[self.number[apart]],
        )
        return replace(self, geometry=replace(self.geometry, to_world=to_world, to_object=to_object))


@dataclass(frozen=True)
class _Part:
    """A mesh of the merged geometry; its triangles count from its own first vertex."""

    positions: np.ndarray
    triangles: np.ndarray

    @classmethod
    def of_mesh(cls, geometry: Geometry, mesh: int) -> "_Part":
        triangles = geometry.triangles[geometry.first_triangle[mesh] : geometry.first_triangle[mesh + 1]]
        return cls(*_compacted(geometry.positions, triangles))

    @classmethod
    def joined(cls, geometry: Geometry, instances: np.ndarray) -> "_Part":
        """The meshes of these instances in world space, one behind the other."""
        parts = [cls.of_mesh(geometry, geometry.instance_mesh[i]) for i in instances]
        starts = _starts(len(p.positions) for p in parts)
        return cls(
            _stacked([_placed(p.positions, geometry.to_world[i]) for p, i in zip(parts, instances, strict=True)]),
            _stacked([_shifted(p.triangles, start) for p, start in zip(parts, starts, strict=False)]),
        )


def _stacked(parts: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(parts) if len(parts) > 1 else parts[0]


def _shifted(triangles: np.ndarray, by: int) -> np.ndarray:
    """The numbers of vertices `by` higher; not copied where that is none."""
    return (triangles + np.int64(by)).astype(np.uint32) if by else triangles


def _compacted(positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The positions that the triangles use, in order, and the triangles in terms of these."""
    first, end = int(triangles.min()), int(triangles.max()) + 1
    is_used = np.zeros(end - first, bool)
    positions, triangles = positions[first:end], _shifted(triangles, -first)
    is_used[triangles.ravel()] = True
    if is_used.all():
        return positions, triangles
    return positions[is_used], (np.cumsum(is_used, dtype=np.uint32) - np.uint32(1))[triangles]


def _bounds(points: np.ndarray) -> np.ndarray:
    """(6,): low and high of (n, 3) points. NumPy is fast along long rows only: first bounds of many points side by side."""
    width = 256
    whole = len(points) // width * width
    rows = points[:whole].reshape(-1, 3 * width)
    candidates = [points[whole:]]
    if whole:
        candidates += [rows.min(axis=0).reshape(-1, 3), rows.max(axis=0).reshape(-1, 3)]
    few = np.concatenate(candidates)
    return np.concatenate([few.min(axis=0), few.max(axis=0)])


def _keeps_shape(geometry: Geometry) -> np.ndarray:
    """(i,) bool, whether an instance's coordinates in the world are not much larger than the instance."""
    low, high = instance_bounds(geometry)
    is_identity = (geometry.to_world == np.eye(3, 4, dtype=np.float32)).all(axis=(1, 2))
    return is_identity | (np.maximum(np.abs(low), np.abs(high)).max(axis=1) <= _FARTHEST * (high - low).max(axis=1))


def _placed(positions: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    """Points in world space; exact for the identity."""
    if np.array_equal(to_world, np.eye(3, 4)):
        return positions
    matrix = to_world.astype(np.float64)
    return (positions @ matrix[:, :3].T + matrix[:, 3]).astype(np.float32)


def _transforms(scene: Scene, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Object to world and back, of all instances at a time: each (i, 3, 4) float32."""
    placed = [pose_at(i.motion, time) if i.motion else i.transform for i in scene.instances]
    # Rounded first: the way back must be the inverse of the way that kernels go.
    to_world = np.array(placed, np.float32)
    square = np.zeros((len(placed), 4, 4))
    square[:, :3], square[:, 3, 3] = to_world, 1.0
    return to_world, np.linalg.inv(square)[:, :3].astype(np.float32)


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
