"""Bounding volume hierarchies: built and traversed in kernels (`cl/bvh/`)."""

from .build import SceneTrees
from .tracer import HIT_DTYPE, MISS, Tracer

__all__ = ["HIT_DTYPE", "MISS", "SceneTrees", "Tracer"]
