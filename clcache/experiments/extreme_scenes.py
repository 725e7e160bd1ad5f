"""Scenes whose picture is known, and all ways to render them: what the cases of extreme_cases.py are made of.

What is seen is as bright as its albedo: level ground under a sun in the zenith of pi W / m^2, which has no noise under
direct light. So whatever goes wrong with a ray, a sample, a cache or a filter shows in a pixel, at any scale and place.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..graph import compile_graph
from ..graph.library import library
from ..graph.text import parse
from ..scene.generators import grid, plane, sphere
from ..scene.model import (
    Camera,
    DirectionalLight,
    Environment,
    Instance,
    Light,
    Material,
    Mesh,
    Scene,
    Track,
)
from ..scene.transform import look_at
from .configuration import Configuration

ALBEDO, OTHER_ALBEDO = 0.5, 0.25  # of the two materials of each ground; exact in half precision
DOWN = (0.0, -1.0, 0.0)
_DIRECT = {"pathtrace.bounces": 0}
_OCTREE = {"octree.resolution": 64, "octree.filter": "none"}
_VOXELS = {"voxelhash.capacity": 2**14}


def _way(name: str, method: str = "pathtrace", settings: dict | None = None, **rest: object) -> Configuration:
    return Configuration(name, method, _DIRECT | (settings or {}), **rest)


# What a case's scene is rendered by, each by direct light, which is without noise: the methods, memoization, filters.
WAYS = {
    way.name: way
    for way in (
        _way("pathtrace"),
        _way("samplecache", "samplecache"),
        _way("isrt", "isrt"),
        _way("voxelhash", "voxelhash", _VOXELS),
        _way("hybrid", "hybrid", _VOXELS),
        _way("octree", "octree", _OCTREE),
        _way("memo texel", settings={"memo.auto": False}, memo="texel"),
        _way("memo tile", settings={"memo.auto": False}, memo="tile"),
        _way("taa", temporal="taa"),
        _way("varianceblend", temporal="varianceblend"),
        _way("stereo varianceblend", stereo_blend="varianceblend"),
        _way("stereo samples", "samplecache", stereo_blend="samples"),
    )
}
METHODS = ("pathtrace", "samplecache", "isrt", "voxelhash", "hybrid", "octree")
CACHES = METHODS[1:]
MEMOS = ("memo texel", "memo tile")
FILTERS = ("taa", "varianceblend", "stereo varianceblend", "stereo samples")
ALL = METHODS + MEMOS + FILTERS


def view(
    eye: Sequence[float], target: Sequence[float], degrees: float = 40.0, near: float = 0.0, up=(0.0, 1.0, 0.0)
) -> Camera:
    """A camera that looks from one place at another."""
    return Camera(look_at(eye, target, up), np.radians(degrees), near)


ABOVE = view((0, 3, 0.1), (0, 0, 0))


def mesh(positions: np.ndarray, triangles: np.ndarray, uvs: np.ndarray | None = None, material: int = 0) -> Mesh:
    """Flat triangles."""
    triangles = np.asarray(triangles, np.uint32).reshape(-1, 3)
    uvs = None if uvs is None else np.asarray(uvs, np.float32)
    of = np.full(len(triangles), material, np.uint32)
    return Mesh("mesh", np.asarray(positions, np.float32), triangles, of, None, uvs)


def floor(size: float = 20.0, material: int = 0) -> Mesh:
    """A square in the plane y = 0."""
    shape = plane((size, size))
    return mesh(shape.positions, shape.triangles, shape.uvs, material)


def ball(radius: float = 1.0, subdivisions: int = 2, material: int = 0) -> Mesh:
    """A sphere of triangles about the origin."""
    shape = sphere(radius, subdivisions)
    return mesh(shape.positions, shape.triangles, shape.uvs, material)


def needles(width: float) -> Mesh:
    """Ground 1 m wide, of triangles 1 m long and next to nothing wide."""
    shape = grid((1.0, 64 * width), (1, 64))
    return mesh(shape.positions, shape.triangles, shape.uvs)


def with_degenerate(base: Mesh) -> Mesh:
    """The mesh with each triangle twice, among points and lines."""
    low, first = base.positions.min(axis=0), len(base.positions)
    more = low + np.array([[0, 0.5, 0], [1, 0.5, 0], [2, 0.5, 0]], np.float32)
    flat = np.array([[first, first + 1, first + 2], [first, first, first + 1], [first] * 3, [0, 0, 1]])
    triangles = np.vstack([flat] * 8 + [base.triangles] * 2 + [flat] * 8)
    return mesh(np.vstack([base.positions, more]), triangles, np.vstack([base.uvs, np.zeros((3, 2))]))


def at(place: Sequence[float], scale: float = 1.0) -> np.ndarray:
    """(3, 4): a transform."""
    return np.column_stack([scale * np.eye(3), place])


def scene(
    *meshes: Mesh,
    camera: Camera | Sequence[Camera] = ABOVE,
    albedos: Sequence[float] = (ALBEDO, OTHER_ALBEDO),
    materials: Sequence[Material] | None = None,
    lights: Sequence[Light] | None = None,
    power: float = 1.0,
    environment: float | Environment = 0.0,
    places: Sequence[np.ndarray] | None = None,
    eye_distance: float = 0.063,
    **parts: object,
) -> Scene:
    """Meshes under the sun, each once where it is unless `places` has transforms for them. camera: one for each frame,
    or for all. power: of the sun, times pi W / m^2. parts: of the scene."""
    cameras = [camera] if isinstance(camera, Camera) else list(camera)
    matrices = [np.eye(4)[:3]] * len(meshes) if places is None else places
    sun = DirectionalLight(DOWN, (power * np.pi,) * 3)
    sky = environment if isinstance(environment, Environment) else Environment.constant((environment,) * 3)
    made = Scene(
        file="extremes",
        meshes=meshes,
        instances=tuple(Instance(f"instance {k}", k, matrix) for k, matrix in enumerate(matrices)),
        materials=tuple(materials or (Material(f"grey {a}", (a,) * 3) for a in albedos)),
        textures=(),
        lights=(sun,) if lights is None else tuple(lights),
        environment=sky,
        camera=cameras[0] if len(cameras) == 1 else _along(cameras),
        **parts,
    )
    return replace(made, defaults=replace(made.defaults, fps=1.0, eye_distance=eye_distance))


def _along(cameras: Sequence[Camera]) -> Camera:
    """A camera that stands in frame k where the k-th does."""
    poses = np.array([c.transform for c in cameras])
    turns = Rotation.from_matrix(poses[:, :, :3]).as_quat()
    times = np.arange(len(cameras), dtype=float)
    return replace(cameras[0], motion=(Track(times, poses[:, :, 3], turns, np.ones((len(cameras), 3)), step=True),))


def ground(size: float = 20.0, **options: object) -> Scene:
    """A floor under the sun."""
    return scene(floor(size), **options)


def two_grounds(first: Sequence[float], second: Sequence[float], size: float, cameras: Sequence[Camera]) -> Scene:
    """A floor of one albedo at a place, and one of another elsewhere."""
    return scene(floor(size), floor(size, 1), camera=cameras, places=[at(first), at(second)])


def scaled(of: Scene, scale: float) -> Scene:
    """The scene made larger: its meshes, where they stand, and where it is seen from."""

    def larger(transform: np.ndarray) -> np.ndarray:
        return np.column_stack([transform[:, :3], scale * transform[:, 3]])

    meshes = tuple(replace(m, positions=m.positions * np.float32(scale)) for m in of.meshes)
    instances = tuple(replace(i, transform=larger(np.asarray(i.transform))) for i in of.instances)
    tracks = tuple(replace(t, translation=scale * t.translation) for t in of.camera.motion)
    camera = replace(of.camera, transform=larger(of.camera.transform), motion=tracks, near=scale * of.camera.near)
    defaults = replace(of.defaults, eye_distance=scale * of.defaults.eye_distance)
    return replace(of, meshes=meshes, instances=instances, camera=camera, defaults=defaults)


def tilted(of: Scene) -> Scene:
    """The scene turned about the origin, so that no plane is one of the axes', and hits on it are rounded."""
    turn = Rotation.from_rotvec((0.5, 0.3, -0.8))
    matrix = turn.as_matrix()
    instances = tuple(replace(i, transform=matrix @ i.transform) for i in of.instances)
    tracks = tuple(
        replace(t, translation=t.translation @ matrix.T, rotation=(turn * Rotation.from_quat(t.rotation)).as_quat())
        for t in of.camera.motion
    )
    camera = replace(of.camera, transform=matrix @ of.camera.transform, motion=tracks)
    lights = tuple(replace(light, direction=tuple(matrix @ light.direction)) for light in of.lights)
    return replace(of, instances=instances, camera=camera, lights=lights)


def still_life() -> Scene:
    """Two balls on a floor under sun and sky, seen on the way past them."""
    cameras = [view((1.0 + 0.1 * k, 2, 4), (0, 0.5, 0)) for k in range(3)]
    return scene(
        floor(6), ball(0.8, 2, 1), ball(0.3, 1),
        camera=cameras, environment=0.4, lights=[DirectionalLight((0.48, -0.8, 0.36), (2.0, 1.8, 1.5))],
        places=[at((0, 0, 0)), at((0, 0.8, 0)), at((-1.2, 0.4, 1))],
    )  # fmt: skip


@functools.cache
def _graph(name: str, output: str, values: str, bright: str = "0 0"):
    """A graph whose value is constant, which nothing but its being evaluated shows."""
    text = (
        f"UVInput Out>0;\nFloat2Constant {bright} Out>1;\nDot A<0 B<1 Out>2;\n"
        f"Float3Constant {values} Out>3;\nAdd A<2 B<3 Out>4;\n{output} In<4;\n"
    )
    return compile_graph(parse(text, f"{name}.graph", library()))


def painted(of: Scene) -> Scene:
    """The scene with graphs that compute the same two albedos."""
    materials = [
        Material(f"painted {k}", graph=_graph(f"painted{k}", "ColorOutput", f"{albedo} {albedo} {albedo}"))
        for k, albedo in enumerate((ALBEDO, OTHER_ALBEDO))
    ]
    return replace(of, materials=tuple(materials))


def lamp(values: str) -> Material:
    """A black surface of which a graph computes the emission: three numbers, in words."""
    return Material("lamp", (0.0,) * 3, graph=_graph(f"lamp{values}".replace(" ", "_"), "EmissionOutput", values))


def made_for(way: Configuration, make: Callable[[], Scene]) -> Scene:
    """The scene as a way needs it: with graphs, if it is memoized."""
    made = make()
    return made if way.memo == "off" or made.materials[0].graph else painted(made)
