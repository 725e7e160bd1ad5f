"""VoxelHash: radiance in voxels of the world, in a hash table (Philippi, Jensen, Frisvad 2025, "Stable Sample Caching for Interactive
Stereoscopic Ray Tracing", section 4, where it is HashCache), and Hybrid, which asks the voxels at the first hits of a SampleCache.

VoxelHash traces one first hit for each pixel anew in every frame. Each asks the voxel that it lies in, or one beside it; one
of those that ask the same voxel is shaded, and updates it. Then all read. Without the jitter of pixels, and that of voxels,
the image would be steady but blocky; with them it needs a temporal filter.

Hybrid keeps first hits from frame to frame, and so asks at points that stay where they are. One sample of each pixel asks its voxel
or that one's parent, one level above; a pixel's colour is the mean of what all its visible samples read from both.
"""

from dataclasses import replace

from ..errors import SettingError
from ..frame import Buffer, Pass, Repeat
from ..passes.film import Clear
from ..passes.materials import (
    ASKED_VALUES,
    DESCRIBED_VALUES,
    FIRST_VALUES,
    NEW_VALUES,
    GraphSetup,
    graph_buffers,
    memo_names,
)
from ..passes.radiance import BeginPaths
from ..passes.reconstruct import (
    Average,
    ClearSurface,
    Describe,
    Distance,
    FillAovs,
    KeepNearest,
    ListedMaterials,
    ListVisible,
    reconstruct_buffers,
    seen,
)
from ..passes.reproject import COUNTERS as SAMPLE_COUNTERS
from ..passes.reproject import (
    GROUP,
    cache_buffers,
    cache_defines,
    exchanged_buffers,
    list_capacity,
    reproject_buffers,
    reproject_passes,
)
from ..passes.retrace import batches, retrace_buffers
from ..passes.shade import path_buffers
from ..passes.trace import Generate, OrderPixels, TraceCamera, path_count, ray_buffers
from ..passes.voxelhash import (
    COUNTERS,
    TABLE,
    AddressAsked,
    AddressSeen,
    AnswerAsked,
    AnswerSeen,
    AskAll,
    AskSamples,
    DescribeVoxels,
    FindAge,
    FindSeen,
    Inherit,
    KeepFirstHits,
    KeepSurface,
    ListClaimed,
    LookUp,
    UpdateVoxels,
    Voxels,
    table_buffers,
    voxel_aov_buffers,
    voxel_buffers,
    voxel_counts,
)
from .method import Method, MethodSetup
from .pathtrace import begin_memo, materials, vertices
from .samplecache import at_batch, check_size, rays_for, seen_materials, trace_samples

_IMAGE = {"DEMODULATE": True, "FILL": True, "HAS_MOMENTS": False}


def voxelhash(setup: MethodSetup) -> Method:
    """The passes of VoxelHash."""
    device, scene, size, settings = setup.device, setup.scene, setup.size, setup.settings
    pixels, paths = size[0] * size[1], path_count(size)
    _check_device(setup)
    check_size(setup, pixels, 1)
    sobol = settings["pathtrace.sampler"] == "sobol"
    voxels = Voxels(device, scene, settings, False, voxel_counts())
    graphs = GraphSetup.of(device, scene, settings, setup.memo)
    passes = (
        OrderPixels(device, scene, size, sobol),
        *begin_memo(graphs),
        Clear("ray_counts"),
        Generate(device, scene, sobol),
        TraceCamera(scene),
        KeepFirstHits(voxels),
        KeepSurface(voxels),
        AskAll(voxels),
        *_update(setup, graphs, voxels, [FindAge(voxels)]),
        *_reconstruct(setup, graphs, cache_defines(1, False), [AnswerAsked(voxels)]),
        *_asked_materials(graphs, DESCRIBED_VALUES),
        DescribeVoxels(voxels),
    )
    first_hits = [replace(b, persistent=False, per_eye=False) for b in cache_buffers(pixels, 1, False)]
    images = reconstruct_buffers(pixels, -(-paths // GROUP), list_capacity(pixels, 1), paths)
    buffers = (
        *ray_buffers(paths),
        *path_buffers(paths),
        *first_hits,
        Buffer("listed", (4,), "u4"),
        Buffer("counters", (len(COUNTERS),), "u4"),
        *table_buffers(settings["voxelhash.capacity"]),
        *voxel_buffers(pixels, settings["voxelhash.capacity"], paths),
        *(b for b in images if b.name != "aov_age"),
        *voxel_aov_buffers(pixels),
        *graph_buffers(graphs, paths, has_lists=True),
    )
    kept = (*TABLE, *memo_names(graphs))
    levels = ("occupied", "capacity")
    return Method(passes, buffers, cache=kept, world=kept, counters=COUNTERS, levels=levels, memo=graphs.memo)


def hybrid(setup: MethodSetup) -> Method:
    """The passes of Hybrid."""
    device, scene, size, settings = setup.device, setup.scene, setup.size, setup.settings
    pixels, paths, slots = size[0] * size[1], path_count(size), settings["samplecache.slots"]
    rays, groups = max(paths, GROUP * slots), -(-paths // GROUP)
    _check_device(setup)
    check_size(setup, pixels, slots)
    variant = settings["samplecache.reprojection"]
    cache = cache_defines(slots, False)
    table_counters = ("voxels" if name == "occupied" else name for name in COUNTERS if name != "shaded")
    names = (*SAMPLE_COUNTERS, *table_counters)
    voxels = Voxels(device, scene, settings, True, voxel_counts(names))
    answers = [AddressSeen(voxels), FindSeen(voxels), AnswerSeen(voxels)]
    graphs = GraphSetup.of(device, scene, settings, setup.memo)
    passes = (
        OrderPixels(device, scene, size, False),
        *begin_memo(graphs),
        Clear("ray_counts"),
        *reproject_passes(device, scene, size, slots, variant, False),
        *trace_samples(setup, cache),
        AskSamples(device, cache),
        *_update(setup, graphs, voxels, []),
        ClearSurface(device, scene, cache | _IMAGE),
        *_reconstruct(setup, graphs, cache, answers, (Distance, KeepNearest)),
    )
    samples = reproject_buffers(pixels, slots, variant)
    buffers = (
        *rays_for(rays, paths),
        *path_buffers(rays),
        *cache_buffers(pixels, slots, False),
        *(replace(b, shape=(len(names),)) if b.name == "counters" else b for b in samples),
        *retrace_buffers(pixels, groups),
        *table_buffers(settings["voxelhash.capacity"]),
        *voxel_buffers(pixels, settings["voxelhash.capacity"], rays),
        *(b for b in reconstruct_buffers(pixels, groups, list_capacity(pixels, slots), rays) if b.name != "aov_age"),
        *graph_buffers(graphs, rays, has_lists=True),
    )
    return Method(
        passes,
        buffers,
        exchanged=exchanged_buffers(False),
        cache=(*TABLE, *(b.name for b in cache_buffers(pixels, slots, False)), *memo_names(graphs)),
        world=(*TABLE, *memo_names(graphs)),
        counters=names,
        levels=("occupied", "visible", "voxels", "capacity"),
        primary=("created", "retraced"),
        memo=graphs.memo,
    )


def _asked_materials(graphs: GraphSetup, values: str) -> list[Pass]:
    """What the graphs of the samples that ask say."""
    return [ListedMaterials(graphs, "asked", ("asked_listed", 1), False, values)] if graphs.scene.graphs else []


def _update(setup: MethodSetup, graphs: GraphSetup, voxels: Voxels, before: list[Pass]) -> list[Pass]:
    """From samples that ask to voxels that know. before: passes between addressing and access."""
    device, scene = setup.device, setup.scene
    traced = [ListedMaterials(graphs, "shaded", ("listed", 1), False, NEW_VALUES)] if scene.graphs else []
    start = [*traced, Inherit(voxels)] if voxels.inherits else []
    batch = [
        BeginPaths(device, scene, True),
        *materials(graphs, True, FIRST_VALUES),
        *vertices(setup, graphs, "path_stream", own_light=False, values=FIRST_VALUES),
        UpdateVoxels(voxels),
    ]
    return [
        *_asked_materials(graphs, ASKED_VALUES),
        AddressAsked(voxels),
        *before,
        LookUp(voxels),
        ListClaimed(voxels),
        *start,
        Repeat("shading", batch, count=lambda _, arrays: batches(arrays, 1), advance=at_batch, count_reads=("listed",)),
    ]


def _reconstruct(
    setup: MethodSetup, graphs: GraphSetup, cache: dict, answers: list[Pass], nearest: tuple[type[Pass], ...] = ()
) -> list[Pass]:
    """From voxels to the image and its AOVs. cache: defines of the samples. answers: what is known of the visible samples. nearest:
    what finds the nearest of them."""
    common = setup.device, setup.scene, cache | _IMAGE
    described = [p(*common) for p in (*nearest, Describe, FillAovs)]
    batch = [*seen_materials(graphs), *answers, Average(*common), *described]
    count = {"count": lambda _, arrays: batches(seen(arrays), 0), "count_reads": ("seen_listed",)}
    return [ListVisible(*common), Repeat("reconstruction", batch, advance=at_batch, **count)]


def _check_device(setup: MethodSetup) -> None:
    if not setup.device.capabilities.int64_atomics:
        raise SettingError(f"method: {setup.device.name} lacks 64-bit atomics, which the table of voxels needs")
