"""Normal maps: which way they bend what they are on. Seen in the normals that a frame writes, and in the light."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import IDENTITY, make_mesh
from render_helpers import WHITE, ball, image, lit, render, view

from clcache.scene.model import DirectionalLight, Material, Mesh, Texture, TextureUse
from clcache.scene.transform import uv_transform

FRONT = view((0, 0, 3), (0, 0, 0), 30)


def wall(uvs=((0, 1), (1, 1), (1, 0), (0, 0))) -> Mesh:
    """A square that faces +Z; by default the picture stands upright on it: u to the right, v downwards."""
    mesh = make_mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    return replace(mesh, uvs=np.array(uvs, np.float32))


def normal_map(rgb, wrap=("repeat", "repeat")):
    return Texture("normals", np.full((2, 2, 4), (*rgb, 255), np.uint8), srgb=False, wrap=wrap)


def decoded(rgb, scale=1.0):
    n = np.asarray(rgb) / 255 * 2 - 1
    n[:2] *= scale
    return n / np.linalg.norm(n)


def mapped(**options):
    return Material("mapped", (0.8, 0.8, 0.8), normal_texture=TextureUse(0), **options)


def normals(mesh, rgb, camera=FRONT, material=None, instance=IDENTITY):
    """(3,): the middle pixel's."""
    scene = lit(
        mesh, camera=camera, materials=[material or mapped()], textures=[normal_map(rgb)], instances=[(0, instance)]
    )
    return render(scene, (3, 3), 1, bounces=0, aovs=("N",)).aov("N", "mono")[1, 1]


@pytest.mark.parametrize("rgb", [(128, 128, 255), (220, 128, 180), (200, 128, 200), (128, 220, 180), (60, 90, 220)])
def test_red_points_right_and_green_up(rgb):
    """OpenGL's convention, as in glTF: in the upright picture, x to the right, y up, z out."""
    np.testing.assert_allclose(normals(wall(), rgb), decoded(rgb), atol=2e-6)


@pytest.mark.parametrize("scale", [0.0, 0.5, 2.0])
def test_scale(scale):
    rgb = (180, 100, 220)
    np.testing.assert_allclose(
        normals(wall(), rgb, material=mapped(normal_scale=scale)), decoded(rgb, scale), atol=2e-6
    )


def test_flat_map_leaves_the_image():
    """8 bits have no exact 0: 128 is off by 0.004, of which light on a ball of smooth normals shows as much, and no more."""
    sun = DirectionalLight((0.5, -0.6, -0.6244998), (3.0, 3.0, 3.0))
    textures = [normal_map((128, 128, 255))]
    images = [
        image(
            lit(ball(1, 3, smooth=True), camera=FRONT, materials=[m], textures=textures, lights=[sun]),
            (24, 24),
            4,
            bounces=0,
        )
        for m in (mapped(), replace(mapped(), normal_texture=None))
    ]
    np.testing.assert_allclose(images[0], images[1], atol=0.03)
    assert np.abs(images[0] - images[1]).mean() < 5e-3


def test_light_on_a_tilted_map_is_that_on_a_tilted_surface():
    """Lambert's cosine with the map's normal."""
    rgb = (190, 90, 200)
    for direction in ((0.0, 0.0, -1.0), (-0.6, 0.0, -0.8), (0.3, 0.5, -0.812403840463596)):
        sun = DirectionalLight(direction, (np.pi / 0.8,) * 3)
        scene = lit(wall(), camera=FRONT, materials=[mapped()], textures=[normal_map(rgb)], lights=[sun])
        cosine = max(-np.dot(decoded(rgb), direction), 0)
        np.testing.assert_allclose(image(scene, (3, 3), 1, bounces=0)[1, 1], cosine, rtol=1e-4, atol=1e-6)


def test_mirrored_and_turned_coordinates():
    """The tangent follows u and the bitangent v, also where the picture is mirrored, turned or stretched on the mesh."""
    rgb = (200, 160, 200)
    n = decoded(rgb)
    cases = {
        ((1, 1), (0, 1), (0, 0), (1, 0)): (-n[0], n[1]),  # u to the left
        ((0, 0), (1, 0), (1, 1), (0, 1)): (n[0], -n[1]),  # v upwards
        ((1, 0), (0, 0), (0, 1), (1, 1)): (-n[0], -n[1]),  # half a turn
        ((0, 0), (0, 1), (1, 1), (1, 0)): (-n[1], n[0]),  # u upwards, v to the right
        ((0, 7), (3, 7), (3, 0), (0, 0)): (n[0], n[1]),  # stretched
        ((-5, 3), (-4, 3), (-4, 2), (-5, 2)): (n[0], n[1]),  # elsewhere
    }
    for uvs, (x, y) in cases.items():
        np.testing.assert_allclose(normals(wall(uvs), rgb), [x, y, n[2]], atol=2e-6, err_msg=str(uvs))


def test_instances_turned_stretched_and_mirrored():
    """What the map's axes are in the world: those of the surface where it is placed."""
    rgb = (200, 160, 200)
    n = decoded(rgb)
    quarter = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]])
    np.testing.assert_allclose(normals(wall(), rgb, instance=quarter), [-n[1], n[0], n[2]], atol=2e-6)
    wide = np.diag([3.0, 1, 1, 1])[:3]
    np.testing.assert_allclose(normals(wall(), rgb, instance=wide), n, atol=2e-6)
    mirrored = np.diag([-1.0, 1, 1, 1])[:3]
    np.testing.assert_allclose(normals(wall(), rgb, instance=mirrored), [-n[0], n[1], n[2]], atol=2e-6)


def test_from_behind():
    """The map is on the surface, not on the side that is seen: the back's normal is the front's, turned over."""
    n = decoded((200, 160, 200))
    seen = normals(wall(), (200, 160, 200), camera=view((0, 0, -3), (0, 0, 0), 30))
    np.testing.assert_allclose(seen, -n, atol=2e-6)


def test_with_smooth_normals():
    """The map bends the interpolated normal: on a wall whose normals all lean, z is along them."""
    lean = np.array([0.3, 0.0, np.sqrt(1 - 0.09)])
    mesh = replace(wall(), normals=np.tile(lean, (4, 1)).astype(np.float32))
    n = decoded((200, 160, 200))
    tangent = np.array([1.0, 0, 0]) - lean[0] * lean
    tangent /= np.linalg.norm(tangent)
    expected = n[0] * tangent + n[1] * np.cross(lean, tangent) + n[2] * lean
    np.testing.assert_allclose(normals(mesh, (200, 160, 200)), expected, atol=2e-6)


def test_a_normal_that_faces_away_is_not_used():
    """Steeper than the view: nothing could be seen of it."""
    grazing = view((3, 0, 0.3), (0, 0, 0), 10)
    np.testing.assert_allclose(normals(wall(), (0, 128, 128), camera=grazing), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(normals(wall(), (128, 128, 0)), [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize("rgb", [(127, 127, 127), (128, 128, 128), (0, 0, 0), (255, 255, 255)])
def test_degenerate_maps(rgb):
    """No length, or nonsense: a unit normal all the same, and no NaN in the light."""
    found = normals(wall(), rgb, material=mapped(normal_scale=0.0))
    np.testing.assert_allclose(np.linalg.norm(found), 1, atol=1e-5)
    scene = lit(wall(), camera=FRONT, materials=[mapped()], textures=[normal_map(rgb)], environment=WHITE)
    assert np.isfinite(image(scene, (4, 4), 4)).all()


def test_meshes_without_coordinates_stay_flat():
    """Or whose coordinates are all one."""
    for mesh in (replace(wall(), uvs=None), wall([(0.5, 0.5)] * 4)):
        np.testing.assert_allclose(normals(mesh, (200, 160, 200)), [0, 0, 1], atol=1e-6)


def test_a_transform_of_coordinates_does_not_turn_the_normal():
    """KHR_texture_transform moves what is looked up; tangents are those of the mesh's coordinates, as glTF has them."""
    use = TextureUse(0, uv_transform((0.3, 0.2), 0.5, (2.0, 3.0)))
    rgb = (200, 160, 200)
    found = normals(wall(), rgb, material=replace(mapped(), normal_texture=use))
    np.testing.assert_allclose(found, decoded(rgb), atol=2e-6)
