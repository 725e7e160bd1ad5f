"""Motion vectors: where the points of first hits were seen in the frame before, against an independent projection."""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import at
from filter_model import ONE, pack_hits
from helpers import IDENTITY, soup
from render_helpers import floor, lit, view

from clcache.frame import FrameGraph
from clcache.methods import PathState
from clcache.passes.temporal import temporal
from clcache.renderer import camera_record
from clcache.resources import SceneResources
from clcache.scene.model import Camera, Scene, Track
from clcache.scene.motion import pose_at
from clcache.settings import resolve

SIZE = (23, 14)
PIXELS = SIZE[0] * SIZE[1]
NOW = view((0.3, 1.2, 5.0), (0.2, 0.1, 0.0), degrees=50, near=0.1)
ASIDE = view((0.35, 1.25, 4.9), (0.2, 0.1, 0.0), degrees=50, near=0.1)
TURNED = view((0.3, 1.2, 5.0), (0.4, 0.2, 0.1), degrees=50, near=0.1)
SPIN = Track(
    np.array([0.0, 1.0]),
    np.array([[0.5, 0, 0], [0.9, 0.3, -0.4]]),
    np.array([[0, 0, 0, 1.0], [0, 0.6, 0, 0.8]]),
    np.array([[1.0, 1, 1], [1.2, 0.9, 1]]),
)


def scene(scale: float = 1.0, offset=(0, 0, 0)) -> Scene:
    """Triangles that stand, and others that move."""
    place = at(offset, scale)
    still = lit(
        floor(6), soup(40, 1, 0.6), soup(40, 2, 0.6), camera=NOW, instances=[(0, IDENTITY), (1, place), (2, IDENTITY)]
    )
    return replace(still, instances=(*still.instances[:2], replace(still.instances[2], motion=(SPIN,))))


def first_hits(seed: int = 1, background: float = 0.2) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Packed (pixels, 4) uint32 at random, and what they say: instance, primitive, u, v, direction; some are background."""
    rng = np.random.default_rng(seed)
    far = rng.random(PIXELS) < background
    instance = rng.integers(0, 3, PIXELS)
    primitive = np.where(instance == 0, rng.integers(0, 2, PIXELS), rng.integers(0, 40, PIXELS))
    uv = rng.integers(0, ONE // 2, (PIXELS, 2))
    direction = rng.normal(size=(PIXELS, 3)) + [0, 0, -2]
    material = rng.integers(0, 256, (PIXELS, 2)) << 24  # bits that say nothing of the place
    words = pack_hits(far, instance, primitive, uv / ONE, direction)
    words[:, :2] |= material.astype(np.uint32)
    told = {"far": far, "instance": instance, "primitive": primitive, "uv": uv / ONE, "direction": direction}
    return words, told


def places(camera: Camera, transforms: list[np.ndarray], scene: Scene, told: dict) -> np.ndarray:
    """(pixels, 3) float64: where in the image, and how deep."""
    points = told["direction"].copy()
    for i in np.flatnonzero(~told["far"]):
        instance = told["instance"][i]
        mesh = scene.meshes[scene.instances[instance].mesh]
        a, b, c = mesh.positions[mesh.triangles[told["primitive"][i]]].astype(np.float64)
        u, v = told["uv"][i]
        m = transforms[instance]
        points[i] = m[:, :3] @ (a + u * (b - a) + v * (c - a)) + m[:, 3] - camera.transform[:, 3]
    view_space = points @ camera.transform[:, :3]
    depth = -view_space[:, 2]
    focal = SIZE[1] / 2 / np.tan(camera.fov_y / 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = SIZE[0] / 2 + focal * view_space[:, 0] / depth
        y = SIZE[1] / 2 - focal * view_space[:, 1] / depth
    return np.column_stack([x, y, depth])


def transforms_at(scene: Scene, time: float) -> list[np.ndarray]:
    """Each instance's transform (3, 4), as float32 has it."""
    placed = [pose_at(i.motion, time) if i.motion else i.transform for i in scene.instances]
    return [np.asarray(m, np.float64)[:3].astype(np.float32).astype(np.float64) for m in placed]


class Motion:
    """The pass that finds motion, alone."""

    def __init__(self, device, scene: Scene, size=SIZE):
        self.resources, self.size = SceneResources(device, scene), size
        built = temporal(device, self.resources, size, resolve({}, {}), "taa")
        self._surface = device.empty((size[0] * size[1], 4), np.uint32)
        inputs = {"surface": self._surface}
        self.graph = FrameGraph(device, built.passes[:1], built.buffers, {"motion", "depth"}, inputs)

    def find(self, surface: np.ndarray, camera: Camera, before: Camera | None, time=0.0, time_before=0.0) -> np.ndarray:
        """(pixels, 2)"""
        self.resources.set_time(time_before)
        self.resources.set_time(time)
        self._surface.set(surface)
        record = None if before is None else camera_record(before, self.size)
        self.graph.run(PathState(camera_record(camera, self.size), (0, 0), 1, camera_before=record))
        return self.graph.of()["motion"].get()[: self.size[0] * self.size[1]]

    @property
    def depth(self) -> np.ndarray:
        """(pixels,), of the last call."""
        return self.graph.of()["depth"].get()[: self.size[0] * self.size[1]]


def expected_motion(scene, told, camera, before, time=0.0, time_before=0.0):
    now = places(camera, transforms_at(scene, time), scene, told)
    then = places(before, transforms_at(scene, time_before), scene, told)
    known = ~told["far"]
    seen = (now[:, 2] > np.where(known, camera.near, 0)) & (then[:, 2] > np.where(known, before.near, 0))
    # Places far outside the image are of no use, and have the errors of small depths.
    return np.where(seen[:, None], (then - now)[:, :2], np.inf), np.abs(np.concatenate([now, then], axis=1)).max(axis=1)


@pytest.mark.parametrize(
    ("before", "times"),
    [(ASIDE, (0, 0)), (TURNED, (0, 0)), (NOW, (0.7, 0.4)), (ASIDE, (0.5, 0.3))],
    ids=["camera moves", "camera turns", "instance moves", "both"],
)
def test_motion_is_that_of_the_projections(device, before, times):
    made = scene()
    words, told = first_hits()
    motion = Motion(device, made)
    found = motion.find(words, NOW, before, *times)
    expected, size = expected_motion(made, told, NOW, before, *times)
    assert np.isfinite(expected).all(axis=1).sum() > PIXELS / 2
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
    near = np.isfinite(expected).all(axis=1) & (size < 1e3)
    np.testing.assert_allclose(found[near], expected[near], atol=3e-4)
    depth = places(NOW, transforms_at(made, times[0]), made, told)[:, 2]
    np.testing.assert_allclose(motion.depth, np.where(told["far"], np.inf, depth), atol=1e-5)
    moves = np.abs(expected[near]).max(axis=1) > 0.01
    if before is NOW:  # then only the moving instance does
        np.testing.assert_array_equal(moves, (told["instance"] == 2)[near] & ~told["far"][near])
    else:
        assert moves.sum() > 0.8 * near.sum() - (before is ASIDE) * told["far"].sum()


def test_what_stands_still_has_no_motion_at_all(device):
    """Exactly 0, however far from the origin, and whatever the camera's pose; the background, too, when the camera only moves."""
    words, told = first_hits()
    for offset, scale in (((0, 0, 0), 1), ((1e6, -3e5, 7e5), 1), ((0, 0, 0), 1e-6)):
        moved = np.column_stack([NOW.transform[:, :3], NOW.transform[:, 3] * scale + offset])
        camera = replace(NOW, transform=moved, near=0.0)
        found = Motion(device, scene(scale, offset)).find(words, camera, camera, 0.3, 0.3)
        seen = np.isfinite(found).all(axis=1)
        assert seen.sum() > PIXELS / 4
        np.testing.assert_array_equal(found[seen], 0)
    shifted = replace(NOW, transform=np.column_stack([NOW.transform[:, :3], NOW.transform[:, 3] + [3, 1, -2]]))
    background = Motion(device, scene()).find(words, NOW, shifted)[told["far"]]
    np.testing.assert_array_equal(background[np.isfinite(background)], 0)
    assert np.isfinite(background).all(axis=1).sum() > 10


def test_far_from_the_origin(device):
    """Where float32 has 6 cm, what moves relative to the eye is still told to a fraction of a pixel: the instance's place is
    exact, and so is the eye's."""
    offset = np.array([2.0**20, -(2.0**19), 2.0**20])
    words, told = first_hits(background=0.0)
    words[:, 3] = told["instance"][:] = 1
    words[:, 2] = told["primitive"][:] = told["primitive"] % 40
    cameras = [replace(c, transform=np.column_stack([c.transform[:, :3], np.round(c.transform[:, 3] * 8) / 8 + offset])) for c in (NOW, TURNED)]  # fmt: skip
    made = scene(1.0, offset)
    expected, size = expected_motion(made, told, *cameras)
    found = Motion(device, made).find(words, *cameras)
    near = np.isfinite(expected).all(axis=1) & (size < 300)
    assert near.sum() > PIXELS / 3
    np.testing.assert_allclose(found[near], expected[near], atol=1e-3)


def test_without_a_frame_before_there_is_none(device):
    """No motion is finite; nor where a point was behind the camera, or is nearer than its near plane."""
    words, told = first_hits()
    motion = Motion(device, scene())
    assert not np.isfinite(motion.find(words, NOW, None)).any()
    away = view((0.0, 0.3, 0.2), (1.0, 0.3, 0.3), degrees=50)  # amid the triangles
    expected, _ = expected_motion(scene(), told, NOW, away)
    found = motion.find(words, NOW, away)
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
    assert 0.1 < np.isfinite(found).all(axis=1).mean() < 0.6
    beyond, known = replace(NOW, near=50.0), np.isfinite(motion.find(words, NOW, NOW)).all(axis=1)
    for now, before in ((beyond, NOW), (NOW, beyond)):
        found = np.isfinite(motion.find(words, now, before)).all(axis=1)
        np.testing.assert_array_equal(found, told["far"] & known)


def test_history_ends_when_the_scene_jumps_and_goes_on(device):
    """`instances_before` is of the call of set_time before: a still pair of frames follows a moving one."""
    made = scene()
    words, told = first_hits()
    motion = Motion(device, made)
    moving = motion.find(words, NOW, NOW, 0.9, 0.1)
    resting = motion.find(words, NOW, NOW, 0.9, 0.9)
    of_moving = (told["instance"] == 2) & ~told["far"] & np.isfinite(moving).all(axis=1)
    assert (np.abs(moving[of_moving]).max(axis=1) > 0.1).mean() > 0.9
    np.testing.assert_array_equal(resting[np.isfinite(resting)], 0)
