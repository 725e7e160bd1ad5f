"""Renders of scenes whose materials are graphs, with and without memoization."""

from dataclasses import replace
from functools import cache

import numpy as np
from helpers import IDENTITY, make_mesh
from render_helpers import lit, shape_mesh, view

from clcache import Renderer
from clcache.graph import CompiledGraph, compile_graph
from clcache.graph.library import library
from clcache.graph.text import parse
from clcache.renderer import Frame
from clcache.scene.generators import plane, sphere
from clcache.scene.model import DirectionalLight, Material, Mesh, Scene

SIZE = (24, 16)
STEPS = 64  # of the checks' coordinates: texture coordinates of exact keys are multiples of 1 / STEPS

# Colour and roughness of squares of 1/64, as random as a fraction can be; the same all over a square.
CHECKS = f"""
UVInput Out>0;
Float1Constant {STEPS} Out>1;
Mul A<0 B<1 Out>2;
Floor In<2 Out>3;
Float2Constant 0.37 0.61 Out>4;
Dot A<3 B<4 Out>5;
Fract In<5 Out>6;
Float3Constant 0.8 0.3 0.1 Out>7;
Float3Constant 0.1 0.4 0.7 Out>8;
Mix Bg<7 Fg<8 Mix<6 Out>9;
ColorOutput In<9;
Float1Constant 0.5 Out>10;
Mix Bg<10 Fg<6 Mix<10 Out>11;
RoughnessOutput In<11;
"""
# A wave that is nowhere flat.
WAVES = """
UVInput Out>0;
Float2Constant 9 7 Out>1;
Dot A<0 B<1 Out>2;
Sin In<2 Out>3;
Float3Constant 0.3 0.2 0.1 Out>4;
Mul A<4 B<3 Out>5;
Float3Constant 0.5 0.5 0.5 Out>6;
Add A<5 B<6 Out>7;
ColorOutput In<7;
"""
STRIPES = WAVES.replace("UVInput", "PositionInput").replace("Float2Constant 9 7", "Float3Constant 9 7 5")
SLOPES = STRIPES.replace("PositionInput", "NormalInput")
# 400 of Sine, one after the other.
EXPENSIVE = (
    "UVInput Out>0;\nFloat2Constant 9 7 Out>1;\nDot A<0 B<1 Out>2;\n"
    + "".join(f"Sin In<{k} Out>{k + 1};\n" for k in range(2, 402))
    + "RoughnessOutput In<402;\n"
)
GRAPHS = {"checks": CHECKS, "waves": WAVES, "stripes": STRIPES, "slopes": SLOPES, "expensive": EXPENSIVE}


@cache
def graph(name: str) -> CompiledGraph:
    """One of GRAPHS."""
    return compile_graph(parse(GRAPHS[name], f"{name}.graph", library()))


def defined(name: str, text: str) -> CompiledGraph:
    """One that a test makes up, from now on one of GRAPHS."""
    GRAPHS[name] = text
    graph.cache_clear()
    return graph(name)


def painted(name: str, **fields) -> Material:
    """A material of which a graph computes the colour. fields: of the material."""
    return Material(name, graph=graph(name), **{"specular": 0.5, **fields})


def exact_mesh(mesh: Mesh, seed: int) -> Mesh:
    """The mesh with triangles apart, each of which has one texture coordinate, a multiple of 1 / STEPS: all of its hits have the same key,
    which says exactly where they are."""
    corners = mesh.positions[mesh.triangles].reshape(-1, 3)
    uvs = np.random.default_rng(seed).integers(-STEPS, STEPS, (len(mesh.triangles), 2)) / STEPS
    separate = make_mesh(corners, np.arange(len(corners)))
    return replace(separate, material=mesh.material, uvs=np.repeat(uvs, 3, axis=0).astype(np.float32))


def yard(*materials: Material, exact: bool = False, eye_distance: float = 0.08) -> Scene:
    """A ball on a floor under sun and sky, of the first two of these materials; the ball stands there once more, mirrored and smaller."""
    first, second = materials if len(materials) == 2 else materials * 2
    meshes = [shape_mesh(plane((6, 6))), shape_mesh(sphere(0.8, 2), 1, smooth=not exact)]
    if exact:
        meshes = [exact_mesh(_grid(), 1), exact_mesh(meshes[1], 2)]
    aside = np.column_stack([np.diag([-0.5, 0.5, 0.5]), [1.3, 0.4, 0.6]])
    return lit(
        *meshes, camera=view((0.4, 2.5, 3.5), (0, 0.4, 0)), materials=[first, second], environment=(0.3, 0.4, 0.5),
        lights=[DirectionalLight((0.48, -0.8, 0.36), (2.0, 1.8, 1.5))], eye_distance=eye_distance,
        instances=[(0, IDENTITY), (1, np.column_stack([np.eye(3), [0, 0.8, 0]])), (1, aside)],
    )  # fmt: skip


def _grid() -> Mesh:
    """A floor of 72 triangles."""
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-3, 3, 7), np.linspace(-3, 3, 7)))
    first = (np.arange(6)[:, None] * 7 + np.arange(6)).reshape(-1, 1)
    return make_mesh(np.column_stack([x, 0 * x, z]), np.vstack([first + [0, 7, 8], first + [0, 8, 1]]))


def renderer(scene: Scene, memo: str = "off", method: str = "pathtrace", **options) -> Renderer:
    """All graphs are memoized that can be, unless `auto`. options: of `Renderer`; settings of memo by their last names."""
    names = (
        "capacity", "probe", "eviction", "tile", "filter", "snap", "bias", "primary", "precision", "auto", "read", "layout", "builder",
        "grouped", "passes",
    )  # fmt: skip
    settings = {"memo.auto": False, "pathtrace.bounces": 2}
    settings |= {f"memo.{name}": options.pop(name) for name in names if name in options}
    settings |= options.pop("settings", {})
    options = {"size": SIZE, "spp": 1} | options
    return Renderer(scene, method, memo=memo, settings=settings, **options)


def frames(scene: Scene, memo: str = "off", method: str = "pathtrace", count: int = 2, **options) -> list[Frame]:
    """The first ones."""
    return list(renderer(scene, memo, method, **options).frames(0, count))


def counters(frame: Frame, eye: str = "mono") -> dict[str, int]:
    """What the memoization counted."""
    return frame.stats["eyes"][eye]["memo"]


def assert_same(found: list[Frame], expected: list[Frame]) -> None:
    """All pictures of all frames, bit for bit."""
    for one, other in zip(found, expected, strict=True):
        for eye, color in other.color.items():
            np.testing.assert_array_equal(one.color[eye], color, err_msg=f"frame {other.number}, {eye}")


def assert_differ(found: list[Frame], expected: list[Frame]) -> None:
    """Some picture does."""
    assert any(
        (one.color[eye] != other.color[eye]).any()
        for one, other in zip(found, expected, strict=True)
        for eye in one.color
    )
