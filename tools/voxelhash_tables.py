"""Measure the voxels' cache beside the samples': the tables of section 5.1 of SampleCache, on this machine and on any scene.

    python tools/voxelhash_tables.py sequences --scene data/city/scene.toml --references DIR    as Fig. 12 and 13
    python tools/voxelhash_tables.py lod --scene data/atrium/scene.toml --references DIR        as Fig. 9
    python tools/voxelhash_tables.py settings --scene data/atrium/scene.toml --references DIR   what the settings trade

DIR holds frames of the same view and size, as `clcache render` names them, each of them true but for its noise:

    clcache render data/city/scene.toml --mono --size 640x360 --spp 256 --seed 1000 --frames 7:8 -o DIR

`sequences` renders two frames (`--slower`) for each of the scene's, so that its frame 14 shows what the reference's
frame 7 does. The temporal filter of section 4 is on top of all methods, as in the paper; `--temporal none` leaves it out. The
stages are the first hits, the cache's upkeep, shading, from cached light to the image, and the filter. `lod` holds
the time of one frame (`--still`), which must have a reference for there to be errors. `settings` changes one at a time.

Columns: relMSE is the mean over frames that have a reference, of `lod` that of the last one; the difference is the mean squared
one of radiance to the frame before. How it and times are taken stands in tools/measuring.py. Exit codes are those of
`clcache`: 1 where the work failed, 2 where what was given is wrong.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from measuring import (
    ROOT,
    TEMPORAL_PASSES,
    Configuration,
    Pictures,
    add_common,
    add_frames,
    chosen,
    counters_table,
    errors_table,
    exit_code,
    frame_range,
    ms,
    number,
    read_references,
    report,
    sequence,
    slowed,
    summary,
    whole,
    write_json,
)

from clcache import load_scene
from clcache.cli import Parser
from clcache.metrics import cpbd, relmse
from clcache.scene.model import Scene
from clcache.settings import TEMPORALS

STILL = 1_000_000  # frames for each of the scene's: the camera all but stands
SHARPNESS = {
    "relmse": relmse,
    "cpbd": lambda test, _: cpbd(test),
    "cpbd_reference": lambda _, reference: cpbd(reference),
}
# The stages of Fig. 13, and the passes that each has. Paths that end at a voxel are shading; what finds it is the cache's.
STAGES = {
    "first hits": (
        *("order", "generate", "trace_camera", "first_hits"),
        *("assess", "plan", "aim", "retrace", "settle"),
    ),
    "cache": (
        *("clear", "list", "project", "reserve", "copy", "importance", "choose", "accumulate"),
        *("ask", "address", "look_up", "claim", "inherit", "update"),
    ),
    "shading": ("begin", "shade", "trace", "shadow", "compact", "finish"),
    "resolve": ("list_visible", "address_seen", "find_seen", "answer", "resolve", "average", "color_sum", "color"),
    "filter": TEMPORAL_PASSES,
}


def samples(name: str, shading: str, rate: float) -> Configuration:
    """The sample cache, shading so many of a pixel's samples."""
    return Configuration(
        name,
        "samplecache",
        {"samplecache.shading": shading, "samplecache.shading_rate": rate},
        temporal="varianceblend",
    )


def voxels(name: str, method: str = "voxelhash", **settings: object) -> Configuration:
    """A method with a cache of voxels, and some of its settings."""
    own = {f"voxelhash.{key}": value for key, value in settings.items()}
    return Configuration(name, method, own, temporal="varianceblend")


def bare(configuration: Configuration) -> Configuration:
    """The same without a temporal filter."""
    return replace(configuration, name=f"{configuration.name}, unfiltered", temporal="none")


SEQUENCES = (
    Configuration("1spp", "pathtrace", temporal="varianceblend"),
    samples("samplecache", "uniform", 1.0),
    voxels("voxelhash"),
    voxels("hybrid", "hybrid"),
    samples("SC-adaptive", "adaptive", 0.7),
)
LOD = tuple(
    turned(c)
    for c in (
        samples("samplecache", "uniform", 1.0),
        voxels("distance", lod="distance"),
        voxels("incidence", lod="incidence"),
    )
    for turned in (bare, lambda c: c)
)
_CHANGES = {
    "no gate": {"gate": False},
    "level -1": {"level_bias": -1},
    "level +1": {"level_bias": 1},
    "level +2": {"level_bias": 2},
    "distance": {"lod": "distance"},
    "lifetime 4": {"lifetime": 4},
    "capacity 2^16": {"capacity": 2**16},
    "capacity 2^18": {"capacity": 2**18},
}
SETTINGS = (
    voxels("voxelhash"),
    voxels("no jitter", jitter=False),
    voxels("no inherit", inherit=False),
    *(voxels(name, **change) for name, change in _CHANGES.items()),
    voxels("hybrid", "hybrid"),
    *(voxels(f"hybrid, {name}", "hybrid", **change) for name, change in _CHANGES.items()),
)
EXPERIMENTS = {"sequences": SEQUENCES, "lod": LOD, "settings": SETTINGS}


def sequences(
    configurations: Sequence[Configuration], scene: Scene, args: argparse.Namespace
) -> tuple[str, dict[str, dict]]:
    """Errors and times of a walk through the scene: tables, and what they are of."""
    references = slower_references(args, scene)
    entries = sequence(configurations, slowed(scene, args.slower), args, references, {"relmse": relmse}, STAGES)
    found = {c.name: summary(c, entries[c.name], args.skip, ("relmse", "difference")) for c in configurations}
    errors = errors_table(found, "relmse", "relMSE")
    return report((overview(found), errors, passes_table(found), counters_table(found))), found


def slower_references(args: argparse.Namespace, scene: Scene) -> dict[int, Pictures]:
    """The references, each by the number of the frame that shows what it does."""
    first, last = frame_range(scene, args)
    numbers = range(-(-first // args.slower), -(-last // args.slower))
    found = read_references(args.references, numbers, args.size or scene.defaults.size)
    return {number * args.slower: pictures for number, pictures in found.items()}


def lod(configurations: Sequence[Configuration], scene: Scene, args: argparse.Namespace) -> tuple[str, dict[str, dict]]:
    """How steady and how sharp a still view is: tables, and what they are of."""
    known = read_references(args.references, [args.still], args.size or scene.defaults.size)
    first, length = args.still * STILL, args.length
    still = argparse.Namespace(**vars(args), frames=(first, first + length))
    frame_range(scene, still)
    references = {first + length - 1: known[args.still]} if known else {}
    entries = sequence(configurations, slowed(scene, STILL), still, references, SHARPNESS, STAGES)
    means = ("difference", *SHARPNESS)
    found = {c.name: summary(c, entries[c.name], args.skip, means) for c in configurations}
    rows = [
        [name, number(s["difference"]), number(s["relmse"]), *(number(s[k], ".3f") for k in means[2:]), ms(s["device"])]
        for name, s in found.items()
    ]
    return report(((["", "flicker", "relMSE", "CPBD", "reference's", "device ms"], rows), counters_table(found))), found


def overview(found: Mapping[str, dict]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: times by stage, paths, errors."""
    rows = [
        [name, ms(s["seconds"]), ms(slow(s, 0.95)), ms(s["device"]), *map(ms, s["stages"].values())]
        + [f"{s['rays'][kind] / 1e3:.1f}" for kind in ("primary", "secondary", "shadow")]
        + [number(s[key]) for key in ("relmse", "difference")]
        for name, s in found.items()
    ]
    kinds = ("primary k", "secondary k", "shadow k")
    return ["", "frame ms", "95 %", "device ms", *STAGES, *kinds, "relMSE", "difference"], rows


def slow(summarised: Mapping, part: float) -> float:
    """The seconds that this part of the frames does not exceed, the first ones among them."""
    return float(np.quantile([e["seconds"] for e in summarised["frames"]], part))


def passes_table(found: Mapping[str, dict]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: milliseconds by pass."""
    rows = [
        [step, stage, *(ms(s["passes"][step]) if step in s["passes"] else "" for s in found.values())]
        for stage, steps in STAGES.items()
        for step in steps
        if any(step in s["passes"] for s in found.values())
    ]
    return ["pass ms", "stage", *found], rows


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line. Raises SettingError."""
    form = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog=Path(__file__).name, description=__doc__, formatter_class=form)
    experiments = parser.add_subparsers(dest="experiment", required=True)
    own = {name: experiments.add_parser(name) for name in EXPERIMENTS}
    for name, part in own.items():
        add_common(part, "data/atrium")
        names = ", ".join(c.name for c in EXPERIMENTS[name])
        part.add_argument("--only", metavar="NAME", nargs="+", help=f"of {names} (default: all)")
        if name != "lod":
            add_frames(part, 8, "0:100" if name == "sequences" else "0:32")
            part.set_defaults(frames=(0, 100) if name == "sequences" else (0, 32))
            slower = 2 if name == "sequences" else 1
            part.add_argument(
                "--slower",
                metavar="N",
                type=whole(1),
                default=slower,
                help="frames for each of the scene's (default: %(default)s)",
            )
            part.add_argument("--temporal", choices=TEMPORALS, default="varianceblend", help="default: %(default)s")
    add = own["lod"].add_argument
    add("--still", metavar="N", type=whole(0), default=7, help="the frame that is held (default: %(default)s)")
    add("--length", metavar="N", type=whole(2), default=64, help="how often it is rendered (default: %(default)s)")
    add("--skip", metavar="N", type=whole(0), default=32, help="frames that do not count (default: %(default)s)")
    return parser.parse_args(arguments)


def measure(arguments: Sequence[str] | None) -> None:
    """Run an experiment. Raises SceneError, SettingError, DeviceError, Error."""
    args = parse(arguments)
    scene = load_scene(args.scene or ROOT / "data" / "atrium" / "scene.toml")
    configurations = chosen(EXPERIMENTS[args.experiment], args.only)
    if args.experiment == "lod":
        text, found = lod(configurations, scene, args)
    else:
        configurations = [replace(c, temporal=args.temporal) for c in configurations]
        text, found = sequences(configurations, scene, args)
    print(text)
    write_json(args.json, args.experiment, scene, found)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
