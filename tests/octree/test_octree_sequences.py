"""Sequences of frames by the octree: what follows a saved state, what another sequence knows of the world, what both eyes share, the
same bits by any number of threads, and what is said of it all.
"""

import json
import os
import zlib
from dataclasses import replace

import numpy as np
import pytest
from cache_renders import along, at, counters, in_child, one_device, orbit, yard
from helpers import IDENTITY
from render_helpers import ball, floor, grey, lit

from clcache import Renderer, SettingError
from clcache.passes.octree_update import COUNTERS
from clcache.scene.model import DirectionalLight, Material, PointLight, Track

SIZE = (23, 17)
FRAMES = 6
AOVS = ("albedo", "N", "Z", "voxel", "level", "count")
LAYERS = ("layer0", "layer1", "layer2", "filtered0", "filtered1", "filtered2")
READ_ONLY = {"octree.caching_resolution": 0.0}
# What another render may set otherwise to read the same cells.
READING = {
    "octree.samples": 2,
    "octree.jitter": 0.0,
    "octree.gate": False,
    "octree.level_bias": -1.0,
    "octree.filter": "none",
    "octree.layered": False,
    "octree.frame_time": 1000.0,
    "octree.paths": "surfaces",
    "octree.caching_resolution": 0.5,
    "octree.filter_luminance": 0.0,
}


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def octree(scene, size=SIZE, **options):
    """A renderer of few cells."""
    given = {"octree.resolution": 64, "pathtrace.bounces": 2} | options.pop("settings", {})
    return Renderer(scene, "octree", size, settings=given, **({"seed": 3} | options))


def walk(moving=False):
    """Over a floor a diffuse ball, a mirror, a rough metal and a glass ball, before a camera that walks about; if `moving`, the diffuse
    one flies."""
    metal = Material("metal", (0.9, 0.7, 0.5), metallic=1.0, roughness=0.4)
    mirror, glass = Material("mirror", metallic=1.0, roughness=0.0), Material("glass", transmission=1.0, specular=1.0)
    fly = Track(
        np.arange(2.0), np.array([(0, 0.8, 0), (1.0, 1.2, 0)]), np.tile([0, 0, 0, 1.0], (2, 1)), np.ones((2, 3))
    )
    places = ((0, 0.8, 0), (-1.2, 0.5, 0.6), (1.1, 0.4, 0.9), (0.2, 0.35, 1.6))
    radii = (0.8, 0.5, 0.4, 0.35)
    scene = lit(
        floor(6), *(ball(radius, 2, 1 + k) for k, radius in enumerate(radii)),
        camera=orbit(1)[0], materials=[grey(0.6), Material("red", (0.8, 0.3, 0.2)), mirror, metal, glass],
        lights=[DirectionalLight((0.48, -0.8, 0.36), (2.0, 1.8, 1.5))], environment=(0.3, 0.4, 0.5),
        instances=[(0, IDENTITY), *((1 + k, at(place)) for k, place in enumerate(places))], eye_distance=0.06,
    )  # fmt: skip
    if moving:
        first, flying, *others = scene.instances
        scene = replace(scene, instances=(first, replace(flying, motion=(fly,)), *others))
    return along(scene, orbit(FRAMES))


def shone(speed):
    """A floor under a lamp, which moves by `speed` in a second, before a camera at rest."""
    places = np.array([(0.0, 3.0, 0.0), (100 * speed, 3.0, 0.0)])
    slide = Track(np.array([0.0, 100.0]), places, np.tile([0, 0, 0, 1.0], (2, 1)), np.ones((2, 3)))
    lamp = PointLight((0, 0, 0), (20.0, 20.0, 20.0), (slide,))
    scene = lit(floor(6), camera=orbit(1)[0], materials=[grey(0.6)], lights=[lamp])
    return replace(scene, defaults=replace(scene.defaults, fps=1.0))


def look(frame, aovs=()):
    """Its pictures, AOVs and counters."""
    images = [image for eye, color in frame.color.items() for image in (color, *(frame.aov(a, eye) for a in aovs))]
    return images, [(stats["rays"], stats["cache"]) for stats in frame.stats["eyes"].values()]


def assert_same(found, expected, aovs=()):
    (images, counted), (others, other_counted) = look(found, aovs), look(expected, aovs)
    assert counted == other_counted
    for image, other in zip(images, others, strict=True):
        np.testing.assert_array_equal(image, other)


def cells(of):
    return of._graph.of()["octree_cells"].get()


def stamp(of):
    """How often the cells were wiped, and once more."""
    return int(of._graph.of()["octree_wipe"].get()[0])


# Going on


@pytest.mark.parametrize(
    "options",
    [
        {"stereo": True},
        {"spp": 3},
        {"temporal": "varianceblend"},
        {"settings": {"octree.paths": "surfaces", "octree.caching_resolution": 0.5}},
        {"stereo": True, "stereo_blend": "varianceblend", "settings": {"octree.filter": "none"}},
    ],
    ids=str,
)
@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
def test_what_follows_a_state_is_what_would_have_followed(tmp_path, moving, options):
    whole, begun, afresh = (octree(walk(moving), aovs=AOVS, **options) for _ in range(3))
    expected = list(whole.frames(0, FRAMES))
    list(begun.frames(0, 3))
    begun.save(tmp_path / "s.npz")
    assert afresh.restore(tmp_path / "s.npz") == 2
    for frame, other in zip(afresh.frames(3, FRAMES), expected[3:], strict=True):
        assert_same(frame, other, AOVS)
    np.testing.assert_array_equal(cells(afresh), cells(whole))


def test_the_running_estimate_of_a_camera_at_rest_goes_on(tmp_path):
    whole, begun, afresh = (octree(yard(moving=False)) for _ in range(3))
    expected = list(whole.frames(0, 5))
    list(begun.frames(0, 2))
    begun.save(tmp_path / "s.npz")
    afresh.restore(tmp_path / "s.npz")
    for frame, other in zip(afresh.frames(2, 5), expected[2:], strict=True):
        assert_same(frame, other)


@pytest.mark.parametrize("setting", ["octree.resolution", *READING])
def test_a_state_is_of_the_same_settings(tmp_path, setting):
    of = octree(walk())
    list(of.frames(0, 1))
    of.save(tmp_path / "s.npz")
    other = octree(
        walk(), settings={"octree.resolution": 128} if setting == "octree.resolution" else {setting: READING[setting]}
    )
    with pytest.raises(SettingError, match=rf"s\.npz: settings (of the image )?{setting} is .* there and .* here"):
        other.restore(tmp_path / "s.npz")


# What another sequence knows


@pytest.fixture(scope="module")
def learnt(tmp_path_factory, compiled_once):
    """The state of a walk of two eyes, and its cells."""
    path = tmp_path_factory.mktemp("octree") / "s.npz"
    of = octree(walk(), stereo=True, spp=4)
    list(of.frames(0, FRAMES))
    of.save(path)
    return path, cells(of)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"size": (9, 30)},
        {"stereo": True, "seed": 99},
        {"spp": 2},
        {"temporal": "taa"},
        *({"settings": {name: value}} for name, value in READING.items()),
    ],
    ids=str,
)
def test_a_warm_start_finds_the_cells(learnt, options):
    """Of most points that the first frame of another render asks for; without it, of none."""
    path, known = learnt
    cold, warm = (octree(walk(), **options) for _ in range(2))
    warm.warm_start(path)
    np.testing.assert_array_equal(cells(warm), known)
    found, fresh = (next(of.frames(3, 4)).stats["eyes"] for of in (warm, cold))
    for eye in found:
        cache = found[eye]["cache"]
        assert cache["hits"] > 0.8 * cache["lookups"] > 0
    assert fresh[next(iter(fresh))]["cache"]["occupied"] < found[next(iter(found))]["cache"]["occupied"]


def test_what_only_reads_changes_no_cell(learnt):
    """Nor is anything traced into them: pictures of other views are of what was learnt."""
    path, known = learnt
    warm = octree(walk(), settings=READ_ONLY)
    warm.warm_start(path)
    frames = list(warm.frames(0, FRAMES))
    np.testing.assert_array_equal(cells(warm), known)
    assert all(counters(frame)["inserted"] == 0 for frame in frames)
    assert all(counters(frame)["hits"] > 0.8 * counters(frame)["lookups"] for frame in frames)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"settings": {"octree.resolution": 128}}, "settings octree.resolution is 64 there and 128 here"),
        ({"settings": {"octree.store": 2}}, "settings octree.store is .* there and 2 here"),
        ({"settings": {"octree.length": 1}}, "settings octree.length is .* there and 1 here"),
        ({"settings": {"pathtrace.bounces": 1}}, "settings pathtrace.bounces is 2 there and 1 here"),
        ({"scene": walk(moving=True)}, "content of the scene is"),
    ],
)
def test_a_warm_start_with_other_light_is_refused(learnt, options, message):
    of = octree(**{"scene": walk()} | options)
    with pytest.raises(SettingError, match=message) as caught:
        of.warm_start(learnt[0])
    assert "\n" not in str(caught.value)


def test_a_warm_start_with_another_method_is_refused(learnt, tmp_path):
    settings = {"octree.resolution": 64, "pathtrace.bounces": 2, "voxelhash.capacity": 1024}
    of = Renderer(walk(), "voxelhash", SIZE, settings=settings, seed=3)
    for go_on in (of.warm_start, of.restore):
        with pytest.raises(SettingError, match="method is octree there and voxelhash here|voxelhash.capacity is"):
            go_on(learnt[0])
    list(of.frames(0, 1))
    of.save(tmp_path / "s.npz")
    with pytest.raises(SettingError, match="method is voxelhash there and octree here|voxelhash.capacity is"):
        octree(walk()).warm_start(tmp_path / "s.npz")


def test_a_warm_start_under_a_lamp_that_is_elsewhere_knows_nothing(tmp_path):
    """And where the lamp is where it was, it knows it all."""
    of = octree(shone(speed=0.5), spp=4)
    list(of.frames(0, 2))
    of.save(tmp_path / "s.npz")
    for number, is_known in ((1, True), (2, False)):
        warm = octree(shone(speed=0.5), settings=READ_ONLY)
        warm.warm_start(tmp_path / "s.npz")
        cache = counters(next(warm.frames(number, number + 1)))
        assert (cache["hits"] > 0) == is_known and (cache["occupied"] > 0) == is_known


def test_cells_are_wiped_where_light_moves_and_only_there():
    for scene, wipes in ((shone(0.0), 0), (shone(0.5), 3), (walk(), 0), (walk(moving=True), 1)):
        of = octree(scene, stereo=True)
        before = []
        for _ in of.frames(0, 4):  # the ball comes to rest in the second frame
            before.append(stamp(of))
        assert before[-1] - before[0] == wipes, before


# What both eyes share


def test_eyes_share_the_cells():
    """What the left eye left is there for the right one, and the memory is that of one eye."""
    mono, stereo = (
        octree(walk(), spp=4),
        octree(walk(), spp=4, stereo=True, aovs=("count",), settings={"octree.samples": 1}),
    )
    assert mono.stats()["memory"]["cache"] == stereo.stats()["memory"]["cache"]
    frame = next(stereo.frames(0, 1))
    left, right = (frame.stats["eyes"][eye]["cache"] for eye in ("left", "right"))
    assert right["occupied"] > left["occupied"] > 0
    assert frame.aov("count", eye="right").mean() > 1.5 * frame.aov("count", eye="left").mean()  # the samples of both


# The same bits


def checksum(moving, **options):
    aovs = (*AOVS, *LAYERS)
    of = octree(walk(moving), stereo=True, aovs=aovs, **options)
    kept = []
    for frame in of.frames(0, 4):
        images, counted = look(frame, aovs)
        kept += [*images, np.array([list(cache.values()) for _, cache in counted])]
    return zlib.crc32(b"".join(np.ascontiguousarray(values).tobytes() for values in (*kept, cells(of))))


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_the_same_bits_by_one_and_two_threads():
    """In processes of their own: PoCL fixes its number of threads once in a process."""
    code = "import test_octree_sequences as t; print(*(t.checksum(m, threads={}) for m in (False, True)))"
    assert in_child(code.format(1)) == in_child(code.format(2)) == [checksum(moving) for moving in (False, True)]


def test_work_groups_and_runs():
    usual = checksum(False)
    assert checksum(False) == usual == checksum(False, settings={"device.local_size": 7})
    assert checksum(False, seed=4) != usual


# What is said


def test_stats_have_the_octree():
    of = octree(walk(), stereo=True)
    stats = json.loads(json.dumps(of.stats()))
    levels = stats["octree"]["levels"]
    assert stats["octree"]["resolution"] == 64
    assert [level["level"] for level in levels] == list(range(7)) and levels[0]["cells"] == 1
    count = sum(level["cells"] for level in levels)
    assert sum(level["data_bytes"] for level in levels) == 24 * count == cells(of).nbytes
    tables = stats["memory"]["cache"] - 24 * count
    assert sum(level["hash_bytes"] for level in levels) >= 8 * count
    assert tables >= sum(level["hash_bytes"] for level in levels)
    assert stats["seconds"]["octree"] > 0
    for frame in of.frames(0, 2):
        for eye in frame.stats["eyes"].values():
            assert tuple(eye["cache"]) == COUNTERS
            cache = eye["cache"]
            assert cache["capacity"] == count >= cache["occupied"] > 0
            assert cache["hits"] + cache["traced"] == cache["lookups"] > 0
            groups = {name.split(".")[0] for name in eye["passes"]}
            assert {"caching", "reconstruction"} <= groups


def test_levels_are_those_of_the_last_update():
    """The number of cells in use, and of all; what is done is that of all updates of a frame."""
    once, thrice = (octree(walk(), spp=spp) for spp in (1, 3))
    one = [counters(frame) for frame in once.frames(0, 1)][0]
    three = [counters(frame) for frame in thrice.frames(0, 1)][0]
    assert three["capacity"] == one["capacity"]
    assert three["lookups"] > 2.5 * one["lookups"]
    assert one["occupied"] <= three["occupied"] < 3 * one["occupied"]


def test_aovs():
    frame = [*octree(walk(), spp=8, aovs=(*AOVS, *LAYERS)).frames(0, 2)][-1]
    level, count, voxel = (frame.aov(name, "mono") for name in ("level", "count", "voxel"))
    answered = np.isfinite(level)
    assert answered.mean() > 0.4 and (count[answered] >= 1).all()
    assert (level[answered] >= 0).all() and (level[answered] <= 6).all() and (level[answered] % 1 == 0).all()
    assert (voxel[answered] > 0).any(axis=-1).all()
    for name in LAYERS:
        layer = frame.aov(name, "mono")
        assert layer.shape == (SIZE[1], SIZE[0], 3) and np.isfinite(layer).all() and (layer >= 0).all()
        assert layer.any(), name
    assert all((frame.aov(f"layer{k}", "mono") != frame.aov(f"filtered{k}", "mono")).any() for k in range(2))
