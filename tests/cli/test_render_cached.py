"""`clcache render` with a cache, on a device: its files, its statistics, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from cache_renders import one_device

from clcache.cli import main
from clcache.passes.octree_update import COUNTERS as OCTREE_COUNTERS
from clcache.passes.reproject import COUNTERS

CORNELL = str(Path(__file__).parents[2] / "data" / "cornell" / "scene.toml")
OCTREE = "--method octree --set octree.resolution=64"
AOVS = "variance,samples,occupancy,visible,age,trace,Z"


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def render(arguments):
    """Run it on a small picture with direct light only: what stats.json says."""
    common = ["--size=16x9", "--set=pathtrace.bounces=0", "-o", "o", "--stats=s.json"]
    assert main(["render", CORNELL, *common, *arguments.split()]) == 0
    return json.loads(Path("s.json").read_text())


def channels(number):
    with OpenEXR.File(f"o/frame_{number:04}.exr", separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


@pytest.mark.parametrize(("method", "slots"), [("samplecache", 12), ("isrt", 9)])
def test_files_and_statistics(method, slots, capsys):
    stats = render(f"--method {method} --mono --frames 0:3 --aov {AOVS}")
    assert capsys.readouterr().out.startswith("o: 3 frames of 16x9 (mono), 1 spp")
    assert (stats["method"], stats["spp"], stats["stereo_blend"]) == (method, 1, "none")
    assert stats["memory"]["cache"] == 2 * 16 * 9 * (4 + 32 * slots)
    assert stats["settings"]["samplecache.reprojection"] == "deterministic"
    for number, frame in enumerate(stats["frames"]):
        (eye,) = frame["eyes"].values()
        assert tuple(eye["cache"]) == COUNTERS
        assert {"project", "reserve", "copy", "assess", "plan", "aim", "retrace", "settle", "choose"} <= set(
            eye["passes"]
        )
        images = channels(number)
        assert set(AOVS.split(",")) - {"variance"} | {"R", "G", "B", "variance.R"} <= set(images)
        assert (
            images["occupancy"].sum() == eye["cache"]["occupied"] and images["visible"].sum() == eye["cache"]["visible"]
        )
        assert images["trace"].min() >= 0 and images["trace"].max() <= 1
        assert np.isfinite(images["R"]).all() and images["R"].max() > 0
    assert images["age"].max() >= 1  # samples have come from frame to frame
    assert images["samples"].sum() > stats["frames"][-1]["eyes"]["mono"]["cache"]["shaded"]


def test_files_and_statistics_of_the_octree(capsys):
    """Of two eyes; the layers are colours, and stats.json has the cells by level."""
    few, layers = "--set octree.resolution=64 --set octree.samples=1", ("layer0", "layer2", "filtered0", "filtered2")
    stats = render(f"--method octree --stereo --frames 0:2 --spp 2 {few} --aov level,voxel,count,{','.join(layers)}")
    assert capsys.readouterr().out.startswith("o: 2 frames of 16x9 (left, right), 2 spp")
    assert stats["octree"]["resolution"] == 64 and [level["level"] for level in stats["octree"]["levels"]] == list(
        range(7)
    )
    assert stats["memory"]["cache"] > sum(
        level["data_bytes"] + level["hash_bytes"] for level in stats["octree"]["levels"]
    )
    assert stats["seconds"]["octree"] > 0
    for number, frame in enumerate(stats["frames"]):
        images = channels(number)
        for prefix, eye in (("", "left"), ("right.", "right")):
            assert tuple(frame["eyes"][eye]["cache"]) == OCTREE_COUNTERS
            color, level, count = (images[f"{prefix}{name}"] for name in ("R", "level", "count"))
            assert np.isfinite(color).all() and color.max() > 0
            assert {*np.unique(level[np.isfinite(level)])} <= {*range(7)} and count.max() >= 1
            for layer in layers:
                assert np.isfinite(images[f"{layer}.{eye}.G"]).all()
            np.testing.assert_array_equal(images[f"voxel.{eye}.B"] > 0, np.isfinite(level))
    with OpenEXR.File("o/frame_0000.exr", header_only=True) as file:
        assert file.header()["method"] == "octree" and file.header()["spp"] == 2


def test_spp_counts_updates(capsys):
    """Each pixel has a sample's value from each, where all pixels are shaded; what was done is counted over all of them."""
    rate = "--set samplecache.shading=uniform --set samplecache.shading_rate=1"
    stats = render(f"--method samplecache --mono --frames 0:1 --spp 3 --aov samples {rate}")
    assert stats["spp"] == stats["frames"][0]["eyes"]["mono"]["spp"] == 3
    with OpenEXR.File("o/frame_0000.exr", header_only=True) as file:
        assert file.header()["spp"] == 3
    samples = channels(0)["samples"]
    assert samples.max() == 3
    assert stats["frames"][0]["eyes"]["mono"]["cache"]["shaded"] == samples.sum()


def test_blended_eyes():
    plain = render("--method samplecache --stereo --frames 0:2 --aov Z")
    before = channels(1)
    blended = render("--method samplecache --stereo --frames 0:2 --aov Z --stereo-blend samples")
    after = channels(1)
    assert (plain["stereo_blend"], blended["stereo_blend"]) == ("none", "samples")
    with OpenEXR.File("o/frame_0001.exr", header_only=True) as file:
        assert file.header()["stereoBlend"] == "samples"
    assert plain["memory"]["cache"] == 2 * 2 * 16 * 9 * (4 + 32 * 12)
    for frame, other in zip(plain["frames"], blended["frames"], strict=True):
        for eye in ("left", "right"):
            assert frame["eyes"][eye]["cache"] == other["eyes"][eye]["cache"]
            assert ("blend" in other["eyes"][eye]["passes"]) > ("blend" in frame["eyes"][eye]["passes"])
    for name in ("R", "right.R"):
        assert (before[name] != after[name]).mean() > 0.2
        assert after[name].mean() == pytest.approx(before[name].mean(), rel=0.1)
    for name in ("Z", "right.Z"):
        np.testing.assert_array_equal(before[name], after[name])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--method cache", "method cache: unknown; there is pathtrace, samplecache, isrt"),
        ("--method samplecache --until-relmse 0.1", "until_relmse 0.1: method samplecache has a cache; expected a method without"),
        ("--method samplecache --mono --stereo-blend samples", "stereo_blend samples: there is one eye; expected stereo"),
        ("--method pathtrace --stereo --stereo-blend samples", "method pathtrace has no cache of samples to blend"),
        ("--method pathtrace --aov occupancy", "AOV occupancy: method pathtrace has none; it has albedo, N, variance, samples, Z"),
        ("--method samplecache --set samplecache.slots=33", "setting samplecache.slots: '33' is not an int in range; expected 1 .. 32"),
        ("--method samplecache --set samplecache.slot=3", "samplecache.slots"),
        ("--method samplecache --set samplecache.tracing=none", "expected single, multi, adaptive"),
        ("--method octree --until-relmse 0.1", "until_relmse 0.1: method octree has a cache; expected a method without"),
        ("--method octree --set octree.resolution=1000", "setting octree.resolution: '1000' is not an int in range; expected 64, 128, "),
        (f"{OCTREE} --aov occupancy", "AOV occupancy: method octree has none; it has albedo, N, voxel, level, count, layer0"),
        (f"{OCTREE} --stereo --stereo-blend samples", "method octree has no cache of samples to blend"),
        (f"{OCTREE} --warm-start none.npz", "none.npz: no such file"),
        ("--method pathtrace --aov filtered1", "AOV filtered1: method pathtrace has none; it has albedo, N, variance, samples, Z"),
        ("--method isrt --set isrt.superresolution=0", "setting isrt.superresolution: '0' is not an int in range; expected 1 .. 5"),
        ("--method samplecache --set samplecache.slots=32 --size 8192x8192", "67108864 pixels of 32 slots: expected "),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line(arguments, message, capsys, folder):
    assert main(["render", CORNELL, *arguments.split()]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    last = captured.err.splitlines()[-1]
    assert last.startswith("clcache: error: ") and message in last
    assert captured.err.count("clcache: error") == 1 and "Traceback" not in captured.err
    assert not [path for path in folder.rglob("*") if path.is_file()]
