"""What a material graph is, whichever form it was written in.

A graph is a list of nodes (thesis, section 5.1): each names the implementation that it calls and gives, for every input
socket, an output of another node or a constant. It carries no types: clcache.graph.infer finds them. Graphs drive the
parameters of one surface, the keys of OUTPUTS; an output that is the same all over is no output of the graph but a
constant of the material.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

# Parameters of a surface that a graph can drive, with their channels, in the order in which evaluation packs them. The
# normal is in tangent space, as glTF's normal textures after * 2 - 1, and not necessarily of unit length.
OUTPUTS = {
    "base_color": 3,
    "metallic": 1,
    "roughness": 1,
    "specular": 1,
    "specular_color": 3,
    "emission": 3,
    "normal": 3,
}

# What a graph can read of the point of a hit, with its channels: texture coordinates with their change over the
# footprint; position and normal in the object's space.
INPUTS = {"uv": 2, "position": 3, "normal": 3}

# The nodes that give them.
INPUT_NODES = {"UVInput": "uv", "PositionInput": "position", "NormalInput": "normal"}

MAX_BYTES = 4 << 20  # of a document
LARGEST = float(np.finfo(np.float32).max)

Constant = tuple[float, ...]  # 1 to 4 finite numbers


@dataclass(frozen=True)
class Link:
    """An output socket of another node. node: its index in Graph.nodes."""

    node: int
    socket: str


@dataclass(frozen=True)
class Node:
    """A call of a node implementation.

    kind: name of the implementation. inputs: link or constant of each input socket. integers: value of each `int`
    parameter (octaves; an index into Graph.textures; …). place: where it stands, for messages: "wood.graph:12: Mul",
    with any text of the document made `printable`.
    """

    kind: str
    inputs: Mapping[str, Link | Constant]
    integers: Mapping[str, int]
    place: str


@dataclass(frozen=True)
class GraphTexture:
    """An image that nodes sample. file: as written, relative to the document. wrap: of u and of v."""

    file: str
    srgb: bool
    wrap: tuple[str, str]
    place: str


@dataclass(frozen=True)
class Graph:
    """A material's graph. outputs: by name of OUTPUTS. constants: fields of scene.model.Material that the document
    sets by constants. notes: what was approximated or left out, one sentence each, for the user."""

    name: str
    nodes: tuple[Node, ...]
    outputs: Mapping[str, Link | Constant]
    textures: tuple[GraphTexture, ...] = ()
    constants: Mapping[str, float | bool | tuple[float, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def printable(text: str, length: int = 60) -> str:
    """A document's text for a message: one line, without control characters, cut to `length` characters."""
    line = "".join(c if c.isprintable() else "?" for c in text[: length + 1])
    return line if len(line) <= length else line[: length - 1] + "…"


def fits_float(value: float) -> bool:
    """Whether a number is finite as a 32-bit float."""
    with np.errstate(over="ignore"):
        return bool(np.isfinite(np.float32(value)))
