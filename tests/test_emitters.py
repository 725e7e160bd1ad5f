"""What direct light is sampled from: chances by power, and directions of the sky by its light."""

from dataclasses import replace

import numpy as np
import pytest
from kernel_source import build
from render_helpers import BLACK, ball, floor, grey, lit, render, shape_mesh, view
from scipy import stats

from clcache.layout import STRUCTS
from clcache.scene.emitters import Emitters, picture_density, picture_shares
from clcache.scene.generators import grid
from clcache.scene.geometry import Geometry
from clcache.scene.model import DirectionalLight, Environment, Material, PointLight, SpotLight, Texture, TextureUse

SOURCE = """
#include "scene/environment.cl"

__kernel void search(
    __global const float *shares,  // (count)
    __global const float *u,       // (n)
    __global uint *index,          // (n)
    uint n,
    uint count)
{
    uint i = get_global_id(0);
    if (i < n) index[i] = search_shares(shares, count, 20, u[i]);
}

__kernel void sample(
    __global const float *sky,          // (size, 3)
    __global const float *sky_rows,     // (height)
    __global const float *sky_columns,  // (size)
    __global const float *sky_density,  // (size)
    __global const float *sky_edges,    // (edges)
    __global const float *random,       // (2, n)
    __global float *direction,          // (3, n)
    __global float *density,            // (n)
    __global float *picture,            // (n)
    Environment environment,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Sky far = { environment, sky, sky_rows, sky_columns, sky_density, sky_edges };
    float found, u;
    store_planes(direction, n, i, sample_sky(&far, random[i], random[n + i], &found, &u));
    picture[i] = u - picture_u(load_vec3(direction, n, i));
    density[i] = found;
}

__kernel void look(
    __global const float *sky,          // (size, 3)
    __global const float *sky_rows,     // (height)
    __global const float *sky_columns,  // (size)
    __global const float *sky_density,  // (size)
    __global const float *sky_edges,    // (edges)
    __global const float *direction,    // (3, n)
    __global float *radiance,           // (3, n)
    __global float *density,            // (n)
    Environment environment,
    uint n)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    Sky far = { environment, sky, sky_rows, sky_columns, sky_density, sky_edges };
    Vec3 towards = load_vec3(direction, n, i);
    store_planes(radiance, n, i, sky_radiance(&far, towards));
    density[i] = sky_density_of(&far, towards);
}
"""
CAMERA = view((0, 2, 5), (0, 0, 0))


@pytest.fixture(scope="module")
def program(device, tmp_path_factory):
    """The device's functions, each called by a kernel."""
    return build(
        device, SOURCE, tmp_path_factory.mktemp("cl"), HAS_SKY_PICTURE=True, SKY_ROW_STEPS=5, SKY_COLUMN_STEPS=6
    )


class Sky:
    """A picture on the device."""

    def __init__(self, device, program, picture):
        rows, columns = picture_shares(picture)
        self.device, self.program = device, program
        edges = np.cos(np.pi * np.arange(len(rows) + 1) / len(rows))
        density = picture_density(rows, columns)
        arrays = (picture.reshape(-1, 3), rows, columns.reshape(-1), density.reshape(-1), edges)
        self.arrays = [device.upload(a.astype(np.float32)) for a in arrays]
        record = np.zeros((), STRUCTS["Environment"])
        record["height"], record["width"] = picture.shape[:2]
        self.record = record[()]

    def sample(self, random):
        """Directions (n, 3) and densities, float64. random: (n, 2)."""
        n = len(random)
        out = [self.device.empty(shape, np.float32) for shape in ((3, n), n, n)]
        random = self.device.upload(random.T.astype(np.float32))
        self.program["sample"](*self.arrays, random, *out, self.record, n, count=n)
        direction, density, off = (a.get().astype(np.float64) for a in out)
        beside = (np.abs(off - np.round(off)) < 2e-6) | (np.hypot(direction[0], direction[2]) < 1e-2)
        assert beside.all()  # the picture's u that goes with a direction is that of looking there, but at the poles
        return direction.T, density

    def look(self, directions):
        """Radiance (n, 3) and densities of these directions."""
        n = len(directions)
        out = [self.device.empty((3, n), np.float32), self.device.empty(n, np.float32)]
        towards = self.device.upload(directions.T.astype(np.float32))
        self.program["look"](*self.arrays, towards, *out, self.record, n, count=n)
        radiance, density = (a.get().astype(np.float64) for a in out)
        return radiance.T, density


def pixel_directions(height, width, fine):
    """Midpoints of fine x fine parts of each pixel: directions (m, 3), solid angles, pixel of each."""
    theta = np.pi * (np.arange(height * fine) + 0.5) / (height * fine)
    around = 2 * np.pi * ((np.arange(width * fine) + 0.5) / (width * fine) - 0.5)
    theta, around = (a.ravel() for a in np.meshgrid(theta, around, indexing="ij"))
    sine = np.sin(theta)
    pixel = (theta / np.pi * height).astype(int) * width + ((around / (2 * np.pi) + 0.5) * width).astype(int)
    directions = np.column_stack([sine * np.sin(around), np.cos(theta), -sine * np.cos(around)])
    return directions, sine * (np.pi / (height * fine)) * (2 * np.pi / (width * fine)), pixel


def random_sky(height, width, seed=0):
    """Radiance over several magnitudes, a black row and black pixels."""
    rng = np.random.default_rng(seed)
    picture = (10.0 ** rng.uniform(-2, 1, (height, width, 3))).astype(np.float32)
    picture[height // 2] = 0
    picture[rng.random((height, width)) < 0.2] = 0
    return picture


def sun(height, width, row, column):
    """A single bright pixel."""
    picture = np.zeros((height, width, 3), np.float32)
    picture[row, column] = 1e5
    return picture


SKIES = {
    "random": random_sky(8, 16),
    "odd": random_sky(5, 3, 1),
    "row": random_sky(1, 7, 2) + 0.1,
    "column": random_sky(7, 1, 3) + 0.1,
    "sun": sun(16, 32, 5, 31),
    "sun at the pole": sun(8, 8, 0, 0),
    "faint sky with sun": sun(16, 32, 5, 20) + np.float32(1e-3),
    "black rows": np.where(np.arange(12)[:, None, None] < 6, random_sky(12, 4, 4), 0).astype(np.float32),
}


# The sky


@pytest.mark.parametrize("name", SKIES)
def test_sky_samples_follow_the_density(device, program, name):
    """Chi-square over quarters of pixels; sampling gives the density that a lookup finds for the same direction."""
    picture, n, fine = SKIES[name], 40_000, 8
    height, width = picture.shape[:2]
    sky = Sky(device, program, picture)
    directions, density = sky.sample(np.random.default_rng(1).random((n, 2)))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)
    looked = sky.look(directions)[1]
    at_border = np.abs(looked / density - 1) > 1e-4  # rounding may put a direction into the next pixel
    assert at_border.mean() < 1e-3
    around = np.arctan2(directions[:, 0], -directions[:, 2]) / (2 * np.pi) + 0.5
    down = np.arccos(np.clip(directions[:, 1], -1, 1)) / np.pi
    row, column = ((v * 2 * k).astype(int).clip(0, 2 * k - 1) for v, k in ((down, height), (around, width)))
    observed = np.bincount(row * 2 * width + column, minlength=4 * height * width)
    points, solid_angle, _ = pixel_directions(2 * height, 2 * width, fine)
    _, _, cell = pixel_directions(2 * height, 2 * width, fine)
    expected = n * np.bincount(cell, sky.look(points)[1] * solid_angle)
    assert expected.sum() == pytest.approx(n, rel=2e-3)
    few = expected < 5
    assert observed[expected == 0].sum() <= at_border.sum()
    observed, expected = (np.append(a[~few], a[few].sum()) for a in (observed, expected))
    kept = expected > 0
    p = stats.chisquare(observed[kept], expected[kept] * observed[kept].sum() / expected[kept].sum()).pvalue
    assert p > 1 - (1 - 0.01) ** (1 / len(SKIES))


@pytest.mark.parametrize("name", SKIES)
def test_no_light_without_density(device, program, name):
    """Wherever bilinear lookups find light, sampling can."""
    picture = SKIES[name]
    sky = Sky(device, program, picture)
    directions, solid_angle, _ = pixel_directions(*picture.shape[:2], 16)
    radiance, density = sky.look(directions)
    assert (density[radiance.sum(axis=1) > 1e-6 * radiance.max()] > 0).all()
    # Importance sampling: no direction is found much too rarely for its light.
    light = radiance @ [0.2126, 0.7152, 0.0722]
    assert (light[density > 0] / density[density > 0]).max() < 16 * np.sum(light * solid_angle)


def test_sky_radiance_is_bilinear(device, program):
    """Pixel centres are exact; the last column's neighbour is the first; the poles' is themselves."""
    picture = random_sky(6, 4, 5)
    sky = Sky(device, program, picture)
    rng = np.random.default_rng(6)
    u, v = rng.random((2, 4000))
    centres = np.stack(np.meshgrid((np.arange(4) + 0.5) / 4, (np.arange(6) + 0.5) / 6), axis=-1).reshape(-1, 2)
    u, v = np.append(u, centres[:, 0]), np.append(v, centres[:, 1])
    around, theta = 2 * np.pi * (u - 0.5), np.pi * v
    directions = np.column_stack([np.sin(theta) * np.sin(around), np.cos(theta), -np.sin(theta) * np.cos(around)])
    x, y = u * 4 - 0.5, v * 6 - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    expected = np.zeros((len(u), 3))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - (x - left)) * np.abs(1 - dy - (y - top))
            expected += weight[:, None] * picture[np.clip(top + dy, 0, 5), (left + dx) % 4]
    np.testing.assert_allclose(sky.look(directions)[0], expected, atol=3e-5)


def test_black_sky_has_shares():
    """Of nothing: even ones, and none that is no number."""
    rows, columns = picture_shares(np.zeros((4, 8, 3), np.float32))
    assert np.isfinite(rows).all() and np.isfinite(columns).all()
    assert (np.diff(rows) >= 0).all() and rows[-1] == 1 and (columns[:, -1] == 1).all()


def test_black_picture_of_a_sky_stays_black():
    """Beside a lamp, by whose light a ray that leaves the scene is weighted, too."""
    scene = lit(
        floor(3), camera=CAMERA, materials=[grey(0.5, 1.0)], environment=Environment(np.zeros((4, 8, 3), np.float32))
    )
    color = render(scene, (16, 16), 4).color["mono"]
    assert np.isfinite(color).all()
    assert (color[0] == 0).all() and color.max() > 0.9


# Chances


def lamps():
    """Two meshes with emissive triangles of two materials, placed three times, beside lights of every kind."""
    materials = [
        grey(0.5),
        Material("red", BLACK, emission=(5.0, 0.0, 0.0)),
        Material("textured", BLACK, emission=(1.0, 1.0, 1.0), emission_texture=TextureUse(0), double_sided=False),
    ]
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[0] = 0
    lights = [
        PointLight((0, 2, 0), (1.0, 2.0, 3.0)),
        SpotLight((0, 2, 1), (0.0, -1.0, 0.0), (9.0, 9.0, 9.0), 0.2, 0.5),
        DirectionalLight((0.0, -1.0, 0.0), (0.01, 0.02, 0.03)),
    ]
    stretched = np.array([[2.0, 0, 0, 1], [0, 1, 0.5, 0], [0, 0, -3, 1]])
    return lit(
        floor(2), shape_mesh(grid((1, 0.5), (2, 1)), 1), shape_mesh(grid((0.3, 0.4), (1, 2)), 2), camera=CAMERA,
        materials=materials, lights=lights, textures=[Texture("half", pixels)],
        instances=[(0, np.eye(4)[:3]), (1, np.eye(4)[:3] + [[0, 0, 0, 2]] * 3), (2, stretched), (2, np.eye(4)[:3])],
        environment=Environment(random_sky(8, 16)),
    )  # fmt: skip


def chances(emitters):
    return np.diff(emitters.shares.astype(np.float64), prepend=0)


def test_chances_of_triangles_go_by_area(device, program):
    """Within a material, a triangle's chance is the material's density times its area; and they are chosen so."""
    scene = lamps()
    geometry = Geometry.of(scene)
    emitters = Emitters.of(scene, geometry)
    kind, chance = emitters.records["kind"], chances(emitters)
    assert chance.sum() == pytest.approx(1)
    assert list(kind[:3]) == [0, 0, 1] and (kind[3:-1] == 2).all() and kind[-1] == 3
    np.testing.assert_array_equal(np.bincount(emitters.records["instance"][kind == 2]), [0, 4, 4, 4])
    for record, part in zip(emitters.records[kind == 2], chance[kind == 2], strict=True):
        mesh = scene.meshes[scene.instances[record["instance"]].mesh]
        matrix = scene.instances[record["instance"]].transform
        corners = mesh.positions[mesh.triangles[record["primitive"]]].astype(float) @ matrix[:, :3].T
        area = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
        density = emitters.material_density[mesh.material[record["primitive"]]]
        assert part == pytest.approx(area * density, abs=2e-7)
    assert emitters.sky_chance == pytest.approx(chance[-1])
    assert emitters.material_density[0] == 0

    n = 200_000
    u = np.random.default_rng(7).random(n).astype(np.float32)
    index = device.empty(n, np.uint32)
    program["search"](
        device.upload(emitters.shares), device.upload(np.minimum(u, 1 - 2.0**-24)), index, n, len(chance), count=n
    )
    observed = np.bincount(index.get(), minlength=len(chance))
    assert stats.chisquare(observed, n * chance).pvalue > 0.01


def test_chances_go_by_power():
    """More power, more chance, and half of all at least by power: 4 pi I of a point, the cone's part of that of a spot, pi A L
    for each side of a triangle, pi R^2 E of what is far away."""
    scene = lamps()
    geometry = Geometry.of(scene)
    chance = chances(Emitters.of(scene, geometry))
    luminance = np.array([0.2126, 0.7152, 0.0722])
    corners = np.concatenate(
        [
            scene.meshes[i.mesh].positions.astype(float) @ i.transform[:, :3].T + i.transform[:, 3]
            for i in scene.instances
        ]
    )
    disc = np.pi * np.sum((0.5 * np.ptp(corners, axis=0)) ** 2)
    theta = np.pi * (np.arange(8)[:, None] + [0, 1]) / 8
    rows = np.cos(theta[:, 0]) - np.cos(theta[:, 1])
    sky = disc * np.pi * np.sum((scene.environment.radiance @ luminance).mean(axis=1) * rows) / 2
    red = 2 * np.pi * 0.5 * 5 * luminance[0]
    textured = np.pi * 0.5 * (0.12 + 2 * 0.3 * np.hypot(0.5 * 0.4, 3 * 0.4))
    cone = 2 * np.pi * (1 - (np.cos(0.2) + np.cos(0.5)) / 2)
    power = np.array(
        [4 * np.pi * luminance @ [1, 2, 3], cone * 9, disc * luminance @ [0.01, 0.02, 0.03], red, textured, sky]
    )
    found = np.array([*chance[:3], chance[3:7].sum(), chance[7:15].sum(), chance[15]])
    np.testing.assert_array_equal(np.argsort(found), np.argsort(power))
    even = np.polyfit(power / power.sum(), found, 1)  # a line: a part by power, the rest alike
    np.testing.assert_allclose(np.polyval(even, power / power.sum()), found, atol=2e-3)
    assert even[0] > 0.5 and even[1] >= 0


def test_weak_light_beside_a_strong_one_can_be_chosen():
    """1e8 beside 1e-8: a chance far above float32's resolution of the shares."""
    scene = replace(lamps(), lights=(PointLight((0, 2, 0), (1e8,) * 3), PointLight((0, 3, 0), (1e-8,) * 3)))
    emitters = Emitters.of(scene, Geometry.of(scene))
    assert chances(emitters).min() > 1e-5


def test_nothing_shines():
    dark = lit(
        floor(2),
        camera=CAMERA,
        lights=[PointLight((0, 1, 0), BLACK)],
        environment=Environment(np.zeros((2, 4, 3), np.float32)),
    )
    emitters = Emitters.of(dark, Geometry.of(dark))
    assert len(emitters.records) == 0 and not emitters.material_density.any() and emitters.sky_chance == 0
    assert (render(dark, (8, 8)).color["mono"] == 0).all()


def test_scaled_instances_shine_with_their_area():
    """Twice as large, four times the chance of the same mesh."""
    scene = lit(
        ball(0.2, 0, 0), camera=CAMERA, materials=[grey(0.0, 1.0)],
        instances=[(0, np.eye(4)[:3]), (0, np.column_stack([2 * np.eye(3), [3, 0, 0]]))],
    )  # fmt: skip
    chance = chances(Emitters.of(scene, Geometry.of(scene)))
    np.testing.assert_allclose(chance[20:].sum() / chance[:20].sum(), 4, rtol=1e-5)
