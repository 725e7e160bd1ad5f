"""Rays that leave a surface neither meet it again (acne) nor slip through it or its neighbours (leaks), at any scale."""

import numpy as np
import pytest
from helpers import IDENTITY, blob, cube, icosphere, make_mesh, moved
from render_helpers import MODELLED, grey, image, lit, render, view, z_of_mean

from clcache.scene.generators import grid
from clcache.scene.model import DirectionalLight, PointLight
from clcache.scene.transform import rotation_matrix

SCALES = [1e-6, 1e-3, 1.0, 1e3, 1e6]
SIZE = (64, 64)


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


def direct_light(mesh, placement, eye, target, towards_light, **options):
    """Direct light of irradiance pi on an albedo of 1, and the cosine that it must equal; both where something is hit."""
    light = DirectionalLight(tuple(-unit(towards_light)), (np.pi,) * 3)
    camera = view(eye, target, 30, up=(0.2, 1, 0.3))
    scene = lit(mesh, camera=camera, lights=[light], instances=[(0, placement)])
    frame = render(scene, SIZE, bounces=0, aovs=("N", "Z"), **options)
    hit = np.isfinite(frame.aov("Z", "mono"))
    return frame.color["mono"][hit][:, 0], np.maximum(frame.aov("N", "mono")[hit] @ unit(towards_light), 0)


def check_every_lit_pixel(radiance, cosine):
    """A convex body shades itself only by its cosine: not one pixel may be darker, nor lit from behind."""
    assert (cosine > 0).sum() > 300
    np.testing.assert_allclose(radiance, cosine, rtol=1e-5, atol=3e-6)


@pytest.mark.parametrize("scale", SCALES)
def test_sphere_by_vertices(scale):
    mesh = moved(icosphere(4), scale)
    eye = np.array([3, 2, 4]) * scale
    check_every_lit_pixel(*direct_light(mesh, IDENTITY, eye, (0, 0, 0), (1, 0.3, -0.2)))


@pytest.mark.parametrize("scale", SCALES)
def test_sphere_by_transform(scale):
    """Turned, stretched, mirrored and moved away by ten times its size."""
    rng = np.random.default_rng(int(np.log10(scale)) + 10)
    matrix = (
        scale * rotation_matrix(rng.normal(size=4)) @ np.diag([1.5, -0.5, 0.8]) @ rotation_matrix(rng.normal(size=4))
    )
    place = scale * rng.normal(size=3) * 10
    eye = place + np.array([3, 2, 4]) * scale
    check_every_lit_pixel(*direct_light(icosphere(4), np.column_stack([matrix, place]), eye, place, [3, -1, 2]))


@pytest.mark.parametrize("scale", [1.0, 1e3])
def test_sphere_a_million_metres_away(scale):
    """The transform moves it, so that its vertices keep their precision."""
    place = np.array([1e6, -1e6, 1e6])
    matrix = scale * rotation_matrix([0.1, 0.2, -0.4, 0.7])
    eye = place + np.array([3, 2, 4]) * scale
    check_every_lit_pixel(*direct_light(icosphere(3), np.column_stack([matrix, place]), eye, place, (1, 0.3, -0.2)))


@pytest.mark.parametrize("sine", [1.0, 0.1, 1e-3, 1e-5])
@pytest.mark.parametrize("scale", SCALES)
def test_tilted_plane_under_grazing_light(scale, sine):
    """Light from above the plane at any elevation reaches all of it; seen from both near and far."""
    turn = rotation_matrix([0.3, -0.2, 0.5, 0.7])
    square = grid((2, 2), (3, 2))
    mesh = make_mesh(square.positions @ turn.T * scale, square.triangles)
    normal, along = turn[:, 1], turn[:, 0]
    eye = scale * (3 * normal + 2 * along)
    radiance, cosine = direct_light(mesh, IDENTITY, eye, (0, 0, 0), sine * normal + np.sqrt(1 - sine**2) * along)
    check_every_lit_pixel(radiance, cosine)
    np.testing.assert_allclose(cosine, sine, atol=1e-6)


@pytest.mark.parametrize("distance", [1e2, 1e4, 1e6])
def test_plane_whose_vertices_lie_far_from_the_origin(distance):
    square = grid((2e3, 2e3), (3, 2))
    turn = rotation_matrix([0.3, -0.2, 0.5, 0.7])
    place = distance * unit([1, 2, -1])
    mesh = make_mesh(square.positions @ turn.T + place, square.triangles)
    light = 0.01 * turn[:, 1] + turn[:, 0]
    check_every_lit_pixel(*direct_light(mesh, IDENTITY, place + 3e3 * turn[:, 1], place, light))


def outside_lights(scale, place):
    """From all sides, a point light close to a wall, and the sky."""
    directions = [unit(v) for v in ([1, 1, 1], [-1, 0.2, 0.1], [0.3, -1, 0.2], [0, 0, 1])]
    near = tuple(np.asarray(place) + np.array([1.5, 1.7, 0.2]) * scale)
    return [DirectionalLight(tuple(-d), (1e6,) * 3) for d in directions] + [PointLight(near, (1e6 * scale**2,) * 3)]


def room(mesh, scale, place, by_vertices):
    transform = IDENTITY if by_vertices else np.column_stack([scale * np.eye(3), place])
    mesh = moved(mesh, scale, place) if by_vertices else mesh
    camera = view(place, np.asarray(place) + [0.1 * scale, 0.2 * scale, -scale], 100)
    lights = outside_lights(scale, place)
    return lit(mesh, camera=camera, lights=lights, environment=(1e6,) * 3, instances=[(0, transform)])


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("by_vertices", [True, False], ids=["vertices", "transform"])
def test_closed_room_is_black_inside(scale, by_vertices):
    place = np.array([0.3, -0.2, 0.1]) * scale
    for mesh in (cube(), blob(3)):
        color = image(room(mesh, scale, place, by_vertices), SIZE, 8, settings={"pathtrace.roulette": 64})
        assert (color == 0).all()


@pytest.mark.parametrize(("scale", "distance"), [(1.0, 1e2), (1.0, 1e4), (1e3, 1e6)])
def test_closed_room_far_away(scale, distance):
    """So far from the origin, a point near an edge may be rounded to beyond the other wall. No more rays leak than hit that
    rim: 2^-23 of the distance along the four edges of each wall."""
    color = image(room(cube(), scale, distance * unit([1, -1, 0.5]), False), SIZE, 8, bounces=0)
    rays = 2 * SIZE[0] * SIZE[1] * 8
    assert (color > 0).any(axis=2).sum() <= rays * 2 * 2.0**-23 * distance / scale


def test_the_room_would_not_be_dark_with_a_hole():
    """One triangle less: the same lights are seen."""
    scene = room(cube(), 1.0, np.zeros(3), True)
    mesh = scene.meshes[0]
    open_mesh = make_mesh(mesh.positions, mesh.triangles[1:])
    leaky = lit(open_mesh, camera=scene.camera, lights=scene.lights, environment=scene.environment)
    assert image(leaky, SIZE).max() > 1e3


@pytest.mark.parametrize("scale", SCALES)
def test_furnace_at_every_scale(scale):
    """1 + a + a^2: no ray of any bounce is lost or stopped on its way. What lies outside would show a single one that left."""
    mesh = moved(icosphere(2), scale, np.array([5, 3, -4]) * scale)
    centre = np.array([5, 3, -4]) * scale
    camera = view(centre, centre + np.array([0.2, 0.3, -1]) * scale, 90)
    scene = lit(mesh, camera=camera, materials=[grey(0.5, 1.0)], environment=(1e7,) * 3)
    frame = render(scene, SIZE, 4, bounces=1, settings={"pathtrace.roulette": 64}, sampler=MODELLED)
    color, rays = frame.color["mono"], frame.stats["eyes"]["mono"]["rays"]
    assert rays["secondary"] == 2 * rays["primary"]
    np.testing.assert_allclose(color.mean(), 1.75, rtol=5e-3)
    assert (z_of_mean(color, 1.75) < 3.3).all()
