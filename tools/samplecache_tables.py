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

How times and differences are taken stands in tools/measuring.py.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from measuring import (
    ROOT,
    Configuration,
    add_common,
    add_frames,
    counters_table,
    errors_table,
    exit_code,
    frame_range,
    mean,
    ms,
    number,
    read_references,
    renderer,
    report,
    sequence,
    summary,
    table,
    whole,
    write_json,
)
from tqdm import tqdm

from clcache import SettingError, load_scene
from clcache.cli import Parser
from clcache.metrics import relmse
from clcache.output.files import atomic_path, check_target
from clcache.scene.model import Scene

STILL = 1e9  # frames per second: all frames show the start
CHECKPOINTS = (1, 4, 16, 64)  # samples per pixel of `static`
REFERENCE_SEED = 1000

# The stages of the paper's figures, and the passes that each has.
STAGES = {
    "reprojection": ("clear", "list", "project", "reserve", "copy"),
    "tracing": ("order", "generate", "trace_camera", "assess", "plan", "aim", "retrace", "settle"),
    "shading": (
        *("importance", "choose", "begin", "first_hits"),
        *("shade", "trace", "shadow", "compact", "finish", "accumulate"),
    ),
    "reconstruction": (
        *("list_visible", "resolve", "average", "moments", "describe", "aovs", "blend"),
        *("color_sum", "color"),
    ),
}
# The kinds of rays that a pass traces.
RAYS_OF = {"retrace": "primary", "trace_camera": "primary", "trace": "secondary", "shadow": "shadow"}


def cache(name: str, against: str | None = None, **settings: object) -> Configuration:
    """The sample cache with some of its settings."""
    return Configuration(name, "samplecache", {f"samplecache.{key}": value for key, value in settings.items()}, against)


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


def measured(configurations: Sequence[Configuration], scene: Scene, args: argparse.Namespace) -> dict[str, dict]:
    """What was found out about each configuration."""
    numbers = range(*frame_range(scene, args))
    references = read_references(args.references, numbers, args.size or scene.defaults.size)
    entries = sequence(configurations, scene, args, references, {"relmse": relmse}, STAGES)
    return {c.name: summarised(c, entries, args.skip) for c in configurations}


def summarised(configuration: Configuration, entries: dict[str, list[dict]], skip: int) -> dict:
    """A configuration's summary, with the rays of its passes and how it compares. entries: of all configurations."""
    own, against = entries[configuration.name], configuration.against
    found = summary(configuration, own, skip, ("relmse", "difference"))
    rays = {name: found["rays"][kind] for name, kind in RAYS_OF.items() if name in found["passes"]}
    ratios = compared(own, entries[against], skip) if against else {}
    return found | {"rays of passes": rays, "against": against, "ratios": ratios}


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


def tables(found: dict[str, dict]) -> str:
    """The tables: times by stage, rays and errors; ratios; errors of each frame; times by pass with its rays; counters."""
    errors = errors_table(found, "relmse", "relMSE")
    return report((_stages(found), _ratios(found), errors, _passes(found), counters_table(found)))


def _stages(found: dict[str, dict]) -> tuple[list[str], list[list[str]]]:
    kinds = ("primary", "secondary", "shadow")
    rows = [
        [name, ms(s["seconds"]), ms(s["device"]), *map(ms, s["stages"].values())]
        + [f"{s['rays'][kind] / 1e3:.1f}" for kind in kinds]
        + [number(s[key]) for key in ("relmse", "difference")]
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


def _passes(found: dict[str, dict]) -> tuple[list[str], list[list[str]]]:
    rows = []
    for step in dict.fromkeys(name for s in found.values() for name in s["passes"]):
        cells = []
        for s in found.values():
            seconds, rays = s["passes"].get(step), s["rays of passes"].get(step)
            cells.append("" if seconds is None else ms(seconds))
            cells.append("" if seconds is None or rays is None else f"{rays / 1e3:.1f}")
        rows.append([step, next(stage for stage, names in STAGES.items() if step in names), *cells])
    return ["pass", "stage", *(text for name in found for text in (f"{name} ms", "k rays"))], rows


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


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line. Raises SettingError."""
    own = {"prog": Path(__file__).name, "formatter_class": argparse.RawDescriptionHelpFormatter}
    parser, common = Parser(description=__doc__, **own), Parser(add_help=False)
    add_common(common, "data/atrium, of static data/cornell")
    experiments = parser.add_subparsers(dest="experiment", required=True)
    for name in EXPERIMENTS:
        add_frames(experiments.add_parser(name, parents=[common]), skip=8)
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
        found = measured(EXPERIMENTS[args.experiment], scene, args)
        text = tables(found)
    print(text)
    write_json(args.json, args.experiment, scene, found)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
