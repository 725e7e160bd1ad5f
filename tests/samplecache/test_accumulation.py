"""What new values do to a sample's radiance: means, exponential averages, what follows the view, and what float32 can still add."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cache_renders import cached, held, one_device
from helpers import make_mesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from render_helpers import everything, grey, lit, view

from clcache.passes.radiance import Accumulate
from clcache.renderer import camera_record
from clcache.resources import SceneResources
from clcache.scene.model import Material, Texture, TextureUse

MOST = 65_534
LEAST_ALBEDO = 0.05  # by which radiance is divided at least
UNIT_ROUNDOFF = 2.0**-24
PLACES = 64  # of a batch
CAMERA = view((0, 0, 5), (0, 0, 0))

# Of 300 materials so that their numbers take both bytes that a first hit has for them.
METALS = [Material("metal", (0.7, 0.9, 0.2), metallic=1.0, roughness=r) for r in (0.0, 0.5, 1.0)]
DIELECTRICS = [
    Material("lambert", (0.8, 0.2, 0.1), roughness=0.3),
    Material("gloss", (0.8, 0.2, 0.1), specular=1.0, roughness=0.3),
    Material("tinted", (0.1, 0.5, 0.3), specular=0.7, specular_color=(0.2, 0.9, 0.4), ior=1.8, roughness=0.1),
    Material("glass", (1.0, 1.0, 1.0), specular=1.0, transmission=1.0, roughness=0.0),
    Material("milk", (0.9, 0.9, 0.8), specular=1.0, transmission=0.4, ior=1.33, roughness=0.6),
    Material("half", (0.5, 0.6, 0.4), metallic=0.5, specular=1.0, roughness=0.2),
    Material("black", (0.0, 0.0, 0.0), roughness=0.5),
    Material("black gloss", (0.0, 0.0, 0.0), specular=1.0, roughness=0.25),
    Material("diamond", (0.4, 0.4, 0.4), specular=1.0, ior=1e4, roughness=0.7),
]
MATERIALS = [*METALS, *DIELECTRICS, *[grey(0.5)] * 288]
MATERIALS[-1] = replace(METALS[0], name="last")


def wall(materials, textures=()):
    """A triangle of each material."""
    corner = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], float)
    positions = np.concatenate([corner + [0, 0, -0.01 * i] for i in range(len(materials))])
    mesh = make_mesh(positions, np.arange(len(positions)))
    mesh = replace(
        mesh,
        material=np.arange(len(materials), dtype=np.uint32),
        uvs=np.tile([0.5, 0.5], (len(positions), 1)).astype(np.float32),
    )
    mesh.uvs[1::3], mesh.uvs[2::3] = (0.6, 0.5), (0.5, 0.6)
    return lit(mesh, camera=CAMERA, materials=materials, textures=textures, environment=(1.0, 1.0, 1.0))


def reflecting(brightness: float, base: float, m: Material) -> float:
    """Appendix C's least part, by how much of what the surface reflects head on follows the view."""
    facing = m.specular * max(m.specular_color) * ((m.ior - 1) / (m.ior + 1)) ** 2
    gloss, rest = min(facing, 1), 1 - m.metallic
    follows = m.metallic * base + rest * gloss + rest * (1 - gloss) * base * m.transmission
    stays = rest * (1 - gloss) * base * (1 - m.transmission)
    return 0 if follows + stays == 0 else follows / (follows + stays) * brightness


def least_part(m: Material) -> float:
    alpha = m.roughness**2
    return reflecting((1 - alpha) * 0.5 + alpha * 0.1, max(m.base_color), m)


class Accumulator:
    """Samples of which each lies on the triangle whose number is its material's, and what comes to them."""

    def __init__(self, device, scene, materials, alpha=0.0, demodulate=False, count=0, radiance=0.0):
        """materials: of each sample, a number. count, radiance: what the samples have."""
        self.device, materials = device, np.asarray(materials)
        self.size = len(materials)
        self.scene = SceneResources(device, scene)
        self._pass = Accumulate(device, self.scene, demodulate, alpha)
        first_hit = np.zeros((1, self.size, 4), np.uint32)
        middle = 0xFFFFFF // 3
        first_hit[0, :, 0] = middle | (materials & 0xFF) << 24
        first_hit[0, :, 1] = middle | (materials >> 8) << 24
        first_hit[0, :, 2] = materials
        words = np.zeros((1, self.size, 4), np.uint32)
        words[0, :, :3] = np.broadcast_to(np.float32(radiance), (self.size, 3)).copy().view(np.uint32)
        words[0, :, 3] = np.uint32(0x12340000) | np.asarray(count, np.uint32)
        self.arrays = {
            "first_hit": device.upload(first_hit, "first_hit"),
            "shading": device.upload(words, "shading"),
            "shaded": device.upload(np.arange(self.size, dtype=np.uint32), "shaded"),
            "listed": device.upload(np.array([0, self.size, 0, 0], np.uint32), "listed"),
            "radiance": device.upload(np.zeros((3, PLACES), np.float32), "radiance"),
            "ray_length": device.upload(np.zeros(PLACES, np.float32), "ray_length"),
        }

    def add(self, values) -> None:
        """One value to each sample, in batches. values: (samples, 3), or what broadcasts to it."""
        values = np.broadcast_to(np.asarray(values, np.float32), (self.size, 3))
        camera = camera_record(CAMERA, (64, 48))
        for batch in range(-(-self.size // PLACES)):
            part = np.full((3, PLACES), 1e9, np.float32)  # of places without a path
            here = values[batch * PLACES : (batch + 1) * PLACES]
            part[:, : len(here)] = here.T
            self.arrays["radiance"].set(part)
            for _ in self._pass.run(self.arrays, SimpleNamespace(camera=camera, batch=batch)):
                pass
        self.device.queue.finish()

    @property
    def words(self) -> np.ndarray:
        return self.arrays["shading"].get()[0]

    @property
    def radiance(self) -> np.ndarray:
        return np.ascontiguousarray(self.words[:, :3]).view(np.float32)

    @property
    def count(self) -> np.ndarray:
        assert (self.words[:, 3] >> 16 == 0x1234).all(), "the age has changed"
        return self.words[:, 3] & 0xFFFF


@pytest.fixture(autouse=True, scope="module")
def compiled_once():
    with one_device():
        yield


@pytest.fixture(scope="module")
def diffuse():
    return wall([grey(0.5)])


@pytest.fixture(scope="module")
def glossy():
    return wall(MATERIALS)


def bright(rng, shape):
    """Radiance with a heavy tail."""
    return rng.lognormal(0, 2, shape).astype(np.float32)


# Means


def test_the_mean_of_what_came(device, diffuse):
    """Rounding at the k-th of n values, some units of roundoff of the largest, reaches the end with the weight k / n."""
    rng, n, samples = np.random.default_rng(1), 200, 150
    values = bright(rng, (n, samples, 3))
    accumulator = Accumulator(device, diffuse, np.zeros(samples, int))
    for v in values:
        accumulator.add(v)
    np.testing.assert_array_equal(accumulator.count, n)
    bound = n * 2 * UNIT_ROUNDOFF * values.max(axis=0)
    assert (np.abs(accumulator.radiance - values.astype(float).mean(axis=0)) <= bound).all()


def test_the_first_value_replaces_what_was_there(device, diffuse):
    accumulator = Accumulator(device, diffuse, np.zeros(3, int), radiance=1e6)
    accumulator.add([[1, 2, 3], [0, 0, 0], [0.5, 1e4, 1e-3]])
    np.testing.assert_allclose(accumulator.radiance, [[1, 2, 3], [0, 0, 0], [0.5, 1e4, 1e-3]], rtol=1e-5, atol=0.07)
    np.testing.assert_array_equal(accumulator.count, 1)


@given(
    before=st.floats(0, 1e6, width=32), value=st.floats(0, 1e6, width=32), count=st.integers(0, MOST),
    alpha=st.sampled_from([0.0, 0.01, 0.25, 1.0]),
)  # fmt: skip
@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)
def test_one_step(device, diffuse, before, value, count, alpha):
    """L + (new - L) max(1 / (count + 1), alpha)"""
    accumulator = Accumulator(device, diffuse, [0], alpha, count=count, radiance=before)
    accumulator.add(value)
    part = max(1 / (count + 1), alpha)
    expected = before + (value - before) * part
    assert np.abs(accumulator.radiance - expected).max() <= 4 * UNIT_ROUNDOFF * max(before, value) + 1e-37
    assert accumulator.count[0] == count + (count < MOST and count * np.float32(alpha) < 1)


@pytest.mark.parametrize("alpha", [0.3, 0.1, 0.02])
def test_fixed_alpha_is_an_exponential_average(device, diffuse, alpha):
    """Once 1 / alpha values have come, of which the mean is taken; the count stays then."""
    rng, n, settled = np.random.default_rng(2), 150, int(np.ceil(1 / alpha))
    values = bright(rng, (n, 5, 3))
    accumulator = Accumulator(device, diffuse, np.zeros(5, int), alpha)
    for v in values:
        accumulator.add(v)
    begun = values[: settled - 1].astype(float).mean(axis=0)  # those whose part is more than alpha
    later = values[settled - 1 :].astype(float)
    weights = alpha * (1 - alpha) ** np.arange(len(later))[::-1]
    expected = begun * (1 - alpha) ** len(later) + np.tensordot(weights, later, 1)
    assert (np.abs(accumulator.radiance - expected) <= 8 / alpha * UNIT_ROUNDOFF * values.max(axis=0)).all()
    np.testing.assert_array_equal(accumulator.count, settled)


def test_alpha_of_one_keeps_the_last_value(device, diffuse):
    accumulator = Accumulator(device, diffuse, [0], 1.0)
    for value in (5.0, 0.0, 3.0):
        accumulator.add(value)
        np.testing.assert_allclose(accumulator.radiance, value, atol=1e-6)
    assert accumulator.count[0] == 1


# Surfaces that reflect


def test_least_part_in_numbers():
    """Appendix C: that of a metal follows from its roughness alone; alpha is the square of it. A diffuse surface has none."""
    assert [least_part(m) for m in METALS] == pytest.approx([0.5, 0.4, 0.1])
    assert least_part(DIELECTRICS[0]) == 0
    assert least_part(DIELECTRICS[3]) == pytest.approx(0.5)  # glass without colour
    assert least_part(DIELECTRICS[7]) == pytest.approx(0.475)  # nothing but gloss: alpha 1/16


def test_least_part_of_materials(device, glossy):
    """What a value is worth where there were 1000, sample by sample."""
    accumulator = Accumulator(device, glossy, np.arange(len(MATERIALS)), count=1000)
    accumulator.add(1.0)
    expected = np.maximum([least_part(m) for m in MATERIALS], 1 / 1001)
    np.testing.assert_allclose(accumulator.radiance, np.repeat(expected[:, None], 3, axis=1), rtol=1e-5)
    full = np.array([1000 * least_part(m) >= 1 for m in MATERIALS])
    np.testing.assert_array_equal(accumulator.count, np.where(full, 1000, 1001))


def test_a_fixed_part_is_that_of_all_materials(device, glossy):
    accumulator = Accumulator(device, glossy, np.arange(len(MATERIALS)), 0.03, count=1000)
    accumulator.add(1.0)
    np.testing.assert_allclose(accumulator.radiance, 0.03, rtol=1e-5)


def test_the_count_stays_where_the_part_does(device, glossy):
    """At the number of values that the average is worth."""
    accumulator = Accumulator(device, glossy, np.arange(len(METALS) + len(DIELECTRICS)))
    many = 40
    for _ in range(many):
        accumulator.add(1.0)
    parts = [least_part(m) for m in (*METALS, *DIELECTRICS)]
    # where 1 / part is a whole number, its last bit decides
    low, high = ([many if p == 0 else min(many, int(np.ceil(d / p))) for p in parts] for d in (1 - 1e-6, 1 + 1e-6))
    assert ((low <= accumulator.count) & (accumulator.count <= high)).all()
    assert low[:3] == [2, 3, 10]


@pytest.mark.parametrize("demodulate", [False, True])
def test_pictures_of_metal_and_roughness(device, demodulate):
    """Of a surface with a picture the part is by what the picture says at the sample's place."""
    pixels = np.full((1, 1, 4), 255, np.uint8)
    pixels[..., 1], pixels[..., 2] = 128, 200
    picture = Texture("rough", pixels, srgb=False)
    materials = [
        Material("m", (0.5,) * 3, metallic=1.0, roughness=1.0, metallic_roughness_texture=TextureUse(0)),
        Material("m", (0.5,) * 3, metallic=0.5, roughness=0.5, specular=1.0, metallic_roughness_texture=TextureUse(0)),
        Material("m", (0.5,) * 3, metallic=1.0, roughness=0.5),
    ]
    accumulator = Accumulator(device, wall(materials, (picture,)), range(3), count=5000, demodulate=demodulate)
    accumulator.add(1.0)
    read = [replace(m, roughness=m.roughness * 128 / 255, metallic=m.metallic * 200 / 255) for m in materials[:2]]
    read += [materials[2]]
    expected = [least_part(m) / (0.5 if demodulate else 1) for m in read]
    np.testing.assert_allclose(accumulator.radiance, np.repeat(np.array(expected)[:, None], 3, axis=1), rtol=1e-4)


# Limits


def test_the_count_saturates(device, diffuse):
    """At 65,534; 65,535 would say that the sample is background."""
    accumulator = Accumulator(device, diffuse, [0] * 3, count=[MOST - 2, MOST - 1, MOST], radiance=1.0)
    for expected in ([MOST - 1, MOST, MOST], [MOST] * 3, [MOST] * 3):
        accumulator.add(2.0)
        np.testing.assert_array_equal(accumulator.count, expected)
    parts = 1 / (np.array([[MOST - 1, MOST, MOST + 1], [MOST, *[MOST + 1] * 2], [MOST + 1] * 3]))
    np.testing.assert_allclose(accumulator.radiance[:, 0], 1 + parts.sum(axis=0), rtol=4 * UNIT_ROUNDOFF)


@pytest.mark.parametrize("demodulate", [False, True])
@pytest.mark.parametrize("value", [np.nan, np.inf, (1.0, np.nan, 1.0), (1.0, 1.0, np.inf), (np.inf, -np.inf, 0.0)])
def test_what_is_not_finite_is_left_out(device, diffuse, value, demodulate):
    accumulator = Accumulator(device, diffuse, [0] * 3, count=[0, 1, 7], radiance=0.25, demodulate=demodulate)
    before = accumulator.words
    accumulator.add(value)
    np.testing.assert_array_equal(accumulator.words, before)
    accumulator.add(0.25)
    np.testing.assert_array_equal(accumulator.count, [1, 2, 8])


@pytest.mark.parametrize("mean", [1.0, 1.3, 1.999, 640.0, 1e-6])
def test_where_float32_stops_moving(device, diffuse, mean):
    """A mean of as many values as can be counted still moves if the new one differs by 1/256 of it, and by about as much as it
    should; by 1/1100 it does not anymore."""
    mean = np.float32(mean)
    differences = np.array([1 / 250, -1 / 250, 1 / 1100, -1 / 1100, 1.0, -1.0]) * mean
    accumulator = Accumulator(device, diffuse, [0] * 6, count=MOST, radiance=mean)
    accumulator.add(np.repeat((mean + differences)[:, None], 3, axis=1))
    moved = accumulator.radiance[:, 0].astype(float) - mean
    assert (np.sign(moved) == np.sign(differences) * [1, 1, 0, 0, 1, 1]).all()
    spacing = float(np.spacing(mean))
    assert (np.abs(moved - differences / (MOST + 1)) <= 0.51 * spacing).all()


# With and without albedo


@pytest.mark.parametrize("albedo", [0.0, 0.02, 0.05, 0.3, 1.0])
def test_demodulated_radiance_is_divided_by_the_albedo(device, albedo):
    """By no less than a twentieth, so that a black surface's is finite, and by each channel's own."""
    material = Material("m", (albedo, 0.5, 1.0))
    accumulator = Accumulator(device, wall([material]), [0], demodulate=True)
    accumulator.add([0.7, 0.7, 0.7])
    np.testing.assert_allclose(accumulator.radiance[0], 0.7 / np.maximum(material.base_color, LEAST_ALBEDO), rtol=1e-6)


def both(scene, frames=6, size=(24, 16), **options):
    """The last of some frames of a still view, with radiance stored as it is and without albedo; and what is stored."""
    renderers = [cached(scene, size=size, demodulate=d, **options) for d in (False, True)]
    images = [list(r.frames(0, frames))[-1].color["mono"] for r in renderers]
    return images, [held(r) for r in renderers]


@pytest.mark.parametrize("options", [{}, {"alpha": 0.2}, {"shading": "adaptive", "target": 8}])
def test_the_same_image_with_and_without_albedo(options):
    """Of a scene that stands still, with textures and surfaces of one colour; beside what rounding does."""
    (plain, demodulated), _ = both(everything(), **options)
    assert plain.std() > 0.1
    np.testing.assert_allclose(demodulated, plain, rtol=1e-4, atol=1e-6)


def test_black_white_and_coloured_without_textures():
    """The images are the same, and what is stored differs by the albedo."""
    materials = [grey(0.0, 0.7), grey(1.0), Material("red", (0.9, 0.05, 0.01))]
    corner = np.array([[-1, -1, 0], [0, -1, 0], [0, 1, 0], [-1, 1, 0]], float)
    positions = np.concatenate([corner + [0.67 * i - 0.33, 0, 0] for i in range(3)])
    mesh = make_mesh(positions, (4 * np.arange(3)[:, None, None] + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3))
    mesh = replace(mesh, material=np.repeat(np.arange(3, dtype=np.uint32), 2))
    scene = lit(mesh, camera=view((0, 0, 2), (0, 0, 0)), materials=materials, environment=(0.5, 0.8, 1.1))
    (plain, demodulated), (stored, divided) = both(scene, bounces=1)
    np.testing.assert_allclose(demodulated, plain, rtol=1e-4, atol=1e-6)
    on_surface = stored.visible & ~stored.background
    np.testing.assert_array_equal(divided.visible, stored.visible)
    albedo = np.array([m.base_color for m in materials])[stored.first_hit[on_surface][:, 2] // 2]
    assert len(np.unique(albedo, axis=0)) == 3
    expected = stored.radiance[on_surface] / np.maximum(albedo, LEAST_ALBEDO)
    np.testing.assert_allclose(divided.radiance[on_surface], expected, rtol=1e-4, atol=1e-6)
    background = stored.visible & stored.background
    np.testing.assert_array_equal(divided.radiance[background], stored.radiance[background])
