"""Which samples are shaded: one of each pixel in turn; by importance, against a model in NumPy and in expectation."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from cache_model import NONE, split_mask
from helpers import cube, make_scene
from scipy import stats

from clcache.device import fill
from clcache.passes.radiance import Choose, CountImportance, radiance_buffers
from clcache.passes.reproject import COUNTERS, GROUP, cache_defines, list_capacity, mask_words
from clcache.passes.trace import OrderPixels, path_count
from clcache.random import stream_key
from clcache.resources import SceneResources

BACKGROUND = 0xFFFF  # in place of a count
MOST = 0xFFFE
BINS, COUNTS = 13, 1024
SLOTS = 12
SIZE = (29, 18)  # neither is a multiple of 4
SIZES = [(1, 1), (3, 5), (17, 9), SIZE]
SIGNIFICANCE = 1e-4  # of every statistical test; all seeds are fixed


@pytest.fixture(scope="module")
def resources(device):
    return SceneResources(device, make_scene(cube()))


@dataclass(frozen=True)
class Samples:
    """What a cache holds as far as the choice goes. occupied, visible: (slots, pixels) bool; count: (slots, pixels) uint16."""

    occupied: np.ndarray
    visible: np.ndarray
    count: np.ndarray

    @property
    def shadable(self):
        return self.visible & (self.count != BACKGROUND)

    @property
    def total(self):
        """(pixels,): values that a pixel's samples have together."""
        return np.where(self.shadable, self.count, 0).sum(axis=0, dtype=np.int64)


def random_samples(pixels, slots=SLOTS, seed=1, part=0.4, seen=0.8, background=0.1, most=40):
    rng = np.random.default_rng(seed)
    occupied = rng.random((slots, pixels)) < part
    count = rng.integers(most + 1, size=(slots, pixels)).astype(np.uint16)
    count[rng.random((slots, pixels)) < background] = BACKGROUND
    return Samples(occupied, occupied & (rng.random((slots, pixels)) < seen), count)


def full(pixels, slots, count):
    """All slots hold visible samples of the same count."""
    everywhere = np.ones((slots, pixels), bool)
    return Samples(everywhere, everywhere, np.full((slots, pixels), count, np.uint16))


@dataclass(frozen=True)
class Chosen:
    """A frame's choice. shaded: (slots, pixels) bool. stream: of the shaded samples, by number. counters: by name."""

    shaded: np.ndarray
    stream: dict[int, int]
    counters: dict[str, int]


class Chooser:
    """The passes that choose, with arrays of their own."""

    def __init__(self, device, resources, samples, size, shading="adaptive", rate=1.0):
        self.device, self.samples = device, samples
        slots, pixels = samples.count.shape
        paths = path_count(size)
        groups, capacity = -(-paths // GROUP), list_capacity(pixels, slots)
        self.arrays = {
            b.name: device.empty(b.shape, b.dtype, b.name)
            for b in radiance_buffers(pixels, paths, capacity, paths, shading == "adaptive")
        }
        shapes = {"pixel": paths, "mask": (pixels, mask_words(slots)), "shading": (slots, pixels, 4), "listed": 4}
        shapes |= {"counters": len(COUNTERS), "group_first": groups}
        self.arrays |= {name: device.empty(shape, np.uint32, name) for name, shape in shapes.items()}
        for array in self.arrays.values():
            fill(array, 0xA5)  # no pass counts on what is there
        bits = np.uint64(1) << np.arange(2 * slots, dtype=np.uint64)[:, None]
        both = np.concatenate([samples.occupied, samples.visible])
        self.arrays["mask"].set(split_mask((both * bits).sum(axis=0, dtype=np.uint64), slots))
        words = np.random.default_rng(9).integers(2**32, size=(slots, pixels, 4), dtype=np.uint32)
        words[..., 3] = words[..., 3] & np.uint32(0xFFFF0000) | samples.count  # whatever its radiance and its age
        self.arrays["shading"].set(words)
        if shading == "adaptive":
            self.arrays["count_range_before"].set(np.zeros(2, np.uint32))
        self._run(OrderPixels(device, resources, size, False), None)
        self.pixel = self.arrays["pixel"].get()
        defines = cache_defines(slots)
        self._importance = [CountImportance(device, defines)] if shading == "adaptive" else []
        self._choose = Choose(device, defines, shading, rate)

    def _run(self, p, state):
        for _ in p.run(self.arrays, state):
            pass

    def frame(self, update=0, seed=0, before=None):
        """before: the least and the most count of the last frame, if not what it was."""
        state = SimpleNamespace(update=update, key=stream_key(seed, 0))
        if before is not None:
            self.arrays["count_range_before"].set(np.array(before, np.uint32))
        fill(self.arrays["counters"], 0)
        for p in (*self._importance, self._choose):
            self._run(p, state)
        length = self.arrays["listed"].get()[1]
        shaded, stream = (self.arrays[name].get()[:length].astype(np.int64) for name in ("shaded", "stream"))
        assert len(np.unique(shaded)) == len(shaded), "a sample is shaded twice"
        chosen = np.zeros(self.samples.count.shape, bool)
        chosen.ravel()[shaded] = True
        counters = dict(zip(COUNTERS, map(int, self.arrays["counters"].get()), strict=True))
        return Chosen(chosen, dict(zip(shaded.tolist(), stream.tolist(), strict=True)), counters)

    def histogram(self):
        return self.arrays["histogram"].get().astype(np.int64)

    def bin_of(self):
        return self.arrays["bin_of"].get().astype(int)

    def count_range(self):
        return tuple(map(int, self.arrays["count_range"].get()))

    def blocks(self):
        """(pixels,): the number of the 4 x 4 block that a pixel is in, by the order of the paths."""
        block = np.empty(self.samples.count.shape[1], int)
        paths = np.flatnonzero(self.pixel != NONE)
        block[self.pixel[paths]] = paths // 16
        return block

    def base(self, update):
        """The pixels of which one sample is shaded always: of each block one, whose turn it is or that comes next."""
        has_any = self.samples.shadable.any(axis=0)
        found = []
        for lanes in self.pixel.reshape(-1, 16):
            turned = np.roll(lanes, -(7 * update % 16))
            able = [p for p in turned if p != NONE and has_any[p]]
            found += able[:1]
        return np.array(found, int)


def candidates(samples):
    """Of all samples that can be shaded: pixel, and place in the order of their pixel's turns."""
    many = samples.shadable.sum(axis=0)
    pixel = np.repeat(np.arange(len(many)), many)
    return pixel, np.arange(len(pixel)) - np.repeat(np.cumsum(many) - many, many)


def z(sum_, expected, variance):
    return abs(sum_ - expected) / np.sqrt(variance)


LIMIT = stats.norm.isf(SIGNIFICANCE / 2)


# Uniform


@pytest.mark.parametrize("slots", [1, SLOTS, 32])
@pytest.mark.parametrize("size", SIZES)
def test_uniform_shades_one_sample_of_each_pixel_with_a_surface(device, resources, size, slots):
    samples = random_samples(size[0] * size[1], slots, background=0.4)
    chooser = Chooser(device, resources, samples, size, "uniform")
    for update in (0, 1, 7, 4_000_000_000):
        shaded = chooser.frame(update).shaded
        assert not (shaded & ~samples.shadable).any()
        np.testing.assert_array_equal(shaded.sum(axis=0), samples.shadable.any(axis=0))


def test_uniform_takes_each_sample_in_its_turn(device, resources):
    """As many updates as a still pixel has samples shade each of them once, wherever they begin."""
    samples = random_samples(SIZE[0] * SIZE[1], background=0)
    chooser, many = Chooser(device, resources, samples, SIZE, "uniform"), samples.visible.sum(axis=0)
    for begin in (0, 5):
        turns = np.stack([chooser.frame(begin + k).shaded for k in range(SLOTS)])
        for number in range(1, SLOTS + 1):
            here = many == number
            np.testing.assert_array_equal(turns[:number, :, here].sum(axis=0), samples.visible[:, here])


def test_uniform_passes_over_the_background(device, resources):
    """Beside it no sample waits for longer than a round."""
    samples = random_samples(SIZE[0] * SIZE[1], background=0.5)
    chooser, many = Chooser(device, resources, samples, SIZE, "uniform"), samples.visible.sum(axis=0)
    turns = np.stack([chooser.frame(k).shaded for k in range(SLOTS)])
    for number in range(1, SLOTS + 1):
        here = many == number
        np.testing.assert_array_equal(turns[:number, :, here].any(axis=0), samples.shadable[:, here])


@pytest.mark.parametrize("rate", [0.0625, 0.3, 0.9])
@pytest.mark.parametrize("size", SIZES)
def test_uniform_below_one_shades_one_pixel_of_each_block_always(device, resources, size, rate):
    """That whose turn it is, or the next that has any: one sample of it; no more than one of the others."""
    samples = random_samples(size[0] * size[1], part=0.1)
    chooser, able = Chooser(device, resources, samples, size, "uniform", rate), samples.shadable.any(axis=0)
    assert not able.all() or able.size == 1
    for update in range(17):
        shaded, base = chooser.frame(update).shaded.sum(axis=0), chooser.base(update)
        np.testing.assert_array_equal(shaded[base], 1)
        assert shaded.max(initial=0) <= 1
        assert not shaded[~able].any()
        if rate == 1 / 16:
            assert shaded.sum() == len(base)


@pytest.mark.parametrize("rate", [0.3, 0.9])
def test_uniform_below_one_is_a_fair_coin(device, resources, rate):
    """Of the pixels that are not their block's, each for itself, so that a block of 16 has 16 times the rate in expectation. Of
    each pixel and of each update the number is binomial: Z-test of the sum, chi-squared tests of both spreads."""
    samples = random_samples(SIZE[0] * SIZE[1])
    chooser, able = Chooser(device, resources, samples, SIZE, "uniform", rate), samples.shadable.any(axis=0)
    updates, chance = 150, (16 * rate - 1) / 15
    shaded = np.stack([chooser.frame(k, seed=3).shaded.sum(axis=0) for k in range(updates)])
    tossed = np.tile(able, (updates, 1))
    for update in range(updates):
        tossed[update, chooser.base(update)] = False
    heads, one = np.where(tossed, shaded, 0), chance * (1 - chance)
    assert z(heads.sum(), chance * tossed.sum(), one * tossed.sum()) < LIMIT
    for axis in (0, 1):
        tosses = tossed.sum(axis=axis)
        tosses, away = tosses[tosses > 0], (heads.sum(axis=axis) - chance * tosses)[tosses > 0]
        assert SIGNIFICANCE / 2 < stats.chi2.cdf((away**2 / (one * tosses)).sum(), len(away)) < 1 - SIGNIFICANCE / 2


@pytest.mark.parametrize("rate", [0.0625, 0.3, 0.9])
def test_uniform_shades_as_many_as_the_rate_says(device, resources, rate):
    """In an image of whole blocks, all of a surface: Z-test of the sum, whose variance is that of the coins of 15 pixels a block."""
    size, updates, chance = (32, 20), 100, (16 * rate - 1) / 15
    chooser = Chooser(device, resources, full(640, 3, 0), size, "uniform", rate)
    shaded = sum(chooser.frame(k, seed=5).shaded.sum() for k in range(updates))
    variance = updates * 600 * chance * (1 - chance)
    if rate == 1 / 16:
        assert shaded == updates * 40
    else:
        assert z(shaded, updates * rate * 640, variance) < LIMIT


# Adaptive: the histogram


@pytest.mark.parametrize("before", [(0, 12), (3, 400), (0, 1023), (100, 101), (1, 2)])
def test_bins_have_equal_ratios(device, resources, before):
    """Between the least and the most importance of the frame before; what lies beyond is in the bins at the ends."""
    chooser = Chooser(device, resources, full(16, SLOTS, 1), (4, 4))
    chooser.frame(before=before)
    importance = 1 / (1 + np.arange(COUNTS))
    least, most = 1 / (1 + before[1]), 1 / (1 + before[0])
    place = BINS * np.log(importance / least) / np.log(most / least)
    # log2_of's error and those of the divisions, in bins
    blur = 1e-5 * BINS / np.log2(most / least)
    low, high = (np.clip(np.trunc(place + d), 0, BINS - 1) for d in (-blur, blur))
    bin_of = chooser.bin_of()
    assert ((low <= bin_of) & (bin_of <= high)).all()
    assert (np.diff(bin_of) <= 0).all()
    assert (bin_of[before[0]], bin_of[before[1] + 1 :].max(initial=0)) == (BINS - 1, 0)


@pytest.mark.parametrize("slots", [1, SLOTS, 17, 32])
@pytest.mark.parametrize("size", SIZES)
def test_histogram_and_range_against_numpy(device, resources, size, slots):
    """One sample of each block stands apart; a pixel's other ones have the counts that they will find when it is their turn."""
    samples = random_samples(size[0] * size[1], slots, seed=slots)
    chooser = Chooser(device, resources, samples, size)
    for update, before in ((0, (0, 150)), (5, (2, 60)), (16, (0, 1000))):
        chooser.frame(update, before=before)
        bin_of, base = chooser.bin_of(), chooser.base(update)
        expected = np.zeros(BINS + 1, int)
        pixel, k = candidates(samples)
        is_base = (k == 0) & np.isin(pixel, base)
        np.add.at(expected, bin_of[np.minimum(samples.total[pixel] + k, COUNTS - 1)[~is_base]], 1)
        expected[BINS] = is_base.sum()
        np.testing.assert_array_equal(chooser.histogram(), expected)
        counted = np.minimum(samples.total[samples.shadable.any(axis=0)], COUNTS - 1)
        assert chooser.count_range() == (counted.min(initial=COUNTS), counted.max(initial=0))


# Adaptive: the choice


@pytest.mark.parametrize("rate", [0.0625, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("size", SIZES)
def test_bins_above_are_shaded_and_those_below_are_not(device, resources, size, rate):
    """The bins from the top as long as they fit the rate, with the blocks' samples first; of the one that does not, some."""
    pixels = size[0] * size[1]
    samples = random_samples(pixels, seed=5)
    chooser = Chooser(device, resources, samples, size, rate=rate)
    for update in range(4):
        shaded = chooser.frame(update, before=(0, 150)).shaded
        histogram, bin_of, base = chooser.histogram(), chooser.bin_of(), chooser.base(update)
        pixel, k = candidates(samples)
        bins = bin_of[np.minimum(samples.total[pixel] + k, COUNTS - 1)]
        is_base = (k == 0) & np.isin(pixel, base)
        assert not (shaded & ~samples.shadable).any()
        rest = np.float32(rate) * np.float32(pixels) - histogram[BINS]
        above = histogram[:BINS].sum() - np.cumsum(histogram[:BINS])  # in the bins above each
        crossing = int(np.flatnonzero(above + histogram[:BINS] > rest).max(initial=-1))
        is_chance = crossing >= 0 and rest > above[crossing]  # else of that bin none is shaded either
        least = np.bincount(pixel, is_base | (bins > crossing), pixels)
        most = np.bincount(pixel, is_base | (bins > crossing) | (bins == crossing) & is_chance, pixels)
        assert (least <= shaded.sum(axis=0)).all()
        assert (shaded.sum(axis=0) <= most).all()


@pytest.mark.parametrize("size", SIZES)
def test_one_sample_of_each_block_always(device, resources, size):
    """Where there is a surface; at the image's ragged edges, too, and if the rate is used up by that."""
    samples = random_samples(size[0] * size[1], seed=2, part=0.1)
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    block = (y // 4 * -(-size[0] // 4) + x // 4).ravel()
    chooser = Chooser(device, resources, samples, size, rate=0.001)
    for update in range(17):
        shaded = chooser.frame(update).shaded.any(axis=0)
        blocks = np.unique(block[samples.shadable.any(axis=0)])
        np.testing.assert_array_equal(np.unique(block[shaded], return_counts=True), [blocks, np.ones(len(blocks))])
        assert chooser.frame(update).shaded.sum() == len(blocks)


@pytest.mark.parametrize("slots", [1, 2, 3, 4, SLOTS])
@pytest.mark.parametrize("shading", ["uniform", "adaptive"])
def test_the_blocks_sample_goes_round(device, resources, shading, slots):
    """Where the rate allows for no more than one sample of each block, each of its pixels is shaded once in 16 updates, and each of
    their samples, whatever their number, in its turn after that."""
    chooser = Chooser(device, resources, full(96, slots, 5), (12, 8), shading, rate=1 / 16)
    shaded = np.stack([chooser.frame(update).shaded for update in range(16 * slots)])
    np.testing.assert_array_equal(shaded[:16].sum(axis=(0, 1)), 1)
    np.testing.assert_array_equal(shaded.sum(axis=0), 1)


@pytest.mark.parametrize("before", [(0, 150), (0, 0), (20, 90)])
@pytest.mark.parametrize("rate", [0.1, 0.5, 0.7, 1.0])
def test_as_many_as_the_rate_asks_for(device, resources, rate, before):
    """Samples dispatched in all updates: Z-test of the sum against rate * width * height, where enough can be shaded, and of the
    updates' spread, chi-squared, whose variance is that of a coin for each sample in the crossing bin."""
    pixels, updates = SIZE[0] * SIZE[1], 120
    samples = random_samples(pixels, seed=4)
    chooser = Chooser(device, resources, samples, SIZE, rate=rate)
    away, variance = np.zeros((2, updates))
    for update in range(updates):
        away[update] = chooser.frame(update, seed=11, before=before).shaded.sum() - rate * pixels
        histogram = chooser.histogram()
        assert histogram[BINS] <= rate * pixels <= histogram.sum(), "the test is of something else"
        rest = rate * pixels - histogram[BINS]
        for bin in range(BINS - 1, -1, -1):
            if histogram[bin] > rest:
                chance = rest / histogram[bin]
                variance[update] = histogram[bin] * chance * (1 - chance)
                break
            rest -= histogram[bin]
    assert z(away.sum(), 0, variance.sum()) < LIMIT
    assert SIGNIFICANCE / 2 < stats.chi2.cdf((away**2 / variance).sum(), updates) < 1 - SIGNIFICANCE / 2


def test_all_alike_are_a_coin_each(device, resources):
    """w_min = w_max: every sample has the same chance, chi-squared test of how often each was shaded; and the coins of a pixel's
    samples are independent: Z-test of the spread of how many of them were, which is binomial."""
    size, rate, updates = (8, 8), 0.7, 600
    samples = full(64, SLOTS, 0)
    chooser = Chooser(device, resources, samples, size, rate=rate)
    shaded = np.stack([chooser.frame(update, before=(0, 0)).shaded for update in range(updates)])
    is_base = np.zeros((updates, 64), bool)
    for update in range(updates):
        is_base[update, chooser.base(update)] = True
    chance = (rate * 64 - 4) / (64 * SLOTS - 4)
    one = chance * (1 - chance)
    tosses, heads = (~is_base).sum(axis=0), (shaded & ~is_base[:, None]).sum(axis=0)
    spread = ((heads - tosses * chance) ** 2 / (tosses * one)).sum()
    assert SIGNIFICANCE / 2 < stats.chi2.cdf(spread, heads.size) < 1 - SIGNIFICANCE / 2
    of_pixels = shaded.sum(axis=1)[~is_base]
    squares = ((of_pixels - SLOTS * chance) ** 2 / (SLOTS * one)).sum()
    assert z(squares, of_pixels.size, of_pixels.size * (2 + (1 - 6 * one) / (SLOTS * one))) < LIMIT


@pytest.mark.parametrize("before", [(0, 0), (1024, 0), (7, 7), (1023, 1023)])
@pytest.mark.parametrize("shading", ["uniform", "adaptive"])
def test_nothing_to_shade(device, resources, shading, before):
    """An empty cache, one that sees nothing, and one of background alone."""
    pixels = SIZE[0] * SIZE[1]
    nowhere, everywhere = np.zeros((SLOTS, pixels), bool), np.ones((SLOTS, pixels), bool)
    count = np.zeros((SLOTS, pixels), np.uint16)
    contents = (
        (nowhere, nowhere, count),
        (everywhere, nowhere, count),
        (everywhere, everywhere, count + np.uint16(BACKGROUND)),
    )
    for content in contents:
        chooser = Chooser(device, resources, Samples(*content), SIZE, shading)
        chosen = chooser.frame(3, before=before if shading == "adaptive" else None)
        assert not chosen.shaded.any()
        assert chosen.counters["shaded"] == 0
        if shading == "adaptive":
            assert (chooser.count_range(), chooser.histogram().sum()) == ((COUNTS, 0), 0)


def test_the_same_counts_everywhere(device, resources):
    """Whatever the range before: rate * pixels in expectation, here at least not nothing and not all."""
    for count, before in ((0, (0, 0)), (9, (108, 108)), (MOST, (1023, 1023))):
        chooser = Chooser(device, resources, full(SIZE[0] * SIZE[1], SLOTS, count), SIZE, rate=0.5)
        shaded = [chooser.frame(update, before=before).shaded.sum() for update in range(40)]
        pixels, blocks = SIZE[0] * SIZE[1], len(np.unique(chooser.blocks()))
        alike = pixels * SLOTS - blocks
        chance = (0.5 * pixels - blocks) / alike
        assert z(np.sum(shaded), 20 * pixels, 40 * alike * chance * (1 - chance)) < LIMIT


def test_counts_that_are_full(device, resources):
    """65,534 is a count like others, the next one says that it is background, which neither counts nor is shaded."""
    count = np.full((3, 16), MOST, np.uint16)
    count[1], count[:, 8:] = BACKGROUND, BACKGROUND
    count[2, 7] = 5
    everywhere = np.ones((3, 16), bool)
    chooser = Chooser(device, resources, Samples(everywhere, everywhere, count), (4, 4))
    chosen = chooser.frame(before=(0, 1023))
    assert (chosen.shaded == (count != BACKGROUND)).all()
    assert chooser.count_range() == (COUNTS - 1, COUNTS - 1)
    np.testing.assert_array_equal(chooser.histogram()[[0, BINS]], [15, 1])
    for update in range(3):
        uniform = Chooser(device, resources, Samples(everywhere, everywhere, count), (4, 4), "uniform").frame(update)
        assert not uniform.shaded[count == BACKGROUND].any()
        assert uniform.counters["shaded"] == 8


def test_those_with_fewer_values_come_first(device, resources):
    """Of pixels with 0, 1, 10 and 100 values, those with fewer are shaded before the others get any but their block's."""
    size = (16, 4)
    count = (
        np.repeat([0, 1, 10, 100], 16).astype(np.uint16)[None].reshape(1, 4, 4, 4).transpose(0, 2, 1, 3).reshape(1, 64)
    )
    everywhere = np.ones((1, 64), bool)
    for rate, shaded in (
        (0.25 + 3 / 64, [16, 1, 1, 1]),
        (0.5 + 2 / 64, [16, 16, 1, 1]),
        (0.75 + 1 / 64, [16, 16, 16, 1]),
    ):
        chooser = Chooser(device, resources, Samples(everywhere, everywhere, count), size, rate=rate)
        chosen = chooser.frame(before=(0, 100)).shaded[0].reshape(4, 4, 4).transpose(1, 0, 2).reshape(4, 16)
        np.testing.assert_array_equal(chosen.sum(axis=1), shaded)


# Streams of random numbers


@pytest.mark.parametrize("shading", ["uniform", "adaptive"])
@pytest.mark.parametrize("slots", [1, SLOTS, 32])
def test_streams_of_random_numbers(device, resources, shading, slots):
    """No two of a frame's samples have the same, so that no two of a pixel are alike; the first of a pixel has the pixel's."""
    pixels = SIZE[0] * SIZE[1]
    samples = random_samples(pixels, slots, part=0.9, most=0)
    chosen = Chooser(device, resources, samples, SIZE, shading).frame(
        3, before=(0, 0) if shading == "adaptive" else None
    )
    streams = list(chosen.stream.values())
    assert len(set(streams)) == len(streams) > 0
    assert 0 <= min(streams) <= max(streams) < slots * pixels < 2**32
    for sample, stream in chosen.stream.items():
        slot, pixel = divmod(sample, pixels)
        assert stream == chosen.shaded[:slot, pixel].sum() * pixels + pixel


def test_coins_are_new_in_each_update_and_seed(device, resources):
    samples = full(SIZE[0] * SIZE[1], SLOTS, 0)
    chooser = Chooser(device, resources, samples, SIZE, rate=0.5)
    frames = [chooser.frame(u, seed, (0, 0)).shaded.tobytes() for u, seed in ((0, 0), (16 * SLOTS, 0), (0, 1), (0, 0))]
    assert frames[0] == frames[3]
    assert len(set(frames)) == 3


# Counters


@pytest.mark.parametrize("shading", ["uniform", "adaptive"])
@pytest.mark.parametrize("size", SIZES)
def test_counters(device, resources, size, shading):
    samples = random_samples(size[0] * size[1])
    chosen = Chooser(device, resources, samples, size, shading).frame(1)
    counts = {"occupied": samples.occupied.sum(), "visible": samples.visible.sum(), "shaded": chosen.shaded.sum()}
    assert chosen.counters == dict.fromkeys(COUNTERS, 0) | counts
