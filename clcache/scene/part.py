"""What one file contributes to a scene; its indices count within the part until parts are joined."""

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

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


def place_light(light: PointLight | DirectionalLight, transform: np.ndarray) -> PointLight | DirectionalLight:
    """A light under a (3, 4) transform: its place or direction follows, its strength stays."""
    if isinstance(light, PointLight):
        return replace(light, position=tuple((transform[:, :3] @ light.position + transform[:, 3]).tolist()))
    direction = transform[:, :3] @ light.direction
    return replace(light, direction=tuple((direction / np.linalg.norm(direction)).tolist()))
