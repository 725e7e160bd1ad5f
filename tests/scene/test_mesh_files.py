import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from clcache.errors import SceneError
from clcache.scene import load_scene

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def obj(tmp_path, text, **others):
    for name, content in others.items():
        (tmp_path / name.replace("_", ".")).write_text(content)
    (tmp_path / "a.obj").write_text(text)
    return tmp_path / "a.obj"


def refusal(path):
    with pytest.raises(SceneError) as error:
        load_scene(path)
    message = str(error.value)
    assert "\n" not in message and message.startswith((str(path), path.name, "m.mtl"))
    return message


def world_triangles(scene):
    return np.concatenate(
        [
            scene.meshes[i.mesh].positions[scene.meshes[i.mesh].triangles] @ i.transform[:, :3].T + i.transform[:, 3]
            for i in scene.instances
        ]
    )


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "off", "glb"])
def test_every_kind_gives_the_triangles_that_trimesh_wrote(tmp_path, kind):
    mesh = trimesh.creation.torus(major_radius=2, minor_radius=0.5)
    mesh.export(tmp_path / f"torus.{kind}")
    scene = load_scene(tmp_path / f"torus.{kind}")
    ours, theirs = world_triangles(scene), mesh.triangles
    assert ours.shape == theirs.shape
    middles = [np.sort(np.round(t.mean(axis=1) @ [1, 10, 100], 3)) for t in (ours, theirs)]
    assert np.allclose(*middles, atol=2e-3)
    assert scene.dropped == {}


def test_normals_are_those_of_the_file_or_none(tmp_path):
    flat = load_scene(obj(tmp_path, SQUARE + "f 1 2 3\n")).meshes[0]
    smooth = load_scene(obj(tmp_path, SQUARE + "vn 0 0 3\nvn 0 4 0\nf 1//1 2//1 3//2\n")).meshes[0]
    assert flat.normals is None
    assert sorted(smooth.normals.tolist()) == [[0, 0, 1], [0, 0, 1], [0, 1, 0]] or sorted(smooth.normals.tolist()) == [
        [0, 1, 0], [0, 0, 1], [0, 0, 1],
    ]  # fmt: skip


def test_polygons_are_split(tmp_path):
    mesh = load_scene(obj(tmp_path, SQUARE + "v 0.5 2 0\nf 1 2 3 4\nf 4 3 5\n"))
    assert mesh.triangle_count == 3


def test_materials_of_obj(tmp_path):
    Image.new("RGB", (4, 2), (0, 255, 0)).save(tmp_path / "green one.png")
    mtl = """newmtl plain
Kd 0.1 0.2 0.3
newmtl lamp
Kd 0 0 0
Ke 4 5 6.5   # bright
newmtl painted
Kd 1.5 1 1
map_Kd -s 1 1 1 -clamp on green one.png
newmtl glass
d 0.3
"""
    text = "mtllib m.mtl\n" + SQUARE + "vt 0 0\nvt 1 0\nvt 1 0.75\n"
    text += "usemtl lamp\nf 1 2 3\nusemtl painted\nf 1/1 2/2 3/3\nusemtl nowhere\nf 1 3 4\nusemtl glass\nf 2 3 4\n"
    scene = load_scene(obj(tmp_path, text, m_mtl=mtl))
    by_name = {m.name: m for m in scene.materials}
    assert set(by_name) == {"lamp", "painted", "glass", "default"}  # what nothing uses is left out
    assert by_name["lamp"].emission == (4, 5, 6.5) and by_name["lamp"].base_color == (0, 0, 0)
    assert by_name["painted"].base_color == (1, 1, 1)
    texture = scene.textures[by_name["painted"].base_color_texture.index]
    assert texture.pixels.shape == (2, 4, 4) and texture.wrap == ("clamp", "clamp")
    assert by_name["glass"].base_color_texture is None
    assert by_name["glass"].thin and abs(by_name["glass"].transmission - 0.7) < 1e-12
    painted = next(m for m in scene.meshes if scene.materials[m.material[0]].name == "painted")
    corner = painted.positions.tolist().index([1, 1, 0])
    assert painted.uvs[corner].tolist() == [1, 0.25]  # v is counted from the first row, in OBJ from the last


@pytest.mark.parametrize("face", ["f 1 2 5", "f 0 1 2", "f 1 2 -5", "f 1//1 2//1 3//9", "f 1/1 2/2 3/3"])
def test_obj_references_out_of_range_are_refused(tmp_path, face):
    message = refusal(obj(tmp_path, SQUARE + "vn 0 0 1\nvt 0 0\nf 1 2 3\n" + face + "\n"))
    assert "reference" in message and "expected" in message


def test_negative_references_count_from_the_end(tmp_path):
    mesh = load_scene(obj(tmp_path, SQUARE + "f -4 -3 -2\n")).meshes[0]
    assert np.array_equal(mesh.positions[mesh.triangles[0]], [[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    again = SQUARE + "f -4 -3 -2\n"
    assert "backwards" in refusal(obj(tmp_path, again + again))


@pytest.mark.parametrize("number", ["nan", "inf", "1e39"])
def test_positions_that_are_not_finite_are_refused(tmp_path, number):
    message = refusal(obj(tmp_path, f"v 0 0 0\nv 1 0 0\nv 0 {number} 0\nf 1 2 3\n"))
    assert "position 2 is" in message and "expected finite" in message


def test_ply_with_indices_out_of_range_is_refused(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 7\n"
    )
    assert "triangle 1 uses vertex 7; expected 0 .. 2" in refusal(path)


def test_zero_area_triangles_are_dropped_and_counted(tmp_path):
    scene = load_scene(obj(tmp_path, SQUARE + "f 1 2 3\nf 1 1 2\nf 2 3 2\n"))
    assert scene.triangle_count == 1 and scene.dropped == {"zero-area triangles": 2}


def test_nothing_but_zero_area_is_no_scene(tmp_path):
    assert "no triangles (left out: 1 zero-area triangles)" in refusal(obj(tmp_path, SQUARE + "f 1 1 2\n"))


@pytest.mark.parametrize("text", ["", SQUARE, "f 1 2 3\n", "hello\n"])
def test_obj_without_triangles_is_refused(tmp_path, text):
    refusal(obj(tmp_path, text))


@pytest.mark.parametrize("format", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(("vertices", "faces"), [(4_000_000_000, 1), (3, 4_000_000_000), (10**18, 1)])
def test_ply_counts_beyond_the_file_are_refused(tmp_path, format, vertices, faces):
    path = tmp_path / "a.ply"
    header = (
        f"ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + bytes(100))
    refusal(path)


def test_stl_count_beyond_the_file_is_refused(tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(bytes(80) + (4_000_000_000).to_bytes(4, "little") + bytes(50))
    refusal(path)


@pytest.mark.parametrize("kind", ["ply", "stl", "off", "obj", "glb"])
@pytest.mark.parametrize("part", [0.02, 0.4, 0.9])
def test_truncated_files_are_refused_or_read_in_part(tmp_path, kind, part):
    path = tmp_path / f"a.{kind}"
    trimesh.creation.icosphere(subdivisions=1).export(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    if kind == "obj" and part > 0.5:  # text that ends early is a smaller mesh, if no reference is cut
        assert load_scene(path).triangle_count < 80
    else:
        refusal(path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("Kd red", "Kd: 'red' is wrong"),
        ("Kd 1 2", "Kd: '1 2' is wrong"),
        ("Ke -1 0 0", "Ke: '-1 0 0' is wrong"),
        ("Ke nan 0 0", "Ke"),
        ("map_Kd none.png", "map_Kd: 'none.png': no such file"),
        ("map_Kd ../x.png", "map_Kd: '../x.png' leaves the scene's folder"),
        ("map_Kd m.mtl", "not a picture"),
    ],
)
def test_mtl_errors_name_file_and_line(tmp_path, line, message):
    text = refusal(obj(tmp_path, "mtllib m.mtl\n" + SQUARE + "f 1 2 3\n", m_mtl="newmtl a\n" + line + "\n"))
    assert text.startswith("m.mtl:2: ") and message in text


def test_a_missing_mtl_is_refused_with_its_line(tmp_path):
    assert "a.obj:2: mtllib: 'none.mtl': no such file" in refusal(obj(tmp_path, "#\nmtllib none.mtl\n" + SQUARE))


def test_references_outside_the_folder(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 0.25 0 0\n")
    (inner / "link.mtl").symlink_to(tmp_path / "m.mtl")
    for reference in ("../m.mtl", str(tmp_path / "m.mtl"), "link.mtl", "..\\m.mtl"):
        path = obj(inner, f"mtllib {reference}\n{SQUARE}usemtl a\nf 1 2 3\n")
        assert "leaves the scene's folder" in refusal(path)
        scene = load_scene(path, allow_outside=True)
        assert scene.materials[0].base_color == (0.25, 0, 0)


@pytest.mark.parametrize("reference", ["file:///etc/hostname", "http://localhost/m.mtl", "https://localhost/m.mtl"])
@pytest.mark.parametrize("allow_outside", [False, True])
def test_urls_are_never_followed(tmp_path, reference, allow_outside):
    with pytest.raises(SceneError, match="is a URL"):
        load_scene(obj(tmp_path, f"mtllib {reference}\n{SQUARE}f 1 2 3\n"), allow_outside=allow_outside)


@pytest.mark.parametrize("name", ["none.obj", "none.toml", "none.glb", "."])
def test_a_missing_file_is_refused(tmp_path, name):
    with pytest.raises(SceneError, match="no such file|not a regular file"):
        load_scene(tmp_path / name)


@pytest.mark.parametrize("name", ["a.txt", "a", "a.zip", "a.exr"])
def test_kinds_that_are_not_read_are_refused(tmp_path, name):
    (tmp_path / name).write_text("x")
    with pytest.raises(SceneError, match=r"expected \.toml, \.gltf"):
        load_scene(tmp_path / name)


def test_pictures_are_looked_for_beside_the_mtl_file(tmp_path):
    (tmp_path / "sub").mkdir()
    Image.new("RGB", (1, 1), (9, 8, 7)).save(tmp_path / "sub" / "p.png")
    (tmp_path / "sub" / "m.mtl").write_text("newmtl a\nmap_Kd p.png\n")
    scene = load_scene(obj(tmp_path, "mtllib sub/m.mtl\n" + SQUARE + "usemtl a\nf 1 2 3\n"))
    assert scene.textures[0].pixels.tolist() == [[[9, 8, 7, 255]]]


def test_ply_with_a_texture(tmp_path):
    Image.new("RGB", (1, 1), (9, 8, 7)).save(tmp_path / "p.png")
    header = "ply\nformat ascii 1.0\ncomment TextureFile p.png\nelement vertex 3\n"
    header += "".join(f"property float {name}\n" for name in ("x", "y", "z", "s", "t"))
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = tmp_path / "a.ply"
    path.write_text(header + "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n")
    scene = load_scene(path)
    assert scene.materials[0].base_color_texture.index == 0 and scene.textures[0].pixels[0, 0, 0] == 9
    mesh = scene.meshes[0]
    assert np.array_equal(mesh.uvs[:, 0], mesh.positions[:, 0]) and np.array_equal(
        mesh.uvs[:, 1], 1 - mesh.positions[:, 1]
    )
    (tmp_path / "p.png").unlink()
    assert "TextureFile: 'p.png': no such file" in refusal(path)


def test_lines_may_go_on_and_end_as_on_windows(tmp_path):
    text = (SQUARE + "f 1 2 \\\n3 4\n").replace("\n", "\r\n")
    path = tmp_path / "a.obj"
    path.write_bytes(text.encode())
    assert load_scene(path).triangle_count == 2


def test_comments_and_indentation(tmp_path):
    text = "# a\n  v 0 0 0 # one\n\tv 1 0 0\nv 0 1 0#x\n f 1 2 3 # face\n#f 1 2 9\n"
    mesh = load_scene(obj(tmp_path, text)).meshes[0]
    assert np.array_equal(mesh.positions[mesh.triangles[0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_ascii_ply_that_ends_early_is_refused(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(
        trimesh.exchange.ply.export_ply(trimesh.creation.icosphere(subdivisions=1), encoding="ascii")[:-200]
    )
    refusal(path)


def test_the_library_prints_nothing():
    code = "import logging, clcache.scene.meshfile; logging.getLogger('trimesh').warning('x')"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2]
    )
    assert result.stderr == ""


def test_a_word_in_an_ascii_stl_does_not_end_it(tmp_path):
    corners = ["0 0 0", "1 0 0", "0 1 0"]
    facet = "facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {c}\n" for c in corners) + "endloop\nendfacet\n"
    path = tmp_path / "a.stl"
    path.write_text("solid a\n" + 2 * facet + "endsolid\n")
    assert load_scene(path).triangle_count == 2
    path.write_text("solid a\n" + facet + facet.replace("vertex 0 0 0", "vertex x 0 0") + "endsolid\n")
    refusal(path)


def test_a_large_obj(tmp_path):
    n = 256
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel() + 1
    quads = np.column_stack([first, first + 1, first + n + 1, first + n])
    vertices = "".join(f"v {a} {b} 0\n" for a, b in zip(x.ravel(), y.ravel(), strict=True))
    faces = "".join(f"f {a} {b} {c} {d}\n" for a, b, c, d in quads)
    mesh = load_scene(obj(tmp_path, vertices + faces)).meshes[0]
    corners = mesh.positions[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert len(area) == 2 * 255**2 and np.allclose(area.sum(), 255**2)
