"""EXR files read back with OpenEXR itself and, where it is installed, with OpenImageIO."""

import json
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache.output.aov import AOVS
from clcache.output.exr import COLOR_CHANNELS, name_in_view, provenance, sample_counts, world_to_camera, write_exr
from clcache.scene.digest import camera_digest, scene_digest
from clcache.scene.model import Camera, Defaults, Scene
from clcache.version import __version__

VIEWS = ["left", "right"]
SPP = {"left": 16, "right": 17}
STATS = {
    "method": "pathtrace",
    "settings": {"pathtrace.bounces": 3},
    "seed": 2**64 - 1,
    "temporal": "taa",
    "stereo_blend": "samples",
    "memo": {"kind": "tile", "materials": []},
}
# At (1, 2, 3), looking along +X with +Y up: the camera's axes -Z, Y and X are the world's X, Y and Z.
TRANSFORM = np.array([[0.0, 0.0, -1.0, 1.0], [0.0, 1.0, 0.0, 2.0], [1.0, 0.0, 0.0, 3.0]])


@dataclass
class FrameOf:
    """A frame as the renderer yields it, of random pixels with the extremes among them."""

    views: list
    number: int = 7

    def __post_init__(self):
        rng = np.random.default_rng(len(self.views))
        self.color = {view: rng.gamma(1.0, 1.0, (4, 6, 3)).astype(np.float32) for view in self.views}
        self.color[self.views[0]][0, 0] = 1e30, np.inf, np.nan
        self.aovs = {
            (name, view): rng.normal(size=(4, 6, 3) if len(aov.channels) == 3 else (4, 6)).astype(np.float32)
            for name, aov in AOVS.items()
            for view in self.views
        }
        self.aovs["Z", self.views[0]][0, 0] = np.inf
        self.cameras = {
            view: Camera(TRANSFORM + [[0, 0, 0, 0.1 * i]] * 3, 0.8 + i) for i, view in enumerate(self.views)
        }

    def aov(self, name, eye):
        return self.aovs[name, eye]


def scene(file="data/cornell/scene.toml"):
    camera = Camera(TRANSFORM, 0.8)
    return Scene(file, (), (), (), (), (), (0.0, 0.0, 0.0), camera, Defaults(fps=24000 / 1001))


def attributes(**options):
    return provenance(scene(**options), STATS) | sample_counts(SPP)


def written(path, frame, aovs=tuple(AOVS)):
    write_exr(path, frame, aovs, attributes())
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return dict(file.header()), {name: channel.pixels for name, channel in file.channels().items()}


def view_and_name(channel):
    """Of a channel in a file with these views: its view (None: in no view) and its name without it, as the convention says."""
    *layers, last = channel.split(".")
    if not layers:
        return VIEWS[0], channel
    if layers[-1] in VIEWS:
        return layers[-1], ".".join((*layers[:-1], last))
    return None, channel


def test_mono_file_has_the_conventional_names_and_every_bit(tmp_path):
    frame = FrameOf(["mono"])
    header, channels = written(tmp_path / "f.exr", frame)
    names = {"R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "N.X", "N.Y", "N.Z", "Z"}
    names |= {"variance.R", "variance.G", "variance.B", "samples", "occupancy", "visible", "age", "trace"}
    names |= {"voxel.R", "voxel.G", "voxel.B", "level", "count", "alpha", "effective", "beta"}
    names |= {f"{kind}{layer}.{channel}" for kind in ("layer", "filtered") for layer in range(3) for channel in "RGB"}
    assert set(channels) == names
    assert "multiView" not in header and "eyeDistance" not in header
    for i, name in enumerate(COLOR_CHANNELS):
        np.testing.assert_array_equal(channels[name], frame.color["mono"][..., i])
        assert channels[name].dtype == np.float32
    for i, name in enumerate(("N.X", "N.Y", "N.Z")):
        np.testing.assert_array_equal(channels[name], frame.aov("N", "mono")[..., i])
    np.testing.assert_array_equal(channels["Z"], frame.aov("Z", "mono"))


def test_stereo_file_has_the_same_channels_in_both_views(tmp_path):
    frame = FrameOf(VIEWS)
    header, channels = written(tmp_path / "f.exr", frame)
    assert header["multiView"] == VIEWS
    assert {"R", "Z", "right.R", "right.Z", "albedo.left.R", "albedo.right.R", "N.left.X", "N.right.Z"} <= set(channels)
    found = {view_and_name(channel): pixels for channel, pixels in channels.items()}
    names = [*COLOR_CHANNELS, *(channel for aov in AOVS.values() for channel in aov.channels)]
    assert set(found) == {(view, name) for view in VIEWS for name in names}
    for view in VIEWS:
        for i, name in enumerate(COLOR_CHANNELS):
            np.testing.assert_array_equal(found[view, name], frame.color[view][..., i])
        for aov in AOVS.values():
            planes = frame.aov(aov.name, view).reshape(4, 6, -1)
            for i, name in enumerate(aov.channels):
                np.testing.assert_array_equal(found[view, name], planes[..., i])


layer = st.text("abcXYZ_019", min_size=1, max_size=8).filter(lambda text: text not in VIEWS)


@given(st.lists(layer, min_size=1, max_size=4).map(".".join), st.sampled_from(VIEWS))
def test_a_name_says_its_view(name, view):
    assert view_and_name(name_in_view(name, VIEWS, view)) == (view, name)
    assert name_in_view(name, ["mono"], "mono") == name


def test_only_the_aovs_asked_for_are_written(tmp_path):
    _, channels = written(tmp_path / "f.exr", FrameOf(["mono"]), aovs=("Z",))
    assert set(channels) == {"R", "G", "B", "Z"}
    _, channels = written(tmp_path / "f.exr", FrameOf(["mono"]), aovs=())
    assert set(channels) == {"R", "G", "B"}


def test_header_says_where_the_picture_comes_from(tmp_path):
    header, _ = written(tmp_path / "f.exr", FrameOf(VIEWS))
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    assert header["software"] == f"clcache {__version__}"
    assert header["scene"] == "data/cornell/scene.toml"
    assert header["sceneDigest"] == scene_digest(scene()) and header["cameraDigest"] == camera_digest(scene())
    assert header["method"] == "pathtrace"
    assert (header["temporal"], header["stereoBlend"], header["memo"]) == ("taa", "samples", "tile")
    assert json.loads(header["settings"]) == {"pathtrace.bounces": 3}
    assert int(header["seed"]) == 2**64 - 1
    assert (header["frame"], header["spp"], header["right.spp"]) == (7, 16, 17)
    assert header["framesPerSecond"] == Fraction(24000, 1001)
    assert header["eyeDistance"] == pytest.approx(0.1 * 3**0.5)
    assert (header["fovY"], header["right.fovY"]) == (pytest.approx(0.8), pytest.approx(1.8))
    frame = FrameOf(VIEWS)
    np.testing.assert_array_equal(header["worldToCamera"], world_to_camera(frame.cameras["left"]))
    np.testing.assert_array_equal(header["right.worldToCamera"], world_to_camera(frame.cameras["right"]))


def test_a_scene_name_that_is_no_unicode_is_escaped(tmp_path):
    write_exr(tmp_path / "f.exr", FrameOf(["mono"]), (), attributes(file="caf\udce9.toml"))
    with OpenEXR.File(str(tmp_path / "f.exr"), header_only=True) as file:
        assert file.header()["scene"] == "caf\\udce9.toml"


def test_world_to_camera_is_left_handed_for_row_vectors():
    matrix = world_to_camera(Camera(TRANSFORM, 0.8))
    in_front, above, to_the_right = ([6, 2, 3, 1], [1, 4, 3, 1], [1, 2, 4, 1])
    np.testing.assert_allclose(in_front @ matrix, [0, 0, 5, 1], atol=1e-6)
    np.testing.assert_allclose(above @ matrix, [0, 2, 0, 1], atol=1e-6)
    np.testing.assert_allclose(to_the_right @ matrix, [1, 0, 0, 1], atol=1e-6)


def test_another_reader_agrees(tmp_path):
    oiio = pytest.importorskip("OpenImageIO")
    frame = FrameOf(VIEWS)
    written(tmp_path / "f.exr", frame)
    image = oiio.ImageInput.open(str(tmp_path / "f.exr"))
    spec = image.spec()
    pixels = image.read_image()
    image.close()
    assert (spec.width, spec.height) == (6, 4)
    for name, expected in (("right.G", frame.color["right"][..., 1]), ("N.left.Y", frame.aov("N", "left")[..., 1])):
        np.testing.assert_array_equal(pixels[..., spec.channelnames.index(name)], expected)
    assert spec.getattribute("method") == "pathtrace"
    assert tuple(spec.getattribute("multiView")) == ("left", "right")
    np.testing.assert_array_equal(spec.getattribute("worldToCamera"), world_to_camera(frame.cameras["left"]).ravel())
