"""OctreeCache: the light of diffuse surfaces in a linkless octree of cells (Roth, Weier, Bauszat, Hinkenjann, Li 2020, "Hash-Based
Hierarchical Caching and Layered Filtering for Interactive Previews in Global Illumination Rendering", where it is HashCache).

An update fills cells and then reads them. Paths from the camera give each of their first vertices the light of those that follow; what
the cells got is added to their means, level by level. Then the image: each pixel's path goes on by mirrors, glass and gloss, and at each of
its vertices the cell that is about as wide as the pixel answers for diffuse light. Layers of vertices are filtered from the last to the
first. Images with the same camera and light are averaged.

Cells are of what never moves. All light is forgotten when anything moves; what moves is traced.
"""

from collections.abc import Mapping
from math import inf

from ..errors import SettingError
from ..octree import Octree
from ..passes.film import Clear, Mean, MeanDirection, NearestDepth, NearestHit, film_buffers
from ..passes.materials import GraphSetup, graph_buffers, memo_names
from ..passes.octree import (
    BeginUpdate,
    Estimate,
    OctreeSetup,
    Pace,
    caching_passes,
    layer_passes,
    miss_passes,
    octree_buffers,
    stage,
)
from ..passes.octree_filter import filter_buffers, filter_passes
from ..passes.octree_update import CELLS, COUNTERS, update_buffers, update_passes
from ..passes.shade import FirstHits, path_buffers
from ..passes.trace import Generate, OrderPixels, TraceCamera, path_count, ray_buffers
from .method import Method, MethodSetup
from .pathtrace import begin_memo, materials

_FILM = ("albedo_sum", "aov_albedo", "N_sum", "aov_N", "aov_Z", "nearest", "surface")


def octree(setup: MethodSetup) -> Method:
    """The passes of OctreeCache."""
    device, scene, size, settings = setup.device, setup.scene, setup.size, setup.settings
    if not device.capabilities.int64_atomics:
        raise SettingError(f"method: {device.name} lacks 64-bit atomics, which the octree's tables need")
    _check_size(settings, size)
    cells = Octree(device, scene.geometry, scene.is_static, settings["octree.resolution"], scene.eyes)
    graphs = GraphSetup.of(device, scene, settings, setup.memo)
    own, pace = OctreeSetup(device, scene, size, settings, cells, graphs), Pace(settings)
    caching = [*caching_passes(own, pace), *update_passes(device, cells)]
    image = [
        Generate(device, scene, own.sobol),
        TraceCamera(scene),
        NearestDepth(device),
        NearestHit(device, scene),
        *materials(graphs, is_primary=True),
        FirstHits(device, scene, own.sobol),
        *layer_passes(own),
        miss_passes(own),
        *filter_passes(device, size, own.layers, settings, own.gathers_hits),
        Estimate(own),
        Mean(device, "albedo_sum", "aov_albedo"),
        MeanDirection(device, "N_sum", "aov_N"),
    ]
    passes = (
        OrderPixels(device, scene, size, own.sobol),
        *begin_memo(graphs),
        BeginUpdate(own),
        *(Clear(b) for b in ("ray_counts", "albedo_sum", "N_sum")),
        Clear("aov_Z", inf),
        Clear("nearest", inf),
        *(stage("caching", caching) if settings["octree.caching_resolution"] > 0 else []),
        *stage("reconstruction", image),
    )
    n, stored = own.paths, settings["octree.store"] * own.paths
    buffers = (
        *ray_buffers(n),
        *path_buffers(n),
        *(b for b in film_buffers(n, own.pixels) if b.name in _FILM),
        *octree_buffers(own),
        *update_buffers(stored, cells.cells),
        *filter_buffers(own.layers, size, settings),
        *graph_buffers(graphs, n),
    )
    kept = (*CELLS, *memo_names(graphs))
    return Method(
        passes,
        buffers,
        cache=kept,
        world=kept,
        counters=COUNTERS,
        levels=("occupied", "capacity"),
        memo=graphs.memo,
        octree=cells,
        pace=pace,
    )


def _check_size(settings: Mapping[str, bool | int | float | str], size: tuple[int, int]) -> None:
    """Raise SettingError where planes of vertices, or of layers' places, have more numbers than kernels can count."""
    each = max(settings["octree.store"], settings["pathtrace.bounces"] + 1)
    if 3 * each * path_count(size) >= 2**32:
        raise SettingError(
            f"{size[0]}x{size[1]} pixels of {each} vertices: expected a smaller size, or less of octree.store and pathtrace.bounces"
        )
