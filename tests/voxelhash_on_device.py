"""The table of voxels and its addressing on a device, through kernels that only call the package's functions."""

from pathlib import Path

import numpy as np
from kernel_source import build
from render_helpers import view
from voxelhash_model import BLOCK

from clcache.device import Device
from clcache.program import Program
from clcache.renderer import camera_record

OUTCOMES = ("hit", "inserted", "evicted", "discarded")
FIND, INSERT = 0, 1
_TABLE = """
#include "voxelhash/table.cl"

__kernel void in_turn(
    __global const uint *what,     // (n)
    __global const uint *place,    // (n)
    __global const uint *check,    // (n)
    __global const uint *stamp,    // (n)
    __global ulong *keys,          // (capacity)
    __global uint *entry,          // (n)
    __global uint *outcome,        // (n)
    uint capacity,
    uint probe,
    int lifetime,
    uint n)
{
    if (get_global_id(0) > 0) return;
    for (uint i = 0; i < n; i++) {
        Table table = { keys, capacity, probe, stamp[i], lifetime };
        Outcome became = HIT;
        entry[i] = what[i] ? find_or_insert(&table, place[i], check[i], &became) : find_entry(&table, place[i], check[i]);
        outcome[i] = became;
        if (what[i] && became == HIT) touch(&table, entry[i]);
    }
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void at_once(
    __global const uint *what,     // (n)
    __global const uint *place,    // (n)
    __global const uint *check,    // (n)
    __global ulong *keys,          // (capacity)
    __global uint *entry,          // (n)
    __global uint *outcome,        // (n)
    uint capacity,
    uint probe,
    uint stamp,
    int lifetime,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Table table = { keys, capacity, probe, stamp, lifetime };
    Outcome became = HIT;
    entry[i] = what[i] ? find_or_insert(&table, place[i], check[i], &became) : find_entry(&table, place[i], check[i]);
    outcome[i] = became;
    if (what[i] && became == HIT) touch(&table, entry[i]);
}
"""
_ADDRESS = """
#include "voxelhash/address.cl"

__kernel void address(
    __global const float *points,   // (n, 3)
    __global const float *normals,  // (n, 3)
    __global const int *given,      // (n)
    __global const uint *dark,      // (n)
    __global int *level,            // (n)
    __global uint *place,           // (n)
    __global uint *check,           // (n)
    Camera camera,
    float factor,
    uint blocks,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    level[i] = level_at(&camera, row3(points, i), row3(normals, i), factor);
    Voxel voxel = voxel_at(row3(points, i), row3(normals, i), given[i], dark[i], blocks);
    place[i] = voxel.place;
    check[i] = voxel.check;
}
"""


def table_program(device: Device, folder: Path) -> Program:
    """folder: an empty one, that stays."""
    return build(device, _TABLE, folder)


class OnDevice:
    """A table on the device, and accesses to it."""

    def __init__(self, device: Device, program: Program, capacity: int, probe: int, lifetime: int):
        self.device, self.program = device, program
        self.scalars = {"capacity": capacity, "probe": probe, "lifetime": lifetime}
        self.array = self.device.upload(np.zeros(capacity, np.uint64))

    @property
    def keys(self) -> np.ndarray:
        """(capacity,) uint64."""
        return self.array.get()

    def _run(self, kernel, count, columns, **scalars):
        arrays = {name: self.device.upload(np.asarray(values, np.uint32)) for name, values in columns.items()}
        n = len(columns["what"])
        entry, outcome = (self.device.empty(n, np.uint32) for _ in range(2))
        arrays |= {"keys": self.array, "entry": entry, "outcome": outcome}
        self.program[kernel].run(count, arrays, n=n, **self.scalars, **scalars)
        return entry.get().tolist(), [OUTCOMES[o] for o in outcome.get()]

    def in_turn(self, operations):
        """Of each of (what, place, check, stamp): entry and outcome."""
        columns = zip(("what", "place", "check", "stamp"), zip(*operations, strict=True), strict=True)
        return self._run("in_turn", 1, dict(columns))

    def at_once(self, what, place, check, stamp):
        """The same, of arrays, all by work-items of their own."""
        return self._run("at_once", len(what), {"what": what, "place": place, "check": check}, stamp=stamp)


SIZE = (160, 90)
EYE = np.array([1.0, 2.0, -3.0])


class Addressing:
    """Voxels of points as the device finds them, for a camera of SIZE at EYE."""

    def __init__(self, device: Device, folder: Path):
        folders = {incidence: folder / str(incidence) for incidence in (False, True)}
        for f in folders.values():
            f.mkdir()
        self.device = device
        self.programs = {i: build(device, _ADDRESS, f, LOD_BY_INCIDENCE=i) for i, f in folders.items()}

    @property
    def camera(self) -> np.void:
        """The camera's record."""
        return camera_record(view(EYE, (0, 0, 0)), SIZE)

    @property
    def spread(self) -> float:
        """The width of a pixel at distance 1."""
        return 2 * self.camera["slope"][1] / SIZE[1]

    def __call__(
        self, points, normals, levels, capacity=2**21, incidence=True, factor=1.0, dark=0
    ) -> tuple[np.ndarray, ...]:
        """Levels; and, of voxels of the given levels, place and check."""
        device, program = self.device, self.programs[incidence]
        n = len(points)
        made = {
            name: device.empty(n, kind)
            for name, kind in (("level", np.int32), ("place", np.uint32), ("check", np.uint32))
        }
        arrays = {
            "points": device.upload(np.asarray(points, np.float32)),
            "normals": device.upload(np.asarray(normals, np.float32)),
            "given": device.upload(np.asarray(np.broadcast_to(levels, n), np.int32)),
            "dark": device.upload(np.asarray(np.broadcast_to(dark, n), np.uint32)),
        }
        program["address"].run(
            n, arrays, made, camera=self.camera, factor=factor, blocks=max(capacity // BLOCK, 1), n=n
        )
        return tuple(made[name].get() for name in ("level", "place", "check"))
