"""Find what the results of a traced composition depend on; the rest is not computed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from holdfast.compiler.composition import Composition
from holdfast.compiler.node import Node
from holdfast.compiler.region import PortSource, TracedGroup


class Needed:
    """The inputs of regions on which the results depend.

    Attributes:
        inputs: the needed inputs of each group's region.
        alike: lists of groups that have the same region. What one of them needs is passed to all of them, so that
            they share their code.
        read: the groups of which the glue or other groups read something that is needed.
    """

    def __init__(self, traced: Composition) -> None:
        regions: dict[object, list[TracedGroup]] = {}
        for group in traced.groups:
            regions.setdefault((group.region, group.count, group.done), []).append(group)
        self.traced, self.alike = traced, list(regions.values())
        self._first = {group: alike[0] for alike in self.alike for group in alike}
        self._like = {alike[0]: alike for alike in self.alike}
        of_first: dict[TracedGroup, set[Node]] = {alike[0]: set() for alike in self.alike}
        self.read: set[TracedGroup] = set()
        self.inputs = {group: of_first[self._first[group]] for group in traced.groups}
        self._given = {
            group: {node: (source, k) for source in group.sources for k, node in enumerate(source.inputs)}
            for group in traced.groups
        }

    def follow(self, results: Iterable[Node]) -> None:
        """Mark everything that the given nodes of the glue depend on."""
        seen: dict[TracedGroup | None, set[Node]] = {group: set() for group in (None, *self._like)}
        elsewhere: list[tuple[TracedGroup | None, list[Node]]] = [(None, list(results))]
        while elsewhere:
            group, here = elsewhere.pop()
            known = seen[group]
            while here:
                node = here.pop()
                if node not in known:
                    known.add(node)
                    here += node.args
                    if node.kind == "input":
                        elsewhere += self._origin(node) if group is None else self._given_to(group, node)

    def _origin(self, node: Node) -> list[tuple[TracedGroup | None, list[Node]]]:
        """Note and return the group and the region node that an input of the glue is an image of, if it is one."""
        origin = self.traced.origins.get(node)
        if origin is None:
            return []
        self.read.add(origin.group)
        return [(self._first[origin.group], [origin.node])]

    def _given_to(self, group: TracedGroup, node: Node) -> list[tuple[TracedGroup | None, list[Node]]]:
        """Mark an input of a region as needed; return the nodes that feed it in all groups of that region."""
        self.inputs[group].add(node)
        sources = [self._sources(*self._given[other][node]) for other in self._like[group]]
        return [(maker and self._first[maker], nodes) for found in sources for maker, nodes in found]

    def _sources(self, source: PortSource, k: int) -> list[tuple[TracedGroup | None, list[Node]]]:
        """Return the nodes, with their groups, that feed input number `k` of a source in any item."""
        if source.numbers is not None:
            return [(None, [of_one[k] for of_one in source.numbers])]
        scan = source.before
        assert scan is not None
        found: list[tuple[TracedGroup | None, Any]] = []
        carries = {group: scan.source(group) for group in dict.fromkeys(group for group, *_ in scan.order)}
        alike = next(kept for kept, (group, *_) in zip(scan.kept, scan.order, strict=False) if carries[group] is source)
        for j, (group, _, _) in enumerate(scan.order):
            if scan.kept[j] == alike:
                found.append((group, carries[group].inputs[k]))  # these items share the array, hence its size
                if j == 0:
                    found.append((None, scan.first[k]))
                else:
                    found.append((scan.order[j - 1][0], scan.handed[j - 1][k]))
        return [(group, [x]) for group, x in found if isinstance(x, Node)]
