"""Measure stereo blending from the sample cache, as Fig. 15 of SampleCache does, on any scene.

    python tools/stereo_blending_table.py DIR [--scene data/spheres/scene.toml] [--frames A:B] ...

DIR holds frames of both eyes, as `clcache render` names them, that are true but for their noise; they give the size:

    clcache render data/spheres/scene.toml --stereo --size 320x180 --spp 1024 --seed 1000 --frames 15:16 -o DIR

Rendered are the frames from the first to the last that is there, and those that are there are compared: without blending,
with the samples' weights, and with one weight for all (tools/stereo_oracle.py, of the same pictures), each with
every sharpness R. The columns are means over frames: relMSE over both eyes; the stereo difference, which is the mean squared
difference of the eyes where both show the same point, as the depth of rays through the pixels' centres tells; the
sharpness CPBD, wanted as the reference has it; and the milliseconds on the device that blending takes for both eyes.
"""

import argparse
import re
import statistics
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from measuring import EYES, ROOT, add_machine, center_depth, check_size, exit_code, frames, table
from stereo_oracle import Eye, blend
from tqdm import tqdm

from clcache import Renderer, SettingError, Tracer, load_scene
from clcache.cli import Parser
from clcache.device import Device
from clcache.metrics import View, cpbd, relmse, reprojected_difference
from clcache.output.read import read_picture
from clcache.renderer import Frame
from clcache.scene.model import Camera
from clcache.settings import SETTINGS

NAME = re.compile(r"frame_(\d+)\.exr")
Pair = dict[str, np.ndarray]  # a picture of each eye


class Measure:
    """The numbers of each row, frame by frame."""

    def __init__(self, tracer: Tracer):
        self._tracer = tracer
        self._depths: dict[int, Pair] = {}
        self.rows: dict[str, list[tuple[float, ...]]] = {}

    def add(self, row: str, number: int, pair: Pair, reference: Pair, cameras: dict[str, Camera], ms: float = 0.0):
        """Compare a frame's pictures."""
        if number not in self._depths:
            self._depths[number] = {e: center_depth(self._tracer, cameras[e], pair[e].shape) for e in EYES}
        views = [View(pair[e], self._depths[number][e], cameras[e]) for e in EYES]
        error = statistics.fmean(relmse(pair[e], reference[e]) for e in EYES)
        sharpness = statistics.fmean(cpbd(pair[e]) for e in EYES)
        self.rows.setdefault(row, []).append((error, reprojected_difference(*views).mean, sharpness, ms))

    def __str__(self) -> str:
        rows = []
        for name, values in self.rows.items():
            error, difference, sharpness, ms = map(statistics.fmean, zip(*values, strict=True))
            rows.append([name, f"{error:.5f}", f"{difference:.4e}", f"{sharpness:.3f}", f"{ms:.2f}" if ms else "-"])
        return table(["", "relMSE", "stereo difference", "CPBD", "blend ms"], rows)


def references(folder: Path, only: tuple[int, int] | None) -> dict[int, Pair]:
    """The references in a folder, by frame. Raises SettingError where there are none, or where one has not two eyes or
    another size than the first."""
    found, size = {}, None
    for file in sorted(folder.glob("frame_*.exr")):
        match = NAME.fullmatch(file.name)
        if match and (only is None or only[0] <= int(match[1]) < only[1]):
            picture = read_picture(file)
            size = size or picture.size
            check_size(file, picture.size, size)
            if not picture.color.keys() >= set(EYES):
                raise SettingError(f"{file}: has views {', '.join(picture.color)}; expected left and right")
            found[int(match[1])] = picture.color
    if not found:
        where = "" if only is None else f" of frames {only[0]}:{only[1]}"
        raise SettingError(f"{folder}: no references{where}; expected files frame_0000.exr, or others of that kind")
    return found


def rendered(scene, args: argparse.Namespace, known: dict[int, Pair], sharpness: float | None) -> Iterator[Frame]:
    """The frames that have references, blended with this sharpness, or not at all."""
    height, width, _ = next(iter(known.values()))["left"].shape
    settings = {"samplecache.alpha": args.alpha} | ({} if sharpness is None else {"samplecache.sharpness": sharpness})
    renderer = Renderer(
        scene,
        "samplecache",
        (width, height),
        stereo=True,
        seed=args.seed,
        settings=settings,
        device=args.device,
        threads=args.threads,
        aovs=("Z",),
        stereo_blend="none" if sharpness is None else "samples",
    )
    what = "none" if sharpness is None else f"R = {sharpness:g}"
    for frame in tqdm(renderer.frames(0, max(known) + 1), what, max(known) + 1, unit="frame", disable=None):
        if frame.number in known:
            yield frame


def halved(frame: Frame, sharpness: float, weight: float) -> Pair:
    """A frame's pictures, each blended with the other by one weight; single precision, as rendered."""
    eyes = {}
    for e in EYES:
        depth = frame.aov("Z", e)
        moments = np.zeros((*depth.shape, 8), np.float32)
        moments[..., 3], moments[..., 7] = 1.0, 1.0 / depth
        eyes[e] = Eye(frame.color[e], moments, frame.cameras[e])
    pairs = {"left": "right", "right": "left"}
    return {e: blend(eyes[e], eyes[o], sharpness, weight).color.astype(np.float32) for e, o in pairs.items()}


def measure(args: argparse.Namespace) -> Measure:
    """Render and compare."""
    scene, known = load_scene(args.scene), references(args.references, args.frames)
    found = Measure(Tracer(scene, Device(args.device, args.threads)))
    plain = list(rendered(scene, args, known, None))
    for frame in plain:
        found.add("reference", frame.number, known[frame.number], known[frame.number], frame.cameras)
    for frame in plain:
        found.add("no blending", frame.number, frame.color, known[frame.number], frame.cameras)
    for r in args.sharpness:
        for frame in plain:
            pair = halved(frame, r, args.weight)
            found.add(f"weight {args.weight:g}, R = {r:g}", frame.number, pair, known[frame.number], frame.cameras)
        for frame in rendered(scene, args, known, r):
            ms = 1e3 * sum(frame.stats["eyes"][e]["passes"]["blend"] for e in EYES)
            found.add(f"samples, R = {r:g}", frame.number, frame.color, known[frame.number], frame.cameras, ms)
    return found


def weight(text: str) -> float:
    """A part of the whole."""
    found = float(text)
    if not 0 <= found <= 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected 0 .. 1")
    return found


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line. Raises SettingError."""
    form = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog=Path(__file__).name, description=__doc__, formatter_class=form)
    sharpness, alpha = (SETTINGS[f"samplecache.{name}"].parse for name in ("sharpness", "alpha"))
    add = parser.add_argument
    add("references", metavar="DIR", type=Path, help="folder of references")
    add("--scene", metavar="FILE", default=ROOT / "data" / "spheres" / "scene.toml", help="default: data/spheres")
    add("--frames", metavar="A:B", type=frames, help="default: all references")
    add("--sharpness", metavar="R", type=sharpness, nargs="+", default=[0.0, 0.8, 1.0], help="default: 0 0.8 1")
    add(
        "--alpha", metavar="A", type=alpha, default=0.1, help="samplecache.alpha (default: %(default)s, as section 5.2)"
    )
    add("--weight", metavar="W", type=weight, default=0.5, help="the constant weight of the other eye (default: 0.5)")
    add_machine(parser)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; the exit code, as of `clcache`."""
    return exit_code(Path(__file__).stem, lambda: print(measure(parse(arguments))))


if __name__ == "__main__":
    sys.exit(main())
