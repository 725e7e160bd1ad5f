"""OBJ, PLY, STL, OFF and whatever else trimesh reads, except glTF; trimesh parses the file, and reads no other file."""

import io
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.load import mesh_formats
from trimesh.resolvers import Resolver

from ..errors import SceneError
from .files import Folder, read_bytes
from .model import NO_TEXTURE, Instance, Material, Texture
from .mtl import MtlMaterial, read_mtl
from .part import Part
from .textures import read_picture
from .validate import check_transform, make_mesh

FORMATS = tuple(sorted(mesh_formats() - {"gltf", "glb"}))

# What trimesh and the decoders under it raise on damaged input; anything else is a defect of ours.
_DAMAGE = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, NotImplementedError, OSError, SyntaxError,
    TypeError, ValueError,
)  # fmt: skip


class _NamesOnly(Resolver):
    """Gives trimesh, instead of an MTL file, one that only declares names; it has no other file to give."""

    def __init__(self, names: list[str]) -> None:
        self._stub = "".join(f"newmtl {name}\n" for name in names).encode()

    def get(self, key: str) -> bytes:
        return self._stub

    def write(self, name: str, data: bytes) -> None:
        raise OSError("a scene is only read")

    def namespaced(self, namespace: str) -> "_NamesOnly":
        return self

    def keys(self) -> list[str]:
        return []


def load_mesh_file(path: Path, name: str, folder: Folder) -> Part:
    """Read a mesh file that trimesh knows. name: the file as messages call it. Raises SceneError."""
    kind = path.suffix.lower().lstrip(".")
    data = read_bytes(path, name)
    part = Part()
    indices = {}
    if kind == "obj":
        text = data.decode("utf-8", "replace")
        _check_obj(text, name)
        indices = _add_materials(part, _obj_materials(text, path, name, folder), path, folder)
    default = len(part.materials)
    part.materials.append(Material("default"))
    for geometry_name, geometry, transform in _geometries(data, kind, name, list(indices), part):
        mesh_name = geometry_name or name
        material = indices.get(_material_name(geometry), default)
        normals = geometry._cache.cache.get("vertex_normals")  # only those of the file; the property would invent some
        uvs = getattr(geometry.visual, "uv", None)
        if uvs is not None:
            uvs = np.asarray(uvs, np.float64)[:, :2] * [1, -1] + [0, 1]
        mesh = make_mesh(
            name, mesh_name, geometry.vertices.view(np.ndarray), geometry.faces.view(np.ndarray), material,
            part.dropped, normals, uvs,
        )  # fmt: skip
        if mesh is not None:
            part.instances.append(Instance(mesh_name, len(part.meshes), check_transform(f"{name}: {mesh_name}", transform)))
            part.meshes.append(mesh)
    return part


def _geometries(
    data: bytes, kind: str, name: str, materials: list[str], part: Part
) -> Iterator[tuple[str, trimesh.Trimesh, np.ndarray]]:
    """Name, mesh and (3, 4) transform of everything in the file that has triangles."""
    try:
        with np.errstate(all="ignore"):
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, resolver=_NamesOnly(materials), process=False)
        placed = [(node, *scene.graph[node]) for node in scene.graph.nodes_geometry]
    except MemoryError:
        raise SceneError(f"{name}: damaged: it declares more elements than memory can hold") from None
    except ImportError as error:
        raise SceneError(f"{name}: reading .{kind} files needs a package that is not installed ({error})") from None
    except _DAMAGE as error:
        raise SceneError(f"{name}: not a readable .{kind} file ({_one_line(error)})") from None
    for _, matrix, geometry_name in placed:
        geometry = scene.geometry[geometry_name]
        if isinstance(geometry, trimesh.Trimesh):
            yield geometry_name, geometry, matrix[:3]
        else:
            part.dropped["points and lines"] += len(getattr(geometry, "vertices", ()))
    coloured = sum(getattr(g.visual, "kind", None) in ("vertex", "face") for g in scene.geometry.values())
    if coloured:
        part.notes.append(f"{name}: {coloured} meshes have vertex or face colours, which are left out")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def _material_name(geometry: trimesh.Trimesh) -> str | None:
    return getattr(getattr(geometry.visual, "material", None), "name", None)


def _obj_materials(text: str, path: Path, name: str, folder: Folder) -> dict[str, MtlMaterial]:
    """The materials of all libraries that an OBJ file names."""
    materials: dict[str, MtlMaterial] = {}
    for match in re.finditer(r"^mtllib[ \t]+(.+?)\s*$", text, re.MULTILINE):
        line = text.count("\n", 0, match.start()) + 1
        library = folder.find(match[1], path, f"{name}:{line}: mtllib")
        materials |= read_mtl(library, match[1])
    return materials


def _add_materials(part: Part, materials: dict[str, MtlMaterial], path: Path, folder: Folder) -> dict[str, int]:
    """Add the materials with their textures; returns their indices by name."""
    textures: dict[tuple[Path, bool], int] = {}
    for name, material in materials.items():
        texture = NO_TEXTURE
        if material.picture:
            file = folder.find(material.picture, path, material.where)
            key = (file, material.clamp)
            if key not in textures:
                wrap = ("clamp", "clamp") if material.clamp else ("repeat", "repeat")
                textures[key] = len(part.textures)
                part.textures.append(Texture(material.picture, read_picture(file, f"{material.where}: {material.picture!r}"), wrap))
            texture = textures[key]
        part.materials.append(Material(name, material.base_color, texture, material.emission))
    approximated = sum(material.approximated for material in materials.values())
    if approximated:
        part.notes.append(
            f"{path.name}: {approximated} materials with transparency, metalness or mirroring are rendered as Lambertian"
        )
    return {name: index for index, name in enumerate(materials)}


def _check_obj(text: str, name: str) -> None:
    """Refuse faces whose indices trimesh would misread: it takes 0 for the first vertex and drops uvs out of range."""
    faces = re.findall(r"^[ \t]*f[ \t]+(.*)$", text, re.MULTILINE)
    corners = " ".join(faces)
    references = {
        "v": re.findall(r"(?<!\S)(-?\d+)", corners),
        "vt": re.findall(r"(?<!\S)-?\d+/(-?\d+)", corners),
        "vn": re.findall(r"(?<!\S)-?\d+/-?\d*/(-?\d+)", corners),
    }
    for kind, words in references.items():
        if not words:
            continue
        declared = [match.start() for match in re.finditer(rf"^{kind}[ \t]", text, re.MULTILINE)]
        indices = np.fromstring(" ".join(words), np.int64, sep=" ")
        bad = (indices == 0) | (np.abs(indices) > len(declared))
        if bad.any():
            first = int(np.argmax(bad))
            raise SceneError(
                f"{name}: faces: {kind} reference {first} is {indices[first]}; expected 1 .. {len(declared)}, or negative"
            )
        if indices.min() < 0 and declared[-1] > re.search(r"^[ \t]*f[ \t]", text, re.MULTILINE).start():
            raise SceneError(
                f"{name}: faces count {kind} backwards (negative indices) amid the {kind} lines; "
                "export the file with positive indices"
            )
