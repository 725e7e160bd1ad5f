"""The octree's cache (`cl/octree/`): its tables' builds and lookups, updates of cells, the layered filter, and the passes of a frame beside a
path-traced one.

Lookups are of the finest level: of cells that there are, in the order of the cells, where neighbours are near each other as they are in the image,
or shuffled, and of others, which no table has. A lookup reads two buckets, each in a cache line of its own, wherever the neighbours' are.
Updates are by vertices that lie in any of the cells, more scattered than those of paths are. The filter's layers are noise: the
first has all pixels, and of the others each has the upper third of those of the one before.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..device import Device
from ..frame import FrameGraph
from ..methods import PathState
from ..octree import Octree
from ..octree.cuckoo import BUCKET, EMPTY, first_table
from ..octree.occupancy import parts_of
from ..passes.octree_filter import filter_buffers, filter_passes
from ..passes.octree_update import COUNTERS, update_buffers, update_passes
from ..renderer import camera_record
from ..resources import eyes_of
from ..scene.geometry import Geometry
from ..scene.model import Scene
from ..settings import resolve
from .cached import cached
from .job import Job
from .launches import timed
from .pathtrace import traffic
from .result import Result

FAMILY = "octree"
USUAL = ("kitchen",)
STAGES = ("caching", "reconstruction")  # how the names of a frame's passes begin, before a dot
LAYERS = (1, 4)
_LINE = 64  # bytes of a cache line
_KEY_BITS = 30  # of a key within its part of space, as in cl/octree/shape.cl
_LEFT = 1 / 3  # of a layer's pixels, in the next one


def octree(job: Job) -> Iterator[Result]:
    """Seconds of each of them. nbytes: of lookups, their keys, answers and buckets, at most the whole table; of the filter, its buffers.
    Raises SettingError where a scene has fewer frames than are to be measured."""
    device = Device(job.device, job.threads)
    for name, scene in job.loaded(*USUAL):
        settings = resolve(scene.defaults.settings)
        trees = [built(device, scene, settings["octree.resolution"]) for _ in range(job.repeats + 1)]
        tree = trees[-1]
        for step in tree.report()["seconds"]:
            seconds = tuple(t.report()["seconds"][step] for t in trees[1:])
            yield Result(FAMILY, f"build, {step}", name, tree.cells, "cells", seconds)
        yield Result(FAMILY, "build", name, tree.cells, "cells", tuple(t.seconds for t in trees[1:]))
        for other in trees[:-1]:
            device.release(*other.arrays.values())
        yield from _lookups(job, device, name, tree)
        state = PathState(camera_record(scene.camera, job.size), (1, 2), 1)
        yield from _updates(job, device, name, tree, settings["octree.store"], state)
        device.release(*tree.arrays.values())
        yield from _filters(job, device, name, settings, state)
    yield from _frames(job)


def built(device: Device, scene: Scene, resolution: int) -> Octree:
    """The octree that the method makes of a scene."""
    is_static = np.array([not i.motion for i in scene.instances])
    return Octree(device, Geometry.of(scene), is_static, resolution, eyes_of(scene))


# ---------------------------------------------------------------------------------------------------------------------
# Lookups


def finest_keys(tree: Octree) -> np.ndarray:
    """(n,) uint64: the keys of the finest level's cells, in order; read from its tables."""
    entries, tables = tree.arrays["octree_table"].get().ravel(), tree.arrays["octree_tables"].get()
    first, found = first_table(tree.finest), []
    for part, (bucket, buckets, *_) in enumerate(tables[first : first + parts_of(tree.finest)].tolist()):
        own = entries[BUCKET * bucket : BUCKET * (bucket + buckets)]
        own = own[own != EMPTY] >> np.uint64(32)
        found.append(own | np.uint64(part << _KEY_BITS))
    return np.sort(np.concatenate(found))


def absent_keys(tree: Octree, present: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count,) uint64: keys of the finest level that no cell has, in order."""
    keys = rng.integers(0, 8**tree.finest, 4 * count, np.uint64)
    return np.sort(keys[~np.isin(keys, present)][:count])


def find(device: Device, tree: Octree, keys: np.ndarray, repeats: int) -> tuple[tuple[float, ...], np.ndarray]:
    """Seconds of each of so many times that keys of the finest level are looked up, and the cells' indices, NONE where there is none."""
    kernel = device.program("bench/find_cell.cl")["find_cells"]
    n = len(keys)
    arrays = {"keys": device.upload(keys, "keys"), "found": device.empty(n, np.uint32, "cells")}
    seconds = timed(lambda: kernel.run(n, arrays, tree.arrays, level=tree.finest, n=n), repeats)
    found = arrays["found"].get()
    device.release(*arrays.values())
    return seconds, found


def _lookups(job: Job, device: Device, name: str, tree: Octree) -> Iterator[Result]:
    rng, count = np.random.default_rng(1), job.size[0] * job.size[1]
    present = finest_keys(tree)
    asked = {
        "hits": np.sort(rng.choice(present, count, replace=len(present) < count)) if len(present) else present,
        "misses": absent_keys(tree, present, count, rng),
    }
    for what, keys in asked.items():
        for order in ("in order", "shuffled"):
            own = keys if order == "in order" else rng.permutation(keys)
            if len(own):
                seconds, _ = find(device, tree, own, job.repeats)
                nbytes = len(own) * (8 + 4) + min(len(own) * 2 * _LINE, tree.nbytes)
                yield Result(FAMILY, f"{what} {order}", name, len(own), "lookups", seconds, nbytes)


# ---------------------------------------------------------------------------------------------------------------------
# Updates and the filter


def _updates(job: Job, device: Device, name: str, tree: Octree, store: int, state: PathState) -> Iterator[Result]:
    rng, count = np.random.default_rng(2), job.size[0] * job.size[1] * store
    present = finest_keys(tree)
    if not len(present):
        return
    inputs = {
        "vertex_key": device.upload(rng.choice(present, count), "keys"),
        "vertex_normal": device.upload(rng.integers(1, 2**32, count, np.uint32), "normals"),
        "vertex_light": device.upload(rng.random((3, count), np.float32), "light"),
        "counters": device.upload(np.zeros(len(COUNTERS), np.uint32), "counters"),
    }
    passes, buffers = update_passes(device, tree), update_buffers(count, tree.cells)
    graph = FrameGraph(device, passes, buffers, {"octree_cells", "octree_wipe", "counters"}, inputs)
    graph.of()["octree_wipe"].set(np.array([1, 0, 0, 0], np.uint32))
    runs = _runs(job, graph, state)
    for step in runs[0]:
        yield Result(FAMILY, f"update, {step}", name, count, "vertices", tuple(run[step] for run in runs))
    yield Result(FAMILY, "update", name, count, "vertices", tuple(sum(run.values()) for run in runs))
    graph.release()
    device.release(*inputs.values())


def _filters(job: Job, device: Device, name: str, settings: dict, state: PathState) -> Iterator[Result]:
    rng, pixels = np.random.default_rng(3), job.size[0] * job.size[1]
    for layers in LAYERS:
        inputs = {}
        for i in range(layers):
            inputs |= {f"layer{i}_{key}": device.upload(v, key) for key, v in _layer(rng, pixels, _LEFT**i).items()}
        passes = filter_passes(device, job.size, layers, settings)
        buffers = filter_buffers(layers, job.size, settings)
        graph = FrameGraph(device, passes, buffers, {"layer0_filtered"}, inputs)
        what = f"filter of {layers} layer{'s' if layers > 1 else ''}"
        seconds = tuple(sum(run.values()) for run in _runs(job, graph, state))
        yield Result(FAMILY, what, name, pixels, "pixels", seconds, sum(traffic(graph, 1).values()))
        graph.release()
        device.release(*inputs.values())


def _layer(rng: np.random.Generator, pixels: int, part: float) -> dict[str, np.ndarray]:
    """The planes of a layer of which this part of the pixels, the first ones, has a vertex."""
    has, goes_on = (np.arange(pixels) < np.array([[part], [_LEFT * part]]) * pixels).astype(np.float32)
    normals = rng.normal((0, 0, 9), 1, (pixels, 3)).T
    planes = {key: rng.random((3, pixels), np.float32) * has for key in ("light", "albedo", "own")}
    return planes | {
        "pass": rng.random((3, pixels), np.float32) * goes_on,
        "normal": (normals / np.linalg.norm(normals, axis=0) * has).astype(np.float32),
        "depth": (10 + rng.random(pixels, np.float32)) * has,
        "segment": rng.random(pixels, np.float32) * goes_on,
        "roughness": rng.random(pixels, np.float32) * has,
        "count": np.floor(1 + 9 * rng.random(pixels, np.float32)) * has,
    }


def _runs(job: Job, graph: FrameGraph, state: PathState) -> list[dict[str, float]]:
    """Seconds by pass of each run, after one that warms up."""
    return [graph.run(replace(state, update=i)) for i in range(job.repeats + 1)][1:]


# ---------------------------------------------------------------------------------------------------------------------
# Frames


def _frames(job: Job) -> Iterator[Result]:
    """The passes of frames, and what those of each stage take together."""
    by_scene: dict[str, list[Result]] = {}
    for result in cached(FAMILY, job):
        by_scene.setdefault(result.scene, []).append(result)
        yield result
    for name, steps in by_scene.items():
        for stage in STAGES:
            own = [r.seconds for r in steps if r.name.startswith(f"{stage}.")]
            yield Result(FAMILY, stage, name, steps[0].items, "pixels", tuple(map(sum, zip(*own, strict=True))))
