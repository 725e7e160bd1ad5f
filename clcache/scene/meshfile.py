"""OBJ, PLY, STL, OFF and whatever else trimesh reads, except glTF; trimesh parses the file, and reads no other file."""

import io
import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from trimesh.exchange.load import mesh_formats
from trimesh.resolvers import Resolver

from ..errors import SceneError
from .files import Folder, read_bytes
from .model import Instance, Material, Texture, TextureUse
from .mtl import MapStatement, MtlMaterial, read_mtl, to_material
from .part import Part
from .textures import read_picture
from .validate import check_transform, make_mesh

# Without a handler, Python prints the library's warnings, with the tracebacks of what it tried, to standard error.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

FORMATS = tuple(sorted(mesh_formats() - {"gltf", "glb"}))


# Where a header declares the number of faces.
_FACE_COUNT = {"off": rb"OFF\s+\d+\s+(\d+)", "ply": rb"element face[ \t]+(\d+)"}


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
    part = Part(materials=[Material("default")])
    named: dict[str, int] = {}
    if kind == "obj":
        text = _plain_obj(data.decode("utf-8", "replace"))
        data = text.encode()
        _check_obj(text, name)
        named = _add_materials(part, _obj_materials(text, path, name, folder), folder, name)
    elif kind == "ply":
        _add_ply_texture(part, data, path, name, folder)
    scene = _read(data, kind, name, list(named))
    if kind in _FACE_COUNT:
        _check_count(data, _FACE_COUNT[kind], scene, name)
    meshes = {
        key: _add_mesh(part, geometry, key or name, name, named)
        for key, geometry in scene.geometry.items()
        if _has_triangles(geometry, part)
    }
    for node in scene.graph.nodes_geometry:
        matrix, key = scene.graph[node]
        if meshes.get(key) is not None:
            transform = check_transform(f"{name}: {node}", matrix[:3])
            part.instances.append(Instance(str(node), meshes[key], transform))
    return part


def _read(data: bytes, kind: str, name: str, materials: list[str]) -> trimesh.Scene:
    try:
        with np.errstate(all="ignore"):
            return trimesh.load_scene(
                io.BytesIO(data),
                file_type=kind,
                resolver=_NamesOnly(materials),
                process=False,
                **({"skip_materials": True} if kind == "ply" else {}),
            )
    except MemoryError:
        raise SceneError(f"{name}: damaged: it declares more elements than memory can hold") from None
    except ImportError as error:
        raise SceneError(f"{name}: reading .{kind} files needs a package that is not installed ({error})") from None
    except Exception as error:  # on damaged input, a parser may raise anything
        raise SceneError(f"{name}: not a readable .{kind} file ({_one_line(error)})") from None


def _has_triangles(geometry: object, part: Part) -> bool:
    if isinstance(geometry, trimesh.Trimesh):
        return True
    part.dropped["points and lines"] += len(getattr(geometry, "vertices", ()))
    return False


def _add_mesh(part: Part, geometry: trimesh.Trimesh, mesh_name: str, name: str, named: dict[str, int]) -> int | None:
    """Add a mesh; returns its index, or None if it has no triangle with an area."""
    material = named.get(getattr(getattr(geometry.visual, "material", None), "name", None), 0)
    normals = geometry._cache.cache.get("vertex_normals")  # only those of the file; the property would invent some
    uvs = getattr(geometry.visual, "uv", None)
    if uvs is not None:
        uvs = np.asarray(uvs, np.float64)[:, :2] * [1, -1] + [0, 1]  # v counts from the picture's last row
    if getattr(geometry.visual, "kind", None) in ("vertex", "face"):
        part.notes.append(f"{name}: the colours of {geometry.visual.kind} elements are left out")
    vertices, faces = geometry.vertices.view(np.ndarray), geometry.faces.view(np.ndarray)
    mesh = make_mesh(name, mesh_name, vertices, faces, material, part.dropped, normals, uvs)
    if mesh is None:
        return None
    part.meshes.append(mesh)
    return len(part.meshes) - 1


def _add_ply_texture(part: Part, data: bytes, path: Path, name: str, folder: Folder) -> None:
    """Give the default material the texture that a PLY header's comment names."""
    header = data[: max(data.find(b"end_header"), 0)]
    comment = re.search(rb"^comment TextureFile[ \t]+(.+?)\s*$", header, re.MULTILINE | re.IGNORECASE)
    if comment is not None:
        reference = comment[1].decode("utf-8", "replace")
        file = folder.find(reference, path, f"{name}: TextureFile")
        part.textures.append(Texture(reference, read_picture(file, f"{name}: TextureFile {reference!r}")))
        part.materials[0] = Material("default", (1.0, 1.0, 1.0), TextureUse(0))


def _check_count(data: bytes, declaration: bytes, scene: trimesh.Scene, name: str) -> None:
    """Refuse a file that ends early, which trimesh reads as a smaller mesh without a word."""
    found = re.search(declaration, re.sub(rb"#.*", b"", data))
    declared = int(found[1]) if found is not None else 0
    read = sum(len(geometry.faces) for geometry in scene.geometry.values() if isinstance(geometry, trimesh.Trimesh))
    if read < declared:
        raise SceneError(f"{name}: truncated: {read} triangles, but the header says {declared} faces")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def _obj_materials(text: str, path: Path, name: str, folder: Folder) -> dict[str, MtlMaterial]:
    """The materials of all libraries that an OBJ file names."""
    materials: dict[str, MtlMaterial] = {}
    for match in re.finditer(r"^mtllib[ \t]+(.+?)\s*$", text, re.MULTILINE):
        line = text.count("\n", 0, match.start()) + 1
        library = folder.find(match[1], path, f"{name}:{line}: mtllib")
        materials |= read_mtl(library, match[1])
    return materials


def _add_materials(part: Part, materials: dict[str, MtlMaterial], folder: Folder, name: str) -> dict[str, int]:
    """Add the materials with their textures; returns their indices by name."""
    textures: dict[tuple, int] = {}

    def use(
        beside: Path, statement: MapStatement | None, srgb: bool, mask: MapStatement | None = None
    ) -> TextureUse | None:
        source = statement or mask
        if source is None:
            return None
        file = folder.find(statement.picture, beside, statement.where) if statement else None
        mask_file = folder.find(mask.picture, beside, mask.where) if mask else None
        key = (file, mask_file, srgb, source.clamp)
        if key not in textures:
            pixels = None if file is None else read_picture(file, f"{statement.where}: {statement.picture!r}")
            if mask_file is not None:
                pixels = _masked(pixels, read_picture(mask_file, f"{mask.where}: {mask.picture!r}"))
            wrap = ("clamp", "clamp") if source.clamp else ("repeat", "repeat")
            textures[key] = len(part.textures)
            part.textures.append(Texture(source.picture, pixels, srgb, wrap))
        return TextureUse(textures[key], source.transform)

    indices = {}
    for key, mtl in materials.items():
        indices[key] = len(part.materials)
        material = to_material(key, mtl)
        lit = mtl.maps.get("map_ke")
        part.materials.append(
            replace(
                material,
                base_color_texture=use(mtl.file, mtl.maps.get("map_kd"), True, mtl.maps.get("map_d")),
                emission_texture=use(mtl.file, lit, True),
                emission=(1.0, 1.0, 1.0) if lit and "ke" not in mtl.colors else material.emission,
                normal_texture=use(mtl.file, mtl.maps.get("norm"), False),
            )
        )
    for what in sorted(set().union(*(mtl.unread for mtl in materials.values()))):
        count = sum(what in mtl.unread for mtl in materials.values())
        part.notes.append(f"{name}: {count} materials have {what}, which is left out")
    return indices


def _masked(colors: np.ndarray | None, mask: np.ndarray) -> np.ndarray:
    """Colours (white, if None) with the mask as alpha: its own alpha if it has any, else its brightness."""
    alpha = mask[..., 3] if mask[..., 3].min() < 255 else mask[..., :3].max(axis=2)
    if colors is None:
        return np.dstack([np.full((*alpha.shape, 3), 255, np.uint8), alpha])
    if colors.shape[:2] != alpha.shape:
        alpha = np.asarray(Image.fromarray(alpha).resize((colors.shape[1], colors.shape[0]), Image.Resampling.BILINEAR))
    return np.dstack([colors[..., :3], alpha])


def _plain_obj(text: str) -> str:
    """The text as trimesh wants it: no continued lines, no indentation, no comments behind numbers."""
    text = re.sub(r"\\\r?\n", " ", text)
    text = re.sub(r"^[ \t]+", "", text, flags=re.MULTILINE)
    return re.sub(r"^((?:v|vt|vn|f)[ \t][^#\n]*)#.*$", r"\1", text, flags=re.MULTILINE)


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
