import io
import zlib

import numpy as np
import pytest
from PIL import Image

from clcache.errors import SceneError
from clcache.scene.textures import decode_picture, encode_srgb


def encoded(picture, kind="png"):
    stream = io.BytesIO()
    picture.save(stream, kind)
    return stream.getvalue()


def pixel(picture, kind="png"):
    pixels = decode_picture(encoded(picture, kind), "x")
    assert pixels.dtype == np.uint8 and pixels.shape == (3, 2, 4) and pixels.flags.c_contiguous
    return pixels[1, 1].tolist()


@pytest.mark.parametrize(
    ("mode", "value", "expected"),
    [
        ("RGB", (10, 20, 30), [10, 20, 30, 255]),
        ("RGBA", (10, 20, 30, 40), [10, 20, 30, 40]),
        ("L", 77, [77, 77, 77, 255]),
        ("LA", (77, 5), [77, 77, 77, 5]),
        ("1", 1, [255, 255, 255, 255]),
        ("I;16", 65535, [255, 255, 255, 255]),
        ("I;16", 257 * 100, [100, 100, 100, 255]),
    ],
)
def test_every_mode_becomes_rgba8(mode, value, expected):
    assert pixel(Image.new(mode, (2, 3), value)) == expected


def test_a_palette_with_transparency():
    picture = Image.new("P", (2, 3), 1)
    picture.putpalette([0, 0, 0, 9, 8, 7])
    stream = io.BytesIO()
    picture.save(stream, "png", transparency=1)
    assert decode_picture(stream.getvalue(), "x")[0, 0].tolist() == [9, 8, 7, 0]


@pytest.mark.parametrize(("value", "expected"), [(0.5, 188), (0.001, 3), (2.0, 255), (-1.0, 0), (3e38, 255)])
def test_floating_point_is_linear_light(value, expected):
    assert pixel(Image.fromarray(np.full((3, 2), value, np.float32)), "tiff") == [expected] * 3 + [255]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(value):
    pixels = np.full((3, 2), 0.5, np.float32)
    pixels[2, 1] = value
    with pytest.raises(SceneError, match=r"x: pixel \(1, 2\) is -?(nan|inf); expected finite"):
        pixel(Image.fromarray(pixels), "tiff")


def test_rows_are_from_the_top():
    pixels = np.zeros((3, 2, 3), np.uint8)
    pixels[0] = 200
    assert decode_picture(encoded(Image.fromarray(pixels)), "x")[:, 0, 0].tolist() == [200, 0, 0]


def test_srgb_is_inverted_by_the_decoding_function():
    s = np.linspace(0, 1, 1001)
    linear = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    assert np.allclose(encode_srgb(linear), s, atol=1e-6)


@pytest.mark.parametrize("kind", ["png", "jpeg", "tiff", "bmp", "gif"])
@pytest.mark.parametrize("keep", [0, 4, 30, 0.5])
def test_damaged_pictures_are_refused(kind, keep):
    noise = np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8)
    data = encoded(Image.fromarray(noise), kind)
    cut = data[: int(keep * len(data)) if isinstance(keep, float) else keep]
    with pytest.raises(SceneError) as error:
        decode_picture(cut, "some.file: images[3]")
    assert str(error.value).startswith("some.file: images[3]: ") and "\n" not in str(error.value)


def test_a_decompression_bomb_is_refused():
    bomb = bytearray(encoded(Image.new("L", (2, 3))))
    bomb[16:24] = (100_000).to_bytes(4, "big") * 2
    bomb[29:33] = zlib.crc32(bytes(bomb[12:29])).to_bytes(4, "big")
    with pytest.raises(SceneError, match="too many pixels"):
        decode_picture(bytes(bomb), "x")
