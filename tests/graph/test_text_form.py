"""The thesis's text form: what it means, and one clear line for whatever is wrong in it."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache.errors import SceneError
from clcache.graph.library import library, parse
from clcache.graph.model import GraphTexture, Link, Node
from clcache.graph.mtlx_file import read_document
from clcache.graph.text import parse as read_text
from clcache.graph.text import read_text_form

NODES = parse(
    """
NODE void NormalInput(const GraphInputs *in, float3 *Out) {}

NODE void UVInput(const GraphInputs *in, float2_D *Out) {}

NODE void Add(float3 A, float3 B, float3 *Out) {}

NODE void Mul(float3 A, float3 B, float3 *Out) {}

NODE void Fractal(int Octaves, int Seed, float2 UV, float *Out) {}

NODE void Image(const Maps *maps, int Texture, float2_D UV, float4 *Out) {}
""",
    "test.cl",
)

LISTING = """
Mul A<0 B<1 Out>2;
ColorOutput In<3;
Add A<1 B<2 Out>3;
Float1Constant 0.5 Out>1;
NormalInput Out>0;
"""


def test_listing_5_1() -> None:
    graph = read_text(LISTING, "normals.graph", NODES)
    assert graph.nodes == (
        Node("Mul", {"A": Link(2, "Out"), "B": (0.5,)}, {}, "normals.graph:2: Mul"),
        Node("Add", {"A": (0.5,), "B": Link(0, "Out")}, {}, "normals.graph:4: Add"),
        Node("NormalInput", {}, {}, "normals.graph:6: NormalInput"),
    )
    assert graph.outputs == {"base_color": Link(1, "Out")}


def test_lines_and_blanks_do_not_matter() -> None:
    loose = '# all;of it<>"\n\tAdd A < 0\n B<0 # twice\n Out> 1;;NormalInput Out>0; RoughnessOutput In<1 ;'
    graph = read_text(loose, "loose.graph", NODES)
    assert [node.place for node in graph.nodes] == ["loose.graph:2: Add", "loose.graph:4: NormalInput"]
    assert graph.outputs == {"roughness": Link(0, "Out")}


def test_integers_textures_and_constants() -> None:
    graph = read_text(
        """UVInput Out>0;
        Float2Constant -1e-3 +.5 Out>1;
        Fractal 3 -7 UV<1 Out>2;
        Image "a b#;/c.png" srgb UV<0 Out>3;
        Image "d.png" linear mirror UV<0 Out>4;
        Image "a b#;/c.png" srgb repeat UV<0 Out>5;
        ColorOutput In<3; EmissionOutput In<4; SpecularColorOutput In<5; MetallicOutput In<2;""",
        "x",
        NODES,
    )
    assert [node.integers for node in graph.nodes[1:]] == [
        {"Octaves": 3, "Seed": -7}, {"Texture": 0}, {"Texture": 1}, {"Texture": 0},
    ]  # fmt: skip
    assert graph.nodes[1].inputs == {"UV": (-0.001, 0.5)}
    assert graph.textures == (
        GraphTexture("a b#;/c.png", True, ("repeat", "repeat"), "x:4: Image"),
        GraphTexture("d.png", False, ("mirror", "mirror"), "x:5: Image"),
    )


def test_every_output_has_a_node() -> None:
    kinds = ["Color", "Metallic", "Roughness", "Specular", "SpecularColor", "Emission", "Normal"]
    text = "Float1Constant 1 Out>0;" + "".join(f"{kind}Output In<0;" for kind in kinds)
    expected = ["base_color", "metallic", "roughness", "specular", "specular_color", "emission", "normal"]
    assert list(read_text(text, "x", NODES).outputs) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("NormalInput Out>0;\nAdd A<0 B<0 Out>1", "2: Add: the node does not end; expected ; behind it"),
        ("Add A<0 B<0 Out>1\nColorOutput In<1;", "1: Add: found 'ColorOutput In <'; expected Socket<number, Socket>number or ;"),
        ("Add A< B<0 Out>1;", "1: Add: found 'A < B'; expected Socket<number, Socket>number or ;"),
        ("Add A<-1 B<0;", "1: Add: found 'A < -1'; expected Socket<number, Socket>number or ;"),
        ("Add A<0 B<99999999999 Out>1;", "1: Add: found 'B < 99999999999'; expected Socket<number, Socket>number or ;"),
        ("12 A<0;", "1: 12: not the name of a kind of node; expected letters and digits, such as Add"),
        ("\n< A<0;", "2: <: not the name of a kind of node; expected letters and digits, such as Add"),
        ("Ad A<0 B<0 Out>1;", "1: Ad: unknown kind of node; did you mean Add?"),
        ("Add A<0 C<0 Out>1;", "1: Add: it has no input socket C; expected A and B"),
        ("Add A<0 B<0 Sum>1;", "1: Add: it has no output socket Sum; expected Out"),
        ("NormalInput In<1 Out>0;", "1: NormalInput: it has no input socket In; expected none"),
        ("Add A<0 A<1 Out>2;", "1: Add: socket A is given twice; expected once"),
        ("Add A<0 Out>2;", "1: Add: input socket B is missing; expected B<number"),
        ("ColorOutput In>2;", "1: ColorOutput: it has no output socket In; expected none"),
        ("Add A<0 B<7 Out>1; NormalInput Out>0;", "1: Add: socket B: no node writes link 7; expected Socket>7 of some node"),
        (
            "NormalInput Out>0;\n\nUVInput Out>0;",
            "3: UVInput: socket Out: link 0 is written in line 1 already; expected once",
        ),
        ("ColorOutput In<0;\nColorOutput In<0;", "2: ColorOutput: it is in line 1 already; expected once"),
        ("Float3Constant 1 2 Out>0;", "1: Float3Constant: 2 values; expected 3 numbers"),
        ("Float1Constant Out>0;", "1: Float1Constant: 0 values; expected 1 number"),
        ("Float1Constant nan Out>0;", "1: Float1Constant: nan; expected a number between -3.4e38 and 3.4e38"),
        ("Float1Constant -inf Out>0;", "1: Float1Constant: -inf; expected a number between -3.4e38 and 3.4e38"),
        ("Float1Constant 1e39 Out>0;", "1: Float1Constant: 1e39; expected a number between -3.4e38 and 3.4e38"),
        ("Float1Constant 0x10 Out>0;", "1: Float1Constant: 0x10; expected a number between -3.4e38 and 3.4e38"),
        ("Float1Constant 1_0 Out>0;", "1: Float1Constant: 1_0; expected a number between -3.4e38 and 3.4e38"),
        ("Fractal UV<0 Out>1;", "1: Fractal: found nothing for Octaves; expected an integer"),
        ("Fractal 3 0.5 UV<0 Out>1;", "1: Fractal: found 0.5 for Seed; expected an integer"),
        ("Fractal 3 4 5 UV<0 Out>1;", "1: Fractal: 5 is one value too many; expected its sockets"),
        ("Add 1 A<0 B<0 Out>1;", "1: Add: 1 is one value too many; expected its sockets"),
        ("Image UV<0 Out>1;", '1: Image: found nothing; expected the file of a picture, as "wood.jpg"'),
        ("Image a.png srgb UV<0 Out>1;", '1: Image: found a.png; expected the file of a picture, as "wood.jpg"'),
        ('Image "" srgb UV<0 Out>1;', '1: Image: found ""; expected the file of a picture, as "wood.jpg"'),
        ('Image "a.png" UV<0 Out>1;', "1: Image: found nothing behind the file; expected srgb or linear"),
        ('Image "a.png" sRGB UV<0 Out>1;', "1: Image: found sRGB behind the file; expected srgb or linear"),
        ('Image "a.png" srgb tile UV<0 Out>1;', "1: Image: tile is one value too many; expected its sockets"),
        ('\nImage "a.png', '2: a quoted name does not end on its line; expected "'),
    ],
)  # fmt: skip
def test_errors_name_line_and_what_is_expected(text: str, message: str) -> None:
    with pytest.raises(SceneError) as error:
        read_text(text, "some.graph", NODES)
    assert str(error.value) == f"some.graph:{message}"


@given(
    st.lists(
        st.sampled_from([*'<>;#"\n\r\x00\u2028é', " ", "Add", "A", "B", "Out", "0", "1", "In", "1e5", "ColorOutput"])
    )
)
def test_any_text_is_a_graph_or_one_line(tokens: list[str]) -> None:
    text = "".join(tokens)
    try:
        graph = read_text(text, "some.graph", NODES)
    except SceneError as error:
        message = str(error)
        assert message.startswith("some.graph:") and message.isprintable() and len(message) < 300
    else:
        assert len(graph.nodes) + len(graph.outputs) <= text.count(";")


@pytest.mark.parametrize("read", [read_text_form, read_document])
def test_large_files_are_refused_unread(read, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate((4 << 20) + 1)
    monkeypatch.setattr(Path, "read_bytes", lambda self: pytest.fail("it is read"))
    with pytest.raises(SceneError, match=r"^large: 4,194,305 bytes; expected at most 4,194,304$"):
        read(path, "large", *([library()] if read is read_text_form else []))


def test_files_in_other_encodings_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "latin.graph"
    path.write_bytes("# größer\n".encode("latin-1"))
    with pytest.raises(SceneError, match="^latin: byte 4 is not UTF-8 text$"):
        read_text_form(path, "latin", library())
