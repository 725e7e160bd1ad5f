"""What filters a method's finished images: passes that run in a graph of their own, once for each frame and eye."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import pyopencl.array as cl_array

from ..device import Device
from ..frame import Buffer, FrameGraph, Pass, needed


@dataclass(frozen=True)
class Filter:
    """Passes and the buffers that they may use; output: the buffer, (pixels, 3), that is the filtered image.

    Beside its own buffers a filter reads by name what the method's last run left for the eye: its `per_eye` and its
    persistent buffers, such as `color`, (pixels, 3), and `surface`, (pixels, 4); a filter of stereo images those of the other
    eye, too, as `other_<name>`. Where an earlier filter has made an image of `color`, that one has its name. exchanged: pairs
    of its own per-eye persistent buffers that change places before each run of an eye. A buffer `aov_<name>` is the AOV of
    that name; passes that write only what is not asked for do not run.
    """

    passes: tuple[Pass, ...]
    buffers: tuple[Buffer, ...]
    output: str
    exchanged: tuple[tuple[str, str], ...] = ()

    def wanted(self, aovs: Iterable[str]) -> set[str]:
        """The buffers that are wanted of it: its output, and those of these AOVs that it has."""
        own = {b.name for b in self.buffers}
        return {self.output} | {f"aov_{name}" for name in aovs} & own

    def inputs(self, aovs: Iterable[str]) -> set[str]:
        """The names of what it reads and does not itself hold, these AOVs being wanted."""
        running = needed(self.passes, self.wanted(aovs), self.exchanged)
        return {b for p in running for b in p.reads} - {b.name for b in self.buffers}

    def graph(
        self, device: Device, aovs: Iterable[str], inputs: Mapping[str, cl_array.Array], eyes: Sequence[str]
    ) -> FrameGraph:
        """A graph of it. inputs: an eye's, for their names and shapes. Raises as `FrameGraph` does."""
        return FrameGraph(device, self.passes, self.buffers, self.wanted(aovs), inputs, eyes, self.exchanged)
