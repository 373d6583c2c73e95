"""Regions (traced bodies of loops), the groups of items that run them, and the connections between them.

"Outside" of a region is the glue: the graph of what is computed between the loops.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, NamedTuple

from holdfast.compiler.errors import CompileError
from holdfast.compiler.graph import Graph
from holdfast.compiler.node import Node
from holdfast.compiler.values import Leaf

Classes = tuple[int, ...]  # for every number of a carry, the index of its class of equal numbers


class RegionInput(NamedTuple):
    """A port of a region: its input nodes, and the leaf of an item and places in that leaf that feed them."""

    inputs: Leaf
    leaf: int
    places: tuple[int, ...]


class ScanCarry(NamedTuple):
    """A carry of a scan, taken apart.

    Attributes:
        value: the carry.
        numbers: its numbers.
        classes: which of these are the same.
        shape: the key of the rest.
    """

    value: Any
    numbers: list[Any]
    classes: Classes
    shape: Hashable


class Traversal(NamedTuple):
    """One run of a loop's body in a region.

    Attributes:
        value: what the body returns for an item, made of nodes of the region.
        ports: the ports that it added to the region.
        carry: the carry that the body of a scan returns; that of the value None for `each`.
        carried: the region's inputs for the carry that the body receives.
        after: the region as it is after this run.
    """

    value: Any
    ports: tuple[RegionInput, ...]
    carry: ScanCarry
    carried: Leaf
    after: Region


class Region:
    """A graph that is traced for one item and grows with every loop over the same items.

    Attributes:
        graph: the graph of one item.
        further: the runs of loop bodies that started from this state, by body and item.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.further: dict[Hashable, Traversal] = {}


class Outside(NamedTuple):
    """The surroundings of all regions.

    Attributes:
        graph: the graph of the glue.
        origins: the origin of every image.
    """

    graph: Graph
    origins: dict[Node, ImageOrigin]


class Images(dict[Node, Node]):
    """The images of a region's nodes in the glue, for one item of a group; each is made when first asked for."""

    def __init__(self, outside: Outside, group: TracedGroup, item: int) -> None:
        super().__init__()
        self.outside, self.group, self.item = outside, group, item

    def of(self, nodes: Leaf) -> tuple[Node, ...]:
        """Return the images of several nodes.

        Raises:
            CompileError: one of them is the truth of a comparison.
        """
        new = [node for node in nodes if node not in self]
        if new:
            if any(node.is_truth for node in new):
                raise CompileError("a loop returned the truth of a comparison; try where(condition, 1.0, 0.0)")
            images = self.outside.graph.inputs(len(new))
            origins = [ImageOrigin(self.group, self.item, node) for node in new]
            self.update(zip(new, images, strict=True))
            self.outside.origins.update(zip(images, origins, strict=True))
        return tuple([self[node] for node in nodes])

    def __missing__(self, node: Node) -> Node:
        return self.of((node,))[0]


class ImageOrigin(NamedTuple):
    """The group, the item and the region's node that an image stands for."""

    group: TracedGroup
    item: int
    node: Node


class PortSource(NamedTuple):
    """The numbers that feed a port.

    Attributes:
        inputs: the input nodes of the region.
        phase: the phase in which they become known; 0 if they depend on parameters only.
        numbers: the nodes of the glue that feed them, for every item; None for a carry.
        before: the scan, if the port receives its carry.
    """

    inputs: Leaf
    phase: int
    numbers: tuple[Leaf, ...] | None
    before: Scan | None = None


class TracedGroup:
    """Items that run one region.

    Attributes:
        name: its name in messages and in machine code.
        region: the region in its current state.
        count: the number of items.
        sources: the sources of its ports, in the order in which the ports were made.
        done: the number of phases called so far.
        images: the images of the region's nodes, for every item.
        turns: the queue of the scan to which the group belongs; None if its items are independent.
    """

    def __init__(self, outside: Outside, name: str, region: Region, count: int, turns: Turns | None) -> None:
        self.name, self.region, self.count, self.turns = name, region, count, turns
        self.sources: list[PortSource] = []
        self.done = 0
        self.images = [Images(outside, self, i) for i in range(count)]
        self._phases: list[int] = []
        self._given: dict[int, int] = {}

    def take(self, source: PortSource) -> None:
        """Add a port."""
        self.sources.append(source)
        for node in source.inputs:
            self._given[node.serial] = source.phase

    def phase(self, node: Node) -> int:
        """Return the phase that computes a node of the region."""
        phases, serial = self._phases, node.serial
        if serial < len(phases):
            return phases[serial]
        for n in self.region.graph.nodes[len(phases) : serial + 1]:
            latest = 0
            for a in n.args:
                if phases[a.serial] > latest:
                    latest = phases[a.serial]
            if n.kind == "input":
                latest = self._given.get(n.serial, -1)  # -1 if only another group with this region has the port
            phases.append(latest)
        return phases[serial]


class Turns:
    """The queue of a scan: the items, with their groups, that wait to be run in this order."""

    def __init__(self) -> None:
        self.open: list[tuple[TracedGroup, int]] = []


class Scan(NamedTuple):
    """One scan.

    Attributes:
        first: the distinct numbers of the initial carry.
        order: group, item and traversal of every item, in the order in which they run.
        kept: classes and shape of the carry before every item and after the last.
        handed: the distinct numbers of the carry that every item returns.
    """

    first: tuple[Any, ...]
    order: tuple[tuple[TracedGroup, int, Traversal], ...]
    kept: tuple[tuple[Classes, Hashable], ...]
    handed: tuple[tuple[Any, ...], ...]

    def source(self, group: TracedGroup) -> PortSource:
        """Return the source of the carry in a group."""
        return next(source for source in group.sources if source.before is self)


class PhaseCall(NamedTuple):
    """A call of one phase of a group for some of its items; the glue that it depends on runs before it."""

    group: TracedGroup
    phase: int
    items: tuple[int, ...]
