"""GGX reflection and refraction in NumPy's float64, from the published formulas, and their integrals.

Walter et al. 2007; Heitz 2014, "Understanding the Masking-Shadowing Function"; glTF 2.0, appendix B.

Directions are binned by their microfacet: h, the normal that would reflect or refract one direction into the other, by its
azimuth and by q, a function of its angle from the normal by which half of the cells lie where a lobe of that alpha is, and
half are spread evenly over the hemisphere. There the densities are smooth at any roughness, so that midpoints of small
cells integrate them.
"""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Model:
    """The fields of `Bsdf`, each colour grey."""

    diffuse: float = 0.0
    f0: float = 0.0
    f90: float = 1.0
    transmitted: float = 0.0
    roughness: float = 0.5
    eta: float = 1.5
    thin: bool = False

    @property
    def alpha(self):
        return self.roughness**2

    @property
    def record(self):
        colors = [self.diffuse] * 3 + [self.f0] * 3 + [self.transmitted] * 3
        return np.array([*colors, self.f90, self.alpha, self.eta, self.thin], np.float32)


def towards(degrees, azimuth=0.3):
    """The unit direction of an angle from the normal."""
    angle = np.radians(degrees)
    return np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])


def ggx(h, alpha):
    tangent2 = (1 - h[:, 2] ** 2) / h[:, 2] ** 2
    return 1 / (np.pi * alpha**2 * h[:, 2] ** 4 * (1 + tangent2 / alpha**2) ** 2)


def smith(w, alpha):
    """Lambda"""
    return (np.sqrt(1 + alpha**2 * (1 / w[..., 2] ** 2 - 1)) - 1) / 2


def dielectric(cosine, eta):
    """Unpolarised reflectance, from amplitudes with complex numbers: beyond the critical angle their size is 1."""
    refracted = np.sqrt(1 - (1 - cosine**2 + 0j) / eta**2)
    s, p = (
        (cosine - eta * refracted) / (cosine + eta * refracted),
        (refracted - eta * cosine) / (refracted + eta * cosine),
    )
    return 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)


def fresnel(model: Model, cosine):
    return dielectric(cosine, model.eta) if model.transmitted else model.f0 + (model.f90 - model.f0) * (1 - cosine) ** 5


def unit(v):
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def place(alpha, cosine):
    """q in [0, 1] of a microfacet at this angle, and its derivative: half GGX's distribution of alpha, half solid angle."""
    square, narrow = cosine**2, alpha**2
    share = (1 - square) / (1 - square + narrow * square)
    slope = 2 * narrow * cosine / (1 - square + narrow * square) ** 2
    return 0.5 * (share + 1 - cosine), -0.5 * (slope + 1)


def microfacets(model: Model, rows: int, columns: int, fine: int):
    """Midpoints of fine x fine parts of each of rows x columns cells: normals (m, 3), the solid angle of each, its cell."""
    q = (np.arange(rows * fine) + 0.5) / (rows * fine)
    low, high = np.zeros_like(q), np.ones_like(q)
    for _ in range(60):  # bisection: q falls with the cosine
        cosine = 0.5 * (low + high)
        too_small = place(model.alpha, cosine)[0] > q
        low, high = np.where(too_small, cosine, low), np.where(too_small, high, cosine)
    azimuth = (np.arange(columns * fine) + 0.5) / (columns * fine) * 2 * np.pi
    cosine, azimuth = (a.ravel() for a in np.meshgrid(cosine, azimuth, indexing="ij"))
    sine = np.sqrt(1 - cosine**2)
    h = np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])
    solid_angle = 2 * np.pi / (len(cosine) * -place(model.alpha, cosine)[1])
    return h, solid_angle, cell_of(model, h, rows, columns)


def cell_of(model: Model, h, rows, columns):
    row = np.minimum(place(model.alpha, h[:, 2])[0] * rows, rows - 1).astype(int)
    column = (np.arctan2(h[:, 1], h[:, 0]) / (2 * np.pi) % 1 * columns).astype(int) % columns
    return row * columns + column


def reflected(model, out, h):
    """Directions by reflection at h and dw / dw_h; those that leave above."""
    cosine = h @ out
    into = 2 * cosine[:, None] * h - out
    return into, 4 * cosine, (cosine > 0) & (into[:, 2] > 0)


def transmitted(model, out, h):
    """The same by transmission: those that leave below."""
    cosine = h @ out
    if model.thin:
        into, jacobian, valid = reflected(model, out, h)
        return into * [1, 1, -1], jacobian, valid
    root = 1 - (1 - cosine**2) / model.eta**2
    beyond = np.sqrt(np.maximum(root, 0))
    into = (cosine / model.eta - beyond)[:, None] * h - out / model.eta
    with np.errstate(divide="ignore"):
        jacobian = (cosine - model.eta * beyond) ** 2 / (model.eta**2 * beyond)
    return into, jacobian, (cosine > 0) & (root > 0) & (into[:, 2] < 0)


def halfway(model, out, into):
    """The microfacet's normal of each pair."""
    below = into[:, 2] < 0
    if model.thin:
        h = out + np.where(below[:, None], into * [1, 1, -1], into)
    else:
        h = np.where(below[:, None], out + model.eta * into, out + into)
    h = unit(h)
    return np.where(h[:, 2:] < 0, -h, h)


def exact(model: Model, out, into):
    """f |cos| in float64, for directions (n, 3)."""
    h = halfway(model, out, into)
    cosine_out, cosine_in = h @ out, np.sum(h * into, axis=1)
    f = fresnel(model, cosine_out)
    d, lambda_out, lambda_in = ggx(h, model.alpha), smith(out, model.alpha), smith(into, model.alpha)
    separable = 1 / ((1 + lambda_out) * (1 + lambda_in))
    above = into[:, 2] > 0
    g = separable if model.transmitted else 1 / (1 + lambda_out + lambda_in)
    mirror = f * d * g / (4 * out[2]) + (1 - f) * model.diffuse * into[:, 2] / np.pi
    if model.thin:
        through = d * separable / (4 * out[2])
    else:
        through = d * separable * cosine_out * np.abs(cosine_in) / (out[2] * (cosine_out + model.eta * cosine_in) ** 2)
    return np.where(above, mirror, (1 - f) * model.transmitted * through)


def albedo(model: Model, out, fine=256):
    """What is reflected and transmitted of light that comes evenly from everywhere: midpoint quadrature of `exact`.

    Radiance beyond the surface is eta^2 times what carries the same flux in front of it; here it is flux that counts.
    """
    h, solid_angle, _ = microfacets(model, 1, 1, 3 * fine)
    total = 0.0
    for direction, factor in ((reflected, 1.0), (transmitted, 1.0 if model.thin else model.eta**2)):
        if direction is transmitted and not model.transmitted:
            continue
        into, jacobian, valid = direction(model, out, h)
        value = exact(replace(model, diffuse=0.0), out, into[valid])
        total += factor * np.sum(value * jacobian[valid] * solid_angle[valid])
    z, azimuth = np.meshgrid((np.arange(fine) + 0.5) / fine, (np.arange(fine) + 0.5) / fine * 2 * np.pi)
    r = np.sqrt(1 - z.ravel() ** 2)
    into = np.column_stack([r * np.cos(azimuth.ravel()), r * np.sin(azimuth.ravel()), z.ravel()])
    f = fresnel(model, halfway(model, out, into) @ out)
    return total + np.sum((1 - f) * model.diffuse * into[:, 2] / np.pi) * 2 * np.pi / fine**2
