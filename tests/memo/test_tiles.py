"""The cache of tiles (`cl/memo/tile.cl`): whoever builds them, and wherever they are, the same tiles and the right values."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tile_on_device import (
    LAYOUTS,
    RUN,
    TILES,
    Cache,
    Hits,
    covers,
    distinct,
    expected,
    has_sub_groups,
    hashed,
    some_hits,
    tiles_at_once,
    word_of,
)

from clcache.device import Device
from clcache.errors import SettingError
from clcache.passes.tiles import check_tiles, image_shape, tile_buffers, tile_size

FORMS = {
    "serial": {"builder": "serial"},
    "lanes": {"builder": "lanes"},
    "grouped": {"builder": "lanes", "grouped": True},
    "native": {"builder": "lanes", "native": True},
}
LOCKED = 1

# Of the texture coordinates in a way that shows every rounding, through calls with vectors, as graphs make them.
CURVED = """
#include "graph/types.cl"
#include "scene/maps.cl"

NOINLINE void bend(float2 a, float3 b, float3 *Out)
{
    *Out = (float3)(a.x, a.y, a.x * a.y) * b + (float3)(0.25f, 0.5f, b.x);
}

NOINLINE void evaluate_graph(uint graph, const GraphInputs *in, const Maps *maps, float *out)
{
    float3 bent;
    bend(in->uv.v, (float3)(1.1f, 0.9f, in->uv.v.x), &bent);
    float u = bent.x - 0.1f * bent.z, v = bent.y;
    out[0] = (u * 0.3f + 0.7f) / (1.1f + v * v);
    out[1] = sqrt(fabs(u * v)) * 1e5f + in->uv.x.x;
    if (graph > 1) out[2] = u * u * u - 0.1f * v;
    if (graph > 2) out[3] = (float)graph / 3.0f;
}
"""


@pytest.fixture(scope="module", params=["serial", "lanes", "native"])
def form(request, device):
    """How tiles are built: by one work-item, by a work-group, or by a sub-group."""
    if request.param == "native" and not has_sub_groups(device):
        pytest.skip("this device has no sub-groups of 32 that exchange values")
    return FORMS[request.param]


@pytest.fixture(scope="module")
def forms(device):
    """All of them."""
    return [form for form in FORMS.values() if not form.get("native") or has_sub_groups(device)]


def settle(cache: Cache, hits: Hits) -> np.ndarray:
    """Look up until all tiles are there: of two that want the same free entry at once, one is discarded. The last values."""
    for _ in range(10):
        values, counters, _ = cache.look_up(hits)
        if counters["built"] == 0:
            assert counters["hits"] == counters["lookups"] and len(cache.tiles()) == distinct(hits)
            return values
    raise AssertionError("tiles are missing again and again")


def assert_answers(cache: Cache, hits: Hits, lookups: int = 2) -> tuple[dict[str, int], int]:
    """Of several look-ups, the first in an empty cache: the last one's counters, and how many tiles were built."""
    built = 0
    for _ in range(lookups):
        values, counters, by_graph = cache.look_up(hits)
        np.testing.assert_array_equal(values, expected(cache, hits))
        assert counters["lookups"] == hits.asks.sum()
        per_graph = np.bincount(hits.cell[3, hits.asks], minlength=5)
        np.testing.assert_array_equal(by_graph[:, 0], per_graph)
        assert by_graph[:, 1].sum() == counters["hits"]
        built += counters["built"]
    return counters, built


# What hits get


@pytest.mark.parametrize("filter", ["nearest", "bilinear"])
@pytest.mark.parametrize("tile", TILES)
def test_every_size_gives_the_texels_value_or_the_line_through_them(device, form, tile, filter):
    """The graphs are linear and all numbers dyadic, so that interpolation is exact."""
    cache = Cache(device, tile=tile, filter=filter, **form)
    hits = some_hits(cache, 333, seed=TILES.index(tile))
    assert_answers(cache, hits, lookups=1)
    np.testing.assert_array_equal(settle(cache, hits), expected(cache, hits))


@pytest.mark.parametrize("precision", ["float", "half"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_holds_and_gives_the_same(device, layout, precision):
    """Of either builder, with as many channels as do not fill up words or images."""
    contents, answers = [], []
    caches = [("serial", "buffer"), ("serial", layout), ("lanes", layout)]
    for builder, where in caches:
        cache = Cache(
            device,
            filter="bilinear",
            precision=precision,
            graphs=CURVED,
            channels=5,
            capacity=300,
            builder=builder,
            layout=where,
        )
        hits = some_hits(cache, 200)
        missed, found = cache.look_up(hits)[0], settle(cache, hits)
        np.testing.assert_array_equal(missed, found)
        contents.append(cache.tiles())
        answers.append(found.tobytes())
    assert contents[0] == contents[1] == contents[2]
    assert len(set(answers)) == 1


@pytest.mark.parametrize("filter", ["nearest", "bilinear"])
def test_lanes_build_what_one_work_item_builds_bit_by_bit(device, forms, filter):
    for precision in ("float", "half"):
        contents, answers = [], []
        for form in forms:
            graphs = CURVED.replace("NOINLINE void bend", "INLINED void bend") if form.get("native") else CURVED
            cache = Cache(device, tile="5x5", filter=filter, precision=precision, graphs=graphs, channels=4, **form)
            hits = some_hits(cache, 500, levels=5)
            answers += [cache.look_up(hits)[0].tobytes(), settle(cache, hits).tobytes()]
            contents.append(cache.tiles())
        assert all(c == contents[0] for c in contents)
        assert len(set(answers)) == 1


def test_half_precision_is_that_of_numpy_and_clamped(device):
    graphs = CURVED.replace("1e5f", "4e6f")
    cache = Cache(device, precision="half", graphs=graphs, channels=4)
    exact = Cache(device, graphs=graphs, channels=4)
    hits = some_hits(cache, 500)
    values, wanted = cache.look_up(hits)[0], exact.look_up(hits)[0]
    np.testing.assert_array_equal(values, np.clip(wanted, -65504, 65504).astype(np.float16).astype(np.float32))
    assert (wanted > 65504).any() and (np.abs(wanted[1]) < 65504).any()


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_hits_that_ask_for_any_tiles(device, forms, data):
    """Among few tiles and graphs, by groups that are not full."""
    n = data.draw(st.integers(1, 70))
    pick = data.draw(st.lists(st.integers(0, 40), min_size=n, max_size=n))
    asks = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    graphs = data.draw(st.lists(st.integers(0, 4), min_size=41, max_size=41))
    capacity = data.draw(st.sampled_from([1, 2, 9, 300]))
    filter = data.draw(st.sampled_from(["nearest", "bilinear"]))
    tiles = np.array([[k - 20, k % 3, word_of(4, 4), graphs[k]] for k in pick]).T
    for form in forms:
        cache = Cache(device, tile="3x3", filter=filter, capacity=capacity, **form)
        within = np.random.default_rng(n).integers(0, 64 * covers(cache)[:, None], (2, n)) / 64
        assert_answers(cache, Hits(tiles, within, asks))


def test_what_is_not_alive_is_left_alone(device, form):
    cache = Cache(device, **form)
    hits = some_hits(cache, 200, asking=1.0)
    values, counters, _ = cache.look_up(hits, alive=77)
    np.testing.assert_array_equal(values[:, :77], expected(cache, hits)[:, :77])
    assert (values[:, 77:] == -77).all() and counters["lookups"] == 77


@pytest.mark.parametrize("turns", [2, 4])
def test_each_hit_has_one_turn(device, form, turns):
    cache = Cache(device, **form)
    hits = some_hits(cache, 900, asking=1.0)
    size = RUN if form["builder"] == "serial" else 32
    rectangles = np.arange(900) // size
    row, column = rectangles % (128 // size), rectangles // (128 // size)
    own = row % 2 + 2 * (column % 2) if turns == 4 else (row + column) % 2
    for turn in range(turns):
        values, counters, _ = cache.look_up(hits, turn=turn, turns=turns)
        np.testing.assert_array_equal(values, expected(cache, replace(hits, asks=own == turn)))
        assert counters["lookups"] == (own == turn).sum() > 0


# What is built


def test_lanes_that_miss_the_same_tile_build_it_once(device, form):
    cache = Cache(device, **form)
    n = RUN if form["builder"] == "serial" else 32  # of one work-item, or one group
    hits = some_hits(cache, n, asking=1.0)
    hits = replace(hits, cell=np.repeat(hits.cell[:, :1], n, axis=1))
    values, counters, _ = cache.look_up(hits)
    np.testing.assert_array_equal(values, expected(cache, hits))
    assert counters["built"] == counters["inserted"] == counters["distinct"] == 1
    assert counters["hits"] == (n - 1 if form["builder"] == "serial" else 0)


def test_lanes_that_all_miss_different_tiles(device, form):
    cache = Cache(device, tile="2x2", **form)
    cell = np.stack([np.arange(32), -np.arange(32), np.full(32, word_of(5, 5)), np.arange(32) % 5])
    hits = Hits(cell, np.tile([[0.25], [1.5]], 32), np.ones(32, bool))
    _, built = assert_answers(cache, hits)
    assert built == 32


@pytest.mark.parametrize("eviction", ["none", "random", "lru-frame", "lrw-counter"])
def test_a_table_of_one_entry(device, form, eviction):
    cache = Cache(device, capacity=1, eviction=eviction, **form)
    for stamp in (1, 2):
        hits = some_hits(cache, 150, seed=stamp)
        values, counters, _ = cache.look_up(hits, stamp)
        np.testing.assert_array_equal(values, expected(cache, hits))
        assert counters["discarded"] + counters["inserted"] + counters["duplicates"] == counters["built"] > 1
        assert len(cache.tiles()) == 1


def test_a_tile_that_is_not_inserted_still_answers(device, form):
    """Every entry is locked by somebody else."""
    cache = Cache(device, capacity=50, **form)
    records = np.zeros(cache.table()["memo_records"].shape, np.uint32)
    records[:, 0] = LOCKED
    cache.table()["memo_records"].set(records)
    counters, built = assert_answers(cache, some_hits(cache, 150))
    assert counters["inserted"] == counters["hits"] == 0 and counters["discarded"] == counters["built"] > 0
    np.testing.assert_array_equal(cache.table()["memo_records"].get(), records)


def test_a_locked_entry_is_not_read(device, form):
    cache = Cache(device, **form)
    hits = some_hits(cache, 150)
    cache.look_up(hits)
    records = cache.table()["memo_records"].get()
    records[records[:, 0] >= 3, 0] = LOCKED
    cache.table()["memo_records"].set(records)
    cache.table()["memo_tiles"].set(np.full(cache.table()["memo_tiles"].shape, 0x12345678, np.uint32))
    assert_answers(cache, hits, lookups=1)


def test_what_the_cache_gives_is_what_it_holds(device, form):
    """Not evaluated anew."""
    cache = Cache(device, **form)
    hits = some_hits(cache, 150, asking=1.0)
    settle(cache, hits)
    tiles = cache.table()["memo_tiles"]
    tiles.set((tiles.get().view(np.float32) + 1).view(np.uint32))
    np.testing.assert_array_equal(cache.look_up(hits)[0], expected(cache, hits) + 1)


def model_of_iterations(cache: Cache, hits: Hits) -> list[set[int]]:
    """The leaders that are built together in each iteration, by sorting as section 5.4.4 has it."""
    cells = [tuple(c) for c in hits.cell.T]
    leaders = [i for i, c in enumerate(cells) if cells.index(c) == i]
    together, graph = tiles_at_once(cache), {i: cells[i][3] for i in leaders}
    if cache.grouped:
        of_graph = {g: [i for i in leaders if graph[i] == g] for g in set(graph.values())}
        left_over = {i for own in of_graph.values() for i in own[len(own) - len(own) % together :]}
        leaders.sort(key=lambda i: (i in left_over, graph[i], i))
    return [set(leaders[k : k + together]) for k in range(0, len(leaders), together)]


@pytest.mark.parametrize("tile", ["2x2", "3x3", "4x4"])
@pytest.mark.parametrize("grouped", [False, True])
def test_tiles_of_a_graph_are_built_together(device, grouped, tile):
    """In which order tiles were inserted, a clock tells."""
    forms = [{}, {"native": True}] if has_sub_groups(device) else [{}]
    for seed in range(5):
        graphs = np.random.default_rng(seed).integers(0, 5, 32)
        cell = np.stack([np.arange(32) // 2, np.zeros(32), np.full(32, word_of(5, 5)), graphs]).astype(int)
        hits = Hits(cell, np.full((2, 32), 0.5), np.ones(32, bool))
        for form in forms:
            cache = Cache(
                device,
                tile=tile,
                builder="lanes",
                grouped=grouped,
                eviction="lrw-counter",
                capacity=5000,
                probe=32,
                **form,
            )
            assert_answers(cache, hits, lookups=1)
            records = cache.table()["memo_records"].get()
            clock = {int(r[0]): int(r[4:6].view(np.uint64)[0]) for r in records if r[0] >= 3}
            order = sorted(clock, key=clock.get)
            check = [int(c) for c in hashed(cell, 2)]
            iterations = model_of_iterations(cache, hits)
            inserted = [{check[i] for i in together} for together in iterations]
            found = np.split(np.array(order), np.cumsum([len(i) for i in inserted])[:-1])
            assert [set(f.tolist()) for f in found] == inserted


def test_grouping_leaves_fewer_iterations_with_several_graphs():
    cell = np.stack([np.arange(7), np.zeros(7), np.zeros(7), [1, 2, 2, 3, 3, 3, 1]]).astype(int)
    hits = Hits(cell, np.zeros((2, 7)), np.ones(7, bool))
    graphs = [
        [sorted(cell[3, i] for i in together) for together in model_of_iterations(Cache(None, grouped=grouped), hits)]
        for grouped in (False, True)
    ]
    assert graphs == [[[1, 2], [2, 3], [3, 3], [1]], [[1, 1], [2, 2], [3, 3], [3]]]


# Where tiles are


@pytest.mark.parametrize("layout", ["image2d", "image3d"])
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("channels", [1, 4, 5, 15])
@pytest.mark.parametrize("capacity", [1, 1000, 2**17, 2**19])
def test_images_have_room_for_every_tile(layout, tile, channels, capacity):
    chosen = {"memo.layout": layout, "memo.tile": tile}
    (width, height), quads = tile_size(chosen), -(-channels // 4)
    shape = image_shape(chosen, channels, capacity)
    assert shape[-1] == 4 and max(shape) <= 16384 and all(size <= 2048 for size in shape[:3] if len(shape) == 4)
    across = shape[-2] // (width * quads if layout == "image2d" else width)
    down = shape[-3] // height
    layers = shape[0] // quads if layout == "image3d" else 1
    assert across * down * layers >= capacity > (across * down * layers - across * down if layers > 1 else 0)
    assert np.prod(shape) / 4 / (width * height * quads) < 2 * capacity + across


def settings_of(**changes) -> dict:
    return Cache(None).settings | {f"memo.{name}": value for name, value in changes.items()}


def test_images_that_a_device_cannot_use_are_refused(device, monkeypatch):
    check_tiles(device, settings_of(layout="image2d"), 7, 2**17)
    with pytest.raises(
        SettingError, match=r"^setting memo.capacity: 268435456 tiles take an image of .*; expected fewer, or memo"
    ):
        check_tiles(device, settings_of(layout="image2d"), 7, 2**28)
    monkeypatch.setattr(Device, "proves", lambda self, feature: False)
    with pytest.raises(SettingError, match=r"^setting memo.layout: image2d needs images .*; expected buffer or entry$"):
        check_tiles(device, settings_of(layout="image2d"), 7, 10)
    check_tiles(device, settings_of(layout="buffer"), 7, 2**28)


def test_only_tiles_outlive_a_frame():
    names = {
        layout: [(b.name, b.persistent, b.is_image) for b in tile_buffers(settings_of(layout=layout), 7, 100, 50)]
        for layout in LAYOUTS
    }
    requests = [("memo_cell", False, False), ("memo_within", False, False)]
    assert names["entry"] == requests
    assert names["buffer"] == [*requests, ("memo_tiles", True, False)]
    assert names["image2d"] == names["image3d"] == [*requests, ("memo_tiles", True, True)]
