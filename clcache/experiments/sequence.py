"""Sequences of frames that several configurations render side by side, and what is measured of each frame.

All that is compared runs in one process, frame by frame, and each in turn is first, so that whatever else the machine does meets all
alike. A frame's time is the wall clock's, a pass's the device's. Frames at the start, in which caches and histories fill, count for
neither times nor differences. The difference between a frame and the one before it is taken where both show the same point, as a depth
tells that is the same for all methods: that of a ray through the pixel's centre, at the scene's start and without alpha masks. So is the
difference between two eyes.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import Protocol

import numpy as np

from ..bvh.tracer import Tracer
from ..errors import SettingError
from ..metrics import View, reprojected_difference
from ..renderer import Frame, Renderer
from ..scene.model import Camera
from .configuration import Configuration
from .job import Machine, Result, open_scene
from .quality import compare
from .reference import timeline

EYES = ("left", "right")
OTHER = "other"  # the stage of passes that no stage has
Pictures = dict[str, list[np.ndarray]]  # by eye, (H, W, 3) by each seed
_LARGEST_HALF = float(np.finfo(np.float16).max)


def run(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Render all frames by all configurations: a row for each configuration and frame, and the pictures that are kept. Raises
    SceneError, SettingError, DeviceError, Error.

    parameters: scene, configurations, size, frames, skip, stereo, slower, still, seed, metrics, stages, pictures, as of
    `experiment.Sequences`. needed: references by FRAME/SEED. The columns: configuration, frame, counted, seconds, device (of all passes),
    pass.NAME and stage.NAME in seconds; rays.KIND, cache.COUNTER and memo.COUNTER, sums over eyes, with memo.hit_rate of the lookups and
    memo.duplicate_rate of what was built; memory.PART in bytes; where there
    are references, the metrics; in frames that count, difference, which is that to the frame before, and with two eyes stereo, the
    difference between them, beside stereo_reference, that of the references.
    """
    told = parameters
    scene, offset = timeline(open_scene(told["scene"]), told["slower"], told["still"])
    configurations = [Configuration.of(entry) for entry in told["configurations"]]
    first, last = told["frames"]
    if last - first <= told["skip"]:
        raise SettingError(f"frames {first}:{last}: expected more than the {told['skip']} that count for nothing")
    references = references_of(needed)
    size = tuple(told["size"])
    running = {
        c.name: c.renderer(scene, size, told["stereo"], told["seed"], machine.device, machine.threads)
        for c in configurations
    }
    counted = first + told["skip"]
    judges = {name: Judge(references, told["metrics"], counted) for name in running}
    depths = Depths(Tracer(scene, machine.open()))
    frames = alternating(running, first + offset, last + offset)
    rows, arrays = measured(frames, offset, counted, judges, depths, told["stages"], told["pictures"])
    for row in rows:
        row |= of_memory(running[row["configuration"]])
    return Result(rows, arrays | reference_pictures(references, told["pictures"]))


def measured(
    frames: Iterable[Mapping[str, Frame]],
    offset: int,
    counted: int,
    judges: Mapping[str, "Judge"],
    depths: "Depths",
    stages: Mapping[str, Sequence[str]],
    pictures: Sequence[int],
) -> tuple[list[dict], dict[str, np.ndarray]]:
    """A row for each configuration and frame, and the pictures that are kept. frames: each by all configurations. offset: of the numbers that
    they have beside the sequence's. counted: the first frame that counts. judges: by configuration."""
    rows: dict[str, list[dict]] = {name: [] for name in judges}
    arrays: dict[str, np.ndarray] = {}
    for made in frames:
        for name, judge in judges.items():
            frame, number = made[name], made[name].number - offset
            judged = judge.judge(number, frame.color, depths.views(frame.color, frame.cameras))
            row = {"configuration": name, "frame": number, "counted": number >= counted}
            rows[name].append(row | of_frame(frame, stages) | judged)
            if number in pictures:
                arrays |= pictures_of(name, number, frame.color)
    return [row for of in rows.values() for row in of], arrays


class Renders(Protocol):
    """What gives frames one after the other, as `Renderer` does."""

    def frames(self, begin: int, end: int) -> Iterator[Frame]:
        """Frames begin .. end - 1."""


def alternating(running: Mapping[str, Renders], first: int, last: int) -> Iterator[dict[str, Frame]]:
    """Each frame by all renderers, of which another one begins each time."""
    frames = {name: one.frames(first, last) for name, one in running.items()}
    names = list(running)
    for turn in range(last - first):
        shift = turn % len(names)
        yield {name: next(frames[name]) for name in names[shift:] + names[:shift]}


# ---------------------------------------------------------------------------------------------------------------------
# What a frame's statistics tell


def of_frame(frame: Frame, stages: Mapping[str, Sequence[str]]) -> dict[str, float]:
    """Times, rays and counters, of all eyes together, by column; of a frame of another renderer the wall clock's time alone."""
    row = {"seconds": frame.stats["seconds"]}
    tables = {
        key: [eye[key] for eye in frame.stats["eyes"].values() if key in eye]
        for key in ("passes", "rays", "cache", "memo")
    }
    sums = {
        key: {name: sum(eye.get(name, 0) for eye in eyes) for eye in eyes[:1] for name in eye}
        for key, eyes in tables.items()
    }
    passes = sums.pop("passes")
    if not passes:
        return row
    row |= {"device": math.fsum(passes.values())} | {f"pass.{name}": value for name, value in passes.items()}
    row |= {f"stage.{name}": value for name, value in by_stage(passes, stages).items()}
    row |= {f"{key}.{name}": value for key, table in sums.items() for name, value in table.items()}
    return row | shares(row)


def shares(row: Mapping[str, float]) -> dict[str, float]:
    """The parts of a memo's lookups that hit, and of what it built that was built before in the frame, by column; without those of nothing."""
    parts = {"memo.hit_rate": ("memo.hits", "memo.lookups"), "memo.duplicate_rate": ("memo.duplicates", "memo.built")}
    return {name: row[part] / row[whole] for name, (part, whole) in parts.items() if row.get(whole)}


def by_stage(passes: Mapping[str, float], stages: Mapping[str, Sequence[str]]) -> dict[str, float]:
    """Seconds of each stage, and of all passes that are in none as OTHER, if there are any. passes: seconds by pass."""
    found = {stage: math.fsum(passes.get(name, 0.0) for name in names) for stage, names in stages.items()}
    rest = passes.keys() - {name for names in stages.values() for name in names}
    return found | ({OTHER: math.fsum(passes[name] for name in rest)} if stages and rest else {})


def of_memory(renderer: Renderer) -> dict[str, int]:
    """What a renderer takes of the device's memory, in bytes, by column."""
    return {f"memory.{part}": taken for part, taken in renderer.stats()["memory"].items()}


# ---------------------------------------------------------------------------------------------------------------------
# What pictures tell


def references_of(needed: Mapping[str, Result]) -> dict[int, Pictures]:
    """The references by frame. needed: each seed's by FRAME/SEED."""
    found: dict[int, Pictures] = {}
    for name, result in needed.items():
        eyes = found.setdefault(int(name.partition("/")[0]), {})
        for eye, color in result.arrays.items():
            eyes.setdefault(eye, []).append(color)
    return found


@dataclass
class Judge:
    """Compares the frames of one sequence with references and with each other. counted: the first frame that counts."""

    references: Mapping[int, Pictures]
    metrics: Sequence[str]
    counted: int
    _before: Sequence[View] | None = field(default=None, init=False)

    def judge(self, number: int, color: Mapping[str, np.ndarray], views: Sequence[View]) -> dict[str, float]:
        """What there is to say of the next frame, by column. color: by eye. views: of each eye. Where no frame with references counts, all of
        these are compared. Raises SettingError, Error."""
        found: dict[str, float] = {}
        counts = number >= self.counted
        known = self.references.get(number)
        if known and (counts or max(self.references) < self.counted):
            found |= compare(color, known, self.metrics)
            if len(views) == len(EYES):
                means = [np.mean(known[eye], axis=0) for eye in EYES]
                pair = [replace(view, color=mean) for view, mean in zip(views, means, strict=True)]
                found["stereo_reference"] = reprojected_difference(*pair).mean
        if counts and self._before:
            pairs = zip(views, self._before, strict=True)
            found["difference"] = fmean(reprojected_difference(*pair).mean for pair in pairs)
        if counts and len(views) == len(EYES):
            found["stereo"] = reprojected_difference(*views).mean
        self._before = views
        return {name: value for name, value in found.items() if math.isfinite(value)}


class Depths:
    """Views of pictures, with depths that are the same for all configurations: those of one camera are found once."""

    def __init__(self, tracer: Tracer) -> None:
        self._tracer = tracer
        self._found: dict[tuple, np.ndarray] = {}

    def views(self, color: Mapping[str, np.ndarray], cameras: Mapping[str, Camera]) -> list[View]:
        """The view of each eye."""
        asked = {eye: (np.asarray(cameras[eye].transform).tobytes(), color[eye].shape) for eye in color}
        self._found = {
            key: self._found[key] if key in self._found else center_depth(self._tracer, cameras[eye], key[1])
            for eye, key in asked.items()
        }
        return [View(color[eye], self._found[asked[eye]], cameras[eye]) for eye in color]


def center_depth(tracer: Tracer, camera: Camera, shape: tuple[int, ...]) -> np.ndarray:
    """Planar depth of the rays through the pixels' centres, (H, W), infinite where there is nothing."""
    return center_hits(tracer, camera, shape)["t"]


def center_hits(tracer: Tracer, camera: Camera, shape: tuple[int, ...]) -> np.ndarray:
    """The hits of the rays through the pixels' centres, (H, W) HIT_DTYPE; t is planar depth."""
    height, width = shape[:2]
    slope = np.tan(camera.fov_y / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * slope * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * slope
    rays = np.stack([*np.meshgrid(x, y), np.full((height, width), -1.0)], axis=-1).reshape(-1, 3)
    origins = np.broadcast_to(camera.transform[:, 3], rays.shape)
    return tracer.closest_hit(origins, rays @ camera.transform[:, :3].T).reshape(height, width)


def pictures_of(name: str, number: int, color: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A frame's pictures as arrays that are kept. color: by eye."""
    return {
        f"picture/{name}/{number}/{eye}": np.clip(image, 0.0, _LARGEST_HALF).astype(np.float16)
        for eye, image in color.items()
    }


def reference_pictures(references: Mapping[int, Pictures], numbers: Sequence[int]) -> dict[str, np.ndarray]:
    """The means of the references of those frames that are shown."""
    found: dict[str, np.ndarray] = {}
    for number in set(numbers) & references.keys():
        found |= pictures_of("reference", number, {e: np.mean(p, axis=0) for e, p in references[number].items()})
    return found
