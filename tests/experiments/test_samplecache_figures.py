"""The figures of the sample cache: what they name exists, every pass that is timed is in one stage, and a small one runs through."""

from dataclasses import replace
from pathlib import Path

import pytest

import clcache
from clcache.bench.reproject import SLOTS, Reprojection, cache_content
from clcache.bvh.tracer import Tracer
from clcache.experiments import reprojection, samplecache_figures
from clcache.experiments.experiment import Calls, Experiment, Sequences, Truth
from clcache.experiments.job import Job, Machine, function_of, perform, scene_entry, with_needs
from clcache.experiments.samplecache_figures import EXPERIMENTS, STAGES, paths, samples
from clcache.resources import SceneResources
from clcache.settings import SETTINGS

DATA = Path(clcache.__file__).parents[1] / "data"
BY_NAME = {e.name: e for e in EXPERIMENTS}
ROOM = """
[camera]
position = [0.0, 1.0, 4.0]
look_at = [0.0, 1.0, 0.0]

[environment]
color = [0.5, 0.6, 0.7]

[meshes.ball]
generator = "sphere"
radius = 1.0
subdivisions = 3

[[instances]]
mesh = "ball"
"""


def sequences(experiment: Experiment) -> list[Sequences]:
    """Its plans that are sequences, at real size and at small."""
    plans = [plan for plan in experiment.plans if isinstance(plan, Sequences)]
    return [made for plan in plans for made in (plan, replace(plan, **plan.quick))]


@pytest.fixture
def room(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(ROOM)
    return scene_entry(file)


def test_all_figures_are_there():
    figures = (6, 7, 8, 9, 10, 12, 13, 14, 15, 18, 19)
    assert [e.name for e in EXPERIMENTS if "fig" in e.name] == [f"samplecache-fig{n}" for n in figures]
    assert len(BY_NAME) == len(EXPERIMENTS)


@pytest.mark.parametrize("name", BY_NAME)
def test_what_an_experiment_names_is_there(name):
    experiment = BY_NAME[name]
    for plan in sequences(experiment):
        assert all((DATA / scene / "scene.toml").is_file() for scene in plan.scenes)
        assert plan.frames[0] + plan.skip < plan.frames[1]
        counted = range(plan.frames[0] + plan.skip, plan.frames[1])
        assert set(plan.pictures) <= set(plan.truth.frames) <= set(counted)
        names = [c.name for c in plan.configurations]
        assert len(set(names)) == len(names)
        for configuration in plan.configurations:
            for key, value in configuration.settings.items():
                SETTINGS[key].parse(value)
    for is_quick in (False, True):
        plans = sequences(experiment)[int(is_quick) :: 2]
        if not plans:
            continue
        known = {c.name for plan in plans for c in plan.configurations}
        scenes = {scene for plan in plans for scene in plan.scenes}
        for claim in experiment.claims:
            assert {claim.of, claim.over or claim.of} <= known
            assert is_quick or set(claim.scenes) <= scenes
        assert is_quick or set(experiment.ladder) <= known
        assert {row["configuration"] for row in experiment.paper} <= known


def test_configurations_shade_as_the_paper_does():
    """None depends on the project's own defaults for how much is shaded."""
    configurations = [c for e in EXPERIMENTS for plan in sequences(e) for c in plan.configurations]
    cached = [c for c in configurations if c.method in ("samplecache", "isrt")]
    assert all({"samplecache.shading", "samplecache.shading_rate"} <= c.settings.keys() for c in cached)


def test_stages_have_no_pass_twice():
    for stages in (STAGES, samplecache_figures.STEREO_STAGES):
        passes = [name for names in stages.values() for name in names]
        assert len(set(passes)) == len(passes)
    assert {name for names in samplecache_figures.STEREO_STAGES.values() for name in names} < {
        name for names in STAGES.values() for name in names
    }


def test_every_pass_is_in_a_stage(room):
    """Of all methods and filters that are measured: a stage `other` would have what is in none."""
    configurations = (
        paths(1, "taa"),
        samples("samples", temporal="varianceblend", stereo_blend="samples", shading="adaptive"),
        samples("neighbourhood", stereo_blend="varianceblend"),
        samplecache_figures.stable(3),
        samplecache_figures.voxels("voxels", temporal="varianceblend"),
        samplecache_figures.voxels("hybrid", "hybrid"),
    )
    parameters = {
        "scene": room,
        "configurations": [c.entry() for c in configurations],
        "size": [16, 16],
        "frames": [0, 2],
        "skip": 1,
        "stereo": True,
        "slower": 1,
        "still": None,
        "seed": 1,
        "metrics": [],
        "stages": STAGES,
        "pictures": [],
    }
    rows = perform(Job("sequence", parameters), {}, Machine()).rows
    for row in rows:
        assert "stage.other" not in row
        assert sum(row[f"stage.{stage}"] for stage in STAGES) == pytest.approx(row["device"])
    assert {row["configuration"] for row in rows} == {c.name for c in configurations}


def test_a_figure_runs_through(tmp_path):
    """Fig. 7, in little: its tables' columns and its claims' measures are there."""
    pytest.importorskip("flip_evaluator")
    little = {
        "scenes": ("room",),
        "size": (32, 18),
        "frames": (0, 3),
        "skip": 1,
        "truth": Truth(4, (2,)),
        "pictures": (2,),
    }
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "scene.toml").write_text(ROOM)
    fig7 = BY_NAME["samplecache-fig7"]
    fig7 = replace(fig7, plans=(replace(fig7.plans[0], **little), replace(fig7.plans[1], **little)))
    labelled = fig7.jobs(tmp_path, [1])
    results = {}
    for job in with_needs([one.job for one in labelled]):
        needed = {name: results[of.key] for name, of in job.needs.items()}
        results[job.key] = perform(job, needed, Machine())
    rows = [row for one in labelled for row in results[one.job.key].rows if row["counted"]]
    of = {name: [row for row in rows if row["configuration"] == name] for name in ("single", "multi", "adaptive")}
    for column in (column for table in fig7.tables for column in table.columns):
        assert all(column.of in row for row in of["multi"] if "relmse" in row)
    for row in of["multi"]:
        parts = [row[f"stage.{stage}"] for stage in STAGES if stage != "shading"]
        assert row["stage.unshaded"] == pytest.approx(sum(parts))
    rays = {name: sum(row["rays.primary"] for row in found) for name, found in of.items()}
    assert max(rays["single"], rays["adaptive"]) < rays["multi"]
    assert set(fig7.ladder) <= {row["configuration"] for row in rows}


# ---------------------------------------------------------------------------------------------------------------------
# Fig. 6


def test_kind_of_every_call_is_known():
    for call in (plan for e in EXPERIMENTS for plan in e.plans if isinstance(plan, Calls)):
        assert callable(function_of(call.kind))


def test_reprojections_stand_side_by_side(room):
    """Times are of the same work."""
    fig6 = BY_NAME["samplecache-fig6"]
    told = {"scene": room, "size": [64, 64], "repeats": 1, "runs": 1, "seed": 1}
    found = {row["configuration"]: row for row in reprojection.run(told, {}, Machine()).rows}
    claimed = {name for claim in fig6.claims for name in (claim.of, claim.over) if name}
    assert claimed | {row["configuration"] for row in fig6.paper} <= found.keys()
    assert len(found) == 8
    for name, row in found.items():
        assert row["seconds"] == pytest.approx(row["stage.reserve"] + row["stage.copy"])
        assert (row["stage.copy"] > 0) == name.startswith(("two-pass", "deterministic"))
        assert row["samples"] == 64 * 64 * (1 if name.startswith("simple") else 4)
        can_race = row["threads"] > 1 and not name.startswith("simple") and not name.endswith("-no-shade")
        assert {"step", "crowd"} & row.keys() == ({"step", "crowd"} if can_race else set())
        if can_race and not name.startswith("single-pass"):
            assert (row["step"], row["crowd"]) == (0, 0)
    with pytest.raises(clcache.SettingError, match="^size 16x16: expected 4096 .."):
        reprojection.run(told | {"size": [16, 16]}, {}, Machine())


def test_spoilt_slots_are_counted(room):
    """Slots are spoilt by hand after a reprojection: one's visibility, the other's radiance."""
    scene, device = clcache.load_scene(room["file"]), Machine().open()
    content = cache_content(Tracer(scene, device), scene, (64, 64))
    passes = Reprojection(device, SceneResources(device, scene), (64, 64), content, "two-pass")
    run_slots = passes.run_slots

    def spoil():
        seconds = run_slots()
        mask, radiance = (passes.arrays[name].get() for name in ("mask", "shading"))
        first, second = (mask[:, 0] & 1).nonzero()[0][[0, -1]]
        mask[first, 0] ^= 1 << SLOTS
        radiance[0, second, 1] += 1
        passes.arrays["mask"].set(mask)
        passes.arrays["shading"].set(radiance)
        return seconds

    slots, visibility, radiance = reprojection.count(passes, content, is_crowd=False)
    assert slots > 4000 and (visibility, radiance) == (0, 0)
    assert reprojection.count(passes, content, is_crowd=True)[1:] == (0, 0)
    passes.run_slots = spoil
    assert reprojection.count(passes, content, is_crowd=False) == (slots, 1, 1)
    passes.release()
