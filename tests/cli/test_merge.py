"""`clcache merge`: files and folders, what it says, what it refuses, and renders of a device merged."""

import shutil
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from clcache.cli import main
from clcache.cli.merge import match_files
from clcache.errors import SettingError
from clcache.methods import METHODS
from clcache.metrics import relmse
from clcache.output.read import read_picture
from clcache.settings import CACHED_METHODS

CORNELL = str(Path(__file__).parents[2] / "data" / "cornell" / "scene.toml")


@pytest.fixture(scope="module")
def renders(tmp_path_factory):
    """Folders a and b of two frames, seeds 1 and 2, 16 spp; many.exr, the first frame with another seed and 512 spp."""
    folder = tmp_path_factory.mktemp("renders")
    # Independent samples, since the error of others does not fall in proportion to their number.
    common = ["--mono", "--size", "32x24", "--set", "pathtrace.bounces=0", "--set", "pathtrace.sampler=independent"]
    for name, seed in (("a", 1), ("b", 2)):
        aovs = "--aov albedo,N,Z,variance,samples"
        more = f"--spp 16 --seed {seed} --frames 0:2 {aovs} -o {folder / name}".split()
        assert main(["render", CORNELL, *common, *more]) == 0
    assert main(["render", CORNELL, *common, "--spp=512", "--seed=3", "-o", str(folder / "many")]) == 0
    return folder


@pytest.fixture
def folder(renders, tmp_path, monkeypatch):
    """A working folder of one's own with these renders."""
    shutil.copytree(renders, tmp_path / "renders")
    monkeypatch.chdir(tmp_path / "renders")
    return tmp_path / "renders"


def refused(capsys, *arguments):
    """The line with which these arguments are refused; nothing is written."""
    before = sorted(Path().rglob("*"))
    capsys.readouterr()
    assert main(["merge", *map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("clcache: error: ") and captured.err.count("\n") == 1
    assert sorted(Path().rglob("*")) == before
    return captured.err


def test_two_renders_have_half_the_error_of_one(folder, capsys):
    """(1/32 + 1/512) / (1/16 + 1/512) = 0.516 of it, as the reference has an error of its own."""
    capsys.readouterr()
    assert main(["merge", "a/frame_0000.exr", "b/frame_0000.exr", "-o", "m.exr"]) == 0
    assert capsys.readouterr().out == "m.exr: 1 frame of 2 renders, 32 spp, seeds 1, 2\n"
    a, b, both = (read_picture(name) for name in ("a/frame_0000.exr", "b/frame_0000.exr", "m.exr"))
    reference = read_picture("many/frame_0000.exr").color["mono"]
    one = (relmse(a.color["mono"], reference) + relmse(b.color["mono"], reference)) / 2
    assert relmse(both.color["mono"], reference) / one == pytest.approx(0.516, abs=0.05)
    # What the merged variance says of the error is what it is, but for the part of the reference.
    variance = np.stack([both.channels["mono"][f"variance.{c}"] for c in "RGB"], axis=-1)
    estimate = np.mean(variance / (reference.astype(np.float64) ** 2 + 0.01)) * (1 + 32 / 512)
    assert estimate == pytest.approx(relmse(both.color["mono"], reference), rel=0.15)


def test_all_channels_of_two_renders_equal_numpy(folder):
    assert main(["merge", "a/frame_0001.exr", "b/frame_0001.exr", "-o", "m.exr"]) == 0
    a, b, both = (read_picture(name).channels["mono"] for name in ("a/frame_0001.exr", "b/frame_0001.exr", "m.exr"))
    assert both.keys() == a.keys()
    a, b = ({name: plane.astype(np.float64) for name, plane in of.items()} for of in (a, b))
    for c in "RGB":
        np.testing.assert_allclose(both[c], (a[c] + b[c]) / 2, rtol=1e-6)
        np.testing.assert_allclose(both[f"albedo.{c}"], (a[f"albedo.{c}"] + b[f"albedo.{c}"]) / 2, rtol=1e-6)
        # Squares about the common mean: (16 * 15 (Va + Vb) + 2 * 16 ((a - b) / 2)^2) / (32 * 31).
        spread = 240 * (a[f"variance.{c}"] + b[f"variance.{c}"]) + 8 * (a[c] - b[c]) ** 2
        np.testing.assert_allclose(both[f"variance.{c}"], spread / 992, rtol=1e-5, atol=1e-12)
    normals = [np.stack([of[f"N.{c}"] for c in "XYZ"], axis=-1) for of in (a, b, both)]
    total = normals[0] + normals[1]
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    np.testing.assert_allclose(normals[2], total / np.where(length > 0, length, 1), atol=1e-6)
    np.testing.assert_array_equal(both["Z"], np.minimum(a["Z"], b["Z"]))
    np.testing.assert_array_equal(both["samples"], 32)


def test_folders_are_merged_frame_by_frame(folder, capsys):
    capsys.readouterr()
    assert main(["merge", "a", "b", "-o", "out/m"]) == 0
    assert capsys.readouterr().out == "out/m: 2 frames of 2 renders, 32 spp, seeds 1, 2\n"
    assert sorted(path.name for path in Path("out/m").iterdir()) == ["frame_0000.exr", "frame_0001.exr"]
    for number in (0, 1):
        with OpenEXR.File(f"out/m/frame_{number:04d}.exr", header_only=True) as file:
            assert (file.header()["frame"], file.header()["seed"], file.header()["spp"]) == (number, "1,2", 32)


def test_files_of_other_aovs_are_merged_with_a_note(folder, capsys):
    assert main(["merge", "a/frame_0000.exr", "many/frame_0000.exr", "-o", "m.exr"]) == 0
    assert "note: left out variance.B, variance.G, variance.R; " in capsys.readouterr().err
    merged = read_picture("m.exr")
    a, many = (read_picture(f"{name}/frame_0000.exr").color["mono"].astype(np.float64) for name in ("a", "many"))
    np.testing.assert_allclose(merged.color["mono"], (16 * a + 512 * many) / 528, rtol=1e-6)


def test_what_does_not_fit_is_refused(folder, capsys):
    zero, one = "a/frame_0000.exr", "b/frame_0001.exr"
    Path("empty").mkdir()
    Path("text.exr").write_text("no picture")
    shutil.copytree("b", "c")
    Path("c/frame_0000.exr").unlink()
    for arguments, message in (
        ((zero, one), "frame: b/frame_0001.exr has 1 and a/frame_0000.exr 0; expected the same in all files"),
        ((zero, zero), "both hold the samples of seed 1"),
        ((zero, "many/frame_0000.exr", zero), "both hold the samples of seed 1"),
        ((zero,), "is alone"),
        (("a", one), "a is a folder and b/frame_0001.exr a file"),
        ((zero, "b"), "b is a folder and a/frame_0000.exr a file"),
        (("a", "none"), "none: no such file or folder"),
        (("a", "empty"), "empty: holds no EXR files"),
        (("a", "c"), "c: lacks frame_0000.exr"),
        ((zero, "text.exr"), "text.exr: not a picture"),
    ):
        assert message in refused(capsys, *arguments, "-o", "out")
    assert "is merged, too" in refused(capsys, "a", "b", "-o", "./a")
    assert "is no regular file" in refused(capsys, zero, "b/frame_0000.exr", "-o", "empty")
    assert "-o" in refused(capsys, "a", "b")


@pytest.mark.parametrize("method", sorted({*CACHED_METHODS} & METHODS.keys()))
def test_renders_of_a_cache_are_refused(folder, capsys, method):
    """By name and reason: two of a kind as well as one among others."""
    for seed in (1, 2):
        few = "--set pathtrace.bounces=0 --set octree.resolution=64"
        small = f"--mono --size 4x4 {few} --method {method} --seed {seed} -o cached{seed}"
        assert main(["render", CORNELL, *small.split()]) == 0
    cached = "cached1/frame_0000.exr"
    expected = f"{cached}: its method, {method}, has samples of earlier frames, too, of which no number is known"
    for arguments in ((cached, "cached2/frame_0000.exr"), ("a/frame_0000.exr", cached), ("cached1", "cached2")):
        line = refused(capsys, *arguments, "-o", "m.exr")
        assert expected in line and "expected frames that stand by themselves" in line


def test_no_frame_is_written_if_one_cannot_be_merged(folder, capsys):
    """The first frames fit; the second of c is a copy of a's."""
    shutil.copytree("b", "c")
    shutil.copy("a/frame_0001.exr", "c/frame_0001.exr")
    assert "both hold the samples of seed 1" in refused(capsys, "a", "c", "-o", "out")


def test_pixels_that_are_damaged_leave_what_was_there(folder, capsys):
    content = Path("b/frame_0000.exr").read_bytes()
    Path("b/frame_0000.exr").write_bytes(content[: len(content) // 2])
    Path("m.exr").write_text("before")
    assert "b/frame_0000.exr: the picture is damaged" in refused(
        capsys, "a/frame_0000.exr", "b/frame_0000.exr", "-o", "m.exr"
    )
    assert Path("m.exr").read_text() == "before"


def test_files_are_matched_by_name(tmp_path):
    for name in ("a/x.exr", "a/y.EXR", "a/x.png", "b/y.EXR", "b/x.exr"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    a, b, out = (tmp_path / name for name in ("a", "b", "out"))
    assert match_files([a, b], out) == {
        out / "x.exr": [a / "x.exr", b / "x.exr"],
        out / "y.EXR": [a / "y.EXR", b / "y.EXR"],
    }
    assert match_files([a / "x.exr", b / "x.exr"], out) == {out: [a / "x.exr", b / "x.exr"]}
    with pytest.raises(SettingError, match="a: lacks z.exr and 1 more"):
        (b / "z.exr").touch()
        (b / "zz.exr").touch()
        match_files([a, b], out)
