"""How far a picture is from its reference, how steady frames are in time, and how well two eyes agree.

All pictures are (H, W, 3) float arrays of linear Rec. 709 radiance. Where a metric is computed differs:

- On radiance itself, unbounded: `relmse`, `rmse`; clipped to [0, 1]: `ssim_linear`, by which Philippi et al. (2023) measure.
- On what a display shows, which is radiance through the tone curve and the sRGB encoding of PNG files (see
  `clcache.output.png`), in [0, 1]: `psnr`, `ssim`, `ms_ssim`, `flip`, `cpbd`. With `encoded=True` the arrays are taken as
  such values and are not mapped again: that serves 8-bit pictures, and whoever wants another mapping.
- On radiance, between two frames or two eyes: `reprojected_difference`.

Of a sequence of frames each picture has its values; `means` has their means, and `summarize` those of the sequence.

A NaN or an infinity is a defect of the picture, and none of these hides it: they raise SettingError, with its count.
"""

from .compare import Comparison, Row, means, summarize
from .image import METRICS, Metric, cpbd, flip, ms_ssim, psnr, relative_error, relmse, rmse, ssim, ssim_linear
from .reprojection import Difference, View, reprojected_difference

__all__ = [
    "METRICS",
    "Comparison",
    "Difference",
    "Metric",
    "Row",
    "View",
    "cpbd",
    "flip",
    "means",
    "ms_ssim",
    "psnr",
    "relative_error",
    "relmse",
    "reprojected_difference",
    "rmse",
    "ssim",
    "ssim_linear",
    "summarize",
]
