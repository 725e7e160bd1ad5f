"""Measure the memoization of material graphs: the tables of MaterialMemo's chapter 6, on this machine and on any scene with graphs.

    python tools/memo_scenes.py data/classroom/scene.toml -o CLASSROOM                 graphs that sample pictures
    python tools/memo_scenes.py data/classroom/scene.toml -o NOISE --kind compute      graphs of noise
    python tools/memo_scenes.py data/landscape/scene.toml -o LANDSCAPE
    python tools/memo_tables.py overall --scene CLASSROOM/scene.toml --scene LANDSCAPE/scene.toml

    overall    Table 6.1, Fig. 6.7, 6.8: no memoization, texels, nearest and bilinear tiles; * only where paths go on; memo.auto
    kinds      Fig. 6.10: on a scene of graphs that sample pictures and on one of noise
    storage    Fig. 6.11, 6.12: where tiles are stored, at several capacities, and by filter
    eviction   Table 6.2, Fig. 6.13: strategies, at a capacity of few frames and of hardly one
    history    Fig. 6.14: the hit rate of each frame, with and without eviction
    capacity   Table 6.3, Fig. 6.15: from 2^10 entries on
    probe      Fig. 6.16: places that are looked at
    tiles      Fig. 6.17: sizes of tiles, at the same number of texels
    builders   section 6.7.1: who builds tiles, and whether tiles of one graph are built together
    passes     section 6.7.2: frames in several passes, and the tiles that are built more than once
    quality    section 6.1: FLIP of what each variant shows and what is shown without, from the same random numbers
    compile    what the graphs' kernels take from document to driver, and a whole render until its first frame: cold and warm
    phases     the first half of that, in this process and as JSON

Frames are those of the scene's own motion, at one sample for each pixel unless --spp says more. All configurations of a table (of a
scene; of `storage` and `eviction`, of a capacity) render in turn, frame by frame, in one process. Frames at the start (--skip), in which
the cache fills, do not count. Frame times are the wall clock's medians, "materials" those of the passes that evaluate or look up; speed-up
is the sum of the frames without memoization over that of the frames with it. Capacities are entries: texels, or tiles. All graphs are
memoized (memo.auto false) but for "auto". Exit codes are those of `clcache`.
"""

import argparse
import csv
import gc
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from measuring import (
    Configuration,
    add_frames,
    add_machine,
    exit_code,
    frame_range,
    ms,
    number,
    renderer,
    size,
    table,
    whole,
)
from tqdm import tqdm

from clcache import SettingError, load_scene
from clcache.cli import Parser
from clcache.output.files import atomic_path, check_target
from clcache.scene.model import Scene
from clcache.settings import SETTINGS

MATERIALS = "materials"  # the passes that evaluate graphs or look values up
COUNTED = ("built", "duplicates", "distinct", "evicted", "discarded", "occupied")
OFF = Configuration("none", "pathtrace")
TEXELS = 1 << 21  # for which all caches have room, where nothing else is said


def choices(setting: str) -> tuple[str, ...]:
    """The values of a setting."""
    return SETTINGS[setting].choices


def texel(name: str, **settings: object) -> Configuration:
    """A cache of texels, and some of its settings."""
    return cached(name, "texel", settings)


def tile(name: str, **settings: object) -> Configuration:
    """A cache of tiles, and some of its settings."""
    return cached(name, "tile", settings)


def cached(name: str, kind: str, settings: Mapping[str, object]) -> Configuration:
    """A cache of all graphs, with room for TEXELS unless the settings say more."""
    width, height = map(int, str(settings.get("tile", "4x4")).split("x"))
    given = {"auto": False, "capacity": TEXELS // (width * height if kind == "tile" else 1), **settings}
    return Configuration(name, "pathtrace", {f"memo.{key}": value for key, value in given.items()}, memo=kind)


# ---------------------------------------------------------------------------------------------------------------------
# What is compared: groups of configurations that render in turn

# Entries for strategies of eviction: about what a frame of 320x180 pixels sees, of which a few frames see more, and half of that.
FULL = {"texel": (1 << 16, 1 << 15), "tile": (1 << 13, 1 << 12)}
MAKERS = {"texel": texel, "tile": tile}

KINDS = (OFF, texel("texel"), tile("tile nearest"), tile("tile bilinear", filter="bilinear"))
OVERALL = (
    *KINDS,
    *(replace(c, name=f"{c.name}*", settings={**c.settings, "memo.primary": False}) for c in KINDS[1:]),
    texel("texel auto", auto=True),
    tile("tile auto", auto=True),
)
STORAGE = tuple(
    (
        OFF,
        *(
            tile(f"{layout} 2^{bits} {kind}", layout=layout, capacity=1 << bits, filter=kind)
            for layout in choices("memo.layout")
        ),
    )
    for bits, kind in ((14, "nearest"), (16, "nearest"), (18, "nearest"), (16, "bilinear"))
)
EVICTION = tuple(
    (
        OFF,
        *(MAKERS[kind](f"{kind} {entries} {how}", eviction=how, capacity=entries) for how in choices("memo.eviction")),
    )
    for which in (0, 1)
    for kind, entries in ((kind, both[which]) for kind, both in FULL.items())
)
HISTORY = tuple(
    MAKERS[kind](f"{kind} {how}", eviction=how, capacity=entries)
    for kind, (entries, _) in FULL.items()
    for how in ("lru-frame", "none")
)
CAPACITY = (
    (OFF, *(texel(f"texel 2^{bits}", capacity=1 << bits) for bits in range(10, 23))),
    (OFF, *(tile(f"tile 2^{bits}", capacity=1 << bits) for bits in range(10, 19))),
)
PROBE = tuple(
    (OFF, *(MAKERS[kind](f"{kind} {probe}", probe=probe, capacity=entries) for probe in (1, 2, 4, 8, 16)))
    for kind, (entries, _) in FULL.items()
)
TILES = tuple(
    (OFF, *(tile(f"{shape} {kind}", tile=shape, filter=kind) for shape in choices("memo.tile")))
    for kind in choices("memo.filter")
)
BUILDERS = (
    (
        OFF,
        tile("serial", builder="serial"),
        tile("lanes", builder="lanes"),
        tile("lanes, grouped", builder="lanes", grouped=True),
    ),
)
PASSES = ((OFF, *(tile(f"passes {how}", passes=how) for how in choices("memo.passes"))),)
GROUPS = {
    "overall": (OVERALL,),
    "kinds": (KINDS,),
    "storage": STORAGE,
    "eviction": EVICTION,
    "history": (HISTORY,),
    "capacity": CAPACITY,
    "probe": PROBE,
    "tiles": TILES,
    "builders": BUILDERS,
    "passes": PASSES,
}
QUALITY = (
    texel("texel"),
    texel("texel, bias 1", bias=1.0),
    texel("texel unsnapped", snap=False),
    tile("tile nearest"),
    tile("tile bilinear", filter="bilinear"),
    texel("texel*", primary=False),
    tile("tile nearest*", primary=False),
    tile("tile bilinear*", filter="bilinear", primary=False),
)


@dataclass(frozen=True)
class Row:
    """What was measured of a configuration on a scene, of the frames that count. frames: all of them, each with `frame`, `seconds`,
    `materials` and the counters."""

    scene: str
    name: str
    frames: list[dict]
    skip: int

    @property
    def counted(self) -> list[dict]:
        """The frames that count."""
        return self.frames[self.skip :]

    def median(self, key: str) -> float:
        """Of a time or counter."""
        return statistics.median(frame[key] for frame in self.counted)

    def total(self, key: str) -> float:
        """Of a time or counter."""
        return sum(frame.get(key, 0) for frame in self.counted)

    @property
    def hit_rate(self) -> float | None:
        """Hits over lookups; None without memoization."""
        lookups = self.total("lookups")
        return self.total("hits") / lookups if lookups else None


# ---------------------------------------------------------------------------------------------------------------------
# Frames in turn


def measured(group: Sequence[Configuration], scenes: Sequence[Scene], args: argparse.Namespace) -> list[Row]:
    """Render all frames of the scenes by all configurations of a group in turn, of which another one begins each time."""
    both = [(scene, c) for scene in scenes for c in group]
    length = min(last - first for first, last in (frame_range(scene, args) for scene in scenes))
    running = []
    for scene, c in tqdm(both, desc="compile", disable=None):
        first, _ = frame_range(scene, args)
        running.append(renderer(c, scene, args, args.spp).frames(first, first + length))
    rows = [Row(scene_name(scene), c.name, [], args.skip) for scene, c in both]
    for turn in tqdm(range(length), unit="frame", disable=None):
        for place in range(len(both)):
            which = (place + turn) % len(both)
            rows[which].frames.append(of_frame(next(running[which]).stats))
    running.clear()
    gc.collect()  # the caches of a group are given back before those of the next one are made
    return rows


def of_frame(stats: Mapping) -> dict:
    """What counts of a frame's statistics."""
    eye = stats["eyes"]["mono"]
    counters = eye.get("memo", {})
    return {"frame": stats["frame"], "seconds": stats["seconds"], "materials": eye["passes"][MATERIALS], **counters}


def scene_name(scene: Scene) -> str:
    """The folder that a scene is in."""
    return Path(scene.file).resolve().parent.name


def compared(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of a group's table. A scene's rows are compared with its first one without memoization, if there is one."""
    heads = ["", "frame ms", "materials ms", "speed-up", "hit rate %", *(f"{key}/frame" for key in COUNTED)]
    lines = []
    for row in rows:
        off = next((r for r in rows if r.scene == row.scene and r.hit_rate is None), None)
        faster = "-" if off is None else f"{off.total('seconds') / row.total('seconds'):.2f}"
        rate = row.hit_rate
        counts = ["-" if rate is None else f"{row.median(key):.0f}" for key in COUNTED]
        times = [ms(row.median("seconds")), ms(row.median("materials"))]
        lines.append([f"{row.scene} {row.name}", *times, faster, "-" if rate is None else f"{100 * rate:.3f}", *counts])
    return heads, lines


def over_time(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: hit rate and time of each frame."""
    heads = ["frame", *(f"{r.scene} {r.name} {what}" for r in rows for what in ("%", "ms"))]
    lines = []
    for frames in zip(*(r.frames for r in rows), strict=True):
        cells = [(f"{100 * f['hits'] / max(f['lookups'], 1):.3f}", ms(f["seconds"])) for f in frames]
        lines.append([str(frames[0]["frame"]), *(text for cell in cells for text in cell)])
    return heads, lines


def rows_of(what: str, scenes: Sequence[Scene], args: argparse.Namespace) -> Iterator[tuple[str, Sequence, Sequence]]:
    """The tables of an experiment: name, heads, rows."""
    together = [scenes] if what == "kinds" else [[scene] for scene in scenes]
    for group in GROUPS[what]:
        for some in together:
            found = measured(group, some, args)
            heads, lines = compared(found)
            yield what, heads, lines
            if what == "history":
                yield "history by frame", *over_time(found)


# ---------------------------------------------------------------------------------------------------------------------
# Image quality


def quality(scene: Scene, args: argparse.Namespace) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: FLIP of a frame with memoization against the same frame without, and of one without from other random
    numbers."""
    flip = flip_metric()
    first, _ = frame_range(scene, args)
    reference = picture(OFF, scene, args, first, args.seed)
    lines = [
        ["none, other random numbers", f"{flip(reference, picture(OFF, scene, args, first, args.seed + 1)):.4f}", "-"]
    ]
    for c in tqdm(QUALITY, disable=None):
        shown = picture(c, scene, args, first, args.seed)
        squared = (shown - reference) ** 2 / (reference**2 + 0.01)
        lines.append([f"{scene_name(scene)} {c.name}", f"{flip(reference, shown):.4f}", number(float(squared.mean()))])
    return ["", "FLIP", "relMSE"], lines


def picture(c: Configuration, scene: Scene, args: argparse.Namespace, frame: int, seed: int) -> np.ndarray:
    """A frame, (H, W, 3)."""
    own = argparse.Namespace(**{**vars(args), "seed": seed})
    (found,) = renderer(c, scene, own, args.quality_spp).frames(frame, frame + 1)
    return found.color["mono"]


def flip_metric() -> Callable[[np.ndarray, np.ndarray], float]:
    """The mean of HDR-FLIP. Raises SettingError where flip-evaluator is not installed."""
    try:
        import flip_evaluator
    except ImportError:
        raise SettingError("quality: needs the package flip-evaluator; expected pip install flip-evaluator") from None

    def flip(reference: np.ndarray, test: np.ndarray) -> float:
        _, mean, _ = flip_evaluator.evaluate(np.ascontiguousarray(reference), np.ascontiguousarray(test), "HDR")
        return float(mean)

    return flip


# ---------------------------------------------------------------------------------------------------------------------
# Compilation


def compilation(scene: Scene, args: argparse.Namespace) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: seconds of each phase in a fresh process, and of a render of one frame from start to end, first with an empty cache of
    the driver and then with what that left."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"POCL_CACHE_DIR": folder, "PYOPENCL_NO_CACHE": "1"}
        environment["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
        columns = [in_process(scene, args, environment) for _ in ("cold", "warm", "warm again")]
    lines = [[phase, *(f"{column[phase]:.3f}" for column in columns)] for phase in columns[0]]
    return [scene_name(scene), "cold s", "warm s", "warm s"], lines


def in_process(scene: Scene, args: argparse.Namespace, environment: Mapping[str, str]) -> dict[str, float]:
    """Seconds by phase, each measured in a process of its own."""
    options = [
        *(["--device", args.device] if args.device else []),
        *(["--threads", str(args.threads)] if args.threads else []),
    ]
    phases = [sys.executable, __file__, "phases", "--scene", scene.file, *options]
    done = subprocess.run(phases, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SettingError(f"compile: {done.stderr.strip().splitlines()[-1]}")
    found = json.loads(done.stdout)
    for memo in ("off", "texel", "tile"):
        with tempfile.TemporaryDirectory() as out:
            width, height = args.size or scene.defaults.size
            command = [
                sys.executable,
                "-m",
                "clcache",
                "render",
                scene.file,
                "--mono",
                "--memo",
                memo,
                "--spp",
                "1",
                "-o",
                out,
            ]
            command += ["--size", f"{width}x{height}", "--frames", "0:1", *options]
            start = time.perf_counter()
            done = subprocess.run(command, env=environment, capture_output=True, text=True)
            found[f"clcache render --memo {memo}, one frame"] = time.perf_counter() - start
            if done.returncode:
                raise SettingError(f"compile: {done.stderr.strip().splitlines()[-1]}")
    return found


def phases(file: str, args: argparse.Namespace) -> dict[str, float]:
    """Seconds from the graphs' documents to their kernel, in this process, where nothing was read or built before."""
    from clcache.device import Device
    from clcache.graph import compile_graph, emit
    from clcache.graph.library import library
    from clcache.graph.text import read_text_form
    from clcache.resources import SceneResources
    from clcache.scene.files import Folder

    seconds, folder = {}, Path(file).resolve().parent

    def timed(phase: str, work: Callable[[], object]) -> object:
        start = time.perf_counter()
        result = work()
        seconds[phase] = seconds.get(phase, 0.0) + time.perf_counter() - start
        return result

    timed("library of nodes", library)
    read = []
    for path in sorted(folder.glob("*.graph")):
        read.append((path, timed("text form", lambda path=path: read_text_form(path, path.name, library()))))
    for path in sorted(folder.glob("*.mtlx")):
        from clcache.graph.mtlx import read_mtlx

        read.append((path, timed("MaterialX", lambda path=path: read_mtlx(path, path.name, None, Folder(folder)))))
    graphs = [timed("inference", lambda p=p, g=g: compile_graph(g, p, Folder(folder))) for p, g in read]
    timed("emission", lambda: emit(graphs))
    resources = SceneResources(device := Device(args.device, args.threads), load_scene(file))
    generated = {"graph/generated.cl": resources.graph_source}
    timed("driver's build", lambda: device.program("memo/evaluate.cl", generated, **resources.defines)["evaluate"])
    return seconds


# ---------------------------------------------------------------------------------------------------------------------
# The command line


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line. Raises SettingError."""
    form = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog=Path(__file__).name, description=__doc__, formatter_class=form)
    add = parser.add_argument
    add(
        "what",
        nargs="+",
        choices=(*GROUPS, "quality", "compile", "phases"),
        metavar="TABLE",
        help="one or more of those above",
    )
    add("--scene", dest="scenes", metavar="FILE", action="append", required=True, help="scene with graphs; repeatable")
    add("--size", metavar="WxH", type=size, default=(320, 180), help="default: 320x180")
    add("--spp", metavar="N", type=whole(1), default=1, help="samples for each pixel of a frame (default: %(default)s)")
    add("--quality-spp", metavar="N", type=whole(1), default=32, help="those of `quality` (default: %(default)s)")
    add_frames(parser, skip=8)
    add_machine(parser)
    add("--csv", metavar="DIR", type=Path, help="also write each table there, as NAME.csv")
    return parser.parse_args(arguments)


def tables_of(what: str, scenes: Sequence[Scene], args: argparse.Namespace) -> Iterator[tuple[str, Sequence, Sequence]]:
    """The tables of an experiment: name, heads, rows."""
    if what in GROUPS:
        yield from rows_of(what, scenes, args)
    else:
        for scene in scenes:
            yield what, *{"quality": quality, "compile": compilation}[what](scene, args)


def measure(arguments: Sequence[str] | None) -> None:
    """Run experiments. Raises SceneError, SettingError, DeviceError, Error."""
    args = parse(arguments)
    if args.what == ["phases"]:
        print(json.dumps(phases(args.scenes[0], args)))
        return
    scenes, written = [load_scene(file) for file in args.scenes], {}
    for scene in scenes:
        if not any(material.graph for material in scene.materials):
            raise SettingError(f"{scene.file}: no material has a graph; expected a scene as of tools/memo_scenes.py")
    for what in args.what:
        for name, heads, rows in tables_of(what, scenes, args):
            print(f"{name}\n{table(heads, rows)}\n", flush=True)
            written.setdefault((name, *heads), []).extend(rows)
            write_csv(args.csv, name, [r for (n, *_), r in written.items() if n == name], heads)


def write_csv(folder: Path | None, name: str, parts: Sequence[Sequence[Sequence[str]]], heads: Sequence[str]) -> None:
    """A table's file, whole, if that is wanted."""
    if folder:
        with (
            atomic_path(check_target(folder / f"{name.replace(' ', '_')}.csv")) as part,
            part.open("w", newline="") as stream,
        ):
            csv.writer(stream).writerows([heads, *(row for rows in parts for row in rows)])


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
