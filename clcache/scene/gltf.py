"""glTF 2.0 and GLB files, read directly: a general mesh library loses emissive strength and invents normals.

The JSON is checked by a schema; every length and index that it gives is checked against what it refers to before anything
is allocated for it. Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html (section numbers below).
"""

import base64
import binascii
import json
import math
import struct
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import unquote

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from ..errors import SceneError
from .files import Folder, read_bytes
from .model import NO_TEXTURE, Camera, DirectionalLight, Instance, Material, PointLight, Texture
from .part import Part, place_light
from .textures import decode_picture, read_picture
from .transform import compose, rigid, rotation_matrix
from .validate import check_transform, make_mesh

# Extensions that a file may require: the first three are read; those of materials only change how a surface scatters.
_READ_EXTENSIONS = ("KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_mesh_quantization")
_MATERIAL_EXTENSIONS = "KHR_materials_"

# An accessor without a buffer view holds zeros that no file pays for; a file that has more of them is a bomb.
_MOST_ZEROS = 1 << 24

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_WRAPS = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6

Index = Annotated[int, Field(ge=0, le=2**31 - 1)]
Size = Annotated[int, Field(ge=1, le=2**53)]
Offset = Annotated[int, Field(ge=0, le=2**53)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(ge=0, le=1e30)]
Three = Annotated[list[float], Field(min_length=3, max_length=3)]
ComponentType = Literal[5120, 5121, 5122, 5123, 5125, 5126]


class _Object(BaseModel):
    """A glTF object; properties that are not read here are ignored."""

    model_config = ConfigDict(alias_generator=to_camel, extra="ignore", strict=True, allow_inf_nan=False, frozen=True)
    name: str = ""
    extensions: dict[str, Any] = {}


class _Buffer(_Object):
    byte_length: Size
    uri: str | None = None


class _BufferView(_Object):
    buffer: Index
    byte_length: Size
    byte_offset: Offset = 0
    byte_stride: Annotated[int, Field(ge=4, le=252)] | None = None


class _SparseIndices(_Object):
    buffer_view: Index
    component_type: Literal[5121, 5123, 5125]
    byte_offset: Offset = 0


class _SparseValues(_Object):
    buffer_view: Index
    byte_offset: Offset = 0


class _Sparse(_Object):
    count: Size
    indices: _SparseIndices
    values: _SparseValues


class _Accessor(_Object):
    component_type: ComponentType
    count: Size
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    buffer_view: Index | None = None
    byte_offset: Offset = 0
    normalized: bool = False
    sparse: _Sparse | None = None


class _Primitive(_Object):
    attributes: dict[str, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: Annotated[int, Field(ge=0, le=6)] = _TRIANGLES
    targets: list[Any] = []


class _Mesh(_Object):
    primitives: Annotated[list[_Primitive], Field(min_length=1)]


class _TextureInfo(_Object):
    index: Index
    tex_coord: Index = 0


class _Pbr(_Object):
    base_color_factor: Annotated[list[Fraction], Field(min_length=4, max_length=4)] = [1.0, 1.0, 1.0, 1.0]
    base_color_texture: _TextureInfo | None = None
    metallic_factor: Fraction = 1.0
    roughness_factor: Fraction = 1.0


class _Material(_Object):
    pbr_metallic_roughness: _Pbr = _Pbr()
    emissive_factor: Annotated[list[Positive], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    emissive_texture: _TextureInfo | None = None
    normal_texture: _TextureInfo | None = None
    alpha_mode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"


class _EmissiveStrength(_Object):
    emissive_strength: Positive = 1.0


class _Texture(_Object):
    sampler: Index | None = None
    source: Index | None = None


class _Sampler(_Object):
    wrap_s: Literal[33071, 33648, 10497] = 10497
    wrap_t: Literal[33071, 33648, 10497] = 10497


class _Image(_Object):
    uri: str | None = None
    buffer_view: Index | None = None


class _Perspective(_Object):
    yfov: Annotated[float, Field(gt=0, lt=math.pi)]
    znear: Annotated[float, Field(gt=0, le=1e18)]


class _Camera(_Object):
    type: Literal["perspective", "orthographic"]
    perspective: _Perspective | None = None


class _Light(_Object):
    type: Literal["point", "directional", "spot"]
    color: Annotated[list[Positive], Field(min_length=3, max_length=3)] = [1.0, 1.0, 1.0]
    intensity: Positive = 1.0


class _Lights(_Object):
    lights: list[_Light] = []


class _LightReference(_Object):
    light: Index


class _Node(_Object):
    children: list[Index] = []
    mesh: Index | None = None
    camera: Index | None = None
    skin: Index | None = None
    matrix: Annotated[list[float], Field(min_length=16, max_length=16)] | None = None
    translation: Three = [0.0, 0.0, 0.0]
    rotation: Annotated[list[float], Field(min_length=4, max_length=4)] = [0.0, 0.0, 0.0, 1.0]
    scale: Three = [1.0, 1.0, 1.0]


class _Scene(_Object):
    nodes: list[Index] = []


class _Asset(_Object):
    version: str
    min_version: str | None = None


class _Document(_Object):
    asset: _Asset
    scene: Index = 0
    scenes: list[_Scene] = []
    nodes: list[_Node] = []
    meshes: list[_Mesh] = []
    materials: list[_Material] = []
    accessors: list[_Accessor] = []
    buffer_views: list[_BufferView] = []
    buffers: list[_Buffer] = []
    images: list[_Image] = []
    samplers: list[_Sampler] = []
    textures: list[_Texture] = []
    cameras: list[_Camera] = []
    animations: list[Any] = []
    extensions_required: list[str] = []


Checked = TypeVar("Checked", bound=_Object)
Item = TypeVar("Item")


@dataclass
class _File:
    """An open file: its JSON, the GLB's binary chunk, and what was read of it so far."""

    path: Path
    name: str
    folder: Folder
    document: _Document
    chunk: memoryview | None
    buffers: dict[int, memoryview] = field(default_factory=dict)
    pictures: dict[int, np.ndarray] = field(default_factory=dict)

    def error(self, place: str, message: str) -> SceneError:
        return SceneError(f"{self.name}: {place}: {message}")

    def item(self, items: list[Item], index: int, place: str, what: str) -> Item:
        if index >= len(items):
            raise self.error(place, f"refers to {what}[{index}]; the file has {len(items)}")
        return items[index]


def load_gltf(path: Path, name: str, folder: Folder) -> Part:
    """Read the default scene of a glTF or GLB file. name: the file as messages call it. Raises SceneError."""
    text, chunk = _split_glb(read_bytes(path, name), name)
    file = _File(path, name, folder, _parse(text, name), chunk)
    _check_extensions(file)
    part = Part()
    _add_materials(file, part)
    meshes: dict[int, int | None] = {}
    for place, node, transform in _walk(file):
        if node.mesh is not None:
            if node.mesh not in meshes:
                meshes[node.mesh] = _add_mesh(file, part, node.mesh, place)
            if meshes[node.mesh] is not None:
                here = check_transform(f"{name}: {place}", transform)
                part.instances.append(
                    Instance(node.name or part.meshes[meshes[node.mesh]].name, meshes[node.mesh], here)
                )
        if node.camera is not None and part.camera is None:
            part.camera = _camera(file, part, node.camera, place, transform)
        if "KHR_lights_punctual" in node.extensions:
            _add_light(file, part, node, place, transform)
    _note_node_features(file, part)
    return part


def _split_glb(data: bytes, name: str) -> tuple[bytes, memoryview | None]:
    """JSON and binary chunk of a GLB file (4.4); a file that is no GLB is JSON as a whole."""
    if data[:4] != b"glTF":
        return data, None
    if len(data) < 20:
        raise SceneError(f"{name}: truncated: {len(data)} bytes; a GLB file has at least 20")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise SceneError(f"{name}: GLB version {version}; expected 2")
    if length > len(data):
        raise SceneError(f"{name}: truncated: {len(data)} bytes, but the header says {length}")
    chunks: dict[bytes, memoryview] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<I4s", data, at)
        if at + 8 + size > length:
            raise SceneError(f"{name}: truncated: the chunk at byte {at} has {size} bytes, {length - at - 8} are left")
        chunks.setdefault(kind, memoryview(data)[at + 8 : at + 8 + size])
        at += 8 + size
    if b"JSON" not in chunks:
        raise SceneError(f"{name}: the GLB file has no JSON chunk")
    return bytes(chunks[b"JSON"]), chunks.get(b"BIN\0")


def _parse(text: bytes, name: str) -> _Document:
    try:
        data = json.loads(text.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise SceneError(f"{name}:{error.lineno}: not valid JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{name}: not valid JSON: {error}") from None
    if not isinstance(data, dict):
        raise SceneError(f"{name}: not a glTF file; expected a JSON object")
    return _checked(_Document, data, name)


def _checked(kind: type[Checked], data: Any, where: str) -> Checked:
    try:
        return kind.model_validate(data)
    except ValidationError as failure:
        error = failure.errors(include_url=False)[0]
    place = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in error["loc"]).lstrip(".")
    shown = "" if isinstance(error["input"], dict | list) else f"{str(error['input'])[:80]!r} is wrong; "
    raise SceneError(f"{where}: {place}: {shown}{error['msg'].replace('Input should be', 'expected')}")


def _check_extensions(file: _File) -> None:
    asset = file.document.asset
    if not (asset.min_version or asset.version).startswith("2."):
        raise file.error("asset", f"glTF version {asset.min_version or asset.version}; expected 2.x")
    for extension in file.document.extensions_required:
        if extension not in _READ_EXTENSIONS and not extension.startswith(_MATERIAL_EXTENSIONS):
            raise file.error("extensionsRequired", f"{extension} is not supported; export the file without it")


# Nodes


def _walk(file: _File) -> list[tuple[str, _Node, np.ndarray]]:
    """Every node of the default scene, parents first: its place in the file, itself, its (3, 4) transform to the world."""
    document = file.document
    if document.scenes:
        roots = file.item(document.scenes, document.scene, "scene", "scenes").nodes
    else:
        children = {child for node in document.nodes for child in node.children}
        roots = [index for index in range(len(document.nodes)) if index not in children]
    found = []
    seen = set()
    waiting = [(index, np.eye(4)[:3]) for index in reversed(roots)]
    while waiting:
        index, outer = waiting.pop()
        place = f"nodes[{index}]"
        node = file.item(document.nodes, index, "the node hierarchy", "nodes")
        if index in seen:
            raise file.error(place, "is reached twice; the node hierarchy must be a tree")
        seen.add(index)
        transform = compose(outer, _local_transform(file, node, place))
        found.append((place, node, transform))
        waiting += [(child, transform) for child in reversed(node.children)]
    return found


def _local_transform(file: _File, node: _Node, place: str) -> np.ndarray:
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T[:3]
    if not any(node.rotation):
        raise file.error(place, "rotation is 0, 0, 0, 0; expected a unit quaternion")
    return np.column_stack([rotation_matrix(node.rotation) * node.scale, node.translation])


def _camera(file: _File, part: Part, index: int, place: str, transform: np.ndarray) -> Camera | None:
    camera = file.item(file.document.cameras, index, place, "cameras")
    if camera.perspective is None:
        part.notes.append(f"{file.name}: the orthographic camera {camera.name!r} is left out")
        return None
    pose = rigid(check_transform(f"{file.name}: {place}", transform))
    return Camera(pose, camera.perspective.yfov, camera.perspective.znear)


def _add_light(file: _File, part: Part, node: _Node, place: str, transform: np.ndarray) -> None:
    where = f"{file.name}: {place}: KHR_lights_punctual"
    index = _checked(_LightReference, node.extensions["KHR_lights_punctual"], where).light
    declared = file.document.extensions.get("KHR_lights_punctual", {})
    lights = _checked(_Lights, declared, f"{file.name}: extensions.KHR_lights_punctual").lights
    light = file.item(lights, index, place, "lights")
    strength = tuple(light.intensity * c for c in light.color)
    transform = check_transform(f"{file.name}: {place}", transform)
    if light.type == "point":
        part.lights.append(place_light(PointLight((0.0, 0.0, 0.0), strength), transform))
    elif light.type == "directional":
        part.lights.append(place_light(DirectionalLight((0.0, 0.0, -1.0), strength), transform))
    else:
        part.dropped["spot lights"] += 1


def _note_node_features(file: _File, part: Part) -> None:
    document = file.document
    features = {
        "spot lights are left out": part.dropped["spot lights"],
        "animations are not played": len(document.animations),
        "skinned meshes stand in their rest pose": sum(node.skin is not None for node in document.nodes),
        "meshes with morph targets keep their base shape": sum(
            any(p.targets for p in mesh.primitives) for mesh in document.meshes
        ),
        "meshes have vertex colours, which are left out": sum(
            any("COLOR_0" in p.attributes for p in mesh.primitives) for mesh in document.meshes
        ),
    }
    part.notes += [f"{file.name}: {count} {what}" for what, count in features.items() if count]
    part.dropped += Counter()  # forgets the kinds that were never counted


# Materials


def _add_materials(file: _File, part: Part) -> None:
    """Materials in the file's order, then the default one (3.9.6) for primitives that name none."""
    textures: dict[tuple[int, tuple[str, str]], int] = {}
    for index, material in enumerate(file.document.materials):
        place = f"materials[{index}]"
        pbr = material.pbr_metallic_roughness
        strength = 1.0
        if "KHR_materials_emissive_strength" in material.extensions:
            extension = material.extensions["KHR_materials_emissive_strength"]
            where = f"{file.name}: {place}: KHR_materials_emissive_strength"
            strength = _checked(_EmissiveStrength, extension, where).emissive_strength
        texture = NO_TEXTURE
        if pbr.base_color_texture is not None:
            texture = _add_texture(file, part, textures, pbr.base_color_texture.index, f"{place}.baseColorTexture")
        emission = tuple(strength * e for e in material.emissive_factor)
        part.materials.append(Material(material.name or place, tuple(pbr.base_color_factor[:3]), texture, emission))
    part.materials.append(Material("default", (1.0, 1.0, 1.0)))
    _note_materials(file, part)


def _note_materials(file: _File, part: Part) -> None:
    materials = file.document.materials
    features = {
        "materials with metalness, roughness below 1, transmission or other extensions are rendered as Lambertian": sum(
            m.pbr_metallic_roughness.metallic_factor > 0
            or m.pbr_metallic_roughness.roughness_factor < 1
            or any(e.startswith(_MATERIAL_EXTENSIONS) for e in m.extensions if e not in _READ_EXTENSIONS)
            for m in materials
        ),
        "normal maps are left out": sum(m.normal_texture is not None for m in materials),
        "emissive textures are left out; the emissive factor holds all over": sum(
            m.emissive_texture is not None and any(m.emissive_factor) for m in materials
        ),
        "materials with transparency are rendered opaque": sum(m.alpha_mode != "OPAQUE" for m in materials),
        "texture transforms are left out": sum(
            info is not None and "KHR_texture_transform" in info.extensions
            for info in (m.pbr_metallic_roughness.base_color_texture for m in materials)
        ),
    }
    part.notes += [f"{file.name}: {count} {what}" for what, count in features.items() if count]


def _add_texture(
    file: _File, part: Part, textures: dict[tuple[int, tuple[str, str]], int], index: int, place: str
) -> int:
    """The index in the part of a glTF texture; the same picture with the same wrap modes is one texture."""
    texture = file.item(file.document.textures, index, place, "textures")
    if texture.source is None:
        raise file.error(f"textures[{index}]", "has no source that can be read; expected a PNG or JPEG picture")
    sampler = _Sampler()
    if texture.sampler is not None:
        sampler = file.item(file.document.samplers, texture.sampler, f"textures[{index}]", "samplers")
    wrap = (_WRAPS[sampler.wrap_s], _WRAPS[sampler.wrap_t])
    key = (texture.source, wrap)
    if key not in textures:
        image = file.item(file.document.images, texture.source, f"textures[{index}]", "images")
        name = image.name or (
            image.uri if image.uri and not image.uri.startswith("data:") else f"images[{texture.source}]"
        )
        textures[key] = len(part.textures)
        part.textures.append(Texture(name, _picture(file, texture.source, image), wrap))
    return textures[key]


def _picture(file: _File, index: int, image: _Image) -> np.ndarray:
    if index not in file.pictures:
        place = f"images[{index}]"
        where = f"{file.name}: {place}"
        if image.uri is None:
            if image.buffer_view is None:
                raise file.error(place, "has neither uri nor bufferView")
            file.pictures[index] = decode_picture(bytes(_view(file, image.buffer_view, place)[0]), where)
        elif image.uri.startswith("data:"):
            file.pictures[index] = decode_picture(_decode_data_uri(file, image.uri, place), where)
        else:
            uri = unquote(image.uri)
            file.pictures[index] = read_picture(file.folder.find(uri, file.path, where), f"{where}: {uri!r}")
    return file.pictures[index]


# Meshes


@dataclass
class _Arrays:
    """The vertices of a mesh while its primitives are joined."""

    positions: list[np.ndarray] = field(default_factory=list)
    normals: list[np.ndarray] = field(default_factory=list)
    uvs: list[np.ndarray] = field(default_factory=list)
    count: int = 0
    has_normals: bool = False
    has_uvs: bool = False


def _add_mesh(file: _File, part: Part, index: int, place: str) -> int | None:
    """Join a mesh's primitives into one `Mesh`; None if it has no triangle with an area."""
    mesh = file.item(file.document.meshes, index, place, "meshes")
    name = mesh.name or f"meshes[{index}]"
    arrays = _Arrays()
    first_vertex: dict[tuple[int | None, ...], int] = {}
    triangles, material = [], []
    for number, primitive in enumerate(mesh.primitives):
        place = f"meshes[{index}].primitives[{number}]"
        if primitive.mode < _TRIANGLES:
            part.dropped["primitives made of points or lines"] += 1
            continue
        which = len(part.materials) - 1
        if primitive.material is not None:
            file.item(file.document.materials, primitive.material, place, "materials")
            which = primitive.material
        key = _vertex_key(file, primitive, which)
        if key not in first_vertex:
            first_vertex[key] = arrays.count
            _append_vertices(file, arrays, key, place)
        vertex_count = file.document.accessors[key[0]].count
        corners = _triangles(file, primitive, vertex_count, place)
        triangles.append(corners + first_vertex[key])
        material.append(np.full(len(corners), which, np.uint32))
    if not triangles:
        return None
    mesh = make_mesh(
        file.name,
        name,
        np.concatenate(arrays.positions),
        np.concatenate(triangles),
        np.concatenate(material),
        part.dropped,
        np.concatenate(arrays.normals) if arrays.has_normals else None,
        np.concatenate(arrays.uvs) if arrays.has_uvs else None,
    )
    if mesh is None:
        return None
    part.meshes.append(mesh)
    return len(part.meshes) - 1


def _vertex_key(file: _File, primitive: _Primitive, material: int) -> tuple[int | None, int | None, int | None]:
    """The accessors of positions, normals and uvs; primitives that agree in them share their vertices."""
    uv_set = 0
    if material < len(file.document.materials):
        texture = file.document.materials[material].pbr_metallic_roughness.base_color_texture
        uv_set = texture.tex_coord if texture is not None else 0
    attributes = primitive.attributes
    return attributes.get("POSITION"), attributes.get("NORMAL"), attributes.get(f"TEXCOORD_{uv_set}")


def _append_vertices(file: _File, arrays: _Arrays, key: tuple[int | None, int | None, int | None], place: str) -> None:
    position, normal, uv = key
    if position is None:
        raise file.error(place, "has no POSITION")
    positions = _attribute(file, position, "VEC3", f"{place}.POSITION")
    arrays.positions.append(positions)
    for accessor, kind, what, into in (
        (normal, "VEC3", "NORMAL", arrays.normals),
        (uv, "VEC2", "TEXCOORD", arrays.uvs),
    ):
        if accessor is None:
            into.append(np.zeros((len(positions), _WIDTHS[kind]), np.float32))
            continue
        values = _attribute(file, accessor, kind, f"{place}.{what}")
        if len(values) != len(positions):
            raise file.error(f"{place}.{what}", f"has {len(values)} elements for {len(positions)} positions")
        into.append(values)
    arrays.has_normals |= normal is not None
    arrays.has_uvs |= uv is not None
    arrays.count += len(positions)


def _attribute(file: _File, index: int, kind: str, place: str) -> np.ndarray:
    """A vertex attribute as float32; normalized integers as numbers in [-1, 1] (3.6.2.2)."""
    accessor = file.item(file.document.accessors, index, place, "accessors")
    if accessor.type != kind:
        raise file.error(f"accessors[{index}]", f"is {accessor.type}; {place} expects {kind}")
    values = _elements(file, index, accessor)
    if not accessor.normalized or values.dtype.kind == "f":
        return values.astype(np.float32)
    return np.maximum(values / np.float64(np.iinfo(values.dtype).max), -1.0).astype(np.float32)


def _triangles(file: _File, primitive: _Primitive, vertex_count: int, place: str) -> np.ndarray:
    """(t, 3) int64 vertex indices of a primitive, whose corners are checked against its vertices."""
    if primitive.indices is None:
        corners = np.arange(vertex_count)
    else:
        index = primitive.indices
        accessor = file.item(file.document.accessors, index, place, "accessors")
        if accessor.type != "SCALAR" or accessor.component_type not in (5121, 5123, 5125):
            raise file.error(f"accessors[{index}]", "holds no indices; expected SCALAR of unsigned integers")
        corners = _elements(file, index, accessor)[:, 0].astype(np.int64)
        if corners.max() >= vertex_count:
            first = int(np.argmax(corners >= vertex_count))
            raise file.error(
                f"{place}.indices", f"element {first} is vertex {corners[first]}; expected 0 .. {vertex_count - 1}"
            )
    if len(corners) < 3 or (primitive.mode == _TRIANGLES and len(corners) % 3):
        expected = "a multiple of 3" if primitive.mode == _TRIANGLES else "at least 3"
        raise file.error(place, f"has {len(corners)} corners; expected {expected}")
    if primitive.mode == _TRIANGLES:
        return corners.reshape(-1, 3)
    i = np.arange(len(corners) - 2)
    if primitive.mode == _FAN:
        return np.column_stack([corners[1:-1], corners[2:], np.broadcast_to(corners[0], len(i))])
    return np.column_stack([corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]])


# Accessors, views, buffers


def _elements(file: _File, index: int, accessor: _Accessor) -> np.ndarray:
    """(count, width) values of an accessor as stored (3.6.2), with its sparse replacements (3.6.2.3)."""
    place = f"accessors[{index}]"
    width = _WIDTHS[accessor.type]
    if accessor.type.startswith("MAT"):
        raise file.error(place, "holds matrices; expected scalars or vectors")
    dtype = np.dtype(_COMPONENTS[accessor.component_type])
    if accessor.buffer_view is None:
        if accessor.count > _MOST_ZEROS:
            raise file.error(place, f"count {accessor.count} without a bufferView; expected at most {_MOST_ZEROS}")
        values = np.zeros((accessor.count, width), dtype)
    else:
        values = _strided(file, accessor.buffer_view, accessor.byte_offset, accessor.count, width, dtype, place)
    if accessor.sparse is not None:
        values = _replace_sparse(file, accessor.sparse, values, place)
    return values


def _replace_sparse(file: _File, sparse: _Sparse, values: np.ndarray, place: str) -> np.ndarray:
    place += ".sparse"
    if sparse.count > len(values):
        raise file.error(place, f"count {sparse.count} is more than the accessor's {len(values)}")
    where = np.dtype(_COMPONENTS[sparse.indices.component_type])
    at = _strided(file, sparse.indices.buffer_view, sparse.indices.byte_offset, sparse.count, 1, where, place)[:, 0]
    if at.max() >= len(values):
        first = int(np.argmax(at >= len(values)))
        raise file.error(f"{place}.indices", f"element {first} is {at[first]}; expected 0 .. {len(values) - 1}")
    values = values.copy()
    width, dtype = values.shape[1], values.dtype
    values[at] = _strided(file, sparse.values.buffer_view, sparse.values.byte_offset, sparse.count, width, dtype, place)
    return values


def _strided(file: _File, view: int, offset: int, count: int, width: int, dtype: np.dtype, place: str) -> np.ndarray:
    """A read-only (count, width) window on a buffer view, whose bounds are checked first."""
    data, stride = _view(file, view, place)
    size = width * dtype.itemsize
    stride = stride or size
    needed = offset + stride * (count - 1) + size
    if stride < size:
        raise file.error(place, f"bufferViews[{view}] has a stride of {stride} bytes; an element takes {size}")
    if needed > len(data):
        raise file.error(place, f"count {count} needs {needed} bytes of bufferViews[{view}], which has {len(data)}")
    return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))


def _view(file: _File, index: int, place: str) -> tuple[memoryview, int | None]:
    """The bytes of a buffer view, and its stride."""
    view = file.item(file.document.buffer_views, index, place, "bufferViews")
    if "EXT_meshopt_compression" in view.extensions:
        raise file.error(
            f"bufferViews[{index}]", "EXT_meshopt_compression is not supported; export the file without it"
        )
    data = _buffer(file, view.buffer, f"bufferViews[{index}]")
    if view.byte_offset + view.byte_length > len(data):
        end = view.byte_offset + view.byte_length
        raise file.error(
            f"bufferViews[{index}]", f"ends at byte {end} of buffers[{view.buffer}], which has {len(data)}"
        )
    return data[view.byte_offset : view.byte_offset + view.byte_length], view.byte_stride


def _buffer(file: _File, index: int, place: str) -> memoryview:
    if index not in file.buffers:
        buffer = file.item(file.document.buffers, index, place, "buffers")
        place = f"buffers[{index}]"
        if buffer.uri is None:
            if index != 0 or file.chunk is None:
                raise file.error(place, "has no uri, and the file no binary chunk for it")
            data = file.chunk
        elif buffer.uri.startswith("data:"):
            data = memoryview(_decode_data_uri(file, buffer.uri, place))
        else:
            where = f"{file.name}: {place}"
            uri = unquote(buffer.uri)
            data = memoryview(read_bytes(file.folder.find(uri, file.path, where), f"{where}: {uri!r}"))
        if len(data) < buffer.byte_length:
            raise file.error(place, f"truncated: {len(data)} bytes, but byteLength is {buffer.byte_length}")
        file.buffers[index] = data[: buffer.byte_length]
    return file.buffers[index]


def _decode_data_uri(file: _File, uri: str, place: str) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma:
        raise file.error(place, "the data URI has no comma; expected data:TYPE;base64,DATA")
    if not head.endswith(";base64"):
        return unquote(body).encode("latin-1", "replace")
    try:
        return base64.b64decode(unquote(body), validate=True)
    except binascii.Error as error:
        raise file.error(place, f"the data URI is not base64 ({error})") from None
