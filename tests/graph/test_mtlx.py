"""MaterialX documents: what their nodes, connections, colours and surface shaders become."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from clcache.errors import SceneError
from clcache.graph import load
from clcache.graph.mtlx_file import standard_library
from clcache.graph.mtlx_signals import Builder

DATA = Path(__file__).parents[2] / "data" / "graphs"
POINTS = np.random.default_rng(1).uniform(-0.5, 1.5, (40, 2)).astype(np.float32)
PLACES = np.random.default_rng(2).uniform(-2.0, 2.0, (40, 3)).astype(np.float32)
U, V = POINTS[:, 0], 1.0 - POINTS[:, 1]  # as MaterialX has them: v upwards
COLOUR = '<convert name="colour" type="color3"><input name="in" type="{type}" nodename="{name}" /></convert>'


def write(folder, body, name="test.mtlx", root='version="1.39"'):
    path = folder / name
    path.write_text(f'<?xml version="1.0"?>\n<materialx {root}>\n{body}\n</materialx>\n')
    return path


def node(kind, name, type_name, **inputs):
    """A node. Each input: (type, value), or (type, "@node") or (type, "@node.output") to connect it."""
    lines = []
    for key, (kind_of_input, value) in inputs.items():
        key = key.rstrip("_")
        if value.startswith("@"):
            source, _, output = value[1:].partition(".")
            rest = f'nodename="{source}"' + (f' output="{output}"' if output else "")
        else:
            rest = f'value="{value}"'
        lines.append(f'<input name="{key}" type="{kind_of_input}" {rest} />')
    return f'<{kind} name="{name}" type="{type_name}">{"".join(lines)}</{kind}>'


def graph_of(folder, nodes, type_name="color3", last="a", **root):
    """The graph of a document with one nodegraph, whose output of colour is made from the node `last`."""
    if type_name != "color3":
        nodes += COLOUR.format(type=type_name, name=last)
        last = "colour"
    body = f'<nodegraph name="g">{nodes}<output name="out" type="color3" nodename="{last}" /></nodegraph>'
    return load(write(folder, body, **root))


def colour(graph):
    return graph.evaluate(POINTS, position=PLACES)["base_color"]


def constant_colour(graph):
    assert not graph.outputs
    return graph.graph.constants["base_color"]


UV = node("texcoord", "uv", "vector2")
PLACE = node("position", "place", "vector3")


# Documents of the project.


@pytest.mark.parametrize(
    "file, material, outputs, reads",
    [
        ("parquet.mtlx", None, {"base_color", "roughness", "normal"}, {"uv"}),
        ("granite.mtlx", "Granite", {"base_color", "roughness"}, {"position"}),
        ("signs.mtlx", "Sign", {"base_color"}, {"uv"}),
        ("signs.mtlx", "Brushed", {"roughness"}, {"uv"}),
        ("checks.mtlx", None, {"base_color"}, {"uv"}),
    ],
)
def test_documents_of_the_project(file, material, outputs, reads):
    graph = load(DATA / file, material)
    assert set(graph.outputs) == outputs and graph.reads == reads and graph.graph.notes == ()
    values = graph.evaluate(POINTS, position=PLACES)
    assert all(np.isfinite(value).all() and np.ptp(value, axis=0).max() > 0.0 for value in values.values())


def test_pictures_and_ramps_stand_upright():
    """The arrow's picture: v = 0 is its first row, and the ramp's top is where the picture's is."""
    graph = load(DATA / "signs.mtlx", "Sign")
    picture = np.asarray(Image.open(DATA / "pictures" / "arrow.png").convert("RGB")) / 255.0
    linear = np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)
    row, column = np.meshgrid([3, 20, 40, 60], [2, 20, 32, 50], indexing="ij")
    uv = (np.stack([column.ravel(), row.ravel()], axis=1) + 0.5) / 64
    shade = (1.0 - 0.7 * uv[:, 1])[:, None]
    found = graph.evaluate(uv)["base_color"]
    assert np.allclose(found, linear[row.ravel(), column.ravel()] * shade, atol=0.01)


# Nodes.

NUMBERS = ("float", "integer", "boolean", "vector2", "vector3", "vector4", "color3", "color4")
NOT_SUPPORTED = {
    "artistic_ior", "bitangent", "blackbody", "chiang_hair_absorption_from_color", "chiang_hair_roughness",
    "deon_hair_absorption_from_melanin", "determinant", "facingratio", "flake2d", "flake3d", "frame", "geomcolor",
    "geompropvalue", "glossiness_anisotropy", "gooch_shade", "hextiledimage", "hextilednormalmap", "reflect",
    "refract", "roughness_anisotropy", "roughness_dual", "standard_surface_to_gltf_pbr", "tangent", "time",
    "transformnormal", "transformpoint",
    "transformvector", "UsdPrimvarReader", "viewdirection",
}  # fmt: skip
NORMAL_MAPS = {"bump", "gltf_normalmap", "normalmap"}  # of which a colour can be made of none
CONSTANT = {"index", "layer", "octaves", "style"}


def document_that_calls(definition, connect):
    """One node of each kind of number that varies, connected, if asked, to whatever inputs a definition has for it."""
    place = node("position", "vector3", "vector3")
    sources = place + node("extract", "float", "float", in_=("vector3", "@vector3"))
    sources += node("floor", "integer", "integer", in_=("float", "@float"))
    sources += node("ifgreater", "boolean", "boolean", value1=("float", "@float"))
    for kind in ("vector2", "vector4", "color3", "color4"):
        sources += node("convert", kind, kind, in_=("vector3", "@vector3"))
    connected = [
        f'<input name="{port.getName()}" type="{port.getType()}" nodename="{port.getType()}" />'
        for port in definition.getActiveInputs()
        if connect
        and port.getType() in NUMBERS
        and not port.getIsUniform()
        and port.getName() not in CONSTANT
        and not port.getDefaultGeomPropString().endswith("world")
    ]
    outputs = definition.getActiveOutputs()
    kind = outputs[0].getType() if len(outputs) == 1 else "multioutput"
    call = f'<{definition.getNodeString()} name="a" type="{kind}" nodedef="{definition.getName()}">'
    call += "".join(connected) + f"</{definition.getNodeString()}>"
    ends = ""
    for i, port in enumerate(outputs):  # there is no conversion of a type to itself
        turn = "dot" if port.getType() == "color3" else "convert"
        source = f"@a.{port.getName()}" if len(outputs) > 1 else "@a"
        ends += node(turn, f"c{i}", "color3", in_=(port.getType(), source))
        ends += node("add", f"t{i}", "color3", in1=("color3", f"@t{i - 1}" if i else "0,0,0"), in2=("color3", f"@c{i}"))
    total = f"t{len(outputs) - 1}"
    text = sources + call + ends
    return f'<nodegraph name="g">{text}<output name="out" type="color3" nodename="{total}" /></nodegraph>'


@pytest.mark.parametrize("connect", [True, False])
def test_every_node_of_the_library_computes_numbers_or_is_refused(tmp_path, connect):
    refused, computed = set(), set()
    for definition in standard_library().getNodeDefs():
        if not all(port.getType() in NUMBERS for port in definition.getActiveOutputs()):
            continue
        kind = definition.getNodeString()
        try:
            graph = load(write(tmp_path, document_that_calls(definition, connect)))
        except SceneError as error:
            assert "test.mtlx:3: " in str(error) and "\n" not in str(error)
            refused.add(kind)
            if not any(port.getType().startswith("matrix") for port in definition.getActiveInputs()):
                assert "not supported" in str(error) or "expected" in str(error), error
        else:
            computed.add(kind)
            values = colour(graph) if graph.outputs else constant_colour(graph)
            assert np.isfinite(values).all(), definition.getName()
    assert refused - computed == NOT_SUPPORTED | NORMAL_MAPS
    assert len(computed) > 100


def test_a_node_of_another_type_is_refused(tmp_path):
    with pytest.raises(SceneError, match="test.mtlx:3: Mismatched types in port connection, at input in1"):
        graph_of(tmp_path, UV + node("add", "a", "color3", in1=("color3", "@uv")))


X, Y, Z = PLACES.astype(float).T
XYZ = np.stack([X, Y, Z], axis=1)


@pytest.mark.parametrize(
    "kind, inputs, expected",
    [
        ("subtract", {"in1": ("vector3", "1,2,3"), "in2": ("vector3", "@place")}, np.array([1, 2, 3]) - XYZ),
        ("subtract", {"in1": ("vector3", "0,0,0"), "in2": ("vector3", "@place")}, -XYZ),
        ("divide", {"in1": ("vector3", "@place"), "in2": ("float", "4")}, XYZ / 4),
        ("modulo", {"in1": ("vector3", "@place"), "in2": ("float", "0.75")}, XYZ % 0.75),
        ("power", {"in1": ("vector3", "@positive"), "in2": ("float", "2.5")}, np.abs(XYZ) ** 2.5),
        ("safepower", {"in1": ("vector3", "@place"), "in2": ("float", "3")}, XYZ**3),
        ("invert", {"in": ("vector3", "@place"), "amount": ("vector3", "1,2,3")}, np.array([1, 2, 3]) - XYZ),
        ("sign", {"in": ("vector3", "@place")}, np.sign(XYZ)),
        ("cos", {"in": ("vector3", "@place")}, np.cos(XYZ)),
        ("exp", {"in": ("vector3", "@place")}, np.exp(XYZ)),
        ("ln", {"in": ("vector3", "@positive")}, np.log(np.abs(XYZ))),
        ("atan2", {"iny": ("vector3", "@place"), "inx": ("vector3", "1,-1,1")}, np.arctan2(XYZ, [1, -1, 1])),
        ("clamp", {"in": ("vector3", "@place"), "low": ("float", "-0.5")}, np.clip(XYZ, -0.5, 1.0)),
        ("crossproduct", {"in1": ("vector3", "@place"), "in2": ("vector3", "1,2,3")}, np.cross(XYZ, [1, 2, 3])),
        ("normalize", {"in": ("vector3", "@place")}, XYZ / np.linalg.norm(XYZ, axis=1, keepdims=True)),
        (
            "remap",
            {"in": ("vector3", "@place"), "inlow": ("vector3", "-1,-1,-1"), "outhigh": ("vector3", "2,3,4")},
            (XYZ + 1) / 2 * [2, 3, 4],
        ),
        (
            "smoothstep",
            {"in": ("vector3", "@place"), "low": ("float", "-1"), "high": ("float", "1")},
            (lambda t: t * t * (3 - 2 * t))(np.clip((XYZ + 1) / 2, 0, 1)),
        ),
        (
            "mix",
            {"fg": ("vector3", "@place"), "bg": ("vector3", "1,1,1"), "mix": ("float", "0.25")},
            0.25 * XYZ + 0.75,
        ),
        # A quarter turn about y, as a row vector times a matrix does it: x becomes z.
        ("rotate3d", {"in": ("vector3", "@place"), "amount": ("float", "90")}, np.stack([-Z, Y, X], axis=1)),
        (
            "transformmatrix",
            {"in": ("vector3", "@place"), "mat": ("matrix44", "1,2,3,0,4,5,6,0,7,8,9,0,10,11,12,1")},
            XYZ @ np.arange(1, 10).reshape(3, 3) + [10, 11, 12],
        ),
    ],
)
def test_vector_nodes(tmp_path, kind, inputs, expected):
    positive = node("absval", "positive", "vector3", in_=("vector3", "@place"))
    graph = graph_of(tmp_path, PLACE + positive + node(kind, "a", "vector3", **inputs), "vector3")
    assert np.allclose(colour(graph), expected, rtol=1e-4, atol=1e-5)


def test_choices_and_logic(tmp_path):
    """1 where x > y and not z >= 0, through booleans."""
    nodes = PLACE + node("separate3", "p", "multioutput", in_=("vector3", "@place"))
    nodes += node("ifgreater", "more", "boolean", value1=("float", "@p.outx"), value2=("float", "@p.outy"))
    nodes += node("ifgreatereq", "front", "boolean", value1=("float", "@p.outz"), value2=("float", "0"))
    nodes += node("not", "behind", "boolean", in_=("boolean", "@front"))
    nodes += node("and", "both", "boolean", in1=("boolean", "@more"), in2=("boolean", "@behind"))
    nodes += node(
        "ifequal", "a", "color3", value1=("boolean", "@both"), value2=("boolean", "true"),
        in1=("color3", "1,2,3"), in2=("color3", "4,5,6"),
    )  # fmt: skip
    both = (X > Y) & (Z < 0)
    assert both.any() and not both.all()
    assert np.array_equal(colour(graph_of(tmp_path, nodes)), np.where(both[:, None], [1, 2, 3], [4, 5, 6]))


def test_channels(tmp_path):
    """Extract, combine and both ways of naming the outputs of separate."""
    nodes = PLACE + node("extract", "y", "float", in_=("vector3", "@place"), index=("integer", "1"))
    nodes += node("combine2", "xy", "vector2", in1=("float", "7"), in2=("float", "@y"))
    nodes += node("combine2", "xyxy", "vector4", in1=("vector2", "@xy"), in2=("vector2", "3,4"))
    nodes += node("convert", "c", "color4", in_=("vector4", "@xyxy"))
    nodes += node("separate4", "s", "multioutput", in_=("color4", "@c"))
    nodes += node(
        "combine3", "a", "color3", in1=("float", "@s.outg"), in2=("float", "@s.outa"), in3=("float", "@s.outr")
    )
    assert np.allclose(colour(graph_of(tmp_path, nodes)), np.stack([Y, 0 * Y + 4, 0 * Y + 7], axis=1))


@pytest.mark.parametrize(
    "kind, expected",
    [
        ("over", [0.1 + 0.5 * 0.4, 0.2 + 0.6 * 0.4, 0.3 + 0.7 * 0.4]),
        ("matte", [0.1 * 0.6 + 0.5 * 0.4, 0.2 * 0.6 + 0.6 * 0.4, 0.3 * 0.6 + 0.7 * 0.4]),
        ("in", [0.1 * 0.8, 0.2 * 0.8, 0.3 * 0.8]),
        ("mask", [0.5 * 0.6, 0.6 * 0.6, 0.7 * 0.6]),
        ("screen", [1 - 0.9 * 0.5, 1 - 0.8 * 0.4, 1 - 0.7 * 0.3]),
        ("difference", [0.4, 0.4, 0.4]),
    ],
)
def test_compositing_of_constants(tmp_path, kind, expected):
    fg, bg = ("color4", "0.1, 0.2, 0.3, 0.6"), ("color4", "0.5, 0.6, 0.7, 0.8")
    graph = graph_of(tmp_path, node(kind, "a", "color4", fg=fg, bg=bg), "color4")
    assert np.allclose(constant_colour(graph), expected)


def test_noise_of_several_channels(tmp_path):
    """Two channels of fractal noise are two noises at a distance; the fourth of a noise of four is one, too."""
    two = node("fractal3d", "a", "vector2", amplitude=("vector2", "2,3"), position=("vector3", "@place"))
    far = node("add", "far", "vector3", in1=("vector3", "@place"), in2=("vector3", "19,193,17"))
    one = node("fractal3d", "a", "float", position=("vector3", "@far"))
    found = colour(graph_of(tmp_path, PLACE + two, "vector2"))
    assert np.allclose(found[:, 1], 3 * colour(graph_of(tmp_path, PLACE + far + one, "float"))[:, 0], atol=1e-5)
    assert np.all(found[:, 2] == 0.0) and np.ptp(found[:, 0]) > 0.1


@pytest.mark.parametrize("kind", ["noise2d", "noise3d", "fractal2d", "fractal3d"])
@pytest.mark.parametrize("type_name, channels", [("vector2", 2), ("color3", 3), ("vector4", 4)])
def test_noise_of_one_amplitude_has_the_outputs_channels(tmp_path, kind, type_name, channels):
    one = node(kind, "a", type_name, amplitude=("float", "2"))
    all_alike = node(kind, "a", type_name, amplitude=(f"vector{channels}", ",".join(["2"] * channels)))
    found, expected = (colour(graph_of(tmp_path, text, type_name)) for text in (one, all_alike))
    assert np.array_equal(found, expected)
    assert np.ptp(found[:, :2], axis=1).max() > 0.1


def test_octaves_beyond_the_most_are_cut_and_said(tmp_path):
    noise = [
        node("fractal3d", "a", "float", octaves=("integer", n), position=("vector3", "@place")) for n in ("16", "99")
    ]
    most, more = (graph_of(tmp_path, PLACE + text, "float") for text in noise)
    assert np.array_equal(colour(most), colour(more))
    assert (most.graph.notes, more.graph.notes) == ((), ("line 3: fractal3d a: 99 octaves of noise are cut to 16",))


def test_texture_coordinates_grow_upwards(tmp_path):
    assert np.allclose(colour(graph_of(tmp_path, UV, "vector2", "uv")), np.stack([U, V, 0 * U], axis=1), atol=1e-6)
    default = node("ramptb", "a", "float", valuet=("float", "1"), valueb=("float", "0"))
    assert np.allclose(colour(graph_of(tmp_path, default, "float"))[:, 0], np.clip(V, 0, 1), atol=1e-6)


def test_the_standards_example_of_a_nodegraph(tmp_path):
    """checkerboard is implemented by a graph of the library: a check is where floor(u) + floor(v) is odd."""
    tiling = ("vector2", "8, 4")
    graph = graph_of(tmp_path, node("checkerboard", "a", "color3", uvtiling=tiling, color1=("color3", "1,0,0")))
    odd = (np.floor(8 * U) + np.floor(4 * V)) % 2 == 1
    assert odd.any() and np.array_equal(colour(graph)[:, 0] == 1.0, odd)


# Pictures.


def picture(folder, name="p.png", size=(8, 4)):
    pixels = np.random.default_rng(3).integers(0, 256, (size[1], size[0], 4), dtype=np.uint8)
    Image.fromarray(pixels, "RGBA").save(folder / name)
    return pixels / 255.0


def texels(size=(8, 4)):
    """Centres of all texels of a picture, as the project's texture coordinates."""
    u, v = np.meshgrid((np.arange(size[0]) + 0.5) / size[0], (np.arange(size[1]) + 0.5) / size[1])
    return np.stack([u.ravel(), v.ravel()], axis=1)


FILE = ("filename", "p.png")


@pytest.mark.parametrize("type_name, channels", [("float", 1), ("vector2", 2), ("vector3", 3), ("color3", 3)])
def test_images_give_the_first_channels(tmp_path, type_name, channels):
    pixels = picture(tmp_path)
    graph = graph_of(tmp_path, node("image", "a", type_name, file=FILE), type_name)
    found = graph.evaluate(texels())["base_color"]
    expected = np.repeat(pixels[..., :1], 3, 2) if channels == 1 else pixels[..., :3].copy()
    expected[..., 2] *= channels != 2
    assert np.allclose(found, expected.reshape(-1, 3), atol=1e-5)
    assert [texture.srgb for texture in graph.graph.textures] == [False]


def test_tiling_is_one_multiplication(tmp_path):
    """What constants do to texture coordinates is done at once, both turns of v included."""
    pixels = picture(tmp_path)
    tiled = node(
        "tiledimage", "a", "color3", file=FILE, uvtiling=("vector2", "3, 5"), uvoffset=("vector2", "0.5, 2.25")
    )
    graph = graph_of(tmp_path, tiled)
    assert [n.kind for n in graph.graph.nodes] == ["UVInput", "Mul", "Add", "Image", "Color"]
    u, up = texels().T[0], 1.0 - texels().T[1]
    s, t = (3 * u - 0.5) % 1.0, (5 * up - 2.25) % 1.0
    column, row = np.floor(s * 8).astype(int) % 8, np.floor((1.0 - t) * 4).astype(int) % 4
    on_a_texel = np.isclose((s * 8) % 1, 0.5, atol=1e-4) & np.isclose((t * 4) % 1, 0.5, atol=1e-4)
    assert on_a_texel.any()
    found = graph.evaluate(texels())["base_color"]
    assert np.allclose(found[on_a_texel], pixels[row, column, :3][on_a_texel], atol=1e-4)
    whole = graph_of(tmp_path, node("tiledimage", "a", "color3", file=FILE, uvtiling=("vector2", "4, 4")))
    assert [n.kind for n in whole.graph.nodes] == ["UVInput", "Mul", "Image", "Color"]


def test_units_are_converted(tmp_path):
    """Angles to degrees; a tile of 18 inches of a picture of 3 feet is half of it."""
    picture(tmp_path)
    turn = node("rotate2d", "a", "vector2", in_=("vector2", "@uv"), amount=("float", "{}"))
    degrees = UV + turn.format("90")
    radians = UV + turn.format(str(np.pi / 2)).replace(
        f'"{np.pi / 2}"', f'"{np.pi / 2}" unit="radian" unittype="angle"'
    )
    found, expected = (colour(graph_of(tmp_path, text, "vector2")) for text in (radians, degrees))
    assert np.allclose(found, expected, atol=1e-5)
    sizes = {"realworldimagesize": ("vector2", "3, 3"), "realworldtilesize": ("vector2", "18, 18")}
    inches = node("tiledimage", "a", "color3", file=FILE, **sizes)
    for numbers, unit in (("3, 3", "foot"), ("18, 18", "inch")):
        inches = inches.replace(f'"{numbers}"', f'"{numbers}" unit="{unit}" unittype="distance"')
    sizes["realworldimagesize"] = ("vector2", "36, 36")
    plain = node("tiledimage", "a", "color3", file=FILE, **sizes)
    found, expected = (colour(graph_of(tmp_path, text)) for text in (inches, plain))
    assert np.allclose(found, expected, atol=1e-4) and np.ptp(found) > 0.1


def test_an_image_at_computed_coordinates(tmp_path):
    """A quarter turn: MaterialX's (v, -u) is this package's (1 - v, 1 + u), modulo the picture."""
    pixels = picture(tmp_path, size=(4, 4))
    turned = node("rotate2d", "turned", "vector2", in_=("vector2", "@uv"), amount=("float", "90"))
    graph = graph_of(
        tmp_path, UV + turned + node("image", "a", "vector3", file=FILE, texcoord=("vector2", "@turned")), "vector3"
    )
    u, v = texels((4, 4)).T
    column, row = np.floor(((1.0 - v) % 1.0) * 4).astype(int), np.floor(((1.0 + u) % 1.0) * 4).astype(int)
    assert np.allclose(graph.evaluate(texels((4, 4)))["base_color"], pixels[row, column, :3], atol=1e-4)


def test_address_modes(tmp_path):
    picture(tmp_path)
    modes = {"uaddressmode": ("string", "mirror"), "vaddressmode": ("string", "clamp")}
    graph = graph_of(tmp_path, node("image", "a", "color3", file=FILE, **modes))
    assert graph.graph.textures[0].wrap == ("mirror", "clamp")
    modes["uaddressmode"] = ("string", "constant")
    with pytest.raises(SceneError, match="test.mtlx:3: image a: address mode 'constant' is not supported"):
        graph_of(tmp_path, node("image", "a", "color3", file=FILE, **modes))


STEPS = st.tuples(
    st.sampled_from(["add", "subtract", "multiply", "divide", "from"]),
    st.sampled_from([-2.0, -0.5, 0.25, 1.0, 2.0, 3.0]),
    st.sampled_from([-1.5, -1.0, 0.5, 1.0, 4.0]),
)


@given(st.lists(STEPS, max_size=5), st.sampled_from(["periodic", "mirror", "clamp"]))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_constants_on_the_way_to_a_picture(tmp_path, steps, mode):
    """However constants move and scale its coordinates: as the picture alone, at coordinates that NumPy moves so."""
    picture(tmp_path)
    nodes, last, at = UV, "uv", texels() * [1, -1] + [0, 1]
    compute = {"add": np.add, "subtract": np.subtract, "multiply": np.multiply, "divide": np.divide}
    for i, (kind, x, y) in enumerate(steps):
        constant, before = ("vector2", f"{x}, {y}"), ("vector2", f"@{last}")
        if kind == "from":
            nodes += node("subtract", f"n{i}", "vector2", in1=constant, in2=before)
            at = [x, y] - at
        else:
            nodes += node(kind, f"n{i}", "vector2", in1=before, in2=constant)
            at = compute[kind](at, [x, y])
        last = f"n{i}"
    modes = {"uaddressmode": ("string", mode), "vaddressmode": ("string", mode)}
    plain = graph_of(tmp_path, node("image", "a", "color3", file=FILE, **modes))
    moved = graph_of(
        tmp_path, nodes + node("image", "a", "color3", file=FILE, texcoord=("vector2", f"@{last}"), **modes)
    )
    assert moved.cost <= 5
    expected = plain.evaluate(at * [1, -1] + [0, 1])["base_color"]
    assert np.allclose(moved.evaluate(texels())["base_color"], expected, atol=2e-4)


def test_pictures_share_the_way_to_their_coordinates(tmp_path, monkeypatch):
    """Each of many nodes is looked at once, however many pictures come behind it."""
    picture(tmp_path)
    steps, one_step = [], Builder._affine_step
    monkeypatch.setattr(Builder, "_affine_step", lambda *a: steps.append(a) or one_step(*a))
    nodes = UV + "".join(
        node("add", f"n{i}", "vector2", in1=("vector2", f"@n{i - 1}" if i else "@uv"), in2=("vector2", f"0.{i + 1}, 0"))
        for i in range(100)
    )
    nodes += "".join(
        node("image", f"i{i}", "color3", file=FILE, texcoord=("vector2", "@n99"))
        + node("add", f"a{i}", "color3", in1=("color3", f"@i{i}"), in2=("color3", f"@a{i - 1}" if i else "0,0,0"))
        for i in range(100)
    )
    graph_of(tmp_path, nodes, last="a99")
    assert 100 <= len(steps) < 200


def test_an_image_at_one_place(tmp_path):
    pixels = picture(tmp_path)
    graph = graph_of(
        tmp_path, node("image", "a", "vector3", file=FILE, texcoord=("vector2", "0.0625, 0.125")), "vector3"
    )
    assert np.allclose(colour(graph), pixels[-1, 0, :3], atol=1e-5)


def test_an_image_at_coordinates_that_overflow(tmp_path):
    picture(tmp_path)
    nodes, last = UV + node("add", "moved", "vector2", in1=("vector2", "@uv"), in2=("vector2", "1e38, 1e38")), "moved"
    for i in range(8):
        nodes += node("multiply", f"n{i}", "vector2", in1=("vector2", f"@{last}"), in2=("vector2", "1e38, -1e38"))
        last = f"n{i}"
    graph = graph_of(tmp_path, nodes + node("image", "a", "color3", file=FILE, texcoord=("vector2", f"@{last}")))
    assert np.isfinite(colour(graph)).all()


def test_an_image_without_a_file_is_its_default(tmp_path):
    image = node("image", "a", "color3", file=("filename", ""), default=("color3", "0.1, 0.2, 0.3"))
    assert np.allclose(constant_colour(graph_of(tmp_path, image)), (0.1, 0.2, 0.3))


def test_prefixes_of_files_and_files_by_interface(tmp_path):
    (tmp_path / "pictures" / "deep").mkdir(parents=True)
    picture(tmp_path / "pictures" / "deep")
    graph = (
        '<nodegraph name="g" fileprefix="pictures/deep/"><input name="f" type="filename" value="p.png" />'
        '<image name="a" type="color3"><input name="file" type="filename" interfacename="f" /></image>'
        '<output name="out" type="color3" nodename="a" /></nodegraph>'
    )
    assert load(write(tmp_path, graph)).graph.textures[0].file == "pictures/deep/p.png"


# Colours.


def srgb_to_linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


COLOURS = np.array([0.02, 0.4, 0.9])
P3_TO_709 = [[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]]


@pytest.mark.parametrize(
    "space, expected",
    [
        ("srgb_texture", srgb_to_linear(COLOURS)),
        ("lin_rec709", COLOURS),
        ("raw", COLOURS),
        ("g22_rec709", COLOURS**2.2),
        ("lin_displayp3", P3_TO_709 @ COLOURS),
    ],
)
def test_colours_become_linear_rec_709(tmp_path, space, expected):
    value = f'<input name="value" type="color3" value="0.02, 0.4, 0.9" colorspace="{space}" />'
    graph = graph_of(tmp_path, f'<constant name="a" type="color3">{value}</constant>')
    assert np.allclose(constant_colour(graph), expected, atol=1e-3)
    inherited = node("constant", "a", "color3", value=("color3", "0.02, 0.4, 0.9"))
    graph = graph_of(tmp_path, inherited, root=f'version="1.39" colorspace="{space}"')
    assert np.allclose(constant_colour(graph), expected, atol=1e-3)


def test_spaces_are_of_colours_alone(tmp_path):
    numbers = node("constant", "a", "vector3", value=("vector3", "0.02, 0.4, 0.9"))
    graph = graph_of(tmp_path, numbers, "vector3", root='version="1.39" colorspace="srgb_texture"')
    assert np.allclose(constant_colour(graph), COLOURS)
    picture(tmp_path)
    both = node("image", "i", "color3", file=FILE) + node("image", "j", "vector3", file=FILE)
    both += node("convert", "k", "color3", in_=("vector3", "@j"))
    both += node("add", "a", "color3", in1=("color3", "@i"), in2=("color3", "@k"))
    graph = graph_of(tmp_path, both, root='version="1.39" colorspace="srgb_texture"')
    assert [texture.srgb for texture in graph.graph.textures] == [True, False]


def test_pictures_in_other_spaces_are_converted_by_nodes(tmp_path):
    pixels = picture(tmp_path)
    image = node("image", "a", "color3", file=FILE).replace("/>", 'colorspace="g22_rec709" />')
    graph = graph_of(tmp_path, image)
    assert not graph.graph.textures[0].srgb
    assert np.allclose(graph.evaluate(texels())["base_color"], pixels[..., :3].reshape(-1, 3) ** 2.2, atol=1e-4)


def test_an_unknown_space_is_refused(tmp_path):
    image = node("image", "a", "color3", file=FILE).replace("/>", 'colorspace="klingon" />')
    picture(tmp_path)
    with pytest.raises(SceneError, match="test.mtlx:3: image a: colour space 'klingon' is not supported"):
        graph_of(tmp_path, image)


# Connections.


def test_inputs_of_graphs(tmp_path):
    """A nodegraph's own input: its value, or what it is connected to outside."""
    inner = (
        '<nodegraph name="{name}"><input name="tint" type="color3" {tint} />'
        + node("multiply", "a", "color3", in1=("color3", "2,2,2")).replace(
            "</", '<input name="in2" type="color3" interfacename="tint" /></'
        )
        + '<output name="out" type="color3" nodename="a" /></nodegraph>'
    )
    assert constant_colour(
        load(write(tmp_path, inner.format(name="g", tint='value="0.1, 0.2, 0.3"')))
    ) == pytest.approx((0.2, 0.4, 0.6))
    two = inner.format(name="first", tint='value="0.1, 0.2, 0.3"') + inner.format(
        name="second", tint='nodegraph="first" output="out"'
    )
    path = write(tmp_path, two)
    assert constant_colour(load(path, "second")) == pytest.approx((0.4, 0.8, 1.2))
    with pytest.raises(SceneError, match="test.mtlx: .*2 graphs. outputs of colour"):
        load(path)


def test_nodes_defined_by_the_document(tmp_path):
    """Each use of a node is an instance of its own; what is not given has the definition's default."""
    definition = (
        '<nodedef name="ND_half" node="half"><input name="x" type="color3" value="1, 1, 1" />'
        '<output name="low" type="color3" /><output name="high" type="color3" /></nodedef>'
        '<nodegraph name="NG_half" nodedef="ND_half"><multiply name="m" type="color3">'
        '<input name="in1" type="color3" interfacename="x" /><input name="in2" type="float" value="0.5" /></multiply>'
        '<add name="p" type="color3"><input name="in1" type="color3" interfacename="x" />'
        '<input name="in2" type="color3" value="1, 1, 1" /></add>'
        '<output name="low" type="color3" nodename="m" /><output name="high" type="color3" nodename="p" /></nodegraph>'
    )
    use = node("half", "h", "multioutput", x=("color3", "0.2, 0.4, 0.6")) + node("half", "i", "multioutput")
    use += node("half", "j", "multioutput", x=("color3", "@h.low"))
    use += node("add", "k", "color3", in1=("color3", "@j.low"), in2=("color3", "@i.high"))
    graph = f'<nodegraph name="g">{use}<output name="out" type="color3" nodename="k" /></nodegraph>'
    assert constant_colour(load(write(tmp_path, definition + graph))) == pytest.approx((2.05, 2.1, 2.15))


def test_the_documents_own_kind_of_a_known_name(tmp_path):
    """A definition in the document comes before what this package knows by the same name."""
    own = (
        '<nodedef name="ND_own" node="luminance"><input name="gain" type="float" value="2" />'
        '<output name="out" type="color3" /></nodedef><nodegraph name="NG_own" nodedef="ND_own">'
        '<multiply name="m" type="color3"><input name="in1" type="color3" value="0.1, 0.2, 0.3" />'
        '<input name="in2" type="float" interfacename="gain" /></multiply>'
        '<output name="out" type="color3" nodename="m" /></nodegraph>'
    )
    use = node("luminance", "a", "color3", gain=("float", "3"))
    graph = f'<nodegraph name="g">{use}<output name="out" type="color3" nodename="a" /></nodegraph>'
    assert constant_colour(load(write(tmp_path, own + graph))) == pytest.approx((0.3, 0.6, 0.9))


def test_definitions_count_not_what_nodes_are_called(tmp_path):
    """MaterialX goes by the definition that a node names; some graphs of its library do so, too."""
    sum_ = '<multiply name="a" type="color3" nodedef="ND_add_color3"><input name="in1" type="color3" value="1,2,3" />'
    assert constant_colour(graph_of(tmp_path, sum_ + "</multiply>")) == (1.0, 2.0, 3.0)
    by_definition = graph_of(tmp_path, '<image name="a" type="color3" nodedef="ND_noise2d_color3" />')
    assert np.array_equal(colour(by_definition), colour(graph_of(tmp_path, node("noise2d", "a", "color3"))))


def test_ramps_of_several_intervals(tmp_path):
    """Black to red at 1 / 2, and on to white at 1; linear."""
    ramp = node(
        "ramp", "a", "color4", interpolation=("integer", "0"), num_intervals=("integer", "2"), type=("integer", "0"),
        interval2=("float", "0.5"), color2=("color4", "1,0,0,1"), interval3=("float", "1"), color3=("color4", "1,1,1,1"),
    )  # fmt: skip
    found = graph_of(tmp_path, ramp, "color4").evaluate(POINTS)["base_color"]
    assert np.allclose(found[:, 0], np.interp(U, [0, 0.5], [0, 1]), atol=1e-4)
    assert np.allclose(found[:, 1], 0.0)


def test_places_of_nodes_and_of_what_an_upgrade_adds(tmp_path):
    """A node's own line; that of the graph around it for nodes that the document does not have."""
    old = '\n<position name="p" type="vector3" />\n<swizzle name="a" type="color3"><input name="in" type="vector3" nodename="p" />'
    graph = graph_of(
        tmp_path, old + '<parameter name="channels" type="string" value="zxy" /></swizzle>', root='version="1.36"'
    )
    places = {n.kind: n.place.removeprefix(str(tmp_path)) for n in graph.graph.nodes}
    assert places["PositionInput"] == "/test.mtlx:4: position p"
    assert places["Combine3"] == "/test.mtlx:5: combine3 a"
    assert places["Separate3"].startswith("/test.mtlx:3: separate3 ")


def test_documents_of_older_versions(tmp_path):
    """1.36: parameters, and channels picked at a connection and by swizzle; the package upgrades them."""
    old = (
        '<texcoord name="t" type="vector2" />'
        '<swizzle name="s" type="color3"><input name="in" type="vector2" nodename="t" />'
        '<parameter name="channels" type="string" value="yx1" /></swizzle>'
    )
    graph = graph_of(tmp_path, old, last="s", root='version="1.36"')
    assert np.allclose(colour(graph), np.stack([V, U, np.ones_like(U)], axis=1), atol=1e-6)


def test_long_chains(tmp_path):
    """Two thousand nodes in a row: as many as the document says, without recursion."""
    chain = PLACE + "".join(
        node("add", f"n{i}", "vector3", in1=("vector3", f"@n{i - 1}" if i else "@place"), in2=("vector3", "1,0,0"))
        for i in range(2000)
    )
    assert np.allclose(colour(graph_of(tmp_path, chain, "vector3", "n1999"))[:, 0], X + 2000, atol=1e-2)


# Surfaces.


def surface(folder, shader, inputs, nodes="", **arguments):
    material = (
        '<surfacematerial name="M" type="material"><input name="surfaceshader" type="surfaceshader" nodename="s" />'
    )
    return load(
        write(folder, nodes + node(shader, "s", "surfaceshader", **inputs) + material + "</surfacematerial>"),
        **arguments,
    )


def test_parameters_of_standard_surface(tmp_path):
    inputs = {
        "base": ("float", "0.5"), "base_color": ("color3", "0.2, 0.4, 0.8"), "metalness": ("float", "0.25"),
        "specular": ("float", "0.75"), "specular_color": ("color3", "1, 0.5, 0.25"), "specular_roughness": ("float", "0.3"),
        "specular_IOR": ("float", "1.33"), "transmission": ("float", "1"), "transmission_color": ("color3", "0.9, 1, 0.9"),
        "thin_walled": ("boolean", "true"), "emission": ("float", "3"), "emission_color": ("color3", "1, 0.5, 0"),
    }  # fmt: skip
    constants = surface(tmp_path, "standard_surface", inputs).graph.constants
    expected = {
        "base_color": (0.9, 1.0, 0.9), "metallic": 0.25, "specular": 0.75, "specular_color": (1.0, 0.5, 0.25),
        "roughness": 0.3, "ior": 1.33, "transmission": 1.0, "thin": True, "emission": (3.0, 1.5, 0.0),
    }  # fmt: skip
    assert set(constants) == set(expected)
    assert all(constants[name] == pytest.approx(value) for name, value in expected.items())
    del inputs["transmission"]
    assert surface(tmp_path, "standard_surface", inputs).graph.constants["base_color"] == pytest.approx((0.1, 0.2, 0.4))


def test_parameters_of_gltf_pbr_and_open_pbr(tmp_path):
    gltf = surface(
        tmp_path, "gltf_pbr",
        {"metallic": ("float", "0.5"), "roughness": ("float", "0.2"), "transmission": ("float", "0.5"),
         "emissive": ("color3", "1, 2, 3"), "emissive_strength": ("float", "2"), "ior": ("float", "1.2")},
    ).graph.constants  # fmt: skip
    assert gltf["base_color"] == (1.0, 1.0, 1.0) and gltf["emission"] == (2.0, 4.0, 6.0) and gltf["thin"] is True
    assert (gltf["metallic"], gltf["roughness"], gltf["ior"]) == pytest.approx((0.5, 0.2, 1.2))
    pbr = surface(
        tmp_path, "open_pbr_surface",
        {"base_weight": ("float", "0.5"), "base_color": ("color3", "0.4, 0.2, 0"), "specular_weight": ("float", "0.3"),
         "base_metalness": ("float", "1"), "emission_luminance": ("float", "4")},
    ).graph.constants  # fmt: skip
    assert pbr["base_color"] == pytest.approx((0.2, 0.1, 0.0)) and pbr["emission"] == (4.0, 4.0, 4.0)
    assert (pbr["specular"], pbr["metallic"], pbr["roughness"], pbr["thin"]) == pytest.approx((0.3, 1.0, 0.3, False))


def test_subsurface_scattering_is_taken_for_diffuse(tmp_path):
    inputs = {"base": ("float", "1"), "base_color": ("color3", "1, 0, 0"), "subsurface_color": ("color3", "0, 1, 0")}
    graph = surface(tmp_path, "standard_surface", inputs | {"subsurface": ("float", "0.25")}).graph
    assert graph.constants["base_color"] == pytest.approx((0.75, 0.25, 0.0))
    assert any("subsurface scattering is approximated" in note for note in graph.notes)
    assert surface(tmp_path, "standard_surface", inputs).graph.notes == ()


@pytest.mark.parametrize(
    "shader, name, value",
    [
        ("standard_surface", "coat", "0.1"), ("standard_surface", "sheen", "1"), ("standard_surface", "thin_film_thickness", "9"),
        ("standard_surface", "opacity", "1, 0.5, 1"), ("gltf_pbr", "clearcoat", "1"), ("gltf_pbr", "alpha_mode", "1"),
        ("open_pbr_surface", "fuzz_weight", "0.5"),
    ],
)  # fmt: skip
def test_what_the_surface_lacks_is_left_out_and_said(tmp_path, shader, name, value):
    kind = {"opacity": "color3", "alpha_mode": "integer"}.get(name, "float")
    (note,) = surface(tmp_path, shader, {name: (kind, value)}).graph.notes
    assert note.startswith("line 3: ") and f"is left out ({name})" in note


def test_absorption_and_metals_edges_are_left_out_and_said(tmp_path):
    green, half, metal = ("color3", "0,1,0"), ("float", "0.5"), ("float", "1")
    notes = [
        surface(tmp_path, shader, inputs).graph.notes
        for shader, inputs in (
            ("gltf_pbr", {"metallic": ("float", "0"), "transmission": half, "attenuation_color": green}),
            ("gltf_pbr", {"attenuation_color": green, "specular_color": green}),
            ("standard_surface", {"metalness": metal, "specular_color": green}),
            ("standard_surface", {"specular_color": green}),
            ("open_pbr_surface", {"base_metalness": metal, "specular_color": green}),
        )
    ]
    assert [len(each) for each in notes] == [1, 0, 1, 0, 1]
    assert "absorption inside the body is left out (attenuation_color)" in notes[0][0]
    assert "colour of a metal's edges is left out (specular_color)" in notes[2][0]


def test_what_is_left_out_may_read_what_is_not_supported(tmp_path):
    nodes = node("viewdirection", "v", "vector3") + node("dotproduct", "d", "float", in1=("vector3", "@v"))
    nodes += node("noise2d", "n", "float")
    inputs = {"sheen": ("float", "@d"), "coat": ("float", "@d"), "specular_roughness": ("float", "@n")}
    graph = surface(tmp_path, "standard_surface", inputs, nodes)
    assert set(graph.outputs) == {"roughness"} and {n.kind for n in graph.graph.nodes} <= {
        "UVInput",
        "Mul",
        "Add",
        "Noise2D",
    }
    assert [note.partition("its ")[2] for note in graph.graph.notes] == [
        "sheen is left out (sheen)", "coat is left out (coat)",
    ]  # fmt: skip
    with pytest.raises(SceneError, match="viewdirection v: nodes of the kind viewdirection are not supported"):
        surface(tmp_path, "standard_surface", {"specular_roughness": ("float", "@d")}, nodes)


def test_outputs_of_a_surface(tmp_path):
    noise = node("noise2d", "n", "float") + node("noise2d", "c", "color3")
    inputs = {
        "base": ("float", "@n"), "base_color": ("color3", "1,1,1"), "metalness": ("float", "@n"), "specular": ("float", "@n"),
        "specular_color": ("color3", "@c"), "specular_roughness": ("float", "@n"), "emission": ("float", "2"),
        "emission_color": ("color3", "@c"),
    }  # fmt: skip
    graph = surface(tmp_path, "standard_surface", inputs, noise)
    values = graph.evaluate(POINTS)
    assert list(values) == ["base_color", "metallic", "roughness", "specular", "specular_color", "emission"]
    assert np.array_equal(values["emission"], 2 * values["specular_color"])
    assert np.array_equal(values["base_color"], np.repeat(values["metallic"], 3, axis=1))


@pytest.mark.parametrize("name", ["transmission", "specular_IOR"])
def test_parameters_that_are_constants_must_not_vary(tmp_path, name):
    with pytest.raises(
        SceneError, match=rf"test.mtlx:3: input {name}: {name} varies over the surface; expected a constant"
    ):
        surface(tmp_path, "standard_surface", {name: ("float", "@n")}, node("noise2d", "n", "float"))


def test_parameters_out_of_range_are_clamped_and_said(tmp_path):
    graph = surface(
        tmp_path, "standard_surface", {"base_color": ("color3", "1, 1.5, -1"), "specular_IOR": ("float", "0.5")}
    ).graph
    assert graph.constants["base_color"] == (1.0, 1.0, 0.0) and graph.constants["ior"] == 1.0 and len(graph.notes) == 3


def test_normal_maps(tmp_path):
    """The numbers of the picture after * 2 - 1, x and y scaled: up is the same direction in both conventions."""
    pixels = picture(tmp_path)
    nodes = node("image", "i", "vector3", file=FILE)
    nodes += node("normalmap", "n", "vector3", in_=("vector3", "@i"), scale=("float", "0.5"))
    graph = surface(tmp_path, "standard_surface", {"normal": ("vector3", "@n")}, nodes)
    expected = (2.0 * pixels[..., :3] - 1.0).reshape(-1, 3) * [0.5, 0.5, 1.0]
    assert np.allclose(graph.evaluate(texels())["normal"], expected, atol=1e-5)


def test_the_meshs_own_normal_is_no_output(tmp_path):
    nodes = node("normal", "n", "vector3", space=("string", "object"))
    assert surface(tmp_path, "standard_surface", {"normal": ("vector3", "@n")}, nodes).outputs == {}
    assert surface(tmp_path, "standard_surface", {}).outputs == {}


@pytest.mark.parametrize("name", ["normal", "tangent", "bitangent"])
def test_normal_maps_about_another_frame_are_refused(tmp_path, name):
    nodes = node(name, "own", "vector3", space=("string", "world")) if name == "normal" else ""
    nodes += node("noise3d", "other", "vector3")
    own = "@own" if name == "normal" else "@other"
    for kind in ("normalmap", "bump"):
        other = node(kind, "n", "vector3", **{name: ("vector3", "@other")})
        with pytest.raises(SceneError, match=f"test.mtlx:3: .*its {name} is connected to another than the surface's"):
            surface(tmp_path, "standard_surface", {"normal": ("vector3", "@n")}, nodes + other)
    if name == "normal":
        given = node("normalmap", "n", "vector3", in_=("vector3", "1,0.5,0.5"), normal=("vector3", own))
        graph = surface(tmp_path, "standard_surface", {"normal": ("vector3", "@n")}, nodes + given)
        assert np.allclose(graph.evaluate(POINTS)["normal"], [1.0, 0.0, 0.0])


def test_normals_of_other_kinds_are_refused(tmp_path):
    with pytest.raises(SceneError, match="test.mtlx:3: .*expected a normalmap"):
        surface(tmp_path, "standard_surface", {"normal": ("vector3", "@n")}, node("noise2d", "n", "vector3"))
    picture(tmp_path)
    nodes = node("image", "i", "vector3", file=FILE) + node("normalmap", "n", "vector3", in_=("vector3", "@i"))
    nodes += node("convert", "c", "color3", in_=("vector3", "@n"))
    with pytest.raises(SceneError, match="test.mtlx:3: convert c: computes with a normal map"):
        surface(tmp_path, "standard_surface", {"base_color": ("color3", "@c")}, nodes)


def test_materials_by_name():
    with pytest.raises(
        SceneError, match="signs.mtlx: has 2 materials; expected the name of one of them: Sign, Brushed"
    ):
        load(DATA / "signs.mtlx")
    with pytest.raises(SceneError, match="signs.mtlx: has no material Back; expected one of Sign, Brushed"):
        load(DATA / "signs.mtlx", "Back")


def test_a_shader_inside_a_graph(tmp_path):
    body = (
        '<nodegraph name="g"><input name="c" type="color3" value="0.1, 0.2, 0.3" />'
        '<standard_surface name="s" type="surfaceshader"><input name="base_color" type="color3" interfacename="c" />'
        '</standard_surface><output name="out" type="surfaceshader" nodename="s" /></nodegraph>'
        '<surfacematerial name="M" type="material">'
        '<input name="surfaceshader" type="surfaceshader" nodegraph="g" output="out" />'
        "</surfacematerial>"
    )
    assert load(write(tmp_path, body)).graph.constants["base_color"] == pytest.approx((0.1, 0.2, 0.3))


def test_a_kind_of_shader_of_the_documents_own(tmp_path):
    body = (
        '<nodedef name="ND_paint" node="paint"><input name="colour" type="color3" value="0.1, 0.2, 0.3" />'
        '<output name="out" type="surfaceshader" /></nodedef><nodegraph name="NG_paint" nodedef="ND_paint">'
        '<standard_surface name="s" type="surfaceshader"><input name="base_color" type="color3" interfacename="colour" />'
        '</standard_surface><output name="out" type="surfaceshader" nodename="s" /></nodegraph>'
        '<paint name="p" type="surfaceshader"><input name="colour" type="color3" value="0.4, 0.5, 0.6" /></paint>'
        '<surfacematerial name="M" type="material"><input name="surfaceshader" type="surfaceshader" nodename="p" />'
        "</surfacematerial>"
    )
    assert load(write(tmp_path, body)).graph.constants["base_color"] == pytest.approx((0.4, 0.5, 0.6))


def test_script_gives_the_stored_pictures(tmp_path):
    script = DATA.parents[1] / "tools" / "make_graph_pictures.py"
    subprocess.run([sys.executable, script, "--out", tmp_path], check=True)
    made = sorted(file.name for file in tmp_path.iterdir())
    assert made == sorted(file.name for file in (DATA / "pictures").iterdir())
    for name in made:  # encoders differ, pictures do not
        new, stored = (np.asarray(Image.open(folder / name), dtype=float) for folder in (tmp_path, DATA / "pictures"))
        assert np.abs(new - stored).mean() < 0.25, name


def test_bumps_lean_against_the_slope(tmp_path):
    """A height that grows upwards in MaterialX's coordinates bends the normal down in tangent space, whose y is up. 1 / 16 of
    the slope is MaterialX's scale."""
    nodes = UV + node("extract", "v", "float", in_=("vector2", "@uv"), index=("integer", "1"))
    nodes += node("multiply", "h", "float", in1=("float", "@v"), in2=("float", "16"))
    nodes += node("bump", "n", "vector3", height=("float", "@h"))
    graph = surface(tmp_path, "standard_surface", {"normal": ("vector3", "@n")}, nodes)
    step = np.full((len(POINTS), 2), 0.0, np.float32)
    normal = graph.evaluate(POINTS, step + [1e-3, 0], step + [0, 1e-3])["normal"]
    assert np.allclose(normal, np.array([0.0, -1.0, 1.0]) / np.sqrt(2.0), atol=1e-4)
