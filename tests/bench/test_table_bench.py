"""The benchmark of the voxels' hash table: that what it times is what it says."""

import numpy as np

from clcache.bench import Job
from clcache.bench.table import CAPACITY, LOADS, _keys, _Table, table
from clcache.device import Device


def test_it_has_a_result_for_each_load_and_order():
    results = list(table(Job(("table",), None, None, 2, (16, 8))))
    assert len(results) == len(LOADS) * 5
    assert {len(r.seconds) for r in results} == {2} and {r.items for r in results} == {128}


def test_hits_are_hits_and_misses_are_misses():
    rng = np.random.default_rng(3)
    keys = _keys(rng, CAPACITY // 4, CAPACITY)
    tables = _Table(Device(), keys)
    # At a quarter of full load a run of PROBE full blocks does not occur.
    assert tables.find(keys)[1] == len(keys)
    new = _keys(rng, 4096, CAPACITY)
    assert tables.find(new)[1] == 0
    assert tables.insert(new)[1] == len(new)
    assert tables.find(new)[1] == len(new)
    assert tables.find(keys)[1] == len(keys)
    tables.release()
