"""Trace the same rays through clcache's trees and through trees of another builder, and print both speeds.

    python tools/peers/sah_tree.py                     every mesh of peer_meshes.py, `mixed` among them
    python tools/peers/sah_tree.py --meshes city,mixed --repeats 9

The other builder is the usual yardstick: from the top down, each range is divided at the best of 32 bins along each of the three
axes, by surface areas and numbers of triangles (Wald 2007), down to single triangles. It is written in NumPy, apart from clcache's,
and takes a minute for a million triangles. Its binary trees become wide ones by clcache's kernels, so that they differ in
nothing else. Printed beside the speeds: the cost of each tree by surface areas, its levels and bytes per triangle.

Pin it to one core, and let PoCL have one thread, to compare figures with others (POCL_MAX_PTHREAD_COUNT=1 taskset -c 0).
"""

import argparse
import statistics

import numpy as np
import pyopencl.array as cl_array
from peer_meshes import MESHES

from clcache.bench.ray_sets import RaySet, ray_sets
from clcache.bvh import build
from clcache.bvh.build import BinaryTrees, SceneTrees
from clcache.bvh.tracer import RayKernels, Tracer
from clcache.device import Device, event_seconds
from clcache.layout import STRUCTS
from clcache.scene.geometry import Geometry

BINS = 32
BATCH = 1 << 14  # ranges whose bins are in memory at once


def half_areas(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Half the surfaces of boxes (..., 3); 0 where there is none."""
    x, y, z = np.moveaxis(np.maximum(high - low, 0), -1, 0)
    return x * y + y * z + z * x


def divide(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """The order of (n, 3) boxes, and of each level the divisions (count, 2): where a range begins, and its second half."""
    order, ranges, levels = np.arange(len(low)), np.array([[0, len(low)]]), []
    while len(ranges := ranges[ranges[:, 1] - ranges[:, 0] > 1]):
        middles = np.concatenate(
            [_divide_batch(order, low, high, ranges[k : k + BATCH]) for k in range(0, len(ranges), BATCH)]
        )
        levels.append(np.column_stack([ranges[:, 0], middles]))
        ranges = np.concatenate([levels[-1], np.column_stack([middles, ranges[:, 1]])])
    return order, levels


def _divide_batch(order: np.ndarray, low: np.ndarray, high: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """Put each range of `order` in order, and tell where its second half begins."""
    sizes = ranges[:, 1] - ranges[:, 0]
    owner, starts = np.repeat(np.arange(len(ranges)), sizes), np.cumsum(sizes) - sizes
    places = np.arange(sizes.sum()) - starts[owner] + ranges[owner, 0]
    boxes = order[places]
    a, b = low[boxes], high[boxes]
    middle = a + b
    first, last = np.minimum.reduceat(middle, starts), np.maximum.reduceat(middle, starts)
    with np.errstate(divide="ignore", invalid="ignore"):
        bins = np.nan_to_num((middle - first[owner]) * (BINS / (last - first))[owner])
    bins = np.minimum(bins, BINS - 1).astype(np.int64)

    least, is_second = np.full(len(ranges), np.inf), np.zeros(len(boxes), bool)
    for axis in range(3):
        cost, border = _best_borders(owner * BINS + bins[:, axis], a, b, len(ranges))
        better = cost < least
        least = np.where(better, cost, least)
        is_second = np.where(better[owner], bins[:, axis] >= border[owner], is_second)
    # Where all middles are the same, by number.
    halved = np.isinf(least)[owner]
    is_second[halved] = (places - ranges[owner, 0] >= sizes[owner] // 2)[halved]
    order[places] = boxes[np.argsort(2 * owner + is_second, kind="stable")]
    return ranges[:, 1] - np.bincount(owner, is_second, len(ranges)).astype(np.int64)


def _best_borders(cell: np.ndarray, low: np.ndarray, high: np.ndarray, ranges: int) -> tuple[np.ndarray, np.ndarray]:
    """Each range's least cost over the borders of its bins, infinite if there is none, and the first bin behind it. cell: (n,), of
    each box, range * BINS + bin."""
    count = np.bincount(cell, minlength=ranges * BINS).reshape(ranges, BINS)
    lows, highs = np.full((ranges * BINS, 3), np.inf), np.full((ranges * BINS, 3), -np.inf)
    for axis in range(3):
        np.minimum.at(lows[:, axis], cell, low[:, axis])
        np.maximum.at(highs[:, axis], cell, high[:, axis])
    lows, highs = lows.reshape(ranges, BINS, 3), highs.reshape(ranges, BINS, 3)

    def running(lows, highs, count):
        areas = half_areas(np.minimum.accumulate(lows, axis=1), np.maximum.accumulate(highs, axis=1))
        counts = np.cumsum(count, axis=1)
        return np.where(counts > 0, areas * counts, np.inf)

    before = running(lows, highs, count)[:, :-1]
    behind = running(lows[:, ::-1], highs[:, ::-1], count[:, ::-1])[:, ::-1][:, 1:]
    border = np.argmin(before + behind, axis=1)
    return np.take_along_axis(before + behind, border[:, None], axis=1)[:, 0], border + 1


class BinnedTrees(SceneTrees):
    """clcache's trees, with the binary trees over meshes by the builder above; of a scene that is one mesh in the end."""

    def _build(self, boxes: cl_array.Array, bounds: np.ndarray, begins: np.ndarray, leaf_size: int) -> BinaryTrees:
        if leaf_size == 1:
            return super()._build(boxes, bounds, begins, leaf_size)
        if len(begins) != 2:
            raise ValueError(f"the scene has {len(begins) - 1} meshes; expected one")
        device, n = self._device, boxes.shape[0]
        values = boxes.get()
        order, levels = divide(values[:, :3].astype(np.float64), values[:, 3:].astype(np.float64))
        items = np.zeros(n, STRUCTS["Item"])
        items["low"], items["minus_high"] = values[order, :3], -values[order, 3:]
        items["cluster"], items["triangles"] = np.arange(n), 1
        items = device.upload(items)
        clusters = device.empty(n, STRUCTS["Cluster"])
        roots = device.upload(np.arange(n, dtype=np.uint32))
        self._complete(items, levels, roots, clusters, n, leaf_size)
        device.release(items)
        begins = device.upload(np.zeros(1, np.uint32))
        return BinaryTrees(boxes, device.upload(order.astype(np.uint32)), clusters, roots, begins)


def area_cost(trees: SceneTrees) -> float:
    """What the collapse minimises, over the area of the root: nodes and leaves by their boxes' surfaces."""
    nodes, record = trees.nodes.get(), trees.placed.get()[0]
    planes = nodes["planes"].reshape(-1, 3, 2, 8).astype(np.float64)
    is_used = np.isfinite(planes[:, 0, 0])
    low, high = (np.where(is_used[..., None], planes[:, :, side].swapaxes(1, 2), 0) for side in (0, 1))
    per_leaf = build.BLOCK_COST + build.TRIANGLE_COST * ((~nodes["child"] & 7) + 1)
    costs = half_areas(low, high) * np.where(nodes["child"] < 0, per_leaf, build.NODE_COST)
    whole = half_areas(record["low"].astype(np.float64), record["high"].astype(np.float64))
    return build.NODE_COST + costs[is_used].sum() / whole


def trace(device: Device, trees: list[SceneTrees], rays: RaySet, repeats: int) -> list[float]:
    """Mrays/s through each of the trees, which take turns; the median."""
    planes = [device.upload(p) for p in (rays.origins, rays.directions)]
    lengths = device.upload(rays.lengths)
    n = lengths.size
    shapes = [(n, np.uint8)] if rays.any_hit else [(n, "f4"), ((2, n), "f4"), (n, "u4"), (n, "u4")]
    results = [device.empty(shape, dtype) for shape, dtype in shapes]
    seconds: list[list[float]] = [[] for _ in trees]
    for repeat in range(repeats + 1):
        for tree, times in zip(trees, seconds, strict=True):
            kernels = RayKernels(device, tree)
            launch = kernels.any_hit if rays.any_hit else kernels.closest_hit
            event = launch(*planes, None, lengths, *results, coherent=rays.coherent)
            event.wait()
            if repeat:
                times.append(event_seconds(event))
    device.release(*planes, lengths, *results)
    return [1e-6 * n / statistics.median(times) for times in seconds]


def main() -> None:
    """Compare on the meshes that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--meshes", default=",".join(MESHES), help="names, with commas")
    parser.add_argument("--size", default="960x544", help="of the picture that the rays are for; multiples of 4")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    size = tuple(int(x) for x in arguments.size.split("x"))
    device = Device()
    for name in arguments.meshes.split(","):
        scene = MESHES[name]()
        tracer, binned = Tracer(scene, device), BinnedTrees(device, Geometry.of(scene))
        trees = [tracer.trees, binned]
        for label, tree in zip(("clcache", "binned"), trees, strict=True):
            triangles = len(tree.merged.geometry.triangles)
            print(
                f"{name:9} {label:8} cost {area_cost(tree):8.3f}  levels {tree.depth:3}  bytes per triangle: nodes "
                f"{tree.nodes.nbytes / triangles:5.1f}, blocks {tree.blocks.nbytes / triangles:5.1f}, all "
                f"{tree.nbytes / triangles:5.1f}"
            )
        for rays in ray_sets(scene, tracer.closest_hit, size):
            ours, theirs = trace(device, trees, rays, arguments.repeats)
            print(f"{name:9} {rays.kind:8} {ours:8.2f} Mrays/s  binned {theirs:8.2f}  ratio {ours / theirs:5.2f}")
        for tree in trees:
            device.release(*tree.arrays.values())


if __name__ == "__main__":
    main()
