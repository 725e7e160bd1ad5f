"""Render a scene with clcache and with Mitsuba 3, compare the images and the time that a sample takes.

    python tools/peers/render_both.py data/cornell/scene.toml -o out/both --size 640x360 --spp 16 --threads 1,2

writes clcache.exr, mitsuba.exr, difference.exr (clcache's minus Mitsuba's), each with a .png beside it (that of the
difference shows its size), and prints the means and times. Both trace the same number of bounces without roulette, from
one eye; what moves stays where it is at the start. Every renderer runs in a process of its own for each number of threads, so that neither finds the other's threads
or memory; the first frame, with whatever is compiled for it, is reported apart, and the median of the later ones counts.
Wall-clock time is what a user waits; processor time is what to compare on a machine that has other work to do.

Mitsuba runs its LLVM variant, which needs libLLVM 19 or newer: the process dies in what versions 14 to 16 make of it. On
Debian: `apt-get install libllvm19`. DRJIT_LIBLLVM_PATH names another one.
"""

import argparse
import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import OpenEXR

from clcache import Error, load_scene
from clcache.output.png import write_png

NO_ROULETTE = 64  # the setting's largest value


@dataclass(frozen=True)
class Job:
    """What to render. threads: how many of the processor's."""

    scene: str
    size: tuple[int, int]
    spp: int
    bounces: int
    seed: int
    repeats: int
    threads: int


@dataclass(frozen=True)
class Run:
    """image: (H, W, 3), the mean of the frames after the first. Times in seconds; prepare: scene and trees; compile: of
    kernels; first: the first frame; wall, cpu: the median of the later frames."""

    image: np.ndarray
    prepare: float
    compile: float
    first: float
    wall: float
    cpu: float


def run_clcache(job: Job) -> Run:
    """Render with clcache."""
    from clcache import Renderer

    scene = load_scene(job.scene)
    # All frames show the start, as Mitsuba's do, and differ in their noise alone.
    scene = replace(scene, defaults=replace(scene.defaults, fps=1e9))
    start = time.perf_counter()
    settings = {"pathtrace.bounces": job.bounces, "pathtrace.roulette": NO_ROULETTE}
    options = {"size": job.size, "spp": job.spp, "seed": job.seed, "settings": settings, "threads": job.threads}
    renderer = Renderer(scene, "pathtrace", stereo=False, **options)
    compiled = renderer.stats()["seconds"]["compile"]
    prepared = time.perf_counter() - start - compiled
    frames = renderer.frames(0, job.repeats + 1)
    return _timed(job, prepared, lambda _: next(frames).color["mono"], lambda: compiled)


def run_mitsuba(job: Job) -> Run:
    """Render with Mitsuba. Raises Error if there is no LLVM that it works with."""
    import drjit as dr

    from clcache.experiments import mitsuba_export

    mitsuba_export.set_llvm_variant(job.threads)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    scene = load_scene(job.scene)
    start = time.perf_counter()
    exported = mitsuba_export.to_mitsuba(scene, job.size, job.spp, job.bounces, job.seed)
    prepared = time.perf_counter() - start

    def compiled() -> float:
        return sum(k.get("codegen_time", 0) + k.get("backend_time", 0) for k in dr.kernel_history()) / 1000

    return _timed(job, prepared, lambda k: mitsuba_export.render(exported, job.spp, job.seed + k), compiled)


def _timed(job: Job, prepared: float, frame: Callable[[int], np.ndarray], compiled: Callable[[], float]) -> Run:
    """frame: renders frame k. compiled: seconds that compilation took, asked for after the first frame."""
    images, wall, cpu = [], [], []
    for k in range(job.repeats + 1):
        before, start = _cpu_seconds(), time.perf_counter()
        images.append(frame(k))
        wall.append(time.perf_counter() - start)
        cpu.append(_cpu_seconds() - before)
        if k == 0:
            compile_seconds = compiled()
    median = np.median([wall[1:], cpu[1:]], axis=1)
    return Run(np.mean(images[1:], axis=0, dtype=np.float32), prepared, compile_seconds, wall[0], *map(float, median))


def _cpu_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


RENDERERS = {"clcache": run_clcache, "mitsuba": run_mitsuba}


def render_all(job: Job, threads: list[int]) -> dict[int, dict[str, Run]]:
    """Threads -> renderer's name -> what it rendered."""
    runs: dict[int, dict[str, Run]] = {}
    for count in threads:
        runs[count] = {}
        for name, renderer in RENDERERS.items():
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
                run = process.submit(renderer, Job(**vars(job) | {"threads": count})).result()
            runs[count][name] = run
            per_sample = 1e9 / (job.size[0] * job.size[1] * job.spp)
            print(
                f"{name:8} {count:7} {run.prepare:10.2f} {run.compile:10.2f} {run.first:10.2f} {run.wall:10.2f}"
                f" {run.wall * per_sample:15.0f} {run.cpu * per_sample:15.0f}",
                flush=True,
            )
    return runs


def report(runs: dict[int, dict[str, Run]]) -> str:
    """Ratios of the times, and the images' means."""
    lines = []
    for count, pair in runs.items():
        ours, theirs = pair["clcache"], pair["mitsuba"]
        ratio = f"wall-clock {ours.wall / theirs.wall:.2f}, processor {ours.cpu / theirs.cpu:.2f}"
        lines.append(f"clcache / mitsuba, threads {count}: time per sample {ratio}")
    means = {name: run.image.mean(axis=(0, 1), dtype=np.float64) for name, run in pair.items()}
    lines += [f"mean of {name}: {' '.join(f'{c:.6f}' for c in mean)}" for name, mean in means.items()]
    relative = means["clcache"] / np.maximum(means["mitsuba"], 1e-30) - 1
    lines.append(f"difference of the means: {' '.join(f'{100 * c:+.4f} %' for c in relative)}")
    return "\n".join(lines)


def write_images(folder: Path, pair: dict[str, Run]) -> None:
    """Both images and their difference, as EXR and PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    images = {name: run.image for name, run in pair.items()}
    images["difference"] = images["clcache"] - images["mitsuba"]
    for name, image in images.items():
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"RGB": np.ascontiguousarray(image)}) as file:
            file.write(str(folder / f"{name}.exr"))
        write_png(folder / f"{name}.png", np.abs(image))


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("scene", metavar="SCENE", help="what clcache renders: a .toml scene or a mesh file")
    add("-o", dest="folder", metavar="DIR", type=Path, help="where to write the images (default: nowhere)")
    add("--size", metavar="WxH", type=lambda text: tuple(map(int, text.split("x"))), default=(640, 360))
    add("--spp", metavar="N", type=int, default=16, help="samples for each pixel of a frame")
    add("--bounces", metavar="N", type=int, default=3, help="as the setting pathtrace.bounces")
    add("--seed", metavar="N", type=int, default=0)
    add("--repeats", metavar="N", type=int, default=3, help="frames after the first")
    add("--threads", metavar="N,...", type=lambda text: list(map(int, text.split(","))), default=[1, os.cpu_count()])
    args = parser.parse_args()
    job = Job(args.scene, args.size, args.spp, args.bounces, args.seed, args.repeats, 0)
    print(f"{args.scene}, {args.size[0]}x{args.size[1]}, {args.spp} spp, {args.bounces} bounces; seconds")
    print("         threads    prepare    compile first frame later frame  wall ns/sample   cpu ns/sample", flush=True)
    try:
        runs = render_all(job, args.threads)
    except Error as error:
        print(f"render_both: {error}", file=sys.stderr)
        return 1
    print(report(runs))
    if args.folder:
        write_images(args.folder, runs[args.threads[-1]])
    return 0


if __name__ == "__main__":
    sys.exit(main())
