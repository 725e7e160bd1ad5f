"""Compare the stereo filter's estimate of beta with the reference, as Fig. 6 of "Practical temporal and stereoscopic filtering for
real-time ray tracing" (Philippi, Frisvad, Jensen 2023) does.

    python tools/reference_beta.py -o DIR [--scene data/spheres/scene.toml] [--size 160x90] [--spp 16] [--renders 64] ...

Many renders of one frame, each with a seed of its own, give the first and second raw moments of what `--spp` samples make of
each pixel, and so the beta of Eq. 4 by luminance, in two ways:

    reference   as the paper has it: the other eye's moments are looked up where the disparity says, that is by the depth of
                the ray through the pixel's centre
    resampled   by the moments of what the filter makes of the other eye: X, interpolated between its pixels

`--tests` further renders are filtered. `estimate` is their beta, `mean estimate` the mean of these: what noise does to the
estimate is gone from it. Compared are the pixels whose point both eyes see, by either depth. The errors are RMSE of the
tests, against the mean of all renders, without blending and with each weight, `0.5` among them.

DIR gets beta.png (left eye, white is 1: reference, resampled, estimate of the first test, mean estimate; red where the other
eye does not show the point), beta.csv (the figures of both eyes) and beta.json, all of it.
"""

import argparse
import csv
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from measuring import ROOT, add_machine, center_depth, exit_code, size, table, whole
from PIL import Image
from scipy.ndimage import map_coordinates
from tqdm import tqdm

from clcache import Renderer, Tracer, load_scene
from clcache.cli import Parser
from clcache.device import Device
from clcache.output.files import atomic_path, check_target
from clcache.passes.stereo import disparity
from clcache.renderer import Frame, camera_record
from clcache.scene.model import Scene

EYES = ("left", "right")
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
DEPTH_TOLERANCE = 0.01  # of the reciprocal depth of a point that is looked up
NOT_SEEN = (128, 0, 0)
Images = np.ndarray  # (2, H, W) or (2, H, W, 3): of both eyes


@dataclass
class Moments:
    """Sums of images, and of their squares about the first of them, which is near the mean."""

    count: int = 0
    origin: np.ndarray | None = None
    first: np.ndarray | float = 0.0
    second: np.ndarray | float = 0.0

    def add(self, images: np.ndarray) -> None:
        """Add what one render has."""
        self.origin = images if self.origin is None else self.origin
        self.count += 1
        self.first = self.first + (images - self.origin)
        self.second = self.second + (images - self.origin) ** 2

    @property
    def mean(self) -> np.ndarray:
        """Of the renders."""
        return self.origin + self.first / self.count

    @property
    def variance(self) -> np.ndarray:
        """Of one render, without bias."""
        return np.maximum(self.second - self.first**2 / self.count, 0.0) / (self.count - 1)


@dataclass
class Found:
    """What was rendered. own, other: moments of both eyes' luminance, as they are and as X, the other eye's image as the filter
    has it. color: those of the eyes' colours. tests: of each the eyes' colours, X and beta. seen: (2, H, W), whether all
    renders show the point in both eyes."""

    own: Moments = field(default_factory=Moments)
    other: Moments = field(default_factory=Moments)
    color: Moments = field(default_factory=Moments)
    tests: list[tuple[Images, Images, Images]] = field(default_factory=list)
    seen: np.ndarray | bool = True


def rendered(
    scene: Scene, args: argparse.Namespace, kind: str, seeds: Sequence[int], **settings: object
) -> Iterator[Frame]:
    """A frame for each seed, blended in one way."""
    settings = {"varianceblend.per_channel": False} | settings
    for seed in seeds:
        renderer = Renderer(
            scene,
            "pathtrace",
            args.size,
            stereo=True,
            seed=seed,
            spp=args.spp,
            settings=settings,
            device=args.device,
            threads=args.threads,
            aovs=("beta",),
            stereo_blend=kind,
        )
        yield next(renderer.frames(args.frame, args.frame + 1))


def of_eyes(images: Mapping[str, np.ndarray]) -> Images:
    """Both eyes' images as one array, in double precision."""
    return np.stack([images[eye] for eye in EYES]).astype(np.float64)


def render(scene: Scene, args: argparse.Namespace) -> tuple[Found, Frame]:
    """Render all; the last frame comes along for its cameras. With a constant beta of 1 the filter's image is Y, of 0 X: so all have
    the same samples, which without a filter another eye has."""
    found, seeds = Found(), range(args.seed, args.seed + args.renders + args.tests)
    pairs = zip(
        rendered(scene, args, "constant", seeds, **{"stereo.beta": 1.0}),
        rendered(scene, args, "constant", seeds, **{"stereo.beta": 0.0}),
        strict=True,
    )
    estimates = rendered(scene, args, "varianceblend", seeds[args.renders :])
    for index, (plain, reprojected) in enumerate(tqdm(pairs, unit="render", total=len(seeds), disable=None)):
        color, x = of_eyes(plain.color), of_eyes(reprojected.color)
        found.seen = found.seen & (of_eyes({eye: reprojected.aov("beta", eye) for eye in EYES}) == 0.0)
        if index < args.renders:
            found.own.add(color @ LUMINANCE)
            found.other.add(x @ LUMINANCE)
        else:
            estimate = next(estimates)
            found.tests.append((color, x, of_eyes({eye: estimate.aov("beta", eye) for eye in EYES})))
        found.color.add(color)
    return found, plain


def looked_up(images: Images, device: Device, scene: Scene, frame: Frame) -> tuple[Images, np.ndarray]:
    """Of each eye's point what the other eye's image has there, interpolated along the row; and whether both eyes show it."""
    height, width = images.shape[1:3]
    tracer = Tracer(scene, device)
    near = [1.0 / center_depth(tracer, frame.cameras[eye], (height, width)).astype(np.float64) for eye in EYES]
    records = [camera_record(frame.cameras[eye], (width, height)) for eye in EYES]
    values, seen = [], []
    for eye, other in ((0, 1), (1, 0)):
        row, column = np.mgrid[:height, :width].astype(np.float64)
        place = [row, column + disparity(records[eye], records[other]) * near[eye]]
        depth = map_coordinates(near[other], place, order=1, mode="nearest")
        is_same = np.abs(depth - near[eye]) <= DEPTH_TOLERANCE * near[eye]
        seen.append(is_same & (place[1] >= 0) & (place[1] <= width - 1))
        values.append(map_coordinates(images[other], place, order=1, mode="nearest"))
    return np.stack(values), np.stack(seen)


def beta_of(bias: np.ndarray, variance_x: np.ndarray, variance_y: np.ndarray) -> np.ndarray:
    """Eq. 4; 1 for 0 / 0."""
    total = bias**2 + variance_x + variance_y
    return 1.0 - np.divide(variance_y, total, out=np.zeros_like(total), where=total > 0)


def compare(scene: Scene, args: argparse.Namespace, found: Found, frame: Frame) -> tuple[dict, list[np.ndarray]]:
    """All figures, and the left eye's pictures of beta."""
    own, other, device = found.own, found.other, Device(args.device, args.threads)
    mean_x, seen = looked_up(own.mean, device, scene, frame)
    squares, _ = looked_up(own.variance + own.mean**2, device, scene, frame)
    seen &= found.seen
    estimates = np.stack([beta for _, _, beta in found.tests])
    betas = {
        "reference": beta_of(mean_x - own.mean, np.maximum(squares - mean_x**2, 0.0), own.variance),
        "resampled": beta_of(other.mean - own.mean, other.variance, own.variance),
        "estimate": estimates[0],
        "mean estimate": estimates.mean(axis=0),
    }
    weights = betas | {"0.5": np.full_like(own.mean, 0.5), "none": np.ones_like(own.mean)}
    result = {"pixels": int(seen.sum()), "of": int(seen.size), "beta": {}, "rmse": {}}
    for name, beta in betas.items():
        result["beta"][name] = {"mean": float(beta[seen].mean()), "deviation": float(beta[seen].std())}
    for name in ("reference", "resampled"):
        for ours in ("estimate", "mean estimate"):
            result["beta"][f"{ours} against {name}"] = against(betas[ours][seen], betas[name][seen])
    for name, weight in weights.items():
        squared = [
            ((x + (beta if name == "estimate" else weight)[..., None] * (y - x) - found.color.mean) ** 2)[seen].mean()
            for y, x, beta in found.tests
        ]
        result["rmse"][name] = float(np.sqrt(np.mean(squared)))
    result["variance of X, of the looked up"] = float(
        other.variance[seen].mean() / np.maximum(squares - mean_x**2, 0.0)[seen].mean()
    )
    return result, [np.where(seen[0], beta[0], np.nan) for beta in betas.values()]


def against(estimate: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """How two images of beta compare."""
    return {
        "mean difference": float((estimate - reference).mean()),
        "correlation": float(np.corrcoef(estimate, reference)[0, 1]),
        "higher": float((estimate > reference).mean()),
    }


def write(folder: Path, result: dict, pictures: Sequence[np.ndarray]) -> None:
    """The three files."""
    grey = np.hstack(pictures)
    colors = np.repeat(np.rint(np.nan_to_num(grey).clip(0, 1) * 255.0)[..., None], 3, axis=-1).astype(np.uint8)
    colors[np.isnan(grey)] = NOT_SEEN
    with atomic_path(folder / "beta.png") as part, part.open("wb") as file:
        Image.fromarray(colors).save(file, format="PNG")
    with atomic_path(folder / "beta.csv") as part, part.open("w", newline="") as file:
        csv.writer(file).writerows([["group", "name", "figure", "value"], *flat(result)])
    with atomic_path(folder / "beta.json") as part:
        part.write_text(json.dumps(result, indent=1) + "\n")


def flat(result: dict) -> Iterator[tuple[str, str, str, float]]:
    """The figures as rows."""
    for name, figures in result["beta"].items():
        for figure, value in figures.items():
            yield "beta", name, figure, value
    for name, value in result["rmse"].items():
        yield "rmse", name, "", value


def work(args: argparse.Namespace) -> None:
    """Render, compare, write, and print the figures."""
    check_target(args.output / "beta.json")
    scene = load_scene(args.scene)
    result, pictures = compare(scene, args, *render(scene, args))
    write(args.output, result, pictures)
    print(f"{result['pixels']} of {result['of']} pixels\n")
    print(table(["", "", "", "value"], [[g, n, f, f"{v:.4f}"] for g, n, f, v in flat(result)]))
    print(f"\nvariance of X, of that of the looked-up pixels: {result['variance of X, of the looked up']:.3f}")


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line. Raises SettingError."""
    form = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog=Path(__file__).name, description=__doc__, formatter_class=form)
    add = parser.add_argument
    add("-o", dest="output", metavar="DIR", type=Path, required=True, help="folder of results")
    add("--scene", metavar="FILE", default=ROOT / "data" / "spheres" / "scene.toml", help="default: data/spheres")
    add("--size", metavar="WxH", type=size, default=(160, 90), help="default: 160x90")
    add("--frame", metavar="N", type=whole(0), default=15, help="default: %(default)s")
    add("--spp", metavar="N", type=whole(1), default=16, help="samples of a render (default: %(default)s, as Fig. 6)")
    add("--renders", metavar="N", type=whole(2), default=64, help="that moments are taken of (default: %(default)s)")
    add("--tests", metavar="N", type=whole(1), default=8, help="that are filtered (default: %(default)s)")
    add_machine(parser)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; the exit code, as of `clcache`."""
    return exit_code(Path(__file__).stem, lambda: work(parse(arguments)))


if __name__ == "__main__":
    sys.exit(main())
