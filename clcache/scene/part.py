"""What one file contributes to a scene; its indices count within the part until parts are joined."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from .model import Camera, DirectionalLight, Instance, Light, Material, Mesh, SpotLight, Texture, TextureUse
from .transform import Chain, chain, is_moving, rest_pose, rigid

_MAPS = ("base_color_texture", "metallic_roughness_texture", "emission_texture", "normal_texture")


@dataclass
class Part:
    """Model values as in `Scene`. camera: the file's own, or None. dropped, notes and graph_seconds: as in `Scene`."""

    meshes: list[Mesh] = field(default_factory=list)
    instances: list[Instance] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)
    textures: list[Texture] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    camera: Camera | None = None
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    graph_seconds: float = 0.0

    def add_assets(self, other: "Part") -> int:
        """Append the other part's meshes, materials and textures; returns the index that its first mesh has here."""
        first_mesh, first_material, first_texture = len(self.meshes), len(self.materials), len(self.textures)
        self.textures += other.textures
        self.materials += [_with_textures(m, lambda index: index + first_texture) for m in other.materials]
        self.meshes += [replace(m, material=m.material + np.uint32(first_material)) for m in other.meshes]
        self.dropped += other.dropped
        self.notes += other.notes
        return first_mesh

    def prune(self) -> None:
        """Leave out the meshes that no instance uses, then the materials and textures that no mesh uses, and the alpha
        masks that hide nothing."""
        used, position = _used([i.mesh for i in self.instances], len(self.meshes))
        self.meshes = [self.meshes[n] for n in used]
        self.instances = [replace(i, mesh=int(position[i.mesh])) for i in self.instances]
        counts = [np.bincount(m.material, minlength=len(self.materials)) for m in self.meshes]
        used, position = _used(np.flatnonzero(np.sum(counts, axis=0)), len(self.materials))
        self.materials = [self.materials[n] for n in used]
        self.meshes = [replace(m, material=position[m.material].astype(np.uint32)) for m in self.meshes]
        self.materials = [m if self._hides_something(m) else replace(m, alpha_cutoff=None) for m in self.materials]
        used, position = _used([use.index for m in self.materials for use in _uses(m)], len(self.textures))
        self.textures = [self.textures[n] for n in used]
        self.materials = [_with_textures(m, lambda index: int(position[index])) for m in self.materials]

    def _hides_something(self, material: Material) -> bool:
        if material.alpha_cutoff is None:
            return False
        least = 255
        if material.base_color_texture is not None:
            least = int(self.textures[material.base_color_texture.index].pixels[..., 3].min())
        return material.alpha * least / 255 < material.alpha_cutoff


def _uses(material: Material) -> list[TextureUse]:
    return [*(use for use in (getattr(material, name) for name in _MAPS) if use is not None), *material.graph_textures]


def _with_textures(material: Material, renumber: Callable[[int], int]) -> Material:
    """The material with the indices of its textures passed through `renumber`."""
    uses = {name: getattr(material, name) for name in _MAPS}
    changed = {name: replace(use, index=renumber(use.index)) for name, use in uses.items() if use is not None}
    if material.graph_textures:
        changed["graph_textures"] = tuple(replace(use, index=renumber(use.index)) for use in material.graph_textures)
    return replace(material, **changed) if changed else material


def _used(indices: ArrayLike, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The indices that occur, ascending, and for each of `count` old indices the new one."""
    occurs = np.zeros(count, bool)
    occurs[np.asarray(indices, np.int64)] = True
    return np.flatnonzero(occurs), np.cumsum(occurs) - 1


def place_instance(instance: Instance, outer: Chain) -> Instance:
    """An instance under a chain of transforms, outermost first."""
    motion = chain(*outer, *(instance.motion or (instance.transform,)))
    return replace(instance, transform=rest_pose(motion), motion=motion if is_moving(motion) else ())


def place_light(light: Light, outer: Chain) -> Light:
    """A light under a chain of transforms: its place and direction follow, its strength stays."""
    motion = chain(*outer, *light.motion)
    if is_moving(motion):
        return replace(light, motion=motion)
    pose = rest_pose(motion)
    moved = {}
    if not isinstance(light, DirectionalLight):
        moved["position"] = tuple((pose[:, :3] @ light.position + pose[:, 3]).tolist())
    if isinstance(light, DirectionalLight | SpotLight):
        direction = pose[:, :3] @ light.direction
        moved["direction"] = tuple((direction / np.linalg.norm(direction)).tolist())
    return replace(light, **moved)


def place_camera(camera: Camera, outer: Chain) -> Camera:
    """A camera under a chain of transforms; those may scale its motion, but not the camera."""
    motion = chain(*outer, *(camera.motion or (camera.transform,)))
    return replace(camera, transform=rigid(rest_pose(motion)), motion=motion if is_moving(motion) else ())
