"""Node implementations as the library reads them."""

import pytest

from clcache.graph.library import library, merge, parse


def test_templates_sockets_and_what_nodes_need() -> None:
    nodes = parse(
        """// Nodes for a test.
// needs noise.cl other.cl

// In either width.
// for T in float float3
NODE void Mix(const Maps *maps, int Index, T A, float Part, T *Out, T_D *Other)
{
    T a = A;  // } is no end here
    if (Part > 0) { *Out = a; }
}
NODE void Mix(const Maps *maps, int Index, T_D A, float Part, T *Out, T_D *Other) { Total(A); }

NODE void Plain(const GraphInputs *in, float2 *Out) {}
""",
        "test.cl",
    )
    first, second, third, fourth = nodes["Mix"]
    assert [o.inputs["A"] for o in nodes["Mix"]] == ["float", "float3", "float_D", "float3_D"]
    assert second.parameters == ("maps", "Index", "A", "Part", "Out", "Other")
    assert (second.inputs, second.integers) == ({"A": "float3", "Part": "float"}, ("Index",))
    assert second.outputs == {"Out": "float3", "Other": "float3_D"}
    assert second.source == (
        "NODE void Mix(const Maps *maps, int Index, float3 A, float Part, float3 *Out, float3_D *Other)\n{\n"
        "    float3 a = A;  // } is no end here\n    if (Part > 0) { *Out = a; }\n}"
    )
    assert third.source.endswith("{ Total(A); }") and first.needs == fourth.needs == ("noise.cl", "other.cl")
    assert nodes["Plain"][0].parameters == ("in", "Out") and len(nodes["Plain"]) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("NODE void A(double X, float *Out) {}", "test.cl: node A: parameter X has the type double"),
        ("NODE void A(uint *X, float *Out) {}", r"test.cl: node A: parameter X has the type uint\*"),
        ("NODE void A(float X[2], float *Out) {}", "test.cl: node A: parameter 'float X\\[2\\]' is not of the form"),
        ("NODE void A(float X) {\n{ }\n", "test.cl: node A: its body does not end"),
        ("static float helper(float x) {}", "test.cl: expected a NODE function, found 'static float helper"),
        (
            "NODE void A(float X) {}\nNODE void A(float3 Y) {}",
            "node A: its overloads differ in their sockets or integers",
        ),
        ("NODE void A(float X) {}\nNODE void A(float X) {}", "node A: two overloads have the same types"),
    ],
)
def test_what_breaks_the_form(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse(text, "test.cl")


def test_a_kind_belongs_to_one_file() -> None:
    nodes = parse("NODE void A(float X) {}", "test.cl")
    with pytest.raises(ValueError, match="node A is declared in two files"):
        merge([nodes, nodes])


def test_the_package_s_nodes_are_read() -> None:
    assert {"Add", "Mix", "Image", "UVInput", "PositionInput", "NormalInput"} <= library().keys()
    assert library() is library()
