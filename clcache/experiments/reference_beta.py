"""The stereo blend's estimate of beta beside the reference, as Fig. 6 of "Practical temporal and stereoscopic filtering for real-time ray tracing"
(Philippi, Frisvad, Jensen 2023) has it.

Many renders of one frame, each with a seed of its own, give the first and second raw moments of what a number of samples makes of
each pixel, and so the beta of Eq. 4 by luminance, in two ways:

    reference   as the paper has it: the other eye's moments are looked up where the disparity says, that is by the depth of
                the ray through the pixel's centre
    resampled   by the moments of what the filter makes of the other eye: X, interpolated between its pixels

Further renders are filtered. `estimate` is the beta of the first of them, `mean estimate` the mean of these: what noise does to the
estimate is gone from it. Compared are the pixels whose point both eyes see, by either depth. The errors are RMSE of the
tests, against the mean of all renders, without blending and with each weight, one half among them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import map_coordinates

from ..bvh.tracer import Tracer
from ..passes.stereo import disparity
from ..renderer import Frame, camera_record
from ..scene.model import Scene
from .configuration import Configuration
from .job import Machine, Result, open_scene
from .sequence import EYES, center_depth, pictures_of

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
DEPTH_TOLERANCE = 0.01  # of the reciprocal depth of a point that is looked up
NOT_SEEN = (0.2, 0.0, 0.0)
SEEDS = 100_000  # of one job: other jobs' are beyond
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


def run(parameters: Mapping, _needed: Mapping[str, Result], machine: Machine) -> Result:
    """A row for each weight: beta (mean), deviation, rmse; of estimates beside each of the true betas, in rows of their own, excess (mean
    difference), correlation, and the part of pixels where they are higher. Pictures of the left eye's beta. Raises SceneError, SettingError,
    DeviceError.

    parameters: scene, size, frame, spp, renders (that moments are taken of), tests (that are filtered), seed.
    """
    scene = open_scene(parameters["scene"])
    found, frame = render(scene, parameters, machine)
    rows, betas, seen = compare(scene, parameters, machine, found, frame)
    shared = {"frame": parameters["frame"], "counted": True}
    pictures = {}
    for name, beta in betas.items():
        grey = np.where(seen[0][..., None], beta[0][..., None], NOT_SEEN)
        pictures |= pictures_of(name, parameters["frame"], {EYES[0]: grey})
    return Result([shared | row for row in rows], pictures)


def rendered(
    scene: Scene, parameters: Mapping, machine: Machine, kind: str, seeds: Sequence[int], **settings: object
) -> Iterator[Frame]:
    """A frame for each seed, blended in one way."""
    settings = {"varianceblend.per_channel": False} | settings
    way = Configuration(kind, "pathtrace", settings, spp=parameters["spp"], stereo_blend=kind)
    size, number = tuple(parameters["size"]), parameters["frame"]
    for seed in seeds:
        renderer = way.renderer(scene, size, True, seed, machine.device, machine.threads, aovs=("beta",))
        yield next(renderer.frames(number, number + 1))


def of_eyes(images: Mapping[str, np.ndarray]) -> Images:
    """Both eyes' images as one array, in double precision."""
    return np.stack([images[eye] for eye in EYES]).astype(np.float64)


def render(scene: Scene, parameters: Mapping, machine: Machine) -> tuple[Found, Frame]:
    """Render all; the last frame comes along for its cameras. With a constant beta of 1 the filter's image is Y, of 0 X: so all have
    the same samples, which without a filter another eye has."""
    renders, first = parameters["renders"], parameters["seed"] * SEEDS
    found, seeds = Found(), range(first, first + renders + parameters["tests"])
    told = scene, parameters, machine
    pairs = zip(
        rendered(*told, "constant", seeds, **{"stereo.beta": 1.0}),
        rendered(*told, "constant", seeds, **{"stereo.beta": 0.0}),
        strict=True,
    )
    estimates = rendered(*told, "varianceblend", seeds[renders:])
    for index, (plain, reprojected) in enumerate(pairs):
        color, x = of_eyes(plain.color), of_eyes(reprojected.color)
        found.seen = found.seen & (of_eyes({eye: reprojected.aov("beta", eye) for eye in EYES}) == 0.0)
        if index < renders:
            found.own.add(color @ LUMINANCE)
            found.other.add(x @ LUMINANCE)
        else:
            estimate = next(estimates)
            found.tests.append((color, x, of_eyes({eye: estimate.aov("beta", eye) for eye in EYES})))
        found.color.add(color)
    return found, plain


def looked_up(images: Images, machine: Machine, scene: Scene, frame: Frame) -> tuple[Images, np.ndarray]:
    """Of each eye's point what the other eye's image has there, interpolated along the row; and whether both eyes show it."""
    height, width = images.shape[1:3]
    tracer = Tracer(scene, machine.open())
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


def compare(
    scene: Scene, parameters: Mapping, machine: Machine, found: Found, frame: Frame
) -> tuple[list[dict], dict[str, Images], np.ndarray]:
    """The rows; both eyes' betas by name; and the pixels that are compared."""
    own, other = found.own, found.other
    mean_x, seen = looked_up(own.mean, machine, scene, frame)
    squares, _ = looked_up(own.variance + own.mean**2, machine, scene, frame)
    variance_x = np.maximum(squares - mean_x**2, 0.0)
    seen &= found.seen
    estimates = np.stack([beta for _, _, beta in found.tests])
    betas = {
        "reference": beta_of(mean_x - own.mean, variance_x, own.variance),
        "resampled": beta_of(other.mean - own.mean, other.variance, own.variance),
        "estimate": estimates[0],
        "mean estimate": estimates.mean(axis=0),
    }
    weights = betas | {"0.5": np.full_like(own.mean, 0.5), "none": np.ones_like(own.mean)}
    rows = []
    for name, weight in weights.items():
        squared = [
            ((x + (beta if name == "estimate" else weight)[..., None] * (y - x) - found.color.mean) ** 2)[seen].mean()
            for y, x, beta in found.tests
        ]
        row = {"configuration": name, "rmse": float(np.sqrt(np.mean(squared)))}
        if name in betas:
            row |= {"beta": float(weight[seen].mean()), "deviation": float(weight[seen].std())}
        rows.append(row | {"pixels": int(seen.sum())})
    rows[1]["variance"] = float(other.variance[seen].mean() / variance_x[seen].mean())
    for name in ("reference", "resampled"):
        for ours in ("estimate", "mean estimate"):
            pair = against(betas[ours][seen], betas[name][seen])
            rows.append({"configuration": f"{ours} against {name}"} | pair)
    return rows, betas, seen


def against(estimate: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """How two images of beta compare."""
    return {
        "excess": float((estimate - reference).mean()),
        "correlation": float(np.corrcoef(estimate, reference)[0, 1]),
        "higher": float((estimate > reference).mean()),
    }
