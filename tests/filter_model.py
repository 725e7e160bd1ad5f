"""The temporal filters in NumPy, in float64, written from the paper and from what their modules say; and the kernels, run on
images, motions and histories that a test makes up."""

from dataclasses import dataclass, field

import numpy as np
from helpers import make_scene, soup
from scipy.ndimage import minimum_filter

from clcache.device import Device
from clcache.frame import FrameGraph
from clcache.methods import PathState
from clcache.passes.temporal import temporal
from clcache.renderer import camera_record
from clcache.resources import SceneResources
from clcache.settings import resolve

NONE = 0xFFFFFFFF
ONE = 2**24 - 1  # of barycentric coordinates
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
RUN = 16  # pixels: a motion buffer is so much longer than the image
MARGIN = 2
STILL_NEARER = 0.05  # of a depth


@dataclass
class History:
    """What goes from frame to frame: mean (H, W, 3), count (H, W), N of Eq. 5, 0 for no history; variance (H, W, 1 or 3)."""

    mean: np.ndarray
    count: np.ndarray
    variance: np.ndarray

    @classmethod
    def none(cls, size: tuple[int, int], channels: int = 1) -> "History":
        """That of a first frame."""
        shape = size[::-1]
        return cls(np.zeros((*shape, 3)), np.zeros(shape), np.zeros((*shape, channels)))


@dataclass
class Model:
    """A filter; options: the settings' last names."""

    kind: str
    size: tuple[int, int]
    history: str = "bicubic"
    alpha: float = 0.1
    validation: str = "clamp"
    gamma: float = 1.0
    per_channel: bool = False
    estimate: str = "corrected"
    past: History = field(init=False)

    def __post_init__(self):
        self.past = History.none(self.size, 3 if self.per_channel else 1)

    @property
    def settings(self) -> dict[str, object]:
        """The same by the settings' names."""
        return {
            "temporal.history": self.history,
            "taa.alpha": self.alpha,
            "taa.validation": self.validation,
            "taa.gamma": self.gamma,
            "varianceblend.per_channel": self.per_channel,
            "varianceblend.estimate": self.estimate,
        }

    def step(
        self, color: np.ndarray, motion: np.ndarray, depth: np.ndarray | float = 1.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The filtered image, alpha and N of a new frame (H, W, 3) with a motion (H, W, 2) in pixels and a depth (H, W), negative
        where something nearer was beside the point before."""
        color, own = np.asarray(color, np.float64), np.asarray(motion, np.float64)
        depth = np.broadcast_to(depth, color.shape[:2])
        there = np.isfinite(color).all(axis=-1)
        mean, n, variance = self._resampled(_of_closest(own, np.abs(depth)))
        if self.kind == "varianceblend" and self.estimate == "corrected":
            n = np.where(_was_left(own, depth), 0, n)
        near = _windows(np.where(there[..., None], color, np.nan))  # (9, H, W, 3)
        if self.kind == "taa":
            mean, n = self._validated(mean, n, near, there)
            alpha = np.repeat(np.maximum(self.alpha, 1 / (n + 1))[..., None], 3, axis=-1)
            found = variance
        else:
            alpha, found = self._weights(mean, n, variance, near)
        has, alpha = (n > 0)[..., None], np.where(there[..., None], alpha, 0)
        alpha = np.where(has, alpha, there[..., None])
        y = np.where(there[..., None], color, 0)
        result = np.where(has, (1 - alpha) * mean + alpha * y, y)
        weight = alpha.mean(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            count = np.where(n > 0, n * 1 / (weight**2 * n + (1 - weight) ** 2 * 1), weight)
        carried = np.where(there[..., None], np.where(has, found, self._first(near)), variance)
        self.past = History(result, count, carried)
        return result, weight, count

    def _judged(self, color: np.ndarray) -> np.ndarray:
        return color if self.per_channel else (color * LUMINANCE).sum(axis=-1, keepdims=True)

    def _first(self, near: np.ndarray) -> np.ndarray:
        return _moments(self._judged(near))[3]

    def _validated(self, mean, n, near, there):
        low, high = np.nanmin(_filled(near), axis=0), np.nanmax(_filled(near), axis=0)
        if self.validation == "reject":
            n = np.where(there & ((mean < low) | (mean > high)).any(axis=-1), 0, n)
        elif self.validation == "clamp":
            mean = np.where(there[..., None], np.clip(mean, low, high), mean)
        elif self.validation == "clip":
            _, middle, variance, _ = _moments(near)
            reach = self.gamma * np.sqrt(variance)
            mean = np.where(there[..., None], np.clip(mean, middle - reach, middle + reach), mean)
        return mean, n

    def _weights(self, mean, n, known, near):
        count, middle, variance, unbiased = _moments(self._judged(near))
        squared = (self._judged(mean) - middle) ** 2
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.estimate == "published":
                alpha = 1 - variance / np.nanmean(
                    (self._judged(mean) - self._judged(near)) ** 2, axis=0
                )  # Eq. 4, 10, 11
                return np.broadcast_to(np.where(np.isnan(alpha), 1, alpha), mean.shape), known
            n = n[..., None]
            most = np.maximum(unbiased, known)
            bias = np.maximum(squared - most / n - unbiased / count, 0)
            alpha = 1 - most / (bias + most / n + most)
        alpha = np.where(np.isnan(alpha), 1 / (n + 1), alpha)
        return np.broadcast_to(alpha, mean.shape), known + alpha * (unbiased - known)

    def _resampled(self, motion):
        width, height = self.size
        x = np.arange(width) + motion[..., 0]
        y = np.arange(height)[:, None] + motion[..., 1]
        with np.errstate(invalid="ignore"):
            inside = (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)
        x, y = np.where(inside, x, 0), np.where(inside, y, 0)
        left, top = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = x - left, y - top
        all_there = np.concatenate([self.past.mean, self.past.count[..., None], self.past.variance], axis=-1)
        padded = np.pad(all_there, ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)))
        reach = (-1, 0, 1, 2) if self.history == "bicubic" else (0, 1)
        taps = np.stack([padded[top + j + MARGIN, left + i + MARGIN] for j in reach for i in reach])
        kernel = _catmull_rom if self.history == "bicubic" else _tent
        weight = np.stack([kernel(j - fy) * kernel(i - fx) for j in reach for i in reach])[..., None]
        full = np.clip((taps * weight).sum(axis=0), taps.min(axis=0), taps.max(axis=0))
        four = np.stack([padded[top + j + MARGIN, left + i + MARGIN] for j in (0, 1) for i in (0, 1)])
        tent = np.stack([_tent(j - fy) * _tent(i - fx) for j in (0, 1) for i in (0, 1)])[..., None]
        full[..., 4:] = (four * tent).sum(axis=0)[..., 4:]
        tent = tent * (four[..., 3:4] > 0)
        total = tent.sum(axis=0)
        some = (four * tent).sum(axis=0) / np.where(total > 0, total, 1)
        result = np.where((taps[..., 3] > 0).all(axis=0)[..., None], full, some)
        result[~inside] = 0
        return result[..., :3], result[..., 3], result[..., 4:]


def _of_closest(motion: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Each pixel's motion, or that of the closest of its neighbours, if that is closer."""
    result = motion.copy()
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            near = [(depth[y, x], 0, y, x)]
            for j in range(max(y - 1, 0), min(y + 2, height)):
                near += [(depth[j, i], 1, j, i) for i in range(max(x - 1, 0), min(x + 2, width))]
            _, _, j, i = min(near)
            result[y, x] = motion[j, i]
    return result


def _was_left(motion: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(H, W): which pixels move and had something nearer beside them, and have nothing such any more."""
    closest = minimum_filter(np.abs(depth), 3, mode="nearest")
    with np.errstate(invalid="ignore"):
        return (depth < 0) & ~(closest < np.abs(depth) * (1 - STILL_NEARER)) & (motion != 0).any(axis=-1)


def _catmull_rom(t: np.ndarray) -> np.ndarray:
    """The kernel with a = -1/2, by the distance from its middle."""
    t = np.abs(t)
    return np.where(t <= 1, 1.5 * t**3 - 2.5 * t**2 + 1, np.where(t < 2, -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2, 0))


def _tent(t: np.ndarray) -> np.ndarray:
    return np.maximum(1 - np.abs(t), 0)


def _windows(color: np.ndarray) -> np.ndarray:
    """(9, H, W, C): the 3x3 pixels about each, NaN where there is none."""
    padded = np.pad(color, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    height, width = color.shape[:2]
    return np.stack([padded[j : j + height, i : i + width] for j in range(3) for i in range(3)])


def _filled(near: np.ndarray) -> np.ndarray:
    """Without windows in which nothing is there, which are not looked at."""
    return np.where(np.isnan(near).all(axis=0), 0, near)


def _moments(near: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """How many there are, mean, variance (Eq. 10, each sum divided by the number), and that by the number less one."""
    near = _filled(near)
    count = (~np.isnan(near)).sum(axis=0)
    mean, variance = np.nanmean(near, axis=0), np.nanvar(near, axis=0)
    return count, mean, variance, np.where(count > 1, variance * count / np.maximum(count - 1, 1), 0)


class Kernels:
    """The filter's passes on made-up frames."""

    def __init__(self, device: Device, model: Model):
        self._device, self.size = device, model.size
        width, height = model.size
        resources = SceneResources(device, make_scene(soup(1, 1)))
        settings = resolve({}, model.settings)
        built = temporal(device, resources, model.size, settings, model.kind)
        self._color = device.empty((width * height, 3), np.float32)
        self._motion = device.empty((width * height + RUN, 2), np.float32)
        self._depth = device.empty(width * height + RUN, np.float32)
        inputs = {"color": self._color, "motion": self._motion, "depth": self._depth}
        passes = [p for p in built.passes if p.name != "motion"]
        buffers = [b for b in built.buffers if b.name not in inputs]
        outputs = {built.output, "aov_alpha", "aov_effective"}
        self.graph = FrameGraph(device, passes, buffers, outputs, inputs, exchanged=built.exchanged)
        self._state = PathState(camera_record(make_scene(soup(1, 1)).camera, model.size), (0, 0), 1)

    def step(
        self, color: np.ndarray, motion: np.ndarray, depth: np.ndarray | float = 1.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As of Model."""
        width, height = self.size
        self._color.set(np.ascontiguousarray(color, np.float32).reshape(-1, 3))
        moved = np.full((width * height + RUN, 2), np.nan, np.float32)  # what lies behind the image does not matter
        moved[: width * height] = motion.reshape(-1, 2)
        self._motion.set(moved)
        depths = np.full(width * height + RUN, np.nan, np.float32)
        depths[: width * height] = np.broadcast_to(depth, (height, width)).ravel()
        self._depth.set(depths)
        self.graph.run(self._state)
        found = [self.graph.of()[name].get() for name in ("filtered", "aov_alpha", "aov_effective")]
        return found[0].reshape(height, width, 3), found[1].reshape(height, width), found[2].reshape(height, width)

    def set_history(self, mean: np.ndarray, count: np.ndarray | float, variance: np.ndarray | float = 0.0) -> None:
        """Have the next frame find this: (H, W, 3), (H, W), (H, W, 1 or 3)."""
        width, height = self.size
        arrays = self.graph.of()
        pitch = -(-width // RUN) * RUN + 2 * RUN
        inside = np.s_[MARGIN : MARGIN + height, RUN : RUN + width]
        rows = np.zeros((height + 2 * MARGIN, pitch, 4), np.float32)
        rows[(*inside, np.s_[:3])], rows[(*inside, 3)] = mean, count
        arrays["history"].set(rows.reshape(-1, 4))
        if "variance" in arrays:
            channels = arrays["variance"].shape[1]
            carried = np.zeros((height + 2 * MARGIN, pitch, channels), np.float32)
            carried[(*inside, np.s_[: min(channels, 3)])] = variance
            arrays["variance"].set(carried.reshape(-1, channels))


def still(size: tuple[int, int]) -> np.ndarray:
    """No motion."""
    return np.zeros((*size[::-1], 2))


def pack_hits(
    far: np.ndarray, instance: np.ndarray, primitive: np.ndarray, uv: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """(pixels, 4) uint32: `surface` as the kernels have it. far: which pixels show the background, and of these the direction
    (pixels, 3) to it is told, of the others the rest; uv (pixels, 2) in [0, 1]."""
    x, y, z = (direction / np.abs(direction).sum(axis=1, keepdims=True)).T
    folded = np.where(z < 0, (1 - np.abs(y)) * np.sign(x), x), np.where(z < 0, (1 - np.abs(x)) * np.sign(y), y)
    octahedral = 0.5 + 0.5 * np.stack(folded, axis=1)
    fixed = np.rint(np.where(far[:, None], octahedral, uv) * ONE).astype(int)
    words = np.column_stack([fixed, primitive, instance]).astype(np.uint32)
    words[far, 2:] = NONE
    return words
