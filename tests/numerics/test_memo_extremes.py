"""Memoization at the ends of what can be asked of it: coordinates, scales, values and images of any size, tables of one entry."""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import one_device
from memo_renders import assert_same, counters, defined, frames, painted, yard

from clcache.graph import OUTPUTS
from clcache.scene.model import Material

MEMOS = ("texel", "tile")
LARGEST_HALF = 65504.0


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def checked(found):
    """The frames, after seeing that nothing in them is nonsense."""
    for frame in found:
        for color in frame.color.values():
            assert np.isfinite(color).all() and (color >= 0).all()
    return found


def with_uvs(scene, scale, offset=0.0):
    with np.errstate(over="ignore"):
        meshes = [
            replace(m, uvs=(m.uvs * np.float32(scale) + np.float32(offset)).astype(np.float32)) for m in scene.meshes
        ]
    return replace(scene, meshes=tuple(meshes))


@pytest.mark.parametrize("memo", MEMOS)
@pytest.mark.parametrize(
    ("scale", "offset"), [(1e7, 0), (-1e7, 0), (1.0, 1e7), (-3.0, -5.0), (1e-7, 0), (0.0, 0), (1e30, 0), (3e37, 0)]
)
def test_coordinates_of_any_size(memo, scale, offset):
    """Where float32 has no fractions, and where it has nothing but; values are as they are without, or of a texel near by."""
    scene = with_uvs(yard(painted("waves")), scale, offset)
    found, expected = checked(frames(scene, memo, count=1)), checked(frames(scene, count=1))
    assert counters(found[0])["lookups"] > 100
    if abs(scale) < 1e-6:
        np.testing.assert_allclose(found[0].color["mono"], expected[0].color["mono"], atol=1e-4)


@pytest.mark.parametrize("memo", MEMOS)
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_scale_of_a_scene_changes_nothing(memo, scale):
    """Coordinates change over a pixel by as much: the same keys, but for some at the borders of texels and levels."""
    scene = yard(painted("waves"))
    places = [
        replace(i, transform=i.transform * np.array([1, 1, 1, scale]) @ np.diag([scale] * 3 + [1.0]))
        for i in scene.instances
    ]
    camera = replace(scene.camera, transform=scene.camera.transform * np.array([1, 1, 1, scale]))
    (usual,), (scaled,) = (
        frames(scene, memo, count=1),
        frames(replace(scene, instances=tuple(places), camera=camera), memo, count=1),
    )
    away = np.abs(checked([scaled])[0].color["mono"] - usual.color["mono"]).max(axis=2)
    assert (away > 1e-3).mean() < 0.1
    assert abs(counters(scaled)["occupied"] - counters(usual)["occupied"]) < 0.2 * counters(usual)["occupied"]


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e6, 1e30])
def test_places_of_any_size(scale):
    """Of a graph that reads the position: the mesh itself is that large, and its instance makes it fit."""
    scene = yard(painted("stripes"))
    meshes = [replace(m, positions=(m.positions * np.float32(scale)).astype(np.float32)) for m in scene.meshes]
    places = [replace(i, transform=i.transform @ np.diag([1 / scale] * 3 + [1.0])) for i in scene.instances]
    found = checked(frames(replace(scene, meshes=tuple(meshes), instances=tuple(places)), "texel", count=1))
    assert counters(found[0])["hits"] > 0


@pytest.mark.parametrize("memo", MEMOS)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (17, 1)])
def test_images_of_any_size(memo, size):
    scene = yard(painted("checks"), exact=True)
    assert_same(checked(frames(scene, memo, size=size, stereo=True)), frames(scene, size=size, stereo=True))


def test_a_graph_of_all_outputs():
    """Fifteen values of a texel, in float and in half, of which they fill the last word by half; each comes back in its place."""
    lines = ["UVInput Out>0;", "Float2Constant 64 64 Out>1;", "Mul A<0 B<1 Out>2;", "Floor In<2 Out>3;"]
    number = 3
    for k, (name, channels) in enumerate(OUTPUTS.items()):
        a, b, c = number + 1, number + 2, number + 3
        lines += [
            f"Float2Constant 0.{37 + 3 * k} 0.{61 - 2 * k} Out>{a};",
            f"Dot A<3 B<{a} Out>{b};",
            f"Fract In<{b} Out>{c};",
        ]
        number = c
        if channels == 3:
            lines += [f"Float3Constant 0.9 0.{k + 1} 0.5 Out>{c + 1};", f"Mul A<{c} B<{c + 1} Out>{c + 2};"]
            number = c + 2
        lines.append(
            f"{''.join(part.capitalize() for part in name.split('_'))}Output In<{number};".replace("BaseColor", "Color")
        )
    everything = Material("all", graph=defined("all", "\n".join(lines)))
    assert everything.graph.channels == 15
    scene = yard(everything, exact=True)
    expected = checked(frames(scene))
    for memo in MEMOS:
        assert_same(frames(scene, memo), expected)
    half = checked(frames(scene, "texel", precision="half", count=1))
    away = np.abs(half[0].color["mono"] - expected[0].color["mono"]) / (0.1 + expected[0].color["mono"])
    assert 0 < np.median(away[away > 0]) < 1e-2 and (away > 1e-2).mean() < 0.05


@pytest.mark.parametrize("eviction", ["none", "lru-counter"])
def test_all_slots_contended_by_all(eviction):
    """One entry, for which all lookups of all eyes and bounces compete: nothing is lost but time."""
    scene = yard(painted("checks"), exact=True)
    expected = frames(scene, stereo=True)
    found = frames(scene, "texel", stereo=True, capacity=1, eviction=eviction)
    assert_same(found, expected)
    of_eye = counters(found[-1], "right")
    assert of_eye["occupied"] == of_eye["capacity"] == 1 and of_eye["built"] > 100
