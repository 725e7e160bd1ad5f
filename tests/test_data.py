"""The scenes in data/: their scripts give the stored files, they load, and their measures are believable."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clcache import load_scene
from clcache.scene.model import NO_TEXTURE

ROOT = Path(__file__).parents[1]
DATA = ROOT / "data"


@pytest.fixture(scope="module")
def cornell():
    return load_scene(DATA / "cornell" / "scene.toml")


@pytest.fixture(scope="module")
def atrium():
    return load_scene(DATA / "atrium" / "scene.toml")


def world_positions(scene, instance):
    linear, offset = instance.transform[:, :3], instance.transform[:, 3]
    return scene.meshes[instance.mesh].positions @ linear.T + offset


def triangle_areas(corners):
    """corners: (t, 3, 3) -> (t,)"""
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


@pytest.mark.parametrize("name", ["cornell", "atrium"])
def test_script_gives_the_stored_files(name, tmp_path):
    script = ROOT / "tools" / f"make_{name}.py"
    subprocess.run([sys.executable, script, "--out", tmp_path], check=True)
    made = {file.relative_to(tmp_path) for file in tmp_path.rglob("*") if file.is_file()}
    assert made == {file.relative_to(DATA / name) for file in (DATA / name).rglob("*") if file.is_file()}
    for file in made:
        if file.suffix == ".jpg":  # encoders differ in the last bits, pictures do not
            new, stored = (np.asarray(Image.open(folder / file), dtype=float) for folder in (tmp_path, DATA / name))
            assert np.abs(new - stored).mean() < 0.25, file
        else:
            assert (tmp_path / file).read_bytes() == (DATA / name / file).read_bytes(), file


def test_data_is_small():
    assert sum(file.stat().st_size for file in DATA.rglob("*") if file.is_file()) < 3_000_000


@pytest.mark.parametrize("name", ["cornell", "atrium", "hairball"])
def test_scene_is_complete(name):
    scene = load_scene(DATA / name / "scene.toml")
    assert scene.dropped == {}
    assert scene.notes == ()
    assert scene.defaults.stereo and scene.defaults.eye_distance == 0.063


def test_hairball_has_a_million_triangles():
    scene = load_scene(DATA / "hairball" / "scene.toml")
    counts = {instance.name: len(scene.meshes[instance.mesh].triangles) for instance in scene.instances}
    assert counts == {"hairball": 1_000_000, "floor": 2}
    lowest = {instance.name: world_positions(scene, instance)[:, 1].min() for instance in scene.instances}
    assert lowest["floor"] < lowest["hairball"] < lowest["floor"] + 0.1


def test_cornell_fills_the_frame_of_both_eyes(cornell):
    """The rays through the frame's corners pass through the open side of the room."""
    points = np.concatenate([world_positions(cornell, i) for i in cornell.instances])
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(high - low, [4.0, 2.25, 2.4], atol=1e-5)
    pose, (width, height) = cornell.camera.transform, cornell.defaults.size
    half = np.tan(cornell.camera.fov_y / 2)
    for eye in (-0.5, 0.5):
        origin = pose[:, 3] + pose[:, 0] * eye * cornell.defaults.eye_distance
        for x in (-1, 1):
            for y in (-1, 1):
                direction = pose[:, :3] @ [x * half * width / height, y * half, -1.0]
                at_opening = origin + direction * (high[2] - origin[2]) / direction[2]
                assert (low[:2] < at_opening[:2]).all() and (at_opening[:2] < high[:2]).all()


def test_cornell_is_lit_by_one_lamp_in_the_ceiling(cornell):
    assert cornell.lights == ()
    lit = [
        i
        for i in cornell.instances
        if any(cornell.materials[m].emission != (0, 0, 0) for m in cornell.meshes[i.mesh].material)
    ]
    assert [i.name for i in lit] == ["lamp"]
    positions = world_positions(cornell, lit[0])
    assert triangle_areas(positions[cornell.meshes[lit[0].mesh].triangles]).sum() == pytest.approx(2.8 * 1.6)
    np.testing.assert_allclose(positions[:, 1], 2.25)


def test_cornell_spheres_stand_on_the_floor_and_apart(cornell):
    balls = [world_positions(cornell, i) for i in cornell.instances if i.name == "sphere"]
    assert len(balls) == 2
    for ball in balls:
        assert ball[:, 1].min() == pytest.approx(0.0, abs=1e-6)
    centres = [(ball.max(axis=0) + ball.min(axis=0)) / 2 for ball in balls]
    radii = [np.ptp(ball[:, 1]) / 2 for ball in balls]
    assert np.linalg.norm(centres[0] - centres[1]) > sum(radii)


def test_atrium_is_instanced_and_of_human_scale(atrium):
    assert 50_000 < atrium.triangle_count < 500_000
    stored = sum(len(mesh.triangles) for mesh in atrium.meshes)
    assert stored * 10 < atrium.triangle_count
    assert len(atrium.instances) > 10 * len(atrium.meshes)
    points = np.concatenate([world_positions(atrium, i) for i in atrium.instances])
    np.testing.assert_allclose(points.max(axis=0) - points.min(axis=0), [32.3, 10.3, 17.3], atol=0.1)
    eye = atrium.camera.transform[:, 3]
    assert 1.5 < eye[1] < 1.8
    assert np.linalg.norm(points - eye, axis=1).min() > 0.5


def test_atrium_normals_are_unit_and_agree_with_the_faces(atrium):
    for mesh in atrium.meshes:
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
        corners = mesh.positions[mesh.triangles].astype(float)
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((face[:, None, :] * mesh.normals[mesh.triangles]).sum(axis=(1, 2)) > 0).all(), mesh.name


def test_atrium_textures_are_not_stretched(atrium):
    """Texture area over surface area is one constant for each material, whatever the mesh (leaves excepted)."""
    names = {material.name for material in atrium.materials if material.base_color_texture != NO_TEXTURE}
    assert len(names) > 10
    for index, material in enumerate(atrium.materials):
        if material.base_color_texture == NO_TEXTURE or material.name == "leaf":
            continue
        density, weight = [], []
        for mesh in atrium.meshes:
            triangles = mesh.triangles[mesh.material == index]
            surface = triangle_areas(mesh.positions[triangles].astype(float))
            flat = np.pad(mesh.uvs[triangles].astype(float), [(0, 0), (0, 0), (0, 1)])
            density.append(triangle_areas(flat) / surface)
            weight.append(surface)
        density, weight = np.concatenate(density), np.concatenate(weight)
        usual = np.average(density, weights=weight)
        even = (density > usual / 2.5) & (density < usual * 2.5)
        assert weight[even].sum() > 0.9 * weight.sum(), material.name


def test_atrium_textures_tile(atrium):
    """The step over a texture's border is no larger than the steps inside it (a leaf does not tile)."""
    for texture in atrium.textures:
        assert texture.wrap == ("repeat", "repeat")
        if "leaf" in texture.name:
            continue
        pixels = texture.pixels[..., :3].astype(float)
        for axis in (0, 1):
            step = np.abs(pixels - np.roll(pixels, 1, axis)).mean(axis=(1 - axis, 2))
            assert step[0] <= 1.1 * step[1:].max(), texture.name
