"""Path tracing without any cache: the reference of all other methods.

Each sample follows one path for each pixel, as waves: every pass does one step of all paths. A path meets up to
`bounces` + 1 surfaces; at each it samples one light, and its next ray finds emission and environment by itself, so
that one more ray follows the last surface where there is any to find.
"""

from dataclasses import replace
from math import inf

from ..frame import Pass, Repeat
from ..passes.film import (
    AddRadiance,
    AddSquare,
    Clear,
    Mean,
    MeanDirection,
    NearestDepth,
    NearestHit,
    SampleCount,
    Variance,
    film_buffers,
)
from ..passes.materials import VALUES, BeginMemo, GraphSetup, Materials, ThinOut, graph_buffers, memo_names
from ..passes.shade import Compact, Finish, FirstHits, Shade, path_buffers
from ..passes.trace import Generate, OrderPixels, Shadow, Trace, TraceCamera, path_count, ray_buffers
from .method import Method, MethodSetup, PathState


def pathtrace(setup: MethodSetup) -> Method:
    """The passes of path tracing."""
    device, (width, height) = setup.device, setup.size
    n = path_count(setup.size)
    sobol = setup.settings["pathtrace.sampler"] == "sobol"
    graphs = GraphSetup.of(device, setup.scene, setup.settings, setup.memo)
    sample = [
        Generate(device, setup.scene, sobol),
        TraceCamera(setup.scene),
        NearestDepth(device),
        NearestHit(device, setup.scene),
        *materials(graphs, is_primary=True),
        FirstHits(device, setup.scene, sobol),
        *vertices(setup, graphs),
        AddRadiance(device),
        AddSquare(device),
    ]
    passes = (
        OrderPixels(device, setup.scene, setup.size, sobol),
        *begin_memo(graphs),
        *(Clear(b) for b in ("ray_counts", "color_sum", "color_lost", "square_sum", "albedo_sum", "N_sum")),
        Clear("aov_Z", inf),
        Clear("nearest", inf),
        *_prepass(setup, graphs),
        Repeat("samples", sample, count=lambda s, _: s.samples - s.begin, advance=_at_sample),
        Mean(device, "color_sum", "color"),
        Variance(device),
        SampleCount(),
        Mean(device, "albedo_sum", "aov_albedo"),
        MeanDirection(device, "N_sum", "aov_N"),
    )
    buffers = (*ray_buffers(n), *path_buffers(n), *film_buffers(n, width * height), *graph_buffers(graphs, n))
    return Method(passes, buffers, cache=memo_names(graphs), world=memo_names(graphs), memo=graphs.memo)


def _at_sample(state: PathState, index: int) -> PathState:
    return replace(state, sample=state.begin + index)


def _prepass(setup: MethodSetup, graphs: GraphSetup) -> list[Pass]:
    """A part of the first sample's paths ahead of all, for what they leave in the cache of graphs (MaterialMemo, section 6.7.2)."""
    if not graphs.memo or not graphs.spacing:
        return []
    device, sobol = setup.device, setup.settings["pathtrace.sampler"] == "sobol"
    return [
        Generate(device, setup.scene, sobol),
        ThinOut(graphs, setup.size[0]),
        TraceCamera(setup.scene),
        *materials(graphs, is_primary=True),
        *vertices(setup, graphs),
    ]


def begin_memo(graphs: GraphSetup) -> list[Pass]:
    """What a memoization needs once for each run of an eye."""
    return [BeginMemo(graphs)] if graphs.memo else []


def materials(graphs: GraphSetup, is_primary: bool, values: str = VALUES) -> list[Pass]:
    """What graphs return at the hits in the queue, where the scene has any."""
    return [Materials(graphs, is_primary, values)] if graphs.scene.graphs else []


def vertices(
    setup: MethodSetup, graphs: GraphSetup, stream: str = "pixel", own_light: bool = True, values: str = VALUES
) -> list[Pass]:
    """From first hits, with what their graphs returned, to the radiance of the paths that go on from there. stream, values: as of
    `Shade`. own_light: whether the first hits' own counts."""
    device, scene, settings = setup.device, setup.scene, setup.settings
    sobol = settings["pathtrace.sampler"] == "sobol"
    last = settings["pathtrace.bounces"]
    gathers_hits, is_lit = scene.features["HAS_EMISSION"], scene.features["HAS_DIRECT"]
    passes: list[Pass] = []
    for vertex in range(last + 1):
        if vertex > 0:
            passes += [Trace(scene), *materials(graphs, is_primary=False)]
        is_last = vertex == last and not gathers_hits
        counts = own_light or vertex > 0
        found = values if vertex == 0 else VALUES
        passes += [Shade(device, scene, vertex, settings["pathtrace.roulette"], is_last, sobol, stream, counts, found)]
        if is_lit:
            passes += [Shadow(scene)]
        passes += [Compact(device, scene)]
    if gathers_hits:
        emits = any("emission" in g.outputs for g in scene.graphs)
        light = [Materials(graphs, is_primary=False, light_only=True)] if emits else []
        passes += [Trace(scene), *light, Finish(device, scene, sobol)]
    return passes
