"""Where cached images must come out the same: as the path tracer's, variant by variant, eye by eye."""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import SMALL, cached, counters, one_device, yard
from render_helpers import image, render
from ztest import agree

from clcache.metrics import relmse

SIZE = (32, 24)
VARIANTS = ("single-pass", "two-pass", "deterministic")


@pytest.fixture(scope="module", autouse=True)
def compiled_once():
    with one_device():
        yield


def frames(scene, count, **options):
    return list(cached(scene, size=SIZE, **SMALL, **options).frames(0, count))


def renders(count, **options):
    return [frames(yard(moving=False), 48, seed=seed, **options)[-1].color["mono"] for seed in range(count)]


@pytest.fixture(scope="module")
def traced():
    return [image(yard(moving=False), SIZE, 48, seed=100 + seed) for seed in range(8)]


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_still_view_converges_to_path_tracing(traced, variant):
    """Diffuse surfaces, seen by each variant: the expectation is that of the path tracer."""
    for verdict in agree(renders(8, reprojection=variant), traced):
        assert verdict.passed, verdict


def test_variants_agree_while_the_camera_moves():
    """Which samples are kept differs, what they show does not: means of blocks are the same within their noise."""
    moving = {v: [frames(yard(8), 8, seed=s, reprojection=v)[-1].color["mono"] for s in range(6)] for v in VARIANTS}
    for variant in VARIANTS[:2]:
        for verdict in agree(moving[variant], moving["deterministic"]):
            assert verdict.passed, verdict


# Eyes


def test_each_eye_has_a_cache_of_its_own():
    """An eye of a stereo render is what it is alone: the left one bit for bit, the right one up to its own random numbers."""
    scene = yard(moving=False)
    pairs = frames(scene, 4, stereo=True)
    alone = frames(replace(scene, camera=pairs[0].cameras["left"]), 4)
    for both, one in zip(pairs, alone, strict=True):
        np.testing.assert_array_equal(both.color["left"], one.color["mono"])
        assert counters(both, "left") == counters(one)
    right = replace(scene, camera=pairs[0].cameras["right"])
    pairs = [frames(scene, 16, stereo=True, seed=s)[-1].color["right"] for s in range(6)]
    for verdict in agree(pairs, [frames(right, 16, seed=s)[-1].color["mono"] for s in range(6)]):
        assert verdict.passed, verdict


def test_eyes_in_one_place_see_the_same_with_noise_of_their_own():
    scene = yard(moving=False, eye_distance=0.0)
    pairs = [frames(scene, 8, stereo=True, seed=s)[-1].color for s in range(6)]
    left, right = ([pair[eye] for pair in pairs] for eye in ("left", "right"))
    for verdict in agree(left, right):
        assert verdict.passed, verdict
    noise = [np.stack(side) - np.mean(side, axis=0) for side in (left, right)]
    lit_up = noise[0].std(axis=0) > 1e-3
    assert abs(np.corrcoef(*(n[:, lit_up].ravel() for n in noise))[0, 1]) < 0.1


def test_blending_lowers_the_error_and_leaves_the_caches_alone():
    scene = yard(4, moving=False)
    plain, blended = (frames(scene, 4, stereo=True, stereo_blend=b, aovs=("samples",)) for b in ("none", "samples"))
    truth = render(scene, SIZE, 256, stereo=True)
    for eye in ("left", "right"):
        errors = [relmse(f[-1].color[eye], truth.color[eye]) for f in (plain, blended)]
        assert errors[1] < 0.95 * errors[0]
        np.testing.assert_array_equal(plain[-1].aov("samples", eye), blended[-1].aov("samples", eye))
        assert counters(plain[-1], eye) == counters(blended[-1], eye)
        assert blended[-1].stats["eyes"][eye]["passes"]["blend"] >= 0
