"""Materials by graph, made without a document."""

from clcache.graph import OUTPUTS, Graph, GraphTexture, Link, Node, compile_graph
from clcache.scene.model import Material, TextureUse

PLACE = "test"


def by_graph(*outputs: str, scale: float = 3.0, offset: float = 0.0, textures: int = 0, **fields) -> Material:
    """A material of which a graph computes these outputs, as a number that follows the scaled texture coordinates, and begins with
    `offset`; with `textures`, the base colour is that and the sum of so many pictures. fields: of the material."""
    nodes = [
        Node("UVInput", {}, {}, PLACE),
        Node("Mul", {"A": Link(0, "Out"), "B": (scale,)}, {}, PLACE),
        Node("Fract", {"In": Link(1, "Out")}, {}, PLACE),
        Node("Dot", {"A": Link(2, "Out"), "B": (0.5, 0.25)}, {}, PLACE),
        Node("Add", {"A": Link(3, "Out"), "B": (offset,)}, {}, PLACE),
        *(Node("Image", {"UV": Link(0, "Out")}, {"Texture": k}, PLACE) for k in range(textures)),
    ]
    found = dict.fromkeys(outputs, Link(4, "Out"))
    for k in range(textures):
        sum_before = Link(4 if k == 0 else len(nodes) - 1, "Out")
        nodes.append(Node("Add", {"A": sum_before, "B": Link(5 + k, "Out")}, {}, PLACE))
        found["base_color"] = Link(len(nodes) - 1, "Out")
    pictures = tuple(GraphTexture(f"{k}.png", True, ("repeat", "repeat"), PLACE) for k in range(textures))
    uses = tuple(TextureUse(k) for k in range(textures))
    assert found.keys() <= OUTPUTS.keys()
    graph = compile_graph(Graph("test", tuple(nodes), found, pictures, {}))
    return Material("by graph", graph=graph, graph_textures=uses, **fields)
