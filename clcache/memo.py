"""For which graphs memoization pays (MaterialMemo, section 2.4).

It does where the ratio of Eq. 2.17 is below 1, that of the time with memoization to the time without:

    S = ((T_f + T_r + T_w) (1 - h) + T_r h) / T_f

T_f is what evaluating the graph takes, T_r a lookup, T_w an insertion, h the part of lookups that hit. (The thesis calls S a speed-up; it is
the cost.) The times are measured before the first frame, all on the device's own clock with all its threads at work; h is counted.
At first every graph is memoized for which a lookup takes less time than evaluation; one that turns out to have too few hits is not any
more from then on. What a graph misses in tiles is a whole tile, so T_f (1 - h) counts once for each of its texels there.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pyopencl.array as cl_array

# Bits of memo_mode: the first three as in cl/memo/key.cl.
READS_UV, READS_POSITION, IS_MEMOIZED, IS_DECIDED = 1, 2, 4, 8
_FIRST_LOOK = (
    4  # frames after which hit rates are first looked at; then whenever as many have passed again as there were
)
_ENOUGH = 1000  # lookups that say something of a hit rate
MOST_RATIO = 0.9  # of Eq. 2.17 at which a graph is memoized: the times are measured with all that they need in the processor's caches


@dataclass(frozen=True)
class Costs:
    """Seconds for each lookup, of a graph's material. evaluate: T_f. look_up: T_r. insert: T_w: what a lookup that misses takes
    besides, and besides evaluation; below 0 where a tile's texels, which lie side by side, take less than as many hits. built: times
    that the graph is evaluated for what a lookup misses."""

    evaluate: float
    look_up: float
    insert: float
    built: int = 1

    def ratio(self, hit_rate: float) -> float:
        """Time with memoization over time without (Eq. 2.17)."""
        missed = self.built * self.evaluate + self.look_up + self.insert
        return (missed * (1 - hit_rate) + self.look_up * hit_rate) / self.evaluate

    @property
    def break_even(self) -> float:
        """The hit rate above which memoization pays; above 1 where it never does."""
        missed = self.built * self.evaluate + self.insert
        return (
            (missed + self.look_up - self.evaluate) / missed if missed > 0 else 0.0
        )  # where misses cost no more than hits


# What is known of each graph, in the columns of the buffer `memo_known`: its costs, the lookups and hits since they were last looked
# at, the hit rate then (negative: none yet), and the frames so far.
_KNOWN = np.dtype(
    [(name, np.float64) for name in ("evaluate", "look_up", "insert", "built", "lookups", "hits", "hit_rate", "frames")]
)
KNOWN_COLUMNS = len(_KNOWN)
_POSSIBLE = (-1e15, 1e15)


class Memo:
    """Which of a scene's graphs are memoized. names: of each graph's materials. reads: (graphs,) uint32, what each reads, in bits. cannot:
    by graph why it is never memoized, or nothing. measure: each graph's Costs, asked for before the first frame if `auto`; the arrays
    are those of the frame graph.

    All that later decisions depend on is in the buffer `memo_known`, so that who goes on with it decides alike.
    """

    def __init__(
        self,
        names: list[list[str]],
        reads: np.ndarray,
        cannot: list[str],
        auto: bool,
        measure: Callable[[Mapping[str, cl_array.Array]], list[Costs]],
    ):
        self._names, self._reads, self._cannot, self._auto, self._measure = names, reads, cannot, auto, measure
        self._modes = np.zeros(len(names), np.uint32)
        self._known = np.zeros(len(names), _KNOWN)
        self._known["hit_rate"] = -1

    def begin(self, arrays: Mapping[str, cl_array.Array]) -> None:
        """Before a run of the passes: decide, if nothing was decided before, here or by whom this goes on from."""
        modes = arrays["memo_mode"].get()
        if modes.any():
            known = np.nan_to_num(arrays["memo_known"].get(), posinf=0, neginf=0)  # which may be anything in a file
            self._known = np.ascontiguousarray(np.clip(known, *_POSSIBLE)).view(_KNOWN)[:, 0].copy()
        else:
            modes = self._first_modes(arrays)
            arrays["memo_mode"].set(modes)
            self._store(arrays)
        self._modes = modes

    @property
    def _costs(self) -> list[Costs | None]:
        """Of each graph; None where they were not measured."""
        return [
            Costs(k["evaluate"], k["look_up"], k["insert"], int(k["built"])) if k["evaluate"] > 0 else None
            for k in self._known
        ]

    def _first_modes(self, arrays: Mapping[str, cl_array.Array]) -> np.ndarray:
        for known, cost in zip(self._known, self._measure(arrays) if self._auto else (), strict=False):
            for name in ("evaluate", "look_up", "insert", "built"):
                known[name] = getattr(cost, name)
        modes = self._reads | np.uint32(IS_DECIDED)
        for graph, cost in enumerate(self._costs):
            if not self._cannot[graph] and (cost is None or cost.ratio(1.0) < MOST_RATIO):
                modes[graph] |= IS_MEMOIZED
        return modes

    @property
    def memoizes(self) -> bool:
        """Whether any graph is memoized now."""
        return bool((self._modes & IS_MEMOIZED).any())

    @property
    def memoizes_all(self) -> bool:
        """Whether every graph is memoized now."""
        return bool((self._modes & IS_MEMOIZED).all())

    def observe(self, arrays: Mapping[str, cl_array.Array]) -> None:
        """After a frame: see whether graphs that are memoized have the hits that they need."""
        known, counted = self._known, arrays["memo_graph_count"].get()
        arrays["memo_graph_count"].set(np.zeros_like(counted))
        known["frames"] += 1
        frames = int(known["frames"][0])
        if frames > 1:  # the first fills the cache
            known["lookups"] += counted[:, 0]
            known["hits"] += counted[:, 1]
        if frames >= _FIRST_LOOK and frames & (frames - 1) == 0:
            self._look_at_hits()
            arrays["memo_mode"].set(self._modes)
        self._store(arrays)

    def _store(self, arrays: Mapping[str, cl_array.Array]) -> None:
        arrays["memo_known"].set(self._known.view(np.float64).reshape(-1, KNOWN_COLUMNS))

    def _look_at_hits(self) -> None:
        for graph, (known, cost) in enumerate(zip(self._known, self._costs, strict=True)):
            if known["lookups"] < _ENOUGH:
                continue
            known["hit_rate"] = rate = known["hits"] / known["lookups"]
            known["lookups"] = known["hits"] = 0
            if cost is not None and cost.ratio(rate) > MOST_RATIO:
                self._modes[graph] &= ~np.uint32(IS_MEMOIZED)

    def report(self) -> list[dict]:
        """What was decided of each graph, and why: nanoseconds, and parts of 1."""
        return [self._describe(graph, cost) for graph, cost in enumerate(self._costs)]

    def _describe(self, graph: int, cost: Costs | None) -> dict:
        rate = self._hit_rate(graph)
        is_memoized = bool(self._modes[graph] & IS_MEMOIZED)
        found = {"materials": self._names[graph], "memoized": is_memoized, "why": self._why(graph, cost, is_memoized)}
        if cost is not None:
            found |= {"evaluate_ns": 1e9 * cost.evaluate}
        if cost is not None and not self._cannot[graph]:
            found |= {"look_up_ns": 1e9 * cost.look_up, "insert_ns": 1e9 * cost.insert, "break_even": cost.break_even}
            found |= {} if rate is None else {"ratio": cost.ratio(rate)}
        return found | ({} if rate is None else {"hit_rate": rate})

    def _hit_rate(self, graph: int) -> float | None:
        rate = float(self._known["hit_rate"][graph])
        return rate if rate >= 0 else None

    def _why(self, graph: int, cost: Costs | None, is_memoized: bool) -> str:
        rate = self._hit_rate(graph)
        if self._cannot[graph]:
            return self._cannot[graph]
        if not self._modes[graph]:
            return "no frame yet"
        if cost is None:
            return "memo.auto is off"
        if is_memoized:
            return (
                "a lookup takes less time than evaluation"
                if rate is None
                else "its hits save more than its misses cost"
            )
        return "a lookup takes about as long as evaluation" if rate is None else "it has too few hits"
