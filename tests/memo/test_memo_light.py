"""Light of what memoized graphs compute, found by paths whose cones have grown wide: its mean is that without memoization, whatever
repeats in the graph."""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import one_device
from memo_renders import counters, defined, frames
from render_helpers import BLACK, floor, grey, lit, shape_mesh, view

from clcache.scene.generators import plane
from clcache.scene.model import Material

# Red goes from 0 to 3 and has its seam where coordinates are whole; green is 3 all over.
RAMP = """
UVInput Out>0;
Fract In<0 Out>1;
Separate2 In<1 X>2 Y>3;
Float1Constant 3 Out>4;
Mul A<2 B<4 Out>5;
Combine3 X<5 Y<4 Z<5 Out>6;
EmissionOutput In<6;
"""
# Noise, which is 0 at whole coordinates, without its sign; the lamp is so many of its cells wide.
SPECKS = """
UVInput Out>0;
Float1Constant CELLS Out>1;
Mul A<0 B<1 Out>2;
Noise2D UV<2 Out>3;
Abs In<3 Out>4;
Combine3 X<4 Y<4 Z<4 Out>5;
EmissionOutput In<5;
"""
SPECKS_IN_SPACE = SPECKS.replace("UVInput", "PositionInput").replace("Noise2D UV", "Noise3D Position")
KINDS = {
    "texels": {"memo": "texel"},
    "free texels": {"memo": "texel", "snap": False},
    "large texels": {"memo": "texel", "bias": -4.0},
    "small texels": {"memo": "texel", "bias": 3.0},
    "tiles": {"memo": "tile"},
    "tiles of points": {"memo": "tile", "filter": "bilinear"},
}


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def light(graph, **options):
    """(3,): mean of a floor that a lamp of this graph lights, seen from between the two; and what was counted."""
    lamp = Material("lamp", BLACK, graph=graph, specular=0.0)
    lid = shape_mesh(plane((3, 3)), 1)
    lid = replace(
        lid, positions=lid.positions + np.float32([0, 0.3, 0])
    )  # no plane in which noise has fewer dimensions
    scene = lit(
        floor(4), lid, camera=view((0, 0.5, 0), (0, 0, 0), up=(0, 0, 1), degrees=60), materials=[grey(0.5), lamp],
        instances=[(0, np.eye(4)[:3]), (1, np.array([[1.0, 0, 0, 0], [0, -1, 0, 1.3], [0, 0, -1, 0]]))],
    )  # fmt: skip
    (frame,) = frames(scene, count=1, size=(48, 32), spp=32, settings={"pathtrace.bounces": 0}, **options)
    return frame.color["mono"].mean(axis=(0, 1)), counters(frame) if "memo" in options else None


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_a_ramp_lights_as_it_does_without(kind):
    """Cones are wider than the lamp. Its texels are no larger than a 16th of it, by whose rounding a mean changes less than 2 %."""
    ramp = defined("ramp", RAMP)
    expected, _ = light(ramp)
    assert expected[0] == pytest.approx(0.5 * expected[1], rel=0.05)
    found, counted = light(ramp, **kind)
    assert counted["hits"] > 0.9 * counted["lookups"] > 0
    np.testing.assert_allclose(found, expected, rtol=0.02)


@pytest.mark.parametrize("cells", [1, 16, 33])
@pytest.mark.parametrize("kind", ["texels", "large texels", "tiles"])
def test_noise_lights_as_it_does_without(kind, cells):
    """Though its cells are as large as texels, or half as large, or as the lamp. The mean over 16 by 16 texels of a value each differs
    by 5 % of what is to be expected of many, its standard error."""
    specks = defined(f"specks {cells}", SPECKS.replace("CELLS", str(cells)))
    (expected, _), (found, counted) = light(specks), light(specks, **KINDS[kind])
    assert counted["hits"] > 0.9 * counted["lookups"] > 0
    np.testing.assert_allclose(found, expected, rtol=0.15)


@pytest.mark.parametrize("cells", [1, 5.4, 11])
def test_noise_in_space_lights_as_it_does_without(cells):
    """So many cells for each metre, in texels of three dimensions."""
    specks = defined(f"specks in space {cells}", SPECKS_IN_SPACE.replace("CELLS", str(cells)))
    (expected, _), (found, counted) = light(specks), light(specks, memo="texel")
    assert counted["hits"] > 0.9 * counted["lookups"] > 0
    np.testing.assert_allclose(found, expected, rtol=0.15)
