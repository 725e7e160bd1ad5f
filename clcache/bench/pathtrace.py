"""The passes of a path-traced frame."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from ..frame import FrameGraph, Pass, Repeat
from ..renderer import Renderer
from .job import Job
from .result import Result

FAMILY = "pathtrace"
USUAL = ("cornell", "city")
SPP = 4
_STILL = 1e9  # frames per second: all frames show the same instant


def pathtrace(job: Job) -> Iterator[Result]:
    """Seconds of each pass in one frame, and of the whole frame."""
    for name, scene in job.loaded(*USUAL):
        still = replace(scene, defaults=replace(scene.defaults, fps=_STILL))
        options = {"size": job.size, "stereo": False, "spp": SPP, "device": job.device, "threads": job.threads}
        renderer = Renderer(still, "pathtrace", seed=1, **options)
        frames = [frame.stats for frame in renderer.frames(0, job.repeats + 1)][1:]
        samples = job.size[0] * job.size[1] * SPP
        passes = [frame["eyes"]["mono"]["passes"] for frame in frames]
        nbytes = traffic(renderer._graph, SPP)
        for step in passes[0]:
            seconds = tuple(p[step] for p in passes)
            if any(seconds):  # else it had nothing to do, in frames after the first
                yield Result(FAMILY, step, name, samples, "samples", seconds, nbytes[step])
        yield Result(FAMILY, "whole frame", name, samples, "samples", tuple(frame["seconds"] for frame in frames))


def traffic(graph: FrameGraph, samples: int) -> dict[str, int]:
    """The bytes of the buffers that each pass reads and writes in a frame, by the pass's name: one that it changes counts twice.
    Of what a scene brings nothing is counted; where a pass skips paths that have ended, it is the most."""
    nbytes: dict[str, int] = {}

    def add(passes: Sequence[Pass], times: int) -> None:
        for step in passes:
            if isinstance(step, Repeat):
                add(step.passes, times * samples)
            else:
                moved = sum(graph.of()[buffer].nbytes for buffer in (*step.reads, *step.writes))
                nbytes[step.name] = nbytes.get(step.name, 0) + times * moved

    add(graph.passes, 1)
    return nbytes
