"""Scenes whose radiance is known in closed form for every number of bounces, and what must not change it."""

import numpy as np
import pytest
from helpers import cube, icosphere
from render_helpers import MODELLED, WHITE, ball, grey, image, lit, render, view, z_of_mean

from clcache.scene.model import Material, PointLight

NO_ROULETTE = {"pathtrace.roulette": 64}
INSIDE = view((0.1, 0.05, 0.2), (0.5, 0.3, -1), 70)


def series(albedo, bounces: int):
    """1 + a + ... + a^bounces"""
    return np.sum(np.asarray(albedo, float)[..., None] ** np.arange(bounces + 1), axis=-1)


@pytest.mark.parametrize("bounces", [0, 1, 3, 8])
@pytest.mark.parametrize("albedo", [0.0, 0.5, 1.0])
def test_closed_emissive_sphere(albedo, bounces):
    """Every surface that a path meets, and the one that its last ray meets, emits the same, whichever ray finds it: the mean
    over all paths by Z-test, and within 0.5 % besides."""
    emission = 0.7
    scene = lit(icosphere(2), camera=INSIDE, materials=[grey(albedo, emission)])
    color = image(scene, (48, 36), 16, bounces=bounces, settings=NO_ROULETTE, sampler=MODELLED)
    expected = emission * series(albedo, bounces + 1)
    np.testing.assert_allclose(color.mean(), expected, rtol=5e-3)
    assert (z_of_mean(color, expected) < 3.3).all()


def test_furnace_has_no_shape():
    """The same in a closed box with corners, by emission alone: no path leaves it, none is lost in a corner. Everything
    outside shines so brightly that a single path that left would show."""
    scene = lit(cube(), camera=INSIDE, materials=[grey(0.9, 1.0)], environment=(1e7,) * 3)
    frame = render(scene, (48, 36), 16, bounces=20, settings=NO_ROULETTE, sampler=MODELLED)
    expected = series(0.9, 21)
    np.testing.assert_allclose(frame.color["mono"].mean(), expected, rtol=5e-3)
    assert (z_of_mean(frame.color["mono"], expected) < 3.3).all()
    assert frame.stats["eyes"]["mono"]["rays"]["secondary"] == 48 * 36 * 16 * 21


@pytest.mark.parametrize("first", [1, 2, 5])
def test_roulette_is_unbiased(first):
    """Z-test of each channel's mean over all paths against the closed form; fixed seeds."""
    albedo, bounces, spp = (0.9, 0.5, 0.2), 6, 128
    scene = lit(icosphere(1), camera=INSIDE, materials=[Material("m", albedo, emission=WHITE)])
    settings = {"pathtrace.roulette": first}
    frame = render(scene, (32, 32), spp, bounces=bounces, settings=settings, seed=first, sampler=MODELLED)
    rays = frame.stats["eyes"]["mono"]["rays"]
    assert rays["secondary"] < 0.95 * (bounces + 1) * rays["primary"], "few paths ended: the roulette did not play"
    assert (z_of_mean(frame.color["mono"], series(albedo, bounces + 1)) < 3.3).all()


def test_roulette_ends_paths():
    scene = lit(icosphere(1), camera=INSIDE, materials=[grey(0.5, 1.0)])
    rays = [
        render(scene, (32, 32), 16, bounces=6, settings={"pathtrace.roulette": first}).stats["eyes"]["mono"]["rays"]
        for first in (1, 64)
    ]
    paths = 32 * 32 * 16
    assert rays[1]["secondary"] == 7 * paths
    # Survival 0.5, each path anew: 1/2 + 1/4 + ... + 1/128 rays; 5 sigma of a variance below 2 for each path.
    assert abs(rays[0]["secondary"] - paths * (1 - 0.5**7)) < 5 * np.sqrt(2 * paths)


def test_roulette_where_nothing_is_lost():
    """Albedo 1: paths end all the same, and what goes on makes up for them."""
    scene = lit(icosphere(1), camera=INSIDE, materials=[grey(1.0, 1.0)])
    color = image(scene, (32, 32), 64, bounces=4, settings={"pathtrace.roulette": 1}, sampler=MODELLED)
    assert (z_of_mean(color, 6) < 3.3).all()


@pytest.mark.parametrize("smooth", [False, True])
def test_white_object_is_invisible_in_a_constant_environment(smooth):
    sky = (0.3, 1.0, 2.5)
    scene = lit(ball(1, 4, smooth=smooth), camera=view((0, 0, 4), (0, 0, 0)), environment=sky)
    color = image(scene, (32, 32), 4)
    at_rim = np.abs(color / np.float32(sky) - 1).max(axis=2) > 1e-6
    # A smooth normal tips some directions below the triangle, where there is no light: an error of the shading, at any pixel.
    assert at_rim.mean() < (0.02 if smooth else 1e-9)
    assert color[16, 16] == pytest.approx(sky, rel=1e-6)


def test_convex_object_of_any_albedo_in_a_constant_environment():
    scene = lit(ball(1, 3), camera=view((0, 0, 3), (0, 0, 0), 20), materials=[grey(0.37)], environment=WHITE)
    np.testing.assert_allclose(image(scene, (16, 16), 8, settings=NO_ROULETTE), 0.37, rtol=1e-5)


@pytest.mark.parametrize("bounces", [0, 1, 2, 5])
def test_point_light_in_the_centre_of_a_sphere(bounces):
    """The irradiance is I / R^2 everywhere, and so every bounce brings `albedo` times what the one before it brought.

    Tolerance: triangles of a fourfold subdivision lie up to 0.1 % within the sphere; 0.5 % for noise besides.
    """
    albedo, radius, intensity = 0.6, 2.0, 8.0
    light = PointLight((0, 0, 0), (intensity,) * 3)
    scene = lit(ball(radius, 4), camera=INSIDE, materials=[grey(albedo)], lights=[light])
    color = image(scene, (24, 24), 16, bounces=bounces, settings=NO_ROULETTE)
    expected = albedo * intensity / radius**2 / np.pi * series(albedo, bounces)
    np.testing.assert_allclose(color, expected, rtol=5e-3)


def test_energy_is_conserved():
    """However often light is reflected, a scene of albedo 1 without emission never shines brighter than its environment."""
    scene = lit(
        cube(), ball(0.5, 2), camera=view((0, 0.3, 0.9), (0, 0, 0), 80), environment=WHITE,
        instances=[(0, np.array([[1.0, 0, 0, 0.9], [0, 1, 0, 0], [0, 0, 1, -1.5]])), (1, np.eye(4)[:3])],
    )  # fmt: skip
    color = image(scene, (32, 32), 16, bounces=16, settings=NO_ROULETTE)
    assert color.max() <= 1 + 1e-6
    assert color.mean() > 0.9
