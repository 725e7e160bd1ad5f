"""Levels of detail: which one a ray cone asks for, told by pictures whose mip levels are grey by their number."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import IDENTITY, make_mesh
from kernel_source import build
from render_helpers import BLACK, WHITE, ball, image, lit, render, view

from clcache import resources
from clcache.scene.model import Camera, Material, Mesh, Texture, TextureUse
from clcache.scene.textures import encode_srgb, mip_chain, srgb_to_linear

STEP = 16  # of grey from level to level
MIRROR = Material("mirror", WHITE, metallic=1.0, roughness=0.0)


@pytest.fixture
def numbered(monkeypatch):
    """Every picture's levels are grey by their number."""

    def levels(texture):
        return [np.full_like(level, STEP * k) for k, level in enumerate(mip_chain(texture))]

    monkeypatch.setattr(resources, "mip_chain", levels)


def picture(width=256, height=256):
    return Texture("picture", np.zeros((height, width, 4), np.uint8), srgb=False)


def level(color):
    """Of what was seen."""
    return np.asarray(color, np.float64) * 255 / STEP


def wall(side=1000.0, turns=1.0) -> Mesh:
    """A square that faces +Z, over which the picture is repeated so many times each way."""
    h = side / 2
    mesh = make_mesh([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]], [[0, 1, 2], [0, 2, 3]])
    return replace(mesh, uvs=np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32) * turns)


def cone(camera: Camera, rows):
    """The angle of a pixel, as tan of half the view makes it."""
    return 2 * np.tan(camera.fov_y / 2) / rows


def middle(aov):
    return aov[aov.shape[0] // 2, aov.shape[1] // 2]


@pytest.mark.parametrize("distance", [1.0, 3.0, 20.0, 100.0, 400.0])
@pytest.mark.parametrize(("width", "height"), [(256, 256), (64, 16), (512, 1)])
def test_level_on_a_plane(numbered, distance, width, height):
    """log2 of the texels that a pixel's cone is wide: of the geometric mean of the picture's sides."""
    camera, turns, side, size = view((0, 0, distance), (0, 0, 0), 20), 400, 1000.0, (33, 33)
    use = Material("m", WHITE, base_color_texture=TextureUse(0))
    scene = lit(wall(side, turns), camera=camera, materials=[use], textures=[picture(width, height)])
    found = level(middle(render(scene, size, 1, bounces=0, aovs=("albedo",)).aov("albedo", "mono")))
    texels = cone(camera, size[1]) * distance * turns / side * np.sqrt(width * height)
    expected = np.clip(np.log2(texels), 0, np.log2(max(width, height)))
    np.testing.assert_allclose(found, expected, atol=0.01)


def test_scale_of_instances_and_coordinates_counts(numbered):
    """A wall twice as large has half the texels; a transform of the coordinates, its own; rows and columns of pixels."""
    camera, size = view((0, 0, 50), (0, 0, 0), 20), (21, 33)
    larger = np.column_stack([4 * np.eye(3), np.zeros(3)])
    use = TextureUse(0, (2.0, 0.0, 0.0, 0.0, 8.0, 0.0))
    scene = lit(
        wall(1000, 100), camera=camera, materials=[Material("m", WHITE, base_color_texture=use)], textures=[picture()],
        instances=[(0, larger)],
    )  # fmt: skip
    found = level(middle(render(scene, size, 1, bounces=0, aovs=("albedo",)).aov("albedo", "mono")))
    texels = cone(camera, 33) * 50 * 100 / 4000 * 256 * np.sqrt(2 * 8)
    np.testing.assert_allclose(found, np.log2(texels), atol=0.01)


@pytest.mark.parametrize("degrees", [0.0, 60.0, 85.0, 89.9])
def test_oblique_view(numbered, degrees):
    """It is the cone's width across the ray that counts: detail along the plane is kept at grazing angles, none is without
    bounds."""
    angle = np.radians(degrees)
    camera = view((10 * np.sin(angle), 0, 10 * np.cos(angle)), (0, 0, 0), 2)
    scene = lit(
        wall(1000, 4000),
        camera=camera,
        materials=[Material("m", WHITE, base_color_texture=TextureUse(0))],
        textures=[picture()],
    )
    found = level(render(scene, (9, 9), 16, bounces=0, aovs=("albedo",)).aov("albedo", "mono")[4, 4])
    expected = np.log2(cone(camera, 9) * 10 * 4000 / 1000 * 256)
    np.testing.assert_allclose(found, expected, atol=0.02 if degrees < 89 else 0.5)


def seen_in_mirror(mirror, place, back, size=17, **options):
    """The level at which a shining wall behind the camera is seen in a mirror at the origin; the cone's angle."""
    camera = view((0, 0, 10), (0, 0, 0), 4)
    lamp = Material("lamp", BLACK, emission=WHITE, emission_texture=TextureUse(0))
    turned = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, back]])
    scene = lit(
        mirror, replace(wall(4000, 1000), material=np.ones(2, np.uint32)), camera=camera, materials=[MIRROR, lamp],
        textures=[picture(1024, 1024)], instances=[(0, place), (1, turned)],
    )  # fmt: skip
    color = image(scene, (size, size), 4, bounces=1, settings={"pathtrace.roulette": 64}, **options)
    return level(middle(color)), cone(camera, size)


def test_level_in_a_flat_mirror(numbered):
    """The cone goes on: the whole way counts."""
    found, angle = seen_in_mirror(replace(wall(1), uvs=None), IDENTITY, 100.0)
    np.testing.assert_allclose(found, np.log2(angle * 110 * 1000 / 4000 * 1024), atol=0.02)


@pytest.mark.parametrize("radius", [20.0, 5.0])
def test_level_in_a_round_mirror(numbered, radius):
    """A convex mirror of radius r spreads a cone of width w by 2 w / r. Tolerance: triangles, whose normals turn evenly only
    on the whole."""
    place = IDENTITY - [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, radius]]
    found, angle = seen_in_mirror(ball(radius, 5, smooth=True), place, 100.0)
    width = 10 * angle
    expected = np.log2((width + (angle + 2 * width / radius) * 100) * 1000 / 4000 * 1024)
    np.testing.assert_allclose(found, expected, atol=0.15)
    assert found[0] > np.log2(angle * 110 * 1000 / 4000 * 1024) + 0.3


SPREAD = """
#include "pathtrace/shade.cl"

__kernel void spreads(
    __global const float *alpha,  // (n)
    __global float *spread,       // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) spread[i] = rough_spread(alpha[i]);
}
"""


def test_rough_reflection_widens_the_cone(device, tmp_path):
    """2 sqrt(alpha^2 / (2 - 2 alpha^2)) (MaterialMemo, Eq. 2.11), which has no bounds at alpha = 1: clamped to a radian."""
    names = (
        "NORMALS",
        "TEXTURES",
        "ALPHA",
        "BASE_COLOR_MAPS",
        "METALLIC_ROUGHNESS_MAPS",
        "EMISSION_MAPS",
        "NORMAL_MAPS",
        "TRANSMISSION",
        "EMISSIVE",
        "EMISSION",
        "SKY_PICTURE",
        "DIRECT",
        "PUNCTUAL",
        "LAMP_HOLES",
    )
    program = build(
        device, SPREAD, tmp_path, SOBOL=False, EMITTER_STEPS=0, HAS_SPECULAR=True, **{f"HAS_{n}": False for n in names}
    )
    alpha = np.append(np.linspace(0, 1, 1001), [1 - 2.0**-24, 1e-20]).astype(np.float32)
    spread = device.empty(len(alpha), np.float32)
    program["spreads"](device.upload(alpha), spread, len(alpha), count=len(alpha))
    with np.errstate(divide="ignore"):
        exact = 2 * np.sqrt(alpha.astype(float) ** 2 / (2 - 2 * alpha.astype(float) ** 2))
    np.testing.assert_allclose(spread.get(), np.minimum(exact, 1), rtol=1e-4, atol=1e-19)


@pytest.mark.parametrize("roughness", [0.0, 0.5, 1.0])
def test_bounces_see_finite_levels(roughness):
    """A bounce off any roughness at any angle reads some mixture of a picture's texels."""
    floor_mesh = wall(100, 1e5)
    material = Material("m", WHITE, base_color_texture=TextureUse(0), roughness=roughness, metallic=0.5, specular=1.0)
    noise = Texture("noise", np.random.default_rng(1).integers(100, 200, (64, 64, 4), dtype=np.uint8), srgb=False)
    scene = lit(
        floor_mesh, ball(1, 2, smooth=True), camera=view((5, 0, 0.5), (0, 0, 0.5)), materials=[material], textures=[noise],
        environment=WHITE,
    )  # fmt: skip
    color = image(scene, (24, 16), 4, bounces=4)
    assert np.isfinite(color).all() and color.min() >= 0 and color.mean() > 0.3


# What the levels are for


def checkerboard():
    pixels = np.full((256, 256, 4), 255, np.uint8)
    pixels[..., :3] = (255 * (np.indices((256, 256)).sum(axis=0) % 2))[..., None]
    return Texture("checkerboard", pixels)


def test_far_checkerboard_is_grey(monkeypatch):
    """At a single sample, far detail converges to its mean in linear light; without levels it is noise."""
    camera = view((0, 3, 30), (0, 0, -30), 30)
    mesh = wall(400, 400)
    flat = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]])
    scene = lit(
        mesh, camera=camera, materials=[Material("m", WHITE, base_color_texture=TextureUse(0))], textures=[checkerboard()],
        instances=[(0, flat)],
    )  # fmt: skip
    images = []
    for levels in (mip_chain, lambda texture: [texture.pixels]):
        monkeypatch.setattr(resources, "mip_chain", levels)
        albedo = render(scene, (32, 32), 1, bounces=0, aovs=("albedo",)).aov("albedo", "mono")[16:, :, 0]
        images.append(albedo)
    assert images[0].mean() == pytest.approx(0.5, abs=0.01)
    assert images[0].std() < 0.05 * images[1].std()


def area_weights(size):
    """(max(size // 2, 1), size): how much of each texel the half-size picture's texels cover."""
    target = max(size // 2, 1)
    edges = np.arange(target + 1) * size / target
    low = np.maximum(edges[:-1, None], np.arange(size))
    high = np.minimum(edges[1:, None], np.arange(size) + 1)
    covered = np.maximum(high - low, 0)
    return covered / covered.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("srgb", [True, False])
@pytest.mark.parametrize("size", [(8, 8), (16, 4), (7, 5), (1, 9), (1, 1), (3, 1), (6, 10)])
def test_levels_are_area_averages(size, srgb):
    """In linear light, alpha as it is; to the nearest of the 256 values, from unrounded levels."""
    width, height = size
    pixels = np.random.default_rng(2).integers(0, 256, (height, width, 4), dtype=np.uint8)
    chain = mip_chain(Texture("t", pixels, srgb=srgb))
    np.testing.assert_array_equal(chain[0], pixels)
    values = pixels / 255
    if srgb:
        values[..., :3] = srgb_to_linear(values[..., :3])
    for found in chain[1:]:
        rows, columns = area_weights(values.shape[0]), area_weights(values.shape[1])
        values = np.einsum("ij,jkc,lk->ilc", rows, values, columns)
        encoded = values.copy()
        if srgb:
            encoded[..., :3] = encode_srgb(encoded[..., :3])
        assert found.shape == values.shape and found.dtype == np.uint8
        assert np.abs(found - 255 * encoded).max() <= 0.501
    assert chain[-1].shape == (1, 1, 4)
