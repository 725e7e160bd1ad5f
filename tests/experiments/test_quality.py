"""Errors against noisy references: that they are without the references' noise, and how sure they are said to be."""

import numpy as np
import pytest

import clcache
from clcache import metrics
from clcache.experiments.quality import BLOCK, block_means, compare, mean_and_error, squared_error

SHAPE = (9 * BLOCK, 16 * BLOCK, 3)


@pytest.fixture
def noisy():
    """A picture of one brightness everywhere, with noise of a standard deviation; each call has new noise."""
    rng = np.random.default_rng(6)
    return lambda deviation: (1.0 + deviation * rng.standard_normal(SHAPE)).astype(np.float32)


def error_of(color, references):
    found = compare({"mono": color}, {"mono": references}, ["relmse"])
    return found["relmse"], found["relmse_error"]


@pytest.mark.parametrize("count", [2, 3])
def test_the_noise_of_references_is_not_counted(noisy, count):
    """A picture with a thirtieth of the references' variance: against one of them, its error would be thirty times too large."""
    color, references = noisy(0.01), [noisy(0.05) for _ in range(count)]
    truth = 0.01**2 / 1.01
    found, error = error_of(color, references)
    assert abs(found - truth) < 3 * error + 2e-6  # the weights' own noise
    assert error < 0.2 * truth
    assert metrics.relmse(color, references[0]) > 20 * truth


def test_of_one_reference_it_is_what_the_metric_is(noisy):
    color, reference = noisy(0.2), noisy(0.1)
    assert squared_error(color, [reference]).mean() == pytest.approx(metrics.relmse(color, reference), rel=1e-6)


def test_standard_errors_are_as_large_as_the_spread(noisy):
    """Of 30 pictures; whose error does not vary over the picture, so that nothing but noise is in it."""
    pairs = [error_of(noisy(0.05), [noisy(0.05), noisy(0.05)]) for _ in range(30)]
    means, errors = np.array(pairs).T
    assert errors.mean() == pytest.approx(means.std(), rel=0.35)


def test_blocks_of_part_of_a_picture():
    """Also where blocks do not divide it, and where some have nothing of the part."""
    rng = np.random.default_rng(8)
    values, mask = rng.random((50, 33)), np.zeros((50, 33), bool)
    mask[3:7, 30:] = mask[41:, 1] = True
    means, counts = block_means(values, mask)
    assert counts.sum() == mask.sum() and len(counts) == 2
    assert mean_and_error(means, counts)[0] == pytest.approx(values[mask].mean())
    assert mean_and_error(*block_means(values))[0] == pytest.approx(values.mean())


def test_metrics_are_means_over_eyes_against_the_mean_of_references():
    rng = np.random.default_rng(9)
    color = {eye: rng.random((30, 40, 3)) * 3 for eye in ("left", "right")}
    references = {eye: [rng.random((30, 40, 3)) * 3 for _ in range(2)] for eye in color}
    found = compare(color, references, ["rmse", "rmse_clipped", "ssim", "ssim_display", "ms_ssim", "cpbd", "relmse"])
    # What needs larger pictures is left out.
    assert found.keys() == {"rmse", "rmse_clipped", "ssim", "ssim_display", "relmse", "relmse_error"}
    means = {eye: (a + b) / 2 for eye, (a, b) in references.items()}
    for name, function in {
        "rmse": lambda x, r: np.sqrt(np.mean((x - r) ** 2)),
        "rmse_clipped": lambda x, r: np.sqrt(np.mean((x.clip(0, 1) - r.clip(0, 1)) ** 2)),
        "ssim": lambda x, r: metrics.ssim(x.clip(0, 1), r.clip(0, 1), encoded=True),
        "ssim_display": metrics.ssim,
    }.items():
        assert found[name] == pytest.approx(np.mean([function(color[eye], means[eye]) for eye in color]))
    products = [(color[e] - references[e][0]) * (color[e] - references[e][1]) / (means[e] ** 2 + 0.01) for e in color]
    assert found["relmse"] == pytest.approx(np.mean(products))


def test_what_cannot_be_compared(noisy):
    color = noisy(0.1)
    color[5, 7, 1] = np.nan
    with pytest.raises(clcache.Error, match="not finite"):
        squared_error(color, [noisy(0.1)])
    with pytest.raises(clcache.SettingError, match="metric mse: unknown; there is relmse, rmse"):
        compare({"mono": color}, {"mono": [color]}, ["mse"])
    # Of equal pictures PSNR is infinite, which no table can hold.
    assert compare({"mono": noisy(0)}, {"mono": [noisy(0)]}, ["psnr"]) == {}
