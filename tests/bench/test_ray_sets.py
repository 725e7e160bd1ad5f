"""The rays that benchmarks trace: where they begin, where they go, and that they are always the same."""

import numpy as np
import pytest
from helpers import IDENTITY, icosphere, make_mesh
from render_helpers import BLACK, grey, lit, view

from clcache.bench.ray_sets import AGREE_T, RaySet, agreement, camera_rays, ray_sets
from clcache.bvh import Tracer
from clcache.scene.generators import plane
from clcache.scene.model import DirectionalLight, PointLight
from clcache.scene.transform import look_at

SIZE = (64, 48)
EYE = (0.0, 2.0, 5.0)
FLOOR = plane((40.0, 40.0))


def room(lights=(), emission=0.0, environment=BLACK, instances=None):
    """A ball above a floor, and a triangle above both that may shine."""
    lamp = make_mesh([[-1, 4, -1], [1, 4, -1], [0, 4, 1]], [[0, 1, 2]])
    lamp = type(lamp)(lamp.name, lamp.positions, lamp.triangles, lamp.material + np.uint32(1))
    meshes = icosphere(3), make_mesh(FLOOR.positions - [0, 1, 0], FLOOR.triangles), lamp
    materials = grey(0.5), grey(0.0, emission)
    options = {"lights": lights, "environment": environment, "instances": instances}
    return lit(*meshes, camera=view(EYE, (0, 0, 0)), materials=materials, **options)


def sets(scene, device, seed=1, **options):
    return ray_sets(scene, Tracer(scene, device).closest_hit, SIZE, seed, **options)


def lengths_of(vectors):
    return np.linalg.norm(vectors.astype(np.float64), axis=0)


def test_camera_rays_are_tiles_of_16():
    """Every ray goes through the centre of its pixel, 4 x 4 pixels after each other."""
    transform, (width, height) = look_at((1, 2, 3), (4, 5, -6)), (12, 8)
    camera = type(view(EYE, (0, 0, 0)))(transform, fov_y=1.0, near=0.5)
    rays = camera_rays(camera, (width, height))
    local = transform[:, :3].T @ rays.directions
    x = (local[0] / -local[2] / np.tan(0.5) * height / width + 1) / 2 * width - 0.5
    y = (1 + local[1] / local[2] / np.tan(0.5)) / 2 * height - 0.5
    expected = [(4 * tx + px, 4 * ty + py) for ty in (0, 1) for tx in (0, 1, 2) for py in range(4) for px in range(4)]
    np.testing.assert_allclose(np.stack([x, y], 1), expected, atol=1e-4)
    np.testing.assert_allclose(lengths_of(rays.directions), 1, atol=1e-6)
    on_near_plane = transform[:, :3].T @ (rays.origins - transform[:, 3:])
    np.testing.assert_allclose(on_near_plane[2], -0.5, atol=1e-5)
    np.testing.assert_allclose(np.cross(on_near_plane, local, axis=0), 0, atol=1e-5)
    assert np.isinf(rays.lengths).all()
    assert rays.coherent and not rays.any_hit


def test_bounces_leave_what_the_camera_sees(device):
    """They begin just above the ball or the floor, and are cosine-distributed: the mean cosine is 2/3."""
    primary, diffuse, _ = sets(room([PointLight((0, 3, 0), (1, 1, 1))]), device)
    assert 0.5 * primary.count < diffuse.count < primary.count
    on_floor = np.abs(diffuse.origins[1] + 1) < 0.01
    on_ball = np.abs(lengths_of(diffuse.origins) - 1) < 0.02
    assert (on_floor ^ on_ball).all()
    assert min(on_floor.mean(), on_ball.mean()) > 0.05
    assert (diffuse.origins[1, on_floor] > -1).all()
    up = diffuse.directions[1, on_floor]
    assert (up >= 0).all()
    assert abs(up.mean() - 2 / 3) < 0.03
    assert abs((up**2).mean() - 1 / 2) < 0.03
    assert np.abs(diffuse.directions[::2, on_floor].mean(axis=1)).max() < 0.05
    outward = (diffuse.directions * diffuse.origins)[:, on_ball].sum(axis=0)
    assert abs(outward.mean() - 2 / 3) < 0.05
    np.testing.assert_allclose(lengths_of(diffuse.directions), 1, atol=1e-6)


def test_normals_of_placed_meshes(device):
    """A sheared instance: bounces from it leave on the side that the camera sees."""
    sheared = np.array([[2.0, 1.0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1.0, 0]])
    apart = IDENTITY + np.array([[0, 0, 0, 0], [0, 0, 0, -50.0], [0, 0, 0, 0]])
    scene = room([PointLight((0, 3, 0), (1, 1, 1))], instances=[(0, sheared), (0, apart)])
    _, diffuse, _ = sets(scene, device)
    local = np.linalg.solve(sheared[:, :3], diffuse.origins)
    np.testing.assert_allclose(lengths_of(local), 1, atol=0.03)
    normal = np.linalg.solve(sheared[:, :3].T, local)
    cosine = (normal * diffuse.directions).sum(axis=0) / lengths_of(normal)
    assert cosine.min() > -0.1
    assert abs(cosine.mean() - 2 / 3) < 0.05


def test_shadow_rays_end_just_before_a_point_light(device):
    _, diffuse, shadow = sets(room([PointLight((0, 3, 0), (1, 1, 1))]), device)
    assert 0 < shadow.count < diffuse.count
    ends = shadow.origins + shadow.directions * shadow.lengths / 0.999
    np.testing.assert_allclose(ends, np.broadcast_to([[0], [3], [0]], ends.shape), atol=1e-4)
    assert shadow.any_hit


def test_shadow_rays_to_a_lamp(device):
    """Their ends are spread over the triangle, as its area is."""
    _, _, shadow = sets(room(emission=1.0), device)
    x, y, z = shadow.origins + shadow.directions * shadow.lengths / 0.999
    np.testing.assert_allclose(y, 4, atol=1e-3)
    assert (np.abs(x) <= (1 - z) / 2 + 1e-3).all()
    assert abs(z.mean() + 1 / 3) < 0.05
    assert abs(x.mean()) < 0.05


def test_shadow_rays_to_the_sun(device):
    down = np.array([1, -2, 0]) / np.sqrt(5)
    scene = room([DirectionalLight(tuple(down), (1, 1, 1))])
    *_, shadow = sets(scene, device)
    np.testing.assert_allclose(shadow.directions, np.broadcast_to(-down[:, None], shadow.directions.shape), atol=1e-6)
    assert np.isinf(shadow.lengths).all()
    *_, spread = sets(scene, device, light_spread=0.01)
    angle = np.arccos(np.clip(-down @ spread.directions, -1, 1))
    assert abs(np.sqrt((angle**2).mean() / 2) - 0.01) < 0.001  # two of the three components turn the direction


def test_shadow_rays_to_the_sky(device):
    _, diffuse, shadow = sets(room(environment=(1.0, 1.0, 1.0)), device)
    assert shadow.count == diffuse.count
    assert np.isinf(shadow.lengths).all()


def test_nothing_to_see(device):
    scene = lit(icosphere(1), camera=view((0, 0, 5), (0, 0, 10)), lights=[PointLight((0, 3, 0), (1, 1, 1))])
    assert [rays.count for rays in sets(scene, device)] == [SIZE[0] * SIZE[1], 0, 0]


def test_the_seed_decides(device):
    scene = room([PointLight((0, 3, 0), (1, 1, 1))])
    one, again, other = (sets(scene, device, seed) for seed in (1, 1, 2))
    for a, b in zip(one, again, strict=True):
        for name in ("origins", "directions", "lengths"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_array_equal(one[0].directions, other[0].directions)
    assert (one[1].directions != other[1].directions).any(axis=0).mean() > 0.9


@pytest.fixture
def rays():
    zeros = np.zeros((3, 8), np.float32)
    return RaySet("primary", zeros, zeros, np.full(8, np.inf, np.float32), any_hit=False, coherent=True)


def test_agreement_of_hits(rays):
    t = np.array([1, 2, 3, 4, np.inf, np.inf, 7, 8], np.float32)
    assert agreement(rays, t, t * (1 + 0.5 * AGREE_T)) == 1
    assert agreement(rays, t, t * np.array([1, 1, 1, 1, 1, 1, 1, 1 + 3 * AGREE_T])) == 7 / 8
    assert agreement(rays, t, np.array([np.inf, 2, 3, 4, 5, np.inf, 7, 8])) == 6 / 8


def test_agreement_of_occlusion(rays):
    shadow = RaySet("shadow", rays.origins, rays.directions, rays.lengths, any_hit=True, coherent=True)
    ours = np.array([1, 1, 1, 1, 0, 0, 0, 0], np.uint8)
    assert agreement(shadow, ours, ours == 1) == 1
    assert agreement(shadow, ours, np.array([1, 1, 1, 0, 0, 0, 0, 1], bool)) == 6 / 8
