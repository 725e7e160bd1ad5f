"""SampleCache: first hits that are kept from frame to frame, with the light that was found there (Philippi, Jensen, Frisvad 2025,
"Stable Sample Caching for Interactive Stereoscopic Ray Tracing", sections 3 and 4), and interactive stable ray tracing (Dal
Corso et al. 2017) in the same terms: there a sample's slot is its place in a grid of M x M within the pixel.

A frame moves the samples of the last one to where they appear now, looks for edges and for pixels with too few samples or
too many, traces some of the samples to see whether they are visible, shades some, and averages those that are visible.
"""

from collections.abc import Mapping
from dataclasses import replace

from ..errors import SettingError
from ..frame import Buffer, Pass, Repeat
from ..passes.blend import Blend, blend_buffers, moment_buffers
from ..passes.film import Clear
from ..passes.materials import FIRST_VALUES, SEEN_VALUES, GraphSetup, graph_buffers, memo_names
from ..passes.radiance import IMPORTANCE, Accumulate, BeginPaths, Choose, CountImportance, radiance_buffers
from ..passes.reconstruct import (
    Average,
    AverageCache,
    ClearSurface,
    Describe,
    Distance,
    FillAovs,
    FindMoments,
    KeepNearest,
    ListedMaterials,
    ListVisible,
    Resolve,
    reconstruct_buffers,
    seen,
)
from ..passes.reproject import (
    COUNTERS,
    GROUP,
    cache_buffers,
    cache_defines,
    exchanged_buffers,
    list_capacity,
    reproject_buffers,
    reproject_passes,
)
from ..passes.retrace import Aim, Assess, ListTraced, Retrace, Settle, batches, retrace_buffers
from ..passes.shade import path_buffers
from ..passes.trace import OrderPixels, path_count, ray_buffers
from .method import Method, MethodSetup, PathState
from .pathtrace import begin_memo, materials, vertices

MAX_SAMPLES = 2**29  # of which vectors of signed numbers address the words
MAX_MATERIALS = 2**16  # what the first hits have bits for


def samplecache(setup: MethodSetup) -> Method:
    """The passes of SampleCache."""
    return _method(setup, setup.settings["samplecache.slots"], None)


def isrt(setup: MethodSetup) -> Method:
    """The same with the layout and the reprojection of interactive stable ray tracing."""
    side = setup.settings["isrt.superresolution"]
    return _method(setup, side * side, side)


def _method(setup: MethodSetup, slots: int, superresolution: int | None) -> Method:
    device, scene, size, settings = setup.device, setup.scene, setup.size, setup.settings
    pixels, paths = size[0] * size[1], path_count(size)
    rays, groups = max(paths, GROUP * slots), -(-paths // GROUP)
    check_size(setup, pixels, slots)
    variant, shading = settings["samplecache.reprojection"], settings["samplecache.shading"]
    is_blended, is_adaptive = setup.stereo_blend == "samples", shading == "adaptive"
    cache = cache_defines(slots, True, superresolution)
    image = cache | {
        "DEMODULATE": settings["samplecache.demodulate"],
        "HAS_MOMENTS": is_blended,
        "FILL": is_adaptive or settings["samplecache.shading_rate"] < 1,
    }
    graphs = GraphSetup.of(device, scene, settings, setup.memo)
    passes = (
        OrderPixels(device, scene, size, False),
        *begin_memo(graphs),
        Clear("ray_counts"),
        *reproject_passes(device, scene, size, slots, variant, True, superresolution),
        *trace_samples(setup, cache),
        *([CountImportance(device, cache)] if is_adaptive else []),
        Choose(device, cache, shading, settings["samplecache.shading_rate"]),
        *_shading(setup, graphs),
        *_reconstruct(setup, graphs, image),
    )
    capacity = list_capacity(pixels, slots)
    buffers = (
        *rays_for(rays, paths),
        *path_buffers(rays),
        *cache_buffers(pixels, slots),
        *reproject_buffers(pixels, slots, variant, superresolution),
        *retrace_buffers(pixels, groups),
        *radiance_buffers(pixels, paths, capacity if is_adaptive else pixels, rays, is_adaptive),
        *reconstruct_buffers(pixels, groups, capacity, rays),
        *moment_buffers(pixels),
        *graph_buffers(graphs, rays, has_lists=True),
    )
    return Method(
        passes,
        buffers,
        exchanged=(*exchanged_buffers(), *([IMPORTANCE] if is_adaptive else [])),
        cache=(*(b.name for b in cache_buffers(pixels, slots)), *memo_names(graphs)),
        world=memo_names(graphs),
        counters=COUNTERS,
        levels=("occupied", "visible"),
        primary=("created", "retraced"),
        blend=(Blend(device, settings["samplecache.sharpness"]),) if is_blended else (),
        blend_buffers=tuple(blend_buffers(pixels)),
        memo=graphs.memo,
    )


def trace_samples(setup: MethodSetup, defines: Mapping) -> list[Pass]:
    """Which samples of a cache are visible, and new ones. defines: of the cache."""
    device, scene, settings = setup.device, setup.scene, setup.settings
    target, tolerance = settings["samplecache.target"], settings["samplecache.tolerance"]
    least, most = min(target - tolerance, defines["SLOTS"]), target + tolerance
    tracing, sampler = settings["samplecache.tracing"], {"SOBOL": settings["pathtrace.sampler"] == "sobol"}
    batch = [Aim(device, scene, defines | sampler), Retrace(scene), Settle(device, scene, defines | sampler, tracing)]
    return [
        Assess(device, defines, tracing, (least, most)),
        ListTraced(device, defines, tracing),
        Repeat(
            "visibility", batch, count=lambda _, arrays: batches(arrays, 0), advance=at_batch, count_reads=("listed",)
        ),
    ]


def _shading(setup: MethodSetup, graphs: GraphSetup) -> list[Pass]:
    device, scene, settings = setup.device, setup.scene, setup.settings
    demodulate = settings["samplecache.demodulate"]
    batch = [
        BeginPaths(device, scene, demodulate),
        *materials(graphs, True, FIRST_VALUES),
        *vertices(setup, graphs, "path_stream", values=FIRST_VALUES),
        Accumulate(device, scene, demodulate, settings["samplecache.alpha"]),
    ]
    return [
        Repeat("shading", batch, count=lambda _, arrays: batches(arrays, 1), advance=at_batch, count_reads=("listed",))
    ]


def _reconstruct(setup: MethodSetup, graphs: GraphSetup, defines: Mapping) -> list[Pass]:
    common = setup.device, setup.scene, defines
    mean = [] if defines["DEMODULATE"] else [AverageCache(*common)]
    average = (Average,) if defines["DEMODULATE"] else ()
    passes = (Resolve, *average, FindMoments, Distance, KeepNearest, Describe, FillAovs)
    batch = [*seen_materials(graphs), *(p(*common) for p in passes)]
    count = {"count": lambda _, arrays: batches(seen(arrays), 0), "count_reads": ("seen_listed",)}
    listed = ListVisible(*common), ClearSurface(*common)
    return [*mean, *listed, Repeat("reconstruction", batch, advance=at_batch, **count)]


def seen_materials(graphs: GraphSetup) -> list[Pass]:
    """What the graphs of the visible samples of a batch say."""
    return [ListedMaterials(graphs, "seen", ("seen_listed", 0), True, SEEN_VALUES)] if graphs.scene.graphs else []


def at_batch(state: PathState, index: int) -> PathState:
    """The state for one of the batches that a list is worked off in."""
    return replace(state, batch=index)


def rays_for(rays: int, paths: int) -> list[Buffer]:
    """The path tracer's, for so many rays; `pixel` has the paths of the image alone."""
    return [replace(b, shape=(paths,)) if b.name == "pixel" else b for b in ray_buffers(rays)]


def check_size(setup: MethodSetup, pixels: int, slots: int) -> None:
    """Raise SettingError where there are more samples or materials than there are bits for, or the device cannot."""
    if pixels * slots > MAX_SAMPLES:
        raise SettingError(
            f"{pixels} pixels of {slots} slots: expected a size and slots of at most {MAX_SAMPLES} samples"
        )
    materials = setup.scene.arrays["materials"].size
    if materials > MAX_MATERIALS:
        raise SettingError(
            f"{setup.scene.file}: {materials} materials; expected at most {MAX_MATERIALS} for a sample cache, which cannot tell more apart"
        )
    variant = setup.settings["samplecache.reprojection"]
    if variant != "deterministic" and not setup.device.capabilities.int64_atomics:
        raise SettingError(
            f"setting samplecache.reprojection: {variant} needs 64-bit atomics, which {setup.device.name} lacks; "
            "expected deterministic"
        )
