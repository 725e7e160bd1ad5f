"""The public face of rendering: what a frame carries, what the statistics say, and which errors users get."""

import json
from dataclasses import replace

import numpy as np
import pytest
from render_helpers import WHITE, ball, everything, floor, lit, render, view

import clcache
from clcache import DeviceError, Renderer, SettingError
from clcache import device as device_module
from clcache.layout import STRUCTS
from clcache.renderer import MAX_PIXELS, camera_record
from clcache.settings import SETTINGS

SIZE = (12, 7)


@pytest.fixture(scope="module")
def scene():
    return everything()


def test_a_frame(scene):
    frames = list(Renderer(scene, size=SIZE, spp=1, stereo=True, aovs=("albedo", "N", "Z")).frames(2, 4))
    assert [f.number for f in frames] == [2, 3]
    for frame in frames:
        assert list(frame.color) == list(frame.cameras) == list(frame.stats["eyes"]) == ["left", "right"]
        for eye in frame.color:
            for image, shape in (
                (frame.color[eye], (7, 12, 3)),
                (frame.aov("albedo", eye), (7, 12, 3)),
                (frame.aov("N", eye=eye), (7, 12, 3)),
                (frame.aov("Z", eye=eye), (7, 12)),
            ):
                assert image.shape == shape
                assert image.dtype == np.float32
                assert image.flags.c_contiguous


def test_frames_are_made_one_at_a_time(scene):
    """Taking one frame of a long sequence renders one; a frame's arrays are its own."""
    renderer = Renderer(scene, size=SIZE, spp=1)
    frames = renderer.frames(0, 10**9)
    first = next(frames)
    kept = first.color["mono"].copy()
    next(frames)
    np.testing.assert_array_equal(first.color["mono"], kept)


def test_defaults_are_the_scenes(scene):
    settings = {"pathtrace.bounces": 1}
    defaults = replace(
        scene.defaults, size=(9, 5), frames=(4, 6), stereo=True, spp=2, seed=7, method="pathtrace", settings=settings
    )
    with_defaults = replace(scene, defaults=defaults)
    frames = list(Renderer(with_defaults).frames())
    assert [f.number for f in frames] == [4, 5]
    given = list(Renderer(scene, size=(9, 5), spp=2, seed=7, stereo=True, settings=settings).frames(4, 6))
    for a, b in zip(frames, given, strict=True):
        for eye in ("left", "right"):
            np.testing.assert_array_equal(a.color[eye], b.color[eye])


def test_arguments_override_the_scenes_defaults(scene):
    defaults = replace(scene.defaults, size=(9, 5), stereo=True, spp=2, seed=7, settings={"pathtrace.bounces": 1})
    renderer = Renderer(
        replace(scene, defaults=defaults), size=SIZE, stereo=False, spp=1, seed=0, settings={"pathtrace.bounces": 0}
    )
    stats = renderer.stats()
    assert (stats["size"], stats["spp"], stats["seed"], stats["settings"]["pathtrace.bounces"]) == ([12, 7], 1, 0, 0)
    assert list(next(renderer.frames(0, 1)).color) == ["mono"]


def test_stats(scene):
    renderer = Renderer(scene, size=SIZE, spp=2, seed=3)
    frames = [f.stats for f in renderer.frames(0, 2)]
    stats = json.loads(json.dumps(renderer.stats() | {"frames": frames}))
    assert stats["version"] == clcache.__version__
    assert stats["device"].keys() == {"platform", "name", "driver", "threads"}
    assert stats["scene"] == {"file": "test", "triangles": 2 + 320 + 320 + 2, "instances": 4, "materials": 3}
    assert stats["method"] == "pathtrace"
    assert stats["settings"] == {name: s.default for name, s in SETTINGS.items()}
    assert stats["memo"] == {"kind": "off", "materials": []}
    assert stats["memory"].keys() == {"bvh", "textures", "cache", "total"}
    assert 0 < stats["memory"]["bvh"] + stats["memory"]["textures"] < stats["memory"]["total"]
    assert stats["seconds"].keys() == {"graphs", "bvh_build", "compile", "render"}
    assert stats["seconds"]["render"] == pytest.approx(sum(f["seconds"] for f in frames))
    for number, frame in enumerate(stats["frames"]):
        assert frame["frame"] == number
        eye = frame["eyes"]["mono"]
        assert eye.keys() == {"passes", "rays", "cache", "spp"}
        assert eye["spp"] == 2
        assert eye["rays"]["primary"] == 12 * 7 * 2
        assert 0 < sum(eye["passes"].values()) <= frame["seconds"]


def test_memory_is_what_is_allocated(scene):
    """A pixel more takes the same bytes as every other: the frame's buffers are all that grows with the image."""
    totals = [Renderer(scene, size=(w, 10)).stats()["memory"]["total"] for w in (10, 11, 12)]
    assert totals[2] - totals[1] == totals[1] - totals[0] > 0


@pytest.mark.parametrize("stereo", [False, True])
def test_progress(scene, stereo):
    parts = []
    for _ in Renderer(scene, size=SIZE, spp=4, stereo=stereo).frames(0, 1, parts.append):
        pass
    assert parts == sorted(parts)
    assert parts == pytest.approx(np.arange(1, 9) / 8 if stereo else np.arange(1, 5) / 4)


def test_programs_are_announced_before_they_are_built(scene):
    names = []
    Renderer(scene, size=SIZE, on_compile=names.append)
    assert {"bvh/build.cl", "bvh/trace.cl", "pathtrace/generate.cl", "pathtrace/shade.cl"} <= set(names)
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": (0, 5)}, "size 0x5: expected at least 1x1"),
        ({"size": (5, -1)}, "size 5x-1: expected at least 1x1"),
        ({"size": (MAX_PIXELS, 2)}, "at most 1073741824 pixels"),
        ({"spp": 0}, "spp 0: expected 1 .. "),
        ({"spp": 2**31}, "spp 2147483648: expected 1 .. "),
        ({"seed": -1}, "seed -1: expected 0 .. "),
        ({"seed": 2**64}, "seed 18446744073709551616: expected 0 .. "),
        ({"method": "magic"}, "method magic: unknown; there is pathtrace"),
        ({"memo": "texels"}, "memo texels: unknown; there is off, texel, tile"),
        ({"settings": {"memo.tile": "9x9"}}, "setting memo.tile: '9x9' is not a str in range; expected 2x2, 3x3, 4x4"),
        ({"settings": {"memo.probes": 3}}, "setting memo.probes: unknown; did you mean memo.probe?"),
        (
            {"aovs": ("Z", "depth")},
            "AOV depth: unknown; there is albedo, N, variance, samples, ",
        ),
        ({"settings": {"pathtrace.bounce": 3}}, "setting pathtrace.bounce: unknown; did you mean pathtrace.bounces?"),
        (
            {"settings": {"pathtrace.bounces": -1}},
            "setting pathtrace.bounces: -1 is not an int in range; expected 0 .. 64",
        ),
        ({"settings": {"pathtrace.bounces": 2.5}}, "setting pathtrace.bounces: 2.5 is not an int in range"),
        ({"settings": {"pathtrace.bounces": "many"}}, "setting pathtrace.bounces: 'many' is not an int in range"),
        ({"settings": {"pathtrace.roulette": 0}}, "setting pathtrace.roulette: 0 is not an int in range"),
        ({"settings": {"device.local_size": 0}}, "setting device.local_size: 0 is not an int in range"),
        ({"device": "no such device"}, "no such device"),
    ],
)
def test_wrong_arguments(scene, options, message):
    with pytest.raises(SettingError) as caught:
        Renderer(scene, **options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_of_the_scene_are_checked_too(scene):
    defaults = replace(scene.defaults, settings={"pathtrace.bounces": 65})
    with pytest.raises(SettingError, match="pathtrace.bounces: 65"):
        Renderer(replace(scene, defaults=defaults))


@pytest.mark.parametrize(("begin", "end"), [(0, 0), (3, 2), (-1, 2), (5, None)])
def test_wrong_ranges_of_frames(scene, begin, end):
    with pytest.raises(SettingError, match=r"frames .*: expected 0 <= first < end"):
        next(Renderer(scene, size=SIZE).frames(begin, end))


def test_an_aov_that_was_not_asked_for(scene):
    frame = render(scene, SIZE, aovs=("Z",))
    with pytest.raises(SettingError, match="AOV N: not rendered; there is Z"):
        frame.aov("N", "mono")


def test_an_image_that_no_memory_holds_is_refused_before_anything_of_it_is_allocated(monkeypatch):
    """A device of 64 MiB: the message says what the image would take, what the device has, and nothing was taken."""
    probe, taken = device_module.probe_capabilities, []
    empty = device_module.Device.empty
    monkeypatch.setattr(device_module, "probe_capabilities", lambda d: replace(probe(d), global_memory=2**26))
    monkeypatch.setattr(device_module.Device, "empty", lambda self, *a, **k: taken.append(a[2]) or empty(self, *a, **k))
    scene = lit(floor(), camera=view((0, 1, 3), (0, 0, 0)), environment=WHITE)
    with pytest.raises(
        DeviceError, match=r"the frame needs \d\.\d\d GiB beside the 0\.0 MiB already taken .*; device .* has 64\.0 MiB"
    ) as caught:
        Renderer(scene, size=(4000, 4000))
    assert "\n" not in str(caught.value)
    assert "positions" in taken
    assert not {"ray_origin", "radiance", "color of mono"} & set(taken)
    Renderer(scene, size=(40, 40))
    assert {"ray_origin", "radiance", "color of mono"} <= set(taken)


def test_the_largest_image_either_fits_or_is_refused():
    scene = lit(ball(), camera=view((0, 0, 3), (0, 0, 0)))
    limits = device_module.Device().capabilities
    if limits.global_memory > 200 * MAX_PIXELS:
        pytest.skip("this device could hold it")
    with pytest.raises(DeviceError, match=r"needs \d+\.\d\d GiB"):
        Renderer(scene, size=(2**15, 2**15))


def test_camera_record():
    """What the kernels are told of the camera, at any aspect."""
    camera = view((1, 2, 3), (0, 0, 0), 90, near=0.5)
    record = camera_record(camera, (200, 100))
    assert record.dtype == STRUCTS["Camera"]
    np.testing.assert_allclose(record["slope"], [2, 1], rtol=1e-6)
    np.testing.assert_allclose(record["to_world"].reshape(3, 4), camera.transform, rtol=1e-6, atol=1e-7)
    assert (record["near"], record["width"], record["height"]) == (0.5, 200, 100)
