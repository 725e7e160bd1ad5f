"""The tables and figures of MaterialMemo's chapter 6: that they ask for what there is, and what is measured of images."""

from pathlib import Path

import numpy as np
import pytest
from memo_renders import painted, yard

from clcache.experiments import memo_quality
from clcache.experiments.configuration import Configuration
from clcache.experiments.experiment import Calls, scene_label
from clcache.experiments.job import KINDS, Machine
from clcache.experiments.memo_figures import (
    EXPERIMENTS,
    FIGURE_10,
    FIGURE_13,
    NONE,
    OVERALL,
    QUALITY,
    TABLE_1,
    TABLE_2,
    scarce,
    secondary,
    texel,
)
from clcache.settings import resolve

DATA = Path(__file__).resolve().parents[2] / "data"


def names_in(plan, is_quick):
    """The configurations of a plan, by scene as rows are labelled."""
    if isinstance(plan, Calls):
        (told,) = plan.quick if is_quick else plan.parameters
        names = {entry["name"] for entry in told["configurations"]}
        return {scene_label(scene, plan.graphs): names for scene in plan.scenes}
    quick = plan.quick if is_quick else {}
    names = {c.name for c in quick.get("configurations", plan.configurations)}
    return {scene_label(scene, plan.graphs): names for scene in quick.get("scenes", plan.scenes)}


@pytest.mark.parametrize("is_quick", [False, True])
@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda e: e.name)
def test_claims_and_printed_values_are_of_what_is_measured(experiment, is_quick):
    measured = {}
    for plan in experiment.plans:
        for scene, names in names_in(plan, is_quick).items():
            measured.setdefault(scene, set()).update(names)
    assert {plan.kind if isinstance(plan, Calls) else "sequence" for plan in experiment.plans} <= {*KINDS}
    unmeasured = 0
    for claim in experiment.claims:
        for scene in claim.scenes or measured:
            unmeasured += not {claim.of, claim.over} - {None} <= measured.get(scene, set())
        assert claim.low is not None or claim.high is not None
        if claim.paper is not None:  # what the thesis prints bears out what it says
            assert (claim.low or -np.inf) <= claim.paper <= (claim.high or np.inf), claim
    assert unmeasured < len(experiment.claims) if is_quick else not unmeasured
    if not is_quick:
        for row in experiment.paper:
            assert row["configuration"] in measured[row["scene"]], row
    for column in (column for table in experiment.tables for column in table.columns if column.over):
        assert all(column.over in names for names in measured.values())


def test_names_are_those_of_the_thesis_and_no_two_alike():
    names = [e.name for e in EXPERIMENTS]
    assert len({*names}) == len(names)
    tables, figures = (
        [f"memo-{what}6.{n}" for n in of] for what, of in (("table", (1, 2, 3)), ("fig", (2, *range(10, 20))))
    )
    assert {*tables, *figures} <= {*names}


def test_what_is_shown_twice_is_measured_once(monkeypatch):
    scene = lambda file, graphs: {"file": str(file), "digest": f"{file} {graphs}"}  # noqa: E731
    monkeypatch.setattr("clcache.experiments.experiment.scene_entry", scene)

    def keys(experiment, is_quick=False):
        return [labelled.job.key for labelled in experiment.jobs(DATA, [1, 2], is_quick)]

    eviction = keys(TABLE_2)
    assert eviction == keys(FIGURE_13) and len({*eviction}) == len(eviction) == 12
    assert not {*eviction} & {*keys(TABLE_2, is_quick=True)}
    assert len({*keys(TABLE_1)} & {*keys(FIGURE_10)}) == 2  # the classroom's, of graphs that sample pictures


def test_settings_are_known_and_in_their_ranges():
    asked = {str(sorted(c.settings.items())): c for c in every_configuration()}
    assert len(asked) > 60
    for configuration in asked.values():
        found = resolve(configuration.settings)
        assert (found["memo.auto"] is False) == (configuration.memo != "off" and bool(configuration.settings))
    assert scarce(texel("small", capacity=1000)).settings["memo.capacity"] < 1000


def every_configuration():
    for experiment in EXPERIMENTS:
        for plan in experiment.plans:
            if isinstance(plan, Calls):
                yield from (Configuration.of(entry) for told in plan.parameters for entry in told["configurations"])
            else:
                yield from (*plan.configurations, *plan.quick.get("configurations", ()))


def test_images_are_compared_with_that_of_the_same_random_numbers(device_spec, monkeypatch):
    scene = yard(painted("waves", roughness=1.0))
    monkeypatch.setattr(memo_quality, "open_scene", lambda entry: scene)
    sharp = next(c for c in QUALITY if c.name == "texel, unsnapped")
    told = {
        "scene": {},
        "configurations": [c.entry() | {"spp": 1} for c in (NONE, sharp, secondary(OVERALL[2]))],
        "size": [32, 18],
        "frame": 3,
        "seed": 1,
    }
    found = memo_quality.run(told, {}, Machine(device_spec))
    flip = {row["configuration"]: row["flip"] for row in found.rows}
    again = "none, other random numbers"
    assert [*flip] == ["texel, unsnapped", "tile, nearest*", again]
    assert 0 < flip["tile, nearest*"] < 0.5 * flip[again] and flip["texel, unsnapped"] < 0.5 * flip[again]
    assert {*found.arrays} == {f"picture/{name}/3/mono" for name in (*flip, "reference")}
    assert found.arrays["picture/reference/3/mono"].shape == (18, 32, 3)
