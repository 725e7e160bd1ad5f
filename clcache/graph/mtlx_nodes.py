"""What MaterialX's own nodes compute, as formulas over the node implementations of `cl/graph/nodes/`.

Each function below implements the MaterialX node of its name; its parameters are that node's inputs that matter here.
Nodes that MaterialX implements by graphs of other nodes are absent, save where one implementation does the same; those
that are neither here nor graphs are not supported. Formulas follow the MaterialX specification, as version 1.39's
reference implementation computes them.

Texture coordinates of MaterialX have v upwards, those of this package downwards: `texcoord` turns them, and `image` turns
them back, together with all scaling and shifting by constants in between.
"""

import inspect
import math
import re
from collections.abc import Callable

from .model import printable
from .mtlx_signals import NORMAL_MAP_MISUSED, Builder, Signal

MAX_OCTAVES = 16
V_UP = (1.0, -1.0), (0.0, 1.0)  # scale and offset between both directions of v
WRAPS = {"periodic": "repeat", "clamp": "clamp", "mirror": "mirror"}

Value = Signal | str | tuple[float, ...]  # the numbers are a matrix's
Result = Signal | dict[str, Signal]
Lowering = Callable[..., Result]

# How each MaterialX node is made, and of what: the names of its inputs, `width` for the channels of its output, `srgb` for
# whether the colours of its picture are encoded.
LOWERINGS: dict[str, Lowering] = {}
INPUTS: dict[str, tuple[str, ...]] = {}


def lowers(*names: str) -> Callable[[Lowering], Lowering]:
    """Make a function the implementation of the MaterialX nodes of those names."""

    def register(lowering: Lowering) -> Lowering:
        inputs = list(inspect.signature(lowering).parameters)[1:]
        for name in names:
            LOWERINGS[name] = lowering
            INPUTS[name] = tuple(parameter.removesuffix("_") for parameter in inputs)
        return lowering

    return register


def _lower_alike(sockets: dict[str, str], kinds: dict[str, str]) -> None:
    """MaterialX nodes that are one node each. sockets: by MaterialX input. kinds: by MaterialX node."""

    def one_node(kind: str) -> Lowering:
        return lambda b, *inputs: b.call(kind, **dict(zip(sockets.values(), inputs, strict=True)))

    for name, kind in kinds.items():
        LOWERINGS[name] = one_node(kind)
        INPUTS[name] = tuple(sockets)


_lower_alike(
    {"in1": "A", "in2": "B"},
    {
        "add": "Add",
        "subtract": "Sub",
        "multiply": "Mul",
        "divide": "Div",
        "modulo": "Mod",
        "power": "Pow",
        "safepower": "SafePow",
        "min": "Min",
        "max": "Max",
        "dotproduct": "Dot",
        "crossproduct": "Cross",
        "distance": "Distance",
        "and": "And",
        "or": "Or",
        "xor": "Xor",
    },
)
_lower_alike(
    {"in": "In"},
    {
        "absval": "Abs",
        "sign": "Sign",
        "floor": "Floor",
        "ceil": "Ceil",
        "round": "Round",
        "fract": "Fract",
        "sqrt": "Sqrt",
        "sin": "Sin",
        "cos": "Cos",
        "tan": "Tan",
        "asin": "Asin",
        "acos": "Acos",
        "exp": "Exp",
        "ln": "Ln",
        "magnitude": "Length",
        "not": "Not",
        "rgbtohsv": "RgbToHsv",
        "hsvtorgb": "HsvToRgb",
        "premult": "Premultiply",
        "unpremult": "Unpremultiply",
    },
)
_lower_alike(
    {"fg": "Fg", "bg": "Bg", "mix": "Mix"},
    {
        "mix": "Mix",
        "plus": "BlendPlus",
        "minus": "BlendMinus",
        "difference": "BlendDifference",
        "screen": "BlendScreen",
        "burn": "BlendBurn",
        "dodge": "BlendDodge",
        "in": "BlendIn",
        "out": "BlendOut",
        "over": "BlendOver",
        "mask": "BlendMask",
        "matte": "BlendMatte",
        "disjointover": "BlendDisjointOver",
    },
)
_lower_alike({"in": "A", "mask": "B"}, {"inside": "Mul"})
_lower_alike({"in": "In", "low": "Low", "high": "High"}, {"clamp": "Clamp", "smoothstep": "Smoothstep"})
_lower_alike({"amount": "A", "in": "B"}, {"invert": "Sub"})
_lower_alike({"iny": "Y", "inx": "X"}, {"atan2": "Atan2"})
_lower_alike(
    {"in": "In", "inlow": "InLow", "inhigh": "InHigh", "outlow": "OutLow", "outhigh": "OutHigh"}, {"remap": "Remap"}
)
_lower_alike({"in": "In", "amount": "Angle"}, {"rotate2d": "Rotate2D"})
_lower_alike({"in": "In", "amount": "Angle", "axis": "Axis"}, {"rotate3d": "Rotate3D"})
_lower_alike({"in": "In", "lumacoeffs": "Weights"}, {"luminance": "Luminance"})
_lower_alike({"valuel": "Left", "valuer": "Right", "texcoord": "UV"}, {"ramplr": "RampLR"})
_lower_alike({"valuet": "Top", "valueb": "Bottom", "texcoord": "UV"}, {"ramptb": "RampTB"})
_lower_alike({"valuel": "Left", "valuer": "Right", "center": "Center", "texcoord": "UV"}, {"splitlr": "SplitLR"})
_lower_alike({"valuet": "Top", "valueb": "Bottom", "center": "Center", "texcoord": "UV"}, {"splittb": "SplitTB"})
_lower_alike({"in": "Height", "scale": "Scale", "texcoord": "UV"}, {"heighttonormal": "HeightToNormal"})
_lower_alike({"texcoord": "UV"}, {"cellnoise2d": "CellNoise2D"})
_lower_alike({"position": "Position"}, {"cellnoise3d": "CellNoise3D"})


def _color(color: Signal) -> Signal:
    """The first three channels."""
    return color.builder.call("Color", In=color) if color.width == 4 else color


def _channels(signal: Signal) -> list[Signal]:
    if signal.width == 1:
        return [signal]
    return list(signal.builder.outputs(f"Separate{signal.width}", In=signal).values())


def _with_alpha(color: Signal, alpha: Signal) -> Signal:
    return color.builder.call("Append", A=color, B=alpha)


def _combined(b: Builder, *channels: Signal) -> Signal:
    if len(channels) == 1:
        return channels[0]
    return b.call(f"Combine{len(channels)}", **dict(zip("XYZW", channels, strict=False)))


def _repeated(signal: Signal, width: int) -> Signal:
    if signal.constant is not None:
        return signal.builder.constant(signal.constant * width)
    return _combined(signal.builder, *[signal] * width)


def resized(signal: Signal, width: int) -> Signal:
    """A signal with so many channels, as MaterialX's convert makes it: one number repeated, missing ones 0, alpha 1."""
    if signal.width == width:
        return signal
    if signal.width == 1:
        return _repeated(signal, width)
    if (signal.width, width) == (4, 3):
        return _color(signal)
    if (signal.width, width) == (3, 4):
        return _with_alpha(signal, signal.builder.constant((1.0,)))
    channels = [*_channels(signal)[:width], signal.builder.constant((0.0,)), signal.builder.constant((1.0,))]
    return _combined(signal.builder, *(channels[:width] if width < 4 else channels))


def _whole(signal: Signal, what: str) -> int:
    if signal.constant is None:
        signal.builder.fail(f"{what} is connected to a node; expected a constant")
    return int(signal.constant[0])


# Channels.


@lowers("combine2", "combine3", "combine4")
def combine(b: Builder, in1: Signal, in2: Signal, in3: Signal | None, in4: Signal | None) -> Signal:
    given = [signal for signal in (in1, in2, in3, in4) if signal is not None]
    if in1.width > 1:
        return b.call("Append", A=in1, B=in2)
    return _combined(b, *given)


@lowers("extract")
def extract(b: Builder, in_: Signal, index: Signal) -> Signal:
    number = _whole(index, "index")
    if not 0 <= number < in_.width:
        b.fail(f"index {number}; expected 0 to {in_.width - 1}")
    return _channels(in_)[number]


@lowers("separate2", "separate3", "separate4")
def separate(b: Builder, in_: Signal) -> dict[str, Signal]:
    """Both names of each output: as of vectors and as of colours."""
    channels = _channels(in_)
    return {f"out{n}": c for names in ("xyzw", "rgba") for n, c in zip(names, channels, strict=False)}


@lowers("dot")
def dot(b: Builder, in_: Value) -> Value:
    return in_


@lowers("convert")
def convert(b: Builder, in_: Signal, width: int) -> Signal:
    if in_.tangent:
        b.fail(NORMAL_MAP_MISUSED)
    return resized(in_, width)


@lowers("constant")
def constant(b: Builder, value: Value) -> Value:
    return value


# Arithmetic.


@lowers("normalize")
def normalize(b: Builder, in_: Signal) -> Signal:
    return in_ if in_.tangent else b.call("Normalize", In=in_)


@lowers("outside")
def outside(b: Builder, in_: Signal, mask: Signal) -> Signal:
    return in_ * (1.0 - mask)


def _comparison(name: str, kind: str) -> None:
    @lowers(name)
    def lowering(b: Builder, value1: Signal, value2: Signal, in1: Signal | None, in2: Signal | None) -> Signal:
        yes, no = (b.constant((1.0,)), b.constant((0.0,))) if in1 is None else (in1, in2)
        return b.call(kind, Value1=value1, Value2=value2, In1=yes, In2=no)


for _name, _kind in {"ifgreater": "IfGreater", "ifgreatereq": "IfGreaterEqual", "ifequal": "IfEqual"}.items():
    _comparison(_name, _kind)


@lowers("transformmatrix")
def transformmatrix(b: Builder, in_: Signal, mat: tuple[float, ...]) -> Signal:
    """A row vector times a matrix; one with a row more than the vector has channels also moves."""
    size, width = math.isqrt(len(mat)), in_.width
    columns = [mat[column::size] for column in range(width)]
    rows = {f"Row{i}": b.constant(tuple(column[:width])) for i, column in enumerate(columns)}
    if width < 4:
        rows["Offset"] = b.constant(tuple(column[width] if size > width else 0.0 for column in columns))
    return b.call(f"Transform{width}", In=in_, **rows)


# Where on the surface.


@lowers("texcoord")
def texcoord(b: Builder, index: Signal) -> Signal:
    if _whole(index, "index") != 0:
        b.fail("reads a second set of texture coordinates; expected index 0")
    scale, offset = V_UP
    return b.call("UVInput") * b.constant(scale) + b.constant(offset)


def _of_the_object(name: str, kind: str) -> None:
    @lowers(name)
    def lowering(b: Builder, space: str) -> Signal:
        if space not in ("object", "model"):
            b.fail(f"reads the {name} in {printable(space)!r} space; expected object or model")
        return b.call(kind)


_of_the_object("position", "PositionInput")
_of_the_object("normal", "NormalInput")


# Textures.


@lowers("image")
def image(
    b: Builder,
    width: int,
    file: str,
    srgb: bool,
    default: Signal,
    texcoord: Signal,
    uaddressmode: str,
    vaddressmode: str,
    filtertype: str,
    layer: str,
    framerange: str,
) -> Signal:
    if not file:
        return default
    if re.search(r"[<>{}\[\]]", file):
        b.fail(f"file {printable(str(file))!r} has a token in it; expected the name of one picture")
    for what, value in (("layer", layer), ("framerange", framerange)):
        if value:
            b.fail(f"{what} {printable(value)!r} is not supported; expected none")
    for mode in (uaddressmode, vaddressmode):
        if mode not in WRAPS:
            b.fail(f"address mode {printable(mode)!r} is not supported; expected one of {', '.join(WRAPS)}")
    if filtertype == "closest":
        b.note("its picture is filtered, though it asks for the closest texel")
    wrap = WRAPS[uaddressmode], WRAPS[vaddressmode]
    texture = b.texture(str(file), srgb, wrap)
    texels = b.call("Image", {"Texture": texture}, UV=_in_the_picture(texcoord, wrap))
    return resized(texels, width) if width >= 3 else _combined(b, *_channels(texels)[:width])


def _in_the_picture(texcoord: Signal, wrap: tuple[str, str]) -> Signal:
    """MaterialX's texture coordinates as the picture's, in which v grows downwards. Where the picture repeats, whole
    repetitions are left out."""
    base, scale, offset = texcoord.builder.affine(texcoord)
    scale = tuple(s * turn for s, turn in zip(scale, V_UP[0], strict=True))
    offset = tuple(o * turn + shift for o, turn, shift in zip(offset, *V_UP, strict=True))
    period = {"repeat": 1.0, "mirror": 2.0, "clamp": math.inf}
    offset = tuple(math.fmod(o, period[mode]) for o, mode in zip(offset, wrap, strict=True))
    return base * base.builder.constant(scale) + base.builder.constant(offset)


@lowers("normalmap")
def normalmap(b: Builder, in_: Signal, scale: Signal) -> Signal:
    """A normal in tangent space. Up in the picture is the same direction in both conventions of v."""
    normal = b.call("NormalMap", In=in_, Scale=scale)
    return Signal(b, normal.source, 3, tangent=True)


# Noise.


def _octaves(octaves: Signal) -> dict[str, int]:
    count = _whole(octaves, "octaves")
    if count > MAX_OCTAVES:
        octaves.builder.note(f"{count} octaves of noise are cut to {MAX_OCTAVES}")
    return {"Octaves": min(max(count, 0), MAX_OCTAVES)}


def _noise(
    kind: str, width: int, socket: str, at: Signal, amplitude: Signal, shift2: tuple | None, shift4: tuple, **rest
) -> Signal:
    """Noise of `width` channels: the first ones of a noise of three, or independent ones at a distance."""
    b = at.builder

    def one(shift: tuple[float, ...]) -> Signal:
        return b.call(kind, **{socket: at + b.constant(shift)}, **rest)

    if width == 1:
        noise = one((0.0,))
    elif width == 2 and shift2 is not None:
        noise = _combined(b, one((0.0,)), one(shift2))
    else:
        three = b.call(f"{kind}Float3", **{socket: at}, **rest)
        noise = {2: lambda: _combined(b, *_channels(three)[:2]), 3: lambda: three}.get(
            width, lambda: _with_alpha(three, one(shift4))
        )()
    return noise * amplitude


@lowers("noise2d")
def noise2d(b: Builder, width: int, amplitude: Signal, pivot: Signal, texcoord: Signal) -> Signal:
    return _noise("Noise2D", width, "UV", texcoord, amplitude, None, (19.0, 73.0)) + pivot


@lowers("noise3d")
def noise3d(b: Builder, width: int, amplitude: Signal, pivot: Signal, position: Signal) -> Signal:
    return _noise("Noise3D", width, "Position", position, amplitude, None, (19.0, 73.0, 29.0)) + pivot


@lowers("fractal2d")
def fractal2d(
    b: Builder, width: int, amplitude: Signal, octaves: Signal, lacunarity: Signal, diminish: Signal, texcoord: Signal
) -> Signal:
    rest = {"integers": _octaves(octaves), "Lacunarity": lacunarity, "Diminish": diminish}
    return _noise("Fractal2D", width, "UV", texcoord, amplitude, (19.0, 193.0), (19.0, 193.0), **rest)


@lowers("fractal3d")
def fractal3d(
    b: Builder, width: int, amplitude: Signal, octaves: Signal, lacunarity: Signal, diminish: Signal, position: Signal
) -> Signal:
    rest = {"integers": _octaves(octaves), "Lacunarity": lacunarity, "Diminish": diminish}
    shift = (19.0, 193.0, 17.0)
    return _noise("Fractal3D", width, "Position", position, amplitude, shift, shift, **rest)


def _worley(name: str, place: str, kind: str, socket: str) -> None:
    def lowering(b: Builder, width: int, at: Signal, jitter: Signal, style: Signal) -> Signal:
        which = kind if width == 1 else f"{kind}Float3"
        noise = b.call(which, {"Style": _whole(style, "style")}, **{socket: at}, Jitter=jitter)
        return _combined(b, *_channels(noise)[:2]) if width == 2 else noise

    LOWERINGS[name] = lowering
    INPUTS[name] = ("width", place, "jitter", "style")


_worley("worleynoise2d", "texcoord", "Worley2D", "UV")
_worley("worleynoise3d", "position", "Worley3D", "Position")
