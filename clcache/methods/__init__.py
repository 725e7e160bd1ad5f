"""The methods: each is nothing but its list of passes."""

from .method import Method, MethodSetup, PathState
from .pathtrace import pathtrace
from .samplecache import isrt, samplecache

METHODS = {"pathtrace": pathtrace, "samplecache": samplecache, "isrt": isrt}

__all__ = ["METHODS", "Method", "MethodSetup", "PathState"]
