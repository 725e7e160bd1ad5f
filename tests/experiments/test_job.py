"""Jobs' keys, and the store that keeps their results."""

import json
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache import Error, SettingError
from clcache.experiments.job import KINDS, Job, Machine, Result, Store, function_of, open_scene, perform, scene_entry

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)
PARAMETERS = st.dictionaries(st.text(), PLAIN, max_size=4)


@given(PARAMETERS, PARAMETERS)
def test_jobs_have_one_key_if_and_only_if_they_say_the_same(a, b):
    turned = dict(reversed(list(a.items())))
    assert Job("reference", a).key == Job("reference", turned).key
    same = json.dumps(a, sort_keys=True) == json.dumps(b, sort_keys=True)
    assert (Job("reference", a).key == Job("reference", b).key) == same


def test_a_key_depends_on_the_kind_and_on_what_is_needed_and_by_which_name():
    needed, other = Job("reference", {"seed": 1}), Job("reference", {"seed": 2})
    keys = [
        Job("sequence", {}).key,
        Job("reference", {}).key,
        *(Job("sequence", {}, needs).key for needs in ({"a": needed}, {"b": needed}, {"a": other})),
    ]
    assert len(set(keys)) == len(keys)


def test_a_key_has_no_room_for_what_json_cannot_say():
    with pytest.raises(ValueError, match="JSON"):
        _ = Job("reference", {"x": float("nan")}).key


def test_a_store_gives_back_what_was_written(tmp_path):
    job = Job("reference", {"seed": 1})
    rows = [{"a": 1, "b": 0.1, "c": "word", "d": True, "e": None}]
    arrays = {"mono": np.float32([[1e30, -0.0], [np.inf, 1]]), "half/left": np.float16([1, 2])}
    store = Store(tmp_path / "results")
    assert job not in store
    store.write(job, Result(rows, arrays, {"seconds": 2.0}))
    assert job in store and Job("reference", {"seed": 2}) not in store
    found = Store(tmp_path / "results").read(job)
    assert found.rows == rows and found.about == {"seconds": 2.0}
    assert found.arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        assert found.arrays[name].dtype == array.dtype and found.arrays[name].tobytes() == array.tobytes()
    assert sorted(file.suffix for file in (tmp_path / "results").iterdir()) == [".json", ".npz"]


@pytest.mark.parametrize("ending", ["json", "npz"])
def test_what_is_broken_in_a_store_is_named(tmp_path, ending):
    job, store = Job("reference", {"seed": 1}), Store(tmp_path)
    store.write(job, Result([], {"a": np.zeros(100)}))
    file = tmp_path / f"{job.key}.{ending}"
    file.write_bytes(file.read_bytes()[:40])
    with pytest.raises(SettingError, match=f"{job.key}.json: cannot be read .*; remove it"):
        store.read(job)


def test_rows_that_are_no_numbers_are_refused_and_leave_nothing(tmp_path):
    job, store = Job("reference", {}), Store(tmp_path)
    with pytest.raises(ValueError, match="JSON"):
        store.write(job, Result([{"x": float("inf")}]))
    assert list(tmp_path.iterdir()) == [] and job not in store


def test_every_kind_has_its_function():
    assert all(callable(function_of(kind)) for kind in KINDS)
    with pytest.raises(Error, match="job of kind 'nonsense': unknown; there is reference"):
        perform(Job("nonsense", {}), {}, Machine())


def test_what_is_not_finite_is_kept_as_nothing(tmp_path, monkeypatch):
    found = Result([{"a": float("nan"), "b": float("-inf"), "c": 1.5, "d": "nan"}])
    monkeypatch.setattr("clcache.experiments.job.function_of", lambda kind: lambda *told: found)
    job, store = Job("reference", {}), Store(tmp_path)
    store.write(job, perform(job, {}, Machine()))
    assert store.read(job).rows == [{"a": None, "b": None, "c": 1.5, "d": "nan"}]


def test_a_scene_that_gives_other_settings_is_another_one(tmp_path):
    file, digests = tmp_path / "scene.toml", []
    text = '[meshes.ball]\ngenerator = "sphere"\n[[instances]]\nmesh = "ball"\n'
    settings = '[render.settings]\n"pathtrace.bounces" = '
    for number, own in enumerate(("", "[render]\n", f"{settings}5\n", f"{settings}6\n")):
        file.write_text(text + own)
        os.utime(file, ns=(number, number))
        digests.append(scene_entry(file)["digest"])
    assert digests[0] == digests[1] and len(set(digests)) == 3


def test_a_scene_that_changed_is_noticed(tmp_path):
    file = tmp_path / "scene.toml"
    text = '[meshes.ball]\ngenerator = "sphere"\n[[instances]]\nmesh = "ball"\n'
    file.write_text(text)
    entry = scene_entry(file)
    assert len(open_scene(entry).instances) == 1
    file.write_text(text + "translation = [0, 0, 1]\n")
    with pytest.raises(Error, match=r"scene\.toml: is not the scene that the job was made for"):
        open_scene(entry)
    assert scene_entry(file)["digest"] != entry["digest"]
