"""Two eyes: where they stand, and what each of them sees."""

from dataclasses import replace

import numpy as np
import pytest
from render_helpers import ball, everything, lit, render, view

SIZE = (160, 90)
EYES = ("left", "right")


def target(camera, distance, eye_distance):
    """A small white ball on the axis of the camera, `distance` ahead."""
    place = camera.transform[:, 3] - distance * camera.transform[:, 2]
    there = np.column_stack([np.eye(3), place])
    return lit(
        ball(0.05 * distance, 3),
        camera=camera,
        environment=(1.0, 1.0, 1.0),
        instances=[(0, there)],
        eye_distance=eye_distance,
    )


def centre(depth):
    """Mean column and row of the pixels that see something."""
    rows, columns = np.nonzero(np.isfinite(depth))
    return columns.mean() + 0.5, rows.mean() + 0.5


def everything_with(eye_distance):
    scene = everything()
    return replace(scene, defaults=replace(scene.defaults, eye_distance=eye_distance))


def test_no_eye_distance_gives_equal_eyes():
    frame = render(everything_with(0.0), (37, 23), 2, stereo=True, aovs=("N", "Z"))
    for images in (frame.color, *({e: frame.aov(name, e) for e in EYES} for name in ("N", "Z"))):
        np.testing.assert_array_equal(images["left"].view(np.uint32), images["right"].view(np.uint32))


def test_no_eye_distance_is_the_view_of_one_eye():
    scene = everything_with(0.0)
    assert (
        render(scene, (37, 23), stereo=True).color["left"] == render(scene, (37, 23), stereo=False).color["mono"]
    ).all()


def test_one_eye_stands_where_the_camera_does():
    scene = everything_with(0.5)
    np.testing.assert_array_equal(render(scene, (4, 4), stereo=False).cameras["mono"].transform, scene.camera.transform)


@pytest.mark.parametrize("distance", [2.0, 4.0])
@pytest.mark.parametrize(
    "camera", [view((0, 0, 0), (0, 0, -1)), view((3, 1, 2), (-1, 0.5, 0), up=(0.3, 1, 0.2))], ids=["axis", "turned"]
)
def test_disparity(camera, distance):
    """The ball's centre is seen to the right by the left eye: by f d / (2 Z) pixels, f the focal length in pixels.

    Half a pixel's tolerance: the outline is sampled once in each pixel.
    """
    eye_distance = 0.3
    frame = render(target(camera, distance, eye_distance), SIZE, 4, stereo=True, aovs=("Z",), bounces=0)
    focal = SIZE[1] / 2 / np.tan(camera.fov_y / 2)
    shift = focal * eye_distance / 2 / distance
    assert shift > 4
    for eye, sign in (("left", 1), ("right", -1)):
        column, row = centre(frame.aov("Z", eye))
        assert column == pytest.approx(SIZE[0] / 2 + sign * shift, abs=0.5)
        assert row == pytest.approx(SIZE[1] / 2, abs=0.5)
        assert frame.aov("Z", eye).min() == pytest.approx(0.95 * distance, rel=1e-2)


def test_cameras_of_a_frame():
    camera = view((3, 1, 2), (-1, 0.5, 0), up=(0.3, 1, 0.2))
    cameras = render(target(camera, 2, 0.3), (8, 8), stereo=True).cameras
    apart = cameras["right"].transform[:, 3] - cameras["left"].transform[:, 3]
    np.testing.assert_allclose(apart, 0.3 * camera.transform[:, 0], atol=1e-12)
    middle = (cameras["right"].transform[:, 3] + cameras["left"].transform[:, 3]) / 2
    np.testing.assert_allclose(middle, camera.transform[:, 3], atol=1e-12)
    for eye in EYES:
        np.testing.assert_array_equal(cameras[eye].transform[:, :3], camera.transform[:, :3])


def test_each_eye_is_the_view_from_its_place():
    scene = everything_with(0.4)
    frame = render(scene, (37, 23), 2, stereo=True)
    for eye in EYES:
        alone = render(replace(scene, camera=frame.cameras[eye]), (37, 23), 2, stereo=False)
        np.testing.assert_array_equal(alone.color["mono"], frame.color[eye])
