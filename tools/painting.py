"""Procedural, tileable textures: noise, patterns of blocks, and the materials that more than one scene has.

A painter is a function of a random state that returns SIZE x SIZE colours from 0 to 1: RGB, or RGBA with an alpha mask. All
patterns are periodic: noise is white noise filtered in the Fourier domain, and block patterns repeat a whole number of
times. Colours are sRGB. The legacy `RandomState` is used because its stream never changes between NumPy versions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

SIZE = 512
JPEG_QUALITY = 86


def noise(rng: np.random.RandomState, exponent: float, lowest: float = 1.0, stretch: tuple[float, float] = (1.0, 1.0)):
    """Periodic noise of zero mean and unit deviation, (SIZE, SIZE).

    The amplitude falls as frequency ** -exponent from `lowest` cycles per tile on; `stretch` > 1 draws the pattern out
    along rows (first value: v) or columns (second value: u).
    """
    frequency = np.fft.fftfreq(SIZE, 1.0 / SIZE)
    radius = np.hypot(frequency[:, None] * stretch[0], frequency[None, :] * stretch[1])
    amplitude = np.where(radius >= lowest, np.maximum(radius, 1.0) ** -exponent, 0.0)
    field = np.fft.ifft2(np.fft.fft2(rng.random_sample((SIZE, SIZE)) - 0.5) * amplitude).real
    return field / field.std()


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    """0 below `low`, 1 above `high`, cubic between."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def mix(a, b, t: np.ndarray) -> np.ndarray:
    """Colours a and b (RGB, or (h, w, 3)) blended by t (h, w)."""
    return np.asarray(a) + (np.asarray(b) - np.asarray(a)) * t[..., None]


@dataclass(frozen=True)
class Blocks:
    """A pattern of blocks. column, row: (h, w) int, of the block; distance: (h, w), metres to the block's edge."""

    column: np.ndarray
    row: np.ndarray
    distance: np.ndarray

    def tone(self, rng: np.random.RandomState) -> np.ndarray:
        """A random number in [0, 1] for each block, spread over its pixels."""
        return rng.random_sample((self.row.max() + 1, self.column.max() + 1))[self.row, self.column]


def blocks(columns: int, rows: int, metres: float, offset: float = 0.0) -> Blocks:
    """`rows` x `columns` blocks over a tile of `metres`; every second row is moved by `offset` blocks."""
    centre = (np.arange(SIZE) + 0.5) / SIZE
    v = np.broadcast_to(centre[:, None] * rows, (SIZE, SIZE))
    row = np.floor(v).astype(int)
    u = centre[None, :] * columns + offset * (row % 2)
    column = np.floor(u).astype(int)
    edge_u = (0.5 - np.abs(u - column - 0.5)) * metres / columns
    edge_v = (0.5 - np.abs(v - row - 0.5)) * metres / rows
    return Blocks(column % columns, row, np.minimum(edge_u, edge_v))


def bumps(height: np.ndarray, metres: float) -> np.ndarray:
    """The normal map, as RGB, of a periodic height field in metres over a tile of `metres`; green is up in the picture."""
    step = metres / SIZE
    du = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / (2 * step)
    dv = (np.roll(height, 1, 0) - np.roll(height, -1, 0)) / (2 * step)
    normal = np.stack([-du, -dv, np.ones_like(du)], axis=-1)
    return 0.5 + 0.5 * normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def plaster(rng: np.random.RandomState) -> np.ndarray:
    """Ochre lime plaster with weather stains."""
    stains = smoothstep(0.4, 2.2, noise(rng, 1.6, 2)) * 0.5
    color = mix((0.88, 0.79, 0.635), (0.78, 0.67, 0.52), stains)
    return color + (0.016 * noise(rng, 1.3, 3) + 0.012 * noise(rng, 0.5, 20))[..., None]


def limestone(rng: np.random.RandomState) -> np.ndarray:
    """Pale, fine-grained stone with darker pits."""
    color = mix((0.83, 0.79, 0.70), (0.72, 0.665, 0.57), 0.7 * smoothstep(-0.6, 2.4, noise(rng, 1.3, 2)))
    pits = smoothstep(1.9, 2.8, noise(rng, 0.9, 24))
    return mix(color, (0.52, 0.46, 0.38), pits * 0.7) + (0.016 * noise(rng, 0.6, 8))[..., None]


def brick(rng: np.random.RandomState) -> np.ndarray:
    """Hand-made bricks, 267 x 67 mm, in running bond with lime mortar."""
    pattern = blocks(6, 24, 1.6, 0.5)
    body = mix((0.66, 0.37, 0.27), (0.50, 0.26, 0.20), pattern.tone(rng))
    body = mix(body, (0.74, 0.52, 0.37), smoothstep(0.75, 0.95, pattern.tone(rng)))
    body = body + (0.035 * noise(rng, 0.9, 6) + 0.02 * noise(rng, 0.3, 40))[..., None]
    mortar = np.asarray((0.76, 0.70, 0.61)) + (0.03 * noise(rng, 0.6, 20))[..., None]
    return mix(mortar, body, smoothstep(0.003, 0.008, pattern.distance + 0.0016 * noise(rng, 1.0, 12)))


def veins(rng: np.random.RandomState) -> np.ndarray:
    """Marble veins in [0, 1], (SIZE, SIZE): the zero lines of noise, bent by other noise."""
    bend = (10.0 * np.stack([noise(rng, 1.8, 2), noise(rng, 1.8, 2)])).astype(int)
    rows, columns = np.indices((SIZE, SIZE))
    field = noise(rng, 1.7, 2)[(rows + bend[0]) % SIZE, (columns + bend[1]) % SIZE]
    return (1.0 - smoothstep(0.0, 0.16, np.abs(field))) * smoothstep(-0.8, 1.2, noise(rng, 1.5, 2))


def marble(rng: np.random.RandomState) -> np.ndarray:
    """White marble with grey veins."""
    cloud = smoothstep(-1.5, 2.0, noise(rng, 1.6, 1))
    return mix(mix((0.91, 0.90, 0.87), (0.80, 0.79, 0.77), cloud), (0.48, 0.47, 0.47), veins(rng) * 0.75)


def wood(rng: np.random.RandomState) -> np.ndarray:
    """Dark oak planks, 0.2 m wide; the grain runs along u."""
    pattern = blocks(1, 8, 1.6)
    grain = noise(rng, 0.9, 4, (1.0, 18.0))
    color = mix((0.54, 0.37, 0.24), (0.43, 0.28, 0.18), pattern.tone(rng))
    color = color + (0.05 * grain + 0.02 * noise(rng, 0.6, 10, (1.0, 6.0)))[..., None]
    gap = np.abs(((np.arange(SIZE) + 0.5) / SIZE * 8 + 0.5) % 1.0 - 0.5)[:, None] * 0.2
    return mix((0.12, 0.08, 0.05), color, np.broadcast_to(smoothstep(0.001, 0.006, gap), (SIZE, SIZE)))


def leaf(rng: np.random.RandomState) -> np.ndarray:
    """One leaf over the whole picture: the midrib along v, paler veins to both sides."""
    t = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(t, t)
    side = np.abs(u - 0.5)
    rib = np.maximum(
        1.0 - smoothstep(0.01, 0.035, side), 0.5 * smoothstep(0.85, 1.0, np.cos(2 * np.pi * (9 * v + 6 * side)))
    )
    color = mix((0.25, 0.40, 0.13), (0.42, 0.52, 0.20), rib)
    return color + (0.03 * noise(rng, 1.2, 2))[..., None]


@dataclass(frozen=True)
class Texture:
    """How a texture is painted, the metres that its tile covers, and its pixels along a side. format: jpg, or png for what
    has an alpha mask or few colours."""

    paint: Callable[[np.random.RandomState], np.ndarray]
    metres: float
    pixels: int = SIZE
    format: str = "jpg"


def write_textures(folder: Path, textures: dict[str, Texture]) -> None:
    """Paint the textures, seeded by their places in `textures`, and write them to `folder` as NAME.jpg or NAME.png."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed, (name, texture) in enumerate(textures.items()):
        color = texture.paint(np.random.RandomState(seed))
        step = SIZE // texture.pixels
        color = color.reshape(texture.pixels, step, texture.pixels, step, -1).mean(axis=(1, 3))
        image = Image.fromarray((np.clip(color, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8))
        if texture.format == "png":
            image.save(folder / f"{name}.png", optimize=True)
        else:
            image.save(folder / f"{name}.jpg", quality=JPEG_QUALITY, subsampling=0)
