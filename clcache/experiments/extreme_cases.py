"""The extremes at which numbers are tested, each declared once: what is fed, what comes out, what should, and by how
much it may differ.

Every line of the list is a group of cases (LINES). A case runs one method at one extreme; what it returns is compared
with a closed form, with NumPy's double precision, or with the same scene at an ordinary scale or place where that must
change nothing. The error is relative, the largest of all pixels, channels, eyes and frames, unless a case says
otherwise; where a clear refusal is right, anything else is wrong.
"""

import functools
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pyopencl.array as cl_array

from .. import renderer as renderer_module
from ..bvh.tracer import MISS, Tracer
from ..device import Device
from ..errors import Error, SceneError
from ..renderer import Frame, Renderer
from ..scene import load_scene
from ..scene.model import Material, PointLight, Scene, Texture, TextureUse
from .extreme_scenes import (
    ABOVE,
    ALBEDO,
    ALL,
    CACHES,
    FILTERS,
    MEMOS,
    METHODS,
    OTHER_ALBEDO,
    WAYS,
    at,
    ball,
    floor,
    ground,
    lamp,
    made_for,
    mesh,
    needles,
    scaled,
    scene,
    still_life,
    tilted,
    two_grounds,
    view,
    with_degenerate,
)
from .job import Machine

LARGEST_HALF = 65504.0
LEAST_NORMAL_HALF = 2.0**-14
HALF_ROUNDING = 2.0**-11
HUGE = 3e38
FRAMES = 10000  # of static ones, at real size
SIZE = (16, 9)

ROUNDING = "rounding of float32 in the few sums and products between a light and a pixel"
IN_HALF = "cells keep half precision: 11 bits, and steps of 2^-24 below 2^-14"


@dataclass(frozen=True)
class Bench:
    """What cases run on. frames: static ones, of the cases that take as many as can be."""

    machine: Machine
    frames: int = FRAMES


@dataclass(frozen=True)
class Found:
    """What came out of a case, and what was expected, in words; how far they are apart, or None if they cannot be
    compared. refused: it was refused, with a clear error, which is `came`."""

    came: str
    expected: str
    error: float | None
    refused: bool = False


@dataclass(frozen=True)
class Case:
    """An extreme. line: of the list. name: tells it from the line's others. method: of what. fed: in words. tolerance:
    of the error, and its reason. refused: whether it is to be refused."""

    line: str
    name: str
    method: str
    fed: str
    run: Callable[[Bench], Found]
    tolerance: float
    reason: str
    refused: bool = False

    def verdict(self, found: Found) -> str:
        """right, refused (where that is right) or wrong."""
        if self.refused:
            return "refused" if found.refused else "wrong"
        is_right = not found.refused and found.error is not None and found.error <= self.tolerance
        return "right" if is_right else "wrong"


# ---------------------------------------------------------------------------------------------------------------------
# Comparing


class one_device:
    """Within the `with`, renderers that ask for the same device get the same one, and what one has compiled serves the
    others."""

    def __enter__(self) -> None:
        self._device = renderer_module.Device
        renderer_module.Device = functools.cache(Device)

    def __exit__(self, *_: object) -> None:
        renderer_module.Device = self._device


def relative(found: np.ndarray, expected: np.ndarray | float, least: float = 0.0) -> float:
    """The largest error, relative to what is expected, or to `least` where that is more; of what is expected to be 0
    itself."""
    found = np.asarray(found, np.float64)
    expected = np.broadcast_to(np.asarray(expected, np.float64), found.shape)
    scale = np.maximum(np.abs(expected), least)
    error = np.abs(found - expected) / np.where(scale > 0, scale, 1.0)
    return float(error.max()) if np.isfinite(found).all() and found.size else np.inf


def in_words(values: np.ndarray) -> str:
    """The least and the most of some numbers."""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.7g}" if low == high else f"{low:.7g} .. {high:.7g}"


def compared(found: np.ndarray, expected: np.ndarray | float, least: float = 0.0, also: str = "") -> Found:
    """Numbers with what they should be."""
    error = relative(found, expected, least)
    return Found(in_words(found) + also, in_words(expected), error if np.isfinite(error) else None)


def colors_of(frame: Frame) -> np.ndarray:
    """(eyes, H, W, 3)."""
    return np.stack(list(frame.color.values()))


def opened(way_name: str, made: Callable[[], Scene], bench: Bench, size=SIZE, settings: Mapping | None = None,
           stereo: bool | None = None, **own: object) -> Renderer:  # fmt: skip
    """A renderer of one of WAYS."""
    way = WAYS[way_name]
    way = replace(way, settings={**way.settings, **(settings or {})}, spp=own.pop("spp", way.spp))
    two = way.stereo_blend != "none" if stereo is None else stereo
    machine = bench.machine
    return way.renderer(made_for(way, made), size, two, own.pop("seed", 1), machine.device, machine.threads, **own)


# ---------------------------------------------------------------------------------------------------------------------
# Cases of which the whole picture is known


@dataclass(frozen=True)
class Shown:
    """A scene that is rendered in several ways, all pixels of which are as bright as expected, in all frames or in
    each.

    first_row: of the image, of those that are compared. before: what is done to a renderer before its first frame.
    in_cells: whether the octree's cells keep what is seen, and it does not shine by itself; then the tolerance is theirs,
    if what is expected is no half.
    """

    line: str
    name: str
    fed: str
    make: Callable[[], Scene]
    ways: Sequence[str] = ALL
    expected: float | Sequence[float] = ALBEDO
    frames: tuple[int, int] = (0, 3)
    size: tuple[int, int] = SIZE
    first_row: int = 0
    settings: Mapping[str, object] = field(default_factory=dict)
    stereo: bool | None = None
    before: Callable[[Renderer], None] | None = None
    in_cells: bool = True
    tolerance: float = 1e-5
    reason: str = ROUNDING

    def cases(self) -> Iterator[Case]:
        """One for each way."""
        for way in self.ways:
            is_rounded = self._is_in_cells(way) and self.tolerance < HALF_ROUNDING and not self._is_half
            tolerance, reason = (2 * HALF_ROUNDING, IN_HALF) if is_rounded else (self.tolerance, self.reason)
            run = functools.partial(self._run, way)
            yield Case(self.line, self.name, way, self.fed, run, tolerance, reason)

    def _is_in_cells(self, way: str) -> bool:
        return way == "octree" and self.in_cells

    @property
    def _each(self) -> np.ndarray:
        count = self.frames[1] - self.frames[0]
        return np.broadcast_to(np.asarray(self.expected, np.float64), count)

    @property
    def _is_half(self) -> bool:
        with np.errstate(over="ignore"):
            return bool((self._each.astype(np.float16) == self._each).all())

    def _run(self, way: str, bench: Bench) -> Found:
        renderer = opened(way, self.make, bench, self.size, self.settings, self.stereo)
        if self.before:
            self.before(renderer)
        pictures = np.stack([colors_of(f)[:, self.first_row :] for f in renderer.frames(*self.frames)])
        expected = self._each.reshape(-1, 1, 1, 1, 1)
        least = LEAST_NORMAL_HALF if self._is_in_cells(way) else 0.0
        error = relative(pictures, expected, least)
        finite = np.isfinite(error)
        return Found(in_words(pictures), in_words(self._each), error if finite else None)


def _scale(scale: float) -> Callable[[], Scene]:
    return lambda: scaled(ground(), scale)


def _far(distance: float) -> Callable[[], Scene]:
    """A place as wide as float32 has room there."""
    place, size = np.array([distance, 0, -distance]), 2e-3 * distance
    cameras = [view(place + [0.01 * size * k, size, 0.1 * size], place + [0.01 * size * k, 0, 0]) for k in range(4)]
    return lambda: scene(floor(1.0), camera=cameras, places=[at(place, 20 * size)])


def _grazing() -> Scene:
    cameras = [view((0, 1e-3, -1e-4 * k), (0, 1e-3, -10), 0.2) for k in range(4)]
    return ground(20, camera=cameras)


def _lit_at(sine: float) -> Callable[[], Scene]:
    from ..scene.model import DirectionalLight

    light = DirectionalLight((float(np.sqrt(1 - sine**2)), -sine, 0.0), (np.pi,) * 3)
    return lambda: ground(lights=[light])


def _needles() -> Scene:
    width = 1e-5
    return scene(
        needles(width), camera=view((0.3, 10 * width, 0), (0.3, 0, 0), 20, up=(1, 0, 0)), eye_distance=2 * width
    )


def _cut() -> Scene:
    """From one ground to another, far away, and back."""
    there = view((500, 23, 0.1), (500, 20, 0))
    return two_grounds((0, 0, 0), (500, 20, 0), 20, [ABOVE] * 3 + [there] * 2 + [ABOVE] * 2)


def _half_turn() -> Scene:
    """From what lies ahead to what lies behind, and back."""
    ahead, behind = view((0, 2, 0), (0, 0, -2), 30), view((0, 2, 0), (0, 0, 2), 30)
    return two_grounds((0, 0, -50), (0, 0, 50), 100, [ahead] * 3 + [behind] * 2 + [ahead] * 2)


_THERE_AND_BACK = (ALBEDO,) * 3 + (OTHER_ALBEDO,) * 2 + (ALBEDO,) * 2


def _furnace(near: float) -> Callable[[], Scene]:
    """A white ball under a white sky, from without, or its far half from within, which no light reaches."""
    white = Material("white", (1.0, 1.0, 1.0))
    camera = view((0, 0, 3), (0, 0, 0), 10, near=near)
    return lambda: scene(ball(1, 3), camera=camera, materials=[white, white], lights=[], environment=1.0)


def _crowding() -> Scene:
    """The camera backs away a hundredfold: all samples fall into two pixels."""
    cameras = [view((0, h, 0.03 * h), (0, 0, 0)) for h in (3, 3, 3, 3, 300, 300, 300)]
    return ground(1e4, camera=cameras)


def _one_place() -> Scene:
    """All of the image is the same voxel, cell and texel."""
    one = floor(20)
    return scene(replace(one, uvs=one.uvs * np.float32(0)), camera=view((0.4, 3, 0.4), (0.4, 0, 0.401), 1e-3))


def _one_cell() -> Scene:
    """A chip far from a grain: each smaller than any cell."""
    camera = view((0, 1e-3, 1e-5), (0, 0, 0), 10)
    return scene(floor(4e-3), floor(4e-3), camera=camera, places=[at((0, 0, 0)), at((3, 0, 0))], eye_distance=1e-5)


def _updates_at(number: int) -> Callable[[Renderer], None]:
    def set_updates(renderer: Renderer) -> None:
        renderer._updates = dict.fromkeys(renderer.eyes, number)

    return set_updates


def _with_uvs(scale: float, offset: float = 0.0) -> Callable[[], Scene]:
    def make() -> Scene:
        one = floor(20)
        return scene(replace(one, uvs=(one.uvs * np.float32(scale) + np.float32(offset)).astype(np.float32)))

    return make


def _wall(albedo: float, emission: float) -> Material:
    return Material("wall", (albedo,) * 3, emission=(emission,) * 3)


def _two_rooms(emission: float) -> Callable[[], Scene]:
    """Two closed black rooms with shining walls, 1e8 and 1e-8, seen from within one of them."""
    x = -2.0 if emission > 1 else 2.0
    camera = view((x, 0, 0), (x, 0.3, 1), 50)
    materials = [_wall(0.0, 1e8), _wall(0.0, 1e-8)]
    return lambda: scene(
        ball(1, 2), ball(1, 2, 1), camera=camera, materials=materials, lights=[], places=[at((-2, 0, 0)), at((2, 0, 0))]
    )


_GROUP_SIZES = ((1, 1), (3, 5), (1, 97), (65, 1), (13, 11))

SHOWN = (
    *(
        Shown("scale", f"ground at {s:g}", f"ground and camera at {s:g} times their size", _scale(s))
        for s in (1e-6, 1e6)
    ),
    *(
        Shown("far", f"at {d:g} m", f"ground seen at ({d:g}, 0, -{d:g}) m, where float32 has steps of {d * 2e-7:.1g} m",
              _far(d), frames=(0, 4))
        for d in (1e4, 1e6)
    ),
    *(
        Shown("scale", f"tilted ground at {s:g}", f"ground askew to all axes, at {s:g} times its size",
              lambda s=s: scaled(tilted(ground()), s))
        for s in (1e-6, 1e6)
    ),
    *(
        Shown("far", f"tilted, at {d:g} m",
              f"the same askew to all axes, {d:g} m away: hits are rounded, and shade themselves if"
              " that is not seen to",
              lambda d=d: tilted(_far(d)()), frames=(0, 4))
        for d in (1e4, 1e6)
    ),
    Shown("grazing", "view", "a camera 1 mm above the ground, looking along it, 0.2 degrees wide", _grazing,
          frames=(0, 4), first_row=7),
    *(
        Shown("grazing", f"light at {s:g}", f"sunlight that meets the ground at a sine of {s:g}", _lit_at(s),
              expected=ALBEDO * max(s, 0.0))
        for s in (1e-3, 1e-6, 0.0, -1e-6)
    ),
    Shown("triangles", "no area, duplicates", "ground of triangles that are there twice, among points and lines",
          lambda: scene(with_degenerate(floor(20)))),
    Shown("triangles", "needles", "ground of triangles 1 m long and 10 micrometres wide", _needles,
          tolerance=1e-3, reason="a needle's normal is that of corners that float32 has to 6e-8 of 1 m"),
    *(
        Shown("coordinates", f"uv of {s:g}", f"texture coordinates of 0 .. {s:g} for the graph of a material",
              _with_uvs(s), ways=MEMOS)
        for s in (1e7, -1e7, -3.0, 1e30)
    ),
    *(
        Shown("albedo", f"{a:g}", f"ground of albedo {a:g}", functools.partial(ground, albedos=(a, a)),
              ways=METHODS + FILTERS, expected=a)
        for a in (0.0, 1.0)
    ),
    Shown("albedo", "0, demodulated", "ground of albedo 0, radiance being kept without albedo",
          functools.partial(ground, albedos=(0.0, 0.0)), ways=("samplecache", "isrt", "stereo samples"), expected=0.0,
          settings={"samplecache.demodulate": True}),
    *(
        Shown("lights", f"{p:g} beside {1 / p:g}", f"within a black room with walls of {p:g}, beside one of {1 / p:g}",
              _two_rooms(p), ways=METHODS + FILTERS, expected=p, in_cells=False)
        for p in (1e8, 1e-8)
    ),
    *(
        Shown("lights", f"sun of {p:g}", f"ground under a sun of {p:g} times pi W / m^2",
              functools.partial(ground, power=p), ways=tuple(w for w in ALL if w != "octree"), expected=ALBEDO * p)
        for p in (1e-30, 1e-8, 1e8, 1e30)
    ),
    *(
        Shown("sizes", f"{w}x{h}", f"an image of {w} x {h}", functools.partial(ground, 400.0), size=(w, h))
        for w, h in _GROUP_SIZES
    ),
    Shown("near plane", "in the open", "a white ball under a white sky, near plane at 0", _furnace(0.0),
          ways=METHODS + FILTERS, expected=1.0),
    Shown("near plane", "within", "the same, near plane through the middle of the ball: its dark inside", _furnace(3.0),
          ways=METHODS + FILTERS, expected=0.0),
    *(
        Shown("eyes", f"{d:g} m apart", f"two eyes, {d:g} m apart, over ground, the camera moving",
              functools.partial(ground, 100.0, eye_distance=d,
                                camera=[view((0.1 * k, 3, 0.1), (0.1 * k, 0, 0)) for k in range(3)]), stereo=True)
        for d in (0.0, 10.0)
    ),
    Shown("cuts", "cut", "the camera jumps 500 m to ground of another albedo, and back", _cut,
          expected=_THERE_AND_BACK, frames=(0, 7), ways=CACHES + MEMOS + FILTERS),
    Shown("cuts", "180 degrees", "the camera turns round to ground of another albedo, and back", _half_turn,
          expected=_THERE_AND_BACK, frames=(0, 7), ways=CACHES + MEMOS + FILTERS),
    Shown("contention", "two pixels", "the camera backs away a hundredfold: all samples fall into two pixels' slots",
          _crowding, ways=CACHES + FILTERS, frames=(0, 7)),
    *(
        Shown("contention", f"two pixels, {v}", f"the same, slots being given {v}", _crowding,
              ways=("samplecache",), frames=(0, 7), settings={"samplecache.reprojection": v})
        for v in ("single-pass", "two-pass")
    ),
    Shown("contention", "one entry", "an image within a single voxel, cell and texel: all paths want the same entry",
          _one_place, ways=("voxelhash", "hybrid", "octree", *MEMOS),
          settings={"voxelhash.level_bias": 8.0, "voxelhash.gate": False, "octree.gate": False}),
    Shown("tables", "one slot", "one slot for a pixel's samples", ground, ways=("samplecache", "stereo samples"),
          settings={"samplecache.slots": 1, "samplecache.target": 1.0}),
    Shown("tables", "superresolution of 1", "one cell in a pixel", ground, ways=("isrt",),
          settings={"isrt.superresolution": 1}),
    Shown("tables", "all in one cell", "a scene of two chips, each within one cell", _one_cell, ways=("octree",),
          settings={"octree.gate": False}),
    Shown("counters", "frames at 2^32 - 1", "frames 2^32 - 2 .. 2^32", ground, frames=(2**32 - 2, 2**32 + 1)),
    Shown("counters", "updates at 2^32 - 1", "caches that have been updated 2^32 - 2 times", ground,
          ways=CACHES, before=_updates_at(2**32 - 2), frames=(0, 4)),
    Shown("counters", "updates at 2^31", "caches that have been updated 2^31 - 2 times: where voxels' stamps wrap",
          ground, ways=CACHES, before=_updates_at(2**31 - 2), frames=(0, 4)),
    *(
        Shown("half", f"light of {p:g}", f"cells that are to keep {p:g}", functools.partial(ground, power=p),
              ways=("octree",), expected=ALBEDO * min(p, LARGEST_HALF), tolerance=1e-6,
              reason="the largest half, 65504, is exact")
        for p in (65504.0, 65519.0, 65520.0, 1e8, 1e30)
    ),
    Shown("variance", "constant 1e6", "an even image of 1e6", functools.partial(ground, power=2e6),
          ways=tuple(w for w in ALL if w != "octree"), expected=1e6, tolerance=1e-6),
)  # fmt: skip


# ---------------------------------------------------------------------------------------------------------------------
# Cases of their own


def _same_at(scale: float, way: str, bench: Bench) -> Found:
    """A scene at two scales, powers of two being exact."""
    usual, other = (
        np.stack([colors_of(f) for f in opened(way, make, bench).frames(0, 3)])
        for make in (still_life, lambda: scaled(still_life(), scale))
    )
    if way in ("voxelhash", "hybrid"):  # other levels have other hashes, and so other neighbours
        return compared(np.mean(other), float(np.mean(usual)))
    return compared(other, usual)


def _scales() -> Iterator[Case]:
    for way in METHODS + FILTERS:
        hashed = way in ("voxelhash", "hybrid")
        for power in (-20, 20):
            yield Case(
                "scale", f"still life at 2^{power}", way, f"balls under sun and sky at 2^{power} times their size",
                functools.partial(_same_at, 2.0**power, way), 0.03 if hashed else 0.0,
                "another level of voxels draws other numbers: the mean, by its noise" if hashed
                else "powers of two are exact: the same bits",
            )  # fmt: skip


def _texture(size: int = 4) -> Texture:
    pixels = np.random.default_rng(5).integers(64, 256, (size, size, 4), dtype=np.uint8)
    return Texture("speckled", pixels, srgb=False)


def _textured(scale: float, offset: float) -> Callable[[], Scene]:
    def make() -> Scene:
        white = Material("white", (1.0, 1.0, 1.0), base_color_texture=TextureUse(0))
        made = replace(_with_uvs(scale, offset)(), materials=(white, white))
        return replace(made, textures=(_texture(),))

    return make


def _coordinates(way: str, scale: float, offset: float, bench: Bench) -> Found:
    pixels = _texture().pixels[..., :3] / 255.0
    (frame,) = opened(way, _textured(scale, offset), bench).frames(0, 1)
    found = colors_of(frame)
    if abs(scale) > 1e6:
        return compared(found, pixels.mean(axis=(0, 1)))
    if abs(offset) > 1e6:
        return compared(found, pixels[[0, 0, -1, -1], [0, -1, 0, -1]].mean(axis=0))
    (usual,) = opened(way, _textured(scale, 0.0), bench).frames(0, 1)
    return compared(found, colors_of(usual))


def _texture_coordinates() -> Iterator[Case]:
    told = (
        (1e7, 0.0, 0.01, "mip levels are of 8 bits", "the picture's mean"),
        (-1e7, 0.0, 0.01, "mip levels are of 8 bits", "the picture's mean"),
        (1.0, 1e7, 2e-3, "whole numbers are all that there is: the mean of four texels", "four texels' mean"),
        (1.0, -5.0, 2e-3, "coordinates are rounded at 5 and not at 1", "as without the 5"),
    )
    for way in METHODS:
        for scale, offset, tolerance, reason, _ in told:
            yield Case(
                "coordinates", f"texture at {scale:g} {offset:+g}", way,
                f"a texture by coordinates of 0 .. {scale:g}, plus {offset:g}",
                functools.partial(_coordinates, way, scale, offset), tolerance, reason,
            )  # fmt: skip


def _rough(way: str, roughness: float, bench: Bench) -> Found:
    """Under an even sky of 1. GGX at alpha = 1 has the density 1 / pi for all microfacet normals, so that what it
    reflects upwards is the integral of G / (4 pi) over the directions above, G being 2 z / (1 + z): 1 - ln 2."""
    metal = Material("metal", (1.0, 1.0, 1.0), metallic=1.0, roughness=roughness, specular=1.0)
    make = functools.partial(
        scene, floor(100), camera=view((0, 3, 0), (0, 0, 0), 1, up=(1, 0, 0)), materials=[metal, metal], lights=[],
        environment=1.0,
    )  # fmt: skip
    spp = 32 if roughness else 1
    (frame,) = opened(way, make, bench, spp=spp).frames(0, 1)
    color = colors_of(frame)
    return compared(color, 1.0) if roughness == 0 else compared(np.mean(color), 1 - np.log(2))


def _roughness() -> Iterator[Case]:
    for way in METHODS:
        yield Case(
            "roughness", "0", way, "a white mirror under a white sky",
            functools.partial(_rough, way, 0.0), 1e-5, ROUNDING,
        )  # fmt: skip
        yield Case(
            "roughness", "1", way,
            "white metal of roughness 1 under a white sky, from above: the image's mean; GGX's integral is 1 - ln 2",
            functools.partial(_rough, way, 1.0), 0.005 if way == "pathtrace" else 0.08,
            "noise; caches keep fewer samples of what is glossy",
        )  # fmt: skip


def _closed(way: str, albedo: float, bench: Bench) -> Found:
    """A closed room that shines by 1: one for each bounce that its walls reflect."""
    make = functools.partial(
        scene, ball(2, 2), camera=view((0, 0, 0), (0, 0, -1)), materials=[_wall(albedo, 1.0)] * 2, lights=[]
    )
    settings = {"pathtrace.bounces": 8, "pathtrace.roulette": 64}
    (frame,) = opened(way, make, bench, settings=settings, spp=8).frames(0, 1)
    return compared(np.mean(colors_of(frame)), 10.0 if albedo else 1.0)


def _closed_rooms() -> Iterator[Case]:
    for way in METHODS:
        for albedo in (0.0, 1.0):
            yield Case(
                "albedo", f"closed room of {albedo:g}", way,
                f"walls that emit 1 and reflect {albedo:g} of it, for eight bounces: the image's mean",
                functools.partial(_closed, way, albedo), 0.02 if albedo else 1e-5,
                "noise of the paths" if albedo else ROUNDING,
            )  # fmt: skip


def _two_lights(way: str, height: float, bench: Bench) -> Found:
    """A weak lamp above, and a strong one below the ground or above: nine samples in ten go to the strong one, and half
    of the rest."""
    lights = [PointLight((0, 2, 0), (1e-8,) * 3), PointLight((0, height, 0), (1e8,) * 3)]
    spp = 1024 if way == "pathtrace" else 64
    make = functools.partial(
        scene, floor(30), camera=view((0, 3, 0.1), (0, 0, 0), 0.1), albedos=(1.0, 1.0), lights=lights
    )
    (frame,) = opened(way, make, bench, size=(8, 8), spp=spp).frames(0, 1)
    expected = (1e8 if height > 0 else 1e-8) / (4 * np.pi)
    return compared(np.mean(colors_of(frame), dtype=np.float64), expected)


def _lamps() -> Iterator[Case]:
    for way in ("pathtrace", "samplecache", "isrt"):
        samples = 64 * (1024 if way == "pathtrace" else 64)
        for height, what in ((-2.0, "below the ground, which it does not reach"), (2.0, "beside it")):
            tolerance = 4.5 * float(np.sqrt((19 if height < 0 else 1 / 19) / samples))
            yield Case(
                "lights", f"lamps, strong one {'below' if height < 0 else 'above'}", way,
                f"a lamp of 1e-8 above the ground, one of 1e8 {what}: the mean",
                functools.partial(_two_lights, way, height), tolerance,
                "noise of the choice between them, 4.5 standard deviations",
            )  # fmt: skip


def _static(way: str, size: tuple[int, int], bench: Bench) -> Found:
    """So many updates of a still view: each count where it ends, and the mean where it was."""
    if way in FILTERS + MEMOS:
        *_, frame = opened(way, ground, bench, size).frames(0, bench.frames)
    else:
        (frame,) = opened(way, ground, bench, size, spp=bench.frames).frames(0, 1)
    return compared(colors_of(frame), ALBEDO, also=f" after {bench.frames:,}")


def _static_views() -> Iterator[Case]:
    for way in CACHES + FILTERS + MEMOS:
        yield Case(
            "static", f"{FRAMES:,} frames", way, f"{FRAMES:,} frames of still ground, of 1 x 1 pixels",
            functools.partial(_static, way, (1, 1)), 1e-5, ROUNDING,
        )  # fmt: skip
    yield Case(
        "static", "mean of 65,536", "pathtrace", "65,536 samples of 0.1 in a pixel", _many_samples, 5e-7,
        "a plain sum of float32 would be off by 1e-4",
    )  # fmt: skip
    for way in ("samplecache", "isrt"):
        yield Case(
            "static", "counts at their end", way, "samples whose counts and ages are 65,530, for 64 frames more",
            functools.partial(_full_counts, way), 1e-5, ROUNDING,
        )  # fmt: skip


def _many_samples(bench: Bench) -> Found:
    room = functools.partial(
        scene, ball(1, 1), camera=view((0, 0, 0), (0, 0.3, 1), 50), materials=[_wall(0.0, 0.1)] * 2, lights=[]
    )
    (frame,) = opened("pathtrace", room, bench, (1, 1), spp=65536 if bench.frames == FRAMES else 1024).frames(0, 1)
    return compared(colors_of(frame), 0.1)


def _full_counts(way: str, bench: Bench) -> Found:
    """A count stops at 65534, for the next says that a sample is background, an age at 65535; neither runs into the
    other."""
    renderer = opened(way, ground, bench, (3, 5))
    list(renderer.frames(0, 8))
    shading: cl_array.Array = renderer._graph.of()["shading"]
    words = shading.get()
    words[..., 3] = 65530 | 65530 << 16
    shading.set(words)
    *_, frame = renderer.frames(8, 72)
    slots = words.shape[0]
    occupied = (renderer._graph.of()["mask"].get()[:, 0] >> np.arange(slots, dtype=np.uint32)[:, None] & 1).astype(bool)
    ends = renderer._graph.of()["shading"].get()[..., 3][occupied]
    counted, aged = ends & 0xFFFF, ends >> 16
    is_full = (counted == 65534).all() and (aged == 65535).all()
    found = compared(colors_of(frame), ALBEDO, also=f"; counts {in_words(counted)}, ages {in_words(aged)}")
    return found if is_full else replace(found, error=None)


def _filled(way: str, settings: Mapping[str, object], counter: str, bench: Bench) -> Found:
    """A table that is full: what is seen is right all the same."""
    renderer = opened(way, still_life if counter == "cache" else _many_texels, bench, settings=settings)
    plain = {"voxelhash": "pathtrace", "hybrid": "pathtrace"}.get(way)
    *_, frame = renderer.frames(0, 6)
    found = frame.stats["eyes"]["mono"][counter]
    occupied = found.get("voxels", found["occupied"])  # of hybrid, which occupies slots as well
    also = f"; {occupied} of {found['capacity']} entries, {found['discarded']} discarded"
    is_full = occupied == found["capacity"]
    if plain is None:
        result = compared(colors_of(frame), ALBEDO, also=also)
    else:
        (truth,) = opened(plain, still_life, bench, spp=256).frames(5, 6)
        result = compared(np.mean(colors_of(frame)), float(np.mean(colors_of(truth))), also=also)
    return result if is_full else replace(result, error=None)


def _many_texels() -> Scene:
    """Ground of many texels of each level."""
    return ground(20.0)


def _full_tables() -> Iterator[Case]:
    for way in ("voxelhash", "hybrid"):
        for capacity in (1, 16):
            settings = {"voxelhash.capacity": capacity, "voxelhash.probe": 64}
            yield Case(
                "tables", f"{capacity} entries, full", way, f"balls under sun and sky, a table of {capacity}: the mean",
                functools.partial(_filled, way, settings, "cache"), 0.06,
                "noise of what finds no place, and is traced for itself",
            )  # fmt: skip
    for way in MEMOS:
        for capacity, eviction in ((1, "none"), (1, "lru-counter"), (8, "none"), (8, "random")):
            settings = {"memo.capacity": capacity, "memo.eviction": eviction}
            yield Case(
                "tables", f"{capacity} entries, eviction {eviction}", way,
                f"ground of many texels, a table of {capacity}, of which {eviction} are evicted",
                functools.partial(_filled, way, settings, "memo"), 1e-6, ROUNDING,
            )  # fmt: skip


_HEIGHTS = 0.5 * 4.0 ** np.arange(6)  # metres, of which each has a camera for two frames


def _levels(way: str, scale: float, settings: Mapping[str, object], is_found: bool, bench: Bench) -> Found:
    """Ground 1 km wide, seen from half a metre up to half a kilometre: all levels between, each as bright. is_found:
    whether many lookups of each second frame are to find an entry; what is much finer than a pixel is seen once
    only."""

    def make() -> Scene:
        cameras = [view((0, h, 0.03 * h), (0, 0, 0)) for h in np.repeat(_HEIGHTS, 2)]
        return scaled(ground(1000, camera=cameras), scale)

    has_level = way in ("voxelhash", "octree")
    renderer = opened(way, make, bench, (9, 9), settings, aovs=("level",) if has_level else ())
    pictures, levels, hits, lookups = [], set(), 0, 0
    for frame in renderer.frames(0, 2 * len(_HEIGHTS)):
        pictures.append(colors_of(frame))
        if has_level:
            seen = np.unique(frame.aov("level", "mono"))
            levels |= set(seen[np.isfinite(seen)].astype(int).tolist())
        if frame.number % 2:
            counts = frame.stats["eyes"]["mono"]["memo" if way in MEMOS else "cache"]
            hits, lookups = hits + counts["hits"], lookups + counts["lookups"]
    named = f"; levels {min(levels)} .. {max(levels)}, {len(levels)} of them" if levels else ""
    found = compared(np.stack(pictures), ALBEDO, also=f"{named}; {hits} of {lookups} found")
    return found if not is_found or hits > 0.3 * lookups else replace(found, error=None)


def _all_levels() -> Iterator[Case]:
    for way in ("voxelhash", "hybrid"):
        for power, bias in ((-20, -8.0), (-20, 0.0), (0, 0.0), (20, 0.0), (20, 8.0)):
            settings = {"voxelhash.level_bias": bias, "voxelhash.capacity": 2**16, "voxelhash.gate": False}
            yield Case(
                "levels", f"voxels at 2^{power}, bias {bias:g}", way,
                f"ground from 0.5 to 512 m away at 2^{power} times its size, voxels of levels {bias:+g}",
                functools.partial(_levels, way, 2.0**power, settings, bias >= 0), 1e-5, ROUNDING,
            )  # fmt: skip
    for bias in (-4.0, 0.0, 4.0):
        settings = {"octree.level_bias": bias, "octree.resolution": 1024, "octree.samples": 1, "octree.gate": False}
        yield Case(
            "levels", f"cells, bias {bias:g}", "octree", f"the same, cells of levels {bias:+g}, 1024 along an edge",
            functools.partial(_levels, "octree", 1.0, settings, True), 1e-5, ROUNDING,
        )  # fmt: skip
        for way in MEMOS:
            yield Case(
                "levels", f"texels, bias {bias:g}", way, f"the same, texels of levels {bias:+g}",
                functools.partial(_levels, way, 1.0, {"memo.bias": bias}, bias <= 0), 1e-5, ROUNDING,
            )  # fmt: skip


def _half_values(way: str, precision: str, bench: Bench) -> Found:
    """Emission beyond halves, by a graph."""
    make = functools.partial(scene, floor(20), materials=[lamp("1e6 65504 1000.3")] * 2, lights=[])
    (frame,) = opened(way, make, bench, settings={"memo.precision": precision}).frames(0, 1)
    rounded = [LARGEST_HALF, LARGEST_HALF, float(np.float16(1000.3))]
    return compared(colors_of(frame), rounded if precision == "half" else [1e6, 65504.0, 1000.3])


def _halves() -> Iterator[Case]:
    for way in MEMOS:
        for precision in ("half", "float"):
            yield Case(
                "half", f"graph, as {precision}", way,
                f"a graph's values of 1e6, 65504 and 1000.3, kept as {precision}",
                functools.partial(_half_values, way, precision), 1e-6,
                "the most that half precision has is kept in place of more",
            )  # fmt: skip


def _variance_seen(way: str, bench: Bench) -> Found:
    """The variance of pixels, relative to their square, where there is none."""
    make = functools.partial(ground, power=2e6)
    renderer = opened(way, make, bench, aovs=("variance",), spp=16)
    (frame,) = renderer.frames(0, 1)
    found = frame.aov("variance", next(iter(frame.color)))
    relative_variance = np.asarray(found, np.float64) / 1e12
    return compared(relative_variance, 0.0)


def _equal_weights(bench: Bench) -> Found:
    """With neither noise nor bias all frames count alike (Eq. 6), however large they are: N frames are N samples."""
    make = functools.partial(ground, power=2e6)
    *_, frame = opened("varianceblend", make, bench, aovs=("effective",)).frames(0, 8)
    return compared(frame.aov("effective", "mono"), 8.0)


def _variances() -> Iterator[Case]:
    for way in ("pathtrace", "samplecache", "isrt"):
        yield Case(
            "variance", "of pixels", way, "the variance of an even image of 1e6, relative to its square",
            functools.partial(_variance_seen, way), 1e-13, "deviations are of rounding alone: 6e-8, squared",
        )  # fmt: skip
    yield Case(
        "variance", "equal weights", "varianceblend", "eight even frames of 1e6: the effective number of samples",
        _equal_weights, 1e-5, ROUNDING,
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------------------------------
# What is refused


def _message(path_of: Callable[[Path], Path], words: Sequence[str], bench: Bench) -> Found:
    """What loading a file that `path_of` writes into a folder says; it is to name the file, and have all of these
    words."""
    with tempfile.TemporaryDirectory() as folder:
        file = path_of(Path(folder))
        expected = "an error that says " + ", ".join(words)
        try:
            load_scene(file)
        except SceneError as error:
            text = str(error).replace(folder, "")
            named = all(word in text for word in words) and "\n" not in text
            return Found(text, expected, None, refused=named)
        return Found("loaded", expected, None)


def _obj(lines: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        file = folder / "mesh.obj"
        file.write_text(lines, encoding="utf-8")
        return file

    return write


def _toml(folder: Path, text: str) -> Path:
    file = folder / "scene.toml"
    file.write_text(text, encoding="utf-8")
    return file


_FLOOR = '[meshes.floor]\ngenerator = "plane"\n[[instances]]\nmesh = "floor"\nmaterial = "a"\n'


def _picture(value: float) -> Callable[[Path], Path]:
    """A texture of floats, of which one pixel is no number."""

    def write(folder: Path) -> Path:
        from PIL import Image

        pixels = np.full((3, 4), 0.5, np.float32)
        pixels[1, 2] = value
        Image.fromarray(pixels).save(folder / "picture.tiff")
        return _toml(folder, _FLOOR + '[materials.a]\nbase_color_texture = "picture.tiff"\n')

    return write


def _sky(value: float) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        import OpenEXR

        pixels = np.full((4, 8, 3), 0.5, np.float32)
        pixels[1, 2, 1] = value
        with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": pixels}) as file:
            file.write(str(folder / "sky.exr"))
        return _toml(folder, _FLOOR + '[materials.a]\n[environment]\nimage = "sky.exr"\n')

    return write


def _gltf(positions: Sequence[float] | None, uvs: Sequence[float] | None) -> Callable[[Path], Path]:
    """A triangle, of whose second vertex these are the position or the texture coordinates."""

    def write(folder: Path) -> Path:
        import base64
        import json

        place = np.array([[0, 0, 0], positions or [1, 0, 0], [0, 1, 0]], np.float32)
        coordinates = np.array([[0, 0], uvs or [1, 0], [0, 1]], np.float32)
        data = place.tobytes() + coordinates.tobytes()
        float_type, ends = 5126, {"min": [0, 0, 0], "max": [1, 1, 0]}
        text = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}}]}],
            "accessors": [
                {"bufferView": 0, "componentType": float_type, "count": 3, "type": "VEC3", **ends},
                {"bufferView": 1, "componentType": float_type, "count": 3, "type": "VEC2"},
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24},
            ],
            "buffers": [{
                "byteLength": len(data),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode(),
            }],
        }  # fmt: skip
        file = folder / "mesh.gltf"
        file.write_text(json.dumps(text), encoding="utf-8")
        return file

    return write


def _wild_rays(value: float, bench: Bench) -> Found:
    tracer = Tracer(ground(), _device(bench.machine))
    try:
        hits = tracer.closest_hit([[0, 1, 0], [value, 1, 0]], [[0, -1, 0]] * 2)
    except ValueError as error:
        return Found(str(error), "an error that says so", None, refused="finite" in str(error))
    return Found(in_words(hits["t"]), "an error that says so", None)


@functools.cache
def _device(machine: Machine) -> Device:
    return machine.open()


def _refused() -> Iterator[Case]:
    face = "f 1/1 2/2 3/3\n"
    numbers = (("NaN", np.nan), ("infinity", np.inf))
    told: list[tuple[str, str, Callable[[Path], Path], tuple[str, ...]]] = []
    for word, value in numbers:
        lower = "nan" if word == "NaN" else "inf"
        told += [
            (f"{word} in vertices", f"an OBJ of which vertex 1 has {word}",
             _obj(f"v 0 0 0\nv 1 {lower} 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n{face}"), ("mesh.obj", "position 1")),
            (f"{word} in UVs", f"an OBJ of which texture coordinate 1 has {word}",
             _obj(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt {lower} 0\nvt 0 1\n{face}"), ("mesh.obj", "texture coordinate 1")),
            (f"{word} in vertices, glTF", f"a glTF of which position 1 has {word}", _gltf((1, value, 0), None),
             ("mesh.gltf", "position 1")),
            (f"{word} in UVs, glTF", f"a glTF of which texture coordinate 1 has {word}", _gltf(None, (1, value)),
             ("mesh.gltf", "texture coordinate 1")),
            (f"{word} in a texture", f"a TIFF of floats of which pixel (2, 1) is {word}", _picture(value),
             ("picture.tiff", "(2, 1)")),
            (f"{word} in an environment", f"an EXR of which pixel (2, 1) has {word} in G", _sky(value),
             ("sky.exr", "(2, 1)")),
            (f"{word} in a scene", f"an emission of {word}",
             functools.partial(_toml, text=_FLOOR + f"[materials.a]\nemission = [0, {lower}, 0]\n"),
             ("scene.toml", "emission.1")),
        ]  # fmt: skip
    for name, fed, write, words in told:
        yield Case(
            "not finite", name, "loading", fed, functools.partial(_message, write, words), 0.0,
            "nothing is traced that is no number", refused=True,
        )  # fmt: skip
    for word, value in numbers:
        yield Case(
            "not finite", f"{word} in rays", "tracer", f"a ray from {word}", functools.partial(_wild_rays, value), 0.0,
            "nothing is traced that is no number", refused=True,
        )  # fmt: skip


# ---------------------------------------------------------------------------------------------------------------------
# The tracer by itself, against planes in float64


def _plane_hits(size: float, offset: float, slope: float, bench: Bench, base=None) -> Found:
    """Rays down to a square; its height, in float64, is where they must meet it. slope: sine of the angle at which."""
    rng, n = np.random.default_rng(7), 2000
    made = mesh(floor(1.0).positions * np.float32(size), floor(1.0).triangles) if base is None else base
    level = np.float32(offset)
    positions = made.positions + np.array([level, 0, level], np.float32)
    tracer = Tracer(scene(replace(made, positions=positions)), _device(bench.machine))
    reach = np.ptp(positions[:, 0]) / 2, np.ptp(positions[:, 2]) / 2
    goal = np.stack([level + 0.98 * reach[0] * rng.uniform(-1, 1, n), np.zeros(n),
                     level + 0.98 * reach[1] * rng.uniform(-1, 1, n)], axis=1)  # fmt: skip
    away = 0.5 * size * rng.uniform(0.1, 1, n)
    angle = rng.uniform(0, 2 * np.pi, n)
    flat = np.sqrt(1 - slope**2)
    direction = np.stack([flat * np.cos(angle), np.full(n, -slope), flat * np.sin(angle)], axis=1).astype(np.float32)
    origin = (goal - away[:, None] * direction).astype(np.float32)
    hits = tracer.closest_hit(origin, direction)
    expected = origin[:, 1].astype(np.float64) / -direction[:, 1].astype(np.float64)
    where = origin.astype(np.float64) + expected[:, None] * direction.astype(np.float64)
    sure = (np.abs(where[:, 0] - level) < 0.99 * reach[0]) & (np.abs(where[:, 2] - level) < 0.99 * reach[1])
    if (hits["instance"][sure] == MISS).any() or sure.sum() < n // 2:
        return Found(f"{int((hits['instance'][sure] == MISS).sum())} of {int(sure.sum())} rays missed", "all hit", None)
    error = relative(hits["t"][sure], expected[sure])
    return Found(f"{int(sure.sum())} hits, off by up to {error:.2g}", "where float64 has the plane", error)


def _first_of_copies(bench: Bench) -> Found:
    """Among 500 copies, the first is hit; points and lines are not."""
    base = floor(2.0)
    lines = np.array([[0, 1, 0], [1, 1, 0], [2, 1, 0]], np.float32)
    triangles = np.vstack([[[4, 5, 6]] * 3, [[4, 4, 4]] * 3, [base.triangles[0]] * 500])
    tracer = Tracer(scene(mesh(np.vstack([base.positions, lines]), triangles)), _device(bench.machine))
    corners = base.positions[base.triangles[0]]
    weights = np.random.default_rng(3).dirichlet([1, 1, 1], 1000)
    origins = (weights @ corners + [0, 5, 0]).astype(np.float32)
    hits = tracer.closest_hit(origins, [[0, -1, 0]] * 1000)
    return Found(f"primitives {in_words(hits['primitive'])}", "6", 0.0 if (hits["primitive"] == 6).all() else None)


def _tracer() -> Iterator[Case]:
    for size in (1e-6, 1e6):
        yield Case(
            "scale", f"square of {size:g} m", "tracer", f"2,000 rays to a square of {size:g} m at a sine of 0.7",
            functools.partial(_plane_hits, size, 0.0, 0.7), 1e-5, "the rounding of three weights and corners",
        )  # fmt: skip
    yield Case(
        "far", "at 1e6 m", "tracer", "2,000 rays to a square of 2 km at (1e6, 0, 1e6) m",
        functools.partial(_plane_hits, 2000.0, 1e6, 0.7), 1e-5, "the rounding of three weights and corners",
    )  # fmt: skip
    for slope in (1e-2, 1e-4, 1e-6):
        yield Case(
            "grazing", f"rays at {slope:g}", "tracer", f"2,000 rays that meet a square at a sine of {slope:g}",
            functools.partial(_plane_hits, 2.0, 0.0, slope), max(1e-5, 2e-7 / slope * 4),
            "heights above the plane are of float32: 4 roundings over the sine",
        )  # fmt: skip
    for width in (1e-3, 1e-5):
        yield Case(
            "triangles", f"needles of {width:g}", "tracer",
            f"2,000 rays from up to 0.5 m to 64 needles, 1 m by {width:g} m",
            functools.partial(_plane_hits, 1.0, 0.0, 0.7, base=needles(width)), 3e-7 / width,
            "weights are rounded products of corners' distances over the area: 6e-8 of 1 m^2 over 1 m times the width",
        )  # fmt: skip
    yield Case(
        "triangles", "500 copies", "tracer", "1,000 rays to 500 copies of a triangle among points and lines",
        _first_of_copies, 0.0, "which of them is hit is defined: the first",
    )  # fmt: skip


CASES: tuple[Case, ...] = (
    *(case for shown in SHOWN for case in shown.cases()),
    *_scales(),
    *_texture_coordinates(),
    *_roughness(),
    *_closed_rooms(),
    *_lamps(),
    *_static_views(),
    *_full_tables(),
    *_all_levels(),
    *_halves(),
    *_variances(),
    *_refused(),
    *_tracer(),
)

LINES: dict[str, str] = {
    "scale": "scene scale 1e-6 and 1e6",
    "far": "far from the origin",
    "grazing": "grazing incidence",
    "triangles": "zero-area, duplicate and needle triangles",
    "not finite": "NaN or infinity in vertices, UVs, textures, environments and rays",
    "coordinates": "UVs of 1e7 and negative",
    "roughness": "roughness 0 and 1",
    "albedo": "albedo 0 and 1",
    "lights": "a light of 1e8 next to one of 1e-8",
    "sizes": "1x1 and 3x5 images, and sizes that no work-group divides",
    "near plane": "near plane",
    "eyes": "eyes 0 and 10 m apart",
    "cuts": "camera cuts and turns by 180 degrees",
    "static": "10,000 static frames, where counts saturate",
    "contention": "all slots contended by all threads",
    "tables": "tables of one entry, and full ones",
    "counters": "frame counters at 2^32 - 1",
    "levels": "the hash of every level",
    "half": "overflow of half precision at 65,504",
    "variance": "variance of a constant 1e6",
}


def attempt(case: Case, bench: Bench) -> Found:
    """Run a case; what it raises is what came out of it."""
    try:
        return case.run(bench)
    except (Error, ArithmeticError, ValueError, TypeError, KeyError, IndexError, RuntimeError) as error:
        return Found(f"{type(error).__name__}: {str(error).partition(chr(10))[0]}", "no error", None)
