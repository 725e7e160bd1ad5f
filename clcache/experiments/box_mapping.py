"""Texture coordinates for glTF meshes that have none: each triangle is seen along the axis that it faces the most.

Coordinates are in the units of the positions. A vertex of triangles that face several axes is doubled.
"""

import json
from pathlib import Path

import numpy as np

# By component type, and by type.
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
UV = "TEXCOORD_0"
SEEN = np.array([[2, 1], [0, 2], [0, 1]])  # the axes that are u and v, by the one that is looked along


class BoxMapped:
    """A glTF file of one binary buffer, whose primitives all get texture coordinates. `mapped`: how many had none."""

    def __init__(self, file: Path) -> None:
        self.document = json.loads(file.read_text(encoding="utf-8"))
        (buffer,) = self.document["buffers"]
        self.binary = bytearray((file.parent / buffer["uri"]).read_bytes())
        primitives = [p for mesh in self.document["meshes"] for p in mesh["primitives"]]
        bare = [p for p in primitives if UV not in p["attributes"]]
        for primitive in bare:
            self._map(primitive)
        self.mapped = len(bare)

    def _map(self, primitive: dict) -> None:
        attributes = {name: self._read(index) for name, index in primitive["attributes"].items()}
        positions = attributes["POSITION"]
        triangles = self._read(primitive["indices"]).reshape(-1, 3).astype(np.int64)
        a, b, c = (positions[triangles[:, k]].astype(float) for k in range(3))
        axis = np.abs(np.cross(b - a, c - a)).argmax(axis=1)
        used, corners = np.unique(3 * triangles + axis[:, None], return_inverse=True)
        vertex, axes = used // 3, SEEN[used % 3]
        attributes = {name: values[vertex] for name, values in attributes.items()}
        attributes[UV] = np.take_along_axis(positions[vertex], axes, axis=1)
        kept = {name: self.document["accessors"][index] for name, index in primitive["attributes"].items()}
        primitive["attributes"] = {
            name: self._append(values, 34962, kept.get(name, {}), bounds=name == "POSITION")
            for name, values in attributes.items()
        }
        primitive["indices"] = self._append(corners.reshape(-1, 1).astype(np.uint32), 34963, {})

    def _read(self, index: int) -> np.ndarray:
        accessor = self.document["accessors"][index]
        view = self.document["bufferViews"][accessor["bufferView"]]
        kind, width = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]]
        first = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        strides = (view.get("byteStride", width * kind.itemsize), kind.itemsize)
        return np.ndarray((accessor["count"], width), kind, self.binary, first, strides).copy()

    def _append(self, values: np.ndarray, target: int, like: dict, bounds: bool = False) -> int:
        """An accessor on a copy of the values; rows of attributes are padded to a multiple of 4 bytes."""
        row = values[0].nbytes
        stride = -(-row // 4) * 4
        padded = np.zeros((len(values), stride), np.uint8)
        padded[:, :row] = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), row)
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": padded.nbytes, "target": target}
        if target == 34962:
            view["byteStride"] = stride
        self.binary.extend(padded.tobytes())
        self.document["bufferViews"].append(view)
        accessor = {
            "bufferView": len(self.document["bufferViews"]) - 1,
            "componentType": next(c for c, name in COMPONENTS.items() if np.dtype(name) == values.dtype),
            "count": len(values),
            "type": next(t for t, width in WIDTHS.items() if width == values.shape[1]),
        }
        if like.get("normalized"):
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.document["accessors"].append(accessor)
        return len(self.document["accessors"]) - 1

    def write(self, file: Path) -> None:
        """Write the document, and its buffer beside it."""
        (buffer,) = self.document["buffers"]
        buffer["byteLength"] = len(self.binary)
        (file.parent / buffer["uri"]).write_bytes(self.binary)
        file.write_text(json.dumps(self.document) + "\n", encoding="utf-8", newline="\n")
