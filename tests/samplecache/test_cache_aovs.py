"""What a sample cache says of itself: AOVs and moments, against NumPy from the cache's own arrays, and the path tracer's AOVs."""

from dataclasses import replace

import numpy as np
import pytest
from cache_renders import along, cached, counters, held, one_device, orbit, yard
from helpers import make_mesh
from render_helpers import MODELLED, checkered, floor, grey, lit, render, view

from clcache.scene.model import Environment, Material, TextureUse

SIZE = (30, 22)  # neither is a multiple of 4
HALF_WEIGHT = 16  # the count at which a sample has half the weight that it can have
LEAST_ALBEDO = 0.05
LIMIT = 3.9  # standard deviations: significance 1e-4; all seeds are fixed
BOOKS = ("samples", "occupancy", "visible", "age", "variance")
SURFACES = ("albedo", "N", "Z")


@pytest.fixture(autouse=True, scope="module")
def compiled_once():
    with one_device():
        yield


def still():
    return yard(moving=False)


def wall(*materials):
    """Rectangles side by side in the plane z = 0 that fill the view, their normals along z."""
    many = len(materials)
    edge = np.linspace(-3, 3, many + 1)
    corner = np.array([[[a, -3, 0], [b, -3, 0], [b, 3, 0], [a, 3, 0]] for a, b in zip(edge, edge[1:], strict=False)])
    triangles = 4 * np.arange(many)[:, None, None] + [[0, 1, 2], [0, 2, 3]]
    mesh = make_mesh(corner.reshape(-1, 3), triangles.reshape(-1, 3))
    mesh.material[:] = np.repeat(np.arange(many), 2)
    return lit(mesh, camera=view((0, 0, 3), (0, 0, 0)), materials=materials, environment=(1, 1, 1))


def aov(frame, name, eye="mono"):
    """(pixels,) or (pixels, 3) float64."""
    values = frame.aov(name, eye).astype(float)
    return values.reshape(-1, *values.shape[2:])


def towards(scene, camera, first_hit):
    """(slots, pixels, 3): from the camera to the stored points, in the camera's own axes, in float64; of the background 0. Normals
    in the world, on the camera's side, and albedos."""
    is_far = first_hit[..., 3] == 0xFFFFFFFF
    point, normal, albedo = np.zeros((3, *first_hit.shape[:2], 3))
    u, v = (first_hit[..., k] & 0xFFFFFF for k in (0, 1))
    for number, instance in enumerate(scene.instances):
        own, mesh = ~is_far & (first_hit[..., 3] == number), scene.meshes[instance.mesh]
        matrix = np.asarray(instance.transform).astype(np.float32).astype(float)
        a, b, c = (
            mesh.positions.astype(float)[mesh.triangles[first_hit[own, 2], k]] @ matrix[:, :3].T + matrix[:, 3]
            for k in range(3)
        )
        s, t = (w[own, None] / 0xFFFFFF for w in (u, v))
        point[own] = a + s * (b - a) + t * (c - a) - camera.transform[:, 3]
        across = np.cross(b - a, c - a)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        normal[own] = np.where((across * point[own]).sum(axis=1, keepdims=True) > 0, -across, across)
        albedo[own] = np.array([m.base_color for m in scene.materials])[mesh.material[first_hit[own, 2]]]
    return point @ camera.transform[:, :3], normal, albedo


# Books


@pytest.mark.parametrize(
    "options", [{}, {"slots": 20, "target": 9, "tracing": "multi"}, {"shading_rate": 0.2, "shading": "adaptive"}]
)
def test_counts_against_the_caches_arrays(options):
    """Along a camera's way, so that samples differ in age, count and visibility."""
    renderer = cached(along(still(), orbit(6)), size=SIZE, aovs=BOOKS, bounces=1, **options)
    for frame in renderer.frames(0, 6):
        h = held(renderer)
        np.testing.assert_array_equal(aov(frame, "occupancy"), h.occupied.sum(axis=0))
        np.testing.assert_array_equal(aov(frame, "visible"), h.visible.sum(axis=0))
        np.testing.assert_array_equal(
            aov(frame, "samples"), np.where(h.visible & ~h.background, h.count, 0).sum(axis=0)
        )
        ages = np.where(h.visible, h.age, 0).sum(axis=0) / h.visible.sum(axis=0)
        np.testing.assert_allclose(aov(frame, "age"), ages, rtol=1e-6)
    assert len(np.unique(aov(frame, "samples"))) > 5
    assert (aov(frame, "visible") < aov(frame, "occupancy")).any()
    assert 0 < aov(frame, "age").mean() < 5


@pytest.mark.parametrize("demodulate", [False, True])
def test_variance_against_the_caches_arrays(demodulate):
    """Of the weighted mean of a pixel's samples, from their spread about it; infinite where less than two were shaded."""
    scene = along(still(), orbit(4))
    renderer = cached(scene, size=SIZE, aovs=BOOKS, bounces=1, target=6, demodulate=demodulate)
    for frame in renderer.frames(0, 4):
        h = held(renderer)
        _, _, albedo = towards(scene, frame.cameras["mono"], h.first_hit)
        albedo = np.maximum(albedo, LEAST_ALBEDO) if demodulate else np.ones_like(albedo)
        seen = h.visible & ~h.background
        value = np.where(seen[..., None], h.radiance * albedo, 0)
        weight = np.where(seen, h.count / (h.count + HALF_WEIGHT), 0)[..., None]
        total, many = weight.sum(axis=0), (weight > 0).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = value - (weight * value).sum(axis=0) / total
            expected = (weight**2 * away**2).sum(axis=0) / total**2 * many / (many - 1)
        expected = np.where(many > 1, expected, np.inf)
        plain = ~(h.visible & h.background).any(axis=0)
        assert plain.sum() > 100
        size = (np.abs(value).max(axis=0) ** 2)[plain]
        found = aov(frame, "variance")[plain]
        np.testing.assert_array_equal(np.isinf(found), np.isinf(expected[plain]))
        finite = np.isfinite(found)
        found, expected, size = found[finite], expected[plain][finite], size[finite]
        assert (np.abs(found - expected) <= 1e-5 * found + 1e-6 * size).all()
    assert np.isfinite(aov(frame, "variance")).any()


def test_variance_of_one_sample_is_unknown():
    """In the first frame nothing is known, with one slot nothing ever."""
    for options in ({}, {"slots": 1, "target": 1}):
        renderer = cached(wall(grey(0.5)), size=SIZE, aovs=BOOKS, **options)
        frames = list(renderer.frames(0, 4))
        assert np.isinf(frames[0].aov("variance", "mono")).all()
        assert np.isinf(frames[3].aov("variance", "mono")).all() == ("slots" in options)


def test_variance_is_that_of_the_image():
    """Where every pixel estimates the same, how much they differ is what each of them says of itself."""
    sky = np.random.default_rng(3).lognormal(0, 1.5, (8, 16, 3)).astype(np.float32)
    camera = view((0, 2, 0), (0, 0, 0), up=(0, 0, 1))
    scene = lit(floor(20), camera=camera, materials=[grey(0.5)], environment=Environment(sky))
    settings = {"pathtrace.sampler": MODELLED}
    renderer = cached(scene, size=(48, 40), bounces=0, aovs=BOOKS, tracing="multi", settings=settings)
    frame = list(renderer.frames(0, 24))[-1]
    color, said = frame.color["mono"].reshape(-1, 3).astype(float), aov(frame, "variance")
    assert np.isfinite(said).all()
    squares = (color - color.mean(axis=0)) ** 2
    assert squares.mean() > 1e-4 * color.mean() ** 2
    away = squares.mean(axis=0) - said.mean(axis=0)
    error = np.hypot(squares.std(axis=0), said.std(axis=0)) / np.sqrt(len(color))
    assert (np.abs(away) < LIMIT * error).all()
    assert (error < 0.1 * said.mean(axis=0)).all()


def test_age_of_a_still_view():
    """A frame older in each frame, as soon as there are samples enough."""
    renderer = cached(wall(grey(0.5), grey(0.7)), size=SIZE, aovs=BOOKS, shading="uniform", shading_rate=1.0)
    frames = list(renderer.frames(0, 9))
    assert (frames[0].aov("age", "mono") == 0).all()
    settled = next(k for k in range(1, 9) if counters(frames[k])["created"] == counters(frames[k])["purged"] == 0)
    assert 1 <= settled <= 5
    for before, after in zip(frames[settled - 1 :], frames[settled:], strict=False):
        np.testing.assert_allclose(aov(after, "age"), aov(before, "age") + 1, rtol=1e-6)
        assert (aov(after, "samples").sum() - aov(before, "samples").sum()) == SIZE[0] * SIZE[1]
    assert (aov(frames[1], "age") == 0.5).all()


# What was traced


@pytest.mark.parametrize("tracing", ["single", "multi", "adaptive"])
def test_the_traced_part_adds_up_to_the_rays(tracing):
    """On a still view, on which no sample fails, so that each is traced but once."""
    renderer = cached(still(), size=SIZE, aovs=("trace", "occupancy"), tracing=tracing)
    for number, frame in enumerate(renderer.frames(0, 20)):
        part, occupied = aov(frame, "trace"), aov(frame, "occupancy")
        traced = part * occupied
        np.testing.assert_allclose(traced, np.round(traced), atol=1e-5)
        assert part.min() >= 0 and part.max() <= 1
        count = counters(frame)
        assert round(traced.sum()) == count["created"] + count["retraced"]
        if tracing == "multi" or number == 0:
            assert (part == 1).all()
        if tracing == "single" and number > 8:
            np.testing.assert_array_equal(np.round(traced), 1)


def test_of_a_flat_wall_one_pixel_of_each_block_is_traced():
    """Each once in 16 updates. Seen from afar, as pixels that subtend much are taken for edges where they are not."""
    scene = replace(wall(grey(0.5)), camera=view((0, 0, 30), (0, 0, 0), 4))
    renderer = cached(scene, size=(24, 16), aovs=("trace",))
    frames = list(renderer.frames(0, 40))[24:]
    traced = np.array([f.aov("trace", "mono") > 0 for f in frames])
    np.testing.assert_array_equal(traced.sum(axis=0), 1)
    np.testing.assert_array_equal(traced.reshape(16, 4, 4, 6, 4).sum(axis=(2, 4)), 1)


# Surfaces


def test_surfaces_against_the_caches_arrays():
    """Albedos and normals are means over all visible samples, the background's being 0; depth is along the axis, of the nearest."""
    scene = along(still(), orbit(4))
    renderer = cached(scene, size=SIZE, aovs=SURFACES, bounces=0)
    for frame in renderer.frames(0, 4):
        h = held(renderer)
        place, normal, albedo = towards(scene, frame.cameras["mono"], h.first_hit)
        seen = (h.visible & ~h.background)[..., None]
        assert 0.02 < (h.visible & h.background).sum() / h.visible.sum() < 0.98
        mean = np.where(seen, albedo, 0).sum(axis=0) / h.visible.sum(axis=0)[:, None]
        np.testing.assert_allclose(aov(frame, "albedo"), mean, rtol=1e-5)
        turned = np.where(seen, normal, 0).sum(axis=0)
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        np.testing.assert_allclose(aov(frame, "N"), turned / np.where(length > 0, length, 1), atol=2e-5)
        depth = np.where(seen[..., 0], -place[..., 2], np.inf).min(axis=0)
        np.testing.assert_allclose(aov(frame, "Z"), depth, rtol=1e-5)


def test_surfaces_are_the_path_tracers():
    """The same in pixels that show one surface; beside that the image's mean, Z-test over independent caches."""
    scene = wall(Material("a", (0.8, 0.2, 0.1)), Material("b", (0.1, 0.5, 0.9)), grey(0.3))
    truth = render(scene, SIZE, 256, aovs=SURFACES)
    runs = []
    for seed in range(12):
        frame = list(cached(scene, size=SIZE, seed=seed, aovs=SURFACES, bounces=0).frames(0, 6))[-1]
        runs.append(aov(frame, "albedo"))
        np.testing.assert_allclose(aov(frame, "N"), aov(truth, "N"), atol=1e-6)
        np.testing.assert_allclose(aov(frame, "Z"), aov(truth, "Z"), rtol=1e-6)
    runs, albedo = np.array(runs), aov(truth, "albedo")
    palette = np.array([m.base_color for m in scene.materials])
    is_one = (np.abs(albedo[:, None] - palette).max(axis=2) < 1e-4).any(axis=1)
    assert 0.05 < 1 - is_one.mean() < 0.5
    np.testing.assert_allclose(runs[:, is_one], np.broadcast_to(albedo[is_one], runs[:, is_one].shape), atol=1e-4)
    of_edges = runs[:, ~is_one].mean(axis=1)
    away = of_edges.mean(axis=0) - albedo[~is_one].mean(axis=0)
    assert (np.abs(away) < LIMIT * of_edges.std(axis=0, ddof=1) / np.sqrt(len(runs)) + 1e-3).all()


def test_pictures_are_read_as_sharply_as_the_path_tracer_does():
    """Pixels are smaller than texels, so that most show one: the same albedo as the path tracer's."""
    material = Material("tiles", (1.0, 1.0, 1.0), base_color_texture=TextureUse(0))
    camera = view((0, 2, 0), (0.1, 0, 0.1), 40, up=(0, 0, 1))
    scene = lit(floor(4), camera=camera, materials=[material], textures=[checkered(8)], environment=(1, 1, 1))
    truth = aov(render(scene, SIZE, 64, aovs=SURFACES), "albedo")
    ours = aov(list(cached(scene, size=SIZE, aovs=SURFACES, bounces=0).frames(0, 5))[-1], "albedo")
    assert truth.std() > 0.1
    assert np.sqrt(((ours - truth) ** 2).mean()) < 0.2 * truth.std()


def test_where_nothing_is_hit():
    """As the path tracer says: no depth, no surface."""
    scene = lit(floor(1), camera=view((0, 1, 0), (0, 2, -1)), environment=(1, 1, 1))
    truth, frame = (
        render(scene, SIZE, 4, aovs=SURFACES),
        next(cached(scene, size=SIZE, aovs=(*SURFACES, *BOOKS)).frames(0, 1)),
    )
    for name in SURFACES:
        np.testing.assert_array_equal(aov(frame, name), aov(truth, name), err_msg=name)
    assert (aov(frame, "Z") == np.inf).all()
    assert (aov(frame, "samples") == 0).all()
    assert (aov(frame, "visible") == 1).all()


# Moments, for stereo blending


@pytest.mark.parametrize("options", [{}, {"demodulate": True}, {"target": 9, "tracing": "multi"}])
def test_moments_against_the_caches_arrays(options):
    """Each eye's: mean, count, mean square about the mean, all weighted by the samples' counts, the background by as much as the
    others have on average; and the nearest one's reciprocal depth."""
    scene = along(still(), orbit(4))
    renderer = cached(scene, size=SIZE, stereo=True, stereo_blend="samples", bounces=1, **options)
    for frame in renderer.frames(0, 4):
        for eye in ("left", "right"):
            h = held(renderer, eye)
            place, _, albedo = towards(scene, frame.cameras[eye], h.first_hit)
            far, near = h.visible & h.background, h.visible & ~h.background
            factor = np.where(near[..., None], np.maximum(albedo, LEAST_ALBEDO), 1) if "demodulate" in options else 1
            value = np.where(h.visible[..., None], h.radiance * factor, 0)
            count = np.where(near, h.count, 0).sum(axis=0)
            with np.errstate(invalid="ignore"):
                of_far = np.where(near.any(axis=0), count / near.sum(axis=0), 1.0)
            weight = np.where(near, h.count, np.where(far, of_far, 0))
            total = weight.sum(axis=0)
            part = (weight / np.where(total > 0, total, 1))[..., None]
            mean = (part * value).sum(axis=0)
            spread = (part * (value - mean) ** 2).sum(axis=0)
            nearest = np.where(near, 1 / np.where(near, -place[..., 2], 1), 0).max(axis=0)
            moments = renderer._graph.of(eye)["moments"].get().astype(float)
            np.testing.assert_allclose(moments[:, :3], mean, rtol=1e-5, atol=1e-7)
            np.testing.assert_allclose(moments[:, 3], total, rtol=1e-6)
            np.testing.assert_allclose(moments[:, 4:7], spread, rtol=1e-4, atol=1e-6 * value.max() ** 2)
            np.testing.assert_allclose(moments[:, 7], nearest, rtol=1e-5)
    assert far.any() and (near.any(axis=0) & far.any(axis=0)).any()
    assert (spread > 0.01).any()
