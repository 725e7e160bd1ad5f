"""Materials, lights and textures at the ends of what they can be: finite, not negative, and right where an answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import moved
from render_helpers import BLACK, WHITE, ball, floor, grey, image, lit, shape_mesh, view

from clcache.scene.generators import plane
from clcache.scene.model import DirectionalLight, Environment, Material, PointLight, Texture, TextureUse

SIZE = (20, 14)
LONG = {"pathtrace.roulette": 64}


def still_life(material, scale=1.0, **options):
    """A ball of the material on a floor, a lamp above, a light and a sky with a bright pixel."""
    sky = np.full((4, 8, 3), 0.3, np.float32)
    sky[1, 5] = 20
    lamp = shape_mesh(plane((1.0, 1.0)), 2)
    places = ([0, 0, 0], [0, 0.7, 0], [0, 3, 0])
    turned = (np.eye(3), np.eye(3), np.diag([1.0, -1, 1]))
    meshes = [floor(8), ball(0.7, 2, 1, smooth=True), lamp]
    instances = [
        (k, np.column_stack([scale * t, scale * np.array(p)]))
        for k, (t, p) in enumerate(zip(turned, places, strict=True))
    ]
    eye = np.array([0.0, 2.0, 4.0]) * scale
    return lit(
        *meshes, camera=view(eye, (0, 0.5 * scale, 0)), materials=[grey(0.5), material, grey(0.0, 4.0)],
        lights=[PointLight((2 * scale, 2 * scale, scale), (10 * scale**2,) * 3)], environment=Environment(sky),
        instances=instances, **options,
    )  # fmt: skip


def checked(color):
    """The image, after seeing that nothing in it is nonsense."""
    assert np.isfinite(color).all() and (color >= 0).all()
    return color


@pytest.mark.parametrize("roughness", [0.0, 0.03, 0.0317, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("base", [BLACK, WHITE])
def test_reflection(roughness, metallic, base):
    material = Material("m", base, roughness=roughness, metallic=metallic, specular=1.0)
    assert checked(image(still_life(material), SIZE, 4)).max() > 0.1


@pytest.mark.parametrize("ior", [1.0, 1.5, 100.0])
@pytest.mark.parametrize(("roughness", "thin"), [(0.0, False), (0.5, False), (1.0, False), (0.5, True)])
def test_transmission(roughness, thin, ior):
    material = Material("m", WHITE, roughness=roughness, specular=1.0, transmission=1.0, thin=thin, ior=ior)
    color = checked(image(still_life(material), SIZE, 4, bounces=6))
    if ior == 1.0 and not thin:  # not there
        gone = still_life(material)
        gone = replace(gone, instances=(gone.instances[0], gone.instances[2]))
        expected = image(gone, SIZE, 64, bounces=6)
        assert checked(image(still_life(material), SIZE, 64, bounces=8)).mean() == pytest.approx(
            expected.mean(), rel=0.05
        )
    assert color.max() > 0.1


def test_furnace_of_white_metal_at_grazing_angles():
    """Along a mirror from edge to edge, and almost so: never brighter than what shines."""
    for roughness in (0.0, 0.2, 1.0):
        for height in (1.0, 1e-2, 1e-4):
            scene = lit(
                floor(100), camera=view((40, height, 0), (0, 0, 0), 2), environment=WHITE,
                materials=[Material("m", WHITE, metallic=1.0, roughness=roughness)],
            )  # fmt: skip
            color = checked(image(scene, (8, 8), 16, bounces=2, settings=LONG))
            assert color.max() <= 1 + 1e-3 * (roughness == 0) + 0.02, (roughness, height)


def test_strong_lamp_beside_a_weak_one():
    """The same of emissive triangles; each in a closed room of its own, whose walls reflect it."""
    rooms = [ball(1, 2), ball(1, 2, 1)]
    for x, emission in ((-2.0, 1e8), (2.0, 1e-8)):
        scene = lit(
            *rooms, camera=view((x, 0, 0), (x, 0.3, 1), 50), materials=[grey(0.5, 1e8), grey(0.5, 1e-8)],
            instances=[(0, np.column_stack([np.eye(3), [-2.0, 0, 0]])), (1, np.column_stack([np.eye(3), [2.0, 0, 0]]))],
        )  # fmt: skip
        color = checked(image(scene, (8, 8), 16, bounces=2, settings=LONG))
        assert color.mean() == pytest.approx(emission * (1 + 0.5 + 0.25 + 0.125), rel=0.02)


def speckled(width, height, **options):
    pixels = np.random.default_rng(3).integers(0, 256, (height, width, 4), dtype=np.uint8)
    return Texture("speckled", pixels, **options)


def textured(texture, uvs_scale=1.0, **material):
    """A floor whose every map is this picture."""
    use = TextureUse(0)
    everything = Material(
        "m", WHITE, base_color_texture=use, metallic=1.0, roughness=1.0, metallic_roughness_texture=use, specular=1.0,
        normal_texture=use, emission=(0.1, 0.1, 0.1), emission_texture=use, **material,
    )  # fmt: skip
    mesh = floor(6)
    mesh = replace(mesh, uvs=(mesh.uvs * np.float32(uvs_scale)).astype(np.float32))
    sun = DirectionalLight((0.6, -0.8, 0.0), (3.0, 3.0, 3.0))
    return lit(
        mesh, ball(0.5, 2, smooth=True), camera=view((0, 2, 4), (0, 0, 0)), materials=[everything], textures=[texture],
        lights=[sun], environment=(0.2, 0.2, 0.2),
    )  # fmt: skip


@pytest.mark.parametrize("scale", [1e7, -1e7, -3.0, 1e-7, 0.0, 3e38])
def test_coordinates_of_any_size(scale):
    """Far beyond where float32 has fractions, with mip levels and normal maps."""
    checked(image(textured(speckled(16, 16), scale), SIZE, 2))


@pytest.mark.parametrize("size", [(1, 1), (1, 64), (3, 5), (2048, 1)])
def test_pictures_of_any_size(size):
    checked(image(textured(speckled(*size)), SIZE, 2))


def test_half_black_pictures():
    """Roughness 0, metallic 0, no normal and no light in one half; 1 in the other."""
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[:, :2] = 0
    checked(image(textured(Texture("half", pixels, srgb=False)), SIZE, 8))
    checked(image(textured(Texture("half", pixels, srgb=False), alpha_cutoff=0.5), SIZE, 8))
    checked(image(textured(Texture("black", pixels[:, :2].copy(), srgb=False)), SIZE, 8))


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scale_changes_nothing(scale):
    """A glass ball, a lamp and a sky a million times smaller or larger, lights scaled alike: the same image."""
    glass = Material("glass", WHITE, roughness=0.2, specular=1.0, transmission=1.0)
    options = {"bounces": 6}
    expected = image(still_life(glass), SIZE, 64, **options)
    found = checked(image(still_life(glass, scale), SIZE, 64, **options))
    differing = np.abs(found - expected).max(axis=2) > 1e-2 * (1 + expected.max(axis=2))
    assert differing.mean() < 0.1, "but for single paths"
    assert found.mean() == pytest.approx(expected.mean(), rel=0.02)


def test_lamps_of_a_nanometre():
    """The areas of triangles far below what float32's squares can hold: they shine as large ones do."""
    means = []
    for scale in (1.0, 1e-9):
        lamp = moved(shape_mesh(plane((1.0, 1.0)), 0), scale, (0, scale, 0))
        lamp = replace(lamp, material=np.ones(2, np.uint32))
        scene = lit(
            moved(floor(1), scale), lamp, camera=view((0, 0.9 * scale, 0.01 * scale), (0, 0, 0), 40),
            materials=[grey(0.6), grey(0.0, 1.0)],
        )  # fmt: skip
        means.append(checked(image(scene, (8, 8), 64, bounces=0)).mean())
    assert means[1] == pytest.approx(means[0], rel=0.01)
