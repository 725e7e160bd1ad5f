"""Whether two renderers give the same image, up to the noise of either.

The test is the one that Mitsuba 3 makes of itself (src/render/tests/test_renders.py, described in its documentation for
developers): both sides give a mean and its variance for each value of each pixel; the difference of the means is put in
relation to its standard deviation, and the probability of one as large under the hypothesis that both means are equal
is compared with a level that holds for the whole image: significance 0.01, Sidak-corrected over the pixels,
1 - (1 - 0.01)^(1 / pixels). The images agree if at least 99.75 % of the values accept the hypothesis.

Here neither side is a stored truth: the statistic is Welch's, for two means of unknown and unequal variance, with the
degrees of freedom of Welch and Satterthwaite. What is independent are whole renders with different seeds, so that the
variance is that of batches of samples, and of stratified ones as well.

Heavy tails. A pixel that a rare bright path can reach, but did not in these samples, has mean and variance too small at
once. Three things keep such pixels from deciding: a batch is a mean of many samples, nearly normal; Student's
distribution allows for a variance that few batches estimate badly; and 0.25 % of the values may reject. What that
tolerates in single pixels is caught by a second test on the means of blocks of pixels, whose noise is a fraction of the
pixels' and nearer to normal, so that a small error of the whole image shows. There every value has to accept, at a level
that the image as a whole misses by chance in one of 10,000 tests. `agree` gives both verdicts.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import stats

SIGNIFICANCE = 0.01
ACCEPTED = 0.9975  # part of the values
BLOCK = 8  # pixels of a side
BLOCK_SIGNIFICANCE = 1e-4
ROUNDING = 2e-5  # relative: what sums of float32 may be off where there is no noise at all


@dataclass(frozen=True)
class Estimate:
    """mean, variance: (H, W, 3) float64, of the mean of `batches` independent renders."""

    mean: np.ndarray
    variance: np.ndarray
    batches: int


@dataclass(frozen=True)
class Verdict:
    """accepted: part of the values that accept that both means are equal. largest: of the statistics' sizes. bias: relative
    difference of the images' means. passed: whether the images agree."""

    accepted: float
    largest: float
    bias: float
    passed: bool


def estimate(renders: Iterable[np.ndarray], block: int = 1) -> Estimate:
    """From independent renders of equal samples, (H, W, 3) each; at least two. block: pixels of a side that become one."""
    stack = np.stack([blocks(np.asarray(r, np.float64), block) for r in renders])
    return Estimate(stack.mean(axis=0), stack.var(axis=0, ddof=1) / len(stack), len(stack))


def blocks(image: np.ndarray, size: int) -> np.ndarray:
    """The means of size x size pixels; what is left over at the right and below is cut off."""
    height, width = (side - side % size for side in image.shape[:2])
    split = image[:height, :width].reshape(height // size, size, width // size, size, -1)
    return split.mean(axis=(1, 3))


def z_test(a: Estimate, b: Estimate, significance: float = SIGNIFICANCE, accepted: float = ACCEPTED) -> Verdict:
    """The test of the module's docstring on two estimates of the same shape. accepted: part of the values that must accept."""
    difference = a.mean - b.mean
    rounding = (ROUNDING * np.maximum(np.abs(a.mean), np.abs(b.mean))) ** 2
    variance = a.variance + b.variance
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = np.where(difference == 0, 0, difference / np.sqrt(variance + rounding))
        freedom = variance**2 / (a.variance**2 / (a.batches - 1) + b.variance**2 / (b.batches - 1))
    freedom = np.where(variance > rounding, freedom, np.inf)
    probability = 2 * stats.t.sf(np.abs(statistic), freedom)
    level = 1 - (1 - significance) ** (1 / (a.mean.shape[0] * a.mean.shape[1]))
    part = float((probability > level).mean())
    bias = float(a.mean.mean() / b.mean.mean() - 1)
    return Verdict(part, float(np.abs(statistic).max()), bias, part >= accepted)


def agree(ours: list[np.ndarray], theirs: list[np.ndarray]) -> tuple[Verdict, Verdict]:
    """The verdicts on pixels and on blocks of them, from independent renders of each side."""
    pixels = z_test(estimate(ours), estimate(theirs))
    return pixels, z_test(estimate(ours, BLOCK), estimate(theirs, BLOCK), BLOCK_SIGNIFICANCE, accepted=1.0)
