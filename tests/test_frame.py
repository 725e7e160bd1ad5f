"""The frame graph: order, what runs, what is allocated, repetition and persistence, mostly with passes that only take notes."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache.errors import DeviceError
from clcache.frame import Buffer, FrameGraph, Pass, Repeat, needed, order


class Note(Pass):
    """A pass that only notes that it ran, and with which state."""

    def __init__(self, name, reads=(), writes=()):
        self.name, self.reads, self.writes = name, tuple(reads), tuple(writes)

    def run(self, arrays, state):
        """Nothing to enqueue: an event of None."""
        state.log.append(self.name if state.index is None else f"{self.name}{state.index}")
        yield None


@dataclass(frozen=True)
class State:
    """What the passes are told: where to note, how often to repeat, which repetition this is."""

    log: list
    times: int = 1
    index: int | None = None


class NoDevice:
    """As much of a device as a graph needs; arrays are NumPy's, memory is 1,000 bytes."""

    def __init__(self):
        self.queue = SimpleNamespace(finish=lambda: None)
        self.allocated = 0

    def check_fits(self, what, sizes):
        if self.allocated + sum(sizes.values()) > 1000:
            raise DeviceError(f"{what} needs {sum(sizes.values())}")

    def empty(self, shape, dtype, what):
        array = np.empty(shape, dtype)
        self.allocated += array.nbytes
        return array

    def upload(self, values, what):
        self.allocated += values.nbytes
        return values.copy()

    def release(self, *arrays):
        self.allocated -= sum(a.nbytes for a in arrays)


def names(passes):
    return [p.name for p in passes]


def graph(passes, buffers, outputs, **kwargs):
    return FrameGraph(
        NoDevice(), passes, [b if isinstance(b, Buffer) else Buffer(b, (4,)) for b in buffers], outputs, **kwargs
    )


def run(graph, **state):
    log = []
    graph.run(State(log, **state))
    return log


def repeat(passes, name="repeat"):
    return Repeat(name, passes, count=lambda s, _: s.times, advance=lambda s, i: replace(s, index=i))


# Order


@st.composite
def single_writer_graphs(draw):
    """Passes that each write a buffer of their own and read those of some passes before them, shuffled."""
    n = draw(st.integers(1, 8))
    reads = [draw(st.sets(st.integers(0, i - 1))) if i else set() for i in range(n)]
    passes = [Note(f"p{i}", [f"b{r}" for r in sorted(reads[i])], [f"b{i}"]) for i in range(n)]
    return draw(st.permutations(passes))


@given(single_writer_graphs())
def test_any_listing_of_a_graph_with_one_writer_for_each_buffer_is_put_in_order(passes):
    ordered = order(passes)
    assert sorted(names(ordered)) == sorted(names(passes))
    place = {buffer: i for i, p in enumerate(ordered) for buffer in p.writes}
    assert all(place[read] < i for i, p in enumerate(ordered) for read in p.reads)


@given(single_writer_graphs(), st.data())
def test_what_an_output_needs_is_what_it_is_reached_from(passes, data):
    outputs = data.draw(st.sets(st.sampled_from([f"b{i}" for i in range(len(passes))]), min_size=1))
    by_buffer = {p.writes[0]: p for p in passes}
    reached, waiting = set(), list(outputs)
    while waiting:
        buffer = waiting.pop()
        if buffer not in reached:
            reached.add(buffer)
            waiting += by_buffer[buffer].reads
    assert needed(passes, outputs) == [p for p in passes if p.writes[0] in reached]


def test_an_ordered_listing_stays_as_it_is():
    passes = [Note("a", [], ["x"]), Note("b", [], ["y"]), Note("c", ["x"], ["z"]), Note("d", ["y"], ["w"])]
    assert order(passes) == passes


def test_writers_of_one_buffer_keep_their_order_and_readers_their_place():
    """A reader between two writers gets what the first left; one listed before both gets what the last leaves."""
    between = [Note("w1", [], ["x"]), Note("r", ["x"], ["y"]), Note("w2", [], ["x"])]
    assert names(order(between)) == ["w1", "r", "w2"]
    before = [Note("r", ["x"], ["y"]), Note("w1", [], ["x"]), Note("w2", [], ["x"])]
    assert names(order(before)) == ["w1", "w2", "r"]


def test_a_reader_is_not_overtaken_by_a_later_writer_that_waits_for_nothing():
    passes = [
        Note("late", [], ["y"]),
        Note("w1", [], ["x"]),
        Note("r", ["x", "y2"], ["z"]),
        Note("w2", [], ["x"]),
        Note("y2", ["y"], ["y2"]),
    ]
    ordered = names(order(passes))
    assert ordered.index("w1") < ordered.index("r") < ordered.index("w2")
    assert ordered.index("y2") < ordered.index("r")


def test_a_pass_that_changes_a_buffer_comes_after_its_writer():
    passes = [
        Note("init", [], ["sum"]),
        Note("add", ["sum", "x"], ["sum"]),
        Note("x", [], ["x"]),
        Note("use", ["sum"], ["out"]),
    ]
    assert names(order(passes)) == ["init", "x", "add", "use"]


def test_persistent_buffers_are_read_before_they_are_written_again():
    passes = [Note("use", ["history"], ["out"]), Note("keep", ["out"], ["history"])]
    assert names(order(passes, persistent={"history"})) == ["use", "keep"]
    with pytest.raises(ValueError, match="these passes wait for each other: use, keep"):
        order(passes)


def test_a_cycle_is_named():
    passes = [Note("free", [], ["f"]), Note("a", ["y"], ["x"]), Note("b", ["x"], ["y"])]
    with pytest.raises(ValueError, match="these passes wait for each other: a, b"):
        order(passes)


# What runs, what is allocated


def test_passes_whose_output_nobody_asked_for_do_not_run_and_take_no_memory():
    passes = [Note("a", [], ["x"]), Note("b", ["x"], ["y"]), Note("c", ["x"], ["z"]), Note("d", ["z"], ["w"])]
    frame = graph(passes, "xyzw", ["y"])
    assert run(frame) == ["a", "b"]
    assert {b.name for b in frame.buffers} == {"x", "y"}
    assert frame.nbytes == 32
    assert set(frame.of()) == {"x", "y"}


def test_a_pass_runs_for_what_it_leaves_to_the_next_run():
    passes = [Note("use", ["history"], ["out"]), Note("update", ["history"], ["history"]), Note("idle", [], ["other"])]
    frame = graph(passes, ["out", "other", Buffer("history", (4,), persistent=True)], ["out"])
    assert run(frame) == ["use", "update"]


def test_given_arrays_are_read_and_not_allocated():
    given_array = np.arange(3)
    frame = graph([Note("a", ["given"], ["x"])], ["x"], ["x"], inputs={"given": given_array})
    assert frame.of()["given"] is given_array
    assert [b.name for b in frame.buffers] == ["x"]


@pytest.mark.parametrize(
    ("passes", "buffers", "outputs", "message"),
    [
        ([Note("a", ["typo"], ["x"])], "x", "x", "pass a uses typo, which is neither declared nor given"),
        ([Note("a", [], ["x", "typo"])], "x", "x", "pass a uses typo, which is neither declared nor given"),
        ([Note("a", ["y"], ["x"])], "xy", "x", "pass a reads y before any pass writes it"),
        ([Note("a", ["x"], ["x"])], "x", "x", "pass a reads x before any pass writes it"),
        ([Note("a", [], ["x"])], "xy", "y", "no pass writes the output y"),
        ([], "", "y", "no pass writes the output y"),
        ([repeat([Note("a", ["y"], ["x"])])], "xy", "x", "pass a reads y before any pass writes it"),
    ],
)
def test_graphs_that_cannot_run(passes, buffers, outputs, message):
    with pytest.raises(ValueError, match=message):
        graph(passes, buffers, list(outputs))


def test_memory_is_checked_before_anything_is_allocated(monkeypatch):
    """Each buffer would fit alone; together they do not, and none is taken."""
    taken = []
    monkeypatch.setattr(NoDevice, "empty", lambda self, shape, dtype, what: taken.append(what))
    buffers = [Buffer(name, (100,)) for name in "abc"]
    with pytest.raises(DeviceError, match="the frame needs 1200"):
        FrameGraph(NoDevice(), [Note("all", [], "abc")], buffers, "abc")
    assert taken == []


def test_the_message_says_what_would_be_needed(device):
    half = device.capabilities.global_memory // 8
    passes, buffers = (
        [Note("all", [], ["a", "b", "huge"])],
        [Buffer("a", (half,)), Buffer("b", (4,)), Buffer("huge", (half + 8,))],
    )
    before = device.allocated
    with pytest.raises(
        DeviceError,
        match=r"the frame needs \d+\.\d\d GiB .*the largest array is huge, \d+\.\d\d GiB\); device .* has \d+",
    ):
        FrameGraph(device, passes, buffers, ["a"])
    assert device.allocated == before


def test_release_gives_everything_back_once():
    frame = graph([Note("a", [], ["x"])], ["x"], ["x"], inputs={"given": np.zeros(2)})
    frame.release()
    assert frame._device.allocated == 0
    assert frame.nbytes == 0
    frame.release()
    assert set(frame.of()) == {"given"}


# Eyes


class Add(Pass):
    """Write what another buffer holds, and what the state says more."""

    def __init__(self, source, target):
        self.name, self.reads, self.writes = f"{source} to {target}", (source,), (target,)

    def run(self, arrays, state):
        arrays[self.writes[0]][:] = arrays[self.reads[0]] + state
        yield None


HISTORY = [Buffer(name, (4,), "f4", persistent=True, per_eye=True) for name in ("history", "history_before")]
EXCHANGED = [("history", "history_before")]


def test_each_eye_has_a_history_of_its_own():
    passes = [Add("history_before", "history"), Add("history", "out")]
    frame = graph(passes, [*HISTORY, "out"], ["out"], eyes=("left", "right"), exchanged=EXCHANGED)
    for eye, state, expected in (("left", 1, 1), ("left", 2, 3), ("right", 10, 10), ("left", 3, 6), ("right", 20, 30)):
        frame.run(state, eye=eye)
        assert (frame.of(eye)["history"] == expected).all()
        assert (frame.of(eye)["history_before"] == expected - state).all()
    assert (frame.of("left")["history"] == 6).all()  # what the other eye ran since then left it alone
    assert frame.of("left")["out"] is frame.of("right")["out"]
    assert frame.of() is frame.of("left")


def test_a_buffer_of_one_run_is_the_eyes_own_too():
    buffers = [Buffer("x", (4,), per_eye=True), "y"]
    frame = graph([Add("in", "x"), Add("x", "y")], buffers, ["y"], inputs={"in": np.zeros(4)}, eyes=("left", "right"))
    frame.run(1, eye="left")
    frame.run(5, eye="right")
    assert [frame.of(eye)["x"][0] for eye in ("left", "right")] == [1, 5]
    assert frame.sizes == {"x": 32, "y": 16}
    assert frame.nbytes == frame._device.allocated == 48
    frame.release()
    assert frame._device.allocated == 0


def test_each_eyes_arrays_are_counted_before_anything_is_allocated():
    buffers = [Buffer("x", (100,), per_eye=True)]
    assert graph([Note("a", [], ["x"])], buffers, ["x"], eyes=("left", "right")).nbytes == 800
    with pytest.raises(DeviceError, match="the frame needs 1200"):
        graph([Note("a", [], ["x"])], buffers, ["x"], eyes=("left", "right", "third"))


def test_who_reads_what_is_exchanged_needs_who_writes_it():
    """The output needs only what the last run left, and that the writer of this run."""
    passes = [Add("history_before", "out"), Note("update", [], ["history"]), Note("idle", [], ["other"])]
    frame = graph(passes, [*HISTORY, "out", "other"], ["out"], exchanged=EXCHANGED)
    assert names(frame.passes) == ["history_before to out", "update"]
    assert set(frame.sizes) == {"history", "history_before", "out"}


def test_both_of_a_pair_exist_where_one_is_used():
    frame = graph([Note("update", [], ["history"])], HISTORY, ["history"], exchanged=EXCHANGED)
    first = frame.of()["history"]
    run(frame)
    assert frame.of()["history_before"] is first and frame.of()["history"] is not first
    run(frame)
    assert frame.of()["history"] is first


def test_a_pair_that_nobody_uses_takes_no_memory():
    frame = graph([Note("a", [], ["out"])], [*HISTORY, "out"], ["out"], exchanged=EXCHANGED)
    run(frame)
    assert set(frame.sizes) == {"out"}


def test_what_the_next_run_depends_on():
    """What is read before it is written, under the name that it had last; a repetition may have written nothing."""
    passes = [
        Note("make", [], ["made"]),
        Note("blend", ["made", "history_before"], ["history"]),
        Note("add", ["sum"], ["sum"]),
        repeat([Note("shade", ["history"], ["inside", "light"]), Note("use", ["inside"], ["color"])]),
        Note("end", ["light", "sum"], ["out"]),
    ]
    shared = [Buffer(name, (4,), persistent=True) for name in ("made", "sum", "inside", "light", "color")]
    frame = graph(passes, [*HISTORY, *shared, "out"], ["out", "color"], eyes=("left", "right"), exchanged=EXCHANGED)
    first = frame.of("right")["history"]
    run(frame)
    assert set(frame.kept()) == {"left.history", "right.history", "all.sum", "all.light"}
    assert frame.kept()["left.history"] is frame.of("left")["history"]
    assert frame.kept()["right.history"] is first


@pytest.mark.parametrize(
    ("change", "pairs"),
    [
        ({"persistent": False}, EXCHANGED),
        ({"per_eye": False}, EXCHANGED),
        ({"shape": (5,)}, EXCHANGED),
        ({"dtype": "u4"}, EXCHANGED),
        ({"name": "other"}, EXCHANGED),
        ({}, EXCHANGED * 2),
        ({}, [("history", "history")]),
    ],
)
def test_pairs_that_cannot_be_exchanged(change, pairs):
    buffers = [HISTORY[0], replace(HISTORY[1], **change)]
    with pytest.raises(ValueError, match="history.* cannot be exchanged"):
        graph([Note("update", [], ["history"])], buffers, ["history"], exchanged=pairs)


def test_equal_dtypes_of_other_names_can_be_exchanged():
    buffers = [HISTORY[0], replace(HISTORY[1], dtype=np.float32)]
    assert graph([Note("update", [], ["history"])], buffers, ["history"], exchanged=EXCHANGED).nbytes == 32


def test_a_run_may_bring_other_inputs():
    frame = graph([Add("in", "x")], ["x"], ["x"], inputs={"in": np.full(4, 2)})
    frame.run(1, inputs={"in": np.full(4, 7)})
    assert frame.of()["x"][0] == 8
    frame.run(1)
    assert frame.of()["x"][0] == 3


# Repetition


@pytest.mark.parametrize(
    ("passes", "message"),
    [
        ([], "pass repeat reads times before any pass writes it"),
        ([Note("late", ["x"], ["times"])], "these passes wait for each other: repeat, late"),
    ],
)
def test_what_counts_is_needed_as_what_is_read(passes, message):
    counted = Repeat("repeat", [Note("a", [], ["x"])], lambda s, arrays: 1, lambda s, i: s, ["times"])
    with pytest.raises(ValueError, match=message):
        graph([counted, *passes], ["x", "times"], ["x"])


def test_how_often_may_be_read_from_the_eyes_arrays():
    """The count is asked after what comes before has run, and looks at arrays of the eye."""
    times = Buffer("times", (1,), "i4", persistent=True, per_eye=True)
    passes = [
        Add("times", "times"),
        Repeat("repeat", [Add("sum", "sum")], lambda s, arrays: arrays["times"][0], lambda s, i: 1, ["times"]),
    ]
    frame = graph(passes, [times, Buffer("sum", (4,), persistent=True, per_eye=True)], ["sum"], eyes=("left", "right"))
    frame.run(2, eye="left")
    frame.run(3, eye="left")
    frame.run(4, eye="right")
    assert [frame.of(eye)["sum"][0] for eye in ("left", "right")] == [2 + 5, 4]


def test_a_repetition_runs_its_passes_in_turn():
    passes = [
        Note("start", [], ["sum"]),
        repeat([Note("a", [], ["x"]), Note("b", ["x", "sum"], ["sum"])]),
        Note("end", ["sum"], ["out"]),
    ]
    frame = graph(passes, ["sum", "x", "out"], ["out"])
    assert run(frame, times=3) == ["start", "a0", "b0", "a1", "b1", "a2", "b2", "end"]
    assert run(frame, times=0) == ["start", "end"]


def test_a_repetition_reads_what_it_does_not_write_first():
    inner = repeat([Note("a", ["in", "sum"], ["x"]), Note("b", ["x", "sum"], ["sum"])])
    assert inner.reads == ("in", "sum")
    assert inner.writes == ("x", "sum")


def test_a_repetition_leaves_out_passes_that_nobody_needs():
    inner = repeat([Note("a", [], ["x"]), Note("spare", ["x"], ["y"]), Note("b", ["x"], ["z"])])
    frame = graph([inner], "xyz", ["z"])
    assert run(frame, times=2) == ["a0", "b0", "a1", "b1"]
    assert [b.name for b in frame.buffers] == ["x", "z"]


def test_repetitions_within_repetitions():
    inner = Repeat(
        "inner",
        [Note("a", ["s"], ["s"])],
        count=lambda s, _: 2,
        advance=lambda s, i: replace(s, index=10 * s.index + i),
    )
    outer = repeat([Note("clear", [], ["s"]), inner, Note("sum", ["s"], ["out"])])
    assert run(graph([outer], ["s", "out"], ["out"]), times=2) == [
        "clear0",
        "a0",
        "a1",
        "sum0",
        "clear1",
        "a10",
        "a11",
        "sum1",
    ]


def test_progress_goes_to_one():
    told = []
    frame = graph([repeat([Note("a", [], ["x"])])], "x", ["x"])
    frame.run(State([], times=4), told.append)
    assert told == [0.25, 0.5, 0.75, 1.0]


# On a device


class Kernel(Pass):
    """Call one kernel."""

    def __init__(self, name, kernel, reads, writes, arguments):
        self.name, self.reads, self.writes = name, reads, writes
        self._kernel, self._arguments = kernel, arguments

    def run(self, arrays, state):
        yield self._kernel(*self._arguments(arrays), count=4)


COUNT_UP = """
__kernel void count_up(
    __global float *total,  // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) total[i] += 1.0f;
}

__kernel void copy(
    __global const float *from,  // (n)
    __global float *to,          // (n)
    uint n)
{
    uint i = get_global_id(0);
    if (i < n) to[i] = from[i];
}
"""


@pytest.fixture
def counting(device, tmp_path, monkeypatch):
    """Passes that count the runs in a persistent buffer, and copy the count to an output."""
    monkeypatch.setattr("clcache.program.SOURCE_FOLDER", tmp_path)
    (tmp_path / "count_up.cl").write_text(COUNT_UP)
    program = device.program("count_up.cl")
    return [
        Kernel("count_up", program["count_up"], ("total",), ("total",), lambda a: (a["total"], 4)),
        Kernel("copy", program["copy"], ("total",), ("out",), lambda a: (a["total"], a["out"], 4)),
    ]


def test_persistent_buffers_begin_with_zeros_and_keep_their_contents(device, counting):
    frame = FrameGraph(device, counting, [Buffer("total", (4,), persistent=True), Buffer("out", (4,))], ["out"])
    for expected in (1, 2, 3):
        frame.run(None)
        np.testing.assert_array_equal(frame.of()["out"].get(), np.full(4, expected))
    frame.release()


def test_seconds_are_those_of_every_pass(device, counting):
    buffers = [Buffer("total", (4,), persistent=True), Buffer("out", (4,))]
    frame = FrameGraph(device, counting, buffers, ["out"])
    seconds = frame.run(None)
    assert set(seconds) == {"count_up", "copy"}
    assert all(0 < s < 10 for s in seconds.values())
    frame.release()


def test_long_repetitions_time_all_launches(device, counting):
    """More launches than events are kept."""
    repeated = Repeat("often", counting[:1], count=lambda s, _: 700, advance=lambda s, i: s)
    frame = FrameGraph(
        device, [repeated, counting[1]], [Buffer("total", (4,), persistent=True), Buffer("out", (4,))], ["out"]
    )
    seconds = frame.run(None)
    np.testing.assert_array_equal(frame.of()["out"].get(), np.full(4, 700))
    assert set(seconds) == {"count_up", "copy"}
    assert min(seconds.values()) > 0
    frame.release()
