"""The OpenCL C that graphs become: its form, that devices build it, and that it computes what graphs say."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from small_graphs import NODES, graphs

import clcache.graph
from clcache.device import Device
from clcache.graph import CompiledGraph, emit
from clcache.graph.emit import literal
from clcache.graph.infer import infer
from clcache.graph.library import TYPES
from clcache.graph.model import Graph
from clcache.graph.prepare import prepare

EXAMPLES = sorted((Path(__file__).parents[2] / "data" / "graphs").glob("*.graph"))

KERNEL = """
#include "graph/generated.cl"
__kernel void run(
    __global const float *uv,        // (n, 2)
    __global const float *position,  // (n, 3)
    __global const float *normal,    // (n, 3)
    __global float *values,          // (n, channels)
    uint graph,
    uint channels,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n)
        return;
    GraphInputs in;
    in.uv = with_changes((float2)(uv[2 * i], uv[2 * i + 1]), (float2)(0.25f, 0.0f), (float2)(0.0f, 0.5f));
    in.position = unchanging((float3)(position[3 * i], position[3 * i + 1], position[3 * i + 2]));
    in.normal = (float3)(normal[3 * i], normal[3 * i + 1], normal[3 * i + 2]);
    Maps maps = { 0, 0, 0, 0 };
    float out[15];
    for (uint k = 0; k < channels; k++)
        out[k] = -1.0f;
    evaluate_graph(graph, &in, &maps, out);
    for (uint k = 0; k < channels; k++)
        values[channels * i + k] = out[k];
}
"""


def load(text: str, folder: Path) -> CompiledGraph:
    path = folder / "test.graph"
    path.write_text(text)
    return clcache.graph.load(path)


def run(device: Device, source: str, graph: int, channels: int, inputs: dict[str, np.ndarray]) -> np.ndarray:
    program = device.program("test.cl", {"test.cl": KERNEL, "graph/generated.cl": source})
    n = len(inputs["uv"])
    values = device.empty((n, channels), np.float32)
    program["run"](
        *(device.upload(inputs[k]) for k in ("uv", "position", "normal")), values, graph, channels, n, count=n
    )
    return values.get()


@pytest.fixture
def inputs() -> dict[str, np.ndarray]:
    draw = np.random.default_rng(1)
    return {
        k: draw.uniform(-2, 2, (100, c)).astype(np.float32) for k, c in {"uv": 2, "position": 3, "normal": 3}.items()
    }


@given(graphs())
def test_every_variable_is_written_once_before_it_is_read(graph: Graph) -> None:
    prepared = prepare(graph, NODES)
    try:
        compiled = CompiledGraph(prepared, infer(prepared, NODES))
    except clcache.SceneError:
        return
    body = emit([compiled]).split("void graph_0(")[1].split("{")[1].split("}")[0]
    statements = [line.strip() for line in body.splitlines() if line.strip()]
    declared = [s for s in statements if s.split()[0] in TYPES]
    names = [name for s in declared for name in re.findall(r"\bv\d+\b", s)]
    assert len(names) == len(set(names))
    written: set[str] = set()
    for statement in statements[len(declared) :]:
        new = re.findall(r"&(v\d+)\b", statement)
        read = set(re.findall(r"(?<!&)\bv\d+\b", statement))
        assert read <= written
        assert not written & set(new) and len(new) == len(set(new))
        written |= set(new)
    assert written == set(names)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_literals_are_exact(value: float) -> None:
    text = literal(value)
    assert re.fullmatch(r"-?0x[01](\.[0-9a-f]+)?p[-+]\d+f", text)
    assert np.float32(float.fromhex(text[:-1])).tobytes() == np.float32(value).tobytes()


def test_literals_are_the_nearest_floats() -> None:
    assert float.fromhex(literal(0.1)[:-1]) == float(np.float32(0.1))


def test_literals_on_the_device(device: Device) -> None:
    bits = np.random.default_rng(2).integers(0, 2**32, 500, dtype=np.uint32)
    values = np.concatenate([bits.view(np.float32), np.float32([0.0, -0.0, 3.4028235e38, -1.17549435e-38, 0.1, 1 / 3])])
    values = values[np.isfinite(values) & ((values == 0) | (np.abs(values) >= np.finfo(np.float32).tiny))]
    table = ", ".join(map(literal, values.tolist()))
    source = f"""__constant float values[] = {{ {table} }};
    __kernel void copy(__global float *out,  // (n)
        uint n) {{ if (get_global_id(0) < n) out[get_global_id(0)] = values[get_global_id(0)]; }}"""
    out = device.empty(len(values), np.float32)
    device.program("test.cl", {"test.cl": source})["copy"](out, len(values), count=len(values))
    assert out.get().tobytes() == values.tobytes()


def test_listing_5_1_computes_what_it_says(device: Device, tmp_path: Path, inputs: dict) -> None:
    graph = load(
        "Mul A<0 B<1 Out>2; ColorOutput In<3; Add A<1 B<2 Out>3; Float1Constant 0.5 Out>1; NormalInput Out>0;", tmp_path
    )
    assert (graph.outputs, graph.reads, graph.cost, graph.channels) == ({"base_color": 3}, {"normal"}, 3, 3)
    expected = np.float32(0.5) + inputs["normal"] * np.float32(0.5)
    assert np.array_equal(run(device, graph.source, 0, 3, inputs), expected)
    assert np.array_equal(graph.evaluate(**inputs)["base_color"], expected)


def test_graphs_of_a_scene_share_functions_and_are_told_apart(device: Device, tmp_path: Path, inputs: dict) -> None:
    first = load(
        "NormalInput Out>0; PositionInput Out>1; Add A<0 B<1 Out>2; ColorOutput In<2; NormalOutput In<0;", tmp_path
    )
    second = load(
        "PositionInput Out>0; Add A<0 B<0 Out>1; Separate3 In<1 Y>2; EmissionOutput In<0; MetallicOutput In<2;",
        tmp_path,
    )
    source = emit([first, second])
    assert source.count("NODE void Add(") == source.count("NODE void PositionInput(") == 1
    assert "float3_D" not in source
    normal, position = inputs["normal"], inputs["position"]
    assert np.array_equal(run(device, source, 0, 6, inputs), np.hstack([normal + position, normal]))
    assert np.array_equal(run(device, source, 1, 4, inputs), np.hstack([2 * position[:, 1:2], position]))
    assert (run(device, source, 2, 4, inputs) == -1).all()  # no such graph: nothing is written


def test_conversions(device: Device, tmp_path: Path, inputs: dict) -> None:
    """Numbers repeated, alpha added and dropped, derivatives made of nothing, dropped, and kept where they are needed."""
    text = """UVInput Out>0; PositionInput Out>1; Separate3 In<1 X>2 Y>3;
    Combine4 X<2 Y<3 Z<2 W<3 Out>4; Add A<4 B<1 Out>5; Separate4 In<5 W>6; RoughnessOutput In<6;
    Add A<2 B<1 Out>7; ColorOutput In<7;
    Float1Constant 3 Out>8; Separate2 In<0 X>9; Mul A<9 B<8 Out>10; Float1Constant 1 Out>11;
    HeightToNormal Height<10 Scale<11 UV<0 Out>12; EmissionOutput In<12;"""
    graph = load(text, tmp_path)
    x, y, _ = inputs["position"].T
    outputs = run(device, graph.source, 0, 7, inputs)
    assert np.array_equal(outputs[:, 3], y + 1)
    assert np.array_equal(outputs[:, :3], x[:, None] + inputs["position"])
    changes = {"duv_dx": np.tile(np.float32([0.25, 0]), (100, 1)), "duv_dy": np.tile(np.float32([0, 0.5]), (100, 1))}
    evaluated = graph.evaluate(**inputs, **changes)
    assert np.allclose(outputs, np.hstack([evaluated[k] for k in ("base_color", "roughness", "emission")]), rtol=1e-5)
    slope = 3 / 16
    normal = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
    assert np.allclose(outputs[:, 4:], 0.5 + 0.5 * normal, rtol=1e-5)


def test_values_that_are_not_finite_are_0(device: Device, tmp_path: Path, inputs: dict) -> None:
    text = "PositionInput Out>0; Float1Constant 1e38 Out>1; Mul A<0 B<1 Out>2; Add A<2 B<2 Out>3; ColorOutput In<3;"
    graph = load(text, tmp_path)
    overflows = np.abs(inputs["position"].astype(np.float64)) * 2e38 > 3.4028235e38
    values = run(device, graph.source, 0, 3, inputs)
    assert overflows.any() and np.array_equal(values == 0, overflows)
    assert np.array_equal(values, graph.evaluate(**inputs)["base_color"])


def test_a_constant_normal_is_an_output(device: Device, tmp_path: Path, inputs: dict) -> None:
    graph = load("Float3Constant 0 0.6 0.8 Out>0; NormalOutput In<0;", tmp_path)
    assert (graph.outputs, graph.reads, graph.cost) == ({"normal": 3}, frozenset(), 0)
    assert (run(device, graph.source, 0, 3, inputs) == np.float32([0, 0.6, 0.8])).all()
    assert (graph.evaluate(**inputs)["normal"] == np.float32([0, 0.6, 0.8])).all()


def test_constant_outputs_are_the_material_s(tmp_path: Path) -> None:
    graph = load(
        """Float1Constant 0.25 Out>0; Float4Constant 1 2 3 4 Out>1; Float3Constant 0 0 1 Out>2; RoughnessOutput In<0;
        ColorOutput In<0; EmissionOutput In<1; NormalOutput In<2;""",
        tmp_path,
    )
    constants = {"base_color": (0.25, 0.25, 0.25), "roughness": 0.25, "emission": (1.0, 2.0, 3.0)}
    assert (graph.outputs, graph.graph.constants) == ({}, constants)


def test_equal_nodes_are_called_once(tmp_path: Path) -> None:
    graph = load(
        """PositionInput Out>0; PositionInput Out>1; Float1Constant 0 Out>2; Float1Constant 0.0 Out>3; Float1Constant -0 Out>4;
        Max A<0 B<2 Out>5; Max B<3 A<1 Out>6; Max A<0 B<4 Out>7; Add A<5 B<6 Out>8; Add A<8 B<7 Out>9; ColorOutput In<9;""",
        tmp_path,
    )
    assert [node.kind for node in graph.graph.nodes] == ["PositionInput", "Max", "Add", "Max", "Add"]


def test_textures_have_the_scene_s_numbers(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        Image.new("RGB", (1, 1)).save(tmp_path / name)
    text = """UVInput Out>0; Image "unused.png" srgb UV<0 Out>1; Image "a.png" srgb UV<0 Out>2; Image "b.png" linear UV<0 Out>3;
    Add A<2 B<3 Out>4; ColorOutput In<4;"""
    graph = load(text, tmp_path)
    assert [t.file for t in graph.graph.textures] == ["a.png", "b.png"]
    assert [file.name for file in graph.files] == ["a.png", "b.png"]
    calls = re.findall(r"Image\(maps, (\d+), ", emit([graph, graph], [(7, 0), (3, 9)]))
    assert calls == ["7", "0", "3", "9"]
    assert re.findall(r"Image\(maps, (\d+), ", graph.source) == ["0", "1"]


def test_headers_only_of_what_is_used(tmp_path: Path) -> None:
    plain = load("PositionInput Out>0; ColorOutput In<0;", tmp_path).source
    noisy = load("PositionInput Out>0; Noise3D Position<0 Out>1; ColorOutput In<1;", tmp_path).source
    assert "noise.cl" not in plain and noisy.count("noise.cl") == 1


def test_arrays_of_other_shapes_are_refused(tmp_path: Path) -> None:
    graph = load("PositionInput Out>0; ColorOutput In<0;", tmp_path)
    with pytest.raises(ValueError, match=r"position and its changes have the shape \(4, 3\), not \(5, 3\)"):
        graph.evaluate(np.zeros((4, 2)), position=np.zeros((5, 3)))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_built_and_vary(device: Device, path: Path, inputs: dict) -> None:
    graph = clcache.graph.load(path)
    program = device.program("test.cl", {"test.cl": KERNEL, "graph/generated.cl": graph.source})
    assert [kernel.signature.name for kernel in program]
    values = graph.evaluate(**inputs)
    assert list(values) == list(graph.outputs)
    assert any(np.ptp(v) > 0.05 for v in values.values())
