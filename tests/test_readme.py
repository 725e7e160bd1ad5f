"""What README.md has to name: every key of a scene file, every command and every AOV."""

import re
from pathlib import Path

import pytest

from clcache.cli import COMMANDS
from clcache.output.aov import AOVS
from clcache.scene import schema

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


def test_its_scenes_exist(readme):
    named = re.findall(r"data/[\w/.]+toml", readme)
    assert named
    for path in named:
        assert (ROOT / path).is_file()
