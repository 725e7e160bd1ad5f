"""Materials by graph: what a scene file says of them, and which materials of a mesh file it replaces."""

from pathlib import Path

import numpy as np
import pytest
from gltf_builder import Gltf
from PIL import Image

from clcache import SceneError, load_scene
from clcache.scene.digest import scene_digest
from clcache.scene.emitters import Emitters
from clcache.scene.geometry import Geometry

ROOT = Path(__file__).parents[2]
BALL = '[meshes.ball]\ngenerator = "sphere"\nsubdivisions = 1\n[[instances]]\nmesh = "ball"\nmaterial = "m"\n'
COLOR = "PositionInput Out>0; ColorOutput In<0;\n"
ROUGH = "PositionInput Out>0; Dot A<0 B<0 Out>1; RoughnessOutput In<1;\n"
GLOW = "PositionInput Out>0; EmissionOutput In<0;\n"
PICTURE = 'UVInput Out>0; Image "{}" srgb clamp UV<0 Out>1; ColorOutput In<1;\n'


@pytest.fixture
def folder(tmp_path):
    """A folder with some graphs and two pictures."""
    documents = {
        "color.graph": COLOR,
        "rough.graph": ROUGH,
        "glow.graph": GLOW,
        "picture.graph": PICTURE.format("a.png"),
        "normal.graph": "NormalInput Out>0; NormalOutput In<0;\n",
        "constant.graph": COLOR + "Float1Constant 0.25 Out>1; RoughnessOutput In<1;\n",
    }
    for name, text in documents.items():
        (tmp_path / name).write_text(text)
    for name in ("a.png", "b.png"):
        Image.new("RGB", (2, 2), (10, 20, 30)).save(tmp_path / name)
    return tmp_path


def load(folder, material, rest=BALL, **options):
    (folder / "scene.toml").write_text(f"[materials.m]\n{material}\n{rest}", encoding="utf-8")
    return load_scene(folder / "scene.toml", **options)


def only(folder, material, **options):
    (found,) = load(folder, material, **options).materials
    return found


def refusal(folder, material, rest=BALL):
    with pytest.raises(SceneError) as error:
        load(folder, material, rest)
    message = str(error.value)
    assert "\n" not in message
    return message.removeprefix(str(folder / "scene.toml"))


def test_a_graph_and_what_stands_beside_it(folder):
    material = only(folder, 'graph = "color.graph"\nroughness = 0.3\ndouble_sided = false\nnormal_texture = "a.png"')
    assert dict(material.graph.outputs) == {"base_color": 3} and material.driven == {"base_color"}
    assert (material.roughness, material.double_sided, material.specular) == (0.3, False, 1.0)
    assert material.normal_texture is not None and material.graph_textures == ()


@pytest.mark.parametrize(
    ("keys", "specular"),
    [
        ('graph = "color.graph"', 0.0),
        ('graph = "rough.graph"', 1.0),
        ('graph = "constant.graph"', 1.0),
        ('graph = "constant.graph"\nspecular = 0.5', 0.5),
        ('graph = "color.graph"\nior = 1.4', 1.0),
    ],
)
def test_roughness_asks_for_a_reflection_whoever_gives_it(folder, keys, specular):
    assert only(folder, keys).specular == specular


def test_constants_of_the_document_are_the_materials(folder):
    """But for those that the table gives; and where there is nothing else, there is no graph."""
    material = only(folder, 'graph = "constant.graph"')
    assert material.driven == {"base_color"} and material.roughness == 0.25
    assert only(folder, 'graph = "constant.graph"\nroughness = 0.75').roughness == 0.75
    (folder / "plain.graph").write_text("Float3Constant 0.1 0.2 3 Out>1; ColorOutput In<1; EmissionOutput In<1;\n")
    plain = only(folder, 'graph = "plain.graph"')
    assert plain.graph is None and plain.driven == frozenset()
    assert plain.base_color == pytest.approx((0.1, 0.2, 1.0)) and plain.emission == pytest.approx((0.1, 0.2, 3.0))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ('graph = "color.graph"\nbase_color = [1, 1, 1]', ":3: materials.m.base_color: the graph computes base_color;"),
        ('graph = "color.graph"\nbase_color_texture = "a.png"', ":3: materials.m.base_color_texture: the graph computes"),
        ('\ngraph = "rough.graph"\nroughness = 1', ":4: materials.m.roughness: the graph computes roughness; expected either"),
        ('metallic_roughness_texture = "a.png"\ngraph = "rough.graph"', ":2: materials.m.metallic_roughness_texture: "),
        ('graph = "normal.graph"\nnormal_scale = 2', ":3: materials.m.normal_scale: the graph computes normal;"),
        ('graph = "glow.graph"\nemission = [1, 1, 1]', ":3: materials.m.emission: the graph computes emission;"),
        ('graph = "color.graph"\ngraph_material = "a"', ":1: materials.m: graph_material names a material of a .mtlx file;"),
        ('graph_material = "a"', ":1: materials.m: graph_material names a material of a .mtlx file; expected graph"),
        ('graph = "none.graph"', ":2: materials.m.graph: 'none.graph': no such file"),
        ('graph = "../x.graph"', ":2: materials.m.graph: '../x.graph' leaves the scene's folder"),
        ('grapf = "color.graph"', ":2: materials.m.grapf: unknown key; did you mean graph?"),
        ("graph = 1", ":2: materials.m.graph: 1 is wrong; expected a valid string"),
    ],
)  # fmt: skip
def test_errors_name_the_line(folder, keys, message):
    assert refusal(folder, keys).startswith(message)


def test_errors_of_a_document_name_its_own_line(folder):
    (folder / "color.graph").write_text("\nPositionInput Out>0;\nColorOutput In<1;\n")
    assert "color.graph:3: ColorOutput: " in refusal(folder, 'graph = "color.graph"')


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        ("none.png", "'none.png': no such file"),
        ("../a.png", "leaves the scene's folder"),
        ("color.graph", "not a picture"),
    ],
)
def test_errors_of_pictures_name_the_node(folder, picture, message):
    (folder / "picture.graph").write_text("\n" + PICTURE.format(picture))
    found = refusal(folder, 'graph = "picture.graph"')
    assert "picture.graph:2: Image: " in found and message in found


def test_pictures_are_relative_to_the_document(folder):
    """In the scene's folder, or below it; with allow_outside anywhere."""
    (folder / "graphs").mkdir()
    (folder / "graphs" / "p.graph").write_text(PICTURE.format("../a.png"))
    scene = load(folder, 'graph = "graphs/p.graph"')
    assert [(t.name, t.srgb, t.wrap) for t in scene.textures] == [("../a.png", True, ("clamp", "clamp"))]
    (folder / "inner").mkdir()
    with pytest.raises(SceneError, match="leaves the scene's folder"):
        load(folder / "inner", 'graph = "../picture.graph"')
    assert len(load(folder / "inner", 'graph = "../picture.graph"', allow_outside=True).textures) == 1


def test_what_is_shared_is_there_once(folder):
    """One document, several materials; one picture, in a graph and beside it."""
    scene = load(
        folder,
        'graph = "picture.graph"\nroughness = 0.5\n'
        '[materials.n]\ngraph = "picture.graph"\n'
        '[materials.o]\nbase_color_texture = { file = "a.png", wrap = "clamp" }\n'
        '[materials.unused]\nbase_color_texture = "b.png"\n',
        BALL + '[[instances]]\nmesh = "ball"\nmaterial = "n"\n[[instances]]\nmesh = "ball"\nmaterial = "o"\n',
    )
    m, n, o = scene.materials
    assert m.graph is n.graph and m.roughness != n.roughness
    assert [t.name for t in scene.textures] == ["a.png"]
    assert m.graph_textures == n.graph_textures == (o.base_color_texture,)


def test_pictures_of_graphs_keep_their_number(folder):
    """Also where textures before them go, being those of materials that nothing shows, and where mesh files bring others."""
    (folder / "picture.graph").write_text(PICTURE.format("b.png"))
    (folder / "t.obj").write_text("mtllib t.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl t\nf 1/1 2/1 3/1\n")
    (folder / "t.mtl").write_text("newmtl t\nmap_Kd a.png\n")
    scene = load(
        folder,
        'base_color_texture = "a.png"\n[materials.n]\ngraph = "picture.graph"',
        '[meshes.t]\nfile = "t.obj"\n[meshes.b]\ngenerator = "box"\n[[instances]]\nmesh = "t"\n'
        '[[instances]]\nmesh = "b"\nmaterial = "n"\n',
    )
    (by_graph,) = [m for m in scene.materials if m.graph]
    assert [scene.textures[use.index].name for use in by_graph.graph_textures] == ["b.png"]
    assert sorted(t.name for t in scene.textures) == ["a.png", "b.png"]


def test_light_of_graphs_is_not_sampled(folder):
    """Its rays find it; and so a scene with nothing else is lit, and gets no light of its own."""
    scene = load(folder, 'graph = "glow.graph"')
    assert scene.materials[0].is_emissive and not scene.lights and not scene.environment.radiance.any()
    emitters = Emitters.of(scene, Geometry.of(scene))
    assert len(emitters.records) == 0 and not emitters.material_density.any()


def test_digests_tell_graphs_apart_by_what_they_compute(folder):
    before = scene_digest(load(folder, 'graph = "constant.graph"'))
    (folder / "moved").mkdir()
    (folder / "moved" / "c.graph").write_text(
        "# the same, written otherwise\n\n" + (folder / "constant.graph").read_text()
    )
    assert scene_digest(load(folder, 'graph = "moved/c.graph"')) == before
    digests = {before}
    for text in (COLOR.replace("Color", "Normal"), COLOR.replace("Position", "Normal")):
        (folder / "constant.graph").write_text(text)
        digests.add(scene_digest(load(folder, 'graph = "constant.graph"')))
    assert len(digests) == 3


# Materials of mesh files

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def room(folder):
    """A file of two materials, and a triangle of none."""
    (folder / "room.mtl").write_text("newmtl Wall paint\nKd 1 0 0\nnewmtl Wood\nKd 0 1 0\n")
    (folder / "room.obj").write_text(
        f"mtllib room.mtl\n{QUAD}f 1 2 4\nusemtl Wall paint\nf 1 2 3\nusemtl Wood\nf 1 3 4\n"
    )


def placed(materials, file="room.obj", rest=""):
    return f'[meshes.r]\nfile = "{file}"\nmaterials = {materials}\n[[instances]]\nmesh = "r"\n{rest}'


def test_materials_of_an_obj_file_are_replaced_by_name(folder):
    room(folder)
    scene = load(folder, 'graph = "color.graph"', placed('{ "Wall paint" = "m" }'))
    names = {m.name: m for m in scene.materials}
    assert names.keys() == {"m", "Wood", "default"} and names["m"].graph is not None
    of_triangle = sorted(scene.materials[k].name for mesh in scene.meshes for k in mesh.material)
    assert of_triangle == ["Wood", "default", "m"]


def test_materials_of_a_gltf_file_are_replaced_by_name(folder):
    """One of several primitives of a mesh; all materials of one name; those of no name by their place."""
    file = Gltf()
    file.json["materials"] = [{"name": "a"}, {"name": "b"}, {"name": "a"}, {}]
    file.mesh(*(file.primitive(np.array([[0, 0, k], [1, 0, k], [0, 1, k]]), material=k) for k in range(4)))
    file.write(folder / "t.glb")
    scene = load(
        folder, 'graph = "color.graph"\n[materials.n]', placed('{ a = "m", "materials[3]" = "n" }', "t.glb")
    )  # fmt: skip
    at = {}
    for mesh in scene.meshes:
        for triangle, material in zip(mesh.triangles, mesh.material, strict=True):
            at[float(mesh.positions[triangle[0], 2])] = scene.materials[material].name
    assert at == {0.0: "m", 1.0: "b", 2.0: "m", 3.0: "n"}


def test_an_instance_paints_over_what_is_replaced(folder):
    room(folder)
    scene = load(
        folder, 'graph = "color.graph"\n[materials.n]', placed('{ Wood = "m" }', rest='material = "n"\n')
    )  # fmt: skip
    assert [m.name for m in scene.materials] == ["n"]


@pytest.mark.parametrize(
    ("materials", "message"),
    [
        ('{ Wod = "m" }', ":5: meshes.r.materials.Wod: no 'Wod' in the materials of 'room.obj'; did you mean 'Wood'?"),
        ('{ Zzzzz = "m" }', "; expected one of default, Wall paint, Wood"),
        ('{ Wood = "mm" }', ":5: meshes.r.materials.Wood: no 'mm' in [materials]; did you mean 'm'?"),
        ('{ Wood = "zzz" }', ":5: meshes.r.materials.Wood: no 'zzz' in [materials]; expected one of m"),
        ('{ "Wall paint" = 1 }', ":5: meshes.r.materials.Wall paint: 1 is wrong; expected a valid string"),
        ('"m"', ":5: meshes.r.materials: 'm' is wrong; expected a valid dictionary"),
    ],
)
def test_errors_of_replaced_materials_name_the_line(folder, materials, message):
    room(folder)
    assert message in refusal(folder, 'graph = "color.graph"', placed(materials))


def test_the_line_is_the_names_own(folder):
    room(folder)
    text = '[meshes.r]\nfile = "room.obj"\n[meshes.r.materials]\nWood = "m"\n\n"Wall\\npaint" = "m"\n[[instances]]\nmesh = "r"\n'
    assert refusal(folder, "roughness = 1", text).startswith(":8: meshes.r.materials.Wall paint: no 'Wall\\npaint' in")


def test_generators_have_no_materials_to_replace(folder):
    text = '[meshes.r]\ngenerator = "box"\nmaterials = { a = "m" }\n[[instances]]\nmesh = "r"\n'
    assert ":5: meshes.r.materials: unknown key" in refusal(folder, "roughness = 1", text)


def test_many_names_are_not_all_listed(folder):
    names = [f"q{k:02}" for k in range(60)]
    (folder / "room.mtl").write_text("".join(f"newmtl {name}\nKd 1 0 0\n" for name in names))
    faces = "".join(f"usemtl {name}\nf 1 2 3\n" for name in names)
    (folder / "room.obj").write_text(f"mtllib room.mtl\n{QUAD}{faces}")
    message = refusal(folder, "roughness = 1", placed('{ Wood = "m" }'))
    assert "expected one of default, q00, q01" in message and message.endswith(", ...") and len(message) < 300


# MaterialX


SEVERAL = """<?xml version="1.0"?>
<materialx version="1.39">
  <nodegraph name="NG">
    <position name="place" type="vector3" />
    <convert name="color" type="color3"><input name="in" type="vector3" nodename="place" /></convert>
    <output name="out" type="color3" nodename="color" />
  </nodegraph>
  <gltf_pbr name="matt" type="surfaceshader">
    <input name="base_color" type="color3" nodegraph="NG" output="out" />
    <input name="roughness" type="float" value="0.75" />
  </gltf_pbr>
  <standard_surface name="coated" type="surfaceshader"><input name="coat" type="float" value="0.5" /></standard_surface>
  <surfacematerial name="Matt" type="material"><input name="surfaceshader" type="surfaceshader" nodename="matt" /></surfacematerial>
  <surfacematerial name="Coated" type="material"><input name="surfaceshader" type="surfaceshader" nodename="coated" /></surfacematerial>
</materialx>
"""


@pytest.fixture
def several(folder):
    pytest.importorskip("MaterialX")
    (folder / "several.mtlx").write_text(SEVERAL)
    return folder


def test_one_of_several_materials_of_a_document(several):
    """Its constants are the material's, unless the table says otherwise, and what is left out is a note."""
    rest = BALL + '[[instances]]\nmesh = "ball"\nmaterial = "n"\n'
    keys = 'graph = "several.mtlx"\ngraph_material = "{}"'
    scene = load(several, keys.format("Matt") + f"\nior = 1.8\n[materials.n]\n{keys.format('Coated')}", rest)
    matt, coated = scene.materials
    assert matt.driven == {"base_color"} and (matt.roughness, matt.ior, matt.specular) == (0.75, 1.8, 1.0)
    assert coated.graph is None and coated.specular == 1.0
    assert any("several.mtlx" in note and "coat" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("", "several.mtlx: has 2 materials; expected the name of one of them: Matt, Coated"),
        ('\ngraph_material = "Mat"', "several.mtlx: has no material Mat; expected one of Matt, Coated"),
        (
            '\ngraph_material = "Matt"\nbase_color = [1, 1, 1]',
            ":4: materials.m.base_color: the graph computes base_color; expected either, not both",
        ),
    ],
)
def test_errors_of_documents_with_several_materials(several, more, message):
    assert message in refusal(several, 'graph = "several.mtlx"' + more)


def test_the_room_of_graphs():
    """The scene in data/: all that is seen is by graph, and nothing is left out."""
    pytest.importorskip("MaterialX")
    scene = load_scene(ROOT / "data" / "graphs" / "scene.toml")
    assert len(scene.materials) == 6 and all(m.graph for m in scene.materials) and not scene.notes
    assert {"uv"} in (reads := [m.graph.reads for m in scene.materials]) and {"position"} in reads
    assert len(scene.textures) == 4 and f"{scene.triangle_count:,}" in (ROOT / "data" / "README.md").read_text()
