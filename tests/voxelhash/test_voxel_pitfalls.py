"""What has gone wrong in published hash caches, asked of this one."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cache_renders import along, at, counters, one_device, yard
from helpers import IDENTITY
from kernel_source import build
from render_helpers import ball, floor, grey, image, lit, on_floor, view
from voxelhash_model import BLOCK, NONE, levels_of
from voxelhash_on_device import FIND, INSERT, Addressing, OnDevice, table_program
from voxelhash_renders import SMALL, SUN, colours_of, ground, held, modelled, voxels
from ztest import agree

import clcache
from clcache import SettingError
from clcache.renderer import camera_record
from clcache.resources import SceneResources
from clcache.scene.model import DirectionalLight

sys.path.append(str(Path(clcache.__file__).parents[1] / "tools"))
from false_hits import Filled  # noqa: E402

MOST_COUNTED = 65535
ABOVE = view((0, 3, 0.1), (0, 0, 0))
AWAY = view((0, 2.5, 0), (0, 60, 1))


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


@pytest.fixture(scope="module")
def kernels(device, tmp_path_factory):
    return device, table_program(device, tmp_path_factory.mktemp("table"))


def color(frame):
    return frame.color["mono"].astype(float)


# A hole after an eviction


def test_behind_a_hole_entries_are_found_and_not_made_again(kernels):
    """Insert A and B in one range, let A die, find B, insert B: one B. And where another took A's place."""
    table = OnDevice(*kernels, 64, 8, 4)
    a, b, c = (3, 100), (3, 200), (3, 300)
    assert table.in_turn([(INSERT, *a, 1), (INSERT, *b, 1), (INSERT, *b, 5)])[0] == [3, 3 + BLOCK, 3 + BLOCK]
    assert table.in_turn([(FIND, *a, 7), (FIND, *b, 7), (INSERT, *b, 7)])[0] == [NONE, 3 + BLOCK, 3 + BLOCK]
    assert table.in_turn([(INSERT, *c, 7), (FIND, *b, 7)]) == ([3, 3 + BLOCK], ["evicted", "hit"])
    assert [int(k) >> 32 for k in table.keys if k] == [300, 200]


# Duplicate keys


def test_a_key_that_stands_behind_a_free_place_gets_no_second_entry(kernels):
    """Alone and by a thousand work-items at once, the free place being wanted by others, too."""
    for _ in range(20):
        table = OnDevice(*kernels, 64, 4, 4)
        table.in_turn([(INSERT, 3, k, 1) for k in (100, 200, 300)])
        table.in_turn([(INSERT, 3, 300, 5)])  # of which the first two die
        check = np.array([300, 400, 200])[np.arange(1200) % 3]
        entries, outcomes = (np.array(x) for x in table.at_once(np.ones(1200), np.full(1200, 3), check, 7))
        checks = [int(k) >> 32 for k in table.keys if k]
        assert sorted(checks) == [200, 300, 400]
        assert (entries[check == 300] == 3 + 2 * BLOCK).all() and (outcomes == "evicted").sum() == 2


# Probing past the end


@pytest.mark.parametrize("capacity", [1, 7, 16, 17, 33])
@pytest.mark.parametrize("probe", [1, 64])
def test_tables_no_larger_than_a_search_is_long(capacity, probe):
    """Even ground looks as it does with any table, and no entry is there twice."""
    renderer = modelled(ground(), capacity=capacity, probe=probe, lifetime=2)
    for frame in renderer.frames(0, 3):
        np.testing.assert_allclose(frame.color["mono"], 0.5, rtol=1e-5)
        assert counters(frame)["discarded"] > 0 and counters(frame)["occupied"] <= capacity
    checks = held(renderer).check
    assert 0 < len(checks) == len(np.unique(checks)) <= capacity


# A hash equal to the value of an empty entry


def test_no_key_is_that_of_an_empty_entry(kernels):
    """The least check hash there is with the stamp 0, after 2^32 updates, is a key like others. That no hash is 0 is another test's."""
    table = OnDevice(*kernels, 64, 8, 4)
    assert table.in_turn([(INSERT, 3, 1, 0), (INSERT, 3, 2, 0), (FIND, 3, 1, 0), (FIND, 3, 2, 4)])[0] == [3, 19, 3, 19]
    assert (table.keys > 0).sum() == 2
    assert table.in_turn([(INSERT, 3, 1, 9), (FIND, 3, 1, 9)]) == ([3, 3], ["evicted", "hit"])


# The level chosen before the jitter

ASK = """
#include "voxelhash/ask.cl"

__kernel void ask_points(
    __global const float *points,  // (n, 3)
    __global const float *random,  // (n, 4)
    __global float *asked,         // (n, 3)
    __global int *level,           // (n)
    Camera camera,
    float factor,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Seen seen = { row3(points, i), vec3(0.0f, 1.0f, 0.0f), 1.0f };
    Random r = { random[4 * i], random[4 * i + 1], random[4 * i + 2], random[4 * i + 3] };
    Asked a = ask(&camera, &seen, factor, r);
    store_row(asked, i, a.point);
    level[i] = a.level;
}
"""


def test_the_level_is_that_of_the_place_that_is_asked(device, tmp_path):
    """Which is another one than that of the place seen, for some; they are no farther apart than a voxel's edge."""
    scene = ground()
    defines = SceneResources(device, scene).defines
    program = build(device, ASK, tmp_path, JITTER=1, COIN=0, GATE=1, LOD_BY_INCIDENCE=1, **defines)
    rng, n, factor = np.random.default_rng(0), 20000, 4.0
    points = np.zeros((n, 3), np.float32)
    points[:, [0, 2]] = rng.uniform(-3, 3, (n, 2))
    made = {"asked": device.empty((n, 3), np.float32), "level": device.empty(n, np.int32)}
    given = {"points": device.upload(points), "random": device.upload(rng.random((n, 4), np.float32))}
    program["ask_points"].run(n, given, made, camera=camera_record(scene.camera, SMALL), factor=factor, n=n)
    asked, level = made["asked"].get(), made["level"].get()
    normals, spread = np.tile([0.0, 1.0, 0.0], (n, 1)), 2 * np.tan(scene.camera.fov_y / 2) / SMALL[1]
    eye = scene.camera.transform[:, 3]
    before, _ = levels_of(eye, spread, points, normals, factor, True)
    after, certain = levels_of(eye, spread, asked, normals, factor, True)
    np.testing.assert_array_equal(level[certain], after[certain])
    assert 20 < (after != before)[certain].sum() < n / 2
    aside = (asked - points)[:, [0, 2]] / 2.0 ** before[:, None]
    assert (np.abs(asked[:, 1]) < 1e-5).all() and (np.abs(aside) <= 0.5001).all()
    assert np.abs(aside.mean(axis=0)).max() < 0.02 and np.abs(aside.var(axis=0) - 1 / 12).max() < 0.005


# Entries that keep each other alive


def test_what_is_seen_only_by_reflection_dies():
    """The camera turns from one wall of a corridor to the other: paths from there find the first one in every frame, and its voxels are
    not touched, so that they die."""
    wall = floor(20)
    up, down = at((0, 0, 0)), np.array([[1.0, 0, 0, 0], [0, -1, 0, 2], [0, 0, -1, 0]])
    below, above = (view((0, 1, 0), (0.1, y, 0), 60) for y in (0, 2))
    scene = lit(wall, camera=below, materials=[grey(0.8)], instances=[(0, up), (0, down)], environment=(1.0, 1.0, 1.0))
    renderer = voxels(along(scene, [below] * 3 + [above] * 8 + [below]), lifetime=4, aovs=("age",))
    first = list(renderer.frames(0, 3))
    assert counters(first[-1])["hits"] > 100
    seen_below = held(renderer)
    list(renderer.frames(3, 11))
    later = held(renderer).stamps
    for check, stamp in seen_below.stamps.items():
        assert later.get(check, stamp) == stamp
    (back,) = renderer.frames(11, 12)
    assert np.isinf(back.aov("age", "mono")).all(), "voxels that are found have lived on"
    assert counters(back)["evicted"] > 0


# Sums that overflow


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")  # where lamps are weighed against each other
def test_lamps_of_any_power_leave_finite_voxels():
    """A sky of 1e30 and one of 1e-30: means, not sums, are kept. And a path whose light overflows is left out."""
    suns = {1e-30: [], 1e30: [], 3e38: [DirectionalLight((0.0, -1.0, 0.0), (3.3e38, 3.3e38, 0.0))]}
    for power, sun in suns.items():
        scene = ground(1.0, lights=sun, environment=(power, power, 0.0))
        renderer = voxels(scene, bounces=0)
        *_, last = renderer.frames(0, 4)
        kept = held(renderer)
        assert np.isfinite(kept.radiance).all() and np.isfinite(last.color["mono"]).all()
        assert (kept.count > 0).all() if power < 1e38 else (kept.count == 0).any()
        if power < 1e38:
            np.testing.assert_allclose(kept.radiance[:, :2], np.float32(power), rtol=1e-5)


def test_after_ten_thousand_frames_a_count_is_full_and_the_mean_stays():
    """Counts near their end are written: they stop there, and a mean goes on moving by a new value's part, in float32, to its end."""
    renderer = modelled(ground(0.5), level_bias=6, gate=False)
    list(renderer.frames(0, 2))
    arrays = renderer._graph.of("mono")
    for count, start in ((10000, 0.5), (MOST_COUNTED - 1, 2.0), (MOST_COUNTED, 2.0)):
        values = arrays["voxel_radiance"].get()
        used = values[:, 3] > 0
        values[used] = (start, start, start, count)
        arrays["voxel_radiance"].set(values)
        list(renderer.frames(2, 5))
        after = arrays["voxel_radiance"].get()[used]
        grown = after[:, 3] > count if count < MOST_COUNTED else after[:, 0] != start
        assert grown.any()
        assert after[:, 3].max() == min(count + 3, MOST_COUNTED)
        sun = 1.0  # irradiance / pi: what a voxel keeps has no albedo
        updates = after[:, 3] - count if count < MOST_COUNTED - 1 else np.full(len(after), 3)
        expected = sun + (start - sun) * (count / (count + updates))
        rtol = 1e-6 if count == 10000 else 2e-5  # not all are asked in each frame, which a full count does not tell
        np.testing.assert_allclose(after[grown, 0], expected[grown], rtol=rtol)


def test_a_full_count_still_follows_what_it_sees():
    """Of a new value one part in 65,536 is taken, which float32 does not lose."""
    renderer = modelled(ground(0.5), level_bias=6, gate=False)
    list(renderer.frames(0, 1))
    arrays = renderer._graph.of("mono")
    values = arrays["voxel_radiance"].get()
    values[values[:, 3] > 0] = (2.0, 2.0, 2.0, MOST_COUNTED)
    arrays["voxel_radiance"].set(values)
    list(renderer.frames(1, 2))
    moved = arrays["voxel_radiance"].get()
    moved = moved[(moved[:, 3] > 0) & (moved[:, 0] != 2.0)]
    assert len(moved) > 0 and (moved[:, 3] == MOST_COUNTED).all()
    np.testing.assert_allclose(2.0 - moved[:, 0], 1 / (MOST_COUNTED + 1), rtol=0.02)


# A failed insert that returns a place all the same


@pytest.mark.parametrize("method", ["voxelhash", "hybrid"])
@pytest.mark.parametrize("capacity", [1, 16])
def test_what_finds_no_place_is_traced_by_itself_and_counted(method, capacity):
    """The image's expectation is that of path tracing, and it is all but as noisy."""
    scene, ours = yard(moving=False), []
    for seed in range(12):
        (frame,) = voxels(scene, method, capacity=capacity, gate=False, seed=seed).frames(0, 1)
        found = counters(frame)
        assert found["discarded"] >= found["lookups"] - 200 > 0
        assert found["shaded"] == found["discarded"] + found["inserted"]
        ours.append(color(frame))
    traced = [image(scene, SMALL, 1, seed=100 + s) for s in range(12)]
    for verdict in agree(ours, traced):
        assert verdict.passed, verdict
    noise = [np.std(images, axis=0).mean() for images in (ours, traced)]
    assert noise[0] == pytest.approx(noise[1], rel=0.1)


# False hits of 32-bit hashes


@pytest.mark.parametrize("load", [0.25, 0.9])
def test_false_hits_are_as_many_as_those_of_independent_hashes(device, load):
    """Of hashes cut to ten bits, of which there are enough to count; of whole ones there is none in a million lookups."""
    for bits in (10, 32):
        table = Filled(device, 2**14, load, 8, bits, 1)
        _, false, compared = table.lookups(10**6, False)
        expected = compared / 2**bits
        assert abs(false - expected) <= 5 * np.sqrt(expected) + 1e-9 if bits == 10 else false == 0
        found, false, _ = table.lookups(10**6, True)
        assert found > 0.8 * 10**6 and (false > 0) == (bits == 10)
        table.release()


# Settings that change under a table


CHANGED = [
    {"voxelhash.lod": "distance"},
    {"voxelhash.level_bias": 1.0},
    {"voxelhash.capacity": 4096},
    {"voxelhash.alpha": 0.5},
    {"pathtrace.bounces": 0},
]


@pytest.mark.parametrize("changed", CHANGED, ids=str)
def test_a_table_of_other_settings_is_refused(changed, tmp_path):
    """By what goes on with a saved state, and by a warm start; of the same settings both take it."""
    scene = ground()
    first = voxels(scene)
    list(first.frames(0, 1))
    first.save(tmp_path / "state.npz")
    name = next(iter(changed))
    for go_on in ("restore", "warm_start"):
        with pytest.raises(SettingError, match=name):
            getattr(voxels(scene, settings=changed), go_on)(tmp_path / "state.npz")
        other = voxels(scene)
        getattr(other, go_on)(tmp_path / "state.npz")
        assert counters(next(other.frames(1, 2)))["hits"] > 0


def test_renderers_on_a_device_share_no_table():
    """Taking turns, each shows what it shows alone."""
    options = [{}, {"level_bias": 1.0}]
    alone = [[color(f) for f in voxels(yard(3), **o).frames(0, 3)] for o in options]
    assert not np.array_equal(alone[0][0], alone[1][0])
    together = [voxels(yard(3), **o) for o in options]
    for number in range(3):
        for renderer, expected in zip(together, alone, strict=True):
            np.testing.assert_array_equal(color(next(renderer.frames(number, number + 1))), expected[number])


# The level missing from the key


def test_the_level_is_part_of_the_key(device, tmp_path):
    """Cell (5, 0, 0) of edge 1 and cell (5, 0, 0) of edge 2 are two voxels."""
    address = Addressing(device, tmp_path)
    _, place, check = address([(5.5, 0.5, 0.5), (11, 1, 1)], [(0, 1, 0)] * 2, [0, 1])
    assert check[0] != check[1] and place[0] != place[1]


# A new cell that answers black


@pytest.mark.parametrize("method", ["voxelhash", "hybrid"])
def test_the_first_frame_is_that_of_path_tracing(method):
    """In expectation; and no pixel is black. (Of voxels that are shared by pixels with others than theirs the table knows nothing yet.)"""
    scene = yard(moving=False)
    ours = [color(next(voxels(scene, method, seed=s, level_bias=-2).frames(0, 1))) for s in range(12)]
    traced = [image(scene, SMALL, 1, seed=100 + s) for s in range(12)]
    for verdict in agree(ours, traced):
        assert verdict.passed, verdict
    for frame in voxels(ground(0.5), method, bounces=0).frames(0, 2):
        np.testing.assert_allclose(frame.color["mono"], 0.5, rtol=1e-5)


def test_after_a_cut_all_is_new_and_nothing_black():
    scene = along(ground(0.5), [ABOVE] * 3 + [view((60, 2, 0), (62, 0, 0.1))] * 2)
    renderer = voxels(scene, bounces=0)
    for frame in renderer.frames(0, 5):
        np.testing.assert_allclose(frame.color["mono"], 0.5, rtol=1e-5)
        assert frame.number != 3 or counters(frame)["hits"] < counters(frame)["inserted"]


# Leaks at thin and near geometry


@pytest.mark.parametrize("gate", [True, False])
def test_near_surfaces_are_asked_for_only_without_the_gate(gate):
    """Where a voxel's diagonal is longer than the distance, each pixel's own path answers."""
    scene = ground(eye=(0, 1, 3), degrees=30)
    renderer = modelled(scene, gate=gate, level_bias=3.5, aovs=("voxel", "level"))
    (frame,) = renderer.frames(0, 1)
    points = on_floor(scene.camera, SMALL).reshape(-1, 3)
    eye = scene.camera.transform[:, 3]
    spread = 2 * np.tan(scene.camera.fov_y / 2) / SMALL[1]
    levels, certain = levels_of(eye, spread, points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), 2.0**3.5, True)
    near = np.linalg.norm(points - eye, axis=1) < np.sqrt(3) * 2.0**levels
    assert 0.1 < near.mean() < 0.9
    has_voxel = np.isfinite(frame.aov("level", "mono")).ravel()
    np.testing.assert_array_equal(has_voxel[certain], (~near if gate else np.full(near.shape, True))[certain])
    np.testing.assert_allclose(frame.color["mono"], 0.5, rtol=1e-5)
    assert counters(frame)["shaded"] >= (~has_voxel).sum()


def corner(gate):
    """The mean image of a ball's shadow on the ground just before the eye, in voxels of many pixels: by the table, and true."""
    shade = lit(
        floor(20), ball(0.02, 2, 1), camera=view((0, 0.3, 0.3), (0, 0, 0)), materials=[grey(0.5), grey(0.5)],
        lights=[SUN], instances=[(0, IDENTITY), (1, at((0, 0.04, 0)))],
    )  # fmt: skip
    options = {"bounces": 0, "level_bias": 4.5, "gate": gate, "lod": "distance", "jitter": False}
    return np.mean([color(f) for f in voxels(shade, **options).frames(0, 8)], axis=0), image(
        shade, SMALL, 64, bounces=0
    )


def test_the_gate_keeps_light_from_leaking_where_voxels_are_as_large_as_the_view():
    """With it the shadow is where it is; without, it is smeared over the ground."""
    errors = {}
    for gate in (True, False):
        ours, truth = corner(gate)
        errors[gate] = np.abs(ours - truth).mean()
    assert errors[True] < 0.3 * errors[False]


@pytest.mark.parametrize("gate", [True, False])
def test_the_sides_of_a_thin_wall_share_no_voxel(gate):
    """A wall without thickness, lit from one side, seen from there and then from the other, which stays black; and back."""
    front, back = view((0, 3, 0.1), (0, 0, 0)), view((0, -3, 0.1), (0, 0, 0))
    scene = along(ground(0.5), [front] * 3 + [back] * 3 + [front])
    renderer = voxels(scene, bounces=0, gate=gate, level_bias=3, aovs=("voxel", "level"))
    *_, seen_front = renderer.frames(0, 3)
    *_, seen_back = renderer.frames(3, 6)
    assert not seen_back.color["mono"].any() and counters(seen_back)["hits"] > 0
    sides = [set(np.unique(colours_of(f))) - {-1} for f in (seen_front, seen_back)]
    assert all(sides) and not sides[0] & sides[1]
    np.testing.assert_allclose(next(renderer.frames(6, 7)).color["mono"], 0.5, rtol=1e-5)


# History across levels


def dolly(inherit, seed):
    """Relative error of the image right after the camera came so much nearer that all levels are others, and what is inherited."""
    scene = ground(0.6, lights=(), environment=(1.0, 1.0, 1.0), eye=(0, 3, 0.1))
    scene = replace(scene, meshes=(*scene.meshes, floor(3)), instances=(*scene.instances, roof()))
    far, near = view((0, 2.6, 0.1), (0, 0, 0)), view((0, 1.3, 0.05), (0, 0, 0))
    renderer = voxels(along(scene, [far] * 24 + [near] * 2), inherit=inherit, seed=seed, bounces=0, aovs=("level",))
    *_, before = renderer.frames(0, 24)
    (after,) = renderer.frames(24, 25)
    return before, after


def roof():
    from clcache.scene.model import Instance

    return Instance("roof", 1, np.array([[1.0, 0, 0, 3.2], [0, 1, 0, 2], [0, 0, 1, 0]]))


def test_a_change_of_level_keeps_what_was_known():
    """Right after it the noise is a fraction of what it is without: that of several values, not of one."""
    noise = {}
    for inherit in (True, False):
        pairs = [dolly(inherit, seed) for seed in range(6)]
        levels = [np.median(f.aov("level", "mono")) for f in pairs[0]]
        assert levels[1] == levels[0] - 1
        images = [color(after) for _, after in pairs]
        noise[inherit] = np.std(images, axis=0).mean()
        assert np.mean(images) == pytest.approx(np.mean([color(b) for b, _ in pairs]), rel=0.03)
    assert noise[True] < 0.6 * noise[False]


# Looking away and back


def there_and_back(away, lifetime, seed=0, **options):
    """Frames of a still view, of the sky, and of the view again: the renderer, that first frame again, and the last before."""
    scene = yard(moving=False)
    cameras = [scene.camera] * 6 + [AWAY] * away + [scene.camera] * 4
    renderer = voxels(along(scene, cameras), lifetime=lifetime, seed=seed, aovs=("age", "count", "Z"), **options)
    *_, before = renderer.frames(0, 6)
    list(renderer.frames(6, 6 + away))
    (back,) = renderer.frames(6 + away, 7 + away)
    return renderer, before, back


def test_who_looks_away_for_less_than_a_lifetime_finds_what_was_known():
    """To the frame: after a lifetime it is there, and one frame later no more."""
    _, before, back = there_and_back(3, 4, level_bias=2, jitter=False, gate=False)
    near = np.isfinite(back.aov("Z", "mono"))
    age, count = back.aov("age", "mono")[near], back.aov("count", "mono")[near]
    assert set(np.unique(age)) <= {4.0, np.inf} and (age == 4).mean() > 0.7, "asked last in the frame before the turn"
    assert count.mean() > 3
    renderer, _, late = there_and_back(4, 4, level_bias=2, jitter=False, gate=False)
    near = np.isfinite(late.aov("Z", "mono"))
    assert np.isinf(late.aov("age", "mono")).all()
    assert (late.aov("count", "mono")[near] == 1).all() and counters(late)["hits"] < counters(late)["lookups"]


@pytest.mark.parametrize(("away", "is_kept"), [(2, True), (12, False)])
def test_what_was_forgotten_does_not_tint_what_comes_back(away, is_kept):
    """All voxels are made red before the view turns to the sky: they are so when it returns within their lifetime, but after it
    nothing is left of them, in no pixel, whether new voxels inherit or not."""
    for inherit in (False, True):
        scene = ground(0.5)
        renderer = voxels(
            along(scene, [ABOVE] * 3 + [AWAY] * away + [ABOVE] * 4), lifetime=6, inherit=inherit, bounces=0
        )
        list(renderer.frames(0, 3))
        arrays = renderer._graph.of("mono")
        values = arrays["voxel_radiance"].get()
        values[values[:, 3] > 0] = (100.0, 0.0, 0.0, 50.0)
        arrays["voxel_radiance"].set(values)
        *_, back = renderer.frames(3, 4 + away)
        if is_kept:
            assert color(back)[..., 0].max() > 10
        else:
            np.testing.assert_allclose(color(back), 0.5, rtol=1e-5)


def test_a_view_that_was_left_is_as_bright_as_one_that_was_not():
    ours = [np.mean([color(f) for f in there_and_back(12, 6, s)[0].frames(19, 22)]) for s in range(6)]
    still = [
        np.mean([color(f) for f in list(voxels(yard(moving=False), seed=50 + s).frames(0, 10))[-3:]]) for s in range(6)
    ]
    spread = np.hypot(np.std(ours, ddof=1), np.std(still, ddof=1)) / np.sqrt(6)
    assert abs(np.mean(ours) - np.mean(still)) < 4 * spread + 1e-3 * np.mean(still)


# Flicker where values are few


def test_hybrid_answers_by_the_parent_while_the_voxel_has_few_values():
    """The parent stands in where there is no voxel; where both are there, it has half a say at 16 values of the voxel's, and ever less."""
    renderer = voxels(yard(moving=False), "hybrid", size=(16, 12))
    for count in (None, 1, 16, 1000):
        list(renderer.frames(0, 2))
        arrays = renderer._graph.of("mono")
        if count:  # all values known apart: even entries hold one, odd ones another number of values
            values = arrays["voxel_radiance"].get()
            values[values[:, 3] > 0, 3] = count
            arrays["voxel_radiance"].set(values)
            list(renderer.frames(2, 3))
        values, place, pixels = (
            arrays["voxel_radiance"].get(),
            arrays["seen_place"].get(),
            renderer.size[0] * renderer.size[1],
        )
        weight = arrays["sample_weight"].get()
        listed = int(arrays["seen_listed"].get()[0])
        value, albedo = (arrays[name].get().T[:listed] for name in ("sample_value", "sample_albedo"))
        answer = value / np.maximum(albedo, 1e-9)
        assert 0 < listed <= place.shape[1]
        own, above = (np.where(p == NONE, 0, p) for p in place[:, :listed])
        is_own, is_above = (p != NONE for p in place[:, :listed])
        n_own, n_above = np.where(is_own, values[own, 3], 0), np.where(is_above, values[above, 3], 0)
        share = n_above * 16 / (16 + n_own)
        total = n_own + share
        surface = (weight[:listed] >= 0) & (total > 0)
        part = np.where(n_own > 0, share / np.maximum(total, 1e-9), 1.0)[:, None]
        expected = np.where(is_own[:, None], values[own, :3], 0) * (1 - part) + values[above, :3] * part
        expected = np.where((n_above > 0)[:, None], expected, values[own, :3])
        assert surface.sum() > pixels / 4 and (is_own & is_above)[surface].sum() > pixels / 8
        np.testing.assert_allclose(answer[surface], expected[surface], rtol=1e-4, atol=1e-6)
        alone = surface & (n_own == 0)
        assert count or alone.any()


def test_hybrid_flickers_less_than_its_voxels_alone_where_all_is_new():
    """In the second frame of many, a pixel's noise over renders, against that of asking without parents and without keeping samples."""
    scene = yard(moving=False)
    noise = {}
    for method in ("voxelhash", "hybrid"):
        noise[method] = np.std(
            [color(list(voxels(scene, method, seed=s).frames(0, 4))[-1]) for s in range(8)], axis=0
        ).mean()
    assert noise["hybrid"] < 0.8 * noise["voxelhash"]
