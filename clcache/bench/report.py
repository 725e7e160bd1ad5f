"""The results of several devices and numbers of threads together: the object that becomes JSON."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from ..drivers import Candidate
from ..version import __version__
from .bandwidth import FAMILY as BANDWIDTH
from .job import Job
from .result import Result


@dataclass(frozen=True)
class Run:
    """What one process measured. results grows while it does."""

    candidate: Candidate
    job: Job
    results: list[Result] = field(default_factory=list)

    @property
    def bandwidth(self) -> dict[str, float]:
        """Bytes per second of a copy and of reading."""
        return {r.name: r.rate for r in self.results if r.family == BANDWIDTH}


@dataclass(frozen=True)
class Scaling:
    """How many times faster something is with more threads. threads: few, many."""

    family: str
    name: str
    scene: str
    threads: tuple[int, int]
    factor: float


def scalings(few: Run, many: Run) -> list[Scaling]:
    """What two runs on the same device, which differ in their threads, have in common."""
    slow = {(r.family, r.name, r.scene): r.median for r in few.results}
    threads = few.job.threads, many.job.threads
    found = ((key, r) for r in many.results if (key := (r.family, r.name, r.scene)) in slow)
    return [Scaling(*key, threads, slow[key] / r.median) for key, r in found]


def scaling_pairs(runs: Sequence[Run]) -> list[tuple[Run, Run]]:
    """For each device that was measured with several numbers of threads, the runs with the fewest and with the most."""
    pairs = []
    for index in dict.fromkeys(run.candidate.index for run in runs):
        of = sorted((r for r in runs if r.candidate.index == index and r.job.threads), key=lambda r: r.job.threads)
        if len(of) > 1:
            pairs.append((of[0], of[-1]))
    return pairs


def report(runs: Sequence[Run], embree: str | None) -> dict:
    """All results, for JSON. embree: how Embree was measured, if it was."""
    return {
        "version": __version__,
        "size": list(runs[0].job.size),
        "repeats": runs[0].job.repeats,
        "embree": embree,
        "runs": [_run(run) for run in runs],
        "scaling": [
            {"device": few.candidate.index, **vars(scaling)}
            for few, many in scaling_pairs(runs)
            for scaling in scalings(few, many)
        ],
    }


def _run(run: Run) -> dict:
    device = run.candidate
    return {
        "device": {
            "index": device.index,
            "platform": device.platform,
            "name": device.name,
            "driver": device.driver_version,
        },
        "threads": run.job.threads,
        "bandwidth": run.bandwidth,
        "results": [result.entry(run.bandwidth["copy"]) for result in run.results],
    }
