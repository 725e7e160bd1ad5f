"""What a scene is, as plain values and NumPy arrays; nothing here touches files or OpenCL.

Conventions: right-handed, +Y up, metres; a camera looks along its own -Z; radiance is linear Rec. 709 RGB; angles are
in radians; transforms are 3x4, row-major, object to world.
"""

from dataclasses import dataclass, field

import numpy as np

NO_TEXTURE = -1
WRAP_MODES = ("repeat", "clamp", "mirror")


@dataclass(frozen=True)
class Mesh:
    """Triangles in object space.

    positions: (v, 3) float32, finite. triangles: (t, 3) uint32, each below v, none of zero area. material: (t,) uint32,
    an index into `Scene.materials` for each triangle. normals: (v, 3) float32 of unit length, or None for flat shading;
    a row of zeros shades its triangles flat. uvs: (v, 2) float32, or None; v = 0 is the first row of the picture.
    """

    name: str
    positions: np.ndarray
    triangles: np.ndarray
    material: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None


@dataclass(frozen=True)
class Instance:
    """A mesh placed in the world. mesh: index into `Scene.meshes`. transform: (3, 4) float64, object to world."""

    name: str
    mesh: int
    transform: np.ndarray = field(default_factory=lambda: np.eye(4)[:3])


@dataclass(frozen=True)
class Texture:
    """A picture. pixels: (h, w, 4) uint8, RGBA, sRGB-encoded colour, top row first. wrap: of u and of v, each one of
    WRAP_MODES."""

    name: str
    pixels: np.ndarray
    wrap: tuple[str, str] = ("repeat", "repeat")


@dataclass(frozen=True)
class Material:
    """A Lambertian surface, the same on both sides.

    base_color: linear RGB albedo in [0, 1], multiplied with the texture's colour. base_color_texture: index into
    `Scene.textures` or NO_TEXTURE. emission: radiance in W / (m^2 sr), on both sides.
    """

    name: str
    base_color: tuple[float, float, float] = (0.8, 0.8, 0.8)
    base_color_texture: int = NO_TEXTURE
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PointLight:
    """A point that radiates evenly. position: metres. intensity: RGB, W / sr."""

    position: tuple[float, float, float]
    intensity: tuple[float, float, float]


@dataclass(frozen=True)
class DirectionalLight:
    """Parallel light. direction: unit vector along which the light travels. irradiance: RGB on a surface that faces it, W / m^2."""

    direction: tuple[float, float, float]
    irradiance: tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. transform: (3, 4) float64, camera to world, rotation and translation only. fov_y: vertical field
    of view, radians, in (0, pi). near: distance of the near plane along the viewing axis, metres, >= 0."""

    transform: np.ndarray
    fov_y: float
    near: float = 0.0


@dataclass(frozen=True)
class Defaults:
    """What a render uses where the user gives nothing else. frames: half-open range. eye_distance: metres between the
    eyes. settings: dotted name -> value, as for --set."""

    size: tuple[int, int] = (640, 360)
    frames: tuple[int, int] = (0, 1)
    fps: float = 30.0
    stereo: bool = False
    eye_distance: float = 0.063
    spp: int | None = None
    seed: int | None = None
    method: str | None = None
    settings: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Scene:
    """All that a render needs to know of the world. file: as given by the user. dropped: what the loader left out and
    how much of it, e.g. {"zero-area triangles": 425}. notes: sentences that tell the user what the loader chose for them
    (a framing camera, a default light, materials that it could only approximate)."""

    file: str
    meshes: tuple[Mesh, ...]
    instances: tuple[Instance, ...]
    materials: tuple[Material, ...]
    textures: tuple[Texture, ...]
    lights: tuple[PointLight | DirectionalLight, ...]
    environment: tuple[float, float, float]
    camera: Camera
    defaults: Defaults = field(default_factory=Defaults)
    dropped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def triangle_count(self) -> int:
        """Triangles of all instances together."""
        return sum(len(self.meshes[i.mesh].triangles) for i in self.instances)
