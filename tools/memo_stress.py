"""Hammer a tiny table of what graphs returned from all threads, and count what must not be.

python tools/memo_stress.py [--lookups N] [--threads N] [--capacity N] [--probe N] [--read key|counter] [--eviction NAME ...] [--seed N]

Work-items look up random keys as the caches do (clcache/cl/memo/table.cl, values.cl): find, read, or else lock, write and publish; far
more keys than there are entries. Values say whose they are, and reading and writing one takes its time. What is read from an entry must be its key's; with memo.read=key it
may be another's now and then, which is counted (MaterialMemo, section 5.3.4). After each launch no entry may be locked, no
key stand twice, all values be their keys' own, and counters add up. Stamps wrap around on the way. The exit code is 1 where
anything was found that must not be.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from measuring import exit_code, table, whole

from clcache import DeviceError
from clcache.cli import Parser
from clcache.device import Device
from clcache.passes.materials import COUNTERS
from clcache.settings import SETTINGS

EVICTIONS = SETTINGS["memo.eviction"].choices
READS = SETTINGS["memo.read"].choices
KEYS = 24
RUN = 64  # lookups of a work-item
LAUNCH = 4096  # work-items
CHANNELS = 15  # of a value, as many as a graph can have
WAIT = 2000  # reads of a word, in the middle of reading and of writing a value: others get there meanwhile
FIRST_KEY = 3  # of those that mean a check hash
SOURCE = """
#include "memo/key.cl"
#include "memo/values.cl"

inline float channel_of(uint key, uint c)
{
    return (float)(pcg_hash(key * GRAPH_CHANNELS + c) >> 8);
}

inline uint check_of(uint key)
{
    return max(pcg_hash(key), KEYS_FROM);
}

// Wait a while, where the compiler cannot move it.
inline void wait(__global volatile uint *word)
{
    for (uint k = 0; k < WAIT; k++) *word;
}

inline bool is_value_of(const float *values, uint key)
{
    bool is_own = true;
    for (uint c = 0; c < GRAPH_CHANNELS; c++) is_own = is_own && values[c] == channel_of(key, c);
    return is_own;
}

// found: [0] values read that are another key's, [1] values at rest that are, [2] keys that stand in two places, [3] locked entries,
// [4] entries with a value.
__kernel void hammer(
    __global volatile uint *records,   // (capacity, stride)
    __global volatile ulong *clock,    // (1)
    __global volatile uint *counters,  // (counters)
    __global volatile uint *found,     // (5)
    uint capacity,
    uint probe,
    uint places,
    uint keys,
    uint stamp,
    uint seed,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Table table = { records, clock, capacity, probe, stamp };
    MemoCounts counts = { 0, 0, 0, 0, 0, 0, 0, 0, 0 };
    uint foreign = 0;
    for (uint k = 0; k < RUN; k++) {
        uint draw = pcg_hash(i * RUN + k ^ pcg_hash(seed)), key = draw % keys, check = check_of(key);
        uint place = pcg_hash(check ^ 0x68E31DA4u) % places;
        float values[GRAPH_CHANNELS];
        uint entry = find_entry(&table, place, check);
        bool is_hit = false;
        counts.lookups++;
        if (entry != NONE) {
            uint version = begin_reading(&table, entry);
            load_values(value_words(&table, entry), values);
            bool is_own = is_value_of(values, key);
            wait(found);
            load_values(value_words(&table, entry), values);
            is_own = is_own && is_value_of(values, key);
            is_hit = is_unchanged(&table, entry, check, version);
            foreign += is_hit && !is_own ? 1 : 0;
        }
        if (is_hit) {
            counts.hits++;
            touch(&table, entry, &counts);
            continue;
        }
        counts.built++;
        for (uint c = 0; c < GRAPH_CHANNELS; c++) values[c] = channel_of(key, c);
        entry = lock_entry(&table, place, check, draw, &counts);
        if (entry == NONE) continue;
        float unfinished[GRAPH_CHANNELS] = { 0 };
        store_values(value_words(&table, entry), unfinished);
        wait(found);
        store_values(value_words(&table, entry), values);
        publish_entry(&table, place, entry, check, &counts);
    }
    add_counts(counters, &counts);
    if (foreign > 0) atomic_add(found, foreign);
}

// Of each key: where it stands, and with what value; by one work-item, when all others are through.
__kernel void look_over(
    __global volatile uint *records,  // (capacity, stride)
    __global volatile uint *found,    // (5)
    uint capacity,
    uint keys)
{
    if (get_global_id(0) > 0) return;
    Table table = { records, 0, capacity, 1, 0 };
    for (uint key = 0; key < keys; key++) {
        uint copies = 0;
        for (uint entry = 0; entry < capacity; entry++) {
            if (record_of(&table, entry)[0] != check_of(key)) continue;
            float values[GRAPH_CHANNELS];
            load_values(value_words(&table, entry), values);
            found[1] += is_value_of(values, key) ? 0 : 1;
            copies++;
        }
        found[2] += copies > 1 ? 1 : 0;
        found[4] += copies;
    }
    for (uint entry = 0; entry < capacity; entry++) found[3] += record_of(&table, entry)[0] == LOCKED ? 1 : 0;
}
"""


@dataclass
class Totals:
    """What was done; `foreign`, values that were read and are another key's; and, from `wrong` on, what must not be: the same of values
    at rest, keys that stand twice, entries that stay locked, counters that do not add up."""

    lookups: int = 0
    hits: int = 0
    inserted: int = 0
    evicted: int = 0
    discarded: int = 0
    duplicates: int = 0
    foreign: int = 0
    wrong: int = 0
    twice: int = 0
    locked: int = 0
    counters: int = 0

    @property
    def defects(self) -> int:
        """All that must not be, whatever the protocol."""
        names = [f.name for f in fields(self)]
        return sum(getattr(self, name) for name in names[names.index("wrong") :])


def stress(
    device: Device,
    lookups: int,
    capacity: int = 16,
    probe: int = 4,
    eviction: str = "lru-frame",
    read: str = "counter",
    seed: int = 0,
    keys: int = KEYS,
) -> Totals:
    """At least so many lookups, of so many keys, in a table of `capacity` entries."""
    probe = min(probe, capacity)
    words = 6 if eviction.endswith("counter") else 4
    defines = {
        "EVICTION": EVICTIONS.index(eviction), "READ_COUNTER": int(read == "counter"), "RECORD_WORDS": words,
        "RECORD_STRIDE": -(-(words + CHANNELS) // 2) * 2, "GRAPH_CHANNELS": CHANNELS, "VALUE_WORDS": CHANNELS, "HALF": 0, "RUN": RUN, "WAIT": WAIT,
        "HAS_NORMALS": 0,
    }  # fmt: skip
    program = device.program("memo_stress.cl", {"memo_stress.cl": SOURCE}, **defines)
    zeros = {"records": (capacity, defines["RECORD_STRIDE"]), "counters": len(COUNTERS), "found": 5}
    arrays = {name: device.upload(np.zeros(shape, np.uint32)) for name, shape in zeros.items()}
    arrays["clock"] = device.upload(np.zeros(1, np.uint64))
    totals, occupied = Totals(), COUNTERS.index("occupied")
    launches = -(-lookups // (RUN * LAUNCH))
    for number in range(launches):
        counted = np.zeros(len(COUNTERS), np.uint32)
        counted[occupied] = arrays["counters"].get()[occupied]
        arrays["counters"].set(counted)
        arrays["found"].set(np.zeros(5, np.uint32))
        stamp, size = (2**32 - launches // 2 + number) % 2**32, {"capacity": capacity, "keys": keys}
        places = max(capacity - probe, 1)
        program["hammer"].run(
            LAUNCH, arrays, probe=probe, places=places, stamp=stamp, seed=seed + number, n=LAUNCH, **size
        )
        program["look_over"].run(1, arrays, **size)
        _add(
            totals, dict(zip(COUNTERS, arrays["counters"].get().tolist(), strict=True)), arrays["found"].get().tolist()
        )
    device.release(*arrays.values())
    return totals


def _add(totals: Totals, counted: dict[str, int], found: Sequence[int]) -> None:
    """What a launch counted, and what was found in and after it."""
    for name in ("lookups", "hits", "inserted", "evicted", "discarded", "duplicates"):
        setattr(totals, name, getattr(totals, name) + counted[name])
    for name, count in zip(("foreign", "wrong", "twice", "locked"), found, strict=False):
        setattr(totals, name, getattr(totals, name) + count)
    missed = counted["lookups"] - counted["hits"]
    inserted_or_not = counted["inserted"] + counted["discarded"]
    add_up = (
        counted["lookups"] == RUN * LAUNCH,
        counted["built"] == missed,
        inserted_or_not <= missed <= inserted_or_not + counted["duplicates"],
        counted["occupied"] == found[4],
    )
    totals.counters += add_up.count(False)


def measure(arguments: Sequence[str] | None) -> None:
    """Print what was counted. Raises DeviceError."""
    parser = Parser(prog=Path(__file__).name, description=__doc__.splitlines()[0])
    parser.add_argument("--lookups", type=whole(1), default=10**7)
    parser.add_argument("--threads", type=whole(1))
    parser.add_argument("--capacity", type=whole(1), default=16)
    parser.add_argument("--probe", type=whole(1), default=4)
    parser.add_argument("--keys", type=whole(1), default=KEYS)
    parser.add_argument("--read", choices=READS, nargs="+", default=READS)
    parser.add_argument("--eviction", choices=EVICTIONS, nargs="+", default=EVICTIONS)
    parser.add_argument("--seed", type=whole(0), default=0)
    args = parser.parse_args(arguments)
    device = Device(threads=args.threads)
    rows, defects = [], 0
    for read in args.read:
        for eviction in args.eviction:
            found = stress(device, args.lookups, args.capacity, args.probe, eviction, read, args.seed, args.keys)
            rows.append([f"{read} {eviction}", *(str(getattr(found, f.name)) for f in fields(found))])
            defects += found.defects + (found.foreign if read == "counter" else 0)
    print(f"{device.threads} threads, {args.capacity} entries, {args.keys} keys")
    print(table(["read, eviction", *(f.name for f in fields(Totals))], rows))
    if defects:
        raise DeviceError(f"{defects} defects")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code, as of `clcache`."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
