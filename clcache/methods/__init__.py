"""The methods: each is nothing but its list of passes."""

from .method import Method, MethodSetup, PathState
from .octree import octree
from .pathtrace import pathtrace
from .samplecache import isrt, samplecache
from .voxelhash import hybrid, voxelhash

METHODS = {
    "pathtrace": pathtrace,
    "samplecache": samplecache,
    "isrt": isrt,
    "voxelhash": voxelhash,
    "hybrid": hybrid,
    "octree": octree,
}

__all__ = ["METHODS", "Method", "MethodSetup", "PathState"]
