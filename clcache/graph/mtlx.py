"""MaterialX documents: from a surface material back through its connections to a graph of this package's nodes."""

from pathlib import Path

import MaterialX

from .model import Graph, printable
from .mtlx_expand import MAX_DEPTH, Expansion, Scope, is_connected
from .mtlx_file import read_document
from .mtlx_nodes import Value, resized
from .mtlx_signals import Builder, Signal
from .mtlx_surface import SHADERS, Constants, surface_of


def read_mtlx(path: Path, name: str, material: str | None) -> Graph:
    """The graph of a material in a .mtlx file.

    name: the file as messages call it. material: name of the surface material, needed where there are several. A document
    that has none but a graph with a colour as its output gives that as the base colour. Raises SceneError, one line that
    names the line of the file."""
    document, places = read_document(path, name)
    builder = Builder(name)
    outputs, constants = _material(Expansion(document, places, builder), material)
    return Graph(
        name=name,
        nodes=tuple(builder.nodes),
        outputs={output: signal.source for output, signal in outputs.items()},
        textures=tuple(builder.textures),
        constants=constants,
        notes=tuple(builder.notes),
    )


def _material(expansion: Expansion, name: str | None) -> tuple[dict[str, Signal], Constants]:
    """Outputs and constants of the named material, the only one, or the only graph."""
    children = expansion.document.getChildren()
    nodes = [element for element in children if isinstance(element, MaterialX.Node)]
    materials = [node for node in nodes if node.getType() == "material"]
    shaders = [node for node in nodes if node.getType() == "surfaceshader"]
    if not materials and not shaders:
        graphs = [element for element in children if isinstance(element, MaterialX.NodeGraph)]
        return {"base_color": _colour_of_a_graph(expansion, name, graphs)}, {}
    chosen = _choose(expansion.builder, name, materials or shaders)
    expansion.enter(chosen, expansion.root)
    if materials:
        return _surface(expansion, *_shader_of(expansion, chosen))
    return _surface(expansion, chosen, expansion.root)


def _choose(b: Builder, name: str | None, candidates: list[MaterialX.Node]) -> MaterialX.Node:
    """The candidate of that name; without a name, the only one."""
    names = [node.getName() for node in candidates]
    known = ", ".join(printable(n) for n in names[:8]) + (", …" if len(names) > 8 else "")
    if name is None and len(candidates) > 1:
        b.fail(f"has {len(names)} materials; expected the name of one of them: {known}")
    if name is not None and name not in names:
        b.fail(f"has no material {printable(name)}; expected one of {known}")
    return candidates[0 if name is None else names.index(name)]


def _colour_of_a_graph(expansion: Expansion, name: str | None, graphs: list[MaterialX.NodeGraph]) -> Signal:
    """The output of colour of the named graph, or of the only one that has one."""
    outputs = [
        output
        for graph in graphs
        if not graph.getAttribute("nodedef") and name in (None, graph.getName())
        for output in graph.getOutputs()
        if output.getType() in ("color3", "color4")
    ]
    if len(outputs) != 1:
        found = f"{len(outputs)} graphs' outputs of colour" if outputs else "no graph's output of colour"
        expansion.builder.fail(f"has no surface material, and {found}; expected a material, or one output of colour")
    scope = expansion.scope_of(outputs[0].getParent())
    return resized(expansion.run(expansion.port(outputs[0], scope)), 3)


def _shader_of(expansion: Expansion, material: MaterialX.Node) -> tuple[MaterialX.Node, Scope]:
    """The surface shader that a material connects, and where it stands: at any depth of graphs, and of kinds of shaders that
    graphs implement."""
    b = expansion.builder
    if material.getCategory() != "surfacematerial":
        b.fail("not supported; expected a surfacematerial")
    displacement = material.getInput("displacementshader")
    if displacement is not None and is_connected(displacement):
        b.note("its displacement is left out")
    port, scope = material.getInput("surfaceshader"), expansion.root
    for _ in range(MAX_DEPTH):
        if port is None or not is_connected(port):
            break
        if port.getNodeGraphString():
            graph = expansion.child(scope, port.getNodeGraphString(), MaterialX.NodeGraph)
            port, scope = expansion.output_of(graph, port.getOutputString()), expansion.scope_of(graph)
            continue
        node = expansion.child(scope, port.getNodeName(), MaterialX.Node)
        expansion.enter(node, scope)
        definition = expansion.definition(node, scope)
        kind = expansion.standard_kind(definition)
        if kind in SHADERS:
            return node, scope
        if kind == "dot":
            port = node.getInput("in")
            continue
        if kind:
            break
        scope = expansion.instance(node, definition, scope)
        port = expansion.output_of(scope.graph, port.getOutputString())
    b.fail(f"connects no surface shader that is supported; expected one of {', '.join(SHADERS)}")


def _surface(expansion: Expansion, shader: MaterialX.Node, scope: Scope) -> tuple[dict[str, Signal], Constants]:
    """Outputs and constants of a surface shader."""
    expansion.enter(shader, scope)
    kind = expansion.standard_kind(expansion.definition(shader, scope))
    if kind not in SHADERS:
        expansion.builder.fail(f"not supported as a surface shader; expected one of {', '.join(SHADERS)}")

    def parameter(name: str) -> Value:
        value = expansion.run(expansion.input(shader, scope, name))
        expansion.enter(shader.getInput(name) or shader, scope)
        return value

    port = shader.getInput(SHADERS[kind].normal)
    normal = parameter(port.getName()) if port is not None and is_connected(port) else None
    expansion.enter(shader, scope)
    return surface_of(SHADERS[kind], expansion.builder, parameter, normal)
