"""The pictures of the MaterialX documents in data/graphs: `python tools/make_graph_pictures.py --out data/graphs/pictures`."""

import argparse
from pathlib import Path

import numpy as np
from painting import SIZE, Blocks, Texture, blocks, bumps, mix, noise, smoothstep, write_textures

METRES = 1.6


def staves() -> Blocks:
    """Staves of 400 x 100 mm in running bond."""
    return blocks(4, 16, METRES, 0.5)


def parquet(rng: np.random.RandomState) -> np.ndarray:
    """Oak staves, each of its own shade; the grain runs along u."""
    color = mix((0.66, 0.50, 0.33), (0.52, 0.36, 0.22), staves().tone(rng))
    return color + (0.05 * noise(rng, 0.9, 4, (1.0, 18.0)))[..., None]


def parquet_wear(rng: np.random.RandomState) -> np.ndarray:
    """Roughness: varnish, worn off in places and absent in the gaps."""
    worn = smoothstep(0.2, 2.0, noise(rng, 1.5, 2))
    gap = 1.0 - smoothstep(0.001, 0.004, staves().distance)
    return np.repeat((0.25 + 0.4 * np.maximum(worn, gap))[..., None], 3, axis=2)


def parquet_relief(rng: np.random.RandomState) -> np.ndarray:
    """Normals of staves with rounded edges."""
    del rng
    return bumps(0.002 * smoothstep(0.0, 0.006, staves().distance), METRES)


def arrow(rng: np.random.RandomState) -> np.ndarray:
    """A red arrow that points up, on a white ground, with a blue bar at the picture's left: what is upright is seen at once."""
    del rng
    u, v = np.meshgrid(*[(np.arange(SIZE) + 0.5) / SIZE] * 2)
    head = (v > 0.15) & (v < 0.5) & (np.abs(u - 0.5) < (v - 0.15) * 0.8)
    shaft = (v >= 0.5) & (v < 0.85) & (np.abs(u - 0.5) < 0.1)
    color = mix((0.95, 0.95, 0.95), (0.85, 0.1, 0.08), (head | shaft).astype(float))
    return mix(color, (0.1, 0.2, 0.7), (u < 0.08).astype(float))


TEXTURES = {
    "parquet_color": Texture(parquet, METRES, 256),
    "parquet_roughness": Texture(parquet_wear, METRES, 256),
    "parquet_normal": Texture(parquet_relief, METRES, 256),
    "arrow": Texture(arrow, 1.0, 64, "png"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "data" / "graphs" / "pictures")
    write_textures(parser.parse_args().out, TEXTURES)


if __name__ == "__main__":
    main()
