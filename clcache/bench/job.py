"""What one process measures, and the scenes that it measures on."""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import clcache

from ..errors import SettingError
from ..scene import load_scene
from ..scene.model import Scene

# The project's scenes: beside the package in a clone.
DATA = Path(clcache.__file__).parents[1] / "data"


@dataclass(frozen=True)
class Job:
    """families: names of what to measure. device: index, or part of a name. threads: of a CPU; None for other devices.
    repeats: runs that count, after one that does not. size: width, height in pixels of the images whose rays are traced,
    multiples of 4. scenes: files; where there is none, each family takes its own of the project's data/."""

    families: tuple[str, ...]
    device: str
    threads: int | None
    repeats: int
    size: tuple[int, int]
    scenes: tuple[str, ...] = ()

    def loaded(self, *usual: str) -> Iterator[tuple[str, Scene]]:
        """Each scene's short name and the scene. usual: names in data/ of the family's own. Raises SceneError,
        SettingError."""
        for file in self.scenes or [str(DATA / name / "scene.toml") for name in usual]:
            if not self.scenes and not Path(file).is_file():
                raise SettingError(f"{file}: the project's scenes are not here; expected --scene FILE")
            yield short_name(file), _load(file)


def short_name(file: str) -> str:
    """A scene file's name without ending; its folder's name for a file called scene.*."""
    path = Path(file).absolute()
    return (path.parent.name if path.stem == "scene" else "") or path.stem


@functools.cache
def _load(file: str) -> Scene:
    return load_scene(file)
