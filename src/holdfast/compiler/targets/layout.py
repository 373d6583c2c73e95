"""The memory layout of a schedule's arrays, for one system and for a batch.

For one system, the arrays of a group whose items run side by side are packed into lanes: each entry is a vector with
one lane per item. All other arrays are contiguous. For a batch, each number is a vector with one lane per system.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

from holdfast.compiler.program import Program
from holdfast.compiler.schedule import Call, Group, Schedule
from holdfast.compiler.stage import Wire
from holdfast.compiler.targets.split import Access, SplitProgram

_LINE = 8  # [doubles] areas begin at multiples of a cache line, which is the alignment of the widest vector


BetweenCalls = str | tuple[str, int]  # an internal array, or the memory of a group's phase
_NEVER = (0, -1)  # the first and the last use of what is not used


class ArrayAddress(NamedTuple):
    """The address of a port's numbers.

    Attributes:
        external: the index of an external array, or None for working memory.
        offset: the distance from its beginning [doubles].
    """

    external: int | None
    offset: int


class Area(NamedTuple):
    """A part of working memory from `start` on: items of `size` numbers, packed in groups of `width` items."""

    start: int
    size: int
    width: int


class Layout:
    """The addresses of one schedule.

    Attributes:
        schedule: the schedule.
        systems: the number of systems side by side: the lanes of a batch, or 1.
        width: how many items of each group run side by side, by group name.
        packed: the copies of external arrays in lanes, by (group, port). Those of outputs last until the next call.
        sums: in a batch, where the sums x - x of results are, which are 0 if all are finite.
        total: the size of working memory without scratch memory [doubles].
    """

    def __init__(self, schedule: Schedule, lanes: int, systems: int = 1) -> None:
        self.schedule, self.systems, self.total = schedule, systems, 0
        self.width = {
            name: min(lanes, 1 << (g.count - 1).bit_length()) if g.side_by_side and systems == 1 else 1
            for name, g in schedule.groups.items()
        }
        self._externals = {name: k for k, name in enumerate(schedule.externals)}
        packing = self._packing()
        self.external_areas: dict[str, Area] = {}
        if systems > 1:
            for name, external in schedule.externals.items():
                rounded = -(-external.size // systems) * systems  # rows are transposed in square blocks
                self.external_areas[name] = self._area(1, rounded, 1)
            self.sums = self._area(1, 1, 1).start
        self.packed: dict[tuple[str, str], Area] = {}
        for name, group in schedule.groups.items():
            width = self.width[name]
            for port, wire in group.wires.items():
                if port in group.stage.input_ports and self._is_packed(name, wire):
                    self.packed[name, port] = self._area(group.count, group.stage.size(port), width)
        self._pack_outputs()
        self._between: dict[BetweenCalls, Area] = {}
        self._place_between(packing)
        # The addresses of items that are copies of numbers elsewhere in a batch's working memory, by array and item.
        self._copies: dict[tuple[str, int], ArrayAddress] = {}
        for call in schedule.calls if systems > 1 else ():
            for port, source, e in self._copied(call):
                wire = schedule.groups[call.group].wires[port]
                start = self.address(call.group, source, 0)
                self._copies[wire.array, wire.places[0]] = ArrayAddress(None, start.offset + e * systems)

    def computed(self, call: Call) -> Program:
        """Return the program of a stage's phase without the results that are copies: they are read at their origin."""
        stage = self._group(call.group).stage
        program = stage.pieces.programs[call.phase]
        outputs = list(program.outputs)
        for k, port in enumerate(stage.outputs[call.phase]):
            wire = self._group(call.group).wires[port]
            if (wire.array, wire.places[0]) in self._copies:
                outputs[k] = outputs[k]._replace(shape=(0,), places=())
        return replace(program, outputs=tuple(outputs))

    def blocks(self, group: str, items: tuple[int, ...]) -> list[int]:
        """Return the first item of every block of items that run side by side, in order."""
        width = self.width[group]
        if width == 1:
            return list(items)
        assert sorted(items) == list(range(self.schedule.groups[group].count)), group
        return list(range(0, len(items), width))

    def access(self, group: str, port: str) -> Access:
        """Return how a stage's function accesses the numbers of a port."""
        if self.systems > 1:
            return Access(self.systems)
        width, wire = self.width[group], self._group(group).wires[port]
        if wire.array in self.schedule.externals:
            return Access(width) if (group, port) in self.packed else Access(1, splat=width > 1)
        area = self._between[wire.array]
        if width > 1 and shared(wire):
            assert area.width == 1, (group, port)
            return Access(1, splat=True)
        assert width in (1, area.width), (group, port)
        return Access(area.width)

    def accesses(self, call: Call) -> tuple[list[Access], list[Access]]:
        """Return how the function of a stage's phase accesses its inputs and outputs; memory comes last in both."""
        stage = self._group(call.group).stage
        memory = Access(max(self.systems, self.width[call.group]))
        known = [port for phase in stage.inputs[: call.phase + 1] for port in phase]
        later = len(stage.input_ports) - len(known)
        inputs = [self.access(call.group, port) for port in known] + [Access()] * later + [memory] * call.phase
        return inputs, [*(self.access(call.group, port) for port in stage.outputs[call.phase]), memory]

    def places(self, call: Call, made: SplitProgram) -> list[list[ArrayAddress | None]]:
        """Return the arguments of a phase's function for every block of its items; None stands for scratch memory."""
        stage = self._group(call.group).stage
        ports, returned = stage.input_ports, tuple(stage.outputs[call.phase])

        def found(item: int) -> list[ArrayAddress | None]:
            read = (
                self.address(call.group, ports[k], item)
                if k < len(ports)
                else self._memory(call.group, k - len(ports), item)
                for k in made.reads
            )
            written = (
                self.address(call.group, returned[k], item)
                if k < len(returned)
                else self._memory(call.group, call.phase, item)
                for k in made.writes
            )
            return [*read, *written, *([None] if made.scratch else [])]

        return [found(item) for item in self.blocks(call.group, call.items)]

    def _memory(self, group: str, phase: int, item: int) -> ArrayAddress:
        """Return the address of the memory that a phase keeps for an item."""
        return self._at(self._between[group, phase], item)

    def address(self, group: str, port: str, item: int) -> ArrayAddress:
        """Return the address of a port's numbers for an item, which is the first of those that run side by side."""
        wire = self._group(group).wires[port]
        if (group, port) in self.packed:
            return self._at(self.packed[group, port], item)
        if wire.array in self.schedule.externals:
            if self.systems == 1:
                return ArrayAddress(self._externals[wire.array], wire.places[item])
            return ArrayAddress(None, self.external_areas[wire.array].start + wire.places[item] * self.systems)
        copied = self._copies.get((wire.array, wire.places[item])) if self.systems > 1 else None
        return copied or self._at(self._between[wire.array], wire.places[item])

    def _copied(self, call: Call) -> Iterator[tuple[str, str, int]]:
        """Return the results of a phase that are consecutive numbers of an input, the input and the first of these."""
        group = self._group(call.group)
        stage, internals = group.stage, self.schedule.internals
        program = stage.pieces.programs[call.phase]
        sizes = [math.prod(shape) for shape in program.input_shapes]
        owners = [(k, e) for k, size in enumerate(sizes) for e in range(size)]
        for port, output in zip(stage.outputs[call.phase], program.outputs, strict=False):
            first, count = output.places[0] if output.places else -1, len(output.places)
            consecutive = tuple(output.places) == tuple(range(first, first + count))
            if group.count > 1 or not consecutive or not 0 <= first <= len(owners) - count:
                continue
            (k, e), (last, _) = owners[first], owners[first + count - 1]
            if k != last or k >= len(stage.input_ports):
                continue
            source, target = group.wires[stage.input_ports[k]].array, group.wires[port].array
            if source in internals and target in internals and internals[target].size == count:
                yield port, stage.input_ports[k], e

    def _group(self, name: str) -> Group:
        return self.schedule.groups[name]

    def _is_packed(self, group: str, wire: Wire) -> bool:
        """Return whether a group's items run side by side, each of them wired to its own part of an external array."""
        return self.width[group] > 1 and wire.array in self.schedule.externals and not shared(wire)

    def _place_between(self, packing: Mapping[str, int]) -> None:
        """Place internal arrays and memories; a place is used again after the last use of what it held."""
        sizes: dict[BetweenCalls, tuple[int, int, int]] = {}
        for name, internal in self.schedule.internals.items():
            sizes[name] = (internal.items, internal.size, packing.get(name, 1))
        for name, group in self.schedule.groups.items():
            for phase, size in enumerate(group.stage.pieces.memory):
                sizes[name, phase] = (group.count, size, self.width[name])
        lives = self._lives()
        begin, placed = self.total, list[tuple[int, int, tuple[int, int]]]()  # from, to, life
        for key in sorted(sizes, key=lambda key: lives.get(key, _NEVER)):
            first, last = lives.get(key, _NEVER)
            self.total = begin
            for start, end, (since, until) in sorted(placed):
                if since <= last and first <= until:
                    if self.total + self._size(*sizes[key]) <= start:
                        break
                    self.total = max(self.total, end)
            area = self._between[key] = self._area(*sizes[key])
            placed.append((area.start, self.total, (first, last)))
        self.total = max([begin, *(end for _, end, _ in placed)])

    def _lives(self) -> dict[BetweenCalls, tuple[int, int]]:
        """Return the first and the last call that use each internal array and memory; what `prepare` uses is kept."""
        calls = self.schedule.calls
        found: dict[BetweenCalls, tuple[int, int]] = {}
        for k, call in [*((-1, call) for call in self.schedule.prepare), *enumerate(calls)]:
            group = self._group(call.group)
            ports, program = group.stage.input_ports, group.stage.pieces.programs[call.phase]
            used: list[BetweenCalls] = [group.wires[port].array for port in group.stage.outputs[call.phase]]
            used.append((call.group, call.phase))
            for j in program.used_inputs:
                used.append(group.wires[ports[j]].array if j < len(ports) else (call.group, j - len(ports)))
            for key in used:
                first, _ = found.get(key, (k, k))
                found[key] = (first, len(calls) if first < 0 else k)
        for call in reversed(calls if self.systems > 1 else ()):
            for port, source, _ in self._copied(call):
                wires = self._group(call.group).wires
                first, last = found[wires[source].array]
                found[wires[source].array] = (first, max(last, found[wires[port].array][1]))
        return found

    def _pack_outputs(self) -> None:
        """Reserve memory for outputs in lanes, the same for every call: outputs are copied right after it."""
        begin = end = self.total
        for name, group in self.schedule.groups.items():
            for ports in group.stage.outputs:
                self.total = begin
                for port in ports:
                    if self._is_packed(name, group.wires[port]):
                        area = self._area(group.count, group.stage.size(port), self.width[name])
                        self.packed[name, port] = area
                end = max(end, self.total)
        self.total = end

    def _packing(self) -> dict[str, int]:
        """Return how many items of each internal array are packed: as many as its group runs side by side."""
        found: dict[str, int] = {}
        for name, group in self.schedule.groups.items():
            for wire in group.wires.values():
                if self.width[name] > 1 and wire.array in self.schedule.internals and not shared(wire):
                    assert wire.places == tuple(range(group.count)), (name, wire)
                    found[wire.array] = self.width[name]
        return found

    def _area(self, items: int, size: int, width: int) -> Area:
        area = Area(self.total, size, width)
        self.total += self._size(items, size, width)
        return area

    def _size(self, items: int, size: int, width: int) -> int:
        return -(-(-(-items // width) * width * size * self.systems) // _LINE) * _LINE

    def _at(self, area: Area, item: int) -> ArrayAddress:
        block, lane = divmod(item, area.width)
        return ArrayAddress(None, area.start + (block * area.size * area.width + lane) * self.systems)


def shared(wire: Wire) -> bool:
    """Return whether all of several items use the same numbers."""
    return len(set(wire.places)) == 1 and len(wire.places) > 1
