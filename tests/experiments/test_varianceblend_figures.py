"""The experiments on the filters, and the comparison of the stereo blend's weights with those of true moments."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from figure_checks import check_names, check_plans

import clcache
from clcache.experiments import varianceblend_figures as figures
from clcache.experiments.experiment import Truth
from clcache.experiments.job import Job, Machine, perform, scene_entry
from clcache.experiments.reference_beta import Moments, against, beta_of

DATA = Path(clcache.__file__).parents[1] / "data"
BETAS = {"reference", "resampled", "estimate", "mean estimate", "0.5", "none"}


@pytest.mark.parametrize("experiment", figures.EXPERIMENTS, ids=lambda e: e.name)
@pytest.mark.parametrize("is_quick", [False, True])
def test_experiments_are_in_keeping_with_themselves(experiment, is_quick):
    check_names(experiment, BETAS if experiment is figures.FIG6 else set())
    check_plans(experiment, DATA, is_quick)


def test_every_pass_is_in_a_stage():
    """Of both filters, of one eye and of two."""
    one, taa, ours, *_ = figures.TEMPORAL.configurations
    mono = replace(figures.TEMPORAL, configurations=(one, taa, ours), scenes=("spheres",), truth=Truth(2, (2,)))
    both = figures.COMBINED[-2:]  # with and without the stereo blend
    stereo = replace(figures.COMBINED_PLAN, configurations=both, scenes=("spheres",), truth=None, metrics=())
    for plan in (mono, stereo):
        small = replace(plan, size=(32, 18), frames=(0, 3), skip=1, pictures=(), quick={})
        (labelled,) = small.jobs(DATA, [1], False)
        needed = {name: perform(job, {}, Machine()) for name, job in labelled.job.needs.items()}
        rows = perform(labelled.job, needed, Machine()).rows
        by_name = {row["configuration"]: row for row in rows if row["frame"] == 2}
        assert list(by_name) == [c.name for c in plan.configurations]
        for c in plan.configurations:
            row = by_name[c.name]
            assert "stage.other" not in row
            parts = [row[f"stage.{stage}"] for stage in figures.STAGES]
            assert sum(parts) == pytest.approx(row["device"])
            filters = c.temporal != "none", c.stereo_blend != "none"
            assert (parts[1] > 0, parts[2] > 0) == filters
            assert set(plan.metrics) <= row.keys()
        assert len({row["difference"] for row in by_name.values()}) == len(by_name)


def test_moments_are_those_of_numpy():
    """Of large numbers, too, whose squares float64 does not hold."""
    images = 1e9 + np.random.default_rng(1).normal(0, 1, (20, 3, 4))
    moments = Moments()
    for each in images:
        moments.add(each)
    np.testing.assert_allclose(moments.mean, images.mean(axis=0), rtol=1e-15)
    np.testing.assert_allclose(moments.variance, images.var(axis=0, ddof=1), rtol=1e-6)


def test_beta_is_that_of_eq_4():
    bias, x, y = (
        np.array([0.0, 0.0, 1.0, 0.0, 2.0]),
        np.array([1.0, 3.0, 1.0, 0.0, 0.0]),
        np.array([1.0, 1.0, 2.0, 0.0, 4.0]),
    )
    np.testing.assert_allclose(beta_of(bias, x, y), [0.5, 0.75, 0.5, 1.0, 0.5])


def test_comparison_of_two_images():
    found = against(np.array([0.2, 0.6, 0.7]), np.array([0.1, 0.3, 0.9]))
    assert found["excess"] == pytest.approx(0.2 / 3)
    assert found["higher"] == pytest.approx(2 / 3)


def test_reference_beta_of_a_small_frame():
    told = {"size": [32, 18], "frame": 15, "spp": 1, "renders": 2, "tests": 1, "seed": 1}
    job = Job("reference_beta", told | {"scene": scene_entry(DATA / "spheres" / "scene.toml")})
    found = perform(job, {}, Machine())
    rows = {row["configuration"]: row for row in found.rows}
    assert rows.keys() > BETAS
    assert 0.5 < rows["none"]["pixels"] / (2 * 32 * 18) < 1
    assert all(0 <= rows[name]["beta"] <= 1 for name in ("reference", "resampled", "estimate", "mean estimate"))
    assert rows["estimate"]["beta"] == rows["mean estimate"]["beta"]  # of one test
    assert max(rows["0.5"]["rmse"], rows["estimate"]["rmse"]) < rows["none"]["rmse"]
    assert rows["resampled"]["variance"] > 0
    excess = rows["estimate"]["beta"] - rows["reference"]["beta"]
    assert rows["estimate against reference"]["excess"] == pytest.approx(excess)
    assert found.arrays["picture/mean estimate/15/left"].shape == (18, 32, 3)
    columns = {column.of for table in figures.FIG6.tables for column in table.columns}
    assert columns <= {key for row in found.rows for key in row}
