#!/usr/bin/env python3
"""Make the pictures of the documentation's gallery: run each command as the page prints it, and write docs/gallery/NAME.webp.

    python tools/make_gallery.py [NAME ...]

Commands run in the project's folder, and leave their files in out/gallery; those of a picture may read what others before it left. A picture of one layer is stretched from 0 to its largest
value; layers of three channels are shown as they are.
"""

import argparse
import io
import os
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import OpenEXR
from cmap import Colormap
from PIL import Image

from clcache import Error, SettingError
from clcache.cli.terminal import say
from clcache.metrics.heatmap import COLORS
from clcache.output.files import atomic_path

ROOT = Path(__file__).resolve().parent.parent
GALLERY = ROOT / "docs" / "gallery.toml"
MOST_BYTES = 120_000
GAP = 8  # pixels between pictures side by side


def main(argv: Sequence[str] | None = None) -> int:
    """Make the pictures that the arguments name, or all. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", metavar="NAME", nargs="*", help="which (default: all)")
    args = parser.parse_args(argv)
    pictures = tomllib.loads(GALLERY.read_text(encoding="utf-8"))["picture"]
    try:
        for picture in chosen(pictures, args.names):
            make(picture)
    except Error as error:
        say(f"make_gallery: error: {error}")
        return 2 if isinstance(error, SettingError) else 1
    return 0


def chosen(pictures: list[dict], names: Sequence[str]) -> list[dict]:
    """Those of these names; all if there are none. Raises SettingError for a name that none has."""
    known = {p["name"] for p in pictures}
    for name in names:
        if name not in known:
            raise SettingError(f"{name}: no picture of docs/gallery.toml; expected one of {', '.join(sorted(known))}")
    return [p for p in pictures if not names or p["name"] in names]


def commands(picture: dict) -> list[list[str]]:
    """The arguments of each of a picture's commands, behind `clcache`."""
    lines = [shlex.split(line) for line in picture["command"].strip().splitlines()]
    return [words[1:] for words in lines if words[0] == "clcache"]


def make(picture: dict) -> None:
    """Run a picture's commands, and write it. Raises Error where one fails."""
    for words in commands(picture):
        say(shlex.join(["clcache", *words]))
        path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        done = subprocess.run(
            [sys.executable, "-m", "clcache", *words], cwd=ROOT, env={**os.environ, "PYTHONPATH": path}
        )
        if done.returncode:
            raise Error(f"{picture['name']}: the command above failed with exit code {done.returncode}")
    parts = [
        layer(ROOT / file, picture["layer"]) if "layer" in picture else shown(ROOT / file) for file in picture["shows"]
    ]
    target = GALLERY.parent / "gallery" / f"{picture['name']}.webp"
    target.parent.mkdir(exist_ok=True)
    with atomic_path(target) as part:
        part.write_bytes(encoded(side_by_side(parts)))
    say(f"{target.relative_to(ROOT)}: {target.stat().st_size} bytes")


def shown(file: Path) -> np.ndarray:
    """(H, W, 3) uint8 of a picture file."""
    try:
        with Image.open(file) as picture:
            return np.asarray(picture.convert("RGB"))
    except OSError as error:
        raise Error(f"{file}: cannot be read ({error}); expected a picture that the commands make") from None


def layer(file: Path, name: str) -> np.ndarray:
    """(H, W, 3) uint8 of a layer of an EXR file."""
    with OpenEXR.File(str(file)) as opened:
        channels = opened.channels()
        values = np.asarray(channels[name].pixels, np.float32)
    if values.ndim == 3:
        return (np.clip(values[..., :3], 0, 1) * 255 + 0.5).astype(np.uint8)
    known = np.where(np.isfinite(values), values, 0)
    colors = Colormap(COLORS)(known / max(float(known.max()), 1e-9))
    return np.rint(colors[..., :3] * 255).astype(np.uint8)


def side_by_side(parts: Sequence[np.ndarray]) -> Image.Image:
    """Pictures of the same height in a row, with a white gap between."""
    gap = np.full((parts[0].shape[0], GAP, 3), 255, np.uint8)
    row = [p for part in parts for p in (gap, part)][1:]
    return Image.fromarray(np.concatenate(row, axis=1))


def encoded(picture: Image.Image) -> bytes:
    """As WebP, as good as it may be within MOST_BYTES."""
    for quality in (90, 80, 70, 60, 50, 40, 30):
        stream = io.BytesIO()
        picture.save(stream, "WEBP", quality=quality, method=6)
        if stream.tell() <= MOST_BYTES:
            return stream.getvalue()
    raise Error(f"a picture of {picture.width}x{picture.height} pixels takes more than {MOST_BYTES} bytes")


if __name__ == "__main__":
    raise SystemExit(main())
