import base64
import io
import json

import numpy as np
import pytest
import trimesh
from gltf_builder import TRIANGLE, Gltf
from PIL import Image

from clcache.errors import SceneError
from clcache.scene import DirectionalLight, PointLight, SpotLight, load_scene

SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


@pytest.fixture
def gltf():
    return Gltf()


def load(gltf, tmp_path, name="a.gltf"):
    return load_scene(gltf.write(tmp_path / name))


def refusal(gltf, tmp_path, name="a.gltf"):
    with pytest.raises(SceneError) as error:
        load(gltf, tmp_path, name)
    message = str(error.value)
    assert "\n" not in message and message.startswith(str(tmp_path / name))
    return message


def png(color=(255, 0, 0), size=(2, 2)):
    stream = io.BytesIO()
    Image.new("RGB", size, color).save(stream, "png")
    return stream.getvalue()


# Geometry


@pytest.mark.parametrize("name", ["a.gltf", "a.glb"])
def test_positions_and_indices_arrive(gltf, tmp_path, name):
    gltf.mesh(gltf.primitive(SQUARE, [[0, 1, 2], [0, 2, 3]]))
    (mesh,) = load(gltf, tmp_path, name).meshes
    assert mesh.name == "thing"
    assert np.array_equal(mesh.positions, np.float32(SQUARE))
    assert np.array_equal(mesh.triangles, [[0, 1, 2], [0, 2, 3]])
    assert mesh.positions.dtype == np.float32 and mesh.triangles.dtype == mesh.material.dtype == np.uint32


def test_a_primitive_without_normals_is_flat(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    assert load(gltf, tmp_path).meshes[0].normals is None


def test_normals_are_brought_to_unit_length_and_zero_ones_stay(gltf, tmp_path):
    primitive = gltf.primitive()
    primitive["attributes"]["NORMAL"] = gltf.accessor([[0, 0, 2], [0, 0.5, 0], [0, 0, 0]], "VEC3")
    gltf.mesh(primitive)
    assert np.array_equal(load(gltf, tmp_path).meshes[0].normals, [[0, 0, 1], [0, 1, 0], [0, 0, 0]])


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_index_types(gltf, tmp_path, dtype):
    primitive = gltf.primitive(SQUARE)
    primitive["indices"] = gltf.accessor([0, 1, 2, 2, 3, 0], "SCALAR", dtype)
    gltf.mesh(primitive)
    assert np.array_equal(load(gltf, tmp_path).meshes[0].triangles, [[0, 1, 2], [2, 3, 0]])


@pytest.mark.parametrize(
    ("mode", "triangles"), [(5, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]), (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]])]
)
def test_strips_and_fans_become_triangles(gltf, tmp_path, mode, triangles):
    corners = [[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0]]
    gltf.mesh(gltf.primitive(corners, mode=mode))
    assert np.array_equal(load(gltf, tmp_path).meshes[0].triangles, triangles)


def test_interleaved_attributes(gltf, tmp_path):
    rows = np.arange(15, dtype="<f4").reshape(3, 5) ** 2
    view = gltf.view(rows.tobytes(), byteStride=20)
    for kind, offset in (("VEC3", 0), ("VEC2", 12)):
        gltf.json["accessors"].append(
            {"bufferView": view, "byteOffset": offset, "componentType": 5126, "count": 3, "type": kind}
        )
    gltf.mesh({"attributes": {"POSITION": 0, "TEXCOORD_0": 1}})
    (mesh,) = load(gltf, tmp_path).meshes
    assert np.array_equal(mesh.positions, rows[:, :3]) and np.array_equal(mesh.uvs, rows[:, 3:])


@pytest.mark.parametrize(("dtype", "most"), [("i1", 127), ("u1", 255), ("i2", 32767), ("u2", 65535)])
def test_normalized_integers(gltf, tmp_path, dtype, most):
    stored = np.array([[0, most, 0], [most, 0, 0], [0, 0, most // 3]])
    if dtype[0] == "i":
        stored[0, 2] = -most - 1  # the one value below -1, which counts as -1
    position = gltf.accessor(stored, "VEC3", dtype, normalized=True)
    if dtype[1] == "1":  # three bytes are not a multiple of four: the specification wants a stride
        padded = np.hstack([stored, np.zeros((3, 1), int)]).astype("<" + dtype)
        gltf.json["accessors"][position]["bufferView"] = gltf.view(padded.tobytes(), byteStride=4)
    gltf.mesh({"attributes": {"POSITION": position}})
    expected = np.maximum(stored / most, -1)
    assert np.allclose(load(gltf, tmp_path).meshes[0].positions, expected, atol=1e-7)


def test_sparse_replaces_elements(gltf, tmp_path):
    base = gltf.accessor(np.zeros((3, 3)), "VEC3")
    indices = gltf.view(np.array([1, 2], "<u2").tobytes())
    values = gltf.view(np.array([[1, 0, 0], [0, 1, 0]], "<f4").tobytes())
    sparse = {
        "count": 2,
        "indices": {"bufferView": indices, "componentType": 5123},
        "values": {"bufferView": values},
    }
    gltf.json["accessors"][base]["sparse"] = sparse
    gltf.json["accessors"].append({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse})  # on zeros
    gltf.mesh({"attributes": {"POSITION": 0}}, {"attributes": {"POSITION": 1}})
    assert np.array_equal(load(gltf, tmp_path).meshes[0].positions, np.float32(TRIANGLE + TRIANGLE))


def test_primitives_become_one_mesh_with_a_material_per_triangle(gltf, tmp_path):
    gltf.json["materials"] = [{"name": "red"}, {"name": "blue"}]
    first = gltf.primitive(SQUARE, [[0, 1, 2]], material=1)
    second = {**first, "indices": gltf.accessor([0, 2, 3], "SCALAR", "u1"), "material": 0}
    gltf.mesh(first, second, gltf.primitive(material=1))
    scene = load(gltf, tmp_path)
    (mesh,) = scene.meshes
    assert [scene.materials[m].name for m in mesh.material] == ["blue", "red", "blue"]
    assert len(mesh.positions) == 4 + 3  # the first two share their vertices
    assert np.array_equal(mesh.triangles, [[0, 1, 2], [0, 2, 3], [4, 5, 6]])


def test_a_flat_and_a_smooth_primitive_in_one_mesh(gltf, tmp_path):
    smooth = gltf.primitive()
    smooth["attributes"]["NORMAL"] = gltf.accessor([[0, 0, 1]] * 3, "VEC3")
    gltf.mesh(gltf.primitive(), smooth)
    assert np.array_equal(load(gltf, tmp_path).meshes[0].normals, [[0, 0, 0]] * 3 + [[0, 0, 1]] * 3)


def test_points_and_lines_are_dropped_and_counted(gltf, tmp_path):
    gltf.mesh(gltf.primitive(), gltf.primitive(mode=0), gltf.primitive(mode=1))
    scene = load(gltf, tmp_path)
    assert scene.triangle_count == 1
    assert scene.dropped == {"primitives made of points or lines": 2}


def test_a_scene_of_lines_only_is_refused(gltf, tmp_path):
    gltf.mesh(gltf.primitive(mode=1))
    assert "no triangles" in refusal(gltf, tmp_path) and "points or lines" in refusal(gltf, tmp_path)


# Nodes


def test_hierarchy_and_shared_meshes(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    gltf.json["scenes"] = [{"nodes": [0]}]
    turn = np.array([[0, 0, 2, 5], [0, 3, 0, 6], [-1, 0, 0, 7], [0, 0, 0, 1.0]])
    gltf.json["nodes"] = [
        {"translation": [1, 2, 3], "rotation": [0, np.sqrt(0.5), 0, np.sqrt(0.5)], "children": [1, 2]},
        {"mesh": 0, "scale": [2, 3, 4], "name": "scaled"},
        {"mesh": 0, "matrix": turn.T.ravel().tolist()},
        {"mesh": 0, "name": "not in the scene"},
    ]
    scene = load(gltf, tmp_path)
    quarter = np.array([[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1.0]])
    assert len(scene.meshes) == 1 and [i.mesh for i in scene.instances] == [0, 0]
    assert scene.instances[0].name == "scaled"
    assert np.allclose(scene.instances[0].transform, (quarter @ np.diag([2, 3, 4, 1]))[:3])
    assert np.allclose(scene.instances[1].transform, (quarter @ turn)[:3])
    assert scene.triangle_count == 2


def test_without_scenes_all_roots_count(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    gltf.json["nodes"] = [{"mesh": 0}, {"children": [0]}, {"mesh": 0}]
    del gltf.json["scenes"], gltf.json["scene"]
    assert len(load(gltf, tmp_path).instances) == 2


def test_a_long_chain_of_nodes_is_no_recursion(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    gltf.json["nodes"] = [{"translation": [1, 0, 0], "children": [n + 1]} for n in range(3000)] + [{"mesh": 0}]
    assert load(gltf, tmp_path).instances[0].transform[0, 3] == 3000


@pytest.mark.parametrize("nodes", [[{"children": [0], "mesh": 0}], [{"children": [1, 1]}, {"mesh": 0}]])
def test_a_hierarchy_that_is_no_tree_is_refused(gltf, tmp_path, nodes):
    gltf.mesh(gltf.primitive())
    gltf.json["nodes"] = nodes
    assert "must be a tree" in refusal(gltf, tmp_path)


@pytest.mark.parametrize(
    "node", [{"scale": [1, 0, 1]}, {"scale": [1e30, 1e30, 1e30], "children": []}, {"matrix": [0.0] * 16}]
)
def test_transforms_that_cannot_be_used_are_refused(gltf, tmp_path, node):
    gltf.mesh(gltf.primitive())
    outer = {"scale": [1e30] * 3, "children": [1]}
    gltf.json["nodes"] = [outer, {"mesh": 0, **node}]
    assert "nodes[1]: the transform" in refusal(gltf, tmp_path)


# Materials, textures


def test_base_colour_and_emissive_strength(gltf, tmp_path):
    gltf.json["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 1], "metallicFactor": 0},
            "emissiveFactor": [1, 0.5, 0],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}},
        }
    ]
    gltf.mesh(gltf.primitive(material=0))
    scene = load(gltf, tmp_path)
    assert scene.materials[0].base_color == (0.1, 0.2, 0.3)
    assert scene.materials[0].emission == (8, 4, 0)
    assert scene.lights == () and not scene.environment.radiance.any()  # a file with light of its own gets no other


def test_the_default_material_is_white(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    assert load(gltf, tmp_path).materials[0].base_color == (1, 1, 1)


@pytest.mark.parametrize("where", ["data URI", "buffer view", "file"])
def test_textures_and_their_wrap_modes(gltf, tmp_path, where):
    if where == "data URI":
        image = {"uri": "data:image/png;base64," + base64.b64encode(png()).decode()}
    elif where == "buffer view":
        image = {"bufferView": gltf.view(png()), "mimeType": "image/png"}
    else:
        (tmp_path / "a b.png").write_bytes(png())
        image = {"uri": "a%20b.png"}
    gltf.json |= {
        "images": [image],
        "samplers": [{"wrapS": 33071, "wrapT": 33648}],
        "textures": [{"source": 0, "sampler": 0}, {"source": 0}, {"source": 0, "sampler": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": n}}} for n in range(3)],
    }
    gltf.mesh(*(gltf.primitive(material=n) for n in range(3)))
    scene = load(gltf, tmp_path)
    assert [m.base_color_texture.index for m in scene.materials] == [0, 1, 0]
    assert [t.wrap for t in scene.textures] == [("clamp", "mirror"), ("repeat", "repeat")]
    assert scene.textures[0].pixels is scene.textures[1].pixels
    assert np.array_equal(scene.textures[0].pixels, np.full((2, 2, 4), [255, 0, 0, 255]))


def test_a_texture_may_use_the_second_set_of_coordinates(gltf, tmp_path):
    gltf.json |= {
        "images": [{"bufferView": gltf.view(png())}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}}}],
    }
    primitive = gltf.primitive(material=0)
    primitive["attributes"]["TEXCOORD_0"] = gltf.accessor(np.zeros((3, 2)), "VEC2")
    primitive["attributes"]["TEXCOORD_1"] = gltf.accessor(
        [[0, 0], [65535, 0], [0, 65535]], "VEC2", "u2", normalized=True
    )
    gltf.mesh(primitive)
    assert np.array_equal(load(gltf, tmp_path).meshes[0].uvs, [[0, 0], [1, 0], [0, 1]])


def test_what_is_approximated_is_said_once_for_each_kind(gltf, tmp_path):
    gltf.json["materials"] = [{"alphaMode": "BLEND", "extensions": {"KHR_materials_sheen": {}}}] * 2
    gltf.mesh(gltf.primitive(material=0), gltf.primitive(material=1))
    notes = load(gltf, tmp_path).notes
    assert sum("2 materials blend by their alpha" in n for n in notes) == 1
    assert sum("2 materials use KHR_materials_sheen" in n for n in notes) == 1


# Lights, cameras


def test_lights(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    gltf.json["extensions"] = {
        "KHR_lights_punctual": {
            "lights": [
                {"type": "point", "color": [1, 0.5, 0], "intensity": 40},
                {"type": "directional", "intensity": 3},
                {"type": "spot", "spot": {}},
            ]
        }
    }
    down = [-np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    lights = [{"extensions": {"KHR_lights_punctual": {"light": n}}, "rotation": down} for n in range(3)]
    gltf.json["nodes"] = [{"mesh": 0, "translation": [1, 2, 3], "scale": [2, 2, 2], "children": [1, 2, 3]}, *lights]
    gltf.json["nodes"][1]["translation"] = [0, 1, 0]
    scene = load(gltf, tmp_path)
    point, directional, spot = scene.lights
    assert point == PointLight((1, 4, 3), (40, 20, 0))
    assert isinstance(directional, DirectionalLight) and directional.irradiance == (3, 3, 3)
    assert np.allclose(directional.direction, [0, -1, 0])
    assert isinstance(spot, SpotLight) and np.allclose(spot.direction, [0, -1, 0])


def test_the_first_camera_of_the_scene_is_used_without_its_scale(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    gltf.json["cameras"] = [
        {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}},
        {"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.2}},
    ]
    gltf.json["nodes"] = [
        {"mesh": 0, "scale": [3, 3, 3], "children": [1]},
        {"camera": 1, "translation": [0, 0, 2], "rotation": [0, 1, 0, 0]},
    ]
    camera = load(gltf, tmp_path).camera
    assert (camera.fov_y, camera.near) == (0.7, 0.2)
    assert np.allclose(camera.transform, [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 6]])


# An independent reader agrees


def test_a_file_that_trimesh_wrote_reads_as_trimesh_made_it(tmp_path):
    ball, cone = trimesh.creation.icosphere(subdivisions=2), trimesh.creation.cone(radius=1, height=2)
    world = trimesh.Scene({"ball": ball})
    move = trimesh.transformations.compose_matrix(angles=[0.1, 0.2, 0.3], translate=[1, 2, 3], scale=[1, 2, 3])
    world.add_geometry(cone, node_name="first", geom_name="cone", transform=move)
    world.graph.update(frame_to="second", geometry="cone", matrix=np.linalg.inv(move))
    for name in ("world.glb", "world.gltf"):
        if name.endswith("glb"):
            world.export(tmp_path / name)
        else:
            for file, data in world.export(file_type="gltf").items():
                (tmp_path / ("world.gltf" if file == "model.gltf" else file)).write_bytes(data)
        scene = load_scene(tmp_path / name)
        ours = np.concatenate(
            [
                scene.meshes[i.mesh].positions[scene.meshes[i.mesh].triangles] @ i.transform[:, :3].T
                + i.transform[:, 3]
                for i in scene.instances
            ]
        )
        theirs = np.concatenate([part.triangles for part in world.dump()])
        assert ours.shape == theirs.shape
        assert len(scene.meshes) == 2 and len(scene.instances) == 3
        order = [np.lexsort(np.round(t, 4).reshape(-1, 9).T) for t in (ours, theirs)]
        assert np.allclose(ours[order[0]], theirs[order[1]], atol=1e-5)


# Damaged files


def test_counts_beyond_the_buffer_are_refused_before_anything_is_allocated(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    gltf.json["accessors"][0]["count"] = 4_000_000_000
    assert "accessors[0]: count 4000000000 needs 48000000000 bytes" in refusal(gltf, tmp_path)


def test_zeros_that_no_file_pays_for_are_refused(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    gltf.json["accessors"][0] |= {"count": 4_000_000_000}
    del gltf.json["accessors"][0]["bufferView"]
    assert "count 4000000000 without a bufferView" in refusal(gltf, tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda j: j["bufferViews"][0].update(byteLength=1000), "bufferViews[0]: ends at byte 1000"),
        (lambda j: j["bufferViews"][0].update(byteOffset=2**60), "bufferViews[0].byteOffset"),
        (lambda j: j["bufferViews"][0].update(buffer=3), "refers to buffers[3]"),
        (lambda j: j["accessors"][0].update(bufferView=9), "refers to bufferViews[9]"),
        (lambda j: j["accessors"][0].update(componentType=5124), "accessors[0].componentType"),
        (lambda j: j["accessors"][0].update(count=-1), "accessors[0].count: '-1' is wrong"),
        (lambda j: j["accessors"][0].update(count=0), "accessors[0].count"),
        (lambda j: j["accessors"][0].update(count=2.5), "accessors[0].count"),
        (lambda j: j["accessors"][0].update(type="VEC2"), "accessors[0]: is VEC2"),
        (lambda j: j["accessors"][0].update(type="MAT4"), "accessors[0]: is MAT4"),
        (lambda j: j["accessors"][1].update(type="VEC3"), "accessors[1]: holds no indices"),
        (lambda j: j["bufferViews"][0].update(byteStride=4), "stride of 4 bytes"),
        (lambda j: j["meshes"][0]["primitives"][0]["attributes"].clear(), "meshes[0].primitives[0]: has no POSITION"),
        (lambda j: j["meshes"][0]["primitives"][0].update(indices=7), "refers to accessors[7]"),
        (lambda j: j["meshes"][0]["primitives"][0].update(material=7), "refers to materials[7]"),
        (lambda j: j["meshes"][0]["primitives"].clear(), "meshes[0].primitives"),
        (lambda j: j["accessors"][1].update(count=5), "meshes[0].primitives[0]: has 5 corners"),
        (lambda j: j["nodes"][0].update(mesh=5), "nodes[0]: refers to meshes[5]"),
        (lambda j: j["scenes"][0].update(nodes=[4]), "refers to nodes[4]"),
        (lambda j: j.update(scene=4), "refers to scenes[4]"),
        (lambda j: j["nodes"][0].update(translation=[1, 2]), "nodes[0].translation"),
        (lambda j: j["nodes"][0].update(rotation=[0, 0, 0, 0]), "nodes[0]: rotation"),
        (lambda j: j["asset"].update(version="1.0"), "asset: glTF version 1.0"),
        (lambda j: j.pop("asset"), "asset"),
        (lambda j: j.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        (lambda j: j.update(extensionsRequired=["EXT_meshopt_compression"]), "EXT_meshopt_compression"),
        (lambda j: j.update(extensionsRequired=["KHR_texture_basisu"]), "KHR_texture_basisu"),
    ],
)
def test_what_does_not_fit_together_is_refused(gltf, tmp_path, change, message):
    gltf.mesh(gltf.primitive(SQUARE, [[0, 1, 2], [0, 2, 3]]))
    change(gltf.json)
    assert message in refusal(gltf, tmp_path)


def test_indices_out_of_range_name_the_first(gltf, tmp_path):
    gltf.mesh(gltf.primitive(SQUARE, [[0, 1, 2], [0, 9, 3]]))
    assert "meshes[0].primitives[0].indices: element 4 is vertex 9; expected 0 .. 3" in refusal(gltf, tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("what", ["POSITION", "NORMAL", "TEXCOORD_0"])
def test_numbers_that_are_not_finite_are_refused(gltf, tmp_path, what, value):
    primitive = gltf.primitive()
    values = np.ones((3, 2 if what == "TEXCOORD_0" else 3))
    values[1, 1] = value
    primitive["attributes"][what] = gltf.accessor(values, f"VEC{values.shape[1]}")
    gltf.mesh(primitive)
    word = {"POSITION": "position", "NORMAL": "normal", "TEXCOORD_0": "texture coordinate"}[what]
    assert f"mesh 'thing': {word} 1 is" in refusal(gltf, tmp_path)


def test_as_many_normals_as_positions(gltf, tmp_path):
    primitive = gltf.primitive()
    primitive["attributes"]["NORMAL"] = gltf.accessor([[0, 0, 1]] * 2, "VEC3")
    gltf.mesh(primitive)
    assert "NORMAL: has 2 elements for 3 positions" in refusal(gltf, tmp_path)


def test_sparse_indices_out_of_range(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    gltf.json["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": gltf.view(b"\x07"), "componentType": 5121},
        "values": {"bufferView": gltf.view(bytes(12))},
    }
    assert "accessors[0].sparse.indices: element 0 is 7" in refusal(gltf, tmp_path)


@pytest.mark.parametrize("keep", [3, 11, 19, 60, -1])
def test_a_truncated_glb_is_refused(gltf, tmp_path, keep):
    gltf.mesh(gltf.primitive())
    path = gltf.write(tmp_path / "a.glb")
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(SceneError, match="truncated|not valid JSON"):
        load_scene(path)


def test_a_glb_without_its_binary_chunk_is_refused(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps({"buffers": [{"byteLength": 36}], **gltf.json}))
    with pytest.raises(SceneError, match=r"buffers\[0\]: has no uri"):
        load_scene(path)


def test_a_buffer_file_that_is_too_short_is_refused(gltf, tmp_path):
    gltf.mesh(gltf.primitive())
    (tmp_path / "a.bin").write_bytes(bytes(10))
    gltf.json["buffers"] = [{"byteLength": 36, "uri": "a.bin"}]
    assert "buffers[0]: truncated: 10 bytes, but byteLength is 36" in refusal(gltf, tmp_path)


@pytest.mark.parametrize("uri", ["data:;base64,!!!", "data:nothing"])
def test_a_broken_data_uri_is_refused(gltf, tmp_path, uri):
    gltf.mesh(gltf.primitive())
    gltf.json["buffers"] = [{"byteLength": 36, "uri": uri}]
    assert "buffers[0]: the data URI" in refusal(gltf, tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{", "\x00\x01", '{"asset": NaN}', "[" * 100_000])
def test_what_is_not_json_is_refused(tmp_path, text):
    (tmp_path / "a.gltf").write_text(text)
    with pytest.raises(SceneError) as error:
        load_scene(tmp_path / "a.gltf")
    assert "a.gltf" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("uri", ["missing.png", "broken.png"])
def test_broken_pictures_name_their_place(gltf, tmp_path, uri):
    (tmp_path / "broken.png").write_bytes(png()[:40])
    gltf.json |= {
        "images": [{"uri": uri}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    }
    gltf.mesh(gltf.primitive(material=0))
    message = refusal(gltf, tmp_path)
    assert "images[0]" in message and uri in message
