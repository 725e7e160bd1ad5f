"""The C harness around Embree, in every one of its settings, against clcache's own hits, and the meshes that both trace."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import clcache
from clcache.bench.ray_sets import agreement, ray_sets
from clcache.bvh import Tracer

pytest.importorskip("embreex")
sys.path.append(str(Path(clcache.__file__).parents[1] / "tools" / "peers"))
import peer_meshes  # noqa: E402
import rays_beside_embree as tool  # noqa: E402

SIZE = (64, 36)
SETTINGS = [pytest.param(s, id="-".join(map(str, s))) for s in tool.SETTINGS]


@pytest.fixture(scope="module")
def scene():
    return peer_meshes.cornell()


@pytest.fixture(scope="module")
def rays(scene):
    return ray_sets(scene, Tracer(scene).closest_hit, SIZE, light_spread=tool.LIGHT_SPREAD)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    return tool.compile_harness(tmp_path_factory.mktemp("harness"))


@pytest.fixture(scope="module")
def embree(scene, library):
    return tool.Embree(library, *tool.joined(scene))


@pytest.mark.parametrize("setting", SETTINGS)
def test_embrees_hits_are_ours(embree, rays, scene, setting):
    tracer = Tracer(scene)
    assert [r.count for r in rays][:2] == [64 * 36] * 2  # nothing is open but what the camera looks through
    for given in rays:
        _, t = embree.trace(given, setting)
        if given.any_hit:
            ours, theirs = tracer.any_hit(given.origins.T, given.directions.T, t_max=given.lengths), np.isneginf(t)
            assert 0 < theirs.mean() < 0.2
        else:
            ours, theirs = tracer.closest_hit(given.origins.T, given.directions.T)["t"], t
        assert agreement(given, ours, theirs) > 0.999


def test_a_number_of_rays_that_no_packet_divides(embree, rays):
    """The rays beyond the last one leave no trace, and the last ones are there."""
    whole, part = rays[0], rays[0]
    n = 16 * 5 + 13
    part = type(whole)(
        "primary",
        *(np.ascontiguousarray(a[..., :n]) for a in (whole.origins, whole.directions, whole.lengths)),
        False,
        True,
    )
    for setting in tool.SETTINGS:
        np.testing.assert_allclose(embree.trace(part, setting)[1], embree.trace(whole, setting)[1][:n], rtol=1e-6)


def test_a_mesh_beside_embree(library, scene, monkeypatch):
    """All that is said of one mesh, from a short run on whatever core there is."""
    monkeypatch.setattr(tool.os, "sched_setaffinity", lambda pid, cores: None)
    result = tool.measure(tool.Job("cornell", ("primary", "shadow"), SIZE, 2, None, (0,), library))
    assert result["triangles"] == 10_252
    assert result["build"]["ratio"] == pytest.approx(
        result["build"]["embree"]["median"] / result["build"]["clcache"]["median"]
    )
    assert set(result["rays"]) == {"primary", "shadow"}
    for of in result["rays"].values():
        assert set(of["clcache"]) == {"in order", "sorted"}
        assert len(of["embree_once"]) == len(tool.SETTINGS)
        best, mine = of["embree"][of["embree_best"]]["median"], of["clcache"][of["fastest"]]["median"]
        assert best == min(t["median"] for t in of["embree"].values())
        assert mine == min(t["median"] for t in of["clcache"].values())
        assert of["ratio"] == pytest.approx(best / mine)
        assert of["agree"] > 0.999
    assert set(tool.measure_alone(tool.Job("cornell", ("diffuse",), SIZE, 1, None, (0,), library))["diffuse"]) == {
        "sorted"
    }
    rows = tool.lines(result)
    assert [row.split()[:2] for row in rows] == [["cornell", kind] for kind in ("build", "primary", "shadow")]


@pytest.mark.parametrize(("name", "triangles"), [("cornell", 10_252), ("city", 24_002)])
def test_meshes_are_seeded(name, triangles):
    one, again = (tool.joined(peer_meshes.MESHES[name]()) for _ in range(2))
    assert one[1].shape == (triangles, 3)
    for a, b in zip(one, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert one[1].max() == len(one[0]) - 1
    assert (np.linalg.norm(np.ptp(one[0][one[1]], axis=1), axis=1) > 0).all()
