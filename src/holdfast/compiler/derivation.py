"""Derive the schedule of a traced composition: its arrays, wires, phases and calls."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from holdfast.compiler.composition import Composition
from holdfast.compiler.graph import Graph
from holdfast.compiler.needed import Needed
from holdfast.compiler.node import Node
from holdfast.compiler.region import ImageOrigin, PortSource, Scan, TracedGroup
from holdfast.compiler.schedule import Call, External, Group, Internal, Schedule
from holdfast.compiler.stage import GraphPorts, Stage, Stages, Wire, made_of
from holdfast.compiler.trace import as_node
from holdfast.compiler.values import Leaf

GLUE = "glue"


class GlueOutput(NamedTuple):
    """Numbers that the glue writes into an array.

    Attributes:
        numbers: the nodes of the glue.
        array: the name of the array.
        place: the item of an internal array that they fill, or their first entry in an external array.
    """

    numbers: Leaf
    array: str
    place: int


class Derivation:
    """Collects the arrays and ports of a composition's schedule."""

    def __init__(
        self, needed: Needed, externals: Mapping[str, External], given: Mapping[str, Leaf], fused: bool
    ) -> None:
        """Start with no arrays and no wires.

        Args:
            needed: what the results of the completely traced composition depend on.
            externals: the caller's arrays by name.
            given: the nodes of the glue for every input and parameter, by name.
            fused: whether products and sums are fused to fma operations.
        """
        self.traced, self.needed, self.externals, self.given = needed.traced, needed, externals, given
        self.place_of = {node: (name, k) for name, nodes in given.items() for k, node in enumerate(nodes)}
        self.internals: dict[str, Internal] = {}
        self.ports = {group: GraphPorts() for group in self.traced.groups}
        self.glue = GraphPorts()
        self.glue_outputs: list[GlueOutput] = []
        self._arrays: dict[object, str] = {}
        self.stages = Stages(fused)
        self._last = {(step.group, step.phase): k for k, step in enumerate(self.traced.phase_calls)}

    # ---- inputs of the regions ----

    def regions(self) -> None:
        """Wire every input that the regions need, including the carries of scans."""
        for k, scan in enumerate(self.traced.scans):
            self._carry(f"carry{k}", scan)
        for group in self.traced.groups:
            for source in group.sources:
                places = [k for k, node in enumerate(source.inputs) if node in self.needed.inputs[group]]
                if source.numbers is not None and places:
                    self._take(group, source, places)

    def _take(self, group: TracedGroup, source: PortSource, places: Sequence[int]) -> None:
        """Wire a port: as a whole if it is part of an external array, otherwise only the numbers that are needed."""
        assert source.numbers is not None
        inputs, wire = source.inputs, self._external(source.numbers)
        if wire is None:
            inputs = tuple([source.inputs[k] for k in places])
            numbers = tuple([tuple([of_one[k] for k in places]) for of_one in source.numbers])
            wire = self._external(numbers) or self._image(group, numbers) or self._glued(numbers)
        self.ports[group].given.append((source.phase, inputs, wire))

    def _external(self, numbers: tuple[Leaf, ...]) -> Wire | None:
        """Return the wire to an array of the caller, if the numbers of every item are consecutive in it."""
        names, places = set(), []
        for of_one in numbers:
            at = [self.place_of.get(node) for node in of_one]
            if None in at:
                return None
            (name, start), *_ = at  # type: ignore[misc]
            if at != [(name, start + k) for k in range(len(at))]:
                return None
            names.add(name)
            places.append(start)
        return Wire(names.pop(), tuple(places)) if len(names) == 1 else None

    def _image(self, group: TracedGroup, numbers: tuple[Leaf, ...]) -> Wire | None:
        """Return the wire to results of other groups, if all numbers of an item come from one item of one group."""
        found = [self._origin(of_one) for of_one in numbers]
        if any(one is None for one in found):
            return None
        origins = [one for one in found if one is not None]
        makers = {maker for maker, _, _ in origins}
        if len(makers) == 1 and len({nodes for _, _, nodes in origins}) == 1:
            (maker, _, nodes), items = origins[0], tuple([i for _, i, _ in origins])
            alike = items == tuple(range(maker.count)) and group.count == maker.count
            if not _wide(group) or alike or (not _wide(maker) and len(set(items)) == 1):
                return Wire(self._returned(maker, nodes, in_lanes=_wide(group) and alike), items)
        if any(_wide(maker) for maker in makers):
            return None
        return self._gathered(origins)

    def _origin(self, numbers: Leaf) -> tuple[TracedGroup, int, Leaf] | None:
        """Return the one group and item that all numbers are images of, and their region nodes; otherwise None."""
        origins = [self.traced.origins.get(node) for node in numbers]
        if None in origins or len({(o.group, o.item) for o in origins}) > 1:  # type: ignore[union-attr]
            return None
        first: ImageOrigin = origins[0]  # type: ignore[assignment]
        return first.group, first.item, tuple([o.node for o in origins])  # type: ignore[union-attr]

    def _gathered(self, origins: Sequence[tuple[TracedGroup, int, Leaf]]) -> Wire | None:
        """Return the wire to an array that several groups write item by item, or one group in another order."""
        wanted: dict[tuple[TracedGroup, Leaf], dict[int, int]] = {}
        for place, (maker, item, nodes) in enumerate(origins):
            wanted.setdefault((maker, nodes), {})[item] = place
        whole = all(len(places) == maker.count for (maker, _), places in wanted.items())
        if not whole or sum(map(len, wanted.values())) != len(origins):
            return None
        key = tuple([(maker.name, item, nodes) for maker, item, nodes in origins])
        if key not in self._arrays:
            name = self._arrays[key] = f"gathered{len(self._arrays)}"
            self.internals[name] = Internal(len(origins), len(origins[0][2]))
            for (maker, nodes), places in wanted.items():
                self._return(maker, nodes, Wire(name, tuple([places[i] for i in range(maker.count)])))
        return Wire(self._arrays[key], tuple(range(len(origins))))

    def _returned(self, maker: TracedGroup, nodes: Leaf, in_lanes: bool = False) -> str:
        """Return the name of the array into which every item of a group writes the given numbers.

        Args:
            maker: the group that returns them.
            nodes: the numbers, as nodes of its region.
            in_lanes: whether the group that reads the array runs its items side by side in lanes; such an array is
                not shared with other readers.
        """
        key = (maker.name, nodes, in_lanes and not _wide(maker))
        if key not in self._arrays:
            name = self._arrays[key] = f"{maker.name}.{len(self._arrays)}"
            self.internals[name] = Internal(maker.count, len(nodes))
            self._return(maker, nodes, Wire(name, tuple(range(maker.count))))
        return self._arrays[key]

    def _return(self, maker: TracedGroup, nodes: Leaf, wire: Wire, phase: int | None = None) -> None:
        known = max([1, *map(maker.phase, nodes)]) if phase is None else phase
        self.ports[maker].returned.append((known, nodes, wire))

    def _glued(self, numbers: tuple[Leaf, ...]) -> Wire:
        """Return the wire to an array that the glue writes."""
        same = len(set(numbers)) == 1
        items = numbers[:1] if same else numbers
        if items not in self._arrays:
            name = self._arrays[items] = f"{GLUE}{len(self._arrays)}"
            self.internals[name] = Internal(len(items), len(numbers[0]))
            self.glue_outputs += [GlueOutput(of_one, name, i) for i, of_one in enumerate(items)]
        return Wire(self._arrays[items], (0,) * len(numbers) if same else tuple(range(len(numbers))))

    def _carry(self, name: str, scan: Scan) -> None:
        """Wire the numbers of a scan's carry that are needed from item to item."""
        names: dict[object, str] = {}
        needed: dict[object, list[int]] = {}
        for k, (group, _, _) in enumerate(scan.order):
            inputs = scan.source(group).inputs
            needed[scan.kept[k]] = [c for c, node in enumerate(inputs) if node in self.needed.inputs[group]]
        for kept, classes in needed.items():
            if classes:
                names[kept] = f"{name}.{len(names)}"
                self.internals[names[kept]] = Internal(len(scan.kept), len(classes))
        taken: dict[TracedGroup, dict[int, int]] = {}
        handed: dict[tuple[TracedGroup, Leaf, str], dict[int, int]] = {}
        for k, (group, item, _) in enumerate(scan.order):
            taken.setdefault(group, {})[item] = k
            kept = scan.kept[k + 1]
            if kept in names and not (k == len(scan.order) - 1 and group.count == 1):
                nodes = tuple([as_node(group.region.graph, scan.handed[k][c]) for c in needed[kept]])
                handed.setdefault((group, nodes, names[kept]), {})[item] = k + 1
        for group, places in taken.items():
            source, kept = scan.source(group), scan.kept[places[0]]
            if kept in names:
                wire = Wire(names[kept], tuple([places[i] for i in range(group.count)]))
                inputs = tuple([source.inputs[c] for c in needed[kept]])
                self.ports[group].given.append((source.phase, inputs, wire))
        for (group, nodes, array), places in handed.items():
            assert len(places) == group.count, "all items of a group must pass on the same nodes of the carry"
            wire = Wire(array, tuple([places[i] for i in range(group.count)]))
            self._return(group, nodes, wire, scan.source(group).phase)
        if scan.kept[0] in names:
            first = tuple([as_node(self.traced.graph, scan.first[c]) for c in needed[scan.kept[0]]])
            self.glue_outputs.append(GlueOutput(first, names[scan.kept[0]], 0))

    # ---- results ----

    def results(self, found: Mapping[str, Sequence[Any]]) -> None:
        """Wire the results: directly from the groups that compute them where possible, otherwise through the glue."""
        for outside, numbers in found.items():
            name = outside
            if self.externals[outside].role == "carried":  # its old value may still be read until the end
                name = f"next.{outside}"
                self.internals[name] = Internal(len(numbers), 1)
            runs = _runs([self.traced.origins.get(x) if isinstance(x, Node) else None for x in numbers])
            of_group: dict[TracedGroup, dict[int, tuple[int, Leaf]]] = {}
            several: set[TracedGroup] = set()
            for start, nodes, origin in runs:
                if origin is not None:
                    places = of_group.setdefault(origin.group, {})
                    if origin.item in places or len(set(nodes)) < len(nodes):
                        several.add(origin.group)
                    places[origin.item] = (start, nodes)
            straight = set()
            for group, places in of_group.items():
                alike = {nodes for _, nodes in places.values()}
                if group not in several and len(places) == group.count and len(alike) == 1:
                    straight.add(group)
                    wire = Wire(name, tuple([places[i][0] for i in range(group.count)]))
                    self._return(group, alike.pop(), wire)
            for start, nodes, origin in runs:
                if origin is None or origin.group not in straight:
                    there = tuple([as_node(self.traced.graph, x) for x in numbers[start : start + len(nodes)]])
                    self.glue_outputs.append(GlueOutput(there, name, start))

    def _return_alike(self) -> None:
        """Let groups with the same region return the same numbers, so that they share one stage.

        The numbers that a group returns only for this reason go to arrays that nobody reads.
        """
        for alike in self.needed.alike:
            every = {(phase, nodes) for group in alike for phase, nodes, _ in self.ports[group].returned}
            for group in alike:
                missing = every - {(phase, nodes) for phase, nodes, _ in self.ports[group].returned}
                for k, (phase, nodes) in enumerate(sorted(missing, key=lambda x: (x[0], [n.serial for n in x[1]]))):
                    name = f"{group.name}.unread{k}"
                    self.internals[name] = Internal(group.count, len(nodes))
                    self._return(group, nodes, Wire(name, tuple(range(group.count))), phase)
        for ports in self.ports.values():
            ports.returned.sort(key=lambda port: (port[0], [node.serial for node in port[1]]))

    def _carry_over(self) -> tuple[Stage, dict[str, Wire]]:
        """Return the stage that copies the new values of carried arrays to where the next repetition reads them."""
        graph, ports = Graph(), GraphPorts()
        for name, internal in self.internals.items():
            if name.startswith("next."):
                nodes = tuple([graph.input() for _ in range(internal.items)])
                ports.given.append((0, nodes, Wire(name, (0,))))
                ports.returned.append((0, nodes, Wire(name.removeprefix("next."), (0,))))
        return self.stages.placed("handed_on", graph, ports, 0)

    # ---- the glue ----

    def glued(self) -> list[int]:
        """Wire the glue; return the indices of the phase calls before which it is called."""
        outside = {name for name, external in self.externals.items() if external.role != "parameter"}
        known = self._ready([node for put in self.glue_outputs for node in put.numbers])
        ready = [max(0 if put.array in outside else -1, *[known[n] for n in put.numbers]) for put in self.glue_outputs]
        when = sorted({at for at in ready if at >= 0})
        phase = {-1: 0} | {at: k + 1 for k, at in enumerate(when)}
        for put, at in zip(self.glue_outputs, ready, strict=True):
            self.glue.returned.append((phase[at], put.numbers, Wire(put.array, (put.place,))))
        used = {node for node in known if node.kind == "input"}
        for name, nodes in self.given.items():
            if not used.isdisjoint(nodes):
                at = 0 if self.externals[name].role == "parameter" else 1
                self.glue.given.append((at, nodes, Wire(name, (0,))))
        for group, items, nodes, last in self._seen(used):
            array = self._returned(group, nodes)
            at = next(k for k in when if k > self._last[group, last])
            for i in items:
                images = group.images[i]
                self.glue.given.append((phase[at], tuple([images[n] for n in nodes]), Wire(array, (i,))))
        return when

    def _ready(self, nodes: Iterable[Node]) -> dict[Node, int]:
        """Return for all that nodes are made of the phase call before which it is known, -1 for parameters only."""
        known: dict[Node, int] = {}
        for n in made_of(nodes):
            origin = self.traced.origins.get(n)
            if origin is not None:
                called = self._last.get((origin.group, max(1, origin.group.phase(origin.node))))
                known[n] = len(self.traced.phase_calls) if called is None else called + 1
            elif n.kind == "input":
                known[n] = -1 if n in self.traced.parameters else 0
            else:
                known[n] = max([known[a] for a in n.args], default=-1)
        return known

    def _seen(self, used: set[Node]) -> list[tuple[TracedGroup, list[int], Leaf, int]]:
        """Return what the glue reads from the groups: group, items, region nodes, and the phase that returns them."""
        nodes: dict[tuple[TracedGroup, int], set[Node]] = {}
        items: dict[tuple[TracedGroup, int], set[int]] = {}
        for node in used:
            origin = self.traced.origins.get(node)
            if origin is not None:
                at = origin.group, max(1, origin.group.phase(origin.node))
                nodes.setdefault(at, set()).add(origin.node)
                items.setdefault(at, set()).add(origin.item)
        # What the glue hands on stays in its order, so that a batch can read it where it is.
        put = [self.traced.origins.get(node) for put in self.glue_outputs for node in put.numbers]
        rank = {origin.node: -k for k, origin in enumerate(reversed(put)) if origin is not None}

        def key(node: Node) -> tuple[int, int]:
            return rank.get(node, 1), node.serial

        order = [
            (group, sorted(items[group, phase]), tuple(sorted(nodes[group, phase], key=key)), phase)
            for group, phase in nodes
        ]
        return sorted(order, key=lambda x: (self.traced.groups.index(x[0]), x[3]))

    # ---- stages ----

    def schedule(self, status: str | None, guarded: tuple[str, ...]) -> Schedule:
        """Return the schedule, once inputs and results are wired."""
        when = self.glued()
        self._return_alike()
        groups: dict[str, Group] = {}
        prepare, calls = [], []
        stage, wires = self.stages.placed(GLUE, self.traced.graph, self.glue, len(when))
        if self.glue.returned:
            groups[GLUE] = Group(stage, 1, wires, side_by_side=False)
            if stage.outputs[0] or stage.pieces.memory[0]:
                prepare.append(Call(GLUE, 0, (0,)))
        for group in self.traced.groups:
            stage, wires = self.stages.placed(group.name, group.region.graph, self.ports[group], group.done)
            groups[group.name] = Group(stage, group.count, wires, side_by_side=_wide(group))
            if stage.outputs[0] or stage.pieces.memory[0]:
                prepare.append(Call(group.name, 0, tuple(range(group.count))))
        for k, step in enumerate(self.traced.phase_calls):
            if k in when:
                calls.append(Call(GLUE, 1 + when.index(k), (0,)))
            stage = groups[step.group.name].stage
            if stage.outputs[step.phase] or stage.pieces.memory[step.phase]:
                calls.append(Call(step.group.name, step.phase, step.items))
        if len(self.traced.phase_calls) in when:
            calls.append(Call(GLUE, len(when), (0,)))
        if any(external.role == "carried" for external in self.externals.values()):
            stage, wires = self._carry_over()
            groups["handed_on"] = Group(stage, 1, wires, side_by_side=False)
            calls.append(Call("handed_on", 0, (0,)))
        return Schedule(dict(self.externals), self.internals, groups, tuple(prepare), tuple(calls), status, guarded)


def derived(
    traced: Composition,
    externals: Mapping[str, External],
    given: Mapping[str, Leaf],
    found: Mapping[str, Sequence[Any]],
    status: str | None = None,
    guarded: tuple[str, ...] = (),
    fused: bool = True,
) -> Schedule:
    """Return the schedule of a traced composition.

    Args:
        traced: the composition.
        externals: the caller's arrays by name.
        given: the nodes of the glue for every input and parameter, by name.
        found: the numbers of every output, by name.
        status: the output that holds the status, or None (see `Schedule`).
        guarded: the outputs that become NaN if the status is bad (see `Schedule`).
        fused: whether products and sums are fused to fma operations, as they should be if the target has them.
    """
    results = [x for numbers in found.values() for x in numbers if isinstance(x, Node)]
    traced.settle(results)
    for node in made_of(results):
        if node in traced.origins:
            traced.call_once(traced.origins[node].group)
    (needed := Needed(traced)).follow(results)
    if traced.call_first([group for group in traced.groups if group in needed.read]):
        (needed := Needed(traced)).follow(results)
    derivation = Derivation(needed, externals, given, fused)
    derivation.regions()
    derivation.results(found)
    return derivation.schedule(status, guarded)


def _runs(origins: Sequence[ImageOrigin | None]) -> list[tuple[int, Leaf, ImageOrigin | None]]:
    """Split numbers into runs of images of one item; return each run's start, region nodes and first origin."""
    found: list[tuple[int, list[Any], ImageOrigin | None]] = []
    for k, origin in enumerate(origins):
        before = found[-1][2] if found else None
        same = bool(found) and (
            (origin is None and before is None)
            or (origin is not None and before is not None and origin[:2] == before[:2])
        )
        if not same:
            found.append((k, [], origin))
        found[-1][1].append(origin.node if origin else None)
    return [(start, tuple(nodes), origin) for start, nodes, origin in found]


def _wide(group: TracedGroup) -> bool:
    """Return whether the items of a group run side by side."""
    return group.turns is None and group.count > 1
