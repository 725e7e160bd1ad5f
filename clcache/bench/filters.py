"""The filters of finished images: what each of their passes costs beside the bytes that it moves."""

import math
from collections.abc import Iterator

from ..frame import FrameGraph
from ..renderer import Renderer
from ..scene.model import Scene
from .job import Job
from .pathtrace import traffic
from .result import Result

FAMILY = "filters"
USUAL = ("classroom",)
PAIRS = (("taa", "constant"), ("varianceblend", "varianceblend"))  # filters in time and between eyes, measured together
_STARTING = 2  # frames that do not count: in the first there is no history
_GEOMETRY = 48  # bytes of what a pixel's first hit is found by: three indices and three corners
_LOCATING = {"motion": 1, "near": 2}  # the passes that find first hits, and of how many eyes


def filters(job: Job) -> Iterator[Result]:
    """Seconds of each filter's passes, and of all of them together, for one eye of a stereo pair in the frames of a scene's own
    motion."""
    for name, scene in job.loaded(*USUAL):
        for temporal, blend in PAIRS:
            yield from _of_pair(job, name, scene, temporal, blend)


def _of_pair(job: Job, name: str, scene: Scene, temporal: str, blend: str) -> Iterator[Result]:
    options = {"size": job.size, "spp": 1, "stereo": True, "seed": 1, "device": job.device, "threads": job.threads}
    renderer = Renderer(scene, "pathtrace", temporal=temporal, stereo_blend=blend, **options)
    first = scene.defaults.frames[0]
    shown = renderer.frames(first, first + _STARTING + job.repeats)
    frames = [frame.stats["eyes"]["left"]["passes"] for frame in shown][_STARTING:]
    for label, graph in ((temporal, renderer._temporal_graph), (f"stereo {blend}", renderer._stereo_graph)):
        yield from _of_graph(label, name, graph, math.prod(job.size), frames)


def _of_graph(
    label: str, name: str, graph: FrameGraph, pixels: int, frames: list[dict[str, float]]
) -> Iterator[Result]:
    nbytes = {step: n + _LOCATING.get(step, 0) * _GEOMETRY * pixels for step, n in traffic(graph, 1).items()}
    for step, moved in nbytes.items():
        seconds = tuple(passes[step] for passes in frames)
        yield Result(FAMILY, f"{label} {step}", name, pixels, "pixels", seconds, moved)
    seconds = tuple(math.fsum(passes[step] for step in nbytes) for passes in frames)
    yield Result(FAMILY, label, name, pixels, "pixels", seconds, sum(nbytes.values()))
