"""The paths that go on close ranks between two vertices; the image is the same, bit for bit, as if they had not."""

import numpy as np
import pytest
from render_helpers import everything, image

from clcache.device import Device
from clcache.passes import shade

CHUNK = 4096
MOVED = {"ray_origin": 3, "ray_direction": 3, "throughput": 3, "density": None, "cone": 2}
FEW = 7 / 8  # more than these stay where they are


@pytest.fixture(scope="module")
def device():
    return Device()


def queue(n: int, part: float, seed: int = 3) -> dict[str, np.ndarray]:
    """A queue as shade and shadow leave it, in which this part of the paths goes on; radiance and path by path."""
    rng = np.random.default_rng(seed)
    planes = {name: (n,) if rows is None else (rows, n) for name, rows in MOVED.items()}
    arrays = {name: rng.random(shape, np.float32) for name, shape in planes.items()}
    goes_on = rng.random(n) < part
    return arrays | {
        "ray_length": np.where(goes_on, np.float32(np.inf), np.float32(0)),
        "path": np.concatenate([c + rng.permutation(min(CHUNK, n - c)) for c in range(0, n, CHUNK)]).astype(np.uint32),
        "alive": np.array([min(CHUNK, n - c) for c in range(0, n, CHUNK)], np.uint32),
        "radiance": rng.random((3, n), np.float32),
        "occluded": (rng.random(n) < 0.5).astype(np.uint8),
        "shadow_length": np.where(rng.random(n) < 0.7, np.float32(2), np.float32(0)),
        "shadow_radiance": rng.random((3, n), np.float32),
    }


def compacted(device: Device, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    kernel = device.program("pathtrace/compact.cl", HAS_DIRECT=True, HAS_EMISSION=True, HAS_TEXTURES=True)["compact"]
    there = {name: device.upload(values, name) for name, values in arrays.items()}
    chunks = arrays["alive"].size
    kernel.run(chunks, there, n=arrays["path"].size, chunks=chunks).wait()
    return {name: values.get() for name, values in there.items()}


@pytest.mark.parametrize("n", [16, CHUNK - 16, CHUNK, 2 * CHUNK + 48])
@pytest.mark.parametrize("part", [0.0, 0.3, 0.8, 0.97, 1.0])
def test_against_numpy(device, n, part):
    before = queue(n, part)
    after = compacted(device, before)
    was_lit = (before["shadow_length"] > 0) & (before["occluded"] == 0)
    radiance = before["radiance"].copy()
    radiance[:, before["path"]] += np.where(was_lit, before["shadow_radiance"], np.float32(0))
    np.testing.assert_array_equal(after["radiance"], radiance)
    for chunk, begin in enumerate(range(0, n, CHUNK)):
        places = np.arange(begin, min(begin + CHUNK, n))
        going_on = places[before["ray_length"][places] > 0]
        if len(going_on) > FEW * len(places):
            going_on = places
        count = len(going_on)
        assert after["alive"][chunk] == count
        front, behind = places[:count], places[count:]
        for name in (*MOVED, "path", "ray_length"):
            np.testing.assert_array_equal(after[name][..., front], before[name][..., going_on], err_msg=name)
        assert not after["ray_length"][behind].any()
        assert not after["shadow_length"][behind].any()


def test_only_those_that_were_alive_count(device):
    """A chunk whose ranks were closed before: what lies behind them is no path's, and brings no light."""
    before = queue(CHUNK, 1.0)
    before["alive"][0] = 1000
    after = compacted(device, before)
    changed = (after["radiance"] != before["radiance"]).any(axis=0)
    was_lit = (before["shadow_length"] > 0) & (before["occluded"] == 0)
    assert set(np.flatnonzero(changed)) == set(before["path"][:1000][was_lit[:1000]])
    assert after["alive"][0] == 1000


def only_add(self, arrays, state):
    """What `Compact` does to radiance, and nothing that moves."""
    was_lit = (arrays["shadow_length"].get() > 0) & (arrays["occluded"].get() == 0)
    brought = np.where(was_lit, arrays["shadow_radiance"].get(), np.float32(0))
    arrays["radiance"].set(arrays["radiance"].get() + brought)
    return ()


@pytest.mark.parametrize("local_size", [1, 7, 64, 256])
def test_the_image_is_the_same_without(monkeypatch, local_size):
    options = {"spp": 2, "bounces": 4, "settings": {"device.local_size": local_size}}
    moved = image(everything(), (101, 67), **options)  # two chunks, of which the second is not full
    monkeypatch.setattr(shade.Compact, "run", only_add)
    stayed = image(everything(), (101, 67), **options)
    np.testing.assert_array_equal(moved.view(np.uint32), stayed.view(np.uint32))
