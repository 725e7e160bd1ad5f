"""The cache that `clcache bench reproject` reprojects holds what its camera sees, and each of its passes does its part."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import cube, icosphere, make_scene
from render_helpers import view

from clcache.bench.reproject import PER_PIXEL, SLOTS, Reprojection, cache_content
from clcache.bvh.tracer import Tracer
from clcache.passes.reproject import VARIANTS
from clcache.resources import SceneResources

SIZE = (40, 24)
PIXELS = SIZE[0] * SIZE[1]
NONE = 0xFFFFFFFF


@pytest.fixture(scope="module")
def scene():
    """Objects that leave a part of the view to the background."""
    turned = np.array([[0, 0, 1, 1.5], [0, 1, 0, 0.3], [-1, 0, 0, -1.0]])
    camera = view((0.3, 1.2, 5.0), (0.2, 0.1, 0.0), degrees=30, near=0.1)
    return replace(make_scene(icosphere(2), cube(), instances=[(0, np.eye(4)[:3]), (1, turned)]), camera=camera)


@pytest.fixture(scope="module")
def resources(device, scene):
    return SceneResources(device, scene)


@pytest.fixture(scope="module")
def content(device, scene):
    return cache_content(Tracer(scene, device), scene, SIZE)


def test_where_the_camera_was_each_sample_is_in_its_own_pixel(device, scene, resources, content):
    """The first hits were packed as kernels unpack them, the background's directions, too."""
    passes = Reprojection(device, resources, SIZE, replace(content, camera=scene.camera), "deterministic")
    passes.run_common()
    assert passes.listed == PER_PIXEL * PIXELS
    samples, target = (passes.arrays[name].get()[: passes.listed] for name in ("samples", "target"))
    own = target == (samples & 0x7FFFFFFF) % PIXELS
    assert own.mean() > 0.998  # the others lie on the line between two pixels
    is_far = np.isinf(passes.arrays["distance"].get()[: passes.listed])
    assert 0.1 < is_far.mean() < 0.9
    assert own[is_far].mean() > 0.99
    assert 0.88 < (samples >= 0x80000000).mean() < 0.92


def test_the_camera_moves_by_a_pixel_or_two(device, scene, resources, content):
    passes = Reprojection(device, resources, SIZE, content, "deterministic")
    passes.run_common()
    samples, target = (passes.arrays[name].get()[: passes.listed] for name in ("samples", "target"))
    here = target != NONE
    before, after = np.unravel_index([(samples & 0x7FFFFFFF)[here] % PIXELS, target[here]], SIZE[::-1])[1]
    is_far = np.isinf(passes.arrays["distance"].get()[: passes.listed])[here]
    assert 0.5 < np.abs(after.astype(int) - before)[~is_far].mean() < 3
    assert here.mean() > 0.8


@pytest.mark.parametrize("variant", [*VARIANTS, "simple"])
@pytest.mark.parametrize("has_radiance", [True, False])
def test_the_passes_fill_the_cache(device, resources, content, variant, has_radiance):
    held = content.of_first_slot() if variant == "simple" else content
    passes = Reprojection(device, resources, SIZE, held, variant, has_radiance)
    before = passes.arrays["first_hit"].get()
    seconds = passes.run_common() | passes.run_slots()
    names = {"simple": {"store"}, "single-pass": {"reserve"}}.get(variant, {"reserve", "copy"})
    assert seconds.keys() == {"list", "project", *names}
    assert all(value > 0 for value in seconds.values())
    assert passes.listed == PIXELS * (1 if variant == "simple" else PER_PIXEL)
    after = passes.arrays["first_hit"].get()
    has_hit = held.first_hit[0, :, 3] != NONE
    assert (after != before).any(axis=-1)[0, has_hit].mean() > 0.6
    known = {tuple(words) for words in held.first_hit.reshape(-1, 4)}
    assert {tuple(words) for words in after[0]} <= known
    assert after.shape[0] == (1 if variant == "simple" else SLOTS)
