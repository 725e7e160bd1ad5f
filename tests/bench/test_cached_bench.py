"""The benchmarks of methods with a cache: which frames they measure."""

from dataclasses import replace

import pytest

from clcache.bench import Job
from clcache.bench.cached import FILLED, samplecache
from clcache.bench.run import FAMILIES
from clcache.errors import SettingError

SCENE = """
[render]
frames = [2, {end}]
[meshes.wall]
generator = "plane"
size = [4.0, 4.0]
[[instances]]
mesh = "wall"
{motion}
[environment]
color = [0.5, 0.6, 0.7]
[camera]
position = [0.0, 3.0, 3.0]
look_at = [0.0, 0.0, 0.0]
fov_y = 45.0
"""
MOTION = """
[[instances.keys]]
time = 0.0
translation = [0.0, 0.0, 0.0]
[[instances.keys]]
time = 1.0
translation = [0.0, 1.0, 0.0]
"""


def job(tmp_path, end, motion=MOTION):
    file = tmp_path / "moving.toml"
    file.write_text(SCENE.format(end=end, motion=motion))
    return Job(("samplecache",), None, None, 2, (16, 8), (str(file),))


def test_all_frames_of_a_moving_scene_are_measured(tmp_path):
    results = {r.name: r for r in samplecache(job(tmp_path, 2 + FILLED + 2))}
    assert len(results["whole frame"].seconds) == 2


@pytest.mark.parametrize(("left", "expected"), [(1, "at most 1"), (0, "more frames"), (-3, "more frames")])
def test_frames_behind_a_moving_scenes_last_are_refused(tmp_path, left, expected):
    end = 2 + FILLED + left
    with pytest.raises(
        SettingError, match=f"--repeats 2: .*moving.toml moves in frames 2:{end}, .*expected {expected}$"
    ):
        next(samplecache(job(tmp_path, end)))


@pytest.mark.parametrize("family", ["samplecache", "voxelhash", "hybrid"])
def test_a_still_scene_has_frames_without_end(tmp_path, family):
    results = list(FAMILIES[family].results(replace(job(tmp_path, 3, motion=""), repeats=3)))
    assert {len(r.seconds) for r in results} == {3}
    assert {r.family for r in results} == {family}
    assert {"shade", "whole frame", "path-traced frame"} <= {r.name for r in results}
