"""Methods with a cache of light over materials by graph: without bounces, and that they ask for no values that nobody reads."""

import numpy as np
import pytest
from cache_renders import one_device
from memo_renders import assert_same, counters, defined, frames, painted, renderer, yard

from clcache.frame import Repeat
from clcache.methods import METHODS
from clcache.scene.model import Material

AT_ONCE = {"settings": {"pathtrace.bounces": 0, "octree.resolution": 128}}
# Green light in whole squares.
GLOW = """
UVInput Out>0;
Float1Constant 64 Out>1;
Mul A<0 B<1 Out>2;
Floor In<2 Out>3;
Float2Constant 0.37 0.61 Out>4;
Dot A<3 B<4 Out>5;
Fract In<5 Out>6;
Float3Constant 0.0 1.5 0.0 Out>7;
Mul A<7 B<6 Out>8;
EmissionOutput In<8;
"""


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


@pytest.mark.parametrize("aovs", [(), ("albedo", "N")], ids=["alone", "with AOVs"])
@pytest.mark.parametrize("method", METHODS)
def test_paths_of_one_vertex(method, aovs):
    """Their last rays meet surfaces only for their light, which graphs compute. Keys that say exactly where hits are change nothing."""
    scene = yard(painted("checks"), Material("glow", graph=defined("glow", GLOW)), exact=True)
    options = AT_ONCE | {"aovs": aovs, "stereo": True}
    dark = frames(yard(painted("checks"), painted("checks"), exact=True), method=method, **options)
    expected, found = (frames(scene, memo, method, **options) for memo in ("off", "texel"))
    assert_same(found, expected)
    for eye in ("left", "right"):
        assert sum(counters(f, eye)["hits"] for f in found) > 0
        color, without = expected[-1].color[eye], dark[-1].color[eye]
        assert np.isfinite(color).all() and color[..., 1].max() > 1.2
        on_floor = without[-2:, :, 1].mean()
        assert color[-2:, :, 1].mean() > 0.5 * on_floor > 0


def passes_of(of, under=None):
    """The names of a renderer's passes, those of repetitions behind the repetition's name."""
    for p in of if under is not None else of._graph.passes:
        yield (under or "") + p.name
        if isinstance(p, Repeat):
            yield from passes_of(p.passes, f"{under or ''}{p.name}/")


@pytest.mark.parametrize("memo", ["off", "texel", "tile"])
@pytest.mark.parametrize("method", ["samplecache", "isrt"])
def test_values_that_nobody_reads_are_not_asked_for(method, memo):
    """Those of visible samples, which serve the AOVs alone: without these there is no such pass, and images are the same."""
    scene, asked = yard(painted("checks"), exact=True), {}
    for aovs in ((), ("albedo",)):
        of = renderer(scene, memo, method, aovs=aovs)
        asked[aovs] = list(of.frames(0, 3))
        names = set(passes_of(of))
        assert "shading/materials" in names
        assert ("reconstruction/materials" in names) == bool(aovs)
        if memo != "off":
            lookups = [counters(frame)["lookups"] for frame in asked[aovs]]
            assert min(lookups) > 0
    assert_same(asked[()], asked["albedo",])
    if memo != "off":
        few, many = (sum(counters(f)["lookups"] for f in found) for found in asked.values())
        assert few < many
