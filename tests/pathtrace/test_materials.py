"""Materials in rendered scenes against closed forms: tiles of one plane, each of another material, seen from far away.

The plane sees nothing of itself, so that a tile's radiance is its albedo in a world of radiance 1, and one value of its
BSDF under a light of one direction.
"""

from dataclasses import replace

import numpy as np
import pytest
from microfacets import Model, albedo, dielectric, exact, fresnel, towards
from render_helpers import BLACK, WHITE, ball, grey, image, lit, shape_mesh, view

from clcache.scene.generators import plane
from clcache.scene.model import DirectionalLight, Environment, Material, PointLight, SpotLight

FAR = 2e4
ANGLE = 50.0  # of the view, degrees
PIXELS = 8  # of a tile, each way
NO_ROULETTE = {"pathtrace.roulette": 64}

MATERIALS = {
    "diffuse": Material("diffuse", (0.8, 0.5, 0.2)),
    "plastic": Material("plastic", (0.7, 0.5, 0.4), roughness=0.4, specular=1.0),
    "tinted": Material("tinted", (0.4, 0.4, 0.4), roughness=0.5, specular=0.6, specular_color=(1.0, 0.5, 0.0), ior=2.0),
    "metal": Material("metal", (1.0, 0.8, 0.3), metallic=1.0, roughness=0.3),
    "half metal": Material("half metal", (0.9, 0.6, 0.3), metallic=0.5, roughness=0.6, specular=1.0),
    "rough metal": Material("rough metal", (1.0, 0.9, 0.8), metallic=1.0, roughness=1.0),
    "glass": Material("glass", (1.0, 0.9, 0.8), roughness=0.4, specular=1.0, transmission=1.0, ior=1.4),
    "thin glass": Material("thin glass", (0.9, 0.9, 0.5), roughness=0.5, specular=1.0, transmission=1.0, thin=True),
    "milky": Material("milky", (0.8, 0.6, 0.4), roughness=0.6, specular=1.0, transmission=0.5),
}


def models(material):
    """The material as glTF maps it to the model, for each channel."""
    result = []
    for base, tint in zip(material.base_color, material.specular_color, strict=True):
        normal = min(((material.ior - 1) / (material.ior + 1)) ** 2 * tint, 1) * material.specular
        body = base * (1 - material.metallic)
        result.append(
            Model(
                body * (1 - material.transmission),
                normal + material.metallic * (base - normal),
                material.specular + material.metallic * (1 - material.specular),
                body * material.transmission,
                material.roughness,
                material.ior,
                material.thin,
            )
        )
    return result


def tiles(materials, **options):
    """The scene, and the size of an image that shows each tile by PIXELS x PIXELS pixels."""
    count = len(materials)
    meshes = [shape_mesh(plane((1.0, 1.0)), k) for k in range(count)]
    places = [np.column_stack([np.eye(3), [k - (count - 1) / 2, 0, 0]]) for k in range(count)]
    eye = FAR * towards(ANGLE, np.pi / 2)[[0, 2, 1]]
    height = np.cos(np.radians(ANGLE)) / FAR
    scene = lit(
        *meshes, camera=view(eye, (0, 0, 0), np.degrees(2 * np.arctan(height / 2))), materials=materials,
        instances=list(enumerate(places)), **options,
    )  # fmt: skip
    return scene, (round(count * PIXELS / np.cos(np.radians(ANGLE))), PIXELS)


def tile_means(color, count):
    """(count, 3): the mean of each tile, without its rim."""
    width = color.shape[1] / count
    return np.array(
        [color[1:-1, int(k * width) + 2 : int((k + 1) * width) - 2].mean(axis=(0, 1)) for k in range(count)]
    )


def furnace_albedos(materials):
    """(count, 3): of light that comes evenly from above and below; radiance, not flux, is what the far side gives."""
    out = towards(ANGLE, np.pi / 2)
    found = []
    for material in materials:
        row = []
        for model in models(material):
            total = albedo(model, out, 128)
            if model.transmitted and not model.thin:
                front = albedo(replace(model, transmitted=1e-12), out, 128)
                total = front + (total - front) / model.eta**2
            row.append(total)
        found.append(row)
    return np.array(found)


def enclosure():
    """A sphere about everything that shines inwards."""
    return ball(2 * FAR, 2, len(MATERIALS))


@pytest.fixture(scope="module")
def expected_albedos():
    return furnace_albedos(MATERIALS.values())


@pytest.mark.parametrize("light", ["constant", "picture", "enclosure"])
def test_furnace(light, expected_albedos):
    """Each material's mean within 0.5 % of its albedo by quadrature, whatever it is that shines evenly."""
    materials = list(MATERIALS.values())
    scene, size = tiles(materials)
    if light == "constant":
        scene = replace(scene, environment=Environment.constant(WHITE))
    elif light == "picture":
        scene = replace(scene, environment=Environment(np.ones((8, 16, 3), np.float32)))
    else:
        lamp = Material("lamp", BLACK, emission=WHITE)
        scene = replace(
            scene, materials=(*materials, lamp), meshes=(*scene.meshes, enclosure()),
            instances=(*scene.instances, replace(scene.instances[0], mesh=len(materials), transform=np.eye(4)[:3])),
        )  # fmt: skip
    found = tile_means(image(scene, size, 512, bounces=1, settings=NO_ROULETTE), len(materials))
    np.testing.assert_allclose(found, expected_albedos, rtol=5e-3)


@pytest.mark.parametrize("light", ["directional", "point", "spot"])
def test_one_direction(light):
    """f cos E in closed form, from above and, through what transmits, from below. Tolerance: a light at a distance of 20 km
    has another direction at each tile, to which refraction is the most sensitive."""
    materials = list(MATERIALS.values())
    out = towards(ANGLE, np.pi / 2)
    for into in (towards(35.0, -1.0), towards(60.0, -np.pi / 2), towards(40.0, -1.2) * [1, 1, -1]):
        world = into[[0, 2, 1]]  # the plane's normal is +Y
        irradiance = np.array([4.0, 2.0, 1.0])
        intensity = tuple(irradiance * FAR**2)
        lights = {
            "directional": DirectionalLight(tuple(-world), tuple(irradiance)),
            "point": PointLight(tuple(FAR * world), intensity),
            "spot": SpotLight(tuple(FAR * world), tuple(-world), intensity, 0.1, 0.2),
        }
        scene, size = tiles(materials, lights=[lights[light]])
        found = tile_means(image(scene, size, 2, bounces=0), len(materials))
        expected = np.zeros_like(found)
        for row, material in zip(expected, materials, strict=True):
            for channel, model in enumerate(models(material)):
                if into[2] > 0 or model.transmitted:
                    row[channel] = exact(model, out, into[None])[0] * irradiance[channel]
        np.testing.assert_allclose(found, expected, rtol=5e-3, atol=1e-6)


def test_spot_falls_off_between_its_angles():
    """KHR_lights_punctual: the square of a ramp in the cosine; full within the inner angle, dark outside the outer."""
    diffuse = [Material("diffuse", WHITE)]
    inner, outer = 0.3, 0.6
    for off in (0.0, 0.25, 0.35, 0.45, 0.59, 0.61, 1.5):
        axis = np.array([np.sin(off), -np.cos(off), 0.0])
        light = SpotLight((0, FAR, 0), tuple(axis), (np.pi * FAR**2,) * 3, inner, outer)
        scene, size = tiles(diffuse, lights=[light])
        ramp = np.clip((np.cos(off) - np.cos(outer)) / (np.cos(inner) - np.cos(outer)), 0, 1)
        np.testing.assert_allclose(tile_means(image(scene, size, 1, bounces=0), 1), ramp**2, rtol=1e-3, atol=1e-6)


# Mirrors and windows


def half_skies(above, below):
    """Radiance of the upper and of the lower half of the world."""
    picture = np.full((64, 4, 3), below, np.float32)
    picture[:32] = above
    return Environment(picture)


SMOOTH = {
    "metal": Material("metal", (0.9, 0.7, 0.5), metallic=1.0, roughness=0.0),
    "glass": Material("glass", (0.9, 0.7, 0.5), roughness=0.0, specular=1.0, transmission=1.0, ior=1.7),
    "window": Material("window", (0.9, 0.7, 0.5), roughness=0.0, specular=1.0, transmission=1.0, thin=True),
}


def test_mirror_and_window():
    """What the mirror shows is above, what the window shows below: Fresnel's shares of either, by 0.5 %."""
    materials = list(SMOOTH.values())
    scene, size = tiles(materials, environment=half_skies(2.0, 5.0))
    found = tile_means(image(scene, size, 512, bounces=1, settings=NO_ROULETTE), len(materials))
    out = towards(ANGLE)
    for row, material in zip(found, materials, strict=True):
        for channel, model in enumerate(models(material)):
            reflectance = fresnel(model, out[2])
            beyond = model.transmitted * (1 - reflectance) / (1 if model.thin else model.eta**2)
            assert row[channel] == pytest.approx(2 * reflectance + 5 * beyond, rel=5e-3), material.name


def test_what_a_mirror_shows_is_where_it_lies():
    """Sky by its direction: reflected at 50 degrees, refracted by Snell's law."""
    eta, picture = 1.7, np.zeros((180, 4, 3), np.float32)
    picture[:, :, 0] = np.arange(180)[:, None]  # radiance tells the angle from the zenith
    materials = [SMOOTH["metal"], replace(SMOOTH["glass"], base_color=WHITE)]
    scene, size = tiles(materials, environment=Environment(picture))
    found = tile_means(image(scene, size, 512, bounces=1, settings=NO_ROULETTE), 2)[:, 0]
    out = towards(ANGLE)
    metal = fresnel(models(materials[0])[0], out[2])
    assert found[0] / metal + 0.5 == pytest.approx(ANGLE, abs=0.3)
    share = dielectric(out[2], eta)
    refracted = 180 - np.degrees(np.arcsin(np.sin(np.radians(ANGLE)) / eta))
    assert found[1] == pytest.approx(share * (ANGLE - 0.5) + (1 - share) / eta**2 * (refracted - 0.5), rel=5e-3)


@pytest.mark.parametrize("ior", [1.0, 1.5])
def test_clear_ball_in_a_furnace_is_invisible(ior):
    """Smooth glass loses nothing, in however many bounces within the ball; its flat triangles leave some paths to go on for
    long, and what is cut off after 64 is what is missing."""
    clear = Material("clear", WHITE, roughness=0.0, specular=1.0, transmission=1.0, ior=ior)
    scene = lit(ball(1, 3), camera=view((0, 0, 4), (0, 0, 0), 30), materials=[clear], environment=WHITE)
    color = image(scene, (16, 16), 16, bounces=64, settings=NO_ROULETTE)
    assert color.mean() == pytest.approx(1, abs=5e-3)
    assert color.max() <= 1.1  # what enters at one facet and leaves at another carries 1 / eta^2 eta^2


def test_the_back_of_a_single_sided_surface_is_black():
    """Except of what transmits."""
    one_sided = [replace(m, double_sided=False) for m in (grey(0.8), MATERIALS["metal"], SMOOTH["window"])]
    scene, size = tiles(one_sided, environment=Environment.constant(WHITE))
    eye = scene.camera.transform[:, 3] * [1, -1, 1]
    below = replace(scene, camera=view(eye, (0, 0, 0), np.degrees(scene.camera.fov_y)))
    found = tile_means(image(below, size, 64, bounces=1, settings=NO_ROULETTE), 3)
    assert (found[0] == 0).all() and found[2].min() > 0.4
    assert found[1].max() < 0.1  # a metal's f90 is all that is left of it


def test_diffuse_is_the_same_beside_specular():
    """A diffuse tile renders alike in a scene with and without other lobes compiled in."""
    plain, size = tiles([MATERIALS["diffuse"]] * 2, environment=Environment.constant(WHITE))
    mixed, _ = tiles([MATERIALS["diffuse"], MATERIALS["glass"]], environment=Environment.constant(WHITE))
    found = [tile_means(image(s, size, 16, bounces=1, settings=NO_ROULETTE), 2)[0] for s in (plain, mixed)]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-5)
