"""A clcache scene as a Mitsuba 3 scene, to compare with a renderer that shares no code with clcache.

Choose a variant first: `set_llvm_variant`, or `mitsuba.set_variant("scalar_rgb")`, which needs nothing besides the package.
What maps to what:

- All instances are baked into the world, where they are at the start, and triangles gathered by material, so that Mitsuba
  has as few shapes as can be: each further shape or instance costs it time. Normals are baked as the inverse transpose
  takes them, not normalised: both renderers interpolate first and normalise then, which matters under transforms that do
  not scale evenly. A mirrored instance's triangles are wound the other way round, so that their fronts stay in front.
- Mitsuba's area lights shine on one side only, so an emissive triangle of a double-sided material becomes two that face
  away from each other, `SHEET_GAP` of the scene's extent apart: a ray always meets the one that faces it first.
- Materials that both know exactly: diffuse (specular, metallic and transmission 0); metal of base colour 1 and roughness 0
  (`conductor` without material); glass (transmission 1, metallic 0), smooth or rough (`dielectric`, `roughdielectric`).
  Double-sided ones are wrapped in `twosided`, but for glass, which has two different sides.
- Alpha masks are `mask` with opacities of 0 and 1, cut along the borders of texels; the integrator is then `volpath`, which
  alone counts no bounce and casts no shadow where there is nothing.
- Pictures are decoded here, multiplied with the material's factors, and handed over as linear float32.
- An image environment gets twice the rows and one more: Mitsuba's first and last rows lie at the poles, clcache's half a
  row away; between rows of the finer picture both interpolate the same line. It is turned by half a turn: Mitsuba's
  centre is +Z.
- Mitsuba's camera looks along its own +Z with +X to the left; clcache's along -Z with +X to the right.
- A path has at most `bounces` + 2 segments, none of them ended by roulette unless that is asked for.

Where the two differ by definition:

- Metal in general: clcache has Schlick's Fresnel term from the base colour to white, Mitsuba one reflectance for all
  angles; and clcache's Smith masking is height-correlated, Mitsuba's is not. At a base colour of 1 and small roughness
  the two meet: the product of both Lambdas, which is all the difference, is below 1e-4 for a roughness of 0.3 seen and
  lit at less than 60 degrees.
- Everything between metal, glass and matt, or with maps of metallic and roughness, becomes Mitsuba's `principled`, which is
  alike and not the same: its base is not Lambertian, its interface not of the same strength. Normal maps are left out.
- Thin glass: clcache has one reflection and straight transmission, rough or not; Mitsuba's `thindielectric` is smooth and
  counts the reflections between its two faces as well.
- Mitsuba has no mip levels: what a picture looks like through wide cones, far away or after a bounce, differs.
- Masks: clcache cuts where the interpolated alpha crosses the cutoff. Of stripes in a picture of alpha 0 and 1, and at a
  cutoff of a half, that is the border of texels, too. A lamp with holes shines from them in Mitsuba, and is refused.
- Between a spot's angles clcache has KHR_lights_punctual's falloff, the square of a line in the cosine, Mitsuba a line in
  the angle. Where there is next to nothing between the two, so is the difference.
- A diffuse surface whose interpolated normal departs from its triangle's reflects in Mitsuba over the hemisphere of the
  former, in clcache over the part of it that is above the triangle as well. Both tend to the same image as meshes get
  finer. Mitsuba's area lights convert densities with the interpolated normal as well, so that what both emits and
  reflects on a smooth coarse mesh is a little off there; what only emits is exported flat.
- The distance that Mitsuba keeps between a surface and a ray that leaves it is about 1e-4 of the coordinates, and never
  below 1e-4 scene units: scenes much smaller than one unit do not compare.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np

from ..errors import Error, SceneError
from ..scene.model import (
    Camera,
    DirectionalLight,
    Environment,
    Light,
    Material,
    PointLight,
    Scene,
    SpotLight,
    Texture,
    TextureUse,
)
from ..scene.motion import pose_at
from ..scene.textures import srgb_to_linear
from ..scene.transform import rigid

SHEET_GAP = 2e-5  # of the scene's extent: well above float32's error in distances, far below a pixel
NEAR, FAR = 1e-6, 100.0  # of the scene's extent: Mitsuba wants a near and a far plane
NO_ROULETTE = 1 << 20  # a depth that no path reaches
SMOOTH = 1e-3  # squared roughness below which clcache reflects as a mirror does
LEAST_LLVM = 19


def set_llvm_variant(threads: int) -> None:
    """Choose the variant that compiles kernels for the processor, for the calling thread. threads: how many it may use. Raises Error where
    there is no LLVM that it works with: it dies in what versions 14 to 16 make of its kernels."""
    import drjit as dr

    dr.set_thread_count(threads)
    try:
        mi.set_variant("llvm_ad_rgb")
        found = dr.detail.llvm_version()
    except ImportError:
        found = ()
    if not found or found[0] < LEAST_LLVM:
        version = ".".join(map(str, found)) or "missing or too old"
        raise Error(
            f"Mitsuba's LLVM variant: libLLVM is {version}; expected {LEAST_LLVM} or newer, such as by "
            f"apt-get install libllvm{LEAST_LLVM}"
        )


def to_mitsuba(scene: Scene, size: tuple[int, int], spp: int = 16, bounces: int = 3, seed: int = 0) -> "mi.Scene":
    """The scene with film, sampler and integrator, in the variant that is set; `mitsuba.render` takes it.

    size: width, height in pixels. spp, seed: of the sampler, where `mitsuba.render` is given no others. bounces: as the
    setting pathtrace.bounces. Raises SceneError for what Mitsuba cannot express.
    """
    scene = still(scene)
    soups = list(_soups(scene))
    extent = _extent(scene, soups)
    description: dict[str, object] = {
        "type": "scene",
        "integrator": integrator(scene, bounces),
        "sensor": _sensor(scene.camera, extent) | {"film": _film(size), "sampler": _sampler(spp, seed)},
    }
    for soup in soups:
        material = scene.materials[soup.material]
        bsdf = mi.load_dict(_bsdf(scene, material))
        name = f"mesh {len(description)} of {material.name}"
        if any(material.emission):
            if material.alpha_cutoff:
                raise SceneError(f"{scene.file}: material {material.name}: a lamp with holes; Mitsuba's have none")
            radiance = _map(scene, material.emission_texture, material.emission)
            sheets = soup.sheets(SHEET_GAP * extent) if material.double_sided else [soup]
            for side, sheet in enumerate(sheets):
                description[f"{name}, side {side}"] = _mesh(name, sheet, bsdf, radiance)
        else:
            description[name] = _mesh(name, soup, bsdf)
    for index, light in enumerate(scene.lights):
        description[f"light {index}"] = _light(light)
    if scene.environment.radiance.any():
        description["environment"] = _environment(scene.environment)
    return mi.load_dict(description)


def integrator(scene: Scene, bounces: int, roulette: int = NO_ROULETTE) -> dict:
    """What traces paths. roulette: the segment from which on it may end them."""
    has_holes = any(m.alpha_cutoff for m in scene.materials)
    return {"type": "volpath" if has_holes else "path", "max_depth": bounces + 2, "rr_depth": roulette}


def side_by_side(scene: Scene, cameras: Sequence[Camera], size: tuple[int, int], sampler: dict) -> dict:
    """A sensor of several views, which one launch renders, into a film that has them side by side. size: of each."""
    fixed = still(scene)
    extent = _extent(fixed, list(_soups(fixed)))
    # Each with a film of its own, which tells the field of view.
    film = _film(size)
    views = {f"view {index}": _sensor(camera, extent) | {"film": film} for index, camera in enumerate(cameras)}
    width, height = size
    return {"type": "batch", **views, "film": _film((len(cameras) * width, height)), "sampler": sampler}


def to_world(camera: Camera) -> np.ndarray:
    """(4, 4): the camera's place, as Mitsuba turns it."""
    return np.vstack([camera.transform, [0.0, 0.0, 0.0, 1.0]]) @ np.diag([-1.0, 1.0, -1.0, 1.0])


def still(scene: Scene) -> Scene:
    """The scene as it is at the start, and stays."""
    instances = tuple(
        replace(i, transform=pose_at(i.motion, 0.0), motion=()) if i.motion else i for i in scene.instances
    )
    camera = scene.camera
    if camera.motion:
        camera = replace(camera, transform=rigid(pose_at(camera.motion, 0.0)), motion=())
    return replace(scene, instances=instances, lights=tuple(map(_still_light, scene.lights)), camera=camera)


def _still_light(light: Light) -> Light:
    if not light.motion:
        return light
    pose, moved = pose_at(light.motion, 0.0), {}
    if not isinstance(light, DirectionalLight):
        moved["position"] = tuple(pose[:, :3] @ light.position + pose[:, 3])
    if not isinstance(light, PointLight):
        direction = pose[:, :3] @ light.direction
        moved["direction"] = tuple(direction / np.linalg.norm(direction))
    return replace(light, motion=(), **moved)


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
        corners = mesh.triangles[:, ::-1] if np.linalg.det(matrix[:, :3]) < 0 else mesh.triangles
        triangles.append(corners.astype(np.int64) + first)
        materials.append(mesh.material)
        first += count
    positions, normals, uvs, triangles = map(np.concatenate, (positions, normals, uvs, triangles))
    material = np.concatenate(materials).astype(np.int64)
    is_lamp = np.array([any(m.emission) and not any(m.base_color) for m in scene.materials])
    # What only emits needs no normals.
    is_smooth = (normals[triangles] != 0).any(axis=2).all(axis=1) & ~is_lamp[material]
    maps = ("base_color_texture", "metallic_roughness_texture", "emission_texture")
    is_textured = np.array([any(getattr(m, name) is not None for name in maps) for m in scene.materials])
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


def _mesh(name: str, soup: Soup, bsdf: "mi.BSDF", radiance: dict | None = None) -> "mi.Mesh":
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    if radiance is not None:
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
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
    surface = _surface(scene, material)
    if material.double_sided and not material.transmission:
        surface = {"type": "twosided", "bsdf": surface}
    if material.alpha_cutoff:
        surface = {"type": "mask", "bsdf": surface, "opacity": _opacity(scene, material)}
    return surface


def _surface(scene: Scene, material: Material) -> dict:
    """What light meets on the front."""
    color = _map(scene, material.base_color_texture, material.base_color)
    alpha = material.roughness**2
    is_rough = alpha >= SMOOTH
    kind = (material.metallic, material.transmission)
    if material.metallic_roughness_texture is None:
        microfacets = {"alpha": alpha, "distribution": "ggx"} if is_rough else {}
        if kind == (0, 0) and material.specular == 0:
            return {"type": "diffuse", "reflectance": color}
        if kind == (1, 0):
            metal = "roughconductor" if is_rough else "conductor"
            return {"type": metal, "material": "none", "specular_reflectance": color, **microfacets}
        if kind == (0, 1):
            glass = "thindielectric" if material.thin else "roughdielectric" if is_rough else "dielectric"
            body = {"int_ior": material.ior, "ext_ior": 1.0, "specular_transmittance": color}
            return {"type": glass, **body, **({} if material.thin else microfacets)}
    return {
        "type": "principled",
        "base_color": color,
        "roughness": _map(scene, material.metallic_roughness_texture, (material.roughness,) * 3, 1),
        "metallic": _map(scene, material.metallic_roughness_texture, (material.metallic,) * 3, 2),
        "spec_trans": material.transmission,
        "eta": max(material.ior, 1.001),
    }


def _map(
    scene: Scene, use: TextureUse | None, factor: tuple[float, float, float], channel: int | None = None
) -> dict | float:
    """A colour times a picture, where there is one; or one channel of it. Mitsuba's v runs downwards as clcache's does."""
    if use is None:
        return _rgb(factor) if channel is None else float(factor[channel])
    texture = scene.textures[use.index]
    plain = np.arange(256) / 255
    table = (srgb_to_linear(plain) if texture.srgb else plain).astype(np.float32)
    linear = table[texture.pixels[..., :3]] * np.asarray(factor, np.float32)
    return _bitmap(scene, use, texture, linear if channel is None else linear[..., channel], "bilinear")


def _opacity(scene: Scene, material: Material) -> dict | float:
    """1 where there is a surface, 0 where there is a hole."""
    use = material.base_color_texture
    if use is None:
        return float(material.alpha >= material.alpha_cutoff)
    texture = scene.textures[use.index]
    is_there = material.alpha * (texture.pixels[..., 3] / 255) >= material.alpha_cutoff
    return _bitmap(scene, use, texture, is_there.astype(np.float32), "nearest")


def _bitmap(scene: Scene, use: TextureUse, texture: Texture, values: np.ndarray, filter_type: str) -> dict:
    if texture.wrap[0] != texture.wrap[1]:
        raise SceneError(
            f"{scene.file}: texture {texture.name}: wraps {texture.wrap}; Mitsuba has one mode for both axes"
        )
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(values)),
        "raw": True,
        "filter_type": filter_type,
        "wrap_mode": texture.wrap[0],
        "to_uv": mi.ScalarTransform3f(np.vstack([np.reshape(use.transform, (2, 3)), [0.0, 0.0, 1.0]])),
    }


def _light(light: Light) -> dict:
    match light:
        case PointLight():
            return {"type": "point", "position": list(light.position), "intensity": _rgb(light.intensity)}
        case SpotLight():
            axis = np.asarray(light.direction, np.float64)
            up = np.eye(3)[np.argmin(np.abs(axis))]
            target = np.asarray(light.position) + axis
            outer = float(np.degrees(light.outer_angle))
            return {
                "type": "spot",
                "to_world": mi.ScalarTransform4f().look_at(list(light.position), list(target), list(up)),
                "intensity": _rgb(light.intensity),
                "cutoff_angle": outer,
                "beam_width": min(float(np.degrees(light.inner_angle)), outer - 1e-3),
            }
        case DirectionalLight():
            return {
                "type": "directional",
                "direction": list(map(float, light.direction)),
                "irradiance": _rgb(light.irradiance),
            }


def _environment(environment: Environment) -> dict:
    picture = environment.radiance
    if picture.shape[:2] == (1, 1):
        return {"type": "constant", "radiance": _rgb(picture[0, 0])}
    rows = np.pad(picture, ((1, 1), (0, 0), (0, 0)), mode="edge")
    finer = np.empty((2 * len(picture) + 1, *picture.shape[1:]), np.float32)
    finer[1::2] = picture
    finer[::2] = 0.5 * (rows[:-1] + rows[1:])
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(finer),
        "to_world": mi.ScalarTransform4f(np.diag([-1.0, 1.0, -1.0, 1.0])),
    }


def _sensor(camera: Camera, extent: float) -> dict:
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(to_world(camera)),
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
