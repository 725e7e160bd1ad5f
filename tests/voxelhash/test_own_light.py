"""What shines by itself is not kept in voxels: a lamp would light all that shares one with it."""

from pathlib import Path

import numpy as np
import pytest

import clcache

DATA = Path(__file__).parents[2] / "data"

SIZE = (48, 32)


@pytest.mark.parametrize("method", ["voxelhash", "hybrid"])
def test_a_lamp_under_the_ceiling_does_not_make_the_ceiling_shine(method):
    scene = clcache.load_scene(DATA / "cornell" / "scene.toml")
    options = {"size": SIZE, "stereo": False, "temporal": "none"}
    (reference,) = clcache.Renderer(scene, method="pathtrace", spp=256, seed=1, **options).frames(0, 1)
    renderer = clcache.Renderer(scene, method=method, seed=2, **options)
    images = [next(renderer.frames(0, 1)).color["mono"].astype(float) for _ in range(16)]
    mean, true = np.mean(images[4:], axis=0), reference.color["mono"]
    # The lamp is many times as bright as the ceiling beside it. With its light in their common voxels the mean is 1.4 times
    # as large; of noise and interpolation there remain a few hundredths.
    assert mean.mean() == pytest.approx(true.mean(), rel=0.04)
    lamp = true.mean(axis=2) > 0.8 * true.mean(axis=2).max()
    assert lamp.any() and mean[lamp].mean() == pytest.approx(true[lamp].mean(), rel=0.04)
