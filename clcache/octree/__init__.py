"""The octree whose cells keep light (HashCache, section 3.1): a scene's occupied cells, and tables that find them."""

from .build import Octree

__all__ = ["Octree"]
