"""The experiment with Mitsuba: that both renderers show the same, that each is held against its own truth, and who is set beside whom."""

from pathlib import Path

import numpy as np
import pytest

import clcache
from clcache import Renderer, load_scene
from clcache.experiments.configuration import Configuration
from clcache.experiments.experiment import Truth
from clcache.experiments.job import Machine, perform
from clcache.experiments.mitsuba import (
    DENOISED,
    EXPERIMENTS,
    OURS,
    RAW,
    Beside,
    Mitsuba,
    Peer,
    TwoTruths,
    beside,
    eye_cameras,
    set_beside,
    split,
)
from clcache.experiments.sequence import EYES, Judge
from clcache.passes.denoise import Denoiser
from clcache.scene.model import Camera

DATA = Path(clcache.__file__).parents[1] / "data"


def test_what_is_set_beside_takes_no_less_time():
    seconds = {"ours": 2.0, "slow": 9.0, f"{RAW} 1 spp": 1.0, f"{RAW} 2 spp": 2.5, f"{RAW} 4 spp": 4.0}
    seconds |= {f"{DENOISED} 1 spp": 2.0, f"{DENOISED} 2 spp": 3.0}
    rows = [
        {"configuration": name, "counted": counts, "seconds": s + off}
        for name, s in seconds.items()
        # The first frame, in which kernels are compiled, counts for nothing; of the others the middle one does.
        for counts, off in ((False, 100.0), (True, -0.5), (True, 0.0), (True, 8.0))
    ]
    theirs = [name for name in seconds if name.startswith(RAW)]
    assert set_beside(rows, ["ours", "slow"], theirs) == {
        beside(RAW, "ours"): f"{RAW} 2 spp",
        beside(DENOISED, "ours"): f"{DENOISED} 1 spp",
    }


def test_eyes_are_where_the_renderer_has_them():
    scene = load_scene(DATA / "classroom" / "scene.toml")
    renderer = Renderer(scene, "pathtrace", (8, 8), stereo=True, spp=1)
    (frame,) = renderer.frames(9, 10)
    cameras = eye_cameras(scene, 9 / scene.defaults.fps)
    for eye in EYES:
        assert np.allclose(cameras[eye].transform, frame.cameras[eye].transform, rtol=0, atol=1e-12)
        assert cameras[eye].fov_y == frame.cameras[eye].fov_y


def test_each_is_held_against_its_own_truth():
    from clcache.metrics import View

    truths = [{0: {"mono": [np.full((24, 32, 3), value)]}} for value in (1.0, 3.0)]
    judge = TwoTruths(*(Judge(truth, ["rmse", "relmse"], 0) for truth in truths))
    color = np.full((24, 32, 3), 1.5, np.float32)
    found = judge.judge(0, {"mono": color}, [View(color, np.ones((24, 32)), Camera(np.eye(3, 4), 1.0, 0.0))])
    assert found["rmse"] == pytest.approx(0.5) and found["other.rmse"] == pytest.approx(1.5)
    assert found.keys() == {"rmse", "relmse", "relmse_error", "other.rmse", "other.relmse", "other.relmse_error"}


def test_jobs_are_of_both_truths():
    (experiment,) = EXPERIMENTS
    for is_quick in (True, False):
        (plan,) = experiment.plans
        for labelled in experiment.jobs(DATA, [1, 2], is_quick):
            job = labelled.job
            kinds = {name.partition("/")[0]: of.kind for name, of in job.needs.items()}
            assert job.kind == "mitsuba" and kinds == {"ours": "reference", "theirs": "mitsuba_reference"}
            told = plan.quick if is_quick else vars(plan)
            assert len(job.needs) == 4 * len(told["truth"].frames)
            assert job.parameters["spp"] == list(told["spp"]) and job.parameters["stereo"] is True
    names = {c.name for c in OURS}
    assert {claim.of for claim in experiment.claims} == names
    assert {claim.over for claim in experiment.claims} == {beside(kind, n) for kind in (RAW, DENOISED) for n in names}


@pytest.fixture(scope="module")
def box():
    """The Cornell box, in Mitsuba; of which both renderers understand all. Other tests have the variant that they chose."""
    mi = pytest.importorskip("mitsuba")
    scene, before = load_scene(DATA / "cornell" / "scene.toml"), mi.variant()
    try:
        yield Mitsuba(scene, (32, 18), 1)
    except clcache.Error as error:
        pytest.skip(str(error))
    finally:
        if before:
            mi.set_variant(before)


def test_both_renderers_show_the_same_to_each_eye(box):
    """Wherever the head is: the launch is recorded for the first camera."""
    renderer = Renderer(box.scene, "pathtrace", (32, 18), stereo=True, spp=64, seed=1)
    (frame,) = renderer.frames(0, 1)
    cameras = eye_cameras(box.scene, 0.0)
    aside = {e: Camera(c.transform + np.outer([1, 0.2, 0], [0, 0, 0, 1]), c.fov_y, c.near) for e, c in cameras.items()}
    moved = box.color(aside, 64, 1)
    both = box.color(cameras, 64, 1)
    assert both.shape == (18, 64, 3) and both.dtype == np.float32
    assert np.array_equal(box.color(cameras, 64, 1), both) and not np.array_equal(box.color(cameras, 64, 2), both)
    eyes = split(both)
    for eye, other in (EYES, EYES[::-1]):
        ours = frame.color[eye]
        assert eyes[eye].mean() == pytest.approx(ours.mean(), rel=0.05)

        def distance(picture, ours=ours):
            return np.mean((picture - ours) ** 2)

        assert distance(eyes[eye]) < 0.7 * min(distance(eyes[other]), distance(split(moved)[eye]))


def test_denoised_pictures_are_nearer_to_the_truth(box):
    pytest.importorskip("pyoidn")
    truth = split(box.color(eye_cameras(box.scene, 0.0), 64, 5))
    errors = []
    for denoiser in (None, Denoiser(1)):
        (frame,) = Peer(box, 1, 3, denoiser).frames(0, 1)
        assert frame.color.keys() == frame.cameras.keys() == set(EYES) and frame.stats["seconds"] > 0
        errors.append(np.mean([np.mean((frame.color[eye] - truth[eye]) ** 2) for eye in EYES]))
    assert errors[1] < 0.5 * errors[0]


def test_a_job(box):
    pytest.importorskip("pyoidn")
    configuration = Configuration("paths", "pathtrace", spp=1)
    plan = Beside(
        ("cornell",),
        (configuration,),
        size=(32, 18),
        frames=(0, 2),
        skip=1,
        truth=Truth(2, (1,)),
        pictures=(1,),
        spp=(1,),
    )
    (labelled,) = plan.jobs(DATA, [1], False)
    needed = {name: perform(job, {}, Machine()) for name, job in labelled.job.needs.items()}
    found = perform(labelled.job, needed, Machine())
    own = ["paths", f"{RAW} 1 spp", f"{DENOISED} 1 spp"]
    names = list(dict.fromkeys(row["configuration"] for row in found.rows))
    assert names[:3] == own and set(names[3:]) <= {beside(kind, "paths") for kind in (RAW, DENOISED)}
    for row in found.rows:
        assert ("relmse" in row, "other.relmse" in row, "stereo" in row, "difference" in row) == (row["counted"],) * 4
        assert ("spp" in row) == (row["configuration"] != "paths") == ("memory.total" not in row)
    shown = {name.split("/")[1] for name in found.arrays}
    assert shown == {*names, "reference"}
