"""Sun and sky of a clear day: Preetham, Shirley, Smits 1999, "A Practical Analytic Model for Daylight".

The sky's luminance and chromaticity are those at the zenith (appendix A.2), spread over the sky by Perez's function (eq. 3).
The sun is a disc whose spectrum outside the atmosphere is attenuated by Rayleigh scattering, aerosols, ozone, mixed gases
and water vapour (appendix A.1). Colours become linear Rec. 709 by the CIE 1931 observer, whose functions are taken from the
fit of Wyman, Sloan, Shirley 2013, "Simple Analytic Approximations to the CIE XYZ Color Matching Functions", JCGT 2(2).

Units: watts weighted by the eye's sensitivity, that is luminance in cd/m^2 divided by 683 lm/W, for the sky and the sun alike,
so that an RGB radiance has the luminance of the physical one: some 10 W/(m^2 sr) of the sky, 150 W/m^2 of the sun.
"""

import numpy as np
from numpy.typing import ArrayLike

SUN_RADIUS = np.radians(0.2665)
SUN_SOLID_ANGLE = 2 * np.pi * (1 - np.cos(SUN_RADIUS))
LUMENS_PER_WATT = 683.0

# CIE XYZ to linear Rec. 709 with a D65 white point (IEC 61966-2-1).
_RGB_OF_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])

# A.2: Perez's A to E as slope and intercept over turbidity, for luminance Y and chromaticities x and y.
_PEREZ_Y = np.array([[0.1787, -1.4630], [-0.3554, 0.4275], [-0.0227, 5.3251], [0.1206, -2.5771], [-0.0670, 0.3703]])
_PEREZ_X = np.array([[-0.0193, -0.2592], [-0.0665, 0.0008], [-0.0004, 0.2125], [-0.0641, -0.8989], [-0.0033, 0.0452]])
_PEREZ_SMALL_Y = np.array(
    [[-0.0167, -0.2608], [-0.0950, 0.0092], [-0.0079, 0.2102], [-0.0441, -1.6537], [-0.0109, 0.0529]]
)

# A.2: the zenith's x and y; rows: turbidity squared, turbidity, 1; columns: cube, square, first power of the sun's angle, 1.
_ZENITH_X = np.array(
    [[0.00166, -0.00375, 0.00209, 0.0], [-0.02903, 0.06377, -0.03202, 0.00394], [0.11693, -0.21196, 0.06052, 0.25886]]
)
_ZENITH_Y = np.array(
    [[0.00275, -0.00610, 0.00317, 0.0], [-0.04214, 0.08970, -0.04153, 0.00516], [0.15346, -0.26756, 0.06670, 0.26688]]
)

# Table 2, from 380 to 750 nm in steps of 10: the sun's radiance outside the atmosphere, 100 W / (m^2 nm sr), and the
# absorption of ozone and of water vapour, 1 / cm. Mixed gases absorb only above 750 nm.
_WAVELENGTHS = np.arange(380.0, 751.0, 10.0)
_SUN = np.array(
    [165.5, 162.3, 211.2, 258.8, 258.2, 242.3, 267.6, 296.6, 305.4, 300.6, 306.6, 288.3, 287.1, 278.2, 271.0, 272.3, 263.6, 255.0,
     250.6, 253.1, 253.5, 251.3, 246.3, 241.7, 236.8, 232.1, 228.2, 223.4, 219.7, 215.3, 211.0, 207.3, 202.4, 198.7, 194.3, 190.7,
     186.3, 182.6]
)  # fmt: skip
_OZONE = np.concatenate(
    [np.zeros(7), [0.003, 0.006, 0.009, 0.014, 0.021, 0.030, 0.040, 0.048, 0.063, 0.075, 0.085, 0.103, 0.120, 0.120, 0.115,
     0.125, 0.120, 0.105, 0.090, 0.079, 0.067, 0.057, 0.048, 0.036, 0.028, 0.023, 0.018, 0.014, 0.011, 0.010, 0.009]]
)  # fmt: skip
_VAPOUR = np.concatenate([np.zeros(31), [0.016, 0.024, 0.0125, 1.0, 0.87, 0.061, 0.001]])


def sky_picture(turbidity: float, to_sun: ArrayLike, width: int) -> np.ndarray:
    """(width / 2, width, 3) float32 radiance of the sky without the sun, laid out as in `Environment`; black below the horizon.

    to_sun: unit vector to the sun, which is above the horizon. width: even.
    """
    to_sun = np.asarray(to_sun, np.float64)
    rows, columns = width // 4, width
    zenith_angle = np.pi * (np.arange(rows) + 0.5) / (width // 2)
    around = 2 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    up, across = np.cos(zenith_angle)[:, None], np.sin(zenith_angle)[:, None]
    cosine = across * (np.sin(around) * to_sun[0] - np.cos(around) * to_sun[2]) + up * to_sun[1]
    from_sun = np.arccos(np.clip(cosine, -1.0, 1.0))
    sky = sky_radiance(turbidity, np.arccos(to_sun[1]), zenith_angle[:, None], from_sun)
    return np.concatenate([sky, np.zeros((width // 2 - rows, columns, 3))]).astype(np.float32)


def sky_radiance(turbidity: float, sun_angle: float, zenith_angle: np.ndarray, from_sun: np.ndarray) -> np.ndarray:
    """(..., 3) linear RGB radiance in directions at angles (radians) from the zenith and from the sun."""
    zenith = zenith_color(turbidity, sun_angle)
    tables = (_PEREZ_X, _PEREZ_SMALL_Y, _PEREZ_Y)
    x, y, luminance = (
        value
        * _perez(table @ (turbidity, 1.0), zenith_angle, from_sun)
        / _perez(table @ (turbidity, 1.0), 0.0, sun_angle)
        for value, table in zip(zenith, tables, strict=True)
    )
    xyz = np.stack([x / y, np.ones_like(y), (1 - x - y) / y], axis=-1) * luminance[..., None]
    return np.maximum(xyz @ _RGB_OF_XYZ.T, 0.0) / LUMENS_PER_WATT


def zenith_color(turbidity: float, sun_angle: float) -> tuple[float, float, float]:
    """x, y and luminance (cd / m^2) at the zenith. sun_angle: of the sun from the zenith, radians."""
    powers = sun_angle ** np.array([3, 2, 1, 0])
    by_turbidity = np.array([turbidity**2, turbidity, 1.0])
    chi = (4 / 9 - turbidity / 120) * (np.pi - 2 * sun_angle)
    luminance = (4.0453 * turbidity - 4.9710) * np.tan(chi) - 0.2155 * turbidity + 2.4192
    return float(by_turbidity @ _ZENITH_X @ powers), float(by_turbidity @ _ZENITH_Y @ powers), 1000 * float(luminance)


def sun_irradiance(turbidity: float, sun_angle: float) -> tuple[float, float, float]:
    """Linear RGB irradiance of the sun's disc on a surface that faces it. sun_angle: from the zenith, radians, below pi / 2."""
    spectrum = 100 * _SUN * sun_transmittance(turbidity, sun_angle)
    xyz = (color_matching(_WAVELENGTHS) * spectrum[:, None]).sum(axis=0) * 10.0
    return tuple((np.maximum(_RGB_OF_XYZ @ xyz, 0.0) * SUN_SOLID_ANGLE).tolist())


def sun_transmittance(turbidity: float, sun_angle: float) -> np.ndarray:
    """(38,) part of the sun's light that reaches the ground, from 380 to 750 nm in steps of 10 (A.1)."""
    mass = 1 / (np.cos(sun_angle) + 0.15 * (93.885 - np.degrees(sun_angle)) ** -1.253)
    micrometres = _WAVELENGTHS / 1000
    rayleigh = 0.008735 * micrometres**-4.08
    aerosols = (0.04608 * turbidity - 0.04586) * micrometres**-1.3
    ozone = 0.35 * _OZONE  # cm of it
    vapour = 2.0 * _VAPOUR  # cm of it
    vapour_depth = 0.2385 * vapour * mass / (1 + 20.07 * vapour * mass) ** 0.45
    return np.exp(-mass * (rayleigh + aerosols + ozone) - vapour_depth)


def color_matching(wavelengths: np.ndarray) -> np.ndarray:
    """(n, 3) the CIE 1931 observer's x, y, z at wavelengths in nm."""

    def lobe(middle: float, below: float, above: float) -> np.ndarray:
        return np.exp(-0.5 * ((wavelengths - middle) / np.where(wavelengths < middle, below, above)) ** 2)

    x = 1.056 * lobe(599.8, 37.9, 31.0) + 0.362 * lobe(442.0, 16.0, 26.7) - 0.065 * lobe(501.1, 20.4, 26.2)
    y = 0.821 * lobe(568.8, 46.9, 40.5) + 0.286 * lobe(530.9, 16.3, 31.1)
    z = 1.217 * lobe(437.0, 11.8, 36.0) + 0.681 * lobe(459.0, 26.0, 13.8)
    return np.column_stack([x, y, z])


def _perez(coefficients: np.ndarray, zenith_angle: np.ndarray | float, from_sun: np.ndarray | float) -> np.ndarray:
    a, b, c, d, e = coefficients
    return (1 + a * np.exp(b / np.cos(zenith_angle))) * (1 + c * np.exp(d * from_sun) + e * np.cos(from_sun) ** 2)
