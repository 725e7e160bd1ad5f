"""Images with memoization: the same where keys say exactly where hits are; the same for any table, order and number of threads
where values follow from keys; and what is memoized, by whom, and for how long."""

import os
import zlib
from dataclasses import replace

import numpy as np
import pytest
from cache_renders import in_child, one_device
from memo_renders import assert_differ, assert_same, counters, frames, graph, painted, renderer, yard

from clcache.memo import Costs
from clcache.output.state import STATE_FILE

METHODS = ("pathtrace", "samplecache")


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


@pytest.fixture(scope="module")
def without():
    """Frames without memoization, by scene and options, rendered once."""
    known = {}

    def find(scene, *key, **options):
        key = (*key, *sorted(options.items()))
        if key not in known:
            known[key] = frames(scene, **options)
        return known[key]

    return find


def total(found, name, eye="mono"):
    return sum(counters(frame, eye)[name] for frame in found)


# Exact keys


@pytest.mark.parametrize("stereo", [False, True], ids=["mono", "stereo"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "options", [{"memo": "texel"}, {"memo": "texel", "snap": False}, {"memo": "tile"}], ids=["snapped", "free", "tiles"]
)
def test_keys_that_say_exactly_where_hits_are_change_nothing(without, method, stereo, options):
    """Each triangle has one texture coordinate, which is a texel's middle at the finest level, and lies in a tile of which all texels are
    alike: images are those without memoization, bit for bit, of both eyes."""
    scene = yard(painted("checks"), exact=True)
    expected = without(scene, "exact", method=method, stereo=stereo)
    found = frames(scene, method=method, stereo=stereo, **options)
    assert_same(found, expected)
    for eye in found[0].color:
        assert total(found, "hits", eye) > total(found, "inserted", eye) > 0


def test_keys_that_do_not_say_so_change_it(without):
    """What a snapped, a free and an interpolating cache make of waves are four different things."""
    scene = yard(painted("waves"))
    found = [without(scene, "waves")]
    caches = ("texel", {}), ("texel", {"snap": False}), ("tile", {"filter": "bilinear"})
    found += [frames(scene, memo, **o) for memo, o in caches]
    for k, one in enumerate(found):
        for other in found[:k]:
            assert_differ(one, other)
        assert np.abs(one[1].color["mono"] - found[0][1].color["mono"]).mean() < 0.03


def test_tiles_give_the_nearest_texels_value():
    """What a cache of texels does: the same places, the same footprints."""
    scene = yard(painted("waves"), painted("checks"))
    expected = frames(scene, "texel", stereo=True)
    for tile in ("2x2", "6x5"):
        assert_same(frames(scene, "tile", stereo=True, tile=tile), expected)


# Values that follow from keys


WAVES = {"memo": "texel", "stereo": True, "count": 2}
OTHERS = [
    {"capacity": 1},
    {"capacity": 64, "eviction": "random", "read": "key"},
    {"capacity": 64, "eviction": "none", "probe": 64},
    {"capacity": 100, "eviction": "lrw-counter", "probe": 1},
    {"capacity": 100, "eviction": "lru-counter"},
]
OTHER_PASSES = ["2", "4", "prepass2", "prepass8"]
OTHER_TILES = [
    {"builder": "lanes", "grouped": True, "capacity": 100},
    {"builder": "lanes", "layout": "entry", "passes": "4"},
    {"layout": "image2d", "passes": "prepass4"},
]


@pytest.fixture(scope="module")
def snapped():
    return frames(yard(painted("waves")), **WAVES)


@pytest.mark.parametrize("others", OTHERS, ids=lambda o: "-".join(map(str, o.values())))
def test_any_table_gives_the_same_images(snapped, others):
    """Of one entry or so many, with any eviction and protocol."""
    found = frames(yard(painted("waves")), **WAVES, **others)
    assert_same(found, snapped)
    for name, is_more in (("built", True), ("hits", False)):
        assert (total(found, name, "right") > total(snapped, name, "right")) == is_more


@pytest.mark.parametrize("passes", OTHER_PASSES)
def test_any_order_of_lookups_gives_the_same_images(snapped, passes):
    """In several passes, or with one ahead of which sparse rays fill the cache."""
    found = frames(yard(painted("waves")), **WAVES, passes=passes)
    assert_same(found, snapped)
    assert total(found, "occupied", "right") >= total(snapped, "occupied", "right")


@pytest.mark.parametrize("others", OTHER_TILES, ids=lambda o: "-".join(map(str, o.values())))
def test_any_store_of_tiles_gives_the_same_images(others):
    """However they are built, by whom, and where they are kept."""
    scene, options = yard(painted("waves")), WAVES | {"memo": "tile"}
    of = renderer(scene, "tile", stereo=True)
    if others.get("layout") == "image2d" and not of.device.proves("images"):
        pytest.skip("the device has no images that a kernel can read and write")
    assert_same(frames(scene, **options, **others), list(of.frames(0, 2)))


def test_the_same_images_by_any_order_of_eyes(snapped):
    """Eyes that have changed sides: what was the first one's is the second's, which finds other things in the cache."""
    turned = frames(yard(painted("waves"), eye_distance=-0.08), **WAVES)
    for one, other in zip(turned, snapped, strict=True):
        np.testing.assert_array_equal(one.color["left"], other.color["right"])
        np.testing.assert_array_equal(one.color["right"], other.color["left"])
    assert counters(turned[0], "left")["inserted"] > counters(snapped[0], "right")["inserted"]


def checksum(method, memo, threads=None):
    found = frames(yard(painted("waves")), memo, method, stereo=True, threads=threads, capacity=500, read="key")
    return zlib.crc32(b"".join(frame.color[eye].tobytes() for frame in found for eye in frame.color))


CASES = [("pathtrace", "texel"), ("pathtrace", "tile")]


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_the_same_bits_by_one_and_two_threads():
    """In processes of their own: PoCL fixes its number of threads once in a process."""
    code = "import test_memo_renders as t; print(*(t.checksum(*case, threads={}) for case in t.CASES))"
    assert in_child(code.format(1)) == in_child(code.format(2)) == [checksum(*case) for case in CASES]


def test_half_precision_only_rounds():
    """Colours of first hits are those of float, rounded to the nearest half."""
    options = {"memo": "texel", "aovs": ("albedo",), "count": 1, "settings": {"pathtrace.bounces": 0}}
    scene = yard(painted("checks"), exact=True)
    (whole,), (half,) = (frames(scene, precision=precision, **options) for precision in ("float", "half"))
    expected = whole.aov("albedo", "mono")
    rounded = expected.astype(np.float16).astype(np.float32)
    np.testing.assert_allclose(half.aov("albedo", "mono"), rounded, rtol=2e-7)
    assert np.abs(rounded - expected).max() > 1e-5


# First hits


def test_first_hits_can_be_left_out(without):
    """Where nothing follows them, the image is that without memoization; what follows is memoized all the same."""
    scene, direct = yard(painted("waves")), {"settings": {"pathtrace.bounces": 0}}
    found = frames(scene, "texel", primary=False, **direct)
    assert_same(found, frames(scene, **direct))
    assert total(found, "lookups") == 0
    assert_differ(frames(scene, "texel", **direct), found)
    deep = frames(scene, "texel", primary=False)
    assert_differ(deep, without(scene, "waves"))
    assert 0 < total(deep, "lookups") < total(frames(scene, "texel"), "lookups")


@pytest.mark.parametrize("method", METHODS)
def test_albedo_of_first_hits_is_that_without_memoization(method):
    scene, options = yard(painted("waves")), {"aovs": ("albedo",), "method": method, "count": 2}
    plain, ours = frames(scene, **options), frames(scene, "texel", primary=False, **options)
    for one, other in zip(ours, plain, strict=True):
        np.testing.assert_array_equal(one.aov("albedo", "mono"), other.aov("albedo", "mono"))
    assert total(ours, "lookups") > 0


# Going on


@pytest.mark.parametrize(
    "options",
    [{"memo": "texel", "eviction": "lru-counter"}, {"memo": "tile", "layout": "entry"}],
    ids=["texel", "tile"],
)
def test_a_render_goes_on_bit_for_bit(tmp_path, options):
    """With the counters that it would have had, of a table so small that it evicts: it is the same table."""
    options = {**options, "stereo": True, "capacity": 100, "temporal": "taa"}
    scene = yard(painted("waves"))
    whole = frames(scene, count=4, **options)
    first = renderer(scene, **options)
    list(first.frames(0, 2))
    first.save(tmp_path / STATE_FILE)
    second = renderer(scene, **options)
    second.restore(tmp_path)
    rest = list(second.frames(2, 4))
    assert_same(rest, whole[2:])
    if second.device.threads == 1:
        assert [f.stats["eyes"][e]["memo"] for f in rest for e in f.color] == [
            f.stats["eyes"][e]["memo"] for f in whole[2:] for e in f.color
        ]


def test_a_warm_start_finds_what_another_sequence_left(tmp_path):
    scene = yard(painted("waves"))
    first = renderer(scene, "texel", capacity=10000)
    list(first.frames(0, 3))
    first.save(tmp_path / STATE_FILE)
    cold, warm = (renderer(scene, "texel", capacity=10000, seed=9) for _ in range(2))
    warm.warm_start(tmp_path)
    (expected,), (found,) = (list(r.frames(0, 1)) for r in (cold, warm))
    assert_same([found], [expected])
    assert counters(found)["lookups"] == counters(expected)["lookups"]
    assert counters(found)["inserted"] < 0.8 * counters(expected)["inserted"]


# What is memoized


def memoized(of):
    return {entry["materials"][0]: entry["memoized"] for entry in of.stats()["memo"]["materials"]}


def whys(of):
    return {entry["materials"][0]: entry["why"] for entry in of.stats()["memo"]["materials"]}


def test_costs_decide(monkeypatch):
    """Of two graphs the expensive one alone is looked up; the other is evaluated where hits are."""
    assert graph("checks").cost < graph("expensive").cost
    seen = []

    def costs(setup, arrays):
        seen.append(setup.kind)
        return [
            Costs(1e-6, 1e-7, 1e-7) if g is graph("expensive") else Costs(1e-8, 1e-7, 1e-7) for g in setup.scene.graphs
        ]

    monkeypatch.setattr("clcache.passes.materials._measure", costs)
    scene = yard(painted("waves"), painted("expensive"))
    of = renderer(scene, "texel", auto=True)
    found = list(of.frames(0, 5))
    assert seen == ["texel"] and memoized(of) == {"waves": False, "expensive": True}
    both = frames(scene, "texel")
    assert 0 < total(found[:2], "lookups") < 0.7 * total(both, "lookups")
    report = {entry["materials"][0]: entry for entry in of.stats()["memo"]["materials"]}
    assert report["waves"]["evaluate_ns"] == pytest.approx(10) and report["expensive"]["break_even"] == pytest.approx(
        2 / 11
    )
    assert_same(
        frames(scene, "texel", auto=True, settings={"memo.primary": False, "pathtrace.bounces": 0}),
        frames(scene, settings={"pathtrace.bounces": 0}),
    )


def test_where_none_pays_all_is_as_without(monkeypatch, without):
    monkeypatch.setattr("clcache.passes.materials._measure", lambda setup, arrays: [Costs(1e-8, 1e-7, 1e-7)])
    of = renderer(yard(painted("waves")), "texel", auto=True)
    found = list(of.frames(0, 2))
    assert_same(found, without(yard(painted("waves")), "waves"))
    assert memoized(of) == {"waves": False} and total(found, "lookups") == total(found, "occupied") == 0


def test_measuring_leaves_nothing_behind(monkeypatch):
    """Whatever the times are, and whatever is decided: the table is empty when the first frame begins, its counters are zero."""
    from clcache.passes import materials

    measure = materials._measure

    def measured(setup, arrays):
        found = measure(setup, arrays)
        assert all(cost.evaluate > 0 and cost.look_up > 0 and cost.insert >= 0 and cost.built == 1 for cost in found)
        for name in ("memo_records", "memo_counters", "memo_graph_count"):
            assert not arrays[name].get().any(), name
        return [Costs(1e-6, 1e-7, 1e-7) for _ in found]

    monkeypatch.setattr(materials, "_measure", measured)
    scene = yard(painted("waves"), painted("stripes"))
    assert_same(frames(scene, "texel", auto=True), frames(scene, "texel"))


@pytest.mark.parametrize("memo", ["texel", "tile"])
def test_what_is_not_part_of_keys_is_not_memoized(memo):
    """Normals never; positions not by tiles. The report says why, and what such graphs compute is as it is without."""
    slopes = yard(painted("slopes"))
    of = renderer(slopes, memo)
    found = list(of.frames(0, 2))
    assert_same(found, frames(slopes))
    assert total(found, "lookups") == 0 and memoized(of) == {"slopes": False}
    assert whys(of) == {"slopes": "it reads the normal, which is not part of keys"}
    of = renderer(yard(painted("waves"), painted("stripes")), memo)
    found = list(of.frames(0, 1))
    assert memoized(of) == {"waves": True, "stripes": memo == "texel"} and total(found, "lookups") > 0
    if memo == "tile":
        assert whys(of)["stripes"] == "it reads the position, and tiles have two dimensions"


@pytest.mark.parametrize("memo", ["texel", "tile"])
def test_graphs_beside_each_other_do_not_share_values(memo):
    """Two at whose hits all is the same, level and texel: each gets its own."""
    scene = yard(painted("checks"), painted("waves"), exact=True)
    uvs = [np.full_like(m.uvs, 0.25) for m in scene.meshes]
    scene = replace(scene, meshes=tuple(replace(m, uvs=uv) for m, uv in zip(scene.meshes, uvs, strict=True)))
    found, expected = frames(scene, memo), frames(scene)
    assert counters(found[-1])["occupied"] == 2
    if memo == "texel":
        assert_same(found, expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.color["mono"], other.color["mono"], atol=1e-5)


def test_counters_add_up():
    """Of a frame, and of the table that it leaves."""
    of = renderer(yard(painted("waves")), "texel", stereo=True, capacity=200, eviction="lrw-frame")
    occupied = 0
    for frame in of.frames(0, 3):
        for eye in ("left", "right"):
            c = counters(frame, eye)
            assert c["lookups"] - c["hits"] == c["built"] > 0
            assert c["inserted"] + c["discarded"] <= c["built"] <= c["inserted"] + c["discarded"] + c["duplicates"]
            assert c["occupied"] <= occupied + c["inserted"] - c["evicted"] and c["capacity"] == 200
            assert c["distinct"] <= c["hits"] + c["inserted"]
            occupied = c["occupied"]
    records = of._graph.of("left")["memo_records"].get()
    keys = records[:, 0]
    assert np.count_nonzero(keys > 2) == occupied == len(set(keys[keys > 2].tolist())) and not (keys == 1).any()


def test_a_bias_makes_texels_larger_or_smaller():
    scene = yard(painted("waves"))
    options = {"count": 1, "size": (96, 64), "settings": {"pathtrace.bounces": 0}}
    coarse, usual, fine = (total(frames(scene, "texel", bias=b, **options), "occupied") for b in (-2.0, 0.0, 2.0))
    assert coarse < 0.3 * usual and fine > usual
