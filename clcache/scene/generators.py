"""Meshes made from a few numbers: what a scene file's `generator = "..."` names.

Every generator returns positions (v, 3), triangles (t, 3), normals (v, 3) or None for flat shading, and uvs (v, 2) or
None, counter-clockwise seen from outside (from above, for the flat ones).
"""

from typing import NamedTuple

import numpy as np


class Shape(NamedTuple):
    """The arrays of a generated mesh, shaped as in `Mesh`."""

    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None


def sphere(radius: float, subdivisions: int) -> Shape:
    """An icosahedron whose triangles are split in four `subdivisions` times, on the sphere: 20 * 4**subdivisions triangles.

    u runs once around +Y, v from the north pole (0) to the south pole (1). Vertices on the seam appear once with u near
    0 and once near 1; those at the poles once for each triangle.
    """
    points, triangles = _icosahedron()
    for _ in range(subdivisions):
        points, triangles = _split_in_four(points, triangles)
    points, triangles, uvs = _unwrap_sphere(points, triangles)
    return Shape(points * radius, triangles, points, uvs)


def _icosahedron() -> tuple[np.ndarray, np.ndarray]:
    """Unit icosahedron with vertices at both poles of the Y axis: pole, upper ring of five, lower ring, pole."""
    ring = np.arange(5)
    angle = 2 * np.pi * ring / 5
    height, radius = 1 / np.sqrt(5), 2 / np.sqrt(5)
    upper = np.column_stack([radius * np.sin(angle), np.full(5, height), radius * np.cos(angle)])
    lower = np.column_stack(
        [radius * np.sin(angle + np.pi / 5), np.full(5, -height), radius * np.cos(angle + np.pi / 5)]
    )
    points = np.vstack([[0.0, 1.0, 0.0], upper, lower, [0.0, -1.0, 0.0]])
    after = (ring + 1) % 5
    up, up_after, low, low_after = 1 + ring, 1 + after, 6 + ring, 6 + after
    triangles = np.vstack(
        [
            np.column_stack([np.zeros(5, int), up, up_after]),
            np.column_stack([up, low, up_after]),
            np.column_stack([low, low_after, up_after]),
            np.column_stack([low, np.full(5, 11), low_after]),
        ]
    )
    return points, triangles


def _split_in_four(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split every triangle at the middles of its edges, and move those to the unit sphere."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys, middle = np.unique(edges[:, 0] * len(points) + edges[:, 1], return_inverse=True)
    middles = points[keys // len(points)] + points[keys % len(points)]
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    ab, bc, ca = (middle.reshape(-1, 3) + len(points)).T
    a, b, c = triangles.T
    corners = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    return np.vstack([points, middles]), corners.transpose(2, 0, 1).reshape(-1, 3)


def _unwrap_sphere(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude and longitude as uvs, with vertices doubled where one would need two values of u."""
    corner = points[triangles]
    u = np.arctan2(corner[..., 0], corner[..., 2]) / (2 * np.pi) % 1.0
    at_pole = np.hypot(corner[..., 0], corner[..., 2]) < 1e-9
    over_seam = np.where(at_pole, 0, u).max(axis=1) - np.where(at_pole, 1, u).min(axis=1) > 0.5
    u[over_seam] += u[over_seam] < 0.5
    pole_u = np.where(at_pole, 0, u).sum(axis=1) / 2  # between those of the other two corners
    u = np.where(at_pole, pole_u[:, None], u)
    v = np.arccos(np.clip(corner[..., 1], -1, 1)) / np.pi
    key = np.column_stack([triangles.ravel(), np.rint(u.ravel() * 2**30).astype(np.int64)])
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    uvs = np.column_stack([u.ravel(), v.ravel()])[first]
    return points[key[first, 0]], inverse.reshape(-1, 3), uvs


def box(size: tuple[float, float, float]) -> Shape:
    """An axis-aligned box about the origin: 12 flat triangles; each face carries the whole of uv space."""
    axis = np.repeat([0, 1, 2], 2)
    sign = np.tile([1.0, -1.0], 3)
    normal = np.eye(3)[axis] * sign[:, None]
    across = np.eye(3)[(axis + 1) % 3] * sign[:, None]
    along = np.eye(3)[(axis + 2) % 3]
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    face = normal[:, None] + corner[None, :, :1] * across[:, None] + corner[None, :, 1:] * along[:, None]
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = (4 * np.arange(6)[:, None, None] + quad).reshape(-1, 3)
    uvs = np.tile((corner * [0.5, -0.5] + 0.5), (6, 1))
    return Shape(face.reshape(-1, 3) * np.asarray(size) / 2, triangles, None, uvs)


def grid(size: tuple[float, float], cells: tuple[int, int]) -> Shape:
    """A rectangle about the origin in the XZ plane, facing +Y, of cells[0] x cells[1] pairs of triangles."""
    columns, rows = cells
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    positions = np.column_stack([(u.ravel() - 0.5) * size[0], np.zeros(u.size), (v.ravel() - 0.5) * size[1]])
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1, 1)
    below = first + columns + 1
    triangles = np.hstack([first, below, below + 1, first, below + 1, first + 1]).reshape(-1, 3)
    return Shape(positions, triangles, None, np.column_stack([u.ravel(), v.ravel()]))


def plane(size: tuple[float, float]) -> Shape:
    """A rectangle of two triangles about the origin in the XZ plane, facing +Y."""
    return grid(size, (1, 1))


def hairball(triangles: int, segments: int, radius: float, thickness: float, seed: int) -> Shape:
    """A ball of thin curled ribbons that grow from its centre: exactly `triangles` triangles.

    Each hair is a ribbon of `segments` pairs of triangles; the last one ends where the count is reached. A hair leaves
    the inner third of the ball in a random direction and meanders outwards: its direction turns with two random waves,
    and the ribbon, `thickness` wide, twists around it. The same arguments give the same arrays.
    """
    rng = np.random.default_rng(seed)
    hairs = -(-triangles // (2 * segments))
    along = np.linspace(0, 1, segments + 1)[None, :, None]

    def random_directions() -> np.ndarray:
        directions = rng.standard_normal((hairs, 1, 3))
        return directions / np.linalg.norm(directions, axis=2, keepdims=True)

    out, wave_a, wave_b, side = (random_directions() for _ in range(4))
    turns_a, turns_b = rng.uniform(1, 4, (2, hairs, 1, 1))
    phase_a, phase_b = rng.uniform(0, 2 * np.pi, (2, hairs, 1, 1))
    bend = along * (
        wave_a * np.sin(2 * np.pi * turns_a * along + phase_a) + wave_b * np.sin(2 * np.pi * turns_b * along + phase_b)
    )
    heading = out + 0.45 * bend
    heading /= np.linalg.norm(heading, axis=2, keepdims=True)
    distance = (radius - thickness) * (
        rng.uniform(0, 0.33, (hairs, 1, 1)) * (1 - along) + rng.uniform(0.7, 1, (hairs, 1, 1)) * along
    )
    across = np.cross(heading, side + 0.5 * wave_a)
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    centre = heading * distance
    half = across * (thickness / 2)
    positions = np.stack([centre - half, centre + half], axis=2).reshape(-1, 3)
    left = (2 * (np.arange(hairs)[:, None] * (segments + 1) + np.arange(segments))).reshape(-1, 1)
    ribbons = np.hstack([left, left + 1, left + 3, left, left + 3, left + 2]).reshape(-1, 3)[:triangles]
    return Shape(positions.astype(np.float32), ribbons)
