"""How many rays a frame traces, and how its noise falls with their number."""

import numpy as np
import pytest
from render_helpers import WHITE, ball, floor, grey, image, lit, render, view

from clcache import Renderer
from clcache.scene.model import DirectionalLight, PointLight

SIZE = (20, 15)
PIXELS = 300
DOWN = view((0, 3, 0.1), (0, 0, 0))  # sees nothing but the floor
SUN = DirectionalLight((0.0, -1.0, 0.0), (1.0, 1.0, 1.0))
NO_ROULETTE = {"pathtrace.roulette": 64}


def rays(scene, **options):
    return render(scene, SIZE, **options).stats["eyes"]["mono"]["rays"]


@pytest.mark.parametrize("spp", [1, 7])
def test_direct_light_only(spp):
    """One camera ray and one shadow ray for each sample; nothing is traced that finds no light."""
    assert rays(lit(floor(), camera=DOWN, lights=[SUN]), spp=spp, bounces=0) == {
        "primary": spp * PIXELS, "secondary": 0, "shadow": spp * PIXELS,
    }  # fmt: skip


def test_environment_needs_one_ray_more():
    counts = rays(lit(floor(), camera=DOWN, environment=WHITE), spp=2, bounces=0)
    assert counts == {"primary": 2 * PIXELS, "secondary": 2 * PIXELS, "shadow": 0}


@pytest.mark.parametrize("bounces", [0, 1, 4])
def test_every_bounce_within_a_closed_room(bounces):
    """Seen from within a sphere with lights alone, each bounce is a ray and a shadow ray; with emission, one ray more. A place
    on the emissive triangle that the path stands on gets no shadow ray: one in 80."""
    camera = view((0, 0, 0), (0, 0, -1))
    light = [PointLight((0, 0.5, 0), (1.0, 1.0, 1.0))]
    options = {"spp": 2, "bounces": bounces, "settings": NO_ROULETTE}
    dark = rays(lit(ball(2, 1), camera=camera, lights=light), **options)
    assert dark == {"primary": 2 * PIXELS, "secondary": 2 * PIXELS * bounces, "shadow": 2 * PIXELS * (bounces + 1)}
    glowing = rays(lit(ball(2, 1), camera=camera, materials=[grey(0.5, 1.0)]), **options)
    vertices = 2 * PIXELS * (bounces + 1)
    assert (glowing["primary"], glowing["secondary"]) == (2 * PIXELS, vertices)
    own = vertices - glowing["shadow"]
    assert 0 < own < vertices / 80 + 4.5 * np.sqrt(vertices / 80)


def test_nothing_follows_a_miss_or_a_black_surface():
    away = view((0, 3, 0), (0, 6, 0.1))
    assert rays(lit(floor(), camera=away, lights=[SUN], environment=WHITE)) == {
        "primary": PIXELS,
        "secondary": 0,
        "shadow": 0,
    }
    black = lit(floor(), camera=DOWN, materials=[grey(0.0)], environment=WHITE)
    assert rays(black)["secondary"] == 0


def test_no_shadow_ray_to_a_light_behind_the_surface():
    below = DirectionalLight((0.0, 1.0, 0.0), (1.0, 1.0, 1.0))
    assert rays(lit(floor(), camera=DOWN, lights=[below]))["shadow"] == 0


def test_counts_are_of_one_eye_and_one_frame():
    renderer = Renderer(
        lit(floor(), camera=DOWN, lights=[SUN]), size=SIZE, spp=3, stereo=True, settings={"pathtrace.bounces": 0}
    )
    for frame in renderer.frames(0, 2):
        for eye in ("left", "right"):
            assert frame.stats["eyes"][eye]["rays"] == {"primary": 3 * PIXELS, "secondary": 0, "shadow": 3 * PIXELS}


def test_bounces_add_light_and_only_light():
    """Images of more bounces, by the same random numbers, are brighter by what the further bounces bring, pixel for pixel."""
    scene = lit(
        ball(2, 2),
        camera=view((0, 0, 0), (0, 0, -1)),
        materials=[grey(0.5)],
        lights=[PointLight((0, 1, 0), (5.0,) * 3)],
    )
    images = [image(scene, SIZE, 2, bounces=b, settings=NO_ROULETTE) for b in range(4)]
    for fewer, more in zip(images, images[1:], strict=False):
        assert (more > fewer).all()


def test_noise_falls_with_the_root_of_the_samples():
    """Variance over 24 frames of 900 pixels, at 1, 4 and 16 spp: ratios of 4 within 10 % (their standard error is 1 to 2 %)
    for independent samples; that of better spread ones falls faster."""
    there = np.column_stack([np.eye(3), [0, 1.0, 0]])
    scene = lit(floor(), ball(0.8, 2), camera=view((0, 0.9, 4), (0, 0, 0), 30), materials=[grey(0.5)], environment=WHITE,
                instances=[(0, np.eye(4)[:3]), (1, there)])  # fmt: skip
    ratios = {}
    for sampler in ("independent", "sobol"):
        variances = []
        for spp in (1, 4, 16):
            settings = {"pathtrace.bounces": 0, "pathtrace.sampler": sampler}
            renderer = Renderer(scene, size=(30, 30), spp=spp, settings=settings)
            frames = np.array([f.color["mono"][..., 0] for f in renderer.frames(0, 24)])
            variances.append(frames.var(axis=0, ddof=1).mean())
        assert variances[0] > 1e-3
        ratios[sampler] = np.divide(variances[:-1], variances[1:])
    np.testing.assert_allclose(ratios["independent"], 4, rtol=0.1)
    assert (ratios["sobol"] > 5).all()


def test_pixels_are_filled_by_their_samples():
    """Samples lie anywhere in their pixel, evenly: an edge through it gives its coverage."""
    camera = view((0, 0, 1), (0, 0, 0), 90)  # the one pixel is the square from -1 to 1 in the plane z = 0
    upright = np.array([[1.0, 0, 0, 15 - 0.5], [0, 0, -1, 0], [0, 1, 0, 0]])  # the square of 30 covers x > -0.5
    scene = lit(floor(30), camera=camera, materials=[grey(0.0, 1.0)], instances=[(0, upright)])
    covered = image(scene, (1, 1), 1024, bounces=0)[0, 0, 0]
    assert covered == pytest.approx(0.75, abs=4.5 * np.sqrt(0.75 * 0.25 / 1024))
