"""Updates of the octree's cells, against a model in NumPy and against what must be so whatever the numbers."""

import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import cube, make_scene
from hypothesis import given, settings
from hypothesis import strategies as st
from octree_model import (
    MOST_SAMPLES,
    NO_VERTEX,
    NONE,
    Cells,
    DeviceCells,
    HandOctree,
    Model,
    Vertices,
    dots,
    pack_normals,
    unfold_normals,
)
from octree_on_device import cell_keys
from overlap_model import world_corners
from scipy import stats

from clcache.octree import Octree
from clcache.passes.octree import BeginUpdate
from clcache.passes.octree_update import COUNTERS
from clcache.scene.geometry import Geometry

HALF_ROUNDING = 2.0**-10  # of a number between two halves, relative
UP, DOWN = (0, 0, 1), (0, 0, -1)
FUNCTIONS = """
#include "octree/merge.cl"

__kernel void look_up(
    __global const uint *octree_cells,  // (cells, 6)
    __global const uint *index,         // (n)
    __global const float *normal,       // (n, 3)
    __global float *light,              // (n, 3)
    __global uint *count,               // (n)
    uint wipe,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Side side = cell_side(octree_cells, index[i], row3(normal, i), wipe);
    store_row(light, i, side.light);
    count[i] = side.count;
}

__kernel void pack(
    __global const float *normal,  // (n, 3)
    __global uint *word,           // (n)
    __global float *unpacked,      // (n, 3)
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    word[i] = pack_normal(row3(normal, i));
    store_row(unpacked, i, unpack_normal(word[i]));
}

__kernel void merge_often(
    __global uint *octree_cells,  // (n, 6)
    uint updates,
    uint change,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    for (uint update = 0; update < updates; update++) {
        float4 front = (float4)((float3)(update < change ? 1.0f : 2.0f), 1.0f);
        merge_into_cell(octree_cells + words_of_cell(i), (float8)(front, (float4)(0.0f)), 0x80008000u, 1, pcg4d(i, update, 0, 0));
    }
}
"""


@pytest.fixture(scope="module")
def cell_functions(device):
    return device.program("cell_functions.cl", {"cell_functions.cl": FUNCTIONS})


def look_up(cell_functions, device, cells, index, normal):
    """Light (n, 3) and numbers of samples (n,) of the sides that face as the normals do."""
    n = len(index)
    light, count = device.empty((n, 3), np.float32), device.empty(n, np.uint32)
    given = [device.upload(np.asarray(index, np.uint32)), device.upload(np.asarray(normal, np.float32))]
    cell_functions["look_up"](device.upload(cells.words), *given, light, count, cells.wipe, n, count=n)
    return light.get(), count.get()


def units(rng, n):
    v = rng.normal(size=(n, 3))
    return (v / np.linalg.norm(v, axis=1)[:, None]).astype(np.float32)


def of_cells(keys, light, normal=UP):
    """A vertex for each key. light, normal: of each, or of all."""
    n = len(keys)
    normals = np.broadcast_to(np.asarray(normal, np.float32), (n, 3))
    return Vertices(np.asarray(keys, np.uint64), normals, np.broadcast_to(np.asarray(light, np.float32), (n, 3)).T)


def some_octree(device, rng, finest, cells):
    return HandOctree(device, np.unique(rng.integers(0, 8**finest, cells, dtype=np.uint64)), finest)


def some_vertices(rng, octree, n):
    """Vertices in few cells and in many, in none, without a cell, and such as are not finite."""
    few = octree.keys[: max(len(octree.keys) // 20, 1)]
    keys = np.where(rng.random(n) < 0.5, rng.choice(few, n), rng.choice(octree.keys, n))
    keys = np.where(rng.random(n) < 0.1, np.uint64(NO_VERTEX), keys)
    keys = np.where(rng.random(n) < 0.1, rng.integers(0, 8**octree.finest, n, dtype=np.uint64), keys)
    light = rng.exponential(size=(3, n)).astype(np.float32) * np.float32(10) ** rng.integers(-8, 6, n)
    light[rng.integers(0, 3, n), np.arange(n)] += np.where(rng.random(n) < 0.05, np.inf, 0)
    light[:, rng.random(n) < 0.03] = np.nan
    return Vertices(keys, units(rng, n), light.astype(np.float32))


def assert_same(cells, model):
    np.testing.assert_array_equal(cells.words, model.words)
    assert (cells.wipe, cells.occupied) == (model.wipe, model.occupied)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    finest=st.integers(0, 10),
    cells=st.integers(1, 400),
    vertices=st.integers(1, 1500),
    wipe=st.sampled_from([1, 2, 77, 2**32 - 1]),
)
def test_model(device, seed, finest, cells, vertices, wipe):
    rng = np.random.default_rng(seed)
    octree = some_octree(device, rng, finest, cells)
    on_device, model = DeviceCells(octree, vertices, wipe), Model(octree, wipe)
    for update in range(3):
        some = some_vertices(rng, octree, vertices)
        assert on_device.update(some, update, eye=update % 2) == model.update(some, update, eye=update % 2)
        assert_same(on_device.cells, model.cells)


def test_model_with_many_chunks(device, other_groups):
    rng = np.random.default_rng(3)
    keys, n = some_octree(device, rng, 6, 9000).keys, 20_000
    model = Model(HandOctree(device, keys, 6))
    vertices = some_vertices(rng, model.octree, n)
    counted = model.update(vertices, 5)
    for each in (device, other_groups):
        cells = DeviceCells(HandOctree(each, keys, 6), n)
        assert cells.update(vertices, 5) == counted
        assert_same(cells.cells, model.cells)


IN_CHILD = """
import sys
import numpy as np
from clcache.device import Device
from octree_model import DeviceCells, HandOctree
from test_octree_update import some_octree, some_vertices
device = Device(threads={threads})
rng = np.random.default_rng(11)
octree = some_octree(device, rng, 7, 30000)
cells = DeviceCells(octree, 60000)
for update in range(2):
    cells.update(some_vertices(rng, octree, 60000), update)
sys.stdout.buffer.write(cells.cells.words.tobytes())
print(cells.cells.occupied, device.threads, file=sys.stderr)
"""


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_one_and_two_threads():
    results = []
    for threads in (1, 2):
        environment = {
            k: v for k, v in os.environ.items() if k not in ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")
        }
        environment["PYTHONPATH"] = os.pathsep.join(p or os.getcwd() for p in sys.path)
        command = [sys.executable, "-c", IN_CHILD.format(threads=threads)]
        done = subprocess.run(command, env=environment, capture_output=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr.decode()
        occupied, used = done.stderr.decode().split()[-2:]
        assert int(used) == threads
        results.append((done.stdout, occupied))
    assert results[0] == results[1]
    assert np.frombuffer(results[0][0], np.uint32).any()


# What goes in comes out


def test_look_up_finds_the_inserted_mean(device, cell_functions):
    rng = np.random.default_rng(1)
    octree = some_octree(device, rng, 6, 2000)
    n, each = len(octree.keys), 4
    keys, light = np.tile(octree.keys, each), rng.exponential(size=(each * n, 3)).astype(np.float32)
    normals = np.tile(units(rng, n), (each, 1))
    cells = DeviceCells(octree, each * n)
    cells.update(of_cells(keys, light, normals))
    index = octree.find(octree.keys, octree.finest)
    found, count = look_up(cell_functions, device, cells.cells, index, normals[:n])
    np.testing.assert_allclose(found, light.reshape(each, n, 3).mean(axis=0), rtol=HALF_ROUNDING, atol=2.0**-24)
    assert (count == each).all()
    other_side = look_up(cell_functions, device, cells.cells, index, -normals[:n])
    assert not other_side[0].any() and not other_side[1].any()


def test_look_up_of_nothing(device, cell_functions):
    octree = HandOctree(device, np.arange(8, dtype=np.uint64), 1)
    cells = DeviceCells(octree, 1)
    cells.update(of_cells([5], 3.0))
    inserted, beside = octree.find(np.array([5, 4], np.uint64), 1)
    light, count = look_up(cell_functions, device, cells.cells, [inserted, beside, NONE], [UP] * 3)
    assert light[:, 0].tolist() == [3, 0, 0] and count.tolist() == [1, 0, 0]
    cells.wipe(2)
    light, count = look_up(cell_functions, device, cells.cells, [inserted, beside, NONE], [UP] * 3)
    assert not light.any() and not count.any()


def test_energy_put_in_is_stored_in_each_level(device):
    rng = np.random.default_rng(2)
    octree, n = some_octree(device, rng, 8, 3000), 8000
    cells, given = DeviceCells(octree, n), np.zeros(3)
    for update in range(3):
        light = rng.exponential(size=(n, 3)).astype(np.float32)
        cells.update(of_cells(rng.choice(octree.keys, n), light, units(rng, n)), update)
        given += light.sum(axis=0, dtype=np.float64)
    energy, count = cells.cells.energy, cells.cells.count
    for first, last in zip(octree.first_cell[:-1], octree.first_cell[1:], strict=True):
        np.testing.assert_allclose(energy[first:last].sum(axis=0), given, rtol=3 * HALF_ROUNDING)
        assert count[first:last].sum() == 3 * n


@pytest.mark.parametrize("resolution", [64, 2048, 4096])
def test_energy_of_points_on_surfaces(device, resolution):
    """Whatever lies on triangles has a cell, also where levels have several tables."""
    rng, n = np.random.default_rng(6), 5000
    placed = [(0, np.column_stack([size * np.eye(3), (place, place, 0)])) for size, place in ((0.02, 0), (0.01, 1))]
    geometry = Geometry.of(make_scene(cube(), instances=placed))
    octree = Octree(device, geometry, np.ones(2, bool), resolution)
    corners = world_corners(geometry, np.ones(2, bool))[rng.integers(0, 24, n)]
    points = np.einsum("nk,nkj->nj", rng.dirichlet([1, 1, 1], n), corners).astype(np.float32)
    keys, _ = cell_keys(device, octree.shape, points, octree.finest)
    light = rng.exponential(size=(n, 3)).astype(np.float32)
    cells = DeviceCells(octree, n, device=device)
    assert cells.update(of_cells(keys, light, units(rng, n)))["inserted"] == n
    energy = cells.cells.energy
    for first, last in zip(octree.first_cell[:-1], octree.first_cell[1:], strict=True):
        stored = energy[first:last].sum(axis=0)
        np.testing.assert_allclose(stored, light.sum(axis=0, dtype=np.float64), rtol=HALF_ROUNDING)


def test_an_octree_without_cells(device):
    octree = Octree(device, Geometry.of(make_scene(cube())), np.zeros(1, bool), 64)
    counted = DeviceCells(octree, 3, device=device).update(of_cells([0, 1, NO_VERTEX], 1.0))
    assert counted == dict.fromkeys(counted, 0) | {"discarded": 2, "capacity": 1}


def test_sides_of_a_thin_wall_do_not_mix(device, cell_functions):
    octree = HandOctree(device, np.array([3], np.uint64), 3)
    cells = DeviceCells(octree, 6)
    light, normals = [[2.0, 0, 0], [0, 0, 8.0], [4.0, 0, 0]] * 2, [UP, DOWN, (0, 0.6, 0.8)] * 2
    cells.update(of_cells([3] * 6, light, normals))
    for index in range(octree.cells):
        found, count = look_up(cell_functions, device, cells.cells, [index] * 2, [UP, DOWN])
        np.testing.assert_allclose(found, [[3, 0, 0], [0, 0, 8]])
        assert count.tolist() == [4, 2]


def test_parent_whose_normal_is_opposite_to_its_childs(device, cell_functions):
    octree = HandOctree(device, np.array([0, 1], np.uint64), 1)
    cells = DeviceCells(octree, 4)
    cells.update(of_cells([0, 1, 1, 1], [[1.0] * 3, [2.0] * 3, [4.0] * 3, [4.0] * 3], [UP, DOWN, UP, UP]))
    root, child, other = 0, *octree.find(octree.keys, 1)
    up, down = (look_up(cell_functions, device, cells.cells, [root, child, other], [n] * 3) for n in (UP, DOWN))
    assert up[0][:, 0].tolist() == [3, 1, 4] and up[1].tolist() == [3, 1, 2]
    assert down[0][:, 0].tolist() == [2, 0, 2] and down[1].tolist() == [1, 0, 1]
    fronts = unfold_normals(cells.cells.words[[root, other], 3])
    assert dots(fronts, np.array([UP, DOWN], np.float32)).min() > 0.9


def test_first_vertex_in_order_says_what_is_front(device):
    octree = HandOctree(device, np.array([9], np.uint64), 2)
    cells = DeviceCells(octree, 3)
    cells.update(of_cells([9] * 3, 1.0, [(1, 0, 0), UP, DOWN]))
    assert (cells.cells.words[:, 3] == pack_normals(np.array([(1, 0, 0)], np.float32))[0]).all()
    cells.update(of_cells([9] * 3, 1.0, [DOWN] * 3), 1)
    assert (cells.cells.words[:, 3] == pack_normals(np.array([(1, 0, 0)], np.float32))[0]).all()


# Rounding


@pytest.mark.parametrize("value", [1.0003, 0.37, 3001.7, 2.0**-14 * 0.77, 2.0**-24 * 0.3, 65500.0])
def test_rounding_to_halves_is_unbiased(device, value):
    """Z-test of the mean over 4,096 cells, whose halves are one of two by chance; at a significance of 1e-4."""
    octree = HandOctree(device, np.arange(4096, dtype=np.uint64), 4)
    cells = DeviceCells(octree, 4096)
    cells.update(of_cells(octree.keys, value))
    stored = cells.cells.light[octree.first_cell[-2] :, 0, 0].astype(np.float64)
    low, high = np.unique(stored)
    exact = float(np.float32(value))
    assert low < exact < high
    chance = (exact - low) / (high - low)
    statistic = (stored.mean() - exact) / ((high - low) * np.sqrt(chance * (1 - chance) / 4096))
    assert abs(statistic) < stats.norm.isf(0.5e-4)


def test_long_running_means_do_not_stall(device, cell_functions):
    """2,000 updates of 1, then 8,000 of 2: a mean that is rounded to the nearest half would stay at 1. The error of a step is at most half
    of the distance of two halves, and weighs n / 10,000 in the end: five standard deviations of the mean over the cells."""
    n, updates = 512, 10_000
    before = Cells(np.zeros((n, 6), np.uint32))
    before.words.view(np.float16)[:, 3:6] = np.random.default_rng(8).exponential(size=(n, 3))
    before.words[:, 4:] = 40_001 << 16, 1
    on_device = device.upload(before.words)
    cell_functions["merge_often"](on_device, updates, 2000, n, count=n)
    cells = Cells(on_device.get())
    deviation = 2.0**-11 * np.sqrt(updates / 3) / np.sqrt(3 * n)
    assert abs(cells.light[:, 0].astype(np.float64).mean() - 1.8) < 5 * deviation
    assert (cells.count == [updates, 40_001]).all()
    assert (cells.light[:, 1] == before.light[:, 1]).all()  # a side that gets nothing stays as it is


def test_numbers_of_samples_saturate(device):
    octree, n = HandOctree(device, np.array([0], np.uint64), 1), MOST_SAMPLES
    cells = DeviceCells(octree, n)
    for update, light in enumerate((6.0, 6.0, 0.0)):
        cells.update(of_cells([0] * n, light), update)
        assert (cells.cells.count == [MOST_SAMPLES, 0]).all()
    assert (cells.cells.light[:, 0] == 3).all()  # as if it had had as many before as in this update


def test_all_vertices_in_one_cell(device):
    octree, n = HandOctree(device, np.arange(512, dtype=np.uint64), 3), 230_400
    light = np.random.default_rng(4).exponential(size=(n, 3)).astype(np.float32)
    light[:, 0] = 0.1  # added one by one, without regard to the rounding, these make 0.4 % too little
    cells = DeviceCells(octree, n)
    assert cells.update(of_cells([77] * n, light))["inserted"] == n
    used = cells.cells.count[:, 0] > 0
    assert used.sum() == cells.cells.occupied == 4
    for mean in cells.cells.light[used, 0]:
        np.testing.assert_allclose(mean, light.mean(axis=0, dtype=np.float64), rtol=HALF_ROUNDING)


@pytest.mark.parametrize(("light", "stored"), [
    (65504.0, 65504), (65519.0, 65504), (1e6, 65504), (3e38, 65504), (1e-12, 0), (-1.0, 0),
])  # fmt: skip
def test_means_beyond_halves(device, light, stored):
    octree = HandOctree(device, np.array([0], np.uint64), 2)
    cells = DeviceCells(octree, 4)
    for update in range(3):
        assert cells.update(of_cells([0] * 4, [light, 0.0, 1.0]), update)["inserted"] == 4
    assert (cells.cells.light[:, 0] == [stored, 0, 1]).all()


def test_bright_samples_count_in_full_where_their_mean_is_a_half(device):
    octree = HandOctree(device, np.array([0], np.uint64), 1)
    cells = DeviceCells(octree, 4)
    cells.update(of_cells([0] * 4, np.array([[1.6e5], [0], [0], [0]]) * np.ones(3)))
    assert (cells.cells.light[:, 0] == 40_000).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_light_that_is_not_finite_is_left_out(device, bad):
    octree = HandOctree(device, np.array([0], np.uint64), 2)
    cells = DeviceCells(octree, 3)
    counted = cells.update(of_cells([0] * 3, [[1.0, 1.0, 1.0], [2.0, bad, 2.0], [3.0, 3.0, 3.0]]))
    assert (counted["inserted"], counted["discarded"]) == (2, 1)
    assert (cells.cells.light[:, 0] == 2).all() and (cells.cells.count[:, 0] == 2).all()


def test_vertices_without_a_cell_are_counted(device):
    octree = HandOctree(device, np.array([0, 7], np.uint64), 2)
    counted = DeviceCells(octree, 5).update(of_cells([0, 3, 64, NO_VERTEX, NO_VERTEX - 1], 1.0))
    assert (counted["inserted"], counted["discarded"]) == (1, 3)


def test_no_vertex_at_all(device):
    octree = HandOctree(device, np.array([0, 7], np.uint64), 2)
    cells = DeviceCells(octree, 700)
    cells.update(of_cells([7] * 700, 5.0))
    before = cells.cells
    counted = cells.update(of_cells([NO_VERTEX] * 700, np.nan), 1)
    assert (cells.cells.words == before.words).all()
    assert counted == dict.fromkeys(counted, 0) | {"occupied": 3, "capacity": octree.cells}


# Wipes


@pytest.mark.parametrize("stamp", [2, 2**32 - 1])
def test_wiped_cells_begin_anew(device, stamp):
    octree = HandOctree(device, np.arange(64, dtype=np.uint64), 2)
    cells = DeviceCells(octree, 8)
    first = cells.update(of_cells(octree.keys[:8], 5.0))
    assert (first["evicted"], first["occupied"]) == (0, 8 + 1 + 1)
    cells.wipe(stamp)
    second = cells.update(of_cells(octree.keys[4:12], 1.0, DOWN), 1)
    assert (second["evicted"], second["occupied"]) == (4 + 1 + 1, 8 + 2 + 1)
    used = cells.cells.count[:, 0] > 0
    assert used.sum() == 11 and not cells.cells.count[:, 1].any()
    assert (cells.cells.light[used, 0] == 1).all() and cells.cells.count[0, 0] == 8
    third = cells.update(of_cells(octree.keys[4:12], 1.0), 2)
    assert (third["evicted"], third["occupied"]) == (0, 11)
    assert (cells.cells.count[used, 1] > 0).all()


def test_stamps_of_wipes_leave_out_that_of_unused_cells(device):
    """A new octree has the first; where the light is another, the next one follows, and behind the last the first."""
    lighting = np.array([5, 6], np.uint32)
    arrays = {"counters": device.empty(len(COUNTERS), np.uint32), "misses": device.empty(1, np.uint32)}
    setup = SimpleNamespace(scene=SimpleNamespace(lighting=lighting), octree=SimpleNamespace(cells=9))
    for before, after in ((0, 1), (1, 2), (2**31, 2**31 + 1), (2**32 - 2, 2**32 - 1), (2**32 - 1, 1)):
        arrays["octree_wipe"] = device.upload(np.array([before, 5, 7, 4], np.uint32))
        for occupied in (0, 3):  # the light is another, then the same
            assert [*BeginUpdate(setup).run(arrays, None)]
            assert arrays["octree_wipe"].get().tolist() == [after, 5, 6, occupied]
            assert arrays["counters"].get()[COUNTERS.index("occupied")] == occupied
            arrays["octree_wipe"].set(np.array([after, 5, 6, 3], np.uint32))


# Normals


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_normals_as_words(device, cell_functions, seed):
    rng = np.random.default_rng(seed)
    normals = units(rng, 500)
    flat = np.sign(rng.integers(-1, 2, (100, 3)) + np.array([0, 0, 1e-3]))  # axes, diagonals and what is between
    normals[:100] = np.where(
        rng.random((100, 1)) < 0.5, flat * [1, 1, 0] + np.eye(3)[rng.integers(0, 3, 100)] * 1e-20, flat
    )
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    words, unpacked = device.empty(500, np.uint32), device.empty((500, 3), np.float32)
    cell_functions["pack"](device.upload(normals), words, unpacked, 500, count=500)
    words, unpacked = words.get(), unpacked.get().astype(np.float64)
    np.testing.assert_array_equal(words, pack_normals(normals))
    assert words.all()
    np.testing.assert_allclose(np.linalg.norm(unpacked, axis=1), 1, atol=3e-7)
    angles = np.linalg.norm(np.cross(unpacked, normals.astype(np.float64)), axis=1)
    assert angles.max() < 7e-5 and dots(unpacked, normals).min() > 0


def test_broken_normals_are_words_that_mean_something(device, cell_functions):
    normals = np.array([[np.nan] * 3, [0, 0, 0], [np.inf, 0, 0]], np.float32)
    words, unpacked = device.empty(3, np.uint32), device.empty((3, 3), np.float32)
    cell_functions["pack"](device.upload(normals), words, unpacked, 3, count=3)
    assert words.get().all() and np.isfinite(unpacked.get()).all()
