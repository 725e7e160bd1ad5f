"""The script that measures the octree's cache: whole runs on a small scene, what is told of them, and what it refuses."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import clcache
from clcache import cli
from clcache.scene.model import Material

ROOT = Path(clcache.__file__).parents[1]
sys.path.append(str(ROOT / "tools"))
import octree_tables as tool  # noqa: E402

SIZE = "176x164"
SCENE = """
[render]
fps = 10
size = [176, 164]
settings = { "octree.resolution" = 64 }

[camera]
fov_y = 60
keys = [
  { time = 0.0, position = [0.0, 0.5, 3.0], look_at = [0.0, 0.5, 0.0] },
  { time = 1.0, position = [0.0, 2.5, 3.0], look_at = [0.0, 2.5, 0.0] },
]

[environment]
color = [0.5, 0.6, 0.7]

[materials.gloss]
specular = 1.0
roughness = 0.2

[meshes.wall]
generator = "plane"
size = [9.0, 2.0]

[meshes.ball]
generator = "sphere"
radius = 0.5

[[instances]]
mesh = "wall"
rotation = { axis = [1, 0, 0], degrees = 90 }

[[instances]]
mesh = "ball"
material = "gloss"
translation = [0.5, 0.5, 0.5]
"""


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("scene") / "scene.toml"
    file.write_text(SCENE)
    return file


@pytest.fixture(scope="module")
def references(scene_file, tmp_path_factory):
    """Two folders of frames 2 and 4 of 20 frames each second."""
    folders = []
    for seed in ("31", "32"):
        folders.append(str(tmp_path_factory.mktemp("references")))
        for number in (2, 4):
            options = ["--mono", "--spp", "8", "--seed", seed, "--fps", "20", "--frames", f"{number}:{number + 1}"]
            assert cli.main(["render", str(scene_file), *options, "-o", folders[-1]]) == 0
    return folders


def run(experiment, scene_file, tmp_path, *options):
    """What an experiment has found."""
    fixed = ["--scene", str(scene_file), "--json", str(tmp_path / "out.json")]
    assert tool.main([experiment, *fixed, *options]) == 0
    return json.loads((tmp_path / "out.json").read_text())["found"]


def test_table1_has_all_levels_and_keeps_its_law(scene_file, tmp_path, capsys):
    found = run("table1", scene_file, tmp_path, "--resolutions", "64", "128")
    for resolution, levels in (("64", 7), ("128", 8)):
        assert [level["level"] for level in found[resolution]["levels"]] == list(range(levels))
        for level in found[resolution]["levels"]:
            assert level["data_bytes"] == 24 * level["cells"]
            assert level["density"] == pytest.approx(level["cells"] / 8 ** level["level"])
        assert found[resolution]["peak_bytes"] >= found[resolution]["before_bytes"] > 2**20
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == (1 + 7 + 1) + 1 + (1 + 8 + 1) + 1 + 3
    assert lines[1].split()[:3] == ["0", "1", "1"] and lines[1].endswith("1.000")


def test_figure11_goes_on_from_frame_to_frame(scene_file, references, tmp_path, capsys):
    """At the pace that is asked for: frames 2 and 4 of another pace would show the camera elsewhere."""
    options = ("--references", *references, "--frames", "0:9", "--fps", "20")
    found = run("figure11", scene_file, tmp_path, *options, "--pathtrace", "1", "4", "--octree", "1", "2")
    measured = found["measured"]
    assert list(measured) == ["pathtrace 1", "pathtrace 4", "octree 1", "octree 2"]
    for entry in measured.values():
        assert [e["frame"] for e in entry["errors_by_frame"]] == [2, 4]
        assert 0 < entry["standard_error"] < entry["relmse"] and 0 < entry["ms_ssim"] <= 1
    ratio = measured["pathtrace 1"]["relmse"] / measured["pathtrace 4"]["relmse"]
    assert ratio == pytest.approx(4, rel=0.5)
    law = found["by 1/N"]["pathtrace 512, by 1/N of 4"]
    assert law["relmse"] == pytest.approx(measured["pathtrace 4"]["relmse"] / 128)
    for samples, equal, *_ in found["equal"]:
        expected = 4 * measured["pathtrace 4"]["relmse"] / measured[f"octree {samples}"]["relmse"]
        assert float(equal) == pytest.approx(expected, abs=0.51)
    assert set(found["references"]) == {"2", "4"}
    text = capsys.readouterr().out
    assert "std. error" in text and "MS-SSIM of frame" in text
    wrong = run("figure11", scene_file, tmp_path, *options[:-1], "2", "--pathtrace", "4", "--octree", "1")
    assert wrong["measured"]["pathtrace 4"]["relmse"] > 4 * measured["pathtrace 4"]["relmse"]


def test_figure13_has_rows_for_each_resolution(scene_file, references, tmp_path):
    options = ("--references", *references, "--fps", "20", "--resolutions", "64", "128", "--set", "octree.samples=2")
    found = run("figure13", scene_file, tmp_path, *options, "--reconstructions", "2")
    assert list(found) == ["64^3, 2", "64^3, unfiltered, 2", "128^3, 2", "128^3, unfiltered, 2"]
    for name, entry in found.items():
        filtered = {"octree.filter": "none"} if "unfiltered" in name else {}
        common = {"octree.samples": 2, "octree.resolution": int(name.split("^")[0]), "octree.caching_resolution": 0}
        assert entry["settings"] == common | filtered
        assert entry["spp"] == 2 and entry["cache"]["hits"] > 0
    assert found["64^3, 2"]["cache_bytes"] < found["128^3, 2"]["cache_bytes"]


def test_figure16_tells_the_parts_apart(scene_file, references, tmp_path):
    options = ("--references", *references, "--fps", "20", "--reconstructions", "1", "4")
    found = run("figure16", scene_file, tmp_path, *options)
    assert list(found) == [f"{name}, {n}" for name in ("layered", "plain", "none") for n in (1, 4)]
    for entry in found.values():
        share = entry["share"]
        assert 0.01 < share < 0.3  # the ball
        parts = share * entry["view"]["relmse"] + (1 - share) * entry["rest"]["relmse"]
        assert parts == pytest.approx(entry["all"]["relmse"])
        assert entry["stages"]["caching"] == 0
    assert found["none, 4"]["view"]["relmse"] < found["none, 1"]["view"]["relmse"]


def test_figure17_counts_cells(scene_file, tmp_path, capsys):
    options = ("--frames", "0:4", "--skip", "1", "--resolution", "64", "--store", "1,1", "3,2")
    found = run("figure17", scene_file, tmp_path, *options, "--caching-resolutions", "0.5", "1")
    assert list(found) == ["1, 1, 0.5", "1, 1, 1", "3, 2, 0.5", "3, 2, 1"]
    for entry in found.values():
        assert len(entry["frames"]) == 4
        for stages in (frame["stages"] for frame in entry["frames"]):
            assert sum(stages[s] for s in (*tool.STAGES, "both")) == pytest.approx(stages["device"])
    # A quarter of the paths, to fewer cells.
    vertices = [found[name]["cache"]["inserted"] for name in ("1, 1, 0.5", "1, 1, 1")]
    assert vertices[0] == pytest.approx(vertices[1] / 4, rel=0.05)
    assert 0 < found["1, 1, 0.5"]["updated"] < found["1, 1, 1"]["updated"]
    assert found["3, 2, 1"]["cache"]["inserted"] > found["1, 1, 1"]["cache"]["inserted"]
    assert "caching ms" in capsys.readouterr().out


def test_figure18_compares_with_path_tracing(scene_file, tmp_path, capsys):
    found = run("figure18", scene_file, tmp_path, "--frames", "0:4", "--skip", "2", "--size", "64x48")
    assert len(found["frames"]["pathtrace"]) == len(found["reading"]["octree"]) == 4
    for frame in found["reading"]["octree"]:
        assert frame["stages"]["caching"] == 0 < frame["stages"]["reconstruction"]
    counted = [(o["stages"], p["stages"]) for o, p in zip(*found["frames"].values(), strict=True)][2:]
    ratios = sorted(p["reconstruction"] / o["device"] for o, p in counted)
    assert found["ratios"]["reconstruction / path tracing"][1] == pytest.approx(np.median(ratios))
    text = capsys.readouterr().out
    assert "reconstruction / path tracing" in text and "upper quartile" in text


def test_stages():
    passes = {"caching.trace": 1.0, "caching.sort": 2.0, "reconstruction.filter": 4.0, "clear": 8.0}
    assert tool.by_prefix(passes) == {"caching": 3.0, "reconstruction": 4.0, "both": 8.0, "device": 15.0}


@pytest.mark.parametrize(
    ("times", "told"),
    [
        ((2.0, 0.1), ["8", "1024", "51", "512", "met"]),
        ((1.1, 0.1), ["8", "563", "51", "512", "met, within the error"]),
        ((0.9, 0.1), ["8", "461", "51", "512", "missed, within the error"]),
        ((0.5, 0.1), ["8", "256", "51", "512", "missed"]),
    ],
)
def test_goals(times, told):
    assert tool.equal_row(8, times, 512) == told
    assert tool.equal_row(2, times, 512)[3:] == ["-", ""]


def test_what_follows_the_view(scene_file):
    scene = clcache.load_scene(scene_file)
    for changes, expected in (
        ({}, False),
        ({"specular": 1.0, "roughness": 0.2}, True),
        ({"specular": 1.0, "roughness": 0.8}, False),
        ({"metallic": 1.0}, True),
        ({"transmission": 1.0}, True),
    ):
        assert tool.shines(scene, Material("m", **changes)) == expected


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("figure11", "--scene", "{folder}/none.toml", "--references", "{folder}"), "{folder}/none.toml"),
        (("figure11", "--references", "{folder}"), "{folder}: no references; expected files as frame_0000.exr"),
        (("figure13",), "--references"),
        (("figure18", "--skip", "0"), "'0': expected a whole number from 1 on"),
        (("figure18", "--frames", "0:8"), "frames 0:8: expected more than the 8"),
        (("figure18", "--set", "octree.sample=3"), "setting octree.sample: unknown; did you mean octree.samples?"),
        (("figure18", "--set", "octree.samples"), "--set octree.samples: expected KEY=VALUE"),
        (("figure17", "--store", "3"), "'': expected a whole number from 0 on"),
        (("figure17", "--resolution", "65"), "octree.resolution"),
        (("figure17", "--fps", "0"), "'0': expected frames per second"),
    ],
)
def test_the_tool_refuses(arguments, text, scene_file, tmp_path, capsys):
    names = {"folder": tmp_path}
    scene = [] if "--scene" in arguments else ["--scene", str(scene_file)]
    assert tool.main([a.format(**names) for a in (*arguments, *scene)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("octree_tables: error: ")
    assert text.format(**names) in line
