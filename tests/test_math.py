"""The small functions of cl/common/math.cl and transform.cl against float64."""

import numpy as np
import pytest

from clcache.layout import STRUCTS

SOURCE = """
#include "common/transform.cl"

__kernel void turns(
    __global float *out,  // (2, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    float sine, cosine;
    sincos_turns(i * 5.9604645e-8f, &sine, &cosine);
    out[i] = sine;
    out[n + i] = cosine;
}

__kernel void logarithms(
    __global const float *v,  // (n)
    __global float *out,      // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) out[i] = log2_of(v[i]);
}

__kernel void angles(
    __global const float *y,  // (n)
    __global const float *x,  // (n)
    __global float *out,      // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) out[i] = atan2_turns(y[i], x[i]);
}

__kernel void unit(
    __global const float *v,  // (3, n)
    __global float *out,      // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) store_planes(out, n, i, normalize3(load_vec3(v, n, i)));
}

__kernel void products(
    __global const float *a,  // (3, n)
    __global const float *b,  // (3, n)
    __global float *dots,     // (n)
    __global float *crosses,  // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    dots[i] = dot3(load_vec3(a, n, i), load_vec3(b, n, i));
    store_planes(crosses, n, i, cross3(load_vec3(a, n, i), load_vec3(b, n, i)));
}

__kernel void transforms(
    __global const Instance *instance,  // (1)
    __global const float *v,            // (3, n)
    __global float *points,             // (3, n)
    __global float *vectors,            // (3, n)
    __global float *normals,            // (3, n)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Instance placed = instance[0];
    store_planes(points, n, i, transform_point(placed.to_world, load_vec3(v, n, i)));
    store_planes(vectors, n, i, transform_vector(placed.to_world, load_vec3(v, n, i)));
    store_planes(normals, n, i, transform_normal(placed.to_object, load_vec3(v, n, i)));
}
"""


@pytest.fixture(scope="module")
def program(device, tmp_path_factory):
    """The device's functions, each called by a kernel."""
    from clcache import program as module

    folder = tmp_path_factory.mktemp("cl")
    (folder / "common").symlink_to(module.SOURCE_FOLDER / "common")
    (folder / "math_test.cl").write_text(SOURCE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "SOURCE_FOLDER", folder)
        return device.program("math_test.cl")


def test_sine_and_cosine_of_every_turn(device, program):
    """All 2^24 multiples of 2^-24 that random numbers can be, and 1."""
    n = 2**24 + 1
    out = device.empty((2, n), np.float32)
    program["turns"](out, n, count=n)
    sine, cosine = out.get()
    device.release(out)
    angle = 2 * np.pi * (np.arange(n) / 2**24)
    worst = max(np.abs(sine - np.sin(angle)).max(), np.abs(cosine - np.cos(angle)).max())
    assert worst < 1.07e-7  # the bound that math.cl states
    length = np.hypot(sine.astype(np.float64), cosine)
    np.testing.assert_allclose(length, 1, rtol=0, atol=1.5e-7)
    quarters = np.arange(5) * 2**22
    np.testing.assert_array_equal(sine[quarters], [0, 1, 0, -1, 0])
    np.testing.assert_array_equal(cosine[quarters], [1, 0, -1, 0, 1])


def test_logarithm_of_every_magnitude(device, program):
    """All mantissas of two octaves, and numbers of all normal exponents."""
    octaves = np.arange(0x3F000000, 0x40000000, dtype=np.uint32).view(np.float32)
    rng = np.random.default_rng(4)
    anywhere = rng.integers(0x00800000, 0x7F800000, 2**20, dtype=np.uint32).view(np.float32)
    for values in (octaves, anywhere, np.float32([1, 2, 0.5, 2**-126])):
        out = device.empty(values.shape, np.float32)
        given = device.upload(values)
        program["logarithms"](given, out, values.size, count=values.size)
        exact = np.log2(values.astype(np.float64))
        assert (np.abs(out.get() - exact) <= 1.1e-7 + 2.0**-24 * np.abs(exact)).all()  # the bound that math.cl states
        device.release(given, out)


def test_angles_all_round(device, program):
    """Directions all round, of any length, and along the axes and diagonals."""
    n = 2**22
    angle = 2 * np.pi * (np.arange(n) / n - 0.5)
    length = 10.0 ** np.random.default_rng(5).uniform(-30, 30, n)
    x, y = ((length * f(angle)).astype(np.float32) for f in (np.cos, np.sin))
    out, given = device.empty(n, np.float32), [device.upload(c) for c in (y, x)]
    program["angles"](*given, out, n, count=n)
    away = out.get() - np.arctan2(y.astype(np.float64), x) / (2 * np.pi)
    assert (
        np.abs(away - np.round(away)).max() < 2.0**-24
    )  # the bound that math.cl states; half a turn is its opposite's
    places = np.float32([[0, 0], [0, 1], [1, 1], [1, 0], [1, -1], [0, -1], [-1, -1], [-1, 0], [-1, 1]])
    out, given = device.empty(9, np.float32), [device.upload(c) for c in places.T]
    program["angles"](*given, out, 9, count=9)
    np.testing.assert_allclose(out.get(), [0, 0, 0.125, 0.25, 0.375, 0.5, -0.375, -0.25, -0.125], rtol=0, atol=6e-8)


def test_unit_vectors_at_every_scale(device, program):
    rng = np.random.default_rng(1)
    v = (rng.normal(size=(3, 20_000)) * 10.0 ** rng.uniform(-38, 37, 20_000)).astype(np.float32)
    v[:, :4] = [[0, 1e-30, 3e38, 0], [0, 0, 3e38, -1e-38], [0, 0, -3e38, 0]]
    out = device.empty(v.shape, np.float32)
    program["unit"](device.upload(v), out, v.shape[1], count=v.shape[1])
    exact = v.astype(np.float64)
    exact[:, 1:] /= np.linalg.norm(exact[:, 1:], axis=0)
    normal = np.abs(v).max(axis=0) > 1e-36  # below, float32 itself has few digits left
    np.testing.assert_allclose(out.get()[:, normal], exact[:, normal], rtol=0, atol=2.5e-7)
    np.testing.assert_array_equal(out.get()[:, 0], 0)


def test_products_are_rounded_after_every_step(device, program):
    """Bit for bit what NumPy computes: no contraction to fused multiply-adds."""
    a, b = np.random.default_rng(2).normal(size=(2, 3, 10_000)).astype(np.float32)
    dots, crosses = device.empty(10_000, np.float32), device.empty((3, 10_000), np.float32)
    program["products"](device.upload(a), device.upload(b), dots, crosses, 10_000, count=10_000)
    np.testing.assert_array_equal(dots.get(), (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2])
    np.testing.assert_array_equal(crosses.get(), np.cross(a, b, axis=0))


def test_transforms(device, program):
    rng = np.random.default_rng(3)
    matrix = np.column_stack([rng.normal(size=(3, 3)), [10.0, -20, 30]])
    inverse = np.linalg.inv(np.vstack([matrix, [0, 0, 0, 1]]))[:3]
    record = np.zeros(1, STRUCTS["Instance"])
    record["to_world"], record["to_object"] = matrix.ravel(), inverse.ravel()
    v = rng.normal(size=(3, 1000)).astype(np.float32)
    results = [device.empty(v.shape, np.float32) for _ in range(3)]
    program["transforms"](device.upload(record), device.upload(v), *results, 1000, count=1000)
    points, vectors, normals = (r.get() for r in results)
    np.testing.assert_allclose(points, matrix[:, :3] @ v + matrix[:, 3:], rtol=0, atol=1e-5)
    np.testing.assert_allclose(vectors, matrix[:, :3] @ v, rtol=0, atol=2e-6)
    np.testing.assert_allclose(normals, np.linalg.inv(matrix[:, :3]).T @ v, rtol=0, atol=1e-5)
    across = matrix[:, :3] @ np.cross(v, rng.normal(size=(3, 1)), axis=0)  # within the plane, before and after
    cosines = np.einsum("in,in->n", normals, across) / np.linalg.norm(normals, axis=0) / np.linalg.norm(across, axis=0)
    assert np.abs(cosines).max() < 1e-5
