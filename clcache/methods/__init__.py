"""The methods: each is nothing but its list of passes."""

from .method import Method, MethodSetup, PathState
from .pathtrace import pathtrace
from .samplecache import isrt, samplecache
from .voxelhash import hybrid, voxelhash

METHODS = {
    "pathtrace": pathtrace,
    "samplecache": samplecache,
    "isrt": isrt,
    "voxelhash": voxelhash,
    "hybrid": hybrid,
}

__all__ = ["METHODS", "Method", "MethodSetup", "PathState"]
