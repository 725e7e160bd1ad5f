"""MTL files, the materials of OBJ, as metallic-roughness materials.

Read here because the mesh library rounds colours to 8 bits, ignores most statements, and goes on silently without a picture
that it cannot read. The format describes shading formulas of 1992, so that some of it has to be understood:

- Pm and Pr (the widespread PBR extension) are metallic and roughness; Kd is then the colour of metals, too.
- Without Pr, the exponent Ns gives GGX's alpha = sqrt(2 / (Ns + 2)) (Walter et al. 2007, of Blinn and Phong's lobe), and
  roughness = sqrt(alpha); ray-traced reflection or refraction (illum 3 and up) of a mirror or of glass is smooth.
- Ks is the reflectance at normal incidence, but not above what the refractive index Ni gives, if that is above 1: exporters
  write strengths there. illum 0 and 1 know no Ks.
- Without Pm, a material whose Kd is next to nothing beside its Ks is a mirror: a metal of the colour Ks.
- illum 4, 6, 7 and 9, and d below 1 with Ni above 1, are glass, whose colour is Tf if given with such an illum; d below 1
  otherwise lets a part of the light through straight on.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import SceneError
from .files import read_text
from .model import Material
from .transform import uv_transform

# Options of a map statement with the number of values that follow each at most; values end where no number stands.
_MAP_OPTIONS = {"-o": 3, "-s": 3, "-t": 3, "-mm": 2}
_MAP_FLAGS = {"-blendu", "-blendv", "-boost", "-bm", "-cc", "-clamp", "-imfchan", "-texres", "-type"}

_COLORS = {"kd": "Kd", "ke": "Ke", "ks": "Ks", "tf": "Tf"}
_NUMBERS = {"ns": "Ns", "ni": "Ni", "d": "d", "tr": "Tr", "pr": "Pr", "pm": "Pm", "illum": "illum"}
_MAPS = {"map_kd": "map_Kd", "map_d": "map_d", "map_ke": "map_Ke", "norm": "norm"}
_UNREAD_MAPS = {"map_ka": "", "map_ks": "map_Ks", "map_ns": "map_Ns", "map_pr": "map_Pr", "map_pm": "map_Pm", "map_bump": "map_Bump",
                "bump": "map_Bump", "disp": "disp", "refl": "refl"}  # fmt: skip

_GLASS = (4, 6, 7, 9)
_RAY_TRACED = 3
_MIRROR_RATIO = 0.1  # of Kd to Ks
_DIMMEST_MIRROR = 0.2
_CUTOFF = 0.5


@dataclass(frozen=True)
class MapStatement:
    """A picture that a material names. picture: file as written; where: the place that wrote it; clamp: whether its
    coordinates are clamped; transform: as of `TextureUse`."""

    picture: str
    where: str
    clamp: bool = False
    transform: tuple[float, float, float, float, float, float] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@dataclass
class MtlMaterial:
    """The statements of one `newmtl`, by their names in lower case. file: the MTL file. unread: maps that are left out, as
    named in notes."""

    file: Path
    colors: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    maps: dict[str, MapStatement] = field(default_factory=dict)
    unread: set[str] = field(default_factory=set)


def read_mtl(path: Path, name: str) -> dict[str, MtlMaterial]:
    """The materials of an MTL file by name. name: the file as messages call it. Raises SceneError."""
    materials: dict[str, MtlMaterial] = {}
    current = MtlMaterial(path)  # statements before the first newmtl belong to no material
    for number, line in enumerate(read_text(path, name).splitlines(), 1):
        key, _, rest = line.strip().partition("#")[0].strip().replace("\t", " ").partition(" ")
        key, rest, where = key.lower(), rest.strip(), f"{name}:{number}"
        if key == "newmtl":
            current = materials.setdefault(rest, MtlMaterial(path))
        elif key == "tf" and rest.split(" ")[0] in ("xyz", "spectral"):
            continue
        elif key in _COLORS:
            current.colors[key] = _color(rest, f"{where}: {_COLORS[key]}")
        elif key in _NUMBERS:
            current.numbers[key] = _number(rest, f"{where}: {_NUMBERS[key]}")
        elif key in _MAPS:
            current.maps[key] = _map(rest, f"{where}: {_MAPS[key]}")
        elif _UNREAD_MAPS.get(key):
            current.unread.add(_UNREAD_MAPS[key])
    return materials


def to_material(name: str, mtl: MtlMaterial) -> Material:
    """The material that the statements describe, without its pictures."""
    diffuse = tuple(min(x, 1.0) for x in mtl.colors.get("kd", (0.8, 0.8, 0.8)))
    illum = int(mtl.numbers.get("illum", 2))
    mirrored = tuple(min(x, 1.0) for x in mtl.colors.get("ks", (0.0, 0.0, 0.0))) if illum >= 2 else (0.0, 0.0, 0.0)
    strongest = max(mirrored)
    ior = max(mtl.numbers.get("ni", 1.0), 1.0)
    opacity = _opacity(mtl.numbers)
    fields = {
        "base_color": diffuse,
        "emission": mtl.colors.get("ke", (0.0, 0.0, 0.0)),
        "roughness": _roughness(mtl.numbers),
    }

    is_mirror = strongest > _DIMMEST_MIRROR and max(diffuse) < _MIRROR_RATIO * strongest and "map_kd" not in mtl.maps
    fields["metallic"] = min(max(mtl.numbers.get("pm", float(is_mirror)), 0.0), 1.0)
    if illum in _GLASS or (opacity < 1 and ior > 1):
        tint = mtl.colors.get("tf", diffuse) if illum in _GLASS else diffuse
        color = tuple(min(x, 1.0) for x in tint) if max(tint) > 0 else (1.0, 1.0, 1.0)
        fields |= {"base_color": color, "metallic": 0.0, "transmission": 1.0, "ior": ior, "specular": 1.0}
    elif opacity < 1:
        fields |= {"transmission": 1 - opacity, "thin": True, "ior": 1.0}
    elif is_mirror and "pm" not in mtl.numbers:
        fields |= {"base_color": mirrored}
    elif strongest > 0 and fields["metallic"] < 1:
        fields |= _reflection(mirrored, ior)
    is_smooth = illum >= _RAY_TRACED and (fields["metallic"] == 1 or "transmission" in fields)
    if "pr" not in mtl.numbers and (is_smooth or fields.get("transmission") == 1.0):
        fields["roughness"] = 0.0
    return Material(name, **fields, alpha_cutoff=_CUTOFF if "map_d" in mtl.maps else None)


def _roughness(numbers: dict[str, float]) -> float:
    if "pr" in numbers:
        return min(max(numbers["pr"], 0.0), 1.0)
    return (2 / (max(numbers.get("ns", 0.0), 0.0) + 2)) ** 0.25


def _opacity(numbers: dict[str, float]) -> float:
    return min(max(numbers.get("d", 1 - numbers.get("tr", 0.0)), 0.0), 1.0)


def _reflection(mirrored: tuple[float, float, float], ior: float) -> dict[str, object]:
    """Parameters of a dielectric whose reflectance at normal incidence is `mirrored`, or as its index limits it."""
    strongest = max(mirrored)
    tint = tuple(x / strongest for x in mirrored)
    if ior > 1:
        limit = ((ior - 1) / (ior + 1)) ** 2
        return {"specular": min(strongest / limit, 1.0), "specular_color": tint, "ior": ior}
    root = math.sqrt(min(strongest, 0.99))
    return {"specular": 1.0, "specular_color": tint, "ior": (1 + root) / (1 - root)}


def _color(text: str, where: str) -> tuple[float, float, float]:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    values *= 3 if len(values) == 1 else 1  # one number stands for all three
    if len(values) != 3 or not all(0 <= x < math.inf for x in values):
        raise SceneError(f"{where}: {text!r} is wrong; expected three numbers from 0 up")
    return tuple(values)


def _number(text: str, where: str) -> float:
    word = text.split()[-1] if text else ""  # d may say -halo before its number
    if not _is_number(word) or not math.isfinite(float(word)):
        raise SceneError(f"{where}: {text!r} is wrong; expected a number")
    return float(word)


def _map(text: str, where: str) -> MapStatement:
    """A map statement, whose options stand before the file's name."""
    words = text.split(" ")
    clamp = False
    pairs = {"-o": [0.0, 0.0], "-s": [1.0, 1.0]}
    at = 0
    while at < len(words) - 1 and words[at].startswith("-"):
        option = words[at].lower()
        clamp |= option == "-clamp" and words[at + 1].lower() == "on"
        at += 1
        if option in _MAP_OPTIONS:
            end, first = min(at + _MAP_OPTIONS[option], len(words) - 1), at
            while at < end and _is_number(words[at]):
                if option in pairs and at - first < 2:
                    pairs[option][at - first] = float(words[at])
                at += 1
        elif option in _MAP_FLAGS:
            at += 1
    (u, v), (width, height) = pairs["-o"], pairs["-s"]
    # The format's v grows upwards, the model's downwards.
    transform = uv_transform((u, 1 - height - v), 0.0, (width, height))
    if not all(abs(x) <= 1e30 for x in transform):
        raise SceneError(f"{where}: the offset or scale is wrong; expected finite numbers")
    return MapStatement(" ".join(words[at:]).strip().strip('"'), where, clamp, transform)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
