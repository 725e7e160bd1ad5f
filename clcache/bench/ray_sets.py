"""Fixed sets of rays through a scene, as a path tracer traces them: camera rays, diffuse bounces and shadow rays.

Camera rays come in tiles of 4 x 4 pixels, 16 neighbours in a row, the tiles line by line; one goes through the centre of
each pixel. Those that hit something begin a bounce, cosine-distributed about the normal, and a ray to a point on one of
the lights; both keep the order of the camera rays. All are functions of the scene, the size and the seed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..bvh.tracer import MISS
from ..scene.emitters import Emitters
from ..scene.geometry import Geometry, instance_bounds
from ..scene.model import Camera, Scene
from ..scene.motion import pose_at
from ..scene.transform import rigid

TILE = 4  # pixels, in both directions
# Two hits are the same whose t differ by no more than this, relative to t, and to the largest coordinate of an origin.
AGREE_T, AGREE_PLACE = 1e-4, 1e-6
# Rays leave a surface this far above it, relative to the largest coordinate of the scene, and end this part before a light.
_OFFSET = 1e-5
_SHORTENED = 1e-3
_POINT, _DIRECTIONAL, _TRIANGLE = range(3)  # kinds of Emitter


@dataclass(frozen=True)
class RaySet:
    """Rays as planes. origins, directions: (3, n) float32, unit directions. lengths: (n,) float32. any_hit: whether only
    the question is whether something is hit. coherent: whether neighbours are alike."""

    kind: str
    origins: np.ndarray
    directions: np.ndarray
    lengths: np.ndarray
    any_hit: bool
    coherent: bool

    @property
    def count(self) -> int:
        """How many rays."""
        return len(self.lengths)


def ray_sets(
    scene: Scene,
    closest_hit: Callable[[np.ndarray, np.ndarray], np.ndarray],
    size: tuple[int, int],
    seed: int = 1,
    light_spread: float = 0.0,
) -> tuple[RaySet, RaySet, RaySet]:
    """Primary, diffuse-bounce and shadow rays of a scene as it is at time 0.

    closest_hit: as of `Tracer`. size: width, height in pixels, multiples of TILE. light_spread: by how much, as the standard
    deviation of a unit vector's components, the directions to a directional light differ. Sets after the first are empty
    where nothing is hit; so is the last where no light is in front.
    """
    geometry = Geometry.of(scene)
    rng = np.random.default_rng(seed)
    primary = camera_rays(scene.camera, size)
    hits = closest_hit(primary.origins.T, primary.directions.T)
    points, normals = _surfaces(geometry, primary, hits)
    diffuse = _ray_set("diffuse", points, _cosine_distributed(normals, rng), np.inf, any_hit=False, coherent=False)
    towards, distance = _to_lights(scene, geometry, points, normals, light_spread, rng)
    front = (towards * normals).sum(axis=0) > 0
    shadow = _ray_set(
        "shadow", points[:, front], towards[:, front], distance[front] * (1 - _SHORTENED), any_hit=True, coherent=True
    )
    return primary, diffuse, shadow


def camera_rays(camera: Camera, size: tuple[int, int]) -> RaySet:
    """One ray through the centre of each pixel, in tiles. size: width, height in pixels, multiples of TILE."""
    width, height = size
    transform = rigid(pose_at(camera.motion, 0.0)) if camera.motion else np.asarray(camera.transform, np.float64)
    slope = np.tan(camera.fov_y / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * slope * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * slope
    across, up = (_tiled(a, size) for a in np.meshgrid(x, y))
    on_plane = transform[:, :3] @ np.stack([across, up, np.full_like(across, -1.0)])
    origins = transform[:, 3:] + camera.near * on_plane
    return _ray_set("primary", origins, _unit(on_plane), np.inf, any_hit=False, coherent=True)


def _ray_set(kind: str, origins, directions, lengths, any_hit: bool, coherent: bool) -> RaySet:
    n = origins.shape[1]
    rays = (np.ascontiguousarray(a, np.float32) for a in (origins, directions, np.broadcast_to(lengths, n)))
    return RaySet(kind, *rays, any_hit, coherent)


def _tiled(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    width, height = size
    return image.reshape(height // TILE, TILE, width // TILE, TILE).transpose(0, 2, 1, 3).ravel()


def _unit(vectors: np.ndarray) -> np.ndarray:
    """(3, n), of unit length; a zero vector points up."""
    length = np.sqrt((vectors * vectors).sum(axis=0))
    return np.where(length > 0, vectors, [[0.0], [1.0], [0.0]]) / np.where(length > 0, length, 1.0)


def _surfaces(geometry: Geometry, rays: RaySet, hits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points just above what was hit, and its geometric normals on the rays' side: (3, m) float64 each."""
    hit = hits["instance"] != MISS
    instance, primitive = hits["instance"][hit], hits["primitive"][hit]
    corners = _corners(geometry, instance, primitive)
    normals = _unit(np.cross(corners[1] - corners[0], corners[2] - corners[0], axis=0))
    directions = rays.directions[:, hit].astype(np.float64)
    normals = np.where((normals * directions).sum(axis=0) > 0, -normals, normals)
    scale = max(float(np.abs(bound).max()) for bound in instance_bounds(geometry))
    return rays.origins[:, hit] + directions * hits["t"][hit] + normals * scale * _OFFSET, normals


def _corners(geometry: Geometry, instance: np.ndarray, primitive: np.ndarray) -> np.ndarray:
    """(3 corners, 3, m) float64: triangles in world space. instance, primitive: (m,)."""
    first = geometry.first_triangle[geometry.instance_mesh[instance]]
    corners = geometry.positions[geometry.triangles[first + primitive]].astype(np.float64)
    matrix = geometry.to_world[instance].astype(np.float64)
    return (np.einsum("mij,mkj->kim", matrix[:, :, :3], corners) + matrix[:, :, 3].T).astype(np.float64)


def _cosine_distributed(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    u, v = rng.random((2, normals.shape[1]))
    helper = np.where(np.abs(normals[0]) > 0.9, [[0.0], [1.0], [0.0]], [[1.0], [0.0], [0.0]])
    tangent = _unit(np.cross(helper, normals, axis=0))
    bitangent = np.cross(normals, tangent, axis=0)
    radius, angle = np.sqrt(u), 2 * np.pi * v
    return _unit(radius * np.cos(angle) * tangent + radius * np.sin(angle) * bitangent + np.sqrt(1 - u) * normals)


def _to_lights(
    scene: Scene, geometry: Geometry, points: np.ndarray, normals: np.ndarray, spread: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (3, m) to a light for each point, chosen by the lights' shares of the power, and distances (m,);
    where the light is the sky, a direction as a bounce would take it."""
    emitters = Emitters.of(scene, geometry)
    m = points.shape[1]
    towards, distance = _cosine_distributed(normals, rng), np.full(m, np.inf)
    choice, u, v = rng.random((3, m))
    if not len(emitters.records):
        return towards, distance
    record = emitters.records[
        np.searchsorted(emitters.shares, choice.astype(np.float32), side="right").clip(max=len(emitters.shares) - 1)
    ]
    kind = record["kind"]
    parallel = kind == _DIRECTIONAL
    directions = record["direction"][parallel].T.astype(np.float64)
    towards[:, parallel] = _unit(directions + spread * rng.standard_normal(directions.shape))
    target = record["position"].T.astype(np.float64)
    triangle = kind == _TRIANGLE
    a, b, c = _corners(geometry, record["instance"][triangle], record["primitive"][triangle])
    root, v = np.sqrt(u[triangle]), v[triangle]
    target[:, triangle] = (1 - root) * a + root * (1 - v) * b + root * v * c
    near = triangle | (kind == _POINT)
    offset = target[:, near] - points[:, near]
    towards[:, near], distance[near] = _unit(offset), np.sqrt((offset * offset).sum(axis=0))
    return towards, distance


def agreement(rays: RaySet, ours: np.ndarray, theirs: np.ndarray) -> float:
    """The part of the rays of which two tracers say the same. ours, theirs: (n,), t of the hits, infinite for a miss, within
    AGREE_T; where any hit is asked for, whether there is one."""
    if not rays.count:
        return 1.0
    if rays.any_hit:
        return float(np.mean(ours.astype(bool) == theirs.astype(bool)))
    missed = np.isinf(ours), np.isinf(theirs)
    with np.errstate(invalid="ignore"):
        near = np.abs(ours - theirs) <= AGREE_T * np.abs(theirs) + AGREE_PLACE * np.abs(rays.origins).max()
    return float(np.mean(np.where(missed[0] | missed[1], missed[0] & missed[1], near)))
