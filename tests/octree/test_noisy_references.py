"""Errors against noisy references: that they are without the references' noise, and how sure they are said to be."""

import sys
from pathlib import Path

import numpy as np
import pytest

import clcache
from clcache import metrics

sys.path.append(str(Path(clcache.__file__).parents[1] / "tools"))
from noisy_references import BLOCK, Errors, block_means, mean_and_error, quotient, squared_error  # noqa: E402

SHAPE = (9 * BLOCK, 16 * BLOCK, 3)


@pytest.fixture
def noisy():
    """A picture of one brightness everywhere, with noise of a standard deviation; each call has new noise."""
    rng = np.random.default_rng(6)
    return lambda deviation: (1.0 + deviation * rng.standard_normal(SHAPE)).astype(np.float32)


def errors_of(*pictures):
    errors = Errors()
    for number, (color, references) in enumerate(pictures):
        errors.blocks[number] = block_means(squared_error(color, references))
    return errors


@pytest.mark.parametrize("count", [2, 3])
def test_the_noise_of_references_is_not_counted(noisy, count):
    """A picture with a thirtieth of the references' variance: against one of them, its error would be thirty times too large."""
    color, references = noisy(0.01), [noisy(0.05) for _ in range(count)]
    truth = 0.01**2 / 1.01
    found, error = errors_of((color, references)).relmse
    assert abs(found - truth) < 3 * error + 2e-6  # the weights' own noise
    assert error < 0.2 * truth
    assert metrics.relmse(color, references[0]) > 20 * truth


def test_of_one_reference_it_is_what_the_metric_is(noisy):
    color, reference = noisy(0.2), noisy(0.1)
    assert squared_error(color, [reference]).mean() == pytest.approx(metrics.relmse(color, reference), rel=1e-6)


def test_standard_errors_are_as_large_as_the_spread(noisy):
    """Of 60 pictures; whose error does not vary over the picture, so that nothing but noise is in it."""
    pairs = [errors_of((noisy(0.05), [noisy(0.05), noisy(0.05)])).relmse for _ in range(60)]
    means, errors = np.array(pairs).T
    assert errors.mean() == pytest.approx(means.std(), rel=0.3)


def test_frames_are_averaged(noisy):
    pictures = [(noisy(s), [noisy(0.02), noisy(0.02)]) for s in (0.1, 0.2, 0.4)]
    each = [errors_of(p).relmse for p in pictures]
    found, error = errors_of(*pictures).relmse
    assert found == pytest.approx(np.mean([m for m, _ in each]))
    assert error == pytest.approx(np.linalg.norm([e for _, e in each]) / 3)


def test_quotients_and_their_errors(noisy):
    """The same references for both: four times the variance."""
    found = []
    for _ in range(40):
        references = [noisy(0.05), noisy(0.05)]
        found.append(quotient(errors_of((noisy(0.1), references)), errors_of((noisy(0.05), references))))
    values, errors = np.array(found).T
    assert values.mean() == pytest.approx(4.0, rel=0.02)
    assert errors.mean() == pytest.approx(values.std(), rel=0.4)
    one = errors_of((noisy(0.1), references))
    assert quotient(one.scaled(8.0), one) == pytest.approx((1 / 8, 0.0), abs=1e-12)


def test_blocks_of_part_of_a_picture():
    """Also where blocks do not divide it, and where some have nothing of the part."""
    rng = np.random.default_rng(8)
    values, mask = rng.random((50, 33)), np.zeros((50, 33), bool)
    mask[3:7, 30:] = mask[41:, 1] = True
    means, counts = block_means(values, mask)
    assert counts.sum() == mask.sum() and len(counts) == 2
    assert mean_and_error(means, counts)[0] == pytest.approx(values[mask].mean())
    assert mean_and_error(*block_means(values))[0] == pytest.approx(values.mean())


def test_pixels_that_are_not_finite(noisy):
    color = noisy(0.1)
    color[5, 7, 1] = np.nan
    with pytest.raises(clcache.Error, match="not finite"):
        squared_error(color, [noisy(0.1)])
