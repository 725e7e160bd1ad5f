"""Albedo, normal and depth of the first hit against closed forms, sample for sample."""

import numpy as np
import pytest
from helpers import IDENTITY
from render_helpers import MODELLED, ball, camera_rays, everything, floor, grey, lit, on_floor, render, view

from clcache.scene.model import Material

SIZE = (40, 30)
CAMERA = view((0.5, 2, 3), (0, 0, 0), 50)
ALL = ("albedo", "N", "Z")


def depth_of(camera, points):
    """Along the viewing axis."""
    return (points - camera.transform[:, 3]) @ -camera.transform[:, 2]


def test_plane():
    scene = lit(floor(), camera=CAMERA, materials=[Material("m", (0.8, 0.5, 0.2))])
    frame = render(scene, SIZE, aovs=ALL, sampler=MODELLED)
    expected = depth_of(CAMERA, on_floor(CAMERA, SIZE))
    np.testing.assert_allclose(frame.aov("Z", "mono"), expected, rtol=1e-5)
    np.testing.assert_array_equal(frame.aov("N", "mono"), np.broadcast_to(np.float32([0, 1, 0]), (*SIZE[::-1], 3)))
    np.testing.assert_array_equal(
        frame.aov("albedo", "mono"), np.broadcast_to(np.float32([0.8, 0.5, 0.2]), (*SIZE[::-1], 3))
    )


def test_depth_is_measured_from_the_eye_whatever_the_near_plane():
    near = view((0.5, 2, 3), (0, 0, 0), 50, near=1.0)
    for camera in (CAMERA, near):
        depth = render(lit(floor(), camera=camera), SIZE, aovs=("Z",), sampler=MODELLED).aov("Z", "mono")
        np.testing.assert_allclose(depth, depth_of(CAMERA, on_floor(CAMERA, SIZE)), rtol=1e-5)


def test_depth_of_several_samples_is_that_of_the_nearest():
    depth = render(lit(floor(), camera=CAMERA), SIZE, 5, aovs=("Z",), sampler=MODELLED).aov("Z", "mono")
    expected = [depth_of(CAMERA, on_floor(CAMERA, SIZE, sample=s)) for s in range(5)]
    np.testing.assert_allclose(depth, np.min(expected, axis=0), rtol=1e-5)


def sphere_hits(camera, centre, radius):
    """(H, W): distance along each camera ray to the sphere, infinite where it misses; and what misses by how much."""
    origin, directions = camera_rays(camera, SIZE)
    b = directions @ (np.asarray(centre) - origin)
    beside = np.sum((np.asarray(centre) - origin) ** 2) - b**2
    with np.errstate(invalid="ignore"):
        return np.where(beside < radius**2, b - np.sqrt(radius**2 - beside), np.inf), np.sqrt(beside)


@pytest.mark.parametrize("smooth", [True, False])
def test_sphere(smooth):
    """A sphere of 20,480 triangles lies within 0.05 % of the round one, its corners' normals are exact."""
    frame = render(lit(ball(1, 5, smooth=smooth), camera=CAMERA), SIZE, aovs=ALL, sampler=MODELLED)
    distance, beside = sphere_hits(CAMERA, (0, 0, 0), 1.0)
    hit = np.isfinite(distance)
    sure = np.abs(beside - 1) > 2e-3
    np.testing.assert_array_equal(np.isfinite(frame.aov("Z", "mono"))[sure], hit[sure])
    origin, directions = camera_rays(CAMERA, SIZE)
    inner = beside < 0.95
    points = origin + distance[inner][:, None] * directions[inner]
    np.testing.assert_allclose(frame.aov("Z", "mono")[inner], depth_of(CAMERA, points), atol=2e-3)
    np.testing.assert_allclose(frame.aov("N", "mono")[inner], points, atol=5e-3 if smooth else 0.05)
    length = np.linalg.norm(frame.aov("N", "mono"), axis=-1)
    np.testing.assert_allclose(length[hit & sure], 1, atol=1e-6)


def test_smooth_normals_are_smoother_than_triangles():
    deviations = []
    for smooth in (True, False):
        scene = lit(ball(1, 2, smooth=smooth), camera=CAMERA)
        normals = render(scene, SIZE, aovs=("N",), sampler=MODELLED).aov("N", "mono")
        distance, beside = sphere_hits(CAMERA, (0, 0, 0), 1.0)
        origin, directions = camera_rays(CAMERA, SIZE)
        inner = beside < 0.9
        points = origin + distance[inner][:, None] * directions[inner]
        deviations.append(np.abs(normals[inner] - points).max())
    assert deviations[0] < 0.25 * deviations[1]


def test_background():
    frame = render(lit(ball(), camera=view((0, 0, 3), (0, 0, 6)), environment=(1.0, 1.0, 1.0)), SIZE, 2, aovs=ALL)
    assert (frame.aov("Z", "mono") == np.inf).all()
    assert (frame.aov("N", "mono") == 0).all()
    assert (frame.aov("albedo", "mono") == 0).all()


def test_normals_face_the_camera_on_both_sides():
    below = render(lit(floor(), camera=view((0, -2, 3), (0, 0, 0))), SIZE, aovs=("N",))
    np.testing.assert_array_equal(below.aov("N", "mono"), np.broadcast_to(np.float32([0, -1, 0]), (*SIZE[::-1], 3)))


def test_a_mesh_without_normals_beside_one_with_them_is_flat():
    place = np.column_stack([np.eye(3), [0, 50, 0]])
    scene = lit(floor(), ball(1, 1, smooth=True), camera=CAMERA, instances=[(0, IDENTITY), (1, place)])
    normals = render(scene, SIZE, aovs=("N",)).aov("N", "mono")
    np.testing.assert_array_equal(normals, np.broadcast_to(np.float32([0, 1, 0]), normals.shape))


def test_albedo_is_a_mean_that_counts_background_as_black():
    scene = lit(ball(1, 4), camera=view((0, 0, 4), (0, 0, 0), 40), materials=[grey(0.5)])
    albedo = render(scene, (1, 1), 1024, aovs=("albedo",), bounces=0).aov("albedo", "mono")[0, 0, 0]
    # The ball's outline: a circle of radius tan(asin(1/4)) on the plane at distance 1, a part of the square of the pixel.
    part = np.pi * np.tan(np.arcsin(1 / 4)) ** 2 / (2 * np.tan(np.radians(20))) ** 2
    assert albedo == pytest.approx(0.5 * part, abs=4.5 * 0.5 * np.sqrt(part * (1 - part) / 1024) + 1e-3)


def test_asking_changes_no_colour():
    scene = everything()
    without, with_all = render(scene, SIZE, 2), render(scene, SIZE, 2, aovs=ALL)
    np.testing.assert_array_equal(without.color["mono"], with_all.color["mono"])


@pytest.mark.parametrize("asked", [(), ("N",), ("Z", "albedo")])
def test_only_passes_that_are_asked_for_run(asked):
    passes = render(everything(), SIZE, aovs=asked).stats["eyes"]["mono"]["passes"]
    for name in ("albedo", "N", "Z"):
        assert (f"aov_{name}" in passes) == (name in asked)
    assert ("first_hits" in passes) == bool({"albedo", "N"} & {*asked})
    assert {"order", "generate", "trace", "shade", "finish", "color"} <= passes.keys()


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (5, 3), (4, 4), (17, 2), (1, 13)])
def test_every_pixel_is_its_own_at_any_size(size):
    """Paths go in blocks of pixels, which few sizes are made of: depths of a floor, pixel by pixel."""
    camera = view((0, 2, 3), (0, 0, 0), 30)
    frame = render(lit(floor(), camera=camera), size, aovs=("Z",), sampler=MODELLED)
    away = on_floor(camera, size) - camera.transform[:, 3]
    np.testing.assert_allclose(frame.aov("Z", "mono"), away @ -camera.transform[:, 2], rtol=1e-5)
    assert frame.stats["eyes"]["mono"]["rays"]["primary"] == size[0] * size[1]
