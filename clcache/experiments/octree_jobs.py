"""What is measured of the octree's cache beside sequences: what building it takes, what a full cache shows where the view counts, and how many
cells an update reaches.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..bvh.tracer import MISS, Tracer
from ..device import Device
from ..errors import Error
from ..octree import Octree
from ..renderer import Renderer
from ..resources import eyes_of
from ..scene.geometry import Geometry
from ..scene.model import Camera, Material, Scene
from . import sequence
from .configuration import Configuration
from .job import Machine, Result, open_scene
from .quality import block_means, compare, mean_and_error, squared_error
from .reference import timeline

CELL_BYTES = 24
BUCKET_BYTES = 4 * 8
SMOOTH = 0.3  # below this roughness, what a surface reflects follows the view
EYE = "mono"

# ---------------------------------------------------------------------------------------------------------------------
# Building


def build(parameters: Mapping, _needed: Mapping[str, Result], machine: Machine) -> Result:
    """Build an octree in a process of its own, whose memory is its own: a row of the whole build, and, if asked for, one for each level.
    Raises Error where the build fails, or where it does not take what it should.

    parameters: scene, resolution, levels (whether these have rows), seed (of which repetition it is: times alone differ).
    """
    told = {**parameters, "device": machine.device, "threads": machine.threads}
    package = str(Path(__file__).resolve().parents[2])
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([package, os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-m", __name__, json.dumps(told)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"ended with exit code {done.returncode}"]
        raise Error(f"octree.resolution {parameters['resolution']}: {lines[-1]}")
    found = json.loads(done.stdout)
    rows = [whole(found)]
    if parameters["levels"]:
        rows += [level_row(level) for level in found["levels"]]
    return Result([{"counted": True} | row for row in rows])


def built(told: Mapping) -> dict:
    """Build an octree alone, in this process: its report; seconds, kernels being there; bytes that the process had before, and at most."""
    scene = open_scene(told["scene"])
    device, geometry = Device(told["device"], told["threads"]), Geometry.of(scene)
    is_static, eyes = np.array([not i.motion for i in scene.instances]), eyes_of(scene)
    Octree(device, geometry, is_static, min(told["resolution"], 64), eyes)  # whose kernels are then there
    before, start = peak_memory(), time.perf_counter()
    tree = Octree(device, geometry, is_static, told["resolution"], eyes)
    elapsed = time.perf_counter() - start
    check_law(tree)
    return tree.report() | {
        "elapsed": elapsed,
        "before_bytes": before,
        "peak_bytes": peak_memory(),
        "kept_bytes": tree.nbytes,
    }


def peak_memory() -> int:
    """The most bytes that this process had in memory."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def check_law(tree: Octree) -> None:
    """Raise Error where what the levels take is not 24 bytes for each cell, and 32 for each bucket."""
    levels = tree.report()["levels"]
    for level in levels:
        if level["data_bytes"] != CELL_BYTES * level["cells"]:
            raise Error(f"level {level['level']}: {level['data_bytes']} bytes; expected {CELL_BYTES} for each cell")
    first, buckets = tree.arrays["octree_tables"].get()[:, :2].astype(np.int64).T
    buckets = int(buckets[first > 0].sum())  # the first one is that of tables without cells
    if sum(level["hash_bytes"] for level in levels) != BUCKET_BYTES * buckets:
        raise Error(f"the tables' {buckets} buckets take other than {BUCKET_BYTES} bytes each")


def whole(found: Mapping) -> dict:
    """The row of a build. Of its finest three levels: by how much the density falls, and the data grow, from each to the next."""
    cells, data, tables = (
        sum(level[key] for level in found["levels"]) for key in ("cells", "data_bytes", "hash_bytes")
    )
    above, finest = found["levels"][-4], found["levels"][-1]
    return {
        "configuration": f"{found['resolution']}^3",
        "resolution": found["resolution"],
        "cells": cells,
        "data_bytes": data,
        "hash_bytes": tables,
        "cell_bytes": data / cells,
        "cell_hash_bytes": tables / cells,
        "thinning": (finest["density"] / above["density"]) ** (1 / 3),
        "growth": (finest["data_bytes"] / above["data_bytes"]) ** (1 / 3),
        "elapsed": found["elapsed"],
        **{f"seconds.{step}": seconds for step, seconds in found["seconds"].items()},
        "attempts": found["attempts"],
        "kept_bytes": found["kept_bytes"],
        "before_bytes": found["before_bytes"],
        "peak_bytes": found["peak_bytes"],
    }


def level_row(level: Mapping) -> dict:
    """The row of a level."""
    return {
        "configuration": f"level {level['level']:2}",
        "level": level["level"],
        "edge": 2 ** level["level"],
        "level_cells": level["cells"],
        "density": level["density"],
        "level_data_bytes": level["data_bytes"],
        "level_hash_bytes": level["hash_bytes"],
    }


# ---------------------------------------------------------------------------------------------------------------------
# Reading a full cache


def read_back(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Fill a cache by a fly-through, and read its last frame from it by several settings, without caching: a row of each, as of a sequence's frame,
    with relmse of the pixels whose first hits follow the view and of the rest as relmse.view and relmse.rest, each with its standard error as
    COLUMN_error, and the former's share of all. Raises SceneError, SettingError, DeviceError, Error.

    parameters: as of a sequence, of one eye; the first configuration fills the cache, the others, of the same resolution, read it. needed:
    references of the last frame by FRAME/SEED.
    """
    told = parameters
    scene, offset = timeline(open_scene(told["scene"]), told["slower"], told["still"])
    filling, *readings = (Configuration.of(entry) for entry in told["configurations"])
    references, shown = sequence.references_of(needed), told["frames"][1] - 1
    size, number = tuple(told["size"]), shown + offset
    own = told["seed"], machine.device, machine.threads
    with tempfile.TemporaryDirectory() as folder:
        state = Path(folder) / "state.npz"
        fill(filling.renderer(scene, size, False, *own), told["frames"][0] + offset, number, state)
        rows, arrays = [], sequence.reference_pictures(references, told["pictures"])
        for configuration in readings:
            reading = replace(configuration, settings={**configuration.settings, "octree.caching_resolution": 0.0})
            renderer = reading.renderer(scene, size, False, *own)
            renderer.warm_start(state)
            (frame,) = renderer.frames(number, number + 1)
            row = {"configuration": configuration.name, "frame": shown, "counted": True}
            row |= sequence.of_frame(frame, told["stages"]) | sequence.of_memory(renderer)
            known = references[shown]
            row |= compare(frame.color, known, told["metrics"])
            mask = follows_view(scene, Tracer(scene, machine.open()), frame.cameras[EYE], frame.color[EYE].shape)
            rows.append(row | by_part(frame.color[EYE], known[EYE], mask))
            if shown in told["pictures"]:
                arrays |= sequence.pictures_of(configuration.name, shown, frame.color)
    return Result(rows, arrays)


def fill(running: Renderer, first: int, last: int, state: Path) -> None:
    """Render frames from first to last - 1, and save what the cache then has."""
    for _ in running.frames(first, last):
        pass
    running.save(state)


def by_part(color: np.ndarray, references: Sequence[np.ndarray], mask: np.ndarray) -> dict[str, float]:
    """Errors of the pixels in a mask, and of the rest, where there are any."""
    error, found = squared_error(color, references), {"share": float(mask.mean())}
    for part, pixels in (("view", mask), ("rest", ~mask)):
        if pixels.any():
            mean, deviation = mean_and_error(*block_means(error, pixels))
            found |= {f"relmse.{part}": mean, f"relmse.{part}_error": deviation}
    return found


def follows_view(scene: Scene, tracer: Tracer, camera: Camera, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) bool: whether what a pixel's first hit shows follows the view; at its centre, of the scene at its start, and without
    alpha masks."""
    hits = sequence.center_hits(tracer, camera, shape)
    is_hit = hits["instance"] != MISS
    mesh = np.array([i.mesh for i in scene.instances])
    first = np.cumsum([0, *(len(m.triangles) for m in scene.meshes)])[:-1]
    material = np.concatenate([m.material for m in scene.meshes])
    triangle = first[mesh[np.where(is_hit, hits["instance"], 0)]] + np.where(is_hit, hits["primitive"], 0)
    return is_hit & np.array([shines(scene, m) for m in scene.materials])[material[triangle]]


def shines(scene: Scene, material: Material) -> bool:
    """Whether a material is metal, lets light through, or is glossy; where a texture varies it, by that one's mean."""
    use = material.metallic_roughness_texture
    _, green, blue, _ = scene.textures[use.index].pixels.mean(axis=(0, 1)) / 255 if use else (1, 1, 1, 1)
    is_glossy = material.specular > 0 and material.roughness * green < SMOOTH
    return material.metallic * blue > 0.5 or material.transmission > 0 or is_glossy


# ---------------------------------------------------------------------------------------------------------------------
# Updates


def updates(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """A sequence, whose rows also have `updated`: how many cells of all levels one update reaches, which are those that have light after the first
    one of an empty cache. Raises and is told what a sequence does."""
    found = sequence.run(parameters, needed, machine)
    scene, offset = timeline(open_scene(parameters["scene"]), parameters["slower"], parameters["still"])
    first, counts = parameters["frames"][0] + offset, {}
    for configuration in map(Configuration.of, parameters["configurations"]):
        renderer = configuration.renderer(
            scene, tuple(parameters["size"]), parameters["stereo"], parameters["seed"], machine.device, machine.threads
        )
        (frame,) = renderer.frames(first, first + 1)
        counts[configuration.name] = sum(eye["cache"]["occupied"] for eye in frame.stats["eyes"].values())
    return Result([row | {"updated": counts[row["configuration"]]} for row in found.rows], found.arrays)


def main() -> int:
    """The child process of `build`: JSON of what it is told as its one argument, JSON of what it found on stdout."""
    try:
        print(json.dumps(built(json.loads(sys.argv[1]))))
    except (Error, MemoryError) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
