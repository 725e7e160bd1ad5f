"""Reprojected differences of scenes whose every pixel has a closed form: textured planes, a step in depth, a far sky."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clcache.errors import SettingError
from clcache.metrics import View, reprojected_difference
from clcache.scene.model import Camera

FOV_Y = 0.9


def camera_at(position, yaw=0.0, pitch=0.0, fov_y=FOV_Y):
    """Looking along -Z, turned by yaw about Y after pitch about X."""
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    turned = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    return Camera(np.column_stack([turned, position]), fov_y)


def rays(camera, size):
    """World-space rays through the pixel centres, of length 1 along the viewing axis: origin (3,), directions (H, W, 3)."""
    width, height = size
    tangent = math.tan(camera.fov_y / 2)
    across = (2 * (np.arange(width) + 0.5) / width - 1) * tangent * width / height
    up = (1 - 2 * (np.arange(height) + 0.5) / height) * tangent
    x, y = np.meshgrid(across, up)
    local = np.stack([x, y, -np.ones_like(x)], axis=-1)
    return camera.transform[:, 3], local @ camera.transform[:, :3].T


def smooth(points):
    """A colour that changes slowly over space."""
    return np.stack([1 + np.sin(2 * points[..., 0]), 2 + np.cos(3 * points[..., 1]), 1 + 0.1 * points[..., 0]], axis=-1)


def linear(points):
    return np.stack([points[..., 0], points[..., 1], points[..., 0] - 2 * points[..., 1]], axis=-1)


def see_plane(camera, normal=(0, 0, 1), distance=-4.0, size=(96, 64), color=smooth):
    """What the camera sees of the plane where normal . p = distance; what does not meet it is infinitely far, and black."""
    origin, directions = rays(camera, size)
    with np.errstate(divide="ignore"):
        depth = (distance - np.dot(normal, origin)) / (directions @ np.asarray(normal, float))
    met = (depth > 0) & np.isfinite(depth)
    points = origin + np.where(met, depth, 0.0)[..., None] * directions
    return View(
        np.where(met[..., None], color(points), 0.0).astype(np.float32),
        np.where(met, depth, np.inf).astype(np.float32),
        camera,
    )


poses = st.builds(
    camera_at,
    st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    st.floats(-0.2, 0.2),
    st.floats(-0.2, 0.2),
    st.floats(0.7, 1.1),
)
tilts = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.just(1.0))


@given(poses, poses, tilts)
@settings(max_examples=25, deadline=None)
def test_a_plane_differs_by_interpolation_alone(first, second, normal):
    difference = reprojected_difference(see_plane(first, normal), see_plane(second, normal))
    assert difference.valid > 0.05
    # Bilinear interpolation errs by at most h^2 / 8 times the second derivatives, 4 and 9; h is the size of a pixel there.
    assert np.nanmax(difference.map) < 2e-2
    assert difference.mean < 2e-4


def test_colour_that_is_linear_over_the_image_differs_by_rounding_alone():
    first, second = (see_plane(camera_at((x, 0.1 * x, 0)), color=linear) for x in (0.0, 0.3))
    difference = reprojected_difference(first, second)
    assert difference.valid > 0.8
    assert np.nanmax(difference.map) < 1e-10


def test_points_land_where_the_cameras_see_them():
    # At distance 4, a pixel is 8 tan(fov / 2) / 64 wide: the camera's move of 5 pixels is the image's.
    pixel = 8 * math.tan(FOV_Y / 2) / 64
    rng = np.random.default_rng(1)
    there = see_plane(camera_at((0, 0, 0)))
    here = replace(there, camera=camera_at((5 * pixel, -3 * pixel, 0)))
    noise = rng.random((64, 96, 3)).astype(np.float32)
    difference = reprojected_difference(here, replace(there, color=noise))
    expected = np.full((64, 96), np.nan)
    shifted = noise[3:, 5:]  # to the right and down in the other view
    expected[: 64 - 3, : 96 - 5] = ((here.color[: 64 - 3, : 96 - 5] - shifted) ** 2).mean(axis=-1)
    np.testing.assert_allclose(difference.map, expected, atol=2e-4)
    assert difference.valid == pytest.approx((64 - 3) * (96 - 5) / (64 * 96))


def test_a_known_offset_is_the_difference():
    view = see_plane(camera_at((0.2, 0, 0), yaw=0.1))
    offset = np.array([0.5, -1.0, 2.0])
    difference = reprojected_difference(view, replace(view, color=view.color + offset))
    assert difference.valid == 1.0
    assert difference.mean == pytest.approx((0.25 + 1 + 4) / 3, rel=1e-6)
    np.testing.assert_allclose(difference.map, difference.mean, rtol=1e-5)


def see_step(camera, size=(160, 40)):
    """A near wall where x < 0 at z = -2, bright, before a far one at z = -4, dim."""
    near = see_plane(camera, distance=-2.0, size=size, color=lambda p: np.full(p.shape, 1000.0))
    far = see_plane(camera, distance=-4.0, size=size, color=lambda p: np.full(p.shape, 1.0))
    origin, directions = rays(camera, size)
    hit = origin[0] + 2.0 * directions[..., 0] < 0
    return View(
        np.where(hit[..., None], near.color, far.color), np.where(hit, near.depth, far.depth).astype(np.float32), camera
    )


@pytest.mark.parametrize("eye", [0.5, -0.5])
def test_disoccluded_pixels_are_left_out(eye):
    view, other = see_step(camera_at((0, 0, 0))), see_step(camera_at((eye, 0, 0)))
    difference = reprojected_difference(view, other)
    width, height, up = 160, 40, math.tan(FOV_Y / 2)
    across = (2 * (np.arange(width) + 0.5) / width - 1) * up * width / height
    # Where the sight of each pixel's point from the other eye meets the near wall's plane, and its column over there.
    far = across > 0
    point = np.where(far, 4.0, 2.0) * across
    meets = np.where(far, 0.5 * (point + eye), point)
    column = ((point - eye) / np.where(far, 4.0, 2.0) / (up * width / height) + 1) * width / 2 - 0.5
    inside = (column >= 0) & (column <= width - 1)
    seen = inside & (~far | (meets >= 0))
    known = np.isfinite(difference.map)
    assert (known == known[0]).all()
    # Next to the wall's edge, where the interpolation meets both walls, a column is left out.
    assert not (known[0] & ~seen).any()
    assert np.count_nonzero(seen & ~known[0]) <= 2
    # Behind the wall's edge there are such points if the other eye is on the wall's side.
    assert (np.count_nonzero(inside & ~seen) > 3) == (eye < 0)
    # The far wall is 1 in both; a thousandth of the near one's brightness would be seen.
    assert np.nanmax(difference.map) < 1e-3 * 1000**2 * 0.01
    assert difference.valid == pytest.approx(np.count_nonzero(known) / known.size)


def test_swapped_eyes_differ_much_more():
    cameras = [camera_at((x, 0, 0)) for x in (-0.2, 0.2)]
    left, right = (see_plane(camera, (0.2, 0.1, 1.0)) for camera in cameras)
    right_way = reprojected_difference(left, right)
    swapped = reprojected_difference(replace(left, color=right.color), replace(right, color=left.color))
    assert swapped.mean > 1000 * right_way.mean
    assert swapped.mean > 0.01


def test_the_sky_takes_part():
    def see_sky(camera):
        _, directions = rays(camera, (96, 64))
        directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        return View(smooth(directions).astype(np.float32), np.full((64, 96), np.inf, np.float32), camera)

    here, turned = see_sky(camera_at((0, 0, 0))), see_sky(camera_at((50, 0, 9), yaw=0.2))
    difference = reprojected_difference(here, turned)
    assert 0.5 < difference.valid < 0.95
    assert difference.mean < 1e-6
    assert reprojected_difference(here, replace(turned, camera=camera_at((0, 0, 0), yaw=math.pi))).valid == 0.0
    # The same colours before a plane are another thing, which the sky's pixels do not show.
    assert reprojected_difference(here, replace(turned, depth=np.full((64, 96), 9, np.float32))).valid == 0.0


def test_a_steep_plane_is_not_taken_for_disocclusion():
    floor = [
        see_plane(camera_at((0, 0.5, -z)), normal=(0, 1, 0), distance=0.0, color=lambda p: p * 0) for z in (0.2, 0)
    ]
    difference = reprojected_difference(*floor)
    below = np.isfinite(floor[0].depth)
    assert np.count_nonzero(np.isfinite(difference.map[below])) > 0.8 * np.count_nonzero(below)


def test_what_is_behind_the_other_camera_is_left_out():
    view = see_plane(camera_at((0, 0, 0)))
    difference = reprojected_difference(view, replace(view, camera=camera_at((0, 0, -8), yaw=math.pi)))
    assert difference.valid == pytest.approx(1.0)  # the plane from its other side, mirrored
    difference = reprojected_difference(view, replace(view, camera=camera_at((0, 0, 0), yaw=math.pi)))
    assert difference.valid == 0.0 and math.isnan(difference.mean) and np.isnan(difference.map).all()


@given(poses)
@settings(max_examples=20, deadline=None)
def test_a_view_agrees_with_itself_everywhere(camera):
    view = see_plane(camera)
    difference = reprojected_difference(view, view)
    assert difference.valid == 1.0
    assert difference.mean < 1e-12


def test_what_cannot_be_reprojected_is_an_error_of_one_line():
    view = see_plane(camera_at((0, 0, 0)))
    smaller = see_plane(camera_at((0, 0, 0)), size=(48, 32))
    holed = view.depth.copy()
    holed[:2, :3] = np.nan, 0.0, -1.0
    for bad, message in (
        (replace(view, depth=holed), "6 depths are NaN or not positive"),
        (replace(view, depth=view.depth[1:]), r"depth is \(63, 96\)"),
        (replace(view, color=view.color * np.nan), "6,144 of 6,144 pixels that are NaN"),
        (smaller, "expected one size"),
    ):
        for pair in ((view, bad), (bad, view)):
            with pytest.raises(SettingError, match=message):
                reprojected_difference(*pair)
