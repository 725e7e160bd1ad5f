"""The statistics file: one JSON object, what `Renderer.stats()` says and the entry of each frame under `frames`."""

import json
import os
from collections.abc import Iterable, Mapping

from .files import atomic_path


def write_stats(path: str | os.PathLike, stats: Mapping[str, object], frames: Iterable[Mapping[str, object]]) -> None:
    """Write the statistics of a render, whole or not at all.

    stats: `Renderer.stats()`. frames: each frame's `stats`. NumPy numbers are written as numbers. Raises Error where the
    file cannot be written, ValueError for a number that JSON has no form for (NaN, infinity).
    """
    text = json.dumps(
        {**stats, "frames": list(frames)}, indent=1, allow_nan=False, default=lambda number: number.item()
    )
    with atomic_path(path) as part:
        part.write_text(text + "\n", encoding="utf-8")
