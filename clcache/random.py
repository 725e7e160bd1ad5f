"""The host's side of `cl/common/random.cl`: the key that a frame's random numbers depend on, and the same hash in NumPy."""

import numpy as np

_MASK = (1 << 64) - 1


def stream_key(seed: int, frame: int) -> tuple[int, int]:
    """Two 32-bit words that depend on every bit of seed and frame (64 bits each; two rounds of SplitMix64's mixer)."""
    mixed = _mix(_mix(seed & _MASK) ^ (frame & _MASK))
    return mixed & 0xFFFFFFFF, mixed >> 32


def _mix(x: int) -> int:
    x = (x + 0x9E3779B97F4A7C15) & _MASK
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & _MASK
    return x ^ (x >> 31)


def pcg4d(v: np.ndarray) -> np.ndarray:
    """PCG4D of each row. v: (n, 4) uint32. Returns (n, 4) uint32. (Jarzynski and Olano 2020.)"""
    x, y, z, w = (v * np.uint32(1664525) + np.uint32(1013904223)).T.copy()
    for last in (False, True):
        x += y * w
        y += z * x
        z += x * y
        w += y * z
        if not last:
            x, y, z, w = (c ^ (c >> np.uint32(16)) for c in (x, y, z, w))
    return np.stack([x, y, z, w], axis=1)


def random4(pixel: np.ndarray, sample: int, dimension: int, key: tuple[int, int]) -> np.ndarray:
    """Four numbers in [0, 1) for each pixel. pixel: (n,) uint32. Returns (n, 4) float32."""
    v = np.empty((len(pixel), 4), np.uint32)
    v[:, 0], v[:, 1], v[:, 2], v[:, 3] = pixel, sample, dimension ^ key[0], key[1]
    return (pcg4d(v) >> np.uint32(8)).astype(np.float32) * np.float32(2**-24)
