"""OpenCL C of typed graphs: one function per graph in static single assignment form, and a switch over the graphs.

    __attribute__((noinline)) void graph_0(const GraphInputs *in, const Maps *maps, float *out)
    {
        float3 v0, v1;
        NormalInput(in, &v0);
        Mul(v0, (float3)(0.5f, 0.5f, 0.5f), &v1);
        ...

Each variable is one node's output, written by one call and read by later ones. The implementations that are used stand in
front, once each. Names and numbers of the text are the library's and this module's own: of a document only the values of
constants and integers get here, as literals.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from .infer import width_of
from .library import PASSED_ON, Overload
from .model import OUTPUTS, Constant, Graph, Link

HEADERS = ("graph/types.cl", "scene/maps.cl")
_PARAMETERS = "(const GraphInputs *in, const Maps *maps, float *out)"


def emit(graphs: Sequence, uses: Sequence[Sequence[int]] | None = None) -> str:
    """The text for several CompiledGraphs: what they need, functions graph_0 … in their order, and

        void evaluate_graph(uint graph, const GraphInputs *in, const Maps *maps, float *out)

    which writes the outputs of one graph to `out`, packed in the order of OUTPUTS. uses: for each graph, the place among
    all uses of textures (Maps) of each of its textures; None: 0, 1, … for each graph.
    """
    uses = [range(len(g.graph.textures)) for g in graphs] if uses is None else uses
    overloads = sorted({o for g in graphs for o in g.overloads}, key=lambda o: (o.kind, o.source))
    headers = dict.fromkeys((*HEADERS, *(f"graph/{file}" for o in overloads for file in o.needs)))
    parts = ["\n".join(f'#include "{header}"' for header in headers)]
    parts += [o.source for o in overloads]
    parts += [
        _function(f"graph_{i}", g.graph, g.overloads, textures)
        for i, (g, textures) in enumerate(zip(graphs, uses, strict=True))
    ]
    cases = "".join(f"    case {i}: graph_{i}(in, maps, out); break;\n" for i in range(len(graphs)))
    parts.append(
        f"NOINLINE void evaluate_graph(uint graph, {_PARAMETERS[1:]}\n{{\n    switch (graph) {{\n{cases}    }}\n}}"
    )
    return "\n\n".join(parts) + "\n"


def literal(value: float) -> str:
    """An OpenCL literal that is exactly the float nearest to a finite value."""
    return re.sub(r"\.0*p", "p", re.sub(r"0+p", "p", float(np.float32(value)).hex())) + "f"


def _function(name: str, graph: Graph, overloads: Sequence[Overload], textures: Sequence[int]) -> str:
    variables = {}
    declared: dict[str, list[str]] = {}
    for i, overload in enumerate(overloads):
        for socket, type_name in overload.outputs.items():
            variable = variables[Link(i, socket)] = f"v{len(variables)}"
            declared.setdefault(type_name, []).append(variable)
    types = {Link(i, socket): t for i, o in enumerate(overloads) for socket, t in o.outputs.items()}

    def value(source: Link | Constant, target: str) -> str:
        return (
            _converted(variables[source], types[source], target)
            if isinstance(source, Link)
            else _constant(source, target)
        )

    lines = [f"{type_name} {', '.join(names)};" for type_name, names in declared.items()]
    for i, (node, overload) in enumerate(zip(graph.nodes, overloads, strict=True)):
        arguments = []
        for parameter in overload.parameters:
            if parameter in overload.inputs:
                arguments.append(value(node.inputs[parameter], overload.inputs[parameter]))
            elif parameter in overload.outputs:
                arguments.append("&" + variables[Link(i, parameter)])
            elif parameter in PASSED_ON:
                arguments.append(parameter)
            else:
                integer = node.integers[parameter]
                arguments.append(str(textures[integer] if parameter == "Texture" else integer))
        lines.append(f"{node.kind}({', '.join(arguments)});")
    lines += _outputs(graph.outputs, value)
    body = "".join(f"    {line}\n" for line in lines)
    return f"NOINLINE void {name}{_PARAMETERS}\n{{\n{body}}}"


def _outputs(outputs: Mapping[str, Link | Constant], value) -> list[str]:
    lines, place = [], 0
    for output, source in outputs.items():
        channels = OUTPUTS[output]
        target = "float" if channels == 1 else f"float{channels}"
        finite = f"finite_or_zero({value(source, target)})"
        if channels == 1:
            lines.append(f"out[{place}] = {finite};")
        else:
            lines.append(f"vstore{channels}({finite}, 0, out + {place});")
        place += channels
    return lines


def _converted(variable: str, source: str, target: str) -> str:
    if source == target:
        return variable
    if source == target + "_D":
        return f"{variable}.v"
    return f"to_{target}({variable})"


def _constant(value: Constant, target: str) -> str:
    width = width_of(target)
    numbers = value * width if len(value) == 1 else (*value, 1.0)[:width]
    text = literal(numbers[0]) if width == 1 else f"(float{width})({', '.join(map(literal, numbers))})"
    return f"unchanging({text})" if target.endswith("_D") else text
