"""Rays and builds of trees, beside Embree where that does the same: hits of the same rays, in the same order, compared."""

from collections.abc import Iterator

import numpy as np

from ..bvh.build import SceneTrees
from ..bvh.tracer import RayKernels, Tracer
from ..device import Device
from ..scene.geometry import Geometry
from ..scene.model import Scene
from .embree import Embree, is_installed, world_triangles
from .job import Job
from .launches import timed
from .ray_sets import RaySet, agreement, ray_sets
from .result import Result

FAMILY = "rays"
# A small room, a large open place, hair, a textured town, and one mesh placed many times.
USUAL = ("cornell", "landscape", "hairball", "city", "atrium")


def rays(job: Job) -> Iterator[Result]:
    """The build of a scene's trees, and primary, diffuse-bounce and shadow rays through them."""
    for name, scene in job.loaded(*USUAL):
        device = Device(job.device, job.threads)
        tracer = Tracer(scene, device)
        triangles = world_triangles(Geometry.of(scene)) if is_installed() else None
        yield _build(job, name, scene, device, triangles)
        kernels = RayKernels(device, tracer.trees)
        embree = Embree(triangles) if triangles is not None and job.threads == 1 else None
        for given in ray_sets(scene, tracer.closest_hit, job.size):
            if given.count:
                yield _trace(job, name, given, device, kernels, embree)


def _build(job: Job, name: str, scene: Scene, device: Device, triangles: np.ndarray | None) -> Result:
    """Embree's build counts where it is over as many triangles."""
    geometry, seconds = Geometry.of(scene), []
    for _ in range(job.repeats + 1):
        trees = SceneTrees(device, geometry)
        seconds.append(trees.seconds)
        device.release(*trees.arrays.values())
    items = len(trees.merged.geometry.triangles)
    peer = None
    if triangles is not None and len(triangles) == items:
        peer = tuple(Embree(triangles).seconds for _ in range(job.repeats + 1))[1:]
    size = trees.nbytes / items
    return Result(
        FAMILY, "build", name, items, "triangles", tuple(seconds[1:]), peer_seconds=peer, bytes_per_triangle=size
    )


def _trace(job: Job, name: str, given: RaySet, device: Device, kernels: RayKernels, embree: Embree | None) -> Result:
    n = given.count
    rays = [device.upload(given.origins, "rays"), device.upload(given.directions, "rays"), None]
    rays.append(device.upload(given.lengths, "rays"))
    shapes = [((n,), np.float32), ((2, n), np.float32), ((n,), np.uint32), ((n,), np.uint32)]
    shapes = [((n,), np.uint8)] if given.any_hit else shapes
    hits = [device.empty(shape, dtype, "hits") for shape, dtype in shapes]
    trace = kernels.any_hit if given.any_hit else kernels.closest_hit
    seconds = timed(lambda: trace(*rays, *hits, coherent=given.coherent), job.repeats)
    found = hits[0].get()
    arrays = [a for a in (*rays, *hits) if a is not None]
    nbytes = sum(a.nbytes for a in arrays)
    device.release(*arrays)
    peer, agree = None, None
    if embree is not None:
        peer, theirs = embree.trace(given, job.repeats)
        agree = agreement(given, found, theirs)
    return Result(FAMILY, given.kind, name, n, "rays", seconds, nbytes, peer, agree)
