"""The device's own functions of octrees, for tests: find_cell (cl/octree/find.cl) and cell_key (cl/octree/shape.cl)."""

from collections.abc import Mapping

import numpy as np
import pyopencl.array as cl_array

from clcache.device import Device
from clcache.program import Program

NONE = 0xFFFFFFFF

_SOURCE = """
#include "octree/find.cl"

__kernel void find_cells(
    __global const ulong *keys,           // (n)
    __global uint *found,                 // (n)
    __global const ulong *octree_table,   // (entries)
    __global const uint *octree_tables,   // (tables, 4)
    uint level,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    CellTables tables = { octree_table, octree_tables };
    found[i] = find_cell(&tables, keys[i], level);
}

__kernel void cell_keys(
    __global const float *points,  // (3, n)
    __global ulong *keys,          // (n)
    __global float *edge,          // (1)
    OctreeShape shape,
    uint level,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    keys[i] = cell_key(&shape, load_vec3(points, n, i), level);
    if (i == 0) edge[0] = cell_edge(&shape, level);
}
"""


def _program(device: Device) -> Program:
    return device.program("octree_on_device.cl", {"octree_on_device.cl": _SOURCE})


def find_cells(device: Device, arrays: Mapping[str, cl_array.Array], keys: np.ndarray, level: int) -> np.ndarray:
    """(n,) uint32: what the device finds for keys of a level. arrays: as of `Octree`."""
    sent = device.upload(np.asarray(keys, np.uint64))
    found = device.empty(sent.size, np.uint32)
    _program(device)["find_cells"].run(sent.size, arrays, keys=sent, found=found, level=level, n=sent.size)
    result = found.get()
    device.release(sent, found)
    return result


def cell_keys(device: Device, shape: np.void, points: np.ndarray, level: int) -> tuple[np.ndarray, np.float32]:
    """Keys (n,) uint64 of the cells that the device puts points (n, 3) into, and the length of their edges."""
    n = len(points)
    sent = device.upload(np.asarray(points, np.float32).T)
    keys, edge = device.empty(n, np.uint64), device.empty(1, np.float32)
    _program(device)["cell_keys"](sent, keys, edge, shape, level, n, count=n)
    result = keys.get(), edge.get()[0]
    device.release(sent, keys, edge)
    return result
