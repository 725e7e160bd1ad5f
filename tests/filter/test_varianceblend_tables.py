"""The script that measures the filters: what it compares, whole runs on a small scene, and what it refuses."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import clcache
from clcache import cli

ROOT = Path(clcache.__file__).parents[1]
sys.path.append(str(ROOT / "tools"))
import measuring  # noqa: E402
import varianceblend_tables as tool  # noqa: E402

SCENE = """
[render]
fps = 10

[camera]
fov_y = 60
keys = [
  { time = 0.0, position = [0.0, 0.5, 3.0], look_at = [0.0, 0.5, 0.0] },
  { time = 1.0, position = [1.0, 0.5, 3.0], look_at = [1.0, 0.5, 0.0] },
]

[environment]
color = [0.5, 0.6, 0.7]

[meshes.ball]
generator = "sphere"
radius = 0.4
subdivisions = 2

[[instances]]
mesh = "ball"
translation = [0.0, 0.5, 0.5]

[meshes.wall]
generator = "plane"
size = [100.0, 1.0]

[[instances]]
mesh = "wall"
rotation = { axis = [1, 0, 0], degrees = 90 }
translation = [0.0, 0.5, 0.0]
"""


@pytest.fixture
def scene_file(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(SCENE)
    return file


def reference(scene_file, folder, *options):
    """Frame 3, as path tracing with one sample has it."""
    fixed = ("--spp", "1", "--seed", "7", "--frames", "3:4", "-o", str(folder))
    assert cli.main(["render", str(scene_file), *fixed, *options]) == 0


def run(arguments, scene_file, folder, *options):
    """What an experiment has found. --json and all that is the same in all of them is given."""
    fixed = ["--scene", str(scene_file), "--references", str(folder), "--seed", "7", "--frames", "0:5", "--skip", "2"]
    assert tool.main([*arguments, *fixed, "--json", str(folder / "out.json"), *options]) == 0
    return json.loads((folder / "out.json").read_text())["found"]


def test_errors_are_of_linear_values_and_those_beyond_a_display_count_once():
    test, reference = np.full((16, 16, 3), 3.0), np.full((16, 16, 3), 2.0)
    values = measuring.compared_with({"mono": reference}, {"mono": test}, tool.METRICS)
    assert values["rmse"] == 1.0
    assert values["rmse_clipped"] == 0.0
    assert values["ssim"] == 1.0 > values["ssim_display"]
    halves = measuring.compared_with({"left": test, "right": test}, {"left": test, "right": reference}, tool.METRICS)
    assert halves["rmse"] == 0.5  # of two eyes the mean
    dark = measuring.compared_with({"mono": reference * 0}, {"mono": test * 0 + 0.25}, tool.METRICS)
    assert dark["rmse"] == dark["rmse_clipped"] == 0.25  # not of encoded values


def test_temporal_compares_filters_with_the_plain_image(scene_file, tmp_path, capsys):
    reference(scene_file, tmp_path, "--mono", "--size", "24x16")
    found = run(["temporal"], scene_file, tmp_path, "--size", "24x16")
    assert list(found) == list(tool.USUAL["temporal"])
    plain = found.pop("1spp")
    assert (plain["rmse"], plain["rmse_clipped"], plain["ssim"], plain["ssim_display"]) == (0.0, 0.0, 1.0, 1.0)
    assert plain["stages"]["temporal"] == 0.0
    for one in found.values():
        assert one["rmse"] > 0.0 and one["ssim"] < 1.0
        assert one["difference"] < plain["difference"]
        assert one["stages"]["temporal"] > 0.0 == one["stages"]["stereo"]
        assert ["rmse" in f for f in one["frames"]] == [False, False, False, True, False]
        assert ["difference" in f for f in one["frames"]] == [False, False, True, True, True]
    text = capsys.readouterr().out
    assert "RMSE of frame" in text and "SSIM of frame" in text


def test_combined_adds_stereo_to_temporal(scene_file, tmp_path):
    reference(scene_file, tmp_path, "--stereo", "--size", "24x16")
    found = run(["combined"], scene_file, tmp_path, "--size", "24x16")
    none, temporal, both = (found[name] for name in ("none", "temporal", "temporal + stereo"))
    assert none["rmse"] == 0.0 < temporal["rmse"]
    assert none["frames"][3]["stereo"] == none["stereo_reference"] == both["stereo_reference"] > 0.0
    assert len({none["stereo"], temporal["stereo"], both["stereo"]}) == 3
    assert none["stages"]["temporal"] == temporal["stages"]["stereo"] == 0.0
    assert temporal["stages"]["temporal"] > 0.0 < both["stages"]["stereo"]
    assert none["rays"]["primary"] == 2 * 24 * 16  # of both eyes


def test_only_some_of_them_with_another_history(scene_file, tmp_path):
    reference(scene_file, tmp_path, "--mono", "--size", "24x16")
    only = ("--size", "24x16", "--only", "corrected", "taa-none")
    bicubic, bilinear = (
        run(["temporal"], scene_file, tmp_path, *only, "--history", name) for name in ("bicubic", "bilinear")
    )
    assert list(bicubic) == ["taa-none", "corrected"]
    assert bilinear["corrected"]["settings"]["temporal.history"] == "bilinear"
    assert bicubic["taa-none"]["rmse"] != bilinear["taa-none"]["rmse"]


@pytest.mark.parametrize("experiment", tool.EXPERIMENTS)
def test_every_pass_is_in_a_stage(experiment, scene_file):
    scene = clcache.load_scene(scene_file)
    args = tool.parse([experiment, "--size", "16x16"])
    stereo = experiment == "combined"
    for configuration in measuring.chosen(tool.EXPERIMENTS[experiment], tool.USUAL[experiment]):
        renderer = measuring.renderer(configuration, scene, args, stereo=stereo)
        (frame,) = renderer.frames(0, 1)
        entry = measuring.of_frame(frame, tool.STAGES)
        assert sum(entry["stages"].values()) == pytest.approx(sum(entry["passes"].values()))
        assert (entry["stages"]["stereo"] > 0) == (configuration.stereo_blend != "none")


def test_usual_ones_exist():
    for experiment, names in tool.USUAL.items():
        assert set(names) <= {c.name for c in tool.EXPERIMENTS[experiment]}
        for configuration in tool.EXPERIMENTS[experiment]:
            clcache.settings.resolve(configuration.settings)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("temporal", "--scene", "{folder}/none.toml"), "{folder}/none.toml"),
        (("temporal", "--only", "dlss"), "--only dlss: unknown; there is 1spp, taa-reject"),
        (("temporal", "--history", "cubic"), "--history: invalid choice: 'cubic'"),
        (("temporal", "--frames", "0:8"), "frames 0:8: expected more than the 8 that --skip leaves out"),
        (("temporal", "--references", "{folder}/none"), "{folder}/none: no references; expected files as frame_0000"),
        (("temporal", "--references", "{folder}/two"), "frame_0003.exr: has views left, right; expected one"),
        (("combined", "--references", "{folder}/one"), "frame_0003.exr: has views mono; expected left and right"),
        (("combined", "--references", "{folder}/one", "--size", "8x8"), "16x16 pixels; expected 8x8"),
        (("stereo",), "invalid choice: 'stereo'"),
    ],
)
def test_tables_refuse(arguments, text, scene_file, tmp_path, capsys):
    for eyes, folder in (("--mono", "one"), ("--stereo", "two")):
        reference(scene_file, tmp_path / folder, eyes, "--size", "16x16")
    capsys.readouterr()
    usual = ["--scene", str(scene_file), "--size", "16x16", "--frames", "0:12"]
    arguments = [a.format(folder=tmp_path) for a in arguments]
    given = [o for pair in zip(usual[::2], usual[1::2], strict=True) if pair[0] not in arguments for o in pair]
    assert tool.main([arguments[0], *given, *arguments[1:]]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("varianceblend_tables: error: ")
    assert text.format(folder=tmp_path) in line
