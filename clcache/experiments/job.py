"""Jobs: the pieces that experiments, trade-offs and references are made of, which do not depend on each other's order or place.

A job is a kind of work and what it is told, both plain data, and the jobs whose results it needs; its key is a digest of all that, so
that what has been done once is found again, by whichever experiment asks for it. A result is rows of numbers and words, which become
tables, and arrays, which become pictures. A `Store` keeps results in a folder, each whole or not at all.
"""

import functools
import hashlib
import importlib
import json
import math
import os
import platform
import time
import zipfile
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .. import drivers
from ..device import Device
from ..errors import Error, SettingError
from ..output.files import atomic_path
from ..scene import load_scene
from ..scene.digest import camera_digest, scene_digest
from ..scene.model import Scene
from ..version import __version__
from .graph_scenes import with_graphs

# What a job can be of: the function that does it, as module:name in this package. Each takes the job's parameters, the results
# that it needs by name, and the machine; it returns a Result.
KINDS = {
    "reference": "reference:run",
    "sequence": "sequence:run",
    "reference_beta": "reference_beta:run",
    "reprojection": "reprojection:run",
    "octree_build": "octree_jobs:build",
    "octree_reading": "octree_jobs:read_back",
    "octree_updates": "octree_jobs:updates",
    "tradeoff": "tradeoff:run",
    "memo_quality": "memo_quality:run",
    "requires": "requires:run",
    "unused": "requires:run_unused",
    "extremes": "extremes:run",
    "precision": "precision:run",
    "mitsuba": "mitsuba:run",
    "mitsuba_reference": "mitsuba:run_reference",
}


@dataclass(frozen=True)
class Machine:
    """Where a job runs. device, threads: as the options of those names."""

    device: str | None = None
    threads: int | None = None

    def open(self, **options: object) -> Device:
        """The device. Raises DeviceError, SettingError."""
        return Device(self.device, self.threads, **options)

    def about(self) -> dict[str, str | int]:
        """What results are found on. Raises DeviceError, SettingError."""
        chosen = drivers.choose(self.device)
        return {
            "host": platform.node(),
            "processor": processor_name(),
            "device": f"{chosen.platform}: {chosen.name}",
            "driver": chosen.driver_version,
            "threads": self.threads or chosen.device.max_compute_units,
        }


@dataclass(frozen=True)
class Result:
    """What a job found. rows: of numbers, words, truth values and None, by column. arrays: by name. about: where and when it was found,
    which is no part of what was found."""

    rows: list[dict]
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    about: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Job:
    """A piece of work. kind: one of KINDS. parameters: what JSON can say. needs: jobs whose results it is given, by name."""

    kind: str
    parameters: Mapping[str, object]
    needs: Mapping[str, "Job"] = field(default_factory=dict)

    @functools.cached_property
    def key(self) -> str:
        """The same for the same work, of the same version, and for no other. Where a scene's file lies is none of that."""
        scene = {k: v for k, v in self.parameters.get("scene", {}).items() if k != "file"}
        told = {
            "version": __version__,
            "kind": self.kind,
            "parameters": {**self.parameters, **({"scene": scene} if scene else {})},
            "needs": {name: job.key for name, job in self.needs.items()},
        }
        text = json.dumps(told, sort_keys=True, allow_nan=False)
        return f"{self.kind}-{hashlib.sha256(text.encode()).hexdigest()[:24]}"


def perform(job: Job, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Do a job, here and now; numbers that are not finite come out as None. Raises what the work raises."""
    start, load = time.time(), os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    found = function_of(job.kind)(job.parameters, needed, machine)
    spent = time.time() - start
    about = machine.about() | {"version": software(), "began": start, "seconds": spent, "load": load}
    rows = [{name: None if _is_infinite(value) else value for name, value in row.items()} for row in found.rows]
    return Result(rows, found.arrays, about | found.about)


def _is_infinite(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


@functools.cache
def software() -> str:
    """The version, and a digest of this package's sources, which tells two of the same version apart."""
    package, found = Path(__file__).resolve().parents[1], hashlib.sha256()
    for file in sorted(f for f in package.rglob("*") if f.suffix in (".py", ".cl")):
        found.update(f"{file.relative_to(package).as_posix()}\0".encode() + file.read_bytes() + b"\0")
    return f"{__version__} ({found.hexdigest()[:8]})"


def function_of(kind: str) -> Callable[[Mapping, Mapping[str, Result], Machine], Result]:
    """What does jobs of a kind. Raises Error for a kind that there is not."""
    if kind not in KINDS:
        raise Error(f"job of kind {kind!r}: unknown; there is {', '.join(KINDS)}")
    module, name = KINDS[kind].split(":")
    return getattr(importlib.import_module(f".{module}", __package__), name)


@functools.cache
def processor_name() -> str:
    """The processor's model as the system names it, or its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


# ---------------------------------------------------------------------------------------------------------------------
# Scenes


def scene_entry(file: str | Path, graphs: str | None = None) -> dict:
    """A scene as jobs are told of it: the file, and a digest of what is in it. graphs: "memory" or "compute", if all materials are replaced by
    graphs of this kind. Raises SceneError, SettingError."""
    path = str(Path(file).resolve())
    changed = Path(path).stat().st_mtime_ns if Path(path).is_file() else 0
    return {"file": path, "digest": _digest(path, graphs, changed)} | ({"graphs": graphs} if graphs else {})


def open_scene(entry: Mapping) -> Scene:
    """The scene that a job was told of. Raises SceneError, SettingError, and Error where it is no longer the same."""
    scene = _load(entry["file"], entry.get("graphs"))
    if _digest_of(scene) != entry["digest"]:
        raise Error(f"{entry['file']}: is not the scene that the job was made for; expected the same files everywhere")
    return scene


@functools.lru_cache(maxsize=64)
def _digest(file: str, graphs: str | None, _changed: int) -> str:
    return _digest_of(_load(file, graphs))


def _load(file: str, graphs: str | None) -> Scene:
    return with_graphs(file, graphs) if graphs else load_scene(file)


def _digest_of(scene: Scene) -> str:
    """Of all that a job's result depends on: what there is, where it is seen from, and the settings that the scene gives, if any."""
    own = json.dumps(scene.defaults.settings, sort_keys=True) if scene.defaults.settings else ""
    settings = f"-{hashlib.sha256(own.encode()).hexdigest()[:8]}" if own else ""
    return f"{scene_digest(scene)}-{camera_digest(scene)}{settings}"


# ---------------------------------------------------------------------------------------------------------------------
# What is kept


class Store:
    """Results in a folder, by the keys of their jobs: KEY.json, and KEY.npz where there are arrays."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def __contains__(self, job: Job) -> bool:
        return self._file(job, "json").is_file()

    def write(self, job: Job, result: Result) -> None:
        """Keep a result: the arrays first, so that where there are rows there is all. Raises SettingError, Error."""
        if result.arrays:
            with atomic_path(self._file(job, "npz")) as part, part.open("wb") as stream:
                np.savez_compressed(stream, **result.arrays)
        text = {
            "kind": job.kind,
            "parameters": job.parameters,
            "needs": {name: needed.key for name, needed in job.needs.items()},
            "arrays": bool(result.arrays),
            "about": result.about,
            "rows": result.rows,
        }
        with atomic_path(self._file(job, "json")) as part:
            part.write_text(json.dumps(text, indent=1, allow_nan=False) + "\n", encoding="utf-8")

    def read(self, job: Job) -> Result:
        """What was kept. Raises SettingError where it is not there, or cannot be read."""
        file = self._file(job, "json")
        try:
            text = json.loads(file.read_text(encoding="utf-8"))
            arrays = {}
            if text["arrays"]:
                with np.load(self._file(job, "npz"), allow_pickle=False) as kept:
                    arrays = {name: kept[name] for name in kept.files}
            return Result(text["rows"], arrays, text["about"])
        except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            raise SettingError(
                f"{file}: cannot be read ({_reason(error)}); remove it, and the job is done again"
            ) from error

    def _file(self, job: Job, ending: str) -> Path:
        return self.folder / f"{job.key}.{ending}"


def _reason(error: Exception) -> str:
    return (getattr(error, "strerror", None) or str(error)).partition("\n")[0]


def with_needs(jobs: Sequence[Job], done: Container[Job] = ()) -> list[Job]:
    """The jobs and all that they need, each once, what is needed first; without those that are done, and what only these need."""
    found: dict[str, Job] = {}

    def visit(job: Job) -> None:
        if job not in done and job.key not in found:
            for needed in job.needs.values():
                visit(needed)
            found[job.key] = job

    for job in jobs:
        visit(job)
    return list(found.values())
