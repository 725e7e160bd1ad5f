"""What one file contributes to a scene; its indices count within the part until parts are joined."""

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from .model import NO_TEXTURE, Camera, DirectionalLight, Instance, Material, Mesh, PointLight, Texture


@dataclass
class Part:
    """Model values as in `Scene`. camera: the file's own, or None. dropped and notes: as in `Scene`."""

    meshes: list[Mesh] = field(default_factory=list)
    instances: list[Instance] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)
    textures: list[Texture] = field(default_factory=list)
    lights: list[PointLight | DirectionalLight] = field(default_factory=list)
    camera: Camera | None = None
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def add_assets(self, other: "Part") -> int:
        """Append the other part's meshes, materials and textures; returns the index that its first mesh has here."""
        first_mesh, first_material, first_texture = len(self.meshes), len(self.materials), len(self.textures)
        self.textures += other.textures
        self.materials += [
            m
            if m.base_color_texture == NO_TEXTURE
            else replace(m, base_color_texture=m.base_color_texture + first_texture)
            for m in other.materials
        ]
        self.meshes += [replace(m, material=m.material + np.uint32(first_material)) for m in other.meshes]
        self.dropped += other.dropped
        self.notes += other.notes
        return first_mesh

    def prune(self) -> None:
        """Leave out the meshes that no instance uses, then the materials and textures that no mesh uses."""
        used, position = _used([i.mesh for i in self.instances], len(self.meshes))
        self.meshes = [self.meshes[n] for n in used]
        self.instances = [replace(i, mesh=int(position[i.mesh])) for i in self.instances]
        counts = [np.bincount(m.material, minlength=len(self.materials)) for m in self.meshes]
        used, position = _used(np.flatnonzero(np.sum(counts, axis=0)), len(self.materials))
        self.materials = [self.materials[n] for n in used]
        self.meshes = [replace(m, material=position[m.material].astype(np.uint32)) for m in self.meshes]
        textured = [m.base_color_texture for m in self.materials if m.base_color_texture != NO_TEXTURE]
        used, position = _used(textured, len(self.textures))
        self.textures = [self.textures[n] for n in used]
        self.materials = [
            m
            if m.base_color_texture == NO_TEXTURE
            else replace(m, base_color_texture=int(position[m.base_color_texture]))
            for m in self.materials
        ]


def _used(indices: ArrayLike, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The indices that occur, ascending, and for each of `count` old indices the new one."""
    occurs = np.zeros(count, bool)
    occurs[np.asarray(indices, np.int64)] = True
    return np.flatnonzero(occurs), np.cumsum(occurs) - 1


def place_light(light: PointLight | DirectionalLight, transform: np.ndarray) -> PointLight | DirectionalLight:
    """A light under a (3, 4) transform: its place or direction follows, its strength stays."""
    if isinstance(light, PointLight):
        return replace(light, position=tuple((transform[:, :3] @ light.position + transform[:, 3]).tolist()))
    direction = transform[:, :3] @ light.direction
    return replace(light, direction=tuple((direction / np.linalg.norm(direction)).tolist()))
