"""Material graphs: documents read, typed, and turned into one OpenCL C function each (thesis, section 5.1)."""

from .compiled import CompiledGraph, compile_graph, load, read
from .emit import emit
from .model import INPUTS, OUTPUTS, Constant, Graph, GraphTexture, Link, Node

__all__ = [
    "INPUTS",
    "OUTPUTS",
    "CompiledGraph",
    "Constant",
    "Graph",
    "GraphTexture",
    "Link",
    "Node",
    "compile_graph",
    "emit",
    "load",
    "read",
]
