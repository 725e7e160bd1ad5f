"""Scenes whose materials are graphs, for measuring their memoization (MaterialMemo, chapter 6).

The scene's folder is copied, and each material of its glTF files is replaced by a graph of its own, with constants and structure drawn
from its name; the colours are about those of the material. Meshes without texture coordinates get some (`box_mapping.py`).
Materials that emit or transmit, or have holes, stay as they are: light of graphs is not sampled, and no graph drives the others. The first
few are MaterialX documents, the others text.

`memory`: what Blender's artists do, as in the thesis's scene: the material's own picture, others of the scene at several
scales as layers of grain, a turned hue behind a mask, dirt, roughness by brightness, bumps. `compute`: octaves of gradient noise
alone (section 6.3). Both kinds take about as long without memoization.
"""

import shutil
import tempfile
import tomllib
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import SettingError
from ..scene import load_scene
from ..scene.model import Material, Scene, Texture
from .box_mapping import BoxMapped
from .graph_forms import LUMINANCE, MaterialXForm, Operand, TextForm, Value

EFFORTS = {
    "memory": 10,
    "compute": 24,
}  # by kind: layers of grain at most, or octaves; by which both take about as long
MATERIALX = 5  # graphs that are written in that form
SHOWING = {"map", "clock", "window"}  # pictures that show something, and make no grain
Form = TextForm | MaterialXForm


@dataclass(frozen=True)
class Picture:
    """A picture of the scene. file: as graphs name it. mean: linear RGB. contrast: deviation of its brightness over the
    mean's."""

    file: str
    srgb: bool
    mean: tuple[float, ...]
    contrast: float

    @property
    def brightness(self) -> float:
        """Luminance of the mean."""
        return float(np.dot(LUMINANCE, self.mean))


@dataclass(frozen=True)
class Look:
    """What a material's graph is to look like. metres: of a unit of its texture coordinates. picture: its own, of which
    `repeats` fit on such a unit. grains: pictures for detail; bumps: of normals."""

    material: Material
    metres: float
    picture: Picture | None
    repeats: float
    grains: Sequence[Picture]
    bumps: Picture | None


@dataclass(frozen=True)
class Surface:
    """What a graph drives, and what it leaves alone, by field of the material."""

    color: Value
    roughness: Value | None
    normal: Value | None
    constants: Mapping[str, float]


@dataclass(frozen=True)
class Document:
    """A graph's file, and what the scene says beside it."""

    file: str
    constants: Mapping[str, float]


# ---------------------------------------------------------------------------------------------------------------------
# Graphs


def memory(form: Form, look: Look, rng: np.random.RandomState, layers: int) -> Surface:
    """A graph that samples pictures."""
    uv = form.uv()
    metres = form.multiply(uv, (look.metres, look.metres))
    color, shade = base(form, look, uv), None
    for _ in range(rng.randint(-(-layers // 2), layers + 1)):
        shade = grain(form, look, metres, rng)
        color = form.multiply(color, form.mix((1.0,), shade, (rng.uniform(0.1, 0.4),)))
    if rng.random_sample() < 0.8:
        turned = form.hue(color, rng.uniform(-0.04, 0.04), rng.uniform(0.7, 1.2))
        color = form.mix(color, turned, form.multiply(grain(form, look, metres, rng), (0.7,)))
    if rng.random_sample() < 0.6:
        dirt = form.multiply(color, tuple(rng.uniform(0.6, 0.9, 3)))
        color = form.mix(color, dirt, form.multiply(grain(form, look, metres, rng), (rng.uniform(0.2, 0.5),)))
    normal = None
    if look.bumps and (look.material.normal_texture or rng.random_sample() < 0.5):
        normal = bumps(form, look, uv, metres, rng)
    return finished(look, form, color, shade if rng.random_sample() < 0.7 else None, normal)


def base(form: Form, look: Look, uv: Value) -> Operand:
    """The material's own colour."""
    if look.picture is None:
        return look.material.base_color
    colour = form.image(look.picture.file, look.picture.srgb, form.multiply(uv, (look.repeats, look.repeats)))
    return form.multiply(colour, look.material.base_color)


def grain(form: Form, look: Look, metres: Value, rng: np.random.RandomState) -> Value:
    """A picture's brightness at some scale, 1 on average."""
    picture = look.grains[rng.randint(len(look.grains))]
    scale, offset = rng.uniform(0.4, 2.5), rng.uniform(0.0, 1.0, 2)
    place = form.add(form.multiply(metres, (scale, scale * rng.uniform(0.8, 1.25))), tuple(offset))
    return form.multiply(form.brightness(form.image(picture.file, picture.srgb, place)), (1.0 / picture.brightness,))


def bumps(form: Form, look: Look, uv: Value, metres: Value, rng: np.random.RandomState) -> Value:
    """Normals: where the material had some, in their old place."""
    if look.material.normal_texture:
        return form.bumps(form.image(look.bumps.file, False, form.multiply(uv, (look.repeats, look.repeats))), 1.0)
    scale = rng.uniform(1.0, 3.0)
    place = form.multiply(metres, (scale, scale))
    return form.bumps(form.image(look.bumps.file, False, place), rng.uniform(0.1, 0.3))


def compute(form: Form, look: Look, rng: np.random.RandomState, octaves: int) -> Surface:
    """A graph of noise: of the colour, its hue, its roughness."""
    metres = form.multiply(form.uv(), (look.metres, look.metres))

    def noise(strength: float) -> Value:
        scale, offset = rng.uniform(1.5, 12.0), rng.uniform(0.0, 50.0, 2)
        place = form.add(form.multiply(metres, (scale, scale * rng.uniform(0.6, 1.6))), tuple(offset))
        return form.multiply(form.fractal(place, octaves), (strength,))

    mean = look.picture.mean if look.picture else (1.0, 1.0, 1.0)
    light = tuple(a * b for a, b in zip(look.material.base_color, mean, strict=True))
    color = form.multiply(form.add(noise(rng.uniform(0.2, 0.5)), (1.0,)), light)
    if rng.random_sample() < 0.8:
        turned = form.hue(color, rng.uniform(-0.06, 0.06), rng.uniform(0.7, 1.2))
        color = form.mix(color, turned, form.add(noise(0.4), (0.5,)))
    if rng.random_sample() < 0.5:
        dark = form.multiply(color, tuple(rng.uniform(0.4, 0.8, 3)))
        color = form.mix(color, dark, form.add(noise(0.35), (0.4,)))
    return finished(look, form, color, form.add(noise(0.5), (1.0,)) if rng.random_sample() < 0.7 else None, None)


def finished(look: Look, form: Form, color: Value, shade: Value | None, normal: Value | None) -> Surface:
    """The surface: shade, 1 on average, moves the roughness of what reflects at all."""
    material, roughness = look.material, None
    constants = {"metallic": material.metallic, "specular": material.specular, "ior": material.ior}
    if shade and material.specular and 0.1 < material.roughness < 1.0:
        low, high = max(material.roughness - 0.12, 0.05), min(material.roughness + 0.12, 1.0)
        roughness = form.add(form.multiply(shade, (0.5 * (high - low),)), (low,))
    else:
        constants["roughness"] = material.roughness
    return Surface(color, roughness, normal, constants)


# ---------------------------------------------------------------------------------------------------------------------
# Scenes


def look_of(scene: Scene, material: Material, pictures: dict[int, Picture]) -> Look:
    """What is known of a material in a scene."""
    use = material.base_color_texture
    grains = [p for i, p in pictures.items() if p.srgb and p.contrast < 0.45 and scene.textures[i].name not in SHOWING]
    bumps = [i for m in (material, *scene.materials) if m.normal_texture for i in [m.normal_texture.index]]
    return Look(
        material,
        metres_of(scene, material),
        pictures[use.index] if use else None,
        use.transform[0] if use else 1.0,
        grains,
        pictures[bumps[0]] if bumps else None,
    )


def metres_of(scene: Scene, material: Material) -> float:
    """Metres of a unit of texture coordinates, by the areas of a material's triangles."""
    which = scene.materials.index(material)
    for instance in scene.instances:
        mesh = scene.meshes[instance.mesh]
        corners = mesh.triangles[mesh.material == which]
        surface, flat = area(mesh.positions[corners]), area(mesh.uvs[corners])
        if surface > 0 and flat > 0:
            return float(np.sqrt(surface / flat) * np.cbrt(abs(np.linalg.det(instance.transform[:, :3]))))
    return 1.0


def area(corners: np.ndarray) -> float:
    """Of triangles (t, 3, 2 or 3), twice."""
    a, b, c = np.moveaxis(corners.astype(float), 1, 0)
    u, v = b - a, c - a
    squared = (u * u).sum(axis=1) * (v * v).sum(axis=1) - (u * v).sum(axis=1) ** 2
    return float(np.sqrt(np.maximum(squared, 0.0)).sum())


def picture_of(file: str, texture: Texture) -> Picture:
    """Mean and contrast of a texture."""
    values = texture.pixels[..., :3] / 255.0
    if texture.srgb:
        values = np.where(values < 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    light = values @ LUMINANCE
    return Picture(file, texture.srgb, tuple(values.mean(axis=(0, 1)).tolist()), float(light.std() / light.mean()))


def is_replaced(material: Material) -> bool:
    """Whether a graph can take its place."""
    return not any(material.emission) and not material.transmission and material.alpha_cutoff is None


def with_graphs(file: str | Path, kind: str) -> Scene:
    """A scene with graphs in place of its materials, to be rendered: the files of the graphs' pictures are gone. file: of a scene whose meshes
    are glTF files beside it. kind: memory or compute. Raises SceneError, and SettingError where no material can be replaced."""
    source = Path(file)
    load_scene(source)  # so that what is wrong with it is said of this file, and not of the copy
    with tempfile.TemporaryDirectory() as made:
        return replace(load_scene(fill_folder(source, Path(made) / source.parent.name, kind)), file=str(source))


def fill_folder(source: Path, out: Path, kind: str) -> Path:
    """Make the folder of a scene with graphs. Returns its scene file. Raises SceneError, SettingError."""
    shutil.copytree(source.parent, out)
    files = {file.name: BoxMapped(file) for file in sorted(out.glob("*.gltf"))}
    for name, mapped in files.items():
        mapped.write(out / name)
    scene = load_scene(out / source.name)
    known = used_names(files.values())
    replaced = [m for m in scene.materials if m.name in known and is_replaced(m)]
    if not replaced:
        raise SettingError(
            f"{source}: no material of a glTF file can be replaced; expected a scene such as data/classroom"
        )
    written = write_graphs(scene, replaced, pictures_of(scene, files.values()), out, kind)
    with (out / source.name).open("a", encoding="utf-8", newline="\n") as stream:
        stream.write(tables(out / source.name, files, written))
    return out / source.name


def write_graphs(
    scene: Scene, replaced: Sequence[Material], pictures: dict[int, Picture], out: Path, kind: str
) -> dict[str, Document]:
    """Write a graph for each of these materials: what was written, by the material's name."""
    recipe = memory if kind == "memory" else compute
    written = {}
    for index, material in enumerate(replaced):
        form = (MaterialXForm if index < MATERIALX else TextForm)(material.name)
        rng = np.random.RandomState(zlib.crc32(f"{kind} {material.name}".encode()))
        surface = recipe(form, look_of(scene, material, pictures), rng, EFFORTS[kind])
        file = material.name.replace(" ", "_") + form.suffix
        constants = surface.constants if isinstance(form, TextForm) else {}
        (out / file).write_text(form.text(**vars(surface)), encoding="utf-8", newline="\n")
        written[material.name] = Document(file, constants)
    return written


def pictures_of(scene: Scene, files: Iterable[BoxMapped]) -> dict[int, Picture]:
    """The scene's pictures, by index of its textures."""
    uris = {i["name"]: i["uri"] for f in files for i in f.document.get("images", [])}
    return {i: picture_of(uris[t.name], t) for i, t in enumerate(scene.textures)}


def used_names(files: Iterable[BoxMapped]) -> set[str]:
    """Names of the materials in glTF files."""
    return {m["name"] for f in files for m in f.document.get("materials", [])}


def tables(scene_file: Path, files: dict[str, BoxMapped], written: dict[str, Document]) -> str:
    """What a scene file says of graphs. written: by material."""
    lines = []
    for mesh, entry in tomllib.loads(scene_file.read_text(encoding="utf-8"))["meshes"].items():
        file = entry.get("file")
        names = used_names([files[file]]) & written.keys() if file in files else ()
        if names:
            lines += ["", f"[meshes.{mesh}.materials]"]
            lines += [f'"{name}" = "{name}"' for name in sorted(names)]
    for name, document in written.items():
        lines += ["", f'[materials."{name}"]', f'graph = "{document.file}"']
        lines += [f"{key} = {float(value)}" for key, value in document.constants.items()]
    return "\n".join(lines) + "\n"
