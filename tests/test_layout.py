"""Struct layouts: what the host declares is what the device compiles, and where it is not, nothing is built."""

import numpy as np
import pytest

from clcache import layout
from clcache.errors import DeviceError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of kernels in the place of the package's own."""
    monkeypatch.setattr("clcache.program.SOURCE_FOLDER", tmp_path)
    return tmp_path


def offsets_kernel(names):
    """A kernel that writes each struct's size, then the offset of each of its fields."""
    lines = []
    for name in names:
        lines.append(f"out[{len(lines)}] = sizeof({name});")
        for field in layout.STRUCTS[name].names:
            lines.append(f"out[{len(lines)}] = (uint)((__local char *)&s_{name}.{field} - (__local char *)&s_{name});")
    variables = "\n".join(f"__local {name} s_{name};" for name in names)
    return f"""__kernel void offsets(
    __global uint *out,  // (n)
    uint n)
{{
    {variables}
    if (get_global_id(0) > 0 || n == 0) return;
    {" ".join(lines)}
}}
"""


def test_sizes_and_offsets_are_the_devices(device, folder):
    """Measured by the device from the addresses of fields, apart from the checks that the emitted text has."""
    (folder / "offsets.cl").write_text(offsets_kernel(layout.STRUCTS))
    expected = []
    for dtype in layout.STRUCTS.values():
        expected += [dtype.itemsize, *(dtype.fields[name][1] for name in dtype.names)]
    out = device.empty(len(expected), np.uint32)
    device.program("offsets.cl")["offsets"](out, len(expected), count=1)
    np.testing.assert_array_equal(out.get(), expected)


@pytest.mark.parametrize("name", layout.STRUCTS)
def test_fields_read_on_the_device_are_the_hosts(device, folder, name):
    """Every 4 bytes of a record, found through its fields' names."""
    dtype = layout.STRUCTS[name]
    words, reads = 0, []
    for field in dtype.names:
        length = int(np.prod(dtype[field].shape, dtype=int))
        scalar = {"f": "as_uint", "u": "", "i": "as_uint"}[dtype[field].base.kind]
        for k in range(length):
            reads.append(f"out[{words}] = {scalar}(record->{field}{f'[{k}]' if dtype[field].shape else ''});")
            words += 1
    (folder / f"{name}.cl").write_text(
        f"__kernel void words(__global const {name} *record,  // (one)\n __global uint *out,  // (n)\n uint n)\n"
        f"{{ if (get_global_id(0) > 0 || n == 0) return; {' '.join(reads)} }}\n"
    )
    assert 4 * words == dtype.itemsize
    raw = np.random.default_rng(1).integers(0, 2**30, words, dtype=np.uint32)
    out = device.empty(words, np.uint32)
    device.program(f"{name}.cl")["words"](device.upload(raw.view(dtype)), out, words, count=1)
    np.testing.assert_array_equal(out.get(), raw)


@pytest.mark.parametrize(
    "wrong",
    [
        np.dtype({"names": ["a", "b"], "formats": ["f4", "u4"], "offsets": [0, 8], "itemsize": 12}),
        np.dtype({"names": ["a", "b"], "formats": ["f4", "u4"], "offsets": [4, 0], "itemsize": 8}),
        np.dtype({"names": ["a", "b"], "formats": ["f4", "u4"], "offsets": [0, 4], "itemsize": 16}),
    ],
    ids=["gap", "order", "size"],
)
def test_a_wrong_layout_does_not_build(device, folder, monkeypatch, wrong):
    (folder / "empty.cl").write_text("")
    device.program("empty.cl", VARIANT=1)
    monkeypatch.setitem(layout.STRUCTS, "Emitter", wrong)
    with pytest.raises(DeviceError, match="Emitter"):
        device.program("empty.cl", VARIANT=2)


def test_fields_are_whole_words():
    for dtype in layout.STRUCTS.values():
        assert dtype.itemsize == sum(dtype[name].itemsize for name in dtype.names)
        assert all(dtype[name].base.itemsize == 4 for name in dtype.names)
