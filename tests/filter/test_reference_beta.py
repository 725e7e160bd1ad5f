"""The tool that compares the stereo filter's beta with the reference of Fig. 6."""

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import clcache

sys.path.append(str(Path(clcache.__file__).parents[1] / "tools"))
from reference_beta import Moments, against, beta_of, main  # noqa: E402


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
    assert found["mean difference"] == pytest.approx(0.2 / 3)
    assert found["higher"] == pytest.approx(2 / 3)


def test_a_small_run(device_spec, tmp_path, capsys):
    arguments = ["-o", str(tmp_path / "out"), "--size", "32x18", "--spp", "1", "--renders", "3", "--tests", "1"]
    assert main([*arguments, "--device", str(device_spec)]) == 0
    result = json.loads((tmp_path / "out" / "beta.json").read_text())
    assert 0.5 * result["of"] < result["pixels"] < result["of"] == 2 * 32 * 18
    assert all(
        0 <= result["beta"][name]["mean"] <= 1 for name in ("reference", "resampled", "estimate", "mean estimate")
    )
    assert result["rmse"]["0.5"] < result["rmse"]["none"] and result["rmse"]["estimate"] < result["rmse"]["none"]
    with (tmp_path / "out" / "beta.csv").open(newline="") as file:
        rows = {(r["group"], r["name"], r["figure"]): float(r["value"]) for r in csv.DictReader(file)}
    assert rows["rmse", "none", ""] == result["rmse"]["none"]
    assert rows["beta", "estimate", "mean"] == result["beta"]["estimate"]["mean"]
    with Image.open(tmp_path / "out" / "beta.png") as picture:
        assert picture.size == (4 * 32, 18) and len(picture.getcolors()) > 4
    assert "of 1152 pixels" in capsys.readouterr().out


def test_wrong_options_are_one_line_and_exit_code_2(tmp_path, capsys):
    for arguments in (["-o", str(tmp_path), "--renders", "1"], ["-o", str(tmp_path), "--scene", "none.toml"], []):
        assert main(arguments) == 2
        assert capsys.readouterr().err.count("\n") == 1
