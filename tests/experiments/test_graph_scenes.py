"""The scenes whose materials are all graphs."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from clcache import Error, SettingError, load_scene
from clcache.experiments.box_mapping import BoxMapped
from clcache.experiments.graph_scenes import EFFORTS, MATERIALX, fill_folder, is_replaced, picture_of, with_graphs
from clcache.experiments.job import open_scene, scene_entry

DATA = Path(__file__).resolve().parents[2] / "data"
CITY = DATA / "city" / "scene.toml"


@pytest.fixture(scope="module", params=EFFORTS)
def made(request):
    """The city with graphs of a kind."""
    return with_graphs(CITY, request.param)


def test_each_material_has_a_graph_of_its_own(made):
    old = {m.name: m for m in load_scene(CITY).materials}
    assert {m.name for m in made.materials} == {*old}
    graphs = {m.name: m.graph for m in made.materials if m.graph}
    assert {*graphs} == {name for name, m in old.items() if is_replaced(m) and name != "sea"}
    assert len({graph.source for graph in graphs.values()}) == len(graphs) == 15
    assert all("uv" in graph.reads and "normal" not in graph.reads for graph in graphs.values())
    assert made.file == str(CITY)


@pytest.mark.parametrize("kind", EFFORTS)
def test_colours_are_about_those_of_the_materials(kind, tmp_path):
    made, old = load_scene(fill_folder(CITY, tmp_path / "city", kind)), load_scene(CITY)
    uv = np.random.default_rng(2).uniform(-400, 400, (1000, 2)).astype(np.float32)
    small = np.full((len(uv), 2), 1e-3, np.float32)
    graphs = {m.name: m.graph for m in made.materials if m.graph}
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
        fill_folder(CITY, tmp_path / name, "memory")
    files = sorted(p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*") if p.is_file())
    assert len([f for f in files if f.suffix == ".mtlx"]) == MATERIALX
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "other" / file).read_bytes()


def test_jobs_are_told_apart_by_the_kind_and_open_what_they_were_told_of():
    entries = [scene_entry(CITY, kind) for kind in (None, *EFFORTS)]
    assert len({entry["digest"] for entry in entries}) == 3
    assert [entry.get("graphs") for entry in entries] == [None, *EFFORTS]
    assert sum(material.graph is not None for material in open_scene(entries[1]).materials) == 15
    with pytest.raises(Error, match="is not the scene that the job was made for"):
        open_scene(entries[1] | {"graphs": "compute"})


def test_a_scene_without_gltf_materials_is_refused():
    with pytest.raises(SettingError, match="cornell/scene.toml: no material of a glTF file can be replaced"):
        with_graphs(DATA / "cornell" / "scene.toml", "memory")
