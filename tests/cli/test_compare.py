"""`clcache compare`: its table, its JSON, its maps, its limits, and what it refuses."""

import json

import numpy as np
import pytest
from PIL import Image

from clcache.cli import main
from clcache.metrics import relmse, rmse
from clcache.output.exr import write_exr
from clcache.scene.model import Camera


class FrameOf:
    """A grey frame of two eyes, 16 x 12 pixels, at depth 2; the eyes stand still, the grey is `level`."""

    number = 0

    def __init__(self, level):
        self.color = {eye: np.full((12, 16, 3), level + i, np.float32) for i, eye in enumerate(("left", "right"))}
        self.cameras = dict.fromkeys(self.color, Camera(np.eye(4)[:3], 0.8))

    def aov(self, name, eye):
        return np.full((12, 16), 2.0, np.float32)


LEVELS = {"test": (1.5, 1.25), "ref": (1.0, 1.0)}


@pytest.fixture
def folders(tmp_path):
    for name, levels in LEVELS.items():
        (tmp_path / name).mkdir()
        for number, level in enumerate(levels):
            write_exr(tmp_path / name / f"frame_000{number}.exr", FrameOf(level), ("Z",), {})
    return str(tmp_path / "test"), str(tmp_path / "ref")


def expected(metric):
    """By file and view; the right eye is brighter by 1."""
    return [
        metric(np.full((1, 1, 3), t + eye), np.full((1, 1, 3), r + eye))
        for t, r in zip(*LEVELS.values(), strict=True)
        for eye in (0, 1)
    ]


def test_the_table_has_a_line_for_each_view_of_each_file_the_mean_and_the_sequence(folders, capsys):
    assert main(["compare", *folders, "--metrics", "relmse,rmse", "--temporal", "--stereo"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    heading, *lines, mean, sequence = [line.split() for line in out.splitlines()]
    assert heading[:4] == ["file", "view", "relmse", "rmse"]
    assert [line[:2] for line in lines] == [[f"frame_000{n}.exr", eye] for n in (0, 1) for eye in ("left", "right")]
    for column, metric in ((2, relmse), (3, rmse)):
        assert [float(line[column]) for line in lines] == pytest.approx(expected(metric), rel=1e-5)
        assert float(mean[column - 1]) == pytest.approx(np.mean(expected(metric)), rel=1e-5)
    assert heading[4:] == ["temporal", "temporal-valid", "temporal-ref", "stereo", "stereo-valid", "stereo-ref"]
    assert lines[0][4:] == ["-", "-", "-", "1", "1", "1"]
    assert lines[2][4:] == ["0.0625", "1", "0", "1", "1", "1"]
    assert mean[0] == "mean" and mean[3:] == ["0.0625", "1", "0", "1", "1", "1"]
    assert sequence[0] == "sequence" and sequence[1] == mean[1] and sequence[3:] == mean[3:]
    assert float(sequence[2]) == pytest.approx(np.sqrt((0.5**2 + 0.25**2) / 2), rel=1e-5)


def test_two_files_have_neither_mean_nor_sequence(folders, capsys):
    files = [f"{folder}/frame_0000.exr" for folder in folders]
    assert main(["compare", *files, "--metrics", "rmse"]) == 0
    assert [line.split()[:2] for line in capsys.readouterr().out.splitlines()] == [
        ["file", "view"],
        ["frame_0000.exr", "left"],
        ["frame_0000.exr", "right"],
    ]
    assert main(["compare", *files, "--metrics", "rmse", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out).keys() == {"test", "reference", "rows"}


def test_json_to_a_file_and_to_stdout(folders, tmp_path, capsys):
    file = tmp_path / "new" / "out.json"
    assert main(["compare", *folders, "--metrics", "rmse,psnr", "--json", str(file)]) == 0
    assert capsys.readouterr().out.startswith("file ")
    result = json.loads(file.read_text())
    assert (result["test"], result["reference"]) == folders
    assert [row["rmse"] for row in result["rows"]] == pytest.approx(expected(rmse))
    assert [(row["file"], row["view"]) for row in result["rows"]][1] == ("frame_0000.exr", "right")
    assert result["mean"]["rmse"] == pytest.approx(np.mean(expected(rmse)))
    assert result["sequence"]["rmse"] == pytest.approx(np.sqrt(np.mean(np.square(expected(rmse)))))
    assert result["sequence"]["psnr"] == result["mean"]["psnr"]
    assert main(["compare", *folders, "--metrics", "rmse,psnr", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == result
    assert main(["compare", folders[0], folders[0], "--metrics", "psnr", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["mean"] == {"psnr": None}  # infinite


def test_heat_maps(folders, tmp_path):
    maps = tmp_path / "maps"
    assert main(["compare", *folders, "--metrics", "rmse", "--temporal", "--stereo", "--heatmap", str(maps)]) == 0
    relative = {f"frame_000{n}_{eye}_relative.png" for n in (0, 1) for eye in ("left", "right")}
    temporal = {f"frame_0001_{eye}_temporal.png" for eye in ("left", "right")}
    assert {p.name for p in maps.iterdir()} == relative | temporal | {f"frame_000{n}_left_stereo.png" for n in (0, 1)}
    with Image.open(maps / "frame_0001_right_temporal.png") as picture:
        assert picture.size == (16, 12)


@pytest.mark.parametrize(
    ("limits", "code"),
    [
        (["rmse=0.5"], 0),
        (["rmse=0.49"], 1),
        (["rmse=1", "relmse=0.01"], 1),
        (["temporal=0.1"], 0),
        (["temporal=0.01"], 1),
    ],
)
def test_max_is_of_every_picture(folders, capsys, limits, code):
    options = [word for limit in limits for word in ("--max", limit)]
    assert main(["compare", *folders, "--metrics", "rmse,relmse", "--temporal", *options]) == code
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 7
    assert err.count("\n") == code and ("is above" in err) == bool(code)
    if limits == ["rmse=0.49"]:
        assert "rmse is above 0.49 in 2 of 4 pictures; most in frame_0000.exr (right): 0.5" in err


def test_a_name_with_control_characters_is_escaped(tmp_path, capsys):
    Image.new("RGB", (4, 4)).save(tmp_path / "a\nb.png")
    assert main(["compare", *[str(tmp_path / "a\nb.png")] * 2, "--metrics", "rmse"]) == 0
    assert "a\\nb.png  mono" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--metrics", "lpips"], "'lpips': expected names of relmse"),
        (["--metrics", ","], "',': expected names of relmse"),
        (["--metrics", "ssim,ms-ssim"], "ms-ssim: the picture has 16x12 pixels; expected at least 161 a side"),
        (["--max", "ssim=0.5"], "a metric of relmse, rmse, flip, temporal, stereo"),
        (["--max", "rmse=nan"], "expected METRIC=VALUE"),
        (["--max", "rmse"], "expected METRIC=VALUE"),
        (["--metrics", "rmse", "--max", "relmse=1"], "--max relmse: is not measured here"),
        (["--max", "stereo=1"], "--max stereo: is not measured here"),
        (["--json", "/dev/null/x"], "/dev/null/x: "),
        (["--heatmap", "/dev/null"], "/dev/null"),
    ],
)
def test_wrong_options_are_one_line_and_exit_code_2(folders, capsys, options, message):
    assert main(["compare", *folders, *options]) == 2
    out, err = capsys.readouterr()
    assert message in err.splitlines()[-1] and err.splitlines()[-1].startswith("clcache: error: ")
    assert out == ""


def test_wrong_files_are_one_line_and_exit_code_2(folders, tmp_path, capsys):
    test, reference = folders
    (tmp_path / "ref" / "frame_0001.exr").unlink()
    for arguments, message in (
        (folders, f"{reference}: lacks frame_0001.exr"),
        ([test, str(tmp_path / "none")], "none: no such file or folder"),
        ([test, reference + "/frame_0000.exr"], "expected two files or two folders"),
    ):
        assert main(["compare", *arguments]) == 2
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert message in err
