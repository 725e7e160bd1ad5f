"""Arrays of a device: large ones are kept in memory of the host's, where the device is its processor."""

import numpy as np
import pytest

from clcache.device import Device, fill
from clcache.errors import DeviceError

LARGE = (3, 500_001)  # of float32: above what is kept in large pages


def test_large_arrays_hold_what_is_written(device):
    before = device.allocated
    values = np.random.default_rng(1).random(LARGE, np.float32)
    array = device.upload(values)
    assert device.allocated - before == values.nbytes == array.nbytes
    np.testing.assert_array_equal(array.get(), values)
    fill(array, 3)
    assert (array.get() == 3).all()
    device.release(array)
    assert device.allocated == before


def test_large_arrays_are_apart(device):
    first, second = (device.upload(np.full(LARGE, v, np.float32)) for v in (1, 2))
    assert (first.get() == 1).all()
    assert (second.get() == 2).all()
    device.release(first)
    assert (second.get() == 2).all()
    device.release(second)


def test_memory_that_the_host_refuses(monkeypatch):
    device = Device()
    if not device.is_cpu:
        pytest.skip("the device has memory of its own")

    def refuse(*_):
        raise MemoryError

    monkeypatch.setattr(np, "empty", refuse)
    with pytest.raises(DeviceError, match=r"a picture: the device gave no 5\.7 MiB"):
        device.empty(LARGE, np.float32, "a picture")
