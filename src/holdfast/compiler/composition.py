"""Trace a function with loops: which regions run for which items, in which order, and what is computed between them.

`each` traces the loop's body for one item of each type into a graph, the region; all items of the type run it. For
every item the loop returns images: inputs of the outer graph, the glue, that stand for the region's nodes. A later
loop over images continues in the region that made them: each item in the region of its first image. When the glue
needs a node of a region, the region is called up to there, and the rest of it belongs to the next phase. What is
computed between loops belongs to the glue, which is cut into phases as well. Loops inside a region are unrolled.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any

from holdfast.compiler.graph import Graph
from holdfast.compiler.node import Node
from holdfast.compiler.region import (
    Classes,
    ImageOrigin,
    Outside,
    PhaseCall,
    PortSource,
    Region,
    RegionInput,
    Scan,
    ScanCarry,
    TracedGroup,
    Traversal,
    Turns,
)
from holdfast.compiler.values import ItemLeaf, Leaf, Values, numbers_of, with_numbers

Signature = tuple[Node | None, ...]


class Composition:
    """The state of a function that is being traced.

    Attributes:
        graph: the graph of the glue.
        parameters: the inputs of the glue that seldom change.
        origins: the group, item and region node that each image stands for.
        groups: all groups, in the order in which they were made.
        phase_calls: the phases called so far, in order.
        scans: all scans, in order.
        inside: whether a region is being traced.
    """

    def __init__(self) -> None:
        self.graph = Graph()
        self.parameters: set[Node] = set()
        self.origins: dict[Node, ImageOrigin] = {}
        self._outside = Outside(self.graph, self.origins)
        self.groups: list[TracedGroup] = []
        self.phase_calls: list[PhaseCall] = []
        self.scans: list[Scan] = []
        self._values = Values()
        self._regions: dict[Hashable, Region] = {}
        self._settled: set[Node] = set()
        self._constants: list[bool] = []
        self.inside = False

    def clear(self) -> None:
        """Forget everything that was traced, which is faster than to leave its many cycles to the garbage collector."""
        for group in self.groups:
            group.region.graph.clear()
            group.images.clear()
        self.graph.clear()
        self.origins.clear()
        self._values.clear()

    # ---- loops ----

    def each(self, f: Callable[..., Any], items: list[tuple[Any, ...]]) -> list[Any]:
        """Trace an `each` loop and return the value of every item, made of images."""
        flat = self._flat(f, items)
        found: list[Any] = [None] * len(items)
        left = set(range(len(items)))
        for group, order in self._complete(flat, scanned=False).items():
            left -= set(order)
            self._go_on(group, f, [items[j] for j in order], [flat[j] for j in order], found, order)
        by_type: dict[Hashable, list[int]] = {}
        for j in sorted(left):
            by_type.setdefault(flat[j][1], []).append(j)
        for key, order in by_type.items():
            group = self._group(f, ("each", key), len(order), None)
            self._go_on(group, f, [items[j] for j in order], [flat[j] for j in order], found, order)
        return found

    def _go_on(
        self,
        group: TracedGroup,
        f: Callable[..., Any],
        items: Sequence[Any],
        flat: Sequence[tuple[list[Leaf], Hashable]],
        found: list[Any],
        order: Sequence[int],
    ) -> None:
        """Continue a group's region with the loop's body, and write every item's value to `found`."""
        done = self._traversal(group.region, group, 0, f, items[0], flat[0])
        group.region = done.after
        self._give(group, done.ports, [leaves for leaves, _ in flat])
        for i, j in enumerate(order):
            found[j] = self._values.images(done.value, group.images[i])

    def scan(self, f: Callable[..., Any], carry: Any, items: list[tuple[Any, ...]]) -> tuple[Any, list[Any]]:
        """Trace a `scan` loop and return the last carry and the value of every item, made of images."""
        flat = self._flat(f, items)
        homes = self._all_again(flat)
        initial = self._taken_apart(carry)
        traversals, kept = self._traversals(f, initial, items, flat, homes)
        turns, order = self._order(f, traversals, flat, homes)
        if turns.open:
            self._call_turns(turns)
        first = _once(initial.numbers, kept[0][0])
        self.settle([x for x in first if isinstance(x, Node)])
        handed = [_once(t.carry.numbers, classes) for t, (classes, _) in zip(traversals, kept[1:], strict=True)]
        scan = Scan(first, tuple((g, i, t) for (g, i), t in zip(order, traversals, strict=True)), kept, tuple(handed))
        self.scans.append(scan)
        rows: dict[TracedGroup, list[tuple[int, int]]] = {}
        for j, (group, i) in enumerate(order):
            rows.setdefault(group, []).append((i, j))
        for group, pairs in rows.items():
            done = traversals[pairs[0][1]]
            group.region = done.after
            self._give(group, done.ports, [flat[j][0] for _, j in sorted(pairs)])
            group.take(PortSource(done.carried, group.done + 1, None, scan))
        turns.open = list(order)
        group, i = order[-1]
        images = group.images[i]
        last = with_numbers(traversals[-1].carry.value, lambda x: images[x] if isinstance(x, Node) else x)
        found = [self._values.images(t.value, g.images[i]) for (g, i), t in zip(order, traversals, strict=True)]
        return last, found

    def _traversals(
        self,
        f: Callable[..., Any],
        initial: ScanCarry,
        items: Sequence[Any],
        flat: Sequence[tuple[list[Leaf], Hashable]],
        homes: Sequence[tuple[TracedGroup, int]] | None,
    ) -> tuple[list[Traversal], tuple[tuple[Classes, Hashable], ...]]:
        """Return the traversal of every item, and the classes and shape of the carry before each item and at the end.

        Two numbers of the carry may be the same node for one item and differ for another. The classes that hold for
        all items are a fixed point: the items are traced again until the classes no longer change.
        """
        classes: dict[Hashable, Classes] = {initial.shape: initial.classes}
        while True:
            carry, traversals, kept = initial, [], []
            for j, x in enumerate(items):
                region = homes[j][0].region if homes else self._region(("scan", flat[j][1]))
                group, i = homes[j] if homes else (None, 0)
                carry = carry._replace(classes=classes[carry.shape])
                kept.append((carry.classes, carry.shape))
                traversals.append(self._traversal(region, group, i, f, x, flat[j], carry))
                carry = traversals[-1].carry
                known = classes.setdefault(carry.shape, carry.classes)
                if known != carry.classes:
                    classes[carry.shape] = _classes(list(zip(known, carry.classes, strict=True)))
                    if classes[carry.shape] != known:
                        break
            else:
                return traversals, (*kept, (classes[carry.shape], carry.shape))

    def _order(
        self,
        f: Callable[..., Any],
        traversals: Sequence[Traversal],
        flat: Sequence[tuple[list[Leaf], Hashable]],
        homes: Sequence[tuple[TracedGroup, int]] | None,
    ) -> tuple[Turns, list[tuple[TracedGroup, int]]]:
        """Return the queue that the scan's groups share, and every item's group and index in that group."""
        if homes:
            turns = homes[0][0].turns
            assert turns is not None
            return turns, list(homes)
        turns = Turns()
        counts: dict[int, int] = {}
        for t in traversals:
            counts[id(t)] = counts.get(id(t), 0) + 1
        groups: dict[int, TracedGroup] = {}
        order = []
        for j, t in enumerate(traversals):
            if id(t) not in groups:
                groups[id(t)] = self._group(f, ("scan", flat[j][1]), counts[id(t)], turns)
                counts[id(t)] = 0
            order.append((groups[id(t)], counts[id(t)]))
            counts[id(t)] += 1
        return turns, order

    def _all_again(self, flat: Sequence[tuple[list[Leaf], Hashable]]) -> list[tuple[TracedGroup, int]] | None:
        """Return every item's group and index if the items are exactly those of an earlier scan, in any order."""
        groups = self._complete(flat, scanned=True)
        turns = {group.turns for group in groups}
        known = {group for group in self.groups if group.turns in turns}
        if len(turns) != 1 or known != set(groups) or sum(map(len, groups.values())) != len(flat):
            return None
        found = {j: (group, i) for group, order in groups.items() for i, j in enumerate(order)}
        return [found[j] for j in range(len(flat))]

    # ---- regions ----

    def _flat(self, f: Callable[..., Any], items: list[tuple[Any, ...]]) -> list[tuple[list[Leaf], Hashable]]:
        """Return for every item the traced nodes of the item and then of the loop's body, and the key of both."""
        of_body, body = self._values.leaves(f)
        return [(found + of_body, (key, body)) for found, key in map(self._values.leaves, items)]

    def _complete(self, flat: Sequence[tuple[list[Leaf], Hashable]], scanned: bool) -> dict[TracedGroup, list[int]]:
        """Return the groups of which all items are among these, made of the same region nodes, and which they are.

        An item is of the group, and has the index in it, that its first node is an image of.
        """
        homes: dict[TracedGroup, dict[int, int]] = {}
        for j, (leaves, _) in enumerate(flat):
            home = self._home(leaves[0]) if leaves else None
            if home is not None and (home[0].turns is not None) == scanned:
                homes.setdefault(home[0], {})[home[1]] = j
        found = {}
        for group, places in homes.items():
            if len(places) < group.count:
                continue
            signs = {(flat[j][1], self._signature(flat[j][0], group, i)) for i, j in places.items()}
            if len(signs) == 1:
                found[group] = [places[i] for i in range(group.count)]
        return found

    def _home(self, leaf: Leaf) -> tuple[TracedGroup, int] | None:
        """Return the group, and the index in it, that the first node of a leaf is an image of."""
        if isinstance(leaf, ItemLeaf):
            return leaf.images.group, leaf.images.item
        origin = self.origins.get(leaf[0])
        return None if origin is None else (origin.group, origin.item)

    def _signature(self, leaves: Sequence[Leaf], group: TracedGroup | None, item: int) -> tuple[Signature, ...]:
        """Return, for every node of an item, the node of the group's region that it is an image of, or None."""
        signature = []
        for leaf in leaves:
            if isinstance(leaf, ItemLeaf):
                same = leaf.images.group is group and leaf.images.item == item
                signature.append(tuple(leaf.leaf) if same else (None,) * len(leaf))
                continue
            origins = map(self.origins.get, leaf)
            own = [o.node if o is not None and o.group is group and o.item == item else None for o in origins]
            signature.append(tuple(own))
        return tuple(signature)

    def _region(self, key: Hashable) -> Region:
        return self._regions.setdefault(key, Region(Graph()))

    def _group(self, f: Callable[..., Any], key: Hashable, count: int, turns: Turns | None) -> TracedGroup:
        name = f"{getattr(f, '__name__', type(f).__name__).strip('<>_')}{len(self.groups)}"
        group = TracedGroup(self._outside, name, self._region(key), count, turns)
        self.groups.append(group)
        return group

    def _traversal(
        self,
        region: Region,
        group: TracedGroup | None,
        item: int,
        f: Callable[..., Any],
        x: Any,
        flat: tuple[list[Leaf], Hashable],
        carry: ScanCarry | None = None,
    ) -> Traversal:
        """Trace the loop's body for one item of a region, or return the traversal known from an equal item."""
        leaves, key = flat
        signature = self._signature(leaves, group, item)
        what = (key, signature, carry and (carry.classes, carry.shape))
        if what in region.further:
            return region.further[what]
        graph, ports, numbers = region.graph, [], []
        for k, (leaf, own) in enumerate(zip(leaves, signature, strict=True)):
            places = tuple([p for p, earlier in enumerate(own) if earlier is None])
            inputs = tuple([graph.input() for _ in places])
            if inputs:
                ports.append(RegionInput(inputs, k, places))
            new = iter(inputs)
            numbers.append({n: next(new) if earlier is None else earlier for n, earlier in zip(leaf, own, strict=True)})
        args, body = self._values.replaced((x, f), numbers)
        handed: tuple[Any, ...] = ()
        carried: Leaf = ()
        if carry is not None:
            carried = tuple([graph.input() for _ in range(max(carry.classes, default=-1) + 1)])
            places = iter(carry.classes)
            handed = (with_numbers(carry.value, lambda _: carried[next(places)]),)
        self.inside = True
        try:
            value = body(*handed, *args)
        finally:
            self.inside = False
        next_carry = None
        if carry is not None:
            next_carry, value = value
        done = Traversal(value, tuple(ports), self._taken_apart(next_carry), carried, Region(graph))
        region.further[what] = done
        return done

    def _taken_apart(self, carry: Any) -> ScanCarry:
        numbers, shape = numbers_of(carry), self._values.leaves(with_numbers(carry, lambda _: None))[1]
        return ScanCarry(carry, numbers, _classes(numbers), shape)

    # ---- order ----

    def _give(self, group: TracedGroup, ports: Sequence[RegionInput], leaves: Sequence[Sequence[Leaf]]) -> None:
        """Connect new ports of a group's region to the nodes of the glue that each item feeds them."""
        given = []
        for port in ports:
            numbers = tuple([tuple([of_one[port.leaf][p] for p in port.places]) for of_one in leaves])
            self.settle([node for of_one in numbers for node in of_one])
            given.append((port, numbers))
        for port, numbers in given:  # in a second loop, because `settle` may have called a phase of this very group
            known = all(self._known_before(node) for of_one in numbers for node in of_one)
            group.take(PortSource(port.inputs, 0 if known else group.done + 1, numbers))

    def _known_before(self, node: Node) -> bool:
        """Return whether a node of the glue depends on parameters only."""
        known = self._constants
        for n in self.graph.nodes[len(known) : node.serial + 1]:  # no recursion, because graphs may be deep
            known.append(n in self.parameters if n.kind == "input" else all(known[a.serial] for a in n.args))
        return known[node.serial]

    def settle(self, nodes: Sequence[Node]) -> None:
        """Call the phases that compute the images on which nodes of the glue depend."""
        waiting = list(nodes)
        while waiting:
            node = waiting.pop()
            if node in self._settled:
                continue
            self._settled.add(node)
            waiting += node.args
            origin = self.origins.get(node)
            if origin is not None and origin.group.phase(origin.node) > origin.group.done:
                self._call(origin.group)

    def call_once(self, group: TracedGroup) -> None:
        """Call a group that has not been called yet, because all that is read from it depends on parameters only."""
        if group.done == 0:
            self._call(group)

    def call_first(self, groups: Sequence[TracedGroup]) -> bool:
        """Call those groups that are not called yet before all others, which read what depends on parameters only.

        Returns:
            Whether there are any.
        """
        others, self.phase_calls = self.phase_calls, []
        for group in groups:
            self.call_once(group)
        called, self.phase_calls = bool(self.phase_calls), self.phase_calls + others
        return called

    def _call(self, group: TracedGroup) -> None:
        if group.turns is not None:
            self._call_turns(group.turns)
            return
        group.done += 1
        self.phase_calls.append(PhaseCall(group, group.done, tuple(range(group.count))))

    def _call_turns(self, turns: Turns) -> None:
        """Call the waiting items of a scan in their order; consecutive items of one group share one call."""
        order, turns.open = turns.open, []
        runs: list[tuple[TracedGroup, list[int]]] = []
        for group, item in order:
            if not runs or runs[-1][0] is not group:
                runs.append((group, []))
            runs[-1][1].append(item)
        for group in {group for group, _ in runs}:
            group.done += 1
        self.phase_calls += [PhaseCall(group, group.done, tuple(items)) for group, items in runs]


def _classes(numbers: Sequence[Any]) -> Classes:
    """Return for every number the index of its class of equal numbers; classes are numbered by first appearance."""
    found: dict[Hashable, int] = {}
    return tuple([found.setdefault(x if isinstance(x, Node | tuple) else float(x).hex(), len(found)) for x in numbers])


def _once(numbers: Sequence[Any], classes: Classes) -> tuple[Any, ...]:
    """Return the first number of each class."""
    found: dict[int, Any] = {}
    for x, which in zip(numbers, classes, strict=True):
        found.setdefault(which, x)
    return tuple([found[which] for which in range(len(found))])
