"""Which cells of an octree's finest level a scene's triangles overlap (HashCache, section 3.1; `cl/octree/occupy.cl`).

A part of space, 1024^3 cells at most, has a bit for each of its cells: 128 MiB that all parts use in turn. Parts that no triangle's
box touches are skipped, and of the others only the segments (32^3 cells) in which bits were set are read.
"""

from dataclasses import dataclass

import numpy as np
import pyopencl.array as cl_array

from ..bvh.build import instance_records
from ..device import Device, fill
from ..errors import DeviceError
from ..layout import STRUCTS
from ..scene.geometry import Geometry
from .cube import cut_to, near_bounds

# As in cl/octree/shape.cl, occupy.cl and levels.cl.
PART_LEVEL = 10  # a part of space has at most 2^10 cells along an edge
MOST_LEVEL = 12
_GRID_BITS = 20
_SEGMENT_WORDS = 1024
# Triangles, and strips of their rows, that one work-item goes through in order.
_RUN = 256
_STRIPS = 16
_DEFINES = {"RUN": _RUN, "STRIPS": _STRIPS}
# By how much of a finest cell the cube is larger than the scene's bounds, below and above, so that floors and walls at the
# bounds do not lie where cells meet.
_BELOW, _ABOVE = 0.3183, 0.3817
_ROUNDOFF = 2.0**-24
# A hit point may be off by this part of a finest cell at most; where float32 is coarser, the octree has fewer levels.
_MOST_ERROR = 0.25
_SMALLEST = 1e-30  # metres, of a cube: its reciprocal is finite
CELL_BYTES = 24  # of a cell's data (cl/octree/cell.cl)
MOST_CELLS = (2**31 - 1) // 6  # kernels number the words of cells by int
# What each cell takes, at least: its data, its place in the tables, and the key from which they are built; bytes.
_BYTES_EACH = {"the cells' data": CELL_BYTES, "their tables": 8.8, "their keys": 4}

Parts = list[cl_array.Array | None]
"""Of each part of a level, the keys of its occupied cells, ascending: (cells,) uint32; None where it has none."""


@dataclass(frozen=True)
class Occupied:
    """The occupied cells of the finest level. shape: OctreeShape. margin: by which the cells were dilated, as a part of their
    edge."""

    shape: np.void
    parts: Parts
    margin: float


def parts_of(level: int) -> int:
    """How many parts of space a level has."""
    return 8 ** max(level - PART_LEVEL, 0)


def find_occupied(
    device: Device, geometry: Geometry, is_static: np.ndarray, resolution: int, eyes: np.ndarray | None = None
) -> Occupied:
    """The cells that the triangles of static instances overlap, each cell dilated by what the hit points of rays may be off.

    is_static: (instances,) bool. eyes: (k, 3), where the scene is seen from, if the cube is to leave out what lies far away
    (`cube.py`). resolution: cells along an edge, a power of two; halved until a cell is at least four times as
    large as hit points may be off. Every cell that a triangle overlaps is there, and none that its triangles miss by more
    than twice the dilation. Raises DeviceError where it does not fit.
    """
    finest, error = resolution.bit_length() - 1, hit_error(geometry, is_static)
    bounds = None if eyes is None else near_bounds(geometry, is_static, eyes, error / _MOST_ERROR * 2**finest)
    shape = None
    if bounds is not None:
        shape = choose_shape(*bounds, error, finest)
        geometry = cut_to(geometry, is_static, *_reach(shape, error))
        is_static = np.ones(len(geometry.instance_mesh), bool)
    records = instance_records(geometry, np.arange(len(geometry.instance_mesh)))[is_static]
    if not len(records):
        return Occupied(_shape(np.zeros(3), 1.0, finest), [None] * parts_of(finest), 0.0)
    triangles = np.diff(geometry.first_triangle)[geometry.instance_mesh[is_static]]
    return _Occupancy(device, geometry, records, triangles).find(error, finest, shape)


def hit_error(geometry: Geometry, is_static: np.ndarray) -> float:
    """How far, along an axis and in metres, hit points on static instances can be from their triangles as `occupy.cl` has them.

    Hit points (`cl/scene/surface.cl`) are interpolated: first corner + (u first edge + v second edge), where all but the last sum
    rounds numbers no larger than edges. Then they are transformed, as corners are: products and sums of numbers as large as the
    instance's size from its own origin, and one sum as large as the coordinates in the world. The identity is exact."""
    mesh, to_world = geometry.instance_mesh[is_static], geometry.to_world[is_static].astype(np.float64)
    low, high = (geometry.mesh_bounds.T[mesh, side].astype(np.float64) for side in (np.s_[:3], np.s_[3:]))
    matrix, offset = np.abs(to_world[:, :, :3]), np.abs(to_world[:, :, 3])
    largest = np.maximum(np.abs(low), np.abs(high))
    edges = np.broadcast_to((high - low).max(axis=1, keepdims=True), low.shape)
    interpolated, sizes = (np.einsum("ijk,ik->ij", matrix, v) for v in (largest + 12 * edges, largest))
    is_identity = (to_world == np.eye(3, 4)).all(axis=(1, 2))
    transformed = np.where(is_identity[:, None], 0.0, 2 * (3 * sizes + sizes + offset))
    return float((interpolated + transformed).max(initial=0.0)) * _ROUNDOFF


def _shape(origin: np.ndarray, size: float, finest: int) -> np.void:
    shape = np.zeros((), STRUCTS["OctreeShape"])
    shape["origin"], shape["size"], shape["finest"] = origin, size, finest
    return shape[()]


def choose_shape(low: np.ndarray, high: np.ndarray, error: float, finest: int) -> np.void:
    """The cube around bounds, low and high (3,), whose finest level is `finest`, or less where the error asks for larger cells; the cube
    itself is larger where the bounds are a few errors wide."""
    longest = max(float((high - low).max()), _SMALLEST, error / _MOST_ERROR)
    while finest and longest / 2**finest * _MOST_ERROR < error:
        finest -= 1
    size = longest / (1 - (_BELOW + _ABOVE) / 2**finest) if finest else longest * (1 + _BELOW + _ABOVE)
    return _shape(low - _BELOW * size / 2**finest, size, finest)


class _Occupancy:
    """Static triangles on a device, whose cells are found part by part."""

    def __init__(self, device: Device, geometry: Geometry, records: np.ndarray, triangles: np.ndarray):
        self._device, self._program = device, device.program("octree/occupy.cl", **_DEFINES)
        self._levels = device.program("octree/levels.cl", RUN=_RUN)
        first = np.concatenate([[0], np.cumsum(triangles)])
        self._n, self._runs = int(first[-1]), -(-int(first[-1]) // _RUN)
        if self._n >= 2**32:
            raise DeviceError(f"the octree: the scene has {self._n} triangles; at most {2**32 - 1} are possible")
        sizes = {
            "positions": geometry.positions.nbytes,
            "triangles": geometry.triangles.nbytes,
            "corners": 36 * self._n,
        }
        device.check_fits("finding the octree's cells", sizes)
        self._scene = {
            "positions": device.upload(geometry.positions, "positions"),
            "triangles": device.upload(geometry.triangles, "triangles"),
            "placed": device.upload(records, "placed meshes"),
            "first": device.upload(first.astype(np.uint32), "first triangles"),
        }

    def find(self, error: float, finest: int, shape: np.void | None) -> Occupied:
        """error: as of `hit_error`. shape: of the cube; that around all triangles where None."""
        shape = choose_shape(*self._bounds(), error, finest) if shape is None else shape
        shift, margin = _GRID_BITS - int(shape["finest"]), _margin(shape, error)
        device, finest = self._device, int(shape["finest"])
        corners = device.empty((9, self._n), np.int32, "corners")
        self._run("place_corners", self._scene, corners=corners, shape=shape, meshes=self._meshes)
        last = 2 ** min(finest, PART_LEVEL) - 1
        words = max((last + 1) ** 3 // 32, _SEGMENT_WORDS)
        bits = device.empty(words, np.uint32, "bits of cells")
        touched = device.empty(words // _SEGMENT_WORDS, np.uint32, "touched segments")
        fill(bits, 0)
        device.queue.finish()
        device.release(*self._scene.values())
        arrays = {"corners": corners, "bits": bits, "touched": touched}
        parts: Parts = []
        for part in range(parts_of(finest)):
            where = {"part": part, "shift": shift, "margin": margin, "last": last}
            is_touched = self._mark(arrays, where)
            cells = sum(p.size for p in parts if p is not None)
            parts.append(self._list(bits, touched, cells, finest) if is_touched else None)
        device.release(corners, bits, touched)
        return Occupied(shape, parts, margin / 2**shift)

    @property
    def _meshes(self) -> int:
        return self._scene["placed"].size

    def _run(self, kernel: str, arrays: dict[str, cl_array.Array], **others: object) -> None:
        """A kernel over the runs of triangles."""
        self._program[kernel].run(self._runs, arrays, n=self._n, runs=self._runs, **others)

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Low and high of all triangles in world space, (3,) float64."""
        bounds = self._device.empty((self._runs, 6), np.float32, "bounds")
        self._run("bound_triangles", self._scene, bounds=bounds, meshes=self._meshes)
        values = bounds.get().astype(np.float64)
        self._device.release(bounds)
        return values[:, :3].min(axis=0), values[:, 3:].max(axis=0)

    def _mark(self, arrays: dict[str, cl_array.Array], where: dict[str, int]) -> bool:
        """Set the bits of a part's cells; False if no triangle's box touches it."""
        device = self._device
        counts = device.empty(self._runs, np.uint32, "counts")
        self._run("count_strips", arrays, counts=counts, **where)
        offsets, count = offsets_of(device, counts)
        if count:
            strips = device.empty((count, 2), np.uint32, "strips of triangles")
            self._run("list_strips", arrays, offsets=offsets, strips=strips, listed=count, **where)
            fill(arrays["touched"], 0)
            items = -(-count // _STRIPS)
            self._program["mark_cells"].run(items, arrays, strips=strips, n=self._n, listed=count, **where)
            device.queue.finish()
            device.release(strips)
        device.release(offsets)
        return count > 0

    def _list(self, bits: cl_array.Array, touched: cl_array.Array, before: int, finest: int) -> cl_array.Array | None:
        """The keys of the cells whose bits are set, which are cleared; None if there are none. before: how many cells the parts
        before this have."""
        device, segments = self._device, np.flatnonzero(touched.get()).astype(np.uint32)
        if not len(segments):
            return None
        listed = device.upload(segments, "segments")
        counts = device.empty(len(segments), np.uint32, "counts")
        self._levels["count_bits"](bits, listed, counts, len(segments), count=len(segments))
        offsets, cells = offsets_of(device, counts)
        check_cells(device, before + cells, finest)
        keys = device.empty(cells, np.uint32, "keys of cells")
        self._levels["list_cells"](bits, listed, offsets, keys, len(segments), cells, count=len(segments))
        device.queue.finish()
        device.release(listed, offsets)
        return keys


def check_cells(device: Device, cells: int, finest: int) -> None:
    """Raise DeviceError if an octree with this many cells, or more, does not fit, or they are too many to be numbered."""
    what = f"the octree at octree.resolution {2**finest}, of {cells} cells and more,"
    if cells > MOST_CELLS:
        raise DeviceError(f"{what} is too large; expected at most {MOST_CELLS}: a lower octree.resolution")
    device.check_fits(what, {name: int(size * cells) for name, size in _BYTES_EACH.items()})


def _margin(shape: np.void, error: float) -> int:
    """By how many steps of the grid cells are dilated: what hit points are off; for rounding to the grid, in float32, three
    quarters of a step; and a quarter for that of a point's place in the cube (`cl/octree/shape.cl`)."""
    return int(np.ceil(error / float(shape["size"]) * 2**_GRID_BITS)) + 1


def _reach(shape: np.void, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Low and high, (3,) float64, of what a dilated cube holds."""
    origin, size = shape["origin"].astype(np.float64), float(shape["size"])
    room = _margin(shape, error) * size / 2**_GRID_BITS
    return origin - room, origin + size + room


def offsets_of(device: Device, counts: cl_array.Array) -> tuple[cl_array.Array, int]:
    """Exclusive prefix sums, and their total; the counts are released."""
    ends = np.cumsum(counts.get(), dtype=np.int64)
    device.release(counts)
    total = int(ends[-1])
    if total >= 2**32:
        raise DeviceError(f"the octree: {total} of a kind are more than the {2**32 - 1} that can be numbered")
    return device.upload((ends - np.diff(ends, prepend=0)).astype(np.uint32), "offsets"), total
