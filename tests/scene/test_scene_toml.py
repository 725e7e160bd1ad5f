import math

import numpy as np
import pytest
from gltf_builder import Gltf
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from clcache.errors import SceneError
from clcache.scene import Defaults, DirectionalLight, PointLight, load_scene

BALL = '[meshes.ball]\ngenerator = "sphere"\nsubdivisions = 1\n[[instances]]\nmesh = "ball"\n'


def write(folder, text, name="scene.toml"):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def load(folder, text, **options):
    return load_scene(write(folder, text), **options)


def refusal(folder, text):
    """The message, without the path of the file that it begins with."""
    path = write(folder, text)
    with pytest.raises(SceneError) as error:
        load_scene(path)
    message = str(error.value)
    assert message.startswith(str(path)) and "\n" not in message
    return message[len(str(path)) :]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One folder for tests with many examples."""
    return tmp_path_factory.mktemp("scenes")


def test_everything_that_a_file_can_say(tmp_path):
    Image.new("RGB", (2, 2), (1, 2, 3)).save(tmp_path / "p.png")
    scene = load(
        tmp_path,
        """
[camera]
position = [0, 1, 4]
look_at = [0, 1, 0]
fov_y = 90
near = 0.5
[environment]
color = [0.1, 0.2, 0.3]
[materials.red]
base_color = [0.63, 0.065, 0.05]
base_color_texture = "p.png"
emission = [1, 2, 3]
[meshes.ball]
generator = "sphere"
radius = 0.5
subdivisions = 2
[meshes.hair]
generator = "hairball"
triangles = 100
[[instances]]
mesh = "ball"
material = "red"
translation = [0, 0.4, 0]
[[instances]]
mesh = "hair"
scale = 2
[[lights]]
type = "point"
position = [0, 1.9, 0]
intensity = [5, 5, 5]
[[lights]]
type = "directional"
direction = [0, -2, 0]
irradiance = [1, 1, 1]
[render]
size = [320, 200]
frames = [2, 5]
fps = 24
stereo = true
eye_distance = 0.07
spp = 16
seed = 7
method = "pathtrace"
[render.settings]
"pathtrace.bounces" = 5
pathtrace.roulette = 4
""",
    )
    assert scene.camera.fov_y == pytest.approx(math.pi / 2) and scene.camera.near == 0.5
    assert np.allclose(scene.camera.transform, [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 4]])
    assert np.allclose(scene.environment.radiance, (0.1, 0.2, 0.3))
    red, default = scene.materials
    assert (red.name, red.base_color, red.emission) == ("red", (0.63, 0.065, 0.05), (1, 2, 3))
    assert scene.textures[red.base_color_texture.index].pixels[0, 0].tolist() == [1, 2, 3, 255]
    assert default.base_color == (0.8, 0.8, 0.8)
    ball, hair = scene.instances
    assert len(scene.meshes[ball.mesh].triangles) == 320 and len(scene.meshes[hair.mesh].triangles) == 100
    assert (scene.meshes[ball.mesh].material == 0).all() and (scene.meshes[hair.mesh].material == 1).all()
    assert np.array_equal(ball.transform, [[1, 0, 0, 0], [0, 1, 0, 0.4], [0, 0, 1, 0]])
    assert np.array_equal(hair.transform, [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]])
    assert scene.lights == (PointLight((0, 1.9, 0), (5, 5, 5)), DirectionalLight((0, -1, 0), (1, 1, 1)))
    given_settings = {"pathtrace.bounces": 5, "pathtrace.roulette": 4}
    assert scene.defaults == Defaults((320, 200), (2, 5), 24.0, True, 0.07, 16, 7, "pathtrace", given_settings)
    assert scene.notes == ()


def test_what_a_file_leaves_out_is_chosen_and_said(tmp_path):
    scene = load(tmp_path, BALL)
    assert scene.defaults == Defaults()
    assert len(scene.lights) == 1 and scene.environment.radiance.min() > 0
    assert [note.split(" in the file")[0] for note in scene.notes] == ["no camera", "no light"]


@pytest.mark.parametrize(
    "light",
    ["[environment]\ncolor = [0, 0, 0]", '[[lights]]\ntype = "point"\nposition = [0, 9, 0]\nintensity = [1, 1, 1]'],
)
def test_a_file_with_light_gets_no_other(tmp_path, light):
    scene = load(tmp_path, BALL + light)
    assert not scene.environment.radiance.any() and len(scene.lights) == light.count("lights")


# Errors name file, line and key


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[materials.red]\ncolour = [1, 0, 0]", ":2: materials.red.colour: unknown key; did you mean base_color?"),
        ("[materials.red]\nemision = [1, 0, 0]", ":2: materials.red.emision: unknown key; did you mean emission?"),
        ("\n\n[camra]\n", ":3: camra: unknown key; did you mean camera?"),
        ("[render]\nzzz = 1", ":2: render.zzz: unknown key; expected one of size, frames, fps"),
        ('[meshes.a]\ngenerator = "sphere"\nsize = 1', ":3: meshes.a.size: unknown key"),
        ("[meshes.a]\ngenerator = 'cone'", ":1: meshes.a: expected file = a path, or generator = sphere, box"),
        ("[meshes.a]\nradius = 1", ":1: meshes.a: expected file = a path, or generator"),
        ("[meshes.a]\nfile = 'x'\ngenerator = 'box'", ":3: meshes.a.generator: unknown key"),
        ("meshes.a = 3", ":1: meshes.a: 3 is wrong; expected file"),
        ("[[lights]]\ntype = 'area'", ":1: lights.0: expected type = point, directional or spot"),
        ("[[lights]]\ntype = 'point'\nposition = [0, 0, 0]", ":1: lights.0: intensity is missing"),
        (
            "[materials.a]\nbase_color = [0.1, 0.2]",
            ":2: materials.a.base_color: [0.1, 0.2] is wrong; expected a list of 3",
        ),
        ("[materials.a]\nbase_color = 'red'", ":2: materials.a.base_color: 'red' is wrong; expected a list of 3"),
        ("[materials.a]\nbase_color = [0.1, 0.2,\n 3]", ":3: materials.a.base_color.2: 3 is wrong; expected less than"),
        (
            "[materials.a]\nbase_color = [0.1, 0.2, true]",
            ":2: materials.a.base_color.2: True is wrong; expected a valid num",
        ),
        ("[materials.a]\nemission = [0, -1, 0]", ":2: materials.a.emission.1: -1 is wrong; expected greater than"),
        ("[materials.a]\nemission = [0, nan, 0]", ":2: materials.a.emission.1: nan is wrong; expected a finite number"),
        ("[materials.a]\nemission = [0, inf, 0]", ":2: materials.a.emission.1: inf is wrong"),
        ("[render]\nspp = 0", ":2: render.spp: 0 is wrong; expected greater than or equal to 1"),
        ("[render]\nspp = 1.5", ":2: render.spp: 1.5 is wrong; expected a valid integer"),
        ("[render]\nspp = '4'", ":2: render.spp: '4' is wrong"),
        ("[render]\nstereo = 1", ":2: render.stereo: 1 is wrong; expected a valid boolean"),
        ("[render]\nsize = [0, 5]", ":2: render.size.0: 0 is wrong"),
        ("[render]\nframes = [3, 3]", ":1: render: frames: the range is empty"),
        ("[render]\nfps = 0", ":2: render.fps: 0 is wrong"),
        ("render = 5", ":1: render: 5 is wrong; expected"),
        ("[camera]\nposition = [0, 0, 1]", ":1: camera: expected position and look_at, or pose"),
        ("[camera]\nposition = [0, 0, 1]\nlook_at = [0, 0, 1]", ":3: camera.look_at: gives no view"),
        ("[camera]\nposition = [0, 0, 0]\nlook_at = [0, 1, 0]", ":3: camera.look_at: gives no view"),
        ("[camera]\nposition = [0, 0, 1]\nlook_at = [0, 0, 0]\nfov_y = 180", ":4: camera.fov_y: 180 is wrong"),
        ("[camera]\nposition = [0, 0, 1]\nlook_at = [0, 0, 0]\nnear = -1", ":4: camera.near: -1 is wrong"),
        ("[camera]\npose = [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]", ":2: camera.pose: is not a rotation"),
        ("[camera]\npose = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]", ":2: camera.pose: is not a rotation"),
        (
            "[camera]\npose = [[1, 0, 0, 0], [0, 1, 0], [0, 0, 1, 0]]",
            ":2: camera.pose.1: [0, 1, 0] is wrong; expected a list",
        ),
        ("[environment]\n", ":1: environment: expected one of color, image and sky"),
        (
            "[render.settings]\n'pathtrace.bouncs' = 1",
            ":2: render.settings.pathtrace.bouncs: setting pathtrace.bouncs: unkn",
        ),
        (
            "[render.settings]\npathtrace.bounces = 1000",
            ":2: render.settings.pathtrace.bounces: setting pathtrace.bounces",
        ),
        (
            "[render.settings.pathtrace]\n\nbounces = 'x'",
            ":3: render.settings.pathtrace.bounces: setting pathtrace.bounce",
        ),
    ],
)
def test_schema_errors(tmp_path, text, message):
    assert refusal(tmp_path, text).startswith(message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mesh = 'bal'", ":5: instances.0.mesh: no 'bal' in [meshes]; did you mean 'ball'?"),
        ("mesh = 'ball'\nmaterial = 'red'", ":6: instances.0.material: no 'red' in [materials]"),
        ("mesh = 'ball'\nscale = 0", ":4: instances.0: the transform cannot be inverted"),
        ("mesh = 'ball'\nscale = [1, 1e-12, 1]", ":4: instances.0: the transform cannot be inverted"),
        ("mesh = 'ball'\nquaternion = [0, 0, 0, 0]", ":6: instances.0.quaternion: has no length"),
        (
            "mesh = 'ball'\nrotation = {axis = [0, 0, 0], degrees = 1}",
            ":6: instances.0.rotation.axis: [0, 0, 0] is wrong",
        ),
        (
            "mesh = 'ball'\nrotation = {axes = [0, 0, 1]}",
            ":6: instances.0.rotation.axes: unknown key; did you mean axis?",
        ),
        (
            "mesh = 'ball'\nrotation = {axis = [0, 0, 1], degrees = 1}\nquaternion = [0, 0, 0, 1]",
            ":4: instances.0: rotation",
        ),
        (
            "mesh = 'ball'\nscale = 1\nmatrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]",
            ":4: instances.0: matrix excludes",
        ),
        ("material = 'red'", ":4: instances.0: mesh is missing"),
    ],
)
def test_instance_errors(tmp_path, text, message):
    assert refusal(tmp_path, '[meshes.ball]\ngenerator = "sphere"\n\n[[instances]]\n' + text).startswith(message)


def test_an_error_in_a_later_element_of_a_list_of_tables_has_its_own_line(tmp_path):
    text = (
        BALL + BALL[BALL.index("[[") :] * 2 + '[[instances]]\nmesh = "ball"\n[instances.rotation]\naxis = [0, 0, 1]\n'
    )
    assert refusal(tmp_path, text).startswith(":12: instances.3.rotation: degrees is missing")


@pytest.mark.parametrize("text", ["[camera", "a = ", "a = 1\na = 2", "\x00", '"""', "[a]\n[a]", "a = 1979-13-01"])
def test_what_is_not_toml_is_refused(tmp_path, text):
    assert refusal(tmp_path, text).startswith(": not valid TOML: ")


def test_deep_nesting_is_refused(tmp_path):
    refusal(tmp_path, "a = " + "[" * 5000 + "]" * 5000)


def test_text_that_is_not_utf8_is_refused(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"[camera]\nname = '\xff'")
    with pytest.raises(SceneError, match="byte 17 is not UTF-8"):
        load_scene(tmp_path / "a.toml")


@pytest.mark.parametrize("text", ["", "[meshes.a]\ngenerator = 'box'"])
def test_a_scene_without_triangles_is_refused(tmp_path, text):
    assert refusal(tmp_path, text) == ": the scene has no triangles"


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("generator = 'sphere'\nsubdivisions = 40", "subdivisions"),
        ("generator = 'grid'\ncells = [100000, 100000]", "cells"),
        ("generator = 'hairball'\ntriangles = 4000000000", "triangles"),
        ("generator = 'hairball'\nsegments = 4000000000", "segments"),
        ("generator = 'sphere'\nradius = 0", "radius"),
        ("generator = 'box'\nsize = [1, -1, 1]", "size"),
    ],
)
def test_generators_are_bounded(tmp_path, text, key):
    assert key in refusal(tmp_path, f"[meshes.a]\n{text}\n[[instances]]\nmesh = 'a'")


def test_a_mesh_too_small_for_float32_is_refused(tmp_path):
    assert "meshes.a: its triangles have no area" in refusal(
        tmp_path, "[meshes.a]\ngenerator = 'box'\nsize = [1e-46, 1e-46, 1e-46]\n[[instances]]\nmesh = 'a'"
    )


# The line of any key


keys = st.text(st.sampled_from('abz019-_ .é"#[]='), min_size=1, max_size=6)


@given(st.lists(keys, min_size=1, max_size=6, unique=True), st.data())
@settings(max_examples=60, deadline=None)
def test_the_line_of_an_unknown_key_is_found_whatever_is_around_it(folder, names, data):
    wrong = data.draw(st.integers(0, len(names) - 1))
    quoted = ['"' + name.replace('"', '\\"') + '"' for name in names]
    lines = []
    for number, name in enumerate(quoted):
        lines += data.draw(st.lists(st.sampled_from(["", "# [materials.x]", "  # = "]), max_size=3))
        if data.draw(st.booleans()):
            lines.append(f"[materials.{name}]")
            lines.append("base_color = [0, # one\n 0.5,\n 1]" if number != wrong else "oops = 1")
        else:
            value = "base_color = [0, 0, 0]" if number != wrong else "oops = 1"
            lines.append(f"[materials]\n{name} = {{ {value} }}" if lines == [] else f"[materials . {name}]\n{value}")
    text = "\n".join(lines)
    expected = 1 + text[: text.index("oops")].count("\n")
    shown = names[wrong]
    assert refusal(folder, text).startswith(f":{expected}: materials.{shown}.oops: unknown key")


# Transforms


def transform_of(folder, text):
    return (
        load(
            folder,
            BALL + text + "\n[environment]\ncolor = [1, 1, 1]\n[camera]\nposition = [0, 0, 9]\nlook_at = [0, 0, 0]",
        )
        .instances[0]
        .transform
    )


unit = st.floats(-1, 1).filter(lambda x: abs(x) > 1e-3)
vectors = st.tuples(unit, unit, unit)


@given(vectors, st.floats(-720, 720), vectors, vectors)
@settings(max_examples=60, deadline=None)
def test_scale_then_rotation_then_translation(folder, axis, degrees, scale, translation):
    text = f"rotation = {{axis = {list(axis)}, degrees = {degrees}}}\nscale = {list(scale)}\ntranslation = {list(translation)}"
    transform = transform_of(folder, text)
    n = np.array(axis) / np.linalg.norm(axis)
    turn = math.radians(degrees)
    point = np.array([0.3, -0.7, 1.1])
    scaled = point * scale
    # Rodrigues' formula
    rotated = scaled * math.cos(turn) + np.cross(n, scaled) * math.sin(turn) + n * (n @ scaled) * (1 - math.cos(turn))
    assert np.allclose(transform @ [*point, 1], rotated + translation, atol=1e-9)


@given(vectors, st.floats(-360, 360), st.sampled_from([1e-250, 0.1, 1.0, 1e25]))
@settings(max_examples=60, deadline=None)
def test_quaternion_and_axis_agree(folder, axis, degrees, length):
    half = math.radians(degrees) / 2
    n = np.array(axis) / np.linalg.norm(axis)
    quaternion = (np.array([*(n * math.sin(half)), math.cos(half)]) * length).tolist()
    by_axis = transform_of(folder, f"rotation = {{axis = {list(axis)}, degrees = {degrees}}}")
    assert np.allclose(transform_of(folder, f"quaternion = {quaternion}"), by_axis, atol=1e-9)


def test_matrix_is_taken_as_it_is(folder):
    rows = [[1, 2, 3, 4], [0, 1, 5, 6], [0, 0, 1, 7]]
    assert transform_of(folder, f"matrix = {rows}").tolist() == rows


@given(vectors, vectors, vectors)
@settings(max_examples=60, deadline=None)
def test_look_at_puts_its_point_in_the_middle_and_up_upwards(folder, position, target, up):
    text = f"[environment]\ncolor = [1, 1, 1]\n[camera]\nposition = {list(position)}\nlook_at = {list(target)}\nup = {list(up)}"
    view = np.subtract(target, position)
    if np.linalg.norm(np.cross(view, up)) < 1e-6:
        return
    pose = load(folder, BALL + text).camera.transform
    assert np.allclose(pose[:, :3].T @ pose[:, :3], np.eye(3)) and np.isclose(np.linalg.det(pose[:, :3]), 1)
    assert np.allclose(pose[:, 3], position)
    assert np.allclose(pose[:, :3].T @ view, [0, 0, -np.linalg.norm(view)], atol=1e-9)
    assert (pose[:, :3].T @ up)[0] == pytest.approx(0, abs=1e-9) and (pose[:, :3].T @ up)[1] > 0


def test_a_pose_is_taken_as_it_is(folder):
    pose = [[0, 0, 1, 5], [0, 1, 0, 6], [-1, 0, 0, 7]]
    scene = load(folder, BALL + f"[camera]\npose = {pose}")
    assert scene.camera.transform.tolist() == pose


# Files that a scene includes


def included(tmp_path):
    """A glTF file with two instances of a mesh, a light and a camera."""
    gltf = Gltf()
    gltf.json["materials"] = [{"name": "own", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.125, 1]}}]
    gltf.mesh(gltf.primitive(material=0))
    gltf.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    gltf.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    light = {"KHR_lights_punctual": {"light": 0}}
    gltf.json["nodes"] = [
        {"children": [1, 2]},
        {"mesh": 0, "translation": [1, 0, 0], "extensions": light},
        {"mesh": 0, "camera": 0},
    ]
    (tmp_path / "models").mkdir()
    gltf.write(tmp_path / "models" / "a.gltf")
    return '[meshes.a]\nfile = "models/a.gltf"\n[materials.red]\nbase_color = [1, 0, 0]\n'


def test_a_mesh_file_is_included_as_a_whole(tmp_path):
    text = included(tmp_path) + '[[instances]]\nmesh = "a"\ntranslation = [0, 2, 0]\nscale = 3\n'
    scene = load(tmp_path, text + '[[instances]]\nmesh = "a"\ntranslation = [0, 0, 5]\n')
    assert len(scene.meshes) == 1 and len(scene.instances) == 4
    assert [i.transform[:, 3].tolist() for i in scene.instances] == [[3, 2, 0], [0, 2, 0], [1, 0, 5], [0, 0, 5]]
    assert [m.name for m in scene.materials] == ["own"]
    assert [light.position for light in scene.lights] == [(3, 2, 0), (1, 0, 5)]
    assert np.allclose(scene.camera.transform, [[1, 0, 0, 0], [0, 1, 0, 2], [0, 0, 1, 0]]) and scene.camera.fov_y == 1


def test_a_material_given_to_an_instance_replaces_those_of_the_file(tmp_path):
    scene = load(
        tmp_path, included(tmp_path) + '[[instances]]\nmesh = "a"\n[[instances]]\nmesh = "a"\nmaterial = "red"\n'
    )
    used = [scene.materials[scene.meshes[i.mesh].material[0]].name for i in scene.instances]
    assert used == ["own", "own", "red", "red"]
    own, red = scene.meshes
    assert own.positions is red.positions and own.triangles is red.triangles


def test_a_file_in_a_folder_below_may_refer_to_one_beside_the_scene(tmp_path):
    text = included(tmp_path) + '[[instances]]\nmesh = "a"\n'
    (tmp_path / "models" / "a.obj").write_text("mtllib ../m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl x\nf 1 2 3\n")
    (tmp_path / "m.mtl").write_text("newmtl x\nKd 0.5 0 0\n")
    assert load(tmp_path, text.replace("a.gltf", "a.obj")).materials[0].base_color == (0.5, 0, 0)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("none.obj", "no such file"),
        ("models", "not a regular file"),
        ("../out.obj", "leaves the scene's folder"),
        ("models/../../out.obj", "leaves the scene's folder"),
        ("link.obj", "leaves the scene's folder"),
        ("/etc/hostname", "leaves the scene's folder"),
        ("file:///etc/hostname", "is a URL"),
        ("http://localhost/a.obj", "is a URL"),
        ("a\\u0000b.obj", "not a usable path"),
        ("scene.toml", "is a scene; expected a mesh file"),
        ("x.txt", "not a kind of file that is read"),
    ],
)
def test_references_that_are_refused(tmp_path, reference, message):
    inner = tmp_path / "inner"
    (inner / "models").mkdir(parents=True)
    (tmp_path / "out.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (inner / "link.obj").symlink_to(tmp_path / "out.obj")
    (inner / "x.txt").write_text("")
    text = f'\n[meshes.a]\nfile = "{reference}"\n[[instances]]\nmesh = "a"\n'
    path = write(inner, text)
    with pytest.raises(SceneError) as error:
        load_scene(path)
    assert message in str(error.value) and "\n" not in str(error.value)
    if "leaves" in message:
        assert str(error.value).startswith(f"{path}:3: meshes.a.file: ")
    if "out.obj" in reference or "link" in reference:
        assert load_scene(path, allow_outside=True).triangle_count == 1


def test_errors_in_an_included_file_name_that_file(tmp_path):
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    with pytest.raises(SceneError, match=r"^bad\.obj: mesh .* position 2 is"):
        load(tmp_path, '[meshes.a]\nfile = "bad.obj"\n[[instances]]\nmesh = "a"\n')


def test_a_broken_texture_names_its_key_and_line(tmp_path):
    (tmp_path / "p.png").write_bytes(b"\x89PNG\r\n\x1a\nxx")
    message = refusal(tmp_path, BALL + '[materials.a]\nbase_color_texture = "p.png"')
    assert message.startswith(":7: materials.a.base_color_texture: 'p.png': ")
