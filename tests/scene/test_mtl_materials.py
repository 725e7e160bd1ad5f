"""How MTL statements become metallic-roughness materials."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clcache import SceneError, load_scene

OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 1\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"


def _load(tmp_path: Path, text: str):
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "a.mtl").write_text("newmtl m\n" + text)
    return load_scene(tmp_path / "a.obj")


def _material(tmp_path: Path, text: str):
    return _load(tmp_path, text).materials[0]


def _reflectance(material) -> np.ndarray:
    """At normal incidence."""
    return material.specular * np.array(material.specular_color) * ((material.ior - 1) / (material.ior + 1)) ** 2


def test_diffuse(tmp_path):
    material = _material(tmp_path, "Kd 0.1 0.2 0.3\nKs 0.5 0.5 0.5\nillum 1\n")
    assert (material.base_color, material.specular, material.metallic, material.transmission) == (
        (0.1, 0.2, 0.3),
        0,
        0,
        0,
    )
    assert material.double_sided


@pytest.mark.parametrize(("statement", "alpha"), [("Ns 198", 0.1), ("Ns 0", 1.0), ("Ns 1000\nPr 0.6", 0.36), ("", 1.0)])
def test_roughness_is_the_root_of_alpha(tmp_path, statement, alpha):
    assert _material(tmp_path, statement + "\n").roughness ** 2 == pytest.approx(alpha)


@pytest.mark.parametrize(
    ("statement", "reflectance"),
    [
        ("Ks 0.04 0.04 0.04", [0.04] * 3),
        ("Ks 0.1 0.05 0", [0.1, 0.05, 0]),
        ("Ks 0.5 0.5 0.5\nNi 1.5", [0.04] * 3),
        ("Ks 0.02 0.01 0\nNi 1.5", [0.02, 0.01, 0]),
        ("Ks 0 0 0\nNi 1.5", [0, 0, 0]),
    ],
)
def test_specular_reflectance(tmp_path, statement, reflectance):
    assert _reflectance(_material(tmp_path, f"Kd 0.5 0.5 0.5\n{statement}\n")) == pytest.approx(np.array(reflectance))


@pytest.mark.parametrize("statement", ["Kd 0.9 0.8 0.7\nPm 1\nPr 0\n", "Kd 0 0 0\nKs 0.9 0.8 0.7\nNs 1000\nillum 3\n"])
def test_a_mirror(tmp_path, statement):
    material = _material(tmp_path, statement)
    assert (material.metallic, material.roughness, material.base_color) == (1, 0, (0.9, 0.8, 0.7))


@pytest.mark.parametrize(
    "statement", ["Kd 1 1 1\nKs 0.04 0.04 0.04\nNs 1000\nNi 1.5\nd 1.0\nTf 1 1 1\nillum 7", "Kd 1 1 1\nd 0.1\nNi 1.5"]
)
def test_glass(tmp_path, statement):
    material = _material(tmp_path, statement + "\n")
    assert (material.transmission, material.thin, material.roughness, material.ior) == (1, False, 0, 1.5)
    assert (material.base_color, material.metallic) == ((1, 1, 1), 0)


@pytest.mark.parametrize("statement", ["d 0.25", "Tr 0.75"])
def test_see_through(tmp_path, statement):
    material = _material(tmp_path, statement + "\n")
    assert (material.transmission, material.thin, material.ior) == (0.75, True, 1)


def test_pictures(tmp_path):
    Image.new("RGB", (4, 4), (10, 20, 30)).save(tmp_path / "color.png")
    Image.fromarray(np.array([[0, 255], [255, 255]], np.uint8)).save(tmp_path / "mask.png")
    Image.new("RGB", (2, 2), (128, 128, 255)).save(tmp_path / "n.png")
    scene = _load(
        tmp_path,
        "map_Kd -s 2 3 1 -o 0.5 0.25 color.png\nmap_d mask.png\nmap_Ke color.png\nnorm n.png\nmap_Bump b.png\nmap_Pr r.png\n",
    )
    material = scene.materials[0]
    base = scene.textures[material.base_color_texture.index]
    assert (
        base.pixels.shape == (4, 4, 4) and base.pixels[0, 0].tolist() == [10, 20, 30, 0] and base.pixels[3, 3, 3] == 255
    )
    assert material.alpha_cutoff == 0.5
    assert (material.emission, scene.textures[material.emission_texture.index].name) == ((1, 1, 1), "color.png")
    assert not scene.textures[material.normal_texture.index].srgb
    # A point with v upwards: (2 u + 0.5, 3 v + 0.25); the model's v is 1 minus that.
    u, v = 0.2, 0.1
    matrix = np.array(material.base_color_texture.transform).reshape(2, 3)
    assert matrix @ [u, 1 - v, 1] == pytest.approx([2 * u + 0.5, 1 - (3 * v + 0.25)])
    notes = " ".join(scene.notes)
    assert "map_Bump" in notes and "map_Pr" in notes


def test_errors_name_the_line(tmp_path):
    with pytest.raises(SceneError, match=r"a.mtl:3: Ns: 'x' is wrong; expected a number"):
        _load(tmp_path, "Kd 1 1 1\nNs x\n")
