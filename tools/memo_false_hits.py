"""Count the keys of a scene's material graphs that the hash table of their values takes for each other, since hashes are equal.

python tools/memo_false_hits.py --scene FILE [--frames A:B] [--size WxH] [--bits N ...] [--capacity N] [--probe N] [--seed N] [--threads N]

Frames are rendered with a cache of texels (clcache/cl/memo), and the whole keys of all hits are recorded: graph, level and texel,
hashed as the cache does. A row for each number of bits to which check hashes are cut, so that there is something to count with fewer than
the table's 32: pairs of different keys with the same check hash; how many of those are near enough in the table for one to be
found in place of the other; and how many of either are to be expected of hashes that are independent, of n keys
n (n - 1) / 2^(bits + 1), and that times (2 probe - 1) / places. What a lookup's risk is follows: the false hits among as many keys as
the table can hold.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from measuring import add_frames, add_machine, exit_code, frame_range, size, table, whole

from clcache import Renderer, SettingError
from clcache.cli import Parser
from clcache.passes import materials
from clcache.scene import load_scene

HIGHEST_BITS = 32
NUMBERS = 9  # of a key: graph, whether it is asked for, levels, and texels in five dimensions
SOURCE = """
#include "memo/hit.cl"
#include "memo/lookup.cl"
#include "pathtrace/queue.cl"

__kernel void whole_keys(
    __global const float *positions,      // (vertices, 3)
    __global const uint *triangles,       // (triangles, 3)
    __global const float *normals,        // (vertices, 3) or null
    __global const float *uvs,            // (vertices, 2)
    __global const Instance *instances,   // (instances)
    __global const uint *material,        // (triangles)
    __global const Material *materials,   // (materials)
    __global const uint *alive,           // (chunks)
    __global const float *hit_t,          // (n)
    __global const float *hit_uv,         // (2, n)
    __global const uint *hit_primitive,   // (n)
    __global const uint *hit_instance,    // (n)
    __global const float *ray_direction,  // (3, n)
    __global const float *ray_length,     // (n)
    __global const float *cone,           // (2, n)
    __global const uint *memo_mode,       // (graphs)
    __global const int *graph_coarsest,   // (graphs, 2)
    __global int *numbers,                // (9, n)
    __global uint *hash,                  // (2, n)
    float bias,
    uint light_only,
    uint first,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    numbers[n + i] = 0;
    if (i >= first || i % CHUNK >= alive[i / CHUNK]) return;
    Maps maps = { 0, 0, 0, 0 };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    Triangles scene = { positions, normals, masks };
    Hits hits = { hit_t, hit_uv, hit_primitive, hit_instance, ray_direction, ray_length, cone, n };
    int graph = graph_at(&scene, &hits, light_only, i);
    if (graph < 0) return;
    uint mode = memo_mode[graph];
    GraphHit hit = graph_hit_at(&scene, &hits, i);
    Key key = texel_key(&hit, (uint)graph, mode, bias, graph_coarsest);
    bool has_uv = (mode & READS_UV) != 0, has_position = (mode & READS_POSITION) != 0;
    int level = (int)word_of(key.level), level3 = (int)word_of(key.level3);
    int number[9] = { graph, mode & IS_MEMOIZED ? 1 : 0, level, key.u, key.v, level3, key.x, key.y, key.z };
    for (uint k = 0; k < 9; k++) numbers[k * n + i] = k < 2 || (k < 5 ? has_uv : has_position) ? number[k] : 0;
    hash[i] = key.hash;
    hash[n + i] = key.check;
}
"""


@dataclass
class Keys:
    """The different keys seen so far: numbers, (n, 9) int32, and hash and check, (n, 2) uint32; and how many hits asked for them."""

    rows: np.ndarray = field(default_factory=lambda: np.zeros((0, NUMBERS + 2), np.uint32))
    lookups: int = 0

    def add(self, numbers: np.ndarray, hashes: np.ndarray) -> None:
        """Those of a queue. numbers: (9, n). hashes: (2, n)."""
        asked = numbers[1] > 0
        rows = np.vstack([numbers.view(np.uint32), hashes]).T[asked]
        self.lookups += len(rows)
        self.rows = np.unique(np.vstack([self.rows, rows]), axis=0)


@contextmanager
def recorded(keys: Keys) -> Iterator[None]:
    """Meanwhile, all that caches of texels look up is added to the keys."""
    look_up = materials.MemoLookUp.run

    def run(self: materials.MemoLookUp, arrays: Mapping, state, places: int, light_only: int = 0) -> Iterator:
        yield from look_up(self, arrays, state, places, light_only)
        setup, n = self._setup, arrays["ray_length"].size
        made = {"numbers": setup.device.empty((NUMBERS, n), np.int32), "hash": setup.device.empty((2, n), np.uint32)}
        program = setup.device.program("memo_keys.cl", {"memo_keys.cl": SOURCE}, **setup.scene.defines)
        scalars = {"bias": setup.settings["memo.bias"], "light_only": light_only, "n": n, "first": places}
        program["whole_keys"].run(n, made, arrays, setup.scene.arrays, **scalars)
        keys.add(*(array.get() for array in made.values()))
        setup.device.release(*made.values())

    materials.MemoLookUp.run = run
    try:
        yield
    finally:
        materials.MemoLookUp.run = look_up


def false_pairs(check: np.ndarray, place: np.ndarray, probe: int) -> tuple[int, int]:
    """Pairs with the same check hash; those of them that are less than `probe` places apart. check, place: (n,) of different keys."""
    combined = np.sort(check.astype(np.uint64) << np.uint64(32) | place)
    _, counts = np.unique(check, return_counts=True)
    pairs = int((counts.astype(np.int64) * (counts - 1) // 2).sum())
    reach = np.searchsorted(combined, combined + np.uint64(probe - 1), side="right")
    return pairs, int((reach - np.arange(len(combined)) - 1).sum())


def rows_of(keys: Keys, bits: Sequence[int], capacity: int, probe: int) -> list[list[str]]:
    """For each number of bits what there is, and what is to be expected."""
    places = max(capacity - probe, 1)
    n, place = len(keys.rows), keys.rows[:, NUMBERS] % np.uint32(places)
    rows = []
    for count in bits:
        check = keys.rows[:, NUMBERS + 1] & np.uint32(2**count - 1)
        pairs, near = false_pairs(check, place, probe)
        expected = n * (n - 1) / 2 ** (count + 1)
        numbers = (expected, expected * min((2 * probe - 1) / places, 1))
        rows.append([str(count), str(pairs), f"{numbers[0]:.4g}", str(near), f"{numbers[1]:.4g}"])
    return rows


def measure(arguments: Sequence[str] | None) -> None:
    """Print a row for each number of bits. Raises SceneError, SettingError, DeviceError."""
    parser = Parser(prog=Path(__file__).name, description=__doc__.splitlines()[0])
    parser.add_argument("--scene", metavar="FILE", required=True)
    parser.add_argument("--size", metavar="WxH", type=size)
    add_frames(parser, 0)
    parser.add_argument("--bits", type=whole(1), nargs="+", default=[32, 24, 16])
    parser.add_argument("--capacity", type=whole(1), default=2**21)
    parser.add_argument("--probe", type=whole(1), default=8)
    add_machine(parser)
    args = parser.parse_args(arguments)
    if max(args.bits) > HIGHEST_BITS:
        raise SettingError(f"--bits {max(args.bits)}: expected 1 .. {HIGHEST_BITS}")
    scene = load_scene(args.scene)
    settings = {"memo.auto": False, "memo.capacity": args.capacity, "memo.probe": min(args.probe, 64)}
    machine = {"device": args.device, "threads": args.threads, "seed": args.seed}
    renderer = Renderer(scene, size=args.size, spp=1, memo="texel", settings=settings, **machine)
    keys = Keys()
    with recorded(keys):
        for _ in renderer.frames(*frame_range(scene, args)):
            pass
    print(
        f"{keys.lookups} lookups of {len(keys.rows)} keys, in a table of {args.capacity} entries, {args.probe} places each"
    )
    heads = ["bits", "pairs", "expected", "false hits", "expected"]
    print(table(heads, rows_of(keys, args.bits, args.capacity, args.probe)))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code, as of `clcache`."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
