"""The path tracer against Mitsuba 3: the same scenes, exported by clcache/experiments/mitsuba_export.py, must give the same images.

Each comparison has a twin with lights that are wrong by 5 %, which the same test must tell from the right one; and where
there is more to a light or a surface than its strength, one in which that is wrong.
"""

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
from clcache.scene.model import (
    DirectionalLight,
    Environment,
    Material,
    PointLight,
    Scene,
    SpotLight,
    Texture,
    TextureUse,
)
from clcache.scene.transform import rotation_matrix

ROOT = Path(__file__).parents[2]
SIZE = (48, 32)
OVERSAMPLING = 3  # rendered pixels for each of the image, per axis: few large launches instead of many small ones
BATCHES = 20
SPP = 8  # in each rendered pixel of each batch: 1,440 samples for each pixel

mi = pytest.importorskip("mitsuba")
# The scalar variant needs no LLVM, and takes no time to compile.
mi.set_variant("scalar_rgb")
from clcache.experiments import mitsuba_export  # noqa: E402 (it needs the package)


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
    textures = [Texture(mode, picture, wrap=(mode, mode)) for mode in ("repeat", "clamp", "mirror")]
    materials = [Material(t.name, (0.9, 0.7, 0.8), TextureUse(k)) for k, t in enumerate(textures)]
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


def _lamps() -> Scene:
    """Lamps that shine from one side and from both, matt besides, seen from either; one of them mirrored."""
    return lit(
        floor(6),
        shape_mesh(plane((1.2, 0.9)), 1),
        shape_mesh(plane((1.0, 1.2)), 2),
        camera=view((0.5, 2.2, 5), (0, 0.9, 0), 50),
        materials=[
            grey(0.7),
            Material("one side", (0.5, 0.3, 0.2), emission=(1.0, 2.0, 3.0), double_sided=False),
            Material("both sides", (0.2, 0.6, 0.3), emission=(2.0, 1.0, 0.6)),
        ],
        instances=[
            (0, IDENTITY),
            _place(0, (0, 2, -2), turn=(1, 0, 0, 1)),
            _place(1, (-1.6, 1.0, -0.4), turn=(0.6, 0.1, 0.4, 1)),
            _place(1, (-0.2, 1.5, 0.3), turn=(1, 0.1, 0.3, 0.1)),
            _place(1, (0.9, 0.7, 1.2), (-1, 1, 0.8), turn=(-0.7, 0.3, 0.2, 1)),
            _place(2, (1.7, 1.0, -0.6), (1, 1, -1), turn=(0.2, 0.1, 0.9, 1)),
        ],
    )


def _picture_lamp() -> Scene:
    """A lamp that shows a picture, turned on it, and one that shows no more than a part of the picture on both sides."""
    picture = np.random.default_rng(4).integers(0, 256, (3, 4, 4), dtype=np.uint8)
    textures = [Texture("colours", picture), Texture("plain", picture[:2, 1:], False, ("mirror", "mirror"))]
    turned = TextureUse(0, (0.0, -1.0, 1.0, 1.0, 0.0, 0.0))
    part = TextureUse(1, (0.5, 0.1, 0.2, -0.1, 0.6, 0.3))
    return lit(
        floor(6),
        shape_mesh(plane((1.4, 1.0)), 1),
        shape_mesh(plane((1.1, 1.3)), 2),
        camera=view((0.3, 2.4, 4), (0, 0.7, 0), 50),
        materials=[
            grey(0.8),
            Material("screen", (0.1, 0.1, 0.1), emission=(2.0, 3.0, 2.5), emission_texture=turned, double_sided=False),
            Material("shade", (0.4, 0.4, 0.4), emission=(1.5, 1.0, 1.2), emission_texture=part),
        ],
        textures=textures,
        instances=[
            (0, IDENTITY),
            _place(1, (-0.9, 1.0, -0.3), turn=(0.6, 0.2, 0.1, 1)),
            _place(2, (1.0, 0.9, 0), turn=(0.1, 0.1, 0.6, 1)),
        ],
    )


def _spots(outer: float = 32.0) -> Scene:
    """Cones with edges as sharp as both know them. outer: of one of them, degrees."""
    return lit(
        floor(8),
        ball(0.6, 3, 1),
        camera=view((0.3, 2.4, 5), (0, 0.6, 0), 50),
        materials=[grey(0.7), Material("red", (0.9, 0.3, 0.2))],
        lights=[
            _spot((1.2, 2.6, 1.0), (-0.5, 0.2, 0), outer, (20.0, 18.0, 12.0)),
            _spot((-2.0, 2.5, 2.5), (0.2, 0.2, -0.2), 40.0, (10.0, 14.0, 24.0)),
        ],
        instances=[(0, IDENTITY), _place(0, (0, 2, -2), turn=(1, 0, 0, 1)), _place(1, (-0.2, 0.6, 0))],
    )


def _spot(position, target, degrees: float, intensity) -> SpotLight:
    axis = np.subtract(target, position)
    outer = np.radians(degrees)
    return SpotLight(position, tuple(axis / np.linalg.norm(axis)), intensity, outer - 1e-5, outer)


def _sky_picture(turn: int = 0, sun: float = 1.0) -> Environment:
    """An uneven sky with a sun of a few pixels. turn: columns to the right. sun: its strength."""
    picture = np.random.default_rng(6).random((12, 24, 3)).astype(np.float32) ** 3 + np.float32(0.05)
    picture[3, 15:17] = sun * np.float32([60, 50, 30])
    return Environment(np.roll(picture, turn, axis=1))


def _image_sky(turn: int = 0) -> Scene:
    return replace(_environment(), environment=_sky_picture(turn))


def _mirrors() -> Scene:
    """Perfect mirrors, flat ones, each seen in the other, and double-sided or not; placed by turning and mirroring."""
    return lit(
        floor(6),
        shape_mesh(box((1, 1, 1)), 1),
        shape_mesh(plane((1.5, 1.8)), 2),
        shape_mesh(box((0.5, 0.5, 0.5)), 3),
        camera=view((0.4, 2.2, 5), (0, 0.7, 0), 50),
        materials=[
            Material("floor", (0.7, 0.5, 0.3)),
            Material("mirror", WHITE, metallic=1.0, roughness=0.0),
            Material("one side", WHITE, metallic=1.0, roughness=0.0, double_sided=False),
            Material("blue", (0.2, 0.3, 0.9)),
        ],
        lights=[DirectionalLight((-0.48, -0.8, -0.36), (1.0, 0.9, 0.7))],
        environment=_sky_picture(sun=0.02),
        instances=[
            (0, IDENTITY),
            _place(1, (-0.9, 0.8, 0), turn=(0.3, 0.5, 0.1, 1)),
            _place(1, (1.6, 0.7, -0.6), (-0.8, 1, 0.9), (0.1, 0.7, 0.2, 1), 0.2),
            _place(2, (0.4, 1.0, -1.2), turn=(1, 0.1, 0, 1)),
            _place(2, (0.3, 0.9, 0.9), (1, 1, -0.7), (0.9, 0.1, 0.2, 1)),
            _place(3, (0.4, 0.4, 0.2), turn=(0.1, 0.2, 0.1, 1)),
        ],
    )


def _rough_metal(roughness: float = 0.3) -> Scene:
    """A plate that shines, of base colour 1, seen and lit from above, where both maskings are next to 1 (see the exporter):
    a lamp, a point and the sky, so that light is found by either ray and by one alone."""
    return lit(
        floor(3),
        shape_mesh(plane((0.9, 0.7)), 1),
        camera=view((0, 3.4, 2.2), (0, 0, 0), 36),
        materials=[
            Material("plate", WHITE, metallic=1.0, roughness=roughness),
            Material("lamp", (0.0, 0.0, 0.0), emission=(3.0, 4.0, 6.0), double_sided=False),
        ],
        lights=[PointLight((1.0, 2.5, -0.5), (2.0, 1.5, 1.0))],
        environment=_sky_picture(),
        instances=[(0, IDENTITY), _place(1, (-0.3, 2.2, -1.6), turn=(1, 0, 0, 0.3))],
    )


def _glass(ior: float = 1.5) -> Scene:
    """A tinted ball of flat facets, and a turned and mirrored slab of diamond. ior: of the glass."""
    clear = {"roughness": 0.0, "transmission": 1.0, "specular": 1.0, "double_sided": False}
    return lit(
        floor(6),
        ball(0.8, 2, 1),
        shape_mesh(box((1, 1, 1)), 2),
        camera=view((0.5, 2.0, 4.6), (0, 0.7, 0), 45),
        materials=[
            Material("floor", (0.7, 0.5, 0.3)),
            Material("glass", (0.9, 1.0, 0.95), ior=ior, **clear),
            Material("diamond", WHITE, ior=2.4, **clear),
        ],
        lights=[DirectionalLight((-0.48, -0.8, -0.36), (1.0, 0.9, 0.7))],
        environment=(0.5, 0.7, 1.0),
        instances=[
            (0, IDENTITY),
            _place(1, (-0.9, 0.9, 0)),
            _place(2, (1.0, 0.8, 0.3), (-0.9, 1.1, 0.4), (0.2, 0.5, 0.1, 1)),
        ],
    )


def _rough_glass(roughness: float = 0.4) -> Scene:
    """Frosted bodies with a lamp behind them, which both the refracted ray and one to the lamp find."""
    frosted = {"transmission": 1.0, "specular": 1.0, "ior": 1.45, "double_sided": False}
    return lit(
        floor(6),
        ball(0.8, 2, 1),
        shape_mesh(box((1, 1, 1)), 2),
        shape_mesh(plane((2.6, 1.6)), 3),
        camera=view((0.5, 2.0, 4.6), (0, 0.7, 0), 45),
        materials=[
            Material("floor", (0.7, 0.5, 0.3)),
            Material("frosted", (0.9, 1.0, 0.95), roughness=roughness, **frosted),
            Material("etched", WHITE, roughness=0.7, **frosted),
            Material("lamp", (0.0, 0.0, 0.0), emission=(3.0, 2.5, 2.0)),
        ],
        environment=(0.2, 0.3, 0.5),
        instances=[
            (0, IDENTITY),
            _place(1, (-0.9, 0.9, 0)),
            _place(2, (1.0, 0.8, 0.3), (-0.9, 1.1, 0.4), (0.2, 0.5, 0.1, 1)),
            _place(3, (0, 1.2, -1.4), turn=(1, 0, 0, 1)),
        ],
    )


def _masks(aside: float = 0.1) -> Scene:
    """Fences of stripes cut out of coloured cloth, one behind the other, turned and mirrored, in light of all kinds. aside: how
    far the picture is moved on some."""
    pixels = np.random.default_rng(7).integers(60, 256, (1, 8, 4), dtype=np.uint8)
    pixels[..., 3] = [255, 0, 0, 255, 255, 0, 255, 0]
    fence = Material(
        "fence", (0.9, 0.8, 0.7), base_color_texture=TextureUse(0, (2.0, 0, aside, 0, 1, 0)), alpha_cutoff=0.5
    )
    front = replace(fence, name="front", double_sided=False)
    return lit(
        floor(6),
        shape_mesh(plane((1.8, 1.4)), 1),
        shape_mesh(plane((1.6, 1.2)), 2),
        shape_mesh(plane((1.0, 1.0)), 3),
        camera=view((0.4, 2.0, 4.6), (0, 0.7, 0), 45),
        materials=[grey(0.7), fence, front, grey(0.0, 4.0)],
        textures=[Texture("stripes", pixels)],
        lights=[PointLight((0.8, 2.2, 1.5), (4.0, 3.0, 2.0)), DirectionalLight((0.48, -0.8, -0.36), (1.0, 0.9, 0.7))],
        environment=(0.3, 0.4, 0.6),
        instances=[
            (0, IDENTITY),
            _place(1, (-0.6, 0.9, 0.5), turn=(1, 0.1, 0.2, 1)),
            _place(2, (0.6, 0.8, -0.2), (-1, 1, 1), turn=(1, 0.2, 0.5, 1)),
            _place(2, (0.5, 0.9, 0.8), (1, 1, -1), turn=(1, -0.3, 0.1, 0.8)),
            _place(1, (0, 1.6, -0.9), (1.2, 1, -0.6), turn=(0.2, 0, 0.1, 1)),
            _place(3, (-1.2, 2.4, -0.6), turn=(0.2, 0.1, 0, 1)),
        ],
    )


def _medley() -> Scene:
    """One mesh of a lamp, a mirror, glass and a fence, placed four times: turned, mirrored, stretched, sheared."""
    pixels = np.full((1, 4, 4), 255, np.uint8)
    pixels[0, ::2, 3] = 0
    walls = [shape_mesh(plane((0.8, 0.8)), k) for k in (1, 2, 4)] + [shape_mesh(box((0.4, 0.4, 0.4)), 3)]
    turns = [rotation_matrix(t) for t in ((0.7, 0, 0, 0.7), (0, 0, 0.7, 0.7), (-0.5, 0.3, 0, 0.8), (0, 0, 0, 1))]
    moves = [(0, 0, -0.6), (0.7, 0, 0), (-0.5, 0, 0.2), (0.1, 0, 0.1)]
    positions = [w.positions @ turn.T + move for w, turn, move in zip(walls, turns, moves, strict=True)]
    starts = np.cumsum([0, *(len(p) for p in positions[:-1])])
    mesh = replace(
        walls[0],
        positions=np.concatenate(positions).astype(np.float32),
        triangles=np.concatenate([w.triangles + np.uint32(k) for w, k in zip(walls, starts, strict=True)]),
        material=np.concatenate([w.material for w in walls]),
        uvs=np.concatenate([w.uvs for w in walls]),
    )
    return lit(
        floor(8),
        mesh,
        camera=view((0.4, 2.6, 5), (0, 0.7, 0), 45),
        materials=[
            grey(0.6),
            Material("lamp", (0.5, 0.5, 0.5), emission=(3.0, 2.0, 1.0), double_sided=False),
            Material("mirror", WHITE, metallic=1.0, roughness=0.0),
            Material("glass", WHITE, roughness=0.3, transmission=1.0, specular=1.0, double_sided=False),
            Material("fence", (0.3, 0.7, 0.4), base_color_texture=TextureUse(0), alpha_cutoff=0.5),
        ],
        textures=[Texture("stripes", pixels)],
        environment=_sky_picture(),
        instances=[
            (0, IDENTITY),
            _place(1, (-1.4, 0.8, 0), turn=(0, 0.6, 0.1, 1)),
            _place(1, (0.0, 0.8, 0.6), (-1, 1, 1), turn=(0.1, 0.3, 0, 1)),
            _place(1, (1.5, 0.8, 0), (1.2, -0.9, 0.8), turn=(0.1, -0.5, 0.1, 1), shear=0.3),
            _place(1, (0.2, 1.6, -1.2), (-0.8, -0.7, -1.1), turn=(0.3, 1.2, 0, 1)),
        ],
    )


# Of each scene: what makes it, and how many bounces it takes to show what it is about.
SCENES: dict[str, tuple[Callable[[], Scene], int]] = {
    "cornell": (_cornell, 3),
    "textured": (_textured, 3),
    "emissive": (_emissive, 3),
    "environment": (_environment, 3),
    "instances": (_instances, 3),
    "smooth": (_smooth, 3),
    "delta lights": (_delta_lights, 3),
    "lamps": (_lamps, 3),
    "picture lamp": (_picture_lamp, 2),
    "spots": (_spots, 1),
    "image sky": (_image_sky, 2),
    "mirrors": (_mirrors, 4),
    "rough metal": (_rough_metal, 1),
    "glass": (_glass, 6),
    "rough glass": (_rough_glass, 5),
    "masks": (_masks, 3),
    "medley": (_medley, 4),
}
# Like the scene of that name but for one thing.
WRONG: dict[str, Callable[[], Scene]] = {
    "lamps": lambda: _with_materials(_lamps(), double_sided=True),
    "picture lamp": lambda: _with_materials(_picture_lamp(), emission_texture=TextureUse(0)),
    "spots": lambda: _spots(30.0),
    "image sky": lambda: _image_sky(1),
    "mirrors": lambda: _with_materials(_mirrors(), double_sided=True),
    "rough metal": lambda: _rough_metal(0.33),
    "glass": lambda: _glass(1.45),
    "rough glass": lambda: _rough_glass(0.5),
    "masks": lambda: _masks(0.15),
    "medley": lambda: replace(_medley(), environment=_sky_picture(2)),
}
FINE_SIZE = tuple(side * OVERSAMPLING for side in SIZE)


def _with_materials(scene: Scene, **changes: object) -> Scene:
    """The changes in all materials that have something else there."""
    kept = [all(getattr(m, name) in (None, (), value) for name, value in changes.items()) for m in scene.materials]
    changed = [m if same else replace(m, **changes) for m, same in zip(scene.materials, kept, strict=True)]
    return replace(scene, materials=tuple(changed))


@cache
def ours(name: str, bounces: int | None = None, roulette: int = 64) -> list[np.ndarray]:
    """Independent renders by clcache."""
    make, usual = SCENES[name]
    settings = {"pathtrace.bounces": usual if bounces is None else bounces, "pathtrace.roulette": roulette}
    renderer = Renderer(make(), size=FINE_SIZE, stereo=False, spp=SPP, seed=1, settings=settings)
    return [blocks(frame.color["mono"], OVERSAMPLING) for frame in renderer.frames(0, BATCHES)]


@cache
def theirs(name: str, bounces: int | None = None) -> list[np.ndarray]:
    """Independent renders by Mitsuba."""
    make, usual = SCENES[name]
    return by_mitsuba(make(), usual if bounces is None else bounces)


def by_mitsuba(scene: Scene, bounces: int, batches: int = BATCHES) -> list[np.ndarray]:
    """Independent renders of any scene."""
    exported = mitsuba_export.to_mitsuba(scene, FINE_SIZE, bounces=bounces)
    return [blocks(mitsuba_export.render(exported, SPP, seed), OVERSAMPLING) for seed in range(batches)]


@pytest.mark.parametrize("name", SCENES)
def test_same_image(name):
    pixels, tiles = agree(ours(name), theirs(name))
    assert pixels.passed, pixels
    assert tiles.passed, tiles


@pytest.mark.parametrize("name", SCENES)
def test_wrong_light_shows(name):
    """All of the light 5 % stronger: as linear as light is, that is the image times 1.05."""
    pixels, tiles = agree(ours(name), [1.05 * r for r in theirs(name)])
    assert not pixels.passed, pixels
    assert not tiles.passed, tiles


@pytest.mark.parametrize("name", WRONG)
def test_wrong_scene_shows(name):
    half = BATCHES // 2
    pixels, tiles = agree(ours(name)[:half], by_mitsuba(WRONG[name](), SCENES[name][1], half))
    assert not pixels.passed, pixels
    assert not tiles.passed, tiles


@pytest.mark.parametrize("bounces", [0, 1])
def test_depth(bounces):
    """Of a short path, too, both count the same segments."""
    pixels, tiles = agree(ours("emissive", bounces), theirs("emissive", bounces))
    assert pixels.passed, pixels
    assert tiles.passed, tiles


def test_roulette_changes_nothing():
    pixels, tiles = agree(ours("environment", roulette=1), theirs("environment"))
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
    texture = Texture("cloth", np.zeros((2, 2, 4), np.uint8), wrap=("repeat", "clamp"))
    scene = lit(
        floor(), camera=view((0, 1, 1), (0, 0, 0)), materials=[Material("m", WHITE, TextureUse(0))], textures=[texture]
    )
    with pytest.raises(SceneError, match="texture cloth: wraps"):
        mitsuba_export.to_mitsuba(scene, SIZE)
