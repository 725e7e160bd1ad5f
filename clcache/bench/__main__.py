"""The process of a job (`run.py`): python -m clcache.bench JOB, as JSON."""

import sys

from .run import work

if __name__ == "__main__":
    work(sys.argv[1])
