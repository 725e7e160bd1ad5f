"""Scenes with light and cameras, rendering them in one call, and the camera rays of a frame worked out in NumPy."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from helpers import IDENTITY, make_mesh, make_scene

from clcache import Renderer
from clcache.random import random4, stream_key
from clcache.renderer import Frame
from clcache.scene.generators import Shape, plane, sphere
from clcache.scene.model import (
    Camera,
    DirectionalLight,
    Environment,
    Instance,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    Texture,
    TextureUse,
)
from clcache.scene.transform import look_at

BLACK = (0.0, 0.0, 0.0)
WHITE = (1.0, 1.0, 1.0)
MODELLED = "independent"  # the sampler of which `camera_rays` knows the numbers; its samples are independent


def grey(albedo: float, emission: float = 0.0) -> Material:
    """A material without colour."""
    return Material("grey", (albedo,) * 3, emission=(emission,) * 3)


def view(
    eye: Sequence[float], target: Sequence[float], degrees: float = 40, near: float = 0.0, up=(0.0, 1.0, 0.0)
) -> Camera:
    """A camera that looks from one place at another."""
    return Camera(look_at(eye, target, up), np.radians(degrees), near)


def shape_mesh(shape: Shape, material: int = 0, smooth: bool = False) -> Mesh:
    """A mesh of a generator's arrays; its normals only if `smooth`."""
    uvs = None if shape.uvs is None else np.asarray(shape.uvs, np.float32)
    normals = np.asarray(shape.normals, np.float32) if smooth else None
    mesh = make_mesh(shape.positions, shape.triangles)
    return replace(mesh, material=mesh.material + np.uint32(material), normals=normals, uvs=uvs)


def lit(
    *meshes: Mesh,
    camera: Camera,
    materials: Sequence[Material] = (grey(1.0),),
    lights: Sequence[Light] = (),
    environment: tuple[float, float, float] | Environment = BLACK,
    textures: Sequence[Texture] = (),
    instances: Sequence[tuple[int, np.ndarray]] | None = None,
    eye_distance: float = 0.0,
) -> Scene:
    """A scene of these meshes, each once where it is unless `instances` place them (mesh index and transform)."""
    scene = make_scene(*meshes, instances=instances)
    if not isinstance(environment, Environment):
        environment = Environment.constant(environment)
    return replace(
        scene,
        materials=tuple(materials),
        lights=tuple(lights),
        environment=environment,
        textures=tuple(textures),
        camera=camera,
        defaults=replace(scene.defaults, eye_distance=eye_distance),
    )


def render(scene: Scene, size: tuple[int, int] = (16, 16), spp: int = 1, frame: int = 0, **options) -> Frame:
    """One frame. options: of `Renderer`, and `bounces` and `sampler`, settings by their last names."""
    short = {f"pathtrace.{name}": options.pop(name) for name in ("bounces", "sampler") if name in options}
    options["settings"] = short | options.get("settings", {})
    return next(Renderer(scene, size=size, spp=spp, **options).frames(frame, frame + 1))


def image(scene: Scene, *arguments, **options) -> np.ndarray:
    """The colour of one frame of one eye: (H, W, 3)."""
    return render(scene, *arguments, **options).color["mono"]


def z_of_mean(color: np.ndarray, expected: float | np.ndarray) -> np.ndarray:
    """(channels,): by how many standard deviations the mean of an image departs from what is expected. color: (H, W, 3), all
    pixels independent estimates of the same, so rendered with sampler=MODELLED. A relative 1e-6 is allowed for the
    rounding of float32 sums; |z| < 3.3 has significance 0.001."""
    pixels = color.reshape(-1, color.shape[-1]).astype(float)
    away = np.abs(pixels.mean(axis=0) - expected) - 1e-6 * np.abs(expected)
    return np.maximum(away, 0) / np.maximum(pixels.std(axis=0, ddof=1) / np.sqrt(len(pixels)), 1e-30)


def camera_rays(
    camera: Camera, size: tuple[int, int], sample: int = 0, frame: int = 0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """The rays that a frame's sample sends through its pixels where the sampler is MODELLED: origin (3,), unit directions
    (H, W, 3), in float64."""
    width, height = size
    jitter = random4(np.arange(width * height, dtype=np.uint32), sample, 0, stream_key(seed, frame)).reshape(
        height, width, 4
    )
    x = (np.arange(width) + jitter[..., 0]) / width * 2 - 1
    y = 1 - (np.arange(height)[:, None] + jitter[..., 1]) / height * 2
    slope = np.tan(camera.fov_y / 2)
    local = np.stack([x * slope * width / height, y * slope, -np.ones_like(x)], axis=-1)
    directions = local @ camera.transform[:, :3].T
    return camera.transform[:, 3], directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def on_floor(camera: Camera, size: tuple[int, int], **which) -> np.ndarray:
    """(H, W, 3): where the camera's rays meet the plane y = 0."""
    origin, directions = camera_rays(camera, size, **which)
    return origin - directions * (origin[1] / directions[..., 1:2])


def floor(size: float = 30.0, material: int = 0) -> Mesh:
    """A square in the plane y = 0."""
    return shape_mesh(plane((size, size)), material)


def ball(radius: float = 1.0, subdivisions: int = 3, material: int = 0, smooth: bool = False) -> Mesh:
    """A sphere of triangles about the origin."""
    return shape_mesh(sphere(radius, subdivisions), material, smooth)


def checkered(size: int = 4, wrap: tuple[str, str] = ("repeat", "repeat")) -> Texture:
    """Random colours."""
    pixels = np.random.default_rng(5).integers(0, 256, (size, size, 4), dtype=np.uint8)
    return Texture("checkered", pixels, wrap=wrap)


def everything() -> Scene:
    """A small scene with all that the path tracer knows: textures, smooth and flat meshes, turned, stretched and mirrored
    instances, several lights of both kinds, emission and an environment."""
    materials = (Material("tiles", base_color_texture=TextureUse(0)), Material("red", (0.9, 0.2, 0.1)), grey(0.0, 3.0))
    lamp = shape_mesh(plane((1.0, 1.0)), 2)
    stretched = np.array([[0.5, 0.2, 0, -1.2], [0, 0.9, 0, 0.9], [0.1, 0, -0.6, 0]])
    lights = (
        PointLight((2, 3, 2), (20.0, 15.0, 10.0)),
        PointLight((-2, 1, 2), (1.0, 2.0, 6.0)),
        DirectionalLight((0.6, -0.8, 0.0), (1.0, 1.0, 0.5)),
    )
    return lit(
        floor(8),
        ball(1, 2, 1, smooth=True),
        lamp,
        camera=view((0.5, 3.5, 5), (0, 0.6, 0)),
        materials=materials,
        lights=lights,
        environment=(0.2, 0.3, 0.5),
        textures=(checkered(),),
        instances=[(0, IDENTITY), (1, stretched), (1, Instance("", 1).transform * 0.7 + [[0, 0, 0, 1], [0, 0, 0, 0.7], [0] * 4]),
                   (2, np.array([[1, 0, 0, 0], [0, -1, 0, 3], [0, 0, 1, -1]]))],
        eye_distance=0.1,
    )  # fmt: skip
