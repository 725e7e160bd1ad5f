"""A scene on a device: its trees, and the arrays that passes shade from; what it lacks is not there."""

import hashlib
import time
from collections.abc import Mapping

import numpy as np
import pyopencl.array as cl_array

from . import graph
from .bvh.build import SceneTrees, instance_records
from .bvh.tracer import RayKernels
from .device import Device
from .layout import STRUCTS
from .scene.emitters import Emitters, picture_density, picture_shares
from .scene.geometry import Geometry
from .scene.model import WRAP_MODES, Scene, Texture, TextureUse
from .scene.motion import key_times, pose_at
from .scene.textures import mip_chain, srgb_to_linear

_NONE = 0xFFFFFFFF  # as in cl/common/math.cl
_MOST_EYES = 256  # places that stand for the camera's path
_LEAST_TEXELS = 16  # along what a graph's texture coordinates or places cover, for however wide a cone
_LEVELS = 24  # of texels, as in cl/memo/key.cl: from minus this on


class SceneResources:
    """Upload a scene, once for all its eyes and frames. `features` are the defines that kernels are specialised by.

    graphs: the graphs of its materials, each once, numbered as `Material` records number them. graph_source: OpenCL C that
    evaluates them, as `clcache.graph.emit` makes it. graph_channels: the most values that one of them computes. graph_seconds:
    what reading and compiling them took. geometry: the meshes, and the instances where they are now. is_static: (instances,) bool,
    which of them never move. lighting: (2,) uint32, a digest of the emitters and the instances' places as
    they are now: the same for the same scene and time in every process, and another where light is another.

    Raises DeviceError if the scene does not fit the device's memory.
    """

    def __init__(self, device: Device, scene: Scene):
        self._device, self._scene, self.file = device, scene, scene.file
        self._keeps_before = False
        self.geometry = geometry = Geometry.of(scene)
        self.is_static = np.array([not i.motion for i in scene.instances])
        emitters = Emitters.of(scene, geometry)
        self.features = features(scene, geometry, emitters)
        self.trees = SceneTrees(device, geometry, ~self.is_static)
        self.arrays: dict[str, cl_array.Array] = {}
        self._upload(device, positions=geometry.positions, triangles=geometry.triangles)
        self._upload(device, instances=_instances(geometry), is_static=self.is_static.astype(np.uint8))
        uses: list[TextureUse] = []
        self._material_records = _material_records(scene, emitters, uses)
        self._add_graphs(scene, uses)
        self._upload(device, material=geometry.material, materials=self._material_records)
        if self.features["HAS_NORMALS"]:
            self._upload(device, normals=geometry.normals)
        if self.features["HAS_TEXTURES"]:
            self._upload(device, uvs=_uvs(geometry), uses=_use_records(uses), **_texture_arrays(scene))
        if self.graphs:
            self._upload(device, graph_coarsest=_coarsest_levels(self._graph_extents()))
        if self.features["HAS_DIRECT"]:
            self._upload(device, emitter_list=emitters.records, shares=emitters.shares)
        self._upload_environment(device, scene, emitters)
        self.lighting = _lighting(emitters, geometry)
        has_alpha, has_textures = self.features["HAS_ALPHA"], self.features["HAS_TEXTURES"]
        self.rays = RayKernels(device, self.trees, self.arrays, has_alpha, has_textures)

    def _add_graphs(self, scene: Scene, uses: list[TextureUse]) -> None:
        """Number the graphs in the materials' records; the textures' uses that their image nodes name are appended to `uses`."""
        start = time.perf_counter()
        numbers: dict[tuple, int] = {}
        graphs, first_uses = [], []
        for record, material in zip(self._material_records, scene.materials, strict=True):
            record["graph"], record["outputs"] = -1, -1
            if material.graph is None:
                continue
            same = (material.graph.source, *material.graph.outputs.items(), *material.graph_textures)
            if same not in numbers:
                numbers[same] = len(graphs)
                graphs.append(material.graph)
                first_uses.append(len(uses))
                uses += material.graph_textures
            record["graph"], record["outputs"] = numbers[same], _places(material.graph.outputs)
        numbered = [range(first, first + len(g.graph.textures)) for g, first in zip(graphs, first_uses, strict=True)]
        self.graphs = tuple(graphs)
        self.graph_source = graph.emit(graphs, numbered) if graphs else ""
        self.graph_channels = max((g.channels for g in graphs), default=0)
        self.graph_seconds = scene.graph_seconds + time.perf_counter() - start

    def keep_before(self) -> None:
        """Keep `instances_before` in the arrays: from each call of `set_time` on, the instances as they were at the call before."""
        if not self._keeps_before:
            self._keeps_before = True
            self._upload(self._device, instances_before=self.arrays["instances"].get())

    def set_time(self, time: float) -> None:
        """Put what moves where it is at a time, in seconds. The tree over the instances is rebuilt only if one of them moved
        since the last call."""
        scene, before = self._scene, self.geometry
        self.geometry = geometry = before.at(scene, time)
        if self._keeps_before and any(i.motion for i in scene.instances):
            self._replace(instances_before=self.arrays["instances"].get())
        if geometry is not before:
            self.trees.move(geometry)
            self._replace(instances=_instances(geometry))
        if geometry is not before or any(light.motion for light in scene.lights):
            emitters = Emitters.of(scene, geometry, time)
            if self.features["HAS_DIRECT"]:
                self._replace(emitter_list=emitters.records, shares=emitters.shares)
            self._material_records["emitter_density"] = emitters.material_density
            self._replace(materials=self._material_records)
            self.environment["chance"] = emitters.sky_chance
            self.lighting = _lighting(emitters, geometry)

    def has_first_hits(self, layers: np.ndarray) -> bool:
        """Whether all first hits, packed as `cl/scene/first_hit.cl` says, are of triangles and materials that there are. layers:
        (n, m, 4) uint32."""
        geometry, materials = self.geometry, self.arrays["materials"].size
        triangles = np.diff(geometry.first_triangle)[geometry.instance_mesh]
        for x, y, primitive, instance in np.moveaxis(layers, -1, 1):  # one by one, for the sake of memory
            is_far, is_known = instance == _NONE, instance < len(triangles)
            known = triangles[np.where(is_known, instance, 0)]
            if not ((x >> 24 | y >> 24 << 8) < materials).all() or not (is_far | is_known & (primitive < known)).all():
                return False
        return True

    def _replace(self, **arrays: np.ndarray) -> None:
        self._device.queue.finish()
        self._device.release(*(self.arrays.pop(name) for name in arrays if name in self.arrays))
        self._upload(self._device, **arrays)

    @property
    def defines(self) -> dict[str, int]:
        """What kernels over paths are specialised by: the features, the channels of graphs, and the steps of each binary search."""
        searched = {
            "EMITTER_STEPS": self.emitter_count,
            "SKY_ROW_STEPS": int(self.environment["height"]),
            "SKY_COLUMN_STEPS": int(self.environment["width"]),
        }
        channels = {"GRAPH_CHANNELS": self.graph_channels} if self.graphs else {}
        return self.features | channels | {name: max(count - 1, 0).bit_length() for name, count in searched.items()}

    def _graph_extents(self) -> np.ndarray:
        """(graphs, 2) float64: how far texture coordinates, and places within the object, reach over the triangles that have each graph;
        the larger extent along the axes."""
        geometry, graphs = self.geometry, np.arange(len(self.graphs))
        graph = self._material_records["graph"][geometry.material]
        extents = np.zeros((len(graphs), 2))
        for column, values in enumerate((_uvs(geometry), geometry.positions)):
            for axis in values.T.astype(np.float64):
                low, high = np.full(len(graphs), np.inf), np.full(len(graphs), -np.inf)
                has_graph = graph >= 0
                corners = axis[geometry.triangles[has_graph]]
                np.minimum.at(low, graph[has_graph], corners.min(1))
                np.maximum.at(high, graph[has_graph], corners.max(1))
                extents[:, column] = np.maximum(extents[:, column], np.maximum(high - low, 0))
        return extents

    @property
    def graph_materials(self) -> list[list[str]]:
        """The names of the materials of each graph."""
        numbers = self._material_records["graph"]
        return [
            [m.name for m, n in zip(self._scene.materials, numbers, strict=True) if n == g]
            for g in range(len(self.graphs))
        ]

    def graph_triangles(self) -> list[np.ndarray]:
        """By graph, of the triangles whose materials have it: (k, 2) uint32, the first instance that has the triangle's mesh, and the
        triangle within that."""
        geometry = self.geometry
        graph = self._material_records["graph"][geometry.material]
        mesh = np.repeat(np.arange(len(geometry.first_triangle) - 1), np.diff(geometry.first_triangle))
        placed, first_instance = np.unique(geometry.instance_mesh, return_index=True)
        instance_of_mesh = np.full(len(geometry.first_triangle) - 1, -1)
        instance_of_mesh[placed] = first_instance
        found = np.column_stack([instance_of_mesh[mesh], np.arange(len(mesh)) - geometry.first_triangle[mesh]])
        shown = np.flatnonzero((graph >= 0) & (found[:, 0] >= 0))
        in_order = shown[np.argsort(graph[shown], kind="stable")]
        ends = np.searchsorted(graph[in_order], np.arange(len(self.graphs) + 1))
        return [found[in_order[i:j]].astype(np.uint32) for i, j in zip(ends[:-1], ends[1:], strict=True)]

    @property
    def eyes(self) -> np.ndarray:
        """(k, 3) float64: places along the camera's path."""
        return eyes_of(self._scene)

    def instance_size(self, instance: int) -> float:
        """How large an instance is, in metres: the diagonal of its box."""
        geometry = self.geometry
        low, high = np.split(geometry.mesh_bounds[:, geometry.instance_mesh[instance]], 2)
        return float(np.linalg.norm(geometry.to_world[instance, :, :3] @ (high - low)))

    @property
    def emitter_count(self) -> int:
        """Emitters that are sampled."""
        return self.arrays["emitter_list"].size if "emitter_list" in self.arrays else 0

    @property
    def texture_bytes(self) -> int:
        """What pictures take on the device, the environment's and all mip levels included."""
        pictures = ("texels", "textures", "uses", "sky", "sky_rows", "sky_columns", "sky_density", "sky_edges")
        return sum(self.arrays[name].nbytes for name in pictures if name in self.arrays)

    def _upload(self, device: Device, **arrays: np.ndarray) -> None:
        self.arrays |= {name: device.upload(values, name) for name, values in arrays.items()}

    def _upload_environment(self, device: Device, scene: Scene, emitters: Emitters) -> None:
        picture = scene.environment.radiance
        height, width = picture.shape[:2]
        environment = np.zeros((), STRUCTS["Environment"])
        environment["width"], environment["height"], environment["chance"] = width, height, emitters.sky_chance
        self.environment = environment[()]
        self._upload(device, sky=picture.reshape(-1, 3).astype(np.float32))
        if self.features["HAS_SKY_PICTURE"]:
            rows, columns = picture_shares(picture)
            density = picture_density(rows, columns)
            edges = np.cos(np.pi * np.arange(height + 1) / height).astype(np.float32)
            self._upload(device, sky_rows=rows, sky_columns=columns.reshape(-1))
            self._upload(device, sky_density=density.reshape(-1), sky_edges=edges)


def _texture_arrays(scene: Scene) -> dict[str, np.ndarray]:
    """Records of the textures, their texels with all mip levels, and the table that decodes colour. There is one texture at
    least, be it that no material uses it."""
    pictures = scene.textures or (Texture("none", np.zeros((1, 1, 4), np.uint8)),)
    chains = [mip_chain(t) for t in pictures]
    records = np.zeros(len(chains), STRUCTS["Texture"])
    sizes = [sum(level.shape[0] * level.shape[1] for level in chain) for chain in chains]
    for record, chain, first in zip(records, chains, np.cumsum([0, *sizes[:-1]]), strict=True):
        texels_before = np.cumsum([0, *(level.shape[0] * level.shape[1] for level in chain[:-1])])
        record["first_texel"][: len(chain)] = first + texels_before
    records["height"], records["width"] = np.array([chain[0].shape[:2] for chain in chains]).T
    records["levels"] = [len(chain) for chain in chains]
    records["wrap"] = [[WRAP_MODES.index(mode) for mode in t.wrap] for t in pictures]
    records["srgb"] = [t.srgb for t in pictures]
    texels = [np.ascontiguousarray(level).reshape(-1, 4).view("<u4")[:, 0] for chain in chains for level in chain]
    table = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
    return {"textures": records, "texels": np.concatenate(texels), "srgb": table}


def _coarsest_levels(extents: np.ndarray) -> np.ndarray:
    """The levels at which there are as many texels as there must be along an extent. int32, of the same shape."""
    with np.errstate(divide="ignore"):
        levels = np.ceil(np.log2(_LEAST_TEXELS / extents))
    return np.where(extents > 0, np.clip(levels, -_LEVELS, _LEVELS), -_LEVELS).astype(np.int32)


def eyes_of(scene: Scene) -> np.ndarray:
    """(k, 3) float64: places along the path of a scene's camera."""
    camera = scene.camera
    times = key_times(camera.motion)
    times = times[:: -(-len(times) // _MOST_EYES)]
    poses = [pose_at(camera.motion, time) for time in times] if camera.motion else [camera.transform]
    return np.array(poses, np.float64)[:, :3, 3]


def _lighting(emitters: Emitters, geometry: Geometry) -> np.ndarray:
    """(2,) uint32: a digest of all that light depends on and that can change with time."""
    found = hashlib.blake2b(digest_size=8)
    for values in (emitters.records, emitters.shares, geometry.to_world):
        found.update(np.ascontiguousarray(values).tobytes())
    return np.frombuffer(found.digest(), "<u4").astype(np.uint32)


def _instances(geometry: Geometry) -> np.ndarray:
    return instance_records(geometry, np.arange(len(geometry.instance_mesh), dtype=np.uint32))


def _uvs(geometry: Geometry) -> np.ndarray:
    """Texture coordinates; (0, 0) where a mesh has none."""
    return np.zeros((len(geometry.positions), 2), np.float32) if geometry.uvs is None else geometry.uvs


def features(scene: Scene, geometry: Geometry, emitters: Emitters) -> dict[str, bool]:
    """What the scene uses, by the defines that compile it in."""
    materials = scene.materials
    maps = ("base_color", "metallic_roughness", "emission", "normal")
    has_maps = {name: any(getattr(m, f"{name}_texture") is not None for m in materials) for name in maps}
    is_emissive = any(m.is_emissive for m in materials)
    has_graphs = any(m.graph for m in materials)
    driven = frozenset().union(*(m.driven for m in materials))
    has_maps["normal"] |= "normal" in driven
    is_specular = any(m.specular > 0 or m.metallic > 0 or m.transmission > 0 for m in materials)
    sky = scene.environment.radiance
    return {
        "HAS_NORMALS": geometry.normals is not None,
        "HAS_GRAPHS": has_graphs,
        "HAS_TEXTURES": any(has_maps.values()) or has_graphs,
        **{f"HAS_{name.upper()}_MAPS": is_used for name, is_used in has_maps.items()},
        "HAS_ALPHA": any(m.alpha_cutoff for m in materials),
        "HAS_LAMP_HOLES": any(m.alpha_cutoff and any(m.emission) for m in materials),
        "HAS_SPECULAR": is_specular or bool(driven & {"specular", "metallic"}),
        "HAS_TRANSMISSION": any(m.transmission > 0 for m in materials),
        "HAS_EMISSIVE": is_emissive,
        "HAS_EMISSION": is_emissive or bool(sky.any()),
        "HAS_SKY_PICTURE": sky.shape[:2] != (1, 1) and bool(sky.any()),
        "HAS_DIRECT": len(emitters.records) > 0,
        "HAS_PUNCTUAL": bool(scene.lights) and len(emitters.records) > 0,
    }


def _places(outputs: Mapping[str, int]) -> list[int]:
    """Where each of graph.OUTPUTS begins among a graph's values, which have the same order; -1 where it is not one of them."""
    first = dict(zip(outputs, np.cumsum([0, *outputs.values()]).tolist(), strict=False))
    return [first.get(name, -1) for name in graph.OUTPUTS]


def _material_records(scene: Scene, emitters: Emitters, uses: list[TextureUse]) -> np.ndarray:
    """One record for each material; the uses of textures that they name are appended to `uses`."""
    records = np.zeros(len(scene.materials), STRUCTS["Material"])
    plain = (
        *("base_color", "alpha", "metallic", "roughness", "specular", "specular_color", "ior"),
        *("transmission", "thin", "emission", "normal_scale", "double_sided"),
    )
    for record, material in zip(records, scene.materials, strict=True):
        for name in plain:
            record[name] = getattr(material, name)
        record["alpha_cutoff"] = material.alpha_cutoff or 0.0
        record["base_color_map"] = _add_use(uses, material.base_color_texture)
        record["metallic_roughness_map"] = _add_use(uses, material.metallic_roughness_texture)
        record["emission_map"] = _add_use(uses, material.emission_texture)
        record["normal_map"] = _add_use(uses, material.normal_texture)
    records["emitter_density"] = emitters.material_density
    return records


def _add_use(uses: list[TextureUse], use: TextureUse | None) -> int:
    if use is None:
        return -1
    uses.append(use)
    return len(uses) - 1


def _use_records(uses: list[TextureUse]) -> np.ndarray:
    records = np.zeros(max(len(uses), 1), STRUCTS["TextureUse"])
    for record, use in zip(records, uses, strict=False):
        record["texture"], record["transform"] = use.index, use.transform
    return records
