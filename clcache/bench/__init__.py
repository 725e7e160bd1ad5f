"""Micro-benchmarks of the kernels: how fast rays, trees, sorts, passes and plain memory are on a device (`clcache bench`).

PoCL fixes its number of threads once in a process, so that every device and number of threads is measured in a process of its
own (`run.py`), which does what a `Job` says and hands back a `Result` for each thing that it measured.
"""

from .job import Job
from .report import Run, report
from .result import Result
from .run import FAMILIES, check_families, measure, targets

__all__ = ["FAMILIES", "Job", "Result", "Run", "check_families", "measure", "report", "targets"]
