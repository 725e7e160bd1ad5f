"""Scenes made of bare triangles, closed meshes, and exact answers to check hits against."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from clcache.scene.model import Camera, Environment, Instance, Material, Mesh, Scene

IDENTITY = np.eye(4)[:3]
MISS = 0xFFFFFFFF


def make_mesh(positions: np.ndarray, triangles: np.ndarray, name: str = "mesh") -> Mesh:
    """A mesh with nothing but its shape; every triangle of material 0."""
    triangles = np.asarray(triangles, np.uint32).reshape(-1, 3)
    return Mesh(name, np.asarray(positions, np.float32), triangles, np.zeros(len(triangles), np.uint32))


def make_scene(*meshes: Mesh, instances: Sequence[tuple[int, np.ndarray]] | None = None) -> Scene:
    """A scene of these meshes. instances: mesh index and (3, 4) transform of each; None: every mesh once, where it is."""
    placed = [(i, IDENTITY) for i in range(len(meshes))] if instances is None else instances
    return Scene(
        file="test",
        meshes=meshes,
        instances=tuple(Instance(f"instance {k}", mesh, matrix) for k, (mesh, matrix) in enumerate(placed)),
        materials=(Material("grey"),),
        textures=(),
        lights=(),
        environment=Environment(),
        camera=Camera(IDENTITY, 1.0),
    )


def soup(n: int, seed: int, size: float = 0.1) -> Mesh:
    """`n` separate random triangles about `size` large in the cube from -1 to 1."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (n, 1, 3)) + size * rng.normal(size=(n, 3, 3))
    return make_mesh(corners.reshape(-1, 3), np.arange(3 * n))


def icosphere(subdivisions: int) -> Mesh:
    """The unit sphere, vertices shared."""
    shape = trimesh.creation.icosphere(subdivisions)
    return make_mesh(shape.vertices, shape.faces)


def blob(subdivisions: int, seed: int = 1, roughness: float = 0.2) -> Mesh:
    """A closed mesh about the origin whose surface is rough from vertex to vertex; contains the ball of radius 0.6."""
    shape = trimesh.creation.icosphere(subdivisions)
    stretch = 1 + roughness * np.random.default_rng(seed).uniform(-1, 1, (len(shape.vertices), 1))
    return make_mesh(shape.vertices * stretch, shape.faces)


def prism(sides: int) -> Mesh:
    """A closed prism about the y axis, of needle triangles: the caps are fans about one vertex."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angle), np.zeros(sides), np.sin(angle)])
    positions = np.vstack([ring + [0, 1, 0], ring - [0, 1, 0], [[0, 1, 0], [0, -1, 0]]])
    a, b = np.arange(sides), (np.arange(sides) + 1) % sides
    top, bottom = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    rows = [(a, b, top), (a + sides, bottom, b + sides), (a, a + sides, b), (b, a + sides, b + sides)]
    return make_mesh(positions, np.vstack([np.column_stack(r) for r in rows]))


def cube() -> Mesh:
    """The cube from -1 to 1: 8 vertices, 12 triangles."""
    shape = trimesh.creation.box((2, 2, 2))
    return make_mesh(shape.vertices, shape.faces)


def moved(mesh: Mesh, scale: float = 1.0, offset: Sequence[float] = (0, 0, 0)) -> Mesh:
    """The mesh with its vertices scaled, then moved, then rounded to float32."""
    return make_mesh(mesh.positions.astype(np.float64) * scale + np.asarray(offset, np.float64), mesh.triangles)


def edges(mesh: Mesh) -> np.ndarray:
    """(e, 2): the vertices of each edge, once."""
    pairs = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    return np.unique(np.sort(pairs, axis=1), axis=0)


def edge_targets(mesh: Mesh, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 3) float32: vertices, edge midpoints and other points on edges, a third of each."""
    a, b = (mesh.positions[column].astype(np.float64) for column in edges(mesh).T)
    pick = rng.integers(len(a), size=n)
    along = np.choose(np.arange(n) % 3, [np.zeros(n), np.full(n, 0.5), rng.random(n)])[:, None]
    return (a[pick] * (1 - along) + b[pick] * along).astype(np.float32)


def random_directions(n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 3) float32, unit length, evenly over the sphere."""
    v = rng.normal(size=(n, 3))
    return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


UNIT_ROUNDOFF = 2.0**-24


@dataclass(frozen=True)
class ExactHits:
    """Rays against triangles in float64, and how far float32 may be off; arrays (rays, triangles).

    A watertight test in float32 answers for a triangle whose corners were moved by at most `delta`, a few units of
    roundoff of their distance from the ray's origin. So what lies farther from the ray than that is certain: `certain`,
    the ray passes within the triangle by more than delta; `possible`, it does not pass outside by more. `t` is that of the
    plane, and float32 finds it within `error`: moving the corners by delta moves the plane, where it meets the ray, by
    at most delta (1 + tan), tan that of the angle of incidence; and rounding the three weights, which are products of
    the corners' distances p from the ray, moves the point in the plane by a few units of roundoff of p0 p1 p2 / area.
    `nearest`, `farthest`: the corners' range along the axis that is longest in the ray's direction, in units of t.
    """

    t: np.ndarray
    error: np.ndarray
    certain: np.ndarray
    possible: np.ndarray
    nearest: np.ndarray
    farthest: np.ndarray


def exact_hits(
    origins: np.ndarray,
    directions: np.ndarray,
    corners: np.ndarray,
    roundoffs: float = 8.0,
    slack: np.ndarray | float = 0.0,
) -> ExactHits:
    """Every ray against every triangle. origins, directions: (n, 3); corners: (m, 3, 3) or (n, m, 3, 3).

    roundoffs, slack: delta is that many units of roundoff of the corners' distance, and this length more.
    """
    d = np.asarray(directions, np.float64)
    speed = np.linalg.norm(d, axis=1)[:, None]
    forward = d / speed
    helper = np.eye(3)[np.argmin(np.abs(forward), axis=1)]
    right = np.cross(forward, helper)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    frame = np.stack([right, np.cross(forward, right), forward], axis=1)  # (n, 3, 3): rows are axes
    offset = np.asarray(corners, np.float64) - np.asarray(origins, np.float64)[:, None, None]
    local = np.einsum("rij,rtkj->rtki", frame, offset)
    delta = roundoffs * UNIT_ROUNDOFF * np.linalg.norm(offset, axis=-1).max(axis=-1) + slack

    flat, depth = local[..., :2], local[..., 2]
    edge = np.roll(flat, -1, axis=2) - flat
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        along = np.clip(-(flat * edge).sum(-1) / (edge * edge).sum(-1), 0, 1)
        distance = np.linalg.norm(flat + np.nan_to_num(along)[..., None] * edge, axis=-1).min(axis=-1)
        sides = flat[..., 0] * edge[..., 1] - flat[..., 1] * edge[..., 0]
        inside = (sides > 0).all(axis=-1) | (sides < 0).all(axis=-1)
        weights = np.roll(sides, -1, axis=2)  # the side opposite to each corner
        normal = np.cross(local[..., 1, :] - local[..., 0, :], local[..., 2, :] - local[..., 0, :])
        area = np.abs(weights.sum(-1))
        t = (weights * depth).sum(-1) / weights.sum(-1) / speed
        slide = 24 * UNIT_ROUNDOFF * np.linalg.norm(flat, axis=-1).prod(axis=-1) / area
        tangent = np.linalg.norm(normal[..., :2], axis=-1) / np.abs(normal[..., 2])
        error = (delta * (1 + tangent) + slide * tangent) / speed + 4 * UNIT_ROUNDOFF * np.abs(t)
    t = np.where(np.isfinite(t), t, 0.0)
    has_area = area > 1e-10 * (edge * edge).sum(-1).max(axis=-1)  # seen along the ray; else float64 has no t either
    error = np.where(has_area & np.isfinite(error), error, np.inf)
    certain = inside & (distance > delta) & np.isfinite(error)
    axis = np.argmax(np.abs(d), axis=1)[:, None, None, None]
    ahead = (
        np.take_along_axis(offset, np.broadcast_to(axis, (*offset.shape[:3], 1)), axis=3)[..., 0]
        / np.take_along_axis(d, axis[:, :, 0, 0], axis=1)[:, :, None]
    )
    reach = delta / speed + 4 * UNIT_ROUNDOFF * np.abs(ahead).max(axis=-1)
    nearest, farthest = ahead.min(axis=-1) - reach, ahead.max(axis=-1) + reach
    return ExactHits(t, error, certain, inside | (distance <= delta), nearest, farthest)


def wrong_hits(
    exact: ExactHits, hits: np.ndarray, primitive: np.ndarray, t_min: float = 0.0, t_max: float = np.inf
) -> np.ndarray:
    """(n,) bool: which of these hits no rounding explains. primitive: the hit's column in `exact`, or MISS."""
    rays, t = np.arange(len(hits)), hits["t"].astype(np.float64)
    missed = primitive == MISS
    column = np.where(missed, 0, primitive)
    must_be_hit = exact.certain & (exact.t - exact.error > t_min) & (exact.t + exact.error < t_max)
    overlooked = (must_be_hit & (exact.t + exact.error < np.where(missed, np.inf, t)[:, None])).any(axis=1)
    with np.errstate(invalid="ignore"):
        off = np.abs(t - exact.t[rays, column]) > exact.error[rays, column]
    off |= (t < exact.nearest[rays, column]) | (t > exact.farthest[rays, column])
    invented = ~exact.possible[rays, column] | off | (t <= t_min) | (t >= t_max)
    return overlooked | (~missed & invented)


def tunnel(sides: int = 200, radius: float = 16.0, half_length: float = 1024.0) -> Mesh:
    """A closed tube along the z axis: long thin triangles, whose edges pass close by the middle."""
    shape = prism(sides)
    return make_mesh(shape.positions[:, [0, 2, 1]] * [radius, radius, half_length], shape.triangles[:, ::-1])


@dataclass(frozen=True)
class WorldTriangles:
    """Every triangle of every instance, in float64. corners: (m, 3, 3). first: (instances,), where each one's begin.
    spread: (m,), what the errors of its transform there and back are multiplied by; offset: (m,), its distance."""

    corners: np.ndarray
    first: np.ndarray
    spread: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> "WorldTriangles":
        """Gather a scene's instances."""
        corners, spread, offset = [], [], []
        for instance in scene.instances:
            mesh = scene.meshes[instance.mesh]
            matrix = instance.transform.astype(np.float32).astype(np.float64)
            linear, move = matrix[:, :3], matrix[:, 3]
            corners.append((mesh.positions.astype(np.float64) @ linear.T + move)[mesh.triangles])
            is_identity = np.array_equal(matrix, IDENTITY)
            there_and_back = 0.0 if is_identity else np.linalg.norm(np.abs(linear) @ np.abs(np.linalg.inv(linear)), 2)
            spread.append(np.full(len(mesh.triangles), there_and_back))
            offset.append(np.full(len(mesh.triangles), np.linalg.norm(move)))
        first = np.concatenate([[0], np.cumsum([len(c) for c in corners])[:-1]])
        return cls(np.concatenate(corners), first, np.concatenate(spread), np.concatenate(offset))

    def wrong(
        self, hits: np.ndarray, origins: np.ndarray, directions: np.ndarray, t_min: float = 0.0, t_max: float = np.inf
    ) -> np.ndarray:
        """(n,) bool: which of these hits no rounding explains; all pairs of rays and triangles are evaluated."""
        far = (
            np.linalg.norm(np.asarray(origins, np.float64), axis=1)[:, None]
            + np.abs(self.corners).max(axis=(1, 2))
            + self.offset
        )
        exact = exact_hits(origins, directions, self.corners, slack=16 * UNIT_ROUNDOFF * self.spread * far)
        missed = hits["instance"] == MISS
        place = np.where(missed, MISS, self.first[np.where(missed, 0, hits["instance"])] + hits["primitive"])
        return wrong_hits(exact, hits, place, t_min, t_max)
