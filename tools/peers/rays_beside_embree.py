"""Trace the same rays with clcache and with Embree's C interface, and build the same trees; print both and the ratio.

    python tools/peers/rays_beside_embree.py --json rays.json
    python tools/peers/rays_beside_embree.py --meshes cornell,city --kinds primary --repeats 9

Needs a C compiler and embreex, whose wheel brings Embree. Each mesh gets a process of its own, which is pinned to one core
and in which PoCL has one thread. Both sides take the same planes of rays in the same order and run in turn. Embree runs with
packets of 1, 4, 8 and 16, told that rays are coherent and not, for its default instruction set and for AVX2: each setting
once, then the two fastest as often as clcache; the faster of these counts. Its robust mode is off. clcache sorts the rays
of bounces, which counts in; primary and shadow rays it takes in order and sorted, of which the faster counts. A ratio above
1 says that clcache is faster. `--scaling` adds clcache's gain from a second thread.
"""

import argparse
import ctypes
import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import embreex
import numpy as np
import pyopencl.array as cl_array
from peer_meshes import MESHES, USUAL

from clcache.bench.ray_sets import RaySet, agreement, ray_sets
from clcache.bvh.build import SceneTrees
from clcache.bvh.tracer import RayKernels, Tracer
from clcache.device import Device
from clcache.errors import DeviceError, Error
from clcache.scene.geometry import Geometry
from clcache.scene.model import Scene

KINDS = ("primary", "diffuse", "shadow")
INSTRUCTION_SETS = ("", "avx2")  # "": the newest that the processor has
SETTINGS = [(isa, width, coherent) for isa in INSTRUCTION_SETS for width in (1, 4, 8, 16) for coherent in (False, True)]
LIGHT_SPREAD = 0.005  # about the sun's radius as it is seen from the earth
FASTEST = 2  # settings of Embree's that are timed again
MEDIUM_QUALITY = 1
Setting = tuple[str, int, bool]  # of Embree's: instruction set, width, whether rays are called coherent
Arrays = tuple[list[cl_array.Array | None], list[cl_array.Array]]  # rays and hits on the device


@dataclass(frozen=True)
class Job:
    """What one process does. cores: those that it may run on. library: the compiled embree_rays.c."""

    mesh: str
    kinds: tuple[str, ...]
    size: tuple[int, int]
    repeats: int
    device: str | None
    cores: tuple[int, ...]
    library: str


@dataclass(frozen=True)
class Times:
    """Seconds of one thing done several times."""

    minimum: float
    median: float
    maximum: float

    @classmethod
    def of(cls, seconds: list[float]) -> "Times":
        """Sum up."""
        return cls(min(seconds), statistics.median(seconds), max(seconds))


class Embree:
    """A mesh in Embree, once for each instruction set."""

    def __init__(self, library: str, positions: np.ndarray, triangles: np.ndarray):
        self._library = lib = ctypes.CDLL(library)
        pointer, size = ctypes.c_void_p, ctypes.c_size_t
        lib.open_device.restype, lib.build.restype, lib.trace.restype = pointer, pointer, ctypes.c_double
        lib.close_scene.argtypes = (pointer,)
        lib.build.argtypes = (pointer, pointer, size, pointer, size, ctypes.c_int, pointer)
        flags = (ctypes.c_int,) * 3
        lib.trace.argtypes = (pointer, pointer, pointer, pointer, size, *flags, pointer, pointer)
        self._mesh = np.ascontiguousarray(positions, np.float32), np.ascontiguousarray(triangles, np.uint32)
        config = "threads=1,user_threads=0"
        configs = {isa: f"{config},isa={isa}" if isa else config for isa in INSTRUCTION_SETS}
        self._devices = {isa: lib.open_device(config.encode()) for isa, config in configs.items()}
        self._scenes = {isa: self._build(isa)[0] for isa in INSTRUCTION_SETS}

    def build_seconds(self) -> float:
        """Build the tree once more, at the default quality."""
        scene, seconds = self._build("")
        self._library.close_scene(scene)
        return seconds

    def trace(self, rays: RaySet, setting: Setting) -> tuple[float, np.ndarray]:
        """Seconds, and t (n,) of the hits; where any hit is asked for, -inf for an occluded ray."""
        isa, width, coherent = setting
        t, primitive = np.empty(rays.count, np.float32), np.empty(rays.count, np.uint32)
        planes = (a.ctypes.data for a in (rays.origins, rays.directions, rays.lengths))
        seconds = self._library.trace(
            self._scenes[isa], *planes, rays.count, rays.any_hit, width, coherent, t.ctypes.data, primitive.ctypes.data
        )
        return seconds, t

    def _build(self, isa: str) -> tuple[int, float]:
        positions, triangles = self._mesh
        seconds = ctypes.c_double()
        scene = self._library.build(
            self._devices[isa],
            positions.ctypes.data,
            len(positions),
            triangles.ctypes.data,
            len(triangles),
            MEDIUM_QUALITY,
            ctypes.byref(seconds),
        )
        if not scene:
            raise DeviceError("Embree cannot build its tree")
        return scene, seconds.value


class Clcache:
    """The same mesh in clcache."""

    def __init__(self, scene: Scene, device_spec: str | None):
        self.device = Device(device_spec)
        self._geometry = Geometry.of(scene)
        self.tracer = Tracer(scene, self.device)
        self.kernels = RayKernels(self.device, self.tracer.trees)

    def build_seconds(self) -> float:
        """Build the trees once more."""
        trees = SceneTrees(self.device, self._geometry)
        self.device.queue.finish()
        self.device.release(*trees.arrays.values())
        return trees.seconds

    def upload(self, rays: RaySet) -> Arrays:
        """Rays and room for their hits, on the device."""
        device, n = self.device, rays.count
        given = [device.upload(a, "rays") for a in (rays.origins, rays.directions)]
        given += [None, device.upload(rays.lengths, "rays")]
        if rays.any_hit:
            return given, [device.empty(n, np.uint8, "hits")]
        shapes = ((n,), np.float32), ((2, n), np.float32), ((n,), np.uint32), ((n,), np.uint32)
        return given, [device.empty(shape, dtype, "hits") for shape, dtype in shapes]

    def trace(self, arrays: Arrays, any_hit: bool, coherent: bool) -> float:
        """Seconds from the launch to the end of all that it brings with it."""
        rays, hits = arrays
        call = self.kernels.any_hit if any_hit else self.kernels.closest_hit
        start = time.perf_counter()
        call(*rays, *hits, coherent=coherent)
        self.device.queue.finish()
        return time.perf_counter() - start


def measure(job: Job) -> dict:
    """All of one mesh beside Embree."""
    ours, scene = _prepare(job)
    mesh = joined(scene)
    embree = Embree(job.library, *mesh)
    builds = _in_turn({"clcache": ours.build_seconds, "embree": embree.build_seconds}, job.repeats)
    triangles = len(mesh[1])
    result = {
        "mesh": job.mesh,
        "triangles": triangles,
        "bytes_per_triangle": ours.tracer.trees.nbytes / triangles,
        "build": {who: asdict(times) for who, times in builds.items()}
        | {"ratio": builds["embree"].median / builds["clcache"].median},
        "rays": {},
    }
    for rays in ray_sets(scene, ours.tracer.closest_hit, job.size, light_spread=LIGHT_SPREAD):
        if rays.kind in job.kinds:
            result["rays"][rays.kind] = _beside(ours, embree, rays, job.repeats)
    return result


def measure_alone(job: Job) -> dict[str, dict[str, float]]:
    """clcache's median seconds for each kind of rays, in order and sorted."""
    ours, scene = _prepare(job)
    seconds = {}
    for rays in ray_sets(scene, ours.tracer.closest_hit, job.size, light_spread=LIGHT_SPREAD):
        if rays.kind in job.kinds:
            arrays = ours.upload(rays)
            times = _in_turn(_our_runs(ours, rays, arrays), job.repeats)
            seconds[rays.kind] = {who: t.median for who, t in times.items()}
    return seconds


def _prepare(job: Job) -> tuple[Clcache, Scene]:
    os.sched_setaffinity(0, job.cores)
    scene = MESHES[job.mesh]()
    return Clcache(scene, job.device), scene


def joined(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Positions (v, 3) and triangles (t, 3) of all meshes together, which stand where they are."""
    starts = np.cumsum([0, *(len(m.positions) for m in scene.meshes)])
    triangles = [m.triangles + np.uint32(start) for m, start in zip(scene.meshes, starts, strict=False)]
    return np.concatenate([m.positions for m in scene.meshes]), np.concatenate(triangles)


def _our_runs(ours: Clcache, rays: RaySet, arrays: Arrays) -> dict[str, Callable[[], float]]:
    modes = {"in order": True, "sorted": False} if rays.coherent else {"sorted": False}
    return {name: lambda c=coherent: ours.trace(arrays, rays.any_hit, c) for name, coherent in modes.items()}


def _beside(ours: Clcache, embree: Embree, rays: RaySet, repeats: int) -> dict:
    quick = {setting: embree.trace(rays, setting)[0] for setting in SETTINGS}
    best = sorted(SETTINGS, key=quick.__getitem__)[:FASTEST]
    arrays = ours.upload(rays)
    runs = _our_runs(ours, rays, arrays) | {s: lambda s=s: embree.trace(rays, s)[0] for s in best}
    times = _in_turn(runs, repeats)
    peer = min(best, key=lambda s: times[s].median)
    mine = {name: times[name] for name in times if isinstance(name, str)}
    mode = min(mine, key=lambda name: mine[name].median)
    ours.trace(arrays, rays.any_hit, mode == "in order")
    found, theirs = arrays[1][0].get(), embree.trace(rays, peer)[1]
    ours.device.release(*(a for part in arrays for a in part if a is not None))
    return {
        "rays": rays.count,
        "clcache": {name: asdict(t) for name, t in mine.items()},
        "fastest": mode,
        "embree": {_setting_name(s): asdict(times[s]) for s in best},
        "embree_once": {_setting_name(s): seconds for s, seconds in quick.items()},
        "embree_best": _setting_name(peer),
        "ratio": times[peer].median / mine[mode].median,
        "agree": agreement(rays, found, np.isneginf(theirs) if rays.any_hit else theirs),
    }


def _in_turn(runs: dict[Setting | str, Callable[[], float]], repeats: int) -> dict[Setting | str, Times]:
    """Each once to warm up, then all of them in turn."""
    seconds = {name: [] for name in runs}
    for round_ in range(repeats + 1):
        for name, run in runs.items():
            taken = run()
            if round_:
                seconds[name].append(taken)
    return {name: Times.of(taken) for name, taken in seconds.items()}


def _setting_name(setting: Setting) -> str:
    isa, width, coherent = setting
    return f"{width}{' coherent' if coherent else ''}{f' {isa}' if isa else ''}"


def compile_harness(folder: Path) -> str:
    """Build embree_rays.c against the Embree in embreex's wheel; returns the library's path."""
    wheel = Path(embreex.__file__).parent.with_name("embreex.libs")
    embree = next(wheel.glob("libembree4*"))
    target = folder / "embree_rays.so"
    source = Path(__file__).with_name("embree_rays.c")
    options = ["-std=gnu11", "-O3", "-march=native", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    linking = [f"-Wl,-rpath,{wheel}", "-Wl,--allow-shlib-undefined"]
    subprocess.run(["cc", *options, *linking, source, embree, "-o", target], check=True)
    return str(target)


def in_process(function: Callable[[Job], dict], job: Job, threads: int) -> dict:
    """Run in a process of its own, in which PoCL has this many threads."""
    os.environ["POCL_MAX_PTHREAD_COUNT"] = os.environ["POCL_CPU_MAX_CU_COUNT"] = str(threads)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, job).result()


def lines(result: dict) -> list[str]:
    """The rows of one mesh."""
    name, build = result["mesh"], result["build"]
    rows = [
        f"{name:9} build     {build['clcache']['median']:8.4f} s {build['embree']['median']:8.4f} s            "
        f"{build['ratio']:6.2f}  {result['bytes_per_triangle']:.0f} bytes/triangle"
    ]
    for kind, of in result["rays"].items():
        mrays = of["rays"] / 1e6
        mine, peer = of["clcache"], of["embree"][of["embree_best"]]
        both = ", ".join(f"{mode} {mrays / t['median']:.2f}" for mode, t in mine.items())
        scaling = "".join(f", x{x:.2f} {mode}" for mode, x in of.get("scaling", {}).items())
        rows.append(
            f"{name:9} {kind:8} {mrays / mine[of['fastest']]['median']:9.2f}   {mrays / peer['median']:8.2f}   "
            f"{of['embree_best']:16} {of['ratio']:6.2f}  {both}; hits agree {100 * of['agree']:.4f} %{scaling}"
        )
    return rows


def names_of(known: Iterable[str]) -> Callable[[str], tuple[str, ...]]:
    """What reads names with commas between."""

    def parse(text: str) -> tuple[str, ...]:
        names = tuple(filter(None, text.split(",")))
        if set(names) - set(known):
            raise argparse.ArgumentTypeError(f"{text!r}: expected names of {', '.join(known)}")
        return names

    return parse


def main() -> int:
    """Measure what the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--meshes", metavar="NAME,...", type=names_of(MESHES), default=USUAL, help=f"of {', '.join(MESHES)}")
    add("--kinds", metavar="NAME,...", type=names_of(KINDS), default=KINDS, help=f"of {', '.join(KINDS)}; may be empty")
    add("--size", metavar="WxH", type=lambda text: tuple(map(int, text.split("x"))), default=(1920, 1080))
    add("--repeats", metavar="N", type=int, default=5, help="runs of each, after one to warm up")
    add("--device", metavar="SPEC", help="as for clcache")
    add("--core", metavar="N", type=int, default=min(os.sched_getaffinity(0)), help="the core that is measured on")
    add("--scaling", metavar="CORE", type=int, help="also measure clcache with two threads, on --core and this one")
    add("--json", metavar="FILE", type=Path)
    args = parser.parse_args()
    columns = f"{'mesh':9} {'what':8} {'clcache':>9}   {'Embree':>8}   {'setting':16} {'ratio':>6}"
    print(f"{columns}  Mrays/s, medians of {args.repeats}", flush=True)
    results = []
    with tempfile.TemporaryDirectory() as folder:
        library = compile_harness(Path(folder))
        for mesh in args.meshes:
            job = Job(mesh, args.kinds, args.size, args.repeats, args.device, (args.core,), library)
            try:
                results.append(_measured(job, args.scaling))
            except Error as error:
                print(f"rays_beside_embree: {mesh}: {error}", file=sys.stderr)
                return 1
            print(*lines(results[-1]), sep="\n", flush=True)
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n")
    return 0


def _measured(job: Job, second_core: int | None) -> dict:
    """The result of one mesh, with the gain from a second thread where a core is given for it."""
    result = in_process(measure, job, 1)
    if second_core is not None:
        two = in_process(measure_alone, replace(job, cores=(*job.cores, second_core)), 2)
        for kind, of in result["rays"].items():
            of["scaling"] = {mode: t["median"] / two[kind][mode] for mode, t in of["clcache"].items()}
    return result


if __name__ == "__main__":
    sys.exit(main())
