"""Random graphs: what a device computes is what NumPy computes.

Rounding may differ wherever it matters, at steps, poles and kinks. So NumPy evaluates each graph several times more, with
every node's outputs shaken by a few units in the last place: what that does to an output bounds what it may differ by.
"""

from contextlib import contextmanager

import numpy as np
import pytest
from graph_nodes import texture_arrays, width_of
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from clcache.errors import SceneError
from clcache.graph import OUTPUTS, CompiledGraph, Graph, GraphTexture, Link, Node, compile_graph, emit
from clcache.graph.interpret import interpret
from clcache.graph.library import library
from clcache.graph.numpy_nodes import NODES, Dual
from clcache.scene.model import Texture

POINTS = 64
SOURCES = ("UVInput", "PositionInput", "NormalInput")
KINDS = sorted(set(library()) - set(SOURCES))
INTEGERS = {
    "Octaves": st.integers(0, 3),
    "Style": st.integers(0, 1),
    "Index": st.integers(0, 3),
    "Texture": st.integers(0, 1),
}
NUMBERS = st.one_of(
    st.floats(-4, 4, width=32), st.sampled_from([0.0, 1.0, -1.0, 0.5, 2.0, 90.0]), st.floats(-300, 300, width=32)
)
PICTURES = tuple(
    Texture(f"{k}.png", np.random.default_rng(k).integers(0, 256, (h, w, 4), dtype=np.uint8), srgb, wrap)
    for k, (h, w, srgb, wrap) in enumerate([(16, 8, True, ("repeat", "mirror")), (5, 7, False, ("clamp", "repeat"))])
)


@st.composite
def graphs(draw):
    """A graph of up to twenty nodes of any kind; each socket reads a constant or one of the last nodes of its width. In half of
    them the last node is a picture, so that changes are carried all the way to it."""
    nodes = [Node(kind, {}, {}, f"t:{k}") for k, kind in enumerate(SOURCES)]
    widths = {Link(0, "Out"): 2, Link(1, "Out"): 3, Link(2, "Out"): 3}
    count = draw(st.integers(3, 16))
    for last in [False] * count + [True] * draw(st.booleans()):
        overload = draw(st.sampled_from(library()["Image" if last else draw(st.sampled_from(KINDS))]))
        number, inputs = len(nodes), {}
        for socket, type_name in overload.inputs.items():
            width = width_of(type_name)
            links = [link for link, w in widths.items() if w == width or w == 1 and width > 1]
            if links and draw(st.integers(0, 5)):
                inputs[socket] = draw(st.sampled_from(links[-3:]))
            else:
                inputs[socket] = tuple(draw(st.lists(NUMBERS, min_size=width, max_size=width)))
        integers = {name: draw(INTEGERS[name]) for name in overload.integers}
        nodes.append(Node(overload.kind, inputs, integers, f"t:{number}"))
        widths |= {Link(number, socket): width_of(t) for socket, t in overload.outputs.items()}
    latest = [link for link in widths if link.node > 2]
    outputs = {"base_color": next((link for link in reversed(latest) if widths[link] != 2), (0.5,))}
    for output, channels in OUTPUTS.items():
        fitting = [link for link in latest if widths[link] in (1, channels)]
        if fitting and output != "base_color" and draw(st.booleans()):
            outputs[output] = draw(st.sampled_from(fitting[-4:]))
    textures = tuple(GraphTexture(p.name, p.srgb, p.wrap, "t:0") for p in PICTURES)
    return Graph("t", tuple(nodes), outputs, textures, {}, ())


def compiled(graph: Graph) -> CompiledGraph | None:
    """None for a graph that no types fit, as one of a picture that the normal moves."""
    try:
        return compile_graph(graph)
    except SceneError:
        return None


def places(seed: int) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Points with footprints of several sizes."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-4, 0, (POINTS, 1))
    made = {}
    for name, channels in (("uv", 2), ("position", 3), ("normal", 3)):
        arrays = rng.uniform(-3, 3, (POINTS, channels)), *(size * rng.normal(size=(2, POINTS, channels)))
        made[name] = tuple(a.astype(np.float32) for a in arrays)
    return made


@contextmanager
def shaken_nodes(rng: np.random.Generator):
    """Every node's outputs off by up to two units in the last place."""

    def shaken(result):
        if isinstance(result, dict):
            return {name: shaken(value) for name, value in result.items()}
        parts = [
            None if a is None else a * (1 + 2.4e-7 * rng.choice([-1, 0, 1], a.shape)).astype(a.dtype)
            for a in (result.v, result.x, result.y)
        ]
        return Dual(*parts)

    with pytest.MonkeyPatch.context() as patch:
        for kind, function in list(NODES.items()):
            patch.setitem(NODES, kind, lambda _function=function, **sockets: shaken(_function(**sockets)))
        yield


def in_numpy(graph: CompiledGraph, inputs) -> np.ndarray:
    textures = [PICTURES[int(texture.file[0])] for texture in graph.graph.textures]
    outputs = interpret(graph.graph, graph.overloads, inputs, textures)
    return np.hstack([outputs[name] for name in graph.outputs])


def spread(graph: CompiledGraph, inputs, exact: np.ndarray) -> np.ndarray:
    """How far rounding moves each output of each point."""
    rng, widest = np.random.default_rng(9), np.zeros_like(exact)
    for _ in range(10):
        moved = {
            name: (v * (1 + 1.2e-7 * rng.choice([-1, 0, 1], v.shape)).astype(v.dtype), *c)
            for name, (v, *c) in inputs.items()
        }
        with shaken_nodes(rng):
            widest = np.maximum(widest, np.abs(in_numpy(graph, moved) - exact))
    return widest


_KERNEL = """
#include "graphs.cl"
__kernel void evaluate(
    __global const float *places,      // (n, 24)
    __global float *values,            // (n, 15)
    __global const TextureUse *uses,   // (uses)
    __global const Texture *textures,  // (textures)
    __global const uint *texels,       // (texels)
    __global const float *srgb,        // (256)
    uint graph,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n)
        return;
    __global const float *p = places + 24 * i;
    Maps maps = { uses, textures, texels, srgb };
    GraphInputs in;
    in.uv = with_changes(vload2(0, p), vload2(0, p + 2), vload2(0, p + 4));
    in.position = with_changes(vload3(0, p + 6), vload3(0, p + 9), vload3(0, p + 12));
    in.normal = vload3(0, p + 15);
    float out[15] = { 0.0f };
    evaluate_graph(graph, &in, &maps, out);
    for (uint k = 0; k < 15; ++k)
        values[15 * i + k] = out[k];
}
"""


def on_device(device, graphs_: list[CompiledGraph], inputs) -> list[np.ndarray]:
    """All graphs in one program, whose textures are used through one list of uses."""
    uses = [[int(texture.file[0]) for texture in graph.graph.textures] for graph in graphs_]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(device, "_programs", {})  # kept for no other test
        program = device.program("main.cl", {"main.cl": _KERNEL, "graphs.cl": emit(graphs_, uses)})
    arrays = {name: device.upload(a) for name, a in texture_arrays(*PICTURES).items()}
    arrays["places"] = device.upload(np.ascontiguousarray(np.hstack([a for v in inputs.values() for a in v])))
    arrays["values"] = device.empty((POINTS, 15), np.float32)
    found = []
    for number, graph in enumerate(graphs_):
        program["evaluate"].run(POINTS, arrays, graph=number, n=POINTS)
        found.append(arrays["values"].get()[:, : graph.channels])
    return found


@settings(
    max_examples=3, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck), database=None,
)  # fmt: skip
@given(drawn=st.lists(graphs(), min_size=24, max_size=24), seed=st.integers(0, 2**16))
def test_random_graphs(device, drawn, seed):
    inputs = places(seed)
    typed = [graph for graph in map(compiled, drawn) if graph is not None and graph.channels]
    for graph, found in zip(typed, on_device(device, typed, inputs), strict=True):
        exact = in_numpy(graph, inputs)
        with np.errstate(over="ignore"):
            margin = 10 * spread(graph, inputs, exact) + 2e-5 * (1 + np.abs(exact))
        kinds = [node.kind for node in graph.graph.nodes]
        assert np.isfinite(found).all(), kinds
        assert (np.abs(found - exact) <= margin).all(), (kinds, graph.source)


def test_what_overflows_is_zero(device):
    """The sum of two large products, each of which ends at the largest float."""
    large = [Node("Mul", {"A": Link(0, "Out"), "B": (float(b), 1.0)}, {}, "t:1") for b in (2e38, 3e38)]
    total = Node("Add", {"A": Link(1, "Out"), "B": Link(2, "Out")}, {}, "t:3")
    parts = Node("Separate2", {"In": Link(3, "Out")}, {}, "t:4")
    nodes = (Node("UVInput", {}, {}, "t:0"), *large, total, parts)
    graph = compile_graph(Graph("t", nodes, {"roughness": Link(4, "X"), "metallic": Link(4, "Y")}))
    inputs = {**places(1), "uv": (np.full((POINTS, 2), 2, np.float32), *np.zeros((2, POINTS, 2), np.float32))}
    [found] = on_device(device, [graph], inputs)
    np.testing.assert_array_equal(found, np.tile(np.float32([4, 0]), (POINTS, 1)))
    np.testing.assert_array_equal(found, in_numpy(graph, inputs))
