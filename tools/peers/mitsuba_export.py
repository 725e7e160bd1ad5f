"""A clcache scene as a Mitsuba 3 scene, to compare with a renderer that shares no code with clcache.

Choose a variant first: `mitsuba.set_variant("llvm_ad_rgb")`, or "scalar_rgb", which needs nothing besides the package.
What maps to what:

- All instances are baked into the world, and triangles gathered by material, so that Mitsuba has as few shapes as can be:
  each further shape or instance costs it time. Normals are baked as the inverse transpose takes them, not normalised:
  both renderers interpolate first and normalise then, which matters under transforms that do not scale evenly.
- Surfaces are two-sided. Mitsuba's area lights shine on one side only, so an emissive triangle becomes two that face away
  from each other, `SHEET_GAP` of the scene's extent apart: a ray always meets the one that faces it first.
- Pictures are decoded here, multiplied with the material's base colour, and handed over as linear float32.
- Mitsuba's camera looks along its own +Z with +X to the left; clcache's along -Z with +X to the right.
- A path has at most `bounces` + 2 segments, none of them ended by roulette.

Where the two differ by definition: a diffuse surface whose interpolated normal departs from its triangle's reflects in
Mitsuba over the hemisphere of the former, in clcache over the part of it that is above the triangle as well. Both tend
to the same image as meshes get finer. Mitsuba's area lights convert densities with the interpolated normal as well, so
that what both emits and reflects on a smooth coarse mesh is a little off there; what only emits is exported flat. The
distance that Mitsuba keeps between a surface and a ray that leaves it is about 1e-4 of the coordinates, and never below
1e-4 scene units: scenes much smaller than one unit do not compare.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from clcache.errors import SceneError
from clcache.resources import srgb_to_linear
from clcache.scene.model import NO_TEXTURE, Camera, DirectionalLight, Material, PointLight, Scene

SHEET_GAP = 2e-5  # of the scene's extent: well above float32's error in distances, far below a pixel
NEAR, FAR = 1e-6, 100.0  # of the scene's extent: Mitsuba wants a near and a far plane
NO_ROULETTE = 1 << 20  # a depth that no path reaches


def to_mitsuba(scene: Scene, size: tuple[int, int], spp: int = 16, bounces: int = 3, seed: int = 0) -> "mi.Scene":
    """The scene with film, sampler and integrator, in the variant that is set; `mitsuba.render` takes it.

    size: width, height in pixels. spp, seed: of the sampler, where `mitsuba.render` is given no others. bounces: as the
    setting pathtrace.bounces. Raises SceneError for what Mitsuba cannot express.
    """
    soups = list(_soups(scene))
    extent = _extent(scene, soups)
    description: dict[str, object] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": bounces + 2, "rr_depth": NO_ROULETTE},
        "sensor": _sensor(scene.camera, extent) | {"film": _film(size), "sampler": _sampler(spp, seed)},
    }
    for soup in soups:
        material = scene.materials[soup.material]
        bsdf = mi.load_dict(_bsdf(scene, material))
        name = f"mesh {len(description)} of {material.name}"
        if any(material.emission):
            for side, sheet in enumerate(soup.sheets(SHEET_GAP * extent)):
                description[f"{name}, side {side}"] = _mesh(name, sheet, bsdf, material.emission)
        else:
            description[name] = _mesh(name, soup, bsdf)
    for index, light in enumerate(scene.lights):
        description[f"light {index}"] = _light(light)
    if any(scene.environment):
        description["environment"] = {"type": "constant", "radiance": _rgb(scene.environment)}
    return mi.load_dict(description)


def render(scene: "mi.Scene", spp: int, seed: int) -> np.ndarray:
    """(H, W, 3) float32, linear: the mean of spp samples for each pixel."""
    return np.array(mi.render(scene, spp=spp, seed=seed), np.float32)


@dataclass(frozen=True)
class Soup:
    """Triangles of one material in the world. positions: (v, 3) float64. triangles: (t, 3). normals: (v, 3), any length, or
    None for flat shading. uvs: (v, 2) or None."""

    material: int
    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None
    uvs: np.ndarray | None

    def sheets(self, gap: float) -> Iterator["Soup"]:
        """The triangles twice, each moved half the gap along its normal: as they are, and turned over."""
        corners = self.positions[self.triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        away = across / np.linalg.norm(across, axis=1, keepdims=True)
        single = np.arange(self.triangles.size).reshape(-1, 3)
        for side in (1, -1):
            moved = (corners + side * gap / 2 * away[:, None]).reshape(-1, 3)
            normals = None if self.normals is None else side * self.normals[self.triangles].reshape(-1, 3)
            uvs = None if self.uvs is None else self.uvs[self.triangles].reshape(-1, 2)
            yield Soup(self.material, moved, single[:, ::side], normals, uvs)


def _soups(scene: Scene) -> Iterator[Soup]:
    """The scene's triangles in the world, by material and by whether normals are interpolated."""
    positions, normals, uvs, triangles, materials, first = [], [], [], [], [], 0
    for instance in scene.instances:
        mesh = scene.meshes[instance.mesh]
        matrix = np.asarray(instance.transform, np.float64)
        count = len(mesh.positions)
        positions.append(mesh.positions @ matrix[:, :3].T + matrix[:, 3])
        normals.append(np.zeros((count, 3)) if mesh.normals is None else mesh.normals @ np.linalg.inv(matrix[:, :3]))
        uvs.append(np.zeros((count, 2)) if mesh.uvs is None else mesh.uvs)
        triangles.append(mesh.triangles.astype(np.int64) + first)
        materials.append(mesh.material)
        first += count
    positions, normals, uvs, triangles = map(np.concatenate, (positions, normals, uvs, triangles))
    material = np.concatenate(materials).astype(np.int64)
    is_lamp = np.array([any(m.emission) and not any(m.base_color) for m in scene.materials])
    # What only emits needs no normals.
    is_smooth = (normals[triangles] != 0).any(axis=2).all(axis=1) & ~is_lamp[material]
    is_textured = np.array([m.base_color_texture != NO_TEXTURE for m in scene.materials])
    for key in np.unique(2 * material + is_smooth):
        index, smooth = int(key) // 2, bool(key % 2)
        used, renumbered = np.unique(triangles[(material == index) & (is_smooth == smooth)], return_inverse=True)
        yield Soup(
            index,
            positions[used],
            renumbered.reshape(-1, 3),
            normals[used] if smooth else None,
            uvs[used] if is_textured[index] else None,
        )


def _extent(scene: Scene, soups: list[Soup]) -> float:
    """The largest side of the box about all that stands in the scene, the camera included."""
    points = np.vstack([soup.positions for soup in soups] + [np.asarray(scene.camera.transform)[None, :, 3]])
    return float(np.ptp(points, axis=0).max())


def _mesh(name: str, soup: Soup, bsdf: "mi.BSDF", radiance: tuple[float, float, float] | None = None) -> "mi.Mesh":
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    if radiance is not None:
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": _rgb(radiance)})
    has_normals, has_uvs = soup.normals is not None, soup.uvs is not None
    mesh = mi.Mesh(name, len(soup.positions), len(soup.triangles), properties, has_normals, has_uvs)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = soup.positions.astype(np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(soup.triangles, np.uint32).ravel()
    if has_normals:
        parameters["vertex_normals"] = soup.normals.astype(np.float32).ravel()
    if has_uvs:
        parameters["vertex_texcoords"] = soup.uvs.astype(np.float32).ravel()
    parameters.update()
    return mesh


def _bsdf(scene: Scene, material: Material) -> dict:
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _base_color(scene, material)}}


def _base_color(scene: Scene, material: Material) -> dict:
    """The material's base colour, as a picture where it has one. Mitsuba's v runs downwards as clcache's does."""
    if material.base_color_texture == NO_TEXTURE:
        return _rgb(material.base_color)
    texture = scene.textures[material.base_color_texture]
    if texture.wrap[0] != texture.wrap[1]:
        raise SceneError(
            f"{scene.file}: texture {texture.name}: wraps {texture.wrap}; Mitsuba has one mode for both axes"
        )
    table = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
    linear = table[texture.pixels[..., :3]] * np.asarray(material.base_color, np.float32)
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(linear)),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": texture.wrap[0],
    }


def _light(light: PointLight | DirectionalLight) -> dict:
    match light:
        case PointLight():
            return {"type": "point", "position": list(light.position), "intensity": _rgb(light.intensity)}
        case DirectionalLight():
            return {
                "type": "directional",
                "direction": list(map(float, light.direction)),
                "irradiance": _rgb(light.irradiance),
            }
    raise SceneError(f"light {light}: not among those that Mitsuba is told of")


def _sensor(camera: Camera, extent: float) -> dict:
    to_world = np.vstack([camera.transform, [0.0, 0.0, 0.0, 1.0]]) @ np.diag([-1.0, 1.0, -1.0, 1.0])
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(to_world),
        "fov": float(np.degrees(camera.fov_y)),
        "fov_axis": "y",
        "near_clip": max(camera.near, NEAR * extent),
        "far_clip": FAR * extent,
    }


def _film(size: tuple[int, int]) -> dict:
    width, height = size
    layout = {"width": width, "height": height, "pixel_format": "rgb", "component_format": "float32"}
    return {"type": "hdrfilm", "rfilter": {"type": "box"}, **layout}


def _sampler(spp: int, seed: int) -> dict:
    return {"type": "independent", "sample_count": spp, "seed": seed}


def _rgb(value: tuple[float, float, float]) -> dict:
    return {"type": "rgb", "value": [float(v) for v in value]}
