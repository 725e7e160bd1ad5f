"""The atrium's textures: `python tools/make_atrium_textures.py --out data/atrium/textures`.

Each texture is a function of a seed and covers a known number of metres, so that UVs can be laid out in metres.
"""

import argparse
from pathlib import Path

import numpy as np
from painting import (
    SIZE,
    Texture,
    blocks,
    brick,
    leaf,
    limestone,
    marble,
    mix,
    noise,
    plaster,
    smoothstep,
    veins,
    wood,
    write_textures,
)


def whitewash(rng: np.random.RandomState) -> np.ndarray:
    """White lime wash for vaults."""
    color = mix((0.90, 0.875, 0.82), (0.80, 0.76, 0.69), smoothstep(0.6, 2.6, noise(rng, 1.5, 2)) * 0.6)
    return color + (0.012 * noise(rng, 1.0, 4))[..., None]


def ashlar(rng: np.random.RandomState) -> np.ndarray:
    """Dressed stone blocks, 1.0 x 0.4 m, in running bond with fine joints."""
    pattern = blocks(2, 5, 2.0, 0.5)
    base = limestone(rng) * (0.90 + 0.14 * pattern.tone(rng))[..., None]
    joint = 1.0 - smoothstep(0.003, 0.010, pattern.distance + 0.0012 * noise(rng, 1.0, 8))
    return mix(base, (0.50, 0.45, 0.38), joint * 0.85)


def court_tiles(rng: np.random.RandomState) -> np.ndarray:
    """Slabs of 0.6 m, cream and rose stone in a chequer, worn at the edges."""
    pattern = blocks(4, 4, 2.4)
    chequer = ((pattern.column + pattern.row) % 2).astype(float)
    tone = pattern.tone(rng)
    cream = mix((0.80, 0.75, 0.66), (0.73, 0.67, 0.57), tone)
    rose = mix((0.60, 0.42, 0.35), (0.52, 0.36, 0.31), tone)
    color = mix(mix(cream, rose, chequer), (0.86, 0.81, 0.74), veins(rng) * 0.35)
    color = color + (0.022 * noise(rng, 1.2, 3) + 0.012 * noise(rng, 0.4, 30))[..., None]
    joint = 1.0 - smoothstep(0.004, 0.011, pattern.distance + 0.0012 * noise(rng, 1.0, 8))
    return mix(color, (0.40, 0.35, 0.29), joint * 0.9)


def terracotta(rng: np.random.RandomState) -> np.ndarray:
    """Fired-clay tiles of 0.2 m."""
    pattern = blocks(6, 6, 1.2)
    color = mix((0.74, 0.48, 0.34), (0.63, 0.38, 0.27), pattern.tone(rng))
    color = color + (0.03 * noise(rng, 1.1, 4))[..., None]
    return mix((0.55, 0.48, 0.41), color, smoothstep(0.002, 0.006, pattern.distance + 0.0008 * noise(rng, 1.0, 10)))


def damask(rng: np.random.RandomState) -> np.ndarray:
    """Pale woven cloth with a tone-on-tone pattern of lozenges and rosettes, to be tinted by the base colour."""
    t = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(t, t)
    rising, falling = (2 * u + v) % 1.0, (2 * u - v) % 1.0
    lattice = np.minimum(np.minimum(rising, 1.0 - rising), np.minimum(falling, 1.0 - falling))
    du, dv = (rising + falling - 1.0) / 4, (rising - falling) / 2
    petals = np.hypot(du, dv) - 0.09 - 0.04 * np.cos(6 * np.arctan2(dv, du))
    figure = np.maximum(1.0 - smoothstep(0.03, 0.05, lattice), 1.0 - smoothstep(-0.01, 0.01, petals))
    thread = np.sin(2 * np.pi * 128 * u) * np.sin(2 * np.pi * 128 * v)
    value = mix((0.74,) * 3, (0.97, 0.93, 0.82), figure)
    return value + (0.03 * thread + 0.02 * noise(rng, 0.3, 30, (1.0, 3.0)))[..., None]


TEXTURES = {
    "plaster": Texture(plaster, 3.0),
    "whitewash": Texture(whitewash, 3.0, 256),
    "limestone": Texture(limestone, 2.0),
    "ashlar": Texture(ashlar, 2.0),
    "brick": Texture(brick, 1.6),
    "marble": Texture(marble, 1.6),
    "court_tiles": Texture(court_tiles, 2.4),
    "terracotta": Texture(terracotta, 1.2),
    "wood": Texture(wood, 1.6),
    "damask": Texture(damask, 0.8),
    "leaf": Texture(leaf, 1.0, 128),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "data" / "atrium" / "textures")
    write_textures(parser.parse_args().out, TEXTURES)


if __name__ == "__main__":
    main()
