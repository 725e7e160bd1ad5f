"""Rays that no camera makes, straight to the kernels, which do not look at them beforehand as `Tracer` does: random bits, what is not a
number, infinities, and the ends of float32."""

from pathlib import Path

import numpy as np
import pytest
from helpers import MISS, blob, cube, make_mesh, make_scene, moved, soup

from clcache.bvh.build import SceneTrees
from clcache.bvh.tracer import RayKernels
from clcache.resources import SceneResources
from clcache.scene import load_scene
from clcache.scene.geometry import Geometry

CITY = Path(__file__).parents[2] / "data" / "city" / "scene.toml"
N = 4 * 4096
HUGE = np.float32(3e38)
SPECIAL = np.array(
    [np.nan, np.inf, -np.inf, HUGE, -HUGE, 0.0, -0.0, 1e-45, 1e-38, 1e18, 1e30, 3e36, -3e36, 1e37], np.float32
)


def random_bits(rng, shape):
    return rng.integers(0, 2**32, shape, dtype=np.uint32).view(np.float32)


def some_special(rng, values):
    """A third of these numbers replaced."""
    return np.where(rng.random(values.shape) < 1 / 3, rng.choice(SPECIAL, values.shape), values)


def all_nan(rng, values):
    return np.full_like(values, np.nan)


def all_infinite(rng, values):
    return np.where(rng.random(values.shape) < 0.5, np.float32(np.inf), np.float32(-np.inf))


def all_huge(rng, values):
    return np.where(rng.random(values.shape) < 0.5, HUGE, -HUGE)


def all_lengths(rng, values):
    """The numbers of a ray scaled alike, up to the ends of float32."""
    with np.errstate(over="ignore", under="ignore"):
        return (values * 10.0 ** rng.uniform(-46, 39, values.shape[1])).astype(np.float32)


WILD = {
    "all lengths": all_lengths,
    "random bits": lambda rng, values: random_bits(rng, values.shape),
    "special": some_special,
    "nan": all_nan,
    "infinite": all_infinite,
    "huge": all_huge,
}


def flat():
    """A square in a plane of the axes, of which rays within it have products of 0 and infinity."""
    return make_mesh([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], [[0, 1, 2], [0, 2, 3]])


def scaled(factor, place):
    return np.column_stack([factor * np.eye(3), place])


# Without instances that are placed, all triangles are in one tree; with them there are trees over trees, and rays are transformed,
# whose directions become longer or shorter there.
SCENES = {
    "one triangle": make_scene(soup(1, 1)),
    "one tree": make_scene(soup(3000, 2), blob(3), flat()),
    "instances": make_scene(
        moved(soup(200, 3), 1e-6), blob(2), moved(flat(), 1e3), moved(blob(2), 100),
        instances=[(k % 4, scaled((1e6, 1, 1e-3, 1e-2)[k % 4], (0.1 * k - 1, 1 - 0.1 * k, 0.05))) for k in range(24)],
    ),
    "ends of float32": make_scene(moved(cube(), 1e-6), moved(cube(), 1e9)),
}  # fmt: skip


def triangle_counts(scene):
    """(instances,)."""
    return np.array([len(scene.meshes[i.mesh].triangles) for i in scene.instances])


@pytest.fixture(scope="module", params=SCENES.values(), ids=SCENES)
def kernels(request, device):
    """The kernels, and how many triangles each instance has."""
    scene = request.param
    return RayKernels(device, SceneTrees(device, Geometry.of(scene))), triangle_counts(scene)


@pytest.fixture(scope="module")
def city(device):
    scene = load_scene(CITY)
    resources = SceneResources(device, scene)
    resources.set_time(0.0)
    return resources.rays, triangle_counts(scene)


def wild(kind, where, seed):
    """Origins (3, N), directions (3, N), and the ends (2, N) of their intervals, of which `where` names those that are wild; every
    second packet of 16 rays has none that is."""
    rng = np.random.default_rng(seed)
    rays = {
        "origins": rng.normal(size=(3, N)).astype(np.float32),
        "directions": rng.normal(size=(3, N)).astype(np.float32),
        "intervals": np.stack([np.zeros(N, np.float32), np.full(N, np.inf, np.float32)]),
    }
    is_wild = np.arange(N) // 16 % 2 == 0
    for name in where:
        rays[name] = np.where(is_wild, WILD[kind](rng, rays[name]), rays[name]).astype(np.float32)
    return rays["origins"], rays["directions"], *rays["intervals"]


def trace(device, kernels, rays, coherent):
    """Any hit (N,) bool; t (N,), uv (2, N), primitive, instance (N,), which begin as numbers that stand for nothing."""
    uploaded = [device.upload(np.ascontiguousarray(values), "rays") for values in rays]
    shapes = ((N,), np.float32), ((2, N), np.float32), ((N,), np.uint32), ((N,), np.uint32)
    unset = [device.upload(np.full(shape, 12345678, dtype), "hits") for shape, dtype in shapes]
    occluded = device.upload(np.full(N, 7, np.uint8), "occlusion")
    kernels.any_hit(*uploaded, occluded, coherent=coherent)
    kernels.closest_hit(*uploaded, *unset, coherent=coherent)
    results = [array.get() for array in (occluded, *unset)]
    device.release(*uploaded, *unset, occluded)
    return results


@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize(
    "where", [("origins",), ("directions",), ("intervals",), ("origins", "directions", "intervals")]
)
@pytest.mark.parametrize("kind", WILD)
def test_wild_rays_hit_what_there_is_or_nothing(device, kernels, kind, where, coherent):
    """No crash, no number of what is not there; and the rays beside them are not disturbed."""
    check(device, *kernels, kind, where, coherent)


@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize("kind", WILD)
def test_wild_rays_in_a_city(device, city, kind, coherent):
    """Hundreds of instances with holes by their pictures, which are read where a ray meets them."""
    check(device, *city, kind, ("directions",), coherent)


def check(device, rays_of, counts, kind, where, coherent):
    for seed in (1, 2):
        rays = wild(kind, where, seed)
        occluded, t, uv, primitive, instance = trace(device, rays_of, rays, coherent)
        is_miss = instance == MISS
        assert set(occluded.tolist()) <= {0, 1}
        np.testing.assert_array_equal(primitive == MISS, is_miss)
        assert (is_miss | (instance < len(counts))).all()
        assert (primitive[~is_miss] < counts[instance[~is_miss]]).all()
        assert np.isfinite(t[~is_miss]).all() and np.isfinite(uv[:, ~is_miss]).all()
        assert (t[is_miss] == np.inf).all()
        tame = np.arange(N) // 16 % 2 == 1
        calm = trace(device, rays_of, wild(kind, (), seed), coherent)
        for found, expected in zip(
            (occluded, t, primitive, instance), (calm[0], calm[1], calm[3], calm[4]), strict=True
        ):
            np.testing.assert_array_equal(found[tame], expected[tame])
        is_number = np.isfinite(rays[0]).all(axis=0) & np.isfinite(rays[1]).all(axis=0)
        assert is_miss[~is_number].all() and not occluded[~is_number].any()
