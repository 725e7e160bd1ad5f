"""`device.fast_math`: which kernels round less carefully, and that no hit is another one by that."""

from pathlib import Path

import numpy as np

from clcache import Renderer, device, load_scene
from clcache.program import Program

CORNELL = Path(__file__).parents[1] / "data" / "cornell" / "scene.toml"


def test_only_kernels_that_decide_nothing_round_less_carefully(device_spec, monkeypatch):
    options = {}

    class Noting(Program):
        def __init__(self, context, queue, told, local_size, name, *rest):
            options[name] = tuple(told)
            super().__init__(context, queue, told, local_size, name, *rest)

    monkeypatch.setattr(device, "Program", Noting)
    scene, pictures = load_scene(CORNELL), {}
    for is_fast in (False, True):
        options.clear()
        renderer = Renderer(
            scene,
            "pathtrace",
            (48, 32),
            spp=4,
            stereo=False,
            device=device_spec,
            settings={"device.fast_math": is_fast, "pathtrace.bounces": 1},
            aovs=("Z",),
        )
        (frame,) = renderer.frames(0, 1)
        pictures[is_fast] = frame.color["mono"], frame.aov("Z", "mono")
        loose = {name for name, told in options.items() if any("unsafe" in option for option in told)}
        exact = {name for name in options if name.startswith("bvh/") or name == "pathtrace/film.cl"}
        assert exact >= {"bvh/build.cl", "bvh/trace.cl", "pathtrace/film.cl"}
        assert loose == (options.keys() - exact if is_fast else set())
        assert "pathtrace/shade.cl" in options
        assert not any("finite" in option or "relaxed" in option for told in options.values() for option in told)
    (careful, depth), (fast, other) = pictures[False], pictures[True]
    assert np.isfinite(fast).all()
    assert np.isclose(other, depth, rtol=1e-5).mean() > 0.99  # the same rays, but for the last bits of their directions
    assert abs(fast.mean() - careful.mean()) < 0.01 * careful.mean()
