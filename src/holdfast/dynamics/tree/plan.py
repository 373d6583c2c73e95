"""The plan of a forest: the parts in which its loops settle, and the order of the elimination, from topology alone.

The vertices of the graph are the bodies and the world; its edges are joints, closures and couplings. A free body hangs
on nothing. A part is a union of biconnected components that is joined to the rest by one vertex, its root. Conditioning
a part on the acceleration of its root loses no rank if the joint between the root and its parent lies outside the part
(docs/theory/tree.md); a component for which it lies inside is therefore joined to the one nearer to the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

from holdfast.dynamics.tree.branches import ForestPart
from holdfast.dynamics.tree.order import Cross, CrossAll, PlanStep, ordered
from holdfast.model.forest import GROUND, Topology


class Settle(NamedTuple):
    """The elimination of a body after everything that hangs on it: of its joint, or of a free body.

    Bodies over which the root of a part moves inward (`Cross`) settle among its steps.

    Attributes:
        body: the body.
        part: index of the part of which it is a member; None for a free body that is the root of a tree.
    """

    body: int
    part: int | None


class Condense(NamedTuple):
    """The elimination of a part, whose members have settled, by its steps; inertia and load remain at its root."""

    part: int


class EliminationPlan(NamedTuple):
    """The order of the elimination.

    Attributes:
        parts: the parts.
        steps: per part, its steps.
        inward: what is eliminated, in order; the way back goes through it in reverse.
    """

    parts: tuple[ForestPart, ...]
    steps: tuple[tuple[PlanStep, ...], ...]
    inward: tuple[Settle | Condense, ...]


class Edge(NamedTuple):
    """An edge of the graph: a joint, a closure or a part of a coupling, by its number, and its two vertices."""

    kind: str
    number: int
    ends: tuple[int, int]


@lru_cache(maxsize=256)
def plan_of(
    topology: Topology, leaves: bool = True, trunk: tuple[int, ...] | None = None, rates: bool = False
) -> EliminationPlan:
    """Return the plan of a forest. The search for the order is cubic in the number of a part's branches.

    Args:
        topology: its graph.
        leaves: whether a chain of joints that only one closure needs is one step; otherwise every joint is a step.
        trunk: bodies one on the other over which the root moves, even if only one closure needs them; everything that
            is connected is one part then. By default, loops that share one body settle there one after the other.
        rates: whether the columns are the rates of the joints below a part's root instead of the root's acceleration.
    """
    found, roots = parts_of_graph(topology, cut=trunk is None)
    rooted: dict[int, list[int]] = {}
    for i, part in enumerate(found):
        rooted.setdefault(part.root, []).append(i)

    steps = tuple(ordered(topology, part, leaves, trunk, rates) for part in found)

    def settled(vertex: int) -> Iterator[Settle | Condense]:
        for i in rooted.get(vertex, []):
            crossed = crossed_bodies(steps[i])
            for k in found[i].members:
                yield from settled(k)
                if k not in crossed:
                    yield Settle(k, i)
            yield Condense(i)

    inward: list[Settle | Condense] = []
    for root in roots:
        inward += settled(root)
        if root != GROUND:
            inward.append(Settle(root, None))
    return EliminationPlan(tuple(found), steps, tuple(inward))


def crossed_bodies(steps: Sequence[PlanStep]) -> set[int]:
    """Return the bodies over whose joints the root of a part moves inward."""
    all_at_once = [k for step in steps if isinstance(step, CrossAll) for k in step.bodies]
    return {*all_at_once, *(step.body for step in steps if isinstance(step, Cross))}


def depths(topology: Topology) -> list[int]:
    """Return per body the number of joints between it and the world, or its tree's free body."""
    found: list[int] = []
    for parent in topology.parents:
        found.append(0 if parent == GROUND else found[parent] + 1)
    return found


def parts_of_graph(topology: Topology, cut: bool = True) -> tuple[list[ForestPart], list[int]]:
    """Return the parts, and the vertices on which the separate graphs hang: the world first, then free bodies.

    Args:
        topology: the graph.
        cut: whether a part may settle at a body that it shares with another one.
    """
    edges = edges_of(topology)
    depth, roots, parts = depths(topology), [], []
    seen: set[int] = set()
    for start in _starts(topology):
        if start in seen:
            continue
        roots.append(start)
        found = components(start, edges, seen)
        whole = [(start, [edge for _, inside in found for edge in inside])] if found else []
        for root, inside in _merged(found) if cut else whole:
            members = {vertex for edge in inside for vertex in edge.ends} - {root, GROUND}
            deepest_first = tuple(sorted(members, key=lambda k: (-depth[k], k)))
            of = {kind: tuple(sorted({e.number for e in inside if e.kind == kind})) for kind in ("closure", "coupling")}
            parts.append(ForestPart(root, deepest_first, of["closure"], of["coupling"]))
    return parts, roots


def edges_of(topology: Topology) -> list[Edge]:
    """Return the edges of the graph; a coupling connects all bodies on both sides of its joints."""
    edges = [Edge("joint", k, (p, k)) for k, p in enumerate(topology.parents) if not topology.free[k]]
    edges += [Edge("closure", i, ends) for i, ends in enumerate(topology.ends)]
    for i, bodies in enumerate(topology.coupled):
        both = sorted({*bodies, *(topology.parents[k] for k in bodies)})
        edges += [Edge("coupling", i, pair) for pair in combinations(both, 2)]
    return edges


def _starts(topology: Topology) -> list[int]:
    """Return the vertices at which a search may begin: the world, then the free bodies with the largest trees."""
    carried = [0] * len(topology.parents)
    for k in range(len(carried)):
        top = k
        while topology.parents[top] != GROUND:
            top = topology.parents[top]
        carried[top] += 1
    return [GROUND, *sorted((k for k, free in enumerate(topology.free) if free), key=lambda k: -carried[k])]


def components(start: int, edges: list[Edge], seen: set[int]) -> list[tuple[int, list[Edge]]]:
    """Return the biconnected components that are reached from a vertex, each with the vertex nearest to it.

    Depth-first search without recursion (J. Hopcroft and R. Tarjan, Algorithm 447, 1973). Vertices reached are added to
    `seen`. The components farther from the start come first.
    """
    adjacent: dict[int, list[tuple[int, int]]] = {}
    for e, edge in enumerate(edges):
        a, b = edge.ends
        adjacent.setdefault(a, []).append((e, b))
        adjacent.setdefault(b, []).append((e, a))
    number, low, used, stack, found = {start: 0}, {start: 0}, set(), [], []
    way = [(start, -1, iter(adjacent.get(start, [])))]
    seen.add(start)
    while way:
        vertex, by, rest = way[-1]
        for e, other in rest:
            if e in used:
                continue
            used.add(e)
            stack.append(e)
            if other not in number:
                number[other] = low[other] = len(number)
                seen.add(other)
                way.append((other, e, iter(adjacent[other])))
                break
            low[vertex] = min(low[vertex], number[other])
        else:
            way.pop()
            if way:
                above = way[-1][0]
                low[above] = min(low[above], low[vertex])
                if low[vertex] >= number[above]:
                    first = stack.index(by)
                    found.append((above, [edges[e] for e in stack[first:]]))
                    del stack[first:]
    return found


def _merged(found: list[tuple[int, list[Edge]]]) -> list[tuple[int, list[Edge]]]:
    """Return the components, after joining those whose root moves by a joint inside to the one nearer to the start."""
    found = [(root, list(inside)) for root, inside in found]
    while True:
        wrong = next((c for c in found if any(e.kind == "joint" and e.number == c[0] for e in c[1])), None)
        if wrong is None:
            return found
        root, inside = wrong
        above = next(c for c in found if c is not wrong and c[0] != root and any(root in e.ends for e in c[1]))
        above[1].extend(inside)
        found.remove(wrong)
