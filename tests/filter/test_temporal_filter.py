"""The temporal filters' kernels against the model of `filter_model.py`, and at extremes."""

import numpy as np
import pytest
from filter_model import MARGIN, RUN, Kernels, Model, still
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter, minimum_filter

SIZES = ((1, 1), (3, 5), (16, 3), (17, 9), (33, 12))
KINDS = [
    *({"kind": "taa", "validation": name} for name in ("none", "reject", "clamp", "clip")),
    *(
        {"kind": "varianceblend", "estimate": estimate, "per_channel": per_channel}
        for estimate in ("published", "corrected")
        for per_channel in (False, True)
    ),
]
NAMES = ["-".join(str(v) for v in kind.values()) for kind in KINDS]
HISTORIES = ("bilinear", "bicubic")


def frames(size, count, seed, holes=0.0, scale=1.0):
    """Images with edges and noise, and motions of a few pixels that are multiples of 1/64, so that float32 has the places exactly;
    some have no history, and beside some was something nearer. holes: the part of the pixels that are not finite."""
    rng, shape = np.random.default_rng(seed), size[::-1]
    scene = rng.uniform(0, 1, (1, 1, 3)) + (rng.random((*shape, 1)) < 0.3) * rng.uniform(0, 3, (1, 1, 3))
    for _ in range(count):
        color = scale * np.maximum(scene + rng.normal(0, 0.2, (*shape, 3)), 0)
        color[rng.random(shape) < holes] = [0.5, np.nan, np.inf]
        motion = np.round(rng.normal(0, 1.5, (*shape, 2)) * 64) / 64
        motion[rng.random(shape) < 0.2] = 0
        motion[rng.random(shape) < 0.05] = np.inf
        # No two finite ones alike; 1 and 1.03 may be of one surface, and 1.1 is of another.
        depth = rng.choice([1.0, 1.03, 1.1, 2.0, 3.5, np.inf], shape) + 1e-3 * rng.random(shape)
        depth *= rng.choice([1, 1, -1], shape)
        yield np.float32(color), motion, np.float32(depth)


def assert_same(device, model, sequence, tolerance=2e-5):
    """Frame by frame. A threshold that only rounding crosses, which `reject` and clamping have, may part the model and the
    kernels; so both go on from the kernels' frames as far as they can be told."""
    kernels = Kernels(device, model)
    for frame in sequence:
        image, alpha, count = kernels.step(*frame)
        expected, expected_alpha, expected_count = model.step(*frame)
        color = frame[0]
        size = max(1.0, float(np.nanmax(np.where(np.isfinite(color), color, 0))))
        np.testing.assert_allclose(alpha, expected_alpha, atol=50 * tolerance)
        np.testing.assert_allclose(image, expected, atol=tolerance * size)
        np.testing.assert_allclose(count, expected_count, rtol=100 * tolerance)


@pytest.mark.parametrize("history", HISTORIES)
@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_the_whole_filter(device, kind, size, history):
    """On random images and motions, at edges, of images smaller than a neighbourhood."""
    assert_same(device, Model(**kind, size=size, history=history), frames(size, 6, 1))


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_from_where_to_where_a_frame_reaches(device, size):
    """The least and the greatest depth of the 3x3 pixels about each, of those that there are; for the next frame."""
    kernels = Kernels(device, Model("varianceblend", size))
    inside = np.s_[MARGIN : MARGIN + size[1], RUN : RUN + size[0]]
    found = []
    for color, motion, depth in frames(size, 2, 8):
        kernels.step(color, motion, depth)
        arrays = kernels.graph.of()
        reach = [
            arrays[name].get().reshape(size[1] + 2 * MARGIN, -1, 2)[inside] for name in ("depths", "depths_before")
        ]
        np.testing.assert_array_equal(reach[0][..., 0], minimum_filter(np.abs(depth), 3, mode="nearest"))
        np.testing.assert_array_equal(reach[0][..., 1], maximum_filter(np.abs(depth), 3, mode="nearest"))
        found.append(reach)
    np.testing.assert_array_equal(found[1][1], found[0][0])


@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_pixels_that_are_not_finite(device, kind):
    """They are left out, show the history, and are black without; nothing else is touched."""
    size = (19, 8)
    assert_same(device, Model(**kind, size=size), frames(size, 6, 2, holes=0.15))


@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_one_bad_frame_does_not_spread(device, kind):
    """A frame of nothing but infinities and NaN shows the history; the next one goes on as if it had not been."""
    size = (18, 6)
    model = Model(**kind, size=size, history="bilinear")
    with_it, without = Kernels(device, model), Kernels(device, model)
    last = np.zeros((*size[::-1], 3))
    for number, (color, *_) in enumerate(frames(size, 5, 3)):
        motion = still(size)
        before = without.step(color, motion)
        if number == 3:
            bad = np.full_like(color, np.nan)
            bad[::2] = np.inf
            bad[::3] = -np.inf
            shown, alpha, _ = with_it.step(bad, motion)
            np.testing.assert_array_equal(alpha, 0)
            np.testing.assert_array_equal(shown, last)
        after = with_it.step(color, motion)
        last = after[0]
        for a, b in zip(before, after, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_a_history_that_is_not_finite_is_none(device, kind):
    """Of a first frame that is not, nothing is left in the second."""
    size = (18, 6)
    kernels = Kernels(device, Model(**kind, size=size))
    color = np.full((*size[::-1], 3), np.nan, np.float32)
    color[2, 3] = 1.0
    image, alpha, count = kernels.step(color, still(size))
    known = np.zeros(size[::-1], bool)
    known[2, 3] = True
    np.testing.assert_array_equal(image, known[..., None] * np.ones(3))
    np.testing.assert_array_equal(alpha, known)
    np.testing.assert_array_equal(count, known)
    image, alpha, count = kernels.step(np.full_like(color, 0.25), np.full((*size[::-1], 2), 0.4))
    assert (image[alpha == 1] == 0.25).all()
    assert (alpha == 1).mean() > 0.9
    assert np.isfinite(image).all()
    assert (count >= 1).all()


@pytest.mark.parametrize("history", HISTORIES)
@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_no_motion_reads_the_texel_itself(device, kind, history):
    """A frame without samples shows its history, to the bit."""
    size, rng = (21, 7), np.random.default_rng(4)
    kernels = Kernels(device, Model(**kind, size=size, history=history))
    mean = np.float32(rng.lognormal(0, 3, (*size[::-1], 3)))
    kernels.set_history(mean, rng.integers(1, 50, size[::-1]))
    image, _, _ = kernels.step(np.full_like(mean, np.nan), still(size))
    np.testing.assert_array_equal(image, mean)


@pytest.mark.parametrize("history", HISTORIES)
def test_whole_pixels_of_motion_read_texels(device, history):
    size, rng = (21, 7), np.random.default_rng(5)
    kernels = Kernels(device, Model("taa", size, history=history))
    mean = np.float32(rng.uniform(0, 1, (*size[::-1], 3)))
    kernels.set_history(mean, 3.0)
    nothing = np.full_like(mean, np.nan)
    image, _, count = kernels.step(nothing, still(size) + [2, -1])
    np.testing.assert_allclose(image[1:, :-2], mean[:-1, 2:], rtol=1e-6)
    np.testing.assert_array_equal(image[0], 0)  # that was above the image
    np.testing.assert_array_equal(count[:, -2:], 0)


@pytest.mark.parametrize("history", HISTORIES)
def test_history_does_not_ring(device, history):
    """Beside a step of a million, cubic weights overshoot; what is read stays within the pixels that it is read from."""
    size = (24, 6)
    kernels = Kernels(device, Model("taa", size, history=history))
    mean = np.zeros((*size[::-1], 3))
    mean[:, 12:] = 1e6
    mean[3, 5] = 1e6
    kernels.set_history(mean, 4.0)
    for part in (0.1, 0.5, 0.9):
        kernels.set_history(mean, 4.0)
        image, _, count = kernels.step(np.full_like(mean, np.nan), still(size) + [part, part])
        assert (image >= 0).all()
        assert (image <= 1e6).all()
        assert ((image > 0) & (image < 1e6)).any()
        assert (count[:-1, :-1] == 4).all()


@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
@pytest.mark.parametrize("value", [0.0, 1e-30, 1.0, 1e6, 1e19, 3e38])
def test_constants_stay(device, kind, value):
    """A constant image has no variance, however large: it stays as it is, and alpha is a weight. Squares of the last ones overflow."""
    size = (18, 5)
    kernels = Kernels(device, Model(**kind, size=size))
    color = np.full((*size[::-1], 3), value, np.float32)
    for _ in range(4):
        image, alpha, count = kernels.step(color, still(size) + [0.3, -0.2])
        np.testing.assert_allclose(image, color, rtol=1e-6)
        assert ((alpha >= 0) & (alpha <= 1)).all()
        assert np.isfinite(count).all()
    if kind.get("estimate") == "corrected":
        variance = kernels.graph.of()["variance"].get()
        assert np.sqrt(variance.max()) <= 1e-6 * value


def test_variance_of_large_numbers(device):
    """That of noise about 1e6 is what it is about 0."""
    size, rng = (64, 40), np.random.default_rng(6)
    noise = rng.normal(0, 8, (*size[::-1], 3)).round()  # exact at 1e6, too
    found = []
    for offset in (0, 1e6):
        kernels = Kernels(device, Model("varianceblend", size, per_channel=True))
        kernels.step(np.float32(noise + offset), still(size))
        found.append(kernels.graph.of()["variance"].get())
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5)
    assert 40 < found[0][found[0] > 0].mean() < 90


@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_a_cut_starts_anew(device, kind):
    """Where nothing was seen before, the frame is the new one."""
    size = (18, 5)
    kernels = Kernels(device, Model(**kind, size=size))
    for color, *_ in frames(size, 4, 7):
        image, alpha, count = kernels.step(color, np.full((*size[::-1], 2), np.inf))
        np.testing.assert_array_equal(image, color)
        np.testing.assert_array_equal(alpha, 1)
        np.testing.assert_array_equal(count, 1)


def test_taa_averages_until_it_has_as_many_samples(device):
    """1 / N at first, then the constant."""
    size = (4, 4)
    kernels = Kernels(device, Model("taa", size, alpha=0.25, validation="none"))
    weights = [kernels.step(np.full((4, 4, 3), k, np.float32), still(size))[1] for k in range(6)]
    np.testing.assert_allclose([w.mean() for w in weights], [1, 1 / 2, 1 / 3, 1 / 4, 1 / 4, 1 / 4], rtol=1e-5)


def test_equal_estimates_take_the_new_sample(device):
    """As published, 0 / 0 is 1; corrected, without any noise known, all samples count alike."""
    size, color = (5, 5), np.full((5, 5, 3), 0.7, np.float32)
    for estimate, expected in (("published", [1, 1, 1]), ("corrected", [1, 1 / 2, 1 / 3])):
        kernels = Kernels(device, Model("varianceblend", size, estimate=estimate))
        np.testing.assert_allclose([kernels.step(color, still(size))[1].mean() for _ in range(3)], expected, rtol=1e-5)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_weights_and_results_are_between(device, data):
    """Of any finite numbers: alpha in [0, 1], N at least 1, and each channel of a result between the new sample and the
    history's range."""
    size = (17, 3)
    kind = data.draw(st.sampled_from(KINDS))
    seed, digits = data.draw(st.integers(0, 2**32 - 1)), data.draw(st.integers(0, 38))
    rng, shape = np.random.default_rng(seed), (*size[::-1], 3)
    model = Model(**kind, size=size, history=data.draw(st.sampled_from(HISTORIES)))
    color = np.float32(rng.choice([-1.0, 1.0, 1.0], shape) * 10.0 ** rng.uniform(-digits, digits, shape))
    past = np.float32(rng.choice([-1.0, 1.0, 1.0], shape) * 10.0 ** rng.uniform(-digits, digits, shape))
    kernels = _kernels(device, model)
    kernels.set_history(past, rng.integers(1, 1000, shape[:2]), min(float(np.abs(past).mean()), 1e19) ** 2)
    moves = data.draw(st.booleans())
    image, alpha, count = kernels.step(color, np.float32(moves * rng.uniform(-0.4, 0.4, (*shape[:2], 2))))
    assert ((alpha >= 0) & (alpha <= 1)).all()
    assert (count >= 0.999).all()
    low, high = (past.min(axis=(0, 1)), past.max(axis=(0, 1))) if moves else (past, past)
    if kind.get("validation") in ("clamp", "clip"):  # which may bring the history elsewhere among the neighbours
        low, high = np.minimum(low, color.min(axis=(0, 1))), np.maximum(high, color.max(axis=(0, 1)))
    assert (image >= np.minimum(low, color)).all()
    assert (image <= np.maximum(high, color)).all()


_BUILT: dict = {}


def _kernels(device, model):
    """Those of a model, built once."""
    key = (id(device), *(str(v) for v in model.settings.values()), model.kind, model.size)
    return _BUILT.setdefault(key, Kernels(device, model))
