"""Preetham's sky against what its paper and others publish."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache import SceneError, load_scene
from clcache.scene.sky import (
    LUMENS_PER_WATT,
    SUN_SOLID_ANGLE,
    color_matching,
    sky_picture,
    sky_radiance,
    sun_irradiance,
    sun_transmittance,
    zenith_color,
)

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SCENE = '[meshes.a]\ngenerator = "box"\n[[instances]]\nmesh = "a"\n[environment.sky]\n'


def _luminance(rgb: np.ndarray) -> np.ndarray:
    return np.asarray(rgb) @ LUMINANCE * LUMENS_PER_WATT


def _to_sun(elevation: float, azimuth: float = 0.0) -> np.ndarray:
    up, around = math.radians(elevation), math.radians(azimuth)
    return np.array([math.cos(up) * math.sin(around), math.sin(up), -math.cos(up) * math.cos(around)])


def test_zenith_luminance_follows_the_formula():
    """At turbidity 3 and the sun at 60 degrees from the zenith: chi = (4/9 - 1/40) pi/3, written out by hand."""
    chi = (0.4444444444 - 0.025) * math.pi / 3
    expected = 1000 * ((12.1359 - 4.9710) * math.tan(chi) - 0.6465 + 2.4192)
    assert zenith_color(3.0, math.radians(60))[2] == pytest.approx(expected, rel=1e-6)


def test_zenith_chromaticity_with_the_sun_there():
    """With the sun's angle 0, only the constant terms of the two matrices are left."""
    x, y, _ = zenith_color(4.0, 0.0)
    assert x == pytest.approx(0.00394 * 4 + 0.25886)
    assert y == pytest.approx(0.00516 * 4 + 0.26688)


@given(st.floats(2, 10), st.floats(5, 85))
def test_the_zenith_of_the_sky_has_the_zenith_s_colour(turbidity, elevation):
    angle = math.radians(90 - elevation)
    color = sky_radiance(turbidity, angle, np.zeros(1), np.full(1, angle))[0]
    x, y, luminance = zenith_color(turbidity, angle)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ color * LUMENS_PER_WATT
    assert xyz[1] == pytest.approx(luminance, rel=2e-3)
    assert xyz[:2] / xyz.sum() == pytest.approx([x, y], abs=1e-3)


@given(st.floats(2, 10), st.floats(10, 80), st.floats(0.05, 1.4), st.floats(0.1, 3.0))
def test_luminance_spreads_as_perez_has_it(turbidity, elevation, zenith_angle, from_sun):
    """The ratio of two directions at the same distance from the sun depends on A and B alone, and the other way round."""
    angle = math.radians(90 - elevation)
    high, low = _luminance(sky_radiance(turbidity, angle, np.array([0.0, zenith_angle]), np.full(2, from_sun)))
    a, b = 0.1787 * turbidity - 1.4630, -0.3554 * turbidity + 0.4275
    expected = (1 + a * math.exp(b / math.cos(zenith_angle))) / (1 + a * math.exp(b))
    assert low / high == pytest.approx(expected, rel=0.02)  # colours outside Rec. 709 are clipped


def test_matching_functions_are_those_of_the_standard_observer():
    """Each integrates to 106.9 nm (CIE 1931), and y peaks with 1 near 555 nm."""
    wavelengths = np.arange(360.0, 831.0)
    functions = color_matching(wavelengths)
    assert functions.sum(axis=0) == pytest.approx([106.87, 106.86, 106.89], rel=0.005)
    assert abs(wavelengths[functions[:, 1].argmax()] - 555) < 5
    assert functions[:, 1].max() == pytest.approx(1.0, abs=0.01)


def test_sunlight_is_as_bright_as_measured():
    """Direct normal illuminance of a high sun through a clear sky is 90 to 120 klx (IESNA handbook)."""
    illuminance = _luminance(sun_irradiance(2.5, math.radians(30)))
    assert 90e3 < illuminance < 120e3


def test_the_sun_outside_the_atmosphere():
    """Attenuation taken back gives the extraterrestrial illuminance, 128 to 134 klx."""
    spectrum = sun_irradiance(2.0, 0.0)
    mean = sun_transmittance(2.0, 0.0)[13:23].mean()  # 510 to 600 nm, which is what is seen
    assert 0.95 < _luminance(spectrum) / mean / 131e3 < 1.08


def test_transmittance_by_hand():
    """550 nm, turbidity 2, sun in the zenith: Rayleigh, aerosols and ozone, each written out."""
    mass = 1 / (1 + 0.15 * 93.885**-1.253)
    depth = 0.008735 * 0.55**-4.08 + 0.0463 * 0.55**-1.3 + 0.35 * 0.085
    assert sun_transmittance(2.0, 0.0)[17] == pytest.approx(math.exp(-mass * depth), rel=1e-9)


@given(st.floats(1.7, 10), st.floats(2, 80))
def test_a_lower_sun_is_dimmer_and_redder(turbidity, elevation):
    low, high = (np.array(sun_irradiance(turbidity, math.radians(90 - e))) for e in (elevation, elevation + 8))
    assert (low <= high).all() and low[0] < high[0]
    assert low[2] / low[0] <= high[2] / high[0]


def test_the_picture_s_directions():
    picture = sky_picture(3.0, _to_sun(30, 90), 128)
    assert picture.shape == (64, 128, 3) and picture.dtype == np.float32
    row, column = np.unravel_index(picture.sum(axis=2).argmax(), (64, 128))
    assert abs(column - 96) <= 1  # +X
    assert abs((row + 0.5) / 64 * 180 - 60) < 4
    assert not picture[32:].any() and (picture[:32] > 0).any(axis=2).all()


@given(st.floats(1.7, 10), st.floats(0.1, 90), st.floats(-180, 180))
def test_every_sky_is_radiance(turbidity, elevation, azimuth):
    picture = sky_picture(turbidity, _to_sun(elevation, azimuth), 32)
    assert np.isfinite(picture).all() and (picture >= 0).all() and picture.any()


def _load(tmp_path, text: str):
    (tmp_path / "a.toml").write_text(SCENE + text)
    return load_scene(tmp_path / "a.toml")


def test_in_a_scene(tmp_path):
    scene = _load(tmp_path, "turbidity = 4\nelevation = 30\nazimuth = 90\nscale = 0.5\nresolution = 64\n")
    (sun,) = scene.lights
    assert sun.direction == pytest.approx((-math.cos(math.pi / 6), -0.5, 0), abs=1e-12)
    assert sun.irradiance == pytest.approx(0.5 * np.array(sun_irradiance(4, math.radians(60))))
    assert scene.environment.radiance == pytest.approx(0.5 * sky_picture(4, _to_sun(30, 90), 64), rel=1e-4)


def test_sun_direction_and_no_sun(tmp_path):
    scene = _load(tmp_path, "sun_direction = [0, 2, 0]\nsun = false\n")
    assert scene.lights == ()
    assert scene.environment.radiance.shape == (256, 512, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("elevation = -3", r"a.toml:5: environment.sky: the sun is not above the horizon"),
        ("sun_direction = [1, 0, 0]", r"a.toml:5: environment.sky: the sun is not above the horizon"),
        ("turbidity = 3", r"a.toml:5: environment.sky: expected sun_direction, or elevation"),
        ("elevation = 10\nsun_direction = [0, 1, 0]", r"expected sun_direction, or elevation"),
        ("turbidity = 1.5\nelevation = 10", r"a.toml:6: environment.sky.turbidity: 1.5 is wrong"),
        ("elevation = 10\nresolution = 30", r"a.toml:7: environment.sky.resolution: 30 is wrong"),
    ],
)
def test_errors_name_the_line(tmp_path, text, message):
    with pytest.raises(SceneError, match=message):
        _load(tmp_path, text)


def test_the_disc_is_as_wide_as_the_sun():
    assert pytest.approx(6.8e-5, rel=0.01) == SUN_SOLID_ANGLE
