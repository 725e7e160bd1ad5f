"""The methods: each is nothing but its list of passes."""

from .method import Method, MethodSetup, PathState
from .pathtrace import pathtrace

METHODS = {"pathtrace": pathtrace}

__all__ = ["METHODS", "Method", "MethodSetup", "PathState"]
