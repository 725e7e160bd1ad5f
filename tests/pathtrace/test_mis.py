"""Lights found by shadow rays alone, by the surfaces' own rays alone, and by both: the same image."""

import numpy as np
import pytest
from helpers import IDENTITY
from render_helpers import BLACK, ball, floor, grey, lit, shape_mesh, view
from scipy import stats

from clcache import Renderer
from clcache import program as program_module
from clcache.scene.generators import plane
from clcache.scene.model import Environment, Material, Texture, TextureUse

SHADOW_WEIGHT = "power_heuristic(light_sample.density, found_otherwise)"  # for shadow rays
RAY_WEIGHT = "power_heuristic(density, found_otherwise)"  # for the paths' own rays
FOUND_BY_RAYS_ONLY = "(isinf(density) || !(found_otherwise > 0.0f) ? 1.0f : 0.0f)"
WEIGHTS = {"both": (SHADOW_WEIGHT, RAY_WEIGHT), "shadow rays": ("1.0f", FOUND_BY_RAYS_ONLY), "rays": ("0.0f", "1.0f")}
SIZE = (8, 6)
ROUGHNESSES = {"rough": 0.9, "glossy": 0.3}


def with_weights(monkeypatch, folder, strategy):
    """Have programs built from sources in which the weights are other ones."""
    texts = {f: f.read_text() for f in program_module.SOURCE_FOLDER.rglob("*.cl")}
    for file, text in texts.items():
        for known, new in zip((SHADOW_WEIGHT, RAY_WEIGHT), WEIGHTS[strategy], strict=True):
            text = text.replace(known, new)
        target = folder / file.relative_to(program_module.SOURCE_FOLDER)
        target.parent.mkdir(exist_ok=True)
        target.write_text(text)
    assert all(sum(w in text for text in texts.values()) == 1 for w in (SHADOW_WEIGHT, RAY_WEIGHT))
    monkeypatch.setattr(program_module, "SOURCE_FOLDER", folder)


def surfaces(roughness):
    """Of a floor and of a metal ball."""
    return [
        Material("floor", (0.6, 0.5, 0.4), roughness=roughness, specular=1.0),
        Material("metal", (0.9, 0.8, 0.7), roughness=roughness, metallic=1.0),
    ]


def lamps(roughness):
    """A large lamp near the floor, a small one, and one of which half is dark and half is bright."""
    shine = [
        Material("large", BLACK, emission=(1.0, 0.8, 0.6)),
        Material("small", BLACK, emission=(60.0, 50.0, 40.0), double_sided=False),
        Material("halves", BLACK, emission=(5.0, 5.0, 5.0), emission_texture=TextureUse(0)),
    ]
    pixels = np.full((1, 2, 4), 255, np.uint8)
    pixels[0, 0, :3] = 0
    down = np.diag([1.0, -1.0, 1.0])
    places = [IDENTITY, IDENTITY + [[0, 0, 0, 0], [0, 0, 0, 0.6], [0] * 4]]
    places += [np.column_stack([down, p]) for p in ([-1.5, 1, 0], [1, 1.5, 0.5], [0, 1.6, -1.0])]
    return lit(
        floor(6), ball(0.6, 2, 1, smooth=True), shape_mesh(plane((1.5, 1.5)), 2), shape_mesh(plane((0.2, 0.2)), 3),
        shape_mesh(plane((0.8, 0.8)), 4), camera=view((0, 2.0, 3.5), (0, 0.4, 0)), materials=[*surfaces(roughness), *shine],
        instances=list(enumerate(places)), textures=[Texture("halves", pixels)],
    )  # fmt: skip


def sunny(roughness):
    """A sky with a bright pixel of a few degrees, a dim half and a dark row."""
    picture = np.full((16, 32, 3), 0.2, np.float32)
    picture[4, 9] = 40
    picture[8:] = 0.05
    picture[6] = 0
    return lit(
        floor(6), ball(0.6, 2, 1, smooth=True), camera=view((0, 2.0, 3.5), (0, 0.4, 0)), materials=surfaces(roughness),
        instances=[(0, IDENTITY), (1, IDENTITY + [[0, 0, 0, 0], [0, 0, 0, 0.6], [0] * 4])], environment=Environment(picture),
    )  # fmt: skip


def renders(scene, count=16, spp=16):
    """(count, H, W, 3): frames, whose numbers are independent; a few bright paths cut off, the same everywhere."""
    settings = {"pathtrace.bounces": 1, "pathtrace.roulette": 64}
    return np.array([f.color["mono"] for f in Renderer(scene, size=SIZE, spp=spp, settings=settings).frames(0, count)])


@pytest.mark.parametrize("make", [lamps, sunny])
def test_same_image_however_light_is_found(make, monkeypatch, tmp_path):
    """Welch's t-test on the means of the image and of its quarters, glossy and rough: significance 0.01, Sidak-corrected."""
    found = {}
    for strategy in WEIGHTS:
        with monkeypatch.context() as patch:
            folder = tmp_path / strategy
            folder.mkdir()
            with_weights(patch, folder, strategy)
            for name, roughness in ROUGHNESSES.items():
                frames = renders(make(roughness), spp=12 if strategy == "both" else 36)
                quarters = frames.reshape(len(frames), 2, SIZE[1] // 2, 2, SIZE[0] // 2, 3).mean(axis=(2, 4, 5))
                found[strategy, name] = np.column_stack([quarters.reshape(-1, 4), frames.mean(axis=(1, 2, 3))])
    level = 1 - 0.99 ** (1 / (3 * 2 * 5))
    for name in ROUGHNESSES:
        for a, b in (("both", "shadow rays"), ("both", "rays"), ("shadow rays", "rays")):
            p = stats.ttest_ind(found[a, name], found[b, name], equal_var=False).pvalue
            assert p.min() > level, (name, a, b, found[a, name].mean(axis=0), found[b, name].mean(axis=0))
    for name in ROUGHNESSES:
        spread = {s: found[s, name].std(axis=0).mean() * (1 if s == "both" else np.sqrt(3)) for s in WEIGHTS}
        assert spread["both"] < 1.1 * min(spread.values()) or spread["both"] < 1.5 * spread["shadow rays"]


def test_density_is_chance_per_solid_angle():
    """The floor is white and lit by one triangle: weighted both ways, its radiance is the form factor (Lambert 1760)."""
    corners = np.array([[-0.7, 1.0, -0.5], [0.9, 1.3, -0.2], [0.1, 0.8, 0.8]])
    lamp = shape_mesh(plane((1.0, 1.0)), 1)
    lamp = type(lamp)("lamp", corners.astype(np.float32), np.array([[0, 1, 2]], np.uint32), np.ones(1, np.uint32))
    scene = lit(
        floor(0.02), lamp, camera=view((0, 0.03, 0.001), (0, 0, 0), 10, up=(0, 0, -1)),
        materials=[grey(1.0), Material("lamp", BLACK, emission=(1.0, 1.0, 1.0))],
    )  # fmt: skip
    color = next(Renderer(scene, size=(8, 8), spp=256, settings={"pathtrace.bounces": 0}).frames(0, 1)).color["mono"]
    u = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    across = np.cross(u, np.roll(u, -1, axis=0))
    angle = np.arccos(np.sum(u * np.roll(u, -1, axis=0), axis=1))
    factor = abs(np.sum(angle * across[:, 1] / np.linalg.norm(across, axis=1))) / (2 * np.pi)
    assert color.mean() == pytest.approx(factor, rel=5e-3)


def test_lamp_with_holes(monkeypatch, tmp_path):
    """A masked lamp shines only where it is: both strategies agree."""
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[:, :2, 3] = 0
    lamp = Material(
        "lamp", (1.0, 1.0, 1.0), base_color_texture=TextureUse(0), alpha_cutoff=0.5, emission=(4.0, 4.0, 4.0)
    )
    down = np.column_stack([np.diag([1.0, -1.0, 1.0]), [0, 1, 0]])
    scene = lit(
        floor(4), shape_mesh(plane((1.0, 1.0)), 1), camera=view((0, 2.0, 3.5), (0, 0.4, 0)), materials=[grey(0.6), lamp],
        instances=[(0, IDENTITY), (1, down)], textures=[Texture("holes", pixels)],
    )  # fmt: skip
    means = []
    for strategy in ("shadow rays", "rays"):
        with monkeypatch.context() as patch:
            folder = tmp_path / strategy
            folder.mkdir()
            with_weights(patch, folder, strategy)
            means.append(renders(scene).mean(axis=(1, 2, 3)))
    assert stats.ttest_ind(*means, equal_var=False).pvalue > 1e-3
