"""The trees themselves, with their invariants derived anew from the arrays that the device holds."""

import numpy as np
import pytest
from helpers import IDENTITY, blob, cube, make_mesh, make_scene, moved, soup
from hypothesis import given, settings
from hypothesis import strategies as st

from clcache.bvh import SceneTrees, build
from clcache.scene.geometry import NONE, Geometry, instance_bounds


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


def growing(n, ratio):
    """Triangles side by side, each `ratio` times as large as the one before: every one but the first fits its smaller neighbour best."""
    sizes = ratio ** np.arange(n)
    begins = np.cumsum(sizes) - sizes
    corners = np.zeros((n, 3, 3))
    corners[..., 0] = begins[:, None] + sizes[:, None] * [0, 1, 0]
    corners[:, 2, 1] = sizes
    return make_mesh(corners.reshape(-1, 3), np.arange(3 * n))


SCENES = {
    **{f"{n} triangles": (lambda n=n: [soup(n, n)]) for n in (*range(1, 10), 63, 64, 65, 1000)},
    "blob": lambda: [blob(4)],
    "twins": lambda: [twins(1000)],
    "concentric": lambda: [concentric(777)],
    "flat": lambda: [flat(500)],
    "clustered": lambda: [clustered(60), twins(300), clustered(30)],
    "growing": lambda: [growing(100, 2.0), growing(2000, 1.004)],
    "many": lambda: [soup(1 + k % 5, k) for k in range(300)],
    "mixed": lambda: [soup(1, 1), blob(2), twins(9), soup(5, 2), cube(), soup(4, 3)],
    "tiny and far": lambda: [moved(blob(2), 1e-6), moved(blob(2), 1, [1e6, 0, 0]), moved(cube(), 1e6)],
}


# How trees come about: small scenes are only divided; and so that all steps meet them: clustered to the end, and clustered somewhat,
# then divided in long ranges and short ones.
WAYS = {
    "divided": {},
    "clustered": {"_FEW_CLUSTERS": 1, "_BOXES_EACH": 1 << 30},
    "both": {"_FEW_CLUSTERS": 8, "_BOXES_EACH": 3, "_SHORT": 20},
}


@pytest.fixture(params=WAYS)
def way(request, monkeypatch):
    """Each way in turn."""
    for name, value in WAYS[request.param].items():
        monkeypatch.setattr(build, name, value)
    return request.param


def check_tree(nodes, reference, read_leaf):
    """Walk a tree; read_leaf(~reference): a leaf's items and the box around them. Returns all items, the box, the levels of nodes, and
    the nodes."""
    if reference < 0:
        items, low, high = read_leaf(~reference)
        return items, low, high, 0, []
    planes = nodes["planes"][reference].reshape(3, 2, 8)
    is_used = np.isfinite(planes[0, 0])
    count = np.count_nonzero(is_used)
    assert count >= 2 and is_used[:count].all()
    assert (planes[:, 0, count:] == np.inf).all() and (planes[:, 1, count:] == -np.inf).all()
    assert (nodes["child"][reference, count:] == 0).all()
    items, lows, highs, depth, seen = [], [], [], 0, [reference]
    for slot in range(count):
        child = int(nodes["child"][reference, slot])
        assert child < 0 or reference < child < len(nodes)
        below, low, high, levels, inner = check_tree(nodes, child, read_leaf)
        np.testing.assert_array_equal(planes[:, 0, slot], low)
        np.testing.assert_array_equal(planes[:, 1, slot], high)
        items, depth, seen = items + below, max(depth, levels + 1), seen + inner
        lows.append(low)
        highs.append(high)
    return items, np.min(lows, axis=0), np.max(highs, axis=0), depth, seen


def block_reader(blocks, geometry):
    """Read and check leaves that are blocks of triangles."""
    corners = geometry.positions[geometry.triangles]

    def read(leaf):
        block, count = leaf >> 3, (leaf & 7) + 1
        triangle = blocks["triangle"][block]
        assert (triangle[count:] == NONE).all() and (triangle[:count] < len(corners)).all()
        positions = blocks["positions"][block].reshape(3, 3, 8).transpose(2, 0, 1)
        np.testing.assert_array_equal(positions[:count], corners[triangle[:count]])
        assert np.isnan(positions[count:]).all()
        return triangle[:count].tolist(), positions[:count].min(axis=(0, 1)), positions[:count].max(axis=(0, 1))

    return read


def check_scene_trees(trees):
    """Every invariant of the trees of meshes; the depth of the deepest."""
    geometry = trees.merged.geometry
    nodes, blocks, records = trees.nodes.get(), trees.blocks.get(), trees.placed.get()
    read = block_reader(blocks, geometry)
    mesh, first = geometry.instance_mesh, geometry.first_triangle
    depth, seen = 0, []
    for k in range(len(first) - 1):
        (root,) = set(records["root"][mesh == k].tolist())
        items, low, high, levels, inner = check_tree(nodes, root, read)
        assert sorted(items) == list(range(first[k], first[k + 1]))
        assert (records["low"][mesh == k] == low).all() and (records["high"][mesh == k] == high).all()
        assert (records["first_triangle"][mesh == k] == first[k]).all()
        depth, seen = max(depth, levels), seen + inner
    assert len(seen) == len(set(seen)) and len(nodes) == max(len(seen), 1)
    return depth


@pytest.mark.parametrize("name", SCENES)
def test_trees_of_meshes(device, way, name):
    meshes = SCENES[name]()
    trees = SceneTrees(device, Geometry.of(make_scene(*meshes)), moves=np.ones(len(meshes), bool))
    depth = check_scene_trees(trees)
    top = (
        check_tree(trees.top_nodes.get(), trees.top_root, lambda leaf: ([leaf >> 3], np.zeros(3), np.ones(3)))[3]
        if (len(meshes) == 1)
        else trees.depth
    )
    assert trees.depth == max(depth, top) or len(meshes) > 1 and trees.depth >= depth
    assert trees.placed.get()["number"].tolist() == list(range(len(meshes)))


@pytest.mark.parametrize("count", [1, 8, 9])
def test_a_mesh_of_up_to_a_block_is_a_leaf(device, count):
    trees = SceneTrees(device, Geometry.of(make_scene(soup(count, 1))))
    (root,) = trees.placed.get()["root"].tolist()
    assert root == (~(count - 1) if count <= 8 else 0)


def test_meshes_that_stand_alone_are_one(device):
    """Two meshes that are placed once join in world space; one that moves and one that is placed twice stay apart."""
    meshes = [soup(7, 1), soup(20, 2), soup(5, 3), soup(6, 4)]
    shift = np.column_stack([np.diag([2.0, 1.0, -1.0]), [1.0, 2.0, 3.0]])
    scene = make_scene(*meshes, instances=[(1, shift), (3, IDENTITY), (0, IDENTITY), (2, IDENTITY), (2, shift)])
    trees = SceneTrees(device, Geometry.of(scene), moves=np.array([False, True, False, False, False]))
    check_scene_trees(trees)
    placed, blocks = trees.placed.get(), trees.blocks.get()
    assert placed["number"].tolist() == [NONE, 1, 3, 4]
    assert placed["first_triangle"].tolist() == [0, 32, 27, 27]
    np.testing.assert_array_equal(placed["to_object"][0], np.eye(3, 4).ravel())
    assert trees.joined_first.get().tolist() == [0, 20, 27]
    assert trees.joined_instance.get().tolist() == [0, 2]
    block, lane = np.nonzero(blocks["triangle"] < 27)
    for k in range(27):
        triangle = blocks["triangle"][block[k], lane[k]]
        corners = blocks["positions"][block[k]].reshape(3, 3, 8)[:, :, lane[k]]
        mesh, primitive = (meshes[1], triangle) if triangle < 20 else (meshes[0], triangle - 20)
        local = mesh.positions[mesh.triangles[primitive]].astype(float)
        world = local @ shift[:, :3].T + shift[:, 3] if triangle < 20 else local
        np.testing.assert_array_equal(corners, world.astype(np.float32))


def test_nothing_is_joined(device):
    trees = SceneTrees(device, Geometry.of(make_scene(cube())), moves=np.array([True]))
    assert trees.joined_first.get().tolist() == [0]
    assert trees.joined_instance.shape == (1,)


@pytest.mark.parametrize("count", [1, 2, 3, 64, 1000])
def test_tree_of_instances(device, way, count):
    rng = np.random.default_rng(count)
    matrices = [np.column_stack([np.eye(3) * rng.uniform(0.1, 2), rng.uniform(-9, 9, 3)]) for _ in range(count)]
    geometry = Geometry.of(make_scene(soup(5, 1), cube(), instances=[(k % 2, m) for k, m in enumerate(matrices)]))
    trees = SceneTrees(device, geometry, moves=np.ones(count, bool))
    low, high = instance_bounds(geometry)

    def read(leaf):
        assert leaf & 7 == 0
        return [leaf >> 3], low[leaf >> 3], high[leaf >> 3]

    items, _, _, depth, _ = check_tree(trees.top_nodes.get(), trees.top_root, read)
    assert sorted(items) == list(range(count))
    assert trees.depth == max(depth, check_scene_trees(trees))
    np.testing.assert_array_equal(trees.bounds.get(), [*low.min(axis=0), *high.max(axis=0)])


def test_equal_triangles_in_masses_are_halved(device, way):
    """A hundred thousand times the same box: an even tree, not one that grows by one box a round."""
    trees = SceneTrees(device, Geometry.of(make_scene(twins(100_000))))
    assert trees.depth <= 10
    assert np.sort(trees.blocks.get()["triangle"], axis=None)[:100_000].tolist() == list(range(100_000))


@pytest.mark.parametrize("ratio", [1.0001, 1.01])
def test_boxes_that_each_want_the_one_before_join_all_the_same(device, way, ratio, monkeypatch):
    rounds, build_sum = [], SceneTrees._sum
    monkeypatch.setattr(SceneTrees, "_sum", lambda self, counts: (rounds.append(1), build_sum(self, counts))[1])
    trees = SceneTrees(device, Geometry.of(make_scene(growing(5000, ratio))))
    check_scene_trees(trees)
    assert len(rounds) < 200


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
    trees._device, trees._program = device, device.program("bvh/build.cl", **build._DEFINES)
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


def keys_on(device, points, begins, bounds, axis_bits):
    """The kernel's keys of boxes that are points, and the order that it begins with."""
    n, segments = len(points), len(begins) - 1
    keys, order = device.empty(n, np.uint64), device.empty(n, np.uint32)
    boxes = device.upload(np.concatenate([points, points], axis=1))
    kernel = device.program("bvh/build.cl", **build._DEFINES)["morton_keys"]
    arrays = device.upload(np.array(begins, np.uint32)), device.upload(np.float32(bounds))
    kernel(boxes, *arrays, keys, order, n, segments, axis_bits, count=n)
    np.testing.assert_array_equal(order.get(), np.arange(n))
    return keys.get()


@pytest.mark.parametrize("axis_bits", [1, 10, 21])
def test_morton_codes(device, axis_bits):
    """Boxes that are points, at the middles of random cells of the unit cube, in two segments."""
    rng = np.random.default_rng(axis_bits)
    cells = rng.integers(0, 2**axis_bits, (200, 3))
    cells[:2] = [[0], [2**axis_bits - 1]]
    # Exact in float32 for 21 bits too: twice the middle would need 22.
    points = ((cells + (0.5 if axis_bits < 21 else 0.0)) / 2**axis_bits).astype(np.float32)
    begins = [0, 70, 200]
    keys = keys_on(device, points, begins, np.tile([0, 0, 0, 1, 1, 1], (2, 1)), axis_bits)
    segment = np.searchsorted(begins, np.arange(200), side="right") - 1
    expected = [int(s) << (3 * axis_bits) | morton_in_python(c, axis_bits) for s, c in zip(segment, cells, strict=True)]
    np.testing.assert_array_equal(keys, np.array(expected, np.uint64))


def test_points_on_the_far_side_of_the_bounds_stay_in_the_last_cell(device):
    points = np.float32([[0, 0, 0], [1, 1, 1], [1, 0, 1]])
    keys = keys_on(device, points, [0, 3], [[0, 0, 0, 1, 1, 1]], 4)
    np.testing.assert_array_equal(keys, [0, 0xFFF, 0b101101101101])


# Whole builds


def test_build_does_not_depend_on_the_work_group_size(device, other_groups, way):
    geometry = Geometry.of(make_scene(blob(3), twins(100), soup(33, 9)))
    first, second = (SceneTrees(d, geometry) for d in (device, other_groups))
    assert first.arrays.keys() == {
        *("top_nodes", "nodes", "blocks", "placed", "bounds", "joined_first", "joined_instance")
    }
    for name in first.arrays:
        assert first.arrays[name].get().tobytes() == second.arrays[name].get().tobytes(), name
    assert first.depth == second.depth


def test_nearby_triangles_share_blocks(device, way):
    """The blocks of a tree over ordered space are far smaller than the scene."""
    trees = SceneTrees(device, Geometry.of(make_scene(soup(4000, 10, 0.01))))
    positions = trees.blocks.get()["positions"].reshape(-1, 3, 3, 8)
    extent = np.nanmax(positions, axis=(1, 3)) - np.nanmin(positions, axis=(1, 3))
    assert np.median(extent.prod(axis=-1)) < 8 / 500


def test_build_gives_back_what_it_needs_no_more(device, way):
    before = device.allocated
    trees = SceneTrees(device, Geometry.of(make_scene(blob(3), cube())))
    assert device.allocated - before == trees.nbytes
    trees.move(trees.merged.geometry)
    assert device.allocated - before == trees.nbytes
