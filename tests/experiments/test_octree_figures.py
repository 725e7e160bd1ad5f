"""The experiments on the octree's cache, and the kinds of jobs that only they have."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from figure_checks import check_names, check_plans

import clcache
from clcache.errors import Error
from clcache.experiments import octree_figures as figures
from clcache.experiments.experiment import Truth
from clcache.experiments.job import Job, Machine, perform, scene_entry
from clcache.experiments.octree_jobs import by_part, shines
from clcache.scene.model import Material

DATA = Path(clcache.__file__).parents[1] / "data"
SCENE = """
[render]
fps = 10

[camera]
fov_y = 60
keys = [
  { time = 0.0, position = [0.0, 0.5, 3.0], look_at = [0.0, 0.5, 0.0] },
  { time = 1.0, position = [0.0, 2.5, 3.0], look_at = [0.0, 2.5, 0.0] },
]

[environment]
color = [0.5, 0.6, 0.7]

[materials.gloss]
specular = 1.0
roughness = 0.2

[meshes.wall]
generator = "plane"
size = [9.0, 2.0]

[meshes.ball]
generator = "sphere"
radius = 0.5

[[instances]]
mesh = "wall"
rotation = { axis = [1, 0, 0], degrees = 90 }

[[instances]]
mesh = "ball"
material = "gloss"
translation = [0.5, 0.5, 0.5]
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder as data/, with one small scene."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "small").mkdir()
    (folder / "small" / "scene.toml").write_text(SCENE)
    return folder


def done(plan, data):
    """What the plan's one job has found, by configuration and frame."""
    (labelled,) = replace(plan, scenes=("small",), quick={}).jobs(data, [1], False)
    needed = {name: perform(job, {}, Machine()) for name, job in labelled.job.needs.items()}
    found = perform(labelled.job, needed, Machine())
    return {(row["configuration"], row["frame"]): row for row in found.rows}, found.arrays


def coarse(*configurations):
    """With the coarsest octree, which is built at once."""
    return tuple(
        c if c.method != "octree" else replace(c, settings=c.settings | {"octree.resolution": 64})
        for c in configurations
    )


@pytest.mark.parametrize("experiment", figures.EXPERIMENTS, ids=lambda e: e.name)
@pytest.mark.parametrize("is_quick", [False, True])
def test_experiments_are_in_keeping_with_themselves(experiment, is_quick):
    builds = {f"{r}^3" for r in figures.RESOLUTIONS} | {f"level {n:2}" for n in range(13)}
    check_names(experiment, builds if experiment.name == "octree-table1" else set())
    check_plans(experiment, DATA, is_quick)


def test_a_flight_has_each_pass_in_a_stage_and_keeps_its_cache(data):
    traced = figures.paths(1)
    ways = (figures.octree("octree"), figures.octree("raw", filter="none", jitter=0.0, caching_resolution=0.5))
    plan = replace(figures.FLIGHT, configurations=(*coarse(*ways), traced), size=(48, 32), truth=Truth(16, (2,)))
    rows, arrays = done(replace(plan, frames=(0, 3), skip=1, pictures=(2,)), data)
    assert rows.keys() == {(name, n) for name in ("octree", "raw", traced.name) for n in range(3)}
    for (name, number), row in rows.items():
        assert "stage.other" not in row
        is_octree = name != traced.name
        assert (row["stage.caching"] > 0, row["stage.reconstruction"] > 0) == (is_octree, is_octree)
        assert ("relmse" in row) == (number == 2)
    caching, rest = (rows["octree", 2][f"stage.{stage}"] for stage in ("caching", "reconstruction"))
    assert caching + rest + rows["octree", 2]["stage.both"] == pytest.approx(rows["octree", 2]["device"])
    assert rows["octree", 2]["cache.occupied"] > rows["octree", 0]["cache.occupied"] > 0
    assert rows["octree", 2]["relmse"] < rows[traced.name, 2]["relmse"]
    assert "picture/octree/2/mono" in arrays


def test_what_is_read_from_a_full_cache_by_part(data):
    plan = figures.FIG16.plans[0]
    rows, _ = done(
        replace(plan, configurations=coarse(*figures.readings(2)), size=(48, 32), frames=(0, 4), truth=Truth(16, (3,)), pictures=()),
        data,
    )  # fmt: skip
    assert list(rows) == [(name, 3) for name in ("layered", "plain", "none")]
    for row in rows.values():
        share = row["share"]
        assert 0.01 < share < 0.3  # the ball
        assert share * row["relmse.view"] + (1 - share) * row["relmse.rest"] == pytest.approx(row["relmse"])
        assert row["stage.caching"] == 0 < row["stage.reconstruction"]
        assert row["cache.hits"] > 0 and "stage.other" not in row
    assert len({row["relmse.view"] for row in rows.values()}) == 3


def test_updates_reach_fewer_cells_by_fewer_paths(data):
    ways = coarse(*figures.stored(1, 1, (0.5, 1.0), 2048), *figures.stored(3, 2, (1.0,), 2048))
    plan = replace(figures.FIG17_PLAN, configurations=ways, size=(48, 32), frames=(0, 2), skip=1)
    rows, _ = done(plan, data)
    half, one, more = (rows[c.name, 1] for c in ways)
    assert half["cache.inserted"] == pytest.approx(one["cache.inserted"] / 4, rel=0.05)
    assert 0 < half["updated"] < one["updated"] < more["updated"]
    # One update of an empty cache, not all that the sequence has cached.
    assert one["updated"] == rows[ways[1].name, 0]["cache.occupied"] < one["cache.occupied"]


def test_builds_have_a_row_for_each_level_and_their_own_memory(data):
    entry = scene_entry(data / "small" / "scene.toml")
    found = perform(Job("octree_build", {"scene": entry, "resolution": 64, "levels": True}), {}, Machine())
    build, *levels = found.rows
    assert [row["level"] for row in levels] == list(range(7))
    for row in levels:
        assert row["density"] == pytest.approx(row["level_cells"] / row["edge"] ** 3)
    assert build["cells"] == sum(row["level_cells"] for row in levels)
    assert build["cell_bytes"] == 24 and build["cell_hash_bytes"] >= 8.8
    assert build["peak_bytes"] >= build["before_bytes"] > 2**20
    ratios = [b["level_data_bytes"] / a["level_data_bytes"] for a, b in zip(levels[-4:], levels[-3:], strict=False)]
    assert build["growth"] == pytest.approx(np.prod(ratios) ** (1 / 3))
    assert build["thinning"] == pytest.approx(build["growth"] / 8)
    columns = {column.of for table in figures.TABLE1.tables for column in table.columns}
    assert columns <= build.keys() | levels[0].keys()


def test_a_build_that_fails_says_so_in_one_line(data):
    entry = scene_entry(data / "small" / "scene.toml") | {"digest": "another"}
    job = Job("octree_build", {"scene": entry, "resolution": 64, "levels": False})
    with pytest.raises(Error, match=r"octree.resolution 64: Error: .*is not the scene that the job was made for"):
        perform(job, {}, Machine())


def test_parts_without_pixels_have_no_error():
    color, reference = np.full((30, 30, 3), 0.5), np.full((30, 30, 3), 0.25)
    found = by_part(color, [reference], np.zeros((30, 30), bool))
    assert found["share"] == 0 and "relmse.view" not in found
    assert found["relmse.rest"] == pytest.approx(0.25**2 / (0.25**2 + 0.01))


def test_what_follows_the_view(data):
    scene = clcache.load_scene(data / "small" / "scene.toml")
    for changes, expected in (
        ({}, False),
        ({"specular": 1.0, "roughness": 0.2}, True),
        ({"specular": 1.0, "roughness": 0.8}, False),
        ({"metallic": 1.0}, True),
        ({"transmission": 1.0}, True),
    ):
        assert shines(scene, Material("m", **changes)) == expected
