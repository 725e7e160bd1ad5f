"""Jobs on Dask: on a local cluster, or on that of a scheduler which somebody has started.

What is in the store is not done again, so that a run that was broken off goes on where it was. A job waits for what it needs; a worker
does one at a time; a job that was on a worker which was lost, or whose worker fails, is tried elsewhere. Results come back to
the one process that writes the store, so that workers need no folder in common with it; they do need the scenes' files, at the same
places. What is found does not depend on who found it: but times do, and workers on one machine take each other's.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from ..errors import DeviceError, Error, SceneError, SettingError
from ..version import __version__
from .job import Job, Machine, Result, Store, perform, with_needs

if TYPE_CHECKING:
    from distributed import Client, Future

RETRIES = 2  # of a job that fails by itself, and not by what it was told
CONNECT = "10s"  # at most, until a scheduler answers
# Run by workers on this machine: Ctrl-C, which a terminal sends to all processes, is this one's to answer, which then ends them. It
# is not ignored, as what workers start would then ignore it, too.
_DEAF = "import signal; signal.signal(signal.SIGINT, lambda *_: None)"
_AT_WORK = threading.Lock()  # of a worker: jobs that are timed have it for themselves


def run_jobs(
    jobs: Sequence[Job],
    store: Store,
    client: "Client",
    machine: Machine,
    on_done: Callable[[int, int], None] | None = None,
    on_lost: Callable[[str], Result] | None = None,
) -> list[Result]:
    """Do those of the jobs that the store has not, and what they need; their results, in their order.

    on_done: called with the number of jobs done and of all, at first and after each. on_lost: called with the reason where a job has ended one worker
    after the other, as one without memory for it does; what is kept in its place. Raises what the first job to fail raises, after which
    the store has what was done until then.
    """
    from distributed import Future, as_completed

    asked = with_needs(jobs)
    by_key = {job.key: job for job in asked}
    missing = with_needs(jobs, store)
    done = len(asked) - len(missing)
    if on_done:
        on_done(done, len(asked))
    futures: dict[str, Future] = {}
    for job in missing:
        for needed in job.needs.values():
            if needed.key not in futures:  # and so in the store: it is sent once, and again where a worker is lost
                futures[needed.key] = client.submit(_same, store.read(needed), key=f"kept-{needed.key}", pure=False)
        needs = {name: futures[needed.key] for name, needed in job.needs.items()}
        futures[job.key] = client.submit(
            _work, job, needs, machine, __version__, key=job.key, retries=RETRIES, pure=False
        )
    waiting = as_completed([futures[job.key] for job in missing])
    futures.clear()  # so that workers may forget what is written and nobody needs any more
    try:
        for future in waiting:
            store.write(by_key[future.key], _result_of(future, on_lost))
            done += 1
            if on_done:
                on_done(done, len(asked))
            future.release()
    except BaseException:
        client.cancel(list(waiting.futures))  # what no other client of the scheduler has asked for as well
        raise
    return [store.read(job) for job in jobs]


def _same(result: Result) -> Result:
    """A task: what the store has."""
    return result


def _work(job: Job, needed: Mapping[str, Result], machine: Machine, version: str) -> Result | Error:
    """A task: what the job finds. What the user can mend is returned and not raised, as trying again would not help."""
    if version != __version__:
        return Error(f"a worker has clcache {__version__}; expected {version}, as where the jobs are from")
    with _AT_WORK:
        try:
            return perform(job, needed, machine)
        except (SceneError, SettingError, DeviceError) as error:
            return type(error)(str(error))


def _result_of(future: "Future", on_lost: Callable[[str], Result] | None) -> Result:
    from distributed import CancelledError, KilledWorker

    try:
        found = future.result()
    except KilledWorker as error:
        reason = "its workers ended, one after the other; is there enough memory?"
        if on_lost and error.task == future.key:  # and not what it needs
            return on_lost(reason)
        raise Error(f"job {error.task}: {reason}") from error
    except CancelledError as error:
        raise Error(f"job {future.key}: was cancelled; is the scheduler there?") from error
    if isinstance(found, Error):
        raise found
    return found


@contextlib.contextmanager
def cluster(scheduler: str | None, workers: int = 1) -> Iterator["Client"]:
    """A client of a scheduler, or of a local cluster with so many workers, which ends with the `with`. Raises SettingError."""
    try:
        import distributed
    except ImportError:
        raise SettingError(
            "experiments need the package distributed; expected pip install 'clcache-renderer[experiments]'"
        ) from None
    if scheduler:
        with _client(distributed, scheduler) as client:
            yield client
        return
    with (
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",
            silence_logs=40,
            preload=[_DEAF],
        ) as local,
        distributed.Client(local) as client,
    ):
        yield client


def _client(distributed, scheduler: str) -> "Client":
    try:
        return distributed.Client(scheduler, timeout=CONNECT)
    except (OSError, ValueError) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise SettingError(
            f"--scheduler {scheduler}: cannot be reached ({reason}); expected the address of a Dask scheduler, such as"
            " tcp://192.0.2.1:8786"
        ) from None
