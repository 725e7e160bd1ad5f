"""Count how often the single-pass reprojection of a sample cache leaves a slot whose visibility or radiance is another sample's.

python tools/single_pass_races.py [SCENE.toml] [--runs N] [--threads N] [--size WxH]

The paper's Listing 2 has two known races (SampleCache, section 3.1; clcache/cl/samplecache/reserve.cl). They are counted where
they have most room, samples that threads reach at the same time crowding into the same pixels, and in the motion that
`clcache bench reproject` measures; the other variants stand beside it, and must have none.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from measuring import exit_code, size, whole

from clcache import SettingError
from clcache.bench.job import DATA
from clcache.bench.reproject import SLOTS, CacheContent, Reprojection, cache_content
from clcache.bvh.tracer import Tracer
from clcache.cli import Parser
from clcache.device import Device
from clcache.methods.samplecache import MAX_SAMPLES
from clcache.passes.reproject import VARIANTS
from clcache.resources import SceneResources
from clcache.scene import load_scene

# PoCL hands a thread so many entries of the list at a time: those this far apart are reached by two threads at much the same
# time. In a crowd they go to one pixel, until twice as many as there is room for have come.
CHUNK = 4096
CROWD = 2 * SLOTS
SEEN = 0.5  # the part of the samples that are visible: the more of either kind, the more races


def measure(arguments: Sequence[str] | None) -> None:
    """Print a row for each variant and each motion. Raises SceneError, SettingError, DeviceError."""
    parser = Parser(prog=Path(__file__).name, description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default=str(DATA / "cornell" / "scene.toml"))
    parser.add_argument("--runs", type=whole(1), default=40)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--size", type=size, default=(640, 360))
    args = parser.parse_args(arguments)
    width, height = args.size
    if not CHUNK <= width * height <= MAX_SAMPLES // SLOTS:  # the crowd needs a chunk of pixels to go to
        raise SettingError(f"--size {width}x{height}: expected {CHUNK} .. {MAX_SAMPLES // SLOTS} pixels")
    scene = load_scene(args.scene)
    device = Device(threads=args.threads)
    content = cache_content(Tracer(scene, device), scene, (width, height), seen=SEEN)
    resources = SceneResources(device, scene)
    print(f"{args.runs} runs, {device.threads} threads, {width}x{height}, of slots filled: how many are inconsistent")
    print(f"{'motion':8} {'variant':14} {'slots':>12} {'visibility':>11} {'radiance':>9} {'runs with any':>14}")
    for motion in ("crowd", "step"):
        for variant in VARIANTS:
            passes = Reprojection(device, resources, (width, height), content, variant)
            counts = np.array([count(passes, content, motion == "crowd") for _ in range(args.runs)])
            slots, visibility, radiance = counts.sum(axis=0)
            touched = int((counts[:, 1:].sum(axis=1) > 0).sum())
            print(f"{motion:8} {variant:14} {slots:12} {visibility:11} {radiance:9} {touched:14}", flush=True)
            passes.release()


def count(passes: Reprojection, content: CacheContent, crowded: bool) -> tuple[int, int, int]:
    """Reproject once: slots filled, those whose visibility is not that of the first hit, those whose radiance is not."""
    passes.run_common()
    if crowded:
        target = passes.arrays["target"]
        entry = np.arange(target.size)
        target.set((entry // (CHUNK * CROWD) * CHUNK + entry % CHUNK).astype(np.uint32))
    passes.run_slots()
    mask = passes.arrays["mask"].get()[:, 0]
    occupied = mask >> np.arange(SLOTS, dtype=np.uint32)[:, None] & 1 != 0
    visible = (mask >> np.arange(SLOTS, 2 * SLOTS, dtype=np.uint32)[:, None] & 1 != 0)[occupied]
    words, hits = (passes.arrays[name].get()[occupied] for name in ("shading", "first_hit"))
    sample = np.minimum(words[:, 0], content.first_hit[..., 0].size - 1)
    own_hit = content.first_hit.reshape(-1, 4)[sample]
    whole = (words[:, :3] == sample[:, None]).all(axis=1) & (hits == own_hit).all(axis=1)
    slot, pixel = np.divmod(sample, content.mask.shape[0])
    seen = content.mask[pixel, 0] >> (slot + SLOTS).astype(np.uint32) & 1 != 0
    return len(sample), int((whole & (seen != visible)).sum()), int((~whole).sum())


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code, as of `clcache`."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
