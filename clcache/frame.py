"""The frame graph: passes over buffers.

A pass names the buffers that it reads and those that it writes (a buffer that it changes is in both). From that follows
everything else: passes that no output needs do not run, buffers that no running pass touches are not allocated, a
pass comes after those that write what it reads, and the time of each is what the device measured.

Passes that write the same buffer keep the order in which they are listed, and so does a reader that is listed after one of
them; a reader that is listed before all writers of a buffer gets what the last of them leaves. `persistent` buffers
keep their contents, zeros at first, from one run to the next: a reader listed before the writers gets what the run before left.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from .device import Device, event_seconds

# Finished commands are timed and forgotten in batches: an event kept for each launch of a long frame would fill memory.
_EVENTS_IN_FLIGHT = 256


@dataclass(frozen=True)
class Buffer:
    """A named array of the graph: its shape and dtype; `persistent` if its contents, zeros at first, outlive a run."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype | type = np.float32
    persistent: bool = False

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return int(np.prod(self.shape, dtype=np.int64)) * np.dtype(self.dtype).itemsize


class Pass:
    """One step of a frame. Subclasses set `name`, `reads` and `writes`, and implement `run`.

    `run(arrays, state)` enqueues the work: arrays maps a buffer's name to its device array, state is what the method
    hands to `FrameGraph.run`. It yields the events of what it enqueued (None for a launch of nothing).
    """

    name: str
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()

    def run(self, arrays: Mapping[str, cl_array.Array], state: object) -> Iterable[cl.Event | None]:
        """Enqueue the pass's work and yield its events."""
        raise NotImplementedError


class Repeat(Pass):
    """Passes that run `count(state)` times over; before each time, `advance(state, index)` gives the state for it."""

    def __init__(
        self,
        name: str,
        passes: Sequence[Pass],
        count: Callable[[object], int],
        advance: Callable[[object, int], object],
    ):
        self.name, self.passes, self.count, self.advance = name, tuple(passes), count, advance
        self.writes = tuple(dict.fromkeys(b for p in passes for b in p.writes))
        first_written: set[str] = set()
        reads: dict[str, None] = {}
        for p in passes:
            reads.update((b, None) for b in p.reads if b not in first_written)
            first_written.update(p.writes)
        self.reads = tuple(reads)

    def keeping(self, passes: Sequence[Pass]) -> "Repeat":
        """The same repetition of only these passes."""
        return Repeat(self.name, passes, self.count, self.advance)


class FrameGraph:
    """The passes that the outputs need, in order, with their buffers allocated.

    inputs: arrays that exist already, by name. outputs: names of the buffers that are wanted after a run; their names
    may be of declared buffers only. Raises ValueError for a graph that cannot be run, DeviceError if its buffers do not
    fit the device's memory (before any is allocated).
    """

    def __init__(
        self,
        device: Device,
        passes: Sequence[Pass],
        buffers: Iterable[Buffer],
        outputs: Iterable[str],
        inputs: Mapping[str, cl_array.Array] | None = None,
    ):
        self._device = device
        declared = {b.name: b for b in buffers}
        given = dict(inputs or {})
        persistent = {b.name for b in declared.values() if b.persistent}
        self.passes = order(needed(passes, set(outputs)), persistent)
        used = dict.fromkeys(b for p in self.passes for b in (*p.reads, *p.writes))
        check(self.passes, declared.keys(), given.keys(), persistent, set(outputs))
        self.buffers = [declared[name] for name in used if name in declared]
        device.check_fits("the frame", {b.name: b.nbytes for b in self.buffers})
        self.arrays: dict[str, cl_array.Array] = given
        for b in self.buffers:
            self.arrays[b.name] = (
                device.upload(np.zeros(b.shape, b.dtype), b.name)
                if b.persistent
                else device.empty(b.shape, b.dtype, b.name)
            )
        self.seconds: dict[str, float] = {}
        self._events: list[tuple[str, cl.Event]] = []

    @property
    def nbytes(self) -> int:
        """What the graph's own buffers take, in bytes."""
        return sum(b.nbytes for b in self.buffers)

    def run(self, state: object, progress: Callable[[float], None] | None = None) -> dict[str, float]:
        """Run every pass once and wait; returns seconds on the device by pass. progress: called with 0 .. 1."""
        self.seconds = dict.fromkeys(_names(self.passes), 0.0)
        for p in self.passes:
            self._run(p, state, progress)
        self._collect()
        return self.seconds

    def _run(self, p: Pass, state: object, progress: Callable[[float], None] | None = None) -> None:
        if isinstance(p, Repeat):
            count = p.count(state)
            for index in range(count):
                inner = p.advance(state, index)
                for q in p.passes:
                    self._run(q, inner)
                if progress:
                    self._collect()
                    progress((index + 1) / count)
            return
        self._events += [(p.name, event) for event in p.run(self.arrays, state) if event is not None]
        if len(self._events) >= _EVENTS_IN_FLIGHT:
            self._collect()

    def _collect(self) -> None:
        self._device.queue.finish()
        for name, event in self._events:
            self.seconds[name] += event_seconds(event)
        self._events.clear()

    def release(self) -> None:
        """Give the graph's buffers back to the device."""
        self._device.release(*(self.arrays.pop(b.name) for b in self.buffers))
        self.buffers = []


def needed(passes: Sequence[Pass], outputs: set[str]) -> list[Pass]:
    """The passes, in the order given, whose results reach an output, in this run or through what it leaves to the next."""
    wanted = set(outputs)
    while True:
        running = [_without_unwanted(p, wanted) for p in passes if wanted & set(p.writes)]
        grown = wanted.union(*(p.reads for p in _flat(running)))
        if grown == wanted:
            return running
        wanted = grown


def _without_unwanted(p: Pass, wanted: set[str]) -> Pass:
    return p.keeping([q for q in p.passes if wanted & set(q.writes)]) if isinstance(p, Repeat) else p


def order(passes: Sequence[Pass], persistent: set[str] = frozenset()) -> list[Pass]:
    """The passes so that each comes after those that it depends on; otherwise as listed. Raises ValueError on a cycle.

    The passes of a repetition stay as they are listed: what one reads before another writes it is of the round before.
    """
    before = [_dependencies(passes, i, persistent) for i in range(len(passes))]
    done: list[int] = []
    while len(done) < len(passes):
        ready = next((i for i in range(len(passes)) if i not in done and before[i] <= set(done)), None)
        if ready is None:
            stuck = ", ".join(p.name for i, p in enumerate(passes) if i not in done)
            raise ValueError(f"these passes wait for each other: {stuck}")
        done.append(ready)
    return [passes[i] for i in done]


def _dependencies(passes: Sequence[Pass], index: int, persistent: set[str]) -> set[int]:
    """Indices of the passes that must run before this one."""
    this, before = passes[index], set()
    for buffer in {*this.reads, *this.writes}:
        writers = {i for i, p in enumerate(passes) if buffer in p.writes and i != index}
        earlier = {i for i in writers if i < index}
        in_listed_order = earlier or buffer in this.writes or buffer in persistent
        before |= earlier if in_listed_order else writers
        if buffer in this.writes:  # who reads what was there before must have read it
            before |= {
                i
                for i, p in enumerate(passes[:index])
                if buffer in p.reads and (buffer in persistent or any(w < i for w in earlier))
            }
    return before


def check(
    passes: Sequence[Pass], declared: Iterable[str], inputs: Iterable[str], persistent: set[str], outputs: set[str]
) -> None:
    """Raise ValueError where a pass names an unknown buffer or reads what nothing wrote, or an output is never written."""
    known, written = {*declared, *inputs}, {*inputs, *persistent}
    for p in _flat(passes):
        for buffer in (*p.reads, *p.writes):
            if buffer not in known:
                raise ValueError(f"pass {p.name} uses {buffer}, which is neither declared nor given")
        for buffer in p.reads:
            if buffer not in written:
                raise ValueError(f"pass {p.name} reads {buffer} before any pass writes it")
        written |= set(p.writes)
    for buffer in outputs - written:
        raise ValueError(f"no pass writes the output {buffer}")


def _flat(passes: Sequence[Pass]) -> Iterable[Pass]:
    for p in passes:
        if isinstance(p, Repeat):
            yield from _flat(p.passes)
        else:
            yield p


def _names(passes: Sequence[Pass]) -> Iterable[str]:
    return (p.name for p in _flat(passes))
