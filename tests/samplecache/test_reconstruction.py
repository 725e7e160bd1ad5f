"""From samples to images: the weighted mean of each pixel's, against NumPy, closed forms and the path tracer."""

import numpy as np
import pytest
from cache_renders import along, cached, held, one_device, orbit, yard
from helpers import icosphere, make_mesh
from render_helpers import MODELLED, ball, floor, grey, image, lit, render, view, z_of_mean
from scipy import stats

from clcache.frame import Repeat
from clcache.methods import PathState
from clcache.random import stream_key
from clcache.renderer import camera_record
from clcache.scene.model import Environment, Material, Texture, TextureUse

HALF_WEIGHT = 16  # the count at which a sample has half the weight that it can have
LEAST_ALBEDO = 0.05
MOST = 65_534
SIGNIFICANCE = 1e-4  # of every statistical test; all seeds are fixed
ALL = {"shading": "uniform", "shading_rate": 1.0}  # a sample of each pixel is shaded
SIZE = (30, 22)  # neither is a multiple of 4


@pytest.fixture(autouse=True, scope="module")
def compiled_once():
    with one_device():
        yield


def albedos(scene, first_hit):
    """(slots, pixels, 3): of the materials, which have no pictures; of the background 1."""
    table = np.zeros((len(scene.instances), max(len(m.triangles) for m in scene.meshes), 3))
    for number, instance in enumerate(scene.instances):
        mesh = scene.meshes[instance.mesh]
        table[number, : len(mesh.triangles)] = np.array([m.base_color for m in scene.materials])[mesh.material]
    is_far = first_hit[..., 3] == 0xFFFFFFFF
    found = table[np.where(is_far, 0, first_hit[..., 3]), np.where(is_far, 0, first_hit[..., 2])]
    return np.where(is_far[..., None], 1.0, found)


def blocks(size):
    """(pixels,): the number of each pixel's block of 4 x 4."""
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    return (y // 4 * -(-size[0] // 4) + x // 4).ravel()


def assert_averages(renderer, color, demodulate=False, fills=False):
    """The image is of surfaces the mean of the visible samples, weighted by count / (count + 16), and of surfaces and background
    the mean by number. Where no surface was shaded yet, that is of the block's samples, as much as light goes (demodulate), or
    the pixel is the mean of the block's other ones.

    Returns of how many pixels nothing was known.
    """
    h, color = held(renderer), color.reshape(-1, 3).astype(float)
    seen = h.visible & ~h.background
    albedo = np.maximum(albedos(renderer.scene, h.first_hit), LEAST_ALBEDO) if demodulate else np.ones_like(h.radiance)
    weight = np.where(seen, h.count / (h.count + HALF_WEIGHT), 0)[..., None]
    light = np.where(seen[..., None], h.radiance.astype(float), 0)
    surface = (weight * albedo * light).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-30)
    near, far = seen.sum(axis=0), (h.visible & h.background).sum(axis=0)
    empty, block = ~(weight[..., 0].any(axis=0) | (near == 0) & (far > 0)), blocks(renderer.size)
    assert (~empty & (far == 0)).sum() > 0.05 * len(empty)
    for pixel in np.flatnonzero(empty & near.astype(bool)) if fills and demodulate else []:
        in_block = block == block[pixel]
        total = weight[:, in_block].sum()
        of_block = (weight * light)[:, in_block].sum(axis=(0, 1)) / total if total else np.zeros(3)
        surface[pixel] = of_block * albedo[seen[:, pixel], pixel].mean(axis=0)
    sky = renderer.scene.environment.radiance[0, 0]
    expected = (near[:, None] * surface + far[:, None] * sky) / np.maximum(near + far, 1)[:, None]
    if not demodulate:
        for pixel in np.flatnonzero(empty):
            others = color[(block == block[pixel]) & ~empty]
            expected[pixel] = others.mean(axis=0) if fills and len(others) else 0
    np.testing.assert_allclose(color, expected, rtol=2e-5, atol=1e-7)
    return int(empty.sum())


def reconstruct(renderer, mask=None, shading=None):
    """Only the last passes once more, on this cache: the image."""
    arrays = renderer._graph.of("mono")
    for name, values in (("mask", mask), ("shading", shading)):
        if values is not None:
            arrays[name].set(values)
    passes = renderer._graph.passes
    after = next(i for i, p in enumerate(passes) if isinstance(p, Repeat) and p.name == "shading") + 1
    state = PathState(camera_record(renderer.scene.camera, renderer.size), stream_key(0, 0), 1)
    for p in passes[after:]:
        renderer._graph._run(p, arrays, state)
    return arrays["color"].get().reshape(*renderer.size[::-1], 3)


def all_surface():
    """A view without background: a ball, nearly black, over a floor."""
    camera = view((0.3, 4, 0.5), (0, 0, 0))
    return lit(floor(20), ball(0.7, 1, 1), camera=camera, materials=[grey(0.5), grey(0.02)], environment=(1, 1, 1))


# Against NumPy


@pytest.mark.parametrize("demodulate", [False, True])
@pytest.mark.parametrize("options", [{}, {"slots": 20, "target": 12, "tracing": "multi"}, {"slots": 1, "target": 1}])
def test_the_mean_of_the_visible_samples(demodulate, options):
    """Along a camera's way, in as many batches as the visible samples need; of a pixel's many samples, or of its only one."""
    renderer = cached(
        along(yard(moving=False), orbit(5)), size=SIZE, demodulate=demodulate, bounces=1, **ALL, **options
    )
    for frame in renderer.frames(0, 5):
        assert_averages(renderer, frame.color["mono"], demodulate)
    at_once = renderer._graph.of()["ray_length"].size
    assert held(renderer).visible.sum() > {1: 0, 12: 2, 20: 2}[options.get("slots", 12)] * at_once


@pytest.mark.parametrize("demodulate", [False, True])
@pytest.mark.parametrize("shading", ["uniform", "adaptive"])
def test_pixels_without_radiance_take_their_blocks(demodulate, shading):
    """Where fewer samples are shaded than there are pixels, from the first frame on."""
    scene = along(yard(moving=False), orbit(4))
    options = {"shading_rate": 0.1, "shading": shading, "demodulate": demodulate, "bounces": 1}
    renderer = cached(scene, size=SIZE, **options)
    filled = [assert_averages(renderer, f.color["mono"], demodulate, fills=True) for f in renderer.frames(0, 4)]
    assert filled[0] > 100 and filled[-1] > 20


def test_blocks_without_radiance_are_black():
    """As are pixels that no sample is seen in, where all are shaded."""
    scene, options = all_surface(), {"bounces": 1, "size": SIZE}
    for more in ({"shading_rate": 0.5}, {"shading_rate": 0.5, "demodulate": True}, {"demodulate": True} | ALL, ALL):
        renderer = cached(scene, **options, **more)
        next(renderer.frames(0, 1))
        arrays = renderer._graph.of("mono")
        assert reconstruct(renderer).max() > 0
        words = arrays["shading"].get()
        words[..., 3] = 0
        np.testing.assert_array_equal(reconstruct(renderer, shading=words), 0)
        words[..., 3] = 5
        assert reconstruct(renderer, shading=words).max() > 0
        if not more.get("demodulate"):
            np.testing.assert_array_equal(reconstruct(renderer, mask=np.zeros_like(arrays["mask"].get())), 0)


@pytest.mark.parametrize("demodulate", [False, True])
def test_weights_by_count(demodulate):
    """Of made-up caches: random radiance, all counts from none to the most."""
    renderer = cached(
        all_surface(), size=SIZE, demodulate=demodulate, bounces=0, target=6, slots=9, tracing="multi", **ALL
    )
    list(renderer.frames(0, 8))
    rng, shape = np.random.default_rng(4), renderer._graph.of()["shading"].shape
    words = np.zeros(shape, np.uint32)
    words[..., :3] = rng.lognormal(0, 3, (*shape[:2], 3)).astype(np.float32).view(np.uint32)
    counts = np.concatenate([rng.integers(0, 30, 40), [0] * 20, [MOST] * 5, rng.integers(30, MOST, 5)])
    words[..., 3] = rng.choice(counts, shape[:2]) | rng.integers(2**16, size=shape[:2]) << 16
    color = reconstruct(renderer, shading=words)
    assert assert_averages(renderer, color, demodulate) >= 0
    assert not held(renderer).background.any()
    assert held(renderer).visible.sum() > 4 * SIZE[0] * SIZE[1]


# Closed forms


@pytest.mark.parametrize("options", [{}, {"demodulate": True}, {"shading": "adaptive", "shading_rate": 0.3}])
def test_closed_furnace(options):
    """Inside a closed shape that shines everywhere the same and reflects the part a of it, radiance is e (1 + a + a^2 + ...):
    Z-test of the mean over the pixels."""
    emission, albedo, bounces = 0.7, 0.6, 2
    camera = view((0.1, 0.05, 0.2), (0.5, 0.3, -1), 70)
    scene = lit(icosphere(2), camera=camera, materials=[grey(albedo, emission)])
    settings = {"pathtrace.sampler": MODELLED, "pathtrace.roulette": 64}
    renderer = cached(scene, size=(48, 36), bounces=bounces, settings=settings, **options)
    expected = emission * np.sum(albedo ** np.arange(bounces + 2))
    for frame in renderer.frames(0, 9):
        color = frame.color["mono"]
    assert (z_of_mean(color, expected) < 3.9).all()
    np.testing.assert_allclose(color.mean(), expected, rtol=5e-3)


@pytest.mark.parametrize("demodulate", [False, True])
def test_a_white_ball_cannot_be_seen(demodulate):
    """In an environment that is the same everywhere; in every frame, as the camera moves, at its rim, too."""
    sky = (0.3, 1.0, 2.5)
    scene = along(lit(ball(1, 2), camera=orbit(1)[0], environment=sky), orbit(5))
    for frame in cached(scene, size=SIZE, demodulate=demodulate).frames(0, 5):
        np.testing.assert_allclose(frame.color["mono"], np.broadcast_to(sky, (*SIZE[::-1], 3)), rtol=1e-5)


@pytest.mark.parametrize("albedo", [0.0, 0.3])
def test_a_grey_ball(albedo):
    """A convex one reflects its albedo, Z-test over the pixels that show nothing else."""
    scene = lit(ball(1, 3), camera=view((0, 0, 4), (0, 0, 0)), materials=[grey(albedo)], environment=(1, 1, 1))
    renderer = cached(scene, size=(40, 40), settings={"pathtrace.sampler": MODELLED}, tracing="multi")
    color = list(renderer.frames(0, 10))[-1].color["mono"].reshape(-1, 3)
    on_ball = ~(held(renderer).visible & held(renderer).background).any(axis=0)
    assert on_ball.sum() > 300
    assert (z_of_mean(color[on_ball][None], albedo) < 3.9).all()


def test_silhouettes_show_as_much_of_the_background_as_there_is():
    """A shining triangle in the dark: at its edges, the part of each pixel that it covers, in every frame. Z-test of the mean over
    the edges' pixels, from independent caches."""
    mesh = make_mesh([[-1, -1.1, 0], [1.2, -0.9, 0], [0.1, 1.05, 0]], [[0, 1, 2]])
    scene = lit(mesh, camera=view((0, 0, 3), (0, 0, 0)), materials=[grey(0.0, 1.0)])
    covered = image(scene, (32, 24), spp=256)[..., 0]
    at_edge = (covered > 0.02) & (covered < 0.98)
    for demodulate in (False, True):
        runs = []
        for seed in range(8):
            frames = cached(scene, size=(32, 24), seed=seed, tracing="multi", demodulate=demodulate).frames(0, 9)
            runs.append([f.color["mono"][at_edge, 0].mean() for f in frames])
        away = np.array(runs) - covered[at_edge].mean()
        t = np.abs(away.mean(axis=0)) / (away.std(axis=0, ddof=1) / np.sqrt(len(runs)))
        assert (stats.t.sf(t[[1, 3, 8]], len(runs) - 1) > SIGNIFICANCE).all(), away.mean(axis=0)


# Pictures


def smooth_sky():
    """A picture with a bright spot."""
    rng = np.random.default_rng(3)
    radiance = rng.lognormal(0, 1, (8, 16, 3)).astype(np.float32)
    radiance[3, 7] = 20
    return Environment(radiance)


def welch(ours, theirs):
    """(pixels, channels): probabilities that the means of two stacks of independent images (runs, H, W, 3) are equal. A relative
    1e-5 is allowed for rounding."""
    ours, theirs = (np.asarray(images, float).reshape(len(images), -1, 3) for images in (ours, theirs))
    away = np.abs(ours.mean(axis=0) - theirs.mean(axis=0))
    away = np.maximum(away - 1e-5 * theirs.mean(axis=0), 0)
    a, b = (images.var(axis=0, ddof=1) / len(images) for images in (ours, theirs))
    freedom = (a + b) ** 2 / (a**2 / (len(ours) - 1) + b**2 / (len(theirs) - 1) + 1e-60)
    return 2 * stats.t.sf(away / np.sqrt(a + b + 1e-30), np.maximum(freedom, 1))


def assert_same_means(ours, theirs, significance=SIGNIFICANCE):
    """Pixel by pixel at the significance for the image as a whole, and the means over the images."""
    probability = welch(ours, theirs)
    assert probability.min() > 1 - (1 - significance) ** (1 / probability.size)
    whole = [np.asarray(images, float).mean(axis=(1, 2))[:, None, None] for images in (ours, theirs)]
    assert welch(*whole).min() > significance


def test_the_background_is_the_path_tracers():
    """Of an environment picture, through samples that are kept while the camera stands still and that follow as it turns."""
    behind = floor(1)
    cameras = [view((0, 1, 0), (0, 1.2 + 0.02 * k, -1 + 0.02 * k), 60) for k in range(5)]
    scene = along(lit(behind, camera=cameras[0], environment=smooth_sky()), cameras)
    size, still, turned, seen, seen_turned = (12, 8), [], [], [], []
    for seed in range(12):
        frames = list(cached(scene, size=size, seed=seed, tracing="multi").frames(0, 5))
        still.append(frames[0].color["mono"])
        turned.append(frames[4].color["mono"])
        seen.append(image(scene, size, 16, 0, seed=seed))
        seen_turned.append(image(scene, size, 16, 4, seed=seed))
    assert np.mean(seen, axis=0).std() > 0.3
    assert_same_means(still, seen)
    assert_same_means(turned, seen_turned)


def test_samples_antialias_textures():
    """Squares about as large as pixels: with more samples the image comes nearer to its mean over each pixel, by the root of how
    many there are, whether radiance is stored with albedo or without; far away all is the mean of both colours."""
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[0, 0, :3] = pixels[1, 1, :3] = 0
    squares = Texture("squares", pixels)

    def board(repeats):
        use = TextureUse(0, (repeats, 0.1 * repeats, 0.1, -0.1 * repeats, repeats, 0.2))
        material = Material("board", (1.0, 1.0, 1.0), base_color_texture=use)
        camera = view((0, 2, 0), (0, 0, 0), 40, up=(0, 0, 1))
        return lit(floor(20), camera=camera, materials=[material], textures=[squares], environment=(1, 1, 1))

    near, far, size = board(60.0), board(20_000.0), (16, 12)
    truth = np.mean([image(near, size, 256, bounces=0, seed=s) for s in range(4)], axis=0)
    errors = {}
    for demodulate in (False, True):
        for target in (1, 16):
            options = {"slots": 2 * target, "target": target, "tolerance": 0, "tracing": "multi", "bounces": 0}
            renderer = cached(near, size=size, demodulate=demodulate, **options)
            color = list(renderer.frames(0, 40))[-1].color["mono"]
            errors[demodulate, target] = np.sqrt(((color - truth) ** 2).mean())
            assert abs(held(renderer).visible.sum(axis=0).mean() / target - 1) < 0.2
    for demodulate in (False, True):
        assert errors[demodulate, 1] > 0.08
        assert errors[demodulate, 16] < 0.5 * errors[demodulate, 1]
    away = cached(far, size=size, bounces=0)
    np.testing.assert_allclose(list(away.frames(0, 6))[-1].color["mono"].mean(), 0.5, rtol=0.02)


# The path tracer


@pytest.mark.parametrize("demodulate", [False, True])
def test_a_still_scene_is_the_path_tracers(demodulate):
    """32 frames of a diffuse scene with sun, sky and light from surfaces, edges included: Welch's test of independent caches against
    independent renders, of every pixel and of the image's mean."""
    scene, size, runs = yard(moving=False), (14, 10), 8
    camera = view((0.4, 3.4, 0.8), (0, 0, 0))
    scene = along(scene, [camera])
    options = {"tracing": "multi", "bounces": 2, "demodulate": demodulate}
    ours = []
    for seed in range(runs):
        renderer = cached(scene, size=size, seed=seed, **options)
        ours.append(list(renderer.frames(0, 32))[-1].color["mono"])
    assert not held(renderer).background.any()
    theirs = [render(scene, size, 128, seed=100 + s, bounces=2).color["mono"] for s in range(runs)]
    assert_same_means(ours, theirs)
    noise = np.std(ours, axis=0, ddof=1).mean() / np.mean(ours)
    assert noise < 0.2, "so noisy that nothing would be seen"
