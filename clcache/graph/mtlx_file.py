"""Reading a MaterialX file: what may be read at all, and where in the file each element stands.

The MaterialX package parses, upgrades and validates documents, but it is C++ without limits and its elements do not know
their lines. Expat therefore reads every file first: it refuses entities, inclusions of other files and documents beyond
the limits below, checks that names and numbers are what the package takes for granted, and notes the line of every
element for messages.
"""

import math
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.parsers import expat

import MaterialX

from ..errors import SceneError
from ..scene.files import read_bytes
from .model import MAX_BYTES, printable

MAX_ELEMENTS = 8192
MAX_DEPTH = 16
MAX_ATTRIBUTE = 4096
MAX_INHERITANCES = 100
# The package follows all connections for each output, to find cycles: outputs times connections.
MAX_TRAVERSAL = 1_000_000
_CONNECTIONS = ("nodename", "nodegraph", "output", "interfacename")

# What an element's own name may be; it is also how others refer to it.
_NAME = re.compile(r"[A-Za-z_:][\w:.\-]*\Z", re.ASCII)
# How many numbers a value of each type has.
WIDTHS = {"float": 1, "integer": 1, "boolean": 1, "vector2": 2, "color3": 3, "vector3": 3, "color4": 4, "vector4": 4}
MATRICES = {"matrix33": 9, "matrix44": 16}


@dataclass(frozen=True)
class Places:
    """Where elements stand. file: how messages name the file. lines: of each element, by its path of names."""

    file: str
    lines: dict[str, int]

    def line(self, path: str) -> int:
        """The line of the element with that path of names, or of the nearest one around it: upgrading a document of an
        older version gives it elements that its file does not have."""
        while path and path not in self.lines:
            path = path.rpartition("/")[0]
        return self.lines.get(path, 1)

    def of(self, element: MaterialX.Element) -> str:
        """An element's place, for messages: "wood.mtlx:12: image image_color"."""
        kind, name = printable(element.getCategory()), printable(element.getName())
        return f"{self.file}:{self.line(element.getNamePath())}: {kind} {name}"


def read_document(path: Path, name: str) -> tuple[MaterialX.Document, Places]:
    """The MaterialX document in a file, upgraded to the package's version and valid, on top of the standard library.

    name: of the file, for messages. Raises SceneError for what cannot be read, is beyond the limits, or is no valid
    document."""
    text = read_bytes(path, name, MAX_BYTES)
    places = Places(name, _Prescan(name).run(text))
    document = MaterialX.createDocument()
    document.setDataLibrary(standard_library())
    options = MaterialX.XmlReadOptions()
    options.readXIncludeFunction = None
    try:
        MaterialX.readFromXmlString(document, text.decode("utf-8-sig"), MaterialX.FileSearchPath(), options)
        valid = document.validate()[0]
    except UnicodeDecodeError as error:
        raise SceneError(f"{name}: byte {error.start} is not UTF-8 text") from None
    except Exception as error:  # the package's own are LookupError, RuntimeError and more; all say that it is not valid
        raise SceneError(f"{name}: {printable(str(error), 200)}; expected a valid MaterialX document") from None
    if not valid:
        raise SceneError(f"{name}{_first_fault(document, places)}; expected a valid MaterialX document")
    return document, places


@cache
def standard_library() -> MaterialX.Document:
    """MaterialX's own definitions of nodes and of their implementations."""
    library = MaterialX.createDocument()
    MaterialX.loadLibraries(MaterialX.getDefaultDataLibraryFolders(), MaterialX.getDefaultDataSearchPath(), library)
    return library


def _first_fault(document: MaterialX.Document, places: Places) -> str:
    """What a validation report says of the first innermost element that is not valid, with the element's line. The report
    of a whole document names elements by name alone, and those of a name may be many."""
    fault, below = document, document
    while below is not None:
        fault, below = below, next((child for child in below.getChildren() if not child.validate()[0]), None)
    what = fault.validate()[1].strip().splitlines()[0].partition(": <")[0]
    if fault is document:
        return f": {printable(what, 200)}"
    at = f"{printable(fault.getCategory())} {printable(fault.getName())}"
    return f":{places.line(fault.getNamePath())}: {printable(what, 200)}, at {at}"


class _Prescan:
    """One pass over a file by expat, which calls the methods below as it goes."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.lines: dict[str, int] = {}
        self.open: list[str] = []
        self.count = self.connections = self.outputs = self.inheritances = 0
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = lambda _: self.open.pop()
        self.parser.StartDoctypeDeclHandler = lambda *_: self.fail("a document type declaration; expected none")
        self.parser.ProcessingInstructionHandler = lambda *_: self.fail("a processing instruction; expected none")

    def run(self, text: bytes) -> dict[str, int]:
        try:
            self.parser.Parse(text, True)
        except expat.ExpatError as error:
            what = expat.ErrorString(error.code)
            raise SceneError(f"{self.name}:{error.lineno}: {what}; expected a MaterialX document") from None
        if self.outputs * self.connections > MAX_TRAVERSAL:
            self.fail(f"{self.outputs} outputs and {self.connections} connections; expected fewer")
        return self.lines

    def fail(self, what: str) -> None:
        raise SceneError(f"{self.name}:{self.parser.CurrentLineNumber}: {what}")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.count += 1
        if not self.open and tag != "materialx":
            self.fail(f"{printable(tag)}; expected materialx, the root of a MaterialX document")
        if tag.rpartition(":")[2] == "include":
            self.fail("an inclusion of another file; expected a document that is complete in itself")
        if self.count > MAX_ELEMENTS:
            self.fail(f"more than {MAX_ELEMENTS} elements; expected fewer")
        if len(self.open) >= MAX_DEPTH:
            self.fail(f"{MAX_DEPTH + 1} elements inside each other; expected at most {MAX_DEPTH}")
        name = attributes.get("name", "")
        where = f"{printable(tag)} {printable(name)}"
        for key, value in attributes.items():
            if len(value) > MAX_ATTRIBUTE:
                self.fail(f"{where}: {printable(key)} of {len(value)} characters; expected at most {MAX_ATTRIBUTE}")
        if self.open and not _NAME.match(name) and (name or "name" in attributes):
            self.fail(f"{where}: expected a name of letters, digits and _")
        connected = any(key in attributes for key in _CONNECTIONS)
        self.connections += connected
        self.outputs += connected and tag == "output"
        self.inheritances += "inherit" in attributes
        if self.inheritances > MAX_INHERITANCES:
            self.fail(f"{where}: more than {MAX_INHERITANCES} elements inherit others; expected fewer")
        if "includecollection" in attributes:
            self.fail(f"{where}: a collection of collections; expected none")
        if attributes.get("value", "").strip():
            self.check_value(where, attributes.get("type", ""), attributes["value"])
        path = f"{self.open[-1]}/{name}".lstrip("/") if self.open else ""
        if name and path in self.lines:
            self.fail(f"{where}: the same name as on line {self.lines[path]}; expected another")
        self.lines[path] = self.parser.CurrentLineNumber
        self.open.append(path)

    def check_value(self, where: str, kind: str, value: str) -> None:
        """Refuse numbers that are missing, too many, not finite in single precision, or no numbers."""
        if kind == "boolean":
            if value.strip() not in ("true", "false"):
                self.fail(f"{where}: value {printable(value)!r}; expected true or false")
            return
        count = (WIDTHS | MATRICES).get(kind)
        if count is None:
            return
        numbers = numbers_of(value)
        if numbers is None or len(numbers) != count:
            self.fail(f"{where}: value {printable(value)!r}; expected {count} finite numbers for a {kind}")
        if kind == "integer" and not (numbers[0].is_integer() and abs(numbers[0]) < 2**31):
            self.fail(f"{where}: value {printable(value)!r}; expected a whole number of 32 bits")


def numbers_of(text: str) -> tuple[float, ...] | None:
    """The numbers of a value of a document; None if one of them is no number that is finite in single precision."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        return None
    return numbers if all(math.isfinite(x) and abs(x) < 3.4e38 for x in numbers) else None
