"""Measure the filters: the tables of "Practical temporal and stereoscopic filtering for real-time ray tracing" (Philippi, Frisvad, Jensen
2023), section 5, on this machine.

    python tools/varianceblend_tables.py temporal --scene data/fence/scene.toml --references DIR      section 5.1
    python tools/varianceblend_tables.py combined --scene data/spheres/scene.toml --references DIR    section 5.3

DIR holds frames of the same views and size, as `clcache render` names them, each of them true but for its noise:

    clcache render data/fence/scene.toml --mono --size 640x360 --spp 256 --seed 1000 --frames 7:8 -o DIR
    clcache render data/spheres/scene.toml --stereo --size 320x180 --spp 1024 --seed 1000 --frames 7:8 -o DIR

`temporal` renders one eye, `combined` two. The columns are means over the frames that have a reference: RMSE and SSIM of
linear RGB as the paper has them, SSIM of values clipped to [0, 1]; RMSE of clipped values, too, which fireflies do not
dominate; and SSIM of what a display shows. The differences are mean squared ones of radiance, to the frame before (flicker;
what moves in the scene counts, too) and between the eyes; the reference has the latter as well. Times are medians on
the device, of both eyes. How they and the differences are taken stands in tools/measuring.py. Exit codes are those of
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
    Metric,
    add_common,
    add_frames,
    chosen,
    errors_table,
    exit_code,
    frame_range,
    ms,
    number,
    read_references,
    report,
    sequence,
    summary,
    write_json,
)

from clcache import load_scene
from clcache.cli import Parser
from clcache.metrics import rmse, ssim
from clcache.scene.model import Scene
from clcache.settings import SETTINGS


def clipped(metric: Metric, **options: bool) -> Metric:
    """A metric of linear values that are clipped to [0, 1]."""
    return lambda test, reference: metric(np.clip(test, 0.0, 1.0), np.clip(reference, 0.0, 1.0), **options)


METRICS: dict[str, Metric] = {
    "rmse": rmse,
    "rmse_clipped": clipped(rmse),
    "ssim": clipped(ssim, encoded=True),
    "ssim_display": ssim,
}
COLUMNS = {
    "rmse": "RMSE",
    "rmse_clipped": "RMSE clipped",
    "ssim": "SSIM",
    "ssim_display": "SSIM display",
    "difference": "frame difference",
    "stereo": "stereo difference",
    "stereo_reference": "reference's",
}
FORMS = dict.fromkeys(METRICS, ".5f")
STAGES = {
    "paths": (
        *("order", "clear", "generate", "trace_camera", "shade", "trace", "shadow", "compact", "finish"),
        *("color_sum", "color"),
    ),
    "temporal": TEMPORAL_PASSES,
    "stereo": ("near", "stereo"),
}


def filtered(name: str, temporal: str, stereo_blend: str = "none", **settings: object) -> Configuration:
    """Path tracing and a filter. settings: of varianceblend or taa."""
    return Configuration(
        name,
        "pathtrace",
        {f"{temporal}.{key}": value for key, value in settings.items()},
        temporal=temporal,
        stereo_blend=stereo_blend,
    )


EXPERIMENTS = {
    "temporal": (
        filtered("1spp", "none"),
        filtered("taa-reject", "taa", validation="reject"),
        filtered("taa", "taa"),
        filtered("taa-clip", "taa", validation="clip"),
        filtered("taa-none", "taa", validation="none"),
        filtered("published", "varianceblend", estimate="published"),
        filtered("published-rgb", "varianceblend", estimate="published", per_channel=True),
        filtered("corrected", "varianceblend", estimate="corrected"),
        filtered("corrected-rgb", "varianceblend", estimate="corrected", per_channel=True),
    ),
    "combined": (
        filtered("none", "none"),
        filtered("temporal", "varianceblend"),
        filtered("temporal + stereo", "varianceblend", "varianceblend"),
        filtered("temporal + constant", "varianceblend", "constant"),
        filtered("stereo", "none", "varianceblend"),
    ),
}
SCENES = {"temporal": "fence", "combined": "spheres"}
# Those that an experiment has unless --only names others: the paper's.
USUAL = {
    "temporal": ("1spp", "taa-reject", "taa", "published", "corrected"),
    "combined": ("none", "temporal", "temporal + stereo"),
}


def measured(
    configurations: Sequence[Configuration], scene: Scene, args: argparse.Namespace, stereo: bool
) -> dict[str, dict]:
    """What was found out about each configuration."""
    numbers = range(*frame_range(scene, args))
    references = read_references(args.references, numbers, args.size or scene.defaults.size, stereo)
    entries = sequence(configurations, scene, args, references, METRICS, STAGES, stereo)
    means = (*METRICS, "difference", *(("stereo", "stereo_reference") if stereo else ()))
    return {c.name: summary(c, entries[c.name], args.skip, means) for c in configurations}


def tables(found: Mapping[str, dict]) -> str:
    """The tables: errors, differences and times; errors of each frame."""
    columns = {key: COLUMNS[key] for key in COLUMNS if any(key in s for s in found.values())}
    rows = [
        [name, *(number(s[key], FORMS.get(key, ".4e")) for key in columns), *map(ms, s["stages"].values())]
        for name, s in found.items()
    ]
    summaries = ["", *columns.values(), *(f"{stage} ms" for stage in STAGES)], rows
    return report((summaries, *(errors_table(found, key, COLUMNS[key]) for key in ("rmse", "ssim"))))


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line. Raises SettingError."""
    form = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog=Path(__file__).name, description=__doc__, formatter_class=form)
    experiments = parser.add_subparsers(dest="experiment", required=True)
    for experiment, configurations in EXPERIMENTS.items():
        own = experiments.add_parser(experiment)
        add_common(own, f"data/{SCENES[experiment]}")
        add_frames(own, skip=8)
        own.add_argument(
            "--only",
            metavar="NAME",
            nargs="+",
            default=USUAL[experiment],
            help=f"of {', '.join(c.name for c in configurations)} (default: {', '.join(USUAL[experiment])})",
        )
        own.add_argument(
            "--history",
            choices=SETTINGS["temporal.history"].choices,
            help="how histories are read (default: the setting's)",
        )
    return parser.parse_args(arguments)


def measure(arguments: Sequence[str] | None) -> None:
    """Run an experiment. Raises SceneError, SettingError, DeviceError, Error."""
    args = parse(arguments)
    scene = load_scene(args.scene or ROOT / "data" / SCENES[args.experiment] / "scene.toml")
    configurations = chosen(EXPERIMENTS[args.experiment], args.only)
    if args.history:
        configurations = [replace(c, settings={**c.settings, "temporal.history": args.history}) for c in configurations]
    found = measured(configurations, scene, args, args.experiment == "combined")
    print(tables(found))
    write_json(args.json, args.experiment, scene, found)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
