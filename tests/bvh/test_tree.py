"""The trees themselves, with their invariants derived anew from the arrays that the device holds."""

import numpy as np
import pytest
from helpers import IDENTITY, blob, cube, make_mesh, make_scene, moved, soup
from hypothesis import given, settings
from hypothesis import strategies as st

from clcache.bvh import SceneTrees
from clcache.bvh.build import LEAF_SIZE
from clcache.scene.geometry import NONE, Geometry, instance_bounds

# Levels that the stacks of cl/bvh/trace.cl have room for.
MAX_DEPTH = 96


def twins(n):
    """`n` copies of one triangle: every key is the same."""
    return make_mesh(np.tile(np.random.default_rng(1).normal(size=(3, 3)), (n, 1)), np.arange(3 * n))


def concentric(n):
    """`n` triangles of different sizes whose boxes have one centre."""
    sizes = np.linspace(1, 2, n)[:, None, None]
    return make_mesh((sizes * [[-1, -1, -1], [1, 1, 1], [1, -1, 0]]).reshape(-1, 3), np.arange(3 * n))


def flat(n):
    """`n` random triangles in the plane y = 3."""
    mesh = soup(n, 3)
    mesh.positions[:, 1] = 3
    return mesh


def clustered(n):
    """Triangles at places that halve the distance to the origin again and again: as deep a tree as keys allow."""
    places = np.repeat(0.5 ** np.arange(n)[:, None], 3, axis=1)
    corners = places[:, None] + 0.01 * places[:, None] * np.random.default_rng(4).normal(size=(n, 3, 3))
    return make_mesh(corners.reshape(-1, 3), np.arange(3 * n))


SCENES = {
    **{f"{n} triangles": (lambda n=n: [soup(n, n)]) for n in (*range(1, 10), 63, 64, 65, 1000)},
    "blob": lambda: [blob(4)],
    "twins": lambda: [twins(1000)],
    "concentric": lambda: [concentric(777)],
    "flat": lambda: [flat(500)],
    "clustered": lambda: [clustered(60), twins(300), clustered(30)],
    "many": lambda: [soup(1 + k % 5, k) for k in range(300)],
    "mixed": lambda: [soup(1, 1), blob(2), twins(9), soup(5, 2), cube(), soup(4, 3)],
    "tiny and far": lambda: [moved(blob(2), 1e-6), moved(blob(2), 1, [1e6, 0, 0]), moved(cube(), 1e6)],
}


def walk(nodes, root, root_count):
    """Visit a tree: its leaves as (begin, count), how many levels of inner nodes it has, and these."""
    leaves, depth, inner = [], 0, []
    level = [(int(root), int(root_count))]
    while level:
        below = []
        for child, count in level:
            if count:
                leaves.append((child, count))
            else:
                inner.append(child)
                below += zip(nodes["child"][child].tolist(), nodes["count"][child].tolist(), strict=True)
        assert len(inner) <= len(nodes)  # else nodes are their own descendants
        depth += bool(below)
        level = below
    return leaves, depth, inner


def check_tree(nodes, root, root_count, low, high, leaf_size):
    """low, high: (n, 3), the boxes in the tree's order. Returns which of them the leaves hold, and the depth."""
    leaves, depth, inner = walk(nodes, root, root_count)
    covered = np.concatenate([np.arange(begin, begin + count) for begin, count in leaves])
    assert max(count for _, count in leaves) <= leaf_size
    assert len(set(inner)) == len(inner) == len(leaves) - 1
    for node in inner:
        for side in range(2):
            child, count = int(nodes["child"][node, side]), int(nodes["count"][node, side])
            below = np.concatenate([np.arange(b, b + c) for b, c in walk(nodes, child, count)[0]])
            np.testing.assert_array_equal(nodes["low"][node].reshape(2, 3)[side], low[below].min(axis=0))
            np.testing.assert_array_equal(nodes["high"][node].reshape(2, 3)[side], high[below].max(axis=0))
    return covered, depth


@pytest.mark.parametrize("name", SCENES)
def test_trees_of_meshes(device, name):
    meshes = SCENES[name]()
    trees = SceneTrees(device, Geometry.of(make_scene(*meshes)), moves=np.ones(len(meshes), bool))
    geometry = trees.merged.geometry
    nodes, leaves, records = trees.nodes.get(), trees.leaves.get(), trees.placed.get()
    assert len(nodes) == len(geometry.triangles) - 1
    corners = leaves[:, :, :3]
    number = leaves[:, 0, 3].copy().view(np.uint32)
    for k, mesh in enumerate(meshes):
        begin, end = geometry.first_triangle[k], geometry.first_triangle[k + 1]
        root, root_count = records["root"][k], records["root_count"][k]
        assert root_count == (len(mesh.triangles) if len(mesh.triangles) <= LEAF_SIZE else 0)
        covered, depth = check_tree(nodes, root, root_count, corners.min(axis=1), corners.max(axis=1), LEAF_SIZE)
        np.testing.assert_array_equal(np.sort(covered), np.arange(begin, end))
        np.testing.assert_array_equal(np.sort(number[begin:end]), np.arange(len(mesh.triangles)))
        np.testing.assert_array_equal(corners[begin:end], mesh.positions[mesh.triangles[number[begin:end]]])
        assert depth <= MAX_DEPTH
        np.testing.assert_array_equal(records["low"][k], corners[begin:end].min(axis=(0, 1)))
        np.testing.assert_array_equal(records["high"][k], corners[begin:end].max(axis=(0, 1)))
        assert records["first_triangle"][k] == begin
        assert records["number"][k] == k
        assert (leaves[begin:end, 1, 3].copy().view(np.uint32) == NONE).all()


def test_meshes_that_stand_alone_are_one(device):
    """Two meshes that are placed once join in world space; one that moves and one that is placed twice stay apart."""
    meshes = [soup(7, 1), soup(20, 2), soup(5, 3), soup(6, 4)]
    shift = np.column_stack([np.diag([2.0, 1.0, -1.0]), [1.0, 2.0, 3.0]])
    scene = make_scene(*meshes, instances=[(1, shift), (3, IDENTITY), (0, IDENTITY), (2, IDENTITY), (2, shift)])
    trees = SceneTrees(device, Geometry.of(scene), moves=np.array([False, True, False, False, False]))
    placed, leaves = trees.placed.get(), trees.leaves.get()
    assert placed["number"].tolist() == [NONE, 1, 3, 4]
    np.testing.assert_array_equal(placed["to_object"][0], np.eye(3, 4).ravel())
    names = leaves[:27, :2, 3].copy().view(np.uint32)
    assert sorted(map(tuple, names)) == sorted([(k, 0) for k in range(20)] + [(k, 2) for k in range(7)])
    for (primitive, instance), corners in zip(names, leaves[:27, :, :3], strict=True):
        mesh = meshes[1 if instance == 0 else 0]
        local = mesh.positions[mesh.triangles[primitive]].astype(float)
        world = local @ shift[:, :3].T + shift[:, 3] if instance == 0 else local
        np.testing.assert_array_equal(corners, world.astype(np.float32))
    assert (leaves[27:, 1, 3].copy().view(np.uint32) == NONE).all()


@pytest.mark.parametrize("count", [1, 2, 3, 64, 1000])
def test_tree_of_instances(device, count):
    rng = np.random.default_rng(count)
    matrices = [np.column_stack([np.eye(3) * rng.uniform(0.1, 2), rng.uniform(-9, 9, 3)]) for _ in range(count)]
    geometry = Geometry.of(make_scene(soup(5, 1), cube(), instances=[(k % 2, m) for k, m in enumerate(matrices)]))
    trees = SceneTrees(device, geometry, moves=np.ones(count, bool))
    order = trees.top_order.get()
    low, high = instance_bounds(geometry)
    covered, depth = check_tree(trees.top_nodes.get(), trees.top_root, count == 1, low[order], high[order], leaf_size=1)
    np.testing.assert_array_equal(np.sort(covered), np.arange(count))
    np.testing.assert_array_equal(np.sort(order), np.arange(count))
    assert depth <= MAX_DEPTH
    np.testing.assert_array_equal(trees.bounds.get(), [*low.min(axis=0), *high.max(axis=0)])


def test_boxes_of_instances_hold_what_float32_makes_of_their_corners():
    rng = np.random.default_rng(3)
    matrices = [
        np.column_stack([rng.normal(size=(3, 3)), 10.0 ** rng.uniform(-3, 6) * rng.normal(size=3)]) for _ in range(200)
    ]
    geometry = Geometry.of(make_scene(cube(), instances=[(0, m) for m in [*matrices, IDENTITY]]))
    low, high = instance_bounds(geometry)
    points = geometry.positions
    world = np.einsum("ijk,vk->ivj", geometry.to_world[:, :, :3], points) + geometry.to_world[:, None, :, 3]
    assert world.dtype == low.dtype == np.float32
    assert (low[:, None] <= world).all()
    assert (world <= high[:, None]).all()
    np.testing.assert_array_equal(low[-1], points.min(axis=0))
    np.testing.assert_array_equal(high[-1], points.max(axis=0))


def test_transforms_to_object_space_invert_the_rounded_ones():
    rng = np.random.default_rng(5)
    matrices = [np.column_stack([rng.normal(size=(3, 3)), 1e5 * rng.normal(size=3)]) for _ in range(50)]
    geometry = Geometry.of(make_scene(cube(), instances=[(0, m) for m in matrices]))
    for there, back in zip(geometry.to_world.astype(np.float64), geometry.to_object, strict=True):
        exact = np.linalg.inv(np.vstack([there, [0, 0, 0, 1]]))[:3]
        np.testing.assert_allclose(back, exact, rtol=1e-7)


# The sort and the keys


def sort_on(device, keys, bits):
    """The device's radix sort, alone: sorted keys, and where each came from."""
    trees = SceneTrees.__new__(SceneTrees)
    trees._device, trees._program = device, device.program("bvh/build.cl")
    order = np.arange(len(keys), dtype=np.uint32)
    sorted_keys, sorted_order = trees._sort(device.upload(keys), device.upload(order), bits)
    return sorted_keys.get(), sorted_order.get()


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 700), distinct=st.integers(1, 1000), bits=st.integers(1, 64), seed=st.integers(0, 2**32 - 1))
def test_sort_is_right_and_stable(device, n, distinct, bits, seed):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 2**64, distinct, dtype=np.uint64) >> np.uint64(64 - bits)
    keys = rng.choice(values, n)
    sorted_keys, order = sort_on(device, keys, bits)
    expected = np.argsort(keys, kind="stable")
    np.testing.assert_array_equal(order, expected)
    np.testing.assert_array_equal(sorted_keys, keys[expected])


def test_sort_of_many_keys(device):
    keys = np.random.default_rng(6).integers(0, 2**40, 300_001, dtype=np.uint64) << np.uint64(23)
    np.testing.assert_array_equal(sort_on(device, keys, 63)[1], np.argsort(keys, kind="stable"))


def morton_in_python(place, bits):
    """Interleave the bits of whole x, y, z: x leads."""
    code = 0
    for bit in reversed(range(bits)):
        for axis in range(3):
            code = code << 1 | (int(place[axis]) >> bit & 1)
    return code


@pytest.mark.parametrize("axis_bits", [1, 10, 21])
def test_morton_codes(device, axis_bits):
    """Boxes that are points, at the middles of random cells of the unit cube, in two segments."""
    rng = np.random.default_rng(axis_bits)
    cells = rng.integers(0, 2**axis_bits, (200, 3))
    cells[:2] = [[0], [2**axis_bits - 1]]
    points = ((cells + 0.5) / 2**axis_bits).astype(np.float32)
    segment = (np.arange(200) % 2).astype(np.uint32)
    bounds = np.repeat(np.float32([[0], [0], [0], [1], [1], [1]]), 2, axis=1)
    keys, order = device.empty(200, np.uint64), device.empty(200, np.uint32)
    boxes = device.upload(np.concatenate([points.T, points.T]))
    kernel = device.program("bvh/build.cl")["morton_keys"]
    kernel(boxes, device.upload(segment), device.upload(bounds), keys, order, 200, 2, axis_bits, count=200)
    expected = [(k % 2) << (3 * axis_bits) | morton_in_python(cells[k], axis_bits) for k in range(200)]
    np.testing.assert_array_equal(keys.get(), np.array(expected, np.uint64))
    np.testing.assert_array_equal(order.get(), np.arange(200))


def test_points_on_the_far_side_of_the_bounds_stay_in_the_last_cell(device):
    points = np.float32([[0, 0, 0], [1, 1, 1], [1, 0, 1]]).T
    bounds = device.upload(np.float32([[0, 0, 0, 1, 1, 1]]).T)
    keys, order = device.empty(3, np.uint64), device.empty(3, np.uint32)
    kernel = device.program("bvh/build.cl")["morton_keys"]
    segment = device.upload(np.zeros(3, np.uint32))
    kernel(device.upload(np.concatenate([points, points])), segment, bounds, keys, order, 3, 1, 4, count=3)
    np.testing.assert_array_equal(keys.get(), [0, 0xFFF, 0b101101101101])


# Whole builds


def test_build_does_not_depend_on_the_work_group_size(device, other_groups):
    geometry = Geometry.of(make_scene(blob(3), twins(100), soup(33, 9)))
    first, second = (SceneTrees(d, geometry) for d in (device, other_groups))
    for name in ("nodes", "leaves", "top_nodes", "top_order", "placed", "bounds"):
        assert getattr(first, name).get().tobytes() == getattr(second, name).get().tobytes(), name


def test_nearby_triangles_share_subtrees(device):
    """The keys do their work: boxes of a tree over ordered space are far smaller than those over shuffled triangles."""
    trees = SceneTrees(device, Geometry.of(make_scene(soup(4000, 10, 0.01))))
    nodes = trees.nodes.get()
    extent = (nodes["high"] - nodes["low"]).reshape(-1, 2, 3)
    assert np.median(extent.prod(axis=-1)) < 8 / 500


def test_build_gives_back_what_it_needs_no_more(device):
    before = device.allocated
    trees = SceneTrees(device, Geometry.of(make_scene(blob(3), cube())))
    assert device.allocated - before == trees.nbytes
