"""VoxelHash and Hybrid as a whole: what is in the table after frames, what images show, and what is said of both."""

import os
import zlib
from dataclasses import replace

import numpy as np
import pytest
from cache_renders import at, counters, in_child, one_device, orbit, yard
from helpers import IDENTITY
from render_helpers import ball, floor, grey, image, lit, on_floor, view
from voxelhash_model import levels_of, voxels_of
from voxelhash_renders import CAPACITY, SMALL, colours_of, ground, held, modelled, voxels

from clcache import SettingError
from clcache.metrics import relmse
from clcache.scene.model import Material

PIXELS = SMALL[0] * SMALL[1]
METHODS = ("voxelhash", "hybrid")
AOVS = ("albedo", "N", "Z", "voxel", "level", "count", "age")
LEVELS = ("occupied", "visible", "voxels", "capacity")


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def frames(scene, count, **options):
    return list(voxels(scene, **options).frames(0, count))


# The same bits


def checksum(method, stereo, **options):
    aovs = AOVS if method == "voxelhash" else ()
    renderer = voxels(yard(4), method, (29, 21), stereo=stereo, aovs=aovs, **options)
    kept = []
    for frame in renderer.frames(0, 4):
        for eye in frame.color:
            kept += [frame.color[eye], *(frame.aov(name, eye) for name in aovs)]
        kept.append(np.array([list(counters(frame, eye).values()) for eye in frame.color]))
    table = held(renderer)
    kept += [table.check, table.stamp, table.radiance, table.count]
    return zlib.crc32(b"".join(np.ascontiguousarray(values).tobytes() for values in kept))


CASES = [(method, stereo) for method in METHODS for stereo in (False, True)]


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_the_same_bits_by_one_and_two_threads():
    """In processes of their own: PoCL fixes its number of threads once in a process."""
    code = "import test_voxel_method as t; print(*(t.checksum(*case, threads={}) for case in t.CASES))"
    assert in_child(code.format(1)) == in_child(code.format(2)) == [checksum(*case) for case in CASES]


@pytest.mark.parametrize(("method", "stereo"), CASES)
def test_the_same_bits_in_other_work_groups_and_runs(method, stereo):
    usual = checksum(method, stereo)
    assert checksum(method, stereo) == usual
    assert checksum(method, stereo, settings={"device.local_size": 7}) == usual
    assert checksum(method, stereo, seed=1) != usual


# What is in the table


@pytest.mark.parametrize(("method", "stereo"), CASES)
def test_a_voxel_is_updated_at_most_once_in_a_frame(method, stereo):
    """By both eyes together: the second only reads what the first has updated."""
    renderer = voxels(yard(6), method, stereo=stereo, inherit=False, gate=False)
    before, shared = {}, 0
    for number, frame in enumerate(renderer.frames(0, 6)):
        now = held(renderer)
        grown = {check: count - before.get(check, 0) for check, count in now.counts.items()}
        assert set(grown.values()) <= {0, 1}
        eyes = list(frame.color)
        shaded = sum(counters(frame, eye)["shaded"] for eye in eyes)
        assert sum(grown.values()) == shaded, "every path went into a voxel of its own"
        asked = np.isin(now.stamp, [2 * number + 1 + eye for eye in range(len(eyes))])
        assert asked.sum() == shaded, "every voxel that was asked is updated"
        shared += sum(counters(frame, eye)["lookups"] for eye in eyes) - shaded
        before = now.counts
    assert shared > 100, "or nothing is shown"


def test_the_second_eye_reads_what_the_first_has_updated():
    """Eyes in one place, without anything random in what they ask: the second traces nothing where voxels are those of the first."""
    scene = ground()
    (first,) = modelled(scene, stereo=True, level_bias=6, gate=False, aovs=("voxel", "level")).frames(0, 1)
    left, right = (set(np.unique(colours_of(first, eye))) for eye in ("left", "right"))
    assert counters(first, "left")["shaded"] == len(left)
    assert counters(first, "right")["shaded"] == len(right - left) < len(right) // 2


def test_who_updates_a_voxel_is_drawn_anew_in_each_frame():
    """Of pixels that share voxels, about eight each, every one has its turn, and none has many times as many as others."""
    renderer = modelled(ground(eye=(0, 3, 0.1)), lod="distance", level_bias=2.0, gate=False)
    wins = np.zeros(PIXELS, int)
    for frame in renderer.frames(0, 48):
        arrays = renderer._graph.of("mono")
        shaded = counters(frame)["shaded"]
        assert shaded < PIXELS / 4
        wins[arrays["stream"].get()[:shaded]] += 1
    assert (wins > 0).mean() > 0.95 and wins.max() < 6 * wins.mean()


@pytest.mark.parametrize("capacity", [1, 100, 4096, 2**20])
def test_memory_is_24_bytes_for_each_entry(capacity):
    """And a word for how many are in use."""
    assert voxels(ground(), capacity=capacity).stats()["memory"]["cache"] == 24 * capacity + 4


def test_memory_of_hybrid_has_the_samples_beside():
    per_entry = [voxels(ground(), "hybrid", capacity=c).stats()["memory"]["cache"] for c in (1000, 3000)]
    assert per_entry[1] - per_entry[0] == 24 * 2000


@pytest.mark.parametrize(("method", "stereo"), CASES)
@pytest.mark.parametrize(("capacity", "lifetime"), [(CAPACITY, 64), (300, 1)])
def test_counters_add_up(method, stereo, capacity, lifetime):
    occupied = 0
    renderer = voxels(yard(5), method, stereo=stereo, capacity=capacity, lifetime=lifetime)
    for frame in renderer.frames(0, 5):
        for eye in frame.color:
            c = counters(frame, eye)
            assert c["lookups"] == c["hits"] + c["inserted"] + c["discarded"] > 0
            assert 0 <= c["evicted"] <= c["inserted"] and c["capacity"] == capacity
            in_use = c["occupied" if method == "voxelhash" else "voxels"]
            assert in_use == occupied + c["inserted"] - c["evicted"]
            occupied = in_use
            assert (c["discarded"] > 0) == (capacity == 300)
            assert c["shaded"] >= c["discarded"]
    assert len(held(renderer).check) == occupied
    assert len(np.unique(held(renderer).check)) == occupied


def test_updates_of_a_frame_add_up():
    """Frames of three updates each."""
    (three,), each = frames(yard(moving=False), 1, spp=3), frames(yard(moving=False), 3)
    np.testing.assert_array_equal(three.color["mono"], each[-1].color["mono"])
    for name, count in counters(three).items():
        of_each = [counters(frame)[name] for frame in each]
        assert count == (of_each[-1] if name in LEVELS else sum(of_each)), name


def test_a_frame_of_several_updates_has_one_of_each_voxel_in_each():
    """In stereo, too, where the first eye makes all its updates before the second."""
    renderer = voxels(yard(moving=False), stereo=True, spp=3, inherit=False, gate=False)
    before = {}
    for _ in renderer.frames(0, 3):
        counts = held(renderer).counts
        assert max(count - before.get(check, 0) for check, count in counts.items()) == 3
        before = counts


# What AOVs say


def model_of(renderer, frame, scene, factor=1.0):
    """The voxels of the floor that each pixel sees, and where they are certain; the levels."""
    points = on_floor(scene.camera, renderer.size, sample=frame, seed=renderer.seed).reshape(-1, 3)
    normals = np.tile([0.0, 1.0, 0.0], (len(points), 1))
    spread = 2 * np.tan(scene.camera.fov_y / 2) / renderer.size[1]
    incidence = renderer.settings["voxelhash.lod"] == "incidence"
    levels, certain = levels_of(scene.camera.transform[:, 3], spread, points, normals, factor, incidence)
    found = voxels_of(points, normals, levels, CAPACITY)
    edge = 2.0 ** levels[:, None]  # a cached first hit is rounded
    off = np.abs(points[:, [0, 2]] / edge - np.round(points[:, [0, 2]] / edge)).min(axis=1) > 1e-3
    return found, levels, certain & off


@pytest.mark.parametrize("lod", ["distance", "incidence"])
@pytest.mark.parametrize("bias", [0.0, 1.5, 4.0])
def test_aovs_are_those_of_a_model(lod, bias):
    """Level, and which pixels share a voxel; how often it was asked before, and when last."""
    scene = ground(eye=(0, 1, 3), degrees=30)
    renderer = modelled(scene, lod=lod, level_bias=bias, gate=False, aovs=("voxel", "level", "count", "age"))
    asked: dict[int, list[int]] = {}
    for number, frame in enumerate(renderer.frames(0, 5)):
        found, levels, certain = model_of(renderer, number, scene, 2.0**bias)
        assert certain.mean() > 0.95
        np.testing.assert_array_equal(frame.aov("level", "mono").ravel()[certain], levels[certain])
        colours = colours_of(frame).ravel()
        pairs = set(zip(found.check[certain].tolist(), colours[certain].tolist(), strict=True))
        assert len(pairs) == len({check for check, _ in pairs}) == len({colour for _, colour in pairs})
        last = np.array([asked.get(c, [-np.inf])[-1] for c in colours.tolist()])
        np.testing.assert_array_equal(frame.aov("age", "mono").ravel(), number - last)
        for colour in set(colours.tolist()):
            asked.setdefault(colour, []).append(number)
        counts = [len(asked[c]) for c in colours.tolist()]
        np.testing.assert_array_equal(frame.aov("count", "mono").ravel(), counts)
    assert len({len(a) for a in asked.values()}) > 1 or bias > 1


def test_a_still_view_is_one_frame_old():
    """Of voxels that are larger than pixels, so that each is asked in each frame."""
    *_, first, last = [
        f.aov("age", "mono") for f in frames(ground(), 2, level_bias=6, jitter=False, gate=False, aovs=("age",))
    ]
    assert np.isinf(first).all()
    assert (last == 1).mean() > 0.95 and (last >= 1).all()


def test_where_there_is_no_voxel_aovs_say_so():
    """The background, and a mirror."""
    *_, last = frames(mirror_ball(), 3, aovs=AOVS)
    far, mirror = np.isinf(last.aov("Z", "mono")), is_mirror(last)
    assert far.any() and mirror.any()
    for nothing in (far, mirror):
        assert (last.aov("voxel", "mono")[nothing] == 0).all() and (last.aov("count", "mono")[nothing] == 0).all()
        assert np.isinf(last.aov("level", "mono")[nothing]).all() and np.isinf(last.aov("age", "mono")[nothing]).all()
    rest = ~far & ~mirror
    assert (last.aov("count", "mono")[rest] >= 1).all() and np.isfinite(last.aov("level", "mono")[rest]).all()


# What images show


@pytest.mark.parametrize("method", METHODS)
def test_an_even_floor_converges_without_bias(method):
    """Its radiance is the same everywhere, so that nothing but noise is there to be wrong: by a sky of which the paths find all."""
    scene = ground(0.6, lights=(), environment=(0.7, 0.8, 0.9))
    finals = [frames(scene, 12, method=method, seed=s, bounces=2, size=(16, 12))[-1].color["mono"] for s in range(4)]
    means = np.stack(finals).astype(float)
    np.testing.assert_allclose(means.mean(axis=(0, 1, 2)), 0.6 * np.array([0.7, 0.8, 0.9]), rtol=2e-3)


@pytest.mark.parametrize("method", METHODS)
def test_a_still_view_converges_to_path_tracing_but_for_a_small_bias(method):
    """What is left is interpolation within voxels and pixels, in half-shadow and at edges: below a hundredth of the mean, and below that
    of a few samples a pixel. Without it the images of many frames would be those of path tracing."""
    scene = yard(moving=False)
    truth = np.mean([image(scene, SMALL, 256, seed=100 + s) for s in range(2)], axis=0)
    finals = []
    for seed in range(2):
        found = frames(scene, 64, method=method, seed=seed)
        finals.append(np.mean([f.color["mono"] for f in found[32:]], axis=0))
    ours = np.mean(finals, axis=0)
    assert abs(ours.mean() / truth.mean() - 1) < 0.01
    assert relmse(ours, truth) < 0.5 * relmse(image(scene, SMALL, 4, seed=7), truth)


@pytest.mark.parametrize("method", METHODS)
def test_background(method):
    scene = yard(moving=False)
    *_, last = frames(scene, 3, method=method, aovs=("Z",))
    far = np.isinf(last.aov("Z", "mono"))
    if method == "voxelhash":
        assert far.any()
        np.testing.assert_allclose(last.color["mono"][far], np.tile((0.3, 0.4, 0.5), (far.sum(), 1)), rtol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_nothing_but_sky(method):
    scene = replace(yard(moving=False), camera=view((0, 50, 0), (0, 90, 1)))
    renderer = voxels(scene, method)
    for frame in renderer.frames(0, 3):
        np.testing.assert_allclose(frame.color["mono"], np.tile((0.3, 0.4, 0.5), (24, 32, 1)), rtol=1e-6)
        assert counters(frame)["lookups"] == counters(frame)["shaded"] == 0
    assert len(held(renderer).check) == 0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (5, 3)])
def test_tiny_images(method, size):
    """Even ground is what it is from the first frame on."""
    for stereo in (False, True):
        scene = replace(ground(0.5), defaults=replace(ground().defaults, eye_distance=0.06))
        for frame in frames(scene, 3, method=method, size=size, bounces=0, stereo=stereo, gate=False):
            for eye in frame.color.values():
                np.testing.assert_allclose(eye, 0.5, rtol=1e-5)


# What follows the view


def mirror_ball():
    """A ball like a mirror over a floor that a small lamp lights unevenly."""
    return lit(
        floor(6), ball(0.8, 3, 1, smooth=True), ball(0.15, 1, 2),
        camera=orbit(1)[0],
        materials=[grey(0.6), Material("mirror", (0.9, 0.9, 0.9), metallic=1.0, roughness=0.0), grey(0.0, 30.0)],
        environment=(0.3, 0.4, 0.5), instances=[(0, IDENTITY), (1, at((0, 0.8, 0))), (2, at((1.0, 1.5, 0.6)))],
    )  # fmt: skip


def is_mirror(frame):
    return np.isclose(frame.aov("albedo", "mono")[..., 0], 0.9, atol=0.01)


def glass_ball():
    scene = mirror_ball()
    glass = Material("glass", (1.0, 1.0, 1.0), specular=1.0, transmission=1.0, roughness=0.0)
    return replace(scene, materials=(scene.materials[0], glass, scene.materials[2]))


@pytest.mark.parametrize("scene", [mirror_ball(), glass_ball()], ids=["mirror", "glass"])
def test_a_mirror_shows_what_its_own_paths_find(scene):
    """No voxel is asked there, so that nothing is smeared: each update is a sample of the path tracer, to the last digits but few."""
    found = frames(scene, 3, aovs=("albedo", "level", "Z"), sampler="sobol")
    traced = [n * image(scene, SMALL, n).astype(float) for n in (1, 2, 3)]
    samples = [traced[0], traced[1] - traced[0], traced[2] - traced[1]]
    for frame, sample in zip(found, samples, strict=True):
        bare = np.isinf(frame.aov("level", "mono")) & np.isfinite(frame.aov("Z", "mono"))
        assert bare.sum() > 30
        np.testing.assert_allclose(frame.color["mono"][bare], sample[bare], rtol=1e-3, atol=1e-3)
        rest = ~bare & np.isfinite(frame.aov("Z", "mono"))
        assert relmse(frame.color["mono"][rest][None], sample[rest][None]) > 1e-3 or frame is found[0]


# Scale, place and motion


def scaled(scene, scale, offset=(0, 0, 0)):
    """The scene made larger, then moved."""
    transform = scene.camera.transform.copy()
    transform[:, 3] = transform[:, 3] * scale + offset
    instances = []
    for instance in scene.instances:
        matrix = np.asarray(instance.transform, float) * scale
        matrix[:, 3] += offset
        instances.append(replace(instance, transform=matrix))
    return replace(scene, camera=replace(scene.camera, transform=transform), instances=tuple(instances))


@pytest.mark.parametrize("power", [-10, 10])
def test_a_scene_of_another_scale_has_the_same_voxels(power):
    """Of a power of two: the same, that many levels away."""
    options = {"aovs": ("voxel", "level", "count"), "seed": 3}
    for here, there in zip(
        frames(yard(moving=False), 3, **options),
        frames(scaled(yard(moving=False), 2.0**power), 3, **options),
        strict=True,
    ):
        levels = [f.aov("level", "mono") for f in (here, there)]
        near = np.isfinite(levels[0])
        assert near.any() and (near == np.isfinite(levels[1])).mean() > 0.99
        near &= np.isfinite(levels[1])
        assert (levels[1][near] - levels[0][near] == power).mean() > 0.98
        sharing = [len(np.unique(colours_of(f)[near])) for f in (here, there)]
        assert sharing[0] == pytest.approx(sharing[1], rel=0.02)
        assert here.color["mono"].mean() == pytest.approx(there.color["mono"].mean(), rel=0.03)


@pytest.mark.parametrize(
    ("scale", "offset"), [(1, (1e4, 0, -1e4)), (1e-3, (0, 0, 0)), (1e3, (0, 0, 0)), (1, (1e4, 1e4, 1e4))]
)
def test_a_scene_of_any_scale_and_place_is_as_bright_and_has_about_as_many_voxels(scale, offset):
    usual, other = (frames(s, 8) for s in (yard(moving=False), scaled(yard(moving=False), scale, offset)))
    means = [np.mean([f.color["mono"] for f in found]) for found in (usual, other)]
    assert means[1] == pytest.approx(means[0], rel=0.02)
    occupied = [counters(found[-1])["occupied"] for found in (usual, other)]
    assert 0.4 < occupied[1] / occupied[0] < 2.5
    assert np.isfinite(other[-1].color["mono"]).all()


@pytest.mark.parametrize("method", METHODS)
def test_what_moves_takes_no_light_along_and_leaves_none(method):
    """A ball that flies past: its voxels are new where it comes, and its image is about as bright as path tracing has it."""
    scene = yard(6)
    last = [frames(scene, 6, method=method, seed=s)[-1].color["mono"] for s in range(4)]
    from clcache import Renderer

    truth = next(Renderer(scene, "pathtrace", SMALL, spp=128).frames(5, 6)).color["mono"]
    assert np.isfinite(last).all()
    assert np.mean(last) == pytest.approx(truth.mean(), rel=0.04)


# What is refused


@pytest.mark.parametrize("method", METHODS)
def test_a_device_without_64_bit_atomics_is_refused(method, monkeypatch):
    from clcache import device as module

    probe = module.probe_capabilities
    monkeypatch.setattr(module, "probe_capabilities", lambda d: replace(probe(d), int64_atomics=False))
    monkeypatch.setattr("clcache.renderer.Device", module.Device)
    with pytest.raises(SettingError, match=r"^method: .* lacks 64-bit atomics") as caught:
        voxels(ground(), method)
    assert "\n" not in str(caught.value)
