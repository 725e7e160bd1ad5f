"""`clcache render --temporal` and `--stereo-blend`, on a device: files, statistics, and what is refused."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from cache_renders import one_device

from clcache.cli import main

CORNELL = str(Path(__file__).parents[2] / "data" / "cornell" / "scene.toml")


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def render(arguments):
    """Run it on a small picture with direct light only, of which the camera stands still: what stats.json says."""
    common = ["--size=20x12", "--spp=1", "--set=pathtrace.bounces=0", "-o", "o", "--stats=s.json", "--frames=0:4"]
    assert main(["render", CORNELL, *common, *arguments.split()]) == 0
    return json.loads(Path("s.json").read_text())


def picture(number):
    with OpenEXR.File(f"o/frame_{number:04}.exr", separate_channels=True) as file:
        return dict(file.header()), {name: channel.pixels for name, channel in file.channels().items()}


@pytest.mark.parametrize("method", ["pathtrace", "samplecache"])
def test_a_temporal_filter(method):
    """The first frame is as it would be; in the others the weight of the new one is less than all, and many frames count."""
    plain = render(f"--method {method} --mono --aov Z --temporal none")
    before = [picture(number)[1] for number in range(4)]
    filtered = render(f"--method {method} --mono --aov Z,alpha,effective --temporal varianceblend")
    after = [picture(number)[1] for number in range(4)]
    assert (plain["temporal"], filtered["temporal"]) == ("none", "varianceblend")
    assert picture(3)[0]["temporal"] == "varianceblend"
    assert filtered["memory"]["cache"] == plain["memory"]["cache"]
    assert filtered["memory"]["total"] > plain["memory"]["total"]
    for name in ("R", "G", "B", "Z"):
        np.testing.assert_array_equal(before[0][name], after[0][name])
    assert (after[0]["alpha"] == 1).all() and (after[0]["effective"] == 1).all()
    assert (before[3]["R"] != after[3]["R"]).mean() > 0.2
    np.testing.assert_array_equal(before[3]["Z"], after[3]["Z"])
    assert 0 < after[3]["alpha"].mean() < 0.9 and 1 < after[3]["effective"].mean() <= 4


@pytest.mark.parametrize("blend", ["constant", "varianceblend"])
def test_a_stereo_blend(blend):
    """Follows a temporal filter, and leaves its history alone: AOVs of that are the same with and without. Of the right eye they are
    not: what is blended has random numbers of its own."""
    aovs = "--aov Z,alpha"
    plain = render(f"--stereo {aovs} --temporal taa")
    before = picture(3)[1]
    blended = render(f"--stereo {aovs},beta --temporal taa --stereo-blend {blend}")
    header, after = picture(3)
    assert (plain["stereo_blend"], blended["stereo_blend"]) == ("none", blend)
    assert (header["temporal"], header["stereoBlend"]) == ("taa", blend)
    for name in ("Z", "alpha"):
        np.testing.assert_array_equal(before[name], after[name])
    assert (before["right.Z"] != after["right.Z"]).mean() > 0.2
    for eye in ("", "right."):
        assert (before[f"{eye}R"] != after[f"{eye}R"]).mean() > 0.2
        assert (after[f"{eye}beta"] >= 0).all() and (after[f"{eye}beta"] <= 1).all() and after[f"{eye}beta"].min() < 0.9


def test_voxelhash_is_filtered_unless_told_otherwise():
    stats = [render(f"--method voxelhash --mono {more}")["temporal"] for more in ("", "--temporal none")]
    assert stats == ["varianceblend", "none"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--temporal some", "argument --temporal: invalid choice: 'some'"),
        ("--mono --stereo-blend constant", "stereo_blend constant: there is one eye; expected stereo"),
        ("--aov alpha", "AOV alpha: needs a temporal filter; expected --temporal taa or varianceblend"),
        ("--stereo --aov beta", "AOV beta: needs a stereo blend of images; expected --stereo-blend constant or varianceblend"),
        ("--set taa.alpha=2", "setting taa.alpha: '2' is not a float in range; expected 0 .. 1"),
        ("--set taa.validation=some", "expected none, reject, clamp, clip"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line(arguments, message, capsys):
    assert main(["render", CORNELL, "-o", "o", *arguments.split()]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line != "compiling kernels"]
    assert len(lines) == 1 and message in lines[0]
    assert not list(Path().rglob("*.exr"))
