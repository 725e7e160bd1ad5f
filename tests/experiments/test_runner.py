"""Jobs on Dask: what is needed is done first, what is done is not done again, and a lost worker changes nothing."""

import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest

from clcache import Error, SettingError
from clcache.experiments import job as jobs
from clcache.experiments import runner
from clcache.experiments.job import Job, Machine, Result, Store, perform
from clcache.experiments.runner import cluster, run_jobs

distributed = pytest.importorskip("distributed")

CORNELL = Path(__file__).parents[2] / "data" / "cornell" / "scene.toml"


@pytest.fixture(scope="module")
def client():
    """A cluster in this process, whose workers see what tests put in place of jobs."""
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as local,
        distributed.Client(local) as client,
    ):
        yield client


@pytest.fixture
def done(monkeypatch):
    """The numbers of the jobs that were done, in order; what a job does: its number and the sum of what it needs."""
    numbers: list[int] = []
    lock = threading.Lock()

    def work(parameters, needed, machine):
        with lock:
            numbers.append(parameters["number"])
            tries = numbers.count(parameters["number"])
        if parameters.get("fails", 0) >= tries:
            raise RuntimeError("bad luck")
        if "wrong" in parameters:
            raise SettingError(parameters["wrong"])
        total = parameters["number"] + sum(result.rows[0]["total"] for result in needed.values())
        return Result([{"total": total}], {"total": np.array([total])})

    monkeypatch.setattr(jobs, "function_of", lambda kind: work)
    return numbers


def job(number: int, *needs: Job, **more: object) -> Job:
    return Job("reference", {"number": number, **more}, {str(n): of for n, of in enumerate(needs)})


def test_what_is_needed_comes_first_and_is_done_once(client, done, tmp_path):
    first = job(1)
    second, third = job(10, first), job(100, first)
    store, seen = Store(tmp_path), []
    results = run_jobs([third, second], store, client, Machine(), lambda *counts: seen.append(counts))
    assert [r.rows[0]["total"] for r in results] == [101, 11]
    assert [int(r.arrays["total"][0]) for r in results] == [101, 11]
    assert sorted(done) == [1, 10, 100] and done[0] == 1
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_what_the_store_has_is_not_done_again(client, done, tmp_path):
    first = job(1)
    store = Store(tmp_path)
    run_jobs([job(10, first)], store, client, Machine())
    done.clear()
    results = run_jobs([job(10, first), job(100, first)], store, client, Machine())
    assert done == [100] and [r.rows[0]["total"] for r in results] == [11, 101]


def test_what_a_done_job_needed_is_not_asked_for(client, done, tmp_path):
    store, first = Store(tmp_path), job(1)
    run_jobs([job(10, first)], store, client, Machine())
    for file in tmp_path.glob(f"{first.key}.*"):
        file.unlink()
    done.clear()
    assert run_jobs([job(10, first)], store, client, Machine())[0].rows == [{"total": 11}]
    assert done == []


def test_bad_luck_is_tried_again_and_not_for_ever(client, done, tmp_path):
    assert run_jobs([job(1, fails=2)], Store(tmp_path), client, Machine())[0].rows == [{"total": 1}]
    assert done == [1, 1, 1]
    done.clear()
    with pytest.raises(RuntimeError, match="bad luck"):
        run_jobs([job(2, fails=9)], Store(tmp_path), client, Machine())
    assert done == [2, 2, 2]


def test_what_a_user_gave_wrong_is_not_tried_again_and_what_was_done_stays(client, done, tmp_path):
    store, first = Store(tmp_path), job(1)
    with pytest.raises(SettingError, match="setting x: expected y"):
        run_jobs([first, job(2, first, wrong="setting x: expected y")], store, client, Machine())
    assert done == [1, 2] and first in store


def test_a_job_that_ends_its_workers_is_an_error_or_what_is_kept_instead(client, done, tmp_path, monkeypatch):
    lost = job(1)
    later = job(2, lost)

    class Ended:
        def __init__(self, key):
            self.key = key

        def result(self):
            raise distributed.KilledWorker(lost.key, None, 3)

    keep = lambda reason: Result([{"failed": reason}])  # noqa: E731
    reason = "its workers ended, one after the other; is there enough memory?"
    assert runner._result_of(Ended(lost.key), keep).rows == [{"failed": reason}]
    for key, on_lost in ((lost.key, None), (later.key, None), (later.key, keep)):
        with pytest.raises(Error, match=f"job {lost.key}: its workers ended"):
            runner._result_of(Ended(key), on_lost)


def test_a_worker_of_another_version_is_refused(client, done, tmp_path, monkeypatch):
    monkeypatch.setattr("clcache.experiments.runner._same", None)
    from clcache.experiments.runner import _work

    found = _work(job(1), {}, Machine(), "0.0.0")
    assert isinstance(found, Error) and "expected 0.0.0" in str(found) and done == []


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", "tcp://:::1"])
def test_a_scheduler_that_is_not_there_is_one_line(address, monkeypatch):
    monkeypatch.setattr("clcache.experiments.runner.CONNECT", "0.2s")
    expected = pytest.raises(SettingError, match=f"--scheduler {address}: cannot be reached .* such as tcp://")
    with expected as caught, cluster(address):
        pass
    assert "\n" not in str(caught.value)


def test_a_lost_worker_changes_nothing(tmp_path):
    """Two workers in processes of their own, one of which is killed as soon as anything is done."""
    scene = jobs.scene_entry(CORNELL)
    told = {"scene": scene, "size": [24, 16], "stereo": False, "slower": 1, "still": None, "spp": 1}
    asked = [Job("reference", told | {"frame": 0, "seed": seed}) for seed in range(6)]
    machine, killed = Machine(), []
    with cluster(None, workers=2) as client:
        # Ctrl-C, which a terminal sends to them too, is not theirs to answer.
        hears = client.run(eval, "repr(__import__('signal').getsignal(2))")
        assert all("lambda" in one for one in hears.values())

        def kill_one(done: int, total: int) -> None:
            if done and not killed:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        found = run_jobs(asked, Store(tmp_path), client, machine, kill_one)
    assert killed
    for one, result in zip(asked, found, strict=True):
        here = perform(one, {}, machine)
        assert result.arrays["mono"].tobytes() == here.arrays["mono"].tobytes()
