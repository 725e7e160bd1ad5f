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
from .model import Camera, DirectionalLight, Instance, Material, PointLight, SpotLight, Texture, TextureUse, Track
from .part import Part, place_camera, place_instance, place_light
from .textures import decode_picture, read_picture
from .transform import Chain, chain, rotation_matrix, uv_transform
from .validate import check_chain, make_mesh

# Extensions that a file may require: what is read, and other ones of materials, which only change how a surface scatters.
_READ_EXTENSIONS = ("KHR_lights_punctual", "KHR_mesh_quantization", "KHR_texture_transform")
_MATERIAL_EXTENSIONS = "KHR_materials_"
_INFINITE_IOR = 1e4  # stands for the 0 by which KHR_materials_ior asks for a reflectance of 1

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
Finite = Annotated[float, Field(ge=-1e30, le=1e30)]
Color = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Two = Annotated[list[Finite], Field(min_length=2, max_length=2)]
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
    scale: Finite = 1.0  # of a normal map


class _TextureTransform(_Object):
    offset: Two = [0.0, 0.0]
    rotation: Finite = 0.0
    scale: Two = [1.0, 1.0]
    tex_coord: Index | None = None


class _Pbr(_Object):
    base_color_factor: Annotated[list[Fraction], Field(min_length=4, max_length=4)] = [1.0, 1.0, 1.0, 1.0]
    base_color_texture: _TextureInfo | None = None
    metallic_factor: Fraction = 1.0
    roughness_factor: Fraction = 1.0
    metallic_roughness_texture: _TextureInfo | None = None


class _Material(_Object):
    pbr_metallic_roughness: _Pbr = _Pbr()
    emissive_factor: Color = [0.0, 0.0, 0.0]
    emissive_texture: _TextureInfo | None = None
    normal_texture: _TextureInfo | None = None
    alpha_mode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"
    alpha_cutoff: Positive = 0.5
    double_sided: bool = False


class _EmissiveStrength(_Object):
    emissive_strength: Positive = 1.0


class _Specular(_Object):
    specular_factor: Fraction = 1.0
    specular_color_factor: Color = [1.0, 1.0, 1.0]
    specular_texture: Any = None
    specular_color_texture: Any = None


class _Ior(_Object):
    ior: Positive = 1.5


class _Transmission(_Object):
    transmission_factor: Fraction = 0.0
    transmission_texture: Any = None


class _Volume(_Object):
    thickness_factor: Positive = 0.0
    attenuation_distance: Positive | None = None


_READ_OF_MATERIALS = {
    "KHR_materials_emissive_strength": _EmissiveStrength,
    "KHR_materials_specular": _Specular,
    "KHR_materials_ior": _Ior,
    "KHR_materials_transmission": _Transmission,
    "KHR_materials_volume": _Volume,
}


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


class _Spot(_Object):
    inner_cone_angle: Annotated[float, Field(ge=0, le=math.pi / 2)] = 0.0
    outer_cone_angle: Annotated[float, Field(gt=0, le=math.pi / 2 + 1e-6)] = math.pi / 4


class _Light(_Object):
    type: Literal["point", "directional", "spot"]
    color: Color = [1.0, 1.0, 1.0]
    intensity: Positive = 1.0
    range: Positive | None = None
    spot: _Spot = _Spot()


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


class _Target(_Object):
    path: str
    node: Index | None = None


class _Channel(_Object):
    sampler: Index
    target: _Target


class _AnimationSampler(_Object):
    input: Index
    output: Index
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"] = "LINEAR"


class _Animation(_Object):
    channels: list[_Channel]
    samplers: list[_AnimationSampler]


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
    animations: list[_Animation] = []
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
    for place, node, motion in _walk(file, _animated_nodes(file, part)):
        if node.mesh is not None:
            if node.mesh not in meshes:
                meshes[node.mesh] = _add_mesh(file, part, node.mesh, place)
            if meshes[node.mesh] is not None:
                here = check_chain(f"{name}: {place}", motion)
                instance = Instance(node.name or part.meshes[meshes[node.mesh]].name, meshes[node.mesh])
                part.instances.append(place_instance(instance, here))
        if node.camera is not None and part.camera is None:
            part.camera = _camera(file, part, node.camera, place, motion)
        if "KHR_lights_punctual" in node.extensions:
            _add_light(file, part, node, place, motion)
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


def _walk(file: _File, animated: dict[int, Chain]) -> list[tuple[str, _Node, Chain]]:
    """Every node of the default scene, parents first: its place in the file, itself, its transforms from the world down.

    animated: the local transforms of nodes that move.
    """
    document = file.document
    if document.scenes:
        roots = file.item(document.scenes, document.scene, "scene", "scenes").nodes
    else:
        children = {child for node in document.nodes for child in node.children}
        roots = [index for index in range(len(document.nodes)) if index not in children]
    found = []
    seen = set()
    waiting: list[tuple[int, Chain]] = [(index, (np.eye(4)[:3],)) for index in reversed(roots)]
    while waiting:
        index, outer = waiting.pop()
        place = f"nodes[{index}]"
        node = file.item(document.nodes, index, "the node hierarchy", "nodes")
        if index in seen:
            raise file.error(place, "is reached twice; the node hierarchy must be a tree")
        seen.add(index)
        local = animated[index] if index in animated else (_local_transform(file, node, place),)
        motion = chain(*outer, *local)
        found.append((place, node, motion))
        waiting += [(child, motion) for child in reversed(node.children)]
    return found


def _local_transform(file: _File, node: _Node, place: str) -> np.ndarray:
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T[:3]
    if not any(node.rotation):
        raise file.error(place, "rotation is 0, 0, 0, 0; expected a unit quaternion")
    return np.column_stack([rotation_matrix(node.rotation) * node.scale, node.translation])


def _camera(file: _File, part: Part, index: int, place: str, motion: Chain) -> Camera | None:
    camera = file.item(file.document.cameras, index, place, "cameras")
    if camera.perspective is None:
        part.notes.append(f"{file.name}: the orthographic camera {camera.name!r} is left out")
        return None
    here = check_chain(f"{file.name}: {place}", motion)
    return place_camera(Camera(np.eye(4)[:3], camera.perspective.yfov, camera.perspective.znear), here)


def _add_light(file: _File, part: Part, node: _Node, place: str, motion: Chain) -> None:
    where = f"{file.name}: {place}: KHR_lights_punctual"
    index = _checked(_LightReference, node.extensions["KHR_lights_punctual"], where).light
    declared = file.document.extensions.get("KHR_lights_punctual", {})
    lights = _checked(_Lights, declared, f"{file.name}: extensions.KHR_lights_punctual").lights
    light = file.item(lights, index, place, "lights")
    strength = tuple(light.intensity * c for c in light.color)
    centre, ahead = (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)
    if light.type == "point":
        made = PointLight(centre, strength)
    elif light.type == "directional":
        made = DirectionalLight(ahead, strength)
    else:
        inner, outer = light.spot.inner_cone_angle, light.spot.outer_cone_angle
        if inner >= outer:
            place = f"extensions.KHR_lights_punctual.lights[{index}].spot"
            raise file.error(place, f"innerConeAngle {inner} is not below outerConeAngle {outer}")
        made = SpotLight(centre, ahead, strength, inner, outer)
    part.lights.append(place_light(made, check_chain(f"{file.name}: {place}", motion)))
    if light.range is not None:
        part.notes.append(
            f"{file.name}: the light {light.name or index!r} reaches farther than its range, which is left out"
        )


def _note_node_features(file: _File, part: Part) -> None:
    document = file.document
    features = {
        "skinned meshes stand in their rest pose": sum(node.skin is not None for node in document.nodes),
        "meshes with morph targets keep their base shape": sum(
            any(p.targets for p in mesh.primitives) for mesh in document.meshes
        ),
        "meshes have vertex colours, which are left out": sum(
            any("COLOR_0" in p.attributes for p in mesh.primitives) for mesh in document.meshes
        ),
    }
    part.notes += [f"{file.name}: {count} {what}" for what, count in features.items() if count]


# Animations

_MOVED = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}
_SPLINE_STEPS = 32  # straight pieces for each piece of a cubic spline
_LEAST_SCALE = 1e-6  # of the largest: stands for 0, which could not be inverted


def _animated_nodes(file: _File, part: Part) -> dict[int, Chain]:
    """The local transforms of the nodes that the first animation moves (3.11)."""
    animations = file.document.animations
    if not animations:
        return {}
    if len(animations) > 1:
        part.notes.append(
            f"{file.name}: of {len(animations)} animations, the first one, {animations[0].name!r}, is played"
        )
    paths: dict[int, dict[str, Track]] = {}
    left_out = 0
    for number, channel in enumerate(animations[0].channels):
        place = f"animations[0].channels[{number}]"
        if channel.target.path not in _MOVED or channel.target.node is None:
            left_out += 1
            continue
        node = file.item(file.document.nodes, channel.target.node, place, "nodes")
        if node.matrix is not None:
            raise file.error(place, f"moves nodes[{channel.target.node}], which has a matrix; expected none")
        sampler = file.item(animations[0].samplers, channel.sampler, place, "samplers")
        paths.setdefault(channel.target.node, {})[channel.target.path] = _track(
            file, sampler, channel.target.path, place
        )
    if left_out:
        part.notes.append(
            f"{file.name}: {left_out} animation channels of morph weights or other properties are left out"
        )
    return {index: _animated_node(file, index, tracks) for index, tracks in paths.items()}


def _track(file: _File, sampler: _AnimationSampler, path: str, place: str) -> Track:
    """One property's keys; the other properties of the track are at rest."""
    times = _attribute(file, sampler.input, "SCALAR", f"{place}.input").astype(np.float64)[:, 0]
    if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
        raise file.error(
            f"{place}.input", "has times that do not ascend; expected finite seconds, each above the one before"
        )
    values = _attribute(file, sampler.output, _MOVED[path], f"{place}.output").astype(np.float64)
    pieces = 3 if sampler.interpolation == "CUBICSPLINE" else 1
    if len(values) != pieces * len(times):
        raise file.error(
            f"{place}.output", f"has {len(values)} elements; expected {pieces} for each of {len(times)} times"
        )
    if not np.isfinite(values).all():
        raise file.error(f"{place}.output", "has values that are not finite")
    if pieces == 3:
        times, values = _sampled_spline(times, values)
    if path == "rotation":
        length = np.linalg.norm(values, axis=1, keepdims=True)
        if not (length > 0).all():
            raise file.error(f"{place}.output", "has a rotation of 0, 0, 0, 0; expected unit quaternions")
        values = values / length
    if path == "scale":
        least = _LEAST_SCALE * max(np.abs(values).max(), _LEAST_SCALE)
        values = np.where(np.abs(values) < least, np.copysign(least, values), values)
    rest = np.ones((len(times), 1))
    fields = {
        "translation": 0.0 * rest * np.ones(3),
        "rotation": rest * [0.0, 0.0, 0.0, 1.0],
        "scale": rest * np.ones(3),
    }
    return Track(times, **(fields | {path: values}), step=sampler.interpolation == "STEP")


def _sampled_spline(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Keys on a cubic spline of in-tangent, value and out-tangent for each time (appendix C.4)."""
    arriving, value, leaving = values[0::3], values[1::3], values[2::3]
    if len(times) == 1:
        return times, value
    t = (np.arange(_SPLINE_STEPS) / _SPLINE_STEPS)[:, None]
    span = np.diff(times)[:, None, None]
    start, end = value[:-1, None], value[1:, None]
    curve = (2 * t**3 - 3 * t**2 + 1) * start + (3 * t**2 - 2 * t**3) * end
    curve = curve + span * ((t**3 - 2 * t**2 + t) * leaving[:-1, None] + (t**3 - t**2) * arriving[1:, None])
    at = (times[:-1, None] + np.diff(times)[:, None] * t[:, 0]).ravel()
    return np.append(at, times[-1]), np.concatenate([curve.reshape(-1, value.shape[1]), value[-1:]])


def _animated_node(file: _File, index: int, tracks: dict[str, Track]) -> Chain:
    """Translation, rotation and scale of a node: one track where they share their times, else one for each that moves."""
    node = file.document.nodes[index]
    at_rest = {"translation": node.translation, "rotation": node.rotation, "scale": node.scale}
    if not any(node.rotation):
        raise file.error(f"nodes[{index}]", "rotation is 0, 0, 0, 0; expected a unit quaternion")
    first = next(iter(tracks.values()))
    if all(np.array_equal(t.times, first.times) and t.step == first.step for t in tracks.values()):
        moved = {path: getattr(track, path) for path, track in tracks.items()}
        still = {path: np.tile(np.array(rest, np.float64), (len(first.times), 1)) for path, rest in at_rest.items()}
        still["rotation"] /= np.linalg.norm(still["rotation"], axis=1, keepdims=True)
        return (Track(first.times, **(still | moved), step=first.step),)
    fixed = {
        "translation": np.column_stack([np.eye(3), node.translation]),
        "rotation": np.column_stack([rotation_matrix(node.rotation), np.zeros(3)]),
        "scale": np.column_stack([np.diag(node.scale), np.zeros(3)]),
    }
    return tuple(tracks.get(path, fixed[path]) for path in at_rest)


# Materials


_TextureKey = tuple[int, bool, tuple[str, str]]


def _add_materials(file: _File, part: Part) -> None:
    """Materials in the file's order, then the default one (3.9.6) for primitives that name none."""
    textures: dict[_TextureKey, int] = {}
    for index, material in enumerate(file.document.materials):
        part.materials.append(_material(file, part, textures, material, f"materials[{index}]"))
    part.materials.append(Material("default", (1.0, 1.0, 1.0), metallic=1.0, specular=1.0, double_sided=False))
    _note_materials(file, part)


def _material(file: _File, part: Part, textures: dict[_TextureKey, int], material: _Material, place: str) -> Material:
    pbr = material.pbr_metallic_roughness
    extensions = {
        name: _checked(kind, material.extensions[name], f"{file.name}: {place}: {name}")
        for name, kind in _READ_OF_MATERIALS.items()
        if name in material.extensions
    }
    glow = extensions.get("KHR_materials_emissive_strength", _EmissiveStrength())
    specular = extensions.get("KHR_materials_specular", _Specular())
    ior = extensions.get("KHR_materials_ior", _Ior()).ior
    if 0 < ior < 1:
        raise file.error(place, f"KHR_materials_ior: ior is {ior}; expected 0, or a number from 1 up")
    volume = extensions.get("KHR_materials_volume", _Volume())
    uv_set = _uv_set(file, material, place)

    def use(info: _TextureInfo | None, what: str, srgb: bool) -> TextureUse | None:
        if info is None:
            return None
        transform = _texture_transform(file, info, f"{place}.{what}")
        if _uv_set_of(info, transform) != uv_set:
            part.notes.append(
                f"{file.name}: {place}: {what} is left out: it has other texture coordinates than the first one"
            )
            return None
        texture = _add_texture(file, part, textures, info.index, srgb, f"{place}.{what}")
        return TextureUse(texture, uv_transform(tuple(transform.offset), transform.rotation, tuple(transform.scale)))

    is_lit = any(material.emissive_factor)
    return Material(
        name=material.name or place,
        base_color=tuple(pbr.base_color_factor[:3]),
        base_color_texture=use(pbr.base_color_texture, "baseColorTexture", True),
        alpha=1.0 if material.alpha_mode == "OPAQUE" else pbr.base_color_factor[3],
        alpha_cutoff={"OPAQUE": None, "MASK": material.alpha_cutoff, "BLEND": 0.5}[material.alpha_mode],
        metallic=pbr.metallic_factor,
        roughness=pbr.roughness_factor,
        metallic_roughness_texture=use(pbr.metallic_roughness_texture, "metallicRoughnessTexture", False),
        specular=specular.specular_factor,
        specular_color=tuple(specular.specular_color_factor),
        ior=ior or _INFINITE_IOR,
        transmission=extensions.get("KHR_materials_transmission", _Transmission()).transmission_factor,
        thin="KHR_materials_transmission" in extensions and volume.thickness_factor == 0,
        emission=tuple(glow.emissive_strength * e for e in material.emissive_factor),
        emission_texture=use(material.emissive_texture, "emissiveTexture", True) if is_lit else None,
        normal_texture=use(material.normal_texture, "normalTexture", False),
        normal_scale=material.normal_texture.scale if material.normal_texture is not None else 1.0,
        double_sided=material.double_sided,
    )


def _texture_transform(file: _File, info: _TextureInfo, place: str) -> _TextureTransform:
    where = f"{file.name}: {place}: KHR_texture_transform"
    return _checked(_TextureTransform, info.extensions.get("KHR_texture_transform", {}), where)


def _uv_set_of(info: _TextureInfo, transform: _TextureTransform) -> int:
    return info.tex_coord if transform.tex_coord is None else transform.tex_coord


def _uv_set(file: _File, material: _Material, place: str) -> int:
    """Which texture coordinates a material's meshes keep: those of its first texture."""
    pbr = material.pbr_metallic_roughness
    infos = {
        "baseColorTexture": pbr.base_color_texture,
        "metallicRoughnessTexture": pbr.metallic_roughness_texture,
        "emissiveTexture": material.emissive_texture,
        "normalTexture": material.normal_texture,
    }
    for what, info in infos.items():
        if info is not None:
            return _uv_set_of(info, _texture_transform(file, info, f"{place}.{what}"))
    return 0


def _note_materials(file: _File, part: Part) -> None:
    materials = file.document.materials
    unread = Counter(e for m in materials for e in m.extensions if e not in _READ_OF_MATERIALS)
    features = {
        "materials blend by their alpha; below 0.5 they are left out, above they are opaque": sum(
            m.alpha_mode == "BLEND" for m in materials
        ),
        "materials have textures of specular reflection or transmission, which are left out": sum(
            "texture" in key.lower()
            for m in materials
            for name in ("KHR_materials_specular", "KHR_materials_transmission")
            for key in m.extensions.get(name, {})
        ),
        "materials absorb light inside (KHR_materials_volume), which is left out": sum(
            "attenuationDistance" in m.extensions.get("KHR_materials_volume", {}) for m in materials
        ),
        "materials are lit although the file asks for none (KHR_materials_unlit)": unread.pop("KHR_materials_unlit", 0),
    } | {f"materials use {extension}, which is left out": count for extension, count in unread.items()}
    part.notes += [f"{file.name}: {count} {what}" for what, count in features.items() if count]


def _add_texture(file: _File, part: Part, textures: dict[_TextureKey, int], index: int, srgb: bool, place: str) -> int:
    """The index in the part of a glTF texture; the same picture, read and wrapped the same way, is one texture."""
    texture = file.item(file.document.textures, index, place, "textures")
    if texture.source is None:
        raise file.error(f"textures[{index}]", "has no source that can be read; expected a PNG or JPEG picture")
    sampler = _Sampler()
    if texture.sampler is not None:
        sampler = file.item(file.document.samplers, texture.sampler, f"textures[{index}]", "samplers")
    wrap = (_WRAPS[sampler.wrap_s], _WRAPS[sampler.wrap_t])
    key = (texture.source, srgb, wrap)
    if key not in textures:
        image = file.item(file.document.images, texture.source, f"textures[{index}]", "images")
        name = image.name or (
            image.uri if image.uri and not image.uri.startswith("data:") else f"images[{texture.source}]"
        )
        textures[key] = len(part.textures)
        part.textures.append(Texture(name, _picture(file, texture.source, image), srgb, wrap))
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
        uv_set = _uv_set(file, file.document.materials[material], f"materials[{material}]")
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
