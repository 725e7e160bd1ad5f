"""What README.md has to name: every key of a scene file, every command, every AOV, every node of graphs, and every setting of their memo
and of the octree."""

import re
import tomllib
from pathlib import Path

import pytest
from PIL import Image

from clcache.cli import COMMANDS
from clcache.graph import load
from clcache.graph.library import library
from clcache.graph.text import CONSTANT_NODES, OUTPUT_NODES
from clcache.output.aov import AOVS
from clcache.passes.materials import COUNTERS
from clcache.passes.octree_update import COUNTERS as OCTREE_COUNTERS
from clcache.scene import schema
from clcache.settings import MEMOS, SETTINGS

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def readme():
    return (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_key_of_a_scene_file_is_in_the_table(readme):
    scenes = readme[readme.index("## Scenes") : readme.index("## Devices")]
    named = set(re.findall(r"`([a-z_]+)`", scenes)) | set(re.findall(r"\[([a-z]+)\b", scenes))
    tables = [t for t in vars(schema).values() if isinstance(t, type) and issubclass(t, schema.Table)]
    keys = {key for table in tables for key in table.model_fields}
    assert len(keys) > 60
    assert keys - named == set()


def test_every_command_and_aov_is_named(readme):
    for command in COMMANDS:
        assert f"clcache {command}" in readme
    for name in AOVS:
        assert f"`{name}`" in readme


def test_every_node_of_graphs_is_named(readme):
    some = {"Float2Constant", "Float3Constant"}  # between those that are
    for name in {*library(), *CONSTANT_NODES, *OUTPUT_NODES} - some:
        assert f"`{name}`" in readme


def test_every_setting_and_counter_of_memoization_is_named(readme):
    section = readme[readme.index("## Memoization") : readme.index("## Devices")]
    for name in (n for n in SETTINGS if n.startswith("memo.")):
        assert f"`{name}`" in section or f"`{name.removeprefix('memo')}`" in section
        for choice in SETTINGS[name].choices if name in ("memo.eviction", "memo.filter", "memo.read") else ():
            assert f"`{choice}`" in section
    for name in COUNTERS:
        assert f"`{name}`" in section
    for name in set(MEMOS) - {"off"}:
        assert f"--memo {name}" in section


def test_every_setting_and_counter_of_the_octree_is_named(readme):
    section = readme[readme.index("- **octree**") : readme.index("## Filters")]
    for name in (n for n in SETTINGS if n.startswith("octree.")):
        assert f"`{name}`" in section or f"`{name.removeprefix('octree')}`" in section
        for choice in SETTINGS[name].choices if name in ("octree.paths", "octree.filter") else ():
            assert f"`{choice}`" in section
    for name in OCTREE_COUNTERS:
        assert f"`{name}`" in section


def test_its_examples_of_graphs_are_read(readme, tmp_path):
    """The scene's table by the schema; the graph in text form by the compiler."""
    section = readme[readme.index("## Materials by graph") : readme.index("## Memoization")]
    scene, graph = re.findall(r"```(?:toml)?\n(.*?)```", section, re.DOTALL)
    table = schema.SceneTable.model_validate(tomllib.loads(scene))
    assert table.materials["table"].graph_material == "Oak" and table.meshes["room"].materials == {"Table top": "table"}
    (tmp_path / "a.graph").write_text(graph)
    Image.new("RGB", (2, 2)).save(tmp_path / "wood.jpg")
    loaded = load(tmp_path / "a.graph")
    assert loaded.outputs == {"base_color": 3} and loaded.reads == {"uv", "position"}


def test_its_scenes_exist(readme):
    named = re.findall(r"data/[\w/.]+(?:toml|graph)", readme)
    assert named
    for path in named:
        assert (ROOT / path).is_file()
