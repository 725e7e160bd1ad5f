"""The cache of tiles: what hits get from it, and how missing tiles are built (`cl/memo/tile.cl`; MaterialMemo, sections 4.6, 5.4)."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device
from ..errors import SettingError
from ..frame import Buffer

if TYPE_CHECKING:
    from .materials import GraphSetup

LANES = 32  # of a lane group, and most texels of a tile
_RUN = 16  # hits that one work-item goes through which builds alone, as in cl/memo/tile.cl
_STORAGE = {"entry": "TEXELS_IN_ENTRY", "buffer": "TEXELS_IN_BUFFER", "image2d": "TEXELS_IN_IMAGE2D", "image3d": "TEXELS_IN_IMAGE3D"}  # fmt: skip
_TILES = "memo_tiles"


def tile_size(settings: Mapping[str, object]) -> tuple[int, int]:
    """Width and height of a tile, in stored texels."""
    width, height = settings["memo.tile"].split("x")
    return int(width), int(height)


def tile_texels(settings: Mapping[str, object]) -> int:
    """Stored texels of a tile."""
    width, height = tile_size(settings)
    return width * height


def tile_defines(settings: Mapping[str, object], record_words: int, value_words: int) -> dict[str, int | bool]:
    """What kernels over tiles are specialised by, besides what those of all caches are. record_words: what the table needs of a
    record; value_words: what a texel's values take."""
    width, height = tile_size(settings)
    stride = record_words + (width * height * value_words if settings["memo.layout"] == "entry" else 0)
    return {
        "RECORD_STRIDE": -(-stride // 2) * 2,  # some words of a record are 64-bit numbers
        "TILE_WIDTH": width,
        "TILE_HEIGHT": height,
        "BILINEAR": settings["memo.filter"] == "bilinear",
        "SERIAL": settings["memo.builder"] == "serial",
        "GROUPED": settings["memo.grouped"],
        **{define: settings["memo.layout"] == layout for layout, define in _STORAGE.items()},
    }


def image_shape(settings: Mapping[str, object], channels: int, capacity: int) -> tuple[int, ...]:
    """Of the image that holds so many tiles: (rows, columns, 4), or (layers, rows, columns, 4), as cl/memo/tile_store.cl divides it up.
    Tiles are laid side by side up to a width, and in three dimensions a height, that every device with images has."""
    width, height = tile_size(settings)
    quads = -(-channels // 4)
    if settings["memo.layout"] == "image2d":
        across = min(8192 // (width * quads), capacity)
        return -(-capacity // across) * height, across * width * quads, 4
    across = min(2048 // width, capacity)
    down = min(2048 // height, -(-capacity // across))
    return -(-capacity // (across * down)) * quads, down * height, across * width, 4


def tile_buffers(settings: Mapping[str, object], channels: int, capacity: int, n: int) -> list[Buffer]:
    """Where the tiles of n hits are, and the texels of so many tiles, unless they are in the table's records."""
    is_half, layout = settings["memo.precision"] == "half", settings["memo.layout"]
    requests = [Buffer("memo_cell", (4, n), "i4"), Buffer("memo_within", (2, n))]
    if layout == "entry":
        return requests
    if layout == "buffer":
        words = tile_texels(settings) * (-(-channels // 2) if is_half else channels)
        return [*requests, Buffer(_TILES, (capacity, words), "u4", persistent=True)]
    shape = image_shape(settings, channels, capacity)
    return [*requests, Buffer(_TILES, shape, "f2" if is_half else "f4", persistent=True, is_image=True)]


def check_tiles(device: Device, settings: Mapping[str, object], channels: int, capacity: int) -> None:
    """Raise SettingError where the device cannot store tiles as the settings say."""
    layout = settings["memo.layout"]
    if not layout.startswith("image"):
        return
    if not device.proves("images"):
        raise SettingError(
            f"setting memo.layout: {layout} needs images that a kernel can read and write, which {device.name} lacks; "
            "expected buffer or entry"
        )
    limits, shape = device.image_limits(3 if layout == "image3d" else 2), image_shape(settings, channels, capacity)
    if any(size > limit for size, limit in zip(shape[-2::-1], limits, strict=True)):
        raise SettingError(
            f"setting memo.capacity: {capacity} tiles take an image of {' x '.join(map(str, shape[-2::-1]))} texels, and the largest "
            f"of {device.name} has {' x '.join(map(str, limits))}; expected fewer, or memo.layout buffer"
        )


class TileLookUp:
    """Find the values of a queue's hits in the cache of tiles, and build the tiles that are missing."""

    def __init__(self, setup: "GraphSetup"):
        device, settings = setup.device, setup.settings
        self._scene, self._memo, self._is_serial = setup.scene, setup.memo, settings["memo.builder"] == "serial"
        native = not self._is_serial and device.proves("lanes")
        program = device.program("memo/tile.cl", setup.generated, **setup.defines, NATIVE_SUBGROUPS=native)
        self._kernel = program["look_up_tiles"]
        self._evaluate = device.program("memo/evaluate.cl", setup.generated, **setup.scene.defines)["evaluate"]

    def run(
        self, arrays: Mapping[str, cl_array.Array], scalars: Mapping[str, int | float], places: int
    ) -> Iterable[cl.Event | None]:
        """First the hits whose graphs are not memoized, in the first turn; then the others, in groups of lanes or runs. scalars:
        capacity, probe, stamp, turn, turns, light_only and n. places: of the queue, from the first on."""
        n, scene = scalars["n"], self._scene.arrays
        if scalars["turn"] == 0 and not (self._memo and self._memo.memoizes_all):
            yield self._evaluate.run(places, arrays, scene, n=n, light_only=scalars["light_only"])
        tiles = {name: arrays[_TILES] for name in (_TILES, "tiles_read", "tiles_written") if _TILES in arrays}
        known = {name: scalars[name] for name in ("capacity", "probe", "stamp", "turn", "turns", "n")}
        yield self._kernel.run(-(-places // _RUN) if self._is_serial else places, tiles, arrays, scene, **known)
