"""The path tracer at the ends of its ranges: sizes, albedos, lights, angles, seeds, frame numbers, distances, degenerate shapes."""

import numpy as np
import pytest
from helpers import make_mesh
from hypothesis import given, settings
from hypothesis import strategies as st
from render_helpers import (
    MODELLED,
    WHITE,
    ball,
    camera_rays,
    everything,
    floor,
    image,
    lit,
    on_floor,
    render,
    shape_mesh,
    view,
)

from clcache.scene.generators import hairball
from clcache.scene.model import DirectionalLight, Mesh, PointLight

ALL = ("albedo", "N", "Z")
ABOVE = view((0, 3, 0.1), (0, 0, 0))


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (5, 3), (1, 97), (97, 1), (13, 11), (64, 1), (65, 1)])
def test_image_sizes(size):
    """Every pixel of an image of any size is that of its own camera rays."""
    scene = lit(floor(300), camera=ABOVE, lights=[DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)])
    frame = render(scene, size, aovs=ALL, sampler=MODELLED)
    assert frame.color["mono"].shape == (*size[::-1], 3)
    origin, directions = camera_rays(ABOVE, size)
    down = directions[..., 1] < -0.1
    depth = (on_floor(ABOVE, size) - origin) @ -ABOVE.transform[:, 2]
    np.testing.assert_allclose(frame.aov("Z", "mono")[down], depth[down], rtol=1e-4)
    np.testing.assert_allclose(frame.color["mono"][down], 1, rtol=1e-5)


@settings(max_examples=6, deadline=None)
@given(st.integers(1, 70), st.integers(1, 70), st.sampled_from([1, 64, 100]))
def test_any_size_and_work_group(width, height, local_size):
    world = lit(ball(), camera=view((0, 0, 3), (0, 0, 0)), environment=WHITE)
    frame = render(world, (width, height), aovs=ALL, settings={"device.local_size": local_size})
    assert np.array_equal(np.isfinite(frame.aov("Z", "mono")), frame.aov("albedo", "mono")[..., 0] == 1)
    np.testing.assert_allclose(frame.color["mono"], 1, atol=1e-6)


@pytest.mark.parametrize("degrees", [0.01, 1, 120, 179])
def test_fields_of_view(degrees):
    camera = view((0, 3, 0.1), (0, 0, 0), degrees)
    depth = render(lit(floor(1e3), camera=camera), (16, 16), aovs=("Z",), sampler=MODELLED).aov("Z", "mono")
    origin, directions = camera_rays(camera, (16, 16))
    down = directions[..., 1] < -0.05
    expected = (on_floor(camera, (16, 16)) - origin) @ -camera.transform[:, 2]
    np.testing.assert_allclose(depth[down], expected[down], rtol=1e-3)


def test_near_plane_cuts():
    """Half of the ball stands before the near plane: its far half is seen, from within."""
    for near, nearest in ((0.0, 2.0), (2.5, 2.5), (3.0, 3.0), (3.9, 3.9)):
        camera = view((0, 0, 3), (0, 0, 0), 30, near=near)
        depth = render(lit(ball(1, 4), camera=camera), (64, 64), 4, aovs=("Z",)).aov("Z", "mono")
        assert depth.min() >= nearest - 1e-5
        centre = 2.0 if near < 2 else 4.0
        assert depth[32, 32] == pytest.approx(centre, abs=5e-3)
    beyond = view((0, 0, 3), (0, 0, 0), 30, near=4.1)
    assert np.isinf(render(lit(ball(1, 4), camera=beyond), (16, 16), aovs=("Z",)).aov("Z", "mono")).all()


@pytest.mark.parametrize("distance", [1e-6, 1e-3, 1.0, 1e4])
def test_point_light_at_any_distance(distance):
    """Light scaled with its distance gives the same where it stands above the surface; far off, almost nothing."""
    light = PointLight((0, distance, 0), (distance**2,) * 3)
    camera = view((0, 3 * distance, 0.1 * distance), (0, 0, 0), 0.01)
    color = image(lit(floor(4 * distance), camera=camera, lights=[light]), (4, 4), bounces=0)
    np.testing.assert_allclose(color, 1 / np.pi, rtol=1e-3)


@pytest.mark.parametrize("seed", [0, 1, 2**32, 2**63, 2**64 - 1])
@pytest.mark.parametrize("frame", [0, 2**31, 2**32 - 1])
def test_seeds_and_frame_numbers(seed, frame):
    """The furnace's answer, and noise of its own for each of them (compared with the neighbours of the same word)."""
    sky = lit(ball(1, 1), camera=view((0, 0, 3), (0, 0, 0), 60), environment=(0.5, 1.0, 2.0))
    rendered = render(sky, (8, 8), seed=seed, frame=frame)
    assert rendered.number == frame
    np.testing.assert_allclose(rendered.color["mono"], np.broadcast_to(np.float32([0.5, 1, 2]), (8, 8, 3)), rtol=1e-6)


def test_seeds_and_frames_that_wrap_are_not_each_other():
    depths = [
        render(lit(floor(), camera=ABOVE), (4, 4), seed=s, frame=f, aovs=("Z",)).aov("Z", "mono").tobytes()
        for s, f in [(0, 0), (2**32, 0), (2**64 - 1, 0), (0, 2**32 - 1), (0, 2**32), (1, 0), (0, 1), (2**64 - 1, 1)]
    ]
    assert len(set(depths)) == len(depths)


def test_many_lights_of_which_none_is_left_out():
    """Over many samples, every one of 100 lights is chosen: the mean is that of all, 4.5 standard deviations about it."""
    count, spp = 100, 256
    lights = [DirectionalLight((0.0, -1.0, 0.0), (np.pi * (k + 1),) * 3) for k in range(count)]
    color = image(lit(floor(), camera=ABOVE, lights=lights), (16, 16), spp, bounces=0)[..., 0].astype(float)
    powers = np.arange(1, count + 1)
    deviation = count * powers.std() / np.sqrt(spp * 256)
    assert abs(color.mean() - powers.sum()) < 4.5 * deviation


def test_thin_and_crossing_triangles_stay_finite():
    """A ball of ribbons, 1 mm wide and much longer than wide, that run through each other."""
    mesh = shape_mesh(hairball(4000, 8, 1.0, 1e-3, 3))
    sun = DirectionalLight((0.6, -0.8, 0.0), (1.0, 1.0, 1.0))
    frame = render(lit(mesh, camera=view((0, 0, 3), (0, 0, 0)), environment=WHITE, lights=[sun]), (48, 48), 4, aovs=ALL)
    color, hit = frame.color["mono"], np.isfinite(frame.aov("Z", "mono"))
    assert hit.mean() > 0.1
    assert np.isfinite(color).all()
    assert color.max() <= 1 + 3 / np.pi + 1e-5
    length = np.linalg.norm(frame.aov("N", "mono")[hit], axis=1)
    np.testing.assert_allclose(length, 1, atol=1e-5)


@pytest.mark.parametrize("height", [1e-3, 1e-5, 3e-7])
def test_needles(height):
    """Triangles 1 m long and next to nothing wide: one lies in every pixel's way, and each is lit as its plane is."""
    count = 64
    base = np.arange(count)[:, None] * [[0, 0, height]]
    corners = base[:, None] + np.array([[-0.5, 0, 0], [0.5, 0, 0.0], [0.5, 0, height]])
    mesh = make_mesh(corners.reshape(-1, 3), np.arange(3 * count))
    middle = np.array([0.3, 0, 0.5 * count * height])
    camera = view(middle + [0, 0.1 * count * height, 0], middle, 20, up=(1, 0, 0))
    sun = DirectionalLight((0.0, -1.0, 0.0), (np.pi,) * 3)
    frame = render(lit(mesh, camera=camera, lights=[sun]), (32, 32), bounces=0, aovs=ALL)
    hit = np.isfinite(frame.aov("Z", "mono"))
    assert hit.mean() > 0.3
    np.testing.assert_allclose(frame.color["mono"][hit], 1, rtol=1e-3)
    np.testing.assert_allclose(np.abs(frame.aov("N", "mono")[hit][:, 1]), 1, rtol=1e-3)


def test_vertex_normals_of_zero_shade_flat():
    """A triangle of which one normal is zero is flat, whatever the others are (see Mesh)."""
    shape = floor()
    normals = np.tile(np.float32([[0.6, 0.8, 0]]), (4, 1))
    normals[shape.triangles[0, 0]] = 0
    mesh = Mesh("m", shape.positions, shape.triangles, shape.material, normals)
    frame = render(lit(mesh, camera=ABOVE), (16, 16), aovs=("N",))
    assert np.isin(shape.triangles, shape.triangles[0, 0]).any(axis=1).all()
    np.testing.assert_array_equal(frame.aov("N", "mono"), np.broadcast_to(np.float32([0, 1, 0]), (16, 16, 3)))


def test_an_instance_between_others_of_another_scale():
    """A grain, a ball and a mountain in one picture, each lit by its cosine."""
    sun = np.array([0.0, 0.6, 0.8])
    sizes, places = (1e-3, 1.0, 1e4), ((0, 0, 2.99), (0.8, 0, 0), (-1.2e4, 0, -3e4))
    instances = [(0, np.column_stack([s * np.eye(3), p])) for s, p in zip(sizes, places, strict=True)]
    world = lit(
        ball(1, 4),
        camera=view((0, 0, 3), (0, 0, 0), 50),
        lights=[DirectionalLight(tuple(-sun), (np.pi,) * 3)],
        instances=instances,
    )
    frame = render(world, (96, 96), bounces=0, aovs=("N", "Z"))
    depth = frame.aov("Z", "mono")
    for low, high in ((0, 0.1), (1, 10), (1e3, 1e5)):
        seen = (depth > low) & (depth < high)
        assert seen.sum() > 20
        cosine = frame.aov("N", "mono")[seen] @ sun
        lit_up = cosine > 1e-5
        away = np.abs(frame.color["mono"][seen][lit_up][:, 0] - cosine[lit_up]) > 1e-5
        assert away.mean() < (0.02 if high == 1e5 else 1e-9)


def test_everything_is_finite():
    frame = render(everything(), (33, 21), 64, bounces=8, stereo=True, aovs=ALL)
    for eye in ("left", "right"):
        assert np.isfinite(frame.color[eye]).all()
        assert frame.color[eye].min() >= 0
        assert not np.isnan(frame.aov("Z", eye)).any()
