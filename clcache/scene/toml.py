"""TOML scene files: read, checked by the schema, and turned into a `Part` and what only such a file can say.

The standard parser gives values without their lines, so that the file is parsed once more by a syntax-tree parser, whose
nodes know where they stand; a map from each key's path to its line serves the error messages.
"""

import difflib
import math
import time
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tree_sitter
import tree_sitter_toml
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from .. import settings
from ..errors import SceneError, SettingError
from . import schema
from .environment import read_environment, turned
from .files import Folder, read_text
from .model import (
    Camera,
    Defaults,
    DirectionalLight,
    Environment,
    Instance,
    Light,
    Material,
    PointLight,
    SpotLight,
    Texture,
    TextureUse,
    Track,
)
from .part import Part, place_camera, place_instance, place_light
from .posefile import read_pose_file
from .sky import sky_picture, sun_irradiance
from .textures import read_picture
from .transform import Chain, look_at, rest_pose, rotation_matrix, turns_between, uv_transform
from .validate import check_transform, make_mesh

if TYPE_CHECKING:
    from ..graph import CompiledGraph

KeyPath = tuple[str | int, ...]

_MAPS = {
    "base_color_texture": True,
    "metallic_roughness_texture": False,
    "emission_texture": True,
    "normal_texture": False,
}

# What keys of a material are about, besides what is called as they are.
_ABOUT = {
    "base_color_texture": ("base_color",),
    "metallic_roughness_texture": ("metallic", "roughness"),
    "emission_texture": ("emission",),
    "normal_texture": ("normal",),
    "normal_scale": ("normal",),
}
_REFLECTING = {
    "roughness",
    "ior",
    "specular_color",
    "metallic_roughness_texture",
}  # what asks for a dielectric's reflection
_RANGES = {"emission": (0.0, 1e30), "ior": (1.0, 1e4)}  # of a document's constants; of all others 0 .. 1
_MOST_NAMES = 20  # in a message


@dataclass(frozen=True)
class TomlScene:
    """A read file. part.camera: None if the file gives none. environment: None likewise."""

    part: Part
    environment: Environment | None
    defaults: Defaults


@dataclass(frozen=True)
class _Document:
    """The values of a file with the lines of its keys."""

    name: str
    data: dict
    lines: dict[KeyPath, int]

    def where(self, path: KeyPath) -> str:
        """File, line and key of this path; the line is that of the nearest table around it if the file does not write it."""
        known = next((path[:n] for n in range(len(path), 0, -1) if path[:n] in self.lines), None)
        line = f":{self.lines[known]}" if known else ""
        dotted = ".".join(map(str, path)).replace("\n", " ")
        return f"{self.name}{line}" + (f": {dotted}" if dotted else "")

    def error(self, path: KeyPath, message: str) -> SceneError:
        return SceneError(f"{self.where(path)}: {message}")


def load_toml(path: Path, name: str, folder: Folder, load_file: Callable[[Path, str], Part]) -> TomlScene:
    """Read a TOML scene. name: the file as messages call it. load_file: reads a mesh file that the scene includes."""
    document = _parse(read_text(path, name), name)
    table = _check(document)
    part = Part()
    adder = _Materials(part, document, path, folder)
    materials = {name: adder.add(name, material) for name, material in table.materials.items()}
    sources = _load_meshes(table, document, path, folder, load_file, materials)
    _add_instances(part, table, document, materials, sources)
    part.lights += map(_light, table.lights)
    if table.camera is not None:
        part.camera = _camera(table.camera, document, path, folder)
    environment = _environment(table.environment, part, document, path, folder)
    return TomlScene(part, environment, _defaults(table.render, document))


def _parse(text: str, name: str) -> _Document:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{name}: not valid TOML: {error}") from None
    except RecursionError:
        raise SceneError(f"{name}: nested too deeply") from None
    return _Document(name, data, _key_lines(text))


def _key_lines(text: str) -> dict[KeyPath, int]:
    """The line, from 1, of every table, key and list element of valid TOML, by its path."""
    lines: dict[KeyPath, int] = {}
    elements: dict[KeyPath, int] = {}  # lists of tables: how many elements so far

    def keys(node: tree_sitter.Node) -> KeyPath:
        table = tomllib.loads(node.text.decode() + "=0")
        path = []
        while isinstance(table, dict):
            ((key, table),) = table.items()
            path.append(key)
        return tuple(path)

    def absolute(path: KeyPath) -> KeyPath:
        """The path with the current element's number after every list of tables."""
        found: KeyPath = ()
        for key in path:
            found += (key,)
            if found in elements:
                found += (elements[found] - 1,)
        return found

    def note(path: KeyPath, node: tree_sitter.Node) -> None:
        for n in range(1, len(path) + 1):
            lines.setdefault(path[:n], node.start_point[0] + 1)

    def pair(base: KeyPath, node: tree_sitter.Node) -> None:
        path = base + keys(node.named_children[0])
        note(path, node)
        value(path, node.named_children[1])

    def value(path: KeyPath, node: tree_sitter.Node) -> None:
        if node.type == "inline_table":
            for child in node.named_children:
                if child.type == "pair":
                    pair(path, child)
        elif node.type == "array":
            items = [child for child in node.named_children if child.type != "comment"]
            for index, child in enumerate(items):
                note((*path, index), child)
                value((*path, index), child)

    parser = tree_sitter.Parser(tree_sitter.Language(tree_sitter_toml.language()))
    for node in parser.parse(text.encode()).root_node.named_children:
        base: KeyPath = ()
        if node.type in ("table", "table_array_element"):
            written = keys(node.named_children[0])
            if node.type == "table_array_element":
                base = (*absolute(written[:-1]), written[-1])
                note(base, node)
                elements[base] = elements.get(base, 0) + 1
            base = absolute(written)
            note(base, node)
        for child in node.named_children if base else [node]:
            if child.type == "pair":
                pair(base, child)
    return lines


def _check(document: _Document) -> schema.SceneTable:
    try:
        return schema.SceneTable.model_validate(document.data)
    except ValidationError as failure:
        error = failure.errors(include_url=False)[0]
    path = _path_in_file(document.data, error["loc"])
    if error["type"] == "unknown_key":
        path += (error["ctx"]["key"],)
    if error["type"] == "missing":
        raise document.error(path, f"{error['loc'][-1]} is missing")
    message = error["msg"].replace("Input should be", "expected")
    value = document.data
    for key in path if error["type"] != "unknown_key" else ():
        value = value[key]
    shown = "" if isinstance(value, dict) or error["type"] == "unknown_key" else f"{value!r} is wrong; "
    raise document.error(path, f"{shown}{message}")


def _path_in_file(data: object, location: KeyPath) -> KeyPath:
    """The part of a schema location that exists in the file's data; the schema adds names of alternatives to it."""
    path: KeyPath = ()
    for key in location:
        try:
            data = data[key]
        except (KeyError, IndexError, TypeError):
            continue
        path += (key,)
    return path


class _Materials:
    """Adds the file's materials, with their textures and graphs, to a part; what several share is there once."""

    def __init__(self, part: Part, document: _Document, path: Path, folder: Folder):
        self._part, self._document, self._path, self._folder = part, document, path, folder
        self._textures: dict[tuple, int] = {}
        self._graphs: dict[tuple, tuple[CompiledGraph, tuple[TextureUse, ...]]] = {}

    def add(self, name: str, table: schema.MaterialTable) -> int:
        """Returns the material's index."""
        here: KeyPath = ("materials", name)
        values = {field: getattr(table, field) for field in schema.MaterialTable.model_fields}
        del values["graph_material"]
        values |= {field: self._use(values[field], (*here, field), srgb) for field, srgb in _MAPS.items()}
        given = set(table.model_fields_set)
        if table.graph is not None:
            graph, values["graph_textures"] = self._graph(table, here)
            self._check_driven(graph, given, here)
            values["graph"] = graph if graph.outputs else None
            values |= {n: _in_range(n, value) for n, value in graph.graph.constants.items() if n not in given}
            given |= graph.outputs.keys() | graph.graph.constants.keys()
        if "specular" not in given:
            values["specular"] = 1.0 if _REFLECTING & given else 0.0
        self._part.materials.append(Material(name, **values))
        return len(self._part.materials) - 1

    def _use(self, source: schema.TextureTable | None, key: KeyPath, srgb: bool) -> TextureUse | None:
        if source is None:
            return None
        where = self._document.where(_path_in_file(self._document.data, (*key, "file")))
        texture = self._texture(
            self._folder.find(source.file, self._path, where), source.file, where, srgb, source.wrap
        )
        return TextureUse(texture, uv_transform(source.offset, math.radians(source.rotation), source.scale))

    def _texture(self, file: Path, name: str, where: str, srgb: bool, wrap: tuple[str, str]) -> int:
        """The index of the picture in a file, which is called `name` where it is named."""
        kind = (file, srgb, wrap)
        if kind not in self._textures:
            self._textures[kind] = len(self._part.textures)
            self._part.textures.append(Texture(name, read_picture(file, f"{where}: {name!r}"), srgb, wrap))
        return self._textures[kind]

    def _graph(self, table: schema.MaterialTable, here: KeyPath) -> tuple["CompiledGraph", tuple[TextureUse, ...]]:
        from ..graph import read
        from ..graph.model import printable

        file = self._folder.find(table.graph, self._path, self._document.where((*here, "graph")))
        key = (file, table.graph_material)
        if key not in self._graphs:
            start = time.perf_counter()
            graph = read(file, printable(table.graph), self._folder, table.graph_material)
            self._part.graph_seconds += time.perf_counter() - start
            self._part.notes += (f"{table.graph}: {note}" for note in graph.graph.notes)
            pictures = zip(graph.files, graph.graph.textures, strict=True)
            textures = (self._texture(file, t.file, t.place, t.srgb, t.wrap) for file, t in pictures)
            self._graphs[key] = graph, tuple(map(TextureUse, textures))
        return self._graphs[key]

    def _check_driven(self, graph: "CompiledGraph", given: Collection[str], here: KeyPath) -> None:
        """Raise SceneError where the table gives what the graph computes."""
        for key in schema.MaterialTable.model_fields:
            driven = [name for name in (key, *_ABOUT.get(key, ())) if name in graph.outputs]
            if key in given and driven:
                raise self._document.error((*here, key), f"the graph computes {driven[0]}; expected either, not both")


def _in_range(name: str, value: float | bool | tuple[float, ...]) -> float | bool | tuple[float, ...]:
    """A document's constant, clamped as kernels clamp what graphs compute."""
    if isinstance(value, bool):
        return value
    low, high = _RANGES.get(name, (0.0, 1.0))
    return tuple(min(max(x, low), high) for x in value) if isinstance(value, tuple) else min(max(value, low), high)


@dataclass(frozen=True)
class _Source:
    """A mesh that instances place: what its file holds, and which of its materials are replaced by which of the scene's."""

    part: Part
    replaced: Mapping[int, int]


def _load_meshes(
    table: schema.SceneTable,
    document: _Document,
    path: Path,
    folder: Folder,
    load_file: Callable[[Path, str], Part],
    materials: Mapping[str, int],
) -> dict[str, _Source]:
    """Each mesh that an instance uses. materials: the scene's, by name."""
    sources = {}
    for name, source in table.meshes.items():
        if not any(instance.mesh == name for instance in table.instances):
            continue
        if isinstance(source, schema.FileMesh):
            where = document.where(("meshes", name, "file"))
            file = folder.find(source.file, path, where)
            if file.suffix.lower() == ".toml":
                raise document.error(("meshes", name, "file"), f"{source.file!r} is a scene; expected a mesh file")
            part = load_file(file, source.file)
            if not source.animated:
                _stop(part)
            sources[name] = _Source(part, _replaced(source, part, ("meshes", name, "materials"), document, materials))
        else:
            sources[name] = _Source(_generated(source, name, document), {})
    return sources


def _replaced(
    source: schema.FileMesh, part: Part, here: KeyPath, document: _Document, materials: Mapping[str, int]
) -> dict[int, int]:
    """Which of a file's materials are replaced: the scene's index by the file's. Names may stand for several of the file."""
    numbers: dict[str, list[int]] = {}
    for number, material in enumerate(part.materials):
        numbers.setdefault(material.name, []).append(number)
    replaced = {}
    for old, new in source.materials.items():
        if old not in numbers:
            raise document.error((*here, old), _unknown(old, numbers, f"the materials of {source.file!r}"))
        if new not in materials:
            raise document.error((*here, old), _unknown(new, materials, "[materials]"))
        replaced |= dict.fromkeys(numbers[old], materials[new])
    return replaced


def _stop(part: Part) -> None:
    """Let everything stand as it does at time 0."""
    part.instances = [replace(instance, motion=()) for instance in part.instances]
    part.lights = [place_light(replace(light, motion=()), (rest_pose(light.motion),)) for light in part.lights]
    if part.camera is not None:
        part.camera = replace(part.camera, motion=())


def _generated(source: schema.MeshSource, name: str, document: _Document) -> Part:
    part = Part(materials=[Material("default")])
    positions, triangles, normals, uvs = source.shape()
    mesh = make_mesh(document.name, name, positions, triangles, 0, part.dropped, normals, uvs)
    if mesh is None:
        raise document.error(("meshes", name), "its triangles have no area in float32; expected larger sizes")
    part.meshes.append(mesh)
    part.instances.append(Instance(name, 0))
    return part


def _add_instances(
    part: Part, table: schema.SceneTable, document: _Document, materials: dict[str, int], sources: dict[str, _Source]
) -> None:
    first_mesh: dict[str, int] = {}
    painted: dict[tuple[int, int], int] = {}
    for index, instance in enumerate(table.instances):
        here: KeyPath = ("instances", index)
        if instance.mesh not in table.meshes:
            raise document.error((*here, "mesh"), _unknown(instance.mesh, table.meshes, "[meshes]"))
        if instance.material is not None and instance.material not in materials:
            raise document.error((*here, "material"), _unknown(instance.material, materials, "[materials]"))
        motion = _instance_motion(instance, document, here)
        source = sources[instance.mesh]
        if instance.mesh not in first_mesh:
            first_mesh[instance.mesh] = _add_source(part, source)
        for inner in source.part.instances:
            mesh = first_mesh[instance.mesh] + inner.mesh
            if instance.material is not None:
                mesh = _painted(part, painted, mesh, materials[instance.material])
            part.instances.append(place_instance(replace(inner, mesh=mesh), motion))
        part.lights += [place_light(light, motion) for light in source.part.lights]
        if part.camera is None and source.part.camera is not None:
            part.camera = place_camera(source.part.camera, motion)


def _add_source(part: Part, source: _Source) -> int:
    """Add what a mesh file holds; returns the index of its first mesh."""
    first_material = len(part.materials)
    first_mesh = part.add_assets(source.part)
    if source.replaced:
        material = np.arange(len(part.materials), dtype=np.uint32)
        for old, new in source.replaced.items():
            material[first_material + old] = new
        part.meshes[first_mesh:] = [replace(m, material=material[m.material]) for m in part.meshes[first_mesh:]]
    return first_mesh


def _painted(part: Part, painted: dict[tuple[int, int], int], mesh: int, material: int) -> int:
    """The index of a mesh that shares the arrays of `mesh` but is of one material all over."""
    if (mesh, material) not in painted:
        painted[mesh, material] = len(part.meshes)
        original = part.meshes[mesh]
        part.meshes.append(replace(original, material=np.full_like(original.material, material)))
    return painted[mesh, material]


def _unknown(name: str, known: Collection[str], where: str) -> str:
    if not known:
        return f"no {name!r} in {where}; there is none"
    near = difflib.get_close_matches(name, known, 1, cutoff=0.5)
    listed = ", ".join([*known][:_MOST_NAMES]) + (", ..." if len(known) > _MOST_NAMES else "")
    return f"no {name!r} in {where}; " + (f"did you mean {near[0]!r}?" if near else f"expected one of {listed}")


def _instance_motion(instance: schema.InstanceTable, document: _Document, path: KeyPath) -> Chain:
    if instance.keys is None:
        return (_transform(instance, document, path),)
    placed = [
        (
            _first_given(key.translation, instance.translation, (0.0, 0.0, 0.0)),
            _first_given(
                _quaternion(key, document, (*path, "keys", index)),
                _quaternion(instance, document, path),
                (0.0, 0.0, 0.0, 1.0),
            ),
            _first_given(key.scale, instance.scale, (1.0, 1.0, 1.0)),
        )
        for index, key in enumerate(instance.keys)
    ]
    translation, rotation, scale = (np.array(column, np.float64) for column in zip(*placed, strict=True))
    track = Track(np.array([key.time for key in instance.keys]), translation, rotation, scale, instance.step)
    for index, factors in enumerate(scale):
        check_transform(document.where((*path, "keys", index)), np.column_stack([np.diag(factors), translation[index]]))
    return (track,)


def _first_given(*values):
    return next(value for value in values if value is not None)


def _quaternion(
    placement: schema.Placement | schema.CameraKey, document: _Document, path: KeyPath
) -> np.ndarray | None:
    """The rotation that a table gives, as a unit quaternion x, y, z, w."""
    if placement.quaternion is not None:
        quaternion = np.array(placement.quaternion)
        if not quaternion.any():
            raise document.error((*path, "quaternion"), "has no length; expected four numbers that are not all 0")
        quaternion = quaternion / np.abs(quaternion).max()  # so that the squares of extreme components stay in range
        return quaternion / np.linalg.norm(quaternion)
    if placement.rotation is not None:
        half = math.radians(placement.rotation.degrees) / 2
        return np.array([*(math.sin(half) * x for x in placement.rotation.axis), math.cos(half)])
    return None


def _transform(placement: schema.Placement, document: _Document, path: KeyPath) -> np.ndarray:
    where = document.where(path)
    if placement.matrix is not None:
        return check_transform(where, np.array(placement.matrix))
    quaternion = _quaternion(placement, document, path)
    rotation = np.eye(3) if quaternion is None else rotation_matrix(quaternion)
    scale = np.array(placement.scale if placement.scale is not None else (1.0, 1.0, 1.0))
    translation = placement.translation if placement.translation is not None else (0.0, 0.0, 0.0)
    return check_transform(where, np.column_stack([rotation * scale, translation]))


def _light(light: schema.LightTable) -> Light:
    if isinstance(light, schema.PointTable):
        return PointLight(light.position or (0.0, 0.0, 0.0), light.intensity, _light_motion(light))
    first = light.keys[0].direction if light.keys else light.direction
    if isinstance(light, schema.DirectionalTable):
        return DirectionalLight(first, light.irradiance, _light_motion(light))
    cone = math.radians(light.inner_angle), math.radians(light.outer_angle)
    return SpotLight(light.position or (0.0, 0.0, 0.0), first, light.intensity, *cone, _light_motion(light))


def _light_motion(light: schema.LightTable) -> Chain:
    """The track that moves a light from the origin, and turns it from its first key's direction."""
    if light.keys is None:
        return ()
    count = len(light.keys)
    translation, rotation = np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    if not isinstance(light, schema.DirectionalTable):
        translation = np.array([key.position for key in light.keys])
    if not isinstance(light, schema.PointTable):
        rotation = turns_between(np.array([key.direction for key in light.keys]))
    times = np.array([key.time for key in light.keys])
    return (Track(times, translation, rotation, np.ones((count, 3)), light.step),)


def _environment(
    environment: schema.EnvironmentTable | None, part: Part, document: _Document, path: Path, folder: Folder
) -> Environment | None:
    """The environment; a sky's sun goes among the part's lights."""
    if environment is None:
        return None
    if environment.color is not None:
        return Environment.constant(environment.color)
    if environment.image is not None:
        image = environment.image
        where = document.where(_path_in_file(document.data, ("environment", "image", "file")))
        picture = read_environment(folder.find(image.file, path, where), f"{where}: {image.file!r}")
        return Environment(np.ascontiguousarray(np.float32(image.scale) * turned(picture, image.rotation)))
    sky = environment.sky
    to_sun = np.array(sky.to_sun)
    if sky.sun:
        irradiance = tuple(sky.scale * x for x in sun_irradiance(sky.turbidity, math.acos(min(to_sun[1], 1.0))))
        part.lights.append(DirectionalLight(tuple((-to_sun).tolist()), irradiance))
    return Environment(np.float32(sky.scale) * sky_picture(sky.turbidity, to_sun, sky.resolution))


def _camera(camera: schema.CameraTable, document: _Document, path: Path, folder: Folder) -> Camera:
    lens = {"fov_y": math.radians(camera.fov_y), "near": camera.near}
    if camera.keys is not None or camera.poses is not None:
        track = (
            _camera_keys(camera, document) if camera.keys is not None else _camera_poses(camera, document, path, folder)
        )
        if camera.step:
            track = replace(track, step=True)
        return Camera(rest_pose((track,)), **lens, motion=(track,))
    if camera.pose is not None:
        pose = np.array(camera.pose)
        turn = pose[:, :3]
        if not np.allclose(turn.T @ turn, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0:
            raise document.error(
                ("camera", "pose"), "is not a rotation and a translation; expected no scale and no mirroring"
            )
    else:
        pose = _look_at(camera.position, camera.look_at, camera.up, document, ("camera", "look_at"))
    return Camera(pose, **lens)


def _look_at(position: tuple, target: tuple, up: tuple, document: _Document, path: KeyPath) -> np.ndarray:
    pose = look_at(position, target, up)
    if pose is None:
        raise document.error(path, "gives no view; expected a point other than position, not straight along up")
    return pose


def _camera_keys(camera: schema.CameraTable, document: _Document) -> Track:
    rotations, positions = [], []
    for index, key in enumerate(camera.keys):
        path: KeyPath = ("camera", "keys", index)
        positions.append(_first_given(key.position, camera.position))
        rotation = _quaternion(key, document, path)
        if rotation is None:
            target, up = _first_given(key.look_at, camera.look_at), _first_given(key.up, camera.up)
            pose = _look_at(positions[-1], target, up, document, (*path, "look_at"))
            rotation = Rotation.from_matrix(pose[:, :3]).as_quat()
        rotations.append(rotation)
    times = np.array([key.time for key in camera.keys])
    return Track(times, np.array(positions), np.array(rotations), np.ones((len(times), 3)))


def _camera_poses(camera: schema.CameraTable, document: _Document, path: Path, folder: Folder) -> Track:
    return read_pose_file(folder.find(camera.poses, path, document.where(("camera", "poses"))), camera.poses)


def _defaults(render: schema.RenderTable, document: _Document) -> Defaults:
    values = {}
    for path, value in _leaves(render.settings):
        try:
            setting = settings.find(".".join(path))
            values[setting.name] = setting.parse(value)
        except SettingError as error:
            raise document.error(("render", "settings", *path), str(error)) from None
    fields = {name: getattr(render, name) for name in schema.RenderTable.model_fields if name != "settings"}
    return Defaults(**fields, settings=values)


def _leaves(table: dict, prefix: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], object]]:
    """All values of nested tables with their key paths."""
    found = []
    for key, value in table.items():
        found += _leaves(value, (*prefix, key)) if isinstance(value, dict) else [((*prefix, key), value)]
    return found
