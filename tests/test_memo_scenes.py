"""The scenes whose materials are graphs (tools/memo_scenes.py)."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from clcache import SettingError, load_scene

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "tools"))
from box_mapping import BoxMapped  # noqa: E402
from memo_scenes import EFFORTS, is_replaced, main, picture_of, write_scene  # noqa: E402

CITY = ROOT / "data" / "city" / "scene.toml"


@pytest.fixture(scope="module", params=EFFORTS)
def written(request, tmp_path_factory):
    """The city with graphs, and what was said of it."""
    out = tmp_path_factory.mktemp(request.param) / "city"
    said = write_scene(CITY, out, request.param, 3, 4)
    return load_scene(out / "scene.toml"), said


def test_each_material_has_a_graph_of_its_own(written):
    scene, said = written
    old = {m.name: m for m in load_scene(CITY).materials}
    assert {m.name for m in scene.materials} == {*old}
    graphs = {m.name: m.graph for m in scene.materials if m.graph}
    assert {*graphs} == {name for name, m in old.items() if is_replaced(m) and name != "sea"}
    assert len({graph.source for graph in graphs.values()}) == len(graphs) == 15
    assert all("uv" in graph.reads and "normal" not in graph.reads for graph in graphs.values())
    assert "15 graphs, 3 of them MaterialX; 4 primitives got texture coordinates; without a graph: " in said


def test_colours_are_about_those_of_the_materials(written):
    scene, _ = written
    old = load_scene(CITY)
    uv = np.random.default_rng(2).uniform(-400, 400, (4000, 2)).astype(np.float32)
    small = np.full((len(uv), 2), 1e-3, np.float32)
    graphs = {m.name: m.graph for m in scene.materials if m.graph}
    for material in old.materials:
        if material.name not in graphs:
            continue
        use = material.base_color_texture
        mean = np.array(picture_of("", old.textures[use.index]).mean if use else (1, 1, 1)) * material.base_color
        color = graphs[material.name].evaluate(uv, small, small[:, ::-1])["base_color"].mean(axis=0)
        assert np.abs(color - mean).max() < 0.25 * mean.max(), material.name


def test_texture_coordinates_lie_along_the_axis_that_a_triangle_faces(tmp_path):
    shutil.copytree(CITY.parent, tmp_path / "city")
    file = tmp_path / "city" / "city.gltf"
    mapped = BoxMapped(file)
    mapped.write(file)
    assert mapped.mapped == 4
    scene, old = load_scene(tmp_path / "city" / "scene.toml"), load_scene(CITY)
    bare = [i for i, m in enumerate(old.materials) if m.name in ("iron", "lantern")]
    found = 0
    for a, b in zip(scene.meshes, old.meshes, strict=True):
        corners = a.positions[a.triangles].astype(float)
        assert np.array_equal(corners, b.positions[b.triangles])
        if b.normals is not None:
            assert np.array_equal(a.normals[a.triangles], b.normals[b.triangles])
        rows = np.isin(a.material, bare)
        if rows.any():
            u, v = (np.diff(a.uvs[a.triangles[rows]].astype(float), axis=1)[:, k] for k in (0, 1))
            edges = np.diff(corners[rows], axis=1)
            seen = np.abs(np.cross(edges[:, 0], edges[:, 1])).max(axis=1)
            assert np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) == pytest.approx(seen)
            found += rows.sum()
    assert found > 0


def test_the_same_again(tmp_path):
    for name in ("one", "other"):
        write_scene(CITY, tmp_path / name, "memory", 2, 3)
    files = sorted(p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*") if p.is_file())
    assert len([f for f in files if f.suffix == ".mtlx"]) == 2
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "other" / file).read_bytes()


def test_what_is_there_is_left_alone(tmp_path, capsys):
    (tmp_path / "kept").write_text("mine")
    assert main([str(CITY), "-o", str(tmp_path)]) == 2
    assert "is there; expected a new folder" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]


def test_a_scene_without_gltf_materials_leaves_nothing_behind(tmp_path):
    with pytest.raises(SettingError, match="no material of a glTF file can be replaced"):
        write_scene(ROOT / "data" / "cornell" / "scene.toml", tmp_path / "out", "memory", 0, 3)
    assert list(tmp_path.iterdir()) == []
