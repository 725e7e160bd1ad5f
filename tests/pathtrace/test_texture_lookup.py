"""Texture lookups against a model in NumPy: through the albedo of swatches, squares of one texture coordinate each."""

import numpy as np
import pytest
from helpers import make_mesh
from render_helpers import MODELLED, camera_rays, lit, render, view

from clcache.scene.generators import plane
from clcache.scene.model import WRAP_MODES, Camera, Material, Mesh, Texture, TextureUse

SIDE = 64  # swatches in a row


def srgb_to_linear(encoded):
    """IEC 61966-2-1"""
    c = np.asarray(encoded, np.float64) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def wrapped(place, size, mode):
    if mode == "clamp":
        return np.clip(place, 0, size - 1)
    if mode == "repeat":
        return np.mod(place, size)
    folded = np.mod(place, 2 * size)
    return np.where(folded < size, folded, 2 * size - 1 - folded)


def bilinear(texture: Texture, uvs: np.ndarray) -> np.ndarray:
    """(n, 3) float64: decoded texels, weighted; the texel in column i, row j has its centre at ((i + 1/2) / w, (j + 1/2) / h)."""
    height, width = texture.pixels.shape[:2]
    texels = srgb_to_linear(texture.pixels[..., :3])
    uvs = np.asarray(uvs, np.float64)
    near = np.where(
        np.array(texture.wrap) == "clamp", np.clip(uvs, -1, 2), np.mod(uvs, 2)
    )  # the same place of the pattern
    x, y = near.T * [[width], [height]] - 0.5
    left, top = np.floor(x), np.floor(y)
    total = np.zeros((len(x), 3))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - (x - left)) * np.abs(1 - dy - (y - top))
            column = wrapped(left + dx, width, texture.wrap[0]).astype(int)
            row = wrapped(top + dy, height, texture.wrap[1]).astype(int)
            total += weight[:, None] * texels[row, column]
    return total


def swatches(uvs: np.ndarray) -> tuple[Mesh, Camera, tuple[int, int]]:
    """A wall of squares, one for each texture coordinate, row by row, and a camera that sees one in each pixel."""
    rows = -(-len(uvs) // SIDE)
    uvs = np.concatenate([uvs, np.zeros((rows * SIDE - len(uvs), 2))])
    place = np.column_stack([np.arange(rows * SIDE) % SIDE, -(np.arange(rows * SIDE) // SIDE)])
    corner = np.array([[0, 0], [0, -1], [1, -1], [1, 0]])
    flat = (place[:, None] + corner).reshape(-1, 2) - [SIDE / 2, -rows / 2]
    mesh = make_mesh(
        np.column_stack([flat, np.zeros(len(flat))]),
        (4 * np.arange(len(uvs))[:, None, None] + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3),
    )
    camera = view((0, 0, rows / 2), (0, 0, 0), 90)
    return (
        Mesh("wall", mesh.positions, mesh.triangles, mesh.material, None, np.repeat(uvs, 4, axis=0).astype(np.float32)),
        camera,
        (SIDE, rows),
    )


def lookups(texture: Texture, uvs: np.ndarray) -> np.ndarray:
    """(n, 3): the renderer's colour at each texture coordinate."""
    mesh, camera, size = swatches(uvs)
    scene = lit(mesh, camera=camera, materials=[Material("m", (1.0, 1.0, 1.0), TextureUse(0))], textures=[texture])
    albedo = render(scene, size, aovs=("albedo",), bounces=0, sampler=MODELLED).aov("albedo", "mono")
    return albedo.reshape(-1, 3)[: len(uvs)]


def random_texture(width, height, wrap=("repeat", "repeat"), seed=0):
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 4), dtype=np.uint8)
    return Texture("noise", pixels, wrap=wrap)


def test_srgb_decoding_of_every_value():
    ramp = np.zeros((1, 256, 4), np.uint8)
    ramp[0, :, 0] = np.arange(256)
    ramp[0, :, 1] = np.arange(256)[::-1]
    ramp[0, :, 2] = np.roll(np.arange(256), 7)
    uvs = np.column_stack([(np.arange(256) + 0.5) / 256, np.full(256, 0.5)])
    colors = lookups(Texture("ramp", ramp), uvs)
    np.testing.assert_allclose(colors, srgb_to_linear(ramp[0, :, :3]), rtol=1e-6, atol=1e-9)


def test_alpha_has_no_effect():
    texture = random_texture(3, 3)
    opaque = texture.pixels.copy()
    opaque[..., 3] = 255
    uvs = np.random.default_rng(1).random((64, 2))
    np.testing.assert_array_equal(lookups(texture, uvs), lookups(Texture("t", opaque), uvs))


@pytest.mark.parametrize("wrap_v", WRAP_MODES)
@pytest.mark.parametrize("wrap_u", WRAP_MODES)
def test_filter_and_wrap(wrap_u, wrap_v):
    """Random places over several turns, texel centres, texel borders, and whole numbers."""
    rng = np.random.default_rng(3)
    texture = random_texture(5, 4, (wrap_u, wrap_v))
    borders = np.stack(np.meshgrid(np.arange(-11, 12) / 10, np.arange(-9, 10) / 8), axis=-1).reshape(-1, 2)
    whole = np.stack(np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)), axis=-1).reshape(-1, 2)
    uvs = np.concatenate([rng.uniform(-4, 4, (1000, 2)), borders, whole]).astype(np.float32)
    np.testing.assert_allclose(lookups(texture, uvs), bilinear(texture, uvs), atol=1e-5)


@pytest.mark.parametrize("wrap", WRAP_MODES)
def test_texture_coordinates_of_any_size(wrap):
    """Up to the largest float32, and the smallest about zero; the model computes with what float32 keeps of them.

    Tolerance: 2^-23 of a turn, times the texels in it and the largest step of 1 between them.
    """
    special = [
        1e7,
        -1e7,
        2.0**23 - 0.5,
        0.5 - 2.0**23,
        2.0**24,
        1e30,
        -1e30,
        3.4e38,
        -3.4e38,
        1e-7,
        -1e-7,
        -1e-30,
        -0.0,
    ]
    rng = np.random.default_rng(4)
    random = rng.choice([-1, 1], 500) * 10 ** rng.uniform(-9, 9, 500)
    u = np.concatenate([special, random]).astype(np.float32)
    texture = random_texture(4, 3, (wrap, wrap))
    uvs = np.column_stack([u, u[::-1]])
    np.testing.assert_allclose(lookups(texture, uvs), bilinear(texture, uvs), atol=8 * 2.0**-23)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2048, 2)])
def test_texture_sizes(size):
    texture = random_texture(*size)
    uvs = np.random.default_rng(6).uniform(-2, 2, (500, 2)).astype(np.float32)
    np.testing.assert_allclose(lookups(texture, uvs), bilinear(texture, uvs), atol=size[0] * 2.0**-22 + 1e-6)


def test_first_row_is_at_v_zero_and_first_column_at_u_zero():
    texture = random_texture(2, 2, ("clamp", "clamp"))
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(
        lookups(texture, corners), srgb_to_linear(texture.pixels[..., :3]).reshape(4, 3), rtol=1e-6
    )


def test_several_textures_and_materials():
    """Each triangle has its own material; textures of different sizes lie one behind the other."""
    textures = [random_texture(3, 2, seed=1), random_texture(1, 1, seed=2), random_texture(4, 5, seed=3)]
    materials = [Material("m", (1.0, 0.5, 0.25), k if k is None else TextureUse(k)) for k in (2, 0, None, 1)]
    mesh, camera, size = swatches(np.tile([[0.3, 0.6]], (SIDE, 1)))
    material = np.repeat(np.arange(SIDE) % 4, 2).astype(np.uint32)
    mesh = Mesh("wall", mesh.positions, mesh.triangles, material, None, mesh.uvs)
    scene = lit(mesh, camera=camera, materials=materials, textures=textures)
    albedo = render(scene, size, aovs=("albedo",), bounces=0, sampler=MODELLED).aov("albedo", "mono")[0]
    one = [bilinear(t, np.float32([[0.3, 0.6]]))[0] for t in textures]
    for column in range(SIDE):
        expected = np.array([1.0, 0.5, 0.25]) * [one[2], one[0], 1, one[1]][column % 4]
        np.testing.assert_allclose(albedo[column], expected, rtol=1e-5)


def test_coordinates_are_interpolated_over_a_triangle():
    """A square that spans one turn: its picture stands upright, the first row at the top (v = 0)."""
    camera = view((0, 3, 0), (0, 0, 0), 60, up=(0, 0, -1))
    shape = plane((2.0, 2.0))
    mesh = make_mesh(shape.positions, shape.triangles)
    uvs = (shape.positions[:, [0, 2]] + 1) / 2  # u to the right, v towards the camera's lower edge
    mesh = Mesh("m", mesh.positions, mesh.triangles, mesh.material, None, uvs.astype(np.float32))
    texture = random_texture(8, 8, ("clamp", "clamp"))
    scene = lit(mesh, camera=camera, materials=[Material("m", (1.0, 1.0, 1.0), TextureUse(0))], textures=[texture])
    size = (40, 40)
    albedo = render(scene, size, aovs=("albedo",), bounces=0, sampler=MODELLED).aov("albedo", "mono")
    origin, directions = camera_rays(camera, size)
    points = (origin - directions * (origin[1] / directions[..., 1:2]))[..., [0, 2]]
    inside = np.abs(points).max(axis=-1) < 1 - 1e-5
    expected = bilinear(texture, (points[inside] + 1) / 2)
    np.testing.assert_allclose(albedo[inside], expected, atol=2e-5)
    assert (albedo[np.abs(points).max(axis=-1) > 1 + 1e-5] == 0).all()


def test_coordinates_that_are_no_color_of_a_mesh_without_texture():
    """Beside a textured mesh, one without texture coordinates and with a plain material keeps its colour."""
    plain = plane((30.0, 30.0))
    mesh = make_mesh(plain.positions, plain.triangles)
    wall, _, _ = swatches(np.array([[0.5, 0.5]]))
    far = np.column_stack([np.eye(3), [0, 0, -500]])
    scene = lit(mesh, Mesh("w", wall.positions, wall.triangles, wall.material + np.uint32(1), None, wall.uvs),
                camera=view((0, 2, 0.1), (0, 0, 0)), materials=[Material("plain", (0.2, 0.4, 0.6)), Material("t", (1.0, 1.0, 1.0), TextureUse(0))],
                textures=[random_texture(2, 2)], instances=[(0, np.eye(4)[:3]), (1, far)])  # fmt: skip
    albedo = render(scene, (8, 8), aovs=("albedo",)).aov("albedo", "mono")
    np.testing.assert_array_equal(albedo, np.broadcast_to(np.float32([0.2, 0.4, 0.6]), albedo.shape))
