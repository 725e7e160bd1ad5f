"""The frame graph: passes over buffers.

A pass names the buffers that it reads and those that it writes (a buffer that it changes is in both). From that follows
everything else: passes that no output needs do not run, buffers that no running pass touches are not allocated, a
pass comes after those that write what it reads, and the time of each is what the device measured.

Passes that write the same buffer keep the order in which they are listed, and so does a reader that is listed after one of
them; a reader that is listed before all writers of a buffer gets what the last of them leaves. `persistent` buffers
keep their contents, zeros at first, from one run to the next: a reader listed before the writers gets what the run before left.

A graph serves one eye or two with the same passes. Buffers that are `per_eye` exist once for each of them, and so each eye
has a history of its own; the others are scratch, or hold what does not depend on the eye. Two buffers of an eye that are
`exchanged` change places before each of its runs: what one was written to in a run is read as the other in the next.

What the next run depends on is what its passes read before they write it. The passes of a repetition, which may run no time at
all, do not count as writers there.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from .device import Device, event_seconds
from .image import Image

# Finished commands are timed and forgotten in batches: an event kept for each launch of a long frame would fill memory.
_EVENTS_IN_FLIGHT = 256


@dataclass(frozen=True)
class Buffer:
    """A named array of the graph: its shape and dtype; `persistent` if its contents, zeros at first, outlive a run; `per_eye`
    if each eye has one of its own, which no other eye's run touches; `is_image` if it is an image of the device (`Image`)."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype | type = np.float32
    persistent: bool = False
    per_eye: bool = False
    is_image: bool = False

    @property
    def nbytes(self) -> int:
        """Size in bytes, of one eye."""
        return int(np.prod(self.shape, dtype=np.int64)) * np.dtype(self.dtype).itemsize


class Pass:
    """One step of a frame. Subclasses set `name`, `reads` and `writes`, and implement `run`; and `results` where what they are run for
    is not all that they write.

    `run(arrays, state)` enqueues the work: arrays maps a buffer's name to its device array, state is what the method
    hands to `FrameGraph.run`. It yields the events of what it enqueued (None for a launch of nothing).
    """

    name: str
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    results: tuple[str, ...] | None = None

    def run(self, arrays: Mapping[str, cl_array.Array], state: object) -> Iterable[cl.Event | None]:
        """Enqueue the pass's work and yield its events."""
        raise NotImplementedError


class Repeat(Pass):
    """Passes that run `count(state, arrays)` times over; before each time, `advance(state, index)` gives the state for it.

    count is asked when all that comes before is enqueued, and may read arrays; count_reads names their buffers.
    """

    def __init__(
        self,
        name: str,
        passes: Sequence[Pass],
        count: Callable[[object, Mapping[str, cl_array.Array]], int],
        advance: Callable[[object, int], object],
        count_reads: Sequence[str] = (),
    ):
        self.name, self.passes, self.count, self.advance = name, tuple(passes), count, advance
        self.count_reads = tuple(count_reads)
        self.writes = tuple(dict.fromkeys(b for p in passes for b in p.writes))
        first_written: set[str] = set()
        reads = dict.fromkeys(self.count_reads)
        for p in passes:
            reads.update((b, None) for b in p.reads if b not in first_written)
            first_written.update(p.writes)
        self.reads = tuple(reads)

    def keeping(self, passes: Sequence[Pass]) -> "Repeat":
        """The same repetition of only these passes."""
        return Repeat(self.name, passes, self.count, self.advance, self.count_reads)


class FrameGraph:
    """The passes that the outputs need, in order, with their buffers allocated.

    inputs: arrays that exist already, by name. outputs: names of the buffers that are wanted after a run; their names
    may be of declared buffers only. eyes: whose frames it makes, one in each run. exchanged: pairs of names of per-eye
    persistent buffers. Raises ValueError for a graph that cannot be run, DeviceError if its buffers do not fit the
    device's memory (before any is allocated).
    """

    def __init__(
        self,
        device: Device,
        passes: Sequence[Pass],
        buffers: Iterable[Buffer],
        outputs: Iterable[str],
        inputs: Mapping[str, cl_array.Array] | None = None,
        eyes: Sequence[str] = ("mono",),
        exchanged: Sequence[tuple[str, str]] = (),
    ):
        self._device = device
        declared = {b.name: b for b in buffers}
        given = dict(inputs or {})
        persistent = {b.name for b in declared.values() if b.persistent}
        check_exchanged(exchanged, declared)
        self.passes = order(needed(passes, set(outputs), exchanged), persistent)
        used = dict.fromkeys(b for p in self.passes for b in (*p.reads, *p.writes))
        check(self.passes, declared.keys(), given.keys(), persistent, set(outputs))
        self._exchanged = [pair for pair in exchanged if used.keys() & set(pair)]
        used |= dict.fromkeys(b for pair in self._exchanged for b in pair)
        self.buffers = [declared[name] for name in used if name in declared]
        self._eyes = tuple(eyes)
        device.check_fits("the frame", {what: b.nbytes for b in self.buffers for what, _ in self._copies(b)})
        self._arrays: dict[str, dict[str, cl_array.Array | Image]] = {eye: dict(given) for eye in eyes}
        for b in self.buffers:
            for what, owners in self._copies(b):
                if b.is_image:
                    array = device.image(b.shape, b.dtype, what)
                elif b.persistent:
                    array = device.upload(np.zeros(b.shape, b.dtype), what)
                else:
                    array = device.empty(b.shape, b.dtype, what)
                for eye in owners:
                    self._arrays[eye][b.name] = array
        self.seconds: dict[str, float] = {}
        self._events: list[tuple[str, cl.Event]] = []

    def _copies(self, b: Buffer) -> list[tuple[str, tuple[str, ...]]]:
        """The arrays that a buffer takes: what to call each, and the eyes whose it is."""
        return [(f"{b.name} of {eye}", (eye,)) for eye in self._eyes] if b.per_eye else [(b.name, self._eyes)]

    def of(self, eye: str | None = None) -> Mapping[str, cl_array.Array]:
        """An eye's arrays (the first eye's where None) by the names that they had in its last run."""
        return self._arrays[self._eyes[0] if eye is None else eye]

    def left(self, eye: str) -> dict[str, cl_array.Array]:
        """What an eye's last run left and no other eye's run touches, or all eyes share from run to run, by name."""
        own = self._arrays[eye]
        return {b.name: own[b.name] for b in self.buffers if b.per_eye or b.persistent}

    def kept(self) -> dict[str, cl_array.Array]:
        """What the next runs depend on, by EYE.NAME; EYE is `all` where the eyes share it."""
        taken = {name: partner for a, b in self._exchanged for name, partner in ((a, b), (b, a))}
        history = read_first(self.passes)
        kept = [b for b in self.buffers if b.persistent and taken.get(b.name, b.name) in history]
        owners = {b.name: self._eyes if b.per_eye else ("all",) for b in kept}
        return {
            f"{owner}.{name}": self._arrays[self._eyes[0] if owner == "all" else owner][name]
            for name, eyes in owners.items()
            for owner in eyes
        }

    @property
    def sizes(self) -> dict[str, int]:
        """What each of the graph's own buffers takes, of all eyes together, in bytes."""
        return {b.name: b.nbytes * len(self._copies(b)) for b in self.buffers}

    @property
    def nbytes(self) -> int:
        """What the graph's own buffers take, in bytes."""
        return sum(self.sizes.values())

    def run(
        self,
        state: object,
        progress: Callable[[float], None] | None = None,
        eye: str | None = None,
        inputs: Mapping[str, cl_array.Array] | None = None,
    ) -> dict[str, float]:
        """Run every pass once, for one eye (the first where None), and wait; returns seconds on the device by pass.

        progress: called with 0 .. 1. inputs: arrays that stand in for those of the same names, in this run.
        """
        own = self._arrays[self._eyes[0] if eye is None else eye]
        for a, b in self._exchanged:
            own[a], own[b] = own[b], own[a]
        arrays = own | dict(inputs or {})
        self.seconds = dict.fromkeys(_names(self.passes), 0.0)
        for p in self.passes:
            self._run(p, arrays, state, progress)
        self._collect()
        return self.seconds

    def _run(
        self,
        p: Pass,
        arrays: Mapping[str, cl_array.Array],
        state: object,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        if isinstance(p, Repeat):
            count = p.count(state, arrays)
            for index in range(count):
                inner = p.advance(state, index)
                for q in p.passes:
                    self._run(q, arrays, inner)
                if progress:
                    self._collect()
                    progress((index + 1) / count)
            return
        self._events += [(p.name, event) for event in p.run(arrays, state) if event is not None]
        if len(self._events) >= _EVENTS_IN_FLIGHT:
            self._collect()

    def _collect(self) -> None:
        self._device.queue.finish()
        for name, event in self._events:
            self.seconds[name] += event_seconds(event)
        self._events.clear()

    def release(self) -> None:
        """Give the graph's buffers back to the device."""
        for b in self.buffers:
            for _, owners in self._copies(b):
                array, *_ = [self._arrays[eye].pop(b.name) for eye in owners]
                self._device.release(array)
        self.buffers = []


def needed(passes: Sequence[Pass], outputs: set[str], exchanged: Sequence[tuple[str, str]] = ()) -> list[Pass]:
    """The passes, in the order given, whose results reach an output, in this run or through what it leaves to the next."""
    wanted = set(outputs)
    while True:
        running = [_without_unwanted(p, wanted) for p in passes if wanted & results_of(p)]
        grown = wanted.union(*(reads for _, reads, _ in _steps(running)))
        grown |= {b for pair in exchanged if grown & set(pair) for b in pair}
        if grown == wanted:
            return running
        wanted = grown


def _without_unwanted(p: Pass, wanted: set[str]) -> Pass:
    return p.keeping([q for q in p.passes if wanted & results_of(q)]) if isinstance(p, Repeat) else p


def results_of(p: Pass) -> set[str]:
    """The buffers for whose sake a pass runs."""
    if isinstance(p, Repeat):
        return set().union(*(results_of(q) for q in p.passes))
    return set(p.writes if p.results is None else p.results)


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


def read_first(passes: Sequence[Pass]) -> set[str]:
    """The buffers that the passes, in their order, read before they write them, or may read without writing them."""
    read: set[str] = set()
    written: set[str] = set()
    for p in passes:
        read |= {*p.reads} - written
        written |= set() if isinstance(p, Repeat) else {*p.writes}
    return read


def check(
    passes: Sequence[Pass], declared: Iterable[str], inputs: Iterable[str], persistent: set[str], outputs: set[str]
) -> None:
    """Raise ValueError where a pass names an unknown buffer or reads what nothing wrote, or an output is never written."""
    known, written = {*declared, *inputs}, {*inputs, *persistent}
    for name, reads, writes in _steps(passes):
        for buffer in (*reads, *writes):
            if buffer not in known:
                raise ValueError(f"pass {name} uses {buffer}, which is neither declared nor given")
        for buffer in reads:
            if buffer not in written:
                raise ValueError(f"pass {name} reads {buffer} before any pass writes it")
        written |= set(writes)
    for buffer in outputs - written:
        raise ValueError(f"no pass writes the output {buffer}")


def check_exchanged(exchanged: Sequence[tuple[str, str]], declared: Mapping[str, Buffer]) -> None:
    """Raise ValueError where two buffers cannot change places."""
    names = [name for pair in exchanged for name in pair]
    for pair in exchanged:
        kinds = {
            (b.persistent and b.per_eye, b.shape, np.dtype(b.dtype))
            for b in (declared.get(name, Buffer(name, ())) for name in pair)
        }
        if len(kinds) > 1 or not next(iter(kinds))[0] or any(names.count(name) > 1 for name in pair):
            raise ValueError(
                f"{' and '.join(pair)} cannot be exchanged: "
                "expected two persistent per-eye buffers of one shape and dtype, each in one pair only"
            )


def _steps(passes: Sequence[Pass]) -> Iterable[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """Name, reads and writes of every pass, those within repetitions too, and of what counts these."""
    for p in passes:
        if isinstance(p, Repeat):
            yield p.name, p.count_reads, ()
            yield from _steps(p.passes)
        else:
            yield p.name, p.reads, p.writes


def _names(passes: Sequence[Pass]) -> Iterable[str]:
    for p in passes:
        if isinstance(p, Repeat):
            yield from _names(p.passes)
        else:
            yield p.name
