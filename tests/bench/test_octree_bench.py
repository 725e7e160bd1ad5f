"""The benchmark of the octree: that what it times is what it says."""

import numpy as np
import pytest

from clcache.bench import Job
from clcache.bench.octree import LAYERS, STAGES, absent_keys, built, find, finest_keys, octree
from clcache.device import Device
from clcache.octree import Octree
from clcache.resources import SceneResources
from clcache.scene import load_scene

SCENE = """
[render]
settings = {{ "octree.resolution" = {resolution} }}
[meshes.strip]
generator = "plane"
size = [4.0, {width}]
[materials.gloss]
specular = 1.0
roughness = 0.1
[[instances]]
mesh = "strip"
material = "gloss"
[[lights]]
type = "point"
position = [0.0, 2.0, 0.0]
intensity = [9.0, 9.0, 9.0]
[camera]
position = [0.0, 3.0, 3.0]
look_at = [0.0, 0.0, 0.0]
fov_y = 45.0
"""
NONE = 0xFFFFFFFF


def scene_file(tmp_path, resolution, width):
    file = tmp_path / "strip.toml"
    file.write_text(SCENE.format(resolution=resolution, width=width))
    return str(file)


@pytest.mark.parametrize("resolution", [64, 2048])
def test_hits_are_all_cells_and_misses_are_none(tmp_path, resolution):
    """Above 1024^3 a level has several tables."""
    device = Device()
    tree = built(device, load_scene(scene_file(tmp_path, resolution, 8 / resolution)), resolution)
    keys, rng = finest_keys(tree), np.random.default_rng(4)
    first, end = tree.first_cell[-2:]
    assert len(keys) == end - first > resolution
    assert (np.diff(keys) > 0).all() and keys[-1] < 8**tree.finest
    _, found = find(device, tree, keys, 1)
    assert (found == np.arange(first, end)).all()
    missing = absent_keys(tree, keys, 1000, rng)
    assert len(missing) == 1000
    seconds, found = find(device, tree, missing, 3)
    assert (found == NONE).all()
    assert len(seconds) == 3
    device.release(*tree.arrays.values())


def test_what_is_measured_is_the_octree_of_the_method(tmp_path):
    """Which is about what is near, where a ground reaches very much farther."""
    text = SCENE.format(resolution=64, width=4000.0).replace("[4.0, 4000.0]", "[4000.0, 4000.0]")
    file = tmp_path / "ground.toml"
    file.write_text(f'{text}\n[meshes.ball]\ngenerator = "sphere"\n[[instances]]\nmesh = "ball"\nmaterial = "gloss"\n')
    device, scene = Device(), load_scene(file)
    tree = built(device, scene, 64)
    resources = SceneResources(device, scene)
    own = Octree(device, resources.geometry, resources.is_static, 64, resources.eyes)
    assert tree.shape == own.shape and tree.shape["size"] < 100
    assert (tree.first_cell == own.first_cell).all()


def test_all_parts_are_measured(tmp_path):
    job = Job(("octree",), None, None, 2, (32, 16), (scene_file(tmp_path, 64, 4.0),))
    results = list(octree(job))
    named = {r.name: r for r in results}
    assert len(named) == len(results)
    assert {r.scene for r in results} == {"strip"}
    assert all(len(r.seconds) == 2 and min(r.seconds) >= 0 for r in results)
    lookups = {f"{what} {order}" for what in ("hits", "misses") for order in ("in order", "shuffled")}
    assert {r.name for r in results if r.unit == "lookups"} == lookups
    assert all(named[name].nbytes > 12 * named[name].items for name in lookups)
    updates = [r for r in results if r.unit == "vertices"]
    assert {r.items for r in updates} == {3 * 32 * 16}
    assert {"update", "update, sort", "update, merge"} <= {r.name for r in updates}
    steps = [r.seconds for r in updates if r.name != "update"]
    assert named["update"].seconds == pytest.approx([sum(each) for each in zip(*steps, strict=True)])
    assert {"build"} < {r.name for r in results if r.unit == "cells"}
    assert {f"filter of {n} layer{'s' if n > 1 else ''}" for n in LAYERS} <= named.keys()
    assert {"whole frame", "path-traced frame", *STAGES} <= named.keys()
    for stage in STAGES:
        steps = [r.seconds for r in results if r.name.startswith(f"{stage}.")]
        assert named[stage].seconds == pytest.approx([sum(each) for each in zip(*steps, strict=True)])
        assert max(named[stage].seconds) < max(named["whole frame"].seconds)
