"""TOML scene files: read, checked by the schema, and turned into a `Part` and what only such a file can say.

The standard parser gives values without their lines, so that the file is parsed once more by a syntax-tree parser, whose
nodes know where they stand; a map from each key's path to its line serves the error messages.
"""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

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

KeyPath = tuple[str | int, ...]

_MAPS = {
    "base_color_texture": True,
    "metallic_roughness_texture": False,
    "emission_texture": True,
    "normal_texture": False,
}


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
    materials = _add_materials(part, table, document, path, folder)
    sources = _load_meshes(table, document, path, folder, load_file)
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


def _add_materials(
    part: Part, table: schema.SceneTable, document: _Document, path: Path, folder: Folder
) -> dict[str, int]:
    """Add the file's materials and textures; returns the materials' indices by name."""
    textures: dict[tuple, int] = {}

    def use(source: schema.TextureTable | None, key: KeyPath, srgb: bool) -> TextureUse | None:
        if source is None:
            return None
        where = document.where(_path_in_file(document.data, (*key, "file")))
        file = folder.find(source.file, path, where)
        kind = (file, srgb, source.wrap)
        if kind not in textures:
            textures[kind] = len(part.textures)
            pixels = read_picture(file, f"{where}: {source.file!r}")
            part.textures.append(Texture(source.file, pixels, srgb, source.wrap))
        return TextureUse(textures[kind], uv_transform(source.offset, math.radians(source.rotation), source.scale))

    indices = {}
    for name, material in table.materials.items():
        indices[name] = len(part.materials)
        fields = {field: getattr(material, field) for field in schema.MaterialTable.model_fields}
        maps = {field: use(fields[field], ("materials", name, field), srgb) for field, srgb in _MAPS.items()}
        part.materials.append(Material(name, **(fields | maps | {"specular": material.reflection})))
    return indices


def _load_meshes(
    table: schema.SceneTable, document: _Document, path: Path, folder: Folder, load_file: Callable[[Path, str], Part]
) -> dict[str, Part]:
    """Each mesh that an instance uses, as a part."""
    sources = {}
    for name, source in table.meshes.items():
        if not any(instance.mesh == name for instance in table.instances):
            continue
        if isinstance(source, schema.FileMesh):
            where = document.where(("meshes", name, "file"))
            file = folder.find(source.file, path, where)
            if file.suffix.lower() == ".toml":
                raise document.error(("meshes", name, "file"), f"{source.file!r} is a scene; expected a mesh file")
            sources[name] = load_file(file, source.file)
            if not source.animated:
                _stop(sources[name])
        else:
            sources[name] = _generated(source, name, document)
    return sources


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
    part: Part, table: schema.SceneTable, document: _Document, materials: dict[str, int], sources: dict[str, Part]
) -> None:
    first_mesh: dict[str, int] = {}
    painted: dict[tuple[int, int], int] = {}
    for index, instance in enumerate(table.instances):
        here: KeyPath = ("instances", index)
        if instance.mesh not in table.meshes:
            raise document.error((*here, "mesh"), _unknown(instance.mesh, table.meshes, "meshes"))
        if instance.material is not None and instance.material not in materials:
            raise document.error((*here, "material"), _unknown(instance.material, materials, "materials"))
        motion = _instance_motion(instance, document, here)
        source = sources[instance.mesh]
        if instance.mesh not in first_mesh:
            first_mesh[instance.mesh] = part.add_assets(source)
        for inner in source.instances:
            mesh = first_mesh[instance.mesh] + inner.mesh
            if instance.material is not None:
                mesh = _painted(part, painted, mesh, materials[instance.material])
            part.instances.append(place_instance(replace(inner, mesh=mesh), motion))
        part.lights += [place_light(light, motion) for light in source.lights]
        if part.camera is None and source.camera is not None:
            part.camera = place_camera(source.camera, motion)


def _painted(part: Part, painted: dict[tuple[int, int], int], mesh: int, material: int) -> int:
    """The index of a mesh that shares the arrays of `mesh` but is of one material all over."""
    if (mesh, material) not in painted:
        painted[mesh, material] = len(part.meshes)
        original = part.meshes[mesh]
        part.meshes.append(replace(original, material=np.full_like(original.material, material)))
    return painted[mesh, material]


def _unknown(name: str, known: dict[str, object], table: str) -> str:
    return f"no {name!r} in [{table}]; expected one of " + (", ".join(known) or "none, the table is empty")


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
