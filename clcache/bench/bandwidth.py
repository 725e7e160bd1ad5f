"""The machine's memory bandwidth, by which everything else is judged (`cl/bench/bandwidth.cl`)."""

from collections.abc import Iterator

import numpy as np

from ..device import Device
from .job import Job
from .launches import timed
from .result import Result

FAMILY = "bandwidth"
ARRAY_BYTES = 2**28  # several times the largest caches
_VECTOR = 16  # floats
_RUN = 64  # vectors that a work-item of `read` takes


def bandwidth(job: Job) -> Iterator[Result]:
    """Copy and read arrays; a copy moves each byte twice."""
    device = Device(job.device, job.threads)
    program = device.program("bench/bandwidth.cl")
    runs = ARRAY_BYTES // (4 * _VECTOR * _RUN)
    n = runs * _RUN
    # Written once: memory that nothing was written to is not there yet.
    values, copied = (device.upload(np.ones((n, _VECTOR), np.float32), "an array to copy") for _ in range(2))
    sums = device.empty(runs, np.float32, "sums")
    seconds = timed(lambda: program["copy"](values, copied, n, count=n), job.repeats)
    yield Result(FAMILY, "copy", "", 2 * values.nbytes, "bytes", seconds, 2 * values.nbytes)
    seconds = timed(lambda: program["read"](values, sums, n, runs, count=runs), job.repeats)
    yield Result(FAMILY, "read", "", values.nbytes, "bytes", seconds, values.nbytes + sums.nbytes)
