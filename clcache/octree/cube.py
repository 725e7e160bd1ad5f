"""Which part of a scene an octree is about: all of it, or, where a ground or a sky reaches very much farther than the rest, what is near.

A cube around all would then have cells as large as houses. The one that is chosen instead has an edge of the scene's, halved some times; its
centre depends on the surfaces alone, so that sequences along other paths have the same cells unless they lead far away.
What lies outside it has no cells.
"""

from dataclasses import replace

import numpy as np

from ..scene.geometry import Geometry, instance_bounds

_MOST = 1_000_000  # triangles that are looked at
_NEAR = 0.98  # part of the triangles whose centres are within
_ROOM = 1.25  # beyond these, and beyond the eyes
_LEAST_HALVINGS = 3  # a cube that is not so much smaller would not be worth what it leaves out
_AT_ONCE = 1 << 17  # triangles that are cut together: the library takes about 1 KiB for each
_SIDES = np.array(
    [1, 2, 4, 8, 16, 32], np.uint8
)  # which sides of a cube a point is beyond: below along each axis, then above


def near_bounds(
    geometry: Geometry, is_static: np.ndarray, eyes: np.ndarray, least: float = 0.0
) -> tuple[np.ndarray, np.ndarray] | None:
    """Low and high, (3,) float64, of the cube about what is near; None where the scene is not very much larger than it.

    is_static: (instances,) bool. eyes: (k, 3), where the scene is seen from. least: metres, of the cube's edge."""
    low, high = (side[is_static].astype(np.float64) for side in instance_bounds(geometry))
    if not len(low):
        return None
    centres = _centres(geometry, is_static)
    centre = np.median(centres, axis=0)
    reach = max(np.quantile(_distances(centres, centre), _NEAR), _distances(eyes, centre).max(initial=0.0)) * _ROOM
    edge, longest = max(2 * reach, least), float((high.max(axis=0) - low.min(axis=0)).max())
    halvings = int(np.floor(np.log2(longest / edge))) if edge > 0 else 0
    if halvings < _LEAST_HALVINGS:
        return None
    half = longest / 2 ** (halvings + 1)
    return centre - half, centre + half


def _centres(geometry: Geometry, is_static: np.ndarray) -> np.ndarray:
    """Of the triangles in the world, or so many of them: (k, 3) float64."""
    instances = np.flatnonzero(is_static)
    mesh = geometry.instance_mesh[instances]
    ends = np.cumsum(np.diff(geometry.first_triangle)[mesh])
    looked_at = np.arange(0, ends[-1], -(-int(ends[-1]) // _MOST))
    placed = np.searchsorted(ends, looked_at, side="right")
    before = np.concatenate([[0], ends[:-1]])[placed]
    triangles = geometry.triangles[geometry.first_triangle[mesh[placed]] + looked_at - before]
    within = geometry.positions[triangles].mean(axis=1, dtype=np.float64)
    to_world = geometry.to_world[instances[placed]].astype(np.float64)
    return np.einsum("tij,tj->ti", to_world[:, :, :3], within) + to_world[:, :, 3]


def _distances(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Along the axis in which they are largest."""
    return np.abs(np.asarray(points, np.float64).reshape(-1, 3) - centre).max(axis=1)


def cut_to(geometry: Geometry, is_static: np.ndarray, low: np.ndarray, high: np.ndarray) -> Geometry:
    """What is within a cube of the static instances. low, high: (3,) float64.

    Instances wholly within are as they were; of others there are the triangles wholly within, and, as one mesh more, in the world,
    the parts that are within of those that cross the cube's sides. Instances wholly outside are left out. Only what places
    triangles is there: no normals, no texture coordinates, no materials.
    """
    least, most = instance_bounds(geometry)
    reaches_in = is_static & (most >= low).all(axis=1) & (least <= high).all(axis=1)
    is_within = (least >= low).all(axis=1) & (most <= high).all(axis=1)
    whole, partly = np.flatnonzero(reaches_in & is_within), np.flatnonzero(reaches_in & ~is_within)
    split = [_split(geometry, instance, low, high) for instance in partly]
    corners = np.concatenate([np.zeros((0, 3, 3), np.float32), *(cut for _, cut in split)])
    points = corners.reshape(-1, 3)
    cut = np.arange(len(points), dtype=np.uint32).reshape(-1, 3) + np.uint32(len(geometry.positions))
    meshes = [*(kept for kept, _ in split), cut]
    identity = np.eye(3, 4, dtype=np.float32)[None]
    old, new = len(geometry.first_triangle) - 1, len(meshes)
    box = np.concatenate([low, high]).astype(np.float32)[:, None]
    return replace(
        geometry,
        positions=np.concatenate([geometry.positions, points]) if len(points) else geometry.positions,
        triangles=np.concatenate([geometry.triangles, *meshes]),
        material=np.zeros(0, np.uint32),
        normals=None,
        uvs=None,
        first_triangle=np.concatenate(
            [geometry.first_triangle, geometry.first_triangle[-1] + np.cumsum([len(m) for m in meshes])]
        ),
        mesh_bounds=np.concatenate(
            [geometry.mesh_bounds, geometry.mesh_bounds[:, geometry.instance_mesh[partly]], box], axis=1
        ),
        instance_mesh=np.concatenate([geometry.instance_mesh[whole], np.arange(old, old + new)]),
        to_world=np.concatenate([geometry.to_world[whole], geometry.to_world[partly], identity]),
        to_object=np.concatenate([geometry.to_object[whole], geometry.to_object[partly], identity]),
    )


def _split(geometry: Geometry, instance: int, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of an instance the triangles within a cube, (k, 3) uint32, and the corners in the world, (m, 3, 3) float32, of what is within of
    those that cross its sides."""
    mesh = geometry.instance_mesh[instance]
    triangles = geometry.triangles[geometry.first_triangle[mesh] : geometry.first_triangle[mesh + 1]]
    first, end = triangles.min(), triangles.max() + 1
    points = _placed(geometry.positions[first:end], geometry.to_world[instance])
    beyond = ((points < low) @ _SIDES[:3] + (points > high) @ _SIDES[3:])[triangles - first]
    is_within = ~beyond.any(axis=1)
    crosses = ~is_within & (np.bitwise_and.reduce(beyond, axis=1) == 0)
    crossing = triangles[crosses]
    parts = [crossing[i : i + _AT_ONCE] for i in range(0, len(crossing), _AT_ONCE)]
    cut = [_cut(_placed(geometry.positions[part], geometry.to_world[instance]), low, high) for part in parts]
    return triangles[is_within], np.concatenate([np.zeros((0, 3, 3), np.float32), *cut])


def _cut(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """What is within a cube of triangles, as triangles: (m, 3, 3) float32. corners: (k, 3, 3) float64."""
    from trimesh.intersections import slice_faces_plane

    size = float((high - low).max())  # the library knows no lengths below 1e-8
    vertices = ((corners - low) / size).reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    for axis in np.eye(3):
        for normal, origin in ((axis, np.zeros(3)), (-axis, axis)):
            vertices, faces, _ = slice_faces_plane(vertices, faces, normal, origin)
    return (vertices[faces].reshape(-1, 3, 3) * size + low).astype(np.float32)


def _placed(positions: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    """Points in the world, (..., 3) float64."""
    matrix = to_world.astype(np.float64)
    return positions.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
