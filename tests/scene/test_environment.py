"""Environment pictures: which way they are put up, and what is refused."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from clcache import SceneError, load_scene
from clcache.scene.environment import read_environment, turned

SCENE = '[meshes.a]\ngenerator = "box"\n[[instances]]\nmesh = "a"\n[environment]\n'


def _write_exr(path: Path, pixels: np.ndarray, **header: object) -> Path:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
    with OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels, np.float32)}) as file:
        file.write(str(path))
    return path


def _write_hdr(path: Path, rgbe: np.ndarray) -> Path:
    """A Radiance file with a run-length encoded scan line for each row, as runs of at most 127 equal bytes."""
    height, width = rgbe.shape[:2]
    data = (
        b"#?RADIANCE\nGAMMA=1\nPRIMARIES=0 0 0 0 0 0 0 0\nFORMAT=32-bit_rle_rgbe\n\n"
        + f"-Y {height} +X {width}\n".encode()
    )
    for row in rgbe:
        data += bytes([2, 2, width >> 8, width & 255])
        for plane in row.T:
            data += b"".join(bytes([129, value]) for value in plane)
    path.write_bytes(data)
    return path


def _marked() -> np.ndarray:
    """8 x 16, a pixel lit in each of: straight up, ahead (-Z), right (+X), behind (+Z), left (-X)."""
    picture = np.zeros((8, 16, 3), np.float32)
    picture[0] = (9, 9, 9)
    for value, column in enumerate((8, 12, 0, 4), 1):
        picture[4, column] = value
    return picture


def _load(tmp_path: Path, text: str):
    (tmp_path / "a.toml").write_text(SCENE + text)
    return load_scene(tmp_path / "a.toml").environment.radiance


def test_a_picture_is_put_up_as_it_is(tmp_path):
    _write_exr(tmp_path / "a.exr", _marked())
    assert np.array_equal(_load(tmp_path, 'image = "a.exr"'), _marked())


def test_a_quarter_turn_brings_ahead_to_the_left(tmp_path):
    """Counter-clockwise as seen from above: -Z goes to -X, +X to -Z."""
    _write_exr(tmp_path / "a.exr", _marked())
    row = _load(tmp_path, 'image = { file = "a.exr", rotation = 90, scale = 10 }')[4, :, 0]
    assert (row[4], row[8], row[12], row[0]) == (10, 20, 30, 40)


def test_turns_between_columns_keep_the_light():
    picture = np.random.default_rng(1).random((4, 10, 3), np.float32)
    turn = turned(picture, 17.0)
    assert turn.sum() == pytest.approx(picture.sum(), rel=1e-5)
    assert turned(turn, -17.0 + 360) != pytest.approx(picture)  # interpolated twice
    assert np.array_equal(turned(picture, 360), picture)


def test_radiance_files(tmp_path):
    """Value = mantissa * 2^(exponent - 136); an exponent of 0 is black."""
    rgbe = np.random.default_rng(2).integers(1, 256, (3, 20, 4), np.uint8)
    rgbe[..., 3] = np.clip(rgbe[..., 3], 100, 160)
    rgbe[0, 0] = (200, 100, 50, 0)
    expected = rgbe[..., :3] * 2.0 ** (rgbe[..., 3:].astype(int) - 136)
    expected[0, 0] = 0
    found = read_environment(_write_hdr(tmp_path / "a.hdr", rgbe), "a.hdr")
    assert found.dtype == np.float32
    # Readers differ in whether they take the middle of the mantissa's step.
    step = np.where(expected > 0, 2.0 ** (rgbe[..., 3:].astype(int) - 136), 0)
    assert (np.abs(found - expected) <= 0.5 * step + 1e-6 * expected).all()


def test_luminance_alone_is_grey(tmp_path):
    values = np.arange(8, dtype=np.float32).reshape(2, 4)
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": values}) as file:
        file.write(str(tmp_path / "a.exr"))
    assert np.array_equal(read_environment(tmp_path / "a.exr", "a"), np.dstack([values] * 3))


def test_a_smaller_data_window_leaves_black(tmp_path):
    display = (np.array([0, 0], np.int32), np.array([15, 7], np.int32))
    data = (np.array([2, 1], np.int32), np.array([5, 2], np.int32))
    pixels = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    path = _write_exr(tmp_path / "a.exr", pixels, displayWindow=display, dataWindow=data)
    expected = np.zeros((8, 16, 3))
    expected[1:3, 2:6] = pixels
    assert np.array_equal(read_environment(path, "a"), expected)


@pytest.mark.parametrize(("bad", "shown"), [(np.nan, "nan"), (np.inf, "inf"), (-1.0, "-1"), (3e38, "3e+38")])
def test_values_that_are_no_radiance(tmp_path, bad, shown):
    picture = _marked()
    picture[5, 3, 1] = bad
    _write_exr(tmp_path / "a.exr", picture)
    with pytest.raises(SceneError) as caught:
        _load(tmp_path, 'image = "a.exr"')
    assert f"a.toml:6: environment.image: 'a.exr': pixel (3, 5) is {shown}" in str(caught.value)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.exr").write_text("no picture")
    (tmp_path / "a.png").write_bytes(b"")
    whole = _write_hdr(tmp_path / "whole.hdr", np.full((64, 64, 4), 130, np.uint8)).read_bytes()
    (tmp_path / "cut.hdr").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "huge.hdr").write_bytes(whole.replace(b"-Y 64 +X 64", b"-Y 9000 +X 9000"))
    for name, message in {
        "a.exr": "not a readable picture",
        "a.png": "expected a picture with the suffix .exr or .hdr",
        "cut.hdr": "the picture is damaged",
        "huge.hdr": "9000 x 9000 pixels; expected at most",
        "none.exr": "no such file",
    }.items():
        with pytest.raises(SceneError, match=message) as caught:
            _load(tmp_path, f'image = "{name}"')
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected one of color, image and sky"),
        ('color = [1, 1, 1]\nimage = "a.exr"', "expected one of color, image and sky"),
        ('image = { file = "a.exr", turn = 3 }', r"a.toml:6: environment.image.turn: unknown key"),
        ("color = [1, -1, 1]", r"a.toml:6: environment.color.1: -1 is wrong"),
    ],
)
def test_schema_errors(tmp_path, text, message):
    with pytest.raises(SceneError, match=message):
        _load(tmp_path, text)
