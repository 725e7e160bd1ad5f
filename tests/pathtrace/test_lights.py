"""Direct light against closed forms, evaluated in NumPy where each camera ray meets the plane y = 0."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import IDENTITY, make_mesh
from render_helpers import (
    BLACK,
    MODELLED,
    ball,
    camera_rays,
    floor,
    grey,
    image,
    lit,
    on_floor,
    render,
    shape_mesh,
    view,
)

from clcache.scene.generators import plane
from clcache.scene.model import DirectionalLight, Environment, Material, PointLight, Texture, TextureUse

SIZE = (24, 18)
CAMERA = view((1, 3, 4), (0, 0, 0))
ALBEDO = np.array([0.8, 0.5, 0.2])


def scene(*lights):
    return lit(floor(), camera=CAMERA, materials=[Material("m", tuple(ALBEDO))], lights=lights)


def point_light(points, position, intensity):
    """Radiance at points of the plane y = 0: albedo / pi * I cos / r^2."""
    to_light = np.asarray(position) - points
    squared = np.sum(to_light**2, axis=-1, keepdims=True)
    return ALBEDO / np.pi * np.asarray(intensity) * to_light[..., 1:2] / squared**1.5


def test_point_light():
    position, intensity = (0.5, 1.2, -0.3), (10.0, 20.0, 30.0)
    color = image(scene(PointLight(position, intensity)), SIZE, bounces=0, sampler=MODELLED)
    np.testing.assert_allclose(color, point_light(on_floor(CAMERA, SIZE), position, intensity), rtol=5e-5)


def test_mean_over_samples():
    position, intensity = (0.5, 1.2, -0.3), (10.0, 20.0, 30.0)
    color = image(scene(PointLight(position, intensity)), SIZE, 8, bounces=0, sampler=MODELLED)
    expected = [point_light(on_floor(CAMERA, SIZE, sample=s), position, intensity) for s in range(8)]
    np.testing.assert_allclose(color, np.mean(expected, axis=0), rtol=5e-5)


def test_inverse_square():
    near, far = (
        image(scene(PointLight((0, h, 0), (h * h,) * 3)), (1, 1), bounces=0) for h in (1e3, 1e4)
    )  # from straight above, and so high that all of the view is one point
    np.testing.assert_allclose(near, far, rtol=1e-4)
    np.testing.assert_allclose(near[0, 0], ALBEDO / np.pi, rtol=1e-4)


@pytest.mark.parametrize("elevation", [90, 45, 5])
def test_directional_light(elevation):
    angle = np.radians(elevation)
    light = DirectionalLight((float(np.cos(angle)), float(-np.sin(angle)), 0.0), (3.0, 2.0, 1.0))
    color = image(scene(light), SIZE, bounces=0)
    np.testing.assert_allclose(
        color, np.broadcast_to(ALBEDO / np.pi * [3, 2, 1] * np.sin(angle), color.shape), rtol=1e-5
    )


@pytest.mark.parametrize(
    "light",
    [
        PointLight((0, -1, 0), (1e6,) * 3),
        PointLight((0, 0, 0), (1e6,) * 3),
        DirectionalLight((0, 1, 0), (1e6,) * 3),
        DirectionalLight((1, 0, 0), (1e6,) * 3),
    ],
    ids=["point below", "point in the plane", "directional from below", "directional along the plane"],
)
def test_light_that_no_surface_faces(light):
    assert (image(scene(light), SIZE, 4) == 0).all()


def test_both_sides_of_a_surface_are_lit():
    """Seen from below, the plane is lit from below."""
    camera = view((1, -3, 4), (0, 0, 0))
    light = DirectionalLight((0.0, 1.0, 0.0), (np.pi,) * 3)
    color = image(lit(floor(), camera=camera, materials=[grey(0.5)], lights=[light]), SIZE, bounces=0)
    np.testing.assert_allclose(color, 0.5, rtol=1e-6)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.0, 0.5])
def test_the_back_of_a_single_sided_surface_is_black(metallic, roughness):
    """Neither matt nor shiny, nor a lamp; at grazing angles, too, where all else reflects most."""
    shiny = Material(
        "m",
        (0.8, 0.8, 0.8),
        metallic=metallic,
        roughness=roughness,
        specular=1.0,
        emission=(1.0, 1.0, 1.0),
        double_sided=False,
    )
    light = DirectionalLight((0.0, 1.0, 0.0), (np.pi,) * 3)
    for eye in ((1, -3, 4), (0, -0.1, 4)):
        camera = view(eye, (0, 0, 0), 3)
        world = lit(floor(1e4), camera=camera, materials=[shiny], lights=[light], environment=(1.0, 1.0, 1.0))
        frame = render(world, SIZE, aovs=("Z",))
        hit = np.isfinite(frame.aov("Z", "mono"))
        assert hit.sum() > 100
        assert (frame.color["mono"][hit] == 0).all()


def test_glass_has_an_inside_though_it_is_single_sided():
    """A clear ball in a white room cannot be seen: what enters leaves, but for a little that its facets keep."""
    glass = Material("glass", (1.0, 1.0, 1.0), roughness=0.0, specular=1.0, transmission=1.0, double_sided=False)
    world = lit(
        ball(1, 4, smooth=True), camera=view((0, 0, 3), (0, 0, 0), 30), materials=[glass], environment=(1.0, 1.0, 1.0)
    )
    settings = {"pathtrace.roulette": 64}
    assert image(world, SIZE, 64, bounces=16, settings=settings).mean() == pytest.approx(1.0, abs=1e-3)


def test_several_lights_are_chosen_by_power():
    """One of three lights for each sample, nine times in ten by its share of the power, else any: within 4.5 standard
    deviations of the sum, which the choice itself causes; and the image's noise is what those chances say, within 20 %."""
    lights = [((0.5, 1.2, -0.3), 10.0), ((-1, 2, 0), 20.0), ((0, 3, 1), 30.0)]
    camera, size, spp = view((1, 3, 4), (0, 0, 0), 0.1), (4, 3), 1024  # so narrow that all of a pixel is one point
    world = lit(
        floor(),
        camera=camera,
        materials=[Material("m", tuple(ALBEDO))],
        lights=[PointLight(p, (i,) * 3) for p, i in lights],
    )
    color = image(world, size, spp, bounces=0, sampler=MODELLED)
    each = np.stack([point_light(on_floor(camera, size), p, (i,) * 3) for p, i in lights])
    expected = each.sum(axis=0)
    chance = 0.9 * np.array([10, 20, 30]) / 60 + 0.1 / 3
    deviation = np.sqrt(((each**2 / chance[:, None, None, None]).sum(axis=0) - expected**2) / spp)
    assert (np.abs(color - expected) < 4.5 * deviation).all()
    renders = np.array([image(world, size, 16, bounces=0, sampler=MODELLED, seed=k) for k in range(1, 40)])
    noise = renders.std(axis=0, ddof=1).mean() / np.sqrt(spp / 16)
    assert noise == pytest.approx(deviation.mean(), rel=0.2)


def test_shadow_of_a_square():
    """A square parallel to the floor, under a point light, casts a square shadow; the geometry says which pixels it has."""
    height, light_height, side = 1.0, 2.5, 0.6
    blocker = plane((side, side))
    camera = view((0, 0.9, 1.2), (0, 0, 0), 70)  # below the square, which hides nothing from it
    mesh = make_mesh(blocker.positions + [0, height, 0], blocker.triangles)
    lights = [PointLight((0, light_height, 0), (10.0,) * 3)]
    color = image(lit(floor(), mesh, camera=camera, lights=lights), (64, 48), bounces=0, sampler=MODELLED)[..., 0]
    origin, directions = camera_rays(camera, (64, 48))
    on_ground = directions[..., 1] < -0.1
    points = on_floor(camera, (64, 48))[on_ground]
    half = side / 2 * light_height / (light_height - height)
    outside = np.abs(points[:, [0, 2]]).max(axis=1) - half
    blocked = outside < 0
    clear = np.abs(outside) > 1e-4
    assert blocked.sum() > 100
    np.testing.assert_array_equal(color[on_ground][clear] == 0, blocked[clear])


def test_light_beyond_an_occluder_and_occluder_beyond_a_light():
    """What stands behind a point light casts no shadow."""
    roof = plane((50, 50))
    light = PointLight((0, 1, 0), (5.0,) * 3)
    for height, is_dark in ((0.9, True), (1.1, False)):
        mesh = make_mesh(roof.positions + [0, height, 0], roof.triangles)
        camera = view((1, 0.8, 2), (0, 0, 0))
        color = image(lit(floor(), mesh, camera=camera, lights=[light]), SIZE, bounces=0, sampler=MODELLED)
        _, directions = camera_rays(camera, SIZE)
        ground = color[directions[..., 1] < -0.1]
        assert ((ground == 0) == is_dark).all()


def test_emission_is_found_by_hits():
    """The sphere itself, and its reflection on the floor: the irradiance of a sphere of radiance L is pi L (r/d)^2 cos.

    Z-test of the image's mean; |z| < 3.3 has significance 0.001; 1 % for the sphere's triangles.
    """
    radius, height, radiance = 0.5, 1.5, 3.0
    place = np.column_stack([np.eye(3), [0, height, 0]])
    camera = view((0, 2, 0.5), (0, 0, 1.2), 20)
    mesh = ball(radius, 4, material=1)
    world = lit(
        floor(), mesh, camera=camera, materials=[Material("m", tuple(ALBEDO)), grey(0.0, radiance)], instances=[(0, IDENTITY), (1, place)]
    )  # fmt: skip
    color = image(world, (16, 16), 1024, bounces=0, sampler=MODELLED).astype(float)
    points = np.mean([on_floor(camera, (16, 16), sample=s) for s in range(16)], axis=0)
    to_centre = np.array([0, height, 0]) - points
    distance = np.linalg.norm(to_centre, axis=-1, keepdims=True)
    expected = ALBEDO * radiance * (radius / distance) ** 2 * to_centre[..., 1:2] / distance
    difference = (color - expected)[..., 0]
    z = difference.mean() / (difference.std(ddof=1) / 16)
    assert abs(z) < 3.3 + 0.01 * expected[..., 0].mean() / (difference.std() / 16)
    front = image(lit(mesh, camera=view((0, 0, 1), (0, 0, 0), 10), materials=[grey(0), grey(0.0, radiance)]), (4, 4))
    assert (front == np.float32(radiance)).all()


def test_background_is_the_environment():
    world = lit(ball(), camera=view((0, 0, 3), (0, 0, 6)), environment=(0.25, 0.5, 4.0))
    assert (image(world, (5, 4), 3) == np.float32([0.25, 0.5, 4.0])).all()


def test_a_dark_picture_about_a_lamp_is_no_environment():
    lamp = lit(floor(3), camera=CAMERA, materials=[grey(0.5, 2.0)])
    dark = replace(lamp, environment=Environment(np.zeros((2, 4, 3), np.float32)))
    np.testing.assert_array_equal(image(dark, SIZE, 4), image(lamp, SIZE, 4))


def test_holes_in_a_lamp_are_dark():
    """Stripes cut out of an emissive square leave the light of the stripes that are there, whichever ray finds it."""
    height, size, spp = 1.0, (24, 24), 64
    camera = view((0, 0.6, 1.5), (0, 0, 0), 40)
    pixels = np.full((1, 4, 4), 255, np.uint8)
    pixels[0, :2, 3] = 0
    picture = Texture("half", pixels, wrap=("clamp", "clamp"))
    above = np.array([[1.0, 0, 0, 0], [0, -1, 0, height], [0, 0, 1, 0]])
    square = shape_mesh(plane((2.0, 2.0)), 1)
    half = replace(square, positions=square.positions * np.float32([0.5, 1, 1]) + np.float32([0.5, 0, 0]))
    cut = replace(grey(0.0, 3.0), base_color_texture=TextureUse(0), alpha_cutoff=0.5)
    images = [
        image(lit(floor(), mesh, camera=camera, materials=[grey(0.5), lamp], textures=[picture], instances=[(0, IDENTITY), (1, above)]),
              size, spp, bounces=0, sampler=MODELLED, seed=seed)
        for seed, mesh, lamp in ((1, square, cut), (2, half, grey(0.0, 3.0)))
    ]  # fmt: skip
    difference = (images[0] - images[1])[..., 0].astype(float)
    assert abs(difference.mean()) < 3.3 * difference.std(ddof=1) / np.sqrt(difference.size)
    assert difference.std() < 0.2 * images[1].mean()


def test_no_light_at_all_is_black():
    frame = render(lit(floor(), camera=CAMERA, environment=BLACK), SIZE, 2)
    assert (frame.color["mono"] == 0).all()


@pytest.mark.parametrize("bounces", [0, 1, 2, 5])
def test_two_planes_facing_each_other(bounces):
    """Wide parallel planes, the upper one emitting e: from the floor, every other surface along a path is the emitter, so
    that its radiance is e (a + a^3 + a^5 ...). A path that leaves by the rim, 2 km away, is one in a million."""
    emission, albedo = 2.0, 0.5
    upper = plane((4e3, 4e3))
    mesh = replace(make_mesh(upper.positions + [0, 1, 0], upper.triangles), material=np.ones(2, np.uint32))
    world = lit(
        floor(4e3), mesh, camera=view((0, 0.9, 0.5), (0, 0, 0), 30), materials=[grey(albedo), grey(albedo, emission)]
    )
    color = image(world, (24, 24), 16, bounces=bounces, settings={"pathtrace.roulette": 64})
    expected = emission * np.sum(albedo ** np.arange(1.0, bounces + 2, 2))
    np.testing.assert_allclose(color.mean(), expected, rtol=2e-4)
