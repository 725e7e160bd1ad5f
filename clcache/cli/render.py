"""`clcache render`: a scene in; an EXR file for each frame, and on request PNG pictures and statistics, out."""

import argparse
import math
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .. import settings
from ..output.aov import AOVS, DEFAULT_AOVS
from .resume import SAVE_EVERY, StateKeeper, finishing_frames, picture_files, stem, where_to_begin
from .terminal import Progress, printable, ray_count, say

if TYPE_CHECKING:
    from ..renderer import Frame, Renderer
    from ..scene.model import Scene

MAX_FRAME = 2**31 - 1  # the frame attribute of an EXR file has 32 bits


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command to the command line."""
    parser = subparsers.add_parser(
        "render",
        help="render a scene to EXR files",
        description="Render a scene to DIR/frame_0000.exr and on: one file for each frame, with both eyes in it where there"
        " are two. What is not given on the command line is as the scene says.",
    )
    add = parser.add_argument
    add("scene", metavar="SCENE", help="a .toml scene or a mesh file (.glb .gltf .obj .ply .stl ...)")
    add("-o", dest="folder", metavar="DIR", type=Path, help="output folder (default: out/NAME, after the scene's file)")
    add(
        "--method",
        metavar="M",
        help=f"rendering method, of pathtrace, {', '.join(settings.CACHED_METHODS)} (default: the scene's, else pathtrace)",
    )
    add("--size", metavar="WxH", type=parse_size, help="pixels (default: the scene's, else 640x360)")
    add(
        "--frames",
        metavar="A:B",
        type=parse_frames,
        help="frame numbers from A to B - 1 (default: the scene's, else 0:1)",
    )
    add(
        "--fps", metavar="N", type=_fps, help="frame n shows the scene at n / N seconds (default: the scene's, else 30)"
    )
    eyes = parser.add_mutually_exclusive_group()
    eyes.add_argument("--stereo", action="store_true", default=None, help="two eyes (default: as the scene says)")
    eyes.add_argument("--mono", dest="stereo", action="store_false", default=None, help="one eye")
    add(
        "--temporal",
        metavar="T",
        choices=settings.TEMPORALS,
        help="how a frame is joined with those before it, of"
        f" {', '.join(settings.TEMPORALS)} (default: {_default_temporals()})",
    )
    add(
        "--stereo-blend",
        metavar="B",
        choices=settings.STEREO_BLENDS,
        help=f"how the eyes share what they know, of {', '.join(settings.STEREO_BLENDS)} (default: none)",
    )
    add(
        "--memo",
        metavar="K",
        choices=settings.MEMOS,
        help="keep what material graphs compute, to compute it once and not for each hit: in texels, or in tiles of them;"
        f" of {', '.join(settings.MEMOS)} (default: off)",
    )
    add(
        "--spp",
        metavar="N",
        type=_whole(1),
        help="samples per pixel (default: the scene's, else 16); of methods with a cache, its updates for each frame"
        " (default: 1)",
    )
    add(
        "--until-relmse",
        metavar="X",
        type=_error,
        help="for each picture, take samples until the relMSE that the pixels' variance lets expect is at most X, or --spp is reached"
        " (default: 65536)",
    )
    add(
        "--seed",
        metavar="N",
        type=_whole(0),
        help="seed of the random numbers, up to 64 bits (default: the scene's, else 0)",
    )
    add(
        "--set",
        dest="settings",
        metavar="KEY=VALUE",
        type=_assignment,
        action="append",
        default=[],
        help="a setting by its dotted name; repeatable; 'clcache settings' lists them",
    )
    add(
        "--aov",
        metavar="NAME,...",
        type=_aovs,
        default=DEFAULT_AOVS,
        help=f"AOVs to write, of {', '.join(AOVS)} (default: {','.join(DEFAULT_AOVS)})",
    )
    add("--png", action="store_true", help="also write frame_0000.png, or frame_0000_left.png and frame_0000_right.png")
    add("--device", metavar="SPEC", help="OpenCL device: its index, or part of the platform's or the device's name")
    add("--threads", metavar="N", type=_whole(1), help="CPU threads of the device (default: all)")
    add(
        "--resume",
        action="store_true",
        help="go on after the last complete frame in DIR, with the caches as they were then: from DIR/state.npz, which a render"
        f" that has caches or a temporal filter leaves where it is interrupted, and writes every {SAVE_EVERY} s",
    )
    add(
        "--save-state", action="store_true", help="leave DIR/state.npz also at the end, to go on with more frames later"
    )
    add(
        "--warm-start",
        metavar="FILE_OR_DIR",
        type=Path,
        help="begin with what the state of another render of the same scene knows of the world (voxelhash, hybrid, octree; any method with --memo)",
    )
    add(
        "--stats",
        metavar="FILE.json",
        type=Path,
        help="write statistics of the finished render to this file; of a resumed one, those of the frames from there on, if there are any",
    )
    add("--allow-outside", action="store_true", help="let the scene name files outside its folder")


def _default_temporals() -> str:
    others = [f"{name} of {method}" for method, name in settings.DEFAULT_TEMPORALS.items()]
    return ", ".join([*others, "else none"])


def run(args: argparse.Namespace) -> int:
    """Render as the arguments say. Returns the exit code. Raises SceneError, SettingError, DeviceError, Error."""
    from ..output.exr import provenance
    from ..output.files import check_target
    from ..output.stats import write_stats

    start = time.perf_counter()
    scene = _load(args)
    load_seconds = time.perf_counter() - start
    folder = args.folder or default_folder(scene.file)
    first, end = args.frames or scene.defaults.frames
    if args.stats:
        check_target(args.stats)
    check_target(stem(folder, first).with_suffix(".exr"))

    finished: list[dict] = []
    with Progress() as progress:
        renderer = _renderer(args, scene, progress)
        attributes = provenance(scene, renderer.stats())
        state = StateKeeper(renderer, folder)
        begin = where_to_begin(renderer, args, folder, (first, end), attributes)
        if begin == end:
            unwritten = f"; {args.stats} is not written" if args.stats else ""
            print(printable(f"{folder}: all {end - first} frames are there{unwritten}"))
            return 0
        width, height = renderer.size
        samples = width * height * renderer.spp * len(renderer.eyes)
        progress.start(end - begin, samples if args.until_relmse is None else None)
        try:
            with finishing_frames(renderer.has_state) as interrupt:
                for frame in renderer.frames(begin, end, progress=progress.part_of_frame):
                    _write(frame, folder, args, attributes)
                    finished.append(frame.stats)
                    progress.frame_done(frame)
                    if frame.number + 1 < end:  # after the last frame there is nothing left to interrupt
                        interrupt.check()
                        state.frame_done()
        except KeyboardInterrupt:
            goes_on = state.interrupted()
            done = begin - first + len(finished)
            how = "goes on" if goes_on else "begins anew, there being no state to go on from"
            say(f"clcache: interrupted; {folder} has {done} of {end - first} frames, each complete; --resume {how}")
            return 130
    state.end(args.save_state or args.resume and renderer.has_state)
    stats = renderer.stats()
    stats["seconds"] = {"load": load_seconds, **stats["seconds"]}
    if args.stats:
        write_stats(args.stats, stats, finished)
    if args.until_relmse is not None:
        _say_what_missed(args.until_relmse, finished)
    print(printable(summary(folder, stats, finished)))
    return 0


def _load(args: argparse.Namespace) -> "Scene":
    from ..scene import load_scene

    scene = load_scene(args.scene, allow_outside=args.allow_outside)
    for note in scene.notes:
        say(f"note: {note}")
    for what, count in scene.dropped.items():
        say(f"note: left out {count} {what}")
    return scene if args.fps is None else replace(scene, defaults=replace(scene.defaults, fps=args.fps))


def _renderer(args: argparse.Namespace, scene: "Scene", progress: Progress) -> "Renderer":
    """The renderer that the arguments ask for; what they leave out it takes from the scene, else from its own defaults."""
    from ..renderer import Renderer

    return Renderer(
        scene,
        method=args.method,
        size=args.size,
        stereo=args.stereo,
        seed=args.seed,
        spp=args.spp,
        settings=dict(args.settings),
        device=args.device,
        threads=args.threads,
        aovs=args.aov,
        until_relmse=args.until_relmse,
        temporal=args.temporal,
        stereo_blend=args.stereo_blend,
        memo=args.memo,
        on_compile=progress.compiling,
    )


def _write(frame: "Frame", folder: Path, args: argparse.Namespace, attributes: dict[str, object]) -> None:
    from ..output.exr import sample_counts, write_exr
    from ..output.png import write_png

    spp = sample_counts({eye: stats["spp"] for eye, stats in frame.stats["eyes"].items()})
    write_exr(stem(folder, frame.number).with_suffix(".exr"), frame, args.aov, attributes | spp)
    files = picture_files(folder, frame.number, tuple(frame.color)) if args.png else {}
    for eye, file in files.items():
        write_png(file, frame.color[eye])


def default_folder(scene_file: str) -> Path:
    """out/NAME: NAME is the scene file's name without ending; for a file called scene.* its folder's name."""
    path = Path(scene_file).absolute()
    return Path("out") / ((path.parent.name if path.stem == "scene" else "") or path.stem)


def summary(folder: Path, stats: dict, frames: list[dict]) -> str:
    """The line that a finished render ends with. stats: those of the whole render; frames: each frame's."""
    seconds = sum(frame["seconds"] for frame in frames)
    rate = sum(map(ray_count, frames)) / max(seconds, 1e-9) / 1e6
    number = f"{len(frames)} frame{'s' if len(frames) != 1 else ''}"
    width, height = stats["size"]
    eyes = [eye for frame in frames for eye in frame["eyes"].values()]
    picture = f"{width}x{height} ({', '.join(frames[0]['eyes'])}), {_range([eye['spp'] for eye in eyes])} spp"
    errors = [eye["estimated_relmse"] for eye in eyes if eye.get("estimated_relmse") is not None]
    error = f", estimated relMSE {_range(errors)}" if errors else ""
    return f"{folder}: {number} of {picture}{error}: {seconds:.2f} s, {rate:.2f} Mrays/s; compiled {stats['seconds']['compile']:.2f} s"


def _range(values: list[float]) -> str:
    texts = [f"{value}" if isinstance(value, int) else f"{value:.3g}" for value in (min(values), max(values))]
    return " to ".join(dict.fromkeys(texts))


def _say_what_missed(goal: float, frames: list[dict]) -> None:
    """Say how many pictures took all samples that they might, and are not as good as was asked for."""
    errors = [eye["estimated_relmse"] for frame in frames for eye in frame["eyes"].values()]
    missed = sum(error is None or error > goal for error in errors)
    if missed:
        say(
            f"note: {missed} of {len(errors)} pictures have all samples that --spp allows and an estimated relMSE above {goal:g}"
        )


def _whole(least: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        if not re.fullmatch(r"[0-9]{1,20}", text) or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number from {least} on")
        return int(text)

    return parse


def parse_size(text: str) -> tuple[int, int]:
    """Width and height, of an option's WxH."""
    match = re.fullmatch(r"([0-9]{1,10})x([0-9]{1,10})", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if min(size) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected WxH in pixels, such as 640x360")
    return size


def parse_frames(text: str) -> tuple[int, int]:
    """The first frame and the one behind the last, of an option's A:B."""
    match = re.fullmatch(r"([0-9]{1,10}):([0-9]{1,10})", text)
    frames = (int(match[1]), int(match[2])) if match else (0, 0)
    if not frames[0] < frames[1] <= MAX_FRAME:
        raise argparse.ArgumentTypeError(f"{text!r}: expected A:B with 0 <= A < B <= {MAX_FRAME}; B is not rendered")
    return frames


def _fps(text: str) -> float:
    try:
        fps = float(text)
    except ValueError:
        fps = 0.0
    if not 0.01 <= fps <= 10_000:
        raise argparse.ArgumentTypeError(f"{text!r}: expected frames per second, 0.01 .. 10000")
    return fps


def _error(text: str) -> float:
    try:
        error = float(text)
    except ValueError:
        error = 0.0
    if not 0.0 < error < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a number above 0, such as 0.001")
    return error


def _assignment(text: str) -> tuple[str, bool | int | float | str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"{text!r}: expected KEY=VALUE, such as pathtrace.bounces=3")
    return name, settings.find(name).parse(value)


def _aovs(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(filter(None, text.split(","))))
    unknown = [name for name in names if name not in AOVS]
    if unknown:
        raise argparse.ArgumentTypeError(
            f"unknown AOV {unknown[0]!r}; expected names of {', '.join(AOVS)}, with commas between"
        )
    return names
