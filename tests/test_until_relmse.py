"""Rendering until the error is small enough, and what is known of it: variance and sample counts."""

import numpy as np
import pytest
from helpers import IDENTITY
from render_helpers import ball, floor, grey, lit, render, shape_mesh, view

from clcache import Renderer, SettingError
from clcache.metrics import relmse
from clcache.scene.generators import plane
from clcache.scene.model import Environment, Material

SIZE = (20, 15)


def scene():
    """A lamp above a ball on a floor."""
    down = np.array([[1.0, 0, 0, 0], [0, -1, 0, 3], [0, 0, 1, 0]])
    lifted = IDENTITY + [[0, 0, 0, 0], [0, 0, 0, 0.8], [0, 0, 0, 0]]
    return lit(
        floor(8), ball(0.8, 2), shape_mesh(plane((1.0, 1.0)), 1), camera=view((0, 2.5, 4.5), (0, 0.6, 0)),
        materials=[grey(0.6), Material("lamp", (0.0, 0.0, 0.0), emission=(8.0, 7.0, 6.0))],
        environment=Environment.constant((0.1, 0.15, 0.2)), instances=[(0, IDENTITY), (1, lifted), (2, down)],
    )  # fmt: skip


def sampling(frame, eye="mono"):
    return frame.stats["eyes"][eye]["spp"], frame.stats["eyes"][eye].get("estimated_relmse")


@pytest.mark.parametrize("sampler", ["independent", "sobol"])
@pytest.mark.parametrize("goal", [1e-2, 3e-4])
def test_stops_when_the_estimate_is_below_the_goal(sampler, goal):
    """Not before, and at most twice the samples that are needed; the image is that of a plain render, bit for bit."""
    frame = render(scene(), SIZE, None, until_relmse=goal, sampler=sampler, bounces=1, aovs=("samples", "variance"))
    spp, estimate = sampling(frame)
    assert estimate <= goal
    variance = frame.aov("variance", "mono").astype(float)
    assert estimate == pytest.approx(np.mean(variance / (frame.color["mono"].astype(float) ** 2 + 0.01)), rel=1e-5)
    if spp > 16:
        assert estimate > goal / 2.6  # rounds at most double
    plain = render(scene(), SIZE, spp, sampler=sampler, bounces=1, aovs=("samples", "variance"))
    np.testing.assert_array_equal(frame.color["mono"], plain.color["mono"])
    np.testing.assert_array_equal(frame.aov("variance", "mono"), plain.aov("variance", "mono"))
    assert (frame.aov("samples", "mono") == spp).all() and (plain.aov("samples", "mono") == spp).all()


def test_more_samples_for_a_smaller_error():
    counts = [sampling(render(scene(), SIZE, None, until_relmse=goal, bounces=1))[0] for goal in (1e-2, 1e-3, 3e-4)]
    assert counts[0] < counts[1] < counts[2]


def test_spp_is_the_most():
    frame = render(scene(), SIZE, 40, until_relmse=1e-9, bounces=1)
    assert sampling(frame)[0] == 40 and sampling(frame)[1] > 1e-9
    np.testing.assert_array_equal(frame.color["mono"], render(scene(), SIZE, 40, bounces=1).color["mono"])
    assert sampling(render(scene(), SIZE, 7, until_relmse=1e9, bounces=1))[0] == 7


def test_each_eye_and_frame_by_itself():
    """One eye's sums do not begin with the other's, nor a frame's with the one before."""
    options = {"size": SIZE, "until_relmse": 1e-2, "settings": {"pathtrace.bounces": 1}}
    frames = list(Renderer(scene(), stereo=True, **options).frames(0, 2))
    again = next(Renderer(scene(), stereo=True, **options).frames(1, 2))
    for eye in ("left", "right"):
        np.testing.assert_array_equal(frames[1].color[eye], again.color[eye])
        spp = sampling(frames[1], eye)[0]
        plain = render(scene(), SIZE, spp, frame=1, stereo=True, bounces=1)
        np.testing.assert_array_equal(frames[1].color[eye], plain.color[eye])


def test_estimate_is_the_true_error():
    """Independent samples: within 30 % of relMSE against many more samples. Of 900 values' squares, whose distribution is
    wide, and weighted by the brightness of a pixel: a deviation of about 8 %."""
    truth = render(scene(), SIZE, 1024, seed=77, bounces=1).color["mono"]
    for seed in (1, 2):
        frame = render(scene(), SIZE, 32, seed=seed, until_relmse=1e-9, sampler="independent", bounces=1)
        assert sampling(frame)[1] == pytest.approx(relmse(frame.color["mono"], truth), rel=0.3)


def test_variance_is_that_of_the_samples():
    """Samples of their own, told from growing renders: sum of n less sum of n - 1. NumPy's variance of the mean of them."""
    n, options = 8, {"sampler": "independent", "bounces": 1}
    sums = [k * render(scene(), SIZE, k, **options).color["mono"].astype(np.float64) for k in range(1, n + 1)]
    samples = np.diff(np.array([np.zeros_like(sums[0]), *sums]), axis=0)
    frame = render(scene(), SIZE, n, aovs=("variance",), **options)
    expected = samples.var(axis=0, ddof=1) / n
    np.testing.assert_allclose(frame.aov("variance", "mono"), expected, rtol=2e-3, atol=1e-6)


def test_variance_predicts_the_spread_of_renders():
    """Over frames, each with its own numbers, the variance of pixels is what each says of its own. Means over the image: 10 %."""
    settings = {"pathtrace.sampler": "independent", "pathtrace.bounces": 1}
    frames = list(Renderer(scene(), size=SIZE, spp=16, settings=settings, aovs=("variance",)).frames(0, 32))
    spread = np.var([f.color["mono"] for f in frames], axis=0, ddof=1).mean()
    assert np.mean([f.aov("variance", "mono") for f in frames]) == pytest.approx(spread, rel=0.1)


def test_variance_of_one_sample_is_unknown_and_of_no_noise_is_zero():
    assert np.isinf(render(scene(), SIZE, 1, bounces=0, aovs=("variance",)).aov("variance", "mono")).all()
    even = lit(floor(60), camera=view((0, 1, 0.01), (0, 0, 0)), materials=[grey(0.0, 1e3)])
    frame = render(even, (8, 8), 64, bounces=0, aovs=("variance",), until_relmse=1e-6)
    assert frame.stats["eyes"]["mono"]["spp"] == 16
    assert (frame.aov("variance", "mono") <= 1e-6 * 1e6 / 16).all()


@pytest.mark.parametrize("goal", [0.0, -1.0, float("nan")])
def test_goals_that_cannot_be(goal):
    with pytest.raises(SettingError, match="until_relmse"):
        Renderer(scene(), size=SIZE, until_relmse=goal)
