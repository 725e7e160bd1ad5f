"""The paper's closed forms on the real kernels, with Gaussian images of known means and variances.

Seeds are fixed. Tests of means are Z-tests, those of variances chi-square tests, all at significance 1e-4.
"""

import numpy as np
import pytest
from filter_model import Kernels, Model, still
from scipy import stats

SIZE = (128, 96)
SHAPE = (*SIZE[::-1], 3)
VALUES = np.prod(SHAPE)
SIGNIFICANCE = 1e-4
Z = stats.norm.isf(SIGNIFICANCE / 2)
MANY = 1e12  # samples in a history that alpha is not raised for
CASES = [(0.0, 0.1, 0.3), (0.2, 0.1, 0.3), (0.5, 0.4, 0.2), (0.05, 0.3, 0.3), (1.0, 0.01, 0.5), (0.3, 0.2, 0.05)]


def optimum(bias: float, sigma_x: float, sigma_y: float) -> float:
    """Eq. 4."""
    return 1 - sigma_y**2 / (bias**2 + sigma_x**2 + sigma_y**2)


def expected_error(alpha: float, bias: float, sigma_x: float, sigma_y: float) -> float:
    """Eq. 3."""
    return (1 - alpha) ** 2 * bias**2 + sigma_x**2 + alpha**2 * (sigma_x**2 + sigma_y**2) - 2 * alpha * sigma_x**2


def errors(device, alpha: float, bias: float, sigma_x: float, sigma_y: float, seed: int = 1) -> np.ndarray:
    """(H, W, 3): squared errors of blends of a history about 1 + bias with frames about 1, by a given alpha."""
    rng = np.random.default_rng(seed)
    x, y = 1 + bias + sigma_x * rng.normal(size=SHAPE), 1 + sigma_y * rng.normal(size=SHAPE)
    kernels = Kernels(device, Model("taa", SIZE, alpha=alpha, validation="none"))
    kernels.set_history(x, MANY)
    image, weight, _ = kernels.step(y, still(SIZE))
    np.testing.assert_allclose(weight, max(alpha, 1 / (MANY + 1)), rtol=1e-6)
    return (image.astype(np.float64) - 1) ** 2


def z_of(values: np.ndarray, expected: float) -> float:
    """How many standard deviations the mean of independent values is from what is expected."""
    return (values.mean() - expected) / (values.std(ddof=1) / np.sqrt(values.size))


def assert_variance(values: np.ndarray, expected: float, freedom: int) -> None:
    """Chi-square test of the variance of so many independent values."""
    statistic = freedom * values.var(ddof=1) / expected
    assert stats.chi2.ppf(SIGNIFICANCE / 2, freedom) < statistic < stats.chi2.isf(SIGNIFICANCE / 2, freedom)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_optimal_blends_error(device, case):
    """Eq. 3 at Eq. 4's alpha, and at others; at the optimum it is not above the error of either image."""
    best = optimum(*case)
    for alpha in (0.0, 0.5 * best, best, 0.5 + 0.5 * best, 1.0):
        assert abs(z_of(errors(device, alpha, *case), expected_error(alpha, *case))) < Z
    bias, sigma_x, sigma_y = case
    of_best = errors(device, best, *case)
    for other, alpha in ((bias**2 + sigma_x**2, 0.0), (sigma_y**2, 1.0)):
        assert expected_error(best, *case) <= other + 1e-12
        assert z_of(of_best - errors(device, alpha, *case), 0.0) < Z
    assert z_of(of_best, min(bias**2 + sigma_x**2, sigma_y**2)) < Z


@pytest.mark.parametrize("case", CASES[1:4], ids=str)
def test_the_error_is_a_parabola_whose_minimum_is_the_optimum(device, case):
    """Through three weights' measured errors of the same images; a blend is linear in alpha, so nothing else is left to chance
    than the minimum's place. Its standard deviation is taken from 16 parts of the image."""
    alphas = np.array([0.2, 0.5, 0.9])
    measured = np.stack([errors(device, a, *case).reshape(16, -1).mean(axis=1) for a in alphas])
    curvature, slope, _ = np.polyfit(alphas, measured, 2)
    assert (curvature > 0).all()
    least = -slope / (2 * curvature)
    t = (least.mean() - optimum(*case)) / (least.std(ddof=1) / 4)
    assert abs(t) < stats.t.isf(SIGNIFICANCE / 2, 15)
    parabola = np.polyfit(alphas, measured.mean(axis=1), 2)
    assert (measured.mean(axis=1) > np.polyval(parabola, least.mean())).all()
    np.testing.assert_allclose(errors(device, 0.65, *case).mean(), np.polyval(parabola, 0.65), rtol=1e-4)


def noise(frames: int, sigma: float = 0.2, seed: int = 2):
    """Frames of a static scene."""
    rng = np.random.default_rng(seed)
    for _ in range(frames):
        yield np.float32(1 + sigma * rng.normal(size=SHAPE))


def test_equal_weights_of_a_static_scene(device):
    """Eq. 6: with the true moments, no bias and Var(X) / N of the history, alpha is 1 / N in every frame; the variance falls as 1 / N."""
    kernels = Kernels(device, Model("taa", SIZE, alpha=0.0, validation="none"))
    for number, frame in enumerate(noise(40), start=1):
        image, alpha, count = kernels.step(frame, still(SIZE))
        true_alpha = 1.0 if number == 1 else optimum(0.0, 0.2 / np.sqrt(number - 1), 0.2)
        np.testing.assert_allclose(alpha, true_alpha, rtol=1e-4)
        np.testing.assert_allclose(count, number, rtol=1e-4)
        assert_variance(image.astype(np.float64), 0.04 / number, VALUES - 1)


@pytest.mark.parametrize("alpha", [0.1, 0.5, 0.8])
def test_effective_count_is_the_variance_reduction(device, alpha):
    """Eq. 5 against the variance of what the filter shows, in every frame of a constant alpha's way to (2 - alpha) / alpha."""
    kernels = Kernels(device, Model("taa", SIZE, alpha=alpha, validation="none"))
    for frame in noise(50):
        image, _, count = kernels.step(frame, still(SIZE))
        assert np.ptp(count) == 0
        assert_variance(image.astype(np.float64), 0.04 / float(count[0, 0]), VALUES - 1)
    np.testing.assert_allclose(count, (2 - alpha) / alpha, rtol=1e-3)


def run(device, frames, **options):
    """The last frame of a static scene by varianceblend."""
    kernels = Kernels(device, Model("varianceblend", SIZE, **options))
    for frame in frames:
        image, alpha, count = kernels.step(frame, still(SIZE))
    return image.astype(np.float64), alpha, count


@pytest.mark.parametrize("per_channel", [False, True])
def test_estimates_under_noise_alone(device, per_channel):
    """The mean of nine pixels is noisy itself: published, that is taken for bias, which leaves (1/9) / (1/9 + 8/9) of every
    new frame, and more. Corrected, half of the variance goes as well, or more than a third where each channel has its own weights, whose
    noise is averaged; either way the truth is not missed, and N is near what the variance says."""
    options = {"per_channel": per_channel}
    found = {e: run(device, noise(48), estimate=e, **options) for e in ("published", "corrected")}
    variance = {e: image.var(ddof=1) for e, (image, _, _) in found.items()}
    assert variance["corrected"] < 0.04 / (15 if per_channel else 11)
    assert variance["corrected"] < (0.65 if per_channel else 0.53) * variance["published"]
    assert found["published"][1].mean() > 1 / 9
    for estimate, (image, _, count) in found.items():
        of_images = 0.04 / variance[estimate]
        assert 0.8 * of_images < count.mean() < 1.25 * of_images
        # Neighbours share the samples that weigh them, so that a Z-test would need their correlation; blocks do not.
        blocks = image[:, :, 0].reshape(12, 8, 16, 8).mean(axis=(1, 3))
        assert abs(z_of(blocks, 1.0)) < Z


@pytest.mark.parametrize("estimate", ["published", "corrected"])
def test_a_change_is_followed(device, estimate):
    """After 30 frames of one mean, frames of another, ten standard deviations away: within three frames nothing is left of the
    first, where a constant alpha without validation keeps 73 %."""
    kernels = Kernels(device, Model("varianceblend", SIZE, estimate=estimate))
    for frame in noise(30):
        kernels.step(frame, still(SIZE))
    for frame in noise(3, seed=3):
        image, _, _ = kernels.step(frame + 2, still(SIZE))
    assert abs(image.mean() - 3) < 0.02
    slow = Kernels(device, Model("taa", SIZE, validation="none"))
    for frame in noise(30):
        slow.step(frame, still(SIZE))
    for frame in noise(3, seed=3):
        image, _, _ = slow.step(frame + 2, still(SIZE))
    np.testing.assert_allclose(image.mean(), 1 + 2 * (1 - 0.9**3), atol=0.01)


def test_rare_bright_samples_do_not_end_the_history(device):
    """One pixel in fifty is fifty times as bright, in other places every frame. Most neighbourhoods show no noise at all; the corrected
    estimate remembers it, and keeps what the published one takes for bias: 34 frames of 40 instead of one, 62 % of the energy instead
    of 15 %, and so a lower error."""
    rng = np.random.default_rng(5)
    frames = [np.float32(np.repeat(rng.random((*SHAPE[:2], 1)) < 0.02, 3, axis=2) * 50.0) for _ in range(40)]
    found = {e: run(device, frames, estimate=e) for e in ("published", "corrected")}
    rmse = {e: np.sqrt(((image - 1) ** 2).mean()) for e, (image, _, _) in found.items()}
    assert rmse["corrected"] < 0.72 * rmse["published"]
    lost = {e: 1 - image.mean() for e, (image, _, _) in found.items()}
    assert 0 < lost["corrected"] < 0.5 * lost["published"], lost
    assert found["corrected"][2].mean() > 30 > 25 * found["published"][2].mean()


def lamp_trail(device, frames: int, **options) -> np.ndarray:
    """(frames,): what is left where a lamp stood, as a share of its light, on average over its pixels, in the frames after it has gone
    elsewhere. It stood for 20 frames before noise, and no motion tells that it goes."""
    lamp, dark = np.zeros(SHAPE[:2], bool), np.random.default_rng(6)
    for row in range(4, 90, 12):
        lamp[row : row + 5, 8:120] = np.arange(112) % 14 < 5
    kernels, left = Kernels(device, Model("varianceblend", SIZE, **options)), []
    for number in range(20 + frames):
        color = 0.1 + 0.02 * dark.normal(size=SHAPE)
        color[lamp if number < 20 else np.roll(lamp, 7, axis=1)] = 20.0
        image, _, _ = kernels.step(color, still(SIZE))
        left.append((image[lamp].mean() - 0.1) / 19.9)
    assert left[19] > 0.99
    return np.array(left[20:])


@pytest.mark.parametrize("per_channel", [False, True])
def test_a_lamp_that_moves_on_leaves_no_trail(device, per_channel):
    """After three frames less than 5.5 % of its light is left: the variance of its own edge, which the history remembers, passes for
    the noise of one frame, and so explains little of a difference from many."""
    left = lamp_trail(device, 4, per_channel=per_channel)
    assert (left < [0.14, 0.08, 0.055, 0.042]).all(), left
    assert (np.diff(left) < 0).all(), left
