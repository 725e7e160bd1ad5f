"""How far pictures are from the truth, of which there are only noisy references.

The mean of (x - r)^2 over pixels has the reference's noise in it, and so no picture seems better than that. Of several references with
independent noise the mean of (x - r1)(x - r2) over all pairs of them has it not: what is wrong in one factor has nothing to do with what is in the
other, so that the products' errors cancel on average; where the picture is as good as the truth, the mean may even come out negative.
Relative errors are these over r^2 + 0.01, r being the mean of all references: its noise matters for the weights only, and little. All other
metrics are against the mean of the references.

Standard errors are of means over blocks of pixels, as if those were independent: they have in them the picture's noise and that of the
references, as far as it is independent from block to block, and how much the error varies over the picture; so they are rather too large.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from statistics import fmean

import numpy as np

from .. import metrics
from ..errors import Error, SettingError
from ..metrics.image import RELATIVE_FLOOR

BLOCK = 20  # pixels along a block's side
RELMSE = "relmse"  # which comes with its standard error, as relmse_error


def _clipped_rmse(test: np.ndarray, reference: np.ndarray) -> float:
    """Of values in [0, 1], which fireflies do not dominate."""
    return metrics.rmse(np.clip(test, 0.0, 1.0), np.clip(reference, 0.0, 1.0))


# By the names of columns: what is compared, and the metric of the package whose least size and packages are needed for it. `ssim` is of linear
# values in [0, 1], `ssim_display` of what a display shows; `cpbd_reference` judges the reference by itself.
_COMPARED: dict[str, tuple[Callable[[np.ndarray, np.ndarray], float], str]] = {
    "rmse": (metrics.rmse, "rmse"),
    "rmse_clipped": (_clipped_rmse, "rmse"),
    "ssim": (metrics.ssim_linear, "ssim-linear"),
    "ssim_display": (metrics.ssim, "ssim"),
    "ms_ssim": (metrics.ms_ssim, "ms-ssim"),
    "psnr": (metrics.psnr, "psnr"),
    "flip": (metrics.flip, "flip"),
    "cpbd": (metrics.cpbd, "cpbd"),
    "cpbd_reference": (lambda _, reference: metrics.cpbd(reference), "cpbd"),
}
NAMES = (RELMSE, *_COMPARED)


def compare(
    color: Mapping[str, np.ndarray], references: Mapping[str, Sequence[np.ndarray]], names: Sequence[str]
) -> dict[str, float]:
    """How a frame compares with its references, on average over eyes, by name. names: of NAMES; what needs larger pictures, and what is
    infinite, is left out. color: by eye, (H, W, 3). references: by eye, several. Raises SettingError, Error."""
    found: dict[str, float] = {}
    for name in names:
        if name not in NAMES:
            raise SettingError(f"metric {name}: unknown; there is {', '.join(NAMES)}")
        if name == RELMSE:
            pairs = [mean_and_error(*block_means(squared_error(color[eye], references[eye]))) for eye in color]
            # The eyes see the same light by much the same samples: their errors do not cancel.
            found |= {"relmse": fmean(m for m, _ in pairs), "relmse_error": fmean(e for _, e in pairs)}
            continue
        function, of = _COMPARED[name]
        if min(next(iter(color.values())).shape[:2]) >= metrics.METRICS[of].least_side:
            value = fmean(function(color[eye], np.mean(references[eye], axis=0)) for eye in color)
            found |= {name: value} if math.isfinite(value) else {}
    return found


def squared_error(color: np.ndarray, references: Sequence[np.ndarray]) -> np.ndarray:
    """(H, W): the pixels' relative squared errors, of several references those that their noise does not add to. Raises Error where
    a pixel is not finite."""
    color, known = color.astype(np.float64), [r.astype(np.float64) for r in references]
    if not np.isfinite(color).all():
        raise Error("a picture has pixels that are not finite; expected finite ones")
    pairs = list(itertools.combinations(known, 2)) or [(known[0], known[0])]
    product = sum((color - a) * (color - b) for a, b in pairs) / len(pairs)
    return (product / (np.mean(known, axis=0) ** 2 + RELATIVE_FLOOR)).mean(axis=-1)


def block_means(values: np.ndarray, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The mean of each block of pixels, and how many it has; of those in the mask alone, if there is one, without blocks that have
    none. values: (H, W)."""
    mask = np.ones(values.shape, bool) if mask is None else mask
    rows, columns = (range(0, extent, BLOCK) for extent in values.shape)

    def sums(of: np.ndarray) -> np.ndarray:
        return np.add.reduceat(np.add.reduceat(of, rows, axis=0), columns, axis=1).ravel()

    counts = sums(mask.astype(np.int64))
    is_used = counts > 0
    return sums(np.where(mask, values, 0.0))[is_used] / counts[is_used], counts[is_used]


def mean_and_error(means: np.ndarray, counts: np.ndarray) -> tuple[float, float]:
    """The mean of all pixels, and its standard error, from the blocks' means and sizes."""
    shares = counts / counts.sum()
    whole_mean = float(means @ shares)
    spread = ((shares * (means - whole_mean)) ** 2).sum()
    return whole_mean, math.sqrt(spread * len(means) / max(len(means) - 1, 1))
