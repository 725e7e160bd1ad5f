"""Programs: sources and signatures, and calls that refuse what does not fit."""

import numpy as np
import pyopencl as cl
import pytest

from clcache.device import Device
from clcache.errors import DeviceError
from clcache.layout import STRUCTS
from clcache.program import SOURCE_FOLDER, read_signatures, read_source

SCALE = """
// Multiplies by a factor.
__kernel void scale(
    __global const float *values,  // (3, n)
    __global float *scaled,        // (3, n)
    __global const uint *extra,    // (*) or null
    uint n,
    float factor)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    for (uint k = 0; k < 3; k++) scaled[k * n + i] = factor * values[k * n + i] + (extra ? extra[0] : 0);
}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of kernels in the place of the package's own."""
    monkeypatch.setattr("clcache.program.SOURCE_FOLDER", tmp_path)
    return tmp_path


def build(device, folder, source, **defines):
    """A program of its own for every call: the device keeps those that it has built."""
    build.number = getattr(build, "number", 0) + 1
    (folder / f"{build.number}.cl").write_text(source)
    return device.program(f"{build.number}.cl", **defines)


# Sources


def test_includes_are_expanded_once_and_lines_keep_their_numbers(folder):
    (folder / "deep").mkdir()
    (folder / "a.cl").write_text('int a1;\n#include "deep/b.cl"\nint a3;\n#include "c.cl"\nint a5;\n')
    (folder / "deep" / "b.cl").write_text('  #include "c.cl"\nint b2;\n')
    (folder / "c.cl").write_text("int c1;\n")
    places, file, number = [], None, 0
    for line in read_source("a.cl").splitlines():
        if line.startswith("#line"):
            number, file = int(line.split()[1]), line.split('"')[1]
            continue
        if line.startswith("int"):
            places.append((line, file, number))
        number += 1
    assert places == [
        ("int a1;", "a.cl", 1),
        ("int c1;", "c.cl", 1),
        ("int b2;", "deep/b.cl", 2),
        ("int a3;", "a.cl", 3),
        ("int a5;", "a.cl", 5),
    ]


def test_files_that_include_each_other_end(folder):
    (folder / "a.cl").write_text('#include "b.cl"\nint a;\n')
    (folder / "b.cl").write_text('#include "a.cl"\nint b;\n')
    assert [line for line in read_source("a.cl").splitlines() if line.startswith("int")] == ["int b;", "int a;"]


def test_a_build_error_names_the_true_file_and_line(device, folder):
    (folder / "first.cl").write_text('// one\n#include "second.cl"\n// three\n')
    (folder / "second.cl").write_text("// one\n// two\ninline int broken() { return undeclared_name; }\n")
    with pytest.raises(DeviceError) as caught:
        device.program("first.cl")
    message = str(caught.value)
    assert message.startswith("first.cl: ")
    assert "second.cl:3" in message
    assert "undeclared_name" in message
    assert "\n" not in message


def test_an_error_after_an_include_names_the_including_file(device, folder):
    (folder / "outer.cl").write_text('// one\n#include "inner.cl"\ninline int broken() { return undeclared_name; }\n')
    (folder / "inner.cl").write_text("// one\n// two\n// three\n")
    with pytest.raises(DeviceError, match="outer.cl:3"):
        device.program("outer.cl")


# Signatures


def test_signatures_are_read():
    source = """
    inline float helper(float x) { return x; }
    __kernel __attribute__((reqd_work_group_size(1, 1, 1))) void first(
        __global const float4 *vectors,           // (n, 3)
        volatile __global uint *restrict counts,  // (256, chunks) or null
        __constant Emitter *lights,               // (lights)
        Camera camera,
        ulong key)
    {
    }
    __kernel void second(__global uchar *bytes,  // (*)
                         uint n) {}
    """
    first, second = read_signatures(source).values()
    assert (first.name, first.local_size, second.name, second.local_size) == ("first", 1, "second", None)
    assert [(a.name, a.dtype, a.shape, a.nullable) for a in first.arguments] == [
        ("vectors", np.float32, ("n", 3, 4), False),
        ("counts", np.uint32, (256, "chunks"), True),
        ("lights", STRUCTS["Emitter"], ("lights",), False),
        ("camera", STRUCTS["Camera"], None, False),
        ("key", np.uint64, None, False),
    ]
    assert [(a.name, a.dtype, a.shape) for a in second.arguments] == [
        ("bytes", np.uint8, ("*",)),
        ("n", np.uint32, None),
    ]


@pytest.mark.parametrize(
    ("argument", "message"),
    [("__global float *x", "kernel k: argument x lacks its shape"), ("half h", "argument h has the unknown type half")],
)
def test_arguments_that_break_the_conventions(argument, message):
    with pytest.raises(ValueError, match=message):
        read_signatures(f"__kernel void k({argument}) {{}}")


# probe.cl is built by clcache/probe.py, without this module's conventions.
FILES = sorted({p.relative_to(SOURCE_FOLDER).as_posix() for p in SOURCE_FOLDER.rglob("*.cl")} - {"probe.cl"})


@pytest.mark.parametrize("file", FILES)
def test_every_kernel_of_the_package_has_a_signature(file):
    text = (SOURCE_FOLDER / file).read_text(encoding="utf-8")
    assert len(read_signatures(text)) == text.count("__kernel ")


# Defines, builds


def test_defines_become_literals(device, folder):
    source = """
    __kernel void write(
        __global float *out,  // (4)
        uint n)
    {
        if (get_global_id(0) >= n) return;
        out[0] = HALF; out[1] = 1 - BELOW; out[2] = YES ? 7 : 8; out[3] = TINY;
    }"""
    out = device.empty(4, np.float32)
    values = {"HALF": np.float32(0.5), "BELOW": -3, "YES": True, "TINY": 1e-30}
    build(device, folder, source, **values)["write"](out, 1, count=1)
    np.testing.assert_array_equal(out.get(), np.float32([0.5, 4, 7, 1e-30]))


def test_programs_are_built_once_for_each_set_of_defines(device, folder):
    (folder / "same.cl").write_text(SCALE)
    first = device.program("same.cl", A=1)
    assert device.program("same.cl", A=1) is first
    assert device.program("same.cl", A=1.0) is not first
    assert device.program("same.cl", A=2) is not first
    assert device.program("same.cl") is not first


def test_every_kernel_is_compiled_ahead_of_use(folder, monkeypatch):
    """The build launches each kernel once, for its work-group size, with no work to do."""
    one_item = "__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void single("
    (folder / "two.cl").write_text(SCALE + SCALE.replace("__kernel void scale(", one_item))
    launched, built = [], []
    launch = cl.enqueue_nd_range_kernel

    def record(queue, kernel, global_size, local_size):
        launched.append((kernel.function_name, global_size, local_size))
        return launch(queue, kernel, global_size, local_size)

    monkeypatch.setattr(cl, "enqueue_nd_range_kernel", record)
    device = Device(local_size=16, on_compile=built.append)
    program = device.program("two.cl")
    assert built == ["two.cl"]
    assert launched == [("scale", (16,), (16,)), ("single", (1,), (1,))]
    assert [k.signature.name for k in program] == ["scale", "single"]
    assert program.seconds == device.compile_seconds > 0


# Calls


@pytest.fixture
def scale(device, folder):
    """A kernel with arguments that fit it: (kernel, values)."""
    values = device.upload(np.arange(15, dtype=np.float32).reshape(3, 5))
    return build(device, folder, SCALE)["scale"], [values, device.empty((3, 5), np.float32), None, 5, 2.0]


def test_a_call(scale):
    kernel, values = scale
    kernel(*values, count=5).wait()
    np.testing.assert_array_equal(values[1].get(), 2 * values[0].get())


def test_count_of_0_enqueues_nothing(scale):
    kernel, values = scale
    assert kernel(*values, count=0) is None


def test_any_shape_where_a_star_allows_it(device, scale):
    kernel, values = scale
    values[2] = device.upload(np.full((2, 2, 2), 10, np.uint32))
    kernel(*values, count=5)
    np.testing.assert_array_equal(values[1].get(), 2 * values[0].get() + 10)


def swapped(values, place, value):
    return [*values[:place], value, *values[place + 1 :]]


@pytest.mark.parametrize(
    ("place", "value", "error", "message"),
    [
        (0, lambda d: None, TypeError, "argument values is NoneType, not an array of the device"),
        (0, lambda d: np.zeros((3, 5), np.float32), TypeError, "values is ndarray, not an array of the device"),
        (0, lambda d: d.empty((3, 5), np.uint32), TypeError, "values has dtype uint32, not float32"),
        (0, lambda d: d.empty((3, 5), np.float64), TypeError, "values has dtype float64, not float32"),
        (0, lambda d: d.empty(15, np.float32), ValueError, r"values has shape \(15,\), not \(3, n\)"),
        (0, lambda d: d.empty((5, 3), np.float32), ValueError, r"values has shape \(5, 3\), not \(3, n\)"),
        (1, lambda d: d.empty((3, 6), np.float32), ValueError, "argument scaled: n is 6, but 5 in argument values"),
        (0, lambda d: d.empty((4, 5), np.float32)[1:], ValueError, "values is a view"),
        (0, lambda d: d.empty((5, 3), np.float32).T, ValueError, "values is a view"),
        (3, lambda d: 4, ValueError, "argument n: n is 4, but 5 in argument values"),
        (3, lambda d: 5.0, TypeError, "argument n is 5.0, not one uint32"),
        (3, lambda d: -1, ValueError, "argument n is -1, out of the range of uint32"),
        (3, lambda d: 2**32, ValueError, "out of the range of uint32"),
        (3, lambda d: None, TypeError, "argument n is None, not one uint32"),
        (4, lambda d: "2", TypeError, "argument factor is '2', not one float32"),
        (4, lambda d: [1.0, 2.0], TypeError, "argument factor is"),
        (4, lambda d: 1j, TypeError, "argument factor is"),
    ],
)
def test_arguments_that_do_not_fit(device, scale, place, value, error, message):
    kernel, values = scale
    with pytest.raises(error, match=f"^kernel scale: .*{message}"):
        kernel(*swapped(values, place, value(device)), count=5)


@pytest.mark.parametrize("change", [lambda v: v[:-1], lambda v: [*v, 1]])
def test_a_wrong_number_of_arguments(scale, change):
    kernel, values = scale
    with pytest.raises(TypeError, match="kernel scale takes 5 arguments, not"):
        kernel(*change(values), count=5)


def test_structs_as_arguments(device, folder):
    source = """
    __kernel void size(
        Camera camera,
        __global uint *out,  // (2)
        uint n)
    {
        if (get_global_id(0) >= n) return;
        out[0] = camera.width; out[1] = camera.height;
    }"""
    kernel = build(device, folder, source)["size"]
    camera = np.zeros((), STRUCTS["Camera"])
    camera["width"], camera["height"] = 640, 360
    out = device.empty(2, np.uint32)
    kernel(camera[()], out, 1, count=1)
    np.testing.assert_array_equal(out.get(), [640, 360])
    for wrong in (np.zeros((), STRUCTS["Emitter"])[()], 5, None):
        with pytest.raises(TypeError, match="kernel size: argument camera"):
            kernel(wrong, out, 1, count=1)


def test_integers_may_stand_for_floats(device, scale):
    kernel, values = scale
    kernel(*swapped(values, 4, 3), count=5)
    np.testing.assert_array_equal(values[1].get(), 3 * values[0].get())


# Devices


def test_two_devices_in_one_process(device_spec, folder):
    """Programs, arrays and memory of two contexts side by side; an array of one is no argument of the other's kernels."""
    (folder / "scale.cl").write_text(SCALE)
    first, second = Device(device_spec), Device(device_spec, local_size=3)
    results = []
    for device in (first, second):
        values = device.upload(np.arange(30, dtype=np.float32).reshape(3, 10))
        results.append(device.empty((3, 10), np.float32))
        device.program("scale.cl")["scale"](values, results[-1], None, 10, 0.5, count=10)
    np.testing.assert_array_equal(results[0].get(), results[1].get())
    assert first.allocated == second.allocated == 240
    with pytest.raises(ValueError, match="kernel scale: argument values is an array of another device"):
        first.program("scale.cl")["scale"](results[1], results[0], None, 10, 0.5, count=10)


def test_memory_is_checked_before_it_is_taken(device):
    before = device.allocated
    with pytest.raises(DeviceError, match=r"a large array needs \d+\.\d\d GiB"):
        device.empty((2**20, 2**30), np.float32, "a large array")
    with pytest.raises(DeviceError, match="pair needs .*the largest array is big, "):
        device.check_fits("pair", {"small": 1, "big": device.capabilities.global_memory})
    assert device.allocated == before


def test_one_array_beyond_the_largest_allowed(device):
    largest = device.capabilities.max_allocation
    if largest + 1 + device.allocated > device.capabilities.global_memory:
        pytest.skip("this device allows one array of all its memory")
    device.check_fits("the scene", {"a": largest})
    with pytest.raises(DeviceError, match="the scene: the array b needs .* for one array"):
        device.check_fits("the scene", {"a": 1, "b": largest + 1})


@pytest.mark.parametrize("shape", [(0,), (3, 0), (1,), (5, 7)])
def test_upload_and_release(device, shape):
    before = device.allocated
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    array = device.upload(values)
    assert device.allocated - before == values.nbytes
    np.testing.assert_array_equal(array.get(), values)
    device.release(array)
    assert device.allocated == before
