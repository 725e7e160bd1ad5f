"""The scripts that measure the sample cache: depths, sums, whole runs by path tracing alone, and what they refuse."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import clcache
from clcache import Error, Renderer, Tracer, cli

ROOT = Path(clcache.__file__).parents[1]
sys.path.append(str(ROOT / "tools"))
import measuring  # noqa: E402
import samplecache_tables as tool  # noqa: E402
import single_pass_races  # noqa: E402
import stereo_blending_table  # noqa: E402

SCENE = """
[camera]
position = [0.0, 0.5, 3.0]
look_at = [0.0, 0.5, 0.0]
fov_y = 60

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


def test_depth_of_a_wall_is_its_distance_where_it_is(scene_file):
    scene = clcache.load_scene(scene_file)
    depth = measuring.center_depth(Tracer(scene), scene.camera, (20, 40, 3))
    # Of a pixel at 3 m, 20 of them 2 * 3 * tan(30 degrees) = 3.46 m high, the wall of 1 m covers the middle 5.8: 6 rows.
    rows = np.isfinite(depth).all(axis=1)
    assert np.flatnonzero(rows).tolist() == list(range(7, 13))
    np.testing.assert_allclose(depth[rows], 3.0, rtol=1e-5)
    assert np.isinf(depth[~rows]).all()


def entry(shade, copy, primary, **others):
    passes = {"shade": shade, "retrace": 0.5, "copy": copy}
    return {
        "seconds": 2 * shade,
        "passes": passes,
        "stages": measuring.by_stage(passes, tool.STAGES),
        "rays": {"primary": primary, "secondary": 10, "shadow": 20},
        "cache": {"created": primary},
        **others,
    }


def test_summary_is_of_the_frames_that_count():
    entries = [
        entry(100.0, 0.0, 5, relmse=0.5),
        entry(1.0, 0.2, 6, difference=1.0),
        entry(3.0, 0.1, 7, difference=2.0, relmse=0.1),
        entry(2.0, 0.3, 9, difference=6.0),
    ]
    found = tool.summarised(tool.cache("c"), {"c": entries}, 1)
    assert found["seconds"] == 4.0
    assert found["device"] == pytest.approx(2.8)
    assert found["stages"] == pytest.approx({"reprojection": 0.2, "tracing": 0.5, "shading": 2.0, "reconstruction": 0})
    assert found["rays of passes"] == {"retrace": 7}
    assert found["difference"] == pytest.approx(3.0)
    assert found["relmse"] == pytest.approx(0.3)  # errors count in all frames


def test_ratios_are_of_the_frames_that_count():
    own = [entry(s, 0.5, 2, relmse=0.1) for s in (100.0, 1.0, 5.0)]
    other = [entry(s, 0.5, 8, relmse=0.4) for s in (1.0, 10.0, 2.0)]
    ratios = tool.compared(own, other, 1)
    assert ratios == pytest.approx(
        {"frame time": 6 / 12, "device time": 8 / 14, "first-hit rays": 0.25, "relmse": 0.25}, rel=1e-12
    )


def test_run_compares_each_frame_with_its_reference(scene_file, tmp_path, monkeypatch, capsys):
    """Of two configurations the one that the reference was made by has no error, and the table says so."""
    still = ("--mono", "--spp", "1", "--seed", "7", "--size", "16x16", "--frames", "2:3", "-o", str(tmp_path))
    assert cli.main(["render", str(scene_file), *still]) == 0
    same = tool.Configuration("same", "pathtrace", against="none")
    none = tool.Configuration("none", "pathtrace", {"pathtrace.sampler": "independent"})
    monkeypatch.setitem(tool.EXPERIMENTS, "paths", (same, none))
    options = ["--scene", str(scene_file), "--size", "16x16", "--frames", "0:4", "--skip", "2", "--seed", "7"]
    options += ["--references", str(tmp_path), "--json", str(tmp_path / "out.json")]
    assert tool.main(["paths", *options]) == 0
    found = json.loads((tmp_path / "out.json").read_text())["found"]
    assert found["same"]["relmse"] == 0.0 < found["none"]["relmse"]
    for one in found.values():
        assert ["relmse" in f for f in one["frames"]] == [False, False, True, False]
        assert ["difference" in f for f in one["frames"]] == [False, False, True, True]
        assert one["rays"]["primary"] == 256
    assert "same / none" in capsys.readouterr().out


def test_pass_of_no_stage_is_named():
    with pytest.raises(Error, match="^pass unheard_of: in no stage"):
        measuring.by_stage({"shade": 1.0, "unheard_of": 0.1}, tool.STAGES)


def test_run_ends_at_a_pass_of_no_stage(scene_file, monkeypatch, capsys):
    monkeypatch.setitem(tool.STAGES, "shading", ())
    monkeypatch.setitem(tool.EXPERIMENTS, "paths", (tool.Configuration("path", "pathtrace"),))
    assert tool.main(["paths", "--scene", str(scene_file), "--size", "8x8", "--frames", "0:2", "--skip", "0"]) == 1
    assert_one_line(capsys, "pass shade: in no stage")


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("pathtrace", {}),
        ("samplecache", {"samplecache.shading": "adaptive", "samplecache.reprojection": "two-pass"}),
        ("samplecache", {"samplecache.demodulate": True}),
        ("isrt", {}),
    ],
)
def test_every_pass_is_in_a_stage(method, settings, scene_file):
    options = {"stereo": True, "seed": 1, "spp": 1, "settings": settings}
    if method != "pathtrace":
        options |= {"stereo_blend": "samples", "aovs": ("Z", "N", "albedo", "occupancy", "visible", "age", "trace")}
    renderer = Renderer(clcache.load_scene(scene_file), method, (16, 16), **options)
    passes = list(renderer.frames(0, 2))[-1].stats["eyes"]["left"]["passes"]
    stages = measuring.by_stage(passes, tool.STAGES)
    assert sum(stages.values()) == pytest.approx(sum(passes.values()))
    assert ("blend" in passes) == (method != "pathtrace")


def test_experiments_say_what_they_shade():
    """None but the one that measures the defaults depends on them."""
    configurations = [
        c for group in (*tool.EXPERIMENTS.values(), tool.STATIC) for c in group if c.method != "pathtrace"
    ]
    own = {"samplecache.shading", "samplecache.shading_rate"}
    assert [c.name for c in configurations if not own <= c.settings.keys()] == ["samplecache"]
    for configuration in configurations:
        clcache.settings.resolve(configuration.settings)


def test_still_caches_stand_beside_paths(scene_file, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tool, "CHECKPOINTS", (1, 3))
    options = ["--scene", str(scene_file), "--size", "16x16", "--reference-spp", "4", "--references", str(tmp_path)]
    out = tmp_path / "out.json"
    assert tool.main(["static", *options, "--json", str(out)]) == 0
    (kept,) = tmp_path.glob("*_16x16_4spp.npy")
    assert np.load(kept).shape == (16, 16, 3)
    found = json.loads(out.read_text())["found"]
    assert list(found) == [c.name for c in tool.STATIC]
    for errors in found.values():
        assert list(errors) == ["1", "3"]
        assert 0 < errors["1"]["shaded"] < errors["3"]["shaded"] <= 3
    assert [f["1"]["pathtrace"] for f in found.values()] == [found["target 4"]["1"]["pathtrace"]] * len(found)
    assert "16 slots, target 15" in capsys.readouterr().out
    np.save(kept, np.zeros((8, 16, 3), np.float32))
    assert tool.main(["static", *options]) == 2
    assert_one_line(capsys, f"{kept}: expected an array (16, 16, 3) of float32")
    kept.write_bytes(b"no array")
    assert tool.main(["static", *options]) == 2
    assert_one_line(capsys, f"{kept}: cannot be read")


def assert_one_line(capsys, *texts):
    """Of a tool's own on stderr, which has these texts."""
    (line,) = capsys.readouterr().err.splitlines()
    for text in texts:
        assert text in line


def render(scene_file, folder, size, *options):
    arguments = ["render", str(scene_file), "--spp", "1", "--size", size, "-o", str(folder), *options]
    assert cli.main(arguments) == 0


PATHS = ("paths", "--scene", "{scene}")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("paths", "--scene", "{folder}/none.toml"), "{folder}/none.toml"),
        ((*PATHS, "--frames", "0:8"), "frames 0:8: expected more than the 8 that --skip leaves out"),
        ((*PATHS, "--frames", "5"), "'5': expected A:B"),
        ((*PATHS, "--frames", "5:5"), "'5:5': expected A:B"),
        ((*PATHS, "--size", "8"), "'8': expected WxH"),
        ((*PATHS, "--size", "0x8"), "'0x8': expected WxH"),
        ((*PATHS, "--skip", "-1"), "'-1': expected a whole number from 0 on"),
        ((*PATHS, "--reference-spp", "9"), "--reference-spp"),
        ((*PATHS, "--threads", "0", "--frames", "0:9"), "--threads 0: expected 1 .."),
        ((*PATHS, "--seed", "-1", "--frames", "0:9"), "seed -1: expected 0 .."),
        ((*PATHS, "--frames", "0:9", "--references", "{folder}/none"), "{folder}/none: no references; expected"),
        (("static", "--frames", "0:9"), "--frames 0:9"),
        (("static", "--skip", "2"), "--skip 2"),
        (("static", "--reference-spp", "0"), "'0': expected a whole number from 1 on"),
        (("unheard_of",), "unheard_of"),
    ],
)
def test_tables_refuse(arguments, text, scene_file, tmp_path, capsys):
    names = {"scene": scene_file, "folder": tmp_path}
    arguments = [a.format(**names) for a in arguments]
    assert tool.main(arguments) == 2
    assert_one_line(capsys, "samplecache_tables: error: ", text.format(**names))


@pytest.mark.parametrize(
    ("eyes", "size", "text"), [("--mono", "8x8", "8x8 pixels; expected 16x16"), ("--stereo", "16x16", "expected one")]
)
def test_tables_refuse_references_of_another_kind(eyes, size, text, scene_file, tmp_path, capsys):
    render(scene_file, tmp_path, size, eyes, "--frames", "3:4")
    capsys.readouterr()
    options = ["--size", "16x16", "--frames", "0:4", "--skip", "1", "--references", str(tmp_path)]
    assert tool.main(["paths", "--scene", str(scene_file), *options]) == 2
    assert_one_line(capsys, f"{tmp_path}/frame_0003.exr: ", text)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--scene", "{folder}/none.toml"), "{folder}/none.toml"),
        (("--frames", "0"), "'0': expected A:B"),
        (("--frames", "2:4"), "{folder}: no references of frames 2:4"),
        (("--sharpness", "2"), "samplecache.sharpness: '2' is not a float in range; expected 0 .. 1"),
        (("--sharpness", "0.5", "nan"), "samplecache.sharpness: 'nan'"),
        (("--alpha", "x"), "samplecache.alpha: 'x'"),
        (("--weight", "-0.5"), "'-0.5': expected 0 .. 1"),
        (("--threads", "0", "--frames", "0:1"), "--threads 0: expected 1 .."),
        ((), "{folder}/frame_0001.exr: the picture has 16x8 pixels; expected 8x8"),
        (("--frames", "4:5"), "{folder}/frame_0004.exr: has views mono; expected left and right"),
    ],
)
def test_blending_table_refuses(options, text, scene_file, tmp_path, capsys):
    render(scene_file, tmp_path, "8x8", "--stereo", "--frames", "0:1")
    render(scene_file, tmp_path, "16x8", "--stereo", "--frames", "1:2")
    render(scene_file, tmp_path, "8x8", "--mono", "--frames", "4:5")
    capsys.readouterr()
    scene = [] if "--scene" in options else ["--scene", str(scene_file)]
    assert stereo_blending_table.main([str(tmp_path), *scene, *(o.format(folder=tmp_path) for o in options)]) == 2
    assert_one_line(capsys, "stereo_blending_table: error: ", text.format(folder=tmp_path))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("{folder}/none.toml", "--threads", "1"), "{folder}/none.toml"),
        (("--size", "10"), "'10': expected WxH"),
        (("--size", "16x16"), "--size 16x16: expected 4096 .."),
        (("--size", "99999x99999"), "--size 99999x99999: expected 4096 .."),
        (("--runs", "0"), "'0': expected a whole number from 1 on"),
        (("--threads", "0"), "--threads 0: expected 1 .."),
    ],
)
def test_races_refuse(arguments, text, tmp_path, capsys):
    assert single_pass_races.main([a.format(folder=tmp_path) for a in arguments]) == 2
    assert_one_line(capsys, "single_pass_races: error: ", text.format(folder=tmp_path))


def test_failure_of_the_device_is_not_the_users(capsys):
    def work():
        raise clcache.DeviceError("none")

    assert measuring.exit_code("tool", work) == 1
    assert_one_line(capsys, "tool: error: none")
