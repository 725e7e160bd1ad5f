"""The layered filter's kernels against the model of `layered_filter_model.py`, against closed forms, and at extremes."""

import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from layered_filter_model import (
    BLUR,
    KAPPA_COLOR,
    KAPPA_LIGHT,
    LOBE,
    PLANES,
    SETTINGS,
    TAPS,
    OnDevice,
    make_layer,
    run,
)
from skimage.color import rgb2lab

from clcache.errors import SettingError
from clcache.passes.octree_filter import SHOWN, filter_buffers, filter_passes

SIZES = ((1, 1), (5, 3), (9, 16), (20, 17), (33, 50))  # rows, columns
AOVS = tuple(f"aov_{kind}{i}" for kind in ("layer", "filtered") for i in range(SHOWN))
OFF = {f"octree.filter_{name}": 0.0 for name in ("depth", "segment", "albedo", "albedo_glossy", "luminance")}


def some_layers(shape, count, seed):
    """Patches of few surfaces, with noise; pixels without a vertex, of the background, without a diffuse part, unknown, mirrors."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        patch = rng.integers(0, 3, (shape[0] // 4 + 1, shape[1] // 4 + 1)).repeat(4, 0).repeat(4, 1)
        patch = patch[: shape[0], : shape[1]]
        normal = rng.normal(size=(3, 3))
        depth = np.choose(patch, (1.0, 1.02, 2.0)) + 0.01 * np.arange(shape[1]) + 2e-3 * rng.random(shape)
        depth[rng.random(shape) < 0.05] = np.inf
        depth[rng.random(shape) < (0.2 if i else 0)] = 0
        yield make_layer(
            shape,
            light=rng.gamma(4, 0.25, (*shape, 1)) * rng.uniform(0.5, 1, (*shape, 3)),
            albedo=rng.random((3, 3))[patch] * (rng.random((*shape, 1)) < 0.8),
            own=rng.random((*shape, 3)) * (rng.random((*shape, 1)) < 0.3),
            **{"pass": rng.random((*shape, 3)) * (rng.random((*shape, 1)) < 0.7)},
            normal=(normal / np.linalg.norm(normal, axis=1)[:, None])[patch],
            depth=depth,
            segment=np.where(
                rng.random(shape) < 0.8, np.choose(patch, (0.5, 1, np.inf)) * rng.uniform(1, 1.01, shape), 0
            ),
            roughness=rng.choice([0, 0.2, 0.6, 1], shape),
            count=rng.choice([0, 1, 8, 100, 65535], shape, p=[0.1, 0.2, 0.3, 0.2, 0.2]),
        )


def pair(**both):
    """Two pixels side by side, so that each is the other's only tap."""
    return make_layer((1, 2), **{name: np.asarray(values)[None] for name, values in both.items()})


def weight_between(device, layer, **scales):
    """The weight that the second of two pixels of E has for the first, beside its own: E is 1 and 2, in grey."""
    image = OnDevice(device, [layer], SETTINGS | OFF | {f"octree.filter_{k}": v for k, v in scales.items()}).run()
    first, second = layer["light"][0, :, 0]
    mean = image[0, 0, 0] / layer["albedo"][0, 0, 0]
    return (mean - first) / (second - mean)


def two_greys(**rest):
    """Two pixels whose E is 1 and 2."""
    return pair(light=[[1.0] * 3, [2.0] * 3], **rest)


def assert_same(image, expected):
    """But where all weights of a hole nearly vanish: rounding then says which is the most."""
    assert np.isfinite(image).all()
    assert (np.abs(image - expected) < 2e-4).mean() > 0.995


@pytest.mark.parametrize("changed", [{}, {"octree.layered": False}, {"octree.filter": "none"}], ids=str)
@pytest.mark.parametrize("shape", SIZES, ids=str)
def test_all_layers_are_as_the_model_says(device, shape, changed):
    """Of images smaller than the pattern of taps, or than a run, and before and after each layer's filter."""
    chosen, layers = SETTINGS | changed, list(some_layers(shape, 4, 1))
    kernels = OnDevice(device, layers, chosen, AOVS)
    image = kernels.run()
    after, before = run(layers, chosen, kernels.pixel_angle)
    assert_same(image, after[0])
    for i in range(SHOWN):
        assert_same(kernels.picture(f"aov_filtered{i}"), after[i])
        assert_same(kernels.picture(f"aov_layer{i}"), before[i])


@pytest.mark.parametrize("kind", ["bilateral", "none", "oidn"])
@pytest.mark.parametrize("layered", [True, False])
def test_what_shines_by_itself_is_not_filtered(device, kind, layered):
    """It is added to each layer's light, and passed on as that."""
    if kind == "oidn":
        pytest.importorskip("pyoidn")
    shape, chosen = (32, 50), SETTINGS | {"octree.filter": kind, "octree.layered": layered}
    rng = np.random.default_rng(16)
    mirror = make_layer(shape, albedo=np.zeros((*shape, 3)), **{"pass": np.full((*shape, 3), 0.5)})
    lamps = make_layer(shape, albedo=np.zeros((*shape, 3)), roughness=np.ones(shape))
    mirror["emitted"], lamps["emitted"] = rng.random((2, *shape, 3))
    lamps["emitted"][rng.random(shape) < 0.1] = 0
    lamps["depth"][:, 40:] = np.inf
    image = OnDevice(device, [mirror, lamps], chosen).run()
    if layered or kind == "none":
        np.testing.assert_allclose(image, mirror["emitted"] + 0.5 * lamps["emitted"], rtol=1e-5, atol=1e-4)
    assert (image >= mirror["emitted"] * 0.9999).all()


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(1, 20),
    columns=st.integers(1, 40),
    scales=st.tuples(*[st.sampled_from([0, 0.5, 1, 30])] * 6),
)
def test_any_factors(device, seed, rows, columns, scales):
    names = ("normal", "depth", "segment", "albedo", "albedo_glossy", "luminance")
    chosen = SETTINGS | {f"octree.filter_{name}": float(scale) for name, scale in zip(names, scales, strict=True)}
    layers = list(some_layers((rows, columns), 2, seed))
    kernels = OnDevice(device, layers, chosen)
    after, _ = run(layers, chosen, kernels.pixel_angle)
    wrong = np.abs(kernels.run() - after[0]) > 2e-3  # where all weights nearly vanish, rounding says which is the most
    assert wrong.mean() < 0.02


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2, 2.0])
@pytest.mark.parametrize("scale", [0.5, 1.0, 1.5])
def test_equation_2_normals(device, angle, scale):
    layer = two_greys(normal=[[0, 0, 1], [np.sin(angle), 0, np.cos(angle)]])
    expected = np.clip(scale * max(np.cos(angle), 0), 0, 1)
    assert weight_between(device, layer, normal=scale) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("other", [2.0, 2.002, 2.01, 1.999, 2.03])
def test_equation_3_lengths_of_paths(device, other):
    layer = two_greys(depth=[2.0, other])
    expected = np.clip(1 - 100 * abs(2 / other - 1), 0, 1)
    assert weight_between(device, layer, depth=100.0) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("other", [3.0, 3.003, 3.006, 2.999, 3.1])
def test_equation_4_lengths_of_segments(device, other):
    """Of surfaces that are nearly mirrors, seen through a microscope: their lobes explain no difference."""
    rough = 1e-3
    layer = pair(
        own=[[1.0] * 3, [2.0] * 3], segment=[3.0, other], roughness=[rough] * 2, albedo=np.zeros((2, 3)), depth=[1, 1]
    )
    chosen = SETTINGS | OFF | {"octree.filter_segment": 400.0}
    image = OnDevice(device, [layer], chosen, pixel_angle=1e-9).run()
    first = image[0, 0, 0]
    expected = np.clip(1 - 400 * max(abs(3 / other - 1) - LOBE * rough**2, 0), 0, 1)
    reach = BLUR * rough**2 * (3 / 4) / 1e-9  # of a surface without diffuse part
    assert (first - 1) / (2 - first) == pytest.approx(expected * (1 - reach**-2), abs=1e-4)


@pytest.mark.parametrize("color", [(0.5, 0.5, 0.5), (0.5, 0.52, 0.5), (0.45, 0.5, 0.5), (0.001, 0.002, 0.001)])
def test_equation_5_albedo(device, color):
    """Against another implementation of L*a*b*, whose white and primaries have fewer digits."""
    albedo = np.array([(0.5, 0.5, 0.5) if max(color) > 0.01 else (0.001, 0.001, 0.001), color])
    encoded = np.where(albedo > 0.0031308, 1.055 * albedo ** (1 / 2.4) - 0.055, 12.92 * albedo)
    apart = np.log1p(KAPPA_COLOR * np.linalg.norm(np.subtract(*rgb2lab(encoded)))) / KAPPA_COLOR
    layer = two_greys(albedo=albedo)
    expected = np.clip(1 - 4 * apart / (apart + 1), 0, 1)
    assert 0 < expected <= 1
    assert weight_between(device, layer, albedo=4.0) == pytest.approx(expected, abs=3e-3)


@pytest.mark.parametrize("counts", [(1, 1), (8, 8), (1, 65535), (500, 20)])
@pytest.mark.parametrize("other", [1.0, 1.05, 2.0, 10.0])
def test_equation_6_light(device, counts, other):
    """A difference counts by how many standard deviations of its noise it is; and a tap weighs by its samples."""
    layer = pair(light=[[1.0] * 3, [other] * 3], count=counts)
    samples = counts[0] * counts[1] / sum(counts)
    apart = KAPPA_LIGHT * np.sqrt(samples) * abs(other - 1) / (other + 1)
    weight = max(0, 1 - np.log(1 + 3 * apart / (apart + 1))) * counts[1]
    image = OnDevice(device, [layer], SETTINGS | OFF | {"octree.filter_luminance": 3.0}).run()
    expected = (counts[0] + weight * other) / (counts[0] + weight)
    assert image[0, 0, 0] / 0.5 == pytest.approx(expected, rel=1e-5)


def test_the_pattern_of_taps(device):
    """What one bright pixel gives to each other, of all alike, is its part of the mean of all that are taps; and no other has any."""
    shape = (21, 37)
    light = np.zeros((*shape, 3))
    light[10, 18] = 1
    image = OnDevice(device, [make_layer(shape, light=light)], SETTINGS | OFF).run()[..., 0] / 0.5
    row, column = np.nonzero(image)
    found = {(int(c), int(r)) for r, c in zip(row - 10, column - 18, strict=True)}
    assert found == {(0, 0)} | {(int(c), int(r)) for c, r in TAPS}
    assert image[10, 18] == pytest.approx(1 / (len(TAPS) + 1))


@pytest.mark.parametrize("kind", ["bilateral", "none"])
def test_layers_are_joined_by_throughput(device, kind):
    """Light that is the same everywhere: S_0 + C_0 E_0 + T_0 (S_1 + C_1 E_1 + T_1 (...)), filtered or not."""
    rng, shape = np.random.default_rng(3), (11, 23)
    layers, image, throughput = [], np.zeros(3), np.ones(3)
    guides = list(some_layers(shape, 4, 5))
    for guide in guides:
        parts = {name: rng.random(3) * np.ones((*shape, 3)) for name in ("light", "albedo", "own", "pass")}
        guide |= {"depth": np.where(guide["depth"] > 0, np.minimum(guide["depth"], 9), 1), "count": guide["count"] + 1}
        layers.append(guide | parts)
        image = image + throughput * (parts["own"][0, 0] + parts["albedo"][0, 0] * parts["light"][0, 0])
        throughput = throughput * parts["pass"][0, 0]
    found = OnDevice(device, layers, SETTINGS | {"octree.filter": kind}).run()
    np.testing.assert_allclose(found, np.broadcast_to(image, found.shape), rtol=1e-5)


def test_filtered_light_is_among_what_is_averaged(device):
    """No filter makes a pixel brighter or darker than all."""
    layers = list(some_layers((24, 40), 1, 7))
    layers[0] |= {"own": np.zeros((24, 40, 3)), "albedo": np.ones((24, 40, 3)), "count": layers[0]["count"] + 1}
    image = OnDevice(device, layers, SETTINGS).run()
    there = np.isfinite(layers[0]["depth"])
    light = layers[0]["light"][there]
    assert (image[there] <= light.max(0) * 1.0001).all()
    assert (image[there] >= light.min(0) * 0.9999).all()


def halves(shape, **of_right):
    """A picture whose left half is noise about 1, and whose right half is 1000 times as bright; and where that begins."""
    rng, middle = np.random.default_rng(2), shape[1] // 2
    light = rng.uniform(0.5, 1.5, (*shape, 1)) * np.ones(3)
    light[:, middle:] *= 1000
    layer = make_layer(shape, light=light, own=light, roughness=np.full(shape, 1.0), segment=np.full(shape, 1.0))
    for name, value in of_right.items():
        layer[name][:, middle:] = value
    return layer, middle


@pytest.mark.parametrize(
    "of_right",
    [{"depth": 3.0}, {"depth": np.inf}, {"depth": 0.0}, {"normal": [1, 0, 0]}],
    ids=str,
)
def test_nothing_crosses_an_edge(device, of_right):
    """The left half is the same as if the image ended there, whatever the light's noise may explain."""
    layer, middle = halves((20, 40), **of_right)
    chosen = SETTINGS | {"octree.filter_luminance": 0.0}
    alone = {name: plane[:, :middle] for name, plane in layer.items()}
    whole = OnDevice(device, [layer], chosen).run()[:, :middle]
    np.testing.assert_allclose(whole, OnDevice(device, [alone], chosen).run(), rtol=1e-6)


def test_a_floor_at_a_grazing_angle_is_filtered(device):
    """Where rows are as far as 5 % of the distance from each other, and samples anywhere in their pixels."""
    rng, shape = np.random.default_rng(4), (60, 64)
    row = np.arange(60)[:, None] + rng.uniform(-0.5, 0.5, shape)
    layer = make_layer(
        shape, light=rng.gamma(4, 0.25, (*shape, 1)) * np.ones(3), depth=20 / (1 + row), count=np.full(shape, 8)
    )
    part = np.s_[15:, 8:-8]
    image = OnDevice(device, [layer], SETTINGS).run()[part] / 0.5
    assert image.var() < 0.2 * layer["light"][part].var()


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_do_not_matter(device, scale):
    """Neither of length, nor of light."""
    layers = list(some_layers((24, 40), 3, 9))
    image = OnDevice(device, layers, SETTINGS).run()
    longer = [layer | {"depth": scale * layer["depth"], "segment": scale * layer["segment"]} for layer in layers]
    np.testing.assert_allclose(OnDevice(device, longer, SETTINGS).run(), image, atol=2e-4)
    brighter = [layer | {"light": scale * layer["light"], "own": scale * layer["own"]} for layer in layers]
    np.testing.assert_allclose(OnDevice(device, brighter, SETTINGS).run() / scale, image, atol=2e-4)


def test_holes_are_filled(device):
    """What is not known takes the mean of what is about it, and gives nothing, whatever it holds."""
    rng, shape = np.random.default_rng(5), (20, 40)
    is_hole = rng.random(shape) < 0.4
    light = np.where(is_hole[..., None], 1e6, 1.0) * np.ones(3)
    image = OnDevice(device, [make_layer(shape, light=light, count=np.where(is_hole, 0.0, 9.0))], SETTINGS).run()
    np.testing.assert_allclose(image, 0.5, rtol=1e-5)


def test_a_surface_that_is_not_diffuse_gives_no_light(device):
    """Its E says nothing, and does not reach its neighbours."""
    shape = (6, 20)
    albedo, light = np.full((*shape, 3), 0.5), np.ones((*shape, 3))
    albedo[:, ::2], light[:, ::2] = 0, 7
    chosen = SETTINGS | {"octree.filter_albedo": 0.0}
    image = OnDevice(device, [make_layer(shape, light=light, albedo=albedo)], chosen).run()
    np.testing.assert_allclose(image, albedo, rtol=1e-5)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_stay_alone(device, bad):
    """Such a light is a hole; such a rest is replaced by its neighbours' where it may be filtered, else black."""
    shape = (9, 40)
    light, own = np.ones((*shape, 3)), np.ones((*shape, 3))
    light[4, 10, 1], own[4, 30, 2] = bad, bad
    image = OnDevice(device, [make_layer(shape, light=light, own=own, roughness=np.full(shape, 0.8))], SETTINGS).run()
    expected = np.full((*shape, 3), 1.5)
    expected[4, 30] = 0.5
    np.testing.assert_allclose(image, expected, rtol=1e-5)


def test_what_is_no_vertex_may_hold_anything(device):
    """Planes of pixels without a vertex, and those of the layer behind, are not looked at."""
    layers = list(some_layers((24, 60), 3, 11))
    image = OnDevice(device, layers, SETTINGS, AOVS).run()
    for layer in layers:
        for name in PLANES:
            if name != "depth":
                layer[name][layer["depth"] == 0] = np.nan
    other = OnDevice(device, layers, SETTINGS, AOVS)
    np.testing.assert_array_equal(other.run(), image)
    assert all(np.isfinite(other.picture(name)).all() for name in AOVS)


def test_guides_of_the_layer_behind_are_not_taken_for_those_of_the_background(device):
    """Neither where a whole run of pixels has no vertex; nor is there light where there is nothing at all."""
    shape = (12, 48)
    depth = np.where(np.arange(48) < 16, 1.0, np.inf) * np.ones(shape)
    depth[5, 3] = 0
    front = make_layer(shape, depth=depth, own=np.full((*shape, 3), 0.25), count=np.full(shape, 8))
    behind = make_layer(shape, light=np.full((*shape, 3), 1e6), own=np.full((*shape, 3), 1e6), roughness=np.ones(shape))
    image = OnDevice(device, [front, behind], SETTINGS | OFF).run()
    expected = np.where(np.isfinite(depth), 0.75, 0.25)
    expected[5, 3] = 0
    np.testing.assert_allclose(image, expected[..., None] * np.ones(3), rtol=1e-5)


def test_a_coat_does_not_show_what_the_metal_beside_it_reflects(device):
    """Nor is what is rough averaged with what is polished."""
    shape = (12, 40)
    is_left = np.arange(40) < 20
    own = np.where(is_left, 1.0, 100.0)[None, :, None] * np.ones((*shape, 3))
    rough, half = np.full(shape, 0.5), np.where(is_left, 0.5, 0.0)[None, :, None] * np.ones((*shape, 3))
    chosen = SETTINGS | {"octree.filter_albedo_glossy": 0.0}
    of_metal = make_layer(shape, own=own, albedo=half, light=0 * own, roughness=rough)
    np.testing.assert_allclose(OnDevice(device, [of_metal], chosen).run(), own, rtol=1e-5)
    of_polished = make_layer(shape, own=own, light=0 * own, roughness=np.where(is_left, 0.5, 0.8) * np.ones(shape))
    np.testing.assert_allclose(OnDevice(device, [of_polished], chosen).run(), own, rtol=1e-5)
    beside_mirror = make_layer(shape, own=own, light=0 * own, roughness=np.where(is_left, 0.1, 0) * np.ones(shape))
    np.testing.assert_allclose(OnDevice(device, [beside_mirror], chosen).run(), own, rtol=1e-5)


def test_paths_that_ended_are_of_the_same_surface(device):
    """A coat of which few pixels' paths went on, that weigh as much as all: the mean neither gains nor loses."""
    rng, shape = np.random.default_rng(15), (48, 64)
    goes_on = rng.random(shape) < 0.2
    own = np.where(goes_on, 5.0, 0.0)[..., None] * np.ones(3)
    segment = np.where(goes_on, 3.0, 0.0)
    layer = make_layer(shape, own=own, light=0 * own, roughness=np.full(shape, 0.5), segment=segment)
    image = OnDevice(device, [layer], SETTINGS).run()
    assert image.mean() == pytest.approx(own.mean(), rel=0.03)
    assert image[8:-8, 8:-8].var() < 0.06 * own.var()


def reflections(roughness, segment):
    """A surface without diffuse part whose reflections are noise."""
    rng, shape = np.random.default_rng(6), (30, 60)
    own = rng.gamma(4, 0.25, (*shape, 1)) * np.ones(3)
    planes = {"roughness": np.full(shape, roughness), "segment": np.full(shape, segment)}
    return make_layer(shape, own=own, albedo=np.zeros((*shape, 3)), **planes)


def test_mirrors_stay_sharp_and_rough_surfaces_do_not(device):
    """By roughness, and by how far what is reflected is away: at an object's foot a polished floor shows it sharply."""
    spread = {}
    for roughness, segment in ((0, 5), (0.1, 5), (1, 5), (0.1, 1e-3), (1, 0.0)):
        layer = reflections(roughness, segment)
        part = OnDevice(device, [layer], SETTINGS).run()[8:-8, 8:-8]
        spread[roughness, segment] = part.var() / layer["own"][8:-8, 8:-8].var()
    assert spread[0, 5] == pytest.approx(1, abs=1e-6)
    assert spread[0.1, 1e-3] == pytest.approx(1, abs=1e-6)
    assert spread[1, 5] < 0.15
    assert spread[1, 0.0] < 0.15
    assert spread[1, 5] < spread[0.1, 5] < 0.5


def test_noise_behind_a_mirror_is_filtered_in_its_own_layer(device):
    """The mirror shows the second layer filtered; by the first layer's guides alone, what is behind it is blurred across its edge."""
    rng, shape = np.random.default_rng(8), (30, 60)
    edge = np.where(np.arange(60) < 30, 1.0, 4.0)[None, :, None] * np.ones((*shape, 3))
    light = rng.gamma(16, 1 / 16, (*shape, 1)) * np.ones(3)
    mirror = make_layer(shape, albedo=np.zeros((*shape, 3)), **{"pass": np.ones((*shape, 3))})
    wall = make_layer(
        shape, light=light * edge, depth=2 + (edge[..., 0] > 2), albedo=np.ones((*shape, 3)), count=np.full(shape, 16)
    )
    errors = {}
    for layered in (True, False):
        chosen = SETTINGS | {"octree.layered": layered}
        errors[layered] = (OnDevice(device, [mirror, wall], chosen).run() / edge - 1).std()
    assert errors[True] < 0.45 * light.std()
    assert errors[True] < 0.8 * errors[False]


@pytest.mark.parametrize("count", [1, 8, 64, 512, 4096, 65535])
def test_the_filter_fades_as_cells_converge(device, count):
    """Edges and gradients in the light: much less error where cells have few samples, and hardly ever more."""
    rng, shape = np.random.default_rng(10), (64, 96)
    row, column = np.indices(shape)
    true = np.where(column < 48, 0.25, 1.0) * (0.5 + row / 64) * np.where((row // 8 + column // 8) % 2, 1, 0.6)
    light = true * rng.gamma(count, 1 / count, shape)
    layer = make_layer(shape, light=light[..., None] * np.ones(3), count=np.full(shape, count))
    image = OnDevice(device, [layer], SETTINGS).run()[..., 0] / 0.5
    before, after = (np.mean((v / true - 1) ** 2) for v in (light, image))
    assert after < (0.35 if count == 1 else 1.05) * before


def test_what_does_not_run_is_not_asked_for(device):
    """Pictures of layers cost nothing unless wanted; those of layers that there are not are black."""
    layers = list(some_layers((5, 20), 1, 12))
    assert {p.name for p in OnDevice(device, layers, SETTINGS).graph.passes} == {"filter"}
    shown = OnDevice(device, layers, SETTINGS, ("aov_layer2", "aov_filtered1"))
    shown.run()
    assert not shown.picture("aov_layer2").any()
    assert not shown.picture("aov_filtered1").any()


def test_the_same_bits_for_any_group_of_work_items(device, other_groups):
    layers = list(some_layers((33, 50), 3, 13))
    images = [OnDevice(d, layers, SETTINGS).run() for d in (device, device, other_groups)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


@pytest.mark.parametrize("layered", [True, False])
def test_what_glossy_surfaces_show_is_weighed_in_layers_only(device, layered):
    layers, images = list(some_layers((20, 40), 2, 17)), []
    for factor in (0.0, 1e3):
        chosen = {"octree.filter_segment": factor, "octree.filter_albedo_glossy": factor, "octree.layered": layered}
        images.append(OnDevice(device, layers, SETTINGS | chosen).run())
    assert np.array_equal(*images) is not layered


def test_declared_buffers_are_those_that_passes_use(device):
    for kind in ("bilateral", "none"):
        chosen = SETTINGS | {"octree.filter": kind}
        names = {b.name for b in filter_buffers(2, (8, 8), chosen)}
        written = {name for p in filter_passes(device, (8, 8), 2, chosen) for name in p.writes}
        assert written - names == set()
        assert names - written <= {"filter_guides"}


class TestOpenImageDenoise:
    """Where its package is installed, or is not."""

    def test_without_the_package(self, device, monkeypatch):
        monkeypatch.setitem(sys.modules, "pyoidn", None)
        with pytest.raises(
            SettingError, match="octree.filter: 'oidn' needs the package pyoidn .*: pip install pyoidn$"
        ):
            filter_passes(device, (8, 8), 2, SETTINGS | {"octree.filter": "oidn"})

    @pytest.mark.parametrize("layered", [True, False])
    def test_noise_is_removed_the_same_way_each_time(self, device, layered):
        pytest.importorskip("pyoidn")
        rng, shape = np.random.default_rng(14), (64, 96)
        own, light = (rng.gamma(2, 0.5, (*shape, 1)) * np.ones(3) for _ in range(2))
        front = make_layer(shape, light=light, own=own, roughness=np.full(shape, 0.5), **{"pass": np.ones((*shape, 3))})
        behind = make_layer(shape, light=light, depth=np.where(np.arange(96) < 48, 2.0, 0.0) * np.ones(shape))
        kernels = OnDevice(device, [front, behind], SETTINGS | {"octree.filter": "oidn", "octree.layered": layered})
        image = kernels.run()
        np.testing.assert_array_equal(kernels.run(), image)
        inner = np.s_[16:-16, 60:-16]
        assert np.abs(image[inner] - 1.5).mean() < 0.2 * np.abs(own + 0.5 * light - 1.5)[inner].mean()

    def test_a_mirror_stays_sharp(self, device):
        pytest.importorskip("pyoidn")
        layer = reflections(0.5, 5.0)
        layer["roughness"][:, :30] = 0
        image = OnDevice(device, [layer], SETTINGS | {"octree.filter": "oidn"}).run()
        np.testing.assert_allclose(image[:, :30], layer["own"][:, :30], rtol=1e-6)
        assert image[:, 30:].var() < 0.3 * layer["own"][:, 30:].var()
