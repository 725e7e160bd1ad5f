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
from ..passes.shade import Compact, Finish, FirstHits, Shade, path_buffers
from ..passes.trace import Generate, OrderPixels, Shadow, Trace, TraceCamera, path_count, ray_buffers
from .method import Method, MethodSetup, PathState


def pathtrace(setup: MethodSetup) -> Method:
    """The passes of path tracing."""
    device, (width, height) = setup.device, setup.size
    n = path_count(setup.size)
    sobol = setup.settings["pathtrace.sampler"] == "sobol"
    sample = [
        Generate(device, setup.scene, sobol),
        TraceCamera(setup.scene),
        NearestDepth(device),
        NearestHit(device, setup.scene),
        FirstHits(device, setup.scene, sobol),
        *vertices(setup),
        AddRadiance(device),
        AddSquare(device),
    ]
    passes = (
        OrderPixels(device, setup.scene, setup.size, sobol),
        *(Clear(b) for b in ("ray_counts", "color_sum", "color_lost", "square_sum", "albedo_sum", "N_sum")),
        Clear("aov_Z", inf),
        Clear("nearest", inf),
        Repeat("samples", sample, count=lambda s, _: s.samples - s.begin, advance=_at_sample),
        Mean(device, "color_sum", "color"),
        Variance(device),
        SampleCount(),
        Mean(device, "albedo_sum", "aov_albedo"),
        MeanDirection(device, "N_sum", "aov_N"),
    )
    return Method(passes, (*ray_buffers(n), *path_buffers(n), *film_buffers(n, width * height)))


def _at_sample(state: PathState, index: int) -> PathState:
    return replace(state, sample=state.begin + index)


def vertices(setup: MethodSetup, stream: str = "pixel", own_light: bool = True) -> list[Pass]:
    """From first hits to the radiance of the paths that go on from there. stream: as of `Shade`. own_light: whether the first
    hits' own counts."""
    device, scene, settings = setup.device, setup.scene, setup.settings
    sobol = settings["pathtrace.sampler"] == "sobol"
    last = settings["pathtrace.bounces"]
    gathers_hits, is_lit = scene.features["HAS_EMISSION"], scene.features["HAS_DIRECT"]
    passes: list[Pass] = []
    for vertex in range(last + 1):
        if vertex > 0:
            passes += [Trace(scene)]
        is_last = vertex == last and not gathers_hits
        counts = own_light or vertex > 0
        passes += [Shade(device, scene, vertex, settings["pathtrace.roulette"], is_last, sobol, stream, counts)]
        if is_lit:
            passes += [Shadow(scene)]
        passes += [Compact(device, scene)]
    if gathers_hits:
        passes += [Trace(scene), Finish(device, scene, sobol)]
    return passes
