"""Which cells triangles overlap, in float64: all 13 axes for every triangle and every cell near it; and Morton codes."""

import numpy as np

from clcache.scene.geometry import Geometry


def spread(v: np.ndarray) -> np.ndarray:
    """Bit i of each number to bit 3 i."""
    v = np.asarray(v, np.uint64)
    return sum((v >> np.uint64(i) & np.uint64(1)) << np.uint64(3 * i) for i in range(13))


def morton(cells: np.ndarray) -> np.ndarray:
    """(n,) uint64: keys of cells (n, 3)."""
    x, y, z = (spread(column) for column in np.asarray(cells).T)
    return x | y << np.uint64(1) | z << np.uint64(2)


def unmorton(keys: np.ndarray) -> np.ndarray:
    """(n, 3) int64: the cells of keys (n,)."""
    keys = np.asarray(keys, np.uint64)
    bits = [
        [(keys >> np.uint64(3 * i + axis) & np.uint64(1)).astype(np.int64) << i for i in range(13)] for axis in range(3)
    ]
    return np.stack([sum(axis) for axis in bits], axis=1)


def gaps(corners: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """(n,): by how much a unit cell must grow, on each side, to touch the triangle; below 0 where they overlap.

    corners: (3, 3), in units of cells. cells: (n, 3) int. Along an axis the box reaches half the sum of the axis's
    components from its centre, and so growing by g on each side moves that by g times the sum.
    """
    edges = np.roll(corners, -1, axis=0) - corners
    axes = [*np.eye(3), np.cross(edges[0], edges[1]), *(np.cross(edge, side) for edge in edges for side in np.eye(3))]
    largest = np.full(len(cells), -np.inf)
    for axis in axes:
        reach = np.abs(axis).sum()
        if reach <= 1e-12 * np.abs(edges).max() ** 2:
            continue
        along = corners @ axis
        centre = (cells + 0.5) @ axis
        gap = np.maximum(along.min() - centre, centre - along.max()) / reach - 0.5
        largest = np.maximum(largest, gap)
    return largest


def world_corners(geometry: Geometry, is_static: np.ndarray) -> np.ndarray:
    """(n, 3, 3) float64: the triangles of the static instances."""
    found = []
    for mesh, matrix in zip(
        geometry.instance_mesh[is_static], geometry.to_world[is_static].astype(np.float64), strict=True
    ):
        triangles = geometry.triangles[geometry.first_triangle[mesh] : geometry.first_triangle[mesh + 1]]
        found.append((geometry.positions.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3])[triangles])
    return np.concatenate(found)


def cell_coordinates(shape: np.void, points: np.ndarray, level: int | None = None) -> np.ndarray:
    """Points of the world in units of a level's cells, in float64."""
    level = int(shape["finest"]) if level is None else level
    return (points - shape["origin"].astype(np.float64)) / np.float64(shape["size"]) * 2.0**level


def overlaps(shape: np.void, corners: np.ndarray, nearer_than: float) -> np.ndarray:
    """Ascending keys of the finest cells to which a triangle is nearer than this, in units of their edge: found from the whole
    cube down, for what is near a cell is near those that hold it."""
    finest = int(shape["finest"])
    octants = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    keys = [np.zeros(0, np.uint64)]
    for triangle in cell_coordinates(shape, corners):
        cells = np.zeros((1, 3), int)
        for level in range(finest + 1):
            if level:
                cells = (2 * cells[:, None] + octants).reshape(-1, 3)
            unit = 2.0 ** (finest - level)
            limit = nearer_than if level == finest else max(nearer_than, 1e-6) / unit
            cells = cells[gaps(triangle / unit, cells) < limit]
        keys.append(morton(cells))
    return np.unique(np.concatenate(keys))
