"""The steps of the tree builder, each against a model of its own: neighbours, pairs, divisions, and the collapse to wide nodes."""

import functools
import math

import numpy as np
import pytest
from helpers import make_mesh, make_scene, soup
from hypothesis import given, settings
from hypothesis import strategies as st

from clcache.bvh import SceneTrees, build
from clcache.layout import STRUCTS
from clcache.scene.geometry import NONE, Geometry

LANES, IS_LEAF = 16, 0x80000000


def kernels(device):
    return device.program("bvh/build.cl", **build._DEFINES)


def half_areas(low, high):
    x, y, z = np.moveaxis(high - low, -1, 0)
    return x * y + y * z + z * x


def random_boxes(rng, n, cells):
    """(n, 3) low and high, with many equal ones if there are few cells."""
    low = rng.integers(0, cells, (n, 3)).astype(np.float32)
    return low, low + rng.integers(0, cells, (n, 3)).astype(np.float32)


def nearest_in_numpy(low, high, segment):
    """For each box the neighbour with the least common area; of equal ones that whose place differs in the lowest bits."""
    n, result = len(low), []
    for i in range(n):
        best = (math.inf, NONE)
        for j in range(max(0, i - build.RADIUS), min(n, i + build.RADIUS + 1)):
            if j != i and segment[j] == segment[i]:
                area = half_areas(np.minimum(low[i], low[j]), np.maximum(high[i], high[j]))
                best = min(best, (float(area), i ^ j))
        result.append(NONE if best[1] == NONE else i ^ best[1])
    return np.array(result, np.uint32)


def partners_in_numpy(nearest, segment, by_place):
    chosen = [j != NONE and nearest[j] == i for i, j in enumerate(nearest)]
    result = [j if mutual else NONE for j, mutual in zip(nearest, chosen, strict=True)]
    for i in range(len(result) - 1) if by_place else ():
        if i % 2 == 0 and not chosen[i] and not chosen[i + 1] and segment[i] == segment[i + 1]:
            result[i], result[i + 1] = i + 1, i
    return np.array(result, np.uint32)


@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(1, 120), cells=st.integers(1, 40), segments=st.integers(1, 4), by_place=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_clusters_find_their_partners(device, n, cells, segments, by_place, seed):
    """Whole numbers, so that NumPy and the device compute the same areas, and many of them are equal."""
    rng = np.random.default_rng(seed)
    low, high = random_boxes(rng, n, cells)
    segment = np.sort(rng.integers(0, segments, n)).astype(np.uint32)
    places = n + 2 * build.RADIUS + LANES
    planes, names = np.zeros((6, places), np.float32), np.full(places, NONE)
    planes[:, build.RADIUS : build.RADIUS + n] = np.concatenate([low.T, high.T])
    names[build.RADIUS : build.RADIUS + n] = segment
    names = device.upload(names)
    nearest, partner = (device.upload(np.zeros(places, np.uint32)) for _ in range(2))
    counts = device.empty((2, 1), np.uint32)
    kernels(device)["nearest_neighbours"](device.upload(planes), names, nearest, places, n, count=-(-n // LANES))
    kernels(device)["match_clusters"](names, nearest, partner, counts, places, 1, n, by_place, count=1)
    expected = nearest_in_numpy(low, high, segment)
    np.testing.assert_array_equal(nearest.get()[:n], expected)
    pairs = partners_in_numpy(expected, segment, by_place)
    np.testing.assert_array_equal(partner.get()[:n], pairs)
    assert counts.get().ravel().tolist() == [np.count_nonzero(pairs != NONE) // 2] * 2


def binary_trees(device, monkeypatch, mesh, **ways):
    """The device's binary tree over a mesh: (clusters, root, boxes by their numbers as clusters), and the SceneTrees."""
    kept, collapse = [], SceneTrees._collapse

    def keep(self, binary, segments, has_blocks):
        if has_blocks:
            boxes = binary.boxes.get()[binary.order.get()]
            kept.append((binary.clusters.get(), int(binary.roots.get()[0]), boxes))
        return collapse(self, binary, segments, has_blocks)

    with monkeypatch.context() as patch:
        patch.setattr(SceneTrees, "_collapse", keep)
        for name, value in ways.items():
            patch.setattr(build, name, value)
        trees = SceneTrees(device, Geometry.of(make_scene(mesh)))
    return kept[0], trees


def least_cost(clusters, root, boxes):
    """What the best wide tree out of a binary one costs, by trying every way to share a node's places (in float64)."""
    n = len(boxes)

    def area(cluster):
        low, high = (boxes[cluster, :3], boxes[cluster, 3:]) if cluster < n else (
            clusters["low"][cluster - n], clusters["high"][cluster - n])  # fmt: skip
        return half_areas(low.astype(np.float64), high.astype(np.float64))

    def halves(cluster):
        return int(clusters["left"][cluster - n]), int(clusters["right"][cluster - n])

    @functools.cache
    def size(cluster):
        return 1 if cluster < n else sum(map(size, halves(cluster)))

    def leaf(cluster):
        return area(cluster) * (build.BLOCK_COST + build.TRIANGLE_COST * size(cluster))

    def shared(cluster, places):
        left, right = halves(cluster)
        return min(cost(left, k) + cost(right, places - k) for k in range(1, places))

    @functools.cache
    def cost(cluster, places):
        if cluster < n:
            return leaf(cluster)
        ways = [leaf(cluster)] if size(cluster) <= 8 else []
        ways.append(shared(cluster, 8) + build.NODE_COST * area(cluster))
        return min([*ways, *(shared(cluster, k) for k in range(2, places + 1))])

    return cost(root, 1)


def cost_of_wide_tree(trees):
    """The same sum over the nodes and leaves that there are."""
    nodes, blocks, record = trees.nodes.get(), trees.blocks.get(), trees.placed.get()[0]
    if record["root"] < 0:
        count = np.count_nonzero(blocks["triangle"] != NONE)
        return half_areas(*(record[side].astype(np.float64) for side in ("low", "high"))) * (
            build.BLOCK_COST + build.TRIANGLE_COST * count
        )
    planes = nodes["planes"].reshape(-1, 3, 2, 8).astype(np.float64)
    is_used = np.isfinite(planes[:, 0, 0])
    areas = half_areas(*(np.where(is_used[..., None], planes[:, :, side].swapaxes(1, 2), 0) for side in (0, 1)))
    per_leaf = build.BLOCK_COST + build.TRIANGLE_COST * ((~nodes["child"] & 7) + 1)
    per_child = np.where(nodes["child"] < 0, per_leaf, build.NODE_COST)
    whole = half_areas(record["low"].astype(np.float64), record["high"].astype(np.float64))
    return build.NODE_COST * whole + (areas * per_child * is_used).sum()


@settings(max_examples=25, deadline=None)
@given(n=st.integers(1, 150), size=st.sampled_from([0.01, 0.3, 3.0]), clustered=st.booleans(), seed=st.integers(0, 999))
def test_collapse_is_the_cheapest_there_is(device, n, size, clustered, seed):
    ways = {"_FEW_CLUSTERS": 1, "_BOXES_EACH": 1 << 30} if clustered else {}
    with pytest.MonkeyPatch.context() as patch:
        (clusters, root, boxes), trees = binary_trees(device, patch, soup(n, seed, size), **ways)
    assert math.isclose(cost_of_wide_tree(trees), least_cost(clusters, root, boxes), rel_tol=1e-5)


@pytest.mark.parametrize("few", [1, 1 << 20])
def test_pairs_hold_what_is_below_them(device, monkeypatch, few):
    (clusters, root, boxes), _ = binary_trees(device, monkeypatch, soup(700, 3), _FEW_CLUSTERS=few, _SHORT=50)
    n, below = len(boxes), {}

    def boxes_below(cluster):
        if cluster < n:
            return [cluster]
        pair = clusters[cluster - n]
        found = boxes_below(int(pair["left"])) + boxes_below(int(pair["right"]))
        np.testing.assert_array_equal(pair["low"], boxes[found, :3].min(axis=0))
        np.testing.assert_array_equal(pair["high"], boxes[found, 3:].max(axis=0))
        assert pair["triangles"] & ~np.uint32(IS_LEAF) == len(found)
        assert (np.diff(pair["costs"]) <= 0).all()
        below[cluster] = found
        return found

    assert sorted(boxes_below(root)) == list(range(n)) and len(below) == n - 1


def divide_once(device, low, high, triangles=None):
    """divide_ranges on all of some boxes: where the second half begins, and the order of the boxes."""
    n = len(low)
    items = np.zeros(n, STRUCTS["Item"])
    items["low"], items["minus_high"], items["cluster"] = low, -high, np.arange(n)
    items["triangles"] = 1 if triangles is None else triangles
    items, middle = device.upload(items), device.empty(1, np.uint32)
    kernels(device)["divide_ranges"](items, device.upload(np.array([[0, n]], np.uint32)), middle, n, 1, count=1)
    return int(middle.get()[0]), items.get()["cluster"]


def division_cost(low, high, triangles, first):
    """first: (n,) bool, the first half."""
    return sum(
        half_areas(low[half].min(axis=0), high[half].max(axis=0)) * triangles[half].sum() for half in (first, ~first)
    )


def best_division(low, high, triangles, bins):
    """The least cost over the borders of bins between the middles, along each axis."""
    middle, costs = low + high, []
    start, extent = middle.min(axis=0), np.ptp(middle, axis=0)
    for axis in np.flatnonzero(extent > 0):
        place = np.minimum((middle[:, axis] - start[axis]) * (bins / extent[axis]), bins - 1).astype(int)
        costs += [division_cost(low, high, triangles, place < border) for border in set(place) - {place.min()}]
    return min(costs)


@settings(max_examples=30, deadline=None)
@given(n=st.integers(64, 400), flat=st.booleans(), seed=st.integers(0, 2**32 - 1))
def test_divisions_are_the_best_among_bins(device, n, flat, seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-5, 5, (n, 3)).astype(np.float32) * np.float32([1, 0 if flat else 1, 1])
    high = low + (10 ** rng.uniform(-3, 0, (n, 1))).astype(np.float32)
    triangles = rng.integers(1, 9, n)
    middle, order = divide_once(device, low, high, triangles)
    assert sorted(order) == list(range(n)) and 0 < middle < n
    first = np.isin(np.arange(n), order[:middle])
    best = best_division(low.astype(float), high.astype(float), triangles, build._DEFINES["BINS"])
    # float32 may put a middle on a border into the bin beside it.
    assert division_cost(low.astype(float), high.astype(float), triangles, first) <= 1.01 * best


def test_two_heaps_are_parted(device):
    rng = np.random.default_rng(2)
    n = 5000
    is_far = rng.random(n) < 0.3
    low = (rng.uniform(0, 1, (n, 3)) + 100 * is_far[:, None] * [0, 0, 1]).astype(np.float32)
    middle, order = divide_once(device, low, low + np.float32(0.01))
    assert middle == np.count_nonzero(~is_far) and not is_far[order[:middle]].any()


@pytest.mark.parametrize("low", [np.zeros((50, 3)), np.full((50, 3), 3e38) * np.sign(np.arange(50) - 24.5)[:, None]])
def test_what_bins_cannot_part_is_halved(device, low):
    """One place; and distances that float32 has no number for."""
    low = low.astype(np.float32)
    middle, order = divide_once(device, low, low)
    assert middle == 25 and sorted(order) == list(range(50))


def test_a_triangle_mesh_of_points_has_a_tree(device):
    """No box has an area."""
    points = np.random.default_rng(1).normal(size=(500, 1, 3)).repeat(3, axis=1)
    trees = SceneTrees(device, Geometry.of(make_scene(make_mesh(points.reshape(-1, 3), np.arange(1500)))))
    assert np.sort(trees.blocks.get()["triangle"], axis=None)[:500].tolist() == list(range(500))
