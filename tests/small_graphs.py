"""Random small graphs over a few kinds of nodes, whose overloads are of all sorts."""

from hypothesis import strategies as st

from clcache.graph.library import parse
from clcache.graph.model import Graph, Link, Node

NODES = parse(
    """
NODE void UV(const GraphInputs *in, float2 *Out) {}
NODE void UV(const GraphInputs *in, float2_D *Out) {}

NODE void Normal(const GraphInputs *in, float3 *Out) {}

NODE void Image(float2_D UV, float4 *Out) {}
NODE void Image(float2_D UV, float4_D *Out) {}

NODE void Noise(float2 UV, float *Out) {}
NODE void Noise(float3 UV, float *Out) {}
NODE void Noise(float3_D UV, float_D *Out) {}

// for T in float float2 float3
NODE void Add(T A, T B, T *Out) {}
NODE void Add(T_D A, T_D B, T_D *Out) {}

// for T in float2 float3
NODE void Dot(T A, T B, float *Out) {}

// for T in float2 float3 float4
NODE void Parts(T A, T *Same, float *First) {}
NODE void Parts(T_D A, T_D *Same, float *First) {}
""",
    "test.cl",
)


@st.composite
def graphs(draw: st.DrawFn, most: int = 5) -> Graph:
    """Nodes that read earlier ones, or constants of 1 to 4 numbers; the last ones are outputs."""
    nodes: list[Node] = []
    sources: list[Link] = []
    for number in range(draw(st.integers(2, most))):
        kind = draw(st.sampled_from(sorted(NODES) if sources else ["Normal", "UV"]))
        constants = st.integers(1, 4).map(lambda width: (0.5,) * width)
        links = st.sampled_from(sources) if sources else st.nothing()
        inputs = {socket: draw(st.one_of(links, links, constants)) for socket in NODES[kind][0].inputs}
        nodes.append(Node(kind, inputs, {}, f"test.graph:{number + 1}: {kind}"))
        sources += [Link(number, socket) for socket in NODES[kind][0].outputs]
    outputs = {"base_color": sources[-1]} | {
        output: draw(st.sampled_from(sources))
        for output in draw(st.sets(st.sampled_from(["roughness", "specular_color", "emission"])))
    }
    return Graph("test.graph", tuple(nodes), outputs)
