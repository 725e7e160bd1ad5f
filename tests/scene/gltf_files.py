"""glTF files for tests: one triangle, and what a test adds to it."""

import base64
import json
from pathlib import Path

import numpy as np
from PIL import Image


class GltfFile:
    """A document with a triangle that has positions, texture coordinates 0 and 1, and a node; tests edit `document`."""

    def __init__(self) -> None:
        self._data = bytearray()
        self.document = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
        }
        uvs = self.accessor(np.array([[0, 0], [1, 0], [0, 1]]), "VEC2")
        attributes = {
            "POSITION": self.accessor(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), "VEC3"),
            "TEXCOORD_0": uvs,
            "TEXCOORD_1": self.accessor(np.array([[5, 5], [6, 5], [5, 6]]), "VEC2"),
        }
        self.document["meshes"].append({"primitives": [{"attributes": attributes}]})

    def accessor(self, values: np.ndarray, kind: str) -> int:
        """Append float values; returns the accessor's index."""
        data = np.asarray(values, "<f4").tobytes()
        self.document["bufferViews"].append({"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)})
        self._data += data
        view = len(self.document["bufferViews"]) - 1
        self.document["accessors"].append(
            {"bufferView": view, "componentType": 5126, "count": len(values), "type": kind}
        )
        return len(self.document["accessors"]) - 1

    def material(self, **fields) -> None:
        """Give the triangle a material."""
        self.document["materials"] = [fields]
        self.document["meshes"][0]["primitives"][0]["material"] = 0

    def pictures(self, folder: Path, count: int) -> None:
        """`count` textures of one colour each, each of its own picture."""
        for index in range(count):
            Image.new("RGBA", (2, 2), (10 * index, 20, 30, 100)).save(folder / f"{index}.png")
        self.document["images"] = [{"uri": f"{index}.png"} for index in range(count)]
        self.document["textures"] = [{"source": index} for index in range(count)]

    def animate(self, *channels: tuple[int, str, list, list, str]) -> None:
        """An animation of these channels: node, path, times, values, interpolation."""
        animation = {"channels": [], "samplers": []}
        for index, (node, path, times, values, interpolation) in enumerate(channels):
            animation["channels"].append({"sampler": index, "target": {"node": node, "path": path}})
            kind = "VEC4" if path == "rotation" else "VEC3"
            sampler = {
                "input": self.accessor(np.array(times)[:, None], "SCALAR"),
                "output": self.accessor(np.array(values), kind),
            }
            self.document["accessors"][sampler["input"]]["type"] = "SCALAR"
            animation["samplers"].append(sampler | {"interpolation": interpolation})
        self.document.setdefault("animations", []).append(animation)

    def write(self, path: Path) -> Path:
        """Write the file; returns its path."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(self._data)).decode()
        self.document["buffers"] = [{"byteLength": len(self._data), "uri": uri}]
        path.write_text(json.dumps(self.document))
        return path
