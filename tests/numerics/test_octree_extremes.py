"""The octree at the ends of its ranges. What is seen is chosen so that its colour is known: surfaces that all samples show as equally
bright, by a sun in the zenith, of pi W / m^2, over level ground, or a white sky about convex things.
"""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import along, at, counters, one_device, yard
from helpers import IDENTITY, make_mesh
from octree_renders import cells, levels, octree
from render_helpers import WHITE, ball, floor, grey, image, lit, view
from scipy import stats

from clcache.metrics import relmse
from clcache.scene.model import DirectionalLight, Material, PointLight

SUN = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
ABOVE = view((0, 3, 0.1), (0, 0, 0))
FRONT = view((0, 0, 3), (0, 0, 0))
ALL = ("albedo", "N", "Z", "voxel", "level", "count", "layer0", "filtered0")
LARGEST_HALF = 65504.0
LEAST_HALF = 2.0**-24


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def ground(*meshes, camera=ABOVE, albedos=(0.5,), **options):
    """Level ground under the sun, each as bright as its albedo is; the sky is black."""
    materials = [grey(a) for a in albedos]
    return lit(*(meshes or (floor(20),)), camera=camera, materials=materials, **{"lights": [SUN], **options})


def colors(renderer, count=3):
    """The images of so many frames, finite and not negative."""
    images = []
    for frame in renderer.frames(0, count):
        for color in frame.color.values():
            assert np.isfinite(color).all() and color.min() >= 0
        found = counters(frame, next(iter(frame.color)))
        assert found["hits"] + found["traced"] == found["lookups"]
        images.append(next(iter(frame.color.values())))
    return images


def direct(scene, size=(16, 16), **options):
    return octree(scene, size, **{"bounces": 0, **options})


# Sizes and views


@pytest.mark.parametrize("filtering", ["none", "bilateral"])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (5, 3), (1, 97), (65, 1), (13, 11)])
def test_image_sizes(size, filtering):
    """Every path of every size fills a cell, and every pixel is as bright as all."""
    of = direct(ground(floor(400)), size, aovs=ALL, filter=filtering, caching_resolution=1.0)
    for frame in of.frames(0, 3):
        np.testing.assert_allclose(frame.color["mono"], 0.5, rtol=1e-5)
        assert counters(frame)["lookups"] == size[0] * size[1]
        assert 0.9 * size[0] * size[1] <= counters(frame)["inserted"] <= size[0] * size[1]
        for name in ALL:
            assert frame.aov(name, "mono").shape[:2] == size[::-1] and not np.isnan(frame.aov(name, "mono")).any()


@pytest.mark.parametrize("degrees", [0.01, 1, 120, 179])
def test_fields_of_view(degrees):
    cameras = [view((0, 3, 0.1 + 0.01 * k), (0, 0, 0), degrees) for k in range(4)]
    for frame in direct(along(ground(floor(1e3)), cameras), aovs=("albedo",)).frames(0, 4):
        color, albedo = frame.color["mono"], frame.aov("albedo", "mono")
        whole = np.isclose(albedo, 0.5)
        assert whole.any() and color.min() >= 0
        np.testing.assert_allclose(color[whole], 0.5, rtol=1e-5)


def test_grazing_view():
    """A millimetre above a wide plane, on the way along it: below the horizon all is as bright as it is."""
    cameras = [view((0, 1e-3, -1e-4 * k), (0, 1e-3, -10), 20) for k in range(4)]
    *_, last = colors(direct(along(ground(floor(1000)), cameras), (32, 32)), 4)
    np.testing.assert_allclose(last[18:], 0.5, rtol=1e-5)
    assert not last[:14].any()


@pytest.mark.parametrize("apart", [0.0, 10.0])
def test_eyes_apart(apart):
    """Those in one place ask for the same cells; those far apart share nothing that they could spoil."""
    cameras = [view((0.1 * k, 3, 0.1), (0.1 * k, 0, 0)) for k in range(3)]
    scene = along(ground(floor(100), eye_distance=apart), cameras)
    of = direct(
        scene, stereo=True, filter="bilateral", stereo_blend="varianceblend", temporal="varianceblend", aovs=("level",)
    )
    for frame in of.frames(0, 3):
        for eye in ("left", "right"):
            np.testing.assert_allclose(frame.color[eye], 0.5, rtol=1e-4)
    left, right = (counters(frame, eye)["occupied"] for eye in ("left", "right"))
    assert (right > 1.5 * left) if apart and frame.number == 0 else right >= left


# Scale and place


def scaled(scene, scale, offset=(0, 0, 0)):
    """The scene made larger, then moved."""

    def moved(transform):
        return np.column_stack([transform[:, :3], scale * transform[:, 3] + np.asarray(offset, float)])

    meshes = tuple(replace(m, positions=m.positions * np.float32(scale)) for m in scene.meshes)
    instances = tuple(replace(i, transform=moved(np.asarray(i.transform, float))) for i in scene.instances)
    camera = replace(scene.camera, transform=moved(scene.camera.transform))
    return replace(scene, meshes=meshes, instances=instances, camera=camera)


def shiny_yard():
    """A diffuse ball and a rough metal one on a floor."""
    still = yard(moving=False)
    metal = Material("metal", (0.9, 0.7, 0.5), metallic=1.0, roughness=0.4)
    return replace(still, materials=(*still.materials[:2], metal))


@pytest.mark.parametrize("filtering", ["none", "bilateral"])
@pytest.mark.parametrize("scale", [2.0**-20, 2.0**20])
def test_scale_of_the_scene(scale, filtering):
    """A million times as small or as large: to the last bit the same, powers of two being exact. No length is built in."""
    options = {"bounces": 2, "filter": filtering}
    usual, other = (octree(scene, **options) for scene in (shiny_yard(), scaled(shiny_yard(), scale)))
    assert usual._parts.octree.cells == other._parts.octree.cells
    for a, b in zip(colors(usual, 2), colors(other, 2), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(*(of._graph.of()["octree_cells"].get() for of in (usual, other)))


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scales_that_are_not_exact(scale):
    """Rounding moves a few hits into other cells: the image's brightness is the same, and nearly all pixels are."""
    options = {"bounces": 2, "spp": 4}
    a, b = (colors(octree(scene, **options), 1)[0] for scene in (shiny_yard(), scaled(shiny_yard(), scale)))
    assert b.mean() == pytest.approx(a.mean(), rel=1e-2)
    assert np.median(np.abs(a - b)) < 0.02 * a.mean()


@pytest.mark.parametrize("offset", [1e3, 1e5, 1e7])
@pytest.mark.parametrize("resolution", [64, 4096])
def test_far_from_the_origin(offset, resolution):
    """Out there float32 has steps of up to a metre: ground of twenty is lit as ever, and what is seen of it is cached, in cells that are no finer than
    that."""
    size = 20.0 * max(offset / 1e5, 1.0)
    scene = ground(floor(1.0), instances=[(0, np.column_stack([size * np.eye(3), [offset, 0, -offset]]))],
                   camera=view((offset, 0.2 * size, -offset + 0.01 * size), (offset, 0, -offset)))  # fmt: skip
    of = direct(scene, resolution=resolution, samples=1)
    for color in colors(of):
        np.testing.assert_allclose(color, 0.5, rtol=1e-4)
    (frame,) = of.frames(3, 4)
    assert counters(frame)["hits"] > 0.95 * counters(frame)["lookups"] and counters(frame)["discarded"] < 0.02 * 256


@pytest.mark.parametrize("resolution", [64, 4096])
def test_resolutions_of_a_small_scene(resolution):
    """All that is lit is found in cells; in finer ones there are more of them."""
    of = octree(shiny_yard(), resolution=resolution, bounces=1, samples=1, filter="none")
    list(of.frames(0, 3))
    (frame,) = of.frames(3, 4)
    found = counters(frame)
    assert found["hits"] > 0.9 * found["lookups"] and found["discarded"] == 0
    report = of.stats()["octree"]
    assert report["resolution"] == resolution and len(report["levels"]) == resolution.bit_length()
    truth = image(shiny_yard(), (32, 24), 64, bounces=1)
    assert frame.color["mono"].mean() == pytest.approx(truth.mean(), rel=0.05)


# Geometry


def test_a_single_triangle():
    """Which the cube is about."""
    mesh = make_mesh(np.array([(-1.0, 0, -1), (1, 0, -1), (0, 0, 1)]), [(0, 2, 1)])
    of = direct(ground(mesh, camera=view((0, 1, 0.01), (0, 0, 0), 10)))
    for color in colors(of):
        np.testing.assert_allclose(color, 0.5, rtol=1e-5)
    assert of._parts.octree.cells > 1000


@pytest.mark.parametrize("paths", ["camera", "surfaces"])
def test_all_within_one_cell(paths):
    """A chip of glitter far from a grain: each is smaller than any cell, and lit as it is."""
    chip = make_mesh(1e-3 * np.array([(-1.0, 0, -1), (1, 0, -1), (0, 0, 1)]), [(0, 2, 1)])
    scene = ground(chip, camera=view((0, 1e-3, 1e-5), (0, 0, 0), 10), instances=[(0, IDENTITY), (0, at((3.0, 0, 0)))])
    of = direct(scene, paths=paths, gate=False, samples=1)
    for color in colors(of):
        np.testing.assert_allclose(color, 0.5, rtol=1e-5)
    begin, end = levels(of)[-1]
    assert end - begin <= 16 and (counters(next(of.frames(3, 4)))["hits"] == 256)


@pytest.mark.parametrize("paths", ["camera", "surfaces"])
def test_nothing_but_triangles_without_area(paths):
    """Points and lines: nothing is seen of them, and nothing breaks."""
    lines = make_mesh(np.array([(0.0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 1)]), [(0, 1, 2), (3, 3, 3), (0, 0, 1)])
    of = octree(ground(lines, environment=(0.3, 0.4, 0.5)), paths=paths, bounces=2)
    for frame in of.frames(0, 2):
        np.testing.assert_allclose(frame.color["mono"], np.broadcast_to((0.3, 0.4, 0.5), (24, 32, 3)), rtol=1e-6)
        assert counters(frame)["inserted"] == counters(frame)["lookups"] == 0
    assert not cells(of).counts.any()


def test_triangles_without_area_beside_others():
    """Paths from surfaces begin at none of them."""
    base = floor(20)
    lines = np.vstack([base.positions, [(0, 1, 0), (5, 1, 0), (9, 1, 0)]])
    both = make_mesh(lines, np.vstack([[(4, 5, 6)] * 50, base.triangles, [(4, 4, 4)] * 50]))
    of = direct(ground(both), (32, 24), paths="surfaces", store=1)
    for frame in of.frames(0, 2):
        assert counters(frame)["inserted"] == 768
        np.testing.assert_allclose(frame.color["mono"], 0.5, rtol=1e-5)


# Materials and lights


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.0, 1e-4, 1.0])
def test_roughness_at_its_ends(roughness, metallic):
    """A ball in the open under an even sky: as bright as path tracing has it, and nowhere brighter than the sky."""
    material = Material("m", (1.0, 1.0, 1.0), metallic=metallic, specular=1.0, roughness=roughness)
    scene = lit(ball(1, 3, smooth=True), camera=view((0, 0, 3), (0, 0, 0), 40), materials=[material], environment=WHITE)
    color = colors(octree(scene, (24, 24), bounces=3, spp=16), 1)[0]
    truth = image(scene, (24, 24), 64, bounces=3)
    assert color.mean() == pytest.approx(truth.mean(), rel=0.01)
    assert color[8:16, 8:16].mean() == pytest.approx(truth[8:16, 8:16].mean(), rel=0.02)
    assert color.max() < (1.001 if metallic else 2.5), "of a mirror on a diffuse base, that or this by chance"


@pytest.mark.parametrize("power", [1e-30, 1e-8, 1e-3, 1.0, 1e4])
def test_light_of_any_power(power):
    """What cells keep is light to half precision, in steps of 2^-24 at least, by chance: right on average."""
    sun = DirectionalLight((0.0, -1.0, 0.0), (power * np.pi,) * 3)
    scene = replace(ground(), lights=(sun,))
    for samples in (1, 8):
        for color in colors(direct(scene, samples=samples)):
            np.testing.assert_allclose(2 * color, power, rtol=2.0**-10, atol=LEAST_HALF)
    (traced,) = colors(direct(scene, caching_resolution=0.0), 1)
    np.testing.assert_allclose(2 * traced, power, rtol=1e-5)


def test_light_below_the_least_half_is_right_on_average():
    """Cells have it or not, by a chance that is in proportion: of 768 cells, 4.5 standard deviations about what is expected."""
    power = 0.2 * LEAST_HALF
    sun = DirectionalLight((0.0, -1.0, 0.0), (power * np.pi,) * 3)
    of = direct(replace(ground(), lights=(sun,)), (64, 48), resolution=512, samples=1, jitter=0.0, store=1)
    next(of.frames(0, 1))
    known, (begin, end) = cells(of), levels(of)[-1]
    used = np.flatnonzero(known.counts[begin:end].sum(axis=1)) + begin
    values = np.maximum(known.front, known.back)[used, 0] / LEAST_HALF
    assert len(used) > 500 and set(np.unique(values)) == {0.0, 1.0}
    assert stats.binomtest(int(values.sum()), len(used), 0.2).pvalue > 1e-3


@pytest.mark.parametrize("power", [1e8, 1e30])
def test_light_beyond_halves_saturates_in_cells(power):
    """At the largest half; what is traced knows no such bound."""
    sun = DirectionalLight((0.0, -1.0, 0.0), (power * np.pi,) * 3)
    scene = replace(ground(), lights=(sun,))
    for color in colors(direct(scene)):
        np.testing.assert_allclose(2 * color, LARGEST_HALF, rtol=1e-5)
    (traced,) = colors(direct(scene, caching_resolution=0.0), 1)
    np.testing.assert_allclose(2 * traced, power, rtol=1e-5)


def test_strong_light_beside_a_weak_one():
    """1e8 from behind the surface and 1e-8 from above: what is seen is the weak one alone, by chance, and no cell has anything of the strong
    one. With both above, cells saturate."""
    weak, camera = PointLight((0, 2, 0), (1e-8,) * 3), view((0, 3, 0.1), (0, 0, 0), 0.1)
    for height in (-2, 2):
        scene = lit(floor(), camera=camera, lights=[weak, PointLight((0, height, 0), (1e8,) * 3)])
        color = colors(direct(scene, spp=16, jitter=0.0), 1)[0]
        if height > 0:
            np.testing.assert_allclose(color, LARGEST_HALF, rtol=1e-5)
        else:
            assert color.max() <= 2 * LEAST_HALF


def test_a_bright_spot_does_not_overflow_what_is_beside_it():
    """A lamp of 1e8 just over the ground: its spot saturates, and the rest falls with the square of the distance, to the cells' width."""
    scene = ground(lights=[PointLight((0, 0.5, 0), (1e6,) * 3)], camera=view((0, 12, 0.1), (0, 0, 0), 60))
    color = colors(direct(scene, (48, 48), resolution=512, samples=1, jitter=0.0, spp=4), 1)[0][..., 0]
    assert color.max() <= 0.5 * LARGEST_HALF * 1.001 and color.max() > 1e4
    truth = np.minimum(image(scene, (48, 48), 64, bounces=0)[..., 0], 0.5 * LARGEST_HALF)
    assert np.median(np.abs(color / truth - 1)) < 0.1


# Numbers


def test_hundreds_of_updates_of_a_still_view():
    """Converged, but for the cells' width, to the path tracer's image, and finite."""
    scene = replace(yard(moving=False), camera=view((3, 2.5, 0.8), (1.8, 0, 0.2), 10))
    of = octree(scene, (4, 4), spp=300, bounces=0, resolution=256)
    (frame,) = of.frames(0, 1)
    assert relmse(frame.color["mono"], image(scene, (4, 4), 4096, bounces=0)) < 1e-3
    assert int(of._graph.of()["estimate_of"].get()[18]) == 300


def test_counts_saturate_and_means_stay():
    """The root has the most samples that are counted, and says what all say."""
    of = direct(ground(), (96, 96), samples=1)
    list(of.frames(0, 10))
    known = cells(of)
    assert known.counts.max() == known.counts[0].max() == 65535 > known.counts[-1].max()
    np.testing.assert_array_equal(known.front[known.counts[:, 0] > 0], 1.0)


@pytest.mark.parametrize("seed", [0, 2**32, 2**63, 2**64 - 1])
def test_seeds(seed):
    """Ground in the light, and noise of its own for each."""
    of, other = (direct(ground(environment=WHITE, lights=()), seed=s, jitter=0.0) for s in (seed, (seed + 1) % 2**64))
    colors(of, 1), colors(other, 1)
    keys = [o._graph.of()["octree_cells"].get()[:, 4] for o in (of, other)]
    assert not np.array_equal(*keys)


@pytest.mark.parametrize("setting", [{"jitter": 2.0, "level_bias": -4.0}, {"level_bias": 4.0}, {"store": 16, "length": 0},
                                     {"samples": 65535, "gate": False}, {"caching_resolution": 1e-6},
                                     {"length": 64, "store": 1}], ids=str)  # fmt: skip
def test_settings_at_their_ends(setting):
    """Even ground is even."""
    for color in colors(octree(ground(), (16, 16), filter="bilateral", bounces=1, **setting), 2):
        np.testing.assert_allclose(color, 0.5, rtol=1e-4)
