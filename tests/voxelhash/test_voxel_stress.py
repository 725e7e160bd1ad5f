"""A tiny table hammered by all threads (tools/voxel_stress.py): nothing lost, nothing twice, nothing of another key's."""

import sys
from pathlib import Path

import pytest

import clcache

sys.path.append(str(Path(clcache.__file__).parents[1] / "tools"))
from voxel_stress import stress  # noqa: E402


@pytest.mark.parametrize(("capacity", "probe"), [(64, 4), (64, 1), (7, 64), (1, 8)])
def test_a_table_hammered_by_all_threads(device, capacity, probe):
    """A million accesses, ten times of which the tool makes."""
    totals = stress(device, 10**6 if capacity == 64 and probe == 4 else 10**5, capacity, probe)
    assert totals.defects == 0, totals
    assert totals.operations >= 10**5 and totals.read > totals.operations // 200
    assert totals.evicted > 5 and totals.discarded > 0
    assert 0.9 * capacity <= totals.inserted - totals.evicted <= capacity
