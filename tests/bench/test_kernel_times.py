"""What is timed does what it says: the memory kernels move all, launches are written down, warm-ups do not count."""

import numpy as np
import pytest
from helpers import IDENTITY, icosphere, make_scene

from clcache.bench.launches import WatchedDevice, timed
from clcache.bvh import Tracer
from clcache.bvh.build import SceneTrees
from clcache.device import event_seconds
from clcache.scene.geometry import Geometry

RUN = 64  # vectors of 16 numbers that a work-item of `read` takes


@pytest.fixture(scope="module")
def watched(device_spec):
    return WatchedDevice(device_spec, None)


def numbers(n):
    return np.random.default_rng(1).integers(0, 100, (n, 16)).astype(np.float32)


def test_copy_copies(device):
    values = numbers(1000)
    arrays = device.upload(values), device.upload(np.zeros_like(values))
    device.program("bench/bandwidth.cl")["copy"](*arrays, 1000, count=1000)
    np.testing.assert_array_equal(arrays[1].get(), values)


def test_read_reads_all(device):
    values = numbers(5 * RUN)
    sums = device.upload(np.zeros(5, np.float32))
    device.program("bench/bandwidth.cl")["read"](device.upload(values), sums, 5 * RUN, 5, count=5)
    np.testing.assert_array_equal(sums.get(), values.reshape(5, -1).sum(axis=1))


def test_the_first_launch_does_not_count(device):
    program, events = device.program("bench/bandwidth.cl"), []
    arrays = device.upload(numbers(1000)), device.upload(numbers(1000))

    def launch():
        events.append(program["copy"](*arrays, 1000, count=1000))
        return events[-1]

    seconds = timed(launch, 3)
    assert len(events) == 4
    assert seconds == tuple(event_seconds(event) for event in events[1:])
    assert min(seconds) > 0


def test_launches_are_written_down(watched):
    program = watched.program("bench/bandwidth.cl")
    values, copied = watched.upload(numbers(1000)), watched.upload(numbers(1000))
    program["copy"].run(1000, {"from": values, "to": copied}, n=1000)
    sums = watched.empty(2, np.float32)
    program["read"](watched.upload(numbers(2 * RUN)), sums, 2 * RUN, 2, count=2)
    launches = watched.take_launches()
    assert [launch.kernel for launch in launches] == ["copy", "read"]
    assert [launch.nbytes for launch in launches] == [2 * values.nbytes, 2 * RUN * 64 + 8]
    assert [(launch.count, launch.longest) for launch in launches] == [(1000, 1000), (2, 2 * RUN)]
    assert all(launch.seconds > 0 for launch in launches)
    np.testing.assert_array_equal(copied.get(), values.get())
    assert watched.take_launches() == []


def test_a_watched_device_builds_the_same_trees(watched, device):
    """Two placed spheres: both levels of trees are built, and rays find the same."""
    aside = IDENTITY + np.array([[0, 0, 0, 3.0], [0, 0, 0, 0], [0, 0, 0, 0]])
    scene = make_scene(icosphere(2), instances=[(0, IDENTITY), (0, aside)])
    SceneTrees(watched, Geometry.of(scene))
    kernels = [launch.kernel for launch in watched.take_launches()]
    assert {"triangle_bounds", "radix_scatter"} <= set(kernels)
    assert kernels.count("morton_keys") == 2
    rng = np.random.default_rng(2)
    origins, directions = rng.uniform(-4, 4, (500, 3)), rng.normal(size=(500, 3))
    hits = Tracer(scene, watched).closest_hit(origins, directions)
    np.testing.assert_array_equal(hits, Tracer(scene, device).closest_hit(origins, directions))
    assert np.isfinite(hits["t"]).any()
