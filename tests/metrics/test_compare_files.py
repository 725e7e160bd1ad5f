"""Files and folders matched and compared: each value is that of the metric, of the right pictures."""

import numpy as np
import pytest
from PIL import Image

from clcache.errors import SettingError
from clcache.metrics import METRICS, Comparison, View, relmse, reprojected_difference, ssim
from clcache.metrics.heatmap import NO_VALUE, to_colors, write_heatmap
from clcache.output.exr import write_exr
from clcache.output.read import decode_srgb
from clcache.scene.model import Camera

SIZE = (24, 32)


class FrameOf:
    def __init__(self, number, views, seed):
        rng = np.random.default_rng((number, seed))
        self.number = number
        self.color = {view: rng.random((*SIZE, 3)).astype(np.float32) for view in views}
        self.cameras = {
            view: Camera(np.column_stack([np.eye(3), [0.1 * (i + number), 0, 0]]), 0.8) for i, view in enumerate(views)
        }

    def aov(self, name, eye):
        return np.full(SIZE, 2.0, np.float32)

    def view(self, eye):
        return View(self.color[eye], self.aov("Z", eye), self.cameras[eye])


def write_frames(folder, seed, views=("left", "right"), numbers=(0, 1), aovs=("Z",)):
    folder.mkdir(exist_ok=True)
    frames = {number: FrameOf(number, views, seed) for number in numbers}
    for number, frame in frames.items():
        write_exr(folder / f"frame_{number}.exr", frame, aovs, {})
    return frames


def test_folders_of_stereo_frames(tmp_path):
    test, reference = (write_frames(tmp_path / name, seed, numbers=(0, 1, 2)) for name, seed in (("t", 1), ("r", 2)))
    comparison = Comparison(tmp_path / "t", tmp_path / "r", ["ssim", "relmse"], temporal=True, stereo=True)
    assert comparison.columns == [
        *("ssim", "relmse", "temporal", "temporal-valid", "temporal-ref", "stereo", "stereo-valid", "stereo-ref")
    ]
    rows = list(comparison.rows())
    assert [(row.file, row.view) for row in rows] == [
        (f"frame_{n}.exr", v) for n in (0, 1, 2) for v in ("left", "right")
    ]
    for row in rows:
        number = int(row.file[6])
        t, r = test[number].color[row.view], reference[number].color[row.view]
        assert row.values["ssim"] == pytest.approx(ssim(t, r), rel=1e-4)
        assert row.values["relmse"] == pytest.approx(relmse(t, r))
        np.testing.assert_allclose((row.maps["relative"] ** 2).mean(), row.values["relmse"])
        assert ("temporal" in row.values, "stereo" in row.values) == (number > 0, row.view == "left")
        if number > 0:
            for name, of in (("temporal", test), ("temporal-ref", reference)):
                expected = reprojected_difference(of[number].view(row.view), of[number - 1].view(row.view))
                assert row.values[name] == pytest.approx(expected.mean, rel=1e-4)
                assert 0.5 < row.values["temporal-valid"] == expected.valid < 1.0
        if row.view == "left":
            for name, of in (("stereo", test), ("stereo-ref", reference)):
                expected = reprojected_difference(of[number].view("left"), of[number].view("right"))
                assert row.values[name] == pytest.approx(expected.mean, rel=1e-4)
            assert np.nanmean(row.maps["stereo"] ** 2) == pytest.approx(row.values["stereo"])


def test_a_reference_without_depth_has_no_reprojected_difference(tmp_path):
    write_frames(tmp_path / "t", 1)
    write_frames(tmp_path / "r", 2, aovs=())
    rows = list(Comparison(tmp_path / "t", tmp_path / "r", ["rmse"], temporal=True, stereo=True).rows())
    assert {"stereo", "temporal"} <= set(rows[2].values)
    assert not {"stereo-ref", "temporal-ref"} & set(rows[2].values)
    with pytest.raises(SettingError, match=r"frame_0\.exr: view left lacks Z or its camera"):
        list(Comparison(tmp_path / "r", tmp_path / "t", ["rmse"], stereo=True).rows())


def test_frames_come_in_the_order_of_their_numbers(tmp_path):
    for folder in "tr":
        write_frames(tmp_path / folder, 1, numbers=(9, 10, 100, 11))
    names = Comparison(tmp_path / "t", tmp_path / "r", ["rmse"]).files
    assert names == [f"frame_{n}.exr" for n in (9, 10, 11, 100)]


def test_png_values_pass_through_no_tone_curve(tmp_path):
    rng = np.random.default_rng(1)
    stored = [rng.integers(0, 256, (*SIZE, 3)).astype(np.uint8) for _ in range(2)]
    for name, pixels in zip("tr", stored, strict=True):
        Image.fromarray(pixels).save(tmp_path / f"{name}.png")
    (row,) = Comparison(tmp_path / "t.png", tmp_path / "r.png", ["ssim", "relmse"]).rows()
    test, reference = (pixels / 255.0 for pixels in stored)
    assert row.values["ssim"] == pytest.approx(ssim(test, reference, encoded=True), abs=1e-5)
    assert row.values["relmse"] == pytest.approx(relmse(decode_srgb(test), decode_srgb(reference)), rel=1e-5)


def test_of_a_folder_with_two_kinds_the_exr_files_are_compared(tmp_path):
    for folder in "tr":
        write_frames(tmp_path / folder, 1, numbers=(0,))
    Image.new("RGB", SIZE).save(tmp_path / "t" / "frame_0.png")
    (tmp_path / "t" / "notes.txt").write_text("none")
    assert Comparison(tmp_path / "t", tmp_path / "r", ["rmse"]).files == ["frame_0.exr"]


def test_the_default_is_every_metric_that_works_here(tmp_path):
    path = tmp_path / "t"
    write_frames(path, 1, views=("mono",))
    comparison = Comparison(path, path)
    small = [m.name for m in METRICS.values() if m.least_side > min(SIZE)]
    assert small == ["ms-ssim", "cpbd"]
    left_out = [note.split()[0] for note in comparison.notes]
    assert set(small) <= set(left_out)
    assert {*comparison.columns, *left_out} - {"cpbd-ref"} == set(METRICS)
    row = next(comparison.rows())
    assert set(row.values) == set(comparison.columns)
    with pytest.raises(SettingError, match="ms-ssim: .*at least 161 a side"):
        next(Comparison(path, path, ["ms-ssim"]).rows())


def test_files_that_do_not_match_are_an_error_of_one_line(tmp_path):
    t, r = tmp_path / "t", tmp_path / "r"
    write_frames(t, 1, numbers=(0, 1, 2))
    write_frames(r, 1, numbers=(2, 3))
    (tmp_path / "empty").mkdir()
    write_frames(tmp_path / "mono", 1, views=("mono",), numbers=(0,))
    Image.new("RGB", SIZE[::-1]).save(tmp_path / "same.png")
    Image.new("RGB", (3, 4)).save(tmp_path / "small.png")
    broken = FrameOf(0, ["left", "right"], 1)
    broken.color["right"][3, 4, 1] = np.nan
    broken.color["right"][5] = np.inf
    write_exr(tmp_path / "nan.exr", broken, (), {})
    first = t / "frame_0.exr"
    for test, reference, message in (
        (t, r, "r: lacks frame_0.exr and 1 more"),
        (r / "frame_2.exr", t, "t is a folder and .*frame_2.exr a file"),
        (t, tmp_path / "none", "none: no such file or folder"),
        (t, tmp_path / "empty", "hold no pictures of one kind"),
        (first, tmp_path / "mono" / "frame_0.exr", "has views left, right and .* mono"),
        (tmp_path / "same.png", tmp_path / "small.png", "has size 32x24 and .* 3x4"),
        (tmp_path / "mono" / "frame_0.exr", tmp_path / "same.png", "has values linear and .* sRGB-encoded"),
        (tmp_path / "nan.exr", first, "nan.exr: view right has 33 of 768 pixels that are NaN or infinite"),
        (first, tmp_path / "nan.exr", "nan.exr: view right has 33 of 768 pixels that are NaN or infinite"),
    ):
        with pytest.raises(SettingError, match=message) as error:
            list(Comparison(test, reference, ["rmse"]).rows())
        assert "\n" not in str(error.value)
    with pytest.raises(SettingError, match="unknown metric 'lpips'; expected names of relmse"):
        Comparison(first, first, ["lpips"])
    with pytest.raises(SettingError, match="expected a folder of two frames or more"):
        Comparison(first, first, ["rmse"], temporal=True)
    mono = tmp_path / "mono" / "frame_0.exr"
    with pytest.raises(SettingError, match="has views mono; expected left and right"):
        list(Comparison(mono, mono, ["rmse"], stereo=True).rows())


def test_heat_maps_grow_lighter_with_error(tmp_path):
    error = np.array([[0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 50.0, np.nan]])
    colors = to_colors(error)
    lightness = colors[0, :7].astype(int) @ [2, 7, 1]
    assert lightness[0] == lightness[1] == lightness[2] and lightness[5] == lightness[6]
    assert (np.diff(lightness[2:6]) > 0).all()
    assert tuple(colors[0, 7]) == NO_VALUE
    every = to_colors(np.geomspace(1e-3, 1.0, 2000)[None])[0].astype(int)
    assert np.abs(every - NO_VALUE).max(axis=-1).min() > 30
    write_heatmap(tmp_path / "new" / "m.png", error)
    with Image.open(tmp_path / "new" / "m.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), colors)
