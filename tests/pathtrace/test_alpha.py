"""Surfaces with holes: camera rays, shadow rays and bounces pass where there is no surface, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import IDENTITY
from render_helpers import BLACK, MODELLED, WHITE, camera_rays, floor, grey, image, lit, render, shape_mesh, view

from clcache.scene.generators import plane
from clcache.scene.model import WRAP_MODES, DirectionalLight, Environment, Material, Mesh, Texture, TextureUse

TOP = view((0, 4, 0), (0, 0, 0), 40, up=(0, 0, -1))
SIZE = (40, 40)


def holes(alpha, wrap=("clamp", "clamp")):
    """A white texture whose texels have these alphas. alpha: (h, w) of 0 .. 255."""
    alpha = np.asarray(alpha, np.uint8)
    pixels = np.full((*alpha.shape, 4), 255, np.uint8)
    pixels[..., 3] = alpha
    return Texture("holes", pixels, wrap=wrap)


def sheet(side=2.0, turns=1.0, material=0) -> Mesh:
    """A horizontal square; u to the right, v towards the camera's lower edge, each over so many turns from -turns / 2."""
    mesh = shape_mesh(plane((side, side)), material)
    return replace(mesh, uvs=(mesh.positions[:, [0, 2]] / side * turns).astype(np.float32))


def masked(**options):
    return Material("masked", WHITE, base_color_texture=TextureUse(0), alpha_cutoff=0.5, **options)


def raised(height):
    return IDENTITY + [[0, 0, 0, 0], [0, 0, 0, height], [0, 0, 0, 0]]


def texture_alpha(texture: Texture, uv):
    """(n,): bilinear alpha in [0, 1], in float64."""
    height, width = texture.pixels.shape[:2]

    def wrapped(place, size, mode):
        if mode == "clamp":
            return np.clip(place, 0, size - 1)
        place = np.mod(place, size if mode == "repeat" else 2 * size)
        return np.where(place < size, place, 2 * size - 1 - place)

    uv = np.where(np.array(texture.wrap) == "clamp", np.clip(uv, 0, 1), uv)
    x, y = (uv * [width, height] - 0.5).T
    left, top = np.floor(x), np.floor(y)
    total = np.zeros(len(uv))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - (x - left)) * np.abs(1 - dy - (y - top))
            column = wrapped(left + dx, width, texture.wrap[0]).astype(int)
            total += weight * texture.pixels[wrapped(top + dy, height, texture.wrap[1]).astype(int), column, 3] / 255
    return total


@pytest.mark.parametrize("wrap", WRAP_MODES)
def test_camera_rays_pass_through_holes(wrap):
    """A sheet over two and a half turns of a random alpha: hit exactly where the filtered alpha is not below the cutoff."""
    texture = holes(np.random.default_rng(1).integers(0, 256, (4, 5)), (wrap, wrap))
    scene = lit(sheet(turns=2.5), camera=TOP, materials=[masked()], textures=[texture], environment=WHITE)
    depth = render(scene, SIZE, 1, bounces=0, sampler=MODELLED, aovs=("Z",)).aov("Z", "mono")
    origin, directions = camera_rays(TOP, SIZE)
    place = (origin - directions * (origin[1] / directions[..., 1:2]))[..., [0, 2]].reshape(-1, 2)
    alpha = texture_alpha(texture, place / 2 * 2.5)
    inside, clear = np.abs(place).max(axis=1) < 0.999, np.abs(alpha - 0.5) > 1e-4
    hit = np.isfinite(depth.ravel())
    np.testing.assert_array_equal(hit[inside & clear], alpha[inside & clear] > 0.5)
    assert 0.2 < hit[inside].mean() < 0.8
    assert not hit[np.abs(place).max(axis=1) > 1.001].any()


def checkers():
    """Half of the texels are holes; large ones, so that their rims are few."""
    return holes(np.kron(np.indices((4, 4)).sum(axis=0) % 2, np.full((16, 16), 255)), ("repeat", "repeat"))


def test_shadow_rays_pass_through_holes():
    """The sun casts the sheet's pattern on a floor, in its place."""
    down = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
    scene = lit(
        floor(8), sheet(material=1), camera=view((0, 0.4, 0), (0, 0, 0), 100, up=(0, 0, -1)), lights=[down],
        materials=[grey(1.0), masked()], textures=[checkers()], instances=[(0, IDENTITY), (1, raised(0.5))],
    )  # fmt: skip
    color = image(scene, SIZE, 1, bounces=0, sampler=MODELLED)[..., 0]
    origin, directions = camera_rays(scene.camera, SIZE)
    place = (origin - directions * (origin[1] / directions[..., 1:2]))[..., [0, 2]].reshape(-1, 2)
    alpha = texture_alpha(checkers(), place / 2)
    under, clear = np.abs(place).max(axis=1) < 0.999, np.abs(alpha - 0.5) > 1e-3
    expected = np.where(under & (alpha > 0.5), 0.0, 1.0)
    np.testing.assert_allclose(color.ravel()[clear], expected[clear], rtol=1e-5)
    assert 0.2 < expected.mean() < 0.8


def test_bounces_pass_through_holes():
    """Below a wide sheet of which nothing is left the furnace is as if it were not there; below one that is whole, dark."""
    colors = {}
    for name, alpha in (("gone", 0), ("whole", 255)):
        scene = lit(
            floor(2), sheet(200, material=1), camera=view((0, 0.4, 0), (0, 0, 0), 60, up=(0, 0, -1)), environment=WHITE,
            materials=[grey(0.7), replace(masked(), base_color=BLACK)], textures=[holes([[alpha]])],
            instances=[(0, IDENTITY), (1, raised(0.5))],
        )  # fmt: skip
        colors[name] = image(scene, (8, 8), 16, bounces=2, settings={"pathtrace.roulette": 64})
    np.testing.assert_allclose(colors["gone"], 0.7, rtol=1e-5)
    assert colors["whole"].max() < 0.02


@pytest.mark.parametrize(
    ("alpha", "factor", "cutoff", "solid"),
    [
        (128, 1.0, 128 / 255, True),  # equal to the cutoff: a surface
        (127, 1.0, 128 / 255, False),
        (255, 0.5, 0.5, True),
        (255, 0.499, 0.5, False),
        (128, 0.5, 0.25, True),
        (128, 0.5, 0.26, False),
        (0, 1.0, 0.0, True),  # nothing is below 0
        (0, 1.0, None, True),  # opaque, whatever alpha is
        (255, 1.0, 1.0, True),
        (254, 1.0, 1.0, False),
    ],
)
def test_cutoff(alpha, factor, cutoff, solid):
    """With another masked material in the scene, so that masks are looked at at all."""
    material = replace(masked(), alpha=factor, alpha_cutoff=cutoff)
    other = Material("far", alpha=0.0, alpha_cutoff=0.5)
    scene = lit(
        sheet(40), sheet(1, material=1), camera=TOP, materials=[material, other], textures=[holes([[alpha]])],
        instances=[(0, IDENTITY), (1, raised(-50))],
    )  # fmt: skip
    depth = render(scene, (4, 4), 1, bounces=0, aovs=("Z",)).aov("Z", "mono")
    assert np.isfinite(depth).all() == solid and np.isfinite(depth).any() == solid


def test_factor_without_texture():
    """A mask by the factor alone; a mesh without texture coordinates."""
    bare = replace(sheet(40), uvs=None)
    for alpha, solid in ((0.6, True), (0.4, False)):
        scene = lit(bare, camera=TOP, materials=[Material("m", alpha=alpha, alpha_cutoff=0.5)], environment=WHITE)
        assert np.isfinite(render(scene, (4, 4), 1, bounces=0, aovs=("Z",)).aov("Z", "mono")).all() == solid


def test_color_of_what_is_left():
    """Alpha does not tint."""
    scene = lit(
        sheet(40), camera=TOP, materials=[replace(masked(), base_color=(0.2, 0.4, 0.6))], textures=[holes([[200]])]
    )
    albedo = render(scene, (4, 4), 1, bounces=0, aovs=("albedo",)).aov("albedo", "mono")
    np.testing.assert_allclose(albedo, np.broadcast_to(np.float32([0.2, 0.4, 0.6]), albedo.shape), rtol=1e-5)


def test_layers_of_holes():
    """Through twenty sheets of holes, in one mesh and in one scene of instances, to what is behind."""
    layers = [sheet(20, material=0) for _ in range(4)]
    scene = lit(
        *layers, floor(40, 1), camera=view((0.3, 8, 0.2), (0, 0, 0), 40, up=(0, 0, -1)),
        materials=[masked(), grey(0.5, 2.0)], textures=[holes([[0]])],
        instances=[*((k % 4, raised(0.3 * k)) for k in range(20)), (4, raised(-1))], environment=Environment.constant(BLACK),
    )  # fmt: skip
    frame = render(scene, (8, 8), 2, bounces=0, aovs=("Z",))
    assert (frame.color["mono"] >= 2 - 1e-5).all()
    assert (frame.aov("Z", "mono") > 8.8).all()
