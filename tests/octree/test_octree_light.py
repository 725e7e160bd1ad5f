"""The light that vertices of paths get (OctreeCache, section 3.2, Eq. 1), against closed forms and against path tracing."""

import numpy as np
import pytest
from cache_renders import one_device
from octree_renders import cells, levels, octree
from render_helpers import ball, floor, grey, lit, view
from scipy import stats
from ztest import agree

from clcache import Renderer
from clcache.scene.model import DirectionalLight, Material, PointLight

ALBEDO = 0.6
BOUNCES = 5  # so many that what lies behind makes no difference in the open


def inside(emission: float = 1.0, albedo: float = ALBEDO):
    """The eye within a ball that shines by itself all over: the same light everywhere."""
    return lit(ball(1.0, 3), camera=view((0.1, 0.05, 0), (1, 0.2, 0.3), 80), materials=[grey(albedo, emission)])


def root_mean(renderer: Renderer) -> np.ndarray:
    known = cells(renderer)
    return known.energy(0, 1) / known.counts[0].sum()


@pytest.mark.parametrize("length", [0, 1, 2, 5])
@pytest.mark.parametrize("store", [1, 3])
def test_light_of_so_many_bounces_in_a_furnace(store, length):
    # Arriving after k bounces is emission * albedo^k, of which there are `length` + 1 terms.
    renderer = octree(inside(), (48, 48), store=store, length=length, roulette=64)
    for _ in renderer.frames(0, 2):
        pass
    expected = sum(ALBEDO**k for k in range(length + 1))
    assert root_mean(renderer) == pytest.approx(expected, rel=0.003)
    assert cells(renderer).counts[0].sum() == 2 * 48 * 48 * store


def test_roulette_does_not_change_the_mean():
    means = []
    with one_device():
        for seed in range(24):
            renderer = octree(inside(), (24, 24), store=3, length=5, roulette=1, seed=seed)
            next(renderer.frames(0, 1))
            means.append(root_mean(renderer)[0])
    expected = sum(ALBEDO**k for k in range(6))
    statistic = (np.mean(means) - expected) / stats.sem(means)
    assert abs(statistic) < stats.norm.isf(0.5e-3)  # significance 0.001


def test_deeper_vertices_get_light_of_as_many_bounces_as_the_first():
    renderer = octree(inside(), (64, 64), store=5, length=1, roulette=64, samples=1)
    next(renderer.frames(0, 1))
    known = cells(renderer)
    first, last = levels(renderer)[2]
    used = known.counts[first:last].max(axis=1) > 50
    assert used.sum() > 20
    light = np.where(known.counts[first:last, :1] > 0, known.front[first:last], known.back[first:last])[used]
    assert light == pytest.approx(1 + ALBEDO, rel=0.08)  # wherever it is


def test_what_a_surface_shines_with_itself_is_not_kept():
    scene = lit(floor(4), camera=view((0, 2, 3), (0, 0, 0)), materials=[grey(0.5, 7.0)])
    renderer = octree(scene)
    frame = next(renderer.frames(0, 1))
    assert cells(renderer).energy(0, 1).max() == 0
    hit = np.isfinite(frame.aov("Z", eye="mono")) if "Z" in renderer.aovs else frame.color["mono"][..., 0] > 0
    assert frame.color["mono"][hit] == pytest.approx(7.0)


def _images(scene, method, seeds, spp, size, **settings):
    made = []
    with one_device():
        for seed in seeds:
            if method == "octree":
                renderer = octree(scene, size, seed=seed, spp=spp, **settings)
            else:
                bounces = {"pathtrace.bounces": settings["bounces"]}
                renderer = Renderer(scene, "pathtrace", size, stereo=False, seed=seed, spp=spp, settings=bounces)
            made.append(next(renderer.frames(0, 1)).color["mono"])
    return made


def _scene(materials):
    return lit(
        floor(6), ball(0.8, 3, 1, smooth=True),
        camera=view((0, 2.0, 4), (0, 0.4, 0)), materials=materials,
        lights=[DirectionalLight((0.48, -0.8, 0.36), (2.0, 1.8, 1.5)), PointLight((1.5, 2.0, 1.0), (4.0, 4.0, 5.0))],
        environment=(0.3, 0.4, 0.5),
    )  # fmt: skip


MATERIALS = {
    "diffuse": Material("ball", (0.8, 0.3, 0.2)),
    "plastic": Material("ball", (0.8, 0.3, 0.2), specular=1.0, roughness=0.4),
    "metal": Material("ball", (0.9, 0.7, 0.4), metallic=1.0, specular=1.0, roughness=0.3),
    "mirror": Material("ball", (0.9, 0.9, 0.9), metallic=1.0, specular=1.0, roughness=0.0),
    "glass": Material("ball", (1.0, 1.0, 1.0), transmission=1.0, specular=1.0, roughness=0.0, ior=1.5),
}


@pytest.mark.parametrize("kind", ["diffuse", "metal", "mirror", "glass"])
@pytest.mark.parametrize("caching", [0.0, 1.0])
def test_images_agree_with_path_tracing(kind, caching):
    # A vertex behind a mirror gets as many bounces as the first: that makes no difference here. Without caching
    # everything is a miss, and what is left is path tracing split into layers. With it, cells of this size blur little.
    scene = _scene([grey(0.5), MATERIALS[kind]])
    options = {"caching_resolution": caching, "bounces": BOUNCES, "resolution": 512, "samples": 1, "jitter": 0.0}
    ours = _images(scene, "octree", range(8), 16, (24, 24), **options)
    theirs = _images(scene, "pathtrace", range(100, 108), 16, (24, 24), bounces=BOUNCES)
    pixels, blocks = agree(ours, theirs)
    assert pixels.passed and blocks.passed, (pixels, blocks)


def test_a_glossy_coat_takes_its_part_of_diffuse_light():
    # What it takes is that of evenly spread light: a small error of the mean remains.
    scene = _scene([grey(0.5), MATERIALS["plastic"]])
    ours = np.mean(_images(scene, "octree", range(8), 16, (24, 24), caching_resolution=0.0, bounces=BOUNCES), axis=0)
    theirs = np.mean(_images(scene, "pathtrace", range(100, 108), 16, (24, 24), bounces=BOUNCES), axis=0)
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.01)


def test_diffuse_light_under_a_coat_seen_at_a_flat_angle_has_no_outliers():
    # Under an even sky a sample is its own weight, 1 / chance of the diffuse part, which is at least one half.
    plastic = Material("plastic", (0.5, 0.5, 0.5), specular=1.0, roughness=0.3)
    scene = lit(floor(4), camera=view((0, 0.06, 2), (0, 0, 0), 20), materials=[plastic], environment=(1.0, 1.0, 1.0))
    renderer = octree(scene, (48, 48), store=1, length=0, samples=1, resolution=512, spp=2)
    next(renderer.frames(0, 1))
    known = cells(renderer)
    assert known.counts[0].sum() > 1000
    assert known.front.max() <= 2.002 and known.back.max() <= 2.002
    assert root_mean(renderer) == pytest.approx(1.0, abs=0.1)


def test_jitter_into_a_cell_that_knows_nothing_asks_the_own_one():
    scene = lit(floor(), camera=view((0, 3, 0.1), (0, 0, 0), 0.1), materials=[grey(0.5)], environment=(1.0, 1.0, 1.0))
    renderer = octree(scene, (16, 16), samples=1, jitter=0.5)
    counted = next(renderer.frames(0, 1)).stats["eyes"]["mono"]["cache"]
    assert counted["hits"] == counted["lookups"] == 256


@pytest.mark.parametrize(("part", "paths"), [(1.0, 30 * 22), (0.5, 15 * 11)])
def test_every_caching_path_hits_behind_a_near_plane(part, paths):
    scene = lit(floor(), camera=view((0, 3, 0.1), (0, 0, 0), near=1.0), materials=[grey(0.5)])
    renderer = octree(scene, (30, 22), store=1, length=0, caching_resolution=part)
    assert next(renderer.frames(0, 1)).stats["eyes"]["mono"]["cache"]["inserted"] == paths
