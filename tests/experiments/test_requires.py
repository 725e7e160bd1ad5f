"""What a scene requires: features of data/, hidden things that switch just what they are to, and pictures that stay as they are."""

from pathlib import Path

import pytest

from clcache import load_scene
from clcache.experiments.configuration import Configuration
from clcache.experiments.job import Job, Machine, perform, scene_entry
from clcache.experiments.requires import EXPERIMENTS, FEATURES, base, features_of
from clcache.scene.geometry import Geometry

DATA = Path(__file__).parents[2] / "data"
PATHTRACE = Configuration("pathtrace", "pathtrace").entry()


@pytest.fixture(scope="module")
def cornell():
    return DATA / "cornell" / "scene.toml"


def compiled_in(scene):
    return {name.removeprefix("HAS_").lower() for name, is_in in features_of(scene).items() if is_in}


def test_features_of_scenes_are_those_that_they_are_known_to_have(cornell):
    assert compiled_in(load_scene(cornell)) == {"normals", "emissive", "emission", "direct"}
    fence = compiled_in(load_scene(DATA / "fence" / "scene.toml"))
    assert {"textures", "base_color_maps", "punctual", "direct"} <= fence and not fence & {"graphs", "emissive"}
    graphs = compiled_in(load_scene(DATA / "graphs" / "scene.toml"))
    assert {"graphs", "textures", "punctual"} <= graphs and "base_color_maps" not in graphs
    spheres = compiled_in(load_scene(DATA / "spheres" / "scene.toml"))
    assert {"specular", "transmission"} <= spheres and "textures" not in spheres


def test_what_is_hidden_switches_its_feature_alone_and_leaves_the_trees(cornell):
    bare = base(load_scene(cornell))
    assert compiled_in(bare) == {"emissive", "emission", "direct"}
    for feature in FEATURES.values():
        without, with_it = feature.pair(bare)
        before, after = features_of(without), features_of(with_it)
        assert {name for name in before if before[name] != after[name]} == set(feature.switches), feature.name
        assert all(after[name] for name in feature.switches), feature.name
        one, other = Geometry.of(without), Geometry.of(with_it)
        assert without.triangle_count == with_it.triangle_count, feature.name
        hidden = one.positions[len(Geometry.of(bare).positions) :]
        assert (hidden[:, 2] < -20).all() and (len(hidden) > 0) == (len(without.meshes) > len(bare.meshes)), (
            feature.name
        )
        assert (one.to_world[: len(bare.instances)] == other.to_world[: len(bare.instances)]).all(), feature.name


def test_pictures_stay_the_same_bits_with_what_no_ray_meets(cornell):
    name = "base colour maps"
    assert FEATURES[name].keeps_bits
    parameters = {"feature": name, "configuration": PATHTRACE, "size": [16, 9], "frames": 3, "skip": 1, "seed": 1}
    job = Job("unused", {"scene": scene_entry(cornell), "cold": False, **parameters})
    (row,) = perform(job, {}, Machine()).rows
    assert row["same"] == 1 and row["configuration"] == f"pathtrace: {name}"
    assert row["difference"] == 0 and row["ratio"] > 0 and row["within"] >= 0
    assert row["bytes"] > 0 and "compile.with" not in row


def test_a_method_is_built_with_no_more_than_a_scene_has(cornell):
    """Of path tracing without an AOV asked for; the albedo's passes and buffers are left out."""
    job = Job("requires", {"scene": scene_entry(cornell), "configuration": PATHTRACE, "size": [16, 9]})
    (row,) = perform(job, {}, Machine()).rows
    is_in = {name.removeprefix("feature.") for name, value in row.items() if name.startswith("feature.") and value}
    assert is_in == {"normals", "emissive", "emission", "direct"} and row["features"] == 4
    assert row["instances"] == 1 and row["mask"] == 0 and row["memo"] == 0
    assert row["bytes.textures"] == 0 and row["bytes.normals"] > 0 and row["bytes.sky"] == 12
    assert (
        row["passes_out"] > 0 and row["buffers_out"] > 0 and row["bytes_out"] > 0 and row["kernels"] > row["programs"]
    )


def test_the_experiments_ask_for_every_scene_and_feature():
    built, unused = EXPERIMENTS
    scenes = {labelled.labels["scene"] for labelled in built.jobs(DATA, [1, 2])}
    assert scenes == {file.parent.name for file in DATA.glob("*/scene.toml")}
    asked = {labelled.job.parameters["feature"] for labelled in unused.jobs(DATA, [1])}
    assert asked == set(FEATURES)
    assert len(unused.jobs(DATA, [1, 2], is_quick=True)) == 6
