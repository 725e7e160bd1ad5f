"""How far pictures are from the truth, of which there are only noisy references.

The mean of (x - r)^2 over pixels has the reference's noise in it, and so no picture seems better than that. Of several references with
independent noise the mean of (x - r1)(x - r2) over all pairs of them has it not: what is wrong in one factor has nothing to do with what is in the
other, so that the products' errors cancel on average; where the picture is as good as the truth, the mean may even come out negative.
Relative errors are these over r^2 + 0.01, r being the mean of all references: its noise matters for the weights only, and little.

Standard errors are of means over blocks of pixels, as if those were independent: they have in them the picture's noise and that of the
references, as far as it is independent from block to block, and how much the error varies over the picture; so they are rather too large.
Of quotients they are by the jackknife, leaving out one block at a time: that does not count what their two errors have in common.
"""

import itertools
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from clcache import Error
from clcache.metrics import ms_ssim
from clcache.metrics.image import RELATIVE_FLOOR

BLOCK = 20  # pixels along a block's side


@dataclass(frozen=True)
class Errors:
    """How far frames are from their references. blocks: by frame, relMSE of each block of pixels, and how many pixels it has.
    ms_ssim: by frame."""

    blocks: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    ms_ssim: dict[int, float] = field(default_factory=dict)

    def add(self, number: int, color: np.ndarray, references: Sequence[np.ndarray]) -> None:
        """A frame's picture, and its references."""
        self.blocks[number] = block_means(squared_error(color, references))
        self.ms_ssim[number] = ms_ssim(color, np.mean(references, axis=0))

    @property
    def relmse(self) -> tuple[float, float]:
        """Mean over frames, and its standard error."""
        found = [mean_and_error(*blocks) for blocks in self.blocks.values()]
        return statistics.fmean(m for m, _ in found), math.hypot(*(e for _, e in found)) / len(found)

    def scaled(self, factor: float) -> "Errors":
        """What these errors would be with so many times the samples, by the law 1/N; without MS-SSIM."""
        return Errors({number: (means / factor, counts) for number, (means, counts) in self.blocks.items()})

    def entry(self) -> dict:
        """All of it for JSON."""
        relmse, error = self.relmse
        by_frame = {n: mean_and_error(*blocks) for n, blocks in self.blocks.items()}
        frames = [
            {"frame": n, "relmse": m, "standard_error": e, "ms_ssim": self.ms_ssim.get(n)}
            for n, (m, e) in by_frame.items()
        ]
        return {
            "relmse": relmse,
            "standard_error": error,
            "ms_ssim": statistics.fmean(self.ms_ssim.values()) if self.ms_ssim else None,
            "errors_by_frame": frames,
        }


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


def quotient(above: Errors, below: Errors) -> tuple[float, float]:
    """Mean error over mean error of the same frames, and its standard error, by the jackknife over blocks."""
    shares = np.concatenate([counts / counts.sum() for _, counts in above.blocks.values()])
    a, b = (np.concatenate([means for means, _ in e.blocks.values()]) * shares for e in (above, below))
    found = a.sum() / b.sum()
    without = (a.sum() - a) / (b.sum() - b)
    n = len(a)
    return float(found), float(math.sqrt((n - 1) / n * ((without - without.mean()) ** 2).sum()))
