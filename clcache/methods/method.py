"""What a method is given, and what it is."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..device import Device
from ..frame import Buffer, Pass
from ..resources import SceneResources


@dataclass(frozen=True)
class MethodSetup:
    """What a method builds its passes from. size: width, height. settings: all, by dotted name."""

    device: Device
    scene: SceneResources
    size: tuple[int, int]
    settings: Mapping[str, bool | int | float | str]


@dataclass(frozen=True)
class Method:
    """Passes and the buffers that they may use. `color`, `ray_counts` and `aov_<name>` are what a frame is read from."""

    passes: tuple[Pass, ...]
    buffers: tuple[Buffer, ...]


@dataclass(frozen=True)
class PathState:
    """What the passes of one eye's frame are told. camera: Camera record. key: of the frame's random numbers. samples: for
    each pixel, of which those before `begin` are there already; sample: the current one."""

    camera: np.void
    key: tuple[int, int]
    samples: int
    begin: int = 0
    sample: int = 0

    @property
    def sampling(self) -> dict[str, int]:
        """The scalars by which kernels draw a sample's numbers."""
        return {"sample": self.sample, "key0": self.key[0], "key1": self.key[1]}
