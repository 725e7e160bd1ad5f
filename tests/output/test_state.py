"""The state of a render: what goes on from it is what would have followed, and no file that is not one does harm."""

import io
import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from cache_renders import one_device, yard
from fake_method import Step, put
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from render_helpers import everything

from clcache import Renderer, SettingError
from clcache.frame import Buffer
from clcache.methods import METHODS, Method
from clcache.output.state import STATE_FILE, StateFile, write_state
from clcache.settings import STEREO_BLENDS

SIZE = (12, 9)
KINDS = [("pathtrace", "none"), ("pathtrace", "taa"), ("pathtrace", "varianceblend"), ("samplecache", "varianceblend")]
KINDS += [(method, None) for method in METHODS if method != "pathtrace"]
VARIANTS = [(m, {f"{group}.{name}": value})
    for m in ("samplecache", "hybrid")
    for group, name, value in (
        ("samplecache", "reprojection", "single-pass"),
        ("samplecache", "reprojection", "two-pass"),
        ("samplecache", "slots", 24),
    )
] + [
    ("samplecache", {"samplecache.shading": "uniform"}),
    ("samplecache", {"samplecache.demodulate": False}),
    ("isrt", {"samplecache.reprojection": "single-pass"}),
    ("voxelhash", {"voxelhash.capacity": 64}),
    ("voxelhash", {"varianceblend.estimate": "published"}),
    ("voxelhash", {"varianceblend.per_channel": True}),
]  # fmt: skip
TABLE = {"voxelhash.capacity": 2048, "octree.resolution": 64}


@pytest.fixture(scope="module", autouse=True)
def device():
    with one_device():
        yield


def renderer(scene=None, method="samplecache", **options):
    given = {"size": SIZE, "spp": 1, "settings": TABLE | options.pop("settings", {})} | options
    return Renderer(yard(6) if scene is None else scene, method, **given)


def frames(of, begin, end):
    """What frames begin .. end - 1 look like, their AOVs and counters too."""
    found = []
    for frame in of.frames(begin, end):
        images = {eye: [color, *(frame.aov(name, eye) for name in of.aovs)] for eye, color in frame.color.items()}
        counted = {eye: (stats["rays"], stats["cache"]) for eye, stats in frame.stats["eyes"].items()}
        found.append((images, counted))
    return found


def assert_same(found, expected):
    for (images, counted), (other_images, other_counted) in zip(found, expected, strict=True):
        assert counted == other_counted
        for eye, own in images.items():
            for image, other in zip(own, other_images[eye], strict=True):
                np.testing.assert_array_equal(image, other)


# A renderer that goes on


def assert_goes_on(folder, **options):
    """What follows is what would have followed, bit by bit, in a scene that moves, for both eyes, whatever the renderer did before."""
    options = {"stereo": True, "aovs": ("Z",), "seed": 3} | options
    whole, begun, afresh, used = (renderer(**options) for _ in range(4))
    expected = frames(whole, 0, 6)
    frames(begun, 0, 3)
    begun.save(folder / STATE_FILE)
    frames(used, 4, 6)
    for resumed in (afresh, used):
        assert resumed.restore(folder) == 2
        assert_same(frames(resumed, 3, 6), expected[3:])
        assert resumed._identity() == whole._identity()
    return expected


@pytest.mark.parametrize(("method", "temporal"), KINDS)
def test_what_follows_is_what_would_have_followed(tmp_path, method, temporal):
    """And it is not what follows from nothing."""
    expected = assert_goes_on(tmp_path, method=method, temporal=temporal)
    of = renderer(method=method, temporal=temporal, stereo=True, aovs=("Z",), seed=3)
    if of.has_state:
        begun = frames(of, 3, 6)
        assert any((a[0]["left"][0] != b[0]["left"][0]).any() for a, b in zip(begun, expected[3:], strict=True))


def races(variant):
    """Whether what an update leaves depends on which thread is first."""
    return (
        variant.get("samplecache.reprojection", "deterministic") != "deterministic" or "voxelhash.capacity" in variant
    )


@pytest.mark.parametrize(("method", "variant"), VARIANTS)
def test_so_it_is_of_every_variant(tmp_path, method, variant):
    if races(variant) and renderer(method=method).device.threads != 1:
        pytest.skip("needs one thread; test_so_it_is_where_threads_race has it")
    assert_goes_on(tmp_path, method=method, settings=variant)


def test_so_it_is_where_threads_race():
    """With one thread, for which PoCL takes a process of its own."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        f"{__file__}::test_so_it_is_of_every_variant",
    ]
    environment = os.environ | {"POCL_MAX_PTHREAD_COUNT": "1", "PYTEST_ADDOPTS": "-p no:xdist"}
    child = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert child.returncode == 0, child.stdout
    assert f"{len(VARIANTS)} passed" in child.stdout


@pytest.mark.parametrize(
    ("method", "blend"),
    [(m, b) for m in METHODS for b in STEREO_BLENDS if b != "samples" or m in ("samplecache", "isrt")],
)
def test_so_it_is_with_what_the_eyes_share(tmp_path, method, blend):
    assert_goes_on(tmp_path, method=method, stereo_blend=blend, temporal="taa", settings={"taa.validation": "none"})


@pytest.mark.parametrize("method", [m for m in METHODS if m != "pathtrace"])
def test_a_state_holds_what_the_next_frames_depend_on_and_nothing_else(tmp_path, method):
    """Without any one of its arrays other frames follow. With so few voxels there are samples that have none; of voxelhash, what is
    known of these would be missed only where a path has brought what is not finite."""
    options = {"method": method, "stereo": True, "stereo_blend": "constant", "temporal": "varianceblend"}
    options |= {"settings": {"voxelhash.capacity": 32, "voxelhash.probe": 1}}
    if method == "octree":  # whose cells are wiped where things move
        options["scene"] = yard(moving=False)
    whole = renderer(**options)
    frames(whole, 0, 3)
    whole.save(tmp_path / STATE_FILE)
    expected = frames(whole, 3, 6)
    for name in whole._kept():
        if method == "voxelhash" and name.endswith("own_light"):
            continue
        of = renderer(**options)
        of.restore(tmp_path)
        put(of._kept()[name], 0)
        with pytest.raises(AssertionError):
            assert_same(frames(of, 3, 6), expected)
    with np.load(tmp_path / STATE_FILE) as archive:
        assert {*archive.files} == {"meta", *whole._kept()}
    names = {name.split(".")[-1] for name in whole._kept()}
    assert not names & {"pixel", "near", "voxel_claim"} and not any(name.endswith("_before") for name in names)


@pytest.mark.parametrize("method", ["voxelhash", "hybrid"])
def test_what_claims_hold_at_first_is_of_no_account(method):
    of, plain = renderer(method=method), renderer(method=method)
    put(of._graph.of()["voxel_claim"], 0xFFFFFFFF)
    assert_same(frames(of, 0, 2), frames(plain, 0, 2))


def test_saving_changes_nothing(tmp_path):
    saved, plain = renderer(), renderer()
    for number in range(3):
        assert_same(frames(saved, number, number + 1), frames(plain, number, number + 1))
        saved.save(tmp_path / "s.npz")


def test_numpy_reads_it_too(tmp_path):
    of = renderer()
    frames(of, 4, 6)
    of.save(tmp_path / "s.npz")
    with np.load(tmp_path / "s.npz", allow_pickle=False) as archive:
        meta = json.loads(archive["meta"].tobytes())
        assert (meta["first"], meta["frame"], meta["updates"], meta["method"]) == (4, 5, 2, "samplecache")
        np.testing.assert_array_equal(archive["method.mono.mask"], of._graph.of("mono")["mask"].get())
        assert {name.split(".")[0] for name in archive.files} == {"meta", "method"}


def test_there_is_a_state_only_after_a_whole_frame(tmp_path, monkeypatch):
    of = renderer()
    with pytest.raises(SettingError, match=r"s\.npz: there is no frame yet; expected a state after whole frames"):
        of.save(tmp_path / "s.npz")
    frames(of, 0, 1)
    monkeypatch.setattr(of._graph, "run", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        frames(of, 1, 2)
    monkeypatch.undo()
    for _ in range(2):
        with pytest.raises(SettingError, match=r"s\.npz: a frame was broken off"):
            of.save(tmp_path / "s.npz")
        frames(of, 1, 2)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("method", "temporal", "expected"), [(m, "none", m != "pathtrace") for m in METHODS] + [("pathtrace", "taa", True)]
)
def test_which_renders_have_a_state(method, temporal, expected):
    assert renderer(method=method, temporal=temporal).has_state == expected


# What is refused


@pytest.fixture(scope="module")
def saved(tmp_path_factory, device):
    """A state of three frames."""
    path = tmp_path_factory.mktemp("state") / "s.npz"
    of = renderer(temporal="none")
    frames(of, 0, 3)
    of.save(path)
    return path


def repainted(scene):
    return replace(scene, materials=(replace(scene.materials[0], roughness=0.5), *scene.materials[1:]))


def turned(scene):
    return replace(scene, camera=replace(scene.camera, fov_y=1.0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scene": repainted(yard(6))}, r"content of the scene is \w{16} there and \w{16} here"),
        ({"scene": turned(yard(6))}, r"camera's path is \w{16} there and \w{16} here"),
        ({"method": "isrt"}, "method is samplecache there and isrt here"),
        ({"settings": {"samplecache.target": 7}}, "settings samplecache.target is 4.0 there and 7.0 here"),
        ({"settings": {"taa.alpha": 0.5}}, "settings of the image taa.alpha is 0.1 there and 0.5 here"),
        ({"settings": {"octree.jitter": 0}}, "settings of the image octree.jitter is .* there and 0.0 here"),
        ({"settings": {"octree.store": 1}}, "settings octree.store is .* there and 1 here"),
        ({"temporal": "taa"}, "temporal is none there and taa here"),
        ({"memo": "texel"}, "memo is off there and texel here"),
        ({"settings": {"memo.bias": 1}}, "settings memo.bias is 0.0 there and 1.0 here"),
        ({"size": (9, 12)}, r"size is \[12, 9\] there and \[9, 12\] here"),
        ({"stereo": True}, r"eyes is \['mono'\] there and \['left', 'right'\] here"),
        ({"stereo": True, "stereo_blend": "constant"}, "stereo_blend is none there and constant here"),
        ({"seed": 2}, "seed is 0 there and 2 here"),
        ({"spp": 2}, "spp is 1 there and 2 here"),
    ],
)
def test_the_state_of_another_render_is_refused(saved, options, message):
    with pytest.raises(SettingError, match=rf"s\.npz: {message}; expected the same") as caught:
        renderer(**options).restore(saved)
    assert "\n" not in str(caught.value)


def test_how_the_device_is_used_does_not_matter(saved):
    with StateFile(saved) as state:
        names = state.meta["settings"] | state.meta["settings of the image"]
    assert {"pathtrace.bounces", "taa.alpha", "device.fast_math"} <= names.keys()
    assert "device.local_size" not in names


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": "0.0.1"}, r"version is 0\.0\.1 there"),
        ({"method": None}, "method is None there"),
        ({"settings": []}, r"settings is \[\] there"),
        ({"settings": {}}, "settings pathtrace.bounces is None there"),
        ({"seed": 0.0}, "seed is 0.0 there and 0 here"),
        ({"seed": "x" * 5000}, "seed is x{57}"),
        ({"frame": -1}, "frame is -1; expected 0 .. "),
        ({"frame": 2**31}, "frame is 2147483648; expected 0 .. "),
        ({"frame": True}, "frame is True; expected 0 .. "),
        ({"first": "0"}, "first is 0; expected 0 .. "),
        ({"updates": 10**400}, "updates is 1000000"),
        ({"updates": None}, "updates is None; expected 0 .. "),
    ],
)
def test_wrong_numbers_are_refused(saved, tmp_path, changes, message):
    with StateFile(saved) as state:
        meta, arrays = state.meta, {name: state.read(name) for name in state._members if name != "meta"}
    write_state(tmp_path / "s.npz", meta | changes, arrays.items())
    of = renderer()
    with pytest.raises(SettingError, match=message) as caught:
        of.restore(tmp_path / "s.npz")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: None, "lacks method.mono.mask; expected a state of the same method, filters and AOVs"),
        (lambda a: a[:-1], r"method.mono.mask is uint32 \(107, 1\); expected uint32 \(108, 1\)"),
        (lambda a: a.astype(np.int32), "method.mono.mask is int32 .*; expected uint32"),
        (lambda a: a[:, 0], r"method.mono.mask is uint32 \(108,\); expected"),
        (lambda a: a.astype(">u4"), "method.mono.mask is >u4 .*; expected uint32"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_before_any_is_taken(saved, tmp_path, change, message):
    with StateFile(saved) as state:
        meta, arrays = state.meta, {name: state.read(name) for name in state._members if name != "meta"}
    arrays["method.mono.mask"] = change(arrays["method.mono.mask"])
    write_state(tmp_path / "s.npz", meta, ((name, a) for name, a in arrays.items() if a is not None))
    of = renderer()
    with pytest.raises(SettingError, match=message):
        of.restore(tmp_path / "s.npz")
    assert not any(array.get().any() for array in of._kept().values())


@pytest.mark.parametrize(
    ("word", "value"),
    [(3, 3), (3, 2**32 - 2), (2, 2), (2, 2**31), (0, 3 << 24), (1, 1 << 24)],
    ids=["instance", "far instance", "triangle", "far triangle", "material", "far material"],
)
def test_hits_of_what_the_scene_lacks_are_refused(saved, tmp_path, word, value):
    """The yard has three instances, the first of two triangles, and three materials."""
    with StateFile(saved) as state:
        meta, arrays = state.meta, {name: state.read(name) for name in state._members if name != "meta"}
    hits = arrays["method.mono.first_hit"]
    hits[:, 5] = 0
    write_state(tmp_path / "s.npz", meta, arrays.items())
    assert renderer().restore(tmp_path / "s.npz") == 2
    hits[7, 5, word] = value
    write_state(tmp_path / "s.npz", meta, arrays.items())
    of = renderer()
    with pytest.raises(SettingError, match="method.mono.first_hit has triangles that the scene lacks"):
        of.restore(tmp_path / "s.npz")
    assert not any(array.get().any() for array in of._kept().values())


def test_damage_anywhere_is_found_before_anything_is_taken(saved, tmp_path):
    """At the end of the largest array, which is read neither first nor at once."""
    content = bytearray(saved.read_bytes())
    with zipfile.ZipFile(saved) as archive:
        largest = max(archive.infolist(), key=lambda info: info.file_size)
    assert largest.file_size > 2**14
    content[largest.header_offset + largest.file_size - 8] ^= 1
    (tmp_path / STATE_FILE).write_bytes(content)
    of = renderer()
    with pytest.raises(SettingError, match="is damaged"):
        of.restore(tmp_path)
    assert not any(array.get().any() for array in of._kept().values())


# Files that are none

ARRAYS = {
    "a": np.arange(50, dtype=np.float32).reshape(5, 10),
    "b": np.arange(7, dtype=np.uint64),
    "none": np.zeros((0, 3), np.uint32),
}
EXPECTED = {name: (a.shape, a.dtype) for name, a in ARRAYS.items()}


def small(**meta):
    """A file of ARRAYS, as bytes."""
    whole = io.BytesIO()
    np.savez(whole, meta=np.frombuffer(json.dumps(meta).encode(), np.uint8), **ARRAYS)
    return whole.getvalue()


def read_all(path):
    with StateFile(path) as state:
        state.check_arrays(EXPECTED)
        return state.meta, {name: state.read(name) for name in EXPECTED}


def refused(path, message="is damaged, or no state of a render"):
    with pytest.raises(SettingError, match=message) as caught:
        read_all(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_what_is_written_is_read(tmp_path):
    write_state(tmp_path / "a.npz", {"x": [1, 2.5, None]}, ARRAYS.items())
    (tmp_path / "b.npz").write_bytes(small(x=[1, 2.5, None]))
    for name in ("a.npz", "b.npz"):
        meta, arrays = read_all(tmp_path / name)
        assert meta == {"x": [1, 2.5, None]}
        for key, array in ARRAYS.items():
            np.testing.assert_array_equal(arrays[key], array, strict=True)


@given(st.data())
@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_damage_is_found_or_harmless(tmp_path, data):
    """Bytes that are changed, and files that end early or go on: refused, or read as what was written."""
    whole = bytearray(small(x=1))
    for _ in range(data.draw(st.integers(1, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    whole = whole[: data.draw(st.one_of(st.none(), st.integers(0, len(whole))))]
    whole += data.draw(st.binary(max_size=3))
    (tmp_path / "s.npz").write_bytes(whole)
    try:
        meta, arrays = read_all(tmp_path / "s.npz")
    except SettingError as error:
        assert "\n" not in str(error)
        return
    assert meta == {"x": 1}
    for key, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[key], array, strict=True)


def header(shape, descr="<f4", is_fortran=False):
    text = f"{{'descr': {descr!r}, 'fortran_order': {is_fortran}, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def archive(path, compression=zipfile.ZIP_STORED, **members):
    with zipfile.ZipFile(path, "w", compression) as out:
        for name, content in members.items():
            out.writestr(f"{name}.npy", content)


def as_npy(array, **options):
    out = io.BytesIO()
    np.lib.format.write_array(out, array, **options)
    return out.getvalue()


META = as_npy(np.frombuffer(b"{}", np.uint8))
OTHERS = {name: as_npy(array) for name, array in ARRAYS.items()}


@pytest.mark.parametrize(
    "members",
    [
        {"a": header((2**40,)) + b"1234"},
        {"a": header((2**62, 2**62)) + b"1234"},
        {"a": header((-5, -10)) + bytes(200)},
        {"a": header((5, 10), is_fortran=True) + bytes(200)},
        {"a": header((5, 10)) + bytes(199)},
        {"a": header((5, 10)) + bytes(201)},
        {"a": header((5, 10), "|O") + bytes(400)},
        {"a": header(("5", "10")) + bytes(200)},
        {"a": header((5, 10), "<f4" * 9000) + bytes(200)},
        {"a": b"\x93NUMPY\x01\x00\xff\xff{" + b"[" * 65534},
        {"a": b"\x93NUMPY\x01\x00\x84\x03" + b"(" * 900},
        {"a": b"\x93NUMPY\x01\x00\x83\x03" + b"{1: " + b"-" * 893 + b"1}"},
        {"a": b"\x93NUMPY\x01\x00\x46\x1f" + b"{1: " + b"-" * 8000 + b"1}"},
        {"a": b"\x93NUMPY\x03\x00" + OTHERS["a"][8:]},
        {"a": as_npy(np.array([{}], object), allow_pickle=True)},
        {"a": b"not an array"},
        {"meta": b"not an array"},
        {"meta": as_npy(np.frombuffer(b"[1]", np.uint8))},
        {"meta": as_npy(np.frombuffer(b"{", np.uint8))},
        {"meta": as_npy(np.frombuffer(b"\xff\xfe", np.uint8))},
        {"meta": as_npy(np.frombuffer(b"[" * 100_000, np.uint8))},
        {"meta": as_npy(np.zeros(2**20 + 1, np.uint8))},
    ],
)
def test_members_that_are_no_arrays_are_refused(tmp_path, members):
    archive(tmp_path / "s.npz", **({"meta": META} | OTHERS | members))
    refused(tmp_path / "s.npz")


def test_arrays_that_unfold_are_refused(tmp_path):
    """Of a bomb, each kilobyte is a megabyte."""
    bomb = header((2**22,)) + bytes(2**24)
    archive(tmp_path / "s.npz", zipfile.ZIP_DEFLATED, **({"meta": META} | OTHERS | {"a": bomb}))
    assert (tmp_path / "s.npz").stat().st_size < 2**15
    refused(tmp_path / "s.npz")
    archive(tmp_path / "s.npz", **({"meta": META} | OTHERS))
    read_all(tmp_path / "s.npz")


@pytest.mark.parametrize("comment", [b"", b"just" + bytes(18)])
def test_lists_of_members_that_are_too_long_are_not_read(tmp_path, monkeypatch, comment):
    """Nor are those behind whose end something stands that says otherwise."""
    archive(tmp_path / "s.npz", **({"meta": META} | OTHERS | {f"m{k}": b"" for k in range(1200)}))
    with zipfile.ZipFile(tmp_path / "s.npz", "a") as out:
        out.comment = comment
    opened = []
    monkeypatch.setattr(zipfile, "ZipFile", lambda file: opened.append(file))
    refused(tmp_path / "s.npz")
    assert not opened


@pytest.mark.parametrize("content", [b"", b"PK", b"PK\5\6" + bytes(18), b"x" * 1000])
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "s.npz").write_bytes(content)
    refused(tmp_path / "s.npz")


def test_names_that_are_no_files_are_refused(tmp_path):
    refused(tmp_path / "s.npz", "no such file; expected what clcache render --save-state writes")
    with pytest.raises(SettingError, match=r"state\.npz: no such file"):
        StateFile(tmp_path)
    (tmp_path / "folder" / STATE_FILE).mkdir(parents=True)
    os.mkfifo(tmp_path / "pipe")
    for path in ("folder", "pipe"):
        with pytest.raises(SettingError, match=r"cannot be read \(it is no regular file\)"):
            StateFile(tmp_path / path)


# Another sequence of the same scene


class Known:
    """A method that counts its updates in a buffer of the world, and is as bright as that."""

    def __init__(self, world=("known",)):
        self.world, self.updates = world, []

    def __call__(self, setup):
        n = setup.size[0] * setup.size[1]
        buffers = (
            Buffer("known", (4,), persistent=True),
            Buffer("seen", (n,), persistent=True, per_eye=True),
            Buffer("color", (n, 3), per_eye=True),
            Buffer("ray_counts", (2, 4), "u4"),
        )
        return Method(
            (Step("learn", ("known", "seen"), ("known", "seen", "color", "ray_counts"), self.learn),),
            buffers,
            world=self.world,
        )

    def learn(self, arrays, state):
        self.updates.append(state.update)
        put(arrays["known"], arrays["known"].get() + 1)
        put(arrays["seen"], arrays["seen"].get() + 1)
        put(arrays["color"], [arrays["known"].get()[0], arrays["seen"].get()[0], 0])


@pytest.fixture
def known(monkeypatch, tmp_path):
    """A method that has learnt from three updates of two eyes; the state is in tmp_path."""
    known = Known()
    monkeypatch.setitem(METHODS, "voxelhash", known)
    of = renderer(everything(), "voxelhash", stereo=True, temporal="none")
    frames(of, 0, 3)
    of.save(tmp_path / STATE_FILE)
    known.updates.clear()
    return known


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"size": (5, 4)},
        {"stereo": True},
        {"seed": 9},
        {"spp": 2},
        {"settings": {"taa.alpha": 0.7}},
        {"settings": {"octree.samples": 1, "octree.caching_resolution": 0, "octree.filter": "none"}},
        {"settings": {"device.local_size": 32}},
        {"scene": turned(everything())},
    ],
)
def test_a_warm_start_knows_the_world_and_nothing_of_the_images(known, tmp_path, options):
    of = renderer(**{"scene": everything(), "method": "voxelhash", "temporal": "none"} | options)
    of.warm_start(tmp_path)
    frame = next(of.frames(20, 21))
    spp = options.get("spp", 1)
    first = next(iter(frame.color.values()))[0, 0]
    assert first.tolist() == [6 + spp, spp, 0]
    assert known.updates == [3 + k for _ in frame.color for k in range(spp)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scene": repainted(everything())}, "content of the scene is .* there and .* here; expected the same"),
        ({"settings": {"pathtrace.bounces": 1}}, "settings pathtrace.bounces is 3 there and 1 here"),
        ({"settings": {"octree.resolution": 128}}, "settings octree.resolution is 64 there and 128 here"),
        ({"settings": {"octree.length": 2}}, "settings octree.length is .* there and 2 here"),
        (
            {"method": "samplecache", "scene": yard(6)},
            "method samplecache keeps nothing that another sequence could begin with",
        ),
        (
            {"method": "pathtrace", "scene": yard(6)},
            "method pathtrace keeps nothing that another sequence could begin with",
        ),
    ],
)
def test_a_warm_start_from_elsewhere_is_refused(known, tmp_path, options, message):
    of = renderer(**{"scene": everything(), "method": "voxelhash", "temporal": "none"} | options)
    with pytest.raises(SettingError, match=message):
        of.warm_start(tmp_path)


def test_a_warm_start_finds_voxels(tmp_path):
    """Of most points that the first frame of another render asks for."""
    learnt = renderer(method="voxelhash", stereo=True)
    frames(learnt, 0, 6)
    learnt.save(tmp_path / "s.npz")
    cold, warm = (renderer(method="voxelhash", seed=7) for _ in range(2))
    warm.warm_start(tmp_path / "s.npz")
    cold, warm = (next(of.frames(5, 6)).stats["eyes"]["mono"]["cache"] for of in (cold, warm))
    assert warm["hits"] > 0.7 * warm["lookups"] > cold["hits"] + 0.3 * cold["lookups"]
    assert warm["occupied"] > 2 * cold["occupied"]


def test_a_warm_start_comes_first(known, tmp_path):
    of = renderer(everything(), "voxelhash", temporal="none")
    frames(of, 0, 1)
    with pytest.raises(SettingError, match="there are frames already; expected a warm start before the first"):
        of.warm_start(tmp_path)
