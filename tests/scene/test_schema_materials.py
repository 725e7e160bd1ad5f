"""Materials and spot lights of scene files."""

import math
from pathlib import Path

import pytest
from PIL import Image

from clcache import SceneError, load_scene
from clcache.scene.model import Material, SpotLight
from clcache.scene.transform import uv_transform

HEAD = '[meshes.a]\ngenerator = "box"\n[[instances]]\nmesh = "a"\nmaterial = "m"\n'


def _load(tmp_path: Path, text: str):
    Image.new("RGBA", (2, 2), (1, 2, 3, 4)).save(tmp_path / "a.png")
    (tmp_path / "a.toml").write_text(HEAD + "[materials.m]\n" + text)
    return load_scene(tmp_path / "a.toml")


def test_base_color_alone_is_lambertian(tmp_path):
    assert _load(tmp_path, "base_color = [0.1, 0.2, 0.3]").materials == (Material("m", (0.1, 0.2, 0.3)),)


def test_every_key(tmp_path):
    scene = _load(
        tmp_path,
        """
base_color = [0.1, 0.2, 0.3]
base_color_texture = { file = "a.png", wrap = ["clamp", "mirror"], scale = 2, rotation = 30, offset = [0.5, 0.25] }
alpha_cutoff = 0.5
metallic = 0.25
roughness = 0.5
metallic_roughness_texture = "a.png"
specular = 0.75
specular_color = [1, 0.5, 0]
ior = 1.33
transmission = 0.5
thin = true
emission = [1, 2, 3]
emission_texture = "a.png"
normal_texture = "a.png"
normal_scale = -1
double_sided = false
""",
    )
    (found,) = scene.materials
    plain = Material(
        "m", (0.1, 0.2, 0.3), found.base_color_texture, 1.0, 0.5, 0.25, 0.5, found.metallic_roughness_texture, 0.75, (1, 0.5, 0),
        1.33, 0.5, True, (1, 2, 3), found.emission_texture, found.normal_texture, -1, False,
    )  # fmt: skip
    assert found == plain
    textures = scene.textures
    assert [(t.srgb, t.wrap) for t in textures] == [
        (True, ("clamp", "mirror")),
        (False, ("repeat", "repeat")),
        (True, ("repeat", "repeat")),
    ]
    assert found.base_color_texture.transform == uv_transform((0.5, 0.25), math.radians(30), (2, 2))
    assert (found.metallic_roughness_texture.index, found.emission_texture.index, found.normal_texture.index) == (
        1,
        2,
        1,
    )


@pytest.mark.parametrize(
    ("text", "specular"),
    [
        ("metallic = 1", 0),
        ("roughness = 1", 1),
        ("ior = 1.3", 1),
        ("specular_color = [1, 0, 0]", 1),
        ("roughness = 1\nspecular = 0", 0),
    ],
)
def test_reflection_that_is_asked_for(tmp_path, text, specular):
    assert _load(tmp_path, text).materials[0].specular == specular


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("roughness = 1.5", r"a.toml:7: materials.m.roughness: 1.5 is wrong"),
        ("ior = 0.5", r"a.toml:7: materials.m.ior: 0.5 is wrong"),
        ("metalic = 1", r"a.toml:7: materials.m.metalic: unknown key; did you mean metallic"),
        (
            'normal_texture = { file = "a.png", warp = "clamp" }',
            r"a.toml:7: materials.m.normal_texture.warp: unknown key.*wrap",
        ),
        ('normal_texture = { file = "a.png", wrap = "tile" }', r"a.toml:7: materials.m.normal_texture.wrap"),
        ('normal_texture = "b.png"', r"a.toml:7: materials.m.normal_texture.*'b.png': no such file"),
        (
            'normal_texture = { file = "../b.png" }',
            r"a.toml:7: materials.m.normal_texture.file: '../b.png' leaves the scene's folder",
        ),
        (
            'emission_texture = "a.png"',
            r"a.toml:6: materials.m: emission_texture is multiplied with emission, which is 0",
        ),
        ("double_sided = 1", r"a.toml:7: materials.m.double_sided: 1 is wrong"),
    ],
)
def test_errors_name_the_line(tmp_path, text, message):
    with pytest.raises(SceneError, match=message):
        _load(tmp_path, text)


SPOT = '[[lights]]\ntype = "spot"\nposition = [1, 2, 3]\ndirection = [0, -3, 0]\nintensity = [1, 1, 1]\n'


def test_spot_light(tmp_path):
    (light,) = _load(tmp_path, SPOT + "inner_angle = 10\nouter_angle = 20").lights
    assert light == SpotLight((1, 2, 3), (0, -1, 0), (1, 1, 1), math.radians(10), math.radians(20))


def test_a_cone_inside_out_is_an_error(tmp_path):
    with pytest.raises(SceneError, match=r"a.toml:7: lights.0: inner_angle is not below outer_angle"):
        _load(tmp_path, SPOT + "inner_angle = 30\nouter_angle = 20")
