"""The thesis's text form of a graph (Listing 5.1): nodes in any order, sockets joined by equal numbers.

    # normals as colours
    Mul A<0 B<1 Out>2;
    ColorOutput In<3;
    Add A<1 B<2 Out>3;
    Float1Constant 0.5 Out>1;
    NormalInput Out>0;

`Socket<n` reads link n, `Socket>n` writes it. Before its sockets stand a node's integers (`Fractal3D 3 Position<0 Out>1;`),
a constant's one to four numbers, or a picture, how its colours are stored, and how it goes on beyond its edges
(`Image "wood.jpg" srgb mirror UV<1 Out>2;`). `ColorOutput` and its kin of OUTPUT_NODES name the graph's outputs.
"""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import SceneError
from ..scene.files import read_text
from ..scene.model import WRAP_MODES
from .library import Library
from .model import MAX_BYTES, Constant, Graph, GraphTexture, Link, Node, fits_float, printable

MAX_FILE_NAME = 255
OUTPUT_NODES = {
    "ColorOutput": "base_color",
    "MetallicOutput": "metallic",
    "RoughnessOutput": "roughness",
    "SpecularOutput": "specular",
    "SpecularColorOutput": "specular_color",
    "EmissionOutput": "emission",
    "NormalOutput": "normal",
}
CONSTANT_NODES = {f"Float{width}Constant": width for width in (1, 2, 3, 4)}

_TOKEN = re.compile(r'(?P<skip>\s+|#[^\n]*)|(?P<string>"[^"\n]*")|(?P<mark>[<>;])|(?P<word>[^\s<>;"#]+)')
_NAME = re.compile(r"[A-Za-z_]\w{0,59}\Z", re.ASCII)
_LINK = re.compile(r"\d{1,9}\Z", re.ASCII)
_INTEGER = re.compile(r"[-+]?\d{1,9}\Z", re.ASCII)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,9})?\Z", re.ASCII)


@dataclass(frozen=True)
class _Statement:
    """A node as written. values: what stands before the sockets. reads, writes: link number by socket."""

    kind: str
    values: tuple[str, ...]
    reads: Mapping[str, int]
    writes: Mapping[str, int]
    line: int


def read_text_form(path: Path, name: str, nodes: Library) -> Graph:
    """The graph of a .graph file. name: the file as messages call it. nodes: the kinds that it may use. Raises SceneError."""
    return parse(read_text(path, name, MAX_BYTES), name, nodes)


def parse(text: str, name: str, nodes: Library) -> Graph:
    """The graph that a text describes. Raises SceneError, one line that names the file and the line of it."""
    return _Reader(name, nodes).graph(_statements(text, name))


def nearest(word: str, known: Iterable[str]) -> str:
    """What a message says is expected in place of an unknown word."""
    known = sorted(known)
    near = difflib.get_close_matches(word[:60], known, 1, cutoff=0.5)
    return f"did you mean {near[0]}?" if near else f"expected one of {', '.join(known)}"


def _statements(text: str, name: str) -> Iterator[_Statement]:
    tokens: list[tuple[str, int]] = []
    for token, line in _tokens(text, name):
        if token != ";":
            tokens.append((token, line))
        elif tokens:
            yield _statement(tokens, name)
            tokens = []
    if tokens:
        raise SceneError(
            f"{name}:{tokens[0][1]}: {printable(tokens[0][0])}: the node does not end; expected ; behind it"
        )


def _tokens(text: str, name: str) -> Iterator[tuple[str, int]]:
    line = start = 1
    place = 0
    while place < len(text):
        token = _TOKEN.match(text, place)
        if token is None:
            raise SceneError(f'{name}:{line}: a quoted name does not end on its line; expected "')
        start, line, place = line, line + token[0].count("\n"), token.end()
        if token["skip"] is None:
            yield token[0], start


def _statement(tokens: list[tuple[str, int]], name: str) -> _Statement:
    kind, line = tokens[0]
    where = f"{name}:{line}: {printable(kind)}"
    if not _NAME.match(kind):
        raise SceneError(f"{where}: not the name of a kind of node; expected letters and digits, such as Add")
    words = [token for token, _ in tokens]
    first_mark = next((i for i, word in enumerate(words) if word in "<>"), len(words) + 1)
    sockets = words[first_mark - 1 :]
    reads: dict[str, int] = {}
    writes: dict[str, int] = {}
    for i in range(0, len(sockets), 3):
        socket, mark, link = (*sockets[i : i + 3], "", "")[:3]
        if not _NAME.match(socket) or mark not in ("<", ">") or not _LINK.match(link):
            found = " ".join(sockets[i : i + 3])
            raise SceneError(f"{where}: found {printable(found)!r}; expected Socket<number, Socket>number or ;")
        if socket in reads or socket in writes:
            raise SceneError(f"{where}: socket {socket} is given twice; expected once")
        (reads if mark == "<" else writes)[socket] = int(link)
    return _Statement(kind, tuple(words[1 : first_mark - 1]), reads, writes, line)


class _Reader:
    """Statements to a graph: first what writes each link, then who reads it."""

    def __init__(self, name: str, nodes: Library):
        self._name = name
        self._nodes = nodes
        self._written: dict[int, tuple[Link | Constant, int]] = {}  # by link: what writes it, and the line
        self._textures: dict[tuple[str, bool, str], tuple[int, GraphTexture]] = {}

    def graph(self, statements: Iterable[_Statement]) -> Graph:
        nodes: list[tuple[_Statement, dict[str, int]]] = []
        outputs: dict[str, _Statement] = {}
        for statement in statements:
            where = self._where(statement)
            if statement.kind in CONSTANT_NODES:
                self._check_sockets(statement, (), ("Out",))
                value = _constant(statement.values, CONSTANT_NODES[statement.kind], where)
                self._write(statement, lambda socket, value=value: value)
            elif statement.kind in OUTPUT_NODES:
                self._check_sockets(statement, ("In",), ())
                _expect_no_more(statement.values, where)
                output = OUTPUT_NODES[statement.kind]
                if output in outputs:
                    raise SceneError(f"{where}: it is in line {outputs[output].line} already; expected once")
                outputs[output] = statement
            else:
                integers = self._integers(statement, where)
                node = len(nodes)
                nodes.append((statement, integers))
                self._write(statement, lambda socket, node=node: Link(node, socket))
        return Graph(
            name=self._name,
            nodes=tuple(Node(s.kind, self._inputs(s), integers, self._where(s)) for s, integers in nodes),
            outputs={output: self._inputs(s)["In"] for output, s in outputs.items()},
            textures=tuple(texture for _, texture in self._textures.values()),
        )

    def _where(self, statement: _Statement) -> str:
        return f"{self._name}:{statement.line}: {statement.kind}"

    def _check_sockets(self, statement: _Statement, inputs: Iterable[str], outputs: Iterable[str]) -> None:
        where = self._where(statement)
        for given, known, kind in ((statement.reads, inputs, "input"), (statement.writes, outputs, "output")):
            for socket in given:
                if socket not in known:
                    what = f"expected {' and '.join(known)}" if known else "expected none"
                    raise SceneError(f"{where}: it has no {kind} socket {socket}; {what}")
        missing = [socket for socket in inputs if socket not in statement.reads]
        if missing:
            raise SceneError(f"{where}: input socket {missing[0]} is missing; expected {missing[0]}<number")

    def _write(self, statement: _Statement, value) -> None:
        for socket, link in statement.writes.items():
            if link in self._written:
                where = f"{self._where(statement)}: socket {socket}"
                raise SceneError(
                    f"{where}: link {link} is written in line {self._written[link][1]} already; expected once"
                )
            self._written[link] = (value(socket), statement.line)

    def _inputs(self, statement: _Statement) -> dict[str, Link | Constant]:
        for socket, link in statement.reads.items():
            if link not in self._written:
                where = f"{self._where(statement)}: socket {socket}"
                raise SceneError(f"{where}: no node writes link {link}; expected Socket>{link} of some node")
        return {socket: self._written[link][0] for socket, link in statement.reads.items()}

    def _integers(self, statement: _Statement, where: str) -> dict[str, int]:
        if statement.kind not in self._nodes:
            known = (*self._nodes, *CONSTANT_NODES, *OUTPUT_NODES)
            raise SceneError(f"{where}: unknown kind of node; {nearest(statement.kind, known)}")
        implementation = self._nodes[statement.kind][0]
        self._check_sockets(statement, implementation.inputs, implementation.outputs)
        values = list(statement.values)
        integers = {}
        for integer in implementation.integers:
            if integer == "Texture":
                integers[integer] = self._texture(values, where)
                continue
            if not values or not _INTEGER.match(values[0]):
                found = printable(values[0]) if values else "nothing"
                raise SceneError(f"{where}: found {found} for {integer}; expected an integer")
            integers[integer] = int(values.pop(0))
        _expect_no_more(values, where)
        return integers

    def _texture(self, values: list[str], where: str) -> int:
        """Index of the texture that the next values name; they are taken off."""
        file = values.pop(0) if values else ""
        if not file.startswith('"') or len(file) < 3:
            raise SceneError(
                f'{where}: found {printable(file) or "nothing"}; expected the file of a picture, as "wood.jpg"'
            )
        if len(file) > MAX_FILE_NAME + 2:
            raise SceneError(
                f"{where}: a file's name of {len(file) - 2:,} characters; expected at most {MAX_FILE_NAME}"
            )
        encoding = values.pop(0) if values else "nothing"
        if encoding not in ("srgb", "linear"):
            raise SceneError(f"{where}: found {printable(encoding)} behind the file; expected srgb or linear")
        wrap = values.pop(0) if values and values[0] in WRAP_MODES else "repeat"
        key = (file[1:-1], encoding == "srgb", wrap)
        texture = GraphTexture(key[0], key[1], (wrap, wrap), where)
        return self._textures.setdefault(key, (len(self._textures), texture))[0]


def _constant(values: tuple[str, ...], width: int, where: str) -> Constant:
    if len(values) != width:
        numbers = "1 number" if width == 1 else f"{width} numbers"
        raise SceneError(f"{where}: {len(values)} values; expected {numbers}")
    for value in values:
        if not _NUMBER.match(value) or not fits_float(float(value)):
            raise SceneError(f"{where}: {printable(value, 30)}; expected a number between -3.4e38 and 3.4e38")
    return tuple(map(float, values))


def _expect_no_more(values: Iterable[str], where: str) -> None:
    for value in values:
        raise SceneError(f"{where}: {printable(value)} is one value too many; expected its sockets")
