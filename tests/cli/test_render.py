"""`clcache render`: what it passes on, what it writes, what it says, and what it refuses."""

import argparse
import contextlib
import io
import json
import os
import sys
import types
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache.cli import main, render, terminal
from clcache.errors import DeviceError, SceneError
from clcache.output.read import read_picture
from clcache.scene.model import Camera, Defaults, Scene

CAMERA = Camera(np.eye(4)[:3], 0.8)


class FakeFrame:
    def __init__(self, number, eyes, size):
        width, height = size
        self.number = number
        self.color = {eye: np.full((height, width, 3), 0.25, np.float32) for eye in eyes}
        self.cameras = dict.fromkeys(eyes, CAMERA)
        rays = {"primary": 1000, "secondary": 200, "shadow": 30}
        self.stats = {
            "frame": number,
            "seconds": 0.5,
            "eyes": {eye: {"passes": {}, "rays": rays, "cache": {}, "spp": 2 + i} for i, eye in enumerate(eyes)},
        }

    def aov(self, name, eye):
        height, width, _ = self.color[eye].shape
        return np.ones((height, width) if name == "Z" else (height, width, 3), np.float32)


class FakeRenderer:
    """Takes what the real one takes, and yields grey frames. `options` are the latest's; `stop` ends the frame of that number;
    `errors` are the eyes' estimated relMSE."""

    options = None
    stop: dict = {}
    errors: tuple = ()

    def __init__(self, scene, **options):
        FakeRenderer.options = {"scene": scene, **options}
        self.size = options["size"] or scene.defaults.size
        self.spp = options["spp"] or scene.defaults.spp
        self.eyes = ("left", "right") if options["stereo"] else ("mono",)
        self.until_relmse, self.has_state = options["until_relmse"], False

    def stats(self):
        stats = {
            "version": "0",
            "method": "pathtrace",
            "settings": {},
            "seed": 1,
            "temporal": self.options["temporal"] or "none",
            "stereo_blend": self.options["stereo_blend"] or "none",
            "memo": {"kind": self.options["memo"] or "off", "materials": []},
            "spp": self.spp,
            "size": list(self.size),
        }
        return stats | {"seconds": {"graphs": 0.0, "bvh_build": 0.0, "compile": 0.25, "render": 1.0}}

    def frames(self, first, end, progress=None):
        self.options["on_compile"]("trace")
        self.options["on_compile"]("shade")
        for number in range(first, end):
            progress(0.5)
            if number in self.stop:
                raise self.stop[number]
            frame = FakeFrame(number, self.eyes, self.size)
            for eye, error in zip(frame.stats["eyes"].values(), self.errors, strict=False):
                eye["estimated_relmse"] = error
            yield frame


@pytest.fixture
def project(monkeypatch, tmp_path):
    """An empty working folder, with a scene loader and a renderer that need no device; the scene can be replaced."""

    def load_scene(path, *, allow_outside=False):
        project.allow_outside = allow_outside
        if not isinstance(project.scene, Scene):
            raise project.scene
        return project.scene

    defaults = Defaults(size=(6, 4), frames=(3, 5), fps=24.0, spp=2, seed=9, settings={"pathtrace.bounces": 1})
    scene = Scene("rooms/scene.toml", (), (), (), (), (), (0.0, 0.0, 0.0), CAMERA, defaults)
    project = types.SimpleNamespace(scene=scene, allow_outside=None)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("clcache.scene.load_scene", load_scene)
    monkeypatch.setitem(sys.modules, "clcache.renderer", types.SimpleNamespace(Renderer=FakeRenderer))
    monkeypatch.setattr(FakeRenderer, "options", None)
    monkeypatch.setattr(FakeRenderer, "stop", {})
    return project


def files(folder="."):
    return sorted(str(path) for path in Path(folder).rglob("*") if path.is_file())


def refused(capsys, *arguments):
    """Run what must be refused: exit code 2, one line on stderr, nothing on stdout. Returns the line."""
    assert main(["render", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("clcache: error: ") and captured.err.count("\n") == 1
    assert files() == []
    return captured.err


def test_what_is_not_given_is_left_to_the_scene(project, capsys):
    assert main(["render", "rooms/scene.toml"]) == 0
    options = FakeRenderer.options
    assert options["scene"] is project.scene
    own = "method size stereo seed spp until_relmse temporal stereo_blend memo device threads"
    assert [options[name] for name in own.split()] == [None] * 11
    assert (options["settings"], options["aovs"]) == ({}, ("albedo", "N", "Z"))
    assert project.allow_outside is False
    assert files() == ["out/rooms/frame_0003.exr", "out/rooms/frame_0004.exr"]
    captured = capsys.readouterr()
    assert captured.out == "out/rooms: 2 frames of 6x4 (mono), 2 spp: 1.00 s, 0.00 Mrays/s; compiled 0.25 s\n"
    assert captured.err.splitlines()[0] == "compiling kernels"
    assert captured.err.splitlines()[1].startswith("frame 3 (1 of 2): 0.50 s, 0.00 Mrays/s, ")


def test_what_is_given_reaches_the_renderer(project):
    arguments = "--method other --size 8x2 --frames 0:1 --fps 60 --stereo --spp 5 --seed 0 --set pathtrace.bounces=4"
    arguments += " --set pathtrace.roulette=1 --aov Z,N,Z --device pocl --threads 3 --allow-outside -o far/away"
    arguments += " --temporal taa --stereo-blend samples --memo texel"
    assert main(["render", "s.toml", *arguments.split()]) == 0
    options = FakeRenderer.options
    assert (options["method"], options["size"], options["stereo"]) == ("other", (8, 2), True)
    assert (options["spp"], options["seed"]) == (5, 0)
    assert (options["temporal"], options["stereo_blend"], options["memo"]) == ("taa", "samples", "texel")
    assert options["settings"] == {"pathtrace.bounces": 4, "pathtrace.roulette": 1}
    assert (options["device"], options["threads"], options["aovs"]) == ("pocl", 3, ("Z", "N"))
    assert options["scene"].defaults.fps == 60.0
    assert project.allow_outside is True
    assert files() == ["far/away/frame_0000.exr"]
    with OpenEXR.File("far/away/frame_0000.exr", separate_channels=True) as file:
        assert {"R", "right.R", "right.Z", "N.right.X"} <= set(file.channels())
        assert not any(name.startswith("albedo") for name in file.channels())
        assert file.header()["framesPerSecond"] == 60
        header = file.header()
        assert (header["temporal"], header["stereoBlend"], header["memo"]) == ("taa", "samples", "texel")


def test_every_view_says_how_many_samples_it_has(project, capsys):
    assert main(["render", "s.toml", "--stereo", "--frames", "0:1", "-o", "o"]) == 0
    with OpenEXR.File("o/frame_0000.exr", header_only=True) as file:
        assert (file.header()["spp"], file.header()["right.spp"]) == (2, 3)
    assert capsys.readouterr().out.startswith("o: 1 frame of 6x4 (left, right), 2 to 3 spp: 0.50 s")


@pytest.mark.parametrize("error", [0.03, None])
def test_until_an_error_is_reached(project, capsys, monkeypatch, error):
    monkeypatch.setattr(FakeRenderer, "errors", (0.002, error))
    assert main(["render", "s.toml", "--stereo", "-o", "o", "--until-relmse", "2e-3", "--stats", "s.json"]) == 0
    assert FakeRenderer.options["until_relmse"] == 0.002
    captured = capsys.readouterr()
    said = "0.002 to 0.03" if error else "0.002"
    assert captured.out.startswith(f"o: 2 frames of 6x4 (left, right), 2 to 3 spp, estimated relMSE {said}: 1.00 s")
    note = "note: 2 of 4 pictures have all samples that --spp allows and an estimated relMSE above 0.002"
    assert captured.err.splitlines()[-1] == note
    eyes = json.loads(Path("s.json").read_text())["frames"][1]["eyes"]
    assert [(eye["spp"], eye["estimated_relmse"]) for eye in eyes.values()] == [(2, 0.002), (3, error)]
    monkeypatch.setattr(FakeRenderer, "errors", (0.002, 0.001))
    assert main(["render", "s.toml", "--stereo", "-o", "o", "--until-relmse", "2e-3"]) == 0
    assert "note" not in capsys.readouterr().err


def test_one_eye_can_be_asked_for(project):
    assert main(["render", "s.toml", "--mono"]) == 0
    assert FakeRenderer.options["stereo"] is False


def test_png_and_stats_are_written_on_request(project):
    assert main(["render", "s.toml", "-o", "o", "--png", "--frames", "7:8", "--stats", "stats/s.json"]) == 0
    assert main(["render", "s.toml", "-o", "o", "--png", "--frames", "12345:12346", "--stereo"]) == 0
    expected = ["frame_0007.exr", "frame_0007.png"]
    expected += ["frame_12345.exr", "frame_12345_left.png", "frame_12345_right.png"]
    assert files("o") == [f"o/{name}" for name in expected]
    stats = json.loads(Path("stats/s.json").read_text())
    assert stats["method"] == "pathtrace"
    assert set(stats["seconds"]) == {"load", "graphs", "bvh_build", "compile", "render"}
    assert [frame["frame"] for frame in stats["frames"]] == [7]


def test_notes_and_what_was_dropped_are_said_on_a_line_each(project, capsys):
    notes = ("a framing camera was\nadded\x1b[31m",)
    project.scene = Scene(
        "a.obj",
        (),
        (),
        (),
        (),
        (),
        (0.0, 0.0, 0.0),
        CAMERA,
        Defaults(size=(2, 2), spp=1),
        {"zero-area triangles": 425},
        notes,
    )
    assert main(["render", "a.obj"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["note: a framing camera was\\nadded\\x1b[31m", "note: left out 425 zero-area triangles"]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--size 0x0", "--size"),
        ("--size 1e9x1e9", "--size"),
        ("--size 640", "--size"),
        ("--memo texels", "--memo"),
        ("--set memo.tile=7x7", "memo.tile: '7x7' is not a str in range; expected 2x2, 3x3"),
        ("--set memo.tiel=4x4", "memo.tiel: unknown; did you mean memo.tile?"),
        ("--frames 5:2", "--frames"),
        ("--frames 5:5", "--frames"),
        ("--frames -1:3", "--frames"),
        ("--frames=-1:3", "--frames"),
        ("--frames 0:2147483648", "--frames"),
        ("--fps 0", "--fps"),
        ("--fps nan", "--fps"),
        ("--fps inf", "--fps"),
        ("--spp 0", "--spp"),
        ("--spp 1.5", "--spp"),
        ("--until-relmse 0", "--until-relmse"),
        ("--until-relmse nan", "--until-relmse"),
        ("--until-relmse inf", "--until-relmse"),
        ("--seed -1", "--seed"),
        ("--seed " + "9" * 5000, "--seed"),
        ("--threads 0", "--threads"),
        ("--set pathtrace.bounces", "KEY=VALUE"),
        ("--set pathtrace.bounce=3", "did you mean pathtrace.bounces"),
        ("--set pathtrace.bounces=many", "0 .. 64"),
        ("--aov depth", "albedo, N, variance, samples, occupancy, visible, age, trace, voxel"),
        ("--stereo --mono", "--stereo"),
        ("--stereo-blend some", "--stereo-blend"),
        ("--stere", "--stere"),
        ("--no-such-option", "--no-such-option"),
    ],
)
def test_a_bad_option_is_one_line(project, capsys, options, named):
    assert named in refused(capsys, "s.toml", *options.split())
    assert FakeRenderer.options is None


def test_no_command_and_unknown_commands_are_one_line(capsys):
    for arguments in ([], ["paint"], ["render"]):
        assert main(arguments) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith("clcache: error: ") and captured.err.count("\n") == 1


def test_version_and_help_are_results(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("clcache ")
    assert main(["render", "--help"]) == 0
    assert "--spp N" in capsys.readouterr().out


def test_a_seed_may_have_64_bits(project):
    assert main(["render", "s.toml", "--seed", "18446744073709551615"]) == 0
    assert FakeRenderer.options["seed"] == 2**64 - 1


def test_errors_have_their_exit_codes(project, capsys):
    project.scene = SceneError("s.toml: line 3\nis wrong")
    assert "s.toml: line 3\\nis wrong" in refused(capsys, "s.toml")
    for error in (DeviceError("no device works"), MemoryError("4 GiB")):
        project.scene = error
        assert main(["render", "s.toml"]) == 1
        assert capsys.readouterr().err.count("\n") == 1


def test_ctrl_c_while_loading_is_one_line(project, capsys):
    project.scene = KeyboardInterrupt()
    assert main(["render", "s.toml"]) == 130
    assert capsys.readouterr().err == "clcache: error: interrupted\n"


def test_an_output_that_cannot_be_is_refused_before_the_work(project, capsys):
    assert os.devnull in refused(capsys, "s.toml", "-o", f"{os.devnull}/sub")
    assert os.devnull in refused(capsys, "s.toml", "--stats", os.devnull)
    assert FakeRenderer.options is None


def test_ctrl_c_leaves_complete_frames(project, capsys, monkeypatch):
    monkeypatch.setattr(FakeRenderer, "stop", {2: KeyboardInterrupt()})
    assert main(["render", "s.toml", "-o", "o", "--frames", "0:9", "--stats", "s.json"]) == 130
    assert files() == ["o/frame_0000.exr", "o/frame_0001.exr"]
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines()[-1] == "clcache: interrupted; o has 2 of 9 frames, each complete; --resume goes on"


def test_a_device_that_fails_midway_leaves_complete_frames(project, capsys, monkeypatch):
    monkeypatch.setattr(FakeRenderer, "stop", {1: DeviceError("trace: out of resources")})
    assert main(["render", "s.toml", "-o", "o", "--frames", "0:9"]) == 1
    assert files() == ["o/frame_0000.exr"]
    assert capsys.readouterr().err.endswith("clcache: error: trace: out of resources\n")


CORNELL = str(Path(__file__).parents[2] / "data" / "cornell" / "scene.toml")


def test_a_scene_becomes_files_on_a_device(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["render", CORNELL, "--size=16x9", "--spp=2", "--seed=5", "--png", "--stats=s.json"]) == 0
    assert files() == [f"out/cornell/frame_0000{end}" for end in (".exr", "_left.png", "_right.png")] + ["s.json"]
    with OpenEXR.File("out/cornell/frame_0000.exr", separate_channels=True) as file:
        header, pixels = dict(file.header()), {name: channel.pixels for name, channel in file.channels().items()}
    assert all(image.shape == (9, 16) for image in pixels.values())
    assert all(np.isfinite(pixels[name]).all() for name in ("R", "right.B", "albedo.left.G", "N.right.X"))
    assert pixels["R"].max() > 0 and pixels["albedo.right.R"].max() <= 1
    assert header["right.worldToCamera"][3, 0] - header["worldToCamera"][3, 0] == pytest.approx(-0.063, abs=1e-6)
    stats = json.loads(Path("s.json").read_text())
    assert {"version", "device", "scene", "method", "settings", "seed", "size", "memory", "seconds"} <= set(stats)
    assert set(stats["device"]) == {"platform", "name", "driver", "threads"}
    assert {"file", "triangles", "instances", "materials"} <= set(stats["scene"])
    assert set(stats["memory"]) == {"bvh", "textures", "cache", "total"}
    assert set(stats["seconds"]) == {"load", "graphs", "bvh_build", "compile", "render"}
    (frame,) = stats["frames"]
    assert set(frame) == {"frame", "seconds", "eyes"} and set(frame["eyes"]) == {"left", "right"}
    for eye in frame["eyes"].values():
        assert set(eye) == {"passes", "rays", "cache", "spp"}
        assert set(eye["rays"]) == {"primary", "secondary", "shadow"}
        assert eye["rays"]["primary"] == 16 * 9 * 2


def test_a_scene_of_graphs_with_a_memo(tmp_path, monkeypatch, capsys):
    """What was kept is counted, the files say so, and frames of another memo are not gone on from."""
    monkeypatch.chdir(tmp_path)
    Path("s.graph").write_text("UVInput Out>0; Dot A<0 B<0 Out>1; ColorOutput In<1;\n")
    ball = '[meshes.b]\ngenerator = "sphere"\n[[instances]]\nmesh = "b"\nmaterial = "m"\n'
    Path("s.toml").write_text('[materials.m]\ngraph = "s.graph"\n' + ball)
    command = ["render", "s.toml", "-o", "o", "--size=16x9", "--spp=2", "--set=memo.auto=false"]
    assert main([*command, "--memo=texel", "--stats=s.json"]) == 0
    stats = json.loads(Path("s.json").read_text())
    (graph,) = stats["memo"]["materials"]
    assert (stats["memo"]["kind"], graph["materials"], graph["memoized"]) == ("texel", ["m"], True)
    counters = stats["frames"][0]["eyes"]["mono"]["memo"]
    assert counters["lookups"] > counters["inserted"] == counters["occupied"] > 0
    with OpenEXR.File("o/frame_0000.exr", header_only=True) as file:
        assert file.header()["memo"] == "texel"
    capsys.readouterr()
    assert main([*command, "--memo=texel", "--resume"]) == 0
    assert capsys.readouterr().out == "o: all 1 frames are there\n"
    assert main([*command, "--memo=tile", "--resume"]) == 2
    assert (
        "frame_0000.exr: memo is texel there and tile here; expected frames of the same render"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    "option",
    [
        "--until-relmse=0.1 --spp=1",
        "--size=1000000000x1000000000",
        "--seed=18446744073709551616",
        "--spp=99999999999",
        "--method=magic",
    ],
)
def test_what_only_the_renderer_can_refuse_is_one_line_too(tmp_path, monkeypatch, capsys, option):
    monkeypatch.chdir(tmp_path)
    refused(capsys, CORNELL, *option.split())


def test_a_goal_for_the_error_is_reached_by_real_samples(tmp_path, monkeypatch, capsys):
    """The files hold, and say, the samples that were taken; the error is what their variance and colour say."""
    monkeypatch.chdir(tmp_path)
    arguments = "--size 16x9 --until-relmse 0.03 -o o --stats s.json --aov variance,samples --set pathtrace.bounces=0"
    assert main(["render", CORNELL, *arguments.split()]) == 0
    eyes = json.loads(Path("s.json").read_text())["frames"][0]["eyes"]
    picture = read_picture("o/frame_0000.exr")
    with OpenEXR.File("o/frame_0000.exr", header_only=True) as file:
        spp = dict(zip(("left", "right"), (file.header()["spp"], file.header()["right.spp"]), strict=True))
    for view, eye in eyes.items():
        assert eye["spp"] == spp[view] > 16 and (picture.channels[view]["samples"] == spp[view]).all()
        assert eye["rays"]["primary"] == 16 * 9 * spp[view]
        variance = np.stack([picture.channels[view][f"variance.{c}"] for c in "RGB"], axis=-1)
        expected = np.mean(variance / (picture.color[view].astype(np.float64) ** 2 + 0.01))
        assert eye["estimated_relmse"] == pytest.approx(expected, rel=1e-5)
        assert 0 < expected <= 0.03
    assert f"{min(spp.values())}" in capsys.readouterr().out


def test_an_error_that_cannot_be_estimated_is_not_reached(tmp_path, monkeypatch, capsys):
    """The squares of this light overflow: all samples are taken, and the statistics hold no number that JSON lacks."""
    monkeypatch.chdir(tmp_path)
    lamp = '[[lights]]\ntype = "point"\nposition = [0, 3, 0]\nintensity = [1e25, 1e25, 1e25]\n'
    ground = '[meshes.g]\ngenerator = "plane"\n[[instances]]\nmesh = "g"\n'
    Path("s.toml").write_text(f"{ground}{lamp}[camera]\nposition = [0, 2, 2]\nlook_at = [0, 0, 0]\n")
    arguments = "--size 4x4 --until-relmse 0.1 --spp 20 --mono -o o --stats s.json"
    assert main(["render", "s.toml", *arguments.split()]) == 0
    eye = json.loads(Path("s.json").read_text())["frames"][0]["eyes"]["mono"]
    assert (eye["spp"], eye["estimated_relmse"]) == (20, None)
    assert "note: 1 of 1 pictures have all samples" in capsys.readouterr().err


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_sees_kernels_then_a_bar_over_all_samples(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    with terminal.Progress() as progress:
        progress.compiling("trace")
        progress.compiling("shade")
        progress.start(2, 500_000)
        for number in range(2):
            progress.part_of_frame(0.5)
            progress.frame_done(FakeFrame(number, ("mono",), (1, 1)))
    shown = screen.getvalue()
    assert "compiling 1: trace [" in shown and "compiling 2: shade [" in shown
    assert "100%" in shown and "1.00M/1.00M" in shown and "sample/s" in shown
    assert "frame 0" not in shown and "\x1b[A" not in shown  # one bar at a time, and no lines


def test_a_bar_shows_the_way_to_a_goal_where_the_samples_are_not_known(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    with terminal.Progress() as progress:
        progress.start(2, None)
        progress.part_of_frame(0.5)
        progress._bar.refresh()
        progress.part_of_frame(0.4)  # the estimate of the error has grown
        progress.frame_done(FakeFrame(0, ("mono",), (1, 1)))
        progress.frame_done(FakeFrame(1, ("mono",), (1, 1)))
    shown = screen.getvalue()
    assert " 25%" in shown and "100%" in shown and "sample" not in shown


def test_elsewhere_a_line_says_the_time_left(monkeypatch, capsys):
    clock = iter([100.0, 104.0])
    monkeypatch.setattr(terminal.time, "perf_counter", lambda: next(clock))
    with terminal.Progress() as progress:
        progress.start(4, 500_000)
        progress.frame_done(FakeFrame(8, ("mono",), (1, 1)))
    assert capsys.readouterr().err == "frame 8 (1 of 4): 0.50 s, 0.00 Mrays/s, 12 s left\n"


def test_a_folder_that_stdout_cannot_spell_is_escaped(project, monkeypatch):
    output = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", output)
    assert main(["render", "s.toml", "-o", "caf\u00e9"]) == 0
    assert output.buffer.getvalue().startswith(b"caf\\xe9: 2 frames")


def test_default_folder_is_named_after_the_scene():
    assert render.default_folder("models/sponza.glb") == Path("out/sponza")
    assert render.default_folder("data/cornell/scene.toml") == Path("out/cornell")
    assert render.default_folder("/scene.toml") == Path("out/scene")


whole = st.integers(0, 3) | st.integers(0, 10**12)


@given(whole, whole)
def test_sizes_and_frames_are_read_back_or_refused(a, b):
    if 1 <= a < 10**10 and 1 <= b < 10**10:
        assert render.parse_size(f"{a}x{b}") == (a, b)
    else:
        with pytest.raises(argparse.ArgumentTypeError, match="expected WxH"):
            render.parse_size(f"{a}x{b}")
    if a < b <= render.MAX_FRAME:
        assert render.parse_frames(f"{a}:{b}") == (a, b)
    else:
        with pytest.raises(argparse.ArgumentTypeError, match="expected A:B"):
            render.parse_frames(f"{a}:{b}")


@given(st.text() | st.from_regex(r"[-+0-9x:.e_ ]+") | st.from_regex(r"\d{1,6}[x:]\d{1,6}"))
def test_no_text_breaks_a_parser(text):
    for parse in (render.parse_size, render.parse_frames, render._fps, render._aovs, render._whole(0)):
        with contextlib.suppress(argparse.ArgumentTypeError):
            parse(text)
            assert text.isascii() or parse is render._fps
