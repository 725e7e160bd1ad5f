"""The table of the caches of graphs and its keys on a device, through kernels that only call the package's functions."""

from collections.abc import Sequence

import numpy as np
from memo_model import COUNTERS, EVICTIONS

from clcache.device import Device

FIND, ACCESS, LOCK, PUBLISH = range(4)
WORDS_BY_COUNTER = 6  # of a record, with the clock's
TABLE = """
#include "memo/table.cl"

// what: 0 find, 1 look up as the caches do, 2 lock, 3 publish what operation `of` locked.
__kernel void in_turn(
    __global const uint *what,        // (n)
    __global const uint *place,       // (n)
    __global const uint *check,       // (n)
    __global const uint *stamp,       // (n)
    __global const uint *draw,        // (n)
    __global const uint *of,          // (n)
    __global volatile uint *records,  // (capacity, stride)
    __global volatile ulong *clock,   // (1)
    __global uint *counters,          // (counters)
    __global uint *entry,             // (n)
    uint capacity,
    uint probe,
    uint n)
{
    if (get_global_id(0) > 0) return;
    MemoCounts counts = { 0, 0, 0, 0, 0, 0, 0, 0, 0 };
    for (uint i = 0; i < n; i++) {
        Table table = { records, clock, capacity, probe, stamp[i] };
        if (what[i] == 2) {
            entry[i] = lock_entry(&table, place[i], check[i], draw[i], &counts);
        } else if (what[i] == 3) {
            entry[i] = entry[of[i]];
            if (entry[i] != NONE) publish_entry(&table, place[i], entry[i], check[i], &counts);
        } else {
            entry[i] = find_entry(&table, place[i], check[i]);
            if (what[i] == 0) continue;
            counts.lookups++;
            if (entry[i] != NONE) {
                counts.hits++;
                touch(&table, entry[i], &counts);
            } else {
                uint locked = lock_entry(&table, place[i], check[i], draw[i], &counts);
                if (locked != NONE) publish_entry(&table, place[i], locked, check[i], &counts);
            }
        }
    }
    add_counts(counters, &counts);
}
"""
KEYS = """
#include "memo/tile_key.cl"

GraphHit hit_of(__global const float *inputs, uint n, uint i)
{
    GraphHit hit;
    hit.uv.u = inputs[i];
    hit.uv.v = inputs[n + i];
    hit.uv_x.u = inputs[2 * n + i];
    hit.uv_x.v = inputs[3 * n + i];
    hit.uv_y.u = inputs[4 * n + i];
    hit.uv_y.v = inputs[5 * n + i];
    hit.position = vec3(inputs[6 * n + i], inputs[7 * n + i], inputs[8 * n + i]);
    hit.position_x = vec3(inputs[9 * n + i], inputs[10 * n + i], inputs[11 * n + i]);
    hit.position_y = vec3(inputs[12 * n + i], inputs[13 * n + i], inputs[14 * n + i]);
    hit.normal = vec3(0.0f, 0.0f, 1.0f);
    return hit;
}

// numbers: level, level3 (words), u, v, x, y, z.
__kernel void texel_keys(
    __global const float *inputs,  // (15, n)
    __global const uint *graph,    // (n)
    __global const int *coarsest,  // (graphs, 2)
    __global uint *place,          // (n)
    __global uint *check,          // (n)
    __global int *numbers,         // (7, n)
    __global float *middle,        // (15, n)
    uint reads,
    float bias,
    uint places,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    GraphHit hit = hit_of(inputs, n, i);
    Key key = texel_key(&hit, graph[i], reads, bias, coarsest);
    GraphHit there = snapped(&hit, &key);
    place[i] = key.hash % places;
    check[i] = key.check;
    numbers[i] = (int)word_of(key.level);
    numbers[n + i] = (int)word_of(key.level3);
    numbers[2 * n + i] = key.u;
    numbers[3 * n + i] = key.v;
    numbers[4 * n + i] = key.x;
    numbers[5 * n + i] = key.y;
    numbers[6 * n + i] = key.z;
    middle[i] = there.uv.u;
    middle[n + i] = there.uv.v;
    middle[2 * n + i] = there.uv_x.u;
    middle[3 * n + i] = there.uv_x.v;
    middle[4 * n + i] = there.uv_y.u;
    middle[5 * n + i] = there.uv_y.v;
    Vec3 found[3] = { there.position, there.position_x, there.position_y };
    for (uint k = 0; k < 3; k++) {
        middle[(6 + 3 * k) * n + i] = found[k].x;
        middle[(7 + 3 * k) * n + i] = found[k].y;
        middle[(8 + 3 * k) * n + i] = found[k].z;
    }
}

__kernel void tile_keys(
    __global const float *inputs,  // (15, n)
    __global const uint *graph,    // (n)
    __global const int *coarsest,  // (graphs, 2)
    __global uint *place,          // (n)
    __global uint *check,          // (n)
    __global int *numbers,         // (3, n)
    __global float *within,        // (2, n)
    float bias,
    uint places,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    GraphHit hit = hit_of(inputs, n, i);
    TileKey tile = tile_key(&hit, graph[i], bias, coarsest);
    place[i] = tile.key.hash % places;
    check[i] = tile.key.check;
    numbers[i] = (int)word_of(tile.key.level);
    numbers[n + i] = tile.key.u;
    numbers[2 * n + i] = tile.key.v;
    within[i] = tile.within.u;
    within[n + i] = tile.within.v;
}

__kernel void remapped(
    __global const uint *number,  // (n)
    __global uint *check,         // (n)
    uint graph,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Level none = { COARSEST_LEVEL, COARSEST_LEVEL, 0 };
    Key key = { none, none, 0, 0, 0, 0, 0, 0, 0 };
    key.v = (int)number[i];
    finish_key(&key, graph, READS_UV);
    check[i] = key.check;
}
"""


def table_defines(eviction: str, read: str = "counter") -> dict[str, int]:
    """Of a table whose records have room for two words of values."""
    words = WORDS_BY_COUNTER if eviction.endswith("counter") else 4
    return {
        "EVICTION": EVICTIONS.index(eviction),
        "READ_COUNTER": int(read == "counter"),
        "RECORD_WORDS": words,
        "RECORD_STRIDE": words + 2,
    }


def run_source(device: Device, source: str, **defines: int):
    """The program of kernels that are written for a test."""
    return device.program("memo_test.cl", {"memo_test.cl": source}, **defines)


class OnDevice:
    """A table on the device, and operations of one work-item on it. guard: what stands behind its end."""

    GUARD = 0xABCDEF01

    def __init__(self, device: Device, capacity: int, probe: int, eviction: str):
        self.device, self.capacity = device, capacity
        defines = table_defines(eviction)
        self.kernel = run_source(device, TABLE, **defines)["in_turn"]
        self.scalars = {"capacity": capacity, "probe": probe}
        self.by_counter = eviction.endswith("counter")
        records = np.zeros((capacity, defines["RECORD_STRIDE"]), np.uint32)
        records[:, defines["RECORD_WORDS"] :] = self.GUARD  # values, which the table itself leaves alone
        self.arrays = {
            "records": device.upload(records),
            "clock": device.upload(np.zeros(1, np.uint64)),
            "counters": device.upload(np.zeros(len(COUNTERS), np.uint32)),
        }

    def run(self, operations: Sequence[tuple[int, ...]]) -> list[int]:
        """Of each of (what, place, check, stamp, draw, of): the entry."""
        names = ("what", "place", "check", "stamp", "draw", "of")
        columns = dict(zip(names, np.array(operations, np.uint64).astype(np.uint32).T, strict=True))
        uploaded = {name: self.device.upload(np.ascontiguousarray(values)) for name, values in columns.items()}
        entry = self.device.empty(len(operations), np.uint32)
        arrays = uploaded | self.arrays | {"entry": entry}
        self.kernel.run(1, arrays, n=len(operations), **self.scalars)
        return entry.get().tolist()

    @property
    def records(self) -> list[list[int]]:
        """As those of the model."""
        words = self.arrays["records"].get()
        values = words[:, WORDS_BY_COUNTER if self.by_counter else 4 :]
        assert (values == self.GUARD).all()
        clock = words[:, 4:6].copy().view(np.uint64)[:, 0] if self.by_counter else np.zeros(len(words), np.uint64)
        return [[*row[:4].tolist(), int(time)] for row, time in zip(words, clock, strict=True)]

    @property
    def clock(self) -> int:
        """Accesses so far that were counted."""
        return int(self.arrays["clock"].get()[0])

    @property
    def counters(self) -> dict[str, int]:
        """By name."""
        return dict(zip(COUNTERS, self.arrays["counters"].get().tolist(), strict=True))

    @property
    def keys(self) -> list[int]:
        """Of the entries that hold a value."""
        return [r[0] for r in self.records if r[0] > 2]
