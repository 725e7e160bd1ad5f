"""What of a scene is uploaded, in which form, and what is left out."""

from dataclasses import replace

import numpy as np
import pytest
from render_helpers import ball, checkered, everything, floor, grey, lit, shape_mesh, view

from clcache.device import Device
from clcache.errors import DeviceError
from clcache.resources import SceneResources, srgb_to_linear
from clcache.scene.generators import plane
from clcache.scene.model import DirectionalLight, Material, Mesh, PointLight, Texture
from clcache.scene.textures import encode_srgb

CAMERA = view((0, 1, 3), (0, 0, 0))


def without_uvs(mesh: Mesh) -> Mesh:
    return replace(mesh, uvs=None)


def test_srgb_round_trip():
    encoded = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(encode_srgb(srgb_to_linear(encoded)), encoded, atol=1e-4)
    np.testing.assert_allclose(srgb_to_linear(np.array([0, 1, 0.5, 0.04])), [0, 1, 0.21404114, 0.04 / 12.92], rtol=1e-7)


def test_what_a_scene_lacks_is_not_there(device):
    resources = SceneResources(device, lit(without_uvs(floor()), camera=CAMERA))
    assert resources.features == dict.fromkeys(("HAS_NORMALS", "HAS_TEXTURES", "HAS_LIGHTS", "HAS_EMISSION"), False)
    assert resources.normals is resources.uvs is resources.lights is resources.textures is resources.texels is None
    assert resources.light_count == resources.texture_bytes == 0


def test_all_that_a_scene_has_is_there(device):
    resources = SceneResources(device, everything())
    assert all(resources.features.values())
    assert resources.light_count == 3
    assert resources.uvs.shape[1] == 2
    assert resources.normals.shape == resources.trees.positions.shape


@pytest.mark.parametrize(
    ("changes", "feature"),
    [
        ({"environment": (0.0, 0.0, 0.1)}, "HAS_EMISSION"),
        ({"materials": (grey(0.5, 0.1),)}, "HAS_EMISSION"),
        ({"lights": (PointLight((0, 0, 0), (1, 1, 1)),)}, "HAS_LIGHTS"),
        ({"meshes": (ball(smooth=True),)}, "HAS_NORMALS"),
        ({"materials": (Material("m", base_color_texture=0),), "textures": (checkered(),)}, "HAS_TEXTURES"),
    ],
)
def test_each_feature_by_itself(device, changes, feature):
    resources = SceneResources(device, replace(lit(floor(), camera=CAMERA), **changes))
    assert [name for name, is_there in resources.features.items() if is_there] == [feature]


def test_a_texture_that_no_material_uses_is_not_uploaded(device):
    assert SceneResources(device, lit(floor(), camera=CAMERA, textures=[checkered()])).texture_bytes == 0


def test_materials(device):
    materials = [Material("a", (0.1, 0.2, 0.3), -1, (4.0, 5.0, 6.0)), grey(0.5)]
    records = SceneResources(device, lit(floor(), camera=CAMERA, materials=materials)).materials.get()
    np.testing.assert_array_equal(records["base_color"], np.float32([[0.1, 0.2, 0.3], [0.5] * 3]))
    np.testing.assert_array_equal(records["emission"], np.float32([[4, 5, 6], [0] * 3]))
    np.testing.assert_array_equal(records["texture"], [-1, -1])


def test_materials_of_triangles_of_several_meshes(device):
    meshes = [shape_mesh(plane((1, 1)), k) for k in (2, 0, 1)]
    scene = lit(*meshes, camera=CAMERA, materials=[grey(k / 4) for k in range(3)])
    np.testing.assert_array_equal(SceneResources(device, scene).material.get(), [2, 2, 0, 0, 1, 1])


def test_lights(device):
    lights = [PointLight((1, 2, 3), (4, 5, 6)), DirectionalLight((0.0, -0.6, 0.8), (7, 8, 9))]
    records = SceneResources(device, lit(floor(), camera=CAMERA, lights=lights)).lights.get()
    np.testing.assert_array_equal(records["kind"], [0, 1])
    np.testing.assert_array_equal(records["vector"], np.float32([[1, 2, 3], [0, 0.6, -0.8]]))
    np.testing.assert_array_equal(records["power"], [[4, 5, 6], [7, 8, 9]])


def test_textures(device):
    """One behind the other, a 32-bit word for each texel, red in the lowest byte."""
    rng = np.random.default_rng(1)
    sizes, wraps = [(2, 3), (1, 1), (4, 2)], [("repeat", "clamp"), ("mirror", "repeat"), ("clamp", "mirror")]
    pictures = [rng.integers(0, 256, (h, w, 4), dtype=np.uint8) for w, h in sizes]
    textures = [Texture(f"t{k}", p, wrap) for k, (p, wrap) in enumerate(zip(pictures, wraps, strict=True))]
    scene = lit(floor(), camera=CAMERA, materials=[Material("m", base_color_texture=1)], textures=textures)
    resources = SceneResources(device, scene)
    records, texels = resources.textures.get(), resources.texels.get()
    np.testing.assert_array_equal(records["first_texel"], [0, 6, 7])
    np.testing.assert_array_equal(np.column_stack([records["width"], records["height"]]), sizes)
    np.testing.assert_array_equal(records["wrap"], [[0, 1], [2, 0], [1, 2]])
    for record, picture in zip(records, pictures, strict=True):
        stored = texels[record["first_texel"] :][: record["width"] * record["height"]].reshape(picture.shape[:2])
        for channel in range(4):
            np.testing.assert_array_equal(stored >> (8 * channel) & 255, picture[..., channel])
    assert resources.texture_bytes == texels.nbytes + records.nbytes


def test_pictures_may_be_views_of_others(device):
    """A flipped or cropped picture, whose rows are not one behind the other in memory."""
    picture = np.arange(4 * 6 * 4, dtype=np.uint8).reshape(4, 6, 4)
    texture = Texture("t", picture[::-1, 1:5])
    scene = lit(floor(), camera=CAMERA, materials=[Material("m", base_color_texture=0)], textures=[texture])
    texels = SceneResources(device, scene).texels.get()
    np.testing.assert_array_equal(texels.view(np.uint8).reshape(4, 4, 4), picture[::-1, 1:5])


def test_memory_is_counted_and_its_end_is_an_error():
    device = Device()
    scene = everything()
    resources = SceneResources(device, scene)
    own = [a for a in resources.surface_arrays() if a is not None]
    assert device.allocated >= sum(a.nbytes for a in {id(a): a for a in own}.values())
    device.capabilities = replace(device.capabilities, global_memory=device.allocated + 100)
    with pytest.raises(DeviceError, match=r"needs .* beside the .* already taken"):
        SceneResources(device, scene)
