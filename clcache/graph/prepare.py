"""Graphs as they are read made ready for type inference: checked, in order, and without what no output needs.

Inputs come before the nodes that read them (depth-first from the outputs, as in the thesis's section 5.1); nodes that say
the same as an earlier one become that one; outputs that are the same all over become constants of the material.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ..errors import SceneError
from .infer import width_cost
from .library import Library
from .model import OUTPUTS, Constant, Graph, Link, Node, fits_float, printable

MAX_NODES = 4096
_FLAT_NORMAL = (0.0, 0.0, 1.0)


def prepare(graph: Graph, nodes: Library) -> Graph:
    """The same graph, as the module says. nodes: the kinds there are. Raises SceneError, one line that names the node."""
    for node in graph.nodes:
        _check_node(node, graph, nodes)
    for output, source in graph.outputs.items():
        if output not in OUTPUTS:
            raise SceneError(f"{graph.name}: unknown output {printable(output)}; expected one of {', '.join(OUTPUTS)}")
        _check_source(source, graph, nodes, f"{graph.name}: output {output}")
    graph = _with_constants(graph)
    order = _order(graph)
    if len(order) > MAX_NODES:
        raise SceneError(f"{graph.name}: its outputs need {len(order):,} nodes; expected at most {MAX_NODES:,}")
    return _without_unused_textures(_merged(graph, order))


def _check_node(node: Node, graph: Graph, nodes: Library) -> None:
    if node.kind not in nodes:
        raise SceneError(f"{node.place}: unknown kind of node {printable(node.kind)!r}")
    implementation = nodes[node.kind][0]
    for given, known, what in (
        (node.inputs, implementation.inputs, "input socket"),
        (node.integers, implementation.integers, "integer"),
    ):
        wrong = [name for name in given if name not in known]
        missing = [name for name in known if name not in given]
        if wrong or missing:
            which = f"unknown {what} {printable(wrong[0])!r}" if wrong else f"{what} {missing[0]} is missing"
            raise SceneError(f"{node.place}: {which}; expected {', '.join(known) or 'none'}")
    for socket, source in node.inputs.items():
        _check_source(source, graph, nodes, f"{node.place}: socket {socket}")
    for name, value in node.integers.items():
        if not -(2**31) <= value < 2**31:
            raise SceneError(f"{node.place}: {name} does not fit into 32 bits; expected less than 2^31 in size")
    if not 0 <= node.integers.get("Texture", 0) < max(1, len(graph.textures)):
        raise SceneError(f"{node.place}: it reads texture {node.integers['Texture']} of {len(graph.textures)}")


def _check_source(source: Link | Constant, graph: Graph, nodes: Library, place: str) -> None:
    if isinstance(source, Link):
        if not 0 <= source.node < len(graph.nodes):
            raise SceneError(f"{place}: it reads node {source.node} of {len(graph.nodes)}")
        writer = graph.nodes[source.node]
        outputs = nodes[writer.kind][0].outputs if writer.kind in nodes else ()
        if source.socket not in outputs:
            socket = printable(source.socket)
            expected = ", ".join(outputs) or "none"
            raise SceneError(f"{place}: it reads {socket!r}, no output socket of {writer.place}; expected {expected}")
        return
    if not 1 <= len(source) <= 4 or not all(map(fits_float, source)):
        raise SceneError(f"{place}: expected 1 to 4 numbers between -3.4e38 and 3.4e38")


def _with_constants(graph: Graph) -> Graph:
    """Outputs that are constants become the material's, the others are put in the order of OUTPUTS. A constant normal remains
    an output, unless it is the surface's."""
    outputs: dict[str, Link | Constant] = {}
    constants = dict(graph.constants)
    for output in sorted(graph.outputs, key=list(OUTPUTS).index):
        source = graph.outputs[output]
        if isinstance(source, Link):
            outputs[output] = source
            continue
        value = _of_width(source, OUTPUTS[output], f"{graph.name}: output {output}")
        if output != "normal":
            constants[output] = value[0] if len(value) == 1 else value
        elif value != _FLAT_NORMAL:
            outputs[output] = value
    return replace(graph, outputs=outputs, constants=constants)


def _of_width(value: Constant, width: int, place: str) -> Constant:
    """A constant brought to so many numbers as type inference would."""
    if not np.isfinite(width_cost(len(value), width)):
        raise SceneError(f"{place}: it is given a constant of {len(value)}; expected a number or {width}")
    return value * width if len(value) == 1 else (*value, 1.0)[:width]


def _links(node: Node) -> Iterator[int]:
    return (source.node for source in node.inputs.values() if isinstance(source, Link))


def _order(graph: Graph) -> list[int]:
    """The nodes that the outputs need, each behind those that it reads. Raises SceneError for a cycle anywhere."""
    order: list[int] = []
    state: dict[int, bool] = {}  # False: being visited; True: done
    needed = len(graph.nodes)
    starts = [source.node for source in graph.outputs.values() if isinstance(source, Link)]
    for start in (*starts, None, *range(len(graph.nodes))):
        if start is None:
            needed = len(order)
            continue
        path = [] if start in state else [(start, _links(graph.nodes[start]))]
        state.setdefault(start, False)
        while path:
            node, links = path[-1]
            source = next((link for link in links if not state.get(link, False)), None)
            if source is None:
                state[node] = True
                order.append(node)
                path.pop()
            elif source in state:
                raise _cycle_error(graph, [n for n, _ in path], source)
            else:
                state[source] = False
                path.append((source, _links(graph.nodes[source])))
    return order[:needed]


def _cycle_error(graph: Graph, path: list[int], start: int) -> SceneError:
    places = [graph.nodes[node].place for node in path[path.index(start) :]]
    shown = ", ".join(places[:3]) + (f" and {len(places) - 3} more" if len(places) > 3 else "")
    return SceneError(f"{places[0]}: it reads its own output (by way of {shown}); expected no cycle")


def _merged(graph: Graph, order: list[int]) -> Graph:
    """Only these nodes, in this order, equal ones once."""
    place: dict[int, int] = {}  # by old number
    known: dict[tuple, int] = {}
    merged: list[Node] = []

    def moved(source: Link | Constant) -> Link | Constant:
        return Link(place[source.node], source.socket) if isinstance(source, Link) else source

    for number in order:
        node = graph.nodes[number]
        inputs = {socket: moved(source) for socket, source in sorted(node.inputs.items())}
        key = (node.kind, repr(inputs), tuple(sorted(node.integers.items())))  # repr: 0.0 is not -0.0
        place[number] = known.setdefault(key, len(merged))
        if place[number] == len(merged):
            merged.append(replace(node, inputs=inputs))
    outputs: Mapping = {output: moved(source) for output, source in graph.outputs.items()}
    return replace(graph, nodes=tuple(merged), outputs=outputs)


def _without_unused_textures(graph: Graph) -> Graph:
    used = sorted({node.integers["Texture"] for node in graph.nodes if "Texture" in node.integers})
    place = {texture: i for i, texture in enumerate(used)}
    nodes = tuple(
        replace(node, integers={**node.integers, "Texture": place[node.integers["Texture"]]})
        if "Texture" in node.integers
        else node
        for node in graph.nodes
    )
    return replace(graph, nodes=nodes, textures=tuple(graph.textures[texture] for texture in used))
