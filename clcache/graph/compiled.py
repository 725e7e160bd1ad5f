"""From a document to a graph that can be built into kernels, or evaluated without them."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import SceneError
from ..scene.files import Folder
from ..scene.model import Texture
from ..scene.textures import read_picture
from .emit import emit
from .infer import components, infer
from .library import Overload, library
from .model import INPUT_NODES, INPUTS, OUTPUTS, Graph, printable
from .prepare import prepare
from .text import read_text_form

KINDS = (".graph", ".mtlx")
MAX_COMPONENTS = 1 << 14  # drivers take milliseconds to build a kernel for each


@dataclass(frozen=True)
class CompiledGraph:
    """A graph with the implementation of each of its nodes. graph: as of `prepare`: inputs before their readers, only
    what the outputs need, and these in the order of OUTPUTS. overloads: one for each node. files: of each of its textures."""

    graph: Graph
    overloads: tuple[Overload, ...] = field(repr=False)
    files: tuple[Path, ...] = ()

    @property
    def outputs(self) -> dict[str, int]:
        """Channels of each output, in the order in which evaluation packs them."""
        return {name: OUTPUTS[name] for name in self.graph.outputs}

    @property
    def channels(self) -> int:
        """Channels of all outputs together."""
        return sum(self.outputs.values())

    @property
    def reads(self) -> frozenset[str]:
        """Which of INPUTS it reads."""
        return frozenset(INPUT_NODES[node.kind] for node in self.graph.nodes if node.kind in INPUT_NODES)

    @property
    def cost(self) -> int:
        """How many nodes one evaluation calls."""
        return len(self.graph.nodes)

    @cached_property
    def source(self) -> str:
        """OpenCL C that evaluates it: `emit` of this graph alone."""
        return emit([self])

    @cached_property
    def textures(self) -> tuple[Texture, ...]:
        """Its pictures; read when first asked for. Raises SceneError."""
        read = []
        for texture, file in zip(self.graph.textures, self.files, strict=True):
            try:
                pixels = read_picture(file, texture.place)
            except MemoryError:
                raise SceneError(
                    f"{texture.place}: the picture does not fit into memory; expected a smaller one"
                ) from None
            read.append(Texture(texture.file, pixels, texture.srgb, texture.wrap))
        return tuple(read)

    def evaluate(
        self,
        uv: np.ndarray,
        duv_dx: np.ndarray | None = None,
        duv_dy: np.ndarray | None = None,
        position: np.ndarray | None = None,
        dposition_dx: np.ndarray | None = None,
        dposition_dy: np.ndarray | None = None,
        normal: np.ndarray | None = None,
    ) -> dict[str, np.ndarray]:
        """The outputs at n points, without OpenCL.

        uv: (n, 2) texture coordinates. position, normal: (n, 3) in object space. d…: their change along the two axes of
        the footprint. All are rounded to float32; what is left out is 0 at every point. Returns (n, channels) float32 of
        each output. Raises ValueError for arrays of other shapes; SceneError if a picture cannot be read.
        """
        from .interpret import interpret

        given = {
            "uv": (uv, duv_dx, duv_dy),
            "position": (position, dposition_dx, dposition_dy),
            "normal": (normal, None, None),
        }
        points = len(np.atleast_1d(uv))
        inputs = {name: tuple(_rows(name, v, points, INPUTS[name]) for v in arrays) for name, arrays in given.items()}
        return interpret(self.graph, self.overloads, inputs, self.textures)


def _rows(name: str, values: np.ndarray | None, points: int, channels: int) -> np.ndarray:
    rows = np.zeros((points, channels), np.float32) if values is None else np.asarray(values, np.float32)
    if rows.shape != (points, channels):
        raise ValueError(f"{name} and its changes have the shape {(points, channels)}, not {rows.shape}")
    return rows


def load(path: str | Path, material: str | None = None, *, allow_outside: bool = False) -> CompiledGraph:
    """The graph of a .graph file (thesis, Listing 5.1) or of a MaterialX document.

    material: which one, where a document has several. allow_outside: let the file name pictures outside its folder. Raises
    SceneError, with one line that names the file, the place in it, and what is wrong there.
    """
    path = Path(path)
    name = printable(str(path), 300)
    try:
        if not path.is_file():
            raise SceneError(f"{name}: " + ("not a regular file" if path.exists() else "no such file"))
    except OSError as error:  # a name that is too long, a folder that is closed
        raise SceneError(f"{name}: cannot be read ({error.strerror})") from None
    return read(path, name, Folder(path.parent.resolve(), allow_outside), material)


def read(path: Path, name: str, folder: Folder, material: str | None = None) -> CompiledGraph:
    """`load` of a file that a scene names. name: the file as messages call it. folder: which pictures it may name."""
    kind = path.suffix.lower()
    if kind == ".mtlx":
        graph = _read_mtlx(path, name, material)
    elif kind != ".graph":
        raise SceneError(f"{name}: not a kind of material graph; expected {' or '.join(KINDS)}")
    elif material is not None:
        raise SceneError(f"{name}: it holds one graph, without a name; expected no graph_material")
    else:
        graph = read_text_form(path, name, library())
    return compile_graph(graph, path, folder)


def _read_mtlx(path: Path, name: str, material: str | None) -> Graph:
    """`read_mtlx`, where its package is installed, which is not made for all processors."""
    try:
        import MaterialX  # noqa: F401
    except ImportError:
        raise SceneError(
            f"{name}: reading it needs the package MaterialX, which is not installed; expected pip install MaterialX"
        ) from None
    from .mtlx import read_mtlx

    return read_mtlx(path, name, material)


def compile_graph(graph: Graph, path: Path | None = None, folder: Folder | None = None) -> CompiledGraph:
    """A graph as it was read, made ready and typed. path: its document, beside which its pictures are found, within
    `folder`. Raises SceneError."""
    graph = prepare(graph, library())
    overloads = infer(graph, library())
    if (numbers := sum(map(components, overloads))) > MAX_COMPONENTS:
        at_most = (
            f"expected at most {MAX_COMPONENTS:,}, of each number its two derivatives, too, where pictures read them"
        )
        raise SceneError(f"{graph.name}: its nodes compute {numbers:,} numbers; {at_most}")
    files = tuple(folder.find(texture.file, path, texture.place) for texture in graph.textures) if folder else ()
    return CompiledGraph(graph, overloads, files)
