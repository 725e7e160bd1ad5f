"""Builds small glTF files byte by byte, so that tests decide every offset, count and type themselves."""

import base64
import json
import struct
from pathlib import Path

import numpy as np

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


class Gltf:
    """A document with one buffer; `json` may be changed at will before it is written."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.json: dict = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
        }

    def view(self, data: bytes, **extra: object) -> int:
        """Append bytes as a buffer view; returns its index."""
        self.data += bytes(-len(self.data) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **extra})
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: object, kind: str, dtype: str = "f4", **extra: object) -> int:
        """Append an array as an accessor with a view of its own; returns its index."""
        array = np.ascontiguousarray(values, "<" + dtype)
        entry = {"bufferView": self.view(array.tobytes()), "componentType": COMPONENTS[dtype], "count": len(array)}
        self.json["accessors"].append({**entry, "type": kind, **extra})
        return len(self.json["accessors"]) - 1

    def primitive(self, positions: object = TRIANGLE, indices: object = None, **extra: object) -> dict:
        """A primitive of float positions and, if given, 32-bit indices."""
        primitive = {"attributes": {"POSITION": self.accessor(positions, "VEC3")}, **extra}
        if indices is not None:
            primitive["indices"] = self.accessor(np.ravel(indices), "SCALAR", "u4")
        return primitive

    def mesh(self, *primitives: dict, name: str = "thing") -> int:
        self.json["meshes"].append({"name": name, "primitives": list(primitives)})
        return len(self.json["meshes"]) - 1

    def write(self, path: Path) -> Path:
        """Write a .gltf with its buffer as a data URI, or a .glb."""
        buffer: dict = {"byteLength": len(self.data)}
        if path.suffix == ".gltf":
            buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        document = {"buffers": [buffer] if self.data else [], **self.json}
        text = json.dumps(document).encode()
        path.write_bytes(text if path.suffix == ".gltf" else glb(text, bytes(self.data)))
        return path


def glb(text: bytes, data: bytes) -> bytes:
    """The container of JSON and one binary chunk."""
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
