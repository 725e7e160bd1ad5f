"""Renders by the method with an octree, and what its cells know then."""

from dataclasses import dataclass

import numpy as np

from clcache import Renderer
from clcache.scene.model import Scene

_SHORT = ("resolution", "store", "length", "paths", "caching_resolution", "frame_time", "samples", "level_bias", "jitter", "gate",
          "filter", "layered")  # fmt: skip


def octree(scene: Scene, size: tuple[int, int] = (32, 24), **options) -> Renderer:
    """A renderer with an octree of few cells and without a filter. options: of `Renderer`; settings of octree by their last names;
    `bounces`, `sampler`, `roulette`."""
    settings = {"octree.resolution": 64, "octree.filter": "none"}
    settings |= {f"octree.{name}": options.pop(name) for name in _SHORT if name in options}
    paths = ("bounces", "sampler", "roulette")
    settings |= {f"pathtrace.{name}": options.pop(name) for name in paths if name in options}
    settings |= options.pop("settings", {})
    return Renderer(scene, "octree", size, settings=settings, **{"stereo": False, **options})


@dataclass(frozen=True)
class Cells:
    """What cells know, those of all levels by their global index. front, back: (n, 3) float64, means. counts: (n, 2), of either side. normal:
    (n,) uint32, packed. stamp: (n,) uint32."""

    front: np.ndarray
    back: np.ndarray
    counts: np.ndarray
    normal: np.ndarray
    stamp: np.ndarray

    def energy(self, first: int, last: int) -> np.ndarray:
        """(3,): the sum of all light of the cells first .. last - 1: means times counts."""
        part = slice(first, last)
        return self.counts[part, 0] @ self.front[part] + self.counts[part, 1] @ self.back[part]


def cells(renderer: Renderer) -> Cells:
    """The cells as the last frame left them."""
    words = renderer._graph.of()["octree_cells"].get()
    halves = words[:, :3].copy().view(np.float16).astype(np.float64)
    counts = np.column_stack([words[:, 4] & 0xFFFF, words[:, 4] >> 16]).astype(np.int64)
    return Cells(halves[:, :3], halves[:, 3:], counts, words[:, 3], words[:, 5])


def levels(renderer: Renderer) -> list[tuple[int, int]]:
    """The first cell of each level and the one behind the last."""
    first = renderer._parts.octree.first_cell
    return list(zip(first[:-1].tolist(), first[1:].tolist(), strict=True))
