"""Stereo filtering: the kernels against NumPy in double precision, and against what must come out by Eq. 3 and 4."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from stereo_model import Eye, blend, estimated_beta

from clcache.frame import FrameGraph
from clcache.methods import PathState
from clcache.passes.stereo import FindNear, disparity, stereo
from clcache.renderer import camera_record
from clcache.scene.model import Camera
from clcache.scene.transform import look_at
from clcache.settings import resolve

KINDS = ("constant", "varianceblend")
DISTANCE = 5.0  # metres from the eyes to the wall that most tests look at


def camera_at(x: float, height: float = 0.0, near: float = 0.0) -> Camera:
    """A camera that looks along -z, beside the origin."""
    return Camera(look_at((x, height, 0.0), (x, height, -1.0)), np.radians(40), near)


def eye_of(color, near=1 / DISTANCE, x=0.0) -> Eye:
    """An eye whose reciprocal depths are given by an image, or by one number for all pixels."""
    color = np.asarray(color, np.float32)
    return Eye(color, np.broadcast_to(np.float32(near), color.shape[:2]), camera_at(x))


def run(device, eye: Eye, other: Eye, kind: str, which: int = 0, **settings) -> tuple[np.ndarray, np.ndarray]:
    """The kernels' result: (H, W, 3) and beta, (H, W). settings: of stereo and varianceblend, by their last names."""
    height, width, _ = eye.color.shape
    pixels, size = height * width, (width, height)
    names = {"beta": "stereo.beta", "per_channel": "varianceblend.per_channel"}
    resolved = resolve({}, {names[k]: v for k, v in settings.items()})
    found = stereo(device, None, size, resolved, kind)
    passes = [p for p in found.passes if not isinstance(p, FindNear)]
    near = np.stack([eye.near, other.near] if which == 0 else [other.near, eye.near])
    images = {
        "color": eye.color.reshape(pixels, 3),
        "other_color": other.color.reshape(pixels, 3),
        "near": near.reshape(2, pixels),
    }
    inputs = {name: device.upload(np.ascontiguousarray(a, np.float32)) for name, a in images.items()}
    buffers = [b for b in found.buffers if b.name != "near"]
    graph = FrameGraph(device, passes, buffers, {found.output, "aov_beta"}, inputs)
    cameras = (camera_record(each.camera, size) for each in (eye, other))
    graph.run(PathState(next(cameras), (0, 0), 1, eye=which, other=next(cameras)))
    blended, beta = (graph.of()[name].get() for name in (found.output, "aov_beta"))
    graph.release()
    device.release(*inputs.values())
    return blended.reshape(height, width, 3), beta.reshape(height, width)


def noise(rng, shape, mean=1.0, deviation=0.2) -> np.ndarray:
    return rng.normal(mean, deviation, (*shape, 3)).astype(np.float32)


def wall_shift(size: tuple[int, int], eye_distance: float, distance: float = DISTANCE) -> float:
    """Pixels by which a wall's image moves to the left as the eye moves to the right."""
    return eye_distance / distance / (2 * np.tan(np.radians(20))) * size[1]


def random_eye(rng, size: tuple[int, int], x: float, plane: np.ndarray) -> Eye:
    """Noise on a plane (its normal over its distance from the origin), before which some pixels have something else, behind
    which some have nothing; of some nothing is known, and some are not finite."""
    width, height = size
    camera = camera_at(x, near=0.1)
    slope = np.tan(camera.fov_y / 2)
    across, up = (np.arange(width) + 0.5) / width * 2 - 1, 1 - (np.arange(height) + 0.5) / height * 2
    ray = np.stack(np.broadcast_arrays(across * slope * width / height, up[:, None] * slope, -1.0), axis=-1)
    near = np.maximum(ray @ plane / (1 - camera.transform[:, 3] @ plane), 0.0)
    kind = rng.choice(5, near.shape, p=[0.75, 0.1, 0.05, 0.05, 0.05])
    near = np.select([kind == 1, kind == 2, kind == 3], [near * rng.uniform(1, 2, near.shape), 0.0, -1.0], near)
    color = rng.uniform(0, 3, (height, width, 3))
    color *= np.where(rng.random((height, width, 1)) < 0.2, 0.0, 1.0)
    color[kind == 4, rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
    return Eye(color.astype(np.float32), near.astype(np.float32), camera)


@given(
    width=st.integers(1, 40),
    height=st.integers(1, 24),
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(KINDS),
    per_channel=st.booleans(),
    beta=st.sampled_from((0.0, 0.25, 0.5, 1.0)),
    eye_distance=st.sampled_from([0.0, 0.063, 1.0, 10.0]),
    which=st.integers(0, 1),
)
@hypothesis_settings(max_examples=60, deadline=None)
def test_random_images(device, width, height, seed, kind, per_channel, beta, eye_distance, which):
    rng = np.random.default_rng(seed)
    plane = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5), -1.0]) / rng.uniform(2, 20)
    eye, other = (
        random_eye(rng, (width, height), x, plane) for x in (eye_distance * which, eye_distance * (1 - which))
    )
    expected = blend(eye, other, beta if kind == "constant" else None, per_channel)
    found, own = run(device, eye, other, kind, which, per_channel=per_channel, beta=beta)
    sure = expected.margin > 1e-4  # elsewhere rounding may decide otherwise whether a pixel shows the surface
    assert np.count_nonzero(~sure & (expected.margin > 0)) <= 0.02 * sure.size + 2
    np.testing.assert_allclose(found[sure], expected.color[sure], rtol=0, atol=2e-3)
    np.testing.assert_allclose(own[sure], expected.beta.mean(axis=-1)[sure], rtol=0, atol=2e-3)
    assert np.all((own >= 0) & (own <= 1))
    seen = sure & expected.is_seen
    low, high = (f(eye.color, expected.other)[seen] for f in (np.minimum, np.maximum))
    assert np.all((found[seen] >= low - 1e-5) & (found[seen] <= high + 1e-5))  # between X and Y


def test_random_images_are_blended():
    """The test above compares something: there is an X for most pixels, and all parts of the way to it are gone."""
    rng = np.random.default_rng(1)
    plane = np.array([0.1, 0.4, -1.0]) / 5
    eye, other = (random_eye(rng, (40, 24), x, plane) for x in (0.0, 0.063))
    result = blend(eye, other, None, per_channel=True)
    assert result.is_seen.mean() > 0.6
    assert np.all(np.histogram(result.beta[result.is_seen], 5, (0, 1))[0] > 20)


@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(KINDS),
    per_channel=st.booleans(),
    scale=st.sampled_from((1e-6, 1.0, 1e6)),
)
@hypothesis_settings(max_examples=25, deadline=None)
def test_results_lie_among_what_went_in(device, seed, kind, per_channel, scale):
    """No result is darker or brighter than all pixels of both eyes in its row: nothing is extrapolated."""
    rng = np.random.default_rng(seed)
    eye, other = (eye_of(scale * rng.lognormal(0, 2, (6, 17, 3)), x=x) for x in (0.0, 0.5))
    found, beta = run(device, eye, other, kind, per_channel=per_channel)
    both = np.concatenate([eye.color, other.color], axis=1)
    low, high = both.min(axis=1, keepdims=True), both.max(axis=1, keepdims=True)
    assert np.all((found >= low - 1e-6 * high) & (found <= high * (1 + 1e-6)))
    assert np.all((beta >= 0) & (beta <= 1))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (64, 36)])
@pytest.mark.parametrize("per_channel", [False, True])
def test_one_image_for_both_eyes_at_one_place_stays_as_it_is(device, kind, size, per_channel):
    rng = np.random.default_rng(2)
    near = rng.uniform(0.1, 1, size[::-1]) * (rng.random(size[::-1]) > 0.2)
    eye = eye_of(rng.uniform(0, 5, (*size[::-1], 3)), near, x=1234.5)
    blended, _ = run(device, eye, eye, kind, per_channel=per_channel)
    np.testing.assert_array_equal(blended, eye.color)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("eye_distance", [0.0, 0.3, 10.0])
def test_mirrored_scene_gives_the_mirrored_image(device, kind, eye_distance):
    """The left eye of a scene is the right eye of the mirrored one."""
    rng = np.random.default_rng(3)
    near = np.where(rng.random((12, 40)) < 0.2, 0.3, 0.2)
    colors = [noise(rng, (12, 40)) for _ in range(2)]
    left = eye_of(colors[0], near), eye_of(colors[1], x=eye_distance)
    mirrored = (
        eye_of(colors[0][:, ::-1], near[:, ::-1], x=eye_distance),
        eye_of(colors[1][:, ::-1]),
    )
    found, beta = run(device, *left, kind)
    found_mirrored, beta_mirrored = run(device, *mirrored, kind, which=1)
    np.testing.assert_allclose(found_mirrored[:, ::-1], found, atol=3e-5)
    np.testing.assert_allclose(beta_mirrored[:, ::-1], beta, atol=3e-5)


def test_disparity():
    """A wall moves to the left as the eye moves to the right, however the head is turned and wherever it is."""
    size = (64, 36)
    for place, ahead in (((0, 0, 0), (0, 0, -1)), ((50, 10, -30), (3, -1, 2))):
        own = Camera(look_at(place, np.add(place, ahead)), np.radians(40), 0.0)
        aside = own.transform.copy()
        aside[:, 3] += 0.25 * aside[:, 0]
        other = replace(own, transform=aside)
        there, back = (
            disparity(camera_record(a, size), camera_record(b, size)) for a, b in ((own, other), (other, own))
        )
        assert there == -back
        assert there / DISTANCE == pytest.approx(-wall_shift(size, 0.25), rel=1e-4)
        assert disparity(camera_record(own, size), camera_record(own, size)) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_straight_ramps_are_interpolated_exactly(device, kind):
    """On a wall, with a disparity that is not a whole number of pixels, between pixels and not beyond the image's edge."""
    size, eye_distance = (64, 36), 0.25
    shift = wall_shift(size, eye_distance)
    assert 1 < shift < 3 and abs(shift - round(shift)) > 0.1
    rng = np.random.default_rng(4)
    ramp = np.broadcast_to(np.arange(64.0)[:, None], (36, 64, 3))
    eye, other = eye_of(rng.normal(0, 10, (36, 64, 3))), eye_of(ramp, x=eye_distance)
    blended, beta = run(device, eye, other, kind, beta=0.25)
    x = np.arange(64.0) - shift
    expected = (1 - beta[..., None]) * x[:, None] + beta[..., None] * eye.color
    beyond = int(np.ceil(shift))
    np.testing.assert_allclose(blended[:, beyond:], expected[:, beyond:], atol=1e-4)
    np.testing.assert_array_equal(blended[:, : int(shift)], eye.color[:, : int(shift)])  # not in the other picture
    assert np.all(beta[:, : int(shift)] == 1)
    assert np.all(beta[:, beyond:] < 1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("spread", "least"), [(0.0, 1.0), (0.5, 0.95)])
def test_slanted_floor_is_one_surface(device, kind, spread, least):
    """No slope fails the depth test, up to the horizon, above which there is sky; nor, but for some few, do first hits that are
    anywhere in their pixels, by which the steps from pixel to pixel differ from the floor's."""
    row, column = np.mgrid[:40, :32] + 0.5
    slope = np.tan(np.radians(20)) / 20 / 1.5
    rng = np.random.default_rng(5)
    eyes = []
    for x in (0.0, 0.2):
        near = np.where(row > 20, (row - 20 + rng.uniform(-spread, spread, row.shape)) * slope, 0.0)
        eyes.append(eye_of(noise(rng, (40, 32)), near, x))
    _, beta = run(device, *eyes, kind)
    there = column + disparity(*(camera_record(e.camera, (32, 40)) for e in eyes)) * eyes[0].near
    assert np.all(beta[there < 0] == 1) and np.any(there < 0)
    assert (beta[there >= 0] < 1).mean() >= least


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("eye_distance", [0.0, 0.5])
def test_what_the_other_eye_does_not_see_is_kept(device, kind, eye_distance):
    """In the other eye something closer stands before the right half of the wall. No colour of it gets into the wall."""
    rng = np.random.default_rng(6)
    size, shift = (40, 12), wall_shift((40, 12), eye_distance)
    near = np.full((12, 40), 1 / DISTANCE)
    near[:, 20:] *= 1.05
    colors = [noise(rng, (12, 40)), noise(rng, (12, 40))]
    colors[1][:, 20:] = 1000.0
    eye, other = eye_of(colors[0]), eye_of(colors[1], near, x=eye_distance)
    blended, beta = run(device, eye, other, kind)
    there = np.arange(size[0]) + 0.5 - shift
    is_hidden, is_wall = there >= 20.5, (there < 20.5 - 1e-3) & (there >= 0)
    np.testing.assert_array_equal(blended[:, is_hidden], colors[0][:, is_hidden])
    assert np.all(blended < 10.0)
    assert np.all(beta[:, is_wall] < 1) and np.all(beta[:, is_hidden] == 1)
    assert is_hidden.any() and is_wall.any()


@pytest.mark.parametrize("kind", KINDS)
def test_two_walls(device, kind):
    """Before a wall stands a narrower one; both eyes see both, each with what it hides. Noiseless colours stay as they are."""
    size, eye_distance, close = (80, 24), 0.4, 2.0
    slope = np.tan(np.radians(20)) * size[0] / size[1]
    eyes = []
    for x in (0.0, eye_distance):
        across = ((np.arange(size[0]) + 0.5) / size[0] * 2 - 1) * slope * close + x
        is_close = np.abs(across - eye_distance / 2) < 0.35
        color = np.where(is_close[:, None], [9.0, 1.0, 0.0], [0.0, 1.0, 2.0])
        near = np.where(is_close, 1 / close, 1 / DISTANCE)
        eyes.append(eye_of(np.broadcast_to(color, (24, 80, 3)), np.broadcast_to(near, (24, 80)), x))
    for which in (0, 1):
        eye, other = eyes[which], eyes[1 - which]
        blended, beta = run(device, eye, other, kind, which)
        np.testing.assert_allclose(blended, eye.color, atol=1e-6)
        if kind == "constant":
            aside = disparity(*(camera_record(e.camera, size) for e in (eye, other)))
            hidden = np.array([beta[0, c] == 1 for c in range(80)])
            there = np.arange(80) + 0.5 + aside * eye.near[0]
            inside = (there >= 0) & (there < 80)
            nearest = other.near[0, np.clip(there.astype(int), 0, 79)]
            assert np.all(~hidden[inside & (nearest == eye.near[0])])
            assert (
                np.count_nonzero(hidden & inside) >= 3
            )  # the strip of the wall that the close one hides from the other


@pytest.mark.parametrize("close", [2.0, 4.0])
@pytest.mark.parametrize("kind", KINDS)
def test_what_stands_before_a_wall_at_the_images_edge_does_not_leak(device, kind, close):
    """In the outermost row or column, where a step of the depth is not between two others, it is a silhouette all the same."""
    distance = 5.0
    eye = eye_of(np.ones((12, 40, 3)), near=1 / distance)
    for edge in (np.s_[:, 0], np.s_[:, -1], np.s_[0, :], np.s_[-1, :]):
        color, near = np.ones((12, 40, 3)), np.full((12, 40), 1 / distance)
        color[edge], near[edge] = 1000.0, 1 / close
        blended, _ = run(device, eye, eye_of(color, near), kind)
        np.testing.assert_allclose(blended, 1.0, atol=1e-6)


@pytest.mark.parametrize("eye_distance", [0.0, 10.0])
@pytest.mark.parametrize("kind", KINDS)
def test_background_is_blended_with_background_only(device, kind, eye_distance):
    """It is infinitely far away, where eyes 10 m apart see the same."""
    rng = np.random.default_rng(8)
    eye, sky = eye_of(noise(rng, (9, 13)), near=0.0), eye_of(noise(rng, (9, 13)), near=0.0, x=eye_distance)
    blended, beta = run(device, eye, sky, kind)
    assert np.all(beta < 1)
    expected = beta[..., None] * eye.color + (1 - beta[..., None]) * sky.color
    np.testing.assert_allclose(blended, expected, atol=1e-6)
    for far in (1e-6, 1e-30):  # a mountain is not the sky
        mountain = eye_of(sky.color, near=far, x=eye_distance)
        np.testing.assert_array_equal(run(device, eye, mountain, kind)[0], eye.color)
        np.testing.assert_array_equal(run(device, mountain, eye, kind)[0], sky.color)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("eye_distance", [0.0, 0.07])
def test_what_is_not_finite_stays_where_it_is(device, value, kind, eye_distance):
    """Neither does it come from the other eye, nor go from pixel to pixel; and where it is, it is not hidden."""
    rng = np.random.default_rng(9)
    colors = [noise(rng, (9, 13)) for _ in range(2)]
    colors[0][2, 3], colors[1][6, 8, 1] = value, value
    blended, beta = run(device, eye_of(colors[0]), eye_of(colors[1], x=eye_distance), kind)
    is_bad = ~np.isfinite(blended).all(axis=-1)
    assert is_bad[2, 3] and is_bad.sum() == 1
    np.testing.assert_array_equal(blended[2, 3], colors[0][2, 3])
    assert np.all(beta[1:4, 2:5] < 1, where=np.arange(9).reshape(3, 3) != 4)  # its neighbours are blended nevertheless


def test_constant_signals_have_no_variance(device):
    """0 / 0, however large the numbers, keeps the pixel, and so does any difference from what is certain."""
    for level in (1e-6, 1.0, 1e6, 3e7):
        eye = eye_of(np.full((7, 9, 3), level))
        for factor in (1.0, 1 + 1e-6, 2.0):
            blended, beta = run(device, eye, eye_of(np.full((7, 9, 3), level * factor)), "varianceblend")
            np.testing.assert_array_equal(blended, eye.color)
            assert np.all(beta == 1)


def test_large_numbers_do_not_hide_the_variance(device):
    """The same deviations about 0 and about 2^20, which float32 holds to 1/8, give the same weights."""
    rng = np.random.default_rng(10)
    signals = [rng.integers(0, 64, (9, 13, 3)).astype(np.float32) for _ in range(2)]
    near_zero, far_off = (
        run(device, eye_of(signals[0] + level), eye_of(signals[1] + level), "varianceblend", per_channel=True)
        for level in (0.0, 2.0**20)
    )
    np.testing.assert_allclose(far_off[1], near_zero[1], atol=1e-6)


def test_numbers_whose_squares_overflow_keep_the_pixel(device):
    rng = np.random.default_rng(11)
    eye, other = (eye_of(rng.uniform(1e30, 3e30, (5, 6, 3))) for _ in range(2))
    blended, _ = run(device, eye, other, "varianceblend")
    np.testing.assert_array_equal(blended, eye.color)


@pytest.mark.parametrize(("which", "beta"), [(0, 0.0), (1, 0.25), (0, 0.5), (1, 1.0)])
def test_constant_weight(device, which, beta):
    rng = np.random.default_rng(12)
    colors = [noise(rng, (9, 13)) for _ in range(2)]
    blended, own = run(device, eye_of(colors[0]), eye_of(colors[1]), "constant", which, beta=beta)
    np.testing.assert_allclose(blended, (1 - beta) * colors[1] + beta * colors[0], atol=1e-6)
    assert np.all(own == beta)


def test_each_channel_has_its_own_weight(device):
    """Red is without noise, green without difference in the mean, and blue far off; by luminance all have one weight."""
    rng = np.random.default_rng(13)
    own = noise(rng, (40, 60), 1.0, 0.2)
    own[..., 0] = 1.0
    other = np.broadcast_to(np.float32([2.0, 1.0, 3.0]), own.shape)
    blended, _ = run(device, eye_of(own), eye_of(other), "varianceblend", per_channel=True)
    part = (blended - own)[..., 1:] / (other - own)[..., 1:]
    np.testing.assert_array_equal(blended[..., 0], 1.0)
    assert part[..., 0].mean() > 0.85 and part[..., 1].mean() < 0.02
    blended, beta = run(device, eye_of(own), eye_of(other), "varianceblend")
    np.testing.assert_allclose(blended, own + (1 - beta[..., None]) * (other - own), atol=2e-6)


SIGMAS = [(0.2, 0.2, 0.0), (0.2, 0.2, 0.3), (0.1, 0.3, 0.1), (0.3, 0.1, 0.1), (0.2, 0.0, 0.2), (0.2, 0.2, 1.0)]


@pytest.mark.parametrize(("sigma_x", "sigma_y", "bias"), SIGMAS)
def test_error_at_the_optimum_is_that_of_eq_3(device, sigma_x, sigma_y, bias):
    """Gaussian eyes with known moments: blending by Eq. 4's weight has Eq. 3's error, below that of either eye, and of weights
    beside it. A Z-test: the squared errors of the pixels are independent."""
    rng = np.random.default_rng(14)
    y, x = noise(rng, (100, 200), 1.0, sigma_y), noise(rng, (100, 200), 1.0 + bias, sigma_x)
    optimum = 1 - sigma_y**2 / (bias**2 + sigma_x**2 + sigma_y**2)
    errors = {}
    for beta in (optimum, 0.0, 1.0, max(optimum - 0.3, 0), min(optimum + 0.3, 1)):
        blended, _ = run(device, eye_of(y), eye_of(x), "constant", beta=beta)
        squared = (blended.astype(np.float64) - 1.0).ravel() ** 2
        expected = (1 - beta) ** 2 * bias**2 + sigma_x**2 + beta**2 * (sigma_x**2 + sigma_y**2) - 2 * beta * sigma_x**2
        assert abs(squared.mean() - expected) <= 4 * squared.std() / np.sqrt(squared.size) + 1e-7
        errors[beta] = squared.mean()
    assert errors[optimum] == min(errors.values())


@pytest.mark.parametrize(("sigma_x", "sigma_y", "bias"), SIGMAS)
def test_estimated_weights_of_gaussian_eyes(device, sigma_x, sigma_y, bias):
    """The error is that of this estimate of Eq. 4, as another sample of it in NumPy has it, and below that of the eye itself.

    It is below that of Eq. 4's optimum, too, where the bias is not large: that is the best of the weights that do not know the
    values. Where the signal is uniform, as here, the neighbours' mean is near the truth, and a value that is far from it counts
    less.
    """
    rng = np.random.default_rng(15)
    y, x = noise(rng, (150, 200), 1.0, sigma_y), noise(rng, (150, 200), 1.0 + bias, sigma_x)
    blended, beta = run(device, eye_of(y), eye_of(x), "varianceblend", per_channel=True)
    error = ((blended.astype(np.float64) - 1.0) ** 2)[1:-1, 1:-1].mean()
    windows = rng.normal(1.0, sigma_y, (3 * 400, 3 * 400, 1))
    centres = (slice(1, None, 3), slice(1, None, 3))
    others = np.zeros_like(windows)
    others[centres] = rng.normal(1.0 + bias, sigma_x, (400, 400, 1))
    own = estimated_beta(windows, others)[centres]
    again = ((own * windows[centres] + (1 - own) * others[centres] - 1.0) ** 2).mean()
    assert error == pytest.approx(again, rel=0.05, abs=1e-12)
    assert beta[1:-1, 1:-1].mean() == pytest.approx(own.mean(), abs=0.01)
    assert error <= 1.02 * sigma_y**2
