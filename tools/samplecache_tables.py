"""Measure the sample cache: the tables of SampleCache's section 5, on this machine and on any scene.

    python tools/samplecache_tables.py tracing --scene data/atrium/scene.toml --references DIR    as Fig. 7
    python tools/samplecache_tables.py isrt --scene data/atrium/scene.toml --references DIR       as Fig. 10
    python tools/samplecache_tables.py shading --scene data/atrium/scene.toml --references DIR    as Fig. 14
    python tools/samplecache_tables.py paths --scene data/classroom/scene.toml --references DIR   beside path tracing
    python tools/samplecache_tables.py static --references DIR                                    a still scene converges

DIR holds frames of the same view and size, as `clcache render` names them, each of them true but for its noise:

    clcache render data/atrium/scene.toml --mono --size 640x360 --spp 256 --seed 1000 --frames 7:8 -o DIR

The error is taken at those frames that are there. `static` renders its own one and keeps it there. Exit codes are those of
`clcache`: 1 where the work failed, 2 where what was given is wrong.

All that is compared runs in one process, frame by frame, and each in turn is first, so that whatever else the machine
does meets all alike. A frame's time is the wall clock's, a pass's the device's, and both are medians; compare by the ratios,
which are of all frames' sums. Frames at the start (`--skip`), in which caches fill, count for neither times nor
differences. The difference between a frame and the one before it is taken where both show the same point, as a depth tells
that is the same for all methods: that of a ray through the pixel's centre, at the scene's start and without alpha masks.
"""

import argparse
import json
import re
import statistics
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from clcache import Error, Renderer, SceneError, SettingError, Tracer, load_scene
from clcache.cli import Parser
from clcache.cli.render import MAX_FRAME
from clcache.cli.terminal import say
from clcache.metrics import View, relmse, reprojected_difference
from clcache.output.files import atomic_path, check_target
from clcache.output.read import read_picture
from clcache.scene.model import Camera, Scene

ROOT = Path(__file__).resolve().parent.parent
STILL = 1e9  # frames per second: all frames show the start
CHECKPOINTS = (1, 4, 16, 64)  # samples per pixel of `static`
REFERENCE_SEED = 1000

# The stages of the paper's figures, and the passes that each has.
STAGES = {
    "reprojection": ("clear", "list", "project", "reserve", "copy"),
    "tracing": ("order", "generate", "assess", "plan", "aim", "retrace", "settle"),
    "shading": (
        *("importance", "choose", "begin", "first_hits"),
        *("shade", "trace", "shadow", "compact", "finish", "accumulate"),
    ),
    "reconstruction": (
        *("list_visible", "resolve", "average", "moments", "describe", "aovs", "blend"),
        *("color_sum", "color"),
    ),
}
STAGE_OF = {name: stage for stage, names in STAGES.items() for name in names}
# The kinds of rays that a pass traces; a method with a cache has a pass of its own for the first hits.
RAYS_OF = {"retrace": ("primary",), "trace": ("secondary",), "shadow": ("shadow",)}
RAYS_OF_PATHS = {"trace": ("primary", "secondary"), "shadow": ("shadow",)}


@dataclass(frozen=True)
class Configuration:
    """What is measured. settings: beside the scene's. against: name of the configuration that it is compared with."""

    name: str
    method: str = "samplecache"
    settings: dict[str, object] = field(default_factory=dict)
    against: str | None = None

    @property
    def rays_of(self) -> dict[str, tuple[str, ...]]:
        """The kinds of rays of each pass that traces."""
        return RAYS_OF_PATHS if self.method == "pathtrace" else RAYS_OF


def cache(name: str, against: str | None = None, **settings: object) -> Configuration:
    """The sample cache with some of its settings."""
    return Configuration(
        name, settings={f"samplecache.{key}": value for key, value in settings.items()}, against=against
    )


def isrt(factor: int, **settings: object) -> Configuration:
    """Interactive stable ray tracing with so many samples by so many."""
    settings = {"isrt.superresolution": factor, **{f"samplecache.{key}": value for key, value in settings.items()}}
    return Configuration(f"isrt M={factor}", "isrt", settings)


UNIFORM = {"shading": "uniform", "shading_rate": 1.0}
SINGLE = {"tracing": "single", **UNIFORM}  # as interactive stable ray tracing has it
EXPERIMENTS = {
    "tracing": (
        cache("single", against="multi", tracing="single", **UNIFORM),
        cache("multi", tracing="multi", **UNIFORM),
        cache("adaptive", against="multi", tracing="adaptive", **UNIFORM),
    ),
    "isrt": (
        isrt(3, target=4, **SINGLE),
        cache("N=9", against="isrt M=3", slots=9, target=4, **SINGLE),
        isrt(4, target=6, **SINGLE),
        cache("N=16", against="isrt M=4", slots=16, target=6, **SINGLE),
    ),
    "shading": (
        cache("uniform 1.0", **UNIFORM),
        cache("adaptive 0.7", against="uniform 1.0", shading="adaptive", shading_rate=0.7),
    ),
    "paths": (
        Configuration("pathtrace", "pathtrace"),
        cache("samplecache", against="pathtrace"),
        cache("uniform", against="pathtrace", **UNIFORM),
    ),
}
STATIC = (
    cache("target 4", slots=12, target=4, **UNIFORM),
    cache("target 8", slots=12, target=8, **UNIFORM),
    cache("16 slots, target 15", slots=16, target=15, **UNIFORM),
)


# ---------------------------------------------------------------------------------------------------------------------
# Sequences


def sequence(configurations: Sequence[Configuration], scene: Scene, args: argparse.Namespace) -> dict[str, list[dict]]:
    """Render all frames by all configurations in turn: what was measured of each frame, by configuration."""
    first, last = args.frames or scene.defaults.frames
    if last - first <= args.skip:
        raise SettingError(f"frames {first}:{last}: expected more than the {args.skip} that --skip leaves out")
    references = read_references(args.references, range(first, last), args.size or scene.defaults.size)
    renderers = {c.name: renderer(c, scene, args) for c in configurations}
    running = {name: r.frames(first, last) for name, r in renderers.items()}
    tracer = Tracer(scene, args.device)
    measured: dict[str, list[dict]] = {name: [] for name in running}
    before: dict[str, View] = {}
    names = list(running)
    for turn, number in enumerate(tqdm(range(first, last), unit="frame", disable=None)):
        depth = None
        for name in names[turn % len(names) :] + names[: turn % len(names)]:
            frame = next(running[name])
            eye, color, camera = frame.stats["eyes"]["mono"], frame.color["mono"], frame.cameras["mono"]
            depth = center_depth(tracer, camera, color.shape) if depth is None else depth
            view = View(color, depth, camera)
            entry = {"frame": number, "seconds": frame.stats["seconds"], "stages": by_stage(eye["passes"]), **eye}
            if number in references:
                entry["relmse"] = relmse(color, references[number])
            if turn >= max(args.skip, 1):
                entry["difference"] = reprojected_difference(view, before[name]).mean
            before[name] = view
            measured[name].append(entry)
    return measured


def renderer(configuration: Configuration, scene: Scene, args: argparse.Namespace, spp: int = 1) -> Renderer:
    """A renderer of one eye."""
    return Renderer(
        scene,
        configuration.method,
        args.size,
        stereo=False,
        seed=args.seed,
        spp=spp,
        settings=configuration.settings,
        device=args.device,
        threads=args.threads,
    )


def read_references(folder: Path | None, numbers: Iterable[int], size: tuple[int, int]) -> dict[int, np.ndarray]:
    """The references of those frames that have one, by frame. Raises SettingError where a folder has none, or one of
    another size or of two eyes."""
    found = {}
    files = {number: folder / f"frame_{number:04d}.exr" for number in numbers} if folder else {}
    for number, file in files.items():
        if file.is_file():
            picture = read_picture(file)
            check_size(file, picture.size, size)
            if len(picture.color) > 1:
                raise SettingError(f"{file}: has views {', '.join(picture.color)}; expected one, of --mono")
            (found[number],) = picture.color.values()
    if files and not found:
        raise SettingError(f"{folder}: no references; expected files as {min(files.values()).name}, of these frames")
    return found


def check_size(file: Path, size: tuple[int, int], expected: tuple[int, int]) -> None:
    """Raise SettingError where a file's picture has another size than expected."""
    if size != expected:
        (width, height), (w, h) = size, expected
        raise SettingError(f"{file}: the picture has {width}x{height} pixels; expected {w}x{h}, as the others")


def center_depth(tracer: Tracer, camera: Camera, shape: tuple[int, ...]) -> np.ndarray:
    """Planar depth of the rays through the pixels' centres, (H, W), infinite where there is nothing."""
    height, width = shape[:2]
    slope = np.tan(camera.fov_y / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * slope * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * slope
    rays = np.stack([*np.meshgrid(x, y), np.full((height, width), -1.0)], axis=-1).reshape(-1, 3)
    origins = np.broadcast_to(camera.transform[:, 3], rays.shape)
    return tracer.closest_hit(origins, rays @ camera.transform[:, :3].T)["t"].reshape(height, width)


def summary(configuration: Configuration, measured: dict[str, list[dict]], skip: int) -> dict:
    """Of one configuration: medians of times, rays and counters; means of errors and differences; how it compares; and all
    frames. measured: of all configurations."""
    entries, against = measured[configuration.name], configuration.against
    counted = entries[skip:]
    rays = medians(counted, "rays")
    return {
        "method": configuration.method,
        "settings": configuration.settings,
        "seconds": median(e["seconds"] for e in counted),
        "device": median(sum(e["passes"].values()) for e in counted),
        "stages": medians(counted, "stages"),
        "passes": medians(counted, "passes"),
        "rays": rays,
        "rays of passes": {name: sum(rays[kind] for kind in kinds) for name, kinds in configuration.rays_of.items()},
        "cache": medians(counted, "cache"),
        "relmse": mean(e["relmse"] for e in entries if "relmse" in e),
        "difference": mean(e["difference"] for e in counted if "difference" in e),
        "against": against,
        "ratios": compared(entries, measured[against], skip) if against else {},
        "frames": entries,
    }


def by_stage(passes: Mapping[str, float]) -> dict[str, float]:
    """Seconds of each stage. passes: seconds by pass. Raises Error for a pass that is in no stage."""
    totals = dict.fromkeys(STAGES, 0.0)
    for name, seconds in passes.items():
        if name not in STAGE_OF:
            raise Error(f"pass {name}: in no stage; expected one that STAGES in {Path(__file__).name} lists")
        totals[STAGE_OF[name]] += seconds
    return totals


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


def compared(own: Sequence[dict], other: Sequence[dict], skip: int) -> dict[str, float]:
    """What is measured of one configuration over that of another, of the times and rays the sums."""
    totals = {
        "frame time": lambda e: e["seconds"],
        "device time": lambda e: sum(e["passes"].values()),
        "first-hit rays": lambda e: e["rays"]["primary"],
    }
    ratios = {name: sum(map(of, own[skip:])) / sum(map(of, other[skip:])) for name, of in totals.items()}
    for key in ("relmse", "difference"):
        a, b = (mean(e[key] for e in entries if key in e) for entries in (own, other))
        if a is not None and b:
            ratios[key] = a / b
    return ratios


def report(found: dict[str, dict]) -> str:
    """The tables: times by stage, rays and errors; ratios; errors of each frame; times by pass with its rays; counters."""
    return "\n\n".join(
        table(*part)
        for part in (_stages(found), _ratios(found), _errors(found), _passes(found), _counters(found))
        if part[1]
    )


def _stages(found: dict[str, dict]) -> tuple[list[str], list[list[str]]]:
    kinds = ("primary", "secondary", "shadow")
    rows = [
        [name, ms(s["seconds"]), ms(s["device"]), *map(ms, s["stages"].values())]
        + [f"{s['rays'][kind] / 1e3:.1f}" for kind in kinds]
        + ["-" if s[key] is None else f"{s[key]:.4e}" for key in ("relmse", "difference")]
        for name, s in found.items()
    ]
    return ["", "frame ms", "device ms", *STAGES, *(f"{kind} k" for kind in kinds), "relMSE", "difference"], rows


def _ratios(found: dict[str, dict]) -> tuple[list[str], list[list[str]]]:
    names = list(dict.fromkeys(key for s in found.values() for key in s["ratios"]))
    rows = [
        [f"{name} / {s['against']}", *(f"{s['ratios'][key]:.3f}" if key in s["ratios"] else "-" for key in names)]
        for name, s in found.items()
        if s["against"]
    ]
    return ["", *names], rows


def _errors(found: dict[str, dict]) -> tuple[list[str], list[list[str]]]:
    frames = zip(*(s["frames"] for s in found.values()), strict=True)
    rows = [[str(row[0]["frame"]), *(f"{e['relmse']:.4e}" for e in row)] for row in frames if "relmse" in row[0]]
    return ["relMSE of frame", *found], rows


def _passes(found: dict[str, dict]) -> tuple[list[str], list[list[str]]]:
    rows = []
    for step in dict.fromkeys(name for s in found.values() for name in s["passes"]):
        cells = []
        for s in found.values():
            seconds, rays = s["passes"].get(step), s["rays of passes"].get(step)
            cells.append("" if seconds is None else ms(seconds))
            cells.append("" if seconds is None or rays is None else f"{rays / 1e3:.1f}")
        rows.append([step, STAGE_OF[step], *cells])
    return ["pass", "stage", *(text for name in found for text in (f"{name} ms", "k rays"))], rows


def _counters(found: dict[str, dict]) -> tuple[list[str], list[list[str]]]:
    counters = dict.fromkeys(name for s in found.values() for name in s["cache"])
    rows = [[name, *(f"{s['cache'][c]:.0f}" for c in counters)] for name, s in found.items() if s["cache"]]
    return ["samples", *counters], rows


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


# ---------------------------------------------------------------------------------------------------------------------
# A still scene


def static(scene: Scene, args: argparse.Namespace) -> tuple[str, dict]:
    """The errors of caches after some frames, and of path tracing with as many samples for each pixel."""
    scene = replace(scene, defaults=replace(scene.defaults, fps=STILL))
    reference, paths = still_reference(scene, args), {}
    for count in CHECKPOINTS:
        (frame,) = renderer(Configuration("pathtrace", "pathtrace"), scene, args, count).frames(0, 1)
        paths[count] = relmse(frame.color["mono"], reference)
    found = {c.name: converging(c, scene, args, reference) for c in STATIC}
    rows = []
    for name, errors in found.items():
        for count, entry in errors.items():
            entry["pathtrace"] = paths[count]
            row = f"{entry['shaded']:.3f}", f"{entry['relmse']:.6f}", f"{paths[count]:.6f}"
            rows.append([name, str(count), *row, f"{entry['relmse'] / paths[count]:.3f}"])
    return table(["", "frames", "samples per pixel", "relMSE", "pathtrace relMSE", "ratio"], rows), found


def converging(
    configuration: Configuration, scene: Scene, args: argparse.Namespace, reference: np.ndarray
) -> dict[int, dict[str, float]]:
    """The error of a cache after some frames, and how many samples it has shaded for each pixel, by frames."""
    cached = renderer(configuration, scene, args)
    pixels, shaded, found = cached.size[0] * cached.size[1], 0, {}
    running = cached.frames(0, CHECKPOINTS[-1])
    for frame in tqdm(running, configuration.name, CHECKPOINTS[-1], unit="frame", disable=None):
        shaded += frame.stats["eyes"]["mono"]["cache"]["shaded"]
        if frame.number + 1 in CHECKPOINTS:
            found[frame.number + 1] = {"relmse": relmse(frame.color["mono"], reference), "shaded": shaded / pixels}
    return found


def still_reference(scene: Scene, args: argparse.Namespace) -> np.ndarray:
    """The path tracer's frame 0 with --reference-spp samples, rendered once and kept in the folder of references."""
    (width, height), path = args.size or scene.defaults.size, Path(scene.file).resolve()
    name = f"{path.parent.name}_{path.stem}_{width}x{height}_{args.reference_spp}spp.npy"
    if args.references:
        kept = check_target(args.references / name)
        if kept.is_file():
            return kept_reference(kept, (height, width, 3))
    reference = Configuration("reference", "pathtrace")
    own = argparse.Namespace(**{**vars(args), "seed": REFERENCE_SEED})
    (frame,) = renderer(reference, scene, own, args.reference_spp).frames(0, 1)
    if args.references:
        with atomic_path(args.references / name) as part, part.open("wb") as stream:
            np.save(stream, frame.color["mono"])
    return frame.color["mono"]


def kept_reference(file: Path, shape: tuple[int, int, int]) -> np.ndarray:
    """What an earlier run has written. Raises SettingError where the file is something else."""
    try:
        reference = np.load(file, allow_pickle=False)
    except (OSError, EOFError, ValueError) as error:
        raise SettingError(f"{file}: cannot be read ({error}); remove it, and it is rendered anew") from None
    if not isinstance(reference, np.ndarray) or reference.shape != shape or reference.dtype != np.float32:
        raise SettingError(f"{file}: expected an array {shape} of float32; remove it, and it is rendered anew")
    return reference


# ---------------------------------------------------------------------------------------------------------------------


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


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line. Raises SettingError."""
    own = {"prog": Path(__file__).name, "formatter_class": argparse.RawDescriptionHelpFormatter}
    parser, common = Parser(description=__doc__, **own), Parser(add_help=False)
    add = common.add_argument
    add("--scene", metavar="FILE", help="scene (default: data/atrium, of static data/cornell)")
    add("--references", metavar="DIR", type=Path, help="folder of references (default: none, and no errors)")
    add("--size", metavar="WxH", type=size, help="default: the scene's")
    add("--seed", metavar="N", type=int, default=1)
    add("--device", metavar="SPEC", help="index, or part of the platform's or device's name")
    add("--threads", metavar="N", type=int, help="CPU threads of the device (default: all)")
    add("--json", metavar="FILE", type=Path, help="also write all that was measured, frame by frame")
    experiments = parser.add_subparsers(dest="experiment", required=True)
    for name in EXPERIMENTS:
        add = experiments.add_parser(name, parents=[common]).add_argument
        add("--frames", metavar="A:B", type=frames, help="default: the scene's")
        add("--skip", metavar="N", type=whole(0), default=8, help="frames that do not count (default: %(default)s)")
    add = experiments.add_parser("static", parents=[common]).add_argument
    add("--reference-spp", metavar="N", type=whole(1), default=4096, help="of the reference (default: %(default)s)")
    return parser.parse_args(arguments)


def measure(arguments: Sequence[str] | None) -> None:
    """Run an experiment. Raises SceneError, SettingError, DeviceError, Error."""
    args = parse(arguments)
    usual = "cornell" if args.experiment == "static" else "atrium"
    scene = load_scene(args.scene or ROOT / "data" / usual / "scene.toml")
    if args.experiment == "static":
        text, found = static(scene, args)
    else:
        configurations = EXPERIMENTS[args.experiment]
        measured = sequence(configurations, scene, args)
        found = {c.name: summary(c, measured, args.skip) for c in configurations}
        text = report(found)
    print(text)
    if args.json:
        with atomic_path(args.json) as part:
            part.write_text(json.dumps({"experiment": args.experiment, "scene": scene.file, "found": found}, indent=1))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
