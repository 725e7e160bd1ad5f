"""Writers of material graphs: the same operations in the project's text form, and as a MaterialX document.

An operation returns a `Value`, which later ones take; constants are tuples of numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

LUMINANCE = (0.2126, 0.7152, 0.0722)
TYPES = {1: "float", 2: "vector2", 3: "color3"}


@dataclass(frozen=True)
class Value:
    """An output of a node. name: what links to it are written with. width: channels."""

    name: str
    width: int


Operand = Value | tuple[float, ...]


def width(value: Operand) -> int:
    """Channels of a value or constant."""
    return value.width if isinstance(value, Value) else len(value)


def number(value: float) -> str:
    """A number in few digits."""
    return f"{value:.6g}"


class TextForm:
    """A graph in the text form: a node a line, links by number."""

    suffix = ".graph"

    def __init__(self, name: str) -> None:
        self._lines = [f"# {name}"]
        self._links = 0

    def _node(self, kind: str, channels: int, arguments: Sequence[str] = (), **inputs: Operand) -> Value:
        links = [f"{socket}<{self._linked(value).name}" for socket, value in inputs.items()]
        out = Value(str(self._links), channels)
        self._links += 1
        self._lines.append(" ".join([kind, *arguments, *links, f"Out>{out.name};"]))
        return out

    def _linked(self, value: Operand) -> Value:
        if isinstance(value, Value):
            return value
        return self._node(f"Float{len(value)}Constant", len(value), [number(v) for v in value])

    def uv(self) -> Value:
        """The mesh's texture coordinates."""
        return self._node("UVInput", 2)

    def add(self, a: Value, b: Operand) -> Value:
        """The sum."""
        return self._node("Add", a.width, A=a, B=b)

    def multiply(self, a: Operand, b: Operand) -> Value:
        """The product, channel by channel; one of them may be a single channel."""
        return self._node("Mul", max(width(a), width(b)), A=a, B=b)

    def mix(self, a: Operand, b: Value, part: Operand) -> Value:
        """a where the part is 0, b where it is 1."""
        return self._node("Mix", b.width, Fg=b, Bg=a, Mix=part)

    def image(self, file: str, srgb: bool, uv: Value) -> Value:
        """A picture's colour."""
        color = self._node("Image", 4, [f'"{file}"', "srgb" if srgb else "linear"], UV=uv)
        return Value(color.name, 3)

    def brightness(self, color: Value) -> Value:
        """Luminance."""
        return self._node("Dot", 1, A=color, B=LUMINANCE)

    def hue(self, color: Value, shift: float, saturation: float) -> Value:
        """The colour with its hue turned by this part of the circle, and its saturation multiplied."""
        hsv = self._node("Mul", 3, A=self._node("RgbToHsv", 3, In=color), B=(1.0, saturation, 1.0))
        return self._node("HsvToRgb", 3, In=self._node("Add", 3, A=hsv, B=(shift, 0.0, 0.0)))

    def fractal(self, point: Value, octaves: int) -> Value:
        """Octaves of gradient noise, about 0: simplex noise in the text form, Perlin's in MaterialX."""
        return self._node("SimplexFractal2D", 1, [str(octaves)], UV=point, Lacunarity=(2.0,), Diminish=(0.5,))

    def bumps(self, color: Value, strength: float) -> Value:
        """The normal of a picture of normals."""
        return self._node("NormalMap", 3, In=color, Scale=(strength, strength))

    def text(self, color: Value, roughness: Value | None, normal: Value | None, constants: dict) -> str:
        """The document. constants: fields of the surface, which this form leaves to the scene."""
        outputs = {"ColorOutput": color, "RoughnessOutput": roughness, "NormalOutput": normal}
        lines = [f"{kind} In<{value.name};" for kind, value in outputs.items() if value]
        return "\n".join([*self._lines, *lines]) + "\n"


class MaterialXForm:
    """A graph as a MaterialX document of one gltf_pbr surface."""

    suffix = ".mtlx"

    def __init__(self, name: str) -> None:
        self._root = ElementTree.Element("materialx", version="1.39")
        self._graph = ElementTree.SubElement(self._root, "nodegraph", name="graph")
        self._name = "".join(c if c.isalnum() else "_" for c in name)
        self._nodes = 0

    def _node(self, category: str, channels: int, kind: str = "", **inputs: Operand | str | int | float) -> Value:
        self._nodes += 1
        name = f"{category}{self._nodes}"
        node = ElementTree.SubElement(self._graph, category, name=name, type=kind or TYPES[channels])
        for socket, value in inputs.items():
            _input(node, socket, value)
        return Value(name, channels)

    def uv(self) -> Value:
        """The mesh's texture coordinates."""
        return self._node("texcoord", 2)

    def add(self, a: Value, b: Operand) -> Value:
        """The sum."""
        return self._node("add", a.width, in1=a, in2=b)

    def multiply(self, a: Operand, b: Operand) -> Value:
        """The product, channel by channel; one of them may be a single channel."""
        wide, other = (b, a) if width(b) > width(a) else (a, b)
        return self._node("multiply", width(wide), in1=wide, in2=other)

    def mix(self, a: Operand, b: Value, part: Operand) -> Value:
        """a where the part is 0, b where it is 1."""
        return self._node("mix", b.width, bg=a, fg=b, mix=part)

    def image(self, file: str, srgb: bool, uv: Value) -> Value:
        """A picture's colour; of one that is not sRGB, its plain numbers."""
        color = self._node("image", 3, "" if srgb else "vector3", texcoord=uv)
        space = {"colorspace": "srgb_texture"} if srgb else {}
        ElementTree.SubElement(self._graph[-1], "input", name="file", type="filename", value=file, **space)
        return color

    def brightness(self, color: Value) -> Value:
        """Luminance."""
        return self._node("extract", 1, **{"in": self._node("luminance", 3, **{"in": color}), "index": 0})

    def hue(self, color: Value, shift: float, saturation: float) -> Value:
        """The colour with its hue turned by this part of the circle, and its saturation multiplied."""
        adjusted = self._node("hsvadjust", 3, **{"in": color})
        amount = ", ".join(map(number, (shift, saturation, 1.0)))
        ElementTree.SubElement(self._graph[-1], "input", name="amount", type="vector3", value=amount)
        return adjusted

    def fractal(self, point: Value, octaves: int) -> Value:
        """Octaves of gradient noise, about 0: simplex noise in the text form, Perlin's in MaterialX."""
        return self._node("fractal2d", 1, texcoord=point, octaves=octaves, lacunarity=(2.0,), diminish=(0.5,))

    def bumps(self, color: Value, strength: float) -> Value:
        """The normal of a picture of normals."""
        return self._node("normalmap", 3, "vector3", **{"in": color, "scale": (strength,)})

    def text(self, color: Value, roughness: Value | None, normal: Value | None, constants: dict) -> str:
        """The document. constants: fields of the surface."""
        surface = ElementTree.SubElement(self._root, "gltf_pbr", name="surface", type="surfaceshader")
        driven = {"base_color": color, "roughness": roughness, "normal": normal}
        for socket, value in {key: v for key, v in driven.items() if v}.items():
            output = ElementTree.SubElement(self._graph, "output", name=socket, nodename=value.name)
            output.set("type", kind := "vector3" if socket == "normal" else TYPES[value.width])
            ElementTree.SubElement(surface, "input", name=socket, type=kind, nodegraph="graph", output=socket)
        for socket, value in constants.items():
            _input(surface, socket, (value,))
        material = ElementTree.SubElement(self._root, "surfacematerial", name=self._name, type="material")
        ElementTree.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename="surface")
        ElementTree.indent(self._root)
        return '<?xml version="1.0"?>\n' + ElementTree.tostring(self._root, encoding="unicode") + "\n"


def _input(node: ElementTree.Element, name: str, value: Operand | int) -> None:
    if isinstance(value, Value):
        # A picture of normals is no colour, though it has as many channels.
        kind = "vector3" if node.tag == "normalmap" else TYPES[value.width]
        ElementTree.SubElement(node, "input", name=name, type=kind, nodename=value.name)
    elif isinstance(value, int):
        ElementTree.SubElement(node, "input", name=name, type="integer", value=str(value))
    else:
        text = ", ".join(map(number, value))
        ElementTree.SubElement(node, "input", name=name, type=TYPES[width(value)], value=text)
