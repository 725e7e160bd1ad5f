"""Measure the octree's cache: the tables and figures of section 4 of OctreeCache, on this machine and on any scene.

    python tools/octree_tables.py table1 --scene data/kitchen/scene.toml        what each level takes, and what building it does
    python tools/octree_tables.py figure11 --scene data/kitchen/scene.toml --fps 47 --references DIR DIR    error by samples
    python tools/octree_tables.py figure13 …    error by the finest level
    python tools/octree_tables.py figure16 …    error of layered filtering, plain filtering and none, where the view counts
    python tools/octree_tables.py figure17 --scene data/kitchen/scene.toml      times by what is cached
    python tools/octree_tables.py figure18 --scene data/kitchen/scene.toml      times of each frame, beside path tracing

The frames are a fly-through: `--fps` says at which times of the scene they lie. In all of them the octree goes on with what the
frames before left; errors are of those frames that have references (figures 13 and 16: of the last of these). Each DIR holds frames of that view and size, by a seed of its own:

    clcache render data/kitchen/scene.toml --mono --size 320x180 --fps 47 --spp 2048 --seed 101 --frames 10:11 -o DIR

relMSE is the mean over frames that have a reference; of several references it is without their noise, and its standard error is over blocks of
pixels (tools/noisy_references.py), as if frames were independent. Path tracing's error falls as 1/N: by that law, from the most samples that
were measured (`--pathtrace`), follow the errors that are said to be "by 1/N", and with how many samples path tracing would have an octree's
error. MS-SSIM is against the mean of the references; that of the references themselves is the first one's against the mean of the
others.

Times are of the device by pass, medians over the frames that --skip leaves. Passes are of the caching, the reconstruction, or of
both. Exit codes are those of `clcache`: 1 where the work failed, 2 where what was given is wrong.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from measuring import (
    ROOT,
    Configuration,
    add_machine,
    alternating,
    center_hits,
    exit_code,
    frame_range,
    frames,
    median,
    ms,
    number,
    read_references,
    renderer,
    report,
    size,
    whole,
    write_json,
)
from noisy_references import Errors, block_means, mean_and_error, quotient, squared_error
from tqdm import tqdm

from clcache import Error, Renderer, SettingError, Tracer, load_scene
from clcache.bvh.tracer import MISS
from clcache.cli import Parser
from clcache.device import Device
from clcache.metrics import ms_ssim
from clcache.renderer import Frame
from clcache.resources import eyes_of
from clcache.scene.geometry import Geometry
from clcache.scene.model import Camera, Material, Scene
from clcache.settings import find

STAGES = ("caching", "reconstruction")  # how the passes' names begin, before a dot
CELL_BYTES = 24
BUCKET_BYTES = 4 * 8
PAPER_HASH_BYTES = 4.4  # for each cell: 4 bytes, and the space factor 1.1
# Table 1 of the paper: densities by level of Country Kitchen, up to 4096^3, and of Streets of Asia, up to 2048^3.
PAPER_DENSITY = {
    "Country Kitchen": (1, 0.5, 0.375, 0.193, 0.124, 0.070, 0.038, 0.023, 0.012, 0.006, 0.003, 0.002, 0.001),
    "Streets of Asia": (1, 0.5, 0.266, 0.197, 0.135, 0.074, 0.043, 0.025, 0.014, 0.008, 0.004, 0.003),
}
GOALS = {8: 512, 64: 4096}  # samples of the octree, and those of path tracing that shall not have less error
SMOOTH = 0.3  # below this roughness, what a surface reflects follows the view


def octree(name: str, settings: Mapping[str, object], **own: object) -> Configuration:
    """The octree with some settings, of which its own count first."""
    return Configuration(name, "octree", {**settings, **{f"octree.{key}": value for key, value in own.items()}})


# ---------------------------------------------------------------------------------------------------------------------
# References and frames


def known_references(args: argparse.Namespace, scene: Scene) -> dict[int, list[np.ndarray]]:
    """The references of each frame that all folders have, one of each folder. Raises SettingError where there is none."""
    first, last = frame_range(scene, args)
    found = [read_references(folder, range(first, last), picture_size(args, scene)) for folder in args.references]
    numbers = sorted(set.intersection(*(set(of) for of in found)))
    if not numbers:
        folders = ", ".join(map(str, args.references))
        raise SettingError(f"{folders}: no frame of {first}:{last} is in all of them; expected the same frames")
    return {n: [of[n]["mono"] for of in found] for n in numbers}


def picture_size(args: argparse.Namespace, scene: Scene) -> tuple[int, int]:
    """Width and height."""
    return args.size or scene.defaults.size


def of_references(references: Mapping[int, Sequence[np.ndarray]]) -> dict[int, float]:
    """MS-SSIM of each frame's first reference against the mean of the others; nothing where there is but one."""
    return {n: ms_ssim(known[0], np.mean(known[1:], axis=0)) for n, known in references.items() if len(known) > 1}


def fly_through(running: Renderer, first: int, last: int, numbers: Sequence[int], name: str) -> Iterator[Frame]:
    """The frames from first to last - 1; of a method without a cache only those of these numbers, as no other counts."""
    ranges = [(first, last)] if running.has_state else [(n, n + 1) for n in numbers]
    total = sum(b - a for a, b in ranges)
    with tqdm(total=total, unit="frame", desc=name, disable=None) as progress:
        for a, b in ranges:
            for frame in running.frames(a, b):
                yield frame
                progress.update()


def compared(
    configuration: Configuration,
    spp: int,
    scene: Scene,
    args: argparse.Namespace,
    references: Mapping[int, Sequence[np.ndarray]],
) -> tuple[Errors, dict]:
    """Render the fly-through up to the last frame that has a reference: errors, and what there is to say of it."""
    running = renderer(configuration, scene, args, spp)
    errors, shown = Errors(), []
    first = frame_range(scene, args)[0]
    for frame in fly_through(running, first, max(references) + 1, sorted(references), configuration.name):
        shown.append(of_frame(frame))
        if frame.number in references:
            errors.add(frame.number, frame.color["mono"], references[frame.number])
    stats = running.stats()
    entry = {
        "method": configuration.method,
        "settings": dict(configuration.settings),
        "spp": spp,
        "seconds": median(e["seconds"] for e in shown),
        "stages": {stage: median(e["stages"][stage] for e in shown) for stage in shown[0]["stages"]},
        "cache_bytes": stats["memory"]["cache"],
        "cache": shown[-1]["cache"],
        **errors.entry(),
    }
    return errors, entry


def of_frame(frame: Frame) -> dict:
    """What counts of a frame's statistics."""
    eye = frame.stats["eyes"]["mono"]
    return {
        "frame": frame.number,
        "seconds": frame.stats["seconds"],
        "passes": eye["passes"],
        "stages": by_prefix(eye["passes"]),
        "rays": eye["rays"],
        "cache": eye["cache"],
    }


def by_prefix(passes: Mapping[str, float]) -> dict[str, float]:
    """Seconds of each stage, of all other passes as `both`, and of all passes as `device`. passes: seconds by pass."""
    sums = dict.fromkeys((*STAGES, "both"), 0.0)
    for name, seconds in passes.items():
        prefix = name.partition(".")[0]
        sums[prefix if prefix in STAGES else "both"] += seconds
    return sums | {"device": sum(passes.values())}


# ---------------------------------------------------------------------------------------------------------------------
# Table 1


def table1(scene: Scene, args: argparse.Namespace) -> tuple[list, dict]:
    """Cells and memory by level, and what the builds took; each resolution is built in a process of its own."""
    found = {resolution: built_apart(args, resolution) for resolution in args.resolutions}
    parts = [levels_table(f"{resolution}^3", built) for resolution, built in found.items()]
    return [*parts, builds_table(found)], found


def built_apart(args: argparse.Namespace, resolution: int) -> dict:
    """What `built` says in a process of its own."""
    machine = [
        *(["--device", args.device] if args.device else []),
        *(["--threads", str(args.threads)] if args.threads else []),
    ]
    command = [sys.executable, __file__, "built", "--scene", args.scene, "--resolution", str(resolution), *machine]
    package = str(Path(__file__).resolve().parents[1])
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([package, os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"ended with exit code {done.returncode}"]
        raise Error(f"octree.resolution {resolution}: {lines[-1]}")
    return json.loads(done.stdout)


def built(scene: Scene, args: argparse.Namespace) -> dict:
    """Build the octree alone, in this process: its report; seconds of a first build, with kernels to compile, and of a second; bytes that the
    process had before, and at most."""
    from clcache.octree import Octree

    device, geometry = Device(args.device, args.threads), Geometry.of(scene)
    is_static, eyes = np.array([not i.motion for i in scene.instances]), eyes_of(scene)
    Octree(device, geometry, is_static, min(args.resolution, 64), eyes)  # whose kernels are then there
    before, start = peak_memory(), time.perf_counter()
    tree = Octree(device, geometry, is_static, args.resolution, eyes)
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


def check_law(tree) -> None:
    """Raise Error where what the levels take is not 24 bytes for each cell, and 32 for each bucket."""
    levels = tree.report()["levels"]
    for level in levels:
        if level["data_bytes"] != CELL_BYTES * level["cells"]:
            raise Error(f"level {level['level']}: {level['data_bytes']} bytes; expected {CELL_BYTES} for each cell")
    first, buckets = tree.arrays["octree_tables"].get()[:, :2].astype(np.int64).T
    buckets = int(buckets[first > 0].sum())  # the first one is that of tables without cells
    if sum(level["hash_bytes"] for level in levels) != BUCKET_BYTES * buckets:
        raise Error(f"the tables' {buckets} buckets take other than {BUCKET_BYTES} bytes each")


def levels_table(name: str, found: Mapping) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: cells, density and memory by level, beside the paper's."""
    heads = ["level", name, "cells", "density", "data", "hash", "hash B/cell", "paper's hash"]
    heads += [f"density of {scene}" for scene in PAPER_DENSITY]
    rows = [
        [
            str(level["level"]),
            str(2 ** level["level"]),
            str(level["cells"]),
            f"{level['density']:.6f}",
            in_bytes(level["data_bytes"]),
            in_bytes(level["hash_bytes"]),
            f"{level['hash_bytes'] / max(level['cells'], 1):.2f}",
            in_bytes(PAPER_HASH_BYTES * level["cells"]),
            *(paper_density(scene, level["level"]) for scene in PAPER_DENSITY),
        ]
        for level in found["levels"]
    ]
    cells, data, tables = (
        sum(level[key] for level in found["levels"]) for key in ("cells", "data_bytes", "hash_bytes")
    )
    total = ["sum", "", str(cells), "", in_bytes(data), in_bytes(tables), f"{tables / max(cells, 1):.2f}"]
    return heads, [*rows, [*total, in_bytes(PAPER_HASH_BYTES * cells), *("" for _ in PAPER_DENSITY)]]


def paper_density(scene: str, level: int) -> str:
    """The paper's density of a level, in words."""
    known = PAPER_DENSITY[scene]
    return f"{known[level]:.3f}" if level < len(known) else "-"


def builds_table(found: Mapping[int, Mapping]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: seconds by step, and memory, of each resolution."""
    steps = list(dict.fromkeys(step for one in found.values() for step in one["seconds"]))
    heads = [
        "build",
        "s",
        *(f"{step} s" for step in steps),
        "attempts",
        "space factor",
        "kept",
        "before",
        "peak",
    ]
    rows = []
    for resolution, one in found.items():
        rows.append(
            [
                str(resolution),
                f"{one['elapsed']:.3f}",
                *(f"{one['seconds'].get(step, 0.0):.3f}" for step in steps),
                *(str(one["attempts"]), f"{one['space_factor']:.3f}"),
                *(in_bytes(one[key]) for key in ("kept_bytes", "before_bytes", "peak_bytes")),
            ]
        )
    return heads, rows


def in_bytes(count: float) -> str:
    """A number of bytes, in words."""
    for unit in ("B", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.4g} {unit}"
        count /= 1024
    return f"{count:.3f} GiB"


# ---------------------------------------------------------------------------------------------------------------------
# Errors: Fig. 11, 13 and 16


def figure11(scene: Scene, args: argparse.Namespace) -> tuple[list, dict]:
    """Error by samples, of path tracing and of the octree."""
    references, measured, errors = known_references(args, scene), {}, {}
    traced = [(Configuration(f"pathtrace {n}", "pathtrace"), n) for n in args.pathtrace]
    cached = [(octree(f"octree {n}", args.settings), n) for n in args.octree]
    for c, spp in (*traced, *cached):
        errors[c.name], measured[c.name] = compared(c, spp, scene, args, references)
    rows = [errors_row(name, entry) for name, entry in measured.items()]
    by_law, told = {}, []
    if args.pathtrace:
        most = max(args.pathtrace)
        best = errors[f"pathtrace {most}"]
        goals = [n for n in GOALS.values() if n not in args.pathtrace]
        by_law = {f"pathtrace {n}, by 1/N of {most}": best.scaled(n / most).entry() for n in goals}
        told = [equal_row(n, quotient(best, errors[f"octree {n}"]), most) for n in args.octree]
    rows += [[name, *relmse_cells(entry), "-", "-", "-", "-"] for name, entry in by_law.items()]
    similar = of_references(references)
    rows += [["references", "-", "-", f"{statistics.fmean(similar.values()):.4f}", "-", "-", "-"]] if similar else []
    heads = ["octree", "as pathtrace at, by 1/N", "std. error", "goal", ""]
    tables = [(ERRORS, rows), (heads, told), *errors_by_frame(measured)]
    return tables, {"measured": measured, "by 1/N": by_law, "references": similar, "equal": told}


def equal_row(samples: int, times: tuple[float, float], traced: int) -> list[str]:
    """With how many samples path tracing would have the error of the octree with these, the standard error of that, and how a goal
    stands, two standard errors being what is sure. times: how often the octree's error goes into that of path tracing, and the standard
    error."""
    equal, error = (traced * value for value in times)
    row = [str(samples), f"{equal:.0f}", f"{error:.0f}"]
    if samples not in GOALS:
        return [*row, "-", ""]
    goal = GOALS[samples]
    unsure = ", within the error" if abs(equal - goal) < 2 * error else ""
    return [*row, str(goal), ("met" if equal >= goal else "missed") + unsure]


ERRORS = ["samples", "relMSE", "std. error", "MS-SSIM", "frame ms", "caching ms", "reconstruction ms"]


def relmse_cells(entry: Mapping) -> list[str]:
    """relMSE and its standard error, in words."""
    return [number(entry["relmse"]), number(entry["standard_error"], ".1e")]


def errors_row(name: str, entry: Mapping) -> list[str]:
    """Name, errors and times of a configuration."""
    similarity = number(entry["ms_ssim"], ".4f")
    return [
        name,
        *relmse_cells(entry),
        similarity,
        ms(entry["seconds"]),
        *(ms(entry["stages"][stage]) for stage in STAGES),
    ]


def errors_by_frame(found: Mapping[str, Mapping]) -> list[tuple[list[str], list[list[str]]]]:
    """Tables of relMSE and MS-SSIM of each frame."""
    tables = []
    for label, key, form in (
        ("relMSE", "relmse", ".3e"),
        ("std. error", "standard_error", ".0e"),
        ("MS-SSIM", "ms_ssim", ".4f"),
    ):
        rows = [
            [str(frames[0]["frame"]), *(number(f[key], form) for f in frames)]
            for frames in zip(*(entry["errors_by_frame"] for entry in found.values()), strict=True)
        ]
        tables.append(([f"{label} of frame", *found], rows))
    return tables


def figure13(scene: Scene, args: argparse.Namespace) -> tuple[list, dict]:
    """Error by the finest level, filtered and not."""
    references, found = known_references(args, scene), {}
    for resolution in args.resolutions:
        settings = args.settings | {"octree.resolution": resolution}
        readings = [
            octree(f"{resolution}^3", settings),
            octree(f"{resolution}^3, unfiltered", settings, filter="none"),
        ]
        found |= read_back(octree(f"{resolution}^3", settings), readings, scene, args, references)
    return [by_part_table(found)], found


FILTERS = {
    "layered": {"filter": "bilateral", "layered": True},
    "plain": {"filter": "bilateral", "layered": False},
    "none": {"filter": "none"},
}


def figure16(scene: Scene, args: argparse.Namespace) -> tuple[list, dict]:
    """Error of layered filtering, plain filtering and none."""
    readings = [octree(name, args.settings, **own) for name, own in FILTERS.items()]
    found = read_back(octree("filling", args.settings), readings, scene, args, known_references(args, scene))
    return [by_part_table(found)], found


def read_back(
    filling: Configuration,
    readings: Sequence[Configuration],
    scene: Scene,
    args: argparse.Namespace,
    references: Mapping[int, Sequence[np.ndarray]],
) -> dict[str, dict]:
    """Fill a cache by the fly-through up to the last frame that has a reference, and read that frame from it by several settings, each by so
    many reconstructions, without caching: errors, by name and number."""
    last, first = max(references), frame_range(scene, args)[0]
    running = renderer(filling, scene, args, args.spp)
    for _ in fly_through(running, first, last, (), filling.name):
        pass
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        running.save(state := Path(folder) / "state.npz")
        for c in readings:
            for count in args.reconstructions:
                c = replace(c, settings={**c.settings, "octree.caching_resolution": 0.0})
                reading = renderer(c, scene, args, count)
                reading.warm_start(state)
                (frame,) = reading.frames(last, last + 1)
                known = {"settings": dict(c.settings), "cache_bytes": reading.stats()["memory"]["cache"], "spp": count}
                found[f"{c.name}, {count}"] = known | by_part(scene, frame, references[last])
    return found


def by_part(scene: Scene, frame: Frame, references: Sequence[np.ndarray]) -> dict:
    """Errors of a frame: of all pixels, of those whose first hits follow the view, and of the rest."""
    color, camera = frame.color["mono"], frame.cameras["mono"]
    mask = follows_view(scene, camera, color.shape)
    error = squared_error(color, references)
    parts = {"all": None, "view": mask, "rest": ~mask}
    return {
        "share": float(mask.mean()),
        "ms_ssim": ms_ssim(color, np.mean(references, axis=0)),
        **{key: of_part(error, part) for key, part in parts.items()},
        **of_frame(frame),
    }


def of_part(error: np.ndarray, part: np.ndarray | None) -> dict[str, float | None]:
    """relMSE of a part of a picture, and its standard error; None where there is no such part."""
    found = (None, None) if part is not None and not part.any() else mean_and_error(*block_means(error, part))
    return dict(zip(("relmse", "standard_error"), found, strict=True))


def by_part_table(found: Mapping[str, Mapping]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: errors of the parts of the picture, by settings and reconstructions."""
    share = next(iter(found.values()))["share"]
    heads = ["reconstructions", "relMSE", "std. error", f"glossy and glass, {share:.0%}", "std. error"]
    heads += ["the rest", "std. error", "MS-SSIM", "reconstruction ms each", "hits %", "cache"]
    rows = [
        [name, *(cell for part in ("all", "view", "rest") for cell in relmse_cells(e[part]))]
        + [f"{e['ms_ssim']:.4f}", ms(e["stages"]["reconstruction"] / e["spp"])]
        + [f"{100 * e['cache']['hits'] / max(e['cache']['lookups'], 1):.2f}", in_bytes(e["cache_bytes"])]
        for name, e in found.items()
    ]
    return heads, rows


def follows_view(scene: Scene, camera: Camera, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) bool: whether what a pixel's first hit shows follows the view; at its centre, of the scene at its start, and without
    alpha masks."""
    hits = center_hits(Tracer(scene), camera, shape)
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
# Times: Fig. 17 and 18


def figure17(scene: Scene, args: argparse.Namespace) -> tuple[list, dict]:
    """Times and updated cells by caching resolution, and by how many vertices store light of how many bounces."""
    found = {}
    for store, length in args.store:
        for part in args.caching_resolutions:
            own = {"store": store, "length": length, "caching_resolution": part, "resolution": args.resolution}
            c = octree(f"{store}, {length}, {part:g}", args.settings, **own)
            found[c.name] = {"settings": dict(c.settings)} | measured(c, scene, args)
    stages = [*STAGES, "both"]
    heads = ["store, length, resolution", "frame ms", *(f"{stage} ms" for stage in stages)]
    heads += ["vertices", "cells updated", "secondary k", "shadow k"]
    rows = [
        [name, ms(e["seconds"]), *(ms(e["stages"][stage]) for stage in stages)]
        + [f"{e['cache']['inserted']:.0f}", str(e["updated"])]
        + [f"{e['rays'][kind] / 1e3:.0f}" for kind in ("secondary", "shadow")]
        for name, e in found.items()
    ]
    return [(heads, rows), passes_table(found)], found


def measured(c: Configuration, scene: Scene, args: argparse.Namespace) -> dict:
    """Medians over the frames that count, and the cells of all levels that the last one updated."""
    running = renderer(c, scene, args)
    first, last = frame_range(scene, args)
    shown, before = [], None
    for frame in fly_through(running, first, last, (), c.name):
        shown.append(of_frame(frame))
        if frame.number == last - 2:
            before = cells(running)
    updated = None if before is None else int((cells(running) != before).any(axis=1).sum())
    counted = shown[args.skip :]
    medians = {
        key: {name: median(e[key][name] for e in counted) for name in counted[0][key]}
        for key in ("passes", "stages", "rays", "cache")
    }
    return {"seconds": median(e["seconds"] for e in counted), **medians, "updated": updated, "frames": shown}


def cells(running: Renderer) -> np.ndarray:
    """(cells, 6) uint32: what the cells hold now."""
    return running._graph.of()["octree_cells"].get()


def passes_table(found: Mapping[str, dict]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: milliseconds by pass."""
    names = dict.fromkeys(name for e in found.values() for name in e["passes"])
    rows = [
        [name, *(ms(e["passes"][name]) if name in e["passes"] else "" for e in found.values())]
        for name in names
        if any(e["passes"].get(name) for e in found.values())
    ]
    return ["pass ms", *found], rows


def figure18(scene: Scene, args: argparse.Namespace) -> tuple[list, dict]:
    """Times of each frame of path tracing, and of the octree's stages; then of frames that only reconstruct, beside path tracing."""
    traced, cached = Configuration("pathtrace", "pathtrace"), octree("octree", args.settings)
    first, last = frame_range(scene, args)
    running = {c.name: renderer(c, scene, args) for c in (traced, cached)}
    shown = together(running, first, last)
    with tempfile.TemporaryDirectory() as folder:
        running["octree"].save(state := Path(folder) / "state.npz")
        reading = renderer(octree("read", args.settings, caching_resolution=0), scene, args)
        reading.warm_start(state)
    running |= {"octree": reading}
    reads = together(running, first, last)
    steps = {
        "path tracing": [e["stages"]["device"] for e in shown["pathtrace"]],
        **{stage: [e["stages"][stage] for e in shown["octree"]] for stage in (*STAGES, "both")},
        "frame, path tracing": [e["seconds"] for e in shown["pathtrace"]],
        "frame, octree": [e["seconds"] for e in shown["octree"]],
        "frame, octree that only reads": [e["seconds"] for e in reads["octree"]],
    }
    pairs = {
        "caching / path tracing": (steps["caching"], steps["path tracing"]),
        "reconstruction / path tracing": (steps["reconstruction"], steps["path tracing"]),
        "frames that only read / path-traced": (
            steps["frame, octree that only reads"],
            [e["seconds"] for e in reads["pathtrace"]],
        ),
    }
    counted = {name: values[args.skip :] for name, values in steps.items()}
    ratios = {
        name: [a / b for a, b in zip(above[args.skip :], below[args.skip :], strict=True)]
        for name, (above, below) in pairs.items()
    }
    rows = [[name, *map(ms, quartiles(values))] for name, values in counted.items()]
    told = [[name, *(f"{v:.2f}" for v in quartiles(values))] for name, values in ratios.items()]
    spread = ["lower quartile", "median", "upper quartile", "most"]
    found = {"frames": shown, "reading": reads, "ratios": {name: quartiles(v) for name, v in ratios.items()}}
    by_pass = {name: {"passes": median_passes(e[args.skip :])} for name, e in shown.items()}
    return [(["ms", *spread], rows), (["ratio", *spread], told), passes_table(by_pass)], found


def together(running: Mapping[str, Renderer], first: int, last: int) -> dict[str, list[dict]]:
    """What was measured of each frame, by renderer; these take turns."""
    shown: dict[str, list[dict]] = {name: [] for name in running}
    for turn in alternating(running, first, last):
        for name, frame in turn.items():
            shown[name].append(of_frame(frame))
    return shown


def median_passes(entries: Sequence[Mapping]) -> dict[str, float]:
    """The median of each pass."""
    return {name: median(e["passes"][name] for e in entries) for name in entries[0]["passes"]}


def quartiles(values: Sequence[float]) -> list[float]:
    """The lower quartile, the median, the upper quartile, and the most."""
    return np.quantile(values, [0.25, 0.5, 0.75, 1.0]).tolist()


# ---------------------------------------------------------------------------------------------------------------------
# The command line

BUILT = "built"
EXPERIMENTS = {
    "table1": table1,
    "figure11": figure11,
    "figure13": figure13,
    "figure16": figure16,
    "figure17": figure17,
    "figure18": figure18,
}
SKIPPED = 8  # frames in which the cache fills and kernels are first launched; of times


def add_scene(parser: argparse.ArgumentParser) -> None:
    """The scene, the machine, and where results go."""
    add = parser.add_argument
    add("--scene", metavar="FILE", default=str(ROOT / "data" / "kitchen" / "scene.toml"), help="default: data/kitchen")
    add_machine(parser)
    add("--json", metavar="FILE", type=Path, help="also write all that was measured, frame by frame")


def add_sequence(parser: argparse.ArgumentParser, skip: int = 0) -> None:
    """What a fly-through is."""
    add_scene(parser)
    add = parser.add_argument
    add("--size", metavar="WxH", type=size, help="default: the scene's")
    add("--fps", metavar="N", type=rate, help="frame n shows the scene at n / N seconds (default: the scene's)")
    add("--frames", metavar="A:B", type=frames, default=(0, 100), help="default: 0:100")
    parser.set_defaults(skip=skip)
    add(
        "--set",
        dest="assigned",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="a setting of the octree's renders, where no other option says it; repeatable",
    )


def add_references(parser: argparse.ArgumentParser) -> None:
    """Where references are."""
    parser.add_argument(
        "--references", metavar="DIR", type=Path, nargs="+", required=True, help="folders of independent references"
    )


def rate(text: str) -> float:
    """Frames per second."""
    try:
        found = float(text)
    except ValueError:
        found = 0.0
    if not 0.01 <= found <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}: expected frames per second, 0.01 .. 1000000")
    return found


def pair(text: str) -> tuple[int, int]:
    """How many vertices store light, and of how many bounces."""
    store, _, length = text.partition(",")
    return whole(1)(store), whole(0)(length)


def part(text: str) -> float:
    """A caching resolution."""
    return find("octree.caching_resolution").parse(text)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line. Raises SettingError."""
    form = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog=Path(__file__).name, description=__doc__, formatter_class=form)
    experiments = parser.add_subparsers(dest="experiment", required=True)
    own = {name: experiments.add_parser(name) for name in EXPERIMENTS}
    several = {"type": whole(1), "nargs": "+", "metavar": "N"}
    add_scene(own["table1"])
    own["table1"].add_argument("--resolutions", **several, default=[1024, 2048, 4096], help="default: 1024 2048 4096")
    for name in ("figure11", "figure13", "figure16"):
        add_sequence(own[name])
        add_references(own[name])
    own["figure11"].add_argument(
        "--pathtrace", **several, default=[1, 8, 64, 512], help="samples (default: 1 8 64 512)"
    )
    own["figure11"].add_argument("--octree", **several, default=[1, 8, 64], help="samples (default: 1 8 64)")
    own["figure13"].add_argument("--resolutions", **several, default=[256, 512, 1024, 2048], help="default: 256 … 2048")
    for name in ("figure13", "figure16"):
        add = own[name].add_argument
        add("--spp", metavar="N", type=whole(1), default=1, help="updates for each frame (default: %(default)s)")
        add("--reconstructions", **several, default=[1, 128], help="of the last frame (default: 1 128)")
    for name in ("figure17", "figure18"):
        add_sequence(own[name], SKIPPED)
        own[name].add_argument(
            "--skip", metavar="N", type=whole(1), help=f"frames that do not count (default: {SKIPPED})"
        )
    add = own["figure17"].add_argument
    add("--resolution", metavar="N", type=int, default=2048, help="cells of the finest level (default: %(default)s)")
    add("--store", metavar="N,N", type=pair, nargs="+", default=[(1, 1), (3, 3), (8, 8)], help="default: 1,1 3,3 8,8")
    usual = [0.25, 0.5, 0.75, 1.0]
    add("--caching-resolutions", metavar="X", type=part, nargs="+", default=usual, help="default: 0.25 0.5 0.75 1")
    alone = experiments.add_parser(BUILT, help="one build of table1, in this process and as JSON")
    add_scene(alone)
    alone.add_argument("--resolution", metavar="N", type=int, required=True)
    return parser.parse_args(arguments)


def assignments(texts: Sequence[str]) -> dict[str, object]:
    """Settings by name, of KEY=VALUE. Raises SettingError."""
    found = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise SettingError(f"--set {text}: expected KEY=VALUE, such as octree.samples=8")
        found[name] = find(name).parse(value)
    return found


def measure(arguments: Sequence[str] | None) -> None:
    """Run an experiment. Raises SceneError, SettingError, DeviceError, Error."""
    args = parse(arguments)
    scene = load_scene(args.scene)
    if args.experiment == BUILT:
        print(json.dumps(built(scene, args)))
        return
    if args.experiment != "table1":
        args.settings = assignments(args.assigned)
        scene = replace(scene, defaults=replace(scene.defaults, fps=args.fps or scene.defaults.fps))
    tables, found = EXPERIMENTS[args.experiment](scene, args)
    print(report(tables))
    write_json(args.json, args.experiment, scene, found)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit code."""
    return exit_code(Path(__file__).stem, lambda: measure(arguments))


if __name__ == "__main__":
    sys.exit(main())
