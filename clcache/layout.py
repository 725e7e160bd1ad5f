"""The structs that host and kernels share: declared here as NumPy dtypes, emitted as OpenCL C into every program.

Every field is a 4-byte scalar or an array of them, so that no compiler has a reason to pad; the emitted text makes the
device's compiler prove it: an array of negative size stops the build where a size or an offset differs.
"""

import numpy as np

_C_TYPES = {"f4": "float", "u4": "uint", "i4": "int"}


def _struct(*fields: tuple[str, str] | tuple[str, str, int]) -> np.dtype:
    return np.dtype(list(fields))


STRUCTS: dict[str, np.dtype] = {
    # A pinhole camera; `slope` is the tangent of half the field of view in x and in y.
    "Camera": _struct(("to_world", "f4", 12), ("slope", "f4", 2), ("near", "f4"), ("width", "u4"), ("height", "u4")),
    # A pair of clusters in the making of a tree, left and right by their numbers: their common box; how many triangles are
    # below (with a flag where they become a leaf); what the subtree costs in 1 .. 7 places of a node, and an unused number.
    "Cluster": _struct(
        ("low", "f4", 3), ("left", "u4"), ("high", "f4", 3), ("right", "u4"), ("costs", "f4", 7), ("triangles", "u4")
    ),
    # A cluster that is to be put below others: its box, the high sides negated, its number and how many triangles it holds.
    "Item": _struct(("low", "f4", 3), ("cluster", "u4"), ("minus_high", "f4", 3), ("triangles", "u4")),
    # A node of a tree with up to eight children, packed at the front. `planes`: six rows, one for each side of the children's
    # boxes: low x, high x, low y, high y, low z, high z; an unused slot has low = inf, high = -inf. `child`: references: the
    # number of a node if not negative; else ~(block << 3 | count - 1), a leaf of `count` triangles in one block, or, in the
    # tree over the instances, ~(placed mesh << 3).
    "Node": _struct(("planes", "f4", 48), ("child", "i4", 8)),
    # Up to eight triangles. `positions`: nine rows: x, y, z of the first corners, of the second, of the third; NaN in unused
    # lanes. `triangle`: their numbers among the triangles of all placed meshes; NONE in unused lanes.
    "Block": _struct(("positions", "f4", 72), ("triangle", "u4", 8)),
    # A placed mesh: its transforms (3x4, row-major), object-space bounds, the root of its tree as a child is named in
    # Node, and where its triangles begin among those of all meshes. `number`: which of the scene's instances it is; NONE
    # if it stands for several.
    "Instance": _struct(
        ("to_world", "f4", 12),
        ("to_object", "f4", 12),
        ("low", "f4", 3),
        ("high", "f4", 3),
        ("root", "i4"),
        ("first_triangle", "u4"),
        ("number", "u4"),
    ),
    # A surface (`scene.model.Material`). The maps are indices of TextureUse, or -1. `emitter_density` is the chance per
    # square metre that a sample of the lights falls on it. `graph`: the number of its graph, or -1; `outputs`: which of the
    # graph's values, of one channel each, is the first of base colour, metallic, roughness, specular, specular colour,
    # emission and normal, or -1 where the graph does not drive that.
    "Material": _struct(
        ("base_color", "f4", 3),
        ("alpha", "f4"),
        ("alpha_cutoff", "f4"),
        ("metallic", "f4"),
        ("roughness", "f4"),
        ("specular", "f4"),
        ("specular_color", "f4", 3),
        ("ior", "f4"),
        ("transmission", "f4"),
        ("thin", "u4"),
        ("emission", "f4", 3),
        ("normal_scale", "f4"),
        ("double_sided", "u4"),
        ("emitter_density", "f4"),
        ("base_color_map", "i4"),
        ("metallic_roughness_map", "i4"),
        ("emission_map", "i4"),
        ("normal_map", "i4"),
        ("graph", "i4"),
        ("outputs", "i4", 7),
    ),
    # A texture as a material uses it; `transform`: 2x3, row-major, of texture coordinates.
    "TextureUse": _struct(("texture", "u4"), ("transform", "f4", 6)),
    # Where each mip level of a picture begins among the texels of all pictures; a level is half as wide and high as the one
    # before, rounded down, but at least 1. `wrap` of u and v: 0 repeat, 1 clamp, 2 mirror.
    "Texture": _struct(
        ("first_texel", "u4", 32),
        ("width", "u4"),
        ("height", "u4"),
        ("levels", "u4"),
        ("wrap", "u4", 2),
        ("srgb", "u4"),
    ),
    # Something that is sampled for direct light. `kind`: 0 point or spot, 1 directional, 2 triangle, 3 environment.
    # A triangle is named by instance and primitive; its first corner in the world is `position`, the edges from there are
    # `direction` and `power`, and cone[0] is the sign of its normal against their cross product. `direction`: of a spot's
    # axis; towards a directional light. `power`: intensity or irradiance. `cone`: a spot's intensity is clamp(cosine *
    # cone[0] + cone[1]) squared; a point's cone is 0, 1.
    "Emitter": _struct(
        ("kind", "u4"),
        ("instance", "u4"),
        ("primitive", "u4"),
        ("material", "u4"),
        ("position", "f4", 3),
        ("direction", "f4", 3),
        ("power", "f4", 3),
        ("cone", "f4", 2),
    ),
    # The environment's picture, and the chance that a sample of the lights is taken from it.
    "Environment": _struct(("width", "u4"), ("height", "u4"), ("chance", "f4")),
    # The cube that an octree divides: from `origin`, `size` metres along each axis. `finest`: the number of its finest level, which
    # has 2^finest cells along an edge; level 0 is the whole cube.
    "OctreeShape": _struct(("origin", "f4", 3), ("size", "f4"), ("finest", "u4")),
}


def source() -> str:
    """All structs as OpenCL C typedefs, each followed by the checks of its size and offsets."""
    return "\n".join(_emit(name, dtype) for name, dtype in STRUCTS.items())


def _emit(name: str, dtype: np.dtype) -> str:
    fields, checks = [], [f"typedef char size_of_{name}[sizeof({name}) == {dtype.itemsize} ? 1 : -1];"]
    for field, (kind, offset) in ((f, dtype.fields[f][:2]) for f in dtype.names):
        length = f"[{kind.shape[0]}]" if kind.shape else ""
        fields.append(f"    {_C_TYPES[kind.base.str[1:]]} {field}{length};")
        checks.append(f"typedef char {name}_{field}[__builtin_offsetof({name}, {field}) == {offset} ? 1 : -1];")
    return "\n".join([f"typedef struct {name} {{", *fields, f"}} {name};", *checks, ""])
