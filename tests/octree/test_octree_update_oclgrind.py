"""The kernels that update cells under Oclgrind (tools/race_check.py): no data race, nothing out of bounds, nothing uninitialised."""

import importlib.util
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
specification = importlib.util.spec_from_file_location("race_check", HERE.parents[1] / "tools" / "race_check.py")
race_check = importlib.util.module_from_spec(specification)
specification.loader.exec_module(race_check)


def update() -> None:
    """Two updates by vertices of three chunks, between which lighting changes: the same cells as in NumPy."""
    from octree_model import DeviceCells, HandOctree, Model
    from test_octree_update import assert_same, some_vertices

    from clcache.device import Device

    rng = np.random.default_rng(5)
    octree = HandOctree(Device("oclgrind", local_size=8), np.unique(rng.integers(0, 512, 90, dtype=np.uint64)), 3)
    cells, model = DeviceCells(octree, 1100), Model(octree)
    for stamp in (1, 2):
        cells.wipe(stamp)
        model.cells.wipe, model.cells.occupied = stamp, 0
        vertices = some_vertices(rng, octree, 1100)
        assert cells.update(vertices, stamp) == model.update(vertices, stamp)
        assert_same(cells.cells, model.cells)


@pytest.mark.skipif(shutil.which("oclgrind") is None, reason="the command oclgrind is not installed")
def test_kernels_of_updates_have_no_defects(monkeypatch):
    monkeypatch.setattr(race_check, "__file__", __file__)
    assert race_check.run("update") == []


if __name__ == "__main__":
    sys.path += [str(HERE), str(HERE.parent)]
    race_check.suit_oclgrind()
    update()
    print("update is done")
