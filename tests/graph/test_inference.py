"""Type inference against an exhaustive search, on small random graphs; its errors, and its speed on large ones."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_graphs import NODES, graphs

import clcache.graph
from clcache.errors import SceneError
from clcache.graph import infer as module
from clcache.graph.infer import infer
from clcache.graph.library import Library, Overload, library, parse
from clcache.graph.model import OUTPUTS, Graph, Link
from clcache.graph.prepare import prepare
from clcache.graph.text import parse as read_text

# What a value of the first type may be read as, and for how many conversions, as written down once more.
WIDER = {("float", "float2"), ("float", "float3"), ("float", "float4"), ("float3", "float4"), ("float4", "float3")}


def conversions(source: str, target: str) -> float:
    plain_source, plain_target = source.removesuffix("_D"), target.removesuffix("_D")
    if plain_source != plain_target and (plain_source, plain_target) not in WIDER:
        return math.inf
    if target.endswith("_D") and not source.endswith("_D"):
        return math.inf
    return (plain_source != plain_target) + (source.endswith("_D") and not target.endswith("_D"))


def cost(graph: Graph, chosen: tuple[Overload, ...]) -> tuple[float, float, float]:
    """Alphas added or lost, numbers computed, other conversions; infinite if a link is impossible."""
    links = []
    for node, overload in zip(graph.nodes, chosen, strict=True):
        for socket, source in node.inputs.items():
            target = overload.inputs[socket]
            if isinstance(source, Link):
                links.append((chosen[source.node].outputs[source.socket], target))
            else:
                links.append(("float" + (str(len(source)) if len(source) > 1 else ""), target.removesuffix("_D")))
    for output, source in graph.outputs.items():
        target = {1: "float", 3: "float3"}[OUTPUTS[output]]
        links.append((chosen[source.node].outputs[source.socket], target))
    total = sum(conversions(*link) for link in links)
    if math.isinf(total):
        return (math.inf, math.inf, math.inf)
    alphas = sum({s.removesuffix("_D"), t.removesuffix("_D")} == {"float3", "float4"} for s, t in links)
    sizes = {
        "float": 1,
        "float2": 2,
        "float3": 3,
        "float4": 4,
        "float_D": 3,
        "float2_D": 6,
        "float3_D": 9,
        "float4_D": 12,
    }
    return (alphas, sum(sizes[t] for overload in chosen for t in overload.outputs.values()), total - alphas)


def exhaustive(graph: Graph, nodes: Library) -> tuple[float, float, float]:
    return min(cost(graph, chosen) for chosen in itertools.product(*(nodes[node.kind] for node in graph.nodes)))


@settings(max_examples=300, deadline=None)
@given(graphs())
def test_costs_as_little_as_any_choice(graph: Graph) -> None:
    graph = prepare(graph, NODES)
    least = exhaustive(graph, NODES)
    if math.isinf(least[0]):
        with pytest.raises(SceneError, match="test.graph.* expected"):
            infer(graph, NODES)
    else:
        assert cost(graph, infer(graph, NODES)) == least


@settings(max_examples=200, deadline=None)
@given(graphs())
def test_is_possible_where_the_search_is_cut_short(graph: Graph) -> None:
    """With room for no combination at all, nodes are fixed one by one."""
    graph = prepare(graph, NODES)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MAX_COMBINATIONS", 1)
        try:
            assert math.isfinite(cost(graph, infer(graph, NODES))[0])
        except SceneError:
            assert math.isinf(exhaustive(graph, NODES)[0])


@st.composite
def problems(draw: st.DrawFn) -> tuple[list[np.ndarray], dict[tuple[int, int], np.ndarray]]:
    """Costs of up to 6 nodes with up to 3 choices each, and of any pairs of them."""
    costs = st.sampled_from([0.0, 1.0, 2.0, 7.0, math.inf])
    sizes = draw(st.lists(st.integers(1, 3), min_size=1, max_size=6))

    def table(*shape: int) -> np.ndarray:
        count = math.prod(shape)
        return np.array(draw(st.lists(costs, min_size=count, max_size=count))).reshape(shape)

    every = list(itertools.combinations(range(len(sizes)), 2))
    pairs = draw(st.sets(st.sampled_from(every))) if every else ()
    return [table(size) for size in sizes], {(a, b): table(sizes[a], sizes[b]) for a, b in sorted(pairs)}


@settings(max_examples=300, deadline=None)
@given(problems(), st.sampled_from([1, 4, 9, 1 << 14]))
def test_the_search_itself(problem: tuple, combinations: int) -> None:
    """With room for all combinations it is exact; with less, what it finds is possible."""
    own, pairs = problem

    def total(choices: tuple[int, ...]) -> float:
        linked = sum(costs[choices[a], choices[b]] for (a, b), costs in pairs.items())
        return sum(costs[choice] for costs, choice in zip(own, choices, strict=True)) + linked

    least = min(map(total, itertools.product(*(range(len(costs)) for costs in own))))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MAX_COMBINATIONS", combinations)
        chosen = module._solve(own, pairs)
    if combinations == 1 << 14:
        assert (chosen is None) == math.isinf(least)
        assert chosen is None or total(tuple(chosen)) == least
    else:
        assert chosen is None or math.isfinite(total(tuple(chosen)))


def chosen_types(text: str, nodes: Library = NODES) -> dict[str, dict[str, str]]:
    graph = prepare(read_text(text, "test.graph", nodes), nodes)
    return {n.kind: dict(o.outputs) for n, o in zip(graph.nodes, infer(graph, nodes), strict=True)}


def test_derivatives_only_where_a_texture_needs_them() -> None:
    types = chosen_types(
        """UV Out>0; Float2Constant 2 2 Out>1; Normal Out>2;
        Parts A<0 Same>3 First>4; Image UV<3 Out>5; Add A<5 B<2 Out>6; ColorOutput In<6; RoughnessOutput In<4;"""
    )
    assert types == {
        "UV": {"Out": "float2_D"},
        "Parts": {"Same": "float2_D", "First": "float"},
        "Image": {"Out": "float4"},
        "Normal": {"Out": "float3"},
        "Add": {"Out": "float3"},
    }


def test_numbers_stay_numbers_until_a_vector_needs_them() -> None:
    """Even where one conversion at their source would do in place of three."""
    text = """UV Out>0; Noise UV<0 Out>1; Parts A<1 Same>2 First>3; Float1Constant 1 Out>4; Add A<1 B<4 Out>5;
    ColorOutput In<5; EmissionOutput In<5; SpecularColorOutput In<5; RoughnessOutput In<3;"""
    types = chosen_types(text)
    assert types["Noise"] == types["Add"] == {"Out": "float"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "UV Out>0;\nColorOutput In<0;",
            "test.graph: output base_color: it is given float2 by socket Out of test.graph:1: UV; expected float3",
        ),
        (
            "Normal Out>0;\nImage UV<0 Out>1;\nColorOutput In<1;",
            "test.graph:2: Image: socket UV: it is given float3 by socket Out of test.graph:1: Normal; "
            "expected float2 with derivatives",
        ),
        (
            "UV Out>0;\nNormal Out>1;\nAdd A<1\n B<0 Out>2;\nColorOutput In<2;",
            "test.graph:3: Add: socket B: it is given float2 by socket Out of test.graph:1: UV; "
            "expected float or float3",
        ),
        (
            "Float2Constant 1 2 Out>0;\nFloat3Constant 1 2 3 Out>1;\nAdd A<0 B<1 Out>2;\nRoughnessOutput In<2;",
            "test.graph:3: Add: socket B: it is given a constant of 3; expected float2",
        ),
        (
            "UV Out>0;\nNormal Out>1;\nDot A<0 B<1 Out>2;\nRoughnessOutput In<2;",
            "test.graph:3: Dot: socket B: it is given float3 by socket Out of test.graph:2: Normal; expected float2",
        ),
    ],
)
def test_errors_name_node_socket_and_types(text: str, message: str) -> None:
    with pytest.raises(SceneError) as error:
        chosen_types(text)
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("node", "expected"),
    [
        ("Length In<1", np.abs), ("Dot A<1 B<1", np.square), ("Normalize In<1", np.sign), ("Extract 0 In<1", np.array),
        ("Distance A<1 B<2", lambda x: np.abs(x - 0.5)), ("HsvToRgb In<3", lambda x: 0.7 + 0 * x),
    ],
)  # fmt: skip
def test_a_number_is_a_vector_of_one_component(node: str, expected: Callable, tmp_path: Path) -> None:
    path = tmp_path / "a.graph"
    path.write_text(
        "PositionInput Out>0; Separate3 In<0 X>1; Float1Constant 0.5 Out>2; Float3Constant 0.3 -0.5 0.7 Out>4;"
        f"Float3Constant 0 0 0 Out>5; Mul A<5 B<0 Out>6; Add A<4 B<6 Out>3; {node} Out>9; EmissionOutput In<9;"
    )
    places = np.random.default_rng(1).uniform(-2.0, 2.0, (20, 3)).astype(np.float32)
    found = clcache.graph.load(path).evaluate(np.zeros((20, 2)), position=places)["emission"]
    np.testing.assert_allclose(found, np.repeat(expected(places[:, :1]), 3, axis=1), rtol=1e-6)


def test_derivatives_are_dropped_early_even_where_that_takes_more_conversions() -> None:
    nodes = parse(
        """
NODE void UV(const GraphInputs *in, float2_D *Out) {}

NODE void Add(float2 A, float2 B, float2 *Out) {}
NODE void Add(float2_D A, float2_D B, float2_D *Out) {}

NODE void Dot(float2 A, float2 B, float *Out) {}
NODE void Dot(float2_D A, float2_D B, float_D *Out) {}
""",
        "test.cl",
    )
    text = """UV Out>0; Float2Constant 1 2 Out>1; Float2Constant 3 4 Out>2; Add A<0 B<1 Out>3; Add A<0 B<2 Out>4;
    Dot A<3 B<4 Out>5; RoughnessOutput In<5;"""
    assert chosen_types(text, nodes) == {"UV": {"Out": "float2_D"}, "Add": {"Out": "float2"}, "Dot": {"Out": "float"}}


def test_second_derivatives_do_not_exist() -> None:
    """A normal made from derivatives cannot be where a texture is read (thesis, section 5.1)."""
    nodes = parse(
        """
NODE void UV(const GraphInputs *in, float2_D *Out) {}

NODE void Slope(float2_D A, float2 *Out) {}

NODE void Image(float2_D UV, float3 *Out) {}
""",
        "test.cl",
    )
    with pytest.raises(SceneError, match="expected float2 with derivatives"):
        chosen_types("UV Out>0; Slope A<0 Out>1; Image UV<1 Out>2; ColorOutput In<2;", nodes)


@pytest.mark.parametrize("reach", [1, 3, 4000])
def test_large_graphs_are_solved(reach: int) -> None:
    """4,000 additions of two earlier values, half of them of numbers alone, the other half of vectors too; from a chain to
    one that no order of elimination can hold."""
    draw = np.random.default_rng(reach)
    numbers, vectors = [1], [0]
    text = ["PositionInput Out>0; Length In<0 Out>1;"]
    for node in range(2, 4000):
        own, other = (numbers, numbers) if node % 2 else (vectors, numbers if draw.random() < 0.8 else vectors)
        a, b = (pool[-1 - draw.integers(min(reach, len(pool)))] for pool in (own, other))
        own.append(node)
        text.append(f"Add A<{a} B<{b} Out>{node};")
    text.append("Add A<3999 B<3998 Out>4000; ColorOutput In<4000;")
    nodes = library()
    graph = prepare(read_text("\n".join(text), "test.graph", nodes), nodes)
    assert math.isfinite(cost(graph, infer(graph, nodes))[0])
