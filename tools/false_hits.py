"""Count the lookups in a table of voxels that answer with the entry of another voxel, since their 32-bit check hashes are equal.

python tools/false_hits.py [--lookups N] [--bits N ...] [--capacity N ...] [--load PART ...] [--probe N] [--seed N] [--threads N]

Keys are voxels as scenes have them, half of them on planes of all sides at several levels, half of them scattered. They fill a
table, addressed as the method does (clcache/cl/voxelhash/address.cl), up to a load; which voxel each entry is of stands
beside it, whole. Then voxels are looked up, those that are there and others. Each row: the load, by what is asked for; how many
entries of other voxels a search compared on its way; the false hits, and how many are to be expected of hashes of so many bits
that are independent: those comparisons / 2^bits. `insert` are voxels that found another's entry when they were to get one.
With fewer bits the hashes are cut off, so that there is something to count.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyopencl as cl
from measuring import exit_code, whole
from voxel_stress import build_beside

from clcache import SettingError
from clcache.cli import Parser
from clcache.device import Device

TILE = 16
RUN = 64  # keys of a work-item
LAUNCH = 1 << 23  # keys
ABSENT = 1 << 28  # what is added to a key's number: none of these is in a table
STAMP, LIFETIME = 1, 1000
HIGHEST_BITS = 32
SOURCE = """
// The voxel of a number: even ones side by side on planes, odd ones scattered.
inline Voxel voxel_of(uint number, uint seed, uint blocks, uint mask)
{
    uint half_of = number >> 1, plane = half_of >> 18;
    Words drawn = pcg4d(number, seed, 0x51ED270Bu, 1);
    bool is_scattered = number & 1;
    int level = -10 + (int)((is_scattered ? drawn.w >> 3 : plane) % 6);
    uint side = (is_scattered ? drawn.w & 7 : plane / 6) % 6;
    float u = (float)(is_scattered ? (int)(drawn.x >> 11) - (1 << 20) : (int)(half_of & 511) - 200);
    float v = (float)(is_scattered ? (int)(drawn.y >> 11) - (1 << 20) : (int)(half_of >> 9 & 511) - 300);
    float layer = (float)(is_scattered ? (int)(drawn.z >> 11) - (1 << 20) : (int)(plane / 36) * 3 - 20);
    float along = side & 1 ? -1.0f : 1.0f, edge = edge_of(level);
    u = (u + 0.5f) * edge;
    v = (v + 0.5f) * edge;
    layer = (layer + 0.5f - LAYER_OFFSET) * edge;
    Vec3 x = vec3(layer, u, v), y = vec3(u, layer, v), z = vec3(u, v, layer);
    Vec3 normal = vec3(side / 2 == 0 ? along : 0.0f, side / 2 == 1 ? along : 0.0f, side / 2 == 2 ? along : 0.0f);
    Voxel voxel = voxel_at(side / 2 == 0 ? x : side / 2 == 1 ? y : z, normal, level, 0, blocks);
    voxel.check &= mask;
    voxel.check = voxel.check > 0 ? voxel.check : 1;
    return voxel;
}

// counts: [0] inserted, [1] found another's entry, [2] discarded.
__kernel void insert(__global ulong *keys, __global uint *owner, __global volatile uint *counts, uint capacity, uint probe, uint mask,
                     uint seed, uint begin, uint end)
{
    uint first = begin + get_global_id(0) * RUN, count[3] = { 0, 0, 0 };
    Table table = { keys, capacity, probe, STAMP, LIFETIME };
    for (uint number = first; number < min(first + RUN, end); number++) {
        Voxel voxel = voxel_of(number, seed, capacity / TILE, mask);
        Outcome outcome;
        uint entry = find_or_insert(&table, voxel.place, voxel.check, &outcome);
        if (outcome == INSERTED) owner[entry] = number;
        count[outcome == INSERTED ? 0 : outcome == HIT ? 1 : 2]++;
    }
    for (uint k = 0; k < 3; k++)
        if (count[k]) atomic_add(counts + k, count[k]);
}

// counts: [0] found, [1] of these another's, [2] entries of other voxels that were compared.
__kernel void look_up(__global ulong *keys, __global const uint *owner, __global volatile uint *counts, uint capacity, uint probe, uint mask,
                      uint seed, uint begin, uint end, uint inserted, uint absent)
{
    uint first = begin + get_global_id(0) * RUN, count[3] = { 0, 0, 0 };
    Table table = { keys, capacity, probe, STAMP, LIFETIME };
    Voxel voxel[RUN];
    uint asked[RUN];
    for (uint k = 0; k < RUN; k++) {
        asked[k] = (uint)((ulong)pcg4d(first + k, seed, 0x2C1B3C6Du, 7).x * (absent ? absent : inserted) >> 32) + absent;
        voxel[k] = voxel_of(asked[k], seed, capacity / TILE, mask);
    }
    for (uint k = 0; k < RUN && first + k < end; k++) {
        uint entry = find_entry(&table, voxel[k].place, voxel[k].check), place = voxel[k].place;
        count[0] += entry != NONE ? 1 : 0;
        bool is_false = entry != NONE && owner[entry] != asked[k];
        count[1] += is_false ? 1 : 0;
        count[2] += is_false ? 1 : 0;
        for (uint step = 0; step < probe && place != entry && keys[place] != EMPTY; step++, place = next_place(&table, place))
            count[2]++;
    }
    for (uint k = 0; k < 3; k++)
        if (count[k]) atomic_add(counts + k, count[k]);
}
"""


class Filled:
    """A table that holds as many voxels as its load says, but for those that found no place."""

    def __init__(self, device: Device, capacity: int, load: float, probe: int, bits: int, seed: int):
        self.device, self.keys_inserted = device, int(load * capacity)
        defines = {"LOD_BY_INCIDENCE": 0, "RUN": RUN, "STAMP": STAMP, "LIFETIME": LIFETIME}
        program = build_beside(device, SOURCE, "voxelhash/address.cl", **defines)
        self.insert, self.look_up = (cl.Kernel(program, name) for name in ("insert", "look_up"))
        self.keys = device.upload(np.zeros(capacity, np.uint64))
        self.owner = device.upload(np.full(capacity, 0xFFFFFFFF, np.uint32))
        self.numbers = [np.uint32(n) for n in (capacity, probe, 2**bits - 1, seed)]
        _, self.false_inserts, self.discarded = self._count(self.insert, self.keys_inserted)

    def _count(self, kernel: cl.Kernel, length: int, *more: int) -> tuple[int, int, int]:
        total = np.zeros(3, np.int64)
        counts = self.device.upload(np.zeros(3, np.uint32))
        buffers = [array.base_data for array in (self.keys, self.owner, counts)]
        for begin in range(0, length, LAUNCH):
            end = min(begin + LAUNCH, length)
            more_numbers = [np.uint32(n) for n in (begin, end, *more)]
            items = -(-(end - begin) // RUN)
            kernel(self.device.queue, (items,), None, *buffers, *self.numbers, *more_numbers)
            total += counts.get()
            counts.fill(0)
        self.device.release(counts)
        return tuple(int(n) for n in total)

    def lookups(self, count: int, are_there: bool) -> tuple[int, int, int]:
        """Of so many lookups: found, false, entries of other voxels compared."""
        return self._count(self.look_up, count, self.keys_inserted, 0 if are_there else ABSENT)

    def release(self) -> None:
        """Give the table back."""
        self.device.release(self.keys, self.owner)


def measure(arguments: Sequence[str] | None) -> None:
    """Print a row for each table and each kind of lookup. Raises SettingError, DeviceError."""
    parser = Parser(prog=Path(__file__).name, description=__doc__.splitlines()[0])
    parser.add_argument("--lookups", type=whole(1), default=10**8)
    parser.add_argument("--bits", type=whole(1), nargs="+", default=[32, 16])
    parser.add_argument("--capacity", type=whole(TILE), nargs="+", default=[2**21, 2**24])
    parser.add_argument("--load", type=float, nargs="+", default=[0.25, 0.5, 0.9])
    parser.add_argument("--probe", type=whole(1), default=8)
    parser.add_argument("--seed", type=whole(0), default=0)
    parser.add_argument("--threads", type=int)
    args = parser.parse_args(arguments)
    if not all(0 < load <= 1 for load in args.load) or not max(args.bits) <= HIGHEST_BITS:
        raise SettingError(f"--load {args.load} --bits {args.bits}: expected 0 .. 1 and 1 .. {HIGHEST_BITS}")
    if max(args.capacity) > ABSENT or args.lookups >= 2**32:
        raise SettingError(
            f"--capacity {max(args.capacity)} --lookups {args.lookups}: expected up to {ABSENT} and 2^32"
        )
    device = Device(threads=args.threads)
    print(f"{args.lookups:.0e} lookups a row, up to {args.probe} places each")
    columns = ("entries", "bits", "load", "discarded", "asked", "found", "compared", "false", "expected", "seconds")
    print(" ".join(f"{name:>11}" for name in columns))
    for capacity in args.capacity:
        for bits in args.bits:
            for load in args.load:
                _measure_table(device, args, capacity, bits, load)


def _measure_table(device: Device, args, capacity: int, bits: int, load: float) -> None:
    table = Filled(device, capacity, load, args.probe, bits, args.seed)
    lost = table.discarded / table.keys_inserted

    def row(asked: str, found: str, compared: str, false: int, expected: str, seconds: str) -> None:
        head = f"{capacity:11} {bits:11} {load:11.2f} {100 * lost:10.3f}%"
        print(head, f"{asked:>11} {found:>11} {compared:>11} {false:11} {expected:>11} {seconds:>11}", flush=True)

    row("insert", "", "", table.false_inserts, "", "")
    for asked in ("present", "absent"):
        start = time.perf_counter()
        found, false, compared = table.lookups(args.lookups, asked == "present")
        per_lookup, expected = compared / args.lookups, compared / 2**bits
        share = f"{100 * found / args.lookups:.4f}%"
        row(asked, share, f"{per_lookup:.4f}", false, f"{expected:.4g}", f"{time.perf_counter() - start:.2f}")
    table.release()


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code, as of `clcache`."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
