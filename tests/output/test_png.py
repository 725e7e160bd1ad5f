"""The tone curve against the formula of its specification, its limits, and the files."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from clcache.output.png import NOT_FINITE, encode_srgb, to_bytes, tone_map, write_png

radiance = st.floats(0.0, 20.0, width=32) | st.floats(0.0, float(np.float32(3e38)), width=32)


def pbr_neutral(color):
    """The specification's formula for one colour, in double precision."""
    lowest = min(color)
    offset = lowest - 6.25 * lowest * lowest if lowest < 0.08 else 0.04
    color = [c - offset for c in color]
    peak = max(color)
    if peak < 0.76:
        return color
    new_peak = 1.0 - 0.24 * 0.24 / (peak + 0.24 - 0.76)
    white = 1.0 - 1.0 / (0.15 * (peak - new_peak) + 1.0)
    return [c * (new_peak / peak) * (1.0 - white) + new_peak * white for c in color]


@given(st.tuples(radiance, radiance, radiance))
def test_tone_map_is_the_specifications(color):
    assert tone_map(np.array(color)) == pytest.approx(pbr_neutral(color), abs=2e-6)


@given(hnp.arrays(np.float32, (4, 3), elements=st.floats(width=32, allow_nan=False, allow_infinity=False)))
def test_tone_map_stays_in_the_display_range(color):
    mapped = tone_map(color)
    assert mapped.shape == color.shape and mapped.dtype == np.float32
    assert (mapped >= 0.0).all() and (mapped <= 1.0).all()


@given(st.tuples(radiance, radiance, radiance), st.floats(1.0, 2.0))
def test_more_light_is_never_darker(color, factor):
    color = np.minimum(np.float32(color), np.float32(1e38))
    assert tone_map(color * np.float32(factor)).max() >= tone_map(color).max() - 1e-6


def test_grey_rises_all_the_way():
    grey = tone_map(np.repeat(np.geomspace(1e-3, 50.0, 500)[:, None], 3, axis=1))
    assert (np.diff(grey[:, 0]) > 0).all()
    assert (grey == grey[:, :1]).all()


def test_base_colours_lose_what_a_dielectric_reflects_and_nothing_else():
    color = np.array([[0.1, 0.3, 0.79], [0.5, 0.08, 0.2]])
    np.testing.assert_allclose(tone_map(color), color - 0.04, atol=1e-6)


def test_negative_light_is_black():
    assert (to_bytes(np.full((1, 1, 3), -5.0, np.float32)) == 0).all()


def test_srgb_encoding_at_known_points():
    linear = np.array([0.0, 0.0031308, 0.21404114, 1.0])
    np.testing.assert_allclose(encode_srgb(linear), [0.0, 0.0404499, 0.5, 1.0], atol=1e-6)


@given(hnp.arrays(np.float32, (2, 3, 3), elements=st.floats(width=32)))
def test_exactly_the_pixels_that_are_not_finite_are_magenta(color):
    magenta = (to_bytes(color) == NOT_FINITE).all(axis=-1)
    finite = np.isfinite(color).all(axis=-1)
    assert magenta[~finite].all()
    # The curve makes no pure magenta of its own: its darkest channel is 0 only where the brightest is below 1.
    assert not magenta[finite & (np.nan_to_num(color, posinf=0).max(axis=-1) < 10)].any()


def test_file_holds_the_picture(tmp_path):
    color = np.random.default_rng(1).gamma(1.0, 0.5, (5, 7, 3)).astype(np.float32)
    write_png(tmp_path / "a.png", color)
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGB" and image.size == (7, 5)
        np.testing.assert_array_equal(np.asarray(image), to_bytes(color))
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
