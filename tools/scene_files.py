"""What the scripts of this folder write: glTF documents with their binary buffers, and TOML scene files.

Every number that is written is rounded, so that a last-bit difference between two machines' sine does not change a file.
"""

import argparse
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from painting import Texture
from shapes import Surface, merged

DATA = Path(__file__).parents[1] / "data"


def output_folder(description: str, name: str) -> Path:
    """The folder that a script writes to, made: data/NAME, or what the command line says."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DATA / name, help="folder to write to")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    return out


def write_text(path: Path, text: str) -> None:
    """A text file, the same on every system."""
    path.write_text(text, encoding="utf-8", newline="\n")


def rounded(values) -> np.ndarray:
    """Rounded to 1e-5, as float32, without negative zeros."""
    return (np.round(np.asarray(values, dtype=float), 5) + 0.0).astype(np.float32)


# ---------------------------------------------------------------------------------------------------------------------
# TOML


def numbers(values: Iterable[float], digits: int = 4) -> str:
    """A TOML list of rounded numbers."""
    return "[" + ", ".join(str(round(float(v), digits) + 0.0) for v in values) + "]"


def key_frames(times: Iterable[float], **columns: Iterable) -> str:
    """The line `keys = [...]` of a table, one inline table to a line: its time and a value, or a vector, of each column."""
    text = "keys = [\n"
    for time, *row in zip(times, *columns.values(), strict=True):
        text += f"  {{ time = {round(float(time), 4)}"
        for name, value in zip(columns, row, strict=True):
            text += f", {name} = {value if isinstance(value, str) else numbers(value)}"
        text += " },\n"
    return text + "]\n"


# ---------------------------------------------------------------------------------------------------------------------
# glTF


@dataclass(frozen=True)
class Material:
    """A glTF material. color: multiplied with its texture. texture, surface, normals: names of textures with base colour,
    with metallic (blue) and roughness (green), with tangent-space normals. cutoff: there is no surface where the texture's
    alpha is below. specular 0 leaves a Lambertian surface. solid: what is transmitted is refracted into a body. emission:
    radiance."""

    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: str | None = None
    roughness: float = 1.0
    metallic: float = 0.0
    surface: str | None = None
    normals: str | None = None
    cutoff: float | None = None
    specular: float = 1.0
    transmission: float = 0.0
    solid: bool = False
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def textures(self) -> list[str]:
        """The names of its textures; all of them cover the same metres."""
        return [name for name in (self.texture, self.surface, self.normals) if name]


class Gltf:
    """A glTF 2.0 document with one binary buffer, built up mesh by mesh and node by node.

    quantum: positions and texture coordinates are stored as whole multiples of it, in 16 bits, and normals in 8
    (KHR_mesh_quantization); None stores float32 throughout.
    """

    def __init__(
        self, script: str, materials: dict[str, Material], textures: dict[str, Texture], quantum: float | None = None
    ) -> None:
        self.materials, self.textures, self.quantum = materials, textures, quantum
        self.binary = bytearray()
        self.document: dict = {
            "asset": {"version": "2.0", "generator": f"clcache tools/{script}"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
        }
        self._add_materials()

    def _add_materials(self) -> None:
        """All materials with their textures, which repeat."""
        if self.textures:
            self.document["samplers"] = [{"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}]
            self.document["images"] = [
                {"name": name, "uri": f"textures/{name}.{texture.format}"} for name, texture in self.textures.items()
            ]
            self.document["textures"] = [
                {"name": name, "sampler": 0, "source": i} for i, name in enumerate(self.textures)
            ]
        self.document["materials"] = [self._material(name, m) for name, m in self.materials.items()]
        used = {"KHR_mesh_quantization"} if self.quantum else set()
        if self.quantum and any(m.textures for m in self.materials.values()):
            used.add("KHR_texture_transform")
        used |= {name for entry in self.document["materials"] for name in entry.get("extensions", {})}
        if used:
            self.document["extensionsUsed"] = sorted(used)
        if self.quantum:
            self.document["extensionsRequired"] = sorted(used & {"KHR_mesh_quantization", "KHR_texture_transform"})

    def _use(self, name: str) -> dict:
        use: dict = {"index": list(self.textures).index(name)}
        if self.quantum:
            scale = round(self.quantum / self.textures[name].metres, 9)
            use["extensions"] = {"KHR_texture_transform": {"scale": [scale, scale]}}
        return use

    def _material(self, name: str, material: Material) -> dict:
        surface: dict = {
            "baseColorFactor": [*material.color, 1.0],
            "metallicFactor": material.metallic,
            "roughnessFactor": material.roughness,
        }
        if material.texture:
            surface["baseColorTexture"] = self._use(material.texture)
        if material.surface:
            surface["metallicRoughnessTexture"] = self._use(material.surface)
        entry: dict = {"name": name, "pbrMetallicRoughness": surface, "doubleSided": True}
        if material.normals:
            entry["normalTexture"] = self._use(material.normals)
        if material.cutoff is not None:
            entry |= {"alphaMode": "MASK", "alphaCutoff": material.cutoff}
        extensions: dict = {}
        if material.specular != 1.0:
            extensions["KHR_materials_specular"] = {"specularFactor": material.specular}
        if material.transmission:
            extensions["KHR_materials_transmission"] = {"transmissionFactor": material.transmission}
        if material.solid:
            extensions["KHR_materials_volume"] = {"thicknessFactor": 1.0}
        strength = max(material.emission)
        if strength:
            entry["emissiveFactor"] = [round(float(v) / strength, 5) for v in material.emission]
            extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
        if extensions:
            entry["extensions"] = extensions
        return entry

    def _accessor(
        self, values: np.ndarray, target: int, bounds: bool = False, normalized: bool = False, aligned: bool = False
    ) -> int:
        """An accessor on the (n,) or (n, 2 or 3) values; aligned: the rows are padded to a multiple of 4 bytes."""
        codes = {np.int8: 5120, np.int16: 5122, np.uint16: 5123, np.uint32: 5125, np.float32: 5126}
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        rows = np.ascontiguousarray(values)
        stride = -(-rows[0].nbytes // 4) * 4
        if aligned:
            padded = np.zeros((len(rows), stride // rows.itemsize), rows.dtype)
            padded[:, : rows.shape[1]] = rows
            rows = padded
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": rows.nbytes, "target": target}
        if aligned:
            view["byteStride"] = stride
        self.document["bufferViews"].append(view)
        accessor = {
            "bufferView": len(self.document["bufferViews"]) - 1,
            "componentType": codes[values.dtype.type],
            "count": len(values),
            "type": "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}",
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.binary.extend(rows.tobytes())
        self.document["accessors"].append(accessor)
        return len(self.document["accessors"]) - 1

    def _primitive(self, surface: Surface) -> dict:
        names = self.materials[surface.material].textures
        uvs = surface.uvs
        if self.quantum:
            vertices = np.round(np.concatenate([surface.positions, uvs], axis=1) / self.quantum)
            vertices = np.concatenate([vertices[:, :3], np.round(surface.normals * 127.0), vertices[:, 3:]], axis=1)
            if not names:
                vertices[:, 6:] = 0.0
            vertices = vertices + 0.0
            assert np.abs(vertices).max() < 32768, surface.material
        else:
            uvs = uvs / (self.textures[names[0]].metres if names else 1.0)
            vertices = rounded(np.concatenate([surface.positions, surface.normals, uvs], axis=1))
        vertices, index = np.unique(vertices, axis=0, return_inverse=True)
        triangles = index.reshape(-1)[surface.triangles]
        corners = vertices[triangles, :3].astype(float)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        triangles = triangles[area > 1e-9]  # rounding may have closed some
        indices = triangles.reshape(-1).astype(np.uint16 if len(vertices) < 65536 else np.uint32)
        return {
            "attributes": self._attributes(vertices, bool(names)),
            "indices": self._accessor(indices, 34963),
            "material": list(self.materials).index(surface.material),
        }

    def _attributes(self, vertices: np.ndarray, textured: bool) -> dict:
        positions, normals, uvs = vertices[:, :3], vertices[:, 3:6], vertices[:, 6:]
        if not self.quantum:
            return {
                "POSITION": self._accessor(positions, 34962, bounds=True),
                "NORMAL": self._accessor(normals, 34962),
                "TEXCOORD_0": self._accessor(uvs, 34962),
            }
        attributes = {
            "POSITION": self._accessor(positions.astype(np.int16), 34962, bounds=True, aligned=True),
            "NORMAL": self._accessor(normals.astype(np.int8), 34962, normalized=True, aligned=True),
        }
        if textured:
            attributes["TEXCOORD_0"] = self._accessor(uvs.astype(np.int16), 34962, aligned=True)
        return attributes

    def mesh(self, name: str, surfaces: list[Surface]) -> int:
        """A mesh with one primitive for each material that its surfaces use; returns its index."""
        used = [m for m in self.materials if any(s.material == m for s in surfaces)]
        primitives = [self._primitive(merged([s for s in surfaces if s.material == m])) for m in used]
        self.document["meshes"].append({"name": name, "primitives": primitives})
        return len(self.document["meshes"]) - 1

    def node(
        self,
        name: str,
        parent: int | None = None,
        mesh: int | None = None,
        at=(0.0, 0.0, 0.0),
        turn: float = 0.0,
        scale: float = 1.0,
    ) -> int:
        """A node at `at`, turned by `turn` degrees about +Y, under `parent` or at the root; returns its index.

        Under a node with a mesh there must be no other if the document is quantised, as that node's scale holds the quantum.
        """
        node: dict = {"name": name}
        if mesh is not None:
            node["mesh"] = mesh
            scale *= self.quantum or 1.0
        if any(at):
            node["translation"] = [round(float(v), 5) for v in at]
        if turn:
            half = np.radians(turn) / 2
            node["rotation"] = [0.0, round(float(np.sin(half)), 9), 0.0, round(float(np.cos(half)), 9)]
        if scale != 1.0:
            node["scale"] = [round(float(scale), 5 if not self.quantum else 9)] * 3
        nodes = self.document["nodes"]
        nodes.append(node)
        siblings = self.document["scenes"][0]["nodes"] if parent is None else nodes[parent].setdefault("children", [])
        siblings.append(len(nodes) - 1)
        return len(nodes) - 1

    def write(self, path: Path) -> None:
        """PATH (JSON, without line breaks if quantised) and the binary buffer beside it."""
        binary = path.with_suffix(".bin")
        self.document["buffers"] = [{"uri": binary.name, "byteLength": len(self.binary)}]
        binary.write_bytes(self.binary)
        write_text(path, json.dumps(self.document, indent=None if self.quantum else 1) + "\n")
