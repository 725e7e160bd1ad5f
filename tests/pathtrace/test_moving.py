"""What moves: frames against the same scene standing still where the motion has it."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import IDENTITY
from render_helpers import ball, floor, grey, lit, render, shape_mesh, view

from clcache import Renderer
from clcache.bvh.build import SceneTrees
from clcache.device import Device
from clcache.resources import SceneResources
from clcache.scene.generators import box, plane
from clcache.scene.model import DirectionalLight, Environment, Material, PointLight, SpotLight, Track
from clcache.scene.motion import pose_at
from clcache.scene.transform import rigid

FPS = 10.0
SIZE = (24, 16)
SECONDS = np.array([0.0, 1.0])
QUARTER = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]  # a turn about +Y


def track(start, end, turn=QUARTER, scale=(1.0, 1.0, 1.0)):
    """A move over the first second, with a turn and a change of scale."""
    return Track(
        SECONDS, np.array([start, end], float), np.array([[0, 0, 0, 1.0], turn]), np.array([[1.0, 1, 1], scale])
    )


def sky():
    """A picture, so that rays and shadow rays share its light by its chance."""
    picture = np.random.default_rng(1).uniform(0.1, 0.6, (4, 8, 3)).astype(np.float32)
    picture[1, 3] = 20
    return Environment(picture)


LAMP = Material("lamp", (0.0, 0.0, 0.0), emission=(6.0, 5.0, 4.0))
RISING = track((-1, 0.5, 0), (1.5, 1.5, 0.5), scale=(0.5, 1.5, 1.0))
TURNED = np.array([[0, 0, 1, 0], [0, 1, 0, 0.3], [-1.0, 0, 0, 0]])


def world():
    """A still floor, a box and a lamp that move, the box under two transforms of which one stands still."""
    scene = lit(
        floor(6), shape_mesh(box((0.8, 0.8, 0.8))), shape_mesh(plane((0.7, 0.7)), 1),
        camera=view((0, 3, 5), (0, 0.5, 0)), materials=[grey(0.6), LAMP], environment=sky(),
        lights=[PointLight((0, 2, 0), (3.0, 2.0, 1.0))],
        instances=[(0, IDENTITY), (1, IDENTITY), (2, IDENTITY)],
    )  # fmt: skip
    motions = ((), (TURNED, RISING), (track((0, 2.5, 0), (3, 1, 2), (1.0, 0, 0, 0), (3.0, 3.0, 3.0)),))
    placed = tuple(replace(i, motion=m) for i, m in zip(scene.instances, motions, strict=True))
    return replace(scene, instances=placed, defaults=replace(scene.defaults, fps=FPS))


def frozen(scene, seconds):
    """The scene as it is then, with nothing that moves."""
    instances = tuple(
        replace(i, transform=pose_at(i.motion, seconds), motion=()) if i.motion else i for i in scene.instances
    )
    camera = scene.camera
    if camera.motion:
        camera = replace(camera, transform=rigid(pose_at(camera.motion, seconds)), motion=())
    return replace(
        scene, instances=instances, camera=camera, lights=tuple(still(light, seconds) for light in scene.lights)
    )


def still(light, seconds):
    if not light.motion:
        return light
    pose = pose_at(light.motion, seconds)
    now = {}
    if not isinstance(light, DirectionalLight):
        now["position"] = tuple(pose[:, :3] @ light.position + pose[:, 3])
    if not isinstance(light, PointLight):
        direction = pose[:, :3] @ light.direction
        now["direction"] = tuple(direction / np.linalg.norm(direction))
    return replace(light, motion=(), **now)


@pytest.fixture(scope="module")
def device():
    """The default one."""
    return Device(None)


@pytest.mark.parametrize("frame", [0, 3, 7, 10, 25])
def test_moving_instances_are_where_they_are(frame):
    """Emissive and not, beside a sampled sky: the same image as the still scene's. Its trees may differ, in whose leaves rays
    meet the same triangles in another order; so all but rounding."""
    scene = world()
    moving = render(scene, SIZE, 4, frame=frame, bounces=1).color["mono"]
    expected = render(frozen(scene, frame / FPS), SIZE, 4, frame=frame, bounces=1).color["mono"]
    np.testing.assert_allclose(moving, expected, rtol=1e-3, atol=1e-4)


def test_something_moves():
    frames = [render(world(), SIZE, 4, frame=f, bounces=1).color["mono"] for f in (0, 10)]
    assert np.abs(frames[0] - frames[1]).mean() > 0.05


def test_a_frame_alone_is_that_frame_of_a_sequence():
    """Bit for bit, whatever was rendered before."""
    scene = world()
    sequence = list(Renderer(scene, size=SIZE, spp=2).frames(2, 6))
    for frame in (5, 3):
        alone = next(Renderer(scene, size=SIZE, spp=2).frames(frame, frame + 1))
        np.testing.assert_array_equal(alone.color["mono"], sequence[frame - 2].color["mono"])
    renderer = Renderer(scene, size=SIZE, spp=2)
    backwards = [next(renderer.frames(f, f + 1)).color["mono"] for f in (5, 4, 2, 4)]
    for image, frame in zip(backwards, (5, 4, 2, 4), strict=True):
        np.testing.assert_array_equal(image, sequence[frame - 2].color["mono"])


def test_moving_camera():
    """Both eyes, about its own axes; scale has no effect on a camera."""
    scene = world()
    path = track((0, 2, 4), (1, 3, 3), [0, np.sin(0.2), 0, np.cos(0.2)], (2.0, 2.0, 2.0))
    scene = replace(
        scene,
        camera=replace(scene.camera, motion=(path,)),
        defaults=replace(scene.defaults, eye_distance=0.2),
        lights=(),
    )
    moving = render(scene, SIZE, 2, frame=4, stereo=True, bounces=0)
    fixed = render(frozen(scene, 0.4), SIZE, 2, frame=4, stereo=True, bounces=0)
    for eye in ("left", "right"):
        np.testing.assert_allclose(moving.color[eye], fixed.color[eye], rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(moving.cameras[eye].transform, fixed.cameras[eye].transform, atol=1e-12)
    apart = moving.cameras["right"].transform[:, 3] - moving.cameras["left"].transform[:, 3]
    np.testing.assert_allclose(np.linalg.norm(apart), 0.2)


def test_moving_lights():
    """Each kind alone, on a still floor: position, axis and direction follow, strength stays."""
    path = track((1, 0.5, 0), (-1, 1, 0.5), [np.sin(0.3), 0, 0, np.cos(0.3)], (2.0, 2.0, 2.0))
    lights = (
        PointLight((0, 1, 0), (4.0, 3.0, 2.0), (path,)),
        SpotLight((0, 1.5, 0), (0.0, -1.0, 0.0), (9.0, 9.0, 9.0), 0.2, 0.7, (path,)),
        DirectionalLight((0.6, -0.8, 0.0), (1.0, 2.0, 3.0), (path,)),
    )
    for light in lights:
        scene = lit(floor(6), ball(0.4, 1), camera=view((0, 3, 5), (0, 0.5, 0)), materials=[grey(0.6)], lights=[light])
        scene = replace(scene, defaults=replace(scene.defaults, fps=FPS))
        images = [render(scene, SIZE, 2, frame=f, bounces=0).color["mono"] for f in (0, 7)]
        expected = render(frozen(scene, 0.7), SIZE, 2, frame=7, bounces=0).color["mono"]
        np.testing.assert_allclose(images[1], expected, rtol=1e-4, atol=1e-6)
        assert np.abs(images[0] - images[1]).max() > 0.05 and images[1].max() > 0.05


def test_the_tree_is_rebuilt_only_when_something_moved(monkeypatch):
    """Frames before the first key and after the last show the same scene, and a moving camera or light moves no instance."""
    builds = []
    build = SceneTrees._build_top
    monkeypatch.setattr(SceneTrees, "_build_top", lambda self, *a: (builds.append(1), build(self, *a))[1])

    def count(scene, first, last):
        builds.clear()
        for _ in Renderer(scene, size=(4, 4), spp=1).frames(first, last):
            pass
        return len(builds)

    moving = world()
    assert count(frozen(moving, 0.5), 0, 4) == 1
    assert count(moving, 0, 1) == 1, "frame 0 is how the scene was loaded"
    assert count(moving, 0, 5) == 5
    assert count(moving, 9, 20) == 3, "frames 9 and 10, then nothing moves"
    path = track((0, 2, 4), (1, 3, 3))
    alone = frozen(moving, 0.0)
    alone = replace(
        alone, camera=replace(alone.camera, motion=(path,)), lights=(PointLight((0, 0, 0), (1.0, 1.0, 1.0), (path,)),)
    )
    assert count(alone, 0, 5) == 1


def test_previous_transforms_are_kept(device):
    """`instances_before`: as at the call before; the current ones: as `pose_at` has them; memory does not grow."""
    scene = world()
    resources = SceneResources(device, scene)
    resources.keep_before()
    taken = []
    for seconds, before in ((0.0, 0.0), (0.3, 0.0), (0.7, 0.3), (0.7, 0.7), (5.0, 0.7)):
        resources.set_time(seconds)
        taken.append(device.allocated)
        for name, time in (("instances", seconds), ("instances_before", before)):
            records = resources.arrays[name].get()
            for record, instance in zip(records, scene.instances, strict=True):
                expected = pose_at(instance.motion, time) if instance.motion else instance.transform
                np.testing.assert_allclose(record["to_world"].reshape(3, 4), expected, rtol=1e-6, atol=1e-6)
                there = record["to_object"].reshape(3, 4).astype(float)
                product = there[:, :3] @ record["to_world"].reshape(3, 4)[:, :3]
                np.testing.assert_allclose(product, np.eye(3), atol=1e-6)
    assert len(set(taken[1:])) == 1


def test_previous_transforms_are_kept_only_where_they_are_asked_for(device):
    resources = SceneResources(device, world())
    resources.set_time(1.0)
    assert "instances_before" not in resources.arrays
    resources.keep_before()
    np.testing.assert_array_equal(resources.arrays["instances_before"].get(), resources.arrays["instances"].get())


def test_of_a_still_scene_the_previous_transforms_are_the_current_ones(device):
    resources = SceneResources(device, frozen(world(), 0.5))
    resources.keep_before()
    resources.set_time(1.0)
    np.testing.assert_array_equal(resources.arrays["instances_before"].get(), resources.arrays["instances"].get())


def test_chances_follow_what_moves(device):
    """A lamp that grows ninefold, and a scene that gets larger, take and give chances: densities by which the surfaces'
    own rays are weighted say the same as the emitters' shares."""
    scene = world()
    resources = SceneResources(device, scene)
    seen = []
    for seconds in (0.0, 1.0):
        resources.set_time(seconds)
        still_resources = SceneResources(device, frozen(scene, seconds))
        for name in ("shares",):
            np.testing.assert_allclose(resources.arrays[name].get(), still_resources.arrays[name].get(), atol=1e-6)
        density = [r.arrays["materials"].get()["emitter_density"] for r in (resources, still_resources)]
        np.testing.assert_allclose(*density, rtol=1e-5)
        chance = float(resources.environment["chance"])
        assert chance == pytest.approx(float(still_resources.environment["chance"]), rel=1e-5)
        seen.append(chance)
    assert seen[0] != pytest.approx(seen[1], rel=0.05)
