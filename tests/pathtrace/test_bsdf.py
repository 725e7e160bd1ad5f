"""The reflection model: sampling against its density, and both against the same formulas in NumPy's float64."""

from dataclasses import replace

import numpy as np
import pytest
from kernel_source import build
from microfacets import (
    Model,
    albedo,
    cell_of,
    exact,
    fresnel,
    halfway,
    microfacets,
    reflected,
    towards,
    transmitted,
    unit,
)
from scipy import stats

SOURCE = """
#include "common/bsdf.cl"

inline Bsdf read_bsdf(__global const float *v)
{
    Bsdf bsdf;
    bsdf.diffuse = row3(v, 0);
    bsdf.f0 = row3(v, 1);
    bsdf.transmitted = row3(v, 2);
    bsdf.f90 = v[9];
    bsdf.alpha = v[10];
    bsdf.eta = v[11];
    bsdf.thin = v[12] != 0.0f;
    return bsdf;
}

__kernel void evaluate(
    __global const float *model,  // (13)
    __global const float *out,    // (3, n)
    __global const float *in,     // (3, n)
    __global float *value,        // (3, n)
    __global float *density,      // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Bsdf bsdf = read_bsdf(model);
    float found;
    store_planes(value, n, i, evaluate_bsdf(&bsdf, load_vec3(out, n, i), load_vec3(in, n, i), &found));
    density[i] = found;
}

__kernel void sample(
    __global const float *model,   // (13)
    __global const float *out,     // (3, n)
    __global const float *random,  // (3, n)
    __global float *in,            // (3, n)
    __global float *weight,        // (3, n)
    __global float *density,       // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Bsdf bsdf = read_bsdf(model);
    Vec3 u = load_vec3(random, n, i);
    Scattered s = sample_bsdf(&bsdf, load_vec3(out, n, i), u.x, u.y, u.z);
    store_planes(in, n, i, s.direction);
    store_planes(weight, n, i, s.weight);
    density[i] = s.density;
}

__kernel void frame(
    __global const float *normal,  // (3, n)
    __global float *tangent,       // (3, n)
    __global float *bitangent,     // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Vec3 t, b;
    make_frame(load_vec3(normal, n, i), &t, &b);
    store_planes(tangent, n, i, t);
    store_planes(bitangent, n, i, b);
}
"""

ALPHA_SMOOTH = 1e-3  # of bsdf.cl
SIGNIFICANCE = 0.01  # of a whole test, Sidak-corrected over its parts


PLASTIC = Model(0.7, 0.04)
METAL = Model(f0=0.9)
GLASS = Model(f0=0.04, transmitted=0.95)
LOBES = {
    "plastic": PLASTIC,
    "metal": METAL,
    "glass from outside": GLASS,
    "glass from inside": replace(GLASS, eta=1 / 1.5),
    "thin glass": replace(GLASS, thin=True),
    "milky glass": replace(GLASS, diffuse=0.4, transmitted=0.5),
}
ANGLES = (0.0, 45.0, 80.0, 89.5)  # degrees
ROUGHNESSES = (0.1, 0.3, 0.6, 1.0)


class Functions:
    """The device's functions on arrays, directions as (n, 3)."""

    def __init__(self, device, program):
        self.device, self.program = device, program

    def evaluate(self, model: Model, out, into):
        """f |cos| (red) and density, float64."""
        n = len(into)
        arrays = [self.device.upload(a) for a in (model.record, _planes(out, n), _planes(into, n))]
        results = [self.device.empty((3, n), np.float32), self.device.empty(n, np.float32)]
        self.program["evaluate"](*arrays, *results, n, count=n)
        value, density = (r.get().astype(np.float64) for r in results)
        self.device.release(*arrays, *results)
        return value[0], density

    def sample(self, model: Model, out, random):
        """Directions (n, 3), weights (red) and densities, float64. random: (n, 3)."""
        n = len(random)
        arrays = [self.device.upload(a) for a in (model.record, _planes(out, n), _planes(random, n))]
        results = [self.device.empty(shape, np.float32) for shape in ((3, n), (3, n), (n,))]
        self.program["sample"](*arrays, *results, n, count=n)
        direction, weight, density = (r.get().astype(np.float64) for r in results)
        self.device.release(*arrays, *results)
        return direction.T, weight[0], density


def _planes(v, n):
    return np.broadcast_to(np.asarray(v, np.float32), (n, 3)).T.copy()


@pytest.fixture(scope="module")
def functions(device, tmp_path_factory):
    """Reflection and transmission compiled in."""
    folder = tmp_path_factory.mktemp("cl")
    return Functions(device, build(device, SOURCE, folder, HAS_SPECULAR=True, HAS_TRANSMISSION=True))


@pytest.fixture(scope="module")
def diffuse_functions(device, tmp_path_factory):
    """Neither compiled in."""
    folder = tmp_path_factory.mktemp("cl")
    return Functions(device, build(device, SOURCE, folder, HAS_SPECULAR=False, HAS_TRANSMISSION=False))


def random_numbers(n, seed):
    """(n, 3) as the sampler gives them: multiples of 2^-24 below 1; each column spread evenly."""
    u = (np.arange(n) + np.random.default_rng(seed).random((3, n))).T / n
    return np.floor(np.random.default_rng(seed + 1).permuted(u, axis=0) * 2**24) / 2**24


# Sampling


def sidak(parts):
    """The level of each of `parts` tests whose chance of any false alarm is SIGNIFICANCE."""
    return 1 - (1 - SIGNIFICANCE) ** (1 / parts)


def expected_shares(functions, model, out, rows=10, columns=16, fine=32):
    """The chance of each cell, reflected then transmitted, by integrating the device's density."""
    h, solid_angle, cell = microfacets(model, rows, columns, fine)
    shares = []
    for direction in (reflected, transmitted):
        into, jacobian, valid = direction(model, out, h)
        _, density = functions.evaluate(model, out, into)
        part = density[valid] * jacobian[valid] * solid_angle[valid]
        shares.append(np.bincount(cell[valid], part, rows * columns))
    if not model.transmitted:
        shares[1][:] = 0
    return np.concatenate(shares)


def observed_counts(model, out, into, density, rows=10, columns=16):
    """How many samples fell into each cell; the last count is of those that were absorbed."""
    lost = density == 0
    cell = cell_of(model, halfway(model, out, into[~lost]), rows, columns) + rows * columns * (into[~lost, 2] < 0)
    return np.append(np.bincount(cell, minlength=2 * rows * columns), lost.sum())


def chi_square(observed, expected):
    """The p-value; cells that expect fewer than five are one."""
    order = np.argsort(expected)
    observed, expected = observed[order], expected[order]
    rare = np.searchsorted(np.cumsum(expected), 5.0, side="left") + 1
    if expected[:rare].sum() > 0:
        observed = np.append(observed[rare:], observed[:rare].sum())
        expected = np.append(expected[rare:], expected[:rare].sum())
    else:
        assert observed[:rare].sum() == 0
        observed, expected = observed[rare:], expected[rare:]
    statistic = np.sum((observed - expected) ** 2 / expected)
    return stats.chi2.sf(statistic, len(expected) - 1)


@pytest.mark.parametrize("lobe", LOBES)
def test_samples_follow_the_density(functions, lobe):
    """Chi-square over directions, with one more cell for what is absorbed: so the density integrates to 1 less that part."""
    n, cases = 20_000, [(r, a) for r in ROUGHNESSES for a in ANGLES]
    level = sidak(len(cases) * len(LOBES))
    for seed, (roughness, degrees) in enumerate(cases):
        model, out = replace(LOBES[lobe], roughness=roughness), towards(degrees)
        shares = expected_shares(functions, model, out)
        assert shares.sum() <= 1 + 1e-3, (roughness, degrees)
        into, weight, density = functions.sample(model, out, np.random.default_rng(seed).random((n, 3)))
        assert (weight[density == 0] == 0).all()
        expected = n * np.append(shares, max(1 - shares.sum(), 0))
        assert chi_square(observed_counts(model, out, into, density), expected) > level, (roughness, degrees)


@pytest.mark.parametrize("lobe", LOBES)
def test_weight_is_value_over_density(functions, lobe):
    """And sampling returns the density that evaluation finds for the same direction, of unit length."""
    for degrees in ANGLES:
        for roughness in ROUGHNESSES:
            model, out = replace(LOBES[lobe], roughness=roughness), towards(degrees)
            into, weight, density = functions.sample(model, out, random_numbers(2000, 1))
            value, found = functions.evaluate(model, out, into)
            kept = density > 0
            np.testing.assert_array_equal(density[kept], found[kept])
            np.testing.assert_allclose(weight[kept], value[kept] / found[kept], rtol=1e-6)
            np.testing.assert_allclose(np.linalg.norm(into[kept], axis=1), 1, atol=1e-6)


# Values


@pytest.mark.parametrize("lobe", LOBES)
def test_values_against_float64(functions, lobe):
    """Directions anywhere, for which the half-vector is well conditioned: those of float32 differ by a few units of roundoff
    over alpha."""
    rng = np.random.default_rng(2)
    for roughness in (0.1, 0.3, 0.6, 1.0):
        model = replace(LOBES[lobe], roughness=roughness)
        for degrees in (0.0, 45.0, 80.0):
            out = towards(degrees).astype(np.float32).astype(np.float64)
            into = unit(rng.normal(size=(4000, 3))).astype(np.float32).astype(np.float64)
            into = into[np.abs(into[:, 2]) > 0.02]
            h = halfway(model, out, into)
            cosine = np.sum(h * into, axis=1)
            below = into[:, 2] < 0
            possible = np.where(below, (h @ out > 0) & ((cosine < 0) | model.thin) & (model.transmitted > 0), True)
            value, _ = functions.evaluate(model, out, into)
            known = np.where(possible, exact(model, out, into), 0.0)
            np.testing.assert_allclose(value, known, rtol=2e-4, atol=1e-6, err_msg=f"{roughness} {degrees}")


@pytest.mark.parametrize("lobe", LOBES)
def test_reciprocity(functions, lobe):
    """f(o, i) = f(i, o); through a refracting surface, f / eta^2 is what is the same both ways: radiance is compressed."""
    model = replace(LOBES[lobe], roughness=0.5)
    rng = np.random.default_rng(3)
    for _ in range(8):
        out, into = unit(np.abs(rng.normal(size=(2, 3))) * [1, 1, 1]), None
        out, into = out[0], out[1] * rng.choice([-1, 1], 3)
        there, _ = functions.evaluate(model, out, into[None])
        back_model, turn = model, np.ones(3)
        if into[2] < 0:
            turn = np.array([1, 1, -1])
            back_model = model if model.thin else replace(model, eta=1 / model.eta)
        back, _ = functions.evaluate(back_model, into * turn, (out * turn)[None])
        scale = 1 / model.eta**2 if into[2] < 0 and not model.thin else 1.0
        np.testing.assert_allclose(there / abs(into[2]), scale * back / out[2], rtol=2e-5, atol=1e-7)


@pytest.mark.parametrize("lobe", LOBES)
def test_white_furnace(functions, lobe):
    """The mean weight in a world of radiance 1 is the albedo, with what single scattering loses at rough surfaces, by
    quadrature in float64. Z-test. All flux counts alike: what comes from beyond a refracting surface, times eta^2.

    Metal and clear glass never give more than they get. glTF's mix of diffuse and specular does, at grazing angles: its
    diffuse part is lessened by the reflectance of each microfacet, which is small even where the mirror's is not.
    """
    n, cases = 20_000, [(r, a) for r in (0.1, 0.3, 0.6, 1.0) for a in (0.0, 45.0, 80.0)]
    limit = stats.norm.isf(sidak(len(cases) * len(LOBES)) / 2)
    for seed, (roughness, degrees) in enumerate(cases):
        model, out = replace(LOBES[lobe], roughness=roughness), towards(degrees)
        into, weight, _ = functions.sample(model, out, np.random.default_rng(100 + seed).random((n, 3)))
        flux = np.where((into[:, 2] < 0) & (not model.thin), weight * model.eta**2, weight)
        expected = albedo(model, out, 48)
        deviation = flux.std(ddof=1) / np.sqrt(n)
        assert abs(flux.mean() - expected) < limit * deviation + 2e-3 * expected, (roughness, degrees)
        if not model.diffuse:
            assert flux.mean() < max(model.f0, model.transmitted) * 1.0 + 0.06 + limit * deviation


def test_no_energy_is_made(functions):
    """White metal and white clear glass, from every angle: at most 1, and exactly 1 where smooth."""
    for model in (
        Model(f0=1.0),
        Model(transmitted=1.0),
        Model(transmitted=1.0, eta=1 / 1.5),
        Model(transmitted=1.0, thin=True),
    ):
        for roughness in (0.0, 0.05, 0.2, 0.5, 1.0):
            for degrees in (0.0, 30.0, 60.0, 80.0, 89.9):
                now = replace(model, roughness=roughness)
                into, weight, _ = functions.sample(now, towards(degrees), random_numbers(4000, 5))
                flux = np.where((into[:, 2] < 0) & (not model.thin), weight * model.eta**2, weight)
                assert flux.max() <= 1 + 2e-5, (model, roughness, degrees)  # each weight: a masking term
                if roughness == 0:
                    np.testing.assert_allclose(flux, 1, rtol=2e-5)


# Smooth surfaces


def fresnel_laws(cosine, eta):
    """Fresnel's equations as sines and tangents of the angles, for 0 < angle < critical."""
    a = np.arccos(cosine)
    b = np.arcsin(np.sin(a) / eta)
    return 0.5 * (np.sin(a - b) ** 2 / np.sin(a + b) ** 2 + np.tan(a - b) ** 2 / np.tan(a + b) ** 2)


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5, 2.4, 1 / 1.05])
def test_smooth_glass(functions, eta):
    """The share that is reflected is Fresnel's, the rest goes by Snell's law; all of it is reflected past the critical angle."""
    n = 4096
    for degrees in (5.0, 30.0, 41.0, 42.5, 60.0, 75.0, 85.0):
        out = towards(degrees)
        model = replace(GLASS, roughness=0.0, eta=eta, transmitted=1.0)
        pick = np.column_stack([(np.arange(n) + 0.5) / n, np.full((n, 2), 0.5)])
        into, weight, density = functions.sample(model, out, pick)
        assert np.isinf(density).all()
        above = into[:, 2] > 0
        sine = np.sin(np.radians(degrees)) / eta
        share = 1.0 if sine >= 1 else fresnel_laws(out[2], eta)
        assert above.mean() == pytest.approx(share, abs=1.5 / n)
        np.testing.assert_allclose(into[above], np.broadcast_to(out * [-1, -1, 1], (above.sum(), 3)), atol=2e-6)
        np.testing.assert_allclose(weight[above], 1, rtol=1e-5)
        if sine < 1:
            beyond = np.array([-out[0] / eta, -out[1] / eta, -np.sqrt(1 - sine**2)])
            np.testing.assert_allclose(into[~above], np.broadcast_to(beyond, (n - above.sum(), 3)), atol=2e-6)
            np.testing.assert_allclose(weight[~above], 1 / eta**2, rtol=1e-5)
        value, found = functions.evaluate(model, out, into)
        assert not value.any() and not found.any(), "no shadow ray finds a mirror"


def test_smooth_metal_and_window(functions):
    out = towards(50.0)
    into, weight, density = functions.sample(replace(METAL, roughness=0.0), out, random_numbers(100, 1))
    np.testing.assert_allclose(into, np.broadcast_to(out * [-1, -1, 1], (100, 3)), atol=1e-6)
    np.testing.assert_allclose(weight, 0.9 + 0.1 * (1 - out[2]) ** 5, rtol=1e-5)
    assert np.isinf(density).all()
    into, weight, _ = functions.sample(replace(GLASS, thin=True, roughness=0.0), out, random_numbers(4000, 1))
    through = into[:, 2] < 0
    np.testing.assert_allclose(into[through], np.broadcast_to(-out, (through.sum(), 3)), atol=1e-6)
    np.testing.assert_allclose(weight[through], 0.95, rtol=1e-5)
    assert through.mean() == pytest.approx(1 - fresnel_laws(out[2], 1.5), abs=1e-3)


def test_smooth_plastic_mixes_both(functions):
    """Above a diffuse body: the mirror by its reflectance, the body by the rest."""
    model, out = replace(PLASTIC, roughness=0.0), towards(70.0)
    into, weight, density = functions.sample(model, out, random_numbers(200_000, 1))
    mirror = np.isinf(density)
    reflectance = 0.04 + 0.96 * (1 - out[2]) ** 5
    np.testing.assert_allclose(np.where(mirror, weight, 0).mean(), reflectance, rtol=1e-3)
    np.testing.assert_allclose(into[mirror], np.broadcast_to(out * [-1, -1, 1], (mirror.sum(), 3)), atol=1e-6)
    fine = 512
    z, azimuth = np.meshgrid((np.arange(fine) + 0.5) / fine, (np.arange(fine) + 0.5) / fine * 2 * np.pi)
    r = np.sqrt(1 - z.ravel() ** 2)
    everywhere = np.column_stack([r * np.cos(azimuth.ravel()), r * np.sin(azimuth.ravel()), z.ravel()])
    body = np.mean((1 - fresnel(model, halfway(model, out, everywhere) @ out)) * 0.7 * 2 * everywhere[:, 2])
    assert np.where(mirror, 0, weight).mean() == pytest.approx(body, rel=1e-3)


@pytest.mark.parametrize("lobe", LOBES)
def test_smooth_and_almost_smooth_are_alike(functions, lobe):
    """On either side of the least alpha that has a lobe, mean weight and mean direction agree."""
    means = []
    for alpha in (0.999 * ALPHA_SMOOTH, 1.001 * ALPHA_SMOOTH):
        model = replace(LOBES[lobe], roughness=np.sqrt(alpha))
        into, weight, density = functions.sample(model, towards(40.0), random_numbers(100_000, 7))
        assert np.isinf(density).any() == (alpha < ALPHA_SMOOTH)
        means.append(np.append(np.mean(into * weight[:, None], axis=0), weight.mean()))
    np.testing.assert_allclose(means[0], means[1], atol=3e-3)


# Extremes


def test_no_extreme_gives_nonsense(functions):
    """Every lobe at the ends of its parameters, grazing included: weights finite and not negative, directions of unit length."""
    rng = np.random.default_rng(4)
    random = np.concatenate([random_numbers(2000, 3), rng.choice([0.0, 0.5, 1 - 2.0**-24], (200, 3))])
    for roughness in (0.0, 0.0316, 0.032, 0.5, 1.0):
        for thin in (False, True):
            for eta in (1.0, 1.0001, 1.0011, 1 / 1.0011, 1.5, 1 / 1.5, 3.0, 100.0):
                for diffuse, f0, clear in (
                    (0, 0, 0),
                    (1, 0, 0),
                    (1, 0.04, 0),
                    (0, 1, 0),
                    (0, 0, 1),
                    (0.5, 0.04, 0.5),
                ):
                    model = Model(diffuse, f0, 1.0, clear, roughness, eta, thin)
                    for z in (1.0, 1e-2, 1e-6):
                        out = np.array([np.sqrt(1 - z * z), 0, z])
                        into, weight, density = functions.sample(model, out, random)
                        assert np.isfinite(weight).all() and (weight >= 0).all(), (model, z)
                        assert not np.isnan(density).any() and (density >= 0).all(), (model, z)
                        np.testing.assert_allclose(np.linalg.norm(into, axis=1)[weight > 0], 1, atol=1e-5)


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("eta", [1.0, 1.0005, 1 / 1.0005])
def test_glass_without_a_boundary_is_not_there(functions, roughness, eta):
    """A refractive index like that of what is around it: light goes on as it came, and all of it."""
    for degrees in (0.0, 45.0, 80.0):
        out = towards(degrees)
        model = Model(transmitted=1.0, roughness=roughness, eta=eta)
        into, weight, _ = functions.sample(model, out, random_numbers(5000, 3))
        np.testing.assert_allclose(weight, 1, rtol=2e-3)
        through = into[into[:, 2] < 0]
        assert len(through) > 0.999 * len(into)
        np.testing.assert_allclose(through, np.broadcast_to(-out, through.shape), atol=4e-3)


# Diffuse only


def test_diffuse_alone(diffuse_functions):
    """What is left where no material has more: cosine-weighted directions, and their density."""
    n = 200_000
    into, weight, density = diffuse_functions.sample(Model(0.6), towards(30.0), random_numbers(n, 1))
    np.testing.assert_allclose(weight, 0.6, rtol=1e-6)
    np.testing.assert_allclose(density, into[:, 2] / np.pi, rtol=1e-6)
    square = np.floor(into[:, 2] ** 2 * 16).clip(0, 15) * 16 + np.arctan2(into[:, 1], into[:, 0]) // (np.pi / 8) % 16
    assert stats.chisquare(np.bincount(square.astype(int), minlength=256)).pvalue > 0.01
    value, found = diffuse_functions.evaluate(Model(0.6), towards(30.0), np.concatenate([into[:10], -into[:10]]))
    np.testing.assert_allclose(value, 0.6 * np.concatenate([into[:10, 2], np.zeros(10)]) / np.pi, rtol=1e-6)
    np.testing.assert_allclose(found * 0.6, value, rtol=1e-6)


def test_frames_are_orthonormal(functions):
    n, rng = 10_000, np.random.default_rng(6)
    normal = np.concatenate([unit(rng.normal(size=(n - 6, 3))), np.eye(3), -np.eye(3)]).T.astype(np.float32)
    arrays = [functions.device.upload(normal), *(functions.device.empty((3, n), np.float32) for _ in range(2))]
    functions.program["frame"](*arrays, n, count=n)
    axes = np.stack([a.get().T.astype(np.float64) for a in (arrays[1], arrays[2], arrays[0])], axis=1)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (n, 3, 3)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(axes), 1, atol=1e-6)
