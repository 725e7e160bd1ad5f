"""The node implementations of `cl/graph/nodes/`, read from their own declarations.

A node is an OpenCL function; its parameters are its sockets, and functions of one name are its overloads:

    // needs noise.cl
    // for T in float float3
    NODE void Mix(T A, T B, float Part, T *Out) { ... }
    NODE void Mix(T_D A, T_D B, float_D Part, T_D *Out) { ... }

A parameter by value is an input socket, a pointer an output socket, an `int` an integer that the document gives; `in` and
`maps` are passed on. A type that ends in `_D` carries the value's change along the two axes of the footprint. The
comment `for` makes each function of the group below it, up to the next blank line, a template, once for every type;
`needs` names files of `cl/graph/` with what the nodes of the file call.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "cl" / "graph" / "nodes"

# Of values; `_D`: with derivatives.
TYPES = ("float", "float2", "float3", "float4", "float_D", "float2_D", "float3_D", "float4_D")
PASSED_ON = {"in": "const GraphInputs *", "maps": "const Maps *"}

_TEMPLATE = re.compile(r"//\s*for T in((?:\s+\w+)+)\s*$")
_NEEDS = re.compile(r"//\s*needs((?:\s+\w+\.cl)+)\s*$")
_HEAD = re.compile(r"NODE void (\w+)\(([^)]*)\)\s*\{")
_PARAMETER = re.compile(r"\s*((?:const\s+)?\w+)\s*(\*?)\s*(\w+)\s*$")


@dataclass(frozen=True, eq=False)
class Overload:
    """One implementation of a node; of several that fit as well, the first is taken. parameters: names in the order of the
    call. inputs, outputs: type of each socket, one of TYPES. integers: names. source: the function, complete. needs: files of
    `cl/graph/` that it calls."""

    kind: str
    parameters: tuple[str, ...]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    integers: tuple[str, ...]
    source: str = field(repr=False)
    needs: tuple[str, ...] = ()


Library = Mapping[str, tuple[Overload, ...]]


@cache
def library() -> Library:
    """All nodes: the overloads of each kind. Read once."""
    return merge(parse(file.read_text(encoding="utf-8"), file.name) for file in sorted(FOLDER.glob("*.cl")))


def merge(parts: Iterable[Library]) -> Library:
    """One library of several files'. Raises ValueError if two files declare the same kind."""
    merged: dict[str, tuple[Overload, ...]] = {}
    for part in parts:
        for kind, overloads in part.items():
            if kind in merged:
                raise ValueError(f"node {kind} is declared in two files")
            merged[kind] = overloads
    return merged


def parse(text: str, name: str) -> Library:
    """The nodes that one file declares, by kind. Raises ValueError where it breaks the form."""
    found: dict[str, list[Overload]] = {}
    needs = tuple(file for line in text.splitlines() if (needed := _NEEDS.match(line)) for file in needed[1].split())
    types: tuple[str, ...] = ("",)
    end = 0
    for start, line in _lines(text):
        if start < end:
            continue  # within the function just read
        if template := _TEMPLATE.match(line):
            types = tuple(template[1].split())
        elif not line:
            types = ("",)
        elif head := _HEAD.match(text, start):
            end = _end_of_body(text, head.end(), f"{name}: node {head[1]}")
            for type_name in types:
                overload = _overload(text[start:end], type_name, needs, f"{name}: node {head[1]}")
                found.setdefault(overload.kind, []).append(overload)
        elif not line.startswith("//"):
            raise ValueError(f"{name}: expected a NODE function, found {line!r}")
    for kind, overloads in found.items():
        _check_alike(overloads, f"{name}: node {kind}")
    return {kind: tuple(overloads) for kind, overloads in found.items()}


def _lines(text: str) -> Iterator[tuple[int, str]]:
    start = 0
    for line in text.splitlines(keepends=True):
        yield start, line.rstrip()
        start += len(line)


def _end_of_body(text: str, start: int, place: str) -> int:
    depth = 1
    for brace in re.compile(r"//[^\n]*|[{}]").finditer(text, start):
        depth += {"{": 1, "}": -1}.get(brace[0], 0)
        if depth == 0:
            return brace.end()
    raise ValueError(f"{place}: its body does not end")


def _overload(source: str, type_name: str, needs: tuple[str, ...], place: str) -> Overload:
    if type_name:
        source = re.sub(r"\bT(_D)?\b", lambda t: type_name + (t[1] or ""), source)
    head = _HEAD.match(source)
    inputs, outputs, parameters, integers = {}, {}, [], []
    for declaration in filter(str.strip, head[2].split(",")):
        parameter = _PARAMETER.match(declaration)
        if parameter is None:
            raise ValueError(f"{place}: parameter {declaration.strip()!r} is not of the form")
        kind, pointer, name = parameter[1], parameter[2], parameter[3]
        parameters.append(name)
        if PASSED_ON.get(name) == f"{kind} {pointer}":
            continue
        if kind == "int" and not pointer:
            integers.append(name)
        elif kind in TYPES:
            (outputs if pointer else inputs)[name] = kind
        else:
            raise ValueError(f"{place}: parameter {name} has the type {kind}{pointer}")
    return Overload(head[1], tuple(parameters), inputs, outputs, tuple(integers), source, needs)


def _check_alike(overloads: list[Overload], place: str) -> None:
    first = overloads[0]
    for other in overloads[1:]:
        if (list(first.inputs), list(first.outputs), first.integers) != (
            list(other.inputs), list(other.outputs), other.integers,
        ):  # fmt: skip
            raise ValueError(f"{place}: its overloads differ in their sockets or integers")
    signatures = {tuple(o.inputs.values()) + tuple(o.outputs.values()) for o in overloads}
    if len(signatures) < len(overloads):
        raise ValueError(f"{place}: two overloads have the same types")
