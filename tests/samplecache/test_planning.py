"""Which samples are traced, and where samples are added and purged, against NumPy."""

from types import SimpleNamespace

import numpy as np
import pytest
from cache_model import join_mask, split_mask
from render_helpers import view
from scipy import stats

from clcache.passes.reproject import COUNTERS, cache_defines, counter_defines, list_capacity, mask_words, pixel_diagonal
from clcache.passes.retrace import TRACINGS
from clcache.passes.trace import path_count
from clcache.random import random4
from clcache.renderer import camera_record

NONE = 0xFFFFFFFF
NO_NEAREST = np.uint64(2**64 - 1)
NEW = np.uint32(1 << 31)
IS_EDGE, ADD, PURGE = 1, 2, 4
SLOPES, TOLERANCE = np.float32(4), np.float32(0.005)  # as in plan.cl
DENSITY = 0x10000  # the dimension of its random numbers
KEY = (77, 88)
SIZE = (37, 22)
SLOTS = 12
INFINITY = np.float32(np.inf)


def camera_of(size, camera=None):
    return camera_record(camera or view((0, 0, 0), (0, 0, -1), 40), size)


def pixel_order(size):
    """(n,): the pixel of each path, blocks of 4 x 4 row by row; `list_traced` takes any order of blocks."""
    width, height = size
    x, y = np.meshgrid(np.arange(-(-width // 4) * 4), np.arange(-(-height // 4) * 4))
    pixel = np.where((x < width) & (y < height), x + y * width, NONE).astype(np.uint32)
    return pixel.reshape(y.shape[0] // 4, 4, -1, 4).transpose(0, 2, 1, 3).ravel()


class Plan:
    """The two kernels of plan.cl over arrays."""

    def __init__(self, device, size=SIZE, slots=SLOTS, tracing="adaptive", superresolution=None):
        self.device, self.size, self.slots, self.tracing = device, size, slots, tracing
        defines = cache_defines(slots, True, superresolution) | {"TRACING": TRACINGS.index(tracing)}
        self.program = device.program("samplecache/plan.cl", **defines, **counter_defines())
        self.pixels, self.paths = size[0] * size[1], path_count(size)

    def assess(self, mask, nearest=None, farthest=None, density=(3.0, 5.0), update=0):
        """(pixels,): what is decided. mask: (pixels,) uint64."""
        device, n = self.device, self.pixels
        arrays = {"mask": split_mask(mask, self.slots)}
        if self.tracing == "adaptive":
            some = np.full(n, np.float32(1).view(np.uint32))
            arrays["nearest"] = some.astype(np.uint64) << np.uint64(32) if nearest is None else nearest
            arrays["farthest"] = some if farthest is None else farthest
        arrays = {name: device.upload(values) for name, values in arrays.items()}
        arrays["plan"] = device.empty(n, np.uint8)
        scalars = {"pixels": n, "words": mask_words(self.slots), "least": density[0], "most": density[1]}
        draws = {"update": update, "key0": KEY[0], "key1": KEY[1]}
        self.program["assess"].run(n, arrays, camera=camera_of(self.size), **scalars, **draws)
        decided = arrays["plan"].get()
        device.release(*arrays.values())
        return decided

    def list_traced(self, mask, plan, update=0):
        """What comes of decisions: mask, samples (in the list's order), is_new of each, counters, traced (the AOV), groups."""
        device, paths = self.device, self.paths
        groups, batch = -(-paths // 64), max(paths, 128 * self.slots)
        room = 2 * list_capacity(paths, self.slots)
        given = {"pixel": pixel_order(self.size), "mask": split_mask(mask, self.slots), "plan": plan.astype(np.uint8)}
        given |= {"samples": np.full(room, 12345, np.uint32), "listed": np.zeros(4, np.uint32)}
        given |= {"counters": np.zeros(len(COUNTERS), np.uint32), "aov_trace": np.full(self.pixels, np.nan, np.float32)}
        given |= {name: np.zeros(groups, np.uint32) for name in ("group_first", "group_count")}
        arrays = {name: device.upload(values) for name, values in given.items()}
        scalars = {"n": paths, "pixels": self.pixels, "groups": groups, "batch": batch}
        draws = {"update": update, "key0": KEY[0], "key1": KEY[1]}
        self.program["list_traced"].run(groups, arrays, **scalars, **draws)
        length = int(arrays["listed"].get()[0])
        listed = arrays["samples"].get()[:length]
        found = {name: arrays[name].get() for name in ("group_first", "group_count")}
        samples = listed[listed != NONE]
        done = SimpleNamespace(
            mask=join_mask(arrays["mask"].get()), listed=listed, samples=samples & ~NEW, is_new=samples >= NEW, **found,
            counters=dict(zip(COUNTERS, arrays["counters"].get().tolist(), strict=True)), traced=arrays["aov_trace"].get(),
        )  # fmt: skip
        device.release(*arrays.values())
        return done

    def listed_slots(self, done, only_new=False):
        """(slots, pixels) bool."""
        chosen = np.zeros(self.slots * self.pixels, bool)
        chosen[done.samples[done.is_new] if only_new else done.samples] = True
        return chosen.reshape(self.slots, self.pixels)


def bits(mask, slots, shift=0):
    """(slots, pixels) bool: which slots are occupied; with shift = slots, visible."""
    return (mask >> np.arange(shift, shift + slots, dtype=np.uint64)[:, None] & np.uint64(1)).astype(bool)


def mask_of(occupied, visible):
    """(pixels,) uint64 from (slots, pixels) bool."""
    weights = np.uint64(1) << np.arange(len(occupied), dtype=np.uint64)[:, None]
    sums = [(part * weights).sum(axis=0, dtype=np.uint64) for part in (occupied, occupied & visible)]
    return sums[0] | sums[1] << np.uint64(len(occupied))


def random_mask(pixels, slots=SLOTS, part=0.4, seen=0.7, seed=1):
    rng = np.random.default_rng(seed)
    part = part * rng.choice([0.0, 0.5, 1.0, 2.0], (1, pixels), p=[0.1, 0.2, 0.4, 0.3])
    return mask_of(rng.random((slots, pixels)) < part, rng.random((slots, pixels)) < seen)


def around(values, size):
    """(9, pixels): of a pixel and its neighbours; those beyond the edge are those at the edge."""
    image = np.pad(values.reshape(size[1], size[0]), 1, mode="edge")
    return np.stack([image[j : j + size[1], i : i + size[0]].ravel() for j in range(3) for i in range(3)])


def density_of(mask, slots, size):
    """(pixels,) float32."""
    return around(bits(mask, slots).sum(axis=0), size).sum(axis=0).astype(np.float32) / np.float32(9)


def expected_densities(mask, slots, size, density, update):
    """(add, purge, sure): sure is False where rounding decides."""
    least, most = np.float32(density)
    mean, band = density_of(mask, slots, size), most - least
    chance = random4(np.arange(len(mask), dtype=np.uint32), update, DENSITY, KEY)[:, 0]
    lack, surplus = least - mean, mean - most
    lack, surplus = lack + np.where(lack > 0, band, 0), surplus + np.where(surplus > 0, band, 0)
    sure = (np.abs(chance - lack) > 1e-5) & (np.abs(chance - surplus) > 1e-5)
    return (chance < lack) | ~bits(mask, slots).any(axis=0), chance < surplus, sure


def key_of(distance, slope):
    """(pixels,) uint64, as reprojection writes `nearest`."""
    distance, slope = (np.asarray(v, np.float32).view(np.uint32).astype(np.uint64) for v in (distance, slope))
    return distance << np.uint64(32) | slope


def expected_edges(nearest, farthest, size):
    """(edge, sure): inequality 2 in float64 over the neighbourhood; sure is False where rounding decides."""
    key, far = around(nearest, size).min(axis=0), around(farthest, size).max(axis=0)
    t_min = (key >> np.uint64(32)).astype(np.uint32).view(np.float32).astype(np.float64)
    slope = (key & np.uint64(NONE)).astype(np.uint32).view(np.float32).astype(np.float64)
    t_max = far.view(np.float32).astype(np.float64)
    with np.errstate(invalid="ignore"):
        bound = (1 + float(TOLERANCE)) * (t_min + float(SLOPES) * slope)
        sure = ~(np.abs(t_max - bound) <= 1e-6 * bound) | np.isinf(bound)
        return ~((far != 0) & (np.isinf(t_min) | (t_max < bound))), sure


@pytest.mark.parametrize("size", [SIZE, (1, 1), (1, 9), (7, 1), (2, 2)])
@pytest.mark.parametrize("slots", [1, 12, 17, 32])
def test_densities_against_numpy(device, size, slots):
    """Bands of all widths, at several updates; in all modes the same."""
    pixels = size[0] * size[1]
    mask = random_mask(pixels, slots)
    for update, density in enumerate(
        [(3.0, 5.0), (4.0, 4.0), (0.4 * slots, 0.4 * slots + 0.3), (0.0, 32.0), (2.0, 2.9)]
    ):
        add, purge, sure = expected_densities(mask, slots, size, density, update)
        assert sure.mean() > 0.9 or pixels < 10
        for tracing in TRACINGS:
            decided = Plan(device, size, slots, tracing).assess(mask, density=density, update=update)
            np.testing.assert_array_equal((decided & ADD > 0)[sure], add[sure])
            np.testing.assert_array_equal((decided & PURGE > 0)[sure], purge[sure])
            assert not (decided & IS_EDGE).any()  # a wall without slope
            assert (
                not ((decided & ADD > 0) & (decided & PURGE > 0))[density_of(mask, slots, size) > 0].all()
                or pixels < 10
            )


def test_pixel_without_a_sample_gets_one_whatever_the_density(device):
    occupied = np.ones((SLOTS, SIZE[0] * SIZE[1]), bool)
    occupied[:, 100] = False
    mask = mask_of(occupied, occupied)
    decided = Plan(device).assess(mask)
    np.testing.assert_array_equal(np.flatnonzero(decided & ADD), [100])


@pytest.mark.parametrize(
    ("filled", "kind", "chance"), [(3, ADD, 0.25), (4, PURGE, 0.75), (3, PURGE, 0.0), (4, ADD, 0.0)]
)
def test_chance_of_a_change_where_the_band_is_narrow(device, filled, kind, chance):
    """3.25 samples wanted, all pixels with 3, or with 4: so many of them change as it takes, on average. Significance 0.001."""
    size = (300, 200)
    occupied = np.zeros((SLOTS, 60_000), bool)
    occupied[:filled] = True
    decided = Plan(device, size).assess(mask_of(occupied, occupied), density=(3.25, 3.25), update=5)
    changed = int((decided & kind > 0).sum())
    assert stats.binomtest(changed, decided.size, chance).pvalue > 0.001


@pytest.mark.parametrize("lack", [0.1, 0.5, 0.9])
def test_chance_of_a_change_grows_with_the_band(device, lack):
    """Below a band of half a sample it is that half and what is lacking, at most 1; significance 0.001."""
    size, density = (300, 200), (2 + lack, 2.5 + lack)
    occupied = np.zeros((SLOTS, 60_000), bool)
    occupied[:2] = True
    decided = Plan(device, size).assess(mask_of(occupied, occupied), density=density, update=6)
    assert stats.binomtest(int((decided & ADD > 0).sum()), decided.size, min(lack + 0.5, 1)).pvalue > 0.001


def random_extent(pixels, seed=2):
    """nearest, farthest: near walls and far ones, slopes of all sizes, background, and pixels where nothing is visible."""
    rng = np.random.default_rng(seed)
    nearest = (10 ** rng.uniform(-0.01, 0.01, pixels) * rng.choice([1, 1, 1, 1.05], pixels)).astype(np.float32)
    slope = (10 ** rng.uniform(-5, -0.5, pixels) * rng.choice([0, 1], pixels, p=[0.2, 0.8])).astype(np.float32)
    slope[rng.random(pixels) < 0.05] = np.inf
    farthest = (nearest * (1 + rng.choice([0, 0.003, 0.01, 0.1], pixels))).astype(np.float32)
    far = rng.random(pixels) < 0.1
    mixed = far & (rng.random(pixels) < 0.5)
    farthest[far] = np.inf
    nearest[far & ~mixed], slope[far & ~mixed] = np.inf, 0
    key, farthest = key_of(nearest, slope), farthest.view(np.uint32).copy()
    none = rng.random(pixels) < 0.3
    key[none], farthest[none] = NO_NEAREST, 0
    return key, farthest


@pytest.mark.parametrize("size", [(96, 64), (1, 200), (200, 1), (1, 1)])
def test_edges_against_numpy(device, size):
    pixels = size[0] * size[1]
    mask = random_mask(pixels)
    for seed in range(3):
        nearest, farthest = random_extent(pixels, seed)
        quiet = np.arange(pixels) % size[0] > size[0] // 2  # half of it has fewer of what makes edges
        nearest[quiet], farthest[quiet] = (
            key_of(np.ones(pixels), np.full(pixels, 1e-3))[quiet],
            np.float32(1.004).view(np.uint32),
        )
        edge, sure = expected_edges(nearest, farthest, size)
        decided = Plan(device, size).assess(mask, nearest, farthest)
        np.testing.assert_array_equal((decided & IS_EDGE > 0)[sure], edge[sure])
        assert sure.mean() > 0.95
        assert pixels == 1 or (0.1 < edge.mean() < 0.9)


def image_of(size, default, **places):
    """(H, W) float32, one value but for the pixels in the middle."""
    image = np.full((size[1], size[0]), default, np.float32)
    image[size[1] // 2, size[0] // 2] = places.get("middle", default)
    return image


@pytest.mark.parametrize(
    ("distance", "farthest", "slope", "is_edge"),
    [
        (INFINITY, INFINITY, 0.0, False),  # background alone
        (1.0, INFINITY, 0.0, True),  # background beside a surface
        (1.0, INFINITY, INFINITY, True),  # whatever its slope
        (1.0, 1.0, 0.0, False),
        (1.0, 1.00499, 0.0, False),  # within the tolerance
        (1.0, 1.00502, 0.0, True),
        (1e-6, 1.00499e-6, 0.0, False),  # at any scale
        (1e6, 1.00502e6, 0.0, True),
        (1.0, 1.4069, 0.1, False),  # four slopes behind it, 0.5 % more
        (1.0, 1.4071, 0.1, True),
        (1.0, 1e30, INFINITY, False),
    ],
)
def test_edges_by_inequality_two(device, distance, farthest, slope, is_edge):
    """One neighbourhood, the nearest and the farthest sample in different pixels of it; nowhere else is there an edge."""
    size = (7, 7)
    near = key_of(image_of(size, farthest, middle=distance).ravel(), image_of(size, 0.0, middle=slope).ravel())
    far = image_of(size, farthest).ravel().view(np.uint32)
    edge = (Plan(device, size).assess(random_mask(49), near, far) & IS_EDGE > 0).reshape(7, 7)
    expected = np.zeros((7, 7), bool)
    expected[2:5, 2:5] = is_edge
    np.testing.assert_array_equal(edge, expected)


def test_nothing_visible_is_not_flat(device):
    """A neighbourhood without a visible sample is traced; one visible sample among nine will do."""
    size, near, far = (9, 9), np.full(81, NO_NEAREST), np.zeros(81, np.uint32)
    assert (Plan(device, size).assess(random_mask(81), near, far) & IS_EDGE).all()
    near[40], far[40] = key_of(2.0, 0.1), np.float32(2).view(np.uint32)
    edge = (Plan(device, size).assess(random_mask(81), near, far) & IS_EDGE > 0).reshape(9, 9)
    assert not edge[3:6, 3:6].any()
    assert edge.sum() == 81 - 9


def plane_extent(size, tilt, camera, pieces=3):
    """nearest, farthest of a plane before the camera, turned by `tilt`: distances and slopes (Eq. 1) of pieces x pieces places in
    each pixel, in float64. It meets the axis of view at distance 10."""
    width, height = size
    x, y = np.meshgrid((np.arange(width * pieces) + 0.5) / pieces, (np.arange(height * pieces) + 0.5) / pieces)
    tangent = np.tan(camera.fov_y / 2)
    ray = np.stack(
        [(2 * x / width - 1) * tangent * width / height, (1 - 2 * y / height) * tangent, -np.ones_like(x)], axis=-1
    )
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    normal = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    cosine = -ray @ normal
    distance = 10 * np.cos(tilt) / cosine
    phi = np.arcsin(pixel_diagonal(camera_record(camera, size))["phi_sine"])
    theta = np.arccos(np.clip(cosine, -1, 1))
    slope = distance * np.abs(1 - np.cos(theta) / np.cos(theta - phi))
    assert (cosine > 0).all()
    key = key_of(distance, slope).reshape(height, pieces, width, pieces)
    farthest = distance.astype(np.float32).view(np.uint32).reshape(height, pieces, width, pieces)
    return key.min(axis=(1, 3)).ravel(), farthest.max(axis=(1, 3)).ravel()


@pytest.mark.parametrize("degrees", [0, 30, 60, 75])
def test_a_slanting_plane_is_flat(device, degrees):
    """So is one that is seen at a grazing angle, up to an elevation of a few pixels."""
    size, camera = (48, 32), view((0, 0, 0), (0, 0, -1), 10)
    nearest, farthest = plane_extent(size, np.radians(degrees), camera)
    assert not (Plan(device, size).assess(random_mask(48 * 32), nearest, farthest) & IS_EDGE).any()


def test_the_edge_of_a_box_before_a_wall_is_one(device):
    """Pixels on either side of the edge, and the corner's; no others."""
    size, camera = (48, 32), view((0, 0, 0), (0, 0, -1), 10)
    nearest, farthest = (a.reshape(32, 48) for a in plane_extent(size, 0.5, camera))
    before = [a.reshape(32, 48) for a in plane_extent(size, 0.5, camera)]
    nearest[8:20, 10:30] = key_of(np.full((12, 20), 9.0), np.zeros((12, 20)))
    farthest[8:20, 10:30] = np.float32(9).view(np.uint32)
    edge = (Plan(device, size).assess(random_mask(48 * 32), nearest.ravel(), farthest.ravel()) & IS_EDGE > 0).reshape(
        32, 48
    )
    expected = np.zeros((32, 48), bool)
    expected[7:21, 9:31] = True
    expected[9:19, 11:29] = False
    np.testing.assert_array_equal(edge, expected)
    nothing = Plan(device, size).assess(random_mask(48 * 32), *(a.ravel() for a in before)) & IS_EDGE
    assert not nothing.any()


def nothing_planned(pixels):
    return np.zeros(pixels, np.uint8)


@pytest.mark.parametrize("slots", [1, 12, 17, 32])
@pytest.mark.parametrize("size", [SIZE, (1, 1), (64, 32)])
def test_multi_traces_all(device, slots, size):
    plan = Plan(device, size, slots, "multi")
    mask = random_mask(plan.pixels, slots)
    done = plan.list_traced(mask, nothing_planned(plan.pixels), update=3)
    np.testing.assert_array_equal(plan.listed_slots(done), bits(mask, slots))
    np.testing.assert_array_equal(done.mask, mask)
    assert len(done.samples) == len(np.unique(done.samples)) == done.counters["retraced"] == bits(mask, slots).sum()
    np.testing.assert_array_equal(done.traced, bits(mask, slots).any(axis=0).astype(np.float32))


def test_groups_and_order_of_the_list(device):
    """Each group's part has its pixels in order of the paths, each one's samples together, in order of the slots."""
    plan = Plan(device, tracing="multi")
    mask = random_mask(plan.pixels)
    done = plan.list_traced(mask, np.full(plan.pixels, ADD), update=2)
    pixel, now = pixel_order(SIZE), bits(done.mask, SLOTS)
    for group, (first, count) in enumerate(zip(done.group_first, done.group_count, strict=True)):
        own = [p for p in pixel[64 * group : 64 * group + 64] if p != NONE]
        expected = [slot * plan.pixels + p for p in own for slot in np.flatnonzero(now[:, p])]
        np.testing.assert_array_equal(done.listed[first : first + count] & ~NEW, expected)


@pytest.mark.parametrize("slots", [1, 12, 32])
def test_single_traces_one_of_each_pixel_in_turn(device, slots):
    """One of a pixel's samples, three times in four a visible one. None of a still pixel is left out for long: all have had their
    turn after four updates for each, the visible ones after four for each three. Where none is visible, all have it at once."""
    plan = Plan(device, slots=slots, tracing="single")
    mask = random_mask(plan.pixels, slots)
    occupied, visible = bits(mask, slots), bits(mask, slots, slots)
    updates = 4 * int(occupied.sum(axis=0).max()) + 8
    traced = np.zeros((updates, *occupied.shape), bool)
    for update in range(updates):
        traced[update] = plan.listed_slots(plan.list_traced(mask, nothing_planned(plan.pixels), update + 7))
    seen = visible.any(axis=0)
    assert (traced[:, :, ~seen] == occupied[:, ~seen]).all()
    traced, occupied, visible = traced[:, :, seen], occupied[:, seen], visible[:, seen]
    assert (traced.sum(axis=1) == 1).all()
    assert not (traced & ~occupied).any()
    assert ((traced & visible).sum(axis=(0, 1)) >= updates // 4 * 3).all()
    for pixel in range(seen.sum()):
        for samples, needed in (
            (occupied, 4 * occupied[:, pixel].sum()),
            (visible, 4 * -(-visible[:, pixel].sum() // 3)),
        ):
            for first in (0, 3, 4):
                turns = traced[first : first + needed + 4, :, pixel].sum(axis=0)
                assert (turns[samples[:, pixel]] > 0).all(), f"samples {turns} in {needed + 4} updates"


@pytest.mark.parametrize("size", [SIZE, (64, 32)])
def test_adaptive_traces_one_sample_in_each_block_where_it_is_flat(device, size):
    """Of each block of 4 x 4 pixels one pixel, each once in 16 updates; of that, one sample, each in its turn."""
    plan = Plan(device, size)
    occupied = bits(random_mask(plan.pixels, part=0.5), SLOTS)
    occupied[0] = True
    mask = mask_of(occupied, occupied)
    runs, block = 16 * 3, block_of(size)
    traced = np.zeros((runs, *occupied.shape), int)
    for update in range(runs):
        traced[update] = plan.listed_slots(plan.list_traced(mask, nothing_planned(plan.pixels), update))
    per_pixel = traced.sum(axis=1)
    for begin in (0, 16, 32, 5):
        np.testing.assert_array_equal(per_pixel[begin : begin + 16].sum(axis=0), 1)
    per_block = np.stack([np.bincount(block, weights=counts) for counts in per_pixel])
    whole = np.bincount(block) == 16
    assert (per_block[:, whole] == 1).all()
    assert (per_block <= 1).all()
    often = occupied.sum(axis=0) >= 3
    assert traced.sum(axis=0)[:, often].max() == 1  # three turns, three samples
    assert ((traced.sum(axis=0) > 0) <= occupied).all()


def block_of(size):
    """(pixels,): the number of its block of 4 x 4 pixels."""
    x, y = np.meshgrid(np.arange(size[0]) // 4, np.arange(size[1]) // 4)
    return (y * -(-size[0] // 4) + x).ravel()


def test_adaptive_traces_all_at_edges_and_where_nothing_is_visible(device):
    plan = Plan(device)
    mask = random_mask(plan.pixels)
    occupied, visible = bits(mask, SLOTS), bits(mask, SLOTS, SLOTS)
    edge = np.random.default_rng(3).random(plan.pixels) < 0.3
    for update in range(3):
        done = plan.list_traced(mask, np.where(edge, IS_EDGE, 0), update)
        traced, all_of = plan.listed_slots(done), edge | ~visible.any(axis=0)
        np.testing.assert_array_equal(traced[:, all_of], occupied[:, all_of])
        assert traced[:, ~all_of].sum(axis=0).max() == 1
        part = traced.sum(axis=0) / np.maximum(occupied.sum(axis=0), 1)
        np.testing.assert_allclose(done.traced, part, rtol=1e-6)
        assert done.counters["retraced"] == traced.sum()


@pytest.mark.parametrize("tracing", TRACINGS)
@pytest.mark.parametrize("slots", [1, 2, 12, 32])
def test_purging_spares_the_last_sample_and_the_last_visible_one(device, slots, tracing):
    plan = Plan(device, slots=slots, tracing=tracing)
    mask = random_mask(plan.pixels, slots, part=0.3, seen=0.4)
    for update in range(4):
        done = plan.list_traced(mask, np.full(plan.pixels, PURGE), update)
        before, after = (bits(m, slots) for m in (mask, done.mask))
        seen_before, seen_after = (bits(m, slots, slots) for m in (mask, done.mask))
        gone = before & ~after
        assert not (after & ~before).any()
        np.testing.assert_array_equal(seen_after, seen_before & after)
        np.testing.assert_array_equal(seen_after.any(axis=0), seen_before.any(axis=0))
        # One goes wherever there is another one; of a pixel's samples of which one is visible, not that one.
        count, seen = before.sum(axis=0), seen_before.sum(axis=0)
        np.testing.assert_array_equal(gone.sum(axis=0), (count > 1).astype(int))
        assert not (gone & seen_before)[:, seen == 1].any()
        assert done.counters["purged"] == gone.sum()
        assert not plan.listed_slots(done)[~after].any()


@pytest.mark.parametrize(("occupied", "visible", "candidates"), [
    (0b101101110, 0b001100010, 0b101101110),  # several visible: all samples
    (0b101101110, 0b000100000, 0b101001110),  # one visible: the others
    (0b101101110, 0b000000000, 0b101101110),  # none visible: all
    (0b111111111111, 0b111111111111, 0b111111111111),
])  # fmt: skip
def test_purged_samples_are_chosen_evenly(device, occupied, visible, candidates):
    """Chi-square over the candidates, significance 0.001."""
    size = (200, 150)
    plan = Plan(device, size)
    mask = np.full(plan.pixels, occupied | visible << SLOTS, np.uint64)
    done = plan.list_traced(mask, np.full(plan.pixels, PURGE), update=11)
    gone = (bits(mask, SLOTS) & ~bits(done.mask, SLOTS)).sum(axis=1)
    chosen = np.array([candidates >> s & 1 for s in range(SLOTS)], bool)
    assert gone[~chosen].sum() == 0
    assert gone.sum() == plan.pixels
    assert stats.chisquare(gone[chosen]).pvalue > 0.001


@pytest.mark.parametrize("tracing", TRACINGS)
@pytest.mark.parametrize("slots", [1, 12, 17, 32])
def test_new_samples_take_a_free_slot_or_an_invisible_one(device, slots, tracing):
    """The lowest free slot; where all are occupied, the lowest of a sample that is not visible; where all are visible, none."""
    plan = Plan(device, slots=slots, tracing=tracing)
    rng = np.random.default_rng(5)
    occupied = bits(random_mask(plan.pixels, slots, part=0.6), slots) | (rng.random(plan.pixels) < 0.4)
    visible = occupied & ((rng.random(occupied.shape) < 0.7) | (rng.random(plan.pixels) < 0.3))
    add = rng.random(plan.pixels) < 0.8
    done = plan.list_traced(mask_of(occupied, visible), np.where(add, ADD, 0), update=4)
    expected = np.zeros_like(occupied)
    for pixel in np.flatnonzero(add):
        free, unseen = np.flatnonzero(~occupied[:, pixel]), np.flatnonzero(~visible[:, pixel])
        expected[(free if len(free) else unseen)[:1], pixel] = True
    fresh = plan.listed_slots(done, only_new=True)
    np.testing.assert_array_equal(fresh, expected)
    np.testing.assert_array_equal(done.mask, mask_of(occupied | fresh, visible & ~fresh))
    assert (fresh & occupied).any(), "the case of an overwritten sample is among these"
    assert (~fresh & add).any() or slots > 20
    # Beside the new ones what would have been traced without them, but for the one that was overwritten.
    rest = plan.listed_slots(done) & ~fresh
    assert not (rest & ~occupied).any()
    if tracing == "multi":
        np.testing.assert_array_equal(rest, occupied & ~fresh)
    counters = done.counters
    assert counters["created"] == fresh.sum()
    assert counters["purged"] == (fresh & occupied).sum()
    assert counters["retraced"] == rest.sum() == len(done.samples) - fresh.sum()


def test_new_sample_of_a_subpixel_grid_lies_in_any_free_cell(device):
    """With cells in place of slots the lowest would be in the same corner each time: chi-square, significance 0.001."""
    plan = Plan(device, (200, 150), 9, "multi", superresolution=3)
    for occupied, visible, cells in ((0b010010001, 0b010010001, 0b101101110), (0b111111111, 0b101010001, 0b010101110)):
        mask = np.full(plan.pixels, occupied | visible << 9, np.uint64)
        done = plan.list_traced(mask, np.full(plan.pixels, ADD), update=2)
        found = plan.listed_slots(done, only_new=True).sum(axis=1)
        chosen = np.array([cells >> s & 1 for s in range(9)], bool)
        assert found[~chosen].sum() == 0
        assert found.sum() == plan.pixels
        assert stats.chisquare(found[chosen]).pvalue > 0.001


@pytest.mark.parametrize("tracing", TRACINGS)
def test_counters_add_up(device, tracing):
    """Whatever is decided: samples after = before + created - purged; all that are listed are retraced or created."""
    plan = Plan(device, tracing=tracing)
    rng = np.random.default_rng(6)
    mask = random_mask(plan.pixels, part=0.7)
    for update in range(4):
        decided = rng.choice([0, ADD, PURGE, ADD | PURGE], plan.pixels) | rng.choice([0, IS_EDGE], plan.pixels)
        done = plan.list_traced(mask, decided, update)
        counters = done.counters
        before, after = (int(bits(m, SLOTS).sum()) for m in (mask, done.mask))
        assert after == before + counters["created"] - counters["purged"]
        assert counters["created"] + counters["retraced"] == len(done.samples)
        assert counters["created"] == done.is_new.sum()
        assert len(np.unique(done.samples)) == len(done.samples)
        mask = done.mask
