"""Regions of a traced function, the groups of items that run them, and what these take and hand on."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, NamedTuple

from holdfast.compiler.errors import CompileError
from holdfast.compiler.graph import Graph
from holdfast.compiler.node import Node
from holdfast.compiler.values import Leaf

Classes = tuple[int, ...]  # which numbers of a carry are one and the same


class RegionInput(NamedTuple):
    """A port of a region, and where its numbers are in an item: which of which leaf."""

    inputs: Leaf
    leaf: int
    places: tuple[int, ...]


class Traversal(NamedTuple):
    """What a loop's body does in a region.

    Attributes:
        value: what it returns for an item.
        ports: what it takes.
        carry: what a scan hands on, or None.
        carried: the region's inputs of what it is handed.
        after: where the region can be gone on with.
    """

    value: Any
    ports: tuple[RegionInput, ...]
    carry: Any
    carried: Leaf
    after: Region


class Region:
    """A traced function under way: a graph that grows with every loop over its items.

    Attributes:
        graph: of one item.
        further: how the function went on from here, by what it did.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.further: dict[Hashable, Traversal] = {}


class Outside(NamedTuple):
    """What lies around the regions.

    Attributes:
        graph: the glue's.
        origins: of images.
    """

    graph: Graph
    origins: dict[Node, Origin]


class Images(dict[Node, Node]):
    """Numbers of a region as they are outside, for one item of a group."""

    def __init__(self, outside: Outside, group: TracedGroup, item: int) -> None:
        super().__init__()
        self.outside, self.group, self.item = outside, group, item

    def __missing__(self, node: Node) -> Node:
        if node.is_truth:
            raise CompileError("a loop returned the truth of a comparison; try where(condition, 1.0, 0.0)")
        image = self[node] = self.outside.graph.input()
        self.outside.origins[image] = Origin(self.group, self.item, node)
        return image


class Origin(NamedTuple):
    """Where an image comes from."""

    group: TracedGroup
    item: int
    node: Node


class Source(NamedTuple):
    """What a port is given.

    Attributes:
        inputs: the region's.
        phase: when; 0: parameters only.
        numbers: per item, numbers outside; None for a carry.
        before: for a carry, the scan.
    """

    inputs: Leaf
    phase: int
    numbers: tuple[Leaf, ...] | None
    before: Scan | None = None


class TracedGroup:
    """Items that run one region.

    Attributes:
        name: for messages and machine code.
        region: where the traced function is.
        count: how many items there are.
        sources: of its ports, in the order of their making.
        done: how many phases have been called.
        images: per item.
        turns: of the scan whose groups they are; None for independent items.
    """

    def __init__(self, outside: Outside, name: str, region: Region, count: int, turns: Turns | None) -> None:
        self.name, self.region, self.count, self.turns = name, region, count, turns
        self.sources: list[Source] = []
        self.done = 0
        self.images = [Images(outside, self, i) for i in range(count)]
        self._phases: list[int] = []
        self._given: dict[int, int] = {}

    def take(self, source: Source) -> None:
        """Add a port."""
        self.sources.append(source)
        for node in source.inputs:
            self._given[node.serial] = source.phase

    def phase(self, node: Node) -> int:
        """Return the phase that computes a number of the region."""
        phases, serial = self._phases, node.serial
        if serial < len(phases):
            return phases[serial]
        for n in self.region.graph.nodes[len(phases) : serial + 1]:
            latest = 0
            for a in n.args:
                if phases[a.serial] > latest:
                    latest = phases[a.serial]
            if n.kind == "input":
                latest = self._given.get(n.serial, -1)  # -1: another group's, which shares the region
            phases.append(latest)
        return phases[serial]


class Turns:
    """The groups of a scan, and the order in which their items wait to be run."""

    def __init__(self) -> None:
        self.open: list[tuple[TracedGroup, int]] = []


class Scan(NamedTuple):
    """One scan.

    Attributes:
        first: the carry's numbers before it, each once.
        order: group, item and traversal, one after the other.
        kept: by item and after the last, which numbers of the carry are kept, and what shape they have.
        handed: by item, the numbers that it hands on, each once.
    """

    first: tuple[Any, ...]
    order: tuple[tuple[TracedGroup, int, Traversal], ...]
    kept: tuple[tuple[Classes, Hashable], ...]
    handed: tuple[tuple[Any, ...], ...]

    def source(self, group: TracedGroup) -> Source:
        """Return what a group's region is handed."""
        return next(source for source in group.sources if source.before is self)


class PhaseCall(NamedTuple):
    """A phase of a group called for items; what the glue has to do before is done then."""

    group: TracedGroup
    phase: int
    items: tuple[int, ...]
