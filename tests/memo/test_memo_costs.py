"""For which graphs memoization pays (`clcache/memo.py`; MaterialMemo, section 2.4): Eq. 2.17 in closed form, and what is decided by it
of costs and hits that a test makes up."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache.memo import IS_MEMOIZED, KNOWN_COLUMNS, MOST_RATIO, READS_POSITION, READS_UV, Costs, Memo

SECONDS = st.integers(1, 10**6).map(lambda n: 1e-9 * n)
CHEAP, EXPENSIVE = Costs(1e-8, 3e-8, 2e-8), Costs(1e-6, 3e-8, 2e-8)


class Words:
    """An array of the device's, as far as a memo asks for it."""

    def __init__(self, values):
        self.values = np.array(values)

    def get(self):
        return self.values.copy()

    def set(self, values):
        self.values = values.copy()


class Run:
    """Frames in which a memo's graphs were asked for so often, and as often answered from the cache."""

    def __init__(self, *costs, cannot=None, auto=True, modes=None, reads=READS_UV):
        self.measured = 0
        self.costs = list(costs)
        n = len(costs)
        names = [[f"material {k}"] for k in range(n)]
        self.arrays = {
            "memo_mode": Words(np.zeros(n, np.uint32) if modes is None else modes),
            "memo_graph_count": Words(np.zeros((n, 2), np.uint32)),
            "memo_known": Words(np.zeros((n, KNOWN_COLUMNS))),
        }
        self.memo = Memo(names, np.full(n, reads, np.uint32), list(cannot or [""] * n), auto, self.measure)

    def measure(self, arrays):
        assert arrays is self.arrays
        self.measured += 1
        return self.costs

    def frames(self, count, *lookups_and_hits):
        """So many frames of two eyes."""
        for _ in range(count):
            self.memo.begin(self.arrays)
            self.memo.begin(self.arrays)
            if lookups_and_hits:
                self.arrays["memo_graph_count"].set(np.array(lookups_and_hits, np.uint32))
            self.memo.observe(self.arrays)
        return self

    @property
    def memoized(self):
        modes = self.arrays["memo_mode"].get()
        assert self.memo.memoizes == bool((modes & IS_MEMOIZED).any())
        return [bool(mode & IS_MEMOIZED) for mode in modes]

    def why(self, graph=0):
        return self.memo.report()[graph]["why"]


# Eq. 2.17


@given(SECONDS, SECONDS, SECONDS, st.floats(0, 1))
def test_the_ratio_is_that_of_the_thesis(evaluate, look_up, insert, hit_rate):
    with_memo = (evaluate + look_up + insert) * (1 - hit_rate) + look_up * hit_rate
    assert Costs(evaluate, look_up, insert).ratio(hit_rate) == pytest.approx(with_memo / evaluate, rel=1e-12)


@given(SECONDS, SECONDS, SECONDS, st.integers(1, 32))
def test_memoization_breaks_even_where_the_ratio_is_1(evaluate, look_up, insert, built):
    costs = Costs(evaluate, look_up, insert, built)
    rate = costs.break_even
    assert costs.ratio(rate) == pytest.approx(1, abs=1e-9 * costs.ratio(0.0))
    assert costs.ratio(rate - 0.01) > costs.ratio(rate + 0.01)
    assert rate > 1 if look_up > 1.001 * evaluate else rate < 1.001
    if built == 1:
        assert rate == pytest.approx((look_up + insert) / (evaluate + insert), rel=1e-12)


def test_ratios_of_numbers_that_can_be_told_in_the_head():
    assert Costs(10.0, 1.0, 1.0).ratio(1.0) == pytest.approx(0.1)
    assert Costs(10.0, 1.0, 1.0).ratio(0.0) == pytest.approx(1.2)
    assert Costs(10.0, 1.0, 1.0).ratio(0.5) == pytest.approx(0.65)
    assert Costs(10.0, 1.0, 1.0).break_even == pytest.approx(2 / 11)
    assert Costs(10.0, 1.0, 1.0, 16).ratio(0.5) == pytest.approx((162 * 0.5 + 0.5) / 10), "a miss builds 16 texels"


# Decisions


def test_a_cheap_graph_is_not_memoized_and_an_expensive_one_is():
    run = Run(CHEAP, EXPENSIVE).frames(1)
    assert run.memoized == [False, True] and run.measured == 1
    assert run.why(0) == "a lookup takes about as long as evaluation"
    assert run.why(1) == "a lookup takes less time than evaluation"


def test_modes_keep_what_graphs_read():
    run = Run(CHEAP, EXPENSIVE, reads=READS_UV | READS_POSITION).frames(1)
    assert (run.arrays["memo_mode"].get() & 3).tolist() == [3, 3]


def test_none_is_memoized_whose_best_is_not_clearly_better():
    just = Costs(1.0, MOST_RATIO * 1.001, 0.0), Costs(1.0, MOST_RATIO * 0.999, 0.0)
    assert Run(*just).frames(1).memoized == [False, True]


def test_a_graph_with_too_few_hits_is_given_up():
    """0.65 at half of the hits; 1.2 at none, which the fourth frame shows. The first, in which all is missed, says nothing."""
    half, none = (10000, 5000), (10000, 0)
    run = Run(Costs(10.0, 1.0, 1.0), Costs(10.0, 1.0, 1.0)).frames(1, none, none)
    assert run.memoized == [True, True] and "hit_rate" not in run.memo.report()[0]
    run.frames(2, half, none)
    assert run.memoized == [True, True]
    run.frames(1, half, none)
    assert run.memoized == [True, False]
    first, second = run.memo.report()
    assert first["hit_rate"] == 0.5 and first["ratio"] == pytest.approx(0.65)
    assert second["hit_rate"] == 0.0 and second["ratio"] == pytest.approx(1.2)
    assert (run.why(0), run.why(1)) == ("its hits save more than its misses cost", "it has too few hits")


def test_it_is_looked_at_again_and_again():
    """After 4, 8, 16 frames: of the hits since it was last."""
    run = Run(Costs(10.0, 1.0, 1.0)).frames(1).frames(3, (10000, 9000))
    assert run.memoized == [True] and run.memo.report()[0]["hit_rate"] == 0.9
    run.frames(3, (10000, 0))
    assert run.memoized == [True]
    run.frames(1, (10000, 0))
    assert run.memoized == [False] and run.memo.report()[0]["hit_rate"] == 0.0
    run.frames(50)
    assert run.memoized == [False], "once given up, it stays so"


def test_few_lookups_say_nothing():
    run = Run(Costs(10.0, 1.0, 1.0)).frames(1).frames(7, (100, 0))
    assert run.memoized == [True] and "hit_rate" not in run.memo.report()[0]


def test_without_auto_all_is_memoized_that_can_be_and_nothing_measured():
    run = Run(CHEAP, EXPENSIVE, CHEAP, auto=False, cannot=["", "", "for a reason"]).frames(9, *[(10000, 0)] * 3)
    assert run.memoized == [True, True, False] and run.measured == 0
    assert [run.why(k) for k in range(3)] == ["memo.auto is off"] * 2 + ["for a reason"]


@pytest.mark.parametrize("auto", [False, True])
def test_what_cannot_be_is_never_memoized_and_the_report_says_why(auto):
    run = Run(EXPENSIVE, EXPENSIVE, cannot=["it reads what is not in keys", ""], auto=auto).frames(
        6, (0, 0), (10000, 9999)
    )
    assert run.memoized == [False, True] and run.why(0) == "it reads what is not in keys"


def test_nothing_is_measured_where_all_is_decided_already():
    """By a state that the render goes on from."""
    decided = Run(CHEAP, EXPENSIVE).frames(1).arrays["memo_mode"].get()
    run = Run(EXPENSIVE, CHEAP, modes=decided).frames(1)
    assert run.memoized == [False, True] and run.measured == 0


def test_who_goes_on_from_anothers_arrays_decides_and_reports_alike():
    """After each number of frames: with costs, hits and frames of before, whatever its own measurement would say, and what it did before."""
    costs, counts = (Costs(10.0, 1.0, 1.0), Costs(10.0, 1.0, 1.0), CHEAP), ((10000, 8000), (10000, 500), (0, 0))
    for before in range(1, 9):
        first = Run(*costs).frames(1).frames(before - 1, *counts)
        for used in (0, 3):
            second = Run(CHEAP, EXPENSIVE, EXPENSIVE).frames(used)
            second.arrays = {name: Words(array.get()) for name, array in first.arrays.items()}
            second.frames(9 - before, *counts)
            expected = Run(*costs).frames(1).frames(8, *counts)
            assert second.measured == (used > 0)
            assert second.memoized == expected.memoized == [True, False, False]
            assert second.memo.report() == expected.memo.report()
            assert [array.get().tolist() for array in second.arrays.values()] == [
                array.get().tolist() for array in expected.arrays.values()
            ]


def test_the_report():
    """Of each graph: its materials, what was decided and why, times in nanoseconds; before the first frame, nothing yet."""
    run = Run(EXPENSIVE)
    assert run.memo.report() == [{"materials": ["material 0"], "memoized": False, "why": "no frame yet"}]
    run.frames(4, (4000, 3000))
    (found,) = json.loads(json.dumps(run.memo.report()))
    assert found["materials"] == ["material 0"] and found["memoized"] is True
    assert [found[f"{name}_ns"] for name in ("evaluate", "look_up", "insert")] == pytest.approx([1000, 30, 20])
    assert found["hit_rate"] == 0.75 and found["ratio"] == pytest.approx(0.25 * 1.05 + 0.75 * 0.03)
    assert found["break_even"] == pytest.approx(0.05 / 1.02)
