"""Keys of hits (`cl/memo/key.cl`, `tile_key.cl`) against an implementation of section 5.3.2 in NumPy, at random and at extremes."""

from dataclasses import dataclass

import numpy as np
import pytest
from memo_model import COARSEST, NEAR, NO_BOUND, hash_of, keys_of, levels_of, pcg_hash, remapped, texels_of
from memo_on_device import KEYS, run_source

NAMES = ("level", "level3", "u", "v", "x", "y", "z")
READS = {"uv": ("uv",), "position": ("position",), "both": ("uv", "position")}
BITS = {"uv": 1, "position": 2, "both": 3}
PLACES = 2**21 - 8


@dataclass(frozen=True)
class Found:
    """What a device makes of hits. numbers: by name. middle: (15, n): inputs of graphs in the middle of the texel."""

    place: np.ndarray
    check: np.ndarray
    numbers: dict[str, np.ndarray]
    middle: np.ndarray


def program(device, width=4, height=4, bilinear=0):
    defines = {"TILE_WIDTH": width, "TILE_HEIGHT": height, "BILINEAR": bilinear, "HAS_NORMALS": 0, "HAS_NORMAL_MAPS": 0}
    return run_source(device, KEYS, **defines)


def texel_keys(device, inputs, graph, reads="uv", bias=0.0, places=PLACES, coarsest=None):
    n = len(graph)
    made = {"place": (n, "u4"), "check": (n, "u4"), "numbers": ((7, n), "i4"), "middle": ((15, n), "f4")}
    arrays = {name: device.empty(shape, np.dtype(dtype)) for name, (shape, dtype) in made.items()}
    arrays |= {
        "inputs": device.upload(np.ascontiguousarray(inputs, np.float32)),
        "graph": device.upload(np.uint32(graph)),
        "coarsest": device.upload(np.int32(no_bounds(graph) if coarsest is None else coarsest)),
    }
    program(device)["texel_keys"].run(n, arrays, reads=BITS[reads], bias=bias, places=places, n=n)
    found = {name: arrays[name].get() for name in made}
    return Found(found["place"], found["check"], dict(zip(NAMES, found["numbers"], strict=True)), found["middle"])


def tile_keys(device, inputs, graph, tile, bilinear, bias=0.0, coarsest=None):
    n = len(graph)
    made = {"place": (n, "u4"), "check": (n, "u4"), "numbers": ((3, n), "i4"), "within": ((2, n), "f4")}
    arrays = {name: device.empty(shape, np.dtype(dtype)) for name, (shape, dtype) in made.items()}
    arrays |= {
        "inputs": device.upload(np.ascontiguousarray(inputs, np.float32)),
        "graph": device.upload(np.uint32(graph)),
        "coarsest": device.upload(np.int32(no_bounds(graph) if coarsest is None else coarsest)),
    }
    program(device, *tile, int(bilinear))["tile_keys"].run(n, arrays, bias=bias, places=PLACES, n=n)
    return {name: arrays[name].get() for name in made}


def levels_in(words):
    """The levels of footprints and of texels, and whether these are scattered."""
    return (words & 255) + COARSEST, (words >> 8 & 255) + COARSEST, words >> 16 == 1


def no_bounds(graph):
    """Of graphs whose texels may be of any size."""
    return np.full((int(np.max(graph)) + 1, 2), NO_BOUND)


def some_bounds():
    """Of 200 graphs, whose coarsest texels are of any size."""
    return np.random.default_rng(8).integers(-24, 25, (200, 2))


def footprints(n, seed, uv=10.0, position=5.0, exponents=(-18, 3)):
    """(15, n) float32: points within bounds, and axes whose lengths have exponents of 2 in this range."""
    rng = np.random.default_rng(seed)

    def axis(d):
        direction = rng.normal(size=(d, n))
        return direction / np.linalg.norm(direction, axis=0) * 2.0 ** rng.uniform(*exponents, n)

    uvs, places = rng.uniform(-uv, uv, (2, n)), rng.uniform(-position, position, (3, n))
    return np.vstack([uvs, axis(2), axis(2), places, axis(3), axis(3)]).astype(np.float32)


def split(inputs):
    """The points and axes of both kinds, as the model takes them."""
    return tuple(a.T for a in np.split(inputs[:6], 3)), tuple(a.T for a in np.split(inputs[6:], 3))


@pytest.mark.parametrize("reads", READS)
@pytest.mark.parametrize("bias", [0.0, -1.5, 4.0])
@pytest.mark.parametrize("size", [1.0, 10.0, 1e7])
def test_keys_are_the_models(device, reads, bias, size):
    """Levels, texels and both hashes of 20,000 hits, whatever bounds graphs have; near where levels end, rounding may choose."""
    inputs = footprints(20000, 1, uv=size, position=size)
    graph = np.random.default_rng(2).integers(0, 200, 20000)
    found, expected = (
        texel_keys(device, inputs, graph, reads, bias, coarsest=some_bounds()),
        keys_of(graph, *split(inputs), READS[reads], PLACES, bias, some_bounds()),
    )
    sure = expected.certain
    assert sure.mean() > 0.99
    for name, numbers in expected.numbers.items():
        np.testing.assert_array_equal(found.numbers[name][sure], numbers[sure], err_msg=name)
    np.testing.assert_array_equal(found.place[sure], expected.place[sure])
    np.testing.assert_array_equal(found.check[sure], expected.check[sure])
    assert np.abs(np.array([found.numbers[n] for n in NAMES[2:]])).max() < 2**29 + 1


def test_the_level_at_exact_powers_of_two(device):
    """A footprint of 2^-m has level m, for all within bounds: no rounding on the way; the shorter axis counts, whichever it is."""
    exponents = np.arange(-40, 41)
    n = len(exponents)
    for shorter in (0, 1):
        inputs = np.zeros((15, n), np.float32)
        for first in (2, 9):
            width = 2 if first == 2 else 3
            inputs[first + shorter * width] = 2.0**-exponents
            inputs[first + (1 - shorter) * width + 1] = 2.0 ** (5 - exponents)
        found = texel_keys(device, inputs, np.zeros(n))
        for name in ("level", "level3"):
            footprint, texels, scattered = levels_in(found.numbers[name])
            np.testing.assert_array_equal([footprint, texels], np.tile(np.clip(exponents, -24, 24), (2, 1)))
            assert not scattered.any()


@pytest.mark.parametrize(("bound", "bound3"), [(4, -2), (-24, 24), (22, 21)])
def test_texels_are_no_larger_than_the_graphs_coarsest(device, bound, bound3):
    """Of wider footprints the level says how graphs filter, those that are 16 times as wide; values of texels within three levels of the bound
    are at random points."""
    exponents = np.arange(-24, 25)
    inputs = np.zeros((15, 49), np.float32)
    inputs[[2, 5, 9, 13]] = 2.0**-exponents
    inputs[[0, 1, 6, 7, 8]] = 0.3
    found = texel_keys(device, inputs, np.ones(49), "both", coarsest=[[0, 0], [bound, bound3]])
    for name, least in (("level", bound), ("level3", bound3)):
        footprint, texels, scattered = levels_in(found.numbers[name])
        np.testing.assert_array_equal(footprint, np.maximum(exponents, least - 4))
        np.testing.assert_array_equal(texels, np.maximum(exponents, least))
        np.testing.assert_array_equal(scattered, (texels <= least + 2) & (texels < 24))
        axes = [2, 5] if name == "level" else [9, 13]
        np.testing.assert_array_equal(found.middle[axes], np.tile(2.0**-footprint, (2, 1)))


def test_the_level_changes_half_way_between_powers_of_two(device):
    """At sqrt(2) times a power: below it the finer level, above it the coarser; and a bias of half a level moves that."""
    exponents = np.arange(-20, 20)
    for bias, place in ((0.0, 0.5), (0.25, 0.75), (-0.5, 0.0), (1.0, 0.5)):
        for sign in (-1, 1):
            inputs = np.zeros((15, len(exponents)), np.float32)
            inputs[2] = inputs[5] = 2.0 ** (-exponents + place + sign * 10 * NEAR)
            level, *_ = levels_in(texel_keys(device, inputs, np.zeros(len(exponents)), bias=bias).numbers["level"])
            exact = exponents - place + bias
            np.testing.assert_array_equal(level, np.clip(np.floor(exact + 0.5) - (sign > 0), -24, 24))


@pytest.mark.parametrize("length", [0.0, 1e-45, 1e-38, 1e-20, 1e19, 3e38])
def test_footprints_of_any_size(device, length):
    """None at all is the finest level that the coordinates allow, one beyond all numbers the coarsest that the graph's bound allows; texels are
    as coarse as coordinates need, or as that bound says."""
    coordinates = np.array([0.0, -0.0, 0.5, -1.0, 31.9, 32.0, 1e5, -1e7, 1e20, -3e38], np.float32)
    inputs = np.zeros((15, len(coordinates)), np.float32)
    inputs[[0, 1, 6, 7, 8]] = coordinates
    inputs[[2, 5, 9, 13]] = length
    found = texel_keys(device, inputs, np.zeros(len(coordinates)), "both", coarsest=[[4, 4]])
    finest = np.array([24, 24, 24, 24, 24, 23, 12, 5, -24, -24])
    expected, texels = (np.minimum(finest, 0), np.minimum(finest, 4)) if length > 1 else (finest, finest)
    for name in ("level", "level3"):
        np.testing.assert_array_equal(levels_in(found.numbers[name])[:2], [expected, texels])
    model = texels_of(coordinates[:, None], texels)[:, 0]
    for name in NAMES[2:]:
        np.testing.assert_array_equal(found.numbers[name], model)
    assert np.isfinite(found.middle).all() or length > 1e38


@pytest.mark.parametrize("level", [-3, 3, 8])
def test_values_are_those_in_the_middle_of_texels(device, level):
    """Texels begin at whole multiples of their size, negative ones like positive ones."""
    size = 2.0**-level
    coordinates = np.array([-2.0, -1.5, -1.01, -1.0, -0.01, 0.0, 0.99, 1.0, 1.5, 7.6], np.float32)
    inputs = np.zeros((15, len(coordinates)), np.float32)
    for rows, axes in (([0, 1], [2, 5]), ([6, 7, 8], [9, 13])):
        inputs[rows], inputs[axes] = np.float32(size) * coordinates, size
        inputs[rows[1:]] *= -1
    found = texel_keys(device, inputs, np.zeros(len(coordinates)), "both")
    first, second = np.array([[-2, -2, -2, -1, -1, 0, 0, 1, 1, 7], [2, 1, 1, 1, 0, 0, -1, -1, -2, -8]])
    for name, expected in (("u", first), ("v", second), ("x", first), ("y", second), ("z", second)):
        np.testing.assert_array_equal(found.numbers[name], expected)
    rows = np.concatenate([np.stack([first, second]), np.stack([first, second, second])])
    np.testing.assert_array_equal(found.middle[[0, 1, 6, 7, 8]], (rows + 0.5) * size)
    axes = np.zeros(15)
    axes[[2, 5, 9, 13]] = size
    np.testing.assert_array_equal(
        found.middle[[2, 3, 4, 5, *range(9, 15)]].T, np.tile(axes[[2, 3, 4, 5, *range(9, 15)]], (10, 1))
    )


def test_values_of_coarse_texels_are_at_random_points_of_them(device):
    """Those of the model, which have no pattern: uniform in each dimension, and of no two dimensions alike."""
    n = 40000
    rng = np.random.default_rng(9)
    inputs = np.zeros((15, n), np.float32)
    rows = [0, 1, 6, 7, 8]
    inputs[rows] = rng.integers(-(2**8), 2**8, (5, n)) / 16 + 1 / 64
    inputs[[2, 5, 9, 13]] = 1.0
    found = texel_keys(device, inputs, np.zeros(n), "both", coarsest=[[4, 4]])
    uv, position = (tuple(part) for part in split(inputs))
    for (point, x, y), names, own in ((uv, "uv", rows[:2]), (position, "xyz", rows[2:])):
        level = levels_of(x, y, point, coarsest=4)
        assert level.scattered.all() and (level.texels == 4).all()
        number = np.array([found.numbers[name] for name in names])
        place = found.middle[own] * 16 - number
        np.testing.assert_allclose(place.T, level.places(number.T), atol=2e-5)
        assert (place >= 0).all() and (place <= 1).all()
        of_texels = np.unique(np.vstack([number, place]), axis=1)[len(names) :]
        count = of_texels.shape[1]
        shares = [np.histogram(p, 16, (0, 1))[0] for p in of_texels]
        assert (np.abs(np.array(shares) - count / 16) < 5 * np.sqrt(count / 16)).all()
        assert (np.abs(np.corrcoef(of_texels) - np.eye(len(names))) < 5 / np.sqrt(count)).all()


def test_the_finest_texels_are_points(device):
    """What has no footprint, at multiples of 2^-24, has a key that says exactly where it is."""
    inputs = np.zeros((15, 1000), np.float32)
    rows = [0, 1, 6, 7, 8]
    inputs[rows] = np.random.default_rng(4).integers(-(2**24), 2**24, (5, 1000)) / 2**24
    found = texel_keys(device, inputs, np.zeros(1000), "both")
    np.testing.assert_array_equal(found.middle[rows], inputs[rows])
    np.testing.assert_array_equal([found.numbers[n] for n in "uvxyz"], inputs[rows].astype(float) * 2**24)


@pytest.mark.parametrize("reads", READS)
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e7])
def test_all_that_have_a_key_have_one_middle_near_by(device, reads, size):
    """Within half a texel of each hit, or a whole one of those that are points; its footprint is the level's; what has the middle has the
    same key, unless texels are as small as the numbers' last digit."""
    inputs = footprints(5000, 3, uv=size, position=size, exponents=(-30, 3))
    graph = np.zeros(5000)
    found = texel_keys(device, inputs, graph, reads)
    again = texel_keys(device, found.middle, graph, reads)
    numbers = np.abs([found.numbers[n] for n in {"uv": "uv", "position": "xyz", "both": "uvxyz"}[reads]])
    countable = ((numbers < 2**23) | (numbers > 2**24)).all(axis=0)
    assert countable.mean() > 0.4
    np.testing.assert_array_equal(again.check[countable], found.check[countable])
    for level, rows, axes in (("level", [0, 1], [2, 5]), ("level3", [6, 7, 8], [9, 13])):
        footprint, texels, _ = levels_in(found.numbers[level])
        away = np.abs(found.middle[rows].astype(float) - inputs[rows])
        assert (away <= np.where(texels < 24, 0.5, 1) * 2.0**-texels + 1e-7 * np.abs(inputs[rows])).all()
        np.testing.assert_array_equal(found.middle[axes], np.broadcast_to(np.exp2(-footprint), (2, 5000)))


def test_all_that_tells_texels_apart_is_in_the_key(device):
    """Graph, level, and each number; what a graph does not read is not."""
    base = np.zeros((15, 1), np.float32)
    base[[0, 1, 6, 7, 8]] = [[5.0], [6.0], [1.0], [2.0], [3.0]]
    base[[2, 5, 9, 13]] = 0.125
    changes = {"u": (0, 5.25), "v": (1, 7.0), "x": (6, 1.5), "y": (7, 3.0), "z": (8, 2.0)}
    for reads in READS:
        variants, graphs, is_read = [base], [7], [True]
        for name, (row, value) in changes.items():
            changed = base.copy()
            changed[row] = value
            variants.append(changed)
            graphs.append(7)
            is_read.append(reads == "both" or (name in "uv") == (reads == "uv"))
        for rows, by in (([2, 5], "uv"), ([9, 13], "position")):  # the level, and nothing else: 0 is 0 at all of them
            changed = base.copy()
            changed[[0, 1, 6, 7, 8]] = 0
            finer = changed.copy()
            finer[rows] = 0.0625
            variants += [changed, finer]
            graphs += [7, 7]
            is_read += [True, reads in (by, "both")]
        found = texel_keys(device, np.hstack([*variants, base]), [*graphs, 8], reads)
        keys = list(zip(found.place.tolist(), found.check.tolist(), strict=True))
        for k in range(1, 6):
            assert (keys[k] != keys[0]) == is_read[k], (reads, k)
        for k in (7, 9):
            assert (keys[k] != keys[k - 1]) == is_read[k], (reads, k)
        assert keys[-1] != keys[0]
        checks = found.check[[0, *(k for k in range(1, 6) if is_read[k]), len(keys) - 1]]
        assert len(set(checks.tolist())) == len(checks)


def test_the_two_hashes_are_independent(device):
    """Keys that begin at the same place have different check hashes, and the other way round: neither follows from the other."""
    u, v = (a.ravel() for a in np.meshgrid(np.arange(300), np.arange(300)))
    inputs = np.zeros((15, u.size), np.float32)
    inputs[0], inputs[1] = u, v
    inputs[2] = inputs[5] = 1
    found = texel_keys(device, inputs, np.zeros(u.size), places=1024)
    assert len(np.unique(found.check)) > u.size - 10  # 1 collision is to be expected of 90,000^2 / 2^33
    counts = np.bincount(found.place, minlength=1024)
    chi_square = ((counts - u.size / 1024) ** 2 / (u.size / 1024)).sum()
    assert abs(chi_square - 1023) < 4 * np.sqrt(2 * 1023)
    shared = np.corrcoef(found.place, found.check % 1024)[0, 1]
    assert abs(shared) < 4 / np.sqrt(u.size)


def _inverse_pcg(value):
    """The word of which this is PCG's hash."""
    value ^= value >> 22
    state = value * pow(277803737, -1, 2**32) % 2**32
    shift = (state >> 28) + 4
    mixed, known = state, state
    for _ in range(8):
        known = mixed ^ known >> shift
    return (known - 2891336453) * pow(747796405, -1, 2**32) % 2**32


@pytest.mark.parametrize("graph", [0, 1, 5000])
def test_hashes_that_mean_something_else_are_remapped(device, graph):
    """Keys made so that their check hash is EMPTY, LOCKED or DEAD, or the first that is none of these."""
    targets, number = range(5), []
    for target in targets:
        value = _inverse_pcg(_inverse_pcg(target))  # levels whose word is 0, and u 0, change nothing
        assert int(pcg_hash(pcg_hash(value))) == target
        number.append(_inverse_pcg(value) ^ int(pcg_hash(~graph % 2**32)))
    expected = remapped(hash_of([np.zeros(5), np.zeros(5), np.array(number)], pcg_hash(~graph % 2**32)))
    arrays = {"number": device.upload(np.uint32(number)), "check": device.empty(5, np.uint32)}
    program(device)["remapped"].run(5, arrays, graph=graph, n=5)
    assert arrays["check"].get().tolist() == expected.tolist() == [2**31, 2**31 + 1, 2**31 + 2, 3, 4]


@pytest.mark.parametrize("tile", [(2, 2), (3, 3), (4, 4), (6, 5), (8, 4)])
@pytest.mark.parametrize("bilinear", [False, True])
@pytest.mark.parametrize("size", [1.0, 1e7])
def test_tiles_are_the_models(device, tile, bilinear, size):
    """Eq. 5.12-5.15: which tile, and where within it, in texels; tiles that overlap cover one less, and begin in the middle of a texel."""
    inputs = footprints(20000, 5, uv=size)
    graph = np.random.default_rng(6).integers(0, 200, 20000)
    found = tile_keys(device, inputs, graph, tile, bilinear, coarsest=some_bounds())
    point, x, y = (a.T for a in np.split(inputs[:6], 3))
    level = levels_of(x, y, point, coarsest=some_bounds()[graph, 0])
    sure, covers = level.certain, np.array(tile) - bilinear
    aside = level.middle[:, None] if bilinear else 0.0  # tiles of points begin at one, in the middle of a texel
    scaled = (point * np.exp2(level.texels)[:, None] - aside).astype(np.float32).astype(float)
    number = np.floor(scaled / covers).astype(np.int64)
    np.testing.assert_array_equal(found["numbers"].T[sure], np.column_stack([level.word, number])[sure])
    texel = np.floor(scaled)
    within = (texel - number * covers).astype(np.float32) + (scaled - texel).astype(np.float32)  # rounded twice
    np.testing.assert_array_equal(found["within"].T[sure], within[sure])
    assert (found["within"] >= 0).all() and (covers >= found["within"].T).all()
    columns = [level.word, *number.T]
    check = remapped(hash_of(columns, pcg_hash(~graph % 2**32)))
    np.testing.assert_array_equal(found["check"][sure], check[sure])
    np.testing.assert_array_equal(found["place"][sure], (hash_of(columns, pcg_hash(graph)) % np.uint32(PLACES))[sure])


@pytest.mark.parametrize("bilinear", [False, True])
def test_tiles_of_extremes(device, bilinear):
    coordinates = np.array([0.0, -1e-45, 1e-45, -1e7, 1e20, -3e38, 3e38, 31.99], np.float32)
    for length in (0.0, 1e-45, 1.0, 3e38):
        inputs = np.zeros((15, len(coordinates)), np.float32)
        inputs[0], inputs[1], inputs[2], inputs[5] = coordinates, coordinates[::-1], length, length
        found = tile_keys(device, inputs, np.zeros(len(coordinates)), (4, 4), bilinear)
        assert ((found["within"] >= 0) & (found["within"] <= 4 - bilinear)).all()
