"""Files merged: equal to NumPy's statistics of all their samples; and files that must not be merged."""

from fractions import Fraction

import numpy as np
import OpenEXR
import pytest

from clcache.errors import SettingError
from clcache.output.exr import COLOR, name_in_view, sample_counts, world_to_camera, write_images
from clcache.output.merge import MAX_SPP, Source, check_mergeable, merge
from clcache.output.read import read_header, read_picture
from clcache.scene.model import Camera

SIZE = (3, 5)
STEREO = ("left", "right")


def header(views, seed, spp, **changes):
    found = {
        "scene": "s.toml",
        "method": "pathtrace",
        "settings": '{"device.local_size": 64, "pathtrace.bounces": 3}',
        "seed": seed if seed is None else str(seed),
        "frame": 4,
        "framesPerSecond": Fraction(24000, 1001),
        **sample_counts(dict.fromkeys(views, spp)),
    }
    if len(views) > 1:
        found |= {"multiView": list(views), "eyeDistance": 0.06}
    for i, view in enumerate(views):
        transform = np.column_stack([np.eye(3), [0.06 * i, 0, 0]])
        found[name_in_view("worldToCamera", views, view)] = world_to_camera(Camera(transform, 0.8))
        found[name_in_view("fovY", views, view)] = 0.8
    found |= changes
    return {name: value for name, value in found.items() if value is not None}


def of_samples(samples, spp):
    """The images that a render of these samples leaves. samples: AOV -> (n, H, W, ...) float64."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            COLOR: samples[COLOR].mean(axis=0),
            "albedo": samples["albedo"].mean(axis=0),
            "variance": samples[COLOR].var(axis=0, ddof=1) / spp if spp > 1 else np.full((*SIZE, 3), np.inf),
            "samples": np.full(SIZE, spp),
            "Z": samples["Z"].min(axis=0),
        }


def drawn(rng, spp):
    z = rng.random((spp, *SIZE)) + 1
    z[rng.random(z.shape) < 0.5] = np.inf
    return {
        COLOR: rng.gamma(1.0, 1.0, (spp, *SIZE, 3)) + 10,
        "albedo": rng.random((spp, *SIZE, 3)),
        "Z": z,
    }


def write(path, images, head):
    write_images(path, images, head)
    return path


def grey(path, views=("mono",), seed=1, spp=4, value=1.0, extra=None, **changes):
    images = {view: {COLOR: np.full((*SIZE, 3), value), **(extra or {})} for view in views}
    return write(path, images, header(views, seed, spp, **changes))


def merged(paths, out):
    sources = [Source.read(path) for path in paths]
    check_mergeable(sources)
    return merge(sources, out)


@pytest.mark.parametrize("views", [("mono",), STEREO])
@pytest.mark.parametrize("counts", [(4, 4), (1, 1), (7, 1, 16), (2, 3, 5, 64)])
def test_statistics_are_those_of_all_samples(tmp_path, views, counts):
    rng = np.random.default_rng(len(views) + sum(counts))
    samples = [{view: drawn(rng, spp) for view in views} for spp in counts]
    paths = [
        write(tmp_path / f"{i}.exr", {view: of_samples(run[view], spp) for view in views}, header(views, 10 + i, spp))
        for i, (run, spp) in enumerate(zip(samples, counts, strict=True))
    ]
    assert merged(paths, tmp_path / "out.exr") == set()
    picture = read_picture(tmp_path / "out.exr")
    for view in views:
        every = {name: np.concatenate([run[view][name] for run in samples]) for name in samples[0][view]}
        expected = of_samples(every, sum(counts))
        channels = picture.channels[view]
        np.testing.assert_allclose(picture.color[view], expected[COLOR], rtol=1e-6)
        for i, c in enumerate("RGB"):
            np.testing.assert_allclose(channels[f"albedo.{c}"], expected["albedo"][..., i], rtol=1e-5)
            # The means in the files are rounded to 24 bits.
            np.testing.assert_allclose(channels[f"variance.{c}"], expected["variance"][..., i], rtol=1e-5, atol=1e-5)
        np.testing.assert_array_equal(channels["Z"], expected["Z"].astype(np.float32))
        np.testing.assert_array_equal(channels["samples"], sum(counts))


def test_merging_in_two_steps_is_merging_at_once(tmp_path):
    rng = np.random.default_rng(1)
    paths = []
    for seed, spp in ((1, 4), (2, 8), (3, 16)):
        images = {"mono": of_samples(drawn(rng, spp), spp)}
        paths.append(write(tmp_path / f"{seed}.exr", images, header(("mono",), seed, spp)))
    merged(paths, tmp_path / "once.exr")
    merged(paths[1:], tmp_path / "first.exr")
    merged([tmp_path / "first.exr", paths[0]], tmp_path / "twice.exr")
    once, twice = (read_picture(tmp_path / name) for name in ("once.exr", "twice.exr"))
    for name, plane in once.channels["mono"].items():
        np.testing.assert_allclose(twice.channels["mono"][name], plane, rtol=1e-3 if "variance" in name else 1e-6)
    with OpenEXR.File(str(tmp_path / "twice.exr"), header_only=True) as file:
        assert (file.header()["seed"], file.header()["spp"]) == ("1,2,3", 28)


def test_normals_are_of_unit_length_and_weighted(tmp_path):
    x, y, nothing = np.zeros((3, *SIZE, 3))
    x[..., 0] = y[..., 1] = 1
    x[0, 0] = y[0, 0] = 0
    paths = [
        grey(tmp_path / f"{seed}.exr", seed=seed, spp=spp, extra={"N": normal})
        for seed, spp, normal in ((1, 3, x), (2, 4, y), (3, 100, nothing))
    ]
    merged(paths, tmp_path / "out.exr")
    channels = read_picture(tmp_path / "out.exr").channels["mono"]
    normals = np.stack([channels[f"N.{c}"] for c in "XYZ"], axis=-1)
    np.testing.assert_array_equal(normals[0, 0], 0)
    np.testing.assert_allclose(normals[1:], np.broadcast_to([0.6, 0.8, 0], normals[1:].shape), rtol=1e-6)


def test_samples_of_the_pixels_come_before_those_of_the_header(tmp_path):
    counts = np.full(SIZE, 4.0)
    counts[1, 2] = 12.0
    a = grey(tmp_path / "a.exr", seed=1, spp=4, value=1.0, extra={"samples": counts})
    b = grey(tmp_path / "b.exr", seed=2, spp=4, value=2.0)
    assert merged([a, b], tmp_path / "out.exr") == set()
    picture = read_picture(tmp_path / "out.exr")
    expected = np.full(SIZE, 1.5)
    expected[1, 2] = 1.25
    np.testing.assert_allclose(picture.color["mono"][..., 1], expected)
    np.testing.assert_array_equal(picture.channels["mono"]["samples"], counts + 4)
    a = grey(tmp_path / "a.exr", seed=1, extra={"samples": counts * 0})
    with pytest.raises(SettingError, match="a.exr: view mono has pixels without samples"):
        merged([a, b], tmp_path / "none.exr")
    assert not (tmp_path / "none.exr").exists()


def test_what_not_all_have_is_left_out(tmp_path):
    a = grey(tmp_path / "a.exr", STEREO, seed=1, extra={"Z": np.ones(SIZE), "albedo": np.ones((*SIZE, 3))})
    b = grey(tmp_path / "b.exr", STEREO, seed=2, extra={"Z": np.ones(SIZE) / 2})
    assert merged([a, b], tmp_path / "out.exr") == {"albedo.R", "albedo.G", "albedo.B"}
    channels = read_picture(tmp_path / "out.exr").channels
    assert set(channels["left"]) == set(channels["right"]) == {"R", "G", "B", "Z"}
    assert (channels["right"]["Z"] == 0.5).all()


def test_a_pixel_that_is_not_finite_stays_so(tmp_path):
    color = np.ones((*SIZE, 3))
    color[0, 0] = np.nan, np.inf, 1.0
    images = {"mono": {COLOR: color, "variance": np.zeros((*SIZE, 3))}}
    paths = [write(tmp_path / f"{seed}.exr", images, header(("mono",), seed, 2)) for seed in (1, 2)]
    merged(paths, tmp_path / "out.exr")
    np.testing.assert_array_equal(read_picture(tmp_path / "out.exr").color["mono"], color.astype(np.float32))


def test_header_is_that_of_the_files_with_all_seeds(tmp_path):
    a = grey(tmp_path / "a.exr", STEREO, seed=2**64 - 1, **sample_counts({"left": 4, "right": 6}))
    other = '{"device.local_size": 8, "pathtrace.bounces": 3}'
    b = grey(tmp_path / "b.exr", STEREO, seed=7, settings=other, **sample_counts({"left": 10, "right": 1}))
    merged([a, b], tmp_path / "out.exr")
    with OpenEXR.File(str(a), header_only=True) as file:
        expected = dict(file.header())
    with OpenEXR.File(str(tmp_path / "out.exr"), header_only=True) as file:
        found = dict(file.header())
    assert found["seed"] == f"7,{2**64 - 1}"
    assert (found["spp"], found["right.spp"]) == (14, 7)
    assert found["compression"] == OpenEXR.ZIP_COMPRESSION
    for name in ("scene", "method", "settings", "frame", "framesPerSecond", "multiView", "eyeDistance", "right.fovY"):
        assert found[name] == expected[name]
    for name in ("worldToCamera", "right.worldToCamera"):
        np.testing.assert_array_equal(found[name], expected[name])


@pytest.mark.parametrize("other", [{}, {"sceneDigest": "aa", "cameraDigest": "dd"}, {"cameraDigest": "dd"}])
def test_digests_that_all_files_share_are_kept(tmp_path, other):
    digests = {"sceneDigest": "aa", "cameraDigest": "cc"}
    has = [digests, digests, other or digests]
    paths = [grey(tmp_path / f"{seed}.exr", seed=seed, **has[seed]) for seed in range(3)]
    merged(paths, tmp_path / "out.exr")
    attributes = read_header(tmp_path / "out.exr").attributes
    found = {name: attributes[name] for name in digests if name in attributes}
    assert found == {name: value for name, value in digests.items() if has[2].get(name) == value}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scene": "t.toml"}, r"scene: .*b\.exr has t\.toml and .*a\.exr s\.toml; expected the same"),
        ({"method": "bidirectional"}, "method: .* has bidirectional"),
        ({"frame": 5}, "frame: .* has 5 and .* 4"),
        ({"memo": "texel"}, "memo: .* has texel and .* off"),
        ({"framesPerSecond": Fraction(30)}, "fps: .* has 30.0"),
        ({"settings": '{"pathtrace.bounces": 4}'}, r"setting pathtrace.bounces: .* has 4 and .* 3"),
        ({"settings": '{"pathtrace.bounces": 3, "new": 1}'}, "setting new: .* has 1 and .* none"),
        ({"worldToCamera": np.diag([1, 1, -1, 2]).astype(np.float32)}, "cameras: view left of .*b.exr"),
        ({"right.fovY": 0.9}, "cameras: view right of .*b.exr"),
        ({"method": "samplecache"}, "b.exr: its method, samplecache, has samples of earlier frames"),
        ({"method": "isrt"}, "b.exr: its method, isrt, has samples of earlier frames"),
        ({"temporal": "taa"}, "b.exr: its temporal filter, taa, has put colour of earlier frames into it"),
        ({"stereoBlend": "constant"}, "b.exr: its stereo blend, constant, has put colour of the other eye into it"),
        ({"seed": "1"}, "both hold the samples of seed 1"),
        ({"seed": "2,1,3"}, "both hold the samples of seed 1"),
        ({"right.spp": MAX_SPP}, "expected at most"),
        ({"spp": None}, "b.exr: lacks the attribute spp"),
        ({"right.spp": None}, "b.exr: lacks the attribute right.spp"),
        ({"seed": None}, "b.exr: lacks the attribute seed"),
        ({"worldToCamera": None}, "b.exr: lacks the attribute worldToCamera"),
        ({"eyeDistance": None}, "b.exr: lacks the attribute eyeDistance"),
        ({"spp": 0}, "b.exr: its attributes are damaged"),
        ({"seed": "one"}, "b.exr: its attributes are damaged"),
        ({"settings": "[]"}, "b.exr: its attributes are damaged"),
        ({"settings": "[" * 100_000}, "b.exr: its attributes are damaged"),
        ({"right.worldToCamera": 1.0}, "b.exr: its attributes are damaged"),
    ],
)
def test_files_that_do_not_fit_are_refused_in_one_line(tmp_path, changes, message):
    paths = [grey(tmp_path / "a.exr", STEREO, seed=1), grey(tmp_path / "b.exr", STEREO, **{"seed": 2, **changes})]
    with pytest.raises(SettingError, match=message) as error:
        merged(paths, tmp_path / "out.exr")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out.exr").exists()


def test_other_sizes_and_views_are_refused(tmp_path):
    a = grey(tmp_path / "a.exr")
    write_images(tmp_path / "b.exr", {"mono": {COLOR: np.ones((3, 4, 3))}}, header(("mono",), 2, 4))
    with pytest.raises(SettingError, match=r"size: .*b\.exr has 4x3 and .* 5x3"):
        merged([a, tmp_path / "b.exr"], tmp_path / "out.exr")
    with pytest.raises(SettingError, match=r"views: .*c\.exr has left, right and .* mono"):
        merged([a, grey(tmp_path / "c.exr", STEREO, seed=2)], tmp_path / "out.exr")
