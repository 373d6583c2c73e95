"""A part of a forest, and what the search for its order has to know: what hangs on what, and where closures end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from holdfast.model.forest import GROUND, Topology


class ForestPart(NamedTuple):
    """Bodies whose loops settle together.

    Attributes:
        root: the vertex on which they hang, a body or `GROUND`.
        members: the other bodies, the deepest first.
        closures: indices of its closures.
        couplings: indices of its couplings.
    """

    root: int
    members: tuple[int, ...]
    closures: tuple[int, ...]
    couplings: tuple[int, ...]


@dataclass(frozen=True)
class Branches:
    """What the search has to know of a part.

    Attributes:
        topology: the forest's graph.
        part: the part.
        closures_at: by vertex, the closures that need its acceleration.
        noted: by body, the couplings that need its joint accelerations.
        children: by vertex, the members on joints to it that lead to a closure or a coupling.
    """

    topology: Topology
    part: ForestPart
    closures_at: dict[int, list[int]]
    noted: dict[int, list[int]]
    children: dict[int, list[int]]

    @staticmethod
    def of(topology: Topology, part: ForestPart) -> Branches:
        """Return the branches of a part."""
        vertices = [part.root, GROUND, *part.members]
        closures_at = {v: [i for i in part.closures if v in topology.ends[i]] for v in vertices}
        noted = {k: [i for i in part.couplings if k in topology.coupled[i]] for k in part.members}
        children: dict[int, list[int]] = {v: [] for v in vertices}
        for k in part.members:  # the deepest first, so that what hangs on k is known
            if not topology.free[k] and (closures_at[k] or noted[k] or children[k]):
                children[topology.parents[k]].append(k)
        return Branches(topology, part, closures_at, noted, {v: sorted(ks) for v, ks in children.items()})

    def above(self, vertex: int) -> list[int]:
        """Return a body and those on which it hangs, from itself inward."""
        found = []
        while vertex != GROUND:
            found.append(vertex)
            vertex = self.topology.parents[vertex]
        return found

    def backbone(self, trunk: Sequence[int] = ()) -> list[int]:
        """Return the bodies over whose joints the root moves inward, the outermost first.

        They are those on which several closures hang, one on the other, as long as nothing else does. What hangs on
        one of them may be closed only with itself and with free bodies on which nothing hangs, and coupled only with
        itself. Those of a trunk are always among them.
        """
        found, vertex = [], self.part.root
        while True:
            below = [k for k in self._below(vertex) if self._hanging(k) > 1 or k in trunk]
            if len(below) != 1 or not self._by_itself(below[0]):
                return found[::-1]
            vertex = below[0]
            found.append(vertex)

    def _below(self, vertex: int) -> list[int]:
        """Return the children of a vertex; free bodies with children are those of the world."""
        free = [k for k in self.part.members if self.topology.free[k] and self.children[k]] if vertex == GROUND else []
        return [*self.children.get(vertex, []), *free]

    def _hanging(self, k: int) -> int:
        """Return the number of closures that need a body or what hangs on it."""
        return sum(any(k in self.above(v) for v in self.topology.ends[i] if v != GROUND) for i in self.part.closures)

    def _by_itself(self, k: int) -> bool:
        """Return whether a body's joint may be crossed; see `backbone`."""
        free, ends = self.topology.free, self.topology.ends
        for i in self.part.closures:
            within = [v for v in ends[i] if v != GROUND and k in self.above(v)]
            others = [v for v in ends[i] if v not in within]
            if within and any(v == GROUND or not free[v] or self.children[v] for v in others):
                return False
        for i in self.part.couplings:
            within = [k in self.above(j) and j != k for j in self.topology.coupled[i]]
            if any(j in self.above(k) for j in self.topology.coupled[i]) or (any(within) and not all(within)):
                return False
        return True
