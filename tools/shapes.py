"""Shapes that the scripts of this folder build their scenes from: sheets, boxes, and profiles turned around an axis.

Frames: +Y is up and the unit is a metre. The texture coordinates of a surface are metres as well; whoever writes it divides
them by what its texture covers.
"""

from dataclasses import dataclass

import numpy as np

ALONG_X = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # a rotation that turns +Y to +X
ALONG_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # one that turns +Y to +Z


def rotation_y(degrees: float) -> np.ndarray:
    """Rotation about +Y (3, 3)."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


# ---------------------------------------------------------------------------------------------------------------------
# Surfaces


@dataclass(frozen=True)
class Surface:
    """Triangles of one material. positions, normals: (v, 3); uvs: (v, 2), in metres; triangles: (t, 3)."""

    material: str
    positions: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    triangles: np.ndarray

    def moved(self, offset=(0.0, 0.0, 0.0), matrix=None) -> "Surface":
        """The surface turned by a rotation matrix (3, 3), then moved by `offset`."""
        turn = np.eye(3) if matrix is None else np.asarray(matrix)
        return Surface(
            self.material, self.positions @ turn.T + np.asarray(offset), self.normals @ turn.T, self.uvs, self.triangles
        )


def merged(surfaces: list[Surface]) -> Surface:
    """Surfaces of one material as one."""
    counts = np.cumsum([0] + [len(s.positions) for s in surfaces[:-1]])
    return Surface(
        surfaces[0].material,
        np.concatenate([s.positions for s in surfaces]),
        np.concatenate([s.normals for s in surfaces]),
        np.concatenate([s.uvs for s in surfaces]),
        np.concatenate([s.triangles + first for s, first in zip(surfaces, counts, strict=True)]),
    )


def copies(surface: Surface, offsets: np.ndarray) -> Surface:
    """The surface repeated at each of the offsets (n, 3)."""
    n, v = len(offsets), len(surface.positions)
    return Surface(
        surface.material,
        (surface.positions + offsets[:, None, :]).reshape(-1, 3),
        np.tile(surface.normals, (n, 1)),
        np.tile(surface.uvs, (n, 1)),
        (surface.triangles + (np.arange(n) * v)[:, None, None]).reshape(-1, 3),
    )


def grid(material: str, points: np.ndarray, lengths: np.ndarray, normals: np.ndarray | None = None) -> Surface:
    """A sheet of quads, each split into two triangles that wind with their normals.

    points: (m, n, 3). lengths: (m, n, 2), the surface's own coordinates in metres. normals: (m, n, 3), or None for flat
    quads, which then face along (d points / d column) x (d points / d row).
    """
    lengths = np.asarray(lengths, dtype=float)
    rows, columns = points.shape[:2]
    quads = np.arange(rows * columns).reshape(rows, columns)
    quads = np.stack([quads[:-1, :-1], quads[:-1, 1:], quads[1:, 1:], quads[1:, :-1]], axis=-1).reshape(-1, 4)
    points, uvs = points.reshape(-1, 3), lengths.reshape(-1, 2)
    if normals is None:
        points, uvs = points[quads].reshape(-1, 3), uvs[quads].reshape(-1, 2)
        corners = points.reshape(-1, 4, 3)
        facing = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        normals = np.repeat(facing, 4, axis=0)
        quads = np.arange(len(points)).reshape(-1, 4)
    normals = normals.reshape(-1, 3)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return clean(Surface(material, points, normals, uvs, triangles))


def clean(surface: Surface) -> Surface:
    """Without triangles that have no area; the others wound so that they face their normals."""
    corners = surface.positions[surface.triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    keep = np.linalg.norm(facing, axis=1) > 1e-9
    backwards = (facing * surface.normals[surface.triangles].sum(axis=1)).sum(axis=1) < 0.0
    triangles = np.where(backwards[:, None], surface.triangles[:, ::-1], surface.triangles)[keep]
    return Surface(surface.material, surface.positions, surface.normals, surface.uvs, triangles)


def sheet(material: str, points: np.ndarray, lengths: np.ndarray) -> Surface:
    """A smooth sheet of quads (as `grid`), its normals from central differences."""
    along_row, along_column = np.gradient(points, axis=(0, 1))
    return grid(material, points, lengths, np.cross(along_column, along_row))


def quad(material: str, corners, lengths=None) -> Surface:
    """A flat quad through four corners in order, facing the side from which they run counter-clockwise.

    Its u follows the first edge and its v the last one, unless lengths (4, 2) says otherwise.
    """
    c = np.asarray(corners, dtype=float)
    if lengths is None:
        u, v = np.linalg.norm(c[1] - c[0]), np.linalg.norm(c[3] - c[0])
        lengths = [[0, 0], [u, 0], [u, -v], [0, -v]]
    return grid(material, c[[[0, 1], [3, 2]]], np.asarray(lengths, dtype=float)[[[0, 1], [3, 2]]])


def box(material: str, low, high) -> list[Surface]:
    """The six faces of a box, u horizontal and v downwards on the sides."""
    (x0, y0, z0), (x1, y1, z1) = low, high

    def face(a, b, c, d, u_axis, v_axis):
        corners = np.array([a, b, c, d], dtype=float)
        return quad(material, corners, np.stack([corners[:, u_axis], -corners[:, v_axis]], axis=-1))

    return [
        face((x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1), 0, 1),
        face((x1, y0, z0), (x0, y0, z0), (x0, y1, z0), (x1, y1, z0), 0, 1),
        face((x1, y0, z1), (x1, y0, z0), (x1, y1, z0), (x1, y1, z1), 2, 1),
        face((x0, y0, z0), (x0, y0, z1), (x0, y1, z1), (x0, y1, z0), 2, 1),
        face((x0, y1, z1), (x1, y1, z1), (x1, y1, z0), (x0, y1, z0), 0, 2),
        face((x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1), 0, 2),
    ]


def centred_box(material: str, half: float, low: float, high: float) -> list[Surface]:
    """A box around the y axis."""
    return box(material, (-half, low, -half), (half, high, half))


# ---------------------------------------------------------------------------------------------------------------------
# Profiles: drawn once, then turned around an axis or swept around the court


@dataclass(frozen=True)
class Profile:
    """A drawn line, piece by piece: points, normals (s, 2, 2) and length so far (s, 2) at both ends of each piece.

    The normal is to the right of the direction in which the line is drawn; it is smooth where the line bends by less
    than 40 degrees and breaks elsewhere.
    """

    points: np.ndarray
    normals: np.ndarray
    length: np.ndarray


def profile(*parts) -> Profile:
    """A line through points: each part is a point (2,) or a run of points (n, 2)."""
    line = np.concatenate([np.atleast_2d(np.asarray(part, dtype=float)) for part in parts])
    line = line[np.concatenate([[True], np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-6])]
    step = np.diff(line, axis=0)
    size = np.linalg.norm(step, axis=1, keepdims=True)
    own = np.stack([step[:, 1], -step[:, 0]], axis=-1) / size
    smooth = (own[1:] * own[:-1]).sum(axis=1, keepdims=True) > np.cos(np.radians(40.0))
    joint = own[1:] + own[:-1]
    joint /= np.maximum(np.linalg.norm(joint, axis=1, keepdims=True), 1e-30)
    start = np.concatenate([own[:1], np.where(smooth, joint, own[1:])])
    end = np.concatenate([np.where(smooth, joint, own[:-1]), own[-1:]])
    total = np.concatenate([[0.0], np.cumsum(size[:, 0])])
    return Profile(
        np.stack([line[:-1], line[1:]], axis=1),
        np.stack([start, end], axis=1),
        np.stack([total[:-1], total[1:]], axis=1),
    )


def curve(x: float, y: float, radius_x: float, radius_y: float, start: float, stop: float, steps: int) -> np.ndarray:
    """Points (steps + 1, 2) on an ellipse around (x, y), from angle `start` to `stop` in degrees."""
    angle = np.radians(np.linspace(start, stop, steps + 1))
    return np.stack([x + radius_x * np.cos(angle), y + radius_y * np.sin(angle)], axis=-1)


def torus(radius: float, low: float, high: float, steps: int = 6) -> np.ndarray:
    """A round moulding on a shaft of `radius`, between two heights, drawn upwards."""
    half = (high - low) / 2
    return curve(radius, low + half, half, half, -90.0, 90.0, steps)


def revolved(
    material: str, line: Profile, segments: int, start: float = 0.0, stop: float = 360.0, tile: float = 1.0
) -> Surface:
    """The profile (radius, height) turned around the y axis; drawn upwards, it faces outwards.

    tile: metres that the material's texture covers.
    """
    angle = np.radians(np.linspace(start, stop, segments + 1))
    axis = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    up = np.array([0.0, 1.0, 0.0])

    def turned(v):  # (s, 2, 2) -> (s, 2, segments + 1, 3)
        return v[..., 0, None, None] * axis + v[..., 1, None, None] * up

    # A whole number of tiles goes around a closed surface, so that the texture meets itself; thin ones have a seam.
    around = np.radians(stop - start) * line.points[..., 0].max()
    if stop - start == 360.0 and around > tile / 2:
        around = round(around / tile) * tile
    u = np.broadcast_to(np.linspace(0.0, around, segments + 1), (*line.length.shape, segments + 1))
    lengths = np.stack([u, np.broadcast_to(-line.length[..., None], u.shape)], axis=-1)
    pieces = zip(turned(line.points), lengths, turned(line.normals), strict=True)
    return merged([grid(material, p, w, n) for p, w, n in pieces])
