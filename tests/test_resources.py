"""What of a scene is uploaded, in which form, and what is left out."""

import re
from dataclasses import replace

import numpy as np
import pytest
from graph_materials import by_graph
from render_helpers import BLACK, ball, checkered, everything, floor, grey, lit, shape_mesh, view

from clcache.device import Device
from clcache.errors import DeviceError
from clcache.graph import OUTPUTS
from clcache.resources import SceneResources, srgb_to_linear
from clcache.scene.generators import plane
from clcache.scene.model import (
    DirectionalLight,
    Environment,
    Material,
    Mesh,
    PointLight,
    SpotLight,
    Texture,
    TextureUse,
)
from clcache.scene.textures import encode_srgb, mip_chain

CAMERA = view((0, 1, 3), (0, 0, 0))
SKY = Environment(np.arange(24, dtype=np.float32).reshape(2, 4, 3))
SUN = DirectionalLight((0.0, -1.0, 0.0), (1.0, 1.0, 1.0))


def without_uvs(mesh: Mesh) -> Mesh:
    return replace(mesh, uvs=None)


def textured(**maps: int) -> Material:
    """Of a white material, the maps by their names without `_texture`, and the textures that they show."""
    return Material("m", **{f"{name}_texture": TextureUse(index) for name, index in maps.items()})


def test_srgb_round_trip():
    encoded = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(encode_srgb(srgb_to_linear(encoded)), encoded, atol=1e-4)
    np.testing.assert_allclose(srgb_to_linear(np.array([0, 1, 0.5, 0.04])), [0, 1, 0.21404114, 0.04 / 12.92], rtol=1e-7)


def test_what_a_scene_lacks_is_not_there(device):
    resources = SceneResources(device, lit(without_uvs(floor()), camera=CAMERA))
    assert not any(resources.features.values())
    assert resources.arrays.keys() == {
        "positions",
        "triangles",
        "instances",
        "is_static",
        "material",
        "materials",
        "sky",
    }
    assert resources.emitter_count == 0
    assert resources.texture_bytes == resources.arrays["sky"].nbytes == 12


def test_all_that_a_scene_has_is_there(device):
    maps = textured(base_color=0, metallic_roughness=0, normal=0, emission=0)
    glass = replace(maps, emission=(1.0, 1.0, 1.0), alpha_cutoff=0.5, transmission=0.5)
    scene = replace(everything(), materials=(glass, glass, by_graph("base_color")), environment=SKY)
    resources = SceneResources(device, scene)
    assert all(resources.features.values())
    assert resources.emitter_count == 3 + scene.triangle_count - 2 + 1
    assert resources.arrays["uvs"].shape[1] == 2
    assert resources.arrays["normals"].shape == resources.arrays["positions"].shape


@pytest.mark.parametrize(
    ("changes", "features"),
    [
        ({"environment": Environment.constant((0.0, 0.0, 0.1))}, {"HAS_EMISSION"}),
        ({"environment": SKY}, {"HAS_EMISSION", "HAS_SKY_PICTURE", "HAS_DIRECT"}),
        ({"environment": Environment(0 * SKY.radiance)}, set()),
        ({"materials": (grey(0.5, 0.1),)}, {"HAS_EMISSION", "HAS_EMISSIVE", "HAS_DIRECT"}),
        ({"lights": (PointLight((0, 0, 0), (1, 1, 1)),)}, {"HAS_DIRECT", "HAS_PUNCTUAL"}),
        ({"lights": (PointLight((0, 0, 0), BLACK),)}, set()),
        ({"meshes": (ball(smooth=True),)}, {"HAS_NORMALS"}),
        ({"materials": (textured(base_color=0),), "textures": (checkered(),)}, {"HAS_TEXTURES", "HAS_BASE_COLOR_MAPS"}),
        ({"materials": (textured(normal=0),), "textures": (checkered(),)}, {"HAS_TEXTURES", "HAS_NORMAL_MAPS"}),
        ({"materials": (Material("m", specular=0.5),)}, {"HAS_SPECULAR"}),
        ({"materials": (Material("m", metallic=0.5),)}, {"HAS_SPECULAR"}),
        ({"materials": (Material("m", transmission=0.5),)}, {"HAS_SPECULAR", "HAS_TRANSMISSION"}),
        ({"materials": (by_graph("base_color"),)}, {"HAS_GRAPHS", "HAS_TEXTURES"}),
        ({"materials": (by_graph("roughness"),)}, {"HAS_GRAPHS", "HAS_TEXTURES"}),
        ({"materials": (by_graph("metallic"),)}, {"HAS_GRAPHS", "HAS_TEXTURES", "HAS_SPECULAR"}),
        ({"materials": (by_graph("specular"),)}, {"HAS_GRAPHS", "HAS_TEXTURES", "HAS_SPECULAR"}),
        ({"materials": (by_graph("normal"),)}, {"HAS_GRAPHS", "HAS_TEXTURES", "HAS_NORMAL_MAPS"}),
        ({"materials": (by_graph("emission"),)}, {"HAS_GRAPHS", "HAS_TEXTURES", "HAS_EMISSIVE", "HAS_EMISSION"}),
        ({"materials": (Material("m", alpha_cutoff=0.5),)}, {"HAS_ALPHA"}),
        ({"materials": (Material("m", alpha_cutoff=0.0),)}, set()),
        (
            {"materials": (Material("m", alpha_cutoff=0.5, emission=(0.1,) * 3),)},
            {"HAS_ALPHA", "HAS_LAMP_HOLES", "HAS_EMISSION", "HAS_EMISSIVE", "HAS_DIRECT"},
        ),
    ],
)
def test_each_feature_by_itself(device, changes, features):
    resources = SceneResources(device, replace(lit(floor(), camera=CAMERA), **changes))
    assert {name for name, is_there in resources.features.items() if is_there} == features


def test_a_texture_that_no_material_uses_is_not_uploaded(device):
    with_texture = SceneResources(device, lit(floor(), camera=CAMERA, textures=[checkered()]))
    assert with_texture.texture_bytes == SceneResources(device, lit(floor(), camera=CAMERA)).texture_bytes


def test_materials(device):
    """Every parameter, in its own place."""
    first = Material(
        "a", (0.1, 0.2, 0.3), alpha=0.9, alpha_cutoff=0.4, metallic=0.5, roughness=0.6, specular=0.7,
        specular_color=(0.8, 0.85, 0.95), ior=1.7, transmission=0.25, thin=True, emission=(4.0, 5.0, 6.0), normal_scale=0.35,
        double_sided=False,
    )  # fmt: skip
    scene = lit(floor(), camera=CAMERA, materials=[first, grey(0.5)])
    records = SceneResources(device, scene).arrays["materials"].get()
    for record, material in zip(records, scene.materials, strict=True):
        for name in records.dtype.names:
            if not name.endswith("_map") and name not in ("emitter_density", "graph", "outputs"):
                value = getattr(material, name)
                np.testing.assert_array_equal(
                    record[name], np.asarray(0 if value is None else value, record[name].dtype)
                )
    maps = ["base_color_map", "metallic_roughness_map", "emission_map", "normal_map", "graph", "outputs"]
    assert all((records[name] == -1).all() for name in maps)


def test_uses_of_textures(device):
    """A material names a use, and that a texture and where it lies; several may show the same one."""
    turned = TextureUse(1, (0.0, 2.0, 0.5, -1.0, 0.0, 0.25))
    materials = [
        Material("a", base_color_texture=TextureUse(1), normal_texture=TextureUse(0)),
        Material("b", emission_texture=turned, metallic_roughness_texture=TextureUse(1)),
    ]
    textures = [checkered(2), checkered(4)]
    arrays = SceneResources(device, lit(floor(), camera=CAMERA, materials=materials, textures=textures)).arrays
    uses, records = arrays["uses"].get(), arrays["materials"].get()
    for record, material in zip(records, materials, strict=True):
        for name in ("base_color", "metallic_roughness", "emission", "normal"):
            use, number = getattr(material, f"{name}_texture"), record[f"{name}_map"]
            assert (use is None) == (number == -1)
            if use is not None:
                assert uses[number]["texture"] == use.index
                np.testing.assert_array_equal(uses[number]["transform"], np.float32(use.transform))


# Graphs


def test_places_of_a_graphs_values(device):
    """Packed in the order of OUTPUTS, whatever a graph lacks; -1 for what is not driven, and where there is no graph."""
    some = ("emission", "metallic", "normal")
    materials = [by_graph(*OUTPUTS), grey(0.5), by_graph(*some), by_graph("specular_color", "specular", scale=2.0)]
    resources = SceneResources(device, lit(floor(), camera=CAMERA, materials=materials))
    records = resources.arrays["materials"].get()
    assert list(records["graph"]) == [0, -1, 1, 2]
    none = [-1] * 7
    assert records["outputs"].tolist() == [
        [0, 3, 4, 5, 6, 9, 12],
        none,
        [-1, 0, -1, -1, -1, 1, 4],
        [-1, -1, -1, 0, 1, -1, -1],
    ]
    assert resources.graph_channels == resources.defines["GRAPH_CHANNELS"] == 15
    assert resources.graphs == tuple(m.graph for m in materials if m.graph)
    assert "graph_2" in resources.graph_source and "graph_3" not in resources.graph_source
    assert "emission" not in resources.graph_source


def test_equal_graphs_are_one(device):
    """By what they compute, and of which pictures; not by where they are written."""
    first, same, other = (by_graph("base_color", scale=s, textures=1) for s in (3.0, 3.0, 4.0))
    elsewhere = replace(same, graph_textures=(TextureUse(1),), roughness=0.5)
    materials, textures = [first, same, other, elsewhere], [checkered(2), checkered(4)]
    resources = SceneResources(device, lit(floor(), camera=CAMERA, materials=materials, textures=textures))
    assert list(resources.arrays["materials"].get()["graph"]) == [0, 0, 1, 2]
    assert len(resources.graphs) == 3
    assert list(resources.arrays["uses"].get()["texture"]) == [0, 0, 1]


def test_pictures_of_graphs_are_numbered_after_those_of_maps(device):
    """The generated text names the uses as they are uploaded."""
    maps = Material("m", base_color_texture=TextureUse(2), normal_texture=TextureUse(0))
    graph = by_graph(textures=2)
    scene = lit(floor(), camera=CAMERA, materials=[graph, maps], textures=[checkered(2), checkered(4), checkered(8)])
    resources = SceneResources(device, scene)
    uses = resources.arrays["uses"].get()
    named = [int(n) for n in re.findall(r"Image\(maps, (\d+),", resources.graph_source)]
    assert [uses[n]["texture"] for n in named] == [0, 1] and sorted(named) == [2, 3]


def test_a_graph_needs_texture_coordinates_but_no_pictures(device):
    scene = lit(without_uvs(floor()), camera=CAMERA, materials=[by_graph("base_color")])
    resources = SceneResources(device, scene)
    assert {"uvs", "uses", "textures", "texels", "srgb"} <= resources.arrays.keys()
    assert not resources.arrays["uvs"].get().any() and resources.arrays["texels"].size == 1


def test_light_of_graphs_has_no_chance_of_being_sampled(device):
    """Beside lamps that have one, and whatever else is said of its emission."""
    by_rays = by_graph("emission", emission=(9.0, 9.0, 9.0))
    scene = replace(everything(), materials=(by_rays, grey(0.5, 1.0), grey(0.0, 3.0)))
    records = SceneResources(device, scene).arrays["materials"].get()
    assert records["emitter_density"][0] == 0 and (records["emitter_density"][1:] > 0).all()


def test_materials_of_triangles_of_several_meshes(device):
    meshes = [shape_mesh(plane((1, 1)), k) for k in (2, 0, 1)]
    scene = lit(*meshes, camera=CAMERA, materials=[grey(k / 4) for k in range(3)])
    np.testing.assert_array_equal(SceneResources(device, scene).arrays["material"].get(), [2, 2, 0, 0, 1, 1])


def test_punctual_lights(device):
    lights = [
        PointLight((1, 2, 3), (4, 5, 6)),
        DirectionalLight((0.0, -0.6, 0.8), (7, 8, 9)),
        SpotLight((3, 2, 1), (0.0, 0.6, -0.8), (6, 5, 4), np.arccos(0.75), np.arccos(0.25)),
    ]
    records = SceneResources(device, lit(floor(), camera=CAMERA, lights=lights)).arrays["emitter_list"].get()
    np.testing.assert_array_equal(records["kind"], [0, 1, 0])
    np.testing.assert_array_equal(records["position"][[0, 2]], [[1, 2, 3], [3, 2, 1]])
    np.testing.assert_allclose(records["direction"][1:], [[0, 0.6, -0.8], [0, 0.6, -0.8]], rtol=1e-6)
    np.testing.assert_array_equal(records["power"], [[4, 5, 6], [7, 8, 9], [6, 5, 4]])
    # Full at the inner angle, none at the outer one, whatever the direction from a point.
    np.testing.assert_allclose(records["cone"] @ [[0.75, 0.25], [1, 1]], [[1, 1], [0 * 0.75 + 0, 0], [1, 0]], atol=1e-6)


def test_emissive_triangles(device):
    """Each triangle of each instance that emits is one, by the numbers that the tracer gives it."""
    mesh = replace(ball(1, 0), material=np.arange(20, dtype=np.uint32) % 2)
    places = [(0, np.eye(3, 4)), (0, 2 * np.eye(3, 4))]
    scene = lit(mesh, camera=CAMERA, materials=[grey(0.5), grey(0.0, 2.0)], instances=places)
    records = SceneResources(device, scene).arrays["emitter_list"].get()
    assert (records["kind"] == 2).all()
    np.testing.assert_array_equal(records["instance"], np.repeat([0, 1], 10))
    np.testing.assert_array_equal(records["primitive"], np.tile(np.arange(1, 20, 2), 2))


def test_textures(device):
    """One behind the other, each with its mip levels, a 32-bit word for each texel, red in the lowest byte."""
    rng = np.random.default_rng(1)
    sizes, wraps = [(2, 3), (1, 1), (4, 2)], [("repeat", "clamp"), ("mirror", "repeat"), ("clamp", "mirror")]
    pictures = [rng.integers(0, 256, (h, w, 4), dtype=np.uint8) for w, h in sizes]
    textures = [Texture(f"t{k}", p, k != 1, wrap) for k, (p, wrap) in enumerate(zip(pictures, wraps, strict=True))]
    scene = lit(floor(), camera=CAMERA, materials=[textured(base_color=1)], textures=textures)
    resources = SceneResources(device, scene)
    records, texels = resources.arrays["textures"].get(), resources.arrays["texels"].get()
    np.testing.assert_array_equal(records["first_texel"][:, :3], [[0, 6, 0], [7, 0, 0], [8, 16, 18]])
    np.testing.assert_array_equal(records["levels"], [2, 1, 3])
    np.testing.assert_array_equal(np.column_stack([records["width"], records["height"]]), sizes)
    np.testing.assert_array_equal(records["wrap"], [[0, 1], [2, 0], [1, 2]])
    np.testing.assert_array_equal(records["srgb"], [1, 0, 1])
    for record, picture, texture in zip(records, pictures, textures, strict=True):
        for first, level in zip(record["first_texel"], [picture, *mip_chain(texture)[1:]], strict=False):
            count = level.shape[0] * level.shape[1]
            stored = texels[first : first + count].reshape(level.shape[:2])
            for channel in range(4):
                np.testing.assert_array_equal(stored >> (8 * channel) & 255, level[..., channel])
    of_pictures = ("texels", "textures", "uses", "sky")
    assert resources.texture_bytes == sum(resources.arrays[name].nbytes for name in of_pictures)


def test_pictures_may_be_views_of_others(device):
    """A flipped or cropped picture, whose rows are not one behind the other in memory."""
    picture = np.arange(4 * 6 * 4, dtype=np.uint8).reshape(4, 6, 4)
    texture = Texture("t", picture[::-1, 1:5])
    scene = lit(floor(), camera=CAMERA, materials=[textured(base_color=0)], textures=[texture])
    texels = SceneResources(device, scene).arrays["texels"].get()
    np.testing.assert_array_equal(texels.view(np.uint8)[:64].reshape(4, 4, 4), picture[::-1, 1:5])


def test_memory_is_counted_and_its_end_is_an_error():
    device = Device()
    scene = everything()
    resources = SceneResources(device, scene)
    assert device.allocated >= sum(a.nbytes for a in {id(a): a for a in resources.arrays.values()}.values())
    device.capabilities = replace(device.capabilities, global_memory=device.allocated + 100)
    with pytest.raises(DeviceError, match=r"needs .* beside the .* already taken"):
        SceneResources(device, scene)
