"""Pictures written by this package, by OpenEXR, by Pillow and byte by byte, read back; and files that are no pictures."""

import struct

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from clcache.errors import SettingError
from clcache.output.exr import all_channels, name_in_view, world_to_camera, write_exr
from clcache.output.png import encode_srgb
from clcache.output.read import decode_srgb, read_header, read_picture, split_name
from clcache.scene.model import Camera

SIZE = (5, 7)


class FrameOf:
    """A frame as the renderer yields it, of random pixels."""

    number = 3

    def __init__(self, views):
        rng = np.random.default_rng(len(views))
        self.color = {view: rng.normal(size=(*SIZE, 3)).astype(np.float32) for view in views}
        self.depth = {view: rng.random(SIZE).astype(np.float32) + 1 for view in views}
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        self.cameras = {v: Camera(np.column_stack([turn, [i, 2.0, 3.0]]), 0.5 + i) for i, v in enumerate(views)}
        for depth in self.depth.values():
            depth[0, 0] = np.inf

    def aov(self, name, eye):
        if name == "Z":
            return self.depth[eye]
        return np.full((*SIZE, 3), 0.5, np.float32)


def write(path, channels, **header):
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels) as file:
        file.write(str(path))
    return path


def planes(names, dtype=np.float32):
    return {name: np.full(SIZE, i + 1, dtype) for i, name in enumerate(names)}


@pytest.mark.parametrize("views", [["mono"], ["left", "right"]])
def test_what_was_written_is_read(tmp_path, views):
    frame = FrameOf(views)
    write_exr(tmp_path / "f.exr", frame, ("albedo", "N", "Z"), {})
    picture = read_picture(tmp_path / "f.exr")
    assert (list(picture.color), picture.size, picture.encoded, picture.origin) == (views, SIZE[::-1], False, (0, 0))
    for view in views:
        np.testing.assert_array_equal(picture.color[view], frame.color[view])
        np.testing.assert_array_equal(picture.depth[view], frame.depth[view])
        np.testing.assert_allclose(picture.cameras[view].transform, frame.cameras[view].transform, atol=1e-6)
        assert picture.cameras[view].fov_y == pytest.approx(frame.cameras[view].fov_y)


@pytest.mark.parametrize(
    ("views", "expected"),
    [
        (["mono"], "R G B Z N.X N.Y N.Z"),
        (
            ["left", "right"],
            "R G B Z N.left.X N.left.Y N.left.Z right.R right.G right.B right.Z N.right.X N.right.Y N.right.Z",
        ),
    ],
)
def test_a_header_names_the_channels(tmp_path, views, expected):
    write_exr(tmp_path / "f.exr", FrameOf(views), ("N", "Z"), {"method": "isrt"})
    header = read_header(tmp_path / "f.exr")
    assert (header.size, header.attributes["method"]) == (SIZE[::-1], "isrt")
    assert sorted(header.channels) == sorted(all_channels(("N", "Z"), views)) == sorted(expected.split())


layer = st.text("abcXYZ_019", min_size=1, max_size=8).filter(lambda text: text not in ("left", "right"))


@given(st.lists(layer, min_size=1, max_size=4).map(".".join), st.sampled_from(["left", "right"]))
def test_split_name_is_the_inverse_of_name_in_view(name, view):
    assert split_name(name_in_view(name, ["left", "right"], view), ["left", "right"]) == (view, name)
    assert split_name(name, ["mono"]) == ("mono", name)


def test_a_layer_is_no_colour(tmp_path):
    path = write(tmp_path / "f.exr", planes(["R", "G", "B", "diffuse.R", "diffuse.G", "diffuse.B"]))
    np.testing.assert_array_equal(read_picture(path).color["mono"][0, 0], [1, 2, 3])
    with pytest.raises(SettingError, match=r"f.exr: channels .*diffuse\.R.*; expected R, G and B"):
        read_picture(write(path, planes(["diffuse.R", "diffuse.G", "diffuse.B"])))


def test_parts_with_views(tmp_path):
    parts = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": view, "view": view}, planes(["R", "G", "B", "Z"]), view)
        for view in ("left", "right")
    ]
    parts[1].channels["R"].pixels[:] = 9
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "f.exr"))
    picture = read_picture(tmp_path / "f.exr")
    assert [picture.color[view][0, 0, 0] for view in ("left", "right")] == [1, 9]
    assert set(picture.depth) == {"left", "right"} and not picture.cameras


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_grey_stands_for_all_three_channels(tmp_path, dtype):
    picture = read_picture(write(tmp_path / "f.exr", planes(["Y", "A"], dtype)))
    assert picture.color["mono"].shape == (*SIZE, 3) and picture.color["mono"].dtype == np.float32
    assert (picture.color["mono"] == 1.0).all()


@pytest.mark.parametrize("names", [["G"], ["R", "G"], ["Z"], ["Y", "RY", "BY"]])
def test_channels_that_are_no_colour_are_refused(tmp_path, names):
    with pytest.raises(SettingError, match="expected R, G and B, or Y alone"):
        read_picture(write(tmp_path / "f.exr", planes(names)))


def test_other_primaries_are_refused(tmp_path):
    rec_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
    read_picture(write(tmp_path / "f.exr", planes("RGB"), chromaticities=rec_709))
    with pytest.raises(SettingError, match="expected those of Rec. 709"):
        read_picture(write(tmp_path / "f.exr", planes("RGB"), chromaticities=(0.7, *rec_709[1:])))


@pytest.mark.parametrize(
    ("matrix", "fov_y"), [(np.zeros((4, 4), np.float32), 0.8), (np.eye(4, dtype=np.float32), 4.0), (None, None)]
)
def test_a_camera_that_is_none_is_refused(tmp_path, matrix, fov_y):
    header = {"worldToCamera": matrix, "fovY": fov_y}
    if matrix is None:
        header = {"worldToCamera": world_to_camera(Camera(np.eye(4)[:3], 1.0)), "fovY": "wide"}
    with pytest.raises(SettingError, match="view mono are no camera"):
        read_picture(write(tmp_path / "f.exr", planes("RGB"), **header))


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "I;16"])
def test_png_values_are_kept_as_they_are(tmp_path, mode):
    rng = np.random.default_rng(1)
    shape = SIZE if mode in ("L", "I;16") else (*SIZE, len(mode))
    stored = rng.integers(0, 65536 if mode == "I;16" else 256, shape).astype(np.uint16 if mode == "I;16" else np.uint8)
    Image.fromarray(stored).save(tmp_path / "f.png")
    picture = read_picture(tmp_path / "f.png")
    expected = np.broadcast_to(stored[..., None], (*SIZE, 3)) if stored.ndim == 2 else stored[..., :3]
    assert picture.encoded
    np.testing.assert_allclose(picture.color["mono"], expected / (65535 if mode == "I;16" else 255), atol=1e-6)


def test_radiance_hdr(tmp_path):
    rgbe = bytes([128, 64, 32, 129, 255, 0, 1, 136])  # mantissa / 256 * 2^(exponent - 128)
    (tmp_path / "f.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + rgbe)
    picture = read_picture(tmp_path / "f.hdr")
    assert not picture.encoded
    np.testing.assert_allclose(picture.color["mono"], [[[1.0, 0.5, 0.25], [255.0, 0.0, 1.0]]], rtol=0.01, atol=1e-6)


def test_decode_srgb_is_the_inverse_of_encode_srgb():
    linear = np.linspace(0, 1, 5001)
    np.testing.assert_allclose(decode_srgb(encode_srgb(linear)), linear, atol=2e-7)


def test_what_is_no_picture_is_an_error_of_one_line(tmp_path):
    good = write(tmp_path / "good.exr", planes("RGB")).read_bytes()
    window = good.index(b"dataWindow") + len(b"dataWindow\0box2i\0") + 4
    huge = good[:window] + struct.pack("<4i", 0, 0, 10**6, 10**6) + good[window + 16 :]
    for name, content, message in (
        ("cut.exr", good[: len(good) - 20], "damaged"),
        ("header.exr", good[:50], "damaged"),
        ("huge.exr", huge, "damaged|expected at most"),
        ("text.exr", b"hello", "not a picture"),
        ("empty.png", b"", "not a picture"),
        ("cut.png", b"\x89PNG\r\n\x1a\n", "damaged"),
        ("cut.hdr", b"#?RADIANCE\n\n-Y 1 +X 2\n", "damaged"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(SettingError, match=f"{name}.*({message})") as error:
            read_picture(path)
        assert "\n" not in str(error.value)
    for path in (tmp_path, tmp_path / "none.exr", "a\0b.exr"):
        with pytest.raises(SettingError, match="no such file|not a regular file"):
            read_picture(path)


def test_the_ending_of_a_name_is_not_trusted(tmp_path):
    content = write(tmp_path / "f.exr", planes("RGB")).read_bytes()
    (tmp_path / "f.png").write_bytes(content)
    picture = read_picture(tmp_path / "f.png")
    assert not picture.encoded
    np.testing.assert_array_equal(picture.color["mono"][0, 0], [1, 2, 3])
