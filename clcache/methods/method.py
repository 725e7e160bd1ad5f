"""What a method is given, and what it is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..device import Device
from ..frame import Buffer, Pass
from ..memo import Memo
from ..resources import SceneResources

if TYPE_CHECKING:
    from ..octree import Octree


class Pace(Protocol):
    """What adapts a method's work to how long it takes."""

    def observe(self, passes: Mapping[str, float], is_moving: bool) -> None:
        """Told after each run of an eye: seconds by pass, and whether the eye moved since the frame before."""


@dataclass(frozen=True)
class MethodSetup:
    """What a method builds its passes from. size: width, height. settings: all, by dotted name. stereo_blend: one of
    STEREO_BLENDS. memo: one of MEMOS."""

    device: Device
    scene: SceneResources
    size: tuple[int, int]
    settings: Mapping[str, bool | int | float | str]
    stereo_blend: str = "none"
    memo: str = "off"


@dataclass(frozen=True)
class Method:
    """Passes and the buffers that they may use. `color`, `ray_counts` and `aov_<name>` are what a frame is read from.

    exchanged: pairs of buffers that change places before each run of an eye. cache: names of the buffers that are the
    method's cache. world: names of persistent buffers, which the eyes share, that depend on the scene alone, and not on where
    it is seen from: another sequence can begin with them. counters: what the elements of the buffer `counters` count, in order; levels: those that
    say what there is after an update, and not what it did. primary: those counters whose sum
    is the number of primary rays; where there are none, it is a ray for each sample of each pixel. blend: where the setup asks
    for one, passes that join what the eyes know, run for each eye after all eyes' own passes. They read this eye's per-eye buffers by their names and
    the other's as `other_<name>`, and the persistent ones that the eyes share; they write `blended`, which is then the
    eye's colour, and may use blend_buffers. What they read is therefore never blended itself. memo: what is known of the
    memoization of the scene's graphs, or None; its counters are those of the buffer `memo_counters`. octree: the cells of the
    scene's surfaces, of methods that keep light in them. pace: what is told how long the passes took, or None.
    """

    passes: tuple[Pass, ...]
    buffers: tuple[Buffer, ...]
    exchanged: tuple[tuple[str, str], ...] = ()
    cache: tuple[str, ...] = ()
    world: tuple[str, ...] = ()
    counters: tuple[str, ...] = ()
    levels: tuple[str, ...] = ()
    primary: tuple[str, ...] = ()
    blend: tuple[Pass, ...] = ()
    blend_buffers: tuple[Buffer, ...] = ()
    memo: Memo | None = None
    octree: "Octree | None" = None
    pace: Pace | None = None


@dataclass(frozen=True)
class PathState:
    """What the passes of one eye's frame are told. camera: Camera record. key: of the frame's random numbers. samples: for
    each pixel, of which those before `begin` are there already; sample: the current one. update: how many times the
    passes have run for this eye before. batch: the current one of those that a list is worked off in. eye: 0, of a stereo
    pair's right eye 1. camera_before: this eye's Camera record of the frame before; None where that was not rendered right
    before, and so there is no history. is_moving: whether this eye's camera is known to differ from that of the frame rendered
    last, whatever its number. other: the other eye's Camera record, for the passes of a stereo blend.

    Of a method with a cache, whose images have the samples of many frames, `key` is the same in all of them and `sample`
    the update, so that a pixel's random sequence goes on; `samples` is what one update brings, 1.
    """

    camera: np.void
    key: tuple[int, int]
    samples: int
    begin: int = 0
    sample: int = 0
    update: int = 0
    batch: int = 0
    eye: int = 0
    camera_before: np.void | None = None
    is_moving: bool = False
    other: np.void | None = None

    @property
    def sampling(self) -> dict[str, int]:
        """The scalars by which kernels draw a sample's numbers."""
        return {"sample": self.sample, "key0": self.key[0], "key1": self.key[1]}
