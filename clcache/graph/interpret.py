"""Evaluation of a typed graph in NumPy: the reference of the compiled one, and what works without OpenCL."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..scene.model import Texture
from .infer import width_of
from .library import Overload
from .model import INPUT_NODES, LARGEST, OUTPUTS, Constant, Graph, Link
from .numpy_nodes import NODES, Dual


def interpret(
    graph: Graph,
    overloads: Sequence[Overload],
    inputs: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
    textures: Sequence[Texture] = (),
) -> dict[str, np.ndarray]:
    """The outputs of a graph at n points.

    graph: nodes in an order in which inputs come before their readers. overloads: of each node, as `infer` chose them;
    they say which values carry derivatives. inputs: by name of INPUTS, the value and its changes along the two axes of
    the footprint, each (n, channels) of one floating-point dtype, in which all is computed. textures: those of the
    graph. Returns (n, channels) of that dtype for each output; 0 where a value overflowed.
    """
    with np.errstate(all="ignore"):
        values: dict[Link, Dual] = {}
        for number, (node, overload) in enumerate(zip(graph.nodes, overloads, strict=True)):
            if node.kind in INPUT_NODES:
                results = {"Out": Dual(*inputs[INPUT_NODES[node.kind]])}
            else:
                like = inputs["uv"][0]
                arguments: dict[str, object] = {
                    socket: _read(node.inputs[socket], values, type_name, like)
                    for socket, type_name in overload.inputs.items()
                }
                arguments |= node.integers
                if "Texture" in arguments:
                    arguments["Texture"] = textures[node.integers["Texture"]]
                result = NODES[node.kind](**arguments)
                results = result if isinstance(result, dict) else {"Out": result}
            for socket, type_name in overload.outputs.items():
                values[Link(number, socket)] = convert(results[socket], type_name, len(inputs["uv"][0]))
        outputs = {name: source for name in OUTPUTS if (source := graph.outputs.get(name)) is not None}
        return {name: _output(source, values, OUTPUTS[name], inputs["uv"][0]) for name, source in outputs.items()}


def _output(source: Link | Constant, values: Mapping[Link, Dual], width: int, like: np.ndarray) -> np.ndarray:
    result = _read(source, values, "float" if width == 1 else f"float{width}", like).v
    finite = np.abs(result) <= LARGEST
    return np.where(finite, result, like.dtype.type(0))


def _read(source: Link | Constant, values: Mapping[Link, Dual], type_name: str, like: np.ndarray) -> Dual:
    """A link's value, or a constant at every point, as one of TYPES."""
    if isinstance(source, Link):
        value = values[source]
    else:
        value = Dual(np.broadcast_to(np.array([source], np.float32).astype(like.dtype), (len(like), len(source))))
    return convert(value, type_name, len(like))


def convert(value: Dual, type_name: str, points: int) -> Dual:
    """A value converted as type inference may: repeated, with or without alpha, with or without changes."""
    width = width_of(type_name)

    def resized(array: np.ndarray, alpha: float) -> np.ndarray:
        if (array.shape[1], width) == (3, 4):
            array = np.hstack([array, np.full((len(array), 1), alpha, array.dtype)])
        elif (array.shape[1], width) == (4, 3):
            array = array[:, :3]
        return np.broadcast_to(array, (points, width))

    if not type_name.endswith("_D"):
        return Dual(resized(value.v, 1.0))
    zero = np.zeros((1, value.width), value.v.dtype)
    return Dual(resized(value.v, 1.0), *(resized(zero if a is None else a, 0.0) for a in (value.x, value.y)))
