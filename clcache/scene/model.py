"""What a scene is, as plain values and NumPy arrays; nothing here touches files or OpenCL.

Conventions: right-handed, +Y up, metres; a camera looks along its own -Z; radiance is linear Rec. 709 RGB; angles are
in radians; transforms are 3x4, row-major, object to world.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..graph import CompiledGraph

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
    """A mesh placed in the world. mesh: index into `Scene.meshes`. transform: (3, 4) float64, object to world, at rest.
    motion: the chain of transforms from the world down to the object where any of them moves, each a Track or a fixed
    (3, 4) matrix; it then replaces `transform`."""

    name: str
    mesh: int
    transform: np.ndarray = field(default_factory=lambda: np.eye(4)[:3])
    motion: tuple = ()


@dataclass(frozen=True)
class Texture:
    """A picture. pixels: (h, w, 4) uint8, RGBA, top row first. srgb: whether RGB is encoded colour, or plain numbers. wrap:
    of u and of v, each one of WRAP_MODES."""

    name: str
    pixels: np.ndarray
    srgb: bool = True
    wrap: tuple[str, str] = ("repeat", "repeat")


@dataclass(frozen=True)
class TextureUse:
    """A texture as a material uses it. index: into `Scene.textures`. transform: (2, 3) row-major, from the mesh's texture
    coordinates to the picture's."""

    index: int
    transform: tuple[float, float, float, float, float, float] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Material:
    """A metallic-roughness surface, as glTF 2.0 and its extensions define it (`cl/common/bsdf.cl`).

    base_color: linear RGB in [0, 1], multiplied with its texture's colour. alpha: multiplied with that texture's alpha;
    where the product is below alpha_cutoff there is no surface (None: opaque everywhere). metallic, roughness: in [0, 1],
    multiplied with their texture's blue and green. specular: strength of the dielectric reflection, 0 (Lambertian) to 1;
    specular_color: its tint at normal incidence. ior: refractive index, >= 1. transmission: part of the light that enters a
    dielectric that goes through; thin: it passes straight, instead of being refracted into the body behind. emission:
    radiance in W / (m^2 sr), multiplied with its texture's colour. normal_texture: tangent-space normals, x and y
    multiplied by normal_scale. double_sided: whether its back reflects and emits as the front does; a single-sided one
    is black from behind (unless it transmits). graph: what computes some of these for each hit, in place of the values
    and textures here; what it emits is found by rays only. graph_textures: the uses of textures that the graph's image
    nodes number.
    """

    name: str
    base_color: tuple[float, float, float] = (0.8, 0.8, 0.8)
    base_color_texture: TextureUse | None = None
    alpha: float = 1.0
    alpha_cutoff: float | None = None
    metallic: float = 0.0
    roughness: float = 1.0
    metallic_roughness_texture: TextureUse | None = None
    specular: float = 0.0
    specular_color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ior: float = 1.5
    transmission: float = 0.0
    thin: bool = False
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emission_texture: TextureUse | None = None
    normal_texture: TextureUse | None = None
    normal_scale: float = 1.0
    double_sided: bool = True
    graph: "CompiledGraph | None" = None
    graph_textures: tuple[TextureUse, ...] = ()

    @property
    def driven(self) -> frozenset[str]:
        """The names of what the graph computes."""
        return frozenset(self.graph.outputs) if self.graph else frozenset()

    @property
    def is_emissive(self) -> bool:
        """Whether it may emit light."""
        return any(self.emission) or "emission" in self.driven


@dataclass(frozen=True)
class PointLight:
    """A point that radiates evenly. position: metres. intensity: RGB, W / sr. motion: as of an Instance; the position is
    then in the space that it moves."""

    position: tuple[float, float, float]
    intensity: tuple[float, float, float]
    motion: tuple = ()


@dataclass(frozen=True)
class SpotLight:
    """A point that radiates into a cone (KHR_lights_punctual). direction: unit vector of its axis. intensity: RGB on the
    axis, W / sr. inner_angle, outer_angle: radians from the axis; between them the intensity falls to 0. motion: as of a
    PointLight."""

    position: tuple[float, float, float]
    direction: tuple[float, float, float]
    intensity: tuple[float, float, float]
    inner_angle: float
    outer_angle: float
    motion: tuple = ()


@dataclass(frozen=True)
class DirectionalLight:
    """Parallel light. direction: unit vector along which the light travels. irradiance: RGB on a surface that faces it,
    W / m^2. motion: as of a PointLight."""

    direction: tuple[float, float, float]
    irradiance: tuple[float, float, float]
    motion: tuple = ()


Light = PointLight | SpotLight | DirectionalLight


@dataclass(frozen=True)
class Environment:
    """Light from infinitely far away. radiance: (h, w, 3) float32, an equirectangular picture: its top row is up (+Y), its
    centre is -Z, its right half is +X; a constant environment is a picture of one pixel."""

    radiance: np.ndarray = field(default_factory=lambda: np.zeros((1, 1, 3), np.float32))

    @classmethod
    def constant(cls, color: tuple[float, float, float]) -> "Environment":
        """The same radiance from everywhere."""
        return cls(np.array([[color]], np.float32))


@dataclass(frozen=True)
class Track:
    """Key-framed poses. times: (k,) float64, seconds, ascending. translation: (k, 3). rotation: (k, 4), unit quaternions
    x, y, z, w. scale: (k, 3). Before the first key and after the last the pose stands still; between keys translation and
    scale are linear, rotation spherical linear; where `step`, each key holds until the next."""

    times: np.ndarray
    translation: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    step: bool = False


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. transform: (3, 4) float64, camera to world, rotation and translation only. fov_y: vertical field
    of view, radians, in (0, pi). near: distance of the near plane along the viewing axis, metres, >= 0. motion: as of an
    Instance, camera to world."""

    transform: np.ndarray
    fov_y: float
    near: float = 0.0
    motion: tuple = ()


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
    (a framing camera, a default light, materials that it could only approximate). graph_seconds: what reading and
    compiling the materials' graphs took."""

    file: str
    meshes: tuple[Mesh, ...]
    instances: tuple[Instance, ...]
    materials: tuple[Material, ...]
    textures: tuple[Texture, ...]
    lights: tuple[Light, ...]
    environment: Environment
    camera: Camera
    defaults: Defaults = field(default_factory=Defaults)
    dropped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    graph_seconds: float = 0.0

    @property
    def triangle_count(self) -> int:
        """Triangles of all instances together."""
        return sum(len(self.meshes[i.mesh].triangles) for i in self.instances)
