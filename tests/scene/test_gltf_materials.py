"""Materials, lights and texture transforms of glTF files."""

import math
from pathlib import Path

import numpy as np
import pytest
from gltf_files import GltfFile
from hypothesis import given
from hypothesis import strategies as st

from clcache import SceneError, load_scene
from clcache.scene.model import DirectionalLight, Material, PointLight, SpotLight
from clcache.scene.transform import uv_transform


def _load_material(tmp_path: Path, pictures: int = 0, **fields) -> tuple[Material, object]:
    file = GltfFile()
    if pictures:
        file.pictures(tmp_path, pictures)
    file.material(**fields)
    scene = load_scene(file.write(tmp_path / "a.gltf"))
    return scene.materials[0], scene


def test_core_defaults(tmp_path):
    material, _ = _load_material(tmp_path)
    assert (material.metallic, material.roughness, material.specular, material.ior) == (1, 1, 1, 1.5)
    assert (material.transmission, material.alpha_cutoff, material.double_sided) == (0, None, False)
    assert material.base_color == (1, 1, 1)


def test_all_factors(tmp_path):
    extensions = {
        "KHR_materials_emissive_strength": {"emissiveStrength": 4},
        "KHR_materials_specular": {"specularFactor": 0.25, "specularColorFactor": [0.5, 0.25, 2]},
        "KHR_materials_ior": {"ior": 1.33},
        "KHR_materials_transmission": {"transmissionFactor": 0.75},
    }
    pbr = {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.25}
    material, scene = _load_material(
        tmp_path, pbrMetallicRoughness=pbr, extensions=extensions, emissiveFactor=[1, 0.5, 0], doubleSided=True
    )
    assert material.base_color == (0.1, 0.2, 0.3)
    assert (material.metallic, material.roughness) == (0.5, 0.25)
    assert material.emission == (4, 2, 0)
    assert (material.specular, material.specular_color, material.ior) == (0.25, (0.5, 0.25, 2), 1.33)
    assert (material.transmission, material.thin, material.double_sided) == (0.75, True, True)
    assert material.alpha == 1  # opaque: the factor's alpha counts for nothing
    assert not any("left out" in note for note in scene.notes)


@pytest.mark.parametrize(("thickness", "thin"), [({}, True), ({"thicknessFactor": 0.1}, False)])
def test_a_volume_makes_glass_solid(tmp_path, thickness, thin):
    extensions = {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": thickness}
    assert _load_material(tmp_path, extensions=extensions)[0].thin is thin


def test_ior_zero_means_full_reflectance(tmp_path):
    ior = _load_material(tmp_path, extensions={"KHR_materials_ior": {"ior": 0}})[0].ior
    assert ((ior - 1) / (ior + 1)) ** 2 > 0.999


def test_ior_between_zero_and_one_is_an_error(tmp_path):
    with pytest.raises(SceneError, match=r"materials\[0\].*ior is 0.5; expected"):
        _load_material(tmp_path, extensions={"KHR_materials_ior": {"ior": 0.5}})


@pytest.mark.parametrize(("mode", "cutoff"), [("MASK", 0.3), ("BLEND", 0.5), ("OPAQUE", None)])
def test_alpha_modes(tmp_path, mode, cutoff):
    pbr = {"baseColorFactor": [1, 1, 1, 0.1]}
    material, scene = _load_material(tmp_path, pbrMetallicRoughness=pbr, alphaMode=mode, alphaCutoff=0.3)
    assert material.alpha_cutoff == cutoff
    assert material.alpha == (1 if mode == "OPAQUE" else 0.1)
    assert any("blend" in note for note in scene.notes) == (mode == "BLEND")


def test_a_mask_that_hides_nothing_is_dropped(tmp_path):
    pbr = {"baseColorTexture": {"index": 0}}  # its alpha is 100 / 255 everywhere
    assert (
        _load_material(tmp_path, 1, pbrMetallicRoughness=pbr, alphaMode="MASK", alphaCutoff=0.3)[0].alpha_cutoff is None
    )
    assert (
        _load_material(tmp_path, 1, pbrMetallicRoughness=pbr, alphaMode="MASK", alphaCutoff=0.5)[0].alpha_cutoff == 0.5
    )


def test_every_texture_slot(tmp_path):
    material, scene = _load_material(
        tmp_path,
        4,
        pbrMetallicRoughness={"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}},
        emissiveTexture={"index": 2},
        emissiveFactor=[1, 1, 1],
        normalTexture={"index": 3, "scale": 0.5},
    )
    uses = (
        material.base_color_texture,
        material.metallic_roughness_texture,
        material.emission_texture,
        material.normal_texture,
    )
    assert [scene.textures[use.index].name for use in uses] == ["0.png", "1.png", "2.png", "3.png"]
    assert [scene.textures[use.index].srgb for use in uses] == [True, False, True, False]
    assert material.normal_scale == 0.5


def test_one_picture_as_colour_and_as_data_is_two_textures(tmp_path):
    pbr = {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 0}}
    material, scene = _load_material(tmp_path, 1, pbrMetallicRoughness=pbr, normalTexture={"index": 0})
    assert [texture.srgb for texture in scene.textures] == [True, False]
    assert material.metallic_roughness_texture.index == material.normal_texture.index == 1


def test_emissive_texture_without_a_factor_is_no_light(tmp_path):
    material, scene = _load_material(tmp_path, 1, emissiveTexture={"index": 0})
    assert material.emission_texture is None and not scene.textures


def test_texture_coordinates_of_the_first_texture_are_kept(tmp_path):
    pbr = {"baseColorTexture": {"index": 0, "texCoord": 1}}
    material, scene = _load_material(tmp_path, 2, pbrMetallicRoughness=pbr, normalTexture={"index": 1})
    assert scene.meshes[0].uvs.min() == 5
    assert material.normal_texture is None
    assert any("normalTexture is left out" in note for note in scene.notes)


def test_texture_transform_overrides_the_texture_coordinates(tmp_path):
    transform = {"offset": [0.5, 0.25], "rotation": 0.0, "scale": [2, 3], "texCoord": 1}
    info = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    material, scene = _load_material(tmp_path, 1, pbrMetallicRoughness={"baseColorTexture": info})
    assert scene.meshes[0].uvs.min() == 5
    assert material.base_color_texture.transform == (2, 0, 0.5, 0, 3, 0.25)


def test_the_extension_s_own_example_shows_the_lower_left_quadrant():
    """KHR_texture_transform's example: "only the lower left quadrant of the source image, rotated clockwise 90 degrees"."""
    matrix = np.array(uv_transform((0, 1), math.pi / 2, (0.5, 0.5))).reshape(2, 3)
    corners = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]]) @ matrix.T
    assert corners[:, 0].min() == pytest.approx(0) and corners[:, 0].max() == pytest.approx(0.5)
    assert corners[:, 1].min() == pytest.approx(0.5) and corners[:, 1].max() == pytest.approx(1)


_NUMBER = st.floats(-10, 10)


@given(st.tuples(_NUMBER, _NUMBER), _NUMBER, st.tuples(_NUMBER, _NUMBER), st.tuples(_NUMBER, _NUMBER))
def test_texture_transform_is_translation_rotation_scale(offset, rotation, scale, uv):
    """Rotation: as a complex factor on u - iv, whose plane has v downwards as the picture has."""
    turned = complex(scale[0] * uv[0], -scale[1] * uv[1]) * complex(math.cos(rotation), math.sin(rotation))
    found = np.array(uv_transform(offset, rotation, scale)).reshape(2, 3) @ [*uv, 1]
    assert found == pytest.approx([turned.real + offset[0], -turned.imag + offset[1]], abs=1e-9)


def test_what_is_not_read_is_noted(tmp_path):
    extensions = {"KHR_materials_unlit": {}, "KHR_materials_clearcoat": {"clearcoatFactor": 1}}
    extensions |= {"KHR_materials_specular": {"specularTexture": {"index": 0}}}
    notes = " ".join(_load_material(tmp_path, extensions=extensions)[1].notes)
    assert "KHR_materials_unlit" in notes and "KHR_materials_clearcoat" in notes and "textures of specular" in notes


def _load_lights(tmp_path: Path, *lights: dict):
    file = GltfFile()
    file.document["extensions"] = {"KHR_lights_punctual": {"lights": list(lights)}}
    turn = [math.sin(math.pi / 4), 0, 0, math.cos(math.pi / 4)]  # -Z becomes +Y
    for index in range(len(lights)):
        node = {"translation": [1, 2, 3], "rotation": turn, "extensions": {"KHR_lights_punctual": {"light": index}}}
        file.document["nodes"].append(node)
        file.document["scenes"][0]["nodes"].append(1 + index)
    return load_scene(file.write(tmp_path / "a.gltf"))


def test_punctual_lights(tmp_path):
    spot = {"innerConeAngle": 0.1, "outerConeAngle": 0.2}
    scene = _load_lights(
        tmp_path,
        {"type": "point", "intensity": 2, "color": [1, 0.5, 0]},
        {"type": "directional", "intensity": 3},
        {"type": "spot", "spot": spot, "range": 10},
    )
    point, directional, cone = scene.lights
    assert point == PointLight((1, 2, 3), (2, 1, 0))
    assert isinstance(directional, DirectionalLight) and directional.irradiance == (3, 3, 3)
    assert directional.direction == pytest.approx((0, 1, 0), abs=1e-12)
    assert isinstance(cone, SpotLight) and cone.position == (1, 2, 3) and cone.intensity == (1, 1, 1)
    assert cone.direction == pytest.approx((0, 1, 0), abs=1e-12)
    assert (cone.inner_angle, cone.outer_angle) == (0.1, 0.2)
    assert any("range" in note for note in scene.notes)


def test_a_cone_inside_out_is_an_error(tmp_path):
    with pytest.raises(SceneError, match=r"lights\[0\].spot: innerConeAngle 0.9 is not below outerConeAngle"):
        _load_lights(tmp_path, {"type": "spot", "spot": {"innerConeAngle": 0.9}})
