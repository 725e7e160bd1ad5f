"""How long kernels take: by the device's own clock, which profiling events read."""

from collections.abc import Callable
from dataclasses import dataclass

import pyopencl as cl
import pyopencl.array as cl_array

from ..device import Device, event_seconds
from ..program import Kernel


def timed(launch: Callable[[], cl.Event], repeats: int) -> tuple[float, ...]:
    """Seconds of each of so many launches, after one that warms up."""
    seconds = []
    for _ in range(repeats + 1):
        event = launch()
        event.wait()
        seconds.append(event_seconds(event))
    return tuple(seconds[1:])


@dataclass(frozen=True)
class Launch:
    """kernel: its name. count: work-items. nbytes: of the arrays that it was given, each once. longest: the most entries that
    one of these has along a dimension."""

    kernel: str
    event: cl.Event
    count: int
    nbytes: int
    longest: int

    @property
    def seconds(self) -> float:
        """How long it took, once it is finished."""
        return event_seconds(self.event)


class WatchedKernel:
    """A kernel whose launches are written down."""

    def __init__(self, kernel: Kernel, launches: list[Launch]):
        self._kernel, self._launches = kernel, launches
        self.signature = kernel.signature

    def __call__(self, *values: object, count: int) -> cl.Event | None:
        """As of `Kernel`."""
        event = self._kernel(*values, count=count)
        if event is not None:
            arrays = [v for v in values if isinstance(v, cl_array.Array)]
            nbytes, longest = sum(a.nbytes for a in arrays), max((max(a.shape) for a in arrays), default=0)
            self._launches.append(Launch(self.signature.name, event, count, nbytes, longest))
        return event

    run = Kernel.run


class WatchedDevice(Device):
    """A device that writes down the launches of all its kernels."""

    def __init__(self, spec: str | None, threads: int | None):
        super().__init__(spec, threads)
        self._launches: list[Launch] = []

    def program(self, name: str, **defines: int | float | bool) -> dict[str, WatchedKernel]:
        """As of `Device`."""
        program = super().program(name, **defines)
        return {kernel.signature.name: WatchedKernel(kernel, self._launches) for kernel in program}

    def take_launches(self) -> list[Launch]:
        """The launches since the last call, finished."""
        self.queue.finish()
        taken = self._launches[:]
        self._launches.clear()
        return taken
