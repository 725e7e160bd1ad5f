"""Jobs in processes of their own: each prints what it finds as lines of JSON, and this module reads them."""

import difflib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

import pyopencl as cl

from .. import drivers, errors
from ..probe import gist
from .bandwidth import FAMILY as BANDWIDTH
from .bandwidth import bandwidth
from .build import build, sort
from .cached import hybrid, samplecache, voxelhash
from .filters import filters
from .job import Job
from .memo import memo
from .octree import octree
from .pathtrace import pathtrace
from .rays import rays
from .reproject import reproject
from .result import Result
from .table import table

ANSWER = "bench: "  # begins the lines that count: drivers may print, too


@dataclass(frozen=True)
class Family:
    """What a name of the command line measures."""

    meaning: str
    results: Callable[[Job], Iterator[Result]]


FAMILIES = {
    BANDWIDTH: Family("memory: copy and read arrays much larger than the caches; always measured", bandwidth),
    "rays": Family("primary, diffuse-bounce and shadow rays, and builds of trees, beside Embree", rays),
    "build": Family("each kernel that builds trees", build),
    "sort": Family("each kernel of the radix sort by which trees are built", sort),
    "pathtrace": Family("each pass of a path-traced frame", pathtrace),
    "samplecache": Family("each pass of a frame by the sample cache, beside a path-traced frame", samplecache),
    "voxelhash": Family("each pass of a frame by voxels in a hash table, beside a path-traced frame", voxelhash),
    "hybrid": Family("each pass of a frame by voxels at cached first hits, beside a path-traced frame", hybrid),
    "octree": Family("builds of an octree of cells, lookups, updates, its filter, and each pass of a frame", octree),
    "table": Family("lookups that hit, lookups that miss, and insertions, in hash tables of several loads", table),
    "memo": Family("material graphs and their memoization: lookups by variant, costs of graphs, frames", memo),
    "filters": Family("each pass of the temporal and stereo filters of images", filters),
    "reproject": Family("the passes of a sample cache's forward reprojection, in its three variants", reproject),
}


def check_families(names: Sequence[str]) -> tuple[str, ...]:
    """Names of families, bandwidth before all others, since these are judged by it; all of them where none is named. Raises
    SettingError for one that does not exist."""
    for name in names:
        if name not in FAMILIES:
            near = difflib.get_close_matches(name, FAMILIES, 1)
            hint = f"; did you mean {near[0]}?" if near else f"; expected names of {', '.join(FAMILIES)}"
            raise errors.SettingError(f"benchmark {name}: unknown{hint}")
    return tuple(dict.fromkeys((BANDWIDTH, *(names or FAMILIES))))


def targets(spec: str | None, threads: Sequence[int] = ()) -> list[tuple[drivers.Candidate, tuple[int | None, ...]]]:
    """Devices to measure, and numbers of threads on each. spec: as of `Device`, or "all" for each one that works. threads: of
    CPUs; one, and as many as the process may use, if none is given. Raises SettingError, DeviceError."""
    found = []
    if spec == "all":
        found = [c for c in drivers.candidates() if "Oclgrind" not in c.platform and drivers.probe(c).usable]
    found = found or [drivers.choose(None if spec == "all" else spec)]  # which says what is wrong where none works
    usual = dict.fromkeys((1, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()))
    return [(c, tuple(threads or (usual if c.device.type & cl.device_type.CPU else (None,)))) for c in found]


def measure(job: Job) -> Iterator[Result]:
    """The results of a job, as they come, from a process of its own, which runs on as many of the cores as it has threads.

    Raises SceneError, SettingError and DeviceError as they occur there, and Error where the process ends before its time.
    """
    command = [sys.executable, "-P", "-m", __package__, json.dumps(asdict(job))]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path)}
    with tempfile.TemporaryFile("w+", errors="replace") as messages:
        options = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": messages}
        child = subprocess.Popen(command, env=environment, text=True, errors="replace", **options)
        try:
            yield from _read(child)
            code = child.wait()
        finally:
            child.kill()
            child.wait()
            child.stdout.close()
        if code:
            messages.seek(0)
            raise errors.Error(
                f"the process that measures device {job.device} {_ending(code)}: {gist(messages.read())}"
            )


def _read(child: subprocess.Popen) -> Iterator[Result]:
    for line in child.stdout:
        if not line.startswith(ANSWER):
            continue
        answer = json.loads(line.removeprefix(ANSWER))
        if "error" in answer:
            raise getattr(errors, answer["error"])(answer["message"])
        yield Result(**{key: tuple(value) if isinstance(value, list) else value for key, value in answer.items()})


def _ending(code: int) -> str:
    return f"ended with {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"


def work(text: str) -> None:
    """The process's side: do the job of this JSON and print each result. An error of clcache's is an answer, too."""
    fields = json.loads(text)
    job = Job(**{key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()})
    if job.threads and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: job.threads])
    try:
        for name in job.families:
            for result in FAMILIES[name].results(job):
                _print(asdict(result))
    except errors.Error as error:
        _print({"error": type(error).__name__, "message": str(error)})


def _print(answer: dict) -> None:
    print(f"\n{ANSWER}{json.dumps(answer)}", flush=True)
