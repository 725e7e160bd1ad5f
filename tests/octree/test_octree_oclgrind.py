"""The kernels that build octrees under Oclgrind (tools/race_check.py): no data race, nothing out of bounds, nothing uninitialised."""

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

pytestmark = pytest.mark.skipif(shutil.which("oclgrind") is None, reason="the command oclgrind is not installed")


def build() -> None:
    """An octree of two instances, one of which has needles and a triangle without area; all its cells are found."""
    from helpers import make_mesh, make_scene, soup
    from octree_on_device import NONE, cell_keys, find_cells

    from clcache.device import Device
    from clcache.octree import Octree
    from clcache.scene.geometry import Geometry

    device = Device("oclgrind", local_size=8)
    corners = np.float32([[0, 0, 0], [1, 1, 1], [1, 1, 1.0001], [0.2, 0.1, 0], [0.2, 0.1, 0], [0.2, 0.1, 0]])
    aside = np.column_stack([0.5 * np.eye(3), [0.4, 0.2, 0.1]])
    scene = make_scene(
        soup(6, seed=1, size=0.3), make_mesh(corners, np.arange(6)), instances=[(0, np.eye(4)[:3]), (1, aside)]
    )
    octree = Octree(device, Geometry.of(scene), np.array([True, True]), 32)
    points = scene.meshes[0].positions
    for level in range(octree.finest + 1):
        keys, _ = cell_keys(device, octree.shape, points, level)
        assert (find_cells(device, octree.arrays, keys, level) != NONE).all()


def restart() -> None:
    """A table that fails is built again in a larger array."""
    from test_cuckoo import WHOLE, check_all_found, colliding, one_table

    from clcache.device import Device

    device, keys = Device("oclgrind", local_size=8), colliding(60, 9, WHOLE)
    tables, arrays = one_table(device, keys)
    assert tables.attempts[WHOLE] > 1
    check_all_found(device, arrays, keys)


CASES = {f.__name__: f for f in (build, restart)}


# By design: work-items look for free places while others fill them, and leave the decision to compare-and-exchange.
PEEKING = ("Read-write data race", "Kernel: insert_cells")


@pytest.mark.parametrize("case", CASES)
def test_kernels_of_octrees_have_no_defects(case, monkeypatch):
    monkeypatch.setattr(race_check, "__file__", __file__)
    assert [r for r in race_check.run(case) if not all(part in r for part in PEEKING)] == []


if __name__ == "__main__":
    sys.path += [str(HERE), str(HERE.parent)]
    race_check.suit_oclgrind()
    CASES[sys.argv[2]]()
    print(f"{sys.argv[2]} is done")
