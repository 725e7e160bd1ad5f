"""Hits against Embree, an independent tracer; where the two differ, float64 says who is right.

Neither of the two computes in more than float32, so that they may differ where two triangles are equally near, or where a
ray passes the border of the nearer one, within rounding: a tie. Any other difference must be an error of Embree's, which a search of all
triangles in float64 proves, and there may be one in 100,000 rays at most.
"""

import numpy as np
import pytest
from helpers import (
    MISS,
    blob,
    edge_targets,
    exact_hits,
    icosphere,
    make_mesh,
    make_scene,
    moved,
    random_directions,
    soup,
    wrong_hits,
)

from clcache.bvh import Tracer
from clcache.scene.generators import hairball

rtcore_scene = pytest.importorskip("embreex.rtcore_scene")
TriangleMesh = pytest.importorskip("embreex.mesh_construction").TriangleMesh

MOST_DIFFERENCES = 1e-5
PLACES = [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1.0, 1e3), (1e3, 1e6)]


def hairs(n):
    """Curled ribbons in the unit ball, about as wide as a hair of a doll."""
    shape = hairball(n, 40, 1.0, 0.004, 1)
    return make_mesh(shape.positions, shape.triangles)


MESHES = {
    "1": lambda: soup(1, 1, 0.8),
    "2": lambda: soup(2, 2, 0.8),
    "7": lambda: soup(7, 3, 0.5),
    "100": lambda: soup(100, 4, 0.3),
    "1280 of a sphere": lambda: icosphere(3),
    "20480 of a blob": lambda: blob(5),
    "100000 of a soup": lambda: soup(100_000, 5, 0.02),
}
LARGE_MESHES = {
    "1000000 of a soup": lambda: soup(1_000_000, 6, 0.01),
    "1000000 of hairs": lambda: hairs(1_000_000),
    "1310720 of a blob": lambda: blob(8, roughness=0.001),
}


def random_rays(mesh, n, scale, offset, rng):
    """From anywhere in and about the mesh to anywhere within it."""
    origins = (offset + scale * rng.uniform(-1.5, 1.5, (n, 3))).astype(np.float32)
    return origins, (offset + scale * rng.uniform(-1, 1, (n, 3))).astype(np.float32) - origins


def coherent_rays(mesh, n, scale, offset, rng):
    """Those of a camera: one origin, a grid of directions that covers the mesh."""
    side = int(np.sqrt(n))
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, side), np.linspace(-0.4, 0.4, side))
    directions = np.column_stack([x.ravel(), y.ravel(), np.full(side * side, -1.0)]).astype(np.float32)
    origin = (offset + scale * np.array([0.05, 0.1, 3.0])).astype(np.float32)
    return np.tile(origin, (len(directions), 1)), directions


def rays_at_edges(mesh, n, scale, offset, rng):
    """At corners, at the middles of edges, and at other points of edges."""
    origins = (offset + 2 * scale * random_directions(n, rng)).astype(np.float32)
    return origins, edge_targets(mesh, n, rng) - origins


KINDS = (random_rays, coherent_rays, rays_at_edges)


def embree_scene(mesh):
    """Embree's own tree, in its robust mode (edges are watertight)."""
    scene = rtcore_scene.EmbreeScene(robust=True)
    TriangleMesh(scene, mesh.positions, mesh.triangles.astype(np.int32))
    return scene


def embree_primitives(scene, origins, directions):
    """The primitive that Embree finds for each ray, or MISS."""
    found = scene.run(origins, directions, dists=np.full(len(origins), np.inf, np.float32), output=True)
    return found["primID"].astype(np.int64).astype(np.uint32)


def is_tie(mesh, hits, theirs, origins, directions):
    """(n,) bool: whether both answers are within rounding. theirs: (n,), the other tracer's primitives.

    Each ray must be able to hit either triangle, and whichever is nearer must be one that it may also pass by.
    """

    def answer(primitive):
        missed = primitive == MISS
        exact = exact_hits_of_pairs(origins, directions, mesh.positions[mesh.triangles[np.where(missed, 0, primitive)]])
        t, error = np.where(missed, np.inf, exact.t), np.where(missed, 0, exact.error)
        return t - error, t + error, exact.certain & ~missed, exact.possible | missed

    our_low, our_high, our_certain, our_possible = answer(hits["primitive"])
    low, high, certain, possible = answer(theirs)
    overlooked = (our_certain & (our_high < low)) | (certain & (high < our_low))
    return our_possible & possible & ~overlooked


def exact_hits_of_pairs(origins, directions, corners):
    """`exact_hits` of each ray with a triangle of its own: corners (n, 3, 3); arrays (n,)."""
    exact = exact_hits(origins, directions, corners[:, None])
    return type(exact)(*(getattr(exact, name)[:, 0] for name in exact.__dataclass_fields__))


def proven(mesh, hits, origins, directions):
    """(n,) bool: whether a search of all triangles in float64 finds nothing wrong with these hits."""
    corners = mesh.positions[mesh.triangles]
    right = np.ones(len(hits), bool)
    for i in range(len(hits)):  # a handful of rays
        blocks = [
            exact_hits(origins[i : i + 1], directions[i : i + 1], corners[k : k + 2**17])
            for k in range(0, len(corners), 2**17)
        ]
        whole = type(blocks[0])(
            *(np.concatenate([getattr(b, name) for b in blocks], axis=1) for name in blocks[0].__dataclass_fields__)
        )
        right[i] = not wrong_hits(whole, hits[i : i + 1], hits["primitive"][i : i + 1])[0]
    return right


def compare(device, mesh, n, scale=1.0, offset=0.0):
    """Trace all kinds of rays with both; every difference must be a tie, or proven, and few must need a proof."""
    mesh = moved(mesh, scale, [offset] * 3)
    tracer, embree = Tracer(make_scene(mesh), device), embree_scene(mesh)
    rng = np.random.default_rng(1)
    unequal = traced = 0
    for kind in KINDS:
        origins, directions = kind(mesh, n, scale, offset, rng)
        hits = tracer.closest_hit(origins, directions)
        theirs = embree_primitives(embree, origins, directions)
        differs = np.flatnonzero(hits["primitive"] != theirs)
        tie = is_tie(mesh, hits[differs], theirs[differs], origins[differs], directions[differs])
        beyond = differs[~tie]
        unequal, traced = unequal + len(beyond), traced + len(origins)
        assert unequal <= max(1, MOST_DIFFERENCES * traced), kind.__name__
        assert proven(mesh, hits[beyond], origins[beyond], directions[beyond]).all(), kind.__name__
        assert np.count_nonzero(hits["primitive"] == theirs) > 0, kind.__name__


@pytest.mark.parametrize(("scale", "offset"), PLACES)
@pytest.mark.parametrize("name", MESHES)
def test_hits_equal_embrees(device, name, scale, offset):
    compare(device, MESHES[name](), 10_000, scale, offset)


@pytest.mark.parametrize("name", LARGE_MESHES)
def test_hits_in_a_million_triangles_equal_embrees(device, name):
    compare(device, LARGE_MESHES[name](), 50_000)


def test_comparison_notices_wrong_hits(device):
    """What the comparison would say of a tracer that takes the second hit, or none, in one ray of a hundred."""
    mesh = blob(3)
    tracer, embree = Tracer(make_scene(mesh), device), embree_scene(mesh)
    origins, directions = random_rays(mesh, 1000, 1.0, 0.0, np.random.default_rng(2))
    theirs = embree_primitives(embree, origins, directions)
    hits = tracer.closest_hit(origins, directions)
    second = tracer.closest_hit(
        origins, directions, t_min=np.where(hits["primitive"] == MISS, 0, hits["t"] * np.float32(1.0001))
    )
    missing = hits.copy()
    missing["primitive"], missing["t"] = MISS, np.inf
    for spoiled in (second, missing):
        differs = np.flatnonzero(spoiled["primitive"] != theirs)[:50]
        assert len(differs) == 50
        assert not is_tie(mesh, spoiled[differs], theirs[differs], origins[differs], directions[differs]).any()
        assert not proven(mesh, spoiled[differs], origins[differs], directions[differs]).any()
