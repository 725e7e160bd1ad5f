"""What has gone wrong in published caches of cells, asked of the octree.

Its tables are built once, and right or empty: what is about keys, holes, duplicates, probing and failed inserts is in test_cuckoo.py;
overflow and saturation in test_octree_update.py; settings that a saved cache must share in test_octree_sequences.py.
"""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import along, at, counters, one_device, yard
from helpers import IDENTITY
from octree_renders import cells, octree
from render_helpers import MODELLED, ball, floor, grey, lit, on_floor, view

from clcache.random import random4, stream_key
from clcache.scene.model import DirectionalLight, PointLight, Track

SUN = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
ABOVE = view((0, 3, 0.1), (0, 0, 0))
AWAY = view((-6, 2.5, 0), (-6, 60, 1))
SIZE = (32, 24)
NEVER = 65535  # samples that no cell has


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def ground(albedo=0.5, camera=ABOVE, **options):
    """A floor that the sun lights evenly: its radiance is the albedo, without noise if there is direct light only."""
    return lit(floor(20), camera=camera, materials=[grey(albedo)], **{"lights": [SUN], **options})


def noisy(camera=ABOVE):
    """A floor under a sky and part of a roof."""
    roof = np.array([[1.0, 0, 0, 3.2], [0, 1, 0, 4], [0, 0, 1, 0]])
    return lit(floor(20), floor(5), camera=camera, materials=[grey(0.6)], environment=(1.0, 1.0, 1.0),
               instances=[(0, IDENTITY), (1, roof)])  # fmt: skip


def color(frame):
    return frame.color["mono"].astype(float)


def spread(images):
    """The mean standard deviation of a pixel."""
    return np.std(images, axis=0, ddof=1).mean()


def paint(renderer, light):
    """Make every cell that is in use say this on both of its sides."""
    array = renderer._graph.of()["octree_cells"]
    words = array.get()
    red, green, blue = np.array(light, np.float16).view(np.uint16).astype(np.uint32)
    used = words[:, 5] > 0
    words[used, :3] = red | green << 16, blue | red << 16, green | blue << 16
    words[used, 4] = 50 | 50 << 16
    array.set(words)
    assert used.sum() > 20


# The level chosen before the jitter


def frame_of(normal):
    """Two unit vectors across it (cl/common/math.cl)."""
    x, y, z = normal
    sign = 1.0 if z >= 0 else -1.0
    a, b = -1 / (sign + z), -x * y / (sign + z)
    return np.array([1 + sign * x * x * a, sign * b, -sign * x]), np.array([b, sign + y * y * a, -y])


def levels_of(renderer, distance):
    """The level whose cells are closest to a pixel's footprint at these distances, and where that is certain."""
    bias = renderer.settings["octree.level_bias"]
    slope = 2 * np.tan(renderer.scene.camera.fov_y / 2) / renderer.size[1]
    fine = np.log2(float(renderer._parts.octree.shape["size"]) / (slope * distance)) + bias + 0.5
    return np.clip(np.floor(fine), 0, renderer._parts.octree.finest), np.abs(fine - np.round(fine)) > 1e-4


def test_the_level_is_that_of_where_jitter_has_led():
    """Of even ground, seen aslant, from pixel to pixel; for some of them it is not that of the vertex itself."""
    scene = ground(camera=view((0, 1.0, 3), (0, 0, 0), 40))
    of = octree(scene, (48, 36), jitter=2.0, samples=1, gate=False, bounces=0, sampler=MODELLED, resolution=128,
                level_bias=-3.0, aovs=("level", "Z"))  # fmt: skip
    list(of.frames(0, 24))
    (frame,) = of.frames(24, 25)
    points = on_floor(scene.camera, of.size, sample=24).reshape(-1, 3)
    eye, n = scene.camera.transform[:, 3], len(points)
    own, is_certain = levels_of(of, np.linalg.norm(points - eye, axis=1))
    aside = random4(np.arange(n, dtype=np.uint32), 24, 512, stream_key(0, 0)).astype(float)
    reach = 2.0 * float(of._parts.octree.shape["size"]) * 2.0**-own
    along_, across = frame_of((0.0, 1.0, 0.0))
    asked = points + reach[:, None] * ((2 * aside[:, :1] - 1) * along_ + (2 * aside[:, 1:2] - 1) * across)
    jittered, certain = levels_of(of, np.linalg.norm(asked - eye, axis=1))
    level = frame.aov("level", "mono").ravel()
    there = certain & is_certain & np.isfinite(level)
    assert there.sum() > 0.8 * n
    assert (level <= jittered)[there].all(), "coarser ones answer where nothing is known yet"
    assert (level == jittered)[there].mean() > 0.8 and (own > jittered)[there].mean() > 0.05


# Cells that keep each other alive


def lamp_that_jumps(count, at_frame):
    """A floor under a lamp that is now here, now there, from a frame on in each."""
    places = [(0, 6, 0) if k >= at_frame and (k - at_frame) % 2 == 0 else (0, 3, 0) for k in range(count)]
    turn, one = np.tile([0, 0, 0, 1.0], (count, 1)), np.ones((count, 3))
    jump = Track(np.arange(float(count)), np.array(places, float), turn, one, step=True)
    lamp = PointLight((0, 0, 0), (36.0,) * 3, (jump,))
    return lit(floor(20), camera=ABOVE, materials=[grey(0.5)], lights=[lamp])


@pytest.mark.parametrize("away", [0, 1, 3])
def test_what_was_wiped_is_seen_no_more(away):
    """All cells are made red before the lamp moves: whoever looks, in whatever frame, at whatever level, sees none of it, whether the
    camera stayed, or was away when it happened and other cells were filled."""
    scene = along(lamp_that_jumps(3 + away + 2, 3), [ABOVE] * 3 + [AWAY] * away + [ABOVE] * 2)
    of = octree(scene, bounces=0, samples=NEVER)
    list(of.frames(0, 3))
    paint(of, (1000.0, 0.0, 0.0))
    for frame in of.frames(3, 3 + away + 2):
        shown = color(frame)
        np.testing.assert_allclose(shown[..., 0], shown[..., 1], rtol=2e-3)  # halves' rounding
        assert frame.number < 3 + away or 0.05 < shown.min() < shown.max() < 10


def test_painted_cells_are_seen_where_nothing_moves():
    """That the tests of red cells can fail."""
    of = octree(along(ground(), [ABOVE] * 3 + [AWAY] * 3 + [ABOVE]), bounces=0)
    list(of.frames(0, 3))
    paint(of, (1000.0, 0.0, 0.0))
    *_, back = of.frames(3, 7)
    assert color(back)[..., 0].min() > 100


# Settings that change under a cache


def test_renderers_on_a_device_share_no_cells():
    """Taking turns, each shows what it shows alone."""
    options = [{}, {"level_bias": -2.0}, {"store": 1}]
    scene = yard(3)
    alone = [[color(f) for f in octree(scene, bounces=2, **o).frames(0, 3)] for o in options]
    assert not np.array_equal(alone[0][0], alone[1][0])
    together = [octree(scene, bounces=2, **o) for o in options]
    for number in range(3):
        for renderer, expected in zip(together, alone, strict=True):
            np.testing.assert_array_equal(color(next(renderer.frames(number, number + 1))), expected[number])


@pytest.mark.parametrize("reading", [{"samples": 1}, {"level_bias": -2.0}, {"jitter": 2.0}], ids=str)
def test_settings_of_reading_leave_cells_as_they_are(reading):
    usual, other = (octree(yard(moving=False), bounces=2, **options) for options in ({}, reading))
    first, second = (list(of.frames(0, 3))[-1] for of in (usual, other))
    np.testing.assert_array_equal(*(of._graph.of()["octree_cells"].get() for of in (usual, other)))
    assert not np.array_equal(color(first), color(second)), "or it does nothing"


# A new cell that answers black


@pytest.mark.parametrize("reading", [{}, {"samples": NEVER}, {"caching_resolution": 0.0}, {"caching_resolution": 0.05},
                                     {"level_bias": 4.0}, {"jitter": 2.0}, {"gate": False}, {"paths": "surfaces"},
                                     {"resolution": 2048}], ids=str)  # fmt: skip
def test_the_first_frames_are_as_bright_as_all(reading):
    """Right after a cut, too: where the light is the same everywhere, so is the image, to the pixel."""
    cameras = [ABOVE] * 2 + [view((3, 1, 3), (4, 0, 4.1))] * 2 + [view((0, 8, 0.1), (0, 0, 0))]
    renderer = octree(along(ground(), cameras), bounces=0, **reading)
    for frame in renderer.frames(0, 5):
        np.testing.assert_allclose(color(frame), 0.5, rtol=1e-5)


def test_no_pixel_is_darker_than_its_light():
    """Where paths bring noise: no pixel of a white floor in a white sky is black, or lacks what the sky alone brings, in any frame."""
    scene = lit(floor(200), ball(0.5, 2), camera=ABOVE, materials=[grey(0.5)], environment=(1.0, 1.0, 1.0),
                instances=[(0, IDENTITY), (0, at((0, -1, 0)))])  # fmt: skip
    for seed in range(4):
        for frame in octree(scene, bounces=2, seed=seed, caching_resolution=0.1).frames(0, 2):
            np.testing.assert_allclose(color(frame), 0.5, rtol=1e-3)


# Leaks at thin and near geometry


def between_floors(gate, reading):
    """Within a gap that is thinner than any cell, over a floor that the upper one, lit from above, keeps dark: the mean of what is seen,
    of cells that paths from everywhere have filled, and how often cells answered."""
    gap = 0.05
    camera = view((0, 0.8 * gap, 0), (0.3 * gap, 0, 0.01 * gap), 30)
    scene = lit(floor(20), floor(20), camera=camera, materials=[grey(0.5)], lights=[SUN],
                instances=[(0, IDENTITY), (1, at((0, gap, 0)))])  # fmt: skip
    of = octree(scene, paths="surfaces", bounces=0, gate=gate, jitter=0.0, spp=8, **reading)
    (frame,) = of.frames(0, 1)
    assert float(of._parts.octree.shape["size"]) / 64 > 3 * gap
    return color(frame).mean(), counters(frame)["hits"] / counters(frame)["lookups"]


@pytest.mark.parametrize("reading", [{}, {"samples": 1}, {"samples": NEVER}, {"level_bias": -4.0}], ids=str)
def test_light_does_not_leak_through_what_is_thinner_than_a_cell(reading):
    """Before an eye that is nearer than a cell is wide: with the gate it is dark, to the bit; without, the cell says what is above as well."""
    assert between_floors(True, reading) == (0.0, 0.0)
    leak, hits = between_floors(False, reading)
    assert leak > 0.02 and hits > 0.5


@pytest.mark.parametrize("samples", [1, 8, NEVER])
def test_no_cell_answers_that_is_wider_than_the_ray_is_long(samples):
    """Its diagonal, to be exact. Without the gate, cells do that for most of this ground."""
    scene = ground(camera=view((0, 1, 3), (0, 0, 0), 60))
    for gate in (True, False):
        of = octree(scene, bounces=0, gate=gate, jitter=0.0, samples=samples, level_bias=-4.0, sampler=MODELLED, resolution=128,
                    aovs=("level",))  # fmt: skip
        for frame in of.frames(0, 3):
            points = on_floor(scene.camera, of.size, sample=frame.number)
            length = np.linalg.norm(points - scene.camera.transform[:, 3], axis=-1)
            level = frame.aov("level", "mono")
            answered = np.isfinite(level)
            diagonal = np.sqrt(3) * float(of._parts.octree.shape["size"]) * 2.0 ** -np.where(answered, level, 99)
            assert answered.mean() > 0.6  # the floor ends below the horizon
            if gate:
                assert (diagonal <= length * (1 + 1e-5))[answered].all()
            else:
                assert (diagonal > length)[answered].mean() > 0.4


@pytest.mark.parametrize("gate", [True, False])
def test_the_sides_of_a_thin_wall_share_no_light(gate):
    """A wall without thickness, lit from one side, seen from there and then from the other, which stays black; and back."""
    front, back = view((0, 3, 0.1), (0, 0, 0)), view((0, -3, 0.1), (0, 0, 0))
    of = octree(along(ground(), [front] * 3 + [back] * 3 + [front]), bounces=0, gate=gate, level_bias=-2.0)
    for frame in of.frames(0, 7):
        if frame.number in (3, 4, 5):
            assert not color(frame).any() and counters(frame)["hits"] > 0
        else:
            np.testing.assert_allclose(color(frame), 0.5, rtol=1e-5)
    known = cells(of)
    both = (known.counts > 0).all(axis=1)
    assert both.sum() > 20
    sides = np.sort(np.stack([known.front[both, 0], known.back[both, 0]], axis=1), axis=1)
    np.testing.assert_array_equal(sides, np.tile([0.0, 1.0], (both.sum(), 1)))


# History across levels


def nearer(seed, is_fresh):
    """The first image from half as far away as before, or of a cache that knows nothing yet; and the median level before and after."""
    far, near = view((0, 3.0, 0.1), (0, 0, 0)), view((0, 1.5, 0.05), (0, 0, 0))
    of = octree(along(noisy(), [far] * 24 + [near]), seed=seed, bounces=0, resolution=256, aovs=("level",), samples=1)
    before = None if is_fresh else list(of.frames(0, 24))[-1]
    (after,) = of.frames(24, 25)
    return before, after


def test_a_change_of_level_keeps_what_was_known():
    """Right after it the noise is a fraction of what it is without, and the brightness as before."""
    known, fresh = ([nearer(seed, is_fresh) for seed in range(6)] for is_fresh in (False, True))
    before, after = ([np.median(pair[k].aov("level", "mono")) for pair in known] for k in (0, 1))
    assert after[0] in (before[0], before[0] + 1), "coarser ones answer where the finer do not know yet"
    noise = [spread([color(after) for _, after in pairs]) for pairs in (known, fresh)]
    assert noise[0] < 0.6 * noise[1]
    means = [np.mean([color(after)[8:16, 12:20] for _, after in pairs]) for pairs in (known, fresh)]
    assert means[0] == pytest.approx(means[1], rel=0.05)


def test_a_change_of_level_finds_finer_cells_and_coarser_ones():
    """Frozen after a walk, the cells answer from half and from twice as far away in all pixels that it saw."""
    views = [view((0, h, h / 30), (0, 0, 0)) for h in (3.0, 1.5, 6.0)]
    of = octree(
        along(noisy(), [views[0]] * 30 + views[1:]), bounces=0, aovs=("level",), samples=1, spp=2, resolution=512
    )
    *_, usual = of.frames(0, 30)
    (near, far) = of.frames(30, 32)
    medians = [np.median(f.aov("level", "mono")) for f in (far, usual, near)]
    assert medians == sorted(medians) and medians[0] < medians[2]
    assert counters(near)["hits"] > 0.99 * counters(near)["lookups"]


# Looking away and back


@pytest.mark.parametrize("away", [1, 10])
def test_what_was_known_is_there_after_a_look_away(away):
    """Cells are as they were, and so is every answer of whoever only reads; the mean of images begins anew."""
    of = octree(along(noisy(), [ABOVE] * 8 + [AWAY] * away + [ABOVE] * 2), bounces=0, aovs=("filtered0", "count"))
    *_, last = of.frames(0, 8)
    known = of._graph.of()["octree_cells"].get()
    for frame in of.frames(8, 8 + away):
        assert counters(frame)["lookups"] == counters(frame)["inserted"] == 0
        np.testing.assert_allclose(color(frame), 1.0, rtol=1e-6)
    np.testing.assert_array_equal(of._graph.of()["octree_cells"].get(), known)
    (back,) = of.frames(8 + away, 9 + away)
    np.testing.assert_array_equal(color(back), back.aov("filtered0", "mono"))
    assert counters(back)["hits"] >= counters(last)["hits"] * 0.98
    assert back.aov("count", "mono").mean() > 8
    assert color(back).mean() == pytest.approx(color(last).mean(), rel=0.05)


# Flicker where samples are few


@pytest.mark.parametrize("samples", [1, 8, 100, NEVER])
def test_coarser_cells_answer_until_finer_ones_have_samples(samples):
    """The finest that has enough of those from the level that fits to three above it; where none has, the coarsest."""
    scene = ground(camera=view((0, 2.0, 2), (0, 0, 0), 40))
    of = octree(scene, SIZE, jitter=0.0, samples=samples, gate=False, bounces=0, sampler=MODELLED, resolution=256,
                aovs=("level", "count"))  # fmt: skip
    is_coarser = 0
    for frame in of.frames(0, 5):
        points = on_floor(scene.camera, of.size, sample=frame.number).reshape(-1, 3)
        fits, certain = levels_of(of, np.linalg.norm(points - scene.camera.transform[:, 3], axis=1))
        level, count = (frame.aov(name, "mono").ravel() for name in ("level", "count"))
        up = (fits - level)[certain]
        assert (up >= 0).all() and (up <= 3).all() and certain.mean() > 0.9
        enough = (count >= samples)[certain]
        assert (up[~enough] == 3).all()
        is_coarser += (up[enough] > 0).sum()
        if samples == 1 and frame.number:
            assert (up == 0).mean() > 0.5
        if samples == NEVER:
            assert (up == 3).all()
    assert samples in (1, NEVER) or is_coarser > 50


def test_few_samples_flicker_less_by_coarser_cells():
    """The noise of a first frame falls with the samples that are asked for, and its brightness stays."""
    noise, means = [], []
    for samples in (1, 8, 64):
        options = {"bounces": 0, "samples": samples, "resolution": 512, "jitter": 0.0}
        images = [color(next(octree(noisy(), seed=s, **options).frames(0, 1))) for s in range(8)]
        noise.append(spread(images))
        means.append(np.mean(images))
    assert noise[1] < 0.6 * noise[0] and noise[2] < 0.8 * noise[1]
    assert means == pytest.approx([means[0]] * 3, rel=0.03)


def test_known_light_does_not_flicker():
    """After many updates, from frame to frame of a camera that walks by less than a pixel, a cell's answer moves by less than its noise
    is at first."""
    cameras = [view((1e-4 * k, 3, 0.1), (1e-4 * k, 0, 0)) for k in range(40)]
    of = octree(along(noisy(), cameras), bounces=0, jitter=0.0)
    images = [color(f) for f in of.frames(0, 40)]
    early, late = (np.abs(images[k + 1] - images[k]).mean() for k in (0, 38))
    assert late < 0.35 * early


def test_no_sample_stands_out_in_a_pixel_alone():
    """Of a lamp so near that single samples are thousands of times as bright as the mean: no pixel of the image is, by the filter and
    cells of many samples."""
    scene = replace(
        noisy(), environment=lit(floor(), camera=ABOVE).environment, lights=(PointLight((0, 1.5, 0), (5.0,) * 3),)
    )
    worst = {}
    for samples in (1, 64):
        frame = next(octree(scene, bounces=2, samples=samples, store=1).frames(0, 1))
        worst[samples] = color(frame).max()
    assert np.isfinite(list(worst.values())).all() and worst[64] <= worst[1] * 1.01
