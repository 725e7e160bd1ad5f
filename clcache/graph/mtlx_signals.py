"""Building a graph's nodes from formulas: signals are what flows between nodes, and computing with them adds nodes.

    scaled = position * 4.0 + builder.constant((0.5, 0.0, 0.0))

A node whose inputs are all constant is evaluated at once, and multiplying by 1 or adding 0 makes no node, so that a
document's unused parameters cost nothing.
"""

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import SceneError
from .infer import width_of
from .interpret import convert
from .library import Overload, library
from .model import LARGEST, Constant, GraphTexture, Link, Node
from .numpy_nodes import NODES, Dual

COMPARISONS = {"IfGreater": operator.gt, "IfGreaterEqual": operator.ge, "IfEqual": operator.eq}
NORMAL_MAP_MISUSED = "computes with a normal map; expected it to be connected to the surface's normal only"


@dataclass(frozen=True)
class Signal:
    """What an input reads: `width` channels of an output, or a constant. tangent: a normal in tangent space, with which only
    the surface can do anything."""

    builder: "Builder" = field(repr=False)
    source: Link | Constant
    width: int
    tangent: bool = False

    @property
    def constant(self) -> Constant | None:
        """The value, where it is the same everywhere."""
        return None if isinstance(self.source, Link) else self.source

    def __add__(self, other: "Signal | float") -> "Signal":
        return self.builder.call("Add", A=self, B=other)

    def __mul__(self, other: "Signal | float") -> "Signal":
        return self.builder.call("Mul", A=self, B=other)

    def __rsub__(self, other: float) -> "Signal":
        return self.builder.call("Sub", A=other, B=self)


class Builder:
    """The nodes and textures made so far. file: as messages call it. place: of the document's node that is being built, for
    messages and for Node.place. notes: what was approximated or left out, where in the file."""

    def __init__(self, file: str) -> None:
        self.file = self.place = file
        self.notes: list[str] = []
        self.nodes: list[Node] = []
        self._channels: list[Mapping[str, int]] = []  # of each node, by output
        self._affine: dict[Link, tuple[Signal, tuple[float, ...], tuple[float, ...]]] = {}  # what `affine` found
        self.textures: list[GraphTexture] = []

    def fail(self, what: str) -> None:
        """Raise the error that says what is wrong at the present place."""
        raise SceneError(f"{self.place}: {what}")

    def note(self, what: str) -> None:
        """Tell the user what is approximated at the present place; once."""
        place = self.place.removeprefix(self.file).removeprefix(":")
        if (sentence := f"line {place}: {what}") not in self.notes:
            self.notes.append(sentence)

    def constant(self, value: Constant) -> Signal:
        """A signal that is the same everywhere. Too large values become the largest, what is no number 0."""
        finite = tuple(0.0 if math.isnan(x) else min(max(float(x), -LARGEST), LARGEST) for x in value)
        return Signal(self, finite, len(finite))

    def call(self, kind: str, integers: Mapping[str, int] | None = None, **inputs: "Signal | float") -> Signal:
        """The only output of a node; a float stands for a constant."""
        (output,) = self.outputs(kind, integers, **inputs).values()
        return output

    def outputs(
        self, kind: str, integers: Mapping[str, int] | None = None, **inputs: "Signal | float"
    ) -> dict[str, Signal]:
        """All outputs of a node, by socket."""
        signals = {k: v if isinstance(v, Signal) else self.constant((v,)) for k, v in inputs.items()}
        if any(signal.tangent for signal in signals.values()):
            self.fail(NORMAL_MAP_MISUSED)
        overload = self._overload(kind, signals)
        widths = {socket: width_of(name) for socket, name in overload.outputs.items()}
        if (same := _identity(kind, signals, widths)) is not None:
            return {"Out": same}
        constant = all(signal.constant is not None for signal in signals.values())
        if constant and signals and "Texture" not in overload.integers:
            return self._evaluated(overload, signals, integers or {})
        node = self._add(kind, signals, dict(integers or {}), widths)
        return {socket: Signal(self, Link(node, socket), width) for socket, width in widths.items()}

    def texture(self, file: str, srgb: bool, wrap: tuple[str, str]) -> int:
        """The index of a texture among the graph's."""
        for index, texture in enumerate(self.textures):
            if (texture.file, texture.srgb, texture.wrap) == (file, srgb, wrap):
                return index
        self.textures.append(GraphTexture(file, srgb, wrap, self.place))
        return len(self.textures) - 1

    def affine(self, signal: Signal) -> tuple[Signal, tuple[float, ...], tuple[float, ...]]:
        """base, scale and offset such that signal = base * scale + offset: what the nodes before it do by constants alone."""
        steps = []
        while signal.source not in self._affine and (step := self._affine_step(signal)) is not None:
            steps.append((signal, *step[1:]))
            signal = step[0]
        width = signal.width
        found = self._affine.get(signal.source, (signal, (1.0,) * width, (0.0,) * width))
        for after, by, plus in reversed(steps):
            base, scale, offset = found
            scale = tuple(s * b for s, b in zip(scale, _wide(by, width), strict=True))
            offset = tuple(o * b + p for o, b, p in zip(offset, _wide(by, width), _wide(plus, width), strict=True))
            finite = np.isfinite(scale + offset).all()
            found = (base, scale, offset) if finite else (after, (1.0,) * width, (0.0,) * width)
            self._affine[after.source] = found
        return found

    def _add(
        self, kind: str, signals: Mapping[str, Signal], integers: dict[str, int], widths: Mapping[str, int]
    ) -> int:
        inputs = {socket: signal.source for socket, signal in signals.items()}
        self.nodes.append(Node(kind, inputs, integers, self.place))
        self._channels.append(widths)
        return len(self.nodes) - 1

    def _evaluated(
        self, overload: Overload, signals: Mapping[str, Signal], integers: Mapping[str, int]
    ) -> dict[str, Signal]:
        """A node's outputs where all its inputs are constant."""
        inputs = {
            socket: convert(Dual(np.array([signals[socket].constant])), type_name, 1)
            for socket, type_name in overload.inputs.items()
        }
        with np.errstate(all="ignore"):
            result = NODES[overload.kind](**inputs, **integers)
        results = result if isinstance(result, dict) else {"Out": result}
        values = {s: convert(results[s], type_name, 1).v[0] for s, type_name in overload.outputs.items()}
        return {socket: self.constant(tuple(value.tolist())) for socket, value in values.items()}

    def _overload(self, kind: str, signals: Mapping[str, Signal]) -> Overload:
        """The implementation that takes the inputs as they are or, where none does, with single numbers repeated."""
        fitting = []
        for overload in library()[kind]:
            pairs = [(signals[socket].width, width_of(name)) for socket, name in overload.inputs.items()]
            if all(have in (1, want) for have, want in pairs):
                fitting.append((sum(have != want for have, want in pairs), overload))
        if not fitting:
            found = ", ".join(f"{socket} of {signal.width}" for socket, signal in signals.items())
            self.fail(f"{kind} takes no inputs with these channels: {found}")
        return min(fitting, key=lambda cost_and_overload: cost_and_overload[0])[1]

    def _affine_step(self, signal: Signal) -> tuple[Signal, Constant, Constant] | None:
        if signal.constant is not None:
            return None
        node = self.nodes[signal.source.node]
        a, b = node.inputs.get("A"), node.inputs.get("B")
        links = [s for s in (a, b) if isinstance(s, Link)]
        if node.kind not in ("Add", "Sub", "Mul", "Div") or len(links) != 1:
            return None
        base = Signal(self, links[0], self._channels[links[0].node][links[0].socket])
        by = b if links[0] is a else a
        if base.width != signal.width:
            return None
        if node.kind == "Add":
            return base, (1.0,), by
        if node.kind == "Mul":
            return base, by, (0.0,)
        if node.kind == "Sub":
            return (base, (1.0,), tuple(-x for x in by)) if links[0] is a else (base, (-1.0,), by)
        if links[0] is a and all(by):
            return base, tuple(1.0 / x for x in by), (0.0,)
        return None


def _wide(value: Constant, width: int) -> Constant:
    return value * width if len(value) == 1 else value


def _all(signal: Signal, value: float) -> bool:
    return signal.constant is not None and all(x == value for x in signal.constant)


def _identity(kind: str, signals: Mapping[str, Signal], widths: Mapping[str, int]) -> Signal | None:
    """The input that a node only passes on, if its channels are the output's; or 0, as a product with it."""
    a, b = signals.get("A"), signals.get("B")
    same = None
    if kind == "Add":
        same = a if _all(b, 0.0) else b if _all(a, 0.0) else None
    elif kind == "Sub":
        same = a if _all(b, 0.0) else None
    elif kind == "Mul":
        same = a if _all(b, 1.0) else b if _all(a, 1.0) else a if _all(a, 0.0) else b if _all(b, 0.0) else None
    elif kind == "Div":
        same = a if _all(b, 1.0) else None
    elif kind == "Mix":
        fg, bg, part = signals["Fg"], signals["Bg"], signals["Mix"]
        same = bg if _all(part, 0.0) or fg.source == bg.source else fg if _all(part, 1.0) else None
    elif kind in COMPARISONS:
        x, y = signals["Value1"].constant, signals["Value2"].constant
        if x is not None and y is not None:
            same = signals["In1"] if COMPARISONS[kind](x, y) else signals["In2"]
    elif kind == "Rotate2D" and _all(signals["Angle"], 0.0):
        same = signals["In"]
    if same is None:
        return None
    if same.constant is not None:
        return same.builder.constant(_wide(same.constant, widths["Out"]))
    return same if same.width == widths["Out"] else None
