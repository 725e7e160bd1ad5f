"""The nodes of material graphs in NumPy: what the functions of `cl/graph/nodes/` compute, for many points at once.

They are written from the same definitions, not from that code, so that each side checks the other. Derivatives come from
dual numbers: `Dual` carries a value's change along the two axes of the footprint through each operation. All arrays are
(n, width), a float's width is 1, and arithmetic is that of the inputs' dtype: float32 as on the device, or float64.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..scene.model import Texture
from ..scene.textures import mip_chain, srgb_to_linear
from .model import LARGEST

SMALLEST_NORMAL = 1.17549435e-38
MOST_OCTAVES = 32

NODES: dict[str, Callable[..., object]] = {}


@dataclass(frozen=True)
class Dual:
    """A value and its changes along the footprint's axes, each (n, width); None for changes that are 0 or not asked for."""

    v: np.ndarray
    x: np.ndarray | None = None
    y: np.ndarray | None = None

    def __add__(self, other):
        other = _dual(other, self)
        return _chain(self.v + other.v, (1.0, self), (1.0, other))

    def __sub__(self, other):
        other = _dual(other, self)
        return _chain(self.v - other.v, (1.0, self), (-1.0, other))

    def __rsub__(self, other):
        return _dual(other, self) - self

    def __mul__(self, other):
        """At most the largest float32 in size, as quotients."""
        other = _dual(other, self)
        return _chain(_within_floats(self.v * other.v), (other.v, self), (self.v, other))

    def __neg__(self):
        return _chain(-self.v, (-1.0, self))

    def __truediv__(self, other):
        """0 where the divisor is."""
        other = _dual(other, self)
        ratio = _quotient(self.v, other.v)
        return _chain(ratio, (_quotient(np.ones_like(other.v), other.v), self), (-_quotient(ratio, other.v), other))

    __radd__, __rmul__ = __add__, __mul__

    def __getitem__(self, components) -> "Dual":
        keep = [components] if isinstance(components, int) else components
        return self.each(lambda a: a[:, keep])

    @property
    def width(self) -> int:
        return self.v.shape[1]

    def each(self, function: Callable[[np.ndarray], np.ndarray]) -> "Dual":
        """A linear function of the value and of the changes."""
        return Dual(*(None if a is None else function(a) for a in (self.v, self.x, self.y)))

    def components(self) -> list["Dual"]:
        return [self[k] for k in range(self.width)]

    def constant(self) -> "Dual":
        return Dual(self.v)


def _dual(value, like: Dual) -> Dual:
    return value if isinstance(value, Dual) else Dual(np.asarray(value, like.v.dtype).reshape(1, -1))


def _chain(value: np.ndarray, *terms: tuple[object, Dual]) -> Dual:
    """A function's value with the changes that the chain rule gives: partial derivative and argument of each term."""

    def change(axis: str) -> np.ndarray | None:
        parts = [np.where(a == 0, a, slope * a) for slope, d in terms if (a := getattr(d, axis)) is not None]
        return np.broadcast_to(sum(parts), value.shape) if parts else None

    return Dual(value, change("x"), change("y"))


def _where(condition: np.ndarray, a: Dual, b: Dual) -> Dual:
    """a where the condition holds, else b."""

    def pick(p, q):
        if p is None and q is None:
            return None
        return np.where(condition, a.v.dtype.type(0) if p is None else p, a.v.dtype.type(0) if q is None else q)

    return Dual(np.where(condition, a.v, b.v), pick(a.x, b.x), pick(a.y, b.y))


def _stack(parts: Sequence[Dual]) -> Dual:
    """The components of several values behind one another."""
    rows = max(len(p.v) for p in parts)

    def joined(axis: str) -> np.ndarray | None:
        arrays = [getattr(p, axis) for p in parts]
        if all(a is None for a in arrays):
            return None
        arrays = [np.zeros_like(p.v) if a is None else a for a, p in zip(arrays, parts, strict=True)]
        return np.concatenate([np.broadcast_to(a, (rows, a.shape[1])) for a in arrays], axis=1)

    return Dual(joined("v"), joined("x"), joined("y"))


def _within_floats(a: np.ndarray) -> np.ndarray:
    largest = a.dtype.type(LARGEST)
    return np.clip(np.where(np.isnan(a), largest, a), -largest, largest)


def _quotient(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b == 0, a.dtype.type(0), _within_floats(a / np.where(b == 0, a.dtype.type(1), b)))


def _bounded(a: np.ndarray, low: float, high: float) -> np.ndarray:
    return np.minimum(
        np.maximum(np.nan_to_num(a, nan=low, posinf=high, neginf=low), a.dtype.type(low)), a.dtype.type(high)
    )


def _node(*kinds: str):
    def register(function):
        NODES.update(dict.fromkeys(kinds, function))
        return function

    return register


# Arithmetic.

_node("Add")(lambda A, B: A + B)
_node("Sub")(lambda A, B: A - B)
_node("Mul")(lambda A, B: A * B)
_node("Div")(lambda A, B: A / B)
_node("Mix")(lambda Fg, Bg, Mix: _between(Bg, Fg, Mix))
_node("Sign")(lambda In: Dual(np.sign(In.v)))
_node("Floor")(lambda In: Dual(np.floor(In.v)))
_node("Ceil")(lambda In: Dual(np.ceil(In.v)))
_node("Fract")(lambda In: _chain(In.v - np.floor(In.v), (1.0, In)))
_node("Min")(lambda A, B: _where(B.v < A.v, B, A))
_node("Max")(lambda A, B: _where(B.v > A.v, B, A))


def _between(a: Dual, b: Dual, part: Dual) -> Dual:
    return a + (b - a) * part


@_node("Mod")
def _mod(A: Dual, B: Dual) -> Dual:
    ratio = _quotient(A.v, B.v)
    remainder = A - B * Dual(np.floor(ratio))
    return _where((B.v != 0) & (np.abs(ratio) < 2.0**23), remainder, _dual(0.0, A))


def _power(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    size = np.abs(x)
    value = np.where(
        size < SMALLEST_NORMAL, x.dtype.type(0), np.power(np.maximum(size, x.dtype.type(SMALLEST_NORMAL)), y)
    )
    value = np.where(value < SMALLEST_NORMAL, x.dtype.type(0), np.minimum(value, x.dtype.type(LARGEST)))
    is_odd = np.abs(np.fmod(y, 2)) == 1
    of_negative = np.where(y == np.floor(y), np.where(is_odd, -value, value), x.dtype.type(0))
    return np.where(y == 0, x.dtype.type(1), np.where(x < 0, of_negative, value))


def _logarithm(x: np.ndarray) -> np.ndarray:
    return np.log(_bounded(x, SMALLEST_NORMAL, LARGEST))


def _dual_power(a: Dual, b: Dual) -> Dual:
    value = _power(a.v, b.v)
    by_b = value * np.where(a.v > 0, _logarithm(a.v), a.v.dtype.type(0))
    return _chain(value, (b.v * _power(a.v, b.v - 1), a), (by_b, b))


_node("Pow")(lambda A, B: _dual_power(A, B))
_node("SafePow")(lambda A, B: Dual(np.sign(A.v)) * _dual_power(_absolute(A), B))


@_node("Abs")
def _absolute(In: Dual) -> Dual:
    return _chain(np.abs(In.v), (np.sign(In.v), In))


@_node("Round")
def _round(In: Dual) -> Dual:
    whole = np.trunc(In.v)
    return Dual(whole + np.where(np.abs(In.v - whole) >= 0.5, np.sign(In.v), In.v.dtype.type(0)))


@_node("Clamp")
def _clamp(In: Dual, Low: Dual, High: Dual) -> Dual:
    raised = _where(In.v < Low.v, Low, In)
    return _where(raised.v > High.v, High, raised)


@_node("Sqrt")
def _sqrt(In: Dual) -> Dual:
    root = np.sqrt(np.maximum(In.v, 0))
    return _chain(root, (_quotient(np.full_like(root, 0.5), root), In))


@_node("Ln")
def _ln(In: Dual) -> Dual:
    return _chain(_logarithm(In.v), (np.where(In.v > 0, _quotient(np.ones_like(In.v), In.v), In.v.dtype.type(0)), In))


@_node("Exp")
def _exp(In: Dual) -> Dual:
    value = np.exp(In.v)
    value = np.where(value < SMALLEST_NORMAL, In.v.dtype.type(0), np.minimum(value, In.v.dtype.type(LARGEST)))
    return _chain(value, (value, In))


def _turns(radians: np.ndarray) -> np.ndarray:
    """Radians as a part of a turn, -1/2 to 1/2, in the arithmetic of the dtype: what large angles lose, they lose here."""
    turns = _bounded(radians, -1e30, 1e30) * (0.5 / np.pi)
    return turns - np.floor(turns + 0.5)


@_node("Sin")
def _sin(In: Dual) -> Dual:
    angle = 2 * np.pi * _turns(In.v)
    return _chain(np.sin(angle), (np.cos(angle), In))


@_node("Cos")
def _cos(In: Dual) -> Dual:
    angle = 2 * np.pi * _turns(In.v)
    return _chain(np.cos(angle), (-np.sin(angle), In))


_node("Tan")(lambda In: _sin(In) / _cos(In))


@_node("Asin")
def _asin(In: Dual) -> Dual:
    bounded = np.clip(In.v, -1, 1)
    return _chain(np.arcsin(bounded), (_quotient(np.ones_like(bounded), np.sqrt((1 - bounded) * (1 + bounded))), In))


@_node("Acos")
def _acos(In: Dual) -> Dual:
    return _chain(np.arccos(np.clip(In.v, -1, 1)), (-1.0, _asin(In)))


@_node("Atan2")
def _atan2(Y: Dual, X: Dual) -> Dual:
    squared = X.v * X.v + Y.v * Y.v
    angle = np.where((X.v == 0) & (Y.v == 0), squared, np.arctan2(Y.v, X.v))
    return _chain(angle, (_quotient(X.v, squared), Y), (-_quotient(Y.v, squared), X))


@_node("Smoothstep")
def _smoothstep(In: Dual, Low: Dual, High: Dual) -> Dual:
    t = (In - Low) / (High - Low)
    between = _where(In.v > Low.v, t * t * (3.0 - 2.0 * t), _dual(0.0, In))
    return _where(In.v >= High.v, _dual(1.0, In), between)


@_node("Remap")
def _remap(In: Dual, InLow: Dual, InHigh: Dual, OutLow: Dual, OutHigh: Dual) -> Dual:
    return _between(OutLow, OutHigh, (In - InLow) / (InHigh - InLow))


# Choices.

_node("IfGreater")(lambda Value1, Value2, In1, In2: _where(Value1.v > Value2.v, In1, In2))
_node("IfGreaterEqual")(lambda Value1, Value2, In1, In2: _where(Value1.v >= Value2.v, In1, In2))
_node("IfEqual")(lambda Value1, Value2, In1, In2: _where(Value1.v == Value2.v, In1, In2))
_node("And")(lambda A, B: Dual(((A.v != 0) & (B.v != 0)).astype(A.v.dtype)))
_node("Or")(lambda A, B: Dual(((A.v != 0) | (B.v != 0)).astype(A.v.dtype)))
_node("Xor")(lambda A, B: Dual(((A.v != 0) ^ (B.v != 0)).astype(A.v.dtype)))
_node("Not")(lambda In: Dual((In.v == 0).astype(In.v.dtype)))

# Vectors.

_node("Combine2")(lambda X, Y: _stack([X, Y]))
_node("Combine3")(lambda X, Y, Z: _stack([X, Y, Z]))
_node("Combine4")(lambda X, Y, Z, W: _stack([X, Y, Z, W]))
_node("Append")(lambda A, B: _stack([A, B]))
_node("Color")(lambda In: In[[0, 1, 2]])
_node("Separate2", "Separate3", "Separate4")(lambda In: dict(zip("XYZW", In.components(), strict=False)))
_node("Extract")(lambda In, Index: In[min(max(Index, 0), In.width - 1)])
_node("Distance")(lambda A, B: _length(A - B))


@_node("Dot")
def _dot(A: Dual, B: Dual) -> Dual:
    return sum(((A[k] * B[k]) for k in range(1, A.width)), A[0] * B[0])


@_node("Cross")
def _cross(A: Dual, B: Dual) -> Dual:
    return A[[1, 2, 0]] * B[[2, 0, 1]] - A[[2, 0, 1]] * B[[1, 2, 0]]


@_node("Length")
def _length(In: Dual) -> Dual:
    return _dot(_normalize(In.constant()), In)


@_node("Normalize")
def _normalize(In: Dual) -> Dual:
    """Scaled by a power of two first, as squares of large and small numbers are out of range."""
    exponent = np.frexp(np.abs(In.v).max(axis=1, keepdims=True))[1]
    scaled = In.each(lambda a: np.ldexp(a, -exponent))
    return scaled / _sqrt(_dot(scaled, scaled))


def _sine_and_cosine(degrees: Dual) -> tuple[Dual, Dual]:
    turns = _bounded(degrees.v, -1e30, 1e30) / degrees.v.dtype.type(360)
    angle = 2 * np.pi * (turns - np.floor(turns + 0.5))
    sine, cosine = np.sin(angle), np.cos(angle)
    return _chain(sine, (np.pi / 180 * cosine, degrees)), _chain(cosine, (-np.pi / 180 * sine, degrees))


@_node("Rotate2D")
def _rotate_2d(In: Dual, Angle: Dual) -> Dual:
    sine, cosine = _sine_and_cosine(Angle)
    return _stack([cosine * In[0] + sine * In[1], cosine * In[1] - sine * In[0]])


@_node("Rotate3D")
def _rotate_3d(In: Dual, Angle: Dual, Axis: Dual) -> Dual:
    sine, cosine = _sine_and_cosine(Angle)
    unit = _normalize(Axis)
    return In * cosine + _cross(In, unit) * sine + unit * _dot(unit, In) * (1.0 - cosine)


@_node("Transform2", "Transform3", "Transform4")
def _transform(In: Dual, Row0: Dual, Row1: Dual, Row2: Dual = None, Row3: Dual = None, Offset: Dual = None) -> Dual:
    products = _stack([_dot(row, In) for row in (Row0, Row1, Row2, Row3) if row is not None])
    return products if Offset is None else products + Offset


# Ramps.


def _along_ramp(at: Dual) -> Dual:
    inside = (at.v > 0) & (at.v < 1)
    return _where(inside, at, Dual(np.clip(np.nan_to_num(at.v), 0, 1)))


_node("RampLR")(lambda Left, Right, UV: _between(Left, Right, _along_ramp(UV[0])))
_node("RampTB")(lambda Top, Bottom, UV: _between(Bottom, Top, _along_ramp(UV[1])))
_node("SplitLR")(lambda Left, Right, Center, UV: _between(Left, Right, _step(Center, UV[0])))
_node("SplitTB")(lambda Top, Bottom, Center, UV: _between(Bottom, Top, _step(Center, UV[1])))


def _step(threshold: Dual, at: Dual) -> Dual:
    """Smoothed over the change of `at`; sharp where that is 0."""
    half_width = Dual(_root_of_squares(at) / at.v.dtype.type(np.sqrt(2)))
    smooth = _smoothstep(at, threshold - half_width, threshold + half_width)
    sharp = Dual((at.v >= threshold.v).astype(at.v.dtype))
    return _where(half_width.v > 0, smooth, sharp)


def _root_of_squares(at: Dual) -> np.ndarray:
    x, y = (np.zeros_like(at.v) if a is None else a for a in (at.x, at.y))
    return np.sqrt(x * x + y * y)


# Colours.


def _on_color(function: Callable[[Dual], Dual]) -> Callable[[Dual], Dual]:
    """A function of three components that leaves a fourth as it is."""
    return lambda In: function(In) if In.width == 3 else _stack([function(In[[0, 1, 2]]), In[3]])


@_node("Luminance")
def _luminance(In: Dual, Weights: Dual) -> Dual:
    return _on_color(lambda rgb: _stack([_dot(rgb, Weights)] * 3))(In)


@_node("RgbToHsv")
@_on_color
def _rgb_to_hsv(In: Dual) -> Dual:
    r, g, b = In.components()
    value = _where((r.v >= g.v) & (r.v >= b.v), r, _where(g.v >= b.v, g, b))
    least = _where((r.v <= g.v) & (r.v <= b.v), r, _where(g.v <= b.v, g, b))
    chroma = value - least
    zero = _dual(0.0, r)
    saturation = _where(value.v > 0, chroma / value, zero)
    sextants = _where(
        value.v == r.v, (g - b) / chroma, _where(value.v == g.v, 2.0 + (b - r) / chroma, 4.0 + (r - g) / chroma)
    )
    hue = sextants * (1 / 6)
    hue = _where(hue.v < 0, hue + 1.0, hue)
    return _stack([_where(saturation.v > 0, hue, zero), saturation, value])


@_node("HsvToRgb")
@_on_color
def _hsv_to_rgb(In: Dual) -> Dual:
    hue, saturation, value = In.components()
    saturation = _where(saturation.v < 0, _dual(0.0, saturation), saturation)
    sextant = 6.0 * _chain(hue.v - np.floor(hue.v), (1.0, hue))
    number = np.minimum(np.floor(np.nan_to_num(sextant.v)), 5).astype(int) % 6
    part = sextant - Dual(np.floor(sextant.v))
    low, falling = value * (1.0 - saturation), value * (1.0 - saturation * part)
    rising = value * (1.0 - saturation * (1.0 - part))
    orders = [
        (value, rising, low), (falling, value, low), (low, value, rising),
        (low, falling, value), (rising, low, value), (value, low, falling),
    ]  # fmt: skip
    color = _stack(orders[0])
    for k in range(1, 6):
        color = _where(number == k, _stack(orders[k]), color)
    return color


_node("Premultiply")(lambda In: _stack([In[[0, 1, 2]] * In[3], In[3]]))
_node("Unpremultiply")(lambda In: _stack([In[[0, 1, 2]] / In[3], In[3]]))


def _blend(kind: str):
    """Register a function of foreground and background, mixed with the background."""

    def register(function):
        NODES[kind] = lambda Fg, Bg, Mix: _between(Bg, function(Fg, Bg), Mix)
        return function

    return register


_blend("BlendPlus")(lambda fg, bg: bg + fg)
_blend("BlendMinus")(lambda fg, bg: bg - fg)
_blend("BlendDifference")(lambda fg, bg: _absolute(bg - fg))
_blend("BlendScreen")(lambda fg, bg: 1.0 - (1.0 - fg) * (1.0 - bg))
_blend("BlendIn")(lambda fg, bg: fg * bg[3])
_blend("BlendMask")(lambda fg, bg: bg * fg[3])
_blend("BlendOut")(lambda fg, bg: fg * (1.0 - bg[3]))
_blend("BlendOver")(lambda fg, bg: fg + bg * (1.0 - fg[3]))
_blend("BlendMatte")(lambda fg, bg: _stack([fg[[0, 1, 2]] * fg[3], fg[3]]) + bg * (1.0 - fg[3]))


@_node("BlendBurn")
def _burn(Fg: Dual, Bg: Dual, Mix: Dual) -> Dual:
    burnt = _between(Bg, 1.0 - (1.0 - Bg) / Fg, Mix)
    return _where(np.abs(Fg.v) < 1e-8, _dual(0.0, Fg), burnt)


@_node("BlendDodge")
def _dodge(Fg: Dual, Bg: Dual, Mix: Dual) -> Dual:
    room = 1.0 - Fg
    return _where(np.abs(room.v) < 1e-8, _dual(0.0, Fg), _between(Bg, Bg / room, Mix))


@_blend("BlendDisjointOver")
def _disjoint_over(fg: Dual, bg: Dual) -> Dual:
    alpha = fg[3] + bg[3]
    fits = alpha.v <= 1
    room = _where(fits, _dual(1.0, alpha), (1.0 - fg[3]) / bg[3])
    color = fg[[0, 1, 2]] + bg[[0, 1, 2]] * room
    is_black = ~fits & (np.abs(bg[3].v) < 1e-8)
    return _stack([_where(is_black, _dual(0.0, alpha), color), _where(fits, alpha, _dual(1.0, alpha))])


# Pictures.


@_node("NormalMap")
def _normal_map(In: Dual, Scale: Dual) -> Dual:
    normal = 2.0 * In - 1.0
    flat = Dual(np.array([[0, 0, 1]], In.v.dtype))
    return _where((In.v == 0).all(axis=1, keepdims=True), flat, _stack([normal[[0, 1]] * Scale, normal[2]]))


@_node("HeightToNormal")
def _height_to_normal(Height: Dual, Scale: Dual, UV: Dual) -> Dual:
    zeros = np.zeros((len(UV.v), 3), UV.v.dtype)

    def tangent(uv: np.ndarray | None, height: np.ndarray | None) -> Dual:
        uv = zeros[:, :2] if uv is None else uv
        return Dual(np.hstack([uv, zeros[:, :1] if height is None else height * Scale.v / 16]))

    along_x, along_y = tangent(UV.x, Height.x), tangent(UV.y, Height.y)
    normal = _normalize(_cross(_normalize(along_x), _normalize(along_y))).v
    normal = np.where(normal[:, 2:] < 0, -normal, normal)
    determinant = along_x.v[:, :1] * along_y.v[:, 1:2] - along_x.v[:, 1:2] * along_y.v[:, :1]
    flat = np.array([[0, 0, 1]], UV.v.dtype)
    return Dual(np.where((determinant != 0) & np.isfinite(normal[:, 2:]), normal, flat) * UV.v.dtype.type(0.5) + 0.5)


@_node("Image")
def _image(UV: Dual, Texture: Texture) -> Dual:
    levels = _linear_levels(Texture, UV.v.dtype)
    axes = [np.zeros_like(UV.v) if a is None else a for a in (UV.x, UV.y)]
    lengths = [_length(Dual(a)).v[:, 0] for a in axes]
    width = np.sqrt(lengths[0]) * np.sqrt(lengths[1])

    def look_up(uv: np.ndarray) -> np.ndarray:
        return _trilinear(levels, Texture.wrap, uv, width)

    if UV.x is None:
        return Dual(look_up(UV.v))
    return Dual(look_up(UV.v), *(look_up(UV.v + 0.5 * a) - look_up(UV.v - 0.5 * a) for a in axes))


def _linear_levels(texture: Texture, dtype: np.dtype) -> list[np.ndarray]:
    """The picture's mip levels as linear numbers."""
    levels = [level.astype(dtype) / 255 for level in mip_chain(texture)]
    if texture.srgb:
        for level in levels:
            level[..., :3] = srgb_to_linear(level[..., :3])
    return levels


def _trilinear(levels: list[np.ndarray], wrap: tuple[str, str], uv: np.ndarray, width: np.ndarray) -> np.ndarray:
    """(n, 4) at uv (n, 2), for footprints of this width (n,); v grows downwards, texel centres lie at half-integer places."""
    uv = np.where(np.isfinite(uv), uv, 0).astype(uv.dtype)
    height, breadth = levels[0].shape[:2]
    texels = np.where(width <= 1e15, width, 1e15).astype(uv.dtype) * uv.dtype.type(np.sqrt(height * breadth))
    level = np.clip(np.log2(np.maximum(texels, 1)), 0, len(levels) - 1)
    sharper = np.floor(level).astype(int)
    result = np.zeros((len(uv), 4), uv.dtype)
    for number in range(len(levels)):
        weight = np.maximum(0, 1 - np.abs(level - number)).astype(uv.dtype)
        at = np.flatnonzero((sharper == number) | (sharper == number - 1))
        if len(at):
            result[at] += weight[at, None] * _bilinear(levels[number], wrap, uv[at])
    return result


def _bilinear(texels: np.ndarray, wrap: tuple[str, str], uv: np.ndarray) -> np.ndarray:
    sizes = texels.shape[1], texels.shape[0]
    first, second, part = [], [], []
    for coordinate, size, mode in zip(uv.T, sizes, wrap, strict=True):
        inside = np.clip(coordinate, 0, 1) if mode == "clamp" else coordinate - 2 * np.floor(0.5 * coordinate)
        place = inside * size - uv.dtype.type(0.5)
        whole = np.floor(place).astype(int)
        first.append(_wrapped(whole, size, mode))
        second.append(_wrapped(whole + 1, size, mode))
        part.append((place - whole)[:, None].astype(uv.dtype))
    above = (1 - part[0]) * texels[first[1], first[0]] + part[0] * texels[first[1], second[0]]
    below = (1 - part[0]) * texels[second[1], first[0]] + part[0] * texels[second[1], second[0]]
    return (1 - part[1]) * above + part[1] * below


def _wrapped(place: np.ndarray, size: int, mode: str) -> np.ndarray:
    if mode == "clamp":
        return np.clip(place, 0, size - 1)
    if mode == "repeat":
        return place % size
    folded = place % (2 * size)
    return np.minimum(folded, 2 * size - 1 - folded)


# Noise. Lattice points are hashed by Bob Jenkins' lookup3: a mix between each three words, another one at the end.

_FINAL = [(2, 1, 14), (0, 2, 11), (1, 0, 25), (2, 1, 16), (0, 2, 4), (1, 0, 14), (2, 1, 24)]
_MIX = [(0, 2, 4, 1), (1, 0, 6, 2), (2, 1, 8, 0), (0, 2, 16, 1), (1, 0, 19, 2), (2, 1, 4, 0)]
_GRADIENTS_2D = np.array(
    [(a, 2 * b) for b in (1, -1) for a in (1, -1)] + [(2 * b, a) for b in (1, -1) for a in (1, -1)]
)
_GRADIENTS_3D = np.array(
    [(a, b, 0) for b in (1, -1) for a in (1, -1)]
    + [(a, 0, b) for b in (1, -1) for a in (1, -1)]
    + [(0, a, b) for b in (1, -1) for a in (1, -1)]
    + [(1, 1, 0), (0, -1, 1), (-1, 1, 0), (0, -1, -1)]
)
_PERLIN_SCALE = {2: 0.6616, 3: 0.9820}


def _rotated(a: np.ndarray, bits: int) -> np.ndarray:
    return (a << np.uint32(bits)) | (a >> np.uint32(32 - bits))


def lookup3(*words: np.ndarray, initial: int = 13) -> np.ndarray:
    """Jenkins' hash of 32-bit words, of which there is one at least. initial: 13 in MaterialX."""
    words = np.broadcast_arrays(*words)
    start = np.uint32((0xDEADBEEF + 4 * len(words) + initial) & 0xFFFFFFFF)
    state = [np.full_like(words[0], start) for _ in range(3)]
    for first in range(0, len(words), 3):
        if first:
            for target, source, bits, third in _MIX:
                state[target] = (state[target] - state[source]) ^ _rotated(state[source], bits)
                state[source] = state[source] + state[third]
        for k, word in enumerate(words[first : first + 3]):
            state[k] = state[k] + word
    for target, source, bits in _FINAL:
        state[target] = (state[target] ^ state[source]) - _rotated(state[source], bits)
    return state[2]


def _cells(p: np.ndarray) -> np.ndarray:
    """The number of the cell of unit size that holds p, as 32-bit words."""
    return np.floor(_bounded(p, -1e9, 1e9)).astype(np.int64).astype(np.uint32)


def _part(p: Dual) -> Dual:
    """Where p lies in its cell."""
    return _chain(np.clip(np.nan_to_num(p.v - np.floor(p.v)), 0, 1), (1.0, p))


def _perlin(p: Dual, channel: int) -> Dual:
    dimensions, dtype = p.width, p.v.dtype
    gradients = (_GRADIENTS_2D if dimensions == 2 else _GRADIENTS_3D).astype(dtype)
    cell, part = _cells(p.v), _part(p)
    fade = part * part * part * (part * (part * 6.0 - 15.0) + 10.0)
    total = _dual(0.0, p)
    for corner in np.ndindex(*[2] * dimensions):
        hashed = lookup3(*(cell + np.array(corner, np.uint32)).T) >> np.uint32(8 * channel)
        product = _dot(part - np.array(corner), Dual(gradients[hashed % len(gradients)]))
        weight = _dual(1.0, p)
        for axis, end in enumerate(corner):
            weight = weight * (fade[axis] if end else 1.0 - fade[axis])
        total = total + weight * product
    return _PERLIN_SCALE[dimensions] * total


def _octaves(noise: Callable[[Dual], Dual], p: Dual, octaves: int, lacunarity: Dual, diminish: Dual) -> Dual:
    total, amplitude = Dual(np.zeros((len(p.v), 1), p.v.dtype)), Dual(np.ones((len(p.v), 1), p.v.dtype))
    for _ in range(min(octaves, MOST_OCTAVES)):
        total = total + amplitude * noise(p)
        amplitude = Dual(_bounded((amplitude * diminish).v, -1e30, 1e30))
        p = p * lacunarity
    return total


def _channels(p: Dual, count: int) -> Dual:
    return _stack([_perlin(p, channel) for channel in range(count)])


_node("Noise2D")(lambda UV: _channels(UV, 1))
_node("Noise3D")(lambda Position: _channels(Position, 1))
_node("Noise2DFloat3")(lambda UV: _channels(UV, 3))
_node("Noise3DFloat3")(lambda Position: _channels(Position, 3))


@_node("Fractal2D")
def _fractal_2d(UV: Dual, Octaves: int, Lacunarity: Dual, Diminish: Dual) -> Dual:
    return _octaves(lambda p: _channels(p, 1), UV, Octaves, Lacunarity, Diminish)


@_node("Fractal3D")
def _fractal_3d(Position: Dual, Octaves: int, Lacunarity: Dual, Diminish: Dual) -> Dual:
    return _octaves(lambda p: _channels(p, 1), Position, Octaves, Lacunarity, Diminish)


@_node("Fractal2DFloat3")
def _fractal_2d_float3(UV: Dual, Octaves: int, Lacunarity: Dual, Diminish: Dual) -> Dual:
    zero = Dual(np.zeros((len(UV.v), 3), UV.v.dtype))
    return zero + _octaves(lambda p: _channels(p, 3), UV, Octaves, Lacunarity, Diminish)


@_node("Fractal3DFloat3")
def _fractal_3d_float3(Position: Dual, Octaves: int, Lacunarity: Dual, Diminish: Dual) -> Dual:
    zero = Dual(np.zeros((len(Position.v), 3), Position.v.dtype))
    return zero + _octaves(lambda p: _channels(p, 3), Position, Octaves, Lacunarity, Diminish)


def _to_one(hashed: np.ndarray, dtype: np.dtype) -> np.ndarray:
    return hashed.astype(dtype) * dtype.type(2.0**-32)


def _cell_noise(p: np.ndarray, channels: int) -> np.ndarray:
    words = list(_cells(p).T)
    if channels == 1:
        return _to_one(lookup3(*words), p.dtype)[:, None]
    return np.stack([_to_one(lookup3(*words, np.full_like(words[0], k)), p.dtype) for k in range(channels)], axis=1)


_node("CellNoise2D")(lambda UV: Dual(_cell_noise(UV.v, 1)))
_node("CellNoise3D")(lambda Position: Dual(_cell_noise(Position.v, 1)))


def _worley(p: Dual, jitter: Dual, style: int, channels: int) -> Dual:
    """Distances to the nearest feature points, one in each cell, among the cells about p; or the nearest one's cell noise."""
    dimensions, dtype = p.width, p.v.dtype
    cell, part = _cells(p.v), _part(p)
    stray = Dual(_bounded(jitter.v, -1e6, 1e6))
    ways, squares = [], []
    for offset in np.ndindex(*[3] * dimensions):
        step = np.array(offset) - 1
        words = [*(cell + step.astype(np.uint32)).T]
        random = np.stack(
            [_to_one(lookup3(*words, np.full_like(words[0], k)), dtype) for k in range(dimensions)], axis=1
        )
        feature = (random - dtype.type(0.5)) * stray.v + dtype.type(0.5)
        ways.append(Dual(step.astype(dtype) + feature) - part)
        squares.append(_dot(ways[-1], ways[-1]))
    squared = np.stack([s.v[:, 0] for s in squares])
    order = np.argsort(np.minimum(squared, 1e6), axis=0, kind="stable")[:channels]
    rows = np.arange(len(p.v))
    if style != 0:
        seen = squared[order[0], rows] < 1e6
        way = np.where(seen[:, None], np.stack([w.v for w in ways])[order[0], rows], 0)
        floor = np.floor(_bounded(p.v, -1e9, 1e9)) + np.floor(part.v + way)
        return Dual(_cell_noise(floor.astype(dtype), channels))
    distances = []
    for nth in order:
        nearest = squares[0]
        for k in range(1, len(squares)):
            nearest = _where((nth == k)[:, None], squares[k], nearest)
        distances.append(_sqrt(_where(nearest.v < 1e6, nearest, _dual(1e6, nearest))))
    return _stack(distances)


_node("Worley2D")(lambda UV, Jitter, Style: _worley(UV, Jitter, Style, 1))
_node("Worley3D")(lambda Position, Jitter, Style: _worley(Position, Jitter, Style, 1))
_node("Worley2DFloat3")(lambda UV, Jitter, Style: _worley(UV, Jitter, Style, 3))
_node("Worley3DFloat3")(lambda Position, Jitter, Style: _worley(Position, Jitter, Style, 3))


def _simplex(p: Dual) -> Dual:
    """Over equilateral triangles, which skewing makes halves of squares: (1/2 - r^2)^4 about each corner weighs the product
    with its gradient. 99.204 brings unit gradients to -1 .. 1; these have the length sqrt(5)."""
    dtype = p.v.dtype
    skew, unskew = (np.sqrt(3) - 1) / 2, (3 - np.sqrt(3)) / 6
    place = Dual(_bounded(p.v, -1e8, 1e8), p.x, p.y)
    cell = np.floor(place.v + dtype.type(skew) * place.v.sum(axis=1, keepdims=True))
    from_first = place - Dual(cell - cell.sum(axis=1, keepdims=True) * dtype.type(unskew))
    is_right = from_first.v[:, :1] > from_first.v[:, 1:]
    total = _dual(0.0, p)
    gradients = _GRADIENTS_2D.astype(dtype)
    for number in range(3):
        middle = np.where(is_right, [[1, 0]], [[0, 1]])
        corner = [np.zeros_like(middle), middle, np.ones_like(middle)][number]
        away = from_first - Dual((corner - corner.sum(axis=1, keepdims=True) * unskew).astype(dtype))
        reach = 0.5 - _dot(away, away)
        reach = _where(reach.v > 0, reach, _dual(0.0, reach))
        hashed = lookup3(*(_cells(cell) + corner.astype(np.uint32)).T)
        total = total + reach * reach * reach * reach * _dot(away, Dual(gradients[hashed % 8]))
    return 44.3655 * total


@_node("SimplexFractal2D")
def _simplex_fractal(UV: Dual, Octaves: int, Lacunarity: Dual, Diminish: Dual) -> Dual:
    return _octaves(_simplex, UV, Octaves, Lacunarity, Diminish)
