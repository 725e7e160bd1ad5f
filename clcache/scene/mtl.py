"""MTL files, the materials of OBJ: colours, the base colour's picture, and emission.

Read here because the mesh library rounds colours to 8 bits, ignores emission, and goes on silently without a picture that
it cannot read.
"""

import math
from dataclasses import dataclass
from pathlib import Path

from ..errors import SceneError
from .files import read_text

# Options of a map statement with the number of values that follow each at most; values end where no number stands.
_MAP_OPTIONS = {"-o": 3, "-s": 3, "-t": 3, "-mm": 2}
_MAP_FLAGS = {"-blendu", "-blendv", "-boost", "-bm", "-cc", "-clamp", "-imfchan", "-texres", "-type"}

# Statements that say more than a Lambertian surface can do, with the value that says nothing.
_NOT_LAMBERTIAN = {"d": 1.0, "tr": 0.0, "pm": 0.0, "ni": 1.0}


@dataclass
class MtlMaterial:
    """One `newmtl`. file: the MTL file. base_color: in [0, 1]. picture: file name as written, at the place `where`. clamp:
    whether the picture's coordinates are clamped. approximated: whether it is more than a Lambertian surface."""

    file: Path
    base_color: tuple[float, float, float] = (0.8, 0.8, 0.8)
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    picture: str | None = None
    where: str = ""
    clamp: bool = False
    approximated: bool = False


def read_mtl(path: Path, name: str) -> dict[str, MtlMaterial]:
    """The materials of an MTL file by name. name: the file as messages call it. Raises SceneError."""
    materials: dict[str, MtlMaterial] = {}
    current = MtlMaterial(path)  # statements before the first newmtl belong to no material
    for number, line in enumerate(read_text(path, name).splitlines(), 1):
        key, _, rest = line.strip().partition("#")[0].strip().replace("\t", " ").partition(" ")
        key, rest, where = key.lower(), rest.strip(), f"{name}:{number}"
        if key == "newmtl":
            current = materials.setdefault(rest, MtlMaterial(path))
        elif key == "kd":
            current.base_color = tuple(min(x, 1.0) for x in _color(rest, f"{where}: Kd"))
        elif key == "ke":
            current.emission = _color(rest, f"{where}: Ke")
        elif key == "map_kd":
            current.picture, current.clamp = _map(rest)
            current.where = f"{where}: map_Kd"
        elif key in _NOT_LAMBERTIAN:
            current.approximated |= _differs(rest, _NOT_LAMBERTIAN[key])
        elif key == "illum":
            current.approximated |= rest not in ("0", "1", "2")
    return materials


def _color(text: str, where: str) -> tuple[float, float, float]:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    values *= 3 if len(values) == 1 else 1  # one number stands for all three
    if len(values) != 3 or not all(0 <= x < math.inf for x in values):
        raise SceneError(f"{where}: {text!r} is wrong; expected three numbers from 0 up")
    return tuple(values)


def _map(text: str) -> tuple[str, bool]:
    """File name and clamping of a map statement, whose options stand before the name."""
    words = text.split(" ")
    clamp = False
    at = 0
    while at < len(words) - 1 and words[at].startswith("-"):
        option = words[at].lower()
        clamp |= option == "-clamp" and words[at + 1].lower() == "on"
        at += 1
        if option in _MAP_OPTIONS:
            end = min(at + _MAP_OPTIONS[option], len(words) - 1)
            while at < end and _is_number(words[at]):
                at += 1
        elif option in _MAP_FLAGS:
            at += 1
    return " ".join(words[at:]).strip().strip('"'), clamp


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _differs(text: str, neutral: float) -> bool:
    word = text.split()[-1] if text else ""
    return _is_number(word) and float(word) != neutral
