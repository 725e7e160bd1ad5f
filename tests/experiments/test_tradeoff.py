"""Trade-offs: which configurations are tried, what is found of each, and what is best of them."""

import inspect
import itertools
import math
import shlex
import statistics
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache import DeviceError, Error, Renderer, SceneError, SettingError, cli
from clcache.cli import Parser
from clcache.experiments import tradeoff
from clcache.experiments.job import Machine
from clcache.experiments.tradeoff import CHANGE, DEFAULT, METHODS, SPREAD, Goal, advise, identity, pareto_front
from clcache.settings import SETTINGS, resolve

NUMBERS = st.sampled_from([0.0, 1.0, 2.0, 3.0, -1.0, math.inf, math.nan])
POINTS = st.lists(st.tuples(NUMBERS, NUMBERS), max_size=12)
SPACES = tradeoff.spaces(METHODS, {}, True, True)


def columns(points):
    return np.array(points, float).reshape(-1, 2).T


# ---------------------------------------------------------------------------------------------------------------------
# What is best


@given(POINTS)
def test_the_front_is_what_no_other_is_better_than(points):
    finite = [p for p in points if all(map(math.isfinite, p))]
    expected = [
        p in finite and not any(q[0] <= p[0] and q[1] <= p[1] and q != p for q in finite)  # as good, and better in one
        for p in points
    ]
    assert pareto_front(*columns(points)).tolist() == expected


@given(POINTS, st.sampled_from([None, 0.5, 1.0, 2.5]), st.sampled_from([None, 0.0, 1.5]))
def test_what_is_recommended_meets_the_goal_or_comes_nearest(points, seconds, error):
    time, errors = columns(points)
    found = advise(Goal(seconds, "relmse", error), time, errors)
    known = [i for i, p in enumerate(points) if all(map(math.isfinite, p))]
    in_time = [i for i in known if seconds is None or points[i][0] <= seconds]
    good = [i for i in known if error is None or points[i][1] <= error]
    both = [i for i in in_time if i in good]

    def least(rows, first):
        return min((points[i][first], points[i][1 - first]) for i in rows)

    def value(row, first):
        return points[row][first], points[row][1 - first]

    if not known:
        assert [(a.row, a.is_met) for a in found] == [(None, False)]
    elif both:
        (only,) = found
        first = 0 if seconds is None and error is not None else 1
        assert only.is_met and only.row in both and value(only.row, first) == least(both, first)
    else:
        assert not any(a.is_met for a in found)
        wanted = []
        if seconds is not None:
            wanted.append((1, least(in_time, 1)) if in_time else (0, least(known, 0)))
        if error is not None:
            wanted.append((0, least(good, 0)) if good else (1, least(known, 1)))
        got = [a.row for a in found]
        assert all(any(value(row, first) == of for row in got) for first, of in wanted) and len(got) <= len(wanted)


# ---------------------------------------------------------------------------------------------------------------------
# The space


@pytest.mark.parametrize("setting", [s for s in SETTINGS.values() if s.trade], ids=lambda s: s.name)
def test_values_to_try_are_legal_and_the_default_is_one(setting):
    assert setting.default in setting.trade and len(set(setting.trade)) == len(setting.trade) > 1
    for value in setting.trade:
        assert setting.parse(value) == value and type(value) is type(setting.default)


def test_every_setting_to_try_is_tried_by_some_method_and_every_method_has_its_own():
    chosen = {of.method: {c.name for c in of.choices} for of in SPACES}
    assert set().union(*chosen.values()) - {"spp", "temporal", "stereo_blend", "memo"} == {
        s.name for s in SETTINGS.values() if s.trade
    }
    assert "samplecache.slots" in chosen["samplecache"] and "samplecache.slots" not in chosen["isrt"]
    assert all(not name.startswith("octree.") for name in chosen["voxelhash"])
    plain = {c.name for of in tradeoff.spaces(METHODS, {}, False, False) for c in of.choices}
    assert not any(name.startswith(("memo.", "stereo.")) for name in plain)  # no graphs, one eye


def test_trials_are_distinct_and_always_the_same_and_more_of_them_begin_with_the_same():
    tried = tradeoff.trials(SPACES, 3, 300)
    names = [identity(t.configuration) for t in tried]
    assert len(set(names)) == len(names) == 300
    assert names == [identity(t.configuration) for t in tradeoff.trials(SPACES, 3, 320)][:300]
    origins = [t.origin for t in tried]
    assert origins == sorted(origins, key=[DEFAULT, CHANGE, SPREAD].index) and set(origins) == {DEFAULT, CHANGE, SPREAD}
    assert [t.space.method for t in tried[: len(METHODS)]] == list(METHODS)
    other = [identity(t.configuration) for t in tradeoff.trials(SPACES, 4, 300)]
    fixed = origins.index(SPREAD)
    assert other[:fixed] == names[:fixed] and other[fixed:] != names[fixed:]


def test_a_change_has_an_effect_and_what_it_is_compared_with_is_tried():
    tried = tradeoff.trials(SPACES, 0, 300)
    names = {identity(t.configuration) for t in tried}
    changes = [t for t in tried if t.origin == CHANGE]
    assert {t.changed for t in changes} >= {s.name for s in SETTINGS.values() if s.trade}
    for trial in changes:
        own, base = trial.configuration, trial.base
        assert identity(base) in names and identity(own) != identity(base)
        differ = {n for n in own.settings | base.settings if own.settings.get(n) != base.settings.get(n)}
        options = {n for n in ("spp", "temporal", "stereo_blend", "memo") if getattr(own, n) != getattr(base, n)}
        assert trial.changed in differ | options


@pytest.mark.parametrize("methods", [METHODS, ("samplecache", "octree")])
def test_all_that_can_be_changed_is_changed_by_itself_and_there_is_room_for_more(methods):
    found = tradeoff.spaces(methods, {}, True, True)
    tried = tradeoff.trials(found, 0, cli.tradeoff.CONFIGURATIONS)
    changed = {t.changed for t in tried if t.origin == CHANGE}
    assert changed == {c.name for of in found for c in of.choices if len(c.values) > 1}
    assert sum(t.origin == SPREAD for t in tried) > 20


@given(st.data())
def test_what_has_no_effect_does_not_make_another_configuration(data):
    of = data.draw(st.sampled_from(SPACES))
    indices = [data.draw(st.integers(0, len(c.values) - 1)) for c in of.choices]
    point = of.at(indices)
    assert of.indices(point) == indices
    settings = of.configuration(point).settings
    for prefix, is_used in (
        ("taa.", point["temporal"] == "taa"),
        ("taa.gamma", point["temporal"] == "taa" and point["taa.validation"] == "clip"),
        ("temporal.", point["temporal"] != "none"),
        ("varianceblend.", "varianceblend" in (point["temporal"], point["stereo_blend"])),
        ("stereo.", point["stereo_blend"] == "constant"),
        ("memo.", point["memo"] != "off"),
        ("memo.tile", point["memo"] == "tile"),
    ):
        assert is_used or not any(name.startswith(prefix) for name in settings)
    assert settings.get("memo.auto") is (None if point["memo"] == "off" else False)  # by times, it would not repeat
    for choice in of.choices:
        if choice.name in settings:
            assert settings[choice.name] == point[choice.name] != choice.default


def test_what_the_scene_sets_is_the_default():
    (of,) = tradeoff.spaces(["samplecache"], {"samplecache.slots": 9, "samplecache.target": 2.0}, False, False)
    slots = next(c for c in of.choices if c.name == "samplecache.slots")
    assert slots.default == 9 and slots.values == (6, 12, 24, 9)
    assert of.configuration(of.default).settings == {}
    assert of.configuration(of.default | {"samplecache.target": 4.0}).settings == {"samplecache.target": 4.0}
    with pytest.raises(SettingError, match="unknown"):
        tradeoff.spaces(["raytrace"], {}, False, False)


def test_the_command_that_is_printed_renders_what_is_measured(monkeypatch):
    """Read by clcache's own parser, it asks for the same renderer, of a scene that has settings of its own."""
    own = {"samplecache.target": 3.5, "voxelhash.jitter": False, "pathtrace.bounces": 6}
    scene = SimpleNamespace(defaults=SimpleNamespace(settings=own))
    asked = []

    def note(*told, **named):
        values = inspect.signature(Renderer).bind(*told, **named)
        values.apply_defaults()
        settings = resolve(own, values.arguments["settings"])
        names = ("method", "size", "stereo", "seed", "spp", "temporal", "stereo_blend", "memo", "device", "threads")
        left_out = {"stereo_blend": "none", "memo": "off"}  # which no scene says
        asked.append(
            {n: left_out.get(n) if values.arguments[n] is None else values.arguments[n] for n in names} | settings
        )

    monkeypatch.setattr("clcache.renderer.Renderer", note)
    monkeypatch.setattr("clcache.experiments.configuration.Renderer", note)
    parser = Parser(prog="clcache")
    subparsers = parser.add_subparsers(dest="command", required=True)
    for command in (cli.render, cli.tradeoff):
        command.add_parser(subparsers)
    options = ["--size", "32x18", "--seed", "7", "--device", "my device", "--threads", "2"]
    args = parser.parse_args(["tradeoff", "my scene.toml", *options])
    tried = tradeoff.trials(tradeoff.spaces(METHODS, own, True, True), 2, 400)
    for trial in tried:
        configuration = trial.configuration
        words = shlex.split(f"{cli.tradeoff._command(args)} {configuration.options()}")
        read = parser.parse_args(words[1:])
        assert words[:2] == ["clcache", "render"] and read.scene == "my scene.toml"
        cli.render._renderer(read, scene, SimpleNamespace(compiling=None))
        configuration.renderer(scene, args.size, args.stereo, args.seed, args.device, args.threads)
        printed, measured = asked[-2:]
        assert printed == measured
        assert all(printed[name] == value for name, value in configuration.settings.items())
    assert len(asked) == 2 * len(tried) == 800


# ---------------------------------------------------------------------------------------------------------------------
# What is found


def frame(seconds, **more):
    return {"counted": True, "seconds": seconds, "memory.total": 100, "memory.cache": 10, **more}


def test_a_row_is_of_the_frames_that_count():
    own = [
        frame(2.0, relmse=0.2, relmse_error=0.02, difference=1.0, stereo=3.0, stereo_reference=2.0),
        frame(9.0, difference=2.0, stereo=4.0),
        frame(3.0, relmse=0.4, relmse_error=0.04, difference=6.0, stereo=5.0, stereo_reference=4.0),
    ]
    row = tradeoff.summary(own, [frame(1.0), frame(4.5), frame(2.0)])
    assert (row["seconds"], row["relative"], row["yardstick"]) == (3.0, 2.0, 2.0)
    assert row["relmse"] == pytest.approx(0.3) and row["relmse_error"] == pytest.approx(0.03)
    assert row["flicker"] == 3.0 and row["flicker_error"] == pytest.approx(statistics.stdev([1, 2, 6]) / math.sqrt(3))
    assert row["stereo"] == 4.0 and row["stereo_reference"] == 3.0
    assert (row["memory"], row["cache"]) == (100, 10) and "flip" not in row


def test_what_cannot_be_rendered_is_a_row_but_a_wrong_scene_or_device_is_an_error(monkeypatch):
    parameters = {"scene": {"file": "none"}, "configuration": {"name": "own", "method": "pathtrace"}}
    with pytest.raises(SceneError):
        tradeoff.run(parameters, {}, Machine())
    monkeypatch.setattr(tradeoff, "open_scene", lambda entry: None)
    with pytest.raises(SettingError, match="--threads"):
        tradeoff.run(parameters, {}, Machine(threads=2**16))
    monkeypatch.setattr(Machine, "open", lambda machine: None)
    for error in (DeviceError("needs 9 GiB"), SettingError("does not fit"), Error("pixels that are not finite")):

        def fail(*_, error=error):
            raise error

        monkeypatch.setattr(tradeoff.sequence, "run", fail)
        assert tradeoff.run(parameters, {}, Machine()).rows == [{"failed": str(error)}]


def test_sensitivities_are_factors_over_what_is_without_the_change():
    tried = tradeoff.trials(tradeoff.spaces(["pathtrace"], {}, False, False), 0, 100)
    rows = {identity(t.configuration): {"relative": 2.0, "relmse": 0.5, "memory": 8} for t in tried}
    spp = next(t for t in tried if t.changed == "spp" and t.point["spp"] == 4)
    gamma = next(t for t in tried if t.changed == "taa.gamma" and t.point["taa.gamma"] == 2.0)
    rows[identity(spp.base)] |= {"seconds": 1.0, "seconds_error": 0.03, "relmse_error": 0.05}
    rows[identity(spp.configuration)] |= {"relative": 8.0, "seconds": 2.0, "seconds_error": 0.08, "relmse": 0.125}
    rows[identity(gamma.base)] |= {"relative": 1.0, "relmse": -0.1}
    found = {(row["changed"], row["value"]): row for row in tradeoff.sensitivities(tried, rows)}
    assert found["spp", 4] == {
        "method": "pathtrace", "changed": "spp", "value": 4, "default": 1,
        "time": 4.0, "relmse": 0.25, "flip": None, "flicker": None, "stereo": None, "memory": 1.0,
        "time_error": pytest.approx(4 * 0.05), "relmse_error": None,
        "flip_error": None, "flicker_error": None, "stereo_error": None,
    }  # fmt: skip
    assert found["taa.gamma", 2.0]["time"] == 2.0 and found["taa.gamma", 2.0]["relmse"] is None


def test_a_search_that_is_told_the_same_asks_the_same_and_gets_better():
    pytest.importorskip("optuna")
    spaces = tradeoff.spaces(["pathtrace", "samplecache"], {}, True, False)
    tried = tradeoff.trials(spaces, 0, 100)

    def row(trial):  # each value makes time and error larger or smaller, whatever the others are
        configuration = trial.configuration
        if configuration.temporal == "taa":
            return {"failed": "it does"}
        told = [
            configuration.method,
            f"spp={configuration.spp}",
            configuration.stereo_blend,
            *configuration.settings.items(),
        ]
        random = [np.random.default_rng(list(str(word).encode())).normal(size=2) for word in told]
        return dict(zip(("relative", "relmse"), np.exp(0.2 * np.sum(random, axis=0)), strict=True))

    def search():
        rows = {identity(t.configuration): row(t) for t in tried}
        batches = []
        for batch in tradeoff.refine(spaces, tried, rows, 5, 20):
            rows |= {identity(t.configuration): row(t) for t in batch}
            batches.append([identity(t.configuration) for t in batch])
        return batches, rows

    batches, rows = search()
    assert batches == search()[0]
    assert [len(b) for b in batches] == [tradeoff.REFINE_BATCH, tradeoff.REFINE_BATCH, 20 - 2 * tradeoff.REFINE_BATCH]
    names = list(itertools.chain(*batches))
    assert len(set(names) - {identity(t.configuration) for t in tried}) == 20

    def mean(of):
        return statistics.fmean(rows[n]["relative"] * rows[n]["relmse"] for n in of if "relative" in rows[n])

    assert mean(names) < 0.8 * mean(identity(t.configuration) for t in tried)
