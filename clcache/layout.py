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
    # An inner node of a binary tree: the boxes of both children. `count` is 0 where `child` is a node; else the child is
    # a leaf of `count` primitives, `child` the place of the first in the tree's order.
    "Node": _struct(("low", "f4", 6), ("high", "f4", 6), ("child", "u4", 2), ("count", "u4", 2)),
    # A placed mesh: its transforms (3x4, row-major), object-space bounds, the root of its tree as a child is named in
    # Node, and where its triangles begin among those of all meshes.
    "Instance": _struct(
        ("to_world", "f4", 12),
        ("to_object", "f4", 12),
        ("low", "f4", 3),
        ("high", "f4", 3),
        ("root", "u4"),
        ("root_count", "u4"),
        ("first_triangle", "u4"),
    ),
    # `texture` is an index into the textures, or -1.
    "Material": _struct(("base_color", "f4", 3), ("texture", "i4"), ("emission", "f4", 3)),
    # Where a picture's texels begin among those of all pictures. `wrap` of u and v: 0 repeat, 1 clamp, 2 mirror.
    "Texture": _struct(("first_texel", "u4"), ("width", "u4"), ("height", "u4"), ("wrap", "u4", 2)),
    # `vector` is the position of a point light (kind 0), the direction towards a directional one (kind 1).
    "Light": _struct(("vector", "f4", 3), ("kind", "u4"), ("power", "f4", 3)),
}


def source() -> str:
    """All structs as OpenCL C typedefs, each followed by the checks of its size and offsets."""
    return "\n".join(_emit(name, dtype) for name, dtype in STRUCTS.items())


def _emit(name: str, dtype: np.dtype) -> str:
    fields, checks = [], [f"typedef char {name}_size[sizeof({name}) == {dtype.itemsize} ? 1 : -1];"]
    for field, (kind, offset) in ((f, dtype.fields[f][:2]) for f in dtype.names):
        length = f"[{kind.shape[0]}]" if kind.shape else ""
        fields.append(f"    {_C_TYPES[kind.base.str[1:]]} {field}{length};")
        checks.append(f"typedef char {name}_{field}[__builtin_offsetof({name}, {field}) == {offset} ? 1 : -1];")
    return "\n".join([f"typedef struct {name} {{", *fields, f"}} {name};", *checks, ""])
