"""Sequences and references: what their rows say, worked out another way."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import clcache
from clcache import Renderer, SettingError, load_scene
from clcache.experiments.configuration import Configuration
from clcache.experiments.experiment import Sequences, Truth
from clcache.experiments.job import Job, Machine, Result, perform
from clcache.experiments.quality import squared_error
from clcache.experiments.reference import timeline
from clcache.experiments.sequence import Judge, alternating, by_stage, center_depth, of_frame, references_of
from clcache.metrics import View, reprojected_difference
from clcache.renderer import Frame
from clcache.scene.model import Camera
from clcache.scene.motion import pose_at

DATA = Path(clcache.__file__).parents[1] / "data"
SIZE = (48, 27)
ONE = Machine()


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder of scenes: the Cornell box, through which the camera moves."""
    still = (DATA / "cornell" / "scene.toml").read_text()
    place = "position = [0.0, 1.125, 4.2]\nlook_at = [0.0, 1.125, 0.0]\n"
    keys = [(0.0, "[0.0, 1.125, 4.2]"), (1.0, "[0.9, 1.4, 3.6]")]
    lines = [f"{{ time = {time}, position = {p}, look_at = [0.0, 1.125, 0.0] }}" for time, p in keys]
    assert place in still
    folder = tmp_path_factory.mktemp("data")
    (folder / "moving").mkdir()
    (folder / "moving" / "scene.toml").write_text(still.replace(place, f"keys = [{', '.join(lines)}]\n"))
    return folder


@pytest.fixture(scope="module")
def scene(data):
    """That box."""
    return load_scene(data / "moving" / "scene.toml")


@pytest.fixture(scope="module")
def plan():
    """Two configurations of an animated camera, in stereo, at half the scene's speed."""
    configurations = (
        Configuration("paths", "pathtrace", spp=2),
        Configuration("cache", "samplecache", {"samplecache.slots": 6}),
    )
    return Sequences(
        ("moving",),
        configurations,
        size=SIZE,
        frames=(2, 6),
        skip=2,
        stereo=True,
        slower=2,
        truth=Truth(4, (3, 4), 2),
        metrics=("relmse", "rmse"),
        stages={"first": ("trace_camera",)},
        pictures=(4,),
    )


@pytest.fixture(scope="module")
def made(plan, data):
    """The job and what it found."""
    (labelled,) = plan.jobs(data, [5], False)
    needed = {name: perform(job, {}, ONE) for name, job in labelled.job.needs.items()}
    return labelled.job, needed, perform(labelled.job, needed, ONE)


def slowed(scene, factor):
    return dataclasses.replace(scene, defaults=dataclasses.replace(scene.defaults, fps=scene.defaults.fps * factor))


def test_rows_are_of_all_frames_and_say_what_there_is(made):
    _, _, found = made
    assert [(r["configuration"], r["frame"], r["counted"]) for r in found.rows] == [
        (name, frame, frame >= 4) for name in ("paths", "cache") for frame in range(2, 6)
    ]
    for row in found.rows:
        # Frame 3 has references, and does not count; 4 has and does.
        assert ("relmse" in row, "rmse" in row, "stereo_reference" in row) == (row["frame"] == 4,) * 3
        assert ("difference" in row, "stereo" in row) == (row["counted"],) * 2
        passes = [value for name, value in row.items() if name.startswith("pass.")]
        assert row["device"] == pytest.approx(sum(passes)) and row["device"] > 0
        assert row["stage.first"] == row.get("pass.trace_camera", 0.0)
        assert row["stage.first"] + row["stage.other"] == pytest.approx(row["device"])
        assert row["memory.total"] > row["memory.bvh"] > 0
        assert (row["memory.cache"] > 0) == (row["configuration"] == "cache") == ("cache.occupied" in row)
    # Two eyes of two samples for each pixel.
    assert {r["rays.primary"] for r in found.rows if r["configuration"] == "paths"} == {4 * SIZE[0] * SIZE[1]}


def test_rows_are_what_a_renderer_gives(made, scene):
    """The same frames rendered once more, and measured by hand."""
    job, needed, found = made
    slow = slowed(scene, 2)
    renderer = Renderer(slow, "pathtrace", SIZE, stereo=True, seed=5, spp=2)
    before, now = renderer.frames(3, 5)
    row = next(r for r in found.rows if r["configuration"] == "paths" and r["frame"] == 4)
    errors = {}
    for eye in ("left", "right"):
        references = [needed[f"4/{seed}"].arrays[eye] for seed in (1000, 1001)]
        errors[eye] = squared_error(now.color[eye], references).mean()
        kept = found.arrays[f"picture/paths/4/{eye}"]
        assert kept.dtype == np.float16 and np.allclose(kept, now.color[eye], rtol=1e-3, atol=1e-4)
        mean = found.arrays[f"picture/reference/4/{eye}"]
        assert np.allclose(mean, np.mean(references, axis=0), rtol=1e-3, atol=1e-4)
    assert row["relmse"] == pytest.approx(np.mean(list(errors.values())))
    tracer = clcache.Tracer(scene)

    def view_of(frame, eye):
        depth = center_depth(tracer, frame.cameras[eye], frame.color[eye].shape)
        return View(frame.color[eye], depth, frame.cameras[eye])

    flicker = [reprojected_difference(view_of(now, eye), view_of(before, eye)).mean for eye in ("left", "right")]
    assert row["difference"] == pytest.approx(np.mean(flicker))
    eyes = reprojected_difference(view_of(now, "left"), view_of(now, "right"))
    assert row["stereo"] == pytest.approx(eyes.mean)


def test_what_is_found_depends_on_nothing_but_the_parameters(made):
    job, needed, found = made
    again = perform(job, needed, ONE)

    def apart_from_times(rows):
        timed = ("seconds", "device", "pass.", "stage.")
        return [{name: value for name, value in row.items() if not name.startswith(timed)} for row in rows]

    assert apart_from_times(again.rows) == apart_from_times(found.rows)
    assert again.arrays.keys() == found.arrays.keys()
    assert all(np.array_equal(again.arrays[name], found.arrays[name]) for name in found.arrays)


def test_a_reference_is_that_frame_by_path_tracing(made, scene):
    _, needed, _ = made
    result = needed["4/1000"]
    assert result.rows[0]["frame"] == 4 and result.rows[0]["spp"] == 4
    assert result.arrays.keys() == {"left", "right"}
    (frame,) = Renderer(slowed(scene, 2), "pathtrace", SIZE, stereo=True, seed=1000, spp=4).frames(4, 5)
    for eye, color in result.arrays.items():
        assert color.dtype == np.float32 and np.array_equal(color, frame.color[eye])
    assert not np.array_equal(needed["4/1000"].arrays["left"], needed["4/1001"].arrays["left"])


def test_timelines(scene):
    fps = scene.defaults.fps

    def pose(of, number):
        return pose_at(of.camera.motion, number / of.defaults.fps)

    slow, offset = timeline(scene, 3, None)
    assert offset == 0 and np.allclose(pose(slow, 21), pose_at(scene.camera.motion, 7 / fps))
    still, offset = timeline(scene, 1, 7)
    poses = [pose(still, offset + n) for n in (0, 100)]
    assert np.allclose(poses, pose(scene, 7), atol=1e-4)
    assert not np.allclose(pose(scene, 8), pose(scene, 7), atol=1e-3)


def test_frames_that_all_count_for_nothing(made):
    job, _, _ = made
    with pytest.raises(SettingError, match="frames 2:4: expected more than the 2"):
        perform(Job("sequence", {**job.parameters, "frames": [2, 4]}), {}, ONE)


# ---------------------------------------------------------------------------------------------------------------------
# The parts by themselves


def view(value):
    camera = Camera(np.eye(3, 4), np.radians(60), 0.0)
    color = np.full((24, 32, 3), value, np.float32)
    return View(color, np.full((24, 32), 2.0, np.float32), camera)


def test_where_no_frame_with_references_counts_all_are_compared():
    references = {1: {"mono": [np.ones((24, 32, 3), np.float32)]}}
    for counted in (0, 1, 2):
        judge = Judge(references, ["rmse"], counted)
        found = [judge.judge(n, {"mono": view(n).color}, [view(n)]) for n in range(3)]
        assert ["rmse" in f for f in found] == [False, True, False]
        assert ["difference" in f for f in found] == [False, counted <= 1, True]
        assert found[2]["difference"] == pytest.approx(1.0)
    both = references | {2: references[1]}
    judge = Judge(both, ["rmse"], 2)
    assert ["rmse" in judge.judge(n, {"mono": view(n).color}, [view(n)]) for n in range(3)] == [False, False, True]


def test_each_in_turn_is_first():
    order = []

    @dataclass
    class Fake:
        name: str

        def frames(self, first, last):
            for number in range(first, last):
                order.append((number, self.name))
                yield number

    turns = list(alternating({name: Fake(name) for name in "abc"}, 4, 8))
    assert turns == [dict.fromkeys("abc", number) for number in range(4, 8)]
    assert ["".join(name for n, name in order if n == number) for number in range(4, 8)] == ["abc", "bca", "cab", "abc"]


def test_sums_over_eyes():
    def eye(k):
        tables = {"passes": {"a": 1.0 * k, "b": 2.0}, "rays": {"shadow": k}, "cache": {"hits": k, "memo": 1}}
        return tables | {"memo": {"hits": 5}}

    row = of_frame(
        Frame(3, {}, {}, {"seconds": 9.0, "eyes": {"left": eye(1), "right": eye(10)}}, {}), {"s": ("b", "c")}
    )
    assert row == {
        **dict.fromkeys(("pass.a", "stage.other"), 11.0),
        "seconds": 9.0,
        "device": 15.0,
        "pass.b": 4.0,
        "stage.s": 4.0,
        "rays.shadow": 11,
        "cache.hits": 11,
        "cache.memo": 2,
        "memo.hits": 10,
    }
    # Of a renderer that says nothing but its time.
    assert of_frame(Frame(3, {}, {}, {"seconds": 9.0, "eyes": {}}, {}), {"s": ("b",)}) == {"seconds": 9.0}


def test_stages_leave_nothing_out():
    assert by_stage({"a": 1.0, "b": 2.0, "c": 4.0}, {"x": ("a", "b"), "y": ("d",)}) == {
        "x": 3.0,
        "y": 0.0,
        "other": 4.0,
    }
    assert by_stage({"a": 1.0}, {"x": ("a",)}) == {"x": 1.0}
    assert by_stage({"a": 1.0}, {}) == {}


def test_references_by_frame():
    one, two, three = (np.full((2, 2, 3), n) for n in range(3))
    needed = {
        "4/1000": Result([], {"left": one}),
        "4/1001": Result([], {"left": two}),
        "9/1000": Result([], {"left": three}),
    }
    assert references_of(needed) == {4: {"left": [one, two]}, 9: {"left": [three]}}


def test_center_depth_is_planar():
    """A floor below a camera that looks down at 45 degrees, by the intersection of a line and a plane."""
    scene = load_scene(DATA / "cornell" / "scene.toml")
    tracer = clcache.Tracer(scene)
    c = np.sqrt(0.5)
    transform = np.array([[1, 0, 0, 0.1], [0, c, c, 1.0], [0, -c, c, 0.3]])
    depth = center_depth(tracer, Camera(transform, np.radians(20), 0.0), (6, 8, 3))
    y = (1 - 2 * (np.arange(6) + 0.5) / 6) * np.tan(np.radians(10))
    expected = 1.0 / (c - c * y)  # height above the floor over the downward part of a direction of depth 1
    assert np.allclose(np.median(depth, axis=1), expected, rtol=1e-5)
