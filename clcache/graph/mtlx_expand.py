"""Evaluating a MaterialX document by name: from an output back through its connections to signals.

A document connects nodes; the standard library, and the document itself, implement some kinds of them by graphs of other
nodes. An input is a constant, a node's output, or what the graph around it was given, and so on. Nodes that `mtlx_nodes`
knows become nodes of the package; the others are entered, each time as an instance (a Scope) of its own. Evaluations are
generators that yield the evaluation they need next, so that chains of nodes are as long as they like and only cycles and
the limits below are errors.
"""

from collections.abc import Generator
from dataclasses import dataclass, field

import MaterialX

from .model import printable
from .mtlx_file import MATRICES, WIDTHS, Places, numbers_of, standard_library
from .mtlx_nodes import INPUTS, LOWERINGS, Value, resized
from .mtlx_signals import Builder, Signal

MAX_DEPTH = 64  # of nodes implemented by graphs of nodes implemented by graphs ...
MAX_NODES = 10_000  # of a document, counted again for each use of the graph that they are in
LINEAR = ("", "lin_rec709", "raw", "none")  # names of what needs no conversion of colours
GEOMETRY = {"UV0": "texcoord", "Pobject": "position", "Nobject": "normal"}
RUNNING = object()

Evaluation = Generator["Evaluation", Value, Value]


class Text(str):
    """A value that is no number. colorspace: of a picture's file, what its colours are encoded in."""

    colorspace: str = ""


@dataclass(eq=False)
class Scope:
    """A graph of nodes as it is used in one place.

    graph: the graph, or the whole document. call: the node that it implements, if it implements one; outer: where that node
    stands. given: inputs that no node gives. place: of the node that all of it stands for, where the graph is none of the
    document's. depth: how many nodes implemented by graphs it is within. values, inner: what is known by now."""

    graph: MaterialX.Element
    call: MaterialX.Node | None = None
    outer: "Scope | None" = None
    given: dict[str, Value] = field(default_factory=dict)
    place: str = ""
    depth: int = 0
    values: dict[tuple, Value] = field(default_factory=dict)
    inner: dict[str, "Scope"] = field(default_factory=dict)


class Expansion:
    """Evaluates parts of a document into a builder. root: the scope of what stands in no graph."""

    def __init__(self, document: MaterialX.Document, places: Places, builder: Builder) -> None:
        self.document = document
        self.places = places
        self.builder = builder
        self.root = Scope(document)
        self.nodes = 0

    def run(self, evaluation: Evaluation) -> Value:
        """The value of an evaluation, with those that it needs on a stack of their own."""
        stack, value = [evaluation], None
        while stack:
            try:
                stack.append(stack[-1].send(value))
                value = None
            except StopIteration as result:
                stack.pop()
                value = result.value
        return value

    def enter(self, element: MaterialX.Element, scope: Scope) -> None:
        """Name an element in the messages to come."""
        self.builder.place = scope.place or self.places.of(element)

    def once(self, key: tuple, scope: Scope, element: MaterialX.Element, evaluation: Evaluation) -> Evaluation:
        """An evaluation whose value the scope keeps. Refuses one that needs itself."""
        if key not in scope.values:
            scope.values[key] = RUNNING
            scope.values[key] = yield evaluation
        if scope.values[key] is RUNNING:
            self.enter(element, scope)
            self.builder.fail("its value depends on itself; expected no cycle")
        return scope.values[key]

    def child(self, scope: Scope, name: str, kind: type) -> MaterialX.Element:
        """The element that a connection names: beside it or, as graphs are, in the document."""
        element = scope.graph.getChild(name)
        if element is None and scope.graph is not self.document:
            element = self.document.getChild(name)
        if not isinstance(element, kind):
            self.builder.fail(f"is connected to {printable(name)}, which is no {kind.__name__.lower()} of the document")
        return element

    def scope_of(self, graph: MaterialX.NodeGraph) -> Scope:
        """The scope of a graph that is used by name; the same for all that use it."""
        return self.root.inner.setdefault(graph.getNamePath(), Scope(graph))

    def port(self, port: MaterialX.PortElement, scope: Scope) -> Evaluation:
        """The value of an input or output: what it is connected to, else its own."""
        self.enter(port, scope)
        if port.getInterfaceName():
            return (yield self.interface(port, scope))
        if port.getNodeName():
            source = self.child(scope, port.getNodeName(), MaterialX.InterfaceElement)
            if isinstance(source, MaterialX.Node):
                return (yield self.node(source, scope, port.getOutputString()))
            return (yield self.output(source, port.getOutputString()))
        if port.getNodeGraphString():
            graph = self.child(scope, port.getNodeGraphString(), MaterialX.NodeGraph)
            return (yield self.output(graph, port.getOutputString()))
        if port.getOutputString():
            output = self.child(scope, port.getOutputString(), MaterialX.Output)
            return (yield self.once(("output", output.getName()), scope, output, self.port(output, scope)))
        return (yield self.declared(port))

    def output(self, graph: MaterialX.NodeGraph, name: str) -> Evaluation:
        """The value of a named graph's output."""
        port, inner = self.output_of(graph, name), self.scope_of(graph)
        return (yield self.once(("output", port.getName()), inner, port, self.port(port, inner)))

    def output_of(self, graph: MaterialX.NodeGraph, name: str) -> MaterialX.Output:
        """The output of a graph that a connection names; without a name, the only one."""
        outputs = graph.getOutputs()
        port = graph.getOutput(name) if name else outputs[0] if len(outputs) == 1 else None
        if port is None:
            names = ", ".join(printable(output.getName()) for output in outputs[:8]) or "none"
            self.builder.fail(f"has no output {printable(name)!r}; expected one of {names}")
        return port

    def interface(self, port: MaterialX.Input, scope: Scope) -> Evaluation:
        """The value of the graph's own input that a node's input names."""
        name = port.getInterfaceName()
        if name in scope.given:
            return scope.given[name]
        if scope.call is not None:
            return (yield self.input(scope.call, scope.outer, name))
        source = scope.graph.getInput(name) if isinstance(scope.graph, MaterialX.NodeGraph) else None
        if source is None:
            self.builder.fail(f"reads {printable(name)}, which is no input of its graph")
        outer = self.root if source.getNodeName() or source.getNodeGraphString() else scope
        return (yield self.once(("input", name), scope, source, self.port(source, outer)))

    def input(self, node: MaterialX.Node, scope: Scope, name: str) -> Evaluation:
        """The value of a node's input; where the node does not give it, that of the node's definition."""
        port = node.getInput(name)
        if port is None or not _is_given(port):
            definition = self.definition(node, scope)
            declared = definition.getActiveInput(name)
            if declared is None:
                self.enter(node, scope)
                self.builder.fail(f"has no input {printable(name)}")
            if port is None or _is_given(declared):
                self.enter(node, scope)
                return (yield self.declared(declared))
        return (yield self.once(("input", node.getName(), name), scope, node, self.port(port, scope)))

    def declared(self, port: MaterialX.PortElement) -> Evaluation:
        """The value of an input or output that is connected to nothing."""
        if isinstance(port, MaterialX.Input) and port.getDefaultGeomPropString():
            return self.geometry(port.getDefaultGeomPropString())
        return (yield self.value(port))

    def node(self, node: MaterialX.Node, scope: Scope, output: str) -> Evaluation:
        """The value of a node's output."""
        results = yield self.once(("node", node.getName()), scope, node, self.results(node, scope))
        if isinstance(results, Scope):
            self.enter(node, scope)
            port = self.output_of(results.graph, output)
            return (yield self.once(("output", port.getName()), results, node, self.port(port, results)))
        if output in results:
            return results[output]
        if len(results) != 1:
            self.enter(node, scope)
            self.builder.fail(f"has no output {printable(output)!r}; expected one of {', '.join(results)}")
        return next(iter(results.values()))

    def results(self, node: MaterialX.Node, scope: Scope) -> Evaluation:
        """A node's outputs by name or, where it is implemented by a graph, the scope that has them."""
        self.enter(node, scope)
        self.nodes += 1
        if self.nodes > MAX_NODES:
            self.builder.fail(f"the document expands to more than {MAX_NODES:,} nodes; expected fewer")
        definition = self.definition(node, scope)
        if self.standard_kind(definition) in LOWERINGS:
            return (yield self.lowered(node, definition, scope))
        return self.instance(node, definition, scope)

    def standard_kind(self, definition: MaterialX.NodeDef) -> str:
        """The kind of node that a definition of the standard library defines, whatever the node itself is called; "" for one
        of the document's own."""
        return "" if definition.getRoot() is self.document else definition.getNodeString()

    def instance(self, node: MaterialX.Node, definition: MaterialX.NodeDef, scope: Scope) -> Scope:
        """The scope of the graph that implements a node."""
        graph = definition.getImplementation()
        if not isinstance(graph, MaterialX.NodeGraph):
            self.builder.fail(f"nodes of the kind {printable(definition.getNodeString())} are not supported")
        if scope.depth >= MAX_DEPTH:
            self.builder.fail(f"its kind is implemented by itself, or by {MAX_DEPTH} kinds in turn; expected fewer")
        place = "" if graph.getRoot() is self.document else self.builder.place
        return Scope(graph, node, scope, {}, scope.place or place, scope.depth + 1)

    def lowered(self, node: MaterialX.Node, definition: MaterialX.NodeDef, scope: Scope) -> Evaluation:
        """The outputs of a node that `mtlx_nodes` knows, each with the channels of its type."""
        category, outputs = definition.getNodeString(), definition.getActiveOutputs()
        known = {port.getName() for port in definition.getActiveInputs()}
        kind = outputs[0].getType()
        values, space = [], ""
        for name in INPUTS[category]:
            if name == "width":
                values.append(WIDTHS[kind])
            elif name == "srgb":
                space = values[-1].colorspace if kind.startswith("color") else ""
                values.append(space == "srgb_texture")
            else:
                values.append((yield self.input(node, scope, name)) if name in known else None)
        self.enter(node, scope)
        for name in ("normal", "tangent", "bitangent") if category == "normalmap" else ():
            if not self.is_surfaces(node, scope, name):
                self.builder.fail(f"its {name} is connected to another than the surface's own; expected none")
        if category not in ("constant", "dot", "transformmatrix") and any(isinstance(v, tuple) for v in values):
            self.builder.fail("computes with matrices; expected them to be constant, and to transform vectors only")
        result = LOWERINGS[category](self.builder, *values)
        results = result if isinstance(result, dict) else {outputs[0].getName(): result}
        for port in outputs:
            value = results.get(port.getName())
            if isinstance(value, Signal) and value.width != WIDTHS.get(port.getType(), value.width):
                results[port.getName()] = resized(value, WIDTHS[port.getType()])
        if space not in ("", "srgb_texture"):
            results = {outputs[0].getName(): (yield self.linear(results[outputs[0].getName()], space))}
        return results

    def is_surfaces(self, node: MaterialX.Node, scope: Scope, name: str) -> bool:
        """Whether an input of that name, normal or tangent, is the surface's: not given, or given as the world's."""
        port = node.getInput(name)
        if port is None or not _is_given(port):
            return True
        if port.getInterfaceName() and scope.call is not None:
            return self.is_surfaces(scope.call, scope.outer, port.getInterfaceName())
        source = scope.graph.getChild(port.getNodeName()) if port.getNodeName() else None
        if not isinstance(source, MaterialX.Node) or self.standard_kind(self.definition(source, scope)) != name:
            return False
        return source.getInputValue("space") == "world"

    def definition(self, node: MaterialX.Node, scope: Scope) -> MaterialX.NodeDef:
        definition = node.getNodeDef()
        if definition is None:
            self.enter(node, scope)
            self.builder.fail("no kind of node has this name and these types of inputs")
        return definition

    # Values.

    def geometry(self, name: str) -> Signal:
        """The value of a geometric property that an input reads where nothing is connected."""
        if name not in GEOMETRY:
            self.builder.fail(f"reads the geometric property {printable(name)}; expected one of {', '.join(GEOMETRY)}")
        rest = {"texcoord": self.builder.constant((0.0,))}
        if (name,) not in self.root.values:
            self.root.values[(name,)] = LOWERINGS[GEOMETRY[name]](self.builder, rest.get(GEOMETRY[name], "object"))
        return self.root.values[(name,)]

    def value(self, port: MaterialX.PortElement) -> Evaluation:
        """The constant that an input holds."""
        kind, text = port.getType(), port.getValueString()
        if kind in ("string", "filename"):
            return self.text(port, text)
        if kind == "boolean":
            return self.builder.constant((float(text.strip() == "true"),))
        numbers = numbers_of(text)
        if kind in MATRICES and numbers is not None:
            return numbers
        if kind not in WIDTHS or numbers is None or len(numbers) != WIDTHS[kind]:
            self.builder.fail(f"input {printable(port.getName())} has no value; expected a {printable(kind)}")
        signal = self.builder.constant(numbers)
        if port.hasUnit():
            signal = signal * self.unit(port.getUnit())
        if kind in ("color3", "color4"):
            return (yield self.linear(signal, port.getActiveColorSpace()))
        return signal

    def unit(self, name: str) -> float:
        """A unit in degrees or metres, as the standard library defines it."""
        units = {unit.getName(): unit for kind in standard_library().getUnitDefs() for unit in kind.getUnits()}
        if name not in units:
            self.builder.fail(f"unit {printable(name)} is not supported; expected one of {', '.join(units)}")
        return float(units[name].getAttribute("scale"))

    def text(self, port: MaterialX.PortElement, text: str) -> Text:
        if port.getType() != "filename":
            return Text(text)
        if port.hasUnit():
            self.builder.fail(f"its picture holds numbers in {printable(port.getUnit())}; expected no unit")
        result = Text(port.getActiveFilePrefix() + text if text else "")
        result.colorspace = port.getActiveColorSpace()
        return result

    def linear(self, signal: Signal, space: str) -> Evaluation:
        """A colour brought to linear Rec. 709, by the standard library's node for that."""
        if space in LINEAR:
            return signal
        definition = standard_library().getNodeDef(f"ND_{space}_to_lin_rec709_color{signal.width}")
        if definition is None:
            self.builder.fail(f"colour space {printable(space)!r} is not supported")
        graph = definition.getImplementation()
        scope = Scope(graph, given={"in": signal}, place=self.builder.place, depth=1)
        return (yield self.port(graph.getOutputs()[0], scope))


def is_connected(port: MaterialX.PortElement) -> bool:
    """Whether an input or output reads something else."""
    return any((port.getNodeName(), port.getNodeGraphString(), port.getInterfaceName(), port.getOutputString()))


def _is_given(port: MaterialX.Input) -> bool:
    """Whether an input says where its value comes from."""
    return is_connected(port) or port.hasValueString() or bool(port.getDefaultGeomPropString())
