"""Metrics of one picture against its reference."""

import importlib.util
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean
from types import ModuleType

import numpy as np
from PIL import Image
from scipy.ndimage import correlate1d
from skimage.metrics import structural_similarity

from ..errors import Error, SettingError
from ..output.png import encode_srgb, tone_map

RELATIVE_FLOOR = 0.01  # added to ref^2, so that dark pixels do not divide by zero
# Wang et al., "Image Quality Assessment: From Error Visibility to Structural Similarity" (2004)
WINDOW_SIGMA = 1.5
WINDOW_RADIUS = 5
K1, K2 = 0.01, 0.03
# Wang et al., "Multiscale Structural Similarity for Image Quality Assessment" (2003), section 3.2: the scales' weights.
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
WINDOW = 2 * WINDOW_RADIUS + 1
CPBD_BLOCK = 64


def relmse(test: np.ndarray, reference: np.ndarray) -> float:
    """Relative mean squared error: the mean over pixels and channels of (x - ref)^2 / (ref^2 + 0.01), on radiance.

    test, reference: (H, W, 3), finite. Returns 0 for equal pictures, without bound. Source: the relative squared error
    (RSE) that Philippi et al. (2025), section 5, plot without a formula; this is its usual one (Rousselle et al.,
    "Adaptive Sampling and Reconstruction using Greedy Error Minimization", 2011). So RSE has no name of its own here. Raises SettingError where shapes differ or a
    pixel is not finite.
    """
    return float(relative_error(test, reference).mean())


def relative_error(test: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The map that `relmse` is the mean of: (H, W) float64, averaged over channels. Arguments and errors as there."""
    test, reference = _pair(test, reference)
    return ((test - reference) ** 2 / (reference**2 + RELATIVE_FLOOR)).mean(axis=-1)


def rmse(test: np.ndarray, reference: np.ndarray) -> float:
    """Root of the mean squared error over pixels and channels, on radiance, as Philippi et al. (2023), section 5, measure it.

    test, reference: (H, W, 3), finite. Raises SettingError where shapes differ or a pixel is not finite.
    """
    test, reference = _pair(test, reference)
    return math.sqrt(np.mean((test - reference) ** 2))


def rmse_of_sequence(values: Sequence[float]) -> float:
    """RMSE over all pixels of pictures of one size, from that of each: the root of the mean of their squares."""
    return math.sqrt(fmean(value**2 for value in values))


def psnr(test: np.ndarray, reference: np.ndarray, *, encoded: bool = False) -> float:
    """Peak signal-to-noise ratio of what a display shows, in dB, with peak 1; infinite for equal pictures.

    test, reference: (H, W, 3) radiance; display values in [0, 1] if `encoded`. Raises SettingError where shapes differ or
    a pixel is not finite, or not in [0, 1] though `encoded`.
    """
    test, reference = _display_pair(test, reference, encoded)
    squared_error = np.mean((test - reference) ** 2)
    return -10.0 * math.log10(squared_error) if squared_error > 0.0 else math.inf


def ssim(test: np.ndarray, reference: np.ndarray, *, encoded: bool = False) -> float:
    """Structural similarity of what a display shows: mean over pixels and channels; 1 for equal pictures.

    Gaussian window of sigma 1.5 and 11x11 pixels, K1 = 0.01, K2 = 0.03, range 1 (Wang et al. 2004), by scikit-image.
    test, reference: (H, W, 3) radiance; display values in [0, 1] if `encoded`. Raises SettingError as `psnr` does, and for
    pictures of less than 11 pixels a side.
    """
    test, reference = _display_pair(test, reference, encoded)
    _check_side(test, "ssim")
    similarity = structural_similarity(
        test,
        reference,
        channel_axis=-1,
        data_range=1.0,
        gaussian_weights=True,
        sigma=WINDOW_SIGMA,
        use_sample_covariance=False,
        K1=K1,
        K2=K2,
    )
    return float(similarity)


def ssim_linear(test: np.ndarray, reference: np.ndarray) -> float:
    """The structural similarity of `ssim` on linear radiance clipped to [0, 1], as Philippi et al. (2023), section 5, measure it.

    They say that image quality is measured in linear RGB, which without a range of values is no SSIM; clipped to the range
    that a display has, it is. test, reference: (H, W, 3) radiance. Raises SettingError where shapes differ or a pixel is
    not finite, and for pictures of less than 11 pixels a side.
    """
    test, reference = (np.clip(picture, 0.0, 1.0) for picture in _pair(test, reference))
    _check_side(test, "ssim-linear")
    return ssim(test, reference, encoded=True)


def ms_ssim(test: np.ndarray, reference: np.ndarray, *, encoded: bool = False) -> float:
    """Multi-scale structural similarity of what a display shows, mean over channels; 1 for equal pictures.

    Wang et al. 2003: contrast and structure at five scales, luminance at the coarsest, each a mean over the places where
    the window of `ssim` fits; between scales pixels are averaged two by two. A negative mean of contrast and structure
    counts as 0, since no real power of it exists. test, reference: (H, W, 3) radiance; display values in [0, 1] if
    `encoded`. Raises SettingError as `psnr` does, and for pictures of less than 161 pixels a side.
    """
    test, reference = _display_pair(test, reference, encoded)
    _check_side(test, "ms-ssim")
    # Double precision: the variances are differences of nearly equal means.
    images = np.stack((test, reference)).astype(np.float64)
    similarity = np.ones(images.shape[-1])
    for scale, weight in enumerate(SCALE_WEIGHTS):
        luminance, contrast = _compare_windows(*images)
        coarsest = scale == len(SCALE_WEIGHTS) - 1
        mean = (luminance * contrast if coarsest else contrast).mean(axis=(0, 1))
        similarity *= np.maximum(mean, 0.0) ** weight
        images = _halve(images)
    return float(similarity.mean())


def flip(test: np.ndarray, reference: np.ndarray, *, encoded: bool = False) -> float:
    """Mean FLIP error of what a display shows, seen at 67 pixels per degree: 0 for equal pictures, at most 1.

    LDR-FLIP of Andersson et al., "FLIP: A Difference Evaluator for Alternating Images" (2020), by its authors' package
    flip-evaluator. HDR-FLIP would choose its exposures anew for every reference, so that frames of one sequence could not be
    compared with each other, and takes four times as long. test, reference: (H, W, 3) radiance; display values in [0, 1]
    if `encoded`. Raises SettingError as `psnr` does, and Error where the package is missing.
    """
    test, reference = _display_pair(test, reference, encoded)
    package = _optional("flip")
    test, reference = (np.ascontiguousarray(image, np.float32) for image in (test, reference))
    return float(package.evaluate(reference, test, "LDR", inputsRGB=True, applyMagma=False)[1])


def cpbd(test: np.ndarray, reference: np.ndarray | None = None, *, encoded: bool = False) -> float:
    """Sharpness of what a display shows: the share of edges on which blur would not be noticed, 0 to 1; 0 without edges.

    Cumulative probability of blur detection of Narvekar and Karam (2011), by the package cpbd-py312, on 8-bit luma. It
    judges a picture by itself: Philippi et al. (2025), section 5.2, look for the value that the reference has. reference: not
    looked at; it is there so that all metrics are called alike. test: (H, W, 3) radiance; display values in [0, 1] if
    `encoded`. Raises SettingError as `psnr` does, and for pictures of less than 64 pixels a side; Error where the package
    is missing.
    """
    picture = check_color(test, "test") if encoded else to_display(test)
    _check_range(picture)
    _check_side(picture, "cpbd")
    package = _optional("cpbd")
    luma = Image.fromarray(np.rint(picture * 255.0).astype(np.uint8)).convert("L")
    return float(package.compute(np.asarray(luma)))


def to_display(color: np.ndarray) -> np.ndarray:
    """What a display shows of linear radiance: (H, W, 3) float32 in [0, 1]. Raises SettingError where a pixel is not finite."""
    return encode_srgb(tone_map(check_color(color, "the picture")))


@dataclass(frozen=True)
class Metric:
    """What the command line needs to know of a metric.

    name: as users write it. function: called with test and reference, and with `encoded` where `on_display`. least_side:
    pixels that each side must have. module, distribution: of the optional package that it needs. of_one: it judges one
    picture, so that the reference has a value too. of_sequence: from the values of pictures of one size, that of all their pixels
    together, or their mean, where the metric is of whole pictures.
    """

    name: str
    function: Callable[..., float]
    on_display: bool
    lower_is_better: bool
    least_side: int = 1
    module: str | None = None
    distribution: str | None = None
    of_one: bool = False
    of_sequence: Callable[[Sequence[float]], float] = fmean

    @property
    def installed(self) -> bool:
        """Whether the package that it needs can be found."""
        return self.module is None or importlib.util.find_spec(self.module) is not None


METRICS: dict[str, Metric] = {
    metric.name: metric
    for metric in (
        Metric("relmse", relmse, on_display=False, lower_is_better=True),
        Metric("rmse", rmse, on_display=False, lower_is_better=True, of_sequence=rmse_of_sequence),
        Metric("psnr", psnr, on_display=True, lower_is_better=False),
        Metric("ssim", ssim, on_display=True, lower_is_better=False, least_side=WINDOW),
        Metric("ssim-linear", ssim_linear, on_display=False, lower_is_better=False, least_side=WINDOW),
        # Of sides that are halved and rounded up four times, the least that still hold a window.
        Metric("ms-ssim", ms_ssim, on_display=True, lower_is_better=False, least_side=(WINDOW - 1) * 2**4 + 1),
        Metric(
            "flip", flip, on_display=True, lower_is_better=True, module="flip_evaluator", distribution="flip-evaluator"
        ),
        Metric(
            "cpbd",
            cpbd,
            on_display=True,
            lower_is_better=False,
            least_side=CPBD_BLOCK,
            module="cpbd",
            distribution="cpbd-py312",
            of_one=True,
        ),
    )
}


def _optional(name: str) -> ModuleType:
    metric = METRICS[name]
    try:
        return importlib.import_module(metric.module)
    except ImportError as error:
        raise Error(
            f"{name}: needs the package {metric.distribution} ({error}); to install it: pip install {metric.distribution}"
        ) from None


def _pair(test: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as float64, seen to be comparable."""
    test, reference = np.asarray(test), np.asarray(reference)
    if test.shape != reference.shape:
        raise SettingError(
            f"test is {test.shape} and reference {reference.shape}; expected pictures of one shape, (H, W, 3)"
        )
    return check_color(test, "test").astype(np.float64), check_color(reference, "reference").astype(np.float64)


def _display_pair(test: np.ndarray, reference: np.ndarray, encoded: bool) -> tuple[np.ndarray, np.ndarray]:
    test, reference = _pair(test, reference)
    if not encoded:
        return to_display(test), to_display(reference)
    _check_range(test)
    _check_range(reference)
    return test, reference


def check_color(color: np.ndarray, what: str) -> np.ndarray:
    """The picture as an array. Raises SettingError, which begins with `what`, if it is not (H, W, 3) and finite."""
    color = np.asarray(color)
    if color.ndim != 3 or color.shape[-1] != 3 or not color.size:
        raise SettingError(f"{what} is {color.shape}; expected (H, W, 3) with at least one pixel")
    bad = np.count_nonzero(~np.isfinite(color).all(axis=-1))
    if bad:
        total = color.shape[0] * color.shape[1]
        raise SettingError(f"{what} has {bad:,} of {total:,} pixels that are NaN or infinite; expected finite ones")
    return color


def _check_range(display: np.ndarray) -> None:
    if display.min() < 0.0 or display.max() > 1.0:
        raise SettingError(f"encoded values reach from {display.min():g} to {display.max():g}; expected 0 .. 1")


def _check_side(color: np.ndarray, name: str) -> None:
    height, width, _ = color.shape
    least = METRICS[name].least_side
    if min(height, width) < least:
        raise SettingError(f"{name}: the picture has {width}x{height} pixels; expected at least {least} a side")


def _compare_windows(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Luminance term, and contrast and structure term, of each window that fits into the pictures."""
    mean_x, mean_y = _window_mean(x), _window_mean(y)
    energy = mean_x**2 + mean_y**2
    product = mean_x * mean_y
    variance = _window_mean(x * x + y * y) - energy
    covariance = _window_mean(x * y) - product
    c1, c2 = K1**2, K2**2
    return (2 * product + c1) / (energy + c1), (2 * covariance + c2) / (variance + c2)


def _window_mean(image: np.ndarray) -> np.ndarray:
    weights = np.exp(-0.5 * (np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1) / WINDOW_SIGMA) ** 2)
    weights /= weights.sum()
    inner = slice(WINDOW_RADIUS, -WINDOW_RADIUS)
    rows = correlate1d(image, weights, axis=0)[inner]
    return correlate1d(rows, weights, axis=1)[:, inner]


def _halve(images: np.ndarray) -> np.ndarray:
    """(n, H, W, 3) averaged two by two; the last row or column of an odd number stands for its missing neighbour too."""
    _, height, width, _ = images.shape
    images = np.pad(images, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return 0.25 * (images[:, ::2, ::2] + images[:, 1::2, ::2] + images[:, ::2, 1::2] + images[:, 1::2, 1::2])
