"""The reprojection of a sample cache by itself, in its variants: what it takes, and how many slots races spoil.

A cache with four first hits in each pixel, of which nine tenths are visible, is reprojected after a small step of the camera, as `clcache bench
reproject` does it. The published variant in one pass has two races (section 3.1 of SampleCache; clcache/cl/samplecache/reserve.cl): a
slot's visibility may be another sample's, and its radiance may be another's than its first hit is. They are counted, of the slots that are
filled: in that step, and where they have most room, in a crowd: samples that threads reach at the same time go to the same pixels, until
twice as many have come as there is room for, and half of them are visible. With one thread there are none.
"""

import statistics
from collections.abc import Mapping

import numpy as np

from ..bench.reproject import SLOTS, CacheContent, Reprojection, cache_content
from ..bvh.tracer import Tracer
from ..device import Device
from ..errors import SettingError
from ..methods.samplecache import MAX_SAMPLES
from ..passes.reproject import VARIANTS
from ..resources import SceneResources
from .job import Machine, Result, open_scene

# PoCL hands a thread so many entries of the list at a time: those this far apart are reached by two threads at much the same time.
CHUNK = 4096
CROWD = 2 * SLOTS
CROWD_SEEN = 0.5  # the more there are of samples that are visible and of those that are not, the more races
SIMPLE = "simple"  # one sample for each pixel, stored where it appears, without any choice of slots


def run(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Times and races of all variants, with and without radiance: a row for each. Raises SceneError, SettingError, DeviceError.

    parameters: scene, size, repeats (those that are timed, after one that is not), runs (in which races are counted), seed. The columns:
    configuration; seconds, and of them stage.reserve (listing, projecting and taking slots) and stage.copy (filling them), medians; samples;
    threads; and of variants with radiance `step` and `crowd`, parts of the filled slots that are inconsistent, but with one thread, which
    shows nothing of races.
    """
    told, scene = parameters, open_scene(parameters["scene"])
    size = tuple(told["size"])
    if not CHUNK <= size[0] * size[1] <= MAX_SAMPLES // SLOTS:  # the crowd needs a chunk of pixels to go to
        raise SettingError(f"size {size[0]}x{size[1]}: expected {CHUNK} .. {MAX_SAMPLES // SLOTS} pixels")
    device = machine.open()
    tracer, resources = Tracer(scene, device), SceneResources(device, scene)
    content = cache_content(tracer, scene, size, seed=told["seed"])
    crowded = cache_content(tracer, scene, size, CROWD_SEEN, told["seed"])
    rows = []
    for variant in (*VARIANTS, SIMPLE):
        for has_radiance in (True, False):
            held = content.of_first_slot() if variant == SIMPLE else content
            passes = Reprojection(device, resources, size, held, variant, has_radiance)
            row = {"configuration": variant if has_radiance else f"{variant}-no-shade", "threads": device.threads}
            row |= _times(passes, told["repeats"])
            can_race = has_radiance and variant != SIMPLE and device.threads > 1
            if can_race:
                row["step"] = _spoilt(passes, held, told["runs"], is_crowd=False)
            passes.release()
            if can_race:
                row["crowd"] = _crowd(device, resources, size, crowded, variant, told["runs"])
            rows.append(row)
    return Result(rows)


def _times(passes: Reprojection, repeats: int) -> dict[str, float]:
    runs = [passes.run_common() | passes.run_slots() for _ in range(repeats + 1)][1:]
    copy = [run.get("copy", 0.0) for run in runs]
    total = [sum(run.values()) for run in runs]
    return {
        "seconds": statistics.median(total),
        "stage.reserve": statistics.median(a - b for a, b in zip(total, copy, strict=True)),
        "stage.copy": statistics.median(copy),
        "samples": passes.listed,
    }


def _crowd(
    device: Device, resources: SceneResources, size: tuple[int, int], content: CacheContent, variant: str, runs: int
) -> float:
    passes = Reprojection(device, resources, size, content, variant)
    try:
        return _spoilt(passes, content, runs, is_crowd=True)
    finally:
        passes.release()


def _spoilt(passes: Reprojection, content: CacheContent, runs: int, is_crowd: bool) -> float:
    """The part of the slots filled that are inconsistent, over all runs."""
    counts = np.sum([count(passes, content, is_crowd) for _ in range(runs)], axis=0)
    slots, visibility, radiance = (int(n) for n in counts)
    return (visibility + radiance) / slots


def count(passes: Reprojection, content: CacheContent, is_crowd: bool) -> tuple[int, int, int]:
    """Reproject once: slots filled, those whose visibility is not that of the first hit, those whose radiance is not."""
    passes.run_common()
    if is_crowd:
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
