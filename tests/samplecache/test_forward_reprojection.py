"""Forward reprojection: where samples go, and which slots they get, against NumPy; nothing lost uncounted; no order of threads
that matters."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from cache_model import (
    NONE,
    VISIBLE,
    Content,
    Reprojection,
    choose,
    identity_words,
    is_consistent,
    objects,
    project,
    random_content,
)
from helpers import make_mesh, make_scene
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from render_helpers import view

from clcache.passes.reproject import VARIANTS, pixel_diagonal
from clcache.renderer import camera_record
from clcache.resources import SceneResources
from clcache.scene.model import Track

SIZE = (19, 13)  # neither is a multiple of 4
PIXELS = SIZE[0] * SIZE[1]
CAMERA = view((0.3, 1.2, 5.0), (0.2, 0.1, 0.0), degrees=50, near=0.1)
BACKGROUND_ONLY = 1.0
AGE = np.uint32(0x10000)


@pytest.fixture(scope="module")
def scene(device):
    return SceneResources(device, objects())


def reprojected(device, scene, content, camera=CAMERA, size=SIZE, **options):
    """What a variant makes of a cache: the passes, what they found, the new cache."""
    passes = Reprojection(device, scene, size, content.slots, **options)
    passes.put(content)
    found = passes.find(camera)
    return passes, found, passes.fill_slots()


def content_of(pixels: int, slots: int, **options) -> Content:
    return random_content(objects(), pixels, slots, **options)


def data(content: Content) -> dict[str, np.ndarray]:
    """Where there are samples, what they are."""
    occupied = content.occupied
    return {"mask": content.mask, "first_hit": content.first_hit[occupied], "shading": content.shading[occupied]}


def assert_same(ours: Content, theirs: Content) -> None:
    for name, values in data(ours).items():
        np.testing.assert_array_equal(values, data(theirs)[name], err_msg=name)


def owners(content: Content) -> np.ndarray:
    """(samples,) whose radiance the occupied slots hold."""
    return content.shading[content.occupied][:, 0]


def assert_none_uncounted(passes: Reprojection, after: Content, before: Content) -> None:
    counters = passes.counters()
    lost = sum(counters[name] for name in ("dropped", "overflow", "stolen"))
    assert after.occupied.sum() + lost == before.occupied.sum()
    assert set(counters) - {name for name, count in counters.items() if not count} <= {"dropped", "overflow", "stolen"}


def extent_of(after: Content, distance: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """nearest and farthest by NumPy. distance, slope: by number of the sample in the last frame's cache."""
    sample = np.where(after.visible, after.shading[..., 0], 0)
    t, s = (values[sample].view(np.uint32).astype(np.uint64) for values in (distance, slope))
    key = np.where(after.visible, t << np.uint64(32) | s, np.uint64(2**64 - 1))
    return key.min(axis=0), np.where(after.visible, t, 0).max(axis=0)


def by_sample(found: dict[str, np.ndarray], name: str, before: Content) -> np.ndarray:
    values = np.zeros(before.occupied.size, np.float32)
    values[found["samples"] & ~VISIBLE] = found[name]
    return values


@pytest.mark.parametrize(("slots", "size"), [(1, (1, 1)), (12, SIZE), (17, (5, 3)), (32, (16, 8))])
def test_all_samples_are_listed_run_by_run(device, scene, slots, size):
    content = content_of(size[0] * size[1], slots, part=0.9)
    passes = Reprojection(device, scene, size, slots)
    passes.put(content)
    samples = passes.find(CAMERA)["samples"]
    number, pixels = samples & ~VISIBLE, size[0] * size[1]
    assert sorted(number) == list(np.flatnonzero(content.occupied.ravel()))
    np.testing.assert_array_equal(samples >= VISIBLE, content.visible.ravel()[number])
    pixel = (number % pixels).astype(int)
    runs = pixel // 64
    assert (np.diff(pixel)[np.diff(runs) == 0] >= 0).all()
    assert len(np.unique(runs)) == 1 + np.count_nonzero(np.diff(runs))


@pytest.mark.parametrize("size", [(1, 1), (3, 5), SIZE, (64, 36)])
@pytest.mark.parametrize(
    "camera",
    [CAMERA, view((-4, 0.5, -3), (0, 0, 0), degrees=100), view((0.1, 0.2, 0.1), (1, 2, 0), degrees=90, near=0.7)],
    ids=["before", "behind", "within"],
)
def test_projection_against_numpy(device, scene, camera, size):
    content = content_of(size[0] * size[1], 32, part=1.0, background=0.3)
    passes = Reprojection(device, scene, size, 32)
    passes.put(content)
    found = passes.find(camera)
    expected = project(objects(), camera, size, content.first_hit.reshape(-1, 4)[found["samples"] & ~VISIBLE])
    assert_projected(found, expected, size, np.sin(pixel_diagonal(camera_record(camera, size))["phi_sine"]))


def assert_projected(found, expected, size, phi: float, tolerance: float = 2e-3) -> None:
    x, y = (np.where(np.isfinite(v), v, -9.0) for v in (expected.x, expected.y))
    inside = expected.in_front & (x >= 0) & (x < size[0]) & (y >= 0) & (y < size[1])
    pixel = np.where(inside, np.floor(y) * size[0] + np.floor(x), NONE)
    on_line = (np.abs(x - np.round(x)) < tolerance) | (np.abs(y - np.round(y)) < tolerance)
    assert on_line.mean() < 0.5 and inside[~on_line].any()
    np.testing.assert_array_equal(found["target"][~on_line], pixel[~on_line].astype(np.uint32))
    np.testing.assert_allclose(found["distance"], expected.distance, rtol=3e-6)
    here = found["target"] != NONE
    np.testing.assert_allclose(found["slope"][here], expected.slope[here], rtol=2e-3, atol=1e-3 * phi)
    assert np.isinf(found["distance"]).sum() > 0
    assert (found["slope"][np.isinf(found["distance"])] == 0).all()


def test_the_background_does_not_move_with_the_eye(device, scene):
    content = content_of(PIXELS, 4, part=1.0, background=BACKGROUND_ONLY)
    targets = []
    for eye in (0, 1e6):
        passes = Reprojection(device, scene, SIZE, 4)
        passes.put(content)
        moved = replace(CAMERA, transform=CAMERA.transform + [[0, 0, 0, eye]] * 3)
        targets.append(passes.find(moved)["target"])
    np.testing.assert_array_equal(*targets)
    assert 0 < (targets[0] != NONE).mean() < 1


def test_moving_instances_take_their_samples_along(device):
    still = objects()
    turn = Track(np.array([0.0, 1.0]), np.array([[0, 0, 0], [0.5, 1.0, -2.0]]), np.array([[0, 0, 0, 1], [0, 1, 0, 1]]) / [[1], [2**0.5]], np.ones((2, 3)))  # fmt: skip
    moving = replace(still, instances=(replace(still.instances[0], motion=(turn,)), *still.instances[1:]))
    resources, content = SceneResources(device, moving), content_of(PIXELS, 12)
    passes = Reprojection(device, resources, SIZE, 12)
    passes.put(content)
    before = passes.find(CAMERA)
    resources.set_time(1.0)
    after = passes.find(CAMERA)
    at_end = np.array([i.transform for i in still.instances])
    at_end[0] = [[0, 0, 1, 0.5], [0, 1, 0, 1.0], [-1, 0, 0, -2.0]]
    hits = content.first_hit.reshape(-1, 4)[after["samples"] & ~VISIBLE]
    expected = project(still, CAMERA, SIZE, hits, at_end)
    assert_projected(after, expected, SIZE, 0.1)
    # Lists have no order of their own where several threads make them.
    was, now = (np.argsort(found["samples"] & ~VISIBLE) for found in (before, after))
    has_moved = after["distance"][now] != before["distance"][was]
    np.testing.assert_array_equal(has_moved, hits[now, 3] == 0)


def one_triangle_content(uv: np.ndarray) -> Content:
    """A cache of one slot, its samples all on triangle 0. uv: (pixels, 2)."""
    words = np.zeros((1, len(uv), 4), np.uint32)
    words[0, :, :2] = np.round(uv * 0xFFFFFF)
    mask = np.full(len(uv), 3, np.uint64)
    return Content(1, mask, words, identity_words(np.arange(len(uv)))[None])


def test_near_plane(device):
    """A triangle that stands across the near plane."""
    scene = make_scene(make_mesh([[0, 0, -1], [0.01, 0, -3], [0, 0.01, -1]], [[0, 1, 2]]))
    content = one_triangle_content(np.column_stack([np.linspace(0, 1, PIXELS), np.zeros(PIXELS)]))
    camera = view((0, 0, 0), (0, 0, -1), degrees=90, near=2.0)
    _, found, after = reprojected(device, scene, content, camera)
    depth = 1 + 2 * np.linspace(0, 1, PIXELS)[found["samples"] & ~VISIBLE]
    off = np.abs(depth - 2) > 1e-5
    np.testing.assert_array_equal((found["target"] != NONE)[off], (depth > 2)[off])
    assert after.occupied.sum() == 1  # of one slot, in the middle


@pytest.mark.parametrize("degrees", [179, 60, 1e-4])
@pytest.mark.parametrize("size", [(1, 1), (1000, 1)])
@pytest.mark.parametrize("height", [0.0, 1e-30, 1e-12, 1e-4, 1.0])
def test_the_slope_is_finite_at_grazing_incidence(device, degrees, size, height):
    """From the plane of a triangle and from just above it: at most the distance and a half, and as Eq. 1 has it."""
    scene = make_scene(make_mesh([[-9, 0, -1], [9, 0, -1], [0, 0, -900]], [[0, 1, 2]]))
    uv = np.random.default_rng(1).dirichlet((1, 1, 1), size[0] * size[1])[:, :2]
    uv[0] = 0, 1  # straight ahead
    camera = view((0, height, 0), (0, height, -1), degrees=degrees)
    passes = Reprojection(device, scene, size, 1)
    passes.put(one_triangle_content(uv))
    found = passes.find(camera)
    assert np.isfinite(found["slope"]).all()
    assert (found["slope"] <= 1.5 * found["distance"]).all()
    expected = project(scene, camera, size, passes.arrays["first_hit_before"].get()[0][found["samples"] & ~VISIBLE])
    here = found["target"] != NONE
    if height in (0.0, 1.0):  # otherwise the cosine is a difference that rounding has left little of
        np.testing.assert_allclose(found["slope"][here], expected.slope[here], rtol=1e-2)
    assert here.any() or height == 1.0


@pytest.mark.parametrize("field", ["to_world", "slope", "near"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, 1e38])
@pytest.mark.parametrize("variant", VARIANTS)
def test_impossible_cameras_lose_samples_and_nothing_else(device, scene, variant, field, value):
    content = content_of(PIXELS, 12)
    record = np.array(camera_record(CAMERA, SIZE))
    record[field] = value
    passes, found, after = reprojected(device, scene, content, record[()], variant=variant)
    assert ((found["target"] < PIXELS) | (found["target"] == NONE)).all()
    assert np.isfinite(found["slope"]).all()
    assert (found["distance"][found["target"] != NONE] > 0).all()
    assert_none_uncounted(passes, after, content)
    if np.isnan(value) and field != "near":
        assert not after.occupied.any()


@pytest.mark.parametrize(("slots", "size"), [(1, (1, 1)), (1, SIZE), (12, (3, 5)), (12, SIZE), (16, SIZE), (17, SIZE), (32, (5, 3))])  # fmt: skip
@pytest.mark.parametrize("part", [0.3, 1.0])
def test_deterministic_slots_against_numpy(device, scene, slots, size, part):
    pixels = size[0] * size[1]
    before = content_of(pixels, slots, part=part)
    passes, found, after = reprojected(device, scene, before, size=size)
    assert_chosen(passes, found, after, before, choose(found, slots, pixels))


def assert_chosen(passes, found, after, before, expected) -> None:
    occupied = expected.sample != NONE
    np.testing.assert_array_equal(after.occupied, occupied)
    np.testing.assert_array_equal(owners(after), expected.sample[occupied])
    assert is_consistent(after, before).all()
    dropped = int((found["target"] == NONE).sum())
    lost = {"dropped": dropped, "stolen": expected.stolen, "overflow": expected.lost - expected.stolen}
    counters = passes.counters()
    assert {name: counters[name] for name in lost} == lost
    nearest, farthest = extent_of(after, by_sample(found, "distance", before), by_sample(found, "slope", before))
    np.testing.assert_array_equal(passes.extent()[0], nearest)
    np.testing.assert_array_equal(passes.extent()[1], farthest)


def test_the_order_of_the_list_and_of_work_items_does_not_matter(device, other_groups, scene):
    before = content_of(PIXELS, 12, part=0.9)
    passes, _, after = reprojected(device, scene, before)
    extent = passes.extent()
    found = passes.find(CAMERA)
    order = np.random.default_rng(2).permutation(len(found["samples"]))
    assert_same(passes.fill_slots({name: values[order] for name, values in found.items()}), after)
    other, _, again = reprojected(other_groups, objects(), before)
    assert_same(again, after)
    for values in (passes.extent(), other.extent()):
        np.testing.assert_array_equal(values, extent)


def in_child(threads: int, variant: str, runs: int) -> bytes:
    """What `contended` returns in a process of its own: PoCL fixes its number of threads once in a process."""
    environment = {k: v for k, v in os.environ.items() if k not in ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")}
    environment["PYTHONPATH"] = os.pathsep.join(p or os.getcwd() for p in sys.path)
    code = f"import cache_model; print(cache_model.contended({threads}, {variant!r}, {runs}))"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_one_and_two_threads_leave_the_same():
    one, two = in_child(1, "deterministic", 1), in_child(2, "deterministic", 3)
    assert one == two
    assert b"'samples': 0" not in one


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_two_passes_never_mix_samples_up():
    assert b"'inconsistent': 0," in in_child(2, "two-pass", 10)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    ("slots", "size"), [(1, SIZE), (12, (3, 5)), (12, SIZE), (16, SIZE), (17, (1, 1)), (17, SIZE), (32, SIZE)]
)
@pytest.mark.parametrize("part", [0.4, 1.0])
def test_no_sample_is_lost_uncounted(device, scene, variant, slots, size, part):
    before = content_of(size[0] * size[1], slots, part=part)
    passes, found, after = reprojected(device, scene, before, size=size, variant=variant)
    assert_none_uncounted(passes, after, before)
    counters = passes.counters()
    assert counters["dropped"] == (found["target"] == NONE).sum()
    if variant != "single-pass":
        assert is_consistent(after, before).all()
    expected = choose(found, slots, size[0] * size[1])
    most = (expected.sample != NONE).sum(axis=0)
    assert (after.occupied.sum(axis=0) <= most).all()
    assert (after.visible.sum(axis=0) <= choose_visible(found, slots, size[0] * size[1])).all()
    if is_exact(device, variant):
        np.testing.assert_array_equal(after.occupied.sum(axis=0), most)
        assert counters["overflow"] + counters["stolen"] == expected.lost


def is_exact(device, variant: str) -> bool:
    """Not so is the single pass on several threads: a visible sample may take the slot of an invisible one, though one is free."""
    return device.threads == 1 or variant != "single-pass"


def choose_visible(found, slots: int, pixels: int) -> np.ndarray:
    """(pixels,): the most visible samples that each pixel can keep."""
    arrives = found["target"][(found["samples"] >= VISIBLE) & (found["target"] != NONE)]
    return np.minimum(np.bincount(arrives, minlength=pixels), slots)


@pytest.mark.parametrize("variant", VARIANTS)
def test_visible_samples_come_before_invisible_ones(device, scene, variant):
    """Whoever came first: a pixel keeps as many visible samples as arrived, as far as there is room."""
    before = content_of(PIXELS, 12, part=0.9, seen=0.3)
    passes, found, after = reprojected(device, scene, before, variant=variant)
    most = choose_visible(found, 12, PIXELS)
    kept = after.visible.sum(axis=0)
    assert passes.counters()["overflow"] > 0
    assert (kept <= most).all()
    if variant == "deterministic" or device.threads == 1:
        np.testing.assert_array_equal(kept, most)


@pytest.mark.parametrize("variant", VARIANTS)
def test_extents_do_not_depend_on_the_variant(device, scene, variant):
    """Where there is room for all, all variants keep the same samples."""
    before = content_of(PIXELS, 32, part=0.03, seen=0.7 if is_exact(device, variant) else 1.0)
    passes, found, after = reprojected(device, scene, before, variant=variant)
    assert not choose(found, 32, PIXELS).lost
    np.testing.assert_array_equal(np.sort(owners(after)), np.sort(found["samples"][found["target"] != NONE] & ~VISIBLE))
    extent = passes.extent()
    expected = extent_of(after, by_sample(found, "distance", before), by_sample(found, "slope", before))
    for ours, theirs in zip(extent, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert (extent[0] == 2**64 - 1).any() and (extent[1] == 0x7F800000).any()


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("slots", [1, 12, 17, 32])
def test_all_samples_in_one_pixel(device, scene, variant, slots):
    before = content_of(PIXELS, slots, part=1.0, seen=0.02)
    passes = Reprojection(device, scene, SIZE, slots, variant)
    passes.put(before)
    found = passes.find(CAMERA)
    found["target"][:] = 5
    after = passes.fill_slots(found)
    visible = int((found["samples"] >= VISIBLE).sum())
    assert (after.occupied.sum(axis=0) == np.where(np.arange(PIXELS) == 5, slots, 0)).all()
    counters = passes.counters()
    assert counters["overflow"] + counters["stolen"] == before.occupied.sum() - slots - counters["dropped"]
    if variant == "deterministic":
        assert_chosen(passes, found, after, before, choose(found, slots, PIXELS))
        assert after.visible.sum() == min(visible, slots)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("superresolution", [3, 5])
def test_places_within_the_pixel_are_slots(device, scene, variant, superresolution):
    m, slots = superresolution, superresolution**2
    before = content_of(PIXELS, slots, part=0.6)
    passes, found, after = reprojected(device, scene, before, variant=variant, superresolution=m)
    here = found["target"] != NONE
    where = project(objects(), CAMERA, SIZE, before.first_hit.reshape(-1, 4)[found["samples"] & ~VISIBLE][here])
    x, y = where.x % 1 * m, where.y % 1 * m
    off = (np.abs(x - np.round(x)) > 0.01) & (np.abs(y - np.round(y)) > 0.01)
    np.testing.assert_array_equal(found["cell"][here][off], (np.floor(y) * m + np.floor(x))[off])
    expected = choose(found, slots, PIXELS)
    np.testing.assert_array_equal(after.occupied, expected.sample != NONE)
    assert_none_uncounted(passes, after, before)
    assert passes.counters()["overflow"] + passes.counters()["stolen"] == expected.lost
    if variant == "deterministic":
        assert_chosen(passes, found, after, before, expected)


@pytest.mark.parametrize("variant", VARIANTS)
def test_without_radiance(device, scene, variant):
    """First hits and masks are the same as with it."""
    before = content_of(PIXELS, 12, part=0.7)
    with_it = reprojected(device, scene, before, variant=variant)[2]
    passes, _, without = reprojected(device, scene, before, variant=variant, has_radiance=False)
    assert not any(name.startswith("shading") for name in passes.arrays)
    if device.threads == 1 or variant == "deterministic":
        np.testing.assert_array_equal(without.mask, with_it.mask)
        np.testing.assert_array_equal(without.first_hit[without.occupied], with_it.first_hit[with_it.occupied])
    assert_none_uncounted(passes, without, before)


@pytest.mark.parametrize("variant", VARIANTS)
def test_age_saturates_and_leaves_the_count_alone(device, scene, variant):
    before = content_of(PIXELS, 1, part=1.0)
    age = np.array([0, 1, 0x7FFF, 0xFFFE, 0xFFFF], np.uint32)[np.arange(PIXELS) % 5]
    before.shading[0, :, 3] = age << np.uint32(16) | np.uint32(0xFFFF)
    after = reprojected(device, scene, before, variant=variant)[2]
    words = after.shading[after.occupied]
    assert set(age[words[:, 0]]) == set(age)
    np.testing.assert_array_equal(words[:, 3] & 0xFFFF, 0xFFFF)
    np.testing.assert_array_equal(words[:, 3] >> 16, np.minimum(age[words[:, 0]] + 1, 0xFFFF))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(targets=st.lists(st.sampled_from([0, 1, 2, 7, NONE]), min_size=1, max_size=80), seed=st.integers(0, 99))
@pytest.mark.parametrize("slots", [1, 17])
def test_any_crowd(device, scene, slots, targets, seed):
    """Few pixels, and as many samples as there may be: what the deterministic variant keeps, and what the others count."""
    pixels = 45
    before = content_of(pixels, slots, part=len(targets) / (pixels * slots) if slots == 17 else 1.0, seed=seed)
    for variant in VARIANTS:
        passes = Reprojection(device, scene, (9, 5), slots, variant)
        passes.put(before)
        found = passes.find(CAMERA)
        found["target"] = np.resize(np.array(targets, np.uint32), len(found["samples"]))
        after, expected = passes.fill_slots(found), choose(found, slots, pixels)
        assert_none_uncounted(passes, after, before)
        if is_exact(device, variant):
            np.testing.assert_array_equal(after.occupied, expected.sample != NONE)
        if variant == "deterministic":
            assert_chosen(passes, found, after, before, expected)
        passes.release()
