"""The seeded meshes on which clcache and Embree trace the same rays: scenes of one or two instances, y up.

cornell: a room with two spheres, 10 thousand triangles. terrain: a height field, a million. hairball: a million triangles in
2,500 curled ribbons. city: 2,000 boxes seen from a street, 24 thousand. blob: a noisy sphere on a floor, 328 thousand.
mixed: long thin beams that cross each other, and balls of very different sizes, 267 thousand; hard for trees.
"""

from collections.abc import Callable

import numpy as np
import trimesh

from clcache.scene.model import Camera, DirectionalLight, Environment, Instance, Light, Material, Mesh, Scene
from clcache.scene.transform import look_at

Shape = tuple[np.ndarray, np.ndarray]  # positions (v, 3), triangles (t, 3)

_QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def cornell() -> Scene:
    """A box as wide as a 16:9 picture, open in front, with a lamp below the ceiling."""
    x = 16 / 9
    low, high = (np.array([[-x, y, 1], [x, y, 1], [x, y, -1], [-x, y, -1]]) for y in (-1, 1))
    walls = [low, high, *(np.stack([low[i], low[j], high[j], high[i]]) for i, j in ((3, 2), (0, 3), (2, 1)))]
    balls = [_ball((-0.75, -0.55, -0.35), 0.45), _ball((0.65, -0.6, 0.25), 0.40)]
    lamp = np.array([[-0.25, 0.99, -0.19], [0.25, 0.99, -0.19], [0.25, 0.99, 0.19], [-0.25, 0.99, 0.19]])
    parts = [(wall, _QUAD) for wall in walls]
    return _scene("cornell", _joined([*parts, *balls]), _camera((0, 0, 3.9), (0, 0, 0), 38), lamp=(lamp, _QUAD))


def terrain() -> Scene:
    """Hills whose spectrum falls with frequency to the power of -1.9."""
    cells, rng = 708, np.random.default_rng(11)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(cells), np.fft.fftfreq(cells), indexing="ij"))
    frequency[0, 0] = 1
    spectrum = (rng.normal(size=(cells, cells)) + 1j * rng.normal(size=(cells, cells))) * frequency**-1.9
    spectrum[0, 0] = 0
    height = np.fft.ifft2(spectrum).real
    height = 5 * (height - height.mean()) / height.std()
    x, z = np.meshgrid(np.linspace(-50, 50, cells), np.linspace(-50, 50, cells), indexing="ij")
    corner = (np.arange(cells - 1)[:, None] * cells + np.arange(cells - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + cells], 1)
    upper = np.stack([corner + 1, corner + cells + 1, corner + cells], 1)
    triangles = np.stack([lower, upper], 1).reshape(-1, 3)

    def ground(at: float) -> float:
        index = round((at + 50) / 100 * (cells - 1))
        return height[index, index]

    eye = (-40, max(ground(-40), ground(-36)) + 9, -40)
    shape = np.stack([x, height, z], -1).reshape(-1, 3), triangles
    return _scene("terrain", shape, _camera(eye, (5, -4, 5), 40), sun=(-0.55, -0.5, 0.3))


def hairball() -> Scene:
    """Ribbons that begin on a sphere, wander, and are drawn back."""
    strands, segments, rng = 2500, 200, np.random.default_rng(12)
    forward = _unit(rng.normal(size=(strands, 3)))
    path = np.empty((strands, segments + 1, 3))
    path[:, 0] = forward * 0.25
    turn = rng.normal(size=(strands, 3)) * 0.5
    for step in range(segments):
        turn = turn * 0.97 + rng.normal(size=(strands, 3)) * 0.35
        here = path[:, step]
        back = np.maximum(0, np.linalg.norm(here, axis=1, keepdims=True) - 0.6)
        forward = _unit(forward + np.cross(turn, forward) * 0.05 - here * 0.02 * back)
        path[:, step + 1] = here + forward * 0.0095
    tangent = _unit(np.gradient(path, axis=1))
    side = _unit(np.cross(tangent, rng.normal(size=(strands, 1, 3))))
    half_width = 0.0025 * np.linspace(1, 0.25, segments + 1)[None, :, None]
    positions = np.stack([path - side * half_width, path + side * half_width], 2).reshape(-1, 3)
    first = 2 * (np.arange(strands)[:, None] * (segments + 1) + np.arange(segments)).ravel()
    lower, upper = np.stack([first, first + 1, first + 2], 1), np.stack([first + 1, first + 3, first + 2], 1)
    triangles = np.stack([lower, upper], 1).reshape(-1, 3)
    return _scene("hairball", (positions, triangles), _camera((0, 0.2, 1.75), (0, 0, 0), 38), sun=(-0.4, -0.7, -0.5))


def city() -> Scene:
    """Houses of many heights on a grid of streets, seen from one of them."""
    blocks, houses, rng = 45, 2000, np.random.default_rng(13)
    place = np.sort(rng.permutation(blocks * blocks)[:houses])
    random = rng.random((houses, 7)).T
    cell = np.stack(np.divmod(place, blocks)) - blocks / 2 + 0.5
    middle = cell * 20 + (random[:2] * 1.6 - 0.8)
    width = 9 + 5 * random[2:4]
    height = 6 + 12 * random[4] + (random[5] < 0.25) * (10 + 35 * random[6])
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (0, 1) for z in (-0.5, 0.5)])
    size, offset = np.stack([width[0], height, width[1]], -1), np.stack([middle[0], 0 * height, middle[1]], -1)
    positions = (corners * size[:, None] + offset[:, None]).reshape(-1, 3)
    quads = np.array([[1, 5, 7, 3], [4, 0, 2, 6], [5, 4, 6, 7], [0, 1, 3, 2], [3, 7, 6, 2], [0, 4, 5, 1]])
    box = quads[:, _QUAD].reshape(-1, 3)
    triangles = (8 * np.arange(houses)[:, None, None] + box).reshape(-1, 3)
    g = blocks * 10 + 30
    ground = np.array([[-g, 0, g], [g, 0, g], [g, 0, -g], [-g, 0, -g]])
    shape = _joined([(positions, triangles), (ground, _QUAD)])
    return _scene("city", shape, _camera((10.6, 1.7, 112.0), (4.0, 9.0, 60.0), 55), sun=(-0.45, -0.8, -0.35))


def blob() -> Scene:
    """A sphere with six octaves of waves in six directions each."""
    rng, points = np.random.default_rng(14), trimesh.creation.icosphere(7)
    radius = np.ones(len(points.vertices))
    for octave in range(6):
        for _ in range(6):
            wave = rng.normal(size=3) * 2.2**octave * 1.3
            radius += 0.055 / 1.9**octave * np.sin(points.vertices @ wave + rng.uniform(0, 6.28))
    positions = points.vertices * radius[:, None]
    y = positions[:, 1].min()
    ground = np.array([[-8, y, 8], [8, y, 8], [8, y, -8], [-8, y, -8]])
    shape = _joined([(positions, points.faces), (ground, _QUAD)])
    return _scene("blob", shape, _camera((1.2, 1.1, 3.4), (0, -0.1, 0), 36), sun=(-0.5, -0.8, -0.35))


def mixed() -> Scene:
    """Beams from wall to wall of a cube, each in twelve triangles, and balls whose sizes span two decades."""
    rng = np.random.default_rng(15)
    cube = trimesh.creation.box()
    parts: list[Shape] = []
    for _ in range(400):
        along = _unit(rng.normal(size=3))
        across = _unit(np.cross(along, rng.normal(size=3)))
        axes = np.stack([along * 4, across * 0.01, np.cross(along, across) * 0.01])
        parts.append((cube.vertices @ axes + rng.uniform(-1, 1, 3), cube.faces))
    parts += [_ball(rng.uniform(-1, 1, 3), 0.2 * 10 ** rng.uniform(-2, 0), 3) for _ in range(205)]
    return _scene("mixed", _joined(parts), _camera((0.3, 0.4, 3.5), (0, 0, 0), 45), sun=(-0.4, -0.7, -0.5))


USUAL = ("cornell", "terrain", "hairball", "city", "blob")
MESHES: dict[str, Callable[[], Scene]] = {f.__name__: f for f in (cornell, terrain, hairball, city, blob, mixed)}


def _scene(name: str, shape: Shape, camera: Camera, sun=None, lamp: Shape | None = None) -> Scene:
    """One mesh, and a lamp as another one, which is told by its material."""
    parts = [shape] if lamp is None else [shape, lamp]
    lights: tuple[Light, ...] = ()
    if sun is not None:
        lights = (DirectionalLight(tuple(_unit(np.array(sun))), (3.0, 2.8, 2.4)),)
    meshes = [
        Mesh(name, positions.astype(np.float32), triangles.astype(np.uint32), np.full(len(triangles), index, np.uint32))
        for index, (positions, triangles) in enumerate(parts)
    ]
    return Scene(
        file=name,
        meshes=tuple(meshes),
        instances=tuple(Instance(name, index, np.eye(3, 4)) for index in range(len(meshes))),
        materials=(Material("grey"), Material("lamp", emission=(18.4, 15.6, 8.0)))[: len(meshes)],
        textures=(),
        lights=lights,
        environment=Environment(),
        camera=camera,
    )


def _camera(eye, target, degrees: float) -> Camera:
    return Camera(look_at(eye, target), np.radians(degrees))


def _ball(centre, radius: float, subdivisions: int = 4) -> Shape:
    shape = trimesh.creation.icosphere(subdivisions, radius)
    return shape.vertices + np.array(centre), shape.faces


def _joined(parts: list[Shape]) -> Shape:
    starts = np.cumsum([0, *(len(positions) for positions, _ in parts)])
    triangles = [triangles + start for (_, triangles), start in zip(parts, starts, strict=False)]
    return np.concatenate([positions for positions, _ in parts]), np.concatenate(triangles)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
