"""Stereo blending against NumPy in double precision, and against what must come out by Eq. 3 and 8."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from blending_model import Eye
from blending_model import blend as blend_in_numpy
from blending_model import dodgson as dodgson_in_numpy
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from kernel_source import build
from scipy import stats

from clcache.frame import FrameGraph
from clcache.passes.blend import Blend, blend_buffers, moment_buffers
from clcache.renderer import camera_record
from clcache.scene.model import Camera
from clcache.scene.transform import look_at

SHARPNESSES = (0.0, 0.5, 0.8, 1.0)
DISTANCE = 5.0  # metres from the eyes to the wall that most tests look at


@dataclass(frozen=True)
class State:
    camera: np.void
    other: np.void


def camera_at(x: float, near: float = 0.0) -> Camera:
    """A camera that looks along -z, beside the origin."""
    return Camera(look_at((x, 0.0, 0.0), (x, 0.0, -1.0)), np.radians(40), near)


def eye_of(color, spread=0.0, count=4.0, near=1 / DISTANCE, camera=None, mean=None) -> Eye:
    """An eye whose moments are given by images, or by one number for all pixels; the mean is the colour where it is not."""
    color = np.asarray(color, np.float32)
    moments = np.zeros((*color.shape[:2], 8), np.float32)
    moments[..., :3] = color if mean is None else mean
    moments[..., 3], moments[..., 4:7], moments[..., 7] = count, spread, near
    return Eye(color, moments, camera or camera_at(0.0))


def run(device, eye: Eye, other: Eye, sharpness: float) -> np.ndarray:
    """The kernel's result, (H, W, 3)."""
    height, width, _ = eye.color.shape
    pixels, size = height * width, (width, height)
    images = {"color": eye.color, "moments": eye.moments, "other_color": other.color, "other_moments": other.moments}
    inputs = {name: device.upload(a.reshape(pixels, -1).astype(np.float32)) for name, a in images.items()}
    graph = FrameGraph(device, [Blend(device, sharpness)], blend_buffers(pixels), ["blended"], inputs)
    graph.run(State(camera_record(eye.camera, size), camera_record(other.camera, size)))
    blended = graph.of()["blended"].get().reshape(height, width, 3)
    graph.release()
    device.release(*inputs.values())
    return blended


def noise(rng, shape, mean=1.0, deviation=0.2) -> np.ndarray:
    return rng.normal(mean, deviation, (*shape, 3)).astype(np.float32)


def wall_shift(size: tuple[int, int], eye_distance: float) -> float:
    """Pixels by which the wall's image moves to the left as the eye moves to the right."""
    return eye_distance / DISTANCE / (2 * np.tan(np.radians(20))) * size[1]


def test_layout():
    assert [(b.name, b.shape, b.dtype, b.per_eye) for b in moment_buffers(15)] == [
        ("moments", (15, 8), np.float32, True)
    ]


@pytest.mark.parametrize("r", [*SHARPNESSES, 0.3])
def test_dodgson_reproduces_straight_lines(r):
    """The weights add up to 1, and their centre is the place itself, wherever it is."""
    offset = np.linspace(-0.5, 0.5, 101)[:, None]
    weights = dodgson_in_numpy(offset - np.array([-2, -1, 0, 1, 2]), r)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(weights @ [-2, -1, 0, 1, 2], offset[:, 0], atol=1e-14)


def test_dodgson_at_known_parameters():
    places = np.array([-1.0, 0.0, 1.0])
    np.testing.assert_array_equal(dodgson_in_numpy(places, 1.0), [0, 1, 0])
    np.testing.assert_array_equal(dodgson_in_numpy(places, 0.5), [0.125, 0.75, 0.125])
    np.testing.assert_array_equal(dodgson_in_numpy(places, 0.0), [0.25, 0.5, 0.25])


@pytest.mark.parametrize("r", SHARPNESSES)
def test_dodgson_on_the_device(device, tmp_path, r):
    source = """
#include "samplecache/blend.cl"
__kernel void weights(__global const float *offset,  // (n)
                      __global float *weight,        // (n, 3)
                      float r, uint n)
{
    uint i = get_global_id(0);
    if (i < n) vstore3(dodgson(offset[i], r), i, weight);
}
"""
    offset = np.linspace(-0.5, 0.5, 101).astype(np.float32)
    weight = device.empty((101, 3), np.float32)
    build(device, source, tmp_path, BLUR=0)["weights"](device.upload(offset), weight, r, 101, count=101)
    expected = dodgson_in_numpy(offset[:, None].astype(np.float64) - [-1, 0, 1], r)
    np.testing.assert_allclose(weight.get(), expected, atol=4e-7)


def random_eye(rng, size: tuple[int, int], camera: Camera, plane: np.ndarray) -> Eye:
    """Noise on a plane (its normal over its distance from the origin), before which some pixels have something else, behind
    which some have nothing, and of some of which nothing is known."""
    width, height = size
    slope = np.tan(camera.fov_y / 2)
    x, y = (
        ((np.arange(width) + 0.5) / width * 2 - 1) * slope * width / height,
        1 - (np.arange(height) + 0.5) / height * 2,
    )
    ray = np.stack(np.broadcast_arrays(x, y[:, None] * slope, -1.0), axis=-1) @ camera.transform[:, :3].T
    near = np.maximum(ray @ plane / (1 - camera.transform[:, 3] @ plane), 0.0)
    kind = rng.choice(5, near.shape, p=[0.7, 0.1, 0.05, 0.05, 0.1])
    near = np.select([kind == 1, kind == 2], [near * rng.uniform(1, 2, near.shape), 0.0], near)
    count = np.where(kind == 3, 0.0, rng.integers(1, 9, near.shape))
    spread = np.where(rng.random(near.shape) < 0.2, 0.0, rng.uniform(0, 4, near.shape))[..., None]
    color = rng.uniform(0, 3, (height, width, 3))
    return eye_of(color, spread, count, near, camera, mean=color + rng.normal(0, 0.1, color.shape))


@given(
    width=st.integers(1, 40),
    height=st.integers(1, 24),
    seed=st.integers(0, 2**32 - 1),
    sharpness=st.one_of(st.sampled_from(SHARPNESSES), st.floats(0, 1, width=32)),
    eye_distance=st.sampled_from([0.0, 0.063, 1.0, 10.0]),
    turn=st.sampled_from([0.0, 0.1, 3.0]),
    is_right=st.booleans(),
)
@hypothesis_settings(max_examples=60, deadline=None)
def test_random_images(device, width, height, seed, sharpness, eye_distance, turn, is_right):
    rng = np.random.default_rng(seed)
    cameras = (
        camera_at(0.0, 0.1),
        Camera(
            look_at((eye_distance, 0.1, 0.2), (eye_distance + np.sin(turn), 0.1, 0.2 - np.cos(turn))),
            np.radians(50),
            0.1,
        ),
    )
    plane = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5), -1.0]) / rng.uniform(2, 20)
    eye, other = (random_eye(rng, (width, height), c, plane) for c in (cameras[::-1] if is_right else cameras))
    expected = blend_in_numpy(eye, other, sharpness)
    found = run(device, eye, other, sharpness)
    sure = expected.margin > 1e-4  # elsewhere rounding may decide otherwise whether a pixel shows the surface
    assert np.count_nonzero(~sure) <= 0.02 * sure.size + 2
    np.testing.assert_allclose(found[sure], expected.color[sure], rtol=0, atol=2e-3)
    low, high = (f(eye.color, expected.other) for f in (np.minimum, np.maximum))
    assert np.all((found >= low - 1e-5) & (found <= high + 1e-5) | ~sure[..., None])  # between X and Y


def test_random_images_are_blended():
    """The test above compares something: there is an X for most pixels, and all parts of the way to it are gone."""
    rng = np.random.default_rng(1)
    plane = np.array([0.1, 0.4, -1.0]) / 5
    eye, other = (random_eye(rng, (40, 24), camera_at(x), plane) for x in (0.0, 0.063))
    result = blend_in_numpy(eye, other, 0.8)
    assert result.is_seen.mean() > 0.6
    assert np.all(np.histogram(result.part[result.is_seen], 5, (0, 1))[0] > 20)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (17, 9)])
def test_equal_moments_meet_half_way(device, sharpness, size):
    """Eyes at one place, one signal, one variance: beta is 1/2; X is the other eye's colour itself where R = 1."""
    rng = np.random.default_rng(2)
    colors = [noise(rng, size[::-1]) for _ in range(2)]
    eye, other = (eye_of(color, spread=0.04, mean=1.0) for color in colors)
    blended = run(device, eye, other, sharpness)
    x = blend_in_numpy(eye, other, sharpness).other
    np.testing.assert_allclose(blended, (colors[0] + x) / 2, atol=1e-5)
    if sharpness == 1:
        np.testing.assert_allclose(blended, (colors[0] + colors[1]) / 2, atol=1e-5)


def test_blending_halves_the_variance(device):
    """Of two images with independent noise, R = 1. A Z-test of the variance: chi-square over all values."""
    rng = np.random.default_rng(3)
    eye, other = (eye_of(noise(rng, (120, 160), 1.0, 0.2), spread=0.04, mean=1.0) for _ in range(2))
    values = run(device, eye, other, 1.0).astype(np.float64).ravel()
    statistic = ((values - 1.0) ** 2).sum() / (0.2**2 / 2)
    p = stats.chi2.cdf(statistic, values.size)
    assert 0.001 < p < 0.999


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_uniform_wall_from_two_places(device, sharpness):
    """A wall moves by its disparity: X is the other eye's picture of it, interpolated there, except where that ends."""
    size, eye_distance = (64, 36), 0.063 * 4
    shift = wall_shift(size, eye_distance)
    assert 1 < shift < 3 and abs(shift - round(shift)) > 0.1
    ramp = np.broadcast_to(np.arange(64.0)[:, None], (36, 64, 3))
    eye = eye_of(np.zeros((36, 64, 3)), spread=1.0, mean=1.0)
    other = eye_of(ramp, spread=1.0, mean=1.0, camera=camera_at(eye_distance))
    blended = run(device, eye, other, sharpness)
    beyond = int(np.ceil(shift)) + 1
    np.testing.assert_allclose(blended[:, beyond:], ramp[:, beyond:] / 2 - shift / 2, atol=1e-4)
    np.testing.assert_array_equal(blended[:, : int(shift)], 0.0)  # not in the other picture


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_slanted_floor_is_one_surface(device, sharpness):
    """No slope fails the depth test: on a floor, up to its horizon, a picture of straight ramps is interpolated exactly, which
    takes all of the nine pixels."""
    row, column = np.mgrid[:40, :32] + 0.5
    tangent = (row / 40 * 2 - 1) * np.tan(np.radians(20))
    near = np.maximum(tangent / 1.5, 0.0)  # the floor is 1.5 m below one eye, 1.51 m below the other
    color = np.stack([row, column, row + column], axis=-1)
    eye = eye_of(np.zeros((40, 32, 3)), spread=1.0, mean=1.0, near=near)
    raised = Camera(look_at((0.2, 0.01, 0.0), (0.2, 0.01, -1.0)), np.radians(40))
    other = eye_of(color, spread=1.0, mean=1.0, near=near * 1.5 / 1.51, camera=raised)
    pixels = 40 / (2 * np.tan(np.radians(20)))
    there = np.stack([row + 0.01 * near * pixels, column - 0.2 * near * pixels], axis=-1)
    expected = np.concatenate([there, there.sum(axis=-1, keepdims=True)], axis=-1) / 2
    floor = np.s_[21:39, 6:31]  # the row at the horizon has sky beside it
    np.testing.assert_allclose(run(device, eye, other, sharpness)[floor], expected[floor], atol=1e-4)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_no_noise_and_no_difference_keeps_the_pixel(device, sharpness):
    """0 / 0 in Eq. 8; the colours differ all the same, and so must not be mixed."""
    rng = np.random.default_rng(5)
    eye, other = (eye_of(noise(rng, (9, 13)), spread=0.0, mean=2.0) for _ in range(2))
    np.testing.assert_array_equal(run(device, eye, other, sharpness), eye.color)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_noiseless_other_eye_replaces_the_pixel(device, sharpness):
    rng = np.random.default_rng(6)
    eye = eye_of(noise(rng, (9, 13)), spread=0.04, mean=1.0)
    other = eye_of(np.full((9, 13, 3), 1.0), spread=0.0)
    np.testing.assert_allclose(run(device, eye, other, sharpness), 1.0, atol=1e-6)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_large_bias_keeps_the_pixel(device, sharpness):
    """beta = 1 - s^2 / (b^2 + 2 s^2), with b = 100 s."""
    eye, other = eye_of(np.full((7, 9, 3), 1.0), spread=1e-4), eye_of(np.full((7, 9, 3), 2.0), spread=1e-4)
    expected = 1.0 + 1e-4 / (1.0 + 2e-4)
    np.testing.assert_allclose(run(device, eye, other, sharpness), expected, rtol=3e-7)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_each_channel_has_its_own_weight(device, sharpness):
    eye = eye_of(np.zeros((5, 5, 3)), spread=np.array([0.0, 1.0, 3.0]), mean=1.0)
    other = eye_of(np.ones((5, 5, 3)), spread=np.array([1.0, 1.0, 1.0]), mean=1.0)
    expected = np.broadcast_to([0.0, 0.5, 0.75], (5, 5, 3))
    np.testing.assert_allclose(run(device, eye, other, sharpness), expected, atol=1e-6)


def test_moments_are_blurred_by_the_sharpness(device):
    """One noisy pixel among constant ones: after blurring its variance counts 1 / (1 + 8 (1 - R)) parts, and that of each
    of its neighbours (1 - R) / (1 + 8 (1 - R)); means apart add to it."""
    spread, mean = np.zeros((5, 5, 1)), np.zeros((5, 5, 3))
    spread[2, 2], mean[2, 2] = 1.0, 1.0
    eye, other = eye_of(np.zeros((5, 5, 3)), spread, mean=mean), eye_of(np.ones((5, 5, 3)), spread=1.0, mean=0.0)
    for r in SHARPNESSES:
        blended = run(device, eye, other, r)
        for place, w in (((2, 2), 1.0), ((1, 3), 1 - r)):
            w /= 1 + 8 * (1 - r)
            variance = 2 * w - w**2  # E[X^2] is spread + mean^2 = 2 in the noisy pixel
            np.testing.assert_allclose(blended[place], variance / (1 + w**2 + variance), atol=1e-6)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_what_the_other_eye_does_not_see_is_kept(device, sharpness):
    """Before the right half of the other eye's wall stands something closer; left of it all pixels that the kernel reaches
    show the wall, in the half to the right none does, and in between no colour of what stands there gets in."""
    rng = np.random.default_rng(7)
    near = np.full((12, 20), 1 / DISTANCE)
    near[:, 10:] *= 1.05
    colors = [noise(rng, (12, 20)), noise(rng, (12, 20))]
    colors[1][:, 10:] = 1000.0
    eye, other = eye_of(colors[0], spread=0.04, mean=1.0), eye_of(colors[1], spread=0.04, near=near, mean=1.0)
    blended = run(device, eye, other, sharpness)
    np.testing.assert_array_equal(blended[:, 11:], colors[0][:, 11:])
    assert np.all(blended < 10.0)
    assert np.all(blended[:, :9] != colors[0][:, :9])


@pytest.mark.parametrize("eye_distance", [0.0, 10.0])
@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_background_is_blended_with_background_only(device, sharpness, eye_distance):
    """It is infinitely far away, where eyes 10 m apart see the same."""
    rng = np.random.default_rng(8)
    color, mean = noise(rng, (9, 13)), 1.0
    eye = eye_of(color, spread=0.04, mean=mean, near=0.0)
    other = eye_of(noise(rng, (9, 13)), spread=0.04, mean=mean, near=0.0, camera=camera_at(eye_distance))
    x = blend_in_numpy(eye, replace(other, camera=eye.camera), sharpness).other
    np.testing.assert_allclose(run(device, eye, other, sharpness), (color + x) / 2, atol=1e-5)
    far = replace(other, moments=np.where(np.arange(8) == 7, np.float32(1e-12), other.moments))
    np.testing.assert_array_equal(run(device, eye, far, sharpness), color)
    np.testing.assert_array_equal(run(device, far, eye, sharpness), far.color)


def test_eyes_far_apart_share_nothing_of_a_near_wall(device):
    rng = np.random.default_rng(9)
    eye, other = (eye_of(noise(rng, (9, 13)), spread=0.04, camera=camera_at(x)) for x in (0.0, 10.0))
    np.testing.assert_array_equal(run(device, eye, other, 0.8), eye.color)


def test_other_eye_that_looks_away(device):
    """What is behind it projects into its image as well, upside down."""
    rng = np.random.default_rng(10)
    away = Camera(look_at((0, 0, 0), (0, 0, 1)), np.radians(40))
    for near in (0.0, 1 / DISTANCE):
        eye, other = (eye_of(noise(rng, (9, 13)), spread=0.04, near=near, camera=c) for c in (camera_at(0.0), away))
        np.testing.assert_array_equal(run(device, eye, other, 0.8), eye.color)


def test_what_is_before_the_other_eye_s_near_plane_is_kept(device):
    rng = np.random.default_rng(11)
    colors = noise(rng, (9, 13)), noise(rng, (9, 13))
    for near_plane, is_kept in ((DISTANCE * 0.99, False), (DISTANCE * 1.01, True)):
        eye, other = (eye_of(c, spread=0.04, mean=1.0, camera=camera_at(0.0, near_plane)) for c in colors)
        assert np.all((run(device, eye, other, 0.8) == eye.color) == is_kept)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_nothing_known_of_a_pixel(device, sharpness):
    """A pixel of this eye without counts is kept; those of the other eye are left out, and whatever is in them."""
    rng = np.random.default_rng(12)
    colors = [noise(rng, (12, 20)) for _ in range(2)]
    count = np.where(np.arange(20) < 10, 0.0, 4.0)
    eye, other = (eye_of(c, spread=0.04, mean=1.0) for c in colors)
    unknown = replace(eye, moments=eye.moments * (count > 0).astype(np.float32)[:, None])
    blended = run(device, unknown, other, sharpness)
    np.testing.assert_array_equal(blended[:, :10], colors[0][:, :10])
    assert np.all(blended[:, 11:] != colors[0][:, 11:])
    hole = replace(other, color=np.where(count[:, None] > 0, other.color, np.float32(np.nan)))
    hole = replace(hole, moments=other.moments * (count > 0).astype(np.float32)[:, None])
    blended = run(device, eye, hole, sharpness)
    np.testing.assert_array_equal(blended[:, :9], colors[0][:, :9])
    assert np.all(np.isfinite(blended)) and np.all(blended[:, 11:] != colors[0][:, 11:])


@pytest.mark.parametrize("eye_distance", [0.0, 0.063, 1.0])
@pytest.mark.parametrize("sharpness", [*SHARPNESSES, 0.3])
@pytest.mark.parametrize("value", [1e6, 0.1, 3e-20])
def test_constant_signal_stays_exactly_constant(device, sharpness, value, eye_distance):
    """Also with some deviation that is nothing but rounding, in either eye."""
    color = np.full((9, 13, 3), value)
    for spread, other_spread in ((0.0, 0.0), (value * 1e-7, 0.0), (0.0, value * 1e-7), (1.0, 1.0)):
        eye = eye_of(color, spread)
        other = eye_of(color, other_spread, camera=camera_at(eye_distance))
        np.testing.assert_array_equal(run(device, eye, other, sharpness), eye.color)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_noise_on_a_large_signal(device, sharpness):
    """Deviations of 1 in a mean of 1e6, where raw second moments would have lost them: still beta = 1/2 within 1 %."""
    eye = eye_of(np.full((9, 13, 3), 1e6), spread=1.0)
    other = eye_of(np.full((9, 13, 3), 1e6 + 100), spread=1.0, mean=1e6)
    np.testing.assert_allclose(run(device, eye, other, sharpness) - 1e6, 50.0, atol=0.5)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_fireflies_and_negative_weights(device, sharpness):
    """Of single pixels of 1e18 nothing becomes negative or infinite, though kernels with R > 1/2 overshoot about them."""
    rng = np.random.default_rng(13)
    colors = [np.abs(noise(rng, (24, 32))) for _ in range(2)]
    for color in colors:
        color[rng.random((24, 32)) < 0.1] = 1e18
    for spread in (1.0, 1e36):
        eye, other = (eye_of(c, spread, mean=1.0, camera=camera_at(x)) for c, x in zip(colors, (0, 0.2), strict=True))
        blended = run(device, eye, other, sharpness)
        assert np.all(np.isfinite(blended)) and np.all(blended >= 0.0)


@pytest.mark.parametrize("sharpness", SHARPNESSES)
def test_squares_that_overflow_keep_the_pixel(device, sharpness):
    eye, other = eye_of(np.full((5, 5, 3), 1.0), np.inf), eye_of(np.full((5, 5, 3), 1e30), spread=1.0)
    np.testing.assert_array_equal(run(device, eye, other, sharpness), eye.color)


def test_work_group_size_does_not_matter(device, other_groups):
    rng = np.random.default_rng(14)
    eye, other = (random_eye(rng, (33, 21), camera_at(x), np.array([0.1, 0.4, -1.0]) / 5) for x in (0.0, 0.063))
    np.testing.assert_array_equal(run(device, eye, other, 0.8), run(other_groups, eye, other, 0.8))
