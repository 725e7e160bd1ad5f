"""Graphs made to break the compiler end in one clear line, and nothing that a document says reaches the source."""

import re
import string
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import clcache.graph
from clcache.errors import SceneError
from clcache.graph.model import Graph, GraphTexture, Link, Node
from clcache.scene.files import Folder

NASTY = [
    '"); system("x"); /*', "*/ } int evil() { /*", "line\nbreak", "end\\", "??/", "%s%n", "\x00\x1b[31m\x7f", "‮gnp", "é" * 3000, "/**/#include <x>",
]  # fmt: skip


def error_of(text: str, folder: Path) -> str:
    path = folder / "hostile.graph"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError) as error:
        clcache.graph.load(path)
    message = str(error.value)
    assert message.isprintable() and len(message) < 600
    assert message.startswith(f"{path}:")
    return message.removeprefix(f"{path}:")


def test_cycles_are_named(tmp_path: Path) -> None:
    text = "PositionInput Out>0;\nAdd A<0 B<3 Out>1;\nAdd A<0 B<1 Out>2;\nMul A<2 B<2 Out>3;\nColorOutput In<3;"
    message = error_of(text, tmp_path)
    assert message.startswith("4: Mul: it reads its own output (by way of ")
    assert all(f"hostile.graph:{line}: " in message for line in (2, 3, 4))


def test_a_node_that_reads_itself_is_named_even_where_nothing_reads_it(tmp_path: Path) -> None:
    message = error_of("PositionInput Out>0;\nColorOutput In<0;\nAbs In<1 Out>1;", tmp_path)
    assert message.startswith("3: Abs: it reads its own output")


def test_long_cycles_are_cut(tmp_path: Path) -> None:
    count = 3000
    nodes = "".join(f"Abs In<{i} Out>{(i + 1) % count};\n" for i in range(count))
    assert "and 2997 more); expected no cycle" in error_of(f"{nodes}RoughnessOutput In<0;", tmp_path)


def chain(count: int) -> str:
    return (
        "PositionInput Out>0;\n"
        + "".join(f"Abs In<{i} Out>{i + 1};\n" for i in range(count))
        + f"ColorOutput In<{count};"
    )


def test_more_nodes_than_are_allowed(tmp_path: Path) -> None:
    assert error_of(chain(10_000), tmp_path) == " its outputs need 10,001 nodes; expected at most 4,096"


def test_as_many_nodes_as_are_allowed(tmp_path: Path) -> None:
    path = tmp_path / "long.graph"
    path.write_text(chain(4095))
    assert clcache.graph.load(path).cost == 4096


def test_more_numbers_than_are_allowed(tmp_path: Path) -> None:
    """Nodes of four components, with derivatives as a picture reads them."""
    (tmp_path / "a.png").write_bytes(b"")
    nodes = "".join(f"Abs In<{i} Out>{i + 1};\n" for i in range(9, 1409))
    text = f"UVInput Out>0; Append A<0 B<0 Out>9;\n{nodes}Separate4 In<1409 X>1 Y>2; Combine2 X<1 Y<2 Out>3;"
    message = error_of(f'{text} Image "a.png" srgb UV<3 Out>4; ColorOutput In<4;', tmp_path)
    assert message.startswith(" its nodes compute 16,8") and "; expected at most 16,384" in message


def test_unneeded_nodes_do_not_count(tmp_path: Path) -> None:
    path = tmp_path / "long.graph"
    path.write_text(chain(10_000).replace("ColorOutput In<10000", "ColorOutput In<5"))
    assert clcache.graph.load(path).cost == 6


@pytest.mark.parametrize(
    "number", ["1e39", "-1e39", "1" + "0" * 400, "1e999999999", "nan", "inf", "-Infinity", "1e9999999999"]
)
def test_numbers_that_no_float_holds(number: str, tmp_path: Path) -> None:
    message = error_of(
        f"PositionInput Out>0; Float1Constant {number} Out>1; Mul A<0 B<1 Out>2; ColorOutput In<2;", tmp_path
    )
    assert message.startswith("1: Float1Constant: ") and message.endswith(
        "; expected a number between -3.4e38 and 3.4e38"
    )


@pytest.mark.parametrize("number", ["3.4028235e38", "-3.4028235e38", "1e-60", "-0", "1.4e-45"])
def test_extreme_numbers_that_floats_hold(number: str, tmp_path: Path) -> None:
    path = tmp_path / "extreme.graph"
    path.write_text(f"PositionInput Out>0; Float1Constant {number} Out>1; Mul A<0 B<1 Out>2; ColorOutput In<2;")
    assert not re.search(r"\b(inf|nan)", clcache.graph.load(path).source)


@pytest.mark.parametrize("name", NASTY)
def test_nasty_names_of_kinds_sockets_and_files(name: str, tmp_path: Path) -> None:
    error_of(f"{name} Out>0; ColorOutput In<0;", tmp_path)
    error_of(f"PositionInput {name}>0; ColorOutput In<0;", tmp_path)
    quoted = name.replace('"', "'")
    error_of(f'UVInput Out>0;\nImage "{quoted}" srgb UV<0 Out>1;\nColorOutput In<1;', tmp_path)


def test_pictures_outside_the_folder_are_refused(tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(b"")
    (tmp_path / "inner").mkdir()
    text = 'UVInput Out>0;\nImage "../secret.png" srgb UV<0 Out>1;\nColorOutput In<1;'
    assert error_of(text, tmp_path / "inner").startswith("2: Image: '../secret.png' leaves the scene's folder")


@pytest.mark.parametrize("file", ["//[a.png", "//℀/a.png", "a" * 5000 + ".png", "a/" * 120 + "b.png"])
def test_names_of_pictures_that_are_no_paths(file: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError) as error:
        Folder(tmp_path).find(file, tmp_path / "x.graph", "x.graph:1")
    message = str(error.value)
    assert message.startswith(f"x.graph:1: '{file[:200]}") and message.isprintable() and len(message) < 600


def test_pictures_too_large_for_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.png").write_bytes(b"")
    path = tmp_path / "x.graph"
    path.write_text('UVInput Out>0; Image "a.png" srgb UV<0 Out>1; ColorOutput In<1;')
    graph = clcache.graph.load(path)

    def allocate(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(clcache.graph.compiled, "read_picture", allocate)
    with pytest.raises(SceneError, match=f"^{path}:1: Image: the picture does not fit into memory; expected a smaller"):
        graph.evaluate([[0.5, 0.5]])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.graph", "no such file"),
        (".", "not a regular file"),
        ("x.txt", "expected .graph or .mtlx"),
        ("x" * 300, r"cannot be read \(File name too long\)"),
    ],
)
def test_files_that_are_no_graphs(name: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_text("")
    with pytest.raises(SceneError, match=f"{message}$"):
        clcache.graph.load(tmp_path / name)


def test_a_graph_without_outputs_is_one_that_computes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "empty.graph"
    path.write_text("# nothing")
    graph = clcache.graph.load(path)
    assert (graph.outputs, graph.reads, graph.cost, graph.channels) == ({}, frozenset(), 0, 0)


ADD = {"A": (1.0,), "B": (2.0,)}


@pytest.mark.parametrize(
    ("node", "message"),
    [
        (Node("Nope", {}, {}, "p"), "p: unknown kind of node 'Nope'"),
        (Node("a\nb", {}, {}, "p"), "p: unknown kind of node 'a?b'"),
        (Node("Add", {"A": (1.0,)}, {}, "p"), "p: input socket B is missing; expected A, B"),
        (Node("Add", {**ADD, "x\n": (1.0,)}, {}, "p"), "p: unknown input socket 'x?'; expected A, B"),
        (Node("Add", ADD, {"Octaves": 1}, "p"), "p: unknown integer 'Octaves'; expected none"),
        (Node("Add", {"A": (1.0,), "B": ()}, {}, "p"), "p: socket B: expected 1 to 4 numbers between -3.4e38 and 3.4e38"),
        (Node("Add", {"A": (1.0,), "B": (1e39,)}, {}, "p"), "p: socket B: expected 1 to 4 numbers between -3.4e38 and 3.4e38"),
        (Node("Add", {"A": (1.0,), "B": Link(5, "Out")}, {}, "p"), "p: socket B: it reads node 5 of 1"),
        (Node("Add", {"A": (1.0,), "B": Link(0, "\n")}, {}, "p"), "p: socket B: it reads '?', no output socket of p; expected Out"),
        (Node("Image", {"UV": (1.0, 1.0)}, {"Texture": 1}, "p"), "p: it reads texture 1 of 0"),
        (Node("CellNoise2D", {"UV": (1.0, 1.0)}, {}, "p"), None),
        (Node("Worley2D", {"UV": (1.0, 1.0), "Jitter": (1.0,)}, {"Style": 2**31}, "p"), "p: Style does not fit into 32 bits; expected less than 2^31 in size"),
    ],
)  # fmt: skip
def test_graphs_that_other_readers_get_wrong(node: Node, message: str | None) -> None:
    graph = Graph("g", (node,), {"roughness": Link(0, "Out")})
    if message is None:
        assert clcache.graph.compile_graph(graph).cost == 1
        return
    with pytest.raises(SceneError) as error:
        clcache.graph.compile_graph(graph)
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("outputs", "message"),
    [
        ({"colour": (1.0,)}, "g: unknown output colour; expected one of base_color, "),
        ({"metallic": (1.0, 1.0)}, "g: output metallic: it is given a constant of 2; expected a number or 1"),
        ({"base_color": (1.0, 1.0)}, "g: output base_color: it is given a constant of 2; expected a number or 3"),
        ({"roughness": (float("nan"),)}, "g: output roughness: expected 1 to 4 numbers between -3.4e38 and 3.4e38"),
    ],
)
def test_outputs_that_other_readers_get_wrong(outputs: dict, message: str) -> None:
    with pytest.raises(SceneError) as error:
        clcache.graph.compile_graph(Graph("g", (), outputs))
    assert str(error.value).startswith(message)


@given(st.sampled_from(NASTY) | st.text(min_size=1), st.text())
def test_no_text_of_a_document_reaches_the_source(text: str, file: str) -> None:
    nodes = (
        Node("UVInput", {}, {}, text),
        Node("Image", {"UV": Link(0, "Out")}, {"Texture": 0}, text),
        Node("Mul", {"A": Link(1, "Out"), "B": (2.5,)}, {}, text),
    )
    textures = (GraphTexture(file, True, ("repeat", "repeat"), text),)
    nasty = clcache.graph.compile_graph(Graph(text, nodes, {"base_color": Link(2, "Out")}, textures, {}, (text,)))
    assert set(nasty.source) <= set(string.printable)
    plain = [Node(n.kind, n.inputs, n.integers, "p") for n in nodes]
    textures = (GraphTexture("a.png", True, ("repeat", "repeat"), "p"),)
    assert (
        nasty.source
        == clcache.graph.compile_graph(Graph("g", tuple(plain), {"base_color": Link(2, "Out")}, textures)).source
    )
