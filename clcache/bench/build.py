"""The kernels that build trees, each by itself, and those of them that sort."""

from collections.abc import Callable, Iterator

from ..bvh.build import SceneTrees
from ..scene.geometry import Geometry
from .job import Job
from .launches import Launch, WatchedDevice
from .result import Result

BUILD, SORT = "build", "sort"
USUAL = ("hairball",)
_SORTS = "radix_"  # how the names of the kernels that sort begin
# Entries of an array for each work-item, at most, where a kernel goes through all of it; shorter ones than this do not matter.
_ENTRIES, _SHORT = 2, 64


def build(job: Job) -> Iterator[Result]:
    """Seconds of each kernel in one build of a scene's trees, but those that sort."""
    return _kernels(job, BUILD, "triangles", lambda kernel: not kernel.startswith(_SORTS))


def sort(job: Job) -> Iterator[Result]:
    """Seconds of each kernel of the radix sort in one build: 64-bit keys, and a number with each."""
    return _kernels(job, SORT, "keys", lambda kernel: kernel.startswith(_SORTS))


def _kernels(job: Job, family: str, unit: str, is_wanted: Callable[[str], bool]) -> Iterator[Result]:
    for name, scene in job.loaded(*USUAL):
        geometry = Geometry.of(scene)
        items = len(geometry.triangles)
        builds = _builds(WatchedDevice(job.device, job.threads), geometry, job.repeats)
        wanted = [kernel for kernel in builds[0] if is_wanted(kernel)]
        for kernel in wanted:
            seconds = tuple(sum(launch.seconds for launch in of[kernel]) for of in builds)
            yield Result(family, kernel, name, items, unit, seconds, traffic(builds[0][kernel], family == SORT))
        whole = tuple(sum(launch.seconds for kernel in wanted for launch in of[kernel]) for of in builds)
        yield Result(family, "all kernels", name, items, unit, whole)


def traffic(launches: list[Launch], takes_all: bool) -> int | None:
    """The bytes of all arguments; None where that says nothing, since the arrays are much longer than the work-items are many.
    takes_all: whether each work-item takes its part of them all the same."""
    known = takes_all or all(launch.longest <= max(_ENTRIES * launch.count, _SHORT) for launch in launches)
    return sum(launch.nbytes for launch in launches) if known else None


def _builds(device: WatchedDevice, geometry: Geometry, repeats: int) -> list[dict[str, list[Launch]]]:
    """The launches of each kernel in each build, after one that warms up."""
    builds = []
    for _ in range(repeats + 1):
        trees = SceneTrees(device, geometry)
        device.release(*trees.arrays.values())
        builds.append({})
        for launch in device.take_launches():
            builds[-1].setdefault(launch.kernel, []).append(launch)
    return builds[1:]
