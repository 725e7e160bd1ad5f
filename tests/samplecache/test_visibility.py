"""What a cache's samples see, over whole frames: densities that settle, pixels that are never empty, and nothing of what is hidden."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import IDENTITY, moved
from render_helpers import ball, floor, grey, lit, shape_mesh, view

from clcache import Renderer
from clcache.passes.reproject import VARIANTS
from clcache.passes.retrace import TRACINGS
from clcache.scene.generators import box, plane
from clcache.scene.model import Track

SIZE = (48, 36)
FPS = 10.0
AOVS = ("occupancy", "visible", "trace")
WALL, BOX = 1.0, 3.0  # what they emit
ALL = {
    "shading": "uniform",
    "shading_rate": 1.0,
}  # a sample of each pixel is shaded, so none takes its colour from others


def caching(scene, device, size=SIZE, aovs=AOVS, method="samplecache", bounces=0, **options):
    """A renderer; options: settings by their last names."""
    settings = {f"samplecache.{name}": value for name, value in options.items()} | {"pathtrace.bounces": bounces}
    return Renderer(scene, method, size, settings=settings, aovs=aovs, device=device)


def samples_of(frame):
    """(H, W) each: samples in the pixels' slots, those visible."""
    return frame.aov("occupancy", "mono"), frame.aov("visible", "mono")


def counters_of(frame):
    return frame.stats["eyes"]["mono"]["cache"]


def density_of(occupancy):
    """(H, W): the mean of 3 x 3 pixels; those beyond the edge are those at the edge."""
    image = np.pad(occupancy.astype(np.float64), 1, mode="edge")
    rows, columns = occupancy.shape
    return sum(image[j : j + rows, i : i + columns] for j in range(3) for i in range(3)) / 9


def at(scale):
    """A ball and a box on a floor before the background, at any scale."""
    meshes = [moved(floor(8), scale), moved(ball(1, 2), scale, (0, scale, 0)), moved(shape_mesh(box((1, 1, 1))), scale)]
    camera = view(np.array([0.5, 1.5, 5]) * scale, np.array([0, 0.7, 0]) * scale, 50)
    turned = np.column_stack([np.eye(3)[:, [2, 1, 0]] * [1, 1, -1], np.array([1.5, 0.5, 1]) * scale])
    return lit(
        *meshes, camera=camera, environment=(0.5, 0.5, 0.5), instances=[(0, IDENTITY), (1, IDENTITY), (2, turned)]
    )


def moving(scene, path, turn=(0.0, 0.0, 0.0, 1.0), until=1.0):
    """The scene with a camera that moves along a path over a second, or so many."""
    transform = scene.camera.transform
    track = Track(
        np.array([0.0, until]), np.array([[0, 0, 0], path], float), np.array([[0, 0, 0, 1.0], turn]), np.ones((2, 3))
    )
    camera = replace(scene.camera, motion=(transform, track))
    return replace(scene, camera=camera, defaults=replace(scene.defaults, fps=FPS))


@pytest.mark.parametrize(
    ("slots", "target", "tolerance"),
    [(12, 4, 1), (12, 1, 1), (1, 1, 0), (12, 6, 0.5), (4, 3, 2), (20, 8, 2)],
)
def test_density_settles_within_as_many_frames_as_the_target(device_spec, slots, target, tolerance):
    """Each frame adds at most one sample to a pixel. Then, seen from where it was, the cache stays as it is."""
    renderer = caching(at(1.0), device_spec, slots=slots, target=target, tolerance=tolerance)
    frames = renderer.frames(0, target + 4)
    for number, frame in enumerate(frames):
        occupancy, _ = samples_of(frame)
        density = density_of(occupancy)
        assert occupancy.max() <= slots
        assert density.max() <= target + tolerance
        if number + 1 >= target:
            assert density.min() >= target - tolerance
        if number > target:
            counters = counters_of(frame)
            assert counters["purged"] == 0
            assert counters["created"] <= 0.001 * occupancy.size  # rounding takes a few samples to the next pixel


def test_mean_density_of_a_narrow_band_is_the_target(device_spec):
    """No number of samples is within the band: pixels have two or three, on average what is asked for."""
    renderer = caching(at(1.0), device_spec, target=2.4, tolerance=0.1)
    frames = list(renderer.frames(0, 10))
    assert [abs(samples_of(frame)[0].mean() - 2.4) < 0.15 for frame in frames[4:]] == [True] * 6


def test_too_many_samples_are_purged(device_spec):
    """Where everything shrinks as the camera moves away, four pixels' samples come to one. What stays too dense is where a pixel with
    one sample has crowded neighbours, which are not too dense themselves."""
    scene = moving(at(1.0), (0.0, 1.5, 6.0), until=0.5)
    renderer = caching(scene, device_spec, target=4, tolerance=1, tracing="multi")
    frames = list(renderer.frames(0, 24))
    assert max(counters_of(frame)["purged"] for frame in frames) > 100
    assert counters_of(frames[-1])["purged"] == 0
    occupancy, _ = samples_of(frames[-1])
    density = density_of(occupancy)
    assert (occupancy[density > 5] == 1).all()
    assert (density > 5).mean() < 0.01
    assert density.min() >= 3


@pytest.mark.parametrize(
    ("tracing", "reprojection", "path"),
    [
        ("single", VARIANTS[2], (-6.0, 0.0, 0.0)),
        ("multi", VARIANTS[2], (1.0, 0.3, -2.0)),
        ("adaptive", VARIANTS[2], (0.0, 2.0, 8.0)),
        ("adaptive", VARIANTS[1], (1.0, 0.3, -2.0)),
        ("adaptive", VARIANTS[0], (-6.0, 0.0, 0.0)),
    ],
)
def test_no_pixel_is_ever_empty(device_spec, tracing, reprojection, path):
    """Nor without a visible sample: the camera moves and turns, by many pixels in each frame."""
    scene = moving(at(1.0), path, (0.0, np.sin(0.2), 0.0, np.cos(0.2)), until=0.6)
    renderer = caching(scene, device_spec, tracing=tracing, reprojection=reprojection)
    for frame in renderer.frames(0, 8):
        occupancy, visible = samples_of(frame)
        assert visible.min() >= 1
        assert (visible <= occupancy).all()
        counters = counters_of(frame)
        assert counters["occupied"] == occupancy.sum()
        assert counters["visible"] == visible.sum()


def grazing():
    """A floor seen from a hundredth of a metre above it."""
    return lit(floor(30), ball(1, 2), camera=view((0.3, 0.01, 10), (0, 0.008, 0), 30), environment=(0.5, 0.5, 0.5))


@pytest.mark.parametrize("tracing", TRACINGS[1:])
@pytest.mark.parametrize("scene", [at(1.0), at(1e-6), at(1e6), grazing()], ids=["metres", "tiny", "huge", "grazing"])
def test_samples_of_a_still_scene_stay_visible(device_spec, scene, tracing):
    """Not one fails when it is traced again; so none is purged, and those that are created have no sample in their place."""
    frames = list(caching(scene, device_spec, tracing=tracing).frames(0, 12))
    for frame in frames:
        occupancy, visible = samples_of(frame)
        np.testing.assert_array_equal(visible, occupancy)
        assert counters_of(frame)["purged"] == 0
        assert counters_of(frame)["retraced"] > 0 or frame.number == 0
    if tracing == "multi":
        assert all((frame.aov("trace", "mono") == 1).all() for frame in frames)


def wall_and_box(track, size=(2.0, 2.0, 0.5)):
    """A wall that fills the view, at distance 8, and a box, at distance 5, that moves before it; both shine."""
    wall = shape_mesh(plane((40.0, 40.0)))
    upright = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, -8]])
    materials = [grey(0.0, WALL), grey(0.0, BOX)]
    scene = lit(
        wall, shape_mesh(box(size), 1), camera=view((0, 0, 0), (0, 0, -1), 50), materials=materials,
        instances=[(0, upright), (1, IDENTITY)],
    )  # fmt: skip
    instances = scene.instances[0], replace(scene.instances[1], motion=(track,))
    return replace(scene, instances=instances, defaults=replace(scene.defaults, fps=FPS))


def way(*places, step=False):
    """From place to place, one for each frame."""
    count = len(places)
    rotation = np.tile([0, 0, 0, 1.0], (count, 1))
    return Track(np.arange(count) / FPS, np.array(places, float), rotation, np.ones((count, 3)), step)


def whole(scene, device, frames, size=SIZE):
    """frame -> (H, W): what pixels show that see either the wall alone or the box alone, NaN for the others."""
    renderer = caching(scene, device, size, (), "pathtrace")
    renderer.spp = 16
    found = {}
    for frame in renderer.frames(*frames):
        image = frame.color["mono"][..., 0]
        found[frame.number] = np.where((image == WALL) | (image == BOX), image, np.nan)
        around = np.pad(found[frame.number], 1, mode="edge")  # 16 rays may have missed a corner of the other
        rows, columns = image.shape
        near = [around[j : j + rows, i : i + columns] for j in range(3) for i in range(3)]
        found[frame.number][np.ptp(near, axis=0) != 0] = np.nan
    return found


def ghosts(frame, expected):
    """(H, W) bool: where a frame shows what is not there."""
    known = np.isfinite(expected)
    assert known.mean() > 0.5
    return known & (np.abs(frame.color["mono"][..., 0] - expected) > 1e-5)


ACROSS = way(*[(-2.0 + 0.35 * k, 0.2, -5.0) for k in range(10)])
JUMP = way(*[(-1.5, 0.0, -5.0)] * 5, *[(0.5, 0.3, -5.0)] * 9, step=True)


@pytest.mark.parametrize("track", [ACROSS, JUMP], ids=["across", "jump"])
def test_no_ghosts_where_all_samples_are_traced(device_spec, track):
    """A box goes, or jumps, before the wall: each frame is that of the path tracer. What it hides is invisible, and is seen again
    behind it."""
    scene, frames = wall_and_box(track), (0, 10)
    expected = whole(scene, device_spec, frames)
    hidden = 0
    for frame in caching(scene, device_spec, tracing="multi", **ALL).frames(*frames):
        assert not ghosts(frame, expected[frame.number]).any()
        occupancy, visible = samples_of(frame)
        hidden += int((occupancy - visible).sum())
    assert hidden > 100


def test_last_sample_that_is_hidden_is_replaced(device_spec):
    """The box comes from behind the camera, where none of its samples are: all of the wall's in its pixels fail at once."""
    scene, frames = wall_and_box(way(*[(0, 0, 20.0)] * 4, *[(0.2, 0.1, -5.0)] * 6, step=True)), (0, 6)
    expected = whole(scene, device_spec, frames)
    for frame in caching(scene, device_spec, tracing="multi", **ALL).frames(*frames):
        counters, here = counters_of(frame), expected[frame.number]
        occupancy, visible = samples_of(frame)
        assert not ghosts(frame, here).any()
        assert visible.min() >= 1
        if frame.number == 4:
            behind = here == BOX
            assert behind.sum() > 100
            assert (visible[behind] == 1).all()  # what took the place of the first that failed
            assert (occupancy[behind] >= 3).all()
            assert counters["purged"] == counters["created"] == 0  # nor does it count as a change of density
            assert counters["retraced"] == occupancy.sum()


@pytest.mark.parametrize("track", [ACROSS, JUMP], ids=["across", "jump"])
def test_ghosts_of_adaptive_tracing_last_three_frames_at_most(device_spec, track):
    """No pixel shows what is not there in more than three frames in a row."""
    scene, frames = wall_and_box(track), (0, 10)
    expected = whole(scene, device_spec, frames)
    lasting, counts = np.zeros(SIZE[::-1], int), []
    for frame in caching(scene, device_spec, tracing="adaptive", **ALL).frames(*frames):
        wrong = ghosts(frame, expected[frame.number])
        lasting = np.where(wrong, lasting + 1, 0)
        counts.append(int(wrong.sum()))
        assert lasting.max() <= 3, counts


@pytest.mark.parametrize("start", [4, 7, 9, 12])
def test_what_comes_before_a_flat_surface_shows_in_its_third_frame(device_spec, start):
    """Of a box that comes from behind the camera nothing is known. In its first frame one sample of one pixel of each block, four
    apart, finds it; these make edges of the pixels around them, and those of the next, until in the third frame the gaps are
    closed."""
    scene = wall_and_box(way(*[(0, 0, 20.0)] * start, *[(0.2, 0.1, -5.0)] * 6, step=True))
    expected = whole(scene, device_spec, (start, start + 1))[start]
    frames = caching(scene, device_spec, tracing="adaptive", **ALL).frames(0, start + 6)
    wrong = [int(ghosts(frame, expected).sum()) for frame in frames if frame.number >= start]
    assert 100 < wrong[0] <= (expected == BOX).sum(), wrong
    assert wrong[1] < 0.5 * wrong[0], wrong
    assert wrong[2:] == [0] * 4, wrong


def test_samples_before_the_near_plane_are_dropped(device_spec):
    """The camera moves until the box is before its near plane: what is left are the wall's samples, as from the start in a frame in
    which the box is always before it."""
    scene = wall_and_box(way((0, 0, -3.0)), (1.0, 1.0, 0.1))
    scene = moving(replace(scene, camera=replace(scene.camera, near=2.0)), (0.0, 0.0, -1.5), until=1 / FPS)
    seen = list(caching(scene, device_spec, tracing="single").frames(0, 3))
    assert (seen[0].color["mono"] == BOX).any()
    assert (seen[1].color["mono"] == WALL).all()
    assert (seen[2].color["mono"] == WALL).all()
    box_samples = samples_of(seen[0])[0][seen[0].color["mono"][..., 0] == BOX].sum()
    assert counters_of(seen[1])["dropped"] >= box_samples > 50
    assert counters_of(seen[1])["purged"] == 0
