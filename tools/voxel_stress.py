"""Hammer a tiny table of voxels from all threads, and count what must not be.

python tools/voxel_stress.py [--operations N] [--threads N] [--capacity N] [--seed N]

The kernels of the method (clcache/cl/voxelhash/look_up.cl) look up random keys, far more of them than there are entries, insert and
claim; those that claimed write values that say whose they are; then random keys are read. Frames follow each other, of two eyes
each, in which ever other keys are asked for, so that entries die and are taken over; stamps wrap around on the way.
Whole keys stand beside the table. The exit code is 1 where anything was found that must not be.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pyopencl as cl
from measuring import exit_code, whole

from clcache import DeviceError, layout
from clcache.bench.job import DATA
from clcache.cli import Parser
from clcache.device import Device, fill
from clcache.passes.voxelhash import COUNTERS, Voxels, stamp, voxel_counts
from clcache.program import read_source
from clcache.resources import SceneResources
from clcache.scene import load_scene
from clcache.settings import resolve

NONE = 0xFFFFFFFF
RUN = 64  # operations of a work-item
BATCH = 2048  # operations of an eye's frame: so many insert, and so many read
KEYS, ASKED = 400, 50  # there are; are asked for in a frame
LIFETIME = 1  # frame
SOURCE = """
// A key as the three numbers of a radiance.
inline float4 value_of(ulong key)
{
    return (float4)((float)(key & 0x3FFFFF), (float)(key >> 22 & 0x3FFFFF), (float)(key >> 44), 1.0f);
}

inline bool is_value_of(float4 value, ulong key)
{
    float4 own = value_of(key);
    return value.x == own.x && value.y == own.y && value.z == own.z;
}

// found: [0] values of another key.
__kernel void write_values(__global const uint *shaded_voxel, __global const uint *stream, __global const ulong *key_of,
                           __global float *voxel_radiance, __global volatile uint *found, uint entries)
{
    uint i = get_global_id(0);
    if (i >= entries || shaded_voxel[i] == NONE) return;
    uint voxel = shaded_voxel[i];
    ulong key = key_of[stream[i]];
    float4 before = vload4(voxel, voxel_radiance), own = value_of(key);
    if (before.w > 0.0f && !is_value_of(before, key)) atomic_inc(found);
    own.w = before.w + 1.0f;
    vstore4(own, voxel, voxel_radiance);
}

// found: [0] values of another key, [1] keys that a search finds elsewhere or not at all, [2] keys that were found.
__kernel void read_values(__global const uint *place, __global const uint *check, __global const ulong *key_of,
                          __global const uint *expected, __global ulong *voxel_key, __global const float *voxel_radiance,
                          __global volatile uint *found, uint capacity, uint probe, uint stamp, int lifetime, uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Table table = { voxel_key, capacity, probe, stamp, lifetime };
    uint entry = find_entry(&table, place[i], check[i]);
    if (expected != 0 && entry != expected[i]) atomic_inc(found + 1);
    if (entry == NONE) return;
    atomic_inc(found + 2);
    if (!is_value_of(vload4(entry, voxel_radiance), key_of[i])) atomic_inc(found);
}
"""


@dataclass
class Totals:
    """What was done, and, from `foreign` on, what must not be: values of another key, keys that were there and are not found, keys that
    stand twice, claims that are not released, voxels with two winners or none, counters that do not add up."""

    operations: int = 0
    inserted: int = 0
    evicted: int = 0
    discarded: int = 0
    read: int = 0
    foreign: int = 0
    lost: int = 0
    twice: int = 0
    claims: int = 0
    winners: int = 0
    counters: int = 0

    @property
    def defects(self) -> int:
        """All that must not be."""
        names = [f.name for f in fields(self)]
        return sum(getattr(self, name) for name in names[names.index("foreign") :])


def build_beside(device: Device, source: str, file: str = "voxelhash/table.cl", **defines: int) -> cl.Program:
    """Kernels that call the functions of a source of the package."""
    text = "".join(f"#define {name} {value}\n" for name, value in defines.items())
    return cl.Program(device.context, text + layout.source() + read_source(file) + source).build(["-cl-std=CL1.2"])


class Hammer:
    """A table, keys, and the frames in which they meet."""

    def __init__(self, device: Device, capacity: int, probe: int, seed: int):
        self.device, self.capacity, self.probe = device, capacity, probe
        self.rng = np.random.default_rng(seed)
        self.full = self.rng.integers(2**63, size=KEYS, dtype=np.uint64)
        self.check = self.rng.choice(2**31, KEYS, replace=False).astype(np.uint32) + np.uint32(1)
        self.place = self.rng.integers(capacity, size=KEYS).astype(np.uint32)
        resources = SceneResources(device, load_scene(DATA / "cornell" / "scene.toml"))
        self.kernels = Voxels(device, resources, resolve({}, {}), False, voxel_counts()).program("look_up")
        own = build_beside(device, SOURCE)
        self.write_values, self.read_values = (cl.Kernel(own, name) for name in ("write_values", "read_values"))
        shapes = {
            "asked": BATCH, "asked_stream": BATCH, "voxel_place": BATCH, "voxel_check": BATCH, "voxel": BATCH,
            "shaded": BATCH, "stream": BATCH, "shaded_voxel": BATCH, "listed": 4, "counters": len(COUNTERS),
            "voxel_claim": capacity, "voxel_occupied": 1,
        }  # fmt: skip
        self.arrays = {name: device.upload(np.zeros(shape, np.uint32)) for name, shape in shapes.items()}
        self.arrays |= {
            "voxel_key": device.upload(np.zeros(capacity, np.uint64)),
            "voxel_radiance": device.upload(np.zeros((capacity, 4), np.float32)),
            "key_of": device.upload(np.zeros(BATCH, np.uint64)),
            "found": device.upload(np.zeros(4, np.uint32)),
        }
        order = np.arange(BATCH, dtype=np.uint32)
        self.set(asked=order, asked_stream=order[::-1].copy())
        self.pixels = order[::-1]
        self.totals = Totals()
        self.occupied = 0

    def set(self, **values: np.ndarray) -> None:
        """Write to arrays."""
        for name, value in values.items():
            self.arrays[name].set(value)

    def ask(self, keys: np.ndarray) -> None:
        """The list's entries ask for these keys, the pixels in the opposite order."""
        self.set(voxel_place=self.place[keys], voxel_check=self.check[keys])

    def run(self, name: str, count: int, **scalars: int) -> None:
        """A kernel of the method."""
        self.kernels[name].run(count, self.arrays, capacity=self.capacity, probe=self.probe, entries=BATCH, **scalars)

    def frame(self, update: int, eye: int, keys: np.ndarray) -> None:
        """An eye's frame. keys: of each of the list's entries."""
        now = stamp(type("State", (), {"update": update, "eye": eye}))
        before = self.arrays["voxel_key"].get()
        for name in ("listed", "counters"):
            fill(self.arrays[name], 0)
        self.ask(keys)
        self.run("look_up", BATCH // RUN, stamp=now, lifetime=2 * LIFETIME, update=update)
        self.run("list_claimed", BATCH // RUN, update=update)
        self.kernels["tally"].run(1, self.arrays, capacity=self.capacity)
        shaded = int(self.arrays["listed"].get()[1])
        self.write(keys, shaded)
        expected = self.arrays["voxel"].get()[self.pixels]
        self.read(keys, now, expected)
        others = self.rng.integers(KEYS, size=BATCH)
        self.read(others, now, None)
        self.run("release", BATCH)
        self.check_frame(keys, before, expected, now, shaded)

    def write(self, keys: np.ndarray, shaded: int) -> None:
        """Those that claimed write."""
        a = self.arrays
        key_of = np.empty(BATCH, np.uint64)
        key_of[self.pixels] = self.full[keys]
        self.set(key_of=key_of)
        names = ("shaded_voxel", "stream", "key_of", "voxel_radiance", "found")
        buffers = [a[name].base_data for name in names]
        self.write_values(self.device.queue, (BATCH,), None, *buffers, np.uint32(shaded))

    def read(self, keys: np.ndarray, now: int, expected: np.ndarray | None) -> None:
        """Search for keys, and look whose values their entries hold. expected: the entries, where these are known."""
        a = self.arrays
        self.ask(keys)
        self.set(key_of=self.full[keys])
        there = None if expected is None else self.device.upload(expected)
        buffers = [a[n].base_data for n in ("voxel_place", "voxel_check", "key_of")]
        buffers += [None if there is None else there.base_data]
        buffers += [a[n].base_data for n in ("voxel_key", "voxel_radiance", "found")]
        numbers = (
            np.uint32(self.capacity),
            np.uint32(self.probe),
            np.uint32(now),
            np.int32(2 * LIFETIME),
            np.uint32(BATCH),
        )
        self.read_values(self.device.queue, (BATCH,), None, *buffers, *numbers)
        self.device.queue.finish()
        if there is not None:
            self.device.release(there)
        foreign, lost, found, _ = a["found"].get().tolist()
        fill(a["found"], 0)
        self.totals.foreign += foreign
        self.totals.lost += lost
        self.totals.read += found

    def check_frame(self, keys: np.ndarray, before: np.ndarray, voxel: np.ndarray, now: int, shaded: int) -> None:
        """Count what must not be in an eye's frame. before: the table's keys. voxel: the entry of each of the list's."""
        totals, after = self.totals, self.arrays["voxel_key"].get()
        counted = dict(zip(COUNTERS, self.arrays["counters"].get().tolist(), strict=True))
        totals.operations += 2 * BATCH
        for name in ("inserted", "evicted", "discarded"):
            setattr(totals, name, getattr(totals, name) + counted[name])
        checks = after[after > 0] >> np.uint64(32)
        totals.twice += len(checks) - len(np.unique(checks))
        totals.claims += np.count_nonzero(self.arrays["voxel_claim"].get())
        # An entry that the first eye accessed in this frame is the second's to read only.
        accessed = np.unique(voxel[voxel != NONE])
        is_read_only = (
            (now % 2 == 0) & (before[accessed] > 0) & ((np.uint64(now) - before[accessed]) & np.uint64(NONE) == 1)
        )
        chosen = self.arrays["shaded_voxel"].get()[:shaded]
        winners = np.sort(chosen[chosen != NONE])
        totals.winners += not np.array_equal(winners, accessed[~is_read_only])
        totals.winners += int((chosen == NONE).sum() != (voxel == NONE).sum())
        totals.lost += int((after[accessed] & np.uint64(NONE) != now).sum())
        totals.lost += int((after[voxel[voxel != NONE]] >> np.uint64(32) != self.check[keys[voxel != NONE]]).sum())
        age = (np.uint64(now) - before) & np.uint64(NONE)
        made = np.flatnonzero((before == 0) & (after > 0)).size
        taken = np.flatnonzero((before > 0) & (age > 2 * LIFETIME) & (age < 2**31) & (after != before)).size
        sums = {
            "lookups": BATCH,
            "hits": BATCH - counted["inserted"] - counted["discarded"],
            "inserted": made + taken,
            "evicted": taken,
            "discarded": int((voxel == NONE).sum()),
            "occupied": np.count_nonzero(after),
            "capacity": self.capacity,
            "shaded": shaded,
        }
        totals.counters += sum(counted[name] != value for name, value in sums.items())


def stress(device: Device, operations: int, capacity: int = 64, probe: int = 4, seed: int = 0) -> Totals:
    """At least so many operations on a table of `capacity` entries."""
    hammer = Hammer(device, capacity, probe, seed)
    frames = -(-operations // (4 * BATCH))
    for number in range(frames):
        asked = hammer.rng.choice(KEYS, ASKED, replace=False)
        for eye in range(2):
            # Stamps wrap around half way.
            hammer.frame((2**31 - frames // 2 + number) % 2**32, eye, hammer.rng.choice(asked, BATCH))
    return hammer.totals


def measure(arguments: Sequence[str] | None) -> None:
    """Print what was counted. Raises SettingError, DeviceError."""
    parser = Parser(prog=Path(__file__).name, description=__doc__.splitlines()[0])
    parser.add_argument("--operations", type=whole(1), default=10**7)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--capacity", type=whole(1), default=64)
    parser.add_argument("--seed", type=whole(0), default=0)
    args = parser.parse_args(arguments)
    device = Device(threads=args.threads)
    totals = stress(device, args.operations, args.capacity, seed=args.seed)
    print(f"{device.threads} threads, {args.capacity} entries")
    for f in fields(totals):
        print(f"{f.name:12} {getattr(totals, f.name):12}")
    if totals.defects:
        raise DeviceError(f"{totals.defects} defects")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code, as of `clcache`."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
