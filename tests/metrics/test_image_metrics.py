"""Each metric against its published definition written out anew, other implementations, closed forms and properties."""

import math
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from skimage import data

from clcache.errors import Error, SettingError
from clcache.metrics import (
    METRICS,
    cpbd,
    flip,
    ms_ssim,
    psnr,
    relative_error,
    relmse,
    rmse,
    ssim,
    ssim_linear,
    summarize,
)
from clcache.metrics.image import to_display
from clcache.output.png import to_bytes

SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)


def photo(size=192):
    """A photograph's middle, grey, in [0, 1]."""
    start = (512 - size) // 2
    grey = data.camera()[start : start + size, start : start + size] / 255.0
    return np.repeat(grey[..., None], 3, axis=-1)


def disturbed(picture, amount=0.1):
    """The picture plus a pattern without random numbers, so that stored values stay valid."""
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    return np.clip(picture + amount * np.sin(1.7 * x + 0.3 * y)[..., None] * np.cos(2.3 * y)[..., None], 0.0, 1.0)


def constant(value, size=192):
    return np.broadcast_to(np.asarray(value, np.float64), (size, size, 3)).copy()


def needs(name):
    return pytest.mark.skipif(not METRICS[name].installed, reason=f"needs {METRICS[name].distribution}")


WITH_REFERENCE = [
    pytest.param(metric, id=metric.name, marks=needs(metric.name)) for metric in METRICS.values() if not metric.of_one
]


# On radiance.


def test_relmse_is_the_mean_of_squares_over_the_reference_squared_plus_a_hundredth():
    reference = np.array([[[0.0, 1.0, 3.0], [10.0, 0.1, 0.0]]])
    test = np.array([[[0.1, 1.5, 3.0], [9.0, 0.2, -0.3]]])
    terms = [0.01 / 0.01, 0.25 / 1.01, 0.0, 1.0 / 100.01, 0.01 / 0.02, 0.09 / 0.01]
    assert relmse(test, reference) == pytest.approx(sum(terms) / 6)
    np.testing.assert_allclose(relative_error(test, reference), [[sum(terms[:3]) / 3, sum(terms[3:]) / 3]])


def test_rmse_is_the_root_of_the_mean_square():
    reference = np.zeros((2, 1, 3))
    test = np.array([[[1.0, 2.0, 3.0]], [[4.0, 5.0, 6.0]]])
    assert rmse(test, reference) == pytest.approx(math.sqrt(91 / 6))


pixels = arrays(np.float32, (3, 4, 3), elements=st.floats(-1e3, 1e3, width=32))


@given(pixels, pixels, st.floats(0.125, 8.0))
def test_rmse_is_a_distance(a, b, scale):
    assert rmse(a, b) == rmse(b, a)
    assert rmse(scale * a.astype(float), scale * b.astype(float)) == pytest.approx(scale * rmse(a, b))
    assert (rmse(a, b) == 0) == np.array_equal(a, b)
    assert relmse(a, b) <= rmse(a, b) ** 2 / 0.01 * (1 + 1e-9)


def test_radiance_metrics_neither_overflow_nor_lose_small_errors():
    bright = np.full((2, 2, 3), 1e30, np.float32)
    assert rmse(-bright, bright) == pytest.approx(2e30, rel=1e-6)
    assert relmse(2 * bright, bright) == pytest.approx(1.0)
    one = np.ones((2, 2, 3), np.float32)
    assert rmse(one + np.float32(2**-20), one) == pytest.approx(2**-20)


# On display values.


def test_psnr_of_a_known_error():
    assert psnr(constant(0.6), constant(0.5), encoded=True) == pytest.approx(20.0)
    assert psnr(constant(0.51), constant(0.5), encoded=True) == pytest.approx(40.0)


def windows(picture):
    """Every 11x11 window of each channel: (h, w, 3, 11, 11)."""
    return np.lib.stride_tricks.sliding_window_view(picture, (11, 11), axis=(0, 1))


def windowed_terms(x, y):
    """Luminance term and contrast-structure term by the sums of Wang et al. (2004), equations 14 to 16, window by window."""
    offset = np.arange(-5, 6)
    weight = np.exp(-(offset[:, None] ** 2 + offset[None] ** 2) / (2 * 1.5**2))
    weight /= weight.sum()
    xs, ys = windows(x), windows(y)
    mean_x, mean_y = ((v * weight).sum(axis=(-2, -1)) for v in (xs, ys))
    from_x, from_y = xs - mean_x[..., None, None], ys - mean_y[..., None, None]
    variance_x, variance_y, covariance = (
        (weight * product).sum(axis=(-2, -1)) for product in (from_x**2, from_y**2, from_x * from_y)
    )
    c1, c2 = 0.01**2, 0.03**2
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    return luminance, (2 * covariance + c2) / (variance_x + variance_y + c2)


def colourful(size):
    """Three different channels, and the same disturbed."""
    grey = photo(size)[..., 0]
    picture = np.stack([grey, grey[::-1], 0.5 * grey.T], axis=-1)
    return disturbed(picture), picture


def test_ssim_is_that_of_wang():
    test, reference = colourful(48)
    luminance, contrast = windowed_terms(test, reference)
    expected = (luminance * contrast).mean()
    assert 0.2 < expected < 0.9
    assert ssim(test, reference, encoded=True) == pytest.approx(expected, abs=1e-9)


def halved(picture):
    odd = picture.shape[0] % 2
    even = np.pad(picture, ((0, odd), (0, odd), (0, 0)), mode="edge")
    return even.reshape(len(even) // 2, 2, len(even) // 2, 2, 3).mean(axis=(1, 3))


@pytest.mark.parametrize("size", [176, 163])
def test_ms_ssim_is_that_of_wang(size):
    test, reference = colourful(size)
    x, y = test, reference
    expected = np.ones(3)
    for scale, weight in enumerate(SCALE_WEIGHTS):
        luminance, contrast = windowed_terms(x, y)
        expected *= (contrast if scale < 4 else luminance * contrast).mean(axis=(0, 1)) ** weight
        if scale < 4:
            x, y = halved(x), halved(y)
    assert 0.2 < expected.mean() < 0.97
    assert ms_ssim(test, reference, encoded=True) == pytest.approx(expected.mean(), abs=1e-9)


# Values of sewar 0.4.10 (pip install sewar) for these grey pictures, taken as by the test below. It halves pictures one
# pixel off, hence the tolerance of the second.
SEWAR_SSIM = 0.611804588180
SEWAR_MS_SSIM = 0.963795270602


def test_ssim_and_ms_ssim_agree_with_recorded_values_of_another_implementation():
    test, reference = disturbed(photo()), photo()
    assert ssim(test, reference, encoded=True) == pytest.approx(SEWAR_SSIM, abs=1e-6)
    assert ms_ssim(test, reference, encoded=True) == pytest.approx(SEWAR_MS_SSIM, abs=1e-3)


def test_recorded_values_are_those_of_the_other_implementation():
    sewar = pytest.importorskip("sewar")
    test, reference = disturbed(photo()), photo()
    gaussian = {"fltr": sewar.utils.Filter.GAUSSIAN, "sigma": 1.5, "ws": 11}
    assert sewar.ssim(reference, test, MAX=1.0, fltr_specs=gaussian)[0] == pytest.approx(SEWAR_SSIM, abs=1e-9)
    assert sewar.msssim(reference, test, MAX=1.0) == pytest.approx(SEWAR_MS_SSIM, abs=1e-9)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@settings(max_examples=10, deadline=None)
def test_ssim_of_constant_pictures_is_the_luminance_term(a, b):
    expected = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
    assert ssim(constant(a), constant(b), encoded=True) == pytest.approx(expected, abs=1e-6)
    assert ms_ssim(constant(a), constant(b), encoded=True) == pytest.approx(expected ** SCALE_WEIGHTS[-1], abs=1e-6)


def test_ms_ssim_of_opposite_pictures_is_zero():
    assert ms_ssim(1.0 - photo(), photo(), encoded=True) == 0.0


@pytest.mark.parametrize("size", [161, 176, 191])
def test_ms_ssim_takes_sides_that_do_not_halve_evenly(size):
    wide = np.concatenate([photo(size), photo(size)[:, :5]], axis=1)
    assert 0.5 < ms_ssim(disturbed(wide), wide, encoded=True) < ms_ssim(disturbed(wide, 0.05), wide, encoded=True) < 1


def hunt_lab(display):
    """CIELAB (D65) of a display colour, its chroma scaled with lightness: Andersson et al. (2020), section 4.1.2."""
    display = np.asarray(display, np.float64)
    linear = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
    # Of the primaries and the white of ITU-R BT.709.
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    ratio = to_xyz @ linear / (to_xyz @ np.ones(3))
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    lightness = 116 * f[1] - 16
    return np.array([lightness, 0.01 * lightness * 500 * (f[0] - f[1]), 0.01 * lightness * 200 * (f[1] - f[2])])


def flip_of_colors(a, b):
    """FLIP of two pictures of one colour each, which have no edges and which its spatial filters leave as they are."""

    def distance(p, q):  # HyAB, to the power 0.7
        d = hunt_lab(p) - hunt_lab(q)
        return (abs(d[0]) + math.hypot(d[1], d[2])) ** 0.7

    largest, error = distance((0, 1, 0), (0, 0, 1)), distance(a, b)
    knee = 0.4 * largest
    return 0.95 * error / knee if error < knee else 0.95 + 0.05 * (error - knee) / (largest - knee)


@needs("flip")
@pytest.mark.parametrize(
    ("a", "b"),
    [((0, 0, 0), (1, 1, 1)), ((0, 1, 0), (0, 0, 1)), ((0.5, 0.5, 0.5), (0.6, 0.5, 0.4)), ((0.2,) * 3, (0.21,) * 3)],
)
def test_flip_of_constant_pictures_is_the_published_colour_difference(a, b):
    assert flip(constant(a, 32), constant(b, 32), encoded=True) == pytest.approx(flip_of_colors(a, b), abs=1e-3)


@needs("flip")
def test_flip_is_that_of_its_authors_package():
    import flip_evaluator

    test, reference = (v.astype(np.float32) for v in colourful(64))
    expected = flip_evaluator.evaluate(reference, test, "LDR")[1]
    assert 0.01 < expected < 0.9
    assert flip(test, reference, encoded=True) == pytest.approx(expected, abs=1e-7)


@needs("cpbd")
def test_cpbd_is_that_of_the_package_on_8_bit_luma():
    import cpbd as package

    grey = data.camera()[64:192, 192:320]
    picture = np.repeat(grey[..., None] / 255.0, 3, axis=-1)
    expected = package.compute(grey)
    assert 0.1 < expected < 1.0
    assert cpbd(picture, encoded=True) == expected
    assert cpbd(picture, constant(0.5, 128), encoded=True) == expected


def test_ssim_linear_is_that_of_clipped_radiance():
    test, reference = (3.0 * v for v in colourful(160))
    assert (test > 1.0).mean() > 0.1 and (test < 1.0).mean() > 0.1
    found = ssim_linear(test, reference)
    assert found == ssim(np.minimum(test, 1.0), np.minimum(reference, 1.0), encoded=True)
    assert found != pytest.approx(ssim(test, reference), abs=1e-3)
    brighter = np.where(reference > 1.0, 2.0 * reference, reference)
    assert ssim_linear(brighter, reference) == 1.0  # what a display cannot show is no difference


def test_a_sequence_is_measured_as_one_picture():
    """relmse and rmse of two pictures are those of one that holds both, beside each other; others are means."""
    rng = np.random.default_rng(1)
    reference = rng.uniform(0, 3, (2, 20, 24, 3))
    test = reference + rng.normal(0, [[[[0.1]]], [[[0.5]]]], reference.shape)
    columns = ["relmse", "rmse", "ssim", "stereo", "temporal"]
    rows = [{name: METRICS[name].function(t, r) for name in columns[:3]} for t, r in zip(test, reference, strict=True)]
    rows[1]["temporal"] = 0.25
    values = summarize(columns, rows)
    for name in ("relmse", "rmse"):
        assert values[name] == pytest.approx(METRICS[name].function(np.hstack(test), np.hstack(reference)))
    assert values["rmse"] > 1.1 * np.mean([row["rmse"] for row in rows])
    assert values["ssim"] == pytest.approx(np.mean([row["ssim"] for row in rows]))
    assert values["temporal"] == 0.25 and "stereo" not in values


@needs("cpbd")
def test_cpbd_falls_with_blur():
    from scipy.ndimage import gaussian_filter

    picture = photo(128)
    values = [cpbd(gaussian_filter(picture, (s, s, 0)), encoded=True) for s in (0.0, 1.0, 2.5)]
    assert values[0] > values[1] > values[2]
    assert cpbd(constant(0.5, 64), encoded=True) == 0.0


# What all have in common.


@pytest.mark.parametrize("metric", WITH_REFERENCE)
def test_equal_pictures_have_the_best_value_and_noise_makes_it_worse(metric):
    reference = photo() * 1.5
    best = {"psnr": math.inf, "ssim": 1.0, "ssim-linear": 1.0, "ms-ssim": 1.0}.get(metric.name, 0.0)
    assert metric.function(reference, reference) == best
    values = [metric.function(disturbed(reference, amount), reference) for amount in (0.02, 0.05, 0.15)]
    ordered = [best, *values] if metric.lower_is_better else [*values[::-1], best]
    assert ordered == sorted(ordered) and len(set(ordered)) == 4


@pytest.mark.parametrize("metric", WITH_REFERENCE)
def test_mirrored_pictures_have_the_same_value(metric):
    test, reference = colourful(176)
    value = metric.function(test, reference)
    assert metric.function(test[:, ::-1], reference[:, ::-1]) == pytest.approx(value, rel=1e-4)
    if metric.name != "relmse":
        assert metric.function(reference, test) == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize("metric", [m for m in WITH_REFERENCE if m.values[0].on_display])
def test_display_metrics_of_radiance_are_those_of_the_png_file(metric):
    test, reference = (8.0 * v**2 for v in colourful(176))
    as_png = [to_bytes(v) / 255.0 for v in (test, reference)]
    assert metric.function(test, reference) == pytest.approx(metric.function(*as_png, encoded=True), rel=0.01)
    assert metric.function(*map(to_display, (test, reference)), encoded=True) == pytest.approx(
        metric.function(test, reference), rel=1e-5
    )


@pytest.mark.parametrize("metric", WITH_REFERENCE)
def test_what_cannot_be_compared_is_an_error_of_one_line(metric):
    good = photo(176)
    for bad in (good[:-1], good[..., :1], good[..., 0], np.empty((0, 4, 3))):
        with pytest.raises(SettingError, match=r"expected .*\(H, W, 3\)") as error:
            metric.function(bad, good)
        assert "\n" not in str(error.value)
    for defect in (np.nan, np.inf, -np.inf):
        defective = good.copy()
        defective[3, 4, 1] = defective[5, 6] = defect
        with pytest.raises(SettingError, match="test has 2 of 30,976 pixels that are NaN or infinite"):
            metric.function(defective, good)
        with pytest.raises(SettingError, match="reference has 2 of"):
            metric.function(good, defective)
    if metric.on_display:
        with pytest.raises(SettingError, match=r"expected 0 \.\. 1"):
            metric.function(good + 0.5, good, encoded=True)


@pytest.mark.parametrize("name", ["ssim", "ssim-linear", "ms-ssim", pytest.param("cpbd", marks=needs("cpbd"))])
def test_least_side_is_the_least_that_works(name):
    metric = METRICS[name]
    least = metric.least_side
    picture = photo(176)[:least]
    assert 0.0 <= metric.function(picture, picture) <= 1.0
    with pytest.raises(SettingError, match=f"{name}.*at least {least} a side"):
        metric.function(picture[:-1], picture[:-1])


@pytest.mark.parametrize("name", ["flip", "cpbd"])
def test_a_missing_package_is_named_with_its_command(name, monkeypatch):
    metric = METRICS[name]
    monkeypatch.setitem(sys.modules, metric.module, None)
    with pytest.raises(Error, match=f"{name}.*pip install {metric.distribution}"):
        metric.function(photo(64), photo(64))
