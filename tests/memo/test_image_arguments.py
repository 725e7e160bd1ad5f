"""Images as arguments of kernels, and arguments that depend on a define."""

import numpy as np
import pytest
from kernel_source import build

from clcache.device import Device
from clcache.errors import DeviceError
from clcache.frame import Buffer, FrameGraph, Pass
from clcache.image import Image
from clcache.program import read_signatures

MOVE = """
#pragma OPENCL EXTENSION cl_khr_3d_image_writes : enable

__kernel void move2d(
    read_only image2d_t before,   // (rows, columns, 4)
    write_only image2d_t after,   // (rows, columns, 4)
    uint columns,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    int2 place = (int2)(i % columns, i / columns);
    write_imagef(after, place, 2.0f * read_imagef(before, place));
}

__kernel void move3d(
    read_only image3d_t before,   // (layers, rows, columns, 4)
    write_only image3d_t after,   // (layers, rows, columns, 4)
    uint columns,
    uint rows,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    int4 place = (int4)(i % columns, i / columns % rows, i / columns / rows, 0);
    write_imagef(after, place, 2.0f * read_imagef(before, place));
}
"""

CHOSEN = """
__kernel void add(
    __global float *values,     // (n)
#if HAS_IMAGE
    read_only image2d_t added,  // (1, n, 4)
#else
    __global const float *added,  // (n)
#endif
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
#if HAS_IMAGE
    values[i] += read_imagef(added, (int2)(i, 0)).x;
#else
    values[i] += added[i];
#endif
}
"""


@pytest.fixture(scope="module")
def move(device, tmp_path_factory):
    return build(device, MOVE, tmp_path_factory.mktemp("move"))


def filled(device: Device, shape: tuple[int, ...], dtype: type) -> tuple[Image, np.ndarray]:
    values = np.random.default_rng(1).normal(size=shape).astype(dtype)
    image = device.image(shape, dtype)
    image.set(values)
    return image, values


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
@pytest.mark.parametrize("shape", [(5, 3, 4), (2, 5, 3, 4)])
def test_texels_come_back_as_they_were_set(device, shape, dtype):
    image, values = filled(device, shape, dtype)
    assert image.shape == shape and image.dtype == dtype and image.nbytes == values.nbytes
    np.testing.assert_array_equal(image.get(), values)


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
@pytest.mark.parametrize("shape", [(5, 3, 4), (2, 5, 3, 4)])
def test_kernels_read_and_write_images(device, move, shape, dtype):
    before, values = filled(device, shape, dtype)
    after = device.image(shape, dtype)
    n = values.size // 4
    rows = {"rows": shape[-3]} if len(shape) == 4 else {}
    kernel = move["move3d" if rows else "move2d"]
    kernel.run(n, {"before": before, "after": after}, columns=shape[-2], n=n, **rows)
    np.testing.assert_array_equal(after.get(), 2 * values)


@pytest.mark.parametrize("has_image", [False, True])
def test_arguments_may_depend_on_a_define(device, tmp_path, has_image):
    program = build(device, CHOSEN, tmp_path, HAS_IMAGE=has_image)
    values = device.upload(np.arange(6, dtype=np.float32))
    image, texels = filled(device, (1, 6, 4), np.float32)
    added = image if has_image else device.upload(texels[0, :, 0])
    program["add"](values, added, 6, count=6)
    np.testing.assert_array_equal(values.get(), np.arange(6, dtype=np.float32) + texels[0, :, 0])


def test_what_is_no_image_or_of_another_shape_is_refused(device, move):
    kernel = move["move2d"]
    image, values = filled(device, (5, 3, 4), np.float32)
    solid, _ = filled(device, (1, 5, 3, 4), np.float32)
    smaller, _ = filled(device, (5, 2, 4), np.float32)
    with pytest.raises(TypeError, match="argument before is Array, not an image of the device"):
        kernel(device.upload(values), image, 3, 15, count=15)
    with pytest.raises(TypeError, match="argument after is NoneType"):
        kernel(image, None, 3, 15, count=15)
    with pytest.raises(ValueError, match="argument before has shape"):
        kernel(solid, image, 3, 15, count=15)
    with pytest.raises(ValueError, match="columns is 2, but 3 in argument before"):
        kernel(image, smaller, 3, 15, count=15)


def test_an_image_of_another_device_is_refused(device, other_groups, move):
    image, _ = filled(device, (5, 3, 4), np.float32)
    other, _ = filled(other_groups, (5, 3, 4), np.float32)
    with pytest.raises(ValueError, match="argument after is an array of another device"):
        move["move2d"](image, other, 3, 15, count=15)


def test_images_count_as_memory_until_they_are_released(device):
    before = device.allocated
    image = device.image((16, 16, 4), np.float16)
    assert device.allocated == before + 16 * 16 * 4 * 2
    device.release(image)
    assert device.allocated == before


def test_an_image_that_the_device_does_not_have_is_a_device_error(device):
    with pytest.raises(DeviceError, match=r"^too wide: the device gave no image of "):
        device.image((1, 2**20, 4), np.float32, "too wide")


class Count(Pass):
    """Adds one to all texels of an image that outlives the run."""

    name, reads, writes = "count", ("counts",), ("counts",)

    def run(self, arrays, state):
        arrays["counts"].set(arrays["counts"].get() + 1)
        return ()


def test_images_of_a_frame_outlive_it_and_are_kept_for_the_next(device):
    before = device.allocated
    image = Buffer("counts", (2, 5, 3, 4), np.float16, persistent=True, is_image=True)
    graph = FrameGraph(device, [Count()], [image], ["counts"])
    assert isinstance(graph.of()["counts"], Image) and graph.sizes == {"counts": 240}
    for run in (1, 2):
        graph.run(None)
        assert (graph.kept()["all.counts"].get() == run).all()
    graph.release()
    assert device.allocated == before


def test_an_image_needs_its_shape():
    with pytest.raises(ValueError, match="kernel k: argument image lacks its shape"):
        read_signatures("__kernel void k(read_only image2d_t image) {}")
