"""OctreeCache as a whole: who reads what from which cell, what the running estimate is of, how many vertices are inserted and where,
and what becomes of scenes that move, that are dark, that are empty, that have holes, and whose materials are graphs.

Sequences that go on from a file, wipes, and the same bits by any number of threads: test_octree_sequences.py. Light: test_octree_light.py.
"""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import along, at, counters, one_device, orbit, yard
from helpers import IDENTITY, make_mesh
from memo_renders import assert_same, painted
from memo_renders import frames as painted_frames
from memo_renders import yard as painted_yard
from octree_renders import cells, levels, octree
from render_helpers import ball, floor, grey, image, lit, shape_mesh, view
from scipy import stats
from ztest import agree

from clcache import Renderer
from clcache.passes.octree import Pace, caching_size
from clcache.scene.generators import plane
from clcache.scene.model import DirectionalLight, Material, PointLight, Texture, TextureUse, Track

SUN = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
SKY = (0.3, 0.4, 0.5)
ABOVE = view((0, 3, 0.1), (0, 0, 0))
AWAY = view((0, 2.5, 0), (0, 60, 1))
SIGNIFICANCE = 1e-3


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def ground(albedo=0.5, camera=ABOVE, **options):
    """A floor that the sun lights evenly: its radiance is the albedo, without noise if there is direct light only."""
    return lit(floor(20), camera=camera, materials=[grey(albedo)], **{"lights": [SUN], **options})


def uneven(camera=ABOVE, **options):
    """A floor under a sky and part of a roof: a light that is another everywhere, and noisy."""
    roof = np.array([[1.0, 0, 0, 3.2], [0, 1, 0, 2], [0, 0, 1, 0]])
    return lit(
        floor(12), floor(5), camera=camera, materials=[grey(0.5)], environment=SKY,
        instances=[(0, IDENTITY), (1, roof)], **options,
    )  # fmt: skip


def mirrors():
    """A diffuse ball and a mirror on a floor, under sun and sky."""
    still = yard(moving=False)
    mirror = Material("mirror", (0.9, 0.9, 0.9), metallic=1.0, roughness=0.0)
    return replace(still, materials=(*still.materials[:2], mirror))


def frames(scene, count, begin=0, **options):
    return list(octree(scene, **options).frames(begin, begin + count))


def color(frame, eye="mono"):
    return frame.color[eye]


def hues(frame, eye="mono"):
    """(H, W): a number of its own for each cell that answers; -1 where none does."""
    rgb = np.round(frame.aov("voxel", eye).astype(float) * 2**24).astype(np.int64)
    return np.where(np.isfinite(frame.aov("level", eye)), (rgb[..., 0] << 24) + rgb[..., 1], -1)


def answers(frame, eye="mono"):
    """What each cell that answers has said, by its number: each the same for all of its pixels."""
    found = {}
    for hue, value in zip(hues(frame, eye).ravel().tolist(), color(frame, eye).reshape(-1, 3).tolist(), strict=True):
        if hue >= 0:
            assert found.setdefault(hue, value) == value
    return found


# What two views of a point read


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Cells that a few frames have filled from three sides."""
    path = tmp_path_factory.mktemp("filled") / "state.npz"
    cameras = [ABOVE, view((0, 2, -2.2), (0, 0, 0)), view((2.2, 2, 0), (0, 0, 0))]
    of = octree(along(uneven(), cameras), spp=8, bounces=1)
    list(of.frames(0, 3))
    of.save(path)
    return path


def read(path, camera, **options):
    """The first frame of another view that only reads."""
    scene = along(uneven(**options.pop("scene", {})), [camera])
    exactly = {"jitter": 0.0, "samples": 1, "caching_resolution": 0.0, "aovs": ("voxel", "level"), "bounces": 1}
    of = octree(scene, **(exactly | options))
    of.warm_start(path)
    return next(of.frames(0, 1))


def test_views_of_a_point_read_the_same_value(filled):
    """From two sides, as far away: where they ask the same cell, they show the same to the bit."""
    a, b = (answers(read(filled, view(eye, (0, 0, 0)))) for eye in ((0, 2.2, 1.8), (-1.8, 2.2, 0.1)))
    shared = a.keys() & b.keys()
    assert len(shared) > 30 and len({tuple(a[hue]) for hue in shared}) > 20, "and others elsewhere"
    assert all(a[hue] == b[hue] for hue in shared)


@pytest.mark.parametrize("apart", [0.0, 0.3])
def test_eyes_read_the_same_value(filled, apart):
    frame = read(filled, ABOVE, stereo=True, scene={"eye_distance": apart})
    left, right = (answers(frame, eye) for eye in ("left", "right"))
    shared = left.keys() & right.keys()
    assert len(shared) > 30 and all(left[hue] == right[hue] for hue in shared)


# The same images


@pytest.mark.parametrize("scene", [yard(4), mirrors()], ids=["yard", "mirrors"])
def test_aovs_change_no_image(scene):
    """Nor does what is cached depend on them."""
    bare, full = (
        octree(scene, bounces=2),
        octree(scene, bounces=2, aovs=("albedo", "N", "Z", "voxel", "level", "count", "layer0", "filtered0")),
    )
    assert_same(list(full.frames(0, 3)), list(bare.frames(0, 3)))
    np.testing.assert_array_equal(*(of._graph.of()["octree_cells"].get() for of in (bare, full)))


# The running estimate


@pytest.mark.parametrize("options", [{}, {"filter": "bilateral"}, {"stereo": True}], ids=str)
def test_an_image_is_the_mean_of_those_since_the_camera_came_to_rest(options):
    scene = along(uneven(eye_distance=0.2), [ABOVE] * 4 + [view((0.3, 3, 0.1), (0.3, 0, 0))] * 3 + [ABOVE] * 2)
    since = {}
    for frame in octree(scene, aovs=("filtered0",), bounces=1, **options).frames(0, 9):
        for eye, shown in frame.color.items():
            since[eye] = [] if frame.number in (4, 7) else since.get(eye, [])
            since[eye].append(frame.aov("filtered0", eye).astype(float))
            np.testing.assert_allclose(shown, np.mean(since[eye], axis=0), rtol=1e-5)
            assert len(since[eye]) == 1 or not np.allclose(shown, since[eye][-1], rtol=1e-2), "updates differ"


def test_an_image_is_of_one_light():
    """A lamp that jumps: the mean begins anew, and is of what the lamp lights now."""
    turn, one = np.tile([0, 0, 0, 1.0], (3, 1)), np.ones((3, 3))
    jump = Track(np.array([0.0, 3.0, 5.0]), np.array([(0, 3, 0), (0, 6, 0), (0, 6, 0)]), turn, one, step=True)
    lamp = PointLight((0, 0, 0), (36.0,) * 3, (jump,))
    scene = along(lit(floor(20), camera=ABOVE, materials=[grey(0.5)], lights=[lamp]), [ABOVE])
    brightness = []
    for frame in octree(scene, bounces=0, aovs=("filtered0",)).frames(0, 6):
        brightness.append(color(frame)[12, 16, 0])
        if frame.number in (0, 3):
            np.testing.assert_array_equal(color(frame), frame.aov("filtered0", "mono"))
    assert brightness[:3] == pytest.approx([2 / np.pi] * 3, rel=0.05)
    assert brightness[3:] == pytest.approx([0.5 / np.pi] * 3, rel=0.05)


@pytest.mark.parametrize("options", [{}, {"filter": "bilateral"}, {"paths": "surfaces"}], ids=str)
@pytest.mark.parametrize("scene", [yard(moving=False), mirrors()], ids=["yard", "mirrors"])
def test_updates_of_a_frame_are_frames_of_a_camera_at_rest(scene, options):
    three, each = (octree(scene, bounces=2, spp=spp, **options) for spp in (3, 1))
    (one,), others = list(three.frames(0, 1)), list(each.frames(0, 3))
    np.testing.assert_array_equal(color(one), color(others[-1]))
    np.testing.assert_array_equal(*(of._graph.of()["octree_cells"].get() for of in (three, each)))
    for name, count in counters(one).items():
        of_each = [counters(frame)[name] for frame in others]
        assert count == (of_each[-1] if name in ("occupied", "capacity") else sum(of_each)), name


# How much is cached


@pytest.mark.parametrize("size", [(32, 24), (30, 22)])
@pytest.mark.parametrize("part", [1.0, 0.5, 0.25, 0.1, 0.001])
def test_vertices_fall_with_the_square_of_the_caching_resolution(part, size):
    """Every path hits the floor, and none goes on from there to anything. At least one is left."""
    width, height = (max(round(length * part), 1) for length in size)
    for frame in frames(ground(), 2, size=size, caching_resolution=part, bounces=0):
        assert counters(frame)["inserted"] == width * height
        np.testing.assert_allclose(color(frame), 0.5, rtol=1e-5)


@pytest.mark.parametrize("store", [1, 2, 3, 7])
@pytest.mark.parametrize("paths", ["camera", "surfaces"])
def test_so_many_vertices_of_each_path_are_stored(store, paths):
    """Between two floors that are as good as endless, from which no path leaves that roulette lets go on; under the open sky the first."""
    hall = lit(floor(1e4), floor(1e4), camera=view((0, 1, 0), (3, 0, 0), 20), materials=[grey(1.0, 1.0)],
               instances=[(0, at((0, 0, 0))), (1, at((0, 2, 0)))])  # fmt: skip
    options = {"paths": paths, "store": store, "bounces": 1, "settings": {"pathtrace.roulette": 64}}
    inserted = counters(frames(hall, 1, **options)[0])["inserted"]
    if paths == "camera":
        assert 0.99 * 768 * store <= inserted <= 768 * store
    else:  # half of them begin outside
        assert inserted == pytest.approx(
            384 + 384 * store, abs=(store - 1) * 4.5 * np.sqrt(768 / 4) + 0.01 * 384 * store
        )
    assert counters(frames(ground(), 1, **options)[0])["inserted"] == 768


def test_nothing_is_cached_without_caching_paths():
    """Images are those of paths, all of them."""
    of = octree(uneven(), caching_resolution=0.0, bounces=1)
    for frame in of.frames(0, 2):
        found = counters(frame)
        assert found["inserted"] == found["occupied"] == found["hits"] == 0 < found["lookups"] == found["traced"]
    assert not cells(of).counts.any() and "caching.merge" not in frame.stats["eyes"]["mono"]["passes"]


# Paths that begin on surfaces


def finest(renderer):
    """(n, 3) coordinates of the finest cells, and their places: slice."""
    begin, end = levels(renderer)[-1]
    entries = renderer._parts.octree.arrays["octree_table"].get()
    key, cell = entries >> np.uint64(32), entries & np.uint64(0xFFFFFFFF)
    is_finest = (entries != np.uint64(2**64 - 1)) & (cell >= begin) & (cell < end)
    keys = np.zeros(end - begin, np.uint64)
    keys[(cell[is_finest] - np.uint64(begin)).astype(int)] = key[is_finest]
    bits = np.arange(6, dtype=np.uint64)
    axes = [((keys[:, None] >> (3 * bits + np.uint64(axis)) & np.uint64(1)) << bits).sum(axis=1) for axis in range(3)]
    return np.column_stack(axes).astype(int), slice(begin, end)


def unpacked(words):
    """(n, 3): cells' normals, not of unit length (cl/octree/cell.cl)."""
    x, y = ((words >> np.uint32(16 * k) & np.uint32(0xFFFF)) / 32767.0 - 32768 / 32767 for k in (0, 1))
    z = 1 - np.abs(x) - np.abs(y)
    folded = [(1 - np.abs(b)) * np.where(a < 0, -1, 1) for a, b in ((x, y), (y, x))]
    return np.column_stack([np.where(z < 0, folded[0], x), np.where(z < 0, folded[1], y), z])


def by_side(of, outwards):
    """Counts and red light of the finest cells' outer side, and of their inner one: (n, 2) each. outwards: (n, 3)."""
    known, (begin, end) = cells(of), levels(of)[-1]
    part = slice(begin, end)
    is_out = ((unpacked(known.normal[part]) * outwards).sum(axis=1) > 0)[:, None]
    counts, light = known.counts[part], np.column_stack([known.front[part, 0], known.back[part, 0]])
    return np.where(is_out, counts, counts[:, ::-1]), np.where(is_out, light, light[:, ::-1])


def hidden():
    """Three instances of a square of one large triangle and 64 small ones, in planes apart, one twice as large, one stretched; they are
    not in the camera's view. places: heights; stretch: along x, z."""
    corners, faces = [(-1, 0, -1), (1, 0, -1), (-1, 0, 1)], [(0, 1, 2)]
    for i in range(8):  # rows of the triangle (1, -1), (1, 1), (-1, 1)
        for j in range(8 - i):
            for k in range(2 if j < 7 - i else 1):
                o, a, b = np.array([1, 0, 1.0]), np.array([0, 0, -0.25]), np.array([-0.25, 0, 0])
                first = o + i * a + j * b
                faces.append(tuple(len(corners) + c for c in range(3)))
                corners += [first, first + a, first + b] if k == 0 else [first + a + b, first + b, first + a]
    mesh = make_mesh(np.array(corners), np.array(faces))
    stretches = {0.0: (1, 1), 1.0: (2, 2), 2.0: (1.5, 0.5)}
    instances = [(0, np.column_stack([np.diag([x, 1, z]), [0, y, 0]])) for y, (x, z) in stretches.items()]
    return lit(mesh, camera=view((0, 0.5, 9), (0, 0.5, 60)), materials=[grey(0.5)], instances=instances,
               environment=SKY), stretches  # fmt: skip


@pytest.fixture(scope="module")
def sown(compiled_once):
    scene, stretches = hidden()
    of = octree(scene, (64, 48), paths="surfaces", store=1, bounces=0, spp=8)
    (frame,) = of.frames(0, 1)
    assert counters(frame)["lookups"] == 0, "nothing of it is seen"
    return of, counters(frame), stretches


def overlaps(coordinates, origin, edge, half):
    """How much of -half .. half lies in cells of these coordinates along an axis."""
    low = origin + coordinates * edge
    return np.clip(np.minimum(low + edge, half) - np.maximum(low, -half), 0, None)


def test_paths_from_surfaces_begin_alike_all_over_their_area(sown):
    """Chi-square over instances, and over groups of cells of each, of which the areas are known."""
    of, counted, stretches = sown
    places, part = finest(of)
    counts, shape = cells(of).counts[part].sum(axis=1), of._parts.octree.shape
    edge, origin = float(shape["size"]) / 64, np.array(shape["origin"], float)
    observed, expected = [], []
    for height, (x, z) in stretches.items():
        own = places[:, 1] == int((height - origin[1]) / edge)
        areas = overlaps(places[own, 0], origin[0], edge, x) * overlaps(places[own, 2], origin[2], edge, z)
        assert areas.sum() == pytest.approx(4 * x * z, rel=1e-3), "all cells of this one"
        group = places[own, 0] // 9 * 10 + places[own, 2] // 9
        for g in np.unique(group):
            observed.append(counts[own][group == g].sum())
            expected.append(areas[group == g].sum())
    total = sum(observed)
    assert total == counted["inserted"] == 8 * 64 * 48
    expected = np.array(expected) * total / np.sum(expected)
    small = expected < 10
    observed, expected = (np.append(v[~small], v[small].sum()) for v in (np.array(observed), expected))
    observed, expected = observed[expected > 0], expected[expected > 0]
    assert len(observed) > 30
    assert stats.chisquare(observed, expected).pvalue > SIGNIFICANCE


def from_the_middle(of):
    """(n, 3): the places of the finest cells."""
    shape = of._parts.octree.shape
    return np.array(shape["origin"]) + (finest(of)[0] + 0.5) * float(shape["size"]) / 64


def test_paths_from_surfaces_begin_on_either_side_alike():
    """Of a ball: within and without."""
    of = octree(lit(ball(1, 3), camera=AWAY), (64, 48), paths="surfaces", store=1, bounces=0, spp=8)
    list(of.frames(0, 1))
    counts, _ = by_side(of, from_the_middle(of))
    outer, inner = counts.sum(axis=0)
    assert outer + inner == 8 * 64 * 48
    assert stats.binomtest(int(outer), int(outer + inner)).pvalue > SIGNIFICANCE


def test_paths_from_surfaces_bring_the_light_that_is_there():
    """Of a ball that shines by itself: on its inner side what reflection makes of it, on its outer side nothing. That is what a view from
    within shows, which no path that fills cells has begun at."""
    albedo = 0.6
    scene = lit(ball(1, 3), camera=view((0.1, 0.05, 0), (1, 0.2, 0.3), 80), materials=[grey(albedo, 1.0)])
    of = octree(
        scene, (48, 48), paths="surfaces", store=3, length=4, samples=1, gate=False, roulette=64, bounces=4, spp=4
    )
    (frame,) = of.frames(0, 1)
    expected = sum(albedo**k for k in range(5))
    counts, light = by_side(of, from_the_middle(of))
    outer, inner = (counts > 0).T
    assert outer.sum() > 1000 and inner.sum() > 3000
    assert not light[outer, 0].any()
    assert np.average(light[inner, 1], weights=counts[inner, 1]) == pytest.approx(expected, rel=0.005)
    assert color(frame).mean() == pytest.approx(1 + albedo * expected, rel=0.005)
    assert counters(frame)["hits"] > 0.9 * counters(frame)["lookups"]


def test_cells_of_a_closed_surface_tell_its_sides_apart():
    """Of a ball under a white sky: all of the outer side is white, and the inner one black."""
    scene = lit(ball(1, 3), camera=view((0, 0, 3), (0, 0, 0)), environment=(1.0, 1.0, 1.0))
    of = octree(scene, (48, 48), paths="surfaces", store=3, bounces=2, samples=1, spp=4)
    (frame,) = of.frames(0, 1)
    counts, light = by_side(of, from_the_middle(of))
    outer, inner = (counts > 0).T
    assert outer.sum() > 1000 and inner.sum() > 1000
    np.testing.assert_array_equal(light[outer, 0], 1.0)
    assert not light[inner, 1].any()
    np.testing.assert_allclose(color(frame), 1.0, rtol=1e-5)


def test_paths_from_surfaces_begin_at_no_hole():
    """A grid of which half are holes: no cell inside a hole gets anything, and those between get it all."""
    scene = fence()
    of = octree(scene, paths="surfaces", store=1, bounces=0, spp=4)
    (frame,) = of.frames(0, 1)
    inserted = counters(frame)["inserted"]
    assert stats.binomtest(inserted, 4 * 768).pvalue > SIGNIFICANCE
    places, part = finest(of)
    counts, shape = cells(of).counts[part].sum(axis=1), of._parts.octree.shape
    edge = float(shape["size"]) / 64
    x, z = (float(shape["origin"][axis]) + (places[:, axis] + 0.5) * edge for axis in (0, 2))
    to_border = [np.abs((v + 2) - np.round(v + 2)) for v in (x, z)]
    clear = (to_border[0] > 0.6 * edge) & (to_border[1] > 0.6 * edge) & (np.abs(x) < 2) & (np.abs(z) < 2)
    is_hole = (np.floor(x + 2) + np.floor(z + 2)) % 2 == 0
    assert not counts[clear & is_hole].any()
    assert (counts[clear & ~is_hole] > 0).mean() > 0.5


# Time


def cost(part, most=0.05, rest=0.02):
    """Seconds of an update's passes: caching takes time by its number of paths."""
    return {"begin": 0.1 * rest, "reconstruction.trace": 0.9 * rest, "caching.trace": 0.8 * most * part**2,
            "caching.merge": 0.2 * most * part**2}  # fmt: skip


def pace(milliseconds, most=1.0):
    return Pace({"octree.caching_resolution": most, "octree.frame_time": milliseconds})


def run(of, moves, **costs):
    """The seconds that updates take."""
    taken = []
    for is_moving in moves:
        passes = cost(of.part(is_moving), **costs)
        of.observe(passes, is_moving)
        taken.append(sum(passes.values()))
    return np.array(taken)


@pytest.mark.parametrize("milliseconds", [21, 30, 50, 69])
@pytest.mark.parametrize("most", [1.0, 0.7])
def test_pace_holds_the_time_while_the_camera_moves(milliseconds, most):
    """From the second update on, and never with more paths than there are to be."""
    of = pace(milliseconds, most)
    taken = run(of, [True] * 6)
    full = sum(cost(most).values())
    np.testing.assert_allclose(taken[1:], min(milliseconds / 1000, full), rtol=1e-6)
    assert of.part(False) == most >= of.part(True)


def test_pace_comes_back_when_there_is_time_again():
    """Of costs that fall, and rise again."""
    of = pace(30)
    assert run(of, [True] * 4)[-1] == pytest.approx(0.03)
    assert run(of, [True] * 2, most=0.4)[-1] == pytest.approx(0.03)
    assert run(of, [True] * 3, most=0.001)[-1] == pytest.approx(0.021)
    assert of.part(True) == 1.0


def test_pace_is_full_at_rest_and_remembers_how_fast_it_can_be():
    of = pace(30)
    taken = run(of, [True, True, False, False, True])
    np.testing.assert_allclose(taken, [0.07, 0.03, 0.07, 0.07, 0.03], rtol=1e-6)


def test_pace_keeps_a_least_part():
    """Where even the rest takes too long; and goes on from it when that is over."""
    of = pace(10)
    run(of, [True] * 20)
    least = of.part(True)
    assert 0 < least <= 1 / 32 and caching_size((640, 360), least) >= (10, 6) and caching_size((1, 1), least) == (1, 1)
    run(of, [True] * 3, rest=0.005)
    assert sum(cost(of.part(True), rest=0.005).values()) == pytest.approx(0.01)


def test_pace_without_a_time_is_full():
    of = pace(0, 0.5)
    run(of, [True] * 4)
    assert of.part(True) == of.part(False) == 0.5


@pytest.mark.parametrize("broken", [{}, {"begin": 1.0}, {"caching.trace": 0.0}])
def test_pace_learns_nothing_from_updates_without_caching(broken):
    of = pace(30)
    run(of, [True] * 2)
    before = of.part(True)
    of.observe(broken, True)
    assert of.part(True) == before


@pytest.mark.parametrize(("milliseconds", "is_full"), [(1e-3, False), (60000.0, True), (0.0, True)])
def test_fewer_vertices_while_the_camera_moves(milliseconds, is_full):
    """From the second frame that moves on, and all of them when it rests."""
    cameras = [view((0.01 * min(k, 3), 3, 0.1), (0.01 * min(k, 3), 0, 0)) for k in range(6)]
    found = frames(along(ground(), cameras), 6, size=(64, 64), frame_time=milliseconds, bounces=0)
    inserted = [counters(frame)["inserted"] for frame in found]
    assert inserted[0] == inserted[4] == inserted[5] == 64 * 64
    assert inserted[1:4] == ([64 * 64] * 3 if is_full else [1] * 3)
    for frame in found:
        np.testing.assert_allclose(color(frame), 0.5, rtol=1e-5)


# What moves


def moving_frames(method, scene, seeds, spp, **settings):
    """The third frame by each seed, and the first renderer."""
    made, first = [], None
    for seed in seeds:
        if method == "octree":
            of = octree(scene, (24, 24), seed=seed, spp=spp, stereo=False, aovs=("level", "albedo"), **settings)
        else:
            bounces = {"pathtrace.bounces": settings["bounces"]}
            of = Renderer(scene, "pathtrace", (24, 24), stereo=False, seed=seed, spp=spp, settings=bounces)
        made.append(list(of.frames(0, 3))[-1])
        first = first or of
    return made, first


def test_what_moves_is_traced():
    """No cell answers for it, and its image is that of path tracing."""
    scene = yard(4)
    close = view((-0.6, 1.6, 3.2), (-0.35, 0.7, 1), 25)
    scene = replace(along(scene, [close]), instances=scene.instances)
    options = {"bounces": 2, "resolution": 256, "jitter": 0.0, "samples": 1}
    ours, _ = moving_frames("octree", scene, range(8), 24, **options)
    theirs, _ = moving_frames("pathtrace", scene, range(100, 108), 24, **options)
    flying = np.all([np.isclose(f.aov("albedo", "mono"), 0.9, atol=1e-3).all(axis=-1) for f in ours], axis=0)
    assert flying.sum() > 40
    for frame in ours:
        assert np.isinf(frame.aov("level", "mono")[flying]).all()
        assert counters(frame)["hits"] > 0
    masked = [[np.where(flying[..., None], color(f), 0) for f in each] for each in (ours, theirs)]
    for verdict in agree(*masked):
        assert verdict.passed, verdict


def test_where_everything_moves_everything_is_traced():
    """To the image of path tracing."""
    scene = yard(4)
    fly = Track(np.arange(5.0), np.zeros((5, 3)) + [[0.02 * k, 0, 0] for k in range(5)], np.tile([0, 0, 0, 1.0], (5, 1)),
                np.ones((5, 3)))  # fmt: skip
    scene = replace(scene, instances=tuple(replace(i, motion=(*i.motion, fly)) for i in scene.instances))
    ours, of = moving_frames("octree", scene, range(8), 16, bounces=2)
    theirs, _ = moving_frames("pathtrace", scene, range(100, 108), 16, bounces=2)
    for frame in ours:
        found = counters(frame)
        assert found["hits"] == found["inserted"] == found["occupied"] == 0 < found["traced"] == found["lookups"]
        assert np.isinf(frame.aov("level", "mono")).all()
    assert not cells(of).counts.any()
    for verdict in agree([color(f) for f in ours], [color(f) for f in theirs]):
        assert verdict.passed, verdict


@pytest.mark.parametrize("paths", ["camera", "surfaces"])
def test_paths_from_what_moves_bring_light_to_what_does_not(paths):
    """A lid that moves closes a well of which the floor is lit by what it shines: its light is cached on the floor, not on itself."""
    slide = Track(
        np.array([0.0, 100.0]), np.array([(0, 1, 0), (0, 1.01, 0)]), np.tile([0, 0, 0, 1.0], (2, 1)), np.ones((2, 3))
    )
    scene = lit(floor(4), floor(1e4, 1), camera=view((0, 0.5, 1), (0, 0, 0)), materials=[grey(0.5), grey(0.0, 2.0)])
    lid = replace(scene.instances[1], motion=(slide,))
    scene = replace(scene, instances=(scene.instances[0], lid), defaults=replace(scene.defaults, fps=1.0))
    of = octree(scene, paths=paths, bounces=1, spp=4, samples=1)
    *_, frame = of.frames(0, 2)
    known = cells(of)
    begin, end = levels(of)[-1]
    assert (finest(of)[0][:, 1] <= 1).all()
    sides = np.stack([known.front[begin:end, 0], known.back[begin:end, 0]], axis=1)
    used = (known.counts[begin:end] > 0) & (known.stamp[begin:end] == known.stamp[begin:end].max())[:, None]
    lit_side = sides[used & (sides > 0)]
    assert len(lit_side) > 20
    assert np.median(lit_side) == 2.0 == pytest.approx(np.mean(lit_side), rel=0.01)
    assert np.median(color(frame)) == pytest.approx(1.0, rel=1e-5)


# Scenes without


def test_a_scene_without_any_light_is_black():
    for scene in (
        lit(floor(6), ball(1, 2), camera=ABOVE),
        lit(floor(6), camera=ABOVE, lights=[PointLight((0, 1, 0), (0.0,) * 3)]),
    ):
        of = octree(scene, aovs=("layer0", "filtered0"), filter="bilateral")
        for frame in of.frames(0, 2):
            assert not color(frame).any() and not frame.aov("filtered0", "mono").any()
            assert counters(frame)["hits"] > 0
        assert not cells(of).energy(0, cells(of).counts.shape[0]).any()


@pytest.mark.parametrize("paths", ["camera", "surfaces"])
def test_nothing_but_sky(paths):
    of = octree(replace(yard(moving=False), camera=AWAY), paths=paths, stereo=True, aovs=("level", "count", "Z"))
    for frame in of.frames(0, 3):
        for eye in ("left", "right"):
            np.testing.assert_allclose(color(frame, eye), np.tile(SKY, (24, 32, 1)), rtol=1e-6)
            found = counters(frame, eye)
            assert found["lookups"] == found["traced"] == 0 and (found["inserted"] > 0) == (paths == "surfaces")
            assert np.isinf(frame.aov("level", eye)).all() and not frame.aov("count", eye).any()


# Holes, graphs, filters


def fence():
    """A square of 4 x 4 fields, every other one a hole, over a floor far below, under sun and sky."""
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[..., 3] = 255 * (np.indices((4, 4)).sum(axis=0) % 2)
    masked = Material("masked", (0.8, 0.4, 0.2), base_color_texture=TextureUse(0), alpha_cutoff=0.5)
    return lit(
        shape_mesh(plane((4, 4))), camera=view((0.3, 3.2, 0.4), (0, 0, 0), 60), materials=[masked],
        textures=[Texture("holes", pixels)], lights=[SUN], environment=SKY,
    )  # fmt: skip


def test_cut_outs():
    """What is left of a fence is as path tracing shows it."""
    scene = fence()
    options = {"bounces": 1, "jitter": 0.0, "samples": 1, "resolution": 256}
    ours = [color(frames(scene, 1, size=(24, 24), seed=s, spp=24, **options)[0]) for s in range(8)]
    theirs = [image(scene, (24, 24), 24, bounces=1, seed=100 + s) for s in range(8)]
    for verdict in agree(ours, theirs):
        assert verdict.passed, verdict


@pytest.mark.parametrize("name", ["checks"])
def test_graphs_with_and_without_memo(name):
    """The same image, to the bit, where keys say exactly where hits are; its albedo is the graph's."""
    scene = painted_yard(painted(name), exact=True)
    options = {"settings": {"octree.resolution": 64}, "method": "octree", "count": 3}
    off, texel = (painted_frames(scene, memo, **options) for memo in ("off", "texel"))
    assert texel[-1].stats["eyes"]["mono"]["memo"]["hits"] > 0
    assert_same(texel, off)


def test_a_graph_colours_what_cells_say():
    """A light that is even everywhere: the image is the graph's colour, in each pixel."""
    scene = painted_yard(painted("waves", specular=0.0))
    bare = replace(ground(), meshes=scene.meshes[:1], materials=scene.materials)
    for memo in ("off", "texel"):
        settings = {"octree.resolution": 64, "octree.filter": "none", "pathtrace.bounces": 0}
        of = Renderer(bare, "octree", (24, 16), stereo=False, memo=memo, settings=settings, aovs=("albedo",))
        frame = next(of.frames(0, 1))
        assert np.ptp(color(frame)) > 0.1
        np.testing.assert_allclose(color(frame), frame.aov("albedo", "mono"), rtol=1e-5)


@pytest.mark.parametrize("temporal", ["taa", "varianceblend"])
@pytest.mark.parametrize("blend", ["none", "constant", "varianceblend"])
def test_filters_over_it_leave_even_ground_as_it_is(temporal, blend):
    """While the camera walks and while it rests."""
    cameras = [view((0.1 * min(k, 3), 3, 0.1), (0.1 * min(k, 3), 0, 0)) for k in range(6)]
    scene = along(ground(eye_distance=0.06), cameras)
    of = octree(scene, temporal=temporal, stereo=True, stereo_blend=blend, bounces=0, filter="bilateral")
    for frame in of.frames(0, 6):
        for eye in ("left", "right"):
            np.testing.assert_allclose(color(frame, eye), 0.5, rtol=1e-4)


def test_a_temporal_filter_takes_noise_off_what_moves():
    """Of a camera that walks, for which there is no running estimate."""
    noise = {}
    for temporal in ("none", "taa"):
        finals = [
            color(
                frames(
                    along(uneven(), orbit(6, 0.01)), 6, temporal=temporal, seed=s, bounces=0, caching_resolution=0.0
                )[-1]
            )
            for s in range(6)
        ]
        noise[temporal] = np.std(finals, axis=0).mean()
    assert 0 < noise["taa"] < 0.7 * noise["none"]
