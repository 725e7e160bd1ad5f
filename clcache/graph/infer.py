"""Type inference: one overload for each node of a graph (thesis, section 5.1).

Documents carry no types. A node's overloads are the candidates; a link joins two of them if the type that one writes is,
or converts to, the type that the other reads:

    float  -> float2, float3, float4      repeated
    float3 -> float4                      with an alpha of 1
    float4 -> float3                      without its alpha
    T_D    -> T                           without its derivatives

Constants take any type of their width, or are repeated, and their derivatives are 0. Wanted is the choice that adds or
loses an alpha least often; of those the one that computes the fewest numbers (the components of all outputs, three
times as many with derivatives, so that these are computed only where something needs them); then the one with the
fewest other conversions. Three phases, as in the thesis: from the outputs to the sources each node's candidates are
filtered by those of its readers, then from the sources to the outputs by those of the nodes that it reads, and what is
left is searched exhaustively.

Links make the costs a sum over pairs of nodes, so the search needs no enumeration. First a candidate goes that another
one beats whatever the neighbours choose (dead-end elimination, Desmet et al. 1992). Then nodes are eliminated one after
the other, those with the fewest combinations of neighbours first: for each combination the best candidate is kept, and
its cost passed on (non-serial dynamic programming, Bertele and Brioschi 1972). That is exact. Only where a node has more
than MAX_COMBINATIONS is the one with the most links fixed to what costs least as far as its own links tell; the choice
for the whole graph may then cost more than the least, or not be found.
"""

import heapq
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import count

import numpy as np

from ..errors import SceneError
from .library import TYPES, Library, Overload
from .model import OUTPUTS, Graph, Link

MAX_COMBINATIONS = 1 << 14

# Units of cost: each is more than all that a graph can have of the smaller ones, and sums are exact.
_CONVERSION, _COMPONENT, _ALPHA = 1.0, 2.0**17, 2.0**34
_IMPOSSIBLE = 2.0**52

_Pairs = Mapping[tuple[int, int], np.ndarray]  # costs of two nodes' choices together: rows are the first one's


@cache
def conversion_cost(source: str, target: str) -> float:
    """Of reading one of TYPES as another; infinite where that is not possible."""
    if target.endswith("_D") and not source.endswith("_D"):
        return np.inf
    dropped = source.endswith("_D") and not target.endswith("_D")
    return width_cost(width_of(source), width_of(target)) + (_CONVERSION if dropped else 0.0)


def width_cost(source: int, target: int) -> float:
    """The same for numbers of components, which is all that counts of a constant."""
    if source == target:
        return 0.0
    if {source, target} == {3, 4}:
        return _ALPHA
    return _CONVERSION if source == 1 else np.inf


def width_of(type_name: str) -> int:
    """Components of a value of one of TYPES."""
    return int(type_name.removesuffix("_D")[5:] or 1)


@cache
def components(overload: Overload) -> int:
    """Numbers that a node computes."""
    return sum(width_of(t) * (3 if t.endswith("_D") else 1) for t in overload.outputs.values())


def infer(graph: Graph, nodes: Library) -> tuple[Overload, ...]:
    """The overload of each node of a prepared graph. Raises SceneError, naming node and socket, where none fits."""
    if not graph.nodes:
        return ()
    search = _Candidates(graph, nodes)
    search.filter_from_outputs()
    search.filter_from_sources()
    chosen = _solve(*search.costs())
    if chosen is None:
        raise search.contradiction()
    return tuple(
        nodes[node.kind][kept[choice]] for node, kept, choice in zip(graph.nodes, search.kept, chosen, strict=True)
    )


@cache
def _link_costs(writers: tuple[Overload, ...], written: str, readers: tuple[Overload, ...], read: str) -> np.ndarray:
    """(writers, readers) cost of the conversion between two sockets for each pair of candidates."""
    costs = [[conversion_cost(w.outputs[written], r.inputs[read]) for r in readers] for w in writers]
    return np.array(costs)


class _Candidates:
    """The overloads that each node may still take, by index: `kept`."""

    def __init__(self, graph: Graph, nodes: Library):
        self._graph = graph
        self._overloads = [nodes[node.kind] for node in graph.nodes]
        self.kept = [list(range(len(overloads))) for overloads in self._overloads]
        self._own = [_COMPONENT * np.array([components(o) for o in overloads]) for overloads in self._overloads]
        self._links: list[list[tuple[str, Link, np.ndarray]]] = []  # by reader: socket, what it reads, costs
        for reader, node in enumerate(graph.nodes):
            links = [(socket, source) for socket, source in node.inputs.items() if isinstance(source, Link)]
            self._links.append([(socket, source, self._costs(reader, socket, source)) for socket, source in links])
            for socket, source in node.inputs.items():
                if not isinstance(source, Link):
                    self._read_constant(reader, socket, len(source))
        for output, source in graph.outputs.items():
            if isinstance(source, Link):
                self._read_output(output, source)

    def filter_from_outputs(self) -> None:
        """First phase: whoever writes what nobody can read goes, readers before those that they read."""
        for reader in reversed(range(len(self._links))):
            for socket, source, costs in self._links[reader]:
                if not self._keep(source.node, np.isfinite(costs[:, self.kept[reader]]).any(axis=1)):
                    raise self._mismatch(reader, socket, source)

    def filter_from_sources(self) -> None:
        """Second phase: whoever reads what is not written goes, writers before their readers."""
        for reader in range(len(self._links)):
            for socket, source, costs in self._links[reader]:
                if not self._keep(reader, np.isfinite(costs[self.kept[source.node]]).any(axis=0)):
                    raise self._mismatch(reader, socket, source)

    def contradiction(self) -> SceneError:
        """What to say of candidates that fit in pairs, but not all together. Raises SceneError itself where going on with
        the filters finds the place."""
        before = None
        while before != (before := [len(kept) for kept in self.kept]):
            self.filter_from_outputs()
            self.filter_from_sources()
        undecided = [node.place for node, size in zip(self._graph.nodes, before, strict=True) if size > 1]
        rest = f" and those of {len(undecided) - 1} other nodes" if len(undecided) > 1 else ""
        return SceneError(
            f"{undecided[0]}: its types{rest} fit in pairs, but not together; expected types that convert"
        )

    def costs(self) -> tuple[list[np.ndarray], _Pairs]:
        """Of what is kept: each node's own costs, and those of each pair of nodes with a link, by their numbers in order."""
        pairs: dict[tuple[int, int], np.ndarray] = {}
        own = [costs[kept] for costs, kept in zip(self._own, self.kept, strict=True)]
        for reader, links in enumerate(self._links):
            for _, source, costs in links:
                pair, kept = (source.node, reader), costs[self.kept[source.node]][:, self.kept[reader]]
                pairs[pair] = pairs[pair] + kept if pair in pairs else kept
        return own, pairs

    def _costs(self, reader: int, socket: str, source: Link) -> np.ndarray:
        return _link_costs(self._overloads[source.node], source.socket, self._overloads[reader], socket)

    def _keep(self, node: int, fits: np.ndarray) -> bool:
        """Only those candidates of a node that fit; False, and all of them, if none does."""
        kept = [candidate for candidate in self.kept[node] if fits[candidate]]
        self.kept[node] = kept or self.kept[node]
        return bool(kept)

    def _read_constant(self, reader: int, socket: str, width: int) -> None:
        costs = np.array([width_cost(width, width_of(o.inputs[socket])) for o in self._overloads[reader]])
        self._own[reader] = self._own[reader] + costs
        if not self._keep(reader, np.isfinite(costs)):
            place, wanted = (
                f"{self._graph.nodes[reader].place}: socket {socket}",
                _type_names(self._wanted(reader, socket)),
            )
            raise SceneError(f"{place}: it is given a constant of {width}; expected {wanted}")

    def _read_output(self, output: str, source: Link) -> None:
        channels = OUTPUTS[output]
        wanted = "float" if channels == 1 else f"float{channels}"
        costs = np.array([conversion_cost(o.outputs[source.socket], wanted) for o in self._overloads[source.node]])
        self._own[source.node] = self._own[source.node] + costs
        if not self._keep(source.node, np.isfinite(costs)):
            place = f"{self._graph.name}: output {output}"
            raise SceneError(f"{place}: it is given {self._offer(source)}; expected {wanted}")

    def _wanted(self, reader: int, socket: str) -> set[str]:
        return {self._overloads[reader][candidate].inputs[socket] for candidate in self.kept[reader]}

    def _offer(self, source: Link) -> str:
        types = {self._overloads[source.node][candidate].outputs[source.socket] for candidate in self.kept[source.node]}
        return f"{_type_names(types)} by socket {source.socket} of {self._graph.nodes[source.node].place}"

    def _mismatch(self, reader: int, socket: str, source: Link) -> SceneError:
        place = f"{self._graph.nodes[reader].place}: socket {socket}"
        wanted = _type_names(self._wanted(reader, socket))
        return SceneError(f"{place}: it is given {self._offer(source)}; expected {wanted}")


def _type_names(types: set[str]) -> str:
    """For messages: what carries derivatives is named only where nothing else of its width is there."""
    plain = {t for t in types if not t.endswith("_D")}
    names = [t.replace("_D", " with derivatives") for t in TYPES if t in plain or t in types and t[:-2] not in plain]
    return " or ".join(names)


@dataclass
class _Factor:
    """A cost of several nodes together: an array with one axis for each, in `nodes`' order."""

    nodes: tuple[int, ...]
    costs: np.ndarray


def _solve(own: list[np.ndarray], pairs: _Pairs) -> list[int] | None:
    """The third phase: each node's choice, as a place in its costs, with the least total; None if none is possible."""
    own, pairs = _without_decided(own, pairs)
    left = _without_beaten(own, pairs)
    own = [costs[choices] for costs, choices in zip(own, left, strict=True)]
    pairs = {(a, b): costs[left[a]][:, left[b]] for (a, b), costs in pairs.items()}
    own, pairs = _without_decided(own, pairs)
    if any(not np.isfinite(costs).any() for costs in own):
        return None
    factors = [_Factor((node,), costs) for node, costs in enumerate(own) if len(costs) > 1]
    factors += [_Factor(pair, costs) for pair, costs in pairs.items()]
    places = _Elimination(factors).solve()
    return None if places is None else [choices[places.get(node, 0)] for node, choices in enumerate(left)]


def _without_decided(own: list[np.ndarray], pairs: _Pairs) -> tuple[list[np.ndarray], _Pairs]:
    """The same costs, where those of a pair with a node that has one choice are the other one's own."""
    own, open_pairs = list(own), {}
    for (a, b), costs in pairs.items():
        if len(own[a]) == 1:
            own[b] = own[b] + costs[0]
        elif len(own[b]) == 1:
            own[a] = own[a] + costs[:, 0]
        else:
            open_pairs[a, b] = costs
    return own, open_pairs


def _without_beaten(own: list[np.ndarray], pairs: _Pairs) -> list[list[int]]:
    """By node, the choices that no other one of it beats or equals whatever its neighbours choose; readers first, and once
    more from the sources."""
    left = [list(range(len(costs))) for costs in own]
    links: dict[int, list[tuple[int, np.ndarray]]] = defaultdict(list)
    for (writer, reader), costs in pairs.items():
        bounded = np.minimum(costs, _IMPOSSIBLE)
        links[writer].append((reader, bounded))
        links[reader].append((writer, bounded.T))
    for node in (*sorted(links, reverse=True), *sorted(links)):
        mine = left[node]
        if len(mine) == 1:
            continue
        costs = np.minimum(own[node][mine], _IMPOSSIBLE)
        worse = costs[:, None] - costs[None, :]  # at most by how much a choice is worse than another
        for other, linked in links[node]:
            table = linked[mine][:, left[other]]
            worse += (table[:, None] - table[None, :]).max(axis=2)
        beaten: set[int] = set()
        for a in range(len(mine)):
            if a not in beaten:
                beaten |= {b for b in range(len(mine)) if b != a and worse[a, b] <= 0}
        left[node] = [choice for a, choice in enumerate(mine) if a not in beaten]
    return left


class _Elimination:
    """Nodes leave one by one; each leaves behind a factor over its neighbours, and a table of its best choices."""

    def __init__(self, factors: Sequence[_Factor]):
        self._factors = dict(enumerate(factors))
        self._numbers = count(len(factors))
        self._of: dict[int, set[int]] = defaultdict(set)  # by node, the factors that it is in
        self._sizes: dict[int, int] = {}
        for number, factor in self._factors.items():
            for node, size in zip(factor.nodes, factor.costs.shape, strict=True):
                self._of[node].add(number)
                self._sizes[node] = size
        self._best: list[tuple[int, tuple[int, ...], np.ndarray]] = []  # node, neighbours, its place for their places

    def solve(self) -> dict[int, int] | None:
        """The place of each node; None if there is no solution."""
        queue = [(self._combinations(node), node) for node in self._sizes]
        heapq.heapify(queue)
        waiting = set(self._sizes)
        while queue:
            combinations, node = heapq.heappop(queue)
            if node not in waiting:
                continue
            now = self._combinations(node)
            if now > combinations:  # others that left have joined its neighbours since
                heapq.heappush(queue, (now, node))
                continue
            touched = self._neighbours(node)
            if now > MAX_COMBINATIONS:
                node = max(touched & waiting, key=lambda other: (len(self._of[other]), -other))
                touched |= self._neighbours(node)
            if not (self._fix(node) if now > MAX_COMBINATIONS else self._eliminate(node)):
                return None
            waiting.discard(node)
            for other in touched & waiting:
                heapq.heappush(queue, (self._combinations(other), other))
        places: dict[int, int] = {}
        for node, others, best in reversed(self._best):
            places[node] = int(best[tuple(places[other] for other in others)])
        return places

    def _neighbours(self, node: int) -> set[int]:
        return {other for number in self._of[node] for other in self._factors[number].nodes}

    def _combinations(self, node: int) -> int:
        combinations = 1
        for other in self._neighbours(node):
            combinations *= self._sizes[other]
            if combinations > MAX_COMBINATIONS:
                break
        return combinations

    def _eliminate(self, node: int) -> bool:
        others = tuple(sorted(self._neighbours(node) - {node}))
        axes = {other: axis for axis, other in enumerate((*others, node))}
        total = np.zeros([self._sizes[n] for n in axes])
        for number in sorted(self._of[node]):
            factor = self._factors[number]
            order = sorted(range(len(factor.nodes)), key=lambda i: axes[factor.nodes[i]])
            shape = np.ones(len(axes), int)
            shape[[axes[factor.nodes[i]] for i in order]] = [factor.costs.shape[i] for i in order]
            total = total + factor.costs.transpose(order).reshape(shape)
            self._remove(number)
        best = total.argmin(axis=-1)
        least = total.min(axis=-1)
        self._best.append((node, others, best))
        if others and np.isfinite(least).any():
            self._add(_Factor(others, least))
        return bool(np.isfinite(least).any())

    def _add(self, factor: _Factor) -> None:
        number = next(self._numbers)
        self._factors[number] = factor
        for node in factor.nodes:
            self._of[node].add(number)

    def _remove(self, number: int) -> None:
        for node in self._factors.pop(number).nodes:
            self._of[node].discard(number)

    def _fix(self, node: int) -> bool:
        """Give the node the choice that costs least as far as its own factors tell."""
        factors = [(self._factors[number], number) for number in sorted(self._of[node])]
        axes = [factor.nodes.index(node) for factor, _ in factors]
        least = np.zeros(self._sizes[node])
        for (factor, _), axis in zip(factors, axes, strict=True):
            least = least + factor.costs.min(axis=tuple(i for i in range(factor.costs.ndim) if i != axis))
        place = int(least.argmin())
        self._best.append((node, (), np.array(place)))
        for (factor, number), axis in zip(factors, axes, strict=True):
            self._remove(number)
            if others := factor.nodes[:axis] + factor.nodes[axis + 1 :]:
                self._add(_Factor(others, factor.costs.take(place, axis=axis)))
        return bool(np.isfinite(least[place]))
