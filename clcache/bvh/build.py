"""Build the trees of a scene: one for each mesh, all in one go, and one over the instances (see `cl/bvh/build.cl`)."""

import time
from dataclasses import dataclass

import numpy as np
import pyopencl.array as cl_array

from ..device import Device
from ..layout import STRUCTS
from ..scene.geometry import Geometry, Merged, instance_bounds

# Triangles in a leaf; a tree over instances has one in each.
LEAF_SIZE = 4
# Work-items that share a round of the radix sort; each counts a run of keys of its own.
_CHUNKS = 64
_DIGIT_BITS = 8
_KEY_BITS = 64
_MORTON_AXIS_BITS = 21


@dataclass(frozen=True)
class Tree:
    """Nodes over segments of boxes. nodes: (max(n - 1, 0),) Node. order: (n,) uint32, the boxes in the tree's order.
    roots: (segments,) uint32, the root node of each segment with more than a leaf's worth of boxes."""

    nodes: cl_array.Array
    order: cl_array.Array
    roots: np.ndarray


class SceneTrees:
    """The trees of a scene's geometry on a device, and what traversal needs beside them. `seconds`: what the build took.

    moves: (i,) bool, which instances may be elsewhere at another time; none by default.

    Raises DeviceError if the build does not fit the device's memory.
    """

    def __init__(self, device: Device, scene: Geometry, moves: np.ndarray | None = None):
        self._device = device
        self._program = device.program("bvh/build.cl")
        start = time.perf_counter()
        moves = np.zeros(len(scene.instance_mesh), bool) if moves is None else moves
        self.merged = merged = Merged.of(scene, moves)
        geometry = merged.geometry
        n = len(geometry.triangles)
        begins = geometry.first_triangle
        segment = np.repeat(np.arange(len(begins) - 1, dtype=np.uint32), np.diff(begins))
        bytes_each = {
            "boxes": 24,
            "pyramid of boxes": 48,
            "segments": 4,
            "keys": 16,
            "order": 8,
            "nodes": 64,
            "leaves": 48,
        }
        device.check_fits("the build of the trees", {name: n * size for name, size in bytes_each.items()})

        positions = device.upload(geometry.positions, "positions")
        triangles = device.upload(geometry.triangles, "triangles")
        boxes = device.empty((6, n), np.float32, "triangle boxes")
        self._program["triangle_bounds"](positions, triangles, boxes, n, count=n)
        segments = device.upload(segment, "mesh of each triangle")
        tree = self._build(boxes, segments, geometry.mesh_bounds, begins, LEAF_SIZE)
        self.nodes = tree.nodes
        self.leaves = device.empty((n, 3, 4), np.float32, "leaf triangles")
        instance = device.upload(merged.instance, "instance of each triangle")
        primitive = device.upload(merged.primitive, "number of each triangle")
        self._program["gather_triangles"](
            positions, triangles, tree.order, instance, primitive, self.leaves, n, count=n
        )
        device.queue.finish()
        device.release(boxes, segments, instance, primitive, tree.order, positions, triangles)
        self._mesh_roots = tree.roots
        self._build_top()
        self.seconds = time.perf_counter() - start

    @property
    def nbytes(self) -> int:
        """What the trees take on the device, in bytes."""
        return sum(a.nbytes for a in self.arrays.values())

    @property
    def arrays(self) -> dict[str, cl_array.Array]:
        """What traversal reads, by the kernels' names."""
        names = ("top_nodes", "top_order", "nodes", "leaves", "placed", "bounds")
        return {name: getattr(self, name) for name in names}

    def move(self, scene: Geometry) -> None:
        """Rebuild the tree over the instances, whose transforms are now those of `scene`."""
        self._device.release(self.top_nodes, self.top_order, self.placed, self.bounds)
        self.merged = self.merged.at(scene)
        self._build_top()

    def _build_top(self) -> None:
        device, geometry = self._device, self.merged.geometry
        records = instance_records(geometry, self.merged.number)
        mesh = geometry.instance_mesh
        sizes = np.diff(geometry.first_triangle)[mesh]
        is_leaf = sizes <= LEAF_SIZE
        records["root"] = np.where(is_leaf, geometry.first_triangle[mesh], self._mesh_roots[mesh])
        records["root_count"] = np.where(is_leaf, sizes, 0)
        self.placed = device.upload(records, "placed meshes")
        low, high = instance_bounds(geometry)
        scene_bounds = np.concatenate([low.min(axis=0), high.max(axis=0)])
        boxes = device.upload(np.concatenate([low.T, high.T]), "instance boxes")
        segment = device.upload(np.zeros(len(low), np.uint32), "segment of each instance")
        begins = np.array([0, len(low)])
        tree = self._build(boxes, segment, scene_bounds[:, None], begins, leaf_size=1)
        device.queue.finish()
        device.release(boxes, segment)
        self.top_nodes, self.top_order = tree.nodes, tree.order
        self.top_root = int(tree.roots[0])
        self.bounds = device.upload(scene_bounds, "bounds of the scene")

    def _build(
        self, boxes: cl_array.Array, segment: cl_array.Array, bounds: np.ndarray, begins: np.ndarray, leaf_size: int
    ) -> Tree:
        """A tree over (6, n) boxes. bounds: (6, segments) float32. begins: (segments + 1,), the first box of each."""
        device, program = self._device, self._program
        n, segments = boxes.shape[1], len(begins) - 1
        segment_bits = max(segments - 1, 0).bit_length()
        axis_bits = min(_MORTON_AXIS_BITS, (_KEY_BITS - segment_bits) // 3)
        keys, order = device.empty(n, np.uint64, "keys"), device.empty(n, np.uint32, "order")
        segment_bounds = device.upload(bounds, "bounds of the meshes")
        program["morton_keys"](boxes, segment, segment_bounds, keys, order, n, segments, axis_bits, count=n)
        keys, order = self._sort(keys, order, 3 * axis_bits + segment_bits)

        pyramid = self._pyramid(boxes, order)
        starts = device.upload(begins.astype(np.uint32), "first boxes")
        nodes = device.empty(max(n - 1, 0), STRUCTS["Node"], "nodes")
        roots = device.upload(np.zeros(segments, np.uint32), "roots")
        entries = pyramid.shape[1]
        program["hierarchy"](
            keys, pyramid, segment, order, starts, nodes, roots, n, entries, leaf_size, count=max(n - 1, 0)
        )
        result = Tree(nodes, order, roots.get())
        device.release(keys, segment_bounds, pyramid, starts, roots)
        return result

    def _sort(self, keys: cl_array.Array, order: cl_array.Array, bits: int) -> tuple[cl_array.Array, cl_array.Array]:
        """Keys, and the order with them, sorted stably; the arrays given are spent."""
        device, program, n = self._device, self._program, keys.shape[0]
        chunks = min(_CHUNKS, n)
        counts = device.empty((1 << _DIGIT_BITS, chunks), np.uint32, "digit counts")
        spare_keys, spare_order = device.empty(n, np.uint64, "keys"), device.empty(n, np.uint32, "order")
        for shift in range(0, bits, _DIGIT_BITS):
            program["radix_count"](keys, counts, n, chunks, shift, count=chunks)
            program["radix_offsets"](counts, chunks, count=1)
            program["radix_scatter"](keys, order, counts, spare_keys, spare_order, n, chunks, shift, count=chunks)
            keys, spare_keys, order, spare_order = spare_keys, keys, spare_order, order
        device.queue.finish()
        device.release(counts, spare_keys, spare_order)
        return keys, order

    def _pyramid(self, boxes: cl_array.Array, order: cl_array.Array) -> cl_array.Array:
        """(6, entries): the boxes in sorted order, then level upon level of joined pairs."""
        n = boxes.shape[1]
        sizes = [n]
        while sizes[-1] > 1:
            sizes.append((sizes[-1] + 1) // 2)
        entries = sum(sizes)
        pyramid = self._device.empty((6, entries), np.float32, "pyramid of boxes")
        self._program["bounds_leaves"](boxes, order, pyramid, n, entries, count=n)
        start = 0
        for size, above in zip(sizes, sizes[1:], strict=False):
            self._program["bounds_level"](pyramid, entries, start, size, start + size, count=above)
            start += size
        return pyramid


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
