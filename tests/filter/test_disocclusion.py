"""Disocclusion: what was hidden in the frame before has no history; what was seen, or only missed, has, unless what moves was mixed
with something nearer that has left it.

The first hits of small scenes are found in NumPy, by rays against every triangle, for the frame before and for this one; a ray
from the camera before to each point tells whether it was hidden.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from filter_model import pack_hits, still
from helpers import make_mesh, make_scene, soup
from render_helpers import view
from scipy.ndimage import maximum_filter, minimum_filter

from clcache.device import Device
from clcache.frame import FrameGraph
from clcache.methods import PathState
from clcache.passes.temporal import temporal
from clcache.renderer import camera_record
from clcache.resources import SceneResources
from clcache.scene.model import Camera, Scene, Track
from clcache.scene.motion import pose_at
from clcache.settings import resolve

SIZE = (44, 26)
SHAPE = SIZE[::-1]
TOLERANCE = 0.02
NEARER = 0.1
AHEAD = view((0, 0, 0), (0, 0, -1), degrees=50, near=0.1)
BESIDE = view((0.9, 0.2, 0), (0.9, 0.2, -1), degrees=50, near=0.1)
TURNED = view((0, 0, 0), (0.1, 0.05, -1), degrees=50, near=0.1)


def square(size: float, z: float, x: float = 0.0):
    """A mesh of two triangles that face the camera."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * size / 2 + [x, 0, z]
    return make_mesh(corners, [[0, 1, 2], [0, 2, 3]])


def two_planes(has_wall: bool = True, start: float = -0.5, end: float = 0.5, wall: float = 6.0) -> Scene:
    """A square 3 away that flies aside, from time 0 to 1, and a wall 6 away, or nothing, behind it."""
    made = make_scene(square(1.2, -3.0), *([square(30.0, -wall)] if has_wall else []))
    fly = Track(
        np.array([0.0, 1.0]), np.array([[start, 0, 0], [end, 0, 0]]), np.tile([0, 0, 0, 1.0], (2, 1)), np.ones((2, 3))
    )
    return replace(made, instances=(replace(made.instances[0], motion=(fly,)), *made.instances[1:]))


@dataclass
class Hits:
    """What rays hit first. distance: in multiples of the direction's length, infinite for nothing; instance, primitive, uv of it."""

    distance: np.ndarray
    instance: np.ndarray
    primitive: np.ndarray
    uv: np.ndarray


def transforms(scene: Scene, time: float) -> list[np.ndarray]:
    return [np.asarray(pose_at(i.motion, time) if i.motion else i.transform)[:3] for i in scene.instances]


def cast(scene: Scene, time: float, origin: np.ndarray, directions: np.ndarray) -> Hits:
    """Of rays (N, 3) from one place, against each triangle."""
    count = len(directions)
    hits = Hits(np.full(count, np.inf), np.zeros(count, int), np.zeros(count, int), np.zeros((count, 2)))
    for number, (instance, m) in enumerate(zip(scene.instances, transforms(scene, time), strict=True)):
        mesh = scene.meshes[instance.mesh]
        corners = mesh.positions.astype(np.float64) @ m[:, :3].T + m[:, 3]
        for primitive, (a, b, c) in enumerate(corners[mesh.triangles]):
            edges = [np.broadcast_to(edge, directions.shape) for edge in (b - a, c - a)]
            solved = np.linalg.inv(np.stack([*edges, -directions], axis=-1)) @ (origin - a)
            u, v, t = solved.T
            first = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < hits.distance)
            hits.distance[first], hits.instance[first], hits.primitive[first] = t[first], number, primitive
            hits.uv[first] = solved[first, :2]
    return hits


def rays(camera: Camera, jitter: np.random.Generator | None = None) -> np.ndarray:
    """(pixels, 3): a ray of each pixel, of depth 1, through its middle or anywhere."""
    width, height = SIZE
    aside = np.full((2, height, width), 0.5) if jitter is None else jitter.random((2, height, width))
    focal = height / 2 / np.tan(camera.fov_y / 2)
    x, y = np.arange(width) + aside[0], np.arange(height)[:, None] + aside[1]
    local = np.stack([(x - width / 2) / focal, (height / 2 - y) / focal, -np.ones_like(x)], axis=-1)
    return (local @ camera.transform[:, :3].T).reshape(-1, 3)


@dataclass
class Shown:
    """A frame: what its pixels show, and where that was at another time, before another camera: places (pixels, 2), depth."""

    scene: Scene
    camera: Camera
    time: float
    directions: np.ndarray
    hits: Hits

    @classmethod
    def of(cls, scene: Scene, camera: Camera, time: float = 0.0, jitter: np.random.Generator | None = None) -> "Shown":
        directions = rays(camera, jitter)
        return cls(scene, camera, time, directions, cast(scene, time, camera.transform[:, 3], directions))

    @property
    def far(self) -> np.ndarray:
        return np.isinf(self.hits.distance)

    @property
    def words(self) -> np.ndarray:
        return pack_hits(self.far, self.hits.instance, self.hits.primitive, self.hits.uv, self.directions)

    def before(self, camera: Camera, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Directions (pixels, 3) from the camera to the points then, of the length of their depths, infinitely deep ones of depth 1;
        places in pixels; depths."""
        meshes = [self.scene.meshes[i.mesh] for i in self.scene.instances]
        points = self.directions.copy()
        for k, m in enumerate(transforms(self.scene, time)):
            own = ~self.far & (self.hits.instance == k)
            a, b, c = (meshes[k].positions.astype(np.float64)[meshes[k].triangles[self.hits.primitive[own]]]).transpose(
                1, 0, 2
            )
            u, v = self.hits.uv[own].T[..., None]
            points[own] = (a + u * (b - a) + v * (c - a)) @ m[:, :3].T + m[:, 3] - camera.transform[:, 3]
        local = points @ camera.transform[:, :3]
        depth = -local[:, 2]
        focal = SIZE[1] / 2 / np.tan(camera.fov_y / 2)
        places = np.array(SIZE) / 2 + focal * local[:, :2] * [1, -1] / depth[:, None]
        return points, places, np.where(self.far, np.inf, depth)


class Filtering:
    """The whole filter, of which the motion is looked at, and what else `arrays` has."""

    def __init__(self, device: Device, scene: Scene, kind: str = "varianceblend", estimate: str = "corrected"):
        self.resources = SceneResources(device, scene)
        built = temporal(device, self.resources, SIZE, resolve({}, {"varianceblend.estimate": estimate}), kind)
        self._surface = device.empty((SIZE[0] * SIZE[1], 4), np.uint32)
        self._color = device.empty((SIZE[0] * SIZE[1], 3), np.float32)
        inputs = {"surface": self._surface, "color": self._color}
        outputs = {"filtered", "motion", "depth", "aov_effective"}
        self.graph = FrameGraph(device, built.passes, built.buffers, outputs, inputs, exchanged=built.exchanged)

    def show(self, frame: Shown, before: Camera | None, color: np.ndarray | float = 1.0) -> np.ndarray:
        """The motion (pixels, 2) of the next frame, whose pixels have one colour, or one each."""
        self.resources.set_time(frame.time)
        gray = np.broadcast_to(np.asarray(color, np.float32), SIZE[0] * SIZE[1])
        self._color.set(np.ascontiguousarray(np.repeat(gray[:, None], 3, axis=1)))
        self._surface.set(frame.words)
        record = None if before is None else camera_record(before, SIZE)
        self.graph.run(PathState(camera_record(frame.camera, SIZE), (0, 0), 1, camera_before=record))
        return self.graph.of()["motion"].get()[: SIZE[0] * SIZE[1]]

    def found(self, name: str) -> np.ndarray:
        """(pixels, ...): an image of the last frame."""
        return self.graph.of()[name].get()[: SIZE[0] * SIZE[1]]

    def pair(self, first: Shown, second: Shown) -> np.ndarray:
        """That of a frame after a first one: (pixels,), which of its points have a history."""
        assert not np.isfinite(self.show(first, None)).any()
        return np.isfinite(self.show(second, first.camera)).all(axis=1)


def inside(places: np.ndarray, margin: float = 0.0) -> np.ndarray:
    return ((places >= margin) & (places < np.array(SIZE) - margin)).all(axis=1)


def expected(first: Shown, second: Shown) -> np.ndarray:
    """Which points of the second frame have a history: those before the camera that lie at most a tolerance behind the farthest
    first hit of the 3x3 pixels about the pixel of the first frame that they were in, or would have been nearest."""
    _, places, depth = second.before(first.camera, first.time)
    farthest = maximum_filter(first.hits.distance.reshape(SHAPE), 3, mode="nearest")
    x, y = np.clip(np.floor(places), 0, np.array(SIZE) - 1).astype(int).T
    return (depth > first.camera.near) & (depth <= farthest[y, x] * (1 + TOLERANCE))


def was_hidden(first: Shown, second: Shown) -> np.ndarray:
    """(pixels,): by rays to the points."""
    towards, _, depth = second.before(first.camera, first.time)
    reach = cast(first.scene, first.time, first.camera.transform[:, 3], towards).distance
    return reach < np.where(np.isinf(depth), np.inf, 1 - 1e-6)


MOVES = {
    "instance moves": (AHEAD, AHEAD, 1.0),
    "camera moves": (AHEAD, BESIDE, 0.0),
    "camera turns, instance moves": (AHEAD, TURNED, 1.0),
    "both move": (BESIDE, AHEAD, 0.7),
}


@pytest.mark.parametrize("has_wall", [True, False], ids=["wall", "background"])
@pytest.mark.parametrize("move", MOVES, ids=str)
def test_what_an_occluder_uncovers_has_no_history(device, move, has_wall):
    """But for what was beside the occluder's edge: 3x3 pixels show both. All else has one, the occluder itself as well, nearer than
    all that was there."""
    before, now, time = MOVES[move]
    scene = two_planes(has_wall)
    first, second = Shown.of(scene, before), Shown.of(scene, now, time)
    has = Filtering(device, scene).pair(first, second)
    np.testing.assert_array_equal(has, expected(first, second))
    places, hidden = second.before(before, 0.0)[1], was_hidden(first, second)
    seen_then = inside(places, 1)
    assert has[~hidden & seen_then].all()
    parallax = has_wall or now is not BESIDE and before is not BESIDE or time > 0  # the background has none by itself
    uncovered = hidden & seen_then & ~has
    if parallax:
        assert uncovered.sum() > 0.4 * (hidden & seen_then).sum() > 15
    assert (has & (second.hits.instance == 0) & ~second.far).sum() > 40


@pytest.mark.parametrize(("wall", "is_found"), [(3.05, False), (3.07, True)])
def test_depths_that_differ_by_2_percent_are_the_same(device, wall, is_found):
    scene = two_planes(wall=wall)
    has = Filtering(device, scene).pair(Shown.of(scene, AHEAD), Shown.of(scene, AHEAD, 1.0))
    assert has.all() != is_found


def test_at_the_images_border(device):
    """An occluder that covered its left columns uncovers them, and one at a corner; nothing is read beyond."""
    for start in (-2.6, -2.2):
        scene = two_planes(start=start, end=start + 1.2)
        first, second = Shown.of(scene, AHEAD), Shown.of(scene, AHEAD, 1.0)
        has = Filtering(device, scene).pair(first, second)
        np.testing.assert_array_equal(has, expected(first, second))
        hidden = was_hidden(first, second).reshape(SHAPE)
        assert hidden[:, 0].sum() > 5
        assert (~has.reshape(SHAPE))[:, 0].sum() >= hidden[:, 0].sum() - 2
        assert not (~has.reshape(SHAPE) & ~hidden).any()


def test_what_appears_before_everything_has_a_history(device):
    """A square before the wall, and all before the sky, that the frame before did not show though nothing hid them: they were
    missed, as thin things are by most samples. But sky is not taken for what was seen of a wall."""
    scene = two_planes()
    shown = Shown.of(scene, AHEAD)
    wall = Shown.of(replace(scene, instances=scene.instances[1:]), AHEAD).hits
    assert (wall.distance > 5).all()
    of_wall = replace(shown, hits=replace(wall, instance=wall.instance + 1))
    of_sky = replace(shown, hits=replace(wall, distance=np.full_like(wall.distance, np.inf)))
    filtering = Filtering(device, scene)
    assert filtering.pair(of_wall, shown).all()
    assert filtering.pair(of_sky, shown).all()
    assert filtering.pair(of_sky, of_sky).all()
    assert not filtering.pair(of_wall, of_sky).any()


def test_nothing_is_uncovered_where_all_stands_still(device):
    """With the same rays, exactly; of small triangles, other rays find other ones each frame, and still all was seen before, but
    for a few points that none of nine pixels' rays came as far as."""
    tangle = make_scene(soup(250, 3, 0.08))
    camera = view((0, 0, 3.0), (0, 0, 0), degrees=50, near=0.1)
    filtering, rng = Filtering(device, tangle), np.random.default_rng(1)
    frame = Shown.of(tangle, camera)
    assert 0.7 < frame.far.mean() < 0.99
    filtering.show(frame, None)
    np.testing.assert_array_equal(filtering.show(frame, camera), still(SIZE).reshape(-1, 2))
    for _ in range(4):
        frame = Shown.of(tangle, camera, jitter=rng)
        has = np.isfinite(filtering.show(frame, camera)).all(axis=1)
        assert has[~frame.far].mean() > 0.9
        assert has[frame.far].mean() > 0.99


@pytest.mark.parametrize("height", [0.05, 0.3, 2.0])
def test_a_slanted_floor_in_motion_keeps_its_history(device, height):
    """However flat it is seen, the 3x3 pixels have more of a plane than a point of the middle one, wherever their rays are."""
    scene = make_scene(
        make_mesh([[-300, 0, -300], [300, 0, -300], [300, 0, 300], [-300, 0, 300]], [[0, 2, 1], [0, 3, 2]])
    )
    rng = np.random.default_rng(2)
    cameras = [
        view((0.3 * k * height, height, -k * height), (k * height, 0.8 * height, -20 - k * height), 50, 0.01)
        for k in range(5)
    ]
    filtering = Filtering(device, scene)
    filtering.show(Shown.of(scene, cameras[0], jitter=rng), None)
    for before, now in zip(cameras, cameras[1:], strict=False):
        frame = Shown.of(scene, now, jitter=rng)
        has = np.isfinite(filtering.show(frame, before)).all(axis=1)
        within = inside(frame.before(before, 0.0)[1], 1)
        assert (within & ~frame.far).sum() > 200
        assert has[within & ~frame.far].all()


def test_a_cut_and_what_follows(device):
    """The first frame after a cut has no history, and is what the second one's is held against: not the frames before the cut."""
    scene = two_planes()
    filtering = Filtering(device, scene)
    for _ in range(3):
        filtering.show(Shown.of(scene, view((0, 0, -2.9), (0, 0, -3), degrees=50, near=0.01), 0.5), None)
    first, second = Shown.of(scene, AHEAD), Shown.of(scene, AHEAD, 1.0)
    assert not expected(first, second).all()
    np.testing.assert_array_equal(filtering.pair(first, second), expected(first, second))
    third = np.isfinite(filtering.show(second, AHEAD)).all(axis=1)
    assert third.all()  # the second frame is the one before, and the instance stands where it stood


def test_only_the_corrected_estimate_looks_for_it(device):
    """TAA and the published estimate have a history there; the motion is the same to the bit wherever both have one."""
    scene = two_planes()
    first, second = Shown.of(scene, AHEAD), Shown.of(scene, AHEAD, 1.0)
    found = {}
    for kind, estimate in (("varianceblend", "corrected"), ("varianceblend", "published"), ("taa", "corrected")):
        filtering = Filtering(device, scene, kind, estimate)
        filtering.show(first, None)
        found[kind, estimate] = filtering.show(second, AHEAD)
        assert ("depths" in filtering.graph.of()) == ((kind, estimate) == ("varianceblend", "corrected"))
    corrected, *others = found.values()
    has = np.isfinite(corrected).all(axis=1)
    assert 0.7 < has.mean() < 0.99
    for other in others:
        assert np.isfinite(other).all()
        np.testing.assert_array_equal(other[has], corrected[has])


@pytest.mark.parametrize("move", MOVES, ids=str)
def test_what_was_beside_something_nearer_is_known(device, move):
    """By the sign of the depth: of the frame before's 3x3 pixels about a point, one was nearer by more than a tenth."""
    before, now, time = MOVES[move]
    scene = two_planes()
    first, second = Shown.of(scene, before), Shown.of(scene, now, time)
    filtering = Filtering(device, scene)
    filtering.pair(first, second)
    _, places, depth = second.before(before, 0.0)
    closest = minimum_filter(first.hits.distance.reshape(SHAPE), 3, mode="nearest")
    x, y = np.clip(np.floor(places), 0, np.array(SIZE) - 1).astype(int).T
    was_beside = closest[y, x] < depth * (1 - NEARER)
    found = filtering.found("depth")
    np.testing.assert_array_equal(np.signbit(found), was_beside)
    np.testing.assert_allclose(np.abs(found), second.hits.distance, rtol=1e-4)
    assert (was_beside & np.isfinite(filtering.found("motion")).all(axis=1)).sum() > 20  # the edge's other side


@pytest.mark.parametrize(("wall", "is_beside"), [(3.3, False), (3.37, True)])
def test_what_is_nearer_by_a_tenth_is_beside(device, wall, is_beside):
    scene = two_planes(wall=wall)
    filtering = Filtering(device, scene)
    filtering.pair(Shown.of(scene, AHEAD), Shown.of(scene, AHEAD, 1.0))
    assert np.signbit(filtering.found("depth")).any() == is_beside


def test_what_moves_past_leaves_no_mixed_colours(device):
    """A bright square before a dark wall, both passed by the camera, with a ray anywhere in each pixel: at the square's edge the
    history has both colours. Where no ray about a pixel meets the square any more, it is the wall's alone, but for 0.4 %, into which
    cubic interpolation brings some from further off; 2 % had it if the history went on. It does elsewhere."""
    scene, rng = two_planes(), np.random.default_rng(3)
    filtering, before, left, count, sides = Filtering(device, scene), None, [], [], 0
    for number in range(16):
        camera = view((0.09 * number - 0.7, 0.03, 0), (0.09 * number - 0.7, 0.03, -1), degrees=50, near=0.1)
        frame = Shown.of(scene, camera, jitter=rng)
        is_square = frame.hits.instance == 0
        filtering.show(frame, before, np.where(is_square, 10.0, 1.0))
        is_about = maximum_filter(is_square.reshape(SHAPE), 3).ravel()
        if number > 4:
            left.append((filtering.found("filtered")[~is_about, 0] - 1) / 9)
            count.append(filtering.found("aov_effective")[~is_about])
            sides += np.sum(np.signbit(filtering.found("depth")) & ~is_about)
        before = camera
    assert sides > 80
    assert (np.concatenate(left) > 0.01).mean() < 0.008
    assert np.median(np.concatenate(count)) > 9


def test_thin_things_that_stand_still_keep_their_history(device):
    """Other rays find them, or not, in each frame; beside a missed one something nearer was, which has not left: nothing
    moves, and the images are, to the bit, those of frames in which nothing was nearer."""
    tangle = make_scene(soup(250, 3, 0.08))
    camera = view((0, 0, 3.0), (0, 0, 0), degrees=50, near=0.1)
    usual, ignorant, rng = Filtering(device, tangle), Filtering(device, tangle), np.random.default_rng(4)
    before = None
    for _ in range(6):
        frame = Shown.of(tangle, camera, jitter=rng)
        color = np.where(frame.far, 0.5, 3.0) * rng.uniform(0.5, 1.5, SIZE[0] * SIZE[1])
        if before is not None:
            depths = ignorant.graph.of()["depths"]
            depths.set(np.repeat(depths.get()[:, 1:], 2, axis=1))
        for filtering in (usual, ignorant):
            filtering.show(frame, before, color)
        for name in ("filtered", "aov_effective"):
            np.testing.assert_array_equal(usual.found(name), ignorant.found(name))
        before = camera
    closest = minimum_filter(np.abs(usual.found("depth")).reshape(SHAPE), 3).ravel()
    gone = np.signbit(usual.found("depth")) & (closest >= 0.95 * np.abs(usual.found("depth")))
    assert gone.sum() > 40
    assert usual.found("aov_effective")[gone].mean() > 4
