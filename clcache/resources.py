"""A scene on a device: its trees, and the arrays that passes shade from; what it lacks is not there."""

import numpy as np
import pyopencl.array as cl_array

from .bvh.build import SceneTrees
from .bvh.tracer import RayKernels
from .device import Device
from .layout import STRUCTS
from .scene.geometry import Geometry
from .scene.model import NO_TEXTURE, WRAP_MODES, PointLight, Scene


class SceneResources:
    """Upload a scene, once for all its eyes and frames. `features` are the defines that kernels are specialised by.

    Raises DeviceError if the scene does not fit the device's memory.
    """

    def __init__(self, device: Device, scene: Scene):
        geometry = Geometry.of(scene)
        is_textured = any(m.base_color_texture != NO_TEXTURE for m in scene.materials)
        self.features = {
            "HAS_NORMALS": geometry.normals is not None,
            "HAS_TEXTURES": is_textured,
            "HAS_LIGHTS": bool(scene.lights),
            "HAS_EMISSION": any(scene.environment) or any(any(m.emission) for m in scene.materials),
        }
        self.environment = scene.environment
        self.trees = SceneTrees(device, geometry)
        self.rays = RayKernels(device, self.trees)
        self.material = device.upload(geometry.material, "material of each triangle")
        self.materials = device.upload(_material_records(scene), "materials")
        self.normals = device.upload(geometry.normals, "normals") if self.features["HAS_NORMALS"] else None
        self.lights = device.upload(_light_records(scene), "lights") if scene.lights else None
        self.uvs = self.textures = self.texels = self.srgb = None
        if is_textured:
            self.uvs = device.upload(_uvs(geometry), "texture coordinates")
            self.textures = device.upload(_texture_records(scene), "textures")
            self.texels = device.upload(_texels(scene), "texels")
            self.srgb = device.upload(srgb_to_linear(np.arange(256) / 255).astype(np.float32), "sRGB table")

    @property
    def light_count(self) -> int:
        """Lights that are sampled."""
        return 0 if self.lights is None else self.lights.shape[0]

    @property
    def texture_bytes(self) -> int:
        """What pictures take on the device."""
        return 0 if self.texels is None else self.texels.nbytes + self.textures.nbytes

    def surface_arrays(self) -> tuple[cl_array.Array | None, ...]:
        """What the kernel `surface` reads of the scene, in its order."""
        t = self.trees
        geometry = (t.positions, t.triangles, self.material, self.normals, self.uvs, t.instances)
        return *geometry, self.materials, self.textures, self.texels, self.srgb


def _uvs(geometry: Geometry) -> np.ndarray:
    """Texture coordinates; (0, 0) where a mesh has none."""
    return np.zeros((len(geometry.positions), 2), np.float32) if geometry.uvs is None else geometry.uvs


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """Decode values in [0, 1] by the transfer function of IEC 61966-2-1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _material_records(scene: Scene) -> np.ndarray:
    records = np.zeros(len(scene.materials), STRUCTS["Material"])
    for record, material in zip(records, scene.materials, strict=True):
        record["base_color"], record["texture"] = material.base_color, material.base_color_texture
        record["emission"] = material.emission
    return records


def _light_records(scene: Scene) -> np.ndarray:
    records = np.zeros(len(scene.lights), STRUCTS["Light"])
    for record, light in zip(records, scene.lights, strict=True):
        if isinstance(light, PointLight):
            record["vector"], record["kind"], record["power"] = light.position, 0, light.intensity
        else:
            record["vector"], record["kind"], record["power"] = -np.asarray(light.direction), 1, light.irradiance
    return records


def _texture_records(scene: Scene) -> np.ndarray:
    records = np.zeros(len(scene.textures), STRUCTS["Texture"])
    first = 0
    for record, texture in zip(records, scene.textures, strict=True):
        height, width = texture.pixels.shape[:2]
        record["first_texel"], record["width"], record["height"] = first, width, height
        record["wrap"] = [WRAP_MODES.index(mode) for mode in texture.wrap]
        first += width * height
    return records


def _texels(scene: Scene) -> np.ndarray:
    return np.concatenate([np.ascontiguousarray(t.pixels).reshape(-1, 4).view("<u4")[:, 0] for t in scene.textures])
