"""What the tools that measure have in common: renderers side by side, references, summaries, tables, and the command line.

All that is compared runs in one process, frame by frame, and each in turn is first, so that whatever else the machine
does meets all alike. A frame's time is the wall clock's, a pass's the device's, and both are medians; compare by ratios
of all frames' sums. Frames at the start (`--skip`), in which caches and histories fill, count for neither times nor
differences. The difference between a frame and the one before it is taken where both show the same point, as a depth tells
that is the same for all methods: that of a ray through the pixel's centre, at the scene's start and without alpha masks.
So is the difference between two eyes.
"""

import argparse
import json
import re
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from clcache import Error, Renderer, SceneError, SettingError, Tracer
from clcache.cli.render import MAX_FRAME
from clcache.cli.terminal import say
from clcache.device import Device
from clcache.metrics import View, reprojected_difference
from clcache.output.files import atomic_path
from clcache.output.read import read_picture
from clcache.renderer import Frame
from clcache.scene.model import Camera, Scene

ROOT = Path(__file__).resolve().parent.parent
EYES = ("left", "right")
TEMPORAL_PASSES = ("surface", "distance", "motion", "lay_out", "filter")  # and what they need of a method
Metric = Callable[[np.ndarray, np.ndarray], float]
Pictures = dict[str, np.ndarray]  # by eye


@dataclass(frozen=True)
class Configuration:
    """What is measured. settings: beside the scene's. against: name of the configuration that it is compared with."""

    name: str
    method: str
    settings: Mapping[str, object] = field(default_factory=dict)
    against: str | None = None
    temporal: str = "none"
    stereo_blend: str = "none"
    memo: str = "off"


# ---------------------------------------------------------------------------------------------------------------------
# Renderers side by side


def renderer(
    configuration: Configuration, scene: Scene, args: argparse.Namespace, spp: int = 1, stereo: bool = False
) -> Renderer:
    """A renderer of one eye, or two."""
    return Renderer(
        scene,
        configuration.method,
        args.size,
        stereo=stereo,
        seed=args.seed,
        spp=spp,
        settings=dict(configuration.settings),
        device=args.device,
        threads=args.threads,
        temporal=configuration.temporal,
        stereo_blend=configuration.stereo_blend,
        memo=configuration.memo,
    )


def in_turn(
    configurations: Sequence[Configuration], scene: Scene, args: argparse.Namespace, stereo: bool, first: int, last: int
) -> Iterator[dict[str, Frame]]:
    """Each frame by all configurations, of which another one begins each time."""
    running = {c.name: renderer(c, scene, args, stereo=stereo) for c in configurations}
    return alternating(running, first, last)


def alternating(running: Mapping[str, Renderer], first: int, last: int) -> Iterator[dict[str, Frame]]:
    """Each frame by all renderers, of which another one begins each time."""
    frames = {name: one.frames(first, last) for name, one in running.items()}
    names = list(running)
    for turn in tqdm(range(last - first), unit="frame", disable=None):
        shift = turn % len(names)
        yield {name: next(frames[name]) for name in names[shift:] + names[:shift]}


def sequence(
    configurations: Sequence[Configuration],
    scene: Scene,
    args: argparse.Namespace,
    references: Mapping[int, Pictures],
    metrics: Mapping[str, Metric],
    stages: Mapping[str, Sequence[str]],
    stereo: bool = False,
) -> dict[str, list[dict]]:
    """Render all frames by all configurations in turn: what was measured of each frame, by configuration.

    references: by frame. metrics: what they are compared by, means over eyes. stages: names of passes. An entry has `frame`,
    `seconds`; `passes`, `stages`, `rays` and `cache`, sums over eyes; the metrics where there is a reference; `difference`
    to the frame before, behind those that --skip leaves out; with two eyes `stereo`, the difference between them, and
    `stereo_reference`, that of the reference.
    """
    first, last = frame_range(scene, args)
    tracer = Tracer(scene, Device(args.device, args.threads))
    measured: dict[str, list[dict]] = {c.name: [] for c in configurations}
    before: dict[str, list[View]] = {}
    for turn, made in enumerate(in_turn(configurations, scene, args, stereo, first, last)):
        some = next(iter(made.values()))
        shape = next(iter(some.color.values())).shape
        depths = {eye: center_depth(tracer, camera, shape) for eye, camera in some.cameras.items()}
        for name, frame in made.items():
            views = [View(frame.color[eye], depths[eye], frame.cameras[eye]) for eye in depths]
            entry = of_frame(frame, stages)
            if frame.number in references:
                entry |= compared_with(references[frame.number], frame.color, metrics)
            if turn >= max(args.skip, 1):
                pairs = zip(views, before[name], strict=True)
                entry["difference"] = statistics.fmean(reprojected_difference(*pair).mean for pair in pairs)
            if stereo:
                entry["stereo"] = reprojected_difference(*views).mean
            if stereo and frame.number in references:
                known = references[frame.number]
                pair = (replace(view, color=known[eye]) for eye, view in zip(EYES, views, strict=True))
                entry["stereo_reference"] = reprojected_difference(*pair).mean
            before[name] = views
            measured[name].append(entry)
    return measured


def frame_range(scene: Scene, args: argparse.Namespace) -> tuple[int, int]:
    """The first frame and the one behind the last. Raises SettingError where none is left to count."""
    first, last = args.frames or scene.defaults.frames
    if last - first <= args.skip:
        raise SettingError(f"frames {first}:{last}: expected more than the {args.skip} that --skip leaves out")
    return first, last


def of_frame(frame: Frame, stages: Mapping[str, Sequence[str]]) -> dict:
    """What a frame's statistics tell, of all eyes together."""
    entry = {"frame": frame.number, "seconds": frame.stats["seconds"]}
    for key in ("passes", "rays", "cache"):
        tables = [eye[key] for eye in frame.stats["eyes"].values()]
        entry[key] = {name: sum(table[name] for table in tables) for name in tables[0]}
    return entry | {"stages": by_stage(entry["passes"], stages)}


def by_stage(passes: Mapping[str, float], stages: Mapping[str, Sequence[str]]) -> dict[str, float]:
    """Seconds of each stage. passes: seconds by pass. Raises Error for a pass that is in no stage."""
    known = {name for names in stages.values() for name in names}
    for name in passes:
        if name not in known:
            raise Error(f"pass {name}: in no stage; expected one of those that the tool lists")
    return {stage: sum(passes.get(name, 0.0) for name in names) for stage, names in stages.items()}


def compared_with(reference: Pictures, color: Pictures, metrics: Mapping[str, Metric]) -> dict[str, float]:
    """How a frame's pictures compare, by metric, on average over eyes."""
    return {
        name: statistics.fmean(metric(color[eye], reference[eye]) for eye in color) for name, metric in metrics.items()
    }


# ---------------------------------------------------------------------------------------------------------------------
# References and depths


def read_references(
    folder: Path | None, numbers: Iterable[int], size: tuple[int, int], stereo: bool = False
) -> dict[int, Pictures]:
    """The references of those frames that have one, by frame. Raises SettingError where a folder has none, or one of
    another size or of other eyes."""
    found = {}
    files = {number: folder / f"frame_{number:04d}.exr" for number in numbers} if folder else {}
    for number, file in files.items():
        if file.is_file():
            picture = read_picture(file)
            check_size(file, picture.size, size)
            if not stereo and len(picture.color) > 1:
                raise SettingError(f"{file}: has views {', '.join(picture.color)}; expected one, of --mono")
            if stereo and not picture.color.keys() >= set(EYES):
                raise SettingError(f"{file}: has views {', '.join(picture.color)}; expected left and right")
            found[number] = picture.color if stereo else {"mono": next(iter(picture.color.values()))}
    if files and not found:
        raise SettingError(f"{folder}: no references; expected files as {min(files.values()).name}, of these frames")
    return found


def check_size(file: Path, size: tuple[int, int], expected: tuple[int, int]) -> None:
    """Raise SettingError where a file's picture has another size than expected."""
    if size != expected:
        (width, height), (w, h) = size, expected
        raise SettingError(f"{file}: the picture has {width}x{height} pixels; expected {w}x{h}, as the others")


def slowed(scene: Scene, factor: int) -> Scene:
    """The scene with so many frames for each of its own, whose times the first of them have."""
    return replace(scene, defaults=replace(scene.defaults, fps=scene.defaults.fps * factor))


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


# ---------------------------------------------------------------------------------------------------------------------
# Summaries and tables


def summary(configuration: Configuration, entries: list[dict], skip: int, means: Sequence[str]) -> dict:
    """Of one configuration: what it is; medians of times, rays and counters; these means; and all frames."""
    counted = entries[skip:]
    return {
        "method": configuration.method,
        "settings": dict(configuration.settings),
        "temporal": configuration.temporal,
        "stereo_blend": configuration.stereo_blend,
        "seconds": median(e["seconds"] for e in counted),
        "device": median(sum(e["passes"].values()) for e in counted),
        "stages": medians(counted, "stages"),
        "passes": medians(counted, "passes"),
        "rays": medians(counted, "rays"),
        "cache": medians(counted, "cache"),
        **{key: mean(e[key] for e in entries if key in e) for key in means},
        "frames": entries,
    }


def errors_table(found: Mapping[str, dict], metric: str, label: str) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of a metric in each frame that has it."""
    frames = zip(*(s["frames"] for s in found.values()), strict=True)
    rows = [[str(row[0]["frame"]), *(f"{e[metric]:.4e}" for e in row)] for row in frames if metric in row[0]]
    return [f"{label} of frame", *found], rows


def counters_table(found: Mapping[str, dict]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of what caches have counted."""
    counters = dict.fromkeys(name for s in found.values() for name in s["cache"])
    rows = [
        [name, *(f"{s['cache'][c]:.0f}" if c in s["cache"] else "-" for c in counters)]
        for name, s in found.items()
        if s["cache"]
    ]
    return ["samples", *counters], rows


def number(value: float | None, form: str = ".4e") -> str:
    """A value in words, of which there may be none."""
    return "-" if value is None else format(value, form)


def median(values: Iterable[float]) -> float:
    """The value in the middle."""
    return statistics.median(values)


def medians(entries: Sequence[dict], key: str) -> dict[str, float]:
    """The median of each value of a table that all entries have."""
    return {name: median(e[key][name] for e in entries) for name in entries[0][key]}


def mean(values: Iterable[float]) -> float | None:
    """The mean; None of nothing."""
    values = list(values)
    return statistics.fmean(values) if values else None


def ms(seconds: float) -> str:
    """Milliseconds, in words."""
    return f"{1e3 * seconds:.2f}"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Rows in columns: the first flush left, the others right."""
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    lines = []
    for row in (heads, *rows):
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *cells[1:]]).rstrip())
    return "\n".join(lines)


def report(parts: Iterable[tuple[Sequence[str], Sequence[Sequence[str]]]]) -> str:
    """Tables, one below the other, but for those without rows."""
    return "\n\n".join(table(*part) for part in parts if part[1])


def write_json(file: Path | None, experiment: str, scene: Scene, found: object) -> None:
    """Write all that was measured, if that is wanted."""
    if file:
        with atomic_path(file) as part:
            part.write_text(json.dumps({"experiment": experiment, "scene": scene.file, "found": found}, indent=1))


# ---------------------------------------------------------------------------------------------------------------------
# The command line


def add_common(parser: argparse.ArgumentParser, scene: str) -> None:
    """The options that all experiments have. scene: what there is in place of a scene, in words."""
    add = parser.add_argument
    add("--scene", metavar="FILE", help=f"scene (default: {scene})")
    add("--references", metavar="DIR", type=Path, help="folder of references (default: none, and no errors)")
    add("--size", metavar="WxH", type=size, help="default: the scene's")
    add_machine(parser)
    add("--json", metavar="FILE", type=Path, help="also write all that was measured, frame by frame")


def add_machine(parser: argparse.ArgumentParser) -> None:
    """The seed, and the options that choose a device."""
    add = parser.add_argument
    add("--seed", metavar="N", type=int, default=1)
    add("--device", metavar="SPEC", help="index, or part of the platform's or device's name")
    add("--threads", metavar="N", type=int, help="CPU threads of the device (default: all)")


def add_frames(parser: argparse.ArgumentParser, skip: int, default: str = "the scene's") -> None:
    """The options of experiments that render a sequence."""
    add = parser.add_argument
    add("--frames", metavar="A:B", type=frames, help=f"default: {default}")
    add("--skip", metavar="N", type=whole(0), default=skip, help="frames that do not count (default: %(default)s)")


def size(text: str) -> tuple[int, int]:
    """Width and height, of WxH."""
    match = re.fullmatch(r"([0-9]{1,10})x([0-9]{1,10})", text)
    found = (int(match[1]), int(match[2])) if match else (0, 0)
    if min(found) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected WxH in pixels, such as 640x360")
    return found


def frames(text: str) -> tuple[int, int]:
    """The first frame and the one behind the last, of A:B."""
    match = re.fullmatch(r"([0-9]{1,10}):([0-9]{1,10})", text)
    found = (int(match[1]), int(match[2])) if match else (0, 0)
    if not found[0] < found[1] <= MAX_FRAME:
        raise argparse.ArgumentTypeError(f"{text!r}: expected A:B with 0 <= A < B <= {MAX_FRAME}; B is not rendered")
    return found


def whole(least: int) -> Callable[[str], int]:
    """A parser of whole numbers from this one on."""

    def parse(text: str) -> int:
        if not re.fullmatch(r"[0-9]{1,9}", text) or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number from {least} on")
        return int(text)

    return parse


def chosen(configurations: Sequence[Configuration], names: Sequence[str] | None) -> list[Configuration]:
    """Those of these names, in the order of the list. Raises SettingError for a name that none has."""
    known = {c.name: c for c in configurations}
    for name in names or ():
        if name not in known:
            raise SettingError(f"--only {name}: unknown; there is {', '.join(known)}")
    return [c for c in configurations if names is None or c.name in names]


def exit_code(tool: str, work: Callable[[], None]) -> int:
    """Do the work. The exit code, as of `clcache`; what went wrong is a line on stderr."""
    try:
        work()
    except (SceneError, SettingError) as error:
        say(f"{tool}: error: {error}")
        return 2
    except Error as error:
        say(f"{tool}: error: {error}")
        return 1
    except MemoryError as error:
        say(f"{tool}: error: out of memory: {error}")
        return 1
    return 0
