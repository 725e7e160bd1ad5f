"""The script that measures the voxels' cache: which frames it compares, whole runs on a small scene, and what it refuses."""

import argparse
import json
import shutil
import sys
from pathlib import Path

import pytest

import clcache
from clcache import cli
from clcache.metrics import cpbd
from clcache.output.read import read_picture

ROOT = Path(clcache.__file__).parents[1]
sys.path.append(str(ROOT / "tools"))
import measuring  # noqa: E402
import voxelhash_tables as tool  # noqa: E402

SCENE = """
[render]
fps = 10

[camera]
fov_y = 60
keys = [
  { time = 0.0, position = [0.0, 0.5, 3.0], look_at = [0.0, 0.5, 0.0] },
  { time = 1.0, position = [0.0, 2.5, 3.0], look_at = [0.0, 2.5, 0.0] },
]

[environment]
color = [0.5, 0.6, 0.7]

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


def reference(scene_file, folder, number, size="16x16", spp=64):
    """The path tracer's frame."""
    options = ("--mono", "--spp", str(spp), "--size", size, "--frames", f"{number}:{number + 1}", "-o", str(folder))
    assert cli.main(["render", str(scene_file), *options]) == 0
    return folder / f"frame_{number:04d}.exr"


def run(arguments, scene_file, folder, *options):
    """What an experiment has found."""
    fixed = ["--scene", str(scene_file), "--references", str(folder), "--json", str(folder / "out.json")]
    assert tool.main([*arguments, *fixed, *options]) == 0
    return json.loads((folder / "out.json").read_text())["found"]


def test_references_are_those_of_the_frames_that_show_the_same(scene_file, tmp_path):
    for number in (1, 2, 4):
        reference(scene_file, tmp_path, number, spp=1)
    scene = clcache.load_scene(scene_file)

    def numbers(frames, slower):
        args = argparse.Namespace(references=tmp_path, frames=frames, skip=0, slower=slower, size=(16, 16))
        return sorted(tool.slower_references(args, scene))

    assert numbers((0, 9), 2) == [2, 4, 8]
    assert numbers((0, 8), 2) == [2, 4]  # 8 is not rendered
    assert numbers((3, 9), 2) == [4, 8]
    assert numbers((3, 13), 3) == [3, 6, 12]
    assert numbers((0, 9), 1) == [1, 2, 4]


def test_sequences_show_at_twice_the_number_what_the_reference_does(scene_file, tmp_path, capsys):
    kept = reference(scene_file, tmp_path, 2)
    options = ("--size", "16x16", "--frames", "0:6", "--skip", "2", "--temporal", "none")
    found = run(["sequences"], scene_file, tmp_path, *options)
    assert list(found) == ["1spp", "samplecache", "voxelhash", "hybrid", "SC-adaptive"]
    for one in found.values():
        assert ["relmse" in f for f in one["frames"]] == [False] * 4 + [True, False]
        assert one["stages"]["filter"] == 0.0
    text = capsys.readouterr().out
    assert "relMSE of frame" in text and "trace_camera" in text and "lookups" in text
    # The camera rises in time: another frame in the reference's place is far off.
    shutil.copy(reference(scene_file, tmp_path, 4), kept)
    wrong = run(["sequences"], scene_file, tmp_path, *options, "--only", "samplecache")
    assert wrong["samplecache"]["relmse"] > 4 * found["samplecache"]["relmse"]


def test_filter_is_on_top_of_all_methods(scene_file, tmp_path):
    reference(scene_file, tmp_path, 1, spp=1)
    found = run(["sequences"], scene_file, tmp_path, "--size", "16x16", "--frames", "0:3", "--skip", "1")
    for one in found.values():
        assert one["temporal"] == "varianceblend"
        assert one["stages"]["filter"] > 0.0


def test_still_view_is_the_frame_that_the_reference_shows(scene_file, tmp_path, capsys):
    pytest.importorskip("cpbd")
    kept = reference(scene_file, tmp_path, 3, "64x64")
    options = ("--size", "64x64", "--still", "3", "--length", "6", "--skip", "4", "--only", "samplecache", "incidence")
    found = run(["lod"], scene_file, tmp_path, *options)
    assert list(found) == ["samplecache", "incidence"]
    for one in found.values():
        assert ["relmse" in f for f in one["frames"]] == [False] * 5 + [True]
        assert 0.0 < one["difference"] < 0.1
        assert 0.0 <= one["cpbd"] <= 1.0
        assert one["cpbd_reference"] == cpbd(read_picture(kept).color["mono"]) != one["cpbd"]
    assert "flicker" in capsys.readouterr().out
    shutil.copy(reference(scene_file, tmp_path, 0, "64x64"), kept)
    wrong = run(["lod"], scene_file, tmp_path, *options)
    assert wrong["samplecache"]["relmse"] > 4 * found["samplecache"]["relmse"]


@pytest.mark.parametrize("experiment", tool.EXPERIMENTS)
def test_every_pass_is_in_a_stage(experiment, scene_file):
    scene = clcache.load_scene(scene_file)
    args = tool.parse([experiment, "--size", "16x16"])
    for configuration in tool.EXPERIMENTS[experiment]:
        frames = list(measuring.renderer(configuration, scene, args).frames(0, 2))
        entry = measuring.of_frame(frames[-1], tool.STAGES)
        assert sum(entry["stages"].values()) == pytest.approx(sum(entry["passes"].values()))
        assert (entry["stages"]["filter"] > 0) == (configuration.temporal != "none")


def test_each_of_the_settings_differs_in_one():
    """From the defaults, and none has the name of another."""
    names = [c.name for c in tool.SETTINGS]
    assert len(set(names)) == len(names)
    default = clcache.settings.resolve()
    for configuration in tool.SETTINGS:
        own = clcache.settings.resolve(configuration.settings)
        changed = [name for name in own if own[name] != default[name]]
        assert changed == list(configuration.settings)
        assert len(changed) == (configuration.name not in ("voxelhash", "hybrid"))


def test_settings_run_at_the_scenes_own_pace(scene_file, tmp_path):
    reference(scene_file, tmp_path, 2)
    options = ("--size", "16x16", "--frames", "0:3", "--skip", "1", "--only", "no gate", "hybrid, capacity 2^16")
    found = run(["settings"], scene_file, tmp_path, *options)
    assert list(found) == ["no gate", "hybrid, capacity 2^16"]
    assert found["hybrid, capacity 2^16"]["cache"]["capacity"] == 2**16
    assert ["relmse" in f for f in found["no gate"]["frames"]] == [False, False, True]


def test_slow_frames():
    frames = [{"seconds": float(s)} for s in range(101)]
    assert tool.slow({"frames": frames}, 0.95) == 95.0


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("sequences", "--scene", "{folder}/none.toml"), "{folder}/none.toml"),
        (("sequences", "--only", "hashcache"), "--only hashcache: unknown; there is 1spp, samplecache"),
        (("sequences", "--slower", "0"), "'0': expected a whole number from 1 on"),
        (("sequences", "--temporal", "dlss"), "invalid choice: 'dlss'"),
        (("sequences", "--frames", "0:8"), "frames 0:8: expected more than the 8"),
        (("settings", "--still", "3"), "--still"),
        (("lod", "--frames", "0:9"), "--frames"),
        (("lod", "--length", "8"), "expected more than the 32 that --skip leaves out"),
        (("lod", "--references", "{folder}"), "{folder}: no references; expected files as frame_0007.exr"),
    ],
)
def test_tables_refuse(arguments, text, scene_file, tmp_path, capsys):
    names = {"folder": tmp_path}
    scene = [] if "--scene" in arguments else ["--scene", str(scene_file)]
    assert tool.main([a.format(**names) for a in (*arguments, *scene)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("voxelhash_tables: error: ")
    assert text.format(**names) in line
