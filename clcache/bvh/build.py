"""Build the trees of a scene: one for each mesh, all in one go, and one over the instances (see `cl/bvh/build.cl`)."""

import time
from dataclasses import dataclass

import numpy as np
import pyopencl.array as cl_array

from ..device import Device
from ..layout import STRUCTS
from ..radix import CHUNKS, radix_sort
from ..scene.geometry import Geometry, Merged, instance_bounds

# Triangles in a leaf, at most: the lanes of a block. A tree over instances has one in each.
LEAF_SIZE = 8
# Costs of a ray's work, in units of the first: testing the eight boxes of a node; the triangles of a block, all at once; what
# each of these adds. Of the costs tried, these gave the fastest traversal, and nearly the fewest bytes.
NODE_COST = 1.0
BLOCK_COST = 1.0
TRIANGLE_COST = 0.0
# How many places away a cluster looks for its partner; clusters beside each other that look at once.
RADIUS = 8
_LANES = 16
# Where fewer than one in so many of the clusters that are to be joined found a partner, the others join by their places.
_FEW = 16
# Clustering goes on until one in so many boxes is left, or so many in all; what is above is divided from the top: that takes longer,
# and makes better trees. Ranges of more than _SHORT clusters are divided by a work-item each time.
_BOXES_EACH = 3
_FEW_CLUSTERS = 32768
_SHORT = 2048
_DIGIT_BITS = 8
_KEY_BITS = 64
_MORTON_AXIS_BITS = 16
# Clusters, and rows of children, that one work-item counts and moves in order; blocks that one writes.
_CLUSTER_CHUNK = 1024
_ROW_CHUNK = 256
_BLOCK_RUN = 8
_DEFINES = {
    "DIGIT_BITS": _DIGIT_BITS,
    "ORDERED": True,
    "RADIUS": RADIUS,
    "CHUNK": _CLUSTER_CHUNK,
    "ROW_CHUNK": _ROW_CHUNK,
    "RUN": _BLOCK_RUN,
    "BINS": 16,
    "NODE_COST": NODE_COST,
    "BLOCK_COST": BLOCK_COST,
    "TRIANGLE_COST": TRIANGLE_COST,
}

# Clusters of a round: planes of their boxes, segments, numbers (see `cl/bvh/cluster.cl`).
Round = tuple[cl_array.Array, cl_array.Array, cl_array.Array]


@dataclass(frozen=True)
class BinaryTrees:
    """Binary trees over segments of boxes, as cl/bvh/cluster.cl and divide.cl make them. boxes: (n, 6) float32. order: (n,) uint32, the
    boxes by their numbers as clusters. clusters: (n,) Cluster. roots: (items,) uint32, and begins: (segments,) uint32, where
    the root of each segment stands there."""

    boxes: cl_array.Array
    order: cl_array.Array
    clusters: cl_array.Array
    roots: cl_array.Array
    begins: cl_array.Array


@dataclass(frozen=True)
class Level:
    """The nodes of a level of wide trees. children: (rows, 8) uint32, clusters. first_row: (rows,) uint32, where those of them
    that are nodes begin in the next level. sizes: (rows, 2) uint32, nodes and leaves in each subtree."""

    children: cl_array.Array
    first_row: cl_array.Array
    sizes: cl_array.Array


@dataclass(frozen=True)
class WideTrees:
    """The trees of all segments. nodes: (nodes,) Node, at least one. roots: (segments,) int32, references. depth: levels of nodes.
    leaf_clusters: (leaves,) uint32."""

    nodes: cl_array.Array
    roots: np.ndarray
    depth: int
    leaf_clusters: cl_array.Array


class SceneTrees:
    """The trees of a scene's geometry on a device, and what traversal needs beside them. `seconds`: what the build took.

    moves: (i,) bool, which instances may be elsewhere at another time; none by default. `top_root`: the reference (see `Node`)
    of the root of the tree over the instances. `depth`: the most levels of nodes that a tree has; the subtrees that wait while a
    tree is walked are at most seven for each, and one.

    Raises DeviceError if the build does not fit the device's memory.
    """

    def __init__(self, device: Device, scene: Geometry, moves: np.ndarray | None = None):
        self._device = device
        self._program = device.program("bvh/build.cl", **_DEFINES)
        start = time.perf_counter()
        moves = np.zeros(len(scene.instance_mesh), bool) if moves is None else moves
        self.merged = merged = Merged.of(scene, moves)
        geometry = merged.geometry
        n = len(geometry.triangles)
        bytes_each = {
            "boxes": 24,
            "keys": 16,
            "order": 8,
            "clusters of two rounds": 64,
            "pairs": 64,
            "nodes": 16,
            "blocks": 100,
        }
        device.check_fits("the build of the trees", {name: n * size for name, size in bytes_each.items()})

        positions = device.upload(geometry.positions, "positions")
        triangles = device.upload(geometry.triangles, "triangles")
        boxes = device.empty((n, 6), np.float32, "triangle boxes")
        self._program["triangle_bounds"](positions, triangles, boxes, n, count=n)
        binary = self._build(boxes, geometry.mesh_bounds.T, geometry.first_triangle, LEAF_SIZE)
        wide = self._collapse(binary, len(geometry.first_triangle) - 1, has_blocks=True)
        self.nodes, self._mesh_roots, self._mesh_depth = wide.nodes, wide.roots, wide.depth
        leaves = wide.leaf_clusters.shape[0]
        self.blocks = device.empty(leaves, STRUCTS["Block"], "blocks")
        self._program["write_blocks"](
            wide.leaf_clusters,
            binary.clusters,
            binary.order,
            positions,
            triangles,
            self.blocks,
            leaves,
            n,
            count=-(-leaves // _BLOCK_RUN),
        )
        device.queue.finish()
        device.release(boxes, positions, triangles, binary.order, binary.clusters, wide.leaf_clusters)
        self.joined_first = device.upload(merged.joined_first, "first triangles of joined instances")
        self.joined_instance = device.upload(
            np.resize(merged.joined_instance, max(len(merged.joined_instance), 1)), "joined"
        )
        self._build_top()
        self.seconds = time.perf_counter() - start

    @property
    def nbytes(self) -> int:
        """What the trees take on the device, in bytes."""
        return sum(a.nbytes for a in self.arrays.values())

    @property
    def arrays(self) -> dict[str, cl_array.Array]:
        """What traversal reads, by the kernels' names."""
        names = ("top_nodes", "nodes", "blocks", "placed", "bounds", "joined_first", "joined_instance")
        return {name: getattr(self, name) for name in names}

    def move(self, scene: Geometry) -> None:
        """Rebuild the tree over the instances, whose transforms are now those of `scene`."""
        self._device.release(self.top_nodes, self.placed, self.bounds)
        self.merged = self.merged.at(scene)
        self._build_top()

    def _build_top(self) -> None:
        device, geometry = self._device, self.merged.geometry
        records = instance_records(geometry, self.merged.number)
        records["root"] = self._mesh_roots[geometry.instance_mesh]
        self.placed = device.upload(records, "placed meshes")
        low, high = instance_bounds(geometry)
        scene_bounds = np.concatenate([low.min(axis=0), high.max(axis=0)])
        boxes = device.upload(np.concatenate([low, high], axis=1), "instance boxes")
        binary = self._build(boxes, scene_bounds[None], np.array([0, len(low)]), leaf_size=1)
        wide = self._collapse(binary, 1, has_blocks=False)
        device.queue.finish()
        device.release(boxes, binary.order, binary.clusters, wide.leaf_clusters)
        self.top_nodes, self.top_root = wide.nodes, int(wide.roots[0])
        self.depth = max(wide.depth, self._mesh_depth)
        self.bounds = device.upload(scene_bounds, "bounds of the scene")

    def _build(self, boxes: cl_array.Array, bounds: np.ndarray, begins: np.ndarray, leaf_size: int) -> BinaryTrees:
        """Binary trees over (n, 6) boxes. bounds: (segments, 6) float32. begins: (segments + 1,), the first box of each."""
        device, program = self._device, self._program
        n, segments = boxes.shape[0], len(begins) - 1
        keys, order, morton_bits = self._sorted_keys(boxes, bounds, begins)
        places = RADIUS + n + RADIUS + _LANES
        clusters = device.empty(n, STRUCTS["Cluster"], "clusters")
        now, then = (
            (
                device.empty((6, places), np.float32, "boxes of clusters"),
                device.empty(places, np.uint32, "segments of clusters"),
                device.empty(places, np.uint32, "numbers of clusters"),
            )
            for _ in range(2)
        )
        program["first_clusters"](boxes, keys, order, *now, *then[:2], n, places, morton_bits, count=places)
        now, then, left = self._cluster(now, then, clusters, n, segments, leaf_size)
        items = device.empty(left, STRUCTS["Item"], "items")
        program["list_items"](now[0], now[2], clusters, items, places, left, n, count=left)
        item_begins = np.array([0, left], np.uint32)
        if segments > 1:
            segment = now[1].get()[RADIUS : RADIUS + left]
            item_begins = np.searchsorted(segment, np.arange(segments + 1)).astype(np.uint32)
        device.queue.finish()
        device.release(keys, *now, *then)
        roots = self._divide(items, item_begins, clusters, n, leaf_size)
        device.release(items)
        return BinaryTrees(boxes, order, clusters, roots, device.upload(item_begins[:-1], "roots"))

    def _cluster(
        self, now: Round, then: Round, clusters: cl_array.Array, n: int, segments: int, leaf_size: int
    ) -> tuple[Round, Round, int]:
        """Rounds of clustering, from `n` clusters. The last round, the one before, and how many clusters it has."""
        device, program, places = self._device, self._program, now[1].shape[0]
        nearest = device.empty(places, np.uint32, "nearest clusters")
        partner = device.empty(places, np.uint32, "partners of clusters")
        left, by_place = n, False
        while left > max(segments, n // _BOXES_EACH, _FEW_CLUSTERS):
            program["nearest_neighbours"](*now[:2], nearest, places, left, count=-(-left // _LANES))
            chunks = -(-left // _CLUSTER_CHUNK)
            counts = device.empty((2, chunks), np.uint32, "counts")
            program["match_clusters"](now[1], nearest, partner, counts, places, chunks, left, by_place, count=chunks)
            joined = self._sum(counts)[0]
            program["merge_clusters"](
                *now, partner, counts, *then, clusters, places, chunks, left, n, n - left, leaf_size, count=chunks
            )
            device.queue.finish()
            device.release(counts)
            by_place = joined * _FEW < left - segments
            left -= joined
            now, then = then, now
        device.queue.finish()
        device.release(nearest, partner)
        return now, then, left

    def _divide(
        self, items: cl_array.Array, begins: np.ndarray, clusters: cl_array.Array, boxes: int, leaf_size: int
    ) -> cl_array.Array:
        """Trees over segments of items. begins: (segments + 1,). Returns the roots, which stand where the segments begin."""
        device, program, n = self._device, self._program, items.shape[0]
        roots = device.empty(n, np.uint32, "roots")
        ranges, short, levels = np.column_stack([begins[:-1], begins[1:]]), [], []
        while True:
            is_short = ranges[:, 1] - ranges[:, 0] <= _SHORT
            short.append(ranges[is_short])
            ranges = ranges[~is_short]
            if not len(ranges):
                break
            listed, middles = device.upload(ranges, "ranges"), device.empty(len(ranges), np.uint32, "middles")
            program["divide_ranges"](items, listed, middles, n, len(ranges), count=len(ranges))
            middle = middles.get()
            device.release(listed, middles)
            levels.append(np.column_stack([ranges[:, 0], middle]))
            ranges = np.concatenate([levels[-1], np.column_stack([middle, ranges[:, 1]])])
        listed = device.upload(np.concatenate(short), "ranges")
        divisions = device.empty((n, 2), np.uint32, "divisions")
        count = listed.shape[0]
        program["build_ranges"](
            items, listed, divisions, roots, clusters, n, count, boxes, boxes - n, leaf_size, count=count
        )
        device.queue.finish()
        device.release(listed, divisions)
        self._complete(items, levels, roots, clusters, boxes, leaf_size)
        return roots

    def _complete(
        self,
        items: cl_array.Array,
        levels: list[np.ndarray],
        roots: cl_array.Array,
        clusters: cl_array.Array,
        boxes: int,
        leaf_size: int,
    ) -> None:
        """The pairs of the divisions of items, (count, 2) of each level from the top."""
        n = items.shape[0]
        for level in reversed(levels):
            listed, count = self._device.upload(level.astype(np.uint32), "divisions"), len(level)
            self._program["complete_divisions"](
                items, listed, roots, clusters, n, count, boxes, boxes - n, leaf_size, count=count
            )
            self._device.queue.finish()
            self._device.release(listed)

    def _sorted_keys(
        self, boxes: cl_array.Array, bounds: np.ndarray, begins: np.ndarray
    ) -> tuple[cl_array.Array, cl_array.Array, int]:
        """The boxes' keys in order, the boxes in that order, and how many bits of a key are its Morton code."""
        device, n, segments = self._device, boxes.shape[0], len(begins) - 1
        segment_begins = device.upload(begins.astype(np.uint32), "first boxes")
        segment_bounds = device.upload(bounds, "bounds of the segments")
        segment_bits = max(segments - 1, 0).bit_length()
        axis_bits = min(_MORTON_AXIS_BITS, (_KEY_BITS - segment_bits) // 3)
        keys, order = device.empty(n, np.uint64, "keys"), device.empty(n, np.uint32, "order")
        self._program["morton_keys"](
            boxes, segment_begins, segment_bounds, keys, order, n, segments, axis_bits, count=n
        )
        keys, order = self._sort(keys, order, 3 * axis_bits + segment_bits)
        device.release(segment_begins, segment_bounds)
        return keys, order, 3 * axis_bits

    def _sort(self, keys: cl_array.Array, order: cl_array.Array, bits: int) -> tuple[cl_array.Array, cl_array.Array]:
        """Keys, and the order with them, sorted stably; the arrays given are spent."""
        device, n = self._device, keys.shape[0]
        counts = device.empty((1 << _DIGIT_BITS, min(CHUNKS, n)), np.uint32, "digit counts")
        given = keys, order
        spare = device.empty(n, np.uint64, "keys"), device.empty(n, np.uint32, "order")
        _, result = radix_sort(self._program, given, spare, counts, n, 0, bits)
        device.queue.finish()
        device.release(counts, *(spare if result is given else given))
        return result

    def _sum(self, counts: cl_array.Array) -> list[int]:
        """Exclusive prefix sums of the rows, in place; their totals."""
        kinds, chunks = counts.shape
        totals = self._device.empty(kinds, np.uint32, "totals")
        self._program["sum_counts"](counts, totals, kinds, chunks, count=kinds)
        result = totals.get().tolist()
        self._device.release(totals)
        return result

    def _collapse(self, binary: BinaryTrees, segments: int, has_blocks: bool) -> WideTrees:
        """Wide trees of the binary ones; `has_blocks`: leaves are blocks of triangles."""
        device, program, n = self._device, self._program, binary.boxes.shape[0]
        levels = self._levels(binary, segments)
        below = levels[-1].sizes
        for level in reversed(levels):
            rows = level.children.shape[0]
            program["measure_subtrees"](level.children, level.first_row, below, level.sizes, rows, count=rows)
            below = level.sizes
        in_all = (levels[0].sizes.get() - [1, 0]).sum(axis=0)
        if in_all[0]:
            nodes = device.empty(int(in_all[0]), STRUCTS["Node"], "nodes")
        else:
            nodes = device.upload(np.zeros(1, STRUCTS["Node"]), "nodes")
        leaf_clusters = device.empty(int(in_all[1]), np.uint32, "leaves")
        roots = device.empty(segments, np.int32, "roots")
        starts = [device.empty(level.sizes.shape, np.uint32, "numbers of nodes") for level in levels]
        # The last level has nothing below it; its own arrays stand in for what is then not read.
        followers = [*range(1, len(levels)), len(levels) - 1]
        top, first = levels[0], followers[0]
        program["number_roots"](
            top.children, levels[first].sizes, binary.clusters, binary.order, roots, starts[first], leaf_clusters,
            top.children.shape[0], segments, n, has_blocks, count=1,
        )  # fmt: skip
        for k, level in enumerate(levels[1:], start=1):
            rows, next_level = level.children.shape[0], followers[k]
            program["write_nodes"](
                level.children, level.first_row, starts[k], levels[next_level].sizes, binary.clusters, binary.boxes,
                binary.order, starts[next_level], leaf_clusters, nodes, rows, n, has_blocks, count=rows,
            )  # fmt: skip
        result = WideTrees(nodes, roots.get(), len(levels) - 1, leaf_clusters)
        device.release(roots, *starts)
        for level in levels:
            device.release(level.children, level.first_row, level.sizes)
        return result

    def _levels(self, binary: BinaryTrees, segments: int) -> list[Level]:
        """The levels of the wide trees, behind one of which the roots are the children."""
        device, program, n = self._device, self._program, binary.boxes.shape[0]
        rows, levels = -(-segments // 8), []
        children = device.empty((rows, 8), np.uint32, "roots")
        program["list_roots"](binary.roots, binary.begins, binary.clusters, children, rows, segments, n, count=8 * rows)
        while True:
            chunks = -(-rows // _ROW_CHUNK)
            counts = device.empty((1, chunks), np.uint32, "counts")
            program["count_children"](children, counts, rows, chunks, count=chunks)
            (nodes,) = self._sum(counts)
            first_row = device.empty(rows, np.uint32, "first children")
            queue = device.empty(max(nodes, 1), np.uint32, "nodes of a level")
            program["list_children"](children, counts, queue, first_row, rows, chunks, count=chunks)
            levels.append(Level(children, first_row, device.empty((rows, 2), np.uint32, "sizes of subtrees")))
            rows = nodes
            if rows:
                children = device.empty((rows, 8), np.uint32, "children")
                program["open_nodes"](queue, binary.clusters, children, rows, n, count=rows)
            device.queue.finish()
            device.release(counts, queue)
            if not rows:
                device.release(binary.roots, binary.begins)
                return levels


def instance_records(geometry: Geometry, number: np.ndarray) -> np.ndarray:
    """Instance records without their trees. number: (i,) uint32, which of the scene's instances each is."""
    records = np.zeros(len(geometry.instance_mesh), STRUCTS["Instance"])
    mesh = geometry.instance_mesh
    records["to_world"] = geometry.to_world.reshape(-1, 12)
    records["to_object"] = geometry.to_object.reshape(-1, 12)
    records["low"], records["high"] = geometry.mesh_bounds.T[mesh, :3], geometry.mesh_bounds.T[mesh, 3:]
    records["first_triangle"] = geometry.first_triangle[mesh]
    records["number"] = number
    return records
