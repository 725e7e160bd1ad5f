"""The same bits in any run, for any number of threads and any work-group size; nearly the same on another runtime."""

import os
import zlib

import numpy as np
import pytest
from cache_renders import SMALL, cached, counters, held, in_child, one_device, yard

from clcache import drivers

SIZE = (32, 24)
AOVS = ("albedo", "N", "Z", "variance", "samples", "occupancy", "visible", "age", "trace")


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def frames(scene, count, **options):
    return list(cached(scene, size=SIZE, **SMALL, **options).frames(0, count))


# What one sequence leaves: images and AOVs of all frames and eyes, and the caches.
OPTIONS = {
    "samplecache": {"stereo": True, "stereo_blend": "samples", "shading": "adaptive", "shading_rate": 0.7},
    "isrt": {"demodulate": True},
}


def checksum(method, **options):
    renderer = cached(yard(4), method, (29, 21), **SMALL, **OPTIONS[method], aovs=AOVS, **options)
    kept = []
    for frame in renderer.frames(0, 4):
        for eye in frame.color:
            kept += [frame.color[eye], *(frame.aov(name, eye) for name in AOVS)]
    for eye in renderer.eyes:
        after = held(renderer, eye)
        kept += [after.occupied, after.visible, after.first_hit[after.occupied], after.radiance[after.occupied]]
        kept += [after.count[after.occupied], after.age[after.occupied]]
    return zlib.crc32(b"".join(np.ascontiguousarray(values).tobytes() for values in kept))


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_one_and_two_threads():
    """In processes of their own: PoCL fixes its number of threads once in a process."""
    code = "import test_repeatability as t; print(*(t.checksum(m, threads={}) for m in t.OPTIONS))"
    assert in_child(code.format(1)) == in_child(code.format(2)) == [checksum(method) for method in OPTIONS]


@pytest.mark.parametrize("method", OPTIONS)
def test_work_groups_and_runs(method):
    usual = checksum(method)
    assert checksum(method) == usual
    assert checksum(method, settings={"device.local_size": 7}) == usual
    assert checksum(method, seed=1) != usual


def test_spp_is_the_number_of_updates():
    still = yard(moving=False)
    *_, third = each = frames(still, 3, aovs=AOVS)
    (only,) = frames(still, 1, spp=3, aovs=AOVS)
    np.testing.assert_array_equal(only.color["mono"], third.color["mono"])
    for name in AOVS:
        np.testing.assert_array_equal(only.aov(name, "mono"), third.aov(name, "mono"))
    assert counters(third)["created"] < counters(only)["created"]
    for name, count in counters(only).items():
        of_each = [counters(frame)[name] for frame in each]
        assert count == (of_each[-1] if name in ("occupied", "visible") else sum(of_each)), name
    rays = [frame.stats["eyes"]["mono"]["rays"] for frame in (only, *each)]
    assert rays[0] == {name: sum(r[name] for r in rays[1:]) for name in rays[0]}
    assert rays[0]["primary"] == counters(only)["created"] + counters(only)["retraced"]


def test_runtimes_agree():
    """PoCL's and Intel's built-in functions and contractions differ in the last bits. Where that turns a coin or moves a sample
    across a pixel's edge a pixel differs as noise does, which happens in few: of nearly all values the difference is rounding."""
    specs = [c for c in drivers.candidates() if "Oclgrind" not in c.platform and drivers.probe(c).usable]
    names = {word: next((c for c in specs if word in c.platform), None) for word in ("Portable", "Intel")}
    if None in names.values():
        pytest.skip("needs PoCL and Intel's runtime")
    pocl, intel = (frames(yard(6), 6, device=str(c.index))[-1].color["mono"].astype(float) for c in names.values())
    close = np.abs(pocl - intel) <= 1e-4 * np.maximum(pocl, intel)
    assert close.mean() > 0.98
    np.testing.assert_allclose(pocl.mean(axis=(0, 1)), intel.mean(axis=(0, 1)), rtol=0.01)
