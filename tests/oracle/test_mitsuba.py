"""The path tracer against Mitsuba 3: the same scenes, exported by tools/peers/mitsuba_export.py, must give the same images.

Each comparison has a twin with lights that are wrong by 5 %, which the same test must tell from the right one.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import IDENTITY, cube
from render_helpers import WHITE, ball, floor, grey, lit, shape_mesh, view
from ztest import agree, blocks

from clcache import Renderer, SceneError, load_scene
from clcache.scene.generators import box, grid, plane
from clcache.scene.model import DirectionalLight, Material, PointLight, Scene, Texture
from clcache.scene.transform import rotation_matrix

ROOT = Path(__file__).parents[2]
SIZE = (48, 32)
OVERSAMPLING = 3  # rendered pixels for each of the image, per axis: few large launches instead of many small ones
BATCHES = 24
SPP = 8  # in each rendered pixel of each batch: 1,728 samples for each pixel

mi = pytest.importorskip("mitsuba")
# The scalar variant needs no LLVM, and takes no time to compile.
mi.set_variant("scalar_rgb")
sys.path.append(str(ROOT / "tools" / "peers"))
import mitsuba_export  # noqa: E402 (it needs a variant)


def _place(mesh: int, offset, scale=1.0, turn=(0, 0, 0, 1), shear: float = 0.0) -> tuple[int, np.ndarray]:
    """An instance. scale: one number or one for each axis, negative to mirror. turn: quaternion."""
    matrix = rotation_matrix(turn) @ np.diag(np.broadcast_to(scale, 3).astype(float))
    matrix[0, 1] += shear
    return mesh, np.column_stack([matrix, offset])


def _cornell() -> Scene:
    return load_scene(ROOT / "data" / "cornell" / "scene.toml")


def _textured() -> Scene:
    """Three cloths whose coordinates go far outside the picture, which is not square."""
    picture = np.random.default_rng(3).integers(0, 256, (3, 5, 4), dtype=np.uint8)
    textures = [Texture(mode, picture, (mode, mode)) for mode in ("repeat", "clamp", "mirror")]
    materials = [Material(t.name, (0.9, 0.7, 0.8), k) for k, t in enumerate(textures)]
    cloths = []
    for k in range(3):
        cloth = shape_mesh(grid((1.9, 1.9), (2, 3)), k)
        cloths.append(replace(cloth, uvs=cloth.uvs @ np.float32([[2.7, 0.5], [-0.4, 3.1]]) - np.float32([1.3, 0.9])))
    return lit(
        *cloths,
        camera=view((0.3, 3.6, 2.6), (0, 0, 0), 60),
        materials=materials,
        textures=textures,
        environment=(0.6, 0.7, 0.9),
        lights=[PointLight((0.5, 2.0, 0.5), (3.0, 2.5, 2.0))],
        instances=[_place(k, ((k - 1) * 2, 0.1 * k, 0), turn=(0, 0, 0.1 * (1 - k), 1)) for k in range(3)],
    )


def _emissive() -> Scene:
    """A panel that shines to both sides and reflects, and a lamp of many triangles."""
    return lit(
        floor(6),
        shape_mesh(plane((1.6, 1.2)), 1),
        ball(0.5, 2, 2),
        camera=view((0.5, 2.2, 5), (0, 0.9, 0), 50),
        materials=[grey(0.7), Material("panel", (0.5, 0.3, 0.2), emission=(1.0, 2.0, 3.0)), grey(0.0, 2.5)],
        instances=[
            (0, IDENTITY),
            _place(0, (0, 2, -2), turn=(1, 0, 0, 1)),
            _place(1, (-1.2, 1.0, -0.5), turn=(0.2, 0.1, 0.5, 1)),
            _place(2, (1.3, 0.6, 0)),
        ],
    )


def _environment() -> Scene:
    return lit(
        floor(6),
        ball(0.8, 3, 1),
        shape_mesh(box((1, 1, 1)), 2),
        camera=view((0.5, 2, 5), (0, 0.6, 0), 50),
        materials=[grey(0.6), Material("red", (0.9, 0.2, 0.1)), Material("blue", (0.1, 0.3, 0.8))],
        environment=(0.9, 1.0, 1.2),
        instances=[(0, IDENTITY), _place(1, (-0.9, 0.8, 0)), _place(2, (0.9, 0.7, 0), turn=(0.3, 0.5, 0.1, 1))],
    )


def _instances() -> Scene:
    """One mesh without symmetry, turned, stretched, sheared and mirrored, flat and smooth."""
    shape = ball(1, 3, 1, smooth=True)
    bent = shape.positions * np.float32([1, 1.3, 0.8])
    bent[:, 0] += np.float32(0.3) * bent[:, 1] ** 2
    flat = replace(shape, positions=bent, normals=None)
    return lit(
        floor(12),
        flat,
        shape,
        camera=view((0, 3, 7), (0, 0.7, 0), 50),
        materials=[grey(0.5), Material("orange", (0.9, 0.5, 0.1))],
        lights=[DirectionalLight((0.48, -0.8, -0.36), (2.0, 1.8, 1.5))],
        environment=(0.3, 0.4, 0.6),
        instances=[
            (0, IDENTITY),
            _place(1, (-2.4, 0.9, 0), 0.7, (0, 0.6, 0.3, 1)),
            _place(1, (-0.6, 1.0, 0.5), (-0.5, 0.8, 0.6)),
            _place(1, (1.2, 0.8, 0.3), (0.4, 0.5, -0.9), (0.5, 0.2, 0, 1), 0.3),
            _place(2, (2.7, 0.8, 0), (0.8, 0.4, 0.6), (0.2, 0.1, 0.7, 1), 0.3),
            _place(2, (0.6, 1.4, -2), (-1, 1.2, 0.7)),
        ],
    )


def _smooth() -> Scene:
    return lit(
        floor(6),
        ball(1, 4, 1, smooth=True),
        camera=view((0.3, 1.8, 4.5), (0, 0.9, 0), 50),
        materials=[grey(0.6), Material("green", (0.3, 0.8, 0.4))],
        lights=[PointLight((1.5, 3, 2), (14, 13, 12))],
        environment=(0.3, 0.3, 0.35),
        instances=[
            (0, IDENTITY),
            _place(1, (-1, 1, 0)),
            _place(1, (1.1, 0.6, 0.4), (0.9, 0.4, 0.6), (0.2, 0.3, 0.4, 1)),
        ],
    )


def _delta_lights() -> Scene:
    """A closed room of which the sun sees the outside only, and one that is open to it; lights of both kinds, near plane."""
    room = cube()
    return lit(
        room,
        replace(ball(0.4, 3), material=ball(0.4, 3).material + np.uint32(1)),
        floor(20),
        camera=replace(view((3.2, 1.8, 4.5), (0.8, 0.3, 0), 55), near=0.5),
        materials=[grey(0.75), Material("blue", (0.2, 0.3, 0.9))],
        lights=[
            PointLight((2.2, 2.0, 1.8), (6.0, 5.0, 3.0)),
            PointLight((0.0, 3.0, 0.5), (2.0, 4.0, 8.0)),
            DirectionalLight((-0.48, -0.6, -0.64), (1.5, 1.4, 1.0)),
        ],
        instances=[
            (0, IDENTITY),
            _place(1, (1.6, 0.4, 0.8)),
            _place(1, (0, 1.6, 0), (1, 1.5, 1)),
            (2, np.column_stack([np.eye(3), (0, -1, 0)])),
        ],
    )


SCENES: dict[str, Callable[[], Scene]] = {
    "cornell": _cornell,
    "textured": _textured,
    "emissive": _emissive,
    "environment": _environment,
    "instances": _instances,
    "smooth": _smooth,
    "delta lights": _delta_lights,
}
FINE_SIZE = tuple(side * OVERSAMPLING for side in SIZE)


@cache
def ours(name: str, bounces: int = 3, roulette: int = 64) -> list[np.ndarray]:
    """Independent renders by clcache."""
    settings = {"pathtrace.bounces": bounces, "pathtrace.roulette": roulette}
    renderer = Renderer(SCENES[name](), size=FINE_SIZE, stereo=False, spp=SPP, seed=1, settings=settings)
    return [blocks(frame.color["mono"], OVERSAMPLING) for frame in renderer.frames(0, BATCHES)]


def theirs(scene: Scene, bounces: int = 3) -> list[np.ndarray]:
    """Independent renders by Mitsuba."""
    exported = mitsuba_export.to_mitsuba(scene, FINE_SIZE, bounces=bounces)
    return [blocks(mitsuba_export.render(exported, SPP, seed), OVERSAMPLING) for seed in range(BATCHES)]


def brighter(scene: Scene, factor: float) -> Scene:
    """The scene with all of its light times the factor."""
    lights = []
    for light in scene.lights:
        power = "intensity" if isinstance(light, PointLight) else "irradiance"
        lights.append(replace(light, **{power: _times(getattr(light, power), factor)}))
    materials = tuple(replace(m, emission=_times(m.emission, factor)) for m in scene.materials)
    return replace(scene, lights=tuple(lights), materials=materials, environment=_times(scene.environment, factor))


def _times(color: tuple[float, float, float], factor: float) -> tuple[float, float, float]:
    return tuple(factor * c for c in color)


@pytest.mark.parametrize("name", SCENES)
def test_same_image(name):
    pixels, tiles = agree(ours(name), theirs(SCENES[name]()))
    assert pixels.passed, pixels
    assert tiles.passed, tiles


@pytest.mark.parametrize("name", SCENES)
def test_wrong_light_shows(name):
    pixels, tiles = agree(ours(name), theirs(brighter(SCENES[name](), 1.05)))
    assert not pixels.passed, pixels
    assert not tiles.passed, tiles


@pytest.mark.parametrize("bounces", [0, 1])
def test_depth(bounces):
    """Of a short path, too, both count the same segments."""
    pixels, tiles = agree(ours("emissive", bounces), theirs(SCENES["emissive"](), bounces))
    assert pixels.passed, pixels
    assert tiles.passed, tiles


def test_roulette_changes_nothing():
    pixels, tiles = agree(ours("environment", roulette=1), theirs(SCENES["environment"]()))
    assert pixels.passed, pixels
    assert tiles.passed, tiles


def test_noise_of_one_renderer_passes():
    """The test by itself: two halves of the same renders agree, and do no longer where one is 2 % brighter."""
    half = BATCHES // 2
    renders = ours("environment")
    assert all(verdict.passed for verdict in agree(renders[:half], renders[half:]))
    assert not agree(renders[:half], [1.02 * r for r in renders[half:]])[1].passed


def test_unlike_wrap_modes_are_refused():
    """Mitsuba has one wrap mode for both axes."""
    texture = Texture("cloth", np.zeros((2, 2, 4), np.uint8), ("repeat", "clamp"))
    scene = lit(floor(), camera=view((0, 1, 1), (0, 0, 0)), materials=[Material("m", WHITE, 0)], textures=[texture])
    with pytest.raises(SceneError, match="texture cloth: wraps"):
        mitsuba_export.to_mitsuba(scene, SIZE)
